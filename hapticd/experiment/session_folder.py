"""The folder of a session: `sub-<label>/ses-<nn>/` in the folder of a data set.

    study.yaml        the study as it was read
    plan.json         every trial in its order
    session.json      participant, session, seed, versions, device and calibration
    log.jsonl         the log (session_log), created last: if it exists, study.yaml and the JSON files are complete
    trial-0007.npz    telemetry of the trial with index 7; of its second attempt: trial-0007-2.npz
    beh/              the tables of BIDS, made from the log (bids)

These files keep the order of trials and the answers, however the process ends.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

from hapticd.base.errors import HapticdError, quoted
from hapticd.base.files import check_regular, write_atomically
from hapticd.base.yaml_source import Json
from hapticd.experiment.session_log import Contents, SessionLog, read_file, read_log, sync_folder

STUDY_FILE_NAME: Final = "study.yaml"
PLAN_FILE_NAME: Final = "plan.json"
SESSION_FILE_NAME: Final = "session.json"
LOG_FILE_NAME: Final = "log.jsonl"
MAX_SESSION_NUMBER: Final = 99
"""Largest number of a session, as the names of folders have two digits."""
_PARTICIPANT_LABEL: Final = re.compile("[A-Za-z0-9]{1,32}")
"""The labels of participants that BIDS allows, with a limit of length."""


def participant_label(participant: str) -> str:
    """Return `participant` if it is a valid label for file names. Raises HapticdError if BIDS does not allow it."""
    if not _PARTICIPANT_LABEL.fullmatch(participant):
        raise HapticdError(f"participant {quoted(participant)}: must be 1 to 32 ASCII letters and digits, such as P07")
    return participant


def numbered(label: str, count: int) -> tuple[str, ...]:
    """Return `count` labels of participants, such as A000001 for `label` A. Raises HapticdError if one is invalid."""
    return tuple(participant_label(f"{label}{number:06d}") for number in range(1, count + 1))


def folder_of(root: Path, participant: str, session: int) -> Path:
    """Return the folder of a session in the data set `root`. Raises HapticdError for an invalid label or number."""
    if not 1 <= session <= MAX_SESSION_NUMBER:
        raise HapticdError(f"session {session}: must be between 1 and {MAX_SESSION_NUMBER}")
    return root / f"sub-{participant_label(participant)}" / f"ses-{session:02d}"


def check_new(root: Path, participant: str, session: int) -> Path:
    """Return the folder for a new session in the data set `root`. Raises HapticdError if the session already exists."""
    path = folder_of(root, participant, session)
    check_regular(path / LOG_FILE_NAME)
    if (path / LOG_FILE_NAME).exists():
        raise HapticdError(
            f"{path}: this session already exists; resume it with `hapticd experiment resume {path}`, "
            "or give another --session"
        )
    return path


@dataclass(frozen=True, slots=True)
class SessionFolder:
    """The folder of a session, with the content of the files that do not change after its beginning."""

    path: Path
    study: bytes
    """Content of study.yaml."""
    plan: dict[str, Json]
    """Content of plan.json."""
    about: dict[str, Json]
    """Content of session.json."""

    @classmethod
    def create(
        cls, root: Path, study: bytes, plan: Mapping[str, Json], about: Mapping[str, Json]
    ) -> tuple[SessionFolder, SessionLog]:
        """Make the folder and the log of a new session, whose participant and number are in `about`.

        A folder without a log, from a process that was killed, is written again. Raises HapticdError if the session
        already exists or the folder cannot be written.
        """
        path = check_new(root, str(about["participant"]), cast(int, about["session"]))
        made = cls(path, study, dict(plan), dict(about))
        made.write()
        return made, SessionLog(path / LOG_FILE_NAME)

    def write(self) -> None:
        """Write study.yaml, plan.json and session.json, and sync them to disk. Raises HapticdError if that fails."""
        self._write({}, synced=True)
        try:
            for folder in (self.path, self.path.parent, self.root):
                sync_folder(folder)
        except OSError as error:
            raise HapticdError(f"{error.filename or self.path}: cannot be written: {error.strerror}") from None

    def write_with(self, log: bytes) -> None:
        """Write the files of a session that is over, without syncing them to disk. `log`, the complete log, is last.

        Raises HapticdError if that fails.
        """
        self._write({LOG_FILE_NAME: log}, synced=False)

    def _write(self, more: Mapping[str, bytes], synced: bool) -> None:
        files = {
            STUDY_FILE_NAME: self.study,
            PLAN_FILE_NAME: _json(self.plan),
            SESSION_FILE_NAME: _json(self.about),
            **more,
        }
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{error.filename or self.path}: cannot be written: {error.strerror}") from None
        for name, content in files.items():
            write_atomically(str(self.path / name), content, overwrite=True, synced=synced)

    @classmethod
    def open(cls, path: Path) -> SessionFolder:
        """Read the session in the folder `path`. Raises HapticdError if it contains no session or cannot be read."""
        if not (path / LOG_FILE_NAME).is_file():
            raise HapticdError(
                f"{path}: not the folder of a session: it has no {LOG_FILE_NAME}; give one such as sub-P07/ses-01"
            )
        return cls(
            path, read_file(path / STUDY_FILE_NAME), _mapping(path / PLAN_FILE_NAME), _mapping(path / SESSION_FILE_NAME)
        )

    @property
    def root(self) -> Path:
        """The folder of the data set that contains the session."""
        return self.path.parent.parent

    @property
    def participant(self) -> str:
        """Label of the participant."""
        return str(self.about["participant"])

    @property
    def session(self) -> int:
        """Number of the session."""
        return cast(int, self.about["session"])

    @property
    def seed(self) -> int:
        """Random seed of the session's plan."""
        return cast(int, self.about["seed"])

    def log(self) -> SessionLog:
        """Open the session's log for writing.

        Raises HapticdError if another process has the log open, or if the log is damaged or cannot be written.
        """
        return SessionLog(self.path / LOG_FILE_NAME)

    def contents(self) -> Contents:
        """Read the session's log without changing it. Raises HapticdError if it is damaged or cannot be read."""
        return read_log(self.path / LOG_FILE_NAME)

    def trial_file(self, trial: int, attempt: int) -> Path:
        """Return an unused file name for the telemetry of an attempt, from 1, at the trial with index `trial`."""
        number = attempt
        while True:
            ending = "" if number == 1 else f"-{number}"
            target = self.path / f"trial-{trial:04d}{ending}.npz"
            if not target.exists():
                return target
            number += 1


def _json(value: object) -> bytes:
    return json.dumps(value, ensure_ascii=False, indent=1, allow_nan=False).encode() + b"\n"


def _mapping(path: Path) -> dict[str, Json]:
    try:
        found = json.loads(read_file(path))
    except ValueError as error:
        raise HapticdError(f"{path}: not valid JSON: {error}; restore the file from a copy") from None
    if not isinstance(found, dict):
        raise HapticdError(f"{path}: must be a JSON object; restore the file from a copy")
    return found
