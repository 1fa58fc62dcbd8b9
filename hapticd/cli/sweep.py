"""`hapticd sweep list | run | show`: simulations at many points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hapticd.base import wording
from hapticd.cli import names
from hapticd.cli.common import json_option, note, print_json, print_shipped, results_option
from hapticd.cli.engine import Where, computed, engine_options, outcome_dict, outcome_text, require_engine
from hapticd.cli.sweep_show import show_command


@click.group("sweep", no_args_is_help=False, short_help="Simulate many configurations and show the results.")
def sweep_command() -> None:
    """Simulate many configurations, the points of a sweep, on all processors or a cluster.

    The results are rows of Parquet in a folder. Points with a row are not computed again.
    """


@click.command("run", short_help="Compute the points of a sweep.")
@click.argument("study", type=click.Path(), metavar="STUDY.yaml", shell_complete=names.sweeps)
@results_option("the name of the study without .yaml")
@engine_options("points")
@json_option
def run_command(study: str, output: Path | None, as_json: bool, **where: Any) -> int:
    """Compute the points of STUDY.yaml that the folder of results lacks.

    STUDY.yaml may be the name of a shipped sweep. Ctrl-C keeps the finished points; the same command continues. The row
    of a point that cannot be computed has the reason. The exit code is 0 if every point has a result, otherwise 1.
    """
    from hapticd.sweeps.study import load_sweep

    engine = Where(**where)
    require_engine(engine)
    plan = load_sweep(study)
    folder = Path(Path(study).stem) if output is None else output
    outcome, store = computed(plan, folder, engine, "point")
    digest = store.digest()
    if as_json:
        print_json(outcome_dict(outcome, folder, digest, "points"))
    else:
        click.echo(outcome_text(outcome, "point"))
        click.echo(f"rows: {folder}/pieces/*.parquet, sha256 {digest[:16]}; see: hapticd sweep show {folder}")
    if outcome.failed:
        note(f"{wording.count(outcome.failed, 'point')} could not be computed; the column error has the reasons")
    return 1 if outcome.failed else 0


@click.command("list", short_help="List the sweeps that ship with hapticd.")
@json_option
def list_command(as_json: bool) -> None:
    """List the sweeps that ship with hapticd. `hapticd sweep run` accepts their names."""
    print_shipped("sweeps", as_json)


for _command in (list_command, run_command, show_command):
    sweep_command.add_command(_command)
