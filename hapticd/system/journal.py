"""Where the daemon's log goes, and which events of the servo stand in it.

Lines go to stderr, by a thread that writes them: nobody else waits for a journal or a terminal that does not read. What
it does not take is lost, and counted.
Under systemd, whose journal takes them from stderr, each begins with its priority (`<3>` for an error, sd-daemon(3)),
so that `journalctl -p warning` shows those that matter.
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
from hapticd.system.repeated_lines import LONGEST_S, STATE_S, Repeats, Since

LEVELS: Final = ("debug", "info", "warning", "error")
"""What a line may be, the least important first."""
_PRIORITIES: Final = {"CRITICAL": 2, "ERROR": 3, "WARNING": 4, "INFO": 6, "DEBUG": 7}
"""Python's levels as those of syslog."""

MOST_WAITING: Final = 10_000
"""Lines."""
END_S: Final = 1.0
"""So long the end waits for the last lines to be written."""

_log = logging.getLogger("hapticd")


@contextmanager
def attached(level: str = "info", environ: Mapping[str, str] = os.environ) -> Iterator[None]:
    """Meanwhile lines of the log go to stderr.

    `level`, one of LEVELS: less important lines of ours are left out; of the libraries' those below a warning, too.
    Each line begins with the time of day, in a file with the date, too; under the journal, which has its own, with its
    priority.
    """
    handler = logging.StreamHandler(sys.stderr)
    if is_stderr(environ.get("JOURNAL_STREAM", "")):
        handler.setFormatter(_ForJournal())
    else:
        on_terminal = sys.stderr is not None and sys.stderr.isatty()
        time_of = "%H:%M:%S" if on_terminal else "%Y-%m-%d %H:%M:%S"
        handler.setFormatter(logging.Formatter("%(asctime)s hapticd: %(message)s", time_of))
    queued = _Queued(handler)
    # A daemon's thread: one that nobody reads does not hold up the end of the process.
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
        writer.join(END_S)


class _Queued(QueueHandler):
    """Lines that wait for the thread that writes them."""

    def __init__(self, handler: logging.Handler) -> None:
        self._waiting: Queue[logging.LogRecord | None] = Queue(MOST_WAITING)
        super().__init__(self._waiting)
        self._handler = handler
        self._lost = 0

    def enqueue(self, record: logging.LogRecord) -> None:
        """Without room the line is lost."""
        try:
            self._waiting.put_nowait(record)
        except Full:
            self._lost += 1

    def end(self) -> None:
        """No more lines come. Without room the thread ends with the process."""
        with suppress(Full):
            self._waiting.put_nowait(None)

    def write(self) -> None:
        """Writes all that come, until the end."""
        while (record := self._waiting.get()) is not None:
            self._handler.handle(record)
            if self._lost:
                lost, self._lost = self._lost, 0
                words = f"{wording.count(lost, 'line')} of this log were lost: nobody read it"
                self._handler.handle(_log.makeRecord(_log.name, logging.WARNING, "", 0, words, (), None))


class _ForJournal(logging.Formatter):
    """A priority before each line, of a traceback too."""

    def format(self, record: logging.LogRecord) -> str:
        priority = _PRIORITIES.get(record.levelname, 6)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


def is_stderr(stream: str) -> bool:
    """Whether $JOURNAL_STREAM, `DEVICE:INODE`, names what stderr is."""
    try:
        status = os.fstat(2)
    except OSError:
        return False
    return stream == f"{status.st_dev}:{status.st_ino}"


# ---- Events --------------------------------------------------------------------------------------------------------

_STATES: Final = frozenset(("fault", "device_lost", "device_found", "rate"))
"""Events that say how things are from now on."""


def _line(event: Mapping[str, object]) -> tuple[int, str] | None:
    """How important an event is, and its words; None for those that do not stand in the log, contacts for example."""
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
            return logging.WARNING, f"the servo goes on at {wording.si(_number(event, 'rate_hz'), 'Hz')}"
        case "resumed":
            lasted = wording.duration(_number(event, "suspended_s"))
            return logging.WARNING, f"the machine was suspended for {lasted}"
        case "memory_refused":
            refused = f"locked memory for all objects: {event['problem']}"
            return logging.WARNING, f"{refused}; the rest is rendered from memory that is not"
        case "glitch":
            speed = wording.quantity(_number(event, "speed_m_per_s"), "m/s", 3)
            return logging.WARNING, f"the position jumped, at {speed}"
        case _:
            return None


def _number(event: Mapping[str, object], name: str) -> float:
    return float(str(event[name]))


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
            members = ", ".join(f"{name} {value}" for name, value in event.items() if name != "event")
            _log.debug("event %s: %s", kind, members)
        if kind == "overrun":
            amounts = {name: int(str(event[name])) for name in ("missed", "count")}
            self._repeats.note(kind, self._overrun, amounts)
            return
        found = _line(event)
        if found is not None:
            level, line = found
            self._repeats.line(kind, level, line, STATE_S if kind in _STATES else LONGEST_S)

    def flush(self) -> None:
        """Tells what was held back and is due."""
        self._repeats.flush()

    def finish(self) -> None:
        """Tells all that was held back, at the end."""
        self._repeats.finish()

    def _overrun(self, since: Since) -> None:
        """Periods that were missed, in a line that sums up with the part of all periods that they are."""
        missed, times = since.amounts["missed"], since.amounts["count"]
        line = f"{wording.count(missed, 'period')} missed"
        if since.seconds and self._rate_hz is not None:
            line += f" ({wording.percent(missed / (since.seconds * self._rate_hz()))})"
        line += f", {times:,} times" if times > 1 else ""
        line += f", {since.window}" if since.window else ""
        _log.warning("%s", line)
        if not self._hinted and self._missing():
            self._hinted = True
            _log.warning("real-time rights are missing, so other programs hold the servo up: see hapticd doctor")
