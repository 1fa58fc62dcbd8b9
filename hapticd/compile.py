"""From scene and materials to the table that the tick reads: flat C records in the units of a tick.

The compiler keeps a record for each object and rewrites only what changed, so that an update of one object costs the
same in a large scene as in a small one. It also hands out slots: an object keeps its slot and generation, and with
them its contact state, as long as it keeps its id and kind. Validation is over when something gets here.
"""

from __future__ import annotations

import cmath
import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from hapticd.core import CData, ffi
from hapticd.materials import Material, Mode
from hapticd.scene import (
    MAX_OBJECTS,
    Constant,
    Membrane,
    Scene,
    SceneObject,
    Spring,
    Viscous,
    Wall,
)

DISPLAYABLE: Final = 0.4
"""Modes above this fraction of the rate are not displayed as they are (models 1)."""

_KEY = "4I"
_SURFACE = "8d"
_MODE = "9d"
_WALL = struct.Struct("=" + _KEY + _SURFACE + _MODE)
_MEMBRANE = struct.Struct("=" + _KEY + _SURFACE + 2 * _MODE)
if _WALL.size != ffi.sizeof("struct hd_wall") or _MEMBRANE.size != ffi.sizeof("struct hd_membrane"):
    raise ImportError("the records of hapticd.compile are not those of csrc/hd_api.h")

_SILENT: tuple[float, ...] = (0.0,) * 9


@dataclass(frozen=True, slots=True)
class Output:
    """What the device and the rate make of a scene."""

    rate_hz: float
    effective_mass_kg: float
    max_force_n: float
    max_speed_m_per_s: float
    undisplayable: Literal["mute", "lower"]


@dataclass(frozen=True, slots=True)
class Undisplayable:
    """A mode that the rate cannot carry: `shown_hz` is what is displayed in its place, None if nothing is."""

    material: str
    mode: Literal["tap", "rupture"]
    frequency_hz: float
    shown_hz: float | None


def displayed_mode(mode: Mode, output: Output) -> tuple[Mode | None, float]:
    """The mode as the rate can carry it, and the factor on its coefficient that keeps the first peak.

    Above 0.4 of the rate a mode is muted (None) or lowered to 0.4 of the rate (models 1).
    """
    highest = 2.0 * math.pi * DISPLAYABLE * output.rate_hz
    if mode.angular_frequency_rad_per_s <= highest:
        return mode, 1.0
    if output.undisplayable == "mute":
        return None, 1.0
    lowered = Mode(decay_rate_per_s=mode.decay_rate_per_s, angular_frequency_rad_per_s=highest)
    return lowered, mode.peak / lowered.peak


def mode_record(
    mode: Mode, amplitude_per_unit: float, coefficient_per_unit: float, output: Output
) -> tuple[float, ...]:
    """The nine numbers of a `struct hd_mode`, in its order.

    `amplitude_per_unit` (m/s^2 per unit of what excites the mode) is reported, `coefficient_per_unit` is struck.
    """
    shown, factor = displayed_mode(mode, output)
    decay, omega = mode.decay_rate_per_s, mode.angular_frequency_rad_per_s
    force = 0.0
    if shown is not None:
        omega = shown.angular_frequency_rad_per_s
        force = output.effective_mass_kg * coefficient_per_unit * factor
    period = 1.0 / output.rate_hz
    rotor = cmath.exp(complex(-decay * period, omega * period))
    heard = mode if shown is None else shown
    return (
        rotor.real,
        rotor.imag,
        decay,
        omega,
        5.0 / decay,
        heard.peak,
        heard.peak_time_s,
        amplitude_per_unit,
        force,
    )


@dataclass(frozen=True, slots=True)
class _Compiled:
    """A material in the units of a tick."""

    stiffness: float
    damping: float
    rupture_depth: float
    heals: bool
    tap: tuple[float, ...]
    rupture: tuple[float, ...]


def compile_material(material: Material, output: Output) -> _Compiled:
    """The records of a material's modes and the numbers of its surface."""
    tap: tuple[float, ...] = _SILENT
    rupture: tuple[float, ...] = _SILENT
    depth, heals = 0.0, False
    if material.tap is not None:
        slope = material.tap.attack_slope_per_s
        mode = material.tap.mode
        tap = mode_record(mode, slope, mode.coefficient(slope, material.tap.attack), output)
    if material.rupture is not None:
        amplitude = material.rupture.amplitude_m_per_s2
        rupture = mode_record(material.rupture.mode, amplitude, amplitude, output)
        depth, heals = material.rupture.rupture_depth_m, material.rupture.heals
    return _Compiled(material.stiffness_n_per_m, material.damping_n_s_per_m, depth, heals, tap, rupture)


class _Records:
    """Densely packed C records by object id, in memory that C reads in place."""

    def __init__(self, layout: struct.Struct, ctype: str) -> None:
        self._layout = layout
        self._ctype = ctype
        self._ids: list[str] = []
        self._place: dict[str, int] = {}
        self._memory = bytearray()
        self._reserve(16)

    def _reserve(self, capacity: int) -> None:
        memory = bytearray(capacity * self._layout.size)
        used = len(self._ids) * self._layout.size
        if used:
            memory[:used] = self._memory[:used]
        self._memory = memory
        self._capacity = capacity
        self.pointer: CData = ffi.cast(self._ctype + " *", ffi.from_buffer("char[]", memory))

    def __len__(self) -> int:
        return len(self._ids)

    def put(self, id: str, *values: float) -> None:
        place = self._place.get(id)
        if place is None:
            place = self._place[id] = len(self._ids)
            if place == self._capacity:
                self._reserve(2 * self._capacity)
            self._ids.append(id)
        self._layout.pack_into(self._memory, place * self._layout.size, *values)

    def remove(self, id: str) -> None:
        place = self._place.pop(id)
        last = self._ids.pop()
        if last != id:
            size = self._layout.size
            end = len(self._ids) * size
            self._memory[place * size : (place + 1) * size] = self._memory[end : end + size]
            self._ids[place] = last
            self._place[last] = place


@dataclass(slots=True)
class _Placed:
    """An object with a slot."""

    slot: int
    generation: int
    version: int
    kind: str
    surface: tuple[float, ...]


@dataclass(slots=True)
class _Field:
    """What a constant, spring or viscous object adds to the field: F = force - stiffness p - damping v."""

    force_n: tuple[float, float]
    stiffness_n_per_m: float
    damping_n_s_per_m: float


class Compiler:
    """Keeps the table of one scene up to date."""

    def __init__(self, output: Output) -> None:
        self._output = output
        self._walls = _Records(_WALL, "struct hd_wall")
        self._membranes = _Records(_MEMBRANE, "struct hd_membrane")
        self._placed: dict[str, _Placed] = {}
        self._fields: dict[str, _Field] = {}
        self._free = list(range(MAX_OBJECTS - 1, -1, -1))
        self._generation = 0
        self._version = 0
        self._field_version = 0
        self._materials: dict[str, tuple[Material, _Compiled]] = {}
        self._names: dict[tuple[int, int], str] = {}
        self._table: CData = ffi.new("struct hd_table *")
        self._table.period_s = 1.0 / output.rate_hz
        self._table.max_force_n = output.max_force_n
        self._table.max_speed_m_per_s = output.max_speed_m_per_s

    def slot_of(self, id: str) -> tuple[int, int] | None:
        """Slot and generation of a surface; None for a field and for an unknown id."""
        placed = self._placed.get(id)
        return None if placed is None else (placed.slot, placed.generation)

    def name_of(self, slot: int, generation: int) -> str | None:
        """The id of the object that has, or had, a slot; None where it is too long ago."""
        return self._names.get((slot, generation))

    def update(
        self,
        scene: Scene,
        changed: Iterable[str],
        materials: Mapping[str, Material],
        revision: int,
    ) -> CData:
        """Bring the records of the objects `changed` (ids, present in the scene or not) up to date.

        Returns the `struct hd_table *`, which stays valid and is the same one at every call.
        """
        fields_changed = False
        # What goes makes room for what comes: there are as many slots as objects.
        for id in sorted(changed, key=lambda id: id in scene.objects):
            fields_changed |= self._put(id, scene.objects.get(id), materials)
        table = self._table
        table.revision = revision
        table.display_force = scene.display.force
        table.display_vibration = scene.display.vibration
        table.ramp_s = scene.ramp_s
        table.ramp_step = table.period_s / scene.ramp_s
        table.wall_count = len(self._walls)
        table.membrane_count = len(self._membranes)
        table.walls = self._walls.pointer
        table.membranes = self._membranes.pointer
        if fields_changed:
            self._field_version += 1
            fields = self._fields.values()
            table.field_version = self._field_version
            table.field.force_n[0] = math.fsum(field.force_n[0] for field in fields)
            table.field.force_n[1] = math.fsum(field.force_n[1] for field in fields)
            table.field.stiffness_n_per_m = math.fsum(field.stiffness_n_per_m for field in fields)
            table.field.damping_n_s_per_m = math.fsum(field.damping_n_s_per_m for field in fields)
        return table

    def undisplayable(self, materials: Mapping[str, Material]) -> list[Undisplayable]:
        """The modes of these materials that the rate cannot carry."""
        found = []
        for name, material in materials.items():
            tap = material.tap.mode if material.tap is not None else None
            rupture = material.rupture.mode if material.rupture is not None else None
            uses: tuple[tuple[Literal["tap", "rupture"], Mode | None], ...] = (("tap", tap), ("rupture", rupture))
            for use, mode in uses:
                if mode is None:
                    continue
                shown, _ = displayed_mode(mode, self._output)
                if shown is not mode:
                    shown_hz = None if shown is None else shown.frequency_hz
                    found.append(Undisplayable(name, use, mode.frequency_hz, shown_hz))
        return found

    def _material(self, name: str, materials: Mapping[str, Material]) -> _Compiled:
        material = materials[name]
        known = self._materials.get(name)
        if known is None or known[0] is not material:
            known = self._materials[name] = (material, compile_material(material, self._output))
        return known[1]

    def _place(self, id: str, kind: str, surface: tuple[float, ...]) -> _Placed:
        placed = self._placed.get(id)
        if placed is not None and placed.kind == kind:
            if placed.surface != surface:
                self._version += 1
                placed.version = self._version
                placed.surface = surface
            return placed
        self._generation += 1
        self._version += 1
        placed = _Placed(self._free.pop(), self._generation, self._version, kind, surface)
        self._placed[id] = placed
        self._names[placed.slot, placed.generation] = id
        if len(self._names) > 4 * MAX_OBJECTS:
            del self._names[next(iter(self._names))]
        return placed

    def _drop(self, id: str) -> None:
        placed = self._placed.pop(id)
        self._free.append(placed.slot)
        (self._walls if placed.kind == "wall" else self._membranes).remove(id)

    def _put(self, id: str, item: SceneObject | None, materials: Mapping[str, Material]) -> bool:
        """One object; whether the field changed."""
        placed = self._placed.get(id)
        if placed is not None and (item is None or item.kind != placed.kind):
            self._drop(id)
        before = self._fields.pop(id, None)
        if isinstance(item, Wall):
            material = self._material(item.material, materials)
            surface = (*item.point_m, *item.normal, material.stiffness, material.damping, 0.0, 0.0)
            placed = self._place(id, "wall", surface)
            self._walls.put(id, placed.slot, placed.generation, placed.version, 0, *surface, *material.tap)
        elif isinstance(item, Membrane):
            material = self._material(item.material, materials)
            width, depth = item.width_m / 2.0, material.rupture_depth
            surface = (*item.center_m, *item.normal, material.stiffness, material.damping, width, depth)
            placed = self._place(id, "membrane", surface)
            key = (placed.slot, placed.generation, placed.version, int(material.heals))
            self._membranes.put(id, *key, *surface, *material.tap, *material.rupture)
        elif item is not None:
            self._fields[id] = _field_of(item)
        return before != self._fields.get(id)


def _field_of(item: Spring | Viscous | Constant) -> _Field:
    if isinstance(item, Spring):
        stiffness = item.stiffness_n_per_m
        force = (stiffness * item.center_m[0], stiffness * item.center_m[1])
        return _Field(force, stiffness, item.damping_n_s_per_m)
    if isinstance(item, Viscous):
        return _Field((0.0, 0.0), 0.0, item.damping_n_s_per_m)
    return _Field((item.force_n[0], item.force_n[1]), 0.0, 0.0)
