"""The validator of BIDS data sets, in a pinned version, which is downloaded once into build/."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import pytest

PACKAGE: Final = "bids-validator-deno"
VERSION: Final = "3.0.2"
"""A version that contains the schema and needs no network."""
_KEPT: Final = Path(__file__).parents[2] / "build" / f"{PACKAGE}-{VERSION}"
_FETCH_S: Final = 300
_RUN_S: Final = 120


def issues_of(data_set: Path) -> list[dict[str, Any]]:
    """Return the errors and warnings of the validator for a data set. Skips the test if it cannot be downloaded."""
    run = subprocess.run(
        [sys.executable, "-c", "from bids_validator_deno import cli; cli()", "--json", str(data_set)],
        env={**os.environ, "PYTHONPATH": str(_fetched())},
        capture_output=True,
        text=True,
        timeout=_RUN_S,
        check=False,
    )
    assert run.stdout.startswith("{"), run.stderr
    found: list[dict[str, Any]] = json.loads(run.stdout)["issues"]["issues"]
    return found


def _fetched() -> Path:
    """Return the folder in which the validator is installed."""
    if not _KEPT.is_dir():
        part = _KEPT.with_name(f"{_KEPT.name}.{os.getpid()}.part")
        install = ["install", "--quiet", "--target", str(part), f"{PACKAGE}=={VERSION}"]
        try:
            subprocess.run(
                [sys.executable, "-m", "pip", *install], capture_output=True, text=True, timeout=_FETCH_S, check=True
            )
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
            shutil.rmtree(part, ignore_errors=True)
            output = str(error.stderr or error).strip().splitlines()
            pytest.skip(f"{PACKAGE} {VERSION} cannot be fetched from PyPI: {output[-1]}")
        part.rename(_KEPT)
    return _KEPT
