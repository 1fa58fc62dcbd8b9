"""The process in which a daemon has filters designed: killed, and when the daemon ends."""

from __future__ import annotations

import os
import random
import signal
from pathlib import Path

import msgpack
import pytest

from hapticd.protocol.messages import Code
from tests.soak import attackers
from tests.support.daemon_process import PATIENCE_S, Daemon, Wire, running_daemon, until, wired

pytestmark = pytest.mark.slow

CHANGE = 99


def children(process: int) -> list[int]:
    """Those of all its threads."""
    found = Path(f"/proc/{process}/task").glob("*/children")
    return [int(child) for each in found for child in each.read_text().split()]


def begin(wire: Wire) -> None:
    """Asks for what takes seconds; the answer comes later."""
    noise = attackers.noise(random.Random(31), 400)
    params = {"materials": {"noise": noise}}
    message = {"jsonrpc": "2.0", "id": CHANGE, "method": "set_materials", "params": params}
    wire.socket.send(msgpack.packb(message))


def designing(daemon: Daemon) -> int:
    """The process, once it is there."""
    until(lambda: bool(children(daemon.process.pid)))
    (child,) = children(daemon.process.pid)
    return child


def is_gone(process: int) -> bool:
    return not Path(f"/proc/{process}").exists()


def test_a_change_whose_process_is_killed_is_refused_and_the_next_one_is_taken() -> None:
    with running_daemon() as daemon, wired(daemon) as wire, wired(daemon) as other:
        scene = {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}}}
        revision = other.result("set_scene", scene=scene)["revision"]
        begin(wire)
        child = designing(daemon)
        os.kill(child, signal.SIGKILL)
        answer = msgpack.unpackb(wire.socket.recv())
        assert answer["id"] == CHANGE and answer["error"]["code"] == Code.INTERNAL
        assert "send it again" in answer["error"]["message"] and "\n" not in answer["error"]["message"]
        assert is_gone(child) and not children(daemon.process.pid)
        status = other.result("get_status")
        assert status["revision"] == revision and status["intake"] is None and not status["faults"]
        assert "Traceback" not in daemon.said()
        assert other.result("set_materials", materials={"gum": {"stiffness_n_per_m": 50}})["revision"] == revision + 1


def test_it_goes_when_the_daemon_ends() -> None:
    with running_daemon() as daemon, wired(daemon) as wire:
        begin(wire)
        child = designing(daemon)
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(PATIENCE_S) == 0
        until(lambda: is_gone(child))
        assert "Traceback" not in daemon.said()


def test_it_goes_when_the_daemon_is_killed() -> None:
    with running_daemon() as daemon, wired(daemon) as wire:
        begin(wire)
        child = designing(daemon)
        daemon.process.kill()
        daemon.process.wait(PATIENCE_S)
        until(lambda: is_gone(child))
