"""The configuration of a stimulus: the base of the study, changed by condition, factors and procedure.

The condition is applied first, then each factor in the order of the study, then a procedure's variable. `{place}` in a
key or a text is replaced by the place of the stimulus. `key_paths` explains how names of materials and changes of
shipped materials are applied.
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

PLACE_PLACEHOLDER: Final = "{place}"
"""Text in a study that is replaced by the place of a stimulus, such as left."""
TARGET_NAME: Final = "target"
"""Name of the stimulus whose level an adaptive procedure varies."""
REFERENCE_NAME: Final = "reference"
"""Name of the stimuli that the target of an adaptive procedure is compared with."""


@dataclass(frozen=True, slots=True)
class Stimulus:
    """A stimulus of a trial, at one place or in one interval."""

    name: str
    """Name, mostly made of the levels. The participant never sees it."""
    levels: Mapping[str, Scalar]
    """Level of each factor, and value of a procedure's variable, by the name of factor or variable."""
    changes: Mapping[str, Json]
    """The stimulus as a merge patch on the study's base configuration."""


class AdaptiveTrial(Protocol):
    """The members of a planned trial that `at_level` needs."""

    @property
    def condition(self) -> str:
        """Name of the condition."""

    @property
    def stimuli(self) -> tuple[Stimulus, ...]:
        """The stimuli in order of presentation. The target may have no value of the procedure's variable yet."""

    @property
    def procedure(self) -> str | None:
        """Name of the run of the procedure that chooses the level, or None."""


def level_text(level: Scalar) -> str:
    """Return a level as text for the names of stimuli and cells: wood, 0.0016, true."""
    if isinstance(level, bool):
        return "true" if level else "false"
    return level if isinstance(level, str) else format(level, ".12g")


def levels_text(levels: Mapping[str, Scalar]) -> str:
    """Return the name of a stimulus made of its levels, or "base" without levels."""
    return ", ".join(map(level_text, levels.values())) or "base"


def placed(data: Json, place: str | None) -> Json:
    """Return plain data with {place} in keys and texts replaced by `place`, or unchanged if `place` is None."""
    if place is None:
        return data
    if isinstance(data, dict):
        return {key.replace(PLACE_PLACEHOLDER, place): placed(value, place) for key, value in data.items()}
    if isinstance(data, list):
        return [placed(value, place) for value in data]
    return data.replace(PLACE_PLACEHOLDER, place) if isinstance(data, str) else data


def document_of(
    study: Study, condition: str, levels: Mapping[str, Scalar], place: str | None, variables: Iterable[Variable] = ()
) -> dict[str, Json]:
    """Return the configuration of a stimulus: scene and materials as plain data.

    `levels` maps names of factors or of `variables` to levels. Raises InvalidError for unknown keys or materials.
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
    """Make a stimulus from its levels, which may include the value of a procedure's `variable`.

    Raises InvalidError for unknown keys or materials.
    """
    document = document_of(study, condition, levels, place, () if variable is None else (variable,))
    return Stimulus(name or levels_text(levels), dict(levels), difference(study.base, document))


def place_of(study: Study, position: int) -> str | None:
    """Return the place of the stimulus at `position`, from 0, or None if stimuli are presented one after the other."""
    return study.places[position] if study.trial.presentation == "places" and study.places else None


def value_of(variable: Variable, level: float) -> float:
    """Return the value of a procedure's variable at a level: the level, or the reference plus or times the level."""
    if variable.level == "value":
        return level
    return variable.reference + level if variable.level == "added" else variable.reference * level


def at_level(study: Study, trial: AdaptiveTrial, level: float) -> tuple[Stimulus, ...]:
    """Return the stimuli of an adaptive trial with the target at `level`, which its procedure has chosen.

    Without a procedure the stimuli are unchanged. Raises InvalidError if the configuration of a stimulus is invalid.
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
    """Return the stimulus if its configuration is valid. Raises InvalidError otherwise."""
    faults = config_faults(document_with(study, (stimulus,)))
    if faults:
        raise InvalidError(
            Problem(path_text(path), f"{text} (levels: {levels_text(stimulus.levels)})") for path, text in faults
        )
    return stimulus


def document_with(study: Study, stimuli: Sequence[Stimulus]) -> dict[str, Json]:
    """Return the configuration (plain data) that presents one stimulus in an interval, or several side by side."""
    found: Json = dict(study.base)
    for stimulus in stimuli:
        found = merge_patch(found, dict(stimulus.changes))
    assert isinstance(found, dict)
    return found


def config_with(study: Study, stimuli: Sequence[Stimulus], rig: Config | None = None) -> Config:
    """Return the validated configuration that presents these stimuli together.

    Servo, device and flight recorder are configured as in `rig`. Raises InvalidError if the configuration is invalid.
    """
    document = document_with(study, stimuli)
    faults = config_faults(document)
    if faults:
        raise InvalidError(Problem(path_text(path), text) for path, text in faults)
    config = Config.parsed(document)
    materials = {**(shipped_materials() if rig is None else rig.materials), **config.materials}
    return (rig or config).model_copy(update={"materials": materials, "scene": config.scene})


def config_faults(document: Mapping[str, Json]) -> list[tuple[Path, str]]:
    """Return the faults of a configuration, including unknown materials, as path and text."""
    try:
        config = Config.parsed(dict(document))
    except ValidationError as error:
        return faults_of(error)
    known = {**shipped_materials(), **config.materials}
    return [(("scene", *path), text) for path, text in reference_faults(config.scene.objects, known)]
