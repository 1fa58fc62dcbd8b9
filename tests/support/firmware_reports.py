"""Reports as a simulated firmware reads them: its report descriptor by tests/support/report_fields.py, numbers bit by
bit, and names by the PID specification. Nothing of it is taken from the product."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from tests.support import report_fields
from tests.support.report_fields import Numbers, reports_of

PID: Final = 0x0F0000
DESKTOP: Final = 0x010000
INPUT, OUTPUT, FEATURE = "input", "output", "feature"
_KINDS: Final = {report_fields.INPUT: INPUT, report_fields.OUTPUT: OUTPUT, report_fields.FEATURE: FEATURE}

REPORTS: Final = {
    (INPUT, 0x92): "state",
    (OUTPUT, 0x21): "set_effect",
    (OUTPUT, 0x5A): "envelope",
    (OUTPUT, 0x5F): "condition",
    (OUTPUT, 0x6E): "periodic",
    (OUTPUT, 0x73): "constant_force",
    (OUTPUT, 0x74): "ramp",
    (OUTPUT, 0x77): "operation",
    (OUTPUT, 0x90): "block_free",
    (OUTPUT, 0x95): "control",
    (OUTPUT, 0x96): "control",
    (OUTPUT, 0x7D): "gain",
    (FEATURE, 0xAB): "create",
    (FEATURE, 0x89): "load",
    (FEATURE, 0x7F): "pool",
}
"""Reports by kind and the usage of the collection around them."""
USAGES: Final = {
    0x22: "index",
    0x23: "block",
    0x50: "duration",
    0x51: "sample_period",
    0x52: "gain",
    0x53: "trigger_button",
    0x54: "trigger_interval",
    0x56: "direction_enable",
    0x5B: "attack_level",
    0x5C: "attack_time",
    0x5D: "fade_level",
    0x5E: "fade_time",
    0x60: "center",
    0x61: "positive_coefficient",
    0x62: "negative_coefficient",
    0x63: "positive_saturation",
    0x64: "negative_saturation",
    0x65: "dead_band",
    0x6F: "offset",
    0x70: "magnitude",
    0x71: "phase",
    0x72: "period",
    0x75: "ramp_start",
    0x76: "ramp_end",
    0x7C: "loops",
    0x7E: "gain",
    0x80: "ram_pool_size",
    0x83: "simultaneous_effects_max",
    0x94: "playing",
    0x9A: "reset",
    0x9F: "paused",
    0xA0: "enabled",
    0xA4: "safety_switch",
    0xA5: "override_switch",
    0xA6: "power",
    0xA7: "start_delay",
    0xA9: "device_managed",
    0xAA: "shared_blocks",
    0xAC: "ram_pool_available",
}
CHOICES: Final = {
    0x26: "constant_force",
    0x27: "ramp",
    0x28: "custom_force",
    0x30: "square",
    0x31: "sine",
    0x32: "triangle",
    0x33: "sawtooth_up",
    0x34: "sawtooth_down",
    0x40: "spring",
    0x41: "damper",
    0x42: "inertia",
    0x43: "friction",
    0x79: "start",
    0x7A: "start_solo",
    0x7B: "stop",
    0x8C: "success",
    0x8D: "full",
    0x8E: "error",
    0x97: "enable_actuators",
    0x98: "disable_actuators",
    0x99: "stop_all_effects",
    0x9A: "device_reset",
    0x9B: "device_pause",
    0x9C: "device_continue",
}
"""Names that are chosen from, by an array or a bit for each."""
AXES: Final = {0x30: "x", 0x31: "y", 0x32: "z", 0x33: "rx", 0x34: "ry", 0x35: "rz"}


# ---- Report descriptor -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Place:
    """One number of a report: where its bits are, counted after the report id, and what the descriptor says of it."""

    kind: str
    report: int
    at: int
    bits: int
    usages: tuple[int, ...]
    """One, or those of an array."""
    is_array: bool
    is_constant: bool
    logical: tuple[int, int]
    physical: tuple[int, int]
    unit: int
    exponent: int
    inside: tuple[int, ...]
    """Usages of the collections around it, the outermost first."""

    def get(self, data: bytes) -> int:
        """The number in a report without its id."""
        raw = 0
        for bit in range(self.bits):
            at = self.at + bit
            raw |= (data[at // 8] >> at % 8 & 1) << bit
        return raw - (1 << self.bits) if self.logical[0] < 0 and raw >> self.bits - 1 else raw

    def put(self, data: bytearray, number: int) -> None:
        for bit in range(self.bits):
            at = self.at + bit
            data[at // 8] = data[at // 8] & ~(1 << at % 8) | (number >> bit & 1) << at % 8

    @property
    def ones(self) -> int:
        """All bits set."""
        return -1 if self.logical[0] < 0 else (1 << self.bits) - 1


def places_of(descriptor: bytes) -> list[Place]:
    """Reads a report descriptor, one place for each element of a field, in order."""
    return [place for one in reports_of(descriptor).every for place in _elements(one)]


def _elements(one: Numbers) -> Iterator[Place]:
    listed = tuple(usage for first, last in one.usages for usage in range(first, last + 1))
    for element in range(one.count):
        yield Place(
            _KINDS[one.tag],
            one.report,
            one.at + element * one.bits,
            one.bits,
            listed[min(element, len(listed) - 1) :][:1] if one.is_variable else listed,
            not one.is_variable,
            one.is_constant,
            one.logical,
            one.physical,
            one.unit,
            one.exponent,
            one.around,
        )


@dataclass
class Form:
    """A report: its places by name, choices and axes apart."""

    name: str
    kind: str
    report: int
    size: int
    """Bytes without the id."""
    numbers: dict[str, Place] = field(default_factory=dict)
    choices: dict[str, tuple[Place, int]] = field(default_factory=dict)
    """By name: a place, and the number that means it there."""
    axes: dict[str, Place] = field(default_factory=dict)
    directions: list[Place] = field(default_factory=list)

    def read(self, data: bytes) -> dict[str, float | str | bool]:
        """The numbers by name, as they are; `chosen` and `axes` as words with blanks between, `direction 0` and on."""
        found: dict[str, float | str | bool] = {name: place.get(data) for name, place in self.numbers.items()}
        chosen = [name for name, (place, number) in self.choices.items() if place.get(data) == number]
        found["chosen"] = " ".join(chosen)
        if self.axes:
            found["axes"] = " ".join(name for name, place in self.axes.items() if place.get(data))
        return found | {f"direction {n}": place.get(data) for n, place in enumerate(self.directions)}

    def write(self, chosen: str = "", **numbers: int) -> bytes:
        """A report of this form, its id first; what is not given is zero."""
        data = bytearray(self.size)
        for name, number in numbers.items():
            place = self.directions[0] if name == "direction" else self.numbers.get(name)
            if place is not None:
                place.put(data, number)
        if chosen in self.choices:
            place, number = self.choices[chosen]
            place.put(data, number)
        return bytes([self.report, *data])


def forms_of(places: list[Place]) -> dict[str, Form]:
    """The reports of the PID class, by name."""
    sizes: dict[tuple[str, int], int] = {}
    for place in places:
        key = place.kind, place.report
        sizes[key] = max(sizes.get(key, 0), (place.at + place.bits + 7) // 8)
    forms: dict[str, Form] = {}
    for place in places:
        names = [REPORTS[place.kind, usage & 0xFFFF] for usage in place.inside if _is_report(place.kind, usage)]
        if not names:
            continue
        form = forms.setdefault(names[0], Form(names[0], place.kind, place.report, sizes[place.kind, place.report]))
        if place.report == form.report and place.usages and not (place.is_constant and place.kind == OUTPUT):
            _enter(form, place)
    return forms


def _is_report(kind: str, usage: int) -> bool:
    return usage >> 16 == PID >> 16 and (kind, usage & 0xFFFF) in REPORTS


def _enter(form: Form, place: Place) -> None:
    usage = place.usages[0]
    page, number = usage & ~0xFFFF, usage & 0xFFFF
    within = {inside & 0xFFFF for inside in place.inside if inside & ~0xFFFF == PID}
    if place.is_array:
        for index, one in enumerate(place.usages):
            if one & ~0xFFFF == PID and one & 0xFFFF in CHOICES:
                form.choices.setdefault(CHOICES[one & 0xFFFF], (place, place.logical[0] + index))
        if usage == PID | 0xAC:  # some declare this number as an array
            form.numbers["ram_pool_available"] = place
    elif 0x57 in within or usage == PID | 0x57:
        form.directions.append(place)
    elif 0x58 in within:
        pass  # offsets into a memory that the device manages by itself
    elif page == DESKTOP and number in AXES:
        form.axes.setdefault(AXES[number], place)
    elif page == PID and number in CHOICES and form.kind == OUTPUT:
        form.choices.setdefault(CHOICES[number], (place, 1))
    elif page == PID and number in USAGES:
        form.numbers.setdefault(USAGES[number], place)
