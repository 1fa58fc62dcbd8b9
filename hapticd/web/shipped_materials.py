"""The method of a page that asks for the shipped materials, as they are before anybody changes them."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Final

from hapticd.config.materials import shipped_materials
from hapticd.web.page import Method, Page


async def _shipped_materials(_: Page, params: Mapping[str, object]) -> object:
    """web.shipped_materials: `materials`, by name, each in the form of get_materials."""
    shipped = await asyncio.to_thread(shipped_materials)
    return {"materials": {name: material.to_dict() for name, material in shipped.items()}}


METHODS: Final[dict[str, Method]] = {"web.shipped_materials": _shipped_materials}
