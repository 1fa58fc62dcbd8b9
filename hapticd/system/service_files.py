"""`hapticd install-service`: adapts the units to this installation and runs systemd/install.sh."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final, Literal

from hapticd.base.errors import HapticdError, collapse_whitespace, quoted

Action = Literal["system", "user", "remove-system", "remove-user"]

_UNIT_EXECUTABLE: Final = "/usr/bin/hapticd"
"""The executable in the shipped unit files, which the executable of this installation replaces."""
_HIDDEN_FOLDERS: Final = ("/home", "/root", "/run/user")
"""Folders that ProtectHome of the units hides."""


@dataclass(frozen=True, slots=True)
class Installation:
    """The paths of an installation of hapticd."""

    executable: Path
    folders: tuple[Path, ...]
    """Folders of Python, its packages and the executable, all of which hapticd needs to run."""

    @staticmethod
    def this() -> Installation:
        """Return the installation of this process. Raises HapticdError if no executable is installed."""
        places = f"{Path(sys.executable).parent}{os.pathsep}{sysconfig.get_path('scripts')}"
        started = sys.argv[0] if Path(sys.argv[0]).name == "hapticd" else None
        found = shutil.which("hapticd", path=places) or (started and shutil.which(started))
        if not found:
            raise HapticdError(f"no executable `hapticd` in {places}: install the package first (pip install .)")
        path, package = Path(found).absolute(), Path(__file__).resolve().parents[2]
        python = Path(os.path.realpath(sys.executable)).parents[1]
        folders = {Path(sys.prefix).resolve(), Path(sys.base_prefix).resolve(), python, package, path.parent}
        outer = [folder for folder in folders if not any(other in folder.parents for other in folders)]
        return Installation(path, tuple(sorted(outer)))

    def adapted(self, unit: str) -> str:
        """Return a unit file's text with this executable, and read-only mounts of `folders` that the unit hides."""
        unit = unit.replace(f"={_UNIT_EXECUTABLE} ", f"={unit_word(self.executable)} ")
        hidden = [one for one in self.folders if any(one.is_relative_to(place) for place in _HIDDEN_FOLDERS)]
        if not hidden:
            return unit
        lines = "".join(f"BindReadOnlyPaths={unit_word(folder)}\n" for folder in hidden)
        return unit.replace("ProtectHome=yes\n", f"ProtectHome=tmpfs\n{lines}")


def run(action: Action, installation: Installation, root: Path | None = None, dry_run: bool = False) -> list[str]:
    """Run install.sh to install or remove the files of the service, and return the lines of its output.

    The lines are the commands that it ran, or with `dry_run` would run, and hints about missing programs. `root` is the
    root folder of another system, whose services are not reloaded. Raises HapticdError with stderr if a command fails.
    """
    shipped = resources.files("hapticd")
    with (
        tempfile.TemporaryDirectory(prefix="hapticd-units-") as name,
        resources.as_file(shipped / "units") as units,
        resources.as_file(shipped / "shipped" / "default.yaml") as config,
    ):
        folder = shutil.copytree(units, Path(name), dirs_exist_ok=True)
        for unit in folder.glob("*.service"):
            unit.write_text(installation.adapted(unit.read_text("utf-8")), "utf-8")
        environment = {**os.environ, "CONFIG": str(config), "ROOT": str(root.absolute()) if root else ""}
        environment |= {"DRY": "1"} if dry_run else {}
        words = ["sh", str(folder / "install.sh"), action]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        problem = collapse_whitespace(done.stderr) or f"exit code {done.returncode}"
        may_not = "Permission denied" in problem and not action.endswith("user")
        hint = "; run it as root, or install it for your user only with --user" if may_not else ""
        raise HapticdError(f"{problem}{hint}")
    return done.stdout.splitlines()


def unit_word(path: Path) -> str:
    """Return a path as one word of a unit file. Raises HapticdError if it has characters that systemd interprets."""
    text = str(path)
    if not text.isprintable() or set(text) & set("$:;\"'\\"):
        raise HapticdError(f"{quoted(text)}: a unit file cannot contain this path; install hapticd elsewhere")
    text = text.replace("%", "%%")
    return f'"{text}"' if " " in text else text
