"""`hapticd stop-device`: which records it trusts, what it sends, and what the daemon records for it."""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import math
import os
import pty
import select
import termios
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.config.hid import Hid
from hapticd.daemon.engine import Engine
from hapticd.daemon.process import _stop_device_of_killed_daemon
from hapticd.hid.connection import Opened
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.stopper import Identity, Record, StopFile, identity_of, load, stop_device
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid

ZERO, STOP = [b"\x05\x01\x00\x00"], [b"\x0a\x01\x03\x00", b"\x0c\x03"]
UEVENT = "DRIVER=hid-generic\nHID_ID=0003:0000045E:0000001B\nHID_NAME=A stick\nHID_PHYS=usb-1/input0\nHID_UNIQ=7\n"
FAKE = Identity(1, 2, {"HID_NAME": "fake"})


class Node:
    """A terminal in place of a hidraw node: a character device whose other end shows what was written."""

    def __init__(self, sysfs: Path) -> None:
        self.sysfs = sysfs
        self.ours, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        self.path = os.ttyname(self.theirs)
        number = os.stat(self.path).st_rdev
        self.entry = sysfs / "dev" / "char" / f"{os.major(number)}:{os.minor(number)}"
        (self.entry / "device").mkdir(parents=True)
        (self.entry / "subsystem").symlink_to("../../../../class/hidraw")
        self.says(UEVENT)
        os.set_blocking(self.ours, False)

    def says(self, uevent: str) -> None:
        (self.entry / "device" / "uevent").write_text(uevent)

    def identify(self, fd: int) -> Identity | None:
        return identity_of(os.fstat(fd), self.sysfs)

    def written(self, count: int = 0) -> bytes:
        """Wait until `count` bytes have arrived, which the kernel delivers in pieces, and return them."""
        found, deadline = b"", time.monotonic() + 60.0
        while True:
            with suppress(BlockingIOError):
                found += os.read(self.ours, 65536)
            if len(found) >= count:
                return found
            assert time.monotonic() < deadline, found
            select.select([self.ours], [], [], 1.0)

    def close(self) -> None:
        os.close(self.ours)
        os.close(self.theirs)


@pytest.fixture
def node(tmp_path: Path) -> Iterator[Node]:
    node = Node(tmp_path / "sys")
    yield node
    node.close()


@pytest.fixture
def record(tmp_path: Path, node: Node) -> Path:
    """Write the record of the node, as a daemon does."""
    path = tmp_path / "hapticd.device"
    StopFile(path, node.identify).keep(node.path, node.theirs, ZERO, STOP, 0.0)
    return path


# ---- What is sent ----------------------------------------------------------------------------------------------------


def test_zero_then_stop(record: Path, node: Node) -> None:
    assert os.stat(record).st_mode & 0o777 == 0o600
    text = stop_device(record, sysfs=node.sysfs)
    assert node.written(len(b"".join(ZERO + STOP))) == b"".join(ZERO + STOP)
    assert text == f'{node.path} ("A stick"): force zero, effects stopped, 3 reports'
    assert not record.exists()
    assert stop_device(record, sysfs=node.sysfs) is None


@pytest.mark.parametrize("key", ["HID_ID", "HID_NAME", "HID_PHYS", "HID_UNIQ"])
def test_another_device_at_the_same_node_gets_nothing(record: Path, node: Node, key: str) -> None:
    node.says("".join(line + ("x" if line.startswith(key) else "") + "\n" for line in UEVENT.splitlines()))
    assert "now another device" in str(stop_device(record, sysfs=node.sysfs))
    assert node.written() == b""
    assert not record.exists()


def test_a_driver_that_changed_is_the_same_device(record: Path, node: Node) -> None:
    node.says(UEVENT.replace("hid-generic", "hid-other"))
    assert "force zero" in str(stop_device(record, sysfs=node.sysfs))


def test_a_node_that_is_not_a_hid_device_receives_nothing(record: Path, node: Node) -> None:
    (node.entry / "subsystem").unlink()
    (node.entry / "subsystem").symlink_to("../../../../class/tty")
    assert "no longer a HID device" in str(stop_device(record, sysfs=node.sysfs))
    assert node.written() == b""


def test_a_link_in_the_place_of_the_node_gets_nothing(record: Path, node: Node, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(node.path)
    record.write_text(record.read_text().replace(node.path, str(tmp_path / "link")))
    assert "no longer a HID device" in str(stop_device(record, sysfs=node.sysfs))
    assert node.written() == b""


def test_a_device_that_is_gone(record: Path, node: Node, tmp_path: Path) -> None:
    record.write_text(record.read_text().replace(node.path, str(tmp_path / "none")))
    assert "no longer connected" in str(stop_device(record, sysfs=node.sysfs))
    assert not record.exists()


def test_a_device_that_a_daemon_drives_is_left_to_it(record: Path, node: Node) -> None:
    with open(node.path, "rb", buffering=0) as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(HapticdError, match="a daemon drives it"):
            stop_device(record, sysfs=node.sysfs, deadline_s=0.05)
    assert node.written() == b""
    assert record.exists()
    assert "force zero" in str(stop_device(record, sysfs=node.sysfs))


def test_a_device_that_hangs_is_given_up(record: Path, node: Node) -> None:
    termios.tcflow(node.theirs, termios.TCOOFF)
    with pytest.raises(HapticdError, match="does not accept reports; it may still push"):
        stop_device(record, sysfs=node.sysfs, deadline_s=0.1)
    assert record.exists()


def test_without_another_thread_it_is_stopped_all_the_same(
    record: Path, node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    assert "force zero, effects stopped" in str(stop_device(record, sysfs=node.sysfs))
    expected = b"".join([*ZERO, *STOP])
    assert node.written(len(expected)) == expected


def refuses(*refused: bytes) -> dict[str, Any]:
    """Return a device that refuses these reports."""

    def write(fd: int, report: bytes) -> int:
        if report in refused:
            raise OSError(errno.EPIPE, "Broken pipe")
        return len(report)

    return {"open_node": lambda record: os.open(os.devnull, os.O_RDWR), "write": write}


@pytest.mark.parametrize(
    ("stop", "refused", "wanted"),
    [
        (STOP, ZERO, "effects stopped; 1 of 3 reports were refused: report 05 01 00 00: Broken pipe"),
        (STOP, STOP[:1], "effects stopped; 1 of 3 reports were refused"),
        (STOP, STOP, "effects stopped; 2 of 3 reports were refused"),
        ([], [], "force zero, effects stopped, 1 reports"),
    ],
)
def test_refused_reports_are_listed(tmp_path: Path, stop: list[bytes], refused: list[bytes], wanted: str) -> None:
    path = tmp_path / "record"
    StopFile(path, lambda fd: FAKE).keep("/dev/x", 0, ZERO, stop, 0.0)
    assert wanted in str(stop_device(path, **refuses(*refused)))
    assert not path.exists()


def test_a_device_that_takes_neither_zero_nor_stop_may_still_push(tmp_path: Path) -> None:
    path = tmp_path / "record"
    StopFile(path, lambda fd: FAKE).keep("/dev/x", 0, ZERO, STOP, 0.0)
    with pytest.raises(HapticdError, match=r"refuses 2 of 3 reports, .*it may still push"):
        stop_device(path, **refuses(*ZERO, STOP[1]))
    assert path.exists()


def test_a_device_that_goes_away_meanwhile_does_not_push(tmp_path: Path) -> None:
    path = tmp_path / "record"
    StopFile(path, lambda fd: FAKE).keep("/dev/x", 0, ZERO, STOP, 0.0)

    def gone(fd: int, report: bytes) -> int:
        raise OSError(errno.ENODEV, "No such device")

    assert "was unplugged while it was stopped" in str(stop_device(path, **{**refuses(), "write": gone}))
    assert not path.exists()


def test_a_device_that_cannot_be_opened_may_still_push(tmp_path: Path) -> None:
    path = tmp_path / "record"
    StopFile(path, lambda fd: FAKE).keep("/dev/x", 0, ZERO, STOP, 0.0)

    def refused(record: Record) -> int:
        raise OSError(errno.EACCES, "Permission denied")

    with pytest.raises(HapticdError, match="cannot open it: Permission denied; it may still push"):
        stop_device(path, open_node=refused)
    assert path.exists()


# ---- What is trusted -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_record_that_others_may_write(record: Path, node: Node, mode: int) -> None:
    record.chmod(mode)
    with pytest.raises(HapticdError, match="other users may change it"):
        stop_device(record, sysfs=node.sysfs)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_a_record_of_somebody_else(record: Path, node: Node) -> None:
    os.chown(record, 65534, -1)
    with pytest.raises(HapticdError, match="belongs to user 65534; it must belong to root or to user "):
        stop_device(record, sysfs=node.sysfs)
    assert node.written() == b""


def test_a_record_that_is_not_a_regular_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(HapticdError, match=r"not a regular file|cannot be read: Is a directory"):
            load(tmp_path / name)


def changed(record: Any, key: str, value: object) -> Any:
    return {**record, key: value}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("version", 2),
        ("path", 7),
        ("path", "dev/hidraw0"),
        ("identity", None),
        ("identity", {"major": 1, "minor": 2}),
        ("identity", {"major": "x", "minor": 2, "device": {}}),
        ("identity", {"major": math.inf, "minor": 2, "device": {}}),
        ("zero", "05"),
        ("zero", [5]),
        ("zero", ["5"]),
        ("zero", ["zz"]),
        ("stop", [""]),
        ("pause_s", -1),
        ("pause_s", "nan"),
        ("pause_s", 11),
    ],
)
def test_a_file_that_is_not_a_record(record: Path, key: str, value: object) -> None:
    record.write_text(json.dumps(changed(json.loads(record.read_text()), key, value)))
    with pytest.raises(HapticdError, match="not a record of a device"):
        load(record)


@pytest.mark.long
@given(
    st.binary(max_size=200)
    | st.recursive(
        st.none() | st.integers() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["version", "path", "identity", "zero", "stop", "pause_s", "device"]), inner, max_size=6
            )
        ),
    ).map(lambda value: json.dumps(value).encode())
)
def test_anything_else_is_one_line(tmp_path_factory: pytest.TempPathFactory, text: bytes) -> None:
    path = tmp_path_factory.mktemp("record") / "record"
    path.touch(0o600)
    path.write_bytes(text)
    with pytest.raises(HapticdError) as caught:
        load(path)
    assert "\n" not in str(caught.value)


def test_a_written_record_is_read_back(record: Path, node: Node) -> None:
    found = load(record)
    assert found == Record(node.path, node.identify(node.theirs), tuple(ZERO), tuple(STOP), 0.0)  # type: ignore[arg-type]


# ---- What the daemon writes ------------------------------------------------------------------------------------------


def test_no_record_is_written_for_a_node_that_is_not_a_hid_device(tmp_path: Path) -> None:
    with open(tmp_path / "file", "wb") as file:
        StopFile(tmp_path / "record").keep("/dev/x", file.fileno(), ZERO, STOP, 0.0)
    with open("/dev/null", "rb") as null:
        StopFile(tmp_path / "record").keep("/dev/null", null.fileno(), ZERO, STOP, 0.0)
    assert os.listdir(tmp_path) == ["file"]


def test_a_record_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(HapticdError, match="record: cannot be written: No such file"):
        StopFile(tmp_path / "none" / "record", lambda fd: FAKE).keep("/dev/x", 0, ZERO, STOP, 0.0)


class Driven:
    """An engine that drives a simulated joystick."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.stick = FakePid(bytes(Joystick()))
        self.record = directory / "hapticd.device"
        hid = Hid()
        self.stick.device.path = "/dev/fake0"
        driver = PidDriver(self.stick.layout, hid)
        opened = Opened(self.stick.device, driver, "stick", 0.001, True, False)
        monkeypatch.setattr("hapticd.daemon.engine.source_of", lambda _: lambda: opened)
        config = load_config({"device": {"kind": "hid"}, "servo": {"realtime": "off", "rate_hz": 1000}})
        self.engine = Engine(config, StopFile(self.record, lambda fd: FAKE))
        self.engine.start()


def test_the_record_of_a_joystick_stops_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The record of a running daemon suffices: afterwards the state machine of the device is at rest."""
    driven = Driven(tmp_path, monkeypatch)
    stick = driven.stick
    stick.wait(lambda: stick.enabled and len(stick.effects) == 2)
    kept = tmp_path / "copy"
    kept.write_bytes(driven.record.read_bytes())
    kept.chmod(0o600)
    driven.engine.stop()
    assert not driven.record.exists()

    # The same joystick, left with a force.
    again = FakePid(bytes(Joystick()))
    PidDriver(again.layout, Hid()).set_up(again.device)
    for effect in again.effects.values():
        effect.magnitude = 5000
    assert again.force() != (0.0, 0.0)
    assert "force zero" in str(stop_device(kept, open_node=lambda record: os.dup(again.ours.fileno())))
    again.wait(lambda: not again.enabled)
    assert again.force() == (0.0, 0.0)
    assert not again.effects
    assert not any("unknown" in line for line in again.log)
    again.close()
    stick.close()


def test_the_record_stays_when_the_joystick_was_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driven = Driven(tmp_path, monkeypatch)
    driven.stick.unplug()
    driven.engine.stop()
    assert driven.record.exists()
    driven.stick.close()


def test_a_daemon_first_stops_the_device_of_the_previous_daemon(
    tmp_path: Path, record: Path, node: Node, caplog: pytest.LogCaptureFixture
) -> None:
    """The record of an absent device, of another device, and no record."""
    (node.entry / "device" / "uevent").unlink()
    with caplog.at_level(logging.INFO):
        _stop_device_of_killed_daemon(record)
        assert "previous daemon: " in caplog.text and "nothing was sent" in caplog.text
        assert not record.exists()
        record.write_text("{}")
        record.chmod(0o622)
        _stop_device_of_killed_daemon(record)
        assert "other users may change it" in caplog.text
        caplog.clear()
        _stop_device_of_killed_daemon(tmp_path / "none")
    assert not caplog.records


# ---- The command -----------------------------------------------------------------------------------------------------


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--runtime-dir", str(tmp_path), "stop-device"]) == 0
    assert capsys.readouterr().out == "nothing to stop: no daemon has left a device\n"
    (tmp_path / "hapticd.device").write_text("{}")
    assert main(["--runtime-dir", str(tmp_path), "stop-device", "--json"]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    error = json.loads(captured.err)["error"]
    assert "not a record of a device" in error["message"] and error["exit_code"] == 1
    missing = Record("/dev/hidraw99", Identity(1, 2, {}), tuple(ZERO), (), 0.0)
    StopFile(tmp_path / "hapticd.device", lambda fd: missing.identity).keep(missing.path, 0, ZERO, STOP, 0.0)
    assert main(["--runtime-dir", str(tmp_path), "stop-device", "--json"]) == 0
    assert "no longer connected" in json.loads(capsys.readouterr().out)["stopped"]
