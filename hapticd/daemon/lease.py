"""The lease: forces stay on only while a client renews it, by token, before its deadline.

`methods.py` converts the exceptions to the protocol's errors. The servo checks the deadline, even if Python hangs or
dies.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Final

MAX_LEASE_DURATION_S: Final = 3600.0
"""Longest duration of a lease, as docs/protocol.md states."""


class LeaseHeldError(Exception):
    """A client with another token holds the lease (Code.LEASE_HELD)."""


class LeaseLapsedError(Exception):
    """The token's lease lapsed, was ended or never existed (Code.LEASE_LAPSED)."""


class Lease:
    """The lease of one client, or none. While a lease is held, forces stay on only until its deadline.

    The holder knows a secret token and renews the lease with it. Times are in nanoseconds of `clock`.
    """

    def __init__(self, set_deadline: Callable[[int], None], clock: Callable[[], int]) -> None:
        """Use `set_deadline` to set the time at which the servo fades the forces out; 0: never."""
        self._set_deadline = set_deadline
        self._clock = clock
        self._token: str | None = None
        self._deadline = 0

    @property
    def remaining_s(self) -> float | None:
        """Time until the lease lapses; None without a lease."""
        if self._token is None:
            return None
        remaining = (self._deadline - self._clock()) / 1e9
        return remaining if remaining > 0 else None

    def request(self, duration_s: float, token: str | None) -> str | None:
        """Take or renew the lease on the forces, or end it with a duration of 0; return the token, None after the end.

        Raises LeaseHeldError while another token holds the lease, LeaseLapsedError for a token that holds no lease.
        """
        held = self.remaining_s is not None
        if held and (token is None or not secrets.compare_digest(token.encode(), (self._token or "").encode())):
            raise LeaseHeldError
        if not held and token is not None:
            raise LeaseLapsedError
        if duration_s == 0:
            if not held:
                raise LeaseLapsedError
            self._token = None
            self._set_deadline(0)
            return None
        if not held:
            self._token = secrets.token_hex(16)
        self._deadline = self._clock() + round(duration_s * 1e9)
        self._set_deadline(self._deadline)
        return self._token

    def forget_lapsed(self) -> None:
        """End a lease that has lapsed, so that it no longer keeps the forces off."""
        if self._token is not None and self.remaining_s is None:
            self._token = None
            self._set_deadline(0)
