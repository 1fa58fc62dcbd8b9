"""Fit of grooves to recorded strokes: spacing, the mode of one groove, and the amplitude of its strikes.

Okamura, Dennerlein and Howe, "Vibration Feedback Models for Virtual Environments", ICRA 1998, eq. 2: each groove that
the stylus passes strikes a mode with the amplitude A(v, F) = velocity_gain |v| + force_gain F.

Between two strikes the acceleration is one free ringing, Im(z exp(p t)) with p = -B + i w, plus a drift. For given B
and w, z and the drift of each interval are a linear fit; B and w minimise the residual (variable projection). A strike
is a step in z, from the decayed ringing before to the ringing after the strike: z' - z exp(p dt) = A exp(-p d). The
magnitude of the step gives A. The phase -w d gives the delay d of the strike after its assumed time. Onsets are first
found as steps of z between two windows, before and after each sample.

Frequency and decay are fitted to groups of strikes. The scatter between groups gives the confidence intervals, and
shows whether frequency and decay change with speed or force. The gains are an M-estimate, on which a few outliers have
no influence.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.recordings.spans import Bools
from hapticd.analysis.statistics import Estimate, FitError, Floats, Ints, Robust, common, robust, well_conditioned
from hapticd.config.modes import Mode
from hapticd.fit import preparation
from hapticd.fit.limits import GROOVE_LIMITS
from hapticd.fit.preparation import Stroke, stroke_of
from hapticd.fit.recording import Recording
from hapticd.fit.result import Fit
from hapticd.fit.spectral_lines import lines_in_residual, report_lines
from hapticd.fit.verdict import LOWER_LIMITS, Exclusions, Warnings
from hapticd.rendering.compensation import pole_of

Complexes: TypeAlias = npt.NDArray[np.complex128]


# ---- Onsets: positions of the strikes, and their regular row ---------------------------------------------------------


def _loudest_frequency(acceleration: Floats, rate_hz: float) -> float:
    """Return the frequency, Hz, above 20 Hz, at which the mean spectrum of windows of 40 ms is highest."""
    from scipy.signal import welch

    length = min(len(acceleration), max(64, round(0.04 * rate_hz)))
    overlap = length - max(1, length // 2)
    window = np.hanning(length)
    frequency, power = welch(acceleration, rate_hz, window, noverlap=overlap, nfft=8 * length, detrend="linear")
    return float(frequency[np.argmax(np.where(frequency >= 20.0, power, 0.0))])


def _ringing_steps(acceleration: Floats, rate_hz: float, mode: Mode) -> Complexes:
    """Return the steps (n,) of the ringing's complex amplitude z at all samples: z after a sample minus z before."""
    from scipy.signal import fftconvolve

    length = max(6, round(GROOVE_LIMITS.window_cycles * rate_hz / mode.frequency_hz))
    count = len(acceleration)
    if count < 4 * length:
        raise FitError(f"too short: {count} samples, {4 * length} are needed for grooves")
    taps = np.zeros(2 * length, dtype=np.complex128)
    for index, sign in ((np.arange(length), 1.0), (np.arange(-length, 0), -1.0)):
        ring = np.exp(pole_of(mode) * index / rate_hz)
        solve = np.linalg.pinv(np.stack([ring.imag, ring.real, np.ones(length)], axis=1))
        taps[index + length] += sign * (solve[0] + 1j * solve[1])
    found = fftconvolve(acceleration, taps[::-1])[length - 1 : length - 1 + count]
    found[:length] = 0
    found[count - length :] = 0
    return np.asarray(found)


def _unit_strike(mode: Mode, rate_hz: float) -> Floats:
    """Return the acceleration (n,) of a strike of amplitude 1 that begins at the middle sample."""
    half = math.ceil(max(6 * mode.decay_time_s, 4 * GROOVE_LIMITS.window_cycles / mode.frequency_hz) * rate_hz)
    time = np.arange(-half, half + 1) / rate_hz
    ring = np.exp(-mode.decay_rate_per_s * np.maximum(time, 0.0)) * np.sin(mode.angular_frequency_rad_per_s * time)
    return np.asarray(np.where(time >= 0, ring, 0.0))


def _pick_strikes(step: Floats, unit: Floats, noise: float, reach: int) -> Ints:
    """Return the sorted sample indices of the strikes, which are found and subtracted in turn, the largest first.

    `step` (n,) are the steps of the ringing's amplitude, `unit` those of a strike of amplitude 1, `noise` is the noise
    of `step`. The distance of two strikes exceeds `reach` samples.
    """
    left = step.copy()
    middle = len(unit) // 2
    free = np.ones(len(step), dtype=np.bool_)
    sizes: dict[int, float] = {}

    def strong() -> float:
        return float(np.percentile(np.abs([*sizes.values()]), 75)) if sizes else 0.0

    while len(sizes) < 2000:
        k = int(np.argmax(np.where(free, np.abs(left), 0.0)))
        size = float(left[k]) / float(unit[middle])
        # One or two knocks must not hide strikes.
        usual = strong() if len(sizes) >= GROOVE_LIMITS.min_strikes else 0.0
        if abs(size) <= max(GROOVE_LIMITS.min_strike_size * usual, min(4 * noise, 0.5 * usual)):
            break
        low, high = max(0, k - middle), min(len(left), k + middle + 1)
        left[low:high] -= size * unit[low - k + middle : high - k + middle]
        # The remainder near a strike is due to errors of its time and of the mode.
        free[max(0, k - reach) : k + reach + 1] = False
        sizes[k] = size
    weak = GROOVE_LIMITS.min_strike_size * strong()
    return np.array(sorted(k for k, size in sizes.items() if abs(size) > weak), dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Row:
    """A regular row of grooves with the number (n,) of each strike's groove.

    Strike k is near the position `first_m + number[k] * spacing_m`.
    """

    number: Ints
    spacing_m: float
    first_m: float

    def offsets(self, position: Floats) -> Floats:
        """Return the signed distances (n,) of strikes at `position` from their grooves, as fractions of the spacing."""
        return np.asarray(position - self.first_m - self.number * self.spacing_m) / self.spacing_m

    def unevenness(self, position: Floats) -> float:
        """Return the RMS distance of strikes from their grooves, as a fraction of the spacing."""
        return float(np.sqrt(np.mean(self.offsets(position) ** 2)))


def row_of(position: Floats) -> Row:
    """Return the row of grooves that strikes at `position` (n,), in m, have struck.

    Grooves are numbered by position, or by the distances of successive strikes if the row is then more regular, as it
    is for a position that drifts.
    """
    steps = np.abs(np.diff(position))
    steps = steps[steps > 0]
    if len(steps) < 2:
        raise FitError("all strikes have the same position: is it the wrong column?")
    usual = float(np.median(steps))
    return min((_by_position(position, usual), _by_step(position, usual)), key=lambda row: row.unevenness(position))


def _slope_of_row(number: Ints, position: Floats) -> float:
    """Return the spacing of the grooves, by least squares; negative if the positions fall as the numbers rise."""
    centred = number - number.mean()
    square = float(centred @ centred)
    return float(centred @ position) / square if square > 0 else 0.0


def _by_step(position: Floats, spacing: float) -> Row:
    """Return the row of strikes at `position` (n,), its grooves numbered by the distances of successive strikes."""
    number = np.zeros(len(position), dtype=np.int64)
    for _ in range(4):
        number = np.concatenate(([0], np.cumsum(np.round(np.diff(position) / spacing).astype(np.int64))))
        spacing = abs(_slope_of_row(number, position)) or spacing
    return Row(number, spacing, float(np.median(position - spacing * number)))


def _by_position(position: Floats, usual: float) -> Row:
    """Return the row of strikes at `position` (n,), its grooves numbered by position.

    At the spacing, 0.5 to 2.5 times the `usual` distance of strikes, the strikes' phases agree best. They agree as well
    at half the true spacing, so the widest of equally good spacings is taken.
    """
    few = position[:300]
    waves = np.arange(0.4 / usual, 2.0 / usual, 0.2 / max(float(np.ptp(few)), usual))
    agree = np.abs(np.exp(2j * math.pi * np.outer(waves, few)).mean(axis=1))
    best = int(np.argmax(agree > 0.95 * agree.max()))
    while best + 1 < len(waves) and agree[best + 1] > agree[best]:
        best += 1
    spacing = 1 / float(waves[best])
    first = spacing * float(np.angle(np.exp(2j * math.pi * few / spacing).mean())) / (2 * math.pi)
    # Refined on twice as many strikes each time, because an error of the spacing accumulates.
    counts = [min(len(few), 16)]
    while counts[-1] < len(position):
        counts.append(min(len(position), 2 * counts[-1]))
    for count in (*counts, len(position)):
        part = position[:count]
        number = np.round((part - first) / spacing).astype(np.int64)
        near = np.abs(part - first - number * spacing) < 0.25 * spacing
        if np.ptp(number[near]) if near.any() else 0:
            spacing = abs(_slope_of_row(number[near], part[near]))
            first = float(np.median(part[near] - spacing * number[near]))
    return Row(np.round((position - first) / spacing).astype(np.int64), spacing, first)


# ---- Model: free ringing between strikes -----------------------------------------------------------------------------


class _FreeRinging:
    """Intervals of free ringing, fitted in parallel: arrays (intervals, samples), 0 beyond the end of an interval.

    An interval is modelled by Im(z exp((-B + i w) t)) plus a drift (level and slope), with complex amplitude z, decay
    rate B and angular frequency w. For given B and w, z and drift of each interval are a separate linear fit.
    """

    def __init__(self, measured: Floats, rate_hz: float, low: Ints, high: Ints, onset_s: Floats, mode: Mode) -> None:
        """Take the samples `low` to `high` - 1 (intervals,) after each onset; `used` are those long enough."""
        min_samples = max(5, math.ceil(0.4 * rate_hz / mode.frequency_hz))
        self.used: Ints = np.flatnonzero(high - low >= min_samples)
        low, high, onset_s = low[self.used], high[self.used], onset_s[self.used]
        count = high - low
        steps = np.arange(int(count.max(initial=0)))
        index = low[:, None] + steps
        self.held: Bools = index < high[:, None]
        self.index: Ints = np.where(self.held, index, low[:, None])
        self._first_s = low / rate_hz - onset_s
        self._since_s = steps / rate_hz
        # A level can be separated from the ringing after a cycle, a slope after two.
        cycles = count / rate_hz * mode.frequency_hz
        level = self.held / np.sqrt(count)[:, None] * (cycles > 0.9)[:, None]
        ramp = np.where(self.held, steps - (count[:, None] - 1) / 2, 0.0) * (cycles > 1.8)[:, None]
        ramp /= np.maximum(np.sqrt(np.sum(ramp**2, axis=1, keepdims=True)), 1e-300)
        self._drift = (level, ramp)
        self.flat: Floats = self._less_drift(np.where(self.held, measured[self.index], 0.0))

    def _less_drift(self, values: Floats) -> Floats:
        for column in self._drift:
            values = values - column * _products(column, values)[:, None]
        return values

    def solved(self, mode: Mode) -> tuple[Complexes, Floats]:
        """Return the ringing's complex amplitude (intervals,) at the onsets, and the residual (intervals, samples)."""
        pole = pole_of(mode)
        turned = np.exp(pole * self._first_s)[:, None] * np.exp(pole * self._since_s) * self.held
        sine, cosine = self._less_drift(turned.imag), self._less_drift(turned.real)
        ss, cc, sc = _products(sine, sine), _products(cosine, cosine), _products(sine, cosine)
        sa, ca = _products(sine, self.flat), _products(cosine, self.flat)
        # If both columns are proportional, the interval does not determine z.
        inverse = 1 / np.maximum(ss * cc - sc**2, 1e-12 * ss * cc + 1e-300)
        by_sine, by_cosine = inverse * (cc * sa - sc * ca), inverse * (ss * ca - sc * sa)
        left = self.flat - by_sine[:, None] * sine - by_cosine[:, None] * cosine
        return by_sine + 1j * by_cosine, left


def _products(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", one, other))


@dataclass(frozen=True, slots=True)
class Strike:
    """One passed groove: time, position, speed, force, and amplitude of the ringing that it struck."""

    recording: str
    time_s: float
    position_m: float
    speed_m_per_s: float
    force_n: float
    amplitude_m_per_s2: float


@dataclass(frozen=True, slots=True)
class ModelledStroke:
    """A fitted recording of a stroke, with the acceleration of the model."""

    name: str
    rate_hz: float
    acceleration_m_per_s2: Floats = dataclasses.field(repr=False)
    model_m_per_s2: Floats = dataclasses.field(repr=False)
    """(n,) acceleration of the model, NaN where no ringing was fitted."""
    variance_accounted_for: float
    spacing_m: float


@dataclass(frozen=True, slots=True)
class Group:
    """The mode fitted to a group of consecutive strikes, and the mean speed and force of these strikes."""

    mode: Mode
    speed_m_per_s: float
    force_n: float


class StrokeFit:
    """The strikes in one recording, and the mode that they strike."""

    def __init__(self, stroke: Stroke) -> None:
        self.stroke = stroke
        self.name, self._rate_hz = stroke.recording.name, stroke.recording.rate_hz
        self._seen = stroke.acceleration
        self._force_n = preparation.running_mean(stroke.force, round(0.005 * self._rate_hz))
        self._time_s = np.arange(len(self._seen)) / self._rate_hz
        rough = _loudest_frequency(self._seen, self._rate_hz)
        if slow := preparation.undersampled(self._rate_hz, rough):
            raise FitError(f"{self.name}: {slow}")
        mode, onsets = self._refined_with_onsets(*self._initial(2 * math.pi * rough))
        if self._unevenness_of(onsets) > GROOVE_LIMITS.max_even_scatter:
            # A wrong first mode makes false strikes.
            again = self._found(mode)
            if len(again) >= GROOVE_LIMITS.min_strikes and self._unevenness_of(again) < self._unevenness_of(onsets):
                mode, onsets = self._refined_with_onsets(mode, again)
        self._onsets = self._without_echoes(mode, self._regular(mode, onsets))
        better = self._searched(mode, self._onsets, wide=True)
        if self._residual_squares(better) < 0.7 * self._residual_squares(mode):
            mode = better
        if mode is better or len(self._onsets) < len(onsets):
            mode, self._onsets = self._refined_with_onsets(mode, self._onsets)
        self.mode = mode
        self.groups = self._grouped()

    # ---- Onsets

    def _initial(self, angular: float) -> tuple[Mode, Floats]:
        """Search strikes with modes of several dampings; return the mode and the onsets of the most regular strikes.

        A wrong damping gives false strikes at random positions. `angular` is the frequency of the modes, rad/s.
        """
        best: tuple[float, Mode, Floats] | None = None
        max_count = 0
        for damping in (0.15, 0.03, 0.4):
            mode = Mode(damping * angular, angular)
            onsets = self._found(mode)
            max_count = max(max_count, len(onsets))
            if len(onsets) < GROOVE_LIMITS.min_strikes:
                continue
            mode = self._searched(mode, onsets)
            onsets = self._found(mode)
            max_count = max(max_count, len(onsets))
            if len(onsets) < GROOVE_LIMITS.min_strikes:
                continue
            uneven = self._unevenness_of(onsets)
            if best is None or uneven < best[0]:
                best = uneven, mode, onsets
            if uneven < GROOVE_LIMITS.max_even_scatter:
                break
        if best is None:
            raise FitError(f"{self.name}: {max_count} strikes, {GROOVE_LIMITS.min_strikes} are needed: no grooves here")
        if best[0] > GROOVE_LIMITS.max_first_unevenness:
            raise FitError(self._scattered(*best))
        return best[1], best[2]

    def _refined_with_onsets(self, mode: Mode, onsets: Floats) -> tuple[Mode, Floats]:
        """Refine mode and onsets alternately, three times; an onset moves by at most a sixth of a cycle each time."""
        for _ in range(3):
            mode = self._refined(mode, self._windows(mode, onsets))
            jump, complete = self._jumps(mode, onsets)
            late = np.where(complete, _late(jump, mode), 0.0)
            limit = 1 / (6 * mode.frequency_hz)
            onsets = np.sort(onsets + np.clip(late, -limit, limit))
        return mode, onsets

    def _scattered(self, uneven: float, mode: Mode, onsets: Floats) -> str:
        cycles = float(np.median(np.diff(onsets))) * mode.frequency_hz
        few = cycles < LOWER_LIMITS["cycles from strike to strike"].fair
        near = f"; strikes follow one another within {cycles:.1f} cycles: stroke more slowly" if few else ""
        return (
            f"{self.name}: the strikes are not at equal distances (errors of {100 * uneven:.0f} % of the spacing): "
            f"no grooves here, or grooves of two spacings{near}"
        )

    def _positions(self, onsets: Floats) -> Floats:
        return np.interp(onsets, self._time_s, self.stroke.position)

    def _unevenness_of(self, onsets: Floats) -> float:
        """Return the RMS distance of the strikes at these onsets from a regular row, as a fraction of the spacing."""
        position = self._positions(onsets)
        return row_of(position).unevenness(position)

    def _found(self, mode: Mode) -> Floats:
        """Return the sorted times, s, of strikes: large steps of the ringing's complex amplitude during motion."""
        step = _ringing_steps(self._seen, self._rate_hz, mode).real
        noise = 1.4826 * float(np.median(np.abs(step)))
        reach = max(2, round(0.5 * self._rate_hz / mode.frequency_hz))
        unit = _ringing_steps(_unit_strike(mode, self._rate_hz), self._rate_hz, mode).real
        kept = _pick_strikes(step, unit, noise, reach)
        moving = np.abs(self.stroke.speed)
        return np.asarray(kept[moving[kept] > 0.1 * np.percentile(moving, 90)] / self._rate_hz)

    def _regular(self, mode: Mode, onsets: Floats) -> Floats:
        """Return the onsets of strikes at equal distances along the surface; raise FitError if there are too few."""
        position = self._positions(onsets)
        row = row_of(position)
        number, off = row.number, np.abs(row.offsets(position))
        regular = off < GROOVE_LIMITS.max_offset
        # If one groove has several strikes in a pass (an echo), the one nearest to the groove is kept.
        for k in range(len(position) - 1):
            if number[k] == number[k + 1] and regular[k] and regular[k + 1]:
                regular[k if off[k] > off[k + 1] else k + 1] = False
        spread = float(np.sqrt(np.mean(off[regular] ** 2))) if regular.any() else 1.0
        needed = max(GROOVE_LIMITS.min_strikes, GROOVE_LIMITS.min_regular_fraction * len(position))
        if np.count_nonzero(regular) < needed or spread > GROOVE_LIMITS.max_unevenness:
            raise FitError(self._scattered(spread, mode, onsets))
        return onsets[regular]

    @property
    def cycles(self) -> float:
        """Median number of cycles of the mode between two strikes."""
        return float(np.median(np.diff(self._onsets))) * self.mode.frequency_hz

    def _without_echoes(self, mode: Mode, onsets: Floats) -> Floats:
        """Return the onsets without echoes, false strikes half-way between two strikes that a wrong damping causes.

        The strikes with odd, or with even, groove numbers are echoes if they are at most half as strong as the others.
        """
        sizes = np.abs(self._jumps(mode, onsets)[0])
        odd = row_of(self._positions(onsets)).number % 2 == 1
        if len(onsets) < 2 * GROOVE_LIMITS.min_strikes or not 0 < np.count_nonzero(odd) < len(odd):
            return onsets
        one, other = float(np.median(sizes[odd])), float(np.median(sizes[~odd]))
        if max(one, other) < 2.0 * min(one, other):
            return onsets
        kept: Floats = onsets[odd == (one > other)]
        return kept

    @property
    def row(self) -> tuple[Floats, Ints]:
        """Positions and groove numbers (n,) of the strikes with a fitted ringing on both sides."""
        position = self._positions(self._onsets)
        complete = self._jumps(self.mode, self._onsets)[1]
        return position[complete], row_of(position).number[complete]

    @property
    def spacing_m(self) -> float:
        """Spacing of the grooves; negative if the position falls with time."""
        position, number = self.row
        return _slope_of_row(number, position)

    # ---- The ringing between strikes

    def _windows(self, mode: Mode, onsets: Floats, part: slice = slice(None)) -> _FreeRinging:
        """Return the intervals of free ringing after each strike, or after the strikes of the slice `part`."""
        guard = 0.1 / mode.frequency_hz
        ends = np.minimum(np.append(onsets[1:] - guard, self._time_s[-1]), onsets + 5 * mode.decay_time_s)
        low = np.maximum(np.ceil((onsets + guard) * self._rate_hz), 0).astype(np.int64)
        high = np.minimum(np.floor(ends * self._rate_hz) + 1, len(self._seen)).astype(np.int64)
        return _FreeRinging(self._seen, self._rate_hz, low[part], high[part], onsets[part], mode)

    def _jumps(self, mode: Mode, onsets: Floats) -> tuple[Complexes, Bools]:
        """Return the steps of complex amplitude at the strikes (n,), and whether both sides were fitted (n,)."""
        windows = self._windows(mode, onsets)
        z = np.zeros(len(onsets), dtype=np.complex128)
        complete = np.zeros(len(onsets), dtype=np.bool_)
        if len(windows.used) == 0:
            return z, complete
        z[windows.used] = windows.solved(mode)[0]
        complete[windows.used] = True
        jump = z.copy()
        jump[1:] -= z[:-1] * np.exp(pole_of(mode) * np.diff(onsets))
        complete[1:] &= complete[:-1].copy()
        complete[0] = False
        return jump, complete

    def _residual_squares(self, mode: Mode) -> float:
        """Refine the mode; return the sum of its squared residuals over all intervals between strikes."""
        windows = self._windows(mode, self._onsets)
        return float(np.sum(windows.solved(self._refined(mode, windows))[1] ** 2))

    def _searched(self, mode: Mode, onsets: Floats, wide: bool = False) -> Mode:
        """Return the best of a grid of modes about `mode`; if `wide`, the grid has more frequencies."""
        w = mode.angular_frequency_rad_per_s
        reach = min(0.3 * w, 2 * math.pi / float(np.median(np.diff(onsets))))
        windows = self._windows(Mode(0.05 * w, w), onsets[: 2 * GROOVE_LIMITS.strikes_in_group])
        if len(windows.used) == 0:
            return mode
        tried = [
            Mode(part * float(angular), float(angular))
            for angular in (np.geomspace(w / 1.7, 1.7 * w, 33) if wide else np.linspace(w - reach, w + reach, 9))
            for part in (0.02, 0.05, 0.12, 0.25, 0.5)
        ]
        return min(tried, key=lambda each: float(np.sum(windows.solved(each)[1] ** 2)))

    def _refined(self, mode: Mode, windows: _FreeRinging) -> Mode:
        """Return the mode that fits these intervals best, by least squares in log decay rate and log frequency.

        The intervals stay the same while the mode changes, so that sums of squares are comparable. Raises FitError if
        all intervals are too short.
        """
        from scipy.optimize import least_squares

        self._check_rings(windows)

        def left(at: Floats) -> Floats:
            return windows.solved(Mode(math.exp(at[0]), math.exp(at[1])))[1].ravel()

        start = np.log([mode.decay_rate_per_s, mode.angular_frequency_rad_per_s])
        bounds = start + np.log([[0.02, 0.3], [50.0, 3.0]])
        found = least_squares(left, start, bounds=bounds, xtol=1e-6, ftol=None, gtol=None, max_nfev=40).x
        return Mode(math.exp(found[0]), math.exp(found[1]))

    def _check_rings(self, windows: _FreeRinging) -> None:
        """Raise FitError if all intervals between strikes are too short to fit the ringing."""
        if len(windows.used) == 0:
            raise FitError(f"{self.name}: the strikes follow one another within half a cycle: stroke more slowly")

    # ---- Results

    def _grouped(self) -> list[Group]:
        count = max(1, len(self._onsets) // GROOVE_LIMITS.strikes_in_group)
        found = []
        for low, high in pairwise(np.linspace(0, len(self._onsets), count + 1).round().astype(int)):
            speed, force = self._moved(self._onsets[low:high])
            refined = self._refined(self.mode, self._windows(self.mode, self._onsets, slice(low, high)))
            found.append(Group(refined, float(np.mean(np.abs(speed))), float(np.mean(force))))
        return found

    def _moved(self, onsets: Floats) -> tuple[Floats, Floats]:
        """Return the stylus's speeds, m/s, and forces, N, at these onsets (n,)."""
        columns = (self.stroke.speed, self._force_n)
        speed, force = (np.interp(onsets, self._time_s, column) for column in columns)
        return speed, force

    def _sizes(self, mode: Mode) -> tuple[Floats, Bools]:
        """Return the strikes' amplitudes (n,), positive along the motion, and whether both sides were fitted (n,)."""
        jump, complete = self._jumps(mode, self._onsets)
        # Strikes near replaced samples are not used.
        at = np.round(self._onsets * self._rate_hz).astype(np.int64)
        reach = max(1, round(self._rate_hz / mode.frequency_hz))
        low, high = np.maximum(at - reach, 0), np.minimum(at + reach + 1, len(self._seen))
        replaced = np.concatenate(([0], np.cumsum(self.stroke.replaced)))
        complete &= replaced[high] == replaced[low]
        along = jump * np.sign(self._moved(self._onsets)[0])
        along *= np.sign(np.sum(along.real[complete])) or 1.0
        return np.abs(along) * np.exp(-mode.decay_rate_per_s * _late(along, mode)) * np.sign(along.real), complete

    def strikes(self, mode: Mode) -> list[Strike]:
        """Return the strikes with a fitted ringing on both sides; amplitudes are positive along the motion."""
        size, complete = self._sizes(mode)
        onsets = self._onsets[complete]
        figures = zip(onsets, self._positions(onsets), *self._moved(onsets), size[complete], strict=True)
        return [Strike(self.name, *map(float, each)) for each in figures]

    def shifts(self, mode: Mode) -> Floats:
        """Return the changes (2, strikes) of the amplitudes if frequency, or decay rate, rises by a standard error."""
        size, complete = self._sizes(mode)
        found = np.zeros((2, int(np.count_nonzero(complete))))
        count = len(self.groups)
        if count < 2:
            return found
        for k, name in enumerate(("angular_frequency_rad_per_s", "decay_rate_per_s")):
            values = np.array([getattr(group.mode, name) for group in self.groups])
            moved = dataclasses.replace(mode, **{name: getattr(mode, name) + values.std(ddof=1) / math.sqrt(count)})
            found[k] = self._sizes(moved)[0][complete] - size[complete]
        return found

    def modelled(self, mode: Mode) -> ModelledStroke:
        """Return the stroke as modelled by this mode; raise FitError if the mode explains too little."""
        windows = self._windows(mode, self._onsets)
        self._check_rings(windows)
        left = windows.solved(mode)[1]
        model = np.full(len(self._seen), np.nan)
        here = windows.index[windows.held]
        model[here] = self._seen[here] - left[windows.held]
        accounted = 1 - float(np.sum(left**2)) / float(np.sum(windows.flat**2))
        if accounted < GROOVE_LIMITS.min_explained:
            raise FitError(
                f"{self.name}: a mode struck by grooves explains {100 * accounted:.0f} % of the variance, "
                f"{100 * GROOVE_LIMITS.min_explained:.0f} % are needed: no grooves here"
            )
        return ModelledStroke(self.name, self._rate_hz, self._seen, model, accounted, self.spacing_m)


def _late(jump: Complexes, mode: Mode) -> Floats:
    """Return the delays (n,), s, of strikes after their assumed times, from the phases of the steps `jump` (n,)."""
    return np.asarray(-np.angle(np.where(jump.real < 0, -jump, jump)) / mode.angular_frequency_rad_per_s)


# ---- Intervals and the laws of all strikes ---------------------------------------------------------------------------


def _gains(
    columns: Floats, amplitude: Floats, shifts: Floats, law: Robust, warnings: Warnings
) -> tuple[list[Estimate], float]:
    """Return the gains of speed and of force, which are at least 0, and the correlation of the law with the data.

    `columns` are the strikes' speeds and forces (n, 2), `shifts` are from StrokeFit.shifts, `law` is the fit with gains
    of any sign. Raises FitError if a gain is significantly negative.
    """
    gains, correlation = list(law.coefficients), law.correlation
    usual = float(np.median(np.abs(amplitude)))
    for which, name in enumerate(("velocity", "force")):
        gain = law.coefficients[which]
        if gain.high < 0:
            raise FitError(
                f"the {name} gain must be positive, is {gain.low:.3g} to {gain.high:.3g}: strikes do not "
                f"weaken as the {name} rises; are columns swapped?"
            )
        warnings.check_gain(name, gain, float(np.median(columns[:, which])), usual)
        if gain.value < 0:
            alone = robust(columns[:, [1 - which]], amplitude, shifts)
            gains[which], gains[1 - which] = Estimate(0.0, 0.0, max(0.0, gain.high)), alone.coefficients[0]
            correlation = alone.correlation
    return gains, correlation


def _offset(columns: Floats, amplitude: Floats, shifts: Floats, warnings: Warnings) -> Estimate | None:
    """Return the constant of a law with two gains and a constant, or None if gains and constant cannot be separated.

    A material has no such constant, so a significant one downgrades the verdict.
    """
    columns = np.column_stack((columns, np.ones_like(amplitude)))
    if len(columns) <= 3 or not well_conditioned(columns):
        return None
    offset = robust(columns, amplitude, shifts).coefficients[2]
    if offset.excludes_zero:
        warnings.check("offset", abs(offset.value) / float(amplitude.mean()), offset=offset)
    return offset


def _spacing(fits: Sequence[StrokeFit]) -> Estimate:
    """Return the common spacing of all recordings, m; each row has a separate origin.

    The regression is robust, because a strike with a short ringing may have a wrong position.
    """
    parts = [each.row for each in fits]
    position = np.concatenate([each - each.mean() for each, _ in parts])
    number = np.concatenate([each - each.mean() for _, each in parts])
    which = np.repeat(np.arange(len(parts)), [len(each) for each, _ in parts])
    # The sign of the direction of each stroke.
    turned = np.array([math.copysign(1.0, each.spacing_m) for each in fits])
    columns = np.column_stack((number * turned[which], which[:, None] == np.arange(len(parts))))
    return robust(columns, position, grows=False).coefficients[0]


def _mean_mode(groups: Sequence[Group]) -> Mode:
    """Return the mode with the mean decay time and the mean frequency of these groups."""
    return Mode(
        1 / float(np.mean([group.mode.decay_time_s for group in groups])),
        float(np.mean([group.mode.angular_frequency_rad_per_s for group in groups])),
    )


# ---- The fit, and its verdict ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class GroovesFit(Fit):
    """Result of a fit of grooves. All intervals are 95 % confidence intervals."""

    spacing_m: Estimate
    frequency_hz: Estimate
    decay_time_s: Estimate
    velocity_gain_per_s: Estimate
    force_gain_m_per_s2_per_n: Estimate
    correlation: float
    """Correlation of measured and predicted amplitudes."""
    offset_m_per_s2: Estimate | None
    """Constant of a law of two gains plus a constant; None if gains and constant cannot be separated."""
    frequency_per_speed_hz_s_per_m: Estimate | None
    frequency_per_force_hz_per_n: Estimate | None
    variance_accounted_for: float
    strikes: tuple[Strike, ...]
    strokes: tuple[ModelledStroke, ...]

    def material(self) -> dict[str, object]:
        """Return the keys of a material: its texture. Strokes do not measure the stiffness."""
        return {
            "texture": {
                "kind": "grooves",
                "display": "vibration",
                "spacing_m": self.spacing_m.value,
                # Strokes do not measure the width, and `display: vibration` does not use it.
                "width_m": 0.25 * self.spacing_m.value,
                "velocity_gain_per_s": max(0.0, self.velocity_gain_per_s.value),
                "force_gain_m_per_s2_per_n": max(0.0, self.force_gain_m_per_s2_per_n.value),
                "frequency_hz": self.frequency_hz.value,
                "decay_time_s": self.decay_time_s.value,
            }
        }


def fit_grooves(recordings: Sequence[Recording], excluded: Exclusions | None = None) -> GroovesFit:
    """Fit grooves to strokes at several speeds and forces.

    Unusable recordings and sections are added to `excluded`. Raises FitError if the recordings do not support a fit.
    """
    excluded = Exclusions() if excluded is None else excluded
    warnings = Warnings()
    preparation.refuse_duplicates(recordings)
    sections = preparation.sections_of(recordings, GROOVE_LIMITS.min_section_s, excluded)
    fits = excluded.each(sections, lambda each: StrokeFit(stroke_of(each, "grooves")))
    if not fits:
        raise excluded.refused(f"none of {len(recordings)} recordings can be used")
    preparation.report_cleaning([each.stroke for each in fits], warnings)
    excluded.report_recordings(recordings, warnings)
    _refuse_others(fits)
    recordings = [each.stroke.recording for each in fits]
    modes = [_mean_mode(each.groups) for each in fits]
    groups = [group for each in fits for group in each.groups]
    if len(groups) < 2:
        raise excluded.refused(
            f"too few strikes for an interval: at least {2 * GROOVE_LIMITS.strikes_in_group} are needed in total"
        )
    frequencies = np.array([group.mode.frequency_hz for group in groups])
    frequency = common(frequencies)
    decay = common(np.array([group.mode.decay_time_s for group in groups]))
    strikes = tuple(strike for each, mode in zip(fits, modes, strict=True) for strike in each.strikes(mode))
    strokes = tuple(each.modelled(mode) for each, mode in zip(fits, modes, strict=True))
    shifts = np.concatenate([each.shifts(mode) for each, mode in zip(fits, modes, strict=True)], 1)
    _check_recordings(recordings, fits, strokes, frequency, warnings)
    spacing = _spacing(fits)
    columns = np.array([(abs(strike.speed_m_per_s), strike.force_n) for strike in strikes])
    amplitude = np.array([strike.amplitude_m_per_s2 for strike in strikes])
    low, high = GROOVE_LIMITS.min_amplitude_m_per_s2, GROOVE_LIMITS.max_amplitude_m_per_s2
    preparation.check_range(float(np.median(np.abs(amplitude))), low, high, "median amplitude of the strikes")
    preparation.check_force_varies(recordings, columns[:, 1], warnings)
    preparation.check_independent(columns[:, 0], columns[:, 1])
    law = robust(columns, amplitude, shifts)
    (by_velocity, by_press), correlation = _gains(columns, amplitude, shifts, law, warnings)
    if law.outliers:
        first = strikes[law.outliers[0]]
        reason = f"{len(law.outliers)} of {len(strikes)} strikes are outliers and do not count"
        warnings.note(f"{reason}; the first: {first.recording} at {first.time_s:.4g} s")
        warnings.check("part left out", len(law.outliers) / len(strikes), left=reason)
    offset = _offset(columns, amplitude, shifts, warnings)
    warnings.check("correlation of the law", correlation, what="amplitudes")
    by_speed, by_force = preparation.changes_with(
        np.array([group.speed_m_per_s for group in groups]),
        np.array([group.force_n for group in groups]),
        frequencies,
        "frequency",
        GROOVE_LIMITS.min_frequency_change,
        GROOVE_LIMITS.change_confidence,
        warnings,
    )
    accounted = float(np.mean([stroke.variance_accounted_for for stroke in strokes]))
    warnings.check("variance that grooves explain", accounted)
    for what, figure in (("spacing", spacing), ("frequency", frequency), ("decay time", decay)):
        warnings.check_interval(what, figure)
    return GroovesFit(
        spacing_m=spacing,
        frequency_hz=frequency,
        decay_time_s=decay,
        velocity_gain_per_s=by_velocity,
        force_gain_m_per_s2_per_n=by_press,
        correlation=correlation,
        offset_m_per_s2=offset,
        frequency_per_speed_hz_s_per_m=by_speed,
        frequency_per_force_hz_per_n=by_force,
        variance_accounted_for=accounted,
        strikes=strikes,
        strokes=strokes,
        warnings=tuple(warnings.lines),
        judged=warnings.verdict(
            f"{len(strikes)} strikes with a spacing of {1e3 * spacing.value:.4g} mm, {frequency.value:.4g} Hz, decay "
            f"time {1e3 * decay.value:.3g} ms, amplitudes with a correlation of {correlation:.2f}"
        ),
        left_out=tuple(excluded.items),
    )


def _refuse_others(fits: Sequence[StrokeFit]) -> None:
    """Raise FitError if the recordings differ in the spacing of the grooves or the frequency of the ringing."""
    spacings = np.array([abs(each.spacing_m) for each in fits])
    frequencies = np.array([each.mode.frequency_hz for each in fits])
    for values, max_difference, what, unit, scale in (
        (spacings, GROOVE_LIMITS.max_spacing_difference, "spacing of the grooves:", "mm", 1e3),
        (frequencies, GROOVE_LIMITS.max_frequency_difference, "frequency of the ringing:", "Hz", 1.0),
    ):
        middle = float(np.median(values))
        off = np.abs(values / middle - 1)
        if off.max() > max_difference:
            k = int(np.argmax(off))
            raise FitError(
                f"{fits[k].name}: {what} {scale * values[k]:.4g} {unit}, usually {scale * middle:.4g}: other grooves, "
                "or strokes too fast to separate the strikes"
            )


def _check_recordings(
    recordings: Sequence[Recording],
    fits: Sequence[StrokeFit],
    strokes: Sequence[ModelledStroke],
    frequency: Estimate,
    warnings: Warnings,
) -> None:
    """Downgrade the verdict for wrong units, hum, strikes in quick succession, and a low sampling rate."""
    preparation.report_gravity(recordings, warnings)
    report_lines(
        strokes,
        lambda each, needed: lines_in_residual(each.acceleration_m_per_s2, each.model_m_per_s2, each.rate_hz, needed),
        warnings,
    )
    for each in fits:
        warnings.check("cycles from strike to strike", each.cycles, name=each.name)
    preparation.report_sampling(recordings, frequency.value, warnings)
