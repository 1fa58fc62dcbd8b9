"""The check of a device's signs in an engine with a PID device whose handle follows its force."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from hapticd.analysis.calibration.rig import rig_of
from hapticd.base.core import SAMPLE_DTYPE, Fault, Flag, HidMeaning, SignsProblem, SignsState, records
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import load_config
from hapticd.config.hid import Hid
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.refusal import MethodError
from hapticd.daemon.status_text import lines
from hapticd.daemon.telemetry import Telemetry
from hapticd.hid import handle_use
from hapticd.hid.connection import Opened
from hapticd.hid.descriptor.layout import layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.signs import SignsStatus
from hapticd.recording.replay import replay
from hapticd.rendering.offline import Rerun
from tests.hid.test_connection import COUNTS, FLOOR, FULL_N, STIFFNESS, TRAVEL_M, World
from tests.recording.test_replay import write
from tests.support import firmware_descriptors as descriptors
from tests.support.firmware import ARDUINO, FINO, OPENFFBOARD, OPENFFBOARD_1, Firmware, Variant

GIVES = 0.8
"""Deflection by the full force, as a fraction of the half travel, of a handle that a spring centres."""
AWAY = {"objects": {"floor": {"kind": "wall", "point_m": [0, -0.02], "normal": [0, 1], "material": "plain"}}}


class Sprung(World):
    """Joysticks whose handle follows their force."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(monkeypatch)
        self.hid = {"renew_s": 0.1, "effect_duration_s": 0.25, "signs": "check"}
        self.config["scene"] = AWAY
        self.way = ((1.0, 0.0), (0.0, 1.0))
        """Matrix from a commanded force to the force of the device."""
        self.gives = GIVES
        self.port = "here"
        self.room = records(SAMPLE_DTYPE, 16384)
        self.samples = records(SAMPLE_DTYPE, 0)

    def open(self) -> Opened:
        return replace(super().open(), identity=self.port)

    def _move(self) -> None:
        while not self._stop.wait(0.0005):
            if self.engine is not None:
                self.engine.beat()
                self.engine.poll_servo()
            stick = self.stick
            if stick is not None:
                force = stick.force()
                # HID's Y grows towards the user.
                x, y = (self.gives * (a * force[0] + b * force[1]) for a, b in self.way)
                stick.report(round(COUNTS * x), round(-COUNTS * y) + self._y)

    def collect(self) -> None:
        """Collect the samples since the previous call."""
        assert self.engine is not None
        count, dropped = self.engine.read_samples(self.room)
        assert not dropped
        self.samples = np.concatenate([self.samples, self.room[:count].copy()])

    def comes_to(self, *states: SignsState) -> None:
        def there() -> bool:
            assert self.engine is not None
            self.collect()
            state = self.engine.counters().signs.state
            if state == SignsState.UNCLEAR:  # a Python thread moves the handle, and may be delayed
                self.engine.set_forces(True)
            return state in states

        self.until(there)

    def checked(self) -> np.ndarray:
        return np.asarray(self.samples["flags"] & Flag.CHECKING != 0)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[Sprung]:
    made = Sprung(monkeypatch)
    yield made
    made.close()


class Flashed(Sprung):
    """A simulated firmware that shares no code with the driver."""

    firmware: Firmware
    rest = 0.0
    """Where the handle is without a force along y, as a part of the half travel."""

    def flash(self, descriptor: bytes, variant: Variant) -> Firmware:
        self.firmware = Firmware(descriptor, variant, clock=time.monotonic)
        return self.firmware

    def open(self) -> Opened:
        hid = Hid(travel_m=TRAVEL_M, full_scale_force_n=FULL_N, **self.hid)
        driver = PidDriver(layout_of(parse(self.firmware.descriptor)), hid)
        return Opened(self.firmware.device, driver, "stick", 0.001, False)

    def _move(self) -> None:
        while not self._stop.wait(0.0005):
            if self.engine is not None:
                self.engine.beat()
                self.engine.poll_servo()
            x, y = self.firmware.force()
            self.firmware.position(self.gives * x, self.rest + self.gives * y)

    def close(self) -> None:
        super().close()
        self.firmware.close()


@pytest.fixture
def flashed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Flashed]:
    made = Flashed(monkeypatch)
    yield made
    made.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("descriptor", "variant", "state"),
    [
        (descriptors.FINO, FINO, SignsState.RIGHT),
        (descriptors.ARDUINO, ARDUINO, SignsState.WRONG),
        (descriptors.OPENFFBOARD_2, OPENFFBOARD, SignsState.RIGHT),
        (descriptors.OPENFFBOARD_1, OPENFFBOARD_1, SignsState.RIGHT),
        (descriptors.OPENFFBOARD_1, replace(OPENFFBOARD_1, signs=(-1, 1)), SignsState.WRONG),
        (descriptors.SIDEWINDER_FF2, Variant(), SignsState.RIGHT),
        (descriptors.SIDEWINDER_FF2, Variant(signs=(1, -1)), SignsState.WRONG),
    ],
    ids=["fino", "arduino", "openffboard", "one axis", "one axis reversed", "sidewinder", "sidewinder with y reversed"],
)
def test_the_signs_of_known_firmware(flashed: Flashed, descriptor: bytes, variant: Variant, state: SignsState) -> None:
    firmware = flashed.flash(descriptor, variant)
    engine = flashed.start()
    engine.set_forces(True)
    flashed.comes_to(SignsState.RIGHT, SignsState.WRONG)
    signs = engine.counters().signs
    assert signs.state == state, signs
    if state == SignsState.WRONG:
        assert signs.axis == ("x" if variant.signs[0] < 0 else "y")
        assert engine.counters().faults == Fault.SIGNS
        last = int(np.flatnonzero(flashed.checked())[-1])
        settled(flashed)
        assert not flashed.samples["force_n"][last + 1 :].any()
        flashed.until(lambda: firmware.force() == (0.0, 0.0))


def settled(world: Sprung) -> None:
    """Wait for ten more ticks."""
    assert world.engine is not None
    engine, ticks = world.engine, world.engine.counters().ticks
    world.until(lambda: engine.counters().ticks > ticks + 10)
    world.collect()


def signs_of(engine: Engine) -> dict[str, Any]:
    connection = Methods(engine).call("get_status", {})["connection"]
    assert isinstance(connection, dict)
    return dict(connection["signs"])


@pytest.mark.slow
def test_right_signs_then_the_scene_and_a_replay_bit_for_bit(world: Sprung, tmp_path: Path) -> None:
    world.plug()
    engine = world.start()
    assert signs_of(engine) == {"state": "unchecked", "axis": None, "problem": None, "advice": None}
    settled(world)
    assert not world.samples["force_n"].any() and not world.checked().any()
    answer = Methods(engine).call("set_forces", {"enabled": True})
    assert answer["forces"] == "on" and answer["signs"]["state"] == "checking"  # type: ignore[index]
    with pytest.raises(MethodError, match="signs of the device are checked") as refused:
        Methods(engine).call("play", {"material": "wood", "amplitude_m_per_s2": 1.0, "direction": [0, 1]})
    assert refused.value.code == -32003
    world.comes_to(SignsState.RIGHT)
    world.hold(0.024)  # by hand, in addition to the spring's deflection
    assert engine.counters().faults == Fault(0)
    world.until(lambda: (world.collect(), world.samples["force_n"][-1, 1] > 0.5 * 0.004 * STIFFNESS)[1])
    checked = world.checked()
    forces = world.samples["force_n"][checked]
    assert 0.05 * FULL_N < np.abs(forces).max() <= 0.1 * FULL_N * (1 + 1e-12)
    assert (world.samples["flags"][checked] & Flag.FORCES_ON).all()

    rerun = Rerun(engine.output, 1)
    rerun.turn_to(engine.scene, engine.scene.objects, engine.materials, engine.revision)
    rerun.restart(muted=True)
    samples, begin = world.samples, int(np.argmax(checked))
    assert begin and not checked[0]
    interval_s = np.where(samples["flags"] & Flag.REPEATED, 0.0, 1e-3)
    missed = np.diff(samples["time_ns"], prepend=samples["time_ns"][0] - 1_000_000)
    periods = np.where(samples["flags"] & Flag.SKIPPED, np.rint(missed / 1e6), 1).astype(np.uint32)
    # Ticks of the start-up, without a position, are left out.
    first = int(np.argmax(samples["flags"] & Flag.REPEATED == 0))
    again, _ = rerun.run(samples[first:], interval_s[first:], periods[first:])
    for name in ("contact_force_n", "vibration_force_n", "force_n"):
        assert again[name].tobytes() == samples[name][first:].tobytes(), name
    assert again["flags"][1:].tobytes() == samples["flags"][first + 1 :].tobytes()

    # A recording that begins in the middle of the check has no force of the scene before the check ends, either.
    middle = (begin + int(np.flatnonzero(checked)[-1])) // 2
    # A replay begins at two successive ticks with a new report, no ramp and no glitch.
    fresh = samples["flags"][middle:] & (Flag.REPEATED | Flag.RAMPING | Flag.GLITCH) == 0
    part = samples[middle + int(np.argmax(fresh[:-1] & fresh[1:])) :]
    config = {"servo": {"rate_hz": 1000}, "device": {"kind": "hid"}, **world.config}
    write(
        tmp_path / "part.npz", part, config, texts={"status": {"connection": {"link_hz": engine.output.link_rate_hz}}}
    )
    found = replay(tmp_path / "part.npz")
    assert found.identical == len(found.samples) > 0.8 * len(part), found.summary()
    assert (found.samples["flags"] & Flag.CHECKING).any() and not (found.samples["flags"][-1] & Flag.CHECKING)


@pytest.mark.slow
def test_wrong_signs_and_never_a_force_of_the_scene(world: Sprung, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "hapticd")
    world.way = ((-1.0, 0.0), (0.0, 1.0))
    stick = world.plug()
    engine = world.start()
    engine.set_forces(True)
    world.comes_to(SignsState.WRONG)
    signs = signs_of(engine)
    assert (signs["state"], signs["axis"], signs["problem"]) == ("wrong", "x", "reversed")
    assert "hapticd devices calibrate" in signs["advice"] and "\n" not in signs["advice"]
    assert engine.counters().faults == Fault.SIGNS
    world.hold(0.024)
    for _ in range(2):
        with pytest.raises(
            MethodError, match="moves the handle the other way: run `hapticd devices calibrate`"
        ) as caught:
            Methods(engine).call("set_forces", {"enabled": True})
        assert caught.value.code == -32003 and caught.value.data == {"faults": ["signs"]}
        settled(world)
    last = int(np.flatnonzero(world.checked())[-1])
    assert not world.samples["force_n"][last + 1 :].any()
    assert stick.force() == (0.0, 0.0)
    world.until(lambda: any("signs of the device are wrong" in line for line in caplog.messages))
    assert sum("signs of the device are wrong" in line for line in caplog.messages) == 1
    # The result stays when the same device comes back; another device is checked.
    world.unplug()
    world.until(lambda: Fault.DEVICE in engine.counters().faults)
    world._y = 0
    world.way = ((1.0, 0.0), (0.0, 1.0))
    world.port = "elsewhere"
    world.plug()
    world.until(lambda: engine.counters().signs.state == SignsState.UNCHECKED)
    world.until(lambda: engine.set_forces(True) > 0 and engine.counters().faults == Fault(0))
    world.comes_to(SignsState.RIGHT)


@pytest.mark.slow
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_programs_that_strike_a_device_wait_for_the_check(
    world: Sprung, way: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`hapticd calibrate` and `verify` run a separate servo."""
    world.way = ((way, 0.0), (0.0, way))
    world.plug()
    monkeypatch.setattr("hapticd.daemon.engine.DEVICE_TIMEOUT_S", world.late_after_s)
    config = load_config(
        {"servo": {"realtime": "off", "rate_hz": 1000}, "device": {"kind": "hid", "hid": {**world.hid}}, **world.config}
    )
    mover = threading.Thread(target=world._move)
    mover.start()
    try:
        if way > 0:
            with rig_of(config) as rig:
                samples = rig.run(0.1)
                assert not (samples["flags"][-1] & Flag.CHECKING) and samples["flags"][-1] & Flag.FORCES_ON
        else:
            with pytest.raises(HapticdError, match="moves the handle the other way: run `hapticd devices calibrate`"):
                rig_of(config)
    finally:
        world._stop.set()
        mover.join()


@pytest.mark.slow
def test_a_device_that_comes_back_is_not_checked_again(world: Sprung) -> None:
    world.plug()
    engine = world.start()
    engine.set_forces(True)
    world.comes_to(SignsState.RIGHT)
    world.unplug()
    world.until(lambda: Fault.DEVICE in engine.counters().faults)
    world.plug()
    world.until(lambda: engine.set_forces(True) > 0 and engine.counters().faults == Fault(0))
    world.collect()
    before = len(world.samples)
    settled(world)
    assert not world.checked()[before:].any()
    assert engine.counters().signs.state == SignsState.RIGHT


@pytest.mark.slow
def test_the_check_waits_for_the_handle_to_leave_an_object(world: Sprung) -> None:
    world.plug()
    engine = world.start()
    world.hold(0.024)
    world.arrived(engine, 0.024)
    engine.set_forces(True)
    world.comes_to(SignsState.WAITING)
    assert signs_of(engine)["problem"] == "contact"
    assert signs_of(engine)["advice"].startswith("the handle touches an object of the scene")
    settled(world)
    assert not world.samples["force_n"].any()
    world._y = 0
    world.comes_to(SignsState.RIGHT)


def test_forces_off_end_a_pulse(world: Sprung) -> None:
    stick = world.plug()
    engine = world.start()
    engine.set_forces(True)
    stick.wait(lambda: stick.force()[0] != 0.0)
    tick = engine.set_forces(False)
    settled(world)
    assert not world.samples["force_n"][world.samples["tick"] >= tick].any()
    assert signs_of(engine)["state"] == "unchecked"


@pytest.mark.parametrize("trusted", [{"signs": "trust"}, {"force_axes": {"x": {"sign": 1}}}])
def test_a_device_that_is_trusted_pushes_at_once(world: Sprung, trusted: dict[str, Any]) -> None:
    del world.hid["signs"]
    world.hid |= trusted
    world.gives = 0.0
    world.plug()
    engine = world.start()
    world.hold(0.024)
    engine.set_forces(True)
    world.until(lambda: (world.collect(), world.samples["force_n"][-1, 1] > 0.5 * 0.004 * STIFFNESS)[1])
    assert not world.checked().any()
    assert signs_of(engine)["state"] == "trusted"


class _Unheard:
    """A publisher without subscribers."""

    def wants(self, topic: str) -> bool:
        return False


@pytest.mark.parametrize("enabled", [True, False], ids=["forces on", "forces off"])
def test_a_handle_that_rests_inside_a_wall_is_reported(
    world: Sprung, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, enabled: bool
) -> None:
    """The check of signs would wait for ever that somebody moves the handle away and lets go of it."""
    monkeypatch.setattr(handle_use, "MIN_REST_S", 0.05)
    world.config["scene"] = FLOOR
    world.plug()
    world.hold(0.003)
    engine = world.start()
    telemetry = Telemetry(engine, cast(Any, _Unheard()), dict)
    if enabled:
        engine.set_forces(True)

    def warned() -> list[str]:
        telemetry._drain()
        telemetry._send_samples()
        return list(Methods(engine).call("get_status", {})["connection"]["warnings"])

    problem = "contact" if enabled else None
    world.until(lambda: bool(warned()) and signs_of(engine)["problem"] == problem)
    (line,) = warned()
    assert line.startswith("the handle rests at x 0.0 mm, y -3.0 mm, inside floor, which pushes it with 2.4 N: ")
    assert caplog.messages.count(line) == 1
    assert ("warning", line) in list(lines(Methods(engine).call("get_status", {})))


class Updated(Flashed):
    """A simulated firmware of a certain version. The configuration has the signs of version 0x0107."""

    version: int | None = 0x0108

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(monkeypatch)
        self.hid = {"renew_s": 0.1, "effect_duration_s": 0.25, "device_version": 0x0107}
        self.hid["force_axes"] = {"x": {"sign": 1}, "y": {"sign": 1}}

    def open(self) -> Opened:
        keys: dict[str, int | str] = {} if self.version is None else {"device_version": self.version}
        return replace(super().open(), keys=keys, identity=str(self.version))

    def poll(self) -> str:
        assert self.engine is not None
        self.engine.poll_servo()
        return str(signs_of(self.engine)["state"])


@pytest.fixture
def updated(monkeypatch: pytest.MonkeyPatch) -> Iterator[Updated]:
    made = Updated(monkeypatch)
    yield made
    made.close()


@pytest.mark.long
def test_signs_that_an_update_turned_round_are_noticed(updated: Updated, caplog: pytest.LogCaptureFixture) -> None:
    """Trusted, the wall would pull the hand in with half of the full force."""
    firmware = updated.flash(descriptors.SIDEWINDER_FF2, Variant(signs=(1, -1)))
    engine = updated.start()
    assert signs_of(engine)["state"] == "unchecked"
    engine.set_forces(True)
    updated.comes_to(SignsState.WRONG)
    updated.until(lambda: Fault.SIGNS in engine.counters().faults)
    updated.collect()
    assert np.abs(updated.samples["force_n"]).max() <= 0.1 * FULL_N * (1 + 1e-9), "never more than the check's force"
    engine.poll_servo()
    why = "device.hid.device_version is 0x0107, the device shows 0x0108: its signs are checked before the first force"
    assert any(why in line for line in caplog.messages)
    assert any(why in line for line in Methods(engine).call("get_status", {})["connection"]["warnings"])
    assert any("the other way" in line for line in caplog.messages)
    assert firmware.force() == (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("version", "action"), [(0x0108, "set device_version: 0x0108"), (None, "remove device_version")]
)
def test_an_update_that_leaves_the_signs_as_they_are(updated: Updated, version: int | None, action: str) -> None:
    updated.version = version
    updated.flash(descriptors.SIDEWINDER_FF2, Variant())
    engine = updated.start()
    engine.set_forces(True)
    updated.comes_to(SignsState.RIGHT)
    (line,) = Methods(engine).call("get_status", {})["connection"]["warnings"]
    assert line.endswith(f"if they are right, {action}")


@pytest.mark.parametrize(
    ("version", "keys"),
    [(0x0107, {}), (0x0108, {"device_version": None}), (None, {"device_version": None})],
    ids=["the same version", "no version was kept", "neither has one"],
)
def test_a_version_that_is_no_other(updated: Updated, version: int | None, keys: dict[str, Any]) -> None:
    updated.version = version
    updated.hid |= keys
    updated.flash(descriptors.SIDEWINDER_FF2, Variant())
    engine = updated.start()
    engine.set_forces(True)
    updated.until(lambda: updated.poll() == "trusted")
    connection = Methods(engine).call("get_status", {})["connection"]
    assert connection["warnings"] == [] and connection["device_version"] == version


def test_when_signs_are_checked_or_trusted() -> None:
    report = {
        "input": {"x": {"bit_offset": 0, "bit_size": 16, "counts_per_m": 1e5}},
        "output": {"length": 2, "x": {"bit_offset": 0, "bit_size": 16, "counts_per_n": 100}},
    }
    assert Hid().signs == "check"
    assert Hid(travel_m=0.1).signs == "check"
    assert Hid(force_axes={}).signs == "check", "says nothing"
    assert Hid(force_axes={"x": {"sign": -1}}).signs == "trust"
    assert Hid(report=report).signs == "trust"
    assert Hid(report=report, signs="check").signs == "check"
    hid = load_config({"device": {"kind": "hid", "hid": {"signs": "trust"}}}).device.hid
    assert load_config({"device": {"hid": hid.to_dict()}}).device.hid == hid
    hid = load_config({"device": {"kind": "hid"}}).device.hid
    assert load_config({"device": {"hid": hid.to_dict()}}).device.hid.signs == "check"


SENSOR = Variant(hand_sensor=True)


def waits(world: Sprung) -> None:
    """Wait for longer than the five rounds of pulses after which an axis is unclear."""
    assert world.engine is not None
    engine, ticks = world.engine, world.engine.counters().ticks
    world.until(lambda: (world.collect(), engine.counters().ticks > ticks + 6000)[1])


@pytest.mark.slow
def test_the_check_and_the_scene_wait_for_a_hand_on_the_sensor(
    flashed: Flashed, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "hapticd")
    flashed.config["scene"] = {**AWAY, "ramp_s": 0.1}
    firmware = flashed.flash(descriptors.SIDEWINDER_FF2, SENSOR)
    engine = flashed.start()
    methods = Methods(engine)
    advice = SignsStatus(SignsState.WAITING, SignsProblem.IDLE, "x", 1 << (HidMeaning.SAFETY - 1)).line()
    assert advice is not None and "its safety switch is open: hold the handle lightly and still" in advice
    signs = methods.call("set_forces", {"enabled": True})["signs"]  # type: ignore[call-overload,index]
    assert (signs["state"], signs["problem"], signs["advice"]) == ("waiting", "idle", advice)
    streamed = methods.call("stream_force", {"seq": 1, "force_n": [0.0, 0.0]})
    assert streamed == {"forces": "on", "warning": f"forces are held back: {advice}"}
    with pytest.raises(MethodError, match=re.escape(f"forces are held back: {advice}")):
        methods.call("play", {"material": "wood", "amplitude_m_per_s2": 1.0, "direction": [0, 1]})
    waits(flashed)
    assert engine.counters().faults == Fault(0) and signs_of(engine)["advice"] == advice
    firmware.becomes(hand=True)
    flashed.comes_to(SignsState.RIGHT)
    assert caplog.messages.count(f"forces are held back: {advice}") == 1
    # In a wall the hand leaves the sensor, and comes back.
    flashed.gives = 0.0
    flashed.rest = -0.024 / TRAVEL_M
    wall_n = 0.004 * STIFFNESS
    flashed.until(lambda: (flashed.collect(), flashed.samples["force_n"][-1, 1] > 0.99 * wall_n)[1])
    firmware.becomes(hand=False)
    flashed.until(lambda: (flashed.collect(), not flashed.samples["force_n"][-1].any())[1])
    assert signs_of(engine)["advice"] == advice and engine.counters().faults == Fault(0)
    left = len(flashed.samples)
    firmware.becomes(hand=True)
    flashed.until(lambda: (flashed.collect(), flashed.samples["force_n"][-1, 1] > 0.99 * wall_n)[1])
    risen = flashed.samples[left:]
    assert (risen["flags"] & Flag.RAMPING).any(), "it fades in"
    assert signs_of(engine)["state"] == "right"


@pytest.mark.slow
@pytest.mark.parametrize(
    "variant", [Variant(ready="never"), replace(SENSOR, ready="never"), replace(SENSOR, ready="turned")]
)
def test_a_safety_switch_that_is_reported_wrongly_does_not_prevent_the_check(
    flashed: Flashed, variant: Variant
) -> None:
    firmware = flashed.flash(descriptors.SIDEWINDER_FF2, variant)
    engine = flashed.start()
    firmware.becomes(hand=True)
    engine.set_forces(True)
    flashed.comes_to(SignsState.RIGHT)
    firmware.becomes(hand=False)
    firmware.becomes(hand=True)
    settled(flashed)
    assert engine.counters().signs.state == SignsState.RIGHT


@pytest.mark.slow
@pytest.mark.parametrize(("variant", "stopped"), [(Variant(dead_band=0.15), False), (Variant(), True)])
def test_a_device_that_does_not_report_why_it_does_not_move(flashed: Flashed, variant: Variant, stopped: bool) -> None:
    firmware = flashed.flash(descriptors.SIDEWINDER_FF2, variant)
    firmware.stopped = stopped
    engine = flashed.start()
    engine.set_forces(True)
    flashed.until(lambda: engine.counters().faults == Fault.SIGNS)
    advice = signs_of(engine)["advice"]
    assert advice.startswith("the handle did not move when it was pushed along x: let go of the handle, or ")
    for reason in ("hand sensor", "emergency stop", "work mode", "dead band takes 10 %"):
        assert reason in advice
    firmware.stopped = False
    if stopped:
        engine.set_forces(True)
        flashed.comes_to(SignsState.RIGHT)


@pytest.mark.slow
def test_actuators_that_a_device_keeps_off_are_no_fault_of_the_check(flashed: Flashed) -> None:
    """The daemon sets the device up again, and sends no force before the actuators are on."""
    firmware = flashed.flash(descriptors.SIDEWINDER_FF2, Variant())
    engine = flashed.start()
    engine.set_forces(True)
    firmware.wait(lambda: firmware.force() != (0.0, 0.0))
    firmware.becomes(enabled=False, locked=True)
    waits(flashed)
    assert engine.counters().faults == Fault(0)
    signs = signs_of(engine)
    assert signs["state"] == "waiting" and "its actuators are off and it was reset" in signs["advice"]
    firmware.becomes(enabled=True, locked=False)
    flashed.comes_to(SignsState.RIGHT)
