"""The password file: one line with the hash of the password by scrypt. How often one may be tried."""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import hmac
import os
import re
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final, Literal

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular, write_whole
from hapticd.base.yaml_source import one_line
from hapticd.system.trusted_files import read_trusted
from hapticd.web.token_bucket import Bucket

LEAST_CHARACTERS: Final = 8
LONGEST_BYTES: Final = 1024
_LARGEST_FILE: Final = 4096
_N, _R, _P = 1 << 15, 8, 1
"""32 MiB and some 0.1 s for each try."""
_MEMORY: Final = 64 << 20
_LINE: Final = re.compile(r"scrypt:([0-9]{1,8}):([0-9]{1,2}):([0-9]{1,2}):([A-Za-z0-9+/=]{16,88}):([A-Za-z0-9+/=]{44})")
_MADE_BY: Final = "`hapticd web --set-password FILE` writes one"

_PER_ADDRESS: Final = (0.1, 5.0)
_OF_ALL: Final = (1.0, 20.0)
"""Tries a second, and at once."""
_MOST_ADDRESSES: Final = 1000

Verdict = Literal["right", "wrong", "later"]


class Passwords:
    """The password of one file. Belongs to the event loop."""

    def __init__(self, path: str, now: Callable[[], float] = time.monotonic) -> None:
        """Raises HapticdError for a file that others may read, or that holds no hash."""
        name = one_line(path)
        match = _LINE.fullmatch(read_trusted(path, _LARGEST_FILE, secret=True).decode("ascii", "replace").strip())
        if match is None:
            raise HapticdError(f"{name}: holds no hash of a password; {_MADE_BY}")
        n, r, p = (int(match[at]) for at in (1, 2, 3))
        if n < 2 or n & (n - 1) or not r or not p or 128 * n * r > _MEMORY // 2 or p > 16:
            raise HapticdError(f"{name}: scrypt:{n}:{r}:{p} is not used here; {_MADE_BY}")
        try:
            self._salt, self._hash = (base64.b64decode(match[at], validate=True) for at in (4, 5))
        except binascii.Error:
            raise HapticdError(f"{name}: holds no hash of a password; {_MADE_BY}") from None
        self._cost = (n, r, p)
        self._now = now
        self._all = Bucket(_OF_ALL[0], _OF_ALL[1], now)
        self._addresses: OrderedDict[str, Bucket] = OrderedDict()
        self._one_at_a_time = asyncio.Lock()

    async def check(self, password: str, address: str) -> Verdict:
        """What of a password that somebody at `address` gives. `later`: too many were tried, this one was not."""
        given = password.encode("utf-8", "surrogateescape")
        if not self._may_try(address):
            return "later"
        if len(given) > LONGEST_BYTES:
            return "wrong"
        async with self._one_at_a_time:
            found = await asyncio.to_thread(_scrypt, given, self._salt, *self._cost)
        return "right" if hmac.compare_digest(found, self._hash) else "wrong"

    def _may_try(self, address: str) -> bool:
        of_address = self._addresses.setdefault(address, Bucket(*_PER_ADDRESS, self._now))
        self._addresses.move_to_end(address)
        if len(self._addresses) > _MOST_ADDRESSES:
            self._addresses.popitem(last=False)
        return of_address.take_if_there(1) and self._all.take_if_there(1)


def _scrypt(password: bytes, salt: bytes, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(password, salt=salt, n=n, r=r, p=p, maxmem=_MEMORY, dklen=32)


def write_password(path: str, password: str) -> None:
    """Writes a file for `Passwords`, which only its owner may read. Never replaces one. Raises HapticdError."""
    given = password.encode("utf-8", "surrogateescape")
    if len(password) < LEAST_CHARACTERS or len(given) > LONGEST_BYTES:
        raise HapticdError(f"a password has {LEAST_CHARACTERS} characters or more, and at most {LONGEST_BYTES} bytes")
    salt = secrets.token_bytes(16)
    parts = (base64.b64encode(each).decode() for each in (salt, _scrypt(given, salt, _N, _R, _P)))
    line = ":".join(("scrypt", str(_N), str(_R), str(_P), *parts)) + "\n"
    check_regular(path)
    if os.path.lexists(path):
        raise HapticdError(f"{one_line(path)}: already exists; remove it first")
    write_whole(path, line, overwrite=False, mode=0o600, synced=True)
