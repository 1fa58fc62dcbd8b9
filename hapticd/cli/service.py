"""`hapticd install-service` and `hapticd stop-device`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from hapticd.cli.common import json_option, note, print_json

if TYPE_CHECKING:
    from hapticd.system.service_files import Action


@click.command("install-service", short_help="Put the service of systemd in place.")
@click.option("--user", is_flag=True, help="For yourself alone, without rights of the system's.")
@click.option("--dry-run", is_flag=True, help="Print the commands, and run none.")
@click.option("--uninstall", is_flag=True, help="Remove it again; users and configuration stay.")
@click.option(
    "--root",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Write below DIR, as for a package; the running system is not touched.",
)
def install_service_command(user: bool, dry_run: bool, uninstall: bool, root: Path | None) -> None:
    """Install units, users, folders and udev rules, and print each command."""
    from hapticd.system.service_files import Installation, run

    if user and root is not None:
        raise click.UsageError("--root is for the system's service, not for --user")
    installation = Installation.this()
    if uninstall:
        action: Action = "remove-user" if user else "remove-system"
    else:
        action = "user" if user else "system"
    for line in run(action, installation, root, dry_run):
        click.echo(line)
    if uninstall:
        note("configuration, users and /var/lib/hapticd are left as they are")
        return
    if root is None:
        note(f"start it: systemctl {'--user ' if user else ''}enable --now hapticd")


@click.command("stop-device", short_help="Stop a device that a daemon left.")
@json_option
@click.pass_context
def stop_device_command(ctx: click.Context, as_json: bool) -> None:
    """Tell the device of a daemon that was killed that its force is zero, and stop its effects.

    systemd runs it whatever ended the daemon. It needs nothing but what the daemon wrote into its runtime directory.
    """
    from hapticd.hid.stopper import stop_device
    from hapticd.system.paths import runtime_paths

    done = stop_device(runtime_paths(cast("str | None", ctx.find_root().obj)).device)
    if as_json:
        print_json({"stopped": done})
    else:
        click.echo(done or "no device was left: nothing to stop")
