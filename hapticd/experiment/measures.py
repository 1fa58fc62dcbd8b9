"""Measures of a trial's motion, computed from its telemetry.

`samples` are (n,) records of `hapticd.SAMPLE_DTYPE`, `events` are mappings as in telemetry. A measure that a trial does
not have, such as the overtravel without a rupture, is None.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from hapticd.base import wording
from hapticd.base.core import Flag
from hapticd.config.schema import unit_of
from hapticd.experiment.stage import Samples

Events: TypeAlias = Sequence[Mapping[str, Any]]


class Plane(NamedTuple):
    """The plane of a membrane at rest, with a point and the unit normal."""

    center_m: tuple[float, float]
    normal: tuple[float, float]


Planes: TypeAlias = Mapping[str, Plane]
"""The planes of the membranes of a scene, by the id of the membrane."""

PATH_STEP_S: Final = 0.01
"""Interval between the positions whose distances are added to the length of a path. With a shorter interval the steps
of the encoder would count as motion of the hand.
"""

MOTION_MEASURES: Final = ("overtravel_m", "peak_force_n", "completion_s", "path_m")
"""Names of all measures of the motion. Each ends with its unit."""
_MEASURE_LABELS: Final = {
    "overtravel_m": "Overtravel",
    "peak_force_n": "Largest force",
    "completion_s": "Time",
    "path_m": "Path",
}
"""Names of the measures as participants read them."""


def measure_text(name: str, value: float) -> str:
    """Return a measure of the motion as text for the participant, such as "Overtravel: 3.2 mm."."""
    return f"{_MEASURE_LABELS[name]}: {wording.si(value, unit_of(name) or '', 3)}."


def why_not_done(name: str, value: float | None) -> str | None:
    """Return a text for the participant if a motor task with this measure was not done, or None if it was done."""
    if name == "overtravel_m" and value is None:
        return "No membrane broke. Push further, until it breaks."
    if name == "peak_force_n" and not value:
        return "No force was felt."
    return None


def measures_of(samples: Samples, events: Events, planes: Planes) -> dict[str, float | None]:
    """Return all measures of a trial's motion by name, None for a measure that the trial does not have."""
    return {
        "overtravel_m": overtravel_m(samples, events, planes),
        "peak_force_n": peak_force_n(samples),
        "completion_s": completion_s(samples),
        "path_m": path_m(samples),
    }


def overtravel_m(samples: Samples, events: Events, planes: Planes) -> float | None:
    """Return how far the hand moved beyond the place of the first rupture, along the membrane's normal, in m.

    Returns None without a rupture. The place is interpolated between the two samples around the `onset_time_ns` of the
    first event `puncture`. The side of the resting membrane on which this place lies gives the direction of the motion.
    The velocity would be less reliable, because the hand may just have reversed.
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
    # Subtract before the conversion: a float64 does not resolve nanoseconds of a long uptime.
    place = float(np.interp(0.0, (times - onset_ns).astype(np.float64), height))
    return max(0.0, float(((height[after] - place) * np.sign(place)).max()))


def peak_force_n(samples: Samples) -> float | None:
    """Return the largest magnitude of the commanded force in N, or None without samples."""
    return float(np.hypot(*samples["force_n"].T).max()) if len(samples) else None


def completion_s(samples: Samples) -> float | None:
    """Return the time in s from the first to the last sample with the forces on, or None without such samples."""
    on = np.flatnonzero(samples["flags"] & Flag.FORCES_ON)
    if len(on) == 0:
        return None
    times = samples["time_ns"].astype(np.int64)
    return float(times[on[-1]] - times[on[0]]) / 1e9


def path_m(samples: Samples) -> float | None:
    """Return the length in m of the handle's path through the positions at intervals of PATH_STEP_S, or None."""
    if len(samples) == 0:
        return None
    times = samples["time_ns"].astype(np.int64)
    step_ns = round(PATH_STEP_S * 1e9)
    wanted = np.arange(times[0], times[-1] + 1, step_ns)
    places = np.unique(np.append(np.searchsorted(times, wanted), len(times) - 1))
    steps = np.diff(samples["position_m"][places], axis=0)
    return float(np.hypot(*steps.T).sum())


def planes_of(objects: Mapping[str, Any]) -> dict[str, Plane]:
    """Return the planes of the membranes among the objects of a scene (plain data, by id)."""
    found: dict[str, Plane] = {}
    for id, each in objects.items():
        if each.get("kind") == "membrane":
            x, y = map(float, each["normal"])
            length = float(np.hypot(x, y))
            center_x, center_y = map(float, each["center_m"])
            found[id] = Plane((center_x, center_y), (x / length, y / length))
    return found
