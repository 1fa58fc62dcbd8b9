"""Ways to make a ringing mode, side by side: ns a mode and tick against error, of one strike and of a minute of them.

The reference is A exp(-B t) sin(w t), summed over the strikes, in 40 digits (mpmath).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.closed_loop import library_modes
from bench.peers import Peers, compiled
from bench.plots import Figure, Point, beside, trade
from bench.report import Advance, Floats, Options, Section, Table, alternated, between, spread
from hapticd.config.modes import Mode

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

RATE_HZ = 10_000.0
MINUTE_S = 60.0
COUNTS = (1, 10, 100)
BELL = Mode(0.1, 2 * math.pi * 440.0)
"""Rings for 50 s, so that every strike of a minute still sounds at its end or nearly so."""


@dataclass(frozen=True, slots=True)
class Way:
    """One way: its number among the peers, and the size of its table."""

    kind: int
    size: int = 0


FLOOR, OURS = "two stored numbers added (floor)", "rotor, double (hapticd)"


def ways(peers: Peers) -> dict[str, Way]:
    """All of them by name."""
    lib = peers.lib
    return {
        FLOOR: Way(lib.PEER_MODE_FLOOR),
        OURS: Way(lib.PEER_MODE_ROTOR),
        "rotor, single": Way(lib.PEER_MODE_ROTOR_SINGLE),
        "recurrence of two terms, double": Way(lib.PEER_MODE_RECURRENCE),
        "recurrence of two terms, single": Way(lib.PEER_MODE_RECURRENCE_SINGLE),
        "libm: exp, sin, cos": Way(lib.PEER_MODE_LIBM),
        "table of 256 sines, nearest": Way(lib.PEER_MODE_TABLE, 256),
        "table of 4096 sines, nearest": Way(lib.PEER_MODE_TABLE, 4096),
        "table of 65536 sines, nearest": Way(lib.PEER_MODE_TABLE, 65536),
        "table of 4096 sines, linear": Way(lib.PEER_MODE_TABLE_LINEAR, 4096),
    }


def bank(peers: Peers, way: Way, modes: list[Mode]) -> Any:
    """Silent modes of one way."""
    decay, omega = np.array([(m.decay_rate_per_s, m.angular_frequency_rad_per_s) for m in modes]).T
    return peers.modes(way.kind, decay, omega, 1 / RATE_HZ, way.size)


def reference(mode: Mode, since_s: list[Any]) -> Floats:
    """exp(-B t) sin(w t) at each time, in 40 digits; 0 before the strike."""
    import mpmath  # type: ignore[import-untyped]

    with mpmath.workdps(40):
        decay, omega = mpmath.mpf(mode.decay_rate_per_s), mpmath.mpf(mode.angular_frequency_rad_per_s)
        return np.array([float(mpmath.exp(-decay * t) * mpmath.sin(omega * t)) if t >= 0 else 0.0 for t in since_s])


def ticks_within(mode: Mode, before_s: float) -> int:
    """Ticks after the striking one that lie safely within 5/B: the last one may fall on either side by rounding."""
    return int((5 / mode.decay_rate_per_s - before_s) * RATE_HZ - 1e-6)


def single_error(peers: Peers, way: Way, mode: Mode, wanted: Floats, before_s: float) -> float:
    """Largest error of one strike over 5/B, of the first peak; `wanted` are the ticks after the strike."""
    rings = bank(peers, way, [mode])
    force = np.array([1.0, -0.5])
    peers.lib.peer_modes_strike(rings, 0, peers.doubles(force), before_s)
    heard, _ = peers.ring(rings, len(wanted))
    return float(np.abs(heard - wanted[:, None] * force).max() / mode.peak)


@dataclass(frozen=True, slots=True)
class Strikes:
    """A minute of strikes of one mode: ticks, times before them, coefficients along x and y."""

    at: Any
    before_s: Floats
    force_n: Floats


def strikes_of(mode: Mode, seconds: float) -> Strikes:
    """Seeded strikes, one every two decay times on average, or every half second if that is less: it never ends."""
    rng = np.random.default_rng(7)
    every = min(2 * RATE_HZ / mode.decay_rate_per_s, 0.5 * RATE_HZ)
    count = int(seconds * RATE_HZ / every)
    at = ((np.arange(count) + rng.uniform(0, 0.9, count)) * every).astype(np.uint64)
    return Strikes(at, rng.uniform(0, 1 / RATE_HZ, count), rng.uniform(-1, 1, (count, 2)))


def sum_of(mode: Mode, strikes: Strikes, ticks: int, kept: int) -> Floats:
    """What all strikes add up to in the last `kept` of so many ticks, [kept][2], in 40 digits."""
    import mpmath

    total = np.zeros((kept, 2))
    # A strike of 45 decay times ago is 3e-20 of what it was.
    oldest = ticks - kept - 45 / mode.decay_rate_per_s * RATE_HZ
    with mpmath.workdps(40):
        decay, omega = mpmath.mpf(mode.decay_rate_per_s), mpmath.mpf(mode.angular_frequency_rad_per_s)
        heard = np.flatnonzero(strikes.at >= max(oldest, 0))
        for row in range(kept):
            tick = ticks - kept + row
            parts: list[list[Any]] = [[], []]
            for index in heard:
                since = (tick - int(strikes.at[index])) / mpmath.mpf(RATE_HZ) + mpmath.mpf(strikes.before_s[index])
                if int(strikes.at[index]) > tick:
                    break
                wave = mpmath.exp(-decay * since) * mpmath.sin(omega * since)
                for axis in range(2):
                    parts[axis].append(wave * mpmath.mpf(strikes.force_n[index, axis]))
            total[row] = [float(mpmath.fsum(part)) for part in parts]
    return total


def minute_error(peers: Peers, way: Way, mode: Mode, strikes: Strikes, ticks: int, wanted: Floats) -> float:
    """Largest error of the last ticks, over the largest of what is wanted there."""
    heard = np.empty_like(wanted)
    peers.lib.peer_modes_play(
        bank(peers, way, [mode]),
        ticks,
        len(strikes.at),
        peers.memory("uint64_t *", strikes.at),
        peers.doubles(strikes.before_s),
        peers.doubles(strikes.force_n),
        len(wanted),
        peers.doubles(heard),
    )
    return float(np.abs(heard - wanted).max() / np.abs(wanted).max())


def _errors(peers: Peers, options: Options, advance: Advance) -> dict[str, tuple[float, float]]:
    """Worst over the library of one strike, and of a minute of strikes with the bell among them."""
    modes = [mode for _, mode in library_modes() if mode.frequency_hz <= 0.4 * RATE_HZ]
    before_s = 0.375 / RATE_HZ
    known = []
    for mode in modes:
        count = ticks_within(mode, before_s)
        known.append(reference(mode, [(tick + 0.375) / RATE_HZ for tick in range(1, count + 1)]))
    ticks = round((MINUTE_S if not options.quick else 3.0) * RATE_HZ)
    found = {name: (0.0, 0.0) for name in ways(peers)}
    for name, way in ways(peers).items():
        if name != FLOOR:
            worst = max(single_error(peers, way, m, w, before_s) for m, w in zip(modes, known, strict=True))
            found[name] = (worst, 0.0)
    for index, mode in enumerate([*modes, BELL]):
        strikes = strikes_of(mode, ticks / RATE_HZ)
        wanted = sum_of(mode, strikes, ticks, 100)
        for name, way in ways(peers).items():
            if name != FLOOR:
                single, minute = found[name]
                error = minute_error(peers, way, mode, strikes, ticks, wanted)
                found[name] = (single, max(minute, error))
        advance((index + 1) / (len(modes) + 1), "errors")
    return found


def _costs(peers: Peers, options: Options, advance: Advance) -> dict[int, dict[str, Floats]]:
    """ns a tick of each way, by the number of modes."""
    rounds = options.few(40, 6)
    found = {}
    for index, count in enumerate(COUNTS):
        modes = [Mode(0.05, 300.0 + 5.0 * i) for i in range(count)]
        ticks = 20_000 // count + 200
        runs = {}
        for name, way in ways(peers).items():
            rings = bank(peers, way, modes)
            force = np.array([1.0, -0.5])
            for mode in range(count):
                peers.lib.peer_modes_strike(rings, mode, peers.doubles(force), 0.0)
            runs[name] = lambda rings=rings, ticks=ticks: peers.ring(rings, ticks)[1] / ticks
        part = index / len(COUNTS)
        found[count] = alternated(rounds, runs, between(advance, part, part + 1 / len(COUNTS), "costs"))
    return found


def run(options: Options, advance: Advance) -> Section:
    """Table and figure of it."""
    advance(0.0, "compiling")
    peers = compiled()
    errors = _errors(peers, options, lambda part, what: advance(0.05 + 0.45 * part, what))
    costs = _costs(peers, options, lambda part, what: advance(0.5 + 0.5 * part, what))
    ten = costs[10]
    rows = []
    for name, (single, minute) in errors.items():
        cells = [spread(costs[count][name] / count, ".2f") for count in COUNTS]
        ratio = spread(ten[name] / ten[FLOOR], ".2f")
        told = ["", ""] if name == FLOOR else [f"{single:.1e}", f"{minute:.1e}"]
        rows.append([name, *cells, ratio, *told])
    points = [
        Point(name, (ten[name] / 10).tolist(), max(errors[name]), name == OURS) for name in errors if name != FLOOR
    ]

    def draw(canvas: Canvas) -> None:
        axes = canvas.add_subplot()
        trade(axes, points)
        floor = float(np.median(ten[FLOOR] / 10))
        axes.axvline(floor, color="black", linestyle=":", linewidth=1, label="floor: two stored numbers added")
        axes.set_xlabel("ns a mode and tick, ten modes ringing")
        axes.set_ylabel("worst error, of the peak")
        axes.set_title("Ringing modes")
        beside(canvas, axes)

    lasting = "a minute" if not options.quick else "3 s"
    return Section(
        "Ringing modes",
        [
            "Cost and error of one two-axis mode at 10 kHz: the core's recursion and the alternatives. A way that is "
            "no recursion (libm, tables) merges a strike with what rings already, with libm. Tables hold sines; their "
            "phase is an "
            "integer that does not drift, and the decay one multiplication a tick. One strike: every mode of the "
            f"library over 5/B, largest error over its peak. Strikes: {lasting} of them at their own times within the "
            "tick, every two decay times, and a bell of 440 Hz and 10 s struck twice a second; the last 100 ticks, "
            "over the largest of them; the worst mode. References: 40 digits.",
            Table(
                f"ns a mode and tick with so many ringing; {options.few(40, 6)} rounds in turns: median (10 to 90 %)",
                ["way", *(f"{count}" for count in COUNTS), "over the floor, 10", "error, one strike", "error, strikes"],
                rows,
            ),
            Figure("modes", "Ringing modes: cost against error", draw),
        ],
    )
