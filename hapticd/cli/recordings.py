"""Commands that watch, record or stream a daemon, simulate without one, or process recordings."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from dataclasses import asdict

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.cli import names
from hapticd.cli.common import (
    configs_option,
    daemon,
    for_option,
    json_option,
    note,
    note_if_forces_are_off,
    notes_option,
    output_option,
    overwrite_option,
    print_result,
    rate_option,
    status_line,
    stopped_by_signals,
)

_EXPORT_HELP = "(.npz; .csv or .mcap, exported from a .npz of the same name)"


@click.command("watch", short_help="Show position, forces and events live.")
@for_option("until Ctrl-C")
@json_option
def watch_command(duration_s: float | None, as_json: bool) -> None:
    """Show position, forces, contacts and faults live.

    If stdout is a file or a pipe, print a line per second and a line for each event.
    """
    from hapticd.client.watch import watch

    def end(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, end)  # SystemExit restores the terminal
    with daemon() as client:
        watch(client, as_json, duration_s=duration_s)


@click.command("record", short_help="Record telemetry to a file.")
@click.argument("file", type=click.Path())
@for_option("until Ctrl-C, or the end of the operator")
@click.option(
    "--operator",
    metavar="FILE",
    shell_complete=names.operators,
    help="Motion of the simulated hand, as for `hapticd operator`, which begins after the first tick.",
)
@click.option("--past", is_flag=True, help="Write the last seconds, which the daemon keeps (the flight recorder).")
@click.option("--recover", is_flag=True, help="Complete killed recordings to FILE instead, as NAME.recovered.npz.")
@notes_option
@overwrite_option
@json_option
def record_command(
    file: str,
    duration_s: float | None,
    operator: str | None,
    past: bool,
    recover: bool,
    notes: dict[str, str],
    overwrite: bool,
    as_json: bool,
) -> int:
    """Record every tick and event to FILE (.npz), with the configuration, scene and materials for `hapticd replay`.

    FILE appears when the recording is complete. If its suffix is .mcap or .csv, the recording goes to the .npz of the
    same name, and FILE is exported from it at the end. With --operator the recording ends with the motion.

    A note reports an earlier recording to FILE that was killed. --recover completes it: recordings that are running and
    files that cannot be read are kept and reported, and the exit code is 1 if nothing was recovered.
    """
    if past or recover:
        if (past and recover) or duration_s is not None or operator is not None or notes:
            raise click.UsageError("--past and --recover cannot be combined, nor with --for, --operator or --note")
        if recover and overwrite:
            raise click.UsageError("--recover replaces no file, each recording gets a free name: leave out --overwrite")
        return _recover(file, as_json) if recover else _write_past(file, overwrite, as_json)
    from hapticd.client.record import ended_early, record
    from hapticd.config.shipped_files import file_of
    from hapticd.protocol.calls import TimedOut
    from hapticd.recording.recording import check_target
    from hapticd.recording.recovery import partial_files_warning

    check_target(file, overwrite)
    found = partial_files_warning(file)
    if found is not None:
        note(found)
    motion = None if operator is None else file_of(operator, "operators")
    end_s: float | None = None
    completed = True
    with daemon() as client, stopped_by_signals() as stop, status_line() as show:

        def progress(recorded_s: float) -> None:
            nonlocal end_s, completed
            show(f"recording, {recorded_s:.1f} s")
            if motion is None or recorded_s == 0:
                return
            if end_s is None:
                end_s = recorded_s + client.set_operator(motion)["duration_s"]
                note_if_forces_are_off(client)
            elif recorded_s >= end_s:
                with suppress(TimedOut):
                    completed = client.wait_gesture(0.0)["completed"]
                    stop.set()

        recording = record(client, file, duration_s, overwrite=overwrite, notes=notes, stop=stop, progress=progress)
    exported = "" if file.lower().endswith(".npz") else f"; exported to {file}"
    print_result(asdict(recording), as_json, f"{recording.summary()}{exported}")
    if not completed:
        note("another motion replaced that of --operator")
        return 1
    early = ended_early(recording.ended_because)
    if early is not None:
        note(f"{early}; {recording.file} has everything before that")
        return 1
    return stop.exit_code(duration_s)


def _recover(file: str, as_json: bool) -> int:
    from hapticd.recording.recovery import recover

    found = recover(file)
    for problem in found.problems:
        note(problem)
    files = [os.fspath(path) for path in found.files]
    if not files and not found.problems:
        raise HapticdError(f"{file}: no partial files of a recording to this file")
    if files or as_json:
        print_result({"files": files, "told": found.problems}, as_json, "\n".join(files))
    return 0 if files else 1


def _write_past(file: str, overwrite: bool, as_json: bool) -> int:
    from hapticd.client.flight_summary import copy_flight, written_flight
    from hapticd.recording.recording import check_saved

    check_saved(file, overwrite)
    with daemon() as client:
        found, line = copy_flight(written_flight(client), file, overwrite)
    print_result(found, as_json, line)
    return 0


@click.command("export", short_help="Convert a recording to .csv or .mcap.")
@click.argument("file", type=click.Path(dir_okay=False))
@click.argument("target", type=click.Path())
@overwrite_option
def export_command(file: str, target: str, overwrite: bool) -> None:
    """Convert the recording FILE to TARGET: .mcap for robotics tools, .csv for other programs.

    FILE is a .npz of `record` or `simulate`, or a flight file. With .csv the events go to a second file,
    NAME.events.csv, and scene and materials to a third, NAME.about.json.
    """
    from hapticd.recording.recording import check_saved, load

    check_saved(target, overwrite)
    recording = load(file)
    saved = recording.save(target, overwrite)
    click.echo(f"{saved}: {len(recording.samples):,} ticks, {len(recording.events):,} events")


@click.command("replay", short_help="Render a recording again and compare forces.")
@click.argument("file", type=click.Path(dir_okay=False))
@output_option(f"File for the rendered recording {_EXPORT_HELP}.")
@overwrite_option
@json_option
def replay_command(file: str, output: str | None, overwrite: bool, as_json: bool) -> int:
    """Render FILE again, without a daemon and not in real time, and compare the forces with the recorded ones.

    FILE is a .npz of `record` or `simulate`, or a flight file. The exit code is 1 if any bit of the forces differs.
    """
    from hapticd.recording.recording import check_target
    from hapticd.recording.replay import replay

    if output is not None:
        check_target(output, overwrite)
    again = replay(file)
    if output is not None:
        again.write(output, overwrite)
    print_result(again.to_dict(), as_json, f"{file}: {again.summary()}")
    return 0 if again.identical == len(again.samples) else 1


@click.command("simulate", short_help="Simulate a scene without a daemon.")
@click.argument("files", nargs=-1, metavar="FILE...", shell_complete=names.scenes)
@configs_option("Configuration below the FILEs, such as that of a device; may be repeated.")
@click.option(
    "--operator",
    metavar="FILE",
    shell_complete=names.operators,
    help="Motion of the hand, as YAML, CSV or a shipped operator  [default: the operator of a shipped scene]",
)
@output_option(f"File for the samples {_EXPORT_HELP}  [default: none, only a summary is printed]")
@for_option("until the operator ends")
@rate_option
@notes_option
@overwrite_option
@json_option
def simulate_command(
    files: tuple[str, ...],
    configs: tuple[str, ...],
    operator: str | None,
    output: str | None,
    duration_s: float | None,
    rate_hz: float | None,
    notes: dict[str, str],
    overwrite: bool,
    as_json: bool,
) -> None:
    """Simulate the scene in all FILEs with the simulated joystick, without a daemon and not in real time.

    A FILE is YAML with a scene, materials or a complete configuration, or the name of a shipped scene. Later files
    override earlier ones. The core is that of the daemon, and every run has the same result. The handle starts at the
    first waypoint if that is at 0 s; otherwise, and with a gesture, at device.sim.start_m of the configuration.

    \b
    hapticd simulate pine.yaml scene.yaml --operator tap.yaml
    """
    from hapticd.config.shipped_files import file_of, shipped, shipped_scenes
    from hapticd.recording.simulated import configuration, simulate_files
    from hapticd.rendering.undisplayable_text import undisplayable_text

    given = [file_of(file, "scenes") for file in (*configs, *files)]
    if not given:
        raise click.UsageError("Missing argument 'FILE...': a scene, or the name of a shipped scene")
    if operator is None:
        operator_of = {scene.file: scene.operator for scene in shipped_scenes()}
        operator = next(filter(None, map(operator_of.get, reversed(given))), None)
    if operator is None:
        if "/dev/stdin" not in given:
            configuration(given)  # a fault of the scene is reported first
        known = ", ".join(shipped("operators"))
        raise click.UsageError(f"Missing option '--operator': a file with the motion of the hand, or one of {known}")
    if output is None and (notes or overwrite):
        raise click.UsageError("--note and --overwrite need -o, the file of the recording")
    result = simulate_files(
        given, file_of(operator, "operators"), output, duration_s, rate_hz, overwrite=overwrite, notes=notes
    )
    for mode in result["undisplayable"]:
        note(undisplayable_text(mode))
    length = f"{wording.count(result['ticks'], 'tick')} in {result['duration_s']:.3f} s"
    kinds = ", ".join(wording.count(number, kind) for kind, number in result["event_counts"].items())
    events = f"{wording.count(result['events'], 'event')}{f' ({kinds})' if kinds else ''}"
    force = f"largest force {wording.si(result['largest_force_n'], 'N')}"
    print_result(result, as_json, f"{result['file'] or ', '.join((*configs, *files))}: {length}, {events}, {force}")


@click.command("lsl", short_help="Stream samples and events to Lab Streaming Layer.")
@for_option("until Ctrl-C")
@json_option
def lsl_command(duration_s: float | None, as_json: bool) -> int:
    """Stream the samples of the daemon and the event codes of sessions to Lab Streaming Layer.

    The outlet `hapticd samples` has a channel for each axis of each quantity. The outlet `hapticd events` has the codes
    in docs/reference/studies.md. The command needs the extra `lsl`. It must run on the daemon's machine, whose clock it
    uses.
    """
    from hapticd.experiment.lsl import EVENTS_OUTLET, SAMPLES_OUTLET, stream

    with daemon() as client, stopped_by_signals() as stop:
        timer = threading.Timer(duration_s or 0.0, stop.set)

        def started() -> None:
            note(f"the outlets {SAMPLES_OUTLET!r} and {EVENTS_OUTLET!r} are open")
            if duration_s is not None:
                timer.start()

        try:
            sent = stream(client, stop, started)
        finally:
            timer.cancel()
    line = f"{wording.count(sent.samples, 'sample')} and {wording.count(sent.events, 'event')} sent"
    print_result(asdict(sent), as_json, line)
    if sent.lost or sent.dropped:
        note(f"{sent.lost:,} samples were lost between daemon and command, {sent.dropped:,} in the ring of the daemon")
    return stop.exit_code(duration_s)
