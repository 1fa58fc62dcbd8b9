"""Velocity estimators side by side, by the error of the tap that each would cause: A = slope v, v at the onset.

Every trial is seeded: two axes with speeds and phases of their own, positions rounded to the encoder's step. A relative
error of the speed is that of the amplitude. Beside them stands what the samples allow at all: half the width of the set
of speeds at the onset that are consistent with them, where even the moment at which the hand began to slow down is
known. No estimator can promise less.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bench.peers import Peers, compiled
from bench.plots import COLOURS, Figure, Point, beside, trade
from bench.report import Advance, Floats, Options, Section, Table, alternated, between, spread, verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

STEPS_M = (1e-6, 5e-6, 20e-6, 100e-6)
RATES_HZ = (1000.0, 2000.0, 5000.0, 10_000.0)
STEP_M, RATE_HZ = 20e-6, 10_000.0
"""The default joystick."""
DECELERATIONS = (0.0, 1.0, 3.0, 10.0)
SPEEDS_M_PER_S = (0.05, 0.5)
HELD_S = (0.002, 0.03)
"""How long before the contact a deceleration began."""
Estimate = Callable[[float, Floats, Floats], Floats]
"""(step_m, interval_s [n], position_m [n][2]) -> m/s [n][2]"""
OURS, FLOOR = "hapticd", "backward difference"


@dataclass(frozen=True, slots=True)
class Estimator:
    """Its number among the peers and its parameter."""

    kind: int
    parameter: float = 0.0


def estimators(peers: Peers) -> dict[str, Estimator]:
    """All of them by name."""
    lib = peers.lib
    return {
        FLOOR: Estimator(lib.PEER_VELOCITY_BACKWARD),
        "low-pass of it, 30 Hz": Estimator(lib.PEER_VELOCITY_LOW_PASS, 30.0),
        "low-pass of it, 100 Hz": Estimator(lib.PEER_VELOCITY_LOW_PASS, 100.0),
        "least squares, 16": Estimator(lib.PEER_VELOCITY_LEAST_SQUARES, 16),
        "least squares, 64": Estimator(lib.PEER_VELOCITY_LEAST_SQUARES, 64),
        "FOAW end fit, 16": Estimator(lib.PEER_VELOCITY_FOAW_END, 16),
        "FOAW end fit, 64": Estimator(lib.PEER_VELOCITY_FOAW_END, 64),
        "FOAW best fit, 16": Estimator(lib.PEER_VELOCITY_FOAW_BEST, 16),
        "FOAW best fit, 64": Estimator(lib.PEER_VELOCITY_FOAW_BEST, 64),
        "Kalman, calm": Estimator(lib.PEER_VELOCITY_KALMAN, 30.0),
        "Kalman, quick": Estimator(lib.PEER_VELOCITY_KALMAN, 300.0),
        OURS: Estimator(lib.PEER_VELOCITY_OURS),
    }


def estimate_of(peers: Peers, estimator: Estimator) -> Estimate:
    """It as a function."""
    return lambda step_m, interval_s, position_m: peers.velocity(
        estimator.kind, estimator.parameter, step_m, interval_s, position_m
    )[0]


def quantise(position_m: Floats, step_m: float) -> Floats:
    """What the encoder says."""
    return np.ascontiguousarray(np.round(position_m / step_m) * step_m)


# ---- Approaches ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Approach:
    """Two axes that move at constant speed, slow down at a constant rate, and touch within the last tick."""

    time_s: Floats
    """[n], 0 at the last sample."""
    onset_s: Floats
    """[2], up to a tick before 0."""
    slowing_s: Floats
    """[2], when slowing down began; the onset's own time where it never did."""
    speed_m_per_s: Floats
    """[2], at the onset."""
    position_m: Floats
    """[n][2], rounded."""

    @property
    def interval_s(self) -> Floats:
        """[n], since the sample before."""
        return np.full(len(self.time_s), self.time_s[-1] - self.time_s[-2])


def drawn_speeds(rng: np.random.Generator) -> Floats:
    """Of both axes, spread evenly over the logarithm."""
    return np.exp(rng.uniform(math.log(SPEEDS_M_PER_S[0]), math.log(SPEEDS_M_PER_S[1]), 2))


def approach(rng: np.random.Generator, rate_hz: float, step_m: float, deceleration: float) -> Approach:
    """A seeded one: 40 ms or 64 samples of constant speed, and what comes before the contact."""
    steady_s = max(0.04, 64 / rate_hz)
    count = round((steady_s + HELD_S[1]) * rate_hz) + 2
    time_s = (np.arange(count) - (count - 1)) / rate_hz
    speed = drawn_speeds(rng)
    onset_s = -rng.uniform(0, 1, 2) / rate_hz
    held_s = rng.uniform(*HELD_S, 2) if deceleration else np.zeros(2)
    slowing_s = onset_s - held_s
    since = time_s[:, None] - onset_s
    # Back from the onset: v - a t while it slows down, and straight before that.
    slowed = np.maximum(since, -held_s)
    position = speed * since - 0.5 * deceleration * slowed**2 + deceleration * held_s * (since - slowed)
    return Approach(time_s, onset_s, slowing_s, speed, quantise(position + rng.uniform(0, step_m, 2), step_m))


def tap_errors(estimate: Estimate, rate_hz: float, step_m: float, deceleration: float, trials: int) -> Floats:
    """Relative errors of tap amplitudes. At constant speed a tap may begin at any tick, so every tick counts."""
    rng = np.random.default_rng(1)
    steady = round(max(0.04, 64 / rate_hz) * rate_hz)
    errors = []
    for _ in range(trials):
        trial = approach(rng, rate_hz, step_m, deceleration)
        speeds = estimate(step_m, trial.interval_s, trial.position_m)
        judged = speeds[steady:] if deceleration == 0.0 else speeds[-1:]
        errors.append((judged / trial.speed_m_per_s - 1.0).ravel())
    return np.concatenate(errors)


def consistent(trial: Approach, axis: int, step_m: float, deceleration: float) -> tuple[float, float]:
    """Slowest and fastest speed at the onset of the motions that pass through every sample's interval.

    The motions are straight up to the moment at which slowing down began, which is known, and have one acceleration, of
    any size, from there on: linear in place, speed and acceleration at the onset, so the two ends are linear programs.
    """
    from scipy.optimize import linprog

    since = trial.time_s - trial.onset_s[axis]
    held = trial.onset_s[axis] - trial.slowing_s[axis]
    span = -float(since[0])
    # In steps and in spans, so that every unknown is of the order of one.
    columns = [np.ones_like(since), since / span]
    if deceleration:
        slowed = np.maximum(since, -held)
        columns.append((0.5 * slowed**2 - held * (since - slowed)) / span**2)
    matrix = np.stack(columns, 1)
    middle = trial.position_m[:, axis] / step_m
    offset = middle[-1]
    bounds = np.concatenate((middle - offset + 0.5, offset - middle + 0.5))
    ends = []
    for sign in (1.0, -1.0):
        goal = np.zeros(matrix.shape[1])
        goal[1] = sign
        found = linprog(goal, np.concatenate((matrix, -matrix)), bounds, bounds=(None, None), method="highs")
        if found.status != 0:
            raise RuntimeError(f"no motion passes through the samples: {found.message}")
        ends.append(float(found.x[1]) * step_m / span)
    return ends[0], ends[1]


def best_possible(rate_hz: float, step_m: float, deceleration: float, trials: int) -> Floats:
    """Half the width of that set, over the speed, of each trial's two axes."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(trials):
        trial = approach(rng, rate_hz, step_m, deceleration)
        for axis in range(2):
            low, high = consistent(trial, axis, step_m, deceleration)
            found.append(0.5 * (high - low) / trial.speed_m_per_s[axis])
    return np.array(found)


def impact(estimate: Estimate, rate_hz: float, step_m: float, trials: int) -> tuple[Floats, float]:
    """Speed 0.3 to -0.15 m/s at once: samples until within 0.045 m/s, and RMS error (m/s) from 1 to 10 ms after."""
    rng = np.random.default_rng(3)
    time_s = np.arange(round(0.07 * rate_hz)) / rate_hz
    interval_s = np.full(len(time_s), 1.0 / rate_hz)
    samples, errors = [], []
    for _ in range(trials):
        since = time_s[:, None] - (0.04 + rng.uniform(0, 1.0 / rate_hz, 2))
        position = np.where(since < 0, 0.3, -0.15) * since + rng.uniform(0, step_m, 2)
        error = estimate(step_m, interval_s, quantise(position, step_m)) + 0.15
        for axis in range(2):
            after = since[:, axis] > 0
            samples.append(float(np.argmax(np.abs(error[after, axis]) < 0.045)) + 1)
            errors.append(error[(since[:, axis] > 1e-3) & (since[:, axis] < 1e-2), axis])
    return np.array(samples), float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def after_stop(estimate: Estimate, rate_hz: float, step_m: float, trials: int) -> float:
    """The largest speed that is said of a probe that has rested for 50 ms, on the edge of a step or not, m/s."""
    rng = np.random.default_rng(5)
    time_s = np.arange(round(0.12 * rate_hz)) / rate_hz
    interval_s = np.full(len(time_s), 1.0 / rate_hz)
    worst = 0.0
    for _ in range(trials):
        speed = drawn_speeds(rng)
        position = np.minimum(time_s[:, None] - 0.05, 0.0) * speed + rng.uniform(0, step_m, 2)
        worst = max(worst, float(np.abs(estimate(step_m, interval_s, quantise(position, step_m))[-1]).max()))
    return worst


def motions(rate_hz: float, count: int) -> dict[str, Floats]:
    """What the cost is measured on, [count][2]."""
    time_s = np.arange(count) / rate_hz
    turn = 2 * np.pi * time_s
    return {
        "at rest": np.zeros((count, 2)),
        "0.05, 0 m/s": np.stack((0.05 * time_s, 0 * time_s), 1),
        "0.1, 0.3 m/s": np.stack((0.1 * time_s, 0.3 * time_s), 1),
        "1 Hz circle": 0.05 * np.stack((np.sin(turn), np.cos(turn)), 1),
        "3 Hz circle": 0.04 * np.stack((np.sin(3 * turn), np.cos(3 * turn)), 1),
    }


# ---- The report ----------------------------------------------------------------------------------------------------


def _percent(errors: Floats, *percentiles: float) -> str:
    values = 100 * np.percentile(np.abs(errors), percentiles)
    return " / ".join(f"{value:.2f}" if value < 99.5 else f"{value:.0f}" for value in values)


def _cost_runs(peers: Peers, path_m: Floats, rate_hz: float, step_m: float) -> dict[str, Callable[[], float]]:
    interval_s = np.full(len(path_m), 1.0 / rate_hz)
    position = quantise(path_m + 1.23e-6, step_m)
    runs: dict[str, Callable[[], float]] = {}
    for name, estimator in estimators(peers).items():
        # The plain best fit over 64 samples looks at each of them 64 times.
        share = len(path_m) // 8 if name == "FOAW best fit, 64" else len(path_m)

        def timed(each: Estimator = estimator, share: int = share) -> float:
            taken = peers.velocity(each.kind, each.parameter, step_m, interval_s[:share], position[:share])[1]
            return taken / share

        runs[name] = timed
    return runs


def _said(deceleration: float) -> str:
    return f"{deceleration:g} m/s^2" if deceleration else "constant speed"


@dataclass(frozen=True, slots=True)
class Setting:
    """What was found at one step and rate: errors by deceleration and estimator, the best possible, ns an update."""

    step_m: float
    rate_hz: float
    errors: dict[float, dict[str, Floats]]
    best: dict[float, Floats]
    costs: dict[str, Floats]

    @property
    def title(self) -> str:
        return f"{1e6 * self.step_m:g} um, {self.rate_hz / 1000:g} kHz"


def _setting(
    peers: Peers, step_m: float, rate_hz: float, trials: int, best_trials: int, rounds: int, advance: Advance
) -> Setting:
    errors: dict[float, dict[str, Floats]] = {a: {} for a in DECELERATIONS}
    names = list(estimators(peers).items())
    for index, (name, estimator) in enumerate(names):
        for a in DECELERATIONS:
            errors[a][name] = tap_errors(estimate_of(peers, estimator), rate_hz, step_m, a, trials)
        advance(0.5 * (index + 1) / len(names), name)
    best = {}
    for index, a in enumerate(DECELERATIONS):
        best[a] = best_possible(rate_hz, step_m, a, best_trials)
        advance(0.5 + 0.3 * (index + 1) / len(DECELERATIONS), "what the samples allow")
    path = motions(rate_hz, 4000)["0.1, 0.3 m/s"]
    runs = _cost_runs(peers, path, rate_hz, step_m)
    costs = alternated(rounds, runs, between(advance, 0.8, 1.0, "costs"))
    return Setting(step_m, rate_hz, errors, best, costs)


def _default_table(peers: Peers, setting: Setting, trials: int, rounds: int) -> Table:
    rows = []
    for name, estimator in estimators(peers).items():
        estimate = estimate_of(peers, estimator)
        cells = [_percent(setting.errors[0.0][name], 50, 99, 100)]
        cells += [_percent(setting.errors[a][name], 50, 100) for a in DECELERATIONS[1:]]
        samples, rms = impact(estimate, setting.rate_hz, setting.step_m, trials)
        cells.append(f"{np.median(samples):.0f} / {samples.max():.0f} / {1e3 * rms:.1f}")
        cells.append(f"{1e3 * after_stop(estimate, setting.rate_hz, setting.step_m, trials):.2f}")
        cost = setting.costs[name]
        cells += [spread(cost, ".1f"), spread(cost / setting.costs[FLOOR], ".1f")]
        rows.append([name, *cells])
    possible = [_percent(setting.best[0.0], 50, 99, 100)]
    possible += [_percent(setting.best[a], 50, 100) for a in DECELERATIONS[1:]]
    rows.append(["*what the samples allow*", *possible, "", "", "", ""])
    return Table(
        f"Error of the tap's amplitude with the default joystick ({setting.title}), %; ns an update of both axes at "
        f"0.1 and 0.3 m/s, {rounds} rounds in turns: median (10 to 90 %)",
        [
            "estimator",
            "constant speed: median / 99 % / worst",
            *(f"{_said(a)}: median / worst" for a in DECELERATIONS[1:]),
            "impact: samples, median / worst / rms, mm/s",
            "50 ms after a stop, mm/s",
            "ns",
            f"over {FLOOR}",
        ],
        rows,
    )


def _grid_table(settings: Sequence[Setting], deceleration: float) -> Table:
    names = list(settings[0].costs)
    rows = [
        [
            setting.title,
            *(_percent(setting.errors[deceleration][name], 50, 100) for name in names),
            _percent(setting.best[deceleration], 50, 100),
        ]
        for setting in settings
    ]
    return Table(
        f"Error of the tap's amplitude, {_said(deceleration)}: median / worst, %",
        ["step, rate", *names, "*the samples allow*"],
        rows,
    )


def _motion_table(peers: Peers, rounds: int, advance: Advance) -> Table:
    paths = motions(RATE_HZ, 8000)
    found = {}
    for index, (motion, path) in enumerate(paths.items()):
        runs = _cost_runs(peers, path, RATE_HZ, STEP_M)
        told = between(advance, index / len(paths), (index + 1) / len(paths), motion)
        found[motion] = alternated(rounds, runs, told)
    rows = [[name, *(spread(found[motion][name], ".0f") for motion in paths)] for name in estimators(peers)]
    interval_s = np.full(8000, 1 / RATE_HZ)
    singles = []
    for path in paths.values():
        position = quantise(path + 1.23e-6, STEP_M)
        clock = float(np.median(peers.each_update_ns(-1.0, interval_s, position)))
        each = np.percentile(peers.each_update_ns(STEP_M, interval_s, position), (50, 99, 99.9)) - clock
        singles.append(" / ".join(f"{value:.0f}" for value in each))
    rows.append([f"{OURS}: single updates, 50 / 99 / 99.9 %", *singles])
    return Table(
        f"ns an update of both axes at {1e6 * STEP_M:g} um and {RATE_HZ / 1000:g} kHz, {rounds} rounds in turns: "
        "median (10 to 90 %); single updates less the clock's own time",
        ["estimator", *paths],
        rows,
    )


def _default_figure(setting: Setting) -> Figure:
    def draw(canvas: Canvas) -> None:
        plots = canvas.subplots(2, 2, sharex=True, sharey=True)
        for axes, a in zip(plots.flat, DECELERATIONS, strict=True):
            for percentile, hollow in ((50, False), (100, True)):
                points = [
                    Point(name, costs.tolist(), 100 * float(np.percentile(np.abs(setting.errors[a][name]), percentile)))
                    for name, costs in setting.costs.items()
                ]
                chosen = [Point(p.name, p.costs, p.error, p.name == OURS) for p in points]
                trade(axes, chosen, hollow=hollow)
            allowed = 100 * float(np.median(setting.best[a]))
            axes.axhline(allowed, color="black", linestyle="--", linewidth=1, label="what the samples allow, median")
            axes.set_title(_said(a), fontsize=10)
        for axes in plots[1]:
            axes.set_xlabel("ns an update of both axes")
        for axes in plots[:, 0]:
            axes.set_ylabel("error of the tap's amplitude, %")
        canvas.suptitle(f"Velocity at the onset, {setting.title}: median filled, worst hollow")
        beside(canvas, plots[0, 0])

    return Figure("velocity", "Velocity estimators with the default joystick: cost against error", draw, (11.0, 7.5))


def _grid_figure(settings: Sequence[Setting]) -> Figure:
    def draw(canvas: Canvas) -> None:
        plots = canvas.subplots(len(STEPS_M), len(RATES_HZ), sharex=True, sharey=True)
        for axes, setting in zip(plots.flat, settings, strict=True):
            for a, hollow in ((0.0, False), (3.0, True)):
                points = [
                    Point(name, costs.tolist(), 100 * float(np.median(np.abs(setting.errors[a][name]))), name == OURS)
                    for name, costs in setting.costs.items()
                ]
                trade(axes, points, hollow=hollow)
            for a, style in ((0.0, "-"), (3.0, "--")):
                allowed = 100 * float(np.median(setting.best[a]))
                axes.axhline(
                    allowed, color=COLOURS[6], linestyle=style, linewidth=1, label=f"the samples allow, {_said(a)}"
                )
            axes.set_title(setting.title, fontsize=9)
            axes.tick_params(labelsize=8)
        canvas.supxlabel("ns an update of both axes", fontsize=10)
        canvas.supylabel("median error of the tap's amplitude, %", fontsize=10)
        canvas.suptitle("Velocity at the onset: constant speed filled, slowing down with 3 m/s^2 hollow")
        beside(canvas, plots[0, 0])

    return Figure("velocity-grid", "Velocity estimators by encoder step and rate", draw, (14.0, 11.0))


def run(options: Options, advance: Advance) -> Section:
    """Tables and figures of it."""
    trials, best_trials = options.few(60, 4), options.few(12, 2)
    many, rounds = options.few(300, 10), options.few(20, 3)
    advance(0.0, "compiling")
    peers = compiled()
    settings: list[Setting] = []
    for step_m in STEPS_M:
        for rate_hz in RATES_HZ:
            here = len(settings)

            def tell(part: float, what: str, here: int = here) -> None:
                advance(0.03 + 0.77 * (here + part) / 16, what)

            default = step_m == STEP_M and rate_hz == RATE_HZ
            some = (many, 2 * best_trials, rounds) if default else (trials, best_trials, options.few(7, 2))
            settings.append(_setting(peers, step_m, rate_hz, *some, tell))
    chosen = next(each for each in settings if (each.step_m, each.rate_hz) == (STEP_M, RATE_HZ))
    table = _default_table(peers, chosen, trials, rounds)
    by_motion = _motion_table(peers, options.few(9, 2), lambda part, what: advance(0.8 + 0.2 * part, what))
    ours = 100 * np.abs(chosen.errors[0.0][OURS])
    median, worst = float(np.median(ours)), float(ours.max())
    return Section(
        "Velocity at the onset",
        [
            f"A tap's amplitude is slope times approach speed, so an error of one is an error of the other. "
            f"{SPEEDS_M_PER_S[0]:g} to {SPEEDS_M_PER_S[1]:g} m/s (at the onset, spread evenly over the logarithm), "
            f"after {1e3 * 0.04:g} ms or 64 samples of constant speed; slowing down begins {1e3 * HELD_S[0]:g} to "
            f"{1e3 * HELD_S[1]:g} ms before the onset, and the onset lies up to a tick before the sample that shows "
            f"it. {many} seeded trials of two axes with the default joystick, {trials} elsewhere. What the samples "
            "allow: half the width of the set of speeds at the onset that agree with every sample, over the speed, "
            "where the moment at which slowing down began is known and the deceleration is not; a figure below it was "
            "luck. Impact: from 0.3 to -0.15 m/s at once, samples until within 45 mm/s, and the error from 1 to 10 ms "
            "after.",
            table,
            f"Aim at constant speed with the default joystick: median below 2 %, worst below 10 %. {OURS}: "
            f"{median:.2f} and {worst:.2f} %, reached: {verdict(max(median / 2, worst / 10), 1.0)}.",
            "A filter of Kalman's costs less and is as good while the hand slows down, better where it does so "
            "hardest. It was made for smooth motion: after an impact it takes several times as long, and is off by "
            "far more in the ten milliseconds in which a probe that has bounced touches again. Windows that are "
            "always of the same length are good at constant speed and late everywhere else. hapticd's own stays the "
            "default.",
            _default_figure(chosen),
            _grid_figure(settings),
            *(_grid_table(settings, a) for a in DECELERATIONS),
            by_motion,
        ],
    )
