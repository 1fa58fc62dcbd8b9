"""A device as set-up sees it: reports go out, features come in, and a descriptor of a file carries the rest.

`HidrawDevice` is a hidraw node: set-up goes through hidapi, positions and forces through a file descriptor that C reads
and writes. What stands in for it in a replay keeps the same few methods.
"""

from __future__ import annotations

import fcntl
import os
import select
import time
from collections.abc import Iterator
from typing import Final, Protocol

from hapticd.base.errors import on_one_line
from hapticd.hid.plan import DeviceError, Plan

RULE: Final = "install systemd/70-hapticd.rules into /etc/udev/rules.d and plug it in again, or run as its owner"
MAX_REPORT_BYTES: Final = 4096


class Device(Protocol):
    """An open device. Methods raise DeviceError when it is gone or refuses."""

    @property
    def path(self) -> str:
        """Its node, or the file that stands for it."""
        ...

    def fileno(self) -> int:
        """Reads input reports, takes output reports, one each time; valid until `close`."""
        ...

    def write(self, report: bytes) -> None:
        """Sends an output report, its id first, and waits until it is sent."""
        ...

    def send_feature(self, report: bytes) -> None:
        """Sends a feature report, its id first."""
        ...

    def get_feature(self, report_id: int, length: int) -> bytes:
        """Asks for a feature report of `length` bytes with its id, which comes first."""
        ...

    def listen(self, timeout_s: float) -> bytes:
        """The next input report, which `fileno` gives as well; empty if none comes in time."""
        ...

    def close(self) -> None:
        """Lets it go; after that nothing else may be called."""
        ...


class Driver(Protocol):
    """How a kind of device is set up and driven."""

    def set_up(self, device: Device) -> Plan:
        """Makes it ready, with a force of zero. Raises DeviceError."""
        ...


def arriving(fd: int, within_s: float = 0.0) -> Iterator[bytes]:
    """The input reports of a device that arrive within a time; those that wait there, where it is 0. Raises DeviceError
    when the device is gone."""
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    until_s = time.monotonic() + within_s
    try:
        while poll.poll(1e3 * max(0.0, until_s - time.monotonic())):
            report = os.read(fd, MAX_REPORT_BYTES)
            if not report:
                raise DeviceError("the device is gone")
            yield report
    except OSError as error:
        raise DeviceError(f"the device is gone: {error.strerror}") from None


class HidrawDevice:
    """A hidraw node, ours alone among daemons. Raises DeviceError: absent, no permission, busy."""

    def __init__(self, path: str) -> None:
        import hidraw

        self._path = path
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except PermissionError:
            raise DeviceError(f"{path}: no permission: {RULE}") from None
        except OSError as error:
            raise DeviceError(f"{path}: {error.strerror}") from None
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._fd)
            raise DeviceError(f"{path}: busy: another daemon drives it; stop that one, or choose another") from None
        self._hidapi = hidraw.device()
        try:
            self._hidapi.open_path(os.fsencode(path))
        except OSError:
            os.close(self._fd)
            raise DeviceError(f"{path}: hidapi cannot open it: {_last(self._hidapi)}") from None

    @property
    def path(self) -> str:
        return self._path

    def fileno(self) -> int:
        return self._fd

    def write(self, report: bytes) -> None:
        if self._hidapi.write(report) != len(report):
            raise DeviceError(f"{self._path}: output report {report[0]} is refused: {_last(self._hidapi)}")

    def send_feature(self, report: bytes) -> None:
        if self._hidapi.send_feature_report(report) != len(report):
            raise DeviceError(f"{self._path}: feature report {report[0]} is refused: {_last(self._hidapi)}")

    def get_feature(self, report_id: int, length: int) -> bytes:
        try:
            return bytes(self._hidapi.get_feature_report(report_id, length))
        except OSError:
            raise DeviceError(f"{self._path}: feature report {report_id} is not given: {_last(self._hidapi)}") from None

    def listen(self, timeout_s: float) -> bytes:
        """The next input report of hidapi's own queue."""
        try:
            return bytes(self._hidapi.read(MAX_REPORT_BYTES, max(1, round(1e3 * timeout_s))))
        except OSError:
            raise DeviceError(f"{self._path}: the device is gone") from None

    def close(self) -> None:
        self._hidapi.close()
        os.close(self._fd)


def _last(hidapi: object) -> str:
    try:
        reason = hidapi.error()  # type: ignore[attr-defined]
    except (OSError, ValueError):
        return "the device is gone"
    return on_one_line(str(reason)) or "no reason given"
