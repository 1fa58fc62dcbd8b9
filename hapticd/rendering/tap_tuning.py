"""Taps whose mode follows the approach speed: the numbers by which the tick finds it (csrc/scene/hd_table_numbers.h).

As of grooves (groove_tuning.py), what `compensation` makes of a mode is designed for some speeds when the scene is
taken in, all with the poles of one tail; between them everything lies on a straight line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import TUNE_NODE, CData
from hapticd.config.materials import Material
from hapticd.config.modes import Mode, ModeTable
from hapticd.rendering.compensation import Ringing, tuned_shapes
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import DISPLAYABLE, Touched, touched_by
from hapticd.rendering.groove_tuning import complete_tail, node_rows

NODES: Final = 16
"""Between the first speed and the last are about so many steps; with the points at most HD_TUNE_NODES nodes."""


@dataclass(frozen=True, slots=True)
class TapTuning:
    """What a tap's mode table is in the C core."""

    table: ModeTable
    by_peak: bool
    """The amplitude is a first peak."""
    highest_rad_per_s: float
    mutes: bool
    base: Mode
    """A mode that can be displayed: what is the same for all strikes is taken of it."""
    tail: Ringing | None
    nodes: npt.NDArray[np.float64]
    """(n, HD_TUNE_NODE), or (0, HD_TUNE_NODE) where nothing is compensated for."""

    def complete(self, record: CData, period_s: float) -> None:
        """Puts into a `struct hd_material`, whose tap's mode is `base`, what it needs beside its numbers."""
        record.mode_count, record.mode_nodes = len(self.table.speeds_m_per_s), len(self.nodes)
        record.mode_by_peak = self.by_peak
        record.tune_highest_rad_per_s, record.tune_mutes = self.highest_rad_per_s, self.mutes
        if len(self.nodes) > 0:
            complete_tail(record.tap, self.tail, period_s)

    def numbers(self) -> npt.NDArray[np.float64]:
        """As the core's table holds them."""
        angular = 2.0 * math.pi * np.array(self.table.frequencies_hz)
        return np.concatenate((self.table.speeds_m_per_s, angular, self.table.decay_times_s, self.nodes.ravel()))


def tap_tuning_of(material: Material, output: Output) -> TapTuning | None:
    """Of a material whose tap has a mode table."""
    tap = material.tap
    if tap is None or tap.mode_table is None:
        return None
    highest = 2.0 * math.pi * DISPLAYABLE * output.carried_hz
    low = tap.mode_table.bounds[0]
    base = Mode(low.decay_rate_per_s, min(low.angular_frequency_rad_per_s, highest))
    tail, nodes = None, np.zeros((0, TUNE_NODE))
    if output.compensation != "off":
        tail, nodes = _nodes(tap.mode_table, highest, output, touched_by(material, "tap"))
    return TapTuning(
        tap.mode_table, tap.attack == "first_peak", highest, output.undisplayable == "mute", base, tail, nodes
    )


def _speeds(table: ModeTable) -> list[float]:
    """All points, and between them steps that are about alike."""
    points = table.speeds_m_per_s
    whole = points[-1] - points[0]
    found = [points[0]]
    for one, other in pairwise(points):
        steps = max(1, round(NODES * (other - one) / whole))
        found += [float(speed) for speed in np.linspace(one, other, steps + 1)[1:]]
    return found


@lru_cache(maxsize=1024)
def _nodes(
    table: ModeTable, highest: float, output: Output, touched: Touched
) -> tuple[Ringing | None, npt.NDArray[np.float64]]:
    assert output.dynamics is not None and output.compensation != "off"
    speeds = _speeds(table)
    found = [table.at(speed) for speed in speeds]
    modes = [Mode(mode.decay_rate_per_s, min(mode.angular_frequency_rad_per_s, highest)) for mode in found]
    load, rate_hz = touched.load(output), output.carried_hz
    pairs = tuned_shapes(modes, output.dynamics, rate_hz, output.compensation, load, touched.own)
    return pairs[0][0].tail, node_rows(speeds, pairs)
