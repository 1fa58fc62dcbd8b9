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
from mcap_ros2.decoder import DecoderFactory

import hapticd
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.recording.recording import recording_into
from hapticd.recording.writer import RecordingWriter
from tests.recording.test_writer import EVENTS, MARKS, some
from tests.support.special_files import KINDS, refused, special, untouched


def a_recording(target: Path, samples: np.ndarray, events: list[dict[str, object]]) -> hapticd.Recording:
    texts = {"scene": {"objects": {}}, "status": {"rate_hz": 10_000}}
    changes = [{"revision": 7}, {"revision": 8}, {"tick": int(samples["tick"][5]), "reset": {}}]
    with RecordingWriter(target) as writer:
        writer.write_all(texts, changes, samples, events)
        writer.finish({"recording": {"lost": 0, "ended": None}})
    return hapticd.load(target)


@pytest.mark.long
def test_the_reader_of_mcap_accepts_the_export(tmp_path: Path) -> None:
    given = some(12_000)
    given["tick"] += np.uint64(2**53)
    given["position_m"] = np.random.default_rng(1).standard_normal((12_000, 2))
    given["revision"] = np.where(np.arange(12_000) < 100, 7, 8)
    events = [{"time_ns": 100_000 * number, **event} for number, event in enumerate(EVENTS[:3])]
    a_recording(tmp_path / "run.npz", given, events)
    assert main(["export", str(tmp_path / "run.npz"), str(tmp_path / "run.mcap")]) == 0
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
        assert counts == {"hapticd/samples": 12_000, "hapticd/event": 3, "hapticd/change": 3, "hapticd/status": 1}
        schemas = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        assert {topic: (schema.name, schema.encoding) for topic, schema in schemas.items()} == {
            "hapticd/samples": ("hapticd_msgs/msg/Sample", "ros2msg"),
            "hapticd/event": ("hapticd.Event", "jsonschema"),
            "hapticd/status": ("hapticd.Status", "jsonschema"),
            "hapticd/change": ("hapticd.Change", "jsonschema"),
        }
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
        told = [(json.loads(message.data), message.log_time) for _, _, message in reader.iter_messages("hapticd/event")]
        assert told == [(event, event["time_ns"]) for event in events]
        # A change has the time of the first sample that it acts on.
        changes = [
            (json.loads(message.data), message.log_time) for _, _, message in reader.iter_messages("hapticd/change")
        ]
        reset = {"tick": 2**53 + 5, "reset": {}}
        assert changes == [({"revision": 7}, 0), (reset, 500_000), ({"revision": 8}, 10_000_000)]


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


@pytest.mark.parametrize(("ending", "package", "extra"), [("mcap", "zstandard", "mcap"), ("csv", "pandas", "pandas")])
def test_a_missing_extra_is_named_before_anything_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(HapticdError) as caught, recording_into(tmp_path / f"run.{ending}"):
        raise AssertionError("the block is not entered")
    assert str(caught.value) == f".{ending} needs the packages of the extra `{extra}`: pip install 'hapticd[{extra}]'"
    assert os.listdir(tmp_path) == []


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
