"""Benchmarks that are sweeps: studies in bench/studies/, which the engine of hapticd computes on all processors.

`hapticd sweep run bench/studies/NAME.yaml` computes a single study.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from bench.report import ROOT
from hapticd.base.yaml_source import Json, load_path
from hapticd.sweeps import engine
from hapticd.sweeps.cluster import client_of
from hapticd.sweeps.store import Store
from hapticd.sweeps.study import load_sweep

STUDIES = ROOT / "bench" / "studies"


@contextmanager
def workers() -> Iterator[Any]:
    """Yield a `distributed.Client` with a worker process for each processor, for the studies of a benchmark."""
    with client_of(None, None, False) as client:
        yield client


def swept(
    client: Any, name: str, progress: Callable[[float], None], vary: Mapping[str, Json] | None = None
) -> list[dict[str, Any]]:
    """Compute bench/studies/NAME.yaml, and return its rows in the order of its axes, the last axis fastest.

    `vary` replaces axes with the same names; `progress` gets the completed fraction. Raises RuntimeError if a point has
    no result.
    """
    study = dict(load_path(STUDIES / f"{name}.yaml").data)  # type: ignore[arg-type]
    study["vary"] = {**study["vary"], **(vary or {})}  # type: ignore[dict-item]
    plan = load_sweep(study)
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        store = Store(Path(folder), _note)
        engine.run(plan, store, lambda: nullcontext(client), _note, lambda at: progress(at.done / at.total))
        rows = {row["point"]: row for row in store.table().to_pylist()}
    found = [rows[each.tobytes().hex()] for each in plan.ids]
    for row in found:
        if row["error"] is not None:
            raise RuntimeError(f"{name}: {row['error']}")
    return found


def _note(text: str) -> None:
    print(text, file=sys.stderr)
