"""hapticd as it is installed: from a clone, for work on it, and from a wheel, without the source tree.

Each builds in a virtual environment that is new, with this one's dependencies, so that nothing is fetched.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path

import pytest

from hapticd import __version__
from hapticd.cli.machine import SCRIPT_PATH_BY_SHELL
from tests.support.cli import page_names

ROOT = Path(__file__).parents[2]
SHOW = "import hapticd; print(hapticd.connect.__module__, hapticd.__file__)"

pytestmark = pytest.mark.slow


class Environment:
    """A virtual environment whose packages are its own hapticd and what this one's needs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
        self.packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
        # Names of packages alone: no .pth of that folder is read, so the hapticd that is installed there is not found.
        (self.packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")

    def run(self, *command: str | Path, cwd: Path, stdin: str = "") -> str:
        """A command of this environment, away from the source tree; its standard output."""
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "HAPTICD"))}
        environment["PATH"] = f"{self.folder / 'bin'}:{environment['PATH']}"
        done = subprocess.run(
            [self.folder / "bin" / command[0], *command[1:]],
            cwd=cwd,
            env=environment,
            input=stdin,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        return done.stdout

    def install(self, *arguments: str | Path, cwd: Path) -> None:
        pip = [sys.executable, "-m", "pip", "--python", self.folder / "bin" / "python"]
        options = ["install", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
        done = subprocess.run([*pip, *options, *arguments], cwd=cwd, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


def clone(folder: Path) -> Path:
    """The files of this tree that belong to it, as `git clone` would put them there."""
    files = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(files, cwd=ROOT, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("this tree is no clone: git does not know its files")
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_symlink() or (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    return folder


def test_python_beside_a_clone_finds_the_package(tmp_path: Path) -> None:
    """The folder hapticd of the current directory, the clone, is no package: it is not to be taken for one."""
    tree = clone(tmp_path / "hapticd")
    environment = Environment(tmp_path / "environment")
    environment.install("--editable", tree, cwd=tmp_path)
    (tmp_path / "show.py").write_text(SHOW)
    wanted = f"hapticd.client.blocking {tree / 'hapticd' / '__init__.py'}\n"
    for start in (["-c", SHOW], ["show.py"], ["-m", "show"]):
        assert environment.run("python", *start, cwd=tmp_path) == wanted, start
    assert environment.run("python", "-i", cwd=tmp_path, stdin=SHOW + "\n") == wanted
    for folder in (tmp_path, tree, Path("/")):
        assert environment.run("hapticd", "--version", cwd=folder).startswith("hapticd ")
        assert environment.run("python", "-m", "hapticd", "--version", cwd=folder).startswith("hapticd ")


def test_a_wheel_made_of_the_sdist_is_whole(tmp_path: Path) -> None:
    """Built without the tree it came from, installed without the tree it was built of, and used."""
    tree = clone(tmp_path / "tree")
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", tmp_path, tree]
    done = subprocess.run(build, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = tmp_path.glob("hapticd-*-cp311-abi3-linux_*.whl")
    (sdist,) = tmp_path.glob("hapticd-*.tar.gz")
    shutil.rmtree(tree)
    environment = Environment(tmp_path / "environment")
    environment.install(wheel, cwd=tmp_path)
    package = environment.packages / "hapticd"

    # Data: all that the tree has.
    for link, folder in (("shipped", "config"), ("units", "systemd")):
        wanted = {path.relative_to(ROOT / folder) for path in (ROOT / folder).rglob("*") if path.is_file()}
        found = {path.relative_to(package / link) for path in (package / link).rglob("*") if path.is_file()}
        assert found == wanted, link
    for folder in ("web/static", "experiment/published", "experiment/pages/static"):
        wanted = {
            path.relative_to(ROOT / "hapticd") for path in (ROOT / "hapticd" / folder).rglob("*") if path.is_file()
        }
        assert wanted and {name for name in wanted if not (package / name).is_file()} == set(), folder
    licences = next(environment.packages.glob("hapticd-*.dist-info")) / "licenses"
    wanted = {Path("LICENSE"), *(ROOT / "hapticd/web/static/vendor").glob("*/LICENSE")}
    assert len(wanted) == 3 and all((licences / (ROOT / name).relative_to(ROOT)).is_file() for name in wanted)
    assert (package / "py.typed").exists() and (package / "_core.pyi").exists()
    assert not [name for name in ("tests", "bench", "config", "csrc") if (environment.packages / name).exists()]
    with tarfile.open(sdist) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    assert {"csrc/api/hd_api.h", "config/default.yaml", "docs/protocol.md", "tests/conftest.py", "Makefile"} < packed
    assert {"docs/tables.py", "examples/demo/__main__.py", "bench/__main__.py"} < packed

    # Commands.
    home = tmp_path / "home"
    home.mkdir()
    assert environment.run("hapticd", "--version", cwd=home) == f"hapticd {__version__}\n"
    (home / "tap.yaml").write_text("gesture: {kind: tap, object: wood, speed_m_per_s: 0.1}\n")
    scene = package / "shipped" / "scenes" / "materials.yaml"
    environment.run("hapticd", "simulate", scene, "--operator", "tap.yaml", "-o", "tap.npz", cwd=home)
    assert (home / "tap.npz").stat().st_size > 1000
    floor = "{'kind': 'wall', 'point_m': [0, 0], 'normal': [0, 1], 'material': 'wood'}"
    render = (
        f"import hapticd; s = hapticd.render({{'scene': {{'objects': {{'floor': {floor}}}}}}}, [[0, -0.001]] * 300)"
    )
    assert float(environment.run("python", "-c", f"{render}; print(s['force_n'].max())", cwd=home)) > 0.5

    # Man pages and completion, where the prefix has them.
    for shell, place in SCRIPT_PATH_BY_SHELL.items():
        assert (environment.folder / place).read_text() == environment.run("hapticd", "completion", shell, cwd=home)
    assert {path.stem for path in (environment.folder / "share/man/man1").iterdir()} == page_names()
    if shutil.which("man") is None:
        pytest.skip("all but man itself, which is not installed")
    found_at = subprocess.run(
        ["man", "-w", "hapticd-simulate"],
        env={**os.environ, "MANPATH": str(environment.folder / "share/man")},
        capture_output=True,
        text=True,
    )
    assert found_at.stdout.strip() == str(environment.folder / "share/man/man1/hapticd-simulate.1")
