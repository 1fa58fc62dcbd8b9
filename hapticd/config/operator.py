"""What the hand on the simulated joystick does: waypoints or a named gesture, from a message or a file.

An operator is exactly one of

    waypoints: [[t_s, x_m, y_m], ...]      and optionally interpolation: linear (the default) or minimum_jerk
    gesture: {kind: tap, object, speed_m_per_s, count, at_m, height_m, press_depth_m}
    gesture: {kind: stroke, object, speed_m_per_s, press_n, from_m, to_m, count, height_m}
    gesture: {kind: puncture, object, speed_m_per_s, at_m, height_m}

`at_m`, `from_m` and `to_m` are tangential coordinates: 0 is the wall's point, the membrane's centre, the middle of the
box's upper face, the disc's top; t = (n_y, -n_x). On a membrane and a box they lie on it, its ends included.
A file is YAML, JSON, or CSV with the columns t_s,x_m,y_m. A gesture becomes straight lines by
`gesture_waypoints`, a pure function of the object, the hand and where the hand is.
"""

import cmath
import csv
import io
import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Final, Literal, Self, TypeAlias, cast

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, Strict, ValidationError, model_validator

from hapticd.base.errors import InvalidError, Problem, known_names, quoted
from hapticd.base.model import Coordinate, Model, Name, at_most, faults_of, plain
from hapticd.base.yaml_source import MAX_BYTES, Document, Json, Marks, load_bytes, one_line, read_file, text_of
from hapticd.config.document_kinds import refuse_other_kinds
from hapticd.config.modes import given, one_of

Interpolation: TypeAlias = Literal["linear", "minimum_jerk"]
Point: TypeAlias = tuple[float, float]

MAX_WAYPOINTS: Final = 100_000
MIN_STEP_S: Final = 1e-5
"""Waypoints are at least this far apart, so that few of them fall into one tick."""
MAX_TIME_S: Final = 86_400.0
MAX_CSV_BYTES: Final = 16 * 1024 * 1024

TRAVEL_M_PER_S: Final = 0.15
"""Speed of everything that is not the gesture itself: going there, withdrawing."""
LOWER_M_PER_S: Final = 0.02
"""A stroke is laid on the surface this slowly, so that it begins without a tap that would be felt."""
HOLD_S: Final = 0.15
"""How long a tap presses, and a puncture stays inside: longer than any mode of the library rings."""
SPEED_WITHIN: Final = 0.01
"""An approach is long enough for the handle to have the commanded speed within this fraction."""
CLEARANCE_M: Final = 0.005

_COLUMNS: Final = ("t_s", "x_m", "y_m")

Speed: TypeAlias = Annotated[float, Field(ge=0.001, le=2)]
Count: TypeAlias = Annotated[int, Field(ge=1, le=1000)]
Height: TypeAlias = Annotated[float, Field(ge=0.001, le=1)]


@dataclass(frozen=True, slots=True)
class Target:
    """What a gesture needs to know of a surface: where 0 is on it, and which way it faces there (a unit vector)."""

    point_m: Point
    normal: Point
    stiffness_n_per_m: float
    rupture_depth_m: float | None
    half_m: float = math.inf
    """How far the surface goes either way from its point."""
    face: str = "surface"
    """What is said to end there."""

    def fault(self, at_m: float) -> str | None:
        """What is wrong with a place along the surface."""
        if abs(at_m) <= self.half_m:
            return None
        return f"{at_m:.15g} is beyond the {self.face}, which ends at {math.copysign(self.half_m, at_m):.15g}"


@dataclass(frozen=True, slots=True)
class Grip:
    """How the hand holds the handle; `moving_mass_kg` is hand and handle together."""

    stiffness_n_per_m: float
    damping_n_s_per_m: float = 5.0
    moving_mass_kg: float = 0.05

    @property
    def settling_s(self) -> float:
        """How long after a change of the reference's speed the handle has it within SPEED_WITHIN, at most 1 s.

        The error is (p exp(p t) - q exp(q t))/(p - q), p and q the roots of M s^2 + b s + k.
        """
        half = self.damping_n_s_per_m / (2 * self.moving_mass_kg)
        root = cmath.sqrt(half * half - self.stiffness_n_per_m / self.moving_mass_kg)
        # Equal roots are moved apart by a little: that changes the error by far less than is asked for.
        p, q = -half - (root or 1e-6 * half), -half + (root or 1e-6 * half)
        time_s = np.linspace(0.0, 1.0, 2001)
        error = np.abs((p * np.exp(p * time_s) - q * np.exp(q * time_s)) / (p - q))
        return float(time_s[min(np.flatnonzero(error > SPEED_WITHIN)[-1] + 1, 2000)])


class TapGesture(Model):
    """Strikes the surface at a speed, presses, withdraws; `count` times."""

    kind: Literal["tap"]
    object: Name = Field(description="Id of a wall, a membrane, a box or a disc.")
    speed_m_per_s: Speed = Field(description="Speed of the approach, along the normal.")
    count: Count = Field(default=1, description="How many taps.")
    at_m: Coordinate = Field(default=0.0, description="Where along the surface.")
    height_m: Height | None = Field(
        default=None, description="Height that the approach begins at; by default enough to reach the speed."
    )
    press_depth_m: Annotated[float, Field(ge=0, le=1)] | None = Field(
        default=None, description="Depth that the hand aims for; by default enough not to bounce."
    )


class StrokeGesture(Model):
    """Strokes along the surface at a speed and with a normal force, to and fro; `count` times in all."""

    kind: Literal["stroke"]
    object: Name = Field(description="Id of a wall, a membrane, a box or a disc.")
    speed_m_per_s: Speed = Field(description="Speed along the surface.")
    press_n: float = Field(ge=0.01, le=100, description="Normal force that the hand presses with.")
    from_m: Coordinate = Field(description="Where along the surface it begins.")
    to_m: Coordinate = Field(description="Where along the surface it ends.")
    count: Count = Field(default=1, description="How many strokes, the second one back, and so on.")
    height_m: Height = Field(default=CLEARANCE_M, description="Height that it is laid on from.")

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Self:
        if self.from_m == self.to_m:
            raise ValueError("from_m and to_m must differ")
        return self


class PunctureGesture(Model):
    """Presses into a membrane at a speed until it has surely broken, then withdraws."""

    kind: Literal["puncture"]
    object: Name = Field(description="Id of a membrane whose material ruptures.")
    speed_m_per_s: Speed = Field(description="Speed of the hand, along the normal.")
    at_m: Coordinate = Field(default=0.0, description="Where along the skin.")
    height_m: Height | None = Field(
        default=None, description="Height that the approach begins at; by default enough to reach the speed."
    )


Gesture: TypeAlias = Annotated[TapGesture | StrokeGesture | PunctureGesture, Field(discriminator="kind")]


Waypoint: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=0, le=MAX_TIME_S)], Coordinate, Coordinate], Strict(False)
]
"""[t_s, x_m, y_m]."""


class OperatorParams(Model):
    """What a message or a file says of the operator."""

    model_config = ConfigDict(
        json_schema_extra={"allOf": [one_of("waypoints", "gesture"), {"not": given("gesture", "interpolation")}]}
    )

    # Of many thousands that are faulty the first alone is reported: the rest would take seconds.
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
    """A validated operator: waypoints or a gesture, the other is None."""

    waypoints: tuple[tuple[float, float, float], ...] | None
    gesture: TapGesture | StrokeGesture | PunctureGesture | None
    interpolation: Interpolation = "linear"
    document: Document | None = field(default=None, compare=False, repr=False)
    """What it was read from, if that was YAML or JSON."""

    def waypoints_for(
        self, target_of: Callable[[str], Target | None], grip: Grip, reference_m: Point, ids: Iterable[str] = ()
    ) -> npt.NDArray[np.float64]:
        """Rows [t_s, x_m, y_m], shape (n, 3), for a hand that wants to be at `reference_m` now.

        `target_of` gives what can be touched of an id, None for anything else; `ids` are those of the scene. Raises
        InvalidError (`where` is inside `gesture`) for an object that is none or that the gesture does not fit.
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
    """An operator from the params of `set_operator`. Raises InvalidError with every fault; of several faulty waypoints
    with those of the first."""
    return _parse(Document(cast(Json, params)))


def parse_operator(data: Mapping[str, object]) -> Operator:
    """An operator from any mapping of such params, numpy arrays and tuples included. Raises InvalidError as operator_of
    does."""
    return _parse(Document(plain(data)))


def load_operator(path: str | os.PathLike[str]) -> Operator:
    """An operator from a file: CSV or JSON by its ending, YAML otherwise.

    A CSV holds the columns t_s,x_m,y_m, with or without a header line; it is followed in straight lines.
    Raises InvalidError, which names file and line of every fault, or HapticdError for a file that cannot be
    read.
    """
    name = os.fspath(path)
    ending = os.path.splitext(name)[1].lower()
    if ending == ".csv":
        return _parse(_csv_document(name))
    # JSON is YAML, but for tabs, which in JSON can only be white space.
    content = read_file(name, MAX_BYTES)
    document = load_bytes(content.replace(b"\t", b" ") if ending == ".json" else content, name)
    refuse_other_kinds(document, "waypoints", "gesture")
    if isinstance(document.data, dict) and "kind" in document.data:
        document = document.below("gesture")
    return replace(_parse(document), document=document)


def gesture_waypoints(
    gesture: TapGesture | StrokeGesture | PunctureGesture, target: Target, grip: Grip, reference_m: Point
) -> npt.NDArray[np.float64]:
    """The straight lines of a gesture, rows [t_s, x_m, y_m], shape (n, 3).

    The first row is at t > 0: the hand goes there from `reference_m`, first out along the normal if it is lower
    than the gesture's height, then to where the gesture begins, and comes to rest. Raises InvalidError.
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
        problem = f"would last {rows[-1, 0]:g} s or go out of reach; at most {MAX_TIME_S:g} s"
        raise InvalidError([Problem("gesture", problem)])
    return rows


class _Path:
    """Waypoints in the coordinates of a surface: `at` along it, `height` above it."""

    def __init__(self, target: Target, reference_m: Point) -> None:
        self._target = target
        self.rows: list[tuple[float, float, float]] = []
        self._time_s = 0.0
        x, y = reference_m[0] - target.point_m[0], reference_m[1] - target.point_m[1]
        n_x, n_y = target.normal
        self._at, self._height = x * n_y - y * n_x, x * n_x + y * n_y

    def go(self, at: float, height: float, speed: float) -> None:
        """A straight line at a speed."""
        way = math.hypot(at - self._at, height - self._height)
        self._at, self._height = at, height
        if way >= 2 * MIN_STEP_S * speed:
            self._add(way / speed)

    def stay(self, duration_s: float) -> None:
        self._add(duration_s)

    def begin(self, at: float, height: float) -> None:
        """To where a gesture begins, without touching its object on the way."""
        if self._height < height:
            self.go(self._at, height, TRAVEL_M_PER_S)
        self.go(at, height, TRAVEL_M_PER_S)

    def press(self, at: float, height: float, depth: float, speed: float, settling_s: float) -> None:
        """From a height to a depth at a speed, stay, and out again."""
        self.begin(at, height)
        self.stay(settling_s)
        self.go(at, -depth, speed)
        self.stay(HOLD_S)
        self.go(at, height, TRAVEL_M_PER_S)

    def _add(self, duration_s: float) -> None:
        self._time_s += duration_s
        (x, y), (n_x, n_y) = self._target.point_m, self._target.normal
        along, out = self._at, self._height
        self.rows.append((self._time_s, x + along * n_y + out * n_x, y - along * n_x + out * n_y))


def _approach_height(speed: float, grip: Grip) -> float:
    return CLEARANCE_M + speed * grip.settling_s


def _tap(gesture: TapGesture, target: Target, grip: Grip, path: _Path) -> None:
    speed, at = gesture.speed_m_per_s, gesture.at_m
    height = gesture.height_m or _approach_height(speed, grip)
    depth = gesture.press_depth_m
    if depth is None:
        # The handle comes to rest at depth k/(K + k) and swings about it; an impact alone would swing by
        # v sqrt(M/(K + k)). With rest as deep as that, and half a swing damped to 0.7, it does not leave
        # again.
        stiffness = target.stiffness_n_per_m + grip.stiffness_n_per_m
        swing = speed * math.sqrt(grip.moving_mass_kg / stiffness)
        depth = 0.002 + swing * stiffness / grip.stiffness_n_per_m
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
    path.go(gesture.from_m, -depth, LOWER_M_PER_S)
    path.stay(grip.settling_s)
    for stroke in range(gesture.count):
        path.go(ends[(stroke + 1) % 2], -depth, gesture.speed_m_per_s)
        path.stay(grip.settling_s)
    path.go(ends[gesture.count % 2], gesture.height_m, TRAVEL_M_PER_S)


def _puncture(gesture: PunctureGesture, target: Target, grip: Grip, path: _Path) -> None:
    if target.rupture_depth_m is None:
        problem = f"{quoted(gesture.object)} cannot be punctured: no membrane, or a material without rupture"
        raise InvalidError([Problem("gesture.object", problem)])
    speed, at = gesture.speed_m_per_s, gesture.at_m
    height = gesture.height_m or _approach_height(speed, grip)
    # At the rupture the hand is ahead of the handle by K d/k; friction takes less than the rest.
    depth = target.rupture_depth_m * (1 + target.stiffness_n_per_m / grip.stiffness_n_per_m)
    path.press(at, height, 1.1 * depth + CLEARANCE_M, speed, grip.settling_s)


# ---- Reading ----------------------------------------------------------------------------------------------


def _parse(document: Document) -> Operator:
    """Raises InvalidError with every fault."""
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
    """The rows as waypoints, each at its line."""
    text = text_of(read_file(name, MAX_CSV_BYTES), name, MAX_CSV_BYTES)
    reader = csv.reader(io.StringIO(text), skipinitialspace=True)
    rows: list[Json] = []
    lines: list[int] = []
    try:
        for cells in reader:
            stripped = [cell.strip() for cell in cells]
            # A header has no number.
            if not rows and any(stripped) and not any(isinstance(_number(cell), float) for cell in stripped):
                if stripped != [*_COLUMNS]:
                    problem = f"the header must be {','.join(_COLUMNS)}, is {quoted(','.join(stripped))}"
                    raise InvalidError([Problem(_line(name, reader.line_num), problem)])
            elif any(stripped):
                rows.append([_number(cell) for cell in stripped])
                lines.append(reader.line_num)
    except csv.Error as error:
        raise InvalidError([Problem(_line(name, reader.line_num), f"not CSV: {error}")]) from None
    marks = Marks(1, 1, {index: Marks(line, 1, {}) for index, line in enumerate(lines)})
    return Document({"waypoints": rows}, name, Marks(1, 1, {"waypoints": marks}))


def _number(cell: str) -> float | str:
    """The number in a cell, or the cell itself where it holds none."""
    try:
        return cell if "_" in cell else float(cell)
    except ValueError:
        return cell


def _line(name: str, line: int) -> str:
    return f"{one_line(name)}:{line}"
