"""Set-up and plans of PID devices, with a simulated device that parses every report independently."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from typing import Any

import pytest

from hapticd.base.core import ffi, lib
from hapticd.base.errors import InvalidError
from hapticd.config.hid import Hid
from hapticd.hid.descriptor.layout import Layout, layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.drivers.pid_plan import schemes_of
from hapticd.hid.plan import DeviceError, Plan
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid, number

FORCES = ((0.0, 0.0), (4.0, 0.0), (-4.0, 0.0), (0.0, 2.0), (0.0, -2.0), (3.0, 4.0), (-1.0, 2.5), (-6.0, -6.0))
FULL_N = 8.9


def hid(**keys: Any) -> Hid:
    return Hid.model_validate(keys)


def driver(stick: FakePid, **keys: Any) -> PidDriver:
    return PidDriver(stick.layout, hid(**keys))


@contextmanager
def joystick(like: Joystick | None = None, **keys: Any) -> Iterator[FakePid]:
    stick = FakePid(bytes(like or Joystick()), **keys)
    try:
        yield stick
    finally:
        stick.close()


def send(stick: FakePid, plan: Plan, force_n: tuple[float, float]) -> None:
    """Send the reports that C makes of a force."""
    described = plan.to_c()
    for place, message in enumerate(plan.force):
        room = ffi.new("uint8_t[]", len(message.data))
        lib.hd_hid_compose(ffi.addressof(described.force.messages, place), ffi.new("double[2]", force_n), room)
        stick.take(bytes(ffi.buffer(room)))


def test_set_up_in_order() -> None:
    with joystick() as stick:
        driver(stick).set_up(stick.device)
        assert stick.log == [
            "device_reset",
            "stop_all_effects",
            "enable_actuators",
            "gain 255",
            "pool",
            "create",
            "load",
            "set_effect 1",
            "constant_force 1",
            "operation start 1",
            "create",
            "load",
            "set_effect 2",
            "constant_force 2",
            "operation start 2",
        ]
        assert stick.force() == (0.0, 0.0)


def test_effects_are_finite_and_wait_for_no_button() -> None:
    with joystick() as stick:
        plan = driver(stick).set_up(stick.device)
        to = stick.layout.set_effect
        assert to is not None and to.gain and to.trigger_button and to.sample_period and to.start_delay
        report = stick.effects[1].set_effect
        assert number(report, to.duration) == 100
        assert number(report, to.gain) == 255
        assert number(report, to.sample_period) == number(report, to.start_delay) == 0
        assert report[1 + to.trigger_button.bit_offset // 8] == 0xFF
        assert plan.renew_s == 0.04
        stick.log.clear()
        for message in plan.renew:
            stick.take(message.data)
        assert stick.log == ["operation start 1", "operation start 2"]


def test_which_effects_are_watched() -> None:
    with joystick() as stick:
        plan = driver(stick).set_up(stick.device)
        state = stick.layout.pid_state
        assert state is not None and state.effect_index and state.effect_playing and plan.effects is not None
        watched = plan.effects
        assert (watched.report_id, watched.indices) == (state.report_id, (1, 2))
        assert watched.index.bit_offset == state.effect_index.bit_offset
        assert watched.playing.bit_offset == state.effect_playing.bit_offset
        # These renewals take longer than an effect, wherever the first one lies within an interval.
        assert (watched.proof - 1) * plan.renew_s > 0.1
        # Stopped, so that the first renewal starts them while reports are read.
        stick.log.clear()
        for message in plan.begin:
            stick.take(message.data)
        assert stick.log == ["operation stop 1", "operation stop 2"]
        described = plan.to_c().effects
        assert described.count == 2 and list(described.indices)[:2] == [1, 2] and described.proof == watched.proof


def test_a_state_that_cannot_name_an_effect_is_not_watched() -> None:
    # With 200 effects, the 7 bits of the index in PID State are too few for the last ones.
    for like, first_index in ((Joystick(without=frozenset({0x92})), 1), (Joystick(indices=200), 198)):
        with joystick(like, first_index=first_index) as stick:
            plan = driver(stick).set_up(stick.device)
            assert plan.effects is None and plan.begin == ()


def test_infinite_duration_is_all_ones_and_a_quirk() -> None:
    with joystick() as stick:
        driver(stick, quirks=["infinite_duration"]).set_up(stick.device)
        to = stick.layout.set_effect
        assert to is not None
        at = 1 + to.duration.bit_offset // 8
        assert stick.effects[1].set_effect[at : at + 2] == b"\xff\xff"


def test_the_end_stops_frees_and_disables() -> None:
    with joystick() as stick:
        plan = driver(stick).set_up(stick.device)
        stick.log.clear()
        for message in plan.stop:
            stick.take(message.data)
        assert stick.log == [
            "operation stop 1",
            "operation stop 2",
            "block_free 1",
            "block_free 2",
            "stop_all_effects",
            "disable_actuators",
        ]
        assert not stick.effects and not stick.enabled


DEVICES = {
    "plain": Joystick(),
    "bits": Joystick(control="bits"),
    "fine directions": Joystick(direction_bits=16),
    "coarse magnitude": Joystick(magnitude=255),
    "byte magnitude": Joystick(magnitude=127, magnitude_bits=8),
    "4096": Joystick(magnitude=4096),
    "32767": Joystick(magnitude=32767),
    "unsigned": Joystick(magnitude=10000, is_magnitude_signed=False, direction_bits=16),
    "unsigned, coarse": Joystick(magnitude=255, magnitude_bits=8, is_magnitude_signed=False),
    "zero in the middle": Joystick(direction_bits=16, is_direction_signed=True),
    "zero in the middle, unsigned": Joystick(direction_bits=16, is_direction_signed=True, is_magnitude_signed=False),
    "axes enabled one by one": Joystick(direction_bits=0, without=frozenset({0x56})),
    "axes in the other order": Joystick(axes=(0x31, 0x30), force_axes=(0x31, 0x30), direction_bits=0),
    "ids from 23 on": Joystick(first_id=23),
    "extended usages": Joystick(is_extended=True),
    "pushed": Joystick(is_pushed=True),
    "apart": Joystick(is_split=True),
    "bare": Joystick(without=frozenset({0x90, 0x7D, 0x7F, 0x92, 0xA7, 0x51, 0x53, 0x54, 0x5A, 0x6E})),
}


def error_of(stick: FakePid, plan: Plan) -> float:
    """Return the allowed error of a force: half a count of magnitude on each axis, half a step of direction."""
    force, effect = stick.layout.constant_force, stick.layout.set_effect
    assert force is not None and effect is not None
    turn = effect.direction[0].counts_per_turn() if effect.direction else math.inf
    return math.sqrt(0.5) / force.magnitude.logical_max + 2 * math.pi * 0.5 / turn


@pytest.mark.parametrize("name", DEVICES)
def test_magnitude_sign_and_axis(name: str) -> None:
    with joystick(DEVICES[name]) as stick:
        plan = driver(stick).set_up(stick.device)
        for force_n in FORCES:
            send(stick, plan, force_n)
            wanted = [part / FULL_N for part in force_n]
            size = math.hypot(*wanted)
            # Each effect has its direction's error, so the errors add up.
            assert stick.force() == pytest.approx(wanted, abs=error_of(stick, plan) * (1 + math.sqrt(2) * size)), (
                force_n
            )


def test_limits_of_the_magnitude_hold() -> None:
    for like in (DEVICES["coarse magnitude"], DEVICES["unsigned"]):
        with joystick(like) as stick:
            plan = driver(stick).set_up(stick.device)
            for force_n in ((1e9, 0.0), (-1e9, 0.0), (math.inf, 0.0), (math.nan, 0.0)):
                send(stick, plan, force_n)
                assert math.hypot(*stick.force()) <= 1.0 + 2e-3


@pytest.mark.parametrize("way", ["two", "polar"])
@pytest.mark.parametrize(("x", "y", "swap"), list(product((1, -1), (1, -1), (False, True))))
def test_force_axes(way: str, x: int, y: int, swap: bool) -> None:
    """The device's axes are swapped first, then signs change."""
    like = Joystick(direction_bits=16, is_magnitude_signed=way == "two")
    axes = {"x": {"sign": x}, "y": {"sign": y}, "swap": swap}
    with joystick(like) as stick:
        plan = driver(stick, force_axes=axes).set_up(stick.device)
        assert len(plan.renew) == (2 if way == "two" else 1)
        for force_n in FORCES:
            send(stick, plan, force_n)
            first, second = force_n[::-1] if swap else force_n
            assert stick.force() == pytest.approx((x * first / FULL_N, y * second / FULL_N), abs=4e-4), force_n


def test_a_single_axis() -> None:
    for like in (
        Joystick(axes=(0x30,), force_axes=(0x30,)),
        Joystick(axes=(0x30,), force_axes=(), is_magnitude_signed=False, direction_bits=16),
    ):
        with joystick(like) as stick:
            plan = driver(stick).set_up(stick.device)
            for force_n in FORCES:
                send(stick, plan, force_n)
                x, _ = stick.force()
                assert x == pytest.approx(force_n[0] / FULL_N, abs=1e-3)


def test_a_device_with_room_for_one_effect_gets_one() -> None:
    with joystick(Joystick(direction_bits=16), room=1) as stick:
        plan = driver(stick).set_up(stick.device)
        assert list(stick.effects) == [1] and len(plan.force) == 2
        send(stick, plan, (-3.0, 4.0))
        assert stick.force() == pytest.approx((-3 / FULL_N, 4 / FULL_N), abs=4e-4)
    with joystick(Joystick(direction_bits=16, without=frozenset({0x7F})), room=1) as stick:
        driver(stick).set_up(stick.device)
        assert list(stick.effects) == [1]
    with joystick(Joystick(direction_bits=16)) as stick:
        assert len(driver(stick, quirks=["one_effect"]).set_up(stick.device).renew) == 1


def test_quirks_leave_reports_out() -> None:
    with joystick() as stick:
        driver(stick, quirks=["no_device_gain", "no_pid_pool", "no_reset"]).set_up(stick.device)
        assert stick.log[:4] == ["stop_all_effects", "enable_actuators", "create", "load"]


@pytest.mark.parametrize(
    ("says", "reason"),
    [
        ("full", "fake0: PID Block Load: full, no room for another effect"),
        ("error", "fake0: PID Block Load: error, the effect is refused"),
    ],
)
def test_block_load_refuses(says: str, reason: str) -> None:
    with joystick(load_says=says) as stick, pytest.raises(DeviceError) as caught:
        driver(stick).set_up(stick.device)
    assert str(caught.value) == reason


def test_block_load_returns_an_index_out_of_range() -> None:
    with joystick(Joystick(indices=5), first_index=6) as stick, pytest.raises(DeviceError) as caught:
        driver(stick).set_up(stick.device)
    assert str(caught.value) == "fake0: PID Block Load: Effect Block Index must be between 1 and 5, is 6"


@pytest.mark.parametrize(
    ("answers_as", "without", "reason"),
    [
        (1, {0x7F}, "fake0: requested PID Block Load, report 2, the device returned report 1"),
        (9, set(), "fake0: requested PID Block Load, report 2, the device returned report 9"),
    ],
)
def test_another_report_is_no_answer(answers_as: int, without: set[int], reason: str) -> None:
    with joystick(Joystick(without=frozenset(without)), answers_as=answers_as) as stick:
        with pytest.raises(DeviceError) as caught:
            driver(stick).set_up(stick.device)
        assert str(caught.value) == reason


def test_effects_numbered_by_the_device() -> None:
    with joystick(first_index=7) as stick:
        plan = driver(stick).set_up(stick.device)
        assert list(stick.effects) == [7, 8]
        send(stick, plan, (0.0, 8.9))
        assert stick.effects[8].magnitude == 10000


def test_positions_in_a_measured_range() -> None:
    """The recording of a stick that reports -327..396 of -512..511 and rests at 20; HID's Y grows towards the user."""
    axes = {"y": {"counts": [-327, 20, 396]}}
    with joystick(Joystick(axis_range=(-512, 511), axis_bits=10)) as stick:
        plan = driver(stick, travel_m=0.06, axes=axes).set_up(stick.device)
    ends_m = [plan.y.position_m(counts) for counts in (-327, 20, 396)]
    assert ends_m == pytest.approx([0.06, 0.0, -0.06], abs=1e-15) and plan.y.position_m(20) == 0.0
    # Each half has its own slope, also beyond the ends.
    assert plan.y.position_m(-327 - 347) == pytest.approx(0.12) and plan.y.position_m(208) == pytest.approx(-0.03)
    assert [plan.y.counts(at_m) for at_m in (0.06, 0.03, 0.0, -0.06)] == pytest.approx([-327, -153.5, 20, 396])
    assert plan.resolution_m == pytest.approx(0.06 / 347), "the coarser half"
    assert plan.x.m_per_count == (0.06 / 511.5,) * 2


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        ([-600, 20, 396], "device.hid.axes.y.counts: must lie within -512 to 511, the range of the device's axis Y"),
        ([-327, 20, 512], r"are \[-327, 20, 512\]"),
        ([-1, 0, 1], "with at least 16 on each side of the middle"),
        ([-512, -511, 511], "with at least 16 on each side of the middle"),
        ([0, 2048, 4095], "must lie within -512 to 511"),
    ],
)
def test_counts_that_the_device_cannot_report(counts: list[int], message: str) -> None:
    like = Joystick(axis_range=(-512, 511), axis_bits=10)
    with joystick(like) as stick, pytest.raises(DeviceError, match=message) as caught:
        driver(stick, axes={"y": {"counts": counts}})
    assert "\n" not in str(caught.value)


def test_counts_of_an_axis_that_the_device_lacks() -> None:
    axes = {"y": {"counts": [0, 100, 200]}}
    with joystick(Joystick(axes=(0x30,), force_axes=(0x30,))) as stick:
        assert driver(stick).set_up(stick.device).y.is_still
        with pytest.raises(DeviceError, match=r"device\.hid\.axes\.y\.usage: the device has no axis Y; it has X"):
            driver(stick, axes=axes)


@pytest.mark.parametrize("counts", [[396, 20, -327], [-327, -327, 396], [-327, 396, 396], [-327, 400, 396]])
def test_counts_that_do_not_increase(counts: list[int]) -> None:
    with pytest.raises(InvalidError, match=r"axes.y: counts must increase: low, middle, high, are \["):
        Hid(axes={"y": {"counts": counts}})


def test_counts_keep_the_other_keys_of_an_axis() -> None:
    assert Hid(axes={"y": {"counts": [1, 2, 3]}}).axes.y.sign == -1
    y = Hid(axes={"y": {"usage": "Rz", "counts": [1, 2, 3]}}).axes.y
    assert (y.usage, y.sign) == ("Rz", 1)


def test_positions() -> None:
    with joystick(Joystick(axis_range=(0, 1023), axis_bits=10)) as stick:
        plan = driver(stick, travel_m=0.06).set_up(stick.device)
        for axis, sign in ((plan.x, 1), (plan.y, -1)):
            metres = [axis.position_m(counts) for counts in (0, 511.5, 1023)]
            assert metres == pytest.approx([-sign * 0.06, 0.0, sign * 0.06], abs=1e-12)
        assert plan.x.bits.get(b"\x01\xff\x03\x00") == 1023
        assert plan.resolution_m == pytest.approx(0.12 / 1023)
        assert len(plan.states) == 4


def test_axes_are_chosen_by_usage() -> None:
    layout = layout_of(parse(bytes(Joystick(axes=(0x31, 0x30, 0x35)))))
    stick = PidDriver(layout, hid(axes={"x": {"usage": "Rz"}, "y": {"usage": "X", "sign": -1}}))
    del stick
    with pytest.raises(DeviceError) as caught:
        PidDriver(layout, hid(axes={"x": {"usage": "Z"}, "y": {"usage": "Y"}}))
    assert str(caught.value) == "device.hid.axes.x.usage: the device has no axis Z; it has X, Y, Rz"


def test_axes_that_a_force_cannot_distinguish() -> None:
    layout = layout_of(parse(bytes(Joystick(force_axes=(), direction_bits=0))))
    assert layout.usable
    with pytest.raises(DeviceError) as caught:
        schemes_of(layout, hid())
    assert "neither Direction nor Axes Enable" in str(caught.value)


def test_durations_of_other_units() -> None:
    with joystick() as stick:
        plan = driver(stick, effect_duration_s=0.02, renew_s=0.016).set_up(stick.device)
        assert plan.renew_s == pytest.approx(0.01)
        to = stick.layout.set_effect
        assert to is not None and number(stick.effects[1].set_effect, to.duration) == 20


def without_reset(**keys: Any) -> Any:
    """A joystick whose pool is not read, and which is not reset."""
    return joystick(Joystick(without=frozenset({0x7F})), **keys)


def test_room_for_one_effect_without_a_reset() -> None:
    with without_reset(room=1) as stick:
        plan = driver(stick, quirks=["no_reset"]).set_up(stick.device)
        assert list(stick.effects) == [1] and len(plan.renew) == 1 and stick.enabled
        send(stick, plan, (3.0, 0.0))
        assert stick.force()[0] == pytest.approx(3.0 / FULL_N, abs=error_of(stick, plan))


def test_a_set_up_that_fails_half_way_leaves_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    with without_reset() as stick:
        answer = stick.get_feature

        def refuse_the_second(report_id: int, length: int) -> bytes:
            stick.load_says = "error" if stick.log.count("create") == 2 else None
            return answer(report_id, length)

        monkeypatch.setattr(stick, "get_feature", refuse_the_second)
        with pytest.raises(DeviceError, match="the effect is refused"):
            driver(stick, quirks=["no_reset"]).set_up(stick.device)
        assert 1 not in stick.effects and not stick.enabled
        assert stick.log.index("operation stop 1") < stick.log.index("block_free 1")


def test_set_up_again_without_a_reset_needs_no_more_room() -> None:
    with without_reset(room=2) as stick:
        again = driver(stick, quirks=["no_reset"])
        first = again.set_up(stick.device)
        for _ in range(3):
            assert again.set_up(stick.device) == first
        assert list(stick.effects) == [1, 2] and stick.enabled


def layout_like(like: Joystick | None = None) -> Layout:
    return layout_of(parse(bytes(like or Joystick())))


def test_a_magnitude_whose_count_of_zero_force_is_not_clear_is_refused() -> None:
    layout = layout_like(Joystick(is_magnitude_signed=False))
    force = layout.constant_force
    assert force is not None and schemes_of(layout, hid())
    below = replace(force, magnitude=replace(force.magnitude, physical_min=-10000, physical_max=10000))
    with pytest.raises(DeviceError, match="count for a force of zero is not clear"):
        PidDriver(replace(layout, constant_force=below), hid())


def test_directions_that_are_parts_of_a_vector_are_not_taken_for_angles() -> None:
    layout = layout_like()
    to = layout.set_effect
    assert to is not None
    vector = replace(layout, set_effect=replace(to, is_direction_cartesian=True))
    assert schemes_of(vector, hid()) == ("two",)
    signless = replace(vector, constant_force=layout_like(Joystick(is_magnitude_signed=False)).constant_force)
    with pytest.raises(DeviceError, match="magnitudes without a sign, and no angle"):
        schemes_of(signless, hid())


@pytest.mark.parametrize("directions", [1, 2, 3])
def test_without_direction_enable_the_direction_is_sent_with_the_axis(directions: int) -> None:
    """Common firmware multiplies a force by the sine or cosine of the direction, that of the axis or the first one."""
    with joystick(Joystick(without=frozenset({0x56}), directions=directions)) as stick:
        driver(stick).set_up(stick.device)
        to = stick.layout.set_effect
        assert to is not None and to.direction_enable is None and len(to.direction) == directions
        along_x, along_y = (effect.set_effect for effect in stick.effects.values())
        for report, enabled, turns in ((along_x, "x", 0.75), (along_y, "y", 0.5)):
            assert [name for name, field in to.axes_enable.items() if number(report, field)] == [enabled]
            assert [number(report, field) / 255 for field in to.direction] == pytest.approx(
                [turns] * directions, abs=2e-3
            )


@pytest.mark.parametrize("usage", [0x30, 0x31])
def test_the_one_axis_that_pushes_is_enabled_whichever_it_is(usage: int) -> None:
    with joystick(Joystick(force_axes=(usage,), directions=0, direction_bits=0)) as stick:
        driver(stick).set_up(stick.device)
        to = stick.layout.set_effect
        assert to is not None
        (enabled,) = to.axes_enable.values()
        assert [number(effect.set_effect, enabled) for effect in stick.effects.values()] == [1]
