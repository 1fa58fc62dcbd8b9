"""The lease of a page: only a page with a lease can turn forces on, and forces fade when the lease is not renewed.

The daemon watches the time, not this process: a page that closes, freezes or loses its network cannot renew its lease.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Final, cast

from hapticd.client.asynchronous import Client
from hapticd.protocol.calls import RemoteError
from hapticd.protocol.messages import Code

MAX_PAGE_LEASE_S: Final = 1.0
"""Longest duration of a page's lease, after which forces fade when the page fails."""


class PageLease:
    """The lease of one page: the daemon keeps forces on only while the page renews it in time."""

    def __init__(self, control: Client, now: Callable[[], float] = time.monotonic) -> None:
        """Use the connection `control`, which other calls of pages do not delay."""
        self._control, self._now = control, now
        self._until = 0.0

    @property
    def held(self) -> bool:
        """Whether the page holds a lease. Its duration counts from the moment before the request to the daemon."""
        return self._now() < self._until

    async def lease(self, params: Mapping[str, object]) -> object:
        """Begin, renew or end the page's lease with the daemon's method `lease`, for at most MAX_PAGE_LEASE_S."""
        given = params.get("duration_s")
        # The daemon refuses values that are not numbers.
        duration_s = given if isinstance(given, int | float) and not isinstance(given, bool) else 0
        if duration_s > MAX_PAGE_LEASE_S:
            problem = f"must be at most {MAX_PAGE_LEASE_S:g} s for a page, is {duration_s!s:.20}"
            data = [{"where": "duration_s", "problem": problem}]
            raise RemoteError(Code.INVALID_PARAMS, f"duration_s: {problem}", data)
        asked = self._now()
        try:
            result = cast("dict[str, object]", await self._control.call("lease", params))
        except RemoteError as error:
            if error.code == Code.LEASE_LAPSED:
                self._until = 0.0
            raise
        self._until = asked + duration_s if result.get("token") is not None else 0.0
        return result

    async def set_forces(self, params: Mapping[str, object]) -> object:
        """Call the daemon's `set_forces`. Turning forces on needs a lease that lasts until the daemon's answer.

        If the lease lapses earlier, forces are turned off again.
        """
        if params.get("enabled") is not True:
            return await self._control.call("set_forces", params)
        if not self.held:
            raise RemoteError(
                Code.LEASE_LAPSED, "only the page that holds the lease can turn forces on; this page has no lease"
            )
        # Shielded: if the page closes meanwhile, its lease must still be checked after the answer.
        return await asyncio.shield(asyncio.create_task(self._turn_on(params), name="page-forces-on"))

    async def _turn_on(self, params: Mapping[str, object]) -> object:
        result = await self._control.call("set_forces", params)
        if not self.held:
            # The daemon may have turned forces on after the lease lapsed.
            await self._control.call("set_forces", {"enabled": False})
            raise RemoteError(Code.LEASE_LAPSED, "the lease lapsed while forces were turned on: they are off again")
        return result
