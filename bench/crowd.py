"""Cost of a tick in a scene of many objects, and cost of compiling the scene and of changing one object.

The crowd of objects is dense: small boxes and discs on a lattice over the entire workspace, or parallel walls below
each other. The probe strokes along a free lane, on three surfaces. tests/tick/test_reach.py asserts that only these
three surfaces exert a force.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bench.features import strokes
from bench.report import Advance, Options, Section, Table, spread, verdict
from bench.tick import FLOOR, MATERIALS, RATE_HZ, STRETCH, Motion, Stretch, measured
from hapticd.base.core import CData, Flag
from hapticd.base.yaml_source import load_bytes
from hapticd.config.configuration import load_config
from hapticd.config.scene import load_scene, validate_object
from hapticd.daemon.engine import Engine
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of
from hapticd.rendering.offline import new_world

COUNTS = (1, 10, 100, 1000, 10_000)
TOUCHED = 3
"""Number of objects that are touched."""
PITCH_M = 2e-3
SIZE_M = 5e-4
DEPTH_M = 2e-4
ABOVE_M = 5e-4
"""Height in the lane at which the probe touches nothing."""
LANE_M = 1e-3
"""Minimum half width of the lane: with three surfaces pressed by 0.2 mm, the reach of a tick at 1 m/s is 0.8 mm."""
FAR_M = 0.03
MOTIONS: Mapping[str, Motion] = {
    "at rest": strokes(1, 0.0, -0.02, -DEPTH_M),
    "0.1 m/s": strokes(64, 0.1, -0.02, -DEPTH_M),
    "1 m/s": strokes(8, 1.0, -0.025, -DEPTH_M),
}

FLOOR_BOX = {"kind": "box", "center_m": [0, -5e-4], "size_m": [0.2, 1e-3], "material": "plain"}

Objects = dict[str, object]


def _small(index: int, x: float, y: float) -> Objects:
    if index % 2:
        return {"kind": "disc", "center_m": [x, y], "radius_m": SIZE_M / 2, "material": "plain"}
    angle = 0.7 * index % 6.0
    size = [SIZE_M, SIZE_M / 2]
    return {"kind": "box", "center_m": [x, y], "size_m": size, "angle_rad": angle, "material": "plain"}


def spread_out(count: int, free_m: float = LANE_M) -> Objects:
    """Return boxes and discs at random points of a lattice, more than `free_m` from the middle of the lane."""
    lines = (np.arange(100) - 49.5) * PITCH_M
    columns, rows = (each.ravel() for each in np.meshgrid(lines, lines + np.copysign(free_m, lines)))
    chosen = np.random.default_rng(7).permutation(len(columns))[:count]
    return {f"o{i}": _small(int(i), float(columns[i]), float(rows[i])) for i in chosen}


def below(count: int) -> Objects:
    """Return parallel walls in the 0.1 m below the lane, beyond the reach of a tick."""
    return {f"w{i}": {**FLOOR, "point_m": [0, -3e-3 - 1e-5 * i]} for i in range(count)}


def floors(count: int) -> Objects:
    """Return overlapping broad boxes below the lane, whose upper faces have a distance of 20 um."""
    return {f"floor{i}": {**FLOOR_BOX, "center_m": [0, -5e-4 - 2e-5 * i]} for i in range(count)}


def stacked_walls(count: int) -> Objects:
    """Return parallel walls below the lane with a distance of 20 um."""
    return {f"floor{i}": {**FLOOR, "point_m": [0, -2e-5 * i]} for i in range(count)}


@dataclass(frozen=True, slots=True)
class Arrangement:
    """The objects that are touched, and the others."""

    touched: Callable[[int], Objects]
    others: Callable[[int], Objects]

    def __call__(self, count: int) -> Objects:
        """Return `count` objects, of which at most TOUCHED are touched."""
        near = min(count, TOUCHED)
        return {**self.others(count - near), **self.touched(near)}


ARRANGEMENTS = {"boxes and discs": Arrangement(floors, spread_out), "walls": Arrangement(stacked_walls, below)}


def _measure(
    scenes: Mapping[str, Stretch], wanted: Flag, rounds: int, times: int, advance: Advance
) -> dict[str, list[float]]:
    """Return for each scene the time of a tick in ns, one for each round."""
    ticks = times * 64 * STRETCH
    flags = dict.fromkeys(scenes, wanted)
    return measured(scenes, flags, Flag.CONTACT, rounds, ticks, lambda part: advance(part, "objects"))


def _touched(options: Options, advance: Advance) -> Table:
    rounds, times = options.few(20, 3), options.few(20, 3)
    scenes = {
        f"{name}, {way}, {count}": Stretch(arrange(count), motion, above_m=ABOVE_M)
        for name, arrange in ARRANGEMENTS.items()
        for way, motion in MOTIONS.items()
        for count in COUNTS
    }
    taken = _measure(scenes, Flag.CONTACT, rounds, times, advance)
    rows = []
    for name in ARRANGEMENTS:
        for way in MOTIONS:
            costs = {count: taken[f"{name}, {way}, {count}"] for count in COUNTS}
            ratio = np.divide(costs[COUNTS[-1]], costs[10])
            cells = [f"{float(np.median(costs[count])):.1f}" for count in COUNTS]
            reached = verdict(float(np.median(ratio)), 1.3)
            rows.append([f"{name}, {way}", *cells, spread(ratio, ".2f"), reached])
    return Table(
        f"ns a tick with three objects in contact (in a crowd of one: one), {rounds} interleaved rounds, each of "
        f"{times * 64 * STRETCH} ticks",
        ["crowd", *(f"{count:,}" for count in COUNTS), "10,000 / 10 (10 to 90 %)", "ratio <= 1.3"],
        rows,
    )


def _untouched(options: Options, advance: Advance) -> Table:
    rounds, times = options.few(20, 3), options.few(20, 3)
    many = COUNTS[-1]
    crowds: dict[str, Objects] = {
        "none": {},
        "one wall, 0.2 mm below": {"w": {**FLOOR, "point_m": [0, -2 * DEPTH_M]}},
        "10,000 walls, from 2.8 mm below": below(many),
        "10,000 boxes and discs, 30 mm away": spread_out(many, FAR_M),
        "10,000 boxes and discs, around": spread_out(many),
    }
    scenes = {
        f"{name}, {way}": Stretch(objects, motion, above_m=ABOVE_M)
        for name, objects in crowds.items()
        for way, motion in MOTIONS.items()
    }
    taken = _measure(scenes, Flag(0), rounds, times, advance)
    rows = []
    for name in crowds:
        cells = [name]
        for way in MOTIONS:
            more = np.subtract(taken[f"{name}, {way}"], taken[f"none, {way}"])
            cost = f"{float(np.median(taken[f'{name}, {way}'])):.1f}"
            cells.append(cost if name == "none" else f"{cost}; {spread(more, '+.1f')}")
        rows.append(cells)
    return Table(
        "ns a tick without contact; difference to an empty scene, round by round (10 to 90 %)",
        ["objects", *MOTIONS],
        rows,
    )


def _taken(work: Callable[[], object], rounds: int) -> list[float]:
    """Return the durations of `rounds` calls of `work`, in s."""
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return taken


RAISED = {**FLOOR_BOX, "center_m": [0, -4.8e-4]}
"""The first box of `floors`, raised by 20 um."""


def _compile(options: Options, advance: Advance) -> Table:
    rounds, updates = options.few(15, 3), options.few(1000, 100)
    objects = ARRANGEMENTS["boxes and discs"](COUNTS[-1])
    text = json.dumps({"objects": objects}, indent=1).encode()
    document = load_bytes(text, "crowd.yaml").data
    config = load_config({"materials": MATERIALS, "scene": {"objects": objects}})
    output = output_of(config, RATE_HZ)

    def compiled(compiler: Compiler) -> CData:
        return compiler.update(config.scene, config.scene.objects, config.materials, 1)

    def compile_all() -> None:
        compiler = Compiler(output)  # kept, since it owns the table
        new_world(compiled(compiler))

    kept = Compiler(output)
    table = compiled(kept)

    work: dict[str, tuple[Callable[[], object], float | None]] = {
        "compile, from validated models to the servo's table": (compile_all, 200.0),
        "of it: the table, in Python": (lambda: compiled(Compiler(output)), None),
        "of it: checks, copy and index, in C": (lambda: new_world(table), None),
        "before it: validation of plain data": (lambda: load_scene({"objects": objects}), None),
        "before that: reading YAML text": (lambda: load_bytes(text, "crowd.yaml"), None),
    }
    if document != {"objects": objects}:
        raise RuntimeError("the YAML text differs from the objects")
    rows = []
    for name, (each, aim) in work.items():
        slow = each is work["before that: reading YAML text"][0]
        taken = _taken(each, 1 if slow else rounds)
        reached = "" if aim is None else verdict(1e3 * float(np.median(taken)), aim)
        rows.append([name, f"{spread(taken, '.3g', 1e3)} ms", "" if aim is None else f"< {aim:g} ms", reached])
        advance(0.7 * (len(rows)) / len(work), "compiling")
    # The engine accepts updates although it is not started.
    engine = Engine(config)
    places = [validate_object("floor0", each) for each in (RAISED, FLOOR_BOX)]
    taken = []
    for index in range(updates):
        start = time.perf_counter()
        changed = {"floor0": places[index % 2]}
        engine.take(engine.scene.with_objects(changed), engine.materials, changed)
        taken.append(time.perf_counter() - start)
    rows.append(["update of one object, from its validated model", f"{spread(taken, '.3g', 1e6)} us", "", ""])
    advance(1.0, "updating")
    return Table(
        f"10,000 boxes and discs, {rounds} runs (one of reading YAML), {updates} updates: median (10 to 90 %)",
        ["work", "time", "aim", "reached"],
        rows,
    )


def run(options: Options, advance: Advance) -> Section:
    """Return the section with costs of ticks, compilation and updates."""
    return Section(
        "Crowds",
        [
            "Time of `hd_render`, as above. The probe is 0.2 mm deep in three surfaces or touches nothing; it rests or "
            "strokes to and fro over 41 mm (at 1 m/s 51 mm). Boxes and discs of 0.5 mm lie on a lattice with a spacing "
            "of 2 mm over 0.2 by 0.2 m, the nearest 1.5 mm away; smaller crowds are drawn from the same lattice. "
            "Parallel walls have a spacing of 10 um, the first 2.8 mm below the probe.",
            _touched(options, lambda part, what: advance(0.5 * part, what)),
            _untouched(options, lambda part, what: advance(0.5 + 0.3 * part, what)),
            _compile(options, lambda part, what: advance(0.8 + 0.2 * part, what)),
        ],
    )
