"""Strikes of a mode in telemetry: onset, amplitude, frequency and decay time.

`hapticd.fit` fits each strike separately, after the ringing of earlier strikes is subtracted. A fit begins at a time at
which a strike is due; it uses no values of the library. Telemetry contains the exact vibration, so nothing is left once
all strikes are found: a remainder is an unexpected strike. A strike is hidden if its onset is too near to a missed
period. The ringing of a mode is hidden after the force limit scaled it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from examples.demo.perform import Floats, Recorded
from hapticd.base.core import Flag
from hapticd.fit.limits import RINGING_LIMITS
from hapticd.fit.ringing import Ringing, fit_ringing

REST_BEFORE_ONSET_SAMPLES: Final = 8
"""Maximum number of silent samples before an onset that are part of its fit."""
MIN_REST_BEFORE_ONSET_SAMPLES: Final = 2
MAX_ROUNDING_ERROR: Final = 1e-6
"""Samples below this fraction of the largest sample are rounding errors."""
ON_TICK_S: Final = 1e-9
"""A strike within this time of a tick is on the tick."""
ENDS_AFTER_DECAY_TIMES: Final = 5.0
"""Duration of a mode in decay times."""
SAME_TIME_S: Final = 1e-6
"""Tolerance of the onset of a strike."""


@dataclass(frozen=True, slots=True)
class Strikes:
    """The n strikes that were found, in arrays (n,). Times are relative to the beginning of the recording."""

    number: npt.NDArray[np.intp]
    """Index of each strike in the due times."""
    onset_s: Floats
    due_s: Floats
    amplitude: Floats
    """Amplitude in m/s^2, positive along the axis."""
    frequencies_hz: Floats
    decay_times_s: Floats
    hidden: int
    """Number of strikes that are too near to a missed period to be fitted."""
    left_over: int
    """Number of samples with vibration that no strike explains."""

    @property
    def frequency_hz(self) -> float:
        """Median frequency of the strikes."""
        return float(np.median(self.frequencies_hz))

    @property
    def decay_time_s(self) -> float:
        """Median decay time of the strikes."""
        return float(np.median(self.decay_times_s))

    @property
    def late_s(self) -> float:
        """Largest difference between onset and due time, in s."""
        return float(abs(self.onset_s - self.due_s).max(initial=0.0))


def strikes_of(recorded: Recorded, axis: int, due_s: Sequence[float] | Floats) -> Strikes:
    """Fit the strikes at the times `due_s`, in order."""
    time_s, rest = recorded.time_s, recorded.vibration(axis)
    rounding = MAX_ROUNDING_ERROR * float(abs(rest).max())
    # The sample of a strike on a tick is zero up to rounding.
    first = np.searchsorted(time_s, np.asarray(due_s) - ON_TICK_S).tolist()
    # A single exact zero may be a zero of the sine, unless the next strike follows it.
    silent = np.flatnonzero((rest[:-1] == 0.0) & ((rest[1:] == 0.0) | np.isin(np.arange(1, len(rest)), first)))
    # In the tick of a strike the force limit scales the strike itself. In later ticks it scales the ringing mode: only
    # after missed periods, if the contact force grew beyond the margin of the strike.
    gaps, scaled = recorded.gaps(), np.zeros(len(rest), dtype=np.bool_)
    limited = np.setdiff1d(np.flatnonzero(recorded.flagged(Flag.SATURATED)), first)
    for at in limited[limited >= gaps.min(initial=len(rest))].tolist():
        scaled[at : _next(silent, at, len(rest))] = True
    rest[scaled] = 0.0
    gaps = np.union1d(gaps, np.flatnonzero(scaled))
    numbers: list[int] = []
    found: list[Ringing] = []
    onsets: list[float] = []
    hidden = left_over = unknown_until = 0  # before this sample an unknown strike rings
    for number, (at, following, due) in enumerate(zip(first, [*first, len(rest)][1:], due_s, strict=True)):
        group = slice(at, _next(silent, at + 1, len(rest)))
        end = min(group.stop, following)
        begin = max(at - REST_BEFORE_ONSET_SAMPLES, 0, *gaps[gaps <= at][-1:].tolist())
        seen = min(end, _next(gaps, at + 1, end))
        # The first strike determines the mode; the others need fewer samples.
        enough = (
            at - begin >= MIN_REST_BEFORE_ONSET_SAMPLES
            and seen - (begin if found else at) >= RINGING_LIMITS.min_samples
        )
        if at < unknown_until or not enough:
            hidden, unknown_until, rest[at:end] = hidden + 1, group.stop, 0.0
            continue
        start = replace(found[-1], onset_s=due - time_s[begin]) if found else None
        ringing = fit_ringing(rest[begin:seen], recorded.rate_hz, onset_s=due - time_s[begin], start=start)
        if unexplained := int(np.count_nonzero(abs(ringing.residual) > rounding)):
            # A missed period may cut the strike too short for a fit.
            left_over, hidden = (left_over, hidden + 1) if seen in gaps else (left_over + unexplained, hidden)
            unknown_until, rest[at:end] = group.stop, 0.0
            continue
        numbers.append(number)
        found.append(ringing)
        onsets.append(float(time_s[begin]) + ringing.onset_s)
        decay, omega = ringing.decay_rate_per_s[0], ringing.angular_frequency_rad_per_s[0]
        # The mode rings on into the next strike, unless it ended before. Its end has no silent sample if periods were
        # missed, or if the next strike is on the following tick.
        over = number + 1 + np.flatnonzero(np.diff(due_s[number:]) > ENDS_AFTER_DECAY_TIMES / decay + ON_TICK_S)
        group = slice(at, min([group.stop, *(first[n] for n in over[:1].tolist())]))
        since = time_s[group] - onsets[-1]
        rings = ringing.coefficients[0] * np.exp(-decay * since) * np.sin(omega * since)
        rest[group] -= np.where(scaled[group], 0.0, rings)
    return Strikes(
        number=np.array(numbers, dtype=np.intp),
        onset_s=np.array(onsets),
        due_s=np.asarray(due_s, dtype=np.float64)[numbers],
        amplitude=np.array([ringing.coefficients[0] for ringing in found]),
        frequencies_hz=np.array([ringing.angular_frequency_rad_per_s[0] for ringing in found]) / (2 * np.pi),
        decay_times_s=np.array([1 / ringing.decay_rate_per_s[0] for ringing in found]),
        hidden=hidden,
        left_over=left_over + int(np.count_nonzero(abs(rest) > rounding)),
    )


def _next(ordered: npt.NDArray[np.intp], at: int, otherwise: int) -> int:
    """Return the first of the ordered indices that is at least `at`; `otherwise` if none is."""
    return next(iter(ordered[np.searchsorted(ordered, at) :].tolist()), otherwise)
