"""A tap as a waveform: a short curve through samples, and what of it a rate can carry.

Q(t) = A s(t) for 0 <= t <= (n - 1)/rate, then 0, with A the amplitude of the tap (m/s^2) and s the curve through the
`samples` s_0 .. s_(n-1). Between sample k and the next, at the share x of the way, s is the cubic of Catmull and Rom:
it passes through both samples with the slopes (s_(k+1) - s_(k-1))/2 and (s_(k+2) - s_k)/2 per sample. Samples before
the first and after the last count as 0. The tick evaluates this curve (csrc/tick/hd_waveform.h).
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import Annotated, Final

import numpy as np
import numpy.typing as npt
from pydantic import Field, Strict

from hapticd.base.core import WAVE_PARTS, WAVE_SAMPLES
from hapticd.base.model import CheckedTogether, at_most
from hapticd.config.modes import Attack

Floats = npt.NDArray[np.float64]

LEAST_SAMPLES: Final = 3
MOST_SAMPLES: Final = WAVE_SAMPLES
LONGEST_S: Final = 0.1
_FINER: Final = 8
"""A spectrum is that of so many points between two samples: beyond, the curve has next to nothing."""

Sample = Annotated[float, Field(ge=-1e5, le=1e5)]


class Waveform(CheckedTogether):
    """The curve that a tap plays instead of ringing, as samples; it begins and ends at 0."""

    rate_hz: float = Field(ge=100, le=1e5, description="Samples a second.")
    samples: Annotated[tuple[Sample, ...], Strict(False), at_most(MOST_SAMPLES)] = Field(
        min_length=LEAST_SAMPLES,
        max_length=MOST_SAMPLES,
        description="The curve, as a multiple of the tap's amplitude, from the onset on; the first and the last are 0.",
    )

    def cross_faults(self) -> list[str]:
        faults = []
        for name, value in (("first", self.samples[0]), ("last", self.samples[-1])):
            if value != 0:
                faults.append(f"the {name} of the samples must be 0, so that the force does not jump; is {value:g}")
        if not any(self.samples):
            faults.append("needs a sample that is not 0")
        if self.length_s > LONGEST_S * (1 + 1e-9):
            faults.append(
                f"must last at most {LONGEST_S:g} s, lasts {self.length_s:.4g} s ({len(self.samples)} samples at "
                f"{self.rate_hz:g} Hz)"
            )
        return faults

    @property
    def length_s(self) -> float:
        """Time from the first sample to the last."""
        return (len(self.samples) - 1) / self.rate_hz

    @cached_property
    def curve(self) -> Curve:
        """The curve through the samples; what is found of it is kept with it."""
        return _curve(self.samples, self.rate_hz)

    def coefficient(self, amplitude: float, attack: Attack) -> float:
        """The A of Q(t) = A s(t) for an amplitude that means A itself, or the largest magnitude of Q."""
        return amplitude if attack == "coefficient" else amplitude / self.curve.peak


class Curve:
    """Cubics between samples."""

    def __init__(self, samples: npt.ArrayLike, rate_hz: float) -> None:
        """`samples` is (n,), n >= 2; `rate_hz` is samples a second."""
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
        """The curve at times since the onset, of any shape; 0 before the onset and after the last sample."""
        place = np.asarray(time_s, dtype=np.float64) * self.rate_hz
        last = len(self._begin)
        k = np.clip(np.floor(place), 0, last - 1).astype(np.intp)
        x = place - k
        value = self._begin[k] + x * (self._slope[k] + x * (self._square[k] + x * self._cube[k]))
        return np.asarray(np.where((place >= 0) & (place <= last), value, 0.0), dtype=np.float64)

    @cached_property
    def _peaks(self) -> tuple[Floats, Floats]:
        """Of each cubic: its largest magnitude, and the share of the way at which it is."""
        places = np.zeros((4, len(self._begin)))
        places[1] = 1.0
        with np.errstate(divide="ignore", invalid="ignore"):
            # b + 2 c x + 3 d x^2 = 0, by the form that loses no digits.
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
        """The largest magnitude."""
        return float(self._peaks[0].max())

    @property
    def peak_time_s(self) -> float:
        """Time of the largest magnitude since the onset."""
        values, places = self._peaks
        k = int(np.argmax(values))
        return (k + float(places[k])) / self.rate_hz

    @cached_property
    def middle_hz(self) -> float:
        """The frequency below which half of the energy lies."""
        frequency, below = _energy(self)
        return float(np.interp(0.5, below, frequency))

    def energy_above(self, frequency_hz: float) -> float:
        """Share of the energy above a frequency, 0 to 1."""
        known = self._above
        if known is None or known[0] != frequency_hz:
            known = self._above = frequency_hz, 1.0 - float(np.interp(frequency_hz, *_energy(self)))
        return known[1]

    def peaks_from(self, parts: int) -> Floats:
        """(parts,): the largest magnitude from the beginning of each of so many equal parts to the end, or a little
        more: of the cubic in which a part begins, the whole counts."""
        values = self._peaks[0]
        rest = np.maximum.accumulate(values[::-1])[::-1]
        first = np.floor(np.arange(parts) * len(values) / parts * (1 - 1e-12)).astype(np.intp)
        return np.asarray(rest[first], dtype=np.float64)

    def numbers(self) -> Floats:
        """As the core's table holds them: the samples, then the peaks of HD_WAVE_PARTS parts."""
        return np.concatenate((self._begin, [0.0], self.peaks_from(WAVE_PARTS)))


@lru_cache(maxsize=1024)
def _curve(samples: tuple[float, ...], rate_hz: float) -> Curve:
    """One curve of the same samples, whose material is changed again and again."""
    return Curve(samples, rate_hz)


@lru_cache(maxsize=1)
def _energy(curve: Curve) -> tuple[Floats, Floats]:
    """Frequencies in Hz, rising, and the share of the curve's energy up to each: up to 8 MiB, so that only what was
    found in them is kept."""
    rate = _FINER * curve.rate_hz
    count = round(curve.length_s * rate) + 1
    values = curve.at(np.arange(count) / rate)
    length = 1 << math.ceil(math.log2(max(4 * count, rate)))
    energy = np.abs(np.fft.rfft(values, length)) ** 2
    total = np.concatenate(([0.0], np.cumsum(energy[1:] + energy[:-1])))
    frequency: Floats = np.asarray(np.fft.rfftfreq(length, 1 / rate), dtype=np.float64)
    return frequency, np.asarray(total / total[-1], dtype=np.float64)
