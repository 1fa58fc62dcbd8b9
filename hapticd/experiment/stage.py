"""The interface of a stage, which renders trials: on a daemon, or offline by simulation."""

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
"""Samples as records of `hapticd.SAMPLE_DTYPE`, shape (n,)."""
Waypoints: TypeAlias = npt.NDArray[np.float64]
"""Waypoints as rows [t_s, x_m, y_m], shape (n, 3)."""


class ForcesLost(HapticdError):
    """A fault switched the forces off during a trial. The attempt does not count, and the trial may begin again."""


class ForcesStopped(HapticdError):
    """Another client switched the forces off during a trial. They stay off until the experimenter continues."""


@dataclass(frozen=True, slots=True)
class Reaction:
    """A reaction of a simulated hand to the samples that it feels."""

    noticed_s: Callable[[Samples], float | None]
    """Returns the time of the reaction to the samples felt until now, in s from the first sample, or None."""
    then: Callable[[float], Waypoints]
    """Returns the waypoints of a reaction at a time, in s from the first sample."""


@dataclass(frozen=True, slots=True)
class Motion:
    """The motion of a simulated hand: waypoints, joined by straight lines, and a reaction to what the hand feels."""

    waypoints: Waypoints
    reaction: Reaction | None = None


@dataclass(frozen=True, slots=True)
class Telemetry:
    """Samples and events of the last interval of a trial, while the forces were on. Events are mappings."""

    samples: Samples
    events: Sequence[Mapping[str, Any]]


class Stage(Protocol):
    """The renderer of a session's trials. Each method raises HapticdError if it fails."""

    def describe(self) -> dict[str, Json]:
        """Return version and device for session.json; of a daemon also configuration and real-time rights."""

    def check(self) -> None:
        """Check that a fault or another client has not switched the forces off.

        Raises ForcesLost after a fault, ForcesStopped if another client switched the forces off after `enable`, and
        another HapticdError if the stage is lost.
        """

    def arm(self, config: Config) -> None:
        """Fade the force out, then replace scene and materials at one tick, and clear the contact state.

        On return the forces are off.
        """

    def is_clear(self) -> bool:
        """Return whether the handle is outside every object of the armed scene, and in front of its membranes.

        Always true for a stage whose hand leaves the handle between motions.
        """

    def enable(self) -> None:
        """Restore ruptured membranes, and fade the force in. Raises HapticdError if the scene changed since `arm`."""

    def fade(self) -> None:
        """Fade the commanded force out, and return when it is zero."""

    def mark(self, text: str, data: Json) -> None:
        """Add a mark with this text and data to the telemetry. It carries an event code."""

    def recording(self, target: Path, notes: Mapping[str, Json]) -> AbstractContextManager[None]:
        """Record telemetry while the context lasts, into `target` if the stage keeps telemetry."""

    def move(self, motion: Motion) -> Samples:
        """Move the simulated hand, and return the samples of this motion. Raises HapticdError without such a hand."""

    def telemetry(self) -> Telemetry:
        """Return the telemetry of the last interval of the last recorded trial."""


def until(waypoints: Waypoints, time_s: float) -> Waypoints:
    """Return the waypoints before `time_s`, followed by the interpolated position at `time_s`."""
    times = waypoints[:, 0]
    before = waypoints[times < time_s]
    here = [time_s, *(float(np.interp(time_s, times, waypoints[:, axis])) for axis in (1, 2))]
    return np.vstack((before, here))
