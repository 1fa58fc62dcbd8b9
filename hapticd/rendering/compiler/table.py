"""From scene and materials to the table that the tick reads: flat C records in the units of a tick.

    objects[]    one record a slot. An object keeps its slot, and with generation and slot its contact state, as long as
                 it keeps its id and kind
    materials[]  those that objects are made of, each at its index as long as anything is made of it
    pieces[]     of the walls with patches, wall after wall
    noises[]     of the materials that sound, each at its index; `numbers` holds their filters

The compiler rewrites only what changed, so that an update of one object costs the same in a large scene as in a small
one. Places are handed out lowest first, so that the arrays stay as dense as their fullest time made them. Validation is
over when something gets here.
"""

from __future__ import annotations

import cmath
import heapq
import math
import struct
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from functools import lru_cache
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol, TypeAlias, TypeGuard, cast

import numpy as np
import numpy.typing as npt

from hapticd.base import lattice
from hapticd.base.core import (
    KICKS,
    MATERIAL_DTYPE,
    NOISE_DTYPE,
    OBJECT_DTYPE,
    PASSIVITY_AGE_MAX,
    PIECE_DTYPE,
    CData,
    PassivityMode,
    Shape,
    Texture,
    ffi,
    pointer,
    records,
)
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.patches import Patch
from hapticd.config.scene import Scene, SceneObject, Surface, Wall
from hapticd.config.texture import Autoregressive, AutoregressiveModel, Grooves, Stochastic
from hapticd.config.waveform import Waveform
from hapticd.rendering import filter_design
from hapticd.rendering.compensation import Ringing
from hapticd.rendering.compensation import Shape as Struck
from hapticd.rendering.compiler.retired_names import Gone
from hapticd.rendering.contact_sets import Parts
from hapticd.rendering.displayability import (
    TOUCHED_N_PER_M,
    UNTOUCHED,
    Touched,
    displayed_mode,
    displayed_pair,
    displayed_wave_rate,
    modes_of,
    struck_shapes,
    touched_by,
    waveform_of,
)
from hapticd.rendering.groove_tuning import shapes_needed, tuning_of
from hapticd.rendering.output import Output
from hapticd.rendering.tap_tuning import tap_shapes_needed, tap_tuning_of

_RECORD = struct.Struct("=8I6d")
if _RECORD.size != OBJECT_DTYPE.itemsize:
    raise ImportError("the records of hapticd.rendering.compiler.table are not those of csrc/api/hd_api.h")

PASSIVITY_BRAKE: Final = 0.1
"""The passivity controller takes at most this part of a handle's momentum in a period."""

_SAME_PERIOD: Final = 1e-6
_LARGEST: Final = 0xFFFFFFFF
_QUANTUM: Final = 1 << 1074
"""Every double is a whole number of 1/_QUANTUM."""

_Place: TypeAlias = tuple[float, float, float, float, float, float]


Effect: TypeAlias = tuple[int, float, float]
"""What a device plays in place of a mode: its id, its largest level over the coefficient, and how long, s."""


class Progress(Protocol):
    """Who is told how many filters are designed."""

    done: int
    of: int

    def step(self) -> None:
        """Called often; what it raises ends the work."""
        ...


class Effects(Protocol):
    """What a device plays by itself."""

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


def mode_record(
    mode: Mode,
    amplitude_per_unit: float,
    coefficient_per_unit: float,
    output: Output,
    effect: Effect | None = None,
    touched: Touched = UNTOUCHED,
) -> tuple[float | list[float], ...]:
    """The numbers of a `struct hd_mode`, in its order. `touched`: the surface that its compensation is chosen
    for; what presses in fact is known when it is struck.

    `amplitude_per_unit` (m/s^2 per unit of what excites the mode) is reported, `coefficient_per_unit` is struck.
    """
    shown, factor = displayed_mode(mode, output)
    decay, omega = mode.decay_rate_per_s, mode.angular_frequency_rad_per_s
    whole_force = output.effective_mass_kg * coefficient_per_unit
    force = 0.0
    shapes: tuple[Struck, Struck] | None = None
    if shown is not None:
        omega = shown.angular_frequency_rad_per_s
        force = whole_force * factor
        shapes = struck_shapes(shown, output, touched)
    period = 1.0 / output.rate_hz
    rotor = cmath.exp(complex(-decay * period, omega * period))
    heard = mode if shown is None else shown
    peak, peak_time_s, gain, tail = heard.peak, heard.peak_time_s, complex(1.0), _NO_TAIL
    free, kicks = _NO_FREE, _NO_KICKS
    if shapes is not None:
        assert output.dynamics is not None
        untouched, shape = shapes
        force = output.dynamics.mass_kg * coefficient_per_unit * factor
        peak, peak_time_s, gain = shape.peak, shape.peak_time_s, shape.mode.gain
        tail = _NO_TAIL if shape.tail is None else _tail_record(shape.tail, period)
        other, its_tail = untouched.mode.gain, 0j if untouched.tail is None else untouched.tail.gain
        if shape.kicks:
            kicks = ([number for pair in shape.kicks for number in pair], len(shape.kicks), 0)
        met_n_per_m = touched.stiffness_n_per_m or TOUCHED_N_PER_M
        free = (met_n_per_m, untouched.peak, other.real, other.imag, its_tail.real, its_tail.imag)
    return (
        rotor.real,
        rotor.imag,
        decay,
        omega,
        5.0 / decay,
        peak,
        peak_time_s,
        amplitude_per_unit,
        force,
        gain.real,
        gain.imag,
        *tail,
        *free,
        *kicks,
        *((0, 0, 0.0, 0.0, 0.0) if effect is None else (effect[0], 0, whole_force, effect[1], effect[2])),
    )


_NO_TAIL: Final[tuple[float, ...]] = (0.0,) * 7
_NO_FREE: Final[tuple[float, ...]] = (0.0,) * 6
_ACROSS: Final = (1.0, 0.0)
"""A tap's and a rupture's aim unless another is given, which the core takes for granted."""
_NO_KICKS: Final[tuple[list[float], int, int]] = ([0.0] * (2 * KICKS), 0, 0)


_SIGNED: Final = (
    *("gain_re", "gain_im", "tail_re", "tail_im"),
    *("free_gain_re", "free_gain_im", "free_tail_re", "free_tail_im"),
)


def _tail_record(tail: Ringing, period_s: float) -> tuple[float, ...]:
    rotor = cmath.exp(tail.pole * period_s)
    decay, omega = -tail.pole.real, tail.pole.imag
    return rotor.real, rotor.imag, decay, omega, tail.end_s, tail.gain.real, tail.gain.imag


def _struck(material: Material) -> Iterator[Mode]:
    """The modes that a device may play by itself."""
    if material.tap is not None and material.tap.one_mode is not None:
        yield material.tap.one_mode
    if material.rupture is not None:
        yield material.rupture.mode


def _play(record: CData, waveform: Waveform, slope: float, coefficient: float, output: Output) -> None:
    """A tap that plays a waveform."""
    rate_hz = displayed_wave_rate(waveform, output)
    shown_hz = waveform.rate_hz if rate_hz is None else rate_hz
    tap, slowed = record.tap, waveform.rate_hz / shown_hz
    tap.end_s = waveform.length_s * slowed
    tap.peak, tap.peak_time_s = waveform.curve.peak, waveform.curve.peak_time_s * slowed
    tap.amplitude_per_unit = slope
    tap.force_per_unit = 0.0 if rate_hz is None else output.effective_mass_kg * coefficient
    tap.gain_re = 1.0
    record.wave_rate_hz, record.wave_count = shown_hz, len(waveform.samples)


def _numbers_of(material: Material, output: Output) -> Iterator[tuple[str, npt.NDArray[np.float64]]]:
    """What a material has in the table's numbers: the member of its record that says where they begin, and they."""
    if material.tap is not None and material.tap.amplitudes is not None:
        yield "tap_first", np.array(material.tap.amplitudes).T.ravel()
    tuning, tap_tuning, waveform = tuning_of(material, output), tap_tuning_of(material, output), waveform_of(material)
    if tuning is not None:
        yield "tune_first", tuning.numbers()
    if tap_tuning is not None:
        yield "mode_first", tap_tuning.numbers()
    if waveform is not None:
        yield "wave_first", waveform.curve.numbers()


def material_record(
    material: Material, noise_index: int, output: Output, effects: Mapping[Mode, Effect | None] = MappingProxyType({})
) -> CData:
    """A `struct hd_material *`, of which only the places of its numbers are missing (`_numbers_of`); `noise_index` is
    where its noise is, for a texture that is noise; `effects` are what a device plays by itself."""
    record = ffi.new("struct hd_material *")
    record.stiffness_n_per_m = material.stiffness_n_per_m
    record.damping_n_s_per_m = material.damping_n_s_per_m
    touched = touched_by(material, "tap")
    if material.tap is not None:
        mode, slope = material.tap.ringing, material.tap.attack_slope_per_s
        if slope is None:  # the points give A itself
            slope = 1.0
            record.tap_count = len(material.tap.amplitudes or ())
        tuned = tap_tuning_of(material, output)
        # Of a table the tick knows the mode, and what a first peak is of it.
        coefficient = material.tap.coefficient(slope) if tuned is None else slope
        if material.tap.aim != _ACROSS:
            record.tap_aim = material.tap.aim
        if material.tap.waveform is not None:
            _play(record, material.tap.waveform, slope, coefficient, output)
        elif tuned is not None:
            record.tap = mode_record(tuned.base, slope, coefficient, output, touched=touched)
            tuned.complete(record, 1.0 / output.rate_hz)
        elif mode is not None:
            record.tap = mode_record(mode, slope, coefficient, output, effects.get(mode), touched)
        if material.tap.second is not None:
            ratio = material.tap.second.ratio
            record.second = mode_record(
                material.tap.second.mode, 0.0, abs(ratio) * coefficient, output, touched=touched
            )
            if ratio < 0:
                for index in range(2 * KICKS):
                    record.second.kicks[index] = -record.second.kicks[index]
                for key in _SIGNED:
                    setattr(record.second, key, -getattr(record.second, key))
    if material.rupture is not None:
        amplitude, mode = material.rupture.amplitude_m_per_s2, material.rupture.mode
        record.rupture = mode_record(mode, amplitude, amplitude, output, effects.get(mode))
        record.rupture_depth_m = material.rupture.rupture_depth_m
        record.heals = material.rupture.heals
        if material.rupture.aim != _ACROSS:
            record.rupture_aim = material.rupture.aim
    if material.friction is not None:
        record.friction_coefficient = material.friction.coefficient
        record.friction_stiffness_n_per_m = material.friction.stiffness_n_per_m
    texture = material.texture
    if isinstance(texture, Grooves):
        record.spacing_m = texture.spacing_m
        record.width_m = texture.width_m
        if texture.display == "vibration":
            assert material.groove_mode is not None
            record.texture = Texture.STRIKES
            record.velocity_gain_per_s = texture.velocity_gain_per_s
            record.force_gain_m_per_s2_per_n = texture.force_gain_m_per_s2_per_n
            tuning = tuning_of(material, output)
            record.groove = mode_record(material.groove_mode if tuning is None else tuning.base, 1.0, 1.0, output)
            if tuning is not None:
                tuning.complete(record, 1.0 / output.rate_hz)
        elif texture.display == "geometry":
            record.texture = Texture.GEOMETRY
            record.depth_m = texture.depth_m
        else:
            record.texture = Texture.DRAG
            record.drag_n_s_per_m = texture.damping_n_s_per_m
    elif texture is not None:
        record.texture = Texture.NOISE
        record.noise = noise_index
    return record


class _Design(NamedTuple):
    """The filters of a noise at the servo's rate, over tangential speed (m/s) and normal force (N)."""

    order: int
    taps: bool
    speeds: tuple[float, ...]
    forces: tuple[float, ...]
    nodes: npt.NDArray[np.float64]
    """(speeds, forces, 1 + order, and order + 1 with taps): RMS in m/s^2, reflection coefficients, ladder taps."""
    muted: bool

    def numbers(self) -> npt.NDArray[np.float64]:
        return np.concatenate((self.speeds, self.forces, self.nodes.ravel()))


_NO_MATERIAL: Final = Material(stiffness_n_per_m=0.0)
_SILENCE: Final = _Design(0, False, (0.0,), (0.0,), np.zeros((1, 1, 1)), True)


_Noise: TypeAlias = Stochastic | Autoregressive
_KEPT: Final = 16 * 2**20
"""Bytes of designs that are kept after their use, of all outputs, and of what they were made of."""


def _bytes_of(texture: _Noise) -> int:
    """About: a number of Python's and the reference to it have 32 bytes."""
    if isinstance(texture, Stochastic):
        return 512
    return sum(512 + 32 * len(model.coefficients) for model in texture.models)


class _Designs:
    """Designs by what they are made of: materials come and go with the objects. For any thread."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[_Noise, Output], tuple[_Design, int]] = OrderedDict()
        """Each with its bytes."""
        self._bytes = 0
        self._lock = threading.Lock()

    def find(self, texture: _Noise, output: Output) -> _Design | None:
        with self._lock:
            found = self._kept.get((texture, output))
            if found is not None:
                self._kept.move_to_end((texture, output))
            return None if found is None else found[0]

    def keep(self, texture: _Noise, output: Output, design: _Design) -> None:
        """Keeps a design, and gives up those that were not asked for longest."""
        with self._lock:
            if (texture, output) not in self._kept:
                size = design.nodes.nbytes + _bytes_of(texture)
                self._kept[texture, output] = design, size
                self._bytes += size
            while self._bytes > _KEPT:
                self._bytes -= self._kept.popitem(last=False)[1][1]


_designs: Final = _Designs()


def _filters(texture: _Noise) -> int:
    """How many filters a design needs."""
    return len(texture.models) if isinstance(texture, Autoregressive) else 1


def _design(texture: _Noise, output: Output, working: Callable[[], None]) -> _Design:
    """The filters of a texture; `working` is called before each, and those of hundreds of models take seconds."""
    found = _designs.find(texture, output)
    if found is None:
        found = _new_design(texture, output, working)
        _designs.keep(texture, output, found)
    return found


def _new_design(texture: _Noise, output: Output, working: Callable[[], None]) -> _Design:
    working()
    if isinstance(texture, Stochastic):
        pair = displayed_pair(texture, output)
        if pair is None:
            return _SILENCE
        shown = filter_design.stochastic_filter(*pair, output.rate_hz)
        taps = () if shown.taps is None else shown.taps
        node = np.array([0.0, *shown.reflection, *taps])
        return _Design(len(shown.reflection), bool(taps), (0.0,), (0.0,), node.reshape(1, 1, -1), False)
    models = []
    for model in texture.models:
        models.append(_shown_model(model, texture.rate_hz, output.rate_hz))
        working()
    order = max(len(model.reflection) for model in models)
    grid = filter_design.grid(models, order)
    return _Design(order, False, grid.speeds, grid.forces, grid.nodes, False)


@lru_cache(maxsize=1024)
def _shown_model(model: AutoregressiveModel, from_rate_hz: float, to_rate_hz: float) -> filter_design.Model:
    given = lattice.reflection_of(model.coefficients)
    other = filter_design.resampled(given, from_rate_hz, to_rate_hz)
    rms = model.level(given) * math.sqrt(other.kept)
    return filter_design.Model(model.speed_m_per_s, model.force_n, other.reflection, rms)


class _Places:
    """Places in an array, the lowest free one first."""

    def __init__(self) -> None:
        self.count = 0
        """The array is so long."""
        self._free: list[int] = []

    def take(self, wanted: int | None = None) -> int:
        """A free place; `wanted`, which is free, where that is given."""
        if wanted is not None:
            self._free.remove(wanted)
            heapq.heapify(self._free)
            return wanted
        if self._free:
            return heapq.heappop(self._free)
        self.count += 1
        return self.count - 1

    def give(self, place: int) -> None:
        heapq.heappush(self._free, place)


class _Rows:
    """C records in memory that C reads in place; it grows by doubling."""

    def __init__(self, ctype: str, dtype: np.dtype[np.void]) -> None:
        self._ctype = ctype
        self._hold(records(dtype, 16))

    def _hold(self, array: npt.NDArray[np.void]) -> None:
        self.array = array
        self.memory = memoryview(array.view(np.uint8))  # type: ignore[arg-type]
        self.pointer: CData = pointer(self._ctype + "[]", array)

    def reserve(self, count: int) -> None:
        if count > len(self.array):
            before = self.memory
            self._hold(records(self.array.dtype, max(count, 2 * len(self.array))))
            self.memory[: len(before)] = before


class _Materials:
    """The materials that are used: a record and an index for each, kept as long as anything is made of it."""

    def __init__(self, output: Output, working: Callable[[], None], effects: Effects) -> None:
        self.output = output
        self.working = working
        self._effects = effects
        self._struck: dict[int, tuple[Mode, ...]] = {}
        """Material to the modes that it uses of those."""
        self._places = _Places()
        self._index: dict[str, int] = {}
        self._names: list[str] = []
        self._uses: list[int] = []
        self._known: list[Material] = []
        self._source: Mapping[str, Material] = {}
        self._rows = _Rows("struct hd_material", MATERIAL_DTYPE)
        self._noise_places = _Places()
        self._noise_of: dict[int, int] = {}
        """Material to noise."""
        self._heard: dict[int, tuple[Stochastic | Autoregressive, int, _Design]] = {}
        """Material to what its noise is made of, the version of that, and its filters."""
        self._own_numbers: dict[int, tuple[tuple[str, npt.NDArray[np.float64]], ...]] = {}
        """Material to what `_numbers_of` finds, where it finds anything."""
        self.prepared: Mapping[_Noise, _Design] = {}
        """Designed for what is taken in now."""
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
            self._known[index] = _NO_MATERIAL  # one of 400 models would be kept
            self._places.give(index)
            self._silence(index)
            self._let_go(index)
            self._rows.pointer[index] = ffi.new("struct hd_material *")[0]
            self.changed = True

    def _compile(self, index: int) -> None:
        material = self._known[index]
        if isinstance(material.texture, Stochastic | Autoregressive):
            if index not in self._noise_of:
                self._noise_of[index] = self._noise_places.take()
            if index not in self._heard or self._heard[index][0] != material.texture:
                design = self._designed(material.texture)
                self._versions = self._versions % _LARGEST + 1
                self._heard[index] = material.texture, self._versions, design
                self._numbers_changed = True
        else:
            self._silence(index)
        self._let_go(index)
        numbers = tuple(_numbers_of(material, self.output))
        if numbers:
            self._own_numbers[index] = numbers
            self._numbers_changed = True
        self.working()
        effects = {mode: self._effects.take(mode) for mode in _struck(material)}
        self._struck[index] = tuple(effects)
        self._rows.pointer[index] = material_record(material, self._noise_of.get(index, 0), self.output, effects)[0]
        self.changed = True

    def _let_go(self, index: int) -> None:
        self._numbers_changed |= self._own_numbers.pop(index, None) is not None
        for mode in self._struck.pop(index, ()):
            self._effects.give(mode)

    def _designed(self, texture: _Noise) -> _Design:
        found = self.prepared.get(texture)
        return _design(texture, self.output, self.working) if found is None else found

    def has(self, names: Set[str], source: Mapping[str, Material]) -> bool:
        """Whether all of `names` are in use already, taken from `source`."""
        return source is self._source and self._index.keys() >= names

    def to_design(self, names: Iterable[str], source: Mapping[str, Material]) -> Iterator[tuple[_Noise | None, int]]:
        """Of each material that would be compiled if `names` were used and all were taken from `source`: its noise,
        where that is not designed yet, and how many filters, shapes and spectra of waveforms it needs."""
        known: Material | None
        for name in dict.fromkeys(names):
            if name not in self._index:
                yield self._cost(None, source[name])
        if source is not self._source:
            for name, index in self._index.items():
                known, material = self._known[index], source.get(name)
                if material is not None and material is not known and material != known:
                    yield self._cost(known, material)

    def _cost(self, known: Material | None, material: Material) -> tuple[_Noise | None, int]:
        texture = material.texture
        new = isinstance(texture, Stochastic | Autoregressive) and (known is None or known.texture != texture)
        if not new or _designs.find(cast(_Noise, texture), self.output) is not None:
            texture = None
        tuned = shapes_needed(material) + tap_shapes_needed(material)
        shapes = 0 if self.output.compensation == "off" else len(modes_of(material)) + tuned
        spectra = 0 if waveform_of(material) is None else 1
        noise = cast("_Noise | None", texture)
        return noise, shapes + spectra + (0 if noise is None else _filters(noise))

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
            design = _SILENCE
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


class _Fields:
    """The sum of all fields, F = force - stiffness p - damping v, exact however often they come and go."""

    def __init__(self) -> None:
        self._parts: dict[str, tuple[float, float, float, float]] = {}
        self._sums = [0, 0, 0, 0]

    def put(self, id: str, item: SceneObject | None) -> bool:
        """Takes what a field exerts, or None for what is none; whether the sum changed."""
        before = self._parts.pop(id, None)
        after = None if item is None else _field_of(item)
        if after is not None:
            self._parts[id] = after
        if before == after:
            return False
        for place in range(4):
            new = 0 if after is None else _quanta(after[place])
            old = 0 if before is None else _quanta(before[place])
            self._sums[place] += new - old
        return True

    def write(self, field: CData) -> None:
        """Puts the sums, correctly rounded, into a `struct hd_field`."""
        x, y, field.stiffness_n_per_m, field.damping_n_s_per_m = (total / _QUANTUM for total in self._sums)
        field.force_n = (x, y)


def _quanta(value: float) -> int:
    numerator, denominator = value.as_integer_ratio()
    return numerator * (_QUANTUM // denominator)


def _field_of(item: SceneObject) -> tuple[float, float, float, float] | None:
    """Force (x, y), stiffness and damping; None for a surface."""
    if item.kind == "spring":
        stiffness = item.stiffness_n_per_m
        return stiffness * item.center_m[0], stiffness * item.center_m[1], stiffness, item.damping_n_s_per_m
    if item.kind == "viscous":
        return 0.0, 0.0, 0.0, item.damping_n_s_per_m
    if item.kind == "constant":
        return item.force_n[0], item.force_n[1], 0.0, 0.0
    return None


# By kind: isinstance of a pydantic model costs more than the rest of its record. So does a member of an enum.
_SURFACE_KINDS: Final = frozenset(("wall", "membrane", "box", "disc"))
_PASSIVITY: Final = {mode.name.lower(): int(mode) for mode in PassivityMode}
_NONE, _WALL, _MEMBRANE, _BOX, _DISC = map(int, (Shape.NONE, Shape.WALL, Shape.MEMBRANE, Shape.BOX, Shape.DISC))


def _is_surface(item: SceneObject | None) -> TypeGuard[Surface]:
    return item is not None and item.kind in _SURFACE_KINDS


def _place_of(item: Surface) -> tuple[int, _Place]:
    """Shape, and point, normal and half as csrc/api/hd_api.h defines them."""
    if item.kind == "wall":
        return _WALL, (*item.point_m, *item.normal, 0.0, 0.0)
    if item.kind == "box":
        width, height = item.size_m
        angle = item.angle_rad
        return _BOX, (*item.center_m, -math.sin(angle), math.cos(angle), width / 2.0, height / 2.0)
    if item.kind == "disc":
        return _DISC, (*item.center_m, 0.0, 1.0, item.radius_m, item.radius_m)
    return _MEMBRANE, (*item.center_m, *item.normal, item.width_m / 2.0, 0.0)


class _Pieces(NamedTuple):
    """What a wall with patches is made of."""

    patches: Sequence[Patch]
    of: tuple[str, float]
    """The material between them, and the ramp."""
    rows: npt.NDArray[np.void]
    """PIECE_DTYPE."""
    materials: frozenset[int]
    """Used once each."""


def _same(one: _Pieces | None, other: _Pieces | None) -> bool:
    if one is None or other is None:
        return one is other
    return one is other or np.array_equal(one.rows, other.rows)


class Compiler:
    """Keeps the table of one scene up to date. One thread at a time, but for `name_of` and `events_read`."""

    def __init__(
        self, output: Output, working: Callable[[], None] = lambda: None, effects: Effects | None = None
    ) -> None:
        """`working` is called now and then in what takes long: the filters of many textures take seconds. `effects`:
        what the device plays by itself; None: nothing."""
        self._objects = _Rows("struct hd_object", OBJECT_DTYPE)
        self._places = _Places()
        self._slots: dict[str, int] = {}
        self._owners: list[tuple[int, str] | None] = []
        """Generation and id, by slot."""
        self._gone = Gone()
        self._lost: dict[str, tuple[int, int]] = {}
        """Slot and generation that ids lost at the last update."""
        self._patched: dict[int, _Pieces] = {}
        """What walls with patches are made of, by slot."""
        self._pieces = records(PIECE_DTYPE, 0)
        self._pieces_changed = False
        self._materials = _Materials(output, working, effects or _NoEffects())
        self._fields = _Fields()
        self._changed: set[int] = set()
        self._changed_slots = np.zeros(0, np.uint32)
        self._stamp = 0
        self._table: CData = ffi.new("struct hd_table *")
        self._turn_to(output)
        self._table.all_changed = 1

    def turn_to(self, output: Output) -> None:
        """What the tables are made for from now on, another rate for example: the next `update`, which is to be taken
        whole, has everything of it. Slots and generations stay."""
        self._turn_to(output)
        self._stamp = self._stamp % _LARGEST + 1
        self._show_again(self._materials.turn_to_output(output))
        self._table.all_changed = 1

    def _turn_to(self, output: Output) -> None:
        self._table.period_s = 1.0 / output.rate_hz
        self._table.max_force_n = output.max_force_n
        self._table.max_speed_m_per_s = output.max_speed_m_per_s
        self._table.rearm_m = output.rearm_m
        self._table.report_age = min(math.ceil(output.age_s * output.rate_hz - _SAME_PERIOD), PASSIVITY_AGE_MAX)
        known = output.dynamics
        mass_kg = output.effective_mass_kg if known is None else known.handle_mass_kg
        self._table.brake_n_s_per_m = PASSIVITY_BRAKE * mass_kg * output.rate_hz
        self._table.handle_damping_n_s_per_m = 0.0 if known is None else known.handle_damping_n_s_per_m
        self._table.handle_friction_n = 0.0 if known is None else known.friction_n

    def slot_of(self, id: str) -> tuple[int, int] | None:
        """Slot and generation of a surface; None for a field and for an unknown id."""
        slot = self._slots.get(id)
        owner = None if slot is None else self._owners[slot]
        return None if slot is None or owner is None else (slot, owner[0])

    def names(self) -> list[str]:
        """Ids by slot; empty where the slot is free. Not while another thread updates it."""
        return ["" if owner is None else owner[1] for owner in self._owners]

    def name_of(self, slot: int, generation: int) -> str | None:
        """The id of the object that has, or had, a slot; None where its events were read. For any thread."""
        owner = self._owners[slot] if slot < len(self._owners) else None
        if owner is not None and owner[0] == generation:
            return owner[1]
        return self._gone.name_of(slot, generation)

    def events_read(self, revision: int) -> None:
        """Every event up to the tick that took this revision, and of that tick, was read: what went until then has no
        name any more. For any one thread."""
        self._gone.read(revision)

    def parts(self) -> Parts:
        """A copy of what of the table says how surfaces and fields push. Not while another thread updates it."""
        return Parts(
            self._objects.array[: self._places.count].copy(),
            self._materials.rows().copy(),
            self._pieces.copy(),
            float(self._table.field.stiffness_n_per_m),
            float(self._table.field.damping_n_s_per_m),
            self._materials.names(),
        )

    def missing(self, names: Set[str], materials: Mapping[str, Material]) -> int:
        """Filters and shapes that `update` would have to design, and spectra of waveforms that it would have to find,
        were it given these materials and objects that are made of `names`; a few milliseconds each."""
        if self._materials.has(names, materials):
            return 0
        return sum(count for _, count in self._materials.to_design(names, materials))

    def prepare(self, names: Set[str], materials: Mapping[str, Material], progress: Progress | None) -> None:
        """Designs the filters that the next `update` needs. They come out as if that did it."""
        self._materials.prepared = {}
        if self._materials.has(names, materials):
            return
        textures = [noise for noise, _ in self._materials.to_design(names, materials) if noise is not None]
        if progress is not None:
            progress.of += sum(map(_filters, textures))

        def working() -> None:
            self._materials.working()
            if progress is not None:
                progress.done = min(progress.done + 1, progress.of)

        output = self._materials.output
        prepared: dict[_Noise, _Design] = {}
        for texture in textures:
            if texture not in prepared:
                prepared[texture] = _design(texture, output, working)
        self._materials.prepared = prepared

    def update(
        self,
        scene: Scene,
        changed: Iterable[str],
        materials: Mapping[str, Material],
        revision: int,
    ) -> CData:
        """Brings the records of the objects `changed` (ids, present in the scene or not) up to date, and those of all
        objects that are made of a material that changed.

        `materials` defines every material of the scene, and stays as it is. Returns the `struct hd_table *`, which
        stays valid and is the same one at every call. Its `changed` grows until `published` is called.
        """
        self._lost = {}
        try:
            return self._update(scene, list(changed), materials, revision, {})
        finally:
            self._materials.prepared = {}

    def published(self) -> None:
        """The table was taken: what changes from now on is a change to it."""
        self._changed.clear()
        self._table.all_changed = 0

    def restore(self, scene: Scene, changed: Iterable[str], materials: Mapping[str, Material], revision: int) -> None:
        """The table of the last update was refused: back to what was in force, given as in `update`, slots and
        generations included. The next table is to be taken whole."""
        self._table.all_changed = 1
        former, self._lost = self._lost, {}
        self._gone.take_back(self._table.revision)
        self._update(scene, list(changed), materials, revision, former)

    def _update(
        self,
        scene: Scene,
        ids: list[str],
        materials: Mapping[str, Material],
        revision: int,
        former: Mapping[str, tuple[int, int]],
    ) -> CData:
        self._stamp = self._stamp % _LARGEST + 1
        objects, table = scene.objects, self._table
        fields_changed = False
        # What goes makes room for what comes.
        for id in ids:
            item = objects.get(id)
            surface = _is_surface(item)
            if not surface and id in self._slots:
                self._remove(id)
            fields_changed |= self._fields.put(id, None if surface else item)
        self._show_again(self._materials.turn_to(materials))
        for id in ids:
            item = objects.get(id)
            if _is_surface(item):
                self._put(id, item, former.get(id))
        self._gone.close(revision, self._lost.values())
        if self._pieces_changed or self._materials.changed:
            table.parts_version = self._stamp
            self._write_parts()
        if fields_changed:
            table.field_version = self._stamp
            self._fields.write(table.field)
        table.revision = revision
        table.display_force = scene.display.force
        table.display_vibration = scene.display.vibration
        table.passivity = _PASSIVITY[scene.passivity]
        table.ramp_s = scene.ramp_s
        table.ramp_step = table.period_s / scene.ramp_s
        table.object_count = self._places.count
        table.objects = self._objects.pointer
        self._changed_slots = np.fromiter(self._changed, np.uint32, len(self._changed))
        table.changed_count = len(self._changed_slots)
        table.changed = pointer("uint32_t[]", self._changed_slots)
        return table

    def _put(self, id: str, item: Surface, former: tuple[int, int] | None) -> None:
        """`former`: slot and generation that it gets back."""
        stamp = self._stamp
        shape, place = _place_of(item)
        material = self._materials.use(item.material)
        slot = self._slots.get(id)
        pieces = self._use_pieces(slot, item) if item.kind == "wall" and item.patches else None
        generation = stamp if former is None else former[1]
        pose_version = surface_version = stamp
        first = 0
        held: _Pieces | None = None
        if slot is None:
            slot = self._slots[id] = self._places.take(None if former is None else former[0])
            if slot == len(self._owners):
                self._owners.append(None)
                self._objects.reserve(slot + 1)
            self._owners[slot] = (generation, id)
        else:
            before = _RECORD.unpack_from(self._objects.memory, slot * _RECORD.size)
            held = self._patched.get(slot)
            if before[3] == shape:
                generation = before[0]
                if before[8:] == place:
                    pose_version = before[1]
                if before[4] == material and _same(held, pieces):
                    surface_version, first = before[2], before[5]
            else:
                self._forget(slot)
                self._owners[slot] = (generation, id)
            self._materials.release(before[4])
        if held is not pieces:
            self._turn_pieces(slot, held, pieces)
        count = 0 if pieces is None else len(pieces.rows)
        key = (generation, pose_version, surface_version, shape, material, first, count, 0)
        _RECORD.pack_into(self._objects.memory, slot * _RECORD.size, *key, *place)
        self._changed.add(slot)

    def _remove(self, id: str) -> None:
        slot = self._slots.pop(id)
        self._forget(slot)
        self._materials.release(_RECORD.unpack_from(self._objects.memory, slot * _RECORD.size)[4])
        self._turn_pieces(slot, self._patched.get(slot), None)
        _RECORD.pack_into(self._objects.memory, slot * _RECORD.size, self._stamp, *(0,) * 7, *(0.0,) * 6)
        self._places.give(slot)
        self._changed.add(slot)

    def _forget(self, slot: int) -> None:
        """The slot has no owner any more; its name is kept for a while."""
        owner = self._owners[slot]
        assert owner is not None
        self._gone.add((slot, owner[0]), owner[1])
        self._lost[owner[1]] = (slot, owner[0])
        self._owners[slot] = None

    def _use_pieces(self, slot: int | None, wall: Wall) -> _Pieces:
        """The pieces of a wall; those that its slot holds, if they are the same.

        Where two meet, they share the shorter of the ramp and the stretches beside it.
        """
        held = None if slot is None else self._patched.get(slot)
        if held is not None and held.patches is wall.patches and held.of == (wall.material, wall.patch_ramp_m):
            return held
        begins, names = wall.stretches()
        indices = {name: self._materials.use(name) for name in dict.fromkeys(names)}
        rows = records(PIECE_DTYPE, len(begins))
        lengths = np.diff(begins, append=math.inf)
        rows["from_m"] = begins
        rows["from_m"][0] = 0.0
        rows["half_ramp_m"][1:] = np.minimum(np.minimum(lengths[:-1], lengths[1:]), wall.patch_ramp_m) / 2.0
        rows["material"] = np.fromiter(map(indices.__getitem__, names), np.uint32, len(names))
        return _Pieces(wall.patches, (wall.material, wall.patch_ramp_m), rows, frozenset(indices.values()))

    def _turn_pieces(self, slot: int, held: _Pieces | None, pieces: _Pieces | None) -> None:
        """What was of pieces `held` is of `pieces` now; those that stay lie where they are."""
        if held is not None:
            for material in held.materials:
                self._materials.release(material)
        self._pieces_changed |= not _same(held, pieces)
        # In order of the slots' first pieces: one that stays keeps its place.
        if pieces is None:
            self._patched.pop(slot, None)
        else:
            self._patched[slot] = pieces

    def _show_again(self, materials: list[int]) -> None:
        """Marks what is made of these materials."""
        if not materials:
            return
        array = self._objects.array[: self._places.count]
        touched = np.isin(array["material"], materials) & (array["shape"] != _NONE)
        sought = set(materials)
        for slot, pieces in self._patched.items():
            touched[slot] |= not sought.isdisjoint(pieces.materials)
        array["surface_version"][touched] = self._stamp
        self._changed.update(np.flatnonzero(touched).tolist())

    def _write_parts(self) -> None:
        table = self._table
        if self._pieces_changed:
            self._pieces = records(PIECE_DTYPE, sum(len(pieces.rows) for pieces in self._patched.values()))
            array = self._objects.array
            first = 0
            for slot, pieces in self._patched.items():
                if array["piece_first"][slot] != first:
                    array["piece_first"][slot] = first
                    self._changed.add(slot)
                self._pieces[first : first + len(pieces.rows)] = pieces.rows
                first += len(pieces.rows)
            self._pieces_changed = False
        table.piece_count = len(self._pieces)
        table.pieces = pointer("struct hd_piece[]", self._pieces)
        self._materials.write(table)
