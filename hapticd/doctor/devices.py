"""Joysticks: whether they may be driven, and who else has them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from hapticd.doctor.machine import Finding, Machine, Needs, Verdict, fail, ok, warn
from hapticd.hid.device_texts import unseen_text
from hapticd.hid.discovery import Found, event_nodes, is_for_others, is_meant

_RULE: Final = "70-hapticd.rules"
_RULE_FOLDERS: Final = ("etc", "run", "usr/local/lib", "usr/lib", "lib")
_INSTALLED: Final = "`hapticd install-service` installs the udev rule; then plug it in again"
_SHOWN: Final = 4


def _evaluated(machine: Machine, needs: Needs) -> list[Found]:
    """The HID devices, each evaluated by the configuration if that may mean it."""
    devices = machine.find(machine.path("/sys/class/hidraw"), machine.path("/dev"))
    return devices if needs.device is None else [device.evaluated_by(needs.device) for device in devices]


def _drivable(machine: Machine, needs: Needs) -> list[Found]:
    return [device for device in _evaluated(machine, needs) if device.usable]


def permissions(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether the joysticks that can be driven may be; and those that are made for forces, or that the configuration
    names, and cannot be driven."""
    devices = _evaluated(machine, needs)
    if not any(device.usable for device in devices):
        other = f"; there are {len(devices)} other HID devices" if devices else ""
        described = needs.device is not None and needs.device.report is not None
        kind = "that the configuration describes" if described else "of the PID class"
        todo = "plug it in; `hapticd devices` says what is there" if needs.device is not None else ""
        what = f"no force-feedback joystick {kind} is connected{other}"
        yield Finding("joystick", "warn" if needs.device is not None else "ok", what, todo)
    for device in devices:
        why_not = device.verdict.why_not
        name = f"{device.name or 'no name'} at {_node(device)}"
        meant = needs.device is not None and needs.device.names_one and is_meant(needs.device, device)
        if why_not is not None:
            if meant or not device.is_other:
                yield Finding("joystick", "fail" if meant else "warn", f"{name} cannot be driven: {why_not}")
        elif device.permission == "ok":
            yield ok("joystick", f"{name} may be driven from here")
        elif device.permission == "absent":
            yield fail("joystick", f"{name} has no node", "is udev running, or /dev complete?")
        elif _service_may(machine, device):
            yield ok("joystick", f"{name} may be driven by the service, not from here")
        else:
            verdict: Verdict = "fail" if needs.device is not None else "warn"
            yield Finding("joystick", verdict, f"{name} may not be driven from here", _INSTALLED)


def _node(device: Found) -> str:
    """As this machine has it, whatever the root that is looked at."""
    return f"/dev/{Path(device.path).name}"


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
    paths = [f"/{folder}/udev/rules.d/{_RULE}" for folder in _RULE_FOLDERS]
    found = next((path for path in paths if machine.path(path).exists()), None)
    if found is not None:
        yield ok("udev rule", found)
    elif needs.device is not None or _drivable(machine, needs):
        what = f"{_RULE} is not installed: joysticks are root's alone, and other programs may reset them"
        yield warn("udev rule", what, "`hapticd install-service` installs it")
    else:
        yield ok("udev rule", f"{_RULE} is not installed, and no joystick asks for it")


def competitors(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Who else has the nodes of the joysticks open, or could upload effects of their own."""
    usable = _drivable(machine, needs)
    users, hidden = _users(machine) if usable else ({}, 0)
    blind = f" ({hidden} processes could not be looked at: ask as root)" if hidden else ""
    for device in usable:
        node, sysfs = _node(device), f"/sys/class/hidraw/{Path(device.path).name}/device"
        events = [f"/dev/input/{name}" for name in event_nodes(machine.path(sysfs))]
        loose = [path for path in events if is_for_others(machine.path(path))]
        holders = sorted({name for path in (node, *events) for name in users.get(path, ())})
        if holders:
            what = f"{node} or its event nodes are open in {', '.join(holders[:_SHOWN])}{blind}"
            yield warn("competitors", what, "end it: what it uploads resets the joystick")
        if loose and _kernel_effects(machine, f"{sysfs}/input"):
            offered = f"the kernel's own driver offers effects of {node} to other programs"
            todo = f"`hapticd devices claim {node}` hides these nodes, and so does its line in {_RULE}"
            yield warn("competitors", f"{offered}, at {', '.join(loose[:_SHOWN])}", todo)
        elif not holders:
            yield Finding("competitors", "warn" if hidden else "ok", f"nobody else uses {node}{blind}")
        if device.resets_seen is False:
            condition, action = unseen_text(node)
            yield warn("resets", condition, action) if loose else ok("resets", condition)


def _users(machine: Machine) -> tuple[dict[str, set[str]], int]:
    """Names of processes by the nodes that they have open, but for daemons of ours; how many could not be checked."""
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
            continue  # it has ended
        if "hapticd" in (machine.text(f"/proc/{pid}/cmdline") or ""):
            continue
        name = f"{machine.text(f'/proc/{pid}/comm') or '?'} ({pid})"
        for fd in fds:
            with suppress(OSError):  # it has been closed meanwhile
                users.setdefault(os.readlink(folder / fd), set()).add(name)
    return users, hidden


def _kernel_effects(machine: Machine, inputs: str) -> bool:
    """Whether the kernel's own driver offers effects (EV_FF) of the device's inputs."""
    masks = [machine.text(f"{inputs}/{entry}/capabilities/ff") for entry in machine.names(inputs, r"input\d+")]
    return any(mask and mask.replace(" ", "").strip("0") for mask in masks)
