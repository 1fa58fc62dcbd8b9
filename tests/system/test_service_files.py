"""`hapticd install-service` into a temporary root, and systemd's verdict on the units."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.config.configuration import default_config, load_config
from hapticd.system.paths import SYSTEM_DIRECTORY
from hapticd.system.service_files import Action, Installation, run, unit_word

ROOT = Path(__file__).parents[2]
HERE = Installation(Path("/opt/hapticd/bin/hapticd"), (Path("/opt/hapticd"),))
UNITS = ("hapticd.service", "hapticd-web.service")
DAEMON = "etc/systemd/system/hapticd.service"
CONFIG = "etc/hapticd/config.yaml"
FILES = {
    DAEMON,
    "etc/systemd/system/hapticd-web.service",
    "etc/sysusers.d/hapticd.conf",
    "etc/tmpfiles.d/hapticd.conf",
    "etc/udev/rules.d/70-hapticd.rules",
    "etc/udev/rules.d/70-hapticd-idle.rules",
    CONFIG,
}


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


def installed(installation: Installation, root: Path, action: Action = "system", dry_run: bool = False) -> list[str]:
    """Return the lines of an installation below `root`."""
    return run(action, installation, root, dry_run)


def test_files_are_installed_and_each_command_is_printed(tmp_path: Path) -> None:
    lines = installed(HERE, tmp_path)
    assert files(tmp_path) == FILES
    assert [line.split()[-1] for line in lines if line.startswith("install ")] == [line.split()[-1] for line in lines]
    assert {os.path.relpath(line.split()[-1], tmp_path) for line in lines} == FILES
    for name in FILES:
        assert os.stat(tmp_path / name).st_mode & 0o777 == 0o644
    unit = (tmp_path / DAEMON).read_text()
    assert "ExecStart=/opt/hapticd/bin/hapticd run -c /etc/hapticd/config.yaml\n" in unit
    assert "ExecStopPost=/opt/hapticd/bin/hapticd stop-device\n" in unit
    assert "/usr/bin/hapticd" not in unit
    assert load_config([tmp_path / CONFIG]) == default_config()


def test_a_second_installation_replaces_all_but_the_configuration(tmp_path: Path) -> None:
    installed(HERE, tmp_path)
    for name in (DAEMON, CONFIG):
        (tmp_path / name).write_text("# mine\n")
    installed(Installation(Path("/usr/local/bin/hapticd"), ()), tmp_path)
    assert "ExecStart=/usr/local/bin/hapticd run" in (tmp_path / DAEMON).read_text()
    assert (tmp_path / CONFIG).read_text() == "# mine\n"


def test_a_masked_unit_does_not_lead_into_a_device(tmp_path: Path) -> None:
    """`systemctl mask` replaces a unit by a link to /dev/null."""
    (tmp_path / "device").touch()
    (tmp_path / DAEMON).parent.mkdir(parents=True)
    (tmp_path / DAEMON).symlink_to(tmp_path / "device")
    installed(HERE, tmp_path)
    assert not (tmp_path / DAEMON).is_symlink() and (tmp_path / "device").read_bytes() == b""


def test_uninstall(tmp_path: Path) -> None:
    installed(HERE, tmp_path)
    installed(HERE, tmp_path, "remove-system")
    assert files(tmp_path) == {CONFIG}
    installed(HERE, tmp_path, "remove-system")
    assert files(tmp_path) == {CONFIG}


def test_a_dry_run_changes_nothing(tmp_path: Path) -> None:
    lines = installed(HERE, tmp_path, dry_run=True)
    assert files(tmp_path) == set()
    assert installed(HERE, tmp_path) == lines
    installed(HERE, tmp_path, "remove-system", dry_run=True)
    assert files(tmp_path) == FILES


def test_another_root_leaves_the_running_system_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only install and rm are run: the names of all other commands lead to a program that fails."""
    tools = tmp_path / "bin"
    tools.mkdir()
    for name in ("systemctl", "udevadm", "systemd-sysusers", "systemd-tmpfiles"):
        (tools / name).write_text("#!/bin/sh\nexit 1\n")
        (tools / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}:{os.environ['PATH']}")
    installed(HERE, tmp_path / "root")
    installed(HERE, tmp_path / "root", "remove-system")


def test_a_command_that_fails_is_reported(tmp_path: Path) -> None:
    (tmp_path / "etc").write_text("no folder\n")
    with pytest.raises(HapticdError, match=r"^install: cannot create directory") as caught:
        installed(HERE, tmp_path)
    assert "\n" not in str(caught.value)


def test_for_one_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    assert len(run("user", HERE)) == 2
    assert files(tmp_path) == {"systemd/user/hapticd.service", "hapticd/config.yaml"}
    unit = (tmp_path / "systemd/user/hapticd.service").read_text()
    assert "ExecStart=/opt/hapticd/bin/hapticd run -c %E/hapticd/config.yaml\n" in unit
    assert "User=" not in unit and "multi-user.target" not in unit
    run("remove-user", HERE)
    assert files(tmp_path) == {"hapticd/config.yaml"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_without_rights_the_error_has_a_hint() -> None:
    with pytest.raises(HapticdError, match=r"Permission denied; run it as root, or .* with --user$"):
        run("system", HERE)


def test_the_units_use_the_directory_of_the_system_service() -> None:
    daemon, page = ((ROOT / "systemd" / name).read_text() for name in UNITS)
    assert f"\nRuntimeDirectory={SYSTEM_DIRECTORY.relative_to('/run')}\n" in daemon
    assert f" --runtime-dir {SYSTEM_DIRECTORY} web\n" in page


@pytest.mark.parametrize("name", [*UNITS, "hapticd.user.service"])
def test_a_service_that_cannot_start_is_never_given_up(name: str) -> None:
    """systemd gives up after StartLimitBurst starts within StartLimitIntervalSec."""
    unit = dict(line.split("=", 1) for line in (ROOT / "systemd" / name).read_text().splitlines() if "=" in line)
    assert unit["Restart"] == "on-failure"
    assert float(unit["StartLimitIntervalSec"]) / float(unit["RestartSec"]) < float(unit["StartLimitBurst"])


# ---- Paths -----------------------------------------------------------------------------------------------------------


def test_an_installation_in_a_home_is_let_into_the_sandbox_and_nothing_else_of_it(tmp_path: Path) -> None:
    home = Installation(Path("/home/ann/h 1/bin/hapticd"), (Path("/home/ann/h 1"), Path("/opt/python")))
    installed(home, tmp_path)
    for name in UNITS:
        unit = (tmp_path / "etc/systemd/system" / name).read_text()
        assert "\nProtectHome=tmpfs\n" in unit and "ProtectHome=yes" not in unit
        assert '\nBindReadOnlyPaths="/home/ann/h 1"\n' in unit
        assert "/opt/python" not in unit
        assert 'ExecStart="/home/ann/h 1/bin/hapticd" ' in unit


@pytest.mark.parametrize(
    ("path", "word"), [("/a/b", "/a/b"), ("/a/b c", '"/a/b c"'), ("/a/50%", "/a/50%%"), ("/a/é", "/a/é")]
)
def test_words_of_a_unit_file(path: str, word: str) -> None:
    assert unit_word(Path(path)) == word


@pytest.mark.parametrize("path", ["/a/$x", "/a:b", "/a/;", "/a'b", '/a"b', "/a\\b", "/a\nb"])
def test_paths_that_a_unit_file_cannot_name_are_refused(path: str) -> None:
    with pytest.raises(HapticdError, match="install hapticd elsewhere"):
        unit_word(Path(path))


def test_this_installation_is_found_or_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["python"])
    neighbour = Path(sys.executable).parent / "hapticd"
    if not neighbour.exists():
        with pytest.raises(HapticdError, match="no executable `hapticd` in "):
            Installation.this()
    (tmp_path / "hapticd").write_text("#!/bin/sh\n")
    (tmp_path / "hapticd").chmod(0o755)
    found = Installation.this()
    assert found.executable == (neighbour if neighbour.exists() else tmp_path / "hapticd")
    assert any(ROOT.is_relative_to(folder) for folder in found.folders)
    assert not any(one != two and one.is_relative_to(two) for one in found.folders for two in found.folders)


# ---- The command -----------------------------------------------------------------------------------------------------


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(Installation, "this", staticmethod(lambda: HERE))
    assert main(["install-service", "--root", str(tmp_path)]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(FILES)
    assert main(["install-service", "--root", str(tmp_path), "--uninstall"]) == 0
    assert files(tmp_path) == {CONFIG}
    capsys.readouterr()
    assert main(["install-service", "--root", str(tmp_path), "--user"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


# ---- The package -----------------------------------------------------------------------------------------------------


def test_the_package_carries_every_file() -> None:
    import tomllib

    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["hapticd"]
    matched = {path.name for pattern in data for path in (ROOT / "hapticd").glob(pattern) if "units" in pattern}
    assert matched == set(os.listdir(ROOT / "systemd"))


# ---- systemd's own word ----------------------------------------------------------------------------------------------

analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")


@analyze
@pytest.mark.parametrize("home", [False, True])
def test_the_units_are_valid(tmp_path: Path, home: bool) -> None:
    """The root has systemd's units, the users and an executable."""
    executable = Path("/home/ann/v 1/bin/hapticd") if home else Path("/opt/hapticd/bin/hapticd")
    installed(Installation(executable, (executable.parents[1],)), tmp_path)
    for program in (tmp_path / executable.relative_to("/"), tmp_path / "bin" / "kill"):
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    (tmp_path / "usr/lib/systemd").mkdir(parents=True)
    places = [Path(place) for place in ("/usr/lib/systemd/system", "/lib/systemd/system")]
    shutil.copytree(
        next(place for place in places if place.exists()), tmp_path / "usr/lib/systemd/system", symlinks=True
    )
    words = ["systemd-analyze", "verify", f"--root={tmp_path}", *UNITS]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    warnings = [line for line in done.stderr.splitlines() if "hapticd" in line]
    assert (done.returncode, warnings) == (0, [])


@analyze
@pytest.mark.parametrize(("name", "limit"), [("hapticd.service", 1.0), ("hapticd-web.service", 1.6)])
def test_the_units_are_exposed_as_little_as_promised(name: str, limit: float) -> None:
    path = str(ROOT / "systemd" / name)
    words = ["systemd-analyze", "security", "--offline=true", f"--threshold={round(10 * limit)}", "--no-pager", path]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
    (line,) = [line for line in done.stdout.splitlines() if "Overall exposure level" in line]
    exposure = float(line.split(":")[1].split()[0])
    assert exposure <= limit
    # The documentation has the same figure.
    page = (ROOT / "docs" / "service.md").read_text()
    assert f"| `{name}` | {exposure:g} |" in page
