"""Start and stop of the servo without sockets, and a device that reports rarely."""

from __future__ import annotations

import ctypes
import gc
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE, CommandKind, Fault, Flag, StreamKind, ffi, lib, records
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import load_config
from hapticd.daemon.engine import Engine
from hapticd.recording.replay import replay
from hapticd.recording.writer import RecordingWriter

PUSH = {"objects": {"push": {"kind": "constant", "force_n": [0.0, 0.5]}}}


def engine(**sim: float) -> Engine:
    return Engine(load_config({"servo": {"realtime": "off", "rate_hz": 1000}, "device": {"sim": sim}, "scene": PUSH}))


def test_stop_ends_although_forces_are_still_commanded_on() -> None:
    """Commands that come after the request to stop do not keep the servo running."""
    for _ in range(10):
        servo = engine()
        servo.start()
        on = ffi.new("struct hd_command[1]")
        on[0].kind = CommandKind.FORCES
        on[0].value = 1
        sequence = ffi.new("uint64_t *")
        for _ in range(100):
            assert lib.hd_servo_send(servo._servo, on, 1, sequence) == 0
        servo.stop()
        assert not servo.counters().running


def test_last_sample_after_a_stop_has_no_force() -> None:
    servo = engine()
    servo.start()
    servo.set_forces(True)
    servo.stop()
    room = records(SAMPLE_DTYPE, 16384)
    count, dropped = servo.read_samples(room)
    assert count > 0
    assert dropped == 0
    assert not np.any(room["force_n"][count - 1])


def test_device_that_reports_as_rarely_as_it_says_is_not_lost() -> None:
    servo = engine(report_interval_s=0.1, report_delay_s=0.1)
    servo.start()
    try:
        pause = threading.Event()
        while servo.counters().ticks < 600:
            servo.beat()
            pause.wait(0.02)
        assert servo.counters().faults == Fault(0)
    finally:
        servo.stop()


class Drained:
    """A running engine and all its samples."""

    def __init__(self, servo: Engine) -> None:
        self.servo = servo
        self.room = records(SAMPLE_DTYPE, 16384)
        self.parts: list[np.ndarray] = []

    def until(self, condition: Callable[[], bool]) -> None:
        pause, until_s = threading.Event(), time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < until_s
            self.servo.beat()
            count, _ = self.servo.read_samples(self.room)
            self.parts.append(self.room[:count].copy())
            pause.wait(0.001)

    def ticks(self, more: int) -> None:
        last = self.servo.counters().ticks + more
        self.until(lambda: self.servo.counters().ticks >= last)

    def samples(self) -> np.ndarray:
        return np.concatenate(self.parts)


@pytest.mark.slow
def test_streams_are_followed_until_none_comes(tmp_path: Path) -> None:
    """The hand follows the targets and stays, the force begins and ends; ticks without a stream can be replayed."""
    config = load_config({"servo": {"realtime": "off", "rate_hz": 1000, "stream_timeout_s": 0.03}, "scene": PUSH})
    servo = Engine(config)
    run = Drained(servo)
    servo.start()
    try:
        run.ticks(50)
        for seq in range(1, 41):
            servo.stream(StreamKind.TARGET, seq, 0.0002 * seq, -0.0001 * seq)
            servo.stream(StreamKind.FORCE, 10 * seq, 0.2, 0.0)
            run.ticks(2)
        force, target = (servo.stream_counters(kind) for kind in (StreamKind.FORCE, StreamKind.TARGET))
        assert force.used + force.superseded == target.used + target.superseded == 40
        assert (force.seq, target.seq) == (400, 40) and 50 < target.tick < servo.counters().ticks
        run.until(lambda: not any(servo.stream_counters(kind).active for kind in StreamKind))
        run.ticks(200)
        assert all(servo.stream_counters(kind).timeouts >= 1 for kind in StreamKind)
    finally:
        servo.stop()
    samples = run.samples()
    streamed = samples["flags"] & Flag.STREAMED != 0
    assert samples["contact_force_n"][streamed, 0].max() == pytest.approx(0.2)
    assert samples["force_n"][-1].tolist() == [0.0, 0.5] and not streamed[-1]
    # The grip holds the handle against the field.
    assert samples["position_m"][-1] == pytest.approx(
        [0.008, -0.004 + 0.5 / config.device.sim.hand.stiffness_n_per_m], abs=3e-4
    )
    with RecordingWriter(tmp_path / "run.npz") as writer:
        texts = {"servo": config.servo.to_dict(), "device": config.device.to_dict()}
        writer.begin(
            {
                "config": texts,
                "scene": config.scene.to_dict(),
                "materials": {"wood": {"stiffness_n_per_m": 800}},
                "status": {"rate_hz": 1000.0},
            }
        )
        writer.write_change({"revision": 1})
        writer.write(samples)
        writer.finish()
    again = replay(tmp_path / "run.npz")
    assert again.left_out["streamed"] == streamed.sum()
    assert again.identical == len(again.samples) > 100


@pytest.mark.parametrize(("kind", "x", "name"), [("FORCE", float("nan"), "force_n"), ("TARGET", 1e4, "position_m")])
def test_what_cannot_be_followed_is_refused(kind: str, x: float, name: str) -> None:
    with pytest.raises(HapticdError, match=name):
        engine().stream(StreamKind[kind], 1, x, 0.0)


@pytest.fixture
def freed_memory_is_overwritten() -> Iterator[None]:
    """Where the C library can do it: who uses what is freed does not get away with it."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", lambda *_: None)
    perturb = -6
    mallopt(perturb, 0x55)
    yield
    mallopt(perturb, 0)


@pytest.mark.long
@pytest.mark.usefixtures("freed_memory_is_overwritten")
def test_engine_that_is_dropped_without_a_stop_ends_its_thread() -> None:
    """The collector of garbage frees the simulation and the hand's path before the servo: its thread uses both until it
    has ended."""

    def threads() -> set[str]:
        return set(os.listdir("/proc/self/task"))

    before = threads()
    servo = engine()
    servo.start()
    begun = threads() - before
    assert begun
    servo.set_operator(np.array([[0.01 * step, 0.001 * step, 0.0] for step in range(10)]), "linear")
    del servo
    gc.collect()
    # A joined thread may stay in /proc for a moment.
    pause = threading.Event()
    for _ in range(6000):
        if not begun & threads():
            return
        pause.wait(0.01)
    raise AssertionError("the servo's thread goes on")
