"""The materials of a batch, made from its rows, and their ranking by verdict."""

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
"""Verdicts from best to worst."""
MAX_REASONS_CHARACTERS: Final = 160
"""Length at which the reasons of a verdict are cut in a table."""


@dataclass(frozen=True, slots=True)
class FitResult:
    """The result of one fit."""

    recordings: RecordingSet
    quality: Quality
    verdict: str
    """The verdict with its reasons; for a refused fit, the reason of the refusal."""
    reasons: tuple[str, ...]
    left_out: int
    """Number of recordings that were not used."""
    contribution: Contribution | None
    """The keys that the fit sets in its material; None if the fit was refused."""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    estimates: Mapping[str, Estimate] | None = None
    plain: Mapping[str, float] | None = None
    panels: Sequence[Any] = ()
    """Plots, as JSON data."""

    @property
    def kind(self) -> Kind:
        """Kind of the fit."""
        return self.recordings.kind


@dataclass(frozen=True, slots=True)
class MaterialResult:
    """A material with the results of its fits."""

    name: str
    quality: Quality
    """The worst verdict on a fit of the material."""
    fits: tuple[FitResult, ...]
    material: Material | None
    """The material from all fits that were not refused; None if every fit was refused."""
    notes: tuple[str, ...]

    @property
    def reasons(self) -> list[str]:
        """The reasons of the verdicts on all fits, each with the kind of its fit if there are several fits."""
        several = len(self.fits) > 1
        return [f"{fit.kind}: {reason}" if several else reason for fit in self.fits for reason in fit.reasons]

    @property
    def shown_reasons(self) -> str:
        """The reasons of the verdicts as one text for a table, cut at MAX_REASONS_CHARACTERS."""
        text = "; ".join(self.reasons)
        return text if len(text) <= MAX_REASONS_CHARACTERS else f"{text[:MAX_REASONS_CHARACTERS].rsplit(' ', 1)[0]} ..."


def ranked(batch: Batch, rows: Iterable[Row], day: datetime.date) -> list[MaterialResult]:
    """Return the materials sorted by verdict (best first), then by number of reasons, then by name.

    `day` is the date of the fits in the provenance. A material without rows is left out.
    """
    by_point = {row[POINT_COLUMN.name]: row for row in rows}
    found = [
        (recordings, by_point[point])
        for index, recordings in enumerate(batch.tree.sets)
        if (point := batch.point(index)) in by_point
    ]
    results = [
        _material(name, [_fit(recordings, row) for recordings, row in several], batch.tree.path, day)
        for name, several in groupby(found, lambda each: each[0].material)
    ]
    return sorted(results, key=lambda each: (QUALITY_ORDER.index(each.quality), len(each.reasons), each.name))


def _fit(recordings: RecordingSet, row: Row) -> FitResult:
    error = row[ERROR_COLUMN.name]
    if error is not None:
        return FitResult(recordings, "refused", str(error), (str(error),), 0, None)
    found: dict[str, Any] = json.loads(str(row["found"]))
    judged = found["origin"]["verdict"][recordings.kind]
    left_out = row["left_out"]
    assert isinstance(left_out, int)
    return FitResult(
        recordings,
        judged["quality"],
        str(row["verdict"]),
        tuple(judged.get("reasons", ())),
        left_out,
        Contribution(recordings.kind, found["figures"], found["origin"]),
        tuple(found["notes"]),
        tuple(found["warnings"]),
        {name: Estimate(*map(_number, each)) for name, each in found["estimates"].items()},
        found["plain"],
        found["panels"],
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _material(name: str, fits: Sequence[FitResult], root: str, day: datetime.date) -> MaterialResult:
    """Merge the fits of a material one after the other, as `hapticd fit --merge` does."""
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
            found = added(part, name, day, onto=material, stiffness_n_per_m=fit.recordings.stiffness_n_per_m)
        except InvalidError as error:  # the merged material is invalid, although each single fit is valid
            done.append(FitResult(fit.recordings, "refused", str(error), (str(error),), fit.left_out, None))
            continue
        material = found.material
        done.append(fit)
        notes += fit.notes
        # The stiffness is set or measured; a puncture, which measures it, comes last.
        if fit.recordings.stiffness_n_per_m is not None or "stiffness_n_per_m" in part.figures:
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
    """Return the provenance `origin` of a fit with the paths of its recordings below `root`, the path of the tree."""
    files = origin["files"]
    assert isinstance(files, list)
    above = os.fsencode(root).decode(errors="backslashreplace")
    return {**origin, "files": [{**file, "path": os.path.join(above, file["path"])} for file in files]}


def counts(results: Iterable[MaterialResult]) -> dict[Quality, int]:
    """Return the number of materials with each verdict."""
    found: dict[Quality, int] = dict.fromkeys(QUALITY_ORDER, 0)
    for each in results:
        found[each.quality] += 1
    return found


def result_dict(rank: int, result: MaterialResult, file: str | None) -> dict[str, Json]:
    """Return a material as JSON data for --json; `file` is the path of its YAML file."""
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
                "recordings": len(fit.recordings.files),
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
