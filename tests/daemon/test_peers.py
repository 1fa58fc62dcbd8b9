"""The daemon's two sockets with peers of libzmq, and with peers that exceed limits."""

from __future__ import annotations

import logging
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
import zmq

from hapticd.base.codec import Encoded
from hapticd.daemon import peers, publisher, router
from hapticd.daemon.peers import Peer, Peers, TurnQueue
from hapticd.daemon.publisher import Publisher
from hapticd.daemon.router import Router
from hapticd.protocol import zmtp

DIALLED: list[zmq.Socket[bytes]] = []
RAW: list[socket.socket] = []
TOPICS = ("samples", "state", "event", "change", "status")


def listening(path: Path) -> socket.socket:
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    made.bind(str(path))
    made.listen(128)
    return made


class Raw:
    """A client that sends any bytes."""

    def __init__(self, path: Path, kind: bytes = b"DEALER", shake: bool = True) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        RAW.append(self.socket)
        self.socket.settimeout(30)
        self.socket.connect(str(path))
        if shake:
            self.socket.sendall(zmtp.ZMTP_GREETING + zmtp.ready(kind))

    def ended(self) -> bool:
        """Wait for the end of the connection."""
        try:
            while self.socket.recv(65536):
                pass
        except ConnectionResetError:
            pass
        return True

    def close(self) -> None:
        self.socket.close()


@contextmanager
def echo(path: Path, made: Router) -> Iterator[Router]:
    """Answer each request with its body, in a thread."""
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            request = made.receive(0.1)
            if request is not None:
                body = b"wrong" if request.body is None else b"long" if request.too_long else request.body
                made.send(request.peer, request.delimited, body)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield made
    finally:
        stop.set()
        made.wake()
        thread.join()
        made.close()


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    while RAW:
        RAW.pop().close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "s"


@pytest.fixture
def served(path: Path) -> Iterator[Router]:
    with echo(path, Router(listening(path))) as made:
        yield made


@pytest.fixture
def context() -> Iterator[zmq.Context[Any]]:
    made: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    yield made
    while DIALLED:
        DIALLED.pop().close(0)
    made.term()


def zeromq(context: zmq.Context[Any], kind: int, path: Path, **options: int | bytes) -> zmq.Socket[bytes]:
    made: zmq.Socket[bytes] = context.socket(kind)
    DIALLED.append(made)
    made.setsockopt(zmq.RCVTIMEO, 30_000)
    for name, value in options.items():
        made.setsockopt(getattr(zmq, name), value)
    made.connect(f"ipc://{path}")
    return made


# ---- requests


def test_req_and_dealer_get_answers_in_their_own_form(served: Router, path: Path, context: zmq.Context[Any]) -> None:
    req = zeromq(context, zmq.REQ, path)
    req.send(b"a")
    assert req.recv_multipart() == [b"a"]
    dealer = zeromq(context, zmq.DEALER, path, ROUTING_ID=b"same", HEARTBEAT_IVL=20, HEARTBEAT_TIMEOUT=60_000)
    other = zeromq(context, zmq.DEALER, path, ROUTING_ID=b"same")
    for each in (dealer, other):
        for body in (b"", b"x", b"y" * 255, b"z" * 256, b"w" * 2**20):
            each.send(body)
            assert each.recv_multipart() == [body]
            each.send_multipart([b"", body])
            assert each.recv_multipart() == [b"", body]


@pytest.mark.parametrize(
    ("frames", "answer"),
    [
        ([b"a", b"b"], [b"wrong"]),
        ([b"", b"a", b"b"], [b"", b"wrong"]),
        ([b"", b""] * 500, [b"", b"wrong"]),
        ([b"x" * 2**20] * 5, [b"wrong"]),
        ([b"x" * (2**21 + 1)], [b"long"]),
        ([b"", b"x" * 2**26], [b"", b"long"]),
    ],
)
def test_of_what_is_too_long_or_in_parts_only_that_is_known(
    served: Router, path: Path, context: zmq.Context[Any], frames: list[bytes], answer: list[bytes]
) -> None:
    dealer = zeromq(context, zmq.DEALER, path)
    dealer.send_multipart(frames)
    assert dealer.recv_multipart() == answer


def test_answers_come_in_the_order_of_the_requests(served: Router, path: Path, context: zmq.Context[Any]) -> None:
    dealer = zeromq(context, zmq.DEALER, path, SNDHWM=0, RCVHWM=0)
    sent = [b"%d" % number * (number % 500 + 1) for number in range(5000)]
    for body in sent:
        dealer.send(body)
    assert [dealer.recv() for _ in sent] == sent


def test_a_client_that_reads_late_loses_no_answer(path: Path) -> None:
    made = Router(listening(path))
    with echo(path, made):
        client = Raw(path)
        body = zmtp.message([b"x" * 10_000])
        sent = 0
        client.socket.settimeout(1)
        try:
            while sent < 10_000:
                client.socket.sendall(body)
                sent += 1
        except TimeoutError:
            pass
        assert 10 < sent < 1000, "it is not read from while it does not read"
        assert made._held <= peers.MAX_UNSENT_BYTES + 2 * len(body) + peers.MAX_READ_BYTES
        client.socket.settimeout(30)
        parser = zmtp.Parser(zmtp.Bounds(1, 10_000, 10_000))
        came = 0
        while came < sent:
            parser.feed(client.socket.recv(65536))
            while (event := parser.next()) is not None:
                came += isinstance(event, zmtp.Message)


@pytest.mark.parametrize("kind", [zmq.REQ, zmq.DEALER])
def test_an_answer_in_parts_arrives_whole_however_late_it_is_read(
    path: Path, context: zmq.Context[Any], kind: int
) -> None:
    large = bytes(range(256)) * 4_000
    answer = Encoded((b"head", large, b"middle", large, b"end"))
    made = Router(listening(path))
    client = zeromq(context, kind, path)
    client.send(b"1")
    request = made.receive(30)
    assert request is not None
    made.send(request.peer, request.delimited, answer)
    made.send(request.peer, request.delimited, b"next")
    assert request.peer.unsent > len(large)
    if kind == zmq.DEALER:
        client.send(b"2")
    while request.peer.out:
        made.receive(0.01)
    assert client.recv() == b"head" + large + b"middle" + large + b"end"
    if kind == zmq.DEALER:
        assert client.recv() == b"next"
    made.close()


def test_an_answer_to_one_who_has_gone_is_dropped(path: Path) -> None:
    made = Router(listening(path))
    client = Raw(path)
    client.socket.sendall(zmtp.message([b"a"]))
    request = None
    while request is None:
        request = made.receive(30)
    client.close()
    while len(made):
        made.receive(0.01)
    made.send(request.peer, False, b"a")
    assert request.peer.closed and not request.peer.out
    made.close()


def test_one_that_floods_over_many_connections_costs_another_a_turn_each() -> None:
    def one(uid: int, pid: int) -> Peer:
        return Peer(cast(Any, None), uid, pid, zmtp.Parser(zmtp.Bounds(1, 1, 1)))

    turns = TurnQueue()
    flood = [one(1, 10 + number // 10) for number in range(100)]
    for each in flood:
        turns.add(each)
    mine, other = one(2, 1), one(1, 5)
    turns.add(mine)
    turns.add(other)
    order = [turns.next() for _ in range(102)]
    assert order.index(mine) == 1
    assert order.index(other) < 13
    assert not turns
    assert {id(each) for each in order} == {id(each) for each in (*flood, mine, other)}


# ---- bounds


def ends(
    path: Path, made: Peers, serve: Callable[[], object], caplog: pytest.LogCaptureFixture, data: bytes, kind: bytes
) -> str:
    """Return the log of a client that sends these bytes repeatedly until it is disconnected."""
    stop = threading.Event()

    def turn() -> None:
        while not stop.is_set():
            serve()

    thread = threading.Thread(target=turn)
    thread.start()
    client = Raw(path, kind)
    try:
        with caplog.at_level(logging.INFO, "hapticd"):
            try:
                while True:
                    client.socket.sendall(data)
            except (BrokenPipeError, ConnectionResetError):
                pass
    finally:
        stop.set()
        made.wake()
        thread.join()
        made.close()
    return caplog.text


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"\x01\x01x" * 1000, "a message of more than 1,024 parts"),
        (b"\x01\x00" * 1000, "a message of more than 1,024 parts"),
        (zmtp.header(2**17, zmtp.MORE_FLAG) + bytes(2**17), "a message of more than 67,108,864 bytes"),
        (b"\x00\x00" + b"\x40", "the data is not ZMTP 3"),
        (zmtp.command(b"SUBSCRIBE", b"") + zmtp.command(b"READY", b""), "unexpected command"),
    ],
)
def test_requests_without_end_end_the_connection(
    path: Path, caplog: pytest.LogCaptureFixture, data: bytes, reason: str
) -> None:
    made = Router(listening(path))
    text = ends(path, made, lambda: made.receive(0.1), caplog, data, b"DEALER")
    assert f"process {os.getpid()} of user {os.getuid()} was disconnected: {reason}" in text


def test_subscriptions_without_end_end_the_connection(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = Publisher(listening(path), TOPICS)
    data = b"".join(zmtp.message([b"\x01%d" % number]) for number in range(100))
    text = ends(path, made, lambda: made.wait(0.1), caplog, data, b"SUB")
    assert "was disconnected: more than 1,000 subscriptions that match no topic" in text


def test_a_wake_after_the_end_writes_to_no_file_that_has_the_number_then(path: Path) -> None:
    made = Router(listening(path))
    made.close()
    others = [os.eventfd(0, os.EFD_NONBLOCK) for _ in range(8)]
    try:
        made.wake()
        for other in others:
            with pytest.raises(BlockingIOError):
                os.eventfd_read(other)
    finally:
        for other in others:
            os.close(other)


def test_a_subscription_takes_no_memory_that_matches_nothing(path: Path, context: zmq.Context[Any]) -> None:
    made = Publisher(listening(path), TOPICS)
    sub = zeromq(context, zmq.SUB, path)
    for number in range(900):
        sub.setsockopt(zmq.SUBSCRIBE, b"no topic %d" % number)
    sub.setsockopt(zmq.SUBSCRIBE, b"st")
    while not any(each.subscriptions for each in made._peers.values()):
        made.wait(0.05)
    (peer,) = made._peers.values()
    assert peer.subscriptions == {b"st": 1}
    made.close()


def test_connections_of_one_process_are_bounded(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    limits = replace(router.COMMAND_SOCKET_LIMITS, process_connections=10)
    made = Router(listening(path), limits)
    clients = [Raw(path) for _ in range(40)]
    for client in clients[10:]:
        while len(made) < 10:
            made.receive(0.01)
        thread = threading.Thread(target=client.ended)
        thread.start()
        while thread.is_alive():
            made.receive(0.01)
    assert len(made) == 10
    assert "the process already has 10 connections" in caplog.text
    clients[3].close()
    while len(made) == 10:
        made.receive(0.01)
    late = Raw(path)
    late.socket.sendall(zmtp.message([b"late"]))
    request = None
    while request is None:
        request = made.receive(1)
    assert request.body == b"late"
    made.close()


def test_who_has_most_connections_makes_room_for_another(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    owners = [(1, 100)] * 8 + [(2, 200), (2, 201), (2, 202), (1, 100)]
    came = iter(owners)

    class Owned(Peer):
        def __init__(self, sock: socket.socket, uid: int, pid: int, parser: zmtp.Parser) -> None:
            super().__init__(sock, *next(came), parser)

    monkeypatch.setattr(peers, "Peer", Owned)
    made = Router(listening(path), replace(router.COMMAND_SOCKET_LIMITS, connections=10))
    clients = [Raw(path) for _ in owners]
    while made._owners.get(2, {}).keys() != {200, 201, 202}:
        made.receive(0.01)
    thread = threading.Thread(target=clients[-1].ended)
    thread.start()
    while thread.is_alive():
        made.receive(0.01)
    there = sorted((peer.uid, peer.pid) for peer in made._peers.values())
    assert there == [(1, 100)] * 7 + [(2, 200), (2, 201), (2, 202)]
    made.close()


def test_who_holds_most_memory_is_disconnected_when_all_hold_too_much(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made = Router(listening(path), replace(router.COMMAND_SOCKET_LIMITS, buffers=3_000_000))
    clients = [Raw(path) for _ in range(4)]
    small = clients[0]
    small.socket.sendall(zmtp.header(200) + b"x" * 100)
    threads = [
        threading.Thread(target=client.socket.sendall, args=(zmtp.header(2_000_000) + b"x" * 1_900_000,), daemon=True)
        for client in clients[1:2]
    ]
    for thread in threads:
        thread.start()
    while made._held < 1_900_000:
        made.receive(0.01)
    second = threading.Thread(target=clients[2].socket.sendall, args=(zmtp.header(2_000_000) + b"x" * 1_500_000,))
    second.start()
    while "buffers, all clients" not in caplog.text:
        made.receive(0.01)
    while second.is_alive():
        made.receive(0.01)
    assert clients[1].ended()
    assert made._held <= 3_000_000
    small.socket.sendall(b"x" * 100)
    request = None
    while request is None:
        request = made.receive(1)
    assert request.body == b"x" * 200
    made.close()
    assert made._held == 0


def test_a_handshake_that_does_not_end_is_ended(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "HANDSHAKE_TIMEOUT_S", 0.0)
    made = Router(listening(path))
    client = Raw(path, shake=False)
    client.socket.sendall(zmtp.ZMTP_GREETING)
    thread = threading.Thread(target=client.ended)
    thread.start()
    while thread.is_alive():
        made.receive(0.01)
    assert len(made) == 0
    made.close()


def test_without_a_descriptor_left_clients_wait_and_the_thread_sleeps(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    made = Router(listening(path))

    class Full:
        def __init__(self, real: socket.socket) -> None:
            self.real, self.tries = real, 0

        def accept(self) -> Any:
            self.tries += 1
            if self.tries < 3:
                raise OSError(24, "Too many open files")
            return self.real.accept()

        def fileno(self) -> int:
            return self.real.fileno()

        def close(self) -> None:
            self.real.close()

    full = Full(made._listening)
    monkeypatch.setattr(made, "_listening", full)
    client = Raw(path)
    client.socket.sendall(zmtp.message([b"a"]))
    request = None
    while request is None:
        request = made.receive(1)
    assert full.tries >= 3
    assert "cannot accept clients at the moment: Too many open files" in caplog.text
    made.close()


# ---- telemetry


@pytest.mark.parametrize("kind", [zmq.SUB, zmq.XSUB])
def test_a_subscriber_gets_what_it_asked_for(path: Path, context: zmq.Context[Any], kind: int) -> None:
    made = Publisher(listening(path), TOPICS)
    sub = zeromq(context, kind, path)

    def subscribe(topic: bytes, wanted: bool = True) -> None:
        if kind == zmq.XSUB:
            sub.send(bytes((wanted,)) + topic)
        else:
            sub.setsockopt(zmq.SUBSCRIBE if wanted else zmq.UNSUBSCRIBE, topic)

    def wait_for(*topics: bytes) -> None:
        while {name for name, peers in made._subscribers.items() if peers} != set(topics):
            made.wait(0.01)

    subscribe(b"sta")
    wait_for(b"state", b"status")
    for topic in TOPICS:
        made.publish(topic, topic.encode())
    assert [sub.recv_multipart() for _ in range(2)] == [[b"state", b"state"], [b"status", b"status"]]
    subscribe(b"")
    wait_for(*(topic.encode() for topic in TOPICS))
    subscribe(b"", False)
    wait_for(b"state", b"status")
    subscribe(b"sta", False)
    wait_for()
    subscribe(b"event")
    wait_for(b"event")
    made.publish("event", b"x" * 2**20)
    while any(peer.out for peer in made._peers.values()):
        made.wait(0.01)
    assert sub.recv_multipart() == [b"event", b"x" * 2**20]
    made.close()


def test_who_does_not_read_loses_the_oldest_and_costs_nobody_anything(path: Path) -> None:
    made = Publisher(listening(path), TOPICS)
    deaf = [Raw(path, b"SUB") for _ in range(20)]
    reading = Raw(path, b"SUB")
    for client in (*deaf, reading):
        client.socket.sendall(zmtp.message([b"\x01samples"]))
    while len(made._subscribers[b"samples"]) < 21:
        made.wait(0.01)
    reading.socket.setblocking(False)
    parser = zmtp.Parser(zmtp.Bounds(2, 100_000, 100_000))
    came: list[int] = []

    def read() -> None:
        while True:
            try:
                parser.feed(reading.socket.recv(65536))
            except BlockingIOError:
                return
            while (event := parser.next()) is not None:
                if isinstance(event, zmtp.Message):
                    came.append(int.from_bytes(event.frames[1][:4], "big"))

    for number in range(1000):
        made.publish("samples", number.to_bytes(4, "big") + bytes(20_000))
        made.wait(0)
        read()
    assert came == list(range(1000))
    assert {len(queue) for queue in made._queues.values()} == {publisher.MAX_QUEUED_MESSAGES}
    kept = {id(data) for queue in made._queues.values() for _, data in queue._messages}
    assert len(kept) <= publisher.MAX_QUEUED_MESSAGES + 1, "each has messages of its own"
    made._reported_s = 0.0  # as if a second had passed
    made.wait(0)
    lost = [peer.lost for peer in made._peers.values()]
    assert sum(lost) >= 20 * 500 and min(lost) == 0
    made.close()


def test_who_unsubscribes_without_reading_keeps_nothing_of_it(path: Path) -> None:
    made = Publisher(listening(path), TOPICS)
    deaf = Raw(path, b"SUB")
    deaf.socket.sendall(zmtp.message([b"\x01samples"]) + zmtp.message([b"\x01event"]))
    while not made._subscribers[b"event"]:
        made.wait(0.01)
    (peer,) = made._peers.values()
    while len(made._queues.get(peer, ())) < 100:
        made.publish("samples", bytes(20_000))
    made.publish("event", b"last")
    peer.unsent = 0  # as if the peer accepted the rest of the message
    deaf.socket.sendall(zmtp.message([b"\x00samples"]))
    while made.wants("samples"):
        made.wait(0.01)
    assert len(made._queues[peer]) == 1 and made.wants("event")
    made.close()


def test_what_was_published_last_arrives_though_it_ends(path: Path, context: zmq.Context[Any]) -> None:
    made = Publisher(listening(path), TOPICS)
    sub = zeromq(context, zmq.SUB, path, RCVHWM=0)
    sub.setsockopt(zmq.SUBSCRIBE, b"")
    while not made._subscribers[b"event"]:
        made.wait(0.01)
    for number in range(300):
        made.publish("event", b"%d" % number + bytes(10_000))
    made.close(linger_s=30)
    assert [int(sub.recv_multipart()[1].rstrip(b"\0")) for _ in range(300)] == list(range(300))


def test_a_socket_of_another_kind_is_refused(
    path: Path, context: zmq.Context[Any], caplog: pytest.LogCaptureFixture
) -> None:
    made = Publisher(listening(path), TOPICS)
    client = Raw(path, b"DEALER")
    thread = threading.Thread(target=client.ended)
    thread.start()
    while thread.is_alive():
        made.wait(0.01)
    assert "socket type must be one of SUB, XSUB" in caplog.text
    made.close()
