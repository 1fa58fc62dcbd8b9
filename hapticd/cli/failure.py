"""What a command that fails says: one line on stderr, on a terminal one a fault, or with --json one JSON object there.

    {"error": {"message": "...", "code": -32003, "exit_code": 1, "problems": [{"where": "...", "problem": "..."}]}}

`code` is that of the protocol: the daemon's own, that for a daemon which is not there, or that for faults of what was
given, whoever found them; null for everything else. stdout stays empty, or holds what came before. Ctrl-C says nothing.
"""

from __future__ import annotations

import json
import sys

import click

from hapticd.base.errors import HapticdError, InvalidError, lines_of, on_one_line


def tell(error: Exception, as_json: bool) -> int:
    """Says on stderr what went wrong; returns the exit code. Raises the error again where it is none of a user's."""
    message = _message(error, as_json)
    exit_code = error.exit_code if isinstance(error, click.ClickException) else 1
    problems = getattr(error, "problems", ())
    if as_json:
        listed = [{"where": each.where, "problem": each.problem} for each in problems]
        told = {"message": message, "code": _code(error), "exit_code": exit_code, "problems": listed}
        print(json.dumps({"error": told}, ensure_ascii=False), file=sys.stderr)
        return exit_code
    on_terminal = sys.stderr is not None and sys.stderr.isatty()
    for line in lines_of(problems) if len(problems) > 1 and on_terminal else [message]:
        print("hapticd:", on_one_line(line), file=sys.stderr)
    return exit_code


def _message(error: Exception, as_json: bool) -> str:
    match error:
        case HapticdError():
            said = str(error)
        case click.ClickException():
            said = error.format_message()
            if isinstance(error, click.UsageError) and error.ctx is not None and not as_json:
                said += f" (see {error.ctx.command_path} --help)"
        case MemoryError():
            said = "there is not enough memory for this; a shorter run or a lower rate needs less"
        case OSError():
            said = f"{error.filename}: " if error.filename else ""
            said += str(error.strerror or error)
        case _:
            from hapticd.base import threads

            if str(error) != threads.THREAD_START_ERROR:
                raise error
            said = threads.refused()
    return on_one_line(said)


def _code(error: Exception) -> int | None:
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
