"""Lists the HID devices of this machine, and chooses the one that a configuration selects.

The list comes from sysfs, which every user may read: no device is opened for it.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal

from hapticd.base.errors import quoted
from hapticd.config.hid import Hid
from hapticd.hid.device import PERMISSION_HINT
from hapticd.hid.plan import DeviceError, UndrivableError
from hapticd.hid.verdict import Verdict, verdict_of

HIDRAW_SYSFS: Final = Path("/sys/class/hidraw")
DEV_FOLDER: Final = Path("/dev")

_BUS_NAMES: Final = {3: "USB", 5: "Bluetooth", 6: "virtual", 24: "I2C"}
"""Names of the buses by their numbers in linux/input.h."""
_MAX_REASONS: Final = 3
"""An error says for at most this many devices why they cannot be driven."""
_LIST_HINT: Final = "`hapticd devices` lists the HID devices"


@dataclass(frozen=True, slots=True)
class SysfsDevice:
    """A HID device, as sysfs describes it."""

    path: str
    name: str
    vendor: int
    product: int
    serial: str
    bus: str
    driver: str
    descriptor: bytes
    in_interval_s: float | None
    """Interval of the USB interrupt endpoint for input reports; None without such an endpoint."""
    out_interval_s: float | None
    """Interval of the USB interrupt endpoint for output reports; None without such an endpoint."""
    permission: Literal["ok", "denied", "absent"]
    """Whether this process may open the node, or "absent" if it does not exist."""
    hid_name: str = ""
    """Name of the device in /sys/bus/hid/devices."""
    port: str = ""
    """The port that the device is plugged into, as HID_PHYS in sysfs names it."""
    version: int | None = None
    """The device's own version (bcdDevice of USB); None if it does not show one."""
    hid: Hid = field(default=Hid(), kw_only=True)
    """The configuration (device.hid) for which `verdict` was made."""
    verdict: Verdict = field(init=False, repr=False, compare=False)
    """Whether and how the device can be driven."""

    def __post_init__(self) -> None:
        # Computed once: parsing the descriptor and planning take some milliseconds.
        object.__setattr__(self, "verdict", verdict_of(self.hid, self.descriptor))

    @property
    def usable(self) -> bool:
        """Whether the device can be driven."""
        return self.verdict.drivable

    @property
    def resets_seen(self) -> bool | None:
        """Whether the descriptor has a report (PID State) by which a reset by another program would be noticed.

        None if the device cannot be driven, or has no effects (vendor reports). Some devices never send this report.
        """
        plan = self.verdict.plan
        return None if plan is None or plan.foreign_effect_s is None else plan.effects is not None

    def __str__(self) -> str:
        return f"{self.path} ({self.name or 'no name'}, {self.vendor:04x}:{self.product:04x})"

    @property
    def identity(self) -> str:
        """Text that distinguishes this device from others; without a serial number it includes the port.

        A device with another version counts as another device, because an update may turn its forces round.
        """
        numbers = f"{self.vendor:04x}:{self.product:04x}:{self.version}"
        return f"{numbers} {self.serial or self.port} {self.name} {self.descriptor.hex()}"

    @property
    def keys(self) -> dict[str, int | str]:
        """The keys of `device.hid` for this device: vendor, product and, if known, serial number and version."""
        keys: dict[str, int | str] = {"vendor": self.vendor, "product": self.product}
        keys |= {"serial": self.serial} if self.serial else {}
        return keys | ({} if self.version is None else {"device_version": self.version})

    @property
    def lacks_forces(self) -> bool:
        """Whether the device's report descriptor has no Set Constant Force report, or is not valid."""
        layout = self.verdict.layout
        return layout is None or layout.constant_force is None

    def evaluated_by(self, hid: Hid) -> SysfsDevice:
        """Return this device with its verdict for `hid`; unchanged if that configuration selects another device."""
        return replace(self, hid=hid) if hid != self.hid and is_selected(hid, self) else self

    def to_dict(self) -> dict[str, object]:
        """Return the device as a map for `hapticd devices --json`."""
        names = ("path", "name", "vendor", "product", "version", "serial", "bus", "driver", "permission")
        verdict, layout = self.verdict, self.verdict.layout
        return {
            **{name: getattr(self, name) for name in names},
            "usable": verdict.drivable,
            "why_not": verdict.why_not,
            "missing": [] if layout is None else list(layout.missing),
            "problem": verdict.problem,
            "resets_seen": self.resets_seen,
            "in_interval_s": self.in_interval_s,
            "out_interval_s": self.out_interval_s,
        }


def find(sysfs: Path = HIDRAW_SYSFS, dev: Path = DEV_FOLDER) -> list[SysfsDevice]:
    """Return all hidraw devices, in the order of their numbers, except those that are unplugged meanwhile."""
    try:
        names = [name for name in os.listdir(sysfs) if re.fullmatch(r"hidraw\d+", name)]
    except OSError:
        return []
    devices = []
    for name in sorted(names, key=lambda text: int(text[6:])):
        with suppress(OSError):
            devices.append(_read_device(sysfs / name, dev / name))
    return devices


def choose(hid: Hid, devices: Sequence[SysfsDevice]) -> SysfsDevice:
    """Return the one device that the configuration selects.

    Raises DeviceError if it selects no device or several, or if the device cannot be driven or opened.
    """
    keys = {"vendor": hid.vendor, "product": hid.product, "serial": hid.serial, "path": hid.path}
    wanted = [
        f"{key} {quoted(value) if isinstance(value, str) else f'0x{value:04x}'}"
        for key, value in keys.items()
        if value is not None
    ]
    text = f" with {', '.join(wanted)}" if wanted else ""
    selected = [device.evaluated_by(hid) for device in devices if is_selected(hid, device)]
    if not selected:
        others = f"; there are {_listed(devices)}" if devices and wanted else ""
        raise DeviceError(f"no HID device{text} is connected{others}; {_LIST_HINT}")
    usable = [device for device in selected if device.usable]
    if len(usable) > 1:
        raise DeviceError(
            f"several HID devices{text} can be driven: {_listed(usable)}; "
            "choose one by device.hid.vendor, product, serial or path"
        )
    if not usable:
        # Devices with force feedback, and those that the configuration names or describes.
        expected = [one for one in selected if not one.lacks_forces or hid.names_one or hid.report is not None]
        if not expected and len(selected) > 1:
            listed = f"none of {_listed(selected)} is a force-feedback device"
            raise DeviceError(f"no HID device{text} can be driven: {listed}; {_LIST_HINT}")
        shown = (expected or selected)[:_MAX_REASONS]
        whys = "; ".join(f"{device} cannot be driven: {device.verdict.why_not}" for device in shown)
        described = hid.report is not None or not any(device.lacks_forces for device in shown)
        hint = "" if described else "; a device outside the PID class needs device.hid.report"
        raise (UndrivableError if expected else DeviceError)(f"{whys}{hint}")
    if usable[0].permission == "denied":
        raise DeviceError(f"{usable[0]}: no permission: {PERMISSION_HINT}")
    return usable[0]


def _listed(devices: Sequence[SysfsDevice]) -> str:
    return ", ".join(map(str, devices[:8])) + (", ..." if len(devices) > 8 else "")


def is_selected(hid: Hid, device: SysfsDevice) -> bool:
    """Return whether vendor, product, serial number and path in the configuration fit this device."""
    return (
        hid.vendor in (None, device.vendor)
        and hid.product in (None, device.product)
        and hid.serial in (None, device.serial)
        and (hid.path is None or os.path.realpath(hid.path) == os.path.realpath(device.path))
    )


def _read_device(entry: Path, node: Path) -> SysfsDevice:
    device = entry / "device"
    uevent = dict(line.split("=", 1) for line in _text(device / "uevent").splitlines() if "=" in line)
    bus, vendor, product = (int(part, 16) for part in uevent.get("HID_ID", "0:0:0").split(":"))
    descriptor = (device / "report_descriptor").read_bytes()
    intervals = _endpoint_intervals(device.resolve().parent)
    absent = not node.exists()
    denied = not absent and not os.access(node, os.R_OK | os.W_OK)
    return SysfsDevice(
        path=str(node),
        name=uevent.get("HID_NAME", ""),
        vendor=vendor & 0xFFFF,
        product=product & 0xFFFF,
        serial=uevent.get("HID_UNIQ", ""),
        bus=_BUS_NAMES.get(bus, f"bus {bus}"),
        driver=uevent.get("DRIVER", ""),
        descriptor=descriptor,
        in_interval_s=intervals.get("in"),
        out_interval_s=intervals.get("out"),
        permission="absent" if absent else "denied" if denied else "ok",
        hid_name=device.resolve().name,
        port=uevent.get("HID_PHYS", ""),
        version=_version(device.resolve()),
    )


def _version(device: Path) -> int | None:
    """Return the version of a HID device, given its folder in sysfs; None if it shows none.

    A USB device has it two folders up; the version of its input nodes is that of the HID specification. On other buses,
    such as Bluetooth, the input nodes have the version of the device.
    """
    for file in (device.parent.parent / "bcdDevice", *sorted(device.glob("input/input*/id/version"))):
        with suppress(OSError, ValueError):
            return int(_text(file), 16)
    return None


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")


def _endpoint_intervals(interface: Path) -> dict[str, float]:
    """Return the intervals of the interrupt endpoints of a USB interface, in s, by direction: "in", "out"."""
    intervals: dict[str, float] = {}
    for endpoint in sorted(interface.glob("ep_*")):
        with suppress(OSError):
            match = re.fullmatch(r"(\d+)(ms|us)", _text(endpoint / "interval").strip())
            if match and _text(endpoint / "type").strip() == "Interrupt":
                intervals[_text(endpoint / "direction").strip()] = int(match[1]) * (1e-3 if match[2] == "ms" else 1e-6)
    return intervals


# ---- Event and joystick nodes, by which other programs use a device --------------------------------------------------


def event_nodes(device: Path) -> list[str]:
    """Return the names of a device's event and joystick nodes below /dev/input, in the order of their numbers.

    `device` is the folder of the HID device in sysfs. Returns [] if it does not exist or cannot be read.
    """
    try:
        entries = [entry for entry in device.glob("input/input*/*") if re.fullmatch(r"(event|js)\d+", entry.name)]
    except OSError:
        return []
    return [entry.name for entry in sorted(entries, key=lambda entry: (*_number(entry.parent), *_number(entry)))]


def _number(entry: Path) -> tuple[int, str]:
    return int(re.sub(r"\D", "", entry.name) or 0), entry.name


def is_open_to_others(node: Path) -> bool:
    """Return whether users other than the owner may use a device node; False if it does not exist."""
    try:
        return bool(os.stat(node).st_mode & (stat.S_IRWXG | stat.S_IRWXO))
    except OSError:
        return False
