"""The keys of the YAML file of a sweep, each with its range.

hapticd.sweeps.study validates them together with the base configuration, and reports faults with their lines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Field, PlainValidator, Strict, StringConstraints

from hapticd.base.errors import shown
from hapticd.base.model import CheckedTogether, Model, Name
from hapticd.base.yaml_source import Json
from hapticd.experiment.plain_values import KeyPath, PlainMapping, PlainScalar, mapping_of
from hapticd.sweeps.figure_keys import SweepFigure, Words

Combine: TypeAlias = Literal["crossed", "zipped", "latin_hypercube", "random"]
Run: TypeAlias = Literal["simulate", "render", "none"]
Spacing: TypeAlias = Literal["linear", "logarithmic"]

MAX_SWEEP_POINTS: Final = 10_000_000
"""Maximum number of points of a study: their identities and indices take 240 MB."""
MAX_SCAN_STEPS: Final = 10_000
DRAWING_COMBINES: Final = ("latin_hypercube", "random")
"""The values of `combine` that draw points at random."""


def _name_or_mapping(value: object) -> str | dict[str, Json]:
    if not isinstance(value, str | dict):
        raise ValueError(f"must be a name or a mapping, is {shown(value)}")
    return value if isinstance(value, str) else mapping_of(value)


def _as_axis(value: object) -> object:
    return {"values": value} if isinstance(value, list | tuple) else value


Number: TypeAlias = Annotated[float, Field(ge=-1e15, le=1e15)]
if TYPE_CHECKING:
    Measured: TypeAlias = "str | dict[str, Json]"
else:  # pydantic cannot make a schema of Json, which is recursive
    Measured = Annotated[object, PlainValidator(_name_or_mapping)]


class SweepAxis(CheckedTogether):
    """The values of one key: a list, a range, a distribution, or named levels that each set several keys."""

    values: (
        Annotated[tuple[PlainScalar, ...], Strict(False), Field(min_length=1, max_length=MAX_SWEEP_POINTS)] | None
    ) = Field(default=None, description="The values as a list; the axis may also be this list itself.")
    low: Number | None = Field(default=None, description="First value of a range, or the lower limit of random values.")
    high: Number | None = Field(default=None, description="Last value of a range, or the upper limit of random values.")
    spacing: Spacing = Field(
        default="linear", description="Equal steps or equal ratios; for random values, uniform or log-uniform."
    )
    count: Annotated[int, Field(ge=1, le=MAX_SWEEP_POINTS)] | None = Field(
        default=None, description="Number of values of the range, including its ends."
    )
    draws: Annotated[int, Field(ge=1, le=MAX_SWEEP_POINTS)] | None = Field(
        default=None, description="Number of random values, instead of `count`."
    )
    mean: Number | None = Field(default=None, description="Mean of a normal distribution; needs `standard_deviation`.")
    standard_deviation: Annotated[float, Field(gt=0, le=1e15)] | None = Field(
        default=None, description="Standard deviation of a normal distribution; needs `mean`."
    )
    levels: Annotated[dict[Name, PlainMapping], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="Named levels: for each name, the keys that the level sets, with their values."
    )

    @property
    def is_range(self) -> bool:
        """Whether the axis has `low` or `high`."""
        return self.low is not None or self.high is not None

    @property
    def is_normal(self) -> bool:
        """Whether the axis has `mean` or `standard_deviation`."""
        return self.mean is not None or self.standard_deviation is not None

    def cross_faults(self) -> list[str]:
        """Return the faults that concern several keys of the axis together."""
        given = [self.values is not None, self.is_range, self.is_normal, self.levels is not None]
        if sum(given) != 1:
            return ["needs one of: values (a list), low and high, mean and standard_deviation, levels"]
        faults = []
        if self.is_range and (self.low is None or self.high is None):
            faults.append("low and high must be given together")
        if self.is_normal and (self.mean is None or self.standard_deviation is None):
            faults.append("mean and standard_deviation must be given together")
        if not self.is_range and self.count is not None:
            faults.append("count needs low and high")
        if not (self.is_range or self.is_normal) and self.draws is not None:
            faults.append("draws needs low and high, or mean and standard_deviation")
        if self.count is not None and self.draws is not None:
            faults.append("count and draws exclude one another: count is for equal steps, draws for random values")
        if not self.is_range and self.spacing != "linear":
            faults.append("spacing needs low and high")
        if self.spacing == "logarithmic" and min(self.low or 0.0, self.high or 0.0) <= 0:
            faults.append("low and high of a logarithmic range must be above 0")
        return faults


class SweepCondition(Model):
    """A condition on a measured column: its value is at most, or at least, a limit."""

    column: KeyPath = Field(description="A measured column.")
    at_most: Number | None = Field(
        default=None, description="The condition holds if the column is not above this value."
    )
    at_least: Number | None = Field(
        default=None, description="The condition holds if the column is not below this value."
    )


class SweepRefine(CheckedTogether):
    """At every point, a search by bisection for the value of one key at which a condition ceases to hold."""

    key: KeyPath = Field(description="The key whose value is searched; it must not be in `vary`.")
    start: Number = Field(description="Value at which the condition holds.")
    end: Number = Field(description="Value at which the condition is expected to fail, above or below `start`.")
    spacing: Spacing = Field(default="logarithmic", description="Whether steps are equal ratios or differences.")
    holds: Annotated[str | SweepCondition, Field(union_mode="left_to_right")] = Field(
        description="A column of true and false, or a limit: {column, at_most} or {column, at_least}."
    )
    within: Annotated[float, Field(gt=0, le=1e6)] = Field(
        default=1e-3,
        description="Width that ends the search: relative to the value if logarithmic, else in the key's unit.",
    )
    scan: Annotated[int, Field(ge=1, le=MAX_SCAN_STEPS)] = Field(
        default=1,
        description="Number of steps from `start` to `end` that are tried in turn until the condition fails; 1 tries "
        "only `end`. For conditions that hold again beyond their first boundary.",
    )

    def cross_faults(self) -> list[str]:
        """Return the faults that concern several keys of `refine` together."""
        if self.start == self.end:
            return ["start and end must differ"]
        if self.spacing == "logarithmic" and (self.start <= 0 or self.end <= 0):
            return ["start and end must be above 0 with logarithmic spacing"]
        return []


class SweepStudy(CheckedTogether):
    """A sweep: the base configuration, the varied keys, and the measures."""

    title: Annotated[str, StringConstraints(min_length=1, max_length=200)] = Field(
        default="A sweep", description="Title of the study in tables and figures."
    )
    base: PlainMapping = Field(
        default={},
        description="What all points share: a configuration (servo, device, materials, scene), or the name of a file "
        "or of a shipped scene.",
    )
    operator: PlainMapping | None = Field(
        default=None, description="The motion of the hand, or the name of a file or of a shipped operator."
    )
    run: Run | None = Field(
        default=None,
        description="`simulate`: the closed loop; `render`: the open loop along the operator's path; `none`: no run. "
        "By default `simulate` if there is an operator, otherwise `none`.",
    )
    duration_s: Annotated[float, Field(gt=0, le=3600)] | None = Field(
        default=None, description="Duration of a run; by default that of the operator's path."
    )
    vary: dict[KeyPath, Annotated[SweepAxis, BeforeValidator(_as_axis)]] = Field(
        default={},
        max_length=64,
        description="The values of each varied key (servo.rate_hz, materials.wood.stiffness_n_per_m, "
        "operator.gesture.speed_m_per_s, parameters.ANY), or of named levels under any name.",
    )
    combine: Combine = Field(
        default="crossed",
        description="All combinations, the n-th value of all keys together, or `count` points drawn at random, "
        "independently or as a Latin hypercube.",
    )
    count: Annotated[int, Field(ge=1, le=MAX_SWEEP_POINTS)] | None = Field(
        default=None, description="Number of points with `combine: latin_hypercube` or `random`."
    )
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(default=0, description="Seed of all random values.")
    parameters: PlainMapping = Field(
        default={}, description="Free parameters, which no configuration has and only functions read."
    )
    measure: Annotated[tuple[Measured, ...], Strict(False), Field(min_length=1, max_length=64)] = Field(
        description="The measures of each point, by name or as {name: options}."
    )
    refine: SweepRefine | None = Field(default=None, description="The search for a boundary along one more key.")
    labels: Annotated[dict[KeyPath, Words], Field(max_length=256)] = Field(
        default={}, description="Labels of columns in figures and on their page, without the unit."
    )
    figures: Annotated[tuple[SweepFigure, ...], Strict(False), Field(max_length=32)] | None = Field(
        default=None, description="Figures of `hapticd sweep show`; by default they are chosen from the columns."
    )

    def cross_faults(self) -> list[str]:
        """Return the faults that concern several keys of the study together."""
        drawn = self.combine in DRAWING_COMBINES
        faults = []
        if drawn and self.count is None:
            faults.append(f"combine: {self.combine} needs count, the number of points")
        if not drawn and self.count is not None:
            faults.append("count needs combine: latin_hypercube or random; the count of a range belongs to its axis")
        for name, axis in self.vary.items():
            if axis.is_range or axis.is_normal:
                counted = axis.count is not None or axis.draws is not None
                if drawn and counted:
                    faults.append(f"vary.{name}: must not have count or draws with combine: {self.combine}")
                if not drawn and not counted:
                    wanted = "draws" if axis.is_normal else "count or draws"
                    faults.append(f"vary.{name}: needs {wanted}, the number of its values")
        if self.run in ("simulate", "render") and self.operator is None:
            faults.append(f"run: {self.run} needs an operator")
        if self.refine is not None and self.refine.key in self.vary:
            faults.append(f"refine.key: {self.refine.key} must not be in vary, too")
        return faults
