"""Feature reports that a set-up reads, and PID Pool: how many effects a device says that it plays at a time.

Some firmware frees every effect when its pool is read. So it is read once in a set-up, after the reset and before the
first effect is made. Nothing depends on it: where it is not given, PID Block Load says whether there is room.
"""

from __future__ import annotations

import logging
import time
from typing import Final

from hapticd.config.hid import Hid
from hapticd.hid.descriptor.fields import Field
from hapticd.hid.descriptor.layout import Layout
from hapticd.hid.device import Device
from hapticd.hid.drivers.pid_reports import bits_of
from hapticd.hid.plan import DeviceError
from hapticd.system.repeated_lines import Repeats

AGAIN_S: Final = 0.05
"""A device that says that it plays one effect, or none, is asked once more, after this time."""

_log = logging.getLogger("hapticd")
_repeats = Repeats()


class Pool:
    """The PID Pool of one device."""

    def __init__(self, layout: Layout, hid: Hid) -> None:
        self._pool = None if "no_pid_pool" in hid.quirks else layout.pool
        self._told = False

    def simultaneous(self, device: Device) -> int | None:
        """How many effects the device plays at a time; None where it does not say. No effect may exist yet."""
        pool = self._pool
        if pool is None or pool.simultaneous_effects_max is None:
            return None
        most = 0
        for attempt in range(2):
            if attempt:
                time.sleep(AGAIN_S)
            try:
                answer = read_feature(device, pool.report_id, pool.report_bytes, "PID Pool")
                most = number_in(answer, pool.simultaneous_effects_max, "PID Pool", device)
            except DeviceError as error:
                self.tell(f"{error}; PID Block Load decides how many effects there are")
                return None
            if most > 1:
                break
        return most if most > 0 else None

    def tell(self, text: str) -> None:
        """Says in the log what is wrong with it: once, and as a sum of a device that is found anew all the time."""
        if not self._told:
            self._told = True
            _repeats.note(text, lambda since: _log.warning("%s%s", text, since.more))


def read_feature(device: Device, report_id: int, report_bytes: int, name: str) -> bytes:
    """The answer to a feature report, its id first. Raises DeviceError where it is another report."""
    answer = device.get_feature(report_id, report_bytes + (report_id == 0))
    if answer[:1] != bytes([report_id]):
        other = f"report {answer[0]}" if answer else "nothing"
        raise DeviceError(f"{device.path}: asked for {name}, report {report_id}, the device answers {other}")
    return answer


def number_in(answer: bytes, field: Field, name: str, device: Device) -> int:
    """A number of a report, its id first. Raises DeviceError for a report that ends before it."""
    try:
        return bits_of(field).get(answer)
    except ValueError:
        raise DeviceError(f"{device.path}: {name} is too short: {len(answer)} bytes") from None
