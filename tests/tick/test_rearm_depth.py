"""How large `device.rearm_m` must be: the formula against simulated noise at a surface, and how noise is measured."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hapticd.base.core import EventKind
from hapticd.rendering.rearm import at_rest, min_rearm_m, rearm_text
from tests.support.rig import Rig

RATE_HZ = 10_000
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
STRETCH = 20_000


def taps(
    rearm_m: float, height_m: float, noise_m: float, minutes: float, step_m: float = 0.0, down: bool = False
) -> int:
    """Taps of a probe held at a height with white noise, after it has come there; `step_m`: of an encoder. `down`: its
    speed is told to be downwards throughout, else it is estimated from the positions."""
    rig = Rig({"floor": FLOOR}, device={"rearm_m": rearm_m})
    rig.render(np.stack([np.zeros(50), np.linspace(1e-3, 1e-5, 50)], axis=1))
    random = np.random.default_rng(7)
    found = 0
    for _ in range(round(minutes * 60 * RATE_HZ / STRETCH)):
        height = height_m + random.normal(0, noise_m, STRETCH)
        if step_m > 0:
            height = step_m * np.rint(height / step_m)
        speed = np.tile([0.0, -0.01], (STRETCH, 1)) if down else None
        rig.render(np.stack([np.zeros(STRETCH), height], axis=1), speed)
        contacts = rig.of(EventKind.CONTACT)
        found += int(np.count_nonzero(contacts["amplitude_m_per_s2"] > 0))
    return found


def tail(sigmas: float) -> float:
    """Of a Gaussian."""
    return 0.5 * math.erfc(sigmas / math.sqrt(2))


@pytest.mark.slow
@pytest.mark.parametrize(("depth", "height"), [(4.0, 2.0), (4.0, 1.0), (2.0, 1.0)])
def test_false_taps_come_as_often_as_the_formula_says(depth: float, height: float) -> None:
    """Often enough to count in a minute, at the height where most are made and beside it. Where the speed is estimated,
    some onsets are no taps, because the estimate is upwards."""
    noise = 1e-6
    wanted = 60 * RATE_HZ / (1 / tail(depth - height) + 1 / tail(height))
    found = taps(depth * noise, height * noise, noise, 1.0, down=True)
    assert found == pytest.approx(wanted, abs=4 * math.sqrt(wanted) + 1)
    assert taps(depth * noise, height * noise, noise, 1.0) <= found


@pytest.mark.slow
@pytest.mark.parametrize("step_m", [0.0, 3e-6])
def test_minutes_of_noise_at_a_surface_make_no_false_tap(step_m: float) -> None:
    """1 um: tens of thousands a minute without a depth, only the first one in minutes with it, wherever the hand is."""
    enough = min_rearm_m(1e-6, step_m, RATE_HZ)
    assert taps(0.0, 0.0, 1e-6, 0.1, step_m) > 3000
    for height_m in (0.0, enough / 2, enough / 4):
        assert taps(enough, height_m, 1e-6, 2.0, step_m) <= 1


def test_the_depth_allows_one_false_tap_a_day() -> None:
    """By the tail of a Gaussian, from the equation: r Q(h / 2s) / 2 a second."""
    for noise_m in (1e-7, 1e-6, 2.3e-5):
        for rate_hz in (1000.0, 10_000.0):
            depth = min_rearm_m(noise_m, 0.0, rate_hz)
            a_day = 86_400 * rate_hz * tail(depth / noise_m / 2) / 2
            assert 0.1 < a_day <= 1.0  # two figures, rounded up
    assert min_rearm_m(1e-6, 0.0, RATE_HZ) == pytest.approx(12e-6)
    assert min_rearm_m(1e-6, 2e-5, RATE_HZ) == pytest.approx(32e-6)
    assert min_rearm_m(0.0, 2e-5, RATE_HZ) == pytest.approx(2e-5)
    assert min_rearm_m(0.0, 0.0, RATE_HZ) == 0.0
    assert min_rearm_m(1.0, 0.0, RATE_HZ) == 0.01


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
def test_noise_is_measured_beside_slow_motion_and_missing_reports(rate_hz: float) -> None:
    count = int(rate_hz)
    random = np.random.default_rng(2)
    time_s = np.arange(count) / rate_hz
    position = random.normal(0, 1e-6, count) + 5e-5 * np.sin(2 * np.pi * 1.0 * time_s) + 0.02
    assert at_rest(position, 1e-9, rate_hz).noise_m == pytest.approx(1e-6, rel=0.1)
    some = position.copy()
    some[random.uniform(size=count) < 0.3] = np.nan
    some[:5] = np.nan
    assert at_rest(some, 1e-9, rate_hz).noise_m == pytest.approx(1e-6, rel=0.2)


def test_a_handle_that_rests_between_two_steps_has_no_noise_but_its_step() -> None:
    step = 2e-5
    flicker = step * np.random.default_rng(1).integers(0, 2, 10_000)
    assert at_rest(flicker, step, RATE_HZ).rearm_m == pytest.approx(step)
    assert at_rest(np.zeros(10_000), step, RATE_HZ).rearm_m == pytest.approx(step)
    assert at_rest(np.full(10_000, np.nan), step, RATE_HZ).rearm_m == pytest.approx(step)
    assert at_rest(np.zeros(10_000), 0.0, RATE_HZ).rearm_m == 0.0


def test_check_says_what_taps_again() -> None:
    assert rearm_text(0.0, 0.0, RATE_HZ) is None
    assert "flickers by the encoder's step, 20 um, taps each time; rearm_m: 2e-05 prevents" in rearm_text(
        0.0, 2e-5, 1e4
    )  # type: ignore[operator]
    assert "noise of positions" in rearm_text(0.0, None, RATE_HZ)  # type: ignore[operator]
    assert "less than the encoder's step, 20 um" in rearm_text(1e-5, 2e-5, RATE_HZ)  # type: ignore[operator]
    assert "noise of up to 1 um taps less than once a day" in rearm_text(3.2e-5, 2e-5, RATE_HZ)  # type: ignore[operator]
    assert str(rearm_text(1e-5, None, RATE_HZ)).endswith("after the probe was 10 um away from it (device.rearm_m)")
