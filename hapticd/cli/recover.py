"""`hapticd recover`: files of what killed recordings left."""

from __future__ import annotations

import os

import click

from hapticd.base.errors import HapticdError
from hapticd.cli.common import json_option, note, print_json


@click.command("recover", short_help="Make a file from the parts of a killed recording.")
@click.argument("file", type=click.Path(dir_okay=False))
@json_option
def recover_command(file: str, as_json: bool) -> int:
    """Make NAME.recovered.npz of each recording into FILE that was killed, or whose file could
    not be written to its end.

    What cannot be read and what is still being recorded stays as it is, and is reported. Ends with 1 if no file was
    made.
    """
    from hapticd.recording.recovery import recover

    found = recover(file)
    for problem in found.problems:
        note(problem)
    if not found.files and not found.problems:
        raise HapticdError(f"{file}: no recording into it left anything")
    if as_json:
        print_json({"files": [os.fspath(path) for path in found.files], "told": found.problems})
    else:
        for path in found.files:
            click.echo(os.fspath(path))
    return 0 if found.files else 1
