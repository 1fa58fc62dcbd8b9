"""Detects by heartbeats which pages are open and whether their scripts run."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable
from typing import Final

from hapticd.web.page import Page

PRESENCE_TIMEOUT_S: Final = 3.0
"""A page without a heartbeat for this time counts as away. Pages send 4 heartbeats per second."""
_SWEEP_INTERVAL_S: Final = 0.25
"""Time between two checks of the heartbeats."""


class Presence:
    """The open and responding pages of one kind, participant's or experimenter's. Use it in the event loop only."""

    def __init__(
        self,
        changed: Callable[[bool], None],
        away_s: float = PRESENCE_TIMEOUT_S,
        now: Callable[[], float] = time.monotonic,
        swept: Callable[[], None] = lambda: None,
    ) -> None:
        """Create a presence without pages.

        `changed` is called with True when the first page comes, and with False when the last page leaves. `swept` is
        called after each check of the heartbeats.
        """
        self._swept = swept
        self._changed, self._away_s, self._now = changed, away_s, now
        self._heard: dict[Hashable, float] = {}
        self._followed: set[Page] = set()

    @property
    def here(self) -> bool:
        """Whether a page of this kind is open and responds."""
        return bool(self._heard)

    def follow(self, page: Page) -> bool:
        """Remove a page as soon as it is closed. Returns False if the page was already followed."""
        if page in self._followed:
            return False
        self._followed.add(page)
        page.closing.callback(self._followed.discard, page)
        page.closing.callback(self.leave, page)
        return True

    def beat(self, page: Hashable) -> None:
        """Store the time of a heartbeat of a page."""
        was = self.here
        self._heard[page] = self._now()
        if not was:
            self._changed(True)

    def leave(self, page: Hashable) -> None:
        """Remove a page that was closed or sends no heartbeats."""
        if self._heard.pop(page, None) is not None and not self.here:
            self._changed(False)

    def sweep(self) -> None:
        """Remove the pages that sent no heartbeat for `away_s`."""
        now = self._now()
        for page in [page for page, heard in self._heard.items() if now - heard > self._away_s]:
            self.leave(page)

    async def run(self) -> None:
        """Check the heartbeats of all pages every _SWEEP_INTERVAL_S, until cancelled."""
        while True:
            await asyncio.sleep(_SWEEP_INTERVAL_S)
            self.sweep()
            self._swept()
