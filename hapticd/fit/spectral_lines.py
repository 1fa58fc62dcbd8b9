"""Spectral lines, hum or other tones, with the fraction of the power that each holds.

In a periodogram of the complete recording with Hann's window, the power of noise is exponentially distributed. The mean
power of the noise is estimated from the median of n neighbouring bins. A bin belongs to a line if power/mean exceeds
the quantile 1 - p/N of the F distribution with 2 and 2 n degrees of freedom. Noise then exceeds it in any of the N bins
with a probability of at most p = LINE_LIMITS.max_chance. Half of several recordings must have the line, with a lower
threshold than for a single recording. A ringing is broader, and is not found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hapticd.analysis.statistics import Floats
from hapticd.fit.limits import LINE_LIMITS
from hapticd.fit.verdict import Warnings

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A tone and its fraction of the power above LINE_LIMITS.min_frequency_hz."""

    frequency_hz: float
    fraction: float


def spectral_lines(acceleration: Floats, rate_hz: float, needed: int = 1) -> list[SpectralLine]:
    """Return the spectral lines of the acceleration (n,) of one recording, the strongest first.

    `needed` is the number of recordings that must have a line; a larger number lowers the threshold of each recording.
    """
    from scipy.special import fdtri

    count = len(acceleration)
    # In a shorter recording a line cannot be separated from a ringing.
    if count < LINE_LIMITS.min_recording_s * rate_hz:
        return []
    width = rate_hz / count
    power = np.abs(np.fft.rfft(np.hanning(count) * (acceleration - acceleration.mean()))) ** 2
    frequency = np.fft.rfftfreq(count, 1 / rate_hz)
    total = float(power[frequency >= LINE_LIMITS.min_frequency_hz].sum())
    if not total > 0:
        return []
    # A line takes five bins of Hann's window. The noise is measured from half a hertz beyond these bins on.
    inner = 2 + math.ceil(LINE_LIMITS.max_same_hz / width)
    outer = inner + max(8, math.ceil(LINE_LIMITS.noise_band_hz / width))
    neighbours = 2 * (outer - inner)
    # The chance that `needed` recordings have a line within six bins of each other is max_chance; that of one recording
    # is limited to 1e-3.
    chance = (
        LINE_LIMITS.max_chance / len(power)
        if needed == 1
        else min(1e-3, (LINE_LIMITS.max_chance / len(power)) ** (1 / needed) / 6)
    )
    factor = float(fdtri(2, 2 * neighbours, 1 - chance))
    found: list[SpectralLine] = []
    left = power.copy()
    left[(frequency < LINE_LIMITS.min_frequency_hz) | (np.arange(len(power)) < outer)] = 0.0
    left[max(0, len(power) - outer) :] = 0.0
    for _ in range(10 * LINE_LIMITS.max_lines):
        place = int(np.argmax(left))
        here = slice(place - 2, place + 3)
        if left[place] <= 0 or power[here].sum() < LINE_LIMITS.min_power_fraction * total:
            break
        about = np.concatenate((power[place - outer : place - inner], power[place + inner + 1 : place + outer + 1]))
        # Mean of an exponential distribution from its median, which other lines do not change.
        mean = float(np.median(about)) / math.log(2)
        fraction = (float(power[here].sum()) - 5 * mean) / total
        if power[place] > factor * mean and fraction > LINE_LIMITS.min_power_fraction:
            near = slice(place - 1, place + 2)
            middle = float(power[near] @ frequency[near]) / float(power[near].sum())
            found.append(SpectralLine(middle, fraction))
        left[place - inner : place + inner + 1] = 0.0
    return sorted(found, key=lambda line: -line.fraction)


def lines_in_residual(acceleration: Floats, modelled: Floats, rate_hz: float, needed: int = 1) -> list[SpectralLine]:
    """Return the spectral lines in the residual of a recording (n,), with their fractions of the recording's power.

    Samples where `modelled` is NaN are not used. `needed` is that of `spectral_lines`.
    """
    left = np.where(np.isfinite(modelled), acceleration - modelled, 0.0)
    part = float(np.var(left) / np.var(acceleration)) if np.var(acceleration) > 0 else 0.0
    return [SpectralLine(line.frequency_hz, part * line.fraction) for line in spectral_lines(left, rate_hz, needed)]


def common_lines(recordings: Sequence[_T], lines_in: Callable[[_T, int], list[SpectralLine]]) -> list[SpectralLine]:
    """Return the spectral lines in at least half of the recordings, with their mean fraction, sorted by frequency.

    `lines_in(recording, needed)` returns the lines of one recording, as `spectral_lines` does.
    """
    count = len(recordings)
    needed = max(1, math.ceil(count / 2))
    every = [(place, line) for place, each in enumerate(recordings) for line in lines_in(each, needed)]
    every.sort(key=lambda each: each[1].frequency_hz)
    found: list[SpectralLine] = []
    while every:
        first = every[0][1].frequency_hz
        alike = [each for each in every if each[1].frequency_hz - first < LINE_LIMITS.max_same_hz]
        every = every[len(alike) :]
        if len({place for place, _ in alike}) < needed:
            continue
        weight = sum(line.fraction for _, line in alike)
        middle = sum(line.frequency_hz * line.fraction for _, line in alike) / weight
        if weight / count > LINE_LIMITS.min_power_fraction:
            found.append(SpectralLine(middle, weight / count))
    return found


def report_lines(
    recordings: Sequence[_T], lines_in: Callable[[_T, int], list[SpectralLine]], warnings: Warnings
) -> None:
    """Add a warning, which makes the verdict fair at best, about spectral lines in at least half of the recordings."""
    if hum := common_lines(recordings, lines_in):
        warnings.add_fair(described(hum))


def described(lines: Sequence[SpectralLine]) -> str:
    """Return a warning about one or more spectral lines, as text."""
    # Rounded to 0.1 Hz, as a bin is a fraction of a hertz wide.
    hertz = {line: f"{round(line.frequency_hz, 1):.10g} Hz" for line in lines}
    if len(lines) == 1:
        what = f"a line at {hertz[lines[0]]} holds {100 * lines[0].fraction:.2g} % of the power"
    else:
        loudest = sorted(lines, key=lambda line: -line.fraction)[: LINE_LIMITS.max_lines]
        loudest.sort(key=lambda line: line.frequency_hz)
        fractions = ", ".join(f"{hertz[line]} {100 * line.fraction:.2g} %" for line in loudest)
        more = f" and {len(lines) - len(loudest)} more" if len(lines) > len(loudest) else ""
        what = f"lines hold {100 * sum(line.fraction for line in lines):.2g} % of the power ({fractions}{more})"
    return f"{what}: hum or another tone, which changes the figures"
