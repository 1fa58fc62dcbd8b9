"""The keys of a sweep's YAML file, each with its range.

Faults between keys that need the base configuration are found by hapticd.sweeps.study, where the place of each is
known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Field, PlainValidator, Strict, StringConstraints

from hapticd.base.errors import shown
from hapticd.base.model import CheckedTogether, Model, Name
from hapticd.base.yaml_source import Json
from hapticd.experiment.plain_values import PlainMapping, PlainScalar, mapping_of
from hapticd.sweeps.figure_keys import SweepFigure, Words

Combine: TypeAlias = Literal["crossed", "zipped", "latin_hypercube", "random"]
Run: TypeAlias = Literal["simulate", "render", "none"]
Spacing: TypeAlias = Literal["linear", "logarithmic"]

MAX_SWEEP_POINTS: Final = 10_000_000
MAX_SCAN_STEPS: Final = 10_000
DRAWING_COMBINES: Final = ("latin_hypercube", "random")


def _name_or_mapping(value: object) -> str | dict[str, Json]:
    if not isinstance(value, str | dict):
        raise ValueError(f"must be a name or a mapping, is {shown(value)}")
    return value if isinstance(value, str) else mapping_of(value)


def _as_axis(value: object) -> object:
    return {"values": value} if isinstance(value, list | tuple) else value


KeyPath: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=512)]
Number: TypeAlias = Annotated[float, Field(ge=-1e15, le=1e15)]
if TYPE_CHECKING:
    Measured: TypeAlias = "str | dict[str, Json]"
else:  # pydantic cannot make a schema of Json, which holds itself
    Measured = Annotated[object, PlainValidator(_name_or_mapping)]


class SweepAxis(CheckedTogether):
    """The values of one key: a list, a range, a distribution, or named levels that each set several keys."""

    values: (
        Annotated[tuple[PlainScalar, ...], Strict(False), Field(min_length=1, max_length=MAX_SWEEP_POINTS)] | None
    ) = Field(default=None, description="The values themselves; a list in the place of the axis is the same.")
    low: Number | None = Field(default=None, description="First value of a range, or the lowest that is drawn.")
    high: Number | None = Field(default=None, description="Last value of a range, or the highest that is drawn.")
    spacing: Spacing = Field(default="linear", description="Equal steps or equal ratios; of a draw: its distribution.")
    count: Annotated[int, Field(ge=1, le=MAX_SWEEP_POINTS)] | None = Field(
        default=None, description="How many values of the range, its ends included."
    )
    draws: Annotated[int, Field(ge=1, le=MAX_SWEEP_POINTS)] | None = Field(
        default=None, description="How many values are drawn at random, instead of `count`."
    )
    mean: Number | None = Field(default=None, description="Of a normal distribution, with `standard_deviation`.")
    standard_deviation: Annotated[float, Field(gt=0, le=1e15)] | None = Field(
        default=None, description="Of a normal distribution."
    )
    levels: Annotated[dict[Name, PlainMapping], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="By name: the keys that the level sets, with their values."
    )

    @property
    def is_range(self) -> bool:
        """Between `low` and `high`."""
        return self.low is not None or self.high is not None

    @property
    def is_normal(self) -> bool:
        """Drawn about a mean."""
        return self.mean is not None or self.standard_deviation is not None

    def cross_faults(self) -> list[str]:
        given = [self.values is not None, self.is_range, self.is_normal, self.levels is not None]
        if sum(given) != 1:
            return ["needs one of: values (a list), low and high, mean and standard_deviation, levels"]
        faults = []
        if self.is_range and (self.low is None or self.high is None):
            faults.append("low and high belong together")
        if self.is_normal and (self.mean is None or self.standard_deviation is None):
            faults.append("mean and standard_deviation belong together")
        if not self.is_range and self.count is not None:
            faults.append("count belongs to low and high")
        if not (self.is_range or self.is_normal) and self.draws is not None:
            faults.append("draws belongs to low and high, or to mean and standard_deviation")
        if self.count is not None and self.draws is not None:
            faults.append("count and draws do not go together: count is of equal steps, draws of random values")
        if not self.is_range and self.spacing != "linear":
            faults.append("spacing belongs to low and high")
        if self.spacing == "logarithmic" and min(self.low or 0.0, self.high or 0.0) <= 0:
            faults.append("a logarithmic range needs low and high above 0")
        return faults


class SweepCondition(Model):
    """A limit of a measured column."""

    column: KeyPath = Field(description="A measured column.")
    at_most: Number | None = Field(default=None, description="Holds where the column is not above this.")
    at_least: Number | None = Field(default=None, description="Holds where the column is not below this.")


class SweepRefine(CheckedTogether):
    """The boundary along one key at which a condition ceases to hold, found by bisection at every point."""

    key: KeyPath = Field(description="The key that is searched along; it is not varied besides.")
    start: Number = Field(description="Value at which the condition holds.")
    end: Number = Field(description="Value at which it is expected not to hold, above or below `start`.")
    spacing: Spacing = Field(default="logarithmic", description="Whether steps are equal ratios or differences.")
    holds: Annotated[str | SweepCondition, Field(union_mode="left_to_right")] = Field(
        description="A column of true and false, or a limit: {column, at_most} or {column, at_least}."
    )
    within: Annotated[float, Field(gt=0, le=1e6)] = Field(
        default=1e-3,
        description="Width of what is left: relative to the value if logarithmic, else in the key's unit.",
    )
    scan: Annotated[int, Field(ge=1, le=MAX_SCAN_STEPS)] = Field(
        default=1,
        description="So many steps from `start` to `end` are tried in turn until one does not hold; 1: only `end`. For "
        "conditions that hold again beyond their first boundary.",
    )

    def cross_faults(self) -> list[str]:
        if self.start == self.end:
            return ["start and end must differ"]
        if self.spacing == "logarithmic" and (self.start <= 0 or self.end <= 0):
            return ["logarithmic steps need start and end above 0"]
        return []


class SweepStudy(CheckedTogether):
    """A sweep: what stays, what is varied, and what is measured."""

    title: Annotated[str, StringConstraints(min_length=1, max_length=200)] = Field(
        default="A sweep", description="What the study is called in tables and figures."
    )
    base: PlainMapping = Field(
        default={},
        description="What all points share: a configuration (servo, device, materials, scene); or the name of a file "
        "or of a shipped scene.",
    )
    operator: PlainMapping | None = Field(
        default=None, description="What the hand does, or the name of a file or of a shipped operator."
    )
    run: Run | None = Field(
        default=None,
        description="What of each point is run: the closed loop, the open loop along the operator's way, or nothing; "
        "by default the closed loop where there is an operator.",
    )
    duration_s: Annotated[float, Field(gt=0, le=3600)] | None = Field(
        default=None, description="How long is run; by default as long as the operator's way."
    )
    vary: dict[KeyPath, Annotated[SweepAxis, BeforeValidator(_as_axis)]] = Field(
        default={},
        max_length=64,
        description="By key (servo.rate_hz, materials.wood.stiffness_n_per_m, operator.gesture.speed_m_per_s, "
        "parameters.ANY), or by any name for levels: its values.",
    )
    combine: Combine = Field(
        default="crossed",
        description="All combinations, the n-th value of all keys together, or `count` points drawn at random, "
        "independently or as a Latin hypercube.",
    )
    count: Annotated[int, Field(ge=1, le=MAX_SWEEP_POINTS)] | None = Field(
        default=None, description="How many points are drawn, of latin_hypercube and random."
    )
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(default=0, description="Of everything that is drawn.")
    parameters: PlainMapping = Field(
        default={}, description="Values that no configuration has; they tell points apart."
    )
    measure: Annotated[tuple[Measured, ...], Strict(False), Field(min_length=1, max_length=64)] = Field(
        description="What is measured at each point: names, or {name: options}."
    )
    refine: SweepRefine | None = Field(default=None, description="The search for a boundary along one more key.")
    labels: Annotated[dict[KeyPath, Words], Field(max_length=256)] = Field(
        default={}, description="By column: what figures and their page call it, without the unit."
    )
    figures: Annotated[tuple[SweepFigure, ...], Strict(False), Field(max_length=32)] | None = Field(
        default=None, description="What `hapticd sweep show` draws; by default what suits the study."
    )

    def cross_faults(self) -> list[str]:
        drawn = self.combine in DRAWING_COMBINES
        faults = []
        if drawn and self.count is None:
            faults.append(f"combine: {self.combine} needs count, the number of points")
        if not drawn and self.count is not None:
            faults.append("count belongs to combine: latin_hypercube or random; of a range it stands in the axis")
        for name, axis in self.vary.items():
            if axis.is_range or axis.is_normal:
                counted = axis.count is not None or axis.draws is not None
                if drawn and counted:
                    faults.append(f"vary.{name}: with combine: {self.combine} the study's count is all: leave it out")
                if not drawn and not counted:
                    wanted = "draws" if axis.is_normal else "count or draws"
                    faults.append(f"vary.{name}: needs {wanted}, the number of its values")
        if self.run in ("simulate", "render") and self.operator is None:
            faults.append(f"run: {self.run} needs an operator, what the hand does")
        if self.refine is not None and self.refine.key in self.vary:
            faults.append(f"refine.key is varied, too: take {self.refine.key} out of vary")
        return faults
