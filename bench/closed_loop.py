"""The closed loop against its continuous closed form: error over rate.

The loop is `hapticd.simulate`. Its only errors are those of the zero-order hold: the joystick has no encoder step, dry
friction, force rounding or vibration. A hand pulls a mass onto a wall; along the normal

    M y'' = k (w - y) + b_h (w' - y') - b y' + F,        F = -K y - D y' inside the wall, 0 outside,

where the hand's reference w is linear in time. Between two events the motion has the closed form

    y(t) = alpha + beta t + c1 exp(p1 t) + c2 exp(p2 t),      M p^2 + (b + b_h + D) p + (k + K) = 0.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from bench.report import Advance, Floats, Options, Section, Table
from bench.tick import FLOOR
from hapticd.rendering.offline import simulate_run

RATES_HZ = (1000.0, 2000.0, 5000.0, 10_000.0)
PHASES = 16
"""Number of positions of the onset within a tick; the worst result is reported."""
SUBTICKS = 16
"""Number of times in each tick at which the held force is compared."""


@dataclass(frozen=True, slots=True)
class Loop:
    """A hand, a handle and a wall at y = 0. SI units."""

    stiffness: float
    damping: float = 0.0
    mass: float = 0.05
    handle_damping: float = 0.2
    hand_stiffness: float = 300.0
    hand_damping: float = 5.0
    start: float = 0.004
    speed: float = 0.1
    moving_s: float = 0.12
    resting_s: float = 0.05

    @property
    def duration_s(self) -> float:
        """Duration of a run: the reference moves, then rests."""
        return self.moving_s + self.resting_s

    def waypoints(self) -> list[list[float]]:
        """Return the waypoints of the hand's reference, rows [t_s, x_m, y_m]."""
        end = self.start - self.speed * self.moving_s
        return [[0.0, 0.0, self.start], [self.moving_s, 0.0, end], [self.duration_s, 0.0, end]]


class Segment:
    """The motion between two events in closed form: it begins at y and v; the reference is `reference + rate t`."""

    def __init__(self, loop: Loop, inside: bool, reference: float, rate: float, y: float, v: float) -> None:
        mass = loop.mass
        damping = loop.handle_damping + loop.hand_damping + (loop.damping if inside else 0.0)
        stiffness = loop.hand_stiffness + (loop.stiffness if inside else 0.0)
        self.beta = loop.hand_stiffness * rate / stiffness
        self.alpha = (loop.hand_stiffness * reference + loop.hand_damping * rate - damping * self.beta) / stiffness
        root = np.sqrt(complex(damping * damping - 4 * mass * stiffness))
        self.p = np.array([(-damping + root) / (2 * mass), (-damping - root) / (2 * mass)])
        self.c = np.linalg.solve(np.array([[1, 1], self.p]), np.array([y - self.alpha, v - self.beta], dtype=complex))

    def at(self, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Return height in m and speed in m/s, each of the shape of `time_s`."""
        t = np.asarray(time_s, dtype=np.float64)
        grown = self.c * np.exp(t[..., None] * self.p)
        y: Floats = self.alpha + self.beta * t + grown.sum(-1).real
        v: Floats = self.beta + (grown * self.p).sum(-1).real
        return y, v


class Continuous:
    """A run in closed form: free, then pressed with a moving reference, then with a resting one."""

    def __init__(self, loop: Loop, onset: tuple[float, float] | None = None) -> None:
        """Compute the three segments; `onset` replaces time and velocity of the computed onset."""
        self.loop = loop
        free = Segment(loop, False, loop.start, -loop.speed, loop.start, 0.0)
        if onset is None:
            low, high = 0.0, loop.moving_s
            while high - low > 1e-16:
                middle = 0.5 * (low + high)
                if middle in (low, high):
                    break
                low, high = (middle, high) if free.at(middle)[0] > 0 else (low, middle)
            onset = high, float(free.at(high)[1])
        self.onset_s = onset[0]
        reference = loop.start - loop.speed * self.onset_s
        pressed = Segment(loop, True, reference, -loop.speed, 0.0, onset[1])
        y, v = pressed.at(loop.moving_s - self.onset_s)
        held = Segment(loop, True, loop.start - loop.speed * loop.moving_s, 0.0, float(y), float(v))
        self._segments = ((0.0, free), (self.onset_s, pressed), (loop.moving_s, held))

    def at(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Return height in m, speed in m/s and the wall's force in N at n times, each (n,)."""
        y, v = np.empty_like(time_s), np.empty_like(time_s)
        begins = [begin for begin, _ in self._segments]
        which = np.searchsorted(begins, time_s, side="right") - 1
        for index, (begin, segment) in enumerate(self._segments):
            here = which == index
            y[here], v[here] = segment.at(time_s[here] - begin)
        force: Floats = np.where(which > 0, -self.loop.stiffness * y - self.loop.damping * v, 0.0)
        return y, v, force


def simulated(loop: Loop, rate_hz: float, delay_s: float = 0.0) -> tuple[Floats, Floats, Floats]:
    """Simulate the sampled loop; return times in s, true heights in m and normal forces in N, each (n,)."""
    hand_mass = 0.2 * loop.mass
    config = {
        "device": {
            "max_force_n": 100,
            "sim": {
                "handle_mass_kg": loop.mass - hand_mass,
                "handle_damping_n_s_per_m": loop.handle_damping,
                "coulomb_friction_n": 0,
                "encoder_step_m": 0,
                "force_step_n": 0,
                "max_force_n": 100,
                "report_delay_s": delay_s,
                "hand": {
                    "mass_kg": hand_mass,
                    "stiffness_n_per_m": loop.hand_stiffness,
                    "damping_n_s_per_m": loop.hand_damping,
                },
            },
        },
        "materials": {"plain": {"stiffness_n_per_m": loop.stiffness, "damping_n_s_per_m": loop.damping}},
        "scene": {"objects": {"floor": FLOOR}, "display": {"force": True, "vibration": False}},
    }
    run = simulate_run(config, loop.waypoints(), loop.duration_s, rate_hz)
    assert run.truth is not None
    time_s = np.arange(len(run.samples)) / rate_hz
    return time_s, run.truth[:, 1].copy(), run.samples["force_n"][:, 1].copy()


@dataclass(frozen=True, slots=True)
class Error:
    """The worst errors over all positions of the onset within the tick."""

    force_n: float
    """Largest difference of the force at a tick."""
    penetration_m: float
    """Largest difference of the penetration at a tick."""
    held_n: float
    """Mean absolute difference of the held force from the true force, also between ticks."""


def placed(loop: Loop, rate_hz: float, phase: int) -> Loop:
    """Return the loop with its onset moved by phase/PHASES of a tick."""
    return dataclasses.replace(loop, start=loop.start + loop.speed / rate_hz * phase / PHASES)


def error(loop: Loop, rate_hz: float, delay_periods: int = 0) -> Error:
    """Return the errors of the sampled loop relative to the closed form, from the onset on."""
    worst = np.zeros(3)
    for phase in range(PHASES):
        case = placed(loop, rate_hz, phase)
        truth = Continuous(case)
        time_s, y, force = simulated(case, rate_hz, delay_periods / rate_hz)
        y_true, _, force_true = truth.at(time_s)
        # The middles of SUBTICKS intervals of each tick.
        between = (time_s[:, None] + (np.arange(SUBTICKS) + 0.5) / SUBTICKS / rate_hz).ravel()
        inside = between > truth.onset_s
        held = np.abs(np.repeat(force, SUBTICKS) - truth.at(between)[2])[inside]
        found = (np.abs(force - force_true).max(), np.abs(y - y_true).max(), held.mean())
        worst = np.maximum(worst, found)
    return Error(*worst.tolist())


def without_hold(loop: Loop, rate_hz: float) -> float:
    """Return the largest error of the penetration in m relative to a continuous loop with a wall damping of -K T/2.

    A held force is T/2 old on average: K y(t - T/2) is K y - (K T/2) y' to first order; the error is of second order.
    """
    worst = 0.0
    for phase in range(PHASES):
        case = placed(loop, rate_hz, phase)
        aged = dataclasses.replace(case, damping=-case.stiffness / rate_hz / 2)
        time_s, y, _ = simulated(case, rate_hz)
        worst = max(worst, float(np.abs(y - Continuous(aged).at(time_s)[0]).max()))
    return worst


def order(rates_hz: tuple[float, ...], errors: list[float]) -> float:
    """Return the power of the period T with which the errors grow: the slope of a line through the logarithms."""
    return float(-np.polyfit(np.log(rates_hz), np.log(errors), 1)[0])


LOOPS = {
    "K = 800 N/m": Loop(800.0),
    "K = 800 N/m, D = 2 N s/m": Loop(800.0, 2.0),
    "K = 2000 N/m": Loop(2000.0),
    "K = 2000 N/m, D = 2 N s/m": Loop(2000.0, 2.0),
}


def peaks(loop: Loop) -> tuple[float, float]:
    """Return the largest force in N and penetration in m of the closed form."""
    y, _, force = Continuous(loop).at(np.linspace(0, loop.duration_s, 20_001))
    return float(force.max()), float(-y.min())


def _loop_table(name: str, loop: Loop, delay_periods: int = 0) -> tuple[Table, list[Error]]:
    errors = [error(loop, rate, delay_periods) for rate in RATES_HZ]
    force, depth = peaks(loop)
    rows = [
        [
            f"{rate:.0f}",
            f"{1e3 * e.force_n:.2f} ({100 * e.force_n / force:.2f} %)",
            f"{1e6 * e.penetration_m:.2f} ({100 * e.penetration_m / depth:.2f} %)",
            f"{1e3 * e.held_n:.2f}",
        ]
        for rate, e in zip(RATES_HZ, errors, strict=True)
    ]
    columns = ([e.force_n for e in errors], [e.penetration_m for e in errors], [e.held_n for e in errors])
    rows.append(["order in T", *(f"{order(RATES_HZ, values):.2f}" for values in columns)])
    late = f", reports {delay_periods} tick old" if delay_periods else ""
    caption = f"{name}{late} (peaks of the closed form: {force:.2f} N, {1e3 * depth:.2f} mm)"
    heads = [
        "rate, Hz",
        "error of the force at ticks, mN",
        "of the penetration at ticks, um",
        "of the held force, mean over time, mN",
    ]
    return Table(caption, heads, rows), errors


def run(options: Options, advance: Advance) -> Section:
    """Return the section with errors of the closed loop at each rate."""
    section = Section(
        "The closed loop",
        [
            "A hand (300 N/m, 5 N s/m) draws a mass of 0.05 kg onto a wall (stiffness K, damping D) at 0.1 m/s and "
            "rests. The simulated joystick has no encoder step, dry friction, force resolution or vibration. The "
            f"reference is the closed form of the continuous loop. Each figure is the largest error over {PHASES} "
            "positions of the onset within the tick, in brackets relative to the peak. *Order in T*: the error grows "
            "with the period T to this power."
        ],
    )
    for index, (name, loop) in enumerate(LOOPS.items()):
        section.parts.append(_loop_table(name, loop)[0])
        advance(0.2 * (index + 1), name)
    loop = LOOPS["K = 800 N/m"]
    left = [without_hold(loop, rate) for rate in RATES_HZ]
    section.parts.append(
        "All errors are of first order in T: a held force is T/2 old on average and acts like a damping of -K T/2 "
        "([why](stability.md#the-proof)); damping from the backward difference of positions is T old. Against a "
        "continuous wall with K T/2 less damping the error is of second order:"
    )
    rows = [[f"{rate:.0f}", f"{1e6 * value:.3f}"] for rate, value in zip(RATES_HZ, left, strict=True)]
    section.parts.append(
        Table(
            "K = 800 N/m, error of the penetration at ticks against a wall with D = -K T/2, um",
            ["rate, Hz", "largest error"],
            [*rows, ["order in T", f"{order(RATES_HZ, left):.2f}"]],
        )
    )
    table, late = _loop_table("K = 800 N/m", loop, 1)
    prompt = [error(loop, rate) for rate in RATES_HZ]
    times = [a.penetration_m / b.penetration_m for a, b in zip(late, prompt, strict=True)]
    section.parts.append(
        "A device whose reports are one tick old makes the force 3 T/2 old instead of T/2. The error in penetration is "
        f"{min(times):.1f} to {max(times):.1f} times as large, and the force lags by one tick:"
    )
    section.parts.append(table)
    return section
