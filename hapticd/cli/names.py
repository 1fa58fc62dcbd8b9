"""What a shell offers where a command takes a name: shipped scenes, materials, objects.

A key was pressed, and somebody waits: nothing here loads more than it needs or asks another machine, and what cannot be
found out is not offered.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

import click
from click.shell_completion import CompletionItem

from hapticd.base.errors import HapticdError

if TYPE_CHECKING:
    from hapticd.client.blocking import Client
    from hapticd.config.shipped_files import Folder

Complete: TypeAlias = "Callable[[click.Context, click.Parameter, str], list[CompletionItem[str]]]"

_PATIENCE_S: Final = 0.3
# Names that no shell has to quote.
_PLAIN: Final = re.compile(r"[\w.+-]+")


def _offered(known: Callable[[click.Context], Iterable[str]], otherwise: str | None = None) -> Complete:
    """Offers the names that begin so; where there is none, what a shell does `otherwise`."""

    def complete(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
        found = [CompletionItem(name) for name in known(ctx) if name.startswith(incomplete)]
        return found or ([] if otherwise is None else [CompletionItem(incomplete, type=otherwise)])

    return complete


def _files(folder: Folder) -> Complete:
    """What ships in a folder and YAML files of this one; where neither begins so, any file."""

    def known(ctx: click.Context) -> list[str]:
        from hapticd.config.shipped_files import shipped

        return [*shipped(folder), *sorted(path.name for path in Path().glob("*.yaml") if _PLAIN.fullmatch(path.name))]

    return _offered(known, otherwise="file")


def _asked(ctx: click.Context, ask: Callable[[Client], object]) -> list[str]:
    """The names in what the daemon of this machine says; nothing where there is none, or none that answers soon."""
    from hapticd.client.blocking import connect

    try:
        with connect(ctx.find_root().params.get("runtime_dir"), _PATIENCE_S) as client:
            return _names(ask(client))
    except (HapticdError, OSError):
        return []


def _shipped_materials(ctx: click.Context) -> list[str]:
    from hapticd.base.yaml_source import load_bytes
    from hapticd.config.shipped_files import shipped

    found: list[str] = []
    for file in shipped("materials").values():
        library = load_bytes(Path(file).read_bytes(), file).data
        found += _names(library["materials"] if isinstance(library, dict) else None)
    return found


def _names(mapping: object) -> list[str]:
    return list(mapping) if isinstance(mapping, dict) else []


scenes, operators = _files("scenes"), _files("operators")
experiments, sweeps = _files("experiments"), _files("sweeps")
shipped_materials = _offered(_shipped_materials)
materials = _offered(
    lambda ctx: _asked(ctx, lambda client: client.get_materials()["materials"]) or _shipped_materials(ctx)
)
"""Of the daemon, or the shipped ones where none answers."""
objects = _offered(lambda ctx: _asked(ctx, lambda client: client.get_scene()["scene"].get("objects")))
"""Of the daemon's scene."""
