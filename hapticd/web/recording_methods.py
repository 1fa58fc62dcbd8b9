"""Methods and routes of recordings: record, list, download, delete, open and show."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Final
from urllib.parse import quote

from aiohttp import web

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json, printable
from hapticd.client.record import Daemon
from hapticd.recording.recording import load
from hapticd.web.connections import extend_deadline
from hapticd.web.page import Method, Page
from hapticd.web.playback import Playback
from hapticd.web.recorder import WebRecorder
from hapticd.web.recording_folder import RecordingFolder, checked_name
from hapticd.web.uploads import Uploads

_DOWNLOAD_BLOCK_BYTES: Final = 1 << 18
"""Bytes of a file that are read and sent at once."""


class Recordings:
    """The recordings of this process, and the methods with which pages use recordings."""

    def __init__(self, folder: Path, connect: Callable[[], AbstractContextManager[Daemon]]) -> None:
        """Record into `folder`. `connect` returns a new client for each recording."""
        self._folder = RecordingFolder(folder)
        self._recorder = WebRecorder(connect, self._folder)
        self._uploads = Uploads()
        self._open: dict[Page, Playback] = {}
        self._known: set[Page] = set()

    def methods(self) -> dict[str, Method]:
        """Return the methods by name. docs/web.md (Recordings) describes their params and results."""
        return {
            "web.recordings": self._list,
            "web.recording": self._state,
            "web.record_start": self._start,
            "web.record_stop": self._stop,
            "web.recording_delete": self._delete,
            "web.playback_open": self._open_one,
            "web.playback_rows": self._rows,
            "web.playback_outline": self._outline,
            "web.playback_scene": self._scene,
            "web.playback_close": self._close_one,
        }

    def add_routes(self, app: web.Application) -> None:
        """Add the routes of downloads and uploads."""
        app.router.add_get("/recordings/{name}", self.download)
        app.router.add_post("/uploads", self._uploads.receive)
        app.on_cleanup.append(self.close)

    async def close(self, _: web.Application | None = None) -> None:
        """End the recording that is under way, and wait for its file."""
        await self._recorder.close()
        self._uploads.close()

    # ---- Record, list, download, delete ----------------------------------------------------------------------------

    async def _list(self, _: Page, params: Mapping[str, object]) -> object:
        listed = await asyncio.to_thread(self._folder.list)
        return {
            "folder": os.fspath(self._folder.path),
            "recordings": [asdict(each) for each in listed],
            "free_bytes": self._folder.free_bytes(),
        }

    async def _state(self, page: Page, params: Mapping[str, object]) -> object:
        self._release_at_end_of(page)
        self._recorder.watch(page.send_news)
        return self._recorder.state()

    async def _start(self, _: Page, params: Mapping[str, object]) -> object:
        return await self._recorder.start(params.get("name"), params.get("notes"), params.get("for_s"))

    async def _stop(self, _: Page, params: Mapping[str, object]) -> object:
        return await self._recorder.stop()

    async def _delete(self, _: Page, params: Mapping[str, object]) -> object:
        await asyncio.to_thread(self._folder.delete, params.get("name"))
        return {}

    async def download(self, request: web.Request) -> web.StreamResponse:
        """Answer a GET of a recording by its name with the bytes of the file."""
        try:
            with self._folder.file(request.match_info["name"]) as file:
                name = request.match_info["name"]
                response = web.StreamResponse(
                    headers={
                        "Content-Type": "application/octet-stream",
                        "Content-Disposition": f"attachment; filename*=UTF-8''{quote(name)}",
                    }
                )
                response.content_length = os.fstat(file.fileno()).st_size
                await response.prepare(request)
                left = response.content_length
                while left and (block := await asyncio.to_thread(file.read, min(_DOWNLOAD_BLOCK_BYTES, left))):
                    await response.write(block)
                    extend_deadline()
                    left -= len(block)
                await response.write_eof()
                return response
        except HapticdError as error:
            return web.Response(status=404, text=f"{error}\n")

    # ---- Open and show ---------------------------------------------------------------------------------------------

    async def _open_one(self, page: Page, params: Mapping[str, object]) -> object:
        if "upload" in params:
            name = str(params.get("name", ""))[:200]
            path = self._uploads.take(params["upload"])
            try:
                return await self._opened(page, path, name)
            finally:
                path.unlink(missing_ok=True)
        name = checked_name(params.get("name"))
        with self._folder.file(name):
            return await self._opened(page, self._folder.path / name, name)

    async def _opened(self, page: Page, path: Path, name: str) -> object:
        await self._close_one(page, {})
        try:
            playback = await asyncio.to_thread(lambda: Playback(load(path)))
            facts = await asyncio.to_thread(playback.facts)
        except HapticdError as error:
            raise HapticdError(str(error).replace(os.fspath(path), printable(name))) from None
        self._release_at_end_of(page)
        self._open[page] = playback
        return {"name": name, **facts}

    def _release_at_end_of(self, page: Page) -> None:
        """When the page ends, close its recording and stop its news."""
        if page not in self._known:
            self._known.add(page)
            page.closing.callback(self._forget, page)

    def _forget(self, page: Page) -> None:
        self._known.discard(page)
        self._open.pop(page, None)
        self._recorder.unwatch(page.send_news)

    def _of(self, page: Page) -> Playback:
        playback = self._open.get(page)
        if playback is None:
            raise HapticdError("no recording is open; open one first")
        return playback

    async def _rows(self, page: Page, params: Mapping[str, object]) -> object:
        playback, first, count = self._of(page), _integer(params, "first"), _integer(params, "count")
        return await asyncio.to_thread(playback.rows, first, count)

    async def _outline(self, page: Page, params: Mapping[str, object]) -> object:
        playback, column = self._of(page), params.get("column")
        if not isinstance(column, str):
            raise HapticdError("column: must be a text")
        first, last, pixels = (_integer(params, name) for name in ("first", "last", "pixels"))
        return await asyncio.to_thread(playback.outline, column, first, last, pixels)

    async def _scene(self, page: Page, params: Mapping[str, object]) -> object:
        return await asyncio.to_thread(self._of(page).scene, _integer(params, "row"))

    async def _close_one(self, page: Page, params: Mapping[str, object]) -> dict[str, Json]:
        self._open.pop(page, None)
        return {}


def _integer(params: Mapping[str, object], name: str) -> int:
    value = params.get(name)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if type(value) is not int:
        raise HapticdError(f"{name}: must be an integer, is {value!r:.40}")
    return value
