"""`hapticd web`: a page in the browser."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import click

from hapticd.base.errors import HapticdError
from hapticd.cli.common import configs_option, log_options
from hapticd.cli.listening import Listening, listening_options, refuse_another_daemon


@click.command("web", short_help="Show a page in the browser.")
@click.option("--demo", is_flag=True, help="Start a daemon with the simulated joystick, and end it afterwards.")
@configs_option("What the daemon of --demo runs with, instead of a scene that shows everything: as `hapticd run -c`.")
@listening_options("the page", 8765, "The port; 0 takes a free one.")
@click.option("--set-password", type=click.Path(), metavar="FILE", help="Ask for a password, write FILE, and end.")
@click.option(
    "--recordings",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder of what is recorded on the page; by default $XDG_DATA_HOME/hapticd/recordings.",
)
@click.option("--metrics", type=click.IntRange(0, 65535), metavar="PORT", help="Serve figures for Prometheus at PORT.")
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
    """Show scene, forces and an oscilloscope in a page of the browser, and let its mouse be the hand.

    Prints an address that lets in one browser, once; SIGUSR1 prints another. An ADDRESS that other machines reach takes
    --tls-cert, --tls-key and --password-file. Ends with Ctrl-C.
    """
    if importlib.util.find_spec("aiohttp") is None:
        raise HapticdError("hapticd web needs aiohttp: pip install 'hapticd[web]'")
    if set_password is not None:
        _set_password(set_password)
        return 0
    if demo:
        refuse_another_daemon(ctx)
    if configs and not demo:
        raise click.UsageError("--config is for --demo: a daemon that runs has a configuration already", ctx)
    from hapticd.protocol.places import place_of
    from hapticd.web.process import Options, run

    place = None if demo else place_of(ctx.find_root().obj)
    return run(
        Options(
            place=place,
            configs=configs,
            **listening,
            log_level=log_level,
            recordings=recordings,
            metrics=metrics,
        )
    )


def _set_password(path: str) -> None:
    from hapticd.web.passwords import write_password

    if sys.stdin.isatty():
        password = click.prompt("password", hide_input=True, confirmation_prompt="the same again", err=True)
    else:
        password = sys.stdin.readline().rstrip("\n")
    write_password(path, password)
