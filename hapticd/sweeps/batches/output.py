"""The output files of a batch in addition to its rows: a YAML file for each material, and CSV tables.

    materials/NAME.yaml   a file for `hapticd -c` and `hapticd apply`, as written by `hapticd fit -o`
    ranking.csv           a row for each fit, the best material first
    figures.csv           a row for each estimated quantity of each fit, with its 95 % confidence interval

With a file for each material, users can choose materials, and only changed files are written again.
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
from hapticd.base.files import check_regular, write_atomically
from hapticd.base.yaml_source import printable
from hapticd.base.yaml_text import yaml_text
from hapticd.config.schema import unit_of
from hapticd.sweeps.batches.ranking import MaterialResult
from hapticd.sweeps.store import STUDY_FILE

_DATE_ENTRY: Final = re.compile(r'date: "\d{4}-\d{2}-\d{2}"')
"""Pattern of the date of a fit in a material's file."""
_MAX_SHOWN_NAMES: Final = 3
"""Maximum number of file names in a line of text."""


def check_folder(folder: Path, tree: str) -> None:
    """Raise HapticdError if results must not go to `folder`: a path in the tree, a file, or a folder of other files."""
    inside, above = os.path.realpath(folder), os.path.realpath(tree)
    if os.path.commonpath([inside, above]) == above:
        raise HapticdError(f"{folder}: is inside the tree of recordings; give a folder outside of it with -o")
    if folder.exists() and not folder.is_dir():
        raise HapticdError(f"{folder}: not a folder; give another name with -o")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / STUDY_FILE).is_file():
        raise HapticdError(f"{folder}: not empty, and not a folder of results; give a new folder with -o")


def write_materials(folder: Path, results: Iterable[MaterialResult]) -> tuple[dict[str, str], list[str]]:
    """Write a YAML file for each material of which at least one fit was not refused.

    Returns the path of each file by the name of the material, and the paths of files that remain from earlier batches.
    A file that would change only in the date is kept. Raises HapticdError if a file cannot be written.
    """
    target = folder / "materials"
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HapticdError(f"{target}: cannot be created: {error.strerror}") from None
    files: dict[str, str] = {}
    for each in results:
        if each.material is None:
            continue
        path = target / f"{each.name}.yaml"
        check_regular(path)
        text = yaml_text({"materials": {each.name: each.material.to_dict()}}) + "\n"
        if _DATE_ENTRY.sub("", _read(path)) != _DATE_ENTRY.sub("", text):
            write_atomically(str(path), text, overwrite=True)
        files[each.name] = str(path)
    left = sorted({str(path) for path in target.glob("*.yaml")} - {*files.values()})
    return files, left


def _read(path: Path) -> str:
    """Return the text of a file; empty if the file is missing or unreadable."""
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError):
        return ""


def write_tables(folder: Path, results: Sequence[MaterialResult], files: Mapping[str, str]) -> None:
    """Write the tables ranking.csv and figures.csv of a batch. Raises HapticdError if one cannot be written."""
    ranking = [
        (rank, result.name, result.quality, fit.kind, fit.quality, len(fit.recordings.files), fit.left_out,
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
    write_atomically(str(path), text.getvalue(), overwrite=True)


def shown_files(names: Sequence[str]) -> str:
    """Return the first _MAX_SHOWN_NAMES names and the number of the others, as one line of text."""
    more = f" and {len(names) - _MAX_SHOWN_NAMES} more" if len(names) > _MAX_SHOWN_NAMES else ""
    return ", ".join(map(printable, names[:_MAX_SHOWN_NAMES])) + more
