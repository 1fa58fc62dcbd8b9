"""`hapticd bridge`: TCP with CURVE in front of a daemon."""

from __future__ import annotations

import click

from hapticd.cli.common import log_options

_DEFAULT = "/etc/hapticd/bridge.yaml"


@click.command("bridge", short_help="Let clients in over TCP, by their keys.")
@click.option(
    "-c",
    "--config",
    type=click.Path(),
    default=_DEFAULT,
    show_default=True,
    metavar="FILE",
    help="Clients, key and limits.",
)
@click.option("--listen", metavar="tcp://HOST:PORT", help="Where commands are taken, instead of the file's.")
@click.option("--metrics", metavar="HOST:PORT", help="Where Prometheus asks, instead of the file's.")
@log_options
@click.pass_context
def bridge_command(ctx: click.Context, config: str, listen: str | None, metrics: str | None, log_level: str) -> int:
    """Let clients in over TCP, encrypted, by their keys, to the daemon of this machine.

    SIGHUP reads the file again, and ends the connections of keys that were revoked.
    """
    from hapticd.bridge.process import run

    return run(config, ctx.find_root().obj, listen, metrics, log_level)
