"""The spectrum of a texture's peak and mean, compared with the recorded spectrum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from hapticd.analysis.statistics import Floats
from hapticd.fit.recording import Recording, Source
from hapticd.fit.texture import fit_texture, spectral_distance_db

RATE_HZ = 2500.0
PLACES = ((0.05, 0.6), (0.05, 2.0), (0.15, 0.6), (0.15, 2.0), (0.1, 1.0))


def test_decibels_are_those_of_the_densities() -> None:
    frequency = np.arange(0.0, 1000.0, 2.0)
    power = 1.0 / (1.0 + ((frequency - 200.0) / 100.0) ** 2)
    assert spectral_distance_db(frequency, power, power) == 0.0
    assert spectral_distance_db(frequency, 2.0 * power, power) == pytest.approx(10 * np.log10(2.0))
    # Densities 20 dB below the peak are not compared.
    other = np.where(power < 0.005, 100.0 * power, power)
    assert spectral_distance_db(frequency, other, power) == 0.0


def resonance(white: Floats, hertz: float, quality: float) -> Floats:
    """Filter noise by a mass on a spring, with the bilinear transform."""
    w = 2 * np.pi * hertz
    noise = signal.lfilter(*signal.bilinear([w**2], [1.0, w / quality, w**2], RATE_HZ), white)
    return np.asarray(noise / np.std(noise))


@pytest.mark.slow
@pytest.mark.parametrize(("second_hz", "quality"), [(None, "good"), (700.0, "fair")])
def test_a_second_resonance_is_reported(second_hz: float | None, quality: str) -> None:
    recordings = []
    for index, (speed, force) in enumerate(PLACES):
        random = np.random.default_rng(index)
        white = random.standard_normal((2, round(6 * RATE_HZ)))
        noise = resonance(white[0], 120.0, 2.0)
        if second_hz is not None:
            noise = np.sqrt(0.5) * (noise + resonance(white[1], second_hz, 6.0))
        pressed = force + 0.01 * random.standard_normal(len(noise))
        moved = np.asarray(speed * np.arange(len(noise)) / RATE_HZ, dtype=np.float64)
        seen = np.asarray((24.0 * speed + 2.4 * force) * noise, dtype=np.float64)
        recordings.append(Recording(f"{index}", RATE_HZ, seen, pressed, None, moved, None, Source("", "")))
    fit = fit_texture(recordings)
    assert fit.judged.quality == quality
    assert any("has another spectrum" in reason for reason in fit.judged.reasons) == (second_hz is not None)
    if second_hz is not None:
        assert not any("has another spectrum" in reason for reason in fit_texture(recordings, True).judged.reasons)
