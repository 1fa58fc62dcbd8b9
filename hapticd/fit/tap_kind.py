"""Whether taps ring, or are pulses: which of the two fits says more of them.

A mode is taken where it rings, which is to fall to 1/e in 0.3 of its period or later, and where it, or two, explain
95 % of the taps' variance (the median; a tap that was left out counts as 0). Otherwise a waveform is taken if it leaves
less than half of what the mode leaves over. A mode may choose frequency and decay for each tap separately, and
a waveform is judged on each tap by the other taps: the comparison favours the mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, Literal, TypeAlias

import numpy as np

from hapticd.analysis.statistics import FitError, UnitError, require_scipy
from hapticd.config.waveform import LONGEST_S
from hapticd.fit.duplicates import refuse_duplicates
from hapticd.fit.exclusions import Exclusions
from hapticd.fit.recording import Recording
from hapticd.fit.tap import TapFit, fit_tap
from hapticd.fit.taps.events import LEAST_REST, Events, Unusable, events_of
from hapticd.fit.taps.law import check_hardness
from hapticd.fit.taps.pulse_shape import Pulse
from hapticd.fit.verdict import AT_LEAST
from hapticd.fit.waveform import WaveformFit, fit_waveform

TapKind: TypeAlias = Literal["auto", "mode", "waveform"]
ENOUGH: Final = 0.95
"""Explained by modes: no waveform is tried."""
RINGS: Final = 0.3
"""Of its period, in which a mode that rings may fall to 1/e."""
LEAVES: Final = 0.5
"""Of what a mode leaves over, a waveform leaves less than this."""
REST_S: Final = 0.02
"""So much of the rest before a tap is compared."""


def fit_taps(
    recordings: Sequence[Recording],
    kind: TapKind = "auto",
    progress: Callable[[Recording], None] | None = None,
    excluded: Exclusions | None = None,
) -> TapFit | WaveformFit:
    """Fits the taps of one material by modes or by a waveform; `progress` and `excluded` as of fit_tap.

    Raises FitError (one line) for what they do not support; where neither fits, of the mode.
    """
    require_scipy()
    refuse_duplicates(recordings)
    excluded = Exclusions() if excluded is None else excluded
    if kind == "mode":
        return fit_tap(recordings, progress, excluded)
    if kind == "waveform":
        warnings: list[str] = []
        return _waveform(pulses_of(recordings, warnings, excluded), recordings, warnings, excluded)
    # What the form that is not taken leaves out does not matter.
    of_mode, of_waveform = excluded.copy(), excluded.copy()
    ringing: TapFit | FitError
    try:
        ringing = fit_tap(recordings, progress, of_mode)
    except FitError as error:
        ringing = error
    found = _other(ringing, recordings, of_waveform)
    if found is not None:
        excluded.merge(of_waveform)
        return found
    excluded.merge(of_mode)
    if isinstance(ringing, FitError):
        raise ringing
    return ringing


def _other(ringing: TapFit | FitError, recordings: Sequence[Recording], excluded: Exclusions) -> WaveformFit | None:
    """The waveform, where it says more of the taps than the modes do."""
    if isinstance(ringing, UnitError):
        return None
    warnings: list[str] = []
    try:
        pulses = pulses_of(recordings, warnings, excluded)
        if isinstance(ringing, FitError):
            found = _waveform(pulses, recordings, warnings, excluded)
            explains = found.variance_accounted_for >= AT_LEAST["variance that a waveform explains"].poor
            resolved = found.samples_a_period >= AT_LEAST["samples in a period of a waveform"].poor
            return found if explains and resolved else None
        by_mode = ringing.variance_accounted_for
        rings = ringing.decay_time_s.value * ringing.frequency_hz.value >= RINGS
        if ringing.second is not None and rings:
            by_mode = max(by_mode, ringing.second.variance_accounted_for)
        by_mode = float(np.median([by_mode] * len(ringing.taps) + [0.0] * (len(pulses) - len(ringing.taps))))
        if rings and by_mode >= ENOUGH:
            return None
        found = _waveform(pulses, recordings, warnings, excluded)
    except FitError:
        return None
    return found if 1 - found.variance_accounted_for < LEAVES * (1 - by_mode) else None


def _waveform(
    pulses: Sequence[Pulse], recordings: Sequence[Recording], warnings: Sequence[str], excluded: Exclusions
) -> WaveformFit:
    """Of the pulses of these recordings."""
    found = fit_waveform(pulses, tuple(recording.source for recording in recordings), warnings, excluded)
    angular = 2.0 * math.pi * found.curve.middle_hz
    check_hardness(found.first_peak_slope_per_s.value, angular, "the angular frequency of the pulses")
    return found


def pulses_of(recordings: Sequence[Recording], warnings: list[str], excluded: Exclusions) -> list[Pulse]:
    """The taps of recordings, each with the rest before it; what cannot be used is reported in `excluded`."""
    return [pulse for found in excluded.each(recordings, lambda each: _of(each, warnings, excluded)) for pulse in found]


def _of(recording: Recording, warnings: list[str], excluded: Exclusions) -> list[Pulse]:
    loud = events_of(recording, warnings)
    found = []
    for index, event in enumerate(loud.events):
        try:
            found.append(_pulse(loud, index))
        except Unusable as no:
            excluded.add(recording.name, str(no), "tap", event.first / recording.rate_hz)
    if not found:
        excluded.unused.add(recording.name)
    return found


def _pulse(loud: Events, index: int) -> Pulse:
    """Raises Unusable."""
    recording, first, (before, after) = loud.recording, loud.events[index].first, loud.room(index)
    acceleration, rate_hz = recording.acceleration_m_per_s2, recording.rate_hz
    assert acceleration is not None
    begin = max(before, first - max(LEAST_REST, round(REST_S * rate_hz)))
    end = min(after, first + round(LONGEST_S * rate_hz))
    if first - begin < LEAST_REST:
        raise Unusable(f"{first - begin} samples of rest before it, {LEAST_REST} are wanted")
    if loud.clipped[begin:end].any():
        raise Unusable(f"it is clipped at {np.abs(acceleration[begin:end][loud.clipped[begin:end]]).max():.4g} m/s^2")
    if loud.replaced[begin:end].any():
        raise Unusable(f"{np.count_nonzero(loud.replaced[begin:end])} of its samples cannot be, and none may")
    speed = loud.speed(index, first / rate_hz)
    return Pulse(recording.name, begin / rate_hz, (first - begin) / rate_hz, speed, rate_hz, acceleration[begin:end])
