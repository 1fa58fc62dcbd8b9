"""Recordings of devices: the report descriptor, and input reports with their times.

A recording is text, one JSON value per line: first a map with `recording` (the version of the format, 1), `name`,
`vendor`, `product` and `descriptor` (hex), then `[t_s, "report in hex"]` for each report, its id first if reports have
ids. `hapticd devices dump` writes a recording; `device: {kind: replay}` plays it as if it were the device, and discards
forces.
"""

from __future__ import annotations

import json
import os
import select
import socket
import stat
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

from hapticd.base.errors import HapticdError, collapse_whitespace, shown
from hapticd.base.files import write_atomically
from hapticd.config.hid import Replay
from hapticd.hid.device import MAX_INPUT_REPORT_BYTES, arrived_reports
from hapticd.hid.plan import DeviceError

RECORDING_VERSION: Final = 1
"""Version of the file format, which the member `recording` of the first line contains."""
_HEADER_MEMBERS: Final = ("recording", "name", "vendor", "product", "descriptor")
"""Members of the map in a recording's first line, all required."""
MIN_ROUND_PAUSE_S: Final = 1e-3
"""Shortest pause before a recording is repeated, so that a recording of zero length does not keep a processor busy."""


@dataclass(frozen=True, slots=True)
class Recording:
    """The input reports and the report descriptor of a device."""

    name: str
    vendor: int
    product: int
    descriptor: bytes
    reports: tuple[tuple[float, bytes], ...]
    """Pairs of the time since the beginning, in s, ascending, and the report as hidraw returns it."""

    @property
    def on_change(self) -> bool:
        """Whether the device reports only changes: each report differs from the previous one."""
        return all(before[1] != after[1] for before, after in pairwise(self.reports))


def save(path: str | os.PathLike[str], recording: Recording, overwrite: bool) -> None:
    """Write a recording to a file. Raises HapticdError."""
    head = {
        "recording": RECORDING_VERSION,
        "name": recording.name,
        "vendor": recording.vendor,
        "product": recording.product,
        "descriptor": recording.descriptor.hex(),
    }
    lines = [json.dumps([round(time_s, 6), report.hex()]) for time_s, report in recording.reports]
    write_atomically(path, "\n".join([json.dumps(head), *lines, ""]), overwrite)


def load(path: str | os.PathLike[str]) -> Recording:
    """Read a recording. Raises HapticdError with file and line if the file is not a valid recording."""
    name = place = os.fspath(path)
    recording: Recording | None = None
    reports: list[tuple[float, bytes]] = []
    try:
        # Other files, such as pipes, may block or have no end.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise HapticdError(f"{name}: not a recording: not a regular file")
        with open(path, encoding="utf-8-sig") as file:
            for number, line in enumerate(file, 1):
                place = f"{name}:{number}"
                if not line.strip():
                    continue
                value = json.loads(line)
                if recording is None:
                    recording = _header(value)
                else:
                    reports.append(_report(value, reports[-1][0] if reports else 0.0))
    except OSError as error:
        raise HapticdError(f"{name}: {error.strerror}") from None
    except (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RecursionError) as error:
        why = collapse_whitespace(str(error))
        raise HapticdError(f"{place}: not a line of a recording of `hapticd devices dump`: {why}") from None
    if recording is None or not reports:
        raise HapticdError(f"{name}: contains no reports; move the device while it is recorded")
    return replace(recording, reports=tuple(reports))


def _header(value: dict[str, Any]) -> Recording:
    if value.get("recording", RECORDING_VERSION) != RECORDING_VERSION:
        raise ValueError(f"recording: must be version {RECORDING_VERSION}, is {shown(value['recording'])}")
    missing = [name for name in _HEADER_MEMBERS if name not in value]
    if missing:
        raise ValueError(f"the first line must have {', '.join(missing)}")
    descriptor = bytes.fromhex(value["descriptor"])
    return Recording(str(value["name"]), int(value["vendor"]), int(value["product"]), descriptor, ())


def _report(value: list[Any], before_s: float) -> tuple[float, bytes]:
    time_s, report = float(value[0]), bytes.fromhex(value[1])
    if not before_s <= time_s <= 1e6:
        raise ValueError(f"the time must be between {before_s:g} and 1e+06 s, is {shown(value[0])}")
    if not 0 < len(report) <= MAX_INPUT_REPORT_BYTES:
        raise ValueError(f"a report must have 1 to {MAX_INPUT_REPORT_BYTES} bytes, this one has {len(report)}")
    return time_s, report


def record(fd: int, duration_s: float) -> tuple[tuple[float, bytes], ...]:
    """Return the input reports, with their times, that a device sends within `duration_s` or until it is gone."""
    reports: list[tuple[float, bytes]] = []
    start_s = time.monotonic()
    with suppress(DeviceError):
        for report in arrived_reports(fd, duration_s):
            reports.append((time.monotonic() - start_s, report))
    return tuple(reports)


class ReplayDevice:
    """A device that plays the input reports of a recording in a separate thread, and discards output reports.

    At its end the recording is repeated, or the device is gone as if it had been unplugged.
    """

    def __init__(self, recording: Recording, replay: Replay) -> None:
        self._recording = recording
        self._replay = replay
        # SOCK_SEQPACKET: one report per read, as with hidraw.
        self._ours, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._wake, self._closing = socket.socketpair()
        self.over = threading.Event()
        """Set when the recording has been played."""
        self._thread = threading.Thread(target=self._play, name="replay", daemon=True)
        self._thread.start()

    @property
    def path(self) -> str:
        """Path of the recording."""
        return self._replay.path

    def fileno(self) -> int:
        """Return a file descriptor that reads the recording's input reports, and discards what is written."""
        return self._ours.fileno()

    def write(self, report: bytes) -> None:
        """Discard an output report."""
        try:
            self._ours.send(report)
        except OSError as error:
            raise DeviceError(f"{self.path}: {error.strerror}") from None

    def send_feature(self, report: bytes) -> None:
        """Discard a feature report."""

    def get_feature(self, report_id: int, length: int) -> bytes:
        """Raise DeviceError: a recording contains no feature reports."""
        raise DeviceError(f"{self.path}: a recording has no feature report {report_id}")

    def listen(self, timeout_s: float) -> bytes:
        """Return b"": listening is not needed, because `Recording.on_change` shows whether all reports differ."""
        return b""

    def close(self) -> None:
        """End the thread that plays the recording, and close the sockets between it and the reader."""
        self._closing.close()
        self._thread.join()
        self._wake.close()
        self._ours.close()

    def _play(self) -> None:
        reports, speed = self._recording.reports, self._replay.speed
        # Pause between the last report and the first of the next round: the average interval of two reports.
        pause_s = max(reports[-1][0] / len(reports), MIN_ROUND_PAUSE_S)
        start = time.monotonic()
        try:
            while True:
                for time_s, report in reports:
                    if not self._wait_until(start + time_s / speed):
                        return
                    # A report is lost if it is not read in time, as with hidraw.
                    with suppress(BlockingIOError):
                        self._theirs.send(report, socket.MSG_DONTWAIT)
                start += (reports[-1][0] + pause_s) / speed
                if not self._replay.loop:
                    self.over.set()
                    return
        except OSError:
            return  # the other end is closed
        finally:
            self._theirs.close()

    def _wait_until(self, when: float) -> bool:
        """Discard output reports until the time `when` (time.monotonic()); return False if the device was closed."""
        while True:
            left = when - time.monotonic()
            ready, _, _ = select.select((self._theirs, self._wake), (), (), max(0.0, left))
            if self._wake in ready or (ready and not self._theirs.recv(MAX_INPUT_REPORT_BYTES)):
                return False
            if not ready and left <= 0:
                return True
