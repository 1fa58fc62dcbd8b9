"""`hapticd export`: a recording in the form of other programs."""

from __future__ import annotations

import click

from hapticd.cli.common import overwrite_option


@click.command("export", short_help="Write a recording in another form.")
@click.argument("file", type=click.Path(dir_okay=False))
@click.argument("target", type=click.Path())
@overwrite_option
def export_command(file: str, target: str, overwrite: bool) -> None:
    """Write FILE (.npz of `record`, `simulate` or `flight`) to TARGET: .mcap for the tools of robotics, .csv for
    everything else.

    With .csv the events go into a second file, NAME.events.csv, and scene and materials into a third, NAME.about.json.
    """
    from hapticd.recording.recording import check_saved, load

    check_saved(target, overwrite)
    recording = load(file)
    click.echo(
        f"{recording.save(target, overwrite)}: {len(recording.samples):,} ticks, {len(recording.events):,} events"
    )
