"""The keys of a study's YAML file, each with its range. hapticd.experiment.faults finds conflicts between keys."""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Field, Strict, StringConstraints

from hapticd.base.model import CheckedTogether, Model, Name, one_of_two
from hapticd.experiment.order import OrderKind
from hapticd.experiment.plain_values import KeyPath, PlainMapping, PlainScalar, Scalar, as_list
from hapticd.experiment.procedures.constant_stimuli import ConstantStimuliParameters
from hapticd.experiment.procedures.quest_plus import QuestPlusParameters
from hapticd.experiment.procedures.staircase import StaircaseParameters

TrialType: TypeAlias = Literal[
    "paired_comparison", "forced_choice", "identification", "ranking", "rating", "motor"
]  # fmt: skip
Presentation: TypeAlias = Literal["places", "intervals"]
Measure: TypeAlias = Literal["overtravel_m", "peak_force_n", "completion_s", "path_m"]
Meaning: TypeAlias = Literal["first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "same"]

POSITION_MEANINGS: Final[tuple[Meaning, ...]] = (
    "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth",
)  # fmt: skip
"""Positions in the order of presentation, by which answers and rankings name stimuli."""
NAMED_KEYS: Final = ("left", "right", "up", "down", "space", "enter")
"""Names of keyboard keys that can choose an answer, besides single characters. Escape stops the forces instead."""
MAX_TRIALS: Final = 100_000
"""Largest number of trials in a session."""
MAX_STIMULI_PER_TRIAL: Final = len(POSITION_MEANINGS)
"""Largest number of stimuli in a trial: an answer can name no other position."""
MAX_FACTOR_LEVELS: Final = 10_000


Level: TypeAlias = PlainScalar
Patch: TypeAlias = PlainMapping
"""A merge patch (RFC 7396) on the base configuration."""
KeyPaths: TypeAlias = Annotated[
    tuple[KeyPath, ...], Strict(False), Field(min_length=1, max_length=64), BeforeValidator(as_list)
]
Markdown: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=100_000)]
Label: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=200)]
Seconds: TypeAlias = Annotated[float, Field(gt=0, le=86_400)]
Names: TypeAlias = Annotated[tuple[Name, ...], Strict(False), Field(min_length=1, max_length=64)]


class Factor(CheckedTogether):
    """A property that varies between stimuli: values of one or more keys, or merge patches by name."""

    levels: Annotated[tuple[Level, ...], Strict(False), Field(min_length=1, max_length=MAX_FACTOR_LEVELS)] | None = (
        Field(
            default=None,
            description="Values of the keys at `at`, in their order from low to high; numbers are ordered by value.",
        )
    )
    at: KeyPaths | None = Field(
        default=None,
        description="The keys that take the level, from the configuration's root: materials.wood.tap.frequency_hz. "
        "{place} stands for the place of the stimulus. At materials.NAME, the name of a material stands for its keys.",
    )
    variants: Annotated[dict[Name, Patch], Field(min_length=1, max_length=MAX_FACTOR_LEVELS)] | None = Field(
        default=None,
        description="Instead of levels: the changes of the configuration for each level, by the level's name.",
    )

    def cross_faults(self) -> list[str]:
        """Return the conflicts between the keys `levels`, `variants` and `at` of a factor."""
        faults = one_of_two(self, "levels", "variants")
        if self.variants is not None and self.at is not None:
            faults.append("at is only valid with levels; variants name the keys that they change")
        if self.levels is not None and self.at is None:
            faults.append("levels need at, the keys that take the level, as materials.wood.tap.frequency_hz")
        return faults

    @property
    def names(self) -> tuple[Scalar, ...]:
        """The levels of the factor, or the names of its variants, in the order of the study."""
        return tuple(self.variants or ()) if self.levels is None else self.levels


class Condition(Model):
    """A condition: changes of the base configuration for a part of the trials."""

    changes: Patch = Field(default={}, description="Changes of the base configuration, as a merge patch.")


class ReplyAnswer(Model):
    """One of the answers to a question."""

    name: Name = Field(description="Name of the answer in the data.")
    label: Label = Field(description="What the participant reads.")
    key: Annotated[str, StringConstraints(min_length=1, max_length=16)] | None = Field(
        default=None, description=f"A key of the keyboard: one character, or one of {', '.join(NAMED_KEYS)}."
    )
    means: Meaning | None = Field(
        default=None,
        description="Position of the stimulus that the answer names, in the order of presentation, or same.",
    )
    level: Level | None = Field(default=None, description="The level that the answer names, in an identification.")


class Asked(Model):
    """The rule that derives the correct answer from the levels of the stimuli."""

    factor: Name = Field(description="The factor, or the variable of a procedure, by which stimuli are compared.")
    which: Literal["highest", "lowest"] = Field(
        default="highest",
        description="The stimulus with the highest level or the lowest; levels as texts rise in the factor's order.",
    )


class _QuestionKeys(Model):
    """The keys that every question has."""

    text: Markdown = Field(description="What the participant reads.")


class ChoiceQuestion(_QuestionKeys):
    """A question with several answers, chosen by buttons or keys."""

    kind: Literal["choice"] = Field(description="Which kind of question this is.")
    answers: Annotated[tuple[ReplyAnswer, ...], Strict(False), Field(min_length=2, max_length=100)] = Field(
        description="The answers, in the order of their buttons."
    )
    asks: Asked | None = Field(default=None, description="Which stimulus is correct.")


class RankingQuestion(_QuestionKeys):
    """A question for a ranking of the stimuli. The answer names their positions, such as second>first>third."""

    kind: Literal["ranking"] = Field(description="Which kind of question this is.")
    asks: Asked | None = Field(default=None, description="Which stimulus comes first in the correct order.")


class SliderQuestion(CheckedTogether):
    """A question for a number between two ends, set with a slider."""

    kind: Literal["slider"] = Field(description="Which kind of question this is.")
    text: Markdown = Field(description="What the participant reads.")
    low: float = Field(default=0.0, ge=-1e9, le=1e9, description="Value of the left end.")
    high: float = Field(default=100.0, ge=-1e9, le=1e9, description="Value of the right end.")
    step: Annotated[float, Field(gt=0, le=1e9)] | None = Field(default=None, description="Step between two values.")
    low_label: Label | None = Field(default=None, description="Label of the left end.")
    high_label: Label | None = Field(default=None, description="Label of the right end.")

    def cross_faults(self) -> list[str]:
        """Return the conflicts between the keys `low`, `high` and `step` of a slider."""
        faults = _rising(self.low, self.high)
        if not faults and self.step is not None and self.step > self.high - self.low:
            faults.append(f"step must be at most high minus low, {self.high - self.low:g}, is {self.step:g}")
        return faults


class NumberQuestion(CheckedTogether):
    """A question for a typed number, as in magnitude estimation."""

    kind: Literal["number"] = Field(description="Which kind of question this is.")
    text: Markdown = Field(description="What the participant reads.")
    low: float = Field(default=0.0, ge=-1e9, le=1e9, description="Smallest number that is accepted.")
    high: float = Field(default=1e6, ge=-1e9, le=1e9, description="Largest number that is accepted.")

    def cross_faults(self) -> list[str]:
        """Return the conflict between the keys `low` and `high`, the limits of the number, if there is one."""
        return _rising(self.low, self.high)


class TextQuestion(_QuestionKeys):
    """A question for a free text."""

    kind: Literal["text"] = Field(description="Which kind of question this is.")
    most_characters: int = Field(default=1000, ge=1, le=100_000, description="Largest number of characters.")


class MeasureQuestion(_QuestionKeys):
    """A task whose answer is a measure of the motion. `text` says what to do."""

    kind: Literal["measure"] = Field(description="Which kind of question this is.")
    measure: Measure = Field(description="What is measured.")


def _rising(low: float, high: float) -> list[str]:
    return [] if low < high else [f"low must be less than high, {high:g}, is {low:g}"]


Question: TypeAlias = (
    ChoiceQuestion | RankingQuestion | SliderQuestion | NumberQuestion | TextQuestion | MeasureQuestion
)
Method: TypeAlias = StaircaseParameters | QuestPlusParameters | ConstantStimuliParameters


class Variable(Model):
    """The quantity that an adaptive procedure varies: one or more keys of the configuration."""

    name: Name = Field(description="Name in the data.")
    at: KeyPaths = Field(description="The keys that take the variable's value, as `at` of a factor.")
    reference: float = Field(ge=-1e9, le=1e9, description="Value in the stimuli that the target is compared with.")
    level: Literal["value", "added", "factor"] = Field(
        default="value",
        description="What the procedure's level is: the value, the difference from the reference, or the ratio to the "
        "reference.",
    )


class Adaptive(Model):
    """A procedure that chooses the level of each trial: a staircase, QUEST+ or constant stimuli."""

    variable: Variable = Field(description="What the procedure varies.")
    method: Annotated[Method, Field(discriminator="kind")] = Field(description="The procedure and its parameters.")
    practice_level: float | None = Field(
        default=None, ge=-1e9, le=1e9, description="The level in practice and training trials."
    )

    @property
    def trials(self) -> int:
        """Largest number of trials in a run of the procedure."""
        method = self.method
        if isinstance(method, ConstantStimuliParameters):
            return len(method.levels) * method.repetitions
        return method.trials

    @property
    def ends(self) -> tuple[float, float]:
        """The lowest and the highest level that the procedure can show."""
        method = self.method
        if isinstance(method, StaircaseParameters):
            return method.least, method.most
        return min(method.levels), max(method.levels)


class ListedTrial(Model):
    """An entry of trial.list: one trial with its stimuli."""

    stimuli: Annotated[
        tuple[dict[Name, Level], ...], Strict(False), Field(min_length=1, max_length=MAX_STIMULI_PER_TRIAL)
    ] = Field(description="The level of every factor, for each stimulus in the order of presentation.")
    condition: Name | None = Field(default=None, description="The condition that the trial belongs to; by default all.")
    correct: Name | None = Field(default=None, description="The correct answer, if the question does not define it.")
    repetitions: int = Field(
        default=1, ge=1, le=MAX_TRIALS, description="How often the trial is presented in each repetition of the list."
    )


class TrialDesign(Model):
    """The type of the trials, and their stimuli."""

    type: TrialType = Field(description="The task of a trial.")
    presentation: Presentation = Field(
        default="intervals", description="Stimuli side by side in one scene, or one after the other."
    )
    question: Name = Field(description="Name of the question.")
    cross: Names | None = Field(default=None, description="Factors; every combination of their levels is a stimulus.")
    list: Annotated[tuple[ListedTrial, ...], Strict(False), Field(min_length=1, max_length=MAX_TRIALS)] | None = Field(
        default=None, description="Instead of cross: a list of trials."
    )
    procedures: Annotated[dict[Name, Adaptive], Field(min_length=1, max_length=64)] | None = Field(
        default=None, description="Adaptive procedures by name; their trials are interleaved."
    )
    alternatives: int | None = Field(
        default=None, ge=2, le=MAX_STIMULI_PER_TRIAL, description="Number of stimuli of a forced choice or a ranking."
    )
    reference: Annotated[dict[Name, Level], Field(min_length=1)] | None = Field(
        default=None, description="Levels of the stimuli that the target of a forced choice is compared with."
    )
    with_itself: bool = Field(default=False, description="Whether each stimulus is also compared with itself.")
    both_orders: bool = Field(
        default=False,
        description="Whether each pair is shown in both orders; if not, orders are balanced at random.",
    )
    measures: Annotated[tuple[Measure, ...], Strict(False), Field(max_length=8)] = Field(
        default=(), description="Measures of the motion, in addition to the answer."
    )
    expected_s: Seconds = Field(
        default=20.0, description="Expected duration of a trial and the pause after it, for the estimate of `check`."
    )


class StudyOrder(Model):
    """The order of the trials of the test."""

    kind: OrderKind = Field(
        default="random",
        description="All trials mixed, blocks in random order, blocks by a Latin square over the participants, or the "
        "order of the file.",
    )
    by: Literal["condition", "repetition", "cell", "procedure"] | None = Field(
        default=None,
        description="What the trials of a block share, for blocked and latin_square; by default the condition.",
    )
    seed: int = Field(default=1, ge=0, le=2**32 - 1, description="Random seed, unless the session has another one.")


class Warmup(Model):
    """Practice or training trials before the test."""

    trials: int = Field(ge=1, le=1000, description="Number of trials, spread evenly over the cells.")
    instructions: Markdown | None = Field(default=None, description="What is shown before these trials.")
    feedback: bool = Field(default=True, description="Whether the participant sees what was correct or measured.")


class Breaks(Model):
    """The breaks of a session."""

    every_trials: int | None = Field(
        default=None, ge=1, le=10_000, description="Number of test trials between two breaks."
    )
    between_blocks: bool = Field(default=False, description="Whether there is a break between two blocks.")
    least_s: float = Field(default=0.0, ge=0, le=3600, description="Shortest duration of a break.")
    text: Markdown | None = Field(default=None, description="What is shown during a break.")


class Stop(Model):
    """Rules that end the test before its last trial."""

    after_s: Seconds | None = Field(
        default=None, description="Time since the first test trial after which no trial begins."
    )
    wrong_in_a_row: int | None = Field(
        default=None, ge=1, le=10_000, description="Number of successive wrong answers that ends the test."
    )


class ProportionEffect(Model):
    """An effect that is a proportion of correct answers, to be distinguished from chance."""

    kind: Literal["proportion"] = Field(description="Which kind of effect this is.")
    correct: float = Field(gt=0, lt=1, description="Mean probability of a correct answer.")
    between: float = Field(
        default=0.0, ge=0, le=0.5, description="Standard deviation of that probability between participants."
    )
    participants: int = Field(ge=2, le=1000, description="Number of participants.")
    significance: float = Field(default=0.05, gt=0, lt=0.5, description="Significance level of the two-sided test.")


class DifferenceEffect(Model):
    """An effect that is a difference of a measure between two conditions or cells."""

    kind: Literal["difference"] = Field(description="Which kind of effect this is.")
    mean: float = Field(ge=-1e9, le=1e9, description="Mean difference, in the measure's unit.")
    standard_deviation: float = Field(
        gt=0, le=1e9, description="Standard deviation of the difference of two single trials."
    )
    between: float = Field(
        default=0.0, ge=0, le=1e9, description="Standard deviation of the true difference between participants."
    )
    participants: int = Field(ge=2, le=1000, description="Number of participants.")
    significance: float = Field(default=0.05, gt=0, lt=0.5, description="Significance level of the two-sided test.")


class StudyAnalysis(Model):
    """Settings of the analysis."""

    chance: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="Probability of a correct answer by guessing. Without it nothing is tested against chance.",
    )
    published: str | None = Field(
        default=None, description="Published results to compare with, e.g. okamura1998.tapping."
    )
    effect: Annotated[ProportionEffect | DifferenceEffect, Field(discriminator="kind")] | None = Field(
        default=None, description="The effect whose power `check` simulates."
    )


class Study(Model):
    """A study, as its YAML file defines it."""

    experiment: Literal[1] = Field(description="Version of this kind of document.")
    title: Label = Field(description="Title of the study, in one line.")
    instructions: Markdown = Field(description="What the participant reads before the first trial.")
    base: Patch = Field(
        default={}, description="Scene and materials that every stimulus starts from; or the name of a file."
    )
    places: Annotated[tuple[Name, ...], Strict(False), Field(max_length=MAX_STIMULI_PER_TRIAL)] = Field(
        default=(), description="Names that replace {place}, from left to right."
    )
    factors: Annotated[dict[Name, Factor], Field(max_length=32)] = Field(default={}, description="What is varied.")
    conditions: Annotated[dict[Name, Condition], Field(min_length=1, max_length=64)] = Field(
        default={"all": Condition()}, description="Conditions by name; each has all trials."
    )
    trial: TrialDesign = Field(description="What a trial is.")
    repetitions: int = Field(default=1, ge=1, le=10_000, description="How often each trial is presented.")
    order: StudyOrder = Field(default=StudyOrder(), description="Order of the trials.")
    practice: Warmup | None = Field(default=None, description="Trials to practise the task, before all others.")
    training: Warmup | None = Field(default=None, description="Trials to learn the answers, before the test.")
    breaks: Breaks = Field(default=Breaks(), description="Breaks of the test.")
    time_limit_s: Seconds | None = Field(default=None, description="Time for a trial, which then ends without answer.")
    questions: Annotated[
        dict[Name, Annotated[Question, Field(discriminator="kind")]], Field(min_length=1, max_length=64)
    ] = Field(description="Questions by name.")
    feedback: Literal["none", "correctness", "measure"] = Field(
        default="none", description="What the participant sees after a trial of the test."
    )
    stop: Stop = Field(default=Stop(), description="Rules that end the test early.")
    analysis: StudyAnalysis = Field(default=StudyAnalysis(), description="Settings of the analysis.")

    @property
    def asked(self) -> Question:
        """The question that the trials ask, one of `questions`."""
        return self.questions[self.trial.question]

    def adaptive(self, procedure: str) -> Adaptive:
        """Return the adaptive procedure of the run with the name `procedure`.

        In a run, a procedure has one state. The name of a run is e.g. `rising`, or `rising.CONDITION.CELL` if each
        condition and cell has a separate run.
        """
        assert self.trial.procedures is not None
        return self.trial.procedures[procedure.partition(".")[0]]

    @property
    def may_end_early(self) -> bool:
        """Whether fewer trials than planned may be needed.

        A procedure can end by a criterion, and a number of successive wrong answers can end the test.
        """
        return self.trial.procedures is not None or self.stop.wrong_in_a_row is not None

    @property
    def stimuli_per_trial(self) -> int:
        """Number of stimuli that a trial presents."""
        match self.trial.type:
            case "paired_comparison":
                return 2
            case "forced_choice":
                return self.trial.alternatives or 2
            case "ranking":
                return self.trial.alternatives or len(self.places) or 2
            case _:
                return 1
