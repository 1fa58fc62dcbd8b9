"""What of a device would be driven: the reports of the PID class and the axes, found in a report descriptor.

Usages and the names of reports are those of "Device Class Definition for Physical Interface Devices" 1.0. Nothing else
is taken for granted: ids, sizes, offsets, ranges, and whether commands are an array or bits come from the descriptor.

The classes of the reports are the table by which they are found. Each field says what it is (`Field`, `Choice`; with
None it may be absent) and how it is found (`Number`, `OneOf`, `Made`). `_REPORTS` says in which collection each
report stands. To read another field, add a line to its report.

A `Group` is what fields are looked for in. What is found can be driven; what is there and cannot be is noted as a
problem of the group.

A physical range that was given for another logical one, of an earlier field, is not taken for this one's: a duration
would become minutes. Where that is so the logical range counts, as without a physical one.

A field whose logical range is wider than its bits: refused where it carries a scale (axes, magnitudes), since the scale
is not known then; elsewhere the range is cut to what the bits hold.

A report is known by the collection around its fields. What it consists of must share one report id; a report that
stands in the descriptor twice is taken where it is complete, and first of all beside the constant force.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from types import NoneType
from typing import Annotated, Any, Final, TypeAlias, get_args, get_type_hints

from hapticd.base.core import lib
from hapticd.hid.descriptor.fields import Choice, Entry, Field, angle_fault, axis_fault, magnitude_fault
from hapticd.hid.descriptor.parser import APPLICATION_COLLECTION, Collection, Descriptor, ReportField, ReportKind

# ---- Usages ----------------------------------------------------------------------------------------------------------

PID: Final = 0x000F0000
DESKTOP: Final = 0x00010000
"""Usage pages, above the sixteen bits of a usage."""
AXES: Final = {"x": 0x30, "y": 0x31, "z": 0x32, "rx": 0x33, "ry": 0x34, "rz": 0x35}
"""Usages of the axes on the page Generic Desktop."""

EFFECT_TYPES: Final = {
    "constant_force": 0x26,
    "ramp": 0x27,
    "custom_force": 0x28,
    "square": 0x30,
    "sine": 0x31,
    "triangle": 0x32,
    "sawtooth_up": 0x33,
    "sawtooth_down": 0x34,
    "spring": 0x40,
    "damper": 0x41,
    "inertia": 0x42,
    "friction": 0x43,
}
OPERATIONS: Final = {"start": 0x79, "start_solo": 0x7A, "stop": 0x7B}
COMMANDS: Final = {
    "enable_actuators": 0x97,
    "disable_actuators": 0x98,
    "stop_all_effects": 0x99,
    "device_reset": 0x9A,
    "device_pause": 0x9B,
    "device_continue": 0x9C,
}
LOAD_STATUS: Final = {"success": 0x8C, "full": 0x8D, "error": 0x8E}

# ---- How a field is found --------------------------------------------------------------------------------------------

MAX_REPORT_BYTES: Final[int] = lib.HD_HID_REPORT_BYTES
"""The longest report that is driven, with its id."""
MAX_FIELD_BITS: Final = 32
"""The widest field that is driven."""


@dataclass(slots=True)
class Group:
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

    def number(self, usage: int, scaled: bool) -> Field | None:
        """The first number of this usage that can be driven."""
        for field, index in self.every(usage if usage >> 16 else PID | usage):
            found = self.element(field, index, scaled) if field.is_variable and not _is_fixed(field) else None
            if found is not None:
                return found
        return None

    def accept(self, field: Field, name: str, fault: str | None) -> bool:
        """Whether there is no fault; else it is noted as a problem."""
        if fault is not None:
            kind = self.fields[0].kind
            self.problems.append(f"{kind} report {field.report_id}, bit {field.bit_offset} ({name}): {fault}")
        return fault is None

    def element(self, field: ReportField, index: int, scaled: bool) -> Field | None:
        """One element as a field, if it can be driven; else a problem is noted."""
        offset, size = field.bit_offset + index * field.bit_size, field.bit_size
        least, most = (-(1 << (size - 1)), (1 << (size - 1)) - 1) if field.logical_min < 0 else (0, (1 << size) - 1)
        low, high = max(field.logical_min, least), min(field.logical_max, most)
        problem = None
        if size > MAX_FIELD_BITS:
            problem = f"it has {size} bits; {MAX_FIELD_BITS} at most can be driven"
        elif self.report_bytes > MAX_REPORT_BYTES:
            problem = f"its report has {self.report_bytes} bytes; {MAX_REPORT_BYTES} at most can be driven"
        elif low > high or (scaled and ((low, high) != (field.logical_min, field.logical_max) or low == high)):
            fault = "is empty" if low == high else f"does not fit into its {size} bits"
            problem = f"its range, {field.logical_min} to {field.logical_max}, {fault}"
        if problem is not None:
            usage = field.usage_at(index) or 0
            where = f"bit {offset} (usage {usage >> 16:02X}:{usage & 0xFFFF:02X})"
            self.problems.append(f"{field.kind} report {field.report_id}, {where}: {problem}")
            return None
        physical = (field.physical_min, field.physical_max)
        if field.is_physical_stale:
            physical = (field.logical_min, field.logical_max)
        return Field(field.report_id, offset, size, low, high, *physical, field.unit, field.unit_exponent)

    def choice(self, names: Mapping[str, int]) -> Choice | None:
        """One of several usages: of the first array that has one of them, else of bits."""
        for field in self.fields:
            if field.is_variable or _is_fixed(field):
                continue
            indices = {name: field.index_of(PID | usage) for name, usage in names.items()}
            if all(index is None for index in indices.values()):
                continue
            element = self.element(field, 0, scaled=False)
            if element is not None:
                values = {name: field.logical_min + index for name, index in indices.items() if index is not None}
                within = range(element.logical_min, element.logical_max + 1)
                entries = {name: Entry(element, value) for name, value in values.items() if value in within}
                if entries:
                    return Choice("array", entries)
        entries = {}
        for name, usage in names.items():
            for field, index in self.every(PID | usage):
                bit = self.element(field, index, scaled=False) if field.is_variable and not _is_fixed(field) else None
                on = bit.counts_when_on() if bit is not None else None
                if bit is not None and on is not None:
                    entries[name] = Entry(bit, on)
                    break
        return Choice("bits", entries) if entries else None


def _is_fixed(field: ReportField) -> bool:
    """Constant in a report that is written. In those that are read, it means that the device alone sets it."""
    return field.is_constant and field.kind == ReportKind.OUTPUT


@dataclass(frozen=True, slots=True)
class Number:
    """The first number of a usage that can be driven. Usages without a page are of the PID page."""

    name: str
    usage: int
    scaled: bool = False
    """It carries a scale."""
    fault: Callable[[Field], str | None] | None = None
    """What else may be wrong with it."""

    def find(self, group: Group) -> Field | None:
        found = group.number(self.usage, self.scaled)
        if found is None or self.fault is None or group.accept(found, self.name, self.fault(found)):
            return found
        return None

    def lacking(self, found: object) -> list[str]:
        """What is named as missing where this was found."""
        return [self.name] if found is None else []


@dataclass(frozen=True, slots=True)
class OneOf:
    """A choice of these usages."""

    name: str
    usages: Mapping[str, int]
    needed: tuple[tuple[str, str], ...] = ()
    """What it cannot do without, by the specification's names."""

    def find(self, group: Group) -> Choice | None:
        return group.choice(self.usages)

    def lacking(self, found: object) -> list[str]:
        if found is None and self.name:
            return [self.name]
        return [name for entry, name in self.needed if not isinstance(found, Choice) or entry not in found.entries]


@dataclass(frozen=True, slots=True)
class Made:
    """What is neither a number nor a choice, and may be empty."""

    find: Callable[[Group], object]

    def lacking(self, found: object) -> list[str]:
        return []


Row: TypeAlias = Number | OneOf | Made


# ---- The report descriptor -------------------------------------------------------------------------------------------

SKIPPED: Final = "report descriptor, "
"""A problem that begins so is an item that was skipped, no field."""

_SIMULATION_PAGE: Final = 0x0002
_JOYSTICKS: Final = (DESKTOP | 0x04, DESKTOP | 0x05, DESKTOP | 0x08)
_VECTORS: Final = tuple(DESKTOP | usage for usage in (*range(0x30, 0x33), *range(0x40, 0x43)))
"""X, Y, Z, and the vectors Vx, Vy, Vz."""


# ---- Where an effect pushes ------------------------------------------------------------------------------------------


def _axes_enable(group: Group) -> dict[str, Field]:
    enable = {}
    for name, usage in AXES.items():
        for field, index in group.every(DESKTOP | usage, PID | 0x55):
            place = group.element(field, index, scaled=False) if field.is_variable else None
            if place is not None and not field.is_constant and place.counts_when_on() is not None:
                enable[name] = place
                break
    return enable


def _directions(group: Group) -> Iterator[tuple[list[Field], bool]]:
    """Fields of the direction, and whether they are parts of a vector."""
    for field in group.fields:
        # Whatever its elements are called: axes, or instances of the page Ordinals.
        inside = field.within(PID | 0x57) or field.index_of(PID | 0x57) is not None
        if inside and field.is_variable and not field.is_constant and field.usages:
            places = [group.element(field, index, scaled=True) for index in range(min(field.count, len(AXES)))]
            is_vector = field.logical_min < 0 and field.usage_at(0) in _VECTORS
            found = [place for place in places if place is not None] if all(places) else []
            if found and (is_vector or group.accept(found[0], "Direction", angle_fault(found[0]))):
                yield found, is_vector


def _direction(group: Group) -> tuple[Field, ...]:
    return tuple(field for found, _ in _directions(group) for field in found)[: len(AXES)]


def _is_direction_cartesian(group: Group) -> bool:
    return any(is_vector for _, is_vector in _directions(group))


# ---- The reports, and where their fields stand -----------------------------------------------------------------------

_EffectIndex = Annotated[Field, Number("Effect Block Index", 0x22)]


@dataclass(frozen=True, slots=True)
class Axis:
    """An input axis."""

    usage: str
    """x, y, z, rx, ry or rz."""
    report_bytes: int
    """With the id, where there is one."""
    field: Field


@dataclass(frozen=True, slots=True)
class Report:
    """A report of which every field has been found."""

    report_id: int
    report_bytes: int
    """With the id, where there is one."""


@dataclass(frozen=True, slots=True)
class SetEffect(Report):
    effect_index: _EffectIndex
    effect_type: Annotated[Choice, OneOf("Effect Type", EFFECT_TYPES, (("constant_force", "ET Constant Force"),))]
    duration: Annotated[Field, Number("Duration", 0x50)]
    axes_enable: Annotated[Mapping[str, Field], Made(_axes_enable)]
    """By axis (x, y, ...); may be empty."""
    direction: Annotated[tuple[Field, ...], Made(_direction)]
    """In the order of the report; may be empty. Angles, unless `is_direction_cartesian`: the first is the polar one
    where Direction Enable is set, and without it there is one for each axis."""
    is_direction_cartesian: Annotated[bool, Made(_is_direction_cartesian)]
    """Its elements are X, Y, ... with a sign: parts of a vector."""
    direction_enable: Annotated[Field | None, Number("Direction Enable", 0x56)]
    gain: Annotated[Field | None, Number("Gain", 0x52)]
    trigger_button: Annotated[Field | None, Number("Trigger Button", 0x53)]
    trigger_repeat_interval: Annotated[Field | None, Number("Trigger Repeat Interval", 0x54)]
    sample_period: Annotated[Field | None, Number("Sample Period", 0x51)]
    start_delay: Annotated[Field | None, Number("Start Delay", 0xA7)]


@dataclass(frozen=True, slots=True)
class ConstantForce(Report):
    effect_index: _EffectIndex
    magnitude: Annotated[Field, Number("Magnitude", 0x70, scaled=True, fault=magnitude_fault)]


@dataclass(frozen=True, slots=True)
class EffectOperation(Report):
    effect_index: _EffectIndex
    operation: Annotated[Choice, OneOf("", OPERATIONS, (("start", "Op Effect Start"), ("stop", "Op Effect Stop")))]
    loop_count: Annotated[Field | None, Number("Loop Count", 0x7C)]


@dataclass(frozen=True, slots=True)
class DeviceControl(Report):
    command: Annotated[Choice, OneOf("commands", COMMANDS)]


@dataclass(frozen=True, slots=True)
class DeviceGain(Report):
    gain: Annotated[Field, Number("Device Gain", 0x7E, scaled=True)]


@dataclass(frozen=True, slots=True)
class CreateNewEffect(Report):
    effect_type: Annotated[Choice, OneOf("Effect Type", EFFECT_TYPES, (("constant_force", "ET Constant Force"),))]


@dataclass(frozen=True, slots=True)
class BlockLoad(Report):
    effect_index: _EffectIndex
    status: Annotated[Choice | None, OneOf("", LOAD_STATUS, (("success", "Block Load Success"),))]
    """One that cannot report success is ignored: the index shows whether the effect is loaded."""


@dataclass(frozen=True, slots=True)
class BlockFree(Report):
    effect_index: _EffectIndex


@dataclass(frozen=True, slots=True)
class Pool(Report):
    simultaneous_effects_max: Annotated[Field | None, Number("Simultaneous Effects Max", 0x83)]


@dataclass(frozen=True, slots=True)
class PidState(Report):
    effect_index: Annotated[Field | None, Number("Effect Block Index", 0x22)]
    effect_playing: Annotated[Field | None, Number("Effect Playing", 0x94)]
    device_paused: Annotated[Field | None, Number("Device Paused", 0x9F)]
    actuators_enabled: Annotated[Field | None, Number("Actuators Enabled", 0xA0)]
    safety_switch: Annotated[Field | None, Number("Safety Switch", 0xA4)]
    actuator_power: Annotated[Field | None, Number("Actuator Power", 0xA6)]
    device_reset: Annotated[Field | None, Number("Device Reset", 0x9A)]


@dataclass(frozen=True, slots=True)
class SetPeriodic(Report):
    effect_index: _EffectIndex
    magnitude: Annotated[Field, Number("Magnitude", 0x70, scaled=True)]
    period: Annotated[Field, Number("Period", 0x72, scaled=True)]
    offset: Annotated[Field | None, Number("Offset", 0x6F, scaled=True)]
    phase: Annotated[Field | None, Number("Phase", 0x71, scaled=True)]


@dataclass(frozen=True, slots=True)
class SetEnvelope(Report):
    effect_index: _EffectIndex
    attack_level: Annotated[Field, Number("Attack Level", 0x5B, scaled=True)]
    attack_time: Annotated[Field, Number("Attack Time", 0x5C, scaled=True)]
    fade_level: Annotated[Field, Number("Fade Level", 0x5D, scaled=True)]
    fade_time: Annotated[Field, Number("Fade Time", 0x5E, scaled=True)]


@dataclass(frozen=True, slots=True)
class _Stands:
    """Where a report is looked for: fields of this kind in a collection of one of these usages."""

    name: str
    kind: ReportKind
    usages: tuple[int, ...]
    report: Callable[..., Report]
    is_needed: bool = True


_REPORTS: Final = {
    # The constant force first: where it stands, the others are looked for first.
    "constant_force": _Stands("Set Constant Force", ReportKind.OUTPUT, (0x73,), ConstantForce),
    "set_effect": _Stands("Set Effect", ReportKind.OUTPUT, (0x21,), SetEffect),
    "effect_operation": _Stands("Effect Operation", ReportKind.OUTPUT, (0x77,), EffectOperation),
    "device_control": _Stands("Device Control", ReportKind.OUTPUT, (0x96, 0x95), DeviceControl),
    "create_new_effect": _Stands("Create New Effect", ReportKind.FEATURE, (0xAB,), CreateNewEffect),
    "block_load": _Stands("PID Block Load", ReportKind.FEATURE, (0x89,), BlockLoad),
    "block_free": _Stands("PID Block Free", ReportKind.OUTPUT, (0x90,), BlockFree, False),
    "device_gain": _Stands("Device Gain", ReportKind.OUTPUT, (0x7D,), DeviceGain, False),
    "pid_state": _Stands("PID State", ReportKind.INPUT, (0x92,), PidState, False),
    "pool": _Stands("PID Pool", ReportKind.FEATURE, (0x7F,), Pool, False),
    "set_periodic": _Stands("Set Periodic", ReportKind.OUTPUT, (0x6E,), SetPeriodic, False),
    "set_envelope": _Stands("Set Envelope", ReportKind.OUTPUT, (0x5A,), SetEnvelope, False),
}


@dataclass(frozen=True, slots=True)
class Layout:
    """What would be driven. `usable`: nothing is missing, so that none of the needed reports is None."""

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
        return {"usable": self.usable, **dataclasses.asdict(self)}


def layout_of(descriptor: Descriptor) -> Layout:
    """Finds what would be driven. Never fails: what is not there is named in `missing`."""
    return _Finder(descriptor).layout()


# ---- Finding them ----------------------------------------------------------------------------------------------------


@cache
def _rows(report: Callable[..., Report]) -> tuple[dict[str, Row], dict[str, Row]]:
    """How the fields of a report are found, by their names: those that it needs, and the others."""
    needed: dict[str, Row] = {}
    others: dict[str, Row] = {}
    for name, hint in get_type_hints(report, include_extras=True).items():
        for row in getattr(hint, "__metadata__", ()):
            is_needed = not isinstance(row, Made) and NoneType not in get_args(hint.__origin__)
            (needed if is_needed else others)[name] = row
    return needed, others


def _read(group: Group, stands: _Stands) -> tuple[Report | None, list[str]]:
    """The report; None, and what it lacks, unless all that it needs is here."""
    needed, others = _rows(stands.report)
    found: dict[str, Any] = {}
    # Numbers before choices: problems are listed in this order.
    for name, row in sorted(needed.items(), key=lambda named: isinstance(named[1], OneOf)):
        found[name] = row.find(group)
        if not stands.is_needed and row.lacking(found[name]):
            return None, []
    lacking = [part for name, row in needed.items() for part in row.lacking(found[name])]
    if lacking:
        return None, lacking
    for name, row in others.items():
        found[name] = row.find(group)
        if row.lacking(found[name]):
            found[name] = None
    return stands.report(report_id=group.report_id, report_bytes=group.report_bytes, **found), []


class _Finder:
    def __init__(self, descriptor: Descriptor) -> None:
        self._descriptor = descriptor
        self._missing: list[str] = []
        self._problems = [f"{SKIPPED}{skipped}" for skipped in descriptor.skipped]
        self._root: int | None = None
        self._within: dict[int, list[tuple[Collection, ReportField]]] = {}
        for field in descriptor.fields:
            # The innermost collection of a usage stays.
            around = {one.usage: one for one in field.path}
            for usage, collection in around.items():
                self._within.setdefault(usage, []).append((collection, field))

    def layout(self) -> Layout:
        found: dict[str, Any] = {name: self._report(at) for name, at in _REPORTS.items() if at.is_needed}
        axes = self._axes()
        if not axes:
            self._missing.append("Joystick: X or Y")
        indices = _indices(part.effect_index for part in found.values() if hasattr(part, "effect_index"))
        force, effect = found["constant_force"], found["set_effect"]
        if indices is None and force is not None:
            self._missing.append("Effect Block Index")
        if effect is not None and force is not None and not force.magnitude.is_signed and not effect.direction:
            self._missing.append("Set Effect: Direction")
        found |= {name: self._report(at) for name, at in _REPORTS.items() if not at.is_needed}
        missing, problems = tuple(self._missing), tuple(dict.fromkeys(self._problems))
        return Layout(missing=missing, problems=problems, input=axes, effect_indices=indices, **found)

    def _report(self, stands: _Stands) -> Report | None:
        """The first complete one; else what the best one lacks is noted as missing, unless it can be done without."""
        lacking: list[str] = []
        for group in self._groups(stands):
            found, absent = _read(group, stands)
            self._problems += group.problems
            if found is not None:
                if stands.is_needed and self._root is None:
                    self._root = group.root
                return found
            lacking = lacking or [f"{stands.name}: {part}" for part in absent]
        if stands.is_needed:
            self._missing += lacking or [stands.name]
        return None

    def _groups(self, stands: _Stands) -> list[Group]:
        """Fields of this kind in collections of this usage, by collection and report id; the nearest ones first."""
        groups: dict[tuple[int, int], Group] = {}
        for usage in stands.usages:
            for around, field in self._within.get(PID | usage, ()):
                if field.kind == stands.kind:
                    self._put(groups, (around.number, field.report_id), field)
        return sorted(groups.values(), key=lambda group: group.root != self._root)

    def _put(self, groups: dict[tuple[int, int], Group], key: tuple[int, int], field: ReportField) -> None:
        """Adds the field to its group, unless its report cannot be identified."""
        if field.report_id == 0 and self._descriptor.numbered(field.kind):
            self._problems.append(
                f"{field.kind} report without an id, bit {field.bit_offset}: other {field.kind} reports have one"
            )
            return
        group = groups.get(key)
        if group is None:
            length = self._descriptor.report_bytes(field.kind, field.report_id)
            group = groups[key] = Group([], field.report_id, length, field.path[0].number)
        group.fields.append(field)

    def _axes(self) -> dict[str, Axis]:
        """Absolute numbers in the input reports of a joystick, gamepad or the like.

        Of several reports that have axes, one with both X and Y, in the collection of the forces if possible; what it
        lacks is taken from the others.
        """
        groups: dict[tuple[int, int], Group] = {}
        for field in self._descriptor.fields:
            # Some devices nest application collections that have no usage of their own.
            around = (c for c in reversed(field.path) if c.type == APPLICATION_COLLECTION and c.usage)
            application = next(around, None)
            if field.kind != ReportKind.INPUT or application is None or not field.is_variable:
                continue
            is_joystick = application.usage >> 16 == _SIMULATION_PAGE or application.usage in _JOYSTICKS
            if is_joystick and not field.is_relative and not field.is_constant:
                self._put(groups, (application.number, field.report_id), field)
        found = []
        for group in groups.values():
            axes = {}
            for name, usage in AXES.items():
                place = Number(name.capitalize(), DESKTOP | usage, scaled=True, fault=axis_fault).find(group)
                if place is not None:
                    axes[name] = Axis(name, group.report_bytes, place)
            self._problems += group.problems
            found.append((group.root != self._root, not {"x", "y"} <= set(axes), axes))
        found.sort(key=lambda entry: entry[:2])
        merged: dict[str, Axis] = {}
        for _, _, axes in found:
            merged = {**axes, **merged}
        return {name: merged[name] for name in AXES if name in merged}


def _indices(fields: Iterable[Field]) -> tuple[int, int] | None:
    """The block indices that all of them can carry; 0 means no effect."""
    fields = tuple(fields)
    first = max((field.logical_min for field in fields), default=0)
    last = min((field.logical_max for field in fields), default=0)
    return (max(first, 1), last) if max(first, 1) <= last else None
