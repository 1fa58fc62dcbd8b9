"""Checks of joysticks: whether they may be driven, and which other programs use them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from hapticd.doctor.machine import Finding, Machine, Needs, Verdict, fail, ok, warn
from hapticd.hid.device_texts import unseen_reset_text
from hapticd.hid.discovery import SysfsDevice, event_nodes, is_open_to_others, is_selected

_UDEV_RULE_FILE: Final = "70-hapticd.rules"
_UDEV_RULE_FOLDERS: Final = ("etc", "run", "usr/local/lib", "usr/lib", "lib")
_MAX_LISTED_NAMES: Final = 4
"""A line of output lists at most this many programs or event nodes."""


def _evaluated_devices(machine: Machine, needs: Needs) -> list[SysfsDevice]:
    """Return the HID devices, each with its verdict for the configured joystick if `needs` has one."""
    devices = machine.find(machine.path("/sys/class/hidraw"), machine.path("/dev"))
    return devices if needs.device is None else [device.evaluated_by(needs.device) for device in devices]


def _drivable_devices(machine: Machine, needs: Needs) -> list[SysfsDevice]:
    return [device for device in _evaluated_devices(machine, needs) if device.usable]


def permissions(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check the permission of each joystick that can be driven.

    A joystick with force feedback that cannot be driven yields a warning, or a failure if the configuration names it.
    """
    devices = _evaluated_devices(machine, needs)
    if not any(device.usable for device in devices):
        other = f"; there are {len(devices)} other HID devices" if devices else ""
        described = needs.device is not None and needs.device.report is not None
        kind = "that the configuration describes" if described else "of the PID class"
        todo = "plug it in; `hapticd devices` lists the HID devices" if needs.device is not None else ""
        what = f"no force-feedback joystick {kind} is connected{other}"
        yield Finding("joystick", "warn" if needs.device is not None else "ok", what, todo)
    for device in devices:
        why_not = device.verdict.why_not
        name = f"{device.name or 'no name'} at {_node_path(device)}"
        meant = needs.device is not None and needs.device.names_one and is_selected(needs.device, device)
        if why_not is not None:
            if meant or not device.lacks_forces:
                yield Finding("joystick", "fail" if meant else "warn", f"{name} cannot be driven: {why_not}")
        elif device.permission == "ok":
            yield ok("joystick", f"this user may drive {name}")
        elif device.permission == "absent":
            yield fail("joystick", f"{name}: the node does not exist", "check that udev is running")
        elif _service_may_open(machine, device):
            yield ok("joystick", f"the service may drive {name}, this user may not")
        else:
            verdict: Verdict = "fail" if needs.device is not None else "warn"
            todo = "`hapticd install-service` installs the udev rule; then plug the device in again"
            yield Finding("joystick", verdict, f"this user may not drive {name}", todo)


def _node_path(device: SysfsDevice) -> str:
    """Return the path of the device's node on the machine, without the root folder of the checks."""
    return f"/dev/{Path(device.path).name}"


def _service_may_open(machine: Machine, device: SysfsDevice) -> bool:
    """Return whether the service is installed and may open the device as a member of the group `input`."""
    try:
        status = os.stat(device.path)
    except OSError:
        return False
    installed = machine.path("/etc/systemd/system/hapticd.service").exists()
    return installed and status.st_mode & 0o060 == 0o060 and machine.group(status.st_gid) == "input"


def rule(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check whether the udev rule that lets users open joysticks, 70-hapticd.rules, is installed."""
    paths = [f"/{folder}/udev/rules.d/{_UDEV_RULE_FILE}" for folder in _UDEV_RULE_FOLDERS]
    found = next((path for path in paths if machine.path(path).exists()), None)
    if found is not None:
        yield ok("udev rule", found)
    elif needs.device is not None or _drivable_devices(machine, needs):
        what = f"{_UDEV_RULE_FILE} is not installed: only root may open joysticks, and other programs may reset them"
        yield warn("udev rule", what, "`hapticd install-service` installs it")
    else:
        yield ok("udev rule", f"{_UDEV_RULE_FILE} is not installed, and no joystick needs it")


def competitors(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check which other programs have a joystick's nodes open or could upload effects to it."""
    usable = _drivable_devices(machine, needs)
    users, hidden = _node_users(machine) if usable else ({}, 0)
    blind = f" ({hidden} processes could not be checked: run this as root)" if hidden else ""
    for device in usable:
        node, sysfs = _node_path(device), f"/sys/class/hidraw/{Path(device.path).name}/device"
        events = [f"/dev/input/{name}" for name in event_nodes(machine.path(sysfs))]
        loose = [path for path in events if is_open_to_others(machine.path(path))]
        holders = sorted({name for path in (node, *events) for name in users.get(path, ())})
        if holders:
            what = f"{node} or its event nodes are open in {', '.join(holders[:_MAX_LISTED_NAMES])}{blind}"
            yield warn("competitors", what, "end these programs: an effect that they upload resets the joystick")
        if loose and _kernel_offers_effects(machine, f"{sysfs}/input"):
            offered = f"the kernel's own driver offers effects of {node} to other programs"
            todo = f"`hapticd devices claim {node}` hides these nodes, and so does a line in {_UDEV_RULE_FILE}"
            yield warn("competitors", f"{offered}, at {', '.join(loose[:_MAX_LISTED_NAMES])}", todo)
        elif not holders:
            yield Finding("competitors", "warn" if hidden else "ok", f"no other program uses {node}{blind}")
        if device.resets_seen is False:
            condition, action = unseen_reset_text(node)
            yield warn("resets", condition, action) if loose else ok("resets", condition)


def _node_users(machine: Machine) -> tuple[dict[str, set[str]], int]:
    """Return the names of other programs' processes by the path of an open file, and the number of hidden processes."""
    users: dict[str, set[str]] = {}
    hidden = 0
    for pid in machine.names("/proc", r"\d+"):
        folder = machine.path(f"/proc/{pid}/fd")
        try:
            fds = os.listdir(folder)
        except PermissionError:
            hidden += 1
            continue
        except OSError:
            continue  # the process has ended
        if "hapticd" in (machine.text(f"/proc/{pid}/cmdline") or ""):
            continue
        name = f"{machine.text(f'/proc/{pid}/comm') or '?'} ({pid})"
        for fd in fds:
            with suppress(OSError):  # the process has closed the file
                users.setdefault(os.readlink(folder / fd), set()).add(name)
    return users, hidden


def _kernel_offers_effects(machine: Machine, inputs: str) -> bool:
    """Return whether the kernel offers a device's effects (EV_FF); `inputs` is the device's folder `input` in sysfs."""
    masks = [machine.text(f"{inputs}/{entry}/capabilities/ff") for entry in machine.names(inputs, r"input\d+")]
    return any(mask and mask.replace(" ", "").strip("0") for mask in masks)
