"""A simulated participant as the front (user interface) of a session: a hand explores, and an observer answers.

The participant receives `Shown`, which contains no names of stimuli, and the samples that its hand felt. Like a person
it knows from the instructions whether to tap, to stroke or to press.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

import numpy as np

from hapticd.base.yaml_source import Json
from hapticd.experiment.front import Command, Reply, Seen, Shown, Watched
from hapticd.experiment.keys import MeasureQuestion
from hapticd.experiment.participants.hand import Hand
from hapticd.experiment.participants.observer import Feature, Observer, rupture_felt_s
from hapticd.experiment.plan import Plan
from hapticd.experiment.stage import Motion, Reaction, Samples, Stage
from hapticd.experiment.trial_scenes import configurations

Task: TypeAlias = Literal["tap", "stroke", "press"]
FEATURE_OF_TASK: Final[dict[Task, Feature]] = {"tap": "hardness", "stroke": "fineness", "press": "loudness"}
"""The feature of the felt force by which the observer answers, by task of the hand."""
_MIN_REACTION_TIME_S: Final = 0.03
"""Lower bound of a random reaction time, due to the conduction time of nerves."""


def task_of(plan: Plan) -> Task:
    """Return the task of the hand in all trials of a plan.

    The task is `press` if the motion is measured, `stroke` if the first trial has a texture, otherwise `tap`.
    """
    if isinstance(plan.study.asked, MeasureQuestion):
        return "press"
    if not plan.trials:
        return "tap"
    config = configurations(plan.study, plan.trials[0].stimuli)[0]
    shown = {
        material
        for item in config.scene.objects.values()
        for material in (getattr(item, "material", None), *(each.material for each in getattr(item, "patches", ())))
    }
    return "stroke" if any(config.materials[name].texture for name in shown if name is not None) else "tap"


class SimulatedFront:
    """The user interface of a simulated participant, without an experimenter; see `Front` for the methods."""

    def __init__(self, seed: int, name: str, task: Task) -> None:
        """Create a participant. Equal seeds, names and tasks give equal answers."""
        chance = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *name.encode()])))
        self._hand = Hand(chance)
        self._observer = Observer(chance)
        self._task = task
        self._percepts: list[float] = []

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        """Return None: a simulated participant begins immediately."""
        return None

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        """Return None: a simulated participant begins the phase immediately."""
        return None

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        """Return None: the forces are switched on immediately."""
        self._percepts = []
        return None

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Move the simulated hand out of the surfaces of an interval, and return None."""
        for surface in shown.surfaces_of(interval):
            stage.move(Motion(self._hand.way_out(surface)))
        return None

    def may_enable(self) -> Command | None:
        """Return None: a simulated participant never forbids the forces."""
        return None

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Feel the surface of an interval with the simulated hand, and return None."""
        self._feel(shown.surfaces[interval - 1], stage)
        return None

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        """Feel the surfaces of the last interval, and return the answer; for a measured motion only press."""
        if shown.kind == "measure":
            self._press(shown.surfaces[0], stage)
            return Reply(None)
        for surface in shown.surfaces if shown.in_places else shown.surfaces[-1:]:
            self._feel(surface, stage)
        return Reply(self._answer(shown))

    def not_done(self, trial: int, why: str) -> None:
        """Ignore that a motor task was not done."""

    def feedback(self, text: str, right: str | None) -> None:
        """Learn which percept belongs to the correct answer, after a trial with one stimulus."""
        if right is not None and len(self._percepts) == 1:
            self._observer.learn(self._percepts[0], right)

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        """Ignore that an answer was saved."""

    def rest(self, text: str | None, least_s: float) -> Command | None:
        """Return None: a break ends immediately."""
        return None

    def paused(self) -> Command | None:
        """Return None: a pause ends immediately."""
        return None

    def show_line(self, line: str) -> None:
        """Ignore a line for the experimenter."""

    def _answer(self, shown: Shown) -> str | float | None:
        match shown.kind:
            case "choice" if len(self._percepts) > 1:
                return self._observer.compare(self._percepts, shown.answers)
            case "choice":
                return self._observer.identify(self._percepts[0], shown.answers)
            case "ranking":
                return self._observer.rank(self._percepts)
            case "slider" | "number":
                low, high = shown.low or 0.0, shown.high if shown.high is not None else 100.0
                return self._observer.rate(self._percepts[-1], low, high)
            case _:
                return ""

    def _feel(self, surface: Seen, stage: Stage) -> None:
        moved = self._hand.strokes(surface) if self._task == "stroke" else self._hand.taps(surface)
        felt = stage.move(Motion(moved))
        self._percepts.append(self._observer.percept(FEATURE_OF_TASK[self._task], felt, surface))

    def _press(self, surface: Seen, stage: Stage) -> None:
        pressed, delay_s = self._hand.press(surface), self._hand.reaction_s()

        def noticed_s(felt: Samples) -> float | None:
            found = rupture_felt_s(felt, surface)
            return None if found is None else found + max(_MIN_REACTION_TIME_S, delay_s)

        stage.move(Motion(pressed, Reaction(noticed_s, lambda at_s: self._hand.withdrawal(surface, pressed, at_s))))
