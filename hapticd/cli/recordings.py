"""Commands that watch, record or stream a daemon, simulate without one, or process recordings."""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import asdict

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.cli import names
from hapticd.cli.common import (
    Finite,
    daemon,
    for_option,
    json_option,
    note,
    notes_option,
    output_option,
    overwrite_option,
    print_result,
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
@for_option("until Ctrl-C")
@notes_option
@overwrite_option
@json_option
def record_command(file: str, duration_s: float | None, notes: dict[str, str], overwrite: bool, as_json: bool) -> int:
    """Record every tick and event to FILE (.npz), with the configuration, scene and materials for `hapticd replay`.

    FILE appears when the recording is complete. If its suffix is .mcap or .csv, the recording goes to the .npz of the
    same name, and FILE is exported from it at the end. A note reports an earlier recording to FILE that was killed and
    can be recovered with `hapticd recover FILE`.
    """
    from hapticd.client.record import record
    from hapticd.recording.recording import check_target
    from hapticd.recording.recovery import partial_files_warning

    check_target(file, overwrite)
    found = partial_files_warning(file)
    if found is not None:
        note(found)
    with daemon() as client, stopped_by_signals() as stop, status_line() as show:
        recording = record(
            client,
            file,
            duration_s,
            overwrite=overwrite,
            notes=notes,
            stop=stop,
            progress=lambda recorded_s: show(f"recording, {recorded_s:.1f} s"),
        )
    print_result(asdict(recording), as_json, recording.summary())
    if stop.signal is None and recording.ended_because is not None:
        note(f"{recording.ended_because}; {recording.file} has everything before that")
        return 1
    return stop.exit_code(duration_s)


@click.command("recover", short_help="Recover the partial files of a killed recording.")
@click.argument("file", type=click.Path(dir_okay=False))
@json_option
def recover_command(file: str, as_json: bool) -> int:
    """Recover each recording to FILE that was killed or could not be completed, as NAME.recovered.npz.

    Files that cannot be read and recordings that are running are kept and reported. The exit code is 1 if nothing was
    recovered.
    """
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


@click.command("export", short_help="Convert a recording to .csv or .mcap.")
@click.argument("file", type=click.Path(dir_okay=False))
@click.argument("target", type=click.Path())
@overwrite_option
def export_command(file: str, target: str, overwrite: bool) -> None:
    """Convert the recording FILE to TARGET: .mcap for robotics tools, .csv for other programs.

    FILE is a .npz of `record`, `simulate` or `flight`. With .csv the events go to a second file, NAME.events.csv, and
    scene and materials to a third, NAME.about.json.
    """
    from hapticd.recording.recording import check_saved, load

    check_saved(target, overwrite)
    recording = load(file)
    saved = recording.save(target, overwrite)
    click.echo(f"{saved}: {len(recording.samples):,} ticks, {len(recording.events):,} events")


@click.command("flight", short_help="Write the last seconds of samples to a file.")
@click.argument("file", required=False, type=click.Path())
@overwrite_option
@json_option
def flight_command(file: str | None, overwrite: bool, as_json: bool) -> None:
    """Write the last seconds of samples and events to a flight file of the daemon, and to FILE if given.

    FILE is .npz, .csv or .mcap. The flight file is on the machine of the daemon.
    """
    from hapticd.client.flight_summary import summed_up, written_flight
    from hapticd.recording.recording import check_saved

    if file is not None:
        check_saved(file, overwrite)
    with daemon() as client:
        written = written_flight(client)
    found: dict[str, object] = {"file": written}
    line = f"{written} on the daemon's machine"
    if file is not None or os.path.exists(written):
        found, line = summed_up(written, file, overwrite)
    print_result(found, as_json, line)


@click.command("replay", short_help="Render a recording again and compare forces.")
@click.argument("file", type=click.Path(dir_okay=False))
@output_option(f"File for the rendered recording {_EXPORT_HELP}.")
@overwrite_option
@json_option
def replay_command(file: str, output: str | None, overwrite: bool, as_json: bool) -> int:
    """Render FILE again, without a daemon and not in real time, and compare the forces with the recorded ones.

    FILE is a .npz of `record`, `simulate` or `flight`. The exit code is 1 if any bit of the forces differs.
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
@click.argument("scene", shell_complete=names.scenes)
@click.option(
    "--operator",
    metavar="FILE",
    shell_complete=names.operators,
    help="Motion of the hand, as YAML, CSV or a shipped operator  [default: the operator of a shipped scene]",
)
@output_option(f"File for the samples {_EXPORT_HELP}  [default: none, only a summary is printed]")
@for_option("until the operator ends")
@click.option(
    "--rate",
    "rate_hz",
    type=Finite(min=0, min_open=True),
    metavar="HZ",
    help="Ticks per second [default: the configuration's].",
)
@notes_option
@overwrite_option
@json_option
def simulate_command(
    scene: str,
    operator: str | None,
    output: str | None,
    duration_s: float | None,
    rate_hz: float | None,
    notes: dict[str, str],
    overwrite: bool,
    as_json: bool,
) -> None:
    """Simulate SCENE with the simulated joystick, without a daemon and not in real time.

    SCENE is YAML with a scene or a complete configuration, or the name of a shipped scene. The core is that of the
    daemon, and every run has the same result. The handle starts at the first waypoint if that is at 0 s; otherwise, and
    with a gesture, at device.sim.start_m of the configuration.
    """
    from hapticd.config.shipped_files import file_of, shipped, shipped_scenes
    from hapticd.recording.simulated import configuration, simulate_files
    from hapticd.rendering.undisplayable_text import undisplayable_text

    file = file_of(scene, "scenes")
    operator = operator or next((each.operator for each in shipped_scenes() if each.file == file), None)
    if operator is None:
        if file != "/dev/stdin":
            configuration(file)  # a fault of the scene is reported first
        known = ", ".join(shipped("operators"))
        raise click.UsageError(f"Missing option '--operator': a file with the motion of the hand, or one of {known}")
    if output is None and (notes or overwrite):
        raise click.UsageError("--note and --overwrite need -o, the file of the recording")
    result = simulate_files(
        file, file_of(operator, "operators"), output, duration_s, rate_hz, overwrite=overwrite, notes=notes
    )
    for mode in result["undisplayable"]:
        note(undisplayable_text(mode))
    length = f"{wording.count(result['ticks'], 'tick')} in {result['duration_s']:.3f} s"
    kinds = ", ".join(wording.count(number, kind) for kind, number in result["event_counts"].items())
    events = f"{wording.count(result['events'], 'event')}{f' ({kinds})' if kinds else ''}"
    force = f"largest force {wording.si(result['largest_force_n'], 'N')}"
    print_result(result, as_json, f"{result['file'] or scene}: {length}, {events}, {force}")


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
