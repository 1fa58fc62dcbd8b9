"""Taps: the floor of a material is struck at many speeds, and the ringing of each fitted in the vibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.table import Table

from examples.demo.marks import Marks
from examples.demo.perform import HOVER_M, Floats, Recorded, Unseen, Waypoints
from examples.demo.strikes import SAME_S, Strikes, strikes_of
from hapticd.base.errors import HapticdError
from hapticd.config.materials import Materials

SPEEDS_M_PER_S: Final = (0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.10, 0.11, 0.12, 0.13, 0.14, 0.15, 0.30)
PRESS_M: Final = 0.004
HOLD_S: Final = 0.06
UNSCALED: Final = 10
"""Taps that the force limit left whole, at least: what a slope is measured from."""


@dataclass(frozen=True, slots=True)
class Tapped:
    """The taps of a material that can be seen; arrays have one element a tap, slopes are of those left whole, 1/s."""

    strikes: Strikes
    speed: Floats
    true_speed: Floats
    whole: npt.NDArray[np.bool_]
    """Whether the force limit left it as it was."""
    late_s: float
    """How far the worst onset is from what its event says."""

    def slope(self, speeds: Floats) -> float:
        """The regression of the amplitude on a speed through the origin."""
        v, amplitude = speeds[self.whole], self.strikes.amplitude[self.whole]
        return float(v @ amplitude / (v @ v))


def tapping(times: int) -> Waypoints:
    """Waypoints of a hand that taps the floor at y = 0 so many times at each speed, in straight lines."""
    path = [[0.0, 0.0, HOVER_M]]
    for speed in SPEEDS_M_PER_S * times:
        down_s = (HOVER_M + PRESS_M) / speed
        for height, lasting in ((HOVER_M, 0.05), (-PRESS_M, down_s), (-PRESS_M, HOLD_S), (HOVER_M, 0.09)):
            path.append([path[-1][0] + lasting, 0.0, height])
    return path


def measured(recorded: Recorded) -> Tapped:
    """The taps that telemetry shows. Raises Unseen where missed periods hid too many, HapticdError where there is no
    slope to measure."""
    events = [event for event in recorded.told("contact") if event["amplitude_m_per_s2"] > 0]
    due = [recorded.onset_s(event) for event in events]
    strikes = strikes_of(recorded, 1, due)
    seen = [events[number] for number in strikes.number]
    whole = np.array([event["scale"] == 1.0 for event in seen])
    if len(recorded.gaps()) and whole.sum() < UNSCALED:
        raise Unseen(f"missed periods hid some taps, and {int(whole.sum())} of {UNSCALED} are left")
    if not whole.any():
        raise HapticdError("every tap was scaled down: there is no slope to measure; tap more slowly")
    return Tapped(
        strikes=strikes,
        speed=np.array([event["speed_m_per_s"] for event in seen]),
        true_speed=np.array([event["true_speed_m_per_s"] for event in seen]),
        whole=whole,
        late_s=strikes.late_s(due),
    )


def table(tapped: Mapping[str, Tapped], library: Materials, marks: Marks) -> Table:
    """Each material: measured, and below it the library's and the difference."""
    rows = Table(title="Taps, fitted to telemetry (below: library, difference)", show_lines=True)
    for heading in ("material", "frequency Hz", "decay ms", "slope 1/s", "slope by true speed", "taps"):
        rows.add_column(heading, justify="left" if heading == "material" else "right")
    for name, found in tapped.items():
        tap, strikes = library[name].tap, found.strikes
        assert tap is not None
        mode, slope = tap.mode, tap.amplitude_m_per_s2(1.0)

        def cell(what: str, measured: float, wanted: float, digits: int, limit: float, name: str = name) -> str:
            difference = marks.off(f"{name}: {what}", measured, wanted, limit)
            return f"{measured:.{digits}f}\n{wanted:.{digits}f} {difference}"

        used = int(found.whole.sum())
        marks.expect(used >= UNSCALED, f"{name}: {used} unscaled taps, {UNSCALED} are wanted")
        marks.expect(strikes.left_over == 0, f"{name}: {strikes.left_over} samples ring without a tap")
        marks.expect(found.late_s <= SAME_S, f"{name}: a tap begins {1e6 * found.late_s:.3g} us off its event")
        scaled = len(found.whole) - used
        rows.add_row(
            name,
            cell("frequency", strikes.frequency_hz, mode.frequency_hz, 1, 0.01),
            cell("decay time", 1e3 * strikes.decay_time_s, 1e3 * mode.decay_time_s, 3, 0.01),
            cell("slope", found.slope(found.speed), slope, 1, 0.01),
            cell("slope by true speed", found.slope(found.true_speed), slope, 1, 0.03),
            f"{used}" + (f"\n+ {scaled} scaled" if scaled else ""),
        )
    return rows
