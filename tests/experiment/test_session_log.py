"""The log of a session: appended records survive, whatever happens to the process or the file."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.experiment.session_folder import (
    LOG_FILE_NAME,
    PLAN_FILE_NAME,
    SESSION_FILE_NAME,
    STUDY_FILE_NAME,
    SessionFolder,
    folder_of,
)
from hapticd.experiment.session_log import SessionLog, decoded, read_log
from tests.support.special_files import KINDS, refused, special, untouched

_WRITER = """
import sys
from pathlib import Path
from hapticd.experiment.session_log import SessionLog

path = Path(sys.argv[1])
with SessionLog(path) as log:
    begun = len([record for record in log.records if record["kind"] == "answer"])
    for number in range(begun, 1_000_000):
        log.append("answer", trial=number, answer="same " * (number % 40))
        sys.stdout.write(f"{number}\\n")
        sys.stdout.flush()
"""


def _written(path: Path, count: int) -> bytes:
    with SessionLog(path) as log:
        for number in range(count):
            log.append("answer", trial=number, answer="härter", measures={"peak_force_n": number / 7})
    return path.read_bytes()


def test_each_line_is_json_with_the_checksum_of_all_before_it(tmp_path: Path) -> None:
    lines = _written(tmp_path / "log.jsonl", 3).splitlines()
    crc = 0
    for number, line in enumerate(lines):
        record = json.loads(line)
        assert (record["record"], record["trial"]) == (number, number)
        crc = zlib.crc32(line[: line.index(b',"crc32"')], crc)
        assert int(record["crc32"], 16) == crc


def test_a_closed_log_continues_where_it_ended(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    _written(path, 2)
    with SessionLog(path) as log:
        assert log.dropped is None
        log.append("note", text="the second time")
    records = read_log(path).records
    assert [record["kind"] for record in records] == ["answer", "answer", "note"]
    assert [record["record"] for record in records] == [0, 1, 2]


def test_every_truncation_is_a_shorter_log_or_drops_one_line_and_reports_it(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    data = _written(path, 4)
    ends = [0] + [at + 1 for at, byte in enumerate(data) if byte == 0x0A]
    for size in range(len(data) + 1):
        path.write_bytes(data[:size])
        sound = max(number for number, end in enumerate(ends) if end <= size)
        with SessionLog(path) as log:
            answers = [record for record in log.records if record["kind"] == "answer"]
            assert [record["trial"] for record in answers] == list(range(sound))
            if size in ends:
                assert log.dropped is None
                assert len(log.records) == sound
            else:
                assert log.dropped is not None
                assert "\n" not in log.dropped
                assert log.records[-1]["kind"] == "line_dropped"
                assert log.records[-1]["bytes"] == size - ends[sound]
        # The repaired log is valid.
        assert read_log(path).torn == b""


@pytest.mark.parametrize("seed", range(4))
def test_a_flipped_bit_is_found_wherever_it_is(seed: int, tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    data = _written(path, 5)
    last = data.rindex(b"\n", 0, -1) + 1
    chance = random.Random(seed)
    for at in chance.sample(range(len(data)), 150):
        flipped = bytearray(data)
        flipped[at] ^= 1 << chance.randrange(8)
        path.write_bytes(flipped)
        if at < last:
            with pytest.raises(HapticdError) as caught:
                SessionLog(path)
            assert "log.jsonl:" in str(caught.value)
            assert "\n" not in str(caught.value)
            assert path.read_bytes() == flipped
        else:
            with SessionLog(path) as log:
                assert log.dropped is not None
                assert len([record for record in log.records if record["kind"] == "answer"]) == 4


def test_a_line_that_is_missing_doubled_or_moved_is_found(tmp_path: Path) -> None:
    lines = _written(tmp_path / "log.jsonl", 4).splitlines(keepends=True)
    for changed in (
        [lines[0], lines[2], lines[3]],
        [*lines[:2], lines[1], *lines[2:]],
        [lines[1], lines[0], *lines[2:]],
    ):
        with pytest.raises(HapticdError, match=r"log:\d: damaged record"):
            decoded(b"".join(changed), "log")


def test_two_processes_do_not_write_one_log(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with SessionLog(path), pytest.raises(HapticdError, match="another process runs this session"):
        SessionLog(path)
    SessionLog(path).close()


def test_what_json_cannot_hold_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with SessionLog(path) as log:
        log.append("note", text="before")
        before = path.read_bytes()
        with pytest.raises(HapticdError, match="cannot be written to the log"):
            log.append("answer", value=float("nan"))
        assert path.read_bytes() == before
        assert log.append("note", text="after")["record"] == 1


def test_a_full_disk_leaves_the_log_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.jsonl"
    with SessionLog(path) as log:
        log.append("note", text="before")
        before = path.read_bytes()
        write = os.pwrite

        def half(fd: int, data: memoryview, at: int) -> int:
            if len(data) > 10:
                return write(fd, data[:10], at)
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "pwrite", half)
        # Ten bytes are written at a time. The last part, at most ten bytes, finds no space.
        with pytest.raises(HapticdError, match="No space left on device"):
            log.append("answer", trial=0)
        monkeypatch.undo()
        assert path.read_bytes() == before
        log.append("answer", trial=0)
    assert [record["kind"] for record in read_log(path).records] == ["note", "answer"]


@pytest.mark.slow
def test_killed_at_random_moments_nothing_is_lost_and_nothing_doubled(tmp_path: Path) -> None:
    """The log has the records that the process reported as appended, in order and once, and at most one more."""
    path = tmp_path / "log.jsonl"
    chance = random.Random(7)
    reported = -1
    for _ in range(12):
        process = subprocess.Popen(
            [sys.executable, "-c", _WRITER, str(path)], stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]
        )
        assert process.stdout is not None
        for _ in range(chance.randrange(1, 60)):
            reported = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        # The output from before the signal.
        rest = process.stdout.read().split("\n")
        reported = max([reported, *(int(line) for line in rest[:-1] if line)])
        process.stdout.close()
        process.wait()
        contents = read_log(path)
        answers = [record["trial"] for record in contents.records if record["kind"] == "answer"]
        assert answers == list(range(len(answers)))
        assert reported < len(answers) <= reported + 2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", [STUDY_FILE_NAME, PLAN_FILE_NAME, SESSION_FILE_NAME, LOG_FILE_NAME])
def test_a_session_leaves_what_is_no_regular_file_alone(name: str, kind: str, tmp_path: Path) -> None:
    path = folder_of(tmp_path, "P07", 1)
    path.mkdir(parents=True)
    (tmp_path / "end").mkdir()
    special(tmp_path / "end" / name, kind)
    (path / name).symlink_to(tmp_path / "end" / name)
    with untouched(tmp_path / "end"), pytest.raises(HapticdError) as caught:
        SessionFolder.create(tmp_path, b"", {}, {"participant": "P07", "session": 1})
    assert str(caught.value) == refused(path / name, kind)
    assert (path / name).is_symlink()


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_is_a_regular_file(kind: str, tmp_path: Path) -> None:
    message = special(tmp_path / "log.jsonl", kind)
    with untouched(tmp_path), pytest.raises(HapticdError) as caught:
        SessionLog(tmp_path / "log.jsonl")
    assert str(caught.value) == message
