"""The telemetry socket, a PUB: sends the messages that `telemetry.py` made to those who subscribed to them.

A subscriber that does not keep up loses the oldest of what waits for it (`backlog.py`).
"""

from __future__ import annotations

import errno
import itertools
import logging
import socket
import time
from collections.abc import Sequence
from typing import Final

from hapticd.base import wording
from hapticd.base.core import ffi, lib
from hapticd.daemon.backlog import Backlog, Reader
from hapticd.daemon.peers import Limits, Peer, Peers
from hapticd.protocol import zmtp
from hapticd.system.repeated_lines import Since

MOST_USELESS: Final = 1000
"""Subscriptions to nothing that there is, and messages that are none, until a subscriber is disconnected."""

_TURNS_AT_ONCE: Final = 20
_REST_S: Final = 0.005
_TELL_EVERY_S: Final = 1.0

LIMITS: Final = Limits(zmtp.Bounds(frames=1, size=4096, kept=4096))

_log = logging.getLogger(__name__)


class Publisher(Peers):
    """The subscribers, and what each waits for. For one thread."""

    kind = b"PUB"
    partners = frozenset((b"SUB", b"XSUB"))

    def __init__(self, listening: socket.socket, topics: Sequence[str], limits: Limits = LIMITS) -> None:
        """`topics`: all that will be published."""
        super().__init__(listening, limits)
        self._subscribers: dict[bytes, dict[Peer, None]] = {topic.encode(): {} for topic in topics}
        """Those who keep up."""
        self._behind: dict[Peer, Reader] = {}
        self._backlog = Backlog(self._subscribers)
        self._reported_s = time.monotonic()
        # Whatever else is subscribed to can match nothing.
        self._useful = {topic[:length] for topic in self._subscribers for length in range(len(topic) + 1)}

    def wants(self, topic: str) -> bool:
        """Whether anybody subscribed to it."""
        name = topic.encode()
        return bool(self._subscribers[name]) or self._backlog.waits(name)

    def publish(self, topic: str, body: bytes, data: bytes | memoryview = b"") -> None:
        """To all who subscribed to it; `data` is sent from where it stands, behind `body`."""
        name = topic.encode()
        listening = self._subscribers[name]
        for peer in [each for each in listening if each.out]:
            self._fall_behind(peer)
        if not self.wants(topic):
            return
        head = zmtp.header(len(name), zmtp.MORE) + name + zmtp.header(len(body) + len(data)) + body
        if self._backlog.waits(name):
            self._backlog.put(name, b"".join((head, data)))
        if listening:
            self._send_each(list(listening), head, data)

    def _send_each(self, peers: list[Peer], head: bytes, data: bytes | memoryview) -> None:
        """To those that keep up. Who does not take all of it falls behind."""
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
            if whole is None:  # one copy for all: what stands in `data` is another message soon
                whole = b"".join((head, data))
            self._keep(peer, (memoryview(whole)[max(count, 0) :],))
            self._fall_behind(peer)

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
        behind = self._behind.get(peer)
        for topic, subscribers in self._subscribers.items():
            wanted = any(topic.startswith(each) for each in peer.subscriptions)
            if behind is None:
                if wanted:
                    subscribers[peer] = None
                else:
                    subscribers.pop(peer, None)
            elif wanted:
                self._backlog.join(behind, topic)
            else:
                self._backlog.leave(behind, topic)

    def _useless(self, peer: Peer) -> None:
        peer.useless += 1
        if peer.useless > MOST_USELESS:
            self._end(peer, f"more than {MOST_USELESS:,} subscriptions to what there is not")

    def _fall_behind(self, peer: Peer) -> None:
        """What is sent from now on waits until it took what was sent before."""
        behind = self._behind[peer] = Reader()
        for topic, subscribers in self._subscribers.items():
            if peer in subscribers:
                del subscribers[peer]
                self._backlog.join(behind, topic)

    def _refill(self, peer: Peer) -> None:
        behind = self._behind.get(peer)
        if behind is None:
            return
        data = self._backlog.take(behind)
        if data is None:
            topics = list(behind.next)
            self._forget(peer)
            for topic in topics:
                self._subscribers[topic][peer] = None
        else:
            peer.out.append(data)
            peer.unsent += len(data)

    def _forget(self, peer: Peer) -> None:
        """It is not behind any more."""
        behind = self._behind.pop(peer, None)
        if behind is not None:
            self._tell_loss(peer, behind)
            for topic in list(behind.next):
                self._backlog.leave(behind, topic)

    def _tell_losses(self) -> None:
        """Once a second."""
        if time.monotonic() >= self._reported_s + _TELL_EVERY_S:
            self._reported_s = time.monotonic()
            for peer, behind in self._behind.items():
                self._tell_loss(peer, behind)

    def _tell_loss(self, peer: Peer, behind: Reader) -> None:
        lost = self._backlog.lost(behind)
        if not lost:
            return
        peer.lost += lost

        def tell(since: Since) -> None:
            lost = wording.count(since.amounts["messages"], "message")
            _log.info("%s does not keep up with telemetry: %s dropped %s", peer, lost, since.window)

        self._repeats.note(f"lost {peer.uid} {peer.pid}", tell, {"messages": lost})

    def _end(self, peer: Peer, why: str | None = None) -> None:
        super()._end(peer, why)
        self._forget(peer)
        for subscribers in self._subscribers.values():
            subscribers.pop(peer, None)
