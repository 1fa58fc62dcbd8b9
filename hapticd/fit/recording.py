"""Recordings of an instrumented stylus: read, put into SI units and onto a uniform clock, checked.

.csv  columns, named in the first line; separated by commas, semicolons, tabs or blanks
.npz  arrays by name, as numpy.savez writes them; `rate_hz` and `speed_m_per_s` may be single numbers
.wav  channels, named 1, 2 and so on; full scale is 1

`FILE.yaml` beside a recording (`tap1.csv.yaml`) says what its columns are, in which units, and at which rate. Without
it columns are known by the names of NAMES, which are in SI units. Of a file only the columns that are used are read,
and nothing of what is in it is ever executed.
"""

from __future__ import annotations

import hashlib
import io
import os
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, ValidationError

from hapticd.analysis.recordings.clock import (
    COLUMN_OF,
    MAX_RATE_MISMATCH,
    MAX_RECORDING_RATE_HZ,
    MIN_RECORDING_RATE_HZ,
    UNITS_OF,
    Quantity,
    uniform,
)
from hapticd.analysis.recordings.files import (
    MAX_RECORDING_BYTES,
    TABLE_READERS,
    Table,
    ending_of,
    file_bytes,
    short_name,
    shown_name,
)
from hapticd.analysis.recordings.sensor import Sensor
from hapticd.analysis.statistics import Floats
from hapticd.base.errors import HapticdError, InvalidError, Problem, known_names
from hapticd.base.files import write_whole
from hapticd.base.model import Model, faults_of
from hapticd.base.yaml_source import MAX_YAML_BYTES as MAX_YAML_BYTES
from hapticd.base.yaml_source import load_bytes, one_line
from hapticd.config.document_kinds import refuse_documents

Kind: TypeAlias = Literal["tap", "grooves", "texture", "puncture"]
"""What a recording is of."""
Rate: TypeAlias = Annotated[float, Field(ge=MIN_RECORDING_RATE_HZ, le=MAX_RECORDING_RATE_HZ)]


class RecordingError(HapticdError):
    """A recording that cannot be taken as it is; one line that says which and why."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name, self.reason = name, reason


class NoRecordingError(RecordingError):
    """There is no file that can be opened."""


class RecordedColumn(Model):
    """Where a quantity stands in the file, and in which unit."""

    column: str | int = Field(description="Its name; of a file without names its number, from 1.")
    unit: str | None = Field(default=None, description="Its unit; the SI unit without it.")
    scale: float = Field(default=1.0, description="What its numbers are multiplied by, before the unit.")


class RecordingSidecar(Model):
    """The YAML beside a recording."""

    rate_hz: Rate | None = Field(default=None, description="Sampling rate; without it there is a column of times.")
    columns: dict[Quantity, RecordedColumn] = Field(
        default_factory=dict, description="Which columns there are; without it, those with the usual names."
    )
    speed_m_per_s: float | list[float] | None = Field(
        default=None, description="Speed of the whole recording, or of each tap in it."
    )
    sensor: Sensor | None = Field(default=None, description="The accelerometer; taps are corrected for it.")


@dataclass(frozen=True, slots=True)
class Source:
    """The file that a recording was read from, or what else it came from, with an empty hash."""

    path: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Recording:
    """Arrays (n,), sampled uniformly and together, without NaN; None is what was not recorded."""

    name: str
    rate_hz: float
    acceleration_m_per_s2: Floats | None
    force_n: Floats | None
    position_m: Floats | None
    """Along the surface's normal."""
    tangential_position_m: Floats | None
    speed_m_per_s: float | Floats | None
    """One for all, one a tap, or (n,)."""
    source: Source
    sensor: Sensor | None = None
    """The accelerometer, where it is known."""
    gaps: tuple[tuple[int, int], ...] = ()
    """First sample and the one after the last of each stretch in which the times have none: the columns hold straight
    lines there."""


def load(path: str | os.PathLike[str], known_as: str | None = None) -> Recording:
    """Reads a recording. `known_as` stands for its path in the result and in errors, instead of the path itself.

    Raises RecordingError (one line), or InvalidError for faults in the YAML beside it and for a YAML file that is for
    another command."""
    name = os.fspath(path)
    own_name = name if known_as is None else known_as
    shown = one_line(own_name)
    refuse_documents(name)
    try:
        content = file_bytes(name, MAX_RECORDING_BYTES)
    except ValueError as error:
        raise NoRecordingError(shown, str(error)) from None
    try:
        beside = _beside(name, own_name)
        table = _table(own_name, content, bool(beside.columns))
        found, rounding_s, rate_hz = _quantities(table, beside, f"{shown}.yaml")
        if rate_hz is not None and beside.rate_hz is not None and abs(rate_hz / beside.rate_hz - 1) > MAX_RATE_MISMATCH:
            raise ValueError(f"the file says {rate_hz:g} Hz, the YAML says {beside.rate_hz:g} Hz: which is right?")
        even, rate_hz, gaps = uniform(found, rate_hz if beside.rate_hz is None else beside.rate_hz, rounding_s)
    except ValueError as error:
        raise RecordingError(shown, str(error)) from None
    except MemoryError:
        raise RecordingError(shown, "there is not enough memory for it: cut it into several files") from None
    speed: float | Floats | None = even.get("speed")
    if isinstance(speed, np.ndarray) and speed.size == 1:
        speed = float(speed[0])
    given = beside.speed_m_per_s
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
        sensor=beside.sensor,
        gaps=gaps,
    )


def npz_of(recording: Recording) -> bytes:
    """A recording as a .npz, which `load` reads without a YAML."""
    arrays: dict[str, Floats] = {"rate_hz": np.array(recording.rate_hz)}
    for name in COLUMN_OF.values():
        values = getattr(recording, name, None)
        if values is not None:
            arrays[name] = np.asarray(values, dtype=np.float64)
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    return content.getvalue()


def save(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Writes a recording as .npz, in place of a file that is there. Raises HapticdError where it cannot."""
    write_whole(os.fspath(path), npz_of(recording), overwrite=True)


# ---- The YAML beside it ---------------------------------------------------------------------------------------------


def _beside(name: str, own_name: str) -> RecordingSidecar:
    path, shown = f"{name}.yaml", f"{own_name}.yaml"
    # A link that leads nowhere is a YAML that cannot be read, and not none.
    if not os.path.lexists(path):
        return RecordingSidecar()
    try:
        content = file_bytes(path, MAX_YAML_BYTES)
    except ValueError as error:
        raise HapticdError(f"{one_line(shown)}: {error}") from None
    document = load_bytes(content, shown)
    if document.data is None:
        return RecordingSidecar()
    try:
        beside = RecordingSidecar.parsed(document.data)
    except ValidationError as error:
        raise InvalidError(Problem(document.where(where), text) for where, text in faults_of(error)) from None
    problems = [
        Problem(
            document.where(("columns", quantity, "unit")),
            f"unknown unit of {quantity}, {known_names(unit, UNITS_OF[quantity])}",
        )
        for quantity, column in beside.columns.items()
        if (unit := column.unit) is not None and _spelt(unit) not in UNITS_OF[quantity]
    ]
    problems += [
        Problem(document.where(("columns", quantity, "scale")), "is 0, which leaves nothing")
        for quantity, column in beside.columns.items()
        if column.scale == 0
    ]
    if beside.speed_m_per_s is not None and "speed" in beside.columns:
        problems.append(Problem(document.where(("speed_m_per_s",)), "is given as a column, too: leave one out"))
    if problems:
        raise InvalidError(problems)
    return beside


def _spelt(unit: str) -> str:
    """A unit as UNITS_OF spells it; in brackets or not, with an exponent or a mu of any kind."""
    bare = unit.strip().strip("[]()").strip()
    return (
        bare.replace("\u00b5", "u")
        .replace("\u03bc", "u")
        .replace("\u00b2", "^2")
        .replace("s2", "s^2")
        .replace("**", "^")
    )


# ---- The files -----------------------------------------------------------------------------------------------------


def _table(name: str, content: bytes, named: bool) -> Table:
    ending = ending_of(name)
    if ending not in TABLE_READERS:
        raise ValueError("a recording ends in .csv, .npz or .wav")
    if ending == ".wav" and not named:
        raise ValueError(f"a .wav needs {one_line(name)}.yaml, with its columns and their scale")
    return TABLE_READERS[ending](content)


def _quantities(
    table: Table, beside: RecordingSidecar, where: str
) -> tuple[dict[Quantity, Floats], float, float | None]:
    """The quantities in SI units, to how much the times are rounded, and the rate that the file says."""
    wanted = beside.columns or {
        quantity: RecordedColumn(column=name) for quantity, name in COLUMN_OF.items() if name in table.names
    }
    unfit = [name for name in COLUMN_OF.values() if name in table.others] if not beside.columns else []
    if unfit:
        raise ValueError(f"{unfit[0]} {table.others[unfit[0]]}: name other columns in {where}")
    if not set(wanted) & {"acceleration", "force", "position", "tangential_position"}:
        if beside.columns:
            raise ValueError(f"{where} names neither acceleration nor force nor position")
        known = ", ".join(COLUMN_OF.values())
        has = known_names("", map(short_name, [*table.names, *table.others])).removeprefix("known: ")
        raise ValueError(f"has none of {known}; it has {has}: name them in {where}")
    places = {quantity: table.place(column.column) for quantity, column in wanted.items()}
    # What is too large or no number here is reported by `uniform`.
    with np.errstate(all="ignore"):
        read = dict(zip(places, table.read(list(places.values())), strict=True))
    found: dict[Quantity, Floats] = {}
    rounding = 0.0
    for quantity, column in wanted.items():
        unit = column.unit if column.unit is not None else table.units.get(places[quantity], "")
        if unit and _spelt(unit) not in UNITS_OF[quantity]:
            raise ValueError(
                f"says that {quantity} is in {shown_name(unit)}, which is none of {', '.join(UNITS_OF[quantity])}: say "
                f"its unit in {where}"
            )
        factor = column.scale * (UNITS_OF[quantity][_spelt(unit)] if unit else 1.0)
        with np.errstate(all="ignore"):
            found[quantity] = read[quantity] * factor
            if quantity == "time":
                rounding = abs(factor) * table.rounded(places[quantity], read[quantity])
    return found, rounding, table.rate_hz
