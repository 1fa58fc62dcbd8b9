"""Finds the axis and the sign of a device's forces by small pushes along each axis, while nobody holds the handle.

The force of each push rises over a ramp and is held; a push ends early once the handle has clearly moved. At the end of
a calibration, and after an error, the force is zero and the effects are stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Literal

from hapticd.base.core import HidMeaning, ffi, lib
from hapticd.config.hid import ForceAxes, ForceAxis, Hid
from hapticd.hid.device import Device, Driver, arrived_reports
from hapticd.hid.plan import DeviceError, Plan
from hapticd.hid.signs import STILL_ADVICE, idle_texts

MAX_FORCE_SHARE: Final = 0.1
"""Largest force of a calibration, as a fraction of the device's largest force."""
PUSH_RAMP_S: Final = 0.2
"""Time over which the force of a push rises."""
PUSH_HOLD_S: Final = 0.4
"""Time for which a push is held after its ramp."""
PUSH_PAUSE_S: Final = 0.5
"""Pause before each push, in which the handle comes to rest."""
PUSH_STEP_S: Final = 0.01
"""Interval between two forces that are sent during a push."""
MIN_MOTION_SHARE: Final = 0.02
"""Smallest motion that counts as moved, as a fraction of the handle's half travel."""
SUFFICIENT_MOTION_SHARE: Final = 0.2
"""A push ends early once the handle has moved by this fraction of its half travel."""
MIN_MOTION_RATIO: Final = 2.0
"""The axis of a motion is clear if the motion along it is at least this many times that along the other axis."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The result of a calibration of the direction in which a device pushes."""

    force_axes: ForceAxes
    moved_m: dict[str, tuple[float, float]]
    """Motion of the handle along x and y, in m, by the device's axis along which a force pushed."""


class Pusher:
    """Sends forces to a device during a calibration, and reads the positions of its handle."""

    def __init__(self, device: Device, plan: Plan, now: Callable[[], float], pause: Callable[[float], None]) -> None:
        self._device, self._plan = device, plan
        self._sent: list[bytes] = []
        self._now, self._pause = now, pause
        self._described = plan.to_c()
        self._renewed = now()
        self.position_m: list[float | None] = [None, None]
        self.idle = 0
        """Why the device exerts no force, as the newest PID State reports it: `SignsStatus.idle`."""

    def put(self, x_n: float, y_n: float) -> None:
        """Send a force, wait for PUSH_STEP_S, and read the reports that arrived."""
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
        self._pause(PUSH_STEP_S)
        self.read()

    def read(self) -> None:
        """Read the queued input reports, and store the newest position of each axis and the state of the device."""
        numbered = self._plan.x.report_id != 0
        for report in arrived_reports(self._device.fileno()):
            data = report if numbered else b"\0" + report
            for place, axis in enumerate((self._plan.x, self._plan.y)):
                if data[0] == axis.report_id and axis.bits.end <= 8 * (len(data) - 1):
                    self.position_m[place] = axis.position_m(axis.bits.get(data))
            for state in self._plan.states:
                here = data[0] == state.report_id and state.bits.end <= 8 * (len(data) - 1)
                if here and state.meaning != HidMeaning.RESET:
                    bit = 1 << (state.meaning - 1)
                    is_idle = bool(state.bits.get(data)) == (state.meaning == HidMeaning.PAUSED)
                    self.idle = self.idle | bit if is_idle else self.idle & ~bit

    def push(self, along: int, force_n: float, half_m: float) -> tuple[float, float]:
        """Push the handle along the device's axis 0 or 1, and return its motion along x and y, in m.

        `half_m` is the handle's half travel.
        """
        start = self._now()
        while self._now() - start < PUSH_PAUSE_S:
            self.put(0.0, 0.0)
        rest: tuple[float | None, ...] = tuple(self.position_m)
        moved = (0.0, 0.0)
        start = self._now()
        while (passed := self._now() - start) < PUSH_RAMP_S + PUSH_HOLD_S:
            share = min(1.0, passed / PUSH_RAMP_S)
            self.put(*((share * force_n, 0.0) if along == 0 else (0.0, share * force_n)))
            # A device that reports only changes sends its first position when it moves.
            rest = tuple(here if known is None else known for known, here in zip(rest, self.position_m, strict=True))
            x, y = (
                0.0 if here is None or was is None else here - was
                for here, was in zip(self.position_m, rest, strict=True)
            )
            moved = (x, y)
            if max(abs(x), abs(y)) > SUFFICIENT_MOTION_SHARE * half_m:
                break
        self.put(0.0, 0.0)
        return moved

    def sent(self) -> str:
        """Return, in hex and ids first, the reports that set up and start the effects, then those of the last push."""
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
    """Push the handle both ways along each axis, and find the axes and signs of forces from its motion, in about 5 s.

    `driver` must have been made with the default `force_axes`; those of `hid` are not used. Raises DeviceError if the
    handle did not move, if the result is not clear, or if the device is gone; ValueError if `force_n` is not above 0 or
    exceeds MAX_FORCE_SHARE of the full force.
    """
    if not 0.0 < force_n <= MAX_FORCE_SHARE * hid.full_scale_force_n * (1 + 1e-9):
        limit_n = MAX_FORCE_SHARE * hid.full_scale_force_n
        raise ValueError(f"the force must be above 0 and at most {limit_n:g} N, is {force_n:g} N")
    plan = driver.set_up(device)
    pusher = Pusher(device, plan, now, pause)
    half_m = hid.travel_m
    try:
        moved: dict[str, tuple[float, float]] = {}
        axes: tuple[Literal["x", "y"], ...] = ("x", "y")
        for along, name in enumerate(axes):
            # A device with one axis is not pushed along the other.
            if not plan.driven_axes[along]:
                continue
            there = pusher.push(along, force_n, half_m)
            back = pusher.push(along, -force_n, half_m)
            moved[name] = ((there[0] - back[0]) / 2.0, (there[1] - back[1]) / 2.0)
            if max(map(abs, moved[name])) < MIN_MOTION_SHARE * half_m:
                idle = f"{': '.join(idle_texts(pusher.idle))}; if that is not so, " if pusher.idle else ""
                raise DeviceError(
                    f"the handle did not move along any axis when {force_n:g} N pushed along the device's {name} axis, "
                    f"nor for -{force_n:g} N: sent reports: {pusher.sent()} (hex, id first); "
                    f"{idle}{STILL_ADVICE}, check that the device accepts these reports, or, if friction or a dead "
                    f"band takes this force, try a larger --force{_single_axis_hint(moved)}"
                )
        return Calibration(_force_axes_of(moved), moved)
    finally:
        send_rest(device, plan)


def _single_axis_hint(moved: dict[str, tuple[float, float]]) -> str:
    """Return a hint for devices, such as wheels, with two axes in the descriptor and a motor for x only."""
    x, y = moved["x"]
    if "y" not in moved or abs(x) < MIN_MOTION_RATIO * abs(y):
        return ""
    sign = 1 if x > 0 else -1
    return (
        f". Along x it does move: a device without a motor for y needs device.hid.force_axes: {{x: {{sign: {sign}}}}}"
    )


def _force_axes_of(moved: dict[str, tuple[float, float]]) -> ForceAxes:
    """Return the axes and signs of forces that follow from these motions. Raises DeviceError if they are not clear."""
    moves = {}
    for name, (x, y) in moved.items():
        if max(abs(x), abs(y)) < MIN_MOTION_RATIO * min(abs(x), abs(y)):
            raise DeviceError(
                f"the device's {name} axis moved the handle by {1e3 * x:.1f} mm along x and {1e3 * y:.1f} mm along y: "
                "the axis is not clear; do not touch the handle"
            )
        moves[name] = ("x", x) if abs(x) > abs(y) else ("y", y)
    if len(moves) == 2 and moves["x"][0] == moves["y"][0]:
        raise DeviceError(f"both of the device's axes moved the handle along {moves['x'][0]}; do not touch the handle")
    signs: dict[str, Literal[1, -1]] = {name: 1 if move[1] > 0 else -1 for name, move in moves.items()}
    return ForceAxes(x=ForceAxis(sign=signs["x"]), y=ForceAxis(sign=signs.get("y", 1)), swap=moves["x"][0] == "y")


def send_rest(device: Device, plan: Plan) -> None:
    """Send a force of zero, stop every effect, and ignore errors of the device."""
    for report in (*(message.at_rest() for message in plan.force), *(message.data for message in plan.stop)):
        with suppress(DeviceError):
            device.write(report)
