"""Strikes of a mode as telemetry shows them: when, how hard, and with which frequency and decay.

Each strike is fitted by itself with `hapticd.fit`, in what is left when the ringing of earlier strikes is taken away.
A fit begins at a time at which something should have been struck; the library is not asked. Telemetry holds every bit
of the vibration, so that nothing is left once all strikes are found: what is left is a strike too many. A strike whose
onset lies too near to a missed period is hidden.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from examples.demo.perform import Floats, Recorded, Unseen
from hapticd.fit.taps.ringing import SHORTEST, Ringing, fit_ringing

REST: Final = 8
"""Samples of silence before an onset that are fitted with it;"""
LEAST_REST: Final = 2
"""at least so many are wanted."""
ROUNDING: Final = 1e-6
"""Part of the loudest sample; what is less is rounding."""
SAME_S: Final = 1e-6
"""A strike within this of the time that it was due at is in time."""


@dataclass(frozen=True, slots=True)
class Strikes:
    """Arrays (n,) of the strikes that were found."""

    number: tuple[int, ...]
    """Which of the times that were asked for each is."""
    onset_s: Floats
    amplitude: Floats
    """m/s^2, positive along the axis."""
    frequency_hz: float
    """Median over the strikes, as the next."""
    decay_time_s: float
    hidden: int
    """Strikes too near to a missed period to be seen."""
    left_over: int
    """Samples with vibration that no strike explains."""

    def late_s(self, due_s: Sequence[float] | Floats) -> float:
        """How far the worst is from the time that it was due at."""
        return float(abs(self.onset_s - np.asarray(due_s)[list(self.number)]).max())


def joined_strikes(found: Sequence[Strikes]) -> Strikes:
    """Those of several recordings; numbers and times are of each recording still."""
    return Strikes(
        number=tuple(number for each in found for number in each.number),
        onset_s=np.concatenate([each.onset_s for each in found]),
        amplitude=np.concatenate([each.amplitude for each in found]),
        frequency_hz=float(np.median([each.frequency_hz for each in found])),
        decay_time_s=float(np.median([each.decay_time_s for each in found])),
        hidden=sum(each.hidden for each in found),
        left_over=sum(each.left_over for each in found),
    )


def strikes_of(recorded: Recorded, axis: int, due_s: Sequence[float] | Floats) -> Strikes:
    """The strikes at the times `due_s`, in order. Raises Unseen where none can be seen."""
    time_s, rest = recorded.time_s, recorded.vibration(axis)
    rounding = ROUNDING * float(abs(rest).max())
    gaps, first = recorded.gaps(), np.searchsorted(time_s, due_s, side="right").tolist()
    # One exact zero may be the sine's own, but for the one after which the next strike begins.
    silent = np.flatnonzero((rest[:-1] == 0.0) & ((rest[1:] == 0.0) | np.isin(np.arange(1, len(rest)), first)))
    numbers: list[int] = []
    found: list[Ringing] = []
    onsets: list[float] = []
    hidden = left_over = unknown = 0  # samples; before `unknown` a strike rings that is not known
    for number, (at, following, due) in enumerate(zip(first, [*first[1:], len(rest)], due_s, strict=True)):
        group = slice(at, _next(silent, at + 1, len(rest)))
        end = min(group.stop, following)
        begin, seen = max(at - REST, 0, *gaps[gaps <= at][-1:].tolist()), min(end, _next(gaps, at + 1, end))
        # The first strike tells what a mode it is; of the others fewer samples are enough.
        if at < unknown or at - begin < LEAST_REST or seen - (begin if found else at) < SHORTEST:
            hidden, unknown, rest[at:end] = hidden + 1, group.stop, 0.0
            continue
        start = replace(found[-1], onset_s=due - time_s[begin]) if found else None
        ringing = fit_ringing(rest[begin:seen], recorded.rate_hz, onset_s=due - time_s[begin], start=start)
        if unexplained := int(np.count_nonzero(abs(ringing.residual) > rounding)):
            # What is cut off by a missed period may be too short for it.
            left_over, hidden = (left_over, hidden + 1) if seen < end else (left_over + unexplained, hidden)
            unknown, rest[at:end] = group.stop, 0.0
            continue
        numbers.append(number)
        found.append(ringing)
        onsets.append(float(time_s[begin]) + ringing.onset_s)
        # With the next strike the mode goes on ringing.
        since = time_s[group] - onsets[-1]
        decay, omega = ringing.decay_rate_per_s[0], ringing.angular_frequency_rad_per_s[0]
        rest[group] -= ringing.coefficients[0] * np.exp(-decay * since) * np.sin(omega * since)
    if not found:
        raise Unseen("no strike can be seen: the machine misses too many periods for the demo")
    return Strikes(
        number=tuple(numbers),
        onset_s=np.array(onsets),
        amplitude=np.array([ringing.coefficients[0] for ringing in found]),
        frequency_hz=float(np.median([ringing.angular_frequency_rad_per_s[0] for ringing in found]) / (2 * np.pi)),
        decay_time_s=float(np.median([1 / ringing.decay_rate_per_s[0] for ringing in found])),
        hidden=hidden,
        left_over=left_over + int(np.count_nonzero(abs(rest) > rounding)),
    )


def _next(ordered: npt.NDArray[np.intp], at: int, otherwise: int) -> int:
    """The first of some samples, in order, from one on."""
    return next(iter(ordered[np.searchsorted(ordered, at) :].tolist()), otherwise)
