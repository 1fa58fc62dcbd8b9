"""What a wheel brings for a prefix's share/: man pages, made of the commands, and completion scripts.

Run by setuptools (setup.py), never imported by the package. It runs before anything is compiled, and with click alone
of what the package needs.
"""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import click
from click_man.man import ManPage

import hapticd.cli
from hapticd._version import __version__
from hapticd.base.files import check_regular
from hapticd.cli.completion import SHELLS, script

_CHANGELOG: Final = Path(__file__).resolve().parent.parent / "CHANGELOG.md"
# What roff would take for something else than the ASCII character that is meant.
_ESCAPES: Final = str.maketrans({"\\": r"\(rs", "'": r"\(aq", "`": r"\(ga", "^": r"\(ha", "~": r"\(ti"})
# A hyphen that begins an option; the others may stand at the end of a line.
_DASH: Final = re.compile(r"(?<![\w-])-+(?=\w)|-(?=-)|(?<=-)-")


def write(folder: Path) -> list[str]:
    """Writes all files, share/... below `folder`; returns their names there."""
    files = {f"share/man/man1/{name}.1": page for name, page in man_pages().items()}
    files |= {place: script(shell) for shell, place in SHELLS.items()}
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        check_regular(path)
        path.write_text(text, encoding="utf-8")
    return list(files)


def man_pages() -> dict[str, str]:
    """The source of each page, by its name. The same commands give the same bytes, whenever and wherever."""
    root = click.Context(hapticd.cli.cli, info_name="hapticd", **hapticd.cli.cli.context_settings)
    return {_name(ctx): _page(ctx) for ctx in _contexts(root)}


def _contexts(ctx: click.Context) -> Iterator[click.Context]:
    yield ctx
    for name, command in _subcommands(ctx):
        yield from _contexts(click.Context(command, info_name=name, parent=ctx))


def _subcommands(ctx: click.Context) -> Iterator[tuple[str, click.Command]]:
    group = ctx.command
    if isinstance(group, click.Group):
        for name in group.list_commands(ctx):
            command = group.get_command(ctx, name)
            if command is not None and not command.hidden:
                yield name, command


def _page(ctx: click.Context) -> str:
    page = ManPage(ctx.command_path)
    page.short_help = _escaped(_short(ctx.command))
    page.synopsis = " ".join(ctx.command.collect_usage_pieces(ctx))
    page.description = _prose(ctx.command.help or "")
    options = [each for each in ctx.command.get_params(ctx) if isinstance(each, click.Option)]
    records = [each.get_help_record(ctx) for each in options]
    page.options = [(_escaped(record[0]), _dashed(_escaped(record[1]))) for record in records if record is not None]
    title, _, rest = str(page).partition("\n")
    title = f'.TH "{_name(ctx).upper()}" "1" "{_date()}" "hapticd {__version__}" "hapticd"'
    return "\n".join([title, rest.rstrip("\n"), *_commands(ctx), *_variables(ctx), *_ending(ctx), ""])


def _commands(ctx: click.Context) -> Iterator[str]:
    # click-man would name the page of a command in a group wrongly.
    below = list(_subcommands(ctx))
    if below:
        yield ".SH COMMANDS"
    for name, command in below:
        yield from (".TP", _reference(f"{_name(ctx)}-{name}"), _dashed(_escaped(_short(command))) + ".")


def _variables(ctx: click.Context) -> Iterator[str]:
    options = [each for each in ctx.command.params if isinstance(each, click.Option) and each.envvar is not None]
    if options:
        yield ".SH ENVIRONMENT"
    for option in options:
        names = [option.envvar] if isinstance(option.envvar, str) else list(option.envvar or ())
        yield from (".TP", f"\\fB{', '.join(names)}\\fP", f"Stands in for {_dashed(option.opts[0])}.")


def _ending(ctx: click.Context) -> Iterator[str]:
    if ctx.parent is not None:
        yield from (".SH SEE ALSO", _reference(_name(ctx.parent)))
        return
    # The module's own words: its second paragraph is about exit codes.
    yield from (".SH EXIT STATUS", _prose((hapticd.cli.__doc__ or "").split("\n\n")[1].strip()))


def _name(ctx: click.Context) -> str:
    return ctx.command_path.replace(" ", "-")


def _reference(name: str) -> str:
    return r"\fB{}\fP(1)".format(name.replace("-", r"\-"))


def _short(command: click.Command) -> str:
    return command.get_short_help_str(limit=200).rstrip(".")


def _prose(text: str) -> str:
    """Help as roff: paragraphs, and as they stand those that click must not wrap."""
    blocks = []
    for block in text.partition("\f")[0].strip("\n").split("\n\n"):
        lines = [_dashed(_escaped(line)) for line in block.split("\n") if line.strip() != "\b"]
        literal = block.lstrip().startswith("\b")
        blocks.append("\n".join([".RS 4", ".nf", *lines, ".fi", ".RE"] if literal else map(str.strip, lines)))
    return "\n\n".join(blocks)


def _escaped(text: str) -> str:
    # A line that began with a full stop would be a request of roff's.
    return "\n".join(rf"\&{line}" if line.startswith(".") else line for line in text.translate(_ESCAPES).split("\n"))


def _dashed(text: str) -> str:
    return _DASH.sub(lambda found: found[0].replace("-", r"\-"), text)


def _date() -> str:
    """The day of the sources, or of the release as the changelog has it."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch is not None:
        return datetime.datetime.fromtimestamp(int(epoch), datetime.UTC).date().isoformat()
    released = re.search(
        rf"^## \[{re.escape(__version__)}\] - (.+)$", _CHANGELOG.read_text(encoding="utf-8"), re.MULTILINE
    )
    return released[1] if released else ""
