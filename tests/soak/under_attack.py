"""What a subscriber and `force off` notice while a daemon is attacked, and what it costs them."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from bench.report import ROOT, Table
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client, connect
from hapticd.protocol.calls import RemoteError
from tests.support.processes import descriptors, memory_kib

OFF_EVERY_S = 0.02
TELL_EVERY_S = 10.0
ASKED_MS, ASKED_MIB = 50.0, 32.0
PATIENCE_S = 120.0
BEGIN_S = 30.0
NOT_BEGUN = "has not begun"
COUNTED = re.compile(r"([\d,]+) (.+)")
"""How an attacker says what it did."""


class Watcher(threading.Thread):
    """Reads every sample, and counts faults."""

    def __init__(self, directory: Path) -> None:
        super().__init__(daemon=True)
        self._directory, self.samples, self.missing, self.dropped = directory, 0, 0, 0
        self.faults: Counter[str] = Counter()
        self.failed: Exception | None = None
        self.begun, self.stop = threading.Event(), threading.Event()

    def run(self) -> None:
        try:
            with connect(self._directory, timeout_s=PATIENCE_S) as client:
                self._read(client)
        except (HapticdError, OSError) as error:
            self.failed = error

    def _read(self, client: Client) -> None:
        following: int | None = None
        dropped: int | None = None
        with client.samples() as stream, client.events() as events:
            for batch in stream:
                first, last = int(batch["tick"][0]), int(batch["tick"][-1])
                if following is not None:
                    self.missing += first - following
                self.missing += last - first + 1 - len(batch)
                self.samples += len(batch)
                following = last + 1
                dropped = batch.dropped if dropped is None else dropped
                self.dropped = batch.dropped - dropped
                self.begun.set()
                while (event := events.receive(0)) is not None:
                    if event["event"] == "fault":
                        self.faults.update(event["faults"])
                if self.stop.is_set():
                    return


@dataclass(frozen=True, slots=True)
class Done:
    """How often attackers of one kind did what they do, of so many processes."""

    count: int
    what: str
    processes: int = 1

    def __str__(self) -> str:
        by = f", by {self.processes} processes" if self.processes > 1 else ""
        return f"{self.count:,} {self.what}{by}"


@dataclass(slots=True)
class Attacker:
    """A process, and the file that it writes to."""

    kind: str
    process: subprocess.Popen[bytes]
    output: IO[bytes]
    ended: bool = False

    def told(self) -> str:
        """The last line it said."""
        size = os.fstat(self.output.fileno()).st_size
        lines = os.pread(self.output.fileno(), 4096, max(0, size - 4096)).decode(errors="replace").splitlines()
        return lines[-1] if lines else NOT_BEGUN

    def done(self) -> Done:
        """What it did so far."""
        counted = COUNTED.match(told := self.told())
        return Done(int(counted[1].replace(",", "")), counted[2]) if counted else Done(0, f"({told})")


@contextlib.contextmanager
def attacked(those: Iterable[tuple[str, Sequence[str]]], nice: int) -> Iterator[list[Attacker]]:
    """All attackers, each by its kind and what follows `python -m`, until the context ends; then they are killed."""
    with contextlib.ExitStack() as stack:
        found: list[Attacker] = []
        for kind, words in those:
            output = stack.enter_context(tempfile.TemporaryFile())
            process = subprocess.Popen([sys.executable, "-m", *words], cwd=ROOT, stdout=output, stderr=output)
            with contextlib.suppress(PermissionError):
                os.setpriority(os.PRIO_PROCESS, process.pid, nice)
            found.append(Attacker(kind, process, output))
            stack.callback(process.wait)
            stack.callback(process.kill)
        yield found


@dataclass(slots=True)
class Found:
    """What came of it."""

    seconds: float = 0.0
    samples: int = 0
    missing: int = 0
    dropped: int = 0
    """Of those that are missing, in the daemon's ring: its publisher got no processor."""
    faults: Counter[str] = field(default_factory=Counter)
    took_ms: dict[str, list[float]] = field(default_factory=lambda: {"before": [], "under attack": []})
    memory_mib: list[float] = field(default_factory=list)
    """At the start, at most, afterwards."""
    descriptors: int = 0
    processor_s: tuple[float, float] = (0.0, 0.0)
    """How long the daemon had one, and how long it waited for one."""
    done: dict[str, Done] = field(default_factory=dict)
    """What the attackers of each kind did."""
    idle: list[str] = field(default_factory=list)
    """Attackers that did nothing: whatever they try was not tried."""
    problems: list[str] = field(default_factory=list)
    """What else was not as it should be."""

    def late_ms(self) -> float:
        """How long `force off` took at most under attack, of 1000 times 999."""
        return percentile(self.took_ms["under attack"], 99.9)

    def kept(self) -> bool:
        """Whether nothing failed, whatever the time it took."""
        ran_s, waited_s = self.processor_s
        # Where others hold the processors, nobody can serve commands, and not all attackers come to attack.
        starved = waited_s > ran_s
        bad = self.faults.keys() - ({"control"} if starved else set()) or (self.idle and not starved)
        return not bad and not self.missing and not self.problems and bool(self.took_ms["under attack"])

    def held(self) -> bool:
        """Whether all that is asked was found."""
        start, _, after = self.memory_mib
        return (
            self.kept()
            and not self.faults
            and not self.idle
            and self.late_ms() <= ASKED_MS
            and after - start <= ASKED_MIB
        )

    def count(self, those: list[Attacker]) -> None:
        """Adds up what attackers did, and finds those that did nothing."""
        for each in those:
            done, before = each.done(), self.done.get(each.kind)
            if each.process.poll() is not None:
                self.problems.append(f"{each.kind} ended: {each.told()}")
            elif not done.count:
                self.idle.append(f"{each.kind} did nothing: {done}")
            if before is not None:
                what = done.what if done.count else before.what
                done = Done(before.count + done.count, what, before.processes + 1)
            self.done[each.kind] = done

    def table(self) -> Table:
        """All of it."""
        faults = ", ".join(f"{name} {count} times" for name, count in self.faults.items()) or "none"
        rows = [
            ["faults", "none", faults],
            ["samples read", "", f"{self.samples:,}"],
            ["samples lost", "0", f"{self.missing:,}"],
            ["of them in the daemon's ring", "0", f"{self.dropped:,}"],
        ]
        for phase, times in self.took_ms.items():
            p50, p99, p999 = (f"{percentile(times, each):.2f}" for each in (50, 99, 99.9))
            largest = f"{max(times, default=np.nan):.2f}"
            asked = f"p99.9 at most {ASKED_MS:g}" if phase == "under attack" else ""
            said = f"{p50} / {p99} / {p999} / {largest}, {len(times):,} times"
            rows.append([f"`force off` {phase}: p50 / p99 / p99.9 / largest, ms", asked, said])
        start, most, after = (f"{each:.1f}" for each in self.memory_mib)
        rows.append(["memory: start / most / afterwards, MiB", f"{ASKED_MIB:g} more", f"{start} / {most} / {after}"])
        rows.append(["descriptors at most", "", f"{self.descriptors:,}"])
        rows.append(["the daemon had a processor / waited for one, s", "", "{:.1f} / {:.1f}".format(*self.processor_s)])
        rows += [[f"attacker: {kind}", "some", str(done)] for kind, done in self.done.items()]
        rows += [["problem", "none", problem] for problem in self.problems + self.idle]
        return Table(f"{self.seconds:.0f} s of attacks", ["what", "asked", "found"], rows)


def percentile(times: list[float], share: float) -> float:
    """Of what may be empty."""
    return float(np.percentile(times, share)) if times else float("nan")


class Measure:
    """The client that turns the forces off, and looks at the daemon."""

    def __init__(self, pid: int, watcher: Watcher, found: Found, tell: Callable[[str], None]) -> None:
        self._pid, self._watcher, self._found, self._tell = pid, watcher, found, tell

    def phase(self, client: Client, phase: str, seconds: float, those: list[Attacker]) -> None:
        """For so long, and until all attackers have done something, but BEGIN_S longer at most.

        Raises HapticdError where there is no answer, or the watcher ended.
        """
        times, found = self._found.took_ms[phase], self._found
        begin = time.monotonic()
        look, tell, told = begin, begin + TELL_EVERY_S, 0
        begun = not those
        while (now := time.monotonic()) < begin + seconds or (not begun and now < begin + seconds + BEGIN_S):
            start = time.perf_counter()
            client.set_forces(False)
            times.append(1e3 * (time.perf_counter() - start))
            with contextlib.suppress(RemoteError):  # the cause of a fault lasts; it is counted
                client.set_forces(True)
            if now >= look:
                found.memory_mib[1] = max(found.memory_mib[1], memory := memory_kib(self._pid) / 1024)
                found.descriptors = max(found.descriptors, descriptors(self._pid))
                if self._watcher.failed is not None:
                    raise HapticdError(f"who reads the samples: {self._watcher.failed}")
                begun = begun or all(each.done().count for each in those)
                look = now + 1.0
            if now >= tell:
                last = times[told:]
                self._tell(
                    f"{phase}, {now - begin:.0f} s: {self._watcher.missing} samples lost, faults "
                    f"{dict(self._watcher.faults) or 'none'}, force off p50 {percentile(last, 50):.1f}, p99 "
                    f"{percentile(last, 99):.1f}, largest {max(last):.1f} ms; memory {memory:.1f} MiB, "
                    f"{descriptors(self._pid)} descriptors"
                )
                for each in those:
                    if each.process.poll() is not None and not each.ended:
                        each.ended = True
                        self._tell(f"{each.kind} ended: {each.told()}")
                tell, told = now + TELL_EVERY_S, len(times)
            time.sleep(OFF_EVERY_S)
