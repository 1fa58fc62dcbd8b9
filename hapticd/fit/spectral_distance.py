"""How far a model's spectrum is from a recorded one, in decibels."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Floats
from hapticd.fit.spectrum_peak import LOW_HZ, smoothed

COMPARED_DB: Final = 20.0
"""Spectra are compared where the recorded one is within this of its peak."""


def apart_db(frequency: Floats, model: Floats, power: Floats) -> float:
    """RMS difference of two densities (n,) over bands of a twelfth of an octave, as a periodogram itself scatters."""
    loud = (frequency >= LOW_HZ) & (smoothed(power, 2) > 10 ** (-COMPARED_DB / 10) * smoothed(power, 2).max())
    band = np.round(12 * np.log2(np.maximum(frequency, 1.0))).astype(int)
    differences = [
        10 * math.log10(float(model[here].mean() / power[here].mean()))
        for each in np.unique(band[loud])
        if np.count_nonzero(here := loud & (band == each))
    ]
    return float(np.sqrt(np.mean(np.square(differences))))
