"""Free ringing between strikes, fitted in all stretches at once.

Each stretch is Im(z exp((-B + i w) t)) beside a level and a slope. For given B and w, z and the drift of each stretch
are a separate linear fit (variable projection).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.recordings.spans import Bools
from hapticd.analysis.statistics import Floats, Ints
from hapticd.config.modes import Mode

Complexes: TypeAlias = npt.NDArray[np.complex128]


class FreeRinging:
    """Stretches of free ringing, side by side: arrays (stretches, samples), 0 beyond a stretch's end."""

    def __init__(
        self, seen: Floats, rate_hz: float, intervals: Sequence[tuple[int, int, float]], mode: Mode, least: int
    ) -> None:
        self.used: Ints = np.array(
            [k for k, (low, high, _) in enumerate(intervals) if high - low >= least], dtype=np.int64
        )
        low, high, onset = np.array([intervals[k] for k in self.used], dtype=np.float64).reshape(-1, 3).T
        count = high - low
        steps = np.arange(int(count.max(initial=0)))
        index = low[:, None] + steps
        self.held: Bools = index < high[:, None]
        self.index: Ints = np.where(self.held, index, low[:, None]).astype(np.int64)
        self._first_s = low / rate_hz - onset
        self._since_s = steps / rate_hz
        # A level takes a cycle to tell from the ringing, a slope two.
        cycles = count / rate_hz * mode.frequency_hz
        level = self.held / np.sqrt(count)[:, None] * (cycles > 0.9)[:, None]
        ramp = np.where(self.held, steps - (count[:, None] - 1) / 2, 0.0) * (cycles > 1.8)[:, None]
        ramp /= np.maximum(np.sqrt(np.sum(ramp**2, axis=1, keepdims=True)), 1e-300)
        self._drift = (level, ramp)
        self.flat: Floats = self._less_drift(np.where(self.held, seen[self.index], 0.0))

    def _less_drift(self, values: Floats) -> Floats:
        for column in self._drift:
            values = values - column * np.einsum("ij,ij->i", column, values)[:, None]
        return values

    def solved(self, mode: Mode) -> tuple[Complexes, Floats]:
        """z at each onset, and what the ringing leaves, (stretches, samples)."""
        pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
        turned = np.exp(pole * self._first_s)[:, None] * np.exp(pole * self._since_s) * self.held
        sine, cosine = self._less_drift(turned.imag), self._less_drift(turned.real)
        ss, cc, sc, sa, ca = (
            np.einsum("ij,ij->i", one, other)
            for one, other in (
                (sine, sine),
                (cosine, cosine),
                (sine, cosine),
                (sine, self.flat),
                (cosine, self.flat),
            )
        )
        # Where both columns say the same, the stretch says nothing.
        inverse = 1 / np.maximum(ss * cc - sc**2, 1e-12 * ss * cc + 1e-300)
        by_sine, by_cosine = inverse * (cc * sa - sc * ca), inverse * (ss * ca - sc * sa)
        left = self.flat - by_sine[:, None] * sine - by_cosine[:, None] * cosine
        return by_sine + 1j * by_cosine, left
