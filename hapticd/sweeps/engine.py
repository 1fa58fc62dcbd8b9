"""The engine: computes the points of a study on the workers of a dask scheduler.

A piece is a group of points that a worker computes as one dask task, in 1 to 10 s (the last pieces in less). Only a few
pieces are submitted at a time, so that a million points are never a million tasks. Only this process writes results: it
writes the rows of a piece as soon as they arrive. A worker needs only hapticd and the content of its piece.
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
from hapticd.base.errors import HapticdError, collapse_whitespace
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Row
from hapticd.sweeps.interrupts import noted_interrupts, raise_interrupt
from hapticd.sweeps.store import Store
from hapticd.sweeps.task import Refusal, pickled, task
from hapticd.sweeps.work import Work
from hapticd.sweeps.worker_check import code_version

MIN_PIECE_S: Final = 1.0
"""Shortest computing time of a piece (a group of points) in s; the last pieces of a study may be shorter."""
MAX_PIECE_S: Final = 10.0
"""Longest computing time of a piece (a group of points), in s."""
MIN_PIECES_PER_THREAD: Final = 20
"""Each thread of a worker gets at least 20 pieces of a study, unless pieces would be shorter than MIN_PIECE_S."""
QUEUED_PIECES_PER_THREAD: Final = 2
"""Number of pieces that wait at a worker for each of its threads, in addition to the piece that is computed."""
WORKER_WAIT_S: Final = 30.0
"""Time in s after which a study ends if the scheduler has no workers."""
WORKER_POLL_S: Final = 1.0
"""Interval in s at which the list of workers is read while no piece finishes."""
WORKERS_ENDED_REASON: Final = "every worker that computed this point ended: too little memory, or a crash"
"""Error in the row of a point that ended all its workers."""
MIN_LAST_PIECE_S: Final = 0.1
"""Shortest computing time in s of the last pieces, which are made short so that all workers finish together."""

Indices = npt.NDArray[np.int64]
"""Indices of points in the list of the study's points, (n,)."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of the run of a study, in points."""

    done: int
    total: int
    failed: int
    """Points that were computed and whose row has an error."""
    left_s: float
    """Estimated remaining time, in s."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a run of a study."""

    points: int
    reused: int
    """Points that were not computed because the folder of results had their rows."""
    computed: int
    failed: int
    """Computed points whose row has an error."""
    seconds: float
    """Elapsed time, in s."""
    worker_seconds: float
    """Sum of the times that workers spent on points, in s."""


def run(
    work: Work,
    store: Store,
    opened: Callable[[], AbstractContextManager[Any]],
    note: Callable[[str], None],
    report: Callable[[Progress], None],
    again: bool = False,
) -> Outcome:
    """Compute the points of a study whose rows are not in the folder of results.

    Args:
        work: The study.
        store: The folder of results.
        opened: Returns a context manager for a `distributed.Client`. It is called only if there are points to compute.
        note: Is called with a line of text for each fault that does not end the study.
        report: Is called with the progress after each piece.
        again: Compute points again whose rows have an error.

    Raises HapticdError if no worker can be used, or if results cannot be written.
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
            engine.compute_all()
    return Outcome(*counts, engine.done, engine.failed, perf_counter() - begin, engine.spent_s)


@dataclass(frozen=True, slots=True)
class _SubmittedPiece:
    """A piece (a group of points) that a worker computes, or that waits at the scheduler or a worker."""

    part: Indices
    workers: frozenset[str] | None
    """Addresses of the workers that may compute the piece; None allows all."""


@dataclass
class _Engine:
    """One run of a study: the points without a row, the submitted pieces (groups of points), and the workers."""

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
    """Number of threads of all usable workers."""
    taken: int = 0
    """Number of missing points that were put into pieces."""
    to_retry: deque[Indices] = field(default_factory=deque)
    """Pieces that have to be computed again."""
    suspects: deque[Indices] = field(default_factory=deque)
    """Points whose worker ended, perhaps because of other points. At the end each is computed in a separate piece."""
    trying_suspect: bool = False
    submitted: dict[Any, _SubmittedPiece] = field(default_factory=dict)
    """Submitted pieces by their futures."""
    finished: SimpleQueue[Any] = field(default_factory=SimpleQueue)
    """Futures that are done, and None for an interrupt."""
    interrupted: int | None = None
    """Number of the signal that arrived, SIGINT or SIGTERM; None if none did."""
    refused: set[str] = field(default_factory=set)
    """Addresses of the workers that get no pieces."""
    unwritten: list[Row] = field(default_factory=list)
    """Computed rows that are not written yet."""
    write_failed: bool = False

    def __post_init__(self) -> None:
        self.columns: tuple[Column, ...] = self.work.columns
        self.version = code_version()

    # ---- Workers -----------------------------------------------------------------------------------------------------

    def usable_workers(self) -> list[str]:
        """Return the addresses of the workers that may be used, and set `threads` to the number of their threads.

        Waits up to WORKER_WAIT_S for a worker. Raises HapticdError if no worker can be used.
        """
        known = self._threads_of_workers()
        deadline = monotonic() + WORKER_WAIT_S
        while not known and monotonic() < deadline:
            with suppress(OSError):  # OSError includes TimeoutError; ended local workers are started again
                self.client.wait_for_workers(1, timeout=WORKER_POLL_S)
            self.end_if_interrupted()
            known = self._threads_of_workers()
        usable = {each: threads for each, threads in known.items() if each not in self.refused}
        if not usable:
            why = "none of its workers runs this version of hapticd" if known else "it has no workers"
            raise HapticdError(f"{self.client.scheduler.address}: the scheduler cannot be used: {why}")
        self.threads = sum(usable.values())
        return list(usable)

    def _threads_of_workers(self) -> dict[str, int]:
        """Return the number of threads of each worker by address. Raises HapticdError if the scheduler has ended."""
        try:
            found: dict[str, int] = self.client.nthreads()
        except (OSError, TimeoutError) as error:
            gone = f"{self.client.scheduler.address}: the scheduler is gone: {collapse_whitespace(str(error))}"
            raise HapticdError(f"{gone}; results are kept: run the same command again to continue") from None
        return found

    def check_versions(self) -> None:
        """Exclude workers with another code version of hapticd. Workers that join later are checked in their tasks."""
        for address, answer in self.client.run(code_version, on_error="return").items():
            if isinstance(answer, OSError):
                continue  # the worker has ended
            if isinstance(answer, Exception):
                # Dask replaces an exception that cannot be pickled by a bare Exception with its text.
                kind = "" if type(answer) is Exception else f"{type(answer).__name__}: "
                self.refuse(address, collapse_whitespace(f"{kind}{answer}"))
            elif answer != self.version:
                self.refuse(address, f"it runs hapticd {answer}, this study needs {self.version}")

    def refuse(self, address: str, why: str) -> None:
        """Exclude the worker at `address` from further points, and report the reason `why` once."""
        if address not in self.refused:
            self.refused.add(address)
            self.note(f"worker {address} is not used: {why}")

    # ---- Pieces ------------------------------------------------------------------------------------------------------

    def next_piece_size(self, threads: int) -> int:
        """Return the number of points of the next task, estimated from the mean computing time of a point."""
        if not self.done:
            return 1
        each_s = max(self.spent_s / self.done, 1e-7)
        left_s = (len(self.missing) - self.taken) * each_s
        wanted_s = min(max(len(self.missing) * each_s / (MIN_PIECES_PER_THREAD * threads), MIN_PIECE_S), MAX_PIECE_S)
        return max(1, round(min(wanted_s, max(left_s / (2 * threads), MIN_LAST_PIECE_S)) / each_s))

    def next_piece(self, threads: int) -> Indices | None:
        """Return the next piece (the points of the next task), or None if all points are in pieces."""
        if self.to_retry:
            return self.to_retry.popleft()
        if self.taken == len(self.missing):
            return None
        part = self.missing[self.taken : self.taken + self.next_piece_size(threads)]
        self.taken += len(part)
        return part

    def submit(self) -> None:
        """Submit pieces (groups of points) until each thread of the workers has 1 + QUEUED_PIECES_PER_THREAD."""
        self.end_if_interrupted()
        workers = frozenset(self.usable_workers())
        self.cancel_stranded(workers)
        # Before the first result the time of a point is unknown, and no pieces are queued.
        max_submitted = self.threads * (1 + (QUEUED_PIECES_PER_THREAD if self.done else 0))
        while len(self.submitted) < max_submitted and not self.trying_suspect:
            part = self.next_piece(self.threads)
            if part is None and self.suspects and not self.submitted:
                part, self.trying_suspect = self.suspects.popleft(), True
            if part is None:
                return
            future = self.client.submit(
                task,
                pickled(self.work.piece(part)),
                self.version,
                pure=False,
                workers=sorted(workers) if self.refused else None,
                allow_other_workers=False,
            )
            self.submitted[future] = _SubmittedPiece(part, workers if self.refused else None)
            future.add_done_callback(self.finished.put)

    def cancel_stranded(self, workers: frozenset[str]) -> None:
        """Cancel tasks whose allowed workers have all left; dask would keep these tasks until such a worker returns."""
        for future, piece in list(self.submitted.items()):
            if piece.workers is not None and not piece.workers & workers:
                self.client.cancel([future], force=True)
                del self.submitted[future]
                self.retry_or_fail(piece.part, WORKERS_ENDED_REASON)

    def compute_all(self) -> None:
        """Compute all points without a row on the workers, and store the rows.

        Raises HapticdError. After SIGINT or SIGTERM this stores the finished rows, then calls `raise_interrupt`.
        """
        try:
            with noted_interrupts(self.interrupt):
                self.check_versions()
                self.submit()
                while self.submitted:
                    # If no piece finishes, submit checks that there still is a worker.
                    with suppress(Empty):
                        self.handle_finished(self.finished.get(timeout=WORKER_POLL_S))
                    self.submit()
        except BaseException:
            with suppress(OSError):  # the scheduler may be gone
                self.client.cancel(list(self.submitted), force=True)
            try:
                self.write_unwritten()
            except HapticdError as error:
                self.note(str(error))
            raise
        self.write_unwritten()

    def interrupt(self, number: int) -> None:
        """Wake `compute_all`, which then ends the study. The signal handler calls this method."""
        self.interrupted = number
        self.finished.put(None)

    def end_if_interrupted(self) -> None:
        """Raise KeyboardInterrupt if SIGINT has arrived, or SystemExit if SIGTERM has."""
        if self.interrupted is not None:
            raise_interrupt(self.interrupted)

    def write_unwritten(self) -> None:
        """Write the computed rows that could not be written before. Raises HapticdError if writing fails again."""
        if not self.unwritten:
            return
        try:
            self.store.write(self.unwritten, self.columns)
        except HapticdError as error:
            lost = wording.count(len(self.unwritten), "row")
            raise HapticdError(f"{error}; {lost} of results are lost: run the same command to compute them") from None

    def handle_finished(self, future: Any) -> None:
        """Store the rows of the piece (group of points) that `future` has computed, or submit its points again.

        If a worker ends before its rows arrive, dask computes its pieces again.
        """
        from distributed import CancelledError, KilledWorker

        if future not in self.submitted:
            return  # it was cancelled, or it is the None of an interrupt
        part = self.submitted[future].part
        try:
            found = future.result(timeout=WORKER_WAIT_S)
        except CancelledError:
            self.to_retry.append(part)
        except Exception as error:
            if isinstance(error, TimeoutError) and future.status != "error":
                future.add_done_callback(self.finished.put)
                return
            killed = isinstance(error, KilledWorker)
            self.retry_or_fail(part, WORKERS_ENDED_REASON if killed else f"{type(error).__name__}: {error}")
        else:
            if isinstance(found[0], str):
                refusal: Refusal = found
                self.refuse(*refusal)
                self.to_retry.append(part)
            else:
                rows, seconds = found
                self.spent_s += seconds
                self.store_rows(rows)
        del self.submitted[future]
        self.trying_suspect = False

    def retry_or_fail(self, part: Indices, why: str) -> None:
        """Divide points whose task failed into up to eight tasks; for a single point, store the error `why`.

        A single point whose workers ended is first added to `suspects`, and computed once more at the end.
        """
        if len(part) > 1:
            self.to_retry.extend(np.array_split(part, min(len(part), 8)))
        elif why == WORKERS_ENDED_REASON and not self.trying_suspect:
            self.suspects.append(part)
        else:
            self.trying_suspect = False
            self.store_rows([self.error_row(part[0], why)])

    def error_row(self, index: np.int64, why: str) -> Row:
        """Return the row of a point that has no result; `why` is its error."""
        row: Row = dict.fromkeys(column.name for column in self.columns)
        row[POINT_COLUMN.name] = self.work.ids[index].tobytes().hex()
        row[ERROR_COLUMN.name] = collapse_whitespace(why)
        return row

    def store_rows(self, rows: list[Row]) -> None:
        """Write the rows of one task; if writing fails, keep the rows and write them with those of the next task."""
        self.done += len(rows)
        self.failed += sum(row[ERROR_COLUMN.name] is not None for row in rows)
        self.unwritten += rows
        try:
            self.store.write(self.unwritten, self.columns)
            self.unwritten = []
            self.write_failed = False
        except HapticdError as error:
            if not self.write_failed:
                self.note(f"{error}; results are kept in memory and written with the next ones")
            self.write_failed = True
        left = len(self.missing) - self.done
        self.report(Progress(self.done, len(self.missing), self.failed, left * self.spent_s / self.done / self.threads))
