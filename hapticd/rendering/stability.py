"""Whether the loop of tick, device and hand is stable: margins of stiffness, and what they are made of.

A wall of stiffness K and damping D is sampled: its force is made of a position that was measured earlier, and is held
for a while. Three things can go wrong, and each has its condition (derived in docs/stability.md, which says
how they go beyond Colgate and Schenkel (1997), Abbott and Okamura (2005) and Diolaiti et al. (2006)):

    passivity      b > K reach + D echo                  any passive hand; b is the handle's own damping
    quantisation   noise(K, D, encoder, actuator) <= c   per axis; c is the handle's own dry friction
    eigenvalues    spectral radius < 1                   of the exact sampled loop with the hand that is on the handle

`reach` is half a period and the age of positions, for a plain loop T/2 + t_d. The first two together prove that a
contact comes to rest in every passive hand, and imply the third. All quantities are SI.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.config.dynamics import Dynamics, held_motion

Floats: TypeAlias = npt.NDArray[np.float64]
Limit: TypeAlias = Literal["passivity", "quantisation", "eigenvalues"]
Verdict: TypeAlias = Literal["safe", "unproved", "unsafe"]
"""unsafe: the linear loop grows in the hand that is assumed or with the handle let go, or dry friction does not hold
the noise of positions. unproved: neither, but nothing proves it safe either."""

BEND: Final = 7.0 / 3.0
"""The estimator may carry a line's speed on by 2/3 of the change since the line before (csrc/tick/hd_velocity.c): an
error of its lines comes out at most 1 + 2 * 2/3 times as large."""
MAXIMAL: Final = 2.0
"""Means over windows of changing length have at most this times the energy of what they are means of (Hardy)."""
PRESS_N: Final = 1.0
"""Groove flanks and ramps between materials are judged under this force: they stiffen with it."""
CORNER: Final = (1.0 + math.sqrt(2.0)) / 2.0
"""The largest of |n_x| (|n_x| + |n_y|) over all unit vectors n."""

_LONGEST_PATTERN: Final = 128
_TICKS: Final = 1000
_MOST_DELAYS: Final = 40
_LEAST_N_PER_M: Final = 0.1
_TOP_N_PER_M: Final = 1e7
GROWS: Final = 1.0 + 1e-6
"""A spectral radius beyond this: less may be rounding, as a handle without a hand has an eigenvalue of 1."""


@dataclass(frozen=True, slots=True)
class Timing:
    """When positions are measured, and when the forces that are made of them act."""

    period_s: float
    """A force is held so long, in the mean."""
    delay_s: float
    """Age of the position when its force begins to act, in the mean."""
    reach_s: float
    """What a newton per metre adds, at most, to the energy given to the hand, per speed squared and time: half a period
    and the delay, where both are constant."""
    echo: float
    """The same for a damping of 1 N s/m: 1 where every position is used for as long as it is new."""
    reading_s: float
    """The shortest time between two positions that are read."""
    gain: float = 1.0
    """How much larger an actuator that overshoots may make the noise of forces."""

    def behind(self, gain: float, late_s: float, mean_s: float) -> Timing:
        """The same with an actuator that spreads a force over later times (Actuator.shares)."""
        return replace(
            self,
            delay_s=self.delay_s + mean_s,
            reach_s=gain * self.reach_s + late_s,
            echo=gain * self.echo,
            gain=gain,
        )


@lru_cache(maxsize=64)
def timing(
    rate_hz: float,
    report_interval_s: float = 0.0,
    report_delay_s: float = 0.0,
    frame_s: float = 0.0,
    frames: int = 1,
) -> Timing:
    """The timing of a servo at `rate_hz`, as the simulated joystick has it.

    Positions are measured every `report_interval_s` (0: at every tick) and can be read `report_delay_s` later. With
    `frame_s` forces act at multiples of it: at the `frames`-th after the tick that made them, the newest wins.

    Where the intervals repeat within 128 ticks, `reach_s` is exact: the norm of the operator that maps a motion to what
    it does between a measurement and the end of its force, which is the largest eigenvalue of a matrix over one
    repetition. Elsewhere it is the larger bound of Schur's test.
    """
    tick = Fraction(1)
    report = _ratio(report_interval_s * rate_hz) if report_interval_s > 0.0 else tick
    age = _ratio(report_delay_s * rate_hz)
    frame = _ratio(frame_s * rate_hz)
    pattern = math.lcm(report.numerator, frame.numerator or 1)
    known = pattern <= _LONGEST_PATTERN
    ticks = 2 * pattern + 4 if known else _TICKS
    settled = math.ceil(age) + math.ceil(frames * frame) + 2 * math.ceil(max(report, frame, tick))
    acts: dict[Fraction, Fraction] = {}
    read: dict[Fraction, Fraction] = {}
    """Measurements by the time at which they act, and windows of speed by measurement."""
    newest = None
    for k in range(settled, 3 * settled + ticks):
        measured = math.floor((k - age) / report) * report
        if newest is not None and measured != newest:
            read[measured] = measured - newest
        newest = measured
        acts[(math.floor(k / frame) + frames) * frame if frame else Fraction(k)] = measured
    times = sorted(acts)
    held = [times[0]] + [now for before, now in pairwise(times) if acts[now] != acts[before]]
    # Measurements at the very beginning have no window yet.
    held = [time for time in held if acts[time] in read]
    if known:
        held = held[: next(i for i, time in enumerate(held) if time >= held[0] + pattern) + 1]
        reach = _norm(held, acts, Fraction(pattern))
    else:
        reach = _schur(held, acts)
    spans = [after - begin for begin, after in pairwise(held)]
    ages = [time - acts[time] for time in held[:-1]]
    echo = max(float(span / read[acts[time]]) for time, span in zip(held, spans, strict=False))
    period_s = 1.0 / rate_hz
    return Timing(
        period_s=float(sum(spans) / len(spans)) * period_s,
        delay_s=float(sum(ages) / len(ages)) * period_s,
        reach_s=reach * period_s,
        echo=math.sqrt(max(1.0, echo)),
        reading_s=float(min(read.values())) * period_s,
    )


def _ratio(value: float) -> Fraction:
    """A ratio that was meant, out of a rounded quotient; as it is where none is near."""
    near = Fraction(value).limit_denominator(_LONGEST_PATTERN)
    return near if abs(near - Fraction(value)) <= Fraction(1, 10**9) else Fraction(value).limit_denominator(10**6)


def _norm(held: list[Fraction], acts: dict[Fraction, Fraction], pattern: Fraction) -> float:
    """The norm of v -> integral of v from s(t) to t, symmetrised, s(t) the measurement that acts at t; in ticks.

    The kernel is constant between the times at which something is measured or begins to act, and repeats: its largest
    eigenvalue belongs to a motion that repeats with it, as no entry is negative.
    """
    first = held[0]
    marks = sorted({(time - first) % pattern for time in (*held, *(acts[time] for time in held))})
    ends = [*marks[1:], pattern]
    count = len(marks)
    index = {mark: place for place, mark in enumerate(marks)}
    cover = np.zeros((count, count))
    begins = [time - first for time in held[:-1]]
    for row, mark in enumerate(marks):
        segment = max(place for place, begin in enumerate(begins) if begin <= mark)
        since = acts[held[segment]] - first
        turns = math.floor(since / pattern)
        first_part = index[since - turns * pattern]
        # Whole parts from `since` to `mark`, and half of the part itself.
        parts = count * -turns + row - first_part
        cover[row] += parts // count
        for extra in range(parts % count):
            cover[row, (first_part + extra) % count] += 1.0
        cover[row, row] += 0.5
    root = np.sqrt([float(end - mark) for mark, end in zip(marks, ends, strict=True)])
    weighted = cover * np.outer(root, root)
    return float(np.linalg.eigvalsh(0.5 * (weighted + weighted.T))[-1])


def _schur(held: list[Fraction], acts: dict[Fraction, Fraction]) -> float:
    """Half the longest time from a measurement to the moment when the first one after the end of its force acts."""
    measured = [acts[time] for time in held]
    worst = Fraction(0)
    for place, after in enumerate(held[1:]):
        later = next((other for other in range(place, len(held)) if measured[other] >= after), None)
        if later is None:
            break
        worst = max(worst, held[later] - measured[place])
    return float(worst) / 2.0


@dataclass(frozen=True, slots=True)
class Loop:
    """What closes the loop around a surface."""

    timing: Timing
    dynamics: Dynamics
    encoder_step_m: float
    force_step_n: float
    max_force_n: float
    workspace_m: float
    """Half the travel, per axis."""

    @property
    def lag(self) -> float:
        """How much of reach_s is delay rather than hold, 0 to 1."""
        return max(0.0, 1.0 - 0.5 * self.timing.period_s / self.timing.reach_s)

    @property
    def late_periods(self) -> float:
        """How many periods reach_s has beyond the half period of a hold."""
        return self.timing.reach_s / self.timing.period_s - 0.5

    def without_hand(self) -> Loop:
        """The same without a hand."""
        handle = replace(self.dynamics, grip_mass_kg=0.0, grip_damping_n_s_per_m=0.0, grip_stiffness_n_per_m=0.0)
        return replace(self, dynamics=handle)

    @property
    def damping_echo(self) -> float:
        """How much damping of the handle one of the virtual damping takes: the estimator's share included."""
        return self.timing.echo * (BEND * MAXIMAL if self.encoder_step_m > 0.0 else 1.0)

    @property
    def speed_step_m_per_s(self) -> float:
        """How far off a speed may be by the encoder's step."""
        return BEND * self.encoder_step_m / self.timing.reading_s

    def to_dict(self) -> dict[str, object]:
        """What is assumed, for `hapticd check`."""
        return {
            **asdict(self.dynamics),
            "encoder_step_m": self.encoder_step_m,
            "force_step_n": self.force_step_n,
            "hold_s": self.timing.period_s,
            "delay_s": self.timing.delay_s,
            "press_n": PRESS_N,
        }


@dataclass(frozen=True, slots=True)
class Margin:
    """How stiff a set of objects that act together is, and how stiff it might be."""

    objects: tuple[str, ...]
    stiffness_n_per_m: float
    """Largest eigenvalue of the sum of their stiffnesses, friction springs and spring fields among them."""
    damping_n_s_per_m: float
    limit_n_per_m: float
    """`margin` times the stiffness."""
    held_limit_n_per_m: float
    """The largest stiffness that does not grow in the hand that is assumed; infinite: all up to 1e7 N/m."""
    margin: float
    """The set is safe in any hand with all its stiffnesses so many times as large, and damping as it is; infinite where
    there is no stiffness and nothing wrong, 0 where no factor would do."""
    limited_by: Limit
    verdict: Verdict
    spectral_radius: float
    """In the hand that is assumed."""
    free_radius: float
    """With the handle let go."""
    remedy: str = ""
    """Which keys to lower, and to what, so that it is safe; empty: `limit_n_per_m` says it, or nothing would do."""

    @property
    def safe(self) -> bool:
        """Whether it is proved that it comes to rest in any passive hand."""
        return self.verdict == "safe"

    def to_dict(self) -> dict[str, object]:
        """As `hapticd check --json` has it."""
        return asdict(self) | {
            "objects": list(self.objects),
            "held_limit_n_per_m": None if math.isinf(self.held_limit_n_per_m) else self.held_limit_n_per_m,
            "margin": None if math.isinf(self.margin) else self.margin,
            "safe": self.safe,
        }

    def __str__(self) -> str:
        text = f"{self.stiffness_n_per_m:.4g} N/m"
        if self.damping_n_s_per_m > 0.0:
            text += f" and {self.damping_n_s_per_m:.3g} N s/m"
        most = f"up to {self.limit_n_per_m:.4g} N/m would be safe" if self.limit_n_per_m > 0.0 else ""
        if self.remedy:
            most = f"safe with {self.remedy}"
        if not self.safe and not most:
            most = "no stiffness would be safe" + (" with that damping" if self.damping_n_s_per_m > 0.0 else "")
        if self.safe:
            return f"{text} is safe in any hand; {most}" if most else f"{text} is safe in any hand"
        if self.limited_by == "eigenvalues":
            return f"{text} oscillates in the hand that is assumed; {most}"
        if self.free_radius > GROWS:
            return f"{text} is stable in the hand that is assumed, but not with the handle let go; {most}"
        if self.verdict == "unproved":
            return f"{text} is stable in the hand that is assumed and without one, but not surely in every hand; {most}"
        return f"{text} may buzz by the steps of encoder and actuator, which dry friction does not hold; {most}"


def limits(
    stiffness_n_per_m: Floats, damping_n_s_per_m: Floats, noise_n: Floats, still_noise_n: Floats, loop: Loop
) -> tuple[Floats, Floats]:
    """The factor on all stiffnesses up to which a set is passive, and the one up to which friction holds its noise.

    Shapes (n,): stiffness and damping as they act on passivity, the noise that grows with stiffness, and that which
    does not, both for the worse axis. A factor is infinite where nothing depends on it, 0 where no stiffness would do.
    """
    b, c = loop.dynamics.handle_damping_n_s_per_m, loop.dynamics.friction_n / loop.timing.gain
    left = b - loop.damping_echo * damping_n_s_per_m
    need = loop.timing.reach_s * stiffness_n_per_m
    quiet = c - still_noise_n
    with np.errstate(divide="ignore", invalid="ignore"):
        # Something that takes nothing is passive on a handle without damping too.
        passive = np.where(need > 0.0, np.maximum(left, 0.0) / need, np.where(left >= 0.0, np.inf, 0.0))
        silent = np.where(
            quiet < 0.0, 0.0, np.where(noise_n > 0.0, np.maximum(quiet, 0.0) / np.maximum(noise_n, 1e-300), np.inf)
        )
    return passive, silent


# ---- Eigenvalues ---------------------------------------------------------------------------------------------------


def loop_matrix(stiffness: Floats, damping: Floats, loop: Loop) -> Floats:
    """One period of the bilateral, unquantised loop: shapes (..., 2, 2) to (..., n, n).

    The state of both axes: position and velocity when a force begins to act, then the positions that were measured
    and not yet used. F = -K y - D (y - y before) / period, y measured delay_s before F acts.
    """
    timing = loop.timing
    period = timing.period_s
    delays = timing.delay_s / period
    if delays > _MOST_DELAYS:  # held longer and delayed by as much less: the mean age stays
        period = (timing.delay_s + 0.5 * timing.period_s) / (_MOST_DELAYS + 0.5)
        delays = float(_MOST_DELAYS)
    whole = math.floor(delays + 1e-9)
    part = delays - whole
    full, push = held_motion(loop.dynamics, period)
    # w[j] was measured `part` of a period before the force of j periods ago began: w[0] is x where that is nothing.
    shift = 0
    early, early_push = full[0], push[0]
    if part > 1e-9:
        shift = 1
        mid, mid_push = held_motion(loop.dynamics, (1.0 - part) * period)
        early, early_push = mid[0], mid_push[0]
    oldest = whole + 1 if damping.any() else whole
    places = [0 if j + shift == 0 else 1 + j + shift for j in range(oldest + 1)]
    size = 2 + oldest + shift
    matrix = np.zeros((*stiffness.shape[:-2], 2 * size, 2 * size))
    now, before = -(stiffness + damping / period), damping / period
    for axis in range(2):
        base = axis * size
        matrix[..., base : base + 2, base : base + 2] = full
        rows = [(base, push[0]), (base + 1, push[1])]
        if shift:
            matrix[..., base + 2, base : base + 2] = early
            rows.append((base + 2, early_push))
        for younger, older in pairwise(places):
            matrix[..., base + older, base + younger] = 1.0
        for other in range(2):
            for row, gain in rows:
                matrix[..., row, other * size + places[whole]] += gain * now[..., axis, other]
                if oldest > whole:
                    matrix[..., row, other * size + places[oldest]] += gain * before[..., axis, other]
    return matrix


def spectral_radius(stiffness: Floats, damping: Floats, loop: Loop) -> Floats:
    """Of loop_matrix: shapes (..., 2, 2) to (...). More than 1: the linear loop grows in the hand that is assumed."""
    radius: Floats = np.abs(np.linalg.eigvals(loop_matrix(stiffness, damping, loop))).max(axis=-1)
    return radius


def held_factor(stiffness: Floats, damping: Floats, loop: Loop, least: Floats) -> Floats:
    """The largest factor on `stiffness` (n, 2, 2) up to which the linear loop does not grow: (n,).

    `least` (n,) are factors that are known not to grow, 0 where none is. Sought upwards in doubles, then by bisection
    to 0.1 %. 0: none was found; infinite: the loop grows at none up to 1e7 N/m.
    """
    size = np.maximum(np.linalg.norm(stiffness, 2, axis=(-2, -1)), 1e-9)
    low, high = np.minimum(least, _TOP_N_PER_M / size), np.full(len(size), np.inf)
    factor = np.maximum(low, _LEAST_N_PER_M / size)
    rising = np.ones(len(size), dtype=bool)
    while rising.any():
        stable = spectral_radius(factor[:, None, None] * stiffness, damping, loop) <= GROWS
        low = np.where(rising & stable, factor, low)
        high = np.where(rising & ~stable, factor, high)
        rising &= stable & (factor * size < _TOP_N_PER_M)
        factor = np.where(rising, 2.0 * factor, factor)
    bracketed = np.isfinite(high) & (low > 0.0)
    if bracketed.any():
        a, b, top = stiffness[bracketed], damping[bracketed], high[bracketed]
        bottom = low[bracketed]
        for _ in range(10):
            middle = 0.5 * (bottom + top)
            stable = spectral_radius(middle[:, None, None] * a, b, loop) <= GROWS
            bottom, top = np.where(stable, middle, bottom), np.where(stable, top, middle)
        low[bracketed] = bottom
    return np.asarray(np.where(np.isinf(high), np.inf, low))
