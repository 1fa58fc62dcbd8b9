"""The docstring of each room of the package explains each of its files, and names only existing files."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from hapticd.cli import _MODULE_BY_COMMAND

PACKAGE = Path(__file__).parents[2] / "hapticd"
ROOMS = sorted(path for path in PACKAGE.iterdir() if (path / "__init__.py").is_file())
FOLDERS = sorted(path.parent for room in ROOMS for path in room.glob("*/**/__init__.py"))
ENTRY = re.compile(r"( *)(\w+(?:, \w+)*|\w+/) {2,}\S")
"""A line of a map: one or several names, at least two spaces, and an explanation."""
FILE = re.compile(r"(?<![\w./-])(?:[a-z_]+/)*[a-z_]\w*\.py\b")


def names_of(folder: Path) -> list[str]:
    """Return the entries of the map in a folder's docstring; entries in a subfolder have its name as prefix."""
    docstring = ast.get_docstring(ast.parse((folder / "__init__.py").read_text()))
    assert docstring is not None, folder
    found: list[str] = []
    within, indent = "", 0
    for match in filter(None, map(ENTRY.match, docstring.splitlines())):
        depth = len(match[1])
        if within and depth <= indent:
            within = ""
        if match[2].endswith("/"):
            within, indent = match[2], depth
            found.append(within)
        else:
            found += [within + name for name in match[2].split(", ")]
    return found


def files_of(folder: Path) -> set[str]:
    folders = {f"{path.parent.name}/" for path in folder.glob("*/__init__.py")}
    return {path.stem for path in folder.glob("*.py") if path.stem != "__init__"} | folders


@pytest.mark.parametrize("room", ROOMS, ids=lambda path: path.name)
def test_the_map_of_a_room_names_its_files(room: Path) -> None:
    named = names_of(room)
    assert len(named) == len(set(named))
    commands = set(_MODULE_BY_COMMAND.values()) if room.name == "cli" else set()
    assert {name for name in named if "/" not in name.rstrip("/")} | commands == files_of(room)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_the_map_of_a_folder_names_its_files(folder: Path) -> None:
    """The map is in the docstring of the folder or of its room."""
    of_room = [name.partition("/")[2] for name in names_of(folder.parent) if name.startswith(f"{folder.name}/")]
    assert sorted([*names_of(folder), *filter(None, of_room)]) == sorted(files_of(folder))


def test_only_two_rooms_load_anything() -> None:
    """The import of a file of a room must not load other files."""
    loading = {
        str(folder.relative_to(PACKAGE))
        for folder in (*ROOMS, *FOLDERS)
        if len(ast.parse((folder / "__init__.py").read_text()).body) > 1
    }
    assert loading == {"cli", "doctor"}


def test_every_file_of_python_that_is_named_exists() -> None:
    sources = sorted(PACKAGE.rglob("*.py"))
    names = {path.name for path in sources}
    named = {
        (name, str(path.relative_to(PACKAGE)))
        for path in sources
        for name in FILE.findall(path.read_text())
        if Path(name).name not in names and not (PACKAGE.parent / name).exists()
    }
    assert named == set()
