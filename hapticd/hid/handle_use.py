"""Finds from a device's positions where its handle rests and which range it reaches, and warns if that is implausible.

Two faults cannot be felt as such: a handle that rests inside an object, which then pushes it although nobody holds it,
and a handle whose counts do not reach the ends of their range, so that all distances are too short. Both are corrected
by `device.hid.axes.x.counts`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Flag
from hapticd.config.hid import Hid
from hapticd.hid.plan import AxisPlan, Plan

MIN_USE_S: Final = 60.0
"""The reached range is judged after the handle was used for this time."""
_MAX_PAUSE_S: Final = 5.0
"""Time after a motion that still counts as use."""
MIN_REST_S: Final = 5.0
"""The handle rests at a position if it was still there for this much longer than elsewhere."""
_MAX_REST_S: Final = 10.0
"""Longest time for which an earlier rest outweighs a new one."""
_STILL_SHARE: Final = 0.002
"""A handle is still while it moves by no more than this fraction of its half travel."""
_STILL_COUNTS: Final = 2.0
"""A handle is also still while it moves by no more than this number of counts."""
_MOVED_SHARE: Final = 0.02
"""An axis is moved if its positions differ by more than this fraction of the half travel."""
_MIN_REST_FORCE_N: Final = 0.1
"""A smaller force on a resting handle is not reported."""
_END_SHARE: Final = 0.1
"""An end of the range counts as reached within this fraction of the half travel, and as exceeded beyond it."""

_log = logging.getLogger("hapticd")


class HandleUse:
    """Observes the handle of one device. One thread calls `note`; any thread may read `lines`."""

    def __init__(self, hid: Hid, *, from_file: bool) -> None:
        """Observe a device with this configuration. `from_file`: its positions are replayed from a recording."""
        self._hid = hid
        self._from_file = from_file
        self._logged: set[str] = set()
        self.lines: tuple[str, ...] = ()
        """The warnings in force, one line each."""
        self._restart(None)

    def _restart(self, axes: tuple[AxisPlan, AxisPlan] | None) -> None:
        self._axes = axes
        self._driven = (False, False)  # an axis without a force, such as a pedal, is not used as a handle is
        self._low_m, self._high_m = np.full(2, np.inf), np.full(2, -np.inf)
        self._time_ns: int | None = None
        self._anchor_m = self._rest_m = np.full(2, np.nan)
        self._still_s, self._rest_s, self._use_s = 0.0, 0.0, 0.0
        self._revision = -1
        self._rest_line: str | None = None

    def note(self, samples: npt.NDArray[np.void], plan: Plan, touching: Callable[[], list[str]]) -> None:
        """Take the positions of consecutive samples. `touching` returns the ids of the objects touched at the last."""
        if self._axes != (plan.x, plan.y):
            self._restart((plan.x, plan.y))
        self._driven = plan.driven_axes
        last = samples[-1]
        now_ns, flags = int(last["time_ns"]), int(last["flags"])
        passed_s = 0.0 if self._time_ns is None else 1e-9 * (now_ns - self._time_ns)
        self._time_ns = now_ns
        if np.any(samples["flags"] & Flag.GLITCH) or passed_s > _MAX_PAUSE_S:
            return
        low_m, high_m = samples["position_m"].min(axis=0), samples["position_m"].max(axis=0)
        self._low_m, self._high_m = np.minimum(self._low_m, low_m), np.maximum(self._high_m, high_m)
        tolerance_m = max(_STILL_SHARE * self._hid.travel_m, _STILL_COUNTS * plan.resolution_m)
        if np.all(np.maximum(high_m - self._anchor_m, self._anchor_m - low_m) <= tolerance_m):
            self._still_s += passed_s
            self._weigh_rest(passed_s, tolerance_m)
        else:
            self._anchor_m, self._still_s = last["position_m"].copy(), 0.0
        self._use_s += passed_s if self._still_s <= _MAX_PAUSE_S else 0.0
        if self._revision != last["revision"]:
            self._revision, self._rest_line = int(last["revision"]), None
        rests = self._rest_s >= MIN_REST_S and np.all(np.abs(self._anchor_m - self._rest_m) <= tolerance_m)
        force_n = math.hypot(*last["contact_force_n"])
        if rests and self._still_s > 0.0 and flags & Flag.CONTACT and force_n >= _MIN_REST_FORCE_N:
            self._rest_line = self._rest_line or self._rest_warning(touching(), force_n)
        ranges = (self._range_warning(name, place) for place, name in enumerate("xy") if self._driven[place])
        self.lines = tuple(line for line in (self._rest_line, *ranges) if line is not None)

    def _weigh_rest(self, passed_s: float, tolerance_m: float) -> None:
        """Find the position at which the handle is still most of the time, by the majority vote of Boyer and Moore."""
        if np.all(np.abs(self._anchor_m - self._rest_m) <= tolerance_m):
            self._rest_s = min(self._rest_s + passed_s, _MAX_REST_S)
        elif self._rest_s > passed_s:
            self._rest_s -= passed_s
        else:
            self._rest_m, self._rest_s = self._anchor_m, passed_s

    def _rest_warning(self, objects: list[str], force_n: float) -> str | None:
        if not objects:
            return None
        assert self._axes is not None
        uncalibrated = [
            f"device.hid.axes.{name}.counts to {round(axis.counts(at_m))}"
            for name, axis, at_m, driven in zip("xy", self._axes, self._rest_m, self._driven, strict=True)
            if driven and getattr(self._hid.axes, name).counts is None
        ]
        if self._hid.report is not None:
            remedy = "set zero_counts of device.hid.report.input to the counts at rest, or move the object"
        elif not uncalibrated:
            remedy = "move the object"
        elif self._from_file:
            remedy = f"set the middle of {' and of '.join(uncalibrated)}, or move the object"
        else:
            remedy = "`hapticd devices calibrate` measures where the middle is; or move the object"
        x_mm, y_mm = 1e3 * self._rest_m
        line = (
            f"the handle rests at x {x_mm:.1f} mm, y {y_mm:.1f} mm, inside {', '.join(objects)}, which pushes it with "
            f"{force_n:.2g} N: if nobody holds it, {remedy}"
        )
        self._log_once("rest", line)
        return line

    def _range_warning(self, name: str, place: int) -> str | None:
        """Return a warning about the range that an axis has reached; None if it is as expected, or not known yet."""
        assert self._axes is not None
        axis, travel_m = self._axes[place], self._hid.travel_m
        low_m, high_m = float(self._low_m[place]), float(self._high_m[place])
        if self._hid.report is not None or high_m - low_m <= _MOVED_SHARE * travel_m:
            return None
        key = f"device.hid.axes.{name}.counts"
        low, high = axis.range_counts(low_m, high_m)
        first, last = axis.range_counts(-travel_m, travel_m)
        if getattr(self._hid.axes, name).counts is not None:
            if max(-low_m, high_m) <= (1.0 + _END_SHARE) * travel_m:
                return None
            line = f"axis {name} reported {low}..{high}, beyond {key}, {first}..{last}: "
        elif self._use_s >= MIN_USE_S and min(-low_m, high_m) < (1.0 - _END_SHARE) * travel_m:
            line = f"axis {name} reported {low}..{high} of {first}..{last} in a minute's use: if it reached its stops, "
        else:
            return None
        if self._from_file:
            rest = round(axis.counts(float(self._rest_m[place]))) if self._rest_s > 0.0 else (low + high) // 2
            line += f"set {key}: [{low}, {rest}, {high}]"
        else:
            line += f"`hapticd devices calibrate` measures {key}"
        self._log_once(f"range of {name}", line)
        return line

    def _log_once(self, what: str, line: str) -> None:
        if what not in self._logged:
            self._logged.add(what)
            _log.warning("%s", line)
