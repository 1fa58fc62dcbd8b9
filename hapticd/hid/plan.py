"""What a connection does with a device, as data: where positions stand, and which reports carry a force.

Made once by `pid.py`, `vendor.py` or `replay.py`, and handed to C as `struct hd_hid_plan` (csrc/api/hd_api.h says
what each
number means). Reports are bytes with the report id first, 0 where reports are not numbered; bits are counted after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import CData, HidMeaning, HidQuantity, ffi, lib
from hapticd.base.errors import HapticdError
from hapticd.hid.signs import Signs

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
        if not self.least <= counts <= self.most:
            raise ValueError(f"{counts} is not between {self.least} and {self.most}")
        if self.end > 8 * (len(report) - 1):
            raise ValueError(f"bit {self.end - 1} lies beyond a report of {len(report) - 1} bytes")
        mask = (1 << self.bit_size) - 1
        raw = counts & mask
        if self.big_endian:
            raw = int.from_bytes(raw.to_bytes(self.bit_size // 8, "big"), "little")
        whole = int.from_bytes(report[1:], "little") & ~(mask << self.bit_offset) | raw << self.bit_offset
        report[1:] = whole.to_bytes(len(report) - 1, "little")

    def get(self, report: bytes) -> int:
        """Reads it from a report (id first). Raises ValueError where it lies beyond the report."""
        if self.end > 8 * (len(report) - 1):
            raise ValueError(f"bit {self.end - 1} lies beyond a report of {len(report) - 1} bytes")
        raw = int.from_bytes(report[1:], "little") >> self.bit_offset & (1 << self.bit_size) - 1
        if self.big_endian:
            raw = int.from_bytes(raw.to_bytes(self.bit_size // 8, "big"), "little")
        return raw - (1 << self.bit_size) if self.signed and raw >> (self.bit_size - 1) else raw


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

    def quantity(self, counts: int) -> float:
        """What a number stands for."""
        return (counts - self.zero_counts) / self.counts_per_unit

    def quantities(self, counts: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """As `quantity`, of many."""
        return (counts.astype(np.float64) - self.zero_counts) / self.counts_per_unit


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
    """Periodic effects that the device plays by itself."""

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
    """What tells that the device has forgotten an effect; None: nothing does."""
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
    effect_reports: Mapping[int, tuple[str, Bits]] = field(default_factory=dict)
    """Output reports of one effect, by id: the name, and where the effect's index lies; for those who look at what was
    sent. Empty: the device has no effects."""
    signs: Signs | None = None
    """What is checked before the first force of the scene; None: the signs are trusted."""

    @property
    def resolution_m(self) -> float:
        """The step of positions, the coarser axis's."""
        return max(abs(self.x.m_per_count), abs(self.y.m_per_count))

    @property
    def leak_told(self) -> str:
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
        plan = ffi.new("struct hd_hid_plan *")
        for into, axis in zip(plan.axes, (self.x, self.y), strict=True):
            _fill_bits(into.field, axis.bits)
            into.report_id = axis.report_id
            into.zero_counts, into.m_per_count = axis.zero_counts, axis.m_per_count
        for script, messages in (
            (plan.begin, self.begin),
            (plan.force, self.force),
            (plan.renew, self.renew),
            (plan.restore, self.restore),
            (plan.stop, self.stop),
        ):
            _fill_script(script, messages)
        if self.effects is not None:
            _fill_effects(plan.effects, self.effects)
        if len(self.states) > lib.HD_HID_STATES:
            raise DeviceError(f"a device with {len(self.states)} state bits; at most {lib.HD_HID_STATES} are watched")
        for into, state in zip(plan.states, self.states, strict=False):
            _fill_bits(into.field, state.bits)
            into.report_id, into.meaning = state.report_id, state.meaning
        plan.state_count = len(self.states)
        if self.signs is not None:
            self.signs.fill(plan.signs)
        plan.on_change = self.on_change
        plan.renew_ns = round(self.renew_s * 1e9)
        plan.restore_ns = round(self.restore_s * 1e9)
        plan.write_interval_ns = round(self.write_interval_s * 1e9)
        return plan


def _fill_bits(into: CData, bits: Bits) -> None:
    into.bit_offset, into.bit_size = bits.bit_offset, bits.bit_size
    into.is_signed, into.big_endian = bits.signed, bits.big_endian


def _fill_effects(into: CData, effects: PlayingBits) -> None:
    if len(effects.indices) > lib.HD_HID_EFFECTS:
        raise DeviceError(f"{len(effects.indices)} effects; at most {lib.HD_HID_EFFECTS} are watched")
    _fill_bits(into.index, effects.index)
    _fill_bits(into.playing, effects.playing)
    into.report_id, into.proof = effects.report_id, effects.proof
    into.count = len(effects.indices)
    for place, index in enumerate(effects.indices):
        into.indices[place] = index


def _fill_script(script: CData, messages: Sequence[Message]) -> None:
    if len(messages) > lib.HD_HID_MESSAGES:
        raise DeviceError(f"a script of {len(messages)} reports; at most {lib.HD_HID_MESSAGES} are sent at a time")
    script.count = len(messages)
    for into, message in zip(script.messages, messages, strict=False):
        fill_message(into, message)


def fill_message(into: CData, message: Message) -> None:
    """Fills a `struct hd_hid_message`. Raises DeviceError for what has no room in it."""
    if len(message.data) > lib.HD_HID_REPORT_BYTES:
        raise DeviceError(
            f"report {message.data[0]} has {len(message.data)} bytes; at most {lib.HD_HID_REPORT_BYTES} are sent"
        )
    if len(message.values) > lib.HD_HID_VALUES:
        raise DeviceError(f"a report with {len(message.values)} numbers; at most {lib.HD_HID_VALUES} are written")
    into.length, into.value_count = len(message.data), len(message.values)
    ffi.memmove(into.bytes, message.data, len(message.data))
    for place, value in zip(into.values, message.values, strict=False):
        _fill_bits(place.field, value.bits)
        place.quantity = value.quantity
        place.counts_per_unit, place.zero_counts = value.counts_per_unit, value.zero_counts
        place.counts_per_other_n = value.counts_per_other_n
        place.least, place.most = value.least, value.most
