"""`hapticd play`, `force`, `reset` and `operator`: what is done at once."""

from __future__ import annotations

import re

import click

from hapticd.base import wording
from hapticd.cli import names
from hapticd.cli.common import Choice, Finite, daemon, json_option, note, print_result


@click.command("play", short_help="Strike a material's tap, or a mode.")
@click.argument("material", required=False, shell_complete=names.materials)
@click.option(
    "--mode",
    "mode_text",
    metavar="KEY=NUMBER,...",
    help="Instead of a material's tap: its frequency and its decay, in the keys of a material's.",
)
@click.option(
    "--amplitude",
    type=Finite(min=0),
    required=True,
    metavar="A",
    help="Acceleration amplitude, m/s^2.",
)
@click.option(
    "--direction",
    type=(float, float),
    default=(0.0, 1.0),
    show_default=True,
    metavar="X Y",
    help="Where it pushes.",
)
@json_option
@click.pass_context
def play_command(
    ctx: click.Context,
    material: str | None,
    mode_text: str | None,
    amplitude: float,
    direction: tuple[float, float],
    as_json: bool,
) -> None:
    """Strike the tap of MATERIAL, or a mode, whatever is touched.

    \b
    hapticd play wood --amplitude 20
    hapticd play --mode frequency_hz=200,decay_time_s=0.01 --amplitude 20
    """
    if (material is None) == (mode_text is None):
        raise click.UsageError("needs a MATERIAL or --mode, and not both")
    mode = None if mode_text is None else _mode(mode_text)
    with daemon(ctx) as client:
        result = client.play(material, mode=mode, direction=direction, amplitude_m_per_s2=amplitude)
    shown = result["displayed_hz"]
    heard = (
        f"shown at {wording.si(shown, 'Hz')}"
        if shown is not None
        else "silent: its frequency is above 0.4 of the servo's rate"
    )
    print_result(result, as_json, f"struck at tick {result['tick']:,}, {heard}")


def _mode(text: str) -> dict[str, float]:
    mode: dict[str, float] = {}
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\w+)\s*=\s*([-+.0-9eE]+)\s*", part)
        try:
            if match is None or match[1] in mode:
                raise ValueError
            mode[match[1]] = float(match[2])
        except ValueError:
            raise click.UsageError(
                f"--mode {text}: write it as frequency_hz=200,decay_time_s=0.01, each key once"
            ) from None
    return mode


@click.command("force", short_help="Turn forces on or off.")
@click.argument("state", type=Choice(["on", "off"]))
@json_option
@click.pass_context
def force_command(ctx: click.Context, state: str, as_json: bool) -> None:
    """Turn forces on or off; on clears a latched fault whose cause is gone."""
    from hapticd.protocol.calls import RemoteError
    from hapticd.protocol.messages import Code

    with daemon(ctx) as client:
        try:
            result = client.set_forces(state == "on")
        except RemoteError as error:
            if error.code != Code.FORCES_OFF:
                raise
            if isinstance(error.data, dict) and "signs" in error.data["faults"]:
                raise  # it says what to do
            # What the daemon tells every client is to turn them on, which was just refused.
            why = error.message.partition(": ")[0]
            raise RemoteError(error.code, f"{why}, which is still so: they stay off", error.data) from None
    faulted = result["forces"] == "faulted"
    if "signs" in result:
        advice = result["signs"]["advice"] or "let go of the handle"
        print_result(result, as_json, f"forces on; first the signs of the device are checked: {advice}")
        return
    told = "off, and a fault is latched: `hapticd status` says which" if faulted else result["forces"]
    print_result(result, as_json, f"forces {told}")


@click.command("reset", short_help="Heal membranes and clear contacts.")
@click.argument("objects", nargs=-1, shell_complete=names.objects)
@json_option
@click.pass_context
def reset_command(ctx: click.Context, objects: tuple[str, ...], as_json: bool) -> None:
    """Heal membranes and clear contacts, of OBJECTS or of all."""
    with daemon(ctx) as client:
        result = client.reset(objects or None)
    print_result(result, as_json, f"reset at tick {result['tick']:,}")


@click.command("operator", short_help="Move the simulated joystick's hand.")
@click.argument("file", shell_complete=names.operators)
@json_option
@click.pass_context
def operator_command(ctx: click.Context, file: str, as_json: bool) -> None:
    """Let the simulated joystick's hand do what FILE says (YAML waypoints or a gesture, or CSV waypoints; or
    the name of a shipped operator)."""
    from hapticd.config.shipped_files import file_of

    source = file_of(file, "operators")
    with daemon(ctx) as client:
        result = client.set_operator(source)
        forces = client.get_status()["forces"]
    if forces != "on":
        note("forces are off: the hand moves, and nothing pushes it; `hapticd status` says why")
    print_result(result, as_json, f"takes {wording.duration(result['duration_s'])}")
