"""The daemon's sockets have their final names from the beginning, in the file system and in the kernel."""

from __future__ import annotations

import os
import shutil
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.daemon.process import run
from hapticd.protocol.calls import DaemonNotRunning
from hapticd.protocol.places import probe
from hapticd.system.paths import Owned, RuntimePaths, owned, runtime_paths


@pytest.fixture
def paths(tmp_path: Path) -> Iterator[RuntimePaths]:
    """A directory that nobody has locked, with the umask of a daemon."""
    (tmp_path / "run").mkdir(mode=0o700)
    before = os.umask(0o007)
    yield runtime_paths(tmp_path / "run")
    os.umask(before)


def bound(directory: Path) -> set[str]:
    """Return the names of the sockets in a directory, as the kernel lists them."""
    names = (line.split()[-1] for line in Path("/proc/net/unix").read_text().splitlines())
    return {name for name in names if name.startswith(f"{directory}/")}


def take(paths: RuntimePaths) -> None:
    with owned(paths):
        pass


def test_a_new_directory_is_for_us_alone(tmp_path: Path) -> None:
    paths = runtime_paths(tmp_path / "parent" / "run")
    take(paths)
    assert stat.S_IMODE(paths.directory.stat().st_mode) == 0o700
    assert stat.S_IMODE(paths.directory.parent.stat().st_mode) == 0o700


def test_a_directory_that_a_group_may_enter_is_kept(tmp_path: Path) -> None:
    paths = runtime_paths(tmp_path / "run")
    paths.directory.mkdir()
    paths.directory.chmod(0o750)
    take(paths)
    assert stat.S_IMODE(paths.directory.stat().st_mode) == 0o750, "what somebody chose is kept"


def test_an_open_directory_is_closed(tmp_path: Path) -> None:
    paths = runtime_paths(tmp_path / "run")
    paths.directory.mkdir()
    paths.directory.chmod(0o755)
    take(paths)
    assert stat.S_IMODE(paths.directory.stat().st_mode) == 0o700


def test_a_directory_that_others_may_write_to_is_refused(tmp_path: Path) -> None:
    paths = runtime_paths(tmp_path / "run")
    paths.directory.mkdir()
    paths.directory.chmod(0o777)
    with pytest.raises(HapticdError, match="other users may write to it"):
        take(paths)


def test_links_and_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with pytest.raises(HapticdError, match="not a symbolic link"):
        take(runtime_paths(tmp_path / "link"))
    (tmp_path / "file").touch()
    with pytest.raises(HapticdError, match="must be a directory"):
        take(runtime_paths(tmp_path / "file"))
    with pytest.raises(HapticdError, match="/file/run: Not a directory"):
        take(runtime_paths(tmp_path / "file" / "run"))


def test_the_kernel_has_the_name_that_the_file_has(paths: RuntimePaths) -> None:
    with Owned(paths).listen(paths.command) as listening:
        assert bound(paths.directory) == {str(paths.command)}
        assert listening.getsockname() == str(paths.command)
        assert stat.S_IMODE(os.lstat(paths.command).st_mode) == 0o660
        assert os.listdir(paths.directory) == ["hapticd.command"]


@pytest.mark.skipif(shutil.which("systemd-tmpfiles") is None, reason="needs systemd-tmpfiles")
def test_systemd_tmpfiles_leaves_a_socket_that_somebody_listens_to(paths: RuntimePaths, tmp_path: Path) -> None:
    """This holds even without the lock, which a rule of another user may not see."""
    rule = tmp_path / "rule.conf"
    rule.write_text(f"d {paths.directory} 0700 - - 0\n")
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(paths.telemetry))
    with Owned(paths).listen(paths.command):
        subprocess.run(["systemd-tmpfiles", "--clean", rule], check=True)
        assert os.listdir(paths.directory) == ["hapticd.command"], "the dead one has gone"
        probe(paths)


def test_sockets_of_a_killed_daemon_are_replaced(paths: RuntimePaths) -> None:
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(paths.command))
    with Owned(paths).listen(paths.command):
        probe(paths)


def test_a_socket_is_known_as_ours_before_anybody_can_be_connected(
    paths: RuntimePaths, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, known = Owned(paths), []

    class Watched(socket.socket):
        def listen(self, *backlog: int) -> None:
            known.append(mine.is_ours(paths.command))
            super().listen(*backlog)

    monkeypatch.setattr("hapticd.system.paths.socket.socket", Watched)
    with mine.listen(paths.command):
        assert known == [True]


def test_a_name_that_cannot_be_taken_is_one_line(paths: RuntimePaths) -> None:
    paths.command.mkdir()
    with pytest.raises(HapticdError, match=r"hapticd\.command: cannot bind the socket: Is a directory$"):
        Owned(paths).listen(paths.command)


def test_a_client_that_connects_between_bind_and_listen_is_accepted(
    paths: RuntimePaths, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX) as starting:
        starting.bind(str(paths.command))
        monkeypatch.setattr(time, "sleep", lambda _: starting.listen())
        probe(paths)


def test_a_socket_without_a_listener_is_not_a_daemon(paths: RuntimePaths) -> None:
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(paths.command))
        with pytest.raises(DaemonNotRunning, match="no daemon at"):
            probe(paths)


def test_a_daemon_that_fails_to_start_leaves_no_socket(paths: RuntimePaths) -> None:
    with pytest.raises(HapticdError, match="refused"), owned(paths) as mine, mine.listen(paths.telemetry):
        raise HapticdError("real time is refused")
    assert os.listdir(paths.directory) == ["hapticd.lock"]


def test_a_daemon_that_cannot_start_leaves_the_process_as_it_was(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("device: {kind: hid, hid: {path: /dev/none}}\n")
    before = os.umask(0o022)
    interval_s = sys.getswitchinterval()
    try:
        with pytest.raises(HapticdError, match="/dev/none"):
            run([config], tmp_path / "run")
        assert os.umask(0o022) == 0o022
        assert sys.getswitchinterval() == interval_s
    finally:
        os.umask(before)
