"""`hapticd stop-device` stops a device that its daemon left running; systemd runs it after every end of the daemon.

Before a daemon sends forces to a real device, it writes a record into its runtime directory: the device's node, its
identity, and the reports that set its force to zero and stop its effects. The daemon removes the record when it has
sent these reports itself at an orderly end. `stop_device` sends them if the record exists, unless the node belongs to
another device now.

This module imports little, so that `hapticd stop-device` starts fast.
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

from hapticd.base.errors import HapticdError, collapse_whitespace, quoted
from hapticd.base.files import write_atomically
from hapticd.system.trusted_files import read_trusted

SYSFS_ROOT: Final = Path("/sys")
STOP_DEADLINE_S: Final = 3.0
"""`hapticd stop-device` gives up if the device has not accepted its reports within this time."""
_RECORD_VERSION: Final = 1
_MAX_RECORD_BYTES: Final = 1 << 16
"""A larger file cannot be a record."""
_IDENTITY_KEYS: Final = ("HID_ID", "HID_NAME", "HID_PHYS", "HID_UNIQ")
"""The keys of a device's uevent in sysfs that identify it."""
_GONE_ERRNOS: Final = (errno.ENODEV, errno.ENXIO, errno.ENOENT)
"""Errors of a device that was unplugged."""


@dataclass(frozen=True, slots=True)
class Identity:
    """The identity of a hidraw node: its device number, and the values that identify the device in sysfs."""

    major: int
    minor: int
    device: dict[str, str]
    """The values of HID_ID, HID_NAME, HID_PHYS and HID_UNIQ in the device's uevent."""

    def __str__(self) -> str:
        return quoted(self.device.get("HID_NAME", "no name"))


def identity_of(status: os.stat_result, sysfs: Path = SYSFS_ROOT) -> Identity | None:
    """Return the identity of a node; None if it is not a hidraw node."""
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
    return Identity(major, minor, {key: uevent[key] for key in _IDENTITY_KEYS if key in uevent})


@dataclass(frozen=True, slots=True)
class Record:
    """What is needed to stop a device without its daemon: its node, its identity, and the reports that stop it."""

    path: str
    identity: Identity
    zero: tuple[bytes, ...]
    """Output reports for a force of zero, ids first."""
    stop: tuple[bytes, ...]
    """Output reports that stop the effects or disable the actuators, ids first."""
    pause_s: float = 0.0
    """Shortest pause between two reports."""


class StopFile:
    """The file with the reports that stop a daemon's device (`Record`), in the daemon's runtime directory."""

    def __init__(self, path: Path, identify: Callable[[int], Identity | None] | None = None) -> None:
        """Use the file at `path`. `identify` returns the identity of an open device, given its file descriptor."""
        self.path = path
        self._identify = identify or (lambda fd: identity_of(os.fstat(fd)))

    def keep(self, path: str, fd: int, zero: Sequence[bytes], stop: Sequence[bytes], pause_s: float) -> None:
        """Write the record of a device atomically; does nothing if `fd` does not belong to a hidraw node.

        Raises HapticdError; without the record no force may be sent.
        """
        identity = self._identify(fd)
        if identity is None:
            return
        record = {
            "version": _RECORD_VERSION,
            "path": path,
            "identity": asdict(identity),
            "zero": [report.hex() for report in zero],
            "stop": [report.hex() for report in stop],
            "pause_s": pause_s,
        }
        if self.path.is_symlink():  # otherwise its target would be written; `load` refuses a link anyway
            self.path.unlink()
        for part in self.path.parent.glob(f".{self.path.name}.*.part"):  # left by a killed daemon
            part.unlink(missing_ok=True)
        write_atomically(self.path, json.dumps(record), overwrite=True, mode=0o600)

    def drop(self) -> None:
        """Remove the record, after the daemon has set the device's force to zero."""
        self.path.unlink(missing_ok=True)


def load(path: Path) -> Record | None:
    """Read a record; returns None if the file does not exist.

    Raises HapticdError if other users could have written the file, or if it is not a valid record.
    """
    if path.is_symlink():
        raise HapticdError(f"{path}: must be a regular file of the daemon, is a symbolic link")
    try:
        text = read_trusted(path, _MAX_RECORD_BYTES)
    except HapticdError:
        if os.path.lexists(path):
            raise
        return None
    try:
        record = json.loads(text)
        if record["version"] != _RECORD_VERSION:
            raise ValueError(f"version: must be {_RECORD_VERSION}")
        identity, pause_s = record["identity"], float(record["pause_s"])
        zero, stop = (tuple(map(bytes.fromhex, record[name])) for name in ("zero", "stop"))
        is_path = os.path.isabs(record["path"]) and "\0" not in record["path"]
        if not (is_path and 0.0 <= pause_s <= 10.0 and all((*zero, *stop))):
            raise ValueError("path must be absolute, pause_s at most 10 s, and no report empty")
        known = Identity(int(identity["major"]), int(identity["minor"]), dict(identity["device"]))
        return Record(record["path"], known, zero, stop, pause_s)
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise HapticdError(f"{path}: not a record of a device: {collapse_whitespace(str(error))}") from None


def stop_device(
    path: Path,
    *,
    sysfs: Path = SYSFS_ROOT,
    deadline_s: float = STOP_DEADLINE_S,
    open_node: Callable[[Record], int] | None = None,
    write: Callable[[int, bytes], int] = os.write,
) -> str | None:
    """Send the reports of the record at `path`, remove the record, and return what was done, in one line.

    Returns None if no record exists. `open_node`, if given, opens the node without a check of the device's identity;
    `write` writes a report. Raises HapticdError if the device may still push.
    """
    record = load(path)
    if record is None:
        return None
    until_s = time.monotonic() + deadline_s
    what = f"{record.path} ({record.identity})"
    try:
        fd = open_node(record) if open_node is not None else _open(record, sysfs)
    except _DeviceAbsentError as error:
        path.unlink(missing_ok=True)
        return f"{what}: {error}"
    except OSError as error:
        raise HapticdError(f"{what}: cannot open it: {error.strerror}; it may still push") from None
    with os.fdopen(fd, "wb", buffering=0):
        _lock(fd, what, until_s)
        try:
            refused = _send(fd, record, what, until_s, write)
        except _DeviceAbsentError as error:
            path.unlink(missing_ok=True)
            return f"{what}: {error}"
    path.unlink(missing_ok=True)
    count = len(record.zero) + len(record.stop)
    suffix = f"; {len(refused)} of {count} reports were refused: {refused[0]}" if refused else f", {count} reports"
    return f"{what}: force zero, effects stopped{suffix}"


class _DeviceAbsentError(Exception):
    """The device of the record is not connected."""


def _open(record: Record, sysfs: Path) -> int:
    """Open the record's node if it still belongs to the same device. Raises _DeviceAbsentError, OSError."""
    try:
        # Checked before it is opened, because opening alone could affect another device.
        _check_identity(record, identity_of(os.lstat(record.path), sysfs))
        fd = os.open(record.path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        if error.errno in _GONE_ERRNOS:
            raise _DeviceAbsentError("no longer connected; nothing was sent") from None
        raise
    try:
        _check_identity(record, identity_of(os.fstat(fd), sysfs))
    except BaseException:
        os.close(fd)
        raise
    return fd


def _check_identity(record: Record, found: Identity | None) -> None:
    if found is None:
        raise _DeviceAbsentError("no longer a HID device; nothing was sent")
    if found != record.identity:
        raise _DeviceAbsentError(f"now another device, {found}; nothing was sent")


def _lock(fd: int, what: str, until_s: float) -> None:
    """Lock the device once a killed daemon's lock has ended. Raises HapticdError if the lock lasts beyond `until_s`."""
    while True:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise HapticdError(f"{what}: a daemon drives it; stop that daemon") from None
            time.sleep(0.01)


def _send(fd: int, record: Record, what: str, until_s: float, write: Callable[[int, bytes], int]) -> list[str]:
    """Write all reports of the record, and return a text for each report that the device refused.

    Raises HapticdError unless the device accepts all reports for a force of zero, or all that stop its effects, before
    `until_s`; _DeviceAbsentError if the device is gone. A separate thread writes, because a write may hang.
    """
    reports = [*record.zero, *record.stop]
    pause_s = min(record.pause_s, STOP_DEADLINE_S / 2.0 / len(reports)) if reports else 0.0
    problems: dict[int, OSError] = {}
    given_up = threading.Event()
    # A duplicate for the thread: a write that returns late must not use a number that was reused after close.
    own = os.dup(fd)

    def send() -> None:
        try:
            for number, report in enumerate(reports):
                if given_up.is_set():
                    return
                try:
                    if write(own, report) != len(report):
                        raise OSError(errno.EIO, "only a part was written")
                except OSError as error:
                    problems[number] = error
                    if error.errno in _GONE_ERRNOS:
                        return
                given_up.wait(pause_s)
        finally:
            os.close(own)

    writer = threading.Thread(target=send, name="stop", daemon=True)
    try:
        writer.start()
    except RuntimeError:
        send()  # no thread can be started: rather risk to hang than leave the device with its force
    else:
        writer.join(max(0.0, until_s - time.monotonic()))
    if writer.is_alive():
        given_up.set()
        raise HapticdError(f"{what}: does not accept reports; it may still push")
    if any(error.errno in _GONE_ERRNOS for error in problems.values()):
        raise _DeviceAbsentError("was unplugged while it was stopped")
    refused = [f"report {reports[number].hex(' ')}: {error.strerror}" for number, error in sorted(problems.items())]
    zeroed = bool(record.zero) and min(problems, default=len(reports)) >= len(record.zero)
    stopped = bool(record.stop) and max(problems, default=-1) < len(record.zero)
    if not zeroed and not stopped:
        raise HapticdError(f"{what}: refuses {len(refused)} of {len(reports)} reports, {refused[0]}; it may still push")
    return refused
