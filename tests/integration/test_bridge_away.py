"""A bridge whose daemon is not there, ends or comes, and what clients of other machines are told of it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import hapticd.aio
from hapticd.client.blocking import Client
from hapticd.client.record import RecordSummary, record
from hapticd.protocol.calls import DaemonNotRunning
from hapticd.protocol.places import probe
from tests.support.bridge_process import Bridge, running_bridge
from tests.support.daemon_process import connect, running_daemon
from tests.support.fake_daemon import fake_daemon, result

pytestmark = pytest.mark.slow

CLIENTS = {"alice": "command", "bob": "watch"}


@pytest.fixture
def nowhere(tmp_path: Path) -> Path:
    """The runtime directory of a daemon that is not there."""
    directory = tmp_path / "run"
    directory.mkdir(mode=0o700)
    return directory


@pytest.fixture
def lonely(tmp_path: Path, nowhere: Path) -> Iterator[Bridge]:
    (tmp_path / "bridge").mkdir()
    with running_bridge(tmp_path / "bridge", nowhere, CLIENTS) as bridge:
        yield bridge


def told_by(bridge: Bridge, more: str = "") -> str:
    return f"^the bridge at {bridge.address}: the daemon behind it does not answer{more}$"


@pytest.mark.slow
def test_the_bridge_is_named_and_its_daemon_blamed(lonely: Bridge, tmp_path: Path) -> None:
    with connect(lonely.address, **lonely.as_client("alice")) as client:
        nothing_done = told_by(lonely, "; nothing was carried out")
        with pytest.raises(DaemonNotRunning, match=nothing_done):
            client.get_status()
        with pytest.raises(DaemonNotRunning, match=nothing_done):
            record(client, tmp_path / "a.npz")
        with pytest.raises(DaemonNotRunning, match=told_by(lonely)):
            client.states()


def test_a_bridge_that_stands_still_does_not_refuse(lonely: Bridge) -> None:
    """The kernel takes the connection for it; of keys and handshakes nothing is known."""
    told = "^no answer from the bridge at .* within 0.1 s, though the connection was taken: it is too busy"
    with lonely.held(), pytest.raises(DaemonNotRunning, match=told):
        probe(lonely.at("alice"), 0.1)


@pytest.mark.slow
def test_a_watcher_is_told_too(lonely: Bridge) -> None:
    with (
        connect(lonely.address, **lonely.as_client("bob")) as client,
        pytest.raises(DaemonNotRunning, match=told_by(lonely)),
    ):
        client.events()

    async def main() -> None:
        async with hapticd.aio.connect(lonely.address, 60.0, **lonely.as_client("bob")) as client:
            with pytest.raises(DaemonNotRunning, match=told_by(lonely)):
                await anext(client.events())
            with pytest.raises(DaemonNotRunning, match=told_by(lonely)):
                async with client.states(newest=True):
                    raise AssertionError

    asyncio.run(main())


def test_the_bridge_says_what_a_key_may_and_whether_there_is_a_daemon(tmp_path: Path) -> None:
    """By a topic of its own, which the daemon does not have: a client asks no command socket that refuses it."""
    with (
        running_daemon("-c", quiet(tmp_path)) as daemon,
        running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge,
        connect(bridge.address, **bridge.as_client("alice")) as alice,
        connect(bridge.address, **bridge.as_client("bob")) as bob,
        alice.telemetry("bridge") as one,
        bob.telemetry("bridge", "status") as other,
    ):
        for there in (True, False):
            for messages, may in ((one, "command"), (other, "watch")):
                found = (told for topic, told in messages if topic == "bridge" and told["daemon"] is there)
                assert next(found) == {"may": may, "daemon": there}
            if there:
                daemon.stop()


@pytest.mark.parametrize("bridged", [False, True], ids=["here", "through a bridge"])
def test_a_recording_ends_with_its_daemon(tmp_path: Path, bridged: bool) -> None:
    """The client would wait a minute for telemetry: what it finds is that the daemon has ended."""
    with running_daemon("-c", quiet(tmp_path)) as daemon, running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge:
        place, keys = (bridge.address, bridge.as_client("alice")) if bridged else (daemon.directory, {})
        with connect(place, **keys) as client:
            kept = recorded_until(client, tmp_path / "a.npz", daemon.stop)
    assert kept.ended_because == "the daemon stopped"
    assert kept.ticks > 0 and kept.lost == 0


def recorded_until(client: Client, target: Path, end: Callable[[], object]) -> RecordSummary:
    """What is recorded of a daemon that `end` ends once there are samples of it."""
    ends: list[threading.Thread] = []

    def progress(recorded_s: float) -> None:
        if recorded_s > 0 and not ends:
            ends.append(threading.Thread(target=end))
            ends[0].start()

    try:
        return record(client, target, progress=progress)
    finally:
        for thread in ends:
            thread.join()


def test_a_client_waits_for_the_daemon_behind_a_bridge(lonely: Bridge, nowhere: Path) -> None:
    keys = lonely.as_client("alice")
    with connect(lonely.address, wait_s=0.05, **keys) as client, pytest.raises(DaemonNotRunning):
        client.get_status()
    found: list[Any] = []

    def wait() -> None:
        with connect(lonely.address, wait_s=60.0, **keys) as client:
            found.append(client.call("hello"))

    since = lonely.spoken
    waiting = threading.Thread(target=wait)
    waiting.start()
    lonely.hears("alice: telemetry", since)
    assert not found
    with fake_daemon(nowhere, lambda request: [result(request, "there")]) as daemon:
        while waiting.is_alive():
            daemon.publish("status", {})
            waiting.join(0.1)
    assert found == ["there"]


def quiet(folder: Path) -> str:
    config = folder / "quiet.yaml"
    config.write_text("servo: {rate_hz: 1000, realtime: off}\n")
    return str(config)
