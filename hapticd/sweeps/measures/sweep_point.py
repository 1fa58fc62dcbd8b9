"""What a user's function is given of a point. These names stay; others may be added."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class SweepPoint:
    """One point of a sweep, as a measure of a user's sees it."""

    config: dict[str, Any]
    """The configuration with this point's values, as a YAML file has it: for `hapticd.render`, `hapticd.simulate`."""
    operator: dict[str, Any] | None
    """What the hand does, with this point's values."""
    parameters: dict[str, Any]
    """`parameters` of the study, with this point's values."""
    duration_s: float | None
    """The study's; None: as long as the operator's way."""
    rate_hz: float
    """Ticks per second."""
    samples: npt.NDArray[np.void] | None
    """(n,) records of `hapticd.SAMPLE_DTYPE`, one a tick; None where the study runs nothing."""
    truth: npt.NDArray[np.float64] | None
    """(n, 4) the handle's own position, m, and velocity, m/s, at each tick; None without a closed loop."""
