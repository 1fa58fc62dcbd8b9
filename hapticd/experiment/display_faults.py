"""Faults in the configurations of a study's stimuli, each with the path of the key of the study that causes it."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from functools import partial
from typing import Final

from hapticd.base.errors import InvalidError, Path, path_text
from hapticd.base.model import UNKNOWN_KEY
from hapticd.base.yaml_source import Json
from hapticd.experiment.cells import Cell, cells_of, levels_key
from hapticd.experiment.faults import Fault
from hapticd.experiment.key_paths import path_of, with_patch
from hapticd.experiment.keys import Adaptive, Study, Variable
from hapticd.experiment.plain_values import Scalar
from hapticd.experiment.stimuli import config_faults, document_of, level_text, levels_text, place_of, placed, value_of

_MAX_FAULTS: Final = 50
"""The search for faults ends after the cell in which this number is reached, to bound its time."""


def display_faults(study: Study) -> list[Fault]:
    """Return the faults in the configurations of a study: of the base, of its conditions, or of the stimuli."""
    base = [(("base", *path), text) for path, text in config_faults(study.base)]
    if base:
        return base
    conditions = [fault for name in study.conditions for fault in _condition(study, name)]
    if conditions:
        return conditions
    found: list[Fault] = []
    seen: set[Hashable] = set()
    faulty: set[Hashable] = set()
    for cell in cells_of(study):
        variable = None if cell.procedure is None else study.adaptive(cell.procedure).variable.name
        for position in range(len(cell.levels)):
            place = place_of(study, position)
            for levels in cell.levels[position:] if cell.listed else cell.levels:
                stimulus = cell.condition, levels_key(levels)
                # A fault at one place is not reported again for the other places.
                known = (place, stimulus) in seen or stimulus in faulty or variable in levels
                if not known:
                    seen.add((place, stimulus))
                    faults = _stimulus(study, cell.condition, levels, place)
                    found += faults
                    if faults:
                        faulty.add(stimulus)
                if cell.listed:
                    break
        # A fault of the factors' levels would appear again with every value of the variable.
        if cell.procedure is not None and (cell.condition, levels_key(cell.levels[0])) not in faulty:
            found += _adaptive(study, cell, study.adaptive(cell.procedure))
        if len(found) >= _MAX_FAULTS:
            break
    return list(dict.fromkeys(found))


def _condition(study: Study, name: str) -> Iterator[Fault]:
    where: Path = ("conditions", name, "changes")
    places = study.places if study.trial.presentation == "places" else ()
    for place in places or (None,):
        changes = placed(study.conditions[name].changes, place)
        assert isinstance(changes, dict)
        found = _faults(partial(with_patch, study.base, changes))
        if found:
            yield from (((*where, *path), text) for path, text in found)
            return


def _faults(make: Callable[[], dict[str, Json]]) -> list[Fault]:
    try:
        return config_faults(make())
    except InvalidError as error:
        return [((), str(problem)) for problem in error.problems]


def _stimulus(study: Study, condition: str, levels: Mapping[str, Scalar], place: str | None) -> list[Fault]:
    """Return the faults in the configuration of a stimulus.

    Their path is that of the level that alone causes faults, or else trial.cross or trial.list.
    """
    found = _faults(partial(document_of, study, condition, levels, place))
    if not found:
        return []
    for name, level in levels.items():
        alone = _faults(partial(document_of, study, condition, {name: level}, place))
        if alone:
            return [(_level_path(study, name, level, text), _sentence(path, text)) for path, text in alone]
    where: Path = ("trial", "list" if study.trial.list is not None else "cross")
    return [(where, f"{levels_text(levels)}: {_sentence(path, text)}") for path, text in found]


def _level_path(study: Study, name: str, level: Scalar, text: str) -> Path:
    """Return the path of a level in a study, or of its factor's `at` if the fault `text` is an unknown key."""
    factor = study.factors[name]
    if factor.at is not None and text.startswith(UNKNOWN_KEY):
        return ("factors", name, "at")
    texts = [level_text(each) for each in factor.names]
    if factor.variants is not None:
        return ("factors", name, "variants", str(level))
    if level_text(level) in texts:
        return ("factors", name, "levels", texts.index(level_text(level)))
    return ("trial", "reference", name)


def _sentence(path: Path, text: str) -> str:
    return f"{path_text(path)}: {text}" if path else text


def _adaptive(study: Study, cell: Cell, adaptive: Adaptive) -> Iterator[Fault]:
    """Yield the faults in stimuli of a procedure: its reference, the ends of its range, and its practice level."""
    assert cell.procedure is not None
    where: Path = ("trial", "procedures", cell.procedure.partition(".")[0])
    variable = adaptive.variable
    plain = document_of(study, cell.condition, cell.levels[0], place_of(study, 0))
    for at in variable.at:
        here = _at(plain, path_of(str(placed(at, place_of(study, 0)))))
        if isinstance(here, bool) or not isinstance(here, int | float):
            unknown = _faults(partial(_with_value, study, cell, variable, variable.reference))
            text = "; ".join(
                _sentence(path, fault) for path, fault in unknown if fault.startswith(UNKNOWN_KEY) or not path
            )
            yield (
                (*where, "variable", "at"),
                text or f"{at} is not a number in the configuration; a procedure can only vary numbers",
            )
            return
    low, high = adaptive.ends
    values = {"reference": variable.reference, "low": value_of(variable, low), "high": value_of(variable, high)}
    if adaptive.practice_level is not None:
        values["practice_level"] = value_of(variable, adaptive.practice_level)
    for name, value in values.items():
        found = _faults(partial(_with_value, study, cell, variable, value))
        keys: dict[str, Path] = {"reference": ("variable", "reference"), "practice_level": ("practice_level",)}
        end = f" (the {name}est level that the procedure can show)" if name in ("low", "high") else ""
        for path, text in found:
            yield (*where, *keys.get(name, ("method",))), f"{_sentence(path, text)}{end}"
        if found:
            return


def _with_value(study: Study, cell: Cell, variable: Variable, value: float) -> dict[str, Json]:
    levels = {**cell.levels[0], variable.name: value}
    return document_of(study, cell.condition, levels, place_of(study, 0), (variable,))


def _at(document: Json, path: Path) -> Json:
    here = document
    for key in path:
        if isinstance(here, dict) and isinstance(key, str):
            here = here.get(key)
        elif isinstance(here, list) and isinstance(key, int) and key < len(here):
            here = here[key]
        else:
            return None
    return here
