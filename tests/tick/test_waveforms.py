"""Taps that are waveforms: the curve between its samples, in Python and in the tick, and what a rate makes of it."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import MAX_WAVEFORM_SAMPLES, EventKind, lib
from hapticd.base.errors import InvalidError
from hapticd.config.configuration import load_config
from hapticd.config.materials import validate_materials
from hapticd.config.waveform import Curve, Waveform
from hapticd.recording.replay import replay
from hapticd.recording.simulated import simulate_files
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import material_warnings, undisplayable, warnings
from hapticd.rendering.offline import render_run, simulate_run
from tests.support.rig import FLOOR, Rig

Floats = npt.NDArray[np.float64]
PULSE = [0.0, 0.4, 1.0, 0.7, 0.2, -0.15, -0.05, 0.0]
RATES = [1000, 2000, 4000, 5000, 8000, 10_000]


def by_kernel(samples: npt.ArrayLike, place: npt.ArrayLike) -> Floats:
    """The curve as a sum of Keys' convolution kernel (a = -1/2) over the samples, at `place` in samples."""
    given, at = np.asarray(samples, dtype=float), np.asarray(place, dtype=float)
    x = np.abs(at[..., None] - np.arange(len(given)))
    near, far = 1.5 * x**3 - 2.5 * x**2 + 1, -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
    kernel = np.where(x <= 1, near, np.where(x <= 2, far, 0.0))
    return np.where((at >= 0) & (at <= len(given) - 1), kernel @ given, 0.0)


def material(samples: Any = PULSE, rate_hz: Any = 2000.0, **tap: object) -> dict[str, Any]:
    waveform = {"rate_hz": rate_hz, "samples": np.asarray(samples, dtype=float).tolist()}
    law = {} if "amplitudes" in tap else {"attack_slope_per_s": 200.0}
    return {"stiffness_n_per_m": 100.0, "tap": {**law, "waveform": waveform, **tap}}


def some_samples(rng: np.random.Generator, count: int) -> Floats:
    return np.concatenate(([0.0], rng.uniform(-1, 1, count - 2), [0.0]))


def struck(
    made: dict[str, Any],
    speed: float = 0.3,
    rate_hz: float = 10_000,
    above_m: float = 0.00123,
    ticks: int = 600,
    normal: tuple[float, float] = (0.0, 1.0),
    **device: object,
) -> tuple[Rig, npt.NDArray[np.void], Floats]:
    """One approach: the rig, its samples, and times since the onset."""
    given = {"max_force_n": 100, "max_speed_m_per_s": 10, **device}
    floor = {**FLOOR, "normal": list(normal), "material": "m"}
    rig = Rig({"w": floor}, materials={"m": made}, device=given, rate_hz=rate_hz)
    time_s = np.arange(ticks) / rate_hz
    path = (above_m - speed * time_s)[:, None] * np.array(normal)
    samples = rig.render(path, velocity=np.tile(-speed * np.array(normal), (ticks, 1)))
    return rig, samples, time_s - above_m / speed


# ---- The curve -------------------------------------------------------------------------------------------------------


def test_the_curve_is_the_sum_of_kernels() -> None:
    rng = np.random.default_rng(1)
    for count in (3, 4, 5, 17, 512):
        samples = some_samples(rng, count)
        place = np.concatenate((rng.uniform(-1, count, 400), np.arange(count)))
        curve = Curve(samples, 4000.0)
        assert np.allclose(curve.at(place / 4000.0), by_kernel(samples, place), rtol=0, atol=1e-12)
        assert curve.at(np.arange(count) / 4000.0) == pytest.approx(samples, abs=1e-12)


def test_no_point_of_a_curve_is_beyond_its_peak_and_one_is_at_it() -> None:
    rng = np.random.default_rng(2)
    for count in (3, 4, 9, 60):
        samples = some_samples(rng, count)
        curve, place = Curve(samples, 1000.0), np.linspace(0, count - 1, 8001)
        values = np.abs(by_kernel(samples, place))
        assert curve.peak == pytest.approx(values.max(), rel=1e-4)
        assert curve.peak >= values.max() * (1 - 1e-12)
        assert abs(float(curve.at(curve.peak_time_s))) == pytest.approx(curve.peak, rel=1e-12)
        for part, peak in enumerate(curve.peaks_from(8)):
            assert peak >= values[place >= part * (count - 1) / 8].max() * (1 - 1e-12)
        assert curve.peaks_from(8)[0] == curve.peak


def test_the_energy_above_a_frequency_is_that_of_the_fourier_integral() -> None:
    made = validate_materials({"m": material()})["m"].tap
    assert made is not None and made.waveform is not None
    place = np.linspace(0, len(PULSE) - 1, 701)
    values, step_s = by_kernel(PULSE, place), (place[1] - place[0]) / 2000.0
    frequency = np.linspace(0, 8000, 1601)
    lines = np.exp(-2j * np.pi * frequency[:, None] * place / 2000.0) @ values * step_s
    energy = np.abs(lines) ** 2
    total = float(np.sum(values**2)) * step_s / 2
    for limit in (100.0, 400.0, 900.0):
        above = float(np.trapezoid(energy[frequency >= limit], dx=5.0)) / total
        assert made.waveform.curve.energy_above(limit) == pytest.approx(above, abs=1e-3)
    assert made.waveform.curve.energy_above(made.waveform.curve.middle_hz) == pytest.approx(0.5)


def test_of_spectra_only_what_was_found_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of 100,000 samples a second has 8 MiB."""
    waveforms = [
        Waveform(rate_hz=1e5, samples=(0.0, *np.random.default_rng(k).normal(size=40).tolist(), 0.0)) for k in range(4)
    ]
    tracemalloc.start()
    found = [(waveform.curve.middle_hz, waveform.curve.energy_above(400.0)) for waveform in waveforms]
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 12e6
    with monkeypatch.context() as patch:
        patch.delattr(np.fft, "rfft")
        assert found == [(waveform.curve.middle_hz, waveform.curve.energy_above(400.0)) for waveform in waveforms]


def test_what_was_found_of_a_waveform_is_kept_as_long_as_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many there are: who asks for the status of a scene of hundreds would have all found again."""
    given = {f"m{k}": material([0.0, 1.0, 0.001 * k, 0.0], 100.0) for k in range(300)}
    made = validate_materials(given)
    output = output_of(load_config({}), 1000)
    found = undisplayable(made, output), [material_warnings(name, each, output) for name, each in made.items()]
    dumped = {name: each.to_dict() for name, each in made.items()}
    with monkeypatch.context() as patch:
        patch.delattr(np.fft, "rfft")
        assert found == (
            undisplayable(made, output),
            [material_warnings(name, each, output) for name, each in made.items()],
        )
    assert dumped == {name: each.to_dict() for name, each in validate_materials(given).items()}
    assert made == validate_materials(given)


# ---- The tick --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_waveform_is_exact_at_any_onset_between_two_ticks(rate_hz: int) -> None:
    rng = np.random.default_rng(rate_hz)
    for _ in range(40):
        samples = some_samples(rng, int(rng.integers(3, 40)))
        wave_hz, speed = float(rng.uniform(500, rate_hz)), float(rng.uniform(0.1, 0.4))
        made = material(samples, wave_hz)
        rig, found, since = struck(made, speed, rate_hz, above_m=float(rng.uniform(1e-3, 2e-3)), undisplayable="lower")
        shown_hz = float(rig.table.materials[0].wave_rate_hz)
        mass = rig.config.device.effective_mass_kg
        wanted = 200.0 * speed * mass * by_kernel(samples, since * shown_hz)
        error = np.abs(found["vibration_force_n"][:, 1] - wanted).max()
        assert error <= 1e-12 * 200.0 * speed * mass * np.abs(samples).max()
        assert not found["vibration_force_n"][since * shown_hz > len(samples) - 1].any()


def test_a_waveform_is_played_with_its_own_rate_where_that_can_be_shown() -> None:
    rig, _, _ = struck(material())
    assert rig.table.materials[0].wave_rate_hz == 2000.0


@pytest.mark.parametrize(
    ("attack", "factor"),
    [("coefficient", 1.0), ("first_peak", 1 / np.abs(by_kernel(PULSE, np.linspace(0, 7, 70_001))).max())],
)
def test_an_amplitude_is_a_coefficient_or_the_largest_acceleration(attack: str, factor: float) -> None:
    made = material(amplitudes=[[0.1, 40.0], [0.4, 100.0]], attack=attack)
    rig, found, since = struck(made, 0.3)
    (contact,) = rig.of(EventKind.CONTACT)
    assert contact["amplitude_m_per_s2"] == pytest.approx(80.0)
    wanted = 80.0 * factor * rig.config.device.effective_mass_kg * by_kernel(PULSE, since * 2000.0)
    assert np.allclose(found["vibration_force_n"][:, 1], wanted, rtol=0, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("direction", [{}, {"direction": "tangent"}, {"angle_rad": 0.7}])
def test_a_waveform_pushes_where_its_tap_does(direction: dict[str, object]) -> None:
    normal = (0.6, 0.8)
    rig, found, since = struck(material(**direction), normal=normal)
    angle = {"direction": np.pi / 2, "angle_rad": 0.7}.get(next(iter(direction), ""), 0.0)
    aim = np.cos(angle) * np.array(normal) + np.sin(angle) * np.array((normal[1], -normal[0]))
    wanted = 60.0 * rig.config.device.effective_mass_kg * by_kernel(PULSE, since * 2000.0)[:, None] * aim
    assert np.allclose(found["vibration_force_n"], wanted, rtol=0, atol=1e-11)


def test_periods_that_were_missed_are_passed_over() -> None:
    """The curve goes on by the time that passed."""
    made = material()
    rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": made}, device={"max_force_n": 100})
    periods = np.array([1, 1, 3, 1, 7, 2, 1, 1, 20, 1])
    time_s = np.cumsum(periods) / 10_000
    path = np.zeros((10, 2))
    path[:, 1] = 0.00005 - 0.3 * time_s
    found = rig.render(path, velocity=np.tile((0.0, -0.3), (10, 1)), periods=periods)
    wanted = 60.0 * rig.config.device.effective_mass_kg * by_kernel(PULSE, (time_s - 0.00005 / 0.3) * 2000.0)
    assert np.count_nonzero(wanted) == 7
    assert np.allclose(found["vibration_force_n"][:, 1], wanted, rtol=0, atol=1e-11)


def test_waveforms_struck_again_add_up() -> None:
    rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": material()}, device={"max_force_n": 100})
    time_s = np.arange(400) / 10_000
    path = np.zeros((400, 2))
    path[:, 1] = 0.0004 * np.cos(2 * np.pi * 400 * time_s)
    found = rig.render(path, velocity=np.gradient(path, 1e-4, axis=0))
    contacts = rig.of(EventKind.CONTACT)
    assert len(contacts) == 16  # 2.5 ms apart, and 3.5 ms long
    wanted = np.zeros(400)
    for contact in contacts:
        onset_s = contact["tick"] / 10_000 - contact["before_tick_s"]
        wanted += contact["amplitude_m_per_s2"] * by_kernel(PULSE, (time_s - onset_s) * 2000.0)
    wanted *= rig.config.device.effective_mass_kg
    assert np.allclose(found["vibration_force_n"][:, 1], wanted, rtol=0, atol=1e-10)


def test_what_plays_goes_on_when_its_material_changes_or_its_object_goes() -> None:
    made = material()
    others = {"n": {"stiffness_n_per_m": 100.0, "tap": material(some_samples(np.random.default_rng(3), 40))["tap"]}}
    for change in ("material", "object", "table"):
        whole, alone, _ = struck(made, ticks=60)
        rig = Rig(
            {"w": {**FLOOR, "material": "m"}},
            materials={"m": made},
            device={"max_force_n": 100, "max_speed_m_per_s": 10},
        )
        path = np.zeros((60, 2))
        path[:, 1] = 0.00123 - 0.3 * np.arange(60) / 10_000
        velocity = np.tile((0.0, -0.3), (60, 1))
        first = rig.render(path[:50], velocity=velocity[:50])
        if change == "material":
            rig.update({}, materials={"m": material([0.0, -1.0, 0.0], 400.0)})
        elif change == "object":
            rig.update({"w": None})
        else:
            rig.update({"other": {**FLOOR, "point_m": [0, -1], "material": "n"}}, materials=others)
        second = rig.render(path[50:], velocity=velocity[50:])
        assert whole.rate_hz == rig.rate_hz
        assert second["vibration_force_n"][:5].any()
        both = np.concatenate((first["vibration_force_n"], second["vibration_force_n"]))
        assert both.tobytes() == alone["vibration_force_n"].tobytes()


def test_a_waveform_beyond_the_limit_is_scaled_as_a_whole() -> None:
    rig, found, since = struck(material(attack_slope_per_s=2000.0), max_force_n=4.0)
    (contact,) = rig.of(EventKind.CONTACT)
    assert 0 < contact["scale"] < 1
    assert np.hypot(*found["force_n"].T).max() <= 4.0
    wanted = contact["scale"] * 600.0 * rig.config.device.effective_mass_kg * by_kernel(PULSE, since * 2000.0)
    playing = since < 0.0035
    assert np.allclose(found["vibration_force_n"][playing, 1], wanted[playing], rtol=0, atol=1e-11)


def test_more_waveforms_than_there_is_room_for_end_without_harm() -> None:
    long = np.concatenate(([0.0], np.ones(200), [0.0]))
    rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": material(long, 2100.0)}, device={"max_force_n": 8})
    time_s = np.arange(3000) / 10_000
    path = np.zeros((3000, 2))
    path[:, 1] = 0.0001 * np.cos(2 * np.pi * 1000 * time_s)
    found = rig.render(path, velocity=np.gradient(path, 1e-4, axis=0))
    assert len(rig.of(EventKind.CONTACT)) > 96 > lib.HD_WAVE_PARTS
    assert np.isfinite(found["force_n"]).all()
    path[:] = (0.0, 0.01)
    rest = rig.render(path)
    assert not rest["vibration_force_n"][1100:].any()


def test_what_is_simulated_is_rendered_and_replayed_to_the_same_bits(tmp_path: Path) -> None:
    config = {
        "materials": {"m": material(attack_slope_per_s=60.0)},
        "scene": {
            "objects": {"w": {**FLOOR, "material": "m"}, "wood": {**FLOOR, "normal": [1, 0], "material": "wood"}}
        },
    }
    ways = [[0.0, 0.01, 0.01], *([0.05 * i, 0.01 * (-1) ** (i // 2), 0.01 * (-1) ** i] for i in range(1, 9))]
    (tmp_path / "config.yaml").write_text(json.dumps(config))
    (tmp_path / "ways.yaml").write_text(json.dumps({"waypoints": ways}))
    simulate_files([str(tmp_path / "config.yaml")], str(tmp_path / "ways.yaml"), str(tmp_path / "run.npz"), 0.4, None)
    again = replay(tmp_path / "run.npz")
    assert again.identical == again.ticks == 4000
    run = simulate_run(config, ways, 0.4)
    assert run.samples["vibration_force_n"].tobytes() == again.samples["vibration_force_n"].tobytes()
    velocity = run.samples["velocity_m_per_s"]
    rendered = render_run(config, run.samples["position_m"], velocity_m_per_s=velocity)
    assert rendered.samples["vibration_force_n"].tobytes() == again.samples["vibration_force_n"].tobytes()
    taps = run.events[run.events["kind"] == EventKind.CONTACT]
    assert len(taps) > 4 and run.samples["vibration_force_n"][:, 1].max() > 0.1


# ---- YAML ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("waveform", "told"),
    [
        ({"rate_hz": 2000}, "tap.waveform.samples: Field required"),
        ({"samples": PULSE}, "tap.waveform.rate_hz: Field required"),
        ({"rate_hz": 50, "samples": PULSE}, "tap.waveform.rate_hz: should be greater than or equal to 100, is 50"),
        (
            {"rate_hz": 2000, "samples": [0, 0]},
            "tap.waveform.samples: List should have at least 3 items after validation, not 2",
        ),
        ({"rate_hz": 2000, "samples": [0] * 513}, "tap.waveform.samples: must hold at most 512 entries, holds 513"),
        ({"rate_hz": 2000, "samples": [0, 1, "a", 0]}, "tap.waveform.samples[2]: should be a valid number"),
        ({"rate_hz": 2000, "samples": [0, float("nan"), 0]}, "tap.waveform.samples[1]: should be a finite number"),
        ({"rate_hz": 2000, "samples": [0, 1e6, 0]}, "tap.waveform.samples[1]: should be less than or equal to 100000"),
        ({"rate_hz": 2000, "samples": 3}, "tap.waveform.samples: should be a list, is 3"),
        ({"rate_hz": 2000, "samples": [0.3, 1, 0]}, "tap.waveform: the first of the samples must be 0, so that"),
        ({"rate_hz": 2000, "samples": [0, 1, 0.1]}, "tap.waveform: the last of the samples must be 0"),
        ({"rate_hz": 2000, "samples": [0, 0, 0]}, "tap.waveform: needs a sample that is not 0"),
        (
            {"rate_hz": 1000, "samples": [0, *[1] * 300, 0]},
            "tap.waveform: must last at most 0.1 s, lasts 0.301 s (302 samples at 1000 Hz)",
        ),
        ({"rate_hz": 2000, "sample": PULSE}, "did you mean samples?"),
    ],
)
def test_waveforms_that_are_none_are_refused_in_a_line(waveform: dict[str, object], told: str) -> None:
    given = {"stiffness_n_per_m": 1, "tap": {"attack_slope_per_s": 1, "waveform": waveform}}
    with pytest.raises(InvalidError) as caught:
        validate_materials({"m": given}, ("materials",))
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"frequency_hz": 100}, "tap: has a waveform instead of a mode: leave out frequency_hz"),
        (
            {"frequency_hz": 100, "decay_time_s": 0.01},
            "tap: has a waveform instead of a mode: leave out frequency_hz and decay_time_s",
        ),
        (
            {"second": {"frequency_hz": 100, "decay_time_s": 0.01, "ratio": 1}},
            "tap: has a waveform instead of a mode: leave out second",
        ),
        ({"attack_slope_per_s": None}, "needs exactly one of attack_slope_per_s and amplitudes, has neither"),
        ({"direction": "normal", "angle_rad": 1}, "needs at most one of direction and angle_rad, has both"),
    ],
)
def test_a_waveform_does_not_ring(keys: dict[str, object], told: str) -> None:
    with pytest.raises(InvalidError) as caught:
        validate_materials({"m": material(**keys)}, ("materials",))
    assert told in str(caught.value)


def test_a_tap_without_waveform_says_nothing_of_it() -> None:
    ringing = {"attack_slope_per_s": 1, "frequency_hz": 100, "decay_time_s": 0.01}
    assert "waveform" not in str(validate_materials({"m": {"stiffness_n_per_m": 1, "tap": ringing}})["m"].to_dict())


def test_grooves_do_not_ring_with_a_waveform() -> None:
    grooves: dict[str, Any] = {"kind": "grooves", "display": "vibration", "spacing_m": 0.002, "width_m": 0.0005}
    grooves["velocity_gain_per_s"] = 10
    with pytest.raises(InvalidError, match="needs a mode: frequency_hz and decay_time_s"):
        validate_materials({"m": {**material(), "texture": grooves}})
    own = {**grooves, "frequency_hz": 200, "decay_time_s": 0.003}
    assert validate_materials({"m": {**material(), "texture": own}})["m"].groove_mode is not None


def test_the_canonical_form_is_the_same_material() -> None:
    made = validate_materials({"m": material()})["m"]
    assert validate_materials({"m": made.to_dict()})["m"] == made
    assert made != validate_materials({"m": material([*PULSE[:-2], -0.06, 0.0])})["m"]
    assert MAX_WAVEFORM_SAMPLES == lib.HD_WAVE_SAMPLES


@pytest.mark.parametrize("materials", [50, pytest.param(1000, marks=pytest.mark.slow)])
def test_materials_of_any_waveforms_are_rendered_or_refused(materials: int) -> None:
    """Whatever is taken gives finite forces within the limit."""
    rng = np.random.default_rng(4)
    taken = 0
    for _ in range(materials):
        count = int(rng.integers(1, 60))
        samples: list[object] = (rng.normal(size=count) * 10.0 ** rng.integers(-6, 6)).tolist()
        if rng.random() < 0.8:
            samples[0] = samples[-1] = 0.0
        if rng.random() < 0.1:
            samples[int(rng.integers(count))] = [float("nan"), "x", None, 1e308, True][int(rng.integers(5))]
        tap: dict[str, object] = {"waveform": {"rate_hz": float(10 ** rng.uniform(1.5, 5.5)), "samples": samples}}
        tap["attack_slope_per_s"] = float(10 ** rng.uniform(-3, 5))
        if rng.random() < 0.1:
            tap["attack"] = "first_peak"
        if rng.random() < 0.1:
            tap["angle_rad"] = float(rng.uniform(-3, 3))
        try:
            found = validate_materials({"m": {"stiffness_n_per_m": 100.0, "tap": tap}})
        except InvalidError:
            continue
        taken += 1
        rig, rendered, _ = struck({"stiffness_n_per_m": 100.0, "tap": tap}, ticks=80, max_force_n=8)
        assert rig.config.materials["m"] == found["m"]
        assert np.isfinite(rendered["force_n"]).all()
        assert np.hypot(*rendered["force_n"].T).max() <= 8.0
    assert taken > 0.3 * materials


# ---- What a rate makes of it -----------------------------------------------------------------------------------------


def fast(middle_hz: float) -> dict[str, Any]:
    """A burst of a sine of about so many Hz."""
    count = 200
    samples = np.hanning(count) * np.sin(2 * np.pi * middle_hz * np.arange(count) / 20_000)
    samples[0] = samples[-1] = 0.0
    return material(samples, 20_000)


@pytest.mark.parametrize("undisplays", ["mute", "lower"])
def test_a_waveform_that_the_rate_cannot_carry_is_silent_or_slowed_down(undisplays: str) -> None:
    made = fast(600.0)
    rig, found, since = struck(made, rate_hz=1000, ticks=100, undisplayable=undisplays)
    output = output_of(rig.config, 1000)
    used = {"m": rig.config.materials["m"]}
    (told,) = undisplayable(used, output)
    assert told.mode == "tap"
    assert told.frequency_hz == pytest.approx(600.0, rel=0.02)
    if undisplays == "mute":
        assert told.shown_hz is None
        assert not found["vibration_force_n"].any()
        return
    assert told.shown_hz is not None
    assert told.shown_hz == pytest.approx(400.0)
    samples = made["tap"]["waveform"]["samples"]
    slowed = 20_000 * told.shown_hz / told.frequency_hz
    wanted = 60.0 * rig.config.device.effective_mass_kg * by_kernel(samples, since * slowed)
    assert np.abs(wanted).max() > 1
    assert np.allclose(found["vibration_force_n"][:, 1], wanted, rtol=0, atol=1e-9)
    assert undisplayable(used, output_of(rig.config, 2000)) == []


def test_energy_beyond_the_rate_is_told() -> None:
    config = load_config({"materials": {"m": fast(380.0)}, "scene": {"objects": {"w": {**FLOOR, "material": "m"}}}})
    (told,) = warnings(config.scene.objects, config.materials, output_of(config, 1000))
    assert told.where == "materials.m.tap.waveform"
    share = float(told.problem.split()[1])
    samples = np.array(config.materials["m"].tap.waveform.samples)  # type: ignore[union-attr]
    energy = np.abs(np.fft.rfft(samples, 1 << 16)) ** 2
    above = energy[np.fft.rfftfreq(1 << 16, 1 / 20_000) > 400].sum() / energy.sum()
    assert share == pytest.approx(100 * above, rel=0.02)
    assert "cannot carry" in told.problem
    assert warnings(config.scene.objects, config.materials, output_of(config, 10_000)) == []


def test_what_is_not_compensated_is_told() -> None:
    scene = {"objects": {"w": {**FLOOR, "material": "m"}}}
    config = load_config({"device": {"compensation": "full"}, "materials": {"m": material()}, "scene": scene})
    (told,) = warnings(config.scene.objects, config.materials, output_of(config, 10_000))
    assert "is not compensated for handle, hand and hold" in told.problem
    plain, off, _ = struck(material())
    _, full, _ = struck(material(), compensation="full")
    assert plain.config.device.compensation == "off"
    assert off["vibration_force_n"].tobytes() == full["vibration_force_n"].tobytes()
