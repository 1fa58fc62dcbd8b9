"""The configurations that present the stimuli of a trial, and the surfaces that a participant sees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config
from hapticd.config.scene import Membrane, Wall
from hapticd.experiment.front import Seen
from hapticd.experiment.keys import Study
from hapticd.experiment.stimuli import Stimulus, config_with
from hapticd.rendering.joystick import target_of


def configurations(study: Study, stimuli: Sequence[Stimulus], rig: Config | None = None) -> tuple[Config, ...]:
    """Return the configurations that present the stimuli of a trial: one per interval, or one if they are side by side.

    Servo and device are configured as in `rig`. Raises InvalidError if a configuration is invalid.
    """
    if study.trial.presentation == "places":
        return (config_with(study, stimuli, rig),)
    return tuple(config_with(study, (each,), rig) for each in stimuli)


def seen(study: Study, configs: Sequence[Config], stimuli: int) -> tuple[Seen, ...]:
    """Return the surface of each stimulus, in the order of presentation, without its material.

    Stimuli side by side have the surfaces of the objects named like the study's places, or of the patches whose
    material has such a name. If these are too few, the surfaces of all objects are used, from left to right. Raises
    HapticdError if a stimulus has no surface.
    """
    if study.trial.presentation == "places":
        found = list(_surfaces(configs[0]))
        by_place = [next((each for name, each in found if name == place), None) for place in study.places]
        named = [each for each in by_place if each is not None]
        ordered = sorted((each for _, each in found), key=lambda each: each.point_m[0])
        return _first_surfaces(named if len(named) >= stimuli else ordered, stimuli)
    return tuple(_first_surfaces([each for _, each in _surfaces(config)], 1)[0] for config in configs)


def membranes(config: Config) -> tuple[Seen, ...]:
    """Return the surface of each membrane of a configuration, at rest."""
    found = [target_of(item, config.materials) for item in config.scene.objects.values() if isinstance(item, Membrane)]
    return tuple(Seen(each.point_m, each.normal, each.half_m) for each in found if each is not None)


def _surfaces(config: Config) -> Iterator[tuple[str, Seen]]:
    """Yield the id and the surface of each object that can be touched.

    For a wall with patches, yield the material's name and the surface of each patch instead.
    """
    for id, item in config.scene.objects.items():
        target = target_of(item, config.materials)
        if target is None:
            continue
        patches = item.patches if isinstance(item, Wall) else ()
        for patch in patches:
            middle, half = (patch.from_m + patch.to_m) / 2.0, (patch.to_m - patch.from_m) / 2.0
            (x, y), (n_x, n_y) = target.point_m, target.normal
            yield patch.material, Seen((x + middle * n_y, y - middle * n_x), target.normal, half)
        if not patches:
            yield id, Seen(target.point_m, target.normal, target.half_m)


def _first_surfaces(surfaces: Sequence[Seen], wanted: int) -> tuple[Seen, ...]:
    if len(surfaces) < wanted:
        raise HapticdError(
            f"the scene has {len(surfaces)} surfaces, must have {wanted}; add a wall, a membrane, a box or a disc"
        )
    return tuple(surfaces[:wanted])
