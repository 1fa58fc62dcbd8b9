"""Tasks of an event loop, and their end."""

from __future__ import annotations

import asyncio
from typing import Any


async def ended(task: asyncio.Task[Any]) -> None:
    """Cancels a task, and returns once it is over, however it ended."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
