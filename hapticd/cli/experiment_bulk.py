"""`hapticd experiment run --offline --count`: many simulated participants in parallel, or on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from hapticd.base import wording
from hapticd.cli.common import note
from hapticd.cli.engine import Where, computed, outcome_text, require_engine

if TYPE_CHECKING:
    from hapticd.experiment.keys import Study

SIMULATED_ROWS_FOLDER: Final = Path("sourcedata", "simulated")
"""Folder of the Parquet rows in a data set. BIDS keeps source data in `sourcedata`."""


def run_bulk(
    study: Study, source: bytes, labels: tuple[str, ...], session: int, seed: int, output: Path, where: Where
) -> int:
    """Simulate a session of each participant whose session the data set lacks, and return the exit code.

    Writes rows of Parquet into SIMULATED_ROWS_FOLDER of the data set, and the folder of each session. The exit code is
    0 if every session is complete, otherwise 1. Raises HapticdError.
    """
    require_engine(where)
    from hapticd.sweeps.participants.bulk import Participants
    from hapticd.sweeps.participants.session_folders import SessionFolders

    work, rows = Participants(study, session, seed, labels), output / SIMULATED_ROWS_FOLDER
    folders = SessionFolders(output, rows, source, work)
    outcome, store = computed(work, rows, where, "participant")
    written = folders.write(store.rows())
    click.echo(outcome_text(outcome, "participant"))
    click.echo(
        f"{output}: {wording.count(written, 'session')} written, {len(folders.present)} already existed; "
        f"rows: {rows}/pieces/*.parquet, sha256 {store.digest()[:16]}"
    )
    if outcome.failed:
        note(f"{wording.count(outcome.failed, 'participant')} could not be simulated; the column error has the reasons")
    return 1 if outcome.failed else 0
