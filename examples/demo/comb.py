"""A comb, displayed as vibration: every groove that is passed is one strike along the motion.

Where a groove is passed is read off the position; what it struck is found in the vibration (`strikes`). Where a servo
without real-time rights missed periods, strikes nearby are hidden, and the grooves only counted in events.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.table import Table

from examples.demo.marks import Marks
from examples.demo.perform import Floats, Recorded, Unseen, Waypoints, stroking
from examples.demo.strikes import SAME_S, Strikes, joined_strikes, strikes_of
from hapticd.base.core import Flag
from hapticd.config.materials import Material
from hapticd.config.scene import Scene
from hapticd.config.texture import Grooves

MATERIAL: Final = "comb_2400um_vibration"
STROKES: Final = tuple((speed, press, 1) for press in (0.5, 1.0, 1.5) for speed in (0.05, 0.1, 0.2))
"""Each a speed, m/s, and the force that is pressed with, N, once; the second one back, and so on."""
HALF_M: Final = 0.0304
"""Half a stroke's length. The ends lie between two grooves."""
WAYS = stroking(HALF_M, STROKES)[1]
UNSCALED: Final = 100
"""Strikes that the force limit left whole, away from gaps, at least: what gains are measured from."""
ON_PLACE_M: Final = 1e-6
RAMP_S: Final = Scene().ramp_s


@dataclass(frozen=True, slots=True)
class Combing:
    """What was measured; arrays have one element a strike."""

    strikes: Strikes
    groove: npt.NDArray[np.int64]
    position_m: Floats
    speed_m_per_s: Floats
    """As estimated: telemetry's velocity at the strike."""
    force_n: Floats
    whole: npt.NDArray[np.bool_]
    """Whether the force limit left it as it was, and no ramp hid the force that it follows."""
    true_speed_m_per_s: Floats
    """As the nearest event has it."""
    in_time: npt.NDArray[np.bool_]
    """Whether that event is of the same time."""
    passed: int
    told: int
    """Grooves that events tell of."""

    def gains(self, speed: Floats, used: npt.NDArray[np.bool_]) -> Floats:
        """Of speed, 1/s, and of force, m/s^2/N: the least squares of |A| = g_v |v| + g_F F."""
        columns = np.stack([abs(speed), self.force_n], axis=1)[used]
        return np.asarray(np.linalg.lstsq(columns, abs(self.strikes.amplitude[used]), rcond=None)[0])


def path(times: int) -> Waypoints:
    """Of all strokes so many times, one after the other; WAYS are those of the first time."""
    return stroking(HALF_M, STROKES * times)[0]


def joined(found: Sequence[Combing]) -> Combing:
    """What was measured in several performances. Raises Unseen where fewer than UNSCALED strikes came through whole."""
    whole = np.concatenate([each.whole for each in found])
    if whole.sum() < UNSCALED:
        raise Unseen(f"{int(whole.sum())} strikes of the comb came through whole, {UNSCALED} are wanted")

    def all_of(field: str) -> Floats:
        return np.concatenate([getattr(each, field) for each in found])

    return Combing(
        strikes=joined_strikes([each.strikes for each in found]),
        groove=np.concatenate([each.groove for each in found]),
        position_m=all_of("position_m"),
        speed_m_per_s=all_of("speed_m_per_s"),
        force_n=all_of("force_n"),
        whole=whole,
        true_speed_m_per_s=all_of("true_speed_m_per_s"),
        in_time=np.concatenate([each.in_time for each in found]),
        passed=sum(each.passed for each in found),
        told=sum(each.told for each in found),
    )


def passages(recorded: Recorded, spacing_m: float) -> tuple[npt.NDArray[np.int64], Floats]:
    """Which grooves were passed under pressure, and when; within a tick the way is straight.

    Where periods were missed for longer than the ramp, the surface is met anew, and nothing is struck on the way.
    """
    x, below = recorded.samples["position_m"][:, 0], recorded.samples["position_m"][:, 1] < 0
    felt = below[:-1] & below[1:] & (np.diff(recorded.time_s) < RAMP_S + 0.5 / recorded.rate_hz)
    cell = np.floor(x / spacing_m).astype(np.int64)
    # The quotient is rounded; the groove lies at the rounded product.
    cell += (cell + 1) * spacing_m <= x
    cell -= cell * spacing_m > x
    found: list[tuple[int, int]] = []
    for n in np.flatnonzero((np.diff(cell) != 0) & felt).tolist():
        low, high = sorted((int(cell[n]), int(cell[n + 1])))
        met = range(low + 1, high + 1)
        found += [(n, groove) for groove in (met if cell[n + 1] > cell[n] else reversed(met))]
    # A groove that was passed last counts again only from half a spacing away.
    found = found[:1] + [
        (n, groove)
        for (since, last), (n, groove) in pairwise(found)
        if groove != last or (abs(x[since + 1 : n + 1] - last * spacing_m) >= 0.5 * spacing_m).any()
    ]
    at, groove = np.array(found, dtype=np.int64).reshape(-1, 2).T
    part = (groove * spacing_m - x[at]) / (x[at + 1] - x[at])
    return groove, recorded.time_s[at] + part * (recorded.time_s[at + 1] - recorded.time_s[at])


def measured(recorded: Recorded, material: Material) -> Combing:
    """Everything about the comb that telemetry tells; the library says only where grooves should have been.

    Raises Unseen where no strike can be seen.
    """
    assert isinstance(material.texture, Grooves)
    groove, due = passages(recorded, material.texture.spacing_m)
    strikes = strikes_of(recorded, 0, due)

    def at_strikes(field: str, axis: int) -> Floats:
        return np.asarray(np.interp(strikes.onset_s, recorded.time_s, recorded.samples[field][:, axis]))

    # The flag stands at the first tick after a strike; one tick more on either side covers a strike on a tick.
    limited = (recorded.samples["flags"] & (Flag.SATURATED | Flag.RAMPING)) != 0
    near = np.searchsorted(recorded.time_s, strikes.onset_s).tolist()
    whole = ~np.array([limited[max(0, n - 1) : n + 2].any() for n in near])
    events = recorded.told("groove")
    onsets = np.array([recorded.onset_s(event) for event in events])
    nearest = abs(strikes.onset_s[:, None] - onsets).argmin(axis=1)
    return Combing(
        strikes=strikes,
        groove=groove[list(strikes.number)],
        position_m=at_strikes("position_m", 0),
        speed_m_per_s=at_strikes("velocity_m_per_s", 0),
        force_n=at_strikes("contact_force_n", 1),
        whole=whole,
        true_speed_m_per_s=np.array([event["true_speed_m_per_s"] for event in events])[nearest],
        in_time=abs(strikes.onset_s - onsets[nearest]) < SAME_S,
        passed=len(due),
        told=sum(event["count"] for event in events),
    )


def table(found: Combing, material: Material, marks: Marks) -> Table:
    """Measured, library, difference, a line for each."""
    grooves, mode, strikes = material.texture, material.groove_mode, found.strikes
    assert isinstance(grooves, Grooves) and mode is not None
    rows = Table(title=f"Strokes over {MATERIAL}: strikes found in telemetry")
    for heading in ("", "measured", "library", "difference"):
        rows.add_column(heading, justify="left" if heading == "" else "right")

    def row(what: str, measured: float, wanted: float, digits: int, limit: float) -> None:
        difference = marks.off(f"comb: {what}", measured, wanted, limit)
        rows.add_row(what, f"{measured:.{digits}f}", f"{wanted:.{digits}f}", difference)

    told, seen, same = found.told, len(strikes.number), found.whole & found.in_time
    farthest = float(abs(found.position_m - found.groove * grooves.spacing_m).max())
    marks.expect(strikes.left_over == 0, f"comb: {strikes.left_over} samples ring without a groove")
    marks.expect(told == found.passed, f"comb: {found.passed} grooves passed, events tell of {told}")
    marks.expect(bool(np.all(strikes.amplitude * found.speed_m_per_s > 0)), "comb: a strike was not along the motion")
    marks.expect(farthest <= ON_PLACE_M, f"comb: a strike was {1e6 * farthest:.3g} um away from its groove")
    rows.add_row("grooves told in events, and passed", f"{told}", f"{found.passed}", "")
    where = ", away from missed periods" if seen + strikes.hidden == found.passed > seen else ""
    rows.add_row(f"strikes found, grooves passed{where}", f"{seen}", f"{found.passed - strikes.hidden}", "")
    rows.add_row("farthest strike from its groove, um", f"{1e6 * farthest:.4f}", "0", "")
    spacing = float(np.polyfit(found.groove, found.position_m, 1)[0])
    row("spacing, mm", 1e3 * spacing, 1e3 * grooves.spacing_m, 5, 1e-3)
    row("frequency, Hz", strikes.frequency_hz, mode.frequency_hz, 1, 0.01)
    row("decay time, ms", 1e3 * strikes.decay_time_s, 1e3 * mode.decay_time_s, 3, 0.01)
    for which, speed, used, limit in (
        ("", found.speed_m_per_s, found.whole, 0.01),
        (f" by true speed ({int(same.sum())} strikes)", found.true_speed_m_per_s, same, 0.03),
    ):
        per_speed, per_force = found.gains(speed, used)
        row(f"velocity gain{which}, 1/s", per_speed, grooves.velocity_gain_per_s, 2, limit)
        row(f"force gain{which}, m/s^2/N", per_force, grooves.force_gain_m_per_s2_per_n, 3, limit)
    if left_out := found.passed - int(found.whole.sum()):
        rows.add_row("scaled, in a ramp or near a missed period: not in the gains", f"{left_out}", "", "")
    return rows
