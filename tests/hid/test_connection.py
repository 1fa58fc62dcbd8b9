"""An engine with a PID device: positions in, forces out; the device is unplugged, plugged in again, and reset."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, Fault, Flag, records
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import load_config
from hapticd.config.hid import Hid
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.refusal import MethodError
from hapticd.hid import connection as connection_module
from hapticd.hid.connection import Opened
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.plan import DeviceError
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid

STIFFNESS = 800.0
TRAVEL_M = 0.05
FULL_N = 8.9
FLOOR = {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "plain"}}}
COUNTS = 32767


class World:
    """Joysticks that are plugged in and unplugged, and an engine that connects to one."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.like = Joystick()
        self.stick: FakePid | None = None
        self.sticks: list[FakePid] = []
        self.opened: list[Opened] = []
        self.on_change: bool | None = False
        self.hid: dict[str, Any] = {"renew_s": 0.1, "effect_duration_s": 0.25, "signs": "trust"}
        """Further keys of `device.hid`. Renewals are slow, because a Python thread reports which effects play."""
        self.late_after_s = 60.0
        """A report that is later is a fault. A Python thread sends the reports, which may be delayed."""
        self.config: dict[str, Any] = {
            "materials": {"plain": {"stiffness_n_per_m": STIFFNESS}},
            "scene": FLOOR,
        }
        self.engine: Engine | None = None
        self._stop = threading.Event()
        self._y = 0
        self._thread: threading.Thread | None = None
        self._monkeypatch = monkeypatch
        monkeypatch.setattr("hapticd.daemon.engine.source_of", lambda _: self.open)
        monkeypatch.setattr(connection_module, "RECONNECT_INTERVAL_S", 0.01)
        # Reports about the set-up must not be taken for later ones.
        monkeypatch.setattr(connection_module, "READY_POLL_INTERVAL_S", 0.3)
        monkeypatch.setattr(connection_module, "READY_TIMEOUT_S", 60.0)

    def plug(self, **keys: Any) -> FakePid:
        self.stick = FakePid(bytes(self.like), **keys)
        self.sticks.append(self.stick)
        return self.stick

    def unplug(self) -> None:
        stick, self.stick = self.stick, None
        assert stick is not None
        stick.unplug()

    def open(self) -> Opened:
        stick = self.stick
        if stick is None:
            raise DeviceError("no HID device is connected")
        hid = Hid(travel_m=TRAVEL_M, full_scale_force_n=FULL_N, **self.hid)
        self.opened.append(Opened(stick.device, PidDriver(stick.layout, hid), "stick", 0.001, self.on_change))
        return self.opened[-1]

    def start(self, **servo: Any) -> Engine:
        """Start an engine whose servo knows the handle's position; without a position, forces are a fault."""
        self._monkeypatch.setattr("hapticd.daemon.engine.DEVICE_TIMEOUT_S", self.late_after_s)
        config = load_config(
            {
                "servo": {"realtime": "off", "rate_hz": 1000, **servo},
                **self.config,
                "device": {"kind": "hid", "hid": {"travel_m": TRAVEL_M, **self.hid}, **self.config.get("device", {})},
            }
        )
        self.engine = Engine(config)
        self._thread = threading.Thread(target=self._move, daemon=True)
        self._thread.start()
        self.engine.start()
        room = records(SAMPLE_DTYPE, 16384)

        def located() -> bool:
            assert self.engine is not None
            count, _ = self.engine.read_samples(room)
            new = room["flags"][:count] & Flag.REPEATED == 0
            return bool(np.any(new & (room["tick"][:count] > 0)))

        self.until(located)
        return self.engine

    def hold(self, depth_m: float) -> None:
        """Hold the handle at this depth in the floor from now on. HID's Y grows towards the user: down is positive."""
        self._y = round(COUNTS * depth_m / TRAVEL_M)

    def _move(self) -> None:
        """Send input reports continuously, as a device does, and heartbeats for the engine."""
        while not self._stop.wait(0.002):
            if self.engine is not None:
                self.engine.beat()
            stick = self.stick
            if stick is not None:
                stick.report(0, self._y)

    def until(self, what: Callable[[], bool], timeout_s: float = 60.0) -> None:
        """Poll a condition that no event announces; the time limit only keeps a broken test from hanging."""
        pause, deadline = threading.Event(), time.monotonic() + timeout_s
        while not what():
            assert time.monotonic() < deadline
            pause.wait(0.002)

    def full(self, engine: Engine) -> None:
        """Wait until forces are fully on."""
        room = records(SAMPLE_DTYPE, 16384)

        def settled() -> bool:
            count, _ = engine.read_samples(room)
            flags = room["flags"][:count]
            return bool(count) and int(flags[-1]) & (Flag.FORCES_ON | Flag.RAMPING | Flag.FAULT) == Flag.FORCES_ON

        self.until(settled)

    def arrived(self, engine: Engine, depth_m: float) -> None:
        """Wait until the servo has received this position of the handle."""
        room = records(SAMPLE_DTYPE, 16384)

        def seen() -> bool:
            count, _ = engine.read_samples(room)
            return bool(count) and abs(room["position_m"][count - 1, 1] + depth_m) < 1e-5

        self.until(seen)

    def later(self, engine: Engine) -> None:
        """Wait for the end of a tick that has not begun yet."""
        ticks = engine.counters().ticks
        self.until(lambda: engine.counters().ticks > ticks + 1)

    def contacts(self, engine: Engine) -> npt.NDArray[np.void]:
        """Return the contact events since the previous call."""
        room = records(EVENT_DTYPE, 4096)
        count, _ = engine.read_events(room)
        return room[:count][room["kind"][:count] == EventKind.CONTACT]

    def events(self) -> list[EventKind]:
        assert self.engine is not None
        room = records(EVENT_DTYPE, 4096)
        count, _ = self.engine.read_events(room)
        return [EventKind(int(kind)) for kind in room["kind"][:count]]

    def close(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        if self.engine is not None:
            self.engine.stop()
        for stick in self.sticks:
            stick.close()


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[World]:
    made = World(monkeypatch)
    yield made
    made.close()


def pressed(stick: FakePid, depth_m: float) -> Callable[[], bool]:
    """Return whether the device exerts the floor's force at this depth."""
    wanted = STIFFNESS * depth_m / FULL_N
    return lambda: abs(stick.force()[1] - wanted) < 2e-3 and abs(stick.force()[0]) < 0.01


def test_position_in_and_force_out(world: World) -> None:
    stick = world.plug()
    engine = world.start()
    assert engine.counters().forces_on is False
    world.hold(0.004)
    room = records(SAMPLE_DTYPE, 16384)

    def deep() -> bool:
        count, _ = engine.read_samples(room)
        return count > 0 and abs(room["position_m"][count - 1][1] + 0.004) < 1e-5

    world.until(deep)
    assert stick.force() == (0.0, 0.0)
    engine.set_forces(True)
    stick.wait(pressed(stick, 0.004))
    world.hold(-0.01)
    stick.wait(lambda: stick.force() == (0.0, 0.0))
    world.hold(0.006)
    stick.wait(pressed(stick, 0.006))


def test_effects_are_renewed_while_nothing_changes(world: World) -> None:
    stick = world.plug()
    world.start()
    for index in (1, 2):
        stick.log.clear()
        stick.wait(lambda index=index: f"operation start {index}" in stick.log)


def test_the_end_is_orderly(world: World) -> None:
    stick = world.plug()
    engine = world.start()
    world.hold(0.004)
    engine.set_forces(True)
    stick.wait(pressed(stick, 0.004))
    engine.stop()
    world.engine = None
    stick.wait(lambda: not stick.effects and not stick.enabled)
    tail = stick.log[-6:]
    assert tail[:2] == ["operation stop 1", "operation stop 2"] and tail[-1] == "disable_actuators"


def test_unplugged_and_plugged_in_again_during_contact(world: World) -> None:
    stick = world.plug()
    engine = world.start()
    world.hold(0.004)
    engine.set_forces(True)
    stick.wait(pressed(stick, 0.004))
    world.events()
    world.unplug()
    world.until(lambda: Fault.DEVICE in engine.counters().faults)
    assert EventKind.DEVICE_LOST in world.events()
    connection = engine.connection
    assert connection is not None
    world.until(lambda: connection.status()["problem"] == "no HID device is connected")
    assert connection.status()["state"] == "lost"
    again = world.plug()
    world.until(lambda: connection.status()["state"] == "connected")
    assert (connection.status()["problem"], connection.status()["connects"]) == (None, 2)
    world.until(lambda: EventKind.DEVICE_FOUND in world.events())
    assert "floor" in engine.scene.objects
    # The fault stays until a client clears it.
    assert again.force() == (0.0, 0.0)
    engine.set_forces(True)
    again.wait(pressed(again, 0.004))


def test_a_lost_device_has_a_reason_before_its_thread_notices_the_loss(world: World) -> None:
    world.plug()
    connection = connection_module.Connection(world.open)
    connection.open()
    assert (connection.status()["state"], connection.status()["problem"]) == ("connected", None)
    world.unplug()
    world.until(lambda: connection.status()["state"] == "lost")
    assert isinstance(connection.status()["problem"], str)
    connection.stop()


def test_a_device_that_was_reset_is_set_up_again(world: World) -> None:
    stick = world.plug()
    engine = world.start()
    world.hold(0.004)
    engine.set_forces(True)
    stick.wait(pressed(stick, 0.004))
    for _ in range(2):
        stick.reset()
        stick.wait(lambda: "operation start 2" in stick.log and "create" in stick.log)
        stick.wait(pressed(stick, 0.004))
    assert engine.counters().faults == Fault(0)
    connection = engine.connection
    assert connection is not None
    world.until(
        lambda: connection.status()["states"] == {"actuators": True, "paused": False, "safety": True, "power": True}
    )
    assert connection.status()["connects"] == 1 and connection.status()["resets"] in (1, 2)
    # The device reports which effects play, so only the set-up sends directions.
    assert connection.status()["resets_seen"] is True and connection.status()["foreign_effect_s"] is None


@pytest.mark.slow
def test_a_reset_that_leaves_the_actuators_on_is_seen_by_the_effects(world: World) -> None:
    stick = world.plug()
    engine = world.start()
    world.hold(0.004)
    engine.set_forces(True)
    stick.wait(pressed(stick, 0.004))
    for _ in range(3):
        # A lost effect counts only after effects have played over several renewals.
        stick.log.clear()
        stick.wait(lambda: stick.log.count("operation start 2") >= 8)
        stick.reset(enabled=True)
        stick.wait(lambda: "operation start 2" in stick.log and "create" in stick.log)
        stick.wait(pressed(stick, 0.004))
    assert engine.counters().faults == Fault(0)
    connection = engine.connection
    assert connection is not None and connection.status()["resets"] == 3 and connection.status()["connects"] == 1


def test_a_device_that_does_not_report_what_plays_is_left_alone(world: World) -> None:
    stick = world.plug(tells_playing=False)
    engine = world.start()
    stick.wait(lambda: stick.log.count("operation start 2") >= 12)
    connection = engine.connection
    assert connection is not None and connection.status()["resets"] == 0
    assert stick.log.count("create") == 2
    # Effects that another program may have changed are restored repeatedly, and the status reports it.
    stick.wait(lambda: min(stick.log.count(f"{what} {n}") for what in ("set_effect", "envelope") for n in (1, 2)) > 3)
    world.until(lambda: connection.status()["resets_seen"] is False)
    lasts = connection.status()["foreign_effect_s"]
    assert isinstance(lasts, float) and lasts > 0.0


def test_effects_with_other_numbers_after_a_reset(world: World) -> None:
    stick = world.plug()
    engine = world.start()
    stick.first_index = 5
    stick.reset()
    stick.wait(lambda: "operation start 6" in stick.log)
    world.hold(0.004)
    # The connection began again, which the servo may have seen as a fault: forces then stay off until they are set.
    world.until(lambda: engine.set_forces(True) > 0 and not engine.counters().faults and pressed(stick, 0.004)())


def test_a_set_up_that_hangs_does_not_keep_the_end_waiting(
    world: World, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connection_module, "STOP_TIMEOUT_S", 0.1)
    stick = world.plug()
    engine = world.start()
    assert engine.connection is not None
    asked, answers = threading.Event(), threading.Event()
    ask = stick.device.get_feature

    def hang(report_id: int, length: int) -> bytes:
        asked.set()
        assert answers.wait(60)
        return ask(report_id, length)

    monkeypatch.setattr(stick.device, "get_feature", hang)
    thread = engine.connection._thread
    assert thread is not None
    stick.reset()
    assert asked.wait(60)
    engine.stop()
    world.engine = None
    assert [record.message for record in caplog.records if "does not respond" in record.message] == [
        "the device does not respond to its set-up; it is left with a force of zero"
    ]
    # The thread's device stays open, and the thread no longer uses it when it returns.
    assert not stick.device.closed and thread.is_alive()
    answers.set()
    thread.join(60)
    assert not thread.is_alive() and not engine.connection._raw().connected


@pytest.mark.slow
def test_members_of_the_status(world: World) -> None:
    world.plug()
    engine = world.start()
    answer = Methods(engine).status()
    assert answer["device"] == "hid"
    link = answer["connection"]
    assert isinstance(link, dict)
    assert (link["name"], link["path"], link["state"], link["problem"]) == ("stick", "fake0", "connected", None)
    assert link["endpoint_hz"] == 500.0 and link["measured_hz"] > 0
    assert link["link_hz"] == min(500.0, link["measured_hz"])
    world.until(lambda: engine.connection is not None and engine.connection.status()["report_hz"] is not None)


def test_an_operator_is_for_the_simulation(world: World) -> None:
    world.plug()
    engine = world.start()
    with pytest.raises(MethodError) as caught:
        Methods(engine).call("set_operator", {"waypoints": [[0, 0, 0]]})
    assert caught.value.code == -32008
    assert "device.kind is hid" in str(caught.value)
    with pytest.raises(HapticdError):
        engine.set_operator(records(SAMPLE_DTYPE, 0), "linear")  # type: ignore[arg-type]


def test_no_device_at_the_start(world: World) -> None:
    with pytest.raises(DeviceError) as caught:
        world.start()
    assert str(caught.value) == "no HID device is connected"
    world.engine = None


def test_a_device_that_refuses_at_the_start_is_let_go(world: World) -> None:
    world.plug(load_says="error")
    with pytest.raises(DeviceError):
        world.start()
    assert world.opened[0].device.closed  # type: ignore[attr-defined]


@pytest.mark.parametrize("steady", [False, True])
def test_whether_a_device_reports_steadily_is_heard(
    world: World, steady: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    stick = world.plug()
    world.on_change = None
    if steady:  # two equal reports end the wait at once
        monkeypatch.setattr(connection_module, "FIRST_REPORTS_TIMEOUT_S", 60.0)
    done = threading.Event()

    def report() -> None:
        count = 0
        while not done.wait(0.005):
            count += 1
            stick.report(0, 0 if steady else count)

    thread = threading.Thread(target=report)
    thread.start()
    try:
        engine = world.start()
    finally:
        done.set()
        thread.join()
    assert engine.connection is not None and engine.connection._live is not None
    assert engine.connection._live.plan.on_change is not steady


def test_ticks_led_by_the_device(world: World) -> None:
    stick = world.plug()
    engine = world.start(clock="device")
    world.hold(0.004)
    world.until(lambda: engine.counters().ticks > 5)
    engine.set_forces(True)
    stick.wait(pressed(stick, 0.004))


def test_a_suspect_device_is_set_up_again_before_it_gets_a_force(world: World) -> None:
    """The state is that after a suspend of the machine."""
    stick = world.plug()
    engine = world.start()
    world.hold(0.004)
    engine.set_forces(True)
    stick.wait(pressed(stick, 0.004))
    with stick.changed:
        stick.log.clear()
        stick.effects.clear()
    assert engine.connection is not None
    engine.connection.suspect()
    stick.wait(lambda: "create" in stick.log)
    stick.wait(pressed(stick, 0.004))
    assert engine.connection.status()["resets"] == 1
    assert engine.counters().faults == Fault(0)
