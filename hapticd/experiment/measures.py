"""What is measured of a trial's motion, from its telemetry alone.

`samples` are (n,) records of `hapticd.SAMPLE_DTYPE`, `events` maps as in telemetry. Each measure is None where the
trial does not have it: a membrane that did not break has no overtravel.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base import wording
from hapticd.base.core import Flag
from hapticd.config.schema import unit_of

Samples: TypeAlias = npt.NDArray[np.void]
Events: TypeAlias = Sequence[Mapping[str, Any]]


class Plane(NamedTuple):
    """That of a membrane at rest."""

    center_m: tuple[float, float]
    normal: tuple[float, float]
    """Of length 1."""


Planes: TypeAlias = Mapping[str, Plane]
"""Of the membranes of a scene, by id."""

PATH_STEP_S: Final = 0.01
"""A path's length is that of the polygon through positions so far apart in time. A finer one would count each step of
the encoder as a way that the hand went."""

MOTION_MEASURES: Final = ("overtravel_m", "peak_force_n", "completion_s", "path_m")
_NAMES: Final = {
    "overtravel_m": "Overtravel",
    "peak_force_n": "Largest force",
    "completion_s": "Time",
    "path_m": "Path",
}
"""What participants read."""


def measure_text(name: str, value: float) -> str:
    """A measure as a participant reads it, `Overtravel: 3.2 mm.`"""
    return f"{_NAMES[name]}: {wording.si(value, unit_of(name) or '', 3)}."


def why_not_done(name: str, value: float | None) -> str | None:
    """Why a trial that is to give this measure was not done, as a participant reads it; None: it was."""
    if name == "overtravel_m" and value is None:
        return "No membrane broke. Push further, until it breaks."
    if name == "peak_force_n" and not value:
        return "No force was felt."
    return None


def measures_of(samples: Samples, events: Events, planes: Planes) -> dict[str, float | None]:
    """Every measure by its name; None: the trial does not have it."""
    return {
        "overtravel_m": overtravel_m(samples, events, planes),
        "peak_force_n": peak_force_n(samples),
        "completion_s": completion_s(samples),
        "path_m": path_m(samples),
    }


def overtravel_m(samples: Samples, events: Events, planes: Planes) -> float | None:
    """How far past the place of its rupture the hand went along the membrane's normal, in m, until the samples end.

    The place is interpolated between the two samples around `onset_time_ns` of the first event `puncture`. It lies on
    the side to which the membrane had given way, so it also says which way is past it: an estimated velocity would not,
    where the hand has just turned round.
    """
    rupture = next((event for event in events if event["event"] == "puncture" and event["object"] in planes), None)
    if rupture is None or len(samples) < 2:
        return None
    times = samples["time_ns"].astype(np.int64)
    plane = planes[str(rupture["object"])]
    height = (samples["position_m"] - np.array(plane.center_m)) @ np.array(plane.normal)
    onset_ns = int(rupture["onset_time_ns"])
    after = times >= onset_ns
    if not after.any() or onset_ns < times[0]:
        return None
    # Differences first: nanoseconds of a long uptime are no float64.
    place = float(np.interp(0.0, (times - onset_ns).astype(np.float64), height))
    return max(0.0, float(((height[after] - place) * np.sign(place)).max()))


def peak_force_n(samples: Samples) -> float | None:
    """The largest magnitude of the commanded force, in N."""
    return float(np.hypot(*samples["force_n"].T).max()) if len(samples) else None


def completion_s(samples: Samples) -> float | None:
    """From the first to the last sample with the forces on, in s."""
    on = np.flatnonzero(samples["flags"] & Flag.FORCES_ON)
    if len(on) == 0:
        return None
    times = samples["time_ns"].astype(np.int64)
    return float(times[on[-1]] - times[on[0]]) / 1e9


def path_m(samples: Samples) -> float | None:
    """How far the handle went, in m: through positions PATH_STEP_S apart."""
    if len(samples) == 0:
        return None
    times = samples["time_ns"].astype(np.int64)
    step_ns = round(PATH_STEP_S * 1e9)
    wanted = np.arange(times[0], times[-1] + 1, step_ns)
    places = np.unique(np.append(np.searchsorted(times, wanted), len(times) - 1))
    ways = np.diff(samples["position_m"][places], axis=0)
    return float(np.hypot(*ways.T).sum())


def planes_of(objects: Mapping[str, Any]) -> dict[str, Plane]:
    """Those of the membranes among a scene's objects, given as plain data by id."""
    found: dict[str, Plane] = {}
    for id, each in objects.items():
        if each.get("kind") == "membrane":
            x, y = map(float, each["normal"])
            length = float(np.hypot(x, y))
            center_x, center_y = map(float, each["center_m"])
            found[id] = Plane((center_x, center_y), (x / length, y / length))
    return found


def joined(parts: Iterable[Samples], none: Samples) -> Samples:
    """Samples of several stretches as one; `none`, of no ticks, where there is no stretch."""
    taken = list(parts)
    return np.concatenate(taken) if taken else none
