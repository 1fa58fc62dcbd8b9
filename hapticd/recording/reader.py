"""Recordings, read back: samples and events as they were, and what they were rendered with."""

from __future__ import annotations

import csv
import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import one_line
from hapticd.config.document_kinds import refuse_documents
from hapticd.recording.csv_reader import files_beside, load_csv
from hapticd.recording.mcap_reader import load_mcap
from hapticd.recording.npz_reader import load_npz
from hapticd.recording.reading_limits import BadRecordingError, Memory, Recorded, Samples, regular

__all__ = ["Memory", "Recorded", "Samples", "load_recorded"]

_WRONG: Final = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    EOFError,
    RecursionError,
    NotImplementedError,
    csv.Error,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
"""What reading a file raises that holds something else than it should."""


def load_recorded(
    path: str | os.PathLike[str], max_memory: int | None = None, memory: Memory | None = None
) -> Recorded:
    """Reads a .npz, .csv or .mcap of `hapticd record` or `hapticd simulate`.

    `max_memory`: bytes that it may take (see reading_limits.py); `memory`, where the caller needs some, too. Raises
    HapticdError where it is none, or would take more.
    """
    name = os.fspath(path)
    ending = Path(path).suffix.lower()
    if ending not in (".npz", ".csv", ".mcap"):
        refuse_documents(name)
        raise HapticdError(f"{one_line(name)}: must end in .npz, .csv or .mcap")
    try:
        with regular(Path(path)) as (file, size):
            memory = memory or memory_for(path, max_memory)
            if ending == ".npz":
                return load_npz(file, memory)
            if ending == ".csv":
                return load_csv(Path(path), file, memory)
            return load_mcap(file, size, memory)
    except OSError as error:
        raise HapticdError(f"{one_line(str(error.filename or name))}: {error.strerror or error}") from None
    except MemoryError:
        raise HapticdError(f"{one_line(name)}: takes more memory than there is") from None
    except _WRONG as error:
        raise HapticdError(f"{one_line(name)}: is no recording of hapticd: {_reason(error)}") from None


def memory_for(path: str | os.PathLike[str], max_memory: int | None, sample_bytes: int | None = None) -> Memory:
    """What reading a file may take; its size is that of all its files. Raises OSError."""
    place = Path(path)
    size = os.stat(place).st_size
    if place.suffix.lower() == ".csv":
        size += sum(beside.stat().st_size for beside in files_beside(place) if beside.exists())
    given = {} if sample_bytes is None else {"sample_bytes": sample_bytes}
    return Memory(os.fspath(path), size, max_memory, **given)


def _reason(error: Exception) -> str:
    """What is wrong, as one line that shows nothing of what is in the file."""
    match error:
        case BadRecordingError():
            return one_line(str(error))
        case UnicodeDecodeError():
            return "a text of it is no Unicode"
        case zipfile.BadZipFile() if "CRC" in str(error):
            return "the checksum of a member is wrong"
        case zipfile.BadZipFile() | zlib.error() | NotImplementedError() | EOFError():
            return "it is no whole archive"
        case _:
            return "it holds something else than it should"
