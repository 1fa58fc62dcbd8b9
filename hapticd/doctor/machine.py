"""Access to the machine for the checks: files below a root, limits, commands. Tests replace each of them."""

from __future__ import annotations

import grp
import os
import re
import resource
import socket
import struct
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from hapticd.base.errors import HapticdError
from hapticd.hid.discovery import SysfsDevice, find

if TYPE_CHECKING:
    from hapticd.config.hid import Hid

_MAX_FILE_BYTES: Final = 1 << 18
"""At most this much of a file is read; the largest file, the kernel's configuration, is smaller."""
_COMMAND_TIMEOUT_S: Final = 5.0
"""A command that runs for longer, such as systemctl, is killed and counts as unanswered."""

Verdict = Literal["ok", "warn", "fail"]


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of a check, one line of output: its name, its verdict, what was found, and what to do about it."""

    name: str
    verdict: Verdict
    what: str
    todo: str = ""

    def __str__(self) -> str:
        return f"{self.verdict:<5} {self.name:<12} {self.what}" + (f"; {self.todo}" if self.todo else "")


def ok(name: str, what: str) -> Finding:
    """Return the result of a check that passed and needs no action."""
    return Finding(name, "ok", what)


def warn(name: str, what: str, todo: str) -> Finding:
    """Return a warning, with the action that would remove it."""
    return Finding(name, "warn", what, todo)


def fail(name: str, what: str, todo: str) -> Finding:
    """Return a failure, with the action that would remove it."""
    return Finding(name, "fail", what, todo)


def unknown(name: str, why: str) -> Finding:
    """Return a warning that a check has no result; `why` says what cannot be read."""
    return Finding(name, "warn", f"not known: {why}")


@dataclass(frozen=True, slots=True)
class Needs:
    """What a configuration requires of the machine."""

    realtime: Literal["required", "preferred", "off"] = "preferred"
    priority: int = 80
    cpu: int | None = None
    device: Hid | None = None
    """The configuration of the HID joystick; None if the configuration drives no HID joystick."""

    def verdict_without_realtime(self) -> Verdict:
        """Return the verdict of a check which finds that real-time scheduling is unavailable."""
        return {"required": "fail", "preferred": "warn", "off": "ok"}[self.realtime]  # type: ignore[return-value]


def command_output(words: Sequence[str]) -> str | None:
    """Return the standard output of a command; None if the command does not exist, fails or takes too long."""
    try:
        done = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_COMMAND_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def socket_holder(path: Path) -> tuple[int, bool] | None:
    """Return the id of the process that listens on a Unix socket, and whether SIGSTOP or a debugger has stopped it.

    Returns None if no process listens there, or if it is not known. Never blocks. Raises HapticdError if the process's
    queue of connections is full.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as own:
        try:
            own.connect(os.fspath(path))
            # The credentials of the listener, as the kernel noted them when it began to listen.
            pid, _, _ = struct.unpack("3i", own.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        except BlockingIOError:
            raise HapticdError(f"{path}: the daemon does not answer: its queue of connections is full") from None
        except (OSError, ValueError):
            return None
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return None
    return pid, state in "Tt"


def group_name(gid: int) -> str | None:
    """Return the name of a group; None for a group without a name."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return None


@dataclass(frozen=True, slots=True)
class Machine:
    """The sources that the checks read: a root of files, and functions that query the system."""

    root: Path = Path("/")
    limit: Callable[[int], tuple[int, int]] = resource.getrlimit
    """Returns the soft and the hard limit of a resource, by its number."""
    group: Callable[[int], str | None] = group_name
    """Returns the name of a group, by its number."""
    run: Callable[[Sequence[str]], str | None] = command_output
    daemon: Callable[[], Mapping[str, object] | None] = field(default=lambda: None)
    """Returns the daemon's status; None without a daemon. Raises HapticdError if the daemon does not answer in time."""
    version: str = ""
    """The version of the installed package."""
    may_write: Callable[[Path], bool] = lambda path: os.access(path, os.W_OK)
    find: Callable[[Path, Path], list[SysfsDevice]] = find
    """Lists HID devices, given the folders /sys/class/hidraw and /dev."""

    def path(self, name: str) -> Path:
        """Return where the file with the absolute path `name` is below the root of the checks."""
        return self.root / name.lstrip("/")

    def text(self, name: str) -> str | None:
        """Return the text of a file without its final newlines; None if it cannot be read."""
        try:
            fd = os.open(self.path(name), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            with open(fd, "rb") as file:
                return file.read(_MAX_FILE_BYTES).decode("utf-8", "replace").rstrip("\n")
        except OSError:
            return None

    def names(self, folder: str, pattern: str) -> list[str]:
        """Return the names in a folder that match, in numerical order; [] if the folder cannot be read."""
        try:
            found = [name for name in os.listdir(self.path(folder)) if re.fullmatch(pattern, name)]
        except OSError:
            return []
        return sorted(found, key=lambda name: (int(re.sub(r"\D", "", name) or 0), name))


def parse_cpu_list(text: str) -> set[int]:
    """Return the processor numbers in a list that the kernel has written, such as 0-3,6."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if first.isdecimal() and (last.isdecimal() or not last):
            found.update(range(int(first), min(int(last or first), 8191) + 1))
    return found
