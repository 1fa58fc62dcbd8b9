"""What is typed in the wrong place, options or files, and commands that have another name here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import click

_INSTEAD: Final = {
    "help": "hapticd --help, or hapticd COMMAND --help",
    "version": "hapticd --version",
    "start": "hapticd run starts the daemon",
    "stop": "Ctrl-C, or systemctl stop hapticd, ends the daemon",
    "restart": "hapticd reload reads the configuration anew",
    "load": "hapticd scene set, hapticd material set or hapticd apply",
    "set": "hapticd scene set, hapticd material set or hapticd apply",
}
"""What people try who do not know the commands yet."""


def with_hint(error: click.ClickException, arguments: Sequence[str]) -> click.ClickException:
    """An error of a command line, which `arguments` are; with where it belongs, if something is in the wrong place."""
    if not isinstance(error, click.UsageError) or error.ctx is None:
        return error
    where = _where(error, error.ctx, arguments)
    return click.UsageError(f"{error.message.rstrip('.')}: {where}", error.ctx) if where else error


def _where(error: click.UsageError, ctx: click.Context, arguments: Sequence[str]) -> str:
    if isinstance(ctx.command, click.Group) and ctx.parent is not None and _names_none(error):
        return f"known: {', '.join(ctx.command.list_commands(ctx))}"
    if isinstance(error, click.NoSuchCommand):
        return _INSTEAD.get(error.command_name, "")
    if isinstance(error, click.NoSuchOption):
        return _option(error.option_name, ctx, arguments)
    if "unexpected extra argument" in error.message:
        if _has(ctx.command, "-c", ctx):
            return "a file is given with -c"
        if _has(ctx.command, "--operator", ctx):
            return "what the hand does is given with --operator"
    return ""


def _names_none(error: click.UsageError) -> bool:
    """Whether a group is given no command of its own, nor one that is nearly one."""
    if isinstance(error, click.NoSuchCommand):
        return not error.possibilities
    return error.message.startswith("Missing command")


def _option(option: str, ctx: click.Context, arguments: Sequence[str]) -> str:
    root = ctx.find_root()
    if ctx is not root:
        return f"{option} belongs before the command: hapticd {option} ..." if _has(root.command, option, root) else ""
    assert isinstance(root.command, click.Group)
    for name in arguments:
        command = root.command.get_command(root, name)
        if command is not None:
            return f"{option} belongs after {name}: hapticd {name} {option}" if _has(command, option, root) else ""
    return ""


def _has(command: click.Command, option: str, ctx: click.Context) -> bool:
    return any(option in parameter.opts for parameter in command.get_params(ctx))
