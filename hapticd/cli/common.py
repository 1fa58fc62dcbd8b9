"""What the commands share: options, finding the daemon, and printing results for people or for programs."""

from __future__ import annotations

import json
import math
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from hapticd.cli import names
from hapticd.system.journal import LOG_LEVELS

if TYPE_CHECKING:
    from hapticd.client.blocking import Client
    from hapticd.config.shipped_files import Folder

_F = TypeVar("_F", bound=Callable[..., Any])

_UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


class Finite(click.FloatRange):
    """A range of numbers without not-a-number and infinity, which click's own takes."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number


# ---- Options ---------------------------------------------------------------------------------------------------------


def configs_option(help: str) -> Callable[[_F], _F]:
    """The option `-c`, as the parameter `configs`: files, in their order."""
    return click.option(
        "-c", "--config", "configs", multiple=True, metavar="FILE", shell_complete=names.scenes, help=help
    )


config_option = configs_option(
    "Configuration, a scene, or the name of a shipped scene; later files override earlier ones  [env var: "
    "HAPTICD_CONFIG; default: ~/.config/hapticd/config.yaml, /etc/hapticd/config.yaml or, without these, the "
    "simulated joystick]"
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON, for programs.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace files that are there.")


def options(*decorators: Callable[[Any], Any]) -> Callable[[_F], _F]:
    """Several options as one decorator; `--help` lists them in this order."""

    def decorated(command: _F) -> _F:
        for decorator in reversed(decorators):
            command = decorator(command)
        return command

    return decorated


log_options = options(
    click.option("-q", "--quiet", "log_level", flag_value="warning", help="Log only warnings and errors."),
    click.option("-v", "--verbose", "log_level", flag_value="debug", help="Log each request and each event, too."),
    click.option(
        "--log-level",
        type=click.Choice(LOG_LEVELS),
        default="info",
        show_default=True,
        help="The least important line of the log; of several of these options the last one holds.",
    ),
)
"""How much stands in the log of a command that runs until it is ended, as the parameter `log_level`."""


def output_option(help: str, metavar: str = "FILE", **more: Any) -> Callable[[_F], _F]:
    """The option `-o`, as the parameter `output`: a file."""
    return click.option("-o", "--output", type=click.Path(), metavar=metavar, help=help, **more)


def results_option(default: str) -> Callable[[_F], _F]:
    """The option `-o`, as the parameter `output`: the folder of a command's results; `default` says which without."""
    return click.option(
        "-o",
        "--output",
        type=click.Path(file_okay=False, path_type=Path),
        metavar="DIR",
        help=f"Folder of the results [default: {default}].",
    )


def for_option(shown: str, default: str | None = None) -> Callable[[_F], _F]:
    """The option `--for`, as the parameter `duration_s`; `shown` says how long it is without."""
    told = f"How long: 5s, 500ms, 2min [default: {shown}]."
    return click.option("--for", "duration_s", type=duration, metavar="TIME", default=default, help=told)


def duration(text: str) -> float:
    """The seconds of a time such as 500ms, 5s or 2min; a bare number is seconds."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(ms|s|min|h)?", text.strip())
    seconds = float(match[1]) * _UNITS[match[2] or "s"] if match else 0.0
    if not seconds > 0:
        raise click.BadParameter(f"{text!r} is not a time such as 5s, 500ms or 2min")
    return seconds


def _key_and_value(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise click.BadParameter(f"{text!r} is not of the form KEY=VALUE")
    return key.strip(), value


def _notes(ctx: click.Context, param: click.Parameter, pairs: tuple[tuple[str, str], ...]) -> dict[str, str]:
    notes = dict(pairs)
    if len(notes) < len(pairs):
        raise click.BadParameter("a key is given twice")
    return notes


notes_option = click.option(
    "--note",
    "notes",
    type=_key_and_value,
    multiple=True,
    metavar="KEY=VALUE",
    callback=_notes,
    help="Keep a note in the recording; may be given several times.",
)
"""The notes as a dictionary."""


# ---- The daemon ------------------------------------------------------------------------------------------------------


def runtime_dir() -> str | None:
    """What `--runtime-dir` names."""
    return cast("str | None", click.get_current_context().find_root().obj)


def daemon(timeout_s: float | None = None) -> Client:
    """A client of the daemon that the command line names; raises DaemonNotRunning where there is none."""
    from hapticd.client.blocking import connect
    from hapticd.protocol.calls import TIMEOUT_S

    return connect(runtime_dir(), TIMEOUT_S if timeout_s is None else timeout_s)


class Stop(threading.Event):
    """Set once a command that runs for a while is to end."""

    signal: int | None = None
    """SIGINT or SIGTERM, if one of them has set it; the first that came."""

    def exit_code(self, duration_s: float | None) -> int:
        """0 where the time is over, or there was none and a signal ended it."""
        return 0 if self.signal is None or duration_s is None else 128 + self.signal


@contextmanager
def stopped_by_signals() -> Iterator[Stop]:
    """Meanwhile Ctrl-C and SIGTERM set the Stop that is given, and interrupt nothing."""
    stop = Stop()

    def end(number: int, frame: object) -> None:
        stop.signal = stop.signal or number
        stop.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# ---- What is printed -------------------------------------------------------------------------------------------------


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
    _show("")
    click.echo(f"hapticd: {text}", err=True)


def print_result(result: object, as_json: bool, text: str) -> None:
    """The result as JSON, which holds its warnings, or `text`, and the warnings on stderr."""
    if as_json:
        print_json(result)
        return
    click.echo(text)
    if isinstance(result, Mapping):
        warnings = [f"{warned['where']}: {warned['problem']}" for warned in result.get("warnings", ())]
        for warning in filter(None, (result.get("warning"), *warnings)):
            note(f"warning: {warning}")


def print_pairs(pairs: Iterable[tuple[str, str]]) -> None:
    """Names and what is said of them, below one another."""
    listed = list(pairs)
    width = max(len(name) for name, _ in listed)
    for name, text in listed:
        click.echo(f"{name:<{width}}  {text}")


def print_shipped(folder: Folder, as_json: bool) -> None:
    """The studies of a folder that ships, by name, each with the question that it asks."""
    from hapticd.config.shipped_files import described

    studies = described(folder)
    if as_json:
        print_json([{"name": each.name, "asks": each.shows, "file": each.file} for each in studies])
    else:
        print_pairs((each.name, each.shows) for each in studies)


def print_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    title: str | None = None,
    *,
    broken: str | None = None,
    stderr: bool = False,
    width: int | None = None,
) -> None:
    """A table for people, of `width` characters at most [default: as the terminal]. A name that begins with > stands
    above a column of numbers; the column `broken` alone gives way where there is too little room."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left", box=box.SIMPLE, show_edge=False, padding=(0, 1, 0, 0))
    cells = list(rows)
    for place, column in enumerate(columns):
        name = Text(column.removeprefix(">"))
        if column.startswith(">"):
            widest = max((len(row[place]) for row in cells), default=1)
            table.add_column(name, justify="right", min_width=widest)
        else:
            table.add_column(name, overflow="fold", no_wrap=column != broken)
    for row in cells:
        table.add_row(*map(Text, row))
    Console(stderr=stderr, width=width, soft_wrap=True).print(table)


@contextmanager
def doing() -> Iterator[Callable[[str], None]]:
    """Shows what is being done in one line of the terminal, if stderr is one; it is gone afterwards, and where the text
    is empty."""
    try:
        yield _show
    finally:
        _show("")


_line_shown = False


def _show(text: str) -> None:
    global _line_shown
    if (text or _line_shown) and sys.stderr is not None and sys.stderr.isatty():
        import shutil  # which loads three compressions

        width = shutil.get_terminal_size().columns - 1
        click.echo(f"\r\x1b[K{text[:width]}", nl=False, err=True)
        _line_shown = bool(text)
