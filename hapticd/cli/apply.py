"""`hapticd apply`: materials and scene as one change."""

from __future__ import annotations

import click

from hapticd.cli import names
from hapticd.cli.common import change, change_options, yaml_file


@click.command("apply", short_help="Change materials and scene together.")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", shell_complete=names.scenes)
@change_options
@click.pass_context
def apply_command(
    ctx: click.Context, files: tuple[str, ...], expect_revision: int | None, wait: bool, as_json: bool
) -> None:
    """Set the materials, the scene or both that FILEs hold: one change at one tick, all or nothing.

    A FILE holds `materials`, `scene` or both, or a scene alone, or is the name of a shipped scene; - is the standard
    input. Later files override earlier ones. Each material that is named is replaced whole, others stay; the scene is
    replaced.
    """
    from hapticd.config.change_files import load_change

    given = load_change([yaml_file(file) for file in files])
    change(
        ctx,
        as_json,
        lambda client: client.apply(
            materials=given.materials, scene=given.scene, expect_revision=expect_revision, wait=wait
        ),
    )
