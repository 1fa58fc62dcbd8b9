"""Fitted taps against their truth: errors of the figures, and how often the 95 % intervals hold it.

A set is a recording of ten taps at random speeds, by the synthetic stylus, whose waveforms are closed forms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import fit_strokes
from bench.report import Advance, Floats, Options, Section, Table
from hapticd.base.errors import HapticdError
from hapticd.config.materials import Tap, shipped_materials
from hapticd.fit.synthesize import Stylus, taps
from hapticd.fit.tap import fit_tap

SEVEN = ("wood", "acrylic", "delrin", "aluminum", "glass", "cast_iron", "steel")
TAPS = 10
SPEEDS_M_PER_S = (0.1, 0.4)
NOISE = 0.02
FIGURES = ("slope", "slope of the first peak", "frequency", "decay time")


@dataclass(frozen=True, slots=True)
class Errors:
    """[sets, figures]; sets that were refused are not among them."""

    relative: Floats
    held: Floats
    """1 where the interval holds the truth, 0 elsewhere."""
    refused: int


def errors(tap: Tap, sets: int, count: int = TAPS, noise: float = NOISE, seed: int = 1) -> Errors:
    """Of so many sets of so many taps."""
    relative, held, refused = [], [], 0
    for index in range(sets):
        speeds = np.random.default_rng([seed, index]).uniform(*SPEEDS_M_PER_S, count)
        recording, truth = taps(tap, speeds, Stylus(noise_rms=noise, seed=1000 * seed + index))
        try:
            fit = fit_tap([recording])
        except HapticdError:
            refused += 1
            continue
        mode = truth.mode
        pairs = (
            (fit.slope_per_s, truth.slope_per_s),
            (fit.first_peak_slope_per_s, truth.slope_per_s * mode.peak),
            (fit.frequency_hz, mode.frequency_hz),
            (fit.decay_time_s, mode.decay_time_s),
        )
        relative.append([found.value / true - 1 for found, true in pairs])
        held.append([float(found.low <= true <= found.high) for found, true in pairs])
    return Errors(np.array(relative).reshape(-1, len(FIGURES)), np.array(held).reshape(-1, len(FIGURES)), refused)


def run(options: Options, advance: Advance) -> Section:
    """A table of it."""
    sets = options.few(12, 3)
    rows, every = [], []
    for index, name in enumerate(SEVEN):
        tap = shipped_materials()[name].tap
        assert tap is not None
        found = errors(tap, sets)
        every.append(found)
        rows.append([name, *_cells(found)])
        advance((index + 1) / len(SEVEN), name)
    together = Errors(
        np.concatenate([found.relative for found in every]),
        np.concatenate([found.held for found in every]),
        sum(found.refused for found in every),
    )
    rows.append(["all", *_cells(together)])
    return Section(
        "Fitted taps",
        [
            f"{sets} recordings of {TAPS} taps for each material, at 25 kHz with {100 * NOISE:g} % noise, speeds at "
            f"random between {SPEEDS_M_PER_S[0]:g} and {SPEEDS_M_PER_S[1]:g} m/s. Told is the median of the error's "
            "size in per cent, and the part of the recordings whose 95 % interval holds the truth; that part is itself "
            f"uncertain by {_uncertain(sets):.1f} points (two standard errors) for one material, by "
            f"{_uncertain(len(SEVEN) * sets):.1f} for all.",
            Table(f"Median error, % / coverage; {sets} recordings", ["material", *FIGURES, "refused"], rows),
            fit_strokes.table(options),
        ],
    )


def _cells(found: Errors) -> list[str]:
    if not len(found.held):
        return [*("-" for _ in FIGURES), f"{found.refused}"]
    middle = 100 * np.median(np.abs(found.relative), axis=0)
    held = found.held.mean(axis=0)
    return [*(f"{error:.2f} / {part:.3f}" for error, part in zip(middle, held, strict=True)), f"{found.refused}"]


def _uncertain(sets: int) -> float:
    return float(200 * (0.95 * 0.05 / sets) ** 0.5)
