"""Opens the device of a configuration: a hidraw node or a recording."""

from __future__ import annotations

from hapticd.config.configuration import Device as DeviceConfig
from hapticd.config.hid import Hid, Replay
from hapticd.hid.connection import Opened, Source
from hapticd.hid.device import Device, HidrawDevice
from hapticd.hid.discovery import choose, find
from hapticd.hid.plan import DeviceError, Plan
from hapticd.hid.replay import ReplayDevice, load
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


def replay_source(replay: Replay, hid: Hid) -> Source:
    """Return the function that opens a recording as a device. Raises HapticdError if the recording cannot be read."""
    recording = load(replay.path)
    driver = _ReplayDriver(hid, recording.descriptor)
    played: list[ReplayDevice] = []

    def play() -> Opened:
        if played and not replay.loop:
            raise DeviceError(f"{replay.path}: the recording is over")
        device = ReplayDevice(recording, replay)
        played[:] = [device]
        return Opened(device, driver, recording.name, None, recording.on_change, measure=False)

    return play


class _ReplayDriver:
    """Driver of a recording, which needs no set-up."""

    def __init__(self, hid: Hid, descriptor: bytes) -> None:
        _, self._plan = verdict_of(hid, descriptor).driver_and_plan()

    def set_up(self, device: Device) -> Plan:
        """Return the plan of the recorded device's reports; nothing is sent."""
        return self._plan
