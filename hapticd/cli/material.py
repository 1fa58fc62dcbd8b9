"""`hapticd material list | set`."""

from __future__ import annotations

import click

from hapticd.cli.common import (
    change_options,
    changed,
    daemon,
    json_option,
    print_json,
    print_result,
    print_yaml,
    yaml_file,
)


@click.group("material", no_args_is_help=False)
def material_command() -> None:
    """Read or change the materials."""


@material_command.command("list")
@json_option
@click.pass_context
def material_list(ctx: click.Context, as_json: bool) -> None:
    """Print all materials, as YAML that `material set` takes."""
    with daemon(ctx) as client:
        result = client.get_materials()
    if as_json:
        print_json(result)
    else:
        print_yaml({"materials": result["materials"]})


@material_command.command("set")
@click.argument("file", type=click.Path())
@change_options
@json_option
@click.pass_context
def material_set(ctx: click.Context, file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Change materials as FILE says: what it holds is merged into them by name and key, null removes."""
    with daemon(ctx) as client:
        result = client.update_materials(yaml_file(file), expect_revision, wait)
    print_result(result, as_json, changed(result))
