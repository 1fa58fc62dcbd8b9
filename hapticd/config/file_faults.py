"""Values that were read from a file and sent to the daemon: its faults get file, line and column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from hapticd.base.errors import Path, path_of_text


class Source(Protocol):
    """A document, or several that were merged."""

    def where(self, path: Sequence[str | int]) -> str:
        """Return `FILE:LINE:COLUMN: KEY` of the value at `path`, or of the nearest one that contains it."""


class FromFile(dict[str, object]):
    """A value of params, or all params, that was read at `root` of a document."""

    def __init__(self, value: Mapping[str, object], document: Source, root: Path = ()) -> None:
        super().__init__(value)
        self._document, self._root = document, root

    def place(self, path: Path) -> str:
        """Return the place of a part of the value in the file."""
        return self._document.where((*self._root, *path))


def placed(where: str, params: Mapping[str, object]) -> str:
    """Return a place inside params as its place in the file that it was read from, or unchanged without a file."""
    path = path_of_text(where)
    if isinstance(params, FromFile):
        return params.place(path)
    value = params.get(str(path[0])) if path else None
    return value.place(path[1:]) if isinstance(value, FromFile) else where
