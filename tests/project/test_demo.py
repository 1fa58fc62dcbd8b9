"""What the demo measures with: strikes, passages and spectra of which the truth is known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal

from examples.demo.comb import away_from_gaps, mode_of, passed, strikes_of
from examples.demo.marks import Marks
from examples.demo.sandpaper import SEGMENT, peak_of

Floats = npt.NDArray[np.float64]
OMEGA, DECAY, RATE = 2 * np.pi * 200.0, 1 / 3e-3, 10_000.0


def rung(time_s: Floats, onsets: Floats, amplitudes: Floats) -> Floats:
    """The modes of all strikes together, silent from 5/B after the last one, and not heard again."""
    since = time_s[:, None] - onsets
    each = np.where(since >= 0, np.exp(-DECAY * np.maximum(since, 0)) * np.sin(OMEGA * since), 0.0)
    group = np.cumsum(np.diff(onsets, prepend=-1.0) > 5 / DECAY)
    last = np.searchsorted(onsets, time_s, side="right") - 1
    silent = (last < 0) | (time_s - onsets[last] > 5 / DECAY)
    return np.where(silent, 0.0, np.where(group == group[last][:, None], each, 0.0) @ amplitudes)


def some_strikes() -> tuple[Floats, Floats]:
    rng = np.random.default_rng(1)
    onsets = 0.01 + np.cumsum(rng.uniform(2e-3, 0.03, 60))
    return onsets, rng.uniform(2, 20, 60) * rng.choice([-1, 1], 60)


def test_a_mode_and_its_strikes_are_found_as_they_were_made() -> None:
    onsets, amplitudes = some_strikes()
    time_s = np.arange(round(1.2 * RATE)) / RATE
    vibration = rung(time_s, onsets, amplitudes)
    omega, decay = mode_of(time_s, vibration)
    assert (omega, decay) == (pytest.approx(OMEGA, rel=1e-9), pytest.approx(DECAY, rel=1e-9))
    strikes = strikes_of(time_s, vibration, omega, decay)
    np.testing.assert_allclose(strikes.onset_s, onsets, rtol=0, atol=1e-9)
    np.testing.assert_allclose(strikes.amplitude, amplitudes, rtol=1e-6)


def test_a_sine_that_is_exactly_zero_on_a_sample_is_no_strike() -> None:
    time_s = np.arange(400) / RATE
    vibration = rung(time_s, np.array([0.01]), np.array([8.0]))
    vibration[175] = 0.0  # one and a half periods after the strike
    strikes = strikes_of(time_s, vibration, OMEGA, DECAY)
    np.testing.assert_allclose(strikes.onset_s, [0.01], rtol=0, atol=1e-9)


def test_missed_periods_hide_the_strikes_near_to_them_and_no_others() -> None:
    onsets, amplitudes = some_strikes()
    whole = np.arange(round(1.2 * RATE)) / RATE
    kept = np.ones(len(whole), dtype=np.bool_)
    for begin in (0.2, 0.5, 0.501, 0.9):
        kept[round(begin * RATE) : round(begin * RATE) + 7] = False
    time_s = whole[kept]
    vibration = rung(whole, onsets, amplitudes)[kept]
    strikes = strikes_of(time_s, vibration, OMEGA, DECAY)
    far = np.array([min(abs(onset - gap) for gap in (0.2, 0.5, 0.501, 0.9)) > 3e-3 for onset in onsets.tolist()])
    assert far.sum() >= 50
    for onset, amplitude in zip(onsets[far], amplitudes[far], strict=True):
        nearest = abs(strikes.onset_s - onset).argmin()
        assert strikes.onset_s[nearest] == pytest.approx(onset, abs=1e-9)
        assert strikes.amplitude[nearest] == pytest.approx(amplitude, rel=1e-6)
    assert all(abs(onsets - onset).min() < 1e-9 for onset in strikes.onset_s.tolist())


def test_samples_near_a_gap() -> None:
    time_s = np.array([0, 1, 2, 3, 4, 9, 10, 11, 12], dtype=np.float64)
    assert away_from_gaps(time_s, 2).tolist() == [True, True, True, False, False, False, False, True, True]


@pytest.mark.parametrize(
    ("trace", "expected"),
    [
        ([0.5, 1.5, 2.5], [0, 1]),
        ([0.5, 3.5], [0, 0, 0]),
        ([0.9, 1.1, 0.9, 1.1], [0]),  # to and fro on one groove
        ([0.9, 1.1, 1.6, 1.1, 0.9], [0, 3]),  # half a spacing away meanwhile
        ([0.9, 1.0, 1.1], [0]),  # on a groove is beyond it
        ([1.1, 1.0, 0.9], [1]),
        ([0.2, 0.4], []),
    ],
)
def test_passages(trace: list[float], expected: list[int]) -> None:
    assert passed(np.array(trace), 1.0) == expected


def test_the_peak_of_two_poles_is_found_within_its_deviation() -> None:
    rng = np.random.default_rng(3)
    pole = 0.93 * np.exp(2j * np.pi * 160 / RATE)
    noise = scipy.signal.lfilter([1.0], np.poly([pole, pole.conjugate()]).real, rng.normal(size=1_000_000))
    response = scipy.signal.freqz([1.0], np.poly([pole, pole.conjugate()]).real, np.linspace(0, 1000, 100_001), fs=RATE)
    true_peak = response[0][abs(response[1]).argmax()]
    frequency, spectrum = scipy.signal.welch(noise, RATE, nperseg=SEGMENT, detrend=False)
    found = peak_of(frequency, spectrum, RATE, len(noise) / RATE)
    assert abs(found.value - true_peak) < 4 * found.deviation
    assert found.deviation < 0.05 * true_peak


def test_marks_collect_what_was_missed_and_numbers_that_are_none() -> None:
    marks = Marks()
    assert marks.off("near", 1.001, 1.0, 0.01) == "+0.10%"
    assert marks.missed == []
    marks.off("far", 1.1, 1.0, 0.01)
    marks.off("none", float("nan"), 1.0, 0.01)
    assert [line.split()[0] for line in marks.missed] == ["far", "none"]
