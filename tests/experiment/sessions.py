"""A small study, a stage that records the calls of its methods, and a front that answers from a script."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.experiment.front import Command, Reply, Shown, Watched
from hapticd.experiment.plan import Plan, plan
from hapticd.experiment.runner import Session
from hapticd.experiment.session import begin, plan_of, procedure_of
from hapticd.experiment.session_folder import SessionFolder
from hapticd.experiment.stage import Motion, Stage, Telemetry
from hapticd.experiment.stimuli import at_level
from hapticd.experiment.study import study_of

STUDY: dict[str, Any] = {
    "experiment": 1,
    "title": "Which is stiffer?",
    "instructions": "Tap both.",
    "base": {
        "materials": {"left": "wood", "right": "wood"},
        "scene": {
            "objects": {
                "left": {"kind": "box", "center_m": [-0.03, -0.03], "size_m": [0.05, 0.04], "material": "left"},
                "right": {"kind": "box", "center_m": [0.03, -0.03], "size_m": [0.05, 0.04], "material": "right"},
            }
        },
    },
    "places": ["left", "right"],
    "factors": {"material": {"at": "materials.{place}", "levels": ["wood", "delrin", "steel"]}},
    "trial": {
        "type": "paired_comparison",
        "presentation": "places",
        "cross": ["material"],
        "with_itself": True,
        "question": "stiffer",
    },
    "questions": {
        "stiffer": {
            "kind": "choice",
            "text": "Which is stiffer?",
            "answers": [
                {"name": "first", "label": "The left one", "key": "1", "means": "first"},
                {"name": "same", "label": "The same", "key": "2", "means": "same"},
                {"name": "second", "label": "The right one", "key": "3", "means": "second"},
            ],
            "asks": {"factor": "material", "which": "highest"},
        }
    },
}

STAIRCASE: dict[str, Any] = {
    "experiment": 1,
    "title": "Which rings higher?",
    "instructions": "Tap both.",
    "base": {
        "materials": {
            "surface": {
                "stiffness_n_per_m": 800,
                "tap": {"attack_slope_per_s": 400, "frequency_hz": 200, "decay_time_s": 0.01},
            }
        },
        "scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "surface"}}},
    },
    "trial": {
        "type": "forced_choice",
        "presentation": "intervals",
        "alternatives": 2,
        "question": "higher",
        "procedures": {
            "down": {
                "variable": {
                    "name": "frequency_hz",
                    "at": "materials.surface.tap.frequency_hz",
                    "reference": 200.0,
                    "level": "added",
                },
                "method": {
                    "kind": "staircase",
                    "rule": "1-up-2-down",
                    "start": 100.0,
                    "least": 1.0,
                    "most": 200.0,
                    "steps": [2.0, 1.4],
                    "axis": "logarithmic",
                    "reversals": 6,
                    "discard": 2,
                    "trials": 20,
                    "guess": 0.5,
                },
            }
        },
    },
    "questions": {
        "higher": {
            "kind": "choice",
            "text": "Which rings higher?",
            "answers": [
                {"name": "first", "label": "The first", "key": "1", "means": "first"},
                {"name": "second", "label": "The second", "key": "2", "means": "second"},
            ],
        }
    },
}


class NotedStage:
    """A stage that records the calls of its methods. `fails` is called with the name of each method."""

    def __init__(self, fails: Callable[[str], None] = lambda done: None) -> None:
        self.done: list[str] = []
        self.configs: list[Any] = []
        self.marks: list[tuple[str, Any]] = []
        self.clear: list[bool] = []
        """Results of the next calls of `is_clear`. Later calls return True."""
        self._fails = fails

    def _do(self, what: str) -> None:
        self._fails(what)
        self.done.append(what)

    def describe(self) -> dict[str, Any]:
        return {"kind": "noted"}

    def check(self) -> None:
        self._fails("check")

    def arm(self, config: Any) -> None:
        self._do("arm")
        self.configs.append(config)

    def is_clear(self) -> bool:
        return self.clear.pop(0) if self.clear else True

    def enable(self) -> None:
        self._do("enable")

    def fade(self) -> None:
        self._do("fade")

    def mark(self, text: str, data: Any) -> None:
        self._do(f"mark {text}")
        self.marks.append((text, data))

    @contextmanager
    def recording(self, target: Path, notes: Mapping[str, Any]) -> Iterator[None]:
        self._do("record")
        try:
            yield
        finally:
            target.write_bytes(b"")
            self.done.append("recorded")

    def move(self, motion: Motion) -> Any:
        raise AssertionError("nobody asked for a hand")

    def telemetry(self) -> Telemetry:
        return Telemetry(np.zeros(0, SAMPLE_DTYPE), [])


class ScriptedFront:
    """A front that answers with `answers` for each trial, counted over all runs; `commands` has its commands."""

    def __init__(self, answers: Callable[[Shown], str] = lambda shown: shown.answers[0].name) -> None:
        self.answers = answers
        self.commands: dict[str, list[Command]] = {}
        """The commands that the methods of the front return, by name of the method."""
        self.watched: list[Watched] = []
        self.shown: list[Shown] = []
        self.lines: list[str] = []
        self.feedbacks: list[str] = []
        self.asked: list[str] = []
        self.answers_on_disk: list[tuple[int, Any, bool | None]] = []

    def _command(self, where: str) -> Command | None:
        self.asked.append(where)
        waiting = self.commands.get(where, [])
        return waiting.pop(0) if waiting else None

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        return self._command("begin")

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        return self._command("phase")

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        self.watched.append(watched)
        return self._command("ready")

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        return self._command("withdraw")

    def may_enable(self) -> Command | None:
        return None

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        return self._command("explore")

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        interruption = self._command("ask")
        if interruption is not None:
            return interruption
        self.shown.append(shown)
        return Reply(self.answers(shown))

    def feedback(self, text: str, right: str | None) -> None:
        self.asked.append("feedback")
        self.feedbacks.append(text)

    def not_done(self, trial: int, why: str) -> None:
        self.feedbacks.append(f"{trial}: {why}")

    def answered(self, watched: Watched, answer: Any, correct: bool | None, response_s: float) -> None:
        self.answers_on_disk.append((watched.index, answer, correct))

    def rest(self, text: str | None, least_s: float) -> Command | None:
        return self._command("rest")

    def paused(self) -> Command | None:
        return self._command("paused")

    def show_line(self, line: str) -> None:
        self.lines.append(line)


def planned(document: Mapping[str, Any] = STUDY, seed: int = 3, participant: str = "P07") -> Plan:
    return plan(study_of(document), participant, 1, seed)


def started(root: Path, stage: Stage, front: Any, document: Mapping[str, Any] = STUDY, seed: int = 3) -> Session:
    """Return a new session."""
    made = planned(document, seed)
    folder, log = begin(root, b"# the study\n", made, stage.describe())
    return _session(folder, log, made, stage, front)


def resumed(path: Path, stage: Stage, front: Any) -> Session:
    """Return a session that continues."""
    folder = SessionFolder.open(path)
    return _session(folder, folder.log(), plan_of(folder), stage, front)


def _session(folder: SessionFolder, log: Any, made: Plan, stage: Stage, front: Any) -> Session:
    return Session(
        folder,
        log,
        made,
        stage,
        front,
        procedures=partial(procedure_of, made.study),
        at_level=partial(at_level, made.study),
    )
