"""`hapticd install-service`: units, users, folders, udev rules and a first configuration in their places.

What is written carries its own checksum in its last line, so that the next call knows what somebody has changed since:
that is never overwritten, the new one is put beside it as `.new`. Every step is reported.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final, Literal

from hapticd._version import __version__
from hapticd.base.errors import HapticdError, on_one_line, quoted
from hapticd.config.locations import user_config
from hapticd.system.rooted_files import Rooted

_MARK: Final = "# Put here by `hapticd install-service` of version "
_SUM: Final = "; sha256 of the lines above: "
_EXECUTABLE: Final = "/usr/bin/hapticd"
"""As the unit files name it."""
_HIDDEN: Final = ("/home", "/root", "/run/user")
_TEMPORARY: Final = ("/tmp", "/var/tmp")
_COMMAND_S: Final = 60.0

Kind = Literal["wrote", "updated", "unchanged", "kept", "removed", "absent", "ran", "failed", "note"]


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that was done, or would be."""

    kind: Kind
    what: str
    """A path, or a command."""
    detail: str = ""

    def __str__(self) -> str:
        text = self.what if self.kind == "note" else f"{self.kind} {self.what}"
        return f"{text}: {self.detail}" if self.detail else text

    def would(self) -> str:
        """As text, of a step that is only tried: nothing was done."""
        done = {"wrote": "would write", "updated": "would update", "removed": "would remove", "ran": "would run"}
        return str(self).replace(self.kind, done[self.kind], 1) if self.kind in done else str(self)

    def to_dict(self) -> dict[str, str]:
        """For programs."""
        return {"kind": self.kind, "what": self.what, "detail": self.detail}


@dataclass(frozen=True, slots=True)
class Installation:
    """Where this hapticd is."""

    executable: Path
    folders: tuple[Path, ...]
    """What it needs to run, beside the system's own files."""

    @staticmethod
    def this() -> Installation:
        """Of this process. Raises HapticdError where no executable is installed."""
        places = [Path(sys.executable).parent, Path(sysconfig.get_path("scripts"))]
        started = Path(sys.argv[0])
        found = [place / "hapticd" for place in places] + ([started.absolute()] if started.name == "hapticd" else [])
        for path in found:
            if path.is_file() and os.access(path, os.X_OK):
                package = Path(__file__).resolve().parents[2]
                python = Path(os.path.realpath(sys.executable)).parents[1]
                folders = {Path(sys.prefix).resolve(), Path(sys.base_prefix).resolve(), python, package, path.parent}
                outer = [folder for folder in folders if not any(other in folder.parents for other in folders)]
                return Installation(path, tuple(sorted(outer)))
        raise HapticdError(f"no executable `hapticd` in {places[0]}: install the package first (pip install .)")


@dataclass(frozen=True, slots=True)
class _Target:
    """A file to be installed, with the text that it gets."""

    path: Path
    body: str
    packaged: Path | None = None
    """Where a distribution's package would have put it."""


class Service:
    """One installation, into the system or for one user."""

    def __init__(
        self,
        installation: Installation,
        *,
        user: bool = False,
        root: Path | None = None,
        dry_run: bool = False,
        config_home: Path | None = None,
        run: Callable[[Sequence[str]], str | None] | None = None,
        booted: Path | None = None,
        udev: Path = Path("/run/udev/control"),
        may_write: Callable[[Path], bool] = lambda folder: os.access(folder, os.W_OK | os.X_OK),
    ) -> None:
        """`root`: instead of the system's; nothing of the running system is touched then, and no symbolic link below it
        is followed. `run`: does a command, and says what was wrong with it. `booted`, `udev`: what is there while
        systemd, the user's own with `user`, and udev run."""
        self._installation = installation
        self._user = user
        self._root = root
        self._files = Rooted(root or Path("/"), strict=root is not None, mode=0o700 if user else 0o755)
        self._dry = dry_run
        self._config_home = config_home or user_config().parents[1]
        self._run = run or _run
        self._booted = booted or (_user_manager() if user else Path("/run/systemd/system"))
        self._udev = udev
        self._writable = may_write

    # ---- What it does ----------------------------------------------------------------------------------------------

    def install(self) -> Iterator[Step]:
        """Does it, step by step. Raises HapticdError, before anything is changed where that can be."""
        targets = self._targets()
        for target in targets:
            self._files.check(target.path)
        if not self._dry:
            self._may_write([target.path for target in targets])
        for folder in self._installation.folders:
            if not self._user and _below(folder, _TEMPORARY):
                yield Step("note", f"{folder} may be emptied at the next start; an installation elsewhere would last")
        for target in targets:
            yield self._put(target)
        yield from self._commands(self._after_install())
        if self._root is None:
            yield Step("note", f"start it: {self._systemctl('enable', '--now', 'hapticd')}")

    def uninstall(self) -> Iterator[Step]:
        """Takes away what `install` put there and nobody changed since."""
        targets = self._targets()
        there = [target.path for target in targets if self._files.exists(target.path)]
        if not self._dry:
            self._may_write(there)
        units = [path.name for path in there if path.suffix == ".service"]
        if units and self._root is None:
            if self._booted.exists():
                yield from self._commands([self._systemctl("disable", "--now", *units).split()])
            else:
                yield Step("note", f"systemd does not run here, so no service is stopped: {', '.join(units)}")
        for target in targets:
            yield self._take_away(target.path)
            beside = _beside(target.path)
            if self._files.exists(beside):
                yield self._take_away(beside)
        yield from self._commands(self._after_uninstall())
        if not self._user:
            yield Step("note", "users, groups, keys and /var/lib/hapticd are left as they are")

    # ---- Files -----------------------------------------------------------------------------------------------------

    def _targets(self) -> list[_Target]:
        default = _shipped("shipped", "default.yaml")
        if self._user:
            home = self._config_home
            unit = self._adapted(_shipped("units", "hapticd.user.service"))
            return [
                _Target(home / "systemd" / "user" / "hapticd.service", unit),
                _Target(home / "hapticd" / "config.yaml", default),
            ]
        root = self._root or Path("/")
        bodies = {
            "systemd/system/hapticd.service": self._adapted(_shipped("units", "hapticd.service")),
            "systemd/system/hapticd-web.service": self._adapted(_shipped("units", "hapticd-web.service")),
            "sysusers.d/hapticd.conf": _shipped("units", "sysusers.conf"),
            "tmpfiles.d/hapticd.conf": _shipped("units", "tmpfiles.conf"),
            "udev/rules.d/70-hapticd.rules": _shipped("units", "70-hapticd.rules"),
            "udev/rules.d/70-hapticd-idle.rules": _shipped("units", "70-hapticd-idle.rules"),
        }
        return [
            *(_Target(root / "etc" / name, body, root / "usr/lib" / name) for name, body in bodies.items()),
            _Target(root / "etc" / "hapticd" / "config.yaml", default),
        ]

    def _adapted(self, unit: str) -> str:
        """With this installation's executable, and its folders where the sandbox would hide them."""
        unit = unit.replace(f"={_EXECUTABLE} ", f"={unit_word(self._installation.executable)} ")
        folders = self._installation.folders
        homes = [folder for folder in folders if _below(folder, _HIDDEN)]
        temporary = [folder for folder in folders if _below(folder, _TEMPORARY)]
        if homes:
            unit = unit.replace("ProtectHome=yes\n", "ProtectHome=tmpfs\n")
        shown = "".join(f"BindReadOnlyPaths={unit_word(folder)}\n" for folder in (*homes, *temporary))
        return unit.replace("PrivateTmp=yes\n", f"PrivateTmp=yes\n{shown}") if shown else unit

    def _put(self, target: _Target) -> Step:
        path, text = target.path, _signed(target.body)
        if not self._files.exists(path):
            if target.packaged is not None and self._brought(target.packaged, target.body):
                return Step("unchanged", str(target.packaged))
            return self._write(path, text, "wrote")
        old = self._files.read(path)
        if old is not None and old in (text, target.body):
            return Step("unchanged", str(path))
        if old is not None and _is_ours(old):
            return self._write(path, text, "updated")
        if old is not None and _sum_of(old) == _checksum(target.body):
            return Step("kept", str(path), "changed by hand; what hapticd ships has not changed since")
        beside = _beside(path)
        self._write(beside, text, "wrote")
        return Step("kept", str(path), f"changed by hand; what hapticd ships now is beside it, as {beside.name}")

    def _brought(self, path: Path, body: str) -> bool:
        """Whether a package has put this very text there."""
        return self._files.exists(path) and self._files.read(path) == body

    def _write(self, path: Path, text: str, kind: Kind) -> Step:
        if not self._dry:
            self._files.write(path, text)
        return Step(kind, str(path))

    def _take_away(self, path: Path) -> Step:
        if not self._files.exists(path):
            return Step("absent", str(path))
        old = self._files.read(path)
        if old is None or not _is_ours(old):
            return Step("kept", str(path), "changed by hand")
        if not self._dry:
            self._files.remove(path)
        return Step("removed", str(path))

    def _may_write(self, paths: Sequence[Path]) -> None:
        for path in paths:
            place = path.parent
            while not place.exists():
                place = place.parent
            if not self._writable(place):
                todo = "" if self._user else "; run it as root, or install it for yourself alone with --user"
                raise HapticdError(f"{path}: no permission to write into {place}{todo}")

    # ---- Commands --------------------------------------------------------------------------------------------------

    def _after_install(self) -> list[list[str]]:
        if self._user:
            return [self._systemctl("daemon-reload").split()] if self._booted.exists() else []
        within = [] if self._root is None else [f"--root={self._root}"]
        commands = [
            ["systemd-sysusers", *within, "hapticd.conf"],
            ["systemd-tmpfiles", *within, "--create", "hapticd.conf"],
        ]
        if self._root is None:
            if self._udev.exists():
                commands += [
                    ["udevadm", "control", "--reload"],
                    ["udevadm", "trigger", "--subsystem-match=hidraw"],
                    ["udevadm", "trigger", "--name-match=/dev/cpu_dma_latency"],
                ]
            if self._booted.exists():
                commands.append(["systemctl", "daemon-reload"])
        return commands

    def _after_uninstall(self) -> list[list[str]]:
        if self._root is not None:
            return []
        commands = [["udevadm", "control", "--reload"]] if not self._user and self._udev.exists() else []
        return [*commands, self._systemctl("daemon-reload").split()] if self._booted.exists() else commands

    def _systemctl(self, *words: str) -> str:
        return " ".join(["systemctl", *(["--user"] if self._user else []), *words])

    def _commands(self, commands: Sequence[Sequence[str]]) -> Iterator[Step]:
        if commands and self._root is not None and os.geteuid() != 0:
            # Into a package's folder: who made it could give nothing in it to another user.
            names = " and ".join(f"`{' '.join(word for word in words if '--root' not in word)}`" for words in commands)
            yield Step("note", f"{names} need root: left to whoever installs the package")
            return
        for words in commands:
            if shutil.which(words[0]) is None:
                yield Step("note", f"{words[0]} is not here: `{' '.join(words)}` is left to you")
                continue
            problem = None if self._dry else self._run(words)
            yield Step("ran" if problem is None else "failed", " ".join(words), problem or "")


def _user_manager() -> Path:
    """The socket of the user's own systemd."""
    return Path(os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.getuid()}", "systemd", "private")


def unit_word(path: Path) -> str:
    """A path as one word of a unit file. Raises HapticdError for one that has characters of systemd's own."""
    text = str(path)
    if not text.isprintable() or set(text) & set("$:;\"'\\"):
        raise HapticdError(f"{quoted(text)}: a unit file has no way to name this path; install hapticd elsewhere")
    text = text.replace("%", "%%")
    return f'"{text}"' if " " in text else text


def _run(words: Sequence[str]) -> str | None:
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=_COMMAND_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return on_one_line(str(error))
    if done.returncode == 0:
        return None
    return on_one_line(done.stderr) or f"exit code {done.returncode}"


def _shipped(folder: str, name: str) -> str:
    return resources.files("hapticd").joinpath(folder, name).read_text(encoding="utf-8")


def _below(path: Path, places: Sequence[str]) -> bool:
    return any(path.is_relative_to(place) for place in places)


def _beside(path: Path) -> Path:
    return path.with_name(path.name + ".new")


def _checksum(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()


def _signed(body: str) -> str:
    return f"{body}{_MARK}{__version__}{_SUM}{_checksum(body)}\n"


def _sum_of(text: str) -> str | None:
    """The checksum that a file was written with; None without one."""
    # Not the last line alone: what somebody adds most often stands behind it.
    marks = [line for line in text.splitlines() if line.startswith(_MARK)]
    return marks[-1].partition(_SUM)[2] or None if marks else None


def _is_ours(text: str) -> bool:
    """Whether nobody changed it since."""
    body = text.rstrip("\n").rpartition("\n")[0] + "\n"
    return _sum_of(text) == _checksum(body)
