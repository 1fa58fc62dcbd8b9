"""What a connection does with a device, as data: where positions stand, and which reports carry a force.

Made once by `pid.py`, `vendor.py` or `replay.py`, and handed to C as `struct hd_hid_plan` (csrc/api/hd_api_device.h
says what each number means). Reports are bytes with the report id first, 0 where reports are not numbered; bits are
counted after it.
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

STILL_M_PER_COUNT: Final = 1e-15
"""A handle with one axis: its other one moves by nothing that matters."""


class DeviceError(HapticdError):
    """A device that cannot be driven; `str` is one line that says which, why and what would be right."""


class UndrivableError(DeviceError):
    """A device that is there and that no plan can be made for, whatever happens to it later."""


@dataclass(frozen=True, slots=True)
class Bits:
    """Where a number lies in a report, counted from the lowest bit of the byte after the report id."""

    bit_offset: int
    bit_size: int
    signed: bool
    big_endian: bool = False

    @property
    def end(self) -> int:
        """The first bit after it."""
        return self.bit_offset + self.bit_size

    @property
    def least(self) -> int:
        """The smallest number that it holds."""
        return -(1 << (self.bit_size - 1)) if self.signed else 0

    @property
    def most(self) -> int:
        """The largest number that it holds."""
        return (1 << (self.bit_size - self.signed)) - 1

    def put(self, report: bytearray, counts: int) -> None:
        """Writes a number into a report (id first).

        Raises ValueError for a number that does not fit, or a field that lies beyond the report.
        """
        field = ffi.new("struct hd_hid_field *", _for_c(self))
        buffer = ffi.from_buffer("uint8_t[]", report, require_writable=True)
        if lib.hd_bits_put(field, buffer, len(report), counts) != Status.OK:
            raise ValueError(f"bit {self.bit_offset} to {self.end - 1} of {len(report) - 1} bytes: cannot be {counts}")

    def get(self, report: bytes) -> int:
        """Reads it from a report (id first). Raises ValueError where it lies beyond the report."""
        field, counts = ffi.new("struct hd_hid_field *", _for_c(self)), ffi.new("int64_t *")
        if lib.hd_bits_get(field, ffi.from_buffer("uint8_t[]", report), len(report), counts) != Status.OK:
            raise ValueError(f"bit {self.end - 1} lies beyond a report of {len(report) - 1} bytes")
        return int(counts[0])


@dataclass(frozen=True, slots=True)
class AxisPlan:
    """One axis: position in m = (counts - zero_counts) * m_per_count."""

    bits: Bits
    report_id: int
    zero_counts: float
    m_per_count: float


@dataclass(frozen=True, slots=True)
class Value:
    """A number that a message carries: quantity * counts_per_unit + zero_counts, rounded, within least .. most.

    Of a force along one axis, the other axis's force times `counts_per_other_n` comes to it.
    """

    bits: Bits
    quantity: HidQuantity
    counts_per_unit: float
    zero_counts: float
    least: float
    most: float
    counts_per_other_n: float = 0.0


@dataclass(frozen=True, slots=True)
class Message:
    """An output report as it is, and the numbers written into it."""

    data: bytes
    values: tuple[Value, ...] = ()

    def at_rest(self) -> bytes:
        """The report for a force of zero."""
        report = bytearray(self.data)
        for value in self.values:
            value.bits.put(report, min(max(round(value.zero_counts), round(value.least)), round(value.most)))
        return bytes(report)

    def for_c(self) -> dict[str, object]:
        """What initializes a `struct hd_hid_message`."""
        values = [_for_c(value) for value in self.values]
        return {"length": len(self.data), "bytes": self.data, "value_count": len(values), "values": values}


@dataclass(frozen=True, slots=True)
class StateBit:
    """Where an input report says how the device is."""

    bits: Bits
    report_id: int
    meaning: HidMeaning


@dataclass(frozen=True, slots=True)
class PlayingBits:
    """Where an input report says which effect it speaks of, and whether that plays."""

    index: Bits
    playing: Bits
    report_id: int
    indices: tuple[int, ...]
    """Of the effects that are watched."""
    proof: int
    """Renewals that together take longer than an effect."""


@dataclass(frozen=True, slots=True)
class Scale:
    """A number of a report and what it stands for: quantity * counts_per_unit + zero_counts, within least .. most."""

    bits: Bits
    counts_per_unit: float
    zero_counts: float
    least: int
    most: int

    @property
    def resolution(self) -> float:
        """The quantity of one count."""
        return 1.0 / self.counts_per_unit

    @property
    def largest(self) -> float:
        """The quantity of the largest number."""
        return self.quantity(self.most)

    def counts(self, quantity: float) -> int:
        """The nearest number within its limits."""
        return min(max(round(quantity * self.counts_per_unit + self.zero_counts), self.least), self.most)

    def quantity(self, counts: Counts) -> Counts:
        """What a number stands for, or each of many."""
        return (counts - self.zero_counts) / self.counts_per_unit


@dataclass(frozen=True, slots=True)
class Numbers:
    """The numbers of a periodic effect: times in s, levels in N."""

    duration: Scale
    attack_time: Scale
    fade_time: Scale
    period: Scale
    magnitude: Scale
    attack_level: Scale
    fade_level: Scale


@dataclass(frozen=True, slots=True)
class PeriodicBlock:
    """The reports of one periodic effect that the device has made, without its times and levels."""

    set_effect: Message
    """With the direction of the force."""
    envelope: bytes
    periodic: bytes
    start: Message
    stop: Message


@dataclass(frozen=True, slots=True)
class Periodic:
    """Periodic effects that the device plays itself."""

    numbers: Numbers
    blocks: tuple[PeriodicBlock, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything that a connection does."""

    x: AxisPlan
    y: AxisPlan
    force: tuple[Message, ...]
    """Sent for each new force, in this order."""
    renew: tuple[Message, ...]
    """Sent every `renew_s`."""
    stop: tuple[Message, ...]
    """Sent at an orderly end, after a force of zero."""
    begin: tuple[Message, ...] = ()
    """Sent once, before the first force."""
    restore: tuple[Message, ...] = ()
    """What another program may have changed of the effects: sent one by one, in turn, to a device that does not say
    that they play."""
    effects: PlayingBits | None = None
    """Where the device reports that it has forgotten an effect; None: nowhere."""
    states: tuple[StateBit, ...] = ()
    on_change: bool = False
    """The device reports only what changes."""
    renew_s: float = 0.04
    restore_s: float = 0.04
    """Between two messages of `restore`."""
    foreign_s: float | None = None
    """At most so long another program's effect acts in the place of ours, where the device does not report it. Until
    `link.paced` has taken the link into account, it follows from the renewals alone. None: it keeps no effects."""
    write_interval_s: float = 0.0
    """Between two writes at least; 0: as fast as the device takes them."""
    periodic: Periodic | None = None
    no_periodic: str = "the device has no periodic effects"
    """Why there is none."""
    leak: float = 0.0
    """At most this part of a force comes out across it, since a direction is a whole number of counts."""
    signs: Signs | None = None
    """What is checked before the first force of the scene; None: the signs are trusted."""

    @property
    def resolution_m(self) -> float:
        """The step of positions, the coarser axis's."""
        return max(abs(self.x.m_per_count), abs(self.y.m_per_count))

    @property
    def leak_text(self) -> str:
        """What `leak` means, for a person; empty where it is below a thousandth."""
        if self.leak < 1e-3:
            return ""
        return f"one effect for both axes: up to {100.0 * self.leak:.2g} % of a force comes out across it"

    @property
    def driven_axes(self) -> tuple[bool, bool]:
        """Whether the device both moves and pushes along x, and along y."""
        steps_n = self.force_steps_n
        return (
            self.x.m_per_count != STILL_M_PER_COUNT and steps_n[0] > 0.0,
            self.y.m_per_count != STILL_M_PER_COUNT and steps_n[1] > 0.0,
        )

    @property
    def force_steps_n(self) -> tuple[float, float]:
        """Steps of a force along x and along y; 0 where no message carries it."""
        values = [value for message in self.force for value in message.values]
        x, y = (
            max((1.0 / abs(value.counts_per_unit) for value in values if value.quantity in quantities), default=0.0)
            for quantities in ((HidQuantity.X, HidQuantity.MAGNITUDE), (HidQuantity.Y, HidQuantity.MAGNITUDE))
        )
        return x, y

    def to_c(self) -> CData:
        """A `struct hd_hid_plan *`. Raises DeviceError for what has no room in it."""

        def script(messages: Sequence[Message]) -> dict[str, object]:
            return {"count": len(messages), "messages": [message.for_c() for message in messages]}

        effects = {} if self.effects is None else {**_for_c(self.effects), "count": len(self.effects.indices)}
        plan = {
            "axes": [_for_c(self.x), _for_c(self.y)],
            "begin": script(self.begin),
            "force": script(self.force),
            "renew": script(self.renew),
            "restore": script(self.restore),
            "stop": script(self.stop),
            "effects": effects,
            "states": [_for_c(state) for state in self.states],
            "state_count": len(self.states),
            "signs": {} if self.signs is None else _for_c(self.signs),
            "on_change": self.on_change,
            "renew_ns": round(self.renew_s * 1e9),
            "restore_ns": round(self.restore_s * 1e9),
            "write_interval_ns": round(self.write_interval_s * 1e9),
        }
        try:
            return ffi.new("struct hd_hid_plan *", plan)
        except IndexError as error:
            raise DeviceError(f"the device needs more reports, or longer ones, than are sent: {error}") from None


_IN_C: Final = {"bits": "field", "signed": "is_signed"}


def _for_c(part: Bits | AxisPlan | Value | StateBit | PlayingBits | Signs) -> dict[str, object]:
    """What initializes the struct of the same members."""
    return asdict(part, dict_factory=lambda members: {_IN_C.get(name, name): value for name, value in members})
