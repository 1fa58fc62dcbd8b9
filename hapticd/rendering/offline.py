"""Rendering without a daemon: the servo's own tick, without clock, thread or I/O.

`render` takes positions and gives forces (open loop); `simulate` closes the loop with the simulated joystick. The same
input gives the same bits on every run.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
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
from hapticd.base.model import problems_of
from hapticd.config.configuration import Config, ConfigSource, Servo, load_config
from hapticd.config.materials import Materials
from hapticd.config.modes import Attack, Mode
from hapticd.config.operator import Operator, load_operator, parse_operator
from hapticd.config.scene import Scene
from hapticd.rendering.compiler.mode_record import mode_record
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import Output, loop_of, output_of
from hapticd.rendering.displayability import materials_in, rate_faults, undisplayable, warnings
from hapticd.rendering.joystick import new_operator, new_sim, way_of
from hapticd.rendering.scene_stability import Stability, evaluate
from hapticd.rendering.undisplayable_text import Undisplayable

Samples: TypeAlias = npt.NDArray[np.void]
"""Shape (n,), dtype `hapticd.SAMPLE_DTYPE`: one record a tick, with the fields and units of telemetry."""

Events: TypeAlias = npt.NDArray[np.void]
"""Shape (m,), dtype `hapticd.base.core.EVENT_DTYPE`."""
Floats: TypeAlias = npt.NDArray[np.float64]

MAX_DURATION_S = 3600.0


@dataclass(frozen=True, slots=True)
class Run:
    """What a run gave."""

    samples: Samples
    """(n,) records, one a tick."""
    events: Events
    objects: dict[tuple[int, int], str]
    """Ids of the objects that events speak of, by their slot and generation."""
    truth: Floats | None
    """(n, 4) the simulated handle's own position (m) and velocity (m/s) at each tick; None for `render`."""
    undisplayable: tuple[Undisplayable, ...]
    """Modes and peaks of textures of the scene that this rate cannot carry."""
    warnings: tuple[Problem, ...]
    """What of the scene is displayed otherwise than it was meant, at this rate; in the closed loop also what may
    oscillate."""
    rate_hz: float
    """Ticks per second."""


class CompiledScene:
    """A configuration, compiled for a rate, by default its own. Raises InvalidError for what no signal of it has."""

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
        state = new_state_of(len(self.config.scene.objects))
        lib.hd_state_set_resolution(state, resolution_m)
        return state

    def stability(self) -> Stability:
        """Which sets of objects are not safe with the simulated joystick, whatever the configuration's device is."""
        device = self.config.device.model_copy(update={"kind": "sim"})
        loop = loop_of(self.config.model_copy(update={"device": device}), self.rate_hz)
        assert loop is not None
        return evaluate(self._compiler, self.config.scene, loop)

    def run_of(self, samples: Samples, events: Events, truth: Floats | None, unstable: Iterable[Problem] = ()) -> Run:
        """A run that gave this, with what of the scene it did not display as it was meant."""
        objects, materials = self.config.scene.objects, self.config.materials
        return Run(
            samples,
            events,
            {place: id for id in objects if (place := self._compiler.slot_of(id)) is not None},
            truth,
            tuple(undisplayable(materials_in(objects, materials), self.output)),
            (*warnings(objects, materials, self.output), *unstable),
            self.rate_hz,
        )


def new_state_of(slots: int) -> CData:
    """A `struct hd_state *` with room for so many objects at once, freed with the last reference to it."""
    state = lib.hd_state_new(max(1, slots))
    if state == ffi.NULL:
        raise MemoryError("no memory for the state of a run")
    return ffi.gc(state, lib.hd_state_free)


def new_world(table: CData) -> CData:
    """A `struct hd_world *` that holds a table, freed with the last reference to it. Raises HapticdError."""
    made = lib.hd_world_new()
    if made == ffi.NULL:
        raise MemoryError("no memory for a world")
    world = ffi.gc(made, lib.hd_world_free)
    status = lib.hd_world_load(world, table)
    if status == Status.ERR_MEMORY:
        raise MemoryError("no memory for a scene")
    if status != Status.OK:
        raise HapticdError(f"the scene cannot be rendered: {invalid_reason()}")
    return world


def _rate(rate_hz: float) -> float:
    try:
        return Servo.parsed({"rate_hz": rate_hz}).rate_hz
    except ValidationError as error:
        raise InvalidError(problems_of(error)) from None


class _Recorder:
    """Runs in stretches, each with room for as many events as its ticks can have, and keeps what there were."""

    STRETCH = 4096
    EVENTS_PER_TICK = 256

    def __init__(self) -> None:
        self._room = records(EVENT_DTYPE, self.STRETCH * self.EVENTS_PER_TICK)
        self._room_pointer = pointer("struct hd_event[]", self._room)
        self._count = ffi.new("size_t *")
        self._taken: list[Events] = []

    def run(self, count: int, stretch: Callable[[slice, CData, int, CData], int]) -> Events:
        """Calls `stretch` for each slice of `count` ticks; the events of all of them."""
        for start in range(0, count, self.STRETCH):
            part = slice(start, min(count, start + self.STRETCH))
            status = stretch(part, self._room_pointer, len(self._room), self._count)
            if status == Status.ERR_MEMORY:
                raise MemoryError("no memory for a run")
            if status != Status.OK:
                raise HapticdError(f"the scene cannot be rendered: {invalid_reason()}")
            if self._count[0]:
                self._taken.append(self._room[: self._count[0]].copy())
        taken, self._taken = self._taken, []
        return np.concatenate(taken) if taken else self._room[:0].copy()


class Rerun:
    """Renders ticks of a servo again, from what their samples say that each was given; the scene may change between.

    As the servo's own tick they go on from what was before: contacts, modes, punctures. `restart` forgets it.
    """

    def __init__(self, output: Output, slots: int) -> None:
        """`slots`: room for so many objects at once."""
        self._output = output
        self._compiler = Compiler(output)
        self._slots = slots
        self._recorder = _Recorder()
        self._world: CData | None = None
        self.restart(False)

    def restart(self, muted: bool) -> None:
        """From here on as if nothing had been before; `muted`: the command comes in over the ramp."""
        self._state = new_state_of(self._slots)
        if muted:
            lib.hd_state_mute(self._state)

    def change_rate(self, output: Output) -> None:
        """Another output from the next `turn_to` on, which comes before any tick."""
        self._output = output
        self._compiler.turn_to(output)

    def turn_to(self, scene: Scene, changed: Iterable[str], materials: Materials, revision: int) -> None:
        """Takes a validated scene, of which the objects `changed` are not those of the scene before. Events
        of the ticks before have no names from then on."""
        self._compiler.events_read((revision - 1) & 0xFFFFFFFF)
        self._world = new_world(self._compiler.update(scene, changed, materials, revision))

    def play(self, mode: Mode, attack: Attack, direction: tuple[float, float], amplitude_m_per_s2: float) -> None:
        """Strikes a mode at the next tick, as the daemon's `play` does."""
        _play(self._state, self._output, mode, mode.coefficient(1.0, attack), direction, amplitude_m_per_s2)

    def reset(self, objects: Iterable[str] | None, time_ns: int) -> None:
        """Clears contact state at the next tick, which has this time, as the daemon's `reset` does."""
        places = [(NO_SLOT, 0)] if objects is None else map(self._compiler.slot_of, objects)
        for place in places:
            if place is not None:
                lib.hd_state_reset(self._state, *place, time_ns)

    def name_of(self, event: npt.NDArray[np.void] | np.void) -> str | None:
        """The id of the object that an event speaks of."""
        return self._compiler.name_of(int(event["slot"]), int(event["generation"]))

    def run(self, recorded: Samples, interval_s: Floats, periods: npt.NDArray[np.uint32]) -> tuple[Samples, Events]:
        """The samples and events of (n,) recorded ticks; `interval_s`, (n,): between the report of a tick and the one
        before, 0: none came; `periods`, (n,): since the tick before."""
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
    """The closed loop of the tick and the simulated joystick, which goes on where it was. Raises HapticdError for what
    cannot be rendered."""

    def __init__(
        self,
        scene: CompiledScene,
        waypoints: Sequence[Sequence[float]] | None = None,
        interpolation: Literal["linear", "minimum_jerk"] = "linear",
    ) -> None:
        """`waypoints` are rows [t_s, x_m, y_m] of the hand, where the handle starts at rest; None: it stays where it
        is."""
        sim = scene.config.device.sim
        self._scene, self._recorder = scene, _Recorder()
        self._state, self._sim = scene.new_state(sim.encoder_step_m), new_sim(sim, scene.rate_hz)
        if waypoints is not None:
            self._hand = new_operator(waypoints, interpolation)
            lib.hd_sim_operate(self._sim, self._hand)
            lib.hd_sim_settle(self._sim)

    def strike(self, mode: Mode, coefficient_m_per_s2: float, direction: tuple[float, float]) -> None:
        """Strikes a mode at the next tick."""
        _play(self._state, self._scene.output, mode, 1.0, direction, coefficient_m_per_s2)

    def advance(self, duration_s: float) -> Floats:
        """The handle's own position (m) and velocity (m/s) at the ticks to come, (n, 4)."""
        return self.run(duration_s)[1]

    def run(self, duration_s: float) -> tuple[Samples, Floats, Events]:
        """Samples, (n,), the handle's own motion as of advance, (n, 4), and events of the ticks to come, one at least."""
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
    """Real numbers, shape (n, columns); whether they are finite is not asked here."""
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


def render(
    config: ConfigSource,
    position_m: npt.ArrayLike,
    rate_hz: float | None = None,
    *,
    velocity_m_per_s: npt.ArrayLike | None = None,
) -> Samples:
    """Forces for a path of positions, open loop.

    `config` is what a YAML file holds, as a mapping or a path (materials, device, scene). `position_m` has shape
    (n, 2), one position a tick, taken as it is: no encoder, no delay, no actuator resolution. `rate_hz`, ticks per
    second, is by default the configuration's. `velocity_m_per_s`, shape (n, 2), is used where the caller knows it;
    otherwise it is estimated (exact positions: the backward difference). Forces are on from the first sample; a probe
    that starts inside an object comes in over the scene's ramp_s.

    Returns (n,) records of SAMPLE_DTYPE. Raises InvalidError, HapticdError.
    """
    return render_run(config, position_m, rate_hz, velocity_m_per_s=velocity_m_per_s).samples


def render_run(
    config: ConfigSource,
    position_m: npt.ArrayLike,
    rate_hz: float | None = None,
    *,
    velocity_m_per_s: npt.ArrayLike | None = None,
) -> Run:
    """As `render`, with the events."""
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
            ffi.NULL,  # no period was missed
            part.stop - part.start,
            pointer("struct hd_sample[]", samples[part]),
            room,
            capacity,
            found,
        ),
    )
    return scene.run_of(samples, events, None)


def simulate(
    config: ConfigSource,
    waypoints: npt.ArrayLike | Mapping[str, object] | str | os.PathLike[str],
    duration_s: float | None = None,
    rate_hz: float | None = None,
    *,
    interpolation: Literal["linear", "minimum_jerk"] | None = None,
) -> Samples:
    """The closed loop of the tick and the simulated joystick of `config`, whose hand follows `waypoints`.

    `waypoints` are [t_s, x_m, y_m], shape (n, 3), or what an operator file holds (waypoints or a gesture), as a mapping
    or a path. The handle starts at rest where the hand first wants to be. `duration_s` is by default the operator's,
    `rate_hz`, ticks per second, the configuration's.

    Returns (round(duration_s * rate),) records of SAMPLE_DTYPE. Raises InvalidError, HapticdError.
    """
    return simulate_run(config, waypoints, duration_s, rate_hz, interpolation=interpolation).samples


def simulate_run(
    config: ConfigSource,
    waypoints: npt.ArrayLike | Mapping[str, object] | str | os.PathLike[str],
    duration_s: float | None = None,
    rate_hz: float | None = None,
    *,
    interpolation: Literal["linear", "minimum_jerk"] | None = None,
    check_stability: bool = True,
) -> Run:
    """As `simulate`, with the events and the handle's true motion.

    Without `check_stability`, which may take longer than the run, the warnings say nothing of what may oscillate.
    """
    scene = CompiledScene(config, rate_hz)
    operator = _operator(waypoints, interpolation)
    way = way_of(operator, scene.config)
    lasting_s = _duration(float(way[-1, 0]) if duration_s is None else duration_s, scene.rate_hz)
    unstable = scene.stability().problems() if check_stability else ()
    samples, truth, events = Simulation(scene, way.tolist(), operator.interpolation).run(lasting_s)
    return scene.run_of(samples, events, truth, unstable)


def _operator(
    waypoints: npt.ArrayLike | Mapping[str, object] | str | os.PathLike[str],
    interpolation: Literal["linear", "minimum_jerk"] | None,
) -> Operator:
    if isinstance(waypoints, str | os.PathLike | Mapping):
        if interpolation is not None:
            raise InvalidError([Problem("interpolation", "belongs to the operator's own keys here")])
        return parse_operator(waypoints) if isinstance(waypoints, Mapping) else load_operator(waypoints)
    points = _numbers(waypoints, "waypoints", 3).tolist()
    return parse_operator({"waypoints": points, "interpolation": interpolation or "linear"})
