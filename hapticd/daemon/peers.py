"""A listening Unix socket and its ZeroMQ peers, for one thread, without libzmq (docs/adr/0024).

A turn serves one peer: at most one read and one message. Descriptors and memory of a peer are limited: a peer that
exceeds a limit is disconnected, and the log names its process and user. `router.py` and `publisher.py` are the command
and the telemetry socket.
"""

from __future__ import annotations

import logging
import os
import select
import socket
import struct
import time
from collections import OrderedDict, deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Final

from hapticd.base import wording
from hapticd.protocol import zmtp
from hapticd.system.open_files import MAX_SOCKET_CONNECTIONS
from hapticd.system.repeated_lines import Repeats

HANDSHAKE_TIMEOUT_S: Final = 5.0
"""Time after connecting within which the handshake must be complete, as docs/protocol.md states."""
MAX_UNSENT_BYTES: Final = 256 * 1024
"""Number of unsent bytes to a peer above which nothing is read from the peer."""
MAX_READ_BYTES: Final = 64 * 1024
"""Largest number of bytes read from a peer in one turn."""

_MAX_ACCEPTED_PER_TURN: Final = 16
"""Largest number of connections accepted before connected peers get a turn, so that a flood does not delay them."""
_MAX_EPOLL_EVENTS: Final = 64
"""Largest number of events taken from epoll at once."""
_ACCEPT_RETRY_S: Final = 0.1
"""Pause before the next attempt to accept a connection, after the process ran out of descriptors."""
_MAX_WRITTEN_BYTES_PER_TURN: Final = 1024 * 1024
"""Number of bytes written to a peer after which other peers get a turn."""
_READ_EVENTS: Final = select.EPOLLIN | select.EPOLLET
_READ_AND_WRITE_EVENTS: Final = _READ_EVENTS | select.EPOLLOUT
_UCRED_STRUCT: Final = struct.Struct("3i")
"""`struct ucred` of the socket option SO_PEERCRED: pid, uid, gid."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the connections and the messages of a socket."""

    message: zmtp.Bounds
    connections: int = MAX_SOCKET_CONNECTIONS
    process_connections: int = MAX_SOCKET_CONNECTIONS // 4
    buffers: int = 96 * 1024 * 1024
    """Largest number of bytes in incomplete messages and unread answers, of all peers together."""

    def of(self, connections: int) -> Limits:
        """Return these limits with a different number of connections."""
        return replace(self, connections=connections, process_connections=max(4, connections // 4))


@dataclass(eq=False, slots=True)
class Peer:
    """A connected ZeroMQ peer. `held` is the number of bytes of the peer that count towards Limits.buffers."""

    sock: socket.socket
    uid: int
    pid: int
    parser: zmtp.Parser
    began_s: float = field(default_factory=time.monotonic)
    ready: bool = False
    closed: bool = False
    queued: bool = False
    readable: bool = False
    out: deque[bytes | memoryview] = field(default_factory=deque)
    unsent: int = 0
    held: int = 0
    # Used by the telemetry socket only: subscriptions by prefix, subscriptions to no topic, dropped messages.
    subscriptions: dict[bytes, int] = field(default_factory=dict)
    useless: int = 0
    lost: int = 0

    def __str__(self) -> str:
        return f"process {self.pid} of user {self.uid}"


class TurnQueue:
    """A fair queue of peers: round-robin over users, over the processes of a user, and over a process's connections.

    A peer that sends much delays another peer by one turn at a time.
    """

    def __init__(self) -> None:
        self._users: OrderedDict[int, OrderedDict[int, deque[Peer]]] = OrderedDict()

    def __bool__(self) -> bool:
        return bool(self._users)

    def add(self, waiting: Peer) -> None:
        """Add a peer behind the other waiting peers of its process."""
        processes = self._users.get(waiting.uid)
        if processes is None:
            processes = self._users[waiting.uid] = OrderedDict()
        queue = processes.get(waiting.pid)
        if queue is None:
            queue = processes[waiting.pid] = deque()
        queue.append(waiting)

    def next(self) -> Peer:
        """Remove and return the peer to serve next. Raises KeyError if the queue is empty."""
        uid, processes = self._users.popitem(last=False)
        pid, queue = processes.popitem(last=False)
        peer = queue.popleft()
        if queue:
            processes[pid] = queue
        if processes:
            self._users[uid] = processes
        return peer


class Peers:
    """All ZeroMQ peers of one listening socket."""

    kind: bytes
    """ZMTP socket type of the listening socket."""
    partners: frozenset[bytes]
    """ZMTP socket types that peers may have."""

    def __init__(self, listening: socket.socket, limits: Limits) -> None:
        """Serve the peers of `listening`, a non-blocking socket that `close` closes."""
        self._listening, self._limits = listening, limits
        self._repeats = Repeats()
        self._peers: dict[int, Peer] = {}
        self._owners: dict[int, dict[int, dict[int, Peer]]] = {}
        """All peers by user, process and descriptor."""
        self._opening: dict[int, Peer] = {}
        """Peers whose handshake is not complete, the oldest first."""
        self._turns = TurnQueue()
        self._held = 0
        self._woken = False
        self._idle = True
        """Whether the last poll returned no event while no peer waited for a turn."""
        self._accept_at_s: float | None = None
        self._space = bytearray(MAX_READ_BYTES)
        self._view = memoryview(self._space)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._epoll = select.epoll()
        self._epoll.register(self._wake, select.EPOLLIN)
        self._epoll.register(listening, select.EPOLLIN)
        self._ready = zmtp.ready(self.kind)

    def __len__(self) -> int:
        return len(self._peers)

    def wake(self) -> None:
        """End the wait for events; do nothing if the socket is closed. For any thread."""
        with suppress(OSError, ValueError):
            os.eventfd_write(self._wake, 1)

    def close(self, linger_s: float = 0.0) -> None:
        """End all connections after waiting up to `linger_s` for unsent data to be sent."""
        self._epoll.unregister(self._listening)
        self._listening.close()
        until_s = time.monotonic() + linger_s
        while any(peer.out for peer in self._peers.values()) and time.monotonic() < until_s:
            self._turn(until_s - time.monotonic())
        for peer in list(self._peers.values()):
            self._end(peer)
        self._epoll.close()
        wake, self._wake = self._wake, -1  # the number may be reused for another file at once
        os.close(wake)
        self._repeats.finish()

    # ---- turns -----------------------------------------------------------------------------------------------------

    def _turn(self, timeout_s: float) -> tuple[Peer, zmtp.Message | zmtp.Command] | None:
        """Wait for events, unless a peer already waits for a turn, and serve one peer.

        Returns the peer with its message or command if the subclass must handle that, otherwise None.
        """
        if self._opening or self._accept_at_s is not None:
            timeout_s = self._check_deadlines(timeout_s)
        came = self._epoll.poll(0 if self._turns else max(timeout_s, 0), _MAX_EPOLL_EVENTS)
        self._idle = not came and not self._turns
        if len(came) == 1 and not self._turns:
            ((descriptor, what),) = came
            if what == select.EPOLLIN and (peer := self._peers.get(descriptor)) is not None:
                peer.readable = True
                return self._give_turn(peer)
        for descriptor, what in came:
            peer = self._peers.get(descriptor)
            if peer is not None:
                if what & select.EPOLLOUT:
                    self._write(peer)
                if what & ~select.EPOLLOUT:
                    peer.readable = True
                    self._queue(peer)
            elif descriptor == self._wake:
                os.eventfd_read(self._wake)
                self._woken = True
            elif descriptor == self._listening.fileno():
                self._accept()
        if not self._turns:
            return None
        peer = self._turns.next()
        peer.queued = False
        return self._give_turn(peer)

    def _give_turn(self, peer: Peer) -> tuple[Peer, zmtp.Message | zmtp.Command] | None:
        try:
            event = None if peer.closed or peer.unsent > MAX_UNSENT_BYTES else self._next(peer)
            return None if event is None else self._handle_protocol(peer, event)
        except zmtp.ZmtpError as error:
            self._end(peer, str(error))
            return None

    def _queue(self, peer: Peer) -> None:
        if not peer.queued and not peer.closed:
            peer.queued = True
            self._turns.add(peer)

    def _next(self, peer: Peer) -> zmtp.Event | None:
        """Return the next event of a peer's ZMTP stream, after at most one read. Raises ZmtpError."""
        event = peer.parser.next()
        if event is None and peer.readable and self._read(peer):
            event = peer.parser.next()
        if peer.readable or peer.parser.pending:
            self._queue(peer)
        self._account(peer)
        return event

    def _read(self, peer: Peer) -> bool:
        try:
            size = peer.sock.recv_into(self._space)
        except BlockingIOError:
            peer.readable = False
            return False
        except OSError:
            size = 0
        if not size:
            self._end(peer)
            return False
        peer.readable = size == MAX_READ_BYTES
        peer.parser.feed(bytes(self._view[:size]))
        return True

    def _handle_protocol(self, peer: Peer, event: zmtp.Event) -> tuple[Peer, zmtp.Message | zmtp.Command] | None:
        """Handle the ZMTP handshake and heartbeats; return other messages and commands. Raises ZmtpError."""
        match event:
            case zmtp.Message():
                if not peer.ready:
                    raise zmtp.ZmtpError("message before the end of the handshake")
                return peer, event
            case zmtp.Greeted():
                self._send(peer, self._ready)
            case zmtp.Command(b"READY") if not peer.ready:
                kind = zmtp.properties(event.data).get(b"socket-type", b"")
                if kind not in self.partners:
                    known = ", ".join(each.decode() for each in sorted(self.partners))
                    why = f"socket type must be one of {known}"
                    self._send(peer, zmtp.error(why.encode()))
                    raise zmtp.ZmtpError(why)
                peer.ready = True
                self._opening.pop(peer.sock.fileno(), None)
            case zmtp.Command(b"PING"):
                self._send(peer, zmtp.command(b"PONG", event.data[2:18]))
            case zmtp.Command(b"PONG"):
                pass
            case zmtp.Command(b"ERROR"):
                self._end(peer)
            case zmtp.Command() if peer.ready:
                return peer, event
            case _:
                raise zmtp.ZmtpError("unexpected command")
        return None

    # ---- sending ---------------------------------------------------------------------------------------------------

    def _send(self, peer: Peer, data: bytes, *more: bytes) -> None:
        """Send data to a peer, after all earlier data; queue the bytes that the peer does not accept at once."""
        if peer.closed:
            return
        if peer.out:
            self._keep(peer, (data, *more))
            return
        try:
            sent = peer.sock.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._end(peer)
            return
        if sent < len(data):
            self._keep(peer, (memoryview(data)[sent:], *more))
        elif more:
            self._keep(peer, more)

    def _keep(self, peer: Peer, unsent: Iterable[bytes | memoryview]) -> None:
        """Queue data behind the data that the peer has not accepted yet."""
        if not peer.out:
            self._epoll.modify(peer.sock, _READ_AND_WRITE_EVENTS)
        for data in unsent:
            peer.out.append(data)
            peer.unsent += len(data)
        self._account(peer)

    def _write(self, peer: Peer) -> None:
        """Send queued data as far as the peer accepts it."""
        written = 0
        while peer.out and written < _MAX_WRITTEN_BYTES_PER_TURN:
            data = peer.out[0]
            try:
                sent = peer.sock.send(data)
            except BlockingIOError:
                break
            except OSError:
                self._end(peer)
                return
            written += sent
            peer.unsent -= sent
            if sent == len(data):
                peer.out.popleft()
                if not peer.out:
                    self._refill(peer)
            else:
                peer.out[0] = memoryview(data)[sent:]
        if not peer.out:
            self._epoll.modify(peer.sock, _READ_EVENTS)
        elif written >= _MAX_WRITTEN_BYTES_PER_TURN:
            self._epoll.modify(peer.sock, _READ_AND_WRITE_EVENTS)  # epoll reports the peer again at once
        if peer.unsent <= MAX_UNSENT_BYTES and (peer.readable or peer.parser.pending):
            self._queue(peer)
        self._account(peer)

    def _refill(self, peer: Peer) -> None:
        """Queue more data for a peer, if there is any. Called once all its queued data was sent."""

    # ---- connecting ------------------------------------------------------------------------------------------------

    def _accept(self) -> None:
        for _ in range(_MAX_ACCEPTED_PER_TURN):
            try:
                sock, _ = self._listening.accept()
            except (BlockingIOError, ConnectionAbortedError):
                return
            except OSError as error:
                self._accept_later(_ACCEPT_RETRY_S)
                self._warn("accept", f"cannot accept clients at the moment: {error.strerror}")
                return
            sock.setblocking(False)
            pid, uid, _ = _UCRED_STRUCT.unpack(sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
            peer = Peer(sock, uid, pid, zmtp.Parser(self._limits.message))
            if len(self._owners.get(peer.uid, {}).get(peer.pid, ())) >= self._limits.process_connections:
                sock.close()
                self._warn_ended(peer, f"the process already has {self._limits.process_connections:,} connections")
                continue
            self._enter(peer)
            if len(self._peers) > self._limits.connections:
                self._end(self._most_connected(), f"all {self._limits.connections:,} connections are taken")
            self._send(peer, zmtp.ZMTP_GREETING)

    def _enter(self, peer: Peer) -> None:
        descriptor = peer.sock.fileno()
        self._peers[descriptor] = self._opening[descriptor] = peer
        self._owners.setdefault(peer.uid, {}).setdefault(peer.pid, {})[descriptor] = peer
        self._epoll.register(descriptor, _READ_EVENTS)

    def _end(self, peer: Peer, why: str | None = None) -> None:
        """Close the connection of a peer. `why`: the reason for the log; None: nothing is logged."""
        if peer.closed:
            return
        peer.closed = True
        descriptor = peer.sock.fileno()
        del self._peers[descriptor]
        self._opening.pop(descriptor, None)
        processes = self._owners[peer.uid]
        del processes[peer.pid][descriptor]
        if not processes[peer.pid]:
            del processes[peer.pid]
        if not processes:
            del self._owners[peer.uid]
        self._held -= peer.held
        peer.out.clear()
        peer.sock.close()
        if why is not None:
            self._warn_ended(peer, why)

    def _warn_ended(self, peer: Peer, why: str) -> None:
        self._warn(f"ended {peer.uid}", f"{peer} was disconnected: {why}")

    def _warn(self, kind: str, line: str) -> None:
        self._repeats.note(kind, lambda since: _log.warning("%s%s", line, since.more))

    def _accept_later(self, pause_s: float) -> None:
        if self._accept_at_s is None:
            self._epoll.modify(self._listening, 0)
        self._accept_at_s = time.monotonic() + pause_s

    def _check_deadlines(self, timeout_s: float) -> float:
        """End an overdue handshake, resume accepting if it is time, and return the time to wait for events, in s."""
        now_s = time.monotonic()
        if self._opening and now_s - (oldest := next(iter(self._opening.values()))).began_s > HANDSHAKE_TIMEOUT_S:
            self._end(oldest, f"handshake not complete within {wording.duration(HANDSHAKE_TIMEOUT_S)}")
        if self._accept_at_s is not None:
            if now_s < self._accept_at_s:
                return min(timeout_s, self._accept_at_s - now_s)
            self._accept_at_s = None
            self._epoll.modify(self._listening, select.EPOLLIN)
        return timeout_s

    def _most_connected(self) -> Peer:
        """Return the newest connection of the process with most connections, of the user with most connections."""
        processes = max(self._owners.values(), key=lambda each: sum(map(len, each.values())))
        return next(reversed(max(processes.values(), key=len).values()))

    def _account(self, peer: Peer) -> None:
        """Update `held` of a peer. Beyond Limits.buffers, disconnect peers of the user and process that hold most."""
        held = peer.parser.held + peer.unsent
        if held == peer.held or peer.closed:
            return
        self._held += held - peer.held
        peer.held = held
        while self._held > self._limits.buffers:
            users: dict[int, int] = {}
            processes: dict[int, int] = {}
            for each in self._peers.values():
                users[each.uid] = users.get(each.uid, 0) + each.held
                processes[each.pid] = processes.get(each.pid, 0) + each.held
            worst = max(self._peers.values(), key=lambda each: (users[each.uid], processes[each.pid], each.held))
            size, total = wording.size(worst.held), wording.size(self._held)
            self._end(worst, f"the connection uses {size} of buffers, all clients {total}")
