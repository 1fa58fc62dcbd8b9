"""A sweep from Python: all points of a study as a DataFrame."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticd.base.errors import HapticdError
from hapticd.sweeps import engine
from hapticd.sweeps.cluster import client_of, require_dask
from hapticd.sweeps.store import Store
from hapticd.sweeps.study import load_sweep

if TYPE_CHECKING:
    import pandas as pd


def sweep(
    study: Mapping[str, object] | str | os.PathLike[str],
    client: Any = None,
    *,
    folder: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    threads: bool = False,
) -> pd.DataFrame:
    """Computes the points of a study (docs/sweeps.md), and returns one row a point.

    `study`: a YAML file, the name of one that ships, or a mapping.

    `client`: a `distributed.Client`, by default of `workers` processes of this machine (as many as processors), or with
    `threads` of threads of this process. Processes are spawned: a script calls this below `if __name__ == "__main__":`.
    `folder` keeps the results, and points that it holds are not computed again.

    Rows are sorted by what is varied. The columns are `point`, what is varied, what is measured, and `error`, why a
    point has no result. Raises InvalidError for a study that is not valid, and HapticdError.
    """
    require_dask()
    plan = load_sweep(study)

    if workers is not None and workers < 1:
        raise HapticdError(f"workers must be at least 1, is {workers}")

    def opened() -> AbstractContextManager[Any]:
        return client_of(None, workers, threads) if client is None else nullcontext(client)

    def run(path: str) -> pd.DataFrame:
        store = Store(Path(path), _note)
        engine.run(plan, store, opened, _note, lambda progress: None)
        found: pd.DataFrame = store.table().to_pandas()
        varied = [column.name for column in plan.columns if column.role == "varied"]
        return found.sort_values(varied, kind="stable", ignore_index=True) if varied else found

    if folder is not None:
        return run(os.fspath(folder))
    with tempfile.TemporaryDirectory(prefix="hapticd-sweep-") as path:
        return run(path)


def _note(text: str) -> None:
    print(text, file=sys.stderr)
