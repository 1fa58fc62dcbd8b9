"""Uploaded recordings: kept in a temporary folder until they are opened, then removed."""

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
from hapticd.web.connections import extend_deadline

MAX_UPLOAD_BYTES: Final = 512 << 20
MAX_WAITING_UPLOADS: Final = 4
"""Maximum number of uploaded files that wait to be opened; the oldest is removed first."""
_UPLOAD_BLOCK_BYTES: Final = 1 << 18
"""Largest block that is received and written at once."""


class Uploads:
    """Uploaded files that wait to be opened, each with the token that its upload returned."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._waiting: dict[str, Path] = {}

    async def receive(self, request: web.Request) -> web.Response:
        """Answer a POST of a file's bytes with {"upload": token} or {"error"}; the query has its `name`."""
        if request.headers.get("Origin") is None:
            return web.json_response({"error": "Origin: only pages of this server may upload files"}, status=403)
        ending = os.path.splitext(request.query.get("name", ""))[1].lower()
        if ending != ".npz":
            return web.json_response({"error": "name: must end in .npz"}, status=415)
        too_large = web.json_response(
            {"error": f"must have at most {wording.size(MAX_UPLOAD_BYTES)}; copy it into the folder of recordings"},
            status=413,
        )
        if (request.content_length or 0) > MAX_UPLOAD_BYTES:
            return too_large
        token = secrets.token_urlsafe(16)
        path = self._path_of(token + ending)
        try:
            if not await _write_body(request, path):
                return too_large
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        self._waiting[token] = path
        while len(self._waiting) > MAX_WAITING_UPLOADS:
            self._waiting.pop(next(iter(self._waiting))).unlink(missing_ok=True)
        return web.json_response({"upload": token})

    def take(self, token: object) -> Path:
        """Return the uploaded file of a token; the caller must remove it. Raises HapticdError for an unknown token."""
        path = self._waiting.pop(token, None) if isinstance(token, str) else None
        if path is None:
            raise HapticdError("upload: the file was removed; choose it again")
        return path

    def close(self) -> None:
        """Remove all uploaded files."""
        self._waiting.clear()
        if self._folder is not None:
            self._folder.cleanup()

    def _path_of(self, name: str) -> Path:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="hapticd-uploads-")
        return Path(self._folder.name, name)


async def _write_body(request: web.Request, path: Path) -> bool:
    """Write a request's body into a file and return True; if it is too large, remove the file and return False."""
    received = reported = 0
    with open(path, "xb") as file:
        async for block in request.content.iter_chunked(_UPLOAD_BLOCK_BYTES):
            received += len(block)
            if received > MAX_UPLOAD_BYTES:
                break
            await asyncio.to_thread(file.write, block)
            if received - reported >= _UPLOAD_BLOCK_BYTES:
                reported = received
                extend_deadline()
    if received > MAX_UPLOAD_BYTES:
        path.unlink()
        return False
    return True
