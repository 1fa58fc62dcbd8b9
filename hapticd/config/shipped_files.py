"""Scenes, operators, materials, studies and sweeps that ship with hapticd, found by name.

Their names have neither folder nor suffix: `comb`. A file of that name in the current folder takes precedence.
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
from hapticd.base.yaml_source import printable

Folder: TypeAlias = Literal["scenes", "operators", "materials", "experiments", "sweeps"]

_SHIPPED_SUFFIXES: Final = (".yaml", ".csv")
_MAX_SUGGESTIONS: Final = 3
"""Largest number of similar names that an error suggests."""


@dataclass(frozen=True, slots=True)
class ShippedFile:
    """A shipped file, with the description in its first comment."""

    name: str
    shows: str
    """Description, one sentence."""
    operator: str | None
    """Name of the shipped operator for a scene; None for other files."""
    file: str

    def to_dict(self) -> dict[str, str | None]:
        """Return name, description and operator of the shipped file as plain data."""
        return {"name": self.name, "shows": self.shows, "operator": self.operator, "file": self.file}


def folder_of(name: str) -> Path:
    """Return a folder of shipped files: `scenes`, `operators`, `materials`, `experiments`, `sweeps`."""
    return Path(str(resources.files("hapticd.shipped").joinpath(name)))


def units_folder() -> Path:
    """Return the folder of the systemd units and udev rules that `hapticd install-service` installs."""
    return Path(str(resources.files("hapticd.units").joinpath("hapticd.service"))).parent


@cache
def shipped(folder: Folder) -> dict[str, str]:
    """Return the shipped files of a folder by name."""
    files = sorted(path for path in folder_of(folder).iterdir() if path.suffix in _SHIPPED_SUFFIXES)
    return {path.stem: str(path) for path in files}


def shipped_scenes() -> list[ShippedFile]:
    """Return the shipped scenes, sorted by name."""
    return described("scenes")


def described(folder: Folder) -> list[ShippedFile]:
    """Return the shipped files of a folder, sorted by name, with their descriptions."""
    return [_described(name, file) for name, file in shipped(folder).items()]


def _described(name: str, file: str) -> ShippedFile:
    lines = Path(file).read_text(encoding="utf-8").splitlines()
    end = next((row for row, line in enumerate(lines) if not line.startswith("#")), len(lines))
    comment = " ".join(line.lstrip("#").strip() for line in lines[:end])
    operator = re.search(r"\bOperator: (\w+)\.yaml", comment)
    sentence = re.match(r".*?\.(?=\s|$)", comment)
    return ShippedFile(name, sentence[0] if sentence else comment, operator[1] if operator else None, file)


def file_of(text: str, shipped_folder: Folder, folder: str = "") -> str:
    """Return the path of the file that `text` names: an existing file, or a shipped one. `-` is the standard input.

    A relative path begins in `folder`, by default the current one. Raises HapticdError for a mere name that is neither.
    A path is returned even if the file does not exist.
    """
    if text == "-":
        return "/dev/stdin"
    path = os.path.join(folder, text)
    if os.path.exists(path) and not os.path.isdir(path):
        return path
    known = shipped(shipped_folder)
    if text in known:
        return known[text]
    what = shipped_folder.removesuffix("s")
    stem, ending = os.path.splitext(text)
    if os.path.dirname(text) or (ending and stem not in known):
        return path
    if stem in known:
        raise HapticdError(f"{text}: no such file; the shipped {what} of that name is called {stem}")
    near = near_names(text, list(known), _MAX_SUGGESTIONS)
    advice = f"did you mean {' or '.join(near)}?" if near else f"shipped: {', '.join(known)}"
    raise HapticdError(f"{printable(text)}: neither a file nor a shipped {what}; {advice}")
