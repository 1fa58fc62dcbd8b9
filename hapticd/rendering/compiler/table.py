"""The compiler: keeps the table that the tick reads, and rewrites the records of changed objects and materials.

    objects[]    one record for each slot. As long as an object keeps its id and kind, it keeps its slot and generation,
                 and with them its contact state
    materials[]  materials in use, each at its index as long as an object has it
    pieces[]     pieces of walls with patches, one wall after the other; a piece is an interval of one material
    noises[]     noises of materials, each at its index; `numbers` holds their filters

An update of one object takes the same time in a large scene as in a small one. The lowest free index is used first, so
that arrays stay as short as possible. All input has been validated.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, TypeAlias, TypeGuard, assert_never

import numpy as np

from hapticd.base.core import MAX_AGE_PERIODS, OBJECT_DTYPE, CData, PassivityMode, Shape, ffi, pointer
from hapticd.base.steps import Steps
from hapticd.config.materials import Material
from hapticd.config.scene import SURFACE_KINDS, Scene, SceneObject, Surface
from hapticd.rendering.compiler.materials import Effects, Materials
from hapticd.rendering.compiler.records import Places, Records, next_version
from hapticd.rendering.compiler.walls import PatchedWalls
from hapticd.rendering.device_output import Output
from hapticd.rendering.surface_table import SurfaceTable

_OBJECT_RECORD = struct.Struct("=8I6d")
"""Members of `struct hd_object`: eight integers of 32 bits, then six doubles."""
if _OBJECT_RECORD.size != OBJECT_DTYPE.itemsize:
    raise ImportError("compiler/table.py: _OBJECT_RECORD must have the size of struct hd_object (csrc/api/hd_api.h)")

MAX_BRAKED_MOMENTUM_PART: Final = 0.1
"""Largest fraction of the handle's momentum that the passivity controller may remove in a period."""

_PERIOD_TOLERANCE: Final = 1e-6
"""Ages are rounded up to multiples of the period, but down if they exceed a multiple by at most this many periods."""
_NO_FIELD: Final = (0.0,) * 4
"""Force law of an object that is not a field: no force."""
_QUANTA_PER_UNIT: Final = 1 << 1074
"""Every double is an integer multiple of 1/_QUANTA_PER_UNIT."""
_Place: TypeAlias = tuple[float, float, float, float, float, float]
_Owner: TypeAlias = tuple[int, int]
"""Slot and generation, by which an event refers to its object."""
_Field: TypeAlias = tuple[float, float, float, float]
"""Force law of a field: force (x, y), stiffness and damping of F = force - stiffness p - damping v."""

# Strings and integers, because isinstance of a pydantic model, or a member of an enum, costs more than all of a record.
_SURFACE_KINDS: Final = frozenset(SURFACE_KINDS)
_PASSIVITY_MODES: Final = {mode.name.lower(): int(mode) for mode in PassivityMode}
_NONE, _WALL, _MEMBRANE, _BOX, _DISC = map(int, (Shape.NONE, Shape.WALL, Shape.MEMBRANE, Shape.BOX, Shape.DISC))


def _is_surface(item: SceneObject | None) -> TypeGuard[Surface]:
    return item is not None and item.kind in _SURFACE_KINDS


def _place_of(item: Surface) -> tuple[int, _Place]:
    """Return the shape, and point, normal and half extents as csrc/api/hd_api.h defines them."""
    if item.kind == "wall":
        return _WALL, (*item.point_m, *item.normal, 0.0, 0.0)
    if item.kind == "box":
        width, height = item.size_m
        angle = item.angle_rad
        return _BOX, (*item.center_m, -math.sin(angle), math.cos(angle), width / 2.0, height / 2.0)
    if item.kind == "disc":
        return _DISC, (*item.center_m, 0.0, 1.0, item.radius_m, item.radius_m)
    if item.kind == "membrane":
        return _MEMBRANE, (*item.center_m, *item.normal, item.width_m / 2.0, 0.0)
    assert_never(item)


def _field_of(item: SceneObject | None) -> _Field | None:
    """Return the force law of a field; None for a surface."""
    if item is None:
        return None
    if item.kind == "spring":
        stiffness = item.stiffness_n_per_m
        return stiffness * item.center_m[0], stiffness * item.center_m[1], stiffness, item.damping_n_s_per_m
    if item.kind == "viscous":
        return 0.0, 0.0, 0.0, item.damping_n_s_per_m
    if item.kind == "constant":
        return item.force_n[0], item.force_n[1], 0.0, 0.0
    return None


def _quanta(value: float) -> int:
    """Return the value as a multiple of 1/_QUANTA_PER_UNIT, for sums without rounding."""
    numerator, denominator = value.as_integer_ratio()
    return numerator * (_QUANTA_PER_UNIT // denominator)


class Compiler:
    """Keeps the table of one scene up to date.

    Only one thread may use it at a time, except for `name_of` and `events_read`.
    """

    def __init__(self, output: Output, effects: Effects | None = None) -> None:
        """Create an empty table. `effects` are the modes that the device plays as effects; None: no modes."""
        self._objects = Records("struct hd_object", OBJECT_DTYPE)
        self._places = Places()
        self._slots: dict[str, int] = {}
        self._owners: list[tuple[int, str] | None] = []
        """Generation and id, by slot."""
        self._lost: dict[str, _Owner] = {}
        """Slot and generation, before the last update, of the ids that lost them in the update."""
        self._retired: dict[_Owner, str] = {}
        """Ids of removed objects to which unread events may refer."""
        self._retiring: deque[tuple[int, list[_Owner]]] = deque()
        """Revisions and the owners that they removed, the oldest first."""
        self._read_revision: int | None = None
        self._materials = Materials(output, effects)
        self._walls = PatchedWalls(self._materials)
        self._fields: dict[str, _Field] = {}
        self._field_sums = [0, 0, 0, 0]
        """Sums over all fields in 1/_QUANTA_PER_UNIT, updated exactly at each change of a field (docs/adr/0005)."""
        self._changed: set[int] = set()
        self.touched: dict[int, None] = {}
        """Slots of the surfaces that, or whose materials, the last update changed."""
        self._changed_slots = np.zeros(0, np.uint32)
        self._stamp = 0
        self._table: CData = ffi.new("struct hd_table *")
        self._turn_to(output)
        self._table.all_changed = 1

    def turn_to(self, output: Output) -> None:
        """Compile the scene for another output (device and rate), and mark the entire table as changed.

        Slots and generations stay. The next `update` returns the table.
        """
        self._turn_to(output)
        self._stamp = next_version(self._stamp)
        self._mark_made_of(self._materials.turn_to_output(output))
        self._table.all_changed = 1

    def _turn_to(self, output: Output) -> None:
        self._table.period_s = 1.0 / output.rate_hz
        self._table.max_force_n = output.max_force_n
        self._table.max_speed_m_per_s = output.max_speed_m_per_s
        self._table.rearm_m = output.rearm_m
        self._table.report_age = min(math.ceil(output.age_s * output.rate_hz - _PERIOD_TOLERANCE), MAX_AGE_PERIODS)
        known = output.dynamics
        mass_kg = output.effective_mass_kg if known is None else known.handle_mass_kg
        self._table.brake_n_s_per_m = MAX_BRAKED_MOMENTUM_PART * mass_kg * output.rate_hz
        self._table.handle_damping_n_s_per_m = 0.0 if known is None else known.handle_damping_n_s_per_m
        self._table.handle_friction_n = 0.0 if known is None else known.friction_n

    def slot_of(self, id: str) -> tuple[int, int] | None:
        """Return the slot and generation (number of the slot's owner) of a surface; None for a field or unknown id."""
        slot = self._slots.get(id)
        owner = None if slot is None else self._owners[slot]
        return None if slot is None or owner is None else (slot, owner[0])

    @property
    def parts_version(self) -> int:
        """A number that changes when an update changes materials or pieces of walls."""
        return int(self._table.parts_version)

    def slots(self) -> Iterable[int]:
        """Return the slots of all surfaces."""
        return self._slots.values()

    def names_of(self, slots: Iterable[int]) -> list[str]:
        """Return the ids of the surfaces at these slots."""
        owners = self._owners
        return [owner[1] for slot in slots if (owner := owners[slot]) is not None]

    def records_of(self, slots: Iterable[int]) -> Iterator[tuple[Any, ...]]:
        """Return the members of `struct hd_object` for the surfaces at these slots."""
        memory, size = self._objects.memory, _OBJECT_RECORD.size
        return (_OBJECT_RECORD.unpack_from(memory, slot * size) for slot in slots)

    def name_of(self, slot: int, generation: int) -> str | None:
        """Return the id of the object that has, or had, a slot; None some time after the object's events were read.

        May be called from any thread.
        """
        owner = self._owners[slot] if slot < len(self._owners) else None
        if owner is not None and owner[0] == generation:
            return owner[1]
        return self._retired.get((slot, generation))

    def events_read(self, revision: int) -> None:
        """Note that all events up to and including the first tick with this revision of the scene were read.

        The next update releases the names of objects removed by then. May be called from any thread.
        """
        self._read_revision = revision

    def surfaces(self) -> SurfaceTable:
        """Return the arrays that determine the forces of surfaces and fields, valid until the next update."""
        return SurfaceTable(
            self._objects.array[: self._places.count],
            self._materials.rows(),
            self._walls.records,
            float(self._table.field.stiffness_n_per_m),
            float(self._table.field.damping_n_s_per_m),
            self._materials.names(),
        )

    def prepare(self, name: str, material: Material) -> Steps[None]:
        """Compute in advance, filter by filter, the slow parts of an `update` with this material under this name.

        The result of the update does not change.
        """
        return self._materials.prepare(name, material)

    def forget_prepared(self) -> None:
        """Discard the results of `prepare`."""
        self._materials.forget_prepared()

    def changing(self, materials: Mapping[str, Material]) -> list[str]:
        """Return the names of materials in use for which `materials` has another material."""
        return self._materials.changing(materials)

    def update(
        self,
        scene: Scene,
        changed: Iterable[str],
        materials: Mapping[str, Material],
        revision: int,
    ) -> CData:
        """Update the records of the objects `changed` and of all objects with a changed material.

        `changed` are ids of new, changed and removed objects. `materials` defines all materials of the scene, and must
        stay unchanged. Returns the `struct hd_table *`, the same at every call. Its list `changed` grows until
        `published` is called.
        """
        self._lost = {}
        return self._update(scene, list(changed), materials, revision, {})

    def published(self) -> None:
        """Clear the table's list of changes, after the table was published."""
        self._changed.clear()
        self._table.all_changed = 0

    def restore(self, scene: Scene, changed: Iterable[str], materials: Mapping[str, Material], revision: int) -> None:
        """Undo the last update, which was refused: restore the table with its slots and generations.

        The arguments are those with which `update` would restore scene and materials. All of the table is marked as
        changed.
        """
        self._table.all_changed = 1
        former, self._lost = self._lost, {}
        if self._retiring and self._retiring[-1][0] == self._table.revision:
            self._retiring.pop()
        self._update(scene, list(changed), materials, revision, former)

    def _update(
        self,
        scene: Scene,
        ids: list[str],
        materials: Mapping[str, Material],
        revision: int,
        former: Mapping[str, _Owner],
    ) -> CData:
        self._stamp = next_version(self._stamp)
        self.touched = {}
        objects, table = scene.objects, self._table
        fields_changed = False
        # Remove first, so that new objects can use the free slots.
        for id in ids:
            item = objects.get(id)
            surface = _is_surface(item)
            if not surface and id in self._slots:
                self._remove(id)
            before, field = self._fields.pop(id, None), _field_of(item)
            if field is not None:
                self._fields[id] = field
            if field != before:
                fields_changed = True
                for place, (new, old) in enumerate(zip(field or _NO_FIELD, before or _NO_FIELD, strict=True)):
                    self._field_sums[place] += _quanta(new) - _quanta(old)
        self._mark_made_of(self._materials.turn_to(materials))
        for id in ids:
            item = objects.get(id)
            if _is_surface(item):
                self._put(id, item, former.get(id))
        self._retire_names(revision)
        if self._walls.changed or self._materials.changed:
            table.parts_version = self._stamp
            self._changed.update(self._walls.write(table, self._objects.array))
            self._materials.write(table)
        if fields_changed:
            table.field_version = self._stamp
            sums = [total / _QUANTA_PER_UNIT for total in self._field_sums]
            table.field.force_n = sums[:2]
            table.field.stiffness_n_per_m, table.field.damping_n_s_per_m = sums[2:]
        table.revision = revision
        table.display_force = scene.display.force
        table.display_vibration = scene.display.vibration
        table.passivity = _PASSIVITY_MODES[scene.passivity]
        table.ramp_s = scene.ramp_s
        table.ramp_step = table.period_s / scene.ramp_s
        table.object_count = self._places.count
        table.objects = self._objects.pointer
        self._changed_slots = np.fromiter(self._changed, np.uint32, len(self._changed))
        table.changed_count = len(self._changed_slots)
        table.changed = pointer("uint32_t[]", self._changed_slots)
        return table

    def _put(self, id: str, item: Surface, former: _Owner | None) -> None:
        """Write the record of a surface. `former` is the slot and generation to restore, if any."""
        stamp = self._stamp
        shape, place = _place_of(item)
        material = self._materials.use(item.material)
        slot = self._slots.get(id)
        generation = stamp if former is None else former[1]
        pose_version = surface_version = stamp
        first, patched = 0, item if item.kind == "wall" and item.patches else None
        if slot is None:
            slot = self._slots[id] = self._places.take(None if former is None else former[0])
            if slot == len(self._owners):
                self._owners.append(None)
                self._objects.reserve(slot + 1)
            self._owners[slot] = (generation, id)
            self._walls.put(slot, patched)
        else:
            pieces_change = self._walls.put(slot, patched)
            before = _OBJECT_RECORD.unpack_from(self._objects.memory, slot * _OBJECT_RECORD.size)
            if before[3] == shape:
                generation = before[0]
                if before[8:] == place:
                    pose_version = before[1]
                if before[4] == material and not pieces_change:
                    surface_version, first = before[2], before[5]
            else:
                self._retire(slot)
                self._owners[slot] = (generation, id)
            self._materials.release(before[4])
        count = 0 if patched is None else self._walls.count(slot)
        key = (generation, pose_version, surface_version, shape, material, first, count, 0)
        _OBJECT_RECORD.pack_into(self._objects.memory, slot * _OBJECT_RECORD.size, *key, *place)
        self._changed.add(slot)
        self.touched[slot] = None

    def _remove(self, id: str) -> None:
        slot = self._slots.pop(id)
        self._retire(slot)
        self._materials.release(_OBJECT_RECORD.unpack_from(self._objects.memory, slot * _OBJECT_RECORD.size)[4])
        self._walls.put(slot, None)
        _OBJECT_RECORD.pack_into(self._objects.memory, slot * _OBJECT_RECORD.size, self._stamp, *(0,) * 7, *(0.0,) * 6)
        self._places.give(slot)
        self._changed.add(slot)

    def _retire(self, slot: int) -> None:
        """Remove the object that owns a slot, and keep its id until the object's events were read."""
        owner = self._owners[slot]
        assert owner is not None
        generation, id = owner
        self._lost[id] = slot, generation
        self._retired[slot, generation] = id  # before the owner is removed, as another thread may ask for the name
        self._owners[slot] = None

    def _retire_names(self, revision: int) -> None:
        """Keep the names of removed objects until the events of this revision are read, and release older ones."""
        if self._lost:
            self._retiring.append((revision, list(self._lost.values())))
        read = self._read_revision
        while self._retiring and read is not None and (read - self._retiring[0][0]) & 0xFFFFFFFF < 0x80000000:
            for owner in self._retiring.popleft()[1]:
                del self._retired[owner]

    def _mark_made_of(self, materials: list[int]) -> None:
        """Mark the objects that have any of these materials as changed."""
        if not materials:
            return
        array = self._objects.array[: self._places.count]
        touched = np.isin(array["material"], materials) & (array["shape"] != _NONE)
        touched[self._walls.made_of(materials)] = True
        array["surface_version"][touched] = self._stamp
        slots = np.flatnonzero(touched).tolist()
        self._changed.update(slots)
        self.touched.update(dict.fromkeys(slots))
