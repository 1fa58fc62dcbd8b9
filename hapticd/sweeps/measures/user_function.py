"""A measure of the user's: a function of a module beside the study, called in a process of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from pydantic import Field, StringConstraints

from hapticd.base.errors import HapticdError, InvalidError, Problem
from hapticd.base.model import Model
from hapticd.base.yaml_source import Json
from hapticd.sweeps.columns import Column, Kind, Row
from hapticd.sweeps.measures.function_process import Function, FunctionProcess, process_of
from hapticd.sweeps.measures.function_source import source_of
from hapticd.sweeps.measures.sweep_point import SweepPoint
from hapticd.sweeps.point import Point

FUNCTION_MEASURE: Final = "function"
"""The measure's name."""
_KIND_OF_UNIT: Final[Mapping[str, Kind]] = {"integer": "integer", "boolean": "boolean", "text": "text"}
_ADDED_OPTIONS: Final = ("source", "file", "folder")
"""Options that are set when a study is read."""
_NON_IDENTITY_OPTIONS: Final = ("file", "folder", "timeout_s")
"""Options that change no value."""


class FunctionOptions(Model):
    """Which function, and what it gives."""

    call: Annotated[str, StringConstraints(pattern=r"^[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*$")] = Field(
        description="module:name. The module is a file beside the study, or one that Python finds."
    )
    columns: Annotated[
        dict[
            Annotated[str, StringConstraints(min_length=1, max_length=64)],
            Annotated[str, StringConstraints(max_length=32)],
        ],
        Field(min_length=1, max_length=256),
    ] = Field(description="By name: the unit of what the function gives, empty for none; or integer, boolean, text.")
    timeout_s: float = Field(
        default=60.0, gt=0, le=86_400, description="Without an answer for so long the function is ended."
    )
    source: str = Field(default="", description="The module's source; set when a study is read.")
    file: str = Field(default="", description="Where it was found; set when a study is read.")
    folder: str = Field(default="", description="The study's folder; set when a study is read.")


class UserFunction:
    """What a function of the user's gives for the point, by column."""

    needs_run = False

    def __init__(self, options: FunctionOptions) -> None:
        self._timeout_s = options.timeout_s
        module, _, name = options.call.partition(":")
        self.columns = tuple(_column(options.call, *each) for each in options.columns.items())
        kinds = tuple((column.name, column.kind) for column in self.columns)
        self._function = Function(module, name, options.source, options.file, options.folder, kinds)

    def of(self, point: Point) -> Row:
        """Of the point and, where the study runs something, of its samples. Raises HapticdError."""
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
        """Loads the module. Raises HapticdError (one line)."""
        FunctionProcess(self._function).end()


def _column(call: str, name: str, unit: str) -> Column:
    kind = _KIND_OF_UNIT.get(unit)
    return Column(name, kind or "number", "measured", "" if kind else unit, f"By the function {call}.")


def with_source(options: Mapping[str, Json], folder: str) -> dict[str, Json]:
    """The options with the source of the module, so that they are all that a worker needs.

    `folder`: where the study is. Raises InvalidError, with paths relative to the options.
    """
    given = {key: value for key, value in options.items() if key not in _ADDED_OPTIONS}
    parsed = FunctionOptions.model_validate(given)
    module = parsed.call.partition(":")[0]
    try:
        found = source_of(module, folder)
        whole: dict[str, Json] = {**given, "source": found.text, "file": found.file, "folder": folder}
        UserFunction(FunctionOptions.model_validate(whole)).check()
    except HapticdError as error:
        raise InvalidError([Problem("call", str(error))]) from None
    return whole


def known_by(options: Mapping[str, Json]) -> dict[str, Json]:
    """What of the options a result depends on."""
    return {key: value for key, value in options.items() if key not in _NON_IDENTITY_OPTIONS}
