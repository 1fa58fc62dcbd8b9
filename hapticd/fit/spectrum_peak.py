"""The peak of a mean spectrum, its interval, and whether there is one at all.

The peak is that of a parabola in 1/density over the squared frequency within the half-power band, by Whittle's
likelihood: a single resonance has just this shape. Its interval is jackknifed over groups of blocks, or over strokes
where they differ by more than the blocks do by chance. Where the parabola of the upper quarter of the power has its
peak elsewhere, the spectrum is no single resonance, and the interval takes in both.

A peak is resolved where the density is lower on both sides: the spectrum ends below LOW_HZ, so that one which is as
high there has its peak anywhere below. Then the interval begins at 0; it ends where the parabola's does, within the
half-power band, or where the highest point lies in 97.5 % of resampled groups (Efron's bootstrap, 1979), if that is
more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Estimate, Floats, Ints, jackknife_error

LOW_HZ: Final = 20.0
GROUPS: Final = 20
"""Of blocks, at most, that the jackknife leaves out one at a time."""
DIFFER: Final = 0.95
"""Strokes differ by more than their blocks where chance makes less than that of them with this probability."""
HALF, QUARTER = 0.5, 0.75
"""Parts of the highest density above which parabolas are fitted."""
SMOOTH_HZ: Final = 15.0
"""Densities are means over so much to either side."""
RESAMPLED: Final = 400
HIGHEST: Final = 0.975
NEAR: Final = 0.2
"""The density of a peak is that within this part of it to either side."""
ROOM: Final = 1.3
"""A peak is so many times LOW_HZ at least, or its lower side is not seen."""


@dataclass(frozen=True, slots=True)
class Peak:
    """Of a spectrum."""

    hz: Estimate
    resolved: bool


def peak_of(frequency: Floats, shape: Floats, strokes: Ints) -> Peak:
    """Of densities (blocks, frequencies) of the blocks of these strokes (blocks,)."""
    found = jackknifed(lambda density: parabola_peak(frequency, density), shape, strokes)
    top = jackknifed(lambda density: parabola_peak(frequency, density, QUARTER), shape, strokes)
    apart = jackknifed(
        lambda density: parabola_peak(frequency, density) - parabola_peak(frequency, density, QUARTER), shape, strokes
    )
    if apart.low > 0 or apart.high < 0:
        found = Estimate(found.value, min(found.low, top.low), max(found.high, top.high))
    resolved = found.low > 0 and found.high - found.low <= found.value and _falls_below(frequency, shape, found.value)
    if resolved:
        return Peak(found, True)
    # An interval may have run away, but nothing with less than half of the highest density is the peak.
    reach = min(found.high, _half_power(frequency, shape.mean(axis=0)))
    return Peak(Estimate(found.value, 0.0, max(_highest(frequency, shape), reach, found.value)), False)


def jackknifed(figure: Callable[[Floats], float], shape: Floats, strokes: Ints) -> Estimate:
    """A figure of the mean density with its interval: each group of blocks left out in turn, or each stroke."""
    from scipy.special import fdtri

    value = figure(shape.mean(axis=0))
    error, freedom = _left_out(figure, shape, groups_of(len(shape)))
    by_stroke = [np.flatnonzero(strokes == each) for each in np.unique(strokes)]
    if 3 <= len(by_stroke) <= GROUPS:
        wider, fewer = _left_out(figure, shape, by_stroke)
        if wider > error * math.sqrt(float(fdtri(fewer, freedom, DIFFER))):
            error, freedom = wider, fewer
    return Estimate.from_error(value, error, freedom)


def groups_of(blocks: int) -> list[Ints]:
    """Blocks in a row, by their numbers."""
    edges = np.linspace(0, blocks, min(GROUPS, blocks) + 1).round().astype(np.int64)
    return [np.arange(low, high) for low, high in pairwise(edges)]


def _left_out(figure: Callable[[Floats], float], shape: Floats, groups: Sequence[Ints]) -> tuple[float, int]:
    """Standard error and degrees of freedom; groups of different sizes count alike (Busing, Meijer and van der Leeden,
    1999, have the weights, which change little)."""
    total = shape.sum(axis=0)
    without = np.array([figure((total - shape[each].sum(axis=0)) / (len(shape) - len(each))) for each in groups])
    return float(jackknife_error(without)), len(groups) - 1


def smoothed(values: Floats, half: int) -> Floats:
    """Means over 2 half + 1 of them, along the last axis; at the ends the last one goes on."""
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.convolve(np.pad(values, half, mode="edge"), kernel, mode="valid")


def parabola_peak(frequency: Floats, shape: Floats, part: float = HALF) -> float:
    """Of the band in which the density (frequencies,) is more than this part of its highest."""
    smooth = smoothed(shape, max(1, round(SMOOTH_HZ / frequency[1])))
    whole = frequency >= LOW_HZ
    place = int(np.argmax(np.where(whole, smooth, 0.0)))
    low = high = place
    while low > 0 and whole[low - 1] and smooth[low - 1] > part * smooth[place]:
        low -= 1
    while high < len(smooth) - 1 and smooth[high + 1] > part * smooth[place]:
        high += 1
    band = slice(low, high + 1)
    if high - low < 6:
        return float(frequency[place])
    square = frequency**2
    width = float(square[high] - square[low])
    x = (square[band] - square[place]) / width
    columns = np.stack([np.ones_like(x), x, x**2], axis=1)
    seen = shape[band] / smooth[place]
    found = np.linalg.lstsq(columns * smooth[band, None], np.full(len(x), smooth[place]), rcond=None)[0]
    if (columns @ found).min() <= 0:
        found = np.array([1.0, 0.0, 1.0])

    def unlikely(at: Floats) -> float:
        inverse = columns @ at
        return float(np.sum(seen * inverse - np.log(inverse))) if inverse.min() > 0 else math.inf

    least = unlikely(found)
    for _ in range(50):
        inverse = columns @ found
        slope = columns.T @ (seen - 1 / inverse)
        step = np.linalg.solve((columns / inverse[:, None] ** 2).T @ columns, -slope)
        while unlikely(found + step) > least and np.abs(step).max() > 1e-12:
            step = step / 2
        found = found + step
        reached = unlikely(found)
        if least - reached < 1e-10:
            break
        least = reached
    if found[2] <= 0:
        return float(frequency[place])
    best = math.sqrt(max(0.0, float(square[place] - width * found[1] / (2 * found[2]))))
    return min(max(best, float(frequency[low])), float(frequency[high]))


def _falls_below(frequency: Floats, shape: Floats, peak_hz: float) -> bool:
    """Whether the density near LOW_HZ is less than at the peak by more than chance."""
    if peak_hz < ROOM * LOW_HZ:
        return False
    low = (frequency >= LOW_HZ) & (frequency <= LOW_HZ + max(frequency[1] * 2, (peak_hz - LOW_HZ) / 3))
    high = (frequency >= (1 - NEAR) * peak_hz) & (frequency <= (1 + NEAR) * peak_hz) & ~low
    if not low.any() or not high.any():
        return False

    def fallen(density: Floats) -> float:
        return math.log(max(float(density[high].mean()), 1e-300) / max(float(density[low].mean()), 1e-300))

    return jackknifed(fallen, shape, np.zeros(len(shape), dtype=np.int64)).low > 0


def _half_power(frequency: Floats, density: Floats) -> float:
    """The first frequency above the highest point with less than half of its density."""
    smooth = smoothed(density, max(1, round(SMOOTH_HZ / frequency[1])))
    place = int(np.argmax(np.where(frequency >= LOW_HZ, smooth, 0.0)))
    below = np.flatnonzero(smooth[place:] < HALF * smooth[place])
    return float(frequency[place + below[0]] if len(below) else frequency[-1])


def _highest(frequency: Floats, shape: Floats) -> float:
    """Where the highest density lies at most, in HIGHEST of the resampled groups of blocks."""
    groups = groups_of(len(shape))
    sums = np.stack([shape[each].sum(axis=0) for each in groups])
    drawn = np.random.default_rng(0).integers(len(groups), size=(RESAMPLED, len(groups)))
    half = max(1, round(SMOOTH_HZ / frequency[1]))
    whole = frequency >= LOW_HZ
    at = [float(frequency[np.argmax(np.where(whole, smoothed(sums[each].sum(axis=0), half), 0.0))]) for each in drawn]
    return float(np.quantile(at, HIGHEST))
