"""A daemon behind `hapticd bridge`: its address, the keys, and why a bridge does not let us in."""

from __future__ import annotations

import errno
import os
import re
import socket as network
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import zmq

from hapticd.base.errors import HapticdError

if TYPE_CHECKING:
    from hapticd.protocol.keys import Certificate

PORT: Final = 9410
"""Where a bridge takes commands by default; telemetry has the port after it."""

_TCP: Final = re.compile(r"tcp://(\[[0-9A-Fa-f:.]+(?:%\w+)?\]|[^\[\]:/\s]+)(?::(\d{1,5}))?/?")
_RECONNECT_MS: Final = 100
_RECONNECT_MOST_MS: Final = 2000
_LOOK_EVERY_S: Final = 0.1
_LOOK_S: Final = 1.0
HANDSHAKE_S: Final = 5.0
"""So long a bridge waits for a key. Whoever it refuses, it lets go long before that."""
_FAILED: Final = (
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
    | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
    | zmq.EVENT_DISCONNECTED
    | zmq.EVENT_CLOSED
)


class Refusal(NamedTuple):
    """Why a bridge did not let us in."""

    by: Literal["nobody", "busy", "handshake", "key"]
    """Nobody is there; a bridge that has no time or no room; whoever ended the handshake; one that refuses our key."""
    why: str


def is_remote(place: object) -> bool:
    """Whether a client is given an address rather than a directory."""
    return isinstance(place, str) and place.startswith("tcp://")


def host_and_port(address: str, default: int | None = None) -> tuple[str, int]:
    """Host (an IPv6 address without its brackets) and port of tcp://HOST:PORT. Raises ValueError."""
    match = _TCP.fullmatch(address)
    port = int(match[2]) if match and match[2] else default
    if match is None or port is None or port > 65535:
        raise ValueError("must be tcp://HOST:PORT")
    return match[1].strip("[]"), port


def is_loopback(host: str) -> bool:
    """Whether a host is this machine's own loopback, by its number or as localhost."""
    import ipaddress

    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True, slots=True)
class Remote:
    """Where a bridge is, who we are, and which key it must have."""

    host: str
    port: int
    certificate: Certificate
    server_key: str

    def _endpoint(self, port: int) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"tcp://{host}:{port}"

    @property
    def command_endpoint(self) -> str:
        """The command socket as ZeroMQ names it."""
        return self._endpoint(self.port)

    @property
    def telemetry_endpoint(self) -> str:
        """The telemetry socket as ZeroMQ names it."""
        return self._endpoint(self.port + 1)

    def __str__(self) -> str:
        return self.command_endpoint

    def secure(self, socket: zmq.Socket[Any]) -> None:
        """Sets a socket up to connect: keys, and pauses between its tries."""
        assert self.certificate.secret_key is not None
        socket.setsockopt(zmq.IPV6, 1)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self.certificate.public_key.encode())
        socket.setsockopt(zmq.CURVE_SECRETKEY, self.certificate.secret_key.encode())
        socket.setsockopt(zmq.CURVE_SERVERKEY, self.server_key.encode())
        socket.setsockopt(zmq.RECONNECT_IVL, _RECONNECT_MS)
        socket.setsockopt(zmq.RECONNECT_IVL_MAX, _RECONNECT_MOST_MS)
        # A bridge whose machine is gone without a word is noticed within a minute.
        socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
        socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, 20)
        socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, 10)
        socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, 3)

    def knock(
        self, timeout_s: float, command: bool, patient: bool = False, given_up: Callable[[], bool] = lambda: False
    ) -> Refusal | None:
        """None where the command (or the telemetry) socket lets us in. Who is `patient` takes one that is not there, or
        busy, for one that may let us in within the time."""
        try:
            network.getaddrinfo(self.host, self.port, type=network.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            return Refusal("nobody", f"{self}: {getattr(error, 'strerror', None) or error}")
        kind, endpoint = (zmq.DEALER, self.command_endpoint) if command else (zmq.SUB, self.telemetry_endpoint)
        trial: zmq.Socket[bytes]
        with zmq.Context.instance().socket(kind) as trial:
            trial.setsockopt(zmq.LINGER, 0)
            self.secure(trial)
            monitor: zmq.Socket[Any] = trial.get_monitor_socket(
                _FAILED | zmq.EVENT_CONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED
            )
            try:
                trial.connect(endpoint)
                heard = self._heard(monitor, timeout_s, patient, given_up)
            finally:
                trial.disable_monitor()
                monitor.close()
        if heard is None or heard.by != "nobody" or command or not self._takes_commands():
            return heard
        told = f"the bridge at {self} is there, but not its port {self.port + 1} for telemetry: a firewall?"
        return Refusal("nobody", told)

    def _takes_commands(self) -> bool:
        """Whether anybody takes connections at the port that the bridge is known by; no key is shown."""
        try:
            network.create_connection((self.host, self.port), _LOOK_S).close()
        except OSError:
            return False
        return True

    def _heard(
        self, monitor: zmq.Socket[Any], timeout_s: float, patient: bool, given_up: Callable[[], bool]
    ) -> Refusal | None:
        refusal = Refusal("nobody", f"no bridge at {self}: no answer within {timeout_s:g} s")
        taken_s = time.monotonic()
        doubted = False
        for event, value in monitored(monitor, timeout_s, given_up):
            if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                return None
            if event == zmq.EVENT_CONNECTED:
                taken_s = time.monotonic()
                refusal = Refusal(
                    "busy",
                    f"no answer from the bridge at {self} within {timeout_s:g} s, though the connection was taken: "
                    "it is too busy, or something else than a bridge listens there",
                )
                continue
            found = self._refusal(event, value, time.monotonic() - taken_s)
            if found.by == "handshake" and not doubted:
                doubted = True
                continue  # a connection that was reset can look just so; libzmq tries once more
            refusal = found
            if not (patient and refusal.by in ("nobody", "busy")):
                return refusal
        return refusal

    def _refusal(self, event: int, value: int, after_s: float) -> Refusal:
        """What the end of a connection says, so long after it was taken; `value` is the event's."""
        if event == zmq.EVENT_CLOSED:
            return Refusal("nobody", f"no bridge at {self}: nobody takes connections there")
        if event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            return Refusal("key", f"the bridge at {self} refuses our key {self.certificate.public_key[:8]}...")
        if event == zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL:
            return Refusal("nobody", f"no bridge at {self}: what answers there speaks another protocol")
        if value == errno.ECONNRESET:
            why = "too many of its connections have not shown a key yet, or it has just ended"
            return Refusal("busy", f"the bridge at {self} took the connection and ended it at once: {why}")
        if after_s >= HANDSHAKE_S:
            why = "the bridge, this machine or the network between them is too slow"
            return Refusal(
                "busy", f"the handshake with the bridge at {self} was not complete after {after_s:.0f} s: {why}"
            )
        return Refusal(
            "handshake",
            f"the bridge at {self} ended the handshake: its key is not the server_key that we were "
            "given, or it has all the connections that it takes",
        )


def monitored(
    monitor: zmq.Socket[Any], timeout_s: float, given_up: Callable[[], bool] = lambda: False
) -> Iterator[tuple[int, int]]:
    """What happens to a socket, events and their values, as it does, for so long or until nobody waits any more."""
    from zmq.utils.monitor import recv_monitor_message

    deadline = time.monotonic() + timeout_s
    while (left_s := deadline - time.monotonic()) > 0 and not given_up():
        if monitor.poll(int(min(left_s, _LOOK_EVERY_S) * 1e3 + 0.999)):
            message = recv_monitor_message(monitor)
            yield int(message["event"]), int(message["value"])


class Named(NamedTuple):
    """An argument, and the variable of the environment that it came from; None: it was given by the caller."""

    value: object
    variable: str | None = None

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Errors name the variable."""
        try:
            yield
        except HapticdError as error:
            if self.variable is None:
                raise
            raise HapticdError(f"{self.variable}: {error}") from None


def remote(address: Named, key: Named, server_key: Named) -> Remote:
    """A bridge at tcp://HOST or tcp://HOST:PORT.

    `key`: path of our secret key's file, or a Certificate; `server_key`: the bridge's public key, or a file with it.
    Raises HapticdError.
    """
    from hapticd.protocol.keys import Certificate, load_secret, public_key_of

    with address.blamed():
        try:
            host, port = host_and_port(str(address.value), PORT)
        except ValueError as error:
            raise HapticdError(f"{address.value}: {error}, or tcp://HOST for port {PORT}") from None
        if port in (0, 65535):
            raise HapticdError(f"{address.value}: the port must be from 1 to 65534; telemetry has the one after it")
        ours, theirs = key.value, server_key.value
        if not isinstance(ours, str | os.PathLike | Certificate) or not isinstance(theirs, str | os.PathLike):
            raise HapticdError(
                f"{address.value}: a bridge needs key, the file of our secret key, and server_key, the bridge's public "
                "key; or HAPTICD_KEY and HAPTICD_SERVER_KEY"
            )
    with key.blamed():
        certificate = ours if isinstance(ours, Certificate) else load_secret(ours)
        if certificate.secret_key is None:
            raise HapticdError(f"{address.value}: key: needs the secret key too")
    with server_key.blamed():
        return Remote(host, port, certificate, public_key_of(theirs))
