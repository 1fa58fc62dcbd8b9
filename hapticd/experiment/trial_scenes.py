"""The configurations that a trial's stimuli are displayed with, and what of them a participant sees."""

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
    """One for each interval; side by side all stimuli are in one scene. `rig`: servo, device. Raises InvalidError."""
    if study.trial.presentation == "places":
        return (config_with(study, stimuli, rig),)
    return tuple(config_with(study, (each,), rig) for each in stimuli)


def seen(study: Study, configs: Sequence[Config], stimuli: int) -> tuple[Seen, ...]:
    """The surface of each stimulus, in the order of presentation; nothing of its material.

    Side by side they are what stands under the names of the study's places or, where nothing does, what can be touched
    from left to right. Raises HapticdError where a stimulus has no surface.
    """
    if study.trial.presentation == "places":
        found = list(_surfaces(configs[0]))
        by_place = [next((each for name, each in found if name == place), None) for place in study.places]
        named = [each for each in by_place if each is not None]
        ordered = sorted((each for _, each in found), key=lambda each: each.point_m[0])
        return _enough(named if len(named) >= stimuli else ordered, stimuli)
    return tuple(_enough([each for _, each in _surfaces(config)], 1)[0] for config in configs)


def membranes(config: Config) -> tuple[Seen, ...]:
    """The surface of each membrane at rest."""
    found = [target_of(item, config.materials) for item in config.scene.objects.values() if isinstance(item, Membrane)]
    return tuple(Seen(each.point_m, each.normal, each.half_m) for each in found if each is not None)


def _surfaces(config: Config) -> Iterator[tuple[str, Seen]]:
    """What can be touched, by its id; of a wall with patches each patch, by the name of its material."""
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


def _enough(surfaces: Sequence[Seen], wanted: int) -> tuple[Seen, ...]:
    if len(surfaces) < wanted:
        raise HapticdError(
            f"the scene has {len(surfaces)} surfaces for {wanted} stimuli; add a wall, a membrane, a box or a disc"
        )
    return tuple(surfaces[:wanted])
