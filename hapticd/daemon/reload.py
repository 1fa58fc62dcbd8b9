"""The configuration, read again for a reload, and what of it needs a restart instead."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from concurrent.futures import wait
from typing import Final

from hapticd.base.errors import HapticdError, Path, Problem, path_text
from hapticd.base.steps import Steps
from hapticd.base.threads import in_background
from hapticd.config.configuration import Config

LOAD_S: Final = 10.0
"""So long the files of a configuration may take to be read."""
_LOOK_S: Final = 0.002


def read_again(load: Callable[[], Config]) -> Steps[Config]:
    """Reads the files in a thread, for LOAD_S at most: a disk may not answer, and large files take seconds. Raises
    HapticdError."""
    found = in_background("reload", load)
    until_s = time.monotonic() + LOAD_S
    while not found.done():
        if time.monotonic() > until_s:
            raise HapticdError(f"the files of the configuration were not read within {LOAD_S:g} s")
        wait([found], _LOOK_S)
        yield
    return found.result()


def needing_restart(before: Config, after: Config) -> list[Problem]:
    """What of a configuration is another, and cannot be taken while the servo runs."""
    problems = []
    for section in Config.model_fields:
        if section not in ("scene", "materials"):
            old, new = getattr(before, section).to_dict(), getattr(after, section).to_dict()
            problems += _differences((section,), old, new)
    return problems


def _differences(path: Path, old: object, new: object) -> list[Problem]:
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [*old, *(key for key in new if key not in old)]
        return [problem for key in keys for problem in _differences((*path, key), old.get(key), new.get(key))]
    # Where the simulated handle starts matters at the start alone.
    if old == new or path == ("device", "sim", "start_m"):
        return []
    text = f"{json.dumps(new)} needs a restart of the daemon; it runs with {json.dumps(old)}"
    return [Problem(path_text(path), text)]
