"""Leases: a dead-man's switch that a crash, a flood and another client cannot hold down."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from tests.support.daemon_process import Daemon, Wire, connect, running_daemon, wired

LEASE_S = 3.0
"""Renewed every second: whoever renews it may be held up for two."""
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


@pytest.mark.slow
def test_kill_of_the_holder_fades_the_force_within_the_lease(daemon: Daemon, wire: Wire) -> None:
    """kill -9, while another client goes on talking, which does not keep the lease alive."""
    program = (
        "import hapticd, sys\n"
        f"with hapticd.connect({str(daemon.directory)!r}, 60) as d, d.hold_lease({LEASE_S}):\n"
        "    print('held', flush=True)\n"
        "    sys.stdin.read()\n"
    )
    with (
        subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder,
        connect(daemon.directory) as client,
        client.samples() as samples,
    ):
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        held_ns = time.monotonic_ns()
        batch = next(batch for batch in samples if batch["time_ns"][-1] > held_ns + 1.3e9 * LEASE_S)
        assert batch["force_n"][-1, 1] == pytest.approx(0.5, abs=0.01), "it was renewed"
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        over_ns = time.monotonic_ns() + LEASE_S * 1e9  # it lapses no later
        batches = [np.array(batch)]
        while batches[-1]["time_ns"][-1] < over_ns + 1e9:
            client.get_status()
            batches.append(np.array(next(samples)))
        data = np.concatenate(batches)
        force, times = data["force_n"][:, 1], data["time_ns"]
        assert force[-1] == 0.0
        # From the first tick on that finds it lapsed, the force fades in 20 ms, and a period.
        noticed_ns = times[times >= over_ns][0]
        assert np.all(force[times >= noticed_ns + 20_200_000] == 0.0)
        # It faded; the peer's force steps to zero at best.
        assert np.max(np.abs(np.diff(force)) / np.diff(times)) * 1e9 <= 0.5 / 0.02 * 1.001
        assert client.get_status()["faults"] == ["lease"]


@pytest.mark.slow
def test_kill_of_a_client_without_a_lease_changes_nothing(daemon: Daemon, wire: Wire) -> None:
    """Its scene stays, and pushes on."""
    program = (
        "import hapticd, sys\n"
        f"with hapticd.connect({str(daemon.directory)!r}, 60) as d:\n"
        "    d.update_scene({'push': {'kind': 'constant', 'force_n': [0.0, 0.25]}}, wait=True)\n"
        "    print('set', flush=True)\n"
        "    sys.stdin.read()\n"
    )
    with (
        subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other,
        connect(daemon.directory) as client,
        client.samples() as samples,
    ):
        assert other.stdout is not None
        assert other.stdout.readline() == b"set\n"
        other.send_signal(signal.SIGKILL)
        other.wait()
        killed_ns = time.monotonic_ns()
        # Longer than the daemon takes to notice a command thread that stands still, and a ramp.
        batch = next(batch for batch in samples if batch["time_ns"][-1] > killed_ns + 2e9)
        assert batch["force_n"][-1, 1] == pytest.approx(0.25, abs=0.01)
        status = client.get_status()
        assert (status["forces"], status["faults"]) == ("on", [])
        assert client.get_scene()["scene"]["objects"]["push"]["force_n"] == [0.0, 0.25]


@pytest.mark.long
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


@pytest.mark.long
def test_after_a_lapse_commands_say_so_and_the_scene_is_still_there(daemon: Daemon, wire: Wire) -> None:
    scene = wire.result("get_scene")["scene"]
    with connect(daemon.directory) as client, client.telemetry("event") as events, client.samples() as samples:
        token = wire.result("lease", duration_s=0.01)["token"]
        fault = next(event for _, event in events if event["event"] == "fault")
        while (batch := next(samples))["tick"][-1] <= fault["tick"] or batch["force_n"][-1, 1] != 0.0:
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
