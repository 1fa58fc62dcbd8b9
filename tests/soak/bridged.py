"""A bridge under attack from its network, for `tests.soak.hostile --bridge`: what do its clients notice of it?

Attackers in processes of their own (`tests.soak.strangers`) hold 2,000 connections that never show a key, silent, with
half a greeting, a whole one or garbage, and open them again when they are ended: half of the processes from one
address, the others from hundreds. Clients with a key of their own subscribe and never read, and ask and never read the
answers.

Beside them one client of the bridge reads every sample and event, another one turns the forces off, again and again,
and a third comes in, asks for the status and leaves. Memory, descriptors and processor time are the bridge's.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.daemon import daemon
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client, connect
from hapticd.protocol.keys import new_certificate, write_certificate
from tests.soak import strangers, under_attack

CLIENTS = {"ours": "command", "theirs": "command"}
READY = "ready: commands at "
_READY_S = 60.0


@dataclass(frozen=True, slots=True)
class Bridge:
    """A bridge that is ready."""

    pid: int
    address: str
    keys: Path

    def enter(self, wait_s: float = 0.0) -> Client:
        """A client of ours. Raises HapticdError."""
        key, server_key = self.keys / "ours.key_secret", self.keys / "server.key"
        return connect(self.address, under_attack.PATIENCE_S, wait_s=wait_s, key=key, server_key=server_key)

    def attackers(self, connections: int) -> list[tuple[str, Sequence[str]]]:
        """All of them, by kind and command."""
        kinds = ["handshakes"] * -(-connections // strangers.CONNECTIONS) + ["forgotten", "unread"]
        rest = (self.address, str(self.keys / "theirs.key_secret"), str(self.keys / "server.key"))
        return [(kind, ("tests.soak.strangers", kind, str(number), *rest)) for number, kind in enumerate(kinds)]


@contextlib.contextmanager
def bridge(directory: Path) -> Iterator[Bridge]:
    """A bridge with its default limits. Raises HapticdError."""
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as name:
        keys, config, log = (Path(name, each) for each in ("keys", "bridge.yaml", "log"))
        write_certificate(new_certificate(), "server", keys)
        clients = {}
        for client, may in CLIENTS.items():
            certificate = new_certificate()
            write_certificate(certificate, client, keys)
            clients[client] = {"public_key": certificate.public_key, "may": may}
        config.write_text(json.dumps({"listen": "tcp://127.0.0.1:0", "metrics": None, "clients": clients}))
        command = [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "bridge", "-c", str(config)]
        with log.open("wb") as stderr:
            process = subprocess.Popen(command, stderr=stderr)
        try:
            deadline = time.monotonic() + _READY_S
            while READY not in (said := log.read_text()):
                if process.poll() is not None or time.monotonic() > deadline:
                    raise HapticdError(f"the bridge does not start: {said.strip()}")
                time.sleep(0.01)  # it is another process, and this line is the last that it says
            yield Bridge(process.pid, said.split(READY)[1].split(",")[0], keys)
        finally:
            process.terminate()
            code = process.wait()
        if code:
            raise HapticdError(f"the bridge ended with {code}: {log.read_text()[-5000:].strip()}")


class Newcomer(threading.Thread):
    """Comes in, asks and leaves, again and again."""

    def __init__(self, through: Bridge, took_s: list[float]) -> None:
        super().__init__(daemon=True)
        self._through, self._took_s = through, took_s
        self.stop = threading.Event()

    def run(self) -> None:
        while not self.stop.wait(0.1):
            begin = time.monotonic()
            with contextlib.suppress(HapticdError), self._through.enter(wait_s=under_attack.PATIENCE_S) as client:
                client.get_status()
                self._took_s.append(time.monotonic() - begin)


def attack(
    seconds: float,
    rate_hz: float,
    connections: int,
    settle_s: float,
    nice: int = 0,
    tell: Callable[[str], None] = lambda _: None,
) -> under_attack.Found:
    """Attacks a bridge of its own for so long."""
    found = under_attack.Found("the bridge")
    found.newcomers_s = []
    with daemon(rate_hz=rate_hz) as running, bridge(running.paths.directory) as attacked:
        watcher = under_attack.Watcher(attacked.enter)
        watcher.start()
        if not watcher.begun.wait(under_attack.PATIENCE_S):
            raise HapticdError("there is no telemetry")
        with attacked.enter() as client:
            time.sleep(settle_s)
            found.memory_mib = [under_attack.memory_mib(attacked.pid)] * 3
            measure = under_attack.Measure(attacked.pid, watcher, found, tell)
            newcomer = Newcomer(attacked, found.newcomers_s)
            begin = time.monotonic()
            try:
                measure.phase(client, "before", min(60.0, seconds / 4), [])
                with under_attack.attacked(attacked.attackers(connections), nice) as those:
                    newcomer.start()
                    try:
                        measure.phase(client, "under attack", seconds, those)
                    finally:
                        newcomer.stop.set()
                        found.count(those)
                        found.processor_s = under_attack.scheduled_s(attacked.pid)
                newcomer.join(under_attack.PATIENCE_S)
                time.sleep(settle_s)
                found.memory_mib[2] = under_attack.memory_mib(attacked.pid)
                found.problems += [f"the fault {name} is latched" for name in client.get_status()["faults"]]
            except (HapticdError, OSError, KeyboardInterrupt) as error:
                found.problems.append(f"{type(error).__name__}: {error}")
            found.seconds = time.monotonic() - begin
            watcher.stop.set()
            watcher.join(under_attack.PATIENCE_S)
    found.samples, found.missing, found.dropped = watcher.samples, watcher.missing, watcher.dropped
    found.faults = watcher.faults
    return found
