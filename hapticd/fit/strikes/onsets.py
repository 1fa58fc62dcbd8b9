"""Where strikes are: steps of a mode's complex amplitude z, between windows on either side of a sample."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hapticd.analysis.statistics import FitError, Floats, Ints
from hapticd.config.modes import Mode
from hapticd.fit.strikes.free_ringing import Complexes

LEAST_STRIKES: Final = 8
MOST_STRIKES: Final = 2000
"""In one recording."""
FAINT: Final = 0.3
"""Steps smaller than this part of the strong ones are not strikes."""
WINDOW_CYCLES: Final = 1.25
"""Ringing on either side of a sample that is searched for a strike."""


def loudest_frequency(seen: Floats, rate_hz: float) -> float:
    """Where the mean spectrum of windows of 40 ms is largest, above 20 Hz."""
    length = min(len(seen), max(64, round(0.04 * rate_hz)))
    starts = range(0, len(seen) - length + 1, max(1, length // 2))
    window = np.hanning(length)
    bins = 8 * length
    power = np.zeros(bins // 2 + 1)
    for start in starts:
        part = seen[start : start + length]
        index = np.arange(length) - (length - 1) / 2
        slope = float(index @ part) / float(index @ index)
        power += np.abs(np.fft.rfft(window * (part - part.mean() - slope * index), bins)) ** 2
    frequency = np.fft.rfftfreq(bins, 1 / rate_hz)
    power[frequency < 20.0] = 0.0
    return float(frequency[int(np.argmax(power))])


def ringing_steps(seen: Floats, rate_hz: float, mode: Mode) -> Complexes:
    """By how much z differs between the windows after and before each sample."""
    length = max(6, round(WINDOW_CYCLES * rate_hz / mode.frequency_hz))
    count = len(seen)
    if count < 4 * length:
        raise FitError("a recording of a few cycles holds no grooves")
    pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
    taps = np.zeros(2 * length, dtype=np.complex128)
    for index, sign in ((np.arange(length), 1.0), (np.arange(-length, 0), -1.0)):
        ring = np.exp(pole * index / rate_hz)
        columns = np.stack([ring.imag, ring.real, np.ones(length)], axis=1)
        solve = np.linalg.pinv(columns)
        taps[index + length] += sign * (solve[0] + 1j * solve[1])
    bins = 1 << (count + 2 * length - 1).bit_length()
    spectrum = np.fft.fft(seen, bins)
    found = np.fft.ifft(spectrum * np.fft.fft(taps[::-1], bins))[length - 1 : length - 1 + count]
    found[:length] = 0
    found[count - length :] = 0
    return np.asarray(found)


def unit_strike(mode: Mode, rate_hz: float) -> Floats:
    """A strike of 1 in the middle of silence, as long as its ringing."""
    half = math.ceil(max(6 * mode.decay_time_s, 4 * WINDOW_CYCLES / mode.frequency_hz) * rate_hz)
    time = np.arange(-half, half + 1) / rate_hz
    ring = np.exp(-mode.decay_rate_per_s * np.maximum(time, 0.0)) * np.sin(mode.angular_frequency_rad_per_s * time)
    return np.asarray(np.where(time >= 0, ring, 0.0))


def pick_strikes(step: Floats, unit: Floats, noise: float, reach: int) -> Ints:
    """Where strikes are, in order: the largest step first, and what it makes of its neighbourhood taken away."""
    left = step.copy()
    middle = len(unit) // 2
    peak = float(unit[middle])
    free = np.ones(len(step), dtype=np.bool_)
    at: list[int] = []
    sizes: list[float] = []
    while len(at) < MOST_STRIKES:
        k = int(np.argmax(np.where(free, np.abs(left), 0.0)))
        size = float(left[k]) / peak
        # A knock or two must not hide strikes.
        strong = float(np.percentile(np.abs(sizes), 75)) if len(sizes) >= LEAST_STRIKES else 0.0
        if abs(size) <= max(FAINT * strong, min(4 * noise, 0.5 * strong)):
            break
        low, high = max(0, k - middle), min(len(left), k + middle + 1)
        left[low:high] -= size * unit[low - k + middle : high - k + middle]
        # What is left about a strike is the error of its time and of the mode.
        free[max(0, k - reach) : k + reach + 1] = False
        at.append(k)
        sizes.append(size)
    strong = float(np.percentile(np.abs(sizes), 75)) if sizes else 0.0
    return np.array(sorted(k for k, size in zip(at, sizes, strict=True) if abs(size) > FAINT * strong), dtype=np.int64)
