"""What commands changed, as the topic `change` tells it: with samples and events, all that a replay needs.

The thread that serves commands only keeps references to what is immutable anyway; the maps are made by the one that
sends them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final, NamedTuple, TypeAlias

from hapticd.base.model import Model
from hapticd.config.materials import Material, Materials
from hapticd.config.modes import Attack, Mode
from hapticd.config.scene import Scene, SceneObject, Wall
from hapticd.config.texture import Autoregressive

MAX_LISTED_CHANGES: Final = 1000
"""Objects, or materials, that a change tells of one by one. Of more, whoever wants to know asks for the scene."""
MAX_FLIGHT_OBJECTS: Final = 2000
"""A larger scene stays out of the flight recorder's files: putting it into words would hold up commands."""
MAX_FLIGHT_PIECES: Final = 4000
"""One of more `pieces` does, too: its words would take tens of megabytes."""
MAX_CHANGE_PIECES: Final = 4000
"""The same of objects and materials with their patches and models, `pieces` of each."""


_SCENE_KEYS: Final = tuple(name for name in Scene.model_fields if name != "objects")


class Revised(NamedTuple):
    """A revision of the scene or of the materials: what is new in it, and None for what is gone."""

    revision: int
    scene: Mapping[str, object]
    """Keys beside `objects`."""
    objects: Mapping[str, SceneObject | None]
    materials: Mapping[str, Material | None]
    whole: tuple[Scene, Materials] | None
    """More changed than is published one by one; scene and materials as they are now."""
    rate_hz: float | None = None
    """The servo's from this revision on, where it is another one."""


class Played(NamedTuple):
    """A mode struck by hand."""

    tick: int
    mode: Mode
    attack: Attack
    direction: tuple[float, float]
    amplitude_m_per_s2: float


class Reset(NamedTuple):
    """Contact state cleared; None: of all objects."""

    tick: int
    objects: tuple[str, ...] | None


Change: TypeAlias = Revised | Played | Reset


def change_map(change: Change) -> dict[str, object]:
    """A change as docs/protocol.md describes it."""
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
        case Revised(revision, scene, objects, materials, whole, rate_hz):
            if whole is not None:
                return {"revision": revision, "large": True}
            if rate_hz is not None:
                return {"revision": revision, "rate_hz": rate_hz}
            parts: dict[str, dict[str, object]] = {
                "scene": {name: _plain(value) for name, value in scene.items()},
                "objects": {id: _plain(item) for id, item in objects.items()},
                "materials": {name: _plain(material) for name, material in materials.items()},
            }
            return {"revision": revision, **{name: part for name, part in parts.items() if part}}


def _plain(value: object) -> object:
    return value.to_dict() if isinstance(value, Model) else value


def pieces(item: Model | None) -> int:
    """How much an object or a material is to put into words: itself, its patches, the models of its texture."""
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
    """What a revision changed; `ids` are the objects that may have.

    It keeps what changed, not the scenes, as long as that is little: many of them may wait to be published.
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
    total = 0
    for id in ids:
        total += pieces(scene.objects.get(id))
    for name in names:
        total += pieces(materials.get(name))
    return total > MAX_CHANGE_PIECES
