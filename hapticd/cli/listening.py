"""Options of commands that serve pages: address, port, TLS, password, browser, `--demo`."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypedDict, TypeVar, cast

import click
from click.core import ParameterSource

_F = TypeVar("_F", bound=Callable[..., Any])


class Listening(TypedDict):
    """The values of the options of `listening_options`, by the names of their parameters."""

    open_browser: bool
    host: str
    port: int
    tls_cert: str | None
    tls_key: str | None
    password_file: str | None


def listening_options(what: str, port: int, port_help: str, last_port: int = 65535) -> Callable[[_F], _F]:
    """Return the options of a command that serves pages, as the parameter `listening`.

    `what` names the pages in the help of --open; `last_port` is the largest port allowed.
    """

    def decorate(command: _F) -> _F:
        @click.option("--open", "open_browser", is_flag=True, help=f"Open {what} in the browser.")
        @click.option("--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Address to listen on.")
        @click.option("--port", type=click.IntRange(0, last_port), default=port, show_default=True, help=port_help)
        @click.option("--tls-cert", type=click.Path(), metavar="FILE", help="TLS certificate with its chain.")
        @click.option("--tls-key", type=click.Path(), metavar="FILE", help="Key of the TLS certificate.")
        @click.option("--password-file", type=click.Path(), metavar="FILE", help="Accept the password in FILE as well.")
        @functools.wraps(command)
        def with_listening(*args: Any, **options: Any) -> Any:
            listening = {name: options.pop(name) for name in Listening.__annotations__}
            return command(*args, listening=listening, **options)

        return cast(_F, with_listening)

    return decorate


demo_option = click.option(
    "--demo", is_flag=True, help="Start a separate daemon with the simulated joystick for this command."
)


def refuse_another_daemon(ctx: click.Context) -> None:
    """Raise UsageError if --demo is combined with --runtime-dir, which names another daemon."""
    if ctx.find_root().get_parameter_source("runtime_dir") == ParameterSource.COMMANDLINE:
        raise click.UsageError("--demo cannot be combined with --runtime-dir: --demo starts a separate daemon", ctx)
