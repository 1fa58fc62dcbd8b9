"""Changes by commands, as the topic `change` publishes them, so that a recording can be rendered again.

The command thread only stores references to immutable objects; the publishing thread makes the maps.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import chain
from typing import Final, NamedTuple, TypeAlias

from hapticd.base.model import Model
from hapticd.config.materials import Material, Materials
from hapticd.config.modes import Attack, Mode
from hapticd.config.scene import Scene, SceneObject, Wall
from hapticd.config.texture import Autoregressive

MAX_LISTED_CHANGES: Final = 1000
"""Largest number of objects, and of materials, that a `change` message lists; a larger change only has `large`."""
MAX_FLIGHT_OBJECTS: Final = 2000
"""Largest number of objects of a scene in a flight file: encoding a larger scene would delay commands."""
MAX_FLIGHT_PARTS: Final = 4000
"""Largest sum of `part_count` over objects and materials in a flight file: more would take tens of megabytes."""
MAX_CHANGE_PARTS: Final = 4000
"""Largest sum of `part_count` over the objects and materials that a change lists."""
_SCENE_KEYS: Final = tuple(name for name in Scene.model_fields if name != "objects")


class Revised(NamedTuple):
    """Differences between a revision of scene and materials and the previous one; None for what was removed."""

    revision: int
    scene: Mapping[str, object]
    """Changed keys of the scene other than `objects`."""
    objects: Mapping[str, SceneObject | None]
    materials: Mapping[str, Material | None]
    complete: tuple[Scene, Materials] | None
    """The new scene and materials if more has changed than a message of the topic `change` lists, otherwise None."""
    rate_hz: float | None = None
    """The new servo rate if it has changed, otherwise None."""


class Played(NamedTuple):
    """A mode struck by the method `play`."""

    tick: int
    mode: Mode
    attack: Attack
    direction: tuple[float, float]
    amplitude_m_per_s2: float


class Reset(NamedTuple):
    """A call of `reset`, which clears contact states of the objects with these ids, or of all objects if None."""

    tick: int
    objects: tuple[str, ...] | None


Change: TypeAlias = Revised | Played | Reset


def change_map(change: Change) -> dict[str, object]:
    """Return a change as the map that the topic `change` publishes (docs/reference/telemetry.md)."""
    match change:
        case Played(tick, mode, attack, direction, amplitude):
            return {
                "tick": tick,
                "play": {
                    "angular_frequency_rad_per_s": mode.angular_frequency_rad_per_s,
                    "decay_rate_per_s": mode.decay_rate_per_s,
                    "attack": attack,
                    "direction": list(direction),
                    "amplitude_m_per_s2": amplitude,
                },
            }
        case Reset(tick, objects):
            return {"tick": tick, "reset": {} if objects is None else {"objects": list(objects)}}
        case Revised(revision, scene, objects, materials, complete, rate_hz):
            if complete is not None:
                return {"revision": revision, "large": True}
            if rate_hz is not None:
                return {"revision": revision, "rate_hz": rate_hz}
            parts: dict[str, dict[str, object]] = {
                "scene": {name: plain(value) for name, value in scene.items()},
                "objects": {id: plain(item) for id, item in objects.items()},
                "materials": {name: plain(material) for name, material in materials.items()},
            }
            return {"revision": revision, **{name: part for name, part in parts.items() if part}}


def plain(value: object) -> object:
    """Return a model as a mapping for JSON; return any other value unchanged."""
    return value.to_dict() if isinstance(value, Model) else value


def part_count(item: Model | None) -> int:
    """Return a measure of an object's or material's encoded size: 1, plus its patches or the models of its texture."""
    match item:
        case Wall():
            return 1 + len(item.patches)
        case Material(texture=Autoregressive() as texture):
            return 1 + len(texture.models)
        case _:
            return 1


def revised(
    revision: int, before: Scene, after: Scene, ids: Collection[str], old: Materials, new: Materials
) -> Revised:
    """Return the differences between two revisions of scene and materials; `ids` name objects that may have changed.

    The result references the scenes only if more has changed than a message lists: many revisions may wait to be sent.
    """
    names: list[str] = []
    if old is not new:
        names = [name for name, item in new.items() if old.get(name) is not item and old.get(name) != item]
        names += [name for name in old if name not in new]
    if max(len(ids), len(names)) > MAX_LISTED_CHANGES or _too_long(after, ids, new, names):
        return Revised(revision, {}, {}, {}, (after, new))
    return Revised(
        revision,
        _changed_keys(before, after),
        {id: after.objects.get(id) for id in ids},
        {name: new.get(name) for name in names},
        None,
    )


def _changed_keys(before: Scene, after: Scene) -> dict[str, object]:
    old, new = before.__dict__, after.__dict__
    return {name: new[name] for name in _SCENE_KEYS if new[name] is not old[name] and new[name] != old[name]}


def _too_long(scene: Scene, ids: Collection[str], materials: Materials, names: Collection[str]) -> bool:
    items = chain(map(scene.objects.get, ids), map(materials.get, names))
    return sum(map(part_count, items)) > MAX_CHANGE_PARTS
