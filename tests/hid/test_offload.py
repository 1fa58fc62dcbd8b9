"""Modes that the device plays: the nearest effect, the reports that carry it, and an engine with such a device."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from hapticd.base.core import Fault, ffi, lib
from hapticd.config.hid import Hid
from hapticd.config.materials import Material, shipped_materials
from hapticd.config.modes import Mode
from hapticd.daemon.methods import Methods
from hapticd.hid.descriptor.layout import layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.drivers.pid_plan import periodic_of
from hapticd.hid.nearest_effect import MAX_EFFECT_S, NearestEffect, nearest_effect, streamed_error
from hapticd.hid.offload import Offload, effect_messages
from hapticd.hid.plan import DeviceError, Message, Periodic, PeriodicScales, Plan
from hapticd.protocol.changes import Played
from tests.hid.test_connection import FULL_N, World, pressed
from tests.hid.test_connection import world as world
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid, Strike
from tests.support.marks import rest_slow

Floats = npt.NDArray[np.float64]
MASS_KG = 0.05
SOFT = ("wood", "acrylic", "delrin", "cellophane")
METALS = ("aluminum", "cast_iron", "steel")
FINE = Joystick(time_exponent=-4, level=10000)


def mode_of(name: str) -> Mode:
    material = shipped_materials()[name]
    part = material.tap or material.rupture
    assert part is not None
    return part.mode


def periodic(like: Joystick, count: int = 8, **keys: Any) -> Periodic:
    layout = layout_of(parse(bytes(like)))
    return periodic_of(layout, Hid.model_validate({"offload": "auto", **keys}), range(3, 3 + count))


def scales(like: Joystick) -> PeriodicScales:
    return periodic(like).scales


def wanted(mode: Mode, time_s: Floats) -> Floats:
    found: Floats = np.exp(-mode.decay_rate_per_s * time_s) * np.sin(mode.angular_frequency_rad_per_s * time_s)
    return found


def power(mode: Mode) -> float:
    """Return the integral of the mode's square over all time, in closed form."""
    b, w = mode.decay_rate_per_s, mode.angular_frequency_rad_per_s
    return w * w / (4.0 * b * (b * b + w * w))


def distance(mode: Mode, shown: Floats, time_s: Floats) -> float:
    """Return the RMS of the difference divided by that of the mode, by the trapezoidal rule."""
    return math.sqrt(float(np.trapezoid((shown - wanted(mode, time_s)) ** 2, time_s)) / power(mode))


def played(found: NearestEffect, unit_s: float, time_s: Floats) -> Floats:
    """Return the curve of an effect, computed from its counts."""
    knots = np.array([0, found.attack, found.duration - found.fade, found.duration]) * unit_s
    levels = [found.attack_level, found.magnitude, found.magnitude, found.fade_level]
    if found.attack == 0:
        knots, levels = knots[1:], levels[1:]
    shown: Floats = np.interp(time_s, knots, levels, right=0.0) * np.sin(2 * np.pi * time_s / (found.period * unit_s))
    return shown


# ---- The fit ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", rest_slow(reversed(SOFT)))
def test_no_effect_of_whole_milliseconds_is_nearer(name: str) -> None:
    """Compare with every possible effect, by scipy's non-negative least squares."""
    mode = mode_of(name)
    time_s = (np.arange(4000) + 0.5) * 6 * mode.decay_time_s / 4000
    target = wanted(mode, time_s)
    best = math.inf
    nearest = round(1e3 / mode.frequency_hz)
    for period in range(nearest - 2, nearest + 3):
        sine = np.sin(2e3 * np.pi * time_s / period)
        for end in range(1, min(100, math.ceil(6e3 * mode.decay_time_s)) + 1):
            for attack in range(end):
                knots = [0.0, attack * 1e-3, end * 1e-3] if attack else [0.0, end * 1e-3]
                lines = np.array([np.interp(time_s, knots, row, right=0.0) for row in np.eye(len(knots))])
                lines[:, time_s > end * 1e-3] = 0.0
                _, left = nnls((lines * sine).T, target)
                best = min(best, left / math.sqrt(target @ target))
    found = nearest_effect(mode, scales(replace(Joystick(), level=10000)))
    assert found is not None
    assert found.error == pytest.approx(best, abs=0.002)


@pytest.mark.parametrize("name", (*SOFT, *METALS, "glass"))
@pytest.mark.parametrize("exponent", [-3, -4, -5])
def test_the_error_is_that_of_the_effect(name: str, exponent: int) -> None:
    mode = mode_of(name)
    found = nearest_effect(mode, scales(Joystick(time_exponent=exponent, level=10000)))
    assert found is not None
    time_s = np.linspace(0.0, max(12 * mode.decay_time_s, found.duration_s), 200_001)
    assert distance(mode, played(found, 10.0**exponent, time_s), time_s) == pytest.approx(found.error, abs=0.005)
    assert found.attack + found.fade <= found.duration
    assert min(found.attack_level, found.magnitude, found.fade_level) >= 0.0
    assert found.duration_s == pytest.approx(found.duration * 10.0**exponent) and found.duration_s <= MAX_EFFECT_S


@pytest.mark.parametrize("name", METALS)
def test_metals_need_tenths_of_a_millisecond(name: str) -> None:
    fine, coarse = (nearest_effect(mode_of(name), scales(Joystick(time_exponent=exponent))) for exponent in (-4, -3))
    assert fine is not None and coarse is not None
    assert 0.05 < fine.error < 0.115
    assert coarse.error > 0.5


def test_levels_are_those_that_the_device_has() -> None:
    """If a level has two counts, the reported error is that of two counts."""
    mode = mode_of("wood")
    found = nearest_effect(mode, scales(Joystick(level=2)))
    assert found is not None
    ratios = {round(2 * level / found.peak, 9) for level in (found.attack_level, found.magnitude, found.fade_level)}
    assert ratios <= {0.0, 1.0, 2.0}
    time_s = np.linspace(0.0, 12 * mode.decay_time_s, 100_001)
    assert distance(mode, played(found, 1e-3, time_s), time_s) == pytest.approx(found.error, abs=0.005)


def test_no_effect_is_longer_than_a_tenth_of_a_second() -> None:
    slow = nearest_effect(Mode(decay_rate_per_s=1.0, angular_frequency_rad_per_s=300.0), scales(Joystick()))
    assert slow is not None and slow.duration_s <= MAX_EFFECT_S
    # After 0.1 s a fraction exp(-2 * 0.1) of the mode's power remains.
    assert slow.error >= math.exp(-0.1) - 0.01


@pytest.mark.slow
def test_extreme_modes_and_devices() -> None:
    for decay in (0.1, 1.0, 1e3, 1e6):
        for angular in (0.05, 1e3, 1e6):
            for like in (Joystick(), Joystick(time_exponent=-6), Joystick(time_exponent=0, level=1)):
                found = nearest_effect(Mode(decay, angular), scales(like))
                assert found is None or (0.0 <= found.error <= 1.0 + 1e-9 and found.duration_s <= MAX_EFFECT_S)


@pytest.mark.long
@pytest.mark.parametrize("cycles_per_frame", [0.01, 0.067, 0.2, 0.39])
def test_error_of_a_held_sine(cycles_per_frame: float) -> None:
    """Compare with a sine that is sampled and held, at the delay that fits best."""
    fine, frames = 200, 4000
    at = np.arange(fine * frames) / fine
    held = np.sin(2 * np.pi * cycles_per_frame * np.floor(at))
    errors = [
        np.sqrt(np.mean((held - np.sin(2 * np.pi * cycles_per_frame * (at - delay))) ** 2) * 2)
        for delay in np.linspace(0.4, 0.6, 21)
    ]
    mode = Mode(decay_rate_per_s=1.0, angular_frequency_rad_per_s=2 * np.pi * cycles_per_frame * 1000.0)
    assert streamed_error(mode, 1000.0) == pytest.approx(min(errors), rel=0.01)
    assert streamed_error(mode, 1000.0 * cycles_per_frame / 0.41) == 1.0


# ---- Reports ---------------------------------------------------------------------------------------------------------


def compose(messages: Iterable[Message], force_n: tuple[float, float]) -> Iterator[bytes]:
    """Return the reports that C makes of these messages."""
    room = ffi.new("uint8_t[]", 256)
    for message in messages:
        into = ffi.new("struct hd_hid_message *", message.for_c())
        lib.hd_hid_compose(into, ffi.new("double[2]", force_n), room)
        yield bytes(ffi.buffer(room, len(message.data)))


DEVICES = {
    "plain": Joystick(),
    "fine": FINE,
    "degrees": Joystick(direction_bits=16),
    "bits": Joystick(control="bits", is_extended=True),
    "unsigned": Joystick(is_magnitude_signed=False),
    "high ids": Joystick(first_id=20, level=4096, is_pushed=True),
    "no axes": Joystick(force_axes=()),
}


@pytest.mark.long
@pytest.mark.parametrize("name", DEVICES)
@settings(max_examples=25)
@given(angle=st.floats(0, 2 * math.pi), part=st.floats(0.02, 3.0))
def test_the_device_plays_the_mode(name: str, angle: float, part: float) -> None:
    like, mode = DEVICES[name], mode_of("wood")
    stick = FakePid.__new__(FakePid)
    stick.layout = layout_of(parse(bytes(like)))
    found = nearest_effect(mode, scales(like))
    assert found is not None
    force = part * FULL_N
    size = min(force, FULL_N / found.peak * 0.999)
    reports = list(compose(effect_messages(found, periodic(like), 0), (size * math.sin(angle), size * math.cos(angle))))
    strike = Strike(3, *reports[:3])
    time_s = np.linspace(0.0, 12 * mode.decay_time_s, 5001)
    shown = FULL_N * stick.shown(strike, time_s)
    along = shown @ [math.sin(angle), math.cos(angle)]
    across = shown @ [math.cos(angle), -math.sin(angle)]
    # Half a count of each level, in addition to the error of the fit.
    rounding = 0.5 * FULL_N / like.level / (size * math.sqrt(power(mode) / found.duration_s)) + 0.03
    assert distance(mode, along / size, time_s) <= found.error + rounding
    assert np.abs(across).max() <= 0.03 * size
    assert np.abs(along).max() <= FULL_N * 1.0001


@contextmanager
def set_up(like: Joystick, room: int = 16, **keys: Any) -> Iterator[tuple[FakePid, Plan]]:
    stick = FakePid(bytes(like), room=room)
    try:
        yield stick, PidDriver(stick.layout, Hid.model_validate({"offload": "auto", **keys})).set_up(stick.device)
    finally:
        stick.close()


def test_set_up_makes_as_many_effects_as_there_is_room_for() -> None:
    for room, made in ((16, 8), (10, 8), (5, 3), (3, 1)):
        with set_up(Joystick(), room) as (stick, plan):
            assert plan.periodic is not None and len(plan.periodic.blocks) == made
            assert [effect.kind for effect in stick.effects.values()] == ["constant_force"] * 2 + ["sine"] * made
            stick.log.clear()
            for message in plan.stop:
                stick.take(message.data)
            assert not stick.effects and not stick.enabled
            # Forces are stopped first; periodic effects, which only take room, are freed last.
            assert stick.log[:2] == ["operation stop 1", "operation stop 2"]
            assert stick.log.index("disable_actuators") < stick.log.index("block_free 3")


@pytest.mark.parametrize(
    ("like", "room", "keys", "why"),
    [
        (Joystick(), 16, {"offload": "off"}, "device.hid.offload is off"),
        (Joystick(), 2, {}, "the device has no room for another effect"),
        (Joystick(without=frozenset({0x6E})), 16, {}, "the device has no Set Periodic"),
        (Joystick(without=frozenset({0x6E, 0x5A})), 16, {}, "the device has no Set Periodic, no Set Envelope"),
        (Joystick(direction_bits=0, without=frozenset({0x56})), 16, {}, "the device has no Direction of two axes"),
        (Joystick(axes=(0x30,), force_axes=(0x30,)), 16, {}, "the device has no Direction of two axes"),
        (Joystick(), 16, {"quirks": ["infinite_duration"]}, "the device ignores finite durations"),
    ],
)
def test_devices_without_effects_say_why(like: Joystick, room: int, keys: dict[str, Any], why: str) -> None:
    with set_up(like, room, **keys) as (stick, plan):
        assert plan.periodic is None and plan.no_periodic == why
        assert "sine" not in {effect.kind for effect in stick.effects.values()}
        assert stick.force() == (0.0, 0.0)


def test_a_device_that_refuses_the_effect_is_driven_without() -> None:
    stick = FakePid(bytes(Joystick()))

    def heard(text: str) -> None:
        if text.startswith("create"):
            stick.load_says = "error" if text == "create sine" else None

    stick.on_log = heard
    try:
        plan = PidDriver(stick.layout, Hid(offload="auto")).set_up(stick.device)
        assert plan.periodic is None and plan.no_periodic == "the device refuses to create a periodic effect"
        assert stick.enabled and [effect.playing for effect in stick.effects.values()][:2] == [True, True]
    finally:
        stick.close()


def test_a_device_that_leaves_in_the_middle_of_it_is_an_error() -> None:
    stick = FakePid(bytes(Joystick()))
    stick.on_log = lambda text: setattr(stick, "gone", text == "create sine")
    with pytest.raises(DeviceError, match="gone"):
        PidDriver(stick.layout, Hid(offload="auto")).set_up(stick.device)
    stick.gone = False
    stick.close()


# ---- Which mode has which effect -------------------------------------------------------------------------------------


def offload(count: int = 2, carried_hz: float = 250.0) -> Offload:
    made = Offload(ffi.gc(lib.hd_hid_new(), lib.hd_hid_free))
    made.set_carried(carried_hz)
    made.attach(periodic(FINE, count), "")
    return made


def test_a_mode_keeps_its_effect_while_it_is_used() -> None:
    held = offload()
    wood, steel, delrin = (mode_of(name) for name in ("wood", "steel", "delrin"))
    first, second = held.take(wood), held.take(steel)
    assert first is not None and second is not None and first.id != second.id
    assert held.take(delrin) is None
    held.give(steel)
    # The mode was streamed, and stays so while it is used, because its record was compiled for that.
    assert held.take(delrin) is None
    held.give(delrin)
    held.give(delrin)
    third = held.take(delrin)
    assert third is not None and third.id not in (first.id, second.id)
    assert held.take(wood) == first
    held.give(wood)
    assert held.take(steel) is None


def test_an_unused_mode_keeps_its_effect_until_another_mode_needs_it() -> None:
    held = offload()
    wood, steel = mode_of("wood"), mode_of("steel")
    first = held.take(wood)
    held.give(wood)
    assert held.take(wood) == first
    held.give(wood)
    held.take(steel)
    held.take(mode_of("delrin"))
    again = held.take(wood)
    assert again is None


def test_a_device_with_other_effects_plays_no_mode() -> None:
    held = offload()
    wood = mode_of("wood")
    assert held.take(wood) is not None and held.shown_hz(wood) is not None
    material = {"wood": shipped_materials()["wood"]}
    held.detach()
    assert held.shown_hz(wood) is None and held.outcomes(material)[0].refused == "the device is not connected"
    held.attach(periodic(Joystick(), 2), "")
    assert held.outcomes(material)[0].refused == "the device that is connected now has other effects"
    held.detach()
    held.attach(periodic(FINE, 2), "")
    assert held.shown_hz(wood) is not None and held.outcomes(material)[0].refused is None


def test_outcomes_and_their_reasons() -> None:
    materials: dict[str, Material] = {name: shipped_materials()[name] for name in ("wood", "steel", "cellophane")}
    coarse = Offload(ffi.gc(lib.hd_hid_new(), lib.hd_hid_free))
    coarse.set_carried(10_000.0)
    coarse.attach(periodic(Joystick()), "")
    for name in materials:
        coarse.take(mode_of(name))
    wood, steel, cellophane = coarse.outcomes(materials)
    assert (wood.material, wood.mode, wood.frequency_hz) == ("wood", "tap", pytest.approx(67.0))
    assert wood.refused == "streaming is more accurate, 1.2 % off"
    assert steel.refused is not None and steel.refused.startswith("the nearest effect is 8")
    assert steel.shown_hz == 1000.0 and steel.streamed_error_percent < 100.0
    assert cellophane.mode == "rupture"
    assert wood.period_resolution_s == wood.envelope_resolution_s == pytest.approx(1e-3)
    coarse.set_carried(250.0)
    assert [outcome.refused for outcome in coarse.outcomes(materials)][1:] == [
        steel.refused,
        "all 8 effects of the device are assigned to other modes",
    ]
    assert coarse.outcomes(materials)[1].streamed_error_percent == 100.0


# ---- A complete engine -----------------------------------------------------------------------------------------------

SCENE = {
    "objects": {
        "floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "ringing"},
        "ceiling": {"kind": "wall", "point_m": [0, 0.04], "normal": [0, -1], "material": "glass"},
    }
}
RINGING = {
    "stiffness_n_per_m": 800.0,
    "tap": {"attack_slope_per_s": 300.0, "frequency_hz": 1500.0, "decay_time_s": 0.0005},
}
MODE = Mode(decay_rate_per_s=2000.0, angular_frequency_rad_per_s=2 * math.pi * 1500.0)


@pytest.fixture
def ringing(world: World) -> World:
    world.like = FINE
    world.hid = {**world.hid, "offload": "auto"}
    world.config = {
        "device": {"kind": "hid", "effective_mass_kg": MASS_KG},
        "materials": {"ringing": RINGING},
        "scene": SCENE,
    }
    return world


def near(stick: FakePid, strike: Strike, coefficient_n: float, direction: tuple[float, float]) -> bool:
    """Return whether a strike is the mode with this coefficient, within the reported error."""
    found = nearest_effect(MODE, scales(FINE))
    assert found is not None
    time_s = np.linspace(0.0, 12 * MODE.decay_time_s, 20_001)
    along = FULL_N * stick.shown(strike, time_s) @ np.array(direction)
    return distance(MODE, along / coefficient_n, time_s) < found.error + 0.02


def struck(world: World, methods: Methods, stick: FakePid, **play: object) -> Strike:
    """Play until the device has struck, and return the strike. A late strike is lost and counted: repeat."""
    engine, before = methods._engine, len(stick.strikes)

    def over(lost: int) -> bool:
        return len(stick.strikes) > before or connection_status(engine)["strikes_lost"] > lost

    def has_struck() -> bool:
        lost = connection_status(engine)["strikes_lost"]
        answer = methods.call("play", {"material": "ringing", **play})
        assert answer["displayed_hz"] == pytest.approx(fit_hz())
        world.until(lambda: over(lost))
        return len(stick.strikes) > before

    world.until(has_struck)
    with stick.changed:  # until it is done with the report
        (strike,) = stick.strikes[before:]
    return strike


def test_play_is_left_to_the_device(ringing: World) -> None:
    stick = ringing.plug()
    engine = ringing.start()
    engine.set_forces(True)
    methods = Methods(engine)
    ringing.full(engine)
    strike = struck(ringing, methods, stick, direction=[0, -1], amplitude_m_per_s2=40.0)
    assert near(stick, strike, 40.0 * MASS_KG, (0.0, -1.0))
    # With the same strength and direction, only the start is sent.
    stick.log.clear()
    index = struck(ringing, methods, stick, direction=[0, -1], amplitude_m_per_s2=40.0).index
    sent = [line for line in stick.log if line.endswith(f" {index}")]
    assert index == strike.index and sent == [f"operation start {index}"]
    strike = struck(ringing, methods, stick, direction=[1, 0], amplitude_m_per_s2=20.0)
    assert near(stick, strike, 20.0 * MASS_KG, (1.0, 0.0))
    plays = sum(isinstance(change, Played) for change in engine.read_changes())
    assert connection_status(engine)["strikes"] == len(stick.strikes) == 3
    assert connection_status(engine)["strikes_lost"] == plays - 3


def fit_hz() -> float:
    found = nearest_effect(MODE, scales(FINE))
    assert found is not None
    return found.frequency_hz


def connection_status(engine: Any) -> dict[str, Any]:
    status = engine.connection.status()
    assert isinstance(status, dict)
    return status


def test_a_tap_is_played_with_the_strength_of_its_event(ringing: World) -> None:
    stick = ringing.plug()
    engine = ringing.start()
    ringing.hold(-0.002)
    engine.set_forces(True)
    ringing.full(engine)
    ringing.contacts(engine)
    strikes_n: list[float] = []

    def tapped() -> bool:
        """Tap until the device strikes. A tap during a stall does not count, and a late strike is lost."""
        lost, before = connection_status(engine)["strikes_lost"], len(strikes_n)
        for depth_m in (-0.001, 0.0005, 0.0015):
            ringing.hold(depth_m)
        ringing.arrived(engine, 0.0015)
        ringing.later(engine)
        # A contact that begins again after a stall causes no strike.
        strengths = [float(event["amplitude_m_per_s2"] * event["scale"]) for event in ringing.contacts(engine)]
        strikes_n.extend(strength for strength in strengths if strength > 0.0)
        if len(strikes_n) > before:
            ringing.until(lambda: bool(stick.strikes) or connection_status(engine)["strikes_lost"] > lost)
        if not stick.strikes:
            ringing.hold(-0.002)
            ringing.arrived(engine, -0.002)
        return bool(stick.strikes)

    ringing.until(tapped)
    (strike,) = stick.strikes
    assert near(stick, strike, strikes_n[-1] * MASS_KG, (0.0, 1.0))


def test_effects_are_stopped_with_the_forces_and_not_started_without_them(ringing: World) -> None:
    stick = ringing.plug()
    engine = ringing.start()
    methods = Methods(engine)

    def stopped() -> bool:
        """Turn forces off while the effect plays, which lasts at most 0.1 s more."""
        engine.set_forces(True)
        ringing.full(engine)
        index = struck(ringing, methods, stick, direction=[0, 1], amplitude_m_per_s2=10.0).index
        engine.set_forces(False)
        # During the fade, the device does not play a strike.
        before, renewed = len(stick.strikes), stick.log.count("operation start 1")
        engine.play(MODE, "coefficient", (0.0, 1.0), 10.0)
        stick.wait(lambda: stick.log.count("operation start 1") >= renewed + 3)
        assert len(stick.strikes) == before
        return f"operation stop {index}" in stick.log

    ringing.until(stopped)
    before = len(stick.strikes)
    ringing.hold(0.004)
    ringing.arrived(engine, 0.004)
    engine.set_forces(True)
    stick.wait(pressed(stick, 0.004))
    assert len(stick.strikes) == before


def test_an_unplugged_device_and_a_reset(ringing: World) -> None:
    stick = ringing.plug()
    engine = ringing.start()
    play = {"material": "ringing", "direction": [0, 1], "amplitude_m_per_s2": 10.0}
    methods = Methods(engine)
    engine.set_forces(True)
    ringing.full(engine)
    struck(ringing, methods, stick, direction=[0, 1], amplitude_m_per_s2=10.0)
    # Its effects were lost and created again, so everything must be sent again.
    stick.reset()
    ringing.until(lambda: connection_status(engine)["resets"] >= 1)
    ringing.until(lambda: play_until(methods, play, stick, 2))
    assert near(stick, stick.strikes[-1], 10.0 * MASS_KG, (0.0, 1.0))
    ringing.unplug()
    ringing.until(lambda: Fault.DEVICE in engine.counters().faults)
    again = ringing.plug()
    ringing.until(lambda: connection_status(engine)["state"] == "connected")
    ringing.until(lambda: engine.set_forces(True) > 0 and not engine.counters().faults)
    ringing.full(engine)
    ringing.until(lambda: play_until(methods, play, again, 1))
    assert near(again, again.strikes[-1], 10.0 * MASS_KG, (0.0, 1.0))


def play_until(methods: Methods, play: dict[str, Any], stick: FakePid, count: int) -> bool:
    methods.call("play", play)
    return len(stick.strikes) >= count


def test_the_status_reports_which_modes_are_offloaded(ringing: World) -> None:
    ringing.plug()
    engine = ringing.start()
    status = Methods(engine).status()
    outcomes = {entry["material"]: entry for entry in status["offload"]}  # type: ignore[attr-defined]
    assert outcomes.keys() == {"ringing", "glass"}
    found = nearest_effect(MODE, scales(FINE))
    assert found is not None
    assert outcomes["ringing"] == {
        "material": "ringing",
        "mode": "tap",
        "frequency_hz": pytest.approx(1500.0),
        "shown_hz": pytest.approx(found.frequency_hz),
        "period_resolution_s": pytest.approx(1e-4),
        "envelope_resolution_s": pytest.approx(1e-4),
        "error_percent": pytest.approx(100 * found.error),
        "streamed_error_percent": 100.0,
        "refused": None,
    }
    # A mode that the device plays is not silent.
    assert status["undisplayable"] == []
    silent = {"materials": {"glass": {"tap": {"frequency_hz": 4700.0}}}}
    Methods(engine).call("update_materials", silent)
    status = Methods(engine).status()
    outcomes = {entry["material"]: entry for entry in status["offload"]}  # type: ignore[attr-defined]
    assert "% off" in outcomes["glass"]["refused"]
    assert [mode["material"] for mode in status["undisplayable"]] == ["glass"]  # type: ignore[attr-defined]


def test_a_device_without_periodic_effects(ringing: World) -> None:
    ringing.like = replace(FINE, without=frozenset({0x5A}))
    stick = ringing.plug()
    engine = ringing.start()
    status = Methods(engine).status()
    assert {entry["refused"] for entry in status["offload"]} == {"the device has no Set Envelope"}  # type: ignore[attr-defined]
    assert {mode["material"] for mode in status["undisplayable"]} == {"ringing", "glass"}  # type: ignore[attr-defined]
    engine.set_forces(True)
    Methods(engine).call("play", {"material": "ringing", "direction": [0, 1], "amplitude_m_per_s2": 10.0})
    ringing.hold(0.004)
    stick.wait(pressed(stick, 0.004))
    assert not stick.strikes
