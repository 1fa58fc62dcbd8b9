"""Errors of fitted grooves, textures and punctures, and how often the intervals contain the truth.

Synthetic recordings have 25 kHz, noise of 2 % of the largest acceleration, and a hand that swings. The accelerometer
has no mounting resonance and no filter, whose bias is described in docs/fit_strokes.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from bench.report import Options, Table
from bench.swept import swept
from hapticd.analysis.statistics import Estimate
from hapticd.base.yaml_source import Json
from hapticd.config.materials import Material, validate_materials
from hapticd.fit.grooves import fit_grooves
from hapticd.fit.puncture import fit_puncture
from hapticd.fit.recording import Recording
from hapticd.fit.synthesize import Hand, Stylus, grooves, puncture, texture
from hapticd.fit.texture import fit_texture

if TYPE_CHECKING:
    from hapticd.sweeps.measures.sweep_point import SweepPoint

Figures: TypeAlias = Mapping[str, Estimate]
Truths: TypeAlias = Mapping[str, float]

COMBS: Final = ((0.002, 200.0, 0.003), (0.00076, 350.0, 0.008), (0.0024, 800.0, 0.004))
"""Spacing in m, frequency in Hz and decay time in s of each comb."""
GRITS: Final = ((160.0, 210.0), (250.0, 280.0), (120.0, 170.0))
"""Peak and mean frequency in Hz of each texture."""
SKINS: Final = ((0.002, 500.0), (0.005, 300.0))
"""Rupture depth in m and stiffness in N/m of each membrane."""
SEED: Final = 1
SPEEDS: Final = (0.05, 0.15)
FORCES: Final = (0.6, 2.0)


@dataclass(frozen=True, slots=True)
class Coverage:
    """The errors of one fitted quantity over many sets of recordings."""

    kind: str
    figure: str
    sets: int
    median_error: float
    """Median of the absolute relative error."""
    bias: float
    """Median of the signed relative error."""
    covered: float
    """Fraction of the intervals that contain the truth."""

    @property
    def standard_error(self) -> float:
        """Standard error of `covered` for a true coverage of 95 %."""
        return math.sqrt(0.95 * 0.05 / self.sets)


def fitted(point: SweepPoint) -> str:
    """Fit the set of a point of studies/fit_strokes.yaml; return [value, low, high, truth] by quantity, as JSON."""
    index = point.parameters["set"]
    ((figures, truths),) = _SETS[point.parameters["kind"]](range(index, index + 1), SEED)
    return json.dumps({name: [found.value, found.low, found.high, truths[name]] for name, found in figures.items()})


def coverage(kind: str, sets: Sequence[Mapping[str, Sequence[float]]]) -> Iterator[Coverage]:
    """Yield the coverage of each quantity. Each set maps its quantities to [value, low, high, truth]."""
    for name in dict.fromkeys(name for each in sets for name in each):
        found = [each[name] for each in sets if name in each]
        errors = [value / truth - 1 for value, _, _, truth in found]
        covered = [low <= truth <= high for _, low, high, truth in found]
        yield Coverage(
            kind, name, len(found), float(np.median(np.abs(errors))), float(np.median(errors)), float(np.mean(covered))
        )


def table(client: Any, options: Options, progress: Callable[[float], None]) -> Table:
    """Return the table of few sets, since grooves and punctures take a second or two for each."""
    quick: dict[str, Json] = {"parameters.kind": list(KINDS), "parameters.set": [0] * len(KINDS)}
    found: dict[str, list[dict[str, list[float]]]] = {}
    for row in swept(client, "fit_strokes", progress, quick if options.quick else None):
        found.setdefault(row["parameters.kind"], []).append(json.loads(row["figures"]))
    rows = [
        [
            each.kind,
            each.figure,
            f"{each.sets}",
            f"{100 * each.median_error:.3f}",
            f"{100 * each.covered:.0f}",
            f"{100 * each.standard_error:.0f}",
        ]
        for kind, sets in found.items()
        for each in coverage(kind, sets)
    ]
    return Table(
        "Strokes and punctures, each fitted to a set of synthetic recordings: coverage of the 95 % intervals, and its "
        "standard error for this number of fits, without peaks that are not resolved",
        ["kind", "figure", "fits", "median error, %", "coverage, %", "standard error, %"],
        rows,
    )


def _figures(fit: object, names: Mapping[str, float]) -> dict[str, Estimate]:
    """Return the figures with these names; the peak of a texture is absent if it is not resolved."""
    found = {name: getattr(fit, name) for name in names}
    if found.get("peak_hz", ...) is None:
        del found["peak_hz"]
    assert all(isinstance(each, Estimate) for each in found.values())
    return found


def _seeds(sets: Iterable[int], seed: int) -> Iterator[tuple[int, np.random.Generator]]:
    for each in sets:
        yield 1000 * each + 10_000_000 * seed, np.random.default_rng((seed, each))


def _places(random: np.random.Generator, count: int) -> list[tuple[float, float]]:
    """Return random pairs of speed and force. The first four are near the corners of SPEEDS and FORCES."""
    corners = [(0, 0), (0, 1), (1, 0), (1, 1)]
    found = []
    for k in range(count):
        slow, light = corners[k] if k < 4 else random.uniform(0, 1, 2)
        speed = SPEEDS[0] + slow * (SPEEDS[1] - SPEEDS[0])
        force = FORCES[0] + light * (FORCES[1] - FORCES[0])
        found.append((speed * random.uniform(0.9, 1.1), force * random.uniform(0.9, 1.1)))
    return found


def _grooves(sets: Iterable[int], seed: int) -> Iterator[tuple[Figures, Truths]]:
    for first, random in _seeds(sets, seed):
        spacing, frequency, decay = COMBS[first // 1000 % len(COMBS)]
        truths = {
            "spacing_m": spacing,
            "frequency_hz": frequency,
            "decay_time_s": decay,
            "velocity_gain_per_s": 1200.0,
            "force_gain_m_per_s2_per_n": 63.4,
        }
        ridges = {"kind": "grooves", "display": "vibration", "width_m": spacing / 4, **truths}
        material = _material(texture=ridges)
        # Slow enough for at least three cycles between grooves.
        slower = min(1.0, spacing * frequency / 4 / SPEEDS[1])
        strokes = [
            grooves(material, speed * slower, force, Stylus(seed=first + k), Hand(duration_s=0.8), 0.05)
            for k, (speed, force) in enumerate(_places(random, 4))
        ]
        yield _figures(fit_grooves(strokes), truths), truths


def _texture(sets: Iterable[int], seed: int) -> Iterator[tuple[Figures, Truths]]:
    for first, random in _seeds(sets, seed):
        peak, mean = GRITS[first // 1000 % len(GRITS)]
        truths = {"peak_hz": peak, "mean_hz": mean, "velocity_gain_per_s": 24.0, "force_gain_m_per_s2_per_n": 2.4}
        material = _material(texture={"kind": "stochastic", **truths})
        strokes = [
            texture(material, speed, force, Stylus(seed=first + k, tremor_m_per_s2=0.3), Hand(duration_s=5.0))
            for k, (speed, force) in enumerate(_places(random, 5))
        ]
        yield _figures(fit_texture(strokes), truths), truths


def _puncture(sets: Iterable[int], seed: int) -> Iterator[tuple[Figures, Truths]]:
    for first, random in _seeds(sets, seed):
        depth, stiffness = SKINS[first // 1000 % len(SKINS)]
        rupture = {
            "depth_m": depth,
            "amplitude_m_per_s2": 38.0,
            "frequency_hz": 1260 / (2 * math.pi),
            "decay_rate_per_s": 330.0,
        }
        truths = {**rupture, "stiffness_n_per_m": stiffness, "force_n": stiffness * depth}
        material = _material(stiffness, rupture=rupture)
        recordings: list[Recording] = [
            puncture(material, speed, Stylus(seed=first + k)) for k, speed in enumerate(random.uniform(0.03, 0.1, 6))
        ]
        yield _figures(fit_puncture(recordings), truths), truths


def _material(stiffness_n_per_m: float = 800.0, **keys: object) -> Material:
    return validate_materials({"truth": {"stiffness_n_per_m": stiffness_n_per_m, **keys}})["truth"]


_SETS: Final[Mapping[str, Callable[[Iterable[int], int], Iterator[tuple[Figures, Truths]]]]] = {
    "grooves": _grooves,
    "texture": _texture,
    "puncture": _puncture,
}
KINDS: Final = tuple(_SETS)
