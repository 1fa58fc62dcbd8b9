"""The code version covers all files that results depend on."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hapticd.sweeps.worker_check import code_version

PACKAGE = Path(__file__).parents[2] / "hapticd"


def version_of(copy: Path) -> str:
    program = "from hapticd.sweeps.worker_check import code_version; print(code_version())"
    return subprocess.run(
        [sys.executable, "-c", program], cwd=copy, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.mark.long
@pytest.mark.parametrize("changed", ["rendering/offline.py", "shipped/materials/okamura1998.yaml", "_core.abi3.so"])
def test_a_change_of_code_core_or_materials_is_another_version(changed: str, tmp_path: Path) -> None:
    copy = tmp_path / "hapticd"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__", "static"))
    assert version_of(tmp_path) == code_version()
    with (copy / changed).open("ab") as file:
        file.write(b"\n")
    assert version_of(tmp_path) != code_version()
