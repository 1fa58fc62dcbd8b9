"""The keys of fit.yaml, which sets the options of all fits in its folder and below.

A fit.yaml in a deeper folder overrides the keys that it sets.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, Literal, TypeAlias

from pydantic import Field, ValidationError

from hapticd.base.errors import InvalidError, Problem
from hapticd.base.model import Model, Stiffness, faults_of
from hapticd.base.yaml_source import MAX_YAML_BYTES, Document, load_bytes, read_file
from hapticd.config.document_kinds import refuse_other_kinds
from hapticd.fit.options import FitOptions
from hapticd.fit.recording import Kind

FIT_YAML: Final = "fit.yaml"
"""Name of the file with the fit options of a folder."""
Key: TypeAlias = str
KINDS_OF_KEY: Final[Mapping[Key, tuple[Kind, ...]]] = {
    "as": ("tap",),
    "attack": ("tap",),
    "law": ("tap",),
    "two_modes": ("tap",),
    "mode_table": ("tap",),
    "autoregressive": ("texture",),
}
"""For each key that not every kind of fit uses, the kinds that use it."""


class BatchFolder(Model):
    """The content of a fit.yaml: fit options."""

    kind: Literal["tap", "grooves", "texture", "puncture"] | None = Field(
        default=None, description="Kind of the recordings directly in the folder of a material."
    )
    stiffness_n_per_m: Stiffness | None = Field(
        default=None, description="Stiffness of the material if the recordings do not determine it; by default 800."
    )
    strict: bool | None = Field(
        default=None, description="Refuse a fit of which parts would be left out: a bad file, a clipped tap."
    )
    form: Literal["auto", "mode", "waveform"] | None = Field(
        default=None, alias="as", description="Form of a tap: a ringing mode, or the waveform of a pulse."
    )
    attack: Literal["coefficient", "first_peak"] | None = Field(
        default=None, description="Meaning of the slope of a tap in the material."
    )
    law: Literal["line", "power", "table"] | None = Field(
        default=None, description="Law of the amplitude of a tap over the speed."
    )
    two_modes: bool | None = Field(default=None, description="Fit two modes to a tap instead of one.")
    mode_table: bool | None = Field(
        default=None, description="Fit frequency and decay of a tap over the speed, instead of one of each."
    )
    autoregressive: bool | None = Field(
        default=None, description="Fit autoregressive models over speed and force to a texture."
    )


def key_of(field: str) -> Key:
    """Return the key in fit.yaml of a field of BatchFolder."""
    return BatchFolder.model_fields[field].alias or field


class FolderYaml:
    """A fit.yaml: its keys, and the line of each."""

    def __init__(self, path: str, shown: str) -> None:
        """Read a fit.yaml; `shown` is its name in errors. Raises InvalidError, or HapticdError if it cannot be read."""
        document = load_bytes(read_file(path, MAX_YAML_BYTES), shown)
        refuse_other_kinds(document)
        self._document: Document = document
        given = document.mapping(map(key_of, BatchFolder.model_fields))
        try:
            self.folder = BatchFolder.parsed(given)
        except ValidationError as error:
            raise InvalidError(document.problem(where, text) for where, text in faults_of(error)) from None

    @property
    def keys(self) -> list[Key]:
        """The keys that the fit.yaml sets."""
        return [key_of(field) for field in BatchFolder.model_fields if field in self.folder.model_fields_set]

    def problem(self, key: Key, text: str) -> Problem:
        """Return a fault with the text `text` at the line of a key."""
        return self._document.problem((key,), text)


def merged(folders: Iterable[BatchFolder]) -> BatchFolder:
    """Return the fit options that hold in the last of `folders`, each of which contains the next folder."""
    found: dict[str, object] = {}
    for folder in folders:
        found |= {key_of(field): getattr(folder, field) for field in folder.model_fields_set}
    return BatchFolder.parsed(found)


def options_of(folder: BatchFolder, kind: Kind) -> FitOptions:
    """Return the options of `folder` for a fit of kind `kind`."""

    def is_used(field: str) -> bool:
        return kind in KINDS_OF_KEY[key_of(field)]

    fields = ("form", "attack", "law", "two_modes", "mode_table", "autoregressive")
    return FitOptions(**{field: getattr(folder, field) for field in fields if is_used(field)})
