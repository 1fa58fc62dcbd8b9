"""Where a configuration's device comes from: the machine's HID devices, or a recording."""

from __future__ import annotations

from hapticd.config import Device as DeviceConfig
from hapticd.hid.config import Hid, Replay
from hapticd.hid.connection import Opened, Source
from hapticd.hid.descriptor import DescriptorError, parse
from hapticd.hid.device import Device, Driver, HidrawDevice
from hapticd.hid.discover import choose, find
from hapticd.hid.layout import layout_of
from hapticd.hid.pid import PidDriver, plan_of, ways_of
from hapticd.hid.plan import DeviceError, Plan
from hapticd.hid.replay import ReplayDevice, load
from hapticd.hid.vendor import VendorDriver
from hapticd.hid.vendor import plan_of as vendor_plan_of


def source_of(device: DeviceConfig) -> Source:
    """What finds and opens the device of a configuration whose kind is hid or replay."""
    if device.kind == "replay":
        assert device.replay is not None
        return replay_source(device.replay, device.hid)
    return lambda: open_hid(device.hid)


def open_hid(hid: Hid) -> Opened:
    """The device that the configuration means, open. Raises DeviceError, one line."""
    found = choose(hid, find())
    driver = driver_of(hid, found.descriptor)
    on_change = True if "reports_on_change" in hid.quirks else False if "reports_steadily" in hid.quirks else None
    return Opened(
        HidrawDevice(found.path), driver, found.name, found.out_interval_s, on_change, identity=found.identity
    )


def driver_of(hid: Hid, descriptor: bytes) -> Driver:
    """How a device with this report descriptor is driven. Raises DeviceError."""
    if hid.report is not None:
        return VendorDriver(hid, descriptor)
    try:
        layout = layout_of(parse(descriptor))
    except DescriptorError as error:
        raise DeviceError(f"the device's report descriptor is not valid: {error}") from None
    if not layout.usable:
        raise DeviceError(f"the device cannot be driven: its report descriptor has no {', no '.join(layout.missing)}")
    return PidDriver(layout, hid)


def expected_plan(hid: Hid, descriptor: bytes) -> Plan:
    """The plan for a device with this report descriptor that is not set up: as if it had room for what is wanted, its
    effects numbered as a device would do it. Raises DeviceError."""
    driver_of(hid, descriptor)
    if hid.report is not None:
        return vendor_plan_of(hid, hid.report)
    layout = layout_of(parse(descriptor))
    way = ways_of(layout, hid)[0]
    first, last = layout.effect_indices or (1, 1)
    return plan_of(layout, hid, way, range(first, last + 1)[: 1 if way in ("one", "polar") else 2])


def replay_source(replay: Replay, hid: Hid) -> Source:
    """What plays a recording, once or for ever. Raises HapticdError for one that cannot be read."""
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
    """A recording is not set up."""

    def __init__(self, hid: Hid, descriptor: bytes) -> None:
        self._plan = expected_plan(hid, descriptor)

    def set_up(self, device: Device) -> Plan:
        """Nothing but the plan."""
        return self._plan
