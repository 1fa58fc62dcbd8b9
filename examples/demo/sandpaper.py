"""Sandpaper: noise along the surface, its RMS and its spectrum against the law.

`hapticd.fit` finds RMS, gains and mean frequency, as it does from a recording of a real surface. Every limit is four
standard deviations of what noise of that spectrum gives in strokes of that length: with D seconds and the one-sided
spectrum S, a sum of phi(f) S(f) over the spectrum has the variance of phi^2 S^2, integrated, over D. 11 s of a band of
440 Hz leave 0.7 % to the RMS and to the mean frequency. The peak of a wide spectrum is flat, and so is known to 3 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.table import Table

from examples.demo.marks import Marks
from examples.demo.perform import Floats, Recorded, stroking
from hapticd.base.core import Flag
from hapticd.config.materials import Material
from hapticd.config.texture import Stochastic
from hapticd.fit.recording import Recording, Source
from hapticd.fit.texture import TextureFit, fit_texture
from hapticd.fit.texture_blocks import BLOCK_S
from hapticd.rendering.filter_design import power_spectrum, stochastic_filter

MATERIAL: Final = "sandpaper_100"
STROKES: Final = ((0.05, 1.0, 1), (0.1, 0.5, 3), (0.1, 1.5, 3), (0.2, 1.0, 5))
"""Each a speed, m/s, the force that is pressed with, N, and how often to or fro."""
HALF_STROKE_M: Final = 0.0645
PATH, WAYS = stroking(HALF_STROKE_M, STROKES)
WANTED_OF_STROKE: Final = 2
"""Blocks of half a second, at least."""
WANTED: Final = WANTED_OF_STROKE * len(STROKES)
MIN_PART_OF_SPEED: Final = 0.25
"""A block in which the handle is slower than this part of the stroke's speed does not count: missed periods held it."""
SETTLED_S: Final = 0.06
"""After the hand set off, or after the force came in over a ramp, the handle follows."""
LIMIT_DEVIATIONS: Final = 4.0
PEAK_DEVIATION: Final = 0.11
"""Standard deviation of the peak frequency, a part of it, times the root of the seconds; from 60 seeded recordings."""
SEGMENT_SAMPLES: Final = 1024
PEAK_BELOW_HZ: Final = 1000.0
"""Where two poles are fitted: beyond it there is nothing that could move a peak."""


@dataclass(frozen=True, slots=True)
class Sanding:
    """What was recorded: arrays (n, samples) of blocks of half a second, and (m,) of all noise over its law's RMS."""

    stroke: npt.NDArray[np.int64]
    """(n,) which of STROKES each block is of."""
    noise_m_per_s2: Floats
    speed_m_per_s: Floats
    force_n: Floats
    over_law: Floats

    @property
    def count(self) -> int:
        """Blocks, at most as many of each stroke as are wanted."""
        return int(np.minimum(np.bincount(self.stroke, minlength=len(STROKES)), WANTED_OF_STROKE).sum())


@dataclass(frozen=True, slots=True)
class Sanded:
    """What was measured; the spectrum is that of the noise over its law's RMS, 1/Hz, one-sided."""

    fit: TextureFit
    frequency_hz: Floats
    spectrum: Floats
    peak_hz: float


def measured(recorded: Recorded, material: Material) -> Sanding:
    """The noise of every stroke. It is a sequence of ticks: a missed period makes no gap in it."""
    law, rate_hz = _stochastic(material), recorded.rate_hz
    block, settling = round(BLOCK_S * rate_hz), round(SETTLED_S * rate_hz)
    moved, pressed = recorded.samples["velocity_m_per_s"][:, 0], recorded.samples["contact_force_n"][:, 1]
    every: Floats = np.array([recorded.vibration(0), abs(moved), pressed])
    ramped = np.flatnonzero(recorded.flagged(Flag.RAMPING | Flag.SATURATED))
    blocks: list[tuple[int, Floats]] = []
    over_law: list[Floats] = [np.empty(0)]
    for number, begin_s, end_s in WAYS:
        begin, end = np.searchsorted(recorded.time_s, (begin_s + SETTLED_S, end_s)).tolist()
        here = ramped[(ramped >= begin - settling) & (ramped < end)].tolist()
        for start, stop in zip([begin, *(max(begin, n + settling) for n in here)], [*here, end], strict=True):
            rows = every[:, start:stop]
            over_law.append(rows[0] / np.maximum(_rms(law, rows[1], rows[2]), 1e-9))
            parts = [rows[:, n : n + block] for n in range(0, stop - start - block + 1, block)]
            blocks += [(number, part) for part in parts if part[1].min() > MIN_PART_OF_SPEED * STROKES[number][0]]
    noise, speed, force = np.array([rows for _, rows in blocks]).reshape(-1, 3, block).swapaxes(0, 1)
    stroke = np.array([number for number, _ in blocks], dtype=np.int64)
    return Sanding(stroke, noise, speed, force, np.concatenate(over_law))


def fitted(found: Sanding, rate_hz: float) -> Sanded:
    """RMS over speed and force, and the spectrum by Welch's method. Raises FitError where it is no texture's."""
    from scipy.signal import welch

    fit = fit_texture(
        [
            Recording(f"{stroke}", rate_hz, noise, force, None, None, speed, Source("", ""))
            for stroke, noise, speed, force in zip(
                found.stroke.tolist(), found.noise_m_per_s2, found.speed_m_per_s, found.force_n, strict=True
            )
        ]
    )
    frequency, spectrum = welch(found.over_law, rate_hz, nperseg=SEGMENT_SAMPLES, detrend=False)
    return Sanded(fit, frequency, spectrum, peak_of(frequency, spectrum, rate_hz))


def _stochastic(material: Material) -> Stochastic:
    assert isinstance(material.texture, Stochastic)
    return material.texture


def _rms(law: Stochastic, speed: Floats, force: Floats) -> Floats:
    return law.velocity_gain_per_s * speed + law.force_gain_m_per_s2_per_n * force


def peak_of(frequency_hz: Floats, spectrum: Floats, rate_hz: float) -> float:
    """The peak of the two poles whose spectrum is the most likely: the sum of P/S + ln S is least (Whittle 1953).

    1/S of two poles is a parabola in 4 sin^2(pi f/rate).
    """
    from scipy.optimize import minimize

    used = (frequency_hz > 0) & (frequency_hz <= PEAK_BELOW_HZ)
    power = spectrum[used] / spectrum[used].max()
    place = (np.sin(np.pi * frequency_hz[used] / rate_hz) / np.sin(np.pi * PEAK_BELOW_HZ / rate_hz)) ** 2
    powers = place[:, None] ** np.arange(3)
    start = np.linalg.lstsq(powers * power[:, None], np.ones(len(power)), rcond=None)[0]

    def unlikely(c: Floats) -> float:
        inverse = np.maximum(powers @ c, 1e-9)
        return float(np.sum(power * inverse - np.log(inverse)))

    c = minimize(unlikely, start, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000}).x
    peak = max(0.0, -c[1] / (2 * c[2])) * np.sin(np.pi * PEAK_BELOW_HZ / rate_hz) ** 2
    return float(np.arcsin(np.sqrt(peak)) * rate_hz / np.pi)


def table(found: Sanded, material: Material, rate_hz: float, marks: Marks) -> Table:
    """A line for each stroke, then all of them together."""
    law, fit = _stochastic(material), found.fit
    fine = np.arange(0.0, rate_hz / 2)
    asked = power_spectrum(stochastic_filter(law.peak_hz, law.mean_hz, rate_hz), fine, rate_hz)
    bandwidth_hz = float(asked.sum() ** 2 / (asked**2).sum())
    spread = float(np.sqrt((((fine - law.mean_hz) * asked) ** 2).sum()) / asked.sum()) / law.mean_hz
    rows = Table(title=f"Strokes over {MATERIAL}: noise in telemetry (limit: four standard deviations)")
    for heading in ("", "measured", "law, library", "difference", "limit"):
        rows.add_column(heading, justify="left" if heading == "" else "right")

    def row(what: str, measured: float, wanted: float, deviation: float, digits: int) -> None:
        limit = LIMIT_DEVIATIONS * deviation
        difference = marks.off(f"sandpaper: {what}", measured, wanted, limit)
        rows.add_row(what, f"{measured:.{digits}f}", f"{wanted:.{digits}f}", difference, f"{100 * limit:.1f}%")

    speed, force, rms = np.array([(b.speed_m_per_s, b.force_n, b.rms_m_per_s2) for b in fit.blocks]).T
    wanted = _rms(law, speed, force)
    strokes = np.array([int(block.recording) for block in fit.blocks])
    for number in range(len(STROKES)):
        here = strokes == number
        marks.expect(bool(here.any()), f"sandpaper: stroke {number + 1} is no texture's")
        if here.any():
            what = f"RMS at {speed[here].mean():.3f} m/s, {force[here].mean():.2f} N, m/s^2"
            deviation = 0.5 / float(np.sqrt(here.sum() * BLOCK_S * bandwidth_hz))
            row(what, float(np.sqrt(np.mean(rms[here] ** 2))), float(wanted[here].mean()), deviation, 3)
    seconds = len(rms) * BLOCK_S
    over = float(np.sqrt(np.mean((rms / wanted) ** 2)))
    row("RMS over the law's, all strokes", over, 1.0, 0.5 / float(np.sqrt(seconds * bandwidth_hz)), 4)
    row("mean frequency, Hz", fit.mean_hz.value, law.mean_hz, spread / float(np.sqrt(seconds)), 1)
    row("peak frequency, Hz", found.peak_hz, law.peak_hz, PEAK_DEVIATION / float(np.sqrt(seconds)), 1)
    return rows
