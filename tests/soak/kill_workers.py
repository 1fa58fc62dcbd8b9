"""Kills one of two workers of an external scheduler at a random moment, again and again: are the rows the same bits?

python -m tests.soak.kill_workers [--kills 20] [--seed 1] [--points 200]

The study is of taps on the seven materials over the mass of the hand. Its rows are computed by one process, by two, and
by threads before, and by the worker that is left after each SIGKILL. Each line says after how many points the kill was.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from hapticd.sweeps.cluster import client_of
from hapticd.sweeps.engine import Outcome, Progress, run
from hapticd.sweeps.store import Store
from hapticd.sweeps.study import load_sweep
from tests.soak.interrupt_sweeps import study
from tests.sweeps.external import WORKER, connected, scheduler


def computed(file: Path, folder: Path, opened: AbstractContextManager[Any], report: Any = None) -> tuple[Outcome, str]:
    """What came of a study, and the SHA-256 of its rows."""
    store = Store(folder, print)
    outcome = run(load_sweep(str(file)), store, lambda: opened, print, report or (lambda progress: None))
    return outcome, store.digest()


def with_a_kill(file: Path, folder: Path, chance: random.Random, points: int) -> tuple[Outcome, str, str]:
    """As `computed`, by two workers of which one is killed; and when it was."""
    after_points, after_s = chance.randrange(points * 3 // 4), chance.uniform(0.0, 0.3)
    when = ""
    with scheduler(WORKER, WORKER) as running:
        victim = chance.choice(running.workers)

        def report(progress: Progress) -> None:
            nonlocal when
            if not when and progress.done > after_points:
                time.sleep(after_s)  # at any moment of a piece, not at its end
                victim.kill()
                when = f"{progress.done} points and {after_s:.2f} s"

        @contextmanager
        def opened() -> Iterator[Any]:
            with connected(running.address, 2) as client:
                yield client

        outcome, digest = computed(file, folder, opened(), report)
    return outcome, digest, when


def main() -> int:
    """The exit code: whether all rows were the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--points", type=int, default=200)
    given = parser.parse_args()
    chance = random.Random(given.seed)
    digests = []
    with tempfile.TemporaryDirectory(prefix="hapticd-soak-") as name:
        folder = Path(name)
        file = study(folder, given.points)
        for label, workers, threads in (("one process", 1, False), ("two processes", 2, False), ("threads", 2, True)):
            outcome, digest = computed(file, folder / label, client_of(None, workers, threads))
            print(f"{label}: {outcome.computed} points, {outcome.failed} failed, {digest[:16]}", flush=True)
            digests.append(digest)
        for index in range(given.kills):
            outcome, digest, when = with_a_kill(file, folder / f"killed {index}", chance, given.points)
            told = f"{outcome.computed} points, {outcome.failed} failed, {digest[:16]}"
            print(f"kill {index + 1} after {when or 'the end'}: {told}", flush=True)
            digests.append(digest)
    print(f"{given.kills} kills, seed {given.seed}: {len(set(digests))} different digest of {len(digests)}")
    return 0 if len(set(digests)) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
