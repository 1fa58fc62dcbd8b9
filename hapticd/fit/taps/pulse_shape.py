"""The shape that pulses have in common: y_i(t) = a_i s(R (t - t_i)) + c_i, s the curve of hapticd.config.waveform.

The samples of s at the rate R are linear least squares for given amplitudes a_i, onsets t_i and offsets c_i; these are
least squares of each pulse for given s, linear in a_i and c_i, with t_i by search. Both by turns, from onsets at which
each pulse crosses a part of its peak. s is what the tick plays, so no error of an interpolation is left out. s is 0 at
both ends, and its largest magnitude is 1 and positive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Floats
from hapticd.config.waveform import Curve

TURNS: Final = 6
LARGE: Final = 0.6
"""Of the peak."""
SMOOTH: Final = 1e-4
"""Weight of the squares of second differences, over that of the samples: decides what no pulse sampled."""
ENOUGH: Final = 6
"""Samples that tell a noise."""
SHIFTS: Final = 9
"""Onsets that are tried at once."""
REFINED: Final = 4
"""So often around the best of them, each time over a quarter of the way."""


@dataclass(frozen=True, slots=True)
class Pulse:
    """The stretch of a recording that holds one contact, and where the contact begins, roughly."""

    recording: str
    begin_s: float
    """Of the stretch, on the recording's clock."""
    onset_s: float
    """After the beginning of the stretch."""
    speed_m_per_s: float
    rate_hz: float
    measured: Floats
    """(n,) in m/s^2."""

    def until(self, end_s: float) -> Pulse:
        """Without what comes so long after its beginning."""
        return replace(self, measured=self.measured[: max(2, math.ceil(end_s * self.rate_hz))])

    @property
    def noise_m_per_s2(self) -> float:
        """Before the contact; 0 where fewer than ENOUGH samples tell it."""
        first = math.floor(self.onset_s * self.rate_hz)
        return float(np.std(self.measured[:first])) if first >= ENOUGH else 0.0

    @property
    def since_s(self) -> Floats:
        """Times of the samples after the beginning of the stretch."""
        return np.arange(len(self.measured)) / self.rate_hz


@dataclass(frozen=True, slots=True)
class Placed:
    """A pulse by the shape."""

    amplitude: float
    offset: float
    onset_s: float
    """After the beginning of the stretch."""
    squares: float
    """Exclusion over."""

    def modelled(self, shape: Curve, pulse: Pulse) -> Floats:
        """(n,): the pulse by the shape."""
        return np.asarray(self.amplitude * shape.at(pulse.since_s - self.onset_s) + self.offset)


def explained(shape: Curve, pulse: Pulse, placed: Placed, noise_m_per_s2: float = 0.0) -> float:
    """Share of the variance about the offset that the shape explains while it lasts; what a noise makes of it is taken
    off."""
    since = pulse.since_s - placed.onset_s
    here = (since >= 0) & (since <= shape.length_s)
    above = pulse.measured[here] - placed.offset
    left = pulse.measured[here] - placed.modelled(shape, pulse)[here]
    noise = noise_m_per_s2**2 * len(left)
    heard = float(above @ above) - noise
    return min(1.0, 1.0 - (float(left @ left) - noise) / heard) if heard > 0 else 0.0


class Equations:
    """Normal equations of the samples 1 .. count - 2 of a shape, pulse by pulse."""

    def __init__(self, pulses: Sequence[Pulse], placed: Sequence[Placed], rate_hz: float, count: int) -> None:
        self._count, self._rate_hz = count, rate_hz
        self._own = [self._of(pulse, place) for pulse, place in zip(pulses, placed, strict=True)]
        self._gram = np.sum([gram for gram, _ in self._own], axis=0)
        self._side = np.sum([side for _, side in self._own], axis=0)
        self._smooth = self._second_differences()

    def _rows(self, pulse: Pulse, place: Placed) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], Floats, Floats]:
        """First samples (m,), weights of four samples from there (m, 4), and what was measured (m,)."""
        at = (pulse.since_s - place.onset_s) * self._rate_hz
        here = (at >= 0) & (at <= self._count - 1)
        k = np.minimum(np.floor(at[here]), self._count - 2).astype(np.intp)
        x = at[here] - k
        weights = 0.5 * np.column_stack(
            (
                x * (-1 + x * (2 - x)),
                2 + x * x * (3 * x - 5),
                x * (1 + x * (4 - 3 * x)),
                x * x * (x - 1),
            )
        )
        return k - 1, weights, pulse.measured[here] - place.offset

    def _of(self, pulse: Pulse, place: Placed) -> tuple[Floats, Floats]:
        """Bands (4, count - 2) of the gram, upper form, and the right side (count - 2,)."""
        first, weights, measured = self._rows(pulse, place)
        # Two places at each end are for what is 0 there.
        gram, side = np.zeros((4, self._count + 2)), np.zeros(self._count + 2)
        for one in range(4):
            np.add.at(side, first + 1 + one, place.amplitude * weights[:, one] * measured)
            for other in range(one, 4):
                square = place.amplitude**2 * weights[:, one] * weights[:, other]
                np.add.at(gram[3 - (other - one)], first + 1 + other, square)
        for band in range(4):  # nothing reaches over the ends
            gram[band, : 2 + 3 - band] = 0.0
        return gram[:, 2:-2], side[2:-2]

    def _second_differences(self) -> Floats:
        unknowns = self._count - 2
        bands = np.zeros((4, unknowns))
        bands[3], bands[2, 1:], bands[1, 2:] = 6.0, -4.0, 1.0
        bands[3, 0] = bands[3, -1] = 5.0
        return np.asarray(SMOOTH * float(np.mean(self._gram[3])) * bands)

    def solved(self, without: int | None = None) -> Floats:
        """Samples (count,), the first and the last 0; `without` one of the pulses."""
        from scipy.linalg import solveh_banded

        gram, side = self._gram, self._side
        if without is not None:
            gram, side = gram - self._own[without][0], side - self._own[without][1]
        # Where no other pulse was sampled, smoothness alone decides.
        gram = gram + self._smooth
        inner = solveh_banded(gram, side, check_finite=False)
        return np.concatenate(([0.0], np.asarray(inner, dtype=np.float64), [0.0]))

    def deviations(self, samples: Floats) -> Floats:
        """(count,): standard errors of the samples, of what differs between pulses (a sandwich of their sums)."""
        from scipy.linalg import solveh_banded

        unknowns = self._count - 2
        left = np.zeros((unknowns, len(self._own)))
        for index, (gram, side) in enumerate(self._own):
            left[:, index] = side - _times(gram, samples[1:-1])
        moved = solveh_banded(self._gram + self._smooth, left, check_finite=False)
        pulses = len(self._own)
        inner = np.sqrt(np.sum(moved**2, axis=1) * pulses / max(1, pulses - 1))
        return np.concatenate(([0.0], np.asarray(inner, dtype=np.float64), [0.0]))


def _times(bands: Floats, vector: Floats) -> Floats:
    """A symmetric matrix of upper bands (4, n) times a vector (n,)."""
    product = bands[3] * vector
    for off in range(1, 4):
        upper = bands[3 - off, off:]
        product[:-off] += upper * vector[off:]
        product[off:] += upper * vector[:-off]
    return np.asarray(product)


def place(shape: Curve, pulse: Pulse, near_s: float, reach_s: float) -> Placed:
    """The pulse by this shape, with its onset sought up to `reach_s` from `near_s`."""
    best: Placed | None = None
    middle_s = near_s
    for _ in range(REFINED):
        onsets = middle_s + np.linspace(-reach_s, reach_s, SHIFTS)
        curves = shape.at(pulse.since_s[None, :] - onsets[:, None])
        mean = curves.mean(axis=1, keepdims=True)
        level = float(pulse.measured.mean())
        centred, measured = curves - mean, pulse.measured - level
        size = np.maximum(np.sum(centred**2, axis=1), 1e-300)
        along = centred @ measured
        which = int(np.argmax(along**2 / size))
        amplitude = float(along[which] / size[which])
        found = Placed(
            amplitude,
            level - amplitude * float(mean[which, 0]),
            float(onsets[which]),
            float(measured @ measured) - float(along[which] ** 2 / size[which]),
        )
        if best is None or found.squares < best.squares:
            best = found
        middle_s, reach_s = best.onset_s, reach_s / 4
    assert best is not None
    return best


def upright(samples: Floats, rate_hz: float) -> tuple[Floats, Curve]:
    """The samples with a largest magnitude of the curve of 1, which is positive, and the curve."""
    curve = Curve(samples, rate_hz)
    largest = float(curve.at(curve.peak_time_s))
    scaled = samples / largest if largest else samples
    return scaled, Curve(scaled, rate_hz)


def common_shape(
    pulses: Sequence[Pulse], placed: Sequence[Placed], rate_hz: float, count: int, turns: int = TURNS
) -> tuple[Floats, list[Placed]]:
    """Samples (count,) of the shape at this rate, and the pulses by it; begun from where the pulses are `placed`."""
    found = list(placed)
    samples = np.zeros(count)
    reach_s = 2.0 / rate_hz
    for _ in range(turns):
        samples, shape = upright(Equations(pulses, found, rate_hz, count).solved(), rate_hz)
        found = [place(shape, pulse, where.onset_s, reach_s) for pulse, where in zip(pulses, found, strict=True)]
        # The shape may slide along its samples together with all onsets.
        slid = float(np.median([new.onset_s for new in found]) - np.median([old.onset_s for old in placed]))
        found = [replace(each, onset_s=each.onset_s - slid) for each in found]
        reach_s = max(reach_s / 2, 0.25 / rate_hz)
    samples, shape = upright(Equations(pulses, found, rate_hz, count).solved(), rate_hz)
    found = [place(shape, pulse, where.onset_s, reach_s) for pulse, where in zip(pulses, found, strict=True)]
    return samples, found


def crossing_s(pulse: Pulse, part: float) -> float:
    """When the pulse, on its way to its first large value, passes this part of its peak; after the beginning of the
    stretch."""
    size = np.abs(pulse.measured - rest_of(pulse))
    level, peak = part * float(size.max()), int(np.argmax(size >= LARGE * size.max()))
    below = np.flatnonzero(size[:peak] < level)
    if not len(below):
        return 0.0
    before = int(below[-1])
    low, high = float(size[before]), float(size[before + 1])
    return (before + (level - low) / (high - low)) / pulse.rate_hz


def rest_of(pulse: Pulse) -> float:
    """The acceleration before the contact."""
    first = max(1, math.floor(pulse.onset_s * pulse.rate_hz))
    return float(np.median(pulse.measured[:first]))
