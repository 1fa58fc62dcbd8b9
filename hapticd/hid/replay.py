"""Recordings of devices: input reports with their times, and the report descriptor that says what they mean.

A recording is text, one JSON value a line: first a map with `recording` (the version of this format, 1), `name`,
`vendor`, `product` and `descriptor` (hex), then `[t_s, "report in hex"]` for each report, id first where they are
numbered. `hapticd devices dump` writes one, `device: {kind: replay}` plays it as if it were the device. Forces go
nowhere.
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

from hapticd.base.errors import HapticdError, on_one_line, shown
from hapticd.base.files import write_whole
from hapticd.config.hid import Replay
from hapticd.hid.device import MAX_REPORT_BYTES, arrived_reports
from hapticd.hid.plan import DeviceError

VERSION: Final = 1
_HEAD_MEMBERS: Final = ("recording", "name", "vendor", "product", "descriptor")
"""Members of the first line."""
LEAST_PAUSE_S: Final = 1e-3
"""Between two rounds, so that a recording that takes no time does not keep a processor busy."""


@dataclass(frozen=True, slots=True)
class Recording:
    """What a device reported."""

    name: str
    vendor: int
    product: int
    descriptor: bytes
    reports: tuple[tuple[float, bytes], ...]
    """Time in s from the beginning, rising, and the report as hidraw gives it."""

    @property
    def on_change(self) -> bool:
        """Whether the device reports only what changes: no report is like the one before it."""
        return all(before[1] != after[1] for before, after in pairwise(self.reports))


def save(path: str | os.PathLike[str], recording: Recording, overwrite: bool) -> None:
    """Writes a recording. Raises HapticdError."""
    head = {
        "recording": VERSION,
        "name": recording.name,
        "vendor": recording.vendor,
        "product": recording.product,
        "descriptor": recording.descriptor.hex(),
    }
    lines = [json.dumps([round(time_s, 6), report.hex()]) for time_s, report in recording.reports]
    write_whole(path, "\n".join([json.dumps(head), *lines, ""]), overwrite)


def load(path: str | os.PathLike[str]) -> Recording:
    """Reads a recording. Raises HapticdError, which names file and line, for what is none."""
    name = place = os.fspath(path)
    recording: Recording | None = None
    reports: list[tuple[float, bytes]] = []
    try:
        # Anything else may have no end, or keep whoever opens it waiting.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise HapticdError(f"{name}: is no recording: no regular file")
        with open(path, encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                place = f"{name}:{number}"
                if not line.strip():
                    continue
                value = json.loads(line)
                if recording is None:
                    recording = _head(value)
                else:
                    reports.append(_report(value, reports[-1][0] if reports else 0.0))
    except OSError as error:
        raise HapticdError(f"{name}: {error.strerror}") from None
    except (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RecursionError) as error:
        raise HapticdError(f"{place}: is no line of a recording: {on_one_line(str(error))}") from None
    if recording is None or not reports:
        raise HapticdError(f"{name}: holds no report: was the device moved while it was recorded?")
    return replace(recording, reports=tuple(reports))


def _head(value: dict[str, Any]) -> Recording:
    if value.get("recording", VERSION) != VERSION:
        raise ValueError(f"a recording of version {shown(value['recording'])}; this reads version {VERSION}")
    missing = [name for name in _HEAD_MEMBERS if name not in value]
    if missing:
        raise ValueError(f"the first line needs {', '.join(missing)}")
    descriptor = bytes.fromhex(value["descriptor"])
    return Recording(str(value["name"]), int(value["vendor"]), int(value["product"]), descriptor, ())


def _report(value: list[Any], before_s: float) -> tuple[float, bytes]:
    time_s, report = float(value[0]), bytes.fromhex(value[1])
    if not before_s <= time_s <= 1e6:
        raise ValueError(f"the time {shown(value[0])} does not follow {before_s:g}")
    if not 0 < len(report) <= MAX_REPORT_BYTES:
        raise ValueError(f"a report has 1 to {MAX_REPORT_BYTES} bytes, this one {len(report)}")
    return time_s, report


def record(fd: int, duration_s: float) -> tuple[tuple[float, bytes], ...]:
    """What a device reports for a time, or until it is gone."""
    reports: list[tuple[float, bytes]] = []
    start_s = time.monotonic()
    with suppress(DeviceError):
        for report in arrived_reports(fd, duration_s):
            reports.append((time.monotonic() - start_s, report))
    return tuple(reports)


class ReplayDevice:
    """A device that reports what a recording holds, in a separate thread, and takes every force.

    At the end it begins again, or is gone, as if it had been unplugged.
    """

    def __init__(self, recording: Recording, replay: Replay) -> None:
        self._recording = recording
        self._replay = replay
        # Message bounds are kept, as those of hidraw are.
        self._ours, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._wake, self._closing = socket.socketpair()
        self.over = threading.Event()
        """Set when the recording has been played."""
        self._thread = threading.Thread(target=self._play, name="replay", daemon=True)
        self._thread.start()

    @property
    def path(self) -> str:
        return self._replay.path

    def fileno(self) -> int:
        return self._ours.fileno()

    def write(self, report: bytes) -> None:
        try:
            self._ours.send(report)
        except OSError as error:
            raise DeviceError(f"{self.path}: {error.strerror}") from None

    def send_feature(self, report: bytes) -> None:
        """Takes a report."""

    def get_feature(self, report_id: int, length: int) -> bytes:
        """A recording answers no question. Raises DeviceError."""
        raise DeviceError(f"{self.path}: a recording has no feature report {report_id}")

    def listen(self, timeout_s: float) -> bytes:
        """Nothing: what a recording holds is known."""
        return b""

    def close(self) -> None:
        self._closing.close()
        self._thread.join()
        self._wake.close()
        self._ours.close()

    def _play(self) -> None:
        reports, speed = self._recording.reports, self._replay.speed
        # Between the last report and the first of the next round: as between two on average.
        pause_s = max(reports[-1][0] / len(reports), LEAST_PAUSE_S)
        start = time.monotonic()
        try:
            while True:
                for time_s, report in reports:
                    if not self._wait_until(start + time_s / speed):
                        return
                    # What nobody reads in time is lost, as it is with hidraw.
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
        """Takes forces until then; False: it is to end."""
        while True:
            left = when - time.monotonic()
            ready, _, _ = select.select((self._theirs, self._wake), (), (), max(0.0, left))
            if self._wake in ready or (ready and not self._theirs.recv(MAX_REPORT_BYTES)):
                return False
            if not ready and left <= 0:
                return True
