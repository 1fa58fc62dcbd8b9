"""The log of the daemon and of `hapticd web` on stderr, and how events of the servo are logged.

A separate thread writes the lines, so that no other thread waits for a journal or a terminal that does not read. Lines
that do not fit into its queue are lost and counted. If stderr is the journal of systemd, each line begins with its
priority (`<3>` for an error, sd-daemon(3)), so that `journalctl -p warning` selects lines.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler
from queue import Full, Queue
from typing import Final

from hapticd.base import wording
from hapticd.system.repeated_lines import MAX_REPEAT_INTERVAL_S, MAX_STATE_INTERVAL_S, Repeats, Since

LOG_LEVELS: Final = ("debug", "info", "warning", "error")
"""The levels that `--log-level` accepts, the least important first."""
_SYSLOG_PRIORITIES: Final = {"CRITICAL": 2, "ERROR": 3, "WARNING": 4, "INFO": 6, "DEBUG": 7}
"""The priority of syslog for each level of Python's logging."""

MAX_QUEUED_LINES: Final = 10_000
"""Lines that wait to be written; further lines are lost."""
FINAL_FLUSH_TIMEOUT_S: Final = 1.0
"""At its end the process waits at most this long for the last lines to be written."""

_log = logging.getLogger("hapticd")


@contextmanager
def attached(level: str = "info", environ: Mapping[str, str] = os.environ) -> Iterator[None]:
    """Write the log to stderr while the context lasts.

    `level`, one of LOG_LEVELS, is the lowest level of hapticd's lines that are written; that of libraries is "warning".
    A line begins with the time, and the date if stderr is not a terminal. If stderr is the journal, which adds both, a
    line begins with its priority.
    """
    handler = logging.StreamHandler(sys.stderr)
    if is_stderr_stream(environ.get("JOURNAL_STREAM", "")):
        handler.setFormatter(_JournalFormatter())
    else:
        on_terminal = sys.stderr is not None and sys.stderr.isatty()
        time_of = "%H:%M:%S" if on_terminal else "%Y-%m-%d %H:%M:%S"
        handler.setFormatter(logging.Formatter("%(asctime)s hapticd: %(message)s", time_of))
    queued = _LineQueue(handler)
    # A daemon thread: if it blocks because stderr is not read, the process can still end.
    writer = threading.Thread(target=queued.write, name="log", daemon=True)
    root, before = logging.getLogger(), _log.level
    root.addHandler(queued)
    _log.setLevel(level.upper())
    writer.start()
    try:
        yield
    finally:
        _log.setLevel(before)
        root.removeHandler(queued)
        queued.end()
        writer.join(FINAL_FLUSH_TIMEOUT_S)


class _LineQueue(QueueHandler):
    """Handler that puts lines into the queue of the thread that writes them."""

    def __init__(self, handler: logging.Handler) -> None:
        self._waiting: Queue[logging.LogRecord | None] = Queue(MAX_QUEUED_LINES)
        super().__init__(self._waiting)
        self._handler = handler
        self._lost = 0

    def enqueue(self, record: logging.LogRecord) -> None:
        """Put a line into the queue; if the queue is full, the line is lost and counted."""
        try:
            self._waiting.put_nowait(record)
        except Full:
            self._lost += 1

    def end(self) -> None:
        """End the writing thread after the queued lines; if the queue is full, the thread ends with the process."""
        with suppress(Full):
            self._waiting.put_nowait(None)

    def write(self) -> None:
        """Write the lines of the queue, in the writing thread, until `end` is called."""
        while (record := self._waiting.get()) is not None:
            self._handler.handle(record)
            if self._lost:
                lost, self._lost = self._lost, 0
                words = f"{wording.count(lost, 'line')} of this log were lost, because its reader was too slow"
                self._handler.handle(_log.makeRecord(_log.name, logging.WARNING, "", 0, words, (), None))


class _JournalFormatter(logging.Formatter):
    """Formatter that begins each line, also those of a traceback, with the priority of syslog."""

    def format(self, record: logging.LogRecord) -> str:
        priority = _SYSLOG_PRIORITIES.get(record.levelname, 6)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


def is_stderr_stream(stream: str) -> bool:
    """Return whether `stream`, a value of $JOURNAL_STREAM (`DEVICE:INODE`), names this process's stderr."""
    try:
        status = os.fstat(2)
    except OSError:
        return False
    return stream == f"{status.st_dev}:{status.st_ino}"


# ---- Events --------------------------------------------------------------------------------------------------------

_STATE_EVENTS: Final = frozenset(("fault", "device_lost", "device_found", "rate"))
"""Events that report a lasting state. If they repeat, their lines are delayed by at most MAX_STATE_INTERVAL_S."""


def _level_and_text(event: Mapping[str, object]) -> tuple[int, str] | None:
    """Return the level and the text of an event; None if it is not logged, for example a contact."""
    match event["event"]:
        case "fault":
            faults = event["faults"]
            if not isinstance(faults, list) or not faults:
                return logging.INFO, "faults cleared"
            names = wording.listed(list(map(str, faults)))
            return logging.ERROR, f"fault: {names}; forces are off until somebody turns them on (hapticd force on)"
        case "device_lost":
            return logging.WARNING, "the device does not report"
        case "device_found":
            return logging.INFO, "the device reports again"
        case "overload":
            share = wording.percent(_number(event, "missed_share"))
            return logging.WARNING, f"overload: {share} of a second's periods were missed"
        case "rate":
            return logging.WARNING, f"the servo continues at {wording.si(_number(event, 'rate_hz'), 'Hz')}"
        case "resumed":
            lasted = wording.duration(_number(event, "suspended_s"))
            return logging.WARNING, f"the machine was suspended for {lasted}"
        case "memory_refused":
            refused = f"cannot lock the memory of all objects: {event['problem']}"
            return logging.WARNING, f"{refused}; the others are rendered from memory that may be paged out"
        case "glitch":
            speed = wording.quantity(_number(event, "speed_m_per_s"), "m/s", 3)
            return logging.WARNING, f"the position jumped, at a speed of {speed}"
        case _:
            return None


def _number(event: Mapping[str, object], name: str) -> float:
    return float(str(event[name]))


class EventLog:
    """Logs faults, overruns, lost devices and similar events; repeated ones are summed up (repeated_lines.py).

    At level DEBUG every event is also logged when it arrives.
    """

    def __init__(
        self,
        now_s: Callable[[], float] = time.monotonic,
        missing: Callable[[], bool] = lambda: False,
        rate_hz: Callable[[], float] | None = None,
        simulated: Callable[[], bool] = lambda: False,
    ) -> None:
        """Create the log of the servo's events.

        `missing` returns whether requested real-time rights were refused; `rate_hz` returns the servo's present rate.
        `simulated` returns whether the hand is simulated.
        """
        self._repeats = Repeats(now_s)
        self._missing, self._rate_hz, self._simulated = missing, rate_hz, simulated
        self._hinted = False

    def note(self, event: Mapping[str, object]) -> None:
        """Log one event of telemetry, at once or later in a sum of repeated events."""
        kind = str(event["event"])
        if _log.isEnabledFor(logging.DEBUG):
            members = ", ".join(f"{name} {value}" for name, value in event.items() if name != "event")
            _log.debug("event %s: %s", kind, members)
        if kind == "overrun":
            amounts = {name: int(str(event[name])) for name in ("missed", "count")}
            self._repeats.note(kind, self._overrun, amounts)
            return
        found = _level_and_text(event)
        if found is not None and kind == "glitch" and self._simulated():
            found = found[0], f"{found[1]}: is a target of the hand in mm instead of m?"
        if found is not None:
            max_interval_s = MAX_STATE_INTERVAL_S if kind in _STATE_EVENTS else MAX_REPEAT_INTERVAL_S
            self._repeats.line(kind, *found, max_interval_s)

    def flush(self) -> None:
        """Log the sums of repeated events that are due."""
        self._repeats.flush()

    def finish(self) -> None:
        """Log all remaining sums of repeated events, at the end of the daemon."""
        self._repeats.finish()

    def _overrun(self, since: Since) -> None:
        """Log the periods that the servo missed; in a sum over some time, also their share of all periods."""
        missed, times = since.amounts["missed"], since.amounts["count"]
        line = f"{wording.count(missed, 'period')} missed"
        if since.seconds and self._rate_hz is not None:
            line += f" ({wording.percent(missed / (since.seconds * self._rate_hz()))})"
        line += f", {times:,} times" if times > 1 else ""
        line += f", {since.window}" if since.window else ""
        _log.warning("%s", line)
        if not self._hinted and self._missing():
            self._hinted = True
            _log.warning("real-time rights are missing, so other programs delay the servo: see hapticd doctor")
