"""The folder of recordings: names, a list, files to read and to delete.

A page names a recording by what the list says, never by a path. Everything is done relative to the folder's descriptor,
and a file is opened only if it is a regular file of that folder: no link, no folder, no pipe.
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
from hapticd.base.yaml_source import Json, one_line

LONGEST_NAME: Final = 64
_NAME: Final = re.compile(r"[^\W_][\w .+-]*")
_MOST_LISTED: Final = 1000


def default_folder(environ: Mapping[str, str] | None = None) -> Path:
    """`recordings` in the state directory that systemd gives a service, or else `$XDG_DATA_HOME/hapticd/recordings`, by
    default below `~/.local/share`."""
    environ = os.environ if environ is None else environ
    state = environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if os.path.isabs(state):
        return Path(state) / "recordings"
    home = environ.get("XDG_DATA_HOME", "")
    # A relative one is to be ignored, says the XDG Base Directory Specification.
    folder = Path(home) if os.path.isabs(home) else Path(os.path.expanduser("~"), ".local", "share")
    return folder / "hapticd" / "recordings"


def checked_name(name: object) -> str:
    """A recording's name with its ending, `tap 3.npz`. Raises HapticdError for anything that could be a path."""
    if not isinstance(name, str):
        raise HapticdError("name: must be a text")
    stem, ending = os.path.splitext(name)
    if ending != ".npz":
        raise HapticdError(f"name: must end in .npz, is {name!r:.80}")
    if not _NAME.fullmatch(stem) or ".." in stem or stem[-1] in " .":
        raise HapticdError(
            "name: takes letters, digits, spaces and _ . + - ; it begins with a letter or a digit, ends with neither "
            f"space nor dot, and is {name!r:.80}"
        )
    if len(stem) > LONGEST_NAME or len(os.fsencode(name)) > 3 * LONGEST_NAME:
        raise HapticdError(f"name: must have at most {LONGEST_NAME} characters, has {len(stem)}")
    return name


@dataclass(frozen=True, slots=True)
class Listed:
    """A recording of the folder."""

    name: str
    size: int
    """Bytes."""
    modified_ns: int
    """When it was finished, ns since 1970."""

    def to_dict(self) -> dict[str, Json]:
        return {"name": self.name, "size": self.size, "modified_ns": self.modified_ns}


class RecordingFolder:
    """One folder, made when the first recording goes into it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def list(self) -> list[Listed]:
        """The recordings, newest first; none where there is no folder yet. Raises HapticdError where it may not be
        read."""
        found = []
        try:
            with self._opened() as fd:
                for name in os.listdir(fd):
                    try:
                        checked_name(name)
                        here = os.stat(name, dir_fd=fd, follow_symlinks=False)
                    except (HapticdError, FileNotFoundError):
                        continue  # It is no recording of ours, or it was deleted meanwhile.
                    if stat.S_ISREG(here.st_mode):
                        found.append(Listed(name, here.st_size, here.st_mtime_ns))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise self._unusable(error) from None
        return sorted(found, key=lambda each: each.modified_ns, reverse=True)[:_MOST_LISTED]

    def target(self, name: object) -> Path:
        """Where a new recording of this name goes; makes the folder. Raises HapticdError where the name is taken, or
        the folder cannot be made."""
        checked = checked_name(name)
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise self._unusable(error) from None
        path = self.path / checked
        if os.path.lexists(path):
            raise HapticdError(f"name: there is a recording {checked} already; take another name, or delete it first")
        return path

    @contextmanager
    def file(self, name: object) -> Iterator[IO[bytes]]:
        """A recording, to be read. Raises HapticdError where there is none of that name."""
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
        """Raises HapticdError where there is no recording of that name, or it may not be deleted."""
        checked = checked_name(name)
        with self.file(checked), self._opened() as folder:
            try:
                os.unlink(checked, dir_fd=folder)
            except OSError as error:
                raise HapticdError(f"{checked}: cannot be deleted: {error.strerror}") from None

    def free_bytes(self) -> int | None:
        """Room on its disk; None where there is no folder yet, nor one above it."""
        for folder in (self.path, *self.path.parents):
            try:
                found = os.statvfs(folder)
            except OSError:
                continue
            return found.f_bavail * found.f_frsize
        return None

    @contextmanager
    def _opened(self) -> Iterator[int]:
        fd = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            yield fd
        finally:
            os.close(fd)

    def _none(self, name: str) -> HapticdError:
        return HapticdError(f"{name}: there is no such recording; it may have been deleted")

    def _unusable(self, error: OSError) -> HapticdError:
        return HapticdError(f"{one_line(os.fspath(self.path))}: cannot be used for recordings: {error.strerror}")
