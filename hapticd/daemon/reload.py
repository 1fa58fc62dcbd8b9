"""Reading the configuration again for a reload, and finding the keys whose change needs a restart."""

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

CONFIG_LOAD_TIMEOUT_S: Final = 10.0
"""Time within which the files of a configuration must be read: a disk may not respond."""
_CONFIG_POLL_S: Final = 0.002
"""Longest time that one step of a reload waits for the thread that reads the files."""


def read_again(load: Callable[[], tuple[Config, str]]) -> Steps[tuple[Config, str]]:
    """Read the configuration in a background thread, and yield while it runs: large files take seconds.

    Returns the result of `load`: the configuration, and the names of its files as one text. Raises
    HapticdError for an invalid configuration, and after CONFIG_LOAD_TIMEOUT_S.
    """
    found = in_background("reload", load)
    until_s = time.monotonic() + CONFIG_LOAD_TIMEOUT_S
    while not found.done():
        if time.monotonic() > until_s:
            raise HapticdError(f"configuration files: were not read within {CONFIG_LOAD_TIMEOUT_S:g} s")
        wait([found], _CONFIG_POLL_S)
        yield
    return found.result()


def needing_restart(before: Config, after: Config) -> list[Problem]:
    """Return a problem for each key that changed and can only be applied by a restart of the daemon."""
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
    # The start position of the simulated handle is used only when the daemon starts.
    if old == new or path == ("device", "sim", "start_m"):
        return []
    text = f"a change from {json.dumps(old)} to {json.dumps(new)} needs a restart of the daemon"
    return [Problem(path_text(path), text)]
