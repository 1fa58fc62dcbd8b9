"""Parser of HID report descriptors, according to the HID specification 1.11 (chapters 5 and 6.2.2).

An invalid item is an error, which names the item's byte. Items that Linux skips or accepts although the specification
does not define them are skipped or accepted here, too, and listed in `Descriptor.skipped`. If the specification is
ambiguous, the parser does what Linux does (drivers/hid/hid-core.c), because Linux has parsed the descriptor before:

- Minima are signed numbers. A maximum is signed if its minimum is negative, else unsigned: `15 00 25 FF` is 0 to 255.
  This is decided at the main item.
- A usage of one or two bytes has the usage page that is current at its item. If another page is current at the main
  item, that page replaces those of the usages, from the last one back to the first that already has it.
- Usages are assigned to the elements of a field in the order of their items, single usages and ranges alike. If there
  are fewer usages than elements, the last usage repeats; surplus usages are ignored.
- Only the first usage between delimiters, the preferred one, is used.
- If several usages precede a collection, the first of them is the collection's usage.
- A unit exponent of 8 to 15 stands for -8 to -1. A physical range of 0 to 0 is unset: the logical range is used.

The parser skips reserved items (type 3), unknown local items, unknown main items (which reset the local state, as any
main item does), long items (the specification defines none; Linux refuses them), and usage ranges that lack an end, end
before they begin or cross a page. Only the lowest 16 bits of a usage page are used. A set of alternative usages that is
open at a main item ends there. Unknown global items are errors, as in Linux. Zero bytes after the last collection are
padding.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hapticd.base.errors import HapticdError

MAX_DESCRIPTOR_BYTES: Final = 4096
"""The longest report descriptor that Linux accepts."""
MAX_REPORT_BYTES: Final = 16384
"""The longest report that Linux accepts."""
MAX_NESTING_DEPTH: Final = 64
"""Largest depth of nested collections, and of the stack of global items that Push fills."""

APPLICATION_COLLECTION: Final = 1
"""The type of an application collection: a device such as a joystick or a keyboard."""
IS_CONSTANT: Final = 0x01
IS_VARIABLE: Final = 0x02
IS_RELATIVE: Final = 0x04
"""Bits in the data of an Input, Output or Feature item."""

_LONG_ITEM_PREFIX: Final = 0xFE
_MAX_LISTED_SKIPS: Final = 16
"""`Descriptor.skipped` lists at most this many items; a last line counts the others."""


class DescriptorError(HapticdError):
    """Error for an invalid report descriptor; its text names the byte at which the item begins."""


class ReportKind(enum.StrEnum):
    """The kind of a report: input (from the device), output (to the device) or feature (read or set on request)."""

    INPUT = "input"
    OUTPUT = "output"
    FEATURE = "feature"


@dataclass(frozen=True, slots=True)
class Collection:
    """A collection of a descriptor; collections are numbered in the order in which they open."""

    number: int
    usage: int
    """Usage page << 16 | usage; 0 without a usage."""
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
    """The field that an Input, Output or Feature item declares: `count` elements of `bit_size` bits.

    Bits are counted from the lowest bit of the first byte after the report id. In a variable field each element has a
    usage and holds a number; in an array field each element holds `logical_min` plus the index of the active usage.
    """

    kind: ReportKind
    report_id: int
    """0 if reports have no ids."""
    bit_offset: int
    bit_size: int
    count: int
    usages: tuple[UsageRange, ...]
    """Usages in the order of elements (variable) or of indices (array); empty for padding."""
    logical_min: int
    logical_max: int
    physical_min: int
    physical_max: int
    is_physical_stale: bool
    """Whether the physical range was declared for an earlier field with another logical range, and never reset."""
    unit: int
    unit_exponent: int
    flags: int
    path: tuple[Collection, ...]
    """The collections that contain the field, the outermost first."""

    @property
    def is_constant(self) -> bool:
        """Whether the field is constant, not data."""
        return bool(self.flags & IS_CONSTANT)

    @property
    def is_variable(self) -> bool:
        """Whether the field is variable, not an array."""
        return bool(self.flags & IS_VARIABLE)

    @property
    def is_relative(self) -> bool:
        """Whether the values of the field are changes, not absolute values."""
        return bool(self.flags & IS_RELATIVE)

    def usage_at(self, index: int) -> int | None:
        """Return the usage of an element (variable) or of an index (array); None if it has no usage.

        In a variable field the last usage repeats.
        """
        for usages in self.usages:
            if index < len(usages):
                return usages.first + index
            index -= len(usages)
        return self.usages[-1].last if self.usages and self.is_variable else None

    def index_of(self, usage: int) -> int | None:
        """Return the first element (variable) or index (array) that has this usage; None without one."""
        base = 0
        for usages in self.usages:
            if usages.first <= usage <= usages.last:
                index = base + usage - usages.first
                return index if not self.is_variable or index < self.count else None
            base += len(usages)
        return None

    def within(self, usage: int) -> Collection | None:
        """Return the innermost collection around the field that has this usage; None without such a collection."""
        return next((collection for collection in reversed(self.path) if collection.usage == usage), None)


@dataclass(frozen=True, slots=True)
class Descriptor:
    """A parsed report descriptor."""

    fields: tuple[ReportField, ...]
    """Fields in the order of their items, except those of zero bits."""
    collections: tuple[Collection, ...]
    report_bits: dict[tuple[ReportKind, int], int]
    """Length of each report in bits, without the id, by kind and id."""
    skipped: tuple[str, ...] = ()
    """Items that deviate from the specification, one line each: byte, name, and how the item was treated."""

    def numbered(self, kind: ReportKind) -> bool:
        """Return whether reports of this kind begin with a report id."""
        return any(of == kind and report_id for of, report_id in self.report_bits)

    def report_bytes(self, kind: ReportKind, report_id: int) -> int:
        """Return the length of a report in bytes, including its id if it has one."""
        return (self.report_bits[kind, report_id] + 7) // 8 + (report_id != 0)


@dataclass(slots=True)
class _ItemData:
    """The data bytes of an item. Whether the number is signed is decided at the main item that uses it."""

    raw: int = 0
    size: int = 0

    @property
    def signed(self) -> int:
        bits = 8 * self.size
        return self.raw - (1 << bits) if bits and self.raw >> (bits - 1) else self.raw


@dataclass(slots=True)
class _Globals:
    numbers: dict[str, _ItemData] = dataclasses.field(default_factory=dict)
    """Data by the names of the global items; the default is 0."""
    usage_page: int = 0
    physical_of: tuple[int, int] | None = None
    """Logical range of the first field that followed the declaration of the physical range; None before that field."""

    def number(self, name: str) -> _ItemData:
        return self.numbers.get(name, _ItemData())

    def range(self, which: str) -> tuple[int, int]:
        """Return the "Logical" or "Physical" range, as minimum and maximum."""
        low, high = self.number(f"{which} Minimum").signed, self.number(f"{which} Maximum")
        return low, high.signed if low < 0 else high.raw


@dataclass(slots=True)
class _Usage:
    """A usage or a range of usages. `page` is the usage page at its item; None if the item itself includes the page."""

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
    """Whether a set of alternative usages is open (Delimiter)."""
    has_preferred: bool = False
    """Whether the preferred usage of that set, which is its first, has been read."""


# Names of the main, global and local items by their tags (chapters 6.2.2.4, 6.2.2.7 and 6.2.2.8).
_MAIN_ITEMS: Final = {0x8: "Input", 0x9: "Output", 0xA: "Collection", 0xB: "Feature", 0xC: "End Collection"}
_GLOBAL_ITEMS: Final = {
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
_LOCAL_ITEMS: Final = {
    0x0: "Usage",
    0x1: "Usage Minimum",
    0x2: "Usage Maximum",
    **dict.fromkeys((0x3, 0x4, 0x5), "Designator"),
    **dict.fromkeys((0x7, 0x8, 0x9), "String"),
    0xA: "Delimiter",
}
_ITEM_NAMES: Final[tuple[dict[int, str], ...]] = (_MAIN_ITEMS, _GLOBAL_ITEMS, _LOCAL_ITEMS, {})
"""Names of items by their type (main, global, local, reserved) and tag."""
_UNKNOWN_ITEM_NAMES: Final = ("unknown main item", "", "unknown local item", "reserved item")
"""Names of skipped items by their type; unknown global items are errors."""
_NAME_BY_PREFIX: Final = tuple(
    "long item"
    if prefix == _LONG_ITEM_PREFIX
    else _ITEM_NAMES[prefix >> 2 & 3].get(prefix >> 4, _UNKNOWN_ITEM_NAMES[prefix >> 2 & 3])
    for prefix in range(256)
)
"""The name of the item with each prefix byte; empty for an unknown global item."""
_REPORT_KINDS: Final = {"Input": ReportKind.INPUT, "Output": ReportKind.OUTPUT, "Feature": ReportKind.FEATURE}


def parse(data: bytes) -> Descriptor:
    """Parse a report descriptor. Raises DescriptorError."""
    if not data:
        raise DescriptorError("the report descriptor is empty")
    if len(data) > MAX_DESCRIPTOR_BYTES:
        raise DescriptorError(
            f"the report descriptor must have at most {MAX_DESCRIPTOR_BYTES} bytes (Linux), has {len(data)}"
        )
    parser = _Parser()
    for offset, name, number in _items(data, parser):
        parser.take(offset, name, number)
    return parser.finish(len(data))


def _error(offset: int, name: str, what: str) -> DescriptorError:
    return DescriptorError(f"report descriptor, byte {offset} ({name}): {what}")


def _items(data: bytes, parser: _Parser) -> Iterator[tuple[int, str, _ItemData]]:
    at, end = 0, len(data)
    while at < end:
        prefix = data[at]
        if prefix == 0 and parser.closed and not any(data[at:]):
            return
        name = _NAME_BY_PREFIX[prefix]
        if not name:
            raise _error(at, f"{prefix:02X}", "unknown global item, which Linux refuses, too")
        size = (0, 1, 2, 4)[prefix & 3]
        if prefix == _LONG_ITEM_PREFIX:
            size = 2 + data[at + 1] if at + 1 < len(data) else 2
        if at + 1 + size > end:
            raise _error(at, name, f"the descriptor ends after {end - at - 1} of the item's {size} bytes")
        yield at, name, _ItemData(int.from_bytes(data[at + 1 : at + 1 + min(size, 4)], "little"), size)
        at += 1 + size


class _Parser:
    """State of the parser: global and local items, open collections, and the length of each report."""

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
        """Whether at least one collection was opened, and all are closed."""
        return bool(self._collections) and not self._path

    def take(self, at: int, name: str, number: _ItemData) -> None:
        """Process one item of the descriptor: the item at byte `at`, with its name and its data."""
        state, value = self._global, number.raw
        if name in _MAIN_ITEMS.values():
            self._end_locals(at)
        match name:
            case "Input" | "Output" | "Feature":
                self._add_field(at, name, value)
            case "Collection":
                if len(self._path) >= MAX_NESTING_DEPTH:
                    raise _error(at, name, f"more than {MAX_NESTING_DEPTH} are nested")
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
                    self._skip(at, name, f"{value:#x} has more than 16 bits: used as {value & 0xFFFF:#x}")
                state.usage_page = value & 0xFFFF
            case "Report ID" if not 1 <= value <= 255:
                raise _error(at, name, f"must be between 1 and 255, is {value}")
            case "Push":
                if len(self._pushed) >= MAX_NESTING_DEPTH:
                    raise _error(at, name, f"more than {MAX_NESTING_DEPTH} are nested")
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
                    raise _error(at, name, "a set is already open" if value else "no set is open")
                self._local.in_set, self._local.has_preferred = bool(value), False
            case "unknown main item" | "unknown local item" | "reserved item" | "long item":
                self._skip(at, name, "skipped")
            case "Designator" | "String":
                pass  # body parts and texts, which do not matter here
            case _:
                state.numbers[name] = number
                if name in ("Physical Minimum", "Physical Maximum"):
                    state.physical_of = None
        if name in _MAIN_ITEMS.values() or name == "unknown main item":
            self._local = _Locals()

    def _skip(self, at: int, name: str, what: str) -> None:
        """Note an item that deviates from the specification and that Linux accepts, too."""
        self._skipped.append(f"byte {at} ({name}): {what}")

    def finish(self, end: int) -> Descriptor:
        """Return the parsed descriptor. Raises DescriptorError without collections, or if one is still open."""
        if self._path:
            raise DescriptorError(f"report descriptor: a collection is still open at its end (byte {end})")
        if not self._collections:
            raise DescriptorError("the report descriptor declares no collection, and so no device")
        skipped = self._skipped[:_MAX_LISTED_SKIPS]
        if len(self._skipped) > _MAX_LISTED_SKIPS:
            skipped.append(f"{len(self._skipped) - _MAX_LISTED_SKIPS} more items")
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
                self._skip(at, name, f"not a valid range, from {first.first:#x} to {last.first:#x}: skipped")
            else:
                self._take_usage(_Usage(first.first, last.first, last.page))

    def _take_usage(self, usage: _Usage) -> None:
        """Add a usage, unless a preferred alternative to it was already read."""
        local = self._local
        if not local.in_set or not local.has_preferred:
            local.usages.append(usage)
        local.has_preferred = local.in_set

    def _end_locals(self, at: int) -> None:
        """Complete the usages before the main item at this byte: apply the current usage page to them."""
        local = self._local
        if local.minimum is not None or local.maximum is not None:
            self._skip(at, "Usage Minimum", "a range without one of its ends: skipped")
        page_now = self._global.usage_page
        for usage in reversed(local.usages):
            if usage.page == page_now:
                break
            if usage.page is not None:
                usage.page = page_now

    def _add_field(self, at: int, name: str, value: int) -> None:
        state, kind = self._global, _REPORT_KINDS[name]
        report = (kind, state.number("Report ID").raw)
        size, count = state.number("Report Size").raw, state.number("Report Count").raw
        exponent = state.number("Unit Exponent")
        offset = self._bits.setdefault(report, 0)
        bits = size * count
        if offset + bits > 8 * MAX_REPORT_BYTES:
            raise _error(
                at, name, f"the report must have at most {MAX_REPORT_BYTES} bytes, has {(offset + bits + 7) // 8}"
            )
        if bits == 0:
            return
        self._bits[report] = offset + bits
        logical = state.range("Logical")
        if logical[0] > logical[1] and not value & IS_CONSTANT:
            raise _error(at, name, f"its logical minimum {logical[0]} is above its maximum {logical[1]}")
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
