"""`hapticd material list | get | set | update`."""

from __future__ import annotations

from collections.abc import Mapping

import click

from hapticd.base.errors import HapticdError, known_names, quoted
from hapticd.base.yaml_text import yaml_text
from hapticd.cli import names
from hapticd.cli.common import change, change_options, daemon, json_option, note, print_json, yaml_file


@click.group("material", no_args_is_help=False)
def material_command() -> None:
    """Read or change the materials."""


_OFFLINE = click.option("--offline", is_flag=True, help="Those of the shipped library; ask no daemon.")


@material_command.command("list", short_help="Print all materials, as YAML.")
@_OFFLINE
@json_option
@click.pass_context
def material_list(ctx: click.Context, offline: bool, as_json: bool) -> None:
    """Print all materials, as YAML that `material set` takes.

    They are the daemon's; where none runs, those of the shipped library, and a line on stderr says so.
    """
    result = _materials(ctx, offline)
    if as_json:
        print_json(result)
    else:
        click.echo(yaml_text({"materials": result["materials"]}))


@material_command.command("get", short_help="Print one material, as YAML.")
@click.argument("name", shell_complete=names.materials)
@_OFFLINE
@json_option
@click.pass_context
def material_get(ctx: click.Context, name: str, offline: bool, as_json: bool) -> None:
    """Print the material NAME, as YAML that `material set` takes: the daemon's or, where none runs, the shipped one."""
    result = _materials(ctx, offline)
    materials = result["materials"]
    assert isinstance(materials, dict)
    if name not in materials:
        told = f"unknown material {quoted(name)}"
        if result["revision"] is None:
            told = f"{told} in the shipped library; one that was set is known to the daemon alone"
            told += f": hapticd material get {name} asks it" if offline else ""
        raise HapticdError(f"{told}; {known_names(name, materials)}")
    found = {name: materials[name]}
    if as_json:
        print_json({**result, "materials": found})
    else:
        click.echo(yaml_text({"materials": found}))


def _materials(ctx: click.Context, offline: bool) -> Mapping[str, object]:
    """All materials by name, and the revision; without a daemon those that ship, and null."""
    from hapticd.protocol.calls import DaemonNotRunning

    if not offline:
        try:
            with daemon(ctx) as client:
                return client.get_materials()
        except DaemonNotRunning as error:
            # Of this machine alone: whoever names another one gets an error.
            if ctx.find_root().params.get("connect") is not None:
                raise
            note(f"{error}; these are the materials of the shipped library")
    from hapticd.config.materials import shipped_materials

    return {"materials": {name: item.to_dict() for name, item in shipped_materials().items()}, "revision": None}


@material_command.command("set", short_help="Replace the materials that are named.")
@click.argument("file", type=click.Path())
@change_options
@click.pass_context
def material_set(ctx: click.Context, file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Set the materials in FILE (YAML; - is the standard input): each is replaced whole, others stay."""
    change(ctx, as_json, lambda client: client.set_materials(yaml_file(file), expect_revision, wait))


@material_command.command("update", short_help="Change single keys; null removes.")
@click.argument("file", type=click.Path())
@change_options
@click.pass_context
def material_update(ctx: click.Context, file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Change materials as FILE says: what it holds is merged into them by name and key, null removes."""
    change(ctx, as_json, lambda client: client.update_materials(yaml_file(file), expect_revision, wait))
