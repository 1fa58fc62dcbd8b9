"""The parts of the bridge that need no daemon: its file, its limits, what it looks at, what Prometheus is told."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import re
import struct
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgpack
import pytest
import zmq
import zmq.asyncio
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client.parser import text_string_to_metric_families

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.base.token_bucket import Bucket
from hapticd.bridge import gate, http
from hapticd.bridge.accounts import Account, Accounts
from hapticd.bridge.config import BridgeClient, BridgeConfig, BridgeLimits, load_bridge
from hapticd.bridge.daemon_link import DaemonLink
from hapticd.bridge.gate import Gate
from hapticd.bridge.limits import Teller
from hapticd.bridge.metrics import Metrics
from hapticd.bridge.relay import method_in, peek
from hapticd.config.configuration import default_config
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.protocol import messages
from hapticd.protocol.keys import new_certificate
from hapticd.system.paths import RuntimePaths
from hapticd.system.repeated_lines import MOST_KINDS, SHORTEST_S

KEYS = {name: new_certificate().public_key for name in ("alice", "bob", "carol")}


class Time:
    """A clock that goes when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


# ---- the file --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("clients:\n  a: {may: watch}\n", "b.yaml:2:3: clients.a.public_key: is missing"),
        ('clients:\n  a: {public_key: "BOB", may: all}\n', "b.yaml:2:63: clients.a.may: must be"),
        ('clients:\n  a: {public_key: "BOB", may: watch, x: 1}\n', "b.yaml:2:75: clients.a.x"),
        ("limits:\n  requests_per_s: 0\n", "b.yaml:2:3: limits.requests_per_s: must be at least 1"),
        ("limits: {message_bytes: 3000000}\n", "limits.message_bytes: must be at most 2097152"),
        ("listen: tcp://0.0.0.0\n", "b.yaml:1:1: listen: must be tcp://HOST:PORT"),
        ("listen: tcp://*:65535\n", "b.yaml:1:1: listen: the port must be at most 65534"),
        ("metrics: 10.0.0.1:9417\n", "b.yaml:1:1: metrics: must be on a loopback address"),
        ("metrics: 9417\n", "b.yaml:1:1: metrics: must be a string"),
        ("metrics: localhost\n", "b.yaml:1:1: metrics: must be HOST:PORT"),
        ("- 1\n", "b.yaml:1:1: must be a mapping"),
        ("a: 1\n", "b.yaml:1:1: a"),
    ],
)
def test_faults_are_told_with_file_line_and_key(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "b.yaml").write_text(text.replace("BOB", KEYS["bob"]))
    (tmp_path / "b.yaml").chmod(0o644)
    with pytest.raises(InvalidError) as error:
        load_bridge(tmp_path / "b.yaml")
    assert told in str(error.value)


def test_one_key_has_one_name(tmp_path: Path) -> None:
    lines = [f'  {name}: {{public_key: "{KEYS["bob"]}", may: watch}}\n' for name in ("one", "two")]
    (tmp_path / "b.yaml").write_text("clients:\n" + "".join(lines))
    (tmp_path / "b.yaml").chmod(0o644)
    with pytest.raises(InvalidError, match='clients "one" and "two" have the same public_key'):
        load_bridge(tmp_path / "b.yaml")


def test_what_stands_in_an_empty_file(tmp_path: Path) -> None:
    """Nobody is let in, and nothing listens beyond this machine."""
    (tmp_path / "b.yaml").write_text("{}\n")
    (tmp_path / "b.yaml").chmod(0o644)
    config = load_bridge(tmp_path / "b.yaml")
    assert config.clients == {}
    assert config.listen == "tcp://127.0.0.1:9410"
    assert config.metrics == "127.0.0.1:9417"
    assert config.server_key == str(tmp_path / "keys" / "server.key_secret")


# ---- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [0o664, 0o646, 0o666])
def test_a_file_that_others_may_change_lets_nobody_in(tmp_path: Path, mode: int) -> None:
    (tmp_path / "b.yaml").write_text("{}\n")
    (tmp_path / "b.yaml").chmod(mode)
    with pytest.raises(HapticdError, match=f"b.yaml: others may change it \\(mode 0{mode:o}\\): chmod go-w"):
        load_bridge(tmp_path / "b.yaml")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_file_of_somebody_else_lets_nobody_in(tmp_path: Path) -> None:
    (tmp_path / "b.yaml").write_text("{}\n")
    os.chown(tmp_path / "b.yaml", 12345, -1)
    with pytest.raises(HapticdError, match=r"b\.yaml: belongs to user 12345; it must belong to root or to us"):
        load_bridge(tmp_path / "b.yaml")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "b.yaml", 0o600)
    with pytest.raises(HapticdError, match=r"b\.yaml: must be a regular file"):
        load_bridge(tmp_path / "b.yaml")


@given(
    per_s=st.floats(1, 1e4),
    burst=st.floats(1, 1e3),
    steps=st.lists(st.tuples(st.floats(0, 2), st.floats(0, 500)), max_size=50),
)
def test_nobody_takes_more_than_the_limit(per_s: float, burst: float, steps: list[tuple[float, float]]) -> None:
    """Who waits as it is told has taken at most the burst, the rate times the time, and what was taken last."""
    time = Time()
    bucket = Bucket(per_s, burst, time)
    start, taken = time.now, 0.0
    for pause_s, amount in steps:
        time.now += pause_s
        assert taken <= burst + per_s * (time.now - start) + 1e-6 * (1 + taken)
        taken += amount
        time.now += bucket.take(amount)
    assert taken <= burst + per_s * (time.now - start) + 1e-6 * (1 + taken)


def test_who_is_slow_enough_never_waits() -> None:
    time = Time()
    bucket = Bucket(10, 1, time)
    for _ in range(100):
        assert bucket.take(1) == 0
        time.now += 0.1 + 1e-9
    assert bucket.take(2) == pytest.approx(0.1)


def test_lines_that_repeat_are_counted() -> None:
    time = Time()
    told: list[str] = []
    tell = Teller(told.append, time)
    for _ in range(100):
        tell("a", "somebody knocks")
    assert told == ["somebody knocks"]
    time.now += SHORTEST_S
    tell.flush()
    assert told[1:] == ["somebody knocks (and 98 more in the last 1 s)"]


def test_no_stranger_fills_the_log() -> None:
    """Each line is of a new kind; five minutes of them."""
    time = Time()
    told: list[str] = []
    tell = Teller(told.append, time)
    for number in range(3000):
        tell(str(number), "somebody else knocks")
        tell.flush()
        time.now += 0.1
    assert len(told) <= 20 + 300 + 1
    assert len(tell) <= MOST_KINDS


# ---- clients ---------------------------------------------------------------------------------------------------------


def config_of(clients: dict[str, tuple[str, str]], **limits: float) -> BridgeConfig:
    entries = {name: {"public_key": KEYS[key], "may": may} for name, (key, may) in clients.items()}
    return BridgeConfig.model_validate({"clients": entries, "limits": limits})


def test_who_is_gone_after_a_reload() -> None:
    accounts = Accounts(config_of({"a": ("alice", "command"), "b": ("bob", "watch")}))
    before = {account.name: account for account in accounts.all()}
    assert accounts.replace(config_of({"a": ("alice", "command"), "b": ("bob", "watch")}, requests_per_s=5)) == []
    assert accounts.find(KEYS["alice"]) is before["a"]
    assert before["a"].requests.take(2) > 0  # the new limit holds: a burst of one
    assert accounts.replace(config_of({"a": ("alice", "watch"), "b": ("bob", "watch")})) == [before["a"]]
    assert accounts.find(KEYS["alice"]) is not before["a"]
    assert accounts.replace(config_of({"a": ("alice", "watch"), "c": ("bob", "watch")})) == [before["b"]]
    gone = accounts.replace(config_of({"a": ("carol", "command")}))
    assert {account.key for account in gone} == {KEYS["alice"], KEYS["bob"]}
    assert accounts.find(KEYS["alice"]) is None


# ---- what a body is --------------------------------------------------------------------------------------------------

_SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text()
_FLAT = _SCALARS | st.binary() | st.lists(_SCALARS) | st.dictionaries(st.text(), _SCALARS)
_TREES = _FLAT | st.lists(_FLAT) | st.dictionaries(st.text(), _FLAT)
_MAPS = st.dictionaries(st.sampled_from(["jsonrpc", "id", "method", "params", "x"]), _TREES | st.just("2.0"))


def answered(body: bytes) -> tuple[bool, object]:
    """Whether the daemon answers a body, and by which id, by its own decoder."""
    try:
        request = messages.parse_request(messages.decode(body))
    except messages.WireError as error:
        return not error.silent, error.id
    return request.has_id, request.id


@given(_MAPS | _TREES)
def test_a_look_at_a_body_misses_no_answer(tree: object) -> None:
    """A body that the daemon answers may be taken for one without an answer, but only a map without an id; never the
    other way round, which would wait in vain."""
    body = msgpack.packb(tree)
    look, id = peek(body)
    answers, told = answered(body)
    has_id = isinstance(tree, dict) and "id" in tree
    assert look == (not isinstance(tree, dict) or has_id)
    assert look or not has_id
    assert look >= answers or not has_id
    if answers and told is not None and len(msgpack.packb(told)) <= 256:
        assert id == told


def test_the_method_of_a_body_for_the_log() -> None:
    assert method_in(msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": "get_status"})) == "get_status"
    assert method_in(msgpack.packb({"id": 1, "method": "two\nlines"})) == '"two\\nlines"'
    for tree in ({"id": 1}, {"method": 3}, {"method": "x" * 300}, ["method"], 7):
        assert method_in(msgpack.packb(tree)) is None
    assert method_in(b"\xdf\xff\xff\xff\xff") is None


@given(st.binary(max_size=100))
def test_a_look_at_any_bytes(body: bytes) -> None:
    method_in(body)
    look, _ = peek(body)
    if not look:
        message = msgpack.unpackb(body, strict_map_key=False, raw=True) if _whole(body) else {}
        assert isinstance(message, dict) and b"id" not in message


def _whole(body: bytes) -> bool:
    try:
        msgpack.unpackb(body, strict_map_key=False, raw=True)
    except (ValueError, TypeError, msgpack.UnpackException):
        return False
    return True


@pytest.mark.parametrize("body", [b"", b"\x81", b"\xdf\xff\xff\xff\xff", b"\x81\xa2id" + b"\x91" * 100_000, b"\x90"])
def test_a_look_at_what_claims_too_much(body: bytes) -> None:
    assert peek(body) == (True, None)


# ---- who has not shown a key -----------------------------------------------------------------------------------------


class Knocking:
    """A connection as the gate sees it."""

    kind, account, domain = "command", None, ""

    def __init__(self, gate: Gate, host: str, since_s: float) -> None:
        self.gate, self.host, self.since_s = gate, host, since_s
        self.there = gate.enter(cast("gate.Connection", self))

    def refused_entry(self) -> None:
        """It never entered."""

    def turn_away(self) -> None:
        """It is about to be closed."""

    def close(self) -> None:
        self.there = False
        self.gate.shown(cast("gate.Connection", self))
        self.gate.leave(cast("gate.Connection", self))


def test_who_holds_all_places_keeps_nobody_out(monkeypatch: pytest.MonkeyPatch) -> None:
    now = Time()
    monkeypatch.setattr(gate, "time", SimpleNamespace(monotonic=now))
    accounts, link = Accounts(config_of({})), cast(DaemonLink, None)
    door = Gate(cast(zmq.asyncio.Context, None), "", new_certificate(), accounts, link, "")

    def knock(host: str) -> Knocking:
        now.now += 1e-6
        return Knocking(door, host, now.now)

    others = [knock(f"10.0.0.{number}") for number in range(gate.HANDSHAKES - gate.HANDSHAKES_PER_HOST)]
    crowd = [knock("10.1.0.1") for _ in range(gate.HANDSHAKES_PER_HOST)]
    assert all(each.there for each in others + crowd)
    assert not knock("10.2.0.1").there, "nobody has had the time to show a key"
    assert not knock("10.1.0.1").there
    now.now += gate.PEACE_S
    assert knock("10.2.0.1").there and not crowd[0].there, "the oldest of the address that has most makes room"
    now.now += gate.PEACE_S
    more = [knock("10.1.0.1"), knock("10.1.0.1")]
    assert all(each.there for each in more)
    assert [each.there for each in crowd[:5]] == [False, False, False, True, True]
    assert all(each.there for each in others), "no other address pays for it"
    assert door.refused == {"handshakes": 5}
    for each in (*others, *crowd[3:], *more):
        each.close()
    assert not knock("10.2.0.1").gate._handshakes.get("10.1.0.1")


# ---- whether there is a daemon ---------------------------------------------------------------------------------------


def test_a_watcher_whose_queue_is_full_is_told_later() -> None:
    """That its daemon has gone: nothing comes after it that could make up for it."""
    account = SimpleNamespace(name="bob", may="watch", telemetry_dropped=0)
    connection = gate.Connection(cast(Gate, SimpleNamespace(link=SimpleNamespace(status=None))), "telemetry")
    with zmq.Context() as context, context.socket(zmq.XPUB) as front, context.socket(zmq.SUB) as watcher:
        for socket in (front, watcher):
            socket.linger = 0
        front.setsockopt(zmq.SNDHWM, 2)
        front.setsockopt(zmq.XPUB_NODROP, 1)
        watcher.setsockopt(zmq.RCVHWM, 2)
        watcher.setsockopt(zmq.RCVTIMEO, 10_000)
        front.bind("inproc://front")
        watcher.connect("inproc://front")
        for topic in (b"samples", gate.BRIDGE):
            watcher.setsockopt(zmq.SUBSCRIBE, topic)
        connection._front, connection.account = cast("zmq.Socket[bytes]", front), cast(Account, account)
        while not watcher.poll(1):  # it subscribes in a thread of libzmq's
            connection.take_subscriptions()
        assert watcher.recv_multipart()[0] == gate.BRIDGE
        while not account.telemetry_dropped:
            connection.publish([b"samples", b""])
        connection.tell_of_bridge()
        while watcher.poll(0):
            assert watcher.recv_multipart()[0] == b"samples"
        connection.take_subscriptions()
        assert [gate.BRIDGE, msgpack.packb({"may": "watch", "daemon": False})] == watcher.recv_multipart()


def test_what_was_on_its_way_shows_no_daemon(tmp_path: Path) -> None:
    """A status that is read after its connection has ended; the next connection's does."""
    lost: list[None] = []

    class Socket:
        """Gives what is put into it."""

        def __init__(self) -> None:
            self.frames: asyncio.Queue[list[bytes]] = asyncio.Queue()

        async def recv_multipart(self, flags: int = 0) -> list[bytes]:
            return await self.frames.get()

    def event(number: int) -> list[bytes]:
        return [struct.pack("=hi", number, 0), b""]

    async def main() -> None:
        link = DaemonLink(zmq.asyncio.Context.instance(), RuntimePaths(tmp_path), lambda: lost.append(None), print)
        monitor, socket = Socket(), Socket()
        tasks = [
            asyncio.create_task(link._read_monitor(cast(zmq.asyncio.Socket, monitor))),
            asyncio.create_task(link._read_status(cast(zmq.asyncio.Socket, socket))),
        ]

        async def read(which: Socket, frames: list[bytes]) -> bool:
            which.frames.put_nowait(frames)
            for _ in range(3):
                await asyncio.sleep(0)
            assert which.frames.empty()
            return link.status is not None

        status = [b"status", msgpack.packb({"tick": 1})]
        assert await read(socket, status)
        assert not await read(monitor, event(zmq.EVENT_DISCONNECTED))
        assert not await read(socket, status)
        assert not await read(monitor, event(zmq.EVENT_HANDSHAKE_SUCCEEDED))
        assert await read(socket, status)
        for task in tasks:
            task.cancel()

    asyncio.run(main())
    assert len(lost) == 1


# ---- metrics ---------------------------------------------------------------------------------------------------------


def told(status: dict[str, Any] | None, accounts: Accounts) -> Metrics:
    counts = SimpleNamespace(accounts=accounts, accepted=3, refused=Counter({"key": 2}))
    return Metrics(cast(DaemonLink, SimpleNamespace(status=status)), cast(Gate, counts))


def parsed(text: str) -> dict[str, dict[tuple[str, ...], float]]:
    """By Prometheus's own client, with what promtool would find fault with."""
    found: dict[str, dict[tuple[str, ...], float]] = {}
    for family in text_string_to_metric_families(text):
        assert family.documentation
        assert family.type in ("counter", "gauge", "histogram")
        for sample in family.samples:
            assert (family.type == "counter") == sample.name.endswith("_total")
            values = found.setdefault(sample.name, {})
            labels = tuple(sample.labels.values())
            assert labels not in values, "a series stands there twice"
            values[labels] = sample.value
    return found


def test_metrics_of_a_status() -> None:
    status = Methods(Engine(default_config())).status()
    lateness = {"edges": [1000, 2000, 4000], "counts": [5, 0, 2, 1], "sum": 12_345, "max": 9000}
    status["histograms"] = {"lateness_ns": lateness}
    status["faults"], status["forces"] = ["device"], "faulted"
    accounts = Accounts(config_of({'a "b" \\': ("alice", "command")}))
    metrics = told(status, accounts)
    found = parsed(metrics.text())
    assert found["hapticd_up"] == {(): 1}
    assert found["hapticd_lateness_seconds_bucket"] == {
        ("1e-06",): 5,
        ("2e-06",): 5,
        ("4e-06",): 7,
        ("+Inf",): 8,
    }
    assert found["hapticd_lateness_seconds_sum"] == {(): pytest.approx(12.345e-6)}
    assert found["hapticd_lateness_seconds_count"] == {(): 8}
    assert found["hapticd_fault"] == {("device",): 1}
    assert found["hapticd_forces"] == {("on",): 0, ("off",): 0, ("faulted",): 1}
    assert found["hapticd_bridge_requests_total"] == {('a "b" \\',): 0}
    assert found["hapticd_bridge_refused_total"] == {("key",): 2}
    counters = {name for name in found if name.endswith("_total") and "bridge" not in name}
    assert len(counters) == len(status["counters"])  # type: ignore[arg-type]
    status["faults"] = []
    assert parsed(metrics.text())["hapticd_fault"] == {("device",): 0}


def test_metrics_without_a_daemon() -> None:
    found = parsed(told(None, Accounts(config_of({}))).text())
    assert found["hapticd_up"] == {(): 0}
    assert "hapticd_ticks_total" not in found
    assert all(math.isfinite(value) for values in found.values() for value in values.values())


async def _says(port: int, *pieces: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    answer = b""
    with contextlib.suppress(ConnectionResetError, BrokenPipeError):
        for piece in pieces:
            writer.write(piece)
            await writer.drain()
        answer = await reader.read(-1)
    writer.transport.abort()
    return answer


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n", b"200 OK"),
        (b"GET /metrics?x=1 HTTP/1.0\r\n\r\n", b"200 OK"),
        (b"GET / HTTP/1.1\r\n\r\n", b"404"),
        (b"POST /metrics HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc", b"405"),
        (b"HEAD /metrics HTTP/1.1\r\n\r\n", b"405"),
        (b"nonsense\r\n\r\n", b"400"),
        (b"GET /metrics HTTP/2\r\n\r\n", b"400"),
        (b"GET /metrics HTTP/1.1\r\nX: " + b"x" * 20_000, b"431"),
    ],
)
def test_requests_of_http(request_: bytes, status: bytes) -> None:
    async def ask() -> bytes:
        async with await http.Endpoint(lambda: "hapticd_up 1\n").listen("127.0.0.1", 0) as server:
            return await _says(server.sockets[0].getsockname()[1], request_)

    answer = asyncio.run(ask())
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 " + status)
    assert b"Content-Length: %d\r\n" % len(body) in head
    assert (body == b"hapticd_up 1\n") == (status == b"200 OK")


def test_who_is_slow_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """So many may be silent at once; the next is told so, and all are shown the door when their time is over."""
    timeout, given = asyncio.timeout, []

    def until_said(seconds: float) -> asyncio.Timeout:
        """Their time is over when the test says so."""
        assert seconds == http.REQUEST_S
        given.append(timeout(None))
        return given[-1]

    monkeypatch.setattr(asyncio, "timeout", until_said)

    async def ask() -> tuple[list[bytes], list[bytes], list[bytes], bytes]:
        endpoint = http.Endpoint(lambda: "")

        async def opened(count: int) -> None:
            while endpoint._open != count:
                await asyncio.sleep(0)

        async with await endpoint.listen("127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            slow = [asyncio.create_task(_says(port, b"GET /met")) for _ in range(http.AT_ONCE)]
            await opened(http.AT_ONCE)
            busy = [await _says(port, b"GET /metrics HTTP/1.1\r\n\r\n")]
            await opened(http.AT_ONCE)
            # Told so, and still there.
            staying = [await asyncio.open_connection("127.0.0.1", port) for _ in range(http.AT_ONCE)]
            await opened(2 * http.AT_ONCE)
            more = [await _says(port, b"GET /metrics HTTP/1.1\r\n\r\n") for _ in range(http.AT_ONCE)]
            await opened(2 * http.AT_ONCE)
            for one in given:
                with contextlib.suppress(RuntimeError):  # it is over
                    one.reschedule(asyncio.get_running_loop().time())
            ended = await asyncio.gather(*slow)
            for reader, writer in staying:
                busy.append(await reader.read(4096))
                writer.transport.abort()
            await opened(0)
            return busy, more, ended, await _says(port, b"GET /metrics HTTP/1.1\r\n\r\n")

    busy, more, ended, after = asyncio.run(ask())
    assert [answer.split(b"\r\n")[0] for answer in busy] == [b"HTTP/1.1 503 Service Unavailable"] * len(busy)
    assert more == ended == [b""] * http.AT_ONCE
    assert after.startswith(b"HTTP/1.1 200")


# ---- docs/bridge.md --------------------------------------------------------------------------------------------------

PAGE = (Path(__file__).parents[2] / "docs" / "bridge.md").read_text()


def rows(heading: str) -> list[list[str]]:
    """The first table under a heading, without its own."""
    lines = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0].splitlines()
    table = [line for line in lines if line.startswith("|")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in table[2:]]


def test_every_key_of_the_file_is_described() -> None:
    keys = [name for name in BridgeConfig.model_fields if name not in ("limits", "clients")]
    keys += [f"limits.{name}" for name in BridgeLimits.model_fields]
    keys += [f"clients.NAME.{name}" for name in BridgeClient.model_fields]
    assert {row[0].strip("` ") for row in rows("The file")} == set(keys)


def test_every_metric_is_described() -> None:
    documented = {(name, row[1]) for row in rows("Prometheus") for name in re.findall("`(hapticd_[a-z_]+)`", row[0])}
    status = Methods(Engine(default_config())).status()
    told_ns = {"edges": [1000], "counts": [1, 0], "sum": 1, "max": 1}
    status["histograms"] = {"lateness_ns": told_ns, "work_ns": told_ns}
    status["faults"] = ["device"]
    text = told(status, Accounts(config_of({}))).text()
    assert documented == set(re.findall(r"^# TYPE (\w+) (\w+)$", text, flags=re.MULTILINE))
