"""Mutated report descriptors, as many as asked for: each is refused in one line, or read soundly; what could be driven
is planned, and no force, however wrong, leaves the range that the descriptor gives.

    python -m tests.fuzz_descriptors [--runs 1000000] [--seed 0]

The tests do a few hundred of the same; `make fuzz` does many. A descriptor that fails is printed in hex.
"""

from __future__ import annotations

import argparse
import math
import random
import time
from collections import Counter

from hapticd.core import ffi, lib
from hapticd.hid.config import Hid
from hapticd.hid.descriptor import DescriptorError, parse
from hapticd.hid.layout import Layout, layout_of
from hapticd.hid.pid import plan_of, ways_of
from hapticd.hid.plan import DeviceError, Plan
from tests.unit import test_hid_descriptor, test_hid_layout

HANGS_S = 5.0
"""Processor time; a descriptor of a few hundred bytes that takes longer hangs."""
EXTREMES = (0.0, -0.0, 1e-300, 1e300, -1e300, math.inf, -math.inf, math.nan)


def check_plan(source: random.Random, plan: Plan) -> None:
    """Composes its force messages with forces of all kinds; every number stays within its limits and its report."""
    described = plan.to_c()
    room, counts = ffi.new("uint8_t[]", lib.HD_HID_REPORT_BYTES), ffi.new("int64_t *")
    for _ in range(4):
        force = [source.choice((source.uniform(-20, 20), source.choice(EXTREMES))) for _ in range(2)]
        for place, message in enumerate(plan.force):
            composed = ffi.addressof(described.force.messages, place)
            lib.hd_hid_compose(composed, ffi.new("double[2]", force), room)
            for at, value in enumerate(message.values):
                field = ffi.addressof(composed.values[at], "field")
                assert lib.hd_field_read(field, room, composed.length, counts) == lib.HD_OK
                assert value.least <= counts[0] <= value.most, (force, counts[0])


def drive(source: random.Random, layout: Layout) -> str:
    """Plans each way of driving it; what came of it."""
    hid = Hid()
    try:
        ways = ways_of(layout, hid)
        first, last = layout.effect_indices or (1, 2)
        for way in ways:
            indices = [first] if way in ("one", "polar") else [first, min(first + 1, last)]
            check_plan(source, plan_of(layout, hid, way, indices))
    except DeviceError as error:
        assert "\n" not in str(error)
        return "not drivable"
    return "driven"


def run(source: random.Random, descriptor: bytes) -> str:
    """One descriptor; what came of it."""
    try:
        found = parse(descriptor)
    except DescriptorError as error:
        assert "\n" not in str(error)
        return "refused"
    test_hid_descriptor.check(found)
    layout = layout_of(found)
    test_hid_layout.check(found, layout)
    return drive(source, layout) if layout.usable else "not usable"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    source = random.Random(arguments.seed)
    whole = [bytes(joystick) for joystick in test_hid_descriptor.VARIANTS]
    outcomes: Counter[str] = Counter()
    worst_s = 0.0
    for number in range(arguments.runs):
        descriptor = test_hid_descriptor.mutated(source, source.choice(whole))
        begin = time.process_time()
        try:
            outcomes[run(source, descriptor)] += 1
        except Exception:
            print(f"run {number}: {descriptor.hex()}")
            raise
        lasted_s = time.process_time() - begin
        assert lasted_s < HANGS_S, f"run {number} took {lasted_s:.1f} s: {descriptor.hex()}"
        worst_s = max(worst_s, lasted_s)
        if (number + 1) % 50_000 == 0:
            print(f"{number + 1} descriptors", flush=True)
    print(f"fuzz_descriptors: ok, {arguments.runs} descriptors, {dict(outcomes)}, the slowest {1e3 * worst_s:.0f} ms")


if __name__ == "__main__":
    main()
