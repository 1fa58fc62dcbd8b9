"""Completion of names in a shell: shipped files, materials, objects.

The user waits after pressing Tab. So a completion imports only the modules that it needs, and never connects to another
machine. After an error it offers nothing.
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

_COMPLETION_TIMEOUT_S: Final = 0.3
"""Longest wait for an answer of the daemon, in s."""
_UNQUOTED_NAME: Final = re.compile(r"[\w.+-]+")
"""File names that need no quotes in any shell; other names are not offered."""


def _completion_of(known: Callable[[click.Context], Iterable[str]], otherwise: str | None = None) -> Complete:
    """Return a completion of the names that `known` returns; if no name matches, the shell completes `otherwise`."""

    def complete(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
        found = [CompletionItem(name) for name in known(ctx) if name.startswith(incomplete)]
        return found or ([] if otherwise is None else [CompletionItem(incomplete, type=otherwise)])

    return complete


def _files(folder: Folder) -> Complete:
    """Return a completion of shipped names and YAML files in the current folder; if none matches, of all files."""

    def known(ctx: click.Context) -> list[str]:
        from hapticd.config.shipped_files import shipped

        return [
            *shipped(folder),
            *sorted(path.name for path in Path().glob("*.yaml") if _UNQUOTED_NAME.fullmatch(path.name)),
        ]

    return _completion_of(known, otherwise="file")


def _keys_from_daemon(ctx: click.Context, ask: Callable[[Client], object]) -> list[str]:
    """Return the keys of the mapping that `ask` requests from the daemon; [] if the daemon does not answer in time."""
    from hapticd.client.blocking import connect

    try:
        with connect(ctx.find_root().params.get("runtime_dir"), _COMPLETION_TIMEOUT_S) as client:
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
shipped_materials = _completion_of(_shipped_materials)
materials = _completion_of(
    lambda ctx: _keys_from_daemon(ctx, lambda client: client.get_materials()["materials"]) or _shipped_materials(ctx)
)
"""Completion of the materials of the daemon, or of the shipped materials if the daemon does not answer."""
objects = _completion_of(lambda ctx: _keys_from_daemon(ctx, lambda client: client.get_scene()["scene"].get("objects")))
