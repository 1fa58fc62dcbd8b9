"""Marks and ends of gestures in the core: none is lost, and each has the exact tick."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import numpy as np
import pytest

from hapticd.base.core import EVENT_DTYPE, MAX_PENDING_MARKS, CommandKind, EventKind, Status, ffi, lib, records
from hapticd.config.configuration import Config, default_config
from hapticd.daemon.command_ring import RingFullError
from hapticd.daemon.engine import Engine
from hapticd.protocol.marks import Mark
from hapticd.rendering.joystick import new_operator
from hapticd.rendering.offline import simulate_run


def silent_config() -> Config:
    return Config.model_validate(
        {
            "servo": {"realtime": "off", "overruns": {"action": "warn"}},
            "device": default_config().device.to_dict(),
            "scene": {"objects": {}},
        }
    )


@pytest.fixture
def engine() -> Iterator[Engine]:
    """A servo whose events are not read."""
    engine = Engine(silent_config())
    engine.start()
    yield engine
    engine.stop()
    gc.collect()


def read_events(engine: Engine) -> tuple[list[np.void], int]:
    room = records(EVENT_DTYPE, 1024)
    found: list[np.void] = []
    while True:
        count, dropped = engine.read_events(room)
        if count == 0:
            return found, dropped
        found += list(room[:count].copy())


def flood(engine: Engine, path: object) -> None:
    """More ends of gestures than the ring of events holds, without a reader."""
    command = ffi.new("struct hd_command *")
    command.kind, command.revision, command.path = CommandKind.OPERATOR, engine.revision, path
    batch = ffi.new("struct hd_command[]", [command[0]] * 1000)
    sequence, tick = ffi.new("uint64_t *"), ffi.new("uint64_t *")
    for _ in range(9):
        assert lib.hd_servo_send(engine._servo, batch, 1000, sequence) == Status.OK
        assert lib.hd_servo_wait_command(engine._servo, sequence[0], 60 * 10**9, tick) == Status.OK
        engine.beat()


@pytest.mark.long
def test_no_mark_is_lost_where_other_events_are(engine: Engine) -> None:
    path = new_operator([[1000.0, 0.0, 0.0]], "linear")
    flood(engine, path)
    ticks = [engine.mark(Mark(f"mark {number}", number)) for number in range(MAX_PENDING_MARKS)]
    events, dropped = read_events(engine)
    assert dropped > 0
    marks = [event for event in events if event["kind"] == EventKind.MARK]
    assert [int(event["tick"]) for event in marks] == ticks
    read = [engine.take_mark(int(event["code"])) for event in marks]
    assert read == [Mark(f"mark {number}", number) for number in range(MAX_PENDING_MARKS)]


def test_marks_under_way_are_bounded_until_their_events_are_read(engine: Engine) -> None:
    for number in range(MAX_PENDING_MARKS):
        engine.mark(Mark(str(number), None))
    with pytest.raises(RingFullError, match=f"{MAX_PENDING_MARKS} marks are under way"):
        engine.mark(Mark("one more", None))
    events, _ = read_events(engine)
    for event in events:
        if event["kind"] == EventKind.MARK:
            engine.take_mark(int(event["code"]))
    engine.mark(Mark("one more", None))


def test_a_mark_that_the_command_ring_refuses_leaves_nothing(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:

        def full(commands: object) -> int:
            raise RingFullError("full")

        patch.setattr(engine._ring, "send", full)
        for _ in range(2 * MAX_PENDING_MARKS):
            with pytest.raises(RingFullError, match="full"):
                engine.mark(Mark("refused", None))
    engine.mark(Mark("taken", None))
    events, _ = read_events(engine)
    (mark,) = [event for event in events if event["kind"] == EventKind.MARK]
    assert engine.take_mark(int(mark["code"])).text == "taken"


# ---- Ends of gestures ----------------------------------------------------------------------------------------------


def ends(waypoints: list[list[float]], duration_s: float, rate_hz: float = 10_000.0) -> list[tuple[int, int, int]]:
    run = simulate_run({"scene": {"objects": {}}}, waypoints, duration_s, rate_hz)
    found = run.events[run.events["kind"] == EventKind.GESTURE_END]
    assert (found["time_ns"] == np.rint(1e9 * found["tick"] / rate_hz)).all()
    return [(int(event["tick"]), int(event["value"]), int(event["code"])) for event in found]


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0, 3000.0])
@pytest.mark.parametrize("end_s", [0.01, 0.123, 0.0123456, 0.05])
def test_a_simulated_gesture_ends_at_the_first_tick_at_or_after_its_last_waypoint(end_s: float, rate_hz: float) -> None:
    tick = int(np.ceil(round(end_s * rate_hz, 6)))
    assert ends([[0.0, 0.0, 0.02], [end_s, 0.01, 0.02]], 0.2, rate_hz) == [(tick, 0, 1)]


def test_one_waypoint_ends_where_it_begins() -> None:
    assert ends([[0.0, 0.0, 0.02]], 0.01) == [(0, 0, 1)]


def test_a_gesture_that_outlasts_the_run_has_no_end() -> None:
    assert ends([[0.0, 0.0, 0.02], [0.1, 0.01, 0.02]], 0.1) == []
    assert ends([[0.0, 0.0, 0.02], [0.1, 0.01, 0.02]], 0.1001) == [(1000, 0, 1)]


def test_the_parts_of_a_run_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A long run is rendered in parts; the end of the gesture is reported only in one of them."""
    waypoints = [[0.0, 0.0, 0.02], [7.0, 0.01, 0.02]]
    assert ends(waypoints, 8.0, 10_000.0) == [(70_000, 0, 1)]
