"""What a client waits for: a daemon that is still to start, the end of a gesture, the newest of what is sent."""

from __future__ import annotations

import asyncio
import threading
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

import hapticd.aio
from hapticd import DaemonNotRunning, HapticdError, TimedOut
from hapticd.client.blocking import Client
from hapticd.client.methods import gesture_end
from hapticd.protocol import places
from hapticd.protocol.messages import MAX_GESTURE_ENDS
from tests.support.daemon_process import Daemon, connect
from tests.support.fake_daemon import fake_daemon, result

SHORT = [[0.0, 0.0, 0.05], [0.02, 0.0, 0.04]]
LONG = [[0.0, 0.0, 0.05], [1000.0, 0.0, 0.04]]


def status_of(request: Mapping[str, Any]) -> list[bytes]:
    return [result(request, {"method": request["method"]})]


# ---- A daemon that is not ready yet ----------------------------------------------------------------------------------


def in_thread(work: Callable[[], object]) -> Callable[[], object]:
    """Begins `work`; the function that is returned waits for what it gives."""
    found: list[object] = []

    def run() -> None:
        try:
            found.append(work())
        except Exception as error:
            found.append(error)

    thread = threading.Thread(target=run)
    thread.start()

    def wait() -> object:
        thread.join(60)
        assert found, "it still waits"
        return found[0]

    return wait


def blocking(directory: Path, wait_s: float) -> object:
    with connect(directory, wait_s=wait_s) as client:
        return client.call("hello")


def with_asyncio(directory: Path, wait_s: float) -> object:
    async def ask() -> object:
        async with hapticd.aio.connect(directory, 60.0, wait_s=wait_s) as client:
            return await client.call("hello")

    return asyncio.run(ask())


@pytest.mark.parametrize("ask", [blocking, with_asyncio])
def test_a_client_may_come_before_the_daemon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ask: Callable[[Path, float], object]
) -> None:
    waits = threading.Event()
    original = places.await_ready

    def awaited(*arguments: Any) -> None:
        waits.set()
        original(*arguments)

    monkeypatch.setattr(places, "await_ready", awaited)
    directory = tmp_path / "later"
    answer = in_thread(lambda: ask(directory, 60.0))
    assert waits.wait(60)
    directory.mkdir()
    with fake_daemon(directory, status_of):
        assert answer() == {"method": "hello"}


@pytest.mark.parametrize("ask", [blocking, with_asyncio])
def test_a_daemon_that_does_not_come_is_told_as_ever(tmp_path: Path, ask: Callable[[Path, float], object]) -> None:
    with pytest.raises(
        DaemonNotRunning, match=rf"no daemon at {tmp_path}; start one with: hapticd run.* \(waited 0\.05 s for it\)$"
    ):
        ask(tmp_path, 0.05)


def test_who_gives_up_waiting_waits_no_longer(tmp_path: Path) -> None:
    """The thread that waits ends with the task, or the loop would not end for an hour."""

    async def give_up() -> None:
        async with asyncio.timeout(0.05):
            await hapticd.aio.connect(tmp_path, wait_s=3600.0)

    answer = in_thread(lambda: asyncio.run(give_up()))
    assert isinstance(answer(), TimeoutError)


def test_asyncio_connects_in_both_ways(daemon: Daemon) -> None:
    async def main() -> None:
        client = await hapticd.aio.connect(daemon.directory)
        async with client:
            assert (await client.get_status())["state"] == "running"
        with pytest.raises(HapticdError, match="the client is closed"):
            await client.get_status()
        async with hapticd.aio.connect(daemon.directory) as other:
            assert (await other.state())["tick"] >= 0
        with pytest.raises(HapticdError, match="the client is closed"):
            await other.state()

    asyncio.run(main())


# ---- The end of a gesture --------------------------------------------------------------------------------------------


def test_the_end_of_a_gesture_is_waited_for(client: Client) -> None:
    started = client.set_operator(SHORT)["tick"]
    end = client.wait_gesture()
    assert end["event"] == "gesture_end"
    assert (end["started_tick"], end["completed"]) == (started, True)
    assert end["tick"] > started
    assert client.wait_gesture() == end, "one that is over is told at once"
    assert client.wait_gesture(0.0) == end


def test_a_gesture_that_somebody_else_replaces_has_ended(client: Client, daemon: Daemon) -> None:
    started = client.set_operator(LONG)["tick"]
    waits = in_thread(client.wait_gesture)
    with connect(daemon.directory) as other:
        taken = other.set_operator(SHORT)["tick"]
        end = waits()
        assert isinstance(end, dict)
        assert (end["started_tick"], end["completed"], end["tick"]) == (started, False, taken)
        assert client.wait_gesture() == end
        assert other.wait_gesture()["completed"]


def test_a_gesture_that_is_not_over_in_time(client: Client) -> None:
    client.set_operator(LONG)
    with pytest.raises(TimedOut, match=r"still moving after 0\.01 s"):
        client.wait_gesture(0.01)
    with pytest.raises(TimeoutError):
        client.wait_gesture(0)


def test_a_client_waits_for_what_it_asked_for(client: Client, daemon: Daemon) -> None:
    with pytest.raises(HapticdError, match="has not called set_operator"):
        client.wait_gesture()
    client.set_operator(SHORT)
    with connect(daemon.directory) as other:
        for _ in range(MAX_GESTURE_ENDS + 1):
            other.set_operator(SHORT)
            other.wait_gesture()
    with pytest.raises(HapticdError, match="has no operator of tick"):
        client.wait_gesture()


def test_a_daemon_that_was_started_anew_knows_of_no_gesture() -> None:
    status = {"operator": {"started_tick": None, "ends": []}}
    for operator in ({"started_tick": None, "ends": []}, {"started_tick": 3, "ends": []}, None):
        with pytest.raises(HapticdError, match="was restarted"):
            gesture_end(70, "status", {"operator": operator})
    status["operator"] = {"started_tick": 80, "ends": []}
    assert gesture_end(70, "status", status) is None, "its event is still to come"


# ---- The newest ------------------------------------------------------------------------------------------------------


def test_the_newest_is_newer_than_its_asking(client: Client) -> None:
    """Whatever was sent while nobody read is left out, however much it is."""
    with client.states(newest=True) as states:
        for _ in range(3):
            with client.states() as every:  # many are sent, and none is read
                for _ in range(10):
                    next(every)
            tick = client.state()["tick"]
            assert next(states)["tick"] >= tick


def test_the_newest_batch_is_newer_than_its_asking_and_warns_of_nothing(client: Client) -> None:
    with warnings.catch_warnings(), client.samples(newest=True) as batches:
        warnings.simplefilter("error")
        first = next(batches)
        with client.states() as every:
            for _ in range(10):
                next(every)
        tick = client.state()["tick"]
        second = next(batches)
        assert second["tick"][-1] >= tick
        assert second.lost == second.first_tick - (first.first_tick + len(first)) > 0


@pytest.mark.long
def test_asyncio_has_the_newest_too(daemon: Daemon) -> None:
    async def main() -> None:
        async with hapticd.aio.connect(daemon.directory, 60.0) as client:
            async with client.states(newest=True) as states, client.states() as every:
                for _ in range(3):
                    for _ in range(10):
                        await anext(every)
                    tick = (await client.state())["tick"]
                    assert (await anext(states))["tick"] >= tick
            states = client.states(newest=True)
            tick = (await client.state())["tick"]
            assert (await anext(states))["tick"] >= tick
            states.close()
            with pytest.raises(StopAsyncIteration):
                await anext(states)

    asyncio.run(main())


@pytest.mark.long
def test_a_closed_subscription_to_the_newest_has_no_more(client: Client) -> None:
    states = client.states(newest=True)
    assert states.receive(60.0) is not None
    states.close()
    assert list(states) == []
