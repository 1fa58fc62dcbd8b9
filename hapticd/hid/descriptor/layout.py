"""Finds the reports of the PID class and the axes of a joystick in a report descriptor.

Usages and names of reports are those of "Device Class Definition for Physical Interface Devices" 1.0. Everything else
comes from the descriptor: report ids, sizes, offsets, ranges, and whether commands are an array or bits.

Each report has a class, whose annotations define how its fields are found: the type of a member is `Field` or
`Choice`, with None if it is optional, and its rule is a `Number`, a `OneOf` or a `Computed`. `_PID_REPORTS` lists the
usages of each report's collection. To read another field, add a member to its report.

A rule searches a `Group`: the fields of one report in one collection. A field that exists but cannot be used is noted
as a problem of the group. Rules for descriptors that deviate from the specification:

- A physical range that was declared for an earlier field with another logical range is ignored, and the logical range
  is used. Otherwise a duration could become minutes.
- If the logical range of a field exceeds its bits, a field with a scale (axes, magnitudes) is refused, because its
  scale is not known. The range of any other field is limited to its bits.
- A report is identified by the collection around its fields, and its fields must share one report id. If a report
  occurs twice, a complete one is used, preferably in the outermost collection of Set Constant Force.
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

PID_PAGE: Final = 0x000F0000
DESKTOP_PAGE: Final = 0x00010000
"""The usage pages Physical Interface Device and Generic Desktop, shifted left by 16 bits."""
AXIS_USAGES: Final = {"x": 0x30, "y": 0x31, "z": 0x32, "rx": 0x33, "ry": 0x34, "rz": 0x35}
"""Usages of the axes on the page Generic Desktop."""

# Usages of effect types, operations, commands and load states on the PID page.
EFFECT_TYPE_USAGES: Final = {
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
OPERATION_USAGES: Final = {"start": 0x79, "start_solo": 0x7A, "stop": 0x7B}
DEVICE_CONTROL_USAGES: Final = {
    "enable_actuators": 0x97,
    "disable_actuators": 0x98,
    "stop_all_effects": 0x99,
    "device_reset": 0x9A,
    "device_pause": 0x9B,
    "device_continue": 0x9C,
}
LOAD_STATUS_USAGES: Final = {"success": 0x8C, "full": 0x8D, "error": 0x8E}

# ---- How a field is found --------------------------------------------------------------------------------------------

MAX_REPORT_BYTES: Final[int] = lib.HD_HID_REPORT_BYTES
"""Longest report that hapticd uses, in bytes, including the report id."""
MAX_FIELD_BITS: Final = 32
"""Widest field that hapticd uses, in bits."""


@dataclass(slots=True)
class Group:
    """The fields of one report in one collection of the descriptor, and the problems found with them."""

    fields: list[ReportField]
    report_id: int
    report_bytes: int
    root: int
    """The number of the outermost collection."""
    problems: list[str] = dataclasses.field(default_factory=list)

    def every(self, usage: int, inside: int | None = None) -> Iterator[tuple[ReportField, int]]:
        """Yield the fields with an element of the usage (page << 16 | usage), and the index of that element.

        Constant fields come last. `inside`, another usage, restricts the fields to those in a collection of that usage.
        """
        for constant in (False, True):
            for field in self.fields:
                if field.is_constant == constant and (inside is None or field.within(inside)):
                    index = field.index_of(usage)
                    if index is not None:
                        yield field, index

    def number(self, usage: int, scaled: bool) -> Field | None:
        """Return the first usable variable field with this usage; None without one. `scaled` as in `element`."""
        for field, index in self.every(usage if usage >> 16 else PID_PAGE | usage):
            found = self.element(field, index, scaled) if field.is_variable and not _is_fixed(field) else None
            if found is not None:
                return found
        return None

    def accept(self, field: Field, name: str, fault: str | None) -> bool:
        """Return True if `fault` is None; else return False and note the text `fault` as a problem of the field."""
        if fault is not None:
            kind = self.fields[0].kind
            self.problems.append(f"{kind} report {field.report_id}, bit {field.bit_offset} ({name}): {fault}")
        return fault is None

    def element(self, field: ReportField, index: int, scaled: bool) -> Field | None:
        """Return one element of a field; if it cannot be used, note a problem and return None.

        `scaled` says that the field has a scale, which its logical range must define.
        """
        offset, size = field.bit_offset + index * field.bit_size, field.bit_size
        fits = (-(1 << (size - 1)), (1 << (size - 1)) - 1) if field.logical_min < 0 else (0, (1 << size) - 1)
        low, high = max(field.logical_min, fits[0]), min(field.logical_max, fits[1])
        problem = None
        if size > MAX_FIELD_BITS:
            problem = f"it must have at most {MAX_FIELD_BITS} bits, has {size}"
        elif self.report_bytes > MAX_REPORT_BYTES:
            problem = f"its report must have at most {MAX_REPORT_BYTES} bytes, has {self.report_bytes}"
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
        """Return the choice among named usages: from the first array field that has one of them, else from flags."""
        for field in self.fields:
            if field.is_variable or _is_fixed(field):
                continue
            indices = {name: field.index_of(PID_PAGE | usage) for name, usage in names.items()}
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
            for field, index in self.every(PID_PAGE | usage):
                bit = self.element(field, index, scaled=False) if field.is_variable and not _is_fixed(field) else None
                on = bit.counts_when_on() if bit is not None else None
                if bit is not None and on is not None:
                    entries[name] = Entry(bit, on)
                    break
        return Choice("bits", entries) if entries else None


def _is_fixed(field: ReportField) -> bool:
    """Return whether a field is constant in an output report.

    In input and feature reports the flag Constant means that only the device sets the field.
    """
    return field.is_constant and field.kind == ReportKind.OUTPUT


def _flag_text(field: ReportField, report: tuple[ReportKind, int]) -> str:
    """Return where a flag is that cannot be set in a report, which is given by kind and id, and why not."""
    if (field.kind, field.report_id) != report:
        return f"it is in {field.kind} report {field.report_id}"
    why = "is constant" if field.is_constant else "is an array"
    if field.is_variable and not field.is_constant:
        why = f"has {field.bit_size} bits and the range {field.logical_min} to {field.logical_max}"
    return f"bit {field.bit_offset} of output report {field.report_id} {why}"


@dataclass(frozen=True, slots=True)
class Number:
    """Rule that finds a number: the first usable field with this usage. A usage without a page is on the PID page."""

    name: str
    usage: int
    scaled: bool = False
    """Whether the field has a scale, which its logical range must define."""
    fault: Callable[[Field], str | None] | None = None
    """An additional check of the range, which returns what is wrong with it."""

    def find(self, group: Group) -> Field | None:
        """Return the field of the number; None if the group has no usable field with this usage."""
        found = group.number(self.usage, self.scaled)
        if found is None or self.fault is None or group.accept(found, self.name, self.fault(found)):
            return found
        return None

    def lacking(self, found: object) -> list[str]:
        """Return [the name of the field] if `find` returned None, else []."""
        return [self.name] if found is None else []


@dataclass(frozen=True, slots=True)
class OneOf:
    """Rule that finds a choice among usages, for example among the commands of Device Control."""

    name: str
    usages: Mapping[str, int]
    needed: tuple[tuple[str, str], ...] = ()
    """Required entries, each with its name in the specification."""

    def find(self, group: Group) -> Choice | None:
        """Return the choice; None if the fields of the group have none of its usages."""
        return group.choice(self.usages)

    def lacking(self, found: object) -> list[str]:
        """Return the names of required entries that the choice `found` lacks; if it is None, the rule's name."""
        if found is None and self.name:
            return [self.name]
        return [name for entry, name in self.needed if not isinstance(found, Choice) or entry not in found.entries]


@dataclass(frozen=True, slots=True)
class Computed:
    """Rule that finds a member of a report by the function `find`, whose result may be empty."""

    find: Callable[[Group], object]

    def lacking(self, found: object) -> list[str]:
        """Return []: an empty result is valid."""
        return []


FieldRule: TypeAlias = Number | OneOf | Computed


# ---- The report descriptor -------------------------------------------------------------------------------------------

SKIPPED_ITEM_PREFIX: Final = "report descriptor, "
"""Prefix of a problem that concerns a skipped item of the descriptor, not a field of a report."""

_SIMULATION_PAGE: Final = 0x0002
"""The usage page Simulation Controls."""
_JOYSTICK_USAGES: Final = (DESKTOP_PAGE | 0x04, DESKTOP_PAGE | 0x05, DESKTOP_PAGE | 0x08)
"""Usages of the application collections Joystick, Game Pad and Multi-axis Controller."""
_VECTOR_USAGES: Final = tuple(DESKTOP_PAGE | usage for usage in (*range(0x30, 0x33), *range(0x40, 0x43)))
"""Usages of the components of a vector: X, Y, Z and Vx, Vy, Vz."""


# ---- Direction of an effect ------------------------------------------------------------------------------------------


def _axes_enable(group: Group) -> dict[str, Field]:
    """Return the flags of the field Axes Enable by the name of their axis (x, y, ...)."""
    enable = {}
    for name, usage in AXIS_USAGES.items():
        for field, index in group.every(DESKTOP_PAGE | usage, PID_PAGE | 0x55):
            element = group.element(field, index, scaled=False) if field.is_variable else None
            if element is not None and not field.is_constant and element.counts_when_on() is not None:
                enable[name] = element
                break
    return enable


def _directions(group: Group) -> Iterator[tuple[list[Field], bool]]:
    """Yield each set of fields that may hold an effect's direction, and whether the set is a vector's components."""
    for field in group.fields:
        # Its elements may have any usage: axes, or instances of the page Ordinals.
        inside = field.within(PID_PAGE | 0x57) or field.index_of(PID_PAGE | 0x57) is not None
        if inside and field.is_variable and not field.is_constant and field.usages:
            elements = [group.element(field, index, scaled=True) for index in range(min(field.count, len(AXIS_USAGES)))]
            is_vector = field.logical_min < 0 and field.usage_at(0) in _VECTOR_USAGES
            found = [element for element in elements if element is not None] if all(elements) else []
            if found and (is_vector or group.accept(found[0], "Direction", angle_fault(found[0]))):
                yield found, is_vector


def _direction(group: Group) -> tuple[Field, ...]:
    return tuple(field for found, _ in _directions(group) for field in found)[: len(AXIS_USAGES)]


def _is_direction_cartesian(group: Group) -> bool:
    return any(is_vector for _, is_vector in _directions(group))


# ---- The reports and their fields ------------------------------------------------------------------------------------

_EffectIndex = Annotated[Field, Number("Effect Block Index", 0x22)]


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis in an input report."""

    usage: str
    """x, y, z, rx, ry or rz."""
    report_bytes: int
    """Length of the report, with its id if it has one."""
    field: Field


@dataclass(frozen=True, slots=True)
class Report:
    """A report of the PID class, all of whose required fields were found in the descriptor."""

    report_id: int
    report_bytes: int
    """Length of the report, with its id if it has one."""


@dataclass(frozen=True, slots=True)
class SetEffect(Report):
    """Output report Set Effect: type, duration, direction and gain of an effect."""

    effect_index: _EffectIndex
    effect_type: Annotated[Choice, OneOf("Effect Type", EFFECT_TYPE_USAGES, (("constant_force", "ET Constant Force"),))]
    duration: Annotated[Field, Number("Duration", 0x50)]
    axes_enable: Annotated[Mapping[str, Field], Computed(_axes_enable)]
    """Flags of Axes Enable by axis (x, y, ...), possibly none."""
    direction: Annotated[tuple[Field, ...], Computed(_direction)]
    """Fields of the direction in the order of the report, possibly none. They are angles unless
    `is_direction_cartesian`: with Direction Enable the first is the polar angle, else there is one angle for each axis.
    """
    is_direction_cartesian: Annotated[bool, Computed(_is_direction_cartesian)]
    """Whether the fields of the direction are signed components of a vector."""
    direction_enable: Annotated[Field | None, Number("Direction Enable", 0x56)]
    gain: Annotated[Field | None, Number("Gain", 0x52)]
    trigger_button: Annotated[Field | None, Number("Trigger Button", 0x53)]
    trigger_repeat_interval: Annotated[Field | None, Number("Trigger Repeat Interval", 0x54)]
    sample_period: Annotated[Field | None, Number("Sample Period", 0x51)]
    start_delay: Annotated[Field | None, Number("Start Delay", 0xA7)]


@dataclass(frozen=True, slots=True)
class ConstantForce(Report):
    """Output report Set Constant Force: the magnitude of a constant force."""

    effect_index: _EffectIndex
    magnitude: Annotated[Field, Number("Magnitude", 0x70, scaled=True, fault=magnitude_fault)]


@dataclass(frozen=True, slots=True)
class EffectOperation(Report):
    """Output report Effect Operation: starts or stops an effect."""

    effect_index: _EffectIndex
    operation: Annotated[
        Choice, OneOf("", OPERATION_USAGES, (("start", "Op Effect Start"), ("stop", "Op Effect Stop")))
    ]
    loop_count: Annotated[Field | None, Number("Loop Count", 0x7C)]


@dataclass(frozen=True, slots=True)
class DeviceControl(Report):
    """Output report Device Control: reset, actuators, stop all effects."""

    command: Annotated[Choice, OneOf("commands", DEVICE_CONTROL_USAGES)]


@dataclass(frozen=True, slots=True)
class DeviceGain(Report):
    """Output report Device Gain: the gain of all effects."""

    gain: Annotated[Field, Number("Device Gain", 0x7E, scaled=True)]


@dataclass(frozen=True, slots=True)
class CreateNewEffect(Report):
    """Feature report Create New Effect: asks the device to allocate an effect."""

    effect_type: Annotated[Choice, OneOf("Effect Type", EFFECT_TYPE_USAGES, (("constant_force", "ET Constant Force"),))]


@dataclass(frozen=True, slots=True)
class BlockLoad(Report):
    """Feature report PID Block Load: the Effect Block Index of the effect that was created last."""

    effect_index: _EffectIndex
    status: Annotated[Choice | None, OneOf("", LOAD_STATUS_USAGES, (("success", "Block Load Success"),))]
    """Block Load Status; None if it cannot report success: then an index of 0 means that no effect was created."""


@dataclass(frozen=True, slots=True)
class BlockFree(Report):
    """Output report PID Block Free: frees an effect."""

    effect_index: _EffectIndex


@dataclass(frozen=True, slots=True)
class Pool(Report):
    """Feature report PID Pool: how many effects the device plays at a time."""

    simultaneous_effects_max: Annotated[Field | None, Number("Simultaneous Effects Max", 0x83)]


@dataclass(frozen=True, slots=True)
class PidState(Report):
    """Input report PID State: states of the device and of an effect."""

    effect_index: Annotated[Field | None, Number("Effect Block Index", 0x22)]
    effect_playing: Annotated[Field | None, Number("Effect Playing", 0x94)]
    device_paused: Annotated[Field | None, Number("Device Paused", 0x9F)]
    actuators_enabled: Annotated[Field | None, Number("Actuators Enabled", 0xA0)]
    safety_switch: Annotated[Field | None, Number("Safety Switch", 0xA4)]
    actuator_power: Annotated[Field | None, Number("Actuator Power", 0xA6)]
    device_reset: Annotated[Field | None, Number("Device Reset", 0x9A)]


@dataclass(frozen=True, slots=True)
class SetPeriodic(Report):
    """Output report Set Periodic: magnitude and period of a periodic effect."""

    effect_index: _EffectIndex
    magnitude: Annotated[Field, Number("Magnitude", 0x70, scaled=True)]
    period: Annotated[Field, Number("Period", 0x72, scaled=True)]
    offset: Annotated[Field | None, Number("Offset", 0x6F, scaled=True)]
    phase: Annotated[Field | None, Number("Phase", 0x71, scaled=True)]


@dataclass(frozen=True, slots=True)
class SetEnvelope(Report):
    """Output report Set Envelope: attack and fade of an effect."""

    effect_index: _EffectIndex
    attack_level: Annotated[Field, Number("Attack Level", 0x5B, scaled=True)]
    attack_time: Annotated[Field, Number("Attack Time", 0x5C, scaled=True)]
    fade_level: Annotated[Field, Number("Fade Level", 0x5D, scaled=True)]
    fade_time: Annotated[Field, Number("Fade Time", 0x5E, scaled=True)]


@dataclass(frozen=True, slots=True)
class _ReportRule:
    """Rule that finds a report: its class, its kind, and the usages (PID page) that its collection may have."""

    name: str
    kind: ReportKind
    usages: tuple[int, ...]
    report: Callable[..., Report]
    is_needed: bool = True


_PID_REPORTS: Final = {
    # Set Constant Force must be first: the others are preferably used from its outermost collection.
    "constant_force": _ReportRule("Set Constant Force", ReportKind.OUTPUT, (0x73,), ConstantForce),
    "set_effect": _ReportRule("Set Effect", ReportKind.OUTPUT, (0x21,), SetEffect),
    "effect_operation": _ReportRule("Effect Operation", ReportKind.OUTPUT, (0x77,), EffectOperation),
    "device_control": _ReportRule("Device Control", ReportKind.OUTPUT, (0x96, 0x95), DeviceControl),
    "create_new_effect": _ReportRule("Create New Effect", ReportKind.FEATURE, (0xAB,), CreateNewEffect),
    "block_load": _ReportRule("PID Block Load", ReportKind.FEATURE, (0x89,), BlockLoad),
    "block_free": _ReportRule("PID Block Free", ReportKind.OUTPUT, (0x90,), BlockFree, False),
    "device_gain": _ReportRule("Device Gain", ReportKind.OUTPUT, (0x7D,), DeviceGain, False),
    "pid_state": _ReportRule("PID State", ReportKind.INPUT, (0x92,), PidState, False),
    "pool": _ReportRule("PID Pool", ReportKind.FEATURE, (0x7F,), Pool, False),
    "set_periodic": _ReportRule("Set Periodic", ReportKind.OUTPUT, (0x6E,), SetPeriodic, False),
    "set_envelope": _ReportRule("Set Envelope", ReportKind.OUTPUT, (0x5A,), SetEnvelope, False),
}


@dataclass(frozen=True, slots=True)
class Layout:
    """The reports and axes of a descriptor. If the layout is `usable`, all required reports are present."""

    missing: tuple[str, ...]
    """Reports that a constant force needs and that are missing, named as in the specification; or "report: field"."""
    problems: tuple[str, ...]
    """Fields that exist but cannot be used, and why."""
    input: Mapping[str, Axis]
    """Axes by usage, in the order x, y, z, rx, ry, rz."""
    effect_indices: tuple[int, int] | None
    """First and last Effect Block Index that every report can hold; None if there is no such index."""
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
        """Whether the descriptor has every report that a constant force needs."""
        return not self.missing

    def to_dict(self) -> dict[str, object]:
        """Return the layout as a map for JSON; absent reports are null."""
        return {"usable": self.usable, **dataclasses.asdict(self)}


def layout_of(descriptor: Descriptor) -> Layout:
    """Find the reports and axes of a descriptor. `Layout.missing` lists missing reports; no error is raised."""
    return _LayoutFinder(descriptor).layout()


# ---- The search ------------------------------------------------------------------------------------------------------


@cache
def _field_rules(report: Callable[..., Report]) -> tuple[dict[str, FieldRule], dict[str, FieldRule]]:
    """Return two maps from the names of a report's fields to the rules that find them: required and optional fields."""
    needed: dict[str, FieldRule] = {}
    others: dict[str, FieldRule] = {}
    for name, hint in get_type_hints(report, include_extras=True).items():
        for field_rule in getattr(hint, "__metadata__", ()):
            is_needed = not isinstance(field_rule, Computed) and NoneType not in get_args(hint.__origin__)
            (needed if is_needed else others)[name] = field_rule
    return needed, others


def _find_report(group: Group, rule: _ReportRule) -> tuple[Report | None, list[str]]:
    """Return the report that a rule finds in a group, or None, and the names of missing required fields."""
    needed, others = _field_rules(rule.report)
    found: dict[str, Any] = {}
    # Numbers before choices, because problems are listed in this order.
    for name, field_rule in sorted(needed.items(), key=lambda named: isinstance(named[1], OneOf)):
        found[name] = field_rule.find(group)
        if not rule.is_needed and field_rule.lacking(found[name]):
            return None, []
    lacking = [part for name, field_rule in needed.items() for part in field_rule.lacking(found[name])]
    if lacking:
        return None, lacking
    for name, field_rule in others.items():
        found[name] = field_rule.find(group)
        if field_rule.lacking(found[name]):
            found[name] = None
    return rule.report(report_id=group.report_id, report_bytes=group.report_bytes, **found), []


class _LayoutFinder:
    """Searches one descriptor, and collects missing reports and unusable fields."""

    def __init__(self, descriptor: Descriptor) -> None:
        self._descriptor = descriptor
        self._missing: list[str] = []
        self._problems = [f"{SKIPPED_ITEM_PREFIX}{skipped}" for skipped in descriptor.skipped]
        self._root: int | None = None
        self._within: dict[int, list[tuple[Collection, ReportField]]] = {}
        for field in descriptor.fields:
            # Of nested collections with the same usage, the innermost one counts.
            around = {one.usage: one for one in field.path}
            for usage, collection in around.items():
                self._within.setdefault(usage, []).append((collection, field))

    def layout(self) -> Layout:
        found: dict[str, Any] = {name: self._report(at) for name, at in _PID_REPORTS.items() if at.is_needed}
        axes = self._axes()
        if not axes:
            self._missing.append("Joystick: X or Y")
        indices = _common_indices(part.effect_index for part in found.values() if hasattr(part, "effect_index"))
        force, effect = found["constant_force"], found["set_effect"]
        if indices is None and force is not None:
            self._missing.append("Effect Block Index")
        if effect is not None and force is not None and not force.magnitude.is_signed and not effect.direction:
            self._missing.append("Set Effect: Direction")
        if effect is not None:
            self._missing += self._unwritable_flags(effect, force is None or force.magnitude.is_signed)
        found |= {name: self._report(at) for name, at in _PID_REPORTS.items() if not at.is_needed}
        missing, problems = tuple(self._missing), tuple(dict.fromkeys(self._problems))
        return Layout(missing=missing, problems=problems, input=axes, effect_indices=indices, **found)

    def _report(self, rule: _ReportRule) -> Report | None:
        """Return the first complete report that a rule finds. If a required report is absent, note what is missing."""
        lacking: list[str] = []
        for group in self._groups(rule):
            found, absent = _find_report(group, rule)
            self._problems += group.problems
            if found is not None:
                if rule.is_needed and self._root is None:
                    self._root = group.root
                return found
            lacking = lacking or [f"{rule.name}: {part}" for part in absent]
        if rule.is_needed:
            self._missing += lacking or [rule.name]
        return None

    def _unwritable_flags(self, effect: SetEffect, is_signed: bool) -> Iterator[str]:
        """Yield the flags of a direction that Set Effect has, but that cannot be set although a force needs them.

        With Direction Enable, Axes Enable does not matter. Without it, the axes of a force are enabled, and magnitudes
        must be signed: firmware of the Arduino family declares Direction Enable as constant. `is_signed`: they are.
        """
        fields, own = self._within[PID_PAGE | 0x21], (ReportKind.OUTPUT, effect.report_id)
        groups = {at.number for at, field in fields if (field.kind, field.report_id) == own}
        inside = [field for at, field in fields if at.number in groups]
        has_enable = effect.direction_enable is not None and effect.direction_enable.counts_when_on() is not None
        axes = effect.axes_enable.keys()
        for field in () if has_enable else inside:
            is_needed = not axes or not is_signed or not _is_fixed(field)
            if is_needed and field.index_of(PID_PAGE | 0x56) is not None:
                yield f"Set Effect: Direction Enable that can be set ({_flag_text(field, own)})"
        for name, usage in () if {"x", "y"} <= axes or (has_enable and not axes) else AXIS_USAGES.items():
            for field in () if name in axes else inside:
                if field.within(PID_PAGE | 0x55) and field.index_of(DESKTOP_PAGE | usage) is not None:
                    yield f"Set Effect: Axes Enable {name.upper()} that can be set ({_flag_text(field, own)})"

    def _groups(self, rule: _ReportRule) -> list[Group]:
        """Return the groups that may hold a report, those in the outermost collection of Set Constant Force first."""
        groups: dict[tuple[int, int], Group] = {}
        for usage in rule.usages:
            for around, field in self._within.get(PID_PAGE | usage, ()):
                if field.kind == rule.kind:
                    self._put(groups, (around.number, field.report_id), field)
        return sorted(groups.values(), key=lambda group: group.root != self._root)

    def _put(self, groups: dict[tuple[int, int], Group], key: tuple[int, int], field: ReportField) -> None:
        """Add a field to the group `key`; note a problem if its report has no id although other reports have one."""
        if field.report_id == 0 and self._descriptor.numbered(field.kind):
            self._problems.append(
                f"{field.kind} report without an id, bit {field.bit_offset}: other {field.kind} reports have an id"
            )
            return
        group = groups.get(key)
        if group is None:
            length = self._descriptor.report_bytes(field.kind, field.report_id)
            group = groups[key] = Group([], field.report_id, length, field.path[0].number)
        group.fields.append(field)

    def _axes(self) -> dict[str, Axis]:
        """Return the absolute axes in the input reports of joysticks and similar devices.

        If several reports have an axis, reports in the outermost collection of Set Constant Force are preferred, then
        reports with both X and Y.
        """
        groups: dict[tuple[int, int], Group] = {}
        for field in self._descriptor.fields:
            # Some devices nest application collections that have no usage.
            around = (c for c in reversed(field.path) if c.type == APPLICATION_COLLECTION and c.usage)
            application = next(around, None)
            if field.kind != ReportKind.INPUT or application is None or not field.is_variable:
                continue
            is_joystick = application.usage >> 16 == _SIMULATION_PAGE or application.usage in _JOYSTICK_USAGES
            if is_joystick and not field.is_relative and not field.is_constant:
                self._put(groups, (application.number, field.report_id), field)
        found = []
        for group in groups.values():
            axes = {}
            for name, usage in AXIS_USAGES.items():
                element = Number(name.capitalize(), DESKTOP_PAGE | usage, scaled=True, fault=axis_fault).find(group)
                if element is not None:
                    axes[name] = Axis(name, group.report_bytes, element)
            self._problems += group.problems
            found.append((group.root != self._root, not {"x", "y"} <= set(axes), axes))
        found.sort(key=lambda entry: entry[:2])
        merged: dict[str, Axis] = {}
        for _, _, axes in found:
            merged = {**axes, **merged}
        return {name: merged[name] for name in AXIS_USAGES if name in merged}


def _common_indices(fields: Iterable[Field]) -> tuple[int, int] | None:
    """Return the first and the last Effect Block Index, from 1, that all fields can hold; None if no index fits."""
    fields = tuple(fields)
    first = max((field.logical_min for field in fields), default=0)
    last = min((field.logical_max for field in fields), default=0)
    return (max(first, 1), last) if max(first, 1) <= last else None
