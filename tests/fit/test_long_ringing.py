"""Taps that ring for a tenth of a second to a second: bells, beams and tuning forks."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest

from hapticd.analysis.statistics import FitError, Floats
from hapticd.fit.from_files import fit_taps
from hapticd.fit.recording import Recording, Source
from hapticd.fit.tap import Events, TapFit, fit_tap
from hapticd.fit.verdict import Exclusions

RATE_HZ = 4000.0
SPEEDS = (0.1, 0.32, 0.16, 0.4, 0.24, 0.2)
SLOPE_PER_S = 300.0


def ringing(
    name: str,
    onsets_s: Floats,
    speeds: tuple[float, ...],
    frequency_hz: float,
    decay_time_s: float,
    length_s: float,
    noise: float = 0.2,
) -> Recording:
    """Return taps whose ringing adds to that of the taps before, with noise in m/s^2."""
    time_s = np.arange(round(length_s * RATE_HZ)) / RATE_HZ
    seen = 9.8 + noise * np.random.default_rng([len(name), ord(name[-1])]).standard_normal(len(time_s))
    for onset_s, speed in zip(onsets_s, speeds, strict=True):
        since = np.maximum(time_s - onset_s, 0.0)
        seen += SLOPE_PER_S * speed * np.exp(-since / decay_time_s) * np.sin(2 * math.pi * frequency_hz * since)
    return Recording(name, RATE_HZ, seen, None, None, None, np.array(speeds), Source(name, ""))


def one_each(frequency_hz: float, decay_time_s: float, length_s: float, noise: float = 0.2) -> list[Recording]:
    """Return a recording of one tap at each speed, 0.1 s after its begin."""
    return [
        ringing(f"t{place}", np.array([0.1003]), (speed,), frequency_hz, decay_time_s, length_s, noise)
        for place, speed in enumerate(SPEEDS)
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    ("frequency_hz", "decay_time_s", "length_s", "noise"),
    [(20, 0.5, 2.0, 0.2), (38, 0.3, 1.5, 0.2), (300, 0.3, 1.5, 2.0), (300, 1.0, 2.2, 0.2), (440, 0.5, 2.5, 2.0)],
)
def test_a_long_ringing_is_one_tap(frequency_hz: float, decay_time_s: float, length_s: float, noise: float) -> None:
    fit = fit_taps(one_each(frequency_hz, decay_time_s, length_s, noise))
    assert isinstance(fit, TapFit)
    assert [tap.recording for tap in fit.taps] == [f"t{place}" for place in range(len(SPEEDS))]
    assert fit.left_out == () and fit.judged.quality == "good"
    for figure, truth in (
        (fit.frequency_hz, frequency_hz),
        (fit.decay_time_s, decay_time_s),
        (fit.slope_per_s, SLOPE_PER_S),
    ):
        assert figure.value == pytest.approx(truth, rel=0.01)
        # The interval of 95 %, doubled: a right interval misses the truth in one of 600 fits of six taps.
        assert abs(figure.value - truth) < 2 * max(figure.high - figure.value, figure.value - figure.low)


@pytest.mark.long
def test_a_long_ringing_in_noise_or_on_a_drift_is_not_a_waveform() -> None:
    """The noise is a tenth of the weakest tap; the drift is 10 m/s^3."""
    noisy = one_each(112, 0.24, 1.3, noise=3.0)
    drifting = [
        dataclasses.replace(each, acceleration_m_per_s2=each.acceleration_m_per_s2 + np.linspace(0.0, 15.0, 6000))
        for each in one_each(38, 0.3, 1.5)
    ]
    for recordings, frequency_hz, decay_time_s in ((noisy, 112.0, 0.24), (drifting, 38.0, 0.3)):
        fit = fit_taps(recordings)
        assert isinstance(fit, TapFit)
        assert len(fit.taps) == len(SPEEDS) and fit.left_out == () and fit.judged.quality == "good"
        assert fit.frequency_hz.value == pytest.approx(frequency_hz, rel=0.002)
        assert fit.decay_time_s.value == pytest.approx(decay_time_s, rel=0.03)


@pytest.mark.long
def test_a_recording_that_ends_too_early_is_refused_and_gets_no_waveform() -> None:
    for frequency_hz, decay_time_s, length_s in ((38, 1.0, 0.9), (80, 0.1, 0.2)):
        with pytest.raises(FitError, match="does not decay enough before the recording or the next tap ends it"):
            fit_taps(one_each(frequency_hz, decay_time_s, length_s))
    chosen = fit_taps(one_each(300, 0.8, 1.2), "waveform")
    assert chosen.judged.quality == "fair" and "the pulses have not ended" in chosen.judged.reasons[0]


@pytest.mark.parametrize(("frequency_hz", "decay_time_s"), [(20, 0.4), (80, 1.0), (300, 0.5)])
def test_taps_during_a_ringing_are_found_once_and_left_out_with_the_reason(
    frequency_hz: float, decay_time_s: float
) -> None:
    speeds = (0.1, 0.4, 0.15, 0.35, 0.2, 0.3)
    onsets_s = 0.1003 + 0.5 * np.arange(len(speeds))
    recording = ringing("bell", onsets_s, speeds, frequency_hz, decay_time_s, 3.1)
    recording = Recording("bell", RATE_HZ, recording.acceleration_m_per_s2, None, None, None, 0.2, Source("bell", ""))
    found = [event.first / RATE_HZ for event in Events(recording, []).events]
    assert len(found) <= len(speeds)
    # Each is within a period of an onset.
    assert all(np.abs(onsets_s - at_s).min() < max(0.01, 1 / frequency_hz) for at_s in found)
    excluded = Exclusions()
    with pytest.raises(FitError, match="taps are too few"):
        fit_tap([recording], excluded=excluded)
    assert excluded.items
    assert all("still rings" in each.reason and "wait longer between taps" in each.reason for each in excluded.items)


def test_speeds_for_taps_that_cannot_be_separated_are_refused_with_the_reason() -> None:
    recording = ringing("bell", 0.1 + 0.2 * np.arange(6), SPEEDS, 80, 1.5, 1.4)
    with pytest.raises(
        FitError,
        match=r"6 speeds for .* a tap is found only if it is louder than the noise and than 5 % of the loudest, and "
        "the one before has almost stopped ringing",
    ):
        fit_tap([recording])
    knocked = ringing("knocked", 0.1 + 0.5 * np.arange(6), SPEEDS, 80, 0.02, 3.1)
    with pytest.raises(FitError, match=r"5 speeds for 6 taps: .* a knock, a hum or a ringing that beats also counts"):
        fit_tap([dataclasses.replace(knocked, speed_m_per_s=np.array(SPEEDS[:5]))])


@pytest.mark.long
def test_a_tap_on_the_remainder_of_another_is_left_out_and_its_ringing_is_no_hum() -> None:
    """0.9 s after a tap, 5 % of its ringing remains, which is more than a quarter of the next tap."""
    speeds = (0.4, 0.3, 0.2, 0.25, 0.35, 0.4, 0.05)
    recording = ringing("bell", 0.1003 + 0.9 * np.arange(7), speeds, 160, 0.3, 6.4)
    fit = fit_tap([recording])
    (left,) = fit.left_out
    assert left.time_s == pytest.approx(5.5, abs=0.01)
    assert re.match("the tap at 4.6 s still rings with [2-5][0-9] % of this tap's amplitude", left.reason)
    assert "at most 25 % is allowed" in left.reason
    assert not any("hum" in reason for reason in fit.judged.reasons)
    assert fit.decay_time_s.value == pytest.approx(0.3, rel=0.01)


@pytest.mark.long
def test_a_tap_during_the_weak_ringing_of_the_tap_before_is_used() -> None:
    """0.5 s after a tap, 8 % of its ringing remains, which is louder than 5 % of the loudest tap."""
    speeds = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4)
    for quarter in range(4):
        # The ringing ends at another phase.
        onsets_s = 0.1003 + (0.5 + quarter / 480) * np.arange(6)
        fit = fit_tap([ringing("bell", onsets_s, speeds, 120, 0.2, 4.5, noise=0.05)])
        assert fit.left_out == () and len(fit.taps) == 6
        assert fit.slope_per_s.value == pytest.approx(SLOPE_PER_S, rel=0.08)
        assert fit.decay_time_s.value == pytest.approx(0.2, rel=0.02)


def test_a_tap_during_a_ringing_that_was_not_fitted_is_left_out() -> None:
    """The first tap is clipped; how loud it still is at the next one is unknown."""
    speeds = (0.4, 0.25, 0.3, 0.2, 0.25)
    recording = ringing("bell", np.array([0.1, 0.607, 2.6, 4.6, 6.6]), speeds, 120, 0.2, 8.5, noise=0.05)
    assert recording.acceleration_m_per_s2 is not None
    cut = dataclasses.replace(recording, acceleration_m_per_s2=np.minimum(recording.acceleration_m_per_s2, 105.0))
    first, second = fit_tap([cut]).left_out
    assert "clipped" in first.reason and "still rings" in second.reason


@pytest.mark.long
def test_a_bell_with_several_modes_keeps_its_modes() -> None:
    """Two modes explain most of a bell of three; 0.1 s of waveform would end long before the bell does."""
    modes = ((240.0, 0.7, 1.0), (540.0, 0.35, 0.5), (910.0, 0.2, 0.4))
    for count in (2, 3):
        recordings = [
            dataclasses.replace(
                parts[0],
                acceleration_m_per_s2=np.sum([part.acceleration_m_per_s2 for part in parts], axis=0)
                - 9.8 * (count - 1),
            )
            for speed in SPEEDS
            for parts in [
                [
                    ringing(f"t{speed}", np.array([0.1003]), (speed * size,), frequency_hz, decay_time_s, 3.0, 0.02)
                    for frequency_hz, decay_time_s, size in modes[:count]
                ]
            ]
        ]
        fit = fit_taps(recordings)
        assert isinstance(fit, TapFit) and fit.second is not None and fit.second.kept
        assert fit.frequency_hz.value == pytest.approx(240, rel=0.002)
        assert fit.decay_time_s.value == pytest.approx(0.7, rel=0.02)
        assert fit.second.decay_time_s.value == pytest.approx(0.35, rel=0.02)


@pytest.mark.parametrize(("other_hz", "ratio"), [(302.0, 0.9), (305.0, 0.6), (340.0, 0.9)])
def test_beating_is_no_tap(other_hz: float, ratio: float) -> None:
    recording = ringing("bell", np.array([0.1]), (0.4,), 300.0, 0.5, 2.5)
    other = ringing("bell", np.array([0.1]), (0.4 * ratio,), other_hz, 0.5, 2.5)
    assert recording.acceleration_m_per_s2 is not None and other.acceleration_m_per_s2 is not None
    both = recording.acceleration_m_per_s2 + other.acceleration_m_per_s2 - 9.8
    beating = Recording("bell", RATE_HZ, both, None, None, None, 0.2, Source("bell", ""))
    (event,) = Events(beating, []).events
    assert event.first / RATE_HZ == pytest.approx(0.1, abs=0.001)
