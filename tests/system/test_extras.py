"""The command that adds an extra, for each way of installing."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from hapticd.system import extras
from hapticd.system.extras import DEBIAN_PREFIX, IMAGE_EXTRAS_VARIABLE, install_command

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def outside_of_an_image(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(IMAGE_EXTRAS_VARIABLE, raising=False)


def test_an_environment_with_pip_installs_with_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "executable", "/home/me/my env/bin/python")
    monkeypatch.setattr(extras, "find_spec", lambda _: object())
    assert install_command("fit") == "'/home/me/my env/bin/python' -m pip install 'hapticd[fit]'"


def test_an_environment_without_pip_is_one_of_uv(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "executable", "/venv/bin/python")
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    assert install_command("fit") == "uv pip install --python /venv/bin/python 'hapticd[fit]'"


def test_pipx_names_its_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    prefix = tmp_path / "hapticd-lab"
    prefix.mkdir()
    (prefix / "pipx_metadata.json").touch()
    monkeypatch.setattr(sys, "prefix", str(prefix))
    assert install_command("web") == "pipx runpip hapticd-lab install 'hapticd[web]'"


def test_the_debian_package_uses_the_pip_of_debian(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", str(DEBIAN_PREFIX))
    pip = "sudo /usr/bin/python3 -m pip --python /usr/lib/hapticd/bin/python3"
    assert install_command("lsl") == f"sudo apt install python3-pip && {pip} install 'hapticd[lsl]'"
    rules = (ROOT / "packaging" / "debian" / "rules").read_text()
    assert "PRIVATE := $(PACKAGE)/usr/lib/hapticd\n" in rules


@pytest.mark.parametrize(
    ("built_with", "wanted", "names"),
    [("mcap,web", "fit", "mcap,web,fit"), ("mcap", "experiment,mcap", "mcap,experiment"), ("", "fit", "fit")],
)
def test_an_image_is_built_with_the_extras_of_both(
    monkeypatch: pytest.MonkeyPatch, built_with: str, wanted: str, names: str
) -> None:
    monkeypatch.setenv(IMAGE_EXTRAS_VARIABLE, built_with)
    command = install_command(wanted)
    assert command == f"podman build -f packaging/Containerfile --build-arg EXTRAS={names} -t hapticd ."
    recipe = (ROOT / "packaging" / "Containerfile").read_text()
    assert recipe.rindex(f"\nENV {IMAGE_EXTRAS_VARIABLE}=${{EXTRAS}}\n") > recipe.rindex("\nARG EXTRAS=")


def test_the_command_of_this_environment_names_this_python() -> None:
    words = shlex.split(install_command("fit"))
    python = next(word for word in words if word.startswith("/"))
    seen = subprocess.run([python, "-c", "import sys; print(sys.prefix)"], capture_output=True, text=True, check=True)
    assert seen.stdout.strip() == sys.prefix
