"""Where the figures of a fitted material come from: recordings, intervals and verdict."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Collection, Mapping, Sequence
from typing import Final, Literal, Protocol, TypeAlias

from hapticd._version import __version__
from hapticd.analysis.statistics import Estimate
from hapticd.config.materials import MAX_REASON, MAX_REASONS
from hapticd.fit.exclusions import Exclusion
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
    def left_out(self) -> tuple[Exclusion, ...]: ...

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
    fit: Fit, recordings: Sequence[Recording], *, kind: Kind = "tap", without: Collection[str] = ()
) -> dict[str, object]:
    """`provenance` of a material but for the day: files, version of hapticd, intervals by kind and name, and the
    verdict.

    A figure whose interval has no end on one side is not among them, nor are those that are named in `without`.
    """
    files = {_text(recording.source.path): recording.source.sha256 for recording in recordings}
    intervals = {
        f"{kind}.{name}": [rounded(estimate.low), rounded(estimate.high)]
        for name, estimate in estimates(fit).items()
        if name not in without and math.isfinite(estimate.low) and math.isfinite(estimate.high)
    }
    # Fits that choose between models say why.
    choices = {f"{kind}.{name}": why[:MAX_REASON] for name, why in getattr(fit, "choices", {}).items()}
    return {
        "files": [{"path": path, **({"sha256": sha256} if sha256 else {})} for path, sha256 in files.items()],
        "version": __version__,
        **({"intervals": intervals} if intervals else {}),
        "verdict": {kind: _verdict(fit.judged)},
        **({"choices": choices} if choices else {}),
    }


def _verdict(judged: Verdict) -> dict[str, object]:
    reasons = [reason[:MAX_REASON] for reason in judged.reasons[:MAX_REASONS]]
    return {"quality": judged.quality, **({"reasons": reasons} if reasons else {})}


def _text(path: str) -> str:
    """A path as text, also where its bytes are none."""
    return os.fsencode(path).decode(errors="backslashreplace")


def rounded(value: float) -> float:
    """With the digits that a material has."""
    return float(f"{value:.{DIGITS}g}")
