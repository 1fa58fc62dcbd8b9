"""Reads a study: a YAML file, or the name of one that ships, with every fault at its line."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Final

from pydantic import ValidationError

from hapticd.base.errors import InvalidError, Path, Problem, shown
from hapticd.base.model import faults_of, plain
from hapticd.base.yaml_source import Document, Json, load_path
from hapticd.config.document_kinds import kind_of, refuse_other_kinds
from hapticd.config.shipped_files import file_of
from hapticd.experiment.display_faults import display_faults
from hapticd.experiment.faults import Fault, faults_between
from hapticd.experiment.key_paths import expanded
from hapticd.experiment.keys import Study

__all__ = ["Study", "load_study", "study_of"]

_BASE: Final = "base"


def load_study(path_or_name: str | os.PathLike[str]) -> Study:
    """A validated study, from a file or by the name of one that ships.

    The `base` of the study that is returned holds scene and materials themselves, also where the file names another
    file: to_dict() of it is a study that needs no other file.

    Raises InvalidError, which names every fault with file, line, key and what would be right; HapticdError for a file
    that cannot be read.
    """
    document = load_path(file_of(os.fspath(path_or_name), "experiments"))
    refuse_other_kinds(document, "study")
    return study_of_document(document)


def study_of(data: Mapping[str, object]) -> Study:
    """As load_study, from a mapping; the path of a base file is relative to the current folder."""
    return study_of_document(Document(plain(data)))


def study_of_document(document: Document) -> Study:
    """As load_study, of a document that was read."""
    data = document.data
    if not isinstance(data, dict):
        text = "is empty" if data is None else "must be a mapping"
        known = ", ".join(Study.model_fields)
        raise InvalidError([Problem(document.where(()), f"{text}; known keys: {known}")])
    given, base = _with_base(document, data)
    try:
        study = Study.parsed(given)
    except ValidationError as error:
        raise _invalid(document, faults_of(error), base) from None
    faults = faults_between(study) or display_faults(study)
    if faults:
        raise _invalid(document, faults, base)
    return study


def _invalid(document: Document, faults: list[Fault], base: Document | None) -> InvalidError:
    """Faults of a base that is another file are placed there."""
    if base is None:
        return InvalidError(document.problem(path, text) for path, text in faults)
    return InvalidError(
        base.problem(path[1:], text) if path[:1] == (_BASE,) and len(path) > 1 else document.problem(path, text)
        for path, text in faults
    )


def _with_base(document: Document, data: dict[str, Json]) -> tuple[dict[str, Json], Document | None]:
    """The data with scene and materials in the place of a name, and what they were read from if that is a file."""
    given = data.get(_BASE)
    source: Document | None = None
    if isinstance(given, str):
        source = _base_file(document, given)
        given = source.data
    if not isinstance(given, dict):
        if given is None and _BASE not in data:
            given = {}
        else:
            text = f"must be scene and materials, or the name of a file or of a shipped scene, is {shown(given)}"
            raise InvalidError([document.problem((_BASE,), text)])
    try:
        whole = expanded(given)
    except InvalidError as error:
        root: Path = () if source else (_BASE,)
        place = (source or document).problem
        raise InvalidError(
            place((*root, *_path(problem.where)), problem.problem) for problem in error.problems
        ) from None
    return {**data, _BASE: whole}, source


def _path(where: str) -> Path:
    """Of `materials.NAME`, as expanded reports it."""
    section, _, name = where.partition(".")
    return section, name.strip('"')


def _base_file(document: Document, name: str) -> Document:
    """A file beside the study, or a shipped scene."""
    beside = FilePath(document.name or "").parent / name
    source = load_path(beside if beside.is_file() else file_of(name, "scenes"))
    refuse_other_kinds(source, "change", "scene", "bare scene", "materials")
    if not isinstance(source.data, dict):
        raise InvalidError([Problem(source.where(()), "must hold a scene, materials or both")])
    if kind_of(source.data) == "bare scene":
        source = source.below("scene")
        assert isinstance(source.data, dict)
    return source
