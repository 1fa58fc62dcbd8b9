"""Fuzzes the daemon's ZMTP: conversations that are right, wrong in one place or without sense, in pieces of any size.

python -m tests.soak.fuzz_zmtp [--runs 1000000] [--seed 0]

Of whatever comes, the parser makes events or refuses it with a ZmtpError; in pieces it says the same as in one; it
keeps no more than its bounds say; and a conversation that is right is taken apart into what it was made of.
"""

from __future__ import annotations

import argparse
import random
import time

from hapticd.protocol import zmtp
from hapticd.protocol.zmtp import Bounds, Command, Event, Greeted, Message, Parser, ZmtpError

BOUNDS = Bounds(frames=6, size=3000, kept=1000)
SIZES = (0, 1, 2, 7, 254, 255, 256, 257, 999, 1000, 1001)


def conversation(source: random.Random) -> tuple[bytes, list[Event]]:
    """One that is right, and what is to be made of it."""
    data, events = [zmtp.ZMTP_GREETING], list[Event]([Greeted()])
    for _ in range(source.randrange(6)):
        if source.random() < 0.3:
            name, said = source.choice((b"READY", b"PING", b"X" * 255)), source.randbytes(source.randrange(40))
            data.append(zmtp.command(name, said))
            events.append(Command(name, said))
            continue
        frames = [source.randbytes(source.choice(SIZES)) for _ in range(source.choice((1, 1, 2, 2, 3, 6)))]
        size = sum(map(len, frames))
        if size > BOUNDS.size:
            continue
        data.append(zmtp.message(frames))
        cut = size > BOUNDS.kept or len(frames) > 2
        events.append(Message([each[:1] for each in frames[:3]] if cut else frames, size))
    return b"".join(data), events


def spoiled(source: random.Random, data: bytes) -> bytes:
    """The same with some mistakes."""
    wrong = bytearray(data)
    for _ in range(source.randrange(1, 4)):
        at = source.randrange(len(wrong)) if wrong else 0
        match source.randrange(4):
            case 0 if wrong:
                wrong[at] = source.choice((0, 1, 2, 3, 4, 5, 6, 7, 8, 127, 255, source.randrange(256)))
            case 1:
                del wrong[at : at + source.randrange(1, 20)]
            case 2:
                wrong[at:at] = source.randbytes(source.randrange(1, 20))
            case _:
                wrong[at:at] = zmtp.header(source.choice((0, 5, 255, 256, 2**32, 2**63)), source.randrange(8))
    return bytes(wrong)


def parsed(data: bytes, source: random.Random | None = None) -> tuple[list[Event], str | None]:
    """Events, and what was refused; in pieces if there is a source of chance."""
    parser, found = Parser(BOUNDS), list[Event]()
    at = 0
    try:
        while at < len(data):
            piece = len(data) if source is None else source.choice((1, 2, 3, 9, 64, 500))
            parser.feed(data[at : at + piece])
            at += piece
            while (event := parser.next()) is not None:
                found.append(event)
                if isinstance(event, Command) and event.name == b"READY":
                    zmtp.properties(event.data)
            assert parser.held <= max(BOUNDS.kept, zmtp.MAX_COMMAND_BYTES)
    except ZmtpError as error:
        return found, str(error)
    return found, None


def normal(event: Event) -> Event:
    """What of a message beyond the bounds is the same in whatever pieces it came."""
    if isinstance(event, Message) and sum(map(len, event.frames)) != event.size:
        return Message([each[:1] for each in event.frames], event.size)
    return event


def run(source: random.Random, runs: int) -> int:
    """So many conversations; how many were refused. Raises AssertionError."""
    refused = 0
    for _ in range(runs):
        data, events = conversation(source)
        right = source.random() < 0.4
        if not right:
            data = spoiled(source, data) if source.random() < 0.9 else source.randbytes(source.randrange(200))
        whole, in_pieces = parsed(data), parsed(data, source)
        same = [normal(each) for each in whole[0]] == [normal(each) for each in in_pieces[0]]
        assert same and whole[1] == in_pieces[1], (data, whole, in_pieces)
        if right and whole[1] is None:
            assert [normal(each) for each in whole[0]] == [normal(each) for each in events], (data, whole[0], events)
        refused += whole[1] is not None
    return refused


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    began = time.monotonic()
    refused = run(random.Random(arguments.seed), arguments.runs)
    print(f"fuzz_zmtp: ok, {arguments.runs} conversations in {time.monotonic() - began:.0f} s, {refused} refused")


if __name__ == "__main__":
    main()
