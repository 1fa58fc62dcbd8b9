"""Stability of the loop of tick, device and hand: limits of stiffness and eigenvalues.

A wall of stiffness K and damping D is sampled: its force is computed from an earlier position and held for a period.
Instability has three causes, each with a condition. They are derived in docs/stability.md, which explains how they
extend Colgate and Schenkel (1997), Abbott and Okamura (2005) and Diolaiti et al. (2006):

    passivity      b > K reach + D echo                  any passive hand; b is the handle's own damping
    quantisation   noise(K, D, encoder, actuator) <= c   per axis; c is the handle's own dry friction
    eigenvalues    spectral radius < 1                   of the exact sampled loop with the configured hand

`reach` is T/2 + t_d with a constant period T and age t_d of positions; `echo` is 1 with exact positions. Together
the first two conditions prove that a contact comes to rest in every passive hand, and imply the third.
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
"""safe: a contact is proved to come to rest in any passive hand. unsafe: motion of the linear loop grows with the
configured hand or with the handle released, or dry friction does not absorb noise of positions. unproved: neither."""

SPEED_ESTIMATE_ERROR_GAIN: Final = 7.0 / 3.0
"""Largest gain of the velocity estimator from slope errors of its fitted lines to the estimated speed. The
estimator adds up to 2/3 of the change of slope since the previous line: 1 + 2 * 2/3 (csrc/tick/hd_velocity.c)."""
WINDOW_MEAN_ENERGY_GAIN: Final = 2.0
"""Largest ratio of the energy of means over windows of changing length to that of the averaged signal (Hardy)."""
ASSUMED_PRESS_N: Final = 1.0
"""Assumed pressing force, with which the stiffness of groove flanks and of ramps between materials grows."""
WORST_NORMAL_FACTOR: Final = (1.0 + math.sqrt(2.0)) / 2.0
"""Maximum of |n_x| (|n_x| + |n_y|) over all unit vectors n."""

_MAX_PATTERN_TICKS: Final = 128
"""Longest period of the pattern of measurements and forces, in ticks, for which `reach_s` is computed exactly."""
_SAMPLED_TICKS: Final = 1000
"""Ticks of a pattern longer than _MAX_PATTERN_TICKS from which an upper bound of `reach_s` is computed."""
_MAX_DELAY_PERIODS: Final = 40
"""Longest delay in loop_matrix, in periods. A longer delay is modelled with longer periods."""
_MIN_SEARCHED_N_PER_M: Final = 0.1
"""Stiffness at which held_factor begins the search for the largest stable stiffness."""
_MAX_SEARCHED_N_PER_M: Final = 1e7
"""Largest stiffness that held_factor tries in its search."""
MAX_STABLE_RADIUS: Final = 1.0 + 1e-6
"""Spectral radius above which motion counts as growing. A free handle has the eigenvalue 1, which may be rounded up."""


@dataclass(frozen=True, slots=True)
class Timing:
    """When positions are measured, and when the forces computed from them act."""

    period_s: float
    """Mean time for which a force is held."""
    delay_s: float
    """Mean age of a position at the time when its force begins to act."""
    reach_s: float
    """Damping of the handle (N s/m) that passivity needs per 1 N/m of stiffness: half a period plus the delay, if both
    are constant."""
    echo: float
    """Damping of the handle (N s/m) that passivity needs per 1 N s/m of virtual damping: 1 if no force is held
    for longer than the interval of positions."""
    reading_s: float
    """Shortest time between two measured positions that the servo reads."""
    gain: float = 1.0
    """Factor by which an actuator that overshoots may amplify the noise of forces."""

    def with_actuator(self, gain: float, late_s: float, mean_s: float) -> Timing:
        """Return the timing with the lag of an actuator, given as Actuator.moments returns it."""
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
    """Return the timing of a servo at `rate_hz`, for a device like the simulated joystick.

    Positions are measured every `report_interval_s` (0: at every tick) and can be read `report_delay_s` later. If
    `frame_s` is positive, a force acts at the `frames`-th multiple of `frame_s` after its tick; of several forces for
    the same multiple, the newest acts.

    If the pattern of measurements and forces repeats within 128 ticks, `reach_s` is exact: the norm of the operator
    that maps a velocity to the displacement since the measurement. This norm is the largest eigenvalue of a matrix over
    one pattern. Otherwise `reach_s` is the bound of Schur's test, which is larger.
    """
    tick = Fraction(1)
    report = _ratio(report_interval_s * rate_hz) if report_interval_s > 0.0 else tick
    age = _ratio(report_delay_s * rate_hz)
    frame = _ratio(frame_s * rate_hz)
    pattern = math.lcm(report.numerator, frame.numerator or 1)
    known = pattern <= _MAX_PATTERN_TICKS
    ticks = 2 * pattern + 4 if known else _SAMPLED_TICKS
    settled = math.ceil(age) + math.ceil(frames * frame) + 2 * math.ceil(max(report, frame, tick))
    acts: dict[Fraction, Fraction] = {}
    """Measurement time by the time at which its force acts, in ticks."""
    read: dict[Fraction, Fraction] = {}
    """Time since the previous measurement, by measurement, in ticks."""
    newest = None
    for k in range(settled, 3 * settled + ticks):
        measured = math.floor((k - age) / report) * report
        if newest is not None and measured != newest:
            read[measured] = measured - newest
        newest = measured
        acts[(math.floor(k / frame) + frames) * frame if frame else Fraction(k)] = measured
    times = sorted(acts)
    held = [times[0]] + [now for before, now in pairwise(times) if acts[now] != acts[before]]
    # The first measurements have no predecessor yet.
    held = [time for time in held if acts[time] in read]
    if known:
        held = held[: next(i for i, time in enumerate(held) if time >= held[0] + pattern) + 1]
        reach = _symmetrised_norm(held, acts, Fraction(pattern))
    else:
        reach = _schur_bound(held, acts)
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
    """Return a ratio of small integers within 1e-9 of a value, or else a ratio close to the value."""
    near = Fraction(value).limit_denominator(_MAX_PATTERN_TICKS)
    return near if abs(near - Fraction(value)) <= Fraction(1, 10**9) else Fraction(value).limit_denominator(10**6)


def _symmetrised_norm(held: list[Fraction], acts: dict[Fraction, Fraction], pattern: Fraction) -> float:
    """Return the norm of the symmetrised operator v -> integral of v from s(t) to t, in ticks.

    s(t) is the time of the measurement whose force acts at t. The kernel is periodic, and constant between the times at
    which a position is measured or begins to act. The kernel is nowhere negative, so the largest eigenvalue belongs to
    a motion with the same period.
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
        # All parts from `since` to `mark`, and half of the part that begins at `mark`.
        parts = count * -turns + row - first_part
        cover[row] += parts // count
        for extra in range(parts % count):
            cover[row, (first_part + extra) % count] += 1.0
        cover[row, row] += 0.5
    root = np.sqrt([float(end - mark) for mark, end in zip(marks, ends, strict=True)])
    weighted = cover * np.outer(root, root)
    return float(np.linalg.eigvalsh(0.5 * (weighted + weighted.T))[-1])


def _schur_bound(held: list[Fraction], acts: dict[Fraction, Fraction]) -> float:
    """Return an upper bound of `reach_s`, in ticks, by Schur's test.

    The bound is half the longest time from a measurement M to the action of the first measurement after the end of M's
    force.
    """
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
    """The closed loop around a surface: timing, handle and hand, encoder and actuator."""

    timing: Timing
    dynamics: Dynamics
    encoder_step_m: float
    force_step_n: float
    max_force_n: float
    workspace_m: float
    """Half the travel, for each axis."""

    @property
    def lag(self) -> float:
        """Fraction, 0 to 1, of `timing.reach_s` that is due to delay rather than to the hold of a force."""
        return max(0.0, 1.0 - 0.5 * self.timing.period_s / self.timing.reach_s)

    @property
    def late_periods(self) -> float:
        """Periods by which `timing.reach_s` exceeds the half period that is due to the hold of a force."""
        return self.timing.reach_s / self.timing.period_s - 0.5

    def without_hand(self) -> Loop:
        """Return the loop of a released handle."""
        handle = replace(self.dynamics, grip_mass_kg=0.0, grip_damping_n_s_per_m=0.0, grip_stiffness_n_per_m=0.0)
        return replace(self, dynamics=handle)

    @property
    def damping_echo(self) -> float:
        """Damping that the handle needs per 1 N s/m of virtual damping, with the error of the velocity estimator."""
        return self.timing.echo * (
            SPEED_ESTIMATE_ERROR_GAIN * WINDOW_MEAN_ENERGY_GAIN if self.encoder_step_m > 0.0 else 1.0
        )

    @property
    def speed_step_m_per_s(self) -> float:
        """Largest error of the estimated speed due to the encoder's step."""
        return SPEED_ESTIMATE_ERROR_GAIN * self.encoder_step_m / self.timing.reading_s

    def to_dict(self) -> dict[str, object]:
        """Return the properties of the loop that `hapticd check` reports as assumptions."""
        return {
            **asdict(self.dynamics),
            "encoder_step_m": self.encoder_step_m,
            "force_step_n": self.force_step_n,
            "hold_s": self.timing.period_s,
            "delay_s": self.timing.delay_s,
            "press_n": ASSUMED_PRESS_N,
        }


@dataclass(frozen=True, slots=True)
class Margin:
    """Stiffness of a contact set, its limits, and the spectral radius of the loop."""

    objects: tuple[str, ...]
    stiffness_n_per_m: float
    """Largest eigenvalue of the summed stiffness of the objects, with friction springs and spring fields."""
    damping_n_s_per_m: float
    limit_n_per_m: float
    """`margin` times the stiffness."""
    held_limit_n_per_m: float
    """Largest stiffness at which no motion grows with the configured hand; infinite above 1e7 N/m."""
    margin: float
    """Largest factor on all stiffnesses, with unchanged damping, up to which the set is safe in any passive hand.
    Infinite without a limit, 0 if no factor is safe."""
    limited_by: Limit
    verdict: Verdict
    spectral_radius: float
    """Spectral radius with the configured hand."""
    free_radius: float
    """Spectral radius with the handle released."""
    remedy: str = ""
    """Keys to lower, with safe values; empty if a stiffness below `limit_n_per_m` suffices, or if nothing helps."""

    @property
    def safe(self) -> bool:
        """Whether the set is proved to come to rest in any passive hand."""
        return self.verdict == "safe"

    def to_dict(self) -> dict[str, object]:
        """Return the map that `hapticd check --json` prints."""
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
        limit = self.limit_n_per_m
        advice = f"below {limit:.4g} N/m it would be safe in any hand" if limit > 0.0 else ""
        if self.remedy:
            advice = f"safe in any hand with {self.remedy}"
        if not self.safe and not advice:
            advice = "no stiffness would be safe" + (" with that damping" if self.damping_n_s_per_m > 0.0 else "")
        if self.safe:
            return f"{text} is safe in any hand; {advice}" if advice else f"{text} is safe in any hand"
        if self.limited_by == "eigenvalues":
            return f"{text} oscillates with the configured hand; {advice}"
        if self.free_radius > MAX_STABLE_RADIUS:
            return f"{text} is stable with the configured hand, but not with the handle released; {advice}"
        if self.verdict == "unproved":
            return f"{text} is stable with the configured hand and without one, but not proved for every hand; {advice}"
        return f"{text} may buzz, as dry friction does not absorb the steps of encoder and actuator; {advice}"


def limits(
    stiffness_n_per_m: Floats, damping_n_s_per_m: Floats, noise_n: Floats, fixed_noise_n: Floats, loop: Loop
) -> tuple[Floats, Floats]:
    """Return the stiffness factors up to which contact sets are passive, and up to which friction absorbs their noise.

    All arrays are (n,): stiffness and damping that count for passivity; `noise_n` grows with the stiffness and
    `fixed_noise_n` does not, both for the worse axis. A factor is infinite without a limit, and 0 if no stiffness is
    safe.
    """
    b, c = loop.dynamics.handle_damping_n_s_per_m, loop.dynamics.friction_n / loop.timing.gain
    left = b - loop.damping_echo * damping_n_s_per_m
    need = loop.timing.reach_s * stiffness_n_per_m
    quiet = c - fixed_noise_n
    with np.errstate(divide="ignore", invalid="ignore"):
        # A set without stiffness and damping is passive even on a handle without damping.
        passive = np.where(need > 0.0, np.maximum(left, 0.0) / need, np.where(left >= 0.0, np.inf, 0.0))
        silent = np.where(
            quiet < 0.0, 0.0, np.where(noise_n > 0.0, np.maximum(quiet, 0.0) / np.maximum(noise_n, 1e-300), np.inf)
        )
    return passive, silent


# ---- Eigenvalues ---------------------------------------------------------------------------------------------------


def loop_matrix(stiffness: Floats, damping: Floats, loop: Loop) -> Floats:
    """Return the matrix of one period of the bilateral, unquantised loop: shapes (..., 2, 2) to (..., n, n).

    The state holds, for both axes, position and velocity when a force begins to act, then the positions that were
    measured and not yet used. The force is F = -K y - D (y - y before) / period, with y measured delay_s before F acts.
    """
    timing = loop.timing
    period = timing.period_s
    delays = timing.delay_s / period
    if delays > _MAX_DELAY_PERIODS:  # a longer hold and a shorter delay of the same mean age
        period = (timing.delay_s + 0.5 * timing.period_s) / (_MAX_DELAY_PERIODS + 0.5)
        delays = float(_MAX_DELAY_PERIODS)
    full_periods = math.floor(delays + 1e-9)
    part = delays - full_periods
    full, push = held_motion(loop.dynamics, period)
    # w[j] was measured `part` of a period before the force of j periods ago began; w[0] is x if `part` is 0.
    shift = 0
    early, early_push = full[0], push[0]
    if part > 1e-9:
        shift = 1
        mid, mid_push = held_motion(loop.dynamics, (1.0 - part) * period)
        early, early_push = mid[0], mid_push[0]
    oldest = full_periods + 1 if damping.any() else full_periods
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
                matrix[..., row, other * size + places[full_periods]] += gain * now[..., axis, other]
                if oldest > full_periods:
                    matrix[..., row, other * size + places[oldest]] += gain * before[..., axis, other]
    return matrix


def spectral_radius(stiffness: Floats, damping: Floats, loop: Loop) -> Floats:
    """Return the spectral radius of loop_matrix, shapes (..., 2, 2) to (...). Above 1, motion of the loop grows."""
    radius: Floats = np.abs(np.linalg.eigvals(loop_matrix(stiffness, damping, loop))).max(axis=-1)
    return radius


def held_factor(stiffness: Floats, damping: Floats, loop: Loop, known: Floats) -> Floats:
    """Return the largest factors (n,) on `stiffness` (n, 2, 2) up to which motion of the linear loop does not grow.

    `known` (n,) are factors that are known to be stable, 0 if unknown. The search doubles the factor, then bisects to
    0.1 %. A factor is 0 if no tried factor is stable, and infinite if the loop is stable up to 1e7 N/m.
    """
    size = np.maximum(np.linalg.norm(stiffness, 2, axis=(-2, -1)), 1e-9)
    low, high = np.minimum(known, _MAX_SEARCHED_N_PER_M / size), np.full(len(size), np.inf)
    factor = np.maximum(low, _MIN_SEARCHED_N_PER_M / size)
    rising = np.ones(len(size), dtype=bool)
    while rising.any():
        stable = spectral_radius(factor[:, None, None] * stiffness, damping, loop) <= MAX_STABLE_RADIUS
        low = np.where(rising & stable, factor, low)
        high = np.where(rising & ~stable, factor, high)
        rising &= stable & (factor * size < _MAX_SEARCHED_N_PER_M)
        factor = np.where(rising, 2.0 * factor, factor)
    bracketed = np.isfinite(high) & (low > 0.0)
    if bracketed.any():
        a, b, top = stiffness[bracketed], damping[bracketed], high[bracketed]
        bottom = low[bracketed]
        for _ in range(10):
            middle = 0.5 * (bottom + top)
            stable = spectral_radius(middle[:, None, None] * a, b, loop) <= MAX_STABLE_RADIUS
            bottom, top = np.where(stable, middle, bottom), np.where(stable, top, middle)
        low[bracketed] = bottom
    return np.asarray(np.where(np.isinf(high), np.inf, low))
