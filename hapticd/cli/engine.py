"""What commands share that compute many pieces on dask: where, how far it is, and what came of it."""

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
from hapticd.cli.common import doing, note, options

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
    return options(
        click.option(
            "--workers", type=click.IntRange(1, 1024), help="How many processes [default: as many as processors]."
        ),
        click.option(
            "--threads", is_flag=True, help="Threads of this process instead of processes; no port is opened."
        ),
        click.option(
            "--scheduler", metavar="ADDRESS", help="A dask scheduler that runs: tcp://HOST:PORT, tls://HOST:PORT."
        ),
        click.option("--again", is_flag=True, help=f"Compute {what} anew whose row has an error."),
    )


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
    told = asdict(outcome)
    for name in ("seconds", "worker_seconds"):
        told[name] = round(told[name], 3)
    return {"folder": str(folder), what: told.pop("points"), **told, "sha256": digest}


def outcome_text(outcome: Outcome, what: str) -> str:
    """One line; `what` is one of what is computed: point."""
    return (
        f"{wording.count(outcome.points, what)}: {outcome.computed} computed in {outcome.seconds:.1f} s "
        f"({outcome.worker_seconds:.1f} s of workers), {outcome.reused} were there, {outcome.failed} failed"
    )


@contextmanager
def _progress(what: str) -> Iterator[Callable[[Progress], None]]:
    """How far it is, in one line on a terminal, else in a line every ten seconds."""
    last = monotonic()

    def report(at: Progress) -> None:
        nonlocal last
        left = "" if at.left_s is None else f", {wording.duration(at.left_s)} left"
        failed = f", {at.failed} failed" if at.failed else ""
        line = f"{at.done} of {wording.count(at.total, what)}{left}{failed}"
        show(line)
        if not sys.stderr.isatty() and monotonic() - last >= _EVERY_S:
            last = monotonic()
            note(line)

    with doing() as show:
        yield report
