"""Strikes of a mode as telemetry shows them: when, how hard, and with which frequency and decay.

Each strike is fitted by itself with `hapticd.fit`, in what is left when the ringing of earlier strikes is taken away.
A fit begins at a time at which something should have been struck; the library is not asked. Telemetry holds every bit
of the vibration, so that nothing is left once all strikes are found: what is left is a strike too many. A strike whose
onset lies too near to a missed period is hidden. So is what rings on after the force limit scaled it.
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
"""Samples of silence that are fitted with an onset, where there are so many."""
MIN_REST_BEFORE_ONSET_SAMPLES: Final = 2
ROUNDING_OF_LOUDEST_SAMPLE: Final = 1e-6
"""What is less than this part of the loudest sample is rounding."""
ON_TICK_S: Final = 1e-9
"""A strike within this of a tick is on it."""
ENDS_AFTER_DECAY_TIMES: Final = 5.0
"""So long a mode sounds."""
SAME_TIME_S: Final = 1e-6
"""A strike within this of the time that it was due at is in time."""


@dataclass(frozen=True, slots=True)
class Strikes:
    """Arrays (n,) of the strikes that were found; times are of the recording that each was found in."""

    number: npt.NDArray[np.intp]
    """Which of the times that were asked for each is."""
    onset_s: Floats
    due_s: Floats
    amplitude: Floats
    """m/s^2, positive along the axis."""
    frequencies_hz: Floats
    decay_times_s: Floats
    hidden: int
    """Strikes too near to a missed period to be seen."""
    left_over: int
    """Samples with vibration that no strike explains."""

    @property
    def frequency_hz(self) -> float:
        return float(np.median(self.frequencies_hz))

    @property
    def decay_time_s(self) -> float:
        return float(np.median(self.decay_times_s))

    @property
    def late_s(self) -> float:
        """How far the worst is from the time that it was due at."""
        return float(abs(self.onset_s - self.due_s).max(initial=0.0))


def strikes_of(recorded: Recorded, axis: int, due_s: Sequence[float] | Floats) -> Strikes:
    """The strikes at the times `due_s`, in order."""
    time_s, rest = recorded.time_s, recorded.vibration(axis)
    rounding = ROUNDING_OF_LOUDEST_SAMPLE * float(abs(rest).max())
    # A strike on a tick begins there with what rounding leaves of zero.
    first = np.searchsorted(time_s, np.asarray(due_s) - ON_TICK_S).tolist()
    # One exact zero may be the sine's own, but for the one after which the next strike begins.
    silent = np.flatnonzero((rest[:-1] == 0.0) & ((rest[1:] == 0.0) | np.isin(np.arange(1, len(rest)), first)))
    # In the tick of a strike the limit scales that strike. Later it scales what rings: after missed periods alone, in
    # which the contact force grew more than the strike had left room for.
    gaps, scaled = recorded.gaps(), np.zeros(len(rest), dtype=np.bool_)
    limited = np.setdiff1d(np.flatnonzero(recorded.flagged(Flag.SATURATED)), first)
    for at in limited[limited >= gaps.min(initial=len(rest))].tolist():
        scaled[at : _next(silent, at, len(rest))] = True
    rest[scaled] = 0.0
    gaps = np.union1d(gaps, np.flatnonzero(scaled))
    numbers: list[int] = []
    found: list[Ringing] = []
    onsets: list[float] = []
    hidden = left_over = unknown_until = 0  # before this sample a strike rings that is not known
    for number, (at, following, due) in enumerate(zip(first, [*first, len(rest)][1:], due_s, strict=True)):
        group = slice(at, _next(silent, at + 1, len(rest)))
        end = min(group.stop, following)
        begin = max(at - REST_BEFORE_ONSET_SAMPLES, 0, *gaps[gaps <= at][-1:].tolist())
        seen = min(end, _next(gaps, at + 1, end))
        # The first strike shows what mode it is; of the others fewer samples are enough.
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
            # What is cut off by a missed period may be too short for it.
            left_over, hidden = (left_over, hidden + 1) if seen in gaps else (left_over + unexplained, hidden)
            unknown_until, rest[at:end] = group.stop, 0.0
            continue
        numbers.append(number)
        found.append(ringing)
        onsets.append(float(time_s[begin]) + ringing.onset_s)
        decay, omega = ringing.decay_rate_per_s[0], ringing.angular_frequency_rad_per_s[0]
        # With the next strike the mode goes on ringing, unless it ended before: where the end was missed, or the next
        # strike is on the tick after it, no sample is silent.
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
    """The first of some samples, in order, from one on."""
    return next(iter(ordered[np.searchsorted(ordered, at) :].tolist()), otherwise)
