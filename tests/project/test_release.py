"""The release: the workflow that builds wheels, its tag, the container, and README's three installations."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from dockerfile_parse import DockerfileParser

from hapticd import __version__

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
WORKFLOW = ROOT / ".github" / "workflows" / "wheels.yml"
CONTAINERFILE = ROOT / "packaging" / "Containerfile"
README = (ROOT / "README.md").read_text()
TRY_WHEEL = ROOT / "packaging" / "try_wheel.py"


def steps() -> list[str]:
    """Return the commands of the workflow's steps."""
    jobs = yaml.safe_load(WORKFLOW.read_text())["jobs"].values()
    return [step["run"] for job in jobs for step in job["steps"] if "run" in step]


# ---- The workflow ----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_workflow_is_valid_by_the_published_schema(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows"]
    done = subprocess.run([*command, WORKFLOW], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    wrong = tmp_path / "wrong.yml"
    wrong.write_text(WORKFLOW.read_text().replace("runs-on:", "runs-at:"))
    assert subprocess.run([*command, wrong], capture_output=True).returncode == 1


@pytest.mark.long
def test_cibuildwheel_would_build_one_wheel_for_each_architecture() -> None:
    command = [sys.executable, "-m", "cibuildwheel", "--print-build-identifiers", "--platform", "linux"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout.split()) == (0, ["cp311-manylinux_x86_64", "cp311-manylinux_aarch64"]), (
        done.stderr
    )
    matrix = yaml.safe_load(WORKFLOW.read_text())["jobs"]["wheel"]["strategy"]["matrix"]["include"]
    assert [each["arch"] for each in matrix] == PYPROJECT["tool"]["cibuildwheel"]["archs"]
    # The oldest Python that the package supports, whose ABI is that of all newer ones.
    oldest = PYPROJECT["project"]["requires-python"].removeprefix(">=").replace(".", "")
    assert PYPROJECT["tool"]["cibuildwheel"]["build"].startswith(f"cp{oldest}-")
    assert f'"py_limited_api": "cp{oldest}"' in (ROOT / "setup.py").read_text()


def test_files_that_the_workflow_names_exist() -> None:
    commands = "\n".join([*steps(), PYPROJECT["tool"]["cibuildwheel"]["test-command"]])
    named = set(re.findall(r"\bpackaging/\w+\.py", commands))
    assert named == {"packaging/version_tag.py", "packaging/first_tap.py"}
    assert all((ROOT / name).is_file() for name in named)


@pytest.mark.long
def test_a_version_tag_is_that_of_the_package() -> None:
    def check(*tag: str) -> tuple[int, str]:
        command = [sys.executable, ROOT / "packaging" / "version_tag.py", *tag]
        done = subprocess.run(command, cwd="/", capture_output=True, text=True)
        return done.returncode, done.stderr

    assert check(f"v{__version__}") == (0, "")
    expected = f"hapticd/_version.py says {__version__}, whose tag is v{__version__}\n"
    for wrong in (__version__, f"v{__version__}.1", f"v{__version__}rc1", "v", ""):
        assert check(wrong) == (1, f"tag {wrong}: {expected}")
    assert check() == (1, "usage: version_tag.py TAG\n")
    assert [step for step in steps() if "version_tag.py" in step] == [
        'python3 packaging/version_tag.py "$GITHUB_REF_NAME"'
    ]


# ---- The container ---------------------------------------------------------------------------------------------------


def instructions() -> list[tuple[str, str]]:
    """Return each instruction of the Containerfile with its arguments."""
    with CONTAINERFILE.open("rb") as file:
        structure = DockerfileParser(fileobj=file).structure
    return [(each["instruction"], each["value"]) for each in structure if each["instruction"] != "COMMENT"]


def test_the_container_is_built_in_two_stages_and_runs_as_an_ordinary_user() -> None:
    found = instructions()
    assert [value for name, value in found if name == "FROM"] == ["${BASE} AS build", "${BASE}"]
    last = found[max(at for at, (name, _) in enumerate(found) if name == "FROM") :]
    values = dict(last)
    assert values["USER"] == "hapticd" and "useradd --system" in values["RUN"]
    assert values["VOLUME"] == "/run/hapticd" and "HAPTICD_RUNTIME_DIR=/run/hapticd" in values["ENV"]
    assert (values["ENTRYPOINT"], values["CMD"]) == ('["hapticd"]', '["run"]')
    # The second stage has neither compiler nor source, only the installation of the first stage.
    assert [value for name, value in last if name in ("COPY", "ADD")] == ["--from=build /opt/hapticd /opt/hapticd"]
    assert "apt-get" not in values["RUN"]


def test_the_context_of_the_container_has_what_a_build_reads() -> None:
    """The targets of the packages' links into the tree are included."""
    ignored = (ROOT / ".containerignore").read_text().splitlines()
    assert "*" in ignored
    taken = {line.removeprefix("!") for line in ignored if line.startswith("!")}
    assert taken == {name for name in taken if (ROOT / name).exists()}
    links = {str(link.resolve().relative_to(ROOT)) for link in (ROOT / "hapticd").iterdir() if link.is_symlink()}
    assert links == {"config", "systemd"} <= taken
    assert {"pyproject.toml", "setup.py", "csrc", "hapticd", "LICENSE", PYPROJECT["project"]["readme"]} <= taken
    assert "CHANGELOG.md" in taken  # the date of the man pages


def test_the_page_names_the_options_that_the_container_needs() -> None:
    page = (ROOT / "docs" / "install.md").read_text()
    for option in (
        "--device /dev/hidraw",
        "--cap-add SYS_NICE",
        "--ulimit rtprio=",
        "--ulimit memlock=-1",
        "-f packaging/Containerfile",
    ):
        assert option in page, option


# ---- README's ways to install ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ways() -> list[list[str]]:
    """Return the commands of each block of README's section Install."""
    text = README.partition("\n## Install\n")[2].partition("\n## ")[0]
    return [block.split("\n    ") for block in re.findall(r"(?:^|\n)\n    ((?:.+\n    )*.+)\n", text)]


def test_every_installation_takes_at_most_three_commands_to_the_first_tap(ways: list[list[str]]) -> None:
    assert len(ways) == 3
    for commands in ways:
        assert len(commands) <= 3 and commands[-1].endswith("hapticd simulate materials"), commands


def test_the_tests_of_installations_run_the_commands_of_the_page(ways: list[list[str]]) -> None:
    """The wheel is installed in every Python (make wheel-test), the clone by a fresh user (.ci/run)."""
    wheel, _, clone = ways
    program = f"import runpy; print(runpy.run_path({str(TRY_WHEEL)!r}, run_name='tried')['block'](), end='')"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout.splitlines()) == (0, wheel), done.stderr
    assert " && ".join(clone) in (ROOT / ".ci" / "run").read_text()
