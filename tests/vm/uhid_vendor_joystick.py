"""A home-built joystick through uhid: no PID class, but a report for forces, and a switch that turns it on.

Input report 3: 4 bits of buttons, then x and y of 14 bits each, unsigned, 8192 in the middle, 100000 counts a metre, y
growing towards the user. Output report 0x16: a byte of 0, then x and y as 16-bit numbers, high byte first, 1000 counts
a newton. The actuator is on after feature report 0x17 with 1, 0xA5, off after 0, and shows a force for 0.1 s at most.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import threading
import time
from collections.abc import Callable

from usb_pid_joystick import _item, _main, _page, _range, _usages

VENDOR, PRODUCT = 0x1209, 0x5AFE
COUNTS_PER_M, MIDDLE, COUNTS_PER_N = 100_000, 8192, 1000
POSITION, FORCE, SWITCH = 3, 0x16, 0x17
HOLDS_S = 0.1

DESCRIPTION = {
    "input": {
        "report_id": POSITION,
        "x": {"bit_offset": 4, "bit_size": 14, "signed": False, "counts_per_m": COUNTS_PER_M, "zero_counts": MIDDLE},
        "y": {"bit_offset": 18, "bit_size": 14, "signed": False, "counts_per_m": -COUNTS_PER_M, "zero_counts": MIDDLE},
    },
    "output": {
        "report_id": FORCE,
        "length": 5,
        "x": {"bit_offset": 8, "bit_size": 16, "byte_order": "big", "counts_per_n": COUNTS_PER_N},
        "y": {"bit_offset": 24, "bit_size": 16, "byte_order": "big", "counts_per_n": COUNTS_PER_N},
    },
    "enable": ["feature 17 01 a5"],
    "disable": ["16 00 00 00 00 00"],
}
"""`device.hid.report` of it."""

_CREATE2, _DESTROY, _INPUT2 = 11, 1, 12
_OUTPUT, _GET, _GET_REPLY, _SET, _SET_REPLY = 6, 9, 10, 13, 14
_EVENT_BYTES = 4 + 4376


def descriptor() -> bytes:
    """Its report descriptor."""
    fields = [
        _page(1) + _usages(4) + b"\xa1\x01" + _item(0x84, POSITION, False),
        _page(9) + _item(0x18, 1, False) + _item(0x28, 4, False) + _range(0, 1, 1, 4) + _main(0x80, 2),
        _page(1) + _usages(0x30, 0x31) + _range(0, 16383, 14, 2) + _main(0x80, 2),
        _page(0xFF00) + _item(0x84, FORCE, False) + _usages(0x10) + _range(0, 255, 8, 5) + _main(0x90, 2),
        _item(0x84, SWITCH, False) + _usages(0x11) + _range(0, 255, 8, 2) + _main(0xB0, 2) + b"\xc0",
    ]
    return b"".join(fields)


class VendorJoystick:
    """The device, there while the context lasts."""

    def __init__(self, interval_s: float = 0.002, holds_s: float = HOLDS_S) -> None:
        """`holds_s`: how long it shows a force; infinity is a device that nobody should build."""
        self.motion: Callable[[float], tuple[float, float]] = lambda t_s: (0.0, 0.0)
        self.forces: list[tuple[float, float, float]] = []
        self.switched: list[bytes] = []
        self.faults: list[str] = []
        self.on = False
        self._interval_s = interval_s
        self._holds_s = holds_s
        self._shown_s = 0.0
        self._end = threading.Event()

    def __enter__(self) -> VendorJoystick:
        self._fd = os.open("/dev/uhid", os.O_RDWR | os.O_CLOEXEC)
        rdesc = descriptor()
        names = (b"hapticd vendor joystick", b"hapticd/uhid", b"VM2")
        os.write(
            self._fd,
            struct.pack("<I128s64s64sHHIIII", _CREATE2, *names, len(rdesc), 3, VENDOR, PRODUCT, 1, 0) + rdesc,
        )
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._report, self._listen)]
        for thread in self._threads:
            thread.start()
        time.sleep(0.5)
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        for thread in self._threads:
            thread.join()
        os.write(self._fd, struct.pack("<I", _DESTROY))
        os.close(self._fd)

    def force(self) -> tuple[float, float]:
        """What the handle shows now."""
        live = self.on and self.forces and time.monotonic() - self._shown_s < self._holds_s
        return self.forces[-1][1:] if live else (0.0, 0.0)

    def _report(self) -> None:
        while not self._end.wait(self._interval_s):
            x, y = self.motion(time.monotonic())
            bits = 0
            for shift, counts in ((4, x * COUNTS_PER_M), (18, -y * COUNTS_PER_M)):
                bits |= min(max(round(counts) + MIDDLE, 0), 16383) << shift
            report = bytes([POSITION]) + bits.to_bytes(4, "little")
            with contextlib.suppress(OSError):
                os.write(self._fd, struct.pack("<IH", _INPUT2, len(report)) + report)

    def _listen(self) -> None:
        while not self._end.is_set():
            if not select.select([self._fd], [], [], 0.05)[0]:
                continue
            event = os.read(self._fd, _EVENT_BYTES)
            (kind,) = struct.unpack_from("<I", event)
            if kind == _OUTPUT:
                (size,) = struct.unpack_from("<H", event, 4 + 4096)
                self._output(event[4 : 4 + size])
            elif kind == _SET:
                number, _, _, size = struct.unpack_from("<IBBH", event, 4)
                self._switch(event[12 : 12 + size])
                os.write(self._fd, struct.pack("<IIH", _SET_REPLY, number, 0))
            elif kind == _GET:
                (number,) = struct.unpack_from("<I", event, 4)
                os.write(self._fd, struct.pack("<IIHH", _GET_REPLY, number, 5, 0))

    def _output(self, data: bytes) -> None:
        if len(data) != 6 or data[0] != FORCE or data[1] != 0:
            self.faults.append(f"a wrong output report: {data.hex(' ')}")
            return
        x, y = (counts / COUNTS_PER_N for counts in struct.unpack(">hh", data[2:]))
        self._shown_s = time.monotonic()
        self.forces.append((self._shown_s, x, y))

    def _switch(self, data: bytes) -> None:
        self.switched.append(data)
        if data not in (bytes([SWITCH, 1, 0xA5]), bytes([SWITCH, 0, 0])):
            self.faults.append(f"a wrong feature report: {data.hex(' ')}")
        self.on = data == bytes([SWITCH, 1, 0xA5])
