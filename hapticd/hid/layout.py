"""What of a device would be driven: the reports of the PID class and the axes, found in a report descriptor.

Usages and the names of reports are those of "Device Class Definition for Physical Interface Devices" 1.0. Nothing else
is taken for granted: ids, sizes, offsets, ranges, and whether commands are an array or bits come from the descriptor.

A report is known by the collection around its fields. What it consists of must share one report id; a report that
stands in the descriptor twice is taken where it is complete, and first of all beside the constant force.

A physical range that was given for another logical one, of an earlier field, is not taken for this one's: a duration
would become minutes. Where that is so the logical range counts, as without a physical one.

A field whose logical range is wider than its bits: refused where it carries a scale (axes, magnitudes), since the scale
is not known then; elsewhere the range is cut to what the bits hold.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

from hapticd.base.core import lib
from hapticd.hid.descriptor import Collection, CollectionType, Descriptor, ReportField, ReportKind
from hapticd.hid.flags import number_of_on
from hapticd.hid.usages import AXES, COMMANDS, EFFECT_TYPES, LOAD_STATUS, OPERATIONS
from hapticd.hid.useful_ranges import angle_fault, axis_fault, magnitude_fault

MAX_REPORT_BYTES: Final[int] = lib.HD_HID_REPORT_BYTES
"""The longest report that is driven, with its id."""
SKIPPED: Final = "report descriptor, "
"""A problem that begins so is an item that was skipped, no field."""
MAX_FIELD_BITS: Final = 32
"""The widest field that is driven."""

_PID: Final = 0x000F0000
_DESKTOP: Final = 0x00010000
_SIMULATION_PAGE: Final = 0x0002
_JOYSTICKS: Final = (_DESKTOP | 0x04, _DESKTOP | 0x05, _DESKTOP | 0x08)


@dataclass(frozen=True, slots=True)
class Field:
    """Where a number lies in a report, bits counted after the report id, and what it may be.

    `logical_min` and `logical_max` always fit into `bit_size` bits.
    """

    report_id: int
    """0 where reports are not numbered."""
    bit_offset: int
    bit_size: int
    """1 to 32."""
    logical_min: int
    logical_max: int
    physical_min: int
    physical_max: int
    unit: int
    """A Unit item of HID: nibbles of system, length, mass, time, ..."""
    unit_exponent: int

    @property
    def is_signed(self) -> bool:
        return self.logical_min < 0

    def seconds_per_count(self) -> float | None:
        """The physical size of a count where the unit is a time; None where the descriptor gives no time."""
        if self.unit not in (0x1001, 0x1002, 0x1003, 0x1004) or self.logical_max == self.logical_min:
            return None
        if not -12 <= self.unit_exponent <= 7 or self.physical_max <= self.physical_min:
            return None
        step = (self.physical_max - self.physical_min) / (self.logical_max - self.logical_min)
        return step * 10.0**self.unit_exponent

    def counts_per_turn(self) -> float:
        """Counts of a full turn, of a field that holds a direction.

        By its unit (degrees 0x14, radians 0x12) if the range is then a turn within a tenth. Else the range is one turn,
        as Linux takes it: many descriptors take the unit back before the field.
        """
        return (self.logical_max - self.logical_min) / (self._turns() or 1.0)

    def counts_at_north(self) -> float:
        """Counts of an angle of zero, of a field that holds a direction.

        Where the physical range is zero, if that is a turn by its unit, or is 360 of something. Else the counts are
        taken for the angle itself: zero, or what is nearest to it.
        """
        span = self.physical_max - self.physical_min
        is_turn = self._turns() is not None or any(0.9 <= span / (360.0 * 10**tens) <= 1.1 for tens in range(5))
        if is_turn and self.physical_min <= 0 <= self.physical_max:
            return self.logical_min - self.physical_min * (self.logical_max - self.logical_min) / span
        return min(max(0, self.logical_min), self.logical_max)

    def _turns(self) -> float | None:
        """The physical range in turns, if its unit is one of angles and it is about one turn."""
        per_turn = {0x14: 360.0, 0x12: 2 * math.pi}.get(self.unit)
        if per_turn is None or not -12 <= self.unit_exponent <= 7:
            return None
        turns = (self.physical_max - self.physical_min) * 10.0**self.unit_exponent / per_turn
        return turns if 0.9 <= turns <= 1.1 else None


@dataclass(frozen=True, slots=True)
class Entry:
    """A choice that can be made: `value` written into `field`."""

    field: Field
    value: int


@dataclass(frozen=True, slots=True)
class Choice:
    """One of several names: the value of an array, or a bit for each ("bits": those not chosen are 0)."""

    kind: str
    """array or bits."""
    entries: Mapping[str, Entry]


@dataclass(frozen=True, slots=True)
class Axis:
    """An input axis."""

    usage: str
    """x, y, z, rx, ry or rz."""
    report_bytes: int
    """With the id, where there is one."""
    field: Field


@dataclass(frozen=True, slots=True)
class SetEffect:
    report_id: int
    report_bytes: int
    """With the id, where there is one."""
    effect_index: Field
    effect_type: Choice
    """Names of EFFECT_TYPES; constant_force is among them."""
    duration: Field
    axes_enable: Mapping[str, Field]
    """By axis (x, y, ...); may be empty."""
    direction: tuple[Field, ...]
    """In the order of the report; may be empty. Angles, unless `is_direction_cartesian`: the first is the polar one
    where Direction Enable is set, and without it there is one for each axis."""
    is_direction_cartesian: bool
    """Its elements are X, Y, ... with a sign: parts of a vector."""
    direction_enable: Field | None
    gain: Field | None
    trigger_button: Field | None
    trigger_repeat_interval: Field | None
    sample_period: Field | None
    start_delay: Field | None


@dataclass(frozen=True, slots=True)
class ConstantForce:
    report_id: int
    report_bytes: int
    effect_index: Field
    magnitude: Field


@dataclass(frozen=True, slots=True)
class EffectOperation:
    report_id: int
    report_bytes: int
    effect_index: Field
    operation: Choice
    """Names of OPERATIONS; start and stop are among them."""
    loop_count: Field | None


@dataclass(frozen=True, slots=True)
class DeviceControl:
    kind: str
    """array or bits, as of `command`."""
    report_id: int
    report_bytes: int
    command: Choice
    """Names of COMMANDS."""


@dataclass(frozen=True, slots=True)
class DeviceGain:
    report_id: int
    report_bytes: int
    gain: Field


@dataclass(frozen=True, slots=True)
class CreateNewEffect:
    """A feature report."""

    report_id: int
    report_bytes: int
    effect_type: Choice
    byte_count: Field | None


@dataclass(frozen=True, slots=True)
class BlockLoad:
    """A feature report."""

    report_id: int
    report_bytes: int
    effect_index: Field
    status: Choice | None
    """Names of LOAD_STATUS."""
    ram_pool_available: Field | None


@dataclass(frozen=True, slots=True)
class BlockFree:
    report_id: int
    report_bytes: int
    effect_index: Field


@dataclass(frozen=True, slots=True)
class Pool:
    """A feature report."""

    report_id: int
    report_bytes: int
    ram_pool_size: Field | None
    simultaneous_effects_max: Field | None
    device_managed_pool: Field | None
    shared_parameter_blocks: Field | None


@dataclass(frozen=True, slots=True)
class PidState:
    """An input report."""

    report_id: int
    report_bytes: int
    effect_index: Field | None
    effect_playing: Field | None
    device_paused: Field | None
    actuators_enabled: Field | None
    safety_switch: Field | None
    actuator_override_switch: Field | None
    actuator_power: Field | None
    device_reset: Field | None


@dataclass(frozen=True, slots=True)
class SetPeriodic:
    report_id: int
    report_bytes: int
    effect_index: Field
    magnitude: Field
    period: Field
    offset: Field | None
    phase: Field | None


@dataclass(frozen=True, slots=True)
class SetEnvelope:
    report_id: int
    report_bytes: int
    effect_index: Field
    attack_level: Field
    attack_time: Field
    fade_level: Field
    fade_time: Field


@dataclass(frozen=True, slots=True)
class Layout:
    """What would be driven. `usable`: nothing is missing, so that none of the first reports is None."""

    missing: tuple[str, ...]
    """What a constant force would need: reports by the specification's names, or "report: field"."""
    problems: tuple[str, ...]
    """Fields that are there but cannot be used, and why."""
    input: Mapping[str, Axis]
    """By usage (x, y, z, rx, ry, rz), in this order."""
    effect_indices: tuple[int, int] | None
    """First and last block index that every report can carry; None if there is none."""
    constant_force: ConstantForce | None
    set_effect: SetEffect | None
    effect_operation: EffectOperation | None
    device_control: DeviceControl | None
    create_new_effect: CreateNewEffect | None
    block_load: BlockLoad | None
    block_free: BlockFree | None
    device_gain: DeviceGain | None
    pid_state: PidState | None
    pool: Pool | None
    set_periodic: SetPeriodic | None
    set_envelope: SetEnvelope | None

    @property
    def usable(self) -> bool:
        return not self.missing

    def to_dict(self) -> dict[str, object]:
        """As JSON: what is absent is null."""
        plain = {item.name: _plain(getattr(self, item.name)) for item in dataclasses.fields(self)}
        return {"usable": self.usable, **plain}


def layout_of(descriptor: Descriptor) -> Layout:
    """Finds what would be driven. Never fails: what is not there is named in `missing`."""
    return _Finder(descriptor).layout()


def _plain(value: object) -> object:
    match value:
        case Axis():
            return {"report_bytes": value.report_bytes, **_plain_fields(value.field)}
        case Choice(kind="array"):
            entries = value.entries
            field = next(iter(entries.values())).field
            return {"kind": "array", **_plain_fields(field), "values": {name: entries[name].value for name in entries}}
        case Choice():
            bits = {name: {**_plain_fields(entry.field), "value": entry.value} for name, entry in value.entries.items()}
            return {"kind": "bits", "bits": bits}
        case DeviceControl():
            command = _plain(value.command)
            assert isinstance(command, dict)
            return {**command, "report_id": value.report_id, "report_bytes": value.report_bytes}
        case Mapping():
            return {name: _plain(inner) for name, inner in value.items()}
        case tuple():
            return [_plain(inner) for inner in value]
        case _ if dataclasses.is_dataclass(value):
            return _plain_fields(value)
        case _:
            return value


def _plain_fields(value: object) -> dict[str, object]:
    assert dataclasses.is_dataclass(value)
    return {item.name: _plain(getattr(value, item.name)) for item in dataclasses.fields(value)}


_Report = TypeVar("_Report")


class _Missing(Exception):
    """A field that a report cannot do without is not there."""


@dataclass(slots=True)
class _Group:
    """The fields of one report that stand in one collection."""

    fields: list[ReportField]
    report_id: int
    report_bytes: int
    root: int
    """The number of the outermost collection."""
    problems: list[str] = dataclasses.field(default_factory=list)

    def every(self, usage: int, inside: int | None = None) -> Iterator[tuple[ReportField, int]]:
        """The fields with an element of this usage (page << 16 | usage), those that can be written first."""
        for constant in (False, True):
            for field in self.fields:
                if field.is_constant == constant and (inside is None or field.within(inside)):
                    index = field.index_of(usage)
                    if index is not None:
                        yield field, index

    def find(self, *usages: int, scaled: bool = False) -> Field | None:
        """The first number of one of these usages that can be driven."""
        for usage in usages:
            for field, index in self.every(usage):
                if not field.is_variable or self._is_fixed(field):
                    continue
                found = self.element(field, index, scaled)
                if found is not None:
                    return found
        return None

    @staticmethod
    def _is_fixed(field: ReportField) -> bool:
        """Constant in a report that is written. In those that are read, it means that the device alone sets it."""
        return field.is_constant and field.kind == ReportKind.OUTPUT

    def accept(self, field: Field, name: str, fault: str | None) -> bool:
        """Whether there is no fault; else it is noted as a problem."""
        if fault is not None:
            kind = self.fields[0].kind
            self.problems.append(f"{kind} report {field.report_id}, bit {field.bit_offset} ({name}): {fault}")
        return fault is None

    def need(self, name: str, *usages: int, scaled: bool = False) -> Field:
        found = self.find(*usages, scaled=scaled)
        if found is None:
            raise _Missing(name)
        return found

    def element(self, field: ReportField, index: int, scaled: bool) -> Field | None:
        """One element as a field, if it can be driven; else a problem is noted."""
        offset, size = field.bit_offset + index * field.bit_size, field.bit_size
        usage = field.usage_at(index) or 0
        where = f"{field.kind} report {field.report_id}, bit {offset} (usage {usage >> 16:02X}:{usage & 0xFFFF:02X})"
        if size > MAX_FIELD_BITS:
            self.problems.append(f"{where}: it has {size} bits; {MAX_FIELD_BITS} at most can be driven")
            return None
        if self.report_bytes > MAX_REPORT_BYTES:
            self.problems.append(
                f"{where}: its report has {self.report_bytes} bytes; {MAX_REPORT_BYTES} at most can be driven"
            )
            return None
        signed = field.logical_min < 0
        least, most = (-(1 << (size - 1)), (1 << (size - 1)) - 1) if signed else (0, (1 << size) - 1)
        low, high = max(field.logical_min, least), min(field.logical_max, most)
        if low > high or (scaled and ((low, high) != (field.logical_min, field.logical_max) or low == high)):
            has = f"{field.logical_min} to {field.logical_max}"
            fault = "is empty" if low == high else f"does not fit into its {size} bits"
            self.problems.append(f"{where}: its range, {has}, {fault}")
            return None
        physical = (field.physical_min, field.physical_max)
        if field.is_physical_stale:
            physical = (field.logical_min, field.logical_max)
        return Field(
            field.report_id,
            offset,
            size,
            low,
            high,
            *physical,
            field.unit,
            field.unit_exponent,
        )

    def choice(self, names: Mapping[str, int]) -> Choice | None:
        """One of several usages: of the first array that has one of them, else of bits."""
        for field in self.fields:
            if field.is_variable or self._is_fixed(field):
                continue
            indices = {name: field.index_of(_PID | usage) for name, usage in names.items()}
            if all(index is None for index in indices.values()):
                continue
            element = self.element(field, 0, scaled=False)
            if element is not None:
                values = {name: field.logical_min + index for name, index in indices.items() if index is not None}
                entries = {
                    name: Entry(element, value)
                    for name, value in values.items()
                    if element.logical_min <= value <= element.logical_max
                }
                if entries:
                    return Choice("array", entries)
        entries = {}
        for name, usage in names.items():
            for field, index in self.every(_PID | usage):
                bit = None
                if field.is_variable and not self._is_fixed(field):
                    bit = self.element(field, index, scaled=False)
                on = number_of_on(bit) if bit is not None else None
                if bit is not None and on is not None:
                    entries[name] = Entry(bit, on)
                    break
        return Choice("bits", entries) if entries else None

    def need_choice(self, name: str, names: Mapping[str, int]) -> Choice:
        found = self.choice(names)
        if found is None:
            raise _Missing(name)
        return found


class _Finder:
    def __init__(self, descriptor: Descriptor) -> None:
        self._descriptor = descriptor
        self._missing: list[str] = []
        self._problems = [f"{SKIPPED}{told}" for told in descriptor.skipped]
        self._root: int | None = None
        self._within: dict[int, list[tuple[Collection, ReportField]]] = {}
        for field in descriptor.fields:
            around = {
                usage: one for one in field.path for usage in (one.usage, *one.aliases)
            }  # the innermost one stays
            for usage, collection in around.items():
                self._within.setdefault(usage, []).append((collection, field))

    def layout(self) -> Layout:
        output, feature = ReportKind.OUTPUT, ReportKind.FEATURE
        # The constant force first: where it stands, the others are looked for first.
        constant_force = self._report("Set Constant Force", 0x73, output, _constant_force)
        set_effect = self._report("Set Effect", 0x21, output, _set_effect)
        operation = self._report("Effect Operation", 0x77, output, _effect_operation)
        control = self._report("Device Control", (0x96, 0x95), output, _device_control)
        create = self._report("Create New Effect", 0xAB, feature, _create_new_effect)
        load = self._report("PID Block Load", 0x89, feature, _block_load)
        axes = self._axes()
        if not axes:
            self._missing.append("Joystick: X or Y")
        indices = _indices(part.effect_index for part in (constant_force, set_effect, operation, load) if part)
        if indices is None and constant_force is not None:
            self._missing.append("Effect Block Index")
        unsigned = constant_force is not None and not constant_force.magnitude.is_signed
        if set_effect is not None and unsigned and not set_effect.direction:
            self._missing.append("Set Effect: Direction")
        return Layout(
            input=axes,
            effect_indices=indices,
            constant_force=constant_force,
            set_effect=set_effect,
            effect_operation=operation,
            device_control=control,
            create_new_effect=create,
            block_load=load,
            block_free=self._optional(0x90, output, _block_free),
            device_gain=self._optional(0x7D, output, _device_gain),
            pid_state=self._optional(0x92, ReportKind.INPUT, _pid_state),
            pool=self._optional(0x7F, feature, _pool),
            set_periodic=self._optional(0x6E, output, _set_periodic),
            set_envelope=self._optional(0x5A, output, _set_envelope),
            missing=tuple(self._missing),
            problems=tuple(dict.fromkeys(self._problems)),
        )

    # ---- reports -----------------------------------------------------------------------------------------------------

    def _report(
        self, name: str, usages: int | tuple[int, ...], kind: ReportKind, build: Callable[[_Group], _Report]
    ) -> _Report | None:
        """The first complete one; else what the best one lacks is noted as missing."""
        lacking: list[str] = []
        for group in self._groups(usages, kind):
            try:
                found = build(group)
            except _Missing as absent:
                lacking = lacking or [f"{name}: {part}" for part in str(absent).split(", ")]
                self._problems += group.problems
                continue
            self._problems += group.problems
            if self._root is None:
                self._root = group.root
            return found
        self._missing += lacking or [name]
        return None

    def _optional(self, usage: int, kind: ReportKind, build: Callable[[_Group], _Report]) -> _Report | None:
        for group in self._groups(usage, kind):
            try:
                found = build(group)
            except _Missing:
                continue
            finally:
                self._problems += group.problems
            return found
        return None

    def _groups(self, usages: int | tuple[int, ...], kind: ReportKind) -> list[_Group]:
        """Fields of this kind in collections of this usage, by collection and report id; the nearest ones first."""
        groups: dict[tuple[int, int], _Group] = {}
        for usage in (usages,) if isinstance(usages, int) else usages:
            for around, field in self._within.get(_PID | usage, ()):
                if field.kind == kind:
                    self._put(groups, (around.number, field.report_id), field)
        return sorted(groups.values(), key=lambda group: group.root != self._root)

    def _put(self, groups: dict[tuple[int, int], _Group], key: tuple[int, int], field: ReportField) -> None:
        """Adds the field to its group, unless its report cannot be told apart."""
        if field.report_id == 0 and self._descriptor.numbered(field.kind):
            self._problems.append(
                f"{field.kind} report without an id, bit {field.bit_offset}: other {field.kind} reports have one"
            )
            return
        group = groups.get(key)
        if group is None:
            length = self._descriptor.report_bytes(field.kind, field.report_id)
            group = groups[key] = _Group([], field.report_id, length, field.path[0].number)
        group.fields.append(field)

    # ---- axes --------------------------------------------------------------------------------------------------------

    def _axes(self) -> dict[str, Axis]:
        """Absolute numbers in the input reports of a joystick, gamepad or the like.

        Of several reports that have axes, one with both X and Y, in the collection of the forces if possible; what it
        lacks is taken from the others.
        """
        groups: dict[tuple[int, int], _Group] = {}
        for field in self._descriptor.fields:
            # Some devices nest application collections that have no usage of their own.
            around = (c for c in reversed(field.path) if c.type == CollectionType.APPLICATION and c.usage)
            application = next(around, None)
            if field.kind != ReportKind.INPUT or application is None or not field.is_variable:
                continue
            is_joystick = application.usage >> 16 == _SIMULATION_PAGE or any(map(application.is_a, _JOYSTICKS))
            if is_joystick and not field.is_relative and not field.is_constant:
                self._put(groups, (application.number, field.report_id), field)
        found = []
        for group in groups.values():
            axes = {}
            for name, usage in AXES.items():
                place = group.find(_DESKTOP | usage, scaled=True)
                if place is not None and group.accept(place, name.capitalize(), axis_fault(place)):
                    axes[name] = Axis(name, group.report_bytes, place)
            self._problems += group.problems
            found.append((group.root != self._root, not {"x", "y"} <= set(axes), axes))
        found.sort(key=lambda entry: entry[:2])
        merged: dict[str, Axis] = {}
        for _, _, axes in found:
            merged = {**axes, **merged}
        return {name: merged[name] for name in AXES if name in merged}


def _indices(fields: Iterable[Field]) -> tuple[int, int] | None:
    """The block indices that all of them can carry; 0 is none."""
    fields = tuple(fields)
    first = max((field.logical_min for field in fields), default=0)
    last = min((field.logical_max for field in fields), default=0)
    return (max(first, 1), last) if max(first, 1) <= last else None


def _needs(*names: str | None) -> None:
    absent = [name for name in names if name]
    if absent:
        raise _Missing(", ".join(absent))


def _constant_force(group: _Group) -> ConstantForce:
    index, magnitude = group.find(_PID | 0x22), group.find(_PID | 0x70, scaled=True)
    if magnitude is not None and not group.accept(magnitude, "Magnitude", magnitude_fault(magnitude)):
        magnitude = None
    if index is None or magnitude is None:
        _needs(None if index else "Effect Block Index", None if magnitude else "Magnitude")
    assert index is not None and magnitude is not None
    return ConstantForce(group.report_id, group.report_bytes, index, magnitude)


def _set_effect(group: _Group) -> SetEffect:
    index, duration = group.find(_PID | 0x22), group.find(_PID | 0x50)
    types = group.choice(EFFECT_TYPES)
    is_constant = types is not None and "constant_force" in types.entries
    _needs(
        None if index else "Effect Block Index",
        None if types else "Effect Type",
        None if is_constant or not types else "ET Constant Force",
        None if duration else "Duration",
    )
    assert index is not None and duration is not None and types is not None
    enable = {}
    for name, usage in AXES.items():
        for field, element in group.every(_DESKTOP | usage, _PID | 0x55):
            place = group.element(field, element, scaled=False) if field.is_variable else None
            if place is not None and not field.is_constant and number_of_on(place) is not None:
                enable[name] = place
                break
    directions: list[Field] = []
    is_cartesian = False
    for field in group.fields:
        # Whatever its elements are called: axes, or instances of the page Ordinals.
        inside = field.within(_PID | 0x57) or field.index_of(_PID | 0x57) is not None
        if inside and field.is_variable and not field.is_constant and field.usages:
            places = [group.element(field, element, scaled=True) for element in range(min(field.count, len(AXES)))]
            # X, Y, Z, and the vectors Vx, Vy, Vz.
            parts = [_DESKTOP | one for one in (*range(0x30, 0x33), *range(0x40, 0x43))]
            is_vector = field.logical_min < 0 and field.usage_at(0) in parts
            found = [place for place in places if place is not None] if all(places) else []
            if found and (is_vector or group.accept(found[0], "Direction", angle_fault(found[0]))):
                directions += found
                is_cartesian |= is_vector
    return SetEffect(
        group.report_id,
        group.report_bytes,
        effect_index=index,
        effect_type=types,
        duration=duration,
        axes_enable=enable,
        direction=tuple(directions[: len(AXES)]),
        is_direction_cartesian=is_cartesian,
        direction_enable=group.find(_PID | 0x56),
        gain=group.find(_PID | 0x52),
        trigger_button=group.find(_PID | 0x53),
        trigger_repeat_interval=group.find(_PID | 0x54),
        sample_period=group.find(_PID | 0x51),
        start_delay=group.find(_PID | 0xA7),
    )


def _effect_operation(group: _Group) -> EffectOperation:
    index, operation = group.find(_PID | 0x22), group.choice(OPERATIONS)
    known = operation.entries if operation else {}
    _needs(
        None if index else "Effect Block Index",
        None if "start" in known else "Op Effect Start",
        None if "stop" in known else "Op Effect Stop",
    )
    assert index is not None and operation is not None
    return EffectOperation(group.report_id, group.report_bytes, index, operation, group.find(_PID | 0x7C))


def _device_control(group: _Group) -> DeviceControl:
    command = group.need_choice("commands", COMMANDS)
    return DeviceControl(command.kind, group.report_id, group.report_bytes, command)


def _create_new_effect(group: _Group) -> CreateNewEffect:
    types = group.need_choice("Effect Type", EFFECT_TYPES)
    _needs(None if "constant_force" in types.entries else "ET Constant Force")
    # Byte Count is of the page Generic Desktop; some devices put it on the PID page.
    return CreateNewEffect(group.report_id, group.report_bytes, types, group.find(_DESKTOP | 0x3B, _PID | 0x3B))


def _block_load(group: _Group) -> BlockLoad:
    index = group.need("Effect Block Index", _PID | 0x22)
    status = group.choice(LOAD_STATUS)
    if status is not None and "success" not in status.entries:
        status = None  # it could never say that an effect is loaded: the index does
    return BlockLoad(group.report_id, group.report_bytes, index, status, group.find(_PID | 0xAC))


def _block_free(group: _Group) -> BlockFree:
    return BlockFree(group.report_id, group.report_bytes, group.need("Effect Block Index", _PID | 0x22))


def _device_gain(group: _Group) -> DeviceGain:
    return DeviceGain(group.report_id, group.report_bytes, group.need("Device Gain", _PID | 0x7E, scaled=True))


def _pool(group: _Group) -> Pool:
    return Pool(group.report_id, group.report_bytes, *(group.find(_PID | usage) for usage in (0x80, 0x83, 0xA9, 0xAA)))


def _pid_state(group: _Group) -> PidState:
    usages = (0x22, 0x94, 0x9F, 0xA0, 0xA4, 0xA5, 0xA6, 0x9A)
    return PidState(group.report_id, group.report_bytes, *(group.find(_PID | usage) for usage in usages))


def _set_periodic(group: _Group) -> SetPeriodic:
    return SetPeriodic(
        group.report_id,
        group.report_bytes,
        effect_index=group.need("Effect Block Index", _PID | 0x22),
        magnitude=group.need("Magnitude", _PID | 0x70, scaled=True),
        period=group.need("Period", _PID | 0x72, scaled=True),
        offset=group.find(_PID | 0x6F, scaled=True),
        phase=group.find(_PID | 0x71, scaled=True),
    )


def _set_envelope(group: _Group) -> SetEnvelope:
    return SetEnvelope(
        group.report_id,
        group.report_bytes,
        effect_index=group.need("Effect Block Index", _PID | 0x22),
        attack_level=group.need("Attack Level", _PID | 0x5B, scaled=True),
        attack_time=group.need("Attack Time", _PID | 0x5C, scaled=True),
        fade_level=group.need("Fade Level", _PID | 0x5D, scaled=True),
        fade_time=group.need("Fade Time", _PID | 0x5E, scaled=True),
    )
