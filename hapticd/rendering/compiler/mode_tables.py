"""Modes that follow speed or force, of taps and of grooves: what the tick looks up when it strikes one
(csrc/scene/hd_table_numbers.h).

What is struck is known when it is struck, and what `compensation` makes of a mode takes milliseconds. So it is designed
for some places of the table's range when the scene is taken in, all with the poles of one tail; between them everything
lies on a straight line.
"""

from __future__ import annotations

import cmath
import math
from functools import lru_cache
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.base.core import KICKS, TUNE_NODE, CData
from hapticd.config.materials import Material
from hapticd.config.modes import Mode, ModeTable
from hapticd.config.texture import Grooves
from hapticd.rendering.compensation import Ringing, Shape, peak_between, tuned_shapes
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import (
    DEFAULT_SURFACE_N_PER_M,
    DISPLAYABLE_RATE_FRACTION,
    NO_SURFACE,
    Touched,
    touched_by,
)

GROOVE_NODES: Final = 17
"""So many frequencies of grooves are designed; at most HD_TUNE_NODES."""
TAP_STEPS: Final = 16
"""Between the first speed of taps and the last are about so many steps; with the points at most HD_TUNE_NODES nodes."""
_PEAK: Final = TUNE_NODE - 2


class TabledModes(NamedTuple):
    """What a table of modes is in the C core."""

    base: Mode
    """A mode that can be displayed: what is the same for all strikes is taken of it."""
    tail: Ringing | None
    """Of the compensation of all of them, with any gain."""
    nodes: npt.NDArray[np.float64]
    """(n, HD_TUNE_NODE), or (0, HD_TUNE_NODE) where nothing is compensated for."""
    numbers: npt.NDArray[np.float64]
    """As the core's table holds them, the nodes included."""

    def complete(self, record: CData, mode: CData, output: Output) -> None:
        """Puts into a `struct hd_material`, and into its `struct hd_mode` made of `base`, what all strikes share: where
        they are lowered or muted, and the tail without kicks."""
        record.tune_highest_rad_per_s, record.tune_mutes = _highest(output), output.undisplayable == "mute"
        if len(self.nodes) == 0:
            return
        mode.kicks, mode.kick_count = [0.0] * (2 * KICKS), 0
        if not mode.touched_n_per_m > 0.0:
            mode.touched_n_per_m = DEFAULT_SURFACE_N_PER_M
        rotor, decay, omega, end_s = 0j, 0.0, 0.0, 0.0
        if self.tail is not None:
            pole, end_s = self.tail.pole, self.tail.end_s
            rotor, decay, omega = cmath.exp(pole * (1.0 / output.rate_hz)), -pole.real, pole.imag
        mode.tail_rotor_re, mode.tail_rotor_im, mode.tail_end_s = rotor.real, rotor.imag, end_s
        mode.tail_decay_rate_per_s, mode.tail_angular_frequency_rad_per_s = decay, omega


def _highest(output: Output) -> float:
    """rad/s."""
    return 2.0 * math.pi * DISPLAYABLE_RATE_FRACTION * output.carried_hz


def tabled_grooves(material: Material, output: Output) -> TabledModes | None:
    """Of a material whose grooves have a table of frequencies."""
    texture, modes = material.texture, material.groove_modes
    if not isinstance(texture, Grooves) or texture.frequency_table is None or not modes:
        return None
    table, highest = texture.frequency_table, _highest(output)
    low, high = (min(mode.angular_frequency_rad_per_s, highest) for mode in (modes[0], modes[-1]))
    count = GROOVE_NODES if high > low else 1
    frequencies = tuple(float(w) for w in np.geomspace(low, high, count))
    decay = modes[0].decay_rate_per_s
    tail, nodes = _nodes(frequencies, tuple(Mode(decay, w) for w in frequencies), output, NO_SURFACE)
    grid = 2.0 * math.pi * np.array(table.frequencies_hz)
    numbers = np.concatenate((table.speeds_m_per_s, table.forces_n, grid.ravel(), nodes.ravel()))
    return TabledModes(Mode(decay, low), tail, nodes, numbers)


def tabled_tap(material: Material, output: Output) -> TabledModes | None:
    """Of a material whose tap has a mode table."""
    if material.tap is None or material.tap.mode_table is None:
        return None
    table, highest = material.tap.mode_table, _highest(output)

    def shown(mode: Mode) -> Mode:
        return Mode(mode.decay_rate_per_s, min(mode.angular_frequency_rad_per_s, highest))

    speeds = _speeds(table)
    modes = tuple(shown(table.at(speed)) for speed in speeds)
    tail, nodes = _nodes(speeds, modes, output, touched_by(material, "tap"))
    angular = 2.0 * math.pi * np.array(table.frequencies_hz)
    numbers = np.concatenate((table.speeds_m_per_s, angular, table.decay_times_s, nodes.ravel()))
    return TabledModes(shown(table.bounds[0]), tail, nodes, numbers)


def _speeds(table: ModeTable) -> tuple[float, ...]:
    """All points, and between them steps that are about alike."""
    points = table.speeds_m_per_s
    whole = points[-1] - points[0]
    found = [points[0]]
    for one, other in pairwise(points):
        steps = max(1, round(TAP_STEPS * (other - one) / whole))
        found += [float(speed) for speed in np.linspace(one, other, steps + 1)[1:]]
    return tuple(found)


@lru_cache(maxsize=1024)
def _nodes(
    places: tuple[float, ...], modes: tuple[Mode, ...], output: Output, touched: Touched
) -> tuple[Ringing | None, npt.NDArray[np.float64]]:
    """The tail that all these modes share, and the nodes (n, HD_TUNE_NODE) at their places, frequencies or speeds."""
    if output.compensation == "off":
        return None, np.zeros((0, TUNE_NODE))
    assert output.dynamics is not None
    load = touched.load(output)
    pairs = tuned_shapes(modes, output.dynamics, output.carried_hz, output.compensation, load, touched.best_in_contact)
    rows = np.array([_row(place, *pair) for place, pair in zip(places, pairs, strict=True)])
    # A strike between two nodes is no larger than the line between their peaks.
    for column, which in ((_PEAK, 1), (_PEAK + 1, 0)):
        shapes = [pair[which] for pair in pairs]
        rows[:, column] *= max([1.0, *(peak_between(one, other) for one, other in pairwise(shapes))])
    return pairs[0][0].tail, rows


def _row(place: float, free: Shape, touched: Shape) -> tuple[float, ...]:
    """A node, in the order of enum hd_tune_number."""
    tails = [0j if shape.tail is None else shape.tail.gain for shape in (touched, free)]
    gains = (touched.mode.gain, tails[0], free.mode.gain, tails[1])
    return place, *(part for gain in gains for part in (gain.real, gain.imag)), touched.peak, free.peak
