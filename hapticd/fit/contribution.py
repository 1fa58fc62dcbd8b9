"""Contribution of a fit to a material: fitted keys and provenance as plain data, and their addition to the material.

A contribution needs neither the fit nor the recordings: it can be stored and added to a material later.
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
from hapticd.fit.options import MATERIAL_KEYS, STIFFNESS_N_PER_M
from hapticd.fit.recording import Kind, Recording
from hapticd.fit.result import estimates


@dataclass(frozen=True, slots=True)
class Contribution:
    """Keys and provenance that one fit contributes to a material."""

    kind: Kind
    figures: Mapping[str, object]
    """Keys of the material with their fitted values."""
    origin: Mapping[str, object]
    """Value of the material's key `provenance`, without the date."""


@dataclass(frozen=True, slots=True)
class Added:
    """A material to which a contribution was added."""

    material: Material
    assumed_n_per_m: float | None
    """The default stiffness, if neither the user nor a recording determined the stiffness, else None."""
    replaced: tuple[str, ...]
    """Keys of the material whose earlier values the contribution replaced."""


def contribution_of(kind: Kind, fitted: Fitted, recordings: Sequence[Recording]) -> Contribution:
    """Return the contribution of a fit, of these recordings, to a material."""
    return Contribution(kind, _rounded(fitted.figures), _provenance(kind, fitted, recordings))


def added(
    contribution: Contribution, name: str, day: datetime.date, *, onto: Material | None, stiffness_n_per_m: float | None
) -> Added:
    """Return the material `onto`, or a new material if `onto` is None, with this name and the contribution.

    `stiffness_n_per_m` is used if the fit does not determine the stiffness; None means the stiffness of `onto`, or
    STIFFNESS_N_PER_M for a new material. Raises InvalidError if a value is out of the range of a material.
    """
    given, assumed = stiffness_n_per_m, None
    if given is None:
        given = STIFFNESS_N_PER_M if onto is None else onto.stiffness_n_per_m
        assumed = given if onto is None and "stiffness_n_per_m" not in contribution.figures else None
    before = {} if onto is None else onto.to_dict()
    origin = {**contribution.origin, "date": day.isoformat()}
    data = {
        **before,
        "stiffness_n_per_m": given,
        **contribution.figures,
        "provenance": _joined(contribution.kind, before.get("provenance"), origin),
    }
    try:
        made = validate_materials({name: data})[name]
    except InvalidError as error:
        problems = [
            Problem(problem.where, f"{problem.problem}: the fitted value is out of the range of a material")
            for problem in error.problems
        ]
        raise InvalidError(problems) from None
    return Added(made, assumed, tuple(key for key in contribution.figures if key in before))


def _provenance(kind: Kind, fitted: Fitted, recordings: Sequence[Recording]) -> dict[str, object]:
    """Return the provenance of a fitted material, without the date.

    Intervals that are infinite, or whose name is in `fitted.without`, are left out.
    """
    fit = fitted.fit
    # Bytes of a path that are not text are escaped.
    files = {os.fsencode(each.source.path).decode(errors="backslashreplace"): each.source.sha256 for each in recordings}
    intervals = {
        f"{kind}.{name}": [_rounded(estimate.low), _rounded(estimate.high)]
        for name, estimate in estimates(fit).items()
        if name not in fitted.without and math.isfinite(estimate.low) and math.isfinite(estimate.high)
    }
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
    """Return the provenance `before` merged with `origin`, that of a new fit, without entries of replaced fits."""
    if not isinstance(before, Mapping):
        return dict(origin)
    replaced = [other for other, key in MATERIAL_KEYS.items() if key == MATERIAL_KEYS[kind]]
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
    """Return plain data with floats rounded to 7 digits, the resolution of recordings, except filter coefficients."""
    if isinstance(value, float):
        return float(f"{value:.7g}")
    if isinstance(value, Mapping):
        return {key: inner if key == "coefficients" else _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(inner) for inner in value]
    return value
