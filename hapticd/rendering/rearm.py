"""`device.rearm_m`, the withdrawal after which a surface can be tapped again, from noise and encoder step.

Noise is assumed Gaussian with standard deviation s, independent at each of r samples a second. A probe held at a
height m above a surface taps falsely if one sample is h or more above the surface, so that it can be tapped again, and
a later sample is below. Waiting for an event of probability p takes 1/p samples on average. So the rate of false taps
is r / (1/Q((h - m)/s) + 1/Q(m/s)) a second, with the Gaussian tail Q. It is highest half way, at m = h/2:

    r Q(h / 2s) / 2   a second.

An encoder of step d rounds by at most d/2 at either end, so h must be larger by d. Without noise, h = d is sufficient:
if the probe is below the surface at one step, it is less than d above the surface at the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt

SECONDS_PER_DAY: Final = 86_400.0
"""rearm_m allows at most one false tap a day."""
MAX_REARM_M: Final = 0.01
"""Upper limit of device.rearm_m."""
DETREND_WINDOW_S: Final = 0.05
"""Changes over longer times count as motion rather than noise."""
_RELATIVE_TOLERANCE: Final = 1e-9
"""Relative tolerance of comparisons of distances, against rounding."""

Floats = npt.NDArray[np.float64]


def rearm_sigmas(rate_hz: float) -> float:
    """Return the part of rearm_m for noise, in standard deviations of the noise, at one false tap a day or less."""
    return -2.0 * NormalDist().inv_cdf(min(0.5, 2.0 / (rate_hz * SECONDS_PER_DAY)))


def min_rearm_m(noise_m: float, step_m: float, rate_hz: float) -> float:
    """Return the smallest rearm_m with at most one false tap a day, rounded up to two digits, at most MAX_REARM_M."""
    exact = min(step_m + rearm_sigmas(rate_hz) * noise_m, MAX_REARM_M)
    if exact < 1e-9:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(exact)) - 1)
    return float(f"{math.ceil(exact / unit * (1.0 - _RELATIVE_TOLERANCE)) * unit:.2g}")


@dataclass(frozen=True, slots=True)
class Resting:
    """Noise and steps of the positions of a handle at rest."""

    noise_m: float
    """Standard deviation of the noise; 0 if the positions differ by at most one step."""
    step_m: float
    rate_hz: float

    @property
    def rearm_m(self) -> float:
        """The smallest device.rearm_m with at most one false tap a day for this noise and step."""
        return min_rearm_m(self.noise_m, self.step_m, self.rate_hz)

    def to_dict(self) -> dict[str, float]:
        """Return the values as a mapping for JSON."""
        return {"noise_m": self.noise_m, "step_m": self.step_m, "rearm_m": self.rearm_m}

    def __str__(self) -> str:
        if self.rearm_m == 0.0:
            return "positions at rest have neither noise nor steps: device.rearm_m may be 0"
        noise = f"{1e6 * self.noise_m:.2g} um of noise" if self.noise_m > 0.0 else "no other noise"
        return (
            f"positions at rest: step {1e6 * self.step_m:.3g} um, {noise}; with a rearm_m of {1e6 * self.rearm_m:.3g} "
            "um a hand at a surface makes less than one false tap a day"
        )


def at_rest(position_m: Floats, step_m: float, rate_hz: float) -> Resting:
    """Return noise and step of the positions (n,), one for each tick, of a handle that nothing drives.

    A tick without a new position has NaN. Slow motion is removed as a straight line over each DETREND_WINDOW_S.
    """
    known = np.flatnonzero(~np.isnan(position_m))
    if len(known) == 0:
        return Resting(0.0, step_m, rate_hz)
    latest = np.maximum.accumulate(np.where(np.isnan(position_m), 0, np.arange(len(position_m))))[known[0] :]
    seen = position_m[latest]
    width = max(8, round(DETREND_WINDOW_S * rate_hz))
    if len(seen) < width or np.ptp(seen) <= step_m * (1.0 + _RELATIVE_TOLERANCE):
        return Resting(0.0, step_m, rate_hz)
    windows = seen[: len(seen) // width * width].reshape(-1, width)
    line = np.stack([np.ones(width), np.arange(width) - (width - 1) / 2.0])
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    left = windows - windows @ line.T @ line
    return Resting(float(np.sqrt(np.sum(left**2) / (len(windows) * (width - 2)))), step_m, rate_hz)


def rearm_text(rearm_m: float, step_m: float | None, rate_hz: float, measurable: bool = True) -> str | None:
    """Return the sentence on device.rearm_m in `hapticd check`, None if not needed; `step_m` None: step unknown.

    `measurable` says whether `hapticd calibrate` can measure the noise. It cannot measure that of a recording.
    """
    if rearm_m == 0.0:
        if step_m == 0.0:
            return None
        every = "every contact taps the surface (device.rearm_m is 0): "
        if step_m is None:
            measures = "; hapticd calibrate measures the rearm_m against that" if measurable else ""
            return f"{every}noise of positions may tap repeatedly{measures}"
        return every + (
            f"a position that flickers by the encoder's step, {1e6 * step_m:g} um, taps each time; "
            f"rearm_m: {step_m:g} prevents that, and hapticd calibrate measures the value for noise"
        )
    again = f"a surface can be tapped again after the probe was {1e6 * rearm_m:g} um away from it (device.rearm_m)"
    if step_m is None:
        return again
    if step_m > 0.0 and rearm_m < step_m * (1.0 - _RELATIVE_TOLERANCE):
        return f"{again}: less than the encoder's step, {1e6 * step_m:g} um, so a flicker by a step taps each time"
    noise_m = max(0.0, rearm_m - step_m) / rearm_sigmas(rate_hz)
    return f"{again}: noise of up to {1e6 * noise_m:.2g} um taps less than once a day"
