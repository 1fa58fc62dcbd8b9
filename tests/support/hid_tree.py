"""A tree of files as the kernel has HID devices below /sys and /dev, with a kernel that binds and unbinds them."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from hapticd.hid.claim import Claims
from hapticd.hid.discovery import SysfsDevice, find
from tests.support.hid_descriptors import Joystick


class Kernel:
    """What stands below /sys and /dev, and what happens when a driver's files are written."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.vendors: dict[str, str] = {}
        """Drivers that insist on a device."""
        self.stubborn: set[str] = set()
        """Devices that no driver takes again."""
        self.log: list[str] = []
        self.commands: list[str] = []
        self.numbers = iter(range(5, 99))
        for folder in ("sys/bus/hid/devices", "sys/class/hidraw", "dev/input", "run/udev"):
            (root / folder).mkdir(parents=True)
        (root / "run/udev/control").touch()
        for driver in ("hid-generic", "hid-vendor"):
            (root / "sys/bus/hid/drivers" / driver).mkdir(parents=True)

    def plug(self, name: str, like: Joystick | None = None) -> None:
        device = self.root / "sys/devices/usb1" / name
        device.mkdir(parents=True)
        (device / "report_descriptor").write_bytes(bytes(like or Joystick()))
        bus, vendor, product = name.split(".")[0].split(":")
        (device / "uevent").write_text(f"HID_ID={bus}:0000{vendor}:0000{product}\nHID_NAME=Stick\n")
        (self.root / "sys/bus/hid/devices" / name).symlink_to(device)
        self._bind(name, self.vendors.get(name, "hid-generic"))

    def write(self, path: Path, text: str) -> None:
        where = str(path.relative_to(self.root / "sys/bus/hid"))
        self.log.append(f"{where} {text}")
        device = self.root / "sys/bus/hid/devices" / text
        if where == "drivers_probe":
            if text not in self.stubborn:
                self._bind(text, self.vendors.get(text, "hid-generic"))
            return
        driver, verb = path.parent.name, path.name
        if verb == "unbind":
            assert (device / "driver").resolve().name == driver
            for node in [*(self.root / "dev").glob("hidraw*"), *(self.root / "dev/input").iterdir()]:
                if any(device.glob(f"hidraw/{node.name}")) or any(device.glob(f"input/*/{node.name}")):
                    node.unlink()
            for entry in device.glob("hidraw/*"):
                (self.root / "sys/class/hidraw" / entry.name).unlink()
            for part in ("hidraw", "input"):
                shutil.rmtree(device / part)
            (device / "driver").unlink()
        elif driver != self.vendors.get(text, driver) or text in self.stubborn:
            raise OSError(errno.ENODEV, "No such device")
        else:
            self._bind(text, driver)

    def _bind(self, name: str, driver: str) -> None:
        device, number = self.root / "sys/devices/usb1" / name, next(self.numbers)
        (device / "driver").symlink_to(self.root / "sys/bus/hid/drivers" / driver)
        (device / f"hidraw/hidraw{number}").mkdir(parents=True)
        (self.root / f"sys/class/hidraw/hidraw{number}").mkdir()
        (self.root / f"sys/class/hidraw/hidraw{number}/device").symlink_to(device)
        shutil.rmtree(self.root / f"sys/class/hidraw/hidraw{number}")
        (self.root / f"sys/class/hidraw/hidraw{number}").symlink_to(device / f"hidraw/hidraw{number}")
        (device / f"hidraw/hidraw{number}/device").symlink_to(device)
        (self.root / f"dev/hidraw{number}").touch()
        for node in (f"event{number}", f"js{number}"):
            (device / f"input/input{number}/{node}").mkdir(parents=True)
            (self.root / "dev/input" / node).touch()
            (self.root / "dev/input" / node).chmod(0o660)

    def run(self, command: Sequence[str]) -> None:
        self.commands.append(" ".join(command))

    @property
    def claims(self) -> Claims:
        return Claims(self.root, self.write, self.run)

    def all(self) -> list[SysfsDevice]:
        """The devices, by number."""
        return find(self.root / "sys/class/hidraw", self.root / "dev")

    def found(self, name: str) -> SysfsDevice:
        (one,) = (one for one in self.all() if one.hid_name == name)
        return one

    def modes(self, name: str) -> set[int]:
        return {os.stat(node).st_mode & 0o777 for node in self.claims.nodes(name)}
