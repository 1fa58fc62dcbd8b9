"""The daemon: `hapticd run`, and the commands that ask one that runs for something."""

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
    options,
    print_json,
    print_pairs,
    print_result,
    runtime_dir,
)

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json
    from hapticd.client.blocking import Client

RELOAD_S = 60.0
"""So long is a reload waited for: the daemon itself gives up files that do not come after 10 s."""

_change_options = options(
    click.option("--wait", is_flag=True, help="Wait until it is in force, and print the tick."),
    click.option(
        "--expect-revision",
        type=click.IntRange(min=0),
        metavar="N",
        help="Change nothing unless the scene is at revision N.",
    ),
    json_option,
)
"""Options of commands that change scene or materials."""


def _file(name: str) -> str:
    """The path of a file that a command reads; `-` is the standard input."""
    return "/dev/stdin" if name == "-" else name


@click.command("run")
@config_option
@log_options
def run_command(configs: tuple[str, ...], log_level: str) -> int:
    """Run the daemon in the foreground."""
    # What is loaded now stays: looking for garbage among it would only take time. The daemon turns it on again.
    gc.disable()
    from hapticd.daemon.process import run

    return run(configs, runtime_dir(), log_level)


@click.command("status")
@json_option
def status_command(as_json: bool) -> None:
    """Show the state of the daemon."""
    from hapticd.daemon.status_text import lines, text_of

    with daemon() as client:
        status = client.get_status(detail=True)
    if as_json:
        print_json(status)
    else:
        click.echo(text_of(list(lines(status))))


def _change(as_json: bool, send: Callable[[Client], Mapping[str, object]], timeout_s: float | None = None) -> None:
    """Has the daemon change scene or materials, and prints what it answers."""
    with daemon(timeout_s) as client:
        result = send(client)
    tick = f", in force from tick {result['tick']:,} on" if "tick" in result else ""
    print_result(result, as_json, f"revision {result['revision']:,}{tick}")


@click.command("reload", short_help="Read the configuration files again.")
@_change_options
def reload_command(expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Have the daemon read its configuration files again, and take scene and materials from them: all or nothing.

    What was touched or punctured stays so. Anything else that changed needs a restart, and refuses the whole.
    """
    _change(as_json, lambda client: client.reload(expect_revision, wait), RELOAD_S)


@click.command("apply", short_help="Change materials and scene together.")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", shell_complete=names.scenes)
@_change_options
def apply_command(files: tuple[str, ...], expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Set the materials, the scene or both that FILEs hold: one change at one tick, all or nothing.

    A FILE holds `materials`, `scene` or both, or a scene alone, or is the name of a shipped scene; - is the standard
    input. Later files override earlier ones. Each material that is named is replaced whole, others stay; the scene is
    replaced.
    """
    from hapticd.config.change_files import load_change

    given = load_change([_file(file) for file in files])
    _change(
        as_json,
        lambda client: client.apply(
            materials=given.materials, scene=given.scene, expect_revision=expect_revision, wait=wait
        ),
    )


# ---- The scene -------------------------------------------------------------------------------------------------------


@click.group("scene", no_args_is_help=False)
def scene_command() -> None:
    """Read or change the scene."""


@scene_command.command("list", short_help="List the scenes that ship with hapticd.")
@json_option
def scene_list(as_json: bool) -> None:
    """List the scenes that ship with hapticd: each name does where a command takes a scene."""
    from hapticd.config.shipped_files import shipped_scenes

    scenes = shipped_scenes()
    if as_json:
        print_json([scene.to_dict() for scene in scenes])
        return
    made_for = {scene.name: f" (operator: {scene.operator})" if scene.operator else "" for scene in scenes}
    print_pairs((scene.name, scene.shows + made_for[scene.name]) for scene in scenes)


@scene_command.command("get", short_help="Print the scene, as YAML.")
@json_option
def scene_get(as_json: bool) -> None:
    """Print the scene, as YAML that `scene set` takes."""
    with daemon() as client:
        result = client.get_scene()
    print_result(result, as_json, f"# revision {result['revision']}\n{yaml_text({'scene': result['scene']})}")


@scene_command.command("set", short_help="Replace the scene.")
@click.argument("file", shell_complete=names.scenes)
@_change_options
def scene_set(file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Replace the scene by that in FILE (YAML, or the name of a shipped scene; - is the standard input)."""
    from hapticd.config.shipped_files import file_of

    source = file_of(file, "scenes")
    _change(as_json, lambda client: client.set_scene(source, expect_revision, wait))


@scene_command.command("update", short_help="Change single objects; null removes.")
@click.argument("file", type=click.Path())
@_change_options
def scene_update(file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Change objects as FILE says: what it holds is merged into them by id and key, null removes."""
    _change(as_json, lambda client: client.update_scene(_file(file), expect_revision, wait))


# ---- The materials ---------------------------------------------------------------------------------------------------


@click.group("material", no_args_is_help=False)
def material_command() -> None:
    """Read or change the materials."""


def _materials() -> Mapping[str, object]:
    """All materials by name, and the revision; without a daemon those that ship, and null."""
    from hapticd.protocol.calls import DaemonNotRunning

    try:
        with daemon() as client:
            return client.get_materials()
    except DaemonNotRunning as error:
        note(f"{error}; these are the materials of the shipped library")
    from hapticd.config.materials import shipped_materials

    return {"materials": {name: item.to_dict() for name, item in shipped_materials().items()}, "revision": None}


@material_command.command("list", short_help="Print all materials, as YAML.")
@json_option
def material_list(as_json: bool) -> None:
    """Print all materials, as YAML that `material set` takes.

    They are the daemon's; where none runs, those of the shipped library, and a line on stderr says so.
    """
    result = _materials()
    print_result(result, as_json, yaml_text({"materials": result["materials"]}))


@material_command.command("get", short_help="Print one material, as YAML.")
@click.argument("name", shell_complete=names.materials)
@json_option
def material_get(name: str, as_json: bool) -> None:
    """Print the material NAME, as YAML that `material set` takes: the daemon's or, where none runs, the shipped one."""
    result = _materials()
    materials = result["materials"]
    assert isinstance(materials, dict)
    if name not in materials:
        told = f"unknown material {quoted(name)}"
        if result["revision"] is None:
            told = f"{told} in the shipped library; one that was set is known to the daemon alone"
        raise HapticdError(f"{told}; {known_names(name, materials)}")
    found = {"materials": {name: materials[name]}}
    print_result({**result, **found}, as_json, yaml_text(found))


@material_command.command("set", short_help="Replace the materials that are named.")
@click.argument("file", type=click.Path())
@_change_options
def material_set(file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Set the materials in FILE (YAML; - is the standard input): each is replaced whole, others stay."""
    _change(as_json, lambda client: client.set_materials(_file(file), expect_revision, wait))


@material_command.command("update", short_help="Change single keys; null removes.")
@click.argument("file", type=click.Path())
@_change_options
def material_update(file: str, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Change materials as FILE says: what it holds is merged into them by name and key, null removes."""
    _change(as_json, lambda client: client.update_materials(_file(file), expect_revision, wait))


# ---- What is done at once --------------------------------------------------------------------------------------------


def _mode(text: str) -> dict[str, float]:
    """The keys and numbers of `--mode`."""
    try:
        pairs = [part.split("=") for part in text.split(",")]
        mode = {key.strip(): float(number) for key, number in pairs}
        if len(mode) < len(pairs):
            raise ValueError
    except ValueError:
        raise click.BadParameter(f"{text}: write it as frequency_hz=200,decay_time_s=0.01, each key once") from None
    return mode


@click.command("play", short_help="Strike a material's tap, or a mode.")
@click.argument("material", required=False, shell_complete=names.materials)
@click.option(
    "--mode",
    type=_mode,
    metavar="KEY=NUMBER,...",
    help="Instead of a material's tap: its frequency and its decay, in the keys of a material's.",
)
@click.option("--amplitude", type=Finite(min=0), required=True, metavar="A", help="Acceleration amplitude, m/s^2.")
@click.option(
    "--direction", type=(float, float), default=(0.0, 1.0), show_default=True, metavar="X Y", help="Where it pushes."
)
@json_option
def play_command(
    material: str | None, mode: dict[str, float] | None, amplitude: float, direction: tuple[float, float], as_json: bool
) -> None:
    """Strike the tap of MATERIAL, or a mode, whatever is touched.

    \b
    hapticd play wood --amplitude 20
    hapticd play --mode frequency_hz=200,decay_time_s=0.01 --amplitude 20
    """
    if (material is None) == (mode is None):
        raise click.UsageError("needs a MATERIAL or --mode, and not both")
    with daemon() as client:
        result = client.play(material, mode=mode, direction=direction, amplitude_m_per_s2=amplitude)
    heard = "silent: its frequency is above 0.4 of the servo's rate"
    if result["displayed_hz"] is not None:
        heard = f"shown at {wording.si(result['displayed_hz'], 'Hz')}"
    print_result(result, as_json, f"struck at tick {result['tick']:,}, {heard}")


@click.command("force", short_help="Turn forces on or off.")
@click.argument("state", type=click.Choice(["on", "off"]))
@json_option
def force_command(state: str, as_json: bool) -> None:
    """Turn forces on or off; on clears a latched fault whose cause is gone."""
    from hapticd.protocol.calls import RemoteError
    from hapticd.protocol.messages import Code

    with daemon() as client:
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
    if "signs" in result:
        advice = result["signs"]["advice"] or "let go of the handle"
        told = f"on; first the signs of the device are checked: {advice}"
    elif result["forces"] == "faulted":
        told = "off, and a fault is latched: `hapticd status` says which"
    else:
        told = result["forces"]
    print_result(result, as_json, f"forces {told}")


@click.command("reset", short_help="Heal membranes and clear contacts.")
@click.argument("objects", nargs=-1, shell_complete=names.objects)
@json_option
def reset_command(objects: tuple[str, ...], as_json: bool) -> None:
    """Heal membranes and clear contacts, of OBJECTS or of all."""
    with daemon() as client:
        result = client.reset(objects or None)
    print_result(result, as_json, f"reset at tick {result['tick']:,}")


@click.command("operator", short_help="Move the simulated joystick's hand.")
@click.argument("file", shell_complete=names.operators)
@json_option
def operator_command(file: str, as_json: bool) -> None:
    """Let the simulated joystick's hand do what FILE says (YAML waypoints or a gesture, or CSV waypoints; or
    the name of a shipped operator)."""
    from hapticd.config.shipped_files import file_of

    source = file_of(file, "operators")
    with daemon() as client:
        result = client.set_operator(source)
        forces = client.get_status()["forces"]
    if forces != "on":
        note("forces are off: the hand moves, and nothing pushes it; `hapticd status` says why")
    print_result(result, as_json, f"takes {wording.duration(result['duration_s'])}")


def _json(text: str) -> Json:
    """What `--data` holds."""
    try:
        data: Json = json.loads(text)
    except ValueError as error:
        raise click.BadParameter(f"{text}: is not JSON: {error}") from None
    return data


@click.command("mark", short_help="Leave a mark in the event stream.")
@click.argument("text")
@click.option("--data", type=_json, metavar="JSON", help='Kept with the mark: 3, "left", {"trial": 3}.')
@json_option
def mark_command(text: str, data: Json, as_json: bool) -> None:
    """Leave a mark with TEXT in the event stream and in every recording that is under way.

    \b
    hapticd mark "trial 3" --data '{"condition": "comb"}'
    """
    with daemon() as client:
        result = client.mark(text, data)
    print_result(result, as_json, f"marked at tick {result['tick']:,}")
