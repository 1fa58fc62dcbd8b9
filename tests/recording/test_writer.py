"""Files of samples and events."""

from __future__ import annotations

import csv
import errno
import json
import os
import resource
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, records
from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.protocol.events import event_map
from hapticd.recording.event_columns import NO_TIME, columns_of, dtype_of, rows_of
from hapticd.recording.formats import check_target, open_writer
from hapticd.recording.mcap_format import EVENT_MEMBERS
from hapticd.recording.mcap_writer import CHUNK_BYTES
from hapticd.recording.reader import load_recorded
from hapticd.recording.recovery import recover
from hapticd.recording.writer import DiskFullError
from tests.support.special_files import KINDS, refused, special, untouched

FORMS = ["npz", "csv", "mcap"]

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


def test_npz_gives_back_what_was_written(tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    with open_writer(target) as writer:
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


def test_csv_gives_back_what_was_written(tmp_path: Path) -> None:
    with open_writer(tmp_path / "run.csv") as writer:
        writer.write(some(4))
        writer.write(some(3, 4))
        for event in EVENTS:
            writer.write_event(event)
        writer.finish()
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
        with open_writer(tmp_path / name) as writer:
            writer.write(some(1))
            writer.finish()
    with np.load(tmp_path / "run.npz") as archive:
        assert len(archive["events"]) == 0
        assert archive["events"].dtype == np.dtype([("event", "<U1"), ("tick", "<i8"), ("time_ns", "<i8")])


@pytest.mark.parametrize("name", ["run.npz", "run.csv", "run.mcap"])
def test_what_fails_leaves_nothing_and_changes_nothing(tmp_path: Path, name: str) -> None:
    target = tmp_path / name
    target.write_text("precious")
    with pytest.raises(RuntimeError), open_writer(target, overwrite=True) as writer:
        writer.write(some(3))
        writer.write_event({"time_ns": 0, **EVENTS[0]})
        raise RuntimeError
    assert target.read_text() == "precious"
    assert os.listdir(tmp_path) == [name]


# ---- Nothing is replaced unasked -----------------------------------------------------------------------------------


RECORDING_FILES = pytest.mark.parametrize(
    ("name", "there"),
    [
        ("run.npz", "run.npz"),
        ("run.mcap", "run.mcap"),
        ("run.csv", "run.csv"),
        ("run.csv", "run.events.csv"),
        ("run.csv", "run.about.json"),
    ],
)
"""`name` is the target of a recording, `there` one of the files that it consists of."""


@RECORDING_FILES
def test_a_file_that_is_there_is_not_replaced_unasked(tmp_path: Path, name: str, there: str) -> None:
    (tmp_path / there).write_text("precious")
    with pytest.raises(HapticdError, match=f"{there}: is there already; give another name, or --overwrite"):
        open_writer(tmp_path / name)
    assert os.listdir(tmp_path) == [there] and (tmp_path / there).read_text() == "precious"
    with open_writer(tmp_path / name, overwrite=True) as writer:
        writer.write(some(3))
        writer.finish({"scene": {}})
    assert len(load_recorded(tmp_path / name).samples) == 3


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize(
    ("name", "appeared"),
    [("run.npz", "run.npz"), ("run.mcap", "run.mcap"), ("run.csv", "run.csv"), ("run.csv", "run.about.json")],
)
def test_a_file_that_appears_meanwhile_keeps_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, appeared: str, links: bool
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    with open_writer(tmp_path / name) as writer:
        writer.write(some(3))
        (tmp_path / appeared).write_text("precious")
        other = tmp_path / name.replace("run", "run-2")
        other.write_text("this, too")
        writer.finish({"scene": {}})
        assert writer.displaced and writer.target == tmp_path / name.replace("run", "run-3")
    assert (tmp_path / appeared).read_text() == "precious" and other.read_text() == "this, too"
    assert load_recorded(writer.target).samples.tobytes() == some(3).tobytes()
    ours = {".csv": {"run-3.csv", "run-3.events.csv", "run-3.about.json"}}.get(Path(name).suffix, {writer.target.name})
    assert set(os.listdir(tmp_path)) == {appeared, other.name} | ours


def test_what_told_of_a_replaced_recording_goes_with_it(tmp_path: Path) -> None:
    for texts in ({"scene": {}}, {}):
        with open_writer(tmp_path / "run.csv", overwrite=True) as writer:
            writer.write(some(3))
            writer.finish(texts)
    assert sorted(os.listdir(tmp_path)) == ["run.csv", "run.events.csv"]


def test_the_target_of_a_link_is_replaced_not_the_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.npz").symlink_to(tmp_path / "real" / "run.npz")
    with open_writer(tmp_path / "link.npz") as writer:
        writer.write(some(2))
        writer.finish()
    assert (tmp_path / "link.npz").is_symlink()
    with np.load(tmp_path / "real" / "run.npz") as archive:
        assert len(archive["samples"]) == 2


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("kind", KINDS)
@RECORDING_FILES
def test_what_is_no_regular_file_is_refused(tmp_path: Path, name: str, there: str, kind: str, overwrite: bool) -> None:
    (tmp_path / "linked").mkdir()
    special(tmp_path / there, kind)
    (tmp_path / "linked" / there).symlink_to(tmp_path / there)
    for folder in (tmp_path, tmp_path / "linked"):
        for check in (check_target, open_writer):
            with untouched(tmp_path), pytest.raises(HapticdError) as caught:
                check(folder / name, overwrite)
            assert str(caught.value) == refused(folder / there, kind)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("ending", FORMS)
def test_what_is_no_regular_file_and_appears_meanwhile_keeps_its_name(tmp_path: Path, kind: str, ending: str) -> None:
    target, next_free = tmp_path / f"run.{ending}", tmp_path / f"run-3.{ending}"
    with open_writer(target, overwrite=True) as writer:
        writer.write(some(3))
        special(target, kind)
        before = target.lstat()
        (tmp_path / f"run-2.{ending}").write_text("precious")
        writer.finish({"scene": {}})
        assert writer.displaced and writer.target == next_free
    assert os.path.samestat(target.lstat(), before) and (tmp_path / f"run-2.{ending}").read_text() == "precious"
    assert load_recorded(next_free).samples.tobytes() == some(3).tobytes()


def test_unwritable_targets_are_told_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "directory.npz").mkdir()
    for target, told in (
        (tmp_path / "run.txt", "must end in .npz, .csv or .mcap"),
        (tmp_path / "run", "must end in .npz, .csv or .mcap"),
        (tmp_path / "directory.npz", "is a directory"),
        (tmp_path / "missing" / "run.npz", "cannot be written: No such file or directory"),
    ):
        with pytest.raises(HapticdError, match=told):
            open_writer(target)
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
    """Records until the disk is full, and finishes; what was given, and how much of it is said to be in the file."""
    given = []
    with open_writer(target) as writer:
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


@pytest.mark.parametrize("ending", FORMS)
def test_on_a_full_disk_what_was_recorded_is_kept(tmp_path: Path, ending: str) -> None:
    with small_disk(tmp_path / "disk", "4m") as disk:
        given, count = fill(disk / f"run.{ending}")
        check_kept(disk / f"run.{ending}", given, count)
        assert not [name for name in os.listdir(disk) if name.startswith(".")]


@pytest.mark.parametrize("ending", FORMS)
def test_what_a_file_may_hold_at_most_is_kept(tmp_path: Path, ending: str) -> None:
    with limited_files(2_500_000):
        given, count = fill(tmp_path / f"run.{ending}")
    check_kept(tmp_path / f"run.{ending}", given, count)
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


def check_kept(target: Path, given: np.ndarray, count: int) -> None:
    recorded = load_recorded(target)
    assert len(recorded.samples) == count
    assert recorded.samples.tobytes() == given[:count].tobytes()
    per_sample = {".csv": 250, ".npz": 112, ".mcap": 160}[target.suffix]
    assert len(given) - count < 4 * 1024 * 1024 / per_sample, "only the end gave way to the rest"
    assert recorded.texts["scene"] == {"objects": {}}
    assert recorded.texts["changes"] == [{"revision": 1}]
    assert recorded.texts["recording"] == {"ended": "full"}


@pytest.mark.parametrize("room", [0, 1000])
@pytest.mark.parametrize("ending", FORMS)
def test_a_disk_without_any_room_is_one_line_and_no_file(tmp_path: Path, ending: str, room: int) -> None:
    with limited_files(room):  # noqa: SIM117
        with (
            pytest.raises(HapticdError, match="cannot be written: File too large"),
            open_writer(tmp_path / f"run.{ending}") as writer,
        ):
            writer.begin({})
            with suppress(DiskFullError):
                for batch in range(100):
                    writer.write(noisy(200, 200 * batch))
            writer.finish({"long": "x" * 2000})
    assert os.listdir(tmp_path) == []


KILLED = """
import os, signal, sys
import numpy as np
from hapticd.recording.formats import open_writer
writer = open_writer(sys.argv[1], overwrite=True)
writer.begin({"scene": {"objects": {}}}, {"notes": {}})
writer.write_change({"revision": 1})
writer.write_event({"event": "overrun", "tick": 3, "time_ns": 4, "missed": 2})
for batch in np.array_split(np.load(sys.argv[2]), 100):
    writer.write(batch)
os.kill(os.getpid(), signal.SIGKILL)
"""


def record_until_killed(target: Path, samples: np.ndarray) -> None:
    given = target.with_name("given.npy")
    np.save(given, samples)
    killed = subprocess.run([sys.executable, "-c", KILLED, target, given], capture_output=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    given.unlink()


@pytest.mark.parametrize("torn", [b"", b"123,4"])
@pytest.mark.parametrize("ending", FORMS)
def test_what_a_killed_recording_left_is_recovered(tmp_path: Path, ending: str, torn: bytes) -> None:
    target = tmp_path / f"run.{ending}"
    target.write_text("an old recording")
    given = noisy(20_000, 0)
    record_until_killed(target, given)
    assert target.read_text() == "an old recording"
    (part,) = tmp_path.glob(f".run.{ending}.*.part")
    with open(part, "ab") as file:
        file.write(torn)
    assert recover(target).files == [tmp_path / f"run.recovered.{ending}"]
    recorded = load_recorded(tmp_path / f"run.recovered.{ending}")
    count = len(recorded.samples)
    assert recorded.samples.tobytes() == given[:count].tobytes()
    # A chunk of MCAP is written when it holds a second of samples or 1 MiB, everything else at once.
    assert count == len(given) if ending != "mcap" else count >= len(given) - CHUNK_BYTES // 147 - 200
    assert recorded.texts["scene"] == {"objects": {}}
    assert recorded.texts["changes"] == [{"revision": 1}]
    assert recorded.texts["recording"] == {"ticks": count, "events": 1, "ended_because": "killed", "notes": {}}
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]
    assert not recover(target).files and not recover(target).problems


def test_what_killed_recordings_left_gets_a_name_of_its_own(tmp_path: Path) -> None:
    target = tmp_path / "run[1].npz"
    for _ in range(2):
        record_until_killed(target, some(100))
    names = ["run[1].recovered-2.npz", "run[1].recovered.npz"]
    assert sorted(path.name for path in recover(target).files) == names
    assert sorted(os.listdir(tmp_path)) == names


@pytest.mark.parametrize("ending", FORMS)
def test_a_recording_under_way_is_let_alone(tmp_path: Path, ending: str) -> None:
    target = tmp_path / f"run.{ending}"
    with open_writer(target) as writer:
        writer.write(some(3))
        found = recover(target)
        assert not found.files and [line.split(": ")[1] for line in found.problems] == ["is still being recorded"]
        writer.write(some(3, 3))
        writer.finish({"scene": {}})
    assert len(load_recorded(target).samples) == 6


def test_numpy_and_zipfile_find_nothing_wrong_with_an_archive(tmp_path: Path) -> None:
    with open_writer(tmp_path / "run.npz") as writer:
        for first in range(0, 40_000, 1000):
            writer.write(some(1000, first))
        writer.finish({"scene": {}})
    with zipfile.ZipFile(tmp_path / "run.npz") as archive:
        assert archive.testzip() is None
        assert archive.namelist()[0] == "samples.npy"
    assert np.load(tmp_path / "run.npz")["samples"].tobytes() == some(40_000).tobytes()


@pytest.mark.parametrize("ending", FORMS)
def test_every_form_gives_back_every_bit(tmp_path: Path, ending: str) -> None:
    """Also whole numbers beyond 2^53, and whatever a double can be."""
    samples = some(500)
    samples["tick"] += np.uint64(2**63)
    samples["time_ns"] += 2**62 + 1
    numbers = np.random.default_rng(1).integers(0, 2**64, (500, 2), np.uint64).view(np.float64)
    samples["force_n"] = np.where(np.isfinite(numbers), numbers, -0.0)
    samples["velocity_m_per_s"][:, 0] = np.nextafter(0.1, np.arange(500))
    samples["lateness_ns"], samples["flags"] = -(2**31), 2**32 - 1
    with open_writer(tmp_path / f"run.{ending}") as writer:
        for part in np.array_split(samples, 7):
            writer.write(part)
        writer.finish({"scene": {}})
    assert load_recorded(tmp_path / f"run.{ending}").samples.tobytes() == samples.tobytes()


# ---- MCAP, read by its own reader ----------------------------------------------------------------------------------


def test_mcap_is_what_its_own_reader_expects(tmp_path: Path) -> None:
    given = some(12_000)
    given["tick"] += np.uint64(2**53)
    given["position_m"] = np.random.default_rng(1).standard_normal((12_000, 2))
    with open_writer(tmp_path / "run.mcap") as writer:
        writer.begin({"scene": {"objects": {}}, "status": {"rate_hz": 10_000}})
        writer.write_change({"revision": 7})
        writer.write_status({"tick": 1})
        for part in np.array_split(given, 60):
            writer.write(part)
            if part["tick"][0] == 2**53:
                for event in EVENTS:
                    writer.write_event({"time_ns": 5, **event})
        writer.finish({"recording": {"lost": 0, "ended": None}})
    with open(tmp_path / "run.mcap", "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert {one.name: json.loads(one.data) for one in reader.iter_attachments()} == {
            "scene.json": {"objects": {}},
            "status.json": {"rate_hz": 10_000},
        }
        assert [(one.name, one.metadata) for one in reader.iter_metadata()] == [
            ("recording", {"lost": "0", "ended": "null"})
        ]
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        counts = {summary.channels[id].topic: n for id, n in summary.statistics.channel_message_counts.items()}
        assert counts == {"hapticd/samples": 12_000, "hapticd/event": 4, "hapticd/change": 1, "hapticd/status": 1}
        times = summary.statistics.message_start_time, summary.statistics.message_end_time
        assert times == (0, int(given["time_ns"][-1]))
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 2
        for (_, _, message, sample), record in zip(
            reader.iter_decoded_messages(["hapticd/samples"]), given, strict=True
        ):
            assert message.log_time == message.publish_time == record["time_ns"]
            assert message.sequence == int(record["tick"]) & 0xFFFFFFFF
            for name in given.dtype.names or ():
                assert np.array_equal(getattr(sample, name), record[name])
        between = reader.iter_messages(["hapticd/samples"], starting_at=10**9, ending_before=10**9 + 10**7)
        assert [message.log_time for _, _, message in between] == list(range(10**9, 10**9 + 10**7, 10**5))
        events = [json.loads(message.data) for _, _, message in reader.iter_messages(["hapticd/event"])]
        assert events == [{"time_ns": 5, **event} for event in EVENTS]
        (change,) = reader.iter_messages(["hapticd/change"])
        assert json.loads(change[2].data) == {"revision": 7}


def test_the_schema_of_events_names_every_member() -> None:
    event = records(EVENT_DTYPE, 1)[0]
    found: set[str] = set()
    for kind in EventKind:
        event["kind"] = kind
        found |= event_map(event, "x").keys()
    assert set(EVENT_MEMBERS) == found


def test_mcap_takes_no_samples_that_cdr_would_pad(tmp_path: Path) -> None:
    packed = np.dtype([("tick", "<u8"), ("flags", "<u4"), ("time_ns", "<i8")])
    with pytest.raises(HapticdError, match="record into"), open_writer(tmp_path / "run.mcap") as writer:
        writer.write(np.zeros(1, packed))


def test_without_the_extra_mcap_is_refused_and_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.mcap").touch()
    monkeypatch.setitem(sys.modules, "zstandard", None)
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    for attempt in (open_writer, load_recorded):
        with pytest.raises(HapticdError, match=r"pip install 'hapticd\[mcap\]'"):
            attempt(tmp_path / "run.mcap")


@pytest.mark.parametrize("ending", FORMS)
@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and so on", b"tick,time_ns\n1", b"\x89MCAP0\r\n\x01"])
def test_what_is_no_recording_is_one_line(tmp_path: Path, ending: str, content: bytes) -> None:
    target = tmp_path / f"run.{ending}"
    target.write_bytes(content)
    (tmp_path / "run.about.json").write_text("{}")
    with pytest.raises(HapticdError, match=f"run.{ending}: is no recording of hapticd"):
        load_recorded(target)
    with pytest.raises(HapticdError, match="No such file"):
        load_recorded(tmp_path / f"nothing.{ending}")
    with pytest.raises(HapticdError, match="must end in"):
        load_recorded(tmp_path / "run.txt")


def test_another_dtype_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HapticdError, match="changed the form"), open_writer(tmp_path / "run.npz") as writer:
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


@pytest.mark.parametrize("ending", FORMS)
def test_events_come_back_as_they_were(tmp_path: Path, ending: str) -> None:
    target = tmp_path / f"run.{ending}"
    with open_writer(target) as writer:
        writer.write(some(10))
        for event in MARKS:
            writer.write_event(event)
        writer.finish({"scene": {}})
    events = load_recorded(target).events
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
    with open_writer(tmp_path / "run.npz") as writer:
        writer.write(some(10))
        writer.write_event(long)
        for tick in range(3000):
            writer.write_event({"event": "overrun", "tick": tick, "time_ns": tick, "missed": 1, "count": 1})
        writer.finish({})
    assert (tmp_path / "run.npz").stat().st_size < 500_000, "3000 rows of 36 kB, mostly nothing"
    events = load_recorded(tmp_path / "run.npz").events
    assert len(events) == 3001 and events[0] == long
    with np.load(tmp_path / "run.npz") as file:
        assert file["events"]["text"][0] == "x" * 1000


def test_columns_do_not_depend_on_what_else_there_is() -> None:
    array = event_array(EVENTS)
    for index, event in enumerate(EVENTS):
        alone = event_array([event])
        for name in alone.dtype.names or ():
            assert alone.dtype[name].kind == array.dtype[name].kind, name
            assert alone.dtype[name].kind == "U" or alone.dtype[name] == array.dtype[name], name
            np.testing.assert_equal(alone[name][0], array[name][index])


def test_a_text_that_is_none_is_refused(tmp_path: Path) -> None:
    with open_writer(tmp_path / "run.npz") as writer:
        writer.write(some(1))
        writer.finish({})
    with np.load(tmp_path / "run.npz") as file:
        members = dict(file)
    members["events"] = np.frombuffer(b"\xff\xff\xff\x7f", [("event", "<U1")])
    np.savez(tmp_path / "wrong.npz", **members)
    with pytest.raises(HapticdError, match=r"wrong.npz: is no recording of hapticd: a text of it is no Unicode"):
        load_recorded(tmp_path / "wrong.npz")


def test_a_csv_without_events_has_their_line_of_names(tmp_path: Path) -> None:
    assert main(["simulate", "fields", "--for", "10ms", "-o", str(tmp_path / "free.csv")]) == 0
    assert (tmp_path / "free.events.csv").read_text() == "event,tick,time_ns\n"
