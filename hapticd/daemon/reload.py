"""The configuration, read again for a reload, and what of it needs a restart instead."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from typing import Final

from hapticd.base import worker_process
from hapticd.base.errors import HapticdError, Path, Problem, path_text
from hapticd.config.configuration import Config

LOAD_S: Final = 10.0
"""So long the files of a configuration may take to be read. Commands and the end wait for it: the units' TimeoutStopSec
and WatchdogSec are more."""
_BEAT_S: Final = 0.1


def read_again(load: Callable[[], Config], working: Callable[[], None], ending: threading.Event) -> Config:
    """Reads the files, for LOAD_S at most and until the daemon ends; meanwhile it says by `working` that it works, as
    large ones take longer than the servo waits. Raises HapticdError."""
    found: list[Config | BaseException] = []
    computed = worker_process.used()

    def read() -> None:
        try:
            with worker_process.using(computed):
                found.append(load())
        except BaseException as error:
            found.append(error)

    # A daemon's thread: one that waits for a file for ever does not hold up the end of the process.
    reader = threading.Thread(target=read, name="reload", daemon=True)
    reader.start()
    until_s = time.monotonic() + LOAD_S
    while reader.is_alive():
        if ending.is_set():
            raise HapticdError("the daemon ends")
        if time.monotonic() > until_s:
            raise HapticdError(f"the files of the configuration were not read within {LOAD_S:g} s")
        working()
        reader.join(_BEAT_S)
    (result,) = found
    if isinstance(result, BaseException):
        raise result
    return result


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
