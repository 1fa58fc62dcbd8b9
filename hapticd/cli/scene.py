"""`hapticd scene list | get | set | update`."""

from __future__ import annotations

import click

from hapticd.base.yaml_text import yaml_text
from hapticd.cli import names
from hapticd.cli.common import (
    change,
    change_options,
    daemon,
    json_option,
    print_json,
    yaml_file,
)


@click.group("scene", no_args_is_help=False)
def scene_command() -> None:
    """Read or change the scene."""


@scene_command.command("list", short_help="List the scenes that ship with hapticd.")
@json_option
def scene_list(as_json: bool) -> None:
    """List the scenes that ship with hapticd: each name does where a command takes a scene."""
    from hapticd.config.shipped_files import shipped_scenes

    scenes = shipped_scenes()
    if as_json:
        print_json([scene.to_dict() for scene in scenes])
        return
    width = max(len(scene.name) for scene in scenes)
    for scene in scenes:
        made_for = f" (operator: {scene.operator})" if scene.operator else ""
        click.echo(f"{scene.name:<{width}}  {scene.shows}{made_for}")


@scene_command.command("get", short_help="Print the scene, as YAML.")
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
        click.echo(yaml_text({"scene": result["scene"]}))


@scene_command.command("set", short_help="Replace the scene.")
@click.argument("file", shell_complete=names.scenes)
@change_options
@click.pass_context
def scene_set(ctx: click.Context, file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Replace the scene by that in FILE (YAML, or the name of a shipped scene; - is the standard input)."""
    from hapticd.config.shipped_files import file_of

    source = file_of(file, "scenes")
    change(ctx, as_json, lambda client: client.set_scene(source, expect_revision, wait))


@scene_command.command("update", short_help="Change single objects; null removes.")
@click.argument("file", type=click.Path())
@change_options
@click.pass_context
def scene_update(ctx: click.Context, file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Change objects as FILE says: what it holds is merged into them by id and key, null removes."""
    change(ctx, as_json, lambda client: client.update_scene(yaml_file(file), expect_revision, wait))
