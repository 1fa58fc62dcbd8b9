"""Layouts of descriptors: offsets computed by hand, names of missing reports, and mutated descriptors."""

from __future__ import annotations

import dataclasses
import json
import math
import random
from collections.abc import Iterator, Mapping

import pytest

from hapticd.base.core import lib
from hapticd.config import hid
from hapticd.hid.descriptor.fields import Field
from hapticd.hid.descriptor.layout import MAX_REPORT_BYTES, Axis, Layout, layout_of
from hapticd.hid.descriptor.parser import Descriptor, DescriptorError, ReportKind, parse
from tests.hid.test_descriptor import VARIANTS, mutated
from tests.support.hid_descriptors import (
    APPLICATION,
    CONSTANT,
    DESKTOP,
    FEATURE,
    INPUT,
    LOGICAL,
    OUTPUT,
    PID,
    Joystick,
    collection,
    data,
    logical,
    pad,
    physical,
    report_id,
    size,
    unit,
    usage,
    usage_page,
    value,
)


def layout(joystick: Joystick | bytes) -> Layout:
    return layout_of(parse(bytes(joystick)))


def place(field: Field | None) -> tuple[int, int, int, int, int]:
    assert field is not None
    return field.report_id, field.bit_offset, field.bit_size, field.logical_min, field.logical_max


def fields_of(value: object) -> Iterator[Field]:
    if isinstance(value, Field):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from fields_of(inner)
    elif isinstance(value, tuple):
        for inner in value:
            yield from fields_of(inner)
    elif dataclasses.is_dataclass(value):
        for part in dataclasses.fields(value):
            yield from fields_of(getattr(value, part.name))


# ---- offsets by hand -----------------------------------------------------------------------------------------------


def test_a_whole_joystick() -> None:
    found = layout(Joystick())
    assert found.usable and not found.missing and not found.problems
    assert {name: place(axis.field) for name, axis in found.input.items()} == {
        "x": (1, 0, 16, -32767, 32767),
        "y": (1, 16, 16, -32767, 32767),
    }
    assert found.input["x"].report_bytes == 6
    assert found.effect_indices == (1, 40)

    force = found.constant_force
    assert force is not None
    assert (force.report_id, force.report_bytes) == (4, 4)
    assert place(force.effect_index) == (4, 0, 8, 1, 40)
    assert place(force.magnitude) == (4, 8, 16, -10000, 10000)

    effect = found.set_effect
    assert effect is not None
    assert (effect.report_id, effect.report_bytes) == (1, 16)
    assert place(effect.effect_index) == (1, 0, 8, 1, 40)
    constant = effect.effect_type.entries["constant_force"]
    assert (effect.effect_type.kind, constant.value, place(constant.field)) == ("array", 1, (1, 8, 8, 1, 11))
    assert effect.effect_type.entries["friction"].value == 11
    assert place(effect.duration) == (1, 16, 16, 0, 32767)
    assert place(effect.trigger_repeat_interval) == (1, 32, 16, 0, 32767)
    assert place(effect.sample_period) == (1, 48, 16, 0, 32767)
    assert place(effect.gain) == (1, 64, 8, 0, 255)
    assert place(effect.trigger_button) == (1, 72, 8, 1, 8)
    assert [(name, place(bit)) for name, bit in effect.axes_enable.items()] == [
        ("x", (1, 80, 1, 0, 1)),
        ("y", (1, 81, 1, 0, 1)),
    ]
    assert place(effect.direction_enable) == (1, 82, 1, 0, 1)
    assert [place(angle) for angle in effect.direction] == [(1, 88, 8, 0, 255), (1, 96, 8, 0, 255)]
    assert place(effect.start_delay) == (1, 104, 16, 0, 32767)

    operation = found.effect_operation
    assert operation is not None
    assert {name: entry.value for name, entry in operation.operation.entries.items()} == {
        "start": 1,
        "start_solo": 2,
        "stop": 3,
    }
    assert (operation.report_id, operation.report_bytes, place(operation.loop_count)) == (5, 4, (5, 16, 8, 0, 255))

    control = found.device_control
    assert control is not None
    assert (control.command.kind, control.report_id, control.report_bytes) == ("array", 7, 2)
    assert [entry.value for entry in control.command.entries.values()] == [1, 2, 3, 4, 5, 6]

    create, load = found.create_new_effect, found.block_load
    assert create is not None and load is not None
    assert (create.report_id, create.report_bytes) == (1, 4)
    assert (load.report_id, load.report_bytes, place(load.effect_index)) == (2, 5, (2, 0, 8, 1, 40))
    assert load.status is not None and load.status.entries["full"].value == 2

    state, pool = found.pid_state, found.pool
    assert state is not None and pool is not None
    assert place(state.actuators_enabled) == (2, 1, 1, 0, 1)
    assert place(state.effect_playing) == (2, 8, 1, 0, 1)
    assert place(state.effect_index) == (2, 9, 7, 1, 40)
    assert state.device_reset is None
    assert place(pool.simultaneous_effects_max) == (3, 16, 8, 0, 255)
    assert found.device_gain is not None and place(found.device_gain.gain) == (8, 0, 8, 0, 255)
    assert found.block_free is not None and found.block_free.report_id == 6
    assert found.set_periodic is not None and place(found.set_periodic.period) == (3, 32, 16, 0, 32767)
    assert found.set_envelope is not None and place(found.set_envelope.fade_time) == (2, 40, 16, 0, 32767)


@pytest.mark.parametrize("joystick", VARIANTS)
def test_every_variant_can_be_driven(joystick: Joystick) -> None:
    found = layout(joystick)
    if not joystick.is_magnitude_signed and not joystick.direction_bits:
        assert not found.usable
        return
    assert found.usable, found.missing
    assert found.constant_force is not None
    assert found.constant_force.magnitude.logical_max == joystick.magnitude
    assert found.constant_force.magnitude.is_signed == joystick.is_magnitude_signed


def test_bits_of_device_control() -> None:
    control = layout(Joystick(control="bits")).device_control
    assert control is not None and control.command.kind == "bits"
    assert {name: (entry.field.bit_offset, entry.value) for name, entry in control.command.entries.items()} == {
        "enable_actuators": (0, 1),
        "disable_actuators": (1, 1),
        "stop_all_effects": (2, 1),
        "device_reset": (3, 1),
        "device_pause": (4, 1),
        "device_continue": (5, 1),
    }


def test_bits_that_claim_the_range_of_an_array() -> None:
    commands = usage(0x97, 0x98, 0x99) + logical(1, 6) + size(1, 8) + data(OUTPUT)
    control = collection(usage_page(PID) + usage(0x96), LOGICAL, report_id(7), commands)
    descriptor = collection(
        usage_page(DESKTOP) + usage(4), APPLICATION, bytes(Joystick(without=frozenset({0x96}))), control
    )
    found = layout(descriptor).device_control
    assert found is not None
    assert [(entry.field.bit_offset, entry.value) for entry in found.command.entries.values()] == [
        (0, 1),
        (1, 1),
        (2, 1),
    ]


def test_an_array_from_zero() -> None:
    commands = usage(0x97, 0x98, 0x99, 0x9A) + logical(0, 3) + size(8) + data(OUTPUT, 0)
    control = collection(usage_page(PID) + usage(0x96), LOGICAL, report_id(7), commands)
    descriptor = collection(
        usage_page(DESKTOP) + usage(4), APPLICATION, bytes(Joystick(without=frozenset({0x96}))), control
    )
    found = layout(descriptor).device_control
    assert found is not None
    assert {name: entry.value for name, entry in found.command.entries.items()} == {
        "enable_actuators": 0,
        "disable_actuators": 1,
        "stop_all_effects": 2,
        "device_reset": 3,
    }


def test_directions_of_16_bits() -> None:
    effect = layout(Joystick(direction_bits=16)).set_effect
    assert effect is not None
    assert [place(angle) for angle in effect.direction] == [(1, 88, 16, 0, 35999), (1, 104, 16, 0, 35999)]
    assert place(effect.start_delay) == (1, 120, 16, 0, 32767)
    assert effect.report_bytes == 18


@pytest.mark.parametrize(("low", "is_cartesian"), [(-127, True), (0, False)])
def test_directions_by_axis(low: int, is_cartesian: bool) -> None:
    angles = usage_page(DESKTOP) + usage(0x30, 0x31) + logical(low, 127) + size(8, 2) + data(OUTPUT)
    types = usage_page(PID) + usage(0x26) + logical(1, 1) + size(8) + data(OUTPUT, 0)
    effect = collection(
        usage_page(PID) + usage(0x21),
        LOGICAL,
        report_id(9) + value(OUTPUT, 0x22, 1, 40, 8) + types + value(OUTPUT, 0x50, 0, 9, 8),
        collection(usage_page(PID) + usage(0x57), LOGICAL, angles),
    )
    found = layout(bytes(Joystick(without=frozenset({0x21}))) + effect).set_effect
    assert found is not None
    assert [place(angle) for angle in found.direction] == [(9, 24, 8, low, 127), (9, 32, 8, low, 127)]
    assert found.is_direction_cartesian == is_cartesian


def test_swapped_axes() -> None:
    found = layout(Joystick(axes=(0x31, 0x30), force_axes=(0x31, 0x30)))
    assert (found.input["x"].field.bit_offset, found.input["y"].field.bit_offset) == (16, 0)
    assert found.set_effect is not None
    assert {name: bit.bit_offset for name, bit in found.set_effect.axes_enable.items()} == {"x": 81, "y": 80}


def test_one_axis() -> None:
    found = layout(Joystick(axes=(0x30,), force_axes=(0x30,), directions=1))
    assert found.usable
    assert list(found.input) == ["x"]
    assert found.set_effect is not None
    assert list(found.set_effect.axes_enable) == ["x"] and len(found.set_effect.direction) == 1


@pytest.mark.parametrize("first_id", range(1, 34))
def test_report_ids(first_id: int) -> None:
    joystick = Joystick(first_id=first_id)
    found = layout(joystick)
    ids = joystick.ids()
    assert found.constant_force is not None and found.constant_force.report_id == ids["constant_force"]
    assert found.input["x"].field.report_id == ids["input"]
    assert {field.report_id for field in fields_of(found)} <= set(ids.values())


@pytest.mark.parametrize("change", [{"is_extended": True}, {"is_pushed": True}, {"is_split": True}])
def test_how_it_is_written_does_not_matter(change: dict[str, bool]) -> None:
    plain, other = layout(Joystick()).to_dict(), layout(Joystick(**change)).to_dict()  # type: ignore[arg-type]
    assert other == plain


# ---- what is missing -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("without", "name"),
    [
        (0x21, "Set Effect"),
        (0x73, "Set Constant Force"),
        (0x77, "Effect Operation"),
        (0x96, "Device Control"),
        (0xAB, "Create New Effect"),
        (0x89, "PID Block Load"),
        (0x22, "Set Effect: Effect Block Index"),
        (0x25, "Set Effect: Effect Type"),
        (0x50, "Set Effect: Duration"),
    ],
)
def test_missing_reports_and_fields_are_named(without: int, name: str) -> None:
    joystick = Joystick(without=frozenset({without}))
    found = layout(joystick)
    assert not found.usable
    assert found.missing == (name,)


def test_optional_reports_may_be_missing() -> None:
    found = layout(Joystick(without=frozenset({0x7F, 0x90, 0x7D, 0x92, 0x6E, 0x5A, 0xA7, 0x53, 0x54, 0x51, 0x52})))
    assert found.usable
    assert (found.pool, found.block_free, found.device_gain, found.pid_state) == (None, None, None, None)
    assert found.set_effect is not None and found.set_effect.start_delay is None


def test_rumble_on_the_pid_page_is_not_a_constant_force() -> None:
    rumble = collection(
        usage_page(PID) + usage(0x21),
        LOGICAL,
        report_id(3),
        value(OUTPUT, 0x97, 0, 1, 4) + pad(OUTPUT, 4),
        value(OUTPUT, 0x70, 0, 100, 8, 4) + value(OUTPUT, 0x50, 0, 255, 8),
    )
    pad_axes = report_id(1) + usage(0x30, 0x31) + logical(0, 65535) + size(16, 2) + data(INPUT)
    found = layout(collection(usage_page(DESKTOP) + usage(5), APPLICATION, pad_axes, rumble))
    assert found.missing == (
        "Set Constant Force",
        "Set Effect: Effect Block Index",
        "Set Effect: Effect Type",
        "Effect Operation",
        "Device Control",
        "Create New Effect",
        "PID Block Load",
    )
    assert place(found.input["y"].field) == (1, 16, 16, 0, 65535)


def test_a_magnitude_without_sign_needs_a_direction() -> None:
    found = layout(Joystick(magnitude=255, magnitude_bits=8, is_magnitude_signed=False, direction_bits=0))
    assert found.missing == ("Set Effect: Direction",)


def test_no_axes() -> None:
    assert layout(Joystick(axes=(0x36,))).missing == ("Joystick: X or Y",)


def test_ranges_that_do_not_fit() -> None:
    found = layout(Joystick(magnitude=10000, magnitude_bits=8))
    assert found.missing == ("Set Constant Force: Magnitude",)
    assert found.problems == (
        "output report 4, bit 8 (usage 0F:70): its range, -10000 to 10000, does not fit into its 8 bits",
    )
    found = layout(Joystick(axis_bits=10))
    assert found.missing == ("Joystick: X or Y",)
    assert len(found.problems) == 2
    # The range of a field without a scale is limited to the field's bits.
    found = layout(Joystick(indices=300))
    assert found.usable and found.effect_indices == (1, 255)


def test_wide_fields_and_long_reports() -> None:
    found = layout(Joystick(axis_bits=40))
    assert found.missing == ("Joystick: X or Y",)
    assert "at most 32 bits, has 40" in found.problems[0]
    long = collection(
        usage_page(PID) + usage(0x73),
        LOGICAL,
        report_id(9),
        value(OUTPUT, 0x22, 1, 9, 8) + value(OUTPUT, 0x70, -9, 9, 8) + pad(OUTPUT, 8 * MAX_REPORT_BYTES),
    )
    found = layout(bytes(Joystick(without=frozenset({0x73}))) + long)
    assert found.missing == ("Set Constant Force: Effect Block Index", "Set Constant Force: Magnitude")
    assert f"at most {MAX_REPORT_BYTES} bytes" in found.problems[0]


def test_block_indices_that_do_not_meet() -> None:
    force = collection(
        usage_page(PID) + usage(0x73),
        LOGICAL,
        report_id(9),
        value(OUTPUT, 0x22, 50, 60, 8) + value(OUTPUT, 0x70, -9, 9, 8),
    )
    assert layout(bytes(Joystick(without=frozenset({0x73}))) + force).missing == ("Effect Block Index",)


# ---- which of several ----------------------------------------------------------------------------------------------


def test_the_complete_one_of_two_reports() -> None:
    empty = collection(usage_page(PID) + usage(0x73), LOGICAL, report_id(30), value(OUTPUT, 0x22, 1, 40, 8))
    for descriptor in (empty + bytes(Joystick()), bytes(Joystick()) + empty):
        found = layout(descriptor)
        assert found.usable
        assert found.constant_force is not None and found.constant_force.report_id == 4


def test_fields_of_one_report_only() -> None:
    """A magnitude with another report id does not belong to the report, even in the same collection."""
    force = collection(
        usage_page(PID) + usage(0x73),
        LOGICAL,
        report_id(9) + value(OUTPUT, 0x22, 1, 40, 8),
        report_id(10) + value(OUTPUT, 0x70, -9, 9, 8),
    )
    found = layout(bytes(Joystick(without=frozenset({0x73}))) + force)
    assert found.missing == ("Set Constant Force: Magnitude",)


def test_axes_of_the_joystick_that_has_the_forces() -> None:
    other = collection(
        usage_page(DESKTOP) + usage(4),
        APPLICATION,
        report_id(40) + usage(0x30, 0x31) + logical(0, 255) + size(8, 2) + data(INPUT),
    )
    for descriptor in (other + bytes(Joystick()), bytes(Joystick()) + other):
        assert layout(descriptor).input["x"].field.report_id == 1


def test_axes_of_a_report_that_has_both() -> None:
    one = report_id(1) + usage(0x30) + logical(0, 255) + size(8) + data(INPUT)
    both = report_id(2) + usage(0x31, 0x30) + logical(0, 255) + size(8, 2) + data(INPUT)
    found = layout(collection(usage_page(DESKTOP) + usage(4), APPLICATION, one, both))
    assert {name: place(axis.field)[:2] for name, axis in found.input.items()} == {"x": (2, 8), "y": (2, 0)}


def test_fields_that_are_not_axes() -> None:
    """The motion of a mouse, constants, and the pointer of another application are not axes."""
    relative = report_id(1) + usage(0x30) + logical(-127, 127) + size(8) + data(INPUT, 6)
    constant = report_id(2) + usage(0x30) + logical(0, 255) + size(8) + data(INPUT, CONSTANT)
    mouse = collection(usage(2), APPLICATION, report_id(3) + usage(0x30) + size(8) + data(INPUT))
    unnamed = collection(b"", APPLICATION, report_id(4) + usage(0x31) + size(8) + data(INPUT))
    found = layout(collection(usage_page(DESKTOP) + usage(4), APPLICATION, relative, constant, mouse, unnamed))
    assert {name: axis.field.report_id for name, axis in found.input.items()} == {"y": 4}


def test_a_report_without_an_id_among_others() -> None:
    axes = usage(0x30, 0x31) + logical(0, 255) + size(8, 2) + data(INPUT)
    numbered = report_id(1) + pad(INPUT, 8)
    found = layout(collection(usage_page(DESKTOP) + usage(4), APPLICATION, axes, numbered))
    assert not found.input
    assert found.problems == ("input report without an id, bit 0: other input reports have an id",)


def test_feature_and_output_are_not_the_same() -> None:
    force = collection(
        usage_page(PID) + usage(0x73),
        LOGICAL,
        report_id(9),
        value(FEATURE, 0x22, 1, 40, 8) + value(FEATURE, 0x70, -9, 9, 8),
    )
    assert layout(bytes(Joystick(without=frozenset({0x73}))) + force).missing == ("Set Constant Force",)


# ---- units ---------------------------------------------------------------------------------------------------------


def test_seconds() -> None:
    effect = layout(Joystick()).set_effect
    assert effect is not None and effect.gain is not None
    assert effect.duration.seconds_per_count() == pytest.approx(1e-3)
    assert effect.gain.seconds_per_count() is None


def test_a_physical_range_of_an_earlier_field_is_ignored() -> None:
    """A count of the duration is 1 ms, whatever range was declared for the effect types before it."""
    complete = bytes(Joystick())
    own = logical(0, 32767) + physical(0, 32767)
    first = complete.index(own)  # of Duration; Effect Type before it has 1 to 11
    stale = complete[:first] + logical(0, 32767) + complete[first + len(own) :]
    effect, expected = layout(stale).set_effect, layout(complete).set_effect
    assert effect is not None and expected is not None
    assert effect.duration == expected.duration
    assert effect.duration.seconds_per_count() == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("items", "turn"),
    [
        (logical(0, 255) + physical(0, 36000) + unit(0x14, -2), 255),
        (logical(0, 180) + physical(0, 358) + unit(0x14), 180 * 360 / 358),
        (logical(0, 35999) + physical(0, 35999) + unit(0x14, -2), 36000),
        (logical(0, 62831) + physical(0, 62831) + unit(0x12, -4), 2e4 * math.pi),
        (logical(0, 36000) + physical(0, 36000) + unit(0), 36000),
        (logical(0, 255) + physical(0, 360) + unit(0x14, -2), 255),  # 3.6 degrees: the exponent is wrong
    ],
)
def test_a_turn(items: bytes, turn: float) -> None:
    axis = usage(0x30) + items + size(16) + data(INPUT)
    field = layout(collection(usage_page(DESKTOP) + usage(4), APPLICATION, axis)).input["x"].field
    assert field.counts_per_turn() == pytest.approx(turn)


@pytest.mark.parametrize(
    ("items", "north"),
    [
        (logical(0, 255) + physical(0, 36000) + unit(0x14, -2), 0),
        (logical(-180, 180) + physical(-180, 180) + unit(0x14), 0),
        (logical(-180, 180) + physical(0, 360) + unit(0x14), -180),
        (logical(0, 255) + physical(-180, 180) + unit(0), 127.5),
        (logical(-128, 127) + physical(-31416, 31416) + unit(0x12, -4), -0.5),
        # Without a range of angles the counts are the angle.
        (logical(-180, 180) + physical(0, 0) + unit(0), 0),
        (logical(1, 255) + physical(0, 0) + unit(0), 1),
        (logical(0, 255) + physical(-10000, 10000) + unit(0), 0),
        (logical(-90, 270) + physical(5, 365) + unit(0x14), 0),
    ],
)
def test_where_north_is(items: bytes, north: float) -> None:
    axis = usage(0x30) + items + size(16) + data(INPUT)
    field = layout(collection(usage_page(DESKTOP) + usage(4), APPLICATION, axis)).input["x"].field
    assert field.counts_at_north() == pytest.approx(north)


def test_numbers_that_the_core_has_too() -> None:
    assert lib.HD_HID_REPORT_BYTES == MAX_REPORT_BYTES == hid.MAX_REPORT_BYTES + 1
    assert lib.HD_HID_MESSAGES == hid.MAX_REPORTS


# ---- mutated descriptors -------------------------------------------------------------------------------------------


def check(descriptor: Descriptor, found: Layout) -> None:
    """Check that every field lies within its report and can hold its range, and that the layout is consistent."""
    kinds = {"input": ReportKind.INPUT, "pid_state": ReportKind.INPUT}
    kinds |= dict.fromkeys(("create_new_effect", "block_load", "pool"), ReportKind.FEATURE)
    for part in dataclasses.fields(found):
        kind = kinds.get(part.name, ReportKind.OUTPUT)
        for field in fields_of(getattr(found, part.name)):
            assert 1 <= field.bit_size <= 32
            assert field.bit_offset >= 0
            assert field.bit_offset + field.bit_size <= descriptor.report_bits[kind, field.report_id]
            assert descriptor.report_bytes(kind, field.report_id) <= MAX_REPORT_BYTES
            assert (field.report_id != 0) == descriptor.numbered(kind)
            low, high = (-(1 << field.bit_size - 1), (1 << field.bit_size - 1) - 1)
            low, high = (low, high) if field.is_signed else (0, (1 << field.bit_size) - 1)
            assert low <= field.logical_min <= field.logical_max <= high
            assert field.counts_per_turn() >= 0
            field.seconds_per_count()
    if found.usable:
        assert found.input and found.effect_indices and found.constant_force and found.set_effect
        assert found.effect_operation and found.device_control and found.create_new_effect and found.block_load
        assert found.constant_force.magnitude.logical_max > 0
        assert {"start", "stop"} <= set(found.effect_operation.operation.entries)
        assert "constant_force" in found.set_effect.effect_type.entries
    for axis in found.input.values():
        assert isinstance(axis, Axis) and axis.field.logical_min < axis.field.logical_max
    json.dumps(found.to_dict(), allow_nan=False)


@pytest.mark.slow
def test_layouts_of_mutated_descriptors() -> None:
    source = random.Random(2)
    usable = 0
    for joystick in VARIANTS:
        complete = bytes(joystick)
        for _ in range(40):
            try:
                descriptor = parse(mutated(source, complete))
            except DescriptorError:
                continue
            found = layout_of(descriptor)
            check(descriptor, found)
            usable += found.usable
    assert usable > 10
