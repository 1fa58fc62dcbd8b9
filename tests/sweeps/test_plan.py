"""Identities of points: hashes from axes equal those of complete documents."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from hapticd.sweeps import plan as planning
from hapticd.sweeps.identity import sum_of
from hapticd.sweeps.plan import Plan
from hapticd.sweeps.study import load_sweep
from tests.sweeps.results_of import FLOOR

BASE: dict[str, Any] = {"materials": {"m": {"stiffness_n_per_m": 200}}, "scene": {"objects": {"floor": FLOOR}}}
RATES = {"servo.rate_hz": [1000, 2000.5]}


def planned(vary: dict[str, Any], **keys: Any) -> Plan:
    return load_sweep({"base": BASE, "vary": vary, "measure": ["stability_factor"], **keys})


@pytest.mark.parametrize(
    "vary",
    [
        {**RATES, "materials.m.stiffness_n_per_m": {"low": 10, "high": 500, "count": 3}},
        {**RATES, "materials.wood.stiffness_n_per_m": [100, 200]},
        {**RATES, "scene.objects.floor.normal[0]": [0.0, 1.0]},
        {**RATES, "materials.m": ["wood", "steel"]},
        {**RATES, "grip": {"levels": {"a": {"device.sim.hand.mass_kg": 0.1}, "b": {"device.max_force_n": 5}}}},
        {**RATES, "parameters.seed": [1, 2, 3], "scene.objects.floor.material": ["m", "steel"]},
    ],
)
def test_hashes_from_axes_are_those_of_complete_documents(vary: dict[str, Any]) -> None:
    made = planned(vary)
    assert planning._are_independent(made.job, made.axes)
    total = len(made.axes[0].of_point)
    expected = [sum_of(made.job.document(planning._combination(made.axes, index))) for index in range(total)]
    assert np.array_equal(planning._document_hashes(made.job, made.axes, total), np.array(expected))
    assert len(made.ids) == total


def test_documents_of_dependent_axes_are_hashed_completely() -> None:
    made = planned({"materials.m": ["wood", "steel"], "materials.m.stiffness_n_per_m": [10, 20]})
    assert not planning._are_independent(made.job, made.axes) and len(made.ids) == 4
    documents = [made.job.document(planning._combination(made.axes, index)) for index in range(4)]
    assert [each["materials"]["m"]["stiffness_n_per_m"] for each in documents] == [10, 20, 10, 20]  # type: ignore[index, call-overload]


def test_other_input_is_another_point() -> None:
    ids = {planned(RATES).ids[0].tobytes()}
    for keys in (
        {"measure": ["stability_factor", {"displayed_error": {"material": "wood"}}]},
        {"base": {**BASE, "materials": {"m": {"stiffness_n_per_m": 201}}}},
        {"parameters": {"a": 1}},
        {"run": "none", "operator": {"waypoints": [[0, 0, 0]]}},
    ):
        ids.add(load_sweep({"base": BASE, "vary": RATES, "measure": ["stability_factor"], **keys}).ids[0].tobytes())
    assert len(ids) == 5


def test_a_title_changes_no_point() -> None:
    assert planned(RATES, title="Other").ids.tobytes() == planned(RATES).ids.tobytes()


def test_a_pickled_piece_computes_the_rows_of_its_points() -> None:
    made = planned({"servo.rate_hz": [1000, 4000], "materials.m.stiffness_n_per_m": [100, 200]})
    piece = pickle.loads(pickle.dumps(made.piece(np.array([3, 0]))))
    rows = piece.rows()
    assert [row["point"] for row in rows] == [made.ids[3].tobytes().hex(), made.ids[0].tobytes().hex()]
    assert len(rows) == len(piece) == 2
    assert [(row["servo.rate_hz"], row["materials.m.stiffness_n_per_m"]) for row in rows] == [(4000, 200), (1000, 100)]
    assert list(rows[0]) == [column.name for column in made.columns]
