"""Where the figures of a fitted material come from, and the material as the loader takes it."""

from __future__ import annotations

import dataclasses
import datetime
import math
import os
from collections.abc import Collection, Mapping, Sequence
from typing import Final, Literal, Protocol, TypeAlias

from hapticd._version import __version__
from hapticd.analysis.statistics import Estimate
from hapticd.base.errors import InvalidError, Problem
from hapticd.config.materials import MAX_REASON, MAX_REASONS, Material, validate_materials
from hapticd.fit.exclusions import Left
from hapticd.fit.recording import Recording
from hapticd.fit.verdict import Verdict

Kind: TypeAlias = Literal["tap", "grooves", "texture", "puncture"]
KEY_OF: Final[Mapping[Kind, str]] = {
    "tap": "tap",
    "grooves": "texture",
    "texture": "texture",
    "puncture": "rupture",
}
"""What of a material each kind of fit makes; of two that make the same only the later stays."""
DIGITS: Final = 7
"""Of the figures in a material; no recording has more."""


class Fit(Protocol):
    """What every fit gives: a frozen dataclass whose figures are Estimates."""

    @property
    def warnings(self) -> tuple[str, ...]: ...

    @property
    def verdict(self) -> str: ...

    @property
    def judged(self) -> Verdict: ...

    @property
    def left_out(self) -> tuple[Left, ...]: ...

    def material(self) -> Mapping[str, object]: ...

    def to_dict(self) -> Mapping[str, object]: ...


def estimates(fit: Fit) -> dict[str, Estimate]:
    """The figures of a fit that have an interval, by name; those of a part of it as `part.name`."""
    found: dict[str, Estimate] = {}
    for name, value in _fields(fit).items():
        if isinstance(value, Estimate):
            found[name] = value
        elif dataclasses.is_dataclass(value):
            parts = _fields(value).items()
            found |= {f"{name}.{part}": inner for part, inner in parts if isinstance(inner, Estimate)}
    return found


def _fields(made: object) -> dict[str, object]:
    assert dataclasses.is_dataclass(made)
    return {field.name: getattr(made, field.name) for field in dataclasses.fields(made)}


def plain_figures(fit: Fit) -> dict[str, float]:
    """The figures of a fit that have no interval, by name."""
    return {name: value for name, value in _fields(fit).items() if isinstance(value, float) and math.isfinite(value)}


def provenance(
    fit: Fit, recordings: Sequence[Recording], day: datetime.date, *, kind: Kind = "tap", without: Collection[str] = ()
) -> dict[str, object]:
    """`provenance` of a material: files, day, version of hapticd, intervals by kind and name, and the verdict.

    A figure whose interval has no end on one side is not among them, nor are those that are named in `without`.
    """
    files = {_text(recording.source.path): recording.source.sha256 for recording in recordings}
    intervals = {
        f"{kind}.{name}": [_rounded(estimate.low), _rounded(estimate.high)]
        for name, estimate in estimates(fit).items()
        if name not in without and math.isfinite(estimate.low) and math.isfinite(estimate.high)
    }
    # Fits that choose between models say why.
    choices = {f"{kind}.{name}": why[:MAX_REASON] for name, why in getattr(fit, "choices", {}).items()}
    return {
        "files": [{"path": path, **({"sha256": sha256} if sha256 else {})} for path, sha256 in files.items()],
        "date": day.isoformat(),
        "version": __version__,
        **({"intervals": intervals} if intervals else {}),
        "verdict": {kind: _verdict(fit.judged)},
        **({"choices": choices} if choices else {}),
    }


def _verdict(judged: Verdict) -> dict[str, object]:
    reasons = [reason[:MAX_REASON] for reason in judged.reasons[:MAX_REASONS]]
    return {"quality": judged.quality, **({"reasons": reasons} if reasons else {})}


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
    before = {} if onto is None else onto.to_dict()
    origin = provenance(fit, recordings, day, kind=kind, without=without)
    data = {
        **before,
        "stiffness_n_per_m": stiffness_n_per_m,
        **_rounded_all(figures),
        "provenance": _joined(kind, before.get("provenance"), origin),
    }
    try:
        return validate_materials({name: data})[name]
    except InvalidError as error:
        told = [
            Problem(problem.where, f"{problem.problem}: no material has what was found") for problem in error.problems
        ]
        raise InvalidError(told) from None


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


def _text(path: str) -> str:
    """A path as text, also where its bytes are none."""
    return os.fsencode(path).decode(errors="backslashreplace")


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _rounded_all(value: Mapping[str, object]) -> dict[str, object]:
    # Poles near the unit circle are worth more digits.
    return {key: inner if key == "coefficients" else _rounded_any(inner) for key, inner in value.items()}


def _rounded_any(value: object) -> object:
    if isinstance(value, float):
        return _rounded(value)
    if isinstance(value, Mapping):
        return _rounded_all(value)
    if isinstance(value, list | tuple):
        return [_rounded_any(inner) for inner in value]
    return value
