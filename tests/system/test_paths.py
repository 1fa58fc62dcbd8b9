"""Where sockets are, and whom a runtime directory may belong to."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.system.paths import check_directory, daemon_paths, make_directory, runtime_paths


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
def test_the_environment_says_where(environment: dict[str, str], directory: str) -> None:
    paths = runtime_paths(environ=environment)
    assert paths.directory == Path(directory)
    assert paths.command_endpoint == f"ipc://{directory}/hapticd.command"
    assert paths.telemetry_endpoint == f"ipc://{directory}/hapticd.telemetry"
    assert paths.lock == Path(directory, "hapticd.lock")
    assert runtime_paths("/elsewhere", environment).directory == Path("/elsewhere")


def test_a_relative_directory_is_made_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert runtime_paths("run").directory == tmp_path / "run"


def test_the_longest_socket_name_is_107_bytes() -> None:
    longest = "/" + "d" * (107 - len("//hapticd.telemetry"))
    assert len(str(runtime_paths(longest).telemetry)) == 107
    with pytest.raises(HapticdError, match="108 bytes"):
        runtime_paths(longest + "d")


def test_a_new_directory_is_for_us_alone(tmp_path: Path) -> None:
    paths = runtime_paths(tmp_path / "parent" / "run")
    make_directory(paths)
    assert stat.S_IMODE(paths.directory.stat().st_mode) == 0o700
    assert stat.S_IMODE(paths.directory.parent.stat().st_mode) == 0o700
    make_directory(paths)


@pytest.mark.parametrize("umask", [0o000, 0o117, 0o177, 0o777])
def test_a_new_directory_can_be_entered_from_the_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, umask: int
) -> None:
    seen: dict[str, int] = {}

    def mkdir(path: str | os.PathLike[str], mode: int = 0o777) -> None:
        make(path, mode)
        seen[Path(path).name] = stat.S_IMODE(os.stat(path).st_mode)

    make = os.mkdir
    monkeypatch.setattr(os, "mkdir", mkdir)
    before = os.umask(umask)
    try:
        make_directory(runtime_paths(tmp_path / "outer" / "inner" / "run"))
        assert os.umask(umask) == umask, "the umask is as it was"
    finally:
        os.umask(before)
    assert seen == {"outer": 0o700, "inner": 0o700, "run": 0o700}


def test_a_directory_that_a_group_may_enter_is_kept(tmp_path: Path) -> None:
    paths = runtime_paths(tmp_path / "run")
    paths.directory.mkdir()
    paths.directory.chmod(0o750)
    make_directory(paths)
    assert stat.S_IMODE(paths.directory.stat().st_mode) == 0o750, "what somebody chose is kept"


def test_an_open_directory_is_closed(tmp_path: Path) -> None:
    paths = runtime_paths(tmp_path / "run")
    paths.directory.mkdir()
    paths.directory.chmod(0o755)
    make_directory(paths)
    assert stat.S_IMODE(paths.directory.stat().st_mode) == 0o700


def test_what_others_may_write_to_is_refused(tmp_path: Path) -> None:
    paths = runtime_paths(tmp_path / "run")
    paths.directory.mkdir()
    paths.directory.chmod(0o777)
    with pytest.raises(HapticdError, match="others may write to it"):
        make_directory(paths)


def test_links_and_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with pytest.raises(HapticdError, match="is a symbolic link"):
        make_directory(runtime_paths(tmp_path / "link"))
    (tmp_path / "file").touch()
    with pytest.raises(HapticdError, match="is not a directory"):
        make_directory(runtime_paths(tmp_path / "file"))
    with pytest.raises(HapticdError, match="/file: File exists"):
        make_directory(runtime_paths(tmp_path / "file" / "run"))
    with pytest.raises(HapticdError, match="No such file"):
        check_directory(runtime_paths(tmp_path / "nowhere"))


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
    with pytest.raises(HapticdError, match="is a symbolic link"):
        daemon_paths()
    assert daemon_paths(link).directory == link, "what was named is taken"
