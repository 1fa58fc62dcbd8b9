"""Writes rows of simulated participants as session folders, which `hapticd experiment analyze` reads.

Syncing each of the ten files of a session would take longer than everything else. So the disk is synced once after
SESSIONS_PER_SYNC sessions, and WRITTEN_FILE lists the sessions that are on disk. After a power failure the other
sessions are written again from their rows.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from hapticd.base import clock
from hapticd.base.errors import HapticdError
from hapticd.base.files import write_atomically
from hapticd.experiment.bids import check_one_study, write_data_set, write_session_tables
from hapticd.experiment.plan import plan
from hapticd.experiment.session import about_of, plan_document
from hapticd.experiment.session_folder import LOG_FILE_NAME, SessionFolder, folder_of
from hapticd.experiment.session_log import lines_of
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Row
from hapticd.sweeps.participants.bulk import PARTICIPANT_COLUMN, Participants
from hapticd.sweeps.participants.one_session import CLOCK_KEY, records_of, stage_of

WRITTEN_FILE: Final = "written.txt"
"""File in the result folder with the identity of each participant whose session folder is on disk, one per line."""
SESSIONS_PER_SYNC: Final = 500
"""Number of sessions after which the disk is synced."""


class SessionFolders:
    """The session folders of simulated participants in a data set."""

    def __init__(self, root: Path, rows_folder: Path, source: bytes, work: Participants) -> None:
        """Check the data set `root`; `source` is the YAML text of the study, `rows_folder` the result folder.

        Raises HapticdError if the data set has a session of another study, or another session with the same label and
        number.
        """
        check_one_study(root, work.title)
        self._root, self._work, self._source = root, work, source
        self._file = rows_folder / WRITTEN_FILE
        self._on_disk = set(self._file.read_text().split()) if self._file.is_file() else set()
        self.present = frozenset(label for label, point in work.points.items() if self._has(label, point))
        """Labels of the participants whose folders are on disk."""

    def _has(self, label: str, point: str) -> bool:
        path = folder_of(self._root, label, self._work.session)
        if not (path / LOG_FILE_NAME).exists() or not self._is_of(path, point):
            return False
        return point in self._on_disk and any((path / "beh").glob("*_events.json"))

    def _is_of(self, path: Path, point: str) -> bool:
        stage = SessionFolder.open(path).about.get("stage")
        if isinstance(stage, Mapping) and stage.get("point") == point:
            return True
        raise HapticdError(
            f"{path}: belongs to another study, seed or version; give another --output, --session or name, or remove it"
        )

    def write(self, rows: Iterable[Row]) -> int:
        """Write missing session folders of rows without an error; return the number of folders. Raises HapticdError."""
        fresh: list[str] = []
        count = 0
        for row in rows:
            if row[ERROR_COLUMN.name] is None and row[PARTICIPANT_COLUMN.name] not in self.present:
                self._write(row)
                fresh.append(str(row[POINT_COLUMN.name]))
                count += 1
            if len(fresh) == SESSIONS_PER_SYNC:
                self._sync(fresh)
        self._sync(fresh)
        if count or self.present:
            write_data_set(self._root, self._work.title)
        return count

    def _write(self, row: Row) -> None:
        work, label = self._work, str(row[PARTICIPANT_COLUMN.name])
        made = plan(work.study, label, work.session, work.seed)
        about = about_of(made, stage_of(str(row[POINT_COLUMN.name])), clock.read())
        folder = SessionFolder(folder_of(self._root, label, work.session), self._source, plan_document(made), about)
        first, *others = records_of(row)
        folder.write_with(lines_of([{**first, CLOCK_KEY: about[CLOCK_KEY]}, *others]))
        write_session_tables(folder, synced=False)

    def _sync(self, fresh: list[str]) -> None:
        """Sync the disk, add the identities of participants in `fresh` to WRITTEN_FILE, and clear `fresh`."""
        if not fresh:
            return
        os.sync()
        self._on_disk.update(fresh)
        fresh.clear()
        written = "".join(f"{each}\n" for each in sorted(self._on_disk))
        write_atomically(str(self._file), written, overwrite=True, synced=True)
