"""The materials that objects of a scene are made of: their records, their noises, and the numbers of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Protocol, cast

import numpy as np
import numpy.typing as npt

from hapticd.base.core import MATERIAL_DTYPE, NOISE_DTYPE, CData, ffi, pointer, records
from hapticd.base.steps import Steps
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.texture import Autoregressive, Stochastic
from hapticd.rendering.compiler.material_record import material_record, numbers_of, struck_modes
from hapticd.rendering.compiler.mode_record import Effect
from hapticd.rendering.compiler.noise_filters import SILENCE, Design, Noise, design
from hapticd.rendering.compiler.records import Places, Records, next_version
from hapticd.rendering.device_output import Output

_NO_MATERIAL: Final = Material(stiffness_n_per_m=0.0)


class Effects(Protocol):
    """What a device plays itself."""

    def take(self, mode: Mode) -> Effect | None:
        """A mode is used from now on; what is played in its place."""
        ...

    def give(self, mode: Mode) -> None:
        """It is used by one thing less."""
        ...


class _NoEffects:
    def take(self, mode: Mode) -> Effect | None:
        return None

    def give(self, mode: Mode) -> None:
        pass


class Materials:
    """The materials that are used: a record and an index for each, kept as long as anything is made of it."""

    def __init__(self, output: Output, beat: Callable[[], None], effects: Effects | None) -> None:
        """`beat` is called between the filters that nobody prepared, of which many take seconds."""
        self.output = output
        self._beat = beat
        self._effects = effects or _NoEffects()
        self._struck: dict[int, tuple[Mode, ...]] = {}
        """Material to the modes that it uses of those."""
        self._places = Places()
        self._index: dict[str, int] = {}
        self._names: list[str] = []
        self._uses: list[int] = []
        self._known: list[Material] = []
        self._source: Mapping[str, Material] = {}
        self._rows = Records("struct hd_material", MATERIAL_DTYPE)
        self._noise_places = Places()
        self._noise_of: dict[int, int] = {}
        """Material to noise."""
        self._heard: dict[int, tuple[Stochastic | Autoregressive, int, Design]] = {}
        """Material to what its noise is made of, the version of that, and its filters."""
        self._own_numbers: dict[int, tuple[tuple[str, npt.NDArray[np.float64]], ...]] = {}
        """Material to what `numbers_of` finds, where it finds anything."""
        self._prepared: dict[tuple[Noise, Output], Design] = {}
        """Designed for the change that is being made."""
        self._versions = 0
        self._noises = records(NOISE_DTYPE, 0)
        self._numbers = np.zeros(0)
        self._numbers_changed = False
        self.changed = False
        """Since `write` was called."""

    def turn_to(self, source: Mapping[str, Material]) -> list[int]:
        """Takes materials from `source` from now on, which stays as it is; the indices whose material changed."""
        if source is self._source:
            return []
        self._source = source
        stale = []
        for name, index in self._index.items():
            material = source.get(name, self._known[index])
            if material is not self._known[index] and material != self._known[index]:
                stale.append(index)
            self._known[index] = material
        for index in stale:
            self._compile(index)
        return stale

    def turn_to_output(self, output: Output) -> list[int]:
        """Compiles everything for another output; the indices of all that is used."""
        self.output = output
        self._heard.clear()
        used = sorted(self._index.values())
        for index in used:
            self._compile(index)
        return used

    def names(self) -> tuple[str, ...]:
        """By index."""
        return tuple(self._names)

    def use(self, name: str) -> int:
        """The index of a material that one thing more is made of."""
        index = self._index.get(name)
        if index is None:
            index = self._index[name] = self._places.take()
            if index == len(self._names):
                self._names.append(name)
                self._uses.append(0)
                self._known.append(self._source[name])
                self._rows.reserve(index + 1)
            else:
                self._names[index], self._known[index] = name, self._source[name]
            self._compile(index)
        self._uses[index] += 1
        return index

    def release(self, index: int) -> None:
        """One thing less is made of it."""
        self._uses[index] -= 1
        if self._uses[index] == 0:
            del self._index[self._names[index]]
            self._known[index] = _NO_MATERIAL  # one of 64 models would be kept
            self._places.give(index)
            self._silence(index)
            self._give_up(index)
            self._rows.pointer[index] = ffi.new("struct hd_material *")[0]
            self.changed = True

    def _compile(self, index: int) -> None:
        material = self._known[index]
        if isinstance(material.texture, Stochastic | Autoregressive):
            if index not in self._noise_of:
                self._noise_of[index] = self._noise_places.take()
            if index not in self._heard or self._heard[index][0] != material.texture:
                design = self._designed(material.texture)
                self._versions = next_version(self._versions)
                self._heard[index] = material.texture, self._versions, design
                self._numbers_changed = True
        else:
            self._silence(index)
        self._give_up(index)
        numbers = tuple(numbers_of(material, self.output))
        if numbers:
            self._own_numbers[index] = numbers
            self._numbers_changed = True
        effects = {mode: self._effects.take(mode) for mode in struck_modes(material)}
        self._struck[index] = tuple(effects)
        self._rows.pointer[index] = material_record(material, self._noise_of.get(index, 0), self.output, effects)[0]
        self.changed = True

    def _give_up(self, index: int) -> None:
        self._numbers_changed |= self._own_numbers.pop(index, None) is not None
        for mode in self._struck.pop(index, ()):
            self._effects.give(mode)

    def _designed(self, texture: Noise) -> Design:
        found = self._prepared.get((texture, self.output))
        if found is not None:
            return found
        steps = design(texture, self.output)
        while True:
            self._beat()
            try:
                next(steps)
            except StopIteration as end:
                return cast(Design, end.value)

    def prepare(self, name: str, material: Material) -> Steps[None]:
        """Finds what takes long of a material that is to be compiled under this name: filters, compensated shapes, the
        spectrum of a waveform. Pauses after each filter, and after the rest."""
        index, output = self._index.get(name), self.output
        known = None if index is None else self._known[index]
        if known is material:
            return
        texture = material.texture
        heard = known is not None and known.texture == texture
        if isinstance(texture, Stochastic | Autoregressive) and not heard:
            self._prepared[texture, output] = yield from design(texture, output)
        # What these find is kept by the functions that they call.
        material_record(material, 0, output, dict.fromkeys(struck_modes(material)))
        for _ in numbers_of(material, output):
            yield
        yield

    def forget_prepared(self) -> None:
        """The change is made, or given up."""
        self._prepared = {}

    def changing(self, source: Mapping[str, Material]) -> list[str]:
        """The names in use of which `source` has another material."""
        if source is self._source:
            return []
        places = self._index.items()
        return [name for name, index in places if source.get(name, self._known[index]) is not self._known[index]]

    def _silence(self, index: int) -> None:
        place = self._noise_of.pop(index, None)
        if place is not None:
            del self._heard[index]
            self._noise_places.give(place)
            self._numbers_changed = True

    def rows(self) -> npt.NDArray[np.void]:
        """The records, at their indices."""
        return self._rows.array[: self._places.count]

    def write(self, table: CData) -> None:
        """Puts materials, noises and numbers into a table."""
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
        """All noises and their numbers, and those of the materials. A place that is free is silent."""
        self._noises = records(NOISE_DTYPE, self._noise_places.count)
        used = {place: index for index, place in self._noise_of.items()}
        numbers: list[npt.NDArray[np.float64]] = []
        first = 0
        for place, record in enumerate(pointer("struct hd_noise[]", self._noises)):
            design = SILENCE
            if place in used:
                texture, record.version, design = self._heard[used[place]]
                record.along_normal = texture.direction == "normal"
                record.seed = texture.seed
                record.threshold_m_per_s = texture.threshold_m_per_s
                if isinstance(texture, Stochastic):
                    record.velocity_gain_per_s = texture.velocity_gain_per_s
                    record.force_gain_m_per_s2_per_n = texture.force_gain_m_per_s2_per_n
            record.order, record.taps = design.order, design.taps
            record.speed_count, record.force_count = len(design.speeds), len(design.forces)
            record.first = first
            record.force_per_unit = 0.0 if design.muted else self.output.effective_mass_kg
            numbers.append(design.numbers())
            first += len(numbers[-1])
        for index, each in self._own_numbers.items():
            for key, own in each:
                setattr(self._rows.pointer[index], key, first)
                numbers.append(own)
                first += len(own)
        self._numbers = np.concatenate(numbers) if numbers else np.zeros(0)
