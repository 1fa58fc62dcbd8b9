"""`hapticd experiment run` and `resume`: a session with a participant."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError, quoted
from hapticd.cli.common import note
from hapticd.cli.engine import Where, engine_options
from hapticd.cli.experiment_pages import live_stage, pages_options, place_of_session, rig_at, run_on_pages
from hapticd.cli.listening import Listening, demo_option

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json
    from hapticd.config.configuration import Config
    from hapticd.experiment.front import Front
    from hapticd.experiment.keys import Study
    from hapticd.experiment.pages.pages_front import PagesFront
    from hapticd.experiment.plan import Plan
    from hapticd.experiment.session_folder import SessionFolder
    from hapticd.experiment.session_log import SessionLog
    from hapticd.experiment.stage import Stage

_SIMULATED_PREFIX = "simulated:"
"""Prefix of the value of --participant for a simulated participant."""
_SessionOpener: TypeAlias = "Callable[[Stage], tuple[SessionFolder, SessionLog]]"
"""A function that creates or opens the folder and the log of a session. Its argument renders the trials."""

_TEXT_WITH_DEMO_ERROR = "--text cannot be combined with --demo: only a page moves the hand of the simulated joystick"

_lsl_option = click.option(
    "--lsl", is_flag=True, help="Stream samples and event codes to Lab Streaming Layer, as `hapticd lsl` does."
)


@click.command("run", short_help="Run a session with a participant.")
@click.argument("study", metavar="STUDY")
@click.option(
    "--participant",
    "participants",
    required=True,
    multiple=True,
    metavar="LABEL",
    help="Letters and digits, or simulated:NAME for a simulated participant. May be repeated with --offline.",
)
@click.option(
    "--count",
    type=click.IntRange(1, 999_999),
    help="Number of simulated participants that --offline computes in parallel: NAME000001, NAME000002, ...",
)
@engine_options("participants")
@click.option("--session", type=click.IntRange(1, 99), default=1, show_default=True, help="Number of the session.")
@click.option(
    "--seed", type=click.IntRange(0, 2**32 - 1), help="Random seed of the order of trials [default: that of the study]."
)
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("."),
    metavar="DIR",
    help="Folder of the data set, for sub-LABEL/ses-NN [default: the current one].",
)
@click.option("--text", is_flag=True, help="Run at this terminal, without pages.")
@click.option("--offline", is_flag=True, help="Simulate the participant without a daemon, faster than real time.")
@_lsl_option
@click.option("--telemetry/--no-telemetry", default=None, help="Whether --offline writes a .npz of each trial.")
@demo_option
@pages_options
@click.pass_context
def run_command(
    ctx: click.Context,
    /,
    study: str,
    participants: tuple[str, ...],
    count: int | None,
    session: int,
    seed: int | None,
    output: Path,
    text: bool,
    offline: bool,
    lsl: bool,
    telemetry: bool | None,
    demo: bool,
    listening: Listening,
    **where: Any,
) -> int:
    """Run a session of STUDY with a participant, trial by trial.

    STUDY is a YAML file or the name of a shipped study. The command prints the addresses of two pages: one for the
    participant, one for the experimenter, who switches the forces on. SIGUSR1 prints new addresses. Each answer is on
    disk before the next trial begins. `hapticd experiment resume` continues a session that was interrupted.

    With --count, --workers, --threads or --scheduler, simulated participants are computed in parallel. If that is
    interrupted, the same command continues it.
    """
    from hapticd.config.configuration import load_config
    from hapticd.config.shipped_files import file_of
    from hapticd.experiment.bids import check_one_study, other_version
    from hapticd.experiment.plan import plan as make_plan
    from hapticd.experiment.session import begin
    from hapticd.experiment.session_folder import check_new, numbered
    from hapticd.experiment.study import load_study

    labels = [_participant(each) for each in participants]
    everyone_simulated = all(simulated for _, simulated in labels)
    if offline and not everyone_simulated:
        raise click.UsageError("--offline needs a simulated participant: --participant simulated:NAME", ctx)
    if text and demo and not everyone_simulated:
        raise click.UsageError(_TEXT_WITH_DEMO_ERROR, ctx)
    if len(labels) > 1 and not offline:
        raise click.UsageError("several participants need --offline; on a daemon, run one session after the other", ctx)
    if offline and demo:
        raise click.UsageError("--offline cannot be combined with --demo: --offline uses no daemon", ctx)
    if telemetry is not None and not offline:
        raise click.UsageError(
            "--telemetry and --no-telemetry need --offline; on a daemon telemetry is always kept", ctx
        )
    if lsl and offline:
        raise click.UsageError("--lsl cannot be combined with --offline: --lsl needs a daemon, in real time", ctx)
    engine = Where(**where)
    in_parallel = count is not None or engine != Where(None, False, None, False)
    if in_parallel and not offline:
        raise click.UsageError(
            "--count, --workers, --threads, --scheduler and --again need --offline and simulated participants", ctx
        )
    if in_parallel and telemetry:
        raise click.UsageError(
            "--telemetry cannot be combined with --count, --workers, --threads, --scheduler or --again", ctx
        )
    if count is not None and len(labels) > 1:
        raise click.UsageError("--count needs a single --participant simulated:NAME", ctx)
    found = load_study(study)
    source = Path(file_of(study, "experiments")).read_bytes()
    check_one_study(output, found.title)  # before a daemon or a page is started
    if (other := other_version(output, source)) is not None:
        note(f"{study}: changed since the session in {other}; `analyze` will combine both")
    if offline:
        _note_undisplayable(found, load_config({}), named=True)
    if in_parallel:
        from hapticd.cli.experiment_bulk import run_bulk

        people = tuple(dict.fromkeys(label for label, _ in labels)) if count is None else numbered(labels[0][0], count)
        return run_bulk(found, source, people, session, found.order.seed if seed is None else seed, output, engine)

    def run_one(label: str, simulated: bool) -> int:
        plan = make_plan(found, label, session, found.order.seed if seed is None else seed)
        check_new(output, label, session)  # before a daemon or a page is started
        return _with_stage(
            ctx,
            plan,
            lambda stage: begin(output, source, plan, _about(stage, simulated, offline, telemetry)),
            pages=None if text or simulated else listening,
            demo=demo,
            offline=offline,
            lsl=lsl,
            telemetry=bool(telemetry),
        )

    return max(run_one(*each) for each in labels)


@click.command("resume", short_help="Resume an interrupted session.")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--text", is_flag=True, help="Run at this terminal, without pages.")
@_lsl_option
@demo_option
@pages_options
@click.pass_context
def resume_command(ctx: click.Context, folder: Path, text: bool, lsl: bool, demo: bool, listening: Listening) -> int:
    """Resume the session in FOLDER (sub-LABEL/ses-NN), in the same order, after the last answer."""
    from hapticd.experiment.progress import check_not_over, progress_of
    from hapticd.experiment.session import plan_of
    from hapticd.experiment.session_folder import SessionFolder

    opened = SessionFolder.open(folder)
    check_not_over(folder, progress_of(opened.contents().records))  # before a daemon or a page is started
    stage_was = opened.about["stage"]
    assert isinstance(stage_was, dict)
    simulated, offline = bool(stage_was.get("simulated")), stage_was.get("kind") == "offline"
    if text and demo and not simulated:
        raise click.UsageError(_TEXT_WITH_DEMO_ERROR, ctx)
    if lsl and offline:
        raise click.UsageError(
            "--lsl cannot be used: this session is offline, and --lsl needs a daemon, in real time", ctx
        )
    return _with_stage(
        ctx,
        plan_of(opened),
        lambda stage: (opened, opened.log()),
        pages=None if text or simulated else listening,
        demo=demo,
        offline=offline,
        lsl=lsl,
        telemetry=bool(stage_was.get("telemetry")),
    )


def _participant(given: str) -> tuple[str, bool]:
    """Return the label in the value of --participant, and whether the participant is simulated."""
    from hapticd.experiment.session_folder import participant_label

    simulated = given.startswith(_SIMULATED_PREFIX)
    name = given.removeprefix(_SIMULATED_PREFIX)
    if simulated and not name.isalnum():
        raise HapticdError(f"--participant {quoted(given)}: must be simulated:NAME, with letters and digits in NAME")
    return participant_label(f"sim{name}" if simulated else name), simulated


def _about(stage: Stage, simulated: bool, offline: bool, telemetry: bool | None) -> dict[str, Json]:
    return {**stage.describe(), "simulated": simulated, "telemetry": bool(telemetry) or not offline}


def _with_stage(
    ctx: click.Context,
    plan: Plan,
    open_session: _SessionOpener,
    *,
    pages: Listening | None,
    demo: bool,
    offline: bool,
    lsl: bool,
    telemetry: bool,
) -> int:
    """Run the session that `open_session` opens: offline, at the terminal, or with pages. Return the exit code."""
    from hapticd.experiment.offline_stage import OfflineStage

    if offline:
        stage = OfflineStage(telemetry)
        folder, log = open_session(stage)
        return _run(stage, folder, log, plan, _front(folder, plan), demo, keep=telemetry, clock=stage.now_s)
    with place_of_session(ctx, demo) as place:
        rig = rig_at(place)
        _note_undisplayable(plan.study, rig, named=pages is not None)
        if pages is not None:
            return run_on_pages(
                place,
                rig.device.kind == "sim",
                pages,
                plan,
                lsl,
                lambda stage, front: _run_shown(stage, front, open_session, plan, demo),
            )
        with live_stage(place, lsl) as live:
            folder, log = open_session(live)
            return _run(live, folder, log, plan, _front(folder, plan), demo)


def _note_undisplayable(study: Study, rig: Config, named: bool) -> None:
    """Print a note if the device does not display all stimuli as written. The session begins nevertheless.

    With `named` the note lists the stimuli. A participant at this terminal must not read this list.
    """
    from hapticd.experiment.cells import cells_of
    from hapticd.experiment.check import display_problems

    _, problems = display_problems(study, cells_of(study), rig)
    for problem in problems if named else ():
        note(f"on this device: {problem}")
    if problems and not named:
        things = wording.count(len(problems), "thing")
        note(f"{things} of the study cannot be displayed as written; `hapticd experiment check` lists them")


def _run_shown(stage: Stage, front: PagesFront, open_session: _SessionOpener, plan: Plan, demo: bool) -> int:
    """Run a session with pages, show on the pages that the session has ended, and return its exit code."""
    thanks = "# Thank you\n\nThis was all. You can take your hand off the handle."
    stopped = "# The session has stopped\n\nThe forces are off. You can take your hand off the handle."
    try:
        folder, log = open_session(stage)
        front.opened(log.records)
        code = _run(stage, folder, log, plan, front, demo)
    except HapticdError as error:
        # The forces may still be on, as the daemon may not answer.
        front.over(
            str(error), "# The session has stopped\n\nLet go of the handle, and wait for the experimenter.", False
        )
        raise
    ended = code == 0
    summary = "complete" if ended else f"stopped; {_how_to_resume(folder, demo)}"
    front.over(summary, thanks if ended else stopped, ended)
    return code


def _run(
    stage: Stage,
    folder: SessionFolder,
    log: SessionLog,
    plan: Plan,
    front: Front,
    demo: bool,
    keep: bool = True,
    clock: Callable[[], float] | None = None,
) -> int:
    import time

    from hapticd.experiment.bids import write_tables
    from hapticd.experiment.runner import Session
    from hapticd.experiment.session import procedure_of
    from hapticd.experiment.stimuli import at_level

    if log.dropped is not None:
        note(log.dropped)
    session = Session(
        folder,
        log,
        plan,
        stage,
        front,
        procedures=partial(procedure_of, plan.study),
        at_level=partial(at_level, plan.study),
        keep_telemetry=keep,
        monotonic_s=clock or time.monotonic,
    )
    try:
        ending = session.run()
    finally:
        # Also after an interruption: the tables then have everything that is in the log.
        write_tables(folder)
    unneeded = len(session.done) - session.answered
    at_most = "at most " if plan.study.may_end_early else ""
    besides = f" ({unneeded} not needed)" if unneeded else ""
    done = f"{folder.path}: {session.answered} of {at_most}{session.total} trials"
    if ending == "ended":
        click.echo(f"{done}, complete{besides}")
        return 0
    click.echo(f"{done}{besides}; {_how_to_resume(folder, demo)}")
    return 1


def _how_to_resume(folder: SessionFolder, demo: bool) -> str:
    return f"continue with `hapticd experiment resume {folder.path}{' --demo' if demo else ''}`"


def _front(folder: SessionFolder, plan: Plan) -> Front:
    """Return the session's simulated participant, or for a real participant the dialog in the terminal."""
    from hapticd.experiment.participants.simulated import SimulatedFront, task_of
    from hapticd.experiment.text_front import TextFront

    stage = folder.about["stage"]
    if isinstance(stage, dict) and stage.get("simulated"):
        return SimulatedFront(plan.seed, f"{plan.participant}/{plan.session}", task_of(plan))
    return TextFront()
