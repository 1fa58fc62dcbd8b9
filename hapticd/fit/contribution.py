"""What a fit gives to a material, as plain data, and the material that has it.

Between the two lies no fit and no recording: a contribution can be kept, and added to a material later.
"""

from __future__ import annotations

import datetime
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hapticd._version import __version__
from hapticd.base.errors import InvalidError, Problem
from hapticd.config.materials import MAX_REASON_CHARACTERS, MAX_REASONS, Material, validate_materials
from hapticd.fit.from_files import Fitted
from hapticd.fit.options import KEY_OF, STIFFNESS_N_PER_M
from hapticd.fit.recording import Kind, Recording
from hapticd.fit.result import estimates


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
    return Contribution(kind, _rounded(fitted.figures), _provenance(kind, fitted, recordings))


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
    origin = {**part.origin, "date": day.isoformat()}
    data = {
        **before,
        "stiffness_n_per_m": given,
        **part.figures,
        "provenance": _joined(part.kind, before.get("provenance"), origin),
    }
    try:
        made = validate_materials({name: data})[name]
    except InvalidError as error:
        problems = [
            Problem(problem.where, f"{problem.problem}: no material has what was found") for problem in error.problems
        ]
        raise InvalidError(problems) from None
    return Added(made, assumed, tuple(key for key in part.figures if key in before))


def _provenance(kind: Kind, fitted: Fitted, recordings: Sequence[Recording]) -> dict[str, object]:
    """But for the day: files, version of hapticd, intervals by kind and name, and the verdict.

    A figure whose interval has no end on one side is not among them, nor is what `fitted` is without.
    """
    fit = fitted.fit
    # A path as text, also where its bytes are none.
    files = {os.fsencode(each.source.path).decode(errors="backslashreplace"): each.source.sha256 for each in recordings}
    intervals = {
        f"{kind}.{name}": [_rounded(estimate.low), _rounded(estimate.high)]
        for name, estimate in estimates(fit).items()
        if name not in fitted.without and math.isfinite(estimate.low) and math.isfinite(estimate.high)
    }
    # Fits that choose between models say why.
    choices = {f"{kind}.{name}": why[:MAX_REASON_CHARACTERS] for name, why in getattr(fit, "choices", {}).items()}
    reasons = [reason[:MAX_REASON_CHARACTERS] for reason in fit.judged.reasons[:MAX_REASONS]]
    return {
        "files": [{"path": path, **({"sha256": sha256} if sha256 else {})} for path, sha256 in files.items()],
        "version": __version__,
        **({"intervals": intervals} if intervals else {}),
        "verdict": {kind: {"quality": fit.judged.quality, **({"reasons": reasons} if reasons else {})}},
        **({"choices": choices} if choices else {}),
    }


def _joined(kind: Kind, before: object, origin: Mapping[str, object]) -> dict[str, object]:
    """Two provenances as one: all files, and the intervals of what the material still has."""
    if not isinstance(before, Mapping):
        return dict(origin)
    replaced = [other for other, key in KEY_OF.items() if key == KEY_OF[kind]]
    files = origin["files"]
    assert isinstance(files, list)
    joined: dict[str, object] = {}
    for member in ("intervals", "verdict", "choices"):
        old, new = before.get(member, {}), origin.get(member, {})
        assert isinstance(new, Mapping)
        joined[member] = {name: each for name, each in old.items() if name.partition(".")[0] not in replaced} | {**new}
    kept = {member: each for member, each in joined.items() if each}
    return {**origin, "files": [*(file for file in before["files"] if file not in files), *files], **kept}


def _rounded(value: Any) -> Any:
    """With 7 digits; no recording has more. Poles near the unit circle are worth more."""
    if isinstance(value, float):
        return float(f"{value:.7g}")
    if isinstance(value, Mapping):
        return {key: inner if key == "coefficients" else _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(inner) for inner in value]
    return value
