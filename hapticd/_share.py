"""Files of a wheel for share/: man pages by click-man, and click's completion scripts.

Run by setuptools (setup.py), never imported by the package. It runs before anything is compiled, and of the package's
dependencies it needs only click.
"""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterator, Mapping
from copy import copy
from inspect import cleandoc
from pathlib import Path
from typing import Final

import click
from click_man.core import write_man_pages

import hapticd.cli
from hapticd._version import __version__
from hapticd.base.files import check_regular
from hapticd.cli.machine import SCRIPT_PATH_BY_SHELL, script

_CHANGELOG_PATH: Final = Path(__file__).resolve().parent.parent / "CHANGELOG.md"
_LITERAL_PARAGRAPH: Final = re.compile(r"\x08\n(.*?)(?=\n\n|\Z)", re.DOTALL)
"""A paragraph of a help text that click does not wrap."""


def write(folder: Path) -> list[str]:
    """Write all man pages and completion scripts to share/ below `folder`; return their paths relative to `folder`."""
    root = _commands()
    files = [*(f"share/man/man1/{name}" for name in _page_names(root)), *SCRIPT_PATH_BY_SHELL.values()]
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        check_regular(folder / file)
    write_man_pages("hapticd", root, version=__version__, target_dir=str(folder / "share/man/man1"), date=_date())
    for shell, file in SCRIPT_PATH_BY_SHELL.items():
        (folder / file).write_text(script(shell), encoding="utf-8")
    return files


def _page_names(command: click.Command, path: str = "hapticd") -> Iterator[str]:
    """Yield the file names of the man pages of a command and of its subcommands, as click-man writes them."""
    yield f"{path}.1"
    for name, below in getattr(command, "commands", {}).items():
        if not below.hidden:
            yield from _page_names(below, f"{path}-{name}")


def _commands() -> click.Command:
    """Load all commands of hapticd, and prepare their help texts for man pages (roff)."""
    ctx = click.Context(hapticd.cli.cli, info_name="hapticd")
    commands = {name: hapticd.cli.cli.get_command(ctx, name) for name in hapticd.cli.cli.list_commands(ctx)}
    return _for_roff(hapticd.cli.cli, {name: command for name, command in commands.items() if command is not None})


def _for_roff(command: click.Command, below: Mapping[str, click.Command]) -> click.Command:
    """Return a copy of a command with the subcommands `below`, whose help texts have the form that roff needs."""
    made = copy(command)
    made.short_help = command.get_short_help_str(limit=200)
    made.help = _LITERAL_PARAGRAPH.sub(r".nf\n\1\n.fi", cleandoc(command.help or ""))
    if isinstance(made, click.Group):
        made.commands = {name: _for_roff(each, getattr(each, "commands", {})) for name, each in below.items()}
    return made


def _date() -> str:
    """Return the date for the man pages: that of SOURCE_DATE_EPOCH, or else of the release in the changelog."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch is not None:
        return datetime.datetime.fromtimestamp(int(epoch), datetime.UTC).date().isoformat()
    released = re.search(
        rf"^## \[{re.escape(__version__)}\] - (.+)$", _CHANGELOG_PATH.read_text(encoding="utf-8"), re.MULTILINE
    )
    return released[1] if released else ""
