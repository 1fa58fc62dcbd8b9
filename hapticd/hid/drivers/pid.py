"""Devices of the PID class: set-up. pid_plan.py has what is sent afterwards, pid_reports.py how reports are encoded.

A set-up resets the device, enables its actuators, sets its gain, has it make the effects, and starts them with a force
of zero. Where it has no room for two effects, one with a direction is used.

PID Pool says how many effects a device plays at a time. Some firmware frees every effect when its pool is read. So it
is read once in a set-up, after the reset and before the first effect is made. Nothing depends on it: where it is not
given, PID Block Load says whether there is room.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final

from hapticd.base.core import lib
from hapticd.config.hid import Hid
from hapticd.hid.descriptor.fields import Field
from hapticd.hid.descriptor.layout import BlockLoad, Layout
from hapticd.hid.device import Device
from hapticd.hid.drivers.pid_plan import (
    Way,
    axes_of,
    effects_of,
    periodic_of,
    periodic_problem,
    plan_of,
    stop_messages,
    ways_of,
)
from hapticd.hid.drivers.pid_reports import (
    ReportWriter,
    bits_of,
    block_free_report,
    constant_force_report,
    control_report,
    duration_of,
    gain_report,
    operation_report,
    set_effect_report,
)
from hapticd.hid.plan import DeviceError, Plan
from hapticd.system.repeated_lines import Repeats

LOAD_TRIES: Final = 30
LOAD_PAUSE_S: Final = 0.01
"""A device that has not yet loaded an effect is asked again so often, after this time."""
AGAIN_S: Final = 0.05
"""A device that says that it plays one effect, or none, is asked once more, after this time."""

_log = logging.getLogger("hapticd")
_repeats = Repeats()


class _FullError(DeviceError):
    """The device has no room for another effect."""


class _RefusedError(DeviceError):
    """The device does not take an effect."""


class PidDriver:
    """Sets up one device, as often as it is asked to."""

    def __init__(self, layout: Layout, hid: Hid) -> None:
        """Raises DeviceError where the layout cannot show what is wanted."""
        self._layout = layout
        self._hid = hid
        self._ways = ways_of(layout, hid)
        self._indices: list[int] = []
        axes_of(layout, hid)
        duration_of(layout, hid)

    def set_up(self, device: Device) -> Plan:
        """Resets the device, enables it, and leaves its effects running with a force of zero."""
        self._prepare(device)
        ways, most = self._ways, self._room(device)
        needed = len(effects_of(ways[0], self._hid))
        if most is not None and most < needed:
            other = "one effect with direction is used" if len(ways) > 1 else "PID Block Load decides"
            _warn(f"{device.path}: plays {most} effect at a time, {needed} are needed; {other}")
            ways = ways[1:] or ways
        for way in ways:
            try:
                return self._set_up(device, way, most)
            except _FullError as error:
                if way == ways[-1]:
                    raise
                _log.warning("%s; one effect with direction is used", error)
                self._prepare(device)
        raise AssertionError("there is always a way")

    def _prepare(self, device: Device) -> None:
        """Resets it and enables it: without effects, at full gain."""
        layout, quirks = self._layout, self._hid.quirks
        if self._indices and ("no_reset" in quirks or control_report(layout, "device_reset") is None):
            # Nothing else would free what the last set-up made.
            _undo(layout, device, self._indices)
        self._indices = []
        for name in ("device_reset", "stop_all_effects", "enable_actuators"):
            if name != "device_reset" or "no_reset" not in quirks:
                _send(device, control_report(layout, name))
        _send(device, gain_report(layout, self._hid))

    def _room(self, device: Device) -> int | None:
        """How many effects the device says that it plays, where more than one is wanted; None: not known. No effect
        may exist yet."""
        pool = None if "no_pid_pool" in self._hid.quirks else self._layout.pool
        several = len(effects_of(self._ways[0], self._hid)) > 1
        wanted = several or periodic_problem(self._layout, self._hid) is None
        if not wanted or pool is None or pool.simultaneous_effects_max is None:
            return None
        most = 0
        for attempt in range(2):
            if attempt:
                time.sleep(AGAIN_S)
            try:
                answer = _feature(device, pool.report_id, pool.report_bytes, "PID Pool")
                most = _number_in(answer, pool.simultaneous_effects_max, "PID Pool", device)
            except DeviceError as error:
                _warn(f"{error}; PID Block Load decides how many effects there are")
                return None
            if most > 1:
                break
        return most if most > 0 else None

    def _set_up(self, device: Device, way: Way, most: int | None) -> Plan:
        plan = self._constant(device, way)
        problem = periodic_problem(self._layout, self._hid)
        if problem is not None:
            return replace(plan, no_periodic=problem)
        try:
            return self._with_periodic(device, plan, most)
        except DeviceError as error:
            # They are worth something, the constant ones are needed; one of those may have been lost.
            _undo(self._layout, device, self._indices)
            _log.warning("%s; no effects are played by the device", error)
            self._prepare(device)
            return replace(self._constant(device, way), no_periodic=str(error))

    def _constant(self, device: Device, way: Way) -> Plan:
        """The constant forces, made and started, and their plan."""
        layout, indices = self._layout, list[int]()
        try:
            for effect in effects_of(way, self._hid):
                index = self._create(device)
                if index in indices:
                    raise DeviceError(f"{device.path}: PID Block Load gives effect {index} twice")
                indices.append(index)
                device.write(set_effect_report(layout, self._hid, index, effect if way != "polar" else None))
                device.write(constant_force_report(layout, index).at_rest())
                device.write(operation_report(layout, index, "start").data)
        except DeviceError:
            _undo(layout, device, indices)
            raise
        self._indices = list(indices)
        return plan_of(layout, self._hid, way, indices)

    def _with_periodic(self, device: Device, plan: Plan, room: int | None) -> Plan:
        """The plan, and what periodic effects there is room for beside the constant ones."""
        layout, problem = self._layout, "the device has no room for another effect"
        constant, made = len(self._indices), list[int]()
        try:
            while len(made) < min(lib.HD_DEVICE_EFFECTS, (room or constant + lib.HD_DEVICE_EFFECTS) - constant):
                index = self._create(device, "sine")
                if index in self._indices:
                    raise DeviceError(f"{device.path}: PID Block Load gives effect {index} twice")
                made.append(index)
                self._indices.append(index)
        except _FullError:
            pass  # as many as there are
        except _RefusedError:
            problem = "the device refuses to make such an effect"
        if not made:
            return replace(plan, no_periodic=problem)
        periodic = periodic_of(layout, self._hid, made)
        frees = tuple(
            message for message in (block_free_report(layout, index) for index in made) if message is not None
        )
        stops = () if control_report(layout, "stop_all_effects") else tuple(block.stop for block in periodic.blocks)
        # Last of all: an effect that is not freed costs room, no force.
        return replace(plan, stop=(*stops, *plan.stop, *frees), periodic=periodic)

    def _create(self, device: Device, kind: str = "constant_force") -> int:
        """A new effect; its block index."""
        create, load = self._layout.create_new_effect, self._layout.block_load
        assert create is not None and load is not None
        report = ReportWriter(create)
        report.choose(create.effect_type, kind)
        device.send_feature(bytes(report.data))
        for _ in range(LOAD_TRIES):
            answer = _feature(device, load.report_id, load.report_bytes, "PID Block Load")
            status = _load_status(load, answer, device)
            if status == "success":
                index = _number_in(answer, load.effect_index, "PID Block Load", device)
                first, last = self._layout.effect_indices or (1, 0)
                if not first <= index <= last:
                    raise DeviceError(
                        f"{device.path}: PID Block Load gives effect {index}, not one of {first} to {last}"
                    )
                return index
            if status == "full":
                raise _FullError(f"{device.path}: PID Block Load says that there is no room for another effect")
            if status == "error":
                raise _RefusedError(f"{device.path}: PID Block Load says that the effect is refused")
            time.sleep(LOAD_PAUSE_S)
        raise DeviceError(f"{device.path}: PID Block Load does not say that the effect is loaded")


def _undo(layout: Layout, device: Device, indices: Sequence[int]) -> None:
    """Ends a set-up that failed half way, as far as the device still takes it: what it has room for is free again."""
    with suppress(DeviceError):
        for message in stop_messages(layout, indices):
            device.write(message.data)


def _send(device: Device, report: bytes | None) -> None:
    if report is not None:
        device.write(report)


def _load_status(load: BlockLoad, answer: bytes, device: Device) -> str | None:
    """success, full or error; None: not yet known."""
    if load.status is None:
        return "success" if _number_in(answer, load.effect_index, "PID Block Load", device) else "full"
    for name, entry in load.status.entries.items():
        if _number_in(answer, entry.field, "PID Block Load", device) == entry.value:
            return name
    return None


def _warn(text: str) -> None:
    """Once, and as a count for a device that is found again and again."""
    _repeats.line(text, logging.WARNING, text)


def _feature(device: Device, report_id: int, report_bytes: int, name: str) -> bytes:
    """The answer to a feature report, its id first. Raises DeviceError where it is another report."""
    answer = device.get_feature(report_id, report_bytes + (report_id == 0))
    if answer[:1] != bytes([report_id]):
        other = f"report {answer[0]}" if answer else "nothing"
        raise DeviceError(f"{device.path}: asked for {name}, report {report_id}, the device answers {other}")
    return answer


def _number_in(answer: bytes, field: Field, name: str, device: Device) -> int:
    """A number of a report, its id first. Raises DeviceError for a report that ends before it."""
    try:
        return bits_of(field).get(answer)
    except ValueError:
        raise DeviceError(f"{device.path}: {name} is too short: {len(answer)} bytes") from None
