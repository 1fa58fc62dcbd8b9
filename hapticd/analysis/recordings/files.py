"""A recording's file: its bytes, and what reads them."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Mapping
from typing import Final

from hapticd.analysis.recordings.csv_table import csv_table
from hapticd.analysis.recordings.npz_table import npz_table
from hapticd.analysis.recordings.table import Table
from hapticd.analysis.recordings.wav_table import wav_table
from hapticd.base.yaml_source import read_file

READERS: Final[Mapping[str, Callable[[bytes], Table]]] = {".csv": csv_table, ".npz": npz_table, ".wav": wav_table}


def ending_of(name: str) -> str:
    """Of a file's name, in small letters."""
    return os.path.splitext(name)[1].lower()


def file_bytes(name: str, most: int) -> bytes:
    """The bytes of a regular file; a pipe would be waited for, a device has no end. Raises ValueError."""
    try:
        found = os.stat(name)
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from None
    if stat.S_ISDIR(found.st_mode):
        raise ValueError("cannot be read: is a folder")
    if not stat.S_ISREG(found.st_mode):
        raise ValueError("cannot be read: is a pipe or a device, not a file")
    # Before it is read: what a sparse file says of its size costs nothing.
    if found.st_size > most or len(content := read_file(name, most)) > most:
        raise ValueError(f"is larger than {most} bytes: cut it into several files")
    return content
