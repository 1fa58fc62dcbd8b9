"""The simulated participants of an experiment as points of the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.yaml_source import Json
from hapticd.experiment.keys import Study
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Row, row_of
from hapticd.sweeps.identity import sum_of, sums_at
from hapticd.sweeps.participants.one_session import SESSION_COLUMNS, session_values
from hapticd.sweeps.work import ID_DTYPE
from hapticd.sweeps.worker_check import code_version

PARTICIPANT_COLUMN: Final = Column("participant", "text", "varied", description="Label of the participant.")
"""The only varied column of a row."""
_ROW_COLUMNS: Final = (POINT_COLUMN, PARTICIPANT_COLUMN, *SESSION_COLUMNS, ERROR_COLUMN)


@dataclass(frozen=True)
class Sessions:
    """The sessions of some participants, which one worker computes as one task."""

    study: Study
    session: int
    seed: int
    ids: tuple[str, ...]
    labels: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.labels)

    def rows(self) -> list[Row]:
        """Run the session of each participant and return one row for each."""
        return [self._row(point, label) for point, label in zip(self.ids, self.labels, strict=True)]

    def _row(self, point: str, label: str) -> Row:
        given = {POINT_COLUMN.name: point, PARTICIPANT_COLUMN.name: label}
        return row_of(_ROW_COLUMNS, given, lambda: session_values(self.study, label, self.session, self.seed))


@dataclass(frozen=True)
class Participants:
    """Simulated participants, each with one session of the same experiment, as points of the engine."""

    study: Study
    session: int
    seed: int
    labels: tuple[str, ...]
    """Labels of the participants, all different."""
    ids: npt.NDArray[np.void] = field(init=False, repr=False)
    """Identities of the participants, (n,) ID_DTYPE."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", _ids(self.study, self.session, self.seed, self.labels))

    @property
    def title(self) -> str:
        """Title of the experiment's study."""
        return self.study.title

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of every row, in order."""
        return _ROW_COLUMNS

    @property
    def points(self) -> dict[str, str]:
        """The identity of each participant as hexadecimal digits, by label."""
        return {label: each.tobytes().hex() for label, each in zip(self.labels, self.ids, strict=True)}

    def piece(self, indices: npt.NDArray[np.int64]) -> Sessions:
        """Return the sessions of the participants whose indices in `labels` are `indices`."""
        ids = tuple(each.tobytes().hex() for each in self.ids[indices])
        labels = tuple(self.labels[index] for index in indices.tolist())
        return Sessions(self.study, self.session, self.seed, ids, labels)

    def manifest(self) -> dict[str, Json]:
        """Return the members of study.json other than title, columns and versions."""
        return {"kind": "participants", "study": self.study.to_dict(), "session": self.session, "seed": self.seed}


def _ids(study: Study, session: int, seed: int, labels: Sequence[str]) -> npt.NDArray[np.void]:
    shared: dict[str, Json] = {
        "kind": "participants",
        "study": study.to_dict(),
        "session": session,
        "seed": seed,
        "code": code_version(),
    }
    sums = sum_of(shared) + sums_at((PARTICIPANT_COLUMN.name,), labels)
    return np.ascontiguousarray(sums).view(ID_DTYPE).reshape(-1)
