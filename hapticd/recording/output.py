"""Where a recording goes: into a .npz. A target of another form is exported at the end, from the .npz beside it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new, displaced
from hapticd.recording.export import files_of
from hapticd.recording.recording import check_saved, load
from hapticd.recording.writer import RecordingWriter


def recording_path(target: str | os.PathLike[str]) -> Path:
    """The .npz of a recording into `target`. Raises HapticdError for an ending of another form."""
    path = Path(target)
    if path.suffix.lower() == ".npz":
        return path
    files_of(path)
    return path.with_suffix(".npz")


def check_target(target: str | os.PathLike[str], overwrite: bool) -> None:
    """As `check_saved`, also for the .npz of an export. Raises HapticdError."""
    check_saved(target, overwrite)
    check_new(recording_path(target), overwrite)


@contextmanager
def recording_into(target: str | os.PathLike[str], overwrite: bool = False) -> Iterator[RecordingWriter]:
    """The writer of a recording, which is to be finished in the block.

    Raises HapticdError: as `check_target` does before anything is written, and at the end where another file had
    appeared at the target, which says where the recording is.
    """
    check_target(target, overwrite)
    recording = recording_path(target)
    with RecordingWriter(recording, overwrite) as writer:
        yield writer
    if writer.displaced:
        raise HapticdError(displaced(recording, writer.target))
    if recording != Path(target):
        try:
            load(recording).save(target, overwrite)
        except (HapticdError, MemoryError) as error:
            why = error if isinstance(error, HapticdError) else f"{target}: takes more memory than there is"
            raise HapticdError(f"{why}; the recording is in {recording}") from None
