"""HID devices of this machine, which of them can be driven, and the choice of one.

What there is stands in sysfs, for everybody to read: nothing is opened to list it.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal

from hapticd.base.errors import quoted
from hapticd.config.hid import Hid
from hapticd.hid.device import RULE
from hapticd.hid.plan import DeviceError, UndrivableError
from hapticd.hid.verdict import Verdict, verdict_of

SYSFS: Final = Path("/sys/class/hidraw")
DEV: Final = Path("/dev")

_BUSES: Final = {3: "USB", 5: "Bluetooth", 6: "virtual", 24: "I2C"}
_MOST_LISTED: Final = 3
_HERE: Final = "`hapticd devices` lists what is there"


@dataclass(frozen=True, slots=True)
class Found:
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
    """Of its interrupt endpoints (USB); None where it has none."""
    out_interval_s: float | None
    permission: Literal["ok", "denied", "absent"]
    hid_name: str = ""
    """As /sys/bus/hid/devices has it."""
    port: str = ""
    """Where it is plugged in."""
    hid: Hid = field(default=Hid(), kw_only=True)
    """The configuration by which it is evaluated."""
    verdict: Verdict = field(init=False, repr=False, compare=False)
    """Whether it can be driven."""

    def __post_init__(self) -> None:
        # Once: reading the descriptor and planning take some milliseconds.
        object.__setattr__(self, "verdict", verdict_of(self.hid, self.descriptor))

    @property
    def usable(self) -> bool:
        """Whether it can be driven."""
        return self.verdict.drivable

    @property
    def resets_seen(self) -> bool | None:
        """Whether it has a report that says which of our effects play: without, a reset by another program is not
        noticed. None where it cannot be driven, and where it has no effects (device.hid.report). A device with such a
        report may still not send it."""
        plan = self.verdict.plan
        return None if plan is None or plan.foreign_s is None else plan.effects is not None

    def __str__(self) -> str:
        return f"{self.path} ({self.name or 'no name'}, {self.vendor:04x}:{self.product:04x})"

    @property
    def identity(self) -> str:
        """Tells it from any other device that may take its place; one without serial is known by its port, too."""
        return f"{self.vendor:04x}:{self.product:04x} {self.serial or self.port} {self.name} {self.descriptor.hex()}"

    @property
    def is_other(self) -> bool:
        """Whether it is no device of the PID class at all, or none that can be read."""
        layout = self.verdict.layout
        return layout is None or layout.constant_force is None

    def evaluated_by(self, hid: Hid) -> Found:
        """The same, evaluated by a configuration if that may mean it."""
        return replace(self, hid=hid) if hid != self.hid and is_meant(hid, self) else self

    def to_dict(self) -> dict[str, object]:
        """For programs."""
        names = ("path", "name", "vendor", "product", "serial", "bus", "driver", "permission")
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


def find(sysfs: Path = SYSFS, dev: Path = DEV) -> list[Found]:
    """Every hidraw device, by number. A device that goes away meanwhile is left out."""
    try:
        names = [name for name in os.listdir(sysfs) if re.fullmatch(r"hidraw\d+", name)]
    except OSError:
        return []
    found = []
    for name in sorted(names, key=lambda text: int(text[6:])):
        try:
            found.append(_look(sysfs / name, dev / name))
        except OSError:
            continue
    return found


def choose(hid: Hid, found: Sequence[Found]) -> Found:
    """The one device that the configuration means. Raises DeviceError: none, several, or one that cannot be driven."""
    keys = {"vendor": hid.vendor, "product": hid.product, "serial": hid.serial, "path": hid.path}
    wanted = [
        f"{key} {quoted(value) if isinstance(value, str) else f'0x{value:04x}'}"
        for key, value in keys.items()
        if value is not None
    ]
    text = f" with {', '.join(wanted)}" if wanted else ""
    meant = [item.evaluated_by(hid) for item in found if is_meant(hid, item)]
    if not meant:
        others = f"; there are {_listed(found)}" if found and wanted else ""
        raise DeviceError(f"no HID device{text} is connected{others}; {_HERE}")
    usable = [item for item in meant if item.usable]
    if len(usable) > 1:
        raise DeviceError(
            f"several HID devices{text} can be driven: {_listed(usable)}; "
            "choose one by device.hid.vendor, product, serial or path"
        )
    if not usable:
        # Those that are made for forces, or that the configuration names or describes.
        expected = [item for item in meant if not item.is_other or hid.names_one or hid.report is not None]
        if not expected and len(meant) > 1:
            raise DeviceError(
                f"no HID device{text} can be driven: none of {_listed(meant)} is a force-feedback device; {_HERE}"
            )
        shown = (expected or meant)[:_MOST_LISTED]
        whys = "; ".join(f"{item} cannot be driven: {item.verdict.why_not}" for item in shown)
        described = hid.report is not None or not any(item.is_other for item in shown)
        hint = "" if described else "; a device with reports of its own needs device.hid.report"
        raise (UndrivableError if expected else DeviceError)(f"{whys}{hint}")
    one = usable[0]
    if one.permission == "denied":
        raise DeviceError(f"{one}: no permission: {RULE}")
    return one


def _listed(found: Sequence[Found]) -> str:
    return ", ".join(map(str, found[:8])) + (", ..." if len(found) > 8 else "")


def is_meant(hid: Hid, item: Found) -> bool:
    """Whether a configuration may mean this device."""
    return (
        hid.vendor in (None, item.vendor)
        and hid.product in (None, item.product)
        and hid.serial in (None, item.serial)
        and (hid.path is None or os.path.realpath(hid.path) == os.path.realpath(item.path))
    )


def _look(entry: Path, node: Path) -> Found:
    device = entry / "device"
    uevent = dict(line.split("=", 1) for line in _text(device / "uevent").splitlines() if "=" in line)
    bus, vendor, product = (int(part, 16) for part in uevent.get("HID_ID", "0:0:0").split(":"))
    descriptor = (device / "report_descriptor").read_bytes()
    intervals = _intervals(device.resolve().parent)
    absent = not node.exists()
    denied = not absent and not os.access(node, os.R_OK | os.W_OK)
    return Found(
        path=str(node),
        name=uevent.get("HID_NAME", ""),
        vendor=vendor & 0xFFFF,
        product=product & 0xFFFF,
        serial=uevent.get("HID_UNIQ", ""),
        bus=_BUSES.get(bus, f"bus {bus}"),
        driver=uevent.get("DRIVER", ""),
        descriptor=descriptor,
        in_interval_s=intervals.get("in"),
        out_interval_s=intervals.get("out"),
        permission="absent" if absent else "denied" if denied else "ok",
        hid_name=device.resolve().name,
        port=uevent.get("HID_PHYS", ""),
    )


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")


def _intervals(interface: Path) -> dict[str, float]:
    """Intervals of the interrupt endpoints of a USB interface, by direction."""
    found: dict[str, float] = {}
    for endpoint in sorted(interface.glob("ep_*")):
        try:
            match = re.fullmatch(r"(\d+)(ms|us)", _text(endpoint / "interval").strip())
            if match and _text(endpoint / "type").strip() == "Interrupt":
                found[_text(endpoint / "direction").strip()] = int(match[1]) * (1e-3 if match[2] == "ms" else 1e-6)
        except OSError:
            continue
    return found


# ---- The nodes by which other programs use a device ------------------------------------------------------------------


def event_nodes(device: Path) -> list[str]:
    """Names of them below /dev/input, in the order of their numbers. `device`: the HID device in sysfs; none of one
    that is gone or cannot be read."""
    try:
        entries = [entry for entry in device.glob("input/input*/*") if re.fullmatch(r"(event|js)\d+", entry.name)]
    except OSError:
        return []
    return [entry.name for entry in sorted(entries, key=lambda entry: (*_number(entry.parent), *_number(entry)))]


def _number(entry: Path) -> tuple[int, str]:
    return int(re.sub(r"\D", "", entry.name) or 0), entry.name


def is_for_others(node: Path) -> bool:
    """Whether anybody but its owner may use a node; false of one that is not there."""
    try:
        return bool(os.stat(node).st_mode & (stat.S_IRWXG | stat.S_IRWXO))
    except OSError:
        return False
