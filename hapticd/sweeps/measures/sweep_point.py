"""The argument of a user's function. Its fields are a stable interface; later versions may add fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class SweepPoint:
    """One point of a sweep, the argument of a user's function."""

    config: dict[str, Any]
    """The configuration with this point's values, for `hapticd.render` and `hapticd.simulate`."""
    operator: dict[str, Any] | None
    """The operator, which is the motion of the hand, with this point's values; None if the study has none."""
    parameters: dict[str, Any]
    """`parameters` of the study, with this point's values."""
    duration_s: float | None
    """`duration_s` of the study; None if the run lasts as long as the operator's path."""
    rate_hz: float
    """Ticks per second."""
    samples: npt.NDArray[np.void] | None
    """The samples of the run, one for each tick, (n,) of `hapticd.SAMPLE_DTYPE`; None without a run."""
    truth: npt.NDArray[np.float64] | None
    """The true position in m and velocity in m/s of the handle at each tick, (n, 4); None without the closed loop."""
