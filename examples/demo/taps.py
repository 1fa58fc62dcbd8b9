"""Taps: the hand strikes a floor of each material at many speeds, and the vibration of each tap is fitted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.table import Table

from examples.demo import paper
from examples.demo.marks import Marks, residual
from examples.demo.perform import HOVER_M, Floats, Recorded, Waypoints
from examples.demo.strikes import SAME_TIME_S, Strikes, strikes_of
from hapticd.config.materials import Materials

SPEEDS_M_PER_S: Final = (0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.10, 0.11, 0.12, 0.13, 0.14, 0.15, 0.30)
PRESS_DEPTH_M: Final = 0.004
HOLD_S: Final = 0.06
MIN_TAPS: Final = 10
"""Minimum number of taps below the force limit, from which a slope is measured."""


def _path() -> Waypoints:
    """Return the waypoints of a hand that taps the floor at y = 0 at each speed, in straight lines."""
    path = [[0.0, 0.0, HOVER_M]]
    for speed in SPEEDS_M_PER_S:
        down_s = (HOVER_M + PRESS_DEPTH_M) / speed
        for height, duration_s in (
            (HOVER_M, 0.05),
            (-PRESS_DEPTH_M, down_s),
            (-PRESS_DEPTH_M, HOLD_S),
            (HOVER_M, 0.09),
        ):
            path.append([path[-1][0] + duration_s, 0.0, height])
    return path


PATH: Final = _path()


@dataclass(frozen=True, slots=True)
class Tapped:
    """The visible taps of a material; arrays have one element per tap. Slopes use taps below the force limit."""

    strikes: Strikes
    speed: Floats
    """Estimated speed of each tap, in m/s."""
    true_speed: Floats
    """True speed of the handle at each tap, in m/s."""
    unscaled: npt.NDArray[np.bool_]
    """Whether the tap was below the force limit."""
    silent: int
    """Number of landings without the event of a tap, not counting those at missed periods."""

    @property
    def count(self) -> int:
        """Number of taps below the force limit."""
        return int(self.unscaled.sum())

    def slope(self, speeds: Floats) -> float:
        """Return the slope of a line through the origin, fitted to the amplitudes over `speeds`, in 1/s."""
        v, amplitude = speeds[self.unscaled], self.strikes.amplitude[self.unscaled]
        return float(v @ amplitude / (v @ v))


def landings(recorded: Recorded) -> npt.NDArray[np.uint64]:
    """Return the ticks in which the hand reached the floor from well above it, without a missed period."""
    y = recorded.samples["position_m"][:, 1]
    down = np.flatnonzero((y[:-1] >= 0) & (y[1:] < 0)) + 1
    if len(down) == 0:
        return np.empty(0, dtype=np.uint64)
    highest = np.maximum.reduceat(y, [0, *down[:-1].tolist()])
    return np.setdiff1d(
        recorded.samples["tick"][down[highest > HOVER_M / 2]], recorded.samples["tick"][recorded.gaps()]
    )


def measured(recorded: Recorded) -> Tapped:
    """Measure the taps in telemetry."""
    events = [event for event in recorded.reported("contact") if event["amplitude_m_per_s2"] > 0]
    strikes = strikes_of(recorded, 1, [recorded.onset_s(event) for event in events])
    seen = [events[number] for number in strikes.number.tolist()]
    return Tapped(
        strikes=strikes,
        speed=np.array([event["speed_m_per_s"] for event in seen]),
        true_speed=np.array([event["true_speed_m_per_s"] for event in seen]),
        unscaled=np.array([event["scale"] == 1.0 for event in seen], dtype=np.bool_),
        silent=len(np.setdiff1d(landings(recorded), [event["tick"] for event in events])),
    )


def table(tapped: Mapping[str, Tapped], library: Materials, marks: Marks) -> Table:
    """Return the table of measured figures, library, paper and residuals, without figures if taps are too few."""
    rows = Table(
        title="Taps, fitted to telemetry (below: library and paper, each with the residual)",
        show_lines=True,
        pad_edge=False,
    )
    for heading in ("material", "frequency Hz", "decay ms", "slope 1/s", "by true speed", "taps"):
        rows.add_column(heading, justify="left" if heading == "material" else "right")
    for name, found in tapped.items():
        tap, strikes = library[name].tap, found.strikes
        assert tap is not None
        mode, slope, printed = tap.mode, tap.amplitude_m_per_s2(1.0), paper.TAPS[name]

        def cell(
            what: str, measured: float, wanted: float, published: float, digits: int, limit: float, name: str = name
        ) -> str:
            difference = marks.off(f"{name}: {what}", measured, wanted, limit)
            return f"{measured:.{digits}f}\n{wanted:g} {difference}\n{published:g} {residual(measured, published)}"

        marks.expect(found.silent == 0, f"{name}: the hand landed {found.silent} times without a tap")
        marks.expect(strikes.left_over == 0, f"{name}: {strikes.left_over} samples ring without a tap")
        marks.expect(strikes.late_s <= SAME_TIME_S, f"{name}: a tap begins {1e6 * strikes.late_s:.3g} us off its event")
        if found.count < MIN_TAPS:
            rows.add_row(name, "", "", "", "", f"{found.count} of {MIN_TAPS}")
            continue
        scaled = len(found.unscaled) - found.count
        rows.add_row(
            name,
            cell("frequency", strikes.frequency_hz, mode.frequency_hz, printed.frequency_hz, 1, 0.01),
            cell(
                "decay time",
                1e3 * strikes.decay_time_s,
                1e3 * mode.decay_time_s,
                1e3 * printed.decay_time_s,
                3,
                0.01,
            ),
            cell("slope", found.slope(found.speed), slope, printed.slope_per_s, 1, 0.01),
            cell("by true speed", found.slope(found.true_speed), slope, printed.slope_per_s, 1, 0.03),
            f"{found.count}" + (f"\n+{scaled} scaled" if scaled else ""),
        )
    return rows
