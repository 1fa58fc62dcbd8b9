"""Methods of this process for every page: version and state, subscriptions, another address, shipped materials."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Final

from hapticd._version import __version__
from hapticd.base.errors import HapticdError
from hapticd.config.materials import shipped_materials
from hapticd.web.page import Method, Page
from hapticd.web.page_lease import MAX_PAGE_LEASE_S
from hapticd.web.telemetry_hub import HUB_TOPICS


async def _hello(page: Page, _: Mapping[str, object]) -> object:
    return {
        "version": __version__,
        "demo": page.demo,
        "topics": list(HUB_TOPICS),
        "daemon": page.hub.daemon,
        "longest_lease_s": MAX_PAGE_LEASE_S,
    }


async def _subscribe(page: Page, params: Mapping[str, object]) -> object:
    topics = params.get("topics")
    if not isinstance(topics, list) or not all(topic in HUB_TOPICS for topic in topics):
        raise HapticdError(f"topics: must be a list of {', '.join(HUB_TOPICS)}")
    page.hub.subscribe(page.outbox, frozenset(topics))
    return {"topics": topics}


async def _new_address(page: Page, _: Mapping[str, object]) -> object:
    """Answer web.new_address: return an address with a one-time token, which gives one more browser access."""
    return {"address": page.new_address()}


async def _shipped_materials(_: Page, params: Mapping[str, object]) -> object:
    """Answer web.shipped_materials: `materials` by name, each in the form of get_materials."""
    shipped = await asyncio.to_thread(shipped_materials)
    return {"materials": {name: material.to_dict() for name, material in shipped.items()}}


BASE_PAGE_METHODS: Final[dict[str, Method]] = {
    "web.hello": _hello,
    "web.subscribe": _subscribe,
    "web.new_address": _new_address,
    "web.shipped_materials": _shipped_materials,
}
