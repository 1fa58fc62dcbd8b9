"""The benches that are sweeps by nature: studies in bench/studies/, computed by hapticd's own engine on all processors.

`hapticd sweep run bench/studies/NAME.yaml` computes one of them alone.
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
    """A `distributed.Client` of as many processes as there are processors, for the studies of one bench."""
    with client_of(None, None, False) as client:
        yield client


def swept(
    client: Any, name: str, tell: Callable[[float], None], vary: Mapping[str, Json] | None = None
) -> list[dict[str, Any]]:
    """The rows of bench/studies/NAME.yaml, in the order of its axes, the last one fastest.

    `vary` takes the place of the axes of the same names; `tell` hears which part is done. Raises RuntimeError where a
    point has no result.
    """
    study = dict(load_path(STUDIES / f"{name}.yaml").data)  # type: ignore[arg-type]
    study["vary"] = {**study["vary"], **(vary or {})}  # type: ignore[dict-item]
    plan = load_sweep(study)
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        store = Store(Path(folder), _note)
        engine.run(plan, store, lambda: nullcontext(client), _note, lambda at: tell(at.done / at.total))
        rows = {row["point"]: row for row in store.table().to_pylist()}
    found = [rows[each.tobytes().hex()] for each in plan.ids]
    for row in found:
        if row["error"] is not None:
            raise RuntimeError(f"{name}: {row['error']}")
    return found


def _note(text: str) -> None:
    print(text, file=sys.stderr)
