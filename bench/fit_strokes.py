"""How far fits of grooves, textures and punctures are from the truth, and how often their intervals hold it.

Sets of synthetic recordings: 25 kHz, noise of 2 % of the largest acceleration, a hand that swings, an accelerometer
without a mounting or a filter of its own (what these do is a bias, told in docs/fit_strokes.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from bench.report import Options, Table
from hapticd.analysis.statistics import Estimate
from hapticd.config.materials import Material, validate_materials
from hapticd.fit.grooves import fit_grooves
from hapticd.fit.puncture import fit_puncture
from hapticd.fit.recording import Recording
from hapticd.fit.synthesize import Stylus
from hapticd.fit.synthesize_strokes import Hand, grooves, puncture, texture
from hapticd.fit.texture import fit_texture

Figures: TypeAlias = Mapping[str, Estimate]
Truths: TypeAlias = Mapping[str, float]

COMBS: Final = ((0.002, 200.0, 0.003), (0.00076, 350.0, 0.008), (0.0024, 800.0, 0.004))
"""Spacing, m, frequency, Hz, and decay time, s."""
GRITS: Final = ((160.0, 210.0), (250.0, 280.0), (120.0, 170.0))
"""Peak and mean, Hz."""
SKINS: Final = ((0.002, 500.0), (0.005, 300.0))
"""Depth, m, and stiffness, N/m."""
SPEEDS: Final = (0.05, 0.15)
FORCES: Final = (0.6, 2.0)


@dataclass(frozen=True, slots=True)
class Coverage:
    """Of one figure over many sets: median of the relative error, and how many intervals hold the truth."""

    kind: str
    figure: str
    sets: int
    median_error: float
    bias: float
    """Median of the signed relative error."""
    covered: float

    @property
    def binomial(self) -> float:
        """Standard error of `covered` if the chance is 95 %."""
        return math.sqrt(0.95 * 0.05 / self.sets)


def coverage_strokes(sets: int, seed: int, kind: str) -> tuple[Coverage, ...]:
    """Of `sets` sets of recordings; `kind` is grooves, texture or puncture."""
    errors: dict[str, list[float]] = {}
    covered: dict[str, list[bool]] = {}
    for figures, truths in _SETS[kind](sets, seed):
        for name, truth in truths.items():
            found = figures[name]
            errors.setdefault(name, []).append(found.value / truth - 1)
            covered.setdefault(name, []).append(found.low <= truth <= found.high)
    return tuple(
        Coverage(
            kind,
            name,
            len(values),
            float(np.median(np.abs(values))),
            float(np.median(values)),
            float(np.mean(covered[name])),
        )
        for name, values in errors.items()
    )


def table(options: Options) -> Table:
    """As `python -m bench fit` prints it: of few sets, as grooves and punctures take a second or two for each."""
    sets = {"grooves": options.few(4, 1), "texture": options.few(12, 1), "puncture": options.few(6, 1)}
    rows = [
        [
            each.kind,
            each.figure,
            f"{each.sets}",
            f"{100 * each.median_error:.3f}",
            f"{100 * each.covered:.0f}",
            f"{100 * each.binomial:.0f}",
        ]
        for kind, count in sets.items()
        for each in coverage_strokes(count, 1, kind)
    ]
    return Table(
        "Strokes and punctures: coverage of the 95 % intervals, beside the standard error of so few sets",
        ["kind", "figure", "sets", "median error, %", "coverage, %", "+-"],
        rows,
    )


def _figures(fit: object, names: Mapping[str, float]) -> dict[str, Estimate]:
    found = {name: getattr(fit, name) for name in names}
    assert all(isinstance(each, Estimate) for each in found.values())
    return found


def _seeds(sets: int, seed: int) -> Iterator[tuple[int, np.random.Generator]]:
    for each in range(sets):
        yield 1000 * each + 10_000_000 * seed, np.random.default_rng((seed, each))


def _places(random: np.random.Generator, count: int) -> list[tuple[float, float]]:
    """Speeds and forces at random, within SPEEDS and FORCES; the first four are slow and fast, light and hard."""
    corners = [(0, 0), (0, 1), (1, 0), (1, 1)]
    found = []
    for k in range(count):
        slow, light = corners[k] if k < 4 else random.uniform(0, 1, 2)
        speed = SPEEDS[0] + slow * (SPEEDS[1] - SPEEDS[0])
        force = FORCES[0] + light * (FORCES[1] - FORCES[0])
        found.append((speed * random.uniform(0.9, 1.1), force * random.uniform(0.9, 1.1)))
    return found


def _grooves(sets: int, seed: int) -> Iterator[tuple[Figures, Truths]]:
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
        # So slow that there are three cycles and more between grooves.
        slower = min(1.0, spacing * frequency / 4 / SPEEDS[1])
        strokes = [
            grooves(material, speed * slower, force, Stylus(seed=first + k), Hand(duration_s=0.8), 0.05)
            for k, (speed, force) in enumerate(_places(random, 4))
        ]
        yield _figures(fit_grooves(strokes), truths), truths


def _texture(sets: int, seed: int) -> Iterator[tuple[Figures, Truths]]:
    for first, random in _seeds(sets, seed):
        peak, mean = GRITS[first // 1000 % len(GRITS)]
        truths = {
            "peak_hz": peak,
            "mean_hz": mean,
            "velocity_gain_per_s": 24.0,
            "force_gain_m_per_s2_per_n": 2.4,
        }
        material = _material(texture={"kind": "stochastic", **truths})
        strokes = [
            texture(material, speed, force, Stylus(seed=first + k, tremor_m_per_s2=0.3), Hand(duration_s=5.0))
            for k, (speed, force) in enumerate(_places(random, 5))
        ]
        yield _figures(fit_texture(strokes), truths), truths


def _puncture(sets: int, seed: int) -> Iterator[tuple[Figures, Truths]]:
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


_SETS: Final[Mapping[str, Callable[[int, int], Iterator[tuple[Figures, Truths]]]]] = {
    "grooves": _grooves,
    "texture": _texture,
    "puncture": _puncture,
}
KINDS: Final = tuple(_SETS)
