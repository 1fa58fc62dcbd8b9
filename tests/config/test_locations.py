"""Where the configuration is searched, and that an unreadable file is an error."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.cli import main
from hapticd.config import locations
from hapticd.config.configuration import config_of, default_config
from hapticd.config.locations import choose, user_config
from tests.support.cli import said


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Set up a machine without a configuration, whose HOME is below the current folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("HAPTICD_CONFIG", "XDG_CONFIG_HOME", "RUNTIME_DIRECTORY", "STATE_DIRECTORY", "HAPTICD_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(locations, "SYSTEM_CONFIG", tmp_path / "etc" / "config.yaml")
    return tmp_path / "home"


def written(path: Path, rate_hz: int) -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"servo: {{rate_hz: {rate_hz}}}\n")
    return str(path)


def test_the_order(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert choose().origin == "built in"
    assert config_of() is default_config()
    system = written(locations.SYSTEM_CONFIG, 1001)
    assert config_of().servo.rate_hz == 1001
    assert choose() == locations.ConfigFiles("system", (system,), (f"{home}/.config/hapticd/config.yaml",))
    user = written(home / ".config/hapticd/config.yaml", 1002)
    assert choose().files == (user,)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home / "xdg"))
    assert choose().files == (system,)
    other = written(home / "xdg/hapticd/config.yaml", 1003)
    assert choose().files == (other,)
    first, second = written(home / "a.yaml", 1004), written(home / "b.yaml", 1005)
    monkeypatch.setenv("HAPTICD_CONFIG", f"{first}:{second}")
    assert choose() == locations.ConfigFiles("environment", (first, second), ())
    assert config_of().servo.rate_hz == 1005
    assert choose([first]) == locations.ConfigFiles("-c", (first,), ())
    assert config_of([first]).servo.rate_hz == 1004
    monkeypatch.setenv("HAPTICD_CONFIG", "")
    assert choose().files == (other,)


def test_a_relative_folder_of_the_user_is_ignored(home: Path) -> None:
    assert user_config({"XDG_CONFIG_HOME": "etc"}) == home / ".config/hapticd/config.yaml"


def test_an_unreadable_file_is_an_error_and_not_skipped(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(locations.SYSTEM_CONFIG, 1001)
    user = home / ".config/hapticd/config.yaml"
    user.parent.mkdir(parents=True)
    user.symlink_to("nowhere")
    with pytest.raises(HapticdError, match=f"^{user}: cannot be read: No such file or directory$"):
        config_of()
    user.unlink()
    user.mkdir()
    with pytest.raises(HapticdError, match=f"^{user}: cannot be read: Is a directory$"):
        config_of()
    user.rmdir()
    user.write_text("servo: {rate: 1}\n")
    with pytest.raises(InvalidError, match=rf"^{user}:1:9: servo\.rate: unknown key; "):
        config_of()
    monkeypatch.setenv("HAPTICD_CONFIG", "gone.yaml")
    with pytest.raises(HapticdError, match=r"^gone\.yaml: no such file; HAPTICD_CONFIG names it$"):
        config_of()


COMMANDS = ["check", "run", "verify", "calibrate", "devices calibrate"]
COMMANDS += ["fit synthesize tap --material wood -o x.npz"]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_reports_a_missing_file(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setenv("HAPTICD_CONFIG", "gone.yaml")
    assert said(capsys, 1, *command.split()) == "hapticd: gone.yaml: no such file; HAPTICD_CONFIG names it\n"


def test_help_names_the_variables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "HAPTICD_CONFIG" in out and "[env var: HAPTICD_RUNTIME_DIR" in out
    for command in ("run", "check", "doctor"):
        assert main([command, "--help"]) == 0
        assert "[env var: HAPTICD_CONFIG" in " ".join(capsys.readouterr().out.split())


def test_paths(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--paths", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["configuration"] == {
        "origin": "built in",
        "files": [],
        "looked_for": [f"{home}/.config/hapticd/config.yaml", str(locations.SYSTEM_CONFIG)],
        "fault": None,
    }
    runtime = home.parent / "hapticd"
    assert found["runtime_directory"] == found["flight_files"] == str(runtime)
    assert found["command_socket"] == f"{runtime}/hapticd.command"
    assert found["telemetry_socket"] == f"{runtime}/hapticd.telemetry"
    shipped = {
        "scenes": "comb",
        "operators": "stroke",
        "materials": "okamura1998",
        "experiments": "jnd_frequency",
        "sweeps": "wall_stability",
    }
    for name, one in shipped.items():
        assert one in found[name]["names"]
        assert os.path.isfile(f"{found[name]['folder']}/{one}.yaml")
    assert os.path.isfile(f"{found['units']}/hapticd.service")
    assert not runtime.exists(), "nothing is made"


def test_paths_as_text(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--paths"]) == 0
    first, *rest = capsys.readouterr().out.splitlines()
    assert first == (
        f"configuration      built in; there is no {home}/.config/hapticd/config.yaml and no {locations.SYSTEM_CONFIG}"
    )
    assert f"command socket     {home.parent}/hapticd/hapticd.command (does not exist)" in rest
    assert any(re.match(r"shipped studies    /.*/experiments: .*\bjnd_frequency\b", line) for line in rest)
    user = written(home / ".config/hapticd/config.yaml", 1002)
    Path(user).write_text("flight: {directory: /var/tmp/flights}\n")
    assert main(["doctor", "--paths"]) == 0
    out = capsys.readouterr().out
    assert f"configuration      {user}\n" in out and "flight files       /var/tmp/flights" in out


def test_paths_with_a_configuration_that_cannot_be_read(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    user = written(home / ".config/hapticd/config.yaml", 1)
    assert main(["doctor", "--paths", "--json"]) == 1
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    fault = f"{user}:1:9: servo.rate_hz: should be greater than or equal to 1000, is 1"
    assert (found["configuration"]["files"], found["flight_files"]) == ([user], None)
    assert (found["configuration"]["fault"], captured.err) == (fault, "")
    assert main(["doctor", "--paths"]) == 1
    captured = capsys.readouterr()
    first, second, *rest = captured.out.splitlines()
    assert (first, second) == (f"configuration      {user}", f"its fault          {fault}")
    assert "flight files       unknown" in rest and len(rest) == 10
    assert captured.err == "hapticd: the configuration is faulty\n"


@pytest.mark.parametrize("command", ["paths", "doctor"])
def test_a_missing_file_is_one_line_of_the_output(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    main([command])
    sound = len(capsys.readouterr().out.splitlines())
    monkeypatch.setenv("HAPTICD_CONFIG", "gone.yaml")
    assert main([command]) == 1
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert sum("gone.yaml: no such file; HAPTICD_CONFIG names it" in line for line in lines) == 1
    assert len(lines) >= sound
    assert len(captured.err.splitlines()) == 1
