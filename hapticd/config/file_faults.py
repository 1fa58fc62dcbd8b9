"""Finds file, line and column of faults that the daemon reports in values read from files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from hapticd.base.errors import Path, path_of_text


class Source(Protocol):
    """A document, or several merged documents, that finds the place of a value in its file."""

    def where(self, path: Sequence[str | int]) -> str:
        """Return `FILE:LINE:COLUMN: KEY` of the value at `path`, or of the innermost existing value around it."""


class FromFile(dict[str, object]):
    """Params of a method, or a value in params, read from a document at the path `root`."""

    def __init__(self, value: Mapping[str, object], document: Source, root: Path = ()) -> None:
        super().__init__(value)
        self._document, self._root = document, root

    def place(self, path: Path) -> str:
        """Return `FILE:LINE:COLUMN: KEY` of the member at `path` of the value."""
        return self._document.where((*self._root, *path))


def placed(where: str, params: Mapping[str, object]) -> str:
    """Return the place in the file from which a value in params was read; without a file the path `where` itself."""
    path = path_of_text(where)
    if isinstance(params, FromFile):
        return params.place(path)
    value = params.get(str(path[0])) if path else None
    return value.place(path[1:]) if isinstance(value, FromFile) else where
