"""The folder of a session: `sub-<label>/ses-<nn>/` in the folder of a data set.

    study.yaml        the study as it was read
    plan.json         every trial in its order
    session.json      participant, session, seed, versions, device and calibration
    log.jsonl         what happened (session_log); it is made last, so that its existence means that the rest is whole
    trial-0007.npz   telemetry of the trial with index 7; of its second attempt trial-0007-2.npz
    beh/              the tables of BIDS, made from the log (bids)

Whatever the process dies of, `SessionFolder.open` finds the same order and everything that was answered.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

from hapticd.base.errors import HapticdError, quoted
from hapticd.base.files import check_regular, write_whole
from hapticd.base.yaml_source import Json
from hapticd.experiment.session_log import Contents, SessionLog, read_log, sync_folder

STUDY: Final = "study.yaml"
PLAN: Final = "plan.json"
ABOUT: Final = "session.json"
LOG: Final = "log.jsonl"
SESSIONS: Final = 99
_LABEL: Final = re.compile("[A-Za-z0-9]{1,32}")


def participant_label(participant: str) -> str:
    """The label of a participant in names of files. Raises HapticdError for one that BIDS does not allow."""
    if not _LABEL.fullmatch(participant):
        raise HapticdError(f"participant {quoted(participant)}: must be 1 to 32 letters and digits, such as P07")
    return participant


def numbered(label: str, count: int) -> tuple[str, ...]:
    """The first `count` labels of many participants: `simA000001`, ... Raises HapticdError."""
    return tuple(participant_label(f"{label}{number:06d}") for number in range(1, count + 1))


def folder_of(root: Path, participant: str, session: int) -> Path:
    """The folder of a session below that of the data set. Raises HapticdError."""
    if not 1 <= session <= SESSIONS:
        raise HapticdError(f"session {session}: must be 1 to {SESSIONS}")
    return root / f"sub-{participant_label(participant)}" / f"ses-{session:02d}"


def check_new(root: Path, participant: str, session: int) -> Path:
    """The folder of a session that is to begin. Raises HapticdError where it exists."""
    path = folder_of(root, participant, session)
    check_regular(path / LOG)
    if (path / LOG).exists():
        raise HapticdError(
            f"{path}: this session exists; if it is not over, go on with `hapticd experiment resume {path}`; "
            "a new one needs another --session"
        )
    return path


@dataclass(frozen=True, slots=True)
class SessionFolder:
    """A session on disk: what was made when it began. Nothing of it changes later; what happens is in the log."""

    path: Path
    study: bytes
    """The study's YAML."""
    plan: dict[str, Json]
    about: dict[str, Json]

    @classmethod
    def create(
        cls, root: Path, study: bytes, plan: Mapping[str, Json], about: Mapping[str, Json]
    ) -> tuple[SessionFolder, SessionLog]:
        """Makes the folder of `about`'s participant and session, and its log.

        Where a process died before the log was there, the folder is made again. Raises HapticdError where the session
        exists, or the folder cannot be written.
        """
        path = check_new(root, str(about["participant"]), cast(int, about["session"]))
        made = cls(path, study, dict(plan), dict(about))
        made.write()
        return made, SessionLog(path / LOG)

    def write(self) -> None:
        """Writes what does not change later, which is on disk then. Raises HapticdError."""
        self._write({}, synced=True)
        try:
            for folder in (self.path, self.path.parent, self.root):
                sync_folder(folder)
        except OSError as error:
            raise HapticdError(f"{error.filename or self.path}: cannot be written: {error.strerror}") from None

    def write_with(self, log: bytes) -> None:
        """Writes a session that is over, with its log last; nothing waits for the disk. Raises HapticdError."""
        self._write({LOG: log}, synced=False)

    def _write(self, more: Mapping[str, bytes], synced: bool) -> None:
        files = {STUDY: self.study, PLAN: _json(self.plan), ABOUT: _json(self.about), **more}
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{error.filename or self.path}: cannot be written: {error.strerror}") from None
        for name, content in files.items():
            write_whole(str(self.path / name), content, overwrite=True, synced=synced)

    @classmethod
    def open(cls, path: Path) -> SessionFolder:
        """The session in a folder. Raises HapticdError where there is none, or it cannot be read."""
        if not (path / LOG).is_file():
            raise HapticdError(f"{path}: is no folder of a session: it has no {LOG}; give one such as sub-P07/ses-01")
        return cls(path, _read(path / STUDY), _mapping(path / PLAN), _mapping(path / ABOUT))

    @property
    def root(self) -> Path:
        """The folder of the data set."""
        return self.path.parent.parent

    @property
    def participant(self) -> str:
        return str(self.about["participant"])

    @property
    def session(self) -> int:
        return cast(int, self.about["session"])

    @property
    def seed(self) -> int:
        return cast(int, self.about["seed"])

    def log(self) -> SessionLog:
        """The log, to go on with. Raises HapticdError."""
        return SessionLog(self.path / LOG)

    def contents(self) -> Contents:
        """What the log holds; it is not changed. Raises HapticdError."""
        return read_log(self.path / LOG)

    def trial_file(self, trial: int, attempt: int) -> Path:
        """Where the telemetry of an attempt (from 1) at a trial goes: under a name that is free."""
        number = attempt
        while True:
            ending = "" if number == 1 else f"-{number}"
            target = self.path / f"trial-{trial:04d}{ending}.npz"
            if not target.exists():
                return target
            number += 1


def _json(value: object) -> bytes:
    return json.dumps(value, ensure_ascii=False, indent=1, allow_nan=False).encode() + b"\n"


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise HapticdError(f"{path}: cannot be read: {error.strerror}") from None


def _mapping(path: Path) -> dict[str, Json]:
    try:
        found = json.loads(_read(path))
    except ValueError as error:
        raise HapticdError(f"{path}: is no JSON: {error}; restore the file from a copy") from None
    if not isinstance(found, dict):
        raise HapticdError(f"{path}: must hold a mapping; restore the file from a copy")
    return found
