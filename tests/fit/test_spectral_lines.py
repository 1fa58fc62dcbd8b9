"""Spectral lines: found at any frequency with their fraction of the power, and not in noise or ringing."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.analysis.statistics import Floats
from hapticd.fit.recording import Recording, Source
from hapticd.fit.spectral_lines import SpectralLine, common_lines, described, lines_in_residual, spectral_lines
from hapticd.fit.tap import fit_tap

RATE = 2000.0


def noise(seconds: float, seed: int) -> Floats:
    """Return noise of variance 1, coloured by a resonance at 180 Hz, 60 Hz wide."""
    count = round(seconds * RATE)
    at = np.fft.rfftfreq(count, 1 / RATE)
    shape = 1 / np.abs(1 - (at / 180) ** 2 + 0.33j * at / 180)
    found = np.fft.irfft(np.fft.rfft(np.random.default_rng(seed).standard_normal(count)) * shape, count)
    return np.asarray(found / found.std())


def tone(seconds: float, hz: float, fraction: float) -> Floats:
    """Return a tone with this fraction of the power of noise and tone together."""
    time_s = np.arange(round(seconds * RATE)) / RATE
    return np.asarray(np.sqrt(2 * fraction / (1 - fraction)) * np.sin(2 * np.pi * hz * time_s + 1))


@pytest.mark.parametrize("hz", [50.0, 133.3, 200.0, 317.9, 611.0])
def test_a_line_is_found_at_any_frequency_with_its_power(hz: float) -> None:
    (line,) = spectral_lines(noise(8.0, 1) + tone(8.0, hz, 0.04), RATE)
    assert line.frequency_hz == pytest.approx(hz, abs=0.1)
    assert line.fraction == pytest.approx(0.04, rel=0.25)


@pytest.mark.long
def test_noise_and_ringing_have_no_lines() -> None:
    """Noise has a line with a probability of one in a thousand; a mode is struck at random times."""
    assert sum(bool(spectral_lines(noise(2.0, seed), RATE)) for seed in range(120)) <= 2
    random = np.random.default_rng(3)
    struck = np.zeros(8000)
    struck[random.integers(0, 8000, 12)] = random.uniform(1, 3, 12)
    time_s = np.arange(400) / RATE
    rings = np.convolve(struck, np.exp(-60 * time_s) * np.sin(2 * np.pi * 240 * time_s))[:8000]
    assert spectral_lines(rings + 0.01 * random.standard_normal(8000), RATE) == []
    assert spectral_lines(noise(0.4, 1) + tone(0.4, 50, 0.2), RATE) == []


def test_lines_that_most_recordings_have_are_reported_together() -> None:
    three = sum(tone(3.0, hz, 0.05) for hz in (200, 300, 400))

    def lines_in(place: int, needed: int) -> list[SpectralLine]:
        assert needed == 2
        return spectral_lines(noise(3.0, place) + three, RATE, needed) + (
            [SpectralLine(611.0, 0.2)] if place == 3 else []
        )

    def none_in(place: int, needed: int) -> list[SpectralLine]:
        return spectral_lines(noise(3.0, 50 + place), RATE, needed)

    found = common_lines(range(4), lines_in)
    assert [round(line.frequency_hz) for line in found] == [200, 300, 400]
    assert common_lines(range(40), none_in) == [] and common_lines(range(4), none_in) == []
    text = described(found)
    assert [float(part.split(" Hz")[0].split("(")[-1]) for part in text.split(", ")[:3]] == pytest.approx(
        [200, 300, 400], abs=0.15
    )
    assert float(text.split("lines hold ")[1].split(" %")[0]) == pytest.approx(100 * 3 * 0.0526 / 1.158, rel=0.25)


def test_the_fraction_is_of_the_recorded_power() -> None:
    """The fraction is that of the recorded power, of which the model explains nine tenths."""
    hum = tone(4.0, 120.0, 0.2)
    loud = 3.0 * noise(4.0, 2)
    (line,) = lines_in_residual(hum + loud + noise(4.0, 4), loud, RATE)
    assert line.frequency_hz == pytest.approx(120, abs=0.05)
    assert line.fraction == pytest.approx(0.25 / (9 + 1 + 0.25), rel=0.15)


def test_hum_between_taps_is_reported() -> None:
    random = np.random.default_rng(1)
    time_s = np.arange(6000) / RATE
    seen = 9.8 + 0.02 * random.standard_normal(len(time_s)) + 0.9 * np.sin(2 * np.pi * 300 * time_s)
    speeds = np.array([0.1, 0.15, 0.2, 0.3, 0.25, 0.12])
    for index, speed in enumerate(speeds):
        since = np.maximum(time_s - 0.2 - 0.45 * index, 0)
        seen += 400 * speed * np.exp(-100 * since) * np.sin(2 * np.pi * 120 * since)
    fit = fit_tap([Recording("taps", RATE, seen, None, None, None, speeds, Source("taps", ""))])
    (line,) = (warning for warning in fit.warnings if "hum" in warning)
    assert "a line at 300 Hz holds" in line
    assert float(line.split("holds ")[1].split(" %")[0]) == pytest.approx(100 * 0.405 / np.var(seen), rel=0.2)
    assert fit.verdict.startswith("fair")
