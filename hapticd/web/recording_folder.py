"""The folder of recordings: names, a list, files to read and to delete.

A page names a recording by its name in the list, never by a path. All accesses are relative to the folder's descriptor,
and only regular files of the folder are opened, not links, folders or pipes.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import printable

MAX_RECORDING_NAME_CHARACTERS: Final = 64
"""Longest name of a recording, without its ending."""
_STEM_PATTERN: Final = re.compile(r"[^\W_][\w .+-]*")
"""Name of a recording without its ending."""
_MAX_LISTED_RECORDINGS: Final = 1000
"""Maximum number of recordings in a list; older ones are left out."""


def default_folder(environ: Mapping[str, str] | None = None) -> Path:
    """Return `recordings` in systemd's state directory, or `$XDG_DATA_HOME/hapticd/recordings`.

    `$XDG_DATA_HOME` defaults to `~/.local/share`.
    """
    environ = os.environ if environ is None else environ
    state = environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if os.path.isabs(state):
        return Path(state) / "recordings"
    home = environ.get("XDG_DATA_HOME", "")
    # The XDG Base Directory Specification says that relative paths must be ignored.
    folder = Path(home) if os.path.isabs(home) else Path(os.path.expanduser("~"), ".local", "share")
    return folder / "hapticd" / "recordings"


def checked_name(name: object) -> str:
    """Return the name of a recording, such as `tap 3.npz`. Raises HapticdError if the name is not valid."""
    if not isinstance(name, str):
        raise HapticdError("name: must be a text")
    stem, ending = os.path.splitext(name)
    if ending != ".npz":
        raise HapticdError(f"name: must end in .npz, is {name!r:.80}")
    if not _STEM_PATTERN.fullmatch(stem) or ".." in stem or stem[-1] in " .":
        raise HapticdError(
            "name: must consist of letters, digits, spaces and _ . + - ; must begin with a letter or a digit and not "
            f"end with a space or a dot; is {name!r:.80}"
        )
    if len(stem) > MAX_RECORDING_NAME_CHARACTERS or len(os.fsencode(name)) > 3 * MAX_RECORDING_NAME_CHARACTERS:
        raise HapticdError(f"name: must have at most {MAX_RECORDING_NAME_CHARACTERS} characters, has {len(stem)}")
    return name


@dataclass(frozen=True, slots=True)
class Listed:
    """A recording in the list of the folder."""

    name: str
    size: int
    """Size of the file, in bytes."""
    modified_ns: int
    """Time at which the file was finished, in ns since 1970."""


class RecordingFolder:
    """The folder of recordings, which is made for the first recording."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def list(self) -> list[Listed]:
        """Return the recordings, the newest first; an empty list if the folder does not exist.

        Raises HapticdError if the folder cannot be read.
        """
        listed = []
        try:
            with self._opened() as fd:
                for name in os.listdir(fd):
                    try:
                        checked_name(name)
                        here = os.stat(name, dir_fd=fd, follow_symlinks=False)
                    except (HapticdError, FileNotFoundError):
                        continue  # not a recording, or deleted meanwhile
                    if stat.S_ISREG(here.st_mode):
                        listed.append(Listed(name, here.st_size, here.st_mtime_ns))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise self._unusable(error) from None
        return sorted(listed, key=lambda each: each.modified_ns, reverse=True)[:_MAX_LISTED_RECORDINGS]

    def target(self, name: object) -> Path:
        """Return the path for a new recording of this name, and make the folder.

        Raises HapticdError if the recording already exists or the folder cannot be made.
        """
        checked = checked_name(name)
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise self._unusable(error) from None
        path = self.path / checked
        if os.path.lexists(path):
            raise HapticdError(f"name: {checked} already exists; use another name, or delete it first")
        return path

    @contextmanager
    def file(self, name: object) -> Iterator[IO[bytes]]:
        """Open a recording for reading. Raises HapticdError if there is no recording of that name."""
        checked = checked_name(name)
        try:
            with self._opened() as folder:
                flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
                fd = os.open(checked, flags, dir_fd=folder)
        except OSError:
            raise self._none(checked) from None
        if not stat.S_ISREG(os.fstat(fd).st_mode):
            os.close(fd)
            raise self._none(checked)
        with open(fd, "rb") as file:
            yield file

    def delete(self, name: object) -> None:
        """Delete a recording. Raises HapticdError if it does not exist or cannot be deleted."""
        checked = checked_name(name)
        with self.file(checked), self._opened() as folder:
            try:
                os.unlink(checked, dir_fd=folder)
            except OSError as error:
                raise HapticdError(f"{checked}: cannot be deleted: {error.strerror}") from None

    def free_bytes(self) -> int | None:
        """Return the free space on the folder's disk, in bytes; None if it is not known."""
        for folder in (self.path, *self.path.parents):
            try:
                disk = os.statvfs(folder)
            except OSError:
                continue
            return disk.f_bavail * disk.f_frsize
        return None

    @contextmanager
    def _opened(self) -> Iterator[int]:
        fd = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            yield fd
        finally:
            os.close(fd)

    def _none(self, name: str) -> HapticdError:
        return HapticdError(f"{name}: no such recording; it may have been deleted")

    def _unusable(self, error: OSError) -> HapticdError:
        return HapticdError(f"{printable(os.fspath(self.path))}: cannot be used for recordings: {error.strerror}")
