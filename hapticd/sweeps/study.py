"""Reads and validates a sweep from a YAML file or a mapping, and reports every fault with its line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from pydantic import ValidationError

from hapticd.base.errors import HapticdError, InvalidError, Path, Problem, known_names
from hapticd.base.model import faults_of, plain
from hapticd.base.yaml_source import MAX_YAML_BYTES, Document, Json, load_bytes, read_file
from hapticd.config.configuration import Config, load_config
from hapticd.config.document_kinds import refuse_other_kinds
from hapticd.config.operator import Operator, load_operator, parse_operator
from hapticd.config.shipped_files import file_of
from hapticd.experiment.key_paths import BASE_KEY, invalid_in, path_of, with_base, with_value
from hapticd.sweeps.axes import Axis
from hapticd.sweeps.columns import Value
from hapticd.sweeps.figure_faults import figure_faults
from hapticd.sweeps.keys import SweepCondition, SweepStudy
from hapticd.sweeps.measures.registry import parse_measure
from hapticd.sweeps.measures.user_function import FUNCTION_MEASURE, with_source
from hapticd.sweeps.plan import Job, Plan, plan
from hapticd.sweeps.point import NON_CONFIG_KEYS, OPERATOR_KEY, PARAMETERS_KEY

_MAX_CHECKED_VALUES: Final = 200
"""Only the first 200 values of an axis are validated before the study begins; the others when they are used."""


def load_sweep(source: Mapping[str, object] | str | os.PathLike[str]) -> Plan:
    """Read a study from a YAML file, by the name of a shipped study, or from a mapping, and return its plan.

    Paths in a study are relative to its file; those in a mapping are relative to the current folder.

    Raises InvalidError with every fault, its file, line and key, and HapticdError for a file that cannot be read.
    """
    if isinstance(source, Mapping):
        return _load(Document(plain(source)))
    file = file_of(os.fspath(source), "sweeps")
    content = read_file(file, MAX_YAML_BYTES)
    document = load_bytes(content, file)
    refuse_other_kinds(document, "sweep")
    return replace(_load(document), source=content.decode())


def _load(document: Document) -> Plan:
    given = document.mapping(SweepStudy.model_fields)
    data, base = with_base(document, given, "a configuration", "configuration", "change", "scene", "materials")
    _with_operator(document, data)
    _with_functions(document, data)
    try:
        study = SweepStudy.parsed(data)
    except ValidationError as error:
        raise invalid_in(document, base, faults_of(error)) from None
    faults = [*_measure_faults(study), *_key_faults(study)]
    if faults:
        raise invalid_in(document, base, faults)
    try:
        found = plan(study)
    except InvalidError as error:
        faults = [(tuple(each.where.split(".")), each.problem) for each in error.problems]
        raise invalid_in(document, base, faults) from None
    faults = [*_value_faults(found.job, found.axes), *_column_faults(found)]
    faults += figure_faults(study, found.columns, found.axes)
    if faults:
        raise invalid_in(document, base, faults)
    return found


# ---- Other files -----------------------------------------------------------------------------------------------------


def _with_operator(document: Document, data: dict[str, Json]) -> None:
    """Replace the name of an operator (the motion of the hand) by its content."""
    given = data.get(OPERATOR_KEY)
    if isinstance(given, str):
        data[OPERATOR_KEY] = _plain_operator(load_operator(file_of(given, "operators", document.folder)))
    elif isinstance(given, dict):
        try:
            parse_operator(given)
        except InvalidError as error:
            raise InvalidError(
                document.problem((OPERATOR_KEY, *_elements(each.where)), each.problem) for each in error.problems
            ) from None


def _with_functions(document: Document, data: dict[str, Json]) -> None:
    """Add to the options of each user function the source of its module."""
    measures = data.get("measure")
    if not isinstance(measures, list):
        return
    measures = data["measure"] = list(measures)
    problems: list[Problem] = []
    for index, each in enumerate(measures):
        options = each.get(FUNCTION_MEASURE) if isinstance(each, dict) and len(each) == 1 else None
        if isinstance(options, dict):
            try:
                measures[index] = {FUNCTION_MEASURE: with_source(options, document.folder)}
            except InvalidError as error:
                problems += [
                    document.problem(("measure", index, FUNCTION_MEASURE, *_elements(each.where)), each.problem)
                    for each in error.problems
                ]
    if problems:
        raise InvalidError(problems)


def _plain_operator(operator: Operator) -> dict[str, Json]:
    if operator.gesture is not None:
        return {"gesture": operator.gesture.to_dict()}
    assert operator.waypoints is not None
    return {"waypoints": [list(each) for each in operator.waypoints], "interpolation": operator.interpolation}


def _elements(where: str) -> Path:
    """Return the text `where` of a problem as a path of keys; empty if the text is not a path."""
    try:
        return path_of(where)
    except ValueError:
        return ()


# ---- Faults between keys ---------------------------------------------------------------------------------------------


def _measure_faults(study: SweepStudy) -> list[tuple[Path, str]]:
    faults: list[tuple[Path, str]] = []
    names: set[str] = set()
    for index, given in enumerate(study.measure):
        try:
            measure = parse_measure(given)
        except InvalidError as error:
            faults += [(("measure", index, *_elements(each.where)), each.problem) for each in error.problems]
            continue
        for column in measure.columns:
            if column.name in names or column.name in study.vary:
                faults.append((("measure", index), f"duplicate column {column.name}; give one of them another name"))
            names.add(column.name)
        if measure.needs_run and (study.run == "none" or study.operator is None):
            faults.append((("measure", index), "measures a run: the study needs an operator and run: simulate"))
    return faults


def _key_faults(study: SweepStudy) -> list[tuple[Path, str]]:
    """Return a fault for each varied key that no configuration or study has; `refine.key` is checked, too."""
    faults: list[tuple[Path, str]] = []
    keys: list[tuple[Path, str]] = []
    for name, axis in study.vary.items():
        if axis.levels is None:
            keys.append((("vary", name), name))
        for level, settings in (axis.levels or {}).items():
            keys += [(("vary", name, "levels", level, key), key) for key in settings]
    if study.refine is not None:
        keys.append((("refine", "key"), study.refine.key))
    known = (*Config.model_fields, *NON_CONFIG_KEYS)
    for place, key in keys:
        try:
            path = path_of(key)
        except ValueError as error:
            faults.append((place, str(error)))
            continue
        if path[0] not in known:
            hint = f"{known_names(str(path[0]), known)}; free parameters are below {PARAMETERS_KEY}"
            faults.append((place, f"unknown key {path[0]}; {hint}"))
    return faults


def _value_faults(job: Job, axes: Sequence[Axis]) -> list[tuple[Path, str]]:
    """Return the faults of axis values that make the configuration invalid.

    Each value of an axis is checked together with the first value of every other axis.
    """
    values = [axis.plain_values[:_MAX_CHECKED_VALUES] for axis in axes]
    first = [each[0] for each in values]
    faults = _faults_with(job, first, "")
    if faults:
        return faults
    for index, name in enumerate(job.names):
        for value in values[index][1:]:
            found = _faults_with(job, [*first[:index], value, *first[index + 1 :]], name)
            if found:
                faults += found
                break
    refine = job.study.refine
    if refine is not None and not faults:
        for key in ("start", "end"):
            document = with_value(job.document(first), path_of(refine.key), getattr(refine, key), make=True)
            faults += [(("refine", key), text) for _, text in _config_faults(document)]
    return faults


def _faults_with(job: Job, values: Sequence[Value], name: str) -> list[tuple[Path, str]]:
    """Return the faults of the configuration at a point.

    The path of a fault names the axis that sets the faulty key. If no axis does, it names the axis `name`, or if `name`
    is empty the base configuration.
    """
    try:
        document = job.document(values)
    except InvalidError as error:
        return [(("vary", name) if name else ("vary",), str(error))]
    owners = {
        path: axis for axis, value in zip(job.names, values, strict=True) for path, _ in job.settings(axis, value)
    }
    found: list[tuple[Path, str]] = []
    for path, text in _config_faults(document):
        owner = next((axis for key, axis in owners.items() if path[: len(key)] == key), None)
        if owner is not None:
            found.append((("vary", owner), text))
        elif name:
            found.append((("vary", name), f"{'.'.join(map(str, path))}: {text}" if path else text))
        else:
            found.append(((path if path[:1] == (OPERATOR_KEY,) else (BASE_KEY, *path)), text))
    return found


def _config_faults(document: Mapping[str, Json]) -> list[tuple[Path, str]]:
    source = {key: value for key, value in document.items() if key not in NON_CONFIG_KEYS}
    try:
        load_config(source)
        operator = document.get(OPERATOR_KEY)
        if isinstance(operator, dict):
            parse_operator(operator)
    except InvalidError as error:
        return [(_elements(each.where), each.problem) for each in error.problems]
    except HapticdError as error:
        return [((), str(error))]
    return []


def _column_faults(found: Plan) -> list[tuple[Path, str]]:
    """Return a fault if `refine.holds` does not name a measured column."""
    study, names = found.job.study, [column.name for column in found.columns if column.role == "measured"]
    if study.refine is None:
        return []
    holds = study.refine.holds
    column = holds.column if isinstance(holds, SweepCondition) else holds
    if column in names:
        return []
    place = ("refine", "holds", "column") if isinstance(holds, SweepCondition) else ("refine", "holds")
    return [(place, f"unknown measured column {column}; {known_names(column, names)}")]
