"""What goes on at another rate: tables, the simulated joystick; and how often times were how long."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.base.core import HISTOGRAM_EDGES_NS, MATERIAL_DTYPE, NOISE_DTYPE, OBJECT_DTYPE, ffi, lib, pointer
from hapticd.config.configuration import Sim, load_config
from hapticd.daemon.engine import Engine
from hapticd.daemon.status_text import quantile_ns
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of
from hapticd.rendering.joystick import new_operator, new_sim, set_rate

SCENE = {
    "objects": {
        "floor": {
            "kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood",
            "patches": [{"from_m": 0.0, "to_m": 0.05, "material": "comb"}],
        },
        "paper": {"kind": "box", "center_m": [0.05, 0.02], "size_m": [0.02, 0.01], "material": "sandpaper_100"},
        "skin": {"kind": "membrane", "center_m": [0, 0.03], "normal": [0, 1], "width_m": 0.1, "material": "cellophane"},
        "honey": {"kind": "viscous", "damping_n_s_per_m": 2},
    }
}  # fmt: skip


def rows(pointed: object, count: int, dtype: np.dtype[np.void]) -> list[dict[str, object]]:
    array = np.frombuffer(ffi.buffer(pointed, count * dtype.itemsize), dtype)
    versions = ("pose_version", "surface_version", "version", "generation")
    return [{name: plain(row[name]) for name in dtype.names or () if name not in versions} for row in array]


def plain(value: object) -> object:
    """A record's value without numpy: a structure as a map, an array as a list."""
    if isinstance(value, np.void):
        return {name: plain(value[name]) for name in value.dtype.names or ()}
    if isinstance(value, np.ndarray):
        return [plain(entry) for entry in value]
    return value.item() if isinstance(value, np.generic) else value


def test_a_table_turned_to_another_rate_is_the_one_that_is_made_for_it() -> None:
    config = load_config({"scene": SCENE})
    turned, fresh = Compiler(output_of(config, 10_000)), Compiler(output_of(config, 2500))
    ids = list(SCENE["objects"])
    first = turned.update(config.scene, ids, config.materials, 1)
    generations = [first.objects[slot].generation for slot in range(first.object_count)]
    skins = [first.objects[slot].surface_version for slot in range(first.object_count)]
    turned.published()
    turned.turn_to(output_of(config, 2500))
    one = turned.update(config.scene, (), config.materials, 2)
    other = fresh.update(config.scene, ids, config.materials, 2)
    assert one.all_changed == 1
    for name in ("period_s", "ramp_s", "ramp_step", "brake_n_s_per_m", "report_age", "object_count", "material_count",
                 "piece_count", "noise_count", "number_count"):  # fmt: skip
        assert getattr(one, name) == getattr(other, name), name
    for name, count, dtype in (("objects", one.object_count, OBJECT_DTYPE), ("materials", one.material_count,
            MATERIAL_DTYPE), ("noises", one.noise_count, NOISE_DTYPE)):  # fmt: skip
        assert rows(getattr(one, name), count, dtype) == rows(getattr(other, name), count, dtype), name
    numbers = [ffi.unpack(table.numbers, table.number_count) for table in (one, other)]
    assert numbers[0] == numbers[1]
    # Who is where stays, and the surfaces are others.
    assert [one.objects[slot].generation for slot in range(one.object_count)] == generations
    assert all(one.objects[slot].surface_version != skin for slot, skin in enumerate(skins))


def test_the_simulated_joystick_goes_on_at_another_rate() -> None:
    """Half of a movement at 10 kHz and half at 2 kHz end where a whole one at 2 kHz ends: its hand follows the same
    path in the same time."""
    sim = Sim(encoder_step_m=0.0)
    path = new_operator([[0, 0, 0], [0.1, 0.02, -0.01], [0.3, -0.03, 0.02]], "minimum_jerk")
    pair = [new_sim(sim, 10_000), new_sim(sim, 2000)]
    for joystick in pair:
        lib.hd_sim_operate(joystick, path)
    lib.hd_sim_advance(pair[0], 1500)
    lib.hd_sim_advance(pair[1], 300)
    set_rate(pair[0], sim, 2000)
    for _ in range(200):
        for joystick in pair:
            lib.hd_sim_advance(joystick, 1)
    found = []
    for joystick in pair:
        position, velocity, force = (np.zeros(2) for _ in range(3))
        lib.hd_sim_truth(joystick, *(pointer("double[]", array) for array in (position, velocity, force)))
        found.append(position)
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
    reading = ffi.new("struct hd_reading *")
    for _ in range(2):
        lib.hd_sim_advance(pair[0], 1)
        lib.hd_sim_read(pair[0], reading)
    assert reading.interval_s == pytest.approx(1 / 2000, abs=1e-9)


def test_histograms_count_every_tick() -> None:
    engine = Engine(load_config({"servo": {"realtime": "off", "rate_hz": 1000}}))
    engine.start()
    while engine.counters().ticks < 300:
        engine.wait_revision(engine.take(engine.scene.with_objects({}), engine.materials))
    engine.stop()
    counters = engine.counters()
    for histogram in engine.histograms():
        assert sum(histogram.counts) == counters.ticks
        assert len(histogram.counts) == len(histogram.edges_ns) + 1
        least = [0, *HISTOGRAM_EDGES_NS]
        most = [*HISTOGRAM_EDGES_NS, histogram.max_ns]
        low = sum(count * edge for count, edge in zip(histogram.counts, least, strict=True))
        high = sum(count * edge for count, edge in zip(histogram.counts, most, strict=True))
        assert low <= histogram.sum_ns <= high
        assert histogram.max_ns >= max(edge for edge, count in zip(least, histogram.counts, strict=True) if count)


def test_quantiles_lie_in_the_bin_of_the_true_one() -> None:
    times = np.random.default_rng(4).lognormal(np.log(20_000), 1.0, 10_000)
    counts = np.bincount(np.searchsorted(HISTOGRAM_EDGES_NS, times, "right"), minlength=len(HISTOGRAM_EDGES_NS) + 1)
    histogram = {"edges": list(HISTOGRAM_EDGES_NS), "counts": counts.tolist(), "max": int(times.max())}
    for part in (0.01, 0.5, 0.9, 0.99, 0.999):
        true = float(np.quantile(times, part))
        assert quantile_ns(histogram, part) == pytest.approx(true, rel=0.26)
    assert quantile_ns(histogram, 1.0) <= times.max()
    assert quantile_ns({**histogram, "counts": [0] * len(counts), "max": 0}, 0.5) == 0
