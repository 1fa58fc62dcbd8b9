"""The materials of a batch, from its rows: each with what its fits found, ranked by verdict."""

from __future__ import annotations

import datetime
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Final

from hapticd.analysis.statistics import Estimate
from hapticd.base.errors import InvalidError
from hapticd.base.yaml_source import Json
from hapticd.config.materials import Material
from hapticd.fit.contribution import Contribution, added
from hapticd.fit.recording import Kind
from hapticd.sweeps.batches.batch import Batch, Quality
from hapticd.sweeps.batches.folder_yaml import FIT_YAML
from hapticd.sweeps.batches.tree import RecordingSet
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Row

QUALITY_ORDER: Final[tuple[Quality, ...]] = ("good", "fair", "poor", "refused")
MAX_REASONS_CHARACTERS: Final = 160
"""Characters of the reasons in a table."""


@dataclass(frozen=True, slots=True)
class FitResult:
    """What came of one fit."""

    asked: RecordingSet
    quality: Quality
    verdict: str
    """With its reasons; of a refused fit the reason alone."""
    reasons: tuple[str, ...]
    left_out: int
    contribution: Contribution | None
    """None: the fit was refused."""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    estimates: Mapping[str, Estimate] | None = None
    plain: Mapping[str, float] | None = None
    panels: Sequence[Any] = ()
    """Pictures, as plain data."""

    @property
    def kind(self) -> Kind:
        """Of the fit."""
        return self.asked.kind


@dataclass(frozen=True, slots=True)
class MaterialResult:
    """A material, of all of its fits that were not refused."""

    name: str
    quality: Quality
    """The worst of its fits'."""
    fits: tuple[FitResult, ...]
    material: Material | None
    """None: every fit was refused."""
    notes: tuple[str, ...]

    @property
    def reasons(self) -> list[str]:
        """Of all fits; each with its kind where there are several."""
        several = len(self.fits) > 1
        return [f"{fit.kind}: {reason}" if several else reason for fit in self.fits for reason in fit.reasons]

    @property
    def shown_reasons(self) -> str:
        """For a table: the beginning of them."""
        text = "; ".join(self.reasons)
        return text if len(text) <= MAX_REASONS_CHARACTERS else f"{text[:MAX_REASONS_CHARACTERS].rsplit(' ', 1)[0]} ..."


def ranked(batch: Batch, rows: Iterable[Row], day: datetime.date) -> list[MaterialResult]:
    """The best first; of equal verdicts those with fewer reasons first, then by name. `day` is that of the fits.

    A material whose point has no row yet is left out.
    """
    by_point = {row[POINT_COLUMN.name]: row for row in rows}
    found = [
        (asked, by_point[point])
        for index, asked in enumerate(batch.tree.sets)
        if (point := batch.point(index)) in by_point
    ]
    results = [
        _material(name, [_fit(asked, row) for asked, row in several], batch.tree.path, day)
        for name, several in groupby(found, lambda each: each[0].material)
    ]
    return sorted(results, key=lambda each: (QUALITY_ORDER.index(each.quality), len(each.reasons), each.name))


def _fit(asked: RecordingSet, row: Row) -> FitResult:
    error = row[ERROR_COLUMN.name]
    if error is not None:
        return FitResult(asked, "refused", str(error), (str(error),), 0, None)
    found: dict[str, Any] = json.loads(str(row["found"]))
    judged = found["origin"]["verdict"][asked.kind]
    left_out = row["left_out"]
    assert isinstance(left_out, int)
    return FitResult(
        asked,
        judged["quality"],
        str(row["verdict"]),
        tuple(judged.get("reasons", ())),
        left_out,
        Contribution(asked.kind, found["figures"], found["origin"]),
        tuple(found["notes"]),
        tuple(found["warnings"]),
        {name: Estimate(*map(_number, each)) for name, each in found["estimates"].items()},
        found["plain"],
        found["panels"],
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _material(name: str, fits: Sequence[FitResult], root: str, day: datetime.date) -> MaterialResult:
    """Adds the fits to one another in their order, as `hapticd fit --merge` does."""
    material: Material | None = None
    assumed: float | None = None
    notes: list[str] = []
    done: list[FitResult] = []
    for fit in fits:
        if fit.contribution is None:
            done.append(fit)
            continue
        part = Contribution(fit.kind, fit.contribution.figures, _with_folder(fit.contribution.origin, root))
        try:
            found = added(part, name, day, onto=material, stiffness_n_per_m=fit.asked.stiffness_n_per_m)
        except InvalidError as error:  # of the material as a whole: each fit alone was one
            done.append(FitResult(fit.asked, "refused", str(error), (str(error),), fit.left_out, None))
            continue
        material = found.material
        done.append(fit)
        notes += fit.notes
        # A puncture, which comes last, measures it.
        if fit.asked.stiffness_n_per_m is not None or "stiffness_n_per_m" in part.figures:
            assumed = None
        elif found.assumed_n_per_m is not None:
            assumed = found.assumed_n_per_m
    if assumed is not None:
        notes.append(
            f"the stiffness, {assumed:g} N/m, is not in the recordings; stiffness_n_per_m in {FIT_YAML} sets it"
        )
    worst = max((fit.quality for fit in done), key=QUALITY_ORDER.index)
    return MaterialResult(name, worst, tuple(done), material, tuple(notes))


def _with_folder(origin: Mapping[str, object], root: str) -> dict[str, object]:
    """A provenance whose files are named with the tree, as the user writes it."""
    files = origin["files"]
    assert isinstance(files, list)
    above = os.fsencode(root).decode(errors="backslashreplace")
    return {**origin, "files": [{**file, "path": os.path.join(above, file["path"])} for file in files]}


def counts(results: Iterable[MaterialResult]) -> dict[Quality, int]:
    """How many materials there are of each verdict."""
    found: dict[Quality, int] = dict.fromkeys(QUALITY_ORDER, 0)
    for each in results:
        found[each.quality] += 1
    return found


def result_dict(rank: int, result: MaterialResult, file: str | None) -> dict[str, Json]:
    """What --json says of a material; `file` is where it was written."""
    return {
        "rank": rank,
        "material": result.name,
        "quality": result.quality,
        "file": file,
        "notes": list(result.notes),
        "fits": [
            {
                "kind": fit.kind,
                "quality": fit.quality,
                "verdict": fit.verdict,
                "reasons": list(fit.reasons),
                "warnings": list(fit.warnings),
                "recordings": len(fit.asked.files),
                "left_out": fit.left_out,
                "figures": {
                    name: [_or_none(each.value), _or_none(each.low), _or_none(each.high)]
                    for name, each in (fit.estimates or {}).items()
                },
            }
            for fit in result.fits
        ],
    }


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
