"""How a field of a report is found: a number, a choice, or what is made of several.

`Number`, `OneOf` and `Made` are the rows of the table in layout.py; a `Group` is what they are looked for in. What is
found can be driven; what is there and cannot be is noted as a problem of the group.

A physical range that was given for another logical one, of an earlier field, is not taken for this one's: a duration
would become minutes. Where that is so the logical range counts, as without a physical one.

A field whose logical range is wider than its bits: refused where it carries a scale (axes, magnitudes), since the scale
is not known then; elsewhere the range is cut to what the bits hold.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticd.base.core import lib
from hapticd.hid.descriptor.fields import Choice, Entry, Field
from hapticd.hid.descriptor.parser import ReportField, ReportKind
from hapticd.hid.descriptor.usages import PID

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
    elsewhere: int | None = None
    """Another usage that some devices have for it."""
    scaled: bool = False
    """It carries a scale."""
    fault: Callable[[Field], str | None] | None = None
    """What else may be wrong with it."""

    def find(self, group: Group) -> Field | None:
        for usage in (self.usage, self.elsewhere):
            if usage is not None and (found := group.number(usage, self.scaled)) is not None:
                is_sound = self.fault is None or group.accept(found, self.name, self.fault(found))
                return found if is_sound else None
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
