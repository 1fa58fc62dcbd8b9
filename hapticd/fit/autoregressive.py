"""Autoregressive models of a texture, one at each pair of speed and force.

They come from the autocorrelation of the mean spectrum there (Levinson and Durbin), which makes them stable for any
spectrum; the order is that of the least corrected information criterion of Akaike (Hurvich and Tsai, 1989).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import FitError, Floats
from hapticd.base.lattice import coefficients_of
from hapticd.fit.spectral_distance import apart_db
from hapticd.rendering.filter_design import power_spectrum

SAME_PLACE: Final = 0.1
"""Strokes whose speeds and forces differ by less than this part are at one place of the autoregressive models."""
STEADY: Final = 0.5
"""A stroke whose speed and force vary by less than this part is at one place."""
MAX_ORDER: Final = 32
KEPT: Final = 0.995
"""Of the power lies below 0.4 of the rate of the autoregressive models."""


@dataclass(frozen=True, slots=True)
class ArModel:
    """At one speed and force: the model, and how far its spectrum is from the recorded one."""

    speed_m_per_s: float
    force_n: float
    coefficients: tuple[float, ...]
    rms_m_per_s2: float
    rms_error_db: float
    """RMS difference of the spectra, in bands, where the recorded one is within COMPARED_DB of its peak."""


def model_rate(frequency: Floats, shape: Floats, rate_hz: float) -> float:
    """A whole number of hertz, at most the recording's rate, 0.4 of which holds KEPT of the power."""
    below = np.cumsum(np.maximum(shape, 0.0))
    top = float(frequency[min(int(np.searchsorted(below, KEPT * below[-1])), len(frequency) - 1)])
    return min(rate_hz, 2 * float(frequency[-1]), float(math.ceil(max(top / 0.4, 100.0))))


def _steady(blocks: list[int], speed: Floats, force: Floats) -> list[list[int]]:
    """A recording whole where speed and force keep near their means, otherwise block by block."""
    spread = max(float(np.ptp(values[blocks]) / np.mean(values[blocks])) for values in (speed, force))
    return [blocks] if spread < STEADY else [[block] for block in blocks]


def models_of(
    frequency: Floats,
    density: Floats,
    speed: Floats,
    force: Floats,
    recordings: Sequence[list[int]],
    block_s: float,
    rate_hz: float,
) -> tuple[ArModel, ...]:
    """Of densities (blocks, frequencies) of blocks that last `block_s`, at their speeds and forces (blocks,);
    `recordings` are the blocks of each."""
    places: list[list[int]] = []
    for part in (part for each in recordings for part in _steady(each, speed, force)):
        v, f = float(np.mean(speed[part])), float(np.mean(force[part]))
        for place in places:
            if (
                abs(v / float(np.mean(speed[place])) - 1) < SAME_PLACE
                and abs(f / float(np.mean(force[place])) - 1) < SAME_PLACE
            ):
                place += part
                break
        else:
            places.append(part)
    kept = [place for place in places if len(place) >= 4]
    if not kept:
        raise FitError("no speed and force was held for 2 s: autoregressive models need steady strokes")
    return tuple(
        _model(frequency, density[place].mean(axis=0), float(speed[place].mean()), float(force[place].mean()),
                  len(place) * block_s, rate_hz)
        for place in kept
    )  # fmt: skip


def _model(
    frequency: Floats, density: Floats, speed: float, force: float, duration_s: float, rate_hz: float
) -> ArModel:
    below = frequency <= rate_hz / 2
    frequency = frequency[below]
    power = np.maximum(density[below], 1e-6 * density.max())
    weights = np.full(len(frequency), frequency[1])
    weights[-1] /= 2
    lags = np.arange(MAX_ORDER + 1)
    correlation = np.cos(2 * math.pi * np.outer(lags, frequency) / rate_hz) @ (power * weights)
    stages, errors = _levinson(correlation)
    count = duration_s * rate_hz
    criteria = [count * math.log(errors[p]) + 2 * (p + 1) * count / (count - p - 2) for p in range(1, MAX_ORDER + 1)]
    order = 1 + int(np.argmin(criteria))
    reflection = stages[:order]
    model = float(correlation[0]) * power_spectrum((reflection, None), frequency, rate_hz)
    return ArModel(
        speed,
        force,
        coefficients_of(reflection),
        math.sqrt(float(correlation[0])),
        apart_db(frequency, model, power),
    )


def _levinson(correlation: Floats) -> tuple[list[float], list[float]]:
    """Reflection coefficients k_1 .. k_p in the convention of hapticd.rendering.filter_design, and the errors E_0 ..
    E_p, relative."""
    forward = np.array([1.0])
    error = float(correlation[0])
    stages, errors = [], [1.0]
    for m in range(1, len(correlation)):
        k = -float(forward @ correlation[m:0:-1]) / error
        stages.append(k)
        padded = np.append(forward, 0.0)
        forward = padded + k * padded[::-1]
        error *= (1 - k) * (1 + k)
        errors.append(error / float(correlation[0]))
    return stages, errors
