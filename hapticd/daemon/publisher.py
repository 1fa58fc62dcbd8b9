"""The telemetry socket, a ZeroMQ PUB: sends the messages of `telemetry.py` to their subscribers.

Messages that a subscriber does not accept at once wait in its queue. Beyond MAX_QUEUED_MESSAGES or MAX_QUEUED_BYTES the
oldest are dropped. Queues share the messages, so that a thousand queues need little more memory than one.
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

MAX_QUEUED_MESSAGES: Final = 400
"""Largest number of messages in the queue of a subscriber: eight seconds of samples."""
MAX_QUEUED_BYTES: Final = 10 * 1024 * 1024
"""Largest number of bytes in the queue of a subscriber, without the newest message."""
MAX_USELESS_SUBSCRIPTIONS: Final = 1000
"""Number of invalid messages and subscriptions to no topic above which a subscriber is disconnected."""

_MAX_TURNS_PER_WAIT: Final = 20
"""Number of served subscribers (turns) after which the telemetry thread pauses for the command thread."""
_TURNS_PAUSE_S: Final = 0.005
"""Pause of the telemetry thread after _MAX_TURNS_PER_WAIT turns."""
_LOSS_LOG_INTERVAL_S: Final = 1.0
"""Interval in which dropped messages are logged."""

TELEMETRY_SOCKET_LIMITS: Final = Limits(zmtp.Bounds(frames=1, size=4096, kept=4096))

_log = logging.getLogger(__name__)


class Queue:
    """Messages that wait for one subscriber, with their topics, and the number of dropped ones."""

    __slots__ = ("_bytes", "_messages", "dropped")

    def __init__(self) -> None:
        self._messages: deque[tuple[bytes, bytes]] = deque()
        self._bytes = 0
        self.dropped = 0
        """Number of messages dropped since the last log line about them."""

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, topic: bytes, data: bytes) -> None:
        """Append a message, and drop the oldest messages beyond MAX_QUEUED_MESSAGES or MAX_QUEUED_BYTES."""
        self._messages.append((topic, data))
        self._bytes += len(data)
        while len(self) > MAX_QUEUED_MESSAGES or (self._bytes > MAX_QUEUED_BYTES and len(self) > 1):
            self.take()
            self.dropped += 1

    def take(self) -> bytes:
        """Remove and return the oldest message. Raises IndexError if the queue is empty."""
        _, data = self._messages.popleft()
        self._bytes -= len(data)
        return data

    def remove(self, topic: bytes) -> None:
        """Remove the messages of a topic from the queue."""
        self._messages = deque(each for each in self._messages if each[0] != topic)
        self._bytes = sum(len(data) for _, data in self._messages)


class Publisher(Peers):
    """The subscribers of telemetry and their queues. For one thread."""

    kind = b"PUB"
    partners = frozenset((b"SUB", b"XSUB"))

    def __init__(
        self, listening: socket.socket, topics: Sequence[str], limits: Limits = TELEMETRY_SOCKET_LIMITS
    ) -> None:
        """Serve the subscribers of the socket `listening`. `topics`: all topics that will be published."""
        super().__init__(listening, limits)
        self._subscribers: dict[bytes, dict[Peer, None]] = {topic.encode(): {} for topic in topics}
        self._queues: dict[Peer, Queue] = {}
        """Queues of the subscribers that do not keep up."""
        self._reported_s = time.monotonic()
        # Subscriptions to other prefixes match no topic.
        self._useful = {topic[:length] for topic in self._subscribers for length in range(len(topic) + 1)}

    def wants(self, topic: str) -> bool:
        """Return whether a topic has subscribers."""
        return bool(self._subscribers[topic.encode()])

    def publish(self, topic: str, body: bytes, data: bytes | memoryview = b"") -> None:
        """Send `body` followed by `data` to all subscribers of a topic; `data` is not copied unless it must wait."""
        name = topic.encode()
        head = zmtp.header(len(name), zmtp.MORE_FLAG) + name + zmtp.header(len(body) + len(data)) + body
        waiting = [peer for peer in self._subscribers[name] if peer.out]
        if waiting:
            message = b"".join((head, data))  # one copy for all: the buffer `data` will be reused
            for peer in waiting:
                self._queues.setdefault(peer, Queue()).put(name, message)
        listening = [peer for peer in self._subscribers[name] if not peer.out]
        if listening:
            self._send_each(listening, head, data)

    def _send_each(self, peers: list[Peer], head: bytes, data: bytes | memoryview) -> None:
        """Send a message to subscribers with an empty queue; bytes that a subscriber does not accept are queued."""
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
        message: bytes | None = None
        for peer, count in zip(peers, taken, strict=True):
            if count == size or peer.closed:  # `_keep` may have ended a peer that uses too much memory
                continue
            if count < 0 and -count not in (errno.EAGAIN, errno.EWOULDBLOCK):
                self._end(peer)
                continue
            message = message or b"".join((head, data))
            self._keep(peer, (memoryview(message)[max(count, 0) :],))

    def wait(self, timeout_s: float) -> None:
        """Serve subscribers for `timeout_s`, at least one of them; return at once when `wake` is called."""
        until_s = time.monotonic() + timeout_s
        for turn in itertools.count(1):
            came = self._turn(timeout_s)
            if came is not None:
                self._handle(*came)
            timeout_s = until_s - time.monotonic()
            if self._woken or timeout_s <= 0:
                self._woken = False
                self._log_losses()
                self._repeats.flush()
                return
            if turn % _MAX_TURNS_PER_WAIT == 0:
                # Subscriptions are not urgent, and the command thread needs the interpreter.
                time.sleep(min(timeout_s, _TURNS_PAUSE_S))
                timeout_s = until_s - time.monotonic()

    def _handle(self, peer: Peer, event: zmtp.Message | zmtp.Command) -> None:
        match event:
            case zmtp.Message([frame]) if frame[:1] in (b"\x00", b"\x01"):
                self._subscribe(peer, frame[1:], frame[0] == 1)
            case zmtp.Command(b"SUBSCRIBE"):
                self._subscribe(peer, event.data, True)
            case zmtp.Command(b"CANCEL"):
                self._subscribe(peer, event.data, False)
            case _:
                self._count_useless(peer)

    def _subscribe(self, peer: Peer, prefix: bytes, wanted: bool) -> None:
        if prefix not in self._useful:
            self._count_useless(peer)
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

    def _count_useless(self, peer: Peer) -> None:
        peer.useless += 1
        if peer.useless > MAX_USELESS_SUBSCRIPTIONS:
            self._end(peer, f"more than {MAX_USELESS_SUBSCRIPTIONS:,} subscriptions that match no topic")

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
            self._log_loss(peer, queue)

    def _log_losses(self) -> None:
        if time.monotonic() >= self._reported_s + _LOSS_LOG_INTERVAL_S:
            self._reported_s = time.monotonic()
            for peer, queue in self._queues.items():
                self._log_loss(peer, queue)

    def _log_loss(self, peer: Peer, queue: Queue) -> None:
        if not queue.dropped:
            return
        peer.lost += queue.dropped

        def log(since: Since) -> None:
            lost = wording.count(since.amounts["messages"], "message")
            _log.info("%s does not keep up with telemetry: %s dropped %s", peer, lost, since.window)

        self._repeats.note(f"lost {peer.uid} {peer.pid}", log, {"messages": queue.dropped})
        queue.dropped = 0

    def _end(self, peer: Peer, why: str | None = None) -> None:
        super()._end(peer, why)
        self._forget(peer)
        for subscribers in self._subscribers.values():
            subscribers.pop(peer, None)
