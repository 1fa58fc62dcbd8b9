"""Clipped samples: those that stand still at an end of the sensor's range."""

from __future__ import annotations

from typing import Final

import numpy as np

from hapticd.analysis.recordings.spans import Bools, spans_of
from hapticd.analysis.statistics import Floats

LEAST_RUN: Final = 3
"""So many equal samples at the largest or the smallest value are a clipped peak,"""
LEAST_LEAP_IN_STEPS: Final = 3.0
"""where they are reached or left by more than so many steps of the numbers: a slow peak of coarse numbers stays at its
highest step, too, but comes to it step by step."""
SHORT_RUN: Final = 4
"""Samples: so short a run of equal ones is what noise makes of the peak of a pulse in coarse numbers,"""
LEAST_LEAP_TO_NOISE: Final = 4.0
"""where it is reached by steps of less than so many standard deviations of the noise. Clipping would take away little
more than the noise there."""


def clipped(values: Floats, noise: float = 0.0) -> Bools:
    """(n,) which of the samples are; `noise` is the standard deviation of the samples at rest, where it is known."""
    found = np.zeros(len(values), dtype=np.bool_)
    steps = np.abs(np.diff(values))
    if not steps.any():
        return found
    quantum = float(steps[steps > 0].min())
    # Without noise, rest may be an end of the range, too.
    rest = np.median(values)
    for extreme in {values.max(), values.min()} - {rest}:
        for begin, end in spans_of(values == extreme):
            around = np.concatenate((steps[max(0, begin - 1) : begin], steps[end - 1 : end]))
            leap = LEAST_LEAP_IN_STEPS * quantum
            if end - begin <= SHORT_RUN:
                leap = max(leap, LEAST_LEAP_TO_NOISE * noise)
            if end - begin >= LEAST_RUN and around.size and around.max() > leap:
                found[begin:end] = True
    return found
