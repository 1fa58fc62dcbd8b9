"""What was sent from a file: what the daemon finds fault with in it is reported with file, line and column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from hapticd.base.errors import Path, path_of_text


class Source(Protocol):
    """A document, or several merged into one."""

    def where(self, path: Sequence[str | int]) -> str:
        """`FILE:LINE:COLUMN: KEY` of the part at `path`, or of the nearest one around it that the file has."""


class FromFile(dict[str, object]):
    """A value of params, or all of them, that stands at `root` of a document."""

    def __init__(self, value: Mapping[str, object], document: Source, root: Path = ()) -> None:
        super().__init__(value)
        self._document, self._root = document, root

    def place(self, path: Path) -> str:
        """Where a part of the value stands in the file."""
        return self._document.where((*self._root, *path))


def placed(where: str, params: Mapping[str, object]) -> str:
    """A place inside params, in the file that it came from if there is one."""
    path = path_of_text(where)
    if isinstance(params, FromFile):
        return params.place(path)
    value = params.get(str(path[0])) if path else None
    return value.place(path[1:]) if isinstance(value, FromFile) else where
