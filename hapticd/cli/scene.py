"""`hapticd scene get | set | update`."""

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


@click.group("scene", no_args_is_help=False)
def scene_command() -> None:
    """Read or change the scene."""


@scene_command.command("get")
@json_option
@click.pass_context
def scene_get(ctx: click.Context, as_json: bool) -> None:
    """Print the scene, as YAML that `scene set` takes."""
    with daemon(ctx) as client:
        result = client.get_scene()
    if as_json:
        print_json(result)
    else:
        click.echo(f"# revision {result['revision']}")
        print_yaml({"scene": result["scene"]})


@scene_command.command("set")
@click.argument("file", type=click.Path())
@change_options
@json_option
@click.pass_context
def scene_set(ctx: click.Context, file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Replace the scene by that in FILE (YAML; - is the standard input)."""
    with daemon(ctx) as client:
        result = client.set_scene(yaml_file(file), expect_revision, wait)
    print_result(result, as_json, changed(result))


@scene_command.command("update")
@click.argument("file", type=click.Path())
@change_options
@json_option
@click.pass_context
def scene_update(ctx: click.Context, file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Change objects as FILE says: what it holds is merged into them by id and key, null removes."""
    with daemon(ctx) as client:
        result = client.update_scene(yaml_file(file), expect_revision, wait)
    print_result(result, as_json, changed(result))
