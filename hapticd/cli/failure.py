"""Errors of failed commands on stderr: one line, or on a terminal one line for each fault; with --json an object.

    {"error": {"message": "...", "code": -32003, "exit_code": 1, "problems": [{"where": "...", "problem": "..."}]}}

`code` is a code of the protocol: the daemon's answer, DAEMON_AWAY if no daemon runs, or INVALID_PARAMS if files or
arguments are invalid; otherwise null. Output before the error stays on stdout. Ctrl-C is not reported.
"""

from __future__ import annotations

import json
import sys

import click

from hapticd.base.errors import HapticdError, InvalidError, collapse_whitespace, lines_of


def report_error(error: Exception, as_json: bool) -> int:
    """Print the error of a command to stderr and return the exit code. An unexpected error, a bug, is raised again."""
    message = _message(error, as_json)
    exit_code = error.exit_code if isinstance(error, click.ClickException) else 1
    problems = getattr(error, "problems", ())
    if as_json:
        listed = [{"where": each.where, "problem": each.problem} for each in problems]
        report = {"message": message, "code": _code(error), "exit_code": exit_code, "problems": listed}
        print(json.dumps({"error": report}, ensure_ascii=False), file=sys.stderr)
        return exit_code
    on_terminal = sys.stderr is not None and sys.stderr.isatty()
    for line in lines_of(problems) if len(problems) > 1 and on_terminal else [message]:
        print("hapticd:", collapse_whitespace(line), file=sys.stderr)
    return exit_code


def _message(error: Exception, as_json: bool) -> str:
    match error:
        case HapticdError():
            text = str(error)
        case click.ClickException():
            text = error.format_message()
            if isinstance(error, click.UsageError) and error.ctx is not None and not as_json:
                text += f" (see {error.ctx.command_path} --help)"
        case MemoryError():
            text = "out of memory; a shorter run or a lower rate needs less"
        case OSError():
            text = f"{error.filename}: " if error.filename else ""
            text += str(error.strerror or error)
        case _:
            from hapticd.base import threads

            if str(error) != threads.THREAD_START_ERROR:
                raise error
            text = threads.refusal_text()
    return collapse_whitespace(text)


def _code(error: Exception) -> int | None:
    if not isinstance(error, HapticdError):
        return None
    # Imported here, since --help needs no client.
    from hapticd.protocol.calls import DaemonNotRunning, RemoteError
    from hapticd.protocol.messages import Code

    if isinstance(error, RemoteError):
        return error.code
    if isinstance(error, DaemonNotRunning):
        return int(Code.DAEMON_AWAY)
    return int(Code.INVALID_PARAMS) if isinstance(error, InvalidError) else None
