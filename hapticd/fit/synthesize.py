"""Recordings as a stylus would make them, of surfaces whose truth is known: to see what a fit can resolve.

The waveforms are the paper's, eq. 1 and 3, in closed form; the renderer is not asked. What a sensor does to them is a
linear system with poles, so that its answer to decaying sinusoids is a sum of exponentials: there is no error of a
step, and an onset lies between samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.recordings.sensor import Sensor
from hapticd.analysis.statistics import Floats
from hapticd.config.materials import Tap
from hapticd.config.modes import Mode
from hapticd.fit.recording import Recording, Source

GRAVITY_M_PER_S2: Final = 9.80665
APPROACH_S: Final = 0.02
"""Before a tap the stylus comes so long at constant speed; as long it rests afterwards."""


@dataclass(frozen=True, slots=True)
class Stylus:
    """What lies between a surface and the numbers."""

    rate_hz: float = 25_000.0
    noise_rms: float = 0.02
    """White, as a part of the largest acceleration of the recording."""
    mounting_hz: float | None = None
    """Resonance of the accelerometer on its mounting; None is rigid."""
    mounting_damping: float = 0.05
    """Of that, as a part of critical damping."""
    filter_hz: float | None = None
    """Corner of a low-pass filter, Butterworth's; None without."""
    filter_order: int = 2
    full_scale_m_per_s2: float = math.inf
    """What is beyond is clipped."""
    tremor_m_per_s2: float = 0.0
    """Amplitude of the hand's tremor."""
    tremor_hz: float = 9.0
    offset_m_per_s2: float = GRAVITY_M_PER_S2
    drift_m_per_s3: float = 0.0
    position_step_m: float = 0.0
    """Of the encoder; 0 is exact."""
    seed: int = 1

    @property
    def sensor(self) -> Sensor:
        """Mounting and filter."""
        return Sensor(
            filter_hz=self.filter_hz,
            filter_order=self.filter_order,
            mounting_hz=self.mounting_hz,
            mounting_damping=self.mounting_damping,
        )

    def ringing(self, mode: Mode, time_s: Floats) -> Floats:
        """What comes of exp(-B t) sin(w t), t >= 0, at times (n,); 0 before."""
        pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
        heard = np.zeros(len(time_s))
        after = time_s > 0
        heard[after] = self.sensor.answer(pole, time_s[after])[0].imag
        return heard

    def recorded(self, clean: Floats, random: np.random.Generator) -> Floats:
        """With offset, drift, tremor, noise and clipping."""
        time_s = np.arange(len(clean)) / self.rate_hz
        phase = random.uniform(0.0, 2 * math.pi)
        numbers = clean + self.offset_m_per_s2 + self.drift_m_per_s3 * time_s
        numbers += self.tremor_m_per_s2 * np.sin(2 * math.pi * self.tremor_hz * time_s + phase)
        numbers += self.noise_rms * float(np.abs(clean).max()) * random.standard_normal(len(clean))
        return np.clip(numbers, -self.full_scale_m_per_s2, self.full_scale_m_per_s2)


@dataclass(frozen=True, slots=True)
class TapTruth:
    """What taps were made of."""

    slope_per_s: float
    """Of the coefficient, whatever the material's `attack` means."""
    mode: Mode
    onsets_s: Floats


def taps(
    material: Tap,
    speeds_m_per_s: Sequence[float] | Floats,
    stylus: Stylus = Stylus(),
    spacing_s: float = 0.1,
) -> tuple[Recording, TapTruth]:
    """One recording of a tap at each speed, `spacing_s` apart, and its truth.

    Position is along the normal, 0 at the surface and negative in front of it.
    """
    random = np.random.default_rng(stylus.seed)
    speeds = np.asarray(speeds_m_per_s, dtype=np.float64)
    mode, amplitude = material.mode, material.attack_slope_per_s
    if amplitude is None:
        raise ValueError("synthetic taps are of a slope, not of a table of amplitudes")
    slope = amplitude * mode.coefficient(1.0, material.attack)
    samples = round(spacing_s * stylus.rate_hz)
    time_s = np.arange(samples * len(speeds)) / stylus.rate_hz
    onsets_s = spacing_s * (np.arange(len(speeds)) + random.uniform(0.3, 0.35, len(speeds)))
    clean, position = np.zeros((2, len(time_s)))
    for index, (speed, onset_s) in enumerate(zip(speeds, onsets_s, strict=True)):
        since = time_s[index * samples :] - onset_s
        clean[index * samples :] += slope * speed * stylus.ringing(mode, since)
        here = slice(index * samples, (index + 1) * samples)
        position[here] = _way(time_s[here] - onset_s, float(speed))
    if stylus.position_step_m > 0:
        position = np.round(position / stylus.position_step_m) * stylus.position_step_m
    recording = Recording(
        name="synthetic taps",
        rate_hz=stylus.rate_hz,
        acceleration_m_per_s2=stylus.recorded(clean, random),
        force_n=None,
        position_m=position,
        tangential_position_m=None,
        speed_m_per_s=speeds,
        source=Source("synthetic", ""),
    )
    return recording, TapTruth(slope, mode, onsets_s)


def _way(since_s: Floats, speed_m_per_s: float) -> Floats:
    """At rest, then on at constant speed to the surface, at rest there, and back."""
    away_m = speed_m_per_s * APPROACH_S
    return np.asarray(
        np.interp(since_s, [-APPROACH_S, 0.0, APPROACH_S, 2 * APPROACH_S], [-away_m, 0.0, 0.0, -away_m]),
        dtype=np.float64,
    )
