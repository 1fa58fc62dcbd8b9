"""README's installation from a wheel, in every Python of this machine: `python packaging/try_wheel.py WHEEL`.

With `--list` it lists those Pythons, one of each minor version.

The block of README.md that installs a wheel runs as it stands there, in a folder with nothing but the wheel. It runs
once for each CPython that `requires-python` allows and that can make virtual environments. The package findpython finds
them: on PATH, and those of pyenv and the like. After each block comes a first tap (first_tap.py), at the end
`pipx install`.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

import findpython
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parent.parent
FIRST_TAP = ROOT / "packaging" / "first_tap.py"
WHEEL_BLOCK = re.compile(r"^(?:    .*\n)*    .*hapticd-\*\.whl.*\n(?:    .*\n)*", re.MULTILINE)


def block() -> str:
    """The commands by which README.md installs a wheel."""
    (found,) = WHEEL_BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    return re.sub("^    ", "", found, flags=re.MULTILINE)


def environment_of(commands: str) -> str:
    """The virtual environment that the commands make, relative to where they run."""
    (folder,) = re.findall(r"^python3 -m venv (\S+)$", commands, re.MULTILINE)
    return str(folder)


def pythons() -> Iterator[tuple[str, Path]]:
    """Version and interpreter of each CPython that the package supports, the newest first; each interpreter once."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    supported = SpecifierSet(project["requires-python"])
    seen: set[Path] = set()
    for each in findpython.find_all(allow_prereleases=False):
        interpreter = Path(each.interpreter).resolve()
        usable = each.implementation == "cpython" and not each.freethreaded and str(each.version) in supported
        if usable and interpreter not in seen:
            seen.add(interpreter)
            yield str(each.version), interpreter


def run(words: list[str | Path], folder: Path, **variables: str) -> str:
    """What a command prints that runs in `folder`, without what the shell says of Python or hapticd.

    Ends the program where the command fails.
    """
    environment = {
        key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "HAPTICD", "VIRTUAL"))
    }
    done = subprocess.run(
        words, cwd=folder, env=environment | variables, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}\n{done.stdout}{done.stderr}exit code {done.returncode}")
    return done.stdout


def try_block(interpreter: Path, wheel: Path, folder: Path) -> str:
    """The block of README.md with `interpreter` as python3; the line of the first tap."""
    commands = block()
    path = folder / "path"
    path.mkdir()
    # Not a link: a virtual environment made through one would look for its library beside the link.
    (path / "python3").write_text(f'#!/bin/sh\nexec "{interpreter}" "$@"\n')
    (path / "python3").chmod(0o755)
    shutil.copy(wheel, folder)
    said = run(["sh", "-ec", commands], folder, PATH=f"{path}:{os.environ['PATH']}", HOME=str(Path.home()))
    if "7 contacts" not in said:
        sys.exit(f"README.md, installing a wheel: no seven contacts in what it printed\n{said}")
    return run([folder / environment_of(commands) / "bin" / "python", FIRST_TAP], folder).strip()


def try_pipx(wheel: Path, folder: Path) -> str:
    """`pipx install WHEEL` into a home of its own; what its command says, and its man page."""
    binaries, pages = folder / "bin", folder / "man"
    variables = {"PIPX_HOME": str(folder / "pipx"), "PIPX_BIN_DIR": str(binaries), "PIPX_MAN_DIR": str(pages)}
    pipx: list[str | Path] = [sys.executable, "-m", "pipx"]
    run([*pipx, "install", "--python", sys.executable, wheel], folder, **variables)
    said = run([binaries / "hapticd", "simulate", "materials"], folder).strip()
    if not (pages / "man1" / "hapticd.1").exists():
        sys.exit("pipx install: no man page hapticd.1 where pipx puts those of a package")
    return said


def has_venv(interpreter: Path) -> bool:
    """Whether it can make virtual environments: distributions have that in a package of its own."""
    return subprocess.run([interpreter, "-c", "import ensurepip, venv"], capture_output=True).returncode == 0


def able() -> Iterator[Path]:
    """Those that can make virtual environments, the newest first; a line on stderr for each that cannot."""
    for version, interpreter in pythons():
        if has_venv(interpreter):
            yield interpreter
        else:
            print(f"Python {version} ({interpreter}): skipped, it has no venv", file=sys.stderr)


def main(wheel: Path) -> None:
    """Each Python, then pipx; a line for each."""
    found = list(able())
    for interpreter in found:
        with tempfile.TemporaryDirectory(prefix="hapticd-") as folder:
            print(f"{try_block(interpreter, wheel, Path(folder))} ({interpreter})", flush=True)
    if not found:
        sys.exit("no Python of this machine can try the wheel: install one with venv (Debian: python3-venv)")
    with tempfile.TemporaryDirectory(prefix="hapticd-") as folder:
        print(f"pipx install: {try_pipx(wheel, Path(folder))}")


if __name__ == "__main__":
    if sys.argv[1:] == ["--list"]:
        print(*{interpreter.name: interpreter for interpreter in able()}.values(), sep="\n")
    elif len(sys.argv) == 2 and Path(sys.argv[1]).is_file():
        main(Path(sys.argv[1]).resolve())
    else:
        sys.exit("usage: try_wheel.py --list | WHEEL")
