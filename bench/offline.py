"""Ticks per second of hapticd.render and hapticd.simulate, as a user calls them, without a clock."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import hapticd
from bench.report import Advance, Options, Section, Table, spread, verdict
from bench.tick import RATE_HZ, STEP_M
from hapticd.base.core import EVENT_DTYPE, Status, ffi, invalid_reason, lib, pointer, records
from hapticd.config.configuration import load_config
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of
from hapticd.rendering.offline import new_world

CONFIG = {"scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}}}}


def run(options: Options, advance: Advance) -> Section:
    """Measure ticks per second, and return the section."""
    count, rounds = options.few(1_000_000, 100_000), options.few(9, 3)
    turn = 2 * np.pi * 2.0 * np.arange(count) / RATE_HZ
    path = np.stack((0.01 * np.cos(turn), 0.004 * np.sin(turn)), 1)
    speeds = 2 * np.pi * 2.0 * np.stack((-0.01 * np.sin(turn), 0.004 * np.cos(turn)), 1)
    quantised = np.ascontiguousarray(np.round(path / STEP_M) * STEP_M)
    compiled = load_config(CONFIG)
    compiler = Compiler(output_of(compiled, RATE_HZ))
    world = new_world(compiler.update(compiled.scene, compiled.scene.objects, compiled.materials, 1))
    samples = np.zeros(count, hapticd.SAMPLE_DTYPE)
    events = records(EVENT_DTYPE, 8 * 4096)

    def c_call() -> None:
        state = ffi.gc(lib.hd_state_new(1), lib.hd_state_free)
        lib.hd_state_set_resolution(state, STEP_M)
        status = lib.hd_render(
            world,
            state,
            pointer("double[]", quantised),
            ffi.NULL,
            ffi.NULL,
            count,
            pointer("struct hd_sample[]", samples),
            pointer("struct hd_event[]", events),
            len(events),
            ffi.new("size_t *"),
        )
        if status != Status.OK:
            raise RuntimeError(invalid_reason())

    seconds = count / RATE_HZ
    strokes = [[0.25 * i, 0.01 * (-1) ** i, 0.004 * (-1) ** i] for i in range(int(4 * seconds) + 1)]
    cases: dict[str, tuple[Callable[[], object], float | None]] = {
        "hapticd.render, velocities given": (
            lambda: hapticd.render(CONFIG, path, RATE_HZ, velocity_m_per_s=speeds),
            15.0,
        ),
        "hapticd.render, velocities estimated from exact positions": (
            lambda: hapticd.render(CONFIG, path, RATE_HZ),
            None,
        ),
        "hd_render with the estimator on 20 um steps": (c_call, 4.0),
        "hapticd.simulate (20 um steps, friction, a hand that taps)": (
            lambda: hapticd.simulate(CONFIG, strokes, seconds, RATE_HZ),
            None,
        ),
    }
    rates: dict[str, list[float]] = {name: [] for name in cases}
    for case, _ in cases.values():
        case()
    for index in range(rounds):
        for name, (case, _) in cases.items():
            start = time.perf_counter()
            case()
            rates[name].append(count / (time.perf_counter() - start) / 1e6)
        advance((index + 1) / rounds, "render and simulate")
    rows = [
        [
            name,
            spread(rates[name], ".1f"),
            f"{1e3 / np.median(rates[name]):.0f}",
            "" if aim is None else f"> {aim:g}",
            "" if aim is None else verdict(float(np.median(rates[name])), aim, above=True),
        ]
        for name, (_, aim) in cases.items()
    ]
    return Section(
        "Offline",
        [
            "The probe enters and leaves one wooden wall twice a second and is in contact half of the time. The Python "
            "calls include reading the configuration, compiling the scene and allocating the result (112 bytes a "
            "tick).",
            Table(
                f"Million ticks a second, {count} ticks, {rounds} runs: median (10 to 90 %)",
                ["call", "Mticks/s", "ns a tick", "aim", "reached"],
                rows,
            ),
        ],
    )
