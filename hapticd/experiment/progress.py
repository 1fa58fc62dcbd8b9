"""The progress of a session, from the records of its log.

These kinds of records change the progress:

    session_started the session began
    trial_started   an attempt at a trial began: trial, attempt, file, stimuli, level
    answer          the trial is done: answer, correct, times, measures, and the new state of its procedure
    trial_skipped   the trial is not needed, because its procedure has ended
    ended           the session is over: all trials are done, or a stop rule ended it

Of the other kinds (`trial_given_up`, `note`, `paused`, ...) only the time `at_s` is used, for `elapsed_s`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.experiment.session_log import Record


@dataclass(slots=True)
class Progress:
    """The progress of a session: trials done, attempts, states of procedures, and counts for stop rules."""

    done: set[int] = field(default_factory=set)
    """Indices of trials that were answered or skipped."""
    attempts: dict[int, int] = field(default_factory=dict)
    """Number of attempts at each trial, by its index."""
    procedures: dict[str, Json] = field(default_factory=dict)
    """The newest state of each adaptive procedure."""
    elapsed_s: float = 0.0
    """Latest time of a record, in s on the session's clock, which runs only while a process runs the session."""
    correct: int = 0
    answered: int = 0
    answered_in_test: int = 0
    wrong_in_a_row: int = 0
    """Number of successive wrong answers in the test, up to the newest answer."""
    test_began_s: float | None = None
    """Onset of the first answered trial of the test, in s on the session's clock; None before its answer."""
    began: bool = False
    """Whether the session was started."""
    ended: str | None = None
    """Reason why the session is over, or None."""

    def take(self, record: Record) -> None:
        """Update the progress with the next record of the session's log."""
        kind = record["kind"]
        if "at_s" in record:
            self.elapsed_s = max(self.elapsed_s, cast(float, record["at_s"]))
        if kind == "trial_started":
            trial = cast(int, record["trial"])
            self.attempts[trial] = self.attempts.get(trial, 0) + 1
        elif kind in ("answer", "trial_skipped"):
            self.done.add(cast(int, record["trial"]))
            procedure = record.get("procedure")
            if isinstance(procedure, str):
                self.procedures[procedure] = record["procedure_state"]
            if kind == "answer":
                self.answered += 1
                self.correct += record.get("correct") == 1
                self._take_answer(record)
        elif kind == "session_started":
            self.began = True
        elif kind == "ended":
            self.ended = str(record["because"])

    def _take_answer(self, answer: Record) -> None:
        """Update the counts that breaks and stop rules need."""
        if answer.get("phase") == "test":
            self.answered_in_test += 1
            if self.test_began_s is None:
                self.test_began_s = cast(float, answer["onset_s"])
            self.wrong_in_a_row = self.wrong_in_a_row + 1 if answer.get("correct") == 0 else 0


def check_not_over(folder: Path, progress: Progress) -> None:
    """Raise HapticdError if the session in `folder`, with this progress, is over."""
    if progress.ended is not None:
        raise HapticdError(f"{folder}: this session is over ({progress.ended}) and cannot be resumed")


def progress_of(records: Iterable[Record]) -> Progress:
    """Return the progress of a session from all records of its log."""
    progress = Progress()
    for record in records:
        progress.take(record)
    return progress
