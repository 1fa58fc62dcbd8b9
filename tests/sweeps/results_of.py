"""Results of a study with rows that a test chooses instead of computing them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hapticd.sweeps.columns import Row
from hapticd.sweeps.results import Results, in_order
from hapticd.sweeps.study import load_sweep

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}
WALL = {"materials": {"m": {"stiffness_n_per_m": 100}}, "scene": {"objects": {"floor": FLOOR}}}
RATE, STIFFNESS, MASS = "servo.rate_hz", "materials.m.stiffness_n_per_m", "device.sim.handle_mass_kg"


def study_of(**keys: Any) -> dict[str, Any]:
    """Return a study of a wall whose measures need no run."""
    return {"base": WALL, "measure": ["stability_factor", {"passive_limit": {"material": "m"}}], **keys}


def results_of(study: dict[str, Any], rows: Sequence[dict[str, Any]]) -> Results:
    """Return the results of a study with these rows; columns that a row lacks are None."""
    plan = load_sweep(study)
    full: list[Row] = [dict.fromkeys(column.name for column in plan.columns) | row for row in rows]
    return Results(
        plan.job.study, None, plan.columns, tuple(in_order(full, plan.columns)), len(plan.ids), {"hapticd": "v"}
    )
