"""The command line. Each command stands in a module that is loaded when it is used.

A command ends with exit code 0, or with another and one line on stderr (see `failure`): 1 for what was asked but could
not be done (output that nobody takes among it), 2 for a command that was not understood, 130 (and no line) for Ctrl-C.

`_HOMES` says in which file a command stands. Beside the commands:

    common      options that commands share, finding the daemon, printing results
    engine      options and progress of commands that compute many pieces on dask
    failure     what a command that fails prints
    listening   options of what serves pages: where it listens, a browser, a daemon of its own
    names       what a shell completes where a command takes a name
    streams     standard output and error that cannot be written
    synthesize  `hapticd fit synthesize`, which fit takes in
    experiment_analyze  `hapticd experiment analyze`, which experiment takes in
    experiment_run      `hapticd experiment run` and `resume`, which experiment takes in
    sweep_show          `hapticd sweep show`, which sweep takes in
    experiment_bulk     many simulated participants side by side, for `hapticd experiment run`
    experiment_pages    the options of the pages of a session, and where its daemon is

Questions, and where to begin:

    How is a command found, and how does it end?
        get_command and _run below.
    How does a command reach the daemon?
        common (daemon), which makes a client of hapticd.client.
    Where do --json and exit codes come from?
        common (print_result) and failure (tell).
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from itertools import takewhile
from typing import Final

import click

from hapticd._version import __version__
from hapticd.base.errors import HapticdError
from hapticd.cli.failure import tell
from hapticd.cli.streams import guarded

_COMMANDS_BY_MODULE: Final = (
    ("daemon", "run status reload scene material apply play force reset operator mark"),
    ("recordings", "watch record recover export flight replay simulate"),
    ("displayed", "check"),
    ("machine", "paths schema"),
    ("devices", "devices"),
    ("machine", "bench"),
    ("displayed", "calibrate verify"),
    ("fit", "fit"),
    ("experiment", "experiment"),
    ("sweep", "sweep"),
    ("recordings", "lsl"),
    ("web", "web"),
    ("machine", "doctor install-service stop-device completion"),
)
"""The modules and the commands in them, in the order in which a person meets these."""
_HOMES: Final = {name: module for module, names in _COMMANDS_BY_MODULE for name in names.split()}


class _LazyGroup(click.Group):
    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            # Ended for click in the ordinary way, since it would print something for an interrupt.
            raise click.exceptions.Exit(130) from None
        except BrokenPipeError as error:
            # For which click would end us without a word.
            raise HapticdError(str(error.strerror)) from None

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_HOMES)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.NoSuchCommand as error:
            # Click compares with the commands that are loaded, of which there are none.
            raise click.NoSuchCommand(error.command_name, possibilities=_HOMES, ctx=ctx) from None

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _HOMES:
            return None
        module = importlib.import_module(f"hapticd.cli.{_HOMES[cmd_name]}")
        command = getattr(module, f"{cmd_name.replace('-', '_')}_command")
        assert isinstance(command, click.Command)
        return command


_ENVIRONMENT: Final = """\b
Environment:
  HAPTICD_CONFIG       Configuration files where no -c is given; several are separated by colons.
  HAPTICD_RUNTIME_DIR  Where the sockets are, as --runtime-dir.
"""


@click.group(
    cls=_LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=_ENVIRONMENT,
)
@click.version_option(__version__, "-V", "--version", message="hapticd %(version)s")
@click.option(
    "--runtime-dir",
    type=click.Path(file_okay=False, readable=False),
    metavar="DIR",
    help="Where the sockets are  [env var: HAPTICD_RUNTIME_DIR; default: $RUNTIME_DIRECTORY, $XDG_RUNTIME_DIR/hapticd "
    "or /tmp/hapticd-UID]",
)
@click.pass_context
def cli(ctx: click.Context, runtime_dir: str | None) -> None:
    """A haptic daemon: taps, combs, sandpaper, friction, solids and membranes on a joystick, commanded over ZeroMQ."""
    ctx.obj = runtime_dir
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    # Before numpy is loaded: its BLAS would start a thread for each processor, and no command needs that.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with guarded() as line_lost:
        code = _run(arguments)
    return code or int(line_lost())


def _run(arguments: Sequence[str] | None) -> int:
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        result = cli.main(given, prog_name="hapticd", standalone_mode=False)
        if sys.stdout is not None:  # closed by whoever started us
            sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except (KeyboardInterrupt, click.Abort):
        return 130
    except (HapticdError, click.ClickException, MemoryError, OSError, RuntimeError) as error:
        # Also of a line that is not understood; behind -- stand arguments alone.
        return tell(error, as_json="--json" in takewhile("--".__ne__, given))
