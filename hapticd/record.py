"""Recordings: telemetry, or a simulated run, to a file.

Samples go to a part file beside the target as they come, so that memory stays bounded however long a
recording is; the target is put in place at the end, whole, by a rename. A recording that fails leaves no
file and changes none.

.npz  `samples` (structured, one a tick), `events` (structured, one column for each key that occurs), and as
      JSON text `status`, `scene` and `materials` at the start; read by numpy.load without pickle
.csv  samples, one row a tick, vectors in two columns (`position_m_x`, `position_m_y`); events in a second file,
      `NAME.events.csv`

The section Files of docs/protocol.md says what each of them holds.
"""

from __future__ import annotations

import csv
import json
import math
import os
import shutil
import threading
import time
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from hapticd import calls
from hapticd.client import Client
from hapticd.errors import HapticdError
from hapticd.samples import SampleBatch, SampleStream

Samples: TypeAlias = npt.NDArray[np.void]

_AXES = ("x", "y")

NO_TIME: Final = -(2**63)
"""What a time of an event that has none is; numpy's own NaT."""


class Sink(ABC):
    """A file in the making; what was not finished when its `with` ends is thrown away.

    Its methods raise HapticdError where the disk does not take what is written.
    """

    def __init__(self, target: str | os.PathLike[str]) -> None:
        """Raises HapticdError where the target cannot be written."""
        self.target = Path(os.path.realpath(target))
        self.count = 0
        self.event_count = 0
        self._name = os.fspath(target)
        self._dtype: np.dtype[np.void] | None = None
        self._files: list[IO[Any]] = []
        if self.target.is_dir():
            raise HapticdError(f"{self._name}: is a directory")
        if self.target.exists() and not os.access(self.target, os.W_OK):
            raise HapticdError(f"{self._name}: may not be overwritten")
        with self._telling():
            self._open()

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _write(self, samples: Samples) -> None: ...

    @abstractmethod
    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None: ...

    def write(self, samples: Samples) -> None:
        """Appends samples; all have one dtype."""
        if self._dtype is None:
            self._dtype = samples.dtype
        elif self._dtype != samples.dtype:
            raise HapticdError("the daemon changed the form of its samples; record again")
        if len(samples):
            with self._telling():
                self._write(samples)
        self.count += len(samples)

    def write_event(self, event: Mapping[str, object]) -> None:
        """Appends an event."""
        with self._telling():
            self._events.write(json.dumps(event) + "\n")
        self.event_count += 1

    def finish(
        self, texts: Mapping[str, object] | None = None, arrays: Mapping[str, npt.NDArray[Any]] | None = None
    ) -> None:
        """Puts the target in place, with `texts` as JSON and `arrays` as they are where the format can."""
        with self._telling():
            self._finish(texts or {}, arrays or {})

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._discard()
            raise HapticdError(f"{self._name}: cannot be written: {error.strerror}") from None

    def _text_part(self, name: str, mode: str) -> IO[str]:
        file = open(self._part(name), mode, encoding="utf-8", newline="")  # noqa: SIM115
        self._files.append(file)
        return file

    def _binary_part(self, name: str, mode: str) -> IO[bytes]:
        file = cast("IO[bytes]", open(self._part(name), mode))  # noqa: SIM115
        self._files.append(file)
        return file

    def _part(self, name: str) -> Path:
        return self.target.with_name(f".{self.target.name}.{os.getpid()}.{name}")

    def _read_events(self) -> Iterator[dict[str, Any]]:
        self._events.seek(0)
        return (json.loads(line) for line in self._events)

    def _place(self, part: IO[Any], target: Path) -> None:
        part.close()
        os.replace(part.name, target)

    def _discard(self) -> None:
        for file in self._files:
            with suppress(OSError):  # a full disk may refuse what close would still write
                file.close()
            with suppress(FileNotFoundError):
                os.unlink(file.name)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._discard()

    _events: IO[str]


class NpzSink(Sink):
    """The .npz form."""

    def _open(self) -> None:
        self._events = self._text_part("events", "x+")
        self._samples = self._binary_part("samples", "x+b")

    def _write(self, samples: Samples) -> None:
        self._samples.write(samples.tobytes())

    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        part = self._binary_part("part", "x+b")
        with zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as archive:
            with archive.open("samples.npy", "w", force_zip64=True) as member:
                header = {
                    "descr": np.lib.format.dtype_to_descr(self._dtype or np.dtype([])),
                    "fortran_order": False,
                    "shape": (self.count,),
                }
                np.lib.format.write_array_header_1_0(member, header)
                self._samples.seek(0)
                shutil.copyfileobj(self._samples, member, 1 << 20)
            columns = {"events": event_array(self._read_events), **arrays}
            columns |= {name: np.array(json.dumps(value)) for name, value in texts.items()}
            for name, array in columns.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)
        self._place(part, self.target)


class CsvSink(Sink):
    """The .csv form; texts and arrays have no place in it."""

    def _open(self) -> None:
        self._events = self._text_part("events", "x+")
        self._samples = self._text_part("samples", "x")
        self._writer = csv.writer(self._samples, lineterminator="\n")

    def _write(self, samples: Samples) -> None:
        if self.count == 0:
            self._writer.writerow(_csv_names(samples.dtype))
        columns: list[list[object]] = []
        for name in samples.dtype.names or ():
            values = samples[name].reshape(len(samples), -1)
            columns += [values[:, index].tolist() for index in range(values.shape[1])]
        self._writer.writerows(zip(*columns, strict=True))

    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        part = self._text_part("part", "x")
        names = list(dict.fromkeys(name for event in self._read_events() for name in event))
        writer = csv.DictWriter(part, names, lineterminator="\n")
        writer.writeheader()
        for event in self._read_events():
            writer.writerow({name: _cell(value) for name, value in event.items()})
        self._place(part, self.target.with_name(f"{self.target.stem}.events.csv"))
        self._place(self._samples, self.target)


def open_sink(target: str | os.PathLike[str]) -> Sink:
    """The sink for a target, by its ending. Raises HapticdError for another, or an unwritable target."""
    match Path(target).suffix.lower():
        case ".npz":
            return NpzSink(target)
        case ".csv":
            return CsvSink(target)
        case _:
            raise HapticdError(f"{os.fspath(target)}: must end in .npz or .csv")


def _csv_names(dtype: np.dtype[Any]) -> list[str]:
    names = []
    for name in dtype.names or ():
        shape = dtype[name].shape
        names += [name] if not shape else [f"{name}_{axis}" for axis in _AXES[: shape[0]]]
    return names


def _cell(value: object) -> object:
    return json.dumps(value) if isinstance(value, list | dict | bool) or value is None else value


def event_array(events: Callable[[], Iterable[Mapping[str, Any]]]) -> npt.NDArray[np.void]:
    """Events as one structured array with a column for each key that occurs.

    What a column is follows from what it holds, and not from whether every event has it; an event that has none holds

    - truth values: i1, 0 or 1; -1
    - whole numbers: i8; 0, or NO_TIME where the key ends in `_ns`
    - numbers, and nothing but None: f8; NaN
    - texts, and as JSON whatever else there is: text; ""

    `events` is called twice.
    """
    kinds: dict[str, set[type]] = {}
    widths: dict[str, int] = {}
    total = 0
    for event in events():
        total += 1
        for name, value in event.items():
            kinds.setdefault(name, set()).add(type(value))
            if not isinstance(value, int | float):
                widths[name] = max(widths.get(name, 1), len(_text(value)))
    columns = [(name, *_column(name, found - {type(None)}, widths.get(name, 1))) for name, found in kinds.items()]
    array = np.zeros(total, np.dtype([(name, form) for name, form, _ in columns]))
    for index, event in enumerate(events()):
        array[index] = tuple(_value(event.get(name), form, absent) for name, form, absent in columns)
    return array


def _column(name: str, kinds: set[type], width: int) -> tuple[str, object]:
    """The form of a column that holds such values, and what stands for none."""
    if kinds == {bool}:
        return "i1", -1
    if kinds == {int}:
        return "<i8", NO_TIME if name.endswith("_ns") else 0
    # The id of an object is a text, also where all of them are gone.
    if kinds <= {int, float} and name != "object":
        return "<f8", math.nan
    return f"<U{width}", ""


def _text(value: object) -> str:
    return "" if value is None else value if isinstance(value, str) else json.dumps(value)


def _value(value: object, form: str, absent: object) -> object:
    if value is None:
        return absent
    return _text(value) if form.startswith("<U") else value


# ---- recording from a daemon -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Recording:
    """What a recording holds, and what it lacks."""

    file: str
    ticks: int
    duration_s: float
    events: int
    lost: int
    """Samples that did not arrive here."""
    dropped: int
    """Samples that the daemon's ring had no room for."""
    ended: str | None
    """Why it ended early, None where it did not."""

    def summary(self) -> str:
        """One line for people."""
        text = f"{self.file}: {self.ticks} ticks in {self.duration_s:.3f} s, {self.events} events, "
        missing = self.lost + self.dropped
        if missing == 0:
            return text + "nothing lost"
        where = f"{self.lost} on the way here, {self.dropped} in the daemon's ring"
        return f"{text}{missing} ticks lost ({where})"


def record(
    client: Client,
    target: str | os.PathLike[str],
    duration_s: float | None = None,
    *,
    stop: threading.Event | None = None,
    progress: Callable[[float], None] = lambda recorded_s: None,
) -> Recording:
    """Records every tick and every event into `target`, for `duration_s` of the daemon's time or until
    `stop` is set.

    What was recorded is kept when it is stopped, and when the daemon goes away. `progress` is called with
    the time recorded so far. Raises HapticdError where the target cannot be written, before anything is
    recorded.
    """
    with open_sink(target) as sink:
        texts: dict[str, object] = {
            "status": client.get_status(),
            "scene": client.get_scene()["scene"],
            "materials": client.get_materials()["materials"],
        }
        stream = SampleStream(warn=False)
        span = _Span(duration_s)
        ended: str | None = None
        with client.telemetry("samples", "event") as messages:
            silent_since = time.monotonic()
            while not span.over:
                if stop is not None and stop.is_set():
                    ended = "stopped"
                    break
                received = messages.receive(0.1)
                if received is None:
                    if time.monotonic() - silent_since > client.timeout_s:
                        ended = str(calls.silent(client.paths, client.timeout_s))
                        break
                    continue
                silent_since = time.monotonic()
                topic, message = received
                if topic == "event":
                    span.hold(message)
                    continue
                batch = stream.convert(topic, message)
                if stream.restarts:
                    ended = "the daemon was restarted"
                    break
                sink.write(span.cut(batch))
                for event in span.release():
                    sink.write_event(event)
                progress(span.recorded_s)
        if sink.count == 0:
            raise HapticdError(f"{target}: nothing was recorded{f' ({ended})' if ended else ''}")
        sink.finish(texts, {})
        return Recording(
            os.fspath(target),
            sink.count,
            span.recorded_s,
            sink.event_count,
            stream.lost,
            stream.dropped,
            ended,
        )


class _Span:
    """The stretch of the daemon's time that is recorded, from the first sample that came.

    Events are sent before the samples of their ticks, so that those of a stretch are complete when its
    samples are.
    """

    def __init__(self, duration_s: float | None) -> None:
        self._duration_ns = None if duration_s is None else round(duration_s * 1e9)
        self._first_tick: int | None = None
        self._first_ns = 0
        self._end_tick = 0
        self._last_ns = 0
        self._period_ns = 0
        self._held: list[dict[str, Any]] = []
        self.over = False

    @property
    def recorded_s(self) -> float:
        if self._first_tick is None:
            return 0.0
        return (self._last_ns + self._period_ns - self._first_ns) / 1e9

    def cut(self, batch: SampleBatch) -> Samples:
        if len(batch) == 0:
            return batch
        times = batch["time_ns"]
        if self._first_tick is None:
            self._first_tick = int(batch["tick"][0])
            self._first_ns = int(times[0])
        if len(batch) > 1:
            self._period_ns = int(np.min(np.diff(times)))
        kept: Samples = batch
        if self._duration_ns is not None:
            # A deadline is rounded to whole nanoseconds: half a period decides which tick is the first
            # outside.
            inside = times - self._first_ns + self._period_ns // 2 < self._duration_ns
            kept = batch[inside]
            self.over = len(kept) < len(batch)
        if len(kept):
            self._end_tick = int(kept["tick"][-1]) + 1
            self._last_ns = int(kept["time_ns"][-1])
        return kept

    def hold(self, event: dict[str, Any]) -> None:
        self._held.append(event)

    def release(self) -> list[dict[str, Any]]:
        """The events of the ticks recorded so far."""
        if self._first_tick is None:
            return []
        held, self._held = self._held, []
        released = []
        for event in held:
            tick = int(event.get("tick", 0))
            if tick >= self._end_tick:
                self._held.append(event)
            elif tick >= self._first_tick:
                released.append(event)
        return released
