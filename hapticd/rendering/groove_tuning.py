"""Grooves whose frequency follows speed and force: the numbers by which the tick finds it,
csrc/scene/hd_table_numbers.h.

A strike's frequency is known when it is struck, and what `compensation` makes of a frequency takes milliseconds. So it
is designed for some frequencies of the table's range when the scene is taken in, all with the poles of one tail;
between them everything lies on a straight line.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import KICKS, TUNE_NODE, CData
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.texture import FrequencyTable, Grooves
from hapticd.rendering.compensation import Ringing, Shape, peak_between, tuned_shapes
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import DISPLAYABLE, TOUCHED_N_PER_M, UNTOUCHED

NODES: Final = 17
"""So many frequencies are designed; at most HD_TUNE_NODES."""
_PEAK: Final = TUNE_NODE - 2


@dataclass(frozen=True, slots=True)
class Tuning:
    """What a material's table of frequencies is in the C core."""

    table: FrequencyTable
    highest_rad_per_s: float
    mutes: bool
    base: Mode
    """A mode that can be displayed, with the decay of all strikes: what is the same for all of them is taken of it."""
    tail: Ringing | None
    """Of its compensation, with any gain."""
    nodes: npt.NDArray[np.float64]
    """(NODES, HD_TUNE_NODE), or (0, HD_TUNE_NODE) where nothing is compensated for."""

    def complete(self, record: CData, period_s: float) -> None:
        """Puts into a `struct hd_material`, whose groove's mode is `base`, what it needs beside its numbers."""
        record.tune_speeds, record.tune_forces = len(self.table.speeds_m_per_s), len(self.table.forces_n)
        record.tune_nodes = len(self.nodes)
        record.tune_highest_rad_per_s, record.tune_mutes = self.highest_rad_per_s, self.mutes
        if len(self.nodes) > 0:
            complete_tail(record.groove, self.tail, period_s)

    def numbers(self) -> npt.NDArray[np.float64]:
        """As the core's table holds them."""
        grid = 2.0 * math.pi * np.array(self.table.frequencies_hz)
        return np.concatenate((self.table.speeds_m_per_s, self.table.forces_n, grid.ravel(), self.nodes.ravel()))


def complete_tail(mode: CData, tail: Ringing | None, period_s: float) -> None:
    """Puts into a `struct hd_mode` that is designed by nodes what all of them share: the tail, and no kicks."""
    for index in range(2 * KICKS):
        mode.kicks[index] = 0.0
    mode.kick_count = 0
    if not mode.touched_n_per_m > 0.0:
        mode.touched_n_per_m = TOUCHED_N_PER_M
    decay, omega, end_s = 0.0, 0.0, 0.0
    rotor = 0j
    if tail is not None:
        rotor = cmath.exp(tail.pole * period_s)
        decay, omega, end_s = -tail.pole.real, tail.pole.imag, tail.end_s
    mode.tail_rotor_re, mode.tail_rotor_im = rotor.real, rotor.imag
    mode.tail_decay_rate_per_s, mode.tail_angular_frequency_rad_per_s = decay, omega
    mode.tail_end_s = end_s


def table_of(material: Material) -> FrequencyTable | None:
    """The table of frequencies of a material, if its grooves have one."""
    texture = material.texture
    return texture.frequency_table if isinstance(texture, Grooves) else None


def tuning_of(material: Material, output: Output) -> Tuning | None:
    """Of a material whose grooves have a table of frequencies."""
    table, modes = table_of(material), material.groove_modes
    if table is None or not modes:
        return None
    highest = 2.0 * math.pi * DISPLAYABLE * output.carried_hz
    decay = modes[0].decay_rate_per_s
    low, high = (min(mode.angular_frequency_rad_per_s, highest) for mode in (modes[0], modes[-1]))
    tail, nodes = None, np.zeros((0, TUNE_NODE))
    if output.compensation != "off":
        tail, nodes = _nodes(decay, low, high, output)
    return Tuning(table, highest, output.undisplayable == "mute", Mode(decay, low), tail, nodes)


@lru_cache(maxsize=1024)
def _nodes(
    decay_rate_per_s: float, low_rad_per_s: float, high_rad_per_s: float, output: Output
) -> tuple[Ringing | None, npt.NDArray[np.float64]]:
    assert output.dynamics is not None and output.compensation != "off"
    count = NODES if high_rad_per_s > low_rad_per_s else 1
    modes = tuple(Mode(decay_rate_per_s, float(w)) for w in np.geomspace(low_rad_per_s, high_rad_per_s, count))
    pairs = tuned_shapes(modes, output.dynamics, output.carried_hz, output.compensation, UNTOUCHED.load(output))
    return pairs[0][0].tail, node_rows([mode.angular_frequency_rad_per_s for mode in modes], pairs)


def node_rows(places: Sequence[float], pairs: Sequence[tuple[Shape, Shape]]) -> npt.NDArray[np.float64]:
    """(n, HD_TUNE_NODE): the nodes at these places (frequencies or speeds), of shapes where nothing is touched and
    where the surface is."""
    rows = np.array([_row(place, *pair) for place, pair in zip(places, pairs, strict=True)])
    # A strike between two nodes is no larger than the line between their peaks.
    for column, which in ((_PEAK, 1), (_PEAK + 1, 0)):
        rows[:, column] *= max([1.0, *_between([pair[which] for pair in pairs])])
    return rows


def _between(shapes: list[Shape]) -> Iterator[float]:
    """By how much what lies half way between two neighbours exceeds the line between their peaks."""
    for one, other in pairwise(shapes):
        yield peak_between(one, other, (one.mode.pole + other.mode.pole) / 2)


def _row(place: float, free: Shape, touched: Shape) -> tuple[float, ...]:
    """A node, in the order of enum hd_tune_number."""
    gains = [gain for shape in (touched, free) for gain in (shape.mode.gain, _tail_gain(shape))]
    numbers = [part for gain in gains for part in (gain.real, gain.imag)]
    return place, *numbers, touched.peak, free.peak


def _tail_gain(shape: Shape) -> complex:
    return 0j if shape.tail is None else shape.tail.gain
