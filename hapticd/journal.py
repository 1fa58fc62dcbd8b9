"""Where the daemon's log goes, and which events of the servo stand in it.

Under systemd, whose journal takes what the daemon writes to stderr, lines go to the journal by its own protocol
(https://systemd.io/JOURNAL_NATIVE_PROTOCOL/), with priority and fields: `journalctl -t hapticd HAPTICD_EVENT=fault`.
Else they go to stderr as text.
"""

from __future__ import annotations

import logging
import os
import socket
import struct
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

SOCKET: Final = "/run/systemd/journal/socket"
IDENTIFIER: Final = "hapticd"
PREFIX: Final = "HAPTICD_"
TELL_EVERY_NS: Final = 1_000_000_000
"""Events of one kind are told at once, and then at most so often."""

_LONGEST: Final = 48 * 1024
"""Bytes of a field; the journal's socket takes some 200 KiB in one message."""
_PRIORITIES: Final = (
    (logging.CRITICAL, 2),
    (logging.ERROR, 3),
    (logging.WARNING, 4),
    (logging.INFO, 6),
    (logging.NOTSET, 7),
)
"""Python's levels as those of syslog."""

_log = logging.getLogger("hapticd")


@contextmanager
def attached(environ: Mapping[str, str] | None = None, address: str = SOCKET) -> Iterator[None]:
    """Meanwhile lines of the log go to the journal if stderr does and the journal can be spoken to, else to stderr."""
    environ = os.environ if environ is None else environ
    if is_stderr(environ.get("JOURNAL_STREAM", "")) and os.path.exists(address):
        handler: logging.Handler = JournalHandler(address)
        handler.setFormatter(logging.Formatter("%(message)s"))
    else:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("hapticd: %(message)s"))
    root = logging.getLogger()
    level = root.level
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    try:
        yield
    finally:
        root.setLevel(level)
        root.removeHandler(handler)
        handler.close()


def is_stderr(stream: str) -> bool:
    """Whether $JOURNAL_STREAM, `DEVICE:INODE`, names what stderr is."""
    try:
        device, inode = map(int, stream.split(":"))
        status = os.fstat(2)
    except (ValueError, OSError):
        return False
    return (status.st_dev, status.st_ino) == (device, inode)


def datagram(fields: Mapping[str, object]) -> bytes:
    """Fields as the journal's socket takes them: a value with line ends is given with its length."""
    parts = []
    for name, value in fields.items():
        data = str(value).encode("utf-8", "backslashreplace")[:_LONGEST]
        if b"\n" in data:
            parts.append(b"%s\n%s%s\n" % (name.encode(), struct.pack("<Q", len(data)), data))
        else:
            parts.append(b"%s=%s\n" % (name.encode(), data))
    return b"".join(parts)


class JournalHandler(logging.Handler):
    """Sends records to the journal. It never waits: what the journal does not take is counted and told with the next
    line that it does take."""

    def __init__(self, address: str = SOCKET) -> None:
        super().__init__()
        self._address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """A record's `fields`, a mapping, become fields of the line: `event` is HAPTICD_EVENT."""
        try:
            data = datagram(self._fields(record))
        except Exception:
            self.handleError(record)  # a line that cannot be made costs no thread
            return
        try:
            self._socket.sendto(data, self._address)
        except OSError:
            self._lost += 1  # told with the next line that gets through
        else:
            self._lost = 0

    def _fields(self, record: logging.LogRecord) -> dict[str, object]:
        priority = next(number for level, number in _PRIORITIES if record.levelno >= level)
        fields: dict[str, object] = {
            "MESSAGE": self.format(record),
            "PRIORITY": priority,
            "SYSLOG_IDENTIFIER": IDENTIFIER,
            "CODE_FILE": record.pathname,
            "CODE_LINE": record.lineno,
            "CODE_FUNC": record.funcName,
        }
        told: Mapping[str, object] = getattr(record, "fields", {})
        fields |= {PREFIX + name.upper(): value for name, value in told.items() if value is not None}
        if self._lost:
            fields[PREFIX + "LINES_LOST"] = self._lost
        return fields

    def close(self) -> None:
        self._socket.close()
        super().close()


# ---- Events --------------------------------------------------------------------------------------------------------


def _fault(event: Mapping[str, object]) -> str:
    faults = event["faults"]
    names = ", ".join(map(str, faults)) if isinstance(faults, list) else ""
    return f"fault: {names}; forces are off until set_forces turns them on" if names else "faults cleared"


def _overrun(event: Mapping[str, object]) -> str:
    return f"{event['missed']} periods missed, {event['count']} times"


_TOLD: Final[Mapping[str, tuple[int, Callable[[Mapping[str, object]], str]]]] = {
    "fault": (logging.ERROR, _fault),
    "device_lost": (logging.WARNING, lambda event: "the device does not report"),
    "device_found": (logging.INFO, lambda event: "the device reports again"),
    "overrun": (logging.WARNING, _overrun),
    "overload": (
        logging.WARNING,
        lambda event: f"overload: {100 * float(str(event['missed_share'])):.1f} % of a second's periods were missed",
    ),
    "rate": (logging.WARNING, lambda event: f"the servo goes on at {float(str(event['rate_hz'])):g} Hz"),
    "resumed": (
        logging.WARNING,
        lambda event: f"the machine was suspended for {float(str(event['suspended_s'])):.1f} s",
    ),
    "memory_refused": (
        logging.WARNING,
        lambda event: (
            f"locked memory for all objects: {event['problem']}; the rest is rendered from memory that is not"
        ),
    ),
    "glitch": (logging.WARNING, lambda event: f"the position jumped, at {float(str(event['speed_m_per_s'])):.3g} m/s"),
}
"""The events that stand in the log: how important each is, and its words. Others, contacts for example, do not."""


@dataclass(slots=True)
class _Held:
    """A kind of event that was told, and those that came since."""

    until_ns: int
    last: dict[str, object] | None = None
    more: int = 0


class EventLog:
    """Tells events of consequence in the log, once each; of a flood, a line a second with how many there were."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._held: dict[str, _Held] = {}

    def note(self, event: Mapping[str, object]) -> None:
        """Takes one event, a map as telemetry sends it."""
        kind = str(event["event"])
        if kind not in _TOLD:
            return
        held = self._held.get(kind)
        if held is None:
            self._held[kind] = _Held(self._now_ns() + TELL_EVERY_NS)
            self._tell(event, 0)
            return
        last = dict(event)
        if held.last is not None:
            # Numbers that add up.
            last |= {
                name: int(str(held.last[name])) + int(str(last[name])) for name in ("missed", "count") if name in last
            }
            held.more += 1
        held.last = last

    def flush(self) -> None:
        """Tells what came since, of kinds whose second is over."""
        now_ns = self._now_ns()
        for kind, held in list(self._held.items()):
            if now_ns < held.until_ns:
                continue
            if held.last is None:
                del self._held[kind]
            else:
                self._held[kind] = _Held(now_ns + TELL_EVERY_NS)
                self._tell(held.last, held.more)

    def _tell(self, event: Mapping[str, object], more: int) -> None:
        level, words = _TOLD[str(event["event"])]
        if event.get("faults") == []:
            level = logging.INFO
        text = words(event)
        if more and "count" not in event:
            text += f" (and {more} more within a second)"
        fields = {name: ", ".join(value) if isinstance(value, list) else value for name, value in event.items()}
        _log.log(level, "%s", text, extra={"fields": fields})
