"""Peaks of spectra with and without a resonance, and the material of a texture without a peak."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from hapticd.analysis.statistics import FitError, Floats
from hapticd.config.texture import Autoregressive
from hapticd.fit.recording import Recording, Source
from hapticd.fit.texture import Peak, fit_texture, peak_of
from tests.support.fitted import fitted_material

Density = Callable[[Floats], Floats]
BLOCKS, STROKES = 50, 5
RATE = 2500.0
PLACES = ((0.05, 0.6), (0.05, 2.0), (0.15, 0.6), (0.15, 2.0), (0.1, 1.0))


def falling(corner_hz: float, order: float) -> Density:
    return lambda frequency: 1 / (1 + (frequency / corner_hz) ** (2 * order))


def resonance(own_hz: float, quality: float) -> Density:
    """Return the density of a resonance, whose peak is at own_hz sqrt(1 - 1/(2 quality^2))."""

    def density(frequency: Floats) -> Floats:
        ratio = frequency / own_hz
        return np.asarray(1 / ((1 - ratio**2) ** 2 + (ratio / quality) ** 2))

    return density


def sampled(densities: Sequence[Density], seed: int) -> Peak:
    """Return the peak of sampled periodograms: the densities times means of three exponential variates."""
    random = np.random.default_rng(seed)
    frequency = np.arange(0.0, 1000.0, 4.0)
    strokes = np.repeat(np.arange(STROKES), BLOCKS // STROKES)
    shape = np.stack([densities[k % len(densities)](frequency) for k in strokes])
    return peak_of(frequency, shape * random.gamma(2.5, 1 / 2.5, shape.shape), strokes)


def bootstrapped(peaks: Sequence[float], random: np.random.Generator) -> tuple[float, float]:
    """Return the interval of 95 % of the means of resampled strokes."""
    means = random.choice(np.array(peaks), size=(4000, len(peaks))).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


@pytest.mark.slow
@pytest.mark.parametrize("density", [falling(40, 1.5), falling(60, 2), falling(150, 3), resonance(100, 0.6)])
def test_a_spectrum_that_only_falls_has_no_peak(density: Density) -> None:
    """The highest density is at 0: a peak due to chance is not resolved, and has no value."""
    for seed in range(8):
        found = sampled([density], seed)
        assert found.hz is None
        assert 20.0 <= found.below_hz < 200.0


@pytest.mark.slow
@pytest.mark.parametrize(("own_hz", "quality"), [(150.0, 2.0), (200.0, 1.2), (90.0, 3.0)])
def test_intervals_of_a_resonance_hold_its_peak(own_hz: float, quality: float) -> None:
    truth = own_hz * np.sqrt(1 - 1 / (2 * quality**2))
    found = [peak for seed in range(20) if (peak := sampled([resonance(own_hz, quality)], seed).hz) is not None]
    assert len(found) == 20
    # Of 20 intervals of 95 %, this number contain the peak with a probability of 1.6 %, fewer with 0.3 %.
    assert sum(each.low <= truth <= each.high for each in found) >= 16


@pytest.mark.slow
def test_strokes_that_differ_make_the_interval_wide() -> None:
    """The interval is 0.8 to 3 times as wide as that of a bootstrap over the strokes, narrow for few strokes."""
    owns = (110.0, 135.0, 150.0, 165.0, 190.0)
    random = np.random.default_rng(1)
    low, high = bootstrapped([own * np.sqrt(1 - 1 / 18) for own in owns], random)
    for seed in range(4):
        found = sampled([resonance(own, 3.0) for own in owns], seed).hz
        assert found is not None
        assert 0.8 * (high - low) < found.high - found.low < 3 * (high - low)


def stroke(density: Density, loudness: float, place: tuple[float, float], seed: int) -> Recording:
    random = np.random.default_rng(seed)
    count = round(4 * RATE)
    time, frequency = np.arange(count) / RATE, np.fft.rfftfreq(count, 1 / RATE)
    root = np.sqrt(density(frequency))
    noise = np.fft.irfft(np.fft.rfft(random.standard_normal(count)) * root, count)
    one, other = random.uniform(0, 6, 2)
    speed = place[0] * (1 + 0.15 * np.sin(4.4 * time + one))
    return Recording(
        name=f"s{seed}",
        rate_hz=RATE,
        acceleration_m_per_s2=loudness * noise / noise.std() + 0.01 * random.standard_normal(count),
        force_n=place[1] * (1 + 0.15 * np.sin(6 * time + other)),
        position_m=None,
        tangential_position_m=np.cumsum(speed) / RATE,
        speed_m_per_s=None,
        source=Source(f"s{seed}", ""),
    )


@pytest.mark.long
@pytest.mark.parametrize("autoregressive", [False, True])
def test_a_texture_without_a_peak_says_so_in_the_material(autoregressive: bool) -> None:
    strokes = [
        stroke(falling(60, 2), 24 * speed + 2.4 * force, (speed, force), seed)
        for seed, (speed, force) in enumerate(PLACES)
    ]
    fit = fit_texture(strokes, autoregressive=autoregressive)
    figures = fit.to_dict()
    assert (figures["peak_hz"], figures["peak_resolved"]) == (None, False)
    assert fit.peak_below_hz is not None and 20.0 <= fit.peak_below_hz < 60.0
    (message,) = (line for line in fit.warnings if "peak" in line)
    assert message.startswith(
        "the peak is not resolved: the spectrum is broad, or highest below 20 Hz; the peak is below "
    )
    # Models of the measured spectrum need no peak.
    made = fitted_material(fit, strokes, "texture", 500.0)
    assert isinstance(made.texture, Autoregressive)
    assert made.fitted["texture"].quality == "good"
    assert made.provenance is not None
    assert made.provenance.intervals is not None
    assert "texture.peak_hz" not in made.provenance.intervals


@pytest.mark.long
def test_a_texture_without_a_peak_needs_steady_strokes() -> None:
    """Strokes that never keep a speed for 2 s have neither a peak nor autoregressive models."""
    speed = np.linspace(0.05, 0.25, round(4 * RATE))
    swept = []
    for seed, place in enumerate(PLACES):
        even = stroke(falling(60, 2), 1.0, place, seed)
        assert even.acceleration_m_per_s2 is not None and even.force_n is not None
        louder = even.acceleration_m_per_s2 * (24 * speed + 2.4 * even.force_n)
        moved = np.cumsum(speed) / RATE
        swept.append(dataclasses.replace(even, acceleration_m_per_s2=louder, tangential_position_m=moved))
    with pytest.raises(FitError, match=r"the peak is not resolved: .* Hz; no speed and force was held for 2 s"):
        fit_texture(swept)


def test_a_loudness_that_does_not_follow_speed_and_force_is_poor() -> None:
    strokes = [
        stroke(resonance(150, 2), loudness, place, seed)
        for seed, (loudness, place) in enumerate(zip((3.0, 2.4, 2.3, 2.9, 2.6), PLACES, strict=True))
    ]
    fit = fit_texture(strokes)
    assert fit.correlation < 0.5
    assert fit.judged.quality == "poor"
    assert any(reason.startswith("speed and force explain the loudness poorly") for reason in fit.judged.reasons)


def test_a_texture_as_the_law_has_it_is_good() -> None:
    strokes = [
        stroke(resonance(150, 2), 24 * speed + 2.4 * force, (speed, force), seed)
        for seed, (speed, force) in enumerate(PLACES)
    ]
    fit = fit_texture(strokes)
    assert (fit.judged.quality, fit.judged.reasons, fit.peak_resolved) == ("good", (), True)
