"""Taps: the floor of a material is struck at many speeds, and the ringing of its mode fitted to the vibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table

from examples.demo.marks import Marks
from examples.demo.perform import HOVER_M, MASS_KG, Floats, Recorded
from hapticd.base.errors import HapticdError
from hapticd.config.materials import Material, Materials, Mode

SPEEDS_M_PER_S: Final = (0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.10, 0.11, 0.12, 0.13, 0.14, 0.15, 0.30)
PRESS_M: Final = 0.004
HOLD_S: Final = 0.08
UNSCALED: Final = 10
"""Taps that the force limit left whole, at least: what a slope is measured from."""


@dataclass(frozen=True, slots=True)
class Tap:
    """One strike of a mode and what telemetry told of it."""

    onset_s: float
    speed: float
    true_speed: float
    scale: float


@dataclass(frozen=True, slots=True)
class Fitted:
    """A mode fitted to recorded vibration; slopes in 1/s, from unscaled taps."""

    taps: tuple[Tap, ...]
    frequency_hz: float
    decay_time_s: float
    amplitudes: Floats
    slope_estimated: float
    slope_true: float
    used: int


def tapping(speeds: Sequence[float], x_m: float = 0.0) -> list[list[float]]:
    """Waypoints of a hand that taps the floor at y = 0 once at each speed, in straight lines."""
    now, path = 0.0, [[0.0, x_m, HOVER_M]]
    for speed in speeds:
        for height, lasting in (
            (HOVER_M, 0.06),
            (-PRESS_M, (HOVER_M + PRESS_M) / speed),
            (-PRESS_M, HOLD_S),
            (HOVER_M, 0.09),
        ):
            now += lasting
            path.append([now, x_m, height])
    return path


def fit(recorded: Recorded, guess: Mode) -> Fitted:
    """Frequency, decay and one amplitude a strike, by variable projection: the amplitudes are linear.

    Strikes closer together than a mode lasts share one ring-down, which ends with its last strike (as the model says),
    so each stretch of samples is fitted with all the strikes that sound in it. The slope is the regression of amplitude
    on speed through the origin, over strikes that the force limit did not scale.
    """
    from scipy.optimize import least_squares

    taps = tuple(
        Tap(recorded.onset_s(event), event["speed_m_per_s"], event["true_speed_m_per_s"], event["scale"])
        for event in recorded.events
        if event["event"] in ("contact", "puncture") and event["amplitude_m_per_s2"] > 0
    )
    onsets = np.array([tap.onset_s for tap in taps])
    vibration = recorded.samples["vibration_force_n"][:, 1] / MASS_KG
    # Only what the guess says sounds for sure: the cut itself is the model's, not what is measured.
    last = np.searchsorted(onsets, recorded.time_s, side="right") - 1
    since_last = np.where(last >= 0, recorded.time_s - onsets[np.maximum(last, 0)], np.inf)
    used = since_last <= 4.9 / guess.decay_rate_per_s
    times, wanted, last = recorded.time_s[used], vibration[used], last[used]
    gap = np.diff(onsets, prepend=-np.inf) > 5.0 / guess.decay_rate_per_s
    group = np.cumsum(gap)  # strikes that sound together

    def columns(parameters: Floats) -> Floats:
        omega, decay = parameters
        matrix = np.zeros((len(times), len(onsets)))
        for column, onset in enumerate(onsets):
            inside = (times >= onset) & (group[last] == group[column])
            t = times[inside] - onset
            matrix[inside, column] = np.exp(-decay * t) * np.sin(omega * t)
        return matrix

    def amplitudes(matrix: Floats) -> Floats:
        return np.asarray(np.linalg.lstsq(matrix, wanted, rcond=None)[0], dtype=np.float64)

    def residual(parameters: Floats) -> Floats:
        matrix = columns(parameters)
        return matrix @ amplitudes(matrix) - wanted

    # From a guess that is well off: what comes out is measured, not what went in.
    start = np.array([guess.angular_frequency_rad_per_s * 1.1, guess.decay_rate_per_s * 0.85])
    found = least_squares(residual, start, x_scale=start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    omega, decay = found.x
    strengths = amplitudes(columns(found.x))
    whole = np.array([tap.scale == 1.0 for tap in taps])
    if not whole.any():
        raise HapticdError("every tap was scaled down: there is no slope to measure; tap more slowly")

    def slope(speeds: Floats) -> float:
        return float(np.dot(speeds[whole], strengths[whole]) / np.dot(speeds[whole], speeds[whole]))

    return Fitted(
        taps=taps,
        frequency_hz=omega / (2 * np.pi),
        decay_time_s=1 / decay,
        amplitudes=strengths,
        slope_estimated=slope(np.array([tap.speed for tap in taps])),
        slope_true=slope(np.array([tap.true_speed for tap in taps])),
        used=int(whole.sum()),
    )


def fitted(recorded: Recorded, material: Material) -> Fitted:
    """The tap of a material as it was rendered."""
    assert material.tap is not None
    return fit(recorded, material.tap.mode)


def table(recorded: Mapping[str, Recorded], fits: Mapping[str, Fitted], library: Materials, marks: Marks) -> Table:
    """Each material: measured, and below it the library's and the difference."""
    rows = Table(title="Taps, fitted to telemetry (below: library, difference)", show_lines=True)
    for heading in ("material", "frequency Hz", "decay ms", "slope 1/s", "slope by true speed", "taps"):
        rows.add_column(heading, justify="left" if heading == "material" else "right")
    for name in recorded:
        tap, found = library[name].tap, fits[name]
        assert tap is not None
        mode, slope = tap.mode, tap.amplitude_m_per_s2(1.0)

        def cell(what: str, measured: float, wanted: float, digits: int, limit: float, name: str = name) -> str:
            difference = marks.off(f"{name}: {what}", measured, wanted, limit)
            return f"{measured:.{digits}f}\n{wanted:.{digits}f} {difference}"

        marks.expect(found.used >= UNSCALED, f"{name}: {found.used} unscaled taps, {UNSCALED} are wanted")
        scaled = len(found.taps) - found.used
        rows.add_row(
            name,
            cell("frequency", found.frequency_hz, mode.frequency_hz, 1, 0.01),
            cell("decay time", 1e3 * found.decay_time_s, 1e3 * mode.decay_time_s, 3, 0.01),
            cell("slope", found.slope_estimated, slope, 1, 0.01),
            cell("slope by true speed", found.slope_true, slope, 1, 0.03),
            f"{found.used}" + (f"\n+ {scaled} scaled" if scaled else ""),
        )
    return rows
