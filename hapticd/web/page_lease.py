"""The lease of a page: forces are turned on only by the page that holds one, and fade when it no longer renews it.

The daemon watches the time, not this process: a page that closes, freezes or loses its network renews nothing.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Final, cast

from hapticd.client.asynchronous import Client
from hapticd.protocol.calls import RemoteError
from hapticd.protocol.messages import Code

LONGEST_S: Final = 1.0


class PageLease:
    """What one page holds. `control` is the connection that no call of any page waits in front of."""

    def __init__(self, control: Client, now: Callable[[], float] = time.monotonic) -> None:
        self._control, self._now = control, now
        self._until = 0.0

    @property
    def held(self) -> bool:
        """Whether the page holds a lease now. Its end is reckoned from before the daemon was asked."""
        return self._now() < self._until

    async def lease(self, params: Mapping[str, object]) -> object:
        """The daemon's method, with a shorter limit."""
        given = params.get("duration_s")
        # What is no number is refused by the daemon.
        duration_s = given if isinstance(given, int | float) and not isinstance(given, bool) else 0
        if duration_s > LONGEST_S:
            problem = f"must be at most {LONGEST_S:g} s for a page, is {duration_s!s:.20}"
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
        """Off always passes. On takes a lease that lives until the daemon has answered; else they are off again."""
        if params.get("enabled") is not True:
            return await self._control.call("set_forces", params)
        if not self.held:
            raise RemoteError(
                Code.LEASE_LAPSED, "only the page that holds the lease turns forces on; this page holds none"
            )
        # A page that goes meanwhile does not end this: whether its lease held is still to be seen.
        return await asyncio.shield(asyncio.create_task(self._turn_on(params), name="page-forces-on"))

    async def _turn_on(self, params: Mapping[str, object]) -> object:
        result = await self._control.call("set_forces", params)
        if not self.held:
            # The daemon may have turned them on without it.
            await self._control.call("set_forces", {"enabled": False})
            raise RemoteError(Code.LEASE_LAPSED, "the lease lapsed while forces were turned on: they are off again")
        return result
