"""The bridge between a daemon and the network: who gets in, what passes, what is limited, what comes back."""

from __future__ import annotations

import asyncio
import json
import os
import random
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from prometheus_client.parser import text_string_to_metric_families

import hapticd.aio
from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.client.blocking import Client
from hapticd.protocol import messages
from hapticd.protocol.calls import DaemonNotRunning, KeyRefused, RemoteError
from hapticd.protocol.keys import new_certificate, write_certificate
from hapticd.protocol.remote import Remote
from tests.support.bridge_process import FAILURES, Bridge, Peer, running_bridge
from tests.support.cli import HAPTICD
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon, until
from tests.support.fake_daemon import fake_daemon, result
from tests.support.network_namespace import Elsewhere, NoNamespaceError, network_namespace

pytestmark = pytest.mark.slow

CLIENTS = {"alice": "command", "carol": "command", "bob": "watch"}
ROOT = Path(__file__).parents[2]
FLOOR = {"kind": "wall", "point_m": [0.0, 0.0], "normal": [0.0, 1.0], "material": "wood"}


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "quiet.yaml"
    config.write_text("servo: {rate_hz: 1000, realtime: off}\n")
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@pytest.fixture(scope="module")
def bridge(daemon: Daemon, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bridge]:
    with running_bridge(tmp_path_factory.mktemp("bridge"), daemon.directory, CLIENTS) as bridge:
        yield bridge


def commands() -> list[bytes]:
    """Whatever would change something."""
    params: dict[str, dict[str, Any]] = {
        "set_scene": {"scene": {"objects": {"floor": FLOOR}}},
        "update_scene": {"objects": {"floor": FLOOR}},
        "update_materials": {"materials": {"mine": {"stiffness_n_per_m": 100}}},
        "set_forces": {"enabled": False},
        "lease": {"duration_s": 60},
        "reload": {},
        "dump_flight": {},
        "get_config": {},
    }
    return [messages.request(number, method, each) for number, (method, each) in enumerate(params.items())]


@contextmanager
def nothing_passes(daemon: Daemon) -> Iterator[None]:
    """Whatever happens meanwhile, scene, forces and lease of the daemon are as before, and no file was asked for."""

    def state() -> list[object]:
        with connect(daemon.directory) as client:
            status = client.get_status()
            flight = status["flight"]
            files = flight["under_way"] + flight["written"]
            return [files, *(status[key] for key in ("revision", "forces", "lease_s"))]  # type: ignore[literal-required]

    before = state()
    yield
    assert state() == before


# ---- with a key ------------------------------------------------------------------------------------------------------


def test_a_client_works_as_beside_the_daemon(daemon: Daemon, bridge: Bridge) -> None:
    with connect(bridge.address, **bridge.as_client("alice")) as client, connect(daemon.directory) as beside:
        revision = client.set_scene({"objects": {"floor": FLOOR}}, wait=True)["revision"]
        assert beside.get_scene()["revision"] == revision
        assert client.get_scene() == beside.get_scene()
        with pytest.raises(RemoteError) as refused:
            client.update_scene({"floor": {"normal": [0, 0]}})
        assert refused.value.problems[0].where == "objects.floor.normal"
        client.set_forces(True)  # a machine that is busy elsewhere may have let them fade
        assert client.play("wood", amplitude_m_per_s2=1)["tick"] > 0
        with client.hold_lease(5.0) as token:
            assert token
        with client.samples() as samples:
            first, second = next(samples), next(samples)
        assert second["tick"][0] == first["tick"][-1] + 1
        with client.telemetry("state", "event", "status") as messages:
            assert {next(messages)[0] for _ in range(100)} >= {"state", "status"}


def test_configuration_and_flight_recorder_of_a_commander(bridge: Bridge) -> None:
    with connect(bridge.address, **bridge.as_client("alice")) as client:
        assert client.call("get_config")["config"]["servo"]["rate_hz"] == 1000
        before = client.set_scene({"objects": {"floor": FLOOR}})["revision"]
        assert client.call("reload", {"wait": True})["revision"] > before
        file = Path(client.call("dump_flight")["file"])
    assert file.name.endswith("-asked.npz")


def test_a_client_of_asyncio(bridge: Bridge) -> None:
    async def several() -> None:
        async with hapticd.aio.connect(bridge.address, 60.0, **bridge.as_client("alice")) as client:
            statuses = await asyncio.gather(*(client.get_status() for _ in range(20)))
            assert all(status["protocol"] == 1 for status in statuses)
            async with client.samples() as samples:
                assert len(await anext(samples))

    asyncio.run(several())


def test_a_request_of_req_and_one_without_an_answer(daemon: Daemon, bridge: Bridge) -> None:
    with Peer(zmq.REQ, bridge.at("alice").command_endpoint, bridge.at("alice")) as peer:
        peer.socket.send(messages.request("a", "get_status"))
        assert msgpack.unpackb(peer.socket.recv())["id"] == "a"
    with Peer(zmq.DEALER, bridge.at("alice").command_endpoint, bridge.at("alice")) as peer:
        silent = msgpack.packb({"jsonrpc": "2.0", "method": "reset"})
        broken = msgpack.packb({"jsonrpc": "2.0", "method": "reset", "more": 1})
        for body in (silent, broken, b"\xc1", messages.request(1, "no"), messages.request(2, "get_status")):
            peer.socket.send(body)
        peer.socket.send_multipart([b"", messages.request(3, "get_status")])
        peer.socket.send_multipart([b"x", b"y", b"z"])
        answers = [msgpack.unpackb(peer.socket.recv()) for _ in range(4)]
        assert [answer["id"] for answer in answers] == [None, None, 1, 2]
        assert [answer.get("error", {}).get("code") for answer in answers] == [-32600, -32700, -32601, None]
        assert peer.socket.recv_multipart()[0] == b""
        assert msgpack.unpackb(peer.socket.recv())["error"]["code"] == -32600


def test_ten_clients_at_once(bridge: Bridge) -> None:
    failures: list[BaseException] = []
    together = threading.Barrier(10)

    def one(number: int) -> None:
        try:
            together.wait(PATIENCE_S)
            name = ("alice", "carol")[number % 2]
            with connect(bridge.address, **bridge.as_client(name)) as client:
                with client.states() as states:
                    ticks = [next(states)["tick"] for _ in range(20)]
                assert ticks == sorted(ticks)
                for _ in range(30):
                    # Each asks for something else, and gets that.
                    with pytest.raises(RemoteError, match=f"no object .x{number}."):
                        client.reset([f"x{number}"])
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=one, args=(number,)) for number in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert failures == []


# ---- without one -----------------------------------------------------------------------------------------------------


def refused(bridge: Bridge, daemon: Daemon, endpoint: str, remote: Remote | None = None) -> None:
    """Sends every command over a connection, which does not come about."""
    with ExitStack() as stack:
        stack.enter_context(nothing_passes(daemon))
        # A connection that was refused takes no more messages: all of them wait before the bridge sees it.
        with bridge.held():
            peer = stack.enter_context(Peer(zmq.DEALER, endpoint, remote))
            peer.socket.setsockopt(zmq.SNDTIMEO, 0)
            for body in commands():
                peer.socket.send(body)
        assert peer.event() & (FAILURES | zmq.EVENT_DISCONNECTED)
        assert peer.event() != zmq.EVENT_HANDSHAKE_SUCCEEDED
        assert not peer.socket.poll(0)


_NO_CURVE = "refused 127.0.0.1 at the command socket: no handshake of CURVE with the bridge's key"


def test_without_a_key(daemon: Daemon, tmp_path: Path) -> None:
    with running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge:
        refused(bridge, daemon, bridge.at("alice").command_endpoint)
        bridge.hears(_NO_CURVE)


def test_with_a_password(bridge: Bridge, daemon: Daemon) -> None:
    peer = Peer(zmq.DEALER, "tcp://127.0.0.1:1")
    peer.socket.setsockopt(zmq.PLAIN_USERNAME, b"alice")
    peer.socket.setsockopt(zmq.PLAIN_PASSWORD, b"alice")
    peer.socket.connect(bridge.address)
    with peer, nothing_passes(daemon):
        while not peer.event() & FAILURES:
            pass
        assert not peer.socket.poll(0)


def test_with_a_key_that_nobody_knows(bridge: Bridge, daemon: Daemon) -> None:
    since = bridge.spoken
    refused(bridge, daemon, bridge.address, bridge.at("stranger"))
    line = bridge.hears("refused 127.0.0.1 at the command socket: key (.*)... belongs to no client", since)
    assert bridge.keys["stranger"].public_key.startswith(line[1])
    with pytest.raises(KeyRefused, match="refuses our key"):
        connect(bridge.address, **bridge.as_client("stranger"))


@pytest.mark.slow
def test_with_another_server_key(daemon: Daemon, tmp_path: Path) -> None:
    with running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge:
        refused(bridge, daemon, bridge.address, bridge.at("alice", server="bob"))
        bridge.hears(_NO_CURVE)
        with pytest.raises(HapticdError, match="not the server_key"):
            connect(bridge.address, key=bridge.keys["alice"], server_key=bridge.keys["bob"].public_key)


def test_a_watcher_commands_nothing(daemon: Daemon, tmp_path: Path) -> None:
    # Its own one: it tells of the same refusal once a minute.
    with running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge:
        watches_and_no_more(daemon, bridge)


def watches_and_no_more(daemon: Daemon, bridge: Bridge) -> None:
    refused(bridge, daemon, bridge.address, bridge.at("bob"))
    bridge.hears('refused 127.0.0.1 at the command socket: "bob" may watch, not command')
    # Nor by the other socket: what is sent up there is no subscription.
    with nothing_passes(daemon), Peer(zmq.XSUB, bridge.at("bob").telemetry_endpoint, bridge.at("bob")) as peer:
        for body in commands():
            peer.socket.send(body)
        peer.socket.send(b"\x01state")
        assert peer.socket.recv_multipart()[0] == b"state"
    with connect(bridge.address, **bridge.as_client("bob")) as client:
        with client.states() as states:
            assert next(states)["tick"] > 0
        with pytest.raises(KeyRefused, match="may only watch"):
            client.get_status()


def test_a_watcher_at_the_command_line(bridge: Bridge, tmp_path: Path) -> None:
    _, secret = write_certificate(bridge.keys["bob"], "bob", tmp_path)
    environment = {
        **os.environ,
        "HAPTICD_CONNECT": bridge.address,
        "HAPTICD_KEY": str(secret),
        "HAPTICD_SERVER_KEY": str(bridge.folder / "keys" / "server.key"),
    }
    command = HAPTICD
    with subprocess.Popen([*command, "watch", "--json"], env=environment, stdout=subprocess.PIPE) as watching:
        assert watching.stdout is not None
        line = json.loads(watching.stdout.readline())
        watching.terminate()
    assert line["topic"] in ("state", "event")
    done = subprocess.run([*command, "status"], env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 1
    assert "it may only watch; `hapticd watch` goes with it" in done.stderr


def test_the_flight_recorder_is_on_the_other_machine(
    bridge: Bridge, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, secret = write_certificate(bridge.keys["alice"], "alice", tmp_path)
    there = ["--connect", bridge.address, "--key", str(secret), "--server-key", bridge.keys["server"].public_key]
    assert main([*there, "flight"]) == 0
    assert re.search(r"flight-\d+-asked\.npz$", capsys.readouterr().out.strip())
    assert main([*there, "flight", str(tmp_path / "here.npz")]) == 2
    assert "through a bridge its file stays there" in capsys.readouterr().err
    assert not (tmp_path / "here.npz").exists()


def test_who_does_not_listen_is_told_from_who_refuses(tmp_path: Path, bridge: Bridge) -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        with pytest.raises(DaemonNotRunning, match="nobody takes connections there"):
            connect(f"tcp://127.0.0.1:{closed.getsockname()[1]}", **bridge.as_client("alice"))


# ---- revoked ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("left", [{"carol": "command"}, {"alice": "watch", "carol": "command"}])
def test_a_revoked_key_on_open_connections(daemon: Daemon, tmp_path: Path, left: dict[str, str]) -> None:
    with running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge:
        remote = bridge.at("alice")
        with (
            Peer(zmq.DEALER, remote.command_endpoint, remote) as peer,
            Peer(zmq.SUB, remote.telemetry_endpoint, remote) as watching,
            Peer(zmq.DEALER, remote.command_endpoint, bridge.at("carol")) as other,
            nothing_passes(daemon),
        ):
            watching.socket.setsockopt(zmq.SUBSCRIBE, b"state")
            watching.socket.recv_multipart()
            for each in (peer, other):
                each.socket.send(messages.request(1, "get_status"))
                each.socket.recv()
            for each in (peer, watching):
                assert each.event() == zmq.EVENT_HANDSHAKE_SUCCEEDED
            line = bridge.reload(left)
            assert "alice" in line and "2 connections ended" in line
            # From here on nothing is taken, not even over the connection as it was.
            for body in commands():
                peer.socket.send(body)
            for each in (peer, watching):
                assert each.event() == zmq.EVENT_DISCONNECTED
            other.socket.send(messages.request(2, "get_status"))
            assert msgpack.unpackb(other.socket.recv())["id"] == 2
            assert other.event() == zmq.EVENT_HANDSHAKE_SUCCEEDED
            assert peer.event() & (FAILURES | zmq.EVENT_DISCONNECTED)
        with pytest.raises(KeyRefused), connect(bridge.address, **bridge.as_client("alice")) as client:
            client.get_status()


def test_a_reload_that_revokes_nothing_ends_nothing(daemon: Daemon, tmp_path: Path) -> None:
    with (
        running_bridge(tmp_path, daemon.directory, {"alice": "command"}) as bridge,
        Peer(zmq.DEALER, bridge.address, bridge.at("alice")) as peer,
    ):
        peer.socket.send(messages.request(1, "get_status"))
        peer.socket.recv()
        assert "0 connections ended" in bridge.reload({"alice": "command"})
        peer.socket.send(messages.request(2, "get_status"))
        peer.socket.recv()
        assert peer.event() == zmq.EVENT_HANDSHAKE_SUCCEEDED
        assert not peer.more()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "clients:\n  alice: {public_key: short, may: command}\n",
            r"bridge\.yaml:2:\d+: clients\.alice\.public_key: must be",
        ),
        ("clients: [\n", r"bridge\.yaml:1:10"),
        ("metrics: 0.0.0.0:9417\n", r"bridge\.yaml:1:\d+: metrics: must be on a loopback address"),
        (None, "cannot be read"),
    ],
)
def test_a_bad_file_changes_nothing(daemon: Daemon, tmp_path: Path, text: str | None, told: str) -> None:
    with (
        running_bridge(tmp_path, daemon.directory, {"alice": "command"}) as bridge,
        Peer(zmq.DEALER, bridge.address, bridge.at("alice")) as peer,
    ):
        bridge.file.unlink()
        if text is not None:
            bridge.file.write_text(text)
        bridge.process.send_signal(signal.SIGHUP)
        bridge.hears(f"not reloaded, everything is as it was: .*{told}")
        peer.socket.send(messages.request(1, "get_status"))
        assert "result" in msgpack.unpackb(peer.socket.recv())


# ---- limits ----------------------------------------------------------------------------------------------------------


def test_who_floods_waits_and_nobody_else(daemon: Daemon, tmp_path: Path) -> None:
    """Everything that was sent is answered, in order, and while it waits others are served."""
    count = 3000
    limits = {"requests_per_s": 100}
    with (
        running_bridge(tmp_path, daemon.directory, CLIENTS, limits=limits) as bridge,
        Peer(zmq.DEALER, bridge.address, bridge.at("alice")) as flood,
    ):
        flood.socket.setsockopt(zmq.SNDHWM, 0)
        for number in range(count):
            flood.socket.send(messages.request(number, "get_status"))
        answered = msgpack.unpackb(flood.socket.recv())["id"]
        assert answered == 0
        with connect(bridge.address, **bridge.as_client("carol")) as client:
            for _ in range(20):
                client.get_status()
        while flood.socket.poll(0):
            answered += 1
            assert msgpack.unpackb(flood.socket.recv())["id"] == answered
        assert answered < count - 1
        with connect(daemon.directory) as beside:
            assert beside.get_status()["state"] == "running"


def test_messages_that_are_too_long(daemon: Daemon, tmp_path: Path) -> None:
    limits = {"message_bytes": 4096, "bytes_per_s": 1e8}
    with (
        running_bridge(tmp_path, daemon.directory, CLIENTS, limits=limits) as bridge,
        Peer(zmq.DEALER, bridge.address, bridge.at("alice")) as peer,
    ):
        peer.socket.send(b"x" * 4097)
        error = msgpack.unpackb(peer.socket.recv())["error"]
        assert error["code"] == messages.Code.PARSE
        assert "4097 bytes: at most 4096" in error["message"]
        peer.socket.send(b"x" * messages.MAX_BODY)
        assert msgpack.unpackb(peer.socket.recv())["error"]["code"] == messages.Code.PARSE
        assert peer.event() == zmq.EVENT_HANDSHAKE_SUCCEEDED
        peer.socket.send(b"x" * (messages.MAX_BODY + 2000))
        assert peer.event() == zmq.EVENT_DISCONNECTED


@pytest.mark.slow
def test_too_many_bytes_wait(daemon: Daemon, tmp_path: Path) -> None:
    limits = {"bytes_per_s": 100_000}
    with (
        running_bridge(tmp_path, daemon.directory, CLIENTS, limits=limits) as bridge,
        Peer(zmq.DEALER, bridge.address, bridge.at("alice")) as peer,
    ):
        for _ in range(6):
            peer.socket.send(b"\xc1" * 60_000)
        for _ in range(6):
            assert msgpack.unpackb(peer.socket.recv())["error"]["code"] == messages.Code.PARSE
        found = metrics(bridge)
        assert found["hapticd_bridge_received_bytes_total"]["alice"] > 360_000
        # 360 kB at 100 kB/s, of which the first 100 kB came at once, and of the rest half while we were held up.
        assert found["hapticd_bridge_limited_seconds_total"]["alice,bytes"] > 1.3
        assert found["hapticd_bridge_limited_seconds_total"]["alice,requests"] == 0


def test_a_message_without_end(daemon: Daemon, tmp_path: Path) -> None:
    """A message of many parts is one to libzmq's limits: it must not fill the bridge's memory."""
    with (
        running_bridge(tmp_path, daemon.directory, CLIENTS, limits={"bytes_per_s": 1e9}) as bridge,
        Peer(zmq.DEALER, bridge.address, bridge.at("alice")) as peer,
    ):
        peer.socket.setsockopt(zmq.SNDHWM, 0)
        for _ in range(20):
            peer.socket.send(bytes(2**20), zmq.SNDMORE)
        peer.socket.send(b"")
        bridge.hears('"alice" sends without end')
        assert peer.event() == zmq.EVENT_HANDSHAKE_SUCCEEDED
        assert peer.event() == zmq.EVENT_DISCONNECTED


def test_subscriptions_without_end(daemon: Daemon, bridge: Bridge) -> None:
    with Peer(zmq.SUB, bridge.at("bob").telemetry_endpoint, bridge.at("bob")) as peer:
        for number in range(100):
            peer.socket.setsockopt(zmq.SUBSCRIBE, b"topic %d" % number)
        bridge.hears('"bob" subscribes without end')
        assert peer.event() == zmq.EVENT_HANDSHAKE_SUCCEEDED
        assert peer.event() == zmq.EVENT_DISCONNECTED


@pytest.mark.slow
def test_more_connections_than_a_client_may_have(daemon: Daemon, tmp_path: Path) -> None:
    limits = {"connections_per_client": 2, "connections": 3}
    with running_bridge(tmp_path, daemon.directory, CLIENTS, limits=limits) as bridge:
        peers = []

        def come(name: str) -> int:
            peers.append(Peer(zmq.DEALER, bridge.address, bridge.at(name)))
            return peers[-1].event()

        assert [come("alice"), come("alice")] == [zmq.EVENT_HANDSHAKE_SUCCEEDED] * 2
        assert come("alice") != zmq.EVENT_HANDSHAKE_SUCCEEDED
        bridge.hears('"alice" has all its connections already')
        assert come("carol") == zmq.EVENT_HANDSHAKE_SUCCEEDED
        assert come("carol") != zmq.EVENT_HANDSHAKE_SUCCEEDED
        bridge.hears('"carol" comes when all are taken')
        for peer in peers:
            peer.close()


# ---- whatever else knocks --------------------------------------------------------------------------------------------

_GREETING = b"\xff\0\0\0\0\0\0\0\x01\x7f\x03\x01CURVE" + bytes(15 + 32)


def _noise(random: random.Random) -> bytes:
    """Bytes of nobody, or a greeting with something after it or changed in it."""
    tail = random.randbytes(random.randrange(400))
    match random.randrange(4):
        case 0:
            return random.randbytes(1 + random.randrange(200))
        case 1:
            return _GREETING + tail
        case 2:
            changed = bytearray(_GREETING + b"\x04\xc8\x05HELLO\x01\x00" + random.randbytes(192))
            for _ in range(random.randrange(8)):
                changed[random.randrange(len(changed))] = random.randrange(256)
            return bytes(changed)
        case _:
            return _GREETING[: random.randrange(1, 64)] + tail


@pytest.mark.slow
def test_bytes_of_nobody_do_no_harm(daemon: Daemon, tmp_path: Path) -> None:
    # Those who are refused are held for a second, and would have the next test shut out.
    with running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge:
        no_harm(bridge, daemon)


def let_in(bridge: Bridge, name: str) -> Client:
    """A client of the bridge, once those that knocked before do not take all the room any more."""
    deadline, pause = time.monotonic() + 60, threading.Event()
    while True:
        try:
            return connect(bridge.address, **bridge.as_client(name))
        except HapticdError:
            assert time.monotonic() < deadline
            pause.wait(0.1)


def no_harm(bridge: Bridge, daemon: Daemon) -> None:
    def knock(seed: int) -> None:
        source = random.Random(seed)
        for number in range(50):
            with bridge.raw(telemetry=number % 2 == 1) as knocking:
                patient = source.random() < 0.3
                try:
                    knocking.sendall(_noise(source))
                    if patient:
                        knocking.shutdown(socket.SHUT_WR)
                        while knocking.recv(4096):
                            pass
                except OSError:
                    pass  # it has been shown the door

    with nothing_passes(daemon):
        threads = [threading.Thread(target=knock, args=(seed,)) for seed in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        with let_in(bridge, "alice"), let_in(bridge, "carol") as client:
            assert client.get_status()["state"] == "running"


@pytest.mark.slow
def test_who_says_nothing_is_shown_the_door(daemon: Daemon, tmp_path: Path) -> None:
    with (
        running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge,
        bridge.raw() as silent,
        bridge.raw(telemetry=True) as halfway,
    ):
        halfway.sendall(_GREETING)
        assert silent.recv(1) == b""
        with pytest.raises(ConnectionError):
            while halfway.recv(4096):
                pass
            raise ConnectionError
        bridge.hears("no key within 5 s")


def test_many_that_say_nothing_are_not_waited_for(daemon: Daemon, tmp_path: Path) -> None:
    """So many of one address wait at most; the rest is closed at once."""
    with running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge:
        not_waited_for(bridge)


def not_waited_for(bridge: Bridge) -> None:
    waiting = [bridge.raw() for _ in range(40)]
    try:
        bridge.hears("too many connections at once that have not shown a key")
        assert waiting[-1].recv(1) == b""
    except ConnectionResetError:
        pass
    finally:
        for each in waiting:
            each.close()
    with let_in(bridge, "alice") as client:
        client.get_status()


# ---- the daemon comes and goes ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_without_a_daemon_it_says_so_and_comes_back(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    directory.mkdir(mode=0o700)
    (tmp_path / "bridge").mkdir()
    with (
        running_bridge(tmp_path / "bridge", directory, CLIENTS) as bridge,
        connect(bridge.address, **bridge.as_client("alice")) as client,
    ):
        with pytest.raises(DaemonNotRunning, match=r"does not answer; nothing was carried out"):
            client.get_status()
        seen: list[Any] = []
        with fake_daemon(directory, lambda request: [result(request, len(seen))]) as daemon:
            assert when_it_is_there(client, "here") == 0
            bridge_knows(bridge)
            # Nobody answers, and then nobody is there.
            asked = threading.Event()

            def silence(request: dict[str, Any]) -> list[bytes]:
                asked.set()
                return []

            daemon.answer = silence
            failures: list[BaseException] = []

            def ask() -> None:
                try:
                    client.call("unanswered")
                except DaemonNotRunning as error:
                    failures.append(error)

            asking = threading.Thread(target=ask)
            asking.start()
            assert asked.wait(PATIENCE_S)
        asking.join(60)
        assert "may have been carried out" in str(failures[0])
        with fake_daemon(directory, lambda request: [result(request, "again")]) as second:
            assert when_it_is_there(client, "after") == "again"
            assert [request["method"] for request in second.requests] == ["after"]


def when_it_is_there(client: Client, method: str) -> object:
    """The answer of a daemon that has just come. A bridge that is held up may find it later than it waits for one."""
    deadline = time.monotonic() + 60
    while True:
        try:
            return client.call(method)
        except DaemonNotRunning as error:
            assert "nothing was carried out" in str(error) and time.monotonic() < deadline


def bridge_knows(bridge: Bridge) -> None:
    """Waits until the bridge has its connection for the status, too: telemetry shows it."""
    with connect(bridge.address, **bridge.as_client("bob")) as client, client.states() as states:
        next(states)


def test_it_ends_with_connections_open(daemon: Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory() as place, monkeypatch.context() as patch:
        patch.setenv("TMPDIR", place)  # where no other test has bridges
        with (
            running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge,
            connect(bridge.address, **bridge.as_client("alice")) as client,
            client.states() as states,
        ):
            next(states)
            client.get_status()
            assert len(list(Path(place).glob("hapticd-bridge-*"))) == 1
            assert bridge.stop() == 0
        assert os.listdir(place) == []


def test_who_leaves_in_the_handshake_leaves_no_file(
    daemon: Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with tempfile.TemporaryDirectory() as place, monkeypatch.context() as patch:
        patch.setenv("TMPDIR", place)
        with running_bridge(tmp_path, daemon.directory, CLIENTS) as bridge:
            (folder,) = Path(place).glob("hapticd-bridge-*")
            for _ in range(10):  # fewer than may be without a key at once
                with socket.create_connection((bridge.host, bridge.port)) as knock:
                    knock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                    knock.sendall(b"\xff\0\0\0\0\0\0\0\x01\x7f")
            with connect(bridge.address, **bridge.as_client("alice")) as client:
                client.get_status()
                assert list(folder.iterdir()) == []


def test_two_on_one_port(daemon: Daemon, bridge: Bridge) -> None:
    second = subprocess.run(
        [sys.executable, "-m", "hapticd", "bridge", "-c", str(bridge.file), "--listen", bridge.address],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert second.returncode == 1
    assert second.stderr.splitlines()[-1] == (
        f"hapticd: listen: 127.0.0.1:{bridge.port} and the port after it: Address already in use"
    )


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--listen", "lab"], "listen: must be tcp://HOST:PORT"),
        (["--metrics", "0.0.0.0:9417"], "metrics: must be on a loopback address"),
        (["-c", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
    ],
)
def test_what_it_does_not_start_with(bridge: Bridge, arguments: list[str], told: str) -> None:
    command = [sys.executable, "-m", "hapticd", "bridge", "-c", str(bridge.file), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert told in line


# ---- metrics ---------------------------------------------------------------------------------------------------------


def metrics(bridge: Bridge) -> dict[str, dict[str, float]]:
    """Values by name, and by the labels' values."""
    url = bridge.hears(r"metrics at (http\S+)")[1]
    with urllib.request.urlopen(url, timeout=30) as answer:
        assert answer.headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
        text = answer.read().decode()
    found: dict[str, dict[str, float]] = {}
    for family in text_string_to_metric_families(text):
        assert family.documentation and family.type != "unknown", family.name
        for sample in family.samples:
            found.setdefault(sample.name, {})[",".join(sample.labels.values())] = sample.value
    return found


def test_metrics(daemon: Daemon, bridge: Bridge) -> None:
    with connect(bridge.address, **bridge.as_client("alice")) as client, client.statuses() as statuses:
        for _ in range(3):
            next(statuses)  # the bridge has heard one of its own by then
        before = metrics(bridge)
        status = client.get_status()
        after = metrics(bridge)
        # One for commands, one for telemetry; the bridge may yet have to hear that those of the tests before are gone.
        until(lambda: metrics(bridge)["hapticd_bridge_client_connections"]["alice"] == 2)
    assert after["hapticd_up"] == {"": 1}
    assert after["hapticd_rate_hertz"] == {"": 1000}
    assert after["hapticd_forces"][status["forces"]] == 1 and sum(after["hapticd_forces"].values()) == 1
    assert 0 < after["hapticd_ticks_total"][""] <= status["counters"]["ticks"] + 60_000
    assert after["hapticd_scene_revision"][""] == status["revision"]
    asked = [each["hapticd_bridge_requests_total"] for each in (before, after)]
    assert asked[1]["alice"] == asked[0]["alice"] + 1
    assert asked[1]["carol"] == asked[0]["carol"]


# ---- from another machine, nearly ------------------------------------------------------------------------------------

_ELSEWHERE = """
import json, sys
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import connect
from hapticd.protocol.keys import Certificate
address, server, *keys = json.loads(sys.argv[1])
for public, secret in keys:
    try:
        with connect(address, 60, key=Certificate(public, secret), server_key=server) as client:
            with client.states() as states:
                next(states)
            print("watches", flush=True)
            print("commands", client.set_scene({"objects": {}})["revision"], flush=True)
    except HapticdError as error:
        print("refused:", error, flush=True)
"""


@pytest.fixture
def elsewhere() -> Iterator[Elsewhere]:
    try:
        with network_namespace() as made:
            yield made
    except NoNamespaceError as error:
        pytest.skip(str(error))


@pytest.mark.slow
def test_from_another_network_namespace(daemon: Daemon, tmp_path: Path, elsewhere: Elsewhere) -> None:
    with running_bridge(tmp_path, daemon.directory, CLIENTS, listen=f"tcp://{elsewhere.here}:0") as bridge:
        assert bridge.host == elsewhere.here

        def says(*names: str, server: str = "server") -> list[str]:
            keys = [(bridge.keys[name].public_key, bridge.keys[name].secret_key) for name in names]
            told = json.dumps([bridge.address, bridge.keys[server].public_key, *keys])
            done = subprocess.run(
                elsewhere.command("-c", _ELSEWHERE, told),
                cwd=ROOT,
                capture_output=True,
                text=True,
                timeout=PATIENCE_S,
            )
            assert done.returncode == 0, done.stderr
            return done.stdout.splitlines()

        with nothing_passes(daemon):
            watches, refusal, stranger = says("bob", "stranger")
            assert watches == "watches"
            assert "may only watch" in refusal
            assert "refuses our key" in stranger
            (wrong,) = says("alice", server="bob")
            assert "not the server_key" in wrong
            bridge.reload({"bob": "watch"})
            (revoked,) = says("alice")
            assert "refuses our key" in revoked
            for mechanism in ("NULL", "PLAIN"):
                bare = subprocess.run(
                    elsewhere.command("-c", _BARE, bridge.address, mechanism),
                    input=msgpack.packb(commands()),
                    capture_output=True,
                    timeout=PATIENCE_S,
                )
                assert bare.stdout == b"nothing\n", bare.stderr
            asked = metrics(bridge)["hapticd_bridge_requests_total"]
            assert asked == {"bob": 0}
        for told in (
            'command socket: "bob" may watch, not command',
            r"\w+ socket: key .{8}\.\.\. belongs to no client",
            "command socket: no handshake of CURVE with the bridge's key",
        ):
            bridge.hears(f"refused {elsewhere.there} at the {told}")
        bridge.reload(CLIENTS)
        watches, commanded = says("alice")
        with connect(daemon.directory) as client:
            assert commanded == f"commands {client.get_status()['revision']}"


_BARE = """
import sys, msgpack, zmq
from zmq.utils.monitor import recv_monitor_message
socket = zmq.Context().socket(zmq.DEALER)
socket.linger = 0
if sys.argv[2] == "PLAIN":
    socket.plain_username = socket.plain_password = b"alice"
monitor = socket.get_monitor_socket(zmq.EVENT_DISCONNECTED | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL)
socket.connect(sys.argv[1])
for body in msgpack.unpackb(sys.stdin.buffer.read()):
    socket.send(body)
recv_monitor_message(monitor)
recv_monitor_message(monitor)
print("something" if socket.poll(0) else "nothing")
socket.disable_monitor()
"""


@pytest.mark.slow
def test_a_key_revoked_under_way_from_another_network_namespace(
    daemon: Daemon, tmp_path: Path, elsewhere: Elsewhere
) -> None:
    """Of what waits at the bridge, and of what comes later, nothing is passed on."""
    limits = {"requests_per_s": 1}
    with running_bridge(
        tmp_path, daemon.directory, CLIENTS, limits=limits, listen=f"tcp://{elsewhere.here}:0"
    ) as bridge:
        alice = bridge.keys["alice"]
        told = [bridge.address, bridge.keys["server"].public_key, alice.public_key, alice.secret_key]
        with subprocess.Popen(
            elsewhere.command("-u", "-c", _REVOKED, json.dumps(told)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as sending:
            assert sending.stdin is not None and sending.stdout is not None
            body = msgpack.packb(
                [messages.request(number, "set_scene", {"scene": {"objects": {}}}) for number in range(40)]
            )
            sending.stdin.write(len(body).to_bytes(4, "big") + body)
            sending.stdin.flush()
            assert sending.stdout.readline() == b"answered\n"
            asked = metrics(bridge)["hapticd_bridge_requests_total"]["alice"]
            assert asked < 40  # the rest waits
            line = bridge.reload({"carol": "command"})
            assert "1 connections ended" in line
            with (
                nothing_passes(daemon),
                connect(bridge.address, **bridge.as_client("carol")) as other,
            ):
                other.get_status()
                sending.stdin.write(b"more\n")
                sending.stdin.flush()
                assert sending.stdout.readline() == b"nothing\n"
                other.get_status()
            assert sending.wait(PATIENCE_S) == 0
        bridge.hears(f"refused {elsewhere.there} at the command socket: key .{{8}}... belongs to no client")


_REVOKED = """
import json, sys, msgpack, zmq
from zmq.utils.monitor import recv_monitor_message
address, server, public, secret = json.loads(sys.argv[1])
socket = zmq.Context().socket(zmq.DEALER)
socket.linger = 0
socket.curve_serverkey, socket.curve_publickey, socket.curve_secretkey = (
    key.encode() for key in (server, public, secret)
)
failures = (
    zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
)
monitor = socket.get_monitor_socket(zmq.EVENT_DISCONNECTED | failures)
socket.connect(address)
bodies = msgpack.unpackb(sys.stdin.buffer.read(int.from_bytes(sys.stdin.buffer.read(4), "big")))
for body in bodies:
    socket.send(body)
socket.recv()
print("answered")
sys.stdin.buffer.readline()
while socket.poll(0):
    socket.recv()
for body in bodies:
    socket.send(body)
# Its connection ended, and each new one is refused.
assert recv_monitor_message(monitor)["event"] == zmq.EVENT_DISCONNECTED
while not recv_monitor_message(monitor)["event"] & failures:
    pass
print("something" if socket.poll(0) else "nothing")
socket.disable_monitor()
"""


def test_under_systemd_its_lines_go_to_the_journal(daemon: Daemon, tmp_path: Path) -> None:
    journal = tmp_path / "journal"
    program = (
        "import sys; from hapticd.system import journal; attached = journal.attached; "
        "journal.attached = lambda level: attached(level, address=sys.argv[1]); "
        "from hapticd.bridge.process import run; sys.exit(run(sys.argv[2], sys.argv[3]))"
    )
    keys = {name: new_certificate() for name in ("server", "stranger")}
    write_certificate(keys["server"], "server", tmp_path / "keys")
    file = tmp_path / "bridge.yaml"
    file.write_text("{listen: 'tcp://127.0.0.1:0', metrics: null}\n")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server, open(tmp_path / "stderr", "wb") as stderr:
        server.bind(str(journal))
        server.settimeout(60)
        status = os.fstat(stderr.fileno())
        environment = {**os.environ, "JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        command = [sys.executable, "-c", program, str(journal), str(file), str(daemon.directory)]
        with subprocess.Popen(command, env=environment, stderr=stderr) as process:
            try:
                ready = server.recv(65536).decode()
                address = re.search(r"ready: commands at (\S+),", ready)
                assert address is not None and "PRIORITY=6\n" in ready
                with pytest.raises(KeyRefused):
                    connect(address[1], key=keys["stranger"], server_key=keys["server"].public_key).get_status()
                refusal = server.recv(65536).decode()
                assert re.search(r"MESSAGE=refused 127.0.0.1 at the \w+ socket: key", refusal)
                assert "PRIORITY=4\n" in refusal and "SYSLOG_IDENTIFIER=hapticd\n" in refusal
            finally:
                process.terminate()
    assert (tmp_path / "stderr").read_bytes() == b""


@pytest.mark.slow
def test_telemetry_that_piled_up_is_passed_on_whole(tmp_path: Path) -> None:
    """Much at once, as a bridge finds it that had to wait for the processor."""
    directory = tmp_path / "run"
    directory.mkdir(mode=0o700)
    count = 800
    with (
        fake_daemon(directory, lambda request: []) as daemon,
        running_bridge(tmp_path, directory, CLIENTS) as bridge,
        Peer(zmq.SUB, bridge.at("bob").telemetry_endpoint, bridge.at("bob")) as peer,
    ):
        peer.socket.setsockopt(zmq.RCVHWM, 0)
        peer.socket.setsockopt(zmq.SUBSCRIBE, b"samples")
        peer.socket.setsockopt(zmq.SUBSCRIBE, b"state")
        while peer.socket.recv_multipart()[0] != b"state":
            pass
        daemon.silent.set()
        for number in range(count):
            daemon.publish("samples", {"number": number, "data": bytes(2000)})
        numbers: list[int] = []
        while len(numbers) < count:
            topic, body = peer.socket.recv_multipart()
            if topic == b"samples":
                numbers.append(msgpack.unpackb(body)["number"])
                assert numbers[-1] == len(numbers) - 1
