"""`hapticd experiment list | check | run | resume | analyze`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hapticd.base import wording
from hapticd.cli import names
from hapticd.cli.common import config_option, json_option, note, print_json, print_shipped
from hapticd.cli.experiment_analyze import analyze_command
from hapticd.cli.experiment_run import resume_command, run_command

if TYPE_CHECKING:
    from hapticd.experiment.check import StudyReport


@click.group("experiment", no_args_is_help=False, short_help="Run and analyze experiments with people.")
def experiment_command() -> None:
    """Run and analyze experiments with people.

    An experiment is a study in YAML. Some studies ship with hapticd.
    """


@click.command("list", short_help="List the studies that ship with hapticd.")
@json_option
def list_command(as_json: bool) -> None:
    """List the studies that ship with hapticd.

    Wherever a command takes a study, it also takes one of these names.
    """
    print_shipped("experiments", as_json)


@click.command("check", short_help="Check the stimuli, duration and power of a study.")
@click.argument("study", shell_complete=names.experiments)
@config_option
@json_option
def check_command(study: str, configs: tuple[str, ...], as_json: bool) -> int:
    """Check whether the device can display the stimuli of STUDY; print its duration and its statistical power.

    STUDY is a YAML file or the name of a shipped study; the device is that of the configuration. Nothing moves. The
    exit code is 0 if every stimulus can be displayed as written, otherwise 1.
    """
    from hapticd.config.configuration import config_of
    from hapticd.experiment.check import check_study
    from hapticd.experiment.study import load_study

    report = check_study(load_study(study), config_of(configs))
    if as_json:
        print_json(report.to_dict())
    else:
        _print(report)
    if report.faults == 0:
        return 0
    note(f"{wording.count(report.faults, 'thing')} of the study cannot be displayed as written")
    return 1


def _print(report: StudyReport) -> None:
    click.echo(report.title)
    at_most = "at most " if report.at_most else ""
    before = {"practice trial": report.practice_trials, "training trial": report.training_trials}
    shown = [wording.count(count, thing) for thing, count in before.items() if count]
    test = f"{at_most}{wording.count(report.test_trials, 'trial')}"
    click.echo(f"trials: {wording.listed([*shown, test])}; {wording.count(report.breaks, 'break')}")
    click.echo(
        f"time: {at_most}{wording.duration(60 * report.minutes)}, at {wording.duration(report.expected_s)} a trial "
        "(trial.expected_s)"
    )
    click.echo("cells:")
    several = len({cell.condition for cell in report.cells}) > 1
    counts: dict[tuple[str, int], list[str]] = {}
    for cell in report.cells:
        counts.setdefault((cell.condition if several else "", cell.trials), []).append(cell.cell)
    for (condition, trials), cells in counts.items():
        begin = f"{condition}: " if condition else ""
        of_each = f"{wording.count(len(cells), 'cell')} of {at_most}{wording.count(trials, 'trial')}"
        click.echo(f"  {begin}{of_each}: {'; '.join(cells)}")
    click.echo(f"correct: {report.correct or 'not defined; the analysis has no percentage correct'}")
    if report.correct is not None:
        no_test = "not set (analysis.chance); the analysis does not test against it"
        chance = no_test if report.chance is None else wording.percent(report.chance)
        click.echo(f"chance: {chance}")
    if report.power is not None:
        power = report.power
        click.echo(
            f"power: {wording.percent(power.power)} to detect the stated effect with "
            f"{wording.count(power.participants, 'participant')} (simulated, standard error "
            f"{wording.percent(power.standard_error, 2)}; {power.test})"
        )
    click.echo(f"device: {report.device}")
    for problem in (*report.to_look_at, *report.undisplayable):
        click.echo(str(problem))
    if report.faults == 0:
        click.echo("every stimulus can be displayed as written")


# Subcommands in the order in which --help lists them.
for _command in (list_command, check_command, run_command, resume_command, analyze_command):
    experiment_command.add_command(_command)
