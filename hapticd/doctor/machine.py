"""The machine as the checks see it: files below a root, and a few questions that a test answers itself."""

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
from hapticd.hid.discovery import Found, find

if TYPE_CHECKING:
    from hapticd.config.hid import Hid

_MOST_BYTES: Final = 1 << 18
"""Of a file that is read; a kernel's configuration is the largest."""
_COMMAND_S: Final = 5.0

Verdict = Literal["ok", "warn", "fail"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One line: what was checked, how it is, and what to do about it."""

    name: str
    verdict: Verdict
    what: str
    todo: str = ""

    def __str__(self) -> str:
        return f"{self.verdict:<5} {self.name:<12} {self.what}" + (f"; {self.todo}" if self.todo else "")


def ok(name: str, what: str) -> Finding:
    return Finding(name, "ok", what)


def warn(name: str, what: str, todo: str) -> Finding:
    return Finding(name, "warn", what, todo)


def fail(name: str, what: str, todo: str) -> Finding:
    return Finding(name, "fail", what, todo)


def unknown(name: str, where: str) -> Finding:
    """What cannot be found out."""
    return Finding(name, "warn", f"not known: {where}")


@dataclass(frozen=True, slots=True)
class Needs:
    """What a configuration asks of the machine."""

    realtime: Literal["required", "preferred", "off"] = "preferred"
    priority: int = 80
    cpu: int | None = None
    device: Hid | None = None
    """The joystick that is to be driven, and how; None: none is."""

    def without(self) -> Verdict:
        """How bad it is when real time cannot be had."""
        return {"required": "fail", "preferred": "warn", "off": "ok"}[self.realtime]  # type: ignore[return-value]


def run(words: Sequence[str]) -> str | None:
    """What a command says; None where it is not there, fails, or takes too long."""
    try:
        done = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_COMMAND_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def holder(path: Path) -> tuple[int, bool] | None:
    """The process that listens on a Unix socket, and whether it is stopped, by SIGSTOP or by a debugger; None where
    nobody does, or it cannot be found out. Waits for nothing.

    Raises HapticdError where no more connections may wait there.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as own:
        try:
            own.connect(os.fspath(path))
            # The credentials of the listener, as the kernel noted them when it began to listen.
            pid, _, _ = struct.unpack("3i", own.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        except BlockingIOError:
            raise HapticdError(f"{path}: nobody accepts connections any more: its daemon does not answer") from None
        except (OSError, ValueError):
            return None
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return None
    return pid, state in "Tt"


def group_name(gid: int) -> str | None:
    """None for a group without a name."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return None


@dataclass(frozen=True, slots=True)
class Machine:
    """Where to look, and whom to ask."""

    root: Path = Path("/")
    limit: Callable[[int], tuple[int, int]] = resource.getrlimit
    """Soft and hard limit."""
    group: Callable[[int], str | None] = group_name
    run: Callable[[Sequence[str]], str | None] = run
    daemon: Callable[[], Mapping[str, object] | None] = field(default=lambda: None)
    """The daemon's get_status; None where there is none. Raises HapticdError for one that does not answer in time."""
    version: str = ""
    """This package's."""
    may_write: Callable[[Path], bool] = lambda path: os.access(path, os.W_OK)
    find: Callable[[Path, Path], list[Found]] = find
    """HID devices, of a /sys/class/hidraw and a /dev."""

    def path(self, name: str) -> Path:
        """A file of the machine, by its absolute name."""
        return self.root / name.lstrip("/")

    def text(self, name: str) -> str | None:
        """What stands in a file, without the last line's end; None where it cannot be read."""
        try:
            fd = os.open(self.path(name), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            with open(fd, "rb") as file:
                return file.read(_MOST_BYTES).decode("utf-8", "replace").rstrip("\n")
        except OSError:
            return None

    def names(self, folder: str, pattern: str) -> list[str]:
        """Names in a folder that match, in the order of their numbers; empty where it cannot be read."""
        try:
            found = [name for name in os.listdir(self.path(folder)) if re.fullmatch(pattern, name)]
        except OSError:
            return []
        return sorted(found, key=lambda name: (int(re.sub(r"\D", "", name) or 0), name))


def processors(text: str) -> set[int]:
    """A list as the kernel writes it, such as 0-3,6."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if first.isdecimal() and (last.isdecimal() or not last):
            found.update(range(int(first), min(int(last or first), 8191) + 1))
    return found
