"""Frequency and decay time of taps over the approach speed, where they change with it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats, Regression, aicc, least_squares
from hapticd.base.yaml_source import Json
from hapticd.fit.plain_data import fields_of
from hapticd.fit.taps.hit import Figures
from hapticd.fit.taps.law import MOVED_DECAY, MOVED_FREQUENCY, knots_of, moves

MOST_POINTS: Final = 5
"""Of the table; fewer where AICc is lower so."""


@dataclass(frozen=True, slots=True)
class Modes:
    """What taps ring with, on straight lines between the speeds and constant beyond."""

    speeds_m_per_s: tuple[float, ...]
    frequencies_hz: tuple[Estimate, ...]
    decay_times_s: tuple[Estimate, ...]
    why: str

    def frequency_at(self, speeds: Floats) -> Floats:
        return np.interp(speeds, self.speeds_m_per_s, [each.value for each in self.frequencies_hz])

    def decay_time_at(self, speeds: Floats) -> Floats:
        return np.interp(speeds, self.speeds_m_per_s, [each.value for each in self.decay_times_s])

    def material(self) -> dict[str, Json]:
        """As `mode_table` of a tap."""
        return {
            "speeds_m_per_s": list(self.speeds_m_per_s),
            "frequencies_hz": [each.value for each in self.frequencies_hz],
            "decay_times_s": [each.value for each in self.decay_times_s],
        }

    def to_dict(self) -> dict[str, Json]:
        return fields_of(self)


def modes_of(figures: Figures, frequency_hz: Estimate, decay_time_s: Estimate) -> Modes | None:
    """The table, where one of the two changes from the slowest tap to the fastest by more than chance and enough to
    matter (tap_law.moves); the other stays the common one. Else None."""
    moved = (
        moves(figures.speeds, figures.angulars, figures.of_angular, "frequency", MOVED_FREQUENCY),
        moves(figures.speeds, -figures.decays, figures.of_decay, "decay time", MOVED_DECAY),
    )
    if not any(moved):
        return None
    hertz, times = np.exp(figures.angulars) / (2 * math.pi), np.exp(-figures.decays)
    pairs = [(hertz, figures.of_angular * hertz**2), (times, figures.of_decay * times**2)]
    knots, least = knots_of(figures.speeds, 2), math.inf
    for count in range(2, MOST_POINTS + 1):
        tried = knots_of(figures.speeds, count)
        if len(tried) < count:
            continue
        criteria = [_aicc(figures.speeds, *pair, tried) for pair, reason in zip(pairs, moved, strict=True) if reason]
        if sum(criteria) < least:
            knots, least = tried, sum(criteria)
    laid = [
        _laid(figures.speeds, *pair, knots).coefficients if reason else (common,) * len(knots)
        for pair, reason, common in zip(pairs, moved, (frequency_hz, decay_time_s), strict=True)
    ]
    return Modes(
        tuple(float(knot) for knot in knots), tuple(laid[0]), tuple(laid[1]), " and ".join(filter(None, moved))
    )


def _laid(speeds: Floats, values: Floats, variances: Floats, knots: Floats) -> Regression:
    hats = np.column_stack([np.interp(speeds, knots, row) for row in np.eye(len(knots))])
    return least_squares(hats, values, variances)


def _aicc(speeds: Floats, values: Floats, variances: Floats, knots: Floats) -> float:
    """With the weights of two points."""
    try:
        scatter = _laid(speeds, values, variances, knots_of(speeds, 2)).scatter
        left = _laid(speeds, values, variances, knots).residual
    except FitError:
        return math.inf
    squares = max(float(np.sum(left**2 / (variances + scatter**2))), 1e-24)
    return aicc(squares, len(values), len(knots))
