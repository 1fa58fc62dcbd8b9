"""The method of a page that returns the shipped materials, unchanged."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Final

from hapticd.config.materials import shipped_materials
from hapticd.web.page import Method, Page


async def _shipped_materials(_: Page, params: Mapping[str, object]) -> object:
    """Answer web.shipped_materials: `materials` by name, each in the form of get_materials."""
    shipped = await asyncio.to_thread(shipped_materials)
    return {"materials": {name: material.to_dict() for name, material in shipped.items()}}


SHIPPED_MATERIALS_PAGE_METHODS: Final[dict[str, Method]] = {"web.shipped_materials": _shipped_materials}
