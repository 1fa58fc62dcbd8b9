"""Addresses at which the server may listen, and the options that other machines need to reach it."""

from __future__ import annotations

import ssl
import stat
import subprocess
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.web.listening import Listening, listen
from hapticd.web.passwords import write_password
from tests.support.special_files import KINDS, special, untouched
from tests.support.special_files import refused as no_regular_file


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the paths of a certificate, its key and a password file."""
    folder = tmp_path_factory.mktemp("tls")
    found = {name: str(folder / name) for name in ("cert", "key", "other", "password")}
    for key, cert in (("key", "cert"), ("other", "other-cert")):
        subprocess.run(
            [
                *("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"),
                *("-days", "2", "-subj", "/CN=lab", "-keyout", folder / key, "-out", folder / cert),
                *("-addext", "subjectAltName=DNS:Haptics.lab.org,DNS:*.wild.org,IP:192.0.2.7"),
            ],
            check=True,
            capture_output=True,
        )
    write_password(found["password"], "rosewood comb")
    return found


def refused(host: str, cert: str | None, key: str | None, password: str | None) -> str:
    with pytest.raises(HapticdError) as error:
        listen(host, 0, cert, key, password).socket.close()
    assert "\n" not in str(error.value)
    return str(error.value)


def closed(at: Listening) -> Listening:
    at.socket.close()
    return at


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.7", "8.8.8.8", "0", "::ffff:8.8.8.8"])
def test_an_address_that_others_reach_needs_tls_and_a_password(host: str, files: dict[str, str]) -> None:
    cert, key, password = files["cert"], files["key"], files["password"]
    for given, missing in (
        ((None, None, None), "--tls-cert and --tls-key and --password-file are missing"),
        ((cert, key, None), "--password-file is missing"),
        ((None, None, password), "--tls-cert and --tls-key are missing"),
        ((cert, None, password), "--tls-key is missing"),
        ((None, key, password), "--tls-cert is missing"),
    ):
        problem = refused(host, *given)
        assert problem.startswith(f"--host {host}: ") and problem.endswith(missing)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "LOCALHOST", "127.0.0.2", "::1"])
def test_an_address_of_this_machine_needs_no_options(host: str) -> None:
    try:
        at = closed(listen(host, 0, None, None, None))
    except HapticdError as error:
        pytest.skip(str(error))  # a machine without IPv6
    assert at.tls is None and at.url.startswith("http://") and not at.url.endswith(":0")


def test_a_certificate_and_its_key_go_together(files: dict[str, str]) -> None:
    assert "--tls-key is missing" in refused("127.0.0.1", files["cert"], None, None)
    assert "--tls-cert is missing" in refused("127.0.0.1", None, files["key"], None)
    assert "another certificate" in refused("127.0.0.1", files["cert"], files["other"], None)
    assert "cannot be used" in refused("127.0.0.1", files["password"], files["key"], None)
    assert "cannot be read: No such file" in refused("127.0.0.1", "/nowhere", files["key"], None)


def test_the_names_are_those_of_the_certificate(files: dict[str, str]) -> None:
    at = closed(listen("0.0.0.0", 0, files["cert"], files["key"], files["password"]))
    assert at.url.startswith("https://haptics.lab.org:") and at.passwords is not None
    assert at.tls is not None and at.tls.minimum_version >= ssl.TLSVersion.TLSv1_2
    assert at.hosts._names == {"haptics.lab.org", "*.wild.org", "192.0.2.7"}


@pytest.mark.parametrize("mode", [0o644, 0o604, 0o622, 0o660])
@pytest.mark.parametrize("name", ["key", "password"])
def test_secrets_that_others_may_read_or_change_are_refused(name: str, mode: int, files: dict[str, str]) -> None:
    path = Path(files[name])
    before = stat.S_IMODE(path.stat().st_mode)
    path.chmod(mode)
    try:
        assert "other users may" in refused("0.0.0.0", files["cert"], files["key"], files["password"])
    finally:
        path.chmod(before)


@pytest.mark.long
def test_a_password_file_is_for_its_owner_alone_and_holds_no_password(tmp_path: Path) -> None:
    path = tmp_path / "password"
    write_password(str(path), "rosewood comb")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert b"rosewood" not in path.read_bytes()
    with pytest.raises(HapticdError, match="already exists"):
        write_password(str(path), "rosewood comb")
    with pytest.raises(HapticdError, match="at least 8 characters"):
        write_password(str(tmp_path / "short"), "rose")
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(HapticdError):
        write_password(str(link), "rosewood comb")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "rosewood comb",
        "scrypt:1073741824:8:1:" + "A" * 24 + ":" + "A" * 43 + "=",
        "scrypt:3:8:1:" + "A" * 24 + ":" + "A" * 43 + "=",
        "scrypt:32768:8:1:" + "A" * 24 + ":=" + "A" * 43,
        "\xff\xfe",
    ],
)
def test_a_file_without_a_hash_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "password"
    path.write_text(text)
    path.chmod(0o600)
    assert "--set-password" in refused("127.0.0.1", None, None, str(path))


def test_a_port_that_is_in_use() -> None:
    at = listen("127.0.0.1", 0, None, None, None)
    port = at.socket.getsockname()[1]
    with pytest.raises(HapticdError, match=f"--port {port}: is in use at 127.0.0.1; choose another, or 0"):
        listen("127.0.0.1", port, None, None, None)
    at.socket.close()


def test_invalid_host_names_are_refused() -> None:
    assert "--host nowhere.invalid:" in refused("nowhere.invalid", None, None, None)
    assert "--host a b:" in refused("a b", None, None, None)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_password_is_written_only_to_a_new_file(kind: str, tmp_path: Path) -> None:
    special(tmp_path / "password", kind)
    (tmp_path / "link").symlink_to("password")
    for name in ("password", "link"):
        with untouched(tmp_path), pytest.raises(HapticdError) as caught:
            write_password(str(tmp_path / name), "rosewood comb")
        assert str(caught.value) == no_regular_file(tmp_path / name, kind)
