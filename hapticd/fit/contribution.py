"""What a fit gives to a material, as plain data, and the material that has it.

Between the two lies no fit and no recording: a contribution can be kept, and added to a material later.
"""

from __future__ import annotations

import datetime
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from hapticd.base.errors import InvalidError, Problem
from hapticd.config.materials import Material, validate_materials
from hapticd.fit.assumptions import STIFFNESS_N_PER_M
from hapticd.fit.from_files import Fitted
from hapticd.fit.provenance import KEY_OF, Fit, Kind, provenance, rounded
from hapticd.fit.recording import Recording


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one fit gives to a material."""

    kind: Kind
    figures: Mapping[str, object]
    """Members of the material."""
    origin: Mapping[str, object]
    """Its `provenance`, but for the day."""


@dataclass(frozen=True, slots=True)
class Added:
    """A material with a contribution."""

    material: Material
    assumed_n_per_m: float | None
    """The stiffness, if nobody said it and no recording."""
    replaced: tuple[str, ...]
    """Members that the material had before."""


def contribution_of(kind: Kind, fitted: Fitted, recordings: Sequence[Recording]) -> Contribution:
    """What a fit of these recordings gives."""
    return _contribution(kind, fitted.fit, fitted.figures, recordings, fitted.without)


def added(
    part: Contribution, name: str, day: datetime.date, *, onto: Material | None, stiffness_n_per_m: float | None
) -> Added:
    """The material of this name with a contribution. Everything else of `onto` is kept.

    `stiffness_n_per_m` is taken if the fit does not determine it; None: that of `onto`, or STIFFNESS_N_PER_M. Raises
    InvalidError where a figure lies beyond what a material may have.
    """
    given, assumed = stiffness_n_per_m, None
    if given is None:
        given = STIFFNESS_N_PER_M if onto is None else onto.stiffness_n_per_m
        assumed = given if onto is None and "stiffness_n_per_m" not in part.figures else None
    before = {} if onto is None else onto.to_dict()
    replaced = tuple(key for key in part.figures if key in before)
    return Added(_with(part, name, given, day, onto), assumed, replaced)


def material(
    fit: Fit,
    figures: Mapping[str, object],
    recordings: Sequence[Recording],
    name: str,
    stiffness_n_per_m: float,
    day: datetime.date,
    *,
    kind: Kind = "tap",
    onto: Material | None = None,
    without: Collection[str] = (),
) -> Material:
    """The fitted material. `figures` are what the fit's `material` gives; `stiffness_n_per_m` is for a fit that says
    nothing of it; `onto` is a material of which everything else is kept; `without` as of `provenance`.

    Raises InvalidError where a figure lies beyond what a material may have.
    """
    return _with(_contribution(kind, fit, figures, recordings, without), name, stiffness_n_per_m, day, onto)


def _contribution(
    kind: Kind, fit: Fit, figures: Mapping[str, object], recordings: Sequence[Recording], without: Collection[str]
) -> Contribution:
    return Contribution(kind, _rounded_all(figures), provenance(fit, recordings, kind=kind, without=without))


def _with(
    part: Contribution, name: str, stiffness_n_per_m: float, day: datetime.date, onto: Material | None
) -> Material:
    before = {} if onto is None else onto.to_dict()
    origin = {**part.origin, "date": day.isoformat()}
    data = {
        **before,
        "stiffness_n_per_m": stiffness_n_per_m,
        **part.figures,
        "provenance": _joined(part.kind, before.get("provenance"), origin),
    }
    try:
        return validate_materials({name: data})[name]
    except InvalidError as error:
        problems = [
            Problem(problem.where, f"{problem.problem}: no material has what was found") for problem in error.problems
        ]
        raise InvalidError(problems) from None


def _joined(kind: Kind, before: object, origin: Mapping[str, object]) -> dict[str, object]:
    """Two provenances as one: all files, and the intervals of what the material still has."""
    if not isinstance(before, Mapping):
        return dict(origin)
    files, intervals, verdict = origin["files"], origin.get("intervals", {}), origin["verdict"]
    assert isinstance(files, list)
    assert isinstance(intervals, Mapping)
    assert isinstance(verdict, Mapping)
    replaced = tuple(other for other, key in KEY_OF.items() if key == KEY_OF[kind])
    kept = {name: ends for name, ends in before.get("intervals", {}).items() if name.partition(".")[0] not in replaced}
    chosen = origin.get("choices", {})
    assert isinstance(chosen, Mapping)
    choices = {name: why for name, why in before.get("choices", {}).items() if name.partition(".")[0] not in replaced}
    choices |= chosen
    judged = {other: each for other, each in before.get("verdict", {}).items() if other not in replaced}
    return {
        **origin,
        "files": [*(file for file in before["files"] if file not in files), *files],
        **({"intervals": {**kept, **intervals}} if kept or intervals else {}),
        "verdict": {**judged, **verdict},
        **({"choices": choices} if choices else {}),
    }


def _rounded_all(value: Mapping[str, object]) -> dict[str, object]:
    # Poles near the unit circle are worth more digits.
    return {key: inner if key == "coefficients" else _rounded_any(inner) for key, inner in value.items()}


def _rounded_any(value: object) -> object:
    if isinstance(value, float):
        return rounded(value)
    if isinstance(value, Mapping):
        return _rounded_all(value)
    if isinstance(value, list | tuple):
        return [_rounded_any(inner) for inner in value]
    return value
