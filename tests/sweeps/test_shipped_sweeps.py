"""The shipped sweeps: found by name, listed, and with the results that they claim."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hapticd.cli import main
from hapticd.config.shipped_files import described, shipped
from hapticd.sweeps.columns import Row
from hapticd.sweeps.plan import Plan
from hapticd.sweeps.study import load_sweep

NAMES = ["displayed_error", "joystick_design", "wall_stability"]


def rows_of(plan: Plan, wanted: Callable[[Row], bool]) -> list[Row]:
    """Compute the rows of the points whose varied values are `wanted`."""
    everything = plan.piece(np.arange(len(plan.ids)))
    found = [
        index
        for index, values in enumerate(everything.values)
        if wanted(dict(zip(plan.job.names, values, strict=True)))
    ]
    return plan.piece(np.array(found)).rows()


def test_three_sweeps_ship_each_with_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert sorted(shipped("sweeps")) == NAMES
    assert all(each.shows.endswith(".") and len(each.shows) < 120 for each in described("sweeps"))
    assert main(["sweep", "list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == NAMES
    assert main(["sweep", "list", "--json"]) == 0
    assert [each["name"] for each in json.loads(capsys.readouterr().out)] == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_each_shipped_sweep_has_figures_and_loads_by_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = load_sweep(name)
    assert plan.job.study.figures
    # Every drawn column has a unit.
    units = {column.name: column.unit for column in plan.columns}
    for figure in plan.job.study.figures:
        drawn = [figure.x, *(figure.y or ())] if figure.kind != "table" else []
        assert all(units[each] for each in drawn if each is not None)


def test_a_similar_name_is_suggested(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "run", "wall_stabilty"]) == 1
    assert "neither a file nor a shipped sweep; did you mean wall_stability?" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize(("rate_hz", "hand"), [(1000.0, "let go"), (1000.0, "light hand")])
def test_a_wall_below_the_line_rests_and_above_it_oscillates_with_the_handle_let_go(rate_hz: float, hand: str) -> None:
    """The line is at 2 b/T = 400 N/m, with b = 0.2 N s/m and T = 1 ms. A light hand raises the limit tenfold."""
    plan = load_sweep("wall_stability")
    rows = rows_of(plan, lambda row: row["servo.rate_hz"] == rate_hz and row["hand"] == hand)
    stiffness = np.array([row["materials.surface.stiffness_n_per_m"] for row in rows], dtype=float)
    decays = np.array([row["decays"] for row in rows])
    assert [row["passive_limit_n_per_m"] for row in rows] == pytest.approx([400.0] * len(rows), rel=1e-12)
    assert decays[stiffness < 400.0].all()
    just_above = (stiffness > 402.0) & (stiffness < 1500.0)
    assert just_above.sum() > 5 and decays[just_above].all() == (hand == "light hand")


@pytest.mark.slow
def test_the_errors_are_those_that_the_study_claims() -> None:
    rows = rows_of(load_sweep("displayed_error"), lambda row: row["device.compensation"] == "mass")
    high = ["aluminum", "glass", "cast_iron", "steel"]
    assert max(float(row[name] or 0) for row in rows for name in high) < 0.24
    good = [
        row
        for row in rows
        if float(row["device.sim.handle_mass_kg"] or 0) > 0.099
        and float(row["device.sim.hand.stiffness_n_per_m"] or 0) < 1000
    ]
    worst = max(float(row[name] or 0) for row in good for name in ["wood", "acrylic", "delrin", *high])
    assert 0.17 < worst < 0.18


def test_some_designs_suffice_and_one_of_a_kilohertz_does_not() -> None:
    plan = load_sweep("joystick_design")
    kept = {"device.sim.encoder_step_m": 1e-4, "device.sim.handle_damping_n_s_per_m": 0.05, "device.max_force_n": 15}
    rows = rows_of(plan, lambda row: all(row[name] == value for name, value in kept.items()))
    good = [(row["servo.rate_hz"], row["device.sim.handle_mass_kg"]) for row in rows if row["suffices"]]
    assert good == [(8000, 0.08), (10000, 0.08)]
