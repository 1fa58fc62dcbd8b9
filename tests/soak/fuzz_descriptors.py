"""Mutated report descriptors, as many as asked for: each is refused in one line, or read soundly; what can be driven is
set up against a device, and no number of any report, whatever the force, leaves the range that the descriptor gives.

    python -m tests.soak.fuzz_descriptors [--runs 1000000] [--seed 0]

Bytes, items, and the data of items (ranges, sizes, counts, usages, report ids, units) are mutated. The device answers
by the product's own layout; its reports are read by tests/support/report_fields.py, which shares nothing with the
product. What
`hapticd devices parse` says is what set-up and the core do. The tests do a few hundred of the same; `make fuzz` does
many. A descriptor that fails is printed in hex.
"""

from __future__ import annotations

import argparse
import math
import random
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

from hapticd.base.core import CData, ffi, lib
from hapticd.config.hid import ForceAxes, ForceAxis, Hid
from hapticd.config.modes import Mode
from hapticd.hid import nearest_effect, offload
from hapticd.hid import verdict as verdicts
from hapticd.hid.descriptor.fields import Field
from hapticd.hid.descriptor.layout import Layout
from hapticd.hid.descriptor.parser import Descriptor, parse
from hapticd.hid.drivers import pid
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.plan import Bits, DeviceError, Message, Plan
from hapticd.hid.verdict import Verdict, verdict_of
from tests.hid import test_descriptor, test_layout
from tests.support import firmware_descriptors as known
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import chosen
from tests.support.report_fields import FEATURE, OUTPUT, Numbers, Reports, reports_of

HANGS_S = 5.0
"""Processor time; a descriptor of a few hundred bytes that takes longer hangs."""
FORCES: Final = (
    *((x, y) for x in (-1e300, -8.9, 0.0, 0.3, 8.9, 1e300) for y in (-8.9, -1e-300, 8.9)),
    (math.inf, 0.0),
    (0.0, -math.inf),
    (math.nan, 1.0),
)
_FORCES: Final = tuple(ffi.new("double[2]", force) for force in FORCES)
SPLIT: Final = 0.4
"""Of all mutations, those of bytes; the others are of items."""
_PID: Final = 0xF0000
_DURATION, _TRIGGER_BUTTON = _PID | 0x50, _PID | 0x53
_WRITTEN: Final = {
    _PID | 0x21: {_PID | one for one in (0x22, 0x50, 0x51, 0x52, 0x54, 0xA7)},
    _PID | 0x73: {_PID | 0x22, _PID | 0x70},
    _PID | 0x77: {_PID | 0x22, _PID | 0x7C},
    _PID | 0x6E: {_PID | 0x22, _PID | 0x70},
    _PID | 0x5A: {_PID | 0x22},
    _PID | 0x90: {_PID | 0x22},
    _PID | 0x7D: {_PID | 0x7E},
}
"""Numbers that these reports of ours always say; the others may be left at zero."""

_LEAST: Final = bytes.fromhex(
    "05010904a101 8501 09300931 160180 26ff7f 7510 9502 8102"  # X and Y
    "050f 0921a102 8501 0922 1501 2528 7508 9501 9102"  # Set Effect: index
    "0925a102 0926 2501 9100 c0 0950 1500 26ff7f 7510 9102"  # type, duration
    "0955a102 0501 09300931 2501 7501 9502 9102 c0 050f 0956 9501 9102 7505 9103"  # Axes Enable, Direction Enable
    "0957a102 0b01000a00 0b02000a00 279f8c0000 7510 9502 9102 c0 c0"  # Direction
    "0973a102 8502 0922 1501 2528 7508 9501 9102 0970 16f0d8 261027 7510 9102 c0"  # Set Constant Force
    "0977a102 8503 0922 1501 2528 7508 9102 0978a102 0979097a097b 2503 9100 c0 097c 1500 26ff00 9102 c0"
    "0996a102 8504 09970998 0999099a 1501 2504 9100 c0"  # Device Control
    "09aba102 8505 0925a102 0926 2501 b100 c0 c0"  # Create New Effect
    "0989a102 8506 0922 2528 b102 098ba102 098c098d098e 2503 b100 c0 c0 c0"  # PID Block Load
)
"""A joystick in 300 bytes, without anything that can be left out: it is read fast."""

DEVICES: Final[tuple[bytes, ...]] = (
    *(bytes(joystick) for joystick in test_descriptor.VARIANTS),
    known.SIDEWINDER_FF2,
    known.XBOX_ONE_S,
    known.OPENFFBOARD_1,
    known.OPENFFBOARD_2,
    known.ARDUINO,
    known.ADAPT_FFB_JOY,
    # As wheel bases have it (Simucube, MOZA, Fanatec, VRS): one axis of 16 bits, few reports.
    bytes(Joystick(axes=(0x30,), axis_range=(0, 65535), force_axes=(0x30, 0x31), magnitude=10000, direction_bits=16)),
    bytes(Joystick(axes=(0x30, 0x31), axis_range=(0, 65535), force_axes=(0x30,), directions=1, magnitude=32767)),
    # As vJoy has it: eight axes of 32 bits, report ids from 0x11 on.
    bytes(
        Joystick(
            axes=(0x30, 0x31, 0x32, 0x33, 0x34, 0x35), axis_bits=32, axis_range=(0, 32767), first_id=0x11, level=10000
        )
    ),
    bytes(Joystick(time_exponent=-4, level=32767, without=frozenset({0x53, 0x54, 0x51}))),
    _LEAST,
    # As it, but with whole ranges and usages.
    *(
        bytes(Joystick(without=frozenset({0x90, 0x7D, 0x7F, 0x92, 0xA7, 0x51, 0x53, 0x54, 0x5A, 0x6E}), **keys))  # type: ignore[arg-type]
        for keys in (
            {},
            {"is_magnitude_signed": False},
            {"control": "bits", "direction_bits": 16},
            {"direction_bits": 0},
        )
    ),
)


_SMALL: Final = (*[DEVICES.index(_LEAST)] * 12, *(at for at, one in enumerate(DEVICES) if len(one) < 800))
"""Read fast, so most descriptors are of these."""

# ---- Mutations -------------------------------------------------------------------------------------------------------

_VALUES: Final = (0, 1, 2, 3, 7, 8, 15, 16, 31, 32, 33, 40, 64, 127, 128, 255, 256, 257, 1000, 10000, 32767, 32768)
_WIDE: Final = (*_VALUES, 65535, 65536, 36000, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1)
_USAGES: Final = (
    *(0x22, 0x25, 0x50, 0x52, 0x53, 0x55, 0x56, 0x57, 0x70, 0x73, 0x77, 0x7C),
    *(0x30, 0x31, 0x33, 0x89, 0xAB, 0x26),
)
_GLOBALS: Final = (0x04, 0x14, 0x24, 0x34, 0x44, 0x54, 0x64, 0x74, 0x84, 0x94)
_ODD: Final = tuple(
    map(bytes.fromhex, ("0d07", "fc", "00", "69 01", "ba0102", "fe0280aabb", "1901", "2930", "a801", "a4", "b4"))
)


def items_of(descriptor: bytes) -> list[bytes]:
    """Its short items."""
    found, at = [], 0
    while at < len(descriptor):
        end = at + 1 + (0, 1, 2, 4)[descriptor[at] & 3]
        found.append(descriptor[at:end])
        at = end
    return found


def item(prefix: int, value: int) -> bytes:
    """With as few bytes as hold the number; some more now and then makes no difference."""
    size = next(one for one in (1, 2, 4) if value < 1 << 8 * one or one == 4)
    return bytes([prefix & 0xFC | {1: 1, 2: 2, 4: 3}[size]]) + (value & 0xFFFFFFFF).to_bytes(size, "little")


def mutated_items(source: random.Random, items: list[bytes]) -> bytes:
    """One to three items changed, dropped, repeated, moved, or put between."""
    items = list(items)
    for _ in range(source.choice((1, 1, 1, 2, 3))):
        at = source.randrange(len(items))
        what = source.random()
        if what < 0.55:
            # The data of one that has some, mostly of a range, size, count or id.
            for _ in range(8):
                if len(items[at]) > 1 and items[at][0] & 0x0C in (0x04, 0x08):
                    break
                at = source.randrange(len(items))
            prefix = items[at][0]
            if prefix & 0x0C == 0x08:
                items[at] = item(prefix, source.choice(_USAGES))
            elif source.random() < 0.3:
                now = int.from_bytes(items[at][1:], "little")
                near = now + source.choice((-1, 1, now, -now // 2)) & (1 << 8 * max(1, len(items[at]) - 1)) - 1
                items[at] = item(prefix, near)
            else:
                items[at] = item(prefix, source.choice(_WIDE if prefix & 0xFC in (0x14, 0x24, 0x34, 0x44) else _VALUES))
        elif what < 0.65:
            del items[at]
        elif what < 0.75:
            items.insert(at, source.choice(items))
        elif what < 0.85:
            items.insert(at, item(source.choice(_GLOBALS), source.choice(_WIDE)))
        elif what < 0.92:
            items.insert(at, source.choice(_ODD))
        else:
            other = source.randrange(len(items))
            items[at], items[other] = items[other], items[at]
        if not items:
            items = [b"\0"]
    return b"".join(items)


def configured(source: random.Random) -> Hid:
    """How it is driven: as a user has it who has configured nothing, or anything."""
    return source.choice(_CONFIGURED)


_CONFIGURED: Final = (
    Hid(),
    Hid(),
    Hid(offload="auto"),
    Hid(offload="auto", full_scale_force_n=100, effect_duration_s=0.01, renew_s=0.005, travel_m=10),
    Hid(quirks=("infinite_duration", "one_effect", "no_pid_pool")),
    Hid(quirks=("no_reset", "no_device_gain"), max_rate_hz=10, effect_duration_s=10, full_scale_force_n=0.01),
    Hid(force_axes=ForceAxes(x=ForceAxis(sign=-1), swap=True), quirks=("one_effect",)),
    Hid.model_validate({"axes": {"x": {"usage": "Rx"}, "y": {"usage": "X"}}}),
)


# ---- The device ------------------------------------------------------------------------------------------------------


@dataclass
class Loader:
    """Takes every report, and makes every effect that there is an index for."""

    layout: Layout
    room: int
    sent: list[tuple[int, bytes]] = field(default_factory=list)
    made: int = 0
    path = "fake0"

    @property
    def resets(self) -> bool:
        control = self.layout.device_control
        return control is not None and "device_reset" in control.command.entries

    def fileno(self) -> int:
        raise AssertionError

    def write(self, report: bytes) -> None:
        self.sent.append((OUTPUT, report))
        control, free = self.layout.device_control, self.layout.block_free
        if control and report[0] == control.report_id and "device_reset" in chosen(report, control.command):
            self.made = 0
        elif free and report[0] == free.report_id:
            self.made = max(0, self.made - 1)

    def send_feature(self, report: bytes) -> None:
        self.sent.append((FEATURE, report))
        self.made += 1

    def get_feature(self, report_id: int, length: int) -> bytes:
        load, pool_of, report = self.layout.block_load, self.layout.pool, bytearray(length)
        report[0] = report_id
        assert load is not None
        first, last = self.layout.effect_indices or (1, 1)
        if report_id == load.report_id:
            index = first + self.made - 1
            # A device that cannot say that it is full has room.
            says_full = load.status is None or "full" in load.status.entries
            there = index <= last and (self.made <= self.room or not says_full)
            if load.status is not None:
                entry = load.status.entries.get("success" if there else "full")
                if entry is not None:
                    _put(report, entry.field, entry.value)
            _put(report, load.effect_index, index if there else 0)
        elif pool_of is not None and pool_of.simultaneous_effects_max is not None:
            _put(report, pool_of.simultaneous_effects_max, self.room)
        return bytes(report)

    def listen(self, timeout_s: float) -> bytes:
        return b""

    def close(self) -> None:
        pass


def _put(report: bytearray, place: Field, number: int) -> None:
    Bits(place.bit_offset, place.bit_size, place.is_signed).put(
        report, min(max(number, place.logical_min), place.logical_max)
    )


# ---- What must hold --------------------------------------------------------------------------------------------------


def check_report(reports: Reports, tag: int, report: bytes, *, endless: bool) -> None:
    """Its length is the report's, and every number lies in its field's range, or is nothing: zero where it need not be
    said, a flag, no button, no end."""
    key = tag, report[0]
    assert key in reports.bits, f"the device has no report {report[0]}"
    assert len(report) == 1 + (reports.bits[key] + 7) // 8
    whole = int.from_bytes(report[1:], "little")
    fields = reports.fields[key]
    inside = {one.inside for one in fields if one.usages}
    said: dict[int, list[bool]] = {}
    for one in fields:
        if one.is_constant:
            continue
        for element in one.elements:
            number, usage = one.read(whole, element), one.usage(element) if one.is_variable else 0
            lies = one.least <= number <= one.most
            ones = number in (-1, (1 << one.bits) - 1)
            nothing = one.bits == 1 or (ones and (usage == _TRIGGER_BUTTON or (usage == _DURATION and endless)))
            assert lies or nothing or number == 0, (hex(usage), number, one)
            if usage in _WRITTEN.get(one.inside[1], ()) and _can_be_driven(one):
                said.setdefault(usage, []).append(lies or nothing)
    # Where several reports share an id, the numbers of the others are not said.
    if len(inside) == 1:
        for usage, each in said.items():
            assert any(each), f"{usage:#x} is not said"


def _can_be_driven(one: Numbers) -> bool:
    return one.is_variable and one.bits <= 32 and one.least < one.most


def check_messages(reports: Reports, messages: Iterator[tuple[CData, int]], *, endless: bool) -> None:
    """Forces of all kinds, composed by the core."""
    room = ffi.new("uint8_t[]", lib.HD_HID_REPORT_BYTES)
    for message, length in messages:
        composed = set()
        for force in _FORCES:
            lib.hd_hid_compose(message, force, room)
            composed.add(bytes(ffi.buffer(room, length)))
        for report in composed:
            check_report(reports, OUTPUT, report, endless=endless)


def check_plan(reports: Reports, plan: Plan, *, endless: bool) -> None:
    """Everything that a connection would send."""
    described = plan.to_c()
    assert lib.hd_hid_check(described) == lib.HD_OK
    for script in (plan.begin, plan.force, plan.renew, plan.restore, plan.stop):
        for message in script:
            check_report(reports, OUTPUT, message.at_rest(), endless=endless)
    check_messages(
        reports,
        ((ffi.addressof(described.force.messages, at), len(one.data)) for at, one in enumerate(plan.force)),
        endless=endless,
    )
    for axis in (plan.x, plan.y):
        assert math.isfinite(axis.zero_counts) and all(math.isfinite(step) and step for step in axis.m_per_count)
    assert plan.renew_s > 0.0 and all(math.isfinite(step) for step in plan.force_steps_n)


def check_periodic(reports: Reports, plan: Plan) -> None:
    """Effects that the device plays by itself, of one mode."""
    assert plan.periodic is not None
    shape = nearest_effect.nearest_effect(_MODE, plan.periodic.scales)
    if shape is None:
        return

    def filled(messages: tuple[Message, ...]) -> Iterator[tuple[CData, int]]:
        for message in messages:
            yield ffi.new("struct hd_hid_message *", message.for_c()), len(message.data)

    for place in range(len(plan.periodic.blocks)):
        messages = offload.effect_messages(shape, plan.periodic, place)
        check_messages(reports, filled(messages), endless=False)


_MODE: Final = Mode(decay_rate_per_s=60.0, angular_frequency_rad_per_s=628.0)


_parsed: Final[list[Descriptor]] = []
"""What the last verdict read: reading it again would take as long."""


def run(source: random.Random, descriptor: bytes) -> str:
    """One descriptor; what came of it."""
    hid = configured(source)
    verdict = verdict_of(hid, descriptor)
    if verdict.why_not is not None:
        assert "\n" not in verdict.why_not and verdict.plan is None
    if verdict.layout is None:
        return "refused"
    found = _parsed[-1]
    test_descriptor.check(found)
    if source.random() < 0.1:
        test_layout.check(found, verdict.layout)
    if not verdict.layout.usable:
        assert not verdict.drivable
        return "not usable"
    return drive(source, hid, verdict, reports_of(descriptor))


def drive(source: random.Random, hid: Hid, verdict: Verdict, reports: Reports) -> str:
    """Sets it up, as `run` would; set-up and verdict agree."""
    layout, endless = verdict.layout, "infinite_duration" in hid.quirks
    assert layout is not None
    device = Loader(layout, source.choice((2, 40, 255)))
    try:
        plan = PidDriver(layout, hid).set_up(device)
    except DeviceError as error:
        # A device that has room for what is wanted is set up if it is said to be drivable; unless it refused more than
        # that, and can free nothing.
        can_free = layout.block_free is not None or device.resets
        assert not verdict.drivable or not can_free, error
        assert "\n" not in str(error)
        return "not drivable"
    assert verdict.plan is not None, verdict.why_not
    for tag, report in device.sent:
        check_report(reports, tag, report, endless=endless)
    if (verdict.plan.force, verdict.plan.renew) != (plan.force, plan.renew):
        check_plan(reports, verdict.plan, endless=endless)
    check_plan(reports, plan, endless=endless)
    if plan.periodic is not None and source.random() < 0.1:
        check_periodic(reports, plan)
    return "driven"


@contextmanager
def without_pauses() -> Iterator[None]:
    """A device that answers at once is not waited for, and no descriptor is read twice."""
    before = pid.time, verdicts.parse

    class Clock:
        @staticmethod
        def sleep(duration_s: float) -> None:
            pass

    def parse_once(descriptor: bytes) -> Descriptor:
        _parsed[:] = [parse(descriptor)]
        return _parsed[0]

    pid.time = Clock  # type: ignore[assignment]
    verdicts.parse = parse_once
    try:
        yield
    finally:
        pid.time, verdicts.parse = before


def fuzz(source: random.Random, runs: int, every: int = 0) -> tuple[Counter[str], float]:
    """So many descriptors; what came of them, and the processor time of the slowest, s."""
    items = [items_of(descriptor) for descriptor in DEVICES]
    outcomes: Counter[str] = Counter()
    worst_s = 0.0
    with without_pauses(), warnings.catch_warnings():
        warnings.simplefilter("error")
        for number in range(runs):
            which = source.choice(_SMALL) if source.random() < 0.8 else source.randrange(len(DEVICES))
            if source.random() < SPLIT:
                descriptor = test_descriptor.mutated(source, DEVICES[which])
            else:
                descriptor = mutated_items(source, items[which])
            begin = time.process_time()
            try:
                outcomes[run(source, descriptor)] += 1
            except Exception:
                print(f"run {number}: {descriptor.hex()}")
                raise
            lasted_s = time.process_time() - begin
            assert lasted_s < HANGS_S, f"run {number} took {lasted_s:.1f} s: {descriptor.hex()}"
            worst_s = max(worst_s, lasted_s)
            if every and (number + 1) % every == 0:
                print(f"{number + 1} descriptors, {dict(outcomes)}", flush=True)
    return outcomes, worst_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    outcomes, worst_s = fuzz(random.Random(arguments.seed), arguments.runs, 20_000)
    print(f"fuzz_descriptors: ok, {arguments.runs} descriptors, {dict(outcomes)}, the slowest {1e3 * worst_s:.0f} ms")


if __name__ == "__main__":
    main()
