"""The servo's life, without sockets: stopping, and a device that reports rarely."""

from __future__ import annotations

import ctypes
import gc
import os
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE, CommandKind, Fault, ffi, lib, records
from hapticd.config.configuration import load_config
from hapticd.daemon.engine import Engine

PUSH = {"objects": {"push": {"kind": "constant", "force_n": [0.0, 0.5]}}}


def engine(**sim: float) -> Engine:
    return Engine(load_config({"servo": {"realtime": "off", "rate_hz": 1000}, "device": {"sim": sim}, "scene": PUSH}))


def test_stop_ends_although_forces_are_still_commanded_on() -> None:
    """Commands that the servo takes after it was told to stop do not keep it going."""
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


@pytest.fixture
def freed_memory_is_overwritten() -> Iterator[None]:
    """Where the C library can do it: who uses what is freed does not get away with it."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", lambda *_: None)
    perturb = -6
    mallopt(perturb, 0x55)
    yield
    mallopt(perturb, 0)


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
