"""The spacing of grooves: the regular row that strikes lie in, and the number of each strike's groove."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import FitError, Floats, Ints

FEW: Final = 300
"""Strikes that a spacing is first looked for with."""


@dataclass(frozen=True, slots=True)
class Row:
    """Groove numbers (n,), so that strike k lies at about `first_m + number[k] * spacing_m`."""

    number: Ints
    spacing_m: float
    first_m: float

    def offsets(self, place: Floats) -> Floats:
        """(n,) distances of strikes from their places in the row, in m, with their signs."""
        return np.asarray(place - self.first_m - self.number * self.spacing_m)

    def unevenness(self, place: Floats) -> float:
        """RMS distance of strikes from their places in the row, as a part of the spacing."""
        return float(np.sqrt(np.mean(self.offsets(place) ** 2))) / self.spacing_m


def row_of(place: Floats) -> Row:
    """The row of strikes at `place` (n,), in m. By where the strikes lie, or from strike to strike (a speed that was
    integrated drifts), whichever is the more even."""
    steps = np.abs(np.diff(place))
    steps = steps[steps > 0]
    if len(steps) < 2:
        raise FitError("the strikes are all at one place: is the position the wrong column?")
    usual = float(np.median(steps))
    return min((_by_place(place, usual), _by_step(place, usual)), key=lambda row: row.unevenness(place))


def slope_of_row(number: Ints, place: Floats) -> float:
    """The spacing, by least squares; negative where the places fall as the numbers rise."""
    centred = number - number.mean()
    square = float(centred @ centred)
    return float(centred @ place) / square if square > 0 else 0.0


def _by_step(place: Floats, spacing: float) -> Row:
    """Each groove's number from the step to it."""
    number = np.zeros(len(place), dtype=np.int64)
    for _ in range(4):
        number = np.concatenate(([0], np.cumsum(np.round(np.diff(place) / spacing).astype(np.int64))))
        spacing = abs(slope_of_row(number, place)) or spacing
    return Row(number, spacing, float(np.median(place - spacing * number)))


def _by_place(place: Floats, usual: float) -> Row:
    """The spacing is the one whose phases agree best, of half the usual step to two and a half of it; half of one that
    agrees does as well, so the largest is taken."""
    few = place[:FEW]
    waves = np.arange(0.4 / usual, 2.0 / usual, 0.2 / max(float(np.ptp(few)), usual))
    agree = np.abs(np.exp(2j * math.pi * np.outer(waves, few)).mean(axis=1))
    best = int(np.argmax(agree > 0.95 * agree.max()))
    while best + 1 < len(waves) and agree[best + 1] > agree[best]:
        best += 1
    spacing = 1 / float(waves[best])
    first = spacing * float(np.angle(np.exp(2j * math.pi * few / spacing).mean())) / (2 * math.pi)
    # Of more strikes each time, as an error of the spacing adds up.
    for count in (*_doubled(min(len(few), 16), len(place)), len(place)):
        part = place[:count]
        number = np.round((part - first) / spacing).astype(np.int64)
        near = np.abs(part - first - number * spacing) < 0.25 * spacing
        if np.ptp(number[near]) if near.any() else 0:
            spacing = abs(slope_of_row(number[near], part[near]))
            first = float(np.median(part[near] - spacing * number[near]))
    return Row(np.round((place - first) / spacing).astype(np.int64), spacing, first)


def _doubled(first: int, last: int) -> list[int]:
    found = [first]
    while found[-1] < last:
        found.append(min(last, 2 * found[-1]))
    return found
