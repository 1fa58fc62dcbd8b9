"""What the figures of taps are over the approach speed: a line through the origin, or straight lines between points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np

from hapticd.analysis.statistics import (
    Estimate,
    FitError,
    Floats,
    Regression,
    improbable,
    least_squares,
    student_t,
    through_origin,
    with_offset,
)
from hapticd.base.yaml_source import Json
from hapticd.fit.taps.hit import CHANCE, LEAST_TAPS, TapHit

BENT: Final = 0.05
"""A(v) is reported to be no line through the origin where that is less likely by chance, and matters more than this."""
TABLE: Final = 8
"""Speeds of a table of amplitudes, at most."""
APART: Final = 0.02
"""And they are apart by so much."""
OUTLYING: Final = 0.25
"""A tap this far off the line of the others is reported."""
SOFTEST: Final = 0.003
HARDEST: Final = 10.0
"""Slope over w: 1 where a mass at this speed rings elastically; the paper's seven are 0.07 to 0.87."""
MOVED_FREQUENCY: Final = 0.02
MOVED_DECAY: Final = 0.1
"""From the slowest to the fastest tap; what is less is not reported."""

Amplitudes: TypeAlias = tuple[tuple[float, Estimate], ...]
"""Speeds in m/s, rising, and m/s^2."""


def knots_of(speeds: Floats, count: int) -> Floats:
    """From the slowest to the fastest, with about as many taps between any two; so many, or fewer where they are not
    APART."""
    order = np.sort(speeds)
    found: list[float] = []
    for speed in order[np.linspace(0, len(order) - 1, count).round().astype(int)]:
        if not found or speed > (1 + APART) * found[-1]:
            found.append(float(speed))
    return np.array(found)


def table(speeds: Floats, amplitudes: Floats, variances: Floats, most: int = TABLE) -> Amplitudes:
    """The straight lines between so many of the speeds that are nearest to the amplitudes, none below 0."""
    knots = knots_of(speeds, min(most, max(2, len(speeds) - 2)))
    nodes = np.concatenate(([0.0], knots))
    hats = np.column_stack([np.interp(speeds, nodes, row) for row in np.eye(len(nodes))[1:]])
    # What would be negative is 0, and the others are fitted without it.
    kept = np.ones(len(knots), dtype=np.bool_)
    while True:
        line = least_squares(hats[:, kept], amplitudes, variances, speeds**2)
        below = [value.value < 0 for value in line.coefficients]
        if not any(below):
            break
        kept[np.flatnonzero(kept)[below]] = False
    found = iter(line.coefficients)
    points = [
        (float(knot), next(found) if keep else Estimate(0.0, 0.0, 0.0)) for knot, keep in zip(knots, kept, strict=True)
    ]
    return tuple((knot, Estimate(value.value, max(0.0, value.low), value.high)) for knot, value in points)


def bends(speeds: Floats, amplitudes: Floats, noise: Floats) -> str:
    """What keeps A(v) from being a line through the origin; empty where nothing does."""
    if len(speeds) < LEAST_TAPS + 2:
        return ""
    ones = np.ones_like(speeds)
    size = float(np.mean(amplitudes))
    weights = noise / np.mean(noise)
    scale = 1 / np.sqrt(weights)

    def laid(*columns: Floats) -> tuple[Regression, Floats]:
        found = least_squares(np.column_stack(columns) * scale[:, None], amplitudes * scale)
        return found, amplitudes - found.residual / scale

    origin, straight = laid(speeds)
    offset, shifted = laid(speeds, ones)
    curve, curved = laid(speeds, speeds**2, ones)
    bend = float(np.sqrt(np.mean((curved - shifted) ** 2))) / size
    if bend > BENT and improbable(offset.squares, offset.freedom, curve.squares, curve.freedom) < CHANCE:
        return f"A(v) is not linear: a curve is {100 * bend:.0f} % off the line"
    off = float(np.sqrt(np.mean((shifted - straight) ** 2))) / size
    if off > BENT and improbable(origin.squares, origin.freedom, offset.squares, offset.freedom) < CHANCE:
        value = offset.coefficients[1].value
        return f"A(v) does not go through the origin: it has {value:.3g} m/s^2 at rest"
    return ""


def check_slope(slope: Estimate) -> None:
    """Raises FitError where the amplitude does not rise with the speed."""
    if not slope.low > 0:
        raise FitError(
            f"the speed says nothing of the amplitude: the slope is {slope.value:.4g} 1/s, from {slope.low:.4g} to "
            f"{slope.high:.4g}: are these taps of one material, and is each speed that of its tap?"
        )


def check_hardness(slope_per_s: float, angular: float, named: str) -> None:
    """Raises FitError where the slope is none of a touch at an angular frequency, which is `named` so."""
    ratio = slope_per_s / angular
    if not SOFTEST <= ratio <= HARDEST:
        raise FitError(
            f"the amplitude over speed is {slope_per_s:.4g} 1/s, {ratio:.2g} times {named}; a touch has "
            f"{SOFTEST:g} to {HARDEST:g}: is the acceleration or the speed off by a thousand (mm, g)?"
        )


def single_outlier(taps: Sequence[TapHit], speeds: Floats, amplitudes: Floats, noise: Floats) -> str:
    """The one tap without which A(v) is a line through the origin; empty where there is none."""
    if len(speeds) < LEAST_TAPS + 3:
        return ""
    found: tuple[float, int, float] | None = None
    scale = np.sqrt(np.mean(noise) / noise)
    for index in range(len(speeds)):
        others = np.delete(np.arange(len(speeds)), index)
        line = through_origin((speeds * scale)[others], (amplitudes * scale)[others])
        expected = line.coefficients[0].value * speeds[index]
        own = float(((amplitudes[index] - expected) * scale[index]) ** 2)
        # The line of the others is uncertain there, too.
        own /= 1 + float((speeds * scale)[index] ** 2 / np.sum((speeds * scale)[others] ** 2))
        # The deleted residual against those of the others: n ways to be the farthest by chance.
        chance = len(speeds) * improbable(line.squares + own, line.freedom + 1, line.squares, line.freedom)
        if found is None or chance < found[0]:
            found = (chance, index, amplitudes[index] / expected - 1)
    assert found is not None
    chance, index, off = found
    others = np.delete(np.arange(len(speeds)), index)
    if chance > CHANCE or abs(off) < OUTLYING or bends(speeds[others], amplitudes[others], noise[others]):
        return ""
    side = "above" if off > 0 else "below"
    return (
        f"the tap at {taps[index].onset_s:.4g} s of {taps[index].recording} is {100 * abs(off):.0f} % {side} the line "
        "of the others"
    )


def moves(speeds: Floats, logs: Floats, variances: Floats, what: str, least: float) -> str:
    """Whether a figure changes with the speed; empty where it does not."""
    if len(speeds) < LEAST_TAPS + 2:
        return ""
    slope = with_offset(speeds, logs, variances).coefficients[0]
    freedom = len(speeds) - 2
    if not slope.value:
        return ""
    # With the chance of CHANCE: as many standard errors as t has there.
    wide = (slope.high - slope.value) * student_t(freedom, 1 - CHANCE) / student_t(freedom)
    change = math.expm1(slope.value * float(np.ptp(speeds)))
    if abs(slope.value) < wide or abs(change) < least:
        return ""
    return (
        f"the {what} {'rises' if change > 0 else 'falls'} by {100 * abs(change):.0f} % from the slowest to the fastest"
    )


def json_table(amplitudes: Amplitudes) -> Json:
    return [{"speed_m_per_s": speed, "coefficient_m_per_s2": amplitude.to_dict()} for speed, amplitude in amplitudes]
