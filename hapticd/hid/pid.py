"""Devices of the PID class: set-up, and the plan of what is sent then, from the layout of their descriptor alone.

A constant force is shown by

- two effects, one for each axis, whose magnitudes carry a sign: a component that did not change costs no report, unless
  the directions are not quite along the axes (`directions.parts`); or
- one effect whose magnitude and direction are both sent, where magnitudes have no sign, or one effect is all there is.

Effects have a finite duration and are started again in time: a daemon that is stopped or killed leaves no force.
A direction is where a force comes from, clockwise from away from the user ("north"), as the specification and Linux
have it; `device.hid.force_axes` says where a device has it otherwise.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final, Literal

from hapticd.core import HidMeaning, HidQuantity, lib
from hapticd.hid.config import HandleAxis, Hid
from hapticd.hid.device import Device
from hapticd.hid.directions import angle_of, counts_of, enabled_for, has_vector, leak, mirrored, parts
from hapticd.hid.flags import number_of_on
from hapticd.hid.layout import Axis, BlockLoad, Choice, Field, Layout, SetEffect
from hapticd.hid.plan import (
    STILL_M_PER_COUNT,
    AxisPlan,
    Bits,
    DeviceError,
    Message,
    Numbers,
    Periodic,
    PeriodicBlock,
    Plan,
    PlayingBits,
    Scale,
    StateBit,
    Value,
)
from hapticd.hid.pool import Pool, number_in, read_feature
from hapticd.hid.same_report import shared_report
from hapticd.hid.useful import duration_fault

LOAD_TRIES: Final = 30
LOAD_PAUSE_S: Final = 0.01
"""A device that has not yet loaded an effect is asked again so often, after this time."""

RENEWED_ENOUGH_S: Final = 0.05
"""What is renewed so often needs no restoring."""

_log = logging.getLogger("hapticd")

Way = Literal["two", "polar", "one", "sides"]
"""two: an effect for each axis; polar: one with direction; one: a single axis; sides: that, with an effect each way."""


class _FullError(DeviceError):
    """The device has no room for another effect."""


class _RefusedError(DeviceError):
    """The device does not take an effect."""


@dataclass(frozen=True, slots=True)
class _Effect:
    """One effect: the axis it is for, where its force comes from (turns), and what its magnitude is."""

    axis: Literal["x", "y"]
    from_turns: float
    quantity: HidQuantity
    sign: int
    needs_angle: bool = False
    """An enabled axis would not say which way."""


class PidDriver:
    """Sets up one device, as often as it is asked to."""

    def __init__(self, layout: Layout, hid: Hid) -> None:
        """Raises DeviceError where the layout cannot show what is wanted."""
        self._layout = layout
        self._hid = hid
        self._ways = ways_of(layout, hid)
        self._indices: list[int] = []
        self._pool = Pool(layout, hid)
        axes_of(layout, hid)
        _duration(layout, hid)

    def set_up(self, device: Device) -> Plan:
        """Resets the device, enables it, and leaves its effects running with a force of zero."""
        self._prepare(device)
        ways, most = self._ways, self._room(device)
        needed = len(_effects(ways[0], self._hid))
        if most is not None and most < needed:
            other = "one effect with direction is used" if len(ways) > 1 else "PID Block Load decides"
            self._pool.tell(f"{device.path}: plays {most} effect at a time, {needed} are needed; {other}")
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
        if self._indices and ("no_reset" in quirks or _control(layout, "device_reset") is None):
            # Nothing else would free what the last set-up made.
            _undo(layout, device, self._indices)
        self._indices = []
        for name in ("device_reset", "stop_all_effects", "enable_actuators"):
            if name != "device_reset" or "no_reset" not in quirks:
                _send(device, _control(layout, name))
        _send(device, _gain(layout, self._hid))

    def _room(self, device: Device) -> int | None:
        """How many effects the device says that it plays, where more than one is wanted; None: not known."""
        several = len(_effects(self._ways[0], self._hid)) > 1
        wanted = several or periodic_problem(self._layout, self._hid) is None
        return self._pool.simultaneous(device) if wanted else None

    def _set_up(self, device: Device, way: Way, most: int | None) -> Plan:
        layout = self._layout
        effects = _effects(way, self._hid)
        indices: list[int] = []
        try:
            for effect in effects:
                index = self._create(device)
                if index in indices:
                    raise DeviceError(f"{device.path}: PID Block Load gives effect {index} twice")
                indices.append(index)
                device.write(set_effect_report(layout, self._hid, index, effect if way != "polar" else None))
                device.write(_constant_force(layout, index).at_rest())
                device.write(_operation(layout, index, "start").data)
        except DeviceError:
            _undo(layout, device, indices)
            raise
        self._indices = list(indices)
        plan = plan_of(layout, self._hid, way, indices)
        return self._with_periodic(device, plan, indices, most)

    def _with_periodic(self, device: Device, plan: Plan, constant: Sequence[int], room: int | None) -> Plan:
        """The plan, and what periodic effects there is room for beside the constant ones."""
        layout, hid = self._layout, self._hid
        problem = periodic_problem(layout, hid)
        if problem is not None:
            return replace(plan, no_periodic=problem)
        made: list[int] = []
        try:
            most = room or len(constant) + lib.HD_HID_OFFERS
            while len(made) < min(lib.HD_HID_OFFERS, most - len(constant)):
                index = self._create(device, "sine")
                if index in self._indices:
                    raise DeviceError(f"{device.path}: PID Block Load gives effect {index} twice")
                made.append(index)
                self._indices.append(index)
        except _FullError:
            problem = "the device has no room for another effect"  # as many as there are
        except _RefusedError:
            problem = "the device refuses to make such an effect"
        except DeviceError:
            _undo(layout, device, self._indices)
            raise
        if not made:
            return replace(plan, no_periodic=problem or "the device has no room for another effect")
        periodic = periodic_of(layout, hid, made)
        frees = tuple(message for message in (_block_free(layout, index) for index in made) if message is not None)
        stops = () if _control(layout, "stop_all_effects") else tuple(block.stop for block in periodic.blocks)
        # Last of all: an effect that is not freed costs room, no force.
        return replace(plan, stop=(*stops, *plan.stop, *frees), periodic=periodic)

    def _create(self, device: Device, kind: str = "constant_force") -> int:
        """A new effect; its block index."""
        create, load = self._layout.create_new_effect, self._layout.block_load
        assert create is not None and load is not None
        report = _Report(create.report_id, create.report_bytes)
        report.choose(create.effect_type, kind)
        device.send_feature(bytes(report.data))
        for _ in range(LOAD_TRIES):
            answer = read_feature(device, load.report_id, load.report_bytes, "PID Block Load")
            status = _load_status(load, answer, device)
            if status == "success":
                index = number_in(answer, load.effect_index, "PID Block Load", device)
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


# ---- Ways and axes ---------------------------------------------------------------------------------------------------


def ways_of(layout: Layout, hid: Hid) -> tuple[Way, ...]:
    """How a force can be shown, the best first. Raises DeviceError."""
    effect, force = layout.set_effect, layout.constant_force
    assert effect is not None and force is not None
    shared = shared_report(layout)
    if shared is not None:
        raise DeviceError(shared)
    angle, signed = angle_of(effect), force.magnitude.is_signed
    if not signed and force.magnitude.physical_min < 0 < force.magnitude.physical_max:
        raise DeviceError(
            f"the magnitude of Set Constant Force counts from {force.magnitude.logical_min}, and its physical range "
            "begins below zero: it does not say which count is no force"
        )
    room = layout.effect_indices is None or layout.effect_indices[1] > layout.effect_indices[0]
    room = room and "one_effect" not in hid.quirks
    both = len(effect.axes_enable) >= 2 or has_vector(effect)
    if _single(layout, hid):
        if signed:
            return ("one",)
        if angle is not None and room:
            return ("sides",)
        raise DeviceError("the device has magnitudes without a sign, and no way to say the direction of a force")
    ways: list[Way] = []
    if signed and room and (angle is not None or both):
        ways.append("two")
    if angle is not None:
        ways.append("polar")
    if not ways:
        if not both:
            told = "and neither Direction nor Axes Enable to tell them apart in a force"
        elif signed:
            told = "room for one effect, and no angle to say the direction of a force"
        else:
            told = "magnitudes without a sign, and no angle to say the direction of a force"
        raise DeviceError(f"the device has two axes, {told}")
    return tuple(ways)


def axes_of(layout: Layout, hid: Hid) -> tuple[AxisPlan, AxisPlan]:
    """The handle's axes. Raises DeviceError where the device has no such axis."""
    x = _axis(layout, hid.axes.x, "x", hid)
    if _single(layout, hid) and hid.axes.y.usage.lower() not in layout.input:
        return x, AxisPlan(x.bits, x.report_id, x.zero_counts, STILL_M_PER_COUNT)
    return x, _axis(layout, hid.axes.y, "y", hid)


def _single(layout: Layout, hid: Hid) -> bool:
    """Whether the device pushes along one axis only, as a wheel does that has pedals and no Y."""
    assert layout.set_effect is not None
    no_y = hid.axes.y.usage == "Y" and "y" not in layout.input
    return no_y or len(layout.input) == 1 or len(layout.set_effect.axes_enable) == 1


def _axis(layout: Layout, axis: HandleAxis, name: str, hid: Hid) -> AxisPlan:
    found: Axis | None = layout.input.get(axis.usage.lower())
    if found is None:
        known = ", ".join(usage.capitalize() for usage in layout.input)
        raise DeviceError(f"device.hid.axes.{name}.usage: the device has no axis {axis.usage}; it has {known}")
    field = found.field
    half = (field.logical_max - field.logical_min) / 2.0
    middle = field.logical_min + half
    return AxisPlan(_bits(field), field.report_id, middle, axis.sign * hid.travel_m / half)


def _effects(way: Way, hid: Hid) -> tuple[_Effect, ...]:
    axes, swap = hid.force_axes, hid.force_axes.swap
    along_x, along_y = (HidQuantity.Y, HidQuantity.X) if swap else (HidQuantity.X, HidQuantity.Y)
    # A force to the right comes from the left, one away from the user from the user.
    right, away = 0.75, 0.5
    match way:
        case "two":
            return (_Effect("x", right, along_x, axes.x.sign), _Effect("y", away, along_y, axes.y.sign))
        case "polar":
            return (_Effect("x", 0.0, HidQuantity.MAGNITUDE, 1),)
        case "one":
            return (_Effect("x", right, HidQuantity.X, axes.x.sign),)
        case "sides":
            sign = axes.x.sign
            return (_Effect("x", right, HidQuantity.X, sign, True), _Effect("x", 1 - right, HidQuantity.X, -sign, True))


# ---- The plan --------------------------------------------------------------------------------------------------------


def plan_of(layout: Layout, hid: Hid, way: Way, indices: Sequence[int]) -> Plan:
    """What a connection does once these effects exist."""
    x, y = axes_of(layout, hid)
    effects = _effects(way, hid)
    # The direction first: the new strength is never shown the old way.
    force = [_polar_effect(layout, hid, indices[0])] if way == "polar" else []
    for effect, index, part in zip(effects, indices, _parts(layout, effects), strict=True):
        force.append(_constant_force(layout, index, effect, hid, part))
    infinite = "infinite_duration" in hid.quirks
    _, duration_s = _duration(layout, hid)
    renew_s = hid.renew_s if infinite else min(hid.renew_s, 0.5 * duration_s)
    watched = _playing(layout, indices, math.ceil(duration_s / renew_s) + 2)
    return Plan(
        x=x,
        y=y,
        force=tuple(force),
        renew=tuple(_operation(layout, index, "start") for index in indices),
        restore=tuple(_restore(layout, hid, way, indices, renew_s)),
        stop=_stop(layout, indices),
        # Most devices say that an effect plays when it begins to. The set-up began it before anybody listened; the
        # first renewal comes at once.
        begin=tuple(_operation(layout, index, "stop") for index in indices) if watched else (),
        effects=watched,
        states=_states(layout),
        renew_s=renew_s,
        foreign_s=renew_s if renew_s <= RENEWED_ENOUGH_S else 0.0,
        write_interval_s=0.0 if hid.max_rate_hz is None else 1.0 / (hid.max_rate_hz * len(force)),
        leak=_leak_of(layout) if way == "polar" else 0.0,
        report_names=_names(layout),
    )


def _names(layout: Layout) -> dict[int, str]:
    """The specification's names of what is sent for an effect."""
    effect, force, operation = layout.set_effect, layout.constant_force, layout.effect_operation
    assert effect is not None and force is not None and operation is not None
    return {
        effect.report_id: "Set Effect",
        force.report_id: "Set Constant Force",
        operation.report_id: "Effect Operation",
    }


def _parts(layout: Layout, effects: Sequence[_Effect]) -> list[tuple[float, float]]:
    """What the magnitude of each effect has of the force along its axis, and of the other one."""
    to = layout.set_effect
    assert to is not None
    angle = angle_of(to)
    straight = [(1.0, 0.0)] * len(effects)
    if len({effect.axis for effect in effects}) < 2 or angle is None or not all(_by_angle(to, one) for one in effects):
        return straight
    sign = effects[0].sign * effects[1].sign
    shown = parts(angle, effects[0].from_turns, effects[1].from_turns)
    return [(along, other * sign) for along, other in shown]


def _leak_of(layout: Layout) -> float:
    assert layout.set_effect is not None
    angle = angle_of(layout.set_effect)
    return 0.0 if angle is None else leak(angle)


def _restore(layout: Layout, hid: Hid, way: Way, indices: Sequence[int], renew_s: float) -> Iterator[Message]:
    """What an effect of another program changes in the place of ours, and is not renewed often enough anyway."""
    effects = _effects(way, hid)
    for effect, index, part in zip(effects, indices, _parts(layout, effects), strict=True):
        if way != "polar":
            yield Message(set_effect_report(layout, hid, index, effect))
        elif renew_s > RENEWED_ENOUGH_S:
            yield _polar_effect(layout, hid, index)
        if layout.set_envelope is not None:
            lines = _Report(layout.set_envelope.report_id, layout.set_envelope.report_bytes)
            lines.put(layout.set_envelope.effect_index, index)
            yield Message(bytes(lines.data))
        if renew_s > RENEWED_ENOUGH_S:
            yield _constant_force(layout, index, effect, hid, part)
            yield _operation(layout, index, "start")
    gain = _gain(layout, hid)
    if gain is not None:
        yield Message(gain)


def _stop(layout: Layout, indices: Sequence[int]) -> tuple[Message, ...]:
    """Stops and frees these effects, and switches the actuators off."""
    control = [_control(layout, name) for name in ("stop_all_effects", "disable_actuators")]
    stop = [
        *(_operation(layout, index, "stop") for index in indices),
        *(_block_free(layout, index) for index in indices),
        *(Message(data) for data in control if data),
    ]
    return tuple(message for message in stop if message is not None)


def _undo(layout: Layout, device: Device, indices: Sequence[int]) -> None:
    """Ends a set-up that failed half way, as far as the device still takes it: what it has room for is free again."""
    with suppress(DeviceError):
        for message in _stop(layout, indices):
            device.write(message.data)


def _states(layout: Layout) -> tuple[StateBit, ...]:
    state = layout.pid_state
    if state is None:
        return ()
    told = (
        (state.device_reset, HidMeaning.RESET),
        (state.actuators_enabled, HidMeaning.ACTUATORS),
        (state.device_paused, HidMeaning.PAUSED),
        (state.safety_switch, HidMeaning.SAFETY),
        (state.actuator_power, HidMeaning.POWER),
    )
    return tuple(StateBit(_bits(field), field.report_id, meaning) for field, meaning in told if field is not None)


def _playing(layout: Layout, indices: Sequence[int], proof: int) -> PlayingBits | None:
    """Where the device says which effects play; None where it does not, or cannot name ours."""
    state = layout.pid_state
    if state is None or state.effect_index is None or state.effect_playing is None:
        return None
    index, playing = state.effect_index, state.effect_playing
    if not all(index.logical_min <= ours <= index.logical_max for ours in indices):
        return None
    return PlayingBits(_bits(index), _bits(playing), state.report_id, tuple(indices), proof)


def _constant_force(
    layout: Layout,
    index: int,
    effect: _Effect | None = None,
    hid: Hid | None = None,
    part: tuple[float, float] = (1.0, 0.0),
) -> Message:
    """Set Constant Force of an effect; without `effect` for a force of zero. `part`: as of `_parts`."""
    force = layout.constant_force
    assert force is not None
    field = force.magnitude
    report = _Report(force.report_id, force.report_bytes)
    report.put(force.effect_index, index)
    zero = min(max(0, field.logical_min), field.logical_max)
    report.put(field, zero)
    if effect is None or hid is None:
        return Message(bytes(report.data))
    counts_per_n = effect.sign * (field.logical_max - zero) / hid.full_scale_force_n
    least = max(field.logical_min, -field.logical_max) if field.is_signed else zero
    along, other = (counts_per_n * share for share in part)
    value = Value(_bits(field), effect.quantity, along, zero, least, field.logical_max, other)
    return Message(bytes(report.data), (value,))


def _polar_effect(layout: Layout, hid: Hid, index: int) -> Message:
    """Set Effect that carries the direction of the force."""
    assert layout.set_effect is not None
    field = angle_of(layout.set_effect)
    assert field is not None
    per_turn = field.counts_per_turn()
    slope, turns = mirrored(hid.force_axes)
    # Within one turn of the range's begin, so that C has to take at most one away or add one.
    zero = counts_of(field, turns)
    value = Value(
        _bits(field),
        HidQuantity.DIRECTION,
        slope * per_turn / (2.0 * math.pi),
        zero,
        field.logical_min,
        field.logical_max,
    )
    return Message(set_effect_report(layout, hid, index, None), (value,))


# ---- Effects that the device plays by itself -------------------------------------------------------------------------


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
    if angle_of(effect) is None or _single(layout, hid):
        absent.append("Direction of two axes")
    if absent:
        return f"the device has no {', no '.join(absent)}"
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
        duration=_time_scale(effect.duration),
        attack_time=_time_scale(envelope.attack_time),
        fade_time=_time_scale(envelope.fade_time),
        period=_time_scale(periodic.period),
        magnitude=_level_scale(periodic.magnitude, hid),
        attack_level=_level_scale(envelope.attack_level, hid),
        fade_level=_level_scale(envelope.fade_level, hid),
    )
    return Periodic(numbers, tuple(_periodic_block(layout, hid, index) for index in indices))


def _periodic_block(layout: Layout, hid: Hid, index: int) -> PeriodicBlock:
    effect, periodic, envelope = layout.set_effect, layout.set_periodic, layout.set_envelope
    assert effect is not None and periodic is not None and envelope is not None
    # As a constant force, but for its type.
    polar = _polar_effect(layout, hid, index)
    set_effect = _Report(effect.report_id, effect.report_bytes)
    set_effect.data[:] = polar.data
    if effect.effect_type.kind == "bits":
        set_effect.put(effect.effect_type.entries["constant_force"].field, 0)
    set_effect.choose(effect.effect_type, "sine")
    shape = _Report(periodic.report_id, periodic.report_bytes)
    shape.put(periodic.effect_index, index)
    for rest in (periodic.magnitude, periodic.offset, periodic.phase):
        shape.put(rest, 0)
    lines = _Report(envelope.report_id, envelope.report_bytes)
    lines.put(envelope.effect_index, index)
    start, stop = (_operation(layout, index, name) for name in ("start", "stop"))
    return PeriodicBlock(
        Message(bytes(set_effect.data), polar.values), bytes(lines.data), bytes(shape.data), start, stop
    )


def _time_scale(field: Field) -> Scale:
    """A time, s; counts of the specification's own unit, 1 ms, where the descriptor names none."""
    step_s = field.seconds_per_count()
    zero = 0.0 if step_s is None else field.logical_min - field.physical_min * 10.0**field.unit_exponent / step_s
    return Scale(_bits(field), 1.0 / (step_s or 1e-3), zero, field.logical_min, field.logical_max)


def _level_scale(field: Field, hid: Hid) -> Scale:
    """A level, N; the largest number is the full force."""
    zero = min(max(0, field.logical_min), field.logical_max)
    return Scale(
        _bits(field), (field.logical_max - zero) / hid.full_scale_force_n, zero, field.logical_min, field.logical_max
    )


# ---- Reports ---------------------------------------------------------------------------------------------------------


class _Report:
    """A report in the making, its id first."""

    def __init__(self, report_id: int, report_bytes: int) -> None:
        self.data = bytearray(report_bytes + (report_id == 0))
        self.data[0] = report_id

    def put(self, field: Field | None, counts: float) -> None:
        """The number of counts, rounded and limited to the field's range; nothing where there is no field."""
        if field is not None:
            _bits(field).put(self.data, min(max(round(counts), field.logical_min), field.logical_max))

    def flag(self, field: Field | None, is_on: bool = True) -> None:
        """A flag, on or off, whatever its range says."""
        if field is not None:
            _bits(field).put(self.data, (number_of_on(field) or 0) if is_on else 0)

    def fill(self, field: Field | None) -> None:
        """All ones: none, or without end."""
        if field is not None:
            Bits(field.bit_offset, field.bit_size, False).put(self.data, (1 << field.bit_size) - 1)

    def choose(self, choice: Choice, name: str) -> None:
        """One of several names."""
        entry = choice.entries[name]
        _bits(entry.field).put(self.data, entry.value)


def set_effect_report(layout: Layout, hid: Hid, index: int, effect: _Effect | None) -> bytes:
    """Set Effect of a constant force; without `effect` its direction is sent later."""
    to = layout.set_effect
    assert to is not None
    report = _Report(to.report_id, to.report_bytes)
    report.put(to.effect_index, index)
    report.choose(to.effect_type, "constant_force")
    if "infinite_duration" in hid.quirks:
        report.fill(to.duration)
    else:
        report.put(to.duration, _duration(layout, hid)[0])
    for absent in (to.trigger_repeat_interval, to.sample_period, to.start_delay):
        report.put(absent, 0)
    if to.gain is not None:
        report.put(to.gain, to.gain.logical_max)
    report.fill(to.trigger_button)
    _aim(report, to, hid, effect)
    return bytes(report.data)


def _aim(report: _Report, to: SetEffect, hid: Hid, effect: _Effect | None) -> None:
    """Where the force of an effect comes from: an angle if the device takes one, else the axes that are enabled."""
    angle, by_angle = angle_of(to), _by_angle(to, effect)
    if by_angle:
        report.flag(to.direction_enable)
        if effect is not None:
            assert angle is not None
            report.put(angle, counts_of(angle, effect.from_turns))
    elif angle is not None and effect is not None:
        # Without Direction Enable there is a direction for each axis; firmware that takes it for a factor has no
        # force along x where it is 0.
        for field in to.direction:
            report.put(field, counts_of(field, effect.from_turns))
    elif to.is_direction_cartesian and effect is not None:
        for name, field in zip(("x", "y"), to.direction, strict=False):
            report.put(field, field.logical_max if name == effect.axis else 0)
        report.flag(to.direction_enable, not to.axes_enable)
    if not by_angle or to.direction_enable is None:
        for name, field in to.axes_enable.items():
            report.flag(field, effect is None or name == enabled_for(to, hid.axes, effect.axis))


def _by_angle(to: SetEffect, effect: _Effect | None) -> bool:
    """Whether an effect's direction is an angle, rather than the axes that are enabled."""
    needed = effect is None or effect.needs_angle
    return angle_of(to) is not None and (to.direction_enable is not None or not to.axes_enable or needed)


def _duration(layout: Layout, hid: Hid) -> tuple[int, float]:
    """The duration of an effect, in counts and as the device understands them, s; of endless ones, what is asked for.
    Raises DeviceError where the device has none that would do.
    """
    assert layout.set_effect is not None
    field = layout.set_effect.duration
    if "infinite_duration" in hid.quirks:
        return field.logical_max, hid.effect_duration_s
    scale = _time_scale(field)
    counts = min(max(scale.counts(hid.effect_duration_s), 1), field.logical_max)
    duration_s = scale.quantity(counts)
    fault = duration_fault(field, scale.resolution, duration_s, hid.effect_duration_s)
    if fault is not None:
        raise DeviceError(fault)
    return counts, duration_s


def _operation(layout: Layout, index: int, name: str) -> Message:
    to = layout.effect_operation
    assert to is not None
    report = _Report(to.report_id, to.report_bytes)
    report.put(to.effect_index, index)
    report.choose(to.operation, name)
    report.put(to.loop_count, 1)
    return Message(bytes(report.data))


def _block_free(layout: Layout, index: int) -> Message | None:
    to = layout.block_free
    if to is None or not to.effect_index.logical_min <= index <= to.effect_index.logical_max:
        return None
    report = _Report(to.report_id, to.report_bytes)
    report.put(to.effect_index, index)
    return Message(bytes(report.data))


def _control(layout: Layout, name: str) -> bytes | None:
    """A command of Device Control; None where the device knows no such command."""
    to = layout.device_control
    assert to is not None
    if name not in to.command.entries:
        return None
    report = _Report(to.report_id, to.report_bytes)
    report.choose(to.command, name)
    return bytes(report.data)


def _gain(layout: Layout, hid: Hid) -> bytes | None:
    """Device Gain at its maximum; None where the device has no such report, or does not take it."""
    to = layout.device_gain
    if to is None or "no_device_gain" in hid.quirks:
        return None
    report = _Report(to.report_id, to.report_bytes)
    report.put(to.gain, to.gain.logical_max)
    return bytes(report.data)


def _send(device: Device, report: bytes | None) -> None:
    if report is not None:
        device.write(report)


def _load_status(load: BlockLoad, answer: bytes, device: Device) -> str | None:
    """success, full or error; None: not yet known."""
    if load.status is None:
        return "success" if number_in(answer, load.effect_index, "PID Block Load", device) else "full"
    for name, entry in load.status.entries.items():
        if number_in(answer, entry.field, "PID Block Load", device) == entry.value:
            return name
    return None


def _bits(field: Field) -> Bits:
    return Bits(field.bit_offset, field.bit_size, field.is_signed)
