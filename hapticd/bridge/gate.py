"""Connections from the network: who is let in (`Gate.authorize`), their bytes moved to a CURVE socket, their end.

Every connection has a separate socket, in a folder that nobody else may enter:

    client -- TCP -- Connection -- ipc, unlinked at once -- ROUTER with CURVE -- Relay -- the daemon's command socket
                                                            XPUB with CURVE -- Gate.publish -- DaemonLink

libzmq asks `zap` about each key, and `Gate.authorize` answers: whether the key belongs to a client of the
configuration, whether that client may command or only watch, and whether it has a connection left.

That costs a hop, and buys what one socket for all could not: a client that is not read from is held back by TCP,
however it floods, and holds nobody else up; a connection is ended alone, at once, when its key is revoked; and what has
not shown a key yet is bounded in number, time and bytes. The bytes are CURVE's: nothing here reads them.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket as network
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Literal

import zmq
import zmq.asyncio

from hapticd.base import codec
from hapticd.base.errors import quoted
from hapticd.base.token_bucket import Bucket
from hapticd.bridge import zap
from hapticd.bridge.accounts import Account, Accounts
from hapticd.bridge.daemon_link import DaemonLink
from hapticd.bridge.limits import Teller
from hapticd.bridge.relay import Relay
from hapticd.protocol.keys import Certificate
from hapticd.protocol.messages import MAX_BODY

Kind = Literal["command", "telemetry"]

HANDSHAKE_S: Final = 5.0
"""From a connection's first moment until its key was taken."""
HANDSHAKES: Final = 64
HANDSHAKES_PER_HOST: Final = 16
"""So many that have not shown a key yet are borne with, of all and of one address."""
PEACE_S: Final = 0.25
"""So long one that has not shown a key has its place; then it makes room for a newer one, where all are taken."""
REFUSED_S: Final = 1.0
"""A refused connection is held for so long, which slows down whoever tries again."""

BRIDGE: Final = b"bridge"
"""The topic of what the bridge itself tells."""

_GREETING: Final = 10
_HANDSHAKE_BYTES: Final = 8192
_LONGEST_FRAME: Final = MAX_BODY + 1024
"""With what CURVE and the envelope add: whatever a client of ours sends is answered, and longer ends the connection."""
_COMMANDS_WAITING: Final = 2
_TELEMETRY_WAITING: Final = 200
"""Telemetry kept for a client that does not read, beside what TCP keeps: about a second and a half."""
_SUBSCRIPTIONS: Final = 64
_SUBSCRIPTION_BYTES: Final = 1024
_WATCHER_BYTES: Final = 4 * 2**20
_WATCHER_BYTES_PER_S: Final = 16384.0

_log = logging.getLogger("hapticd.bridge")


class Gate:
    """All connections. Belongs to the running event loop."""

    def __init__(
        self,
        context: zmq.asyncio.Context,
        folder: str,
        certificate: Certificate,
        accounts: Accounts,
        link: DaemonLink,
        command_endpoint: str,
    ) -> None:
        self.context, self.folder, self.accounts, self.link = context, folder, accounts, link
        self.command_endpoint = command_endpoint
        self.tell = Teller(_log.warning)
        self._welcome = Teller(_log.info)
        self.accepted = 0
        self.refused: Counter[str] = Counter()
        self._certificate = certificate
        self._connections: dict[str, Connection] = {}
        self._handshakes: dict[str, dict[Connection, None]] = {}
        """Connections that have not shown a key yet, by address, the oldest first."""
        self._count = 0
        self._there = False

    # ---- coming ------------------------------------------------------------------------------------------------------

    def protocol_factory(self, kind: Kind) -> Callable[[], asyncio.Protocol]:
        """What takes the connections of a listening socket."""
        return lambda: Connection(self, kind)

    def enter(self, connection: Connection) -> bool:
        """A new connection; false if there are too many that have not shown a key."""
        self.accepted += 1
        here = self._handshakes.get(connection.host, {})
        if len(here) >= HANDSHAKES_PER_HOST:
            crowd = here
        elif sum(map(len, self._handshakes.values())) >= HANDSHAKES:
            crowd = max(self._handshakes.values(), key=len)
        else:
            crowd = {}
        if crowd and not self._make_room(next(iter(crowd))):
            connection.refused_entry()
            self._refuse_handshake(connection)
            return False
        self._handshakes.setdefault(connection.host, {})[connection] = None
        self._count += 1
        connection.domain = f"{connection.kind}.{self._count}"
        self._connections[connection.domain] = connection
        return True

    def _make_room(self, oldest: Connection) -> bool:
        """Ends the oldest one, unless it is too young: whoever holds all places must not keep others out, and a client
        must come to show its key."""
        if time.monotonic() - oldest.since_s < PEACE_S:
            return False
        self._refuse_handshake(oldest)
        oldest.close()
        return True

    def _refuse_handshake(self, connection: Connection) -> None:
        self.refuse(connection, "handshakes", "too many connections at once that have not shown a key")

    def shown(self, connection: Connection) -> None:
        """A connection does not count among those without a key any more."""
        here = self._handshakes[connection.host]
        del here[connection]
        if not here:
            del self._handshakes[connection.host]

    def leave(self, connection: Connection) -> None:
        """A connection has ended."""
        del self._connections[connection.domain]
        if connection.account is not None:
            connection.account.connections -= 1
            self._attend()

    def authorize(self, domain: str, key: str) -> bytes:
        """Whether a connection may go on with this key, as a status of ZAP."""
        connection = self._connections.get(domain)
        if connection is None or connection.account is not None:
            return zap.REFUSED
        limits, account = self.accounts.limits, self.accounts.find(key)
        if account is None:
            self.refuse(connection, "key", f"key {key[:8]}... belongs to no client", key)
            return zap.REFUSED
        if connection.kind == "command" and account.may != "command":
            self.refuse(connection, "right", f"{quoted(account.name)} may watch, not command", key)
            return zap.REFUSED
        if account.connections >= limits.connections_per_client:
            self.refuse(connection, "connections", f"{quoted(account.name)} has all its connections already", key)
            return zap.LATER
        if sum(other.connections for other in self.accounts.all()) >= limits.connections:
            self.refuse(connection, "connections", f"{quoted(account.name)} comes when all are taken", key)
            return zap.LATER
        account.connections += 1
        where = f"{connection.kind} from {connection.host}"
        self._welcome(f"{key} {where}", f"{account.name}: {where}")
        connection.admit(account)
        self._attend()
        return zap.OK

    def refuse(self, connection: Connection, reason: str, line: str, who: str = "") -> None:
        """Counts and tells a refusal."""
        self.refused[reason] += 1
        self.tell(
            f"{reason} {who} {connection.kind} {connection.host}",
            f"refused {connection.host} at the {connection.kind} socket: {line}",
        )
        connection.turn_away()

    # ---- going -------------------------------------------------------------------------------------------------------

    def drop(self, account: Account) -> int:
        """Ends the connections of a client at once; returns how many there were."""
        found = [connection for connection in self._connections.values() if connection.account is account]
        for connection in found:
            connection.close()
        return len(found)

    def close(self) -> None:
        """Ends all connections."""
        for connection in list(self._connections.values()):
            connection.close()

    # ---- the daemon --------------------------------------------------------------------------------------------------

    def publish(self, frames: list[bytes]) -> None:
        """Telemetry for everybody who asked for its topic."""
        for connection in list(self._connections.values()):
            connection.publish(frames)

    def daemon_lost(self) -> None:
        for connection in self._connections.values():
            if connection.relay is not None:
                connection.relay.daemon_lost()
        self._tell_of_daemon()

    def _tell_of_daemon(self) -> None:
        """Whether the daemon is there, to everybody who asked, where it is not as it was."""
        there = self.link.status is not None
        if there != self._there:
            self._there = there
            for connection in list(self._connections.values()):
                connection.tell_of_bridge()

    def tick(self) -> None:
        """Once a second: checks subscriptions although no telemetry comes, and logs what is due."""
        self.tell.flush()
        self._welcome.flush()
        self._tell_of_daemon()
        for connection in list(self._connections.values()):
            connection.take_subscriptions()

    def _attend(self) -> None:
        self.link.listen(any(c.kind == "telemetry" and c.account is not None for c in self._connections.values()))

    # ---- sockets -----------------------------------------------------------------------------------------------------

    def front(self, connection: Connection) -> tuple[zmq.Socket[bytes], str]:
        """The socket of a connection, bound, and the path that it is bound to."""
        front: zmq.Socket[bytes] = zmq.Socket(self.context, zmq.ROUTER if connection.kind == "command" else zmq.XPUB)
        secret = self._certificate.secret_key
        assert secret is not None
        front.setsockopt(zmq.LINGER, 0)
        front.setsockopt(zmq.CURVE_SERVER, 1)
        front.setsockopt(zmq.CURVE_SECRETKEY, secret.encode())
        front.setsockopt(zmq.ZAP_DOMAIN, connection.domain.encode())
        front.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        front.setsockopt(zmq.HANDSHAKE_IVL, 0)  # the gate's own limit holds
        if connection.kind == "command":
            front.setsockopt(zmq.RCVHWM, _COMMANDS_WAITING)
            front.setsockopt(zmq.SNDHWM, _COMMANDS_WAITING)
            front.setsockopt(zmq.ROUTER_MANDATORY, 1)
            front.setsockopt(zmq.MAXMSGSIZE, _LONGEST_FRAME)
        else:
            front.setsockopt(zmq.SNDHWM, _TELEMETRY_WAITING)
            front.setsockopt(zmq.XPUB_NODROP, 1)  # what is dropped is counted
            front.setsockopt(zmq.MAXMSGSIZE, _SUBSCRIPTION_BYTES)
        path = os.path.join(self.folder, connection.domain)
        front.bind(f"ipc://{path}")
        return front, path


class Connection(asyncio.Protocol):
    """One connection: what comes from the network, and what becomes of it."""

    def __init__(self, gate: Gate, kind: Kind) -> None:
        self.kind: Kind = kind
        self.host = ""
        self.domain = ""
        self.since_s = time.monotonic()
        self.account: Account | None = None
        self.relay: Relay | None = None
        self._gate = gate
        self._outer: asyncio.Transport | None = None
        self._inner: asyncio.Transport | None = None
        self._front: zmq.Socket[bytes] | None = None
        self._path = ""
        self._greeting = b""
        self._came = 0
        self._held: set[str] = set()
        self._task: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._topics: set[bytes] = set()
        self._untold = False
        """What the bridge tells had no room in the client's queue."""
        self._watching = Bucket(_WATCHER_BYTES_PER_S, _WATCHER_BYTES_PER_S)
        self._closed = False

    def refused_entry(self) -> None:
        """There is no room even to be refused slowly."""
        assert self._outer is not None
        self._closed = True
        self._outer.abort()

    # ---- from the network --------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._outer = transport
        self.host = str(transport.get_extra_info("peername")[0])
        if not self._gate.enter(self):
            return
        raw: network.socket = transport.get_extra_info("socket")
        # A machine that went away without a word is noticed within a minute.
        raw.setsockopt(network.SOL_SOCKET, network.SO_KEEPALIVE, 1)
        raw.setsockopt(network.IPPROTO_TCP, network.TCP_KEEPIDLE, 20)
        raw.setsockopt(network.IPPROTO_TCP, network.TCP_KEEPINTVL, 10)
        raw.setsockopt(network.IPPROTO_TCP, network.TCP_KEEPCNT, 3)
        raw.setsockopt(network.IPPROTO_TCP, network.TCP_USER_TIMEOUT, 60_000)
        self._timer = asyncio.get_running_loop().call_later(HANDSHAKE_S, self._too_slow)

    def data_received(self, data: bytes) -> None:
        self._came += len(data)
        if self.account is None and self._came > _HANDSHAKE_BYTES:
            self._gate.refuse(self, "garbage", "a handshake that does not end")
            self.close()
        elif self._inner is not None:
            self._inner.write(data)
            self._pace(len(data))
        else:
            self._greeting += data
            if self._front is None and self._greets():
                self._open()

    def eof_received(self) -> None:
        self.close()

    def connection_lost(self, error: Exception | None) -> None:
        self.close()

    def pause_writing(self) -> None:
        if self._inner is not None:
            self._inner.pause_reading()

    def resume_writing(self) -> None:
        if self._inner is not None:
            self._inner.resume_reading()

    # ---- to libzmq ---------------------------------------------------------------------------------------------------

    def _greets(self) -> bool:
        """Whether this is a greeting of ZMTP 3; whatever else knocks costs no socket."""
        if len(self._greeting) < _GREETING and self._greeting[:1] in (b"", b"\xff"):
            return False
        if self._greeting[0] == 0xFF and self._greeting[9] == 0x7F:
            return True
        self._gate.refuse(self, "garbage", "what it sends is not ZeroMQ")
        return False

    def _open(self) -> None:
        self._front, self._path = self._gate.front(self)
        self._task = asyncio.create_task(self._connect(self._path), name=self.domain)

    async def _connect(self, path: str) -> None:
        try:
            await asyncio.get_running_loop().create_unix_connection(lambda: _Inner(self), path)
        except OSError as error:
            line = f"a connection from {self.host} failed: {path}: {error.strerror}"
            self._gate.tell(f"failed {error.errno} {self.host}", line)
            self.close()

    def inner_made(self, transport: asyncio.Transport) -> None:
        if self._closed:
            transport.abort()
            return
        self._inner = transport
        transport.write(self._greeting)
        self._greeting = b""

    def inner_received(self, data: bytes) -> None:
        """Bytes for the client; the first show that libzmq has taken the connection."""
        if self._closed:
            return
        # Nobody else finds it; to unbind it would end this connection, too.
        self._unlink()
        assert self._outer is not None
        self._outer.write(data)

    def inner_lost(self) -> None:
        """libzmq has ended the connection: refused, or for what came over it."""
        if self.account is not None:
            if not self._closed:
                line = f"{self.account.name}: a connection from {self.host} ended by what came over it"
                self._gate.tell(f"ended {self.account.name} {self.host}", line)
            self.close()
        elif not self._closed and "refused" not in self._held:
            self._gate.refuse(self, "key", "no handshake of CURVE with the bridge's key")

    def turn_away(self) -> None:
        """Refused: nothing more is read, and the end comes soon."""
        if self._closed or "refused" in self._held:
            return
        self._hold("refused")
        if self._timer is not None:
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_later(REFUSED_S, self.close)

    def hold_for(self, reason: str, hold: bool) -> None:
        """Whether the network is not read for this reason; it is while there is none."""
        if hold:
            self._hold(reason)
        else:
            self._release(reason)

    def _hold(self, reason: str) -> None:
        assert self._outer is not None
        if not self._held and not self._outer.is_closing():
            self._outer.pause_reading()
        self._held.add(reason)

    def _release(self, reason: str) -> None:
        self._held.discard(reason)
        if not self._held and self._outer is not None and not self._outer.is_closing():
            self._outer.resume_reading()

    def _pace(self, count: int) -> None:
        """Lets a client that is too fast wait."""
        if self.account is None:
            return
        if self.kind == "telemetry":
            wait_s = self._watching.take(count)
            most = _WATCHER_BYTES
        else:
            wait_s = self.account.take_bytes(count)
            # A message in many parts is one to libzmq's limits, and would grow without end.
            most = 4 * _LONGEST_FRAME
        if self._came > most:
            self._gate.refuse(self, "garbage", f"{quoted(self.account.name)} sends without end")
            self.close()
        elif wait_s:
            self._hold("pace")
            asyncio.get_running_loop().call_later(wait_s, self._release, "pace")

    # ---- with a key --------------------------------------------------------------------------------------------------

    def admit(self, account: Account) -> None:
        """The key was taken: libzmq goes on with the handshake, and what comes then is served."""
        assert self._timer is not None
        self._timer.cancel()
        self.account = account
        self._gate.shown(self)
        if self.kind == "command":
            gate = self._gate
            assert self._front is not None
            self.relay = Relay(
                gate.context,
                self._front,
                gate.command_endpoint,
                gate.link,
                account,
                lambda: gate.accounts.limits.message_bytes,
                self._read,
                self.close,
            )

    def _read(self) -> None:
        self._came = 0

    def publish(self, frames: list[bytes]) -> None:
        """A message of telemetry; it is dropped, and counted, where the client does not read."""
        self.take_subscriptions()
        if self.kind == "telemetry" and self._front is not None and self.account is not None and not self._closed:
            try:
                self._front.send_multipart(frames, zmq.NOBLOCK)
            except zmq.Again:
                self.account.telemetry_dropped += 1

    def tell_of_bridge(self) -> None:
        """What a client may, and whether the daemon is there, to one who asked for the topic."""
        if b"\x01" + BRIDGE in self._topics and self._front is not None and self.account is not None:
            state = {"may": self.account.may, "daemon": self._gate.link.status is not None}
            try:
                self._front.send_multipart([BRIDGE, codec.encode(state)], zmq.NOBLOCK)
                self._untold = False
            except zmq.Again:
                self._untold = True

    def take_subscriptions(self) -> None:
        """Checks what a watcher has subscribed to, and sends again what had no room before."""
        if self.kind != "telemetry" or self._front is None or self.account is None:
            return
        while not self._closed and int(self._front.getsockopt(zmq.EVENTS)) & zmq.POLLIN:
            frame: bytes = self._front.recv()
            if frame.startswith(b"\x01"):
                self._topics.add(frame)
                if frame == b"\x01" + BRIDGE:
                    self.tell_of_bridge()
            elif frame.startswith(b"\x00"):
                self._topics.discard(b"\x01" + frame[1:])
            if len(self._topics) > _SUBSCRIPTIONS:
                self._gate.refuse(self, "garbage", f"{quoted(self.account.name)} subscribes without end")
                self.close()
        if self._untold and not self._closed:
            self.tell_of_bridge()

    # ---- the end -----------------------------------------------------------------------------------------------------

    def _too_slow(self) -> None:
        self._gate.refuse(self, "slow", f"no key within {HANDSHAKE_S:g} s")
        self.close()

    def close(self) -> None:
        """Ends the connection at once; may be called twice. Nothing of it is carried out from here on."""
        if self._closed:
            return
        self._closed = True
        if self._timer is not None:
            self._timer.cancel()
        if self._task is not None:
            self._task.cancel()
        if self.relay is not None:
            self.relay.close()
        elif self._front is not None:
            self._front.close()
        self._unlink()
        for transport in (self._outer, self._inner):
            if transport is not None:
                transport.abort()
        if self.account is None:
            self._gate.shown(self)
        self._gate.leave(self)

    def _unlink(self) -> None:
        """libzmq leaves the file of a socket that it closes."""
        path, self._path = self._path, ""
        if path:
            with suppress(FileNotFoundError):
                os.unlink(path)


class _Inner(asyncio.Protocol):
    """The side of a connection that leads to libzmq."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._connection.inner_made(transport)

    def data_received(self, data: bytes) -> None:
        self._connection.inner_received(data)

    def eof_received(self) -> None:
        self._connection.inner_lost()

    def connection_lost(self, error: Exception | None) -> None:
        self._connection.inner_lost()

    def pause_writing(self) -> None:
        self._connection.hold_for("full", True)

    def resume_writing(self) -> None:
        self._connection.hold_for("full", False)
