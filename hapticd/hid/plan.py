"""The plan of a connection as data: the fields of positions in input reports, and the reports that carry a force.

A driver makes the plan (drivers/pid.py, drivers/vendor.py), which is passed to C as `struct hd_hid_plan`;
csrc/api/hd_api_device.h describes each member. Reports are bytes that begin with the report id, or with 0 if reports
have no ids; bits are counted from the next byte.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, TypeVar

import numpy.typing as npt

from hapticd.base.core import CData, HidMeaning, HidQuantity, Status, ffi, lib
from hapticd.base.errors import HapticdError
from hapticd.hid.signs import Signs

Counts = TypeVar("Counts", float, npt.NDArray[Any])

STILL_AXIS_M_PER_COUNT: Final = 1e-15
"""Position step of the missing axis of a handle with one axis: its motion is negligible at any count."""


class DeviceError(HapticdError):
    """Error of a device that is absent or gone, refuses a report, or cannot be driven; its text is one line."""


class UndrivableError(DeviceError):
    """Error of a connected device that cannot be driven, so that trying again is useless."""


@dataclass(frozen=True, slots=True)
class Bits:
    """A bit field of a report; its offset is counted from the lowest bit of the byte after the report id."""

    bit_offset: int
    bit_size: int
    signed: bool
    big_endian: bool = False

    @property
    def end(self) -> int:
        """Offset, in bits, of the first bit after this bit field."""
        return self.bit_offset + self.bit_size

    @property
    def min_counts(self) -> int:
        """The smallest number that the field can hold."""
        return -(1 << (self.bit_size - 1)) if self.signed else 0

    @property
    def max_counts(self) -> int:
        """The largest number that the field can hold."""
        return (1 << (self.bit_size - self.signed)) - 1

    def put(self, report: bytearray, counts: int) -> None:
        """Write a number into a report (id first).

        Raises ValueError if the number does not fit into the field, or the field lies beyond the report.
        """
        field = ffi.new("struct hd_hid_field *", _c_members(self))
        buffer = ffi.from_buffer("uint8_t[]", report, require_writable=True)
        if lib.hd_bits_put(field, buffer, len(report), counts) != Status.OK:
            raise ValueError(f"bit {self.bit_offset} to {self.end - 1} of {len(report) - 1} bytes: cannot be {counts}")

    def get(self, report: bytes) -> int:
        """Read the number from a report (id first). Raises ValueError if the field lies beyond the report."""
        field, counts = ffi.new("struct hd_hid_field *", _c_members(self)), ffi.new("int64_t *")
        if lib.hd_bits_get(field, ffi.from_buffer("uint8_t[]", report), len(report), counts) != Status.OK:
            raise ValueError(f"bit {self.end - 1} lies beyond a report of {len(report) - 1} bytes")
        return int(counts[0])


@dataclass(frozen=True, slots=True)
class AxisPlan:
    """The position field of an axis. A position in m is (counts - zero_counts) * m_per_count."""

    bits: Bits
    report_id: int
    zero_counts: float
    m_per_count: tuple[float, float]
    """The step of one count below and above `zero_counts`: the halves of the travel may have different steps."""

    def position_m(self, counts: float) -> float:
        """Return the position at a count."""
        off = counts - self.zero_counts
        return off * self.m_per_count[bool(off > 0.0)]

    def counts(self, position_m: float) -> float:
        """Return the count at a position: the inverse of `position_m`."""
        return self.zero_counts + position_m / self.m_per_count[bool(position_m * self.m_per_count[0] > 0.0)]

    def range_counts(self, low_m: float, high_m: float) -> tuple[int, int]:
        """Return the smallest and the largest count between two positions."""
        low, high = sorted((round(self.counts(low_m)), round(self.counts(high_m))))
        return low, high

    @property
    def is_still(self) -> bool:
        """Whether the device does not report this axis, so that the handle does not move along it."""
        return self.m_per_count[0] == STILL_AXIS_M_PER_COUNT


@dataclass(frozen=True, slots=True)
class Value:
    """A number in a message: quantity * counts_per_unit + zero_counts, from `min_counts` to `max_counts`, rounded.

    If the quantity is the force along one axis, the force along the other axis times `counts_per_other_n` is added.
    """

    bits: Bits
    quantity: HidQuantity
    counts_per_unit: float
    zero_counts: float
    min_counts: float
    max_counts: float
    counts_per_other_n: float = 0.0


@dataclass(frozen=True, slots=True)
class Message:
    """An output report as a template, and the numbers that are written into it."""

    data: bytes
    values: tuple[Value, ...] = ()

    def at_rest(self) -> bytes:
        """Return the report for a force of zero."""
        report = bytearray(self.data)
        for value in self.values:
            value.bits.put(report, min(max(round(value.zero_counts), round(value.min_counts)), round(value.max_counts)))
        return bytes(report)

    def for_c(self) -> dict[str, object]:
        """Return the message as the members of C's `struct hd_hid_message`."""
        values = [_c_members(value) for value in self.values]
        return {"length": len(self.data), "bytes": self.data, "value_count": len(values), "values": values}


@dataclass(frozen=True, slots=True)
class StateBit:
    """The field of an input report for a state of the device, for example whether the actuators are on."""

    bits: Bits
    report_id: int
    meaning: HidMeaning


@dataclass(frozen=True, slots=True)
class PlayingBits:
    """The fields Effect Block Index and Effect Playing of an input report (PID State)."""

    index: Bits
    playing: Bits
    report_id: int
    indices: tuple[int, ...]
    """Effect Block Indices of hapticd's effects."""
    proof: int
    """Number of consecutive renewals, longer in total than an effect, after which reports of lost effects are trusted:
    the device has reported over these renewals that an effect plays. Before, only the first reported loss counts,
    because some devices do not report that a renewal restarts an effect."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The scale of a field: counts = quantity * counts_per_unit + zero_counts, from `min_counts` to `max_counts`."""

    bits: Bits
    counts_per_unit: float
    zero_counts: float
    min_counts: int
    max_counts: int

    @property
    def resolution(self) -> float:
        """The change of the field's quantity by one count."""
        return 1.0 / self.counts_per_unit

    def counts(self, quantity: float) -> int:
        """Return the nearest count to a quantity, within the limits."""
        return min(max(round(quantity * self.counts_per_unit + self.zero_counts), self.min_counts), self.max_counts)

    def quantity(self, counts: Counts) -> Counts:
        """Return the quantity that a count stands for, or each count of an array."""
        return (counts - self.zero_counts) / self.counts_per_unit


@dataclass(frozen=True, slots=True)
class PeriodicScales:
    """The scales of the fields of a periodic effect: times in s, levels in N."""

    duration: Scale
    attack_time: Scale
    fade_time: Scale
    period: Scale
    magnitude: Scale
    attack_level: Scale
    fade_level: Scale

    @property
    def levels(self) -> tuple[Scale, Scale, Scale]:
        """The scales of attack level, magnitude and fade level."""
        return self.attack_level, self.magnitude, self.fade_level


@dataclass(frozen=True, slots=True)
class PeriodicBlock:
    """The reports of one periodic effect that was created on the device, without its times and levels."""

    set_effect: Message
    """Set Effect, into which the direction of the force is written."""
    envelope: bytes
    periodic: bytes
    start: Message
    stop: Message


@dataclass(frozen=True, slots=True)
class Periodic:
    """The periodic effects that were created on the device, to be played in place of modes."""

    scales: PeriodicScales
    blocks: tuple[PeriodicBlock, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan of a connection: the fields of input reports, the output reports (messages), and their timing."""

    x: AxisPlan
    y: AxisPlan
    force: tuple[Message, ...]
    """Messages that carry each new force, sent in this order."""
    renew: tuple[Message, ...]
    """Messages that are sent every `renew_s`, so that effects do not end by their finite duration."""
    stop: tuple[Message, ...]
    """Messages that are sent at an orderly end, after a force of zero."""
    begin: tuple[Message, ...] = ()
    """Messages that are sent once, before the first force."""
    restore: tuple[Message, ...] = ()
    """Messages with the parameters of effects that another program may have changed. They are sent one at a time, in
    turn, to a device that does not report which effects play."""
    effects: PlayingBits | None = None
    """The fields by which the device reports the loss of an effect; None if it does not report this."""
    states: tuple[StateBit, ...] = ()
    on_change: bool = False
    """Whether the device reports only changes."""
    renew_s: float = 0.04
    restore_s: float = 0.04
    """Interval between two messages of `restore`."""
    foreign_effect_s: float | None = None
    """The longest time for which another program's effect can replace hapticd's, if the device does not report which
    effects play; None without effects. Until `link.plan_paced_for_link` sets it, only renewals are considered."""
    write_interval_s: float = 0.0
    """Shortest interval between two output reports; 0 means as fast as the device accepts them."""
    periodic: Periodic | None = None
    no_periodic: str = "the device has no periodic effects"
    """Why `periodic` is None."""
    leak: float = 0.0
    """Largest fraction of a force that acts at right angles to the force, because directions are rounded to counts."""
    signs: Signs | None = None
    """Parameters of the check whether forces push the right way, before the scene's first force; None: no check."""

    @property
    def resolution_m(self) -> float:
        """The largest position step of one count, in m."""
        return max(map(abs, (*self.x.m_per_count, *self.y.m_per_count)))

    @property
    def leak_text(self) -> str:
        """A text for users about `leak`, the force at right angles; empty if `leak` is below a thousandth."""
        if self.leak < 1e-3:
            return ""
        return f"one effect for both axes: up to {100.0 * self.leak:.2g} % of a force acts at right angles to it"

    @property
    def driven_axes(self) -> tuple[bool, bool]:
        """For x and y: whether the device has both a position and a force along the axis."""
        steps_n = self.force_steps_n
        return (
            not self.x.is_still and steps_n[0] > 0.0,
            not self.y.is_still and steps_n[1] > 0.0,
        )

    @property
    def force_steps_n(self) -> tuple[float, float]:
        """The force steps of one count along x and along y, in N; 0 if no message contains that force."""
        values = [value for message in self.force for value in message.values]
        x, y = (
            max((1.0 / abs(value.counts_per_unit) for value in values if value.quantity in quantities), default=0.0)
            for quantities in ((HidQuantity.X, HidQuantity.MAGNITUDE), (HidQuantity.Y, HidQuantity.MAGNITUDE))
        )
        return x, y

    def to_c(self) -> CData:
        """Return the plan as `struct hd_hid_plan *`. Raises DeviceError if it has more than the struct can hold."""

        def script(messages: Sequence[Message]) -> dict[str, object]:
            return {"count": len(messages), "messages": [message.for_c() for message in messages]}

        effects = {} if self.effects is None else {**_c_members(self.effects), "count": len(self.effects.indices)}
        plan = {
            "axes": [_c_members(self.x), _c_members(self.y)],
            "begin": script(self.begin),
            "force": script(self.force),
            "renew": script(self.renew),
            "restore": script(self.restore),
            "stop": script(self.stop),
            "effects": effects,
            "states": [_c_members(state) for state in self.states],
            "state_count": len(self.states),
            "signs": {} if self.signs is None else _c_members(self.signs),
            "on_change": self.on_change,
            "renew_ns": round(self.renew_s * 1e9),
            "restore_ns": round(self.restore_s * 1e9),
            "write_interval_ns": round(self.write_interval_s * 1e9),
        }
        try:
            return ffi.new("struct hd_hid_plan *", plan)
        except IndexError as error:
            raise DeviceError(f"the device needs more or longer reports than hapticd can send: {error}") from None


_C_MEMBER_NAMES: Final = {"bits": "field", "signed": "is_signed", "min_counts": "least", "max_counts": "most"}
"""Names in C of members that have another name here."""


def _c_members(part: Bits | AxisPlan | Value | StateBit | PlayingBits | Signs) -> dict[str, object]:
    """Return the members of the C struct that corresponds to a dataclass."""
    return asdict(part, dict_factory=lambda pairs: {_C_MEMBER_NAMES.get(name, name): value for name, value in pairs})
