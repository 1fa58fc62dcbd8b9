"""What the commands share: finding the daemon, and printing results for people or for programs."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from hapticd.base.errors import known_names, quoted
from hapticd.cli import names
from hapticd.system.journal import LEVELS

if TYPE_CHECKING:
    from hapticd.client.blocking import Client
    from hapticd.config.shipped_files import Folder

_F = TypeVar("_F", bound=Callable[..., Any])

_UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


class Choice(click.Choice[str]):
    """click's, which asks whether one of them was meant."""

    def get_invalid_choice_message(self, value: object, ctx: click.Context | None) -> str:
        return f"{quoted(str(value))} is none of them; {known_names(str(value), map(str, self.choices))}"


class Finite(click.FloatRange):
    """A range of numbers of which not-a-number and infinity are none: click's own takes the first for one of them."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            float(value)
        except ValueError:
            self.fail(f"{quoted(str(value))} is not a number", param, ctx)
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number

    def _describe_range(self) -> str:
        # Of a range without ends click's help says x<=None.
        return "" if self.min is None and self.max is None else super()._describe_range()


def daemon(ctx: click.Context, timeout_s: float | None = None) -> Client:
    """A client of the daemon that the command line names; raises DaemonNotRunning where there is none."""
    from hapticd.client.blocking import connect
    from hapticd.protocol.calls import TIMEOUT_S

    return connect(ctx.find_root().obj, TIMEOUT_S if timeout_s is None else timeout_s)


def config_option(command: _F) -> _F:
    """The option `-c`, for the configuration files of a command."""
    return click.option(
        "-c",
        "--config",
        "configs",
        multiple=True,
        metavar="FILE",
        shell_complete=names.scenes,
        help="Configuration, a scene, or the name of a shipped scene; later files override earlier ones  [env var: "
        "HAPTICD_CONFIG; default: ~/.config/hapticd/config.yaml, /etc/hapticd/config.yaml or, without these, the "
        "simulated joystick]",
    )(command)


def json_option(command: _F) -> _F:
    """The option `--json`."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON, for programs.")(command)


def log_options(command: _F) -> _F:
    """The options of what runs until it is ended: how much stands in its log, as the parameter `log_level`."""

    @click.option("-q", "--quiet", is_flag=True, help="Log only warnings and errors.")
    @click.option("-v", "--verbose", is_flag=True, help="Log each request and each event, too.")
    @click.option("--log-level", type=Choice(LEVELS), help="The least important line of the log [default: info].")
    @functools.wraps(command)
    def with_level(*args: Any, quiet: bool, verbose: bool, log_level: str | None, **options: Any) -> Any:
        if quiet + verbose + (log_level is not None) > 1:
            raise click.UsageError("-q, -v and --log-level say the same: give one")
        level = log_level or ("warning" if quiet else "debug" if verbose else "info")
        return command(*args, log_level=level, **options)

    return cast(_F, with_level)


def change_options(command: _F) -> _F:
    """The options of commands that change scene or materials, `--json` among them."""
    command = click.option(
        "--expect-revision",
        type=click.IntRange(min=0),
        metavar="N",
        help="Change nothing unless the scene is at revision N.",
    )(json_option(command))
    return click.option("--wait", is_flag=True, help="Wait until it is in force, and print the tick.")(command)


def yaml_file(name: str) -> str:
    """The path of a file that a command reads; `-` is the standard input."""
    return "/dev/stdin" if name == "-" else name


def print_json(value: object) -> None:
    """One line of JSON."""
    click.echo(json.dumps(value, ensure_ascii=False))


def note(text: str) -> None:
    """A line for people beside the result: on stderr, since stdout is the result's.

    With --json it is left out: the result says the same, and stderr holds nothing but the object of an error.
    """
    ctx = click.get_current_context(silent=True)
    if ctx is not None and ctx.params.get("as_json"):
        return
    click.echo(f"hapticd: {text}", err=True)


def print_result(result: Mapping[str, object], as_json: bool, text: str) -> None:
    """The result as JSON, which holds its warnings, or `text`, and the warnings on stderr."""
    if as_json:
        print_json(result)
        return
    click.echo(text)
    if "warning" in result:
        note(f"warning: {result['warning']}")
    for warned in cast("list[Mapping[str, str]]", result.get("warnings", [])):
        note(f"warning: {warned['where']}: {warned['problem']}")


def print_shipped(folder: Folder, as_json: bool) -> None:
    """The studies of a folder that ships, by name, each with the question that it asks."""
    from hapticd.config.shipped_files import described

    studies = described(folder)
    if as_json:
        print_json([{"name": each.name, "asks": each.shows, "file": each.file} for each in studies])
        return
    width = max(len(each.name) for each in studies)
    for each in studies:
        click.echo(f"{each.name:<{width}}  {each.shows}")


def results_option(default: str) -> Callable[[_F], _F]:
    """The option `-o`, as the parameter `output`: the folder of a command's results; `default` says which without."""
    return click.option(
        "-o",
        "--output",
        type=click.Path(file_okay=False, path_type=Path),
        metavar="DIR",
        help=f"Folder of the results [default: {default}].",
    )


def overwrite_option(command: _F) -> _F:
    """The option `--overwrite`."""
    return click.option("--overwrite", is_flag=True, help="Replace files that are there.")(command)


def notes_option(command: _F) -> _F:
    """The option `--note`: the notes as a dictionary."""
    return click.option(
        "--note",
        "notes",
        multiple=True,
        metavar="KEY=VALUE",
        callback=_notes,
        help="Keep a note in the recording; may be given several times.",
    )(command)


def _notes(ctx: click.Context, param: click.Parameter, given: tuple[str, ...]) -> dict[str, str]:
    notes: dict[str, str] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise click.BadParameter(f"{text!r} is not of the form KEY=VALUE", ctx, param)
        if key.strip() in notes:
            raise click.BadParameter(f"{key.strip()!r} is given twice", ctx, param)
        notes[key.strip()] = value
    return notes


def changed(result: Mapping[str, object]) -> str:
    """What a change of the scene did, in words."""
    tick = f", in force from tick {result['tick']:,} on" if "tick" in result else ""
    return f"revision {result['revision']:,}{tick}"


def change(
    ctx: click.Context,
    as_json: bool,
    send: Callable[[Client], Mapping[str, object]],
    timeout_s: float | None = None,
) -> None:
    """Has the daemon change scene or materials, and prints what it answers."""
    with daemon(ctx, timeout_s) as client:
        result = send(client)
    print_result(result, as_json, changed(result))


def for_option(default: str) -> Callable[[_F], _F]:
    """The option `--for`, as the parameter `duration_s`; `default` says how long it is without."""
    told = f"How long: 5s, 500ms, 2min [default: {default}]."
    return click.option("--for", "duration_s", metavar="TIME", callback=duration, help=told)


def duration(ctx: click.Context, param: click.Parameter, text: str | None) -> float | None:
    """The seconds of an option such as 500ms, 5s or 2min; a bare number is seconds."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(ms|s|min|h)?", text.strip())
    seconds = float(match[1]) * _UNITS[match[2] or "s"] if match else 0.0
    if not seconds > 0:
        raise click.BadParameter(f"{text!r} is not a time such as 5s, 500ms or 2min", ctx, param)
    return seconds
