"""Devices with vendor reports: their description, its errors, and the plan made from it."""

from __future__ import annotations

import copy
from typing import Any, Literal

import pytest

from hapticd.base.core import ffi, lib
from hapticd.base.errors import InvalidError
from hapticd.config.configuration import load_config
from hapticd.config.hid import Hid
from hapticd.hid.drivers.vendor import VendorDriver, plan_of
from hapticd.hid.plan import STILL_AXIS_M_PER_COUNT, DeviceError
from tests.support.hid_descriptors import (
    APPLICATION,
    INPUT,
    OUTPUT,
    collection,
    data,
    logical,
    report_id,
    size,
    usage,
    usage_page,
)

REPORT: dict[str, Any] = {
    "input": {
        "report_id": 1,
        "x": {"bit_offset": 0, "bit_size": 16, "counts_per_m": 400000},
        "y": {"bit_offset": 16, "bit_size": 16, "counts_per_m": -400000, "zero_counts": 100},
    },
    "output": {
        "report_id": 2,
        "length": 6,
        "x": {"bit_offset": 0, "bit_size": 16, "byte_order": "big", "counts_per_n": 1000},
        "y": {"bit_offset": 20, "bit_size": 12, "signed": False, "counts_per_n": -100, "zero_counts": 2048},
    },
    "enable": ["02 01 00 00 00 00 00", "feature 0301"],
    "disable": ["02 00 00 00 00 00 00"],
}
DESCRIPTOR = collection(
    usage_page(1) + usage(4),
    APPLICATION,
    report_id(1) + usage(0x30, 0x31) + logical(-32768, 32767) + size(16, 2) + data(INPUT),
    usage_page(0xFF00) + report_id(2) + usage(1) + logical(0, 255) + size(8, 6) + data(OUTPUT),
)


class Recorder:
    path = "fake0"

    def __init__(self) -> None:
        self.sent: list[tuple[str, str]] = []

    def fileno(self) -> int:
        raise AssertionError

    def write(self, report: bytes) -> None:
        self.sent.append(("output", report.hex()))

    def send_feature(self, report: bytes) -> None:
        self.sent.append(("feature", report.hex()))

    def get_feature(self, report_id: int, length: int) -> bytes:
        raise AssertionError

    def listen(self, timeout_s: float) -> bytes:
        return b""

    def close(self) -> None:
        pass


def changed(**parts: dict[str, Any]) -> dict[str, Any]:
    """Return the description with other members, by path: output__x={"bit_size": 8}."""
    report = copy.deepcopy(REPORT)
    for path, members in parts.items():
        place = report
        for key in path.split("__"):
            place = place[key]
        place.update(members)
    return report


def hid(report: dict[str, Any]) -> Hid:
    return Hid.model_validate({"report": report})


def faults(report: dict[str, Any]) -> dict[str, str]:
    with pytest.raises(InvalidError) as caught:
        load_config({"device": {"kind": "hid", "hid": {"report": report}}})
    return {problem.where: problem.problem for problem in caught.value.problems}


def test_counts_of_axes_are_those_of_the_report() -> None:
    message = "axes: counts are not used with report, whose input has counts_per_m and zero_counts"
    with pytest.raises(InvalidError, match=message):
        Hid(report=REPORT, axes={"x": {"counts": [1, 2, 3]}})


def test_enable_sequence_and_plan() -> None:
    recorder = Recorder()
    plan = VendorDriver(hid(REPORT), DESCRIPTOR).set_up(recorder)
    assert recorder.sent == [("output", "02010000000000"), ("feature", "0301")]
    assert [message.data.hex() for message in plan.stop] == ["02000000000000"]
    assert (
        plan.x.m_per_count == (1 / 400000,) * 2
        and plan.y.m_per_count == (-1 / 400000,) * 2
        and plan.y.zero_counts == 100
    )
    assert plan.force[0].at_rest() == bytes.fromhex("02 0000 00 80 0000")


@pytest.mark.parametrize(
    ("force_n", "x", "y"),
    [
        ((0, 0), 0, 2048),
        ((1.5, 0), 1500, 2048),
        ((-8.9, 3.0), -8900, 2048 - 300),
        ((40, -30), 32767, 4095),
        ((-40, 30), -32768, 0),
    ],
)
def test_forces(force_n: tuple[float, float], x: int, y: int) -> None:
    plan = plan_of(hid(REPORT), hid(REPORT).report or pytest.fail())
    described = plan.to_c()
    room = ffi.new("uint8_t[7]")
    lib.hd_hid_compose(ffi.addressof(described.force.messages, 0), ffi.new("double[2]", force_n), room)
    report = bytes(ffi.buffer(room))
    assert report[0] == 2
    assert int.from_bytes(report[1:3], "big", signed=True) == x
    assert int.from_bytes(report[3:5], "little") >> 4 == y
    assert report[5:] == b"\0\0"


def test_a_number_lies_where_its_bits_are() -> None:
    plan = plan_of(hid(REPORT), hid(REPORT).report or pytest.fail())
    for bits in (each.bits for each in plan.force[0].values):
        for counts in (bits.min_counts, -1 if bits.signed else 1, 0, 1, 1000, bits.max_counts):
            report = bytearray(b"\xa5" * 7)
            bits.put(report, counts)
            order: Literal["big", "little"] = "big" if bits.big_endian else "little"
            at = 8 + bits.bit_offset
            raw = int.from_bytes(report[at // 8 : (at + bits.bit_size + 7) // 8], order) >> at % 8
            assert raw % (1 << bits.bit_size) == counts % (1 << bits.bit_size)
            assert bits.get(bytes(report)) == counts
            bits.put(report, bits.get(b"\xa5" * 7))
            assert report == b"\xa5" * 7, "neighbouring bits are unchanged"
        with pytest.raises(ValueError):
            bits.put(bytearray(7), bits.max_counts + 1)
        with pytest.raises(ValueError):
            bits.put(bytearray(2), 0)


def test_a_single_axis_stays_where_it_is_along_the_other() -> None:
    report = copy.deepcopy(REPORT)
    del report["input"]["y"], report["output"]["y"]
    plan = plan_of(hid(report), hid(report).report or pytest.fail())
    assert plan.y.m_per_count == (STILL_AXIS_M_PER_COUNT,) * 2 and len(plan.force[0].values) == 1


@pytest.mark.parametrize(
    ("parts", "where", "problem"),
    [
        (
            {"output__x": {"bit_offset": 40}},
            "output",
            "x ends at bit 55, but 6 bytes end at bit 47",
        ),
        (
            {"output__y": {"bit_offset": 8}},
            "output",
            "x (bits 0 to 15) and y (bits 8 to 19) overlap",
        ),
        ({"input__y": {"bit_offset": 15}}, "input", "x (bits 0 to 15) and y (bits 15 to 30) overlap"),
        ({"output__x": {"bit_size": 33}}, "output.x.bit_size", "should be less than or equal to 32, is 33"),
        ({"output__x": {"bit_size": 0}}, "output.x.bit_size", "should be greater than or equal to 1, is 0"),
        (
            {"output__x": {"bit_size": 12}},
            "output.x",
            "with byte_order big, bit_offset and bit_size must be multiples of 8",
        ),
        (
            {"output__x": {"counts_per_n": 0}},
            "output.x",
            "counts_per_n must be at least 0.001, or at most -0.001, is 0",
        ),
        ({"input__x": {"counts_per_m": 0.5}}, "input.x", "counts_per_m must be at least 1, or at most -1, is 0.5"),
        (
            {"output__y": {"zero_counts": 5000}},
            "output.y",
            "zero_counts 5000 does not fit into 12 bits: 0 to 4095",
        ),
        ({"output": {"report_id": 256}}, "output.report_id", "should be less than or equal to 255, is 256"),
        ({"output": {"length": 0}}, "output.length", "should be greater than or equal to 1, is 0"),
    ],
)
def test_wrong_descriptions(parts: dict[str, Any], where: str, problem: str) -> None:
    assert faults(changed(**parts)) == {f"device.hid.report.{where}": problem}


def test_wrong_scripts() -> None:
    assert list(faults(REPORT | {"enable": ["0", "02 01"]})) == ["device.hid.report.enable[0]"]
    reason = faults(REPORT | {"disable": ["feature 02 01"]})
    assert reason == {"device.hid.report": "disable must hold output reports only, not feature reports"}


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        (
            {"output": {"length": 8}},
            "device.hid.report.output.length: output report 2 of the device has 6 bytes after its id, not 8",
        ),
        (
            {"output": {"report_id": 9}},
            "device.hid.report.output.report_id: the device has no output report 9; it has 2",
        ),
        (
            {"input": {"report_id": 7}},
            "device.hid.report.input.report_id: the device has no input report 7; it has 1",
        ),
        (
            {"input__y": {"bit_offset": 24}},
            "device.hid.report.input.y: bit 39 is beyond input report 1 of the device, which has 4 bytes after its id",
        ),
    ],
)
def test_descriptions_of_another_device(parts: dict[str, Any], reason: str) -> None:
    with pytest.raises(DeviceError) as caught:
        VendorDriver(hid(changed(**parts)), DESCRIPTOR)
    assert str(caught.value) == reason


def test_an_invalid_descriptor_is_ignored() -> None:
    VendorDriver(hid(REPORT), b"\x05")
