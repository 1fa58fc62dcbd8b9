"""Export of recordings to .mcap (with the package mcap) and .csv (with pandas). hapticd cannot read these files.

.mcap, for robotics tools, has four topics:

    hapticd/samples    one message per tick, CDR with a ros2msg schema: a CDR header of 4 bytes, then the bytes of the
                       sample
    hapticd/event      JSON: events
    hapticd/status     JSON: the status at the start
    hapticd/change     JSON: changes by commands

`log_time` and `publish_time` are the tick's `time_ns` plus one offset, which makes them UTC in ns since 1970. The
messages themselves have CLOCK_MONOTONIC of the daemon's machine. Texts that are known at the start are attachments
(`scene.json`, ...), with the time of the first sample; texts that are known at the end are metadata.

NAME.csv holds the samples, one row per tick; a vector has two columns (`position_m_x`, `position_m_y`). The events are
in `NAME.events.csv`, the texts in `NAME.about.json`. Neither format holds arrays such as `truth`.
"""

from __future__ import annotations

import csv
import heapq
import importlib
import io
import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd._version import __version__
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError, collapse_whitespace
from hapticd.base.files import atomic_file, write_atomically
from hapticd.recording.event_columns import COMMON_EVENT_MEMBERS, EVENT_MEMBER_SCHEMAS, cell_of
from hapticd.system.extras import install_command

if TYPE_CHECKING:
    from pandas import DataFrame

    from hapticd.recording.writer import Samples

Events: TypeAlias = Iterable[Mapping[str, Any]]
Texts: TypeAlias = Mapping[str, Any]

_MODULES_OF_SUFFIX: Final = {".mcap": ("mcap.writer", "zstandard"), ".csv": ("pandas",)}
"""Modules that a format needs, by the file's ending. The package of the first has the name of hapticd's extra."""
_BLOCK_SAMPLES: Final = 100_000
"""Number of samples that are converted at once."""
_ATTACHED_TEXTS: Final = ("config", "scene", "materials", "status")
"""Texts that become attachments of a .mcap, as they are known at the start."""
_METADATA_TEXTS: Final = ("recording", "flight")
"""Texts that become metadata of a .mcap, as they are known only at the end."""
_ROS_TYPES: Final = {"u8": "uint64", "i8": "int64", "f8": "float64", "u4": "uint32", "i4": "int32", "f4": "float32"}
"""Type in a ros2msg definition, by numpy type."""
_CDR_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
"""CDR header of a message with little-endian numbers."""
_SAMPLES_CHANNEL, _EVENT_CHANNEL, _STATUS_CHANNEL, _CHANGE_CHANNEL = range(1, 5)
"""Ids of the channels of a .mcap and of their schemas; mcap's writer numbers both from 1."""
_STATUS_MEMBERS: Final = {
    name: {"type": kind}
    for name, kind in (("tick", "integer"), ("rate_hz", "number"), ("revision", "integer"), ("forces", "string"))
}
"""JSON Schema of some members of the status."""
_JSON_CHANNELS: Final = {
    "hapticd/event": ("hapticd.Event", EVENT_MEMBER_SCHEMAS),
    "hapticd/status": ("hapticd.Status", _STATUS_MEMBERS),
    "hapticd/change": ("hapticd.Change", {"revision": {"type": "integer"}}),
}
"""Name and members of the schema of each JSON topic."""


def files_of(target: Path) -> list[Path]:
    """Return the files that an export to `target` writes, with `target` last.

    Raises HapticdError if the ending of `target` is not .csv or .mcap, or if a needed package is not installed.
    """
    modules = _MODULES_OF_SUFFIX.get(target.suffix.lower())
    if modules is None:
        raise HapticdError(f"{target}: must end in .npz, .csv or .mcap")
    try:
        for module in modules:
            importlib.import_module(module)
    except (ImportError, ValueError) as error:  # numpy raises ValueError for a package built for another numpy
        extra = modules[0].partition(".")[0]
        broken = "" if isinstance(error, ModuleNotFoundError) else f" ({module}: {collapse_whitespace(str(error))})"
        needs = f"needs the packages of the extra `{extra}`: {install_command(extra)}"
        raise HapticdError(f"{target}: {target.suffix} {needs}{broken}") from None
    endings = ("events.csv", "about.json") if "pandas" in modules else ()
    return [*(target.with_name(f"{target.stem}.{ending}") for ending in endings), target]


def export(samples: Samples, events: Events, texts: Texts, utc_offset_ns: int, target: Path, overwrite: bool) -> None:
    """Write a recording in the format of the ending of `target`. Raises HapticdError if the files cannot be written.

    `utc_offset_ns` is UTC minus the clock of the samples, in ns; 0 if it is unknown.
    """
    files = files_of(target)
    if len(files) == 1:
        with atomic_file(target, overwrite) as file:
            try:
                _write_mcap(samples, events, texts, utc_offset_ns, file)
            except struct.error:
                raise HapticdError(f"{target}: .mcap needs times from 1970 to 2554; the recording has others") from None
        return
    write_atomically(files[0], _events_csv(events), overwrite)
    write_atomically(files[1], json.dumps(dict(texts), indent=1) + "\n", overwrite)
    with atomic_file(target, overwrite) as file:
        for first in range(0, max(1, len(samples)), _BLOCK_SAMPLES):
            frame = frame_of(samples[first : first + _BLOCK_SAMPLES])
            frame.to_csv(file, index=False, header=first == 0, lineterminator="\n")


def frame_of(samples: Samples) -> DataFrame:
    """Return samples as a DataFrame: one row per tick, a column for each field and for each component of a vector.

    The index, `time_s`, is the time since the first sample in s. Raises HapticdError if pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise HapticdError(f"to_pandas needs pandas: {install_command('pandas')}") from None
    columns: dict[str, npt.NDArray[Any]] = {}
    for name in samples.dtype.names or ():
        values = samples[name]
        if values.ndim == 1:
            columns[name] = values
        else:
            columns |= {f"{name}_{axis}": values[:, place] for place, axis in enumerate("xy")}
    times = samples["time_ns"].astype(np.int64)
    return pandas.DataFrame(columns, index=pandas.Index((times - times[:1]) / 1e9, name="time_s"))


def _events_csv(events: Events) -> str:
    """Return events as the text of a .csv: a header with all members that occur, and a line per event."""
    names = dict.fromkeys((*COMMON_EVENT_MEMBERS, *(name for event in events for name in event)))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, names)
    writer.writeheader()
    for event in events:
        writer.writerow({name: cell_of(name, value) for name, value in event.items()})
    return text.getvalue()


class _Message(NamedTuple):
    time_ns: int
    channel: int
    sequence: int
    data: bytes


def _write_mcap(samples: Samples, events: Events, texts: Texts, utc_offset_ns: int, file: BinaryIO) -> None:
    from mcap.writer import Writer

    writer = Writer(file)
    writer.start(library=f"hapticd {__version__}")
    schema = writer.register_schema("hapticd_msgs/msg/Sample", "ros2msg", _sample_schema().encode())
    writer.register_channel("hapticd/samples", "cdr", schema)
    for topic, (name, members) in _JSON_CHANNELS.items():
        shape = {"$schema": "http://json-schema.org/draft-07/schema#", "type": "object", "properties": members}
        schema = writer.register_schema(name, "jsonschema", json.dumps(shape).encode())
        writer.register_channel(topic, "json", schema)
    start_ns = int(samples["time_ns"][0]) if len(samples) else 0
    for name in _ATTACHED_TEXTS:
        if name in texts:
            utc_ns, text = start_ns + utc_offset_ns, json.dumps(texts[name]).encode()
            writer.add_attachment(utc_ns, utc_ns, f"{name}.json", "application/json", text)
    by_time = attrgetter("time_ns")
    others = sorted(_other_messages(samples, events, texts, start_ns), key=by_time)
    for message in heapq.merge(_sample_messages(samples), others, key=by_time):
        utc_ns = message.time_ns + utc_offset_ns
        writer.add_message(message.channel, utc_ns, message.data, utc_ns, message.sequence)
    for name in _METADATA_TEXTS:
        if isinstance(texts.get(name), dict):
            writer.add_metadata(name, {key: json.dumps(value) for key, value in texts[name].items()})
    writer.finish()  # type: ignore[no-untyped-call]


def _sample_schema() -> str:
    lines = []
    for name in SAMPLE_DTYPE.names or ():
        base, shape = SAMPLE_DTYPE[name].base, SAMPLE_DTYPE[name].shape
        lines.append(f"{_ROS_TYPES[base.str[1:]]}{f'[{shape[0]}]' if shape else ''} {name}\n")
    return "".join(lines)


def _sample_messages(samples: Samples) -> Iterator[_Message]:
    for first in range(0, len(samples), _BLOCK_SAMPLES):
        part = samples[first : first + _BLOCK_SAMPLES]
        data, size = part.tobytes(), part.dtype.itemsize
        for row, (tick, time_ns) in enumerate(zip(part["tick"].tolist(), part["time_ns"].tolist(), strict=True)):
            body = _CDR_LITTLE_ENDIAN + data[row * size : (row + 1) * size]
            yield _Message(time_ns, _SAMPLES_CHANNEL, tick & 0xFFFFFFFF, body)


def _other_messages(samples: Samples, events: Events, texts: Texts, time_ns: int) -> Iterator[_Message]:
    if texts.get("status"):
        yield _json_message(time_ns, _STATUS_CHANNEL, texts["status"])
    # A change has the time of the first sample rendered with it; without such a sample, that of the previous change.
    revisions, rows = np.unique(samples["revision"], return_index=True)
    first_rows = dict(zip(revisions.tolist(), rows.tolist(), strict=True))
    for change in texts.get("changes", ()):
        row = first_rows.get(change.get("revision"))
        if row is None and "tick" in change and len(samples):
            row = min(int(np.searchsorted(samples["tick"], np.uint64(change["tick"]))), len(samples) - 1)
        time_ns = time_ns if row is None else int(samples["time_ns"][row])
        yield _json_message(time_ns, _CHANGE_CHANNEL, change)
    for event in events:
        yield _json_message(int(event["time_ns"]), _EVENT_CHANNEL, event)


def _json_message(time_ns: int, channel: int, value: Any) -> _Message:
    return _Message(time_ns, channel, 0, json.dumps(value).encode())
