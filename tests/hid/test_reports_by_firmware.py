"""Reports to a device of the PID class, checked by an independent firmware (tests/support/firmware.py)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pytest
import yaml

from hapticd.base.core import ffi, lib
from hapticd.config.hid import Hid
from hapticd.config.modes import Mode
from hapticd.hid.descriptor.layout import AXIS_USAGES, layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.nearest_effect import nearest_effect
from hapticd.hid.offload import effect_messages
from hapticd.hid.plan import DeviceError, Plan
from hapticd.hid.sign_calibration import calibrate
from tests.support import firmware_descriptors as descriptors
from tests.support.firmware import ADAPT, FINO, OPENFFBOARD, OPENFFBOARD_1, Firmware, Variant
from tests.support.hid_descriptors import DESKTOP, ORDINAL, OUTPUT, Joystick, logical, pad, physical, usage, usage32

FULL_N = 8.0
FORCES = (
    (4.0, 0.0),
    (-4.0, 0.0),
    (0.0, 2.0),
    (0.0, -6.0),
    (3.0, 4.0),
    (-1.0, 2.5),
    (-5.0, -5.0),
    (0.2, 0.0),
    (0.0, 0.0),
)
FAMILIES = {
    "sidewinder": (descriptors.SIDEWINDER_FF2, Variant()),
    "openffboard": (descriptors.OPENFFBOARD_2, OPENFFBOARD),
    "fino": (descriptors.FINO, FINO),
    "fino, two axes": (descriptors.arduino(2), FINO),
    "adapt-ffb-joy": (descriptors.ADAPT_FFB_JOY, ADAPT),
    "8-bit directions": (bytes(Joystick()), Variant()),
    "16-bit directions": (bytes(Joystick(direction_bits=16)), Variant()),
    "commands as bits": (bytes(Joystick(control="bits")), Variant()),
    "slow to load": (bytes(Joystick()), Variant(load_after=2)),
    "few effects": (bytes(Joystick()), Variant(most_effects=2)),
    "signed directions": (bytes(Joystick(direction_bits=16, is_direction_signed=True)), Variant()),
    "extended usages": (bytes(Joystick(is_extended=True, is_split=True, first_id=20)), Variant(first_index=7)),
    "pushed": (bytes(Joystick(is_pushed=True, control="bits")), Variant(reset_disables=True)),
    "tenths of a ms": (bytes(Joystick(time_exponent=-4)), Variant()),
    "without reset": (bytes(Joystick(without=frozenset({0x9A, 0x7F}))), Variant(tells="nothing")),
    "one effect": (bytes(Joystick(direction_bits=16)), Variant(most_effects=1)),
    "unsigned": (bytes(Joystick(direction_bits=16, is_magnitude_signed=False)), Variant()),
    "room for one at a time": (bytes(Joystick(direction_bits=16)), Variant(simultaneous=1)),
    "pool stalls": (bytes(Joystick()), Variant(pool_stalls=True)),
    "pool says one at first": (bytes(Joystick()), Variant(pool_says=(1,))),
}


SPECIFIED: Final = Variant()


def driver(stick: Firmware, **keys: Any) -> PidDriver:
    return PidDriver(layout_of(parse(stick.descriptor)), hid(**keys))


def hid(**keys: Any) -> Hid:
    return Hid.model_validate({"full_scale_force_n": FULL_N, **keys})


@contextmanager
def driven(descriptor: bytes, variant: Variant = SPECIFIED, **keys: Any) -> Iterator[tuple[Firmware, Plan]]:
    with Firmware(descriptor, variant) as stick:
        yield stick, driver(stick, **keys).set_up(stick.device)


def send(stick: Firmware, plan: Plan, force_n: tuple[float, float]) -> None:
    """Send the reports that C makes of a force."""
    described = plan.to_c()
    for place, message in enumerate(plan.force):
        room = ffi.new("uint8_t[]", len(message.data))
        lib.hd_hid_compose(ffi.addressof(described.force.messages, place), ffi.new("double[2]", force_n), room)
        stick.take(bytes(ffi.buffer(room)))


def step_of(stick: Firmware) -> float:
    """Return one count of the magnitude, as a fraction of the full force."""
    return 1.0 / stick.forms["constant_force"].numbers["magnitude"].logical[1]


@pytest.mark.parametrize("name", FAMILIES)
def test_signs_and_sizes(name: str) -> None:
    """Each magnitude is right within half a count along each axis, also if no count of a direction is a right angle."""
    with driven(*FAMILIES[name]) as (stick, plan):
        assert stick.force() == (0.0, 0.0)
        for force_n in FORCES:
            send(stick, plan, force_n)
            wanted = (force_n[0] / FULL_N, force_n[1] / FULL_N)
            # The full force acts from the beginning to the end of the effect: there is no envelope.
            for t_s in (stick.now, stick.now + 0.05, stick.now + 0.099):
                assert stick.force(t_s) == pytest.approx(wanted, abs=0.52 * step_of(stick) + 1e-4), force_n
        assert stick.force(stick.now + 0.102) == (0.0, 0.0)
        assert stick.faults == []


@pytest.mark.parametrize("signs", [(1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("name", ["sidewinder", "fino", "8-bit directions"])
def test_reversed_devices_are_right_with_their_signs(name: str, signs: tuple[int, int]) -> None:
    descriptor, variant = FAMILIES[name]
    axes = {axis: {"sign": sign} for axis, sign in zip("xy", signs, strict=True)}
    with driven(descriptor, replace(variant, signs=signs), force_axes=axes) as (stick, plan):
        for force_n in FORCES:
            send(stick, plan, force_n)
            wanted = (force_n[0] / FULL_N, force_n[1] / FULL_N)
            assert stick.force() == pytest.approx(wanted, abs=0.52 * step_of(stick) + 1e-4), force_n


@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1)])
def test_swapped_axes(signs: tuple[int, int]) -> None:
    """The device's first axis exerts the force along y, its second axis that along x, each with its sign."""
    axes = {"swap": True, "x": {"sign": signs[0]}, "y": {"sign": signs[1]}}
    with driven(descriptors.SIDEWINDER_FF2, force_axes=axes) as (stick, plan):
        for x_n, y_n in FORCES:
            send(stick, plan, (x_n, y_n))
            wanted = (signs[0] * y_n / FULL_N, signs[1] * x_n / FULL_N)
            assert stick.force() == pytest.approx(wanted, abs=0.52 * step_of(stick) + 1e-4), (x_n, y_n)


def test_one_effect_for_both_axes_reports_the_force_at_right_angles() -> None:
    """With 255 counts a turn, half a count diverts 1.2 % of the force to the side."""
    with driven(bytes(Joystick(is_magnitude_signed=False))) as (stick, plan):
        assert len(stick.effects) == 1
        assert plan.leak == pytest.approx(math.sin(math.pi / 255.0), rel=1e-12)
        worst = 0.0
        for k in range(144):
            angle = math.pi * k / 72.0
            send(stick, plan, (FULL_N * math.sin(angle), FULL_N * math.cos(angle)))
            x, y = stick.force()
            worst = max(worst, abs(x * math.cos(angle) - y * math.sin(angle)))
        assert 0.9 * plan.leak < worst <= plan.leak + 1e-9
    with driven(descriptors.SIDEWINDER_FF2) as (_, plan):
        assert plan.leak == 0.0


def test_too_large_a_force_along_one_axis_causes_none_along_the_other() -> None:
    with driven(descriptors.SIDEWINDER_FF2) as (stick, plan):
        send(stick, plan, (1e6, 0.0))
        assert stick.force() == pytest.approx((1.0, 0.0), abs=step_of(stick))


def _vectors(force_axes: tuple[int, ...] = (0x30, 0x31), without: frozenset[int] = frozenset({0x56})) -> bytes:
    """Return a descriptor whose direction is a vector: X and Y from -127 to 127."""
    angles = usage32(ORDINAL, 1, 2) + logical(0, 255) + physical(0, 36000)
    parts = usage32(DESKTOP, 0x30, 0x31) + logical(-127, 127) + physical(-127, 127)
    descriptor = bytes(Joystick(force_axes=force_axes, without=without))
    assert descriptor.count(angles) == 1
    return descriptor.replace(angles, parts)


@pytest.mark.parametrize("name", ["no direction", "vectors"])
def test_axes_alone_go_the_way_of_the_device(name: str) -> None:
    """Without an angle only the axis is sent. The device's Y grows towards the user, which a calibration finds."""
    descriptor = _vectors() if name == "vectors" else bytes(Joystick(direction_bits=0, without=frozenset({0x56})))
    table = Table(descriptor, SPECIFIED, 5.0)
    with table.stick as stick:
        found = calibrate(stick.device, driver(stick), hid(), 0.4, now=lambda: stick.now, pause=table.pause)
    assert (found.force_axes.x.sign, found.force_axes.y.sign, found.force_axes.swap) == (1, -1, False)
    with driven(descriptor, force_axes=found.force_axes.to_dict()) as (stick, plan):
        for force_n in FORCES:
            send(stick, plan, force_n)
            assert stick.force() == pytest.approx((force_n[0] / FULL_N, force_n[1] / FULL_N), abs=2e-4), force_n
        assert stick.faults == []


@pytest.mark.parametrize(("first", "second"), [("Rx", "Ry"), ("Z", "Rz"), ("X", "Z")])
def test_axes_of_other_names_are_enabled_one_by_one(first: str, second: str) -> None:
    """A handle with other axes than X and Y, without an angle: no axis was enabled, so no force was felt."""
    pair = (AXIS_USAGES[first.lower()], AXIS_USAGES[second.lower()])
    descriptor = bytes(Joystick(axes=pair, force_axes=pair, direction_bits=0, without=frozenset({0x56})))
    with driven(descriptor, axes={"x": {"usage": first}, "y": {"usage": second}}) as (stick, _):
        shown = [str(stick.read(report)[1]["axes"]) for report in stick.sent("set_effect")]
        assert shown == [first.lower(), second.lower()]


def test_a_third_axis_is_left_alone() -> None:
    """The handle's axes are enabled, whatever axes lie between them."""
    descriptor = bytes(
        Joystick(axes=(0x30, 0x35), force_axes=(0x30, 0x32, 0x35), direction_bits=0, without=frozenset({0x56}))
    )
    with driven(descriptor, axes={"y": {"usage": "Rz"}}) as (stick, _):
        shown = [str(stick.read(report)[1]["axes"]) for report in stick.sent("set_effect")]
        assert shown == ["x", "rz"]


def test_a_wheel_with_pedals_and_no_y_is_pushed_along_x() -> None:
    """Some wheels name X and Y as axes of their forces. A configured axis that is missing is refused."""
    wheel = bytes(Joystick(axes=(0x30, 0x32, 0x35)))
    with driven(wheel) as (stick, plan):
        assert plan.driven_axes == (True, False) and len(plan.force) == 1
        for force_n in (4.0, -2.0, 0.5):
            send(stick, plan, (force_n, 3.0))
            assert stick.force()[0] == pytest.approx(force_n / FULL_N, abs=0.52 * step_of(stick) + 1e-4)
        assert stick.faults == []
    with (
        pytest.raises(DeviceError, match="the device has no axis Rx; it has X, Z, Rz"),
        driven(wheel, axes={"y": {"usage": "Rx"}}),
    ):
        pass


@pytest.mark.parametrize("has_enable", [False, True])
def test_a_direction_of_two_parts_needs_no_axes_enable(has_enable: bool) -> None:
    """Components of a vector distinguish the axes; Y grows towards the user, which a calibration finds."""
    descriptor = _vectors(force_axes=(), without=frozenset() if has_enable else frozenset({0x56}))
    with driven(descriptor, force_axes={"y": {"sign": -1}}) as (stick, plan):
        for force_n in FORCES:
            send(stick, plan, force_n)
            assert stick.force() == pytest.approx((force_n[0] / FULL_N, force_n[1] / FULL_N), abs=2e-4), force_n
        if has_enable:
            assert [stick.read(report)[1]["direction_enable"] for report in stick.sent("set_effect")] == [1, 1]
        assert stick.faults == []


# ---- One axis --------------------------------------------------------------------------------------------------------


def test_one_axis_whose_flags_have_the_range_0_to_0() -> None:
    """OpenFFBoard with one axis exerts no force unless the axis is enabled by its flag."""
    with driven(descriptors.OPENFFBOARD_1, OPENFFBOARD_1) as (stick, plan):
        (set_effect,) = stick.sent("set_effect")
        # Id, index, type, four times of two bytes, gain, trigger button, then the flags: X, Direction Enable.
        assert set_effect[13] == 0x02
        assert len(plan.force) == 1 and plan.driven_axes == (True, False)
        for force_n in FORCES:
            before = len(stick.sent("constant_force"))
            send(stick, plan, force_n)
            assert len(stick.sent("constant_force")) == before + 1
            assert stick.force() == pytest.approx((force_n[0] / FULL_N, 0.0), abs=step_of(stick))
        assert stick.faults == []


def test_commands_that_are_bits_of_the_range_0_to_0() -> None:
    descriptor = bytes(Joystick(control="bits"))
    before = b"\x15\x00\x25\x01\x75\x01\x95\x06"  # six bits, 0 to 1
    assert descriptor.count(before) == 1
    with driven(descriptor.replace(before, before.replace(b"\x25\x01", b"\x25\x00"))) as (stick, plan):
        assert stick.enabled
        send(stick, plan, (4.0, 0.0))
        assert stick.force() == pytest.approx((0.5, 0.0), abs=step_of(stick))


# ---- Gain, envelope, time --------------------------------------------------------------------------------------------


def test_the_whole_of_the_gain_is_used() -> None:
    with driven(descriptors.SIDEWINDER_FF2, Variant(gain_at_start=0.25)) as (stick, plan):
        send(stick, plan, (FULL_N, 0.0))
        assert stick.force() == pytest.approx((1.0, 0.0), abs=step_of(stick))


@pytest.mark.parametrize("name", ["sidewinder", "fino", "adapt-ffb-joy"])
def test_a_killed_host_leaves_no_force(name: str) -> None:
    """While it is renewed, the force lasts; afterwards it ends with the duration of the effect."""
    duration_s = 0.1
    with driven(*FAMILIES[name], effect_duration_s=duration_s) as (stick, plan):
        for tick in range(1, 20):
            stick.now = tick * plan.renew_s
            for message in plan.renew:
                stick.take(message.data)
            send(stick, plan, (4.0, -2.0))
            assert stick.force() == pytest.approx((0.5, -0.25), abs=step_of(stick))
        last_s = stick.now
        times_s = [last_s + k * 1e-3 for k in range(200)]
        shown = [math.hypot(*stick.force(t_s)) > 0.0 for t_s in times_s]
        ends_s = next(t_s for t_s, on in zip(times_s, shown, strict=True) if not on)
        assert ends_s - last_s == pytest.approx(duration_s, abs=2e-3)
        assert not any(shown[round((ends_s - last_s) * 1e3) :])


# ---- What the device plays by itself ---------------------------------------------------------------------------------


def test_a_device_that_never_reports_full_keeps_its_constant_forces(caplog: pytest.LogCaptureFixture) -> None:
    """A periodic effect replaced the first effect: all are created again, without periodic effects."""
    variant = Variant(most_effects=5, never_full=True, pool_stalls=True)
    with driven(descriptors.SIDEWINDER_FF2, variant, offload="auto") as (stick, plan):
        assert plan.periodic is None and "returns Effect Block Index 1 twice" in plan.no_periodic
        assert "returns Effect Block Index 1 twice; no effects are played by the device" in caplog.text
        assert len(stick.effects) == 2
        for force_n in FORCES:
            send(stick, plan, force_n)
            wanted = (force_n[0] / FULL_N, force_n[1] / FULL_N)
            assert stick.force() == pytest.approx(wanted, abs=0.52 * step_of(stick) + 1e-4), force_n
        assert stick.faults == []


@pytest.mark.parametrize("name", ["sidewinder", "openffboard", "fino", "adapt-ffb-joy"])
def test_a_strike_is_the_mode_along_its_direction(name: str) -> None:
    """The sine within its envelope has the reported error and the direction of the force."""
    mode = Mode(decay_rate_per_s=1.0 / 0.03, angular_frequency_rad_per_s=2.0 * math.pi * 80.0)
    way = (0.6, -0.8)
    with driven(*FAMILIES[name], offload="auto") as (stick, plan):
        assert plan.periodic is not None, plan.no_periodic
        shape = nearest_effect(mode, plan.periodic.scales)
        assert shape is not None
        size_n = 0.8 * FULL_N / shape.peak
        stick.now = 1.0
        for message in effect_messages(shape, plan.periodic, 0):
            into = ffi.new("struct hd_hid_message *", message.for_c())
            room = ffi.new("uint8_t[]", len(message.data))
            lib.hd_hid_compose(into, ffi.new("double[2]", [size_n * part for part in way]), room)
            stick.take(bytes(ffi.buffer(room)))
        times_s = np.linspace(0.0, 0.2, 2001)
        shown = FULL_N * np.array([stick.force(1.0 + t_s) for t_s in times_s])
        ideal = size_n * np.exp(-mode.decay_rate_per_s * times_s) * np.sin(mode.angular_frequency_rad_per_s * times_s)
        along, across = shown @ np.array(way), shown @ np.array([-way[1], way[0]])
        power = float(np.sqrt(np.mean(ideal**2)))
        # Levels and direction are integer counts, too.
        assert float(np.sqrt(np.mean((along - ideal) ** 2))) / power < shape.error + 0.01
        assert float(np.abs(across).max()) < 0.018 * float(np.abs(along).max()) + 1e-9
        assert stick.faults == []


# ---- Calibration -----------------------------------------------------------------------------------------------------


class Table:
    """A device on a table, whose handle follows the force; its clock advances only while the caller waits."""

    def __init__(self, descriptor: bytes, variant: Variant, travel_per_force: float) -> None:
        self.stick = Firmware(descriptor, variant)
        self.travel_per_force = travel_per_force

    def pause(self, duration_s: float) -> None:
        self.stick.now += duration_s
        x, y = (self.travel_per_force * part for part in self.stick.force())
        self.stick.position(x, y)


def test_calibration_of_one_axis_leaves_the_other_alone() -> None:
    table = Table(descriptors.OPENFFBOARD_1, replace(OPENFFBOARD_1, signs=(-1, 1)), 5.0)
    with table.stick as stick:
        found = calibrate(stick.device, driver(stick), hid(), 0.4, now=lambda: stick.now, pause=table.pause)
        assert set(found.moved_m) == {"x"} and found.force_axes.x.sign == -1
        assert stick.force() == (0.0, 0.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_calibration_of_a_wheel_that_names_two_axes_reports_the_needed_keys(sign: int) -> None:
    """Nothing moves along y: the result for x is reported, and drives the wheel the right way."""
    variant = Variant(axes=("x",), signs=(sign, 1))
    table = Table(bytes(Joystick(direction_bits=16)), variant, 5.0)
    with table.stick as stick, pytest.raises(DeviceError) as caught:
        calibrate(stick.device, driver(stick), hid(), 0.4, now=lambda: stick.now, pause=table.pause)
    message = str(caught.value)
    assert message.endswith(f"a device without a motor for y needs device.hid.force_axes: {{x: {{sign: {sign}}}}}")
    keys = yaml.safe_load(message.split("device.hid.force_axes: ")[1])
    assert hid(force_axes=keys).signs == "trust"
    with driven(table.stick.descriptor, variant, force_axes=keys) as (stick, plan):
        send(stick, plan, (4.0, 2.0))
        assert stick.force() == pytest.approx((0.5, 0.0), abs=2e-4)


def _index_later() -> bytes:
    """Return a descriptor whose reports have an unused byte before the Effect Block Index."""
    descriptor = bytes(Joystick(direction_bits=16))
    for name in (0x21, 0x73, 0x77):
        head = usage(name) + b"\xa1\x02\x85"
        at = descriptor.index(head) + len(head) + 1
        descriptor = descriptor[:at] + pad(OUTPUT, 8) + descriptor[at:]
    return descriptor


@pytest.mark.parametrize("name", ["sidewinder", "index later"])
def test_a_failed_calibration_reports_the_sent_reports(name: str) -> None:
    descriptor = {"sidewinder": descriptors.SIDEWINDER_FF2, "index later": _index_later()}[name]
    table = Table(descriptor, Variant(), 0.0)
    with table.stick as stick:
        with pytest.raises(DeviceError) as caught:
            calibrate(stick.device, driver(stick), hid(), 0.4, now=lambda: stick.now, pause=table.pause)
        message = str(caught.value)
        (set_effect, _) = stick.sent("set_effect")
        strongest = min(stick.sent("constant_force"), key=lambda report: stick.read(report)[1]["magnitude"])
        assert "device's x axis" in message and "0.4 N" in message and "\n" not in message
        operation = stick.forms["operation"].write("start", index=1, loops=1)
        assert all(report.hex(" ") in message for report in (set_effect, strongest, operation))
        assert "power" not in message
