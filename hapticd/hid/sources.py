"""Opens the device of a configuration: a hidraw node or a recording."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

from hapticd.base.errors import HapticdError, InvalidError, Problem
from hapticd.config.configuration import Device as DeviceConfig
from hapticd.config.hid import Hid, Replay
from hapticd.hid.connection import Opened, Source
from hapticd.hid.device import Device, HidrawDevice
from hapticd.hid.discovery import choose, find
from hapticd.hid.plan import DeviceError, Plan
from hapticd.hid.replay import Recording, ReplayDevice, load
from hapticd.hid.verdict import verdict_of


def source_of(device: DeviceConfig) -> Source:
    """Return the function that finds and opens the device of a configuration whose kind is hid or replay."""
    if device.kind == "replay":
        assert device.replay is not None
        return replay_source(device.replay, device.hid)
    return lambda: open_hid(device.hid)


def open_hid(hid: Hid) -> Opened:
    """Open the device that the configuration selects. Raises DeviceError."""
    found = choose(hid, find())
    driver, _ = found.verdict.driver_and_plan()
    on_change = True if "reports_on_change" in hid.quirks else False if "reports_steadily" in hid.quirks else None
    device = HidrawDevice(found.path)
    return Opened(device, driver, found.name, found.out_interval_s, on_change, identity=found.identity, keys=found.keys)


def read_replay(replay: Replay, hid: Hid) -> tuple[Recording, Plan]:
    """Return the recording that a configuration names, and the plan of the recorded device.

    Raises InvalidError, with key and full path, if the file cannot be read or the recorded device cannot be driven.
    """
    path = os.path.abspath(replay.path)
    try:
        recording = load(path)
        _, plan = verdict_of(hid, recording.descriptor).driver_and_plan()
    except HapticdError as error:
        where = f"{path}: " if isinstance(error, DeviceError) else ""
        raise InvalidError([Problem("device.replay.path", f"{where}{error}")]) from None
    return recording, plan


def replay_source(replay: Replay, hid: Hid) -> Source:
    """Return the function that opens a recording as a device. Raises InvalidError if the recording cannot be read."""
    recording, plan = read_replay(replay, hid)
    # No other program can change the effects of a recording.
    driver = _ReplayDriver(replace(plan, restore=(), foreign_effect_s=None))
    played: list[ReplayDevice] = []

    def play() -> Opened:
        if played and not replay.loop:
            raise DeviceError(f"{replay.path}: the recording is over; restart the daemon, or set device.replay.loop")
        device = ReplayDevice(recording, replay)
        played[:] = [device]
        return Opened(device, driver, recording.name, None, recording.on_change, measure=False)

    return play


@dataclass(frozen=True)
class _ReplayDriver:
    """Driver of a recording, which needs no set-up."""

    plan: Plan

    def set_up(self, device: Device) -> Plan:
        """Return the plan of the recorded device's reports; nothing is sent."""
        return self.plan
