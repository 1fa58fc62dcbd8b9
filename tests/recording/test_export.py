"""Recordings in the forms of other programs, read by those programs' own readers."""

from __future__ import annotations

import csv
import json
import os
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

import hapticd
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.recording.export import files_of
from hapticd.recording.recording import recording_into
from hapticd.recording.writer import RecordingWriter
from hapticd.system.extras import install_command
from tests.recording.test_writer import EVENTS, MARKS, some
from tests.support.special_files import KINDS, refused, special, untouched

BOOTED_NS = 1_750_000_000_123_456_789
"""UTC at which CLOCK_MONOTONIC of the machine was 0: 2025-06-15."""
STARTED = {"monotonic_ns": 5_000_000_000, "realtime_ns": BOOTED_NS + 5_000_000_000}
AN_HOUR_NS = 3_600_000_000_000


def a_recording(
    target: Path, samples: np.ndarray, events: list[dict[str, object]], **clocks: object
) -> hapticd.Recording:
    texts = {"scene": {"objects": {}}, "status": {"rate_hz": 10_000}}
    changes = [{"revision": 7}, {"revision": 8}, {"tick": int(samples["tick"][5]), "reset": {}}]
    with RecordingWriter(target) as writer:
        writer.write_all(texts, changes, samples, events)
        writer.finish({"recording": {"lost": 0, "ended": None, **clocks}})
    return hapticd.load(target)


def messages_of(path: Path, *topics: str) -> list[tuple[str, Message]]:
    """Topics and messages of a .mcap, in the order of their times."""
    with open(path, "rb") as file:
        return [
            (channel.topic, message) for _, channel, message in make_reader(file).iter_messages(list(topics) or None)
        ]


@pytest.mark.parametrize(
    ("clocks", "offset_ns"),
    [
        ({"started": STARTED}, BOOTED_NS),
        ({"started": {"monotonic_ns": 0, "realtime_ns": BOOTED_NS}}, BOOTED_NS),
        # The time of day was set meanwhile: the file stays on the clock of its start.
        (
            {"started": STARTED, "ended": {"monotonic_ns": 6_000_000_000, "realtime_ns": BOOTED_NS + AN_HOUR_NS}},
            BOOTED_NS,
        ),
        ({"ended": {"monotonic_ns": 6_000_000_000, "realtime_ns": BOOTED_NS + 6_000_000_000}}, BOOTED_NS),
        # Of the first release, and of a simulation.
        ({"ended": "stopped"}, 0),
        ({}, 0),
    ],
    ids=["started", "at_boot", "time_set", "ended_only", "first_release", "simulated"],
)
def test_times_of_mcap_are_utc_by_one_offset(tmp_path: Path, clocks: dict[str, object], offset_ns: int) -> None:
    given = some(20)
    given["time_ns"] += 5_000_000_000
    given["revision"] = np.where(np.arange(20) < 9, 7, 8)
    event: dict[str, object] = {"event": "mark", "tick": 3, "time_ns": 5_000_300_000, "text": "tap", "data": None}
    recording = a_recording(tmp_path / "run.npz", given, [event], **clocks)
    recording.save(tmp_path / "run.mcap")
    found = messages_of(tmp_path / "run.mcap")
    expected_ns = {
        "hapticd/samples": [5_000_000_000 + 100_000 * tick for tick in range(20)],
        "hapticd/event": [5_000_300_000],
        "hapticd/status": [5_000_000_000],
        "hapticd/change": [5_000_000_000, 5_000_500_000, 5_000_900_000],
    }
    for topic, times_ns in expected_ns.items():
        messages = [message for name, message in found if name == topic]
        assert [message.log_time - offset_ns for message in messages] == times_ns
        assert [message.publish_time for message in messages] == [message.log_time for message in messages]
    with open(tmp_path / "run.mcap", "rb") as file:
        attached = [(one.log_time, one.create_time) for one in make_reader(file).iter_attachments()]
    assert attached == [(offset_ns + 5_000_000_000, offset_ns + 5_000_000_000)] * 2
    # The messages keep the clock of the servo, and the recording its bits.
    data = b"".join(message.data[4:] for topic, message in found if topic == "hapticd/samples")
    assert data == given.tobytes() == hapticd.load(tmp_path / "run.npz").samples.tobytes()
    assert [json.loads(message.data) for topic, message in found if topic == "hapticd/event"] == [event]


def test_mcap_merges_with_the_utc_topic_of_a_camera(tmp_path: Path) -> None:
    """The frame was exposed between the samples 7 and 8."""
    given = some(20)
    given["time_ns"] += 5_000_000_000
    a_recording(tmp_path / "run.npz", given, [], started=STARTED).save(tmp_path / "run.mcap")
    with open(tmp_path / "camera.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("camera/image", "", 0)
        exposed_ns = BOOTED_NS + 5_000_750_000
        writer.add_message(channel, exposed_ns, b"frame", exposed_ns)
        writer.finish()
    both = [*messages_of(tmp_path / "run.mcap", "hapticd/samples"), *messages_of(tmp_path / "camera.mcap")]
    merged = [message.data for _, message in sorted(both, key=lambda pair: pair[1].log_time)]
    at = merged.index(b"frame")
    before, after = (np.frombuffer(merged[place][4:], SAMPLE_DTYPE)["tick"][0] for place in (at - 1, at + 1))
    assert (before, after) == (7, 8)


@pytest.mark.parametrize("moved_ns", [-(2**62), 2**62])
def test_clocks_that_no_machine_has_are_one_line(tmp_path: Path, moved_ns: int) -> None:
    started = {"monotonic_ns": 0, "realtime_ns": 4 * moved_ns}
    recording = a_recording(tmp_path / "run.npz", some(20), [], started=started)
    with pytest.raises(HapticdError, match=r"run.mcap: \.mcap needs times from 1970 to 2554; the recording has others"):
        recording.save(tmp_path / "run.mcap")
    assert os.listdir(tmp_path) == ["run.npz"]


@pytest.mark.long
def test_the_reader_of_mcap_accepts_the_export(tmp_path: Path) -> None:
    given = some(12_000)
    given["tick"] += np.uint64(2**53)
    given["position_m"] = np.random.default_rng(1).standard_normal((12_000, 2))
    given["revision"] = np.where(np.arange(12_000) < 100, 7, 8)
    events = [{"time_ns": 100_000 * number, **event} for number, event in enumerate(EVENTS[:3])]
    a_recording(tmp_path / "run.npz", given, events, started={"monotonic_ns": 0, "realtime_ns": 10**18})
    assert main(["export", str(tmp_path / "run.npz"), str(tmp_path / "run.mcap")]) == 0
    with open(tmp_path / "run.mcap", "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert {one.name: json.loads(one.data) for one in reader.iter_attachments()} == {
            "scene.json": {"objects": {}},
            "status.json": {"rate_hz": 10_000},
        }
        assert [(one.name, one.metadata) for one in reader.iter_metadata()] == [
            (
                "recording",
                {"lost": "0", "ended": "null", "started": '{"monotonic_ns": 0, "realtime_ns": 1000000000000000000}'},
            )
        ]
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        counts = {summary.channels[id].topic: n for id, n in summary.statistics.channel_message_counts.items()}
        assert counts == {"hapticd/samples": 12_000, "hapticd/event": 3, "hapticd/change": 3, "hapticd/status": 1}
        schemas = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        assert {topic: (schema.name, schema.encoding) for topic, schema in schemas.items()} == {
            "hapticd/samples": ("hapticd_msgs/msg/Sample", "ros2msg"),
            "hapticd/event": ("hapticd.Event", "jsonschema"),
            "hapticd/status": ("hapticd.Status", "jsonschema"),
            "hapticd/change": ("hapticd.Change", "jsonschema"),
        }
        times = summary.statistics.message_start_time, summary.statistics.message_end_time
        assert times == (10**18, 10**18 + int(given["time_ns"][-1]))
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 2
        for (_, _, message, sample), record in zip(
            reader.iter_decoded_messages(["hapticd/samples"]), given, strict=True
        ):
            assert message.log_time == message.publish_time == 10**18 + int(record["time_ns"])
            assert message.sequence == int(record["tick"]) & 0xFFFFFFFF
            for name in given.dtype.names or ():
                assert np.array_equal(getattr(sample, name), record[name])
        begin = 10**18 + 10**9
        between = reader.iter_messages(["hapticd/samples"], starting_at=begin, ending_before=begin + 10**7)
        assert [message.log_time for _, _, message in between] == list(range(begin, begin + 10**7, 10**5))
        told = [(json.loads(message.data), message.log_time) for _, _, message in reader.iter_messages("hapticd/event")]
        assert told == [(event, 10**18 + int(str(event["time_ns"]))) for event in events]
        # A change has the time of the first sample that it acts on.
        changes = [
            (json.loads(message.data), message.log_time) for _, _, message in reader.iter_messages("hapticd/change")
        ]
        reset = {"tick": 2**53 + 5, "reset": {}}
        at = {"start": 10**18, "reset": 10**18 + 500_000, "change": 10**18 + 10_000_000}
        assert changes == [({"revision": 7}, at["start"]), (reset, at["reset"]), ({"revision": 8}, at["change"])]


def test_csv_has_every_bit_and_the_events_beside_it(tmp_path: Path) -> None:
    given = some(500)
    given["tick"] += np.uint64(2**63)
    numbers = np.random.default_rng(1).integers(0, 2**64, (500, 2), np.uint64).view(np.float64)
    given["force_n"] = np.where(np.isfinite(numbers), numbers, -0.0)
    recording = a_recording(tmp_path / "run.npz", given, EVENTS)
    assert recording.save(tmp_path / "run.csv") == tmp_path / "run.csv"
    with open(tmp_path / "run.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["tick"]) for row in rows] == given["tick"].tolist()
    for name, axis, column in (("force_n", "x", 0), ("force_n", "y", 1), ("position_m", "y", 1)):
        read = np.array([float(row[f"{name}_{axis}"]) for row in rows])
        assert read.tobytes() == given[name][:, column].tobytes()
    assert set(rows[0]) == set(recording.to_pandas().columns)
    with open(tmp_path / "run.events.csv", newline="") as file:
        events = list(csv.DictReader(file))
    assert [event["event"] for event in events] == ["contact", "overrun", "fault", "contact"]
    assert json.loads(events[2]["faults"]) == ["lease", "device"]
    assert [event["appeared"] for event in events] == ["false", "", "", "true"]
    assert [event["missed"] for event in events] == ["", "2", "", ""]
    assert [event["object"] for event in events] == ["floor", "", "", "null"]
    assert json.loads((tmp_path / "run.about.json").read_text()) == recording.texts
    with pytest.raises(HapticdError, match="already exists"):
        recording.save(tmp_path / "run.csv")
    recording.save(tmp_path / "run.csv", overwrite=True)
    assert sorted(os.listdir(tmp_path)) == ["run.about.json", "run.csv", "run.events.csv", "run.npz"]


def test_texts_of_marks_are_cells_whatever_they_hold(tmp_path: Path) -> None:
    a_recording(tmp_path / "run.npz", some(10), MARKS).save(tmp_path / "run.csv")
    for read in (
        lambda file: list(csv.DictReader(file)),
        lambda file: pandas.read_csv(file, dtype=str).to_dict("records"),
    ):
        with open(tmp_path / "run.events.csv", newline="") as file:
            marks = [row for row in read(file) if row["event"] == "mark"]
        assert [mark["text"] for mark in marks[:3]] == [mark["text"] for mark in MARKS[:3]]
        assert json.loads(marks[3]["data"]) == MARKS[3]["data"]


def test_a_csv_without_events_has_their_line_of_names(tmp_path: Path) -> None:
    assert main(["simulate", "fields", "--for", "10ms", "-o", str(tmp_path / "free.csv")]) == 0
    assert (tmp_path / "free.events.csv").read_text() == "event,tick,time_ns\n"
    assert len(pandas.read_csv(tmp_path / "free.csv")) == len(hapticd.load(tmp_path / "free.npz").samples) == 100


@pytest.mark.parametrize("ending", ["csv", "mcap"])
def test_a_recording_into_another_form_is_exported_at_its_end(tmp_path: Path, ending: str) -> None:
    target = tmp_path / f"run.{ending}"
    with recording_into(target) as writer:
        writer.write(some(3))
        writer.finish({"scene": {}})
        assert not target.exists()
    assert target.exists() and hapticd.load(tmp_path / "run.npz").samples.tobytes() == some(3).tobytes()
    with pytest.raises(HapticdError, match=r"must end in \.npz; other formats are exports for other programs"):
        hapticd.load(target)
    with recording_into(target, overwrite=True) as writer:
        writer.write(some(4))
        writer.finish({"scene": {}})
    assert target.stat().st_size > 0 and len(hapticd.load(tmp_path / "run.npz").samples) == 4


@pytest.mark.parametrize("there", ["run.npz", "run.csv", "run.events.csv", "run.about.json"])
def test_no_file_of_an_export_is_replaced_unasked(tmp_path: Path, there: str) -> None:
    (tmp_path / there).write_text("precious")
    with pytest.raises(HapticdError, match=f"{there}: already exists"), recording_into(tmp_path / "run.csv"):
        raise AssertionError("the block is not entered")
    assert os.listdir(tmp_path) == [there] and (tmp_path / there).read_text() == "precious"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("name", "there"), [("run.mcap", "run.mcap"), ("run.csv", "run.events.csv")])
def test_an_export_writes_to_no_device(tmp_path: Path, name: str, there: str, kind: str) -> None:
    recording = a_recording(tmp_path / "given.npz", some(10), [])
    special(tmp_path / there, kind)
    with untouched(tmp_path), pytest.raises(HapticdError) as caught:
        recording.save(tmp_path / name, overwrite=True)
    assert str(caught.value) == refused(tmp_path / there, kind)


NEEDED = [("mcap", "mcap.writer", "mcap"), ("mcap", "zstandard", "mcap"), ("csv", "pandas", "pandas")]
"""A folder called `mcap` is imported as a package, too; only its module `writer` shows that the right one is there."""


@pytest.mark.parametrize(("ending", "package", "extra"), NEEDED)
def test_a_missing_extra_is_named_before_anything_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(HapticdError) as caught, recording_into(tmp_path / f"run.{ending}"):
        raise AssertionError("the block is not entered")
    needs = f"{tmp_path}/run.{ending}: .{ending} needs the packages of the extra `{extra}`"
    assert str(caught.value) == f"{needs}: {install_command(extra)}"
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("ending", "package", "extra"), NEEDED)
@pytest.mark.parametrize(
    "command", ["record {}", "record --past {}", "simulate fields -o {}", "export run.npz {}", "replay run.npz -o {}"]
)
def test_every_command_that_exports_names_a_missing_extra_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    ending: str,
    package: str,
    extra: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    assert main(command.format(f"run.{ending}").split()) == 1
    needs = f"run.{ending}: .{ending} needs the packages of the extra `{extra}`: {install_command(extra)}"
    assert capsys.readouterr().err == f"hapticd: {needs}\n" and os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("ending", "package", "text", "shown"),
    [
        ("csv", "pandas", "raise ValueError('numpy.dtype size changed')", "pandas: numpy.dtype size changed"),
        ("csv", "pandas", "raise ImportError('No dependencies:\\npytz')", "pandas: No dependencies: pytz"),
        ("mcap", "zstandard", "raise ImportError('libzstd.so.1: not found')", "zstandard: libzstd.so.1: not found"),
    ],
)
def test_a_broken_package_is_refused_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, package: str, text: str, shown: str
) -> None:
    (tmp_path / f"{package}.py").write_text(f"{text}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, package, raising=False)
    with pytest.raises(HapticdError) as caught:
        files_of(Path(f"run.{ending}"))
    assert str(caught.value).endswith(f"' ({shown})")


def test_samples_are_laid_out_as_cdr_is() -> None:
    """Their bytes are the message."""
    members = [(name, SAMPLE_DTYPE[name]) for name in SAMPLE_DTYPE.names or ()]
    assert np.dtype(members, align=True) == SAMPLE_DTYPE


def test_a_recording_whose_export_fails_is_kept(tmp_path: Path) -> None:
    with (
        pytest.raises(HapticdError, match=rf"run.mcap: already exists.*; the recording is in {tmp_path}/run.npz"),
        recording_into(tmp_path / "run.mcap") as writer,
    ):
        writer.write(some(3))
        (tmp_path / "run.mcap").write_text("precious")
        writer.finish()
    assert (tmp_path / "run.mcap").read_text() == "precious"
    assert len(hapticd.load(tmp_path / "run.npz").samples) == 3
