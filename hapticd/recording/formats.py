"""The formats of recordings, by the ending of the file."""

from __future__ import annotations

import os
from pathlib import Path

from hapticd.base.errors import HapticdError
from hapticd.recording.csv_writer import CsvWriter
from hapticd.recording.npz_writer import NpzWriter
from hapticd.recording.writer import RecordingWriter


def writer_class(target: str | os.PathLike[str]) -> type[RecordingWriter]:
    """Raises HapticdError for an ending that is none of ours."""
    match Path(target).suffix.lower():
        case ".npz":
            return NpzWriter
        case ".csv":
            return CsvWriter
        case ".mcap":
            from hapticd.recording.mcap_writer import McapWriter

            return McapWriter
        case _:
            raise HapticdError(f"{os.fspath(target)}: must end in .npz, .csv or .mcap")


def open_writer(target: str | os.PathLike[str], overwrite: bool = False) -> RecordingWriter:
    """The writer for a target, by its ending. Raises HapticdError for another, an unwritable target, and, without
    `overwrite`, for one that is there already."""
    return writer_class(target)(target, overwrite=overwrite)


def check_target(target: str | os.PathLike[str], overwrite: bool) -> None:
    """Raises HapticdError for a target of another ending, one that is no regular file, and, without `overwrite`, one
    that is there already."""
    writer_class(target).check_files(target, overwrite)
