"""Motion of the hand on the simulated joystick: waypoints or a gesture, from a message or a file.

An operator is exactly one of

    waypoints: [[t_s, x_m, y_m], ...]      and optionally interpolation: linear (the default) or minimum_jerk
    gesture: {kind: tap, object, speed_m_per_s, count, at_m, height_m, press_depth_m}
    gesture: {kind: stroke, object, speed_m_per_s, press_n, from_m, to_m, count, height_m}
    gesture: {kind: puncture, object, speed_m_per_s, at_m, height_m}

`at_m`, `from_m` and `to_m` are coordinates along the tangent t = (n_y, -n_x). Their origin is the wall's point, the
membrane's centre, the middle of the box's upper face, or the disc's top. On a membrane and a box they must lie between
the ends. A file is YAML, JSON, or CSV with the columns t_s,x_m,y_m. `gesture_waypoints` converts a gesture to straight
lines, which depend only on the object, the hand and the hand's position.
"""

import cmath
import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Final, Literal, Self, TypeAlias, cast

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, Strict, ValidationError, model_validator

from hapticd.base.csv_table import CsvTable, CsvTableError, csv_table_of, number_of
from hapticd.base.errors import InvalidError, Problem, known_names, quoted
from hapticd.base.model import Coordinate, Model, Name, at_most, faults_of, plain
from hapticd.base.units import UNITS_OF, Quantity, stated_unit, unit_of
from hapticd.base.yaml_source import (
    MAX_YAML_BYTES,
    Document,
    Json,
    Marks,
    load_bytes,
    printable,
    read_file,
)
from hapticd.config.document_kinds import refuse_other_kinds
from hapticd.config.modes import given, one_of

Interpolation: TypeAlias = Literal["linear", "minimum_jerk"]
Point: TypeAlias = tuple[float, float]

MAX_WAYPOINTS: Final = 100_000
"""Maximum number of waypoints of an operator."""
MIN_STEP_S: Final = 1e-5
"""Minimum time between two waypoints, so that a tick contains only a few."""
MAX_TIME_S: Final = 86_400.0
"""Maximum time of a waypoint: one day."""
MAX_CSV_BYTES: Final = 16 * 1024 * 1024
"""Maximum size of a CSV file of waypoints, in bytes."""

TRAVEL_SPEED_M_PER_S: Final = 0.15
"""Speed of the hand on its way to the beginning of a gesture, and when it withdraws."""
LOWERING_SPEED_M_PER_S: Final = 0.02
"""Speed at which the hand is lowered for a stroke; a tap at this speed cannot be felt."""
PRESS_TIME_S: Final = 0.15
"""Time for which the hand stays at the depth of a tap or puncture, until all modes of the library have decayed."""
SPEED_TOLERANCE: Final = 0.01
"""Maximum relative deviation of the handle's speed at contact from the speed that the gesture commands."""
CLEARANCE_HEIGHT_M: Final = 0.005
"""Height from which the hand is lowered for a stroke; also added to other heights and to a puncture's depth."""

_CSV_COLUMNS: Final = ("t_s", "x_m", "y_m")
_QUANTITY_OF: Final[dict[str, Quantity]] = {"t": "time", "x": "position", "y": "position"}

Speed: TypeAlias = Annotated[float, Field(ge=0.001, le=2)]
Count: TypeAlias = Annotated[int, Field(ge=1, le=1000)]
Height: TypeAlias = Annotated[float, Field(ge=0.001, le=1)]


@dataclass(frozen=True, slots=True)
class Target:
    """Surface of a gesture: the origin of its tangential coordinate, and the unit normal there."""

    point_m: Point
    normal: Point
    stiffness_n_per_m: float
    rupture_depth_m: float | None
    half_m: float = math.inf
    """Half the surface's length; the origin is in its middle."""
    face: str = "surface"
    """Name of the surface in messages."""

    def fault(self, at_m: float) -> str | None:
        """Return the fault of a tangential coordinate that lies beyond the ends of the surface, or None."""
        if abs(at_m) <= self.half_m:
            return None
        return f"{at_m:.15g} is beyond the {self.face}, which ends at {math.copysign(self.half_m, at_m):.15g}"


@dataclass(frozen=True, slots=True)
class Grip:
    """Spring and damper of the hand on the handle; `moving_mass_kg` is the mass of hand and handle together."""

    stiffness_n_per_m: float
    damping_n_s_per_m: float = 5.0
    moving_mass_kg: float = 0.05

    @property
    def settling_s(self) -> float:
        """Time in s, at most 1, after which the handle follows a new speed of its target within SPEED_TOLERANCE.

        The relative error of the speed is (p exp(p t) - q exp(q t))/(p - q), with p and q the roots of M s^2 + b s + k:
        moving mass M, damping b, stiffness k.
        """
        half = self.damping_n_s_per_m / (2 * self.moving_mass_kg)
        root = cmath.sqrt(half * half - self.stiffness_n_per_m / self.moving_mass_kg)
        # Equal roots are separated slightly, which changes the error by far less than SPEED_TOLERANCE.
        p, q = -half - (root or 1e-6 * half), -half + (root or 1e-6 * half)
        time_s = np.linspace(0.0, 1.0, 2001)
        error = np.abs((p * np.exp(p * time_s) - q * np.exp(q * time_s)) / (p - q))
        return float(time_s[min(np.flatnonzero(error > SPEED_TOLERANCE)[-1] + 1, 2000)])


class TapGesture(Model):
    """A tap: the hand strikes the surface at a given speed, presses and withdraws, `count` times."""

    kind: Literal["tap"]
    object: Name = Field(description="Id of a wall, a membrane, a box or a disc.")
    speed_m_per_s: Speed = Field(description="Speed of the approach, along the normal.")
    count: Count = Field(default=1, description="Number of taps.")
    at_m: Coordinate = Field(default=0.0, description="Coordinate along the surface.")
    height_m: Height | None = Field(
        default=None, description="Height at which the approach begins; by default enough to reach the speed."
    )
    press_depth_m: Annotated[float, Field(ge=0, le=1)] | None = Field(
        default=None, description="Depth of the hand's target; by default enough not to bounce."
    )


class StrokeGesture(Model):
    """A stroke along the surface at a given speed and normal force, to and fro, `count` strokes in total."""

    kind: Literal["stroke"]
    object: Name = Field(description="Id of a wall, a membrane, a box or a disc.")
    speed_m_per_s: Speed = Field(description="Speed along the surface.")
    press_n: float = Field(ge=0.01, le=100, description="Normal force of the hand.")
    from_m: Coordinate = Field(description="Coordinate along the surface at which the stroke begins.")
    to_m: Coordinate = Field(description="Coordinate along the surface at which the stroke ends.")
    count: Count = Field(default=1, description="Number of strokes; every second one goes back.")
    height_m: Height = Field(
        default=CLEARANCE_HEIGHT_M, description="Height from which the probe is lowered onto the surface."
    )

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Self:
        if self.from_m == self.to_m:
            raise ValueError("from_m and to_m must differ")
        return self


class PunctureGesture(Model):
    """A puncture: the hand presses into a membrane at a given speed until it has ruptured, then withdraws."""

    kind: Literal["puncture"]
    object: Name = Field(description="Id of a membrane whose material ruptures.")
    speed_m_per_s: Speed = Field(description="Speed of the hand, along the normal.")
    at_m: Coordinate = Field(default=0.0, description="Coordinate along the membrane.")
    height_m: Height | None = Field(
        default=None, description="Height at which the approach begins; by default enough to reach the speed."
    )


Gesture: TypeAlias = Annotated[TapGesture | StrokeGesture | PunctureGesture, Field(discriminator="kind")]


Waypoint: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=0, le=MAX_TIME_S)], Coordinate, Coordinate], Strict(False)
]
"""A waypoint [t_s, x_m, y_m]: a time, and the position of the hand at this time."""


class OperatorParams(Model):
    """An operator as given by a message or a file."""

    model_config = ConfigDict(
        json_schema_extra={"allOf": [one_of("waypoints", "gesture"), {"not": given("gesture", "interpolation")}]}
    )

    # Only the first faulty waypoint is reported: thousands would take seconds.
    waypoints: (
        Annotated[
            tuple[Waypoint, ...],
            Strict(False),
            Field(min_length=1, max_length=MAX_WAYPOINTS, fail_fast=True),
            at_most(MAX_WAYPOINTS),
        ]
        | None
    ) = Field(
        default=None,
        description="times from 0 to 86400, each at least 1e-5 after the one before; coordinates -10 to 10",
    )
    interpolation: Interpolation | None = Field(
        default=None, description="with waypoints: `linear` (the default) or `minimum_jerk`"
    )
    gesture: Gesture | None = Field(default=None, description="a tap, a stroke or a puncture")

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if (self.waypoints is None) == (self.gesture is None):
            raise ValueError("needs exactly one of waypoints and gesture")
        if self.gesture is not None and self.interpolation is not None:
            raise ValueError("interpolation belongs to waypoints; a gesture is made of straight lines")
        return self


@dataclass(frozen=True, slots=True)
class Operator:
    """A validated operator: either waypoints or a gesture; the other one is None."""

    waypoints: tuple[tuple[float, float, float], ...] | None
    gesture: TapGesture | StrokeGesture | PunctureGesture | None
    interpolation: Interpolation = "linear"
    document: Document | None = field(default=None, compare=False, repr=False)
    """The YAML or JSON document of the operator, if it was read from one."""

    def waypoints_for(
        self, target_of: Callable[[str], Target | None], grip: Grip, reference_m: Point, ids: Iterable[str] = ()
    ) -> npt.NDArray[np.float64]:
        """Return the waypoints of an operator, for a hand whose target is at `reference_m` now.

        The rows are [t_s, x_m, y_m], shape (n, 3). `target_of` returns the surface of an object's id, and None for an
        id without a surface; `ids` are those of the scene. Raises InvalidError (`where` is inside `gesture`) for an
        unknown object or one that does not suit the gesture.
        """
        if self.gesture is None:
            return np.array(self.waypoints, dtype=np.float64)
        target = target_of(self.gesture.object)
        if target is None:
            wanted = self.gesture.object
            known = known_names(wanted, (id for id in ids if target_of(id) is not None))
            problem = f"no wall, membrane, box or disc of the scene has the id {quoted(wanted)}; {known}"
            raise InvalidError([Problem("gesture.object", problem)])
        return gesture_waypoints(self.gesture, target, grip, reference_m)


def operator_of(params: Mapping[str, object]) -> Operator:
    """Return the operator (motion of the simulated hand) in the params of `set_operator`.

    Raises InvalidError with every fault; of several faulty waypoints it reports the first.
    """
    return _parse(Document(cast(Json, params)))


def parse_operator(data: Mapping[str, object]) -> Operator:
    """Return the operator in a mapping, which may hold numpy arrays and tuples. Raises InvalidError as operator_of."""
    return _parse(Document(plain(data)))


def load_operator(path: str | os.PathLike[str]) -> Operator:
    """Load an operator (motion of the simulated hand) from a file: CSV or JSON by its ending, YAML otherwise.

    A CSV file has the columns t_s,x_m,y_m, with or without names, or the same in other units, such as t (ms). It is
    read as the .csv of a recording. Waypoints are joined by straight lines.

    Raises InvalidError, which names file and line of every fault, or HapticdError for a file that cannot be read.
    """
    name = os.fspath(path)
    ending = os.path.splitext(name)[1].lower()
    if ending == ".csv":
        return _parse(_csv_document(name))
    # JSON is YAML except for tabs, which in JSON are always white space.
    content = read_file(name, MAX_YAML_BYTES)
    document = load_bytes(content.replace(b"\t", b" ") if ending == ".json" else content, name)
    refuse_other_kinds(document, "waypoints", "gesture")
    if isinstance(document.data, dict) and "kind" in document.data:
        document = document.below("gesture")
    return replace(_parse(document), document=document)


def gesture_waypoints(
    gesture: TapGesture | StrokeGesture | PunctureGesture, target: Target, grip: Grip, reference_m: Point
) -> npt.NDArray[np.float64]:
    """Return the waypoints of a gesture, rows [t_s, x_m, y_m], shape (n, 3).

    The first row has t > 0. If `reference_m` is below the gesture's height, the hand first moves out along the normal.
    The hand then moves to the beginning of the gesture and stops there. Raises InvalidError.
    """
    if grip.stiffness_n_per_m <= 0:
        problem = "needs a hand that holds the handle: device.sim.hand.stiffness_n_per_m above 0"
        raise InvalidError([Problem("gesture", problem)])
    places = ("from_m", "to_m") if isinstance(gesture, StrokeGesture) else ("at_m",)
    faults = [Problem(f"gesture.{name}", text) for name in places if (text := target.fault(getattr(gesture, name)))]
    if faults:
        raise InvalidError(faults)
    path = _Path(target, reference_m)
    match gesture:
        case TapGesture():
            _tap(gesture, target, grip, path)
        case StrokeGesture():
            _stroke(gesture, target, grip, path)
        case PunctureGesture():
            _puncture(gesture, target, grip, path)
    rows = np.array(path.rows, dtype=np.float64)
    if not (np.isfinite(rows).all() and rows[-1, 0] <= MAX_TIME_S and len(rows) <= MAX_WAYPOINTS):
        problem = f"would last {rows[-1, 0]:g} s in {len(rows)} waypoints; at most {MAX_TIME_S:g} s in {MAX_WAYPOINTS}"
        raise InvalidError([Problem("gesture", problem)])
    return rows


class _Path:
    """Builder of waypoints in the coordinates of a surface: `at` along it, `height` above it."""

    def __init__(self, target: Target, reference_m: Point) -> None:
        self._target = target
        self.rows: list[tuple[float, float, float]] = []
        self._time_s = 0.0
        x, y = reference_m[0] - target.point_m[0], reference_m[1] - target.point_m[1]
        n_x, n_y = target.normal
        self._at, self._height = x * n_y - y * n_x, x * n_x + y * n_y

    def go(self, at: float, height: float, speed: float) -> None:
        """Move the hand in a straight line, at `speed`, to `at` along the surface and `height` above it."""
        distance = math.hypot(at - self._at, height - self._height)
        self._at, self._height = at, height
        if distance >= 2 * MIN_STEP_S * speed:
            self._add(distance / speed)

    def stay(self, duration_s: float) -> None:
        """Keep the hand still for `duration_s`."""
        self._add(duration_s)

    def begin(self, at: float, height: float) -> None:
        """Move the hand to the beginning of a gesture, without contact on the way."""
        if self._height < height:
            self.go(self._at, height, TRAVEL_SPEED_M_PER_S)
        self.go(at, height, TRAVEL_SPEED_M_PER_S)

    def press(self, at: float, height: float, depth: float, speed: float, settling_s: float) -> None:
        """Move the hand from `height` to `depth` below the surface at `speed`, stay there, and withdraw."""
        self.begin(at, height)
        self.stay(settling_s)
        self.go(at, -depth, speed)
        self.stay(PRESS_TIME_S)
        self.go(at, height, TRAVEL_SPEED_M_PER_S)

    def _add(self, duration_s: float) -> None:
        self._time_s += duration_s
        (x, y), (n_x, n_y) = self._target.point_m, self._target.normal
        along, out = self._at, self._height
        self.rows.append((self._time_s, x + along * n_y + out * n_x, y - along * n_x + out * n_y))


def _approach_height(speed: float, grip: Grip) -> float:
    return CLEARANCE_HEIGHT_M + speed * grip.settling_s


def _tap(gesture: TapGesture, target: Target, grip: Grip, path: _Path) -> None:
    speed, at = gesture.speed_m_per_s, gesture.at_m
    height = gesture.height_m or _approach_height(speed, grip)
    depth = gesture.press_depth_m
    if depth is None:
        # The handle comes to rest at depth k/(K + k) and oscillates about it; an impact alone has the amplitude
        # v sqrt(M/(K + k)). At a rest depth of that amplitude, with half an oscillation damped to 0.7, the handle stays
        # in contact.
        stiffness = target.stiffness_n_per_m + grip.stiffness_n_per_m
        overshoot = speed * math.sqrt(grip.moving_mass_kg / stiffness)
        depth = 0.002 + overshoot * stiffness / grip.stiffness_n_per_m
    for _ in range(gesture.count):
        path.press(at, height, depth, speed, grip.settling_s)


def _stroke(gesture: StrokeGesture, target: Target, grip: Grip, path: _Path) -> None:
    if target.stiffness_n_per_m <= 0:
        problem = f"{quoted(gesture.object)} has no stiffness to press against"
        raise InvalidError([Problem("gesture.object", problem)])
    # Hand and surface are springs in series.
    depth = gesture.press_n * (1 / target.stiffness_n_per_m + 1 / grip.stiffness_n_per_m)
    ends = (gesture.from_m, gesture.to_m)
    path.begin(gesture.from_m, gesture.height_m)
    path.stay(grip.settling_s)
    path.go(gesture.from_m, -depth, LOWERING_SPEED_M_PER_S)
    path.stay(grip.settling_s)
    for stroke in range(gesture.count):
        path.go(ends[(stroke + 1) % 2], -depth, gesture.speed_m_per_s)
        path.stay(grip.settling_s)
    path.go(ends[gesture.count % 2], gesture.height_m, TRAVEL_SPEED_M_PER_S)


def _puncture(gesture: PunctureGesture, target: Target, grip: Grip, path: _Path) -> None:
    if target.rupture_depth_m is None:
        problem = f"{quoted(gesture.object)} cannot be punctured: not a membrane, or its material has no rupture"
        raise InvalidError([Problem("gesture.object", problem)])
    speed, at = gesture.speed_m_per_s, gesture.at_m
    height = gesture.height_m or _approach_height(speed, grip)
    # At the rupture the hand is ahead of the handle by K d/k; friction needs less than the margin of 10 % and 5 mm.
    depth = target.rupture_depth_m * (1 + target.stiffness_n_per_m / grip.stiffness_n_per_m)
    path.press(at, height, 1.1 * depth + CLEARANCE_HEIGHT_M, speed, grip.settling_s)


# ---- Reading ----------------------------------------------------------------------------------------------


def _parse(document: Document) -> Operator:
    """Return the operator in a document. Raises InvalidError with every fault."""
    if not isinstance(document.data, dict):
        raise InvalidError([document.problem((), "must be a mapping with waypoints or gesture")])
    try:
        params = OperatorParams.parsed(document.data)
    except ValidationError as error:
        raise InvalidError(document.problem(path, text) for path, text in faults_of(error)) from None
    if params.waypoints is None:
        return Operator(None, params.gesture)
    times_s = np.array([time_s for time_s, _, _ in params.waypoints])
    too_early = np.flatnonzero(np.diff(times_s) < MIN_STEP_S * (1 - 1e-6)) + 1
    if too_early.size:
        index = int(too_early[0])
        problem = f"must be at least {MIN_STEP_S:g} later than {times_s[index - 1]} before it, is {times_s[index]}"
        raise InvalidError([document.problem(("waypoints", index, 0), problem)])
    return Operator(params.waypoints, None, params.interpolation or "linear")


def _csv_document(name: str) -> Document:
    """Read a CSV file as a document of waypoints, with the line of each waypoint. Raises InvalidError."""
    content = read_file(name, MAX_CSV_BYTES)
    if len(content) > MAX_CSV_BYTES:
        raise InvalidError([Problem(f"{printable(name)}:1", f"larger than {MAX_CSV_BYTES} bytes")])
    rows: list[Json] = []
    marks: dict[str | int, Marks] = {}
    try:
        table = csv_table_of(content)
        indices, factors = _waypoint_columns(table)
        for line, cells in table.lines():
            if (fault := table.fault(cells, indices)) is not None:
                raise InvalidError([Problem(f"{printable(name)}:{line}", fault)])
            numbers = [number_of(cells[index], table.delimiter) or 0.0 for index in indices]
            marks[len(rows)] = Marks(line, 1, {})
            rows.append([factor * number for factor, number in zip(factors, numbers, strict=True)])
    except ValueError as error:
        line = error.line if isinstance(error, CsvTableError) else 1
        raise InvalidError([Problem(f"{printable(name)}:{line}", str(error))]) from None
    return Document({"waypoints": rows}, name, Marks(1, 1, {"waypoints": Marks(1, 1, marks)}))


def _waypoint_columns(table: CsvTable) -> tuple[list[int], list[float]]:
    """Return the indices of the columns t, x and y, and the factors to SI units. Raises ValueError."""
    if not table.is_named and len(table.names) == len(_CSV_COLUMNS):
        return [0, 1, 2], [1.0, 1.0, 1.0]
    found: dict[str, list[tuple[int, str | None]]] = {"t": [], "x": [], "y": []}
    for key, columns in found.items():
        quantity = _QUANTITY_OF[key]
        for index, name in enumerate(table.names):
            stated = stated_unit(name, quantity, table.units.get(index, ""))
            bare = (name if stated is None else stated.column).strip(" _/").casefold()
            if ("t" if bare == "time" else bare) == key:
                columns.append((index, None if stated is None else unit_of(stated.text, quantity)))
    if any(len(columns) != 1 or columns[0][1] is None for columns in found.values()):
        raise ValueError(
            f"the columns must be {','.join(_CSV_COLUMNS)}, or be named with other units of time and length as in "
            f"t (ms),x (mm),y (mm); they are {quoted(','.join(table.names))}"
        )
    chosen = [(index, UNITS_OF[_QUANTITY_OF[key]][unit or ""]) for key, ((index, unit),) in found.items()]
    return [index for index, _ in chosen], [factor for _, factor in chosen]
