"""Commands for this machine: readiness, speed, paths, schemas, completion, the service of systemd."""

from __future__ import annotations

import importlib
import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Final, cast

import click
from click.shell_completion import ShellComplete, get_completion_class

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.cli.common import config_option, json_option, note, print_json, print_pairs, print_result, runtime_dir

if TYPE_CHECKING:
    from hapticd.config.shipped_files import Folder
    from hapticd.system.service_files import Action

_STATUS_TIMEOUT_S = 2.0
"""Longest wait of `hapticd doctor` for the status of the daemon, in s."""
_SHIPPED_FOLDERS: Final[tuple[Folder, ...]] = ("scenes", "operators", "materials", "experiments", "sweeps")
SOURCE_TREE = Path(__file__).resolve().parent.parent.parent
"""Root of the source tree, with the benchmarks, if hapticd is imported from a source tree."""
SCRIPT_PATH_BY_SHELL: Final = {
    "bash": "share/bash-completion/completions/hapticd",
    "zsh": "share/zsh/site-functions/_hapticd",
    "fish": "share/fish/vendor_completions.d/hapticd.fish",
}
"""Path of the completion script of each shell, below the prefix of an installation."""

_COMPLETION_CALL: Final = re.compile(r"(_complete \$1|_complete hapticd|\(commandline -t\) hapticd)(?=\))")
"""End of the call of hapticd in a completion script of click, up to the closing bracket of the substitution."""


@click.command("doctor", short_help="Check whether this machine is ready.")
@config_option
@click.option("--paths", is_flag=True, help="Print the paths of files, sockets and shipped scenes instead.")
@json_option
def doctor_command(configs: tuple[str, ...], paths: bool, as_json: bool) -> int:
    """Check whether this machine is ready for the daemon, with a remedy for each problem.

    The permissions are those of the user who runs the command. Nothing is changed. The command waits at most 5 s for
    systemd and 2 s for the daemon. The exit code is 1 if something that the configuration needs is missing.
    """
    if paths:
        return _print_paths(configs, as_json)
    from hapticd._version import __version__
    from hapticd.config.locations import choose
    from hapticd.doctor import diagnose
    from hapticd.doctor.machine import Machine, Needs
    from hapticd.doctor.service import configuration

    config, first = configuration(choose(configs))
    servo = config.servo
    device = config.device.hid if config.device.kind == "hid" else None
    needs = Needs(servo.realtime, servo.priority, servo.cpu, device)
    findings = []
    for finding in chain([first], diagnose(Machine(daemon=_status, version=__version__), needs)):
        findings.append(finding)
        if not as_json:
            click.echo(str(finding))
    if as_json:
        print_json([asdict(finding) for finding in findings])
    failed = [finding.name for finding in findings if finding.verdict == "fail"]
    if failed:
        note(f"not ready: {wording.listed(list(dict.fromkeys(failed)))}")
    return 1 if failed else 0


def _status() -> Mapping[str, object] | None:
    """Return the status of this user's daemon, else of the service's daemon, else None.

    Raises HapticdError if a daemon runs and does not answer.
    """
    from hapticd.client.blocking import connect
    from hapticd.doctor.machine import socket_holder
    from hapticd.protocol.calls import DaemonNotRunning
    from hapticd.system.paths import SYSTEM_DIRECTORY, daemon_paths, runtime_paths

    named = runtime_dir()
    for place in (named,) if named is not None else (daemon_paths().directory, SYSTEM_DIRECTORY):
        pid, is_stopped = socket_holder(runtime_paths(place).command) or (None, False)
        if is_stopped:
            raise HapticdError(f"process {pid}, which holds {place}, is stopped and does not answer")
        try:
            with connect(place, _STATUS_TIMEOUT_S) as client:
                return client.get_status()
        except DaemonNotRunning:
            if pid is not None:
                unanswered = f"did not answer within {_STATUS_TIMEOUT_S:g} s"
                raise HapticdError(f"process {pid}, which holds {place}, {unanswered}") from None
    return None


@click.command("paths", short_help="Print the paths of files and sockets.", hidden=True)
@config_option
@json_option
def paths_command(configs: tuple[str, ...], as_json: bool) -> int:
    """Print the paths of the configuration, the sockets, the flight files and the shipped files.

    Nothing is created, and no daemon is needed. The exit code is 1 if the configuration is faulty.
    """
    return _print_paths(configs, as_json)


def _print_paths(configs: tuple[str, ...], as_json: bool) -> int:
    from hapticd.config.configuration import chosen_config
    from hapticd.config.locations import choose
    from hapticd.config.shipped_files import folder_of, shipped, units_folder
    from hapticd.daemon.flight_recorder import directory_of
    from hapticd.system.paths import runtime_paths

    chosen, runtime = choose(configs), runtime_paths(runtime_dir())
    flight = fault = None
    try:
        flight = str(directory_of(chosen_config(chosen).flight.directory, runtime.directory))
    except HapticdError as error:
        fault = str(error)
    places = {
        "runtime_directory": str(runtime.directory),
        "command_socket": str(runtime.command),
        "telemetry_socket": str(runtime.telemetry),
        "flight_files": flight,
    }
    ships = {folder: (str(folder_of(folder)), list(shipped(folder))) for folder in _SHIPPED_FOLDERS}
    units = str(units_folder())
    if as_json:
        configuration = {
            "origin": chosen.origin,
            "files": [os.path.abspath(file) for file in chosen.files],
            "looked_for": list(chosen.missing),
            "fault": fault,
        }
        folders = {folder: {"folder": path, "names": names} for folder, (path, names) in ships.items()}
        print_json({"configuration": configuration} | places | folders | {"units": units})
    else:
        lines = [("configuration", str(chosen)), *([] if fault is None else [("its fault", fault)])]
        lines += [(name.replace("_", " "), _place(path)) for name, path in places.items()]
        for folder, (path, names) in ships.items():
            word = "studies" if folder == "experiments" else folder
            lines.append((f"shipped {word}", f"{path}: {', '.join(names)}"))
        print_pairs([*lines, ("units", units)])
    if fault is not None:
        note("the configuration is faulty")
    return 0 if fault is None else 1


def _place(path: str | None) -> str:
    if path is None:
        return "unknown"
    return path if os.path.lexists(path) else f"{path} (does not exist)"


@click.command("schema", short_help="Print a schema of the configuration or protocol.", hidden=True)
@click.option(
    "--protocol",
    type=click.Choice(["openrpc", "asyncapi"]),
    help="Print the protocol instead: its requests as OpenRPC, or telemetry and streams as AsyncAPI.",
)
def schema_command(protocol: str | None) -> None:
    """Print the JSON Schema of the configuration, or with --protocol a description of the protocol."""
    from hapticd.config.schema import config_schema
    from hapticd.daemon.described.documents import asyncapi_document, openrpc_document

    documents = {None: config_schema, "openrpc": openrpc_document, "asyncapi": asyncapi_document}
    click.echo(json.dumps(documents[protocol](), indent=2, ensure_ascii=False))


@click.command("install-service", short_help="Install the service of systemd.")
@click.option("--user", is_flag=True, help="Install for the current user only, without root.")
@click.option(
    "--dry-run", is_flag=True, help="Print the commands without running them; their files are adapted copies."
)
@click.option("--uninstall", is_flag=True, help="Remove the service; keep users and configuration.")
@click.option(
    "--root",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Install below DIR, as for a package, without changing the running system.",
)
def install_service_command(user: bool, dry_run: bool, uninstall: bool, root: Path | None) -> None:
    """Install the service of systemd: units, users, folders and udev rules. Each command is printed."""
    from hapticd.system.service_files import Installation, run

    if user and root is not None:
        raise click.UsageError("--root cannot be combined with --user")
    scope = "user" if user else "system"
    action = cast("Action", f"remove-{scope}" if uninstall else scope)
    for line in run(action, Installation.this(), root, dry_run):
        click.echo(line)
    if uninstall:
        note("configuration, users and /var/lib/hapticd are kept")
    elif root is None:
        note(f"to start the service: systemctl {'--user ' if user else ''}enable --now hapticd")


@click.command("stop-device", short_help="Stop the device of a killed daemon.", hidden=True)
@json_option
def stop_device_command(as_json: bool) -> None:
    """Set the force of a killed daemon's device to zero, and stop its effects.

    systemd runs this command whenever the daemon ends. It needs only the file of the daemon in the runtime directory.
    """
    from hapticd.hid.stopper import stop_device
    from hapticd.system.paths import runtime_paths

    done = stop_device(runtime_paths(runtime_dir()).device)
    print_result({"stopped": done}, as_json, done or "nothing to stop: no daemon has left a device")


def script(shell: str) -> str:
    """Return the completion script that click generates for a shell, with three corrections.

    Errors during a completion are not printed. In fish, help texts are not cut at their first comma. In zsh, a script
    that is loaded from fpath also works after the first completion.
    """
    from hapticd.cli import cli

    kind = get_completion_class(shell)
    assert kind is not None
    # source() of the subclass runs bash to check its version; the text does not depend on it.
    source = ShellComplete.source(kind(cli, {}, "hapticd", "_HAPTICD_COMPLETE"))
    source = _COMPLETION_CALL.sub(r"\1 2>/dev/null", source)
    source = source.replace("$zsh_eval_context[-1] == loadautofunc", "$funcstack[1] == _hapticd")
    return source.replace('string split ","', 'string split -m 1 ","')


@click.command("completion", short_help="Print the completion script of a shell.", hidden=True)
@click.argument("shell", type=click.Choice(list(SCRIPT_PATH_BY_SHELL)))
def completion_command(shell: str) -> None:
    """Print the script with which SHELL completes commands, options, files, scenes, materials and objects.

    For the current terminal:

    \b
    eval "$(hapticd completion bash)"
    eval "$(hapticd completion zsh)"           # after compinit
    hapticd completion fish | source

    For every new terminal, put the line into ~/.bashrc or ~/.zshrc; for fish:

    \b
    hapticd completion fish > ~/.config/fish/completions/hapticd.fish

    An installation into /usr or /usr/local puts the scripts where the shells find them.
    """
    click.echo(script(shell), nl=False)


def _bench() -> ModuleType:
    """Return the main module of the benchmarks. Raises HapticdError if benchmarks or a dependency are missing."""
    if not (SOURCE_TREE / "bench" / "report.py").is_file():
        raise HapticdError(
            "hapticd bench: not in a source tree; the benchmarks need one, after pip install -e '.[dev]'"
        )
    if str(SOURCE_TREE) not in sys.path:
        sys.path.insert(0, str(SOURCE_TREE))
    try:
        return importlib.import_module("bench.__main__")
    except ModuleNotFoundError as error:
        raise HapticdError(
            f"hapticd bench: {error.name} is not installed; pip install -e '.[dev]' in {SOURCE_TREE}"
        ) from None


@click.command("bench", short_help="Measure speed and accuracy on this machine.", hidden=True)
@click.argument("names", nargs=-1)
@click.option("--list", "list_names", is_flag=True, help="List the names of the benchmarks.")
@click.option("--quick", is_flag=True, help="Run for a minute or two; the figures are not precise.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder of the pages [default: docs of the source tree if everything is measured].",
)
@click.option("--overwrite", is_flag=True, help="Replace existing pages; a partial run replaces only its sections.")
def bench_command(names: tuple[str, ...], list_names: bool, quick: bool, out: Path | None, overwrite: bool) -> int:
    """Measure speed and accuracy on this machine: the benchmarks NAMES, or all of them.

    A run of all benchmarks prints its duration. The command works only in a source tree, which has the benchmarks.
    """
    bench = _bench()
    if list_names:
        click.echo(bench.listed())
        return 0
    if (wrong := bench.unknown(names)) is not None:
        raise click.UsageError(wrong)
    return int(bench.perform(names, bench.Options(quick=quick), out, overwrite))
