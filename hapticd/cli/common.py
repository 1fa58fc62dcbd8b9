"""Options that commands share, the client of the daemon, and the printing of results as text or JSON."""

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

_SECONDS_BY_UNIT = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


class Finite(click.FloatRange):
    """A range of finite numbers. click.FloatRange accepts NaN and infinity."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number that `value` contains; fail if the number is not finite or out of range."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number


# ---- Options ---------------------------------------------------------------------------------------------------------


def configs_option(help: str) -> Callable[[_F], _F]:
    """Return the option `-c`: configuration files in their order, as the parameter `configs`."""
    return click.option(
        "-c", "--config", "configs", multiple=True, metavar="FILE", shell_complete=names.scenes, help=help
    )


config_option = configs_option(
    "Configuration, scene or name of a shipped scene; later files override earlier ones  [env var: HAPTICD_CONFIG; "
    "default: ~/.config/hapticd/config.yaml, else /etc/hapticd/config.yaml, else the simulated joystick]"
)
rate_option = click.option(
    "--rate",
    "rate_hz",
    type=Finite(min=0, min_open=True),
    metavar="HZ",
    help="Ticks per second [default: the configuration's].",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace existing files.")


def options(*decorators: Callable[[Any], Any]) -> Callable[[_F], _F]:
    """Combine several options into one decorator; `--help` lists the options in the order of the arguments."""

    def decorated(command: _F) -> _F:
        for decorator in reversed(decorators):
            command = decorator(command)
        return command

    return decorated


log_options = options(
    click.option("-q", "--quiet", "log_level", flag_value="warning", help="Log only warnings and errors."),
    click.option("-v", "--verbose", "log_level", flag_value="debug", help="Log each request and event as well."),
    click.option(
        "--log-level",
        type=click.Choice(LOG_LEVELS),
        default="info",
        show_default=True,
        help="Lowest level that is logged; the last of -q, -v and --log-level wins.",
    ),
)
"""Log options of a command that runs until it is stopped, as the parameter `log_level`."""


def output_option(help: str, metavar: str = "FILE", **more: Any) -> Callable[[_F], _F]:
    """Return the option `-o`: a file, as the parameter `output`."""
    return click.option("-o", "--output", type=click.Path(), metavar=metavar, help=help, **more)


def results_option(default: str) -> Callable[[_F], _F]:
    """Return the option `-o`: a folder of results, as the parameter `output`. `default` describes its default."""
    return click.option(
        "-o",
        "--output",
        type=click.Path(file_okay=False, path_type=Path),
        metavar="DIR",
        help=f"Folder of the results [default: {default}].",
    )


def for_option(shown: str, default: str | None = None) -> Callable[[_F], _F]:
    """Return the option `--for`: a duration, as the parameter `duration_s`. `--help` shows the default as `shown`."""
    help = f"Duration, as 5s, 500ms or 2min [default: {shown}]."
    return click.option("--for", "duration_s", type=duration, metavar="TIME", default=default, help=help)


def duration(text: str) -> float:
    """Convert a text such as 500ms, 5s or 2min to seconds; a number without a unit is in seconds."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(ms|s|min|h)?", text.strip())
    seconds = float(match[1]) * _SECONDS_BY_UNIT[match[2] or "s"] if match else 0.0
    if not seconds > 0:
        raise click.BadParameter(f"{text!r} is not a duration such as 5s, 500ms or 2min")
    return seconds


def _key_and_value(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise click.BadParameter(f"{text!r} is not of the form KEY=VALUE")
    return key.strip(), value


def _notes(ctx: click.Context, param: click.Parameter, pairs: tuple[tuple[str, str], ...]) -> dict[str, str]:
    notes = dict(pairs)
    if len(notes) < len(pairs):
        raise click.BadParameter("duplicate key")
    return notes


notes_option = click.option(
    "--note",
    "notes",
    type=_key_and_value,
    multiple=True,
    metavar="KEY=VALUE",
    callback=_notes,
    help="Note for the recording; may be repeated.",
)
"""Notes of a recording, as the parameter `notes`: a dictionary."""


# ---- The daemon ------------------------------------------------------------------------------------------------------


def runtime_dir() -> str | None:
    """Return the value of `--runtime-dir`."""
    return cast("str | None", click.get_current_context().find_root().obj)


def daemon(timeout_s: float | None = None) -> Client:
    """Return a client of the daemon at `--runtime-dir`. Raises DaemonNotRunning if no daemon runs there."""
    from hapticd.client.blocking import connect
    from hapticd.protocol.calls import REPLY_TIMEOUT_S

    return connect(runtime_dir(), REPLY_TIMEOUT_S if timeout_s is None else timeout_s)


class Stop(threading.Event):
    """Event that is set when a long-running command has to end."""

    signal: int | None = None
    """The first signal that arrived, SIGINT or SIGTERM; None without a signal."""

    def exit_code(self, duration_s: float | None) -> int:
        """Return 128 + `signal` if a signal ended a command with a duration, otherwise 0."""
        return 0 if self.signal is None or duration_s is None else 128 + self.signal


@contextmanager
def stopped_by_signals() -> Iterator[Stop]:
    """Yield a Stop, an event that Ctrl-C and SIGTERM set instead of interrupting the command."""
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


# ---- Output ----------------------------------------------------------------------------------------------------------


def print_json(value: object) -> None:
    """Print a value as one line of JSON."""
    click.echo(json.dumps(value, ensure_ascii=False))


def note(text: str) -> None:
    """Print a line to stderr, since stdout is for the result.

    With --json nothing is printed: the result has the same information, and stderr is for the JSON of an error.
    """
    ctx = click.get_current_context(silent=True)
    if ctx is not None and ctx.params.get("as_json"):
        return
    _show("")
    click.echo(f"hapticd: {text}", err=True)


def note_if_forces_are_off(client: Client) -> None:
    """Print a note if the daemon exerts no force on the hand of the simulated joystick, which moves."""
    if client.get_status()["forces"] != "on":
        note("forces are off: no force acts on the moving hand; `hapticd status` gives the reason")


def print_result(result: object, as_json: bool, text: str) -> None:
    """Print a command's result as JSON with its warnings; without --json print `text`, and the warnings to stderr."""
    if as_json:
        print_json(result)
        return
    click.echo(text)
    if isinstance(result, Mapping):
        warnings = [f"{warned['where']}: {warned['problem']}" for warned in result.get("warnings", ())]
        for warning in filter(None, (result.get("warning"), *warnings)):
            note(f"warning: {warning}")


def print_pairs(pairs: Iterable[tuple[str, str]]) -> None:
    """Print names and descriptions in two columns."""
    listed = list(pairs)
    width = max(len(name) for name, _ in listed)
    for name, text in listed:
        click.echo(f"{name:<{width}}  {text}")


def print_shipped(folder: Folder, as_json: bool) -> None:
    """Print the names of the studies in a shipped folder, each with its research question."""
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
    wrapped: str | None = None,
    stderr: bool = False,
    width: int | None = None,
) -> None:
    """Print a table of at most `width` characters, by default the width of the terminal.

    A column whose name begins with > has numbers, aligned to the right. If the table is too wide, only the cells of the
    column `wrapped` are wrapped.
    """
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
            table.add_column(name, overflow="fold", no_wrap=column != wrapped)
    for row in cells:
        table.add_row(*map(Text, row))
    Console(stderr=stderr, width=width, soft_wrap=True).print(table)


@contextmanager
def status_line() -> Iterator[Callable[[str], None]]:
    """Yield a function that shows a status line if stderr is a terminal; an empty text and the end erase the line."""
    try:
        yield _show
    finally:
        _show("")


_line_shown = False


def _show(text: str) -> None:
    global _line_shown
    if (text or _line_shown) and sys.stderr is not None and sys.stderr.isatty():
        import shutil  # imported here, since it loads three compression modules

        width = shutil.get_terminal_size().columns - 1
        click.echo(f"\r\x1b[K{text[:width]}", nl=False, err=True)
        _line_shown = bool(text)
