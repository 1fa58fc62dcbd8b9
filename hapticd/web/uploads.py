"""Recordings that a person sends to look at: kept in a folder of this process until they are opened, then removed."""

from __future__ import annotations

import asyncio
import os
import secrets
import tempfile
from pathlib import Path
from typing import Final

from aiohttp import web

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.web.connections import goes_on

MOST_BYTES: Final = 512 << 20
"""Of one file."""
MOST_WAITING: Final = 4
"""Files that were sent and not opened; the oldest gives way."""
_BLOCK: Final = 1 << 18


class Uploads:
    """Files that wait to be opened, by a token that their sender got."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._waiting: dict[str, Path] = {}

    async def receive(self, request: web.Request) -> web.Response:
        """POST of a file's bytes; `name` in the query gives its ending. Answers {"upload": token}, or {"error"}."""
        if request.headers.get("Origin") is None:
            return web.json_response({"error": "Origin: only pages of this server may send files"}, status=403)
        ending = os.path.splitext(request.query.get("name", ""))[1].lower()
        if ending != ".npz":
            return web.json_response({"error": "a recording ends in .npz"}, status=415)
        too_large = web.json_response(
            {"error": f"the file has more than {wording.size(MOST_BYTES)}; put it into the folder of recordings"},
            status=413,
        )
        if (request.content_length or 0) > MOST_BYTES:
            return too_large
        token = secrets.token_urlsafe(16)
        path = self._place(token + ending)
        try:
            if not await _kept(request, path):
                return too_large
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        self._waiting[token] = path
        while len(self._waiting) > MOST_WAITING:
            self._waiting.pop(next(iter(self._waiting))).unlink(missing_ok=True)
        return web.json_response({"upload": token})

    def take(self, token: object) -> Path:
        """The file of a token, which is the caller's to remove. Raises HapticdError where there is none."""
        path = self._waiting.pop(token, None) if isinstance(token, str) else None
        if path is None:
            raise HapticdError("upload: this file is here no longer; choose it again")
        return path

    def close(self) -> None:
        self._waiting.clear()
        if self._folder is not None:
            self._folder.cleanup()

    def _place(self, name: str) -> Path:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="hapticd-uploads-")
        return Path(self._folder.name, name)


async def _kept(request: web.Request, path: Path) -> bool:
    """Writes the body into a file; False, and no file, where it is too large."""
    received = told = 0
    with open(path, "xb") as file:
        async for block in request.content.iter_chunked(_BLOCK):
            received += len(block)
            if received > MOST_BYTES:
                break
            await asyncio.to_thread(file.write, block)
            if received - told >= _BLOCK:
                told = received
                goes_on()
    if received > MOST_BYTES:
        path.unlink()
        return False
    return True
