"""A simulated participant as the front of a session: its hand explores, its observer answers.

It gets `Shown`, which holds no name of a stimulus, and the samples that its hand felt. From the instructions it knows
what a person knows: whether to tap, to stroke or to press.
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
TASKS: Final[dict[Task, Feature]] = {"tap": "hardness", "stroke": "fineness", "press": "loudness"}
_CAUTION_S: Final = 0.03
"""So long the nerves take until something felt can be acted on; a part of the reaction time."""


def task_of(plan: Plan) -> Task:
    """What the instructions of a study ask for, once for all trials: to press where the motion is measured, to stroke
    where the first trial has a texture, to tap otherwise."""
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
    """Hand and observer; nobody else is asked, and the forces come on at once."""

    def __init__(self, seed: int, name: str, task: Task) -> None:
        """The same seed, name and task answer alike."""
        chance = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *name.encode()])))
        self._hand = Hand(chance)
        self._observer = Observer(chance)
        self._task = task
        self._percepts: list[float] = []

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        return None

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        return None

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        self._percepts = []
        return None

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        for surface in shown.surfaces_of(interval):
            stage.move(Motion(self._hand.way_out(surface)))
        return None

    def may_enable(self) -> Command | None:
        return None

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        self._feel(shown.surfaces[interval - 1], stage)
        return None

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        if shown.kind == "measure":
            self._press(shown.surfaces[0], stage)
            return Reply(None)
        for surface in shown.surfaces if shown.in_places else shown.surfaces[-1:]:
            self._feel(surface, stage)
        return Reply(self._answer(shown))

    def not_done(self, trial: int, why: str) -> None:
        pass

    def feedback(self, told: str, right: str | None) -> None:
        if right is not None and len(self._percepts) == 1:
            self._observer.learn(self._percepts[0], right)

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        pass

    def rest(self, text: str | None, least_s: float) -> Command | None:
        return None

    def paused(self) -> Command | None:
        return None

    def tell(self, line: str) -> None:
        pass

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
        self._percepts.append(self._observer.percept(TASKS[self._task], felt, surface))

    def _press(self, surface: Seen, stage: Stage) -> None:
        pressed, delay_s = self._hand.press(surface), self._hand.reaction_s()

        def noticed_s(felt: Samples) -> float | None:
            found = rupture_felt_s(felt, surface)
            return None if found is None else found + max(_CAUTION_S, delay_s)

        stage.move(Motion(pressed, Reaction(noticed_s, lambda at_s: self._hand.withdrawal(surface, pressed, at_s))))
