"""The keys of a study: what its YAML file holds, each key with its range.

Faults between keys are found by hapticd.experiment.faults, where the place of each is known.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Field, Strict, StringConstraints

from hapticd.base.model import CheckedTogether, Model, Name, one_of_two
from hapticd.experiment.plain_values import PlainMapping, PlainScalar, Scalar
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
"""What an answer means by its position, in the order of presentation."""
NAMED_KEYS: Final = ("left", "right", "up", "down", "space", "enter")
"""Keys of a keyboard that an answer may be on, besides single characters. Escape stops everything."""
MAX_TRIALS: Final = 100_000
MAX_STIMULI_PER_TRIAL: Final = len(POSITION_MEANINGS)
MAX_FACTOR_LEVELS: Final = 10_000


def _some(value: object) -> object:
    return [value] if isinstance(value, str) else value


Level: TypeAlias = PlainScalar
Patch: TypeAlias = PlainMapping
"""A merge patch (RFC 7396) on the base configuration."""
KeyPath: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=512)]
KeyPaths: TypeAlias = Annotated[
    tuple[KeyPath, ...], Strict(False), Field(min_length=1, max_length=64), BeforeValidator(_some)
]
Markdown: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=100_000)]
Label: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=200)]
Seconds: TypeAlias = Annotated[float, Field(gt=0, le=86_400)]
Names: TypeAlias = Annotated[tuple[Name, ...], Strict(False), Field(min_length=1, max_length=64)]


class Factor(CheckedTogether):
    """What is varied between stimuli: values of one or more keys, or whole patches by name."""

    levels: Annotated[tuple[Level, ...], Strict(False), Field(min_length=1, max_length=MAX_FACTOR_LEVELS)] | None = Field(
        default=None,
        description="Values of the keys at `at`, in their order from low to high; numbers are ordered by value.",
    )
    at: KeyPaths | None = Field(
        default=None,
        description="The keys that take the level, from the configuration's root: materials.wood.tap.frequency_hz. "
        "{place} stands for the place of the stimulus. A material's name at materials.NAME stands for its keys.",
    )
    variants: Annotated[dict[Name, Patch], Field(min_length=1, max_length=MAX_FACTOR_LEVELS)] | None = Field(
        default=None, description="Instead of levels: by the level's name what it changes in the configuration."
    )

    def cross_faults(self) -> list[str]:
        faults = one_of_two(self, "levels", "variants")
        if self.variants is not None and self.at is not None:
            faults.append("at belongs to levels; variants say themselves which keys they change")
        if self.levels is not None and self.at is None:
            faults.append("levels need at: the key or the keys that take them, as materials.wood.tap.frequency_hz")
        return faults

    @property
    def names(self) -> tuple[Scalar, ...]:
        """The levels, or the names of the variants, in their order."""
        return tuple(self.variants or ()) if self.levels is None else self.levels


class Condition(Model):
    """What holds for a part of the trials."""

    changes: Patch = Field(default={}, description="What it changes in the base configuration, as a merge patch.")


class ReplyAnswer(Model):
    """One of the answers to a question."""

    name: Name = Field(description="What stands in the data.")
    label: Label = Field(description="What the participant reads.")
    key: Annotated[str, StringConstraints(min_length=1, max_length=16)] | None = Field(
        default=None, description=f"A key of the keyboard: one character, or one of {', '.join(NAMED_KEYS)}."
    )
    means: Meaning | None = Field(
        default=None, description="Which stimulus it names, in the order of presentation, or that they are the same."
    )
    level: Level | None = Field(default=None, description="The level that it names, in an identification.")


class Asked(Model):
    """Which stimulus the question asks for."""

    factor: Name = Field(description="The factor, or the variable of a procedure, by which stimuli are compared.")
    which: Literal["highest", "lowest"] = Field(
        default="highest",
        description="The stimulus with the highest level or the lowest; texts rise in the factor's order.",
    )


class _QuestionKeys(Model):
    """What every question has."""

    text: Markdown = Field(description="What the participant reads.")


class ChoiceQuestion(_QuestionKeys):
    """One of several answers, by buttons or keys."""

    kind: Literal["choice"] = Field(description="Which kind of question this is.")
    answers: Annotated[tuple[ReplyAnswer, ...], Strict(False), Field(min_length=2, max_length=100)] = Field(
        description="The answers, in the order of their buttons."
    )
    asks: Asked | None = Field(default=None, description="By which the correct answer is found.")


class RankingQuestion(_QuestionKeys):
    """The stimuli put in order; the answer names the positions of presentation: second>first>third."""

    kind: Literal["ranking"] = Field(description="Which kind of question this is.")
    asks: Asked | None = Field(default=None, description="By which the correct order is found.")


class SliderQuestion(CheckedTogether):
    """A number between two ends, by a slider."""

    kind: Literal["slider"] = Field(description="Which kind of question this is.")
    text: Markdown = Field(description="What the participant reads.")
    low: float = Field(default=0.0, ge=-1e9, le=1e9, description="Value of the left end.")
    high: float = Field(default=100.0, ge=-1e9, le=1e9, description="Value of the right end.")
    step: Annotated[float, Field(gt=0, le=1e9)] | None = Field(default=None, description="Between two values.")
    low_label: Label | None = Field(default=None, description="What stands at the left end.")
    high_label: Label | None = Field(default=None, description="What stands at the right end.")

    def cross_faults(self) -> list[str]:
        faults = _rising(self.low, self.high)
        if not faults and self.step is not None and self.step > self.high - self.low:
            faults.append(f"step must be at most high minus low, {self.high - self.low:g}, is {self.step:g}")
        return faults


class NumberQuestion(CheckedTogether):
    """A number that is typed, as in magnitude estimation."""

    kind: Literal["number"] = Field(description="Which kind of question this is.")
    text: Markdown = Field(description="What the participant reads.")
    low: float = Field(default=0.0, ge=-1e9, le=1e9, description="The least that is taken.")
    high: float = Field(default=1e6, ge=-1e9, le=1e9, description="The most that is taken.")

    def cross_faults(self) -> list[str]:
        return _rising(self.low, self.high)


class TextQuestion(_QuestionKeys):
    """Free text."""

    kind: Literal["text"] = Field(description="Which kind of question this is.")
    most_characters: int = Field(default=1000, ge=1, le=100_000, description="The longest text that is taken.")


class MeasureQuestion(_QuestionKeys):
    """What is measured of the motion instead of an answer; `text` says what to do."""

    kind: Literal["measure"] = Field(description="Which kind of question this is.")
    measure: Measure = Field(description="What is measured.")


def _rising(low: float, high: float) -> list[str]:
    return [] if low < high else [f"low must be less than high, {high:g}, is {low:g}"]


Question: TypeAlias = (
    ChoiceQuestion | RankingQuestion | SliderQuestion | NumberQuestion | TextQuestion | MeasureQuestion
)
Method: TypeAlias = StaircaseParameters | QuestPlusParameters | ConstantStimuliParameters


class Variable(Model):
    """The key that an adaptive procedure varies."""

    name: Name = Field(description="What it is called in the data.")
    at: KeyPaths = Field(description="The keys that take its value, as a factor's.")
    reference: float = Field(ge=-1e9, le=1e9, description="Its value in the stimuli that the target is compared with.")
    level: Literal["value", "added", "factor"] = Field(
        default="value",
        description="What the procedure's level is: the value itself, what is added to the reference, or what the "
        "reference is multiplied by.",
    )


class Adaptive(Model):
    """An adaptive procedure: the next level follows from the answers before it."""

    variable: Variable = Field(description="What it varies.")
    method: Annotated[Method, Field(discriminator="kind")] = Field(description="The procedure and its parameters.")
    practice_level: float | None = Field(
        default=None, ge=-1e9, le=1e9, description="The level in practice and training trials."
    )

    @property
    def trials(self) -> int:
        """The most trials that it takes."""
        method = self.method
        if isinstance(method, ConstantStimuliParameters):
            return len(method.levels) * method.repetitions
        return method.trials

    @property
    def ends(self) -> tuple[float, float]:
        """The lowest and the highest level that it may show."""
        method = self.method
        if isinstance(method, StaircaseParameters):
            return method.least, method.most
        return min(method.levels), max(method.levels)


class ListedTrial(Model):
    """A trial written out."""

    stimuli: Annotated[tuple[dict[Name, Level], ...], Strict(False), Field(min_length=1, max_length=MAX_STIMULI_PER_TRIAL)] = (
        Field(description="Of each stimulus the level of every factor, in the order of presentation.")
    )
    condition: Name | None = Field(default=None, description="The condition that it belongs to; by default each.")
    correct: Name | None = Field(default=None, description="The correct answer, where the question does not tell.")
    repetitions: int = Field(default=1, ge=1, le=MAX_TRIALS, description="How often, for each repetition of all.")


class TrialDesign(Model):
    """What a trial is, and which ones there are."""

    type: TrialType = Field(description="What is done in it.")
    presentation: Presentation = Field(
        default="intervals", description="Stimuli side by side in one scene, or one after the other."
    )
    question: Name = Field(description="Name of the question.")
    cross: Names | None = Field(default=None, description="Factors; every combination of their levels is a stimulus.")
    list: Annotated[tuple[ListedTrial, ...], Strict(False), Field(min_length=1, max_length=MAX_TRIALS)] | None = Field(
        default=None, description="Instead of cross: the trials one by one."
    )
    procedures: Annotated[dict[Name, Adaptive], Field(min_length=1, max_length=64)] | None = Field(
        default=None, description="Adaptive procedures by name; their trials are interleaved."
    )
    alternatives: int | None = Field(
        default=None, ge=2, le=MAX_STIMULI_PER_TRIAL, description="Stimuli of a forced choice or a ranking."
    )
    reference: Annotated[dict[Name, Level], Field(min_length=1)] | None = Field(
        default=None, description="Levels of the stimuli that the target of a forced choice is shown among."
    )
    with_itself: bool = Field(default=False, description="Whether each stimulus is compared with itself, too.")
    both_orders: bool = Field(
        default=False,
        description="Whether each pair is shown in both orders; otherwise sides are balanced by the seed.",
    )
    measures: Annotated[tuple[Measure, ...], Strict(False), Field(max_length=8)] = Field(
        default=(), description="What is measured of the motion besides the answer."
    )
    expected_s: Seconds = Field(
        default=20.0, description="How long a trial will take with what is around it; for the estimate of `check`."
    )


class StudyOrder(Model):
    """In which order the trials of the test come."""

    kind: Literal["random", "blocked", "latin_square", "listed"] = Field(
        default="random",
        description="All mixed; blocks in random order; blocks by a Latin square over the participants; as written.",
    )
    by: Literal["condition", "repetition", "cell", "procedure"] | None = Field(
        default=None, description="What makes a block, of blocked and latin_square; by default the condition."
    )
    seed: int = Field(default=1, ge=0, le=2**32 - 1, description="The seed unless the session is given another.")


class Warmup(Model):
    """Trials before the test."""

    trials: int = Field(ge=1, le=1000, description="How many; every cell as often as any other, or once more.")
    instructions: Markdown | None = Field(default=None, description="What is shown before them.")
    feedback: bool = Field(default=True, description="Whether the participant is told what was correct or measured.")


class Breaks(Model):
    """When the participant rests."""

    every_trials: int | None = Field(
        default=None, ge=1, le=10_000, description="A break after so many trials of the test."
    )
    between_blocks: bool = Field(default=False, description="Whether there is one before each further block.")
    least_s: float = Field(default=0.0, ge=0, le=3600, description="How long a break is at least.")
    text: Markdown | None = Field(default=None, description="What is shown in it.")


class Stop(Model):
    """What ends the test before its last trial."""

    after_s: Seconds | None = Field(default=None, description="No trial begins so long after the first one.")
    wrong_in_a_row: int | None = Field(default=None, ge=1, le=10_000, description="So many wrong answers in a row.")


class ProportionEffect(Model):
    """A per cent of correct answers that is to be told from chance."""

    kind: Literal["proportion"] = Field(description="Which kind of effect this is.")
    correct: float = Field(gt=0, lt=1, description="Mean probability of a correct answer.")
    between: float = Field(
        default=0.0, ge=0, le=0.5, description="Standard deviation of that probability between participants."
    )
    participants: int = Field(ge=2, le=1000, description="How many take part.")
    significance: float = Field(default=0.05, gt=0, lt=0.5, description="Level of the test, two-sided.")


class DifferenceEffect(Model):
    """A difference of a measure between two conditions or cells."""

    kind: Literal["difference"] = Field(description="Which kind of effect this is.")
    mean: float = Field(ge=-1e9, le=1e9, description="Mean difference, in the measure's unit.")
    standard_deviation: float = Field(gt=0, le=1e9, description="Of the difference of two single trials.")
    between: float = Field(
        default=0.0, ge=0, le=1e9, description="Standard deviation of the true difference between participants."
    )
    participants: int = Field(ge=2, le=1000, description="How many take part.")
    significance: float = Field(default=0.05, gt=0, lt=0.5, description="Level of the test, two-sided.")


class StudyAnalysis(Model):
    """What the analysis is to know."""

    chance: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="Probability of a correct answer by guessing; by default there is no test against it.",
    )
    published: str | None = Field(
        default=None, description="Published results that ours are set beside: okamura1998.tapping."
    )
    effect: Annotated[ProportionEffect | DifferenceEffect, Field(discriminator="kind")] | None = Field(
        default=None, description="The effect that `check` finds the power for."
    )


class Study(Model):
    """A study, as its file says."""

    experiment: Literal[1] = Field(description="Version of this kind of document.")
    title: Label = Field(description="One line.")
    instructions: Markdown = Field(description="What the participant reads before the first trial.")
    base: Patch = Field(default={}, description="Scene and materials that every stimulus is made of; or a file's name.")
    places: Annotated[tuple[Name, ...], Strict(False), Field(max_length=MAX_STIMULI_PER_TRIAL)] = Field(
        default=(), description="Names that {place} stands for, from left to right."
    )
    factors: Annotated[dict[Name, Factor], Field(max_length=32)] = Field(default={}, description="What is varied.")
    conditions: Annotated[dict[Name, Condition], Field(min_length=1, max_length=64)] = Field(
        default={"all": Condition()}, description="Parts of the study by name; each has all trials."
    )
    trial: TrialDesign = Field(description="What a trial is.")
    repetitions: int = Field(default=1, ge=1, le=10_000, description="How often each trial comes.")
    order: StudyOrder = Field(default=StudyOrder(), description="In which order they come.")
    practice: Warmup | None = Field(default=None, description="Trials to get used to it, before all others.")
    training: Warmup | None = Field(default=None, description="Trials to learn the answers, before the test.")
    breaks: Breaks = Field(default=Breaks(), description="Rests.")
    time_limit_s: Seconds | None = Field(default=None, description="Time for a trial; then it ends without an answer.")
    questions: Annotated[
        dict[Name, Annotated[Question, Field(discriminator="kind")]], Field(min_length=1, max_length=64)
    ] = Field(description="Questions by name.")
    feedback: Literal["none", "correctness", "measure"] = Field(
        default="none", description="What the participant is told after a trial of the test."
    )
    stop: Stop = Field(default=Stop(), description="What ends the test early.")
    analysis: StudyAnalysis = Field(default=StudyAnalysis(), description="What the analysis is to know.")

    @property
    def asked(self) -> Question:
        """The question of its trials."""
        return self.questions[self.trial.question]

    def adaptive(self, procedure: str) -> Adaptive:
        """The procedure that a planned trial names: `rising`, or `rising.CONDITION.CELL` where each of these has a run
        of its own."""
        assert self.trial.procedures is not None
        return self.trial.procedures[procedure.partition(".")[0]]

    @property
    def may_end_early(self) -> bool:
        """Whether a session may need fewer trials than are planned: a procedure has found what it looks for, or the
        participant's wrong answers end it."""
        return self.trial.procedures is not None or self.stop.wrong_in_a_row is not None

    @property
    def stimuli_per_trial(self) -> int:
        """How many stimuli a trial presents."""
        match self.trial.type:
            case "paired_comparison":
                return 2
            case "forced_choice":
                return self.trial.alternatives or 2
            case "ranking":
                return self.trial.alternatives or len(self.places) or 2
            case _:
                return 1
