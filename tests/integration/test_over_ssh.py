"""A daemon on another machine: its two sockets through an SSH server on loopback, as docs/remote.md says."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hapticd.cli import main
from tests.support.daemon_process import Daemon, connect, listens, running_daemon, until

pytestmark = pytest.mark.slow


def sshd() -> str:
    """The server's program; skips, or fails where HAPTICD_CLIENTS=required is set, without one."""
    found = shutil.which("sshd", path=f"{os.environ['PATH']}:/usr/sbin")
    if found is None or shutil.which("ssh") is None:
        line = "docs/remote.md needs ssh and sshd (Debian: apt install openssh-server openssh-client)"
        if os.environ.get("HAPTICD_CLIENTS") == "required":
            pytest.fail(line, pytrace=False)
        pytest.skip(line)
    return found


@contextmanager
def forwarded(daemon: Daemon, folder: Path) -> Iterator[Path]:
    """The folder of the forwarded sockets, while a server and a client of SSH run."""
    server = sshd()
    for name in ("host", "ours"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)], check=True)
    shutil.copy(folder / "ours.pub", folder / "authorized_keys")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    (folder / "sshd_config").write_text(
        f"ListenAddress 127.0.0.1:{port}\nHostKey {folder}/host\nAuthorizedKeysFile {folder}/authorized_keys\n"
        f"PidFile none\nStrictModes no\nUsePAM no\n"
    )
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)  # without it sshd as root refuses to start
    near = folder / "near"
    near.mkdir(mode=0o700)
    command = ["ssh", "-nNT", "-F", "none", "-p", str(port), "-i", str(folder / "ours"), "-o", "BatchMode=yes"]
    command += ["-o", "ExitOnForwardFailure=yes", "-o", "ConnectionAttempts=60", "-o", "StrictHostKeyChecking=no"]
    command += ["-o", f"UserKnownHostsFile={folder}/known_hosts"]
    for name in ("hapticd.command", "hapticd.telemetry"):
        command += ["-L", f"{near / name}:{daemon.directory / name}"]
    with (
        open(folder / "log", "wb") as log,
        subprocess.Popen([server, "-D", "-e", "-f", str(folder / "sshd_config")], stderr=log) as serving,
        subprocess.Popen([*command, f"{getpass.getuser()}@127.0.0.1"], stderr=log) as forwarding,
    ):
        try:
            until(lambda: listens(near / "hapticd.telemetry") or forwarding.poll() is not None)
            assert forwarding.poll() is None, (folder / "log").read_text()
            yield near
        finally:
            forwarding.terminate()
            serving.terminate()


def test_commands_and_every_sample_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with running_daemon() as daemon, forwarded(daemon, tmp_path) as near:
        assert main(["--runtime-dir", str(near), "status"]) == 0
        assert "running" in capsys.readouterr().out
        with connect(near) as client, client.samples() as samples:
            client.set_scene({"objects": {}}, wait=True)
            first = next(samples)
            ticks = [first["tick"][0], first["tick"][-1]]
            while ticks[-1] - ticks[0] < 10_000:
                batch = next(samples)
                assert batch.lost == 0 and batch["tick"][0] > ticks[-1]
                ticks.append(batch["tick"][-1])


def test_the_flight_recorder_s_file_is_on_the_daemon_s_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Here both are one machine, so that what is in it can be told."""
    with running_daemon() as daemon, forwarded(daemon, tmp_path) as near:
        assert main(["--runtime-dir", str(near), "record", "--past", str(tmp_path / "copy.npz")]) == 0
    assert "ticks in" in capsys.readouterr().out and (tmp_path / "copy.npz").exists()


def test_an_ssh_that_ends_is_a_daemon_that_is_gone(tmp_path: Path) -> None:
    with running_daemon() as daemon:
        with forwarded(daemon, tmp_path) as near, connect(near) as client:
            assert client.get_status()["device"] == "sim"
        assert main(["--runtime-dir", str(near), "status"]) == 1
        assert daemon.process.poll() is None
