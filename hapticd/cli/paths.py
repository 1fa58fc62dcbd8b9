"""`hapticd paths`: where everything is."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

import click

from hapticd.cli.common import config_option, json_option, note, print_json

if TYPE_CHECKING:
    from hapticd.config.shipped_files import Folder


_SHIPPED: Final[tuple[Folder, ...]] = ("scenes", "operators", "materials", "experiments", "sweeps")


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
    configuration = {
        "origin": chosen.origin,
        "files": [os.path.abspath(file) for file in chosen.files],
        "looked_for": list(chosen.looked_for),
        "fault": fault,
    }
    places = {
        "runtime_directory": str(runtime.directory),
        "command_socket": str(runtime.command),
        "telemetry_socket": str(runtime.telemetry),
        "flight_files": flight,
    }
    ships = {folder: list(shipped(folder)) for folder in _SHIPPED}
    units = str(units_folder())
    if as_json:
        folders = {folder: {"folder": str(folder_of(folder)), "names": names} for folder, names in ships.items()}
        print_json({"configuration": configuration} | places | folders | {"units": units})
    else:
        lines = [("configuration", str(chosen))] + ([] if fault is None else [("its fault", fault)])
        lines += [(name.replace("_", " "), _place(path)) for name, path in places.items()]
        for folder, names in ships.items():
            word = "studies" if folder == "experiments" else folder
            lines.append((f"shipped {word}", f"{folder_of(folder)}: {', '.join(names)}"))
        for name, text in [*lines, ("units", units)]:
            click.echo(f"{name:<17}  {text}")
    if fault is None:
        return 0
    note("the configuration is faulty")
    return 1


def _place(path: str | None) -> str:
    if path is None:
        return "not known"
    return path if os.path.lexists(path) else f"{path} (not there now)"
