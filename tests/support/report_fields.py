"""A report descriptor read by the HID specification alone, and numbers read out of reports bit by bit: what the fuzzer
of descriptors holds the reports against that the product makes, and what the simulated firmware
(tests/support/firmware.py)
reads its own descriptor with. It shares nothing with the product, and never fails: of what makes no sense it reads as
much as it can."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

INPUT, OUTPUT, FEATURE = 0x8, 0x9, 0xB
"""Tags of the main items that declare a field."""
_MOST_ELEMENTS: Final = 64
_REPORTS: Final = frozenset(
    0xF0000 | one
    for one in (
        *(0x21, 0x5A, 0x5F, 0x68, 0x6B, 0x6E, 0x73, 0x74, 0x77),
        *(0x7D, 0x7F, 0x85, 0x89, 0x90, 0x92, 0x95, 0x96, 0xAB),
    )
)


@dataclass(frozen=True, slots=True)
class Numbers:
    """Elements of one main item. The range is what the logical one leaves of the bits; empty: least > most."""

    tag: int
    at: int
    bits: int
    count: int
    least: int
    most: int
    is_signed: bool
    is_constant: bool
    is_variable: bool
    usages: tuple[tuple[int, int], ...]
    """First and last, page << 16 | usage."""
    inside: tuple[int, int]
    """The collection around it that stands for a report of the PID class: its number and usage; 0, 0: none."""
    around: tuple[int, ...]
    """Usages of all collections around it, the outermost first."""
    state: dict[int, tuple[int, int]]
    """Data and size of the global items that hold for it, by their tags."""

    @property
    def report(self) -> int:
        return _plain(self.state, 8)

    @property
    def logical(self) -> tuple[int, int]:
        return _range(self.state, 1)

    @property
    def physical(self) -> tuple[int, int]:
        return _range(self.state, 3)

    @property
    def unit(self) -> int:
        return _plain(self.state, 6)

    @property
    def exponent(self) -> int:
        number = _signed(self.state, 5)
        return number - 16 if 8 <= number < 16 else number

    def usage(self, element: int) -> int:
        """Of a variable field; the last one repeats; 0 without one."""
        for first, last in self.usages:
            if element <= last - first:
                return first + element
            element -= last - first + 1
        return self.usages[-1][1] if self.usages else 0

    def read(self, report: int, element: int) -> int:
        """Of a report without its id, as one number, the lowest byte first."""
        raw = report >> self.at + element * self.bits & (1 << self.bits) - 1
        return raw - (1 << self.bits) if self.is_signed and raw >> self.bits - 1 else raw

    @property
    def elements(self) -> range:
        return range(min(self.count, _MOST_ELEMENTS))


@dataclass(slots=True)
class Reports:
    """What reports a device has: fields and bits, by the tag of the item and the report id."""

    fields: dict[tuple[int, int], list[Numbers]] = field(default_factory=dict)
    bits: dict[tuple[int, int], int] = field(default_factory=dict)
    every: list[Numbers] = field(default_factory=list)
    """All fields, as they stand in the descriptor."""


def reports_of(descriptor: bytes) -> Reports:
    """Every report."""
    found = Reports()
    state: dict[int, tuple[int, int]] = {}  # a global item's data and its bytes
    stack: list[dict[int, tuple[int, int]]] = []
    usages: list[list[int]] = []  # first, last, 1 where the page is that of the item
    least: tuple[int, int] | None = None
    most: tuple[int, int] | None = None
    branch, depth, path, opened = 0, 0, [(0, 0)], 0
    around: tuple[int, ...] = ()
    at = 0
    while at < len(descriptor):
        head = descriptor[at]
        if head == 0xFE:
            at += 3 + (descriptor[at + 1] if at + 1 < len(descriptor) else 0)
            continue
        size = (0, 1, 2, 4)[head & 3]
        value = int.from_bytes(descriptor[at + 1 : at + 1 + size], "little")
        at += 1 + size
        tag, kind = head >> 4, head >> 2 & 3
        if kind == 1:
            if tag == 0xA:
                stack.append(dict(state))
            elif tag == 0xB and stack:
                state = stack.pop()
            else:
                state[tag] = (value, size)
        elif kind == 2:
            short = int(size < 4)
            whole = (_plain(state, 0) & 0xFFFF) << 16 | value if short else value
            if tag == 0 and branch == 0:
                usages.append([whole, whole, short])
                branch = depth
            elif tag == 1:
                least = (whole, short)
            elif tag == 2:
                most = (whole, short)
            elif tag == 0xA:
                depth, branch = int(value != 0), 0
            if least and most:
                usages.append([least[0], most[0] if least[0] <= most[0] else least[0] | 0xFFFF, most[1]])
                least = most = None
        elif kind == 0:
            for one in reversed(usages):
                page = (_plain(state, 0) & 0xFFFF) << 16
                if one[2] and one[0] & ~0xFFFF == page:
                    break
                if one[2]:
                    one[0], one[1] = page | one[0] & 0xFFFF, page | one[1] & 0xFFFF
            if tag == 0xA:
                opened += 1
                around = (*around, usages[0][0] if usages else 0)
                path.append((opened, around[-1]) if around[-1] in _REPORTS else path[-1])
            elif tag == 0xC and len(path) > 1:
                path.pop()
                around = around[:-1]
            elif tag in (INPUT, OUTPUT, FEATURE):
                _declare(found, tag, value, state, tuple((one[0], one[1]) for one in usages), path[-1], around)
            usages, least, most, branch, depth = [], None, None, 0, 0
    return found


def _declare(
    found: Reports,
    tag: int,
    flags: int,
    state: dict[int, tuple[int, int]],
    usages: tuple[tuple[int, int], ...],
    inside: tuple[int, int],
    around: tuple[int, ...],
) -> None:
    report, bits, count = (_plain(state, name) for name in (8, 7, 9))
    key = tag, report
    start = found.bits.get(key, 0)
    found.bits[key] = start + bits * count
    if not bits * count:
        return
    low, high = _range(state, 1)
    first, last = (-(1 << bits - 1), (1 << bits - 1) - 1) if low < 0 else (0, (1 << bits) - 1)
    one = Numbers(
        tag,
        start,
        bits,
        count,
        max(low, first),
        min(high, last),
        low < 0,
        bool(flags & 1),
        bool(flags & 2),
        usages,
        inside,
        around,
        dict(state),
    )
    found.fields.setdefault(key, []).append(one)
    found.every.append(one)


def _plain(state: dict[int, tuple[int, int]], tag: int) -> int:
    return state.get(tag, (0, 0))[0]


def _range(state: dict[int, tuple[int, int]], tag: int) -> tuple[int, int]:
    """A minimum is signed; a maximum is where its minimum is below zero."""
    least = _signed(state, tag)
    return least, _signed(state, tag + 1) if least < 0 else _plain(state, tag + 1)


def _signed(state: dict[int, tuple[int, int]], tag: int) -> int:
    value, size = state.get(tag, (0, 0))
    return value - (1 << 8 * size) if size and value >> 8 * size - 1 else value
