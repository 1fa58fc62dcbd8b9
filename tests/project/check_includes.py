"""The rooms of csrc/ and their order: `python -m tests.project.check_includes` names each include that breaks it.

A room includes only rooms above it in ROOMS, and of another room only its public header. Within a room, a .c file and
its header count as one file, and includes form no circle. The first line of each file is a comment of at least four
words that says what the file is for; in rooms of many files one header lists them all.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Final

ROOMS: Final = ("api", "base", "shapes", "scene", "tick", "device", "servo")
PUBLIC_HEADERS: Final = {
    "api": "hd_core.h",
    "shapes": "hd_shape.h",
    "scene": "hd_world.h",
    "tick": "hd_tick.h",
    "device": "hd_device.h",
}
"""The public header of each room. All headers of base/ are public."""

LISTING_HEADERS: Final = {"base": "hd_rt.h", "tick": "hd_tick.h", "device": "hd_device.h"}
"""The header whose first comment lists the files of its room."""

CSRC: Final = Path(__file__).resolve().parents[2] / "csrc"
INCLUDE: Final = re.compile(r'^\s*#\s*include\s*"([^"]+)"', re.M)

Includes = dict[str, list[str]]
"""The included files of each file, all as ROOM/NAME."""


def includes_of(csrc: Path) -> Includes:
    return {
        path.relative_to(csrc).as_posix(): INCLUDE.findall(path.read_text(encoding="utf-8"))
        for path in sorted(csrc.glob("*/*.[ch]"))
    }


def _wrong(file: str, included: str) -> str | None:
    room, other = file.split("/")[0], included.split("/")[0]
    if room not in ROOMS:
        return f"csrc/{file}: {room}/ is not one of the rooms {', '.join(ROOMS)}"
    if other not in ROOMS or "/" not in included:
        return f'csrc/{file} includes "{included}", which does not begin with a room'
    if ROOMS.index(other) > ROOMS.index(room):
        return f"csrc/{file} includes {included}, of a room below"
    if other not in (room, "base") and included.split("/")[1] != PUBLIC_HEADERS[other]:
        return f"csrc/{file} includes {included}, a private header; public: {PUBLIC_HEADERS[other]}"
    return None


def _circle(edges: dict[str, set[str]]) -> list[str]:
    """Return the first circle of includes, which begins and ends with the same name; [] if there is no circle."""
    done: set[str] = set()

    def visit(name: str, path: list[str]) -> list[str]:
        if name in path:
            return [*path[path.index(name) :], name]
        if name not in done:
            for other in sorted(edges.get(name, ())):
                if circle := visit(other, [*path, name]):
                    return circle
            done.add(name)
        return []

    return next((circle for name in sorted(edges) if (circle := visit(name, []))), [])


def faults(includes: Includes) -> list[str]:
    """Return a line for each include that breaks a rule."""
    found = [fault for file, all_of in includes.items() for one in all_of if (fault := _wrong(file, one))]
    edges: dict[str, set[str]] = {}
    for file, all_of in includes.items():
        name = file.removesuffix(".c").removesuffix(".h")
        others = {
            one.removesuffix(".c").removesuffix(".h") for one in all_of if one.split("/")[0] == file.split("/")[0]
        }
        edges.setdefault(name, set()).update(others - {name})
    if circle := _circle(edges):
        found.append(f"these files of csrc/ include each other in a circle: {' -> '.join(circle)}")
    return found


def has_purpose_comment(text: str) -> bool:
    """Return whether the first line is a comment of at least four words; names of files do not count."""
    comment = re.match(r"/\*(.*?)(\*/|\n)", text)
    words = comment[1].split() if comment else []
    return sum(re.fullmatch(r"[A-Za-z'-]+[,.:;]?", word) is not None for word in words) >= 4


def unexplained_files(csrc: Path) -> list[str]:
    """Return a line for each file without a comment on its purpose, and each that the list of its room lacks."""
    found = []
    for path in sorted(csrc.glob("*/*.[ch]")):
        name = path.relative_to(csrc).as_posix()
        if not has_purpose_comment(path.read_text(encoding="utf-8")):
            found.append(f"csrc/{name}: the first line is not a comment that says what the file is for")
        if path.parent.name in LISTING_HEADERS:
            header = path.parent / LISTING_HEADERS[path.parent.name]
            listed = re.findall(r"^ \*   (hd_\w+)  ", header.read_text(encoding="utf-8").split("*/")[0], re.M)
            if path.stem not in listed:
                found.append(f"csrc/{name} is missing in the list at the top of {header.name}")
    return found


if __name__ == "__main__":
    lines = faults(includes_of(CSRC)) + unexplained_files(CSRC)
    print("\n".join(lines), file=sys.stderr, end="\n" if lines else "")
    sys.exit(1 if lines else 0)
