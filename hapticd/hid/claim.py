"""`hapticd devices claim` and `release`: keep other programs off one device while it is plugged in.

The kernel has no driver that provides hidraw without force feedback: hid-generic starts hid-pidff for every device of
the PID class, and so do the drivers of vendors. Other programs use the device's event and joystick nodes. A device is
claimed in three steps:

1. A udev rule below /run, for this device only, gives these nodes to root; it lasts until a reboot.
2. The device is unbound from its driver. A program that has one of the nodes open loses this node.
3. The device is bound to hid-generic, or, if a vendor's driver claims it, to that driver. The driver creates the nodes
   again, and the rule lets only root open them from the start.

`release` removes the rule, and binds the device again to the driver that the kernel chooses.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular
from hapticd.hid.discovery import SysfsDevice, event_nodes, is_open_to_others

CLAIM_RULES_PATH: Final = Path("run/udev/rules.d/71-hapticd-claimed.rules")
"""Sorts after 70-uaccess, which tags joysticks for the user at the seat, and before 73-seat-late, which uses tags."""
GENERIC_DRIVER: Final = "hid-generic"
REBIND_TIMEOUT_S: Final = 5.0
"""After a device was bound to a driver, its hidraw node must exist within this time."""
_UDEVADM_TIMEOUT_S: Final = 5.0
_ACL_ATTRIBUTE: Final = "system.posix_acl_access"
"""Extended attribute with the access list by which udev lets the user at the seat open a device node."""
_HIDDEN_BY_RULE: Final = ": a line in 70-hapticd.rules already lets only root open its event nodes"

Write = Callable[[Path, str], None]


def _write(path: Path, text: str) -> None:
    path.write_text(text)


def _run(command: Sequence[str]) -> None:
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        subprocess.run(command, timeout=_UDEVADM_TIMEOUT_S, capture_output=True, check=False)


class Claims:
    """The claimed devices of a machine, kept from other programs by the udev rules in CLAIM_RULES_PATH."""

    def __init__(
        self, root: Path = Path("/"), write: Write = _write, run: Callable[[Sequence[str]], None] = _run
    ) -> None:
        """Use the system files below `root`. `write` writes a file of sysfs, `run` executes a udevadm command."""
        self._root, self._write, self._run = root, write, run
        self._rules = root / CLAIM_RULES_PATH

    def names(self) -> list[str]:
        """Return the names in /sys/bus/hid/devices of the claimed devices that are plugged in."""
        try:
            text = self._rules.read_text(encoding="utf-8") if self._rules.is_file() else ""
        except OSError:
            return []
        named = dict.fromkeys(re.findall(r'KERNELS=="([0-9A-F:.]+)"', text))
        return [name for name in named if self._folder(name).exists()]

    def claim(self, device: SysfsDevice) -> str:
        """Keep other programs off a device, and return the name of its new kernel driver. Raises HapticdError."""
        name, claimed = self._name(device), self.names()
        if name in claimed:
            raise HapticdError(f"{device} is already claimed; `hapticd devices release {device.path}` releases it")
        if self._is_root_only(name):
            raise HapticdError(f"{device}{_HIDDEN_BY_RULE}")
        driver = self._rebind(device, claimed, [*claimed, name], GENERIC_DRIVER)
        for node in self.nodes(name):
            _hide(node)
        return driver

    def release(self, device: SysfsDevice) -> str:
        """Let other programs use a device again, and return the name of its new kernel driver. Raises HapticdError."""
        name, claimed = self._name(device), self.names()
        if name not in claimed:
            raise HapticdError(f"{device} is not claimed{_HIDDEN_BY_RULE if self._is_root_only(name) else ''}")
        return self._rebind(device, claimed, [other for other in claimed if other != name], None)

    def nodes(self, hid_name: str) -> list[Path]:
        """Return the paths of a device's event and joystick nodes; `hid_name` is its name in /sys/bus/hid/devices."""
        return [self._root / "dev" / "input" / node for node in event_nodes(self._folder(hid_name))]

    def path(self, hid_name: str) -> str | None:
        """Return the path of a device's hidraw node; None while the node does not exist."""
        entry = next(iter(sorted(self._folder(hid_name).glob("hidraw/hidraw*"))), None)
        return None if entry is None else str(self._root / "dev" / entry.name)

    # ---- The steps ---------------------------------------------------------------------------------------------------

    def _folder(self, name: str) -> Path:
        return self._root / "sys/bus/hid/devices" / name

    def _name(self, device: SysfsDevice) -> str:
        if not device.hid_name:
            raise HapticdError(f"{device}: sysfs has no HID device for this node")
        return device.hid_name

    def _driver(self, name: str) -> str:
        driver = self._folder(name) / "driver"
        return driver.resolve().name if driver.exists() else ""

    def _write_rules(self, names: Sequence[str]) -> None:
        """Write the udev rules that hide the nodes of these devices, and have udev read the rules."""
        if names:
            self._rules.parent.mkdir(parents=True, exist_ok=True)
            check_regular(self._rules)
            self._rules.write_text("".join(map(_rule, names)), encoding="utf-8")
        else:
            self._rules.unlink(missing_ok=True)
        if (self._root / "run/udev/control").exists():
            self._run(["udevadm", "control", "--reload"])

    def _is_root_only(self, name: str) -> bool:
        """Return whether only root may open the event and joystick nodes of a device."""
        nodes = self.nodes(name)
        return bool(nodes) and not any(map(is_open_to_others, nodes))

    def _rebind(self, device: SysfsDevice, before: Sequence[str], after: Sequence[str], driver: str | None) -> str:
        """Write the rules for the devices `after`, bind a device to another driver, and return the driver's name.

        If that fails, the rules for the devices `before` are restored. If `driver` is None, the kernel chooses one.
        """
        name = device.hid_name
        try:
            self._write_rules(after)
            try:
                if self._driver(name):
                    self._write(self._root / "sys/bus/hid/drivers" / self._driver(name) / "unbind", name)
                self._bind(name, driver)
            except BaseException:
                self._write_rules(before)
                raise
        except PermissionError:
            raise HapticdError(f"{device}: no permission to unbind it from its driver: use sudo") from None
        return self._driver(name)

    def _bind(self, name: str, driver: str | None) -> None:
        """Bind a device to `driver`, or, if that fails, to the driver that the kernel chooses."""
        if driver is not None:
            with contextlib.suppress(OSError):
                self._write(self._root / "sys/bus/hid/drivers" / driver / "bind", name)
        if not self._driver(name):
            with contextlib.suppress(OSError):
                self._write(self._root / "sys/bus/hid/drivers_probe", name)
        deadline = time.monotonic() + REBIND_TIMEOUT_S
        while self.path(name) is None or not os.path.exists(str(self.path(name))):
            if time.monotonic() > deadline:
                raise HapticdError(f"{name}: no driver accepted it: unplug it and plug it in again")
            time.sleep(0.01)


def _rule(name: str) -> str:
    """Return two udev rules, which give the event and joystick nodes of one device to root."""
    return (
        f'SUBSYSTEM=="input", KERNELS=="{name}", ENV{{ID_INPUT_JOYSTICK}}="", TAG-="uaccess"\n'
        f'SUBSYSTEM=="input", KERNEL=="event*|js*", KERNELS=="{name}", GROUP:="root", MODE:="0600"\n'
    )


def _hide(node: Path) -> None:
    """Let only root open a device node, in case udev does not run or created the node before it read the rule."""
    with contextlib.suppress(FileNotFoundError):
        with contextlib.suppress(OSError):
            os.removexattr(node, _ACL_ATTRIBUTE)
        os.chmod(node, 0o600)
