"""Options, progress and result of commands that compute many points, fits or sessions on dask."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click

from hapticd.base import wording
from hapticd.cli.common import note, options, status_line

if TYPE_CHECKING:
    from hapticd.sweeps.engine import Outcome, Progress
    from hapticd.sweeps.store import Store
    from hapticd.sweeps.work import Work

_F = TypeVar("_F", bound=Callable[..., Any])
_PROGRESS_PERIOD_S: Final = 10.0
"""Time between two lines of progress if stderr is not a terminal, in s."""


@dataclass(frozen=True, slots=True)
class Where:
    """Values of the options of `engine_options`, which select where points are computed."""

    workers: int | None
    threads: bool
    scheduler: str | None
    again: bool


def engine_options(what: str) -> Callable[[_F], _F]:
    """Return the options `--workers`, `--threads`, `--scheduler`, `--again`. `what` is a word such as "points"."""
    return options(
        click.option(
            "--workers", type=click.IntRange(1, 1024), help="Number of processes [default: number of processors]."
        ),
        click.option("--threads", is_flag=True, help="Compute in threads instead of processes; no port is opened."),
        click.option(
            "--scheduler",
            metavar="ADDRESS",
            help="Address of a running dask scheduler: tcp://HOST:PORT or tls://HOST:PORT.",
        ),
        click.option("--again", is_flag=True, help=f"Compute again the {what} whose row has an error."),
    )


def require_engine(where: Where) -> None:
    """Raise click.UsageError if options in `where` exclude each other, HapticdError without the extra `cluster`."""
    from hapticd.sweeps.cluster import require_dask
    from hapticd.sweeps.store import require_pyarrow

    if where.scheduler is not None and (where.workers is not None or where.threads):
        raise click.UsageError(
            "--scheduler cannot be combined with --workers or --threads: a scheduler has separate workers"
        )
    require_dask()
    require_pyarrow()


def computed(work: Work, folder: Path, where: Where, what: str) -> tuple[Outcome, Store]:
    """Compute points without a row in `folder`, with progress on stderr. `what` is the word for a point, as "fit"."""
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
        note(f"interrupted; {folder} has the finished part: the same command continues")
        raise


def outcome_dict(outcome: Outcome, folder: Path, digest: str, what: str) -> dict[str, object]:
    """Return the outcome of a run for --json. The key `what`, such as "fits", has the number of points."""
    fields = asdict(outcome)
    for name in ("seconds", "worker_seconds"):
        fields[name] = round(fields[name], 3)
    return {"folder": str(folder), what: fields.pop("points"), **fields, "sha256": digest}


def outcome_text(outcome: Outcome, what: str) -> str:
    """Return the outcome of a run as one line of text. `what` is the word for a point, such as "fit"."""
    return (
        f"{wording.count(outcome.points, what)}: {outcome.computed} computed in {outcome.seconds:.1f} s "
        f"({outcome.worker_seconds:.1f} s of workers), {outcome.reused} already existed, {outcome.failed} failed"
    )


@contextmanager
def _progress(what: str) -> Iterator[Callable[[Progress], None]]:
    """Yield a function that shows progress: in a status line on a terminal, else as a line every ten seconds."""
    last = monotonic()

    def report(at: Progress) -> None:
        nonlocal last
        failed = f", {at.failed} failed" if at.failed else ""
        line = f"{at.done} of {wording.count(at.total, what)}, {wording.duration(at.left_s)} left{failed}"
        show(line)
        if not sys.stderr.isatty() and monotonic() - last >= _PROGRESS_PERIOD_S:
            last = monotonic()
            note(line)

    with status_line() as show:
        yield report
