"""This machine: whether it is ready and how fast, where everything is, what editors and shells are told, and the
service of systemd."""

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

_ANSWER_S = 2.0
_SHIPPED: Final[tuple[Folder, ...]] = ("scenes", "operators", "materials", "experiments", "sweeps")
TREE = Path(__file__).resolve().parent.parent.parent
"""The source tree, where this is one."""
SHELLS: Final = {
    "bash": "share/bash-completion/completions/hapticd",
    "zsh": "share/zsh/site-functions/_hapticd",
    "fish": "share/fish/vendor_completions.d/hapticd.fish",
}
"""The shells, and where below a prefix each looks for the scripts of packages."""

# Where click's scripts ask hapticd: the end of that command, before the bracket that ends the substitution.
_QUESTION: Final = re.compile(r"(_complete \$1|_complete hapticd|\(commandline -t\) hapticd)(?=\))")


@click.command("doctor", short_help="Check whether this machine is ready.")
@config_option
@json_option
def doctor_command(configs: tuple[str, ...], as_json: bool) -> int:
    """Check whether this machine is ready for the daemon, and say what to do about each problem.

    The rights shown are those of the user who runs the command; nothing is changed. It waits at most 5 s
    for systemd and 2 s for a daemon that runs and does not answer. The exit code is 1
    if something fails that the configuration needs.
    """
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
    """The status of our own daemon, or else of the service's; None: there is none. Raises HapticdError for one that
    does not answer."""
    from hapticd.client.blocking import connect
    from hapticd.doctor.machine import socket_holder
    from hapticd.protocol.calls import DaemonNotRunning
    from hapticd.system.paths import SYSTEM_DIRECTORY, daemon_paths, runtime_paths

    named = runtime_dir()
    for place in (named,) if named is not None else (daemon_paths().directory, SYSTEM_DIRECTORY):
        pid, is_stopped = socket_holder(runtime_paths(place).command) or (None, False)
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


@click.command("paths", short_help="List the places of files and sockets.")
@config_option
@json_option
def paths_command(configs: tuple[str, ...], as_json: bool) -> int:
    """Say where the configuration, the sockets, the flight files and what ships with hapticd are.

    Nothing is made, and no daemon is asked. The exit code is 1 if the configuration is faulty.
    """
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
    ships = {folder: (str(folder_of(folder)), list(shipped(folder))) for folder in _SHIPPED}
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
        return "not known"
    return path if os.path.lexists(path) else f"{path} (not there now)"


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


@click.command("install-service", short_help="Put the service of systemd in place.")
@click.option("--user", is_flag=True, help="For yourself alone, without rights of the system's.")
@click.option("--dry-run", is_flag=True, help="Print the commands, and run none.")
@click.option("--uninstall", is_flag=True, help="Remove it again; users and configuration stay.")
@click.option(
    "--root",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Write below DIR, as for a package; the running system is not touched.",
)
def install_service_command(user: bool, dry_run: bool, uninstall: bool, root: Path | None) -> None:
    """Install units, users, folders and udev rules, and print each command."""
    from hapticd.system.service_files import Installation, run

    if user and root is not None:
        raise click.UsageError("--root is for the system's service, not for --user")
    scope = "user" if user else "system"
    action = cast("Action", f"remove-{scope}" if uninstall else scope)
    for line in run(action, Installation.this(), root, dry_run):
        click.echo(line)
    if uninstall:
        note("configuration, users and /var/lib/hapticd are left as they are")
    elif root is None:
        note(f"start it: systemctl {'--user ' if user else ''}enable --now hapticd")


@click.command("stop-device", short_help="Stop a device that a daemon left.")
@json_option
def stop_device_command(as_json: bool) -> None:
    """Tell the device of a daemon that was killed that its force is zero, and stop its effects.

    systemd runs it whatever ended the daemon. It needs nothing but what the daemon wrote into its runtime directory.
    """
    from hapticd.hid.stopper import stop_device
    from hapticd.system.paths import runtime_paths

    done = stop_device(runtime_paths(runtime_dir()).device)
    print_result({"stopped": done}, as_json, done or "no device was left: nothing to stop")


def script(shell: str) -> str:
    """click's script for a shell, with three things mended: what goes wrong while a key is pressed is kept from the
    terminal, fish shows help texts beyond their first comma, and zsh, where it loads the script from its fpath, does
    not lose the second key."""
    from hapticd.cli import cli

    kind = get_completion_class(shell)
    assert kind is not None
    # The class's own source() asks the bash that is installed for its version; the text is the same for all.
    source = ShellComplete.source(kind(cli, {}, "hapticd", "_HAPTICD_COMPLETE"))
    source = _QUESTION.sub(r"\1 2>/dev/null", source)
    source = source.replace("$zsh_eval_context[-1] == loadautofunc", "$funcstack[1] == _hapticd")
    return source.replace('string split ","', 'string split -m 1 ","')


@click.command("completion", short_help="Print the completion script of a shell.")
@click.argument("shell", type=click.Choice(list(SHELLS)))
def completion_command(shell: str) -> None:
    """Print the script by which SHELL completes commands, options, files, scenes, materials and objects.

    For the terminal that is open:

    \b
    eval "$(hapticd completion bash)"
    eval "$(hapticd completion zsh)"           # after compinit
    hapticd completion fish | source

    For every new one, the same line in ~/.bashrc or ~/.zshrc; for fish:

    \b
    hapticd completion fish > ~/.config/fish/completions/hapticd.fish

    An installation into /usr or /usr/local brings the scripts with it, where the shells look for them.
    """
    click.echo(script(shell), nl=False)


def _bench() -> ModuleType:
    """The benchmarks' main module. Raises HapticdError where they are not, or what they need is not."""
    if not (TREE / "bench" / "report.py").is_file():
        raise HapticdError(
            "the benchmarks are not installed with hapticd: run this in a source tree, after pip install -e '.[dev]'"
        )
    if str(TREE) not in sys.path:
        sys.path.insert(0, str(TREE))
    try:
        return importlib.import_module("bench.__main__")
    except ModuleNotFoundError as error:
        raise HapticdError(
            f"the benchmarks need {error.name}, which is not installed: pip install -e '.[dev]' in {TREE}"
        ) from None


@click.command("bench", short_help="Measure speed and error on this machine.")
@click.argument("names", nargs=-1)
@click.option("--list", "list_names", is_flag=True, help="Say what can be measured, and stop.")
@click.option("--quick", is_flag=True, help="A minute or two: shows that it runs, not how fast.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Where the pages go [default: docs of the source tree, of a whole run].",
)
@click.option("--overwrite", is_flag=True, help="Replace the pages that are there; of a part, its sections of them.")
def bench_command(names: tuple[str, ...], list_names: bool, quick: bool, out: Path | None, overwrite: bool) -> int:
    """Measure NAMES, or everything: what each part costs, or how wrong it is.

    A whole run says at its end how long it took. Works in a source tree, where the benchmarks are.
    """
    bench = _bench()
    if list_names:
        click.echo(bench.listed())
        return 0
    if (wrong := bench.unknown(names)) is not None:
        raise click.UsageError(wrong)
    return int(bench.perform(names, bench.Options(quick=quick), out, overwrite))
