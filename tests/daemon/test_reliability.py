"""Every fault of the table in docs/reliability.md: it is caused, reported by events and status, and cleared."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from time import monotonic_ns
from typing import Any, cast

import numpy as np
import pytest

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, Fault, Flag, records
from hapticd.base.errors import HapticdError
from hapticd.base.steps import finish
from hapticd.config.configuration import Config, load_config
from hapticd.config.modes import Mode
from hapticd.daemon import reload
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.refusal import MethodError
from hapticd.protocol.changes import Played, Revised
from hapticd.protocol.events import event_map
from tests.hid.test_connection import World

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reliability.md").read_text()
ROWS = {
    name: [cell.strip() for cell in row.strip("|").split(" | ")]
    for row, name in re.findall(r"^(\| <a id=\"([\w-]+)\">.*)$", PAGE, re.M)
}
"""The table's rows by their anchors."""
ANY = {"threshold": 1.0}
"""Threshold of overruns at which a busy machine does not disturb a test."""
PUSH = {"push": {"kind": "constant", "force_n": [0.0, 0.5]}}
ELSEWHERE = {
    # With a real process, in tests/integration/test_faults_live.py.
    "suspended",
    "clock-set",
    "stopped",
    "memory",
    # In tests/integration/test_recording.py and tests/recording/test_writer.py.
    "disk-full",
    # In test_hid_connection.py.
    "effects-forgotten",
    # In test_signs_live.py.
    "signs",
    "idle",
    # In tests/integration/test_lease.py.
    "client-killed",
}


def named(cell: str) -> set[str]:
    """Return the events that a cell names."""
    return set(re.findall(r"`([a-z_]+)`", cell))


class Watch:
    """An engine under test with all its samples and events."""

    def __init__(self, engine: Engine, beats: bool = True) -> None:
        self.engine, self.methods = engine, Methods(engine)
        self.beats = beats
        self.samples = records(SAMPLE_DTYPE, 0)
        self.events: list[dict[str, Any]] = []
        self._room, self._places = records(SAMPLE_DTYPE, 16384), records(EVENT_DTYPE, 8192)

    def read(self) -> None:
        if self.beats:
            self.engine.beat()
            self.engine.poll_servo()
        # Events of a tick are in their ring before its sample is in its own, and both before its faults are known.
        count, _ = self.engine.read_samples(self._room)
        self.samples = np.concatenate([self.samples, self._room[:count]])[-30_000:]
        count, _ = self.engine.read_events(self._places)
        self.events += [event_map(event, None) for event in self._places[:count]]

    def until(self, what: Callable[[], bool], timeout_s: float = 60.0) -> None:
        """Poll until a condition holds; the bound only keeps a broken test from hanging."""
        pause, deadline = threading.Event(), time.monotonic() + timeout_s
        while self.read() or not what():
            assert time.monotonic() < deadline, (self.events[-20:], self.engine.counters())
            pause.wait(0.002)

    def kinds(self) -> set[str]:
        return {str(event["event"]) for event in self.events}

    def status(self) -> dict[str, Any]:
        return self.methods.status()

    def faults(self) -> list[str]:
        return list(self.status()["faults"])

    def full(self) -> bool:
        flags = int(self.samples["flags"][-1]) if len(self.samples) else 0
        return flags & (Flag.FORCES_ON | Flag.RAMPING | Flag.FAULT) == Flag.FORCES_ON

    def forces_on(self) -> None:
        """Call set_forces, and return its result."""
        self.events.clear()
        self.methods.call("set_forces", {"enabled": True})
        self.until(self.full)
        assert self.faults() == []
        assert [event["faults"] for event in self.events if event["event"] == "fault"] == [[]]


def simulated(objects: Mapping[str, object] = PUSH, **sections: Any) -> Engine:
    servo = {"realtime": "off", "rate_hz": 1000, "overruns": ANY, **sections.pop("servo", {})}
    return Engine(load_config({"servo": servo, "scene": {"objects": dict(objects)}, **sections}))


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[World]:
    made = World(monkeypatch)
    yield made
    made.close()


def expect(row: list[str], watch: Watch, *, but: set[str] = frozenset()) -> None:  # type: ignore[assignment]
    """Check that events and status are those of the row."""
    quiet = {"contact", "release", "overrun", "saturation", "glitch"}
    assert watch.kinds() - quiet - but == named(row[3]) - quiet - but


def unplugged(row: list[str], world: World) -> None:
    world.plug()
    watch = Watch(world.start(overruns=ANY))
    world.hold(0.004)
    world.full(world.engine) if watch.methods.call("set_forces", {"enabled": True}) else None  # type: ignore[arg-type]
    watch.read()
    watch.events.clear()
    world.unplug()
    watch.until(lambda: watch.faults() == ["device"] and watch.status()["connection"]["state"] == "lost")
    watch.read()
    expect(row, watch)
    lost = int(next(event["tick"] for event in watch.events if event["event"] == "device_lost"))
    watch.until(lambda: int(watch.samples["tick"][-1]) > lost)
    assert not watch.samples["force_n"][watch.samples["tick"] >= lost].any()
    assert watch.status()["connection"]["problem"]
    with pytest.raises(MethodError, match="does not report"):
        watch.methods.call("set_forces", {"enabled": True})
    world.plug()
    watch.until(lambda: "device_found" in watch.kinds())
    assert watch.faults() == ["device"]
    watch.forces_on()


def silent(row: list[str], world: World) -> None:
    stick = world.plug()
    world.late_after_s = 1.0  # longer than the thread that reports may be delayed
    watch = Watch(world.start(overruns=ANY))
    world.hold(0.004)
    watch.methods.call("set_forces", {"enabled": True})
    watch.until(watch.full)
    watch.events.clear()
    world.stick = None  # it is connected, and no longer reports
    watch.until(lambda: watch.faults() == ["device"])
    watch.read()
    expect(row, watch)
    watch.until(lambda: not watch.samples["force_n"][-1].any())
    assert watch.status()["connection"]["state"] == "connected"
    with pytest.raises(MethodError, match="does not report"):
        watch.methods.call("set_forces", {"enabled": True})
    world.stick = stick
    watch.until(lambda: "device_found" in watch.kinds())
    watch.forces_on()


def late(row: list[str], _: World) -> None:
    """Reports come 0.09 s apart, and are 0.09 s old."""
    engine = simulated(device={"sim": {"report_interval_s": 0.09, "report_delay_s": 0.09}})
    engine.start()
    try:
        watch = Watch(engine)
        watch.until(lambda: engine.counters().ticks > 500)
        expect(row, watch)
        repeated = (watch.samples["flags"] & Flag.REPEATED) != 0
        # A tick that was late may have missed some.
        elapsed_s = (int(watch.samples["time_ns"][-1]) - int(watch.samples["time_ns"][0])) * 1e-9
        assert 1 <= np.count_nonzero(~repeated[1:]) <= elapsed_s / 0.09 + 1
        assert not np.any(
            watch.samples["position_m"][1:][repeated[1:]] != watch.samples["position_m"][:-1][repeated[1:]]
        )
        assert watch.faults() == []
    finally:
        engine.stop()


def frozen(row: list[str], _: World) -> None:
    """Dry friction that is stronger than the push holds the handle where it is."""
    device = {"frozen_after_s": 0.2, "max_force_n": 4.0, "sim": {"coulomb_friction_n": 2.0}}
    engine = simulated(device=device)
    engine.start()
    try:
        watch = Watch(engine)
        watch.until(lambda: watch.faults() == ["frozen"])
        watch.read()
        expect(row, watch)
        watch.until(lambda: bool(watch.samples["flags"][-1] & Flag.FAULT))
        faulted = watch.samples[(watch.samples["flags"] & Flag.FAULT) != 0]
        assert not faulted["force_n"].any()
        # Under less than a tenth of the largest force it may rest.
        watch.methods.call("update_scene", {"objects": {"push": {"force_n": [0.0, 0.3]}}, "wait": True})
        watch.forces_on()
        start = watch.engine.counters().ticks
        watch.until(lambda: watch.engine.counters().ticks > start + 400)
        assert watch.faults() == []
    finally:
        engine.stop()


def stalled(row: list[str], _: World) -> None:
    engine = simulated()
    engine.start()
    try:
        watch = Watch(engine, beats=False)
        watch.until(lambda: engine.counters().faults == Fault.CONTROL)
        watch.read()
        expect(row, watch)
        watch.beats = True
        assert watch.faults() == ["control"]
        watch.forces_on()
    finally:
        engine.stop()


def lapsed(row: list[str], _: World) -> None:
    engine = simulated()
    engine.start()
    try:
        watch = Watch(engine)
        watch.methods.call("lease", {"duration_s": 0.2})
        watch.until(lambda: watch.faults() == ["lease"])
        watch.read()
        expect(row, watch)
        assert watch.status()["lease_s"] is None
        watch.forces_on()
    finally:
        engine.stop()


def heavy(count: int) -> dict[str, object]:
    """Floors one below the other, all touched by the probe: as many contacts in each tick."""
    floor = {"kind": "wall", "normal": [0, 1], "material": "soft"}
    return {f"f{i}": {**floor, "point_m": [0, 0.001 + 1e-6 * i]} for i in range(count)}


def overloaded(action: str, objects: Mapping[str, object], threshold: float = 0.3) -> Engine:
    return simulated(
        objects,
        servo={"rate_hz": 10_000, "overruns": {"threshold": threshold, "action": action}},
        materials={"soft": {"stiffness_n_per_m": 0.01}},
    )


HEAVY = 8000
"""Number of contacts that no machine computes in 0.1 ms."""


def missed(row: list[str], _: World) -> None:
    engine = overloaded("warn", heavy(HEAVY), threshold=1.0)
    engine.start()
    try:
        watch = Watch(engine)
        watch.until(lambda: "overrun" in watch.kinds())
        assert named(row[3]) == {"overrun"}
        counters = watch.status()["counters"]
        assert counters["skipped"] >= counters["overruns"] > 0
    finally:
        engine.stop()


def too_many(row: list[str], _: World) -> None:
    engine = overloaded("warn", heavy(HEAVY))
    engine.start()
    try:
        watch = Watch(engine)
        watch.until(lambda: engine.counters().overloads > 0)
        watch.until(lambda: "overload" in watch.kinds())
        expect(row, watch)
        status = watch.status()
        assert status["overruns"]["missed_share"] > 0.3
        assert (status["forces"], status["rate_hz"]) == ("on", 10_000)
    finally:
        engine.stop()


def too_many_is_a_fault(row: list[str], _: World) -> None:
    engine = overloaded("fault", heavy(HEAVY))
    engine.start()
    try:
        watch = Watch(engine)
        watch.until(lambda: watch.faults() == ["overrun"])
        watch.read()
        expect(row, watch)
        watch.methods.call("set_scene", {"scene": {"objects": {}}, "wait": True})
        watch.events.clear()
        watch.methods.call("set_forces", {"enabled": True})
        # A busy machine may miss too many periods again.
        watch.until(lambda: any({"event": "fault", "faults": []}.items() <= event.items() for event in watch.events))
    finally:
        engine.stop()


def steps_down(row: list[str], _: World) -> None:
    opened = {
        "skin": {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.1, "material": "cellophane"}
    }
    engine = overloaded("step_down", {**heavy(HEAVY), **opened, **PUSH})
    engine.start()
    try:
        watch = Watch(engine)
        watch.until(lambda: "rate" in watch.kinds())
        # Half the rate may be too high, too: the servo steps down again until it keeps up, or to the lowest rate.
        watch.methods.call("update_scene", {"objects": dict.fromkeys(heavy(HEAVY)), "wait": True})
        watch.until(lambda: bool(watch.status()["faults"]) or watch.full())
        expect(row, watch, but=set() if watch.faults() == [] else {"fault"})
        watch.read()  # the samples of these events, too
        rates = [event["rate_hz"] for event in watch.events if event["event"] == "rate"]
        assert rates == [10_000 / 2 ** (n + 1) for n in range(len(rates))]
        # Each step is reported as a revision, so that a recording has the rate of every tick.
        changes = [change for change in engine.read_changes() if isinstance(change, Revised)]
        assert [change.rate_hz for change in changes if change.rate_hz is not None] == rates
        revisions = [change.revision for change in changes]
        assert revisions == list(range(revisions[0], engine.revision + 1))
        status = watch.status()
        assert (status["rate_hz"], status["overruns"]["configured_rate_hz"]) == (rates[-1], 10_000)
        ticks = watch.samples["tick"].astype(np.int64)
        assert np.all(np.diff(ticks) == 1)
        assert np.all(np.diff(watch.samples["time_ns"]) > 0)
        for event in watch.events:
            if event["event"] != "rate":
                continue
            at = int(np.flatnonzero(ticks == event["tick"])[0])
            ramp_ticks = 0.02 * event["rate_hz"]
            before, first = (abs(watch.samples["force_n"][place, 1]) for place in (at - 1, at))
            assert before == 0.0
            assert first <= 10.0 / ramp_ticks
    finally:
        engine.stop()


SCENARIOS: dict[str, Callable[[list[str], World], None]] = {
    "unplugged": unplugged,
    "silent": silent,
    "frozen": frozen,
    "late": late,
    "missed": missed,
    "too-many": too_many,
    "too-many-fault": too_many_is_a_fault,
    "too-many-step-down": steps_down,
    "stalled": stalled,
    "lapsed": lapsed,
}


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_row(name: str, world: World) -> None:
    SCENARIOS[name](ROWS[name], world)


def test_every_row_has_its_test() -> None:
    assert ROWS.keys() == SCENARIOS.keys() | ELSEWHERE


@pytest.mark.slow
def test_no_step_down_to_a_rate_that_no_signal_of_the_scene_has() -> None:
    """A texture whose mean lies above half of half the rate."""
    texture = {"kind": "stochastic", "peak_hz": 2550, "mean_hz": 2600, "velocity_gain_per_s": 1}
    materials = {
        "soft": {"stiffness_n_per_m": 0.01},
        "hiss": {"stiffness_n_per_m": 100, "texture": texture},
    }
    objects = {
        **heavy(HEAVY),
        "away": {"kind": "disc", "center_m": [0.05, 0.05], "radius_m": 0.001, "material": "hiss"},
    }
    servo = {"rate_hz": 10_000, "overruns": {"threshold": 0.3, "action": "step_down"}}
    engine = simulated(objects, servo=servo, materials=materials)
    engine.start()
    try:
        watch = Watch(engine)
        watch.until(lambda: engine.counters().faults == Fault.OVERRUN)
        watch.methods.call("update_scene", {"objects": dict.fromkeys(heavy(HEAVY)), "wait": True})
        watch.read()
        assert "rate" not in watch.kinds()
        assert {change.rate_hz for change in engine.read_changes() if isinstance(change, Revised)} == {None}
        assert watch.status()["rate_hz"] == 10_000
        watch.until(lambda: engine.counters().running)  # the servo may have stepped down again
        with pytest.raises(MethodError, match="missed too many periods"):
            watch.methods.call("play", {"material": "wood", "direction": [0, 1], "amplitude_m_per_s2": 1})
        watch.methods.call("set_forces", {"enabled": True})
        watch.until(lambda: watch.full() or watch.faults() == ["overrun"])
    finally:
        engine.stop()


@pytest.mark.slow
def test_a_command_is_not_in_vain_while_the_servo_steps_down() -> None:
    """The thread that waits for the servo is the one that restarts it."""
    engine = overloaded("step_down", heavy(HEAVY))
    engine.start()
    try:
        watch = Watch(engine)
        ended = threading.Event()
        while engine.counters().running:
            engine.beat()
            ended.wait(0.002)
        watch.methods.call("set_forces", {"enabled": True})
        assert engine.rate_hz == 5000
        changed = watch.methods.call("update_scene", {"objects": dict.fromkeys(heavy(HEAVY)), "wait": True})
        assert engine.counters().revision >= int(str(changed["revision"]))
    finally:
        engine.stop()


@pytest.mark.slow
def test_a_play_under_way_is_struck_at_the_rate_that_the_servo_goes_on_at() -> None:
    """Sent when the servo had ended, for 10 kHz. The sign of what rings is that of the sine at the samples' times.

    The first tick after that has no force yet, and strikes nothing: the mode is struck again.
    """
    engine = overloaded("step_down", heavy(HEAVY))
    engine.start()
    try:
        ended = threading.Event()
        while engine.counters().running:
            engine.beat()
            ended.wait(0.002)
        tick, _ = engine.play(Mode(1.0, 100 * math.pi), "coefficient", (1.0, 0.0), 1.0)
        assert engine.rate_hz == 5000
        assert [change.tick for change in engine.read_changes() if isinstance(change, Played)][-1] == tick
        room = np.empty(16384, SAMPLE_DTYPE)
        found: list[tuple[float, float]] = []
        struck_ns = None
        while len(found) < 50 and engine.counters().running:
            engine.beat()
            count, _ = engine.read_samples(room)
            for sample in room[:count]:
                if sample["tick"] == tick:
                    struck_ns = int(sample["time_ns"])
                if struck_ns is not None:
                    found.append((1e-9 * (int(sample["time_ns"]) - struck_ns), float(sample["vibration_force_n"][0])))
            ended.wait(0.002)
    finally:
        engine.stop()
    # Within the first second, which knows only this rate, and clear of the zeros.
    compared = [(math.sin(100 * math.pi * s), n) for s, n in found[:50] if abs(math.sin(100 * math.pi * s)) > 0.2]
    assert len(compared) > 10
    assert all(sine * force > 0 for sine, force in compared if force != 0), compared
    assert sum(force != 0 for _, force in compared) > 10


@pytest.mark.slow
def test_memory_stays_locked_when_it_steps_down() -> None:
    overruns = {"threshold": 0.3, "action": "step_down"}
    engine = simulated(
        heavy(HEAVY),
        servo={"rate_hz": 10_000, "realtime": "preferred", "overruns": overruns},
        materials={"soft": {"stiffness_n_per_m": 0.01}},
    )
    before = engine.start()
    try:
        Watch(engine).until(lambda: engine.rate_hz < 10_000)
        assert engine.granted is not None
        assert engine.granted.memory == before.memory
        grants = (before, engine.granted)
        locked = [[line for line in each.missing if line.startswith("locked memory")] for each in grants]
        assert locked[0] == locked[1]
    finally:
        engine.stop()


def test_a_reload_pauses_while_files_are_read() -> None:
    engine, read = simulated(), threading.Event()

    def load() -> tuple[Config, str]:
        assert read.wait(15.0)
        return engine.config, ""

    steps = Methods(engine, load).change("reload", {})
    for _ in range(5):
        next(steps)
    read.set()
    assert cast(dict[str, object], finish(steps))["revision"] == engine.revision


def test_a_reload_that_the_servo_refuses_names_the_files_once(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = simulated()

    def refuse(*_: object) -> int:
        raise HapticdError("the scene cannot be rendered: no memory")

    monkeypatch.setattr(engine, "take", refuse)
    with pytest.raises(MethodError) as caught:
        Methods(engine, lambda: (engine.config, "/etc/a.yaml")).call("reload", {})
    assert str(caught.value) == "/etc/a.yaml: the scene cannot be rendered: no memory"


def test_files_that_are_never_read_hold_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    engine, over = simulated(), threading.Event()

    def load() -> tuple[Config, str]:
        over.wait()
        return engine.config, ""

    monkeypatch.setattr(reload, "CONFIG_LOAD_TIMEOUT_S", 0.0)
    with pytest.raises(MethodError, match="were not read within 0 s"):
        Methods(engine, load).call("reload", {})
    over.set()


@pytest.mark.parametrize("unit", ["hapticd.service", "hapticd.user.service"])
def test_no_unit_gives_up_before_a_reload_does(unit: str) -> None:
    limits = dict(re.findall(r"^(TimeoutStopSec|WatchdogSec)=(\d+)$", (ROOT / "systemd" / unit).read_text(), re.M))
    assert len(limits) == 2 and all(int(limit) > reload.CONFIG_LOAD_TIMEOUT_S for limit in limits.values())


@pytest.mark.slow
def test_stepping_down_keeps_what_is_open_and_who_is_who() -> None:
    """At half the rate a punctured membrane is still open, and events still have its id."""
    skin = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.1, "material": "cellophane"}
    engine = overloaded("step_down", {"skin": skin}, threshold=0.5)
    engine.start()
    try:
        watch = Watch(engine)
        # Again and again: a skin that is met in a stall is not felt.
        strokes = [[0.4 * n + t_s, 0, y_m] for n in range(50) for t_s, y_m in ((0.0, 0.01), (0.3, -0.02))]
        watch.methods.call("set_operator", {"waypoints": strokes})
        watch.until(lambda: "puncture" in watch.kinds())
        slot = engine._compiler.slot_of("skin")
        watch.methods.call("set_operator", {"waypoints": [[0, 0, -0.02]]})  # stays down, in all of the floors to come
        watch.methods.call("update_scene", {"objects": heavy(HEAVY), "wait": False})
        watch.until(lambda: "rate" in watch.kinds())
        watch.methods.call("update_scene", {"objects": dict.fromkeys(heavy(HEAVY)), "wait": True})
        assert engine._compiler.slot_of("skin") == slot
        watch.until(lambda: bool(watch.faults()) or watch.full())
        watch.events.clear()
        watch.methods.call("set_forces", {"enabled": True})
        hand = watch.methods.call("set_operator", {"waypoints": [[0, 0, 0.01], [0.2, 0, -0.02]]})
        over_ns = monotonic_ns() + int(float(str(hand["duration_s"])) * 1e9) + 300_000_000
        watch.until(lambda: monotonic_ns() > over_ns)
        assert "contact" not in watch.kinds()
        watch.methods.call("reset", {})
        taps = [[0.4 * n + t_s, 0, y_m] for n in range(50) for t_s, y_m in ((0.0, 0.01), (0.2, -0.001))]
        watch.methods.call("set_operator", {"waypoints": taps})
        watch.until(lambda: "contact" in watch.kinds())
    finally:
        engine.stop()
