"""The amplitude of taps over the approach speed: a line through the origin, a power law, or a table.

The one with the lowest AICc (Akaike's criterion, corrected for few points; Burnham and Anderson 2002, 2.4) is chosen,

    AICc = n ln(S/n) + 2 k + 2 k (k + 1)/(n - k - 1),

S the weighted squares that it leaves over of n taps, k its parameters and the scale of the scatter. All have the same
weights: of the noise, and of a scatter in proportion to the amplitude. A law that is lower than the line by less than
SPEED_LAW_LIMITS.min_aicc_gain, or differs from it by less than SPEED_LAW_LIMITS.min_bend, is a line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np

from hapticd.analysis.statistics import (
    Estimate,
    FitError,
    Floats,
    Regression,
    aicc,
    improbable,
    least_squares,
    student_t,
    through_origin,
    with_offset,
)
from hapticd.base.yaml_source import Json
from hapticd.fit.limits import SPEED_LAW_LIMITS
from hapticd.fit.verdict import Warnings

LawKind: TypeAlias = Literal["line", "power", "table"]
Amplitudes: TypeAlias = tuple[tuple[float, Estimate], ...]
"""Speeds in m/s, rising, and m/s^2."""


class Tap(Protocol):
    """One tap, whatever was fitted to it."""

    @property
    def recording(self) -> str: ...

    @property
    def onset_s(self) -> float:
        """On the recording's clock."""

    @property
    def speed_m_per_s(self) -> float: ...


def check_speeds(taps: Sequence[Tap]) -> None:
    """Raises FitError for speeds that cannot be, or where the fastest is less than 1.2 times the slowest."""
    low, high = SPEED_LAW_LIMITS.min_speed_m_per_s, SPEED_LAW_LIMITS.max_speed_m_per_s
    slowest, fastest = min(taps, key=lambda tap: tap.speed_m_per_s), max(taps, key=lambda tap: tap.speed_m_per_s)
    for tap, allowed, unit in (
        (fastest, fastest.speed_m_per_s <= high, "is it in mm/s, or are columns swapped?"),
        (slowest, slowest.speed_m_per_s >= low, "is it in km/s, or the position in the wrong unit?"),
    ):
        if not allowed:
            raise FitError(
                f"{tap.recording}: the tap at {tap.onset_s:.4g} s has a speed of {tap.speed_m_per_s:.4g} m/s, taps "
                f"have {low:g} to {high:g}: {unit}"
            )
    if fastest.speed_m_per_s < SPEED_LAW_LIMITS.min_speed_ratio * slowest.speed_m_per_s:
        raise FitError(
            f"all {len(taps)} taps have about one speed ({slowest.speed_m_per_s:.4g} to "
            f"{fastest.speed_m_per_s:.4g} m/s): a slope over speed needs slow ones and fast ones"
        )


def check_slope(slope: Estimate) -> None:
    """Raises FitError where the amplitude does not rise with the speed."""
    if not slope.low > 0:
        raise FitError(
            f"the speed says nothing of the amplitude: the slope is {slope.value:.4g} 1/s, from {slope.low:.4g} to "
            f"{slope.high:.4g}: are these taps of one material, and is each speed that of its tap?"
        )


def check_hardness(slope_per_s: float, angular: float, named: str) -> None:
    """Raises FitError where the slope is none of a touch at an angular frequency, which is `named` so: their ratio is 1
    where a mass at this speed rings elastically; the paper's seven are 0.07 to 0.87."""
    softest, hardest = SPEED_LAW_LIMITS.min_slope_to_angular, SPEED_LAW_LIMITS.max_slope_to_angular
    ratio = slope_per_s / angular
    if not softest <= ratio <= hardest:
        raise FitError(
            f"the amplitude over speed is {slope_per_s:.4g} 1/s, {ratio:.2g} times {named}; a touch has "
            f"{softest:g} to {hardest:g}: is the acceleration or the speed off by a thousand (mm, g)?"
        )


# ---- Laws ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Power:
    """A = coefficient v^exponent, v in m/s."""

    exponent: Estimate
    coefficient_m_per_s2: Estimate
    """At 1 m/s."""
    points: Amplitudes
    """As a material has it: straight lines between points of the law."""
    off: float
    """The largest error of these lines between the first point and the last, as a part of the law."""

    def to_dict(self) -> dict[str, Json]:
        return {
            "exponent": self.exponent.to_dict(),
            "coefficient_m_per_s2": self.coefficient_m_per_s2.to_dict(),
            "points": [[speed, amplitude.value] for speed, amplitude in self.points],
            "points_off": self.off,
        }


@dataclass(frozen=True, slots=True)
class Law:
    """The law that was chosen for A(v), and the others."""

    kind: LawKind
    above: Mapping[LawKind, float]
    """AICc of each kind less the lowest; without those that the taps are too few for."""
    power: Power | None
    """None where the taps have no power law."""
    table: Amplitudes
    """Straight lines from rest to the first speed and from one to the next."""
    r_squared: float
    """Of the chosen law, about the weighted mean."""
    left: float
    """RMS of what the chosen law leaves over, as a part of the amplitudes."""

    @property
    def named(self) -> str:
        """What A(v) is."""
        if self.kind == "line":
            return "a line through the origin"
        if self.kind == "table" or self.power is None:
            return f"a table of {len(self.table)} speeds"
        return f"a power law of exponent {self.power.exponent.value:.2f}"

    @property
    def points(self) -> Amplitudes:
        """As `amplitudes` of a material has A(v): points of the power law, where it is one, else the table."""
        return self.power.points if self.kind == "power" and self.power is not None else self.table

    @property
    def why(self) -> str:
        """Why this one: the criterion of the others."""
        names: Mapping[LawKind, str] = {"line": "a line", "power": "a power law", "table": "a table"}
        others = " and ".join(f"{above:.1f} for {names[kind]}" for kind, above in self.above.items() if above > 0)
        if self.kind == "line" and self.above.get("line", 0.0) > 0:
            return (
                f"AICc of another law is lower by less than {SPEED_LAW_LIMITS.min_aicc_gain:g}, "
                f"or it differs by less than {100 * SPEED_LAW_LIMITS.min_bend:.0f} %"
            )
        return f"AICc is higher by {others}" if others else "the taps are too few to tell"

    def to_dict(self) -> dict[str, Json]:
        return {
            "kind": self.kind,
            "why": self.why,
            "aicc_above_lowest": {kind: above for kind, above in self.above.items()},
            "power": None if self.power is None else self.power.to_dict(),
            "r_squared": self.r_squared,
            "left": self.left,
        }


def law_of(speeds: Floats, amplitudes: Floats, variances: Floats, only: LawKind | None = None) -> Law:
    """The law of amplitudes (n,) in m/s^2 over speeds in m/s, with the variances of their noise; `only` is taken
    without a choice."""
    weights = _weights(speeds, amplitudes, variances)

    def criterion(model: Floats, unknowns: int) -> float:
        squares = float(np.sum(weights * (amplitudes - model) ** 2))
        # Of taps without any noise the rounding.
        squares = max(squares, 1e-24 * float(np.sum(weights * amplitudes**2)))
        return aicc(squares, len(amplitudes), unknowns)

    root = np.sqrt(weights)
    line = through_origin(speeds * root, amplitudes * root).coefficients[0].value * speeds
    power = _power(speeds, amplitudes, variances)
    laid: dict[LawKind, tuple[Floats, float]] = {"line": (line, criterion(line, 1))}
    if power is not None:
        curve = power.coefficient_m_per_s2.value * speeds**power.exponent.value
        laid["power"] = (curve, criterion(curve, 2))
    # Of few taps, and of speeds that are hardly apart, some tables have fewer speeds than were asked for.
    tried = (table(speeds, amplitudes, variances, count) for count in range(2, SPEED_LAW_LIMITS.max_table_speeds + 1))
    tables = list({len(points): points for points in tried}.values())
    chosen_table, least = tables[-1], math.inf
    for points in tables:
        found = _along(points, speeds)
        reached = criterion(found, len(points))
        if reached < least:
            chosen_table, least = points, reached
            laid["table"] = (found, reached)
    known = {kind: value for kind, (_, value) in laid.items() if math.isfinite(value)} or {"line": 0.0}
    kind: LawKind = min(known, key=lambda each: known[each])
    size = np.maximum(line, np.finfo(np.float64).tiny)
    bent = float(np.sqrt(np.mean(((laid[kind][0] - line) / size) ** 2)))
    if bent < SPEED_LAW_LIMITS.min_bend or known.get("line", math.inf) < known[kind] + SPEED_LAW_LIMITS.min_aicc_gain:
        kind = "line"
    kind = only or kind
    model = laid[kind][0]
    mean = float(np.sum(weights * amplitudes) / np.sum(weights))
    about = float(np.sum(weights * (amplitudes - mean) ** 2))
    lowest = min(known.values())
    return Law(
        kind=kind,
        above={each: value - lowest for each, value in known.items()},
        power=power,
        table=chosen_table if kind == "table" else table(speeds, amplitudes, variances),
        r_squared=1 - float(np.sum(weights * (amplitudes - model) ** 2)) / about if about > 0 else 0.0,
        left=float(np.sqrt(np.mean(((amplitudes - model) / np.maximum(np.abs(model), 1e-300)) ** 2))),
    )


def check_law(warnings: Warnings, law: Law, r_squared: float) -> None:
    """Whether the speed says what the amplitude is; `r_squared` of the line."""
    if law.kind != "line":
        warnings.note(f"A(v) is {law.named}, no line through the origin: {law.why}")
    # Where the amplitude hardly depends on the speed, r^2 says nothing: what counts is how far taps are from it.
    if law.kind == "line" or law.left > SPEED_LAW_LIMITS.max_scatter:
        warnings.check("r^2 of the law of taps", r_squared if law.kind == "line" else law.r_squared)


def _weights(speeds: Floats, amplitudes: Floats, variances: Floats) -> Floats:
    """Of the noise and a scatter in proportion to the amplitude, as a smooth curve has it."""
    columns = np.column_stack((np.ones_like(speeds), np.log(speeds)))
    logs = np.log(np.maximum(amplitudes, 1e-6 * float(np.max(amplitudes))))
    if len(speeds) > 4:
        columns = np.column_stack((columns, np.log(speeds) ** 2))
    try:
        found = least_squares(columns, logs, variances / amplitudes**2)
    except FitError:
        found = least_squares(columns[:, :1], logs, variances / amplitudes**2)
    smooth = np.exp(logs - found.residual)
    return np.asarray(1.0 / (variances + (found.scatter * smooth) ** 2), dtype=np.float64)


# ---- Tables ----------------------------------------------------------------------------------------------------------


def knots_of(speeds: Floats, count: int) -> Floats:
    """From the slowest to the fastest, with about as many taps between any two; so many, or fewer where they are not
    apart by 2 %."""
    order = np.sort(speeds)
    found: list[float] = []
    for speed in order[np.linspace(0, len(order) - 1, count).round().astype(int)]:
        if not found or speed > SPEED_LAW_LIMITS.min_table_step * found[-1]:
            found.append(float(speed))
    return np.array(found)


def table(
    speeds: Floats, amplitudes: Floats, variances: Floats, most: int = SPEED_LAW_LIMITS.max_table_speeds
) -> Amplitudes:
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
    points = dict.fromkeys(map(float, knots), Estimate(0.0, 0.0, 0.0))
    for knot, value in zip(knots[kept], line.coefficients, strict=True):
        points[float(knot)] = Estimate(value.value, max(0.0, value.low), value.high)
    return tuple(points.items())


def json_table(amplitudes: Amplitudes, what: str = "coefficient_m_per_s2") -> Json:
    return [{"speed_m_per_s": speed, what: amplitude.to_dict()} for speed, amplitude in amplitudes]


def _along(points: Amplitudes, speeds: Floats) -> Floats:
    nodes, heights = np.array([(0.0, 0.0), *((speed, amplitude.value) for speed, amplitude in points)]).T
    return np.asarray(np.interp(speeds, nodes, heights), dtype=np.float64)


# ---- The power law ---------------------------------------------------------------------------------------------------


def _power(speeds: Floats, amplitudes: Floats, variances: Floats) -> Power | None:
    """By Gauss's and Newton's steps from the line of the logarithms."""
    if len(speeds) < 3 or not (amplitudes > 0).all():
        return None
    middle = math.exp(float(np.mean(np.log(speeds))))
    logs = np.log(speeds / middle)
    exponent, height = np.polyfit(logs, np.log(amplitudes), 1)
    for _ in range(50):
        height_of, exponent_of = _step(logs, amplitudes, variances, float(height), float(exponent))
        moved = abs(height_of.value - height) + abs(exponent_of.value - exponent)
        height, exponent = height_of.value, exponent_of.value
        if not abs(exponent) < 5.0 or not abs(height) < 50:
            return None
        if moved < 1e-12:
            break
    else:
        return None
    # At rest there is no amplitude, whatever the law says.
    if exponent <= 0:
        return None

    def at(speed: float) -> Estimate:
        here = float(height + exponent * math.log(speed / middle))
        return _step(np.log(speeds / speed), amplitudes, variances, here, float(exponent))[0].mapped(math.exp)

    # From half the slowest tap's speed to twice the fastest one's, lines within a thousandth of the law.
    first, last = max(1e-4, float(speeds.min()) / 2), min(100.0, float(speeds.max()) * 2)
    bend = math.sqrt(8e-3 / max(1e-6, abs(exponent * (1 - exponent))))
    count = min(256, 2 + math.ceil(math.log(last / first) / bend))
    points = tuple((float(speed), at(float(speed))) for speed in np.geomspace(first, last, count))
    dense = np.geomspace(first, last, 64 * count)
    law = np.exp(height) * (dense / middle) ** exponent
    off = float(np.max(np.abs(_along(points, dense) / law - 1)))
    return Power(exponent_of, at(1.0), points, off)


def _step(logs: Floats, amplitudes: Floats, variances: Floats, height: float, exponent: float) -> tuple[Estimate, ...]:
    """ln A where the logarithms of the speeds are 0, and the exponent, a step nearer."""
    model = np.exp(height + exponent * logs)
    columns = np.column_stack((model, model * logs))
    wanted = amplitudes - model + columns @ np.array([height, exponent])
    return least_squares(columns, wanted, variances, model**2).coefficients


# ---- What is off a law -----------------------------------------------------------------------------------------------


def single_outlier(taps: Sequence[Tap], speeds: Floats, amplitudes: Floats, noise: Floats) -> str:
    """The one tap, a quarter and more off, without which A(v) is a line through the origin; empty where there is
    none."""
    count = len(speeds)
    if count < SPEED_LAW_LIMITS.min_taps + 3:
        return ""
    scale = np.sqrt(np.mean(noise) / noise)
    x, y = speeds * scale, amplitudes * scale
    line = through_origin(x, y)
    # By so much each tap adds to the squares that the line of the others leaves.
    added = line.residual**2 / (1 - x**2 / float(x @ x))
    index = int(np.argmax(added))
    others = np.delete(np.arange(count), index)
    # n ways to be the farthest by chance.
    chance = count * improbable(line.squares, line.freedom, line.squares - float(added[index]), line.freedom - 1)
    off = float(amplitudes[index] / speeds[index] * (x[others] @ x[others]) / (x[others] @ y[others])) - 1
    if (
        chance > SPEED_LAW_LIMITS.significance
        or abs(off) < SPEED_LAW_LIMITS.min_outlier_distance
        or _bends(speeds[others], amplitudes[others], noise[others])
    ):
        return ""
    side = "above" if off > 0 else "below"
    return (
        f"the tap at {taps[index].onset_s:.4g} s of {taps[index].recording} is {100 * abs(off):.0f} % {side} the line "
        "of the others"
    )


def _bends(speeds: Floats, amplitudes: Floats, noise: Floats) -> bool:
    """Whether A(v) is no line through the origin: it has an offset, or is a curve."""
    ones = np.ones_like(speeds)
    size = float(np.mean(amplitudes))
    scale = 1 / np.sqrt(noise / np.mean(noise))

    def laid(*columns: Floats) -> tuple[Regression, Floats]:
        found = least_squares(np.column_stack(columns) * scale[:, None], amplitudes * scale)
        return found, amplitudes - found.residual / scale

    origin, straight = laid(speeds)
    offset, shifted = laid(speeds, ones)
    curve, curved = laid(speeds, speeds**2, ones)
    for less, more, apart in ((offset, curve, curved - shifted), (origin, offset, shifted - straight)):
        part = float(np.sqrt(np.mean(apart**2))) / size
        if (
            part > SPEED_LAW_LIMITS.min_bend
            and improbable(less.squares, less.freedom, more.squares, more.freedom) < SPEED_LAW_LIMITS.significance
        ):
            return True
    return False


def moves(speeds: Floats, logs: Floats, variances: Floats, what: str, least: float) -> str:
    """Whether a figure changes with the speed by `least` from the slowest tap to the fastest; empty where it does
    not."""
    if len(speeds) < SPEED_LAW_LIMITS.min_taps + 2:
        return ""
    slope = with_offset(speeds, logs, variances).coefficients[0]
    freedom = len(speeds) - 2
    # As many standard errors as t has at SPEED_LAW_LIMITS.significance.
    wide = (slope.high - slope.value) * student_t(freedom, 1 - SPEED_LAW_LIMITS.significance) / student_t(freedom)
    change = math.expm1(slope.value * float(np.ptp(speeds)))
    if not slope.value or abs(slope.value) < wide or abs(change) < least:
        return ""
    return (
        f"the {what} {'rises' if change > 0 else 'falls'} by {100 * abs(change):.0f} % from the slowest to the fastest"
    )
