"""A daemon under attack by members of its group, everything at once: what do a subscriber and `force off` notice of it?

python -m tests.soak.hostile [--for 3600] [--rate 10000] [--connections 2000] [--out build/hostile.md]

Attackers in processes of their own (`tests.soak.attackers`)

- hold 2,000 connections, a quarter of them subscribers that never read, a half without a handshake, and open them anew
  when they are ended;
- send messages of parts without end, of empty parts and of 64 MiB, and subscribe to 21 MB of what there is not;
- ask and never read the answers, ask as fast as it goes, send garbage, and ZMTP that is nearly right;
- send mutated requests of every method, and look at each answer;
- change the scene with 64 autoregressive models of order 32 and 512 patches, and take them away.

Beside them one client reads every sample and event, and another one turns the forces off, again and again. Attackers
yield the processors to whoever else wants them (nice 10), and daemon and clients come first if we have the right: what
is measured is what the daemon makes of it, not how the kernel shares the processors.

Asked: no fault, no sample lost, `force off` answered within 50 ms (p99.9), and memory afterwards within 32 MiB of its
start, once scene and materials are as they were. Exit code 1 if one of them is missed. Says every ten seconds how it
goes; what was found is a table on the terminal and in the file.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from bench.daemon import daemon
from bench.report import ROOT
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client, connect
from hapticd.protocol import messages
from hapticd.protocol.calls import RemoteError
from tests.soak import attackers
from tests.soak.under_attack import PATIENCE_S, Found, Measure, Watcher, attacked
from tests.support.processes import memory_kib, scheduled_s

SETTLE_S = 15.0
"""Longer than the flight recorder remembers."""
PRIORITY, NICE = -10, 10
"""Of daemon and clients, and of attackers."""


def members(directory: Path, connections: int) -> list[tuple[str, Sequence[str]]]:
    """The attackers of a daemon's sockets."""
    kinds = ["connections"] * -(-connections // attackers.CONNECTIONS) + ["fuzz", "long", *attackers.ATTACKS]
    return [(kind, ("tests.soak.attackers", kind, str(directory))) for kind in kinds]


def restore(client: Client, scene: object, materials: object) -> None:
    """Scene and materials as they were, once what was under way is over."""
    assert isinstance(materials, dict)
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            client.call("set_scene", {"scene": scene, "wait": True})
            others = {name: None for name in client.get_materials()["materials"] if name not in materials}
            client.call("update_materials", {"materials": others | materials})
            return
        except RemoteError as error:
            if error.code != messages.Code.RING_FULL or time.monotonic() > deadline:
                raise
            time.sleep(0.5)


def attack(
    seconds: float,
    rate_hz: float,
    connections: int,
    settle_s: float,
    nice: int = 0,
    tell: Callable[[str], None] = lambda _: None,
) -> Found:
    """Attacks a daemon of its own for so long."""
    found = Found()
    with daemon(rate_hz=rate_hz) as running:
        directory, pid = running.paths.directory, running.pid
        watcher = Watcher(directory)
        watcher.start()
        if not watcher.begun.wait(PATIENCE_S):
            raise HapticdError("there is no telemetry")
        with connect(directory, timeout_s=PATIENCE_S) as client:
            scene, materials = client.get_scene()["scene"], client.get_materials()["materials"]
            time.sleep(settle_s)
            found.memory_mib = [memory_kib(pid) / 1024] * 3
            measure = Measure(pid, watcher, found, tell)
            measure.phase(client, "before", min(60.0, seconds / 4), [])
            begin = time.monotonic()
            try:
                with attacked(members(directory, connections), nice) as those:
                    try:
                        measure.phase(client, "under attack", seconds, those)
                    finally:
                        found.count(those)
                        found.processor_s = scheduled_s(pid)
                restore(client, scene, materials)
                time.sleep(settle_s)
                found.memory_mib[2] = memory_kib(pid) / 1024
                client.set_forces(True)
                found.problems += [f"the fault {name} is latched" for name in client.get_status()["faults"]]
            except (HapticdError, OSError, KeyboardInterrupt) as error:
                found.problems.append(f"{type(error).__name__}: {error}")
            found.seconds = time.monotonic() - begin
            watcher.stop.set()
            watcher.join(PATIENCE_S)
    found.samples, found.missing, found.dropped = watcher.samples, watcher.missing, watcher.dropped
    found.faults = watcher.faults
    return found


def main(seconds: float, rate_hz: float, connections: int, out: Path) -> int:
    """Attacks, prints and writes; the exit code."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    found = attack(seconds, rate_hz, connections, SETTLE_S, NICE, lambda line: print(line, flush=True))
    text = found.table().markdown()
    print(text)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text + "\n", encoding="utf-8")
    return 0 if found.held() else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--for", dest="seconds", type=float, default=3600.0, metavar="SECONDS")
    parser.add_argument("--rate", type=float, default=10_000.0, metavar="HZ")
    parser.add_argument("--connections", type=int, default=2000, metavar="COUNT")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "hostile.md", metavar="FILE")
    arguments = parser.parse_args()
    sys.exit(main(arguments.seconds, arguments.rate, arguments.connections, arguments.out))
