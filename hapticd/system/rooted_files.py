"""Files below a folder that is taken for the root of a system: no symbolic link leads out of it.

Each folder on the way to a file is opened by its name in the one above it, so that what is written, read or removed is
below the root, whoever changes names meanwhile.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.base.files import put

_FOLDER: Final = os.O_DIRECTORY | os.O_CLOEXEC
_MOST_BYTES: Final = 1 << 24


@dataclass(frozen=True, slots=True)
class Rooted:
    """Where files are put. With `strict`, a symbolic link below `root` is refused; else links are followed."""

    root: Path = Path("/")
    strict: bool = False
    mode: int = 0o755
    """Of folders that are made, whatever the umask."""

    def check(self, path: Path) -> None:
        """Raises HapticdError where a link stands in the place of a folder on the way to `path`."""
        self.exists(path)

    def exists(self, path: Path) -> bool:
        """Whether something has this name, a link too. Raises HapticdError where that is not known."""
        try:
            with self._parent(path, make=False) as folder:
                os.stat(path.name, dir_fd=folder, follow_symlinks=False)
        except FileNotFoundError:
            return False
        except OSError as error:
            raise HapticdError(f"{path}: {error.strerror}") from None
        return True

    def read(self, path: Path) -> str | None:
        """A regular file's text; None for everything else. Raises HapticdError where it cannot be read."""
        try:
            with self._parent(path, make=False) as folder:
                if not stat.S_ISREG(os.stat(path.name, dir_fd=folder, follow_symlinks=False).st_mode):
                    return None
                fd = os.open(path.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
                with open(fd, "rb") as file:
                    return file.read(_MOST_BYTES).decode("utf-8")
        except UnicodeDecodeError:
            return None
        except OSError as error:
            raise HapticdError(f"{path}: cannot be read: {error.strerror}") from None

    def write(self, path: Path, text: str) -> None:
        """Puts a file in place, whole, with mode 0644; makes the folders that are missing. Raises HapticdError."""
        part = f".{path.name}.{os.getpid()}.part"
        try:
            with self._parent(path, make=True) as folder:
                try:
                    out = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644, dir_fd=folder)
                    with open(out, "w", encoding="utf-8") as file:
                        os.fchmod(out, 0o644)
                        file.write(text)
                    put(part, path.name, True, folder)
                except OSError:
                    with suppress(OSError):
                        os.unlink(part, dir_fd=folder)
                    raise
        except OSError as error:
            raise HapticdError(f"{path}: cannot be written: {error.strerror}") from None

    def remove(self, path: Path) -> None:
        """Removes a file. Raises HapticdError."""
        try:
            with self._parent(path, make=False) as folder:
                os.unlink(path.name, dir_fd=folder)
        except OSError as error:
            raise HapticdError(f"{path}: cannot be removed: {error.strerror}") from None

    @contextmanager
    def _parent(self, path: Path, make: bool) -> Iterator[int]:
        """The folder of a file, opened. Raises OSError, and HapticdError for a link that is not to be followed."""
        if make:
            self.root.mkdir(parents=True, exist_ok=True)
        folder, place = os.open(self.root, _FOLDER | os.O_PATH), self.root
        try:
            for name in path.parent.relative_to(self.root).parts:
                place /= name
                made = make and _make(name, folder)
                if self.strict and stat.S_ISLNK(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode):
                    raise HapticdError(f"{place}: is a symbolic link; below --root it must be a folder")
                flags = _FOLDER | (os.O_RDONLY if made else os.O_PATH) | (os.O_NOFOLLOW if self.strict else 0)
                inner = os.open(name, flags, dir_fd=folder)
                os.close(folder)
                folder = inner
                if made:
                    os.fchmod(folder, self.mode)
            yield folder
        finally:
            os.close(folder)


def _make(name: str, folder: int) -> bool:
    """Whether the folder was missing."""
    try:
        os.mkdir(name, 0o700, dir_fd=folder)
    except FileExistsError:
        return False
    return True
