"""Keeping other programs off one device while it is plugged in, and letting them at it again.

The kernel has no driver that gives hidraw without force feedback: hid-generic starts hid-pidff for every device of the
PID class, and so do the drivers of vendors. What other programs use of it are the device's event and joystick nodes. So
a device is claimed in this order:

1. a udev rule below /run, for this device alone, takes these nodes from everybody but root (kept until a reboot);
2. the device is taken from its driver, by which every node that a program has open ends;
3. it is bound to hid-generic if that takes it (the driver of a vendor may insist), else to whichever driver does: the
   nodes are made again, and hidden from the start.

To release it, the rule goes and the device is bound again to the driver that the kernel chooses.
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
from hapticd.hid.discovery import Found, event_nodes, is_for_others

RULES: Final = Path("run/udev/rules.d/71-hapticd-claimed.rules")
"""It sorts behind 70-uaccess, which hands joysticks to whoever sits at the seat, and before 73-seat-late."""
GENERIC: Final = "hid-generic"
BOUND_S: Final = 5.0
"""A device that was bound has its hidraw node after so long."""
_COMMAND_S: Final = 5.0
_ACL: Final = "system.posix_acl_access"
_KEPT_BY_RULE: Final = ": its event nodes are root's alone already, as a line of 70-hapticd.rules makes them"

Write = Callable[[Path, str], None]


def _write(path: Path, text: str) -> None:
    path.write_text(text)


def _run(command: Sequence[str]) -> None:
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        subprocess.run(command, timeout=_COMMAND_S, capture_output=True, check=False)


class Claims:
    """The devices of a machine that are claimed."""

    def __init__(
        self, root: Path = Path("/"), write: Write = _write, run: Callable[[Sequence[str]], None] = _run
    ) -> None:
        """`root`: where sys, dev and run lie. `write`: into a file of sysfs. `run`: does a command of udev."""
        self._root, self._write, self._run = root, write, run
        self._rules = root / RULES

    def names(self) -> list[str]:
        """Those that are claimed and still there, as /sys/bus/hid/devices has them."""
        try:
            text = self._rules.read_text(encoding="utf-8") if self._rules.is_file() else ""
        except OSError:
            return []
        named = dict.fromkeys(re.findall(r'KERNELS=="([0-9A-F:.]+)"', text))
        return [name for name in named if self._device(name).exists()]

    def claim(self, found: Found) -> str:
        """Keeps others off it; the driver that it has now. Raises HapticdError, one line."""
        name, claimed = self._name(found), self.names()
        if name in claimed:
            raise HapticdError(f"{found} is claimed already; `hapticd devices release {found.path}` lets others at it")
        if self._is_ruled(name):
            raise HapticdError(f"{found}{_KEPT_BY_RULE}")
        driver = self._rebind(found, claimed, [*claimed, name], GENERIC)
        for node in self.nodes(name):
            _hide(node)
        return driver

    def release(self, found: Found) -> str:
        """Lets others at it again; the driver that it has now. Raises HapticdError, one line."""
        name, claimed = self._name(found), self.names()
        if name not in claimed:
            raise HapticdError(f"{found} is not claimed{_KEPT_BY_RULE if self._is_ruled(name) else ''}")
        return self._rebind(found, claimed, [other for other in claimed if other != name], None)

    def nodes(self, name: str) -> list[Path]:
        """The event and joystick nodes of a device."""
        return [self._root / "dev" / "input" / node for node in event_nodes(self._device(name))]

    def path(self, name: str) -> str | None:
        """Its hidraw node; None while there is none."""
        entry = next(iter(sorted(self._device(name).glob("hidraw/hidraw*"))), None)
        return None if entry is None else str(self._root / "dev" / entry.name)

    # ---- The steps ---------------------------------------------------------------------------------------------------

    def _device(self, name: str) -> Path:
        return self._root / "sys/bus/hid/devices" / name

    def _name(self, found: Found) -> str:
        if not found.hid_name:
            raise HapticdError(f"{found}: sysfs does not say which HID device it is")
        return found.hid_name

    def _driver(self, name: str) -> str:
        driver = self._device(name) / "driver"
        return driver.resolve().name if driver.exists() else ""

    def _tell_udev(self, names: Sequence[str]) -> None:
        """The rule is about these devices from now on."""
        if names:
            self._rules.parent.mkdir(parents=True, exist_ok=True)
            check_regular(self._rules)
            self._rules.write_text("".join(map(_rule, names)), encoding="utf-8")
        else:
            self._rules.unlink(missing_ok=True)
        if (self._root / "run/udev/control").exists():
            self._run(["udevadm", "control", "--reload"])

    def _is_ruled(self, name: str) -> bool:
        """Whether its nodes are root's alone although nobody has claimed it."""
        nodes = self.nodes(name)
        return bool(nodes) and not any(map(is_for_others, nodes))

    def _rebind(self, found: Found, before: Sequence[str], after: Sequence[str], driver: str | None) -> str:
        """Takes it from its driver and binds it to this one, with a rule about other devices than before; which driver
        it has now."""
        name = found.hid_name
        try:
            self._tell_udev(after)
            try:
                if self._driver(name):
                    self._write(self._root / "sys/bus/hid/drivers" / self._driver(name) / "unbind", name)
                self._bind(name, driver)
            except BaseException:
                self._tell_udev(before)
                raise
        except PermissionError:
            raise HapticdError(f"{found}: no permission to take it from its driver: use sudo") from None
        return self._driver(name)

    def _bind(self, name: str, driver: str | None) -> None:
        """To this driver if it takes it, else to whichever does."""
        if driver is not None:
            with contextlib.suppress(OSError):
                self._write(self._root / "sys/bus/hid/drivers" / driver / "bind", name)
        if not self._driver(name):
            with contextlib.suppress(OSError):
                self._write(self._root / "sys/bus/hid/drivers_probe", name)
        deadline = time.monotonic() + BOUND_S
        while self.path(name) is None or not os.path.exists(str(self.path(name))):
            if time.monotonic() > deadline:
                raise HapticdError(f"{name}: no driver took it again: unplug it and plug it in")
            time.sleep(0.01)


def _rule(name: str) -> str:
    """Lines of a udev rule for one device."""
    return (
        f'SUBSYSTEM=="input", KERNELS=="{name}", ENV{{ID_INPUT_JOYSTICK}}="", TAG-="uaccess"\n'
        f'SUBSYSTEM=="input", KERNEL=="event*|js*", KERNELS=="{name}", GROUP:="root", MODE:="0600"\n'
    )


def _hide(node: Path) -> None:
    """As the rule does, where udev does not run or was here first."""
    with contextlib.suppress(FileNotFoundError):
        with contextlib.suppress(OSError):
            os.removexattr(node, _ACL)
        os.chmod(node, 0o600)
