"""Files of samples and events."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest

from hapticd.core import SAMPLE_DTYPE
from hapticd.errors import HapticdError
from hapticd.record import NO_TIME, event_array, open_sink

EVENTS: list[dict[str, object]] = [
    {
        "event": "contact",
        "tick": 3,
        "object": "floor",
        "onset_time_ns": 299_950,
        "speed_m_per_s": 0.25,
        "true_speed_m_per_s": None,
        "appeared": False,
    },
    {"event": "overrun", "tick": 5, "missed": 2},
    {"event": "fault", "tick": 6, "faults": ["lease", "device"]},
    {
        "event": "contact",
        "tick": 9,
        "object": None,
        "onset_time_ns": 2**62 + 1,
        "speed_m_per_s": None,
        "true_speed_m_per_s": None,
        "appeared": True,
    },
]


def some(count: int, first: int = 0) -> np.ndarray:
    samples = np.zeros(count, SAMPLE_DTYPE)
    ticks = np.arange(first, first + count)
    samples["tick"], samples["time_ns"] = ticks, ticks * 100_000
    samples["position_m"] = np.column_stack([ticks / 3, -ticks / 7])
    samples["force_n"][:, 1] = 1e-300
    samples["lateness_ns"] = -5
    return samples


def test_npz_gives_back_what_was_written(tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    with open_sink(target) as sink:
        sink.write(some(4))
        sink.write(some(3, 4))
        for event in EVENTS:
            sink.write_event(event)
        assert not target.exists(), "in place only when it is whole"
        sink.finish({"scene": {"objects": {}}}, {"truth": np.eye(2)})
    with np.load(target) as archive:
        assert archive["samples"].dtype == SAMPLE_DTYPE
        assert archive["samples"].tobytes() == some(7).tobytes()
        assert archive["truth"].tolist() == np.eye(2).tolist()
        assert json.loads(str(archive["scene"])) == {"objects": {}}
        assert archive["events"]["event"].tolist() == ["contact", "overrun", "fault", "contact"]
    assert os.listdir(tmp_path) == ["run.npz"]


def test_csv_gives_back_what_was_written(tmp_path: Path) -> None:
    with open_sink(tmp_path / "run.csv") as sink:
        sink.write(some(4))
        sink.write(some(3, 4))
        for event in EVENTS:
            sink.write_event(event)
        sink.finish()
    with open(tmp_path / "run.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    samples = some(7)
    assert [int(row["tick"]) for row in rows] == samples["tick"].tolist()
    assert [(float(row["position_m_x"]), float(row["position_m_y"])) for row in rows] == [
        tuple(position) for position in samples["position_m"].tolist()
    ]
    assert {float(row["force_n_y"]) for row in rows} == {1e-300}
    with open(tmp_path / "run.events.csv", newline="") as file:
        events = list(csv.DictReader(file))
    assert [event["event"] for event in events] == ["contact", "overrun", "fault", "contact"]
    assert json.loads(events[2]["faults"]) == ["lease", "device"]
    assert [event["appeared"] for event in events] == ["false", "", "", "true"]
    assert [event["missed"] for event in events] == ["", "2", "", ""]
    assert sorted(os.listdir(tmp_path)) == ["run.csv", "run.events.csv"]


def test_without_events(tmp_path: Path) -> None:
    for name in ("run.npz", "run.csv"):
        with open_sink(tmp_path / name) as sink:
            sink.write(some(1))
            sink.finish()
    with np.load(tmp_path / "run.npz") as archive:
        assert len(archive["events"]) == 0


@pytest.mark.parametrize("name", ["run.npz", "run.csv"])
def test_what_fails_leaves_nothing_and_changes_nothing(tmp_path: Path, name: str) -> None:
    target = tmp_path / name
    target.write_text("precious")
    with pytest.raises(RuntimeError), open_sink(target) as sink:
        sink.write(some(3))
        sink.write_event(EVENTS[0])
        raise RuntimeError
    assert target.read_text() == "precious"
    assert os.listdir(tmp_path) == [name]


def test_the_target_of_a_link_is_replaced_not_the_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.npz").symlink_to(tmp_path / "real" / "run.npz")
    with open_sink(tmp_path / "link.npz") as sink:
        sink.write(some(2))
        sink.finish()
    assert (tmp_path / "link.npz").is_symlink()
    with np.load(tmp_path / "real" / "run.npz") as archive:
        assert len(archive["samples"]) == 2


def test_unwritable_targets_are_told_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "directory.npz").mkdir()
    for target, told in (
        (tmp_path / "run.txt", "must end in .npz or .csv"),
        (tmp_path / "run", "must end in .npz or .csv"),
        (tmp_path / "directory.npz", "is a directory"),
        (tmp_path / "missing" / "run.npz", "cannot be written: No such file or directory"),
    ):
        with pytest.raises(HapticdError, match=told):
            open_sink(target)
    assert os.listdir(tmp_path) == ["directory.npz"]


def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    with (
        pytest.raises(HapticdError, match="cannot be written: No space left on device"),
        open_sink(tmp_path / "run.npz") as sink,
    ):
        (full,) = [file for file in sink._files if file.name.endswith("samples")]
        with open("/dev/full", "wb") as device:
            os.dup2(device.fileno(), full.fileno())
        for _ in range(100):
            sink.write(some(1000))
        sink.finish()
    assert os.listdir(tmp_path) == []


def test_another_dtype_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HapticdError, match="changed the form"), open_sink(tmp_path / "run.npz") as sink:
        sink.write(some(1))
        sink.write(np.zeros(1, [("tick", "<u8")]))


def test_columns_of_events() -> None:
    array = event_array(lambda: EVENTS)
    assert array["tick"].dtype == "<i8" and array["tick"].tolist() == [3, 5, 6, 9]
    assert array["object"].tolist() == ["floor", "", "", ""]
    assert array["appeared"].dtype == "i1" and array["appeared"].tolist() == [0, -1, -1, 1]
    assert array["faults"].tolist() == ["", "", '["lease", "device"]', ""]
    assert array["missed"].dtype == "<i8" and array["missed"].tolist() == [0, 2, 0, 0]
    assert array["onset_time_ns"].dtype == "<i8"
    assert array["onset_time_ns"].tolist() == [299_950, NO_TIME, NO_TIME, 2**62 + 1], "every nanosecond is kept"
    assert np.isnat(array["onset_time_ns"].view("M8[ns]")).tolist() == [False, True, True, False]
    assert array["speed_m_per_s"][0] == 0.25 and np.isnan(array["speed_m_per_s"][1:]).all()
    assert array["true_speed_m_per_s"].dtype == "<f8" and np.isnan(array["true_speed_m_per_s"]).all()
    assert event_array(lambda: []).shape == (0,)


def test_columns_do_not_depend_on_what_else_there_is() -> None:
    array = event_array(lambda: EVENTS)
    for index, event in enumerate(EVENTS):
        alone = event_array(lambda event=event: [event])  # type: ignore[misc]
        for name in alone.dtype.names or ():
            assert alone.dtype[name].kind == array.dtype[name].kind, name
            assert alone.dtype[name].kind == "U" or alone.dtype[name] == array.dtype[name], name
            np.testing.assert_equal(alone[name][0], array[name][index])
