"""What commands share that compute many pieces on dask: where, how far it is, and what came of it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click

from hapticd.base import wording
from hapticd.cli.common import note

if TYPE_CHECKING:
    from hapticd.sweeps.engine import Outcome, Progress
    from hapticd.sweeps.store import Store
    from hapticd.sweeps.work import Work

_F = TypeVar("_F", bound=Callable[..., Any])
_EVERY_S: Final = 10.0
"""Between two lines of progress where no terminal is."""


@dataclass(frozen=True, slots=True)
class Where:
    """Where it is computed, as the options say."""

    workers: int | None
    threads: bool
    scheduler: str | None
    again: bool


def engine_options(what: str) -> Callable[[_F], _F]:
    """`--workers`, `--threads`, `--scheduler` and `--again`; `what` is computed: points."""

    def decorated(command: _F) -> _F:
        for option in (
            click.option("--again", is_flag=True, help=f"Compute {what} anew whose row has an error."),
            click.option(
                "--scheduler", metavar="ADDRESS", help="A dask scheduler that runs: tcp://HOST:PORT, tls://HOST:PORT."
            ),
            click.option(
                "--threads", is_flag=True, help="Threads of this process instead of processes; no port is opened."
            ),
            click.option(
                "--workers", type=click.IntRange(1, 1024), help="How many processes [default: as many as processors]."
            ),
        ):
            command = option(command)
        return command

    return decorated


def require_engine(where: Where) -> None:
    """Raises click.UsageError for options that exclude one another, HapticdError where the extra is missing."""
    from hapticd.sweeps.cluster import require_dask
    from hapticd.sweeps.store import require_pyarrow

    if where.scheduler is not None and (where.workers is not None or where.threads):
        raise click.UsageError("--scheduler has its own workers: leave out --workers and --threads")
    require_dask()
    require_pyarrow()


def computed(work: Work, folder: Path, where: Where, what: str) -> tuple[Outcome, Store]:
    """Computes what the folder does not hold, with progress on stderr; `what` is one of it: point."""
    from hapticd.sweeps import engine
    from hapticd.sweeps.cluster import client_of
    from hapticd.sweeps.interrupts import sigterm_ends
    from hapticd.sweeps.store import Store

    store = Store(folder, note)

    @contextmanager
    def opened() -> Iterator[Any]:
        with client_of(where.scheduler, where.workers, where.threads) as client:
            if client.dashboard_link and not where.threads:
                note(f"dashboard: {client.dashboard_link}")
            yield client

    try:
        with sigterm_ends(), _progress(what) as report:
            return engine.run(work, store, opened, note, report, where.again), store
    except (KeyboardInterrupt, SystemExit):
        note(f"interrupted; what is done is in {folder}: the same command goes on")
        raise


def outcome_dict(outcome: Outcome, folder: Path, digest: str, what: str) -> dict[str, object]:
    """What --json says of it; `what` is computed: points."""
    return {
        "folder": str(folder),
        what: outcome.points,
        "reused": outcome.reused,
        "computed": outcome.computed,
        "failed": outcome.failed,
        "seconds": round(outcome.seconds, 3),
        "worker_seconds": round(outcome.worker_seconds, 3),
        "sha256": digest,
    }


def outcome_text(outcome: Outcome, what: str) -> str:
    """One line; `what` is one of what is computed: point."""
    return (
        f"{wording.count(outcome.points, what)}: {outcome.computed} computed in {outcome.seconds:.1f} s "
        f"({outcome.worker_seconds:.1f} s of workers), {outcome.reused} were there, {outcome.failed} failed"
    )


@contextmanager
def _progress(what: str) -> Iterator[Callable[[Progress], None]]:
    """A bar on a terminal, a line every ten seconds elsewhere."""
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
        from rich.progress import Progress as Bar

        columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
        with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task("", total=None)
            yield lambda at: bar.update(task, total=at.total, completed=at.done, description=_left(at))
        return
    last = monotonic()

    def report(at: Progress) -> None:
        nonlocal last
        if monotonic() - last >= _EVERY_S:
            last = monotonic()
            note(f"{at.done} of {wording.count(at.total, what)}, {_left(at)}")

    yield report


def _left(at: Progress) -> str:
    failed = f", {at.failed} failed" if at.failed else ""
    return ("" if at.left_s is None else f"{wording.duration(at.left_s)} left") + failed
