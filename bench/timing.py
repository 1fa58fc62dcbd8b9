"""When an onset was and when grooves were passed, with and without interpolation: error of time and of phase."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from bench.closed_loop import library_modes
from bench.peers import Peers, compiled
from bench.plots import Figure, Point, beside, trade
from bench.report import Advance, Floats, Options, Section, Table, alternated, between, spread
from bench.velocity import quantise
from hapticd.base.core import EventKind
from hapticd.rendering.offline import render_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

RATES_HZ = (1000.0, 2000.0, 5000.0, 10_000.0)
STEP_M = 20e-6
SPEEDS_M_PER_S = (0.05, 0.5)
DECELERATION = 3.0
SPACING_M = 2e-3
FAST_SPACING_M = 2e-4
OURS = "straight line between samples (hapticd)"
ONE, ALL, CROSSING = "at the tick, one strike", "at the tick, every groove", OURS


# ---- Onsets --------------------------------------------------------------------------------------------------------


class Onset:
    """Seeded approaches: depths around the onset, the speed that is estimated, and how long before the tick it was."""

    def __init__(self, rate_hz: float, step_m: float, count: int) -> None:
        rng = np.random.default_rng(11)
        self.rate_hz = rate_hz
        self.period_s = 1 / rate_hz
        self.speed = np.exp(rng.uniform(math.log(SPEEDS_M_PER_S[0]), math.log(SPEEDS_M_PER_S[1]), count))
        self.truth_s = rng.uniform(0.0, self.period_s, count)
        self.step_m = step_m
        # So many samples on either side that rounding cannot have moved the onset by more.
        self.samples = 4 + math.ceil((step_m / SPEEDS_M_PER_S[0]) * rate_hz)
        tick = np.arange(-self.samples, self.samples)
        since = tick * self.period_s + self.truth_s[:, None]
        self.depth = self.speed[:, None] * since - 0.5 * DECELERATION * since**2
        # The surface lies anywhere between the encoder's steps.
        offset = rng.uniform(0, step_m, count)[:, None] if step_m else 0.0
        if step_m:
            self.depth = np.round((self.depth + offset) / step_m) * step_m - offset
        seen = np.argmax(self.depth > 0, axis=1)
        rows = np.arange(count)
        self.pairs = np.ascontiguousarray(np.stack((self.depth[rows, seen - 1], self.depth[rows, seen]), 1))
        self.late_s = tick[seen] * self.period_s + self.truth_s
        """From the onset to the tick that sees it."""
        slowed = self.speed - DECELERATION * self.late_s
        # 2 %: what an estimator may be off by.
        self.estimated = slowed * (1 + rng.uniform(-0.02, 0.02, count))


def onset_ways(peers: Peers) -> dict[str, int]:
    """All ways by name."""
    lib = peers.lib
    return {
        "at the tick": lib.PEER_ONSET_TICK,
        OURS: lib.PEER_ONSET_LINEAR,
        "depth over estimated speed": lib.PEER_ONSET_SPEED,
    }


def onset_errors(peers: Peers, way: int, onset: Onset) -> Floats:
    """How much later than the truth each onset is said to be, s."""
    before, _ = peers.onset(way, onset.period_s, onset.pairs, onset.estimated)
    late: Floats = onset.late_s - before
    return late


def rendered_errors(onset: Onset) -> Floats:
    """The same as the core tells it, in the events of `hapticd.render`, each approach on its own."""
    config = {
        "materials": {"plain": {"stiffness_n_per_m": 100}},
        "scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "plain"}}},
        "device": {"sim": {"encoder_step_m": onset.step_m}},
    }
    rows, columns = onset.depth.shape
    # One after the other, up from each and down to the next outside of what is judged; slow enough to be no glitch.
    apart = 64
    height = np.full((rows, apart + columns), 0.01)
    height[:, apart:] = -onset.depth
    height[:, : apart // 2] = np.linspace(-np.roll(onset.depth[:, -1], 1), 0.01, apart // 2, axis=1)
    height[:, apart // 2 : apart] = np.linspace(np.full(rows, 0.01), -onset.depth[:, 0], apart // 2, axis=1)
    height[0, : apart // 2] = 0.01
    path = np.stack((np.zeros(height.size), height.ravel()), 1)
    run = render_run(config, path, onset.rate_hz)
    struck = run.events[run.events["kind"] == EventKind.CONTACT]
    if len(struck) != rows:
        raise RuntimeError(f"{len(struck)} onsets of {rows}")
    begin = (np.arange(rows) * (apart + columns) + apart + onset.samples) * onset.period_s - onset.truth_s
    told: Floats = struck["tick"] * onset.period_s - struck["before_tick_s"] - begin
    return told


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _phases(errors: Mapping[tuple[float, float], Mapping[str, Floats]]) -> list[list[str]]:
    """The rms errors as phases of each of the library's modes."""
    phases = []
    for material, mode in library_modes():
        cells = []
        for rate in (1000.0, 10_000.0):
            for name in ("at the tick", OURS):
                for step in (0.0, STEP_M):
                    time_s = _rms(errors[rate, step][name])
                    shown = mode.frequency_hz <= 0.4 * rate
                    degrees = 360 * mode.frequency_hz * time_s
                    cells.append((f"{degrees:.1g}" if degrees < 0.1 else f"{degrees:.1f}") if shown else "-")
        phases.append([f"{material}, {mode.frequency_hz:.0f} Hz", *cells])
    return phases


def onsets(options: Options, advance: Advance) -> Section:
    """Tables and figure of onsets."""
    count, rounds = options.few(5000, 500), options.few(40, 6)
    errors: dict[tuple[float, float], dict[str, Floats]] = {}
    peers = compiled()
    ways = onset_ways(peers)
    for rate in RATES_HZ:
        for step in (0.0, STEP_M):
            onset = Onset(rate, step, count)
            found = {name: onset_errors(peers, way, onset) for name, way in ways.items()}
            # What the core says takes the formula's place.
            found[OURS] = rendered_errors(onset)
            errors[rate, step] = found
        advance(0.1 + 0.5 * (RATES_HZ.index(rate) + 1) / len(RATES_HZ), f"{rate:.0f} Hz")
    onset = Onset(10_000.0, STEP_M, 4000)
    runs: dict[str, Callable[[], float]] = {}
    for name, way in ways.items():

        def timed(way: int = way) -> float:
            return peers.onset(way, onset.period_s, onset.pairs, onset.estimated)[1] / 4000

        runs[name] = timed
    costs = alternated(rounds, runs, between(advance, 0.6, 1.0, "costs"))
    floor = costs["at the tick"]
    rows = [
        [
            f"{rate / 1000:g} kHz, {'exact positions' if step == 0 else f'{1e6 * step:g} um'}",
            *(f"{1e6 * _rms(found[name]):.3g} / {1e6 * np.abs(found[name]).max():.3g}" for name in ways),
        ]
        for (rate, step), found in errors.items()
    ]
    priced = [
        ["ns an onset", *(spread(costs[name], ".2f") for name in ways)],
        ["over the floor, at the tick", *(spread(costs[name] / floor, ".2f") for name in ways)],
    ]
    phases = _phases(errors)
    heads = [
        f"{rate / 1000:g} kHz, {name}, {'exact' if step == 0 else f'{1e6 * step:g} um'}"
        for rate in (1000.0, 10_000.0)
        for name in ("at the tick", "interpolated")
        for step in (0.0, STEP_M)
    ]

    def draw(canvas: Canvas) -> None:
        plots = canvas.subplots(1, 2, sharey=True)
        for axes, step in zip(plots, (0.0, STEP_M), strict=True):
            for rate, hollow in ((10_000.0, False), (1000.0, True)):
                points = [
                    Point(name, costs[name].tolist(), 1e6 * _rms(errors[rate, step][name]), name == OURS)
                    for name in ways
                ]
                trade(axes, points, hollow=hollow)
            axes.set_xlabel("ns an onset")
            axes.set_title("exact positions" if step == 0 else f"steps of {1e6 * step:g} um", fontsize=10)
        plots[0].set_ylabel("rms error of the onset, us")
        canvas.suptitle("Onset time: 10 kHz filled, 1 kHz hollow")
        beside(canvas, plots[0])

    return Section(
        "Time of the onset",
        [
            f"{count} seeded approaches with {SPEEDS_M_PER_S[0]:g} to {SPEEDS_M_PER_S[1]:g} m/s that slow down with "
            f"{DECELERATION:g} m/s^2, onsets anywhere within the tick, the surface anywhere between the encoder's "
            "steps. The third way divides the depth at the tick by a speed that is up to 2 % off. What hapticd says "
            "is read from the events of hapticd.render; the cost of each way is that of its formula alone. A step of "
            "the encoder hides an onset until the handle has gone on by up to a step, which no interpolation can know.",
            Table("Error of the onset, us: rms / worst", ["rate, positions", *ways], rows),
            Table(f"Cost, {rounds} rounds in turns: median (10 to 90 %)", ["", *ways], priced),
            Table("The same rms as an error of phase, degrees (-: the rate cannot carry it)", ["mode", *heads], phases),
            Figure("onset", "Onset time: cost against error", draw, (10.0, 4.5)),
        ],
    )


# ---- Grooves -------------------------------------------------------------------------------------------------------


class Stroke:
    """A hand that strokes over `reach` grooves to either side: a sine, sampled and rounded, and when it passes each."""

    def __init__(self, rate_hz: float, step_m: float, spacing_m: float, reach: int, frequency_hz: float) -> None:
        self.rate_hz, self.spacing_m = rate_hz, spacing_m
        # It turns round more than half a spacing beyond the last groove, which may then be struck again.
        amplitude_m = (reach + 0.75) * spacing_m
        middle_m = 0.1037 * spacing_m
        turn = 2 * math.pi * frequency_hz
        time_s = np.arange(round(2 * rate_hz / frequency_hz)) / rate_hz
        along = amplitude_m * np.sin(turn * time_s) + middle_m
        self.along = quantise(along, step_m) if step_m else np.ascontiguousarray(along)
        found = []
        for groove in range(-reach, reach + 1):
            first = math.asin((groove * spacing_m - middle_m) / amplitude_m) / turn
            for period in range(3):
                found += [(first + period / frequency_hz, groove)]
                found += [(0.5 / frequency_hz - first + period / frequency_hz, groove)]
        last = time_s[-1]
        self.passed = sorted((at, groove) for at, groove in found if 0 < at <= last)


def matched(stroke: Stroke, times_s: Floats, which: np.ndarray[tuple[int], np.dtype[np.int64]]) -> tuple[Floats, int]:
    """Errors of the times of the strikes that are some passage's, each passage its nearest one of the same groove
    within ten ticks and a step's way, and how many passages have no strike."""
    errors, lost = [], 0
    free = np.ones(len(times_s), dtype=bool)
    for at, groove in stroke.passed:
        candidates = np.flatnonzero((which == groove) & free)
        if len(candidates):
            near = candidates[np.argmin(np.abs(times_s[candidates] - at))]
            if abs(times_s[near] - at) < 10 / stroke.rate_hz:
                errors.append(times_s[near] - at)
                free[near] = False
                continue
        lost += 1
    return np.array(errors), lost


def rendered_strikes(stroke: Stroke) -> tuple[Floats, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Times and grooves as the events of `hapticd.render` tell them."""
    texture = {
        "kind": "grooves",
        "display": "vibration",
        "spacing_m": stroke.spacing_m,
        "width_m": stroke.spacing_m / 4,
        "velocity_gain_per_s": 1.0,
        "force_gain_m_per_s2_per_n": 0.0,
        "frequency_hz": 200,
        "decay_time_s": 0.003,
    }
    config = {
        "materials": {"comb": {"stiffness_n_per_m": 800, "texture": texture}},
        "scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "comb"}}},
    }
    path = np.stack((stroke.along, np.full(len(stroke.along), -1e-3)), 1)
    run = render_run(config, path, stroke.rate_hz)
    struck = run.events[run.events["kind"] == EventKind.GROOVE]
    times: Floats = struck["tick"] / stroke.rate_hz - struck["before_tick_s"]
    # An event does not say which groove it was: the one that is nearest to the probe at that time.
    at = np.interp(times, np.arange(len(path)) / stroke.rate_hz, stroke.along)
    return times, np.rint(at / stroke.spacing_m).astype(np.int64)


def strokes(rate_hz: float) -> Mapping[str, Stroke]:
    """What grooves are judged on."""
    return {
        "2 mm, exact": Stroke(rate_hz, 0.0, SPACING_M, 10, 2.0),
        "2 mm, 20 um": Stroke(rate_hz, STEP_M, SPACING_M, 10, 2.0),
        "0.2 mm at up to 1 m/s, exact": Stroke(rate_hz, 0.0, FAST_SPACING_M, 200, 4.0),
    }


def groove_ways(peers: Peers) -> dict[str, int]:
    """All ways by name."""
    lib = peers.lib
    return {ONE: lib.PEER_GROOVE_TICK_ONE, ALL: lib.PEER_GROOVE_TICK_ALL, CROSSING: lib.PEER_GROOVE_CROSSING}


def grooves(options: Options, advance: Advance) -> Section:
    """Tables and figure of grooves."""
    rounds = options.few(40, 6)
    rows = []
    kept: dict[tuple[float, str, str], float] = {}
    peers = compiled()
    ways = groove_ways(peers)
    for index, rate in enumerate(RATES_HZ):
        for case, stroke in strokes(rate).items():
            cells = []
            for name, way in ways.items():
                times, which, _ = peers.grooves(way, 1 / rate, stroke.spacing_m, stroke.along)
                if name == CROSSING:
                    times, which = rendered_strikes(stroke)
                errors, lost = matched(stroke, times, which)
                kept[rate, case, name] = _rms(errors)
                cells.append(f"{1e6 * _rms(errors):.3g} / {1e6 * np.abs(errors).max():.3g} / {lost}")
            rows.append([f"{rate / 1000:g} kHz, {case}", str(len(stroke.passed)), *cells])
        advance(0.1 + 0.5 * (index + 1) / len(RATES_HZ), f"{rate:.0f} Hz")
    along = strokes(10_000.0)["2 mm, exact"]
    runs: dict[str, Callable[[], float]] = {}
    for name, way in ways.items():

        def timed(way: int = way) -> float:
            return peers.grooves(way, 1e-4, along.spacing_m, along.along)[2] / len(along.along)

        runs[name] = timed
    costs = alternated(rounds, runs, between(advance, 0.6, 1.0, "costs"))
    priced = [
        ["ns a tick", *(spread(costs[name], ".2f") for name in ways)],
        [f"over the floor, {ONE}", *(spread(costs[name] / costs[ONE], ".2f") for name in ways)],
    ]

    def draw(canvas: Canvas) -> None:
        cases = list(strokes(10_000.0))
        plots = canvas.subplots(1, len(cases), sharey=True)
        for axes, case in zip(plots, cases, strict=True):
            for rate, hollow in ((10_000.0, False), (1000.0, True)):
                points = [
                    Point(name, costs[name].tolist(), 1e6 * kept[rate, case, name], name == CROSSING) for name in ways
                ]
                trade(axes, points, hollow=hollow)
            axes.set_xlabel("ns a tick")
            axes.set_title(case, fontsize=10)
        plots[0].set_ylabel("rms error of a strike's time, us")
        canvas.suptitle("Time of groove strikes: 10 kHz filled, 1 kHz hollow")
        beside(canvas, plots[0])

    return Section(
        "Time of grooves",
        [
            "A hand strokes to and fro (sine; 21.5 mm at 2 Hz, up to 0.27 m/s; 40 mm at 4 Hz, up to 1 m/s) over "
            "grooves. A strike's time is compared with the time at which the continuous motion passes the groove; a "
            "passage without a strike of its own within ten ticks is lost. What hapticd says is read from the events "
            "of hapticd.render, which also leaves out the groove that was struck last until the hand was half a "
            "spacing away; costs are those of detection alone. The place of a groove rounds as every position does: a "
            "step of 20 um at 0.25 m/s takes 80 us.",
            Table("Error of the times, us: rms / worst / passages lost", ["rate, grooves", "passages", *ways], rows),
            Table(f"Cost at 2 mm, {rounds} rounds in turns: median (10 to 90 %)", ["", *ways], priced),
            Figure("grooves", "Time of groove strikes: cost against error", draw, (11.0, 4.5)),
        ],
    )
