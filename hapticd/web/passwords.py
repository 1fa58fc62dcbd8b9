"""The password file, which is one line with the password's scrypt hash, and the rate limits of tries."""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import hmac
import os
import re
import secrets
from collections import OrderedDict
from typing import Final, Literal

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular, write_atomically
from hapticd.base.yaml_source import printable
from hapticd.system.trusted_files import read_trusted
from hapticd.web.token_bucket import Bucket

MIN_PASSWORD_CHARACTERS: Final = 8
"""Shortest password that `hapticd web --set-password` accepts."""
MAX_PASSWORD_BYTES: Final = 1024
"""Longest password, in UTF-8."""
_MAX_PASSWORD_FILE_BYTES: Final = 4096
_SCRYPT_N, _SCRYPT_R, _SCRYPT_P = 1 << 15, 8, 1
"""Costs of scrypt for new files: 32 MiB and about 0.1 s for each try."""
_SCRYPT_MEMORY_BYTES: Final = 64 << 20
"""Maximum memory of scrypt. The costs in a password file may need at most half of it."""
_LINE_PATTERN: Final = re.compile(
    r"scrypt:([0-9]{1,8}):([0-9]{1,2}):([0-9]{1,2}):([A-Za-z0-9+/=]{16,88}):([A-Za-z0-9+/=]{44})"
)
_CREATION_HINT: Final = "`hapticd web --set-password FILE` writes one"
"""Advice in error texts on how to make a password file."""
_TRIES_PER_ADDRESS: Final = (0.1, 5.0)
"""Rate limit of one address: tries a second, and burst."""
_TRIES_OF_ALL_ADDRESSES: Final = (1.0, 20.0)
"""Rate limit of all addresses together: tries a second, and burst."""
_MAX_TRACKED_ADDRESSES: Final = 1000
"""Maximum number of addresses with a separate rate limit; the address that tried longest ago is forgotten first."""
CheckResult = Literal["right", "wrong", "later"]
"""Result of a try; `later`: there were too many tries, and the password was not checked."""


class Passwords:
    """Checks passwords against the hash in one file, with rate limits. Only the event loop may use it."""

    def __init__(self, path: str) -> None:
        """Read the password file. Raises HapticdError if other users may read it or if it does not contain a hash."""
        name = printable(path)
        match = _LINE_PATTERN.fullmatch(
            read_trusted(path, _MAX_PASSWORD_FILE_BYTES, secret=True).decode("ascii", "replace").strip()
        )
        if match is None:
            raise HapticdError(f"{name}: not a password file; {_CREATION_HINT}")
        n, r, p = (int(match[at]) for at in (1, 2, 3))
        if n < 2 or n & (n - 1) or not r or not p or 128 * n * r > _SCRYPT_MEMORY_BYTES // 2 or p > 16:
            raise HapticdError(f"{name}: unsupported costs scrypt:{n}:{r}:{p}; {_CREATION_HINT}")
        try:
            self._salt, self._hash = (base64.b64decode(match[at], validate=True) for at in (4, 5))
        except binascii.Error:
            raise HapticdError(f"{name}: not a password file; {_CREATION_HINT}") from None
        self._cost = (n, r, p)
        self._all = Bucket(*_TRIES_OF_ALL_ADDRESSES)
        self._addresses: OrderedDict[str, Bucket] = OrderedDict()
        self._one_at_a_time = asyncio.Lock()

    async def check(self, password: str, address: str) -> CheckResult:
        """Check a password that a browser at `address` sent."""
        given = password.encode("utf-8", "surrogateescape")
        if not self._may_try(address):
            return "later"
        if len(given) > MAX_PASSWORD_BYTES:
            return "wrong"
        async with self._one_at_a_time:
            hashed = await asyncio.to_thread(_scrypt, given, self._salt, *self._cost)
        return "right" if hmac.compare_digest(hashed, self._hash) else "wrong"

    def _may_try(self, address: str) -> bool:
        of_address = self._addresses.setdefault(address, Bucket(*_TRIES_PER_ADDRESS))
        self._addresses.move_to_end(address)
        if len(self._addresses) > _MAX_TRACKED_ADDRESSES:
            self._addresses.popitem(last=False)
        return of_address.try_take(1) and self._all.try_take(1)


def _scrypt(password: bytes, salt: bytes, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(password, salt=salt, n=n, r=r, p=p, maxmem=_SCRYPT_MEMORY_BYTES, dklen=32)


def write_password(path: str, password: str) -> None:
    """Write a new password file, which only its owner may read.

    Raises HapticdError, also if the file already exists.
    """
    given = password.encode("utf-8", "surrogateescape")
    if len(password) < MIN_PASSWORD_CHARACTERS or len(given) > MAX_PASSWORD_BYTES:
        limits = f"at least {MIN_PASSWORD_CHARACTERS} characters and at most {MAX_PASSWORD_BYTES} bytes"
        raise HapticdError(f"password: must have {limits}")
    salt = secrets.token_bytes(16)
    parts = (base64.b64encode(each).decode() for each in (salt, _scrypt(given, salt, _SCRYPT_N, _SCRYPT_R, _SCRYPT_P)))
    line = ":".join(("scrypt", str(_SCRYPT_N), str(_SCRYPT_R), str(_SCRYPT_P), *parts)) + "\n"
    check_regular(path)
    if os.path.lexists(path):
        raise HapticdError(f"{printable(path)}: already exists; remove it first")
    write_atomically(path, line, overwrite=False, mode=0o600, synced=True)
