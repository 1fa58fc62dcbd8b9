"""The amplitude of taps over the approach speed: a line through the origin, a power law, or a table.

The one with the lowest AICc (Akaike's criterion, corrected for few points; Burnham and Anderson 2002, 2.4) is chosen,

    AICc = n ln(S/n) + 2 k + 2 k (k + 1)/(n - k - 1),

S the weighted squares that it leaves over of n taps, k its parameters and the scale of the scatter. All have the same
weights: of the noise, and of a scatter in proportion to the amplitude. A law that is lower than the line by less than
CLEARLY, or differs from it by less than BENT, is a line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats, aicc, least_squares, through_origin
from hapticd.base.yaml_source import Json
from hapticd.fit.taps.law import BENT, TABLE, Amplitudes, table
from hapticd.fit.verdict import Doubts

LawKind: TypeAlias = Literal["line", "power", "table"]
WELL_KNOWN: Final = 0.15
"""What taps are off a law that is no line, as a part of the amplitude."""
POINTS_OFF: Final = 1e-3
"""The table of a power law is so near to it, as a part of it."""
BEYOND: Final = 2.0
"""From the slowest tap's speed over this to the fastest one's times this."""
MOST_POINTS: Final = 256
"""Of a material's table."""
MOST_EXPONENT: Final = 5.0
CLEARLY: Final = 2.0
"""Of AICc."""
_STEPS: Final = 50


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
                f"AICc of another law is lower by less than {CLEARLY:g}, or it differs by less than {100 * BENT:.0f} %"
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
    count = len(speeds)
    weights = _weights(speeds, amplitudes, variances)
    line = _weighted_line(speeds, amplitudes, weights) * speeds
    power = _power(speeds, amplitudes, variances)
    tables = _tables(speeds, amplitudes, variances)
    laid: dict[LawKind, tuple[Floats, float]] = {"line": (line, _aicc(line, amplitudes, weights, 1))}
    if power is not None:
        curve = power.coefficient_m_per_s2.value * speeds**power.exponent.value
        laid["power"] = (curve, _aicc(curve, amplitudes, weights, 2))
    chosen_table, least = tables[-1], math.inf
    for points in tables:
        found = _along(points, speeds)
        criterion = _aicc(found, amplitudes, weights, len(points))
        if criterion < least:
            chosen_table, least = points, criterion
            laid["table"] = (found, criterion)
    known = {kind: value for kind, (_, value) in laid.items() if math.isfinite(value)}
    known = known or {"line": 0.0}
    kind: LawKind = min(known, key=lambda each: known[each])
    size = np.maximum(line, np.finfo(np.float64).tiny)
    bent = float(np.sqrt(np.mean(((laid[kind][0] - line) / size) ** 2)))
    if bent < BENT or known.get("line", math.inf) < known[kind] + CLEARLY:
        kind = "line"
    kind = only or kind
    model = laid[kind][0]
    mean = float(np.sum(weights * amplitudes) / np.sum(weights))
    about = float(np.sum(weights * (amplitudes - mean) ** 2))
    lowest = min(known.values(), default=0.0)
    return Law(
        kind=kind,
        above={each: value - lowest for each, value in known.items()},
        power=power,
        table=chosen_table if kind == "table" else table(speeds, amplitudes, variances),
        r_squared=1 - float(np.sum(weights * (amplitudes - model) ** 2)) / about if about > 0 and count > 1 else 0.0,
        left=float(np.sqrt(np.mean(((amplitudes - model) / np.maximum(np.abs(model), 1e-300)) ** 2))),
    )


def doubt_the_law(doubts: Doubts, law: Law, r_squared: float) -> None:
    """Whether the speed says what the amplitude is; `r_squared` of the line."""
    share = r_squared if law.kind == "line" else law.r_squared
    # Where the amplitude hardly depends on the speed, r^2 says nothing: what counts is how far taps are from it.
    if law.kind == "line" or law.left > WELL_KNOWN:
        doubts.at_least("r^2 of the law of taps", share, f"the speed says little of the amplitude (r^2 {share:.2f})")


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


def _weighted_line(speeds: Floats, amplitudes: Floats, weights: Floats) -> float:
    return through_origin(speeds * np.sqrt(weights), amplitudes * np.sqrt(weights)).coefficients[0].value


def _aicc(model: Floats, amplitudes: Floats, weights: Floats, unknowns: int) -> float:
    squares = float(np.sum(weights * (amplitudes - model) ** 2))
    # Of taps without any noise the rounding.
    squares = max(squares, 1e-24 * float(np.sum(weights * amplitudes**2)))
    return aicc(squares, len(amplitudes), unknowns)


def _tables(speeds: Floats, amplitudes: Floats, variances: Floats) -> list[Amplitudes]:
    """Of 2 to TABLE speeds."""
    found = {}
    for count in range(2, min(TABLE, max(2, len(speeds) - 2)) + 1):
        points = table(speeds, amplitudes, variances, count)
        found[len(points)] = points
    return list(found.values())


def _along(points: Amplitudes, speeds: Floats) -> Floats:
    nodes, heights = np.array([(0.0, 0.0), *((speed, amplitude.value) for speed, amplitude in points)]).T
    return np.asarray(np.interp(speeds, nodes, heights), dtype=np.float64)


def _power(speeds: Floats, amplitudes: Floats, variances: Floats) -> Power | None:
    """By Gauss's and Newton's steps from the line of the logarithms."""
    if len(speeds) < 3 or not (amplitudes > 0).all():
        return None
    middle = math.exp(float(np.mean(np.log(speeds))))
    logs = np.log(speeds / middle)
    exponent, height = np.polyfit(logs, np.log(amplitudes), 1)
    for _ in range(_STEPS):
        fitted = _step(logs, amplitudes, variances, float(height), float(exponent))
        height_of, exponent_of = fitted
        moved = abs(height_of.value - height) + abs(exponent_of.value - exponent)
        height, exponent = height_of.value, exponent_of.value
        if not abs(exponent) < MOST_EXPONENT or not abs(height) < 50:
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

    first, last = max(1e-4, float(speeds.min()) / BEYOND), min(100.0, float(speeds.max()) * BEYOND)
    bend = math.sqrt(8 * POINTS_OFF / max(1e-6, abs(exponent * (1 - exponent))))
    count = min(MOST_POINTS, 2 + math.ceil(math.log(last / first) / bend))
    nodes = np.geomspace(first, last, count)
    points = tuple((float(speed), at(float(speed))) for speed in nodes)
    dense = np.geomspace(first, last, 64 * count)
    law = np.exp(height) * (dense / middle) ** exponent
    return Power(
        exponent=exponent_of,
        coefficient_m_per_s2=at(1.0),
        points=points,
        off=float(np.max(np.abs(_along(points, dense) / law - 1))),
    )


def _step(logs: Floats, amplitudes: Floats, variances: Floats, height: float, exponent: float) -> list[Estimate]:
    """ln A where the logarithms of the speeds are 0, and the exponent, a step nearer."""
    model = np.exp(height + exponent * logs)
    columns = np.column_stack((model, model * logs))
    wanted = amplitudes - model + columns @ np.array([height, exponent])
    return list(least_squares(columns, wanted, variances, model**2).coefficients)
