"""Amplitude of taps as a function of the approach speed: a line through the origin, a power law, or a table.

The law with the lowest AICc is chosen (Akaike's criterion, corrected for few points; Burnham and Anderson 2002, 2.4):

    AICc = n ln(S/n) + 2 k + 2 k (k + 1)/(n - k - 1),

S is the weighted sum of squared residuals of n taps, k the number of parameters including the scale of the scatter. All
laws have the same weights, from the noise and a scatter proportional to the amplitude. The line is chosen unless
another law has an AICc lower by SPEED_LAW_LIMITS.min_aicc_gain and differs from the line by SPEED_LAW_LIMITS.min_bend.
AICc is strict with few taps: if the line explains the amplitudes poorly, another law that leaves less than half of the
line's scatter is chosen.
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
    f_test_p,
    least_squares,
    rank_correlation,
    student_t,
    through_origin,
    with_offset,
)
from hapticd.base.yaml_source import Json
from hapticd.fit.limits import SPEED_LAW_LIMITS
from hapticd.fit.verdict import LOWER_LIMITS, UPPER_LIMITS, Warnings

LawKind: TypeAlias = Literal["line", "power", "table"]
Amplitudes: TypeAlias = tuple[tuple[float, Estimate], ...]
"""Pairs of speed, m/s, and amplitude, m/s^2, sorted by speed."""


class Tap(Protocol):
    """A tap fitted by a mode or a waveform."""

    @property
    def recording(self) -> str:
        """Name of the tap's recording."""

    @property
    def onset_s(self) -> float:
        """Onset of the tap on the recording's clock."""

    @property
    def speed_m_per_s(self) -> float:
        """Approach speed of the stylus."""


def check_speeds(taps: Sequence[Tap]) -> None:
    """Raise FitError for impossible speeds, or if the fastest tap is less than 1.2 times as fast as the slowest."""
    low, high = SPEED_LAW_LIMITS.min_speed_m_per_s, SPEED_LAW_LIMITS.max_speed_m_per_s
    slowest, fastest = min(taps, key=lambda tap: tap.speed_m_per_s), max(taps, key=lambda tap: tap.speed_m_per_s)
    for tap, allowed, unit in (
        (fastest, fastest.speed_m_per_s <= high, "is it in mm/s, or are columns swapped?"),
        (slowest, slowest.speed_m_per_s >= low, "is it in km/s, or the position in the wrong unit?"),
    ):
        if not allowed:
            raise FitError(
                f"{tap.recording}: speed of the tap at {tap.onset_s:.4g} s: must be between {low:g} and {high:g} m/s, "
                f"is {tap.speed_m_per_s:.4g}: {unit}"
            )
    if fastest.speed_m_per_s < SPEED_LAW_LIMITS.min_speed_ratio * slowest.speed_m_per_s:
        raise FitError(
            f"all {len(taps)} taps have about one speed ({slowest.speed_m_per_s:.4g} to "
            f"{fastest.speed_m_per_s:.4g} m/s): a slope needs slow and fast taps"
        )


def check_hardness(speeds: Floats, amplitudes: Floats, angular_frequency: float, name: str) -> None:
    """Raise FitError if most ratios of amplitude to speed are impossible for a tap of this angular frequency.

    The ratio is the angular frequency for a mass that rings elastically, and 0.07 to 0.87 times the angular frequency
    for the seven materials of Okamura et al. 1998. `name` is the name of the angular frequency in the error.
    """
    softest, hardest = SPEED_LAW_LIMITS.min_slope_to_angular_frequency, SPEED_LAW_LIMITS.max_slope_to_angular_frequency
    low, slope_per_s, high = map(float, np.percentile(amplitudes / speeds, (25.0, 50.0, 75.0)))
    ratio = slope_per_s / angular_frequency
    if not (softest * angular_frequency <= high and low <= hardest * angular_frequency):
        raise FitError(
            f"the ratio of amplitude to speed is {slope_per_s:.4g} 1/s: must be between {softest:g} and {hardest:g} "
            f"times {name}, is {ratio:.2g} times: is the acceleration or the speed off by a thousand (mm, g)?"
        )


# ---- Laws ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Power:
    """Power law of a tap's amplitude: the coefficient times v^exponent, with the approach speed v in m/s."""

    exponent: Estimate
    coefficient_m_per_s2: Estimate
    """Amplitude at 1 m/s."""
    points: Amplitudes
    """Points of the law, between which a material interpolates linearly."""
    off: float
    """Largest error of linear interpolation between the first point and the last, as a fraction of the law."""

    def to_dict(self) -> dict[str, Json]:
        """Return the law as plain data for JSON."""
        return {
            "exponent": self.exponent.to_dict(),
            "coefficient_m_per_s2": self.coefficient_m_per_s2.to_dict(),
            "points": [[speed, amplitude.value] for speed, amplitude in self.points],
            "points_off": self.off,
        }


@dataclass(frozen=True, slots=True)
class Law:
    """Chosen law of amplitude versus approach speed, and the alternatives."""

    kind: LawKind
    above: Mapping[LawKind, float]
    """AICc of each kind of law minus the lowest AICc; kinds that need more taps are left out."""
    power: Power | None
    """The power law, or None if none fits the taps."""
    table: Amplitudes
    """The law as a table: amplitudes at several speeds, interpolated linearly between them and down to 0 at rest."""
    r_squared: float
    """r^2 of the chosen law, about the weighted mean."""
    left: float
    """RMS residual of the chosen law, as a fraction of the amplitudes."""
    rank_correlation: float
    """Spearman's rank correlation of speed and amplitude."""
    why: str

    @property
    def named(self) -> str:
        """Name of the chosen law, in words."""
        if self.kind == "line":
            return "a line through the origin"
        if self.kind == "table" or self.power is None:
            return f"a table of {len(self.table)} speeds"
        return f"a power law of exponent {self.power.exponent.value:.2f}"

    @property
    def points(self) -> Amplitudes:
        """Value of `amplitudes` of a material: points on the curve of the power law, or the table."""
        return self.power.points if self.kind == "power" and self.power is not None else self.table

    def to_dict(self) -> dict[str, Json]:
        """Return the law as plain data for JSON."""
        return {
            "kind": self.kind,
            "why": self.why,
            "aicc_above_lowest": {kind: above for kind, above in self.above.items()},
            "power": None if self.power is None else self.power.to_dict(),
            "r_squared": self.r_squared,
            "left": self.left,
            "rank_correlation": self.rank_correlation,
        }


def law_of(
    speeds: Floats, amplitudes: Floats, variances: Floats, only: LawKind | None = None, because: str = "as requested"
) -> Law:
    """Return the law of the taps' amplitudes (n,), m/s^2, versus their approach speeds (n,), m/s.

    `variances` (n,) are those of the amplitudes due to noise. The law of the kind `only`, if given, is always chosen,
    for the reason `because`; raises FitError if this is the power law and none fits the amplitudes.
    """
    weights = _weights(speeds, amplitudes, variances)
    mean = float(np.sum(weights * amplitudes) / np.sum(weights))
    about = float(np.sum(weights * (amplitudes - mean) ** 2))

    def squares(model: Floats) -> float:
        return float(np.sum(weights * (amplitudes - model) ** 2))

    def criterion(model: Floats, unknowns: int) -> float:
        # Synthetic taps without noise have residuals by rounding only.
        rounding = 1e-24 * float(np.sum(weights * amplitudes**2))
        return aicc(max(squares(model), rounding), len(amplitudes), unknowns)

    def r_squared(model: Floats) -> float:
        return 1 - squares(model) / about if about > 0 else 0.0

    def left(model: Floats) -> float:
        # A table may be 0 at a tap.
        size = np.maximum(np.abs(model), 1e-9 * float(np.max(amplitudes)))
        return float(np.sqrt(np.mean(((amplitudes - model) / size) ** 2)))

    root = np.sqrt(weights)
    line = through_origin(speeds * root, amplitudes * root).coefficients[0].value * speeds
    power = _power(speeds, amplitudes, variances)
    laid: dict[LawKind, tuple[Floats, float]] = {"line": (line, criterion(line, 1))}
    if power is not None:
        curve = power.coefficient_m_per_s2.value * speeds**power.exponent.value
        laid["power"] = (curve, criterion(curve, 2))
    elif only == "power":
        raise FitError("no power law was found: none with an exponent between 0 and 5 fits the amplitudes")
    # Few taps or similar speeds give tables with fewer speeds than requested, and some of them twice.
    tried = (table(speeds, amplitudes, variances, count) for count in range(2, SPEED_LAW_LIMITS.max_table_speeds + 1))
    tables = list({len(points): points for points in tried}.values())
    chosen_table, lowest = tables[-1], math.inf
    for points in tables:
        found = _along(points, speeds)
        reached = criterion(found, len(points))
        if reached < lowest:
            chosen_table, lowest = points, reached
            laid["table"] = (found, reached)
    known = {kind: value for kind, (_, value) in laid.items() if math.isfinite(value)} or {"line": 0.0}
    lowest = min(known.values())
    above = {each: value - lowest for each, value in known.items()}
    names: Mapping[LawKind, str] = {"line": "a line", "power": "a power law", "table": "a table"}
    others = " and ".join(f"{more:.1f} for {names[each]}" for each, more in above.items() if more > 0)
    why = f"AICc is higher by {others}" if others else "too few taps to compare laws"
    kind: LawKind = min(known, key=lambda each: known[each])
    size = np.maximum(line, np.finfo(np.float64).tiny)
    bent = float(np.sqrt(np.mean(((laid[kind][0] - line) / size) ** 2)))
    if bent < SPEED_LAW_LIMITS.min_bend or known.get("line", math.inf) < lowest + SPEED_LAW_LIMITS.min_aicc_gain:
        if kind != "line":
            why = (
                f"AICc of another law is lower by less than {SPEED_LAW_LIMITS.min_aicc_gain:g}, "
                f"or it differs by less than {100 * SPEED_LAW_LIMITS.min_bend:.0f} %"
            )
        kind = "line"
    if kind == "line" and r_squared(line) < LOWER_LIMITS["r^2 of the law of taps"].fair and len(speeds) > 3:
        scatter_of = {each: left(model) for each, (model, _) in laid.items()}
        kind = next((each for each in laid if scatter_of[each] < scatter_of["line"] / 2), kind)
        if kind != "line":
            off, scatter = 100 * scatter_of["line"], 100 * scatter_of[kind]
            why = f"a line leaves a scatter of {off:.0f} %, this law {scatter:.2g} %"
    if kind != "table":
        chosen_table = table(speeds, amplitudes, variances)
        laid["table"] = (_along(chosen_table, speeds), math.inf)
    if only is not None:
        kind, why = only, because
    model = laid[kind][0]
    return Law(
        kind=kind,
        above=above,
        power=power,
        table=chosen_table,
        r_squared=r_squared(model),
        left=left(model),
        rank_correlation=rank_correlation(speeds, amplitudes),
        why=why,
    )


def check_law(warnings: Warnings, law: Law) -> None:
    """Downgrade the verdict if the law does not explain the amplitudes.

    If the amplitudes rise from tap to tap, only their scatter about the law counts. If the law is not a line, r^2 is
    not judged while the scatter is small: an amplitude that hardly depends on the speed has a small r^2.
    """
    if law.kind != "line":
        warnings.note(f"A(v) is {law.named}, not a line through the origin: {law.why}")
    if law.kind != "line" and law.left <= SPEED_LAW_LIMITS.max_scatter:
        return
    if law.rank_correlation <= SPEED_LAW_LIMITS.high_rank_correlation:
        warnings.check("r^2 of the law of taps", law.r_squared)
    elif law.r_squared < LOWER_LIMITS["r^2 of the law of taps"].fair:
        warnings.check("scatter about the law of taps", law.left, law=law.named)


def check_rises(law: Law, count: int) -> None:
    """Raise FitError if the amplitudes of `count` taps do not rise with the speed.

    They rise if the rank correlation is significantly positive, or if it is positive and the law explains them. A line,
    which always rises, must explain them better than a constant.
    """
    enough = 0.0 if law.kind == "line" else LOWER_LIMITS["r^2 of the law of taps"].fair
    if not _ranks_rise(law.rank_correlation, count) and not (law.rank_correlation > 0 and law.r_squared >= enough):
        raise FitError(
            f"the amplitude does not rise with the speed: the rank correlation of {count} taps is "
            f"{law.rank_correlation:.2f}: are these taps of one material, and is each speed that of its tap?"
        )


def _ranks_rise(correlation: float, count: int) -> bool:
    """Return whether a rank correlation of `count` pairs is high, or significantly above 0 (95 %)."""
    t = student_t(count - 2)
    return correlation > min(SPEED_LAW_LIMITS.high_rank_correlation, t / math.sqrt(count - 2 + t**2))


def _weights(speeds: Floats, amplitudes: Floats, variances: Floats) -> Floats:
    """Return the taps' weights (n,): inverse variances of noise and of scatter proportional to a smooth amplitude."""
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
    """Return `count` speeds from the slowest to the fastest, with nearly equal numbers of taps between them.

    Of neighbouring speeds that differ by less than 2 %, only the lower one is returned.
    """
    order = np.sort(speeds)
    found: list[float] = []
    for speed in order[np.linspace(0, len(order) - 1, count).round().astype(int)]:
        if not found or speed > SPEED_LAW_LIMITS.min_table_step * found[-1]:
            found.append(float(speed))
    return np.array(found)


def table(
    speeds: Floats, amplitudes: Floats, variances: Floats, max_speeds: int = SPEED_LAW_LIMITS.max_table_speeds
) -> Amplitudes:
    """Return the table that fits amplitudes versus speed best, with at most `max_speeds` and no amplitude below 0."""
    knots = knots_of(speeds, min(max_speeds, max(2, len(speeds) - 2)))
    nodes = np.concatenate(([0.0], knots))
    hats = np.column_stack([np.interp(speeds, nodes, row) for row in np.eye(len(nodes))[1:]])
    # Negative amplitudes are set to 0, and the others are fitted again.
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
    """Return a table of amplitudes as plain data for JSON; each amplitude has the key `what`."""
    return [{"speed_m_per_s": speed, what: amplitude.to_dict()} for speed, amplitude in amplitudes]


def _along(points: Amplitudes, speeds: Floats) -> Floats:
    nodes, heights = np.array([(0.0, 0.0), *((speed, amplitude.value) for speed, amplitude in points)]).T
    return np.asarray(np.interp(speeds, nodes, heights), dtype=np.float64)


# ---- The power law ---------------------------------------------------------------------------------------------------


def _power(speeds: Floats, amplitudes: Floats, variances: Floats) -> Power | None:
    """Return the power law, by Gauss-Newton steps from a line through the logarithms, or None if none fits."""
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
    # An amplitude that does not vanish at rest is impossible.
    if exponent <= 0:
        return None

    def at(speed: float) -> Estimate:
        here = float(height + exponent * math.log(speed / middle))
        found = _step(np.log(speeds / speed), amplitudes, variances, here, float(exponent))[0]
        # The interval of three taps may be beyond the largest float.
        return found.mapped(lambda log: math.exp(min(log, 700.0)))

    # Lines within a thousandth of the law, from half the speed of the slowest tap to twice that of the fastest.
    first, last = max(1e-4, float(speeds.min()) / 2), min(100.0, float(speeds.max()) * 2)
    bend = math.sqrt(8e-3 / max(1e-6, abs(exponent * (1 - exponent))))
    count = min(256, 2 + math.ceil(math.log(last / first) / bend))
    points = tuple((float(speed), at(float(speed))) for speed in np.geomspace(first, last, count))
    dense = np.geomspace(first, last, 64 * count)
    law = np.exp(height) * (dense / middle) ** exponent
    off = float(np.max(np.abs(_along(points, dense) / law - 1)))
    return Power(exponent_of, at(1.0), points, off)


def _step(logs: Floats, amplitudes: Floats, variances: Floats, height: float, exponent: float) -> tuple[Estimate, ...]:
    """Return the log amplitude where `logs`, the log speeds, are 0, and the exponent, after one Gauss-Newton step."""
    model = np.exp(height + exponent * logs)
    columns = np.column_stack((model, model * logs))
    wanted = amplitudes - model + columns @ np.array([height, exponent])
    return least_squares(columns, wanted, variances, model**2).coefficients


# ---- Deviations from a law -------------------------------------------------------------------------------------------


def single_outlier(taps: Sequence[Tap], speeds: Floats, amplitudes: Floats, noise: Floats, law: Law) -> str:
    """Return a sentence about the only tap that is not on a line through the origin, or an empty string.

    The tap must be off the line of the other taps by a quarter or more. The others must rise with the speed, without
    much scatter about their line, and with less than all taps have about `law`, if this is a power law.
    """
    count = len(speeds)
    if count < SPEED_LAW_LIMITS.min_taps + 3:
        return ""
    scale = np.sqrt(np.mean(noise) / noise)
    x, y = speeds * scale, amplitudes * scale
    line = through_origin(x, y)
    # Increase of the sum of squares by each tap, compared with the line of the others.
    added = line.residual**2 / (1 - x**2 / float(x @ x))
    index = int(np.argmax(added))
    others = np.delete(np.arange(count), index)
    # Any of the n taps may be the farthest by chance.
    chance = count * f_test_p(line.squares, line.freedom, line.squares - float(added[index]), line.freedom - 1)
    slope_per_s = float((x[others] @ y[others]) / (x[others] @ x[others]))
    off = float(amplitudes[index] / speeds[index]) / slope_per_s - 1
    scatter = float(np.sqrt(np.mean((amplitudes[others] / speeds[others] / slope_per_s - 1) ** 2)))
    if (
        scatter > (law.left if law.kind == "power" else UPPER_LIMITS["scatter about the law of taps"].poor)
        or not _ranks_rise(rank_correlation(speeds[others], amplitudes[others]), count - 1)
        or chance > SPEED_LAW_LIMITS.significance
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
    """Return whether amplitude versus speed has an offset or is a curve, not a line through the origin."""
    ones = np.ones_like(speeds)
    size = float(np.mean(amplitudes))
    scale = 1 / np.sqrt(noise / np.mean(noise))

    def laid(*columns: Floats) -> tuple[Regression, Floats]:
        found = least_squares(np.column_stack(columns) * scale[:, None], amplitudes * scale)
        return found, amplitudes - found.residual / scale

    origin, straight = laid(speeds)
    offset, shifted = laid(speeds, ones)
    curve, curved = laid(speeds, speeds**2, ones)
    for less, more, difference in ((offset, curve, curved - shifted), (origin, offset, shifted - straight)):
        part = float(np.sqrt(np.mean(difference**2))) / size
        if (
            part > SPEED_LAW_LIMITS.min_bend
            and f_test_p(less.squares, less.freedom, more.squares, more.freedom) < SPEED_LAW_LIMITS.significance
        ):
            return True
    return False


def speed_trend(speeds: Floats, logs: Floats, variances: Floats, name: str, min_change: float) -> str:
    """Return a sentence if a quantity changes from the slowest tap to the fastest, else an empty string.

    The change must be significant, and at least the fraction `min_change`. `logs` (n,) are the logarithms of the
    quantity, and `name` is its name in the sentence.
    """
    if len(speeds) < SPEED_LAW_LIMITS.min_taps + 2:
        return ""
    slope = with_offset(speeds, logs, variances).coefficients[0]
    freedom = len(speeds) - 2
    # As many standard errors as t has at SPEED_LAW_LIMITS.significance.
    wide = (slope.high - slope.value) * student_t(freedom, 1 - SPEED_LAW_LIMITS.significance) / student_t(freedom)
    change = math.expm1(slope.value * float(np.ptp(speeds)))
    if not slope.value or abs(slope.value) < wide or abs(change) < min_change:
        return ""
    return (
        f"the {name} {'rises' if change > 0 else 'falls'} by {100 * abs(change):.0f} % from the slowest to the fastest"
    )
