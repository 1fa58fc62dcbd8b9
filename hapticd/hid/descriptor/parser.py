"""HID report descriptors, read item by item as the HID specification 1.11 (chapters 5 and 6.2.2) has it.

Nothing is guessed: what cannot be read is refused, with the byte at which the item stands. What Linux skips or takes
although the specification does not have it is skipped or taken here, too, and named in `Descriptor.skipped`. Where the
specification leaves room, this is how Linux reads (drivers/hid/hid-core.c), since Linux has read the descriptor before
we do:

- Minima are signed numbers. A maximum is signed if its minimum is negative, and unsigned if not: `15 00 25 FF` is
  0 to 255. This is decided where the field is declared, so the order of the two items does not matter.
- A usage of one or two bytes takes the usage page that holds where it stands. If another page follows the last usage,
  then that page holds for it, and for those before it back to the first that has that page already.
- Usages are dealt to the elements of a field in the order in which they stand, single ones and ranges alike. If there
  are fewer, the last one repeats; if there are more, the rest is dropped.
- Of the usages between delimiters the first, the preferred one, is taken; the others are skipped.
- A collection has the first of the usages before it.
- A unit exponent of 8 to 15 is a negative nibble; a physical range of 0 to 0 is absent, and the logical
  one counts.

Skipped are reserved items (type 3), unknown local items, unknown main items (which end the local state as any main item
does), long items (the specification defines none; Linux refuses them), and ranges of usages that lack an end, end
before they begin or go beyond a page. A usage page keeps its lowest 16 bits. A set of alternatives that is open at a
main item ends there. Unknown global items are refused, as by Linux. Zero bytes after the last collection are padding.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hapticd.base.errors import HapticdError

MAX_DESCRIPTOR_BYTES: Final = 4096
"""Linux takes no longer one."""
MAX_REPORT_BYTES: Final = 16384
"""Linux takes no longer one."""
MAX_DEPTH: Final = 64
"""Of collections, and of Push."""

APPLICATION_COLLECTION: Final = 1
"""The type of a collection that is a device: a joystick, a keyboard."""
IS_CONSTANT: Final = 0x01
IS_VARIABLE: Final = 0x02
IS_RELATIVE: Final = 0x04
"""Bits of an Input, Output or Feature item."""

_LONG_ITEM: Final = 0xFE
_MOST_LISTED: Final = 16


class DescriptorError(HapticdError):
    """A report descriptor that cannot be read; says where (the byte at which the item begins) and why."""


class ReportKind(enum.StrEnum):
    """What a report is for: to the computer, from it, or asked for and set."""

    INPUT = "input"
    OUTPUT = "output"
    FEATURE = "feature"


@dataclass(frozen=True, slots=True)
class Collection:
    """A collection. `number` counts them in the order in which they open, so two of the same usage differ."""

    number: int
    usage: int
    """Usage page << 16 | usage; 0 without one."""
    type: int


@dataclass(frozen=True, slots=True)
class UsageRange:
    """Consecutive usages (page << 16 | usage), both ends included."""

    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first + 1


@dataclass(frozen=True, slots=True)
class ReportField:
    """What one Input, Output or Feature item declares: `count` elements of `bit_size` bits.

    Bits are counted from the lowest bit of the first byte after the report id. In a variable field each element is a
    number of its own usage; in an array field each element holds `logical_min` + the index of the usage that is on.
    """

    kind: ReportKind
    report_id: int
    """0 where reports are not numbered."""
    bit_offset: int
    bit_size: int
    count: int
    usages: tuple[UsageRange, ...]
    """In the order of elements (variable) or of indices (array); empty for padding."""
    logical_min: int
    logical_max: int
    physical_min: int
    physical_max: int
    is_physical_stale: bool
    """The physical range was given for another logical one, and stands only because nothing took it back."""
    unit: int
    unit_exponent: int
    flags: int
    path: tuple[Collection, ...]
    """The collections around it, the outermost first."""

    @property
    def is_constant(self) -> bool:
        return bool(self.flags & IS_CONSTANT)

    @property
    def is_variable(self) -> bool:
        return bool(self.flags & IS_VARIABLE)

    @property
    def is_relative(self) -> bool:
        return bool(self.flags & IS_RELATIVE)

    def usage_at(self, index: int) -> int | None:
        """The usage of an element (variable) or of an index (array); the last one repeats in a variable field."""
        for usages in self.usages:
            if index < len(usages):
                return usages.first + index
            index -= len(usages)
        return self.usages[-1].last if self.usages and self.is_variable else None

    def index_of(self, usage: int) -> int | None:
        """The first element (variable) or index (array) that has this usage."""
        base = 0
        for usages in self.usages:
            if usages.first <= usage <= usages.last:
                index = base + usage - usages.first
                return index if not self.is_variable or index < self.count else None
            base += len(usages)
        return None

    def within(self, usage: int) -> Collection | None:
        """The innermost collection around it that has this usage."""
        return next((collection for collection in reversed(self.path) if collection.usage == usage), None)


@dataclass(frozen=True, slots=True)
class Descriptor:
    """A report descriptor, read."""

    fields: tuple[ReportField, ...]
    """In the order of their items; fields without a bit are left out."""
    collections: tuple[Collection, ...]
    report_bits: dict[tuple[ReportKind, int], int]
    """How long each report is by kind and id, without the id."""
    skipped: tuple[str, ...] = ()
    """What is not as the specification has it and does not matter, one line each: which byte, and what became of it."""

    def numbered(self, kind: ReportKind) -> bool:
        """Whether reports of this kind begin with their id."""
        return any(of == kind and report_id for of, report_id in self.report_bits)

    def report_bytes(self, kind: ReportKind, report_id: int) -> int:
        """The length of a report as it is read and written: with its id where it has one."""
        return (self.report_bits[kind, report_id] + 7) // 8 + (report_id != 0)


@dataclass(slots=True)
class _Number:
    """The data of an item whose sign is not known yet."""

    raw: int = 0
    size: int = 0

    @property
    def signed(self) -> int:
        bits = 8 * self.size
        return self.raw - (1 << bits) if bits and self.raw >> (bits - 1) else self.raw


@dataclass(slots=True)
class _Globals:
    numbers: dict[str, _Number] = dataclasses.field(default_factory=dict)
    """By the names of their items; what was not given is 0."""
    usage_page: int = 0
    physical_of: tuple[int, int] | None = None
    """The logical range of the field that the physical one was given for; None until there is one."""

    def number(self, name: str) -> _Number:
        return self.numbers.get(name, _Number())

    def range(self, which: str) -> tuple[int, int]:
        """From "Logical" or "Physical" Minimum to Maximum."""
        least, most = self.number(f"{which} Minimum").signed, self.number(f"{which} Maximum")
        return least, most.signed if least < 0 else most.raw


@dataclass(slots=True)
class _Usage:
    """A usage or a range of them, and the page that holds for it; `page` is None where the item has its own."""

    first: int
    last: int
    page: int | None

    def complete(self) -> UsageRange:
        page = (self.page or 0) << 16
        return UsageRange(page | self.first, page | self.last)


@dataclass(slots=True)
class _Locals:
    usages: list[_Usage] = dataclasses.field(default_factory=list)
    minimum: _Usage | None = None
    maximum: _Usage | None = None
    in_set: bool = False
    """A set of alternatives is open."""
    has_preferred: bool = False
    """Its first usage has been read."""


_MAIN: Final = {0x8: "Input", 0x9: "Output", 0xA: "Collection", 0xB: "Feature", 0xC: "End Collection"}
_GLOBAL: Final = {
    0x0: "Usage Page",
    0x1: "Logical Minimum",
    0x2: "Logical Maximum",
    0x3: "Physical Minimum",
    0x4: "Physical Maximum",
    0x5: "Unit Exponent",
    0x6: "Unit",
    0x7: "Report Size",
    0x8: "Report ID",
    0x9: "Report Count",
    0xA: "Push",
    0xB: "Pop",
}
_LOCAL: Final = {
    0x0: "Usage",
    0x1: "Usage Minimum",
    0x2: "Usage Maximum",
    **dict.fromkeys((0x3, 0x4, 0x5), "Designator"),
    **dict.fromkeys((0x7, 0x8, 0x9), "String"),
    0xA: "Delimiter",
}
_NAMES: Final[tuple[dict[int, str], ...]] = (_MAIN, _GLOBAL, _LOCAL, {})
_UNKNOWN: Final = ("unknown main item", "", "unknown local item", "reserved item")
"""What is skipped, by type; unknown global items are refused."""
_BY_PREFIX: Final = tuple(
    "long item" if one == _LONG_ITEM else _NAMES[one >> 2 & 3].get(one >> 4, _UNKNOWN[one >> 2 & 3])
    for one in range(256)
)
_KINDS: Final = {"Input": ReportKind.INPUT, "Output": ReportKind.OUTPUT, "Feature": ReportKind.FEATURE}


def parse(data: bytes) -> Descriptor:
    """Reads a report descriptor; raises DescriptorError."""
    if not data:
        raise DescriptorError("the report descriptor is empty")
    if len(data) > MAX_DESCRIPTOR_BYTES:
        raise DescriptorError(
            f"the report descriptor has {len(data)} bytes; the longest that Linux takes has {MAX_DESCRIPTOR_BYTES}"
        )
    parser = _Parser()
    for offset, name, number in _items(data, parser):
        parser.take(offset, name, number)
    return parser.finish(len(data))


def _error(offset: int, name: str, what: str) -> DescriptorError:
    return DescriptorError(f"report descriptor, byte {offset} ({name}): {what}")


def _items(data: bytes, parser: _Parser) -> Iterator[tuple[int, str, _Number]]:
    at, end = 0, len(data)
    while at < end:
        prefix = data[at]
        if prefix == 0 and parser.closed and not any(data[at:]):
            return
        name = _BY_PREFIX[prefix]
        if not name:
            raise _error(at, f"{prefix:02X}", "the HID specification knows no such global item, and Linux refuses it")
        size = (0, 1, 2, 4)[prefix & 3]
        if prefix == _LONG_ITEM:
            size = 2 + data[at + 1] if at + 1 < len(data) else 2
        if at + 1 + size > end:
            raise _error(at, name, f"the descriptor ends after {end - at - 1} of its {size} bytes")
        yield at, name, _Number(int.from_bytes(data[at + 1 : at + 1 + min(size, 4)], "little"), size)
        at += 1 + size


class _Parser:
    """The state of a reader: global and local items, open collections, and how far each report has come."""

    def __init__(self) -> None:
        self._global = _Globals()
        self._local = _Locals()
        self._pushed: list[_Globals] = []
        self._path: tuple[Collection, ...] = ()
        self._collections: list[Collection] = []
        self._fields: list[ReportField] = []
        self._bits: dict[tuple[ReportKind, int], int] = {}
        self._skipped: list[str] = []

    @property
    def closed(self) -> bool:
        """Every collection has ended, and there was one."""
        return bool(self._collections) and not self._path

    def take(self, at: int, name: str, number: _Number) -> None:
        """One item."""
        state, value = self._global, number.raw
        if name in _MAIN.values():
            self._end_locals(at)
        match name:
            case "Input" | "Output" | "Feature":
                self._add_field(at, name, value)
            case "Collection":
                if len(self._path) >= MAX_DEPTH:
                    raise _error(at, name, f"more than {MAX_DEPTH} are nested")
                first = self._local.usages[0].complete().first if self._local.usages else 0
                collection = Collection(len(self._collections), first, value)
                self._collections.append(collection)
                self._path = (*self._path, collection)
            case "End Collection":
                if not self._path:
                    raise _error(at, name, "no collection is open")
                self._path = self._path[:-1]
            case "Usage Page":
                if value > 0xFFFF:
                    self._skip(at, name, f"{value:#x} has more than 16 bits: taken for {value & 0xFFFF:#x}")
                state.usage_page = value & 0xFFFF
            case "Report ID" if not 1 <= value <= 255:
                raise _error(at, name, f"{value} is no report id; they go from 1 to 255")
            case "Push":
                if len(self._pushed) >= MAX_DEPTH:
                    raise _error(at, name, f"more than {MAX_DEPTH} are nested")
                self._pushed.append(dataclasses.replace(state, numbers=dict(state.numbers)))
            case "Pop":
                if not self._pushed:
                    raise _error(at, name, "nothing was pushed")
                self._global = self._pushed.pop()
            case "Usage" | "Usage Minimum" | "Usage Maximum":
                page = None if number.size == 4 else state.usage_page
                self._add_usage(at, name, _Usage(value, value, page))
            case "Delimiter":
                if bool(value) == self._local.in_set:
                    raise _error(at, name, f"{'another' if value else 'no'} set is open")
                self._local.in_set, self._local.has_preferred = bool(value), False
            case "unknown main item" | "unknown local item" | "reserved item" | "long item":
                self._skip(at, name, "skipped")
            case "Designator" | "String":
                pass  # where a hand is, and words
            case _:
                state.numbers[name] = number
                if name in ("Physical Minimum", "Physical Maximum"):
                    state.physical_of = None
        if name in _MAIN.values() or name == "unknown main item":
            self._local = _Locals()

    def _skip(self, at: int, name: str, what: str) -> None:
        """Notes what Linux does not mind either."""
        self._skipped.append(f"byte {at} ({name}): {what}")

    def finish(self, end: int) -> Descriptor:
        """What was read, if nothing is left open."""
        if self._path:
            raise DescriptorError(f"report descriptor: a collection is still open where it ends (byte {end})")
        if not self._collections:
            raise DescriptorError("the report descriptor declares no collection, so there is no device in it")
        skipped = self._skipped[:_MOST_LISTED]
        if len(self._skipped) > _MOST_LISTED:
            skipped.append(f"{len(self._skipped) - _MOST_LISTED} more items")
        return Descriptor(tuple(self._fields), tuple(self._collections), self._bits, tuple(skipped))

    def _add_usage(self, at: int, name: str, usage: _Usage) -> None:
        local = self._local
        if name == "Usage Minimum":
            local.minimum = usage
        elif name == "Usage Maximum":
            local.maximum = usage
        else:
            self._take_usage(usage)
        if local.minimum is not None and local.maximum is not None:
            first, last = local.minimum, local.maximum
            local.minimum = local.maximum = None
            if first.page != last.page or last.first < first.first or last.first >> 16 != first.first >> 16:
                self._skip(at, name, f"the range from {first.first:#x} to {last.first:#x} is none: skipped")
            else:
                self._take_usage(_Usage(first.first, last.first, last.page))

    def _take_usage(self, usage: _Usage) -> None:
        """Unless it is an alternative to another one."""
        local = self._local
        if not local.in_set or not local.has_preferred:
            local.usages.append(usage)
        local.has_preferred = local.in_set

    def _end_locals(self, at: int) -> None:
        """What usages stand before the main item at this byte is known now."""
        local = self._local
        if local.minimum is not None or local.maximum is not None:
            self._skip(at, "Usage Minimum", "a range without its other end: skipped")
        page_now = self._global.usage_page
        for usage in reversed(local.usages):
            if usage.page == page_now:
                break
            if usage.page is not None:
                usage.page = page_now

    def _add_field(self, at: int, name: str, value: int) -> None:
        state, kind = self._global, _KINDS[name]
        report = (kind, state.number("Report ID").raw)
        size, count = state.number("Report Size").raw, state.number("Report Count").raw
        exponent = state.number("Unit Exponent")
        offset = self._bits.setdefault(report, 0)
        bits = size * count
        if offset + bits > 8 * MAX_REPORT_BYTES:
            raise _error(at, name, f"the report becomes longer than {MAX_REPORT_BYTES} bytes")
        if bits == 0:
            return
        self._bits[report] = offset + bits
        logical = state.range("Logical")
        if logical[0] > logical[1] and not value & IS_CONSTANT:
            raise _error(at, name, f"its logical minimum {logical[0]} lies above its maximum {logical[1]}")
        physical = state.range("Physical")
        state.physical_of = state.physical_of or logical
        stale = physical != (0, 0) and state.physical_of != logical
        if physical == (0, 0):
            physical = logical
        self._fields.append(
            ReportField(
                kind=kind,
                report_id=report[1],
                bit_offset=offset,
                bit_size=size,
                count=count,
                usages=tuple(usage.complete() for usage in self._local.usages),
                logical_min=logical[0],
                logical_max=logical[1],
                physical_min=physical[0],
                physical_max=physical[1],
                is_physical_stale=stale,
                unit=state.number("Unit").raw,
                unit_exponent=exponent.raw - 16 if 8 <= exponent.raw <= 15 else exponent.signed,
                flags=value,
                path=self._path,
            )
        )
