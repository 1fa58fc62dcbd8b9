"""A daemon under attack by members of its group, everything at once: what do a subscriber and `force off` notice of it?

python -m bench.hostile [--for 3600] [--rate 10000]

Attackers in processes of their own open 2,000 connections and open them anew when they are ended; send messages of
parts without end, of empty parts and of 64 MiB; subscribe to 21 MB of what there is not; subscribe to everything and
never read; ask and never read the answers; send garbage, and ZMTP that is nearly right. Beside them one client reads
every sample, and another one turns the forces off, again and again.

Asked: no sample lost, `force off` answered within 50 ms (p99.9), and memory afterwards within 32 MiB of its start. Exit
code 1 if one of them is missed, or the daemon ends or fails. The attackers yield the processors to whoever else wants
them (nice 19): what is measured is what the daemon makes of them, not how the kernel shares the processors.

python -m bench.hostile --attack KIND DIRECTORY      one attacker, until it is killed
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import random
import re
import resource
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.daemon import daemon
from bench.report import ROOT
from hapticd import wire, zmtp
from hapticd.client import connect

CONNECTIONS = 2000
OFF_EVERY_S = 0.05
ASKED_MS, ASKED_MIB = 50.0, 32.0
SETTLE_S = 5.0


def open_to(path: Path, kind: bytes | None) -> socket.socket:
    """A connection, its handshake sent if a kind is given."""
    made = socket.socket(socket.AF_UNIX)
    made.settimeout(1)
    made.connect(str(path))
    if kind is not None:
        made.sendall(zmtp.GREETING + zmtp.ready(kind))
    return made


def again_and_again(attack: Callable[[Path], None], path: Path) -> None:
    """Whatever ends one attempt, the next follows."""
    while True:
        with contextlib.suppress(OSError):
            attack(path)


def connections(directory: Path) -> None:
    """So many connections, half of them with a handshake, to both sockets; those that end are opened anew."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    paths = (directory / "hapticd.command", directory / "hapticd.telemetry")
    kinds = itertools.cycle(((paths[0], b"DEALER"), (paths[1], b"SUB"), (paths[0], None), (paths[1], None)))
    mine: dict[int, socket.socket] = {}
    poll = select.poll()
    while True:
        while len(mine) < CONNECTIONS:
            try:
                made = open_to(*next(kinds))
            except OSError:
                time.sleep(0.001)  # the attacker's own pace
                break
            mine[made.fileno()] = made
            poll.register(made, select.POLLIN)
        for descriptor, _ in poll.poll(10):
            try:
                if mine[descriptor].recv(65536):
                    continue
            except OSError:
                pass
            poll.unregister(descriptor)
            mine.pop(descriptor).close()


def parts(path: Path) -> None:
    """Messages without end."""
    chosen = random.choice(
        (zmtp.header(60_000, zmtp.MORE) + bytes(60_000), b"\x01\x00" * 30_000, b"\x01\x01x" * 20_000)
    )
    with open_to(path, b"DEALER") as made:
        while True:
            made.sendall(chosen)


def huge(path: Path) -> None:
    """Messages of 64 MiB."""
    with open_to(path, b"DEALER") as made:
        while True:
            made.sendall(zmtp.header(2**26))
            for _ in range(2**10):
                made.sendall(bytes(2**16))


def subscriptions(path: Path) -> None:
    """21 MB of them."""
    with open_to(path, b"SUB") as made:
        for block in range(210):
            made.sendall(b"".join(zmtp.message([b"\x01" + b"%090d" % (block * 1000 + n)]) for n in range(1000)))


def deaf(path: Path) -> None:
    """Subscribers that never read."""
    made = []
    for _ in range(100):
        made.append(open_to(path, b"SUB"))
        made[-1].sendall(zmtp.message([b"\x01"]))
    time.sleep(3)
    for each in made:
        each.close()


def unread(path: Path) -> None:
    """Questions whose answers nobody reads."""
    question = zmtp.message([wire.request(1, "get_materials")]) * 20
    made = [open_to(path, b"DEALER") for _ in range(50)]
    for each in made:
        each.setblocking(False)
    for _ in range(1000):
        for each in made:
            with contextlib.suppress(BlockingIOError):
                each.send(question)
        time.sleep(0.001)
    for each in made:
        each.close()


def ask(path: Path) -> None:
    """Questions as fast as they go, over many connections."""
    question = zmtp.message([b"", wire.request(1, "get_scene")])
    made = [open_to(path, b"REQ") for _ in range(20)]
    for _ in range(500):
        for each in made:
            each.sendall(question)
        for each in made:
            each.recv(65536)
    for each in made:
        each.close()


def garbage(path: Path) -> None:
    """Bytes without sense, and right ones with a mistake."""
    right = zmtp.GREETING + zmtp.ready(b"DEALER") + zmtp.message([b"", wire.request(1, "get_status")]) * 3
    with open_to(path, None) as made:
        if random.random() < 0.3:
            made.sendall(random.randbytes(random.randrange(1, 5000)))
        else:
            wrong = bytearray(right + zmtp.command(b"PING", b"\0\0x") * 50)
            for _ in range(random.randrange(1, 6)):
                wrong[random.randrange(len(wrong))] = random.randrange(256)
            made.sendall(wrong[: random.randrange(1, len(wrong))])
        made.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            made.recv(4096)


ATTACKS: dict[str, tuple[Callable[[Path], None], str]] = {
    "parts": (parts, "command"),
    "huge": (huge, "command"),
    "subscriptions": (subscriptions, "telemetry"),
    "deaf": (deaf, "telemetry"),
    "unread": (unread, "command"),
    "ask": (ask, "command"),
    "garbage": (garbage, "command"),
    "noise": (garbage, "telemetry"),
}


def memory_mib(process: int) -> float:
    """Memory of a process that is its own and in use."""
    told = Path(f"/proc/{process}/smaps_rollup").read_text()
    return sum(int(kb) for kb in re.findall(r"^Private_\w+: +(\d+) kB", told, re.M)) / 1024


class Watcher(threading.Thread):
    """Reads every sample."""

    def __init__(self, directory: Path) -> None:
        super().__init__(daemon=True)
        self.directory, self.samples, self.missing = directory, 0, 0
        self.begun, self.stop = threading.Event(), threading.Event()

    def run(self) -> None:
        following: int | None = None
        with connect(self.directory, timeout_s=60) as client, client.samples(timeout_s=60) as stream:
            for batch in stream:
                first, last = int(batch["tick"][0]), int(batch["tick"][-1])
                if following is not None:
                    self.missing += first - following
                self.missing += last - first + 1 - len(batch)
                self.samples += len(batch)
                following = last + 1
                self.begun.set()
                if self.stop.is_set():
                    return


def main(seconds: float, rate_hz: float) -> int:
    """Attacks and prints; the exit code."""
    with daemon(rate_hz=rate_hz) as running:
        directory, began_s = running.paths.directory, time.monotonic()
        watcher = Watcher(directory)
        watcher.start()
        if not watcher.begun.wait(60):
            raise SystemExit("there is no telemetry")
        took: dict[str, list[float]] = {"before": [], "under attack": []}
        attackers: list[subprocess.Popen[bytes]] = []
        with connect(directory, timeout_s=60) as client:
            client.set_forces(False)
            time.sleep(SETTLE_S)
            first = peak = memory_mib(running.pid)

            def off(phase: str, seconds: float) -> None:
                nonlocal peak
                end = look = time.monotonic()
                end += seconds
                while time.monotonic() < end:
                    start = time.perf_counter()
                    client.set_forces(False)
                    took[phase].append(1e3 * (time.perf_counter() - start))
                    client.set_forces(True)
                    if time.monotonic() >= look:
                        peak = max(peak, memory_mib(running.pid))
                        look = time.monotonic() + 1.0
                    time.sleep(OFF_EVERY_S)

            off("before", min(60.0, seconds / 4))
            try:
                for kind in ("connections", *ATTACKS):
                    command = [sys.executable, "-m", "bench.hostile", "--attack", kind, str(directory)]
                    attackers.append(subprocess.Popen(command, cwd=ROOT))
                off("under attack", seconds)
            finally:
                for each in attackers:
                    each.kill()
                    each.wait()
            time.sleep(SETTLE_S)
            last = memory_mib(running.pid)
            status = client.get_status()
            watcher.stop.set()
            watcher.join()
    faults = ", ".join(status["faults"]) or "none"
    print(f"{seconds:g} s of attacks, {time.monotonic() - began_s:.0f} s in all; faults: {faults}")
    print(f"samples: {watcher.samples:,} read, {watcher.missing:,} lost (asked 0)")
    for phase, times in took.items():
        late = float(np.percentile(times, 99.9))
        print(
            f"force off {phase}, {len(times):,} times: p50 {np.median(times):.2f} ms, "
            f"p99 {np.percentile(times, 99):.2f}, "
            f"p99.9 {late:.2f} (asked {ASKED_MS:g}), worst {max(times):.2f}"
        )
    print(
        f"memory: {first:.1f} MiB at the start, {peak:.1f} at most, {last:.1f} afterwards "
        f"(asked: {ASKED_MIB:g} more at most)"
    )
    held = watcher.missing == 0 and late <= ASKED_MS and last - first <= ASKED_MIB and not status["faults"]
    return 0 if held else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--for", dest="seconds", type=float, default=3600.0, metavar="SECONDS")
    parser.add_argument("--rate", type=float, default=10_000.0, metavar="HZ")
    parser.add_argument("--attack", nargs=2, metavar=("KIND", "DIRECTORY"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.attack is None:
        sys.exit(main(arguments.seconds, arguments.rate))
    os.nice(19)
    kind, directory = arguments.attack[0], Path(arguments.attack[1])
    if kind == "connections":
        connections(directory)
    else:
        attack, name = ATTACKS[kind]
        again_and_again(attack, directory / f"hapticd.{name}")
