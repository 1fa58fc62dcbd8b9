"""Events that are each fitted well, but differ too much for a good fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hapticd.analysis.statistics import FitError, Floats
from hapticd.fit.from_files import fit_taps
from hapticd.fit.puncture import fit_puncture
from hapticd.fit.recording import Recording, Source
from hapticd.fit.tap import fit_tap
from hapticd.fit.waveform import WaveformFit

RATE_HZ = 5000.0
SPEEDS = np.linspace(0.08, 0.4, 10)
MIXED = np.array([1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0])
"""Signs without a trend over SPEEDS."""


def tap(index: int, seen: Floats) -> Recording:
    random = np.random.default_rng(index)
    acceleration = np.concatenate((np.zeros(50), seen)) + 0.05 * random.standard_normal(50 + len(seen))
    return Recording(f"tap {index}", RATE_HZ, acceleration, None, None, None, float(SPEEDS[index]), Source("", ""))


def since() -> Floats:
    return np.arange(500) / RATE_HZ


@pytest.mark.parametrize(("scatter", "quality"), [(0.05, "good"), (0.5, "fair"), (0.9, "poor")])
def test_a_decay_time_that_differs_from_tap_to_tap_is_a_reason(scatter: float, quality: str) -> None:
    times_s = 0.01 * np.exp(scatter * MIXED)
    seen = [
        600 * speed * np.exp(-since() / time_s) * np.sin(2 * np.pi * 250 * since())
        for speed, time_s in zip(SPEEDS, times_s, strict=True)
    ]
    fit = fit_tap([tap(index, each) for index, each in enumerate(seen)])
    assert fit.judged.quality == quality
    assert any("the decay time is uncertain" in reason for reason in fit.judged.reasons) == (quality != "good")


def pulses(sizes: Sequence[float] | Floats) -> list[Recording]:
    shape = np.where(since() < 0.01, np.sin(np.pi * since() / 0.01) ** 2, 0.0)
    return [tap(index, size * shape) for index, size in enumerate(sizes)]


@pytest.mark.slow
def test_pulses_whose_sizes_do_not_follow_the_speed_are_refused() -> None:
    with pytest.raises(FitError, match="does not rise with the speed"):
        fit_taps(pulses(60 * np.exp(0.6 * MIXED)), "waveform")
    found = fit_taps(pulses(300 * SPEEDS))
    assert isinstance(found, WaveformFit)
    assert found.judged.quality == "good"


def rupture(index: int, frequency_hz: float) -> Recording:
    """Return a puncture, at 10 mm/s, of a membrane of 400 N/m that ruptures at 1.2 N."""
    random = np.random.default_rng(index)
    time = np.arange(3500) / RATE_HZ
    way = 0.01 * (time - 0.1)
    after = np.maximum(time - 0.4001, 0.0)
    force = np.where(after > 0, 0.0, 400 * np.maximum(way, 0.0)) + 0.002 * random.standard_normal(len(time))
    ringing = np.where(after > 0, 30 * np.exp(-100 * after) * np.sin(2 * np.pi * frequency_hz * after), 0.0)
    acceleration = ringing + 0.1 * random.standard_normal(len(time))
    return Recording(f"rupture {index}", RATE_HZ, acceleration, force, way, None, None, Source("", ""))


@pytest.mark.long
@pytest.mark.parametrize(("scatter", "quality"), [(0.01, "good"), (0.07, "fair"), (0.2, "poor")])
def test_ruptures_that_ring_at_different_frequencies_are_a_reason(scatter: float, quality: str) -> None:
    fit = fit_puncture([rupture(index, 200 * float(np.exp(scatter * sign))) for index, sign in enumerate(MIXED[:6])])
    assert fit.judged.quality == quality
    assert any("the frequency scatters" in reason for reason in fit.judged.reasons) == (quality != "good")
