"""`hapticd install-service` and `hapticd stop-device`."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import click

from hapticd.base.errors import HapticdError
from hapticd.cli.common import json_option, print_json


@click.command("install-service", short_help="Put the service of systemd in place.")
@click.option("--user", is_flag=True, help="For yourself alone, without rights of the system's.")
@click.option("--dry-run", is_flag=True, help="Say what would be done.")
@click.option("--uninstall", is_flag=True, help="Take it away again, but for what somebody changed.")
@click.option(
    "--root",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Into another root, as for a package, made if it is missing; the running system is not touched.",
)
@json_option
def install_service_command(user: bool, dry_run: bool, uninstall: bool, root: Path | None, as_json: bool) -> int:
    """Put units, users, folders and udev rules in place, and say what was done."""
    from hapticd.system.service_files import Installation, Service

    if user and root is not None:
        raise click.UsageError("--root is for the system's service, not for --user")
    service = Service(Installation.this(), user=user, root=root, dry_run=dry_run)
    failed = []
    steps = []
    for step in service.uninstall() if uninstall else service.install():
        steps.append(step.to_dict())
        if step.kind == "failed":
            failed.append(step)
        if not as_json:
            click.echo(step.would() if dry_run else str(step))
    if as_json:
        print_json(steps)
    if failed:
        raise HapticdError("; ".join(f"{step.what}: {step.detail}" for step in failed))
    return 0


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
