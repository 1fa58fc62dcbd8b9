"""Plan of a device of the PID class, made from the layout of its descriptor.

A force is exerted by constant-force effects, in one of these schemes:

- Two effects, one for each axis, with signed magnitudes. If the force along one axis does not change, the report of its
  effect is not sent, unless the directions are not exactly along the axes (`pid_reports.force_factors`).
- One effect, for which magnitude and direction are sent: if magnitudes have no sign, or the device has room for one
  effect only.

Effects have a finite duration and are renewed in time, so that a daemon that is stopped or killed leaves no force. A
direction is where a force comes from, clockwise from "north", which is away from the user, as in the specification and
in Linux; `device.hid.force_axes` describes devices that deviate from this.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, Literal

from hapticd.base.core import HidMeaning, HidQuantity
from hapticd.config.hid import HandleAxis, Hid
from hapticd.hid.descriptor.fields import MIN_AXIS_COUNTS
from hapticd.hid.descriptor.layout import Axis, Layout
from hapticd.hid.drivers.pid_reports import (
    Effect,
    ReportWriter,
    angle_of,
    bits_of,
    block_free_report,
    constant_force_report,
    control_report,
    duration_of,
    envelope_report,
    force_factors,
    gain_report,
    has_one_axis,
    has_vector,
    is_by_angle,
    leak_share,
    level_scale,
    operation_report,
    polar_effect_report,
    set_effect_report,
    shared_report_problem,
    time_scale,
)
from hapticd.hid.plan import (
    STILL_AXIS_M_PER_COUNT,
    AxisPlan,
    DeviceError,
    Message,
    Periodic,
    PeriodicBlock,
    PeriodicScales,
    Plan,
    PlayingBits,
    StateBit,
)

MAX_RENEW_WITHOUT_RESTORE_S: Final = 0.05
"""If effects are renewed at this interval or a shorter one, `Plan.restore` omits the messages that renewals contain."""

Scheme = Literal["two", "polar", "one", "sides"]
"""The effects that exert a force. On a device with two axes: "two", one for each axis, or "polar", one effect with a
direction. On a device with one axis: "one", one effect, or "sides", one for each direction."""


# ---- Schemes and axes ------------------------------------------------------------------------------------------------


def schemes_of(layout: Layout, hid: Hid) -> tuple[Scheme, ...]:
    """Return the schemes in which the device can exert a force, the best first. Raises DeviceError if there is none."""
    effect, force = layout.set_effect, layout.constant_force
    assert effect is not None and force is not None
    shared = shared_report_problem(layout)
    if shared is not None:
        raise DeviceError(shared)
    angle, signed = angle_of(effect), force.magnitude.is_signed
    if not signed and force.magnitude.physical_min < 0 < force.magnitude.physical_max:
        raise DeviceError(
            f"the magnitude of Set Constant Force counts from {force.magnitude.logical_min}, and its physical range "
            "begins below zero: the count for a force of zero is not clear"
        )
    room = layout.effect_indices is None or layout.effect_indices[1] > layout.effect_indices[0]
    room = room and "one_effect" not in hid.quirks
    both = len(effect.axes_enable) >= 2 or has_vector(effect)
    if has_one_axis(layout, hid):
        if signed:
            return ("one",)
        if angle is not None and room:
            return ("sides",)
        raise DeviceError("the device has magnitudes without a sign, and no field for the direction of a force")
    schemes: list[Scheme] = []
    if signed and room and (angle is not None or both):
        schemes.append("two")
    if angle is not None:
        schemes.append("polar")
    if not schemes:
        if not both:
            lacks = "and neither Direction nor Axes Enable to distinguish them in a force"
        elif signed:
            lacks = "room for one effect, and no angle for the direction of a force"
        else:
            lacks = "magnitudes without a sign, and no angle for the direction of a force"
        raise DeviceError(f"the device has two axes, {lacks}")
    return tuple(schemes)


def axes_of(layout: Layout, hid: Hid) -> tuple[AxisPlan, AxisPlan]:
    """Return the position fields of the handle's axes x and y. Raises DeviceError if the device lacks one of them."""
    x = _axis(layout, hid.axes.x, "x", hid)
    if has_one_axis(layout, hid) and hid.axes.y.usage.lower() not in layout.input and hid.axes.y.counts is None:
        return x, AxisPlan(x.bits, x.report_id, x.zero_counts, (STILL_AXIS_M_PER_COUNT,) * 2)
    return x, _axis(layout, hid.axes.y, "y", hid)


def _axis(layout: Layout, axis: HandleAxis, name: str, hid: Hid) -> AxisPlan:
    found: Axis | None = layout.input.get(axis.usage.lower())
    if found is None:
        known = ", ".join(usage.capitalize() for usage in layout.input)
        raise DeviceError(f"device.hid.axes.{name}.usage: the device has no axis {axis.usage}; it has {known}")
    field = found.field
    first, last = field.logical_min, field.logical_max
    low, middle, high = axis.counts or (first, (first + last) / 2.0, last)
    if axis.counts and (low < first or high > last or min(middle - low, high - middle) < MIN_AXIS_COUNTS // 2):
        raise DeviceError(
            f"device.hid.axes.{name}.counts: must lie within {first} to {last}, the range of the device's axis "
            f"{axis.usage}, with at least {MIN_AXIS_COUNTS // 2} on each side of the middle, are {list(axis.counts)}"
        )
    travel_m = axis.sign * hid.travel_m
    return AxisPlan(bits_of(field), field.report_id, middle, (travel_m / (middle - low), travel_m / (high - middle)))


def effects_of(scheme: Scheme, hid: Hid) -> tuple[Effect, ...]:
    """Return the effects that exert a force in this scheme."""
    axes, swap = hid.force_axes, hid.force_axes.swap
    along_x, along_y = (HidQuantity.Y, HidQuantity.X) if swap else (HidQuantity.X, HidQuantity.Y)
    # A force to the right comes from the left, one away from the user from the user.
    right, away = 0.75, 0.5
    match scheme:
        case "two":
            return (Effect("x", right, along_x, axes.x.sign), Effect("y", away, along_y, axes.y.sign))
        case "polar":
            return (Effect("x", 0.0, HidQuantity.MAGNITUDE, 1),)
        case "one":
            return (Effect("x", right, HidQuantity.X, axes.x.sign),)
        case "sides":
            sign = axes.x.sign
            return (Effect("x", right, HidQuantity.X, sign, True), Effect("x", 1 - right, HidQuantity.X, -sign, True))


# ---- The plan --------------------------------------------------------------------------------------------------------


def plan_of(layout: Layout, hid: Hid, scheme: Scheme, indices: Sequence[int]) -> Plan:
    """Return the plan for the effects of a scheme, which the device created under these Effect Block Indices."""
    x, y = axes_of(layout, hid)
    effects = effects_of(scheme, hid)
    # The direction is sent before the magnitude, so that a new magnitude never acts along the old direction.
    force = [polar_effect_report(layout, hid, indices[0])] if scheme == "polar" else []
    for effect, index, factors in zip(effects, indices, _force_factors(layout, effects), strict=True):
        force.append(constant_force_report(layout, index, effect, hid, factors))
    infinite = "infinite_duration" in hid.quirks
    _, duration_s = duration_of(layout, hid)
    renew_s = hid.renew_s if infinite else min(hid.renew_s, 0.5 * duration_s)
    watched = _playing_bits(layout, indices, math.ceil(duration_s / renew_s) + 2)
    return Plan(
        x=x,
        y=y,
        force=tuple(force),
        renew=tuple(operation_report(layout, index, "start") for index in indices),
        restore=tuple(_restore_messages(layout, hid, scheme, indices, renew_s)),
        stop=stop_messages(layout, indices),
        # Most devices report that an effect plays when it starts. The set-up started it before reports were read, so
        # the effects are stopped once; the first renewal starts them again at once.
        begin=tuple(operation_report(layout, index, "stop") for index in indices) if watched else (),
        effects=watched,
        states=_state_bits(layout),
        renew_s=renew_s,
        foreign_effect_s=renew_s if renew_s <= MAX_RENEW_WITHOUT_RESTORE_S else 0.0,
        write_interval_s=0.0 if hid.max_rate_hz is None else 1.0 / (hid.max_rate_hz * len(force)),
        leak=_leak_of(layout) if scheme == "polar" else 0.0,
    )


def _force_factors(layout: Layout, effects: Sequence[Effect]) -> list[tuple[float, float]]:
    """Return two factors for each effect: magnitude per force along its axis, and per force along the other axis."""
    set_effect = layout.set_effect
    assert set_effect is not None
    angle = angle_of(set_effect)
    straight = [(1.0, 0.0)] * len(effects)
    if (
        len({effect.axis for effect in effects}) < 2
        or angle is None
        or not all(is_by_angle(set_effect, one) for one in effects)
    ):
        return straight
    sign = effects[0].sign * effects[1].sign
    shown = force_factors(angle, effects[0].from_turns, effects[1].from_turns)
    return [(along, other * sign) for along, other in shown]


def _leak_of(layout: Layout) -> float:
    assert layout.set_effect is not None
    angle = angle_of(layout.set_effect)
    return 0.0 if angle is None else leak_share(angle)


def _restore_messages(
    layout: Layout, hid: Hid, scheme: Scheme, indices: Sequence[int], renew_s: float
) -> Iterator[Message]:
    """Yield the messages that restore effects after a change by another program, unless renewals suffice for that."""
    effects = effects_of(scheme, hid)
    for effect, index, factors in zip(effects, indices, _force_factors(layout, effects), strict=True):
        if scheme != "polar":
            yield Message(set_effect_report(layout, hid, index, effect))
        elif renew_s > MAX_RENEW_WITHOUT_RESTORE_S:
            yield polar_effect_report(layout, hid, index)
        if layout.set_envelope is not None:
            yield Message(envelope_report(layout.set_envelope, index))
        if renew_s > MAX_RENEW_WITHOUT_RESTORE_S:
            yield constant_force_report(layout, index, effect, hid, factors)
            yield operation_report(layout, index, "start")
    gain = gain_report(layout, hid)
    if gain is not None:
        yield Message(gain)


def stop_messages(layout: Layout, indices: Sequence[int]) -> tuple[Message, ...]:
    """Return the messages that stop and free these effects, and disable the actuators."""
    control = [control_report(layout, name) for name in ("stop_all_effects", "disable_actuators")]
    stop = [
        *(operation_report(layout, index, "stop") for index in indices),
        *(block_free_report(layout, index) for index in indices),
        *(Message(data) for data in control if data),
    ]
    return tuple(message for message in stop if message is not None)


def _state_bits(layout: Layout) -> tuple[StateBit, ...]:
    state = layout.pid_state
    if state is None:
        return ()
    states = (
        (state.device_reset, HidMeaning.RESET),
        (state.actuators_enabled, HidMeaning.ACTUATORS),
        (state.device_paused, HidMeaning.PAUSED),
        (state.safety_switch, HidMeaning.SAFETY),
        (state.actuator_power, HidMeaning.POWER),
    )
    return tuple(StateBit(bits_of(field), field.report_id, meaning) for field, meaning in states if field is not None)


def _playing_bits(layout: Layout, indices: Sequence[int], proof: int) -> PlayingBits | None:
    """Return the fields of PID State that report which effects play; None without them, or if an index does not fit."""
    state = layout.pid_state
    if state is None or state.effect_index is None or state.effect_playing is None:
        return None
    index, playing = state.effect_index, state.effect_playing
    if not all(index.logical_min <= ours <= index.logical_max for ours in indices):
        return None
    return PlayingBits(bits_of(index), bits_of(playing), state.report_id, tuple(indices), proof)


# ---- Periodic effects, played in place of modes ----------------------------------------------------------------------


def periodic_problem(layout: Layout, hid: Hid) -> str | None:
    """Return why periodic effects are not used; None if they are configured and the descriptor has their reports."""
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
    shared = shared_report_problem(layout, with_periodic=True)
    if shared is not None:
        return shared
    assert layout.set_periodic is not None and layout.set_envelope is not None
    lines = layout.set_envelope
    if min(level.logical_max for level in (layout.set_periodic.magnitude, lines.attack_level, lines.fade_level)) <= 0:
        return "the device has no levels above zero"
    first, last = layout.effect_indices or (1, 0)
    indices = (layout.set_periodic.effect_index, lines.effect_index)
    if any(index.logical_min > first or index.logical_max < last for index in indices):
        return "Set Periodic or Set Envelope cannot hold every Effect Block Index"
    if "infinite_duration" in hid.quirks:
        return "the device ignores finite durations"
    return None


def periodic_of(layout: Layout, hid: Hid, indices: Sequence[int]) -> Periodic:
    """Return the reports of the periodic effects with these indices; `periodic_problem` must have returned None."""
    effect, periodic, envelope = layout.set_effect, layout.set_periodic, layout.set_envelope
    assert effect is not None and periodic is not None and envelope is not None
    scales = PeriodicScales(
        duration=time_scale(effect.duration),
        attack_time=time_scale(envelope.attack_time),
        fade_time=time_scale(envelope.fade_time),
        period=time_scale(periodic.period),
        magnitude=level_scale(periodic.magnitude, hid),
        attack_level=level_scale(envelope.attack_level, hid),
        fade_level=level_scale(envelope.fade_level, hid),
    )
    return Periodic(scales, tuple(_periodic_block(layout, hid, index) for index in indices))


def _periodic_block(layout: Layout, hid: Hid, index: int) -> PeriodicBlock:
    periodic, envelope = layout.set_periodic, layout.set_envelope
    assert periodic is not None and envelope is not None
    shape = ReportWriter(periodic)
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
