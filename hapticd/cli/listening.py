"""Options of what serves pages: where it listens, and whether the browser is opened; and a daemon of its own."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypedDict, TypeVar, cast

import click
from click.core import ParameterSource

_F = TypeVar("_F", bound=Callable[..., Any])


class Listening(TypedDict):
    """The options, by the names of their parameters."""

    open_browser: bool
    host: str
    port: int
    tls_cert: str | None
    tls_key: str | None
    password_file: str | None


def listening_options(what: str, port: int, port_help: str, last_port: int = 65535) -> Callable[[_F], _F]:
    """The options as the parameter `listening`; `what` is opened, `last_port` the largest that may be given."""

    def decorate(command: _F) -> _F:
        @click.option("--open", "open_browser", is_flag=True, help=f"Open {what} in the browser.")
        @click.option("--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Where to listen.")
        @click.option("--port", type=click.IntRange(0, last_port), default=port, show_default=True, help=port_help)
        @click.option("--tls-cert", type=click.Path(), metavar="FILE", help="The certificate with its chain.")
        @click.option("--tls-key", type=click.Path(), metavar="FILE", help="The certificate's key.")
        @click.option("--password-file", type=click.Path(), metavar="FILE", help="Let in who knows the password, too.")
        @functools.wraps(command)
        def with_listening(*args: Any, **options: Any) -> Any:
            listening = {name: options.pop(name) for name in Listening.__annotations__}
            return command(*args, listening=listening, **options)

        return cast(_F, with_listening)

    return decorate


def refuse_another_daemon(ctx: click.Context) -> None:
    """For --demo. Raises UsageError where the command line says which daemon to take."""
    if ctx.find_root().get_parameter_source("runtime_dir") == ParameterSource.COMMANDLINE:
        raise click.UsageError("--demo starts a daemon of its own: leave --runtime-dir out", ctx)
