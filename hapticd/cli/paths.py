"""`hapticd paths`: where everything is."""

from __future__ import annotations

import os
from typing import Final, Literal, TypedDict

import click

from hapticd.cli.common import config_option, json_option, note, print_json


class _Paths(TypedDict):
    configuration: dict[str, object]
    runtime_directory: str
    command_socket: str
    telemetry_socket: str
    flight_files: str | None
    scenes: dict[str, object]
    operators: dict[str, object]
    materials: dict[str, object]
    experiments: dict[str, object]
    sweeps: dict[str, object]
    units: str


_SHIPPED: Final[dict[str, Literal["scenes", "operators", "materials", "experiments", "sweeps"]]] = {
    "scenes": "scenes",
    "operators": "operators",
    "materials": "materials",
    "studies": "experiments",
    "sweeps": "sweeps",
}
"""Folders of what ships, by the word for what is in them."""


@click.command("paths", short_help="List the places of files and sockets.")
@config_option
@json_option
@click.pass_context
def paths_command(ctx: click.Context, configs: tuple[str, ...], as_json: bool) -> int:
    """Say where the configuration, the sockets, the flight files and what ships with hapticd are.

    Nothing is made, and no daemon is asked. The exit code is 1 if the configuration is faulty.
    """
    from hapticd.base.errors import HapticdError
    from hapticd.config.configuration import chosen_config
    from hapticd.config.locations import choose
    from hapticd.config.shipped_files import folder_of, shipped, units_folder
    from hapticd.daemon.flight_recorder import directory_of
    from hapticd.system.paths import runtime_paths

    chosen = choose(configs)
    runtime = runtime_paths(ctx.find_root().obj)
    flight: str | None = None
    fault: str | None = None
    try:
        flight = str(directory_of(chosen_config(chosen).flight.directory, runtime.directory))
    except HapticdError as error:
        fault = str(error)
    found: _Paths = {
        "configuration": {
            "origin": chosen.origin,
            "files": [os.path.abspath(file) for file in chosen.files],
            "looked_for": list(chosen.looked_for),
            "fault": fault,
        },
        "runtime_directory": str(runtime.directory),
        "command_socket": str(runtime.command),
        "telemetry_socket": str(runtime.telemetry),
        "flight_files": flight,
        "scenes": {"folder": str(folder_of("scenes")), "names": list(shipped("scenes"))},
        "operators": {"folder": str(folder_of("operators")), "names": list(shipped("operators"))},
        "materials": {"folder": str(folder_of("materials")), "names": list(shipped("materials"))},
        "experiments": {"folder": str(folder_of("experiments")), "names": list(shipped("experiments"))},
        "sweeps": {"folder": str(folder_of("sweeps")), "names": list(shipped("sweeps"))},
        "units": str(units_folder()),
    }
    if as_json:
        print_json(found)
    else:
        _print(found, str(chosen))
    if fault is None:
        return 0
    note("the configuration is faulty")
    return 1


def _print(found: _Paths, configuration: str) -> None:
    fault = found["configuration"]["fault"]
    lines = [
        ("configuration", configuration),
        *([("its fault", str(fault))] if fault is not None else []),
        ("runtime directory", _place(found["runtime_directory"])),
        ("command socket", _place(found["command_socket"])),
        ("telemetry socket", _place(found["telemetry_socket"])),
        ("flight files", "not known" if found["flight_files"] is None else _place(found["flight_files"])),
    ]
    for name, key in _SHIPPED.items():
        shipped = found[key]
        names = shipped["names"]
        assert isinstance(names, list)
        lines.append((f"shipped {name}", f"{shipped['folder']}: {', '.join(names)}"))
    lines.append(("units", found["units"]))
    for name, text in lines:
        click.echo(f"{name:<17}  {text}")


def _place(path: str) -> str:
    return path if os.path.lexists(path) else f"{path} (not there now)"
