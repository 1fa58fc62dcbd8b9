"""`hapticd key new`: keys for the bridge and its clients."""

from __future__ import annotations

import json
from pathlib import Path

import click

from hapticd.cli.common import json_option, print_json


@click.group("key", no_args_is_help=False)
def key_command() -> None:
    """Make keys for the bridge and its clients."""


@key_command.command("new", short_help="Make a pair of keys.")
@click.argument("name")
@click.option("--watch", is_flag=True, help="For a client that may only watch.")
@click.option("--command", is_flag=True, help="For a client that may command, too.")
@click.option(
    "--dir",
    "directory",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Where it goes [default: /etc/hapticd/keys of root, else ~/.config/hapticd/keys].",
)
@json_option
def key_new(name: str, watch: bool, command: bool, directory: Path | None, as_json: bool) -> None:
    """Make a pair of keys: NAME.key, the public one, and NAME.key_secret, for nobody else.

    Without --watch or --command it is the bridge's own. With one of them the line that lets the client in is printed,
    to be put below `clients:` in the bridge's file.
    """
    from hapticd.protocol import keys

    if watch and command:
        raise click.UsageError("--watch and --command are two rights: give one")
    may = "watch" if watch else "command" if command else None
    certificate = keys.new_certificate()
    public, secret = keys.write_certificate(certificate, name, directory or keys.default_directory())
    if as_json:
        about = {"name": name, "may": may, "public_key": certificate.public_key}
        print_json({**about, "public": str(public), "secret": str(secret)})
        return
    click.echo(f"{secret}: the secret key; it stays with whoever it stands for", err=True)
    if may is None:
        click.echo(f"{public}: the bridge's public key; every client needs it, as --server-key", err=True)
        click.echo(certificate.public_key)
    else:
        click.echo(f"{public}: the public key, for whoever runs the bridge; the line for its file:", err=True)
        click.echo(f"  {name}: {{public_key: {json.dumps(certificate.public_key)}, may: {may}}}")
