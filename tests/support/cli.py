"""What tests of the command line share."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

import click
import pytest

from hapticd.cli import cli, main
from tests.support.daemon_process import PATIENCE_S

HAPTICD = [
    sys.executable,
    "-c",
    "import sys, hapticd.protocol.calls; from hapticd.cli import main\n"
    f"hapticd.protocol.calls.REPLY_TIMEOUT_S = {PATIENCE_S}; sys.exit(main())",
]
"""The command in a process of its own; it waits for an answer as long as the tests do, not five seconds."""


def said(capsys: pytest.CaptureFixture[str], code: int, *arguments: str) -> str:
    """The one line on stderr of a command that fails with `code`; with --json, in the words of one without."""
    assert main(arguments) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    if "--json" in arguments:
        told = json.loads(captured.err)
        assert list(told) == ["error"] and told["error"]["exit_code"] == code
        assert list(told["error"]) == ["message", "code", "exit_code", "problems"]
        return f"hapticd: {told['error']['message']}\n"
    assert captured.err.startswith("hapticd: ") and captured.err.count("\n") == 1, captured.err
    return captured.err


def contexts(ctx: click.Context | None = None) -> Iterator[click.Context]:
    """Of every command, its parent's first."""
    ctx = ctx or click.Context(cli, info_name="hapticd", **cli.context_settings)
    yield ctx
    if isinstance(ctx.command, click.Group):
        for name in ctx.command.list_commands(ctx):
            command = ctx.command.get_command(ctx, name)
            assert command is not None
            yield from contexts(click.Context(command, info_name=name, parent=ctx))


def page_names() -> set[str]:
    """The names of the man pages: of all commands that `--help` lists."""
    return {ctx.command_path.replace(" ", "-") for ctx in contexts() if not ctx.command.hidden}
