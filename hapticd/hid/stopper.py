"""Stops a device whose daemon could not: `hapticd stop-device`, which systemd runs whatever ended the daemon.

Before a daemon lets any force through to a real device, it writes into its runtime directory which node that is, how to
know it again, and the exact reports that take its force to zero and stop its effects. The record stays until an orderly
end did that itself. Whoever finds it sends those reports, unless the node is another device by now.

Nothing is loaded here that a process needs which lives for a moment.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import stat
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError, on_one_line, quoted
from hapticd.base.files import write_whole
from hapticd.system.trusted_files import read_trusted

SYSFS: Final = Path("/sys")
DEADLINE_S: Final = 3.0
"""A device that has not taken its reports by then is given up."""
_VERSION: Final = 1
_LARGEST_BYTES: Final = 1 << 16
_KEYS: Final = ("HID_ID", "HID_NAME", "HID_PHYS", "HID_UNIQ")
_GONE: Final = (errno.ENODEV, errno.ENXIO, errno.ENOENT)


@dataclass(frozen=True, slots=True)
class Identity:
    """How a hidraw node is known again: its number, and what its driver says of the device."""

    major: int
    minor: int
    device: dict[str, str]
    """HID_ID, HID_NAME, HID_PHYS and HID_UNIQ of its uevent."""

    def __str__(self) -> str:
        return quoted(self.device.get("HID_NAME", "no name"))


def identity_of(status: os.stat_result, sysfs: Path = SYSFS) -> Identity | None:
    """Of a node; None for whatever is no hidraw node."""
    if not stat.S_ISCHR(status.st_mode):
        return None
    major, minor = os.major(status.st_rdev), os.minor(status.st_rdev)
    entry = sysfs / "dev" / "char" / f"{major}:{minor}"
    try:
        if os.path.basename(os.readlink(entry / "subsystem")) != "hidraw":
            return None
        text = (entry / "device" / "uevent").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    uevent = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
    return Identity(major, minor, {key: uevent[key] for key in _KEYS if key in uevent})


@dataclass(frozen=True, slots=True)
class Record:
    """What stops one device."""

    path: str
    identity: Identity
    zero: tuple[bytes, ...]
    """Reports that say a force of zero, ids first."""
    stop: tuple[bytes, ...]
    """Reports that stop its effects, or switch it off."""
    pause_s: float = 0.0
    """What it needs between two reports."""


class StopFile:
    """The record in a daemon's runtime directory."""

    def __init__(self, path: Path, identify: Callable[[int], Identity | None] | None = None) -> None:
        """`identify`: of an open device's descriptor."""
        self.path = path
        self._identify = identify or (lambda fd: identity_of(os.fstat(fd)))

    def keep(self, path: str, fd: int, zero: Sequence[bytes], stop: Sequence[bytes], pause_s: float) -> None:
        """Writes it, whole or not at all; nothing for what is no real device. Raises HapticdError: without it no force
        may go out."""
        identity = self._identify(fd)
        if identity is None:
            return
        record = {
            "version": _VERSION,
            "path": path,
            "identity": asdict(identity),
            "zero": [report.hex() for report in zero],
            "stop": [report.hex() for report in stop],
            "pause_s": pause_s,
        }
        if self.path.is_symlink():  # its end would be written, and a link is never trusted
            self.path.unlink()
        for part in self.path.parent.glob(f".{self.path.name}.*.part"):  # of a daemon that was killed here
            part.unlink(missing_ok=True)
        write_whole(self.path, json.dumps(record), overwrite=True, mode=0o600)

    def drop(self) -> None:
        """The device is at zero."""
        self.path.unlink(missing_ok=True)


def load(path: Path) -> Record | None:
    """Reads a record; None where there is none. Raises HapticdError for one that others may have written, or that is no
    record."""
    if path.is_symlink():
        raise HapticdError(f"{path}: is a symbolic link; it must be a file of the daemon's own")
    try:
        text = read_trusted(path, _LARGEST_BYTES)
    except HapticdError:
        if os.path.lexists(path):
            raise
        return None
    try:
        record = json.loads(text)
        if record["version"] != _VERSION:
            raise ValueError(f"not of version {_VERSION}")
        identity, pause_s = record["identity"], float(record["pause_s"])
        zero, stop = (tuple(map(bytes.fromhex, record[name])) for name in ("zero", "stop"))
        is_path = os.path.isabs(record["path"]) and "\0" not in record["path"]
        if not (is_path and 0.0 <= pause_s <= 10.0 and all((*zero, *stop))):
            raise ValueError("no absolute path, a pause beyond 10 s or a report without bytes")
        known = Identity(int(identity["major"]), int(identity["minor"]), dict(identity["device"]))
        return Record(record["path"], known, zero, stop, pause_s)
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise HapticdError(f"{path}: is no record of a device: {on_one_line(str(error))}") from None


def stop_device(
    path: Path,
    *,
    sysfs: Path = SYSFS,
    deadline_s: float = DEADLINE_S,
    opened: Callable[[Record], int] | None = None,
    write: Callable[[int, bytes], int] = os.write,
) -> str | None:
    """Sends what the record at `path` says, and takes it away; what was done, in one line. None: there is no record.

    `opened` opens the node in the place of this module's own checks, `write` writes a report. Raises HapticdError where
    the device may still push.
    """
    record = load(path)
    if record is None:
        return None
    until_s = time.monotonic() + deadline_s
    what = f"{record.path} ({record.identity})"
    try:
        fd = opened(record) if opened is not None else _open(record, sysfs)
    except _NotThereError as error:
        path.unlink(missing_ok=True)
        return f"{what}: {error}"
    except OSError as error:
        raise HapticdError(f"{what}: cannot be opened: {error.strerror}; it may still push") from None
    with os.fdopen(fd, "wb", buffering=0):
        _lock(fd, what, until_s)
        try:
            refused = _send(fd, record, what, until_s, write)
        except _NotThereError as error:
            path.unlink(missing_ok=True)
            return f"{what}: {error}"
    path.unlink(missing_ok=True)
    count = len(record.zero) + len(record.stop)
    said = f"; {len(refused)} of {count} reports were refused: {refused[0]}" if refused else f", {count} reports"
    return f"{what}: force zero, effects stopped{said}"


class _NotThereError(Exception):
    """The device that is meant is not there."""


def _open(record: Record, sysfs: Path) -> int:
    """The node, if it is still the same device. Raises _NotThereError, OSError."""
    try:
        # Looked at before it is opened: opening alone may do something to what it is now.
        _check(record, identity_of(os.lstat(record.path), sysfs))
        fd = os.open(record.path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        if error.errno in _GONE:
            raise _NotThereError("is not connected any more; nothing was sent") from None
        raise
    try:
        _check(record, identity_of(os.fstat(fd), sysfs))
    except BaseException:
        os.close(fd)
        raise
    return fd


def _check(record: Record, found: Identity | None) -> None:
    if found is None:
        raise _NotThereError("is no HID device any more; nothing was sent")
    if found != record.identity:
        raise _NotThereError(f"is another device now, {found}; nothing was sent")


def _lock(fd: int, what: str, until_s: float) -> None:
    """Ours alone among daemons: one that is dead lets go when the kernel is done with it."""
    while True:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise HapticdError(f"{what}: a daemon drives it; stop that one") from None
            time.sleep(0.01)


def _send(fd: int, record: Record, what: str, until_s: float, write: Callable[[int, bytes], int]) -> list[str]:
    """Writes all reports, and says which were refused. Raises HapticdError where neither a force of zero nor the end of
    its effects was taken whole, in time (a write may hang in the kernel, so it is another thread's), _NotThereError."""
    reports = [*record.zero, *record.stop]
    pause_s = min(record.pause_s, DEADLINE_S / 2.0 / len(reports)) if reports else 0.0
    problems: dict[int, OSError] = {}
    given_up = threading.Event()
    # Its own: one that comes back late must not write to what has the number of a closed one by then.
    own = os.dup(fd)

    def send() -> None:
        try:
            for number, report in enumerate(reports):
                if given_up.is_set():
                    return
                try:
                    if write(own, report) != len(report):
                        raise OSError(errno.EIO, "taken in part")
                except OSError as error:
                    problems[number] = error
                    if error.errno in _GONE:
                        return
                given_up.wait(pause_s)
        finally:
            os.close(own)

    writer = threading.Thread(target=send, name="stop", daemon=True)
    try:
        writer.start()
    except RuntimeError:
        send()  # no thread is to be had: better to wait for a device that hangs than to leave each as it is
    else:
        writer.join(max(0.0, until_s - time.monotonic()))
    if writer.is_alive():
        given_up.set()
        raise HapticdError(f"{what}: does not take reports; it may still push")
    if any(error.errno in _GONE for error in problems.values()):
        raise _NotThereError("went away while it was told")
    refused = [f"report {reports[number].hex(' ')}: {error.strerror}" for number, error in sorted(problems.items())]
    zeroed = bool(record.zero) and min(problems, default=len(reports)) >= len(record.zero)
    stopped = bool(record.stop) and max(problems, default=-1) < len(record.zero)
    if not zeroed and not stopped:
        raise HapticdError(f"{what}: refuses {len(refused)} of {len(reports)} reports, {refused[0]}; it may still push")
    return refused
