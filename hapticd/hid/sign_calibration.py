"""Which way a device pushes: small forces along each of its axes, both ways, while nobody holds the handle.

The force rises and falls over ramps, is held for a moment, and ends early once the handle has clearly moved. However a
calibration ends, the force ends at zero and the effects are stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Literal

from hapticd.base.core import ffi, lib
from hapticd.config.hid import ForceAxes, ForceAxis, Hid
from hapticd.hid.device import Device, Driver, arrived_reports
from hapticd.hid.plan import DeviceError, Plan

MOST_OF_FULL: Final = 0.1
"""No more than this part of the full force is used."""
RAMP_S: Final = 0.2
HOLD_S: Final = 0.4
REST_S: Final = 0.5
STEP_S: Final = 0.01
MOVED: Final = 0.02
"""A handle that moved by less than this part of its half travel was not pushed."""
ENOUGH: Final = 0.2
"""A push ends early once the handle has moved by this part."""
CLEARLY_FARTHER: Final = 2.0
"""The axis that was pushed moves so many times as far as the other."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What was found."""

    force_axes: ForceAxes
    moved_m: dict[str, tuple[float, float]]
    """How far the handle went along x and y with a force along each of the device's axes."""


class _Pusher:
    """Sends forces and reads positions, with the time that it takes."""

    def __init__(self, device: Device, plan: Plan, now: Callable[[], float], pause: Callable[[float], None]) -> None:
        self._device, self._plan = device, plan
        self._sent: list[bytes] = []
        self._now, self._pause = now, pause
        self._described = plan.to_c()
        self._renewed = now()
        self.position_m: list[float | None] = [None, None]

    def put(self, x_n: float, y_n: float) -> None:
        """One force; what was reported meanwhile is read."""
        force, sent = ffi.new("double[2]", [x_n, y_n]), []
        for place, message in enumerate(self._plan.force):
            report = ffi.new("uint8_t[]", len(message.data))
            lib.hd_hid_compose(ffi.addressof(self._described.force.messages, place), force, report)
            sent.append(bytes(ffi.buffer(report)))
            self._device.write(sent[-1])
        if self._now() - self._renewed >= self._plan.renew_s / 2:
            self._renewed = self._now()
            for renewal in self._plan.renew:
                self._device.write(renewal.data)
        self._sent = sent if x_n or y_n else self._sent
        self._pause(STEP_S)
        self.read()

    def read(self) -> None:
        """Takes what was reported; the newest position of each axis stays."""
        numbered = self._plan.x.report_id != 0
        for report in arrived_reports(self._device.fileno()):
            data = report if numbered else b"\0" + report
            for place, axis in enumerate((self._plan.x, self._plan.y)):
                if data[0] == axis.report_id and axis.bits.end <= 8 * (len(data) - 1):
                    self.position_m[place] = (axis.bits.get(data) - axis.zero_counts) * axis.m_per_count

    def push(self, along: int, force_n: float, half_m: float) -> tuple[float, float]:
        """How far the handle goes when it is pushed along an axis (0 or 1), m."""
        start = self._now()
        while self._now() - start < REST_S:
            self.put(0.0, 0.0)
        rest: tuple[float | None, ...] = tuple(self.position_m)
        moved = (0.0, 0.0)
        start = self._now()
        while (passed := self._now() - start) < RAMP_S + HOLD_S:
            share = min(1.0, passed / RAMP_S)
            self.put(*((share * force_n, 0.0) if along == 0 else (0.0, share * force_n)))
            # A device that reports only what changes first says where it is when it moves.
            rest = tuple(here if known is None else known for known, here in zip(rest, self.position_m, strict=True))
            x, y = (
                0.0 if here is None or was is None else here - was
                for here, was in zip(self.position_m, rest, strict=True)
            )
            moved = (x, y)
            if max(abs(x), abs(y)) > ENOUGH * half_m:
                break
        self.put(0.0, 0.0)
        return moved

    def sent(self) -> str:
        """What the device was sent for the last push, and what of its effects went before it, in hex, ids first."""
        before = [message.at_rest() for message in (*self._plan.restore, *self._plan.renew)]
        return ", ".join(report.hex(" ") for report in (*before, *self._sent))


def calibrate(
    device: Device,
    driver: Driver,
    hid: Hid,
    force_n: float,
    *,
    now: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
) -> Calibration:
    """Pushes along each axis both ways and sees what moves; some five seconds.

    `driver` and `hid` must have the force axes as the device has them. Raises DeviceError: nothing moved, it is not
    clear what did, or the device is gone; ValueError for more than a tenth of the full force.
    """
    if not 0.0 < force_n <= MOST_OF_FULL * hid.full_scale_force_n * (1 + 1e-9):
        raise ValueError(f"{force_n:g} N is not above 0 and up to {MOST_OF_FULL * hid.full_scale_force_n:g} N")
    plan = driver.set_up(device)
    pusher = _Pusher(device, plan, now, pause)
    half_m = hid.travel_m
    try:
        moved: dict[str, tuple[float, float]] = {}
        axes: tuple[Literal["x", "y"], ...] = ("x", "y")
        for along, name in enumerate(axes):
            # A device of one axis has nothing to push along the other.
            if not plan.driven_axes[along]:
                continue
            there = pusher.push(along, force_n, half_m)
            back = pusher.push(along, -force_n, half_m)
            moved[name] = ((there[0] - back[0]) / 2.0, (there[1] - back[1]) / 2.0)
            if max(map(abs, moved[name])) < MOVED * half_m:
                raise DeviceError(
                    f"the handle did not move along any axis when {force_n:g} N pushed along the device's {name} axis, "
                    f"nor for -{force_n:g} N: sent was {pusher.sent()} (hex, id first); is a hand on it, or does it "
                    f"take these reports otherwise? Else try more with --force{_alone(moved)}"
                )
        return Calibration(_found(moved), moved)
    finally:
        _rest(device, plan)


def _alone(moved: dict[str, tuple[float, float]]) -> str:
    """What a device needs that pushes along its first axis and not along its second one, as wheels that name both."""
    x, y = moved["x"]
    if "y" not in moved or abs(x) < CLEARLY_FARTHER * abs(y):
        return ""
    sign = 1 if x > 0 else -1
    return (
        f". Along x it does move: a device without a motor for y needs device.hid.force_axes: {{x: {{sign: {sign}}}}}"
    )


def _found(moved: dict[str, tuple[float, float]]) -> ForceAxes:
    ways = {}
    for name, (x, y) in moved.items():
        if max(abs(x), abs(y)) < CLEARLY_FARTHER * min(abs(x), abs(y)):
            raise DeviceError(
                f"the device's {name} axis moved the handle by {1e3 * x:.1f} mm along x and {1e3 * y:.1f} mm along y: "
                "not clear which it is; was the handle touched?"
            )
        ways[name] = ("x", x) if abs(x) > abs(y) else ("y", y)
    if len(ways) == 2 and ways["x"][0] == ways["y"][0]:
        raise DeviceError(f"both of the device's axes moved the handle along {ways['x'][0]}: was the handle touched?")
    signs: dict[str, Literal[1, -1]] = {name: 1 if way[1] > 0 else -1 for name, way in ways.items()}
    return ForceAxes(x=ForceAxis(sign=signs["x"]), y=ForceAxis(sign=signs.get("y", 1)), swap=ways["x"][0] == "y")


def _rest(device: Device, plan: Plan) -> None:
    """A force of zero, and the end of every effect, as far as the device still takes it."""
    for report in (*(message.at_rest() for message in plan.force), *(message.data for message in plan.stop)):
        with suppress(DeviceError):
            device.write(report)
