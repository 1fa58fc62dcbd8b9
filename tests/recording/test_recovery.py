"""Recordings whose process was killed, or whose file could not be written: recovery from their partial files."""

from __future__ import annotations

import errno
import os
import random
import signal
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.recording.recording import load
from hapticd.recording.recovery import partial_files_warning, recover
from hapticd.recording.writer import RecordingWriter
from tests.recording.test_writer import noisy, some

KILLED = """
import os, signal, sys
import numpy as np
from hapticd.recording.writer import RecordingWriter
writer = RecordingWriter(sys.argv[1], overwrite=True)
writer.begin({"scene": {"objects": {}}}, {"notes": {}})
writer.write_change({"revision": 1})
writer.write_event({"event": "overrun", "tick": 3, "time_ns": 4, "missed": 2})
for batch in np.array_split(np.load(sys.argv[2]), 100):
    writer.write(batch)
if sys.argv[3] == "while it is finished":
    os.fsync = lambda fd: os.kill(os.getpid(), signal.SIGKILL)
    writer.finish({"config": {}})
os.kill(os.getpid(), signal.SIGKILL)
"""


def record_until_killed(target: Path, samples: np.ndarray, when: str = "while it records") -> None:
    given = target.with_name("given.npy")
    np.save(given, samples)
    killed = subprocess.run([sys.executable, "-c", KILLED, target, given, when], capture_output=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    given.unlink()


@pytest.mark.parametrize("when", ["while it records", "while it is finished"])
@pytest.mark.parametrize("torn", [b"", b"123,4"])
def test_partial_files_of_a_killed_recording_are_recovered(tmp_path: Path, torn: bytes, when: str) -> None:
    target = tmp_path / "run.npz"
    target.write_text("an old recording")
    given = noisy(20_000, 0)
    record_until_killed(target, given, when)
    assert target.read_text() == "an old recording"
    (part,) = tmp_path.glob(".run.npz.*.part")
    with open(part, "ab") as file:
        file.write(torn)
    assert recover(target).files == [tmp_path / "run.recovered.npz"]
    recorded = load(tmp_path / "run.recovered.npz")
    count = len(recorded.samples)
    assert recorded.samples.tobytes() == given[:count].tobytes()
    assert count == len(given)
    assert recorded.texts["scene"] == {"objects": {}}
    assert recorded.texts["changes"] == [{"revision": 1}]
    assert recorded.texts["recording"] == {"ticks": count, "events": 1, "ended_because": "killed", "notes": {}}
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]
    assert not recover(target).files and not recover(target).problems


@pytest.mark.long
def test_each_recovered_recording_gets_a_free_name(tmp_path: Path) -> None:
    target = tmp_path / "run[1].npz"
    for _ in range(2):
        record_until_killed(target, some(100))
    names = ["run[1].recovered-2.npz", "run[1].recovered.npz"]
    assert sorted(path.name for path in recover(target).files) == names
    assert sorted(os.listdir(tmp_path)) == names


def test_a_recording_under_way_is_let_alone(tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    with RecordingWriter(target) as writer:
        writer.write(some(3))
        found = recover(target)
        assert not found.files and [line.split(": ")[1] for line in found.problems] == [
            "its recording is still running"
        ]
        writer.write(some(3, 3))
        writer.finish({"scene": {}})
    assert len(load(target).samples) == 6


def test_a_part_that_was_removed_ends_the_recording_at_once(tmp_path: Path) -> None:
    told = "run.npz: cannot be written: it was removed while it was being written"
    with pytest.raises(HapticdError, match=told), RecordingWriter(tmp_path / "run.npz") as writer:
        writer.write(noisy(10, 0))
        for path in tmp_path.iterdir():
            path.unlink()
        for batch in range(1, 100):
            writer.write_event({"event": "overrun", "tick": 1, "time_ns": 2, "missed": 3, "count": 1})
            writer.write(noisy(1000, 1000 * batch))
    assert os.listdir(tmp_path) == []


def test_a_recording_that_cannot_be_renamed_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    target = tmp_path / "a run.npz"
    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(HapticdError) as caught, RecordingWriter(target) as writer:
        writer.begin({"scene": {"objects": {}}}, {"notes": {}})
        writer.write(noisy(20_000, 0))
        writer.finish({})
    assert str(caught.value) == (
        f"{target}: cannot be written: Permission denied; the samples are kept, and `hapticd record --recover "
        f"'{target}'` makes a recording of them"
    )
    monkeypatch.undo()
    told = partial_files_warning(target)
    assert told is not None and f"hapticd record --recover '{target}'" in told
    (made,) = recover(target).files
    assert load(made).samples.tobytes() == noisy(20_000, 0).tobytes()
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


# ---- Parts that were damaged -------------------------------------------------------------------------------------


def damages(source: random.Random, path: Path) -> None:
    """Changes a file as disks and people do."""
    content = bytearray(path.read_bytes())
    at = source.randrange(len(content)) if content else 0
    match source.randrange(9):
        case 0:
            content.clear()
        case 1:
            del content[at:]
        case 2:
            content[at : at + 64] = source.randbytes(64)
        case 3:
            content[:64] = source.randbytes(64)
        case 4:
            content[:] = b"\0" * len(content)
        case 5:
            content[:] = b'["texts", []]\n["dtype", [["tick", "|O"]]]\n["event", 5]\n[1]\n5\n[]\n'
        case 6 if source.random() < 0.5:
            content[:] = b'["dtype", [["tick", "<u8,("], ["time_ns", "<i8"]]]\n' + content
        case 6:
            content[:] = b"root:$6$secret:0:0\n" * 100
        case 7:
            content[at : at + 8] = b"\xff" * 8
        case _:
            content[:] = b'["dtype", [["tick", "<u8", [1000000]], ["time_ns", "|V0"]]]\n' + content[:at]
    path.write_bytes(content)


@pytest.mark.long
def test_a_damaged_part_stops_no_recording_and_shows_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = tmp_path / "given"
    given.mkdir()
    record_until_killed(given / "run.npz", some(500))
    whole = {path.name: path.read_bytes() for path in given.iterdir()}
    source = random.Random(7)
    target = tmp_path / "run.npz"
    for number in range(60):
        for path in (*tmp_path.glob(".run.*"), *tmp_path.glob("run*")):
            path.unlink()
        for name, content in whole.items():
            (tmp_path / name).write_bytes(content)
        for name in source.sample(sorted(whole), source.choice((1, 1, 2))):
            if source.random() < 0.05:
                (tmp_path / name).unlink()
            else:
                damages(source, tmp_path / name)
        assert bool(partial_files_warning(target)) == any(name.endswith(".part") for name in os.listdir(tmp_path)), (
            number
        )
        with RecordingWriter(target) as writer:
            writer.write(some(3))
            writer.finish({"scene": {}})
        assert len(load(target).samples) == 3
        code = main(["record", "--recover", str(target)])
        out, err = capsys.readouterr()
        assert code in (0, 1) and "Traceback" not in err and "$6$" not in err and (out + err).isascii(), err
        assert all(line.startswith("hapticd: ") for line in err.splitlines()), err
        for line in out.splitlines():
            load(line)


def test_partial_files_stay_if_the_disk_has_no_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    target = tmp_path / "run.npz"
    record_until_killed(target, some(500))
    before = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    monkeypatch.setattr(os, "fsync", full)
    (told,) = recover(target).problems
    assert "cannot be finished, left unchanged" in told and "No space left on device" in told
    monkeypatch.undo()
    assert {path.name: path.stat().st_size for path in tmp_path.iterdir()} == before
    (made,) = recover(target).files
    assert load(made).samples.tobytes() == some(500).tobytes()
    assert stat.S_ISREG(made.stat().st_mode)


def test_recover_says_that_nothing_lies_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["record", "--recover", str(tmp_path / "run.npz")]) == 1
    assert capsys.readouterr().err == f"hapticd: {tmp_path}/run.npz: no partial files of a recording to this file\n"
