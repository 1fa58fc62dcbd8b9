"""Errors of fitted taps relative to their truth, and how often the 95 % intervals contain the truth.

Each set is a recording of ten taps at random speeds by the synthetic stylus, whose waveforms are closed forms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import fit_strokes
from bench.report import Advance, Floats, Options, Section, Table, between
from bench.swept import swept, workers
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.config.materials import shipped_materials
from hapticd.fit.synthesize import Stylus, taps
from hapticd.fit.tap import fit_tap

if TYPE_CHECKING:
    from hapticd.sweeps.measures.sweep_point import SweepPoint

TAPS = 10
SPEEDS_M_PER_S = (0.1, 0.4)
NOISE = 0.02
SEED = 1
KEYS = ("slope", "first_peak", "frequency", "decay_time")
"""Names of the fitted quantities in the columns of the study."""
FIGURES = ("slope", "slope of the first peak", "frequency", "decay time")


@dataclass(frozen=True, slots=True)
class Errors:
    """Results of the fits that were not refused, arrays (sets, quantities)."""

    relative: Floats
    held: Floats
    """1 if the interval contains the truth, otherwise 0."""
    refused: int
    """Number of refused fits."""


def fitted(point: SweepPoint) -> dict[str, float | bool | None]:
    """Fit the recording of a point of studies/fit_taps.yaml, and return its errors; None if the fit is refused."""
    tap, index = shipped_materials()[point.parameters["material"]].tap, point.parameters["set"]
    assert tap is not None
    speeds = np.random.default_rng([SEED, index]).uniform(*SPEEDS_M_PER_S, TAPS)
    recording, truth = taps(tap, speeds, Stylus(noise_rms=NOISE, seed=1000 * SEED + index))
    found: dict[str, float | bool | None] = {f"{key}_{what}": None for key in KEYS for what in ("error", "held")}
    try:
        fit = fit_tap([recording])
    except HapticdError:
        return found
    mode = truth.mode
    pairs = (
        (fit.slope_per_s, truth.slope_per_s),
        (fit.first_peak_slope_per_s, truth.slope_per_s * mode.peak),
        (fit.frequency_hz, mode.frequency_hz),
        (fit.decay_time_s, mode.decay_time_s),
    )
    for key, (value, true) in zip(KEYS, pairs, strict=True):
        found[f"{key}_error"] = value.value / true - 1
        found[f"{key}_held"] = bool(value.low <= true <= value.high)
    return found


def errors_of(rows: Sequence[Mapping[str, Any]]) -> Errors:
    """Return the errors in the rows of studies/fit_taps.yaml."""
    kept = [row for row in rows if row[f"{KEYS[0]}_error"] is not None]
    relative = [[row[f"{key}_error"] for key in KEYS] for row in kept]
    held = [[float(row[f"{key}_held"]) for key in KEYS] for row in kept]
    shape = (-1, len(KEYS))
    return Errors(np.array(relative).reshape(shape), np.array(held).reshape(shape), len(rows) - len(kept))


def run(options: Options, advance: Advance) -> Section:
    """Return the section with errors and coverage of taps, strokes and punctures."""
    sets = options.few(12, 3)
    drawn: dict[str, Json] = {"parameters.set": {"low": 0, "high": sets - 1, "count": sets}}
    with workers() as client:
        found = swept(client, "fit_taps", between(advance, 0.0, 0.7, "taps"), drawn)
        strokes = fit_strokes.table(client, options, between(advance, 0.7, 1.0, "strokes"))
    rows = [
        [name, *_cells(errors_of([row for row in found if row["parameters.material"] == name]))]
        for name in dict.fromkeys(row["parameters.material"] for row in found)
    ]
    rows.append(["all", *_cells(errors_of(found))])
    return Section(
        "Fitted taps",
        [
            f"{sets} recordings of {TAPS} taps for each material, at 25 kHz with {100 * NOISE:g} % noise and random "
            f"speeds between {SPEEDS_M_PER_S[0]:g} and {SPEEDS_M_PER_S[1]:g} m/s. The table shows the median of the "
            "absolute error in per cent, and the coverage: the fraction of the recordings whose 95 % interval contains "
            f"the truth. Two standard errors of the coverage are {_uncertainty(sets):.1f} percentage points for one "
            f"material, {_uncertainty(len(found)):.1f} for all.",
            Table(f"Median error, % / coverage; {sets} recordings", ["material", *FIGURES, "refused"], rows),
            strokes,
        ],
    )


def _cells(found: Errors) -> list[str]:
    if not len(found.held):
        return [*("-" for _ in FIGURES), f"{found.refused}"]
    middle = 100 * np.median(np.abs(found.relative), axis=0)
    held = found.held.mean(axis=0)
    return [*(f"{error:.2f} / {covered:.3f}" for error, covered in zip(middle, held, strict=True)), f"{found.refused}"]


def _uncertainty(sets: int) -> float:
    """Return two standard errors of the coverage, in percentage points."""
    return float(200 * (0.95 * 0.05 / sets) ** 0.5)
