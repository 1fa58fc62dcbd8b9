"""Periodic effects that a device of the PID class plays by itself: whether it has them, and their reports."""

from __future__ import annotations

from collections.abc import Sequence

from hapticd.config.hid import Hid
from hapticd.hid.descriptor.layout import Layout
from hapticd.hid.drivers.pid_directions import angle_of, has_one_axis
from hapticd.hid.drivers.pid_reports import (
    Report,
    envelope_report,
    level_scale,
    operation_report,
    polar_effect_report,
    shared_report,
    time_scale,
)
from hapticd.hid.plan import Numbers, Periodic, PeriodicBlock


def periodic_problem(layout: Layout, hid: Hid) -> str | None:
    """Why there are no periodic effects, short; None: the descriptor has all of it, and they are wanted."""
    effect, create = layout.set_effect, layout.create_new_effect
    assert effect is not None and create is not None
    if hid.offload == "off":
        return "device.hid.offload is off"
    reports = {"Set Periodic": layout.set_periodic, "Set Envelope": layout.set_envelope}
    absent = [name for name, report in reports.items() if report is None]
    if not {"sine"} <= effect.effect_type.entries.keys() & create.effect_type.entries.keys():
        absent.append("ET Sine")
    if angle_of(effect) is None or has_one_axis(layout, hid):
        absent.append("Direction of two axes")
    if absent:
        return f"the device has no {', no '.join(absent)}"
    shared = shared_report(layout, with_periodic=True)
    if shared is not None:
        return shared
    assert layout.set_periodic is not None and layout.set_envelope is not None
    lines = layout.set_envelope
    if min(level.logical_max for level in (layout.set_periodic.magnitude, lines.attack_level, lines.fade_level)) <= 0:
        return "the device has no levels above zero"
    first, last = layout.effect_indices or (1, 0)
    indices = (layout.set_periodic.effect_index, lines.effect_index)
    if any(index.logical_min > first or index.logical_max < last for index in indices):
        return "Set Periodic or Set Envelope does not take every Effect Block Index"
    if "infinite_duration" in hid.quirks:
        return "the device ignores finite durations"
    return None


def periodic_of(layout: Layout, hid: Hid, indices: Sequence[int]) -> Periodic:
    """Periodic effects that were made; the layout has all that they need."""
    effect, periodic, envelope = layout.set_effect, layout.set_periodic, layout.set_envelope
    assert effect is not None and periodic is not None and envelope is not None
    numbers = Numbers(
        duration=time_scale(effect.duration),
        attack_time=time_scale(envelope.attack_time),
        fade_time=time_scale(envelope.fade_time),
        period=time_scale(periodic.period),
        magnitude=level_scale(periodic.magnitude, hid),
        attack_level=level_scale(envelope.attack_level, hid),
        fade_level=level_scale(envelope.fade_level, hid),
    )
    return Periodic(numbers, tuple(_periodic_block(layout, hid, index) for index in indices))


def _periodic_block(layout: Layout, hid: Hid, index: int) -> PeriodicBlock:
    periodic, envelope = layout.set_periodic, layout.set_envelope
    assert periodic is not None and envelope is not None
    shape = Report(periodic.report_id, periodic.report_bytes)
    shape.put(periodic.effect_index, index)
    for rest in (periodic.magnitude, periodic.offset, periodic.phase):
        shape.put(rest, 0)
    return PeriodicBlock(
        polar_effect_report(layout, hid, index, "sine"),
        envelope_report(envelope, index),
        bytes(shape.data),
        operation_report(layout, index, "start"),
        operation_report(layout, index, "stop"),
    )
