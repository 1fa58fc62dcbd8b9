"""A lease: forces stay on only while somebody renews it, by token, in time.

`methods.py` makes the protocol's errors of what it raises. The servo itself watches the deadline, so that a
control plane that hangs or dies changes nothing about it.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Final

MAX_DURATION_S: Final = 3600.0


class LeaseHeldError(Exception):
    """Somebody else holds the lease; the protocol's error is Code.LEASE_HELD."""


class LeaseLapsedError(Exception):
    """The token's lease lapsed or was ended, or there never was one; the error is Code.LEASE_LAPSED."""


class Lease:
    """At most one lease at a time; times in nanoseconds of `clock`."""

    def __init__(self, set_deadline: Callable[[int], None], clock: Callable[[], int]) -> None:
        """`set_deadline` tells the servo when forces fade out; 0: never."""
        self._set_deadline = set_deadline
        self._clock = clock
        self._token: str | None = None
        self._deadline = 0

    @property
    def remaining_s(self) -> float | None:
        """Time left, None without a lease."""
        if self._token is None:
            return None
        remaining = (self._deadline - self._clock()) / 1e9
        return remaining if remaining > 0 else None

    def request(self, duration_s: float, token: str | None) -> str | None:
        """Takes, renews or (0) ends the lease; its token, None once ended.

        Raises LeaseHeldError while another token holds it, LeaseLapsedError for a token that holds nothing.
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
        """A lease whose time has passed is over, and no longer a cause to keep the forces off."""
        if self._token is not None and self.remaining_s is None:
            self._token = None
            self._set_deadline(0)
