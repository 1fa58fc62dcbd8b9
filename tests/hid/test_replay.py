"""Recordings of devices are written, read, refused, and played as a device."""

from __future__ import annotations

import os
import socket
import struct
import threading
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE, Fault, records
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.config.hid import Hid, Replay
from hapticd.daemon import status_text
from hapticd.daemon.engine import Engine
from hapticd.doctor import service
from hapticd.doctor.machine import Machine, Needs
from hapticd.hid.connection import Connection
from hapticd.hid.plan import DeviceError
from hapticd.hid.replay import Recording, ReplayDevice, load, record, save
from hapticd.hid.sources import replay_source
from hapticd.hid.verdict import verdict_of
from tests.support.hid_descriptors import Joystick

STICK = bytes(Joystick())
OVER = "the recording is over; restart the daemon, or set device.replay.loop"


def report(x: int, y: int) -> bytes:
    return struct.pack("<BhhB", 1, x, y, 0)


def moving(count: int = 100) -> Recording:
    """Return a recording that moves down by one count a millisecond."""
    return Recording("stick", 0x1209, 0x5AFF, STICK, tuple((n / 1000, report(0, n)) for n in range(count)))


@pytest.fixture
def path(tmp_path: Path) -> str:
    return str(tmp_path / "stick.jsonl")


def test_as_it_was_written(path: str) -> None:
    recording = moving()
    save(path, recording, False)
    assert load(path) == recording
    assert recording.on_change
    assert not Recording("", 0, 0, b"", ((0.0, b"a"), (0.1, b"a"))).on_change


HEAD = '{"recording": 1, "name": "a", "vendor": 1, "product": 2, "descriptor": "0501"}\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "contains no reports"),
        (
            "hello\n",
            ":1: not a line of a recording of `hapticd devices dump`: Expecting value: line 1 column 1 (char 0)",
        ),
        ("[]\n", ":1: not a line of a recording of `hapticd devices dump`: "),
        ("{}\n", ":1: not a line of a recording of `hapticd devices dump`: the first line must have recording, name"),
        (
            '{"recording": 2}\n',
            ":1: not a line of a recording of `hapticd devices dump`: recording: must be version 1, is 2",
        ),
        (
            '{"recording": 1, "name": "a", "descriptor": ""}\n',
            ":1: not a line of a recording of `hapticd devices dump`: the first line must have vendor, product",
        ),
        (
            HEAD.replace("0501", "05x"),
            ":1: not a line of a recording of `hapticd devices dump`: non-hexadecimal number",
        ),
        (HEAD, "contains no reports; move the device while it is recorded"),
        (
            HEAD + '[0.1, "01"]\n[0.05, "01"]\n',
            ":3: not a line of a recording of `hapticd devices dump`: the time must be between 0.1 and 1e+06 s",
        ),
        (
            HEAD + '["a", "01"]\n',
            ":2: not a line of a recording of `hapticd devices dump`: could not convert string to float: 'a'",
        ),
        (HEAD + '[NaN, "01"]\n', "the time must be between 0 and 1e+06 s, is nan"),
        (HEAD + '[0, "0"]\n', ":2: not a line of a recording of `hapticd devices dump`: "),
        (HEAD + '[0, ""]\n', "a report must have 1 to 4096 bytes, this one has 0"),
        (HEAD + "[0]\n", ":2: not a line of a recording of `hapticd devices dump`: "),
        (HEAD + "{}\n", ":2: not a line of a recording of `hapticd devices dump`: "),
        (HEAD + f'[1{"0" * 400}, "01"]\n', ":2: not a line of a recording of `hapticd devices dump`: "),
        (HEAD + "[" * 50000 + "\n", ":2: "),
    ],
)
def test_files_that_are_not_recordings(path: str, text: str, message: str) -> None:
    Path(path).write_text(text)
    with pytest.raises(HapticdError) as caught:
        load(path)
    assert str(caught.value).startswith(path) and message in str(caught.value) and "\n" not in str(caught.value)


def test_a_windows_editor_adds_a_mark_and_line_ends(path: str) -> None:
    save(path, moving(), False)
    Path(path).write_bytes(b"\xef\xbb\xbf" + Path(path).read_bytes().replace(b"\n", b"\r\n"))
    assert load(path) == moving()


def test_no_file(path: str) -> None:
    with pytest.raises(HapticdError) as caught:
        load(path)
    assert str(caught.value) == f"{path}: No such file or directory"
    Path(path).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(HapticdError):
        load(path)


def test_a_file_that_may_have_no_end_is_not_a_recording(path: str) -> None:
    os.mkfifo(path)
    for other in (path, "/dev/zero"):
        with pytest.raises(HapticdError) as caught:
            load(other)
        assert str(caught.value) == f"{other}: not a recording: not a regular file"


def test_rounds_of_zero_length_are_separated_by_a_pause(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    due: list[float] = []

    def next_round(self: ReplayDevice, when: float) -> bool:
        due.append(when)
        return len(due) < 4

    monkeypatch.setattr(ReplayDevice, "_wait_until", next_round)
    at_once = Recording("stick", 0x1209, 0x5AFF, STICK, ((0.0, report(0, 1)),))
    device = ReplayDevice(at_once, Replay(path=path, loop=True, speed=0.5))
    device._thread.join(60)
    device.close()
    assert np.diff(due) == pytest.approx([2e-3] * 3)


def test_recording_a_device() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        for n in range(3):
            theirs.send(report(n, -n))
        theirs.shutdown(socket.SHUT_RDWR)
        reports = record(ours.fileno(), 60.0)
    assert [data for _, data in reports] == [report(n, -n) for n in range(3)]
    assert all(0.0 <= one[0] <= two[0] for one, two in pairwise(reports))


def read_all(device: ReplayDevice) -> list[bytes]:
    found = []
    while data := os.read(device.fileno(), 4096):
        found.append(data)
    return found


def test_played_once(path: str) -> None:
    save(path, moving(), False)
    source = replay_source(Replay(path=path, speed=10.0), Hid())
    opened = source()
    assert read_all(opened.device) == [data for _, data in moving().reports]  # type: ignore[arg-type]
    opened.device.close()
    with pytest.raises(DeviceError) as caught:
        source()
    assert str(caught.value) == f"{path}: {OVER}"


def test_played_for_ever_and_closed_meanwhile(path: str) -> None:
    save(path, moving(3), False)
    device = ReplayDevice(load(path), Replay(path=path, loop=True, speed=50.0))
    found = [os.read(device.fileno(), 4096) for _ in range(7)]
    assert [struct.unpack("<BhhB", data)[2] for data in found] == [0, 1, 2, 0, 1, 2, 0]
    device.write(b"\x01")
    device.close()


def test_a_recording_of_a_device_that_cannot_be_driven(path: str) -> None:
    save(path, Recording("mouse", 1, 2, bytes(Joystick(without=frozenset({0x73}))), ((0.0, b"\x01"),)), False)
    with pytest.raises(InvalidError) as caught:
        replay_source(Replay(path=path), Hid())
    reason = "the device cannot be driven: its report descriptor has no Set Constant Force"
    assert str(caught.value) == f"device.replay.path: {path}: {reason}"


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_missing_recording_is_named_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    """With the key and the folder of the YAML file, not that of the process."""
    (tmp_path / "rig.yaml").write_text("device: {kind: replay, replay: {path: rec.jsonl}}\n")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    Path("rec.jsonl").touch()
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "run"))
    assert main([command, "-c", "../rig.yaml"]) == 1
    problem = f"device.replay.path: {tmp_path}/rec.jsonl: No such file or directory"
    assert problem in "".join(capsys.readouterr()).splitlines()[-1 if command == "run" else -2]


def test_a_recording_is_treated_as_no_joystick(
    path: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No other program can change its effects, and no force moves it, so no command for a joystick is of use."""
    monkeypatch.setattr("hapticd.hid.connection.PLAYING_REPORT_TIMEOUT_S", 0.0)
    save(path, moving(), False)
    connection = Connection(replay_source(Replay(path=path, loop=True), Hid()))
    connection.open()
    try:
        status = connection.status()
    finally:
        connection.stop()
    assert status["state"] == "connected" and status["resets_seen"] is None and status["foreign_effect_s"] is None
    assert {name for name, _ in status_text._connection(status)} == {"connection"}
    machine = Machine(Path("/"), daemon=lambda: {"version": "1", "connection": status}, version="1")
    assert [finding.verdict for finding in service.daemon(machine, Needs())] == ["ok"]
    config = Path(path).with_suffix(".yaml")
    config.write_text(f"device: {{kind: replay, replay: {{path: {path}}}}}\n")
    main(["check", "-c", str(config)])
    assert "noise of positions may tap repeatedly\n" in capsys.readouterr().out
    refused = "device.kind replay: forces do not move a recording; give the configuration of the joystick"
    for command in (["calibrate", "--yes"], ["verify", "--yes", "--recording", "none.csv"]):
        assert main([*command, "-c", str(config)]) == 1
        assert capsys.readouterr().err == f"hapticd: {refused}\n"


def test_configuration() -> None:
    with pytest.raises(InvalidError) as caught:
        load_config({"device": {"kind": "replay"}})
    assert str(caught.value) == "device: kind replay needs device.replay.path, a recording of `hapticd devices dump`"


def test_an_engine_takes_the_measured_range_of_a_recorded_stick(path: str) -> None:
    """The stick reports -327..396 of -512..511 and rests at 20: without counts it rests 2.4 mm inside the floor."""
    descriptor = bytes(Joystick(axis_range=(-512, 511), axis_bits=10))
    plan = verdict_of(Hid(), descriptor).plan
    assert plan is not None

    def seen(y: int) -> bytes:
        data = bytearray(b"\x01\0\0\0\0\0\0\0")
        plan.y.bits.put(data, y)
        return bytes(data)

    way = [20, -327, 20, 396]
    reports = tuple((0.005 * n, seen(way[n % 4])) for n in range(40))
    save(path, Recording("stick", 0x45E, 0x1B, descriptor, reports), False)
    config = {
        "servo": {"realtime": "off", "rate_hz": 1000},
        "device": {
            "kind": "replay",
            "replay": {"path": path, "loop": True},
            "max_speed_m_per_s": 100,
            "hid": {"travel_m": 0.06, "axes": {"y": {"counts": [-327, 20, 396]}}},
        },
        "scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}}},
    }
    engine = Engine(load_config(config))
    engine.start()
    room, taken = records(SAMPLE_DTYPE, 16384), records(SAMPLE_DTYPE, 0)
    try:
        pause, deadline = threading.Event(), time.monotonic() + 60
        while not {-0.06, 0.0, 0.06} <= set(taken["position_m"][:, 1].round(12)):
            assert time.monotonic() < deadline
            engine.beat()
            count, _ = engine.read_samples(room)
            taken = np.concatenate([taken, room[:count].copy()])
            pause.wait(0.01)
    finally:
        engine.stop()
    y_m, force_n = taken["position_m"][:, 1], taken["contact_force_n"][:, 1]
    assert set(y_m.round(12)) == {-0.06, 0.0, 0.06}
    assert (force_n[y_m == 0.0] == 0.0).all() and force_n.max() > 0.0


def test_an_engine_follows_a_recording(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The handle moves into a wall until the recording ends, which the engine reports as a lost device."""
    wait_until, seen = ReplayDevice._wait_until, threading.Event()
    waited = 0

    def until_seen(self: ReplayDevice, when: float) -> bool:
        """Hold back the last report until the servo has received one, however late it began."""
        nonlocal waited
        waited += 1
        return (waited < 400 or seen.wait(60)) and wait_until(self, when)

    monkeypatch.setattr(ReplayDevice, "_wait_until", until_seen)
    save(path, moving(400), False)
    config = {
        "servo": {"realtime": "off", "rate_hz": 1000},
        "device": {"kind": "replay", "replay": {"path": path}, "hid": {"travel_m": 0.05}},
        "scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}}},
    }
    engine = Engine(load_config(config))
    engine.start()
    taken = []
    room = records(SAMPLE_DTYPE, 16384)
    try:
        pause, deadline = threading.Event(), time.monotonic() + 60
        while Fault.DEVICE not in engine.counters().faults:
            assert time.monotonic() < deadline
            engine.beat()
            count, _ = engine.read_samples(room)
            taken.append(room[:count].copy())
            if count and room["position_m"][count - 1, 1] < 0.0:
                seen.set()
            pause.wait(0.01)
        connection = engine.connection
        assert connection is not None
        while connection.status()["problem"] != f"{path}: {OVER}":
            assert time.monotonic() < deadline
            pause.wait(0.01)
    finally:
        seen.set()
        engine.stop()
    count, _ = engine.read_samples(room)
    heights = np.concatenate([*taken, room[:count]])["position_m"][:, 1]
    counts = heights / (0.05 / 32767)
    assert np.all(np.diff(counts) <= 1e-9)
    assert counts[-1] < -1 and counts == pytest.approx(np.round(counts), abs=1e-6)
