"""Report descriptors: cases computed by hand, hid-tools as the reference of offsets and ranges, and random bytes."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest
from hidtools.hid import HidReport, ReportDescriptor
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.hid.descriptor.parser import (
    IS_VARIABLE,
    MAX_REPORT_BYTES,
    Descriptor,
    DescriptorError,
    ReportField,
    ReportKind,
    parse,
)
from tests.support.hid_descriptors import (
    APPLICATION,
    BUTTON,
    CONSTANT,
    DATA_ARRAY,
    DESKTOP,
    FEATURE,
    INPUT,
    LOGICAL,
    OUTPUT,
    PID,
    Joystick,
    alternatives,
    collection,
    data,
    item,
    logical,
    pad,
    physical,
    pop,
    push,
    report_id,
    size,
    unit,
    usage,
    usage32,
    usage_page,
    usage_range,
    usage_range32,
    value,
)

STICK = usage_page(DESKTOP) + usage(0x04)
X, Y, Z = 0x10030, 0x10031, 0x10032

VARIANTS = [
    Joystick(),
    Joystick(control="bits"),
    Joystick(direction_bits=16),
    Joystick(direction_bits=0),
    *(Joystick(magnitude=high, magnitude_bits=bits) for high, bits in ((127, 8), (4096, 16), (10000, 16), (32767, 16))),
    Joystick(magnitude=255, magnitude_bits=8, is_magnitude_signed=False),
    *(Joystick(first_id=number) for number in (2, 20, 33)),
    Joystick(axes=(0x30,), force_axes=(0x30,), directions=1),
    Joystick(axes=(0x31, 0x30), force_axes=(0x31, 0x30)),
    Joystick(axes=(0x30, 0x31, 0x32, 0x35), axis_bits=10, axis_range=(0, 1023)),
    Joystick(is_extended=True),
    Joystick(is_pushed=True),
    Joystick(is_split=True),
    Joystick(without=frozenset({0xA7, 0x7F, 0x5A, 0x6E, 0x53, 0x56})),
]


def stick(*body: bytes) -> Descriptor:
    return parse(collection(STICK, APPLICATION, *body))


def only(*body: bytes) -> ReportField:
    (field,) = stick(*body).fields
    return field


# ---- numbers -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("items", "low", "high"),
    [
        ("15 00 25 FF", 0, 255),
        ("15 00 26 FF FF", 0, 65535),
        ("15 00 27 FF FF FF FF", 0, 2**32 - 1),
        ("25 FF 15 00", 0, 255),
        ("15 80 25 7F", -128, 127),
        ("15 81 25 FF", -127, -1),
        ("16 00 80 26 FF 7F", -32768, 32767),
        ("16 01 FF 26 FF 00", -255, 255),
        ("26 FF 00 16 01 FF", -255, 255),
        ("17 00 00 00 80 27 FF FF FF 7F", -(2**31), 2**31 - 1),
        ("14 24", 0, 0),
        ("15 FF 24", -1, 0),
    ],
)
def test_signs_of_a_range(items: str, low: int, high: int) -> None:
    field = only(usage(0x30), bytes.fromhex(items), size(32), data(INPUT))
    assert (field.logical_min, field.logical_max) == (low, high)
    # Without a physical range the logical one counts.
    assert (field.physical_min, field.physical_max) == (low, high)


def test_physical_range_and_unit() -> None:
    field = only(
        usage(0x30), logical(0, 255), bytes.fromhex("35 00 46 A0 8C 66 14 00 55 0E"), size(8), data(INPUT, 0x42)
    )
    assert (field.physical_min, field.physical_max) == (0, 36000)
    assert (field.unit, field.unit_exponent) == (0x14, -2)
    assert field.flags == IS_VARIABLE | 0x40
    negative = only(usage(0x30), logical(-1, 1), physical(-10000, 10000), unit(0x1003, -3), size(8), data(INPUT))
    assert (negative.physical_min, negative.physical_max, negative.unit_exponent) == (-10000, 10000, -3)


def test_a_physical_range_that_stands_from_another_field() -> None:
    """The range holds, as the specification says; that it was declared for another logical range is reported."""

    def one(*items: bytes) -> bytes:
        return usage(0x30) + b"".join(items) + size(8) + data(INPUT)

    items = (
        one(logical(0, 1)),  # none
        one(physical(1, 40), logical(1, 40)),
        one(logical(1, 40)),  # the same again
        one(logical(0, 99)),
        push() + one(logical(0, 50), physical(0, 500)) + pop() + one(logical(0, 50)),
        one(physical(0, 0)),
    )
    seen = [(field.physical_max, field.is_physical_stale) for field in stick(*items).fields]
    assert seen == [(1, False), (40, False), (40, False), (40, True), (500, False), (40, True), (50, False)]


def test_a_logical_minimum_above_the_maximum() -> None:
    with pytest.raises(DescriptorError, match=r"byte \d+ \(Input\): its logical minimum 5 is above its maximum 4"):
        stick(usage(0x30), logical(5, 4), size(8), data(INPUT))
    assert stick(logical(5, 4), size(8), data(INPUT, CONSTANT)).fields[0].is_constant


# ---- usages --------------------------------------------------------------------------------------------------------


def usages(field: ReportField) -> list[int | None]:
    return [field.usage_at(index) for index in range(field.count)]


def test_the_last_usage_repeats_and_the_rest_is_dropped() -> None:
    ranged = logical(0, 1)
    assert usages(only(usage(0x30, 0x31), ranged, size(8, 4), data(INPUT))) == [X, Y, Y, Y]
    field = only(usage(0x30, 0x31, 0x32), ranged, size(8, 2), data(INPUT))
    assert usages(field) == [X, Y]
    assert (field.index_of(Y), field.index_of(Z)) == (1, None)


def test_a_stray_usage_before_a_range_takes_the_first_element() -> None:
    field = only(usage(0x39) + usage_range(0x30, 0x32), logical(0, 1), size(8, 4), data(INPUT))
    assert usages(field) == [0x10039, X, Y, Z]
    assert field.index_of(Y) == 2


def test_ranges_and_single_usages_in_their_order() -> None:
    body = usage_range(0x31, 0x32) + usage(0x30) + usage_range(0x33, 0x34)
    assert usages(only(body, logical(0, 1), size(8, 5), data(INPUT))) == [Y, Z, X, 0x10033, 0x10034]


def test_maximum_before_minimum() -> None:
    body = item(0x28, 0x31) + item(0x18, 0x30)
    assert usages(only(body, logical(0, 1), size(8, 2), data(INPUT))) == [X, Y]


def test_extended_usages_keep_their_page() -> None:
    body = usage_page(PID) + usage32(DESKTOP, 0x30) + usage(0x70) + usage_range32(BUTTON, 1, 2)
    assert usages(only(body, logical(0, 1), size(8, 4), data(OUTPUT))) == [X, 0xF0070, 0x90001, 0x90002]


def test_a_page_after_the_usages() -> None:
    body = usage_page(BUTTON) + usage(0x30, 0x31) + usage_page(DESKTOP)
    assert usages(only(body, logical(0, 1), size(8, 2), data(INPUT))) == [X, Y]


def test_a_page_between_the_usages() -> None:
    body = usage_page(BUTTON) + usage(1) + usage_page(DESKTOP) + usage(0x30)
    assert usages(only(body, logical(0, 1), size(8, 2), data(INPUT))) == [0x90001, X]


def test_arrays_count_indices() -> None:
    body = usage_page(PID) + usage(0x96) + usage_range(0x97, 0x9C)
    field = only(body, logical(1, 7), size(8), data(OUTPUT, DATA_ARRAY))
    assert field.index_of(0xF0097) == 1
    assert field.index_of(0xF009C) == 6
    assert field.usage_at(7) is None


def test_a_vast_range_costs_nothing() -> None:
    field = only(usage_range32(BUTTON, 0, 0xFFFF), logical(0, 65535), size(16), data(INPUT, DATA_ARRAY))
    assert field.index_of(0x9FFFF) == 65535


def test_alternatives() -> None:
    body = alternatives(usage(0x38), usage(0x30), usage32(PID, 0x70)) + usage(0x31)
    field = only(body, logical(0, 1), size(8, 2), data(INPUT))
    assert usages(field) == [0x10038, Y]
    found = parse(collection(usage_page(DESKTOP) + alternatives(usage(0x08), usage(0x04)), APPLICATION))
    assert found.collections[0].usage == 0x10008


# ---- state ---------------------------------------------------------------------------------------------------------


def test_push_and_pop_keep_all_globals() -> None:
    inner = usage_page(BUTTON) + logical(-5, 5) + physical(1, 2) + unit(0x1003, -3) + size(3, 7) + report_id(9)
    outer = logical(0, 15) + size(4, 2) + report_id(3)
    first, second = stick(outer, push(), inner, usage(1), data(OUTPUT), pop(), usage(0x30), data(OUTPUT)).fields
    assert (first.report_id, first.bit_size, first.count, first.logical_min) == (9, 3, 7, -5)
    assert (second.report_id, second.bit_size, second.count) == (3, 4, 2)
    assert (second.logical_min, second.logical_max, second.physical_max, second.unit) == (0, 15, 15, 0)
    assert second.unit_exponent == 0
    assert second.usage_at(0) == X


def test_locals_end_with_the_main_item() -> None:
    first, second = stick(usage(0x30), logical(0, 1), size(8), data(INPUT), data(INPUT)).fields
    assert first.usages and not second.usages


def test_offsets_count_by_kind_and_id() -> None:
    one, two = report_id(1), report_id(2)
    part = logical(0, 1) + size(3, 2)
    fields = stick(one, part, data(INPUT), two, data(INPUT), data(OUTPUT), one, data(INPUT), data(FEATURE)).fields
    assert [(f.kind, f.report_id, f.bit_offset) for f in fields] == [
        ("input", 1, 0),
        ("input", 2, 0),
        ("output", 2, 0),
        ("input", 1, 6),
        ("feature", 1, 0),
    ]


def test_collections_of_one_usage_differ() -> None:
    twice = collection(usage_page(PID) + usage(0x73), LOGICAL, value(OUTPUT, 0x70, 0, 255, 8)) * 2
    found = stick(twice)
    first, second = found.fields
    assert [c.usage for c in first.path] == [0x10004, 0xF0073] == [c.usage for c in second.path]
    assert first.path[0] == second.path[0]
    assert first.path[1] != second.path[1]
    assert first.within(0xF0073) == found.collections[1]
    assert first.within(0xF0021) is None
    assert found.collections[1].type == LOGICAL


def test_several_top_level_collections() -> None:
    found = parse(collection(STICK, APPLICATION) + collection(usage_page(PID) + usage(1), APPLICATION))
    assert [c.usage for c in found.collections] == [0x10004, 0xF0001]


def test_report_lengths() -> None:
    found = stick(report_id(7), pad(INPUT, 9), report_id(8), pad(OUTPUT, 8))
    assert found.report_bytes(ReportKind.INPUT, 7) == 3
    assert found.report_bytes(ReportKind.OUTPUT, 8) == 2
    assert found.numbered(ReportKind.INPUT) and not found.numbered(ReportKind.FEATURE)
    assert stick(pad(INPUT, 9)).report_bytes(ReportKind.INPUT, 0) == 2


def test_fields_without_bits() -> None:
    found = stick(usage(0x30), logical(0, 1), size(8, 0), data(INPUT), size(0, 8), data(INPUT), size(8), data(INPUT))
    (field,) = found.fields
    assert field.bit_offset == 0


def test_long_items_and_padding_at_the_end() -> None:
    long_item = bytes([0xFE, 3, 0x80, 1, 2, 3])
    plain = value(INPUT, 0x30, 0, 255, 8)
    assert stick(long_item, plain).fields == stick(plain).fields
    assert parse(collection(STICK, APPLICATION, plain) + bytes(5)).fields == stick(plain).fields


# ---- what Linux does not mind --------------------------------------------------------------------------------------


ODDITIES = {
    "a reserved item": (bytes([0x0D, 7]), "(reserved item): skipped"),
    "a reserved item of four bytes": (bytes([0xCF, 7, 0xA1, 1, 0xC0]), "(reserved item): skipped"),
    "a reserved item without data": (bytes([0x3C]), "(reserved item): skipped"),
    "an unknown local item": (bytes([0xBA, 1, 2]), "(unknown local item): skipped"),
    "the local item that the specification leaves out": (bytes([0x69, 1]), "(unknown local item): skipped"),
    "an unknown main item": (bytes([0xD1, 1]), "(unknown main item): skipped"),
    "a byte of zero": (bytes([0x00]), "(unknown main item): skipped"),
    "a long item": (bytes([0xFE, 3, 0x80, 0xA1, 1, 0xC0]), "(long item): skipped"),
}


@pytest.mark.parametrize("name", ODDITIES)
def test_items_that_linux_skips_are_skipped_and_reported(name: str) -> None:
    """The skipped item lies between two axes, so that it must not shift or remove a field."""
    odd, message = ODDITIES[name]
    first, second = value(INPUT, 0x30, 0, 255, 8), value(INPUT, 0x31, -5, 5, 8)
    plain = stick(first, second)
    found = stick(first, odd, second)
    assert not plain.skipped
    assert found.skipped == (f"byte {6 + len(first)} {message}",)
    assert [(f.usages, f.bit_size, f.logical_min, f.logical_max) for f in found.fields if not f.is_constant] == [
        (f.usages, f.bit_size, f.logical_min, f.logical_max) for f in plain.fields
    ]


def test_an_unknown_main_item_ends_the_local_state_and_others_do_not() -> None:
    """Linux' hid_parser_main does the same; a reserved or unknown local item keeps the usages before it."""
    rest = logical(0, 1) + size(8) + data(INPUT)
    assert usages(only(usage(0x30), bytes([0x0D, 7]), bytes([0xBA, 1, 2]), rest)) == [X]
    assert not only(usage(0x30), bytes([0xD1, 1]), rest).usages


@pytest.mark.parametrize(
    ("body", "first", "message"),
    [
        # Without a usage it is padding.
        (item(0x18, 0x30), None, "(Usage Minimum): a range without one of its ends: skipped"),
        (usage(0x31) + item(0x28, 0x30), Y, "(Usage Minimum): a range without one of its ends: skipped"),
        (usage_range(0x31, 0x30), None, "(Usage Maximum): not a valid range, from 0x31 to 0x30: skipped"),
        (item(0x18, 0x10030, 4) + item(0x28, 0x31), None, "not a valid range, from 0x10030 to 0x31: skipped"),
        (usage_page(0x10001) + usage(0x30), X, "(Usage Page): 0x10001 has more than 16 bits: used as 0x1"),
    ],
)
def test_usages_that_are_not_as_they_should_be(body: bytes, first: int | None, message: str) -> None:
    found = stick(body, logical(0, 255), size(8), data(INPUT))
    assert found.fields[0].usage_at(0) == first
    (skipped,) = found.skipped
    assert message in skipped


def test_a_range_among_alternatives() -> None:
    found = stick(alternatives(usage_range(0x30, 0x31), usage(0x38)), logical(0, 1), size(8, 2), data(INPUT))
    assert usages(found.fields[0]) == [X, Y]
    late = stick(alternatives(usage(0x30), usage_range(0x31, 0x32)), logical(0, 1), size(8), data(INPUT))
    assert usages(late.fields[0]) == [X]


def test_a_collection_has_the_first_usage_before_it() -> None:
    assert parse(collection(usage_page(DESKTOP) + usage(0x04, 0x01), APPLICATION)).collections[0].usage == 0x10004


def test_the_list_of_skipped_items_is_limited() -> None:
    found = stick(bytes([0x0D, 7]) * 50, value(INPUT, 0x30, 0, 255, 8))
    assert len(found.skipped) == 17 and found.skipped[-1] == "34 more items"


# ---- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("descriptor", "message"),
    [
        (b"", "empty"),
        (STICK, "declares no collection"),
        (bytes(4097), "has 4097"),
        (STICK + bytes([0xA1]), r"byte 4 \(Collection\): the descriptor ends after 0 of the item's 1 bytes"),
        (bytes([0x27, 1, 2]), r"byte 0 \(Logical Maximum\): the descriptor ends after 2 of the item's 4 bytes"),
        (bytes([0xFE]), "byte 0 .long item.: the descriptor ends"),
        (bytes([0xFE, 9, 1, 2]), "byte 0 .long item.: the descriptor ends after 3 of the item's 11 bytes"),
        (STICK + item(0xA0, 1), r"a collection is still open at its end \(byte 6\)"),
        (collection(STICK, APPLICATION) + item(0xC0), r"byte 7 \(End Collection\): no collection is open"),
        (item(0x84, 0), r"byte 0 \(Report ID\): must be between 1 and 255, is 0"),
        (item(0x84, 256), r"must be between 1 and 255, is 256"),
        (pop(), r"\(Pop\): nothing was pushed"),
        (push() * 65, r"byte 64 \(Push\): more than 64"),
        (item(0xA0, 0) * 65, r"byte 128 \(Collection\): more than 64"),
        (item(0xA8, 0), r"\(Delimiter\): no set is open"),
        (item(0xA8, 1) * 2, "a set is already open"),
        (bytes([0xC4, 0]), "byte 0 .C4.: unknown global item"),
        (size(32, 65536) + data(INPUT), f"must have at most {MAX_REPORT_BYTES} bytes, has 262144"),
        (size(8 * MAX_REPORT_BYTES) + data(OUTPUT) + size(1) + data(OUTPUT), r"byte 13 \(Output\)"),
    ],
)
def test_refused(descriptor: bytes, message: str) -> None:
    with pytest.raises(DescriptorError, match=message) as caught:
        parse(descriptor)
    assert "\n" not in str(caught.value)


@pytest.mark.long
def test_every_truncation_is_refused() -> None:
    complete = bytes(Joystick())
    for length in range(len(complete)):
        with pytest.raises(DescriptorError):
            parse(complete[:length])


# ---- the oracle ----------------------------------------------------------------------------------------------------

Rows = list[tuple[object, ...]]


def ours(found: Descriptor) -> dict[tuple[str, int], Rows]:
    """Return every element of every report; an array counts as one element, and so does padding without usages."""
    rows: dict[tuple[str, int], Rows] = {}
    for field in found.fields:
        row = rows.setdefault((field.kind.value, field.report_id), [])
        ranged = (field.logical_min, field.logical_max)
        if not field.usages:
            row.append((field.bit_offset, field.bit_size * field.count, *ranged))
        elif not field.is_variable:
            row.append((field.bit_offset, field.bit_size, *ranged, field.count))
        else:
            for index in range(field.count):
                offset = field.bit_offset + index * field.bit_size
                row.append((offset, field.bit_size, *ranged, field.usage_at(index)))
    return rows


def theirs(descriptor: bytes) -> dict[tuple[str, int], Rows]:
    found = ReportDescriptor.from_bytes(list(descriptor))
    rows: dict[tuple[str, int], Rows] = {}

    def put(kind: str, reports: dict[int, HidReport]) -> Iterator[None]:
        for number, report in reports.items():
            row = rows.setdefault((kind, max(number, 0)), [])
            id_bits = 8 if report.numbered else 0
            for field in report:
                high = field.logical_max
                if field.logical_min < 0:  # hid-tools does not change maxima
                    bits = 8 if high < 0x100 else 16 if high < 0x10000 else 32
                    high -= (high >> (bits - 1)) << bits
                ranged = (field.logical_min, high)
                if field.is_array:
                    row.append((field.start - id_bits, field.size, *ranged, field.count))
                elif field.usage:
                    row.append((field.start - id_bits, field.size, *ranged, field.usage))
                else:
                    row.append((field.start - id_bits, field.size, *ranged))
            yield

    for kind, reports in (
        ("input", found.input_reports),
        ("output", found.output_reports),
        ("feature", found.feature_reports),
    ):
        list(put(kind, reports))
    return rows


@pytest.mark.parametrize("joystick", VARIANTS)
def test_against_hid_tools(joystick: Joystick) -> None:
    descriptor = bytes(joystick)
    found = parse(descriptor)
    assert ours(found) == theirs(descriptor)
    reference = ReportDescriptor.from_bytes(list(descriptor))
    for number, report in reference.output_reports.items():
        assert found.report_bytes(ReportKind.OUTPUT, number) == report.size


_Part = tuple[int, int, int, tuple[int, int], int, int, list[int], bool, bool]

field_parts = st.tuples(
    st.sampled_from([INPUT, OUTPUT, FEATURE]),
    st.sampled_from([DATA_ARRAY, 2, 6, 0x42]),
    st.integers(1, 5),  # report id
    st.sampled_from([(0, 1), (0, 255), (-128, 127), (-32768, 32767), (0, 65535), (1, 6), (-1, 0)]),
    st.integers(1, 32),
    st.integers(1, 6),
    st.lists(st.integers(1, 0xFF), min_size=1, max_size=8),
    st.booleans(),  # extended usages
    st.booleans(),  # between Push and Pop
)


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(st.lists(field_parts, min_size=1, max_size=12))
def test_made_up_descriptors_against_hid_tools(parts: list[_Part]) -> None:
    body = b""
    for kind, flags, number, (low, high), bits, count, names, is_extended, is_pushed in parts:
        built = usage_page(PID) + logical(low, high) + size(bits, count) + report_id(number)
        built += (usage32(BUTTON, *names) if is_extended else usage(*names)) + data(kind, flags)
        # hid-tools does not put report ids on its stack.
        body += push() + built + pop() + report_id(number) if is_pushed else built
    descriptor = collection(STICK, APPLICATION, body)
    assert ours(parse(descriptor)) == theirs(descriptor)


# ---- bytes that make no sense --------------------------------------------------------------------------------------


def check(found: Descriptor) -> None:
    """Check that the fields of a report have no gaps or overlaps, and end where the report ends."""
    ends: dict[tuple[ReportKind, int], int] = {}
    for field in found.fields:
        report = (field.kind, field.report_id)
        assert field.bit_offset == ends.get(report, 0)
        assert field.bit_size > 0 and field.count > 0
        assert field.is_constant or field.logical_min <= field.logical_max
        ends[report] = field.bit_offset + field.bit_size * field.count
    assert {report: bits for report, bits in found.report_bits.items() if bits} == ends
    assert all(bits <= 8 * MAX_REPORT_BYTES for bits in ends.values())


@pytest.mark.long
@settings(max_examples=500, deadline=None)
@given(st.binary(max_size=200))
def test_random_bytes(descriptor: bytes) -> None:
    try:
        found = parse(descriptor)
    except DescriptorError:
        return
    check(found)


def mutated(source: random.Random, descriptor: bytes) -> bytes:
    """Flip, remove, repeat or move a few bytes."""
    data = bytearray(descriptor)
    for _ in range(source.randint(1, 4)):
        at, length = source.randrange(len(data)), source.randint(1, 8)
        match source.randrange(5):
            case 0:
                data[at] ^= 1 << source.randrange(8)
            case 1:
                data[at] = source.choice((0, 1, 0x7F, 0x80, 0xFF, source.randrange(256)))
            case 2:
                del data[at : at + length]
            case 3:
                data[at:at] = data[at : at + length]
            case _:
                part = bytes(data[at : at + length])
                del data[at : at + length]
                to = source.randrange(len(data) + 1)
                data[to:to] = part
        if not data:
            data = bytearray(1)
    return bytes(data)


@pytest.mark.long
def test_mutated_descriptors() -> None:
    source = random.Random(1)
    read = 0
    for joystick in VARIANTS:
        complete = bytes(joystick)
        for _ in range(40):
            try:
                found = parse(mutated(source, complete))
            except DescriptorError as error:
                assert "\n" not in str(error)
                continue
            check(found)
            read += 1
    assert read > 40  # enough descriptors are valid for the check to be meaningful
