"""The materials of a scene's objects: their records, their noises, and the arrays of both in the table's `numbers`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from hapticd.base.core import MATERIAL_DTYPE, NOISE_DTYPE, CData, ffi, pointer, records
from hapticd.base.steps import Steps, finish
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.texture import Autoregressive, Stochastic
from hapticd.rendering.compiler.material_record import Numbers, material_record, struck_modes
from hapticd.rendering.compiler.mode_record import Effect
from hapticd.rendering.compiler.noise_filters import MUTED_DESIGN, Design, Noise, design
from hapticd.rendering.compiler.records import Places, Records, next_version
from hapticd.rendering.device_output import Output


class Effects(Protocol):
    """Modes that a device plays as effects, in place of the servo."""

    def take(self, mode: Mode) -> Effect | None:
        """Register a use of a mode; return the effect that the device plays in its place, or None."""
        ...

    def give(self, mode: Mode) -> None:
        """Remove a use of a mode that `take` registered."""
        ...


@dataclass(slots=True)
class _Used:
    """A material that objects of the scene have, and its records in the table."""

    name: str
    material: Material
    uses: int = 0
    noise: int | None = None
    """Index of the material's noise."""
    filters: tuple[Noise, int, Design] | None = None
    """Texture of the noise, version of the filters, and the filters."""
    numbers: Numbers = field(default_factory=dict)
    struck: tuple[Mode, ...] = ()
    """The modes of the material whose use is registered with the effects."""


class Materials:
    """The records of the materials in use. A material keeps its index as long as an object has the material."""

    def __init__(self, output: Output, effects: Effects | None) -> None:
        self.output = output
        self._effects = effects
        self._places, self._noise_places = Places(), Places()
        self._used: dict[int, _Used] = {}
        """Materials in use, by index."""
        self._index: dict[str, int] = {}
        self._source: Mapping[str, Material] = {}
        self._rows = Records("struct hd_material", MATERIAL_DTYPE)
        self._prepared: dict[tuple[Noise, Output], Design] = {}
        """Filters that `prepare` designed for the next update."""
        self._versions = 0
        self._noises = records(NOISE_DTYPE, 0)
        self._numbers = np.zeros(0)
        self._numbers_changed = False
        self.changed = False
        """Whether anything changed since the last `write`."""

    def turn_to(self, source: Mapping[str, Material]) -> list[int]:
        """Replace all materials by those of `source`, which must stay unchanged; return the indices that changed."""
        if source is self._source:
            return []
        self._source = source
        stale = []
        for index, used in self._used.items():
            material, before = source.get(used.name, used.material), used.material
            used.material = material
            if material is not before and material != before:
                stale.append(index)
        for index in stale:
            self._compile(index)
        return stale

    def turn_to_output(self, output: Output) -> list[int]:
        """Compile all materials in use for another output (device and rate); return their indices."""
        self.output = output
        used = sorted(self._used)
        for index in used:
            self._used[index].filters = None
            self._compile(index)
        return used

    def names(self) -> tuple[str, ...]:
        """Return the names of the materials in the order of their indices, "" for a free index."""
        return tuple(self._used[index].name if index in self._used else "" for index in range(self._places.count))

    def use(self, name: str) -> int:
        """Count one more use of a material, and return its index."""
        index = self._index.get(name)
        if index is None:
            index = self._index[name] = self._places.take()
            self._used[index] = _Used(name, self._source[name])
            self._rows.reserve(index + 1)
            self._compile(index)
        self._used[index].uses += 1
        return index

    def release(self, index: int) -> None:
        """Count one use of a material less; after the last use, free its index."""
        used = self._used[index]
        used.uses -= 1
        if used.uses == 0:
            self._release_noise(used)
            self._release_record_parts(used)
            del self._index[used.name], self._used[index]
            self._places.give(index)
            self._rows.pointer[index] = ffi.new("struct hd_material *")[0]
            self.changed = True

    def _compile(self, index: int) -> None:
        used = self._used[index]
        material, texture = used.material, used.material.texture
        if isinstance(texture, Stochastic | Autoregressive):
            if used.noise is None:
                used.noise = self._noise_places.take()
            if used.filters is None or used.filters[0] != texture:
                designed = self._designed(texture)
                self._versions = next_version(self._versions)
                used.filters = texture, self._versions, designed
                self._numbers_changed = True
        else:
            self._release_noise(used)
        self._release_record_parts(used)
        effects: dict[Mode, Effect | None] = {}
        if self._effects is not None:
            effects = {mode: self._effects.take(mode) for mode in struck_modes(material)}
        used.struck = tuple(effects)
        record, used.numbers = material_record(material, used.noise or 0, self.output, effects)
        self._rows.pointer[index] = record[0]
        self._numbers_changed |= bool(used.numbers)
        self.changed = True

    def _release_record_parts(self, used: _Used) -> None:
        """Release the arrays and effects of a material's record, but not its noise."""
        self._numbers_changed |= bool(used.numbers)
        for mode in used.struck:
            assert self._effects is not None
            self._effects.give(mode)
        used.numbers, used.struck = {}, ()

    def _release_noise(self, used: _Used) -> None:
        if used.noise is not None:
            self._noise_places.give(used.noise)
            used.noise = used.filters = None
            self._numbers_changed = True

    def _designed(self, texture: Noise) -> Design:
        found = self._prepared.get((texture, self.output))
        return finish(design(texture, self.output)) if found is None else found

    def prepare(self, name: str, material: Material) -> Steps[None]:
        """Compute in advance the slow parts of the compilation of a material under this name.

        These are filters (one per step), compensated shapes, and the spectrum of a waveform.
        """
        used = self._used.get(self._index.get(name, -1))
        if used is not None and used.material is material:
            return
        texture = material.texture
        unchanged = used is not None and used.material.texture == texture
        if isinstance(texture, Stochastic | Autoregressive) and not unchanged:
            self._prepared[texture, self.output] = yield from design(texture, self.output)
        # The functions that this calls cache their results.
        material_record(material, 0, self.output)
        yield

    def forget_prepared(self) -> None:
        """Discard the filters that `prepare` designed."""
        self._prepared = {}

    def changing(self, source: Mapping[str, Material]) -> list[str]:
        """Return the names of materials in use for which `source` has another material."""
        if source is self._source:
            return []
        return [used.name for used in self._used.values() if source.get(used.name, used.material) is not used.material]

    def rows(self) -> npt.NDArray[np.void]:
        """Return the records of the materials, by index."""
        return self._rows.array[: self._places.count]

    def write(self, table: CData) -> None:
        """Put the records of materials and noises, and their array `numbers`, into a table."""
        if self._numbers_changed:
            self._rebuild_numbers()
        table.material_count = self._places.count
        table.materials = self._rows.pointer
        table.noise_count = len(self._noises)
        table.noises = pointer("struct hd_noise[]", self._noises)
        table.number_count = len(self._numbers)
        table.numbers = pointer("double[]", self._numbers)
        self.changed = self._numbers_changed = False

    def _rebuild_numbers(self) -> None:
        """Rebuild all noises and the array `numbers`. The noise at an unused index is silent."""
        self._noises = records(NOISE_DTYPE, self._noise_places.count)
        filters_by_noise = {used.noise: used.filters for used in self._used.values()}
        numbers: list[npt.NDArray[np.float64]] = []
        first = 0
        for place, record in enumerate(pointer("struct hd_noise[]", self._noises)):
            designed, made_of = MUTED_DESIGN, filters_by_noise.get(place)
            if made_of is not None:
                texture, record.version, designed = made_of
                record.along_normal = texture.direction == "normal"
                record.seed = texture.seed
                record.threshold_m_per_s = texture.threshold_m_per_s
                if isinstance(texture, Stochastic):
                    record.velocity_gain_per_s = texture.velocity_gain_per_s
                    record.force_gain_m_per_s2_per_n = texture.force_gain_m_per_s2_per_n
            record.order, record.taps = designed.order, designed.taps
            record.speed_count, record.force_count = len(designed.speeds), len(designed.forces)
            record.first = first
            record.force_per_unit = 0.0 if designed.muted else self.output.effective_mass_kg
            numbers.append(designed.numbers())
            first += len(numbers[-1])
        for index, used in self._used.items():
            for key, own in used.numbers.items():
                setattr(self._rows.pointer[index], key, first)
                numbers.append(own)
                first += len(own)
        self._numbers = np.concatenate(numbers) if numbers else np.zeros(0)
