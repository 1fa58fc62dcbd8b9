"""An open recording: its samples by row, the minimum and maximum of a column per pixel, the scene at a row.

Rows count from 0, the first sample of the file. The content is not trusted: `hapticd.load` has checked the format of
the file, but its numbers may be anything, also NaN.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.base.merge_patch import replace_members
from hapticd.base.yaml_source import Json
from hapticd.client.record import ended_early
from hapticd.recording.recording import Recording

MAX_ROWS_PER_ANSWER: Final = 20_000
"""Maximum number of samples in one answer, which then has about 2 MB."""
MAX_OUTLINE_PIXELS: Final = 4096
"""Maximum number of pixels of an outline, which has the minimum and the maximum of a column per pixel."""
MAX_SHOWN_EVENTS: Final = 5000
"""Maximum number of events of a recording that a page gets; later events are left out."""
_MAX_EVENT_TEXT_CHARACTERS: Final = 500
"""Longest text in an event; members with a longer text are left out."""
_RATE_RANGE_HZ: Final = (1.0, 1e6)
"""Lowest and highest rate of a recording that can be opened."""
_SHOWN_EVENT_KINDS: Final = frozenset(
    (
        "contact",
        "release",
        "puncture",
        "groove",
        "mark",
        "fault",
        "saturation",
        "device_lost",
        "device_found",
        "gesture_end",
    )
)

_COMPONENT_COLUMNS: Final = {
    "x_m": ("position_m", 0),
    "y_m": ("position_m", 1),
    "vx_m_per_s": ("velocity_m_per_s", 0),
    "vy_m_per_s": ("velocity_m_per_s", 1),
    "contact_x_n": ("contact_force_n", 0),
    "contact_y_n": ("contact_force_n", 1),
    "vibration_x_n": ("vibration_force_n", 0),
    "vibration_y_n": ("vibration_force_n", 1),
    "force_x_n": ("force_n", 0),
    "force_y_n": ("force_n", 1),
}
"""Columns of vector components, each with its field of a sample and its index in that field."""
_MAGNITUDE_COLUMNS: Final = {
    "force_n": "force_n",
    "contact_n": "contact_force_n",
    "vibration_n": "vibration_force_n",
    "speed_m_per_s": "velocity_m_per_s",
}
"""Columns of vector magnitudes, each with its field of a sample."""
OUTLINE_COLUMNS: Final = (*_COMPONENT_COLUMNS, *_MAGNITUDE_COLUMNS)
"""Columns that an outline may show. Components have the same names as in static/samples.js."""


class Playback:
    """An open recording. Its methods may take long and must be called in a worker thread."""

    def __init__(self, recording: Recording) -> None:
        """Show a recording. Raises HapticdError if it has no samples or an impossible rate."""
        self._recording = recording
        self._samples = recording.samples
        self.rate_hz = recording.rate_hz
        if not _RATE_RANGE_HZ[0] <= self.rate_hz <= _RATE_RANGE_HZ[1]:
            low_hz, high_hz = _RATE_RANGE_HZ
            raise HapticdError(
                f"{recording.path}: its rate must be between {low_hz:g} and {high_hz:g} Hz, is {self.rate_hz:g} Hz"
            )
        if not len(self._samples):
            raise HapticdError(f"{recording.path}: contains no samples")

    def facts(self) -> dict[str, Json]:
        """Return what the page shows about the recording: duration, rate, notes, events and others."""
        recording, samples = self._recording, self._samples
        times = samples["time_ns"]
        started = recording.started
        return {
            "rows": len(samples),
            "rate_hz": self.rate_hz,
            "start_ns": int(times[0]),
            "duration_s": max(0.0, (int(times[-1]) - int(times[0])) * 1e-9) + 1.0 / self.rate_hz,
            "started_ns": None if started is None else started.realtime_ns,
            "ended_because": ended_early(recording.ended_because),
            "missed_periods": recording.missed_periods,
            "notes": {name: value for name, value in recording.notes.items() if isinstance(value, str | int | float)},
            "events": self._events(),
            "columns": list(OUTLINE_COLUMNS),
        }

    def _events(self) -> list[Json]:
        events: list[Json] = []
        ticks = self._samples["tick"]
        for event in self._recording.events:
            kind, tick = event.get("event"), event.get("tick")
            if kind not in _SHOWN_EVENT_KINDS or type(tick) is not int or not int(ticks[0]) <= tick <= int(ticks[-1]):
                continue
            row = int(np.searchsorted(ticks, np.uint64(tick)))
            events.append({**{name: value for name, value in event.items() if _is_brief(value)}, "row": row})
            if len(events) == MAX_SHOWN_EVENTS:
                break
        return events

    def rows(self, first: int, count: int) -> dict[str, object]:
        """Return `count` samples from row `first` on, as in the topic `samples` (docs/reference/telemetry.md)."""
        first = _inside("first", first, 0, len(self._samples) - 1)
        count = _inside("count", count, 1, MAX_ROWS_PER_ANSWER)
        part = self._samples[first : first + count]
        return {
            "first": first,
            "count": len(part),
            "first_tick": int(part["tick"][0]),
            "dropped": 0,
            "dtype": np.lib.format.dtype_to_descr(part.dtype),
            "data": part.tobytes(),
        }

    def outline(self, column: str, first: int, last: int, pixels: int) -> dict[str, object]:
        """Return a column of the samples from row `first` to before row `last`, as little-endian float32.

        The result has `min` and `max`, each with one number per pixel. If there are at most two rows per pixel, it has
        `raw` instead, with one number per row.
        """
        if column not in OUTLINE_COLUMNS:
            raise HapticdError(f"column: must be one of {', '.join(OUTLINE_COLUMNS)}")
        first = _inside("first", first, 0, len(self._samples) - 1)
        last = _inside("last", last, first + 1, len(self._samples))
        pixels = _inside("pixels", pixels, 1, MAX_OUTLINE_PIXELS)
        values = self._column(column, first, last)
        answer: dict[str, object] = {"column": column, "first": first, "last": last}
        if last - first <= 2 * pixels:
            return {**answer, "raw": _packed(values)}
        edges = np.linspace(0, last - first, pixels, endpoint=False).astype(np.int64)
        return {
            **answer,
            "min": _packed(np.fmin.reduceat(values, edges)),
            "max": _packed(np.fmax.reduceat(values, edges)),
        }

    def _column(self, name: str, first: int, last: int) -> npt.NDArray[np.float64]:
        part = self._samples[first:last]
        if name in _COMPONENT_COLUMNS:
            field, component = _COMPONENT_COLUMNS[name]
            values: npt.NDArray[np.float64] = part[field][:, component]
            return values
        vectors = part[_MAGNITUDE_COLUMNS[name]]
        length: npt.NDArray[np.float64] = np.hypot(vectors[:, 0], vectors[:, 1])
        return length

    def scene(self, row: int) -> dict[str, object]:
        """Return the `scene`, the `materials` and the `revision` with which the sample of this row was rendered."""
        row = _inside("row", row, 0, len(self._samples) - 1)
        revision = int(self._samples["revision"][row])
        scene = dict(self._recording.scene)
        objects, materials = _map(scene.pop("objects", None)), dict(self._recording.materials)
        for change in self._recording.changes:
            number = change.get("revision")
            # Revisions wrap around at 2^32.
            if type(number) is not int or (revision - number) & 0xFFFFFFFF >= 1 << 31:
                continue
            for into, name in ((scene, "scene"), (objects, "objects"), (materials, "materials")):
                replace_members(into, _map(change.get(name)))
        return {"scene": {**scene, "objects": objects}, "materials": materials, "revision": revision}


def _is_brief(value: object) -> bool:
    """Return whether a member of an event is passed on: a number or a short text."""
    return (
        value is None
        or isinstance(value, int | float)
        or (isinstance(value, str) and len(value) <= _MAX_EVENT_TEXT_CHARACTERS)
    )


def _packed(values: npt.NDArray[np.float64]) -> bytes:
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype("<f4").tobytes()


def _map(value: object) -> dict[str, Any]:
    return dict(value) if isinstance(value, dict) else {}


def _inside(name: str, value: int, low: int, high: int) -> int:
    """Return the integer `value` that a page sent. Raises HapticdError if it is not between `low` and `high`."""
    if not low <= value <= high:
        raise HapticdError(f"{name}: must be between {low:,} and {high:,}, is {value:,}")
    return value
