"""Finding devices in a sysfs made of files, and choosing one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from hapticd.config.hid import Hid
from hapticd.hid.discovery import SysfsDevice, choose, find
from hapticd.hid.plan import DeviceError
from tests.support.hid_descriptors import (
    APPLICATION,
    INPUT,
    OUTPUT,
    Joystick,
    collection,
    data,
    logical,
    physical,
    size,
    usage,
    usage_page,
)

STICK = bytes(Joystick())
MOUSE = collection(usage_page(1) + usage(2), APPLICATION, usage(0x30), logical(-127, 127), size(8), data(INPUT))


class Machine:
    """A tree like the kernel's: class/hidraw links to the HID device, which lies in its USB interface."""

    def __init__(self, root: Path) -> None:
        self.sysfs, self.dev, self._root = root / "class", root / "dev", root
        self.sysfs.mkdir()
        self.dev.mkdir()

    def add(
        self,
        number: int,
        descriptor: bytes = STICK,
        ids: tuple[int, int] = (0x1209, 0x5AFF),
        name: str = "Lab stick",
        serial: str = "",
        bus: int = 3,
        endpoints: tuple[tuple[str, str], ...] = (("in", "1ms"), ("out", "4ms")),
    ) -> None:
        interface = self._root / "devices" / f"1-1:{number}.0"
        device = interface / f"0003:{number}"
        device.mkdir(parents=True)
        for place, (direction, interval) in enumerate(endpoints):
            endpoint = interface / f"ep_{place:02x}"
            endpoint.mkdir()
            for key, text in (("direction", direction), ("interval", interval), ("type", "Interrupt")):
                (endpoint / key).write_text(text + "\n")
        (device / "report_descriptor").write_bytes(descriptor)
        (device / "uevent").write_text(
            f"DRIVER=hid-generic\nHID_ID={bus:04X}:{ids[0]:08X}:{ids[1]:08X}\nHID_NAME={name}\nHID_UNIQ={serial}\n"
        )
        entry = self.sysfs / f"hidraw{number}"
        entry.mkdir()
        (entry / "device").symlink_to(device)
        (self.dev / f"hidraw{number}").touch()

    def find(self) -> list[SysfsDevice]:
        return find(self.sysfs, self.dev)

    def choose(self, **keys: Any) -> SysfsDevice:
        return choose(Hid.model_validate(keys), self.find())

    def refusal(self, **keys: Any) -> str:
        with pytest.raises(DeviceError) as caught:
            self.choose(**keys)
        assert "\n" not in str(caught.value)
        return str(caught.value).replace(str(self.dev), "/dev")


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_members_from_sysfs(machine: Machine) -> None:
    machine.add(10, serial="A1")
    machine.add(2, MOUSE, (0x46D, 0xC077), "A mouse", bus=5, endpoints=())
    mouse, stick = machine.find()
    assert (stick.name, stick.vendor, stick.product, stick.serial) == ("Lab stick", 0x1209, 0x5AFF, "A1")
    assert (stick.bus, stick.driver, stick.in_interval_s, stick.out_interval_s) == ("USB", "hid-generic", 1e-3, 4e-3)
    assert stick.usable and stick.to_dict()["missing"] == [] and stick.permission == "ok"
    assert (mouse.bus, mouse.out_interval_s, mouse.usable) == ("Bluetooth", None, False)
    assert "Set Constant Force" in str(mouse.to_dict()["missing"])
    assert stick.to_dict()["usable"] is True


def test_resets_are_seen_as_far_as_reports_can_name_our_effects(machine: Machine) -> None:
    """A reset is not noticed if PID State cannot hold the indices of hapticd's effects."""
    index = logical(1, 40) + physical(1, 40) + size(7) + data(INPUT)
    assert STICK.count(index) == 1
    machine.add(0)
    machine.add(1, STICK.replace(index, logical(41, 60) + physical(41, 60) + size(7) + data(INPUT)))
    machine.add(2, MOUSE)
    assert [found.resets_seen for found in machine.find()] == [True, False, None]


@pytest.mark.parametrize(
    ("bus", "bcd_device", "of_input", "version"),
    [
        (3, "0107", "0111", 0x0107),  # the input node has the version of the HID specification
        (3, None, None, None),
        (3, "wrong", None, None),
        (5, None, "011b", 0x011B),
        (5, None, None, None),
    ],
)
def test_versions(
    machine: Machine, bus: int, bcd_device: str | None, of_input: str | None, version: int | None
) -> None:
    machine.add(0, serial="A1", bus=bus)
    device = (machine.sysfs / "hidraw0" / "device").resolve()
    if bcd_device is not None:
        (device.parent.parent / "bcdDevice").write_text(f"{bcd_device}\n")
    if of_input is not None:
        (device / "input/input7/id").mkdir(parents=True)
        (device / "input/input7/id/version").write_text(f"{of_input}\n")
    (found,) = machine.find()
    assert found.version == found.to_dict()["version"] == version
    keys = {"vendor": 0x1209, "product": 0x5AFF, "serial": "A1"}
    assert found.keys == (keys if version is None else {**keys, "device_version": version})
    assert Hid.model_validate(found.keys).device_version == version
    machine.choose(**found.keys | {"device_version": 1})  # selects no device: another version is driven, and checked


def test_another_version_is_another_device(machine: Machine) -> None:
    machine.add(0)
    version = machine.dev.parent / "devices" / "bcdDevice"
    version.write_text("0107\n")
    before = machine.find()[0]
    version.write_text("0108\n")
    assert machine.find()[0].identity != before.identity
    version.write_text("0107\n")
    assert machine.find()[0].identity == before.identity


def test_microsecond_intervals(machine: Machine) -> None:
    machine.add(0, endpoints=(("out", "125us"),))
    assert machine.find()[0].out_interval_s == pytest.approx(125e-6)


def test_no_sysfs(tmp_path: Path) -> None:
    assert find(tmp_path / "nothing", tmp_path) == []


def test_a_device_that_goes_away_is_left_out(machine: Machine) -> None:
    machine.add(0)
    (machine.sysfs / "hidraw1").mkdir()
    assert len(machine.find()) == 1


def test_a_descriptor_that_is_not_valid(machine: Machine) -> None:
    machine.add(0, STICK[:100])
    found = machine.find()[0]
    assert not found.usable and found.verdict.problem is not None
    assert "its report descriptor is not valid: report descriptor, byte" in machine.refusal()


def test_the_device_that_the_configuration_selects_is_chosen_of_several(machine: Machine) -> None:
    machine.add(0, bytes(Joystick(axes=(0x33, 0x34))))
    machine.add(1)
    assert machine.choose().path.endswith("hidraw1")
    rotating = {"x": {"usage": "Rx"}, "y": {"usage": "Ry"}}
    assert machine.choose(axes=rotating).path.endswith("hidraw0")
    neither = machine.refusal(axes={"x": {"usage": "Z"}})
    why = "cannot be driven: device.hid.axes.x.usage: the device has no axis Z; it has"
    assert neither.startswith(f"/dev/hidraw0 (Lab stick, 1209:5aff) {why} Rx, Ry; ")
    assert neither.endswith(f"/dev/hidraw1 (Lab stick, 1209:5aff) {why} X, Y")


def test_the_only_one_is_chosen(machine: Machine) -> None:
    machine.add(0, MOUSE, (1, 2))
    machine.add(1)
    assert machine.choose().path.endswith("hidraw1")


def test_none(machine: Machine) -> None:
    assert machine.refusal() == "no HID device is connected; `hapticd devices` lists the HID devices"
    machine.add(0)
    assert machine.refusal(vendor=0x45E, serial="x") == (
        'no HID device with vendor 0x045e, serial "x" is connected; there are /dev/hidraw0 (Lab stick, 1209:5aff); '
        "`hapticd devices` lists the HID devices"
    )


def test_one_that_cannot_be_driven(machine: Machine) -> None:
    machine.add(0, bytes(Joystick(without=frozenset({0x73}))), (0x45E, 0xB13), "Pad")
    message = machine.refusal(product=0xB13)
    assert message == (
        "/dev/hidraw0 (Pad, 045e:0b13) cannot be driven: its report descriptor has no Set Constant Force; "
        "a device outside the PID class needs device.hid.report"
    )
    machine.add(1, MOUSE, (1, 2), "Mouse")
    assert "none of /dev/hidraw0 (Pad, 045e:0b13), /dev/hidraw1 (Mouse, 0001:0002)" in machine.refusal()


def test_several(machine: Machine) -> None:
    machine.add(0, serial="A")
    machine.add(1, serial="B")
    assert machine.refusal() == (
        "several HID devices can be driven: /dev/hidraw0 (Lab stick, 1209:5aff), /dev/hidraw1 (Lab stick, 1209:5aff); "
        "choose one by device.hid.vendor, product, serial or path"
    )
    assert machine.choose(serial="B").path.endswith("hidraw1")
    assert machine.choose(path=str(machine.dev / "hidraw0")).serial == "A"


def test_a_described_device_needs_no_pid_class(machine: Machine) -> None:
    out = usage_page(0xFF00) + usage(1) + logical(0, 255) + size(8) + data(OUTPUT)
    machine.add(0, collection(usage_page(1) + usage(2), APPLICATION, usage(0x30) + size(8) + data(INPUT), out))
    axis = {"bit_offset": 0, "bit_size": 8}
    report = {"input": {"x": axis | {"counts_per_m": 100}}, "output": {"length": 1, "x": axis | {"counts_per_n": 10}}}
    assert machine.choose(report=report).name == "Lab stick"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may do everything")
def test_no_permission(machine: Machine) -> None:
    machine.add(0)
    (machine.dev / "hidraw0").chmod(0)
    assert "no permission: install systemd/70-hapticd.rules" in machine.refusal()


def test_a_missing_permission_is_reported(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    machine.add(0)
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert machine.find()[0].permission == "denied"
    assert machine.refusal().startswith("/dev/hidraw0 (Lab stick, 1209:5aff): no permission: install ")
