"""A stimulus as a scene: the study's base configuration with what condition, levels and procedure change in it.

Changes are laid over one another as merge patches: the condition's, then each factor's in the order of the study's
factors, then the variable's of a procedure. `{place}` in a key or a text stands for the place of the stimulus. A text
where a material's keys are expected, `materials.left: wood`, stands for the keys of the material of that name, so that
a scene need not hold the name of what it displays. A change of a shipped material's key starts from that material.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from pydantic import ValidationError

from hapticd.base.errors import InvalidError, Path, Problem, path_text
from hapticd.base.merge_patch import merge_patch
from hapticd.base.model import faults_of
from hapticd.base.yaml_source import Json
from hapticd.config.configuration import Config
from hapticd.config.materials import shipped_materials
from hapticd.config.scene import reference_faults
from hapticd.experiment.key_paths import difference, path_of, with_patch, with_value
from hapticd.experiment.keys import Study, Variable
from hapticd.experiment.plain_values import Scalar

PLACE: Final = "{place}"
TARGET: Final = "target"
REFERENCE: Final = "reference"


@dataclass(frozen=True, slots=True)
class Stimulus:
    """What is presented at one place or in one interval."""

    name: str
    """Of its levels; never shown to the participant."""
    levels: Mapping[str, Scalar]
    """By factor; of a procedure's variable the value."""
    changes: Mapping[str, Json]
    """A merge patch on the study's base configuration."""


class AdaptiveTrial(Protocol):
    """What at_level needs to know of a planned trial."""

    @property
    def condition(self) -> str: ...
    @property
    def stimuli(self) -> tuple[Stimulus, ...]: ...
    @property
    def procedure(self) -> str | None: ...


def level_text(level: Scalar) -> str:
    """A level as names of stimuli and cells have it: wood, 0.0016, true."""
    if isinstance(level, bool):
        return "true" if level else "false"
    return level if isinstance(level, str) else format(level, ".12g")


def levels_text(levels: Mapping[str, Scalar]) -> str:
    """The name of a stimulus: its levels, or `base` where it has none."""
    return ", ".join(map(level_text, levels.values())) or "base"


def placed(data: Json, place: str | None) -> Json:
    """Plain data with {place} replaced in keys and texts; unchanged without a place."""
    if place is None:
        return data
    if isinstance(data, dict):
        return {key.replace(PLACE, place): placed(value, place) for key, value in data.items()}
    if isinstance(data, list):
        return [placed(value, place) for value in data]
    return data.replace(PLACE, place) if isinstance(data, str) else data


def document_of(
    study: Study, condition: str, levels: Mapping[str, Scalar], place: str | None, variables: Iterable[Variable] = ()
) -> dict[str, Json]:
    """The configuration of a stimulus: scene and materials as plain data.

    `levels` are by factor, or by the name of one of the `variables`. Raises InvalidError as with_patch and with_value
    do.
    """
    document = with_patch(study.base, _mapping(placed(study.conditions[condition].changes, place)))
    for name, factor in study.factors.items():
        if name not in levels:
            continue
        level = levels[name]
        if factor.variants is not None:
            document = with_patch(document, _mapping(placed(factor.variants[str(level)], place)))
        for at in factor.at or ():
            document = with_value(document, path_of(str(placed(at, place))), level)
    for variable in variables:
        if variable.name in levels:
            for at in variable.at:
                document = with_value(document, path_of(str(placed(at, place))), levels[variable.name])
    return document


def _mapping(data: Json) -> dict[str, Json]:
    assert isinstance(data, dict)
    return data


def stimulus_of(
    study: Study,
    condition: str,
    levels: Mapping[str, Scalar],
    place: str | None,
    variable: Variable | None = None,
    name: str | None = None,
) -> Stimulus:
    """A stimulus by its levels; of a procedure also by the value of its variable. Raises InvalidError."""
    document = document_of(study, condition, levels, place, () if variable is None else (variable,))
    return Stimulus(name or levels_text(levels), dict(levels), difference(study.base, document))


def place_of(study: Study, position: int) -> str | None:
    """The name of the place of a stimulus, None where stimuli come one after the other."""
    return study.places[position] if study.trial.presentation == "places" and study.places else None


def value_of(variable: Variable, level: float) -> float:
    """The variable's value at a procedure's level."""
    if variable.level == "value":
        return level
    return variable.reference + level if variable.level == "added" else variable.reference * level


def at_level(study: Study, trial: AdaptiveTrial, level: float) -> tuple[Stimulus, ...]:
    """The stimuli of an adaptive trial at the level that its procedure asks for: the target takes it.

    A trial that is fixed has its stimuli already. Raises InvalidError for a value that the configuration refuses.
    """
    if trial.procedure is None:
        return trial.stimuli
    variable = study.adaptive(trial.procedure).variable
    return tuple(
        stimulus
        if variable.name in stimulus.levels
        else checked(study, _at(study, trial, stimulus, position, variable, value_of(variable, level)))
        for position, stimulus in enumerate(trial.stimuli)
    )


def _at(
    study: Study, trial: AdaptiveTrial, stimulus: Stimulus, position: int, variable: Variable, value: float
) -> Stimulus:
    levels = {**stimulus.levels, variable.name: value}
    return stimulus_of(study, trial.condition, levels, place_of(study, position), variable, stimulus.name)


def checked(study: Study, stimulus: Stimulus) -> Stimulus:
    """The stimulus, if its configuration is valid. Raises InvalidError."""
    faults = config_faults(document_with(study, (stimulus,)))
    if faults:
        raise InvalidError(
            Problem(path_text(path), f"{text} (levels: {levels_text(stimulus.levels)})") for path, text in faults
        )
    return stimulus


def document_with(study: Study, stimuli: Sequence[Stimulus]) -> dict[str, Json]:
    """The configuration in which these stimuli are presented together: one of an interval, all of places."""
    found: Json = dict(study.base)
    for stimulus in stimuli:
        found = merge_patch(found, dict(stimulus.changes))
    assert isinstance(found, dict)
    return found


def config_with(study: Study, stimuli: Sequence[Stimulus], rig: Config | None = None) -> Config:
    """As document_with, validated; servo, device and flight recorder are those of `rig`. Raises InvalidError."""
    document = document_with(study, stimuli)
    faults = config_faults(document)
    if faults:
        raise InvalidError(Problem(path_text(path), text) for path, text in faults)
    config = Config.parsed(document)
    materials = {**(shipped_materials() if rig is None else rig.materials), **config.materials}
    return (rig or config).model_copy(update={"materials": materials, "scene": config.scene})


def config_faults(document: Mapping[str, Json]) -> list[tuple[Path, str]]:
    """What is wrong with a configuration, its materials' names among it, with the path of each fault."""
    try:
        config = Config.parsed(dict(document))
    except ValidationError as error:
        return faults_of(error)
    known = {**shipped_materials(), **config.materials}
    return [(("scene", *path), text) for path, text in reference_faults(config.scene.objects, known)]
