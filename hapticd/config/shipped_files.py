"""The scenes, operators, materials, studies and sweeps that ship with hapticd, and how a person names them.

A scene, an operator, a study or a sweep that ships is named without folder and ending: `comb`. A file of that name in
the current folder comes first.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import HapticdError, near_names
from hapticd.base.yaml_source import one_line

Folder: TypeAlias = Literal["scenes", "operators", "materials", "experiments", "sweeps"]

_ENDINGS: Final = (".yaml", ".csv")
_MOST_NEAR: Final = 3


@dataclass(frozen=True, slots=True)
class ShippedScene:
    """A scene that ships, or another file, as its first comment describes it."""

    name: str
    shows: str
    """One sentence."""
    operator: str | None
    """The name of the shipped operator that is made for it."""
    file: str

    def to_dict(self) -> dict[str, str | None]:
        """As JSON."""
        return {"name": self.name, "shows": self.shows, "operator": self.operator, "file": self.file}


def folder_of(name: str) -> Path:
    """A folder of what ships: `scenes`, `operators`, `materials`, `experiments`, `sweeps`."""
    return Path(str(resources.files("hapticd.shipped").joinpath(name)))


def units_folder() -> Path:
    """Where the units of systemd and the udev rules lie that `hapticd install-service` puts in place."""
    return Path(str(resources.files("hapticd.units").joinpath("hapticd.service"))).parent


@cache
def shipped(folder: Folder) -> dict[str, str]:
    """Files by the names that a person gives them."""
    files = sorted(path for path in folder_of(folder).iterdir() if path.suffix in _ENDINGS)
    return {path.stem: str(path) for path in files}


def shipped_scenes() -> list[ShippedScene]:
    """The scenes that ship, by name."""
    return described("scenes")


def described(folder: Folder) -> list[ShippedScene]:
    """The files of a folder that ship, by name, as their first comments describe them."""
    return [_described(name, file) for name, file in shipped(folder).items()]


def _described(name: str, file: str) -> ShippedScene:
    lines = Path(file).read_text(encoding="utf-8").splitlines()
    end = next((row for row, line in enumerate(lines) if not line.startswith("#")), len(lines))
    comment = " ".join(line.lstrip("#").strip() for line in lines[:end])
    operator = re.search(r"\bOperator: (\w+)\.yaml", comment)
    sentence = re.match(r".*?\.(?=\s|$)", comment)
    return ShippedScene(name, sentence[0] if sentence else comment, operator[1] if operator else None, file)


def file_of(text: str, folder: Folder) -> str:
    """The file that `text` names: the file of that name, or else what ships under it. `-` is the standard input.

    Raises HapticdError for a bare name that is neither. A path that leads nowhere is returned as it is, for its reader
    to say so.
    """
    if text == "-":
        return "/dev/stdin"
    if os.path.exists(text) and not os.path.isdir(text):
        return text
    known = shipped(folder)
    if text in known:
        return known[text]
    what = folder.removesuffix("s")
    stem, ending = os.path.splitext(text)
    if os.path.dirname(text) or (ending and stem not in known):
        return text
    if stem in known:
        raise HapticdError(f"{text}: there is no such file here; the shipped {what} of that name is called {stem}")
    near = near_names(text, list(known), _MOST_NEAR)
    meant = f"did you mean {' or '.join(near)}?" if near else f"shipped: {', '.join(known)}"
    raise HapticdError(f"{one_line(text)}: is no file here and no shipped {what}; {meant}")
