"""hapticd.sweep(): runs a study from Python and returns its rows as a DataFrame."""

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
    """Compute the points of a study (docs/sweeps.md) and return a DataFrame with one row for each point.

    Args:
        study: A YAML file, the name of a shipped study, or a mapping.
        client: A `distributed.Client`. By default one with local processes is started for this call.
        folder: Folder for the results; points with rows in it are not computed again.
        workers: Number of local processes, by default the number of processors.
        threads: Use threads of this process instead of processes. Processes import the script, which therefore must
            make this call below `if __name__ == "__main__":`.

    The columns are `point`, the varied keys, the measured columns, and `error`, the reason why a point has no result.
    Rows are sorted by the varied keys. Raises InvalidError for an invalid study, HapticdError if it cannot be run.
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
