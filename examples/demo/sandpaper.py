"""Sandpaper: RMS and spectrum of the noise along the surface, compared with the material's law.

The noise of each tick is divided by the RMS that the law states for the speed and the force of that tick, because both
change when periods are missed. Every limit is four standard deviations of the estimate. For a stroke of D seconds and
the one-sided spectrum S, the variance of the integral of phi(f) S(f) is the integral of phi^2 S^2, divided by D. With
11 s and a band of 440 Hz the standard deviation of RMS and mean frequency is 0.7 %. The peak of a wide spectrum is
flat, so its standard deviation is 3 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.table import Table

from examples.demo.marks import Marks
from examples.demo.perform import Floats, Recorded, stroking
from hapticd.base.core import Flag
from hapticd.config.materials import Material
from hapticd.config.texture import Stochastic
from hapticd.rendering.filter_design import power_spectrum, stochastic_filter

MATERIAL: Final = "sandpaper_100"
STROKES: Final = ((0.05, 1.0, 1), (0.1, 0.5, 3), (0.1, 1.5, 3), (0.2, 1.0, 5))
"""Speed in m/s, pressing force in N and number of passes of each stroke."""
HALF_STROKE_M: Final = 0.0645
PATH, PASSES = stroking(HALF_STROKE_M, STROKES)
MIN_STROKES: Final = len(STROKES)
MIN_TICKS: Final = 10_000
"""Minimum number of ticks of each stroke."""
SETTLING_S: Final = 0.06
"""Time after the start of a pass until the handle moves like the hand."""
LIMIT_DEVIATIONS: Final = 4.0
"""Limit of a difference, in standard deviations of the estimate."""
PEAK_DEVIATION: Final = 0.11
"""Relative standard deviation of the peak frequency in 1 s, from 60 seeded recordings. It falls as 1/sqrt(time)."""
SEGMENT_TICKS: Final = 1024
"""Length of a segment of Welch's method."""
PEAK_BELOW_HZ: Final = 1000.0
"""Upper end of the band in which two poles are fitted; higher frequencies do not change the peak."""


@dataclass(frozen=True, slots=True)
class Sanding:
    """Measurements of sections without a ramp, (n,)."""

    stroke: npt.NDArray[np.int64]
    """Index into STROKES."""
    ticks: npt.NDArray[np.int64]
    square: Floats
    """Mean square of the noise divided by its law's RMS."""
    spectrum: Floats
    """One-sided spectrum of the noise divided by its law's RMS in 1/Hz, up to half the rate, (n, frequencies)."""
    speed_m_per_s: Floats
    force_n: Floats

    def ticks_of_strokes(self) -> list[int]:
        return [int(self.ticks[self.stroke == number].sum()) for number in range(len(STROKES))]

    @property
    def count(self) -> int:
        """Number of strokes with at least MIN_TICKS ticks."""
        return sum(ticks >= MIN_TICKS for ticks in self.ticks_of_strokes())

    def mean_spectrum(self) -> Floats:
        return np.average(self.spectrum, axis=0, weights=self.ticks)


def measured(recorded: Recorded, material: Material) -> Sanding:
    """Measure the noise of every stroke as a sequence of ticks: a missed period leaves no gap in it.

    Ticks with a ramp or without contact, as after missed periods, are left out.
    """
    from scipy.signal import welch

    law = _stochastic(material)
    noise, force = recorded.vibration(0), recorded.samples["contact_force_n"][:, 1]
    speed: Floats = abs(recorded.samples["velocity_m_per_s"][:, 0])
    excluded = np.flatnonzero(recorded.flagged(Flag.RAMPING | Flag.SATURATED) | (force <= 0))
    found: list[tuple[int, int, float, Floats, float, float]] = []
    for number, begin_s, end_s in PASSES:
        begin, end = np.searchsorted(recorded.time_s, (begin_s + SETTLING_S, end_s)).tolist()
        edges = [begin - 1, *excluded[(excluded >= begin) & (excluded < end)].tolist(), end]
        for here in (slice(before + 1, after) for before, after in pairwise(edges) if after - before > SEGMENT_TICKS):
            over_law = noise[here] / _rms(law, speed[here], force[here])
            spectrum = welch(over_law, recorded.rate_hz, nperseg=SEGMENT_TICKS, detrend=False)[1]
            square = float(np.mean(over_law**2))
            found.append(
                (number, len(over_law), square, spectrum, float(speed[here].mean()), float(force[here].mean()))
            )
    columns = zip(*found, strict=True) if found else [()] * 3 + [np.empty((0, SEGMENT_TICKS // 2 + 1))] + [()] * 2
    stroke, ticks, *others = (np.array(column) for column in columns)
    return Sanding(stroke.astype(np.int64), ticks.astype(np.int64), *others)


def _stochastic(material: Material) -> Stochastic:
    assert isinstance(material.texture, Stochastic)
    return material.texture


def _rms(law: Stochastic, speed: Floats, force: Floats) -> Floats:
    return law.velocity_gain_per_s * speed + law.force_gain_m_per_s2_per_n * force


def peak_of(frequency_hz: Floats, spectrum: Floats, rate_hz: float) -> float:
    """Fit the peak of a two-pole spectrum by maximum likelihood: minimise the sum of P/S + ln S (Whittle 1953).

    1/S of two poles is a parabola in 4 sin^2(pi f/rate).
    """
    from scipy.optimize import minimize

    used = (frequency_hz > 0) & (frequency_hz <= PEAK_BELOW_HZ)
    power = spectrum[used] / spectrum[used].max()
    place = (np.sin(np.pi * frequency_hz[used] / rate_hz) / np.sin(np.pi * PEAK_BELOW_HZ / rate_hz)) ** 2
    powers = place[:, None] ** np.arange(3)
    start = np.linalg.lstsq(powers * power[:, None], np.ones(len(power)), rcond=None)[0]

    def objective(c: Floats) -> float:
        inverse = np.maximum(powers @ c, 1e-9)
        return float(np.sum(power * inverse - np.log(inverse)))

    c = minimize(objective, start, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000}).x
    peak = max(0.0, -c[1] / (2 * c[2])) * np.sin(np.pi * PEAK_BELOW_HZ / rate_hz) ** 2
    return float(np.arcsin(np.sqrt(peak)) * rate_hz / np.pi)


def table(found: Sanding, material: Material, rate_hz: float, marks: Marks) -> Table:
    """Return the table of each stroke and of all strokes together, without figures if there are too few ticks."""
    law = _stochastic(material)
    fine = np.arange(0.0, rate_hz / 2)
    asked = power_spectrum(stochastic_filter(law.peak_hz, law.mean_hz, rate_hz), fine, rate_hz)
    bandwidth_hz = float(asked.sum() ** 2 / (asked**2).sum())
    spread = float(np.sqrt((((fine - law.mean_hz) * asked) ** 2).sum()) / asked.sum()) / law.mean_hz
    rows = Table(
        title=f"Strokes over {MATERIAL}: noise in telemetry (limit: 4 standard deviations; the paper prints no figures)"
    )
    for heading in ("", "measured", "law, library", "residual", "limit"):
        rows.add_column(heading, justify="left" if heading == "" else "right")

    def row(what: str, measured: float, wanted: float, deviation: float, digits: int) -> None:
        limit = LIMIT_DEVIATIONS * deviation
        difference = marks.off(f"sandpaper: {what}", measured, wanted, limit)
        rows.add_row(what, f"{measured:.{digits}f}", f"{wanted:.{digits}f}", difference, f"{100 * limit:.1f}%")

    def rms_row(what: str, here: npt.NDArray[np.bool_], wanted: float, digits: int) -> None:
        over = float(np.sqrt(np.average(found.square[here], weights=found.ticks[here])))
        seconds = float(found.ticks[here].sum()) / rate_hz
        row(what, over * wanted, wanted, 0.5 / float(np.sqrt(seconds * bandwidth_hz)), digits)

    rows.add_row("strokes with enough samples", f"{found.count}", f"{MIN_STROKES}", "", "")
    if found.count < MIN_STROKES:
        return rows
    for number in range(len(STROKES)):
        here = found.stroke == number
        speed, force = (
            float(np.average(each[here], weights=found.ticks[here])) for each in (found.speed_m_per_s, found.force_n)
        )
        wanted = law.velocity_gain_per_s * speed + law.force_gain_m_per_s2_per_n * force
        rms_row(f"RMS at {speed:.3f} m/s, {force:.2f} N, m/s^2", here, wanted, 3)
    rms_row("RMS over the law's, all strokes", found.ticks > 0, 1.0, 4)
    spectrum = found.mean_spectrum()
    frequency = np.linspace(0.0, rate_hz / 2, len(spectrum))
    mean_hz = float(frequency @ spectrum / spectrum.sum())
    peak_hz = peak_of(frequency, spectrum, rate_hz)
    root_s = float(np.sqrt(found.ticks.sum() / rate_hz))
    row("mean frequency, Hz", mean_hz, law.mean_hz, spread / root_s, 1)
    row("peak frequency, Hz", peak_hz, law.peak_hz, PEAK_DEVIATION / root_s, 1)
    return rows
