"""What a command that fails says: one line on stderr, on a terminal one a fault, or with --json one JSON object there.

    {"error": {"message": "...", "code": -32003, "exit_code": 1, "problems": [{"where": "...", "problem": "..."}]}}

`code` is that of the protocol: the daemon's own, that for a daemon which is not there, or that for faults of what was
given, whoever found them; null for everything else. stdout stays empty, or holds what came before. Ctrl-C says nothing.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

import click

from hapticd.base.errors import HapticdError, InvalidError, Problem, lines_of, on_one_line


def asks_for_json(arguments: Sequence[str]) -> bool:
    """Whether a command line asks for JSON, also one that is not understood."""
    before = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return "--json" in before


def tell(error: BaseException | str, exit_code: int, as_json: bool) -> int:
    """Says on stderr what went wrong; returns the exit code."""
    message = on_one_line(_message(error, as_json))
    found = _problems(error)
    if as_json:
        problems = [{"where": each.where, "problem": each.problem} for each in found]
        told = {"message": message, "code": _code(error), "exit_code": exit_code, "problems": problems}
        print(json.dumps({"error": told}, ensure_ascii=False), file=sys.stderr)
        return exit_code
    on_terminal = sys.stderr is not None and sys.stderr.isatty()
    several = [on_one_line(line) for line in lines_of(found)] if len(found) > 1 and on_terminal else []
    for line in several or [message]:
        print("hapticd:", line, file=sys.stderr)
    return exit_code


def _message(error: BaseException | str, as_json: bool) -> str:
    if isinstance(error, click.ClickException):
        hint = ""
        if isinstance(error, click.UsageError) and error.ctx is not None and not as_json:
            hint = f" (see {error.ctx.command_path} --help)"
        return error.format_message() + hint
    return str(error)


def _problems(error: BaseException | str) -> tuple[Problem, ...]:
    found = getattr(error, "problems", ())
    return found if isinstance(found, tuple) else ()


def _code(error: BaseException | str) -> int | None:
    if not isinstance(error, HapticdError):
        return None
    # Whoever only asks for --help waits for no client.
    from hapticd.protocol.calls import DaemonNotRunning, RemoteError
    from hapticd.protocol.messages import Code

    if isinstance(error, RemoteError):
        return error.code
    if isinstance(error, DaemonNotRunning):
        return int(Code.DAEMON_AWAY)
    return int(Code.INVALID_PARAMS) if isinstance(error, InvalidError) else None
