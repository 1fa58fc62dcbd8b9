"""Access to an open device: output reports, feature reports, and a file descriptor for positions and forces.

`HidrawDevice` is a hidraw node. Set-up uses hidapi; C reads positions from and writes forces to the file descriptor.
`ReplayDevice` (replay.py) has the same methods.
"""

from __future__ import annotations

import fcntl
import os
import select
import time
from collections.abc import Iterator
from typing import Final, Protocol

from hapticd.base.errors import collapse_whitespace
from hapticd.hid.plan import DeviceError, Plan

PERMISSION_HINT: Final = (
    "install systemd/70-hapticd.rules into /etc/udev/rules.d and plug the device in again, or run as the node's owner"
)
MAX_INPUT_REPORT_BYTES: Final = 4096
"""Length to which input reports are read; joysticks send far shorter ones."""


class Device(Protocol):
    """An open device. Its methods raise DeviceError if the device is gone or refuses a report."""

    @property
    def path(self) -> str:
        """Path of the device's hidraw node, or of the recording that is played."""
        ...

    def fileno(self) -> int:
        """Return a file descriptor, valid until `close`: one read or write transfers one input or output report."""
        ...

    def write(self, report: bytes) -> None:
        """Send an output report, its id first, and wait until it is sent."""
        ...

    def send_feature(self, report: bytes) -> None:
        """Send a feature report, its id first."""
        ...

    def get_feature(self, report_id: int, length: int) -> bytes:
        """Get a feature report of `length` bytes, its id first."""
        ...

    def listen(self, timeout_s: float) -> bytes:
        """Return the next input report, which `fileno` yields, too; empty if none arrives within `timeout_s`."""
        ...

    def close(self) -> None:
        """Close the device. No other method may be called afterwards."""
        ...


class Driver(Protocol):
    """Driver that sets up the devices of one class, for example of the PID class."""

    def set_up(self, device: Device) -> Plan:
        """Set up the device with a force of zero, and return the plan of its reports. Raises DeviceError."""
        ...


def arrived_reports(fd: int, within_s: float = 0.0) -> Iterator[bytes]:
    """Yield the input reports of a device that arrive within `within_s`; 0 yields those that are already queued.

    Raises DeviceError if the device is gone.
    """
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    until_s = time.monotonic() + within_s
    try:
        while poll.poll(1e3 * max(0.0, until_s - time.monotonic())):
            report = os.read(fd, MAX_INPUT_REPORT_BYTES)
            if not report:
                raise DeviceError("the device is gone")
            yield report
    except OSError as error:
        raise DeviceError(f"the device is gone: {error.strerror}") from None


class HidrawDevice:
    """A hidraw node, locked against other daemons.

    Raises DeviceError if the node is absent or busy, or may not be opened.
    """

    def __init__(self, path: str) -> None:
        import hidraw

        self._path = path
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except PermissionError:
            raise DeviceError(f"{path}: no permission: {PERMISSION_HINT}") from None
        except OSError as error:
            raise DeviceError(f"{path}: {error.strerror}") from None
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._fd)
            raise DeviceError(f"{path}: busy: another daemon drives it; stop it, or choose another device") from None
        self._hidapi = hidraw.device()
        try:
            self._hidapi.open_path(os.fsencode(path))
        except OSError:
            os.close(self._fd)
            raise DeviceError(f"{path}: hidapi cannot open it: {_last_error(self._hidapi)}") from None

    @property
    def path(self) -> str:
        """Path of the hidraw node."""
        return self._path

    def fileno(self) -> int:
        """Return the file descriptor of the hidraw node."""
        return self._fd

    def write(self, report: bytes) -> None:
        """Send an output report."""
        if self._hidapi.write(report) != len(report):
            raise DeviceError(f"{self._path}: cannot send output report {report[0]}: {_last_error(self._hidapi)}")

    def send_feature(self, report: bytes) -> None:
        """Send a feature report."""
        if self._hidapi.send_feature_report(report) != len(report):
            raise DeviceError(f"{self._path}: cannot send feature report {report[0]}: {_last_error(self._hidapi)}")

    def get_feature(self, report_id: int, length: int) -> bytes:
        """Get a feature report of `length` bytes, its id first."""
        try:
            return bytes(self._hidapi.get_feature_report(report_id, length))
        except OSError:
            reason = _last_error(self._hidapi)
            raise DeviceError(f"{self._path}: cannot get feature report {report_id}: {reason}") from None

    def listen(self, timeout_s: float) -> bytes:
        """Return the next input report; empty if none arrives within `timeout_s`."""
        try:
            return bytes(self._hidapi.read(MAX_INPUT_REPORT_BYTES, max(1, round(1e3 * timeout_s))))
        except OSError:
            raise DeviceError(f"{self._path}: the device is gone") from None

    def close(self) -> None:
        """Close the hidraw node, and so release its lock."""
        self._hidapi.close()
        os.close(self._fd)


def _last_error(hidapi: object) -> str:
    try:
        reason = hidapi.error()  # type: ignore[attr-defined]
    except (OSError, ValueError):
        return "the device is gone"
    return collapse_whitespace(str(reason)) or "no reason given"
