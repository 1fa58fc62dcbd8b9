"""Threads, processes and external workers compute the same rows, even if workers end."""

from __future__ import annotations

import os
import random
import re
import signal
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticd.base.errors import HapticdError
from hapticd.sweeps import engine
from hapticd.sweeps.cluster import client_of
from hapticd.sweeps.engine import Outcome, Progress, run
from hapticd.sweeps.store import Store
from tests.sweeps.external import OTHER_VERSION, WORKER, connected, scheduler
from tests.sweeps.works import BAD, Roots, id_of

pytestmark = pytest.mark.slow


def ran(
    work: Roots, folder: Path, opened: AbstractContextManager[Any], again: bool = False
) -> tuple[Outcome, Store, list[str], list[Progress]]:
    notes: list[str] = []
    seen: list[Progress] = []
    store = Store(folder, notes.append)
    outcome = run(work, store, lambda: opened, notes.append, seen.append, again)
    return outcome, store, notes, seen


def threads() -> AbstractContextManager[Any]:
    return client_of(None, 2, threads=True)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> str:
    _, store, _, _ = ran(Roots(400), tmp_path_factory.mktemp("one"), threads())
    return store.digest()


def test_rows_are_those_of_the_points_and_progress_ends_at_all(tmp_path: Path) -> None:
    outcome, store, notes, seen = ran(Roots(50), tmp_path, threads())
    assert (outcome.points, outcome.computed, outcome.reused, outcome.failed) == (50, 50, 0, 0)
    assert notes == [] and (seen[-1].done, seen[-1].total) == (50, 50)
    rows = store.table().to_pylist()
    assert [row["point"] for row in rows] == sorted(id_of(n).hex() for n in range(50))
    assert all(row["root"] == pytest.approx(row["n"] ** 0.5, rel=1e-15) for row in rows)
    field = store.table().schema.field("root")
    assert (field.metadata[b"unit"], field.metadata[b"description"]) == (b"m", b"Root of n.")


def listeners() -> dict[str, str]:
    """Return the addresses of listening sockets by inode, in the form of /proc (127.0.0.1 is 0100007F)."""
    rows = [
        line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/self/net/{name}").read_text().splitlines()[1:]
    ]
    return {row[9]: row[1].partition(":")[0] for row in rows if row[3] == "0A"}


def of_process(pid: int | str) -> set[str]:
    """Return the inodes of the sockets of a process."""
    found = set()
    for each in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):
            found |= set(re.findall(r"socket:\[(\d+)\]", os.readlink(each)))
    return found


def test_threads_open_no_port() -> None:
    before = of_process("self")
    with threads() as client:
        assert not listeners().keys() & (of_process("self") - before)
        assert client.scheduler.address.startswith("inproc://")


@pytest.mark.slow
def test_processes_listen_only_on_this_machine() -> None:
    before = of_process("self")
    with client_of(None, 2, False) as client:
        pids = client.run(os.getpid).values()
        opened = (of_process("self") - before).union(*map(of_process, pids))
        addresses = {address for inode, address in listeners().items() if inode in opened}
        assert addresses == {"0100007F"}


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_processes_give_the_same_bits(workers: int, tmp_path: Path, expected: str) -> None:
    _, store, notes, _ = ran(Roots(400), tmp_path, client_of(None, workers, False))
    assert store.digest() == expected and notes == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_killed_worker_changes_nothing(seed: int, tmp_path: Path, expected: str) -> None:
    killed: list[int] = []
    with scheduler(WORKER, WORKER) as running, connected(running.address, 2) as client:
        notes: list[str] = []
        store = Store(tmp_path, notes.append)

        moment = random.Random(seed).randrange(350)

        def report(progress: Progress) -> None:
            if not killed and progress.done > moment:
                running.workers[0].send_signal(signal.SIGKILL)
                killed.append(progress.done)

        work = Roots(400, busy_s=0.002)
        outcome = run(work, store, lambda: nullcontext(client), notes.append, report)
    assert killed and outcome.computed == 400, moment
    assert store.digest() == expected


@pytest.mark.slow
def test_a_worker_of_another_version_is_refused_in_one_line(tmp_path: Path, expected: str) -> None:
    with scheduler(WORKER, OTHER_VERSION) as running, connected(running.address, 2) as client:
        outcome, store, notes, _ = ran(Roots(400), tmp_path, nullcontext(client))
    assert outcome.computed == 400 and store.digest() == expected
    assert len(notes) == 1 and "is not used: it runs hapticd 9.9.9 (other), this study needs 0." in notes[0]


@pytest.mark.slow
def test_without_a_usable_worker_the_study_ends_with_the_reason(tmp_path: Path) -> None:
    with (
        scheduler(OTHER_VERSION) as running,
        connected(running.address, 1) as client,
        pytest.raises(HapticdError, match="cannot be used: none of its workers runs this version of hapticd"),
    ):
        ran(Roots(10), tmp_path, nullcontext(client))


@pytest.mark.slow
def test_when_the_last_worker_ends_finished_rows_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "WORKER_WAIT_S", 1.0)
    store = Store(tmp_path, lambda text: None)
    with scheduler(WORKER) as running, connected(running.address, 1) as client:
        work = Roots(400, busy_s=0.002)
        with pytest.raises(HapticdError, match="cannot be used: it has no workers"):
            run(work, store, lambda: nullcontext(client), lambda text: None, lambda progress: running.workers[0].kill())
    assert 0 < store.table().num_rows < 400


@pytest.mark.slow
def test_a_point_that_ends_its_worker_is_a_row_with_its_reason(tmp_path: Path) -> None:
    outcome, store, _, _ = ran(Roots(40, "exits"), tmp_path, client_of(None, 2, False))
    assert (outcome.computed, outcome.failed) == (40, 1)
    rows = {row["n"]: row for row in store.table().to_pylist()}
    assert rows.pop(None)["error"].startswith("every worker that computed this point ended")
    assert set(rows) == set(range(40)) - {BAD} and all(row["error"] is None for row in rows.values())


def test_a_point_with_an_unexpected_exception_is_a_row(tmp_path: Path) -> None:
    outcome, store, _, _ = ran(Roots(40, "raises"), tmp_path, threads())
    assert (outcome.computed, outcome.failed) == (40, 1)
    (failed,) = (row for row in store.table().to_pylist() if row["error"] is not None)
    assert failed["point"] == id_of(BAD).hex() and failed["error"].startswith("LookupError: ")
    assert "\n" not in failed["error"]


def test_existing_rows_are_not_computed_again(tmp_path: Path) -> None:
    log = tmp_path / "log"
    ran(Roots(30), tmp_path / "r", threads())
    outcome, _, _, _ = ran(Roots(50, log=str(log)), tmp_path / "r", threads())
    assert (outcome.reused, outcome.computed) == (30, 20)
    assert sorted(int(each) for each in log.read_text().split()) == list(range(30, 50))

    def opened() -> AbstractContextManager[Any]:
        raise AssertionError("no point must be computed")

    store = Store(tmp_path / "r", lambda text: None)
    assert run(Roots(50), store, opened, lambda text: None, lambda progress: None).reused == 50


def test_again_computes_failed_points(tmp_path: Path) -> None:
    ran(Roots(40, "raises"), tmp_path, threads())
    outcome, _, _, _ = ran(Roots(40), tmp_path, threads())
    assert outcome.computed == 0
    outcome, store, _, _ = ran(Roots(40), tmp_path, threads(), again=True)
    assert outcome.computed == 1 and all(row["error"] is None for row in store.table().to_pylist())


def test_a_damaged_piece_is_reported_and_computed_again(tmp_path: Path) -> None:
    _, store, _, _ = ran(Roots(40), tmp_path, threads())
    before = store.digest()
    piece = max((tmp_path / "pieces").iterdir(), key=lambda file: file.stat().st_size)
    piece.write_bytes(piece.read_bytes()[:100])
    outcome, store, notes, _ = ran(Roots(40), tmp_path, threads())
    assert notes == [f"{piece}: not a piece of a sweep, or damaged; its points are computed again"]
    assert outcome.computed > 0 and store.digest() == before


def test_results_wait_while_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written, refused = Store.write, 2

    def write(self: Store, rows: Any, columns: Any) -> None:
        nonlocal refused
        if refused:
            refused -= 1
            raise HapticdError("pieces: cannot be written: No space left on device")
        written(self, rows, columns)

    monkeypatch.setattr(Store, "write", write)
    outcome, store, notes, _ = ran(Roots(60), tmp_path, threads())
    assert outcome.computed == 60 and store.table().num_rows == 60
    assert len(notes) == 1 and notes[0].endswith("results are kept in memory and written with the next ones")


def test_if_the_disk_stays_full_the_study_ends_with_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(self: Store, rows: Any, columns: Any) -> None:
        raise HapticdError("pieces: cannot be written: No space left on device")

    monkeypatch.setattr(Store, "write", write)
    with pytest.raises(HapticdError, match="No space left on device"):
        ran(Roots(20), tmp_path, threads())


def test_an_interrupt_keeps_finished_rows(tmp_path: Path) -> None:
    store = Store(tmp_path, lambda text: None)

    def report(progress: Progress) -> None:
        if progress.done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(Roots(400), store, threads, lambda text: None, report)
    kept = store.table().num_rows
    assert 0 < kept < 400
    outcome, store, _, _ = ran(Roots(400), tmp_path, threads())
    assert outcome.reused == kept and store.table().num_rows == 400


def test_an_unreachable_scheduler_is_reported_in_one_line() -> None:
    message = r"^tcp://127.0.0.1:9: no scheduler answers within 10 s(: .+)?$"
    with pytest.raises(HapticdError, match=message), client_of("tcp://127.0.0.1:9", None, False):
        pass


def test_pieces_grow_to_seconds_and_shrink_at_the_end(tmp_path: Path) -> None:
    work = Roots(3000)
    made = engine._Engine(work, Store(tmp_path, print), None, print, lambda progress: None, np.arange(3000))
    assert made.next_piece_size(2) == 1
    made.done, made.spent_s, made.taken = 100, 10.0, 100  # 0.1 s a point, 300 s in all
    assert 1.0 <= 0.1 * made.next_piece_size(2) <= 10.0
    made.taken = 2990
    assert made.next_piece_size(2) <= 3
