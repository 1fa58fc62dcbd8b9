"""Rendering without a daemon: the servo's tick, without clock, thread or I/O.

`render` computes forces from positions (open loop); `simulate` closes the loop with the simulated joystick. The same
input gives the same bits in every run.
"""

from __future__ import annotations

import math
import os
import warnings as python_warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from hapticd.base.core import (
    EVENT_DTYPE,
    NO_SLOT,
    SAMPLE_DTYPE,
    CData,
    Status,
    ffi,
    invalid_reason,
    lib,
    pointer,
    records,
)
from hapticd.base.errors import HapticdError, InvalidError, Problem, shown
from hapticd.base.model import MAX_FAULTS, problems_of
from hapticd.config.configuration import Config, ConfigSource, Servo, load_config
from hapticd.config.materials import Materials
from hapticd.config.modes import Attack, Mode
from hapticd.config.operator import Operator, load_operator, parse_operator
from hapticd.config.scene import Scene
from hapticd.rendering.compiler.mode_record import mode_record
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import Output, loop_of, output_of
from hapticd.rendering.displayability import materials_in, rate_faults, undisplayable, warnings
from hapticd.rendering.joystick import new_operator, new_sim, waypoints_of
from hapticd.rendering.placement import Reach, far_positions, placement_warnings
from hapticd.rendering.plausibility import ImplausibleValue, figure_warnings
from hapticd.rendering.scene_stability import Stability, evaluate
from hapticd.rendering.undisplayable_text import Undisplayable

Samples: TypeAlias = npt.NDArray[np.void]
"""Array (n,) of `hapticd.SAMPLE_DTYPE`: one record for each tick, with the fields and units of telemetry."""

Events: TypeAlias = npt.NDArray[np.void]
"""Array (m,) of `hapticd.base.core.EVENT_DTYPE`."""
Floats: TypeAlias = npt.NDArray[np.float64]

MAX_DURATION_S = 3600.0
"""Longest simulated time of a run: all samples are kept in memory."""


@dataclass(frozen=True, slots=True)
class Run:
    """The result of rendering or simulating a scene."""

    samples: Samples
    """(n,) records, one for each tick."""
    events: Events
    objects: dict[tuple[int, int], str]
    """Ids of the objects that events refer to, by slot and generation."""
    truth: Floats | None
    """Exact position (m) and velocity (m/s) of the simulated handle at each tick, (n, 4); None for `render`."""
    undisplayable: tuple[Undisplayable, ...]
    """Modes, waveforms and texture peaks of the scene whose frequency is too high for this rate."""
    warnings: tuple[Problem, ...]
    """Deviations in the display of the scene at this rate; in the closed loop also contact sets that may oscillate."""
    implausible: tuple[Problem, ...]
    """Those of `warnings` that are about figures and positions, which may be in another unit."""
    rate_hz: float
    """Ticks per second."""


class CompiledScene:
    """A configuration, compiled for a servo rate, by default for the configured one.

    Raises InvalidError for a texture whose frequencies are not below half the rate.
    """

    def __init__(self, config: ConfigSource, rate_hz: float | None = None) -> None:
        self.config: Config = load_config(config)
        self.rate_hz = self.config.servo.rate_hz if rate_hz is None else _rate(rate_hz)
        scene, materials = self.config.scene, self.config.materials
        self.output = output_of(self.config, self.rate_hz)
        refused = rate_faults(scene.objects, materials, self.output)
        if refused:
            raise InvalidError(refused)
        self._compiler = Compiler(self.output)
        self.world = new_world(self._compiler.update(scene, scene.objects, materials, 1))

    def new_state(self, resolution_m: float) -> CData:
        """Return a state without contacts or modes; `resolution_m` is the step of positions, 0 for exact ones."""
        state = new_state_of(len(self.config.scene.objects))
        lib.hd_state_set_resolution(state, resolution_m)
        return state

    def stability(self) -> Stability:
        """Return the stability of the contact sets with the simulated joystick, even if the device is another one."""
        device = self.config.device.model_copy(update={"kind": "sim"})
        loop = loop_of(self.config.model_copy(update={"device": device}), self.rate_hz)
        assert loop is not None
        return evaluate(self._compiler, self.config.scene, loop)

    def run_of(
        self,
        samples: Samples,
        events: Events,
        truth: Floats | None,
        path_m: Floats,
        path_name: str,
        unstable: Iterable[Problem] = (),
    ) -> Run:
        """Return a Run with these results and the scene's warnings, to which `unstable` is added.

        `path_m` (n, 2) are the positions of the probe or the hand, from the argument `path_name`.
        """
        objects, materials = self.config.scene.objects, self.config.materials
        placed = self._placement_warnings(path_m, path_name)
        shown = materials_in(objects, materials)
        figures = (problem for name, material in shown.items() for problem in figure_warnings(name, material))
        return Run(
            samples,
            events,
            {place: id for id in objects if (place := self._compiler.slot_of(id)) is not None},
            truth,
            tuple(undisplayable(shown, self.output)),
            (*placed, *warnings(objects, materials, self.output), *unstable),
            (*placed, *figures),
            self.rate_hz,
        )

    def _placement_warnings(self, path_m: Floats, path_name: str) -> list[Problem]:
        """Return the warning of a path, shape (n, 2), that is far away, or of the objects that it begins in."""
        reach = Reach.of(self.config)
        far = far_positions(path_m, reach, path_name)
        if far or not len(path_m):
            return far
        begun = reach._replace(rest_m=(float(path_m[0, 0]), float(path_m[0, 1])))
        return list(islice(placement_warnings(self.config.scene, self.config.materials, begun), MAX_FAULTS))


def new_state_of(slots: int) -> CData:
    """Return a state of ticks, a `struct hd_state *`, for up to `slots` objects; freed when unused."""
    state = lib.hd_state_new(max(1, slots))
    if state == ffi.NULL:
        raise MemoryError("not enough memory for the state of a run")
    return ffi.gc(state, lib.hd_state_free)


def new_world(table: CData) -> CData:
    """Return a world, a `struct hd_world *` that holds the table of a scene; freed when unused.

    Raises HapticdError if the core rejects the table.
    """
    made = lib.hd_world_new()
    if made == ffi.NULL:
        raise MemoryError("not enough memory for the scene of a run")
    world = ffi.gc(made, lib.hd_world_free)
    status = lib.hd_world_load(world, table)
    if status == Status.ERR_MEMORY:
        raise MemoryError("not enough memory for the table of a scene")
    if status != Status.OK:
        raise HapticdError(f"the scene cannot be rendered: {invalid_reason()}")
    return world


def _rate(rate_hz: float) -> float:
    try:
        return Servo.parsed({"rate_hz": rate_hz}).rate_hz
    except ValidationError as error:
        raise InvalidError(problems_of(error)) from None


class _Recorder:
    """Runs ticks in blocks, with room for all events that the ticks of a block can have, and collects the events."""

    BLOCK_TICKS = 4096
    EVENTS_PER_TICK = 256

    def __init__(self) -> None:
        self._room = records(EVENT_DTYPE, self.BLOCK_TICKS * self.EVENTS_PER_TICK)
        self._room_pointer = pointer("struct hd_event[]", self._room)
        self._count = ffi.new("size_t *")
        self._taken: list[Events] = []

    def run(self, count: int, block: Callable[[slice, CData, int, CData], int]) -> Events:
        """Call `block` for each slice of `count` ticks and return their events."""
        for start in range(0, count, self.BLOCK_TICKS):
            part = slice(start, min(count, start + self.BLOCK_TICKS))
            status = block(part, self._room_pointer, len(self._room), self._count)
            if status == Status.ERR_MEMORY:
                raise MemoryError("not enough memory for the state of a run")
            if status != Status.OK:
                raise HapticdError(f"the scene cannot be rendered: {invalid_reason()}")
            if self._count[0]:
                self._taken.append(self._room[: self._count[0]].copy())
        taken, self._taken = self._taken, []
        return np.concatenate(taken) if taken else self._room[:0].copy()


class Rerun:
    """Renders recorded ticks of a servo again from the inputs in their samples; the scene may change between ticks.

    Contacts, modes and punctures persist from tick to tick, as in the servo.
    """

    def __init__(self, output: Output, slots: int) -> None:
        """Prepare an empty scene with room for `slots` objects."""
        self._output = output
        self._compiler = Compiler(output)
        self._slots = slots
        self._recorder = _Recorder()
        self._world: CData | None = None
        self.restart(False)

    def restart(self, muted: bool) -> None:
        """Clear contacts, modes and punctures; with `muted`, the commanded force rises from 0 over scene.ramp_s."""
        self._state = new_state_of(self._slots)
        if muted:
            lib.hd_state_mute(self._state)

    def change_rate(self, output: Output) -> None:
        """Change the output (device and rate). `turn_to` must be called before the next tick."""
        self._output = output
        self._compiler.turn_to(output)

    def turn_to(self, scene: Scene, changed: Iterable[str], materials: Materials, revision: int) -> None:
        """Change to a validated scene, which differs from the previous scene only in the objects `changed`.

        Afterwards `name_of` may return None for events of earlier ticks.
        """
        self._compiler.events_read((revision - 1) & 0xFFFFFFFF)
        self._world = new_world(self._compiler.update(scene, changed, materials, revision))

    def play(self, mode: Mode, attack: Attack, direction: tuple[float, float], amplitude_m_per_s2: float) -> None:
        """Start a mode (a decaying vibration) at the next tick, as the daemon's `play` does."""
        _play(self._state, self._output, mode, mode.coefficient(1.0, attack), direction, amplitude_m_per_s2)

    def reset(self, objects: Iterable[str] | None, time_ns: int) -> None:
        """Clear the contact state of objects (None: all) at the next tick, whose time is `time_ns`, as `reset` does."""
        places = [(NO_SLOT, 0)] if objects is None else map(self._compiler.slot_of, objects)
        for place in places:
            if place is not None:
                lib.hd_state_reset(self._state, *place, time_ns)

    def name_of(self, event: npt.NDArray[np.void] | np.void) -> str | None:
        """Return the id of the object to which an event refers; None without an object."""
        return self._compiler.name_of(int(event["slot"]), int(event["generation"]))

    def run(self, recorded: Samples, interval_s: Floats, periods: npt.NDArray[np.uint32]) -> tuple[Samples, Events]:
        """Render (n,) recorded ticks again, and return the rendered samples and events.

        `interval_s` (n,) is the time from the previous position report to that of the tick, 0 without a new report.
        `periods` (n,) is the number of periods since the previous tick, 1 if no period was missed.
        """
        world, samples = self._world, np.empty(len(recorded), SAMPLE_DTYPE)
        assert world is not None
        recorded, interval_s = np.ascontiguousarray(recorded), np.ascontiguousarray(interval_s)
        periods = np.ascontiguousarray(periods)
        events = self._recorder.run(
            len(recorded),
            lambda part, room, capacity, found: lib.hd_replay(
                world,
                self._state,
                pointer("struct hd_sample[]", recorded[part]),
                pointer("double[]", interval_s[part]),
                pointer("uint32_t[]", periods[part]),
                part.stop - part.start,
                pointer("struct hd_sample[]", samples[part]),
                room,
                capacity,
                found,
            ),
        )
        return samples, events


class Simulation:
    """The closed loop of tick and simulated joystick, whose state persists from run to run.

    Raises HapticdError for a scene that cannot be rendered.
    """

    def __init__(
        self,
        scene: CompiledScene,
        waypoints: Sequence[Sequence[float]] | None = None,
        interpolation: Literal["linear", "minimum_jerk"] = "linear",
    ) -> None:
        """Prepare the loop with the handle at rest at the first waypoint.

        `waypoints` are rows [t_s, x_m, y_m] of the hand's path; without them the hand stays where it is.
        """
        sim = scene.config.device.sim
        self._scene, self._recorder = scene, _Recorder()
        self._state, self._sim = scene.new_state(sim.encoder_step_m), new_sim(sim, scene.rate_hz)
        if waypoints is not None:
            self._hand = new_operator(waypoints, interpolation)
            lib.hd_sim_operate(self._sim, self._hand)
            lib.hd_sim_settle(self._sim)

    def strike(self, mode: Mode, coefficient_m_per_s2: float, direction: tuple[float, float]) -> None:
        """Start a mode (a decaying vibration) with this coefficient along `direction` at the next tick."""
        _play(self._state, self._scene.output, mode, 1.0, direction, coefficient_m_per_s2)

    def advance(self, duration_s: float) -> Floats:
        """Run for a time; return the exact position (m) and velocity (m/s) of the handle at each tick, (n, 4)."""
        return self.run(duration_s)[1]

    def run(self, duration_s: float) -> tuple[Samples, Floats, Events]:
        """Run for a time, at least one tick; return samples (n,), exact motion of the handle (n, 4) and events."""
        count = max(1, round(duration_s * self._scene.rate_hz))
        samples, truth = np.empty(count, SAMPLE_DTYPE), np.empty((count, 4))
        events = self._recorder.run(
            count,
            lambda part, room, capacity, found: lib.hd_simulate(
                self._scene.world,
                self._state,
                self._sim,
                part.stop - part.start,
                pointer("struct hd_sample[]", samples[part]),
                pointer("double[]", truth[part]),
                room,
                capacity,
                found,
            ),
        )
        return samples, truth, events


def _play(
    state: CData, output: Output, mode: Mode, coefficient: float, direction: tuple[float, float], amplitude: float
) -> None:
    length = math.hypot(*direction)
    record = ffi.new("struct hd_mode *", mode_record(mode, 1.0, coefficient, output))
    along = ffi.new("double[2]", (direction[0] / length, direction[1] / length))
    if lib.hd_play(state, record, along, amplitude) != Status.OK:
        raise HapticdError(f"the mode cannot be played: {invalid_reason()}")


def _duration(duration_s: float, rate_hz: float) -> float:
    wanted = f"must be a number of seconds, at least one tick and at most {MAX_DURATION_S:g} s"
    number = not isinstance(duration_s, bool) and isinstance(duration_s, int | float | np.integer | np.floating)
    if not number or not 0 < duration_s <= MAX_DURATION_S or round(float(duration_s) * rate_hz) < 1:
        raise InvalidError([Problem("duration_s", f"{wanted}, is {shown(duration_s)}")])
    return float(duration_s)


def _numbers(values: npt.ArrayLike, name: str, columns: int) -> Floats:
    """Return `values` as real numbers, shape (n, columns), finite or not. Raises InvalidError for other values."""
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "fiu" or isinstance(values, np.ma.MaskedArray):
            raise InvalidError([Problem(name, f"must be real numbers, shape (n, {columns}), has type {given.dtype}")])
        array = np.ascontiguousarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidError([Problem(name, f"must be numbers, shape (n, {columns}): {error}")]) from None
    if array.ndim != 2 or array.shape[1] != columns:
        raise InvalidError([Problem(name, f"must have shape (n, {columns}), has {array.shape}")])
    return array


def _positions(position_m: npt.ArrayLike, name: str) -> Floats:
    array = _numbers(position_m, name, 2)
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        raise InvalidError([Problem(f"{name}[{first}]", f"must be finite, is {array[first].tolist()}")])
    return array


def _warn_of(problems: Iterable[Problem]) -> None:
    """Issue a Python warning for each problem, at the line that called `render` or `simulate`."""
    for problem in problems:
        python_warnings.warn(ImplausibleValue(str(problem)), stacklevel=3)


def render(
    config: ConfigSource,
    position_m: npt.ArrayLike,
    rate_hz: float | None = None,
    *,
    velocity_m_per_s: npt.ArrayLike | None = None,
) -> Samples:
    """Return the samples, with the rendered forces, for a given path of positions (open loop).

    `config` is the content of a YAML file (materials, device, scene), as a mapping or a path. `position_m` has shape
    (n, 2), one position for each tick, used without encoder, delay or actuator resolution. `rate_hz`, ticks per
    second, is by default the configuration's. `velocity_m_per_s`, shape (n, 2), is used if given; otherwise the
    velocity is estimated (for exact positions: the backward difference). Forces are on from the first sample. If the
    probe starts inside an object, its force rises over the scene's ramp_s.

    Returns (n,) records of SAMPLE_DTYPE. Warns of values that may be in another unit (ImplausibleValue). Raises
    InvalidError, HapticdError.
    """
    run = render_run(config, position_m, rate_hz, velocity_m_per_s=velocity_m_per_s)
    _warn_of(run.implausible)
    return run.samples


def render_run(
    config: ConfigSource,
    position_m: npt.ArrayLike,
    rate_hz: float | None = None,
    *,
    velocity_m_per_s: npt.ArrayLike | None = None,
) -> Run:
    """Render as `render` does; return the samples with the events and warnings of the run."""
    scene = CompiledScene(config, rate_hz)
    positions = _positions(position_m, "position_m")
    count = len(positions)
    velocities = None
    if velocity_m_per_s is not None:
        velocities = _positions(velocity_m_per_s, "velocity_m_per_s")
        if len(velocities) != count:
            raise InvalidError([Problem("velocity_m_per_s", f"must have shape ({count}, 2), has {velocities.shape}")])
    state = scene.new_state(0.0)
    samples = np.empty(count, SAMPLE_DTYPE)
    events = _Recorder().run(
        count,
        lambda part, room, capacity, found: lib.hd_render(
            scene.world,
            state,
            pointer("double[]", positions[part]),
            ffi.NULL if velocities is None else pointer("double[]", velocities[part]),
            ffi.NULL,  # no period is missed
            part.stop - part.start,
            pointer("struct hd_sample[]", samples[part]),
            room,
            capacity,
            found,
        ),
    )
    return scene.run_of(samples, events, None, positions, "position_m")


def simulate(
    config: ConfigSource,
    waypoints: npt.ArrayLike | Mapping[str, object] | str | os.PathLike[str],
    duration_s: float | None = None,
    rate_hz: float | None = None,
    *,
    interpolation: Literal["linear", "minimum_jerk"] | None = None,
) -> Samples:
    """Simulate the closed loop of the tick and the joystick of `config`, whose hand follows `waypoints`.

    `waypoints` are [t_s, x_m, y_m], shape (n, 3), or the content of an operator file (waypoints or a gesture), as a
    mapping or a path. The handle starts at rest at the hand's first reference position. `duration_s` is by default the
    operator's, `rate_hz`, ticks per second, the configuration's.

    Returns (round(duration_s * rate),) records of SAMPLE_DTYPE. Warns of values that may be in another unit, and of
    objects that the handle cannot reach or that hold it deep inside (ImplausibleValue). Raises InvalidError,
    HapticdError.
    """
    run = simulate_run(config, waypoints, duration_s, rate_hz, interpolation=interpolation)
    _warn_of(run.implausible)
    return run.samples


def simulate_run(
    config: ConfigSource,
    waypoints: npt.ArrayLike | Mapping[str, object] | str | os.PathLike[str],
    duration_s: float | None = None,
    rate_hz: float | None = None,
    *,
    interpolation: Literal["linear", "minimum_jerk"] | None = None,
    check_stability: bool = True,
) -> Run:
    """Simulate as `simulate` does; return the samples with events, exact motion of the handle, and warnings.

    Without `check_stability`, which may take longer than the run, the warnings do not include oscillations.
    """
    scene = CompiledScene(config, rate_hz)
    operator = _operator(waypoints, interpolation)
    path = waypoints_of(operator, scene.config)
    lasting_s = _duration(float(path[-1, 0]) if duration_s is None else duration_s, scene.rate_hz)
    unstable = scene.stability().problems() if check_stability else ()
    samples, truth, events = Simulation(scene, path.tolist(), operator.interpolation).run(lasting_s)
    return scene.run_of(samples, events, truth, path[:, 1:], "waypoints", unstable)


def _operator(
    waypoints: npt.ArrayLike | Mapping[str, object] | str | os.PathLike[str],
    interpolation: Literal["linear", "minimum_jerk"] | None,
) -> Operator:
    if isinstance(waypoints, str | os.PathLike | Mapping):
        if interpolation is not None:
            raise InvalidError(
                [Problem("interpolation", "must be a key of the operator given as waypoints, not an argument")]
            )
        return parse_operator(waypoints) if isinstance(waypoints, Mapping) else load_operator(waypoints)
    points = _numbers(waypoints, "waypoints", 3).tolist()
    return parse_operator({"waypoints": points, "interpolation": interpolation or "linear"})
