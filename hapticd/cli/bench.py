"""`hapticd bench`: the benchmarks, which lie beside the package in the source tree and are not installed with it."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import click

from hapticd.base.errors import HapticdError

TREE = Path(__file__).resolve().parent.parent.parent
"""The source tree, where this is one."""


def _bench() -> ModuleType:
    """The benchmarks' main module. Raises HapticdError where they are not, or what they need is not."""
    if not (TREE / "bench" / "peers.py").is_file():
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
    help="Where the report and its figures go [default: docs of the source tree, of a whole run].",
)
@click.option(
    "--overwrite", is_flag=True, help="Replace the pages and figures that are there; of a part, its sections of them."
)
def bench_command(names: tuple[str, ...], list_names: bool, quick: bool, out: Path | None, overwrite: bool) -> int:
    """Measure NAMES, or everything: what each part costs, and how wrong it is, beside other ways to do the same.

    A whole run says at its end how long it took. Works in a source tree, where the benchmarks are.
    """
    bench = _bench()
    if list_names:
        click.echo(bench.listed())
        return 0
    if (wrong := bench.unknown(names)) is not None:
        raise click.UsageError(wrong)
    return int(bench.perform(names, bench.Options(quick=quick), out, overwrite))
