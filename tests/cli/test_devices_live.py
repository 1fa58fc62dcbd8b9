"""`devices`, `devices dump` and `devices calibrate` with simulated devices."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.config.hid import ForceAxes, ForceAxis, Hid
from hapticd.hid import discovery, range_calibration, sign_calibration, sources
from hapticd.hid.connection import Opened
from hapticd.hid.discovery import SysfsDevice
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.plan import DeviceError
from hapticd.hid.range_calibration import MeasuredRange
from hapticd.hid.verdict import Verdict, verdict_of
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid

STICK = bytes(Joystick())


def found(path: str = "/dev/hidraw0", descriptor: bytes = STICK) -> SysfsDevice:
    return SysfsDevice(
        path=path,
        name="Lab stick",
        vendor=0x1209,
        product=0x5AFF,
        serial="",
        bus="USB",
        driver="hid-generic",
        descriptor=descriptor,
        in_interval_s=0.001,
        out_interval_s=0.004,
        permission="ok",
    )


def here(monkeypatch: pytest.MonkeyPatch, *devices: SysfsDevice) -> None:
    monkeypatch.setattr(discovery, "find", lambda: list(devices))


def test_list(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pad = found("/dev/hidraw1", bytes(Joystick(without=frozenset({0x73}))))
    here(monkeypatch, found(), pad, replace(found("/dev/hidraw2"), permission="denied"))
    assert main(["devices"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["/dev/hidraw0 (Lab stick, 1209:5aff), USB", "    can be driven, a report every 4 ms"]
    assert lines[3] == "    cannot be driven without a description: its report descriptor has no Set Constant Force"
    assert lines[5].startswith("    can be driven, a report every 4 ms; but no permission: install ")
    assert main(["devices", "--json"]) == 0
    assert [item["usable"] for item in json.loads(capsys.readouterr().out)] == [True, False, True]


@pytest.mark.parametrize(("keys", "times"), [({}, 1), ({"travel_m": 0.04}, 2)], ids=["defaults", "configured"])
def test_a_descriptor_is_read_once_for_each_configuration(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, keys: dict[str, object], times: int
) -> None:
    configurations = []

    def noted(hid: Hid, descriptor: bytes) -> Verdict:
        configurations.append(hid)
        return verdict_of(hid, descriptor)

    monkeypatch.setattr(discovery, "verdict_of", noted)
    here(monkeypatch, found())
    config = tmp_path / "config.yaml"
    config.write_text(json.dumps({"device": {"kind": "hid", "hid": keys}}))
    assert main(["devices", "-c", str(config)]) == 0
    assert len(configurations) == times


def test_none(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    here(monkeypatch)
    assert main(["devices"]) == 0
    assert capsys.readouterr() == ("", "hapticd: no HID device is connected, or the kernel lacks hidraw\n")
    assert main(["devices", "dump", "/dev/hidraw0", "-o", "x"]) == 1
    assert capsys.readouterr().err == 'hapticd: no HID device "/dev/hidraw0"; connected: none\n'


def test_dump(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    node = tmp_path / "hidraw0"
    # A file ends after one read, as a device does that is unplugged.
    node.write_bytes(b"\x01\x00\x00\x05\x00\x00")
    here(monkeypatch, found(str(node)))
    out = tmp_path / "stick.jsonl"
    assert main(["devices", "dump", "1209:5aff", "-o", str(out), "--for", "1min"]) == 0
    head, report = out.read_text().splitlines()
    assert json.loads(head) == {
        "recording": 1,
        "name": "Lab stick",
        "vendor": 0x1209,
        "product": 0x5AFF,
        "descriptor": STICK.hex(),
    }
    assert json.loads(report)[1] == "010000050000"
    assert capsys.readouterr().out.startswith("1 report of ")
    dumped = out.read_text()
    assert main(["devices", "dump", "1209:5aff", "-o", str(out)]) == 1
    assert "stick.jsonl: already exists; give another name, or --overwrite" in capsys.readouterr().err
    assert out.read_text() == dumped
    assert main(["devices", "dump", "1209:5aff", "-o", str(out), "--overwrite"]) == 0
    capsys.readouterr()
    here(monkeypatch, found(), found("/dev/hidraw1"))
    assert main(["devices", "dump", "1209:5aff", "-o", str(out), "--overwrite"]) == 1
    assert "2 devices are 1209:5aff; name one by its path: /dev/hidraw0" in capsys.readouterr().err


def calibrated(monkeypatch: pytest.MonkeyPatch, found: MeasuredRange | Exception) -> tuple[FakePid, ForceAxes]:
    """Make `devices calibrate` open a device, and find these directions and this range."""
    stick, axes = FakePid(STICK), ForceAxes(x=ForceAxis(sign=-1), swap=True)
    keys: dict[str, int | str] = {"vendor": 0x1209, "product": 0x5AFF, "serial": "A1", "device_version": 0x0107}

    def opened(hid: Hid) -> Opened:
        assert hid.axes.x.counts is None and hid.axes.y.counts is None and hid.force_axes == ForceAxes()
        return Opened(stick.device, PidDriver(stick.layout, hid), "Lab stick", keys=keys)

    def measured(*_: object) -> MeasuredRange:
        if isinstance(found, MeasuredRange):
            return found
        raise found

    monkeypatch.setattr(sources, "open_hid", opened)
    monkeypatch.setattr(sign_calibration, "calibrate", lambda *_: sign_calibration.Calibration(axes, {}))
    monkeypatch.setattr(range_calibration, "measure_range", measured)
    return stick, axes


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [(KeyboardInterrupt(), 130, ""), (DeviceError("the device is gone"), 1, "hapticd: the device is gone\n")],
    ids=["ctrl-c", "unplugged"],
)
def test_a_range_that_was_not_measured_loses_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    error: Exception,
    code: int,
    said: str,
) -> None:
    stick, axes = calibrated(monkeypatch, error)
    config, out = tmp_path / "stick.yaml", tmp_path / "calibrated.yaml"
    config.write_text("device: {kind: hid, hid: {axes: {x: {counts: [1, 2, 3]}}}}\n")
    assert main(["devices", "calibrate", "-c", str(config), "-o", str(out), "--yes"]) == code
    seen = capsys.readouterr()
    assert seen.out == out.read_text() and seen.err.endswith(said)
    hid = load_config(out).device.hid
    assert hid.force_axes == axes and hid.axes.x.counts == (1, 2, 3) and hid.signs == "trust"
    assert stick.device.closed
    stick.close()


def test_calibrate(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    stick, axes = calibrated(monkeypatch, MeasuredRange((-30000, 5, 31000), None, ("axis y was hardly moved",)))
    config = tmp_path / "stick.yaml"
    known = "axes: {x: {counts: [1, 2, 3]}, y: {counts: [-4, 5, 6]}}, device_version: 1, product: 0x5aff"
    config.write_text(f"device: {{kind: hid, hid: {{vendor: 0x1209, travel_m: 0.04, {known}}}}}\n")
    out = tmp_path / "calibrated.yaml"
    assert main(["devices", "calibrate", "-c", str(config), "-o", str(out), "--yes"]) == 0
    seen = capsys.readouterr()
    assert seen.out == out.read_text() and "hapticd: axis y was hardly moved\n" in seen.err
    read = load_config(out).device
    assert read.kind == "hid"
    # The device's own version takes the place of the old one; the counts that were not measured are kept.
    assert read.hid == Hid(
        vendor=0x1209,
        product=0x5AFF,
        serial="A1",
        device_version=0x0107,
        travel_m=0.04,
        force_axes=axes,
        axes={"x": {"counts": [-30000, 5, 31000]}, "y": {"counts": [-4, 5, 6]}},
    )
    assert stick.device.closed
    assert [item.name for item in tmp_path.iterdir() if item not in (config, out)] == []
    # Existing files are kept, and no handle moves if the file cannot be written.
    before = config.read_text()
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr(sources, "open_hid", lambda hid: pytest.fail("the handle moves"))
    for place, message in (
        (tmp_path / "none" / "a.yaml", "cannot be written: the folder"),
        (tmp_path / "folder", "not a regular file but a directory"),
        (out, "already exists; give another name, or --overwrite"),
    ):
        assert main(["devices", "calibrate", "-c", str(config), "-o", str(place), "--yes"]) == 1
        seen = capsys.readouterr()
        assert seen.out == "" and seen.err.startswith(f"hapticd: {place}: {message}")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["calibrated.yaml", "folder", "stick.yaml"]
    assert main(["devices", "calibrate", "-c", str(config), "-o", f"{tmp_path}/./stick.yaml", "--yes"]) == 2
    assert "is the configuration file; name another file" in capsys.readouterr().err
    assert config.read_text() == before
    assert main(["devices", "calibrate", "-c", str(config), "--force", "1"]) == 2
    assert "--force must be at most 0.89" in capsys.readouterr().err
    stick.close()
