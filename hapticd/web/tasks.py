"""Cancelling tasks of the event loop."""

from __future__ import annotations

import asyncio
from typing import Any


async def ended(task: asyncio.Task[Any]) -> None:
    """Cancel a task, and return once it has ended in any way."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
