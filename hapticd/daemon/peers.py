"""A listening Unix socket and the ZeroMQ peers that come to it, for one thread, without libzmq (docs/adr/0024).

No peer can take more than its share of descriptors, memory and turns; one that tries is disconnected, and the log names
its process and user. `router.py` answers requests on top of this, `publisher.py` sends telemetry.
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

HANDSHAKE_S: Final = 5.0
"""From a connection's first moment until its handshake is over."""
UNSENT_BYTES: Final = 256 * 1024
"""A peer that leaves more than this unread is not read from."""
READ_BYTES: Final = 64 * 1024
"""What is read from a peer in one turn."""

_ACCEPTED_AT_ONCE: Final = 16
"""Then those that are connected get their turns; refusals among them cost newcomers no more than their own time."""
_EVENTS_AT_ONCE: Final = 64
_NO_DESCRIPTOR_PAUSE_S: Final = 0.1
_WRITTEN_AT_ONCE: Final = 1024 * 1024
_IN: Final = select.EPOLLIN | select.EPOLLET
_IN_AND_OUT: Final = _IN | select.EPOLLOUT
_CREDENTIALS: Final = struct.Struct("3i")

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Limits:
    """What a socket bears with."""

    message: zmtp.Bounds
    connections: int = MAX_SOCKET_CONNECTIONS
    process_connections: int = MAX_SOCKET_CONNECTIONS // 4
    buffers: int = 96 * 1024 * 1024
    """Bytes of all peers together that came and are not a whole message, or were answered and are not read."""

    def of(self, connections: int) -> Limits:
        """The same with so many connections."""
        return replace(self, connections=connections, process_connections=max(4, connections // 4))


@dataclass(eq=False, slots=True)
class Peer:
    """A connection; answers to a peer that has left are dropped."""

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
    # Of a subscriber:
    subscriptions: dict[bytes, int] = field(default_factory=dict)
    useless: int = 0
    lost: int = 0

    def __str__(self) -> str:
        return f"process {self.pid} of user {self.uid}"


class Turns:
    """Those who wait for their turn: one after the other among users, among the processes of each, and among the
    connections of each of these. So what one of them wants, however much, costs another one turn at a time."""

    def __init__(self) -> None:
        self._users: OrderedDict[int, OrderedDict[int, deque[Peer]]] = OrderedDict()

    def __bool__(self) -> bool:
        return bool(self._users)

    def add(self, waiting: Peer) -> None:
        """Behind the others of its process."""
        processes = self._users.get(waiting.uid)
        if processes is None:
            processes = self._users[waiting.uid] = OrderedDict()
        queue = processes.get(waiting.pid)
        if queue is None:
            queue = processes[waiting.pid] = deque()
        queue.append(waiting)

    def next(self) -> Peer:
        """The one whose turn it is, which does not wait any more. Raises KeyError: nobody waits."""
        uid, processes = self._users.popitem(last=False)
        pid, queue = processes.popitem(last=False)
        found = queue.popleft()
        if queue:
            processes[pid] = queue
        if processes:
            self._users[uid] = processes
        return found


class Peers:
    """All peers of one socket."""

    kind: bytes
    """Of our side, as ZMTP names it."""
    partners: frozenset[bytes]
    """Kinds that may come."""

    def __init__(self, listening: socket.socket, limits: Limits) -> None:
        """`listening`: does not block; it is closed in the end."""
        self._listening, self._limits = listening, limits
        self._repeats = Repeats()
        self._peers: dict[int, Peer] = {}
        self._owners: dict[int, dict[int, dict[int, Peer]]] = {}
        """The same by user, process and descriptor."""
        self._opening: dict[int, Peer] = {}
        """Those whose handshake is not over, the oldest first."""
        self._turns = Turns()
        self._held = 0
        self._woken = False
        self._idle = True
        """At the last look nothing had come, and nobody waited for a turn."""
        self._accept_at_s: float | None = None
        self._space = bytearray(READ_BYTES)
        self._view = memoryview(self._space)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._epoll = select.epoll()
        self._epoll.register(self._wake, select.EPOLLIN)
        self._epoll.register(listening, select.EPOLLIN)
        self._ready = zmtp.ready(self.kind)

    def __len__(self) -> int:
        return len(self._peers)

    def wake(self) -> None:
        """Ends the wait for what comes; nothing once it is closed. For any thread."""
        with suppress(OSError, ValueError):
            os.eventfd_write(self._wake, 1)

    def close(self, linger_s: float = 0.0) -> None:
        """Ends all connections; `linger_s`: for so long what was not sent may still go out."""
        self._epoll.unregister(self._listening)
        self._listening.close()
        until_s = time.monotonic() + linger_s
        while any(peer.out for peer in self._peers.values()) and time.monotonic() < until_s:
            self._turn(until_s - time.monotonic())
        for peer in list(self._peers.values()):
            self._end(peer)
        self._epoll.close()
        wake, self._wake = self._wake, -1  # another file has the number soon
        os.close(wake)
        self._repeats.finish()

    # ---- turns -----------------------------------------------------------------------------------------------------

    def _turn(self, timeout_s: float) -> tuple[Peer, zmtp.Message | zmtp.Command] | None:
        """Waits until something comes, or not at all while somebody waits for a turn; gives one peer its turn.

        What that one sent, if it is for who is above this.
        """
        if self._opening or self._accept_at_s is not None:
            timeout_s = self._look_after(timeout_s)
        came = self._epoll.poll(0 if self._turns else max(timeout_s, 0), _EVENTS_AT_ONCE)
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
            event = None if peer.closed or peer.unsent > UNSENT_BYTES else self._next(peer)
            return None if event is None else self._shake(peer, event)
        except zmtp.ZmtpError as error:
            self._end(peer, str(error))
            return None

    def _queue(self, peer: Peer) -> None:
        if not peer.queued and not peer.closed:
            peer.queued = True
            self._turns.add(peer)

    def _next(self, peer: Peer) -> zmtp.Event | None:
        """What comes next of a peer, after one read at most. Raises ZmtpError."""
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
        peer.readable = size == READ_BYTES
        peer.parser.feed(bytes(self._view[:size]))
        return True

    def _shake(self, peer: Peer, event: zmtp.Event) -> tuple[Peer, zmtp.Message | zmtp.Command] | None:
        """The handshake, and what every peer may say. Raises ZmtpError."""
        match event:
            case zmtp.Message():
                if not peer.ready:
                    raise zmtp.ZmtpError("a message before the handshake was over")
                return peer, event
            case zmtp.Greeted():
                self._send(peer, self._ready)
            case zmtp.Command(b"READY") if not peer.ready:
                kind = zmtp.properties(event.data).get(b"socket-type", b"")
                if kind not in self.partners:
                    known = wording.listed([each.decode() for each in sorted(self.partners)])
                    why = f"a socket of another kind than {known}"
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
                raise zmtp.ZmtpError("a command out of place")
        return None

    # ---- out -------------------------------------------------------------------------------------------------------

    def _send(self, peer: Peer, data: bytes, *more: bytes) -> None:
        """Sends bytes after those that were sent before; whatever the peer does not take at once waits."""
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
        """What is to be sent once the peer took what waits before it."""
        if not peer.out:
            self._epoll.modify(peer.sock, _IN_AND_OUT)
        for data in unsent:
            peer.out.append(data)
            peer.unsent += len(data)
        self._account(peer)

    def _write(self, peer: Peer) -> None:
        """Sends what waits, as far as the peer takes it."""
        written = 0
        while peer.out and written < _WRITTEN_AT_ONCE:
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
            self._epoll.modify(peer.sock, _IN)
        elif written >= _WRITTEN_AT_ONCE:
            self._epoll.modify(peer.sock, _IN_AND_OUT)  # reported again at once
        if peer.unsent <= UNSENT_BYTES and (peer.readable or peer.parser.pending):
            self._queue(peer)
        self._account(peer)

    def _refill(self, peer: Peer) -> None:
        """All that waited was sent."""

    # ---- coming and going ------------------------------------------------------------------------------------------

    def _accept(self) -> None:
        for _ in range(_ACCEPTED_AT_ONCE):
            try:
                sock, _ = self._listening.accept()
            except (BlockingIOError, ConnectionAbortedError):
                return
            except OSError as error:
                self._accept_later(_NO_DESCRIPTOR_PAUSE_S)
                self._tell("accept", f"clients have to wait: {error.strerror}")
                return
            sock.setblocking(False)
            pid, uid, _ = _CREDENTIALS.unpack(sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
            peer = Peer(sock, uid, pid, zmtp.Parser(self._limits.message))
            if len(self._owners.get(peer.uid, {}).get(peer.pid, ())) >= self._limits.process_connections:
                sock.close()
                self._tell_end(peer, f"it has {self._limits.process_connections:,} connections already")
                continue
            self._enter(peer)
            if len(self._peers) > self._limits.connections:
                self._end(self._most_connected(), f"all {self._limits.connections:,} connections are taken")
            self._send(peer, zmtp.ZMTP_GREETING)

    def _enter(self, peer: Peer) -> None:
        descriptor = peer.sock.fileno()
        self._peers[descriptor] = self._opening[descriptor] = peer
        self._owners.setdefault(peer.uid, {}).setdefault(peer.pid, {})[descriptor] = peer
        self._epoll.register(descriptor, _IN)

    def _end(self, peer: Peer, why: str | None = None) -> None:
        """Closes a connection; `why`: what the peer did that it may not, for the log."""
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
            self._tell_end(peer, why)

    def _tell_end(self, peer: Peer, why: str) -> None:
        self._tell(f"ended {peer.uid}", f"{peer} was disconnected: {why}")

    def _tell(self, kind: str, line: str) -> None:
        self._repeats.note(kind, lambda since: _log.warning("%s%s", line, since.more))

    def _accept_later(self, pause_s: float) -> None:
        if self._accept_at_s is None:
            self._epoll.modify(self._listening, 0)
        self._accept_at_s = time.monotonic() + pause_s

    def _look_after(self, timeout_s: float) -> float:
        """Handshakes that do not end, and connections that have to wait; until when to wait for something else."""
        now_s = time.monotonic()
        if self._opening and now_s - (oldest := next(iter(self._opening.values()))).began_s > HANDSHAKE_S:
            self._end(oldest, f"its handshake did not end in {wording.duration(HANDSHAKE_S)}")
        if self._accept_at_s is not None:
            if now_s < self._accept_at_s:
                return min(timeout_s, self._accept_at_s - now_s)
            self._accept_at_s = None
            self._epoll.modify(self._listening, select.EPOLLIN)
        return timeout_s

    def _most_connected(self) -> Peer:
        """The newest connection of the process that has most of the user that has most."""
        processes = max(self._owners.values(), key=lambda each: sum(map(len, each.values())))
        return next(reversed(max(processes.values(), key=len).values()))

    def _account(self, peer: Peer) -> None:
        """Ends who holds most, while all hold too much together."""
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
            most = max(self._peers.values(), key=lambda each: (users[each.uid], processes[each.pid], each.held))
            self._end(most, f"{wording.size(most.held)} wait for it, and {wording.size(self._held)} for all clients")
