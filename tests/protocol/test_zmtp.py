"""ZMTP without I/O: messages that peers may send, in pieces of any size, and data that ends a connection."""

from __future__ import annotations

import pytest

from hapticd.protocol import zmtp
from hapticd.protocol.zmtp import Bounds, Command, Greeted, Message, Parser, ZmtpError

BOUNDS = Bounds(frames=8, size=100_000, kept=1000)
READY = zmtp.ready(b"DEALER", Identity=b"me")


def events(data: bytes, piece: int | None = None, bounds: Bounds = BOUNDS) -> list[zmtp.Event]:
    parser = Parser(bounds)
    found = []
    for at in range(0, len(data), piece or len(data)):
        parser.feed(data[at : at + (piece or len(data))])
        while (event := parser.next()) is not None:
            found.append(event)
    return found


@pytest.mark.parametrize("piece", [None, 1, 2, 3, 7, 64, 65])
def test_events_are_the_same_in_whatever_pieces_the_bytes_come(piece: int | None) -> None:
    data = (
        zmtp.ZMTP_GREETING
        + READY
        + zmtp.message([b"alone"])
        + zmtp.message([b"", b"x" * 300])
        + zmtp.command(b"PING", b"\0\0context")
        + zmtp.message([b""])
        + zmtp.message([b"a", b"b", b"c", b"d"])
    )
    assert events(data, piece) == [
        Greeted(),
        Command(b"READY", READY[8:]),
        Message([b"alone"], 5),
        Message([b"", b"x" * 300], 300),
        Command(b"PING", b"\0\0context"),
        Message([b""], 0),
        Message([b"a", b"b", b"c"], 4),
    ]


@pytest.mark.parametrize("piece", [None, 1, 100])
def test_of_a_message_that_is_too_long_only_the_size_is_kept(piece: int | None) -> None:
    parser = Parser(BOUNDS)
    parser.feed(zmtp.ZMTP_GREETING)
    assert parser.next() == Greeted()
    data = zmtp.message([b"", b"x" * 1001])
    step = piece or len(data)
    found = None
    for at in range(0, len(data), step):
        parser.feed(data[at : at + step])
        found = parser.next()
        assert parser.held <= BOUNDS.kept
    assert found == Message([b"", b"x"], 1001)


def test_what_is_announced_takes_no_memory_until_it_comes() -> None:
    parser = Parser(Bounds(frames=1, size=2**40, kept=2**40))
    parser.feed(zmtp.ZMTP_GREETING + zmtp.header(2**40) + b"abc")
    assert parser.next() == Greeted()
    assert parser.next() is None
    assert parser.held == 3


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"GET / HTTP/1.1\r\n", "not ZMTP 3"),
        (b"\x01\x00", "not ZMTP 3"),
        (b"\xff" + bytes(8) + b"\x00", "not ZMTP 3"),
        (b"\xff" + bytes(8) + b"\x7f\x01", "ZMTP 1"),
        (zmtp.ZMTP_GREETING.replace(b"NULL", b"CURV"), '"CURV": must be NULL'),
        (zmtp.ZMTP_GREETING + b"\x08\x00", "not ZMTP 3"),
        (zmtp.ZMTP_GREETING + b"\x05\x00", "not ZMTP 3"),
        (zmtp.ZMTP_GREETING + b"\x04\x00", "without a name"),
        (zmtp.ZMTP_GREETING + b"\x04\x01\x00", "without a name"),
        (zmtp.ZMTP_GREETING + b"\x04\x02\x05R", "without a name"),
        (zmtp.ZMTP_GREETING + zmtp.header(4097, zmtp.COMMAND_FLAG), "4,097 bytes"),
        (zmtp.ZMTP_GREETING + b"\x01\x00" * 9, "more than 8 parts"),
        (zmtp.ZMTP_GREETING + zmtp.header(100_001), "more than 100,000 bytes"),
        (zmtp.ZMTP_GREETING + zmtp.header(2**64 - 1), "more than 100,000 bytes"),
        (zmtp.ZMTP_GREETING + zmtp.message([b"x" * 60_000, b"x" * 60_000]), "more than 100,000 bytes"),
    ],
    ids=range(15),
)
@pytest.mark.parametrize("piece", [None, 1])
def test_what_is_no_zmtp_or_too_much_is_refused(data: bytes, problem: str, piece: int | None) -> None:
    with pytest.raises(ZmtpError, match=problem):
        events(data, piece)


def test_what_a_ready_says() -> None:
    assert zmtp.properties(READY[8:]) == {b"socket-type": b"DEALER", b"identity": b"me"}
    for cut in range(9, len(READY)):
        data = READY[8:cut]
        if cut != 8 + 1 + len("Socket-Type") + 4 + len("DEALER"):
            with pytest.raises(ZmtpError, match="truncated"):
                zmtp.properties(data)
