"""How far the probe must have been from a surface to tap it again: `device.rearm_m` for a noise and an encoder's step.

Noise is taken as Gaussian with standard deviation s, independent at each of r samples a second. A probe held m above a
surface taps falsely when one sample is h or more above it (it arms), and a later one is in it. Waiting for either takes
1/p samples on average, so that there are r / (1/Q((h - m)/s) + 1/Q(m/s)) false taps a second, Q the Gaussian tail. Most
are made half way, m = h/2:

    r Q(h / 2s) / 2   a second.

An encoder of step d rounds by at most d/2 at either end, so h is d larger. Without noise d alone is enough: a probe in
the surface at one step is less than d above it at the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt

DAY_S: Final = 86_400.0
LARGEST_M: Final = 0.01
"""The limit of device.rearm_m."""
WINDOW_S: Final = 0.05
"""What changes more slowly than in such a time is motion, not noise."""
_SAME: Final = 1e-9

Floats = npt.NDArray[np.float64]


def sigmas(rate_hz: float) -> float:
    """(h - d) / s for one false tap a day at most."""
    return -2.0 * NormalDist().inv_cdf(min(0.5, 2.0 / (rate_hz * DAY_S)))


def depth_m(noise_m: float, step_m: float, rate_hz: float) -> float:
    """The least rearm_m with at most one false tap a day, two figures, rounded up; at most LARGEST_M."""
    exact = min(step_m + sigmas(rate_hz) * noise_m, LARGEST_M)
    if exact < 1e-9:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(exact)) - 1)
    return float(f"{math.ceil(exact / unit * (1.0 - _SAME)) * unit:.2g}")


@dataclass(frozen=True, slots=True)
class Resting:
    """What the positions of a handle at rest do."""

    noise_m: float
    """Standard deviation; 0 where nothing but two neighbouring steps is seen."""
    step_m: float
    rate_hz: float

    @property
    def rearm_m(self) -> float:
        return depth_m(self.noise_m, self.step_m, self.rate_hz)

    def to_dict(self) -> dict[str, float]:
        """For programs."""
        return {"noise_m": self.noise_m, "step_m": self.step_m, "rearm_m": self.rearm_m}

    def __str__(self) -> str:
        if self.rearm_m == 0.0:
            return "positions at rest have neither noise nor steps: device.rearm_m may be 0"
        noise = f"{1e6 * self.noise_m:.2g} um of noise" if self.noise_m > 0.0 else "no noise beside it"
        return (
            f"positions at rest: step {1e6 * self.step_m:.3g} um, {noise}; with a rearm_m of {1e6 * self.rearm_m:.3g} "
            "um a hand at a surface makes less than one false tap a day"
        )


def at_rest(position_m: Floats, step_m: float, rate_hz: float) -> Resting:
    """Of positions (n,) at a rate, NaN where none was new, of a handle that nothing drives. Slow motion is taken away:
    a straight line over each WINDOW_S."""
    known = np.flatnonzero(~np.isnan(position_m))
    if len(known) == 0:
        return Resting(0.0, step_m, rate_hz)
    latest = np.maximum.accumulate(np.where(np.isnan(position_m), 0, np.arange(len(position_m))))[known[0] :]
    seen = position_m[latest]
    width = max(8, round(WINDOW_S * rate_hz))
    if len(seen) < width or np.ptp(seen) <= step_m * (1.0 + _SAME):
        return Resting(0.0, step_m, rate_hz)
    windows = seen[: len(seen) // width * width].reshape(-1, width)
    line = np.stack([np.ones(width), np.arange(width) - (width - 1) / 2.0])
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    left = windows - windows @ line.T @ line
    return Resting(float(np.sqrt(np.sum(left**2) / (len(windows) * (width - 2)))), step_m, rate_hz)


def words(rearm_m: float, step_m: float | None, rate_hz: float) -> str | None:
    """What `hapticd check` says; None where there is nothing to say. `step_m`: of the encoder, None if not known."""
    if rearm_m == 0.0:
        if step_m == 0.0:
            return None
        every = "a surface is tapped at every contact (device.rearm_m is 0): "
        if step_m is None:
            return every + "noise of positions there taps again and again; hapticd calibrate measures what stops it"
        return every + (
            f"a position that flickers by the encoder's step, {1e6 * step_m:g} um, taps each time; "
            f"rearm_m: {step_m:g} stops that, and hapticd calibrate measures what noise needs"
        )
    again = f"a surface is tapped again after the probe was {1e6 * rearm_m:g} um from it (device.rearm_m)"
    if step_m is None:
        return again
    if step_m > 0.0 and rearm_m < step_m * (1.0 - _SAME):
        return f"{again}: less than the encoder's step, {1e6 * step_m:g} um, so that a flicker by a step taps each time"
    noise_m = max(0.0, rearm_m - step_m) / sigmas(rate_hz)
    return f"{again}: noise of up to {1e6 * noise_m:.2g} um taps less than once a day"
