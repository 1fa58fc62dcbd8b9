"""What members of the daemon's group may do to it: one attacker, until it is killed; for `tests.soak.hostile`.

python -m tests.soak.attackers KIND DIRECTORY      prints once a second what it has done so far

Each attack yields whenever it has done something; only that counts.
"""

from __future__ import annotations

import contextlib
import itertools
import random
import resource
import select
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from hapticd.client.blocking import Client, connect
from hapticd.protocol import messages, zmtp
from hapticd.protocol.calls import RemoteError

CONNECTIONS = 250
"""Of one attacker that holds connections; half of them to each socket."""
MODELS, ORDER = 64, 32
PATCHES = 512
"""Of a wall; there are two walls."""

_PATIENCE_S = 600.0


class Tally:
    """What was done so far, for who reads the output."""

    def __init__(self, what: str) -> None:
        self._what, self._count, self._due_s = what, 0, 0.0
        self.add(0)

    def add(self, count: int = 1) -> None:
        first = not self._count and count
        self._count += count
        if first or time.monotonic() >= self._due_s:
            print(f"{self._count:,} {self._what}", flush=True)
            self._due_s = time.monotonic() + 1.0


def open_to(path: Path, kind: bytes | None) -> socket.socket:
    """A connection, its handshake sent if a kind is given."""
    made = socket.socket(socket.AF_UNIX)
    try:
        made.settimeout(1)
        made.connect(str(path))
        if kind is not None:
            made.sendall(zmtp.ZMTP_GREETING + zmtp.ready(kind))
    except OSError:
        made.close()
        raise
    return made


def several(stack: contextlib.ExitStack, path: Path, kind: bytes, count: int) -> list[socket.socket]:
    """So many connections, or fewer where the daemon takes no more; raises OSError where it takes none."""
    made: list[socket.socket] = []
    while len(made) < count:
        try:
            made.append(stack.enter_context(open_to(path, kind)))
        except OSError:
            if not made:
                raise
            break
    return made


# ---- Connections -----------------------------------------------------------------------------------------------------


def keep(count: int, opened: Callable[[], socket.socket], tally: Tally) -> None:
    """Holds so many connections, opened anew where they are ended, for ever. `opened` may raise OSError."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    mine: dict[int, socket.socket] = {}
    poll = select.poll()
    while True:
        for _ in range(count - len(mine)):
            try:
                made = opened()
            except OSError:
                time.sleep(0.01)  # the attacker's own pace
                break
            mine[made.fileno()] = made
            # What comes is never read: only the end of a connection is looked for.
            poll.register(made, select.POLLRDHUP)
            tally.add()
        for descriptor, _ in poll.poll(100):
            poll.unregister(descriptor)
            mine.pop(descriptor).close()


def connections(directory: Path) -> None:
    """So many connections to both sockets, opened anew where they are ended: half of them with a handshake, those to
    the telemetry socket subscribed to everything and never read."""
    paths = (directory / "hapticd.command", directory / "hapticd.telemetry")
    kinds = itertools.cycle(((paths[0], b"DEALER"), (paths[1], b"SUB"), (paths[0], None), (paths[1], None)))

    def opened() -> socket.socket:
        path, kind = next(kinds)
        made = open_to(path, kind)
        if kind == b"SUB":
            made.sendall(zmtp.message([b"\x01"]))
        return made

    keep(CONNECTIONS, opened, Tally("connections"))


def garbage(path: Path) -> Iterator[None]:
    """Bytes without sense, and right ones with a mistake."""
    right = zmtp.ZMTP_GREETING + zmtp.ready(b"DEALER") + zmtp.message([b"", messages.request(1, "get_status")]) * 3
    with open_to(path, None) as made:
        if random.random() < 0.3:
            made.sendall(random.randbytes(random.randrange(1, 5000)))
        else:
            wrong = bytearray(right + zmtp.command(b"PING", b"\0\0x") * 50)
            for _ in range(random.randrange(1, 6)):
                wrong[random.randrange(len(wrong))] = random.randrange(256)
            made.sendall(wrong[: random.randrange(1, len(wrong))])
        yield
        made.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            made.recv(4096)


# ---- Messages --------------------------------------------------------------------------------------------------------


def parts(path: Path) -> Iterator[None]:
    """Messages without end."""
    chosen = random.choice(
        (zmtp.header(60_000, zmtp.MORE_FLAG) + bytes(60_000), b"\x01\x00" * 30_000, b"\x01\x01x" * 20_000)
    )
    with open_to(path, b"DEALER") as made:
        while True:
            made.sendall(chosen)
            yield


def huge(path: Path) -> Iterator[None]:
    """Messages of 64 MiB, the longest that are not ended."""
    with open_to(path, b"DEALER") as made:
        while True:
            made.sendall(zmtp.header(2**26))
            for _ in range(2**6):
                made.sendall(bytes(2**20))
                yield


def subscriptions(path: Path) -> Iterator[None]:
    """21 MB of them."""
    with open_to(path, b"SUB") as made:
        for block in range(210):
            made.sendall(b"".join(zmtp.message([b"\x01" + b"%090d" % (block * 1000 + n)]) for n in range(1000)))
            yield


def deaf(path: Path) -> Iterator[None]:
    """Subscribers that never read, and come and go."""
    with contextlib.ExitStack() as stack:
        for _ in range(100):
            made = stack.enter_context(open_to(path, b"SUB"))
            made.sendall(zmtp.message([b"\x01"]))
            yield
        time.sleep(3)


def unread(path: Path) -> Iterator[None]:
    """Questions whose answers nobody reads."""
    question = zmtp.message([messages.request(1, "get_materials")]) * 20
    with contextlib.ExitStack() as stack:
        made = several(stack, path, b"DEALER", 50)
        for each in made:
            each.setblocking(False)
        for _ in range(1000):
            for each in made:
                with contextlib.suppress(BlockingIOError):
                    each.send(question)
                    yield
            time.sleep(0.001)


def ask(path: Path) -> Iterator[None]:
    """Questions as fast as they go, over many connections."""
    question = zmtp.message([b"", messages.request(1, "get_scene")])
    with contextlib.ExitStack() as stack:
        made = several(stack, path, b"REQ", 20)
        for _ in range(500):
            for each in made:
                each.sendall(question)
            for each in made:
                each.recv(65536)
                yield


def fuzz(directory: Path) -> None:
    """Mutated requests of every method, each answer checked. Without leases: one that lapses is a fault by right."""
    from tests.soak import fuzz_messages

    source, tally = random.Random(), Tally("messages, each answer as the protocol says")
    traffic = fuzz_messages.Traffic(directory)
    while True:
        what = fuzz_messages.message(source, quiet=False)
        if what.method != "lease":
            traffic.send(what)
            traffic.revisions.clear()
            tally.add()


# ---- Long changes ----------------------------------------------------------------------------------------------------


def noise(source: random.Random, count: int = MODELS) -> dict[str, object]:
    """A valid material of autoregressive models that nobody has sent before."""
    models = [
        {
            "speed_m_per_s": 0.001 * (1 + number % 20),
            "force_n": 0.1 * (1 + number // 20),
            "coefficients": [source.uniform(-0.9, -0.8), *[0.0] * (ORDER - 2), source.uniform(0, 1e-3)],
            "rms_m_per_s2": 1.0,
        }
        for number in range(count)
    ]
    return {"stiffness_n_per_m": 100, "texture": {"kind": "autoregressive", "rate_hz": 2000, "models": models}}


def wall(number: int, patches: int = PATCHES) -> dict[str, object]:
    """A wall, below all others, with so many patches."""
    each = [{"from_m": 4e-4 * n, "to_m": 4e-4 * n + 3e-4, "material": "wood"} for n in range(patches)]
    return {"kind": "wall", "point_m": [0, -5 - number], "normal": [0, 1], "material": "wood", "patches": each}


def _taken(client: Client, method: str, params: Mapping[str, object]) -> None:
    """Tries until there is room for one more change."""
    while True:
        try:
            client.call(method, params)
            return
        except RemoteError as error:
            if error.code != messages.Code.RING_FULL:
                raise
            time.sleep(0.1)


def long_changes(source: random.Random) -> Iterator[tuple[str, dict[str, object]]]:
    """Models and patches, and small changes beside them, and what takes them away again."""
    yield "update_materials", {"materials": {"noise": noise(source)}}
    plain = {"kind": "wall", "point_m": [0, -4], "normal": [0, 1], "material": "noise"}
    yield "update_scene", {"objects": {"noisy": plain}}
    for number in range(2):
        yield "update_scene", {"objects": {f"long{number}": wall(number)}}
    for number in range(20):
        yield "update_scene", {"objects": {"long0": {"point_m": [0, -5 - 1e-3 * number]}}}
    yield "update_scene", {"objects": {"noisy": None, "long0": None, "long1": None}}
    yield "update_materials", {"materials": {"noise": None}}


def long(directory: Path) -> None:
    """Valid changes that take long, one after the other. Others may remove between them what they speak of."""
    source, tally = random.Random(), Tally("long changes")
    while True:
        with connect(directory, timeout_s=_PATIENCE_S) as client:
            for method, params in long_changes(source):
                with contextlib.suppress(RemoteError):
                    _taken(client, method, params)
                    tally.add()


# ---- One attacker ----------------------------------------------------------------------------------------------------

ATTACKS: dict[str, tuple[Callable[[Path], Iterator[None]], str, str]] = {
    "parts": (parts, "command", "blocks of 60 kB of parts"),
    "huge": (huge, "command", "MiB of messages of 64 MiB"),
    "subscriptions": (subscriptions, "telemetry", "blocks of 1000 subscriptions"),
    "deaf": (deaf, "telemetry", "subscribers that never read"),
    "unread": (unread, "command", "blocks of 20 questions"),
    "ask": (ask, "command", "answers"),
    "garbage": (garbage, "command", "connections of garbage"),
    "nonsense": (garbage, "telemetry", "connections of garbage"),
}
"""At one of the sockets, and what is counted; whatever ends an attack, the next follows."""
OTHERS: dict[str, Callable[[Path], None]] = {"connections": connections, "fuzz": fuzz, "long": long}
"""Which go on by themselves, and are over where something is not as it should be."""


def main(kind: str, directory: Path) -> None:
    """Attacks until it is killed."""
    if kind in OTHERS:
        OTHERS[kind](directory)
        return
    attack, name, what = ATTACKS[kind]
    tally = Tally(what)
    while True:
        with contextlib.suppress(OSError):
            for _ in attack(directory / f"hapticd.{name}"):
                tally.add()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
