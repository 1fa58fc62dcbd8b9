"""Recordings: written completely or not at all, on full disks, and by processes that are killed."""

from __future__ import annotations

import errno
import json
import os
import resource
import subprocess
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, records
from hapticd.base.errors import HapticdError
from hapticd.protocol.events import event_map
from hapticd.recording.event_columns import EVENT_MEMBER_SCHEMAS, NO_TIME, columns_of, dtype_of, rows_of
from hapticd.recording.recording import check_target, load, recording_into
from hapticd.recording.writer import DiskFullError, RecordingWriter
from tests.support.special_files import KINDS, refused, special, untouched

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


def event_array(events: Sequence[Mapping[str, object]]) -> np.ndarray:
    """Events as they stand in a .npz."""
    _, columns = columns_of(events)
    stretches = list(rows_of(events, columns))
    return np.concatenate(stretches) if stretches else np.zeros(0, dtype_of(columns))


def test_npz_gives_back_the_written_data(tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    with RecordingWriter(target) as writer:
        writer.write(some(4))
        writer.write(some(3, 4))
        for event in EVENTS:
            writer.write_event(event)
        assert not target.exists(), "in place only when it is whole"
        writer.finish({"scene": {"objects": {}}}, {"truth": np.eye(2)})
    with np.load(target) as archive:
        assert archive["samples"].dtype == SAMPLE_DTYPE
        assert archive["samples"].tobytes() == some(7).tobytes()
        assert archive["truth"].tolist() == np.eye(2).tolist()
        assert json.loads(str(archive["scene"])) == {"objects": {}}
        assert archive["events"]["event"].tolist() == ["contact", "overrun", "fault", "contact"]
    assert os.listdir(tmp_path) == ["run.npz"]


def test_without_events(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run.npz") as writer:
        writer.write(some(1))
        writer.finish()
    with np.load(tmp_path / "run.npz") as archive:
        assert len(archive["events"]) == 0
        assert archive["events"].dtype == np.dtype([("event", "<U1"), ("tick", "<i8"), ("time_ns", "<i8")])


def test_a_failed_recording_leaves_no_file_and_changes_none(tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    target.write_text("precious")
    with pytest.raises(RuntimeError), RecordingWriter(target, overwrite=True) as writer:
        writer.write(some(3))
        writer.write_event({"time_ns": 0, **EVENTS[0]})
        raise RuntimeError
    assert target.read_text() == "precious"
    assert os.listdir(tmp_path) == ["run.npz"]


# ---- Nothing is replaced unasked -----------------------------------------------------------------------------------


def test_a_file_that_is_there_is_not_replaced_unasked(tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    target.write_text("precious")
    with pytest.raises(HapticdError, match=r"run.npz: already exists; give another name, or --overwrite"):
        RecordingWriter(target)
    assert os.listdir(tmp_path) == ["run.npz"] and target.read_text() == "precious"
    with RecordingWriter(target, overwrite=True) as writer:
        writer.write(some(3))
        writer.finish({"scene": {}})
    assert len(load(target).samples) == 3


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_appears_meanwhile_keeps_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    target, other, ours = (tmp_path / name for name in ("run.npz", "run-2.npz", "run-3.npz"))
    with RecordingWriter(target) as writer:
        writer.write(some(3))
        target.write_text("precious")
        other.write_text("this, too")
        writer.finish({"scene": {}})
        assert writer.displaced and writer.target == ours
    assert target.read_text() == "precious" and other.read_text() == "this, too"
    assert load(ours).samples.tobytes() == some(3).tobytes()
    assert set(tmp_path.iterdir()) == {target, other, ours}


def test_the_target_of_a_link_is_replaced_not_the_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.npz").symlink_to(tmp_path / "real" / "run.npz")
    with RecordingWriter(tmp_path / "link.npz") as writer:
        writer.write(some(2))
        writer.finish()
    assert (tmp_path / "link.npz").is_symlink()
    with np.load(tmp_path / "real" / "run.npz") as archive:
        assert len(archive["samples"]) == 2


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_target_that_is_not_a_regular_file_is_refused(tmp_path: Path, kind: str, overwrite: bool) -> None:
    (tmp_path / "linked").mkdir()
    special(tmp_path / "run.npz", kind)
    (tmp_path / "linked" / "run.npz").symlink_to(tmp_path / "run.npz")
    for folder in (tmp_path, tmp_path / "linked"):
        for check in (check_target, RecordingWriter):
            with untouched(tmp_path), pytest.raises(HapticdError) as caught:
                check(folder / "run.npz", overwrite)
            assert str(caught.value) == refused(folder / "run.npz", kind)


@pytest.mark.parametrize("kind", KINDS)
def test_a_special_file_that_appears_meanwhile_keeps_its_name(tmp_path: Path, kind: str) -> None:
    target, next_free = tmp_path / "run.npz", tmp_path / "run-3.npz"
    with RecordingWriter(target, overwrite=True) as writer:
        writer.write(some(3))
        special(target, kind)
        before = target.lstat()
        (tmp_path / "run-2.npz").write_text("precious")
        writer.finish({"scene": {}})
        assert writer.displaced and writer.target == next_free
    assert os.path.samestat(target.lstat(), before) and (tmp_path / "run-2.npz").read_text() == "precious"
    assert load(next_free).samples.tobytes() == some(3).tobytes()


def test_unwritable_targets_are_reported_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "directory.npz").mkdir()
    for target, told in (
        (tmp_path / "run.txt", "must end in .npz, .csv or .mcap"),
        (tmp_path / "run", "must end in .npz, .csv or .mcap"),
        (tmp_path / "directory.npz", "not a regular file but a directory"),
        (tmp_path / "missing" / "run.npz", "cannot be written: the folder"),
    ):
        with pytest.raises(HapticdError, match=told), recording_into(target):
            raise AssertionError("the block is not entered")
    assert os.listdir(tmp_path) == ["directory.npz"]


@contextmanager
def small_disk(place: Path, size: str) -> Iterator[Path]:
    """A file system with room for `size`."""
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "none", place], capture_output=True)
    if mounted.returncode:
        pytest.skip(f"may not mount a small file system: {mounted.stderr.decode().strip()}")
    try:
        yield place
    finally:
        subprocess.run(["umount", place], check=True)


@contextmanager
def limited_files(size: int) -> Iterator[None]:
    """No file may grow beyond `size`."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def fill(target: Path) -> tuple[np.ndarray, int]:
    """Records until the disk is full, and finishes; returns the given samples and the number reported as written."""
    given = []
    with RecordingWriter(target) as writer:
        writer.begin({"scene": {"objects": {}}})
        writer.write_change({"revision": 1})
        with pytest.raises(DiskFullError, match=r"cannot be written: (No space left on device|File too large)"):
            for batch in range(10_000):
                given.append(noisy(200, 200 * batch))
                writer.write_event({"event": "contact", "object": "x", "tick": 200 * batch, "time_ns": 20_000 * batch})
                writer.write(given[-1])
        writer.finish({"recording": {"ended": "full"}})
        return np.concatenate(given), writer.count


def noisy(count: int, first: int) -> np.ndarray:
    """Samples that do not compress."""
    samples = some(count, first)
    samples["position_m"] = np.random.default_rng(first).standard_normal((count, 2))
    return samples


def test_on_a_full_disk_the_recorded_samples_are_kept(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "4m") as disk:
        given, count = fill(disk / "run.npz")
        check_kept(disk / "run.npz", given, count)
        assert not [name for name in os.listdir(disk) if name.startswith(".")]


def test_at_the_size_limit_of_a_file_the_recorded_samples_are_kept(tmp_path: Path) -> None:
    with limited_files(2_500_000):
        given, count = fill(tmp_path / "run.npz")
    check_kept(tmp_path / "run.npz", given, count)
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


def check_kept(target: Path, given: np.ndarray, count: int) -> None:
    recorded = load(target)
    assert len(recorded.samples) == count
    assert recorded.samples.tobytes() == given[:count].tobytes()
    assert len(given) - count < 4 * 1024 * 1024 / 112, "only the end gave way to the rest"
    assert recorded.texts["scene"] == {"objects": {}}
    assert recorded.texts["changes"] == [{"revision": 1}]
    assert recorded.texts["recording"] == {"ended": "full"}


@pytest.mark.parametrize("room", [0, 1000])
def test_a_disk_without_any_room_is_one_line_and_no_file(tmp_path: Path, room: int) -> None:
    with limited_files(room):  # noqa: SIM117
        with (
            pytest.raises(HapticdError, match="cannot be written: File too large"),
            RecordingWriter(tmp_path / "run.npz") as writer,
        ):
            writer.begin({})
            with suppress(DiskFullError):
                for batch in range(100):
                    writer.write(noisy(200, 200 * batch))
            writer.finish({"long": "x" * 2000})
    assert os.listdir(tmp_path) == []


def test_numpy_and_zipfile_find_nothing_wrong_with_an_archive(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run.npz") as writer:
        for first in range(0, 40_000, 1000):
            writer.write(some(1000, first))
        writer.finish({"scene": {}})
    with zipfile.ZipFile(tmp_path / "run.npz") as archive:
        assert archive.testzip() is None
        assert archive.namelist()[0] == "samples.npy"
    assert np.load(tmp_path / "run.npz")["samples"].tobytes() == some(40_000).tobytes()


def test_every_bit_comes_back(tmp_path: Path) -> None:
    """Also integers beyond 2^53, and all values of a double."""
    samples = some(500)
    samples["tick"] += np.uint64(2**63)
    samples["time_ns"] += 2**62 + 1
    numbers = np.random.default_rng(1).integers(0, 2**64, (500, 2), np.uint64).view(np.float64)
    samples["force_n"] = np.where(np.isfinite(numbers), numbers, -0.0)
    samples["velocity_m_per_s"][:, 0] = np.nextafter(0.1, np.arange(500))
    samples["lateness_ns"], samples["flags"] = -(2**31), 2**32 - 1
    with RecordingWriter(tmp_path / "run.npz") as writer:
        for part in np.array_split(samples, 7):
            writer.write(part)
        writer.finish({"scene": {}})
    assert load(tmp_path / "run.npz").samples.tobytes() == samples.tobytes()


def test_the_schema_of_events_names_every_member() -> None:
    event = records(EVENT_DTYPE, 1)[0]
    found: set[str] = set()
    for kind in EventKind:
        event["kind"] = kind
        found |= event_map(event, "x").keys()
    assert set(EVENT_MEMBER_SCHEMAS) == found


def test_another_dtype_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HapticdError, match="changed the form"), RecordingWriter(tmp_path / "run.npz") as writer:
        writer.write(some(1))
        writer.write(np.zeros(1, [("tick", "<u8")]))


def test_columns_of_events() -> None:
    array = event_array(EVENTS)
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
    assert event_array([]).shape == (0,)


MARKS: list[dict[str, object]] = [
    {"event": "mark", "tick": 1, "time_ns": 1, "text": "plain", "data": None},
    {"event": "mark", "tick": 2, "time_ns": 2, "text": "5", "data": 5},
    {"event": "mark", "tick": 3, "time_ns": 3, "text": 'a,"b"\n\rnull', "data": "5"},
    {"event": "mark", "tick": 4, "time_ns": 4, "text": "null", "data": {"é": [1, 2.5, None, True, "x,y"]}},
    {"event": "gesture_end", "tick": 5, "time_ns": 5, "started_tick": 0, "completed": False},
    {"event": "contact", "tick": 6, "time_ns": 6, "object": None, "onset_time_ns": 5, "before_tick_s": 0.1}
    | {"speed_m_per_s": 1.0, "true_speed_m_per_s": None, "amplitude_m_per_s2": 0.0, "scale": 1.0, "appeared": True},
    {"event": "fault", "tick": 7, "time_ns": 7, "faults": []},
    {"event": "overrun", "tick": 8, "time_ns": 8, "missed": 3, "count": 1},
    {"event": "of_a_later_version", "tick": 9, "time_ns": 9, "new": True, "other": 2.5, "said": "it"},
]


def test_events_come_back_as_they_were(tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    with RecordingWriter(target) as writer:
        writer.write(some(10))
        for event in MARKS:
            writer.write_event(event)
        writer.finish({"scene": {}})
    events = load(target).events
    assert events == MARKS
    for event, given in zip(events, MARKS, strict=True):
        assert {name: type(value) for name, value in event.items()} == {
            name: type(value) for name, value in given.items()
        }


def test_text_and_data_of_marks_are_columns(tmp_path: Path) -> None:
    array = event_array(MARKS)
    assert array["text"][:5].tolist() == ["plain", "5", 'a,"b"\n\rnull', "null", ""]
    assert array["data"][:5].tolist() == ["", "5", '"5"', '{"é": [1, 2.5, null, true, "x,y"]}', ""]
    assert array["completed"].tolist() == [-1, -1, -1, -1, 0, -1, -1, -1, -1] and array["started_tick"].dtype == "<i8"


@pytest.mark.slow
def test_one_long_mark_does_not_make_a_file_large(tmp_path: Path) -> None:
    long = {"event": "mark", "tick": 0, "time_ns": 0, "text": "x" * 1000, "data": "y" * 8000}
    with RecordingWriter(tmp_path / "run.npz") as writer:
        writer.write(some(10))
        writer.write_event(long)
        for tick in range(3000):
            writer.write_event({"event": "overrun", "tick": tick, "time_ns": tick, "missed": 1, "count": 1})
        writer.finish({})
    assert (tmp_path / "run.npz").stat().st_size < 500_000, "3000 rows of 36 kB, mostly nothing"
    events = load(tmp_path / "run.npz").events
    assert len(events) == 3001 and events[0] == long
    with np.load(tmp_path / "run.npz") as file:
        assert file["events"]["text"][0] == "x" * 1000


def test_columns_do_not_depend_on_other_events() -> None:
    array = event_array(EVENTS)
    for index, event in enumerate(EVENTS):
        alone = event_array([event])
        for name in alone.dtype.names or ():
            assert alone.dtype[name].kind == array.dtype[name].kind, name
            assert alone.dtype[name].kind == "U" or alone.dtype[name] == array.dtype[name], name
            np.testing.assert_equal(alone[name][0], array[name][index])
