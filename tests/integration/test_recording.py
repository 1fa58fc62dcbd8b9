"""Recordings of a running daemon: complete with what they were rendered with, and honest about what they lack."""

from __future__ import annotations

import asyncio
import itertools
import math
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapticd
from hapticd.base.core import SAMPLE_DTYPE, Flag
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client
from hapticd.client.record import RecordSummary, record
from hapticd.config.configuration import Overruns, default_config, load_config
from hapticd.recording.recording import load
from hapticd.recording.recovery import recover
from hapticd.recording.replay import replay
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon
from tests.support.fake_daemon import FakeDaemon, fake_daemon, result

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
DISC = {"kind": "disc", "center_m": [0.01, 0.0], "radius_m": 0.004, "material": "steel"}
PULSE = {
    **dict.fromkeys(("frequency_hz", "decay_time_s")),
    "attack_slope_per_s": 100,
    "waveform": {"rate_hz": 700, "samples": [0, 0.4, 1, 0.7, -0.2, 0]},
}
WAYS = [[0.1 * step, 0.02 * np.sin(step), 0.008 * np.cos(2.1 * step)] for step in range(600)]

QUIET = """servo: {rate_hz: 1000, realtime: off, overruns: {threshold: 1}}
device: {sim: {encoder_step_m: 1.0e-5}}
flight: {seconds: 60}
"""


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "quiet.yaml"
    config.write_text(QUIET)
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@contextmanager
def recording(daemon: Daemon, target: Path, *options: str, limit: int | None = None) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, which ends with the block."""

    def limited() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    with subprocess.Popen(
        [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), "record", str(target), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=limited,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_until_it_records(client: Client, target: Path, process: subprocess.Popen[str]) -> None:
    with client.samples() as batches:
        for _ in batches:  # 50 times a second
            assert process.poll() is None
            notes = target.parent.glob(f".{target.name}.{process.pid}.*.notes")
            if any(b'["dtype"' in path.read_bytes() for path in notes):
                return


@pytest.mark.long
def test_what_a_daemon_rendered_is_rendered_again_bit_for_bit(daemon: Daemon, tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    with connect(daemon.directory) as client:
        client.set_scene({"objects": {"floor": FLOOR}})
        client.update_materials({"wood": None})
        client.set_operator([[0, 0, 0.01]], interpolation="linear")
        client.reset()
        with recording(daemon, target) as process:
            wait_until_it_records(client, target, process)
            client.set_operator(WAYS, interpolation="minimum_jerk")
            with client.events() as events:
                for change in changes(client):
                    tick = change()["tick"]
                    # Something is touched between one change and the next.
                    next(event for event in events if event["event"] == "contact" and event["tick"] > tick)
            client.set_operator([[0, 0, 0.01]], interpolation="linear")
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, err) == (0, "") and "nothing lost" in out, out
        scene, materials = client.get_scene()["scene"], client.get_materials()["materials"]
    again = replay(target)
    assert again.missing_revisions == () and again.settled
    assert again.identical == len(again.samples) > 0.9 * again.ticks
    assert len(set(again.samples["revision"].tolist())) >= 5
    assert any("play" in change for change in again.texts["changes"])
    assert any("reset" in change for change in again.texts["changes"])
    # The changes, one after the other, lead to what there was at the end.
    objects, made_of = dict(again.texts["scene"]["objects"]), dict(again.texts["materials"])
    for change in again.texts["changes"]:
        for into, key in ((objects, "objects"), (made_of, "materials")):
            for name, value in change.get(key, {}).items():
                into[name] = value
                if value is None:
                    del into[name]
    assert (objects, made_of) == (scene["objects"], materials)
    assert again.texts["recording"]["missing_revisions"] == [] and again.texts["recording"]["gaps"] == []


def changes(client: Client) -> Iterator[Callable[[], Any]]:
    """What is done, one after the other."""
    yield lambda: client.update_scene({"disc": DISC}, wait=True)
    yield lambda: client.update_materials({"wood": {"stiffness_n_per_m": 500, "tap": PULSE}}, wait=True)
    yield lambda: client.play("steel", direction=(1, 2), amplitude_m_per_s2=3)
    yield lambda: client.update_scene({"disc": {"center_m": [0.0, 0.0]}}, wait=True)
    yield lambda: client.reset(["floor"])
    yield lambda: client.set_scene({"ramp_s": 0.05, "objects": {"floor": FLOOR, "disc": DISC}}, wait=True)
    yield lambda: client.update_materials({"wood": None}, wait=True)
    yield lambda: client.reset()
    yield lambda: client.update_scene({"disc": None}, wait=True)


def test_changes_are_told_as_they_are(daemon: Daemon) -> None:
    with connect(daemon.directory) as client:
        revision = client.set_scene({"objects": {"floor": FLOOR}})["revision"]
        client.update_materials({"wood": None})
        floor = client.get_scene()["scene"]["objects"]["floor"]
        with client.telemetry("change") as messages:
            # What came before may still be on its way to a new subscriber, commands that have no revision among it.
            each = (message for _, message in messages)
            told = itertools.dropwhile(lambda message: message.get("revision", 0) <= revision + 1, each)
            client.update_scene({"disc": DISC})
            assert next(told) == {
                "revision": revision + 2,
                "objects": {"disc": client.get_scene()["scene"]["objects"]["disc"]},
            }
            client.update_scene({"disc": None, "nothing": None})
            assert next(told) == {"revision": revision + 3, "objects": {"disc": None}}
            client.set_scene({"display": {"vibration": False}, "objects": {"floor": FLOOR, "other": FLOOR}})
            display = {"force": True, "vibration": False}
            assert next(told) == {"revision": revision + 4, "scene": {"display": display}, "objects": {"other": floor}}
            client.update_materials({"mine": {"stiffness_n_per_m": 100}})
            mine = client.get_materials()["materials"]["mine"]
            assert next(told) == {"revision": revision + 5, "materials": {"mine": mine}}
            client.update_materials({"mine": None})
            assert next(told) == {"revision": revision + 6, "materials": {"mine": None}}
            tick = client.play(
                mode={"frequency_hz": 100.0, "decay_time_s": 0.01}, direction=(0, -2), amplitude_m_per_s2=4
            )["tick"]
            change = next(told)
            assert change["play"].pop("angular_frequency_rad_per_s") == pytest.approx(200 * np.pi)
            assert change["play"].pop("decay_rate_per_s") == pytest.approx(100)
            play = {"attack": "coefficient", "direction": [0.0, -2.0], "amplitude_m_per_s2": 4.0}
            assert change == {"tick": tick, "play": play}
            tick = client.reset(["floor"])["tick"]
            assert next(told) == {"tick": tick, "reset": {"objects": ["floor"]}}
            tick = client.reset()["tick"]
            assert next(told) == {"tick": tick, "reset": {}}
            many = {f"disc{number}": {**DISC, "center_m": [0.1, number / 1e4]} for number in range(1001)}
            large = client.update_scene(many)["revision"]
            assert next(told) == {"revision": large, "large": True}
            client.set_scene({"objects": {}})


def test_the_configuration_goes_round(daemon: Daemon) -> None:
    with connect(daemon.directory) as client:
        config = load_config(client.get_config()["config"])
    assert config.servo.rate_hz == 1000 and config.device.sim.encoder_step_m == 1e-5
    changed = {"rate_hz": 1000.0, "realtime": "off", "overruns": Overruns(threshold=1.0)}
    assert config.servo == default_config().servo.model_copy(update=changed)
    assert config.device.sim.hand == default_config().device.sim.hand


@pytest.mark.long
def test_what_a_killed_recording_left_is_told_by_the_next(daemon: Daemon, tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    with connect(daemon.directory) as client, recording(daemon, target) as process:
        wait_until_it_records(client, target, process)
        (part,) = tmp_path.glob(f".{target.name}.{process.pid}.*.part")
        with client.samples() as batches:
            while part.stat().st_size < 1000 * SAMPLE_DTYPE.itemsize:
                next(batches)
        process.kill()
        process.communicate(timeout=PATIENCE_S)
    assert len(os.listdir(tmp_path)) == 2
    with recording(daemon, target, "--for", "100ms") as process:
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0 and "nothing lost" in out
    assert err == (
        f"hapticd: {target}: {part.name} in its folder: another recording is running, or was killed; "
        f"`hapticd record --recover {target}` recovers killed ones\n"
    )
    assert recover(target).files == [tmp_path / "run.recovered.npz"]
    assert sorted(os.listdir(tmp_path)) == ["run.npz", "run.recovered.npz"]
    recovered = load(tmp_path / "run.recovered.npz")
    assert recovered.texts["recording"]["ended_because"] == "killed"
    assert len(recovered.samples) > 0 and (np.diff(recovered.samples["tick"].astype(np.int64)) == 1).all()
    assert replay(tmp_path / "run.recovered.npz").missing_revisions == ()


@pytest.mark.slow
def test_a_full_disk_ends_a_recording_that_is_kept(daemon: Daemon, tmp_path: Path) -> None:
    target = tmp_path / "run.npz"
    with recording(daemon, target, limit=700_000) as process:
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert err == f"hapticd: {target}: cannot be written: File too large; {target} has everything before that\n"
    assert os.listdir(tmp_path) == ["run.npz"]
    samples = load(target).samples
    assert f"{len(samples):,} ticks" in out and len(samples) > 0


# ---- A daemon that says what a real one cannot be made to ----------------------------------------------------------


class Told:
    """A daemon that, once a recording has begun, publishes what it is given."""

    def __init__(
        self, directory: Path, *messages: tuple[str, dict[str, Any]], revisions: tuple[int, ...] = (1,)
    ) -> None:
        self._directory = directory
        self._messages = messages
        self._revisions = list(revisions)
        self.started = [1]
        self.rates_hz = [1000.0]
        """Before the scene is read, after it was once, twice; the last one stays."""
        self.threshold = 1.0
        self._reads = 0
        self.daemon: FakeDaemon | None = None

    def _answer(self, request: dict[str, Any]) -> list[bytes]:
        assert self.daemon is not None
        last = len(self._revisions) == 1
        match request["method"]:
            case "get_status":
                started = self.started[0] if len(self.started) == 1 else self.started.pop(0)
                rate_hz = self.rates_hz[min(self._reads, len(self.rates_hz) - 1)]
                overruns = {"threshold": self.threshold}
                return [result(request, {"started_ns": started, "rate_hz": rate_hz, "overruns": overruns})]
            case "get_config":
                for topic, message in self._messages:
                    self.daemon.publish(topic, message)
                return [result(request, {"config": {"servo": {}, "device": {}}})]
            case "get_scene":
                revision = self._revisions[0] if last else self._revisions.pop(0)
                self._reads += 1
                objects = {f"object{number}": FLOOR for number in range(revision)}
                return [result(request, {"scene": {"ramp_s": 0.02, "objects": objects}, "revision": revision})]
            case _:
                return [result(request, {"materials": {}, "revision": 1})]

    def record(self, target: Path, ticks: int) -> RecordSummary:
        stop = threading.Event()

        def progress(recorded_s: float) -> None:
            if recorded_s >= (ticks - 0.5) / 1000:
                stop.set()

        with fake_daemon(self._directory, self._answer) as self.daemon, connect(self._directory) as client:
            return record(client, target, stop=stop, progress=progress)


def samples(first: int, count: int, revision: int = 1) -> tuple[str, dict[str, Any]]:
    batch = np.zeros(count, SAMPLE_DTYPE)
    batch["tick"], batch["revision"] = np.arange(first, first + count), revision
    batch["time_ns"] = batch["tick"] * 1_000_000
    description = np.lib.format.dtype_to_descr(SAMPLE_DTYPE)
    return "samples", {"first_tick": first, "dropped": 0, "dtype": description, "data": batch.tobytes()}


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    return tmp_path / "run"


def test_a_gap_is_told_and_stands_in_the_file(tmp_path: Path, directory: Path) -> None:
    told = Told(directory, samples(0, 100), samples(500, 100))
    kept = told.record(tmp_path / "run.npz", 600)
    assert (kept.ticks, kept.lost, kept.ended_because) == (200, 400, "stopped")
    assert "400 ticks lost (400 between daemon and recording, 0 in the ring of the daemon)" in kept.summary()
    recorded = load(tmp_path / "run.npz")
    assert recorded.texts["recording"]["gaps"] == [[100, 400]]
    assert recorded.samples["tick"].tolist() == [*range(100), *range(500, 600)]


@pytest.mark.parametrize("first", [500, 10])
def test_another_daemon_ends_a_recording(tmp_path: Path, directory: Path, first: int) -> None:
    told = Told(directory, samples(0, 100), samples(first, 100))
    told.started = [1, 1, 2]
    kept = told.record(tmp_path / "run.npz", 600)
    assert (kept.ticks, kept.ended_because) == (100, "the daemon was restarted")


def test_a_change_that_was_lost_is_read_again(tmp_path: Path, directory: Path) -> None:
    told = Told(
        directory,
        samples(0, 100),
        samples(100, 100, revision=2),
        ("change", {"revision": 3, "objects": {"object2": FLOOR}}),
        samples(200, 100, revision=3),
        ("change", {"revision": 4, "objects": {"object0": None}}),
        samples(300, 100, revision=4),
        revisions=(1, 3),
    )
    kept = told.record(tmp_path / "run.npz", 400)
    assert kept.missing_revisions == (2,)
    assert "1 revision of the scene missing" in kept.summary()
    texts = load(tmp_path / "run.npz").texts
    assert texts["changes"] == [
        {"revision": 1},
        {"revision": 3, "objects": {"object1": FLOOR, "object2": FLOOR}},
        {"revision": 4, "objects": {"object0": None}},
    ]
    assert texts["recording"]["missing_revisions"] == [2]


def test_a_large_change_is_read(tmp_path: Path, directory: Path) -> None:
    large = ("change", {"revision": 2, "large": True})
    told = Told(directory, samples(0, 100), large, samples(100, 100, revision=2), revisions=(1, 2))
    kept = told.record(tmp_path / "run.npz", 200)
    assert kept.missing_revisions == ()
    assert load(tmp_path / "run.npz").changes == [{"revision": 1}, {"revision": 2, "objects": {"object1": FLOOR}}]


def test_it_begins_with_the_scene_that_was_read(tmp_path: Path, directory: Path) -> None:
    """Nothing that was rendered with the scene before is in it, and no change that is in the scene already."""
    told = Told(
        directory,
        samples(0, 50, revision=4),
        ("change", {"revision": 5, "objects": {"object4": FLOOR}}),
        samples(50, 100, revision=5),
        revisions=(5,),
    )
    kept = told.record(tmp_path / "run.npz", 100)
    recorded = load(tmp_path / "run.npz")
    assert kept.missing_revisions == () and recorded.texts["changes"] == [{"revision": 5}]
    assert recorded.samples["tick"].tolist() == list(range(50, 150))
    assert recorded.texts["scene"]["objects"].keys() == {f"object{number}" for number in range(5)}


def test_the_rate_is_that_of_the_scene_that_was_read(tmp_path: Path, directory: Path) -> None:
    """The servo steps down, which is revision 2, while a recording begins."""
    told = Told(directory, samples(0, 100, revision=2), revisions=(2,))
    told.rates_hz = [1000.0, 500.0]
    assert told.record(tmp_path / "run.npz", 100).missing_revisions == ()
    texts = load(tmp_path / "run.npz").texts
    assert texts["status"]["rate_hz"] == 500.0 and texts["changes"] == [{"revision": 2}]


def test_the_rate_is_that_of_the_scene_that_was_read_again(tmp_path: Path, directory: Path) -> None:
    """Revision 2 cannot be told, and while it is read the servo steps down, which is revision 3."""
    told = Told(
        directory,
        samples(0, 50),
        ("change", {"revision": 2, "large": True}),
        ("change", {"revision": 3, "rate_hz": 500.0}),
        samples(50, 100, revision=3),
        revisions=(1, 2, 3),
    )
    told.rates_hz = [1000.0, 1000.0, 500.0]
    assert told.record(tmp_path / "run.npz", 150).missing_revisions == ()
    changes = load(tmp_path / "run.npz").texts["changes"]
    assert changes == [
        {"revision": 1},
        {"revision": 3, "rate_hz": 500.0, "objects": {"object1": FLOOR, "object2": FLOOR}},
    ]


def test_the_change_of_the_last_samples_is_waited_for(tmp_path: Path, directory: Path) -> None:
    change = ("change", {"revision": 2, "objects": {"object0": None}})
    told = Told(directory, samples(0, 50), samples(50, 50, revision=2), change)
    kept = told.record(tmp_path / "run.npz", 100)
    assert kept.missing_revisions == ()
    assert load(tmp_path / "run.npz").texts["changes"][-1] == change[1]


def overrun(first: int, count: int, late: int) -> tuple[str, dict[str, Any]]:
    """As `samples`, but so many periods were missed before the tick in the middle."""
    topic, message = samples(first, count)
    batch = np.frombuffer(message["data"], SAMPLE_DTYPE).copy()
    batch["time_ns"][count // 2 :] += late * 1_000_000
    batch["flags"][count // 2] = Flag.SKIPPED
    return topic, {**message, "data": batch.tobytes()}


def test_missed_periods_are_told_and_stand_in_the_file(tmp_path: Path, directory: Path) -> None:
    told = Told(directory, overrun(0, 100, 25))
    told.threshold = 0.1
    kept = told.record(tmp_path / "run.npz", 100)
    assert kept.missed_periods == 25
    assert "run.npz: 100 ticks in 0.125 s, 25 periods missed (20 %), nothing lost, 0 events" in kept.summary()
    assert kept.warning == (
        "25 of 125 periods were missed (20 %), more than servo.overruns.threshold (10 %); "
        "`hapticd doctor` says what the machine lacks"
    )
    assert load(tmp_path / "run.npz").texts["recording"]["missed_periods"] == 25
    told = Told(directory, overrun(0, 100, 1))
    told.threshold = 0.1
    kept = told.record(tmp_path / "one.npz", 100)
    assert kept.warning is None and "1 period missed (0.99 %)" in kept.summary()


def test_a_file_that_is_there_is_refused_before_anything_is_recorded(tmp_path: Path, directory: Path) -> None:
    (tmp_path / "run.events.csv").write_text("precious")
    told = Told(directory, samples(0, 100))
    with pytest.raises(HapticdError, match=r"run.events.csv: already exists"):
        told.record(tmp_path / "run.csv", 100)
    assert told.daemon is not None and told.daemon.requests == []
    assert sorted(os.listdir(tmp_path)) == ["run", "run.events.csv"]


# ---- While a block of code runs ------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["npz", "mcap"])
def test_a_block_is_recorded_from_its_first_to_its_last_command(daemon: Daemon, tmp_path: Path, ending: str) -> None:
    target = tmp_path / f"run.{ending}"
    before = time.time_ns()
    with connect(daemon.directory) as client:
        with client.record(target, subject=3, hand="left") as recorder:
            first = client.mark("first", {"trial": 1})["tick"]
            with pytest.raises(HapticdError, match="not complete"):
                _ = recorder.result
            last = client.mark("last")["tick"]
        with pytest.raises(HapticdError, match="already exists"), client.record(target):
            raise AssertionError("the block is not entered")
        with client.record(target, overwrite=True):
            pass
    assert recorder.result.file == str(tmp_path / "run.npz") and target.exists()
    assert recorder.result.ended_because == "stopped"
    started, ended = recorder.result.started, recorder.result.ended
    assert started is not None and ended is not None
    assert before <= started.realtime_ns <= ended.realtime_ns <= time.time_ns()
    assert started.monotonic_ns <= ended.monotonic_ns <= time.monotonic_ns()
    assert first < last


def test_marks_of_a_block_are_in_the_file(daemon: Daemon, tmp_path: Path) -> None:
    with connect(daemon.directory) as client:
        client.set_operator([[0, 0, 0.01]], interpolation="linear")
        notes: dict[str, Any] = {"subject": 3, "hand": "left", "sham": False, "gain": None, "order": (1, [2.5])}
        with client.record(tmp_path / "run.npz", **notes, block=np.int64(4), force_n=np.ones(2)) as recorder:
            first = client.mark("first", {"trial": 1})["tick"]
            operator = client.set_operator([[0, 0, 0.01], [0.01, 0, 0.012]])["tick"]
            with client.events() as events:
                client.set_operator([[0, 0, 0.01]], interpolation="linear")
                next(event for event in events if event["event"] == "gesture_end")
            last = client.mark("last")["tick"]
    recording = recorder.load()
    ticks = recording.samples["tick"]
    assert ticks[0] < first < last <= ticks[-1]
    assert [(mark["tick"], mark["text"], mark["data"]) for mark in recording.marks] == [
        (first, "first", {"trial": 1}),
        (last, "last", None),
    ]
    times = {int(sample["tick"]): int(sample["time_ns"]) for sample in recording.samples}
    assert [mark["time_ns"] for mark in recording.marks] == [times[first], times[last]]
    ends = [event for event in recording.events if event["event"] == "gesture_end"]
    assert operator in [event["started_tick"] for event in ends]
    assert all(isinstance(event["completed"], bool) for event in ends)
    kept = {**notes, "order": [1, [2.5]], "block": 4, "force_n": [1.0, 1.0]}
    assert recording.notes == kept
    assert [type(note) for note in recording.notes.values()] == [type(note) for note in kept.values()]


@pytest.mark.parametrize(
    ("note", "told"),
    [
        ({"when": date(2026, 1, 2)}, r"notes\.when: must be a JSON value, is a Python object of type date"),
        ({"gains": [1.0, math.nan]}, r"notes\.gains\[1\]: must be finite, is nan"),
        ({"by_trial": {1: "wood"}}, r"notes\.by_trial: keys must be strings, this one is 1"),
        ({"name": "\ud800"}, r"notes\.name: must be text that UTF-8 can encode"),
    ],
)
def test_a_note_that_no_file_can_keep_is_refused(
    daemon: Daemon, tmp_path: Path, note: dict[str, Any], told: str
) -> None:
    with (
        connect(daemon.directory) as client,
        pytest.raises(hapticd.InvalidError, match=f"^{told}"),
        client.record(tmp_path / "run.npz", **note),
    ):
        raise AssertionError("the block is not entered")
    assert not (tmp_path / "run.npz").exists()


def test_a_block_with_too_many_missed_periods_is_warned_of(
    daemon: Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `hapticd record` warns: here of a recording that says so, whatever this machine missed."""

    def busy(*arguments: Any, **options: Any) -> RecordSummary:
        return replace(record(*arguments, **options), warning="38 of 148 periods were missed")

    monkeypatch.setattr("hapticd.client.record.record", busy)
    with (
        pytest.warns(hapticd.MissedPeriods, match=r"run\.npz: 38 of 148 periods were missed$") as warned,
        connect(daemon.directory) as client,
        client.record(tmp_path / "run.npz"),
    ):
        pass
    assert [Path(each.filename).name for each in warned] == [Path(__file__).name]


def test_what_goes_wrong_in_a_block_is_what_is_told_and_the_recording_is_kept(daemon: Daemon, tmp_path: Path) -> None:
    with connect(daemon.directory) as client:
        with pytest.raises(ZeroDivisionError), client.record(tmp_path / "run.npz"):
            raise ZeroDivisionError
        assert len(hapticd.load(tmp_path / "run.npz").samples) > 0
        told = r"late.npz: another program created this file meanwhile; the output is in .*late-2.npz"
        with pytest.raises(HapticdError, match=told), client.record(tmp_path / "late.npz"):
            (tmp_path / "late.npz").write_text("precious")
    assert (tmp_path / "late.npz").read_text() == "precious"
    assert len(hapticd.load(tmp_path / "late-2.npz").samples) > 0


@pytest.mark.long
def test_a_block_of_asyncio_is_recorded(daemon: Daemon, tmp_path: Path) -> None:
    async def run() -> tuple[int, int]:
        async with hapticd.aio.connect(daemon.directory, timeout_s=PATIENCE_S) as client:
            async with client.record(tmp_path / "run.npz", subject=3):
                first = (await client.mark("first"))["tick"]
                last = (await client.mark("last"))["tick"]
            with pytest.raises(HapticdError, match="already exists"):
                async with client.record(tmp_path / "run.npz"):
                    raise AssertionError("the block is not entered")
            return first, last

    first, last = asyncio.run(run())
    recording = hapticd.load(tmp_path / "run.npz")
    assert [mark["tick"] for mark in recording.marks] == [first, last]
    assert recording.samples["tick"][0] < first and last <= recording.samples["tick"][-1]
    assert recording.notes == {"subject": 3}


# ---- The flight recorder -------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_file_of_the_flight_recorder_is_rendered_again(tmp_path: Path) -> None:
    """The scene changes within the seconds that are kept, under the hand; the file has what was there before."""
    config = tmp_path / "quiet.yaml"
    config.write_text(QUIET)
    target = tmp_path / "flight.npz"
    with running_daemon("-c", str(config)) as daemon, connect(daemon.directory) as client:
        client.set_scene({"objects": {"floor": FLOOR}})
        before = client.reset()["tick"]
        client.set_operator(WAYS, interpolation="minimum_jerk")
        with client.events() as events:
            for change in changes(client):
                tick = change()["tick"]
                next(event for event in events if event["event"] == "contact" and event["tick"] > tick)
        client.mark("here")
        client.set_operator([[0, 0, 0.01]], interpolation="linear")

        def flight(*arguments: str) -> subprocess.CompletedProcess[str]:
            command = [
                sys.executable,
                "-m",
                "hapticd",
                "--runtime-dir",
                str(daemon.directory),
                "record",
                "--past",
                *arguments,
            ]
            return subprocess.run(command, capture_output=True, text=True, check=False)

        told = flight(str(target)).stdout
        held = hapticd.load(target)
        assert told.startswith(f"{target}: {len(held.samples):,} ticks in ")
        assert told.endswith(f" missed, {len(held.events):,} events\n") or " %), " in told
        again = flight(str(target))
        assert again.returncode == 1 and "already exists; give another name, or --overwrite" in again.stderr
        assert flight(str(target), "--overwrite").returncode == 0
        assert flight(str(tmp_path / "flight.mcap")).stdout.startswith(f"{tmp_path}/flight.mcap: ")
        assert (tmp_path / "flight.mcap").exists()
        refused = flight("f.txt")
        assert refused.stderr == "hapticd: f.txt: must end in .npz, .csv or .mcap\n" and refused.returncode == 1
    recording = hapticd.load(target)
    assert [mark["text"] for mark in recording.marks] == ["here"]
    assert recording.started is not None and recording.ended is not None
    assert recording.started.monotonic_ns < recording.ended.monotonic_ns
    rendered = replay(target)
    assert rendered.missing_revisions == () and rendered.settled
    assert rendered.identical == len(rendered.samples) > 0.9 * rendered.ticks, rendered.summary()
    assert rendered.samples["tick"][0] < before, "also what was rendered with the scene of before"
    assert len(set(rendered.samples["revision"].tolist())) >= 6
