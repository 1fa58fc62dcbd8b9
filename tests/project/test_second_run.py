"""tests/second_run.py: a test that fails twice fails the run; one that passes the second time is named."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parent.parent / "second_run.py"
FAILS_ONCE = """
from pathlib import Path

def test_passes():
    pass

def test_fails_once():
    marker = Path("ran_before")
    first, _ = not marker.exists(), marker.touch()
    assert not first
"""
FAILS = "def test_fails():\n    assert False\n"


def second_run(folder: Path, *arguments: str) -> tuple[int, list[str]]:
    """Return the exit code of tests/second_run.py and the lines that it prints."""
    done = subprocess.run([sys.executable, SCRIPT, *arguments], cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stdout.splitlines()


def binary(folder: Path, name: str, script: str) -> str:
    """Write a program that takes the place of a C test."""
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(path)


@pytest.mark.long
def test_a_test_that_passes_the_second_time_is_named(tmp_path: Path) -> None:
    (tmp_path / "test_once.py").write_text(FAILS_ONCE)
    code, lines = second_run(tmp_path, "--", "-n", "2")
    assert code == 0
    assert lines[-1] == "needed a second run: test_once.py::test_fails_once"


@pytest.mark.long
def test_a_test_that_fails_twice_fails_the_run(tmp_path: Path) -> None:
    (tmp_path / "test_once.py").write_text(FAILS_ONCE)
    (tmp_path / "test_twice.py").write_text(FAILS)
    code, lines = second_run(tmp_path, "--", "-q")
    assert code == 1
    assert lines[-2:] == [
        "needed a second run: test_once.py::test_fails_once",
        "failed twice: test_twice.py::test_fails",
    ]


@pytest.mark.slow
def test_a_failure_of_an_earlier_run_is_not_run_again(tmp_path: Path) -> None:
    (tmp_path / "test_once.py").write_text(FAILS_ONCE)
    (tmp_path / "test_twice.py").write_text(FAILS)
    assert second_run(tmp_path, "--", "test_twice.py")[0] == 1
    code, lines = second_run(tmp_path, "--", "test_once.py")
    assert code == 0
    assert lines[-1] == "needed a second run: test_once.py::test_fails_once"


@pytest.mark.long
def test_no_tests_and_tests_that_cannot_be_collected_fail_the_run(tmp_path: Path) -> None:
    assert second_run(tmp_path, "--", "-q")[0] == 5
    (tmp_path / "test_broken.py").write_text("import no_such_module\n")
    assert second_run(tmp_path, "--", "-q")[0] != 0


def test_c_tests(tmp_path: Path) -> None:
    passes = binary(tmp_path, "passes", 'echo "run $HD_RUN"')
    once = binary(tmp_path, "once", "[ -e been ] || { touch been; echo broken; exit 3; }")
    fails = binary(tmp_path, "fails", "kill -ABRT $$")
    assert second_run(tmp_path, "--c-runs", "2", passes) == (0, ["run 0", "run 1"])
    code, lines = second_run(tmp_path, once, passes)
    assert code == 0 and f"{once}: ended with 3" in lines and lines[-1] == f"needed a second run: {once}"
    code, lines = second_run(tmp_path, fails)
    assert code == 1 and lines[-1] == f"failed twice: {fails}"
