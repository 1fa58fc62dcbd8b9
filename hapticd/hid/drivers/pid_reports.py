"""Encodes the reports for a device of the PID class, from the layout of its descriptor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from hapticd.base.core import HidQuantity
from hapticd.config.hid import ForceAxes, HandleAxes, Hid
from hapticd.hid.descriptor.fields import Choice, Field, duration_fault
from hapticd.hid.descriptor.layout import Layout, Report, SetEffect, SetEnvelope
from hapticd.hid.plan import Bits, DeviceError, Message, Scale, Value

_MIN_DIRECTION_SINE: Final = 0.5
"""Smallest sine of the angle between the two effects' directions at which `force_factors` corrects their rounding."""


# ---- Directions ------------------------------------------------------------------------------------------------------


def angle_of(effect: SetEffect) -> Field | None:
    """Return the field for the angle of an effect's direction; None if the report has no direction, or a vector."""
    return None if effect.is_direction_cartesian or not effect.direction else effect.direction[0]


def has_vector(effect: SetEffect) -> bool:
    """Return whether the direction is a vector with components along at least two axes."""
    return effect.is_direction_cartesian and len(effect.direction) >= 2


def has_one_axis(layout: Layout, hid: Hid) -> bool:
    """Return whether the device exerts forces along one axis only, for example a wheel."""
    assert layout.set_effect is not None
    no_y = hid.axes.y.usage == "Y" and "y" not in layout.input
    return no_y or len(layout.input) == 1 or len(layout.set_effect.axes_enable) == 1


def enabled_for(effect: SetEffect, axes: HandleAxes, axis: Literal["x", "y"]) -> str:
    """Return the axis in Axes Enable for a force along the device's first (x) or second axis (y).

    The two axes are X and Y if the device has both, else those of the handle (`axes`), else the axes in the order of
    the report. A device with one axis always gets that axis.
    """
    known = effect.axes_enable
    handle = (axes.x.usage.lower(), axes.y.usage.lower())
    names = next(names for names in (("x", "y"), handle, tuple(known)) if known.keys() >= set(names))
    return names[min("xy".index(axis), len(names) - 1)]


def counts_of(angle: Field, turns: float) -> float:
    """Return the counts of a direction in turns, from the field's minimum to less than one turn above the minimum."""
    per_turn = angle.counts_per_turn()
    if per_turn <= 0.0:
        return angle.logical_min
    return angle.logical_min + (angle.counts_at_north() + per_turn * turns - angle.logical_min) % per_turn


def direction_transform(axes: ForceAxes) -> tuple[int, float]:
    """Return slope and offset: a force of direction d, in turns, is sent with the direction slope * d + offset.

    A direction is an angle from +y towards +x. A negative sign of x maps d to -d, a negative sign of y maps d to
    1/2 - d, and swapped axes map d to 1/4 - d. The swap is applied first.
    """
    slope, offset = (-1, 0.25) if axes.swap else (1, 0.0)
    if axes.x.sign < 0:
        slope, offset = -slope, -offset
    if axes.y.sign < 0:
        slope, offset = -slope, 0.5 - offset
    return slope, offset


def force_factors(angle: Field, x_turns: float, y_turns: float) -> list[tuple[float, float]]:
    """Return two factors for the effect along x, then two for that along y, so that the effects add up to the force.

    The magnitude of an effect is the first factor times the force along its axis, plus the second factor times the
    force along the other axis. The factors correct the rounding of the directions `x_turns` and `y_turns`: with 255
    counts per turn, no count is a right angle, and an effect for one axis pushes along the other with up to 1.2 % of
    its force.
    """
    x_x, x_y = _push_vector(angle, x_turns)
    y_x, y_y = _push_vector(angle, y_turns)
    area = x_x * y_y - x_y * y_x
    if area < _MIN_DIRECTION_SINE:
        return [(1.0, 0.0)] * 2
    return [(y_y / area, -y_x / area), (x_x / area, -x_y / area)]


def leak_share(angle: Field) -> float:
    """Return the fraction of a force that acts at right angles to the force, if its direction is half a count off."""
    per_turn = angle.counts_per_turn()
    return math.sin(math.pi / per_turn) if per_turn > 2.0 else 1.0


def _push_vector(angle: Field, turns: float) -> tuple[float, float]:
    """Return the unit vector of the force that comes from a direction, after the direction is rounded to counts."""
    per_turn = angle.counts_per_turn()
    if per_turn > 0.0:
        counts = min(max(round(counts_of(angle, turns)), angle.logical_min), angle.logical_max)
        turns = (counts - angle.counts_at_north()) / per_turn
    return -math.sin(2.0 * math.pi * turns), -math.cos(2.0 * math.pi * turns)


# ---- Reports ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Effect:
    """A constant-force effect: its axis, the direction it pushes from in turns, and what determines its magnitude."""

    axis: Literal["x", "y"]
    from_turns: float
    quantity: HidQuantity
    sign: int
    needs_angle: bool = False
    """Whether the direction must be an angle: without signed magnitudes, an enabled axis does not define it."""


class ReportWriter:
    """Writes a report field by field into `data`, its id first."""

    def __init__(self, fields: Report) -> None:
        """Begin a report with the id and the length of `fields`, filled with zeros."""
        self.data = bytearray(fields.report_bytes + (fields.report_id == 0))
        self.data[0] = fields.report_id

    def put(self, field: Field | None, counts: float) -> None:
        """Write counts, rounded and limited to the field's range; does nothing without a field."""
        if field is not None:
            bits_of(field).put(self.data, min(max(round(counts), field.logical_min), field.logical_max))

    def flag(self, field: Field | None, is_on: bool = True) -> None:
        """Set or clear a flag, even if its range is invalid; does nothing without a field."""
        if field is not None:
            bits_of(field).put(self.data, (field.counts_when_on() or 0) if is_on else 0)

    def fill(self, field: Field | None) -> None:
        """Write a one into every bit, which means "none" or "infinite"; does nothing without a field."""
        if field is not None:
            Bits(field.bit_offset, field.bit_size, False).put(self.data, (1 << field.bit_size) - 1)

    def choose(self, choice: Choice, name: str) -> None:
        """Select an entry of a choice by its name."""
        entry = choice.entries[name]
        bits_of(entry.field).put(self.data, entry.value)


def set_effect_report(
    layout: Layout, hid: Hid, index: int, effect: Effect | None, kind: str = "constant_force"
) -> bytes:
    """Return the report Set Effect, without a direction if `effect` is None. `kind` is a key of EFFECT_TYPE_USAGES."""
    fields = layout.set_effect
    assert fields is not None
    report = ReportWriter(fields)
    report.put(fields.effect_index, index)
    report.choose(fields.effect_type, kind)
    if "infinite_duration" in hid.quirks:
        report.fill(fields.duration)
    else:
        report.put(fields.duration, duration_of(layout, hid)[0])
    for absent in (fields.trigger_repeat_interval, fields.sample_period, fields.start_delay):
        report.put(absent, 0)
    if fields.gain is not None:
        report.put(fields.gain, fields.gain.logical_max)
    report.fill(fields.trigger_button)
    _put_direction(report, fields, hid, effect)
    return bytes(report.data)


def _put_direction(report: ReportWriter, fields: SetEffect, hid: Hid, effect: Effect | None) -> None:
    """Write the direction of an effect: as an angle if the device accepts it, else as the enabled axes."""
    angle, by_angle = angle_of(fields), is_by_angle(fields, effect)
    if by_angle:
        report.flag(fields.direction_enable)
        if effect is not None:
            assert angle is not None
            report.put(angle, counts_of(angle, effect.from_turns))
    elif angle is not None and effect is not None:
        # Without Direction Enable there is one direction for each axis. Firmware that uses it as a factor exerts no
        # force along x if it is 0.
        for field in fields.direction:
            report.put(field, counts_of(field, effect.from_turns))
    elif fields.is_direction_cartesian and effect is not None:
        for name, field in zip(("x", "y"), fields.direction, strict=False):
            report.put(field, field.logical_max if name == effect.axis else 0)
        report.flag(fields.direction_enable, not fields.axes_enable)
    if not by_angle or fields.direction_enable is None:
        for name, field in fields.axes_enable.items():
            report.flag(field, effect is None or name == enabled_for(fields, hid.axes, effect.axis))


def is_by_angle(fields: SetEffect, effect: Effect | None) -> bool:
    """Return whether an effect's direction is an angle, rather than the enabled axes."""
    needed = effect is None or effect.needs_angle
    return angle_of(fields) is not None and (fields.direction_enable is not None or not fields.axes_enable or needed)


def duration_of(layout: Layout, hid: Hid) -> tuple[int, float]:
    """Return the duration of an effect in counts, and in s as the device interprets these counts.

    With the quirk infinite_duration, the time is the configured one. Raises DeviceError if no duration is suitable.
    """
    assert layout.set_effect is not None
    field = layout.set_effect.duration
    if "infinite_duration" in hid.quirks:
        return field.logical_max, hid.effect_duration_s
    scale = time_scale(field)
    counts = min(max(scale.counts(hid.effect_duration_s), 1), field.logical_max)
    duration_s = scale.quantity(counts)
    fault = duration_fault(field, scale.resolution, duration_s, hid.effect_duration_s)
    if fault is not None:
        raise DeviceError(fault)
    return counts, duration_s


def operation_report(layout: Layout, index: int, name: str) -> Message:
    """Return the report Effect Operation; `name` is a key of OPERATION_USAGES."""
    fields = layout.effect_operation
    assert fields is not None
    report = ReportWriter(fields)
    report.put(fields.effect_index, index)
    report.choose(fields.operation, name)
    report.put(fields.loop_count, 1)
    return Message(bytes(report.data))


def block_free_report(layout: Layout, index: int) -> Message | None:
    """Return the report PID Block Free; None if the device has no such report, or the report cannot hold this index."""
    fields = layout.block_free
    if fields is None or not fields.effect_index.logical_min <= index <= fields.effect_index.logical_max:
        return None
    report = ReportWriter(fields)
    report.put(fields.effect_index, index)
    return Message(bytes(report.data))


def control_report(layout: Layout, name: str) -> bytes | None:
    """Return the report Device Control with a command; None if the device lacks the command."""
    fields = layout.device_control
    assert fields is not None
    if name not in fields.command.entries:
        return None
    report = ReportWriter(fields)
    report.choose(fields.command, name)
    return bytes(report.data)


def gain_report(layout: Layout, hid: Hid) -> bytes | None:
    """Return the report Device Gain with the largest gain; None if the device lacks or refuses the report."""
    fields = layout.device_gain
    if fields is None or "no_device_gain" in hid.quirks:
        return None
    report = ReportWriter(fields)
    report.put(fields.gain, fields.gain.logical_max)
    return bytes(report.data)


def constant_force_report(
    layout: Layout,
    index: int,
    effect: Effect | None = None,
    hid: Hid | None = None,
    factors: tuple[float, float] = (1.0, 0.0),
) -> Message:
    """Return the report Set Constant Force for an effect; if `effect` is None, for a force of zero.

    The two `factors`, described at `force_factors`, determine the magnitude.
    """
    force = layout.constant_force
    assert force is not None
    field = force.magnitude
    report = ReportWriter(force)
    report.put(force.effect_index, index)
    report.put(field, 0)
    if effect is None or hid is None:
        return Message(bytes(report.data))
    scale = level_scale(field, hid)
    low = max(field.logical_min, -field.logical_max) if field.is_signed else scale.zero_counts
    along, other = (effect.sign * scale.counts_per_unit * factor for factor in factors)
    value = Value(scale.bits, effect.quantity, along, scale.zero_counts, low, field.logical_max, other)
    return Message(bytes(report.data), (value,))


def polar_effect_report(layout: Layout, hid: Hid, index: int, kind: str = "constant_force") -> Message:
    """Return the report Set Effect for an effect of this kind; the direction is filled in later, for each force."""
    assert layout.set_effect is not None
    field = angle_of(layout.set_effect)
    assert field is not None
    per_turn = field.counts_per_turn()
    slope, turns = direction_transform(hid.force_axes)
    # Within one turn above the minimum, so that C has to add or subtract at most one turn.
    zero = counts_of(field, turns)
    value = Value(
        bits_of(field),
        HidQuantity.DIRECTION,
        slope * per_turn / (2.0 * math.pi),
        zero,
        field.logical_min,
        field.logical_max,
    )
    return Message(set_effect_report(layout, hid, index, None, kind), (value,))


def envelope_report(fields: SetEnvelope, index: int) -> bytes:
    """Return the report Set Envelope for an effect, with times and levels of zero."""
    report = ReportWriter(fields)
    report.put(fields.effect_index, index)
    return bytes(report.data)


def shared_report_problem(layout: Layout, *, with_periodic: bool = False) -> str | None:
    """Return the error text if output reports share an id, so that sending one sets the others to zero; else None.

    `with_periodic` includes the report Set Periodic.
    """
    sent = {
        "Set Effect": layout.set_effect,
        "Set Constant Force": layout.constant_force,
        "Effect Operation": layout.effect_operation,
        "Device Control": layout.device_control,
        "Device Gain": layout.device_gain,
        "PID Block Free": layout.block_free,
        "Set Envelope": layout.set_envelope,
        "Set Periodic": layout.set_periodic if with_periodic else None,
    }
    by_id: dict[int, list[str]] = {}
    for name, report in sent.items():
        if report is not None:
            by_id.setdefault(report.report_id, []).append(name)
    for number, names in by_id.items():
        if len(names) > 1:
            which = f"output report {number}" if number else "the one output report, which has no id"
            return f"{', '.join(names[:-1])} and {names[-1]} are {which}: sending one would set the others to zero"
    return None


def time_scale(field: Field) -> Scale:
    """Return the scale of a field for times in s. Without a unit, a count is 1 ms, as in the specification."""
    step_s = field.seconds_per_count()
    zero = 0.0 if step_s is None else field.logical_min - field.physical_min * 10.0**field.unit_exponent / step_s
    return Scale(bits_of(field), 1.0 / (step_s or 1e-3), zero, field.logical_min, field.logical_max)


def level_scale(field: Field, hid: Hid) -> Scale:
    """Return the scale of a field for levels in N, whose largest count is the device's full force."""
    zero = min(max(0, field.logical_min), field.logical_max)
    return Scale(
        bits_of(field), (field.logical_max - zero) / hid.full_scale_force_n, zero, field.logical_min, field.logical_max
    )


def bits_of(field: Field) -> Bits:
    """Return the place of a field in its report: its offset, its size, and whether it is signed."""
    return Bits(field.bit_offset, field.bit_size, field.is_signed)
