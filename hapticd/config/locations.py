"""Files of the configuration.

They are the first of: the files given with `-c`; those in `$HAPTICD_CONFIG`, separated by colons; the user's file and
the system's file, if they exist; the built-in configuration. A file that exists but is unreadable is an error.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import printable

CONFIG_VARIABLE: Final = "HAPTICD_CONFIG"
"""Environment variable with the files of the configuration."""
SYSTEM_CONFIG: Final = Path("/etc/hapticd/config.yaml")
"""The system's configuration."""

Origin: TypeAlias = Literal["-c", "environment", "user", "system", "built in"]


@dataclass(frozen=True, slots=True)
class ConfigFiles:
    """Files of a configuration, in the order in which they are merged, and the reason for their choice."""

    origin: Origin
    files: tuple[str, ...]
    missing: tuple[str, ...]
    """Files that come earlier in the search order, but do not exist."""

    def __str__(self) -> str:
        named = ", ".join(printable(os.path.abspath(file)) for file in self.files)
        if self.origin == "built in":
            return f"built in; there is no {' and no '.join(map(printable, self.missing))}"
        return f"{named} (by ${CONFIG_VARIABLE})" if self.origin == "environment" else named


def user_config(environ: Mapping[str, str] | None = None) -> Path:
    """Return `$XDG_CONFIG_HOME/hapticd/config.yaml`, by default below `~/.config`."""
    environ = os.environ if environ is None else environ
    home = environ.get("XDG_CONFIG_HOME", "")
    # The XDG Base Directory Specification ignores relative paths.
    folder = Path(home) if os.path.isabs(home) else Path(os.path.expanduser("~"), ".config")
    return folder / "hapticd" / "config.yaml"


def choose(named: Sequence[str | os.PathLike[str]] = (), environ: Mapping[str, str] | None = None) -> ConfigFiles:
    """Choose the files of the configuration without reading them; check_named reports missing files."""
    if named:
        return ConfigFiles("-c", tuple(os.fspath(file) for file in named), ())
    environ = os.environ if environ is None else environ
    listed = tuple(filter(None, environ.get(CONFIG_VARIABLE, "").split(os.pathsep)))
    if listed:
        return ConfigFiles("environment", listed, ())
    missing: list[str] = []
    places: tuple[tuple[Origin, Path], ...] = (("user", user_config(environ)), ("system", SYSTEM_CONFIG))
    for origin, path in places:
        if _exists(path):
            return ConfigFiles(origin, (str(path),), tuple(missing))
        missing.append(str(path))
    return ConfigFiles("built in", (), tuple(missing))


def check_named(chosen: ConfigFiles) -> None:
    """Raise HapticdError if the environment names a file that does not exist."""
    for file in chosen.files if chosen.origin == "environment" else ():
        if not os.path.exists(file):
            raise HapticdError(f"{printable(file)}: no such file; {CONFIG_VARIABLE} names it")


def _exists(path: Path) -> bool:
    """Return whether a file of this name exists, even if it is unreadable."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError:
        return True
    return True
