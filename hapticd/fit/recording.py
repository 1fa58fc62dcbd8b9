"""Recordings of an instrumented stylus: read, checked, and converted to SI units on a uniform clock.

.csv  columns, named in the first line; separated by commas, semicolons, tabs or blanks
.npz  arrays by name, as numpy.savez writes them; `rate_hz` and `speed_m_per_s` may be single numbers
.wav  channels, named 1, 2 and so on; full scale is 1

`FILE.yaml` in the same folder (`tap1.csv.yaml` for `tap1.csv`) has the columns, their units and the sampling rate.
Without it, columns have the names of COLUMN_OF and SI units. Only the columns that are used are read, and nothing in a
file is executed.
"""

from __future__ import annotations

import hashlib
import io
import os
from dataclasses import dataclass
from typing import Annotated, Final, Literal, TypeAlias

import numpy as np
from pydantic import Field, ValidationError, model_validator

from hapticd.analysis.recordings.clock import (
    COLUMN_OF,
    MAX_RATE_MISMATCH,
    MAX_RECORDING_RATE_HZ,
    MIN_RECORDING_RATE_HZ,
    uniform,
)
from hapticd.analysis.recordings.files import (
    MAX_RECORDING_BYTES,
    TABLE_READERS,
    Table,
    csv_table,
    ending_of,
    file_bytes,
)
from hapticd.analysis.recordings.sensor import Sensor
from hapticd.analysis.statistics import Floats
from hapticd.base.errors import HapticdError, InvalidError, Problem, known_names, short_name, shown
from hapticd.base.files import write_atomically
from hapticd.base.model import Model, faults_of
from hapticd.base.units import UNITS_OF, ColumnUnitError, Quantity, factor_of, unit_of
from hapticd.base.yaml_source import MAX_YAML_BYTES as MAX_YAML_BYTES
from hapticd.base.yaml_source import load_bytes, printable
from hapticd.config.document_kinds import refuse_documents

Kind: TypeAlias = Literal["tap", "grooves", "texture", "puncture"]
"""Kind of a recording, and of the fit for it."""
Rate: TypeAlias = Annotated[float, Field(ge=MIN_RECORDING_RATE_HZ, le=MAX_RECORDING_RATE_HZ)]


_MEASURED_QUANTITIES: Final[tuple[Quantity, ...]] = ("acceleration", "force", "position", "tangential_position")
"""Quantities of which a recording has at least one."""


class RecordingError(HapticdError):
    """A recording cannot be used; the message is one line with the recording's name and the reason."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name, self.reason = name, reason


class FatalRecordingError(RecordingError):
    """A fit cannot leave the recording out: its file cannot be opened, or its columns or a unit are not known."""


class _UnknownColumnsError(ValueError):
    """A file has none of the columns that a recording needs."""


class RecordedColumn(Model):
    """Column and unit of a quantity in the file of a recording."""

    column: str | int = Field(description="Its name; of a file without names its number, from 1.")
    unit: str | None = Field(default=None, description="Its unit; without it that of the file, else the SI unit.")
    scale: float | None = Field(
        default=None, description="Factor of its numbers, which are in `unit` after it; 1 without it."
    )

    @model_validator(mode="before")
    @classmethod
    def _with_key(cls, data: object) -> object:
        if isinstance(data, str | int):
            raise ValueError(f"should be a mapping such as {{column: {short_name(str(data))}}}, is {shown(data)}")
        return data


class RecordingSidecar(Model):
    """The YAML file that describes a recording."""

    rate_hz: Rate | None = Field(default=None, description="Sampling rate; without it there is a column of times.")
    skip_lines: int = Field(
        default=0, ge=0, le=1_000_000, description="Number of lines of a .csv, from its first, that are not read."
    )
    columns: dict[Quantity, RecordedColumn] = Field(
        default_factory=dict, description="Which columns there are; without it, those with the usual names."
    )
    speed_m_per_s: float | list[float] | None = Field(
        default=None, description="Speed of the recording, or of each tap in it."
    )
    sensor: Sensor | None = Field(default=None, description="The accelerometer; taps are corrected for it.")


@dataclass(frozen=True, slots=True)
class Source:
    """The file of a recording and its hash, which is empty if the recording was not read from a file."""

    path: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Recording:
    """Quantities of a recording: arrays (n,) at the same uniform times, without NaN; None if not recorded."""

    name: str
    rate_hz: float
    acceleration_m_per_s2: Floats | None
    force_n: Floats | None
    position_m: Floats | None
    """Position along the surface's normal."""
    tangential_position_m: Floats | None
    speed_m_per_s: float | Floats | None
    """One speed for the recording, one for each tap, or (n,) for the samples."""
    source: Source
    sensor: Sensor | None = None
    """The accelerometer, if it is known."""
    gaps: tuple[tuple[int, int], ...] = ()
    """First sample and last sample + 1 of each gap in the times; the columns are interpolated linearly there."""
    notes: tuple[str, ...] = ()
    """What the user should know about how the file was read, without its name."""


def load(path: str | os.PathLike[str], known_as: str | None = None) -> Recording:
    """Read the recording at this path; `known_as` replaces the path in the result and in errors.

    Raises RecordingError (one line), or InvalidError for faults in its YAML file or a YAML file of another command.
    """
    name = os.fspath(path)
    own_name = name if known_as is None else known_as
    shown = printable(own_name)
    refuse_documents(name)
    try:
        content = file_bytes(name, MAX_RECORDING_BYTES)
    except ValueError as error:
        raise FatalRecordingError(shown, str(error)) from None
    try:
        sidecar = _sidecar(name, own_name)
        table = _table(own_name, content, sidecar)
        found, rounding_s, notes = _quantities(table, sidecar, f"{shown}.yaml")
        rate_hz = table.rate_hz
        if (
            rate_hz is not None
            and sidecar.rate_hz is not None
            and abs(rate_hz / sidecar.rate_hz - 1) > MAX_RATE_MISMATCH
        ):
            raise ValueError(
                f"the rate is {rate_hz:g} Hz in the file, {sidecar.rate_hz:g} Hz in the YAML: make them equal"
            )
        even, rate_hz, gaps = uniform(found, rate_hz if sidecar.rate_hz is None else sidecar.rate_hz, rounding_s)
    except (ColumnUnitError, _UnknownColumnsError) as error:
        raise FatalRecordingError(shown, str(error)) from None
    except ValueError as error:
        raise RecordingError(shown, str(error)) from None
    except MemoryError:
        raise RecordingError(shown, "not enough memory: cut the recording into several files") from None
    speed: float | Floats | None = even.get("speed")
    if isinstance(speed, np.ndarray) and speed.size == 1:
        speed = float(speed[0])
    given = sidecar.speed_m_per_s
    if given is not None:
        speed = np.array(given, dtype=np.float64) if isinstance(given, list) else float(given)
    return Recording(
        name=shown,
        rate_hz=rate_hz,
        acceleration_m_per_s2=even.get("acceleration"),
        force_n=even.get("force"),
        position_m=even.get("position"),
        tangential_position_m=even.get("tangential_position"),
        speed_m_per_s=speed,
        source=Source(own_name, hashlib.sha256(content).hexdigest()),
        sensor=sidecar.sensor,
        gaps=gaps,
        notes=notes,
    )


def npz_of(recording: Recording) -> bytes:
    """Return the bytes of a .npz file of a recording, which `load` reads without a YAML file."""
    arrays: dict[str, Floats] = {"rate_hz": np.array(recording.rate_hz)}
    for name in COLUMN_OF.values():
        values = getattr(recording, name, None)
        if values is not None:
            arrays[name] = np.asarray(values, dtype=np.float64)
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    return content.getvalue()


def save(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as .npz, replacing an existing file; raise HapticdError if it cannot be written."""
    write_atomically(os.fspath(path), npz_of(recording), overwrite=True)


# ---- The YAML file ---------------------------------------------------------------------------------------------------


def _sidecar(name: str, own_name: str) -> RecordingSidecar:
    path, shown = f"{name}.yaml", f"{own_name}.yaml"
    # A broken link is a YAML file that cannot be read, not a missing one.
    if not os.path.lexists(path):
        return RecordingSidecar()
    try:
        content = file_bytes(path, MAX_YAML_BYTES)
    except ValueError as error:
        raise HapticdError(f"{printable(shown)}: {error}") from None
    document = load_bytes(content, shown)
    if document.data is None:
        return RecordingSidecar()
    try:
        sidecar = RecordingSidecar.parsed(document.data)
    except ValidationError as error:
        raise InvalidError(Problem(document.where(where), text) for where, text in faults_of(error)) from None
    problems = [
        Problem(
            document.where(("columns", quantity, "unit")),
            f"unknown unit of {quantity}, {known_names(unit, UNITS_OF[quantity])}",
        )
        for quantity, column in sidecar.columns.items()
        if (unit := column.unit) is not None and unit_of(unit, quantity) is None
    ]
    problems += [
        Problem(document.where(("columns", quantity, "scale")), "must not be 0")
        for quantity, column in sidecar.columns.items()
        if column.scale == 0
    ]
    if sidecar.speed_m_per_s is not None and "speed" in sidecar.columns:
        problems.append(Problem(document.where(("speed_m_per_s",)), "duplicate of columns.speed: leave one out"))
    if problems:
        raise InvalidError(problems)
    return sidecar


# ---- The files -----------------------------------------------------------------------------------------------------


def _table(name: str, content: bytes, sidecar: RecordingSidecar) -> Table:
    ending = ending_of(name)
    if ending not in TABLE_READERS:
        raise ValueError("the name of a recording must end in .csv, .npz or .wav")
    if ending == ".wav" and not sidecar.columns:
        raise ValueError(f"a .wav needs {printable(name)}.yaml, with its columns and their scale")
    if ending == ".csv":
        return csv_table(
            content, sidecar.skip_lines, f"set in {printable(name)}.yaml skip_lines, the number of lines to leave out"
        )
    if sidecar.skip_lines:
        raise ValueError(f"skip_lines in {printable(name)}.yaml is for a .csv, this file has no lines")
    return TABLE_READERS[ending](content)


def _quantities(
    table: Table, sidecar: RecordingSidecar, where: str
) -> tuple[dict[Quantity, Floats], float, tuple[str, ...]]:
    """Return the quantities in SI units, the rounding of the times in s, and notes for the user."""
    wanted = sidecar.columns or {
        quantity: RecordedColumn(column=name) for quantity, name in COLUMN_OF.items() if name in table.names
    }
    unfit = [name for name in COLUMN_OF.values() if name in table.others] if not sidecar.columns else []
    if unfit:
        raise ValueError(f"{unfit[0]} {table.others[unfit[0]]}: name other columns in {where}")
    if not set(wanted) & set(_MEASURED_QUANTITIES):
        if sidecar.columns:
            raise ValueError(f"{where}: columns has neither acceleration nor force nor position")
        known = ", ".join(COLUMN_OF[quantity] for quantity in _MEASURED_QUANTITIES)
        has = known_names("", map(short_name, [*table.names, *table.others])).removeprefix("known: ")
        raise _UnknownColumnsError(
            f"none of the columns {known}; the file has {has}: name the columns in {where}, such as "
            "columns: {acceleration: {column: NAME, unit: g}}"
        )
    places = {quantity: table.index_of(column.column) for quantity, column in wanted.items()}
    # `uniform` reports values that are too large or NaN.
    with np.errstate(all="ignore"):
        read = dict(zip(places, table.read(list(places.values())), strict=True))
    found: dict[Quantity, Floats] = {}
    rounding = 0.0
    notes = [table.note] if table.note else []
    for quantity, column in wanted.items():
        index = places[quantity]
        stated = table.stated_unit(index, quantity)
        unit = None if column.unit is None else unit_of(column.unit, quantity)
        factor = factor_of(quantity, stated, unit, column.scale, where)
        if unit is None and stated is not None and stated.is_converted(quantity):
            notes.append(f"the {quantity} is in {unit_of(stated.text, quantity)} by {stated.source}")
        with np.errstate(all="ignore"):
            found[quantity] = read[quantity] * factor
            if quantity == "time":
                rounding = abs(factor) * table.rounded(index, read[quantity])
    return found, rounding, tuple(notes)
