"""The examples and the notebook of examples/, beside a daemon, as their first lines say to start them."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import hapticd
from tests.support.daemon_process import Daemon, connect

EXAMPLES = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def daemon(quiet_daemon: Daemon) -> Daemon:
    return quiet_daemon


def run(daemon: Daemon | None, folder: Path, *words: str) -> str:
    """What an example prints."""
    environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    environment["HAPTICD_RUNTIME_DIR"] = "/nowhere" if daemon is None else str(daemon.directory)
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_loop_draws_the_disc_and_takes_it_away(daemon: Daemon, tmp_path: Path) -> None:
    drawn = run(daemon, tmp_path, str(EXAMPLES / "gui_loop.py"), "--for", "1").splitlines()
    assert len(drawn) > 1
    assert any("O" in line and line.endswith(" N") for line in drawn)
    with connect(daemon.directory) as client:
        assert "disc" not in client.get_scene()["scene"]["objects"]


def test_asyncio_prints_each_tap(daemon: Daemon, tmp_path: Path) -> None:
    lines = run(daemon, tmp_path, str(EXAMPLES / "asyncio_client.py")).splitlines()
    assert [line.split(":")[0] for line in lines] == ["tap 1", "tap 2", "tap 3"]
    assert all(0.08 < float(line.split()[2]) < 0.12 for line in lines)


def test_the_staircase_writes_a_row_a_trial(daemon: Daemon, tmp_path: Path) -> None:
    script = str(EXAMPLES / "psychophysics.py")
    assert "threshold" in run(daemon, tmp_path, script, "answers.csv", "--simulated", "--trials", "3")
    with open(tmp_path / "answers.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["trial"] for row in rows] == ["1", "2", "3"]
    assert all((row["stiffer"] == row["answer"]) == (row["correct"] == "True") for row in rows)
    assert [float(row["difference_n_per_m"]) for row in rows[:2]] == [200.0, 200.0]


def test_the_table_of_contacts_is_that_of_the_events(tmp_path: Path) -> None:
    scene = {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}}}
    (tmp_path / "scene.yaml").write_text(json.dumps({"scene": scene}))
    (tmp_path / "hand.yaml").write_text("waypoints: [[0, 0, 0.01], [0.1, 0, -0.003], [0.2, 0, 0.01], [0.3, 0, 0.01]]\n")
    run(None, tmp_path, "-m", "hapticd", "simulate", "scene.yaml", "--operator", "hand.yaml", "-o", "tap.npz")
    heading, *rows = run(None, tmp_path, str(EXAMPLES / "recordings_pandas.py"), "tap.npz").splitlines()
    recording = hapticd.load(tmp_path / "tap.npz")
    contacts = [event for event in recording.events if event["event"] == "contact"]
    assert heading.split()[0] == "object" and len(rows) == len(contacts) > 0
    largest = max(float(row.split()[4]) for row in rows)
    assert largest == pytest.approx(abs(recording.samples["force_n"][:, 1]).max(), rel=1e-3)


def test_the_notebook_runs(daemon: Daemon, tmp_path: Path) -> None:
    run(
        daemon,
        tmp_path,
        "-c",
        "from nbclient.cli import main; main()",
        str(EXAMPLES / "first_wall.ipynb"),
        f"--output={tmp_path / 'done.ipynb'}",
    )
    cells = json.loads((tmp_path / "done.ipynb").read_text())["cells"]
    shown = [output.get("data", {}) for cell in cells for output in cell.get("outputs", [])]
    assert any("image/png" in data for data in shown)
    assert any("cork" in "".join(data.get("text/plain", "")) for data in shown)


def test_the_notebook_is_kept_without_output() -> None:
    for cell in json.loads((EXAMPLES / "first_wall.ipynb").read_text())["cells"]:
        assert not cell.get("outputs") and cell.get("execution_count") is None
