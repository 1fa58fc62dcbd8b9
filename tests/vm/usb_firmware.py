"""The simulated firmware of tests/support/firmware.py behind the bus of usb_pid_joystick.py: a device of a known
family, with all that is odd in it, which the guest's own USB stack enumerates and its own drivers use.
"""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable

from usb_pid_joystick import FULL_SCALE_N, TRAVEL_M
from usbip.classes.device import hid as usb_hid

from tests.support.firmware import Firmware, Variant


class FirmwareJoystick:
    """What `usb_pid_joystick.Plug` plugs in. Lengths in metre and forces in newton, x right, y away from the user."""

    def __init__(self, report_descriptor: bytes, variant: Variant) -> None:
        self.report_descriptor = report_descriptor
        self.stick = Firmware(report_descriptor, variant, clock=time.monotonic)
        self.motion: Callable[[float], tuple[float, float]] = lambda t_s: (0.0, 0.0)
        self.free: float | None = None
        """The hand is off: metres a second for each newton, to the end of the way; None: `motion` says where it is."""
        self.place = (0.0, 0.0)
        self._last_s = time.monotonic()
        self.deaf = False
        self.priority = 0
        self.forces: list[tuple[float, float, float]] = []
        """Time and force, once a frame."""

    def power_on(self) -> None:
        """As after it lost its power."""
        self.stick.power_on()

    def force(self) -> tuple[float, float]:
        """What the handle shows now."""
        x, y = self.stick.force()
        return FULL_SCALE_N * x, FULL_SCALE_N * y

    def zero_after(self, since: float) -> float:
        """How long after `since` there is no force and none comes any more, s; it is asked when all has ended."""
        until = time.monotonic()
        steps = round((until - since) * 1e3)
        pushed = [k for k in range(steps) if self.stick.force(since + k * 1e-3) != (0.0, 0.0)]
        return (pushed[-1] + 1) * 1e-3 if pushed and self.force() == (0.0, 0.0) else math.inf if pushed else 0.0

    # ---- What the bus calls ------------------------------------------------------------------------------------------

    def output(self, data: bytes) -> None:
        """An output report, its id first."""
        self.stick.take(data)

    def set_feature(self, kind: int, report: int, data: bytes) -> None:
        """SET_REPORT."""
        if kind == usb_hid.REPORT_OUTPUT:
            self.stick.take(data)
        else:
            self.stick.set_feature(data)

    def get_feature(self, kind: int, report: int, length: int) -> bytes:
        """GET_REPORT."""
        return self.stick.get_feature(report, length)

    def frame(self) -> bytes | None:
        """The next input report: about the state if there is one, else where the handle is."""
        now = time.monotonic()
        force = self.force()
        self.forces.append((now, *force))
        if self.free is None:
            self.place = self.motion(now)
        else:
            step = (now - self._last_s) * self.free
            x, y = (min(max(at + step * push, -TRAVEL_M), TRAVEL_M) for at, push in zip(self.place, force, strict=True))
            self.place = (x, y)
        self._last_s = now
        try:
            return self.stick.heard.get_nowait()
        except queue.Empty:
            x, y = self.place
            self.stick.position(x / TRAVEL_M, y / TRAVEL_M)
            return self.stick.heard.get_nowait()
