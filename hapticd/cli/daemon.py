"""`hapticd run`, `hapticd reload` and `hapticd status`."""

from __future__ import annotations

import gc

import click

from hapticd.cli.common import change, change_options, config_option, daemon, json_option, log_options, print_json
from hapticd.daemon.status_text import lines, text_of

RELOAD_S = 60.0
"""So long is a reload waited for: the daemon itself gives up files that do not come after 10 s."""


@click.command("run")
@config_option
@log_options
@click.pass_context
def run_command(ctx: click.Context, configs: tuple[str, ...], log_level: str) -> int:
    """Run the daemon in the foreground."""
    # What is loaded now stays: looking for garbage among it would only take time. The daemon turns it on again.
    gc.disable()
    from hapticd.daemon.process import run

    return run(configs, ctx.find_root().obj, log_level)


@click.command("reload", short_help="Read the configuration files again.")
@change_options
@click.pass_context
def reload_command(ctx: click.Context, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Have the daemon read its configuration files again, and take scene and materials from them: all or nothing.

    What was touched or punctured stays so. Anything else that changed needs a restart, and refuses the whole.
    """
    change(ctx, as_json, lambda client: client.reload(expect_revision, wait), RELOAD_S)


@click.command("status")
@json_option
@click.pass_context
def status_command(ctx: click.Context, as_json: bool) -> None:
    """Show the state of the daemon."""
    with daemon(ctx) as client:
        status = client.get_status(detail=True)
    if as_json:
        print_json(status)
        return
    click.echo(text_of(list(lines(status))))
