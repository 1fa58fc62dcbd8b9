"""Loads a study from a YAML file or by the name of a shipped one, and reports each fault with its line."""

from __future__ import annotations

import os
from collections.abc import Mapping

from pydantic import ValidationError

from hapticd.base.errors import InvalidError, Path, Problem, shown
from hapticd.base.model import faults_of, plain
from hapticd.base.yaml_source import Document, Json, load_path
from hapticd.config.document_kinds import kind_of, refuse_other_kinds
from hapticd.config.shipped_files import file_of
from hapticd.experiment.display_faults import display_faults
from hapticd.experiment.faults import Fault, faults_between
from hapticd.experiment.key_paths import BASE_KEY, expanded, invalid_in
from hapticd.experiment.keys import Study

__all__ = ["Study", "load_study", "study_of"]


def load_study(path_or_name: str | os.PathLike[str]) -> Study:
    """Load and validate a study from a file, or by the name of a shipped one.

    If the key `base` names another file, the returned study contains scene and materials of that file.

    Raises InvalidError with the file, line and key of every fault and a correction, and HapticdError if a file cannot
    be read.
    """
    document = load_path(file_of(os.fspath(path_or_name), "experiments"))
    refuse_other_kinds(document, "study")
    return study_of_document(document)


def study_of(data: Mapping[str, object]) -> Study:
    """Validate a study that is given as a mapping. The path of a base file is relative to the current folder.

    Raises InvalidError with every fault, and HapticdError if a base file cannot be read.
    """
    return study_of_document(Document(plain(data)))


def study_of_document(document: Document) -> Study:
    """Validate a study in a YAML document. Raises InvalidError with the file, line and key of every fault."""
    data = document.data
    if not isinstance(data, dict):
        text = "is empty" if data is None else "must be a mapping"
        known = ", ".join(Study.model_fields)
        raise InvalidError([Problem(document.where(()), f"{text}; known keys: {known}")])
    given, base = _with_base(document, data)
    try:
        study = Study.parsed(given)
    except ValidationError as error:
        raise invalid_in(document, base, faults_of(error)) from None
    faults = faults_between(study) or display_faults(study)
    if faults:
        raise invalid_in(document, base, faults)
    return study


def _with_base(document: Document, data: dict[str, Json]) -> tuple[dict[str, Json], Document | None]:
    """Return a study's data with a base file's name replaced by its content, and the base file or None."""
    given = data.get(BASE_KEY)
    source: Document | None = None
    if isinstance(given, str):
        source = _base_file(document, given)
        given = source.data
    if not isinstance(given, dict):
        if given is None and BASE_KEY not in data:
            given = {}
        else:
            text = f"must be scene and materials, or the name of a file or of a shipped scene, is {shown(given)}"
            raise InvalidError([document.problem((BASE_KEY,), text)])
    try:
        base = expanded(given)
    except InvalidError as error:
        base_faults: list[Fault] = [((BASE_KEY, *_path(each.where)), each.problem) for each in error.problems]
        raise invalid_in(document, source, base_faults) from None
    return {**data, BASE_KEY: base}, source


def _path(where: str) -> Path:
    """Convert `materials.NAME`, the place of an error in a configuration, to a path of keys."""
    section, _, name = where.partition(".")
    return section, name.strip('"')


def _base_file(document: Document, name: str) -> Document:
    """Load the base of a study, scene and materials, from a file in the study's folder or a shipped scene."""
    source = load_path(file_of(name, "scenes", document.folder))
    refuse_other_kinds(source, "change", "scene", "bare scene", "materials")
    if not isinstance(source.data, dict):
        raise InvalidError([Problem(source.where(()), "must have a scene, materials or both")])
    if kind_of(source.data) == "bare scene":
        source = source.below("scene")
        assert isinstance(source.data, dict)
    return source
