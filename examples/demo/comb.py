"""A comb that is displayed as vibration: every groove that the hand passes causes one strike along the motion.

The position shows when the hand passes a groove; the vibration shows the strike (`strikes`). If the servo missed
periods, nearby strikes are hidden: their grooves are only counted from events.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.table import Table

from examples.demo import paper
from examples.demo.marks import Marks, residual
from examples.demo.perform import Floats, Recorded, stroking
from examples.demo.strikes import SAME_TIME_S, Strikes, strikes_of
from hapticd.base.core import Flag
from hapticd.config.materials import Material
from hapticd.config.scene import Scene
from hapticd.config.texture import Grooves

MATERIAL: Final = "comb_2400um_vibration"
STROKES: Final = tuple((speed, press, 1) for press in (0.5, 1.0, 1.5) for speed in (0.05, 0.1, 0.2))
"""Speed in m/s, pressing force in N and number of passes of each stroke; directions alternate."""
HALF_STROKE_M: Final = 0.0304
"""Half of the length of a stroke, whose ends lie between two grooves."""
PATH, PASSES = stroking(HALF_STROKE_M, STROKES)
MIN_STRIKES: Final = 100
"""Minimum number of strikes from which gains are measured."""
MAX_POSITION_ERROR_M: Final = 1e-6
"""Largest distance of a strike from its groove."""
RAMP_S: Final = Scene().ramp_s


@dataclass(frozen=True, slots=True)
class Combing:
    """Measurements of the comb; arrays have one element per strike."""

    strikes: Strikes
    groove: npt.NDArray[np.int64]
    position_m: Floats
    direction: Floats
    """Direction of the motion in the tick of the strike, 1 or -1. The estimated speed is late when the hand turns."""
    speed_m_per_s: Floats
    """Estimated speed: telemetry's velocity at the strike."""
    force_n: Floats
    true_speed_m_per_s: Floats
    """True speed in the nearest event."""
    unscaled: npt.NDArray[np.bool_]
    """Whether an event has the same time, and neither the force limit nor a ramp changed the force."""
    passed: int
    """Number of grooves that the hand passed."""
    reported: int
    """Number of grooves in events."""

    @property
    def count(self) -> int:
        """Number of strikes from which gains are measured."""
        return int(self.unscaled.sum())

    def gains(self, speed: Floats) -> Floats:
        """Fit the gains of speed in 1/s and of force in m/s^2/N by least squares of |A| = g_v |v| + g_F F."""
        columns = np.stack([abs(speed), self.force_n], axis=1)[self.unscaled]
        return np.asarray(np.linalg.lstsq(columns, abs(self.strikes.amplitude[self.unscaled]), rcond=None)[0])


def passages(recorded: Recorded, spacing_m: float) -> tuple[npt.NDArray[np.int64], Floats, Floats]:
    """Return the grooves passed on the surface y = 0, the times of their strikes, and the directions, 1 or -1.

    Within a tick the path is straight. Grooves passed during missed periods are struck in the last of these periods. If
    the gap is longer than the ramp, the contact begins again, and the grooves of the gap are not struck.
    """
    x, y = recorded.samples["position_m"].T
    below = y < 0
    felt = (below[:-1] | below[1:]) & (np.diff(recorded.time_s) < RAMP_S + 0.5 / recorded.rate_hz)
    # After missed periods the hand may have moved far in the tick in which it landed or left.
    crossing = x[:-1] + y[:-1] / np.where(y[:-1] == y[1:], 1.0, y[:-1] - y[1:]) * np.diff(x)
    ends = np.array([np.where(below[:-1], x[:-1], crossing), np.where(below[1:], x[1:], crossing)])
    cell = np.floor(ends / spacing_m).astype(np.int64)
    # The quotient is rounded; the groove lies at the rounded product.
    cell += (cell + 1) * spacing_m <= ends
    cell -= cell * spacing_m > ends
    found: list[tuple[int, int]] = []
    for n in np.flatnonzero((cell[0] != cell[1]) & felt).tolist():
        low, high = sorted(cell[:, n].tolist())
        crossed = range(low + 1, high + 1)
        found += [(n, groove) for groove in (crossed if cell[1, n] > cell[0, n] else reversed(crossed))]
    # The same groove counts again only if the hand was half a spacing away from it, on the surface.
    on_surface = np.where(np.stack([below[:-1] | felt, below[1:] | felt]), ends, np.nan).T.ravel()
    found = found[:1] + [
        (n, groove)
        for (since, last), (n, groove) in pairwise(found)
        if groove != last or (abs(on_surface[2 * since + 1 : 2 * n + 1] - last * spacing_m) >= 0.5 * spacing_m).any()
    ]
    at, groove = np.array(found, dtype=np.int64).reshape(-1, 2).T
    part = (groove * spacing_m - x[at]) / (x[at + 1] - x[at])
    passed_s = recorded.time_s[at] + part * (recorded.time_s[at + 1] - recorded.time_s[at])
    return groove, np.maximum(passed_s, recorded.time_s[at + 1] - 1 / recorded.rate_hz), np.sign(x[at + 1] - x[at])


def measured(recorded: Recorded, material: Material) -> Combing:
    """Measure the comb from telemetry; only the nominal spacing of the grooves comes from the library."""
    assert isinstance(material.texture, Grooves)
    groove, due, direction = passages(recorded, material.texture.spacing_m)
    strikes = strikes_of(recorded, 0, due)

    def at_strikes(field: str, axis: int) -> Floats:
        return np.asarray(np.interp(strikes.onset_s, recorded.time_s, recorded.samples[field][:, axis]))

    # The flag is set at the first tick after a strike; one more tick on either side covers a strike on a tick.
    limited = recorded.flagged(Flag.SATURATED | Flag.RAMPING)
    near = np.searchsorted(recorded.time_s, strikes.onset_s).tolist()
    free = ~np.array([limited[max(0, n - 1) : n + 2].any() for n in near], dtype=np.bool_)
    events = recorded.reported("groove")
    # The first value is a placeholder, which is the nearest only if there are no events.
    onsets = np.array([-np.inf, *(recorded.onset_s(event) for event in events)])
    nearest = abs(strikes.onset_s[:, None] - onsets).argmin(axis=1)
    return Combing(
        strikes=strikes,
        groove=groove[strikes.number],
        position_m=at_strikes("position_m", 0),
        direction=direction[strikes.number],
        speed_m_per_s=at_strikes("velocity_m_per_s", 0),
        force_n=at_strikes("contact_force_n", 1),
        true_speed_m_per_s=np.array([np.nan, *(event["true_speed_m_per_s"] for event in events)])[nearest],
        unscaled=free & (abs(strikes.onset_s - onsets[nearest]) < SAME_TIME_S),
        passed=len(due),
        reported=sum(event["count"] for event in events),
    )


def table(found: Combing, material: Material, marks: Marks) -> Table:
    """Return the table of measured figures, library, paper and residuals, without figures if strikes are too few."""
    grooves, mode, strikes = material.texture, material.groove_mode, found.strikes
    assert isinstance(grooves, Grooves) and mode is not None
    rows = Table(title=f"Strokes over {MATERIAL}: strikes found in telemetry")
    for heading in ("", "measured", "library", "residual"):
        rows.add_column(heading, justify="left" if heading == "" else "right")

    def row(what: str, measured: float, wanted: float, digits: int, limit: float) -> None:
        difference = marks.off(f"comb: {what}", measured, wanted, limit)
        rows.add_row(what, f"{measured:.{digits}f}", f"{wanted:.{digits}f}", difference)

    reported, seen = found.reported, len(strikes.number)
    farthest = float(abs(found.position_m - found.groove * grooves.spacing_m).max(initial=0.0))
    marks.expect(strikes.left_over == 0, f"comb: {strikes.left_over} samples ring without a groove")
    marks.expect(reported == found.passed, f"comb: {found.passed} grooves passed, events report {reported}")
    marks.expect(bool(np.all(strikes.amplitude * found.direction > 0)), "comb: a strike was not along the motion")
    marks.expect(farthest <= MAX_POSITION_ERROR_M, f"comb: a strike was {1e6 * farthest:.3g} um away from its groove")
    rows.add_row("grooves reported by events, and passed", f"{reported}", f"{found.passed}", "")
    where = ", away from missed periods" if seen + strikes.hidden == found.passed > seen else ""
    rows.add_row(f"strikes found, grooves passed{where}", f"{seen}", f"{found.passed - strikes.hidden}", "")
    rows.add_row("farthest strike from its groove, um", f"{1e6 * farthest:.4f}", "0", "")
    rows.add_row("strikes that gains are measured from, wanted", f"{found.count}", f"{MIN_STRIKES}", "")
    if found.count < MIN_STRIKES:
        return rows
    spacing = float(np.polyfit(found.groove, found.position_m, 1)[0])
    row("spacing, mm", 1e3 * spacing, 1e3 * grooves.spacing_m, 5, 1e-3)
    row("frequency, Hz", strikes.frequency_hz, mode.frequency_hz, 1, 0.01)
    row("decay time, ms", 1e3 * strikes.decay_time_s, 1e3 * mode.decay_time_s, 3, 0.01)
    for which, speed, limit in (("", found.speed_m_per_s, 0.01), (" by true speed", found.true_speed_m_per_s, 0.03)):
        per_speed, per_force = found.gains(speed)
        row(f"velocity gain{which}, 1/s", per_speed, grooves.velocity_gain_per_s, 2, limit)
        row(f"force gain{which}, m/s^2/N", per_force, grooves.force_gain_m_per_s2_per_n, 3, limit)
    per_speed, per_force = found.gains(found.speed_m_per_s)
    of_paper = (
        ("spacing", 1e3 * spacing, 1e3 * paper.COMB_SPACING_M, "mm"),
        ("velocity gain", per_speed, paper.COMB_VELOCITY_GAIN_PER_S, "1/s"),
        ("force gain", per_force, paper.COMB_FORCE_GAIN_M_PER_S2_PER_N, "m/s^2/N"),
    )
    rows.caption = "The paper's comb is another one: " + ", ".join(
        f"{what} {printed:g} {unit} ({residual(measured, printed)})" for what, measured, printed, unit in of_paper
    )
    return rows
