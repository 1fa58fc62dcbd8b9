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
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from hapticd.base import wording
from hapticd.system.repeated_lines import LONGEST_S, STATE_S, Repeats, Since

SOCKET: Final = "/run/systemd/journal/socket"
IDENTIFIER: Final = "hapticd"
PREFIX: Final = "HAPTICD_"

LEVELS: Final = ("debug", "info", "warning", "error")
"""What a line may be, the least important first."""
LINE: Final = "%(asctime)s hapticd: %(message)s"
TIME_OF_DAY: Final = "%H:%M:%S"
DATE: Final = "%Y-%m-%d"

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
def attached(level: str = "info", environ: Mapping[str, str] | None = None, address: str = SOCKET) -> Iterator[None]:
    """Meanwhile lines of the log go to the journal if stderr does and the journal can be spoken to, else to stderr.

    `level`, one of LEVELS: less important lines of ours are left out; of the libraries' those below a warning, too.
    On stderr each line begins with the time of day, in a file with the date, too; under the journal, which has its own,
    with neither.
    """
    environ = os.environ if environ is None else environ
    journal = is_stderr(environ.get("JOURNAL_STREAM", ""))
    if journal and os.path.exists(address):
        handler: logging.Handler = JournalHandler(address)
        handler.setFormatter(logging.Formatter("%(message)s"))
    else:
        handler = logging.StreamHandler(sys.stderr)
        on_terminal = sys.stderr is not None and sys.stderr.isatty()
        time_of = TIME_OF_DAY if on_terminal else f"{DATE} {TIME_OF_DAY}"
        handler.setFormatter(logging.Formatter("hapticd: %(message)s" if journal else LINE, time_of))
    root, before = logging.getLogger(), _log.level
    root.addHandler(handler)
    _log.setLevel(level.upper())
    try:
        yield
    finally:
        _log.setLevel(before)
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
    """Sends records to the journal. It never waits: what the journal does not take is counted, and reported with the
    next line that it does take."""

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
            self._lost += 1  # reported with the next line that gets through
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
        extra: Mapping[str, object] = getattr(record, "fields", {})
        fields |= {PREFIX + name.upper(): value for name, value in extra.items() if value is not None}
        if self._lost:
            fields[PREFIX + "LINES_LOST"] = self._lost
        return fields

    def close(self) -> None:
        self._socket.close()
        super().close()


# ---- Events --------------------------------------------------------------------------------------------------------


def _fault(event: Mapping[str, object], since: Since) -> str:
    faults = event["faults"]
    names = wording.listed(list(map(str, faults))) if isinstance(faults, list) else ""
    text = f"fault: {names}; forces are off until somebody turns them on (hapticd force on)" if names else ""
    return (text or "faults cleared") + since.more


def _overrun(event: Mapping[str, object], since: Since) -> str:
    """With the part of all periods that it is, in a line that sums up; `rate_hz` stands in the event for it."""
    missed, times = since.amounts["missed"], since.amounts["count"]
    text = f"{wording.count(missed, 'period')} missed"
    if since.seconds and "rate_hz" in event:
        text += f" ({wording.percent(missed / (since.seconds * _number(event, 'rate_hz')))})"
    if times > 1:
        text += f", {times:,} times"
    return f"{text}, {since.window}" if since.window else text


def _plain(text: Callable[[Mapping[str, object]], str]) -> Callable[[Mapping[str, object], Since], str]:
    return lambda event, since: text(event) + since.more


def _number(event: Mapping[str, object], name: str) -> float:
    return float(str(event[name]))


_TOLD: Final[Mapping[str, tuple[int, Callable[[Mapping[str, object], Since], str]]]] = {
    "fault": (logging.ERROR, _fault),
    "device_lost": (logging.WARNING, _plain(lambda event: "the device does not report")),
    "device_found": (logging.INFO, _plain(lambda event: "the device reports again")),
    "overrun": (logging.WARNING, _overrun),
    "overload": (
        logging.WARNING,
        _plain(
            lambda event: (
                f"overload: {wording.percent(_number(event, 'missed_share'))} of a second's periods were missed"
            )
        ),
    ),
    "rate": (
        logging.WARNING,
        _plain(lambda event: f"the servo goes on at {wording.si(_number(event, 'rate_hz'), 'Hz')}"),
    ),
    "resumed": (
        logging.WARNING,
        _plain(lambda event: f"the machine was suspended for {wording.duration(_number(event, 'suspended_s'))}"),
    ),
    "memory_refused": (
        logging.WARNING,
        _plain(
            lambda event: (
                f"locked memory for all objects: {event['problem']}; the rest is rendered from memory that is not"
            )
        ),
    ),
    "glitch": (
        logging.WARNING,
        _plain(lambda event: f"the position jumped, at {wording.quantity(_number(event, 'speed_m_per_s'), 'm/s', 3)}"),
    ),
}
"""The events that stand in the log: how important each is, and its words. Others, contacts for example, do not."""

_SUMS: Final = ("missed", "count")
"""Members of an event that add up."""
_STATES: Final = frozenset(("fault", "device_lost", "device_found", "rate"))
"""Those that say how things are from now on."""


def _short(value: object) -> object:
    """A value of an event as a person reads it: the telemetry has every digit."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(str(_short(each)) for each in value)}]"
    return f"{value:.{wording.DIGITS}g}" if isinstance(value, float) else value


class EventLog:
    """Tells events of consequence in the log: the first of a kind at once, those that follow as `repeats` says.

    With level DEBUG every event is logged, each as it comes.
    """

    def __init__(
        self,
        now_s: Callable[[], float] = time.monotonic,
        missing: Callable[[], bool] = lambda: False,
        rate_hz: Callable[[], float] | None = None,
    ) -> None:
        """`missing`: whether real-time rights that were asked for are missing; `rate_hz`: the servo's, now."""
        self._repeats = Repeats(now_s)
        self._missing, self._rate_hz = missing, rate_hz
        self._hinted = False

    def note(self, event: Mapping[str, object]) -> None:
        """Takes one event, a map as telemetry sends it."""
        kind = str(event["event"])
        if _log.isEnabledFor(logging.DEBUG):
            members = ", ".join(f"{name} {_short(value)}" for name, value in event.items() if name != "event")
            _log.debug("event %s: %s", kind, members)
        if kind not in _TOLD:
            return
        amounts = {name: int(str(event[name])) for name in _SUMS if name in event}
        last = dict(event)
        longest_s = STATE_S if kind in _STATES else LONGEST_S
        self._repeats.note(kind, lambda since: self._tell(last, since), amounts, longest_s)

    def flush(self) -> None:
        """Tells what was held back and is due."""
        self._repeats.flush()

    def finish(self) -> None:
        """Tells all that was held back, at the end."""
        self._repeats.finish()

    def _tell(self, event: Mapping[str, object], since: Since) -> None:
        level, words_of = _TOLD[str(event["event"])]
        if event["event"] == "overrun" and self._rate_hz is not None:
            event = {**event, "rate_hz": self._rate_hz()}
        if event.get("faults") == []:
            level = logging.INFO
        fields = {name: ", ".join(value) if isinstance(value, list) else value for name, value in event.items()}
        fields |= since.amounts
        if since.times > 1:
            fields["times"] = since.times
        _log.log(level, "%s", words_of(event, since), extra={"fields": fields})
        if event["event"] == "overrun" and not self._hinted and self._missing():
            self._hinted = True
            _log.warning("real-time rights are missing, so other programs hold the servo up: see hapticd doctor")
