"""Time of a tick with warm caches: hd_render with the same state, over motions that fit the first-level cache."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.report import Advance, Floats, Options, Section, Table, spread, verdict
from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, CData, Flag, Status, ffi, invalid_reason, lib, pointer, records
from hapticd.config.configuration import load_config
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of
from hapticd.rendering.offline import new_world

RATE_HZ = 10_000.0
STRETCH = 128
"""Number of ticks of a call: 14 KiB of samples and 4 KiB of motion."""
STEP_M = 20e-6
Progress = Callable[[float], None]
"""A function that gets the completed fraction of a measurement."""

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "plain"}
MATERIALS: Mapping[str, object] = {
    "plain": {"stiffness_n_per_m": 800, "damping_n_s_per_m": 1},
    # Rings for ten seconds, so that the mode is active in every tick of a measurement.
    "bell": {
        "stiffness_n_per_m": 800,
        "damping_n_s_per_m": 1,
        "tap": {"attack_slope_per_s": 10, "frequency_hz": 200, "decay_time_s": 2},
    },
}
FIELDS: Mapping[str, object] = {
    "pull": {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 50, "damping_n_s_per_m": 0.5},
    "honey": {"kind": "viscous", "damping_n_s_per_m": 2},
    "push": {"kind": "constant", "force_n": [0, -0.2]},
}
SKIN = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.2, "material": "plain"}


def walls(count: int, material: str) -> dict[str, object]:
    """Return parallel walls, which the probe touches at the same time."""
    return {f"wall{i}": {**FLOOR, "point_m": [0, 1e-4 * i], "material": material} for i in range(count)}


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A closed path and the velocities along it, (n, 2) each; n is a multiple of STRETCH."""

    path_m: Floats
    speeds_m_per_s: Floats


def circle(height_m: float, step_m: float = 0.0) -> Motion:
    """Return a small circle in STRETCH ticks, with positions rounded to `step_m`."""
    turn = 2 * np.pi * np.arange(STRETCH) / STRETCH
    radius = 2e-4
    path = np.stack((radius * np.cos(turn), height_m + radius * np.sin(turn)), 1)
    if step_m:
        path = np.round(path / step_m) * step_m
    speed = radius * 2 * np.pi / STRETCH * RATE_HZ
    return Motion(path, np.stack((-speed * np.sin(turn), speed * np.cos(turn)), 1))


class Stretch:
    """A scene, a state and a motion, which is rendered repeatedly in calls of STRETCH ticks."""

    def __init__(
        self,
        objects: Mapping[str, object],
        motion: Motion | float,
        *,
        materials: Mapping[str, object] = MATERIALS,
        above_m: float = 0.004,
        estimate: bool = False,
        step_m: float = 0.0,
        world: CData | None = None,
    ) -> None:
        """Prepare the calls. A number as `motion` is the height of a small circle.

        At the height `above_m` nothing is touched. `world` has the compiled objects, if they are already compiled.
        """
        if world is None:
            config = load_config({"materials": materials, "scene": {"objects": objects}})
            compiler = Compiler(output_of(config, RATE_HZ))
            world = new_world(compiler.update(config.scene, config.scene.objects, config.materials, 1))
        self.world = world
        self.state = ffi.gc(lib.hd_state_new(max(1, len(objects))), lib.hd_state_free)
        lib.hd_state_set_resolution(self.state, step_m)
        self.motion = motion if isinstance(motion, Motion) else circle(motion, step_m)
        self._above_m = above_m
        self._samples = records(SAMPLE_DTYPE, STRETCH)
        self._events = records(EVENT_DTYPE, 1024)
        self._found = ffi.new("size_t *")
        self._estimate = estimate
        self._begun = False
        self._count = len(self.motion.path_m)
        self._arguments = [
            self._prepare(self.motion.path_m[at : at + STRETCH], self.motion.speeds_m_per_s[at : at + STRETCH])
            for at in range(0, self._count, STRETCH)
        ]

    def _prepare(self, path: Floats, speeds: Floats) -> tuple[Any, ...]:
        return (
            self.world,
            self.state,
            pointer("double[]", path),
            ffi.NULL if self._estimate else pointer("double[]", speeds),
            ffi.NULL,
            len(path),
            pointer("struct hd_sample[]", self._samples),
            pointer("struct hd_event[]", self._events),
            len(self._events),
            self._found,
        )

    def go(self, path_m: Floats, speeds_m_per_s: Floats) -> tuple[npt.NDArray[np.void], npt.NDArray[np.void]]:
        """Render another path, and return its samples and events. Path and velocities have shape (n, 2)."""
        samples, events = [], []
        for at in range(0, len(path_m), STRETCH):
            arguments = self._prepare(path_m[at : at + STRETCH], speeds_m_per_s[at : at + STRETCH])
            if lib.hd_render(*arguments) != Status.OK:
                raise RuntimeError(invalid_reason())
            if self._found[0] > len(self._events):
                raise RuntimeError("too many events for the buffer")
            samples.append(self._samples[: arguments[5]].copy())
            events.append(self._events[: self._found[0]].copy())
        return np.concatenate(samples), np.concatenate(events)

    def enter(self) -> None:
        """Leave all surfaces, and return from above at 0.2 m/s, which causes taps."""
        # A new state begins above: a membrane is touched from the side from which the probe comes.
        first, last = self.motion.path_m[0], self.motion.path_m[-1]
        above = self._above_m
        begin = last[1] if self._begun else above
        self._begun = True
        height = np.concatenate((np.linspace(begin, above, 60), np.linspace(above, first[1], 60)))
        self.go(np.stack((np.full(120, first[0]), height), 1), np.tile([0.0, -0.2], (120, 1)))

    def render(self, rounds: int) -> None:
        """Render the motion `rounds` times."""
        for _ in range(rounds):
            for arguments in self._arguments:
                lib.hd_render(*arguments)

    def timed(self, rounds: int) -> list[float]:
        """Render the motion `rounds` times, and return the time of a tick in ns for each."""
        now, render, calls = time.perf_counter_ns, lib.hd_render, self._arguments
        taken = []
        for _ in range(rounds):
            start = now()
            for arguments in calls:
                render(*arguments)
            taken.append((now() - start) / self._count)
        return taken

    def empty_call(self, calls: int) -> list[float]:
        """Return the time in ns per tick that clock and Python take, from `calls` calls without ticks."""
        arguments = (*self._arguments[0][:5], 0, *self._arguments[0][6:])
        taken = []
        for _ in range(calls):
            start = time.perf_counter_ns()
            lib.hd_render(*arguments)
            taken.append((time.perf_counter_ns() - start) / STRETCH)
        return taken

    def flags(self) -> Flag:
        """Return the flags that every tick of the last call had."""
        return Flag(int(np.bitwise_and.reduce(self._samples["flags"])))


def measured(
    scenes: Mapping[str, Stretch], wanted: Mapping[str, Flag], mask: Flag, rounds: int, ticks: int, progress: Progress
) -> dict[str, list[float]]:
    """Render scenes in turns, and return for each scene the median time of a tick in ns in each round.

    A round has `ticks` ticks. Raises RuntimeError if the flags of a scene in `mask` are not those in `wanted`.
    """
    taken: dict[str, list[float]] = {name: [] for name in scenes}
    for index in range(rounds):
        for name, scene in scenes.items():
            repeats = max(1, ticks // len(scene.motion.path_m))
            scene.enter()
            scene.render(max(1, repeats // 10))
            taken[name].append(float(np.median(scene.timed(repeats))))
            if scene.flags() & mask != wanted[name]:
                raise RuntimeError(f"{name}: flags must be {wanted[name]!r}, are {scene.flags()!r}")
        progress((index + 1) / rounds)
    return taken


def _ticks(options: Options, advance: Advance) -> Table:
    cases: dict[str, tuple[Stretch, Flag, float | None]] = {
        "empty scene": (Stretch({}, 0.01), Flag(0), 30.0),
        "wall out of reach": (Stretch(walls(1, "plain"), 0.01), Flag(0), None),
        "wall in contact": (Stretch(walls(1, "plain"), -0.001), Flag.CONTACT, None),
        "wall in contact and ringing": (Stretch(walls(1, "bell"), -0.001), Flag.CONTACT | Flag.RINGING, 60.0),
        "four walls in contact and ringing": (Stretch(walls(4, "bell"), -0.001), Flag.CONTACT | Flag.RINGING, None),
        "membrane in contact": (Stretch({"skin": SKIN}, -0.001), Flag.CONTACT, None),
        "fields: spring, viscous, constant": (Stretch(FIELDS, 0.01), Flag(0), None),
        "wall in contact, estimator on exact positions": (
            Stretch(walls(1, "plain"), -0.001, estimate=True),
            Flag.CONTACT,
            None,
        ),
        "wall in contact, estimator on 20 um steps": (
            Stretch(walls(1, "plain"), -0.001, estimate=True, step_m=STEP_M),
            Flag.CONTACT,
            None,
        ),
    }
    rounds, calls = options.few(40, 6), options.few(200, 50)
    medians = measured(
        {name: case for name, (case, _, _) in cases.items()},
        {name: wanted for name, (_, wanted, _) in cases.items()},
        Flag.CONTACT | Flag.RINGING,
        rounds,
        calls * STRETCH,
        lambda part: advance(part, "scenes"),
    )
    overhead = [float(np.median(cases["empty scene"][0].empty_call(calls))) for _ in range(rounds)]
    rows = [
        [
            name,
            spread(medians[name], ".1f"),
            "" if aim is None else f"< {aim:g}",
            "" if aim is None else verdict(float(np.median(medians[name])), aim),
        ]
        for name, (_, _, aim) in cases.items()
    ]
    rows.append(["part of each row: the call itself (a call without ticks)", spread(overhead, ".1f"), "", ""])
    return Table(
        f"ns a tick, {rounds} rounds of {calls} calls of {STRETCH} ticks: median of the rounds' medians (10 to 90 %)",
        ["scene", "ns a tick", "aim", "reached"],
        rows,
    )


def _estimator(options: Options, advance: Advance) -> Table:
    count, rounds = 4096, options.few(40, 6)
    time_s = np.arange(count) / RATE_HZ
    interval_s = np.full(count, 1.0 / RATE_HZ)
    turn = 2 * np.pi * time_s
    motions = {
        "at rest": np.zeros((count, 2)),
        "0.1 and 0.3 m/s": np.stack((0.1 * time_s, 0.3 * time_s), 1),
        "circle of 5 cm, 1 Hz": 0.05 * np.stack((np.sin(turn), np.cos(turn)), 1),
    }
    out = np.empty((count, 2))
    rows = []
    for index, (name, truth) in enumerate(motions.items()):
        cells = [name]
        for step_m in (0.0, STEP_M):
            path = np.ascontiguousarray(np.round(truth / STEP_M) * STEP_M if step_m else truth)
            intervals, positions, speeds = (pointer("double[]", array) for array in (interval_s, path, out))
            taken = []
            for _ in range(rounds):
                start = time.perf_counter_ns()
                status = lib.hd_velocity_run(step_m, count, intervals, positions, speeds, ffi.NULL)
                taken.append((time.perf_counter_ns() - start) / count)
                if status != Status.OK:
                    raise RuntimeError(invalid_reason())
            cells.append(spread(taken, ".1f"))
        rows.append(cells)
        advance((index + 1) / len(motions), "estimator")
    return Table(
        f"The velocity estimator alone: ns for an update of both axes, {rounds} runs of {count} updates (10 to 90 %)",
        ["motion", "exact positions", "20 um steps"],
        rows,
    )


def run(options: Options, advance: Advance) -> Section:
    """Return the section with the time of a tick and of the velocity estimator."""
    return Section(
        "Work per tick",
        [
            "Time of `hd_render`, called from Python: its loop, the tick, and the 112-byte sample that it writes. "
            "State and memory are warm. There is no clock and no device; velocities are given, unless the row names "
            "the estimator. Nothing is subtracted: the last row shows how much of each other row is the call itself.",
            _ticks(options, lambda part, what: advance(0.9 * part, what)),
            _estimator(options, lambda part, what: advance(0.9 + 0.1 * part, what)),
        ],
    )
