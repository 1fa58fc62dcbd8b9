"""The paths of sockets, and the owner of a runtime directory."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.system.paths import check_directory, daemon_paths, runtime_paths


@pytest.mark.parametrize(
    ("environment", "directory"),
    [
        (
            {"HAPTICD_RUNTIME_DIR": "/mine", "RUNTIME_DIRECTORY": "/run/hapticd", "XDG_RUNTIME_DIR": "/run/user/7"},
            "/mine",
        ),
        ({"HAPTICD_RUNTIME_DIR": "", "RUNTIME_DIRECTORY": "/run/hapticd"}, "/run/hapticd"),
        ({"RUNTIME_DIRECTORY": "/run/hapticd", "XDG_RUNTIME_DIR": "/run/user/7"}, "/run/hapticd"),
        ({"RUNTIME_DIRECTORY": "/run/hapticd:/run/other"}, "/run/hapticd"),
        ({"XDG_RUNTIME_DIR": "/run/user/7"}, "/run/user/7/hapticd"),
        ({"RUNTIME_DIRECTORY": "", "XDG_RUNTIME_DIR": ""}, f"/tmp/hapticd-{os.getuid()}"),
        ({}, f"/tmp/hapticd-{os.getuid()}"),
    ],
)
def test_the_environment_selects_the_directory(
    environment: dict[str, str], directory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("HAPTICD_RUNTIME_DIR", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    paths = runtime_paths()
    assert paths.directory == Path(directory)
    assert paths.command_endpoint == f"ipc://{directory}/hapticd.command"
    assert paths.telemetry_endpoint == f"ipc://{directory}/hapticd.telemetry"
    assert paths.lock == Path(directory, "hapticd.lock")
    assert runtime_paths("/elsewhere").directory == Path("/elsewhere")


def test_a_relative_directory_is_made_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert runtime_paths("run").directory == tmp_path / "run"


def test_the_longest_socket_name_is_107_bytes() -> None:
    longest = "/" + "d" * (107 - len("//hapticd.telemetry"))
    assert len(str(runtime_paths(longest).telemetry)) == 107
    with pytest.raises(HapticdError, match="108 bytes"):
        runtime_paths(longest + "d")


def test_a_strangers_directory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = runtime_paths(tmp_path)
    tmp_path.chmod(0o700)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(HapticdError, match="belongs to user"):
        check_directory(paths)


def test_a_client_trusts_a_guessed_directory_only_if_it_is_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    link = tmp_path / "link"
    link.symlink_to(tmp_path)
    monkeypatch.setattr("hapticd.system.paths.Path", lambda *parts: link)
    with pytest.raises(HapticdError, match="not a symbolic link"):
        daemon_paths()
    assert daemon_paths(link).directory == link, "what was named is taken"
