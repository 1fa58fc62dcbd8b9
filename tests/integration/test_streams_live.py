"""Streamed targets and forces: what a real daemon does with them, whoever sends what, and both clients of it."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import re
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

import hapticd.aio
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.protocol import streams
from hapticd.protocol.calls import DaemonNotRunning, ForcesOff, RemoteError
from tests.support.daemon_process import PATIENCE_S, Daemon, Wire, connect, running_daemon, until, wired
from tests.support.fake_daemon import fake_daemon, result

ROOT = Path(__file__).parents[2]
TIMEOUT_S = 0.2
"""Of streams in most tests, which a busy machine must not end."""


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "slow.yaml"
    config.write_text(
        f"servo: {{rate_hz: 1000, realtime: off, stream_timeout_s: {TIMEOUT_S}, overruns: {{threshold: 1.0}}}}\n"
        "device: {kind: sim}\nscene: {objects: {}}\n"
    )
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@pytest.fixture
def wire(daemon: Daemon) -> Iterator[Wire]:
    """With forces on and no stream under way."""
    with wired(daemon) as wire:
        wire.result("set_forces", enabled=True)
        until(lambda: not any(each["active"] for each in streams_of(wire).values()))
        yield wire


def streams_of(wire: Wire) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = wire.result("get_status")["streams"]
    return found


def counted(wire: Wire, kind: str = "force") -> dict[str, int]:
    return {name: value for name, value in streams_of(wire)[kind].items() if type(value) is int}


def notify(wire: Wire, method: str, params: object) -> None:
    wire.socket.send(msgpack.packb({"jsonrpc": "2.0", "method": method, "params": params}))


def led_to(wire: Wire, kind: streams.Kind, x: float, y: float, there: Callable[[dict[str, Any]], bool]) -> int:
    """Streams one value until the state is as it should be; the last number."""
    numbers = itertools.count()

    def send() -> bool:
        wire.socket.send(streams.write(kind, next(numbers), x, y))
        return there(wire.result("get_state"))

    until(send)
    return next(numbers) - 1


def more(after: dict[str, int], before: dict[str, int], *names: str) -> list[int]:
    return [after[name] - before.get(name, 0) for name in names]


# ---- What is carried out ---------------------------------------------------------------------------------------------


def test_a_force_is_felt_and_ends_when_none_comes(wire: Wire) -> None:
    before = counted(wire)
    last = led_to(wire, "force", 0.5, -0.25, lambda state: state["force_n"] == pytest.approx([0.5, -0.25]))
    assert "streamed" in wire.result("get_state")["flag_names"]
    until(lambda: streams_of(wire)["force"]["seq"] == last)  # the force may be that of the message before
    status = streams_of(wire)["force"]
    assert status["active"] and 0 < status["tick"] <= wire.result("get_status")["tick"]
    until(lambda: wire.result("get_state")["force_n"] == [0, 0])
    after = counted(wire)
    assert more(after, before, "received", "timeouts", "lost", "late", "held", "refused") == [last + 1, 1, 0, 0, 0, 0]
    assert sum(more(after, before, "used", "superseded")) == last + 1
    assert not streams_of(wire)["force"]["active"]


def test_a_target_moves_the_hand_and_holds(wire: Wire) -> None:
    led_to(wire, "target", 0.02, 0.03, lambda state: state["position_m"] == pytest.approx([0.02, 0.03], abs=1e-3))
    until(lambda: not streams_of(wire)["target"]["active"])
    assert wire.result("get_state")["position_m"] == pytest.approx([0.02, 0.03], abs=1e-3)
    # A gesture begins where the last target left the hand.
    wire.result("set_scene", scene={"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1],
                                                          "material": "wood"}}})  # fmt: skip
    gesture = {"kind": "tap", "object": "floor", "speed_m_per_s": 0.1, "at_m": 0.02}
    near = wire.result("set_operator", gesture=gesture)["duration_s"]
    wire.result("set_operator", waypoints=[[0.0, 1.0, 0.03]])
    assert wire.result("set_operator", gesture=gesture)["duration_s"] > near + 1
    wire.result("set_scene", scene={"objects": {}})


def test_with_an_id_it_is_answered(wire: Wire) -> None:
    assert wire.result("stream_target", seq=0, position_m=[0, 0.02]) == {}
    assert wire.result("stream_force", seq=0, force_n=[0, 0.1]) == {"forces": "on"}
    wire.result("set_forces", enabled=False)
    answer = wire.result("stream_force", seq=1, force_n=[0, 0.1])
    assert answer["forces"] == "off" and "set_forces turns them on" in answer["warning"]
    wire.result("set_forces", enabled=True)


WRONG: list[tuple[str, dict[str, Any], str]] = [
    ("stream_force", {"seq": 1, "force_n": [math.nan, 0.0]}, "force_n[0]"),
    ("stream_force", {"seq": 1, "force_n": [0.0]}, "force_n[1]"),
    ("stream_force", {"seq": 1, "force_n": [0.0, 0.0], "more": 1}, "more"),
    ("stream_force", {"seq": -1, "force_n": [0.0, 0.0]}, "seq"),
    ("stream_target", {"seq": 1, "position_m": [10.5, 0.0]}, "position_m[0]"),
]


@pytest.mark.parametrize(("method", "params", "where"), WRONG)
def test_what_is_wrong_is_said_with_an_id_and_counted_without(
    wire: Wire, method: str, params: dict[str, Any], where: str
) -> None:
    kind = method.removeprefix("stream_")
    before = counted(wire, kind)
    error = wire.error(method, **params)
    assert error["code"] == -32602
    assert where in [each["where"] for each in error["data"]], error
    notify(wire, method, params)
    assert more(counted(wire, kind), before, "received", "refused", "used") == [2, 2, 0]


def test_params_that_are_no_map_are_counted(wire: Wire) -> None:
    before = counted(wire)
    notify(wire, "stream_force", [1, [0.0, 0.0]])
    assert more(counted(wire), before, "received", "refused") == [1, 1]


def test_the_first_senders_stream_stands_until_it_has_ended(daemon: Daemon, wire: Wire) -> None:
    with wired(daemon) as other:
        before = counted(wire)
        assert wire.result("stream_force", seq=100, force_n=[0.0, 0.3])["forces"] == "on"
        error = other.error("stream_force", seq=200, force_n=[0.0, -0.3])
        assert error["code"] == -32010 and 0 < error["data"]["free_s"] <= TIMEOUT_S
        assert "another client streams a force" in error["message"]
        other.socket.send(streams.write("force", 201, 0.0, -0.3))
        assert other.result("stream_target", seq=0, position_m=[0.0, 0.02]) == {}  # the other kind is free
        assert more(counted(other), before, "held", "received") == [2, 3]
        # It ends by time, and another one takes over, at any number.
        until(lambda: "result" in other.call("stream_force", seq=1, force_n=[0.0, -0.3]))
        assert wire.error("stream_force", seq=101, force_n=[0.0, 0.3])["code"] == -32010


def test_a_jump_is_never_a_step_of_the_force(daemon: Daemon, wire: Wire) -> None:
    """From the largest force to the other way, again and again: limited, counted, never faster than the ramp allows."""
    before = counted(wire)
    with connect(daemon.directory) as client, client.samples() as samples:
        for seq in range(20):
            wire.socket.send(streams.write("force", seq, 0.0, 100.0 if seq % 2 else -100.0))
            batch = next(samples)
        force = batch["force_n"]
        most_n = client.call("get_config")["config"]["device"]["max_force_n"]  # type: ignore[index,call-overload]
    assert np.abs(force).max() <= most_n * (1 + 1e-9)
    steps = np.abs(np.diff(force[:, 1]))
    assert steps.max() <= most_n / 0.02 / 1000 * 2.01
    assert more(counted(wire), before, "limited")[0] > 0


# ---- Senders that misbehave ------------------------------------------------------------------------------------------

SENDER = """
import sys, zmq
from hapticd.protocol import streams
with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
    socket.connect(sys.argv[1])
    seq = 0
    while True:
        socket.send(streams.write("force", seq, 0.0, 0.4))
        seq += 1
        if len(sys.argv) > 2 and seq == 1:
            print("sent", flush=True)
"""


def sender(daemon: Daemon, *words: str) -> subprocess.Popen[str]:
    """A process that streams a force as fast as it can."""
    endpoint = f"ipc://{daemon.directory}/hapticd.command"
    return subprocess.Popen([sys.executable, "-c", SENDER, endpoint, *words], stdout=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_a_sender_without_pause_holds_up_nobody_and_its_end_takes_the_force_to_zero(daemon: Daemon, wire: Wire) -> None:
    before, faults = counted(wire), wire.result("get_status")["counters"]
    with sender(daemon) as process:
        try:
            until(lambda: counted(wire)["received"] - before["received"] > 20_000)
            for _ in range(200):
                assert wire.result("get_status")["faults"] == []
            assert wire.result("get_state")["force_n"] == pytest.approx([0.0, 0.4])
            assert wire.result("mark", text="meanwhile")["tick"] > 0
        finally:
            process.send_signal(signal.SIGKILL)
    until(lambda: wire.result("get_state")["force_n"] == [0, 0])
    after = counted(wire)
    assert more(after, before, "late", "lost", "held", "refused") == [0, 0, 0, 0]
    assert sum(more(after, before, "used", "superseded")) == more(after, before, "received")[0]
    assert wire.result("get_status")["counters"]["glitches"] == faults["glitches"]


# ---- Clients ---------------------------------------------------------------------------------------------------------


def test_the_blocking_client_streams(daemon: Daemon, wire: Wire) -> None:
    before = {kind: counted(wire, kind) for kind in ("target", "force")}
    with connect(daemon.directory) as client:
        with client.stream() as stream:
            for number in range(50):
                stream.target(0.0001 * number, np.float64(0.02))
                stream.force(0, 0.2)
            assert stream.unsent == 0
        target, force = counted(wire, "target"), counted(wire)
        assert more(target, before["target"], "received", "lost", "late", "refused") == [50, 0, 0, 0]
        # One more than the block sent: a force of zero.
        assert more(force, before["force"], "received", "lost", "late", "refused") == [51, 0, 0, 0]
        until(lambda: sum(more(counted(wire), before["force"], "used", "superseded")) == 51)
        assert streams_of(wire)["force"]["seq"] == 50
        # Another stream of the same client goes on where that one was: it is the same sender.
        with client.stream() as stream:
            stream.target(0.0, 0.02)
        assert more(counted(wire, "target"), before["target"], "received", "held", "late", "lost") == [51, 0, 0, 0]


def test_the_client_of_asyncio_streams_with_and_without_await(daemon: Daemon, wire: Wire) -> None:
    before = counted(wire)

    async def stream() -> None:
        async with hapticd.aio.connect(daemon.directory, PATIENCE_S) as client, client.stream() as stream:
            stream.force(0.0, 0.1)
            await stream.force(0.0, 0.2)
            state = await client.get_state()
            assert state["tick"] > 0

    asyncio.run(stream())
    assert more(counted(wire), before, "received", "refused", "late", "lost") == [3, 0, 0, 0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("x", "y", "told"),
    [
        (math.nan, 0, r"x: must be a number from -10 to 10 m, is nan"),
        (0, 11, r"y: must be a number from -10 to 10 m, is 11"),
        ("1", 0, r'x: must be a number from -10 to 10 m, is "1"'),
        (True, 0, r"x: must be a number from -10 to 10 m, is true"),
    ],
)
def test_a_client_refuses_what_the_daemon_would(daemon: Daemon, x: Any, y: Any, told: str) -> None:
    with connect(daemon.directory) as client, client.stream() as stream:
        with pytest.raises(InvalidError, match=told):
            stream.target(x, y)
        with pytest.raises(InvalidError, match=r"fx: must be a number from -100 to 100 N, is inf"):
            stream.force(math.inf, 0)


def test_a_client_tells_of_forces_that_are_off(daemon: Daemon, wire: Wire) -> None:
    wire.result("set_forces", enabled=False)
    with connect(daemon.directory) as client:
        with pytest.warns(ForcesOff, match="set_forces turns them on"), client.stream() as stream:
            stream.force(0.0, 0.1)
        with pytest.warns(ForcesOff) as told, client.stream() as stream:
            until_s = time.monotonic() + 10
            while not told and time.monotonic() < until_s:
                stream.force(0.0, 0.1)
        assert told[0].filename == __file__
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with client.stream() as stream:
                stream.target(0.0, 0.02)
    wire.result("set_forces", enabled=True)


def test_a_client_raises_what_the_daemon_refuses(tmp_path: Path) -> None:
    def answer(request: dict[str, Any]) -> list[bytes]:
        if "id" not in request:
            return []
        if request["method"] != "stream_target":
            return [result(request, {})]
        error = {"code": -32008, "message": "this device is of kind hid"}
        return [msgpack.packb({"jsonrpc": "2.0", "id": request["id"], "error": error})]

    with fake_daemon(tmp_path, answer), connect(tmp_path) as client:
        with pytest.raises(RemoteError, match="this device is of kind hid") as refused, client.stream() as stream:
            stream.target(0.0, 0.0)
        assert refused.value.code == -32008
        stream = client.stream()
        with pytest.raises(RemoteError), stream:
            while True:
                stream.target(0.0, 0.0)
        with client.stream() as stream:
            stream.force(0.0, 0.0)


@pytest.mark.usefixtures("wire")
def test_a_stream_is_used_in_a_block_and_not_after_the_client(daemon: Daemon) -> None:
    with connect(daemon.directory) as client:
        with pytest.raises(HapticdError, match=r"with daemon\.stream"):
            client.stream().target(0.0, 0.0)
        with client.stream() as stream:
            stream.target(0.0, 0.02)
    with pytest.raises(HapticdError, match=r"with daemon\.stream"):
        stream.target(0.0, 0.0)
    with pytest.raises(HapticdError, match="the client is closed"):
        client.stream()


@pytest.mark.slow
def test_a_daemon_that_goes_away_is_told_and_the_next_one_is_streamed_to(tmp_path: Path) -> None:
    def sends(stream: Any) -> bool:
        try:
            stream.target(0.0, 0.02)
        except DaemonNotRunning:
            return False
        return True

    with running_daemon() as first, connect(first.directory) as client, ExitStack() as later:
        with client.stream() as stream:
            stream.target(0.0, 0.02)
            first.stop(signal.SIGKILL)
            until(lambda: not sends(stream))
            second = Daemon(first.directory)
            later.callback(second.process.kill)
            second.wait_ready()
            with wired(second) as wire:
                until(lambda: sends(stream) and counted(wire, "target")["used"] > 0)
        assert second.stop() == 0


@pytest.mark.long
def test_a_question_that_went_to_a_daemon_that_is_gone_is_not_waited_for(tmp_path: Path) -> None:
    """Of two daemons, one after the other at the same place, the first took a message and did not answer it."""

    def answers_what_is_asked_last(request: dict[str, Any]) -> list[bytes]:
        return [result(request, {})] if request["method"] == "get_config" else []

    with (
        fake_daemon(tmp_path, answers_what_is_asked_last),
        hapticd.connect(tmp_path, timeout_s=3.0) as client,
        client.stream() as stream,
    ):
        stream.target(0.0, 0.0)


TOLD = json.loads((ROOT / "tests" / "data" / "conversation-1.1.json").read_text())
KINDS = {"integer": int, "boolean": bool, "string": str, "nil": type(None)}


@pytest.mark.long
def test_a_client_that_streams_is_understood_byte_by_byte(wire: Wire) -> None:
    """What it says is frozen, and so is what it reads."""
    before = {kind: counted(wire, kind) for kind in TOLD["counted"]}
    for each in TOLD["conversation"]:
        body = bytes.fromhex(each["request"])
        if "reads" not in each:
            wire.socket.send(body)
            continue
        answer = wire.body(body)
        assert answer["id"] == msgpack.unpackb(body)["id"]
        for member, kinds in each["reads"].items():
            assert type(answer["result"][member]) in [KINDS[kind] for kind in kinds]
    for each in TOLD["errors"]:
        assert wire.body(bytes.fromhex(each["request"]))["error"]["code"] == each["code"], each
    for kind, expected in TOLD["counted"].items():
        status = streams_of(wire)[kind]
        for member, kinds in TOLD["streams"].items():
            assert type(status[member]) in [KINDS[each] for each in kinds], member
        assert dict(zip(expected, more(counted(wire, kind), before[kind], *expected), strict=True)) == expected


@pytest.mark.slow
def test_the_example_of_the_page_moves_the_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs" / "protocol.md").read_text().partition("\n## Streams\n")[2].partition("\n## ")[0]
    (code,) = re.findall(r"^```python\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    assert len([line for line in code.splitlines() if line]) == 5
    with running_daemon() as daemon, connect(daemon.directory) as client:
        monkeypatch.setenv("HAPTICD_RUNTIME_DIR", str(daemon.directory))
        exec(code, {})
        streamed = client.get_status()["streams"]["target"]
        # What the sender had no room for, on a machine that is busy, the daemon counts as lost.
        assert streamed["received"] + streamed["lost"] == 2000 and streamed["late"] == streamed["refused"] == 0
        assert streamed["received"] > 1000
        assert streamed["used"] + streamed["superseded"] == 2000
