"""Warnings of figures that no known material has, with the unit that they may have been written in.

The limits lie far outside the shipped materials and the published ones (docs/adr/0067), so that a value beyond them is
most likely in another unit. A value of 0 turns its part off, and is not reported.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hapticd.base.errors import Path, Problem, path_text
from hapticd.config.materials import Material, Tap
from hapticd.config.modes import Mode
from hapticd.config.scene import SceneObject
from hapticd.config.texture import Autoregressive, Grooves, Stochastic

MIN_STIFFNESS_N_PER_M: Final = 1.0
MAX_STIFFNESS_N_PER_M: Final = 1e5
MIN_FREQUENCY_HZ: Final = 15.0
MIN_AMPLITUDE_M_PER_S2: Final = 0.1
MAX_AMPLITUDE_M_PER_S2: Final = 3000.0
MAX_TAP_SPEED_M_PER_S: Final = 10.0


class ImplausibleValue(UserWarning):
    """A value is far outside of what is known: it may be in another unit, such as mm instead of m."""


@dataclass(frozen=True, slots=True)
class Range:
    """The plausible values of one quantity."""

    name: str
    low: float
    high: float
    unit: str
    other_unit: str
    """The unit that is mistaken for `unit` most often."""
    factor: float
    """Size of `other_unit` in `unit`."""
    highest_known: float = math.inf
    """A larger value is not proposed, although none is reported up to `high`."""
    exception: str = ""
    """Known materials that have values above `high`."""

    def problem(self, value: float) -> str | None:
        """Return the warning of a value outside the range, with the value that it would be if it is in `other_unit`."""
        if value == 0.0 or self.low <= value <= self.high or f"{value:g}" in (f"{self.low:g}", f"{self.high:g}"):
            return None
        compared, limit = ("below", self.low) if value < self.low else ("above", self.high)
        converted = value * self.factor
        known = self.low <= converted <= min(self.high, self.highest_known)
        hint = f"; if it is in {self.other_unit}, write {converted:g}" if known else ""
        but = f" but {self.exception}" if self.exception and value > self.high else ""
        return (
            f"a {self.name} of {value:g} {self.unit} is {compared} that of all known materials{but}, "
            f"{limit:g} {self.unit}{hint}"
        )


STIFFNESS_RANGE: Final = Range("stiffness", MIN_STIFFNESS_N_PER_M, MAX_STIFFNESS_N_PER_M, "N/m", "N/mm", 1e3)
DAMPING_RANGE: Final = Range("damping", 0.0, 200.0, "N s/m", "mN s/m", 1e-3)
# A frequency that is too high is silent or lowered, and reported as such (displayability.py).
FREQUENCY_RANGE: Final = Range("frequency", MIN_FREQUENCY_HZ, math.inf, "Hz", "kHz", 1e3, highest_known=5000.0)
# Bells ring for up to 8 s, and the decay times of taps in ms, taken as s, are from 0.3 to 10 s.
DECAY_TIME_RANGE: Final = Range("decay time", 3e-5, 2.0, "s", "ms", 1e-3, exception="bells")
SPACING_RANGE: Final = Range("groove spacing", 2e-5, 0.1, "m", "mm", 1e-3)
GROOVE_DEPTH_RANGE: Final = Range("groove depth", 1e-6, 0.01, "m", "mm", 1e-3)
RUPTURE_DEPTH_RANGE: Final = Range("rupture depth", 1e-5, 0.1, "m", "mm", 1e-3)
RUPTURE_AMPLITUDE_RANGE: Final = Range(
    "rupture amplitude", MIN_AMPLITUDE_M_PER_S2, MAX_AMPLITUDE_M_PER_S2, "m/s^2", "g", 9.80665
)
# At 0.1 m/s these slopes give the smallest and the largest amplitude of a rupture.
TAP_SLOPE_RANGE: Final = Range("slope", MIN_AMPLITUDE_M_PER_S2 / 0.1, MAX_AMPLITUDE_M_PER_S2 / 0.1, "1/s", "1/ms", 1e3)
TAP_SPEED_RANGE: Final = Range("tap speed", 0.0, MAX_TAP_SPEED_M_PER_S, "m/s", "mm/s", 1e-3)


def figure_warnings(name: str, material: Material) -> list[Problem]:
    """Return a warning for each figure of a material that no known material has."""
    return [
        Problem(path_text(("materials", name, *place)), problem)
        for place, problem in _material_problems(material)
        if problem is not None
    ]


def field_problem(item: SceneObject) -> tuple[str, str] | None:
    """Return key and problem of the first figure of a field that no known material has; None for other objects."""
    if item.kind != "spring" and item.kind != "viscous":
        return None
    figures = [("damping_n_s_per_m", DAMPING_RANGE.problem(item.damping_n_s_per_m))]
    if item.kind == "spring":
        figures.append(("stiffness_n_per_m", STIFFNESS_RANGE.problem(item.stiffness_n_per_m)))
    return next(((key, problem) for key, problem in figures if problem is not None), None)


def _material_problems(material: Material) -> Iterator[tuple[Path, str | None]]:
    """Yield path and problem of each figure of a material; the problem of a plausible figure is None."""
    yield ("stiffness_n_per_m",), STIFFNESS_RANGE.problem(material.stiffness_n_per_m)
    yield ("damping_n_s_per_m",), DAMPING_RANGE.problem(material.damping_n_s_per_m)
    if material.friction is not None:
        yield ("friction", "stiffness_n_per_m"), STIFFNESS_RANGE.problem(material.friction.stiffness_n_per_m)
    tap, rupture, texture = material.tap, material.rupture, material.texture
    if tap is not None:
        yield from _tap_problems(tap)
    if rupture is not None:
        yield from _mode_problems(("rupture",), rupture.mode)
        yield ("rupture", "amplitude_m_per_s2"), RUPTURE_AMPLITUDE_RANGE.problem(rupture.amplitude_m_per_s2)
        if rupture.depth_m is not None:
            yield ("rupture", "depth_m"), RUPTURE_DEPTH_RANGE.problem(rupture.depth_m)
    match texture:
        case Grooves():
            yield ("texture", "spacing_m"), SPACING_RANGE.problem(texture.spacing_m)
            if texture.depth_m is not None:
                yield ("texture", "depth_m"), GROOVE_DEPTH_RANGE.problem(texture.depth_m)
            if texture.damping_n_s_per_m is not None:
                yield ("texture", "damping_n_s_per_m"), DAMPING_RANGE.problem(texture.damping_n_s_per_m)
            for mode in texture.own_modes:
                yield from _mode_problems(("texture",), mode)
        case Stochastic():
            yield ("texture", "peak_hz"), FREQUENCY_RANGE.problem(texture.peak_hz)
            yield ("texture", "mean_hz"), FREQUENCY_RANGE.problem(texture.mean_hz)
        case Autoregressive() | None:
            pass  # fitted, never written by hand


def _tap_problems(tap: Tap) -> Iterator[tuple[Path, str | None]]:
    if tap.amplitudes is not None:
        yield ("tap", "amplitudes"), TAP_SPEED_RANGE.problem(tap.amplitudes[-1][0])
    for mode in tap.modes:
        yield from _mode_problems(("tap",), mode)
    if tap.second is not None:
        yield from _mode_problems(("tap", "second"), tap.second.mode)
    if tap.attack_slope_per_s is not None:
        yield ("tap", "attack_slope_per_s"), TAP_SLOPE_RANGE.problem(tap.attack_slope_per_s)


def _mode_problems(place: Path, mode: Mode) -> Iterator[tuple[Path, str | None]]:
    yield place, FREQUENCY_RANGE.problem(mode.frequency_hz)
    yield place, DECAY_TIME_RANGE.problem(mode.decay_time_s)
