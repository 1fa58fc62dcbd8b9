"""The files of a batch beside its rows: a YAML for each material, and tables as CSV.

    materials/NAME.yaml   as `hapticd fit -o` writes it: a file that -c and `material set` take
    ranking.csv           a row for each fit, the best material first
    figures.csv           a row for each figure of each fit, with its 95 % interval

A file for each material, so that the good ones can be taken, and so that only what changed is written again.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular, write_whole
from hapticd.base.yaml_source import one_line
from hapticd.base.yaml_text import yaml_text
from hapticd.config.schema import unit_of
from hapticd.sweeps.batches.ranking import MaterialResult
from hapticd.sweeps.store import STUDY_FILE

MATERIALS_FOLDER: Final = "materials"
_DATE_ENTRY: Final = re.compile(r'date: "\d{4}-\d{2}-\d{2}"')


def check_folder(folder: Path, tree: str) -> None:
    """Raises HapticdError where results cannot go to a folder: one in the tree, or one that holds something else."""
    inside, above = os.path.realpath(folder), os.path.realpath(tree)
    if os.path.commonpath([inside, above]) == above:
        raise HapticdError(f"{folder}: lies in the tree of recordings; give a folder outside of it: -o")
    if folder.exists() and not folder.is_dir():
        raise HapticdError(f"{folder}: is a file; give another name: -o")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / STUDY_FILE).is_file():
        raise HapticdError(f"{folder}: holds something else than a batch; give a new folder: -o")


def write_materials(folder: Path, results: Iterable[MaterialResult]) -> tuple[dict[str, str], list[str]]:
    """The file of each material that there is, by name, and files of others that an earlier batch left there.

    A file that differs from the new one in the day alone is kept. Raises HapticdError.
    """
    target = folder / MATERIALS_FOLDER
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HapticdError(f"{target}: cannot be made: {error.strerror}") from None
    files: dict[str, str] = {}
    for each in results:
        if each.material is None:
            continue
        path = target / f"{each.name}.yaml"
        check_regular(path)
        text = yaml_text({"materials": {each.name: each.material.to_dict()}}) + "\n"
        if _DATE_ENTRY.sub("", _read(path)) != _DATE_ENTRY.sub("", text):
            write_whole(str(path), text, overwrite=True)
        files[each.name] = str(path)
    left = sorted({str(path) for path in target.glob("*.yaml")} - {*files.values()})
    return files, left


def _read(path: Path) -> str:
    """Empty where there is nothing that could be kept."""
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError):
        return ""


def write_tables(folder: Path, results: Sequence[MaterialResult], files: Mapping[str, str]) -> None:
    """ranking.csv and figures.csv. Raises HapticdError."""
    ranking = [
        (rank, result.name, result.quality, fit.kind, fit.quality, len(fit.asked.files), fit.left_out,
         "; ".join(fit.reasons), os.path.relpath(files[result.name], folder) if result.name in files else "")
        for rank, result in enumerate(results, 1)
        for fit in result.fits
    ]  # fmt: skip
    figures = [
        (result.name, fit.kind, name, each.value, each.low, each.high, unit_of(name) or "")
        for result in results
        for fit in result.fits
        for name, each in (fit.estimates or {}).items()
    ]
    heads = ("rank", "material", "quality", "kind", "fit_quality", "recordings", "left_out", "reasons", "file")
    _write(folder / "ranking.csv", heads, ranking)
    _write(folder / "figures.csv", ("material", "kind", "figure", "value", "low", "high", "unit"), figures)


def _write(path: Path, heads: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows(rows)
    write_whole(str(path), text.getvalue(), overwrite=True)


def shown_files(names: Sequence[str], most: int = 3) -> str:
    """The first of several names, on one line."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(one_line, names[:most])) + more
