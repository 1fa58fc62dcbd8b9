"""Clipped samples: runs of equal samples at an end of the sensor's range."""

from __future__ import annotations

from typing import Final

import numpy as np

from hapticd.analysis.recordings.spans import Bools, spans_of
from hapticd.analysis.statistics import Floats

MIN_CLIPPED_RUN_SAMPLES: Final = 3
"""Smallest number of successive equal samples, at an end of the range, that count as a clipped peak."""
MIN_CLIPPED_EDGE_STEPS: Final = 3.0
"""A clipped peak begins or ends with a change of more than this number of quantization steps. The peak of a slow signal
with coarse steps also rests at its highest step, but reaches this step by changes of one step."""
MAX_SHORT_RUN_SAMPLES: Final = 4
"""Longest run of equal samples that noise and coarse steps can cause at the peak of a pulse without clipping."""
MIN_SHORT_RUN_EDGE_SIGMAS: Final = 4.0
"""A short run counts as clipped only if it begins or ends with a change of more than this number of standard deviations
of the noise. Clipping after a smaller change would remove little more than noise."""


def clipped(values: Floats, noise: float = 0.0) -> Bools:
    """Return a mask (n,) of the clipped samples. `noise` is the standard deviation at rest, 0 if unknown."""
    found = np.zeros(len(values), dtype=np.bool_)
    steps = np.abs(np.diff(values))
    if not steps.any():
        return found
    quantum = float(steps[steps > 0].min())
    # Without noise, the value at rest may be the largest or smallest of the recording without being clipped.
    rest = np.median(values)
    for extreme in {values.max(), values.min()} - {rest}:
        for begin, end in spans_of(values == extreme):
            around = np.concatenate((steps[max(0, begin - 1) : begin], steps[end - 1 : end]))
            leap = MIN_CLIPPED_EDGE_STEPS * quantum
            if end - begin <= MAX_SHORT_RUN_SAMPLES:
                leap = max(leap, MIN_SHORT_RUN_EDGE_SIGMAS * noise)
            if end - begin >= MIN_CLIPPED_RUN_SAMPLES and around.size and around.max() > leap:
                found[begin:end] = True
    return found
