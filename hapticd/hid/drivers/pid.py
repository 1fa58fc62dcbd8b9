"""Set-up of devices of the PID class. pid_plan.py plans what is sent after a set-up, pid_reports.py encodes reports.

A set-up resets the device, enables its actuators, sets its gain, creates the effects, and starts them with a force of
zero.

The feature report PID Pool contains how many effects the device plays at a time. It is read once in a set-up, after the
reset and before the first effect is created, because some firmware frees every effect when it is read. It is optional:
without it, PID Block Load shows whether there is room for an effect.
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
    Scheme,
    axes_of,
    effects_of,
    periodic_of,
    periodic_problem,
    plan_of,
    schemes_of,
    stop_messages,
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

MAX_BLOCK_LOAD_READS: Final = 30
BLOCK_LOAD_READ_INTERVAL_S: Final = 0.01
"""While an effect is not loaded, PID Block Load is read at this interval, at most MAX_BLOCK_LOAD_READS times."""
POOL_REREAD_DELAY_S: Final = 0.05
"""If PID Pool reports 1 or 0 effects, it is read once more after this time."""

_log = logging.getLogger("hapticd")
_repeats = Repeats()


class _FullError(DeviceError):
    """Error of a device that has no room for another effect."""


class _RefusedError(DeviceError):
    """Error of a device that refuses to create an effect."""


class PidDriver:
    """Sets up a device of the PID class; `set_up` may be called repeatedly."""

    def __init__(self, layout: Layout, hid: Hid) -> None:
        """Create a driver. Raises DeviceError if the descriptor lacks what the configuration needs."""
        self._layout = layout
        self._hid = hid
        self._schemes = schemes_of(layout, hid)
        self._indices: list[int] = []
        axes_of(layout, hid)
        duration_of(layout, hid)

    def set_up(self, device: Device) -> Plan:
        """Reset and enable the device, create its effects, start them with a force of zero, and return the plan."""
        self._prepare(device)
        schemes, max_effects = self._schemes, self._effects_in_pool(device)
        needed = len(effects_of(schemes[0], self._hid))
        if max_effects is not None and max_effects < needed:
            other = "one effect with direction is used" if len(schemes) > 1 else "PID Block Load decides"
            _warn_once(f"{device.path}: plays {max_effects} effect at a time, {needed} are needed; {other}")
            schemes = schemes[1:] or schemes
        for scheme in schemes:
            try:
                return self._set_up(device, scheme, max_effects)
            except _FullError as error:
                if scheme == schemes[-1]:
                    raise
                _log.warning("%s; one effect with direction is used", error)
                self._prepare(device)
        raise AssertionError("there is always a scheme")

    def _prepare(self, device: Device) -> None:
        """Reset the device, free its effects, enable its actuators, and set its gain to the maximum."""
        layout, quirks = self._layout, self._hid.quirks
        if self._indices and ("no_reset" in quirks or control_report(layout, "device_reset") is None):
            # Without a reset, the effects of the last set-up must be freed one by one.
            _free_effects(layout, device, self._indices)
        self._indices = []
        for name in ("device_reset", "stop_all_effects", "enable_actuators"):
            if name != "device_reset" or "no_reset" not in quirks:
                _send(device, control_report(layout, name))
        _send(device, gain_report(layout, self._hid))

    def _effects_in_pool(self, device: Device) -> int | None:
        """Return how many effects the device plays at a time; None if this is not known, or if hapticd needs only one.

        This reads PID Pool, which must happen before the first effect is created.
        """
        pool = None if "no_pid_pool" in self._hid.quirks else self._layout.pool
        several = len(effects_of(self._schemes[0], self._hid)) > 1
        wanted = several or periodic_problem(self._layout, self._hid) is None
        if not wanted or pool is None or pool.simultaneous_effects_max is None:
            return None
        max_effects = 0
        for attempt in range(2):
            if attempt:
                time.sleep(POOL_REREAD_DELAY_S)
            try:
                answer = _get_feature(device, pool.report_id, pool.report_bytes, "PID Pool")
                max_effects = _number_in(answer, pool.simultaneous_effects_max, "PID Pool", device)
            except DeviceError as error:
                _warn_once(f"{error}; PID Block Load decides how many effects there are")
                return None
            if max_effects > 1:
                break
        return max_effects if max_effects > 0 else None

    def _set_up(self, device: Device, scheme: Scheme, max_effects: int | None) -> Plan:
        plan = self._create_constant_forces(device, scheme)
        problem = periodic_problem(self._layout, self._hid)
        if problem is not None:
            return replace(plan, no_periodic=problem)
        try:
            return self._add_periodic_effects(device, plan, max_effects)
        except DeviceError as error:
            # Periodic effects are optional, constant forces are required and may have been lost: create them again.
            _free_effects(self._layout, device, self._indices)
            _log.warning("%s; no effects are played by the device", error)
            self._prepare(device)
            return replace(self._create_constant_forces(device, scheme), no_periodic=str(error))

    def _create_constant_forces(self, device: Device, scheme: Scheme) -> Plan:
        """Create and start the constant-force effects of a scheme, and return the plan of their reports."""
        layout, indices = self._layout, list[int]()
        try:
            for effect in effects_of(scheme, self._hid):
                index = self._create(device, indices)
                indices.append(index)
                device.write(set_effect_report(layout, self._hid, index, effect if scheme != "polar" else None))
                device.write(constant_force_report(layout, index).at_rest())
                device.write(operation_report(layout, index, "start").data)
        except DeviceError:
            _free_effects(layout, device, indices)
            raise
        self._indices = list(indices)
        return plan_of(layout, self._hid, scheme, indices)

    def _add_periodic_effects(self, device: Device, plan: Plan, max_effects: int | None) -> Plan:
        """Create as many periodic effects as there is room for, and return the plan with them.

        `max_effects` is the result of `_effects_in_pool`.
        """
        layout, problem = self._layout, "the device has no room for another effect"
        constant, made = len(self._indices), list[int]()
        try:
            while len(made) < min(lib.HD_DEVICE_EFFECTS, (max_effects or constant + lib.HD_DEVICE_EFFECTS) - constant):
                made.append(self._create(device, self._indices, "sine"))
                self._indices.append(made[-1])
        except _FullError:
            pass  # the effects that were created are used
        except _RefusedError:
            problem = "the device refuses to create a periodic effect"
        if not made:
            return replace(plan, no_periodic=problem)
        periodic = periodic_of(layout, self._hid, made)
        frees = tuple(
            message for message in (block_free_report(layout, index) for index in made) if message is not None
        )
        stops = () if control_report(layout, "stop_all_effects") else tuple(block.stop for block in periodic.blocks)
        # Freed last, because a periodic effect that is not freed takes room but exerts no force.
        return replace(plan, stop=(*stops, *plan.stop, *frees), periodic=periodic)

    def _create(self, device: Device, taken: Sequence[int], kind: str = "constant_force") -> int:
        """Create an effect, and return its Effect Block Index. Raises DeviceError, also if the index is `taken`."""
        create, load = self._layout.create_new_effect, self._layout.block_load
        assert create is not None and load is not None
        report = ReportWriter(create)
        report.choose(create.effect_type, kind)
        device.send_feature(bytes(report.data))
        for _ in range(MAX_BLOCK_LOAD_READS):
            answer = _get_feature(device, load.report_id, load.report_bytes, "PID Block Load")
            status = _load_status(load, answer, device)
            if status == "success":
                index = _number_in(answer, load.effect_index, "PID Block Load", device)
                first, last = self._layout.effect_indices or (1, 0)
                if not first <= index <= last:
                    raise DeviceError(
                        f"{device.path}: PID Block Load: Effect Block Index must be between {first} and {last}, "
                        f"is {index}"
                    )
                if index in taken:
                    raise DeviceError(f"{device.path}: PID Block Load returns Effect Block Index {index} twice")
                return index
            if status == "full":
                raise _FullError(f"{device.path}: PID Block Load: full, no room for another effect")
            if status == "error":
                raise _RefusedError(f"{device.path}: PID Block Load: error, the effect is refused")
            time.sleep(BLOCK_LOAD_READ_INTERVAL_S)
        raise DeviceError(f"{device.path}: PID Block Load does not report that the effect is loaded")


def _free_effects(layout: Layout, device: Device, indices: Sequence[int]) -> None:
    """Stop and free effects after a failed set-up, and ignore errors of the device."""
    with suppress(DeviceError):
        for message in stop_messages(layout, indices):
            device.write(message.data)


def _send(device: Device, report: bytes | None) -> None:
    if report is not None:
        device.write(report)


def _load_status(load: BlockLoad, answer: bytes, device: Device) -> str | None:
    """Return the status in PID Block Load: "success", "full" or "error"; None if the device has not finished."""
    if load.status is None:
        return "success" if _number_in(answer, load.effect_index, "PID Block Load", device) else "full"
    for name, entry in load.status.entries.items():
        if _number_in(answer, entry.field, "PID Block Load", device) == entry.value:
            return name
    return None


def _warn_once(text: str) -> None:
    """Log a warning; if it repeats at later connections, log at growing intervals how often."""
    _repeats.line(text, logging.WARNING, text)


def _get_feature(device: Device, report_id: int, report_bytes: int, name: str) -> bytes:
    """Get a feature report, its id first. Raises DeviceError if the device returns another report."""
    answer = device.get_feature(report_id, report_bytes + (report_id == 0))
    if answer[:1] != bytes([report_id]):
        other = f"report {answer[0]}" if answer else "nothing"
        raise DeviceError(f"{device.path}: requested {name}, report {report_id}, the device returned {other}")
    return answer


def _number_in(answer: bytes, field: Field, name: str, device: Device) -> int:
    """Return the number in a field of a report (id first). Raises DeviceError if the report ends before the field."""
    try:
        return bits_of(field).get(answer)
    except ValueError:
        raise DeviceError(f"{device.path}: {name} is too short, {len(answer)} bytes") from None
