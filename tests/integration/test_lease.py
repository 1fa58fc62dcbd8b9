"""Leases: a dead-man's switch that a crash, a flood and another client cannot hold down."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

import hapticd
from tests.daemon_process import Daemon, Wire, running_daemon, wired

FLOOR = {"kind": "wall", "point_m": [0.0, 0.0], "normal": [0.0, 1.0], "material": "wood"}
PUSH = {"floor": FLOOR, "push": {"kind": "constant", "force_n": [0.0, 0.5]}}


@pytest.fixture
def daemon() -> Iterator[Daemon]:
    with running_daemon() as daemon:
        yield daemon


@pytest.fixture
def wire(daemon: Daemon) -> Iterator[Wire]:
    with wired(daemon) as wire:
        wire.result("set_scene", scene={"objects": PUSH}, wait=True)
        yield wire


def test_kill_of_the_holder_fades_the_force_within_the_lease(daemon: Daemon, wire: Wire) -> None:
    """kill -9, while another client goes on talking, which does not keep the lease alive."""
    program = (
        "import hapticd, sys\n"
        f"with hapticd.connect({str(daemon.directory)!r}) as d, d.hold_lease(0.5):\n"
        "    print('held', flush=True)\n"
        "    sys.stdin.read()\n"
    )
    with (
        subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder,
        hapticd.connect(daemon.directory) as client,
        client.samples() as samples,
    ):
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        for _ in range(40):  # 0.8 s: longer than the lease, so that it was renewed
            batch = next(samples)
        assert batch["force_n"][-1, 1] == pytest.approx(0.5, abs=0.01)
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        killed_ns = int(batch["time_ns"][-1])
        batches = []
        for _ in range(80):
            client.get_status()
            batches.append(np.array(next(samples)))
            if batches[-1]["force_n"][-1, 1] == 0.0:
                break
        data = np.concatenate(batches)
        force, times = data["force_n"][:, 1], data["time_ns"]
        assert force[-1] == 0.0
        # Within the lease, the fade of 20 ms, and what passed between the last sample seen and the kill.
        assert times[np.flatnonzero(force == 0.0)[0]] - killed_ns <= 1_000_000_000
        # It faded; the peer's force steps to zero at best.
        assert np.max(np.abs(np.diff(force)) / np.diff(times)) * 1e9 <= 0.5 / 0.02 * 1.001
        assert client.get_status()["faults"] == ["lease"]


def test_second_holder_is_refused_and_a_token_survives_a_reconnection(daemon: Daemon, wire: Wire) -> None:
    token = wire.result("lease", duration_s=30)["token"]
    with wired(daemon) as other:
        error = other.error("lease", duration_s=1)
        assert error["code"] == -32004
        assert other.error("lease", duration_s=1, token="wrong")["code"] == -32004
        assert other.result("lease", duration_s=30, token=token)["token"] == token
    assert wire.result("get_status")["lease_s"] > 20
    assert wire.result("lease", duration_s=0, token=token)["token"] is None
    assert wire.result("get_status")["lease_s"] is None
    assert wire.result("get_status")["forces"] == "on"
    assert wire.error("lease", duration_s=1, token=token)["code"] == -32007


def test_after_a_lapse_commands_say_so_and_the_scene_is_still_there(daemon: Daemon, wire: Wire) -> None:
    scene = wire.result("get_scene")["scene"]
    token = wire.result("lease", duration_s=0.01)["token"]
    with hapticd.connect(daemon.directory) as client, client.samples() as samples:
        while next(samples)["force_n"][-1, 1] != 0.0:
            pass
    assert wire.result("get_status")["faults"] == ["lease"]
    error = wire.error("play", material="wood", direction=[0, 1], amplitude_m_per_s2=1)
    assert error["code"] == -32003
    assert "lease" in error["message"]
    assert wire.error("lease", duration_s=1, token=token)["code"] == -32007
    changed = wire.result("update_scene", objects={"floor": FLOOR})
    assert "lease" in changed["warning"]
    assert wire.result("get_scene")["scene"] == scene
    assert wire.result("set_forces", enabled=True)["forces"] == "on"
    assert "warning" not in wire.result("update_scene", objects={"floor": FLOOR})
    assert "tick" in wire.result("play", material="wood", direction=[0, 1], amplitude_m_per_s2=1)
    assert wire.result("get_status")["faults"] == []
