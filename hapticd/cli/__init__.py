"""The command line. The module of a command is imported when the command is used.

Exit codes: 0 for success; 1 if the command failed or its output cannot be written; 2 for a usage error; 130 for
Ctrl-C; 141 if nobody reads the output any more. With 1 and 2 one line on stderr states the error (see `failure`).

`_MODULE_BY_COMMAND` maps each command to its file. The other files:

    common              options that commands share, the client of the daemon, printing of results
    engine              options and progress of commands that compute many points, fits or sessions on dask
    failure             how a failed command reports its error
    listening           options of commands that serve pages: address, port, TLS, browser, demo
    names               completion of names in a shell
    streams             one-line errors for failed writes to standard output
    synthesize          `hapticd fit synthesize`
    experiment_analyze  `hapticd experiment analyze`
    experiment_run      `hapticd experiment run` and `resume`
    experiment_bulk     `hapticd experiment run --count`: many simulated participants in parallel
    experiment_pages    the pages and the daemon of a session
    sweep_show          `hapticd sweep show`

Questions, and where to begin:

    How is a command found, and how does it end?
        get_command and _run below.
    How does a command reach the daemon?
        common (daemon), which returns a client of hapticd.client.
    Where do --json and exit codes come from?
        common (print_result) and failure (report_error).
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from collections.abc import Sequence
from itertools import takewhile
from typing import Final

import click

from hapticd._version import __version__
from hapticd.base.errors import HapticdError
from hapticd.cli.failure import report_error
from hapticd.cli.streams import ReaderGone, guarded

_COMMANDS_BY_SECTION: Final = {
    "Daemon": {"daemon": "run status reload force reset"},
    "Scene": {"daemon": "apply scene material play operator mark"},
    "Observe and record": {"recordings": "watch record export lsl", "web": "web"},
    "Offline": {"recordings": "simulate replay", "displayed": "check", "fit": "fit"},
    "Studies": {"experiment": "experiment", "sweep": "sweep"},
    "Device": {"devices": "devices", "displayed": "calibrate verify"},
    "Machine": {"machine": "doctor install-service bench completion paths schema stop-device"},
}
"""Commands by module and section, as `hapticd --help` lists them, without those that are hidden."""
_MODULE_BY_COMMAND: Final = {
    name: module
    for modules in _COMMANDS_BY_SECTION.values()
    for module, names in modules.items()
    for name in names.split()
}
_FORMER_COMMANDS: Final = {"flight": "`hapticd record --past FILE`", "recover": "`hapticd record --recover FILE`"}


class _LazyGroup(click.Group):
    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            # Converted to an ordinary exit, since click prints an empty line for an interrupt.
            raise click.exceptions.Exit(130) from None
        except BrokenPipeError as error:
            # Click would exit without a message.
            raise HapticdError(str(error.strerror)) from None

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_MODULE_BY_COMMAND)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        width = formatter.width - 6 - max(map(len, _MODULE_BY_COMMAND))
        for section, modules in _COMMANDS_BY_SECTION.items():
            listed = [(name, self.get_command(ctx, name)) for name in " ".join(modules.values()).split()]
            rows = [(name, found.get_short_help_str(width)) for name, found in listed if found and not found.hidden]
            with formatter.section(section):
                formatter.write_dl(rows)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.NoSuchCommand as error:
            if (now := _FORMER_COMMANDS.get(error.command_name)) is not None:
                raise click.UsageError(f"No such command '{error.command_name}': it is now {now}", ctx) from None
            # Click suggests only loaded commands, and here no command is loaded.
            raise click.NoSuchCommand(error.command_name, possibilities=_MODULE_BY_COMMAND, ctx=ctx) from None

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _MODULE_BY_COMMAND:
            return None
        module = importlib.import_module(f"hapticd.cli.{_MODULE_BY_COMMAND[cmd_name]}")
        command = getattr(module, f"{cmd_name.replace('-', '_')}_command")
        assert isinstance(command, click.Command)
        return command


_ENVIRONMENT_HELP: Final = """\b
Environment:
  HAPTICD_CONFIG       Configuration files, separated by colons; -c overrides.
  HAPTICD_RUNTIME_DIR  Directory of the sockets, as --runtime-dir.
"""


@click.group(
    cls=_LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=_ENVIRONMENT_HELP,
)
@click.version_option(__version__, "-V", "--version", message="hapticd %(version)s")
@click.option(
    "--runtime-dir",
    type=click.Path(file_okay=False, readable=False),
    metavar="DIR",
    help="Directory of the sockets  [env var: HAPTICD_RUNTIME_DIR; default: $RUNTIME_DIRECTORY, "
    "$XDG_RUNTIME_DIR/hapticd or /tmp/hapticd-UID]",
)
@click.pass_context
def cli(ctx: click.Context, runtime_dir: str | None) -> None:
    """Run or control a haptic daemon, which displays virtual surfaces on a force-feedback joystick."""
    ctx.obj = runtime_dir
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    # Set before numpy is loaded: otherwise its BLAS starts a thread for each processor, and no command needs them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with guarded() as line_lost:
        code = _run(arguments)
    return code or int(line_lost())


def _run(arguments: Sequence[str] | None) -> int:
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        result = cli.main(given, prog_name="hapticd", standalone_mode=False)
        if sys.stdout is not None:  # None if the parent process closed it
            sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except (KeyboardInterrupt, click.Abort):
        return 130
    except ReaderGone:
        return 128 + signal.SIGPIPE
    except (HapticdError, click.ClickException, MemoryError, OSError, RuntimeError) as error:
        # After a usage error no option is parsed. So --json is searched in the arguments, up to a -- that ends options.
        return report_error(error, as_json="--json" in takewhile("--".__ne__, given))
