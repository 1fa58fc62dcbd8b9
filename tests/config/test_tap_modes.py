"""Taps whose frequency and decay follow the approach speed, against closed forms written from the equations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.analysis.calibration.verify import compare_on_walls
from hapticd.base.core import EventKind, lib
from hapticd.base.errors import InvalidError
from hapticd.config.configuration import load_config
from hapticd.config.materials import validate_materials
from hapticd.config.modes import MAX_TABLE_POINTS
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import undisplayable
from tests.support.rig import FLOOR, Rig

Floats = npt.NDArray[np.float64]

RATE = 10_000.0
SPEEDS, HERTZ, DECAYS = [0.1, 0.2, 0.4], [120.0, 210.0, 260.0], [0.004, 0.008, 0.011]
TABLE = {"speeds_m_per_s": SPEEDS, "frequencies_hz": HERTZ, "decay_times_s": DECAYS}
SECOND = {"frequency_hz": 700.0, "decay_time_s": 0.003, "ratio": 0.4}
SLOPE = 300.0


def material(table: Mapping[str, object] = TABLE, **tap: object) -> dict[str, Any]:
    return {"stiffness_n_per_m": 100.0, "tap": {"attack_slope_per_s": SLOPE, "mode_table": dict(table), **tap}}


def mode_of(speed: float) -> tuple[float, float]:
    """Return frequency in Hz and decay time in s by numpy.interp, which is constant beyond the ends."""
    return float(np.interp(speed, SPEEDS, HERTZ)), float(np.interp(speed, SPEEDS, DECAYS))


def form(since: Floats, hertz: float, decay_s: float) -> Floats:
    sounds = (since >= 0) & (since <= 5 * decay_s)
    return np.where(sounds, np.exp(-since / decay_s) * np.sin(2 * np.pi * hertz * since), 0.0)


def struck(
    made: dict[str, Any], speed: float, rate_hz: float = RATE, count: int = 900, **device: object
) -> tuple[Rig, Floats, Floats]:
    """Render one approach; return the vibration divided by the mass, and times since the onset in s."""
    device = {"max_force_n": 100, "max_speed_m_per_s": 1000, **device}
    rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": made}, device=device, rate_hz=rate_hz)
    time_s = np.arange(count) / rate_hz
    path = np.zeros((count, 2))
    path[:, 1] = 0.00123 - speed * time_s
    samples = rig.render(path, velocity=np.tile((0.0, -speed), (count, 1)))
    mass = rig.config.device.effective_mass_kg
    return rig, np.asarray(samples["vibration_force_n"][:, 1]) / mass, time_s - 0.00123 / speed


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.137, 0.2, 0.29, 0.4, 0.9])
@pytest.mark.parametrize("second", [{}, {"second": SECOND}], ids=["one", "two"])
def test_a_tap_rings_with_the_frequency_and_decay_of_its_speed(speed: float, second: dict[str, object]) -> None:
    rig, heard, since = struck(material(**second), speed)
    hertz, decay_s = mode_of(speed)
    wanted = form(since, hertz, decay_s)
    judged = np.abs(since - 5 * decay_s) > 1e-9
    if second:
        wanted = wanted + 0.4 * form(since, 700.0, 0.003)
        judged &= np.abs(since - 5 * 0.003) > 1e-9
    wanted *= SLOPE * speed
    np.testing.assert_allclose(heard[judged], wanted[judged], rtol=0, atol=1e-11 * np.abs(wanted).max())
    (contact,) = rig.of(EventKind.CONTACT)
    assert contact["amplitude_m_per_s2"] == pytest.approx(SLOPE * speed, rel=1e-12)


@pytest.mark.parametrize("speed", [0.05, 0.29])
def test_a_first_peak_is_that_of_the_mode_that_rings(speed: float) -> None:
    _, heard, since = struck(material(attack="first_peak", second=SECOND), speed)
    hertz, decay_s = mode_of(speed)
    fine = np.linspace(0, 1 / hertz, 200_001)
    coefficient = SLOPE * speed / form(fine, hertz, decay_s).max()
    wanted = coefficient * (form(since, hertz, decay_s) + 0.4 * form(since, 700.0, 0.003))
    judged = np.minimum(np.abs(since - 5 * decay_s), np.abs(since - 0.015)) > 1e-9
    np.testing.assert_allclose(heard[judged], wanted[judged], rtol=0, atol=1e-8 * np.abs(wanted).max())


def test_taps_of_different_speeds_ring_together() -> None:
    rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": material()}, device={"max_force_n": 100})
    # A tap at 0.15 m/s, then one at 0.3 m/s before the first has decayed.
    first, out, again = -0.15 * np.arange(20) / RATE, np.array([0.0005]), 0.00033 - 0.3 * np.arange(200) / RATE
    y = np.concatenate((0.0001234 + first, out, again))
    speed = np.concatenate((np.full(20, -0.15), [0.0], np.full(200, -0.3)))
    samples = rig.render(np.column_stack((0 * y, y)), velocity=np.column_stack((0 * y, speed)))
    assert len(rig.of(EventKind.CONTACT)) == 2
    time_s = np.arange(len(y)) / RATE
    onsets = (0.0001234 / 0.15, 21 / RATE + 0.00033 / 0.3)
    wanted = sum(SLOPE * v * form(time_s - t, *mode_of(v)) for v, t in zip((0.15, 0.3), onsets, strict=True))
    mass = rig.config.device.effective_mass_kg
    np.testing.assert_allclose(
        samples["vibration_force_n"][:, 1] / mass, wanted, rtol=0, atol=1e-11 * float(np.abs(wanted).max())
    )


def test_a_table_of_one_speed_equals_one_mode() -> None:
    one = material({"speeds_m_per_s": [0.1], "frequencies_hz": [210], "decay_times_s": [0.008]})
    plain = {**one, "tap": {"attack_slope_per_s": SLOPE, "frequency_hz": 210, "decay_time_s": 0.008}}
    np.testing.assert_allclose(struck(one, 0.23)[1], struck(plain, 0.23)[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("what", ["mute", "lower"])
def test_a_tap_above_the_displayable_limit_is_lowered_or_muted(what: str) -> None:
    """At a rate of 600 Hz the limit is 240 Hz; the tap at 0.35 m/s has 247.5 Hz."""
    speed = 0.35
    rig, heard, since = struck(material(second={**SECOND, "frequency_hz": 80.0}), speed, 600.0, 60, undisplayable=what)
    hertz, decay_s = mode_of(speed)
    fine = np.linspace(0, 0.01, 200_001)
    part = form(fine, hertz, decay_s).max() / form(fine, 240.0, decay_s).max() if what == "lower" else 0.0
    wanted = SLOPE * speed * (part * form(since, 240.0, decay_s) + 0.4 * form(since, 80.0, 0.003))
    np.testing.assert_allclose(heard, wanted, rtol=0, atol=1e-7 * np.abs(wanted).max())
    (muted,) = undisplayable({"m": rig.config.materials["m"]}, output_of(rig.config, 600))
    assert (muted.mode, muted.frequency_hz) == ("tap", pytest.approx(260.0))
    # A slow tap is unchanged.
    slow, since = struck(material(), 0.1, 600.0, 60, undisplayable=what)[1:]
    np.testing.assert_allclose(slow, 30.0 * form(since, 120.0, 0.004), rtol=0, atol=1e-9)


HANDLE = {
    "handle": {"mass_kg": 0.03, "damping_n_s_per_m": 0.2, "friction_n": 0.0},
    "grip": {"mass_kg": 0.02, "damping_n_s_per_m": 5.0, "stiffness_n_per_m": 200.0},
}


@pytest.mark.parametrize("compensation", ["mass", "full"])
@pytest.mark.slow
def test_compensated_taps_are_displayed_as_those_of_one_mode(compensation: str) -> None:
    """This also holds between the speeds of the table: the tail is common, and the first samples are not corrected."""
    for speed in (0.1, 0.16, 0.33):
        hertz, decay_s = mode_of(speed)
        one = {"attack_slope_per_s": SLOPE, "frequency_hz": hertz, "decay_time_s": decay_s}
        made = {"tuned": material(), "one": {**material(), "tap": one}}
        device = {"kind": "sim", "max_force_n": 100, "max_speed_m_per_s": 1000, "compensation": compensation, **HANDLE}
        found = compare_on_walls(load_config({"device": device, "materials": made}), speed)
        error = {each.strike.material: each.error for each in found if each.strike.material in made}
        assert error["tuned"] < error["one"] + 0.02


@pytest.mark.parametrize(
    ("tap", "problem"),
    [
        ({"frequency_hz": 100}, "has a mode_table, which gives frequency and decay: leave out frequency_hz"),
        ({"decay_rate_per_s": 100}, "leave out decay_rate_per_s"),
        (
            {"mode_table": {**TABLE, "decay_times_s": [0.01]}},
            "decay_times_s must have a decay time for each speed, 3, has 1",
        ),
        ({"mode_table": {**TABLE, "frequencies_hz": [1, 2, 3, 4]}}, "must have a frequency for each speed, 3, has 4"),
        (
            {"mode_table": {**TABLE, "speeds_m_per_s": [0.1, 0.1, 0.2]}},
            "speeds_m_per_s[1] must be at least 1e-06 above",
        ),
        (
            {"waveform": {"rate_hz": 1000, "samples": [0, 1, 0]}},
            "has a waveform instead of a mode: leave out mode_table",
        ),
    ],
)
def test_invalid_combinations_of_keys_are_reported(tap: dict[str, object], problem: str) -> None:
    with pytest.raises(InvalidError) as error:
        validate_materials({"m": material(**tap)})
    assert problem in str(error.value)


def test_grooves_need_a_separate_mode_if_the_tap_has_a_table() -> None:
    grooves = {
        "kind": "grooves",
        "display": "vibration",
        "spacing_m": 0.002,
        "width_m": 0.001,
        "force_gain_m_per_s2_per_n": 1,
    }
    with pytest.raises(InvalidError, match="because the tap has a mode_table"):
        validate_materials({"m": {**material(), "texture": grooves}})


def test_a_material_is_returned_as_given() -> None:
    found = validate_materials({"m": material()})["m"]
    again = validate_materials({"m": found.to_dict()})["m"]
    assert again == found and found.tap is not None
    for speed in (0.0, 0.13, 0.4, 2.0):
        hertz, decay_s = mode_of(speed)
        assert found.tap.mode_at(speed).frequency_hz == pytest.approx(hertz, rel=1e-12)
        assert found.tap.mode_at(speed).decay_time_s == pytest.approx(decay_s, rel=1e-12)
    assert found.tap.mode.frequency_hz == pytest.approx(float(np.interp(0.25, SPEEDS, HERTZ)))


def test_a_table_of_the_maximum_length_is_rendered() -> None:
    assert MAX_TABLE_POINTS == lib.HD_TUNE_POINTS
    rises = (0.1 * np.arange(1, MAX_TABLE_POINTS + 1)).tolist()
    full = {
        "speeds_m_per_s": rises,
        "frequencies_hz": [100.0] * MAX_TABLE_POINTS,
        "decay_times_s": [0.01] * MAX_TABLE_POINTS,
    }
    rig, found, since = struck(material(full), 0.3)
    assert rig.table.materials[0].mode_count == MAX_TABLE_POINTS
    assert np.abs(found - SLOPE * 0.3 * form(since, 100.0, 0.01)).max() < 1e-11 * np.abs(found).max()
