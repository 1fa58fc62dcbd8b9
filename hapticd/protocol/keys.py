"""CURVE keys in files, in the form of CZMQ's certificates, which pyzmq's zmq.auth, CZMQ and JeroMQ read too.

NAME.key holds the public key, NAME.key_secret both. A key is 32 bytes, written as 40 characters of Z85.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import zmq

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular, create
from hapticd.base.yaml_source import one_line
from hapticd.system.trusted_files import read_trusted

PUBLIC: Final = ".key"
SECRET: Final = ".key_secret"

_Z85: Final = re.compile(r"[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")
_LINE: Final = re.compile(r"""\s*(public-key|secret-key)\s*=\s*(["'])(.*)\2\s*""")
_LARGEST: Final = 64 * 1024
_NAME: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")


@dataclass(frozen=True, slots=True)
class Certificate:
    """A pair of keys, or the public one alone, in Z85."""

    public_key: str
    secret_key: str | None = None

    def __repr__(self) -> str:
        return f"Certificate({self.public_key!r})"  # the secret never gets into a log


def is_key(text: str) -> bool:
    """Whether `text` is a key in Z85."""
    if _Z85.fullmatch(text) is None:
        return False
    # Five characters hold 85^5 numbers, more than four bytes have: the highest are none.
    return all(_number(text[at : at + 5]) < 2**32 for at in range(0, 40, 5))


_DIGITS: Final = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.-:+=^!/*?&<>()[]{}@%$#"


def _number(text: str) -> int:
    number = 0
    for character in text:
        number = number * 85 + _DIGITS.index(character)
    return number


def new_certificate() -> Certificate:
    """A new pair of keys, from the system's source of randomness."""
    public, secret = zmq.curve_keypair()
    return Certificate(public.decode(), secret.decode())


def write_certificate(certificate: Certificate, name: str, directory: Path) -> tuple[Path, Path]:
    """Writes NAME.key and, for the owner alone, NAME.key_secret; returns both. Never replaces a key.

    A missing directory is made, for the user alone. Raises HapticdError.
    """
    if _NAME.fullmatch(name) is None:
        raise HapticdError(f"{name}: a key's name has 1 to 64 letters, digits, - and _")
    public, secret = directory / f"{name}{PUBLIC}", directory / f"{name}{SECRET}"
    for path in (public, secret):
        check_regular(path)
        if os.path.lexists(path):
            raise HapticdError(f"{path}: is there already; choose another name, or remove it")
    told = f'# hapticd: the %s of {name}.\nmetadata\n    name = "{name}"\ncurve\n'
    line = f'    public-key = "{certificate.public_key}"\n'
    try:
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        both = told % "secret key, for nobody else," + line + f'    secret-key = "{certificate.secret_key}"\n'
        create(secret, both, 0o600)
        try:
            create(public, told % "public key" + line, 0o644)
        except OSError:
            secret.unlink()
            raise
    except OSError as error:
        raise HapticdError(f"{error.filename or directory}: cannot be written: {error.strerror}") from None
    return public, secret


def load_certificate(path: str | os.PathLike[str]) -> Certificate:
    """The keys in a file that others may not change. Raises HapticdError for one that holds no public key."""
    name = os.fspath(path)
    return _parsed(name, read_trusted(name, _LARGEST))


def _parsed(name: str, content: bytes) -> Certificate:
    text = content.decode("utf-8", "replace")
    found: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        match = _LINE.fullmatch(line)
        if match is None:
            continue
        if not is_key(match[3]):
            raise HapticdError(f"{one_line(name)}:{number}: {match[1]}: is no key, which has 40 characters of Z85")
        if match[1] in found:
            raise HapticdError(f"{one_line(name)}:{number}: {match[1]}: stands there a second time")
        found[match[1]] = match[3]
    if "public-key" not in found:
        raise HapticdError(f"{one_line(name)}: holds no public-key; a key file is made by: hapticd key new NAME")
    return Certificate(found["public-key"], found.get("secret-key"))


def load_secret(path: str | os.PathLike[str]) -> Certificate:
    """As load_certificate, of a file with a secret key that others may neither read nor change (`read_trusted`)."""
    name = os.fspath(path)
    for secret in (False, True):  # whether it is a secret at all is said first
        certificate = _parsed(name, read_trusted(name, _LARGEST, secret=secret))
        if certificate.secret_key is None:
            raise HapticdError(f"{one_line(name)}: holds no secret-key; give the file that ends in {SECRET}")
    pair = zmq.curve_public((certificate.secret_key or "").encode()).decode()
    if pair != certificate.public_key:
        raise HapticdError(f"{one_line(name)}: public-key and secret-key are no pair")
    return certificate


def public_key_of(text: str | os.PathLike[str]) -> str:
    """A public key that is given as itself or as a file. Raises HapticdError.

    A file that is there is meant: its path can have the form of a key, 40 characters of which all are Z85's.
    """
    if isinstance(text, str) and is_key(text) and not os.path.exists(text):
        return text
    return load_certificate(text).public_key


def default_directory() -> Path:
    """Where keys are kept: /etc/hapticd/keys of root, else below the user's own configuration."""
    if os.geteuid() == 0:
        return Path("/etc/hapticd/keys")
    home = os.environ.get("XDG_CONFIG_HOME")
    return (Path(home) if home else Path.home() / ".config") / "hapticd" / "keys"
