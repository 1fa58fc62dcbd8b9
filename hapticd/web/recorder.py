"""A recording that any page can begin and end, made by a thread of this process with a separate connection.

There is at most one recording. It continues if the page that began it is closed or loses the network; every page shows
the recording and can stop it. It ends when it is stopped, after its duration, when the daemon ends, when the disk is
full and when `hapticd web` ends; the file contains all samples until then.
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

PROGRESS_INTERVAL_S: Final = 0.5
"""Interval at which pages get the progress of a recording."""
MAX_RECORDING_S: Final = 86_400.0
"""Longest duration that may be given for a recording: a day."""
_MIN_FREE_BYTES: Final = 64 << 20
"""Free disk space that is needed to begin a recording."""
_MAX_NOTES: Final = 20
_MAX_NOTE_CHARACTERS: Final = 4000
_MAX_NOTE_KEY_CHARACTERS: Final = 64


@dataclass(slots=True)
class _ActiveRecording:
    """A recording that is being made, with its thread."""

    name: str
    stop: threading.Event
    begun: asyncio.Future[None]
    over: asyncio.Future[None]
    """Done when the thread has ended; `WebRecorder.state` then has the result in `last`."""
    for_s: float | None
    writer: RecordingWriter | None = None
    recorded_s: float = 0.0


class WebRecorder:
    """Begins and ends recordings. Only the event loop may use it."""

    def __init__(self, connect: Callable[[], AbstractContextManager[Daemon]], folder: RecordingFolder) -> None:
        """Record into `folder`. `connect` returns a new client, which only the recording's thread uses."""
        self._connect, self._folder = connect, folder
        self._active: _ActiveRecording | None = None
        self._last: dict[str, Json] | None = None
        self._watchers: set[Callable[[Mapping[str, object]], None]] = set()
        self._publishing: asyncio.Task[None] | None = None

    # ---- Progress for pages ----------------------------------------------------------------------------------------

    def watch(self, send_news: Callable[[Mapping[str, object]], None]) -> None:
        """Call `send_news` with the news {"recording": state} from now on."""
        self._watchers.add(send_news)

    def unwatch(self, send_news: Callable[[Mapping[str, object]], None]) -> None:
        """Stop calling `send_news`."""
        self._watchers.discard(send_news)

    def state(self) -> dict[str, Json]:
        """Return the state of recordings.

        `recording`: whether a recording is under way; if so, also its `name`, `recorded_s`, `ticks`, `bytes`, `for_s`.
        `last`: the summary of the last recording, or its `name` and `error`. `free_bytes`: free disk space.
        """
        state: dict[str, Json] = {
            "recording": self._active is not None,
            "last": self._last,
            "free_bytes": self._folder.free_bytes(),
        }
        active = self._active
        if active is not None:
            writer = active.writer
            state |= {
                "name": active.name,
                "for_s": active.for_s,
                "recorded_s": active.recorded_s,
                "ticks": 0 if writer is None else writer.count,
                "bytes": 0 if writer is None else writer.written_bytes,
            }
        return state

    def _publish(self) -> None:
        news = {"recording": self.state()}
        for send_news in tuple(self._watchers):
            send_news(news)

    async def _publish_progress(self) -> None:
        while self._active is not None:
            self._publish()
            await asyncio.sleep(PROGRESS_INTERVAL_S)

    # ---- Begin and end ---------------------------------------------------------------------------------------------

    async def start(self, name: object, notes: object = None, for_s: object = None) -> dict[str, Json]:
        """Begin a recording, and return the state once the first sample is in the file.

        Raises HapticdError if the recording cannot begin.
        """
        if self._active is not None:
            raise HapticdError(f"a recording is under way: {self._active.name}; stop it first")
        duration_s, kept = _duration(for_s), _notes(notes)
        target = self._folder.target(name)
        free = self._folder.free_bytes()
        if free is not None and free < _MIN_FREE_BYTES:
            raise HapticdError(
                f"the disk has {wording.size(free)} free; a recording needs at least {wording.size(_MIN_FREE_BYTES)}"
            )
        loop = asyncio.get_running_loop()
        active = _ActiveRecording(
            target.name, threading.Event(), loop.create_future(), loop.create_future(), duration_s
        )
        self._active, self._last = active, None
        thread = threading.Thread(
            target=self._run, args=(loop, active, target, kept), name="hapticd-record", daemon=True
        )
        thread.start()
        await asyncio.wait((active.begun, active.over), return_when=asyncio.FIRST_COMPLETED)
        if active.begun.done():
            self._publishing = asyncio.create_task(self._publish_progress(), name="recording-news")
            return self.state()
        assert self._last is not None
        raise HapticdError(str(self._last.get("error") or self._last.get("ended_because")))

    async def stop(self) -> dict[str, Json]:
        """End the recording, and return the state once the file is complete.

        Raises HapticdError if nothing is being recorded.
        """
        active = self._active
        if active is None:
            raise HapticdError("nothing is being recorded")
        active.stop.set()
        await asyncio.shield(active.over)
        return self.state()

    async def close(self) -> None:
        """End the recording that is under way, and wait for its file."""
        if self._active is not None:
            await self.stop()

    def _run(
        self, loop: asyncio.AbstractEventLoop, active: _ActiveRecording, target: Path, notes: Mapping[str, Json]
    ) -> None:
        """Record until the recording is stopped or ends; runs in the recording's thread."""

        def opened(writer: RecordingWriter) -> None:
            active.writer = writer

        def progress(recorded_s: float) -> None:
            if recorded_s > 0 and active.recorded_s == 0:
                loop.call_soon_threadsafe(_resolve, active.begun)
            active.recorded_s = recorded_s

        try:
            with self._connect() as client:
                summary = record(
                    client, target, active.for_s, notes=notes, stop=active.stop, progress=progress, opened=opened
                )
            last = _result_of(summary)
        except HapticdError as error:
            last = {"name": active.name, "error": str(error)}
        except Exception as error:  # unexpected: pages must get the end of the recording in any case
            last = {"name": active.name, "error": f"internal error: {type(error).__name__}: {error}"}
        loop.call_soon_threadsafe(self._finish, active, last)

    def _finish(self, active: _ActiveRecording, last: dict[str, Json]) -> None:
        self._active, self._last = None, last
        _resolve(active.over)
        self._publish()


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _result_of(summary: RecordSummary) -> dict[str, Json]:
    """Return the summary of an ended recording, the member `last` of the state."""
    return {
        "name": Path(summary.file).name,
        "ticks": summary.ticks,
        "duration_s": summary.duration_s,
        "lost": summary.lost + summary.dropped,
        "ended_because": ended_early(summary.ended_because),
        "warning": summary.warning,
    }


def _duration(for_s: object) -> float | None:
    if for_s is None:
        return None
    sound = isinstance(for_s, int | float) and not isinstance(for_s, bool) and math.isfinite(for_s)
    if not sound or not 0.01 <= for_s <= MAX_RECORDING_S:  # type: ignore[operator]
        raise HapticdError(f"for_s: must be a number between 0.01 and {MAX_RECORDING_S:g}, is {for_s!r:.40}")
    return float(for_s)  # type: ignore[arg-type]


def _notes(notes: object) -> dict[str, Json]:
    if notes is None:
        return {}
    if not isinstance(notes, dict) or len(notes) > _MAX_NOTES:
        raise HapticdError(f"notes: must be a map of at most {_MAX_NOTES} texts")
    for name, text in notes.items():
        if (
            not isinstance(text, str)
            or len(text) > _MAX_NOTE_CHARACTERS
            or not 0 < len(name) <= _MAX_NOTE_KEY_CHARACTERS
        ):
            raise HapticdError(
                f"notes: each must be a text of at most {_MAX_NOTE_CHARACTERS} characters with a name of 1 to "
                f"{_MAX_NOTE_KEY_CHARACTERS} characters"
            )
    return dict(notes)
