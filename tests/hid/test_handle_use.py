"""Warnings about a handle that rests inside an object, or that does not reach the ends of its range."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE, Flag, records
from hapticd.config.hid import Hid
from hapticd.hid.handle_use import HandleUse
from hapticd.hid.plan import Plan
from hapticd.hid.verdict import verdict_of
from tests.hid.test_vendor import DESCRIPTOR, REPORT
from tests.support.firmware_descriptors import OPENFFBOARD_1
from tests.support.hid_descriptors import Joystick

STICK = bytes(Joystick(axis_range=(-512, 511), axis_bits=10))
TRAVEL_M = 0.06
M_PER_COUNT = TRAVEL_M / 511.5
STEP_S = 0.05
"""Time between two batches of samples."""


class Stick:
    """A handle whose counts a test gives; the warnings about it. Until something else is said, nothing is touched."""

    def __init__(self, *, from_file: bool = False, desc: bytes = STICK, **hid: Any) -> None:
        self.hid = Hid.model_validate({"travel_m": TRAVEL_M, **hid})
        plan = verdict_of(self.hid, desc if self.hid.report is None else DESCRIPTOR).plan
        assert plan is not None
        self.plan: Plan = plan
        self.use = HandleUse(self.hid, from_file=from_file)
        self.time_s, self.revision = 0.0, 1
        self.touched: list[str] = []
        self.force_n = 0.0
        self.flags = Flag(0)

    def at(self, x: float, y: float, duration_s: float) -> None:
        """Hold the handle at these counts."""
        self.along([(x, y)] * max(1, round(duration_s / STEP_S)))

    def along(self, way: list[tuple[float, float]]) -> None:
        """Move the handle through these counts, with STEP_S from one to the next."""
        for x, y in way:
            self.time_s += STEP_S
            sample = records(SAMPLE_DTYPE, 2)
            sample["time_ns"] = round(1e9 * self.time_s)
            sample["position_m"] = self.plan.x.position_m(x), self.plan.y.position_m(y)
            sample["revision"] = self.revision
            sample["flags"] = self.flags | (Flag.CONTACT if self.touched else 0)
            sample["contact_force_n"] = 0.0, self.force_n
            self.use.note(sample, self.plan, lambda: self.touched)

    def inside(self, *names: str, force_n: float = 1.92) -> None:
        self.touched, self.force_n = list(names), force_n

    def sweep(self, low: float, high: float, duration_s: float) -> None:
        """Move the handle along y through its whole range, from end to end in a second."""
        count = round(duration_s / STEP_S)
        phase = np.abs((np.arange(count) * STEP_S / 0.5 + 1) % 4 - 2) - 1  # a triangle from -1 to 1
        self.along([(0, (low + high) / 2 + (high - low) / 2 * part) for part in phase])


def test_a_rest_inside_an_object_is_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    stick = Stick()
    stick.inside("floor")
    stick.at(0, 20, 4)
    assert stick.use.lines == ()
    with caplog.at_level(logging.WARNING, "hapticd"):
        stick.at(0, 20, 2)
        stick.at(0, 21, 60)  # its counts are not steadier than that
    (line,) = stick.use.lines
    # HID's Y grows towards the user; the middle of -512..511 is -0.5.
    assert line.startswith("the handle rests at x 0.1 mm, y -2.4 mm, inside floor, which pushes it with 1.9 N: ")
    assert "if nobody holds it, `hapticd devices calibrate` measures where the middle is; or move the object" in line
    assert [record.message for record in caplog.records] == [line]


def test_a_rest_in_short_pieces() -> None:
    """As a recording has it that is played again and again: half a second of rest every two seconds."""
    stick = Stick(from_file=True)
    for _ in range(16):
        stick.inside()
        stick.along([(0, y) for y in (*range(20, 396, 40), *range(396, -327, -40), *range(-327, 20, 40))])
        stick.inside("floor")
        stick.at(0, 20, 0.5)
    (line,) = stick.use.lines
    assert (
        "set the middle of device.hid.axes.x.counts to 0 and of device.hid.axes.y.counts to 20, or move the object"
        in line
    )
    assert "devices calibrate" not in line


@pytest.mark.parametrize(
    ("touched", "force_n"), [((), 2.0), (("table",), 0.05)], ids=["a field holds it", "half a count below a surface"]
)
def test_a_rest_that_is_no_fault(touched: tuple[str, ...], force_n: float) -> None:
    stick = Stick()
    stick.inside(*touched, force_n=force_n)
    stick.at(0, 0, 30)
    assert stick.use.lines == ()


def test_a_hand_that_presses_is_no_rest() -> None:
    """The handle was at rest elsewhere before, and a hand does not hold one place for long."""
    stick = Stick()
    stick.at(0, 0, 20)
    for depth in range(60, 120, 10):
        stick.inside("floor")
        stick.at(0, depth, 4)
        stick.inside()
        stick.at(0, 0, 3)
    assert stick.use.lines == ()
    stick.inside("floor")
    stick.at(0, 60, 20)  # that is one
    assert len(stick.use.lines) == 1


def test_another_scene_ends_the_warning_unless_it_pushes_too(caplog: pytest.LogCaptureFixture) -> None:
    stick = Stick()
    stick.inside("floor")
    stick.at(0, 20, 6)
    stick.revision += 1
    stick.inside()
    stick.at(0, 20, 1)
    assert stick.use.lines == ()
    stick.revision += 1
    stick.inside("block")
    stick.at(0, 20, 1)
    assert "inside block" in stick.use.lines[0]
    assert len(caplog.messages) == 1, "a program that makes new objects again and again does not fill the log"


def test_calibrated_counts_leave_only_the_object() -> None:
    counts = {"counts": [-327, 0, 396]}
    stick = Stick(axes={"x": counts, "y": counts})
    stick.inside("floor")
    stick.at(0, 20, 6)
    assert stick.use.lines[0].endswith("if nobody holds it, move the object")


def test_a_range_that_is_not_reached_in_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    stick = Stick()
    stick.sweep(-327, 396, 59)
    assert stick.use.lines == ()
    with caplog.at_level(logging.WARNING, "hapticd"):
        stick.sweep(-327, 396, 3)
    (line,) = stick.use.lines
    assert line == (
        "axis y reported -327..396 of -512..511 in a minute's use: if it reached its stops, "
        "`hapticd devices calibrate` measures device.hid.axes.y.counts"
    )
    assert [record.message for record in caplog.records] == [line]
    stick.sweep(-512, 511, 5)
    assert stick.use.lines == (), "it has reached them"


def test_the_range_of_a_recording_is_to_be_written() -> None:
    stick = Stick(from_file=True)
    stick.sweep(-327, 396, 58)
    stick.at(0, 20, 3)
    assert stick.use.lines[0].endswith("if it reached its stops, set device.hid.axes.y.counts: [-327, 20, 396]")


def test_a_handle_that_nobody_moves_is_not_used() -> None:
    stick = Stick()
    stick.sweep(-100, 100, 30)
    stick.at(0, 0, 100)
    assert stick.use.lines == ()


def test_a_range_that_is_as_expected() -> None:
    short = Stick(axes={"y": {"counts": [-327, 20, 396]}})
    short.sweep(-200, 250, 62)
    assert short.use.lines == (), "a measured range need not be used up"
    short.sweep(-340, 400, 5)
    assert short.use.lines == ()
    short.sweep(-512, 511, 5)
    assert short.use.lines == (
        "axis y reported -512..511, beyond device.hid.axes.y.counts, -327..396: `hapticd devices calibrate` measures "
        "device.hid.axes.y.counts",
    )
    almost = Stick()
    almost.sweep(-505, 500, 62)
    assert almost.use.lines == ()


def test_a_jump_is_no_reach() -> None:
    stick = Stick()
    stick.sweep(-327, 396, 62)
    stick.flags = Flag.GLITCH
    stick.at(0, 511, STEP_S)
    stick.at(0, -512, STEP_S)
    stick.flags = Flag(0)
    stick.sweep(-327, 396, 2)
    assert len(stick.use.lines) == 1


def test_a_device_with_vendor_reports_has_its_own_scale() -> None:
    stick = Stick(report=REPORT)
    stick.sweep(-10, 10, 62)
    assert stick.use.lines == ()
    stick.inside("floor")
    stick.at(0, 10, 20)
    assert "zero_counts of device.hid.report.input" in stick.use.lines[0]


@pytest.mark.parametrize(
    "desc", [OPENFFBOARD_1, bytes(Joystick(axes=(0x30,), force_axes=(0x30,)))], ids=["pedal", "none"]
)
@pytest.mark.parametrize(
    ("x", "remedy"),
    [
        ({}, "set the middle of device.hid.axes.x.counts to 5000, or move the object"),
        ({"counts": [-30000, 4000, 30000]}, "move the object"),
    ],
)
def test_the_rest_of_a_wheel_concerns_x_alone(desc: bytes, x: dict[str, Any], remedy: str) -> None:
    wheel = Stick(desc=desc, from_file=True, axes={"x": x})
    wheel.inside("block")
    wheel.at(5000, 0, 6)
    assert wheel.use.lines[0].endswith(f"if nobody holds it, {remedy}")


def test_the_pedal_of_a_wheel_has_no_range_to_warn_of() -> None:
    stick = Stick(desc=OPENFFBOARD_1)
    stick.along([(32767 * math.sin(i), 32740 + i % 27) for i in range(round(62 / STEP_S))])
    assert stick.use.lines == ()


def test_ten_bits_in_a_range_of_sixteen_are_reported() -> None:
    """Firmware that sends what its converter gives, 0 to 1023."""
    stick = Stick(desc=bytes(Joystick(axis_range=(0, 65535))))
    stick.sweep(0, 1023, 62)
    assert len(stick.use.lines) == 1 and " of 0..65535 in a minute's use" in stick.use.lines[0]


def test_an_axis_along_which_nobody_moves_is_not_reported() -> None:
    stick = Stick()
    stick.sweep(-512, 511, 62)  # x is 0, then 1
    stick.at(1, 0, 1)
    assert stick.use.lines == ()
