"""Whether taps ring, or are pulses: which of the two fits says more of them.

A mode is taken where it rings, which is to fall to 1/e in 0.3 of its period or later, and where it, or two, explain
95 % of the taps' variance (the median; a tap that was left out counts as 0). Otherwise a waveform is taken if it leaves
less than half of what the mode leaves over. A mode may choose frequency and decay anew for each tap, and a waveform is
judged on each tap by the other taps: the comparison favours the mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, Literal, TypeAlias, cast

import numpy as np

from hapticd.fit.impossible import without_impossible
from hapticd.fit.pulse_shape import Pulse
from hapticd.fit.recording import Recording
from hapticd.fit.regression import FitError, require_scipy
from hapticd.fit.strokes import force_of, gravity_of
from hapticd.fit.tap import (
    HARDEST,
    SOFTEST,
    TapFit,
    TapHit,
    _base,
    _check_files,
    _check_force,
    _check_speeds,
    _clipped,
    _events,
    _given_speeds,
    _speed_of,
    _without_bounces,
    fit_tap,
)
from hapticd.fit.waveform import FEW_SAMPLES, POORLY_EXPLAINED, WaveformFit, fit_waveform
from hapticd.waveform import LONGEST_S, middle_hz

TapKind: TypeAlias = Literal["auto", "mode", "waveform"]
ENOUGH: Final = 0.95
"""Explained by modes: no waveform is tried."""
RINGS: Final = 0.3
"""Of its period, in which a mode that rings may fall to 1/e."""
LEAVES: Final = 0.5
"""Of what a mode leaves over, a waveform leaves less than this."""
REST_S: Final = 0.02
"""So much of the rest before a tap is looked at."""
LEAST_REST: Final = 2
"""Samples of it."""


def fit_taps(
    recordings: Sequence[Recording], kind: TapKind = "auto", progress: Callable[[Recording], None] | None = None
) -> TapFit | WaveformFit:
    """Fits the taps of one material by modes or by a waveform; `progress` as of fit_tap.

    Raises FitError (one line) for what they do not support; where neither fits, of the mode.
    """
    require_scipy()
    if kind == "mode":
        return fit_tap(recordings, progress)
    if kind == "waveform":
        return _waveform(recordings)
    try:
        ringing = fit_tap(recordings, progress)
    except FitError as error:
        try:
            found = _waveform(recordings)
        except FitError:
            raise error from None
        if found.variance_accounted_for < POORLY_EXPLAINED or found.samples_a_period < FEW_SAMPLES:
            raise error from None
        return found
    by_mode = ringing.variance_accounted_for
    rings = ringing.decay_time_s.value * ringing.frequency_hz.value >= RINGS
    if ringing.second is not None and rings:
        by_mode = max(by_mode, ringing.second.variance_accounted_for)
    warnings: list[str] = []
    try:
        pulses = pulses_of(recordings, warnings)
        by_mode = float(np.median([by_mode] * len(ringing.taps) + [0.0] * (len(pulses) - len(ringing.taps))))
        if rings and by_mode >= ENOUGH:
            return ringing
        found = _waveform(recordings)
    except FitError:
        return ringing
    return found if 1 - found.variance_accounted_for < LEAVES * (1 - by_mode) else ringing


def _waveform(recordings: Sequence[Recording]) -> WaveformFit:
    warnings: list[str] = []
    _check_files(recordings)
    pulses = pulses_of(recordings, warnings)
    found = fit_waveform(pulses, tuple(recording.source for recording in recordings), warnings)
    _check_speeds(cast(Sequence[TapHit], found.taps))
    ratio = found.first_peak_slope_per_s.value / (2.0 * math.pi * middle_hz(found.curve))
    if not SOFTEST <= ratio <= HARDEST:
        raise FitError(
            f"the amplitude over speed is {found.first_peak_slope_per_s.value:.4g} 1/s, {ratio:.2g} times the angular "
            f"frequency of the pulses; a touch has {SOFTEST:g} to {HARDEST:g}: is the acceleration or the speed off by "
            "a thousand (mm, g)?"
        )
    return found


def pulses_of(recordings: Sequence[Recording], warnings: list[str]) -> list[Pulse]:
    """The taps of recordings, each with the rest before it; what is left out is told."""
    return [pulse for recording in recordings for pulse in _of(recording, warnings)]


def _of(recording: Recording, warnings: list[str]) -> list[Pulse]:
    whole = without_impossible(recording, "tap")
    recording = whole.recording
    warnings += whole.told
    acceleration, rate_hz = recording.acceleration_m_per_s2, recording.rate_hz
    if acceleration is None:
        raise FitError(f"{recording.name}: has no acceleration, which taps are fitted to")
    if recording.force_n is not None:
        _check_force(recording.name, force_of(recording))
    warnings += gravity_of(recording)
    above = acceleration - _base(acceleration, rate_hz)
    events = _events(recording, above)
    speeds = _given_speeds(recording, events, above)
    if speeds is not None and len(speeds) != len(events):
        events = [(first, last) for first, last in events if first < last] or events
    if speeds is None or len(speeds) != len(events):
        events = _without_bounces(recording, events, above)
    if speeds is not None and len(speeds) != len(events):
        raise FitError(f"{recording.name}: has {len(speeds)} speeds for {len(events)} taps: needs one a tap")
    clipped = _clipped(acceleration)
    found = []
    for index, (first, _) in enumerate(events):
        place = f"{recording.name}: the tap at {first / rate_hz:.4g} s"
        before = events[index - 1][1] + 1 if index > 0 else 0
        after = events[index + 1][0] if index + 1 < len(events) else len(acceleration)
        begin = max(before, first - max(LEAST_REST, round(REST_S * rate_hz)))
        end = min(after, first + round(LONGEST_S * rate_hz))
        if first - begin < LEAST_REST:
            warnings.append(
                f"{place} has no rest before it ({first - begin} samples, needs {LEAST_REST}), and is left out"
            )
            continue
        if clipped[begin:end].any():
            warnings.append(f"{place} is clipped, and left out")
            continue
        speed = _speed_of(recording, first / rate_hz) if speeds is None else float(speeds[index])
        if isinstance(speed, str):
            warnings.append(f"{place} {speed}, and is left out")
            continue
        onset_s = (first - begin) / rate_hz
        found.append(Pulse(recording.name, begin / rate_hz, onset_s, speed, rate_hz, acceleration[begin:end]))
    return found
