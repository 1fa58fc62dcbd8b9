"""Modes of taps and grooves that depend on speed or force: the tables that a strike interpolates.

The compensation of a mode takes milliseconds to compute. So when a scene is compiled, modes are compensated at nodes of
the table's range, all with the same pole of the tail. A strike interpolates linearly between two nodes
(csrc/scene/hd_table_numbers.h).
"""

from __future__ import annotations

import cmath
import math
from functools import lru_cache
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.base.core import MAX_CORRECTED_SAMPLES, TUNE_NODE_NUMBERS, CData
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
"""Number of frequencies at which modes of grooves are compensated; at most HD_TUNE_NODES."""
TAP_STEPS: Final = 16
"""Approximate number of steps from the lowest to the highest tap speed. The nodes must not exceed HD_TUNE_NODES."""
_PEAK_COLUMN: Final = TUNE_NODE_NUMBERS - 2
"""Column of a table of nodes that holds the peak force in contact; the next column holds that without contact."""


class TabledModes(NamedTuple):
    """A table of modes as the C core holds it."""

    base: Mode
    """A displayable mode with the values that all strikes share."""
    tail: Ringing | None
    """Tail of the compensation of all modes; only its pole is used."""
    nodes: npt.NDArray[np.float64]
    """Compensated modes, (n, HD_TUNE_NODE); (0, HD_TUNE_NODE) without compensation."""
    numbers: npt.NDArray[np.float64]
    """All numbers of the table, including the nodes, in the order of the core."""

    def complete(self, record: CData, mode: CData, output: Output) -> None:
        """Put the values that all strikes share into a `struct hd_material` and its `struct hd_mode` for `base`.

        These are the frequency above which modes are lowered or muted, and the tail. Kicks are removed.
        """
        record.tune_highest_rad_per_s, record.tune_mutes = _highest_rad_per_s(output), output.undisplayable == "mute"
        if len(self.nodes) == 0:
            return
        mode.kicks, mode.kick_count = [0.0] * (2 * MAX_CORRECTED_SAMPLES), 0
        if not mode.touched_n_per_m > 0.0:
            mode.touched_n_per_m = DEFAULT_SURFACE_N_PER_M
        rotor, decay, omega, end_s = 0j, 0.0, 0.0, 0.0
        if self.tail is not None:
            pole, end_s = self.tail.pole, self.tail.end_s
            rotor, decay, omega = cmath.exp(pole * (1.0 / output.rate_hz)), -pole.real, pole.imag
        mode.tail_rotor_re, mode.tail_rotor_im, mode.tail_end_s = rotor.real, rotor.imag, end_s
        mode.tail_decay_rate_per_s, mode.tail_angular_frequency_rad_per_s = decay, omega


def _highest_rad_per_s(output: Output) -> float:
    """Return the highest displayable angular frequency, in rad/s."""
    return 2.0 * math.pi * DISPLAYABLE_RATE_FRACTION * output.carried_hz


def tabled_grooves(material: Material, output: Output) -> TabledModes | None:
    """Return the table of a material whose grooves have a table of frequencies, or None."""
    texture, modes = material.texture, material.groove_modes
    if not isinstance(texture, Grooves) or texture.frequency_table is None or not modes:
        return None
    table, highest = texture.frequency_table, _highest_rad_per_s(output)
    low, high = (min(mode.angular_frequency_rad_per_s, highest) for mode in (modes[0], modes[-1]))
    count = GROOVE_NODES if high > low else 1
    frequencies = tuple(float(w) for w in np.geomspace(low, high, count))
    decay = modes[0].decay_rate_per_s
    tail, nodes = _nodes(frequencies, tuple(Mode(decay, w) for w in frequencies), output, NO_SURFACE)
    grid = 2.0 * math.pi * np.array(table.frequencies_hz)
    numbers = np.concatenate((table.speeds_m_per_s, table.forces_n, grid.ravel(), nodes.ravel()))
    return TabledModes(Mode(decay, low), tail, nodes, numbers)


def tabled_tap(material: Material, output: Output) -> TabledModes | None:
    """Return the table of a material whose tap has a mode table, or None."""
    if material.tap is None or material.tap.mode_table is None:
        return None
    table, highest = material.tap.mode_table, _highest_rad_per_s(output)

    def shown(mode: Mode) -> Mode:
        """Return the mode, lowered to the highest displayable frequency if necessary."""
        return Mode(mode.decay_rate_per_s, min(mode.angular_frequency_rad_per_s, highest))

    speeds = _speeds(table)
    modes = tuple(shown(table.at(speed)) for speed in speeds)
    tail, nodes = _nodes(speeds, modes, output, touched_by(material, "tap"))
    angular = 2.0 * math.pi * np.array(table.frequencies_hz)
    numbers = np.concatenate((table.speeds_m_per_s, angular, table.decay_times_s, nodes.ravel()))
    return TabledModes(shown(table.bounds[0]), tail, nodes, numbers)


def _speeds(table: ModeTable) -> tuple[float, ...]:
    """Return the speeds (m/s) of the table's points, with further speeds between them at about equal steps."""
    points = table.speeds_m_per_s
    span = points[-1] - points[0]
    found = [points[0]]
    for one, other in pairwise(points):
        steps = max(1, round(TAP_STEPS * (other - one) / span))
        found += [float(speed) for speed in np.linspace(one, other, steps + 1)[1:]]
    return tuple(found)


@lru_cache(maxsize=1024)
def _nodes(
    arguments: tuple[float, ...], modes: tuple[Mode, ...], output: Output, touched: Touched
) -> tuple[Ringing | None, npt.NDArray[np.float64]]:
    """Return the tail (second pole of a strike's force) that all modes share, and the nodes (n, HD_TUNE_NODE).

    `arguments` are the frequencies or speeds of the nodes.
    """
    if output.compensation == "off":
        return None, np.zeros((0, TUNE_NODE_NUMBERS))
    assert output.dynamics is not None
    load = touched.load(output)
    pairs = tuned_shapes(modes, output.dynamics, output.carried_hz, output.compensation, load, touched.best_in_contact)
    rows = np.array([_row(argument, *pair) for argument, pair in zip(arguments, pairs, strict=True)])
    # Scaled so that the line between the peaks of two nodes bounds the peak of a strike between them.
    for column, which in ((_PEAK_COLUMN, 1), (_PEAK_COLUMN + 1, 0)):
        shapes = [pair[which] for pair in pairs]
        rows[:, column] *= max([1.0, *(peak_between(one, other) for one, other in pairwise(shapes))])
    return pairs[0][0].tail, rows


def _row(argument: float, free: Shape, touched: Shape) -> tuple[float, ...]:
    """Return the numbers of a node, in the order of enum hd_tune_number, from its frequency or speed and its shapes."""
    tails = [0j if shape.tail is None else shape.tail.gain for shape in (touched, free)]
    gains = (touched.mode.gain, tails[0], free.mode.gain, tails[1])
    return argument, *(part for gain in gains for part in (gain.real, gain.imag)), touched.peak, free.peak
