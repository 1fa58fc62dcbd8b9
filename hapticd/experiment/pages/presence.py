"""Whether somebody looks at a page: it is open, and its script ran not long ago."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable
from typing import Final

from hapticd.web.page import Page

AWAY_S: Final = 3.0
"""A page that was not heard for so long is away: its browser is frozen, or its network gone. Pages beat 4 times a s."""
_SWEEP_S: Final = 0.25


class Presence:
    """Of the pages of one kind. Belongs to the event loop."""

    def __init__(
        self,
        changed: Callable[[bool], None],
        away_s: float = AWAY_S,
        now: Callable[[], float] = time.monotonic,
        swept: Callable[[], None] = lambda: None,
    ) -> None:
        """`changed` is called when the first one comes and when the last one goes, `swept` a few times a second."""
        self._swept = swept
        self._changed, self._away_s, self._now = changed, away_s, now
        self._heard: dict[Hashable, float] = {}
        self._followed: set[Page] = set()

    @property
    def here(self) -> bool:
        return bool(self._heard)

    def follow(self, page: Page) -> bool:
        """Has it leave when it is closed; False where it is followed already."""
        if page in self._followed:
            return False
        self._followed.add(page)
        page.closing.callback(self._followed.discard, page)
        page.closing.callback(self.leave, page)
        return True

    def beat(self, page: Hashable) -> None:
        """It is here."""
        was = self.here
        self._heard[page] = self._now()
        if not was:
            self._changed(True)

    def leave(self, page: Hashable) -> None:
        """It was closed."""
        if self._heard.pop(page, None) is not None and not self.here:
            self._changed(False)

    def sweep(self) -> None:
        """Lets go of those that were not heard for too long."""
        now = self._now()
        for page in [page for page, heard in self._heard.items() if now - heard > self._away_s]:
            self.leave(page)

    async def run(self) -> None:
        """Sweeps, until cancelled."""
        while True:
            await asyncio.sleep(_SWEEP_S)
            self.sweep()
            self._swept()
