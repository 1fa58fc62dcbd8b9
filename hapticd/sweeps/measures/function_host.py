"""The program that runs in the process of a user's function, started by function_process."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from types import ModuleType
from typing import Any, Final

from hapticd.base.errors import HapticdError, collapse_whitespace, known_names
from hapticd.base.threads import end_with_parent
from hapticd.sweeps.columns import Row
from hapticd.sweeps.measures.function_process import Function
from hapticd.sweeps.measures.function_values import values_of
from hapticd.sweeps.measures.sweep_point import SweepPoint

_MAX_ERROR_CHARACTERS: Final = 500
"""Length in characters at which error texts of a function are cut."""


def serve() -> None:
    """Load the user's function, then call the function for each point from the pipe, until the pipe is closed.

    The system kills the process when the thread that started it ends, even during a call.
    """
    end_with_parent(int(sys.argv[1]), signal.SIGKILL)()
    # A terminal sends SIGINT to all processes; the process that sends the points handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pipe = Connection(os.dup(0))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    with pipe, suppress(EOFError, BrokenPipeError):
        function: Function = pipe.recv()
        try:
            called = loaded(function)
        except HapticdError as error:
            pipe.send(str(error))
            return
        pipe.send(None)
        while True:
            pipe.send(_answer(function, called, pipe.recv()))


def loaded(function: Function) -> Callable[[SweepPoint], object]:
    """Create the module of a function from its source, and return the function. Raises HapticdError (one line)."""
    name = function.module
    if function.folder:
        sys.path.insert(0, function.folder)
    module = ModuleType(name)
    module.__file__ = function.file
    module.__package__ = name.rpartition(".")[0]
    sys.modules[name] = module
    try:
        exec(compile(function.source, function.file, "exec"), module.__dict__)
    except SyntaxError as error:
        raise HapticdError(f"{name} cannot be loaded: line {error.lineno}: {error.msg}") from None
    except BaseException as error:
        raise HapticdError(f"{name} cannot be loaded: {_reason(error, function)}") from None
    found: Any = module
    for part in function.name.split("."):
        known = [each for each in vars(found) if callable(getattr(found, each)) and not each.startswith("_")]
        if not hasattr(found, part):
            raise HapticdError(f"{name} has no function {function.name}; {known_names(function.name, known)}")
        found = getattr(found, part)
    if not callable(found):
        raise HapticdError(f"{function.call} is not a function, but a {type(found).__name__}")
    return found  # type: ignore[no-any-return]


def _answer(
    function: Function, called: Callable[[SweepPoint], object], point: SweepPoint
) -> tuple[Row, None] | tuple[None, str]:
    try:
        return values_of(called(point), dict(function.kinds)), None
    except HapticdError as error:
        return None, collapse_whitespace(str(error))[:_MAX_ERROR_CHARACTERS]
    except BaseException as error:  # including SystemExit, so that a function cannot end a study
        return None, f"raised {_reason(error, function)}"


def _reason(error: BaseException, function: Function) -> str:
    """Return type and text of an exception, and the line of the module in which it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == function.file]
    where = f" ({os.path.basename(function.file)}, line {lines[-1]})" if lines else ""
    text = collapse_whitespace(str(error))[:_MAX_ERROR_CHARACTERS]
    return f"{type(error).__name__}{f': {text}' if text else ''}{where}"
