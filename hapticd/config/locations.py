"""Which files the configuration is taken from.

In this order: those that a command names (`-c`), those of `$HAPTICD_CONFIG` (several are separated by colons), the
user's, the system's, and none, which means the built-in one. The first that is there is taken alone. One that is there
and cannot be read is an error: no other takes its place.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import one_line

VARIABLE: Final = "HAPTICD_CONFIG"
SYSTEM_CONFIG: Final = Path("/etc/hapticd/config.yaml")

Origin: TypeAlias = Literal["-c", "environment", "user", "system", "built in"]


@dataclass(frozen=True, slots=True)
class Chosen:
    """The files of a configuration, in the order in which they are merged, and by what they were chosen."""

    origin: Origin
    files: tuple[str, ...]
    looked_for: tuple[str, ...]
    """Files that were looked for before and are not there."""

    def __str__(self) -> str:
        named = ", ".join(one_line(os.path.abspath(file)) for file in self.files)
        if self.origin == "built in":
            return f"built in; there is no {' and no '.join(map(one_line, self.looked_for))}"
        return f"{named} (by ${VARIABLE})" if self.origin == "environment" else named


def user_config(environ: Mapping[str, str] | None = None) -> Path:
    """`$XDG_CONFIG_HOME/hapticd/config.yaml`, by default below `~/.config`."""
    environ = os.environ if environ is None else environ
    home = environ.get("XDG_CONFIG_HOME", "")
    # A relative one is to be ignored, says the XDG Base Directory Specification.
    folder = Path(home) if os.path.isabs(home) else Path(os.path.expanduser("~"), ".config")
    return folder / "hapticd" / "config.yaml"


def choose(named: Sequence[str | os.PathLike[str]] = (), environ: Mapping[str, str] | None = None) -> Chosen:
    """The files to take; whether they can be read, and are there, is for check_named and their reader to say."""
    if named:
        return Chosen("-c", tuple(os.fspath(file) for file in named), ())
    environ = os.environ if environ is None else environ
    listed = tuple(filter(None, environ.get(VARIABLE, "").split(os.pathsep)))
    if listed:
        return Chosen("environment", listed, ())
    missed: list[str] = []
    places: tuple[tuple[Origin, Path], ...] = (("user", user_config(environ)), ("system", SYSTEM_CONFIG))
    for origin, path in places:
        if _is_there(path):
            return Chosen(origin, (str(path),), tuple(missed))
        missed.append(str(path))
    return Chosen("built in", (), tuple(missed))


def check_named(chosen: Chosen) -> None:
    """Raises HapticdError for a file that the environment names and that is not there."""
    for file in chosen.files if chosen.origin == "environment" else ():
        if not os.path.exists(file):
            raise HapticdError(f"{one_line(file)}: there is no such file; {VARIABLE} names it")


def _is_there(path: Path) -> bool:
    """Whether something has this name, though it may not be readable: whoever reads it says so."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError:
        return True
    return True
