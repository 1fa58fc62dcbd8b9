"""The measure `function`: a user's function in a module next to the study, called in a separate process."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, StringConstraints

from hapticd.base.errors import HapticdError, InvalidError, Problem, collapse_whitespace
from hapticd.base.model import Model
from hapticd.base.yaml_source import Json
from hapticd.sweeps.columns import Column, Kind, Row
from hapticd.sweeps.measures.function_process import Function, FunctionProcess, process_of
from hapticd.sweeps.measures.sweep_point import SweepPoint
from hapticd.sweeps.point import Point

FUNCTION_MEASURE: Final = "function"
"""Name of the measure that calls a user's function."""
_KIND_OF_UNIT: Final[Mapping[str, Kind]] = {"integer": "integer", "boolean": "boolean", "text": "text"}
"""Values in the option `columns` that are kinds of columns; any other value is the unit of a number."""
_ADDED_OPTIONS: Final = ("source", "file", "folder")
"""Options that are added when a study is read; users do not set them."""
_NON_IDENTITY_OPTIONS: Final = ("file", "folder", "timeout_s")
"""Options that results do not depend on."""
_MAX_SOURCE_BYTES: Final = 4 << 20
"""Largest size of a module that is sent to workers."""


class FunctionOptions(Model):
    """Options of the measure `function`."""

    call: Annotated[str, StringConstraints(pattern=r"^[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*$")] = Field(
        description="module:name. The module is a file next to the study, or one that Python finds."
    )
    columns: Annotated[
        dict[
            Annotated[str, StringConstraints(min_length=1, max_length=64)],
            Annotated[str, StringConstraints(max_length=32)],
        ],
        Field(min_length=1, max_length=256),
    ] = Field(description="For each column its unit, empty for a number without one; or integer, boolean or text.")
    timeout_s: float = Field(
        default=60.0, gt=0, le=86_400, description="Time after which a call of the function is killed."
    )
    source: str = Field(default="", description="The module's source; set when a study is read.")
    file: str = Field(default="", description="The module's path; set when a study is read.")
    folder: str = Field(default="", description="The study's folder; set when a study is read.")


class UserFunction:
    """The values that a user's function returns for a point."""

    needs_run = False

    def __init__(self, options: FunctionOptions) -> None:
        self._timeout_s = options.timeout_s
        module, _, name = options.call.partition(":")
        self.columns = tuple(_column(options.call, *each) for each in options.columns.items())
        kinds = tuple((column.name, column.kind) for column in self.columns)
        self._function = Function(module, name, options.source, options.file, options.folder, kinds)

    def of(self, point: Point) -> Row:
        """Call the function with the point and, if the study has a run, its samples. Raises HapticdError."""
        run = None if point.run_kind == "none" or point.operator is None else point.run
        given = SweepPoint(
            config=point.source,
            operator=point.operator_source,
            parameters=point.parameters,
            duration_s=point.duration_s,
            rate_hz=point.rate_hz,
            samples=None if run is None else run.samples,
            truth=None if run is None else run.truth,
        )
        return process_of(self._function).values(given, self._timeout_s)

    def check(self) -> None:
        """Raise HapticdError (one line) if the function's module cannot be loaded or lacks the function."""
        FunctionProcess(self._function).end()


def _column(call: str, name: str, unit: str) -> Column:
    kind = _KIND_OF_UNIT.get(unit)
    return Column(name, kind or "number", "measured", "" if kind else unit, f"Value of the function {call}.")


def with_source(options: Mapping[str, Json], folder: str) -> dict[str, Json]:
    """Return the options of a user's function with the source of its module added, so that a worker needs no file.

    `folder` is the study's folder. Raises InvalidError, with paths relative to the options.
    """
    given = {key: value for key, value in options.items() if key not in _ADDED_OPTIONS}
    parsed = FunctionOptions.model_validate(given)
    module = parsed.call.partition(":")[0]
    try:
        file, source = source_of(module, folder)
        complete: dict[str, Json] = {**given, "source": source, "file": file, "folder": folder}
        UserFunction(FunctionOptions.model_validate(complete)).check()
    except HapticdError as error:
        raise InvalidError([Problem("call", str(error))]) from None
    return complete


def identity_options(options: Mapping[str, Json]) -> dict[str, Json]:
    """Return the options of a user's function on which results depend."""
    return {key: value for key, value in options.items() if key not in _NON_IDENTITY_OPTIONS}


# ---- The source of the module ---------------------------------------------------------------------------------------


def source_of(module: str, folder: str) -> tuple[str, str]:
    """Return path and source of a module in `folder`; if it is not there, of the file that Python would import.

    Raises HapticdError (one line).
    """
    path = Path(folder, *module.split("."))
    for file in (path.with_name(f"{path.name}.py"), path / "__init__.py"):
        if file.is_file():
            return _source_in(str(file))
    try:
        spec = find_spec(module)
    except Exception as error:  # parent packages are imported, which may raise any exception
        why = collapse_whitespace(f"{type(error).__name__}: {error}")
        raise HapticdError(f"{module} cannot be found: {why}") from None
    if spec is None:
        raise HapticdError(f"no module {module}, neither as {module}.py in {folder} nor on Python's path")
    if spec.origin is None or not spec.origin.endswith(".py"):
        raise HapticdError(f"{module} is not a Python file; workers need its source")
    return _source_in(spec.origin)


def _source_in(file: str) -> tuple[str, str]:
    try:
        content = Path(file).read_bytes()
        if len(content) > _MAX_SOURCE_BYTES:
            raise HapticdError(f"{file} is larger than {_MAX_SOURCE_BYTES >> 20} MiB")
        return file, content.decode()
    except OSError as error:
        raise HapticdError(f"{file} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise HapticdError(f"{file} is not UTF-8") from None
