"""Synthetic recordings of a stylus with known parameters, to find out what a fit can resolve.

The waveforms are those of hapticd's models (Okamura, Dennerlein and Howe, 1998, eq. 1 to 3) in closed form, not those
of the renderer. The sensor is a linear system with poles, so its response to decaying sinusoids is a sum of
exponentials: it has no integration error, and onsets lie between samples. The noise of textures is not filtered by the
sensor, because it ends far below the frequencies of mounting and filter.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.recordings.sensor import Sensor
from hapticd.analysis.statistics import Floats
from hapticd.base.lattice import reflection_of
from hapticd.config.materials import Material, Tap
from hapticd.config.modes import Mode
from hapticd.config.texture import Autoregressive, AutoregressiveModel, Grooves, Stochastic
from hapticd.fit.recording import Recording, Source
from hapticd.rendering.filter_design import power_spectrum, stochastic_filter

SYNTHETIC_APPROACH_S: Final = 0.02
"""Duration of the approach at constant speed before a synthetic tap, and of the rest on the surface after the tap."""


@dataclass(frozen=True, slots=True)
class Stylus:
    """Stylus with a sensor: sampling, noise, mounting, filter, range and tremor."""

    rate_hz: float = 25_000.0
    noise_rms: float = 0.02
    """RMS of white noise, as a fraction of the largest acceleration of the recording."""
    mounting_hz: float | None = None
    """Resonance of the accelerometer on its mounting; None is a rigid mounting."""
    mounting_damping: float = 0.05
    """Damping of the mounting, as a fraction of critical damping."""
    filter_hz: float | None = None
    """Corner of a Butterworth low-pass filter; None means no filter."""
    filter_order: int = 2
    full_scale_m_per_s2: float = math.inf
    """Larger accelerations are clipped."""
    tremor_m_per_s2: float = 0.0
    """Amplitude of the hand's tremor."""
    tremor_hz: float = 9.0
    offset_m_per_s2: float = 9.80665
    drift_m_per_s3: float = 0.0
    position_step_m: float = 0.0
    """Resolution of the encoder; 0 is exact."""
    seed: int = 1

    @property
    def sensor(self) -> Sensor:
        """Mounting and filter as a sensor."""
        return Sensor(
            filter_hz=self.filter_hz,
            filter_order=self.filter_order,
            mounting_hz=self.mounting_hz,
            mounting_damping=self.mounting_damping,
        )

    def ringing(self, mode: Mode, time_s: Floats) -> Floats:
        """Return the sensor's response (n,) at times (n,) to a mode exp(-B t) sin(w t) that begins at t = 0."""
        pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
        response = np.zeros(len(time_s))
        after = time_s > 0
        response[after] = self.sensor.response(pole, time_s[after])[0].imag
        return response

    def recorded(self, clean: Floats, random: np.random.Generator) -> Floats:
        """Return the `clean` acceleration (n,) with offset, drift, tremor, noise and clipping."""
        time_s = np.arange(len(clean)) / self.rate_hz
        phase = random.uniform(0.0, 2 * math.pi)
        numbers = clean + self.offset_m_per_s2 + self.drift_m_per_s3 * time_s
        numbers += self.tremor_m_per_s2 * np.sin(2 * math.pi * self.tremor_hz * time_s + phase)
        numbers += self.noise_rms * float(np.abs(clean).max()) * random.standard_normal(len(clean))
        return np.clip(numbers, -self.full_scale_m_per_s2, self.full_scale_m_per_s2)


@dataclass(frozen=True, slots=True)
class TapTruth:
    """True parameters of synthetic taps."""

    slope_per_s: float
    """Slope of the coefficient A with speed, whichever `attack` the material has."""
    mode: Mode
    onsets_s: Floats


def taps(
    material: Tap,
    speeds_m_per_s: Sequence[float] | Floats,
    stylus: Stylus = Stylus(),
    spacing_s: float = 0.1,
) -> tuple[Recording, TapTruth]:
    """Return a recording with a tap at each speed, one every `spacing_s`, and the true parameters.

    The position is along the normal, 0 at the surface and negative in front of the surface. Raises ValueError for a
    material with `amplitudes`.
    """
    random = np.random.default_rng(stylus.seed)
    speeds = np.asarray(speeds_m_per_s, dtype=np.float64)
    mode, amplitude = material.mode, material.attack_slope_per_s
    if amplitude is None:
        raise ValueError("synthetic taps need a material with attack_slope_per_s, not with amplitudes")
    slope = amplitude * mode.coefficient(1.0, material.attack)
    samples = round(spacing_s * stylus.rate_hz)
    time_s = np.arange(samples * len(speeds)) / stylus.rate_hz
    onsets_s = spacing_s * (np.arange(len(speeds)) + random.uniform(0.3, 0.35, len(speeds)))
    clean, position = np.zeros((2, len(time_s)))
    for index, (speed, onset_s) in enumerate(zip(speeds, onsets_s, strict=True)):
        since = time_s[index * samples :] - onset_s
        clean[index * samples :] += slope * speed * stylus.ringing(mode, since)
        here = slice(index * samples, (index + 1) * samples)
        position[here] = _tap_position(time_s[here] - onset_s, float(speed))
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


def _tap_position(since_s: Floats, speed_m_per_s: float) -> Floats:
    """Return the stylus's position (n,), m: at rest, then to the surface at constant speed, at rest there, and back."""
    away_m = speed_m_per_s * SYNTHETIC_APPROACH_S
    return np.asarray(
        np.interp(
            since_s,
            [-SYNTHETIC_APPROACH_S, 0.0, SYNTHETIC_APPROACH_S, 2 * SYNTHETIC_APPROACH_S],
            [-away_m, 0.0, 0.0, -away_m],
        ),
        dtype=np.float64,
    )


# ---- Strokes and punctures by a hand that deviates from its target; the true parameters are those of the material ----


@dataclass(frozen=True, slots=True)
class Hand:
    """A hand's stroke: duration, sinusoidal variation of speed and force, and noise of force and position."""

    duration_s: float = 1.0
    speed_swing: float = 0.15
    """Amplitude of the variation, as a fraction of the mean; `force_swing` likewise."""
    force_swing: float = 0.15
    swing_hz: float = 0.7
    force_noise_n: float = 0.005
    position_noise_m: float = 2e-6


def grooves(
    material: Material,
    speed_m_per_s: float,
    force_n: float,
    stylus: Stylus = Stylus(),
    hand: Hand = Hand(),
    scatter: float = 0.0,
) -> Recording:
    """Return a recording of a stroke over a material with grooves displayed as vibration.

    `scatter` is the relative standard deviation of the amplitudes. Raises ValueError for other materials.
    """
    texture, mode = material.texture, material.groove_mode
    if not isinstance(texture, Grooves) or mode is None:
        raise ValueError("the texture of the material must be grooves with display: vibration")
    random = np.random.default_rng(stylus.seed)
    time, place, speed, force = _stroke(speed_m_per_s, force_n, stylus, hand, random)
    clean = np.zeros_like(time)
    rising = np.sign(speed_m_per_s) * place
    numbers = np.arange(math.ceil(rising[0] / texture.spacing_m), math.floor(rising[-1] / texture.spacing_m) + 1)
    for struck_s in np.interp(numbers * texture.spacing_m, rising, time):
        velocity, press = np.interp(struck_s, time, speed), np.interp(struck_s, time, force)
        amplitude = texture.velocity_gain_per_s * abs(velocity) + texture.force_gain_m_per_s2_per_n * press
        amplitude *= np.sign(velocity) * (1 + scatter * random.standard_normal())
        mode = material.groove_mode_at(float(velocity), float(press))
        assert mode is not None
        _strike(clean, time, float(struck_s), float(amplitude), mode, stylus)
    name = f"grooves at {abs(speed_m_per_s):g} m/s and {force_n:g} N"
    return _recorded(name, time, clean, force, None, place, hand, stylus, random)


def texture(
    material: Material,
    speed_m_per_s: float,
    force_n: float,
    stylus: Stylus = Stylus(),
    hand: Hand = Hand(),
) -> Recording:
    """Return a recording of a stroke over a material with a stochastic or an autoregressive texture.

    The spectrum is that of white noise times the root of the texture's density. Of autoregressive models the nearest in
    speed and force is used. Raises ValueError for other materials.
    """
    coarse = material.texture
    if not isinstance(coarse, Stochastic | Autoregressive):
        raise ValueError("the texture of the material must be stochastic or autoregressive")
    if isinstance(coarse, Autoregressive):
        # Level and spectrum must be those of one model, although the means of the stroke may be nearer to another.
        coarse = coarse.model_copy(update={"models": (_nearest(coarse, speed_m_per_s, force_n),)})
    random = np.random.default_rng(stylus.seed)
    time, place, speed, force = _stroke(speed_m_per_s, force_n, stylus, hand, random)
    count = len(time)
    frequency = np.asarray(np.fft.rfftfreq(count, 1 / stylus.rate_hz), dtype=np.float64)
    density = unit_density(coarse, speed_m_per_s, force_n, frequency, stylus.rate_hz)
    white = np.fft.rfft(random.standard_normal(count))
    clean = np.fft.irfft(white * np.sqrt(density * stylus.rate_hz / 2), count) * level_of(coarse, speed, force)
    name = f"texture at {abs(speed_m_per_s):g} m/s and {force_n:g} N"
    return _recorded(name, time, clean, force, None, place, hand, stylus, random)


def unit_density(
    texture: Stochastic | Autoregressive, speed_m_per_s: float, force_n: float, frequency: Floats, rate_hz: float
) -> Floats:
    """Return the one-sided power spectral density (n,), 1/Hz, of a texture with an RMS of 1, at `frequency` (n,), Hz.

    The density of an autoregressive texture is that of the model nearest in speed and force, and 0 above half the
    models' rate.
    """
    if isinstance(texture, Stochastic):
        return power_spectrum(stochastic_filter(texture.peak_hz, texture.mean_hz, rate_hz), frequency, rate_hz)
    reflection = reflection_of(_nearest(texture, speed_m_per_s, force_n).coefficients)
    below = frequency <= texture.rate_hz / 2
    density = np.zeros_like(frequency)
    density[below] = power_spectrum((reflection, None), frequency[below], texture.rate_hz)
    return density


def level_of(texture: Stochastic | Autoregressive, speed: Floats, force: Floats) -> Floats:
    """Return the RMS (n,), m/s^2, of a texture at speeds (n,), m/s, and forces (n,), N.

    The RMS of an autoregressive texture is that of the model nearest to the mean speed and force.
    """
    if isinstance(texture, Autoregressive):
        model = _nearest(texture, float(np.mean(speed)), float(np.mean(force)))
        return np.full(len(speed), model.level(reflection_of(model.coefficients)))
    level = texture.velocity_gain_per_s * np.abs(speed) + texture.force_gain_m_per_s2_per_n * force
    return np.maximum(level, 0.0) * np.minimum(1.0, np.abs(speed) / texture.threshold_m_per_s)


def _nearest(texture: Autoregressive, speed_m_per_s: float, force_n: float) -> AutoregressiveModel:
    def distance(model: AutoregressiveModel) -> float:
        by_speed = abs(model.speed_m_per_s - abs(speed_m_per_s)) / max(abs(speed_m_per_s), 1e-9)
        return by_speed + abs(model.force_n - force_n) / max(abs(force_n), 1e-9)

    return min(texture.models, key=distance)


def puncture(
    material: Material,
    speed_m_per_s: float,
    stylus: Stylus = Stylus(),
    hand: Hand = Hand(),
    ruptures: bool = True,
) -> Recording:
    """Return a recording of a puncture; if not `ruptures`, the stylus is withdrawn before the rupture.

    The position is along the normal, pressing positive. Raises ValueError for a material without a rupture.
    """
    rupture = material.rupture
    if rupture is None:
        raise ValueError("the material must have a rupture")
    random = np.random.default_rng(stylus.seed)
    depth = rupture.rupture_depth_m
    gap = 0.3 * depth + 0.1 * depth * random.random()
    after_s = max(8 * rupture.mode.decay_time_s, 0.05)
    deepest = depth if ruptures else 0.8 * depth
    struck_s = (gap + deepest) / speed_m_per_s
    time = np.arange(round((struck_s + after_s) * stylus.rate_hz)) / stylus.rate_hz
    place = speed_m_per_s * time - gap
    clean = np.zeros_like(time)
    if ruptures:
        force = np.where(time < struck_s, material.stiffness_n_per_m * np.maximum(place, 0.0), 0.0)
        _strike(clean, time, struck_s, rupture.amplitude_m_per_s2, rupture.mode, stylus)
    else:
        place = deepest - np.abs(place - deepest)
        force = material.stiffness_n_per_m * np.maximum(place, 0.0)
    return _recorded(f"puncture at {speed_m_per_s:g} m/s", time, clean, force, place + 0.01, None, hand, stylus, random)


def _stroke(
    speed_m_per_s: float, force_n: float, stylus: Stylus, hand: Hand, random: np.random.Generator
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return time, position, speed and force (n,) of a stroke; speed and force vary sinusoidally about the targets."""
    time = np.arange(round(hand.duration_s * stylus.rate_hz)) / stylus.rate_hz
    one, other = random.uniform(0, 2 * math.pi, 2)
    turn = 2 * math.pi * hand.swing_hz
    speed = speed_m_per_s * (1 + hand.speed_swing * np.sin(turn * time + one))
    place = speed_m_per_s * (time + hand.speed_swing / turn * (math.cos(one) - np.cos(turn * time + one)))
    place = place + 0.01 * random.random()
    force = force_n * (1 + hand.force_swing * np.sin(1.37 * turn * time + other))
    return time, place, speed, force


def _strike(onto: Floats, time: Floats, struck_s: float, amplitude: float, mode: Mode, stylus: Stylus) -> None:
    """Add the sensor's response to a strike of `mode` at `struck_s`, for 14 decay times (to a millionth)."""
    low = math.ceil(struck_s * stylus.rate_hz)
    high = min(len(time), low + math.ceil(14 * mode.decay_time_s * stylus.rate_hz))
    onto[low:high] += amplitude * stylus.ringing(mode, time[low:high] - struck_s)


def _recorded(
    name: str,
    time: Floats,
    clean: Floats,
    force: Floats,
    position: Floats | None,
    tangential: Floats | None,
    hand: Hand,
    stylus: Stylus,
    random: np.random.Generator,
) -> Recording:
    count = len(time)
    acceleration = stylus.recorded(clean, random)

    def placed(values: Floats | None) -> Floats | None:
        if values is None:
            return None
        noisy = values + hand.position_noise_m * random.standard_normal(count)
        step = stylus.position_step_m
        return np.round(noisy / step) * step if step > 0 else noisy

    return Recording(
        name=name,
        rate_hz=stylus.rate_hz,
        acceleration_m_per_s2=acceleration,
        force_n=force + hand.force_noise_n * random.standard_normal(count),
        position_m=placed(position),
        tangential_position_m=placed(tangential),
        speed_m_per_s=None,
        source=Source(path=name, sha256=hashlib.sha256(acceleration.tobytes()).hexdigest()),
    )
