"""Where trials are felt: what the runner needs of a daemon, or of the closed loop without one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.config.configuration import Config

Samples: TypeAlias = npt.NDArray[np.void]
"""(n,) records of `hapticd.SAMPLE_DTYPE`."""
Waypoints: TypeAlias = npt.NDArray[np.float64]
"""(n, 3) rows [t_s, x_m, y_m]."""


class ForcesLost(HapticdError):
    """A fault took the forces away: the attempt does not count, and may begin again."""


class ForcesStopped(HapticdError):
    """Somebody else switched the forces off: they stay off until the experimenter goes on."""


@dataclass(frozen=True, slots=True)
class Reaction:
    """What a simulated hand does once it has felt something."""

    noticed_s: Callable[[Samples], float | None]
    """The time since the first of these samples at which the hand begins to act on what it felt in them, s."""
    then: Callable[[float], Waypoints]
    """The waypoints from that time on."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What a simulated hand does: waypoints that are followed in straight lines, and what it reacts to."""

    waypoints: Waypoints
    reaction: Reaction | None = None


@dataclass(frozen=True, slots=True)
class Telemetry:
    """Samples and events, as maps, of the last interval of a trial while the forces were on."""

    samples: Samples
    events: Sequence[Mapping[str, Any]]


class Stage(Protocol):
    """Where trials are felt. Each method raises HapticdError where it cannot be done."""

    def describe(self) -> dict[str, Json]:
        """Version, device, calibration and rights, for the session's file."""

    def check(self) -> None:
        """Raises ForcesLost where a fault keeps the forces off, ForcesStopped where somebody else switched them off
        since `enable`, and another HapticdError where the stage is gone."""

    def arm(self, config: Config) -> None:
        """Fades the force out, then puts a scene and its materials in force at one tick and clears the contact state.

        When it returns, nothing of the scene before is felt any more, and the forces are still off.
        """

    def is_clear(self) -> bool:
        """Whether the handle is inside nothing of the scene that is armed, and behind no membrane of it. True where no
        hand waits between motions."""

    def enable(self) -> None:
        """Heals what was broken since `arm`, and brings the force in. Raises where the scene is not the one that was
        armed."""

    def fade(self) -> None:
        """Takes the force out, and returns once it is zero."""

    def mark(self, text: str, data: Json) -> None:
        """Leaves an event code in the telemetry."""

    def recording(self, target: Path, notes: Mapping[str, Json]) -> AbstractContextManager[None]:
        """Records telemetry into `target`, or into no file where the stage keeps none."""

    def move(self, motion: Motion) -> Samples:
        """Has the simulated hand go its way; what it felt. Raises where there is no simulated hand."""

    def telemetry(self) -> Telemetry:
        """Of the recording that ended last."""


def until(waypoints: Waypoints, time_s: float) -> Waypoints:
    """The waypoints before a time, and where the reference is at it."""
    times = waypoints[:, 0]
    before = waypoints[times < time_s]
    here = [time_s, *(float(np.interp(time_s, times, waypoints[:, axis])) for axis in (1, 2))]
    return np.vstack((before, here))
