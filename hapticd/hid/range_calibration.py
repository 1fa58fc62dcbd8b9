"""Measures the range of a handle's axes in counts: a person moves the handle to all corners, then lets go of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median_low
from typing import Final

from hapticd.config.hid import CountRange
from hapticd.hid.device import Device, Driver
from hapticd.hid.plan import AxisPlan
from hapticd.hid.sign_calibration import PUSH_STEP_S, Pusher, send_rest

START_TIMEOUT_S: Final = 20.0
"""The measurement ends if the handle is not moved within this time."""
SHORT_STILL_TIME_S: Final = 2.5
"""The measurement ends once the handle was still for this time, away from the ends of its range."""
LONG_STILL_TIME_S: Final = 8.0
"""The measurement also ends once the handle was still for this time, wherever it is."""
_STILL_SHARE: Final = 0.01
"""A handle is still while it moves by no more than this fraction of the axis' range in the report descriptor."""
_STILL_COUNTS: Final = 2.0
"""A handle is also still while it moves by no more than this number of counts."""
_SWEPT_SHARE: Final = 0.25
"""Fraction of the range in the report descriptor that is moved through before a short rest ends the measurement."""
_MIN_RANGE_SHARE: Final = 0.03
"""A smaller range is not used, as a fraction of the range in the report descriptor."""
_MIN_RANGE_COUNTS: Final = 40
"""A smaller range is not used either: it might leave fewer counts than needed on one side of the middle."""
_MAX_OFF_CENTRE: Final = 0.2
"""A handle that rests farther from the middle of its range has no spring; as a fraction of the half range."""


@dataclass(slots=True)
class _Axis:
    """The counts that were read of one axis."""

    name: str
    plan: AxisPlan
    first: int
    """Smallest count of the axis, by the report descriptor; a smaller one is ignored."""
    last: int
    low: float = float("inf")
    high: float = float("-inf")
    before: int | None = None
    anchor: int | None = None
    """Count at which the handle became still."""
    rest: list[int] = field(default_factory=list)
    """The counts since then."""

    @property
    def tolerance(self) -> float:
        """Largest motion of a handle that is still, in counts."""
        return max(_STILL_COUNTS, _STILL_SHARE * (self.last - self.first))

    def note(self, position_m: float | None) -> bool:
        """Take the newest position; return whether the handle has moved. One outlier does not widen the range."""
        if position_m is None or not self.first <= (counts := round(self.plan.counts(position_m))) <= self.last:
            return False
        before = counts if self.before is None else self.before
        self.low, self.high = min(self.low, max(before, counts)), max(self.high, min(before, counts))
        self.before = counts
        moved = self.anchor is not None and abs(counts - self.anchor) > self.tolerance
        if moved or self.anchor is None:
            self.anchor, self.rest = counts, []
        self.rest.append(counts)
        return moved

    @property
    def is_swept(self) -> bool:
        """Whether the handle was moved far along this axis, and is not at an end of its range."""
        if self.before is None or self.high - self.low < _SWEPT_SHARE * (self.last - self.first):
            return False
        margin = 0.1 * (self.high - self.low)
        return self.low + margin < self.before < self.high - margin

    def result(self) -> tuple[CountRange | None, str | None]:
        """Return the measured counts, and a note for the user; None if there is none."""
        if self.high - self.low < max(_MIN_RANGE_SHARE * (self.last - self.first), _MIN_RANGE_COUNTS):
            return None, f"axis {self.name} was hardly moved: its counts are not measured"
        low, high, rest = int(self.low), int(self.high), median_low(self.rest)
        middle = (low + high) // 2
        if abs(rest - middle) > _MAX_OFF_CENTRE * (high - low) / 2:
            note = f"axis {self.name} came to rest at {rest}, far from the middle of its range {low}..{high}"
            return (low, middle, high), f"{note}, as a handle without a spring does: {middle} is taken for the middle"
        return (low, rest, high), None


@dataclass(frozen=True, slots=True)
class MeasuredRange:
    """The counts of the axes, as `device.hid.axes.x.counts` has them; None for an axis that was not measured."""

    x: CountRange | None
    y: CountRange | None
    notes: tuple[str, ...]
    """Lines for the user about axes that were not measured, or are unusual."""


def measure_range(
    device: Device,
    driver: Driver,
    travel_m: float,
    show: Callable[[str], None],
    *,
    now: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
) -> MeasuredRange:
    """Measure the range of each axis while a person moves the handle; end once it was let go and is still.

    `driver` must have been made without counts in the configuration, and with half the travel `travel_m`. `show` gets a
    line of progress. The force is zero. Raises DeviceError if the device is gone.
    """
    plan = driver.set_up(device)
    pusher = Pusher(device, plan, now, pause)
    axes = [_Axis(name, axis, *axis.range_counts(-travel_m, travel_m)) for name, axis in (("x", plan.x), ("y", plan.y))]
    axes = axes[: 1 if plan.y.is_still else 2]
    try:
        start_s = still_since_s = now()
        has_moved = False
        while True:
            pause(PUSH_STEP_S)
            pusher.read()
            if any([axis.note(at_m) for axis, at_m in zip(axes, pusher.position_m, strict=False)]):
                has_moved, still_since_s = True, now()
            still_s = now() - still_since_s
            if not has_moved and now() - start_s > START_TIMEOUT_S:
                moved = f"by less than {100 * _STILL_SHARE:g} % of its axes' range within {START_TIMEOUT_S:.0f} s"
                return MeasuredRange(None, None, (f"the handle moved {moved}: its counts are not measured",))
            until_s = SHORT_STILL_TIME_S if all(axis.is_swept for axis in axes) else LONG_STILL_TIME_S
            if has_moved and still_s > until_s:
                break
            seen = [f"{axis.name} {axis.low:.0f}..{axis.high:.0f}" for axis in axes if axis.before is not None]
            show(", ".join([*seen, f"still for {still_s:.0f} s" if has_moved else "move the handle"]))
    finally:
        send_rest(device, plan)
    results = {axis.name: axis.result() for axis in axes}
    x, y = (results.get(name, (None, None))[0] for name in "xy")
    return MeasuredRange(x, y, tuple(note for _, note in results.values() if note is not None))
