"""The tests are the same in whichever shell they are started: see conftest.py."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest

HERE = Path(__file__)
PARTS = ("test_nothing_of_the_shell_is_taken_for_ours", "test_a_process_that_is_interrupted_ends")


def test_nothing_of_the_shell_is_taken_for_ours() -> None:
    # What the tests must find on the machine is for them (conftest.py), and for nothing of the package.
    for_tests = {"HAPTICD_BROWSER", "HAPTICD_CLIENTS"}
    assert not [name for name in os.environ if name.startswith("HAPTICD_") and name not in for_tests]
    # The user's configuration is a copy of the built-in one; see conftest.py.
    built_in = resources.files("hapticd").joinpath("shipped", "default.yaml").read_bytes()
    ours = Path(os.environ["XDG_CONFIG_HOME"], "hapticd")
    assert {path.name: path.read_bytes() for path in ours.iterdir()} == {"config.yaml": built_in}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_process_that_is_interrupted_ends(number: int) -> None:
    done = subprocess.run(["sh", "-c", f"kill -{number} $$"], timeout=60, check=False)
    assert done.returncode == -number


@pytest.mark.slow
def test_started_from_a_script_or_by_nohup() -> None:
    """A job in the background of a script has interrupts ignored, and so does what it starts."""
    tests = [f"{HERE}::{name}" for name in PARTS]
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "HAPTICD_RUNTIME_DIR": "/nowhere"}
    done = subprocess.run(
        ["sh", "-c", 'trap "" INT HUP; exec "$@"', "sh", *words],
        cwd=HERE.parents[2],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
