"""What is typed in the wrong place: options before or after their command, files without their option."""

from __future__ import annotations

from collections.abc import Sequence

import click


def with_hint(error: click.ClickException, arguments: Sequence[str]) -> click.ClickException:
    """An error of a command line, which `arguments` are; with where it belongs, if something is in the wrong place."""
    if not isinstance(error, click.UsageError) or error.ctx is None:
        return error
    where = _where(error, error.ctx, arguments)
    return click.UsageError(f"{error.message.rstrip('.')}: {where}", error.ctx) if where else error


def _where(error: click.UsageError, ctx: click.Context, arguments: Sequence[str]) -> str:
    if isinstance(error, click.NoSuchOption):
        return _option(error.option_name, ctx, arguments)
    if "unexpected extra argument" in error.message and _has(ctx.command, "-c", ctx):
        return "a file is given with -c"
    return ""


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
