"""The keys of fit.yaml, which says how the recordings of a folder, and of folders in it, are fitted.

A key holds for all fits below the folder that take it. A fit.yaml nearer to the recordings overrides it, key by key.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, Literal, TypeAlias

from pydantic import Field, ValidationError

from hapticd.base.errors import InvalidError, Problem
from hapticd.base.model import Model, Stiffness, faults_of
from hapticd.base.yaml_source import MAX_BYTES, Document, load_bytes, read_file
from hapticd.config.document_kinds import refuse_other_kinds
from hapticd.fit.options import FitOptions
from hapticd.fit.recording import Kind

FIT_YAML: Final = "fit.yaml"
Key: TypeAlias = str
KINDS_OF_KEY: Final[Mapping[Key, tuple[Kind, ...]]] = {
    "as": ("tap",),
    "attack": ("tap",),
    "law": ("tap",),
    "two_modes": ("tap",),
    "mode_table": ("tap",),
    "autoregressive": ("texture",),
}
"""Keys that not every kind of fit takes."""


class BatchFolder(Model):
    """fit.yaml: how recordings are fitted."""

    kind: Literal["tap", "grooves", "texture", "puncture"] | None = Field(
        default=None, description="Of the recordings that stand in a material's folder itself."
    )
    stiffness_n_per_m: Stiffness | None = Field(
        default=None, description="Of the material if the recordings do not determine it; 800 without it."
    )
    strict: bool | None = Field(default=None, description="Refuse what would be left out: a bad file, a clipped tap.")
    form: Literal["auto", "mode", "waveform"] | None = Field(
        default=None, alias="as", description="Of taps: a mode that rings, or a waveform of a pulse."
    )
    attack: Literal["coefficient", "first_peak"] | None = Field(
        default=None, description="Of taps: what the slope in the material means."
    )
    law: Literal["line", "power", "table"] | None = Field(
        default=None, description="Of taps: how the amplitude of the material follows the speed."
    )
    two_modes: bool | None = Field(default=None, description="Of taps: two modes in the material, or one.")
    mode_table: bool | None = Field(
        default=None, description="Of taps: frequency and decay over the speed, or one of each."
    )
    autoregressive: bool | None = Field(
        default=None, description="Of textures: autoregressive models over speed and force."
    )


def key_of(field: str) -> Key:
    """How a field is written."""
    return BatchFolder.model_fields[field].alias or field


class FolderYaml:
    """One fit.yaml: what it says, and where each key stands."""

    def __init__(self, path: str, shown: str) -> None:
        """Reads it; `shown` is its name in errors. Raises InvalidError, and HapticdError where it cannot be read."""
        document = load_bytes(read_file(path, MAX_BYTES), shown)
        refuse_other_kinds(document)
        if not isinstance(document.data, dict):
            text = "is empty" if document.data is None else "must be a mapping"
            keys = ", ".join(map(key_of, BatchFolder.model_fields))
            raise InvalidError([Problem(document.where(()), f"{text}; known keys: {keys}")])
        self._document: Document = document
        try:
            self.folder = BatchFolder.parsed(document.data)
        except ValidationError as error:
            raise InvalidError(document.problem(where, text) for where, text in faults_of(error)) from None

    @property
    def keys(self) -> list[Key]:
        """Those that are given."""
        return [key_of(field) for field in BatchFolder.model_fields if field in self.folder.model_fields_set]

    def problem(self, key: Key, text: str) -> Problem:
        """A fault of a key."""
        return self._document.problem((key,), text)


def merged(folders: Iterable[BatchFolder]) -> BatchFolder:
    """What holds below several folders, the outermost first."""
    found: dict[str, object] = {}
    for folder in folders:
        found |= {key_of(field): getattr(folder, field) for field in folder.model_fields_set}
    return BatchFolder.parsed(found)


def options_of(folder: BatchFolder, kind: Kind) -> FitOptions:
    """The options of a fit of this kind."""

    def taken(field: str) -> bool:
        return kind in KINDS_OF_KEY[key_of(field)]

    fields = ("form", "attack", "law", "two_modes", "mode_table", "autoregressive")
    return FitOptions(**{field: getattr(folder, field) for field in fields if taken(field)})
