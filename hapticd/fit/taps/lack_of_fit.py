"""Whether what taps leave over has a shape."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from hapticd.analysis.statistics import improbable
from hapticd.fit.taps.hit import CHANCE, COLOURED, Hit, colour

MISSHAPEN: Final = 0.02
"""RMS over that of the ringing, from which on a shape of what is left over is reported."""


def lack_of_fit(hits: Sequence[Hit]) -> tuple[str, str]:
    """Whether what is left over has a shape that all taps have, and is no noise: the score test of the shapes that
    ringing.py tries beside the mode. Empty where it has none."""
    more = "the figures may be farther off than their intervals say"
    coloured = float(np.median([colour(tap, ringing) for tap, ringing in hits]))
    size = len(hits[0][1].lack_of_fit[0])
    score, squares, heard, samples = np.zeros(size), np.zeros((size, size)), 0.0, 0
    for tap, ringing in hits:
        score += ringing.lack_of_fit[0] / tap.noise_m_per_s2**2
        squares += ringing.lack_of_fit[1] / tap.noise_m_per_s2**2
        modelled = tap.modelled - np.median(tap.modelled)
        heard += float(modelled @ modelled) / tap.noise_m_per_s2**2
        samples += len(tap.measured) - 6
    taken = float(score @ np.linalg.lstsq(squares, score, rcond=1e-9)[0])
    share = math.sqrt(max(0.0, taken) / heard) if heard > 0 else 0.0
    chance = improbable(float(samples), samples, max(0.0, samples - taken), samples - size)
    if share > MISSHAPEN and (chance < CHANCE or coloured > COLOURED):
        return f"what is left over has a shape, {100 * share:.0f} % of the ringing", more
    left = math.sqrt(
        sum(float(ringing.residual @ ringing.residual) / tap.noise_m_per_s2**2 for tap, ringing in hits) / heard
    )
    if coloured > COLOURED and left > MISSHAPEN:
        return f"what is left over is {coloured:.1f} times the noise before the taps", more
    return "", ""
