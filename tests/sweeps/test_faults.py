"""A fault during a study is one line, or the row of its point, and the other points are computed."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import distributed.system
import pytest

from hapticd.base.errors import HapticdError
from hapticd.sweeps import engine
from hapticd.sweeps.cluster import client_of
from hapticd.sweeps.engine import Progress, run
from hapticd.sweeps.store import Store
from tests.soak.interrupt_sweeps import command, ended, study, wrong
from tests.support.daemon_process import PATIENCE_S
from tests.support.special_files import KINDS, special, untouched
from tests.sweeps.external import OTHER_VERSION, WITHOUT_HAPTICD, WORKER, connected, scheduler
from tests.sweeps.test_engine import ran, threads
from tests.sweeps.works import BAD, Fault, Roots

pytestmark = pytest.mark.slow


def ran_command(
    words: list[str], environment: dict[str, str] | None = None, **started: Any
) -> tuple[int, list[str], str]:
    """Return exit code, stderr (lines without dashboard and progress) and stdout of a command."""
    done = subprocess.run(
        words, capture_output=True, text=True, env={**os.environ, **(environment or {})}, timeout=PATIENCE_S, **started
    )
    said = [line for line in done.stderr.splitlines() if "dashboard: " not in line and " left" not in line]
    return done.returncode, said, done.stdout


# ---- Workers ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_worker_without_hapticd_is_refused_in_one_line(tmp_path: Path) -> None:
    with scheduler(WORKER, WITHOUT_HAPTICD) as running, connected(running.address, 2) as client:
        outcome, _, notes, _ = ran(Roots(100), tmp_path, nullcontext(client))
    assert (outcome.computed, outcome.failed) == (100, 0)
    assert len(notes) == 1 and "is not used: " in notes[0] and "No module named 'hapticd'" in notes[0]


@pytest.mark.slow
@pytest.mark.parametrize(("program", "why"), [(WITHOUT_HAPTICD, "No module named 'hapticd'"), (OTHER_VERSION, "9.9.9")])
def test_a_worker_that_joins_during_the_study_is_refused_too(program: list[str], why: str, tmp_path: Path) -> None:
    notes: list[str] = []
    with scheduler(WORKER) as running, connected(running.address, 1) as client:

        def report(progress: Progress) -> None:
            if len(running.workers) == 1:
                running.add(program)
                client.wait_for_workers(2, timeout=PATIENCE_S)

        store = Store(tmp_path, notes.append)
        outcome = run(Roots(400, busy_s=0.01), store, lambda: nullcontext(client), notes.append, report)
        assert len(client.nthreads()) == 2  # the task that it could not load has not ended it
    assert (outcome.computed, outcome.failed) == (400, 0)
    assert len(notes) == 1 and "is not used: " in notes[0] and why in notes[0]


@pytest.mark.slow
def test_pieces_of_the_only_usable_worker_go_to_its_replacement(tmp_path: Path) -> None:
    """After a worker was refused, pieces are bound to the workers that are known at the time."""
    with scheduler(WORKER, WITHOUT_HAPTICD) as running, connected(running.address, 2) as client:

        def report(progress: Progress) -> None:
            if len(running.workers) == 2:
                running.add(WORKER)
                client.wait_for_workers(3, timeout=PATIENCE_S)
                running.workers[0].kill()

        store = Store(tmp_path, lambda text: None)
        outcome = run(Roots(200, busy_s=0.005), store, lambda: nullcontext(client), lambda text: None, report)
    assert (outcome.computed, outcome.failed) == (200, 0)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["is killed", "eats"])
def test_a_point_that_takes_all_memory_is_a_row(fault: Fault, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distributed.system, "MEMORY_LIMIT", 1_000_000_000)  # 500 MB for each of two
    outcome, store, _, _ = ran(Roots(20, fault), tmp_path, client_of(None, 2, False))
    assert (outcome.computed, outcome.failed) == (20, 1)
    (failed,) = (row for row in store.table().to_pylist() if row["error"] is not None)
    assert failed["error"] == "every worker that computed this point ended: too little memory, or a crash"


def test_a_point_that_is_refused_memory_is_a_row(tmp_path: Path) -> None:
    outcome, store, _, _ = ran(Roots(40, "has no memory"), tmp_path, threads())
    assert (outcome.computed, outcome.failed) == (40, 1)
    assert [row["error"] for row in store.table().to_pylist() if row["n"] is None or row["n"] == BAD] == [
        "MemoryError: Unable to allocate 8.00 TiB"
    ]


# ---- The scheduler ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_killed_scheduler_is_reported_and_finished_rows_are_kept(tmp_path: Path) -> None:
    store = Store(tmp_path, lambda text: None)
    with scheduler(WORKER) as running, connected(running.address, 1) as client:

        def report(progress: Progress) -> None:
            running.process.kill()

        with pytest.raises(HapticdError, match=r"^tcp://127.0.0.1:\d+: the scheduler is gone: "):
            run(Roots(400, busy_s=0.002), store, lambda: nullcontext(client), lambda text: None, report)
    assert 0 < store.table().num_rows < 400


@pytest.mark.slow
@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("tcp://127.0.0.1:9", "tcp://127.0.0.1:9: no scheduler answers within 10 s: "),
        ("cluster", "cluster: cannot be used: missing port number in address 'cluster'"),
        ("tls://127.0.0.1:9", "tls://127.0.0.1:9: cannot be used: TLS expects a `ssl_context` argument"),
    ],
)
def test_the_command_reports_an_unreachable_scheduler_in_one_line(address: str, why: str, tmp_path: Path) -> None:
    code, said, _ = ran_command(command(study(tmp_path, 5), tmp_path / "r", "--scheduler", address))
    assert code == 1 and len(said) == 1 and said[0].startswith(f"hapticd: {why}"), said


@pytest.mark.slow
def test_a_worker_is_refused_as_scheduler(tmp_path: Path) -> None:
    with (
        scheduler(WORKER) as running,
        connected(running.address, 1) as client,
        pytest.raises(HapticdError, match=r": not a dask scheduler, but a worker$"),
        client_of(next(iter(client.nthreads())), None, False),
    ):
        pass


# ---- TLS -------------------------------------------------------------------------------------------------------------


def certificates(folder: Path, name: str) -> dict[str, str]:
    """Return settings of dask with a new self-signed certificate, which all parts of the cluster use."""
    cert, key = folder / f"{name}.pem", folder / f"{name}.key"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
         "-days", "2", "-subj", "/CN=sweeps", "-keyout", str(key), "-out", str(cert)],
        check=True, capture_output=True,
    )  # fmt: skip
    settings = {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": str(cert)}
    for part in ("SCHEDULER", "WORKER", "CLIENT"):
        settings[f"DASK_DISTRIBUTED__COMM__TLS__{part}__CERT"] = str(cert)
        settings[f"DASK_DISTRIBUTED__COMM__TLS__{part}__KEY"] = str(key)
    return settings


@pytest.mark.slow
def test_tls_follows_the_configuration_of_dask(tmp_path: Path) -> None:
    file = study(tmp_path, 20)
    _, _, out = ran_command(command(file, tmp_path / "here", "--threads", "--json"))
    ours, others = certificates(tmp_path, "ours"), certificates(tmp_path, "others")
    with scheduler(WORKER, protocol="tls", settings=ours) as running:
        over = ("--scheduler", running.address, "--json")
        code, said, over_tls = ran_command(command(file, tmp_path / "tls", *over), ours)
        assert code == 0 and said == []
        assert json.loads(over_tls)["sha256"] == json.loads(out)["sha256"]
        code, said, _ = ran_command(command(file, tmp_path / "others", *over[:2]), others)
        assert code == 1 and len(said) == 1 and "no scheduler answers within 10 s: " in said[0]
        plain = running.address.replace("tls://", "tcp://")
        code, said, _ = ran_command(command(file, tmp_path / "plain", "--scheduler", plain), ours)
        assert code == 1 and len(said) == 1 and "no scheduler answers within 10 s" in said[0]


# ---- The folder ------------------------------------------------------------------------------------------------------


def test_a_folder_that_another_process_writes_into_is_refused(tmp_path: Path) -> None:
    def opened() -> Any:
        code, said, _ = ran_command(command(study(tmp_path, 5), tmp_path / "r", "--threads"))
        assert code == 1
        message = "another process writes results into it; wait for its end, or give another folder"
        assert said == [f"hapticd: {tmp_path / 'r'}: {message}"]
        return threads()

    store = Store(tmp_path / "r", lambda text: None)
    assert run(Roots(10), store, opened, lambda text: None, lambda progress: None).computed == 10


def test_half_written_pieces_of_a_killed_process_are_removed(tmp_path: Path) -> None:
    ran(Roots(10), tmp_path, threads())
    part = tmp_path / "pieces" / f".{'0' * 32}.parquet.77.{'1' * 16}.part"
    part.write_bytes(b"half")
    (tmp_path / "pieces" / ".hidden.part").write_bytes(b"foreign")
    ran(Roots(10), tmp_path, threads())
    assert not part.exists() and (tmp_path / "pieces" / ".hidden.part").exists()


def test_a_read_only_folder_is_reported_in_one_line(tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)  # root may write everywhere
    try:
        with pytest.raises(HapticdError, match=r"cannot be created: Permission denied$"):
            ran(Roots(10), tmp_path / "r", threads())
    finally:
        os.seteuid(user)
        tmp_path.chmod(0o755)


@pytest.mark.slow
def test_a_full_disk_is_reported_and_sets_the_exit_code(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    with subprocess.Popen(
        command(study(tmp_path, 400), folder, "--threads"), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        deadline = monotonic() + PATIENCE_S
        while not (folder / "study.json").exists() and monotonic() < deadline:
            sleep(0.01)
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
        assert process.stderr is not None
        said = [line for line in process.stderr.read().splitlines() if " left" not in line]
    assert process.returncode == 1 and len(said) == 2, said
    assert said[0].endswith(
        "cannot be written: File too large; results are kept in memory and written with the next ones"
    )
    assert said[1].endswith("rows of results are lost: run the same command to compute them")


def test_rows_that_cannot_be_written_at_the_end_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(self: Store, rows: Any, columns: Any) -> None:
        raise HapticdError("pieces: cannot be written: No space left on device")

    monkeypatch.setattr(Store, "write", write)
    with pytest.raises(
        HapticdError, match="No space left on device; 20 rows of results are lost: run the same command"
    ):
        ran(Roots(20), tmp_path, threads())
    notes: list[str] = []

    def report(progress: Progress) -> None:
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run(Roots(400), Store(tmp_path, notes.append), threads, notes.append, report)
    assert len(notes) == 2 and "results are kept in memory" in notes[0] and "results are lost" in notes[1]


def piece_of(folder: Path) -> Path:
    """Return the path of the largest piece."""
    return max((folder / "pieces").glob("*.parquet"), key=lambda file: file.stat().st_size)


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (lambda content: content[:100], "not a piece of a sweep, or damaged; its points are computed again"),
        (lambda content: b"", "not a piece of a sweep, or damaged; its points are computed again"),
        (lambda content: content[:300] + bytes(50) + content[350:], None),
    ],
)
def test_a_damaged_piece_is_reported_and_computed_again(
    damage: Callable[[bytes], bytes], why: str | None, tmp_path: Path
) -> None:
    _, store, _, _ = ran(Roots(40), tmp_path, threads())
    before, piece = store.digest(), piece_of(tmp_path)
    piece.write_bytes(damage(piece.read_bytes()))
    outcome, store, notes, _ = ran(Roots(40), tmp_path, threads())
    assert len(notes) == 1 and notes[0].startswith(f"{piece}: ") and (why is None or notes[0].endswith(why))
    assert outcome.computed > 0 and store.digest() == before


def test_a_foreign_parquet_file_is_left_out(tmp_path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    _, store, _, _ = ran(Roots(10), tmp_path, threads())
    before = store.digest()
    parquet.write_table(pyarrow.table({"a": [1]}), tmp_path / "pieces" / "a.parquet")
    ids = pyarrow.table({"point": ["no identity"], "n": [1], "root": [1.0], "error": pyarrow.array([None], "string")})
    parquet.write_table(ids, tmp_path / "pieces" / "b.parquet")
    # A piece with other columns, as of another study in this folder.
    parquet.write_table(ids.drop_columns(["root"]), tmp_path / "pieces" / "c.parquet")
    outcome, store, notes, _ = ran(Roots(10), tmp_path, threads())
    assert (outcome.computed, store.digest()) == (0, before)
    assert [Path(each.partition(": ")[0]).name for each in notes[:2]] == ["a.parquet", "b.parquet"]


# ---- Interrupts ------------------------------------------------------------------------------------------------------


def test_an_interrupt_is_handled_once_a_piece_is_written(tmp_path: Path) -> None:
    store = Store(tmp_path, lambda text: None)
    seen: list[int] = []

    def report(progress: Progress) -> None:
        signal.raise_signal(signal.SIGTERM)
        seen.append(progress.done)

    with pytest.raises(SystemExit) as ending:
        run(Roots(400), store, threads, lambda text: None, report)
    assert ending.value.code == 143 and store.table().num_rows == seen[-1] < 400
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_an_ignored_signal_stays_ignored(tmp_path: Path) -> None:
    """A script that starts a command in the background makes it ignore SIGINT."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        outcome, _, _, _ = ran(Roots(20), tmp_path, threads())
        run(
            Roots(30), Store(tmp_path, print), threads, print,
            lambda progress: signal.raise_signal(signal.SIGINT),
        )  # fmt: skip
        assert outcome.computed == 20 and Store(tmp_path, print).table().num_rows == 30
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("after_s", [1.0, 3.0])
def test_a_command_that_is_ended_leaves_no_process_and_no_traceback(
    number: signal.Signals, after_s: float, tmp_path: Path
) -> None:
    assert wrong(ended(command(study(tmp_path, 2000), tmp_path / "r"), number, after_s), number) is None


def test_without_a_worker_the_study_ends_with_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "WORKER_WAIT_S", 0.2)
    with (
        scheduler() as running,
        client_of(running.address, None, False) as client,
        pytest.raises(HapticdError, match="cannot be used: it has no workers"),
    ):
        ran(Roots(10), tmp_path, nullcontext(client))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["lock", "points.npy", "study.json"])
def test_a_folder_of_results_needs_regular_files(name: str, kind: str, tmp_path: Path) -> None:
    message = special(tmp_path / name, kind)
    others = {"lock": ["pieces"], "points.npy": ["pieces", "lock"], "study.json": ["pieces", "lock", "points.npy"]}
    with untouched(tmp_path, *others[name]), pytest.raises(HapticdError) as caught:
        ran(Roots(1), tmp_path, threads())
    assert str(caught.value) == message
