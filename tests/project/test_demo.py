"""What the demo measures with: strikes, passages and spectra of which the truth is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal

from examples.demo.comb import Combing, joined, passages
from examples.demo.marks import Marks
from examples.demo.perform import MASS_KG, Recorded, Unseen
from examples.demo.sandpaper import SEGMENT, peak_of
from examples.demo.strikes import Strikes, strikes_of
from hapticd.base.core import SAMPLE_DTYPE

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


def telemetry(time_s: Floats, vibration: Floats | float = 0.0, x: Floats | float = 0.0) -> Recorded:
    samples: npt.NDArray[Any] = np.zeros(len(time_s), SAMPLE_DTYPE)
    samples["vibration_force_n"][:, 0] = MASS_KG * np.asarray(vibration)
    samples["position_m"][:, 0] = x
    samples["position_m"][:, 1] = -0.001
    return Recorded(time_s, samples, (), 0, RATE)


def some_strikes() -> tuple[Floats, Floats]:
    rng = np.random.default_rng(1)
    onsets = 0.01 + np.cumsum(rng.uniform(6e-3, 0.03, 20))
    return onsets, rng.uniform(2, 20, 20) * rng.choice([-1, 1], 20)


def test_a_mode_and_its_strikes_are_found_as_they_were_made() -> None:
    onsets, amplitudes = some_strikes()
    time_s = np.arange(round(0.45 * RATE)) / RATE
    found = strikes_of(telemetry(time_s, rung(time_s, onsets, amplitudes)), 0, onsets)
    assert found.number == tuple(range(20)) and found.left_over == 0
    assert found.frequency_hz == pytest.approx(OMEGA / (2 * np.pi), rel=1e-9)
    assert found.decay_time_s == pytest.approx(1 / DECAY, rel=1e-9)
    assert found.late_s(onsets) < 1e-9
    np.testing.assert_allclose(found.amplitude, amplitudes, rtol=1e-6)


def test_a_strike_too_many_and_one_of_another_shape_are_left_over() -> None:
    onsets, amplitudes = some_strikes()
    time_s = np.arange(round(0.45 * RATE)) / RATE
    vibration = rung(time_s, onsets, amplitudes)
    assert strikes_of(telemetry(time_s, vibration), 0, np.delete(onsets, 8)).left_over > 0
    vibration[2001] += 0.1
    assert strikes_of(telemetry(time_s, vibration), 0, onsets).left_over > 0


def test_a_sine_that_is_exactly_zero_on_a_sample_goes_on() -> None:
    time_s = np.arange(400) / RATE
    vibration = rung(time_s, np.array([0.01]), np.array([8.0]))
    vibration[175] = 0.0  # one and a half periods after the strike
    found = strikes_of(telemetry(time_s, vibration), 0, [0.01])
    np.testing.assert_allclose(found.amplitude, [8.0], rtol=1e-6)
    assert found.left_over == 0


def test_a_strike_one_sample_after_the_end_of_another_is_found() -> None:
    onsets, amplitudes = np.array([0.01003, 0.02515]), np.array([8.0, -5.0])
    time_s = np.arange(450) / RATE
    vibration = rung(time_s, onsets, amplitudes)
    assert vibration[250] != 0.0 == vibration[251] and vibration[252] != 0.0
    found = strikes_of(telemetry(time_s, vibration), 0, onsets)
    np.testing.assert_allclose(found.amplitude, amplitudes, rtol=1e-6)
    assert found.left_over == 0


def test_missed_periods_hide_the_strikes_near_to_them_and_no_others() -> None:
    onsets, amplitudes = some_strikes()
    whole = np.arange(round(0.45 * RATE)) / RATE
    kept = np.ones(len(whole), dtype=np.bool_)
    for begin in (0.1, 0.2, 0.201, float(onsets[5]), float(onsets[9]) - 2e-4):
        kept[round(begin * RATE) : round(begin * RATE) + 7] = False
    found = strikes_of(telemetry(whole[kept], rung(whole, onsets, amplitudes)[kept]), 0, onsets)
    assert 14 <= len(found.number) < 20 and found.left_over == 0
    assert not {5, 9} & set(found.number) and found.hidden == 20 - len(found.number)
    assert found.late_s(onsets) < 1e-9
    np.testing.assert_allclose(found.amplitude, amplitudes[list(found.number)], rtol=1e-6)


@pytest.mark.parametrize(
    ("trace", "expected"),
    [
        ([0.5, 1.5, 2.5], [1, 2]),
        ([0.5, 3.5], [1, 2, 3]),
        ([0.9, 1.1, 0.9, 1.1], [1]),  # to and fro on one groove
        ([0.9, 1.1, 1.6, 1.1, 0.9], [1, 1]),  # half a spacing away meanwhile
        ([0.9, 1.0, 1.1], [1]),  # on a groove is beyond it
        ([1.1, 1.0, 0.9], [1]),
        ([0.2, 0.4], []),
    ],
)
def test_passages(trace: list[float], expected: list[int]) -> None:
    groove, at_s = passages(telemetry(np.arange(len(trace)) / RATE, x=np.array(trace)), 1.0)
    assert groove.tolist() == expected
    assert np.interp(at_s, np.arange(len(trace)) / RATE, trace) == pytest.approx(expected)


@pytest.mark.parametrize(("periods", "expected"), [(200, [1, 2, 3]), (201, [1, 3])])
def test_nothing_is_passed_in_a_stall_that_is_longer_than_the_ramp(periods: int, expected: list[int]) -> None:
    time_s = np.array([0, 1, 1 + periods, 2 + periods]) / RATE
    groove, _ = passages(telemetry(time_s, x=np.array([0.5, 1.5, 2.5, 3.5])), 1.0)
    assert groove.tolist() == expected


def test_a_groove_that_is_passed_before_the_force_has_come_in_again_counts() -> None:
    recorded = telemetry(np.arange(3) / RATE, x=np.array([0.5, 0.9, 1.1]))
    recorded.samples["contact_force_n"][:, 1] = [1.0, 0.0, 0.01]
    assert passages(recorded, 1.0)[0].tolist() == [1]
    recorded.samples["position_m"][:, 1] = [-0.001, 0.001, -0.001]
    assert passages(recorded, 1.0)[0].tolist() == []


def combing(whole: int, scaled: int = 0) -> Combing:
    count = whole + scaled
    each = np.ones(count)
    strikes = Strikes(tuple(range(count)), 0.01 * np.arange(count), 8.0 * each, 200.0, 0.003, 1, 0)
    cells = np.arange(count)
    return Combing(strikes, cells, 0.0024 * cells, 0.1 * each, each, cells < whole, each, cells >= 0, count + 1, count)


def test_strikes_of_several_performances_count_together() -> None:
    with pytest.raises(Unseen, match="60 strikes of the comb came through whole, 100 are wanted"):
        joined([combing(60, 5)])
    found = joined([combing(60, 5), combing(70)])
    assert found.whole.sum() == 130 and len(found.strikes.number) == 135
    assert (found.passed, found.told, found.strikes.hidden) == (137, 135, 2)


def test_the_peak_of_two_poles_is_found() -> None:
    rng = np.random.default_rng(3)
    pole = 0.93 * np.exp(2j * np.pi * 160 / RATE)
    noise = scipy.signal.lfilter([1.0], np.poly([pole, pole.conjugate()]).real, rng.normal(size=1_000_000))
    response = scipy.signal.freqz([1.0], np.poly([pole, pole.conjugate()]).real, np.linspace(0, 1000, 100_001), fs=RATE)
    true_peak = response[0][abs(response[1]).argmax()]
    frequency, spectrum = scipy.signal.welch(noise, RATE, nperseg=SEGMENT, detrend=False)
    assert peak_of(frequency, spectrum, RATE) == pytest.approx(true_peak, rel=0.05)


def test_marks_collect_what_was_missed_and_numbers_that_are_none() -> None:
    marks = Marks()
    assert marks.off("near", 1.001, 1.0, 0.01) == "+0.10%"
    assert marks.missed == []
    marks.off("far", 1.1, 1.0, 0.01)
    marks.off("none", float("nan"), 1.0, 0.01)
    assert [line.split()[0] for line in marks.missed] == ["far", "none"]
