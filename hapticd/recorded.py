"""Recordings, read back: samples as they were, and what they were rendered with."""

from __future__ import annotations

import json
import os
import struct
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from hapticd.core import SAMPLE_DTYPE
from hapticd.errors import HapticdError

Samples = npt.NDArray[np.void]


_LEAST_MCAP = 8 + 29 + 8
"""Bytes of magic, footer and magic."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a file holds."""

    samples: Samples
    """(n,) records of `hapticd.SAMPLE_DTYPE`."""
    texts: Mapping[str, Any]
    """What stands beside them, by name: `status`, `config`, `scene`, `materials`, `changes`, `recording`."""


def load_recorded(path: str | os.PathLike[str]) -> Recorded:
    """Reads a .npz, .csv or .mcap of `hapticd record` or `hapticd simulate`. Raises HapticdError where it is none."""
    forms: dict[str, Callable[[Path], Recorded]] = {".npz": _load_npz, ".csv": _load_csv, ".mcap": _load_mcap}
    name = os.fspath(path)
    load = forms.get(Path(path).suffix.lower())
    if load is None:
        raise HapticdError(f"{name}: must end in .npz, .csv or .mcap")
    try:
        return load(Path(path))
    except OSError as error:
        raise HapticdError(f"{error.filename or name}: {error.strerror or error}") from None
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise HapticdError(f"{name}: is no recording of hapticd: {error}") from None


def _samples(count: int, columns: Callable[[str], npt.NDArray[Any]]) -> Samples:
    """Records of the names that this version has, from columns; a KeyError or ValueError where one is missing."""
    samples = np.empty(count, SAMPLE_DTYPE)
    for name in SAMPLE_DTYPE.names or ():
        samples[name] = columns(name)
    return samples


def _load_npz(path: Path) -> Recorded:
    with open(path, "rb") as opened, np.load(opened) as file:
        given = file["samples"]
        texts = {name: json.loads(str(file[name])) for name in file.files if file[name].dtype.kind == "U"}
    if given.dtype == SAMPLE_DTYPE:
        return Recorded(given, texts)
    return Recorded(_samples(len(given), given.__getitem__), texts)


def _load_csv(path: Path) -> Recorded:
    about = path.with_name(f"{path.stem}.about.json")
    with open(about, encoding="utf-8") as file:
        texts = json.load(file)
    with open(path, encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        start = file.tell()
        cells = np.empty((0, len(names)), "U25")
        if file.readline():
            file.seek(start)
            cells = np.loadtxt(file, dtype="U25", delimiter=",", ndmin=2)
    if cells.shape[1] != len(names):
        raise ValueError(f"has {cells.shape[1]} columns under {len(names)} names")

    def column(name: str) -> npt.NDArray[Any]:
        base, shape = SAMPLE_DTYPE[name].base, SAMPLE_DTYPE[name].shape
        wanted = [f"{name}_{axis}" for axis in "xy"] if shape else [name]
        found = np.stack([cells[:, names.index(one)].astype(base) for one in wanted], axis=1)
        return found if shape else found[:, 0]

    return Recorded(_samples(len(cells), column), texts)


def _load_mcap(path: Path) -> Recorded:
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap.stream_reader import StreamReader, get_chunk_data_stream
        from zstandard import ZstdError
    except ImportError:
        from hapticd.mcap import needed

        raise needed() from None
    from hapticd.mcap import CHANGE, MAGIC, SAMPLES, TOPICS, sample_schema

    texts: dict[str, Any] = {}
    found: dict[str, list[bytes]] = {TOPICS[SAMPLES]: [], TOPICS[CHANGE]: []}
    with open(path, "rb") as file:
        if path.stat().st_size < _LEAST_MCAP or file.read(len(MAGIC)) != MAGIC:
            raise ValueError("it is no whole MCAP file")
        file.seek(0)
        try:
            reader = make_reader(file)
            for attachment in reader.iter_attachments():
                texts[attachment.name.removesuffix(".json")] = json.loads(attachment.data)
            for metadata in reader.iter_metadata():
                texts[metadata.name] = {name: json.loads(value) for name, value in metadata.metadata.items()}
            summary = reader.get_summary()
            if summary is None:
                raise ValueError("it was not finished; `mcap recover` makes a whole one of it")
            wanted = {}
            for channel in summary.channels.values():
                if channel.topic == TOPICS[SAMPLES]:
                    definition = summary.schemas[channel.schema_id].data.decode()
                    if definition != sample_schema(SAMPLE_DTYPE):
                        raise ValueError("its samples have other fields than those of this version")
                if channel.topic in found:
                    wanted[channel.id] = found[channel.topic]
            for place in sorted(index.chunk_start_offset for index in summary.chunk_indexes):
                file.seek(place)
                chunk = next(StreamReader(file, skip_magic=True, emit_chunks=True).records)
                stream, size = get_chunk_data_stream(cast(Any, chunk), validate_crc=True)
                _take_messages(stream.read(size), wanted)
        except (McapError, ZstdError, EOFError, struct.error) as error:
            raise ValueError(str(error) or "it ends too early") from None
    # Four bytes say how the record after them is encoded.
    samples = np.frombuffer(b"".join(message[4:] for message in found[TOPICS[SAMPLES]]), SAMPLE_DTYPE)
    return Recorded(samples, texts | {"changes": [json.loads(message) for message in found[TOPICS[CHANGE]]]})


def _take_messages(data: bytes, wanted: Mapping[int, list[bytes]]) -> None:
    """Adds the messages of a chunk to those of their channels. A call of the library for each would cost far more."""
    head, rest = struct.Struct("<BQH"), 4 + 8 + 8
    at = 0
    while at < len(data):
        opcode, length, channel = head.unpack_from(data, at)
        end = at + 9 + length
        if opcode == 5 and channel in wanted:
            wanted[channel].append(data[at + head.size + rest : end])
        at = end
