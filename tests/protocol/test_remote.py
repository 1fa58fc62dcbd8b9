"""What the end of a handshake with a bridge says: refused, ended at once, or too slow."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from hapticd.bridge import gate
from hapticd.protocol import remote
from hapticd.protocol.calls import DaemonNotRunning, KeyRefused
from hapticd.protocol.keys import new_certificate
from hapticd.protocol.places import probe
from hapticd.protocol.remote import Refusal, Remote

GREETING = 64  # bytes, of ZMTP 3

Treat = Callable[[socket.socket], None]


def reset(connection: socket.socket) -> None:
    """What a bridge does to whom it has no room for; here once the connection is known to be there on both sides."""
    connection.recv(1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def close(connection: socket.socket) -> None:
    """What it does in the end to whom it refused, or who was too slow."""
    while connection.recv(GREETING):
        connection.shutdown(socket.SHUT_WR)
    connection.close()


@contextmanager
def listening(treat: Treat) -> Iterator[Remote]:
    """A place where every connection is treated so."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            while True:
                try:
                    connection, _ = listener.accept()
                except OSError:
                    return
                with connection:
                    treat(connection)

        thread = threading.Thread(target=serve)
        thread.start()
        ours = new_certificate()
        try:
            yield Remote("127.0.0.1", listener.getsockname()[1], ours, new_certificate().public_key)
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()


def test_a_handshake_that_is_ended_in_time_is_refused() -> None:
    with listening(close) as place, pytest.raises(KeyRefused, match="its key is not the server_key"):
        probe(place, 60.0, command=True)


def test_a_handshake_that_took_too_long_says_nothing_of_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "HANDSHAKE_S", 0.0)
    with (
        listening(close) as place,
        pytest.raises(DaemonNotRunning, match=r"was not complete after 0 s: the bridge, .* is too slow$"),
    ):
        probe(place, 60.0, command=True)


def test_the_client_knows_how_long_a_bridge_waits() -> None:
    assert remote.HANDSHAKE_S == gate.HANDSHAKE_S > gate.REFUSED_S


def test_who_is_let_go_at_once_is_not_told_of_keys() -> None:
    with listening(reset) as place, pytest.raises(DaemonNotRunning, match="took the connection and ended it at once"):
        probe(place, 60.0, command=True)


def test_who_is_patient_tries_again_where_there_was_no_room() -> None:
    comes = threading.Semaphore(0)

    def treat(connection: socket.socket) -> None:
        reset(connection)
        comes.release()

    with listening(treat) as place:

        def twice() -> bool:
            return comes.acquire(blocking=False) and comes.acquire()

        refusal = place.knock(60.0, command=True, patient=True, given_up=twice)
    assert isinstance(refusal, Refusal) and refusal.by == "busy"
