"""The methods of this process that every page needs: who answers, which telemetry it wants, an address for another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hapticd._version import __version__
from hapticd.base.errors import HapticdError
from hapticd.web.page import Method, Page
from hapticd.web.page_lease import LONGEST_S
from hapticd.web.telemetry_hub import TOPICS


async def _hello(page: Page, _: Mapping[str, object]) -> object:
    return {
        "version": __version__,
        "demo": page.demo,
        "topics": list(TOPICS),
        "daemon": page.hub.daemon,
        "longest_lease_s": LONGEST_S,
    }


async def _subscribe(page: Page, params: Mapping[str, object]) -> object:
    topics = params.get("topics")
    if not isinstance(topics, list) or not all(topic in TOPICS for topic in topics):
        raise HapticdError(f"topics: must be a list of {', '.join(TOPICS)}")
    page.hub.subscribe(page.outbox, frozenset(topics))
    return {"topics": topics}


async def _new_address(page: Page, _: Mapping[str, object]) -> object:
    """One that lets in one more browser, once."""
    return {"address": page.new_address()}


METHODS: Final[dict[str, Method]] = {
    "web.hello": _hello,
    "web.subscribe": _subscribe,
    "web.new_address": _new_address,
}
