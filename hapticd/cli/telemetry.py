"""`hapticd watch`, `hapticd record` and `hapticd flight`."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hapticd.cli.common import daemon, for_option, json_option, note, notes_option, overwrite_option, print_json

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticd.client.record import RecordSummary


@click.command("watch", short_help="Show what happens, live.")
@for_option("until Ctrl-C")
@json_option
@click.pass_context
def watch_command(ctx: click.Context, duration_s: float | None, as_json: bool) -> None:
    """Show position, forces, contacts and faults live, for some time or until Ctrl-C.

    Into a file or a pipe it prints a line a second, and one for each event.
    """
    from hapticd.client.watch import watch

    def end(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, end)  # so that the terminal is put back as it was
    with daemon(ctx) as client:
        watch(client, as_json, duration_s=duration_s)


@click.command("record", short_help="Record telemetry to a file.")
@click.argument("file", type=click.Path())
@for_option("until Ctrl-C")
@notes_option
@overwrite_option
@json_option
@click.pass_context
def record_command(
    ctx: click.Context, file: str, duration_s: float | None, notes: dict[str, str], overwrite: bool, as_json: bool
) -> int:
    """Record every tick and event into FILE (.npz), and what they were rendered with, for `hapticd replay`. FILE is
    there once the recording is complete.

    If FILE ends in .mcap or .csv, the recording goes into the .npz of the same name, and FILE is exported from it at
    the end. If an earlier recording into FILE was killed, the command says so; `hapticd recover FILE` recovers it.
    """
    from dataclasses import asdict

    from hapticd.client.record import record
    from hapticd.recording.output import check_target
    from hapticd.recording.recovery import partial_files_beside

    stop = threading.Event()
    received: list[int] = []

    def end(number: int, frame: object) -> None:
        received.append(number)
        stop.set()

    check_target(file, overwrite)
    found = partial_files_beside(file)
    if found is not None:
        note(found)
    with daemon(ctx) as client:
        before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            with _progress(duration_s) as progress:
                recording = record(
                    client, file, duration_s, overwrite=overwrite, notes=notes, stop=stop, progress=progress
                )
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    if as_json:
        print_json(asdict(recording))
    else:
        click.echo(recording.summary())
    if recording.warning is not None:
        note(recording.warning)
    return _exit_code(recording, duration_s, received)


@click.command("flight", short_help="Write the last seconds to a file.")
@click.argument("file", required=False, type=click.Path())
@overwrite_option
@json_option
@click.pass_context
def flight_command(ctx: click.Context, file: str | None, overwrite: bool, as_json: bool) -> None:
    """Have the flight recorder write the last seconds of samples and events to a file, and write what is in it to FILE
    (.npz, or an export to .csv or .mcap), too.

    The file of a daemon on another machine stays there.
    """
    from hapticd.client.flight_summary import summed_up, written_flight

    if file is not None:
        from hapticd.recording.recording import check_saved

        check_saved(file, overwrite)
    with daemon(ctx) as client:
        written = written_flight(client)
    found: dict[str, object] = {"file": written}
    line = f"{written} on the daemon's machine"
    if file is not None or os.path.exists(written):
        found, line = summed_up(written, file, overwrite)
    if as_json:
        print_json(found)
    else:
        click.echo(line)


def _exit_code(recording: RecordSummary, duration_s: float | None, received: list[int]) -> int:
    if received:
        return 0 if duration_s is None else 128 + received[0]
    if recording.ended_because is not None:
        note(f"{recording.ended_because}; {recording.file} holds what came before")
        return 1
    return 0


@contextmanager
def _progress(duration_s: float | None) -> Iterator[Callable[[float], None]]:
    if not sys.stderr.isatty():
        yield lambda recorded_s: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = [TextColumn("recording"), BarColumn(), TextColumn("{task.completed:.1f} s")]
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=duration_s)
        yield lambda recorded_s: bar.update(task, completed=recorded_s)
