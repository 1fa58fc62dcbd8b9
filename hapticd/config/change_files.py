"""Materials and a scene from files, for one change of a running daemon.

Files are merged like those of a configuration: a later file overrides key by key, but replaces a material or an object
completely. A file holds `materials`, `scene` or both, or the content of one of these keys.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field, ValidationError

from hapticd.base.errors import InvalidError, Problem
from hapticd.base.model import Model, Name, faults_of
from hapticd.base.yaml_source import Document
from hapticd.config.configuration import Merged, load_all
from hapticd.config.document_kinds import kind_of, refuse_other_kinds
from hapticd.config.file_faults import FromFile
from hapticd.config.materials import MAX_MATERIALS, Material
from hapticd.config.scene import Scene
from hapticd.config.shipped_files import file_of


class _ChangeParts(Model):
    materials: dict[Name, Material] | None = Field(default=None, max_length=MAX_MATERIALS)
    scene: Scene | None = None


@dataclass(frozen=True, slots=True)
class ChangeFiles:
    """Validated materials and scene from files, with file and line of each value; None if no file has the section."""

    materials: FromFile | None
    scene: FromFile | None


def load_change(paths: Sequence[str | os.PathLike[str]]) -> ChangeFiles:
    """Load new materials and a new scene from files; a shipped scene may be given by its name.

    Whether the scene's materials exist is not checked here: the daemon may have others. Raises InvalidError, which
    names every fault with file and line, and HapticdError for a file that cannot be read.
    """
    return change_of(load_all([file_of(os.fspath(path), "scenes") for path in paths]))


def change_of(documents: Sequence[Document]) -> ChangeFiles:
    """Merge documents, and validate the materials and the scene in them. Raises InvalidError."""
    merged = Merged()
    for document in map(_as_change, documents):
        assert isinstance(document.data, dict)
        merged.add(document, document.data)
    try:
        change = _ChangeParts.parsed(merged.data)
    except ValidationError as error:
        raise merged.invalid(faults_of(error)) from None
    materials, scene = change.materials, change.scene
    given = None if materials is None else {name: material.to_dict() for name, material in materials.items()}
    return ChangeFiles(
        None if given is None else FromFile(given, merged, ("materials",)),
        None if scene is None else FromFile(scene.to_dict(), merged, ("scene",)),
    )


def _as_change(document: Document) -> Document:
    """Return a document with the keys `materials` and `scene`. Raises InvalidError for a document of another kind."""
    refuse_other_kinds(document, "change", "scene", "bare scene", "materials", "bare materials")
    kind = kind_of(document.data)
    if kind is None:
        text = "holds neither materials nor a scene; known keys: materials, scene"
        raise InvalidError([Problem(document.where(()), text)])
    return document.below(kind.removeprefix("bare ")) if kind.startswith("bare ") else document
