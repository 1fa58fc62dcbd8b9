"""Report descriptors for tests: an assembler of items, and joysticks of the PID class with what real ones differ in."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

DESKTOP: Final = 0x01
BUTTON: Final = 0x09
ORDINAL: Final = 0x0A
PID: Final = 0x0F

DATA_ARRAY: Final = 0x00
CONSTANT: Final = 0x03
VARIABLE: Final = 0x02

PHYSICAL, APPLICATION, LOGICAL = 0, 1, 2

INPUT, OUTPUT, FEATURE = 0x80, 0x90, 0xB0
"""Prefixes of the items that declare a field, without their size."""

EFFECT_TYPES: Final = (0x26, 0x27, 0x30, 0x31, 0x32, 0x33, 0x34, 0x40, 0x41, 0x42, 0x43)


def item(prefix: int, value: int | None = None, size: int | None = None) -> bytes:
    """One short item. Without a size: the shortest in which the number reads the same signed and unsigned."""
    if value is None:
        return bytes([prefix])
    if size is None:
        size = next(n for n in (1, 2, 4) if -(1 << (8 * n - 1)) <= value < 1 << (8 * n - 1) or n == 4)
    return bytes([prefix | {0: 0, 1: 1, 2: 2, 4: 3}[size]]) + (value & (1 << 8 * size) - 1).to_bytes(size, "little")


def _unsigned(prefix: int, value: int) -> bytes:
    return item(prefix, value, 1 if value < 0x100 else 2 if value < 0x10000 else 4)


def usage_page(page: int) -> bytes:
    return _unsigned(0x04, page)


def usage(*usages: int) -> bytes:
    return b"".join(_unsigned(0x08, one) for one in usages)


def usage32(page: int, *usages: int) -> bytes:
    """Extended usages: the page stands in the item."""
    return b"".join(item(0x08, page << 16 | one, 4) for one in usages)


def usage_range(first: int, last: int) -> bytes:
    return _unsigned(0x18, first) + _unsigned(0x28, last)


def usage_range32(page: int, first: int, last: int) -> bytes:
    return item(0x18, page << 16 | first, 4) + item(0x28, page << 16 | last, 4)


def logical(least: int, most: int) -> bytes:
    return item(0x14, least) + item(0x24, most)


def physical(least: int, most: int) -> bytes:
    return item(0x34, least) + item(0x44, most)


def unit(value: int, exponent: int = 0) -> bytes:
    return _unsigned(0x64, value) + item(0x54, exponent)


def size(bits: int, count: int = 1) -> bytes:
    return _unsigned(0x74, bits) + _unsigned(0x94, count)


def report_id(number: int) -> bytes:
    return _unsigned(0x84, number) if number else b""


def push() -> bytes:
    return item(0xA4)


def pop() -> bytes:
    return item(0xB4)


def alternatives(*items: bytes) -> bytes:
    """A set of usages between delimiters."""
    return item(0xA8, 1) + b"".join(items) + item(0xA8, 0)


def data(kind: int, flags: int = VARIABLE) -> bytes:
    return _unsigned(kind, flags)


def pad(kind: int, bits: int) -> bytes:
    return size(bits) + data(kind, CONSTANT)


def collection(of: bytes, kind: int, *body: bytes) -> bytes:
    """`of` is what gives its usage, or nothing."""
    return of + item(0xA0, kind) + b"".join(body) + item(0xC0)


def value(kind: int, name: int, least: int, most: int, bits: int, count: int = 1) -> bytes:
    """A number of one usage of the current page, its physical range the same as the logical one."""
    return usage(name) + logical(least, most) + physical(least, most) + size(bits, count) + data(kind)


@dataclass(frozen=True)
class Joystick:
    """A joystick of the PID class; `bytes(Joystick(...))` is its report descriptor."""

    axes: tuple[int, ...] = (0x30, 0x31)
    """Usages in the order in which they stand in the input report."""
    axis_range: tuple[int, int] = (-32767, 32767)
    axis_bits: int = 16
    force_axes: tuple[int, ...] = (0x30, 0x31)
    """Usages of Axes Enable, in its order; none: no such collection."""
    magnitude: int = 10000
    magnitude_bits: int = 16
    is_magnitude_signed: bool = True
    direction_bits: int = 8
    """8: 0 to 255; 16: 0 to 35999. 0: there is no direction."""
    is_direction_signed: bool = False
    """-180 to 180 instead, in 16 bits."""
    directions: int = 2
    control: str = "array"
    """array or bits."""
    first_id: int = 1
    """Report ids are this one and the next ones, at most 33 together; see ids()."""
    indices: int = 40
    is_extended: bool = False
    """Usages of the PID page as 32-bit items."""
    is_pushed: bool = False
    """Global items that differ are put between Push and Pop."""
    without: frozenset[int] = field(default_factory=frozenset)
    """Usages of PID reports, or of fields of Set Effect, that it lacks."""
    time_exponent: int | None = None
    """Times are in units of ten to this, s. None: Set Effect's are ms, those of periodic effects have no unit."""
    level: int = 255
    """The largest magnitude and level of periodic effects."""
    is_split: bool = False
    """The PID collections stand in an application collection of their own."""

    def ids(self) -> dict[str, int]:
        """Report ids: `input` and the reports of each kind."""
        start = self.first_id
        names = (
            ("input", "state"),
            (
                "set_effect",
                "envelope",
                "periodic",
                "constant_force",
                "operation",
                "block_free",
                "control",
                "gain",
            ),
        )
        found = {name: start + number for group in names for number, name in enumerate(group)}
        return found | {name: start + number for number, name in enumerate(("create", "load", "pool"))}

    def __bytes__(self) -> bytes:
        stick = usage_page(DESKTOP) + usage(0x04)
        forces = self._forces()
        if self.is_split:
            apart = collection(usage_page(PID) + usage(0x01), APPLICATION, forces)
            return collection(stick, APPLICATION, self._input()) + apart
        return collection(stick, APPLICATION, self._input(), forces)

    def _pid(self, *usages: int) -> bytes:
        return usage32(PID, *usages) if self.is_extended else usage_page(PID) + usage(*usages)

    def _value(self, kind: int, name: int, least: int, most: int, bits: int) -> bytes:
        return self._pid(name) + logical(least, most) + physical(least, most) + size(bits) + data(kind)

    def _choice(self, kind: int, *usages: int) -> bytes:
        ranged = logical(1, len(usages)) + physical(1, len(usages)) + size(8)
        return self._pid(*usages) + ranged + data(kind, DATA_ARRAY)

    def _input(self) -> bytes:
        body = report_id(self.ids()["input"])
        body += usage(*self.axes) + logical(*self.axis_range) + physical(*self.axis_range)
        body += size(self.axis_bits, len(self.axes)) + data(INPUT)
        if self.axis_bits * len(self.axes) % 8:
            body += pad(INPUT, -self.axis_bits * len(self.axes) % 8)
        buttons = usage_page(BUTTON) + usage_range(1, 8) + logical(0, 1) + size(1, 8) + data(INPUT)
        return collection(usage(0x01), PHYSICAL, body) + buttons

    def _index(self, kind: int) -> bytes:
        return self._value(kind, 0x22, 1, self.indices, 8)

    def _forces(self) -> bytes:
        ids = self.ids()
        parts: dict[int, tuple[str, tuple[bytes, ...]]] = {
            0x92: ("state", self._state()),
            0x21: ("set_effect", self._set_effect()),
            0x5A: ("envelope", (self._index(OUTPUT), *self._levels())),
            0x6E: (
                "periodic",
                (
                    self._index(OUTPUT),
                    self._value(OUTPUT, 0x70, 0, self.level, 8 if self.level < 256 else 16),
                    self._value(OUTPUT, 0x6F, -127, 127, 8),
                    self._value(OUTPUT, 0x71, 0, 255, 8),
                    self._wave_time(0x72),
                ),
            ),
            0x73: ("constant_force", (self._index(OUTPUT), self._magnitude())),
            0x77: (
                "operation",
                (
                    self._index(OUTPUT),
                    collection(self._pid(0x78), LOGICAL, self._choice(OUTPUT, 0x79, 0x7A, 0x7B)),
                    self._value(OUTPUT, 0x7C, 0, 255, 8),
                ),
            ),
            0x90: ("block_free", (self._index(OUTPUT),)),
            0x96: ("control", (self._control(),)),
            0x7D: ("gain", (self._value(OUTPUT, 0x7E, 0, 255, 8),)),
            0xAB: (
                "create",
                (
                    collection(self._pid(0x25), LOGICAL, self._choice(FEATURE, *EFFECT_TYPES)),
                    usage_page(DESKTOP) + value(FEATURE, 0x3B, 0, 511, 10) + pad(FEATURE, 6),
                ),
            ),
            0x89: (
                "load",
                (
                    self._index(FEATURE),
                    collection(self._pid(0x8B), LOGICAL, self._choice(FEATURE, 0x8C, 0x8D, 0x8E)),
                    self._value(FEATURE, 0xAC, 0, 65535, 16),
                ),
            ),
            0x7F: (
                "pool",
                (
                    self._value(FEATURE, 0x80, 0, 65535, 16),
                    self._value(FEATURE, 0x83, 0, 255, 8),
                    self._pid(0xA9, 0xAA) + logical(0, 1) + size(1, 2) + data(FEATURE) + pad(FEATURE, 6),
                ),
            ),
        }
        built = b""
        for name, (number, body) in parts.items():
            if name not in self.without:
                built += collection(self._pid(name), LOGICAL, report_id(ids[number]), *body)
        return built

    def _state(self) -> tuple[bytes, ...]:
        flags = self._pid(0x9F, 0xA0, 0xA4, 0xA5, 0xA6) + logical(0, 1) + physical(0, 1) + size(1, 5) + data(INPUT)
        playing = self._value(INPUT, 0x94, 0, 1, 1)
        return (flags, pad(INPUT, 3), playing, self._value(INPUT, 0x22, 1, self.indices, 7))

    def _levels(self) -> tuple[bytes, ...]:
        return (
            *(self._value(OUTPUT, name, 0, self.level, 8 if self.level < 256 else 16) for name in (0x5B, 0x5D)),
            *(self._wave_time(name) for name in (0x5C, 0x5E)),
        )

    def _magnitude(self) -> bytes:
        least = -self.magnitude if self.is_magnitude_signed else 0
        return self._value(OUTPUT, 0x70, least, self.magnitude, self.magnitude_bits)

    def _control(self) -> bytes:
        commands = (0x97, 0x98, 0x99, 0x9A, 0x9B, 0x9C)
        if self.control == "array":
            return self._choice(OUTPUT, *commands)
        return self._pid(*commands) + logical(0, 1) + size(1, 6) + data(OUTPUT) + pad(OUTPUT, 2)

    def _set_effect(self) -> tuple[bytes, ...]:
        """Index, type, times, gain, trigger, axes, direction, delay; bits are filled up to whole bytes."""
        parts = {
            0x22: self._index(OUTPUT),
            0x25: collection(self._pid(0x25), LOGICAL, self._choice(OUTPUT, *EFFECT_TYPES)),
            0x50: self._time(0x50),
            0x54: self._time(0x54),
            0x51: self._time(0x51),
            0x52: self._value(OUTPUT, 0x52, 0, 255, 8),
            0x53: self._value(OUTPUT, 0x53, 1, 8, 8),
        }
        body = [part for name, part in parts.items() if name not in self.without]
        count = len(self.force_axes)
        if count:
            bits = usage_page(DESKTOP) + usage(*self.force_axes) + logical(0, 1) + size(1, count) + data(OUTPUT)
            body.append(collection(self._pid(0x55), LOGICAL, bits))
        if 0x56 not in self.without:
            body.append(self._value(OUTPUT, 0x56, 0, 1, 1))
            count += 1
        if count % 8:
            body.append(pad(OUTPUT, 8 - count % 8))
        if self.direction_bits:
            most = {8: 255, 16: 35999}[self.direction_bits]
            angle = usage32(ORDINAL, *range(1, self.directions + 1))
            if self.is_direction_signed:
                angle += logical(-180, 180) + physical(-18000, 18000)
            else:
                angle += logical(0, most) + physical(0, 36000)
            angle += unit(0x14, -2) + size(self.direction_bits, self.directions) + data(OUTPUT)
            if self.is_pushed:
                angle = push() + angle + pop()
            else:
                angle += unit(0) + physical(0, 0)
            body.append(collection(self._pid(0x57), LOGICAL, angle))
        if 0xA7 not in self.without:
            body.append(self._time(0xA7))
        return tuple(body)

    def _time(self, name: int) -> bytes:
        exponent = -3 if self.time_exponent is None else self.time_exponent
        if self.is_pushed:
            return push() + unit(0x1003, exponent) + self._value(OUTPUT, name, 0, 32767, 16) + pop()
        return unit(0x1003, exponent) + self._value(OUTPUT, name, 0, 32767, 16) + unit(0)

    def _wave_time(self, name: int) -> bytes:
        return self._value(OUTPUT, name, 0, 32767, 16) if self.time_exponent is None else self._time(name)
