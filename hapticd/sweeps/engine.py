"""Computes the points of a study on the workers of a dask scheduler, and keeps each piece as soon as it is done.

Points go out in pieces of 1 to 10 s, shorter ones at the end, and a few at a time, so that a million points are never a
million tasks. Only this process writes results; a worker needs nothing but hapticd and what a piece brings.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from time import monotonic, perf_counter
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base import wording
from hapticd.base.errors import HapticdError, on_one_line
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Row
from hapticd.sweeps.interrupts import noted_interrupts, raise_interrupt
from hapticd.sweeps.store import Store
from hapticd.sweeps.task import Refusal, packed, task
from hapticd.sweeps.work import Work
from hapticd.sweeps.worker_check import code_version

MIN_PIECE_S: Final = 1.0
MAX_PIECE_S: Final = 10.0
MIN_PIECES_PER_THREAD: Final = 20
"""A study is cut into at least so many pieces for each worker, if they are not too short then."""
QUEUED_PIECES_PER_THREAD: Final = 2
"""Pieces that wait at a worker, besides the one that it computes."""
WORKER_WAIT_S: Final = 30.0
"""A scheduler without workers is given so long to get one."""
WORKER_POLL_S: Final = 1.0
"""How often workers are looked for where nothing comes."""
WORKERS_ENDED_REASON: Final = "every worker that computed it ended: too little memory, or a crash"
MIN_LAST_PIECE_S: Final = 0.1
"""No piece is made shorter than this for the sake of an even end."""

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a study is."""

    done: int
    total: int
    failed: int
    left_s: float | None
    """Estimated time left; None: nothing is known yet."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a study."""

    points: int
    reused: int
    """Rows that were there."""
    computed: int
    failed: int
    """Rows with an error, of those that were computed."""
    seconds: float
    worker_seconds: float
    """What workers spent on points, together."""


def run(
    work: Work,
    store: Store,
    opened: Callable[[], AbstractContextManager[Any]],
    note: Callable[[str], None],
    report: Callable[[Progress], None],
    again: bool = False,
) -> Outcome:
    """Computes the points of a study that the folder does not hold, on the workers of a `distributed.Client`, which
    `opened` gives if there is something to compute.

    `note` is called with a line about what goes wrong while the rest goes on. `again`: points whose row has an error
    are computed anew. Raises HapticdError where no worker can be used, or where results could not be written.
    """
    begin = perf_counter()
    with store.locked():
        store.begin(work)
        missing = np.flatnonzero(~np.isin(work.ids, store.present(work.columns, again)))
        counts = len(work.ids), len(work.ids) - len(missing)
        if not len(missing):
            return Outcome(*counts, computed=0, failed=0, seconds=perf_counter() - begin, worker_seconds=0.0)
        with opened() as client:
            engine = _Engine(work, store, client, note, report, missing)
            engine.go_on()
    return Outcome(*counts, engine.done, engine.failed, perf_counter() - begin, engine.spent_s)


@dataclass(frozen=True, slots=True)
class _Flying:
    """A piece that is computed, or waits for it."""

    part: Indices
    workers: frozenset[str] | None
    """Those that may compute it; None: all."""


@dataclass
class _Engine:
    work: Work
    store: Store
    client: Any
    note: Callable[[str], None]
    report: Callable[[Progress], None]
    missing: Indices
    done: int = 0
    failed: int = 0
    spent_s: float = 0.0
    threads: int = 1
    """Of the workers that are used."""
    begun: int = 0
    again: deque[Indices] = field(default_factory=deque)
    """Pieces that have to be computed once more, in smaller parts."""
    suspects: deque[Indices] = field(default_factory=deque)
    """Points whose workers ended. Another piece there may have been the reason: each is tried alone at the end."""
    alone: bool = False
    """Whether a suspect is tried."""
    flying: dict[Any, _Flying] = field(default_factory=dict)
    """By future."""
    came: SimpleQueue[Any] = field(default_factory=SimpleQueue)
    """Futures that are done, and None for an interrupt."""
    interrupted: int | None = None
    """By which signal."""
    refused: set[str] = field(default_factory=set)
    unwritten: list[Row] = field(default_factory=list)
    full: bool = False

    def __post_init__(self) -> None:
        self.columns: tuple[Column, ...] = self.work.columns
        self.version = code_version()

    # ---- Workers -----------------------------------------------------------------------------------------------------

    def workers(self) -> list[str]:
        """Those that may be used; `threads` is how many threads these have. Raises HapticdError where there is none."""
        known = self._known()
        deadline = monotonic() + WORKER_WAIT_S
        while not known and monotonic() < deadline:
            with suppress(OSError):  # among them TimeoutError: where all have ended, new ones take their place
                self.client.wait_for_workers(1, timeout=WORKER_POLL_S)
            self.end_if_interrupted()
            known = self._known()
        usable = {each: threads for each, threads in known.items() if each not in self.refused}
        if not usable:
            why = "none of its workers runs this hapticd" if known else "it has no workers"
            raise HapticdError(f"the scheduler {self.client.scheduler.address} cannot be used: {why}")
        self.threads = sum(usable.values())
        return list(usable)

    def _known(self) -> dict[str, int]:
        """Threads of each worker of the scheduler, by address. Raises HapticdError where the scheduler is gone."""
        try:
            found: dict[str, int] = self.client.nthreads()
        except (OSError, TimeoutError) as error:
            gone = f"the scheduler {self.client.scheduler.address} is gone: {on_one_line(str(error))}"
            raise HapticdError(f"{gone}; what is done stays, and the same command goes on") from None
        return found

    def examine(self) -> None:
        """Asks each worker for its version. One that comes later is asked with its first piece."""
        for address, answer in self.client.run(code_version, on_error="return").items():
            if isinstance(answer, OSError):
                continue  # it ended meanwhile
            if isinstance(answer, Exception):
                # What the worker could not send as it is, dask sends as a bare Exception with its text.
                kind = "" if type(answer) is Exception else f"{type(answer).__name__}: "
                self.refuse(address, on_one_line(f"{kind}{answer}"))
            elif answer != self.version:
                self.refuse(address, f"it runs hapticd {answer}, this study needs {self.version}")

    def refuse(self, address: str, why: str) -> None:
        """A worker gets nothing more."""
        if address not in self.refused:
            self.refused.add(address)
            self.note(f"worker {address} is not used: {why}")

    # ---- Pieces ------------------------------------------------------------------------------------------------------

    def size(self, threads: int) -> int:
        """How many points the next piece has."""
        if not self.done:
            return 1
        each_s = max(self.spent_s / self.done, 1e-7)
        left_s = (len(self.missing) - self.begun) * each_s
        wanted_s = min(max(len(self.missing) * each_s / (MIN_PIECES_PER_THREAD * threads), MIN_PIECE_S), MAX_PIECE_S)
        return max(1, round(min(wanted_s, max(left_s / (2 * threads), MIN_LAST_PIECE_S)) / each_s))

    def next_piece(self, threads: int) -> Indices | None:
        """Which points come next; None: all have begun."""
        if self.again:
            return self.again.popleft()
        if self.begun == len(self.missing):
            return None
        part = self.missing[self.begun : self.begun + self.size(threads)]
        self.begun += len(part)
        return part

    def submit(self) -> None:
        """Gives each worker something to do, and something to go on with."""
        self.end_if_interrupted()
        workers = frozenset(self.workers())
        self.recall(workers)
        # Until it is known how long a point takes, nothing waits.
        most = self.threads * (1 + (QUEUED_PIECES_PER_THREAD if self.done else 0))
        while len(self.flying) < most and not self.alone:
            part = self.next_piece(self.threads)
            if part is None and self.suspects and not self.flying:
                part, self.alone = self.suspects.popleft(), True
            if part is None:
                return
            future = self.client.submit(
                task,
                packed(self.work.piece(part)),
                self.version,
                pure=False,
                workers=sorted(workers) if self.refused else None,
                allow_other_workers=False,
            )
            self.flying[future] = _Flying(part, workers if self.refused else None)
            future.add_done_callback(self.came.put)

    def recall(self, workers: frozenset[str]) -> None:
        """Takes back what waits for workers that have all left: dask would keep it for their return."""
        for future, flying in list(self.flying.items()):
            if flying.workers is not None and not flying.workers & workers:
                self.client.cancel([future], force=True)
                del self.flying[future]
                self.lost(flying.part, WORKERS_ENDED_REASON)

    def go_on(self) -> None:
        """Until all is done. Raises HapticdError; and as a signal would, once nothing is half done."""
        try:
            with noted_interrupts(self.interrupt):
                self.examine()
                self.submit()
                while self.flying:
                    # Where nothing comes, submit finds out whether there is still a worker.
                    with suppress(Empty):
                        self.take(self.came.get(timeout=WORKER_POLL_S))
                    self.submit()
        except BaseException:
            with suppress(OSError):  # the scheduler may be gone
                self.client.cancel(list(self.flying), force=True)
            try:
                self.write_rest()
            except HapticdError as error:
                self.note(str(error))
            raise
        self.write_rest()

    def interrupt(self, number: int) -> None:
        """From a signal's handler: the loop ends the study."""
        self.interrupted = number
        self.came.put(None)

    def end_if_interrupted(self) -> None:
        """Raises as the signal would that has arrived."""
        if self.interrupted is not None:
            raise_interrupt(self.interrupted)

    def write_rest(self) -> None:
        """What could not be written before. Raises HapticdError where it still cannot."""
        if not self.unwritten:
            return
        try:
            self.store.write(self.unwritten, self.columns)
        except HapticdError as error:
            lost = wording.count(len(self.unwritten), "row")
            raise HapticdError(f"{error}; {lost} of results are lost: the same command computes them again") from None

    def take(self, future: Any) -> None:
        """What came of a piece. What was lost with its worker before it came here, dask computes again meanwhile."""
        from distributed import CancelledError, KilledWorker

        if future not in self.flying:
            return  # it was taken back, or it is an interrupt
        part = self.flying[future].part
        try:
            found = future.result(timeout=WORKER_WAIT_S)
        except CancelledError:
            self.again.append(part)
        except Exception as failure:
            if isinstance(failure, TimeoutError) and future.status != "error":
                future.add_done_callback(self.came.put)
                return
            self.lost(
                part,
                WORKERS_ENDED_REASON if isinstance(failure, KilledWorker) else f"{type(failure).__name__}: {failure}",
            )
        else:
            if isinstance(found[0], str):
                refusal: Refusal = found
                self.refuse(*refusal)
                self.again.append(part)
            else:
                rows, seconds = found
                self.spent_s += seconds
                self.keep(rows)
        del self.flying[future]
        self.alone = False

    def lost(self, part: Indices, why: str) -> None:
        """Nothing came of a piece: one of its points is at fault, and the others are to be had."""
        if len(part) > 1:
            self.again.extend(np.array_split(part, min(len(part), 8)))
        elif why == WORKERS_ENDED_REASON and not self.alone:
            self.suspects.append(part)
        else:
            self.alone = False
            self.keep([self.failure(part[0], why)])

    def failure(self, index: np.int64, why: str) -> Row:
        """The row of a point of which nothing came."""
        row: Row = dict.fromkeys(column.name for column in self.columns)
        row[POINT_COLUMN.name] = self.work.ids[index].tobytes().hex()
        row[ERROR_COLUMN.name] = on_one_line(why)
        return row

    def keep(self, rows: list[Row]) -> None:
        """Writes a piece; where that fails it is written with the next one."""
        self.done += len(rows)
        self.failed += sum(row[ERROR_COLUMN.name] is not None for row in rows)
        self.unwritten += rows
        try:
            self.store.write(self.unwritten, self.columns)
            self.unwritten = []
            self.full = False
        except HapticdError as error:
            if not self.full:
                self.note(f"{error}; results are kept in memory and written with the next ones")
            self.full = True
        left = len(self.missing) - self.done
        self.report(Progress(self.done, len(self.missing), self.failed, left * self.spent_s / self.done / self.threads))
