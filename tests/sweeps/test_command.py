"""`hapticd sweep` and `hapticd.sweep`, as users call them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import hapticd
from hapticd.cli import main
from hapticd.system.extras import install_command
from tests.sweeps.results_of import FLOOR
from tests.sweeps.results_of import WALL as BASE

FREE = {
    "max_force_n": 100,
    "max_speed_m_per_s": 1000,
    "sim": {
        "encoder_step_m": 0,
        "coulomb_friction_n": 0,
        "force_step_n": 0,
        "max_force_n": 100,
        "hand": {"mass_kg": 0, "stiffness_n_per_m": 0, "damping_n_s_per_m": 0},
    },
}
"""A free handle with 0.2 N s/m, exact positions and no dry friction."""
PRESS = {"waypoints": [[0, 0, 0.002], [0.05, 0, -0.001]]}


def study(tmp_path: Path, **keys: Any) -> str:
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump({"base": BASE, "operator": PRESS, "measure": ["peak_force_n"], **keys}))
    return str(file)


def ran(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = main(["sweep", *words])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


@pytest.mark.long
def test_the_boundary_of_a_free_handle_is_that_of_colgate_and_schenkel(tmp_path: Path) -> None:
    """K = 2 b/T (Colgate and Schenkel 1997), for a wall without damping."""
    rates = [1000.0, 2500.0]
    push = {"kind": "constant", "force_n": [0, -0.5]}
    found = hapticd.sweep(
        {
            "base": {**BASE, "device": FREE, "scene": {"objects": {"floor": FLOOR, "push": push}}},
            "operator": {"waypoints": [[0, 0, 0.001], [0.01, 0, 0.001]]},
            "vary": {"servo.rate_hz": rates},
            "measure": ["end"],
            "refine": {
                "key": "materials.m.stiffness_n_per_m", "start": 100, "end": 10000, "holds": "decays",
                "within": 0.002, "scan": 20,
            },
        },
        threads=True,
    ).sort_values("servo.rate_hz")  # fmt: skip
    expected = 2.0 * 0.2 * np.array(rates)
    assert found["boundary_state"].tolist() == ["found", "found"]
    # The limit of the exact linear loop is up to 0.5 % above the limit of passivity (docs/stability.md).
    assert (found["boundary"] > 0.997 * expected).all() and (found["boundary_fails"] < 1.007 * expected).all()


@pytest.mark.long
def test_run_and_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = study(tmp_path, vary={"materials.m.stiffness_n_per_m": [100, 200, 400]}, title="Three walls")
    folder = str(tmp_path / "results")
    code, out, err = ran(capsys, "run", file, "-o", folder, "--threads", "--json")
    assert code == 0 and err == ""
    first = json.loads(out)
    assert (first["points"], first["computed"], first["failed"]) == (3, 3, 0)
    code, out, _ = ran(capsys, "run", file, "-o", folder, "--json")
    assert code == 0 and json.loads(out)["reused"] == 3 and json.loads(out)["sha256"] == first["sha256"]
    code, out, _ = ran(capsys, "show", folder, "--json")
    rows = json.loads(out)["rows"]
    by_stiffness = {row["materials.m.stiffness_n_per_m"]: row["peak_force_n"] for row in rows}
    config = {**BASE, "materials": {"m": {"stiffness_n_per_m": 400}}}
    forces = hapticd.simulate(config, PRESS)["force_n"]
    assert by_stiffness[400] == float(np.hypot(*forces.T).max())
    code, out, _ = ran(capsys, "show", folder)
    assert code == 0 and out.startswith("Three walls") and len(out.splitlines()) >= 5


def test_a_point_that_cannot_be_computed_is_a_row_and_the_exit_code_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The combination of the second values is invalid: a start position outside the workspace.
    vary = {"device.sim.workspace_m": [0.075, 0.01], "device.sim.start_m[1]": [0.005, 0.05]}
    base = {**BASE, "device": {"sim": {"start_m": [0, 0.005]}}}
    code, out, err = ran(capsys, "run", study(tmp_path, base=base, vary=vary), "-o", str(tmp_path / "r"), "--threads")
    assert code == 1 and "1 failed" in out and "1 point could not be computed" in err
    _, out, _ = ran(capsys, "show", str(tmp_path / "r"), "--json")
    (failed,) = (row for row in json.loads(out)["rows"] if row["error"] is not None)
    assert failed["error"].startswith("device.sim: start_m must be inside the workspace")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"vary": {"servo.rate": [1000]}}, 'vary."servo.rate": unknown key; did you mean rate_hz?'),
        ({"vary": {"servo.rate_hz": [1000, 5]}}, 'vary."servo.rate_hz": should be greater than or equal to 1000, is 5'),
        ({"vary": {"rate": [1]}}, "vary.rate: unknown key rate"),
        ({"measure": ["peak_force"]}, "unknown measure peak_force; did you mean peak_force_n?"),
        (
            {"measure": [{"quantile": {"field": "force_n", "q": 2}}]},
            "measure[0].quantile.q: should be less than or equal to 1, is 2",
        ),
        ({"operator": None}, "measures a run: the study needs an operator"),
        ({"operator": {"gesture": {"kind": "tap"}}}, "operator.gesture.object: Field required"),
        ({"base": "no_such_scene"}, "no_such_scene: neither a file nor a shipped scene"),
        (
            {"refine": {"key": "servo.rate_hz", "start": 1000, "end": 9000, "holds": "peak"}},
            "unknown measured column peak",
        ),
        (
            {"vary": {"a": {"levels": {"x": {"servo.rate_hz": 5}}}}},
            "vary.a: should be greater than or equal to 1000, is 5",
        ),
    ],
)
def test_a_fault_is_one_line_with_its_place(
    keys: dict[str, Any], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = ran(capsys, "run", study(tmp_path, **keys), "-o", str(tmp_path / "r"), "--threads")
    assert code == 1 and out == "" and message in err and len(err.splitlines()) == 1, err
    assert not (tmp_path / "r").exists()


def test_another_kind_of_file_names_the_command_that_takes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.yaml").write_text("objects: {}\n")
    code, _, err = ran(capsys, "run", str(tmp_path / "scene.yaml"))
    assert code == 1 and "hapticd apply" in err


def test_points_with_equal_input_are_one_point(tmp_path: Path) -> None:
    found = hapticd.sweep(
        {"base": BASE, "vary": {"servo.rate_hz": [1000, 1000.0, 2000]}, "measure": ["stability_factor"]}, threads=True
    )
    assert sorted(found["servo.rate_hz"]) == [1000, 2000]


def test_two_studies_share_equal_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "r")
    stiffness = "materials.m.stiffness_n_per_m"
    ran(capsys, "run", study(tmp_path, vary={stiffness: [100, 200]}), "-o", folder, "--threads")
    drawn = {stiffness: {"low": 200, "high": 400, "count": 3}}
    code, out, _ = ran(capsys, "run", study(tmp_path, vary=drawn), "-o", folder, "--threads", "--json")
    found = json.loads(out)
    assert code == 0 and (found["reused"], found["computed"]) == (1, 2)
    _, out, _ = ran(capsys, "show", folder, "--json")
    assert sorted(row[stiffness] for row in json.loads(out)["rows"]) == [200, 300, 400]


def test_rows_with_other_columns_are_not_reused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "r")
    stiffness = "materials.m.stiffness_n_per_m"
    ran(capsys, "run", study(tmp_path, vary={stiffness: [200]}), "-o", folder, "--threads")
    levels = {"levels": {"soft": {stiffness: 200}}}
    _, out, _ = ran(capsys, "run", study(tmp_path, vary={"wall": levels}), "-o", folder, "--threads", "--json")
    assert json.loads(out)["computed"] == 1
    _, out, _ = ran(capsys, "show", folder, "--json")
    assert [row["wall"] for row in json.loads(out)["rows"]] == ["soft"]


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("distributed", f"sweeps need dask: {install_command('cluster')}"),
        ("pyarrow.parquet", f"results of sweeps need pyarrow: {install_command('cluster')}"),
    ],
)
def test_a_missing_package_is_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, missing: str, message: str
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    assert ran(capsys, "run", study(tmp_path), "-o", str(tmp_path / "out")) == (1, "", f"hapticd: {message}\n")
    assert not (tmp_path / "out").exists()
