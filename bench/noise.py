"""Ways to make coloured noise: ns a sample against the error of its power and of its spectrum.

The reference is the analytic spectrum of the filter that is meant (hapticd.rendering.filter_design.power_spectrum is
not asked: the
transfer function is written out here). A filter that stays is judged by its power, whole and in third octaves; one that
is another one every few samples by its power, which is one whatever happens, if it is right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from bench.peers import Peers, compiled
from bench.plots import Figure, Point, beside, trade
from bench.report import Advance, Floats, Options, Section, Table, alternated, between, spread
from hapticd.base.core import ffi

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

RATE_HZ = 10_000.0
ORDERS = (2, 10, 32)
TABLES = (4096, 65536)
SEED = 20
CHANGES = (1, 4, 16)
"""Samples between two changes of the filter."""
PAIRS = 6
"""Pairs of filters that take turns."""
BANDS_HZ = (50.0, 4000.0)
FLOOR, OURS, DIRECT, LADDER = (
    "white numbers alone (floor)",
    "normalised lattice (hapticd)",
    "direct form",
    "lattice, not normalised",
)


@dataclass(frozen=True, slots=True)
class Coloured:
    """An all-pole filter of unit power: its reflection coefficients, a_1 .. a_p, and its gain."""

    reflection: Floats
    coefficients: Floats
    gain: float


def coloured(order: int, seed: int) -> Coloured:
    """A seeded one with a clear peak: a resonance, and smaller reflections on top of it."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(0.1, 0.5), 0.97
    reflection = np.zeros(order)
    reflection[1] = radius**2
    reflection[0] = -2 * radius * math.cos(angle) / (1 + radius**2)
    reflection[2:] = rng.uniform(-0.2, 0.2, max(0, order - 2))
    polynomial = np.ones(1)
    for k in reflection:
        polynomial = np.append(polynomial, 0.0) + k * np.append(0.0, polynomial[::-1])
    return Coloured(reflection, polynomial[1:].copy(), math.sqrt(float(np.prod(1 - reflection**2))))


def density(filter: Coloured, frequency_hz: Floats) -> Floats:
    """One-sided, 1/Hz: 2 g^2 / (rate |A(exp(-i w))|^2)."""
    delay = np.exp(-2j * np.pi * frequency_hz / RATE_HZ)
    polynomial = np.polynomial.polynomial.polyval(delay, np.append(1.0, filter.coefficients))
    found: Floats = 2 * filter.gain**2 / RATE_HZ / np.abs(polynomial) ** 2
    return found


def bands_db(noise: Floats, filter: Coloured) -> Floats:
    """Power in third octaves, dB over what the filter's spectrum says. Welch's mean over Hann windows of 4096."""
    size = 4096
    window = np.hanning(size)
    scale = 2 / (RATE_HZ * float(window @ window))
    starts = range(0, len(noise) - size + 1, size // 2)
    power = np.zeros(size // 2 + 1)
    for start in starts:
        power += np.abs(np.fft.rfft(noise[start : start + size] * window)) ** 2
    power *= scale / len(starts)
    frequency = np.fft.rfftfreq(size, 1 / RATE_HZ)
    fine = (np.arange(64 * size // 2) + 0.5) * RATE_HZ / size / 64
    meant = density(filter, fine)
    edges = BANDS_HZ[0] * 2 ** (np.arange(0, math.floor(3 * math.log2(BANDS_HZ[1] / BANDS_HZ[0])) + 1) / 3)
    found = []
    width = RATE_HZ / size
    for low, high in pairwise(edges):
        inside = (frequency >= low) & (frequency < high)
        # A bin stands for its width around it.
        covered = (fine >= frequency[inside][0] - width / 2) & (fine < frequency[inside][-1] + width / 2)
        found.append(10 * math.log10(float(power[inside].sum()) * width / (float(meant[covered].sum()) * width / 64)))
    return np.array(found)


Which: TypeAlias = np.ndarray[tuple[int], np.dtype[np.uint8]]
"""[n]: which filter makes each sample."""


@dataclass(frozen=True, slots=True)
class Source:
    """Makes noise of two filters: (which [n]) -> (samples [n], ns)."""

    make: Callable[[Which], tuple[Floats, float]]
    changes: bool = True
    """Whether it can go from one filter to the other."""


def sources(peers: Peers, filters: tuple[Coloured, Coloured]) -> dict[str, Source]:
    """All of them by name."""
    lib = peers.lib
    order = len(filters[0].reflection)
    direct = np.stack([each.coefficients for each in filters])
    ladder = np.stack([each.reflection for each in filters])
    gains = np.array([each.gain for each in filters])
    # One model, or one at each of two speeds; nodes of RMS and reflection coefficients.
    nodes = [np.append(1.0, each.reflection) for each in filters]

    def ours(which: Which) -> tuple[Floats, float]:
        speeds = [0.1, 0.2] if which.any() else [0.1]
        numbers = np.concatenate((speeds, [0.0], *nodes[: len(speeds)]))
        fields = {"order": order, "speed_count": len(speeds), "force_count": 1, "seed": SEED, "force_per_unit": 1.0}
        noise = ffi.new("struct hd_noise *", fields)
        return peers.lattice(noise, numbers, np.where(which == 0, 0.1, 0.2), np.zeros(len(which)))

    def table(size: int) -> Source:
        made = peers.noise(lib.PEER_NOISE_DIRECT, direct, gains, np.zeros(size + 4000, dtype=np.uint8), SEED)[0]
        stretch = made[4000:]
        return Source(lambda which: peers.noise(lib.PEER_NOISE_TABLE, stretch, gains, which, SEED), False)

    return {
        FLOOR: Source(lambda which: peers.noise(lib.PEER_NOISE_WHITE, direct, gains, which, SEED), False),
        DIRECT: Source(lambda which: peers.noise(lib.PEER_NOISE_DIRECT, direct, gains, which, SEED)),
        LADDER: Source(lambda which: peers.noise(lib.PEER_NOISE_LADDER, ladder, gains, which, SEED)),
        OURS: Source(ours),
        **{f"table of {size}": table(size) for size in TABLES},
    }


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, slots=True)
class Wrong:
    """What is wrong with a source. Infinite: it diverges, or cannot change at all."""

    level: float
    """RMS less one, the filter staying."""
    octaves_db: float
    octaves_worst_db: float
    changing: float
    """Largest |RMS - 1| while filters take turns."""
    largest: float
    """Sample, while they do."""


def errors(peers: Peers, order: int, seconds: float) -> dict[str, Wrong]:
    """Every source but the white numbers."""
    count = round(seconds * RATE_HZ)
    filters = (coloured(order, 1), coloured(order, 2))
    made = sources(peers, filters)
    found = {}
    for name, source in made.items():
        if name == FLOOR:
            continue
        samples, _ = source.make(np.zeros(count, dtype=np.uint8))
        bands = bands_db(samples, filters[0])
        found[name] = Wrong(_rms(samples) - 1, _rms(bands), float(np.abs(bands).max()), math.inf, math.inf)
    for pair in range(PAIRS):
        for every in CHANGES:
            which = ((np.arange(count) // every) % 2).astype(np.uint8)
            for name, source in sources(peers, (coloured(order, 1 + 2 * pair), coloured(order, 2 + 2 * pair))).items():
                if not source.changes:
                    continue
                with np.errstate(over="ignore", invalid="ignore"):
                    settled = source.make(which)[0][1000:]
                    wrong = abs(_rms(settled) - 1) if np.isfinite(settled).all() else math.inf
                    largest = float(np.abs(settled).max()) if math.isfinite(wrong) else math.inf
                before = found[name]
                if pair or every != CHANGES[0]:
                    wrong, largest = max(wrong, before.changing), max(largest, before.largest)
                found[name] = replace(before, changing=wrong, largest=largest)
    return found


def costs(peers: Peers, order: int, rounds: int, tell: Callable[[float], None]) -> dict[bool, dict[str, Floats]]:
    """ns a sample; by whether the filter changes."""
    made = sources(peers, (coloured(order, 1), coloured(order, 2)))
    found = {}
    for changes in (False, True):
        which = ((np.arange(20_000) // CHANGES[-1]) % 2 * changes).astype(np.uint8)
        runs: dict[str, Callable[[], float]] = {}
        for name, source in made.items():

            def timed(source: Source = source, which: Which = which) -> float:
                return source.make(which)[1] / len(which)

            if source.changes or not changes or name == FLOOR:
                runs[name] = timed
        found[changes] = alternated(
            rounds, runs, between(lambda part, _: tell(part), changes / 2, (changes + 1) / 2, "")
        )
    return found


def run(options: Options, advance: Advance) -> Section:
    """Table and figure of it."""
    rounds, seconds = options.few(30, 4), options.few(120, 6)
    peers = compiled()
    rows, drawn = [], {}
    for index, order in enumerate(ORDERS):
        base = index / len(ORDERS)
        priced = costs(peers, order, rounds, between(advance, base, base + 0.5 / len(ORDERS), "costs"))
        wrong = errors(peers, order, seconds)
        for name, cost in priced[False].items():
            cells = [spread(cost, ".1f"), spread(cost / priced[False][FLOOR], ".2f")]
            if name == FLOOR:
                rows.append([f"order {order}: {name}", *cells, "", "", "", "", ""])
                continue
            of = wrong[name]
            cells += [f"{100 * of.level:+.2f}", f"{of.octaves_db:.2f} / {of.octaves_worst_db:.2f}"]
            if name in priced[True]:
                cells.append(spread(priced[True][name], ".1f"))
                # As large as this it is on its way to infinity.
                diverges = of.largest > 1e6
                cells += ["diverges", "-"] if diverges else [f"{100 * of.changing:.2f}", f"{of.largest:.1f}"]
            else:
                cells += ["cannot", "cannot", "-"]
            rows.append([f"order {order}: {name}", *cells])
            drawn[order, name] = (cost, of.octaves_db)
            if name in priced[True]:
                drawn[-order, name] = (priced[True][name], 1000.0 if of.largest > 1e6 else 100 * of.changing)
        advance(base + 1 / len(ORDERS), f"order {order}")

    def draw(canvas: Canvas) -> None:
        plots = canvas.subplots(1, 2)
        labels = ("rms error of third octaves, dB", "worst error of the RMS, %")
        names = [name for order, name in drawn if order == 10]
        for axes, sign, label in zip(plots, (1, -1), labels, strict=True):
            for order, hollow in ((10, False), (32, True)):
                here = [(name, drawn.get((sign * order, name))) for name in names]
                points = [
                    Point(name, found[0].tolist(), found[1], name == OURS) if found else None for name, found in here
                ]
                trade(axes, points, hollow=hollow)
            axes.set_xlabel("ns a sample")
            axes.set_ylabel(label)
        plots[0].set_title("the filter stays", fontsize=10)
        plots[1].set_title("filters take turns; what diverges is drawn at 1000 %", fontsize=10)
        canvas.suptitle("Coloured noise: order 10 filled, order 32 hollow")
        beside(canvas, plots[0])

    return Section(
        "Coloured noise",
        [
            f"All-pole filters at 10 kHz, fed with the same white numbers; {seconds:g} s. A filter that stays: its "
            f"RMS, and its power in third octaves from {BANDS_HZ[0]:g} to {BANDS_HZ[1]:g} Hz over that of its "
            "analytic spectrum; the scatter of a finite stretch is in every row, and is all that there is in most. "
            "Filters that change: two of unit power take turns every "
            f"{', '.join(map(str, CHANGES))} samples, {PAIRS} pairs of them, as models do under a hand that goes to "
            "and fro over a texture; whatever they are, the power is one. The table shows the worst. A table is a "
            "stretch of noise that was made once: it repeats itself, and between two models there is none. The "
            "normalised lattice is the dearest: its stages cost four multiplications instead of two, and the "
            "changing one's cost holds the place in the grid and the square roots of each change. "
            "It is the only one whose power is right "
            "however fast the hand changes.",
            Table(
                f"ns a sample, {rounds} rounds in turns: median (10 to 90 %); errors",
                [
                    "order: way",
                    "ns",
                    "over the floor",
                    "RMS, %",
                    "third octaves, dB: rms / worst",
                    "ns, changing",
                    "RMS, changing, %",
                    "largest sample",
                ],
                rows,
            ),
            Figure("noise", "Coloured noise: cost against error", draw, (11.0, 5.0)),
        ],
    )
