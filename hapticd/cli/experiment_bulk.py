"""`hapticd experiment run --offline --count`: many simulated participants on all processors, or a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from hapticd.base import wording
from hapticd.cli.common import note
from hapticd.cli.engine import Where, computed, outcome_text, require_engine

if TYPE_CHECKING:
    from hapticd.experiment.keys import Study

ANSWERS: Final = Path("sourcedata", "simulated")
"""Folder of the rows in a data set, where BIDS has what files were made of."""


def run_bulk(
    study: Study, source: bytes, labels: tuple[str, ...], session: int, seed: int, output: Path, where: Where
) -> int:
    """One session of each participant: rows of Parquet in the data set's ANSWERS, and the folder of each session.

    What the data set holds is not computed again. The exit code is 0 if every session is complete. Raises HapticdError.
    """
    require_engine(where)
    from hapticd.sweeps.participants.bulk import Participants
    from hapticd.sweeps.participants.session_folders import SessionFolders

    work, rows = Participants(study, session, seed, labels), output / ANSWERS
    folders = SessionFolders(output, rows, source, work)
    outcome, store = computed(work, rows, where, "participant")
    written = folders.write(store.rows())
    click.echo(outcome_text(outcome, "participant"))
    click.echo(
        f"{output}: {wording.count(written, 'session')} written, {len(folders.present)} were there; "
        f"rows: {rows}/pieces/*.parquet, sha256 {store.digest()[:16]}"
    )
    if outcome.failed:
        note(f"{wording.count(outcome.failed, 'participant')} could not be simulated: the column error says why")
    return 1 if outcome.failed else 0
