"""What was sent from a file: what the daemon finds fault with in it is reported with file, line and column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from hapticd.base.errors import path_text
from hapticd.base.yaml_source import Json

Path = tuple[str | int, ...]


class Source(Protocol):
    """A document, or several merged into one."""

    @property
    def data(self) -> Json: ...

    def place(self, path: Sequence[str | int]) -> str:
        """`FILE:LINE:COLUMN`."""

    def own(self, path: Sequence[str | int]) -> Sequence[str | int]:
        """A path as it is in its file."""


class FromFile(dict[str, object]):
    """A value of params, or all of them, that stands at `root` of a document."""

    def __init__(self, value: Mapping[str, object], document: Source, root: Path = ()) -> None:
        super().__init__(value)
        self._document, self._root = document, root

    def place(self, where: str) -> str:
        """`FILE:LINE:COLUMN: KEY` of a place inside the value, given as the protocol does: `table.normal[0]`. A place
        that the file does not have is where the nearest one around it is."""
        node = self._document.data
        for element in self._root:
            node = _below(node, element)
        path, rest = list(self._root), where
        while rest:
            key = _first_of(rest, node)
            if key is None:
                break
            rest = rest[len(path_text((key,))) :].removeprefix(".")
            path.append(key)
            node = _below(node, key)
        text = path_text(self._document.own(path))
        if rest:
            text += rest if rest.startswith("[") or not text else f".{rest}"
        place = self._document.place(path)
        return f"{place}: {text}" if text else place


def _below(node: Json, key: str | int) -> Json:
    if isinstance(node, dict) and isinstance(key, str):
        return node.get(key)
    return node[key] if isinstance(node, list) and isinstance(key, int) else None


def _first_of(text: str, node: Json) -> str | int | None:
    """The key of `node` that a path begins with, written as path_text does."""
    keys: Sequence[str | int] = (
        [*node] if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    )
    found = [
        key for key in keys if text.startswith(begin := path_text((key,))) and text[len(begin) :][:1] in ("", ".", "[")
    ]
    return max(found, key=lambda key: len(path_text((key,))), default=None)


def placed(where: str, params: Mapping[str, object]) -> str:
    """A place inside params, in the file that it came from if there is one."""
    if isinstance(params, FromFile):
        return params.place(where)
    for name, value in params.items():
        if isinstance(value, FromFile) and where.startswith(name):
            rest = where[len(name) :]
            if rest[:1] in ("", ".", "["):
                return value.place(rest.removeprefix("."))
    return where
