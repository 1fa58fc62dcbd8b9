"""Strokes over a texture in blocks of half a second, each with its spectrum, speed and force.

What the sensor hisses is read off the top of the spectrum and taken away; below LOW_HZ, where a hand trembles, the
density goes on as it is just above, and where it sinks into the hiss it goes on falling as it does in the octave
before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import FitError, Floats
from hapticd.fit.invalid_samples import Cleaned
from hapticd.fit.recording_checks import acceleration_of, pressed
from hapticd.fit.spectrum_peak import LOW_HZ, smoothed
from hapticd.fit.stylus_motion import motion_of
from hapticd.fit.verdict import Doubts

BLOCK_S: Final = 0.5
CUT_OFF: Final = 0.05
"""Of the highest density, between 0.4 and 0.49 of the rate: more than that is a spectrum that goes on beyond it."""
FALLS: Final = 1.78
"""From 0.325 to 0.445 of the rate, the density of noise with two poles at low frequency, filtered at this very rate;
the samples of a continuous one fall by more."""
TONE_BINS: Final = 3
"""That hold half of the power are a tone."""
SPOILT: Final = 0.02
"""Of the samples of a block, replaced, and it does not count."""
KNOCK: Final = 15.0
"""Standard deviations of a block that noise does not reach."""
KNOCKED: Final = 0.1
"""Of the blocks of a recording; where more have knocks, they are part of the texture."""
SUNK: Final = 0.3
"""Of the hiss: a density below is not seen."""


@dataclass(frozen=True, slots=True)
class StrokeBlocks:
    """A recording in blocks: density (blocks, frequencies) in (m/s^2)^2/Hz, one-sided, without the sensor's."""

    name: str
    frequency_hz: Floats
    density: Floats
    speed: Floats
    force: Floats
    moments: Floats
    """(blocks, 3) means of the squares of speed and of force, and between them of their product."""
    floor: float
    lost: int
    """Blocks that do not count, as of `_spoilt`."""
    kept: Cleaned


def slices_of(cut: Sequence[StrokeBlocks]) -> Iterator[tuple[StrokeBlocks, slice]]:
    """Each with its blocks among all."""
    start = 0
    for each in cut:
        yield each, slice(start, start + len(each.density))
        start += len(each.density)


def blocks_of(kept: Cleaned, usual_hz: float, doubts: Doubts) -> StrokeBlocks:
    """A recording in blocks. FitError where its rate is another one, and where it is no texture."""
    recording = kept.recording
    if recording.rate_hz != usual_hz:
        raise FitError(
            f"{recording.name}: sampled at {recording.rate_hz:g} Hz, most others at {usual_hz:g} Hz: strokes of one "
            "texture need one rate"
        )
    rate_hz = recording.rate_hz
    seen, force = acceleration_of(recording), pressed(recording)
    speed = motion_of(recording, len(seen)).speed_m_per_s
    usual = float(np.median(np.abs(speed)))
    windows = _Windows(rate_hz)
    found, speeds, forces, moments = [], [], [], []
    spoilt = _spoilt(kept, seen, windows.block, doubts)
    for start in range(0, len(seen) - windows.block + 1, windows.block):
        here = slice(start, start + windows.block)
        if start in spoilt or np.abs(speed[here]).min() < 0.2 * usual or force[here].mean() <= 0:
            continue
        found.append(windows.periodogram(seen[here]))
        moved, press = np.abs(speed[here]), np.maximum(force[here], 0.0)
        speeds.append(windows.mean(moved))
        forces.append(windows.mean(press))
        moments.append([windows.mean(each) for each in (moved**2, moved * press, press**2)])
    if not found:
        raise FitError(f"{recording.name}: holds no half second of one stroke")
    frequency: Floats = np.asarray(np.fft.rfftfreq(windows.length, 1 / rate_hz), dtype=np.float64)
    density, floor = _without_hiss(recording.name, frequency, np.array(found, dtype=np.float64), rate_hz)
    _refuse_motion(recording.name, frequency, density.mean(axis=0))
    just = (frequency >= LOW_HZ) & (frequency < 2 * LOW_HZ)
    density[:, frequency < LOW_HZ] = density[:, just].mean(axis=1)[:, None]
    # A sum over the bins is then the integral from 0 on.
    density[:, 0] /= 2
    return StrokeBlocks(
        recording.name,
        frequency,
        density,
        np.array(speeds),
        np.array(forces),
        np.array(moments),
        floor,
        len(spoilt),
        kept,
    )


class _Windows:
    """Three windows of Hann's in each block: at both ends, and half-way over the first."""

    def __init__(self, rate_hz: float) -> None:
        self.block, self.length = round(BLOCK_S * rate_hz), round(BLOCK_S * rate_hz / 2)
        """Samples of a block, and of a window."""
        self._window = np.hanning(self.length + 1)[:-1]
        self._scale = 2 / (rate_hz * float(self._window @ self._window))
        self._firsts = (0, self.length // 2, self.block - self.length)
        weights = np.zeros(self.block)
        for first in self._firsts:
            weights[first : first + self.length] += self._window**2
        self._weights = weights / weights.sum()

    def periodogram(self, part: Floats) -> Floats:
        """(frequencies,) of a block, per Hz, one-sided."""
        power = np.zeros(self.length // 2 + 1)
        for first in self._firsts:
            piece = part[first : first + self.length]
            power += np.abs(np.fft.rfft(self._window * (piece - piece.mean()))) ** 2 * self._scale / 3
        return power

    def mean(self, values: Floats) -> float:
        """Of a block, as the power's is taken."""
        return float(self._weights @ values)


def _without_hiss(name: str, frequency: Floats, density: Floats, rate_hz: float) -> tuple[Floats, float]:
    """The density without the sensor's, and the sensor's. FitError where the spectrum does not end below half the
    rate."""
    hiss = (frequency > 0.4 * rate_hz) & (frequency < 0.49 * rate_hz)
    floor = float(np.mean(density[:, hiss]))
    if floor > CUT_OFF * float(density[:, (frequency >= LOW_HZ) & ~hiss].mean(axis=0).max(initial=0.0)):
        raise FitError(
            f"{name}: the spectrum goes on beyond half the rate of {rate_hz:g} Hz, or is the sensor's hiss "
            "alone: record at a higher rate, or with less noise"
        )
    # A texture's own density falls there, by FALLS at least; only what does not is the sensor's.
    nearer = float(np.mean(density[:, (frequency > 0.3 * rate_hz) & (frequency < 0.35 * rate_hz)]))
    floor = min(max(0.0, (FALLS * floor - nearer) / (FALLS - 1)), floor)
    return density - floor, floor


def _spoilt(kept: Cleaned, seen: Floats, block: int, doubts: Doubts) -> set[int]:
    """First samples of the blocks that do not count: much of them was not measured so, or something knocked."""
    starts = range(0, len(seen) - block + 1, block)
    lost = {start for start in starts if np.mean(kept.replaced[start : start + block]) > SPOILT}
    knocks = []
    for start in starts:
        part = np.abs(seen[start : start + block] - np.median(seen[start : start + block]))
        if part.max() > KNOCK * 1.4826 * np.median(part):
            knocks.append(start)
    # Where there are many, it is a texture of knocks.
    if 0 < len(knocks) <= max(1, KNOCKED * len(starts)):
        at = knocks[0] + int(np.argmax(np.abs(seen[knocks[0] : knocks[0] + block])))
        value = f"{seen[at]:.4g} m/s^2 at {at / kept.recording.rate_hz:.6g} s"
        doubts.warn(
            f"{kept.recording.name}: the acceleration of {value} is a knock: {len(knocks) * BLOCK_S:g} s about such "
            "are left out"
        )
        lost |= set(knocks)
    return lost


def _refuse_motion(name: str, frequency: Floats, density: Floats) -> None:
    """FitError where most of the power is the hand's, or tones."""
    low, whole = frequency < LOW_HZ, frequency >= LOW_HZ
    smooth = smoothed(density, 2)
    lowest = float(frequency[whole][np.argmax(smooth[whole])])
    if density[low].sum() > density[whole].sum() and lowest < 2 * LOW_HZ:
        raise FitError(
            f"{name}: most of it is below {LOW_HZ:g} Hz, and above it falls: a hand that moves, and no texture"
        )
    loudest = np.sort(density[whole])[-TONE_BINS:]
    if loudest.sum() > 0.5 * density[whole].sum():
        raise FitError(
            f"{name}: a tone at {frequency[whole][np.argmax(density[whole])]:.4g} Hz holds most of the power: hum, or "
            "something that rings, and no texture"
        )


def top_of(frequency: Floats, shape: Floats, floor: float) -> tuple[float, Tail | None]:
    """Where the mean spectrum sinks into what was taken away as the sensor's, and how it goes on from there."""
    smooth = smoothed(shape, max(1, round(25 / frequency[1])))
    peak = int(np.argmax(smooth))
    below = np.flatnonzero(smooth[peak:] < SUNK * floor)
    if floor <= 0 or len(below) == 0:
        return float(frequency[-1]), None
    top = float(frequency[peak + below[0]])
    last = (frequency > max(top / 2, float(frequency[peak]))) & (frequency <= top) & (smooth > 0)
    if np.count_nonzero(last) < 8:
        return top, None
    fall = -float(np.polyfit(np.log(frequency[last]), np.log(smooth[last]), 1)[0])
    # The power of what falls more slowly has no mean frequency.
    return top, Tail(top, max(fall, 2.5), float(frequency[-1])) if fall > 2 else None


@dataclass(frozen=True, slots=True)
class Tail:
    """Density beyond `top_hz`, up to half the rate: it falls as frequency^-fall, as in the octave before."""

    top_hz: float
    fall: float
    end_hz: float

    def moments(self, frequency: Floats, shape: Floats) -> tuple[float, float]:
        """Its power, and that times its mean frequency, in units of sums over `shape`."""
        last = frequency > self.top_hz / 2
        level = float(shape[last].sum() / np.sum((frequency[last] / self.top_hz) ** -self.fall)) / float(frequency[1])
        ratio = self.end_hz / self.top_hz
        power = self.top_hz * (1 - ratio ** (1 - self.fall)) / (self.fall - 1)
        first = self.top_hz**2 * (1 - ratio ** (2 - self.fall)) / (self.fall - 2)
        return level * power, level * first


def centroid_of(frequency: Floats, shape: Floats, tail: Tail | None) -> float:
    beyond, first = (0.0, 0.0) if tail is None else tail.moments(frequency, shape)
    return float((frequency @ shape + first) / (shape.sum() + beyond))
