"""`hapticd doctor`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from itertools import chain

import click

from hapticd.base import wording
from hapticd.cli.common import config_option, json_option, note, print_json

_ANSWER_S = 2.0


@click.command("doctor", short_help="Check whether this machine is ready.")
@config_option
@json_option
@click.pass_context
def doctor_command(ctx: click.Context, configs: tuple[str, ...], as_json: bool) -> int:
    """Check whether this machine is ready for the daemon, and say what to do about each problem.

    The rights shown are those of the user who runs the command; nothing is changed. It waits at most 5 s
    for systemd and 2 s for a daemon that runs and does not answer. The exit code is 1
    if something fails that the configuration needs.
    """
    from hapticd._version import __version__
    from hapticd.base.errors import HapticdError
    from hapticd.client.blocking import connect
    from hapticd.config.locations import choose
    from hapticd.doctor import diagnose
    from hapticd.doctor.machine import Machine, Needs, holder
    from hapticd.doctor.service import configuration
    from hapticd.protocol.calls import DaemonNotRunning
    from hapticd.system.paths import SYSTEM_DIRECTORY, daemon_paths, runtime_paths

    config, first = configuration(choose(configs))

    def asked() -> Mapping[str, object] | None:
        # Our own, else the service's.
        named = ctx.find_root().obj
        for place in (named,) if named is not None else (daemon_paths().directory, SYSTEM_DIRECTORY):
            pid, is_stopped = holder(runtime_paths(place).command) or (None, False)
            if is_stopped:
                raise HapticdError(f"process {pid} holds {place} and does not answer: it is stopped")
            try:
                with connect(place, _ANSWER_S) as client:
                    return client.get_status()
            except DaemonNotRunning:
                if pid is not None:
                    waited = f"did not answer within {_ANSWER_S:g} s"
                    raise HapticdError(f"process {pid} holds {place} and {waited}") from None
        return None

    servo = config.servo
    device = config.device.hid if config.device.kind == "hid" else None
    needs = Needs(servo.realtime, servo.priority, servo.cpu, device is not None, device)
    findings = []
    for finding in chain([first], diagnose(Machine(daemon=asked, version=__version__), needs)):
        findings.append(finding)
        if not as_json:
            click.echo(str(finding))
    if as_json:
        print_json([asdict(finding) for finding in findings])
    failed = [finding.name for finding in findings if finding.verdict == "fail"]
    if not failed:
        return 0
    if not as_json:
        note(f"not ready: {wording.listed(list(dict.fromkeys(failed)))}")
    return 1
