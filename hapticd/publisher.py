"""Telemetry out: the PUB of the telemetry socket.

A subscriber that does not keep up loses the oldest of what waits for it. So all who do not hold the same newest
messages, and a thousand of them take no more memory than one.
"""

from __future__ import annotations

import itertools
import logging
import socket
import time
from collections import deque
from collections.abc import Sequence
from typing import Final

from hapticd import words, zmtp
from hapticd.peers import MESSAGES_WAITING, Limits, Peer, Peers
from hapticd.repeats import Since

MOST_USELESS: Final = 1000
"""Subscriptions to nothing that there is, and messages that are none, until a subscriber is disconnected."""

_TURNS_AT_ONCE: Final = 20
_REST_S: Final = 0.005

LIMITS: Final = Limits(zmtp.Bounds(frames=1, size=4096, kept=4096))

_log = logging.getLogger(__name__)


class Publisher(Peers):
    """Who listens, for one thread."""

    kind = b"PUB"
    partners = frozenset((b"SUB", b"XSUB"))

    def __init__(self, listening: socket.socket, topics: Sequence[str], limits: Limits = LIMITS) -> None:
        """`topics`: all that will be published."""
        super().__init__(listening, limits)
        self._subscribers: dict[bytes, dict[Peer, None]] = {topic.encode(): {} for topic in topics}
        # Whatever else is subscribed to can match nothing.
        self._useful = {topic[:length] for topic in self._subscribers for length in range(len(topic) + 1)}

    def publish(self, topic: str, body: bytes) -> None:
        """To all who subscribed to it."""
        name = topic.encode()
        listening = self._subscribers[name]
        if not listening:
            return
        data = zmtp.message([name, body])
        for peer in list(listening):
            if peer.out:
                if len(peer.backlog) == MESSAGES_WAITING:
                    self._lose(peer)
                peer.backlog.append((name, data))
            else:
                self._send(peer, data)

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
            elif subscribers.pop(peer, ()) is None:
                # What waits is shared as long as it is what comes now.
                peer.backlog = deque((each for each in peer.backlog if each[0] != topic), MESSAGES_WAITING)

    def _useless(self, peer: Peer) -> None:
        peer.useless += 1
        if peer.useless > MOST_USELESS:
            self._end(peer, f"more than {MOST_USELESS:,} subscriptions to what there is not")

    def _lose(self, peer: Peer) -> None:
        peer.lost += 1

        def tell(since: Since) -> None:
            lost = words.count(since.amounts["messages"], "message")
            _log.info("%s does not keep up with telemetry: %s dropped %s", peer, lost, since.window)

        self._repeats.note(f"lost {peer.uid} {peer.pid}", tell, {"messages": 1})

    def _refill(self, peer: Peer) -> None:
        if peer.backlog:
            data = peer.backlog.popleft()[1]
            peer.out.append(data)
            peer.unsent += len(data)

    def _end(self, peer: Peer, why: str | None = None) -> None:
        super()._end(peer, why)
        for subscribers in self._subscribers.values():
            subscribers.pop(peer, None)
        peer.backlog.clear()
