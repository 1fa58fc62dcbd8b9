"""`hapticd.load`: the content of a recording."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import hapticd
from hapticd import shipped
from hapticd.base.clock import Moment, moment_of, read
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.recording.writer import RecordingWriter
from hapticd.system.extras import install_command
from tests.support.cli import said

CONFIG = Path(shipped.__path__[0])
RECORDING = {
    "ticks": 20,
    "missed_periods": 7,
    "started": {"monotonic_ns": 1_000, "realtime_ns": 1_700_000_000_000_001_000},
    "ended": {"monotonic_ns": 9_000, "realtime_ns": 1_700_000_000_000_009_000},
    "ended_because": "stopped",
    "notes": {"subject": "3", "hand": "left = right"},
}
CHANGES = [{"revision": 4}, {"revision": 5, "objects": {"floor": None}}]


def some(count: int) -> np.ndarray:
    samples = np.zeros(count, SAMPLE_DTYPE)
    samples["tick"] = np.arange(100, 100 + count)
    samples["time_ns"] = 5_000 + np.arange(count) * 100_000
    samples["force_n"] = np.random.default_rng(1).standard_normal((count, 2))
    return samples


EVENTS: list[dict[str, object]] = [
    {"event": "release", "tick": 101, "time_ns": 1, "object": "floor"},
    {"event": "mark", "tick": 103, "time_ns": 2, "text": "trial 1", "data": {"left": True}},
    {"event": "saturation", "tick": 104, "time_ns": 3, "wanted_n": 12.0},
    {"event": "mark", "tick": 105, "time_ns": 4, "text": "trial 2", "data": None},
]


def write(target: Path, recording: object = RECORDING) -> Path:
    with RecordingWriter(target) as writer:
        writer.begin(
            {
                "config": {"servo": {"rate_hz": 10_000.0}, "device": {"kind": "sim"}},
                "scene": {"ramp_s": 0.02, "objects": {"floor": {"kind": "wall"}}},
                "materials": {"wood": {"stiffness_n_per_m": 500}},
                "status": {"rate_hz": 5000.0},
            }
        )
        for change in CHANGES:
            writer.write_change(change)
        writer.write(some(20))
        for event in EVENTS:
            writer.write_event(event)
        writer.finish({"recording": recording})
    return target


def test_written_data_are_loaded(tmp_path: Path) -> None:
    recording = hapticd.load(write(tmp_path / "run.npz"))
    assert isinstance(recording, hapticd.Recording)
    assert recording.samples.tobytes() == some(20).tobytes()
    assert recording.events == EVENTS
    assert [(mark["tick"], mark["text"], mark["data"]) for mark in recording.marks] == [
        (103, "trial 1", {"left": True}),
        (105, "trial 2", None),
    ]
    assert recording.scene["objects"] == {"floor": {"kind": "wall"}}
    assert recording.materials == {"wood": {"stiffness_n_per_m": 500}}
    assert recording.config["device"] == {"kind": "sim"} and recording.status == {"rate_hz": 5000.0}
    assert recording.changes == CHANGES
    assert recording.notes == {"subject": "3", "hand": "left = right"}
    assert recording.started == Moment(1_000, 1_700_000_000_000_001_000)
    assert recording.ended == Moment(9_000, 1_700_000_000_000_009_000)
    assert (recording.ended_because, recording.missed_periods, recording.rate_hz) == ("stopped", 7, 5000.0)
    assert recording.truth is None
    assert repr(recording) == f"<hapticd.Recording {tmp_path}/run.npz: 20 ticks, 4 events>"


def test_the_time_of_day_of_each_sample(tmp_path: Path) -> None:
    recording = hapticd.load(write(tmp_path / "run.npz"))
    assert recording.utc().dtype == "M8[ns]"
    assert recording.utc()[[0, 1]].astype(np.int64).tolist() == [1_700_000_000_000_005_000, 1_700_000_000_000_105_000]
    assert recording.started is not None
    assert recording.started.utc == datetime(2023, 11, 14, 22, 13, 20, 1, UTC)
    with pytest.raises(HapticdError, match="holds no time of day"):
        hapticd.load(write(tmp_path / "none.npz", {"started": None})).utc()


def test_pandas(tmp_path: Path) -> None:
    recording = hapticd.load(write(tmp_path / "run.npz"))
    frame = recording.to_pandas()
    assert frame.index.name == "time_s" and frame.index[:3].tolist() == pytest.approx([0.0, 1e-4, 2e-4])
    assert list(frame.columns[:4]) == ["tick", "time_ns", "position_m_x", "position_m_y"]
    assert frame["force_n_y"].to_numpy().tobytes() == some(20)["force_n"][:, 1].tobytes()
    assert len(frame) == 20 and frame["tick"].dtype == np.uint64
    by_day = frame.set_index(recording.utc())
    assert str(by_day.index[0]) == "2023-11-14 22:13:20.000005"


def test_without_pandas_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = hapticd.load(write(tmp_path / "run.npz"))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(HapticdError, match=f"^to_pandas needs pandas: {re.escape(install_command('pandas'))}$"):
        recording.to_pandas()


@pytest.mark.parametrize("ended", [None, "stopped"])
def test_files_of_before_are_read(tmp_path: Path, ended: str | None) -> None:
    """`recording.ended` was the reason; the number of missed periods was not stored."""
    recording = hapticd.load(write(tmp_path / "run.npz", {"ticks": 20, "ended": ended}))
    assert (recording.ended, recording.ended_because, recording.started, recording.notes) == (None, ended, None, {})
    assert recording.missed_periods == 0


def test_a_recording_is_saved_as_another(tmp_path: Path) -> None:
    recording = hapticd.load(write(tmp_path / "run.npz"))
    assert recording.save(tmp_path / "copy.npz") == tmp_path / "copy.npz"
    again = hapticd.load(tmp_path / "copy.npz")
    assert again.samples.tobytes() == recording.samples.tobytes()
    assert (again.events, again.texts) == (recording.events, recording.texts)
    with pytest.raises(HapticdError, match="already exists"):
        recording.save(tmp_path / "copy.npz")


def test_samples_may_be_changed_and_the_file_stays(tmp_path: Path) -> None:
    recording = hapticd.load(write(tmp_path / "run.npz"))
    recording.samples["force_n"] = 7.0
    assert hapticd.load(tmp_path / "run.npz").samples.tobytes() == some(20).tobytes()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_archives_of_numpy_and_of_earlier_versions_are_read(tmp_path: Path, save: Callable[..., None]) -> None:
    """Their samples are compressed, or not aligned in the file."""
    with np.load(write(tmp_path / "run.npz")) as file:
        save(tmp_path / "again.npz", **file)
    recording, again = hapticd.load(tmp_path / "run.npz"), hapticd.load(tmp_path / "again.npz")
    assert again.samples.flags.aligned and recording.samples.flags.aligned
    assert again.samples.tobytes() == recording.samples.tobytes()
    assert (again.events, again.texts) == (recording.events, recording.texts)


@pytest.mark.long
def test_a_simulation_has_truth_and_notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    command = [
        "simulate",
        str(CONFIG / "scenes" / "comb.yaml"),
        "--operator",
        str(CONFIG / "operators" / "stroke.yaml"),
    ]
    command += ["-o", "run.npz", "--for", "100ms"]
    assert main([*command, "--note", "subject=3", "--note", "why=a=b"]) == 0
    recording = hapticd.load("run.npz")
    assert recording.truth is not None and recording.truth.shape == (1000, 4)
    assert recording.notes == {"subject": "3", "why": "a=b"}
    assert (recording.missed_periods, recording.started, recording.ended_because) == (0, None, None)
    assert recording.rate_hz == 10_000.0
    saved = hapticd.load(recording.save("copy.npz"))
    assert saved.truth is not None and saved.truth.tobytes() == recording.truth.tobytes()
    before = Path("run.npz").read_bytes()
    assert "run.npz: already exists; give another name, or --overwrite" in said_to(command)
    assert Path("run.npz").read_bytes() == before
    assert main([*command, "--overwrite"]) == 0
    assert hapticd.load("run.npz").notes == {}
    assert main(["replay", "run.npz", "-o", "again.npz"]) == 0
    assert "again.npz: already exists" in said_to(["replay", "run.npz", "-o", "again.npz"])
    assert main(["replay", "run.npz", "-o", "again.npz", "--overwrite"]) == 0


def said_to(command: list[str]) -> str:
    """What a command that is refused says, before it does anything."""
    import contextlib
    import io

    err, out = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out):
        assert main(command) == 1
    assert out.getvalue() == "" and err.getvalue().count("\n") == 1
    return err.getvalue()


@pytest.mark.parametrize("note", ["subject", "=3", " = 3", ""])
def test_a_note_has_a_key_and_a_value(capsys: pytest.CaptureFixture[str], note: str) -> None:
    told = said(capsys, 2, "record", "run.npz", "--note", note)
    assert f"{note!r} is not of the form KEY=VALUE" in told
    assert "duplicate key" in said(capsys, 2, "record", "run.npz", "--note", "a=1", "--note", "a=2")


def test_clocks_are_read_together() -> None:
    before, moment, after = read(), read(), read()
    assert before.monotonic_ns <= moment.monotonic_ns <= after.monotonic_ns
    assert moment_of({"monotonic_ns": 1, "realtime_ns": 2}) == Moment(1, 2)
    for wrong in (None, "stopped", {}, {"monotonic_ns": 1}, {"monotonic_ns": 1.5, "realtime_ns": 2}):
        assert moment_of(wrong) is None


def test_json_of_the_summary_is_plain() -> None:
    from dataclasses import asdict

    assert json.loads(json.dumps(asdict(Moment(1, 2)))) == {"monotonic_ns": 1, "realtime_ns": 2}
