"""`hapticd simulate`, `hapticd replay` and `hapticd schema`: what needs no daemon."""

from __future__ import annotations

import json

import click

from hapticd.base import wording
from hapticd.cli import names
from hapticd.cli.common import (
    Finite,
    for_option,
    json_option,
    note,
    notes_option,
    overwrite_option,
    print_json,
)
from hapticd.rendering.undisplayable_text import undisplayable_text


@click.command("simulate", short_help="Run a scene without daemon and clock.")
@click.argument("scene", shell_complete=names.scenes)
@click.option(
    "--operator",
    metavar="FILE",
    shell_complete=names.operators,
    help="What the hand does (YAML or CSV), or a shipped operator's name  [default: of a shipped scene, its own]",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(),
    metavar="FILE",
    help="Where the samples go (.npz; .csv and .mcap are exported from the .npz beside it)  [default: nowhere, the "
    "summary alone is printed]",
)
@for_option("as long as the operator")
@click.option("--rate", "rate_hz", type=Finite(), metavar="HZ", help="Ticks per second [default: the configuration's].")
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
    """Run SCENE (YAML: a scene or a whole configuration; or the name of a shipped scene) with the simulated joystick,
    without daemon and clock.

    The same core as the daemon's; the result is the same on every run. The handle starts at the first
    waypoint if that is at 0 s, otherwise, and with a gesture, at device.sim.start_m of the configuration.
    """
    from hapticd.config.shipped_files import file_of, shipped
    from hapticd.recording.simulated import configuration, simulate_files

    file = file_of(scene, "scenes")
    operator = operator or _own_operator(file)
    if operator is None:
        if file != "/dev/stdin":
            configuration(file)  # what is no scene is reported first
        known = ", ".join(shipped("operators"))
        raise click.UsageError(f"Missing option '--operator': a file that says what the hand does, or one of {known}")
    if output is None and (notes or overwrite):
        raise click.UsageError("--note and --overwrite are for a file: name it with -o")
    result = simulate_files(
        file, file_of(operator, "operators"), output, duration_s, rate_hz, overwrite=overwrite, notes=notes
    )
    for mode in result["undisplayable"]:
        note(undisplayable_text(mode))
    for warning in result["warnings"]:
        note(f"{warning['where']}: {warning['problem']}")
    if as_json:
        print_json(result)
    else:
        length = f"{wording.count(result['ticks'], 'tick')} in {result['duration_s']:.3f} s"
        kinds = ", ".join(wording.count(number, kind) for kind, number in result["event_counts"].items())
        told = f"{wording.count(result['events'], 'event')}{f' ({kinds})' if kinds else ''}"
        force = f"largest force {wording.si(result['largest_force_n'], 'N')}"
        click.echo(f"{result['file'] or scene}: {length}, {told}, {force}")


def _own_operator(scene: str) -> str | None:
    """The operator of a shipped scene."""
    from hapticd.config.shipped_files import shipped_scenes

    return next((each.operator for each in shipped_scenes() if each.file == scene), None)


@click.command("replay", short_help="Render a recording again, and compare.")
@click.argument("file", type=click.Path(dir_okay=False))
@click.option(
    "-o",
    "--output",
    type=click.Path(),
    metavar="FILE",
    help="Where what was rendered goes (.npz; .csv and .mcap are exported from the .npz beside it).",
)
@overwrite_option
@json_option
def replay_command(file: str, output: str | None, overwrite: bool, as_json: bool) -> int:
    """Render FILE (.npz of `record`, `simulate` or `flight`) again, without daemon and clock, and
    compare the forces.

    Ends with 1 if they differ from the recorded ones in any bit.
    """
    from hapticd.recording.output import check_target
    from hapticd.recording.replay import replay

    if output is not None:
        check_target(output, overwrite)
    again = replay(file)
    if output is not None:
        again.write(output, overwrite)
    if as_json:
        print_json(again.to_dict())
    else:
        click.echo(f"{file}: {again.summary()}")
    return 0 if again.identical == len(again.samples) else 1


@click.command("schema", short_help="Print the schema of the configuration or the protocol.")
@click.option(
    "--protocol",
    type=click.Choice(["openrpc", "asyncapi"]),
    help="Of the protocol instead: OpenRPC of the requests, or AsyncAPI of telemetry and streams.",
)
def schema_command(protocol: str | None) -> None:
    """Print the JSON Schema of the configuration, for editors; or a description of the protocol, for programs."""
    from hapticd.config.schema import config_schema
    from hapticd.daemon.described.documents import asyncapi_document, openrpc_document

    documents = {None: config_schema, "openrpc": openrpc_document, "asyncapi": asyncapi_document}
    click.echo(json.dumps(documents[protocol](), indent=2, ensure_ascii=False))
