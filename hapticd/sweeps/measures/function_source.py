"""The source of the module of a user's function, in the folder of the study or on Python's path."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError, collapse_whitespace

_MAX_SOURCE_BYTES: Final = 4 << 20
"""Largest size of a module that is sent to workers."""


@dataclass(frozen=True, slots=True)
class FunctionSource:
    """A module as text, which is sent to workers that do not have the file."""

    file: str
    text: str


def source_of(module: str, folder: str) -> FunctionSource:
    """Read the source of a module from `folder`; if it is not there, from the file that Python would import.

    Raises HapticdError (one line).
    """
    path = Path(folder, *module.split("."))
    for file in (path.with_name(f"{path.name}.py"), path / "__init__.py"):
        if file.is_file():
            return _read(str(file))
    try:
        spec = find_spec(module)
    except Exception as error:  # parent packages are imported, which may raise any exception
        why = collapse_whitespace(f"{type(error).__name__}: {error}")
        raise HapticdError(f"{module} cannot be found: {why}") from None
    if spec is None:
        raise HapticdError(f"no module {module}, neither as {module}.py in {folder} nor on Python's path")
    if spec.origin is None or not spec.origin.endswith(".py"):
        raise HapticdError(f"{module} is not a Python file; workers need its source")
    return _read(spec.origin)


def _read(file: str) -> FunctionSource:
    try:
        content = Path(file).read_bytes()
        if len(content) > _MAX_SOURCE_BYTES:
            raise HapticdError(f"{file} is larger than {_MAX_SOURCE_BYTES >> 20} MiB")
        return FunctionSource(file, content.decode())
    except OSError as error:
        raise HapticdError(f"{file} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise HapticdError(f"{file} is not UTF-8") from None
