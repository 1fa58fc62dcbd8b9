"""A recording that a page begins and any page ends: made by a thread of this process, with a connection of its own.

One at a time. It belongs to the process, not to the page that began it: when that page is closed or loses the network,
it goes on, every page shows it, and every page can end it. It ends when it is stopped, after the time it was given,
when the daemon ends, when the disk is full and when `hapticd web` ends; what was recorded until then is in the file.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.client.record import Daemon, RecordSummary, ended_early, record
from hapticd.recording.writer import RecordingWriter
from hapticd.web.recording_folder import RecordingFolder

TOLD_EVERY_S: Final = 0.5
"""How often pages hear how far a recording is."""
LONGEST_S: Final = 86_400.0
_LEAST_ROOM: Final = 64 << 20
"""Bytes that must be free for a recording to begin."""
_MOST_NOTES: Final = 20
_LONGEST_NOTE: Final = 4000
_LONGEST_KEY: Final = 64


@dataclass(slots=True)
class _Under:
    """A recording under way."""

    name: str
    stop: threading.Event
    begun: asyncio.Future[None]
    over: asyncio.Future[None]
    """Done when the thread is through; `last` then says how it went."""
    for_s: float | None
    writer: RecordingWriter | None = None
    recorded_s: float = 0.0


class WebRecorder:
    """Begins and ends recordings; belongs to the event loop."""

    def __init__(self, connect: Callable[[], AbstractContextManager[Daemon]], folder: RecordingFolder) -> None:
        """`connect` makes a client for the thread alone."""
        self._connect, self._folder = connect, folder
        self._under: _Under | None = None
        self._last: dict[str, Json] | None = None
        self._watchers: set[Callable[[Mapping[str, object]], None]] = set()
        self._telling: asyncio.Task[None] | None = None

    # ---- What pages hear -------------------------------------------------------------------------------------------

    def watch(self, tell: Callable[[Mapping[str, object]], None]) -> None:
        """From now on `tell` hears how far a recording is, as ["web", {"recording": state}]."""
        self._watchers.add(tell)

    def forget(self, tell: Callable[[Mapping[str, object]], None]) -> None:
        self._watchers.discard(tell)

    def state(self) -> dict[str, Json]:
        """`recording`: whether one is under way; then its `name`, `recorded_s`, `ticks`, `bytes` and `for_s`. `last`:
        how the last one ended, its `name` and `error`, or what it holds. `free_bytes` on the disk."""
        state: dict[str, Json] = {
            "recording": self._under is not None,
            "last": self._last,
            "free_bytes": self._folder.free_bytes(),
        }
        under = self._under
        if under is not None:
            writer = under.writer
            state |= {
                "name": under.name,
                "for_s": under.for_s,
                "recorded_s": under.recorded_s,
                "ticks": 0 if writer is None else writer.count,
                "bytes": 0 if writer is None else writer.written_bytes,
            }
        return state

    def _tell(self) -> None:
        news = {"recording": self.state()}
        for tell in tuple(self._watchers):
            tell(news)

    async def _keep_telling(self) -> None:
        while self._under is not None:
            self._tell()
            await asyncio.sleep(TOLD_EVERY_S)

    # ---- Begin and end ---------------------------------------------------------------------------------------------

    async def start(self, name: object, notes: object = None, for_s: object = None) -> dict[str, Json]:
        """Returns once the first sample is in the file. Raises HapticdError where nothing could be recorded."""
        if self._under is not None:
            raise HapticdError(f"a recording is under way: {self._under.name}; stop it first")
        duration_s, kept = _duration(for_s), _notes(notes)
        target = self._folder.target(name)
        free = self._folder.free_bytes()
        if free is not None and free < _LEAST_ROOM:
            raise HapticdError(
                f"the disk has room for {wording.size(free)}; to begin, {wording.size(_LEAST_ROOM)} are needed"
            )
        loop = asyncio.get_running_loop()
        under = _Under(target.name, threading.Event(), loop.create_future(), loop.create_future(), duration_s)
        self._under, self._last = under, None
        thread = threading.Thread(
            target=self._run, args=(loop, under, target, kept), name="hapticd-record", daemon=True
        )
        thread.start()
        await asyncio.wait((under.begun, under.over), return_when=asyncio.FIRST_COMPLETED)
        if under.begun.done():
            self._telling = asyncio.create_task(self._keep_telling(), name="recording-news")
            return self.state()
        assert self._last is not None
        raise HapticdError(str(self._last.get("error") or self._last.get("ended_because")))

    async def stop(self) -> dict[str, Json]:
        """Returns once the file is whole. Raises HapticdError where nothing is being recorded."""
        under = self._under
        if under is None:
            raise HapticdError("nothing is being recorded")
        under.stop.set()
        await asyncio.shield(under.over)
        return self.state()

    async def close(self) -> None:
        """Ends what is under way, and waits for its file."""
        if self._under is not None:
            await self.stop()

    def _run(self, loop: asyncio.AbstractEventLoop, under: _Under, target: Path, notes: Mapping[str, Json]) -> None:
        """In the thread."""

        def opened(writer: RecordingWriter) -> None:
            under.writer = writer

        def progress(recorded_s: float) -> None:
            if recorded_s > 0 and under.recorded_s == 0:
                loop.call_soon_threadsafe(_resolve, under.begun)
            under.recorded_s = recorded_s

        try:
            with self._connect() as client:
                found = record(
                    client, target, under.for_s, notes=notes, stop=under.stop, progress=progress, opened=opened
                )
            last = _told(found)
        except HapticdError as error:
            last = {"name": under.name, "error": str(error)}
        except Exception as error:  # a defect: pages must hear that it ended, whatever it was
            last = {"name": under.name, "error": f"a defect ended the recording: {type(error).__name__}: {error}"}
        loop.call_soon_threadsafe(self._over, under, last)

    def _over(self, under: _Under, last: dict[str, Json]) -> None:
        self._under, self._last = None, last
        _resolve(under.over)
        self._tell()


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _told(found: RecordSummary) -> dict[str, Json]:
    """How a recording went."""
    return {
        "name": Path(found.file).name,
        "ticks": found.ticks,
        "duration_s": found.duration_s,
        "lost": found.lost + found.dropped,
        "ended_because": ended_early(found.ended_because),
        "warning": found.warning,
    }


def _duration(for_s: object) -> float | None:
    if for_s is None:
        return None
    sound = isinstance(for_s, int | float) and not isinstance(for_s, bool) and math.isfinite(for_s)
    if not sound or not 0.01 <= for_s <= LONGEST_S:  # type: ignore[operator]
        raise HapticdError(f"for_s: must be a number from 0.01 to {LONGEST_S:g}, is {for_s!r:.40}")
    return float(for_s)  # type: ignore[arg-type]


def _notes(notes: object) -> dict[str, Json]:
    if notes is None:
        return {}
    if not isinstance(notes, dict) or len(notes) > _MOST_NOTES:
        raise HapticdError(f"notes: must be a map of at most {_MOST_NOTES} texts")
    for name, text in notes.items():
        if not isinstance(text, str) or len(text) > _LONGEST_NOTE or not 0 < len(name) <= _LONGEST_KEY:
            raise HapticdError(
                f"notes: each is a text of at most {_LONGEST_NOTE} characters, with a name of at most {_LONGEST_KEY}"
            )
    return dict(notes)
