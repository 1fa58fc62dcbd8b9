"""The log: where lines are written, and which events are logged."""

from __future__ import annotations

import logging
import os
import pty
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapticd.base.core import EVENT_DTYPE, EventKind, records
from hapticd.protocol.events import event_map
from hapticd.system.journal import EventLog, is_stderr_stream
from hapticd.system.repeated_lines import FORGET_AFTER_S

ROOT = Path(__file__).parents[2]


def test_lines_go_to_stderr_and_for_the_journal_with_their_priority() -> None:
    assert not is_stderr_stream("")
    assert not is_stderr_stream("1:x")
    status = os.fstat(2)
    assert is_stderr_stream(f"{status.st_dev}:{status.st_ino}")
    assert not is_stderr_stream(f"{status.st_dev}:{status.st_ino + 1}")
    program = """
import logging, os
from hapticd.system import journal
log, status = logging.getLogger("hapticd"), os.fstat(2)
stream = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
with journal.attached("info", stream):
    log.warning("hello")
    log.info("i")
    try:
        raise ValueError("first\\nsecond")
    except ValueError:
        log.exception("it failed")
with journal.attached("info", {}):
    log.info("plain")
    log.debug("not written")
with journal.attached("warning", {}):
    log.info("not written")
    log.warning("written")
with journal.attached("debug", {}):
    log.debug("all")
    logging.getLogger("asyncio").info("a library's")
log.info("to nobody")
assert not logging.getLogger().handlers
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=True)
    lines = run.stderr.splitlines()
    assert lines[:4] == ["<4>hello", "<6>i", "<3>it failed", "<3>Traceback (most recent call last):"]
    of_journal = [line for line in lines if line.startswith("<")]
    assert of_journal[-2:] == ["<3>ValueError: first", "<3>second"]
    dated = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d hapticd: (plain|written|all)")
    rest = lines[len(of_journal) :]
    assert [match[1] for line in rest if (match := dated.fullmatch(line))] == ["plain", "written", "all"]
    assert len(rest) == 3


def test_no_thread_waits_for_a_reader_that_does_not_read() -> None:
    # The program ends after its lines were read, since at its end it waits only FINAL_FLUSH_TIMEOUT_S for their writer.
    program = """
import logging
import sys
from hapticd.system import journal
with journal.attached("info", {}):
    for number in range(5000):
        logging.getLogger("hapticd").info("%s", number)
    print("not held up", flush=True)
    sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    ) as run:
        assert run.stdin is not None and run.stdout is not None and run.stderr is not None
        assert run.stdout.readline() == "not held up\n"
        for number in range(5000):
            assert run.stderr.readline().split()[-1] == str(number)
        run.stdin.close()
        assert run.stderr.read() == ""


def test_on_a_terminal_a_line_begins_with_the_time_of_day() -> None:
    program = """
import logging
from hapticd.system import journal
with journal.attached("info", {}):
    logging.getLogger("hapticd").info("hello")
"""
    ours, theirs = pty.openpty()
    try:
        subprocess.run([sys.executable, "-c", program], stderr=theirs, cwd=ROOT, check=True)
        assert re.fullmatch(rb"\d\d:\d\d:\d\d hapticd: hello\r\n", os.read(ours, 4096))
    finally:
        os.close(ours)
        os.close(theirs)


class Clock:
    def __init__(self) -> None:
        self.s = 0.0

    def __call__(self) -> float:
        return self.s


@pytest.fixture
def logged(caplog: pytest.LogCaptureFixture) -> Iterator[pytest.LogCaptureFixture]:
    with caplog.at_level(logging.INFO, logger="hapticd"):
        yield caplog


def overrun(missed: int = 3, count: int = 2) -> dict[str, object]:
    return {"event": "overrun", "tick": 1, "time_ns": 0, "missed": missed, "count": count}


@pytest.mark.slow
def test_a_flood_is_one_line_at_once_and_then_sums_at_doubling_intervals(logged: pytest.LogCaptureFixture) -> None:
    """A daemon without real-time rights misses some periods ten times a second, for ten hours."""
    clock = Clock()
    log = EventLog(clock)
    seconds = 10 * 3600
    for tenth in range(10 * seconds):
        clock.s = 0.1 * tenth
        log.note(overrun())
        log.flush()
    assert logged.messages[:4] == [
        "3 periods missed, 2 times",
        "30 periods missed, 20 times, in the last 1 s",
        "60 periods missed, 40 times, in the last 2 s",
        "120 periods missed, 80 times, in the last 4 s",
    ]
    assert logged.messages[-1] == "108,000 periods missed, 72,000 times, in the last 1 h"
    assert len(logged.messages) == 1 + 12 + 8
    clock.s += FORGET_AFTER_S
    log.flush()  # the delayed sum
    clock.s += FORGET_AFTER_S
    log.note(overrun(1, 1))
    assert logged.messages[-1] == "1 period missed"


def test_missing_rights_cause_one_hint_to_the_doctor(logged: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    for missing, hints in ((True, 1), (False, 0)):
        logged.clear()
        log = EventLog(clock, lambda missing=missing: missing)  # type: ignore[misc]
        for _ in range(100):
            clock.s += 10
            log.note(overrun())
            log.flush()
        assert len([line for line in logged.messages if "hapticd doctor" in line]) == hints
        assert "periods missed" in logged.messages[0]


def test_lines_that_cannot_be_added_up_show_the_newest_and_the_number(logged: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    log = EventLog(clock)
    for faults in (["device", "overload"], [], ["device"], []):
        log.note({"event": "fault", "tick": 1, "time_ns": 0, "faults": faults})
    assert [record.levelname for record in logged.records] == ["ERROR"]
    clock.s = 2.0
    log.flush()
    assert logged.messages == [
        "fault: device and overload; forces are off until somebody turns them on (hapticd force on)",
        "faults cleared (and 2 more in the last 2 s)",
    ]


def test_a_fault_is_held_back_a_minute_at_most(logged: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    log = EventLog(clock)
    for _ in range(3600):
        clock.s += 1.0
        log.note({"event": "fault", "tick": 1, "time_ns": 0, "faults": ["lease"]})
        log.flush()
    assert "(and 59 more in the last 60 s)" in logged.messages[-1]


def test_at_level_debug_every_event_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, logger="hapticd"):
        log = EventLog(Clock())
        for _ in range(3):
            log.note({"event": "release", "tick": 7, "object": "table"})
            log.note({"event": "contact", "time_ns": 1234567890, "speed_m_per_s": 0.25, "position_m": [0.5, 0.0]})
    assert caplog.messages[::2] == ["event release: tick 7, object table"] * 3
    assert caplog.messages[1] == "event contact: time_ns 1234567890, speed_m_per_s 0.25, position_m [0.5, 0.0]"


def test_a_sum_of_missed_periods_has_their_share(logged: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    log = EventLog(clock, rate_hz=lambda: 2000.0)
    for _ in range(3):
        log.note(overrun(10))
    clock.s = 4.0
    log.flush()
    assert logged.messages == ["10 periods missed, 2 times", "20 periods missed (0.25 %), 4 times, in the last 4 s"]


def test_only_important_events_are_logged(logged: pytest.LogCaptureFixture) -> None:
    event = records(EVENT_DTYPE, 1)[0]
    silent = {EventKind.CONTACT, EventKind.RELEASE, EventKind.PUNCTURE, EventKind.GROOVE, EventKind.SATURATION}
    silent |= {EventKind.REVISION, EventKind.MARK, EventKind.GESTURE_END}
    for kind in EventKind:
        event["kind"] = kind
        logged.clear()
        EventLog(Clock()).note(event_map(event, "x"))
        assert len(logged.messages) == (kind not in silent), kind


def test_a_jump_of_a_simulated_hand_may_be_a_target_in_mm(logged: pytest.LogCaptureFixture) -> None:
    jump = {"event": "glitch", "tick": 1, "time_ns": 0, "speed_m_per_s": 21.5}
    EventLog(Clock()).note(jump)
    EventLog(Clock(), simulated=lambda: True).note(jump)
    line = "the position jumped, at a speed of 21.5 m/s"
    assert logged.messages == [line, f"{line}: is a target of the hand in mm instead of m?"]
