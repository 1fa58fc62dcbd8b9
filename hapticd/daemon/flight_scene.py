"""The scene at the oldest sample that the flight recorder keeps, and the changes since.

Only the telemetry thread uses this module. Memory is bounded: while the weight of all kept changes exceeds
MAX_KEPT_WEIGHT, the oldest change is applied to the scene. Samples from before that change cannot be rendered again.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import chain
from typing import Final, NamedTuple

from hapticd.base.merge_patch import replace_members
from hapticd.config.materials import Material, Materials
from hapticd.config.scene import Scene, SceneObject
from hapticd.protocol.changes import (
    MAX_FLIGHT_OBJECTS,
    MAX_FLIGHT_PARTS,
    Change,
    Played,
    Reset,
    Revised,
    change_map,
    part_count,
    plain,
)

MAX_KEPT_WEIGHT: Final = 4000
"""Largest sum of the sizes (`_weight`) of the kept changes."""


class _Base(NamedTuple):
    """The scene at the oldest kept sample: keys of the scene other than `objects`, objects by id, materials by name."""

    shown: dict[str, object]
    objects: dict[str, SceneObject]
    materials: dict[str, Material]

    def is_too_large(self) -> bool:
        """Return whether the scene is too large for a file of the flight recorder."""
        everything = chain(self.objects.values(), self.materials.values())
        return len(self.objects) > MAX_FLIGHT_OBJECTS or sum(map(part_count, everything)) > MAX_FLIGHT_PARTS


@dataclass(frozen=True, slots=True)
class History:
    """Scene and changes for a flight recorder's file, copied for the writer thread, which converts them to maps."""

    revision: int
    rate_hz: float
    base: _Base | None
    """The scene at the beginning; None: it is too large or unknown."""
    changes: tuple[Change, ...]
    complete_from: int
    """The tick from which on `changes` has every play and reset."""

    def texts(self) -> dict[str, object]:
        """Return `scene` and `materials` at the oldest sample, as in recordings; both None if too large or unknown."""
        if self.base is None:
            return {"scene": None, "materials": None}
        objects = {id: item.to_dict() for id, item in self.base.objects.items()}
        shown = {name: plain(value) for name, value in self.base.shown.items()}
        materials = {name: material.to_dict() for name, material in self.base.materials.items()}
        return {"scene": {**shown, "objects": objects}, "materials": materials}

    def change_maps(self) -> list[dict[str, object]]:
        """Return `changes` as in recordings; the first entry has the revision and the rate at the oldest sample."""
        first: dict[str, object] = {"revision": self.revision, "rate_hz": self.rate_hz}
        return [first, *map(change_map, self.changes)]

    def missing(self, revisions: set[int]) -> list[int]:
        """Return those of the samples' `revisions` whose scene is unknown, sorted."""
        known = {change.revision for change in self.changes if isinstance(change, Revised)}
        return sorted(revisions - known - {self.revision})


class FlightScene:
    """Keeps the scene at the oldest kept sample, and all later changes."""

    def __init__(self, scene: Scene, materials: Materials, revision: int, rate_hz: float) -> None:
        """Begin with the scene, the materials, the revision (number of the last change) and the rate in force."""
        self._rate_hz = rate_hz
        self._revision = revision
        self._base = _base_of(scene, materials)
        self._lost = False
        """Whether a revision is missing, so that the scene is unknown until a change has the complete scene."""
        self._changes: deque[Change] = deque()
        self._weight = 0
        self._complete_from = 0
        self.newest = revision
        """The newest known revision."""

    def take(self, change: Change) -> None:
        """Add a change of the scene, a play or a reset that a command made."""
        if isinstance(change, Revised):
            if change.complete is not None:
                # The change has a complete scene, which replaces everything before it.
                while self._changes:
                    self._drop()
                self._base, self._lost = _base_of(*change.complete), False
                self._revision = self.newest = change.revision
                return
            if change.revision != (self.newest + 1) & 0xFFFFFFFF:
                self._lost = True
            self.newest = change.revision
        self._changes.append(change)
        self._weight += _weight(change)
        while self._weight > MAX_KEPT_WEIGHT:
            self._drop()

    def forget(self, tick: int, revision: int) -> None:
        """Apply and remove the changes up to the oldest kept sample, which has this tick and revision."""
        while self._changes and _took_effect(self._changes[0], tick, revision):
            self._drop()

    def knows(self, revision: int) -> bool:
        """Return whether the change to `revision` was added; it may come after the first sample with that revision."""
        return _ahead(self.newest, revision) >= 0

    def history(self) -> History:
        """Return a copy of the scene and the kept changes."""
        known = not self._lost and not self._base.is_too_large()
        base = _Base(*map(dict, self._base)) if known else None  # type: ignore[arg-type]
        return History(self._revision, self._rate_hz, base, tuple(self._changes), self._complete_from)

    def _drop(self) -> None:
        """Remove the oldest change and apply it to the scene at the beginning."""
        change = self._changes.popleft()
        self._weight -= _weight(change)
        if not isinstance(change, Revised):
            self._complete_from = max(self._complete_from, change.tick + 1)
            return
        self._revision = change.revision
        if change.rate_hz is not None:
            self._rate_hz = change.rate_hz
        self._base.shown.update(change.scene)
        replace_members(self._base.objects, change.objects)
        replace_members(self._base.materials, change.materials)


def _base_of(scene: Scene, materials: Materials) -> _Base:
    shown = {name: getattr(scene, name) for name in Scene.model_fields if name != "objects"}
    return _Base(shown, dict(scene.objects), dict(materials))


def _weight(change: Change) -> int:
    """Return a measure of a change's size: 1, plus the `part_count` of its parts or the number of its reset ids."""
    match change:
        case Played():
            return 1
        case Reset(_, objects):
            return 1 + len(objects or ())
        case Revised():
            return 1 + sum(map(part_count, chain(change.objects.values(), change.materials.values())))


def _took_effect(change: Change, tick: int, revision: int) -> bool:
    """Return whether a play or reset took effect before `tick`, or a revision is not later than `revision`."""
    if isinstance(change, Revised):
        return _ahead(revision, change.revision) >= 0
    return change.tick < tick


def _ahead(one: int, other: int) -> int:
    """Return the signed difference of two revisions, which wrap around at 2^32."""
    ahead = (one - other) & 0xFFFFFFFF
    return ahead if ahead < 0x80000000 else ahead - 0x100000000
