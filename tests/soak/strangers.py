"""What others in the network may do to a bridge: one attacker, until it is killed; for `tests.soak.bridged`.

python -m tests.soak.strangers KIND NUMBER ADDRESS KEY SERVER_KEY      prints once a second what it has done so far

`NUMBER`: of the process; those with an odd one come from one address, the others from hundreds of 127.0.0.0/8.
"""

from __future__ import annotations

import itertools
import random
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import zmq

from hapticd.protocol import messages
from hapticd.protocol.remote import Named, Remote, remote
from tests.soak.attackers import Tally, keep

CONNECTIONS = 250
"""Of one attacker that holds connections; half of them to each port."""
FORGOTTEN = 100
"""Clients that are opened and forgotten, each time anew."""

_GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x01" + b"CURVE".ljust(20, b"\0") + bytes(32)
_HELD_S = 3.0


@dataclass(frozen=True, slots=True)
class Target:
    """The bridge, and one of its own clients' keys."""

    number: int
    place: Remote

    def knock(self, count: int) -> socket.socket:
        """A connection to one of its ports; raises OSError."""
        made = socket.socket()
        try:
            there = f"{count // 200 % 200}.{count % 200 + 1}" if self.number % 2 == 0 else "0.1"
            made.bind((f"127.{self.number + 1}.{there}", 0))
            made.settimeout(1)
            made.connect((self.place.host, self.place.port + count % 2))
        except OSError:
            made.close()
            raise
        return made


def handshakes(target: Target) -> None:
    """Connections that never show a key: silent, with half a greeting, a whole one, or garbage; opened anew where they
    are ended."""
    numbers = itertools.count(1)

    def opened() -> socket.socket:
        made = target.knock(next(numbers))
        made.sendall(random.choice((b"", _GREETING[:10], _GREETING, random.randbytes(200))))
        return made

    keep(CONNECTIONS, opened, Tally("connections without a key"))


def forgotten(target: Target) -> None:
    """Clients with a key that subscribe to everything, never read and are never closed, but all at once."""
    tally = Tally("clients that never read")
    while True:
        with zmq.Context() as context:
            for _ in range(FORGOTTEN):
                made = context.socket(zmq.SUB)
                made.setsockopt(zmq.RCVHWM, 1)
                made.setsockopt(zmq.SUBSCRIBE, b"")
                target.place.secure(made)
                made.connect(target.place.telemetry_endpoint)
                tally.add()
            time.sleep(_HELD_S)
            context.destroy(0)


def unread(target: Target) -> None:
    """Questions of a client with a key, whose answers nobody reads."""
    tally = Tally("questions")
    question = messages.request(1, "get_materials")
    while True:
        until_s = time.monotonic() + _HELD_S
        with zmq.Context() as context:
            made = [context.socket(zmq.DEALER) for _ in range(10)]
            for each in made:
                each.setsockopt(zmq.RCVHWM, 1)
                each.setsockopt(zmq.SNDTIMEO, 10)
                target.place.secure(each)
                each.connect(target.place.command_endpoint)
            while time.monotonic() < until_s:
                for each in made:
                    try:
                        each.send(question)
                        tally.add()
                    except zmq.Again:
                        pass
            context.destroy(0)


KINDS: dict[str, Callable[[Target], None]] = {"handshakes": handshakes, "forgotten": forgotten, "unread": unread}


def main(kind: str, number: int, address: str, key: str, server_key: str) -> None:
    """Attacks until it is killed."""
    KINDS[kind](Target(number, remote(Named(address), Named(key), Named(server_key))))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), *sys.argv[3:6])
