"""Loads a study from a YAML file or by the name of a shipped one, and reports each fault with its line."""

from __future__ import annotations

import os
from collections.abc import Mapping

from pydantic import ValidationError

from hapticd.base.model import faults_of, plain
from hapticd.base.yaml_source import Document, load_path
from hapticd.config.document_kinds import refuse_other_kinds
from hapticd.config.shipped_files import file_of
from hapticd.experiment.display_faults import display_faults
from hapticd.experiment.faults import faults_between
from hapticd.experiment.key_paths import invalid_in, with_base
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
    data = document.mapping(Study.model_fields)
    given, base = with_base(document, data, "scene and materials", "change", "scene", "materials")
    try:
        study = Study.parsed(given)
    except ValidationError as error:
        raise invalid_in(document, base, faults_of(error)) from None
    faults = faults_between(study) or display_faults(study)
    if faults:
        raise invalid_in(document, base, faults)
    return study
