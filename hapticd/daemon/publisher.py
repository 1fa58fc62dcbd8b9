"""The telemetry socket, a PUB: sends the messages that `telemetry.py` made to those who subscribed to them.

What a subscriber does not take at once waits in a queue, whose oldest messages are dropped beyond MESSAGES and BYTES.
All queues share the same messages, so a thousand of them need little more memory than one.
"""

from __future__ import annotations

import errno
import itertools
import logging
import socket
import time
from collections import deque
from collections.abc import Sequence
from typing import Final

from hapticd.base import wording
from hapticd.base.core import ffi, lib
from hapticd.daemon.peers import Limits, Peer, Peers
from hapticd.protocol import zmtp
from hapticd.system.repeated_lines import Since

QUEUED_MESSAGES: Final = 400
"""In the queue of a subscriber; eight seconds of samples."""
QUEUED_BYTES: Final = 10 * 1024 * 1024
"""In that queue, the newest message not counted."""
MOST_USELESS: Final = 1000
"""Subscriptions to nothing that there is, and messages that are none, until a subscriber is disconnected."""

_TURNS_AT_ONCE: Final = 20
_REST_S: Final = 0.005
_TELL_EVERY_S: Final = 1.0

LIMITS: Final = Limits(zmtp.Bounds(frames=1, size=4096, kept=4096))

_log = logging.getLogger(__name__)


class Queue:
    """Messages that wait for one subscriber, with their topics, and how many were dropped."""

    __slots__ = ("_bytes", "_messages", "dropped")

    def __init__(self) -> None:
        self._messages: deque[tuple[bytes, bytes]] = deque()
        self._bytes = 0
        self.dropped = 0
        """Since this was reported last."""

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, topic: bytes, data: bytes) -> None:
        """Appends a message; the oldest give way."""
        self._messages.append((topic, data))
        self._bytes += len(data)
        while len(self) > QUEUED_MESSAGES or (self._bytes > QUEUED_BYTES and len(self) > 1):
            self.take()
            self.dropped += 1

    def take(self) -> bytes:
        """The oldest message. Raises IndexError where there is none."""
        _, data = self._messages.popleft()
        self._bytes -= len(data)
        return data

    def remove(self, topic: bytes) -> None:
        """Forgets the messages of a topic."""
        self._messages = deque(each for each in self._messages if each[0] != topic)
        self._bytes = sum(len(data) for _, data in self._messages)


class Publisher(Peers):
    """The subscribers, and what each waits for. For one thread."""

    kind = b"PUB"
    partners = frozenset((b"SUB", b"XSUB"))

    def __init__(self, listening: socket.socket, topics: Sequence[str], limits: Limits = LIMITS) -> None:
        """`topics`: all that will be published."""
        super().__init__(listening, limits)
        self._subscribers: dict[bytes, dict[Peer, None]] = {topic.encode(): {} for topic in topics}
        self._queues: dict[Peer, Queue] = {}
        """Of those that do not keep up."""
        self._reported_s = time.monotonic()
        # Whatever else is subscribed to can match nothing.
        self._useful = {topic[:length] for topic in self._subscribers for length in range(len(topic) + 1)}

    def wants(self, topic: str) -> bool:
        """Whether anybody subscribed to it."""
        return bool(self._subscribers[topic.encode()])

    def publish(self, topic: str, body: bytes, data: bytes | memoryview = b"") -> None:
        """To all who subscribed to it; `data` is sent from where it stands, behind `body`."""
        name = topic.encode()
        head = zmtp.header(len(name), zmtp.MORE_FLAG) + name + zmtp.header(len(body) + len(data)) + body
        waiting = [peer for peer in self._subscribers[name] if peer.out]
        if waiting:
            whole = b"".join((head, data))  # one copy for all: what stands in `data` is another message soon
            for peer in waiting:
                self._queues.setdefault(peer, Queue()).put(name, whole)
        listening = [peer for peer in self._subscribers[name] if not peer.out]
        if listening:
            self._send_each(listening, head, data)

    def _send_each(self, peers: list[Peer], head: bytes, data: bytes | memoryview) -> None:
        """To those that keep up; the rest of what one does not take waits."""
        size, taken = len(head) + len(data), ffi.new("int64_t[]", len(peers))
        sockets = ffi.new("int32_t[]", [peer.sock.fileno() for peer in peers])
        lib.hd_send_each(
            sockets,
            len(peers),
            ffi.from_buffer("char[]", head),
            len(head),
            ffi.from_buffer("char[]", data),
            len(data),
            taken,
        )
        whole: bytes | None = None
        for peer, count in zip(peers, taken, strict=True):
            if count == size or peer.closed:  # one that held too much may have been ended meanwhile
                continue
            if count < 0 and -count not in (errno.EAGAIN, errno.EWOULDBLOCK):
                self._end(peer)
                continue
            whole = whole or b"".join((head, data))
            self._keep(peer, (memoryview(whole)[max(count, 0) :],))

    def wait(self, timeout_s: float) -> None:
        """Serves those who listen for so long, at least one of them; returns at once when somebody calls `wake`."""
        until_s = time.monotonic() + timeout_s
        for turn in itertools.count(1):
            came = self._turn(timeout_s)
            if came is not None:
                self._hear(*came)
            timeout_s = until_s - time.monotonic()
            if self._woken or timeout_s <= 0:
                self._woken = False
                self._tell_losses()
                self._repeats.flush()
                return
            if turn % _TURNS_AT_ONCE == 0:
                # What is said here is not urgent, and another thread serves commands.
                time.sleep(min(timeout_s, _REST_S))
                timeout_s = until_s - time.monotonic()

    def _hear(self, peer: Peer, event: zmtp.Message | zmtp.Command) -> None:
        match event:
            case zmtp.Message([frame]) if frame[:1] in (b"\x00", b"\x01"):
                self._subscribe(peer, frame[1:], frame[0] == 1)
            case zmtp.Command(b"SUBSCRIBE"):
                self._subscribe(peer, event.data, True)
            case zmtp.Command(b"CANCEL"):
                self._subscribe(peer, event.data, False)
            case _:
                self._useless(peer)

    def _subscribe(self, peer: Peer, prefix: bytes, wanted: bool) -> None:
        if prefix not in self._useful:
            self._useless(peer)
            return
        count = peer.subscriptions.get(prefix, 0) + (1 if wanted else -1)
        if count > 0:
            peer.subscriptions[prefix] = count
        else:
            peer.subscriptions.pop(prefix, None)
        for topic, subscribers in self._subscribers.items():
            if any(topic.startswith(each) for each in peer.subscriptions):
                subscribers[peer] = None
            elif peer in subscribers:
                del subscribers[peer]
                if peer in self._queues:
                    self._queues[peer].remove(topic)

    def _useless(self, peer: Peer) -> None:
        peer.useless += 1
        if peer.useless > MOST_USELESS:
            self._end(peer, f"more than {MOST_USELESS:,} subscriptions to what there is not")

    def _refill(self, peer: Peer) -> None:
        queue = self._queues.get(peer)
        if queue:
            data = queue.take()
            peer.out.append(data)
            peer.unsent += len(data)
        elif queue is not None:
            self._forget(peer)

    def _forget(self, peer: Peer) -> None:
        queue = self._queues.pop(peer, None)
        if queue is not None:
            self._tell_loss(peer, queue)

    def _tell_losses(self) -> None:
        """Once a second."""
        if time.monotonic() >= self._reported_s + _TELL_EVERY_S:
            self._reported_s = time.monotonic()
            for peer, queue in self._queues.items():
                self._tell_loss(peer, queue)

    def _tell_loss(self, peer: Peer, queue: Queue) -> None:
        if not queue.dropped:
            return
        peer.lost += queue.dropped

        def tell(since: Since) -> None:
            lost = wording.count(since.amounts["messages"], "message")
            _log.info("%s does not keep up with telemetry: %s dropped %s", peer, lost, since.window)

        self._repeats.note(f"lost {peer.uid} {peer.pid}", tell, {"messages": queue.dropped})
        queue.dropped = 0

    def _end(self, peer: Peer, why: str | None = None) -> None:
        super()._end(peer, why)
        self._forget(peer)
        for subscribers in self._subscribers.values():
            subscribers.pop(peer, None)
