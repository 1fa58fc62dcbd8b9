"""The log: datagrams as the journal reads them, and which events stand in it."""

from __future__ import annotations

import logging
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.core import EVENT_DTYPE, EventKind, records
from hapticd.events import event_map
from hapticd.journal import EventLog, JournalHandler, datagram, is_stderr

ROOT = Path(__file__).parents[2]


def fields_of(data: bytes) -> dict[str, str]:
    """A datagram read as https://systemd.io/JOURNAL_NATIVE_PROTOCOL/ says."""
    found = {}
    while data:
        line, _, rest = data.partition(b"\n")
        name, equals, value = line.partition(b"=")
        if not equals:
            (size,) = struct.unpack_from("<Q", rest)
            value, end, data = rest[8 : 8 + size], rest[8 + size : 9 + size], rest[9 + size :]
            assert end == b"\n"
        else:
            data = rest
        assert name.decode() not in found
        found[name.decode()] = value.decode()
    return found


@given(st.dictionaries(st.from_regex(r"[A-Z][A-Z0-9_]{0,20}", fullmatch=True), st.text(max_size=200)))
def test_fields_arrive_as_they_were_whatever_is_in_them(fields: dict[str, str]) -> None:
    # What UTF-8 has no bytes for is told by its number.
    assert fields_of(datagram(fields)) == {
        name: value.encode("utf-8", "backslashreplace").decode() for name, value in fields.items()
    }


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(str(tmp_path / "socket"))
        server.settimeout(30)
        yield server


@pytest.fixture
def log(journal: socket.socket, tmp_path: Path) -> Iterator[logging.Logger]:
    made = logging.Logger("test", logging.INFO)
    handler = JournalHandler(str(tmp_path / "socket"))
    made.addHandler(handler)
    yield made
    handler.close()


def test_a_line_has_priority_and_fields_and_a_traceback_is_one_line(
    journal: socket.socket, log: logging.Logger
) -> None:
    log.error("fault: %s", "lease", extra={"fields": {"event": "fault", "tick": 12, "object": None}})
    told = fields_of(journal.recv(65536))
    assert {name: told[name] for name in told if not name.startswith("CODE_")} == {
        "MESSAGE": "fault: lease",
        "PRIORITY": "3",
        "SYSLOG_IDENTIFIER": "hapticd",
        "HAPTICD_EVENT": "fault",
        "HAPTICD_TICK": "12",
    }
    assert told["CODE_FILE"] == __file__
    try:
        raise ValueError("first\nsecond")
    except ValueError:
        log.exception("it failed")
    told = fields_of(journal.recv(65536))
    assert told["MESSAGE"].startswith("it failed\nTraceback")
    assert told["MESSAGE"].endswith("ValueError: first\nsecond")
    log.warning("w")
    log.info("i")
    assert [fields_of(journal.recv(65536))["PRIORITY"] for _ in range(2)] == ["4", "6"]


def test_a_journal_that_does_not_read_holds_nobody_up_and_hears_how_much_it_missed(
    journal: socket.socket, log: logging.Logger
) -> None:
    count = 5000
    for number in range(count):
        log.info("%s", number)
    journal.setblocking(False)
    arrived = []
    with pytest.raises(BlockingIOError):
        while True:
            arrived.append(fields_of(journal.recv(65536)))
    assert 0 < len(arrived) < count
    assert not any("HAPTICD_LINES_LOST" in line for line in arrived)
    log.info("again")
    told = fields_of(journal.recv(65536))
    assert (told["MESSAGE"], told["HAPTICD_LINES_LOST"]) == ("again", str(count - len(arrived)))
    log.info("and again")
    assert "HAPTICD_LINES_LOST" not in fields_of(journal.recv(65536))


def test_the_journal_is_spoken_to_where_stderr_is_its(journal: socket.socket, tmp_path: Path) -> None:
    assert not is_stderr("")
    assert not is_stderr("1:x")
    status = os.fstat(2)
    assert is_stderr(f"{status.st_dev}:{status.st_ino}")
    assert not is_stderr(f"{status.st_dev}:{status.st_ino + 1}")
    program = f"""
import logging, os
from hapticd import journal
log, status = logging.getLogger("hapticd"), os.fstat(2)
with journal.attached({{"JOURNAL_STREAM": f"{{status.st_dev}}:{{status.st_ino}}"}}, {str(tmp_path / "socket")!r}):
    log.warning("hello")
with journal.attached({{}}):
    log.info("plain")
log.info("to nobody")
assert not logging.getLogger().handlers
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=True)
    assert fields_of(journal.recv(65536))["MESSAGE"] == "hello"
    assert run.stderr == "hapticd: plain\n"


class Clock:
    def __init__(self) -> None:
        self.ns = 0

    def __call__(self) -> int:
        return self.ns


@pytest.fixture
def said(caplog: pytest.LogCaptureFixture) -> Iterator[pytest.LogCaptureFixture]:
    with caplog.at_level(logging.INFO, logger="hapticd"):
        yield caplog


def test_a_flood_is_one_line_at_once_and_one_a_second(said: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    log = EventLog(clock)
    for _ in range(1000):
        log.note({"event": "overrun", "tick": 1, "time_ns": 0, "missed": 3, "count": 2})
        log.flush()
    assert said.messages == ["3 periods missed, 2 times"]
    clock.ns = 1_000_000_000
    log.flush()
    assert said.messages[1:] == [f"{3 * 999} periods missed, {2 * 999} times"]
    for second in range(2, 5):
        clock.ns = second * 1_000_000_000
        log.flush()
    assert len(said.messages) == 2  # nothing came
    log.note({"event": "overrun", "tick": 9, "time_ns": 0, "missed": 1, "count": 1})
    assert said.messages[2:] == ["1 periods missed, 1 times"]


def test_what_cannot_be_added_up_is_told_by_its_last_with_the_number(said: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    log = EventLog(clock)
    for faults in (["device"], [], ["device"], []):
        log.note({"event": "fault", "tick": 1, "time_ns": 0, "faults": faults})
    assert [record.levelname for record in said.records] == ["ERROR"]
    clock.ns = 2_000_000_000
    log.flush()
    assert said.messages == [
        "fault: device; forces are off until set_forces turns them on",
        "faults cleared (and 2 more within a second)",
    ]
    assert said.records[0].fields["event"] == "fault"  # type: ignore[attr-defined]


def test_a_line_that_cannot_be_made_costs_no_thread(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    handler = JournalHandler(str(tmp_path / "journal"))
    handler.handle(logging.LogRecord("hapticd", logging.INFO, "here.py", 1, "%d", ("no number",), None))
    handler.close()
    assert "here.py" in capsys.readouterr().err


def test_events_of_consequence_have_words_and_others_none(said: pytest.LogCaptureFixture) -> None:
    event = records(EVENT_DTYPE, 1)[0]
    silent = {EventKind.CONTACT, EventKind.RELEASE, EventKind.PUNCTURE, EventKind.GROOVE, EventKind.SATURATION}
    silent |= {EventKind.REVISION}
    for kind in EventKind:
        event["kind"] = kind
        said.clear()
        EventLog(Clock()).note(event_map(event, "x"))
        assert len(said.messages) == (kind not in silent), kind
