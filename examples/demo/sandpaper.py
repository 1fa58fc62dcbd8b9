"""Sandpaper: noise along the surface, its RMS and its spectrum against the law.

Every limit is four standard deviations of what noise of that bandwidth gives in strokes of that length. With D seconds
and the one-sided spectrum S, a sum of phi(f) S(f) over the spectrum has the variance of phi^2 S^2, integrated, over D:
10 s of a band of 440 Hz leave 0.8 % to the RMS and to the mean frequency. The peak of a wide spectrum is flat, and so
is known to 4 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.table import Table

from examples.demo.marks import Marks
from examples.demo.perform import HOVER_M, MASS_KG, Floats, Recorded, hand_depth_m
from hapticd.base.errors import HapticdError
from hapticd.config.materials import Material
from hapticd.config.texture import Stochastic

MATERIAL: Final = "sandpaper_100"
STIFFNESS_N_PER_M: Final = 800.0
STROKES: Final = ((0.05, 1.0), (0.1, 0.5), (0.1, 1.5), (0.2, 1.0))
"""Each a speed, m/s, and the force that is pressed with, N."""
STROKED_S: Final = 2.8
"""How long the hand strokes at each of them, to and fro; a whole number of ways at every speed."""
HALF_M: Final = 0.035
REST_S: Final = 0.15
SETTLED_S: Final = 0.06
"""After the hand set off the handle follows."""
DEVIATIONS: Final = 4.0
SEGMENT: Final = 1024
LEAST_SEGMENTS: Final = 20
PEAK_BELOW_HZ: Final = 1000.0
"""Where two poles are fitted: beyond it there is nothing that could move a peak."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its standard deviation."""

    value: float
    deviation: float


@dataclass(frozen=True, slots=True)
class Stroked:
    """All strokes at one speed and press, while the handle moved steadily. RMS in m/s^2."""

    speed_m_per_s: float
    force_n: float
    lasting_s: float
    rms: float
    law_rms: float


@dataclass(frozen=True, slots=True)
class Sanding:
    """What was measured; the spectrum is that of the noise over its law's RMS, 1/Hz, one-sided."""

    strokes: tuple[Stroked, ...]
    bandwidth_hz: float
    frequency_hz: Floats
    spectrum: Floats
    rms_over_law: Estimate
    peak_hz: Estimate
    mean_hz: Estimate


def stroking() -> list[list[float]]:
    """Waypoints of a hand that strokes the floor at y = 0 to and fro."""
    return _path()[0]


def _path() -> tuple[list[list[float]], list[list[tuple[float, float]]]]:
    """The waypoints, and of each speed and press the times within which the handle moves steadily."""
    now, x = 0.5, -HALF_M
    path = [[0.3, x, HOVER_M], [now, x, -hand_depth_m(STROKES[0][1], STIFFNESS_N_PER_M)]]
    steady: list[list[tuple[float, float]]] = []
    for speed, press in STROKES:
        depth, lasting = hand_depth_m(press, STIFFNESS_N_PER_M), 2 * HALF_M / speed
        now += REST_S
        path.append([now, x, -depth])
        steady.append([])
        for _ in range(round(STROKED_S / lasting)):
            steady[-1].append((now + SETTLED_S, now + lasting))
            x, now = -x, now + lasting
            path.append([now, x, -depth])
    path += [[now + 0.2, x, HOVER_M], [now + 0.4, 0.0, HOVER_M]]
    return path, steady


def measured(recorded: Recorded, material: Material, rate_hz: float) -> Sanding:
    """RMS against the law with speed and force from telemetry, and the spectrum by Welch's method.

    The noise is a sequence of ticks: a missed period makes no gap in it.
    """
    law = _stochastic(material)
    noise = recorded.samples["vibration_force_n"][:, 0] / MASS_KG
    speed = abs(recorded.samples["velocity_m_per_s"][:, 0])
    force = recorded.samples["contact_force_n"][:, 1]
    loud = law.velocity_gain_per_s * speed + law.force_gain_m_per_s2_per_n * force
    rms = np.maximum(0.0, loud) * np.minimum(1.0, speed / law.threshold_m_per_s)
    pieces: list[Floats] = []
    strokes = []
    for windows in _path()[1]:
        inside = [(recorded.time_s > begin) & (recorded.time_s <= end) & (rms > 0) for begin, end in windows]
        pieces += [noise[each] / rms[each] for each in inside]
        here: npt.NDArray[np.bool_] = np.logical_or.reduce(inside)
        strokes.append(
            Stroked(
                speed_m_per_s=float(speed[here].mean()),
                force_n=float(force[here].mean()),
                lasting_s=int(here.sum()) / rate_hz,
                rms=float(np.sqrt(np.mean(noise[here] ** 2))),
                law_rms=float(np.sqrt(np.mean(rms[here] ** 2))),
            )
        )
    # Where many periods were missed, a stroke may be too short for a segment.
    pieces = [piece for piece in pieces if len(piece) >= SEGMENT]
    if not all(stroke.rms for stroke in strokes) or sum(map(len, pieces)) < LEAST_SEGMENTS * SEGMENT:
        raise HapticdError("the sandpaper was hardly stroked: there is no spectrum to measure")
    frequency, spectrum = _welch(pieces, rate_hz)
    step = float(frequency[1])
    lasting = sum(map(len, pieces)) / rate_hz
    power = float(spectrum.sum() * step)
    bandwidth = power**2 / float((spectrum**2).sum() * step)
    mean = float((frequency * spectrum).sum() * step / power)
    spread = float(np.sqrt(((frequency - mean) ** 2 * spectrum**2).sum() * step / lasting) / power)
    return Sanding(
        strokes=tuple(strokes),
        bandwidth_hz=bandwidth,
        frequency_hz=frequency,
        spectrum=spectrum,
        rms_over_law=Estimate(
            float(np.sqrt(np.mean(np.concatenate(pieces) ** 2))), 0.5 / float(np.sqrt(lasting * bandwidth))
        ),
        peak_hz=peak_of(frequency, spectrum, rate_hz, lasting),
        mean_hz=Estimate(mean, spread),
    )


def _stochastic(material: Material) -> Stochastic:
    assert isinstance(material.texture, Stochastic)
    return material.texture


def _welch(pieces: list[Floats], rate_hz: float) -> tuple[Floats, Floats]:
    """One spectrum of several stretches, each with the weight of its segments."""
    from scipy.signal import welch

    total, segments = np.zeros(SEGMENT // 2 + 1), 0
    for piece in pieces:
        count = 2 * (len(piece) // SEGMENT) - 1
        frequency, spectrum = welch(piece, rate_hz, nperseg=SEGMENT, detrend=False)
        total, segments = total + count * spectrum, segments + count
    return np.asarray(frequency), total / segments


def peak_of(frequency_hz: Floats, spectrum: Floats, rate_hz: float, lasting_s: float) -> Estimate:
    """The peak of the two poles that fit a spectrum best.

    1/S of two poles is a parabola in 4 sin^2(pi f/rate). Its coefficients are those of the greatest likelihood of a
    periodogram (Whittle 1953): the sum of P/S + ln S is least; Newton's steps from a linear fit. Its second derivatives
    give the deviation.
    """
    used = (frequency_hz > 0) & (frequency_hz <= PEAK_BELOW_HZ)
    f, power = frequency_hz[used], spectrum[used] / spectrum[used].max()
    scale = 4 * np.sin(np.pi * 0.25 * PEAK_BELOW_HZ / rate_hz) ** 2
    powers = (4 * np.sin(np.pi * f / rate_hz) ** 2 / scale)[:, None] ** np.arange(3)
    c = np.linalg.lstsq(powers * power[:, None], np.ones(len(f)), rcond=None)[0]
    for _ in range(20):
        inverse = powers @ c
        curvature = (powers / inverse[:, None] ** 2).T @ powers
        step = np.linalg.solve(curvature, powers.T @ (power - 1 / inverse))
        c -= step
        if abs(step).max() <= 1e-12 * abs(c).max():
            break
    place = -c[1] / (2 * c[2])
    slope = np.array([0.0, -1 / (2 * c[2]), c[1] / (2 * c[2] ** 2)])
    deviation = np.sqrt(slope @ np.linalg.solve(curvature * lasting_s * float(f[1] - f[0]), slope))

    def hertz(place: float) -> float:
        return float(np.arcsin(np.sqrt(max(0.0, place) * scale / 4)) * rate_hz / np.pi)

    return Estimate(hertz(place), (hertz(place + deviation) - hertz(place - deviation)) / 2)


def table(found: Sanding, material: Material, marks: Marks) -> Table:
    """A line for each speed and press, then all of them together."""
    law = _stochastic(material)
    rows = Table(title=f"Strokes over {MATERIAL}: noise in telemetry (limit: four standard deviations)")
    for heading in ("", "measured", "law, library", "difference", "limit"):
        rows.add_column(heading, justify="left" if heading == "" else "right")

    def row(what: str, measured: float, wanted: float, deviation: float, digits: int) -> None:
        limit = DEVIATIONS * deviation
        difference = marks.off(f"sandpaper: {what}", measured, wanted, limit)
        rows.add_row(what, f"{measured:.{digits}f}", f"{wanted:.{digits}f}", difference, f"{100 * limit:.1f}%")

    for stroke in found.strokes:
        what = f"RMS at {stroke.speed_m_per_s:.3f} m/s, {stroke.force_n:.2f} N, m/s^2"
        deviation = 0.5 / float(np.sqrt(stroke.lasting_s * found.bandwidth_hz))
        row(what, stroke.rms, stroke.law_rms, deviation, 3)
    row("RMS over the law's, all strokes", found.rms_over_law.value, 1.0, found.rms_over_law.deviation, 4)
    row("mean frequency, Hz", found.mean_hz.value, law.mean_hz, found.mean_hz.deviation / law.mean_hz, 1)
    row("peak frequency, Hz", found.peak_hz.value, law.peak_hz, found.peak_hz.deviation / law.peak_hz, 1)
    return rows
