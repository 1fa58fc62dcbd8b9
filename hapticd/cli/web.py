"""`hapticd web`: a page in the browser."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import click

from hapticd.base.errors import HapticdError
from hapticd.cli.common import configs_option, log_options
from hapticd.cli.listening import Listening, demo_option, listening_options, refuse_another_daemon
from hapticd.system.extras import install_command


@click.command("web", short_help="Serve a page for the browser.")
@demo_option
@configs_option(
    "Configuration of the daemon of --demo, as `hapticd run -c`  [default: a scene with every kind of surface]"
)
@listening_options("the page", 8765, "Port to listen on; 0 chooses a free one.")
@click.option(
    "--set-password", type=click.Path(), metavar="FILE", help="Ask for a password, write its hash to FILE and exit."
)
@click.option(
    "--recordings",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder of recordings made on the page [default: $XDG_DATA_HOME/hapticd/recordings].",
)
@click.option("--metrics", type=click.IntRange(0, 65535), metavar="PORT", help="Port for Prometheus metrics.")
@log_options
@click.pass_context
def web_command(
    ctx: click.Context,
    demo: bool,
    configs: tuple[str, ...],
    listening: Listening,
    set_password: str | None,
    recordings: Path | None,
    metrics: int | None,
    log_level: str,
) -> int:
    """Serve a page for the browser with scene, forces and an oscilloscope, in which the mouse can be the hand.

    The command prints an address that admits one browser, once; SIGUSR1 prints another. An ADDRESS that other machines
    can reach requires --tls-cert, --tls-key and --password-file. Ctrl-C ends the command.
    """
    if importlib.util.find_spec("aiohttp") is None:
        raise HapticdError(f"hapticd web needs aiohttp: {install_command('web')}")
    if set_password is not None:
        _set_password(set_password)
        return 0
    if demo:
        refuse_another_daemon(ctx)
    if configs and not demo:
        raise click.UsageError("--config needs --demo: a running daemon already has a configuration", ctx)
    from hapticd.protocol.places import place_of
    from hapticd.web.process import Options, run

    place = None if demo else place_of(ctx.find_root().obj)
    return run(
        Options(place=place, configs=configs, **listening, log_level=log_level, recordings=recordings, metrics=metrics)
    )


def _set_password(path: str) -> None:
    from hapticd.web.passwords import write_password

    if sys.stdin.isatty():
        password = click.prompt("password", hide_input=True, confirmation_prompt="repeat the password", err=True)
    else:
        password = sys.stdin.readline().rstrip("\n")
    write_password(path, password)
