"""A comb, displayed as vibration: every groove that is passed is one strike along the motion.

The strikes are found in the vibration alone. Between them three samples of a mode obey y2 = a y1 - b y0; what a sample
has beyond that belongs to a strike, and two such remainders tell its time and its amplitude. Telemetry holds every bit
of both, and so they come out exactly. Where a servo without real-time rights missed periods, several grooves may lie in
one tick, which strikes them within one period all the same: grooves near to such a gap are left out here, and only
counted in events.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.table import Table

from examples.demo.marks import Marks
from examples.demo.perform import HOVER_M, MASS_KG, Floats, Recorded, hand_depth_m
from hapticd.base.core import Flag
from hapticd.base.errors import HapticdError
from hapticd.config.materials import Material
from hapticd.config.texture import Grooves

MATERIAL: Final = "comb_2400um_vibration"
STIFFNESS_N_PER_M: Final = 800.0
STROKES: Final = tuple((speed, press) for press in (0.5, 1.0, 1.5) for speed in (0.05, 0.1, 0.2))
"""Each a speed, m/s, and the force that is pressed with, N; the second one back, and so on."""
HALF_M: Final = 0.0304
"""Half a stroke's length. The ends lie between two grooves."""
REST_S: Final = 0.15
ROUNDING: Final = 1e-6
"""Of the loudest sample: what is less is rounding."""
SAME_S: Final = 1e-6
"""A groove event and a strike within this are the same."""
FROM_GAP: Final = 3
"""Samples that a strike is found from lie at least as far from a gap; it counts from twice that."""
UNSCALED: Final = 100
"""Strikes that the force limit left whole, away from gaps, at least: what gains are measured from."""
ON_PLACE_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Strikes:
    """What strikes of one mode were found; arrays of shape (n,)."""

    onset_s: Floats
    amplitude: Floats
    """m/s^2, positive along +x."""


@dataclass(frozen=True, slots=True)
class Combing:
    """What was measured; arrays have one element a strike."""

    strikes: Strikes
    position_m: Floats
    speed_m_per_s: Floats
    """As estimated: telemetry's velocity at the strike."""
    force_n: Floats
    whole: npt.NDArray[np.bool_]
    """Whether the force limit left it as it was, no ramp hid the force that it follows, and no gap is near."""
    frequency_hz: float
    decay_time_s: float
    spacing_m: float
    farthest_m: float
    """Of a strike from its groove."""
    passed: int
    """Grooves passed, away from missed periods."""
    missing: int
    """Of them, those without a strike."""
    surplus: int
    """Strikes where no groove was passed."""
    passed_at_all: int
    told: int
    """Grooves that events told of."""
    along_motion: bool
    gains: Floats
    """Of speed, 1/s, and of force, m/s^2/N."""
    gains_by_true_speed: Floats
    with_true_speed: int


def stroking() -> list[list[float]]:
    """Waypoints of a hand that strokes the floor at y = 0 to and fro, each time at another speed and press."""
    return _path()[0]


def stroke_times() -> list[tuple[float, float]]:
    """When each stroke begins and ends."""
    return _path()[1]


def _path() -> tuple[list[list[float]], list[tuple[float, float]]]:
    now, x = 0.5, -HALF_M
    path = [[0.2, x, HOVER_M], [now, x, -hand_depth_m(STROKES[0][1], STIFFNESS_N_PER_M)]]
    times = []
    for speed, press in STROKES:
        depth, lasting = hand_depth_m(press, STIFFNESS_N_PER_M), 2 * HALF_M / speed
        now += REST_S
        path.append([now, x, -depth])
        times.append((now, now + lasting))
        x, now = -x, now + lasting
        path.append([now, x, -depth])
    path += [[now + REST_S, x, path[-1][2]], [now + REST_S + 0.2, x, HOVER_M], [now + REST_S + 0.4, 0.0, HOVER_M]]
    return path, times


def mode_of(time_s: Floats, vibration: Floats) -> tuple[float, float]:
    """Angular frequency and decay rate of a mode that is struck now and then (Prony's method).

    y[n] = 2 r cos(w T) y[n-1] - r^2 y[n-2] with r = exp(-B T), a linear regression over neighbouring samples. The few
    that hold a strike stand out and are left out, until none does.
    """
    step = np.diff(time_s)
    period = float(np.median(step))
    even = (abs(step[1:] - period) < 0.01 * period) & (abs(step[:-1] - period) < 0.01 * period)
    sounding = even & (vibration[:-2] != 0) & (vibration[1:-1] != 0) & (vibration[2:] != 0)
    before = np.stack([vibration[1:-1], vibration[:-2]], axis=1)[sounding]
    now = vibration[2:][sounding]
    if len(now) < 100:
        raise HapticdError("the comb hardly rang: there is no mode to measure")
    used = np.ones(len(now), dtype=np.bool_)
    for _ in range(50):
        weights = np.linalg.lstsq(before[used], now[used], rcond=None)[0]
        error = abs(before @ weights - now)
        fits = error <= max(3 * float(np.median(error)), 1e-12 * float(abs(now).max()))
        if np.array_equal(fits, used):
            break
        used = fits
    radius = np.sqrt(-weights[1])
    return float(np.arccos(weights[0] / (2 * radius)) / period), float(-np.log(radius) / period)


def away_from_gaps(time_s: Floats, samples: int) -> npt.NDArray[np.bool_]:
    """Of each sample, whether no period was missed so many samples around it."""
    step = np.diff(time_s)
    away = np.ones(len(time_s), dtype=np.bool_)
    for n in np.flatnonzero(step > 1.5 * np.median(step)).tolist():
        away[max(0, n - samples + 1) : n + samples + 1] = False
    return away


def strikes_of(time_s: Floats, vibration: Floats, omega: float, decay: float) -> Strikes:
    """Time and amplitude of the strikes of a mode away from gaps, from the vibration that they make together.

    A strike gives c = A exp(-B t) sin(w t) more than what rang before at the first sample after it, and so at the next:
    two samples of one sine, which tell its phase, that is the time, and its amplitude.
    """
    y0, y1, y2 = vibration[:-2], vibration[1:-1], vibration[2:]
    step = np.diff(time_s)
    first, second = step[:-1], step[1:]
    a = np.exp(-decay * second) * np.sin(omega * (first + second)) / np.sin(omega * first)
    b = np.exp(-decay * (first + second)) * np.sin(omega * second) / np.sin(omega * first)
    rounding = ROUNDING * abs(vibration).max()
    beyond = y2 - (a * y1 - b * y0)
    # Exact zero is silence, from where nothing follows, unless it is the sine's own.
    beyond = np.where((y1 == 0) & (abs(beyond) >= rounding), y2, beyond)
    beyond[abs(beyond) < rounding] = 0.0
    beyond[y2 == 0] = 0.0  # what falls silent is no strike but the mode's end
    away = away_from_gaps(time_s, FROM_GAP)[2:]
    onsets, amplitudes = [], []
    n = 0
    while n + 1 < len(beyond):
        if beyond[n] == 0.0 or not away[n]:
            n += 1
            continue
        one, gap = beyond[n], second[n + 1]
        two = beyond[n + 1] + a[n + 1] * one
        sine, cosine = one, (two * np.exp(decay * gap) - one * np.cos(omega * gap)) / np.sin(omega * gap)
        since = float(np.arctan(sine / cosine) / omega)
        onsets.append(time_s[n + 2] - since)
        amplitudes.append(np.copysign(np.hypot(sine, cosine), cosine) * np.exp(decay * since))
        n += 2
    return Strikes(np.array(onsets), np.array(amplitudes))


def passed(position_m: Floats, spacing_m: float) -> list[int]:
    """Where a trace passes a groove, each counted again only once it was half a spacing away, or another passed.

    Of each passage the index of the sample before it.
    """
    cell = np.floor(position_m / spacing_m)
    # The quotient is rounded; the groove lies at the rounded product.
    cell += (cell + 1) * spacing_m <= position_m
    cell -= cell * spacing_m > position_m
    found: list[int] = []
    last, since = None, 0
    for n in np.flatnonzero(np.diff(cell)).tolist():
        # Of several within a tick all count, but for the first if it is the last one again.
        low, high = sorted((int(cell[n]), int(cell[n + 1])))
        met = list(range(low + 1, high + 1))
        if cell[n + 1] < cell[n]:
            met.reverse()
        if met[0] == last and not (abs(position_m[since : n + 1] - last * spacing_m) >= 0.5 * spacing_m).any():
            met.pop(0)
        if met:
            found += [n] * len(met)
            last, since = met[-1], n + 1
    return found


def measured(recorded: Recorded, material: Material) -> Combing:
    """Everything about the comb that telemetry tells; the library says only where grooves should have been."""
    grooves = _grooves(material)
    time_s, samples = recorded.time_s, recorded.samples
    vibration = np.ascontiguousarray(samples["vibration_force_n"][:, 0]) / MASS_KG
    x, push = samples["position_m"][:, 0], samples["contact_force_n"][:, 1]
    omega, decay = mode_of(time_s, vibration)
    strikes = strikes_of(time_s, vibration, omega, decay)
    counts = away_from_gaps(time_s, 2 * FROM_GAP)
    at = strikes.onset_s
    near = np.searchsorted(time_s, at)
    position = np.interp(at, time_s, x)
    speed = np.interp(at, time_s, samples["velocity_m_per_s"][:, 0])
    force = np.interp(at, time_s, push)
    # The flag stands at the first tick after a strike; one tick more on either side covers a strike on a tick.
    limited = (samples["flags"] & (Flag.SATURATED | Flag.RAMPING)) != 0
    whole = counts[near] & np.array([not limited[max(0, n - 1) : n + 2].any() for n in near.tolist()])
    if whole.sum() < UNSCALED:
        raise HapticdError(f"{int(whole.sum())} strikes of the comb came through whole, {UNSCALED} are wanted")
    told = [event for event in recorded.events if event["event"] == "groove"]
    events = np.array([recorded.onset_s(event) for event in told])
    true = np.array([event["true_speed_m_per_s"] for event in told])
    pressed = np.flatnonzero(push > 0)
    before = np.array(passed(x[pressed], grooves.spacing_m), dtype=np.intp)
    passes = pressed[before]
    passes = passes[pressed[before + 1] == passes + 1]  # after a stall the comb is met anew
    # Within a tick the way is straight.
    groove = np.round(0.5 * (x[passes] + x[passes + 1]) / grooves.spacing_m) * grooves.spacing_m
    passing = time_s[passes] + (groove - x[passes]) / (x[passes + 1] - x[passes]) * np.diff(time_s)[passes]
    due = passing[counts[passes]]
    nearest = np.array([int(abs(at - onset).argmin()) for onset in events.tolist()])
    same = (abs(at[nearest] - events) < SAME_S) & whole[nearest]
    return Combing(
        strikes=strikes,
        position_m=position,
        speed_m_per_s=abs(speed),
        force_n=force,
        whole=whole,
        frequency_hz=omega / (2 * np.pi),
        decay_time_s=1 / decay,
        spacing_m=_spacing(position[counts[near]]),
        farthest_m=float(
            abs(position - np.round(position / grooves.spacing_m) * grooves.spacing_m)[counts[near]].max()
        ),
        passed=len(due),
        missing=int(sum(abs(at - time).min() > SAME_S for time in due.tolist())),
        surplus=int(sum(abs(passing - onset).min() > SAME_S for onset in at[counts[near]].tolist())),
        passed_at_all=len(passes),
        told=sum(event["count"] for event in told),
        along_motion=bool((strikes.amplitude * speed > 0).all()),
        gains=_gains(abs(speed)[whole], force[whole], strikes.amplitude[whole]),
        gains_by_true_speed=_gains(abs(true)[same], force[nearest][same], strikes.amplitude[nearest][same]),
        with_true_speed=int(same.sum()),
    )


def _grooves(material: Material) -> Grooves:
    assert isinstance(material.texture, Grooves)
    return material.texture


def _spacing(position_m: Floats) -> float:
    """Slope of the grooves' places over their numbers; strikes of one groove lie close together."""
    ordered = np.sort(position_m)
    number = np.concatenate([[0], np.cumsum(np.diff(ordered) > 0.1 * np.diff(ordered).max())])
    return float(np.polyfit(number, ordered, 1)[0])


def _gains(speed: Floats, force: Floats, amplitude: Floats) -> Floats:
    """The least squares of |A| = g_v |v| + g_F F."""
    return np.asarray(np.linalg.lstsq(np.stack([speed, force], axis=1), abs(amplitude), rcond=None)[0])


def table(found: Combing, material: Material, marks: Marks) -> Table:
    """Measured, library, difference, a line for each."""
    grooves, mode = _grooves(material), material.groove_mode
    assert mode is not None
    rows = Table(title=f"Strokes over {MATERIAL}: strikes found in telemetry")
    for heading in ("", "measured", "library", "difference"):
        rows.add_column(heading, justify="left" if heading == "" else "right")

    def row(what: str, measured: float, wanted: float, digits: int, limit: float) -> None:
        difference = marks.off(f"comb: {what}", measured, wanted, limit)
        rows.add_row(what, f"{measured:.{digits}f}", f"{wanted:.{digits}f}", difference)

    marks.expect(found.missing == 0, f"comb: {found.missing} grooves passed without a strike")
    marks.expect(found.surplus == 0, f"comb: {found.surplus} strikes where no groove was passed")
    marks.expect(
        found.told == found.passed_at_all, f"comb: {found.passed_at_all} grooves passed, events tell of {found.told}"
    )
    marks.expect(found.along_motion, "comb: a strike was not along the motion")
    marks.expect(
        found.farthest_m <= ON_PLACE_M, f"comb: a strike was {1e6 * found.farthest_m:.3g} um away from its groove"
    )
    rows.add_row("grooves told in events, and passed", f"{found.told}", f"{found.passed_at_all}", "")
    where = "" if found.passed == found.passed_at_all else ", away from missed periods"
    rows.add_row(f"strikes found, grooves passed{where}", f"{found.passed - found.missing}", f"{found.passed}", "")
    rows.add_row("farthest strike from its groove, um", f"{1e6 * found.farthest_m:.4f}", "0", "")
    row("spacing, mm", 1e3 * found.spacing_m, 1e3 * grooves.spacing_m, 5, 1e-3)
    row("frequency, Hz", found.frequency_hz, mode.frequency_hz, 1, 0.01)
    row("decay time, ms", 1e3 * found.decay_time_s, 1e3 * mode.decay_time_s, 3, 0.01)
    gains: Sequence[tuple[str, Floats, float]] = (
        ("", found.gains, 0.01),
        (f" by true speed ({found.with_true_speed} strikes)", found.gains_by_true_speed, 0.03),
    )
    for which, (per_speed, per_force), limit in gains:
        row(f"velocity gain{which}, 1/s", per_speed, grooves.velocity_gain_per_s, 2, limit)
        row(f"force gain{which}, m/s^2/N", per_force, grooves.force_gain_m_per_s2_per_n, 3, limit)
    left_out = len(found.whole) - int(found.whole.sum())
    if left_out:
        rows.add_row("scaled, in a ramp or near a missed period: not in the gains", f"{left_out}", "", "")
    return rows
