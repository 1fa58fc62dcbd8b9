"""The studies of the benchmarks: each is valid, and its rows are those of its function without the engine."""

from __future__ import annotations

from dataclasses import asdict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bench import fit, passivity, stability
from bench.report import ROOT
from bench.swept import STUDIES, swept
from hapticd.base.yaml_source import load_path
from hapticd.sweeps.cluster import client_of
from hapticd.sweeps.study import load_sweep
from tests.support.marks import rest_slow


@pytest.mark.long
@pytest.mark.parametrize("file", rest_slow(sorted(STUDIES.glob("*.yaml"))), ids=lambda file: file.stem)
def test_a_study_of_the_benchmarks_is_valid_and_has_its_points(file: Any) -> None:
    found = load_sweep(file)
    study: Any = load_path(file).data
    counts = [len(axis) if isinstance(axis, list) else axis["count"] for axis in study["vary"].values()]
    zipped = study.get("combine") == "zipped"
    assert len(found.ids) == (counts[0] if zipped else np.prod(counts))
    (measure,) = study["measure"]
    assert measure["function"]["call"].startswith("bench.")


@pytest.mark.slow
def test_the_benchmarks_compute_studies_as_the_functions_do() -> None:
    fractions: list[float] = []
    with client_of(None, 2, threads=True) as client:
        cases = {"parameters.case": [3, 11], "parameters.positions": ["delay", "exact"]}
        rows = swept(client, "passivity", fractions.append, cases)  # type: ignore[arg-type]
        trials = swept(client, "stability_trials", fractions.append, {"parameters.trial": [0, 5]})
        fits = swept(client, "fit_taps", fractions.append, {"parameters.material": ["wood"], "parameters.set": [4]})
    assert fractions[-1] == 1.0
    order = [(row["parameters.positions"], row["parameters.passivity"], row["parameters.case"]) for row in rows]
    assert order == [
        (positions, mode, case)
        for positions in ("delay", "exact")
        for mode in ("observe", "control")
        for case in (3, 11)
    ]
    for row, (positions, mode, case) in zip(rows, order, strict=True):
        drawn = passivity.draw(case, positions)
        run = passivity.simulated(drawn, mode)
        assert (row["given_j"], row["bound_j"]) == (run.true_j, drawn.bound_j)
        assert (row["speed_m_per_s"], row["restrained"]) == (run.speed_m_per_s, run.energy.restrained)
    for row in trials:
        expected = asdict(stability.became(stability.SEED, row["parameters.trial"]))
        assert {key: row[key] for key in expected} == expected
    (row,) = fits
    given: Any = SimpleNamespace(parameters={"material": "wood", "set": 4})
    expected_fit = fit.fitted(given)
    assert {key: row[key] for key in expected_fit} == expected_fit


@pytest.mark.slow
def test_a_point_without_a_result_ends_a_benchmark() -> None:
    with client_of(None, 1, threads=True) as client, pytest.raises(RuntimeError, match=r"fit_taps: bench.fit:fitted: "):
        swept(client, "fit_taps", lambda part: None, {"parameters.material": ["cheese"], "parameters.set": [0]})


def test_each_map_varies_the_key_of_its_axis() -> None:
    for axis, (_, key, _) in stability.AXES.items():
        study: Any = load_path(ROOT / "bench" / "studies" / f"stability_{axis}.yaml").data
        assert list(study["vary"]) == [key]
