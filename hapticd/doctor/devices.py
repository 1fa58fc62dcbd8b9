"""Joysticks: whether they may be driven, and who else has them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hapticd.doctor.machine import Finding, Machine, Needs
from hapticd.hid.device_texts import unseen_text
from hapticd.hid.event_nodes import event_nodes, is_for_others

if TYPE_CHECKING:
    from hapticd.hid.discovery import Found

RULE: Final = "70-hapticd.rules"
_RULE_FOLDERS: Final = ("etc", "run", "usr/local/lib", "usr/lib", "lib")
_MOST_PROCESSES: Final = 32768
_SHOWN: Final = 4


def evaluated(machine: Machine, needs: Needs) -> list[Found]:
    """The HID devices, each evaluated by the configuration if that may mean it."""
    devices = machine.find(machine.path("/sys/class/hidraw"), machine.path("/dev"))
    return devices if needs.device is None else [device.evaluated_by(needs.device) for device in devices]


def drivable(machine: Machine, needs: Needs) -> list[Found]:
    """Those that can be driven."""
    return [device for device in evaluated(machine, needs) if device.usable]


def refused(devices: Iterable[Found], needs: Needs) -> Iterator[Finding]:
    """Those that are made for forces, or that the configuration names, and cannot be driven."""
    from hapticd.hid.discovery import is_meant

    for device in devices:
        why_not = device.verdict.why_not
        meant = needs.device is not None and needs.device.names_one and is_meant(needs.device, device)
        if why_not is not None and (meant or not device.is_other):
            name = f"{device.name or 'no name'} at /dev/{Path(device.path).name}"
            yield Finding("joystick", "fail" if meant else "warn", f"{name} cannot be driven: {why_not}")


def permissions(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether the joysticks that can be driven may be."""
    devices = evaluated(machine, needs)
    usable = [device for device in devices if device.usable]
    if not usable:
        other = f"; there are {len(devices)} other HID devices" if devices else ""
        described = needs.device is not None and needs.device.report is not None
        kind = "of the PID class" if not described else "that the configuration describes"
        yield Finding(
            "joystick",
            "warn" if needs.hid else "ok",
            f"no force-feedback joystick {kind} is connected{other}",
            "plug it in; `hapticd devices` says what is there" if needs.hid else "",
        )
    yield from refused(devices, needs)
    for device in usable:
        name = f"{device.name or 'no name'} at /dev/{Path(device.path).name}"
        if device.permission == "ok":
            yield Finding("joystick", "ok", f"{name} may be driven from here")
        elif device.permission == "absent":
            yield Finding("joystick", "fail", f"{name} has no node", "is udev running, or /dev complete?")
        elif _service_may(machine, device):
            yield Finding("joystick", "ok", f"{name} may be driven by the service, not from here")
        else:
            yield Finding(
                "joystick",
                "fail" if needs.hid else "warn",
                f"{name} may not be driven from here",
                "`hapticd install-service` installs the udev rule; then plug it in again",
            )


def _service_may(machine: Machine, device: Found) -> bool:
    """The service is in the group `input`, if it is installed."""
    try:
        status = os.stat(device.path)
    except OSError:
        return False
    installed = machine.path("/etc/systemd/system/hapticd.service").exists()
    return installed and status.st_mode & 0o060 == 0o060 and machine.group(status.st_gid) == "input"


def rule(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether the udev rule is installed."""
    for folder in _RULE_FOLDERS:
        path = machine.path(f"/{folder}/udev/rules.d/{RULE}")
        if path.exists():
            yield Finding("udev rule", "ok", f"/{folder}/udev/rules.d/{RULE}")
            return
    if needs.hid or drivable(machine, needs):
        yield Finding(
            "udev rule",
            "warn",
            f"{RULE} is not installed: joysticks are root's alone, and other programs may reset them",
            "`hapticd install-service` installs it",
        )
    else:
        yield Finding("udev rule", "ok", f"{RULE} is not installed, and no joystick asks for it")


def competitors(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Who else has the nodes of the joysticks open, or could upload effects of their own."""
    usable = drivable(machine, needs)
    if not usable:
        return
    users, hidden = _users(machine)
    blind = f" ({hidden} processes could not be looked at: ask as root)" if hidden else ""
    for device in usable:
        node = f"/dev/{Path(device.path).name}"
        sysfs = machine.path(f"/sys/class/hidraw/{Path(device.path).name}/device")
        events = [f"/dev/input/{name}" for name in event_nodes(sysfs)]
        holders = sorted({name for path in (node, *events) for name in users.get(path, ())})
        if holders:
            yield Finding(
                "competitors",
                "warn",
                f"{node} or its event nodes are open in {', '.join(holders[:_SHOWN])}{blind}",
                "end it: what it uploads resets the joystick",
            )
        loose = [path for path in events if is_for_others(machine.path(path))]
        if loose and _kernel_effects(machine, Path(device.path).name):
            yield Finding(
                "competitors",
                "warn",
                f"the kernel's own driver offers effects of {node} to other programs, at {', '.join(loose[:_SHOWN])}",
                f"`hapticd devices claim {node}` hides these nodes, and so does its line in {RULE}",
            )
        elif not holders:
            yield Finding("competitors", "warn" if hidden else "ok", f"nobody else uses {node}{blind}")
        if device.resets_seen is False:
            condition, action = unseen_text(node)
            yield Finding("resets", "warn" if loose else "ok", condition, action if loose else "")


def _users(machine: Machine) -> tuple[dict[str, set[str]], int]:
    """Names of processes by the nodes that they have open, but for daemons of ours; how many could not be checked."""
    users: dict[str, set[str]] = {}
    hidden = 0
    for pid in islice(machine.names("/proc", r"\d+"), _MOST_PROCESSES):
        folder = machine.path(f"/proc/{pid}/fd")
        try:
            fds = os.listdir(folder)
        except PermissionError:
            hidden += 1
            continue
        except OSError:
            continue
        name = machine.text(f"/proc/{pid}/comm") or "?"
        if "hapticd" in (machine.text(f"/proc/{pid}/cmdline") or ""):
            continue
        for fd in fds:
            try:
                target = os.readlink(folder / fd)
            except OSError:
                continue
            if target.startswith(("/dev/hidraw", "/dev/input/")):
                users.setdefault(target, set()).add(f"{name} ({pid})")
    return users, hidden


def _kernel_effects(machine: Machine, hidraw: str) -> bool:
    """Whether the kernel's own driver offers effects (EV_FF) of the device."""
    base = f"/sys/class/hidraw/{hidraw}/device/input"
    masks = [machine.text(f"{base}/{entry}/capabilities/ff") for entry in machine.names(base, r"input\d+")]
    return any(mask and mask.replace(" ", "").strip("0") for mask in masks)
