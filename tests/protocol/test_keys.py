"""Key files, and addresses of bridges."""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path

import pytest
import zmq
import zmq.auth
from click.testing import CliRunner
from zmq.utils import z85

from hapticd.base.errors import HapticdError
from hapticd.bridge.config import load_bridge
from hapticd.cli import cli, main
from hapticd.protocol.keys import (
    Certificate,
    is_key,
    load_certificate,
    load_secret,
    new_certificate,
    public_key_of,
    write_certificate,
)
from hapticd.protocol.places import place_of
from hapticd.protocol.remote import Named, host_and_port, is_loopback, remote


def test_the_files_are_those_of_czmq(tmp_path: Path) -> None:
    """Read by pyzmq's own reader of CZMQ's form."""
    certificate = new_certificate()
    public, secret = write_certificate(certificate, "alice", tmp_path / "keys")
    assert zmq.auth.load_certificate(public) == (certificate.public_key.encode(), None)
    assert certificate.secret_key is not None
    pair = certificate.public_key.encode(), certificate.secret_key.encode()
    assert zmq.auth.load_certificate(secret) == pair
    assert load_certificate(secret) == load_secret(secret) == certificate
    assert load_certificate(public) == Certificate(certificate.public_key)
    assert stat.S_IMODE(os.stat(secret).st_mode) == 0o600
    assert stat.S_IMODE(os.stat(secret.parent).st_mode) == 0o700
    assert certificate.secret_key not in repr(certificate)


def test_theirs_are_read(tmp_path: Path) -> None:
    public, secret = zmq.auth.create_certificates(tmp_path, "bob", {"email": "bob@example.com"})
    os.chmod(secret, 0o600)
    assert load_certificate(public).public_key.encode() == zmq.auth.load_certificate(public)[0]
    assert load_secret(secret).secret_key is not None


def test_a_key_is_never_replaced(tmp_path: Path) -> None:
    write_certificate(new_certificate(), "alice", tmp_path)
    before = (tmp_path / "alice.key_secret").read_bytes()
    with pytest.raises(HapticdError, match=r"alice\.key: is there already"):
        write_certificate(new_certificate(), "alice", tmp_path)
    assert (tmp_path / "alice.key_secret").read_bytes() == before
    for name in ("", "a/b", "..", "a b"):
        with pytest.raises(HapticdError, match="letters, digits"):
            write_certificate(new_certificate(), name, tmp_path)


@pytest.mark.parametrize("ending", ["key", "key_secret"])
def test_where_one_file_cannot_be_written_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    sync = os.fsync

    def full(fd: int) -> None:
        if os.readlink(f"/proc/self/fd/{fd}").endswith(f"alice.{ending}"):
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(fd)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(HapticdError, match="cannot be written: No space left on device"):
            write_certificate(new_certificate(), "alice", tmp_path)
    assert list(tmp_path.iterdir()) == []
    write_certificate(new_certificate(), "alice", tmp_path)


@pytest.mark.parametrize("mode", [0o644, 0o620, 0o604, 0o660])
def test_a_secret_that_others_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    _, secret = write_certificate(new_certificate(), "alice", tmp_path)
    os.chmod(secret, mode)
    with pytest.raises(HapticdError, match=r"others may (read|change)"):
        load_secret(secret)
    os.chmod(secret, 0o640)
    assert load_secret(secret)


@pytest.mark.parametrize("mode", [0o664, 0o646])
def test_a_public_key_that_others_may_change_is_refused(tmp_path: Path, mode: int) -> None:
    public, _ = write_certificate(new_certificate(), "alice", tmp_path)
    os.chmod(public, mode)
    with pytest.raises(HapticdError, match="others may change it"):
        public_key_of(public)


def test_a_path_that_could_be_a_key_is_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    certificate, path = new_certificate(), "keys/public-key-of-the-bridge-upstairs.k"
    assert is_key(path)
    public, _ = write_certificate(certificate, "server", tmp_path)
    (tmp_path / "keys").mkdir()
    public.rename(path)
    assert public_key_of(path) == certificate.public_key
    assert public_key_of(certificate.public_key) == certificate.public_key


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_keys_of_somebody_else_are_refused(tmp_path: Path) -> None:
    for path in write_certificate(new_certificate(), "alice", tmp_path):
        os.chown(path, 12345, -1)
        with pytest.raises(HapticdError, match="belongs to user 12345"):
            load_certificate(path)


def test_files_that_are_no_keys(tmp_path: Path) -> None:
    public, secret = write_certificate(new_certificate(), "alice", tmp_path)
    with pytest.raises(HapticdError, match="holds no secret-key"):
        load_secret(public)
    other = new_certificate().public_key
    text = secret.read_text()
    secret.write_text(text.replace(load_certificate(public).public_key, other))
    with pytest.raises(HapticdError, match="are no pair"):
        load_secret(secret)
    secret.write_text(text + f'    public-key = "{other}"\n')
    with pytest.raises(HapticdError, match=r"alice\.key_secret:\d+: public-key: stands there a second time"):
        load_secret(secret)
    secret.write_text('curve\n    public-key = "short"\n')
    with pytest.raises(HapticdError, match=r"alice\.key_secret:2: public-key: is no key"):
        load_secret(secret)
    secret.write_text("")
    with pytest.raises(HapticdError, match="holds no public-key"):
        load_secret(secret)
    with pytest.raises(HapticdError, match="cannot be read: No such file"):
        load_certificate(tmp_path / "nobody.key")


def test_what_is_a_key() -> None:
    """Against pyzmq's Z85, which does not look at the length and at what five characters are beyond 32 bits."""
    for _ in range(100):
        data = os.urandom(32)
        assert is_key(z85.encode(data).decode())
    # 85^5 - 1 in five characters is more than 2^32 - 1, which is "%nSc0" (ZeroMQ RFC 32).
    assert is_key("%nSc0" * 8)
    assert not is_key("%nSc1" + "0" * 35)
    for text in ("", "0" * 39, "0" * 41, "0" * 39 + "\n", "0" * 39 + '"', "0" * 39 + "~"):
        assert not is_key(text)


@pytest.mark.parametrize(
    ("address", "found"),
    [
        ("tcp://lab:9410", ("lab", 9410)),
        ("tcp://10.0.0.1", ("10.0.0.1", 7)),
        ("tcp://[::1]:80", ("::1", 80)),
        ("tcp://*:80", ("*", 80)),
    ],
)
def test_addresses(address: str, found: tuple[str, int]) -> None:
    assert host_and_port(address, 7) == found


@pytest.mark.parametrize("address", ["tcp://", "tcp://a b:1", "tcp://a:", "tcp://a:99999", "ipc:///x", "tcp://::1:80"])
def test_what_is_no_address(address: str) -> None:
    with pytest.raises(ValueError, match="must be tcp://HOST:PORT"):
        host_and_port(address, 7)


def test_loopback() -> None:
    assert all(map(is_loopback, ("127.0.0.1", "127.3.2.1", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "10.0.0.1", "*", "lab", "127.0.0.1.example.com")))


def test_a_bridge_needs_both_keys(tmp_path: Path) -> None:
    certificate = new_certificate()
    place = remote(Named("tcp://lab"), Named(certificate), Named(certificate.public_key))
    assert place.command_endpoint == "tcp://lab:9410"
    assert place.telemetry_endpoint == "tcp://lab:9411"
    assert (
        remote(Named("tcp://[::1]:5"), Named(certificate), Named(certificate.public_key)).telemetry_endpoint
        == "tcp://[::1]:6"
    )
    for keys in ((None, None), (certificate, None), (None, certificate.public_key)):
        with pytest.raises(HapticdError, match="needs key, the file of our secret key, and server_key"):
            place_of("tcp://lab", *keys)
    with pytest.raises(HapticdError, match="keys are for a bridge"):
        place_of(tmp_path, certificate)
    with pytest.raises(HapticdError, match="from 1 to 65534"):
        place_of("tcp://lab:65535", certificate, certificate.public_key)


def test_the_line_that_is_printed_lets_the_client_in(tmp_path: Path) -> None:
    def new(*arguments: str) -> str:
        done = CliRunner().invoke(cli, ["key", "new", *arguments, "--dir", str(tmp_path / "keys")])
        assert done.exit_code == 0, done.output
        return done.stdout

    new("server")
    lines = new("alice", "--command") + new("bob", "--watch")
    (tmp_path / "bridge.yaml").write_text("clients:\n" + lines)
    config = load_bridge(tmp_path / "bridge.yaml")
    rights = {name: client.may for name, client in config.clients.items()}
    assert rights == {"alice": "command", "bob": "watch"}
    assert config.clients["bob"].public_key == load_certificate(tmp_path / "keys" / "bob.key").public_key
    assert load_secret(config.server_key)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--key", "x", "status"], "--key is for --connect"),
        (["--connect", "tcp://lab", "--runtime-dir", "x", "status"], "name two places"),
        (["--connect", "lab", "--key", "x", "--server-key", "y", "status"], '--connect: "lab" must be tcp://HOST:PORT'),
        (["--connect", "tcp://a:b:c", "--key", "x", "--server-key", "y", "status"], '"tcp://a:b:c" must be tcp://'),
        (["--server-key", "x", "status"], "--server-key is for --connect"),
        (["--connect", "tcp://lab", "status"], "--connect needs --key and --server-key"),
        (["--connect", "tcp://lab", "--key", "x", "status"], "--connect needs --server-key, or"),
        (["--connect", "tcp://lab", "--key", "x", "--server-key", "y", "run", "-c", "none"], "for this machine alone"),
        (["--connect", "tcp://lab", "bridge", "-c", "none"], "bridge is for this machine alone"),
        (["--connect", "tcp://lab", "flight", "copy.npz"], "FILE is for a daemon of this machine"),
        (["key", "new", "x", "--watch", "--command"], "give one"),
    ],
)
def test_what_the_command_line_refuses(arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert told in lines[0]


def test_a_variable_that_names_a_bridge(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("HAPTICD_CONNECT", "tcp://lab")
    assert main(["--runtime-dir", "x", "status"]) == 2
    assert "HAPTICD_CONNECT and --runtime-dir name two places" in capsys.readouterr().err
    assert main(["bridge", "-c", "/nowhere/bridge.yaml"]) == 1  # it means nothing to a command of this machine
    assert "/nowhere/bridge.yaml: cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(("option", "may"), [([], None), (["--watch"], "watch"), (["--command"], "command")])
def test_a_new_key_for_programs(
    tmp_path: Path, option: list[str], may: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["key", "new", "x", "--dir", str(tmp_path), "--json", *option]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["may"] == may
    assert told["public_key"] == load_certificate(tmp_path / "x.key").public_key
