"""`hapticd run`, and the commands that send a request to a running daemon."""

from __future__ import annotations

import gc
import json
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError, known_names, quoted
from hapticd.base.yaml_text import yaml_text
from hapticd.cli import names
from hapticd.cli.common import (
    Finite,
    config_option,
    daemon,
    json_option,
    log_options,
    note,
    note_if_forces_are_off,
    options,
    print_json,
    print_pairs,
    print_result,
    rate_option,
    runtime_dir,
)

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json
    from hapticd.client.blocking import Client

RELOAD_TIMEOUT_S = 60.0
"""Longest wait for the answer to a reload, in s. It exceeds the 10 s in which the daemon must read its files."""

_change_options = options(
    click.option("--wait", is_flag=True, help="Wait until the change is in force; print its tick."),
    click.option(
        "--expect-revision",
        type=click.IntRange(min=0),
        metavar="N",
        help="Refuse the change unless the scene is at revision N.",
    ),
    json_option,
)
"""Options of commands that change the scene or materials."""
_scene_options = options(
    _change_options,
    click.option("--force", is_flag=True, help="Make the change even if an object holds the handle deep inside."),
)
"""Options of commands that may put objects under the hand."""


def _file(name: str) -> str:
    """Return the path of an input file; `-` is standard input."""
    return "/dev/stdin" if name == "-" else name


@click.command("run")
@config_option
@rate_option
@log_options
def run_command(configs: tuple[str, ...], rate_hz: float | None, log_level: str) -> int:
    """Run the daemon in the foreground."""
    # Garbage collection while modules are imported takes time and frees nothing. The daemon enables it again.
    gc.disable()
    from hapticd.daemon.process import run

    return run(configs, runtime_dir(), log_level, rate_hz)


@click.command("status")
@json_option
def status_command(as_json: bool) -> None:
    """Print the state of the daemon."""
    from hapticd.daemon.status_text import lines, text_of

    with daemon() as client:
        status = client.get_status(detail=True)
    if as_json:
        print_json(status)
    else:
        click.echo(text_of(list(lines(status))))


def _change(as_json: bool, send: Callable[[Client], Mapping[str, object]], timeout_s: float | None = None) -> None:
    """Send a change of scene or materials to the daemon with `send`, and print the daemon's answer."""
    with daemon(timeout_s) as client:
        result = send(client)
    tick = f", in force from tick {result['tick']:,} on" if "tick" in result else ""
    print_result(result, as_json, f"revision {result['revision']:,}{tick}")


@click.command("reload", short_help="Reload the configuration files.")
@_scene_options
def reload_command(expect_revision: int | None, wait: bool, force: bool, as_json: bool) -> None:
    """Reload scene and materials from the configuration files of the daemon.

    The state of contacts and punctures is kept. If any other key has changed, which needs a restart, the reload fails.
    """
    _change(as_json, lambda client: client.reload(expect_revision, wait, force), RELOAD_TIMEOUT_S)


@click.command("apply", short_help="Change materials and scene together.")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", shell_complete=names.scenes)
@_scene_options
def apply_command(files: tuple[str, ...], expect_revision: int | None, wait: bool, force: bool, as_json: bool) -> None:
    """Apply the materials and scenes in all FILEs as one change, at one tick.

    A FILE has the keys `materials`, `scene` or both, or is a scene; it may be the name of a shipped scene, or - for
    standard input. Later files override earlier ones. The scene and each named material are replaced; other materials
    are kept. If anything is invalid, nothing is changed.
    """
    from hapticd.config.change_files import load_change

    given = load_change([_file(file) for file in files])
    _change(
        as_json,
        lambda client: client.apply(
            materials=given.materials, scene=given.scene, expect_revision=expect_revision, wait=wait, force=force
        ),
    )


# ---- The scene -------------------------------------------------------------------------------------------------------


@click.group("scene", no_args_is_help=False)
def scene_command() -> None:
    """Print or change the scene."""


@scene_command.command("list", short_help="List the scenes that ship with hapticd.")
@json_option
def scene_list(as_json: bool) -> None:
    """List the scenes that ship with hapticd.

    Wherever a command takes a scene file, it also takes one of these names.
    """
    from hapticd.config.shipped_files import shipped_scenes

    scenes = shipped_scenes()
    if as_json:
        print_json([scene.to_dict() for scene in scenes])
        return
    made_for = {scene.name: f" (operator: {scene.operator})" if scene.operator else "" for scene in scenes}
    print_pairs((scene.name, scene.shows + made_for[scene.name]) for scene in scenes)


@scene_command.command("get", short_help="Print the scene as YAML.")
@json_option
def scene_get(as_json: bool) -> None:
    """Print the scene as YAML, which `apply` accepts."""
    with daemon() as client:
        result = client.get_scene()
    print_result(result, as_json, f"# revision {result['revision']}\n{yaml_text({'scene': result['scene']})}")


@scene_command.command("update", short_help="Change some objects of the scene.")
@click.argument("file", type=click.Path())
@_scene_options
def scene_update(file: str, expect_revision: int | None, wait: bool, force: bool, as_json: bool) -> None:
    """Merge FILE into the objects of the scene, by id and key; the value null removes an object or a key.

    FILE is YAML, or - for standard input.
    """
    _change(as_json, lambda client: client.update_scene(_file(file), expect_revision, wait, force))


# ---- The materials ---------------------------------------------------------------------------------------------------


@click.group("material", no_args_is_help=False)
def material_command() -> None:
    """Print or change the materials."""


def _materials() -> Mapping[str, object]:
    """Return all materials by name, and the revision; without a daemon the shipped materials and None."""
    from hapticd.protocol.calls import DaemonNotRunning

    try:
        with daemon() as client:
            return client.get_materials()
    except DaemonNotRunning as error:
        note(f"{error}; showing the shipped materials")
    from hapticd.config.materials import shipped_materials

    return {"materials": {name: item.to_dict() for name, item in shipped_materials().items()}, "revision": None}


@material_command.command("list", short_help="Print all materials as YAML.")
@json_option
def material_list(as_json: bool) -> None:
    """Print all materials of the daemon as YAML, which `apply` accepts.

    If no daemon runs, print the shipped materials, with a note on stderr.
    """
    result = _materials()
    print_result(result, as_json, yaml_text({"materials": result["materials"]}))


@material_command.command("get", short_help="Print one material as YAML.")
@click.argument("name", shell_complete=names.materials)
@json_option
def material_get(name: str, as_json: bool) -> None:
    """Print the material NAME as YAML, which `apply` accepts.

    If no daemon runs, print the shipped material, with a note on stderr.
    """
    result = _materials()
    materials = result["materials"]
    assert isinstance(materials, dict)
    if name not in materials:
        unknown = f"unknown material {quoted(name)}"
        if result["revision"] is None:
            unknown = f"{unknown} in the shipped library; other materials need a running daemon"
        raise HapticdError(f"{unknown}; {known_names(name, materials)}")
    found = {"materials": {name: materials[name]}}
    print_result({**result, **found}, as_json, yaml_text(found))


@material_command.command("update", short_help="Change some keys of materials.")
@click.argument("file", type=click.Path())
@_change_options
def material_update(file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Merge FILE into the materials, by name and key; the value null removes a material or a key.

    FILE is YAML, or - for standard input.
    """
    _change(as_json, lambda client: client.update_materials(_file(file), expect_revision, wait))


for _group in (scene_command, material_command):
    # Other names of `apply`, after the methods of the protocol.
    _group.add_command(
        click.Command("set", None, apply_command.callback, apply_command.params, apply_command.help, hidden=True)
    )


# ---- Immediate commands ---------------------------------------------------------------------------------------------


def _mode(text: str) -> dict[str, float]:
    """Return the keys and numbers of a vibration mode from the text of the option `--mode`."""
    try:
        pairs = [part.split("=") for part in text.split(",")]
        mode = {key.strip(): float(number) for key, number in pairs}
        if len(mode) < len(pairs):
            raise ValueError
    except ValueError:
        raise click.BadParameter(
            f"{text}: must be like frequency_hz=200,decay_time_s=0.01, without duplicate keys"
        ) from None
    return mode


@click.command("play", short_help="Play a tap of a material, or a mode.")
@click.argument("material", required=False, shell_complete=names.materials)
@click.option(
    "--mode",
    type=_mode,
    metavar="KEY=NUMBER,...",
    help="Mode to play instead of a tap: frequency and decay, with the keys of a mode in a material.",
)
@click.option("--amplitude", type=Finite(min=0), required=True, metavar="A", help="Acceleration amplitude, in m/s^2.")
@click.option(
    "--direction",
    type=(float, float),
    default=(0.0, 1.0),
    show_default=True,
    metavar="X Y",
    help="Direction of the force.",
)
@json_option
def play_command(
    material: str | None, mode: dict[str, float] | None, amplitude: float, direction: tuple[float, float], as_json: bool
) -> None:
    """Play the tap of MATERIAL, or a mode (a decaying vibration), whether or not anything is touched.

    \b
    hapticd play wood --amplitude 20
    hapticd play --mode frequency_hz=200,decay_time_s=0.01 --amplitude 20
    """
    if (material is None) == (mode is None):
        raise click.UsageError("give either MATERIAL or --mode")
    with daemon() as client:
        result = client.play(material, mode=mode, direction=direction, amplitude_m_per_s2=amplitude)
    frequency = "silent: its frequency is above 0.4 of the servo rate"
    if result["displayed_hz"] is not None:
        frequency = f"shown at {wording.si(result['displayed_hz'], 'Hz')}"
    print_result(result, as_json, f"struck at tick {result['tick']:,}, {frequency}")


@click.command("force", short_help="Turn forces on or off.")
@click.argument("state", type=click.Choice(["on", "off"]))
@json_option
def force_command(state: str, as_json: bool) -> None:
    """Turn forces on or off.

    Turning forces on clears a latched fault whose cause is gone.
    """
    from hapticd.hid.device_texts import LET_GO
    from hapticd.protocol.calls import RemoteError
    from hapticd.protocol.messages import Code

    with daemon() as client:
        try:
            result = client.set_forces(state == "on")
        except RemoteError as error:
            if error.code != Code.FORCES_OFF:
                raise
            if isinstance(error.data, dict) and "signs" in error.data["faults"]:
                raise  # its message says what to do
            # The message of the daemon advises to turn forces on, which the daemon has just refused.
            why = error.message.partition(": ")[0]
            raise RemoteError(error.code, f"{why}, and the cause persists", error.data) from None
    if "signs" in result:
        advice = result["signs"]["advice"]
        state_text = f"on, but held back: {advice}" if advice else f"on, once the check of signs has passed: {LET_GO}"
    elif result["forces"] == "faulted":
        state_text = "off: a fault is latched; see `hapticd status`"
    else:
        state_text = result["forces"]
    print_result(result, as_json, f"forces {state_text}")


@click.command("reset", short_help="Heal membranes and clear contacts.")
@click.argument("objects", nargs=-1, shell_complete=names.objects)
@json_option
def reset_command(objects: tuple[str, ...], as_json: bool) -> None:
    """Heal membranes and clear contacts of OBJECTS, by default of all objects."""
    with daemon() as client:
        result = client.reset(objects or None)
    print_result(result, as_json, f"reset at tick {result['tick']:,}")


@click.command("operator", short_help="Move the hand of the simulated joystick.")
@click.argument("file", shell_complete=names.operators)
@click.option("--wait", is_flag=True, help="Wait until the motion has ended.")
@json_option
def operator_command(file: str, wait: bool, as_json: bool) -> int:
    """Move the hand of the simulated joystick as FILE describes.

    FILE is YAML with waypoints or a gesture, CSV with waypoints, or the name of a shipped operator. With --wait the
    exit code is 1 if another motion replaced this one before its end.
    """
    from hapticd.config.shipped_files import file_of

    source = file_of(file, "operators")
    with daemon() as client:
        result = client.set_operator(source)
        note_if_forces_are_off(client)
        end = client.wait_gesture() if wait else None
    takes = f"takes {wording.duration(result['duration_s'])}"
    if end is None:
        print_result(result, as_json, takes)
        return 0
    print_result({**result, **end}, as_json, takes if end["completed"] else f"{takes}; replaced by another motion")
    return 0 if end["completed"] else 1


def _json(text: str) -> Json:
    """Return the value of the option `--data`, which is JSON text."""
    try:
        data: Json = json.loads(text)
    except ValueError as error:
        raise click.BadParameter(f"{text}: not JSON: {error}") from None
    return data


@click.command("mark", short_help="Put a mark into the event stream.")
@click.argument("text")
@click.option("--data", type=_json, metavar="JSON", help='Data of the mark, as 3, "left" or {"trial": 3}.')
@json_option
def mark_command(text: str, data: Json, as_json: bool) -> None:
    """Put a mark with TEXT into the event stream, and so into every running recording.

    \b
    hapticd mark "trial 3" --data '{"condition": "comb"}'
    """
    with daemon() as client:
        result = client.mark(text, data)
    print_result(result, as_json, f"marked at tick {result['tick']:,}")
