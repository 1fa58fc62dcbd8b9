"""`hapticd lsl`: samples and event codes as outlets of Lab Streaming Layer."""

from __future__ import annotations

import signal
import threading

import click

from hapticd.base import wording
from hapticd.cli.common import daemon, for_option, json_option, note, print_json


@click.command("lsl", short_help="Samples and event codes as outlets of Lab Streaming Layer.")
@for_option("until Ctrl-C")
@json_option
@click.pass_context
def lsl_command(ctx: click.Context, duration_s: float | None, as_json: bool) -> int:
    """Pass every sample of the daemon, and the event codes of sessions, on to Lab Streaming Layer.

    Two outlets: `hapticd samples`, a number for each axis and quantity, and `hapticd events`, the codes that
    docs/experiments.md lists. It needs the extra `lsl`, and runs on the daemon's machine, whose clock it uses.
    """
    from dataclasses import asdict

    from hapticd.experiment.lsl import EVENTS, SAMPLES, stream

    stop = threading.Event()
    received: list[int] = []

    def end(number: int, frame: object) -> None:
        received.append(number)
        stop.set()

    with daemon(ctx) as client:
        timer = None if duration_s is None else threading.Timer(duration_s, stop.set)

        def started() -> None:
            note(f"{SAMPLES!r} and {EVENTS!r} are there")
            if timer is not None:
                timer.start()

        before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            sent = stream(client, stop, started)
        finally:
            if timer is not None:
                timer.cancel()
            for number, handler in before.items():
                signal.signal(number, handler)
    if as_json:
        print_json(asdict(sent))
    else:
        click.echo(f"{wording.count(sent.samples, 'sample')} and {wording.count(sent.events, 'event')} sent")
    if sent.lost or sent.dropped:
        note(f"{sent.lost:,} samples were lost on the way here, {sent.dropped:,} in the daemon's ring")
    return 128 + received[0] if received and duration_s is not None else 0
