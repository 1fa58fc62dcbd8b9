"""SIGKILL at any moment, under load: what `hapticd stop-device` does leaves the joystick at zero, and nothing that was
left behind stops the next daemon."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zmq

from hapticd.config.hid import Hid
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.stopper import stop_device
from tests.support.daemon_process import Wire
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid
from tests.support.killed_daemon import INDICES

KILLS = int(os.environ.get("KILLS", "10"))
"""A kill takes two or three seconds of a processor: docs/service.md speaks of a run with 100."""
CONFIG = """
device: {kind: hid, hid: {signs: trust}}
servo: {rate_hz: 10000}
materials: {soft: {stiffness_n_per_m: 200}}
scene:
  objects:
    floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: soft}
    push: {kind: constant, force_n: [1.5, 0.7]}
"""


class Nursery:
    """Where daemons come from, one after the other, on one runtime directory and one joystick."""

    def __init__(self, directory: Path, stick: FakePid) -> None:
        self.runtime = directory / "run"
        (directory / "c.yaml").write_text(CONFIG)
        fd = stick.ours.fileno()
        with open(directory / "log", "wb") as log:
            self.process = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "tests.support.killed_daemon",
                    str(fd),
                    str(self.runtime),
                    str(directory / "c.yaml"),
                ],
                pass_fds=[fd],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        self.log = directory / "log"
        self.last: int | None = None

    def daemon(self) -> int:
        """A new one's process id."""
        assert self.process.stdin is not None
        self.process.stdin.write("next\n")
        self.process.stdin.flush()
        self.last = self.heard()
        return self.last

    def ended(self) -> int:
        """The exit code of the last one, once it has ended."""
        code = self.heard()
        self.last = None
        return code

    def heard(self) -> int:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.log.read_text()
        return int(line)

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        if self.last is not None:
            os.kill(self.last, signal.SIGKILL)
        assert self.process.wait(30) == 0
        self.process.stdout.close()


@contextmanager
def load(runtime: Path) -> Iterator[Wire]:
    """Scene updates one after the other, from a client that nobody waits for."""
    wire, stop = Wire(runtime), threading.Event()
    wire.socket.RCVTIMEO = 50

    def work() -> None:
        x = 0
        while not stop.is_set():
            x = (x + 1) % 100
            block = {"kind": "box", "center_m": [x * 1e-3, 0.03], "size_m": [0.01, 0.01], "material": "soft"}
            try:
                wire.call("update_scene", objects={"block": block})
            except zmq.Again:  # it was killed
                return

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield wire
    finally:
        stop.set()
        thread.join()
        wire.close()


def push(wire: Wire, stick: FakePid) -> None:
    """Forces on, until there is one: a hand of ours that is held up for 0.1 s is a device that does not report."""
    deadline = time.monotonic() + 60
    pause = threading.Event()
    while stick.force() == (0.0, 0.0):
        assert time.monotonic() < deadline, wire.result("get_status")["faults"]
        if wire.result("get_status")["forces"] != "on":
            wire.call("set_forces", enabled=True)
        pause.wait(0.02)


def set_up(stick: FakePid) -> None:
    """The joystick's effects, as a daemon's set-up leaves them."""
    PidDriver(stick.layout, Hid()).set_up(stick.device)
    assert tuple(stick.effects) == INDICES


def stopped(stick: FakePid, record: Path) -> str | None:
    """What `hapticd stop-device` does; the joystick is at rest then, whatever it was before."""
    said = stop_device(record, open_node=lambda record: os.dup(stick.ours.fileno()))
    if said is not None:
        stick.wait(lambda: not stick.effects and not stick.enabled)
    return said


@contextmanager
def moved() -> Iterator[tuple[Nursery, FakePid]]:
    """Where daemons come from, and their joystick, which a hand moves."""
    stick = FakePid(bytes(Joystick()), on_log=lambda _: None)
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as parent:
        nursery = Nursery(Path(parent), stick)
        over = threading.Event()

        def move() -> None:
            y = 0
            while not over.wait(0.002):
                y = (y + 37) % 2000
                stick.report(0, 1000 + y)

        hand = threading.Thread(target=move)
        hand.start()
        try:
            yield nursery, stick
        finally:
            over.set()
            hand.join()
            nursery.close()
            stick.close()


@pytest.mark.slow
def test_killed_at_random_moments_under_load() -> None:
    dice, pushed = random.Random(20), 0
    with moved() as (nursery, stick):
        record = nursery.runtime / "hapticd.device"
        for _ in range(KILLS):
            stick.log.clear()
            set_up(stick)
            pid = nursery.daemon()
            wire = Wire(nursery.runtime)
            # A socket that was left behind answers nobody: the connection is made when the daemon binds anew.
            wire.result("get_status")
            push(wire, stick)
            wire.close()
            with load(nursery.runtime):
                reports = len(stick.log) + dice.randrange(60)
                stick.wait(lambda reports=reports: len(stick.log) >= reports)  # type: ignore[misc]
                os.kill(pid, signal.SIGKILL)
                assert nursery.ended() == -signal.SIGKILL
            pushed += stick.force() != (0.0, 0.0)
            assert (nursery.runtime / "hapticd.command").exists()
            said = stopped(stick, record)
            assert said is not None and "force zero" in said and "refused" not in said
            assert stick.force() == (0.0, 0.0)
            assert not record.exists()
            assert not any("unknown" in line for line in stick.log)
    assert 2 * pushed > KILLS


@pytest.mark.long
def test_killed_in_the_first_moments() -> None:
    """At the first reports that a daemon sends: either nothing was let through, or a record stops it. And the next one
    finds what was left and ends in good order, without a record."""
    stick = FakePid(bytes(Joystick()))
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as parent:
        nursery = Nursery(Path(parent), stick)
        record = nursery.runtime / "hapticd.device"
        try:
            for reports in (0, 1, 2, 3, 5):
                set_up(stick)
                stick.log.clear()
                pid = nursery.daemon()
                stick.wait(lambda reports=reports: len(stick.log) >= reports)  # type: ignore[misc]
                os.kill(pid, signal.SIGKILL)
                assert nursery.ended() == -signal.SIGKILL
                assert record.exists() or not reports
                stopped(stick, record)
                assert stick.force() == (0.0, 0.0)
            set_up(stick)
            pid = nursery.daemon()
            wire = Wire(nursery.runtime)
            assert wire.result("get_status")["state"] == "running"
            wire.close()
            assert record.exists()
            os.kill(pid, signal.SIGTERM)
            assert nursery.ended() == 0
            assert not record.exists()
            stick.wait(lambda: not stick.effects and not stick.enabled)
        finally:
            nursery.close()
            stick.close()


@pytest.mark.long
@pytest.mark.parametrize("fault", [signal.SIGABRT, signal.SIGSEGV])
def test_a_fault_of_the_process_stops_the_joystick_before_it_ends(fault: signal.Signals) -> None:
    with moved() as (nursery, stick):
        set_up(stick)
        pid = nursery.daemon()
        wire = Wire(nursery.runtime)
        wire.result("get_status")
        push(wire, stick)
        wire.close()
        os.kill(pid, fault)
        assert nursery.ended() == -fault
        stick.wait(lambda: not stick.effects and not stick.enabled)
        assert stick.force() == (0.0, 0.0)
