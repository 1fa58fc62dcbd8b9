"""A tap as a waveform: a short curve through samples, its peaks and its spectrum.

Q(t) = A s(t) for 0 <= t <= (n - 1)/rate, then 0, with A the amplitude of the tap (m/s^2) and s the curve through the
`samples` s_0 .. s_(n-1). Between two samples k and k + 1, s is the cubic of Catmull and Rom: it passes through both
samples with the slopes (s_(k+1) - s_(k-1))/2 and (s_(k+2) - s_k)/2 per sample. Samples before the first and after the
last count as 0. The tick evaluates the same curve (csrc/tick/hd_waveform.h).
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import Annotated, Final

import numpy as np
import numpy.typing as npt
from pydantic import Field, Strict

from hapticd.base.core import MAX_WAVEFORM_SAMPLES, WAVEFORM_PARTS
from hapticd.base.model import CheckedTogether, at_most
from hapticd.config.modes import Attack

Floats = npt.NDArray[np.float64]

MIN_WAVEFORM_SAMPLES: Final = 3
"""Minimum number of samples: the first and the last are 0."""
MAX_WAVEFORM_LENGTH_S: Final = 0.1
"""Maximum length of a waveform."""
_SPECTRUM_OVERSAMPLING: Final = 8
"""Points of the curve per sample for the spectrum; above half their rate the curve has hardly any energy."""

Sample = Annotated[float, Field(ge=-1e5, le=1e5)]


class Waveform(CheckedTogether):
    """Waveform of a tap, as samples; it begins and ends at 0."""

    rate_hz: float = Field(ge=100, le=1e5, description="Sampling rate.")
    samples: Annotated[tuple[Sample, ...], Strict(False), at_most(MAX_WAVEFORM_SAMPLES)] = Field(
        min_length=MIN_WAVEFORM_SAMPLES,
        max_length=MAX_WAVEFORM_SAMPLES,
        description="Samples from the onset on, as multiples of the tap's amplitude; the first and the last are 0.",
    )

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        faults = []
        for name, value in (("first", self.samples[0]), ("last", self.samples[-1])):
            if value != 0:
                faults.append(f"the {name} of the samples must be 0, so that the force does not jump; is {value:g}")
        if not any(self.samples):
            faults.append("needs a sample that is not 0")
        if self.length_s > MAX_WAVEFORM_LENGTH_S * (1 + 1e-9):
            faults.append(
                f"must last at most {MAX_WAVEFORM_LENGTH_S:g} s, lasts {self.length_s:.4g} s "
                f"({len(self.samples)} samples at {self.rate_hz:g} Hz)"
            )
        return faults

    @property
    def length_s(self) -> float:
        """Time from the first sample to the last."""
        return (len(self.samples) - 1) / self.rate_hz

    @cached_property
    def curve(self) -> Curve:
        """The curve s(t) through the waveform's samples; the curve caches its peaks and energies."""
        return _curve(self.samples, self.rate_hz)

    def coefficient(self, amplitude: float, attack: Attack) -> float:
        """Return A of Q(t) = A s(t) for an amplitude that, depending on `attack`, is A or the maximum of |Q|."""
        return amplitude if attack == "coefficient" else amplitude / self.curve.peak


class Curve:
    """Curve of cubics through `samples`, shape (n,) with n >= 2, at `rate_hz` samples per second."""

    def __init__(self, samples: npt.ArrayLike, rate_hz: float) -> None:
        given = np.asarray(samples, dtype=np.float64)
        padded = np.concatenate(([0.0], given, [0.0]))
        before, begin, end, after = padded[:-3], padded[1:-2], padded[2:-1], padded[3:]
        self.rate_hz = rate_hz
        self.length_s = (len(given) - 1) / rate_hz
        self._begin: Floats = begin
        self._slope: Floats = 0.5 * (end - before)
        self._square: Floats = 0.5 * (2 * before - 5 * begin + 4 * end - after)
        self._cube: Floats = 0.5 * (3 * (begin - end) + after - before)
        self._above: tuple[float, float] | None = None

    def at(self, time_s: npt.ArrayLike) -> Floats:
        """Return the values of the curve at times since the onset, in s, of any shape; 0 outside the samples."""
        place = np.asarray(time_s, dtype=np.float64) * self.rate_hz
        last = len(self._begin)
        k = np.clip(np.floor(place), 0, last - 1).astype(np.intp)
        x = place - k
        value = self._begin[k] + x * (self._slope[k] + x * (self._square[k] + x * self._cube[k]))
        return np.asarray(np.where((place >= 0) & (place <= last), value, 0.0), dtype=np.float64)

    @cached_property
    def _peaks(self) -> tuple[Floats, Floats]:
        """Largest magnitude of each cubic between two samples, and its relative position between them, 0 to 1."""
        places = np.zeros((4, len(self._begin)))
        places[1] = 1.0
        with np.errstate(divide="ignore", invalid="ignore"):
            # b + 2 c x + 3 d x^2 = 0, in the form without cancellation.
            root = np.sqrt(self._square**2 - 3 * self._slope * self._cube)
            sum_ = -(self._square + np.copysign(root, self._square))
            places[2], places[3] = sum_ / (3 * self._cube), self._slope / sum_
        places = np.where((places > 0) & (places <= 1), places, 0.0)
        values = np.abs(self._begin + places * (self._slope + places * (self._square + places * self._cube)))
        which = np.argmax(values, axis=0)
        every = np.arange(len(which))
        peaks: Floats = np.asarray(values[which, every], dtype=np.float64)
        return peaks, np.asarray(places[which, every], dtype=np.float64)

    @property
    def peak(self) -> float:
        """Largest magnitude of the curve."""
        return float(self._peaks[0].max())

    @property
    def peak_time_s(self) -> float:
        """Time from the onset to the largest magnitude of the curve, in s."""
        values, places = self._peaks
        k = int(np.argmax(values))
        return (k + float(places[k])) / self.rate_hz

    @cached_property
    def middle_hz(self) -> float:
        """Frequency in Hz below which half of the curve's energy lies."""
        frequency, below = _energy(self)
        return float(np.interp(0.5, below, frequency))

    def energy_above(self, frequency_hz: float) -> float:
        """Return the fraction of the curve's energy above a frequency, 0 to 1."""
        known = self._above
        if known is None or known[0] != frequency_hz:
            known = self._above = frequency_hz, 1.0 - float(np.interp(frequency_hz, *_energy(self)))
        return known[1]

    def peaks_from(self, parts: int) -> Floats:
        """Return upper bounds of |s| from the start of each of `parts` equal parts of the curve to its end.

        The shape is (parts,). A cubic in which a part starts counts completely.
        """
        values = self._peaks[0]
        later_peaks = np.maximum.accumulate(values[::-1])[::-1]
        first = np.floor(np.arange(parts) * len(values) / parts * (1 - 1e-12)).astype(np.intp)
        return np.asarray(later_peaks[first], dtype=np.float64)

    def numbers(self) -> Floats:
        """Return the waveform's table for the C core: the samples, then the values of peaks_from(HD_WAVE_PARTS)."""
        return np.concatenate((self._begin, [0.0], self.peaks_from(WAVEFORM_PARTS)))


@lru_cache(maxsize=1024)
def _curve(samples: tuple[float, ...], rate_hz: float) -> Curve:
    """Return the curve of these samples, from a cache, since a material may be changed repeatedly."""
    return Curve(samples, rate_hz)


@lru_cache(maxsize=1)
def _energy(curve: Curve) -> tuple[Floats, Floats]:
    """Return frequencies in Hz, in rising order, and the fraction of the curve's energy up to each.

    The arrays take up to 8 MiB, so only those of one curve are cached.
    """
    rate = _SPECTRUM_OVERSAMPLING * curve.rate_hz
    count = round(curve.length_s * rate) + 1
    values = curve.at(np.arange(count) / rate)
    length = 1 << math.ceil(math.log2(max(4 * count, rate)))
    energy = np.abs(np.fft.rfft(values, length)) ** 2
    total = np.concatenate(([0.0], np.cumsum(energy[1:] + energy[:-1])))
    frequency: Floats = np.asarray(np.fft.rfftfreq(length, 1 / rate), dtype=np.float64)
    return frequency, np.asarray(total / total[-1], dtype=np.float64)
