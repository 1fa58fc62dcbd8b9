"""One recording of a stroke over grooves: its strikes, the mode that they ring with, and their amplitudes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from hapticd.analysis.recordings.spans import Bools
from hapticd.analysis.statistics import FitError, Floats, Ints
from hapticd.config.modes import Mode
from hapticd.fit.invalid_samples import Cleaned
from hapticd.fit.recording_checks import acceleration_of, pressed, undersampled
from hapticd.fit.spectral_lines import SpectralLine, lines_in_residual
from hapticd.fit.strikes.free_ringing import Complexes, FreeRinging
from hapticd.fit.strikes.onsets import LEAST_STRIKES, loudest_frequency, pick_strikes, ringing_steps, unit_strike
from hapticd.fit.strikes.spacing import row_of, slope_of_row
from hapticd.fit.stylus_motion import Motion, motion_of, running_mean
from hapticd.fit.verdict import AT_LEAST

GROUP: Final = 8
"""Strikes in a group whose frequency is fitted."""
TURNS: Final = 3
"""So often mode and onsets are refined in turn."""
DAMPINGS: Final = (0.15, 0.03, 0.4)
"""B over w that strikes are first looked for with."""
EVEN: Final = 0.05
"""Where they lie off by less, no other damping is tried."""
SCATTERED: Final = 0.22
"""Where they lie off by more, nothing is refined; places at random are off by 0.29."""
NEAR: Final = AT_LEAST["cycles from strike to strike"].fair
BETTER: Final = 0.7
"""A mode that leaves so much less than the one at hand takes its place."""
ECHO: Final = 2.0
"""Every other strike so many times weaker than its neighbours is an echo of the one before."""
UNEVEN: Final = 0.12
"""Strikes that lie off a regular row by more than this part of the spacing (RMS) are not grooves."""
ACCOUNTED: Final = 0.5
"""Less of the variance than this is not one mode struck again and again."""
_FORCE_WINDOW_S: Final = 0.005


@dataclass(frozen=True, slots=True)
class Strike:
    """One groove passed: when and where, how fast and how hard pressed, and A of its ringing."""

    recording: str
    time_s: float
    position_m: float
    speed_m_per_s: float
    force_n: float
    amplitude_m_per_s2: float


@dataclass(frozen=True, slots=True)
class Stroke:
    """One recording as fitted: time from its first sample, and the acceleration that the strikes make."""

    name: str
    rate_hz: float
    acceleration_m_per_s2: Floats
    model_m_per_s2: Floats
    """NaN where no ringing was fitted."""
    variance_accounted_for: float
    spacing_m: float

    def lines(self, needed: int) -> list[SpectralLine]:
        """Of what the model leaves."""
        return lines_in_residual(self.acceleration_m_per_s2, self.model_m_per_s2, self.rate_hz, needed)


@dataclass(frozen=True, slots=True)
class Group:
    """Intervals in a row, their mode, and the mean speed and force there."""

    mode: Mode
    speed_m_per_s: float
    force_n: float


class StrokeFit:
    """The strikes of one recording, and the mode that they ring with."""

    def __init__(self, kept: Cleaned) -> None:
        self.kept = kept
        recording = kept.recording
        self._replaced = np.concatenate(([0], np.cumsum(kept.replaced)))
        self.name = recording.name
        self._rate_hz = recording.rate_hz
        self._seen = acceleration_of(recording)
        force = pressed(recording)
        self._force_n = running_mean(force, round(_FORCE_WINDOW_S * self._rate_hz))
        self._motion: Motion = motion_of(recording, len(self._seen))
        self._time_s = np.arange(len(self._seen)) / self._rate_hz
        rough = loudest_frequency(self._seen, self._rate_hz)
        if slow := undersampled(self._rate_hz, rough):
            raise FitError(f"{self.name}: {slow}")
        mode, onsets = self._begun(2 * math.pi * rough)
        mode, onsets = self._settled(mode, onsets)
        if self._uneven(onsets) > EVEN:
            mode, onsets = self._found_again(mode, onsets)
        self._onsets = self._without_echoes(mode, self._regular(mode, onsets))
        better = self._searched(mode, self._onsets, wide=True)
        if self._left(better) < BETTER * self._left(mode):
            mode = better
        if mode is better or len(self._onsets) < len(onsets):
            mode, self._onsets = self._settled(mode, self._onsets)
        self.mode = mode
        self.groups = self._grouped(mode)

    # ---- Onsets

    def _begun(self, angular: float) -> tuple[Mode, Floats]:
        """Mode and onsets, from several dampings: the ones whose strikes lie most evenly. What is no strike follows
        from a wrong damping, and then lies anywhere."""
        best: tuple[float, Mode, Floats] | None = None
        most = 0
        for part in DAMPINGS:
            mode = Mode(part * angular, angular)
            onsets = self._found(mode)
            most = max(most, len(onsets))
            if len(onsets) < LEAST_STRIKES:
                continue
            mode = self._searched(mode, onsets)
            onsets = self._found(mode)
            most = max(most, len(onsets))
            if len(onsets) < LEAST_STRIKES:
                continue
            uneven = self._uneven(onsets)
            if best is None or uneven < best[0]:
                best = uneven, mode, onsets
            if uneven < EVEN:
                break
        if best is None:
            raise FitError(f"{self.name}: {most} strikes, at least {LEAST_STRIKES} are needed: no grooves here")
        if best[0] > SCATTERED:
            raise FitError(self._scattered(best[0], best[1], best[2]))
        return best[1], best[2]

    def _settled(self, mode: Mode, onsets: Floats) -> tuple[Mode, Floats]:
        """Mode and onsets, each refined in turn by the other."""
        for _ in range(TURNS):
            mode = self._refined(mode, self._intervals(mode, onsets))
            onsets = self._moved(mode, onsets)
        return mode, onsets

    def _found_again(self, mode: Mode, onsets: Floats) -> tuple[Mode, Floats]:
        """Mode and onsets, looked for again with the mode that was found, where they lie more evenly so: what is no
        strike followed from the mode that they were looked for with."""
        again = self._found(mode)
        if len(again) >= LEAST_STRIKES and self._uneven(again) < self._uneven(onsets):
            return self._settled(mode, again)
        return mode, onsets

    def _scattered(self, uneven: float, mode: Mode, onsets: Floats) -> str:
        cycles = float(np.median(np.diff(onsets))) * mode.frequency_hz
        near = f"; they follow within {cycles:.1f} cycles: stroke more slowly" if cycles < NEAR else ""
        return (
            f"{self.name}: the strikes are not at equal distances (off by {100 * uneven:.0f} % of the spacing): "
            f"no grooves here, or grooves of two spacings{near}"
        )

    def _uneven(self, onsets: Floats) -> float:
        """RMS distance from a regular row, as a part of its spacing."""
        place = np.interp(onsets, self._time_s, self._motion.position_m)
        return row_of(place).unevenness(place)

    def _found(self, mode: Mode) -> Floats:
        """Times of the strikes, s, in order: where z steps while the stylus moves."""
        step = ringing_steps(self._seen, self._rate_hz, mode)
        noise = 1.4826 * float(np.median(np.abs(step.real)))
        reach = max(2, round(0.5 * self._rate_hz / mode.frequency_hz))
        unit = ringing_steps(unit_strike(mode, self._rate_hz), self._rate_hz, mode).real
        kept = pick_strikes(step.real, unit, noise, reach)
        moving = np.abs(self._motion.speed_m_per_s)
        return np.asarray(kept[moving[kept] > 0.1 * np.percentile(moving, 90)] / self._rate_hz)

    def _moved(self, mode: Mode, onsets: Floats) -> Floats:
        """Each onset where the phase of its step says, by a sixth of a cycle at most."""
        late = np.zeros(len(onsets))
        jump, whole = self._jumps(mode, onsets)
        turned = np.where(jump.real < 0, -jump, jump)
        late[whole] = -np.angle(turned[whole]) / mode.angular_frequency_rad_per_s
        limit = 1 / (6 * mode.frequency_hz)
        return np.asarray(np.sort(onsets + np.clip(late, -limit, limit)))

    def _regular(self, mode: Mode, onsets: Floats) -> Floats:
        """The onsets that lie in one row of equal distances along the surface. FitError where most do not."""
        place = np.interp(onsets, self._time_s, self._motion.position_m)
        row = row_of(place)
        number, off = row.number, np.abs(row.offsets(place)) / row.spacing_m
        sound = off < 0.25
        # Of several on one groove in one pass (an echo), the one nearest to its place stays.
        order = np.arange(len(place))
        for k in order[:-1]:
            if number[k] == number[k + 1] and sound[k] and sound[k + 1]:
                sound[k if off[k] > off[k + 1] else k + 1] = False
        spread = float(np.sqrt(np.mean(off[sound] ** 2))) if sound.any() else 1.0
        if np.count_nonzero(sound) < max(LEAST_STRIKES, 0.7 * len(place)) or spread > UNEVEN:
            raise FitError(self._scattered(spread, mode, onsets))
        return onsets[sound]

    @property
    def cycles(self) -> float:
        """From one strike to the next."""
        return float(np.median(np.diff(self._onsets))) * self.mode.frequency_hz

    def _without_echoes(self, mode: Mode, onsets: Floats) -> Floats:
        """Half-way between two strikes may be what a wrong damping leaves of the one before."""
        sizes = np.abs(self._jumps(mode, onsets)[0])
        odd = row_of(np.interp(onsets, self._time_s, self._motion.position_m)).number % 2 == 1
        if len(onsets) < 2 * LEAST_STRIKES or not 0 < np.count_nonzero(odd) < len(odd):
            return onsets
        one, other = float(np.median(sizes[odd])), float(np.median(sizes[~odd]))
        if max(one, other) < ECHO * min(one, other):
            return onsets
        kept: Floats = onsets[odd == (one > other)]
        return kept

    @property
    def row(self) -> tuple[Floats, Ints]:
        """Places of the strikes and the numbers of their grooves. The first strike's time is not refined, as what
        rang before it is not known: it has no place."""
        place = np.interp(self._onsets, self._time_s, self._motion.position_m)
        number = row_of(place).number
        whole = self._jumps(self.mode, self._onsets)[1]
        return place[whole], number[whole]

    # ---- The ringing between strikes

    def _intervals(self, mode: Mode, onsets: Floats) -> list[tuple[int, int, float]]:
        """First and last sample (excluded) after each strike, and the strike's time."""
        guard = 0.1 / mode.frequency_hz
        longest = 5 * mode.decay_time_s
        found = []
        for k, onset in enumerate(onsets):
            end = onsets[k + 1] - guard if k + 1 < len(onsets) else self._time_s[-1]
            low = math.ceil((onset + guard) * self._rate_hz)
            high = math.floor(min(end, onset + longest) * self._rate_hz) + 1
            found.append((max(low, 0), min(high, len(self._seen)), float(onset)))
        return found

    def _least(self, mode: Mode) -> int:
        """Samples of an interval that says anything."""
        return max(5, math.ceil(0.4 * self._rate_hz / mode.frequency_hz))

    def _windows(self, mode: Mode, intervals: Sequence[tuple[int, int, float]]) -> FreeRinging:
        return FreeRinging(self._seen, self._rate_hz, intervals, mode, self._least(mode))

    def _jumps(self, mode: Mode, onsets: Floats) -> tuple[Complexes, Bools]:
        """The step in z at each strike, and which steps have a ringing on either side."""
        windows = self._windows(mode, self._intervals(mode, onsets))
        z = np.zeros(len(onsets), dtype=np.complex128)
        whole = np.zeros(len(onsets), dtype=np.bool_)
        if len(windows.used) == 0:
            return z, whole
        z[windows.used] = windows.solved(mode)[0]
        whole[windows.used] = True
        pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
        jump = z.copy()
        jump[1:] -= z[:-1] * np.exp(pole * np.diff(onsets))
        whole[1:] &= whole[:-1].copy()
        whole[0] = False
        return jump, whole

    def _left(self, mode: Mode) -> float:
        """Squares that a mode, refined, leaves."""
        intervals = self._intervals(mode, self._onsets)
        return float(np.sum(self._windows(mode, intervals).solved(self._refined(mode, intervals))[1] ** 2))

    def _searched(self, mode: Mode, onsets: Floats, wide: bool = False) -> Mode:
        """The best of a grid of modes about this one, of the same intervals for all."""
        longest = 1 / (0.05 * mode.angular_frequency_rad_per_s)
        repeat = 1 / float(np.median(np.diff(onsets)))
        w = mode.angular_frequency_rad_per_s
        reach = min(0.3 * w, 2 * math.pi * repeat)
        windows = self._windows(mode, self._intervals(Mode(1 / longest, w), onsets[: 2 * GROUP]))
        if len(windows.used) == 0:
            return mode
        tried = [
            Mode(part * float(angular), float(angular))
            for angular in (np.geomspace(w / 1.7, 1.7 * w, 33) if wide else np.linspace(w - reach, w + reach, 9))
            for part in (0.02, 0.05, 0.12, 0.25, 0.5)
        ]
        return min(tried, key=lambda each: float(np.sum(windows.solved(each)[1] ** 2)))

    def _refined(self, mode: Mode, intervals: Sequence[tuple[int, int, float]]) -> Mode:
        """Least squares in log B and log w over these intervals."""
        from scipy.optimize import least_squares

        place = np.log([mode.decay_rate_per_s, mode.angular_frequency_rad_per_s])
        # The intervals stay as they are while the mode moves, so that sums of squares compare.
        windows = self._windows(mode, intervals)
        if len(windows.used) == 0:
            raise FitError(f"{self.name}: the strikes follow one another within half a cycle: stroke more slowly")

        def left(at: Floats) -> Floats:
            return windows.solved(Mode(math.exp(at[0]), math.exp(at[1])))[1].ravel()

        bounds = place + np.log([[0.02, 0.3], [50.0, 3.0]])
        found = least_squares(left, place, bounds=bounds, xtol=1e-6, ftol=None, gtol=None, max_nfev=40).x
        return Mode(math.exp(found[0]), math.exp(found[1]))

    # ---- What comes of it

    def _grouped(self, mode: Mode) -> list[Group]:
        count = max(1, len(self._onsets) // GROUP)
        intervals = self._intervals(mode, self._onsets)
        edges = np.linspace(0, len(self._onsets), count + 1).round().astype(int)
        found = []
        for low, high in pairwise(edges):
            part = self._onsets[low:high]
            refined = self._refined(mode, intervals[low:high])
            found.append(
                Group(
                    refined,
                    float(np.mean(np.abs(np.interp(part, self._time_s, self._motion.speed_m_per_s)))),
                    float(np.mean(np.interp(part, self._time_s, self._force_n))),
                )
            )
        return found

    def _sizes(self, mode: Mode) -> tuple[Floats, Bools]:
        """Amplitudes of all strikes, positive along the motion, and which of them have a ringing on either side."""
        jump, whole = self._jumps(mode, self._onsets)
        # What was not measured so about a strike says nothing of it.
        at = np.round(self._onsets * self._rate_hz).astype(np.int64)
        reach = max(1, round(self._rate_hz / mode.frequency_hz))
        low, high = np.maximum(at - reach, 0), np.minimum(at + reach + 1, len(self._seen))
        whole &= self._replaced[high] == self._replaced[low]
        along = jump * np.sign(np.interp(self._onsets, self._time_s, self._motion.speed_m_per_s))
        along *= np.sign(np.sum(along.real[whole])) or 1.0
        late = -np.angle(np.where(along.real < 0, -along, along)) / mode.angular_frequency_rad_per_s
        return np.abs(along) * np.exp(-mode.decay_rate_per_s * late) * np.sign(along.real), whole

    def strikes(self, mode: Mode) -> list[Strike]:
        """Those with a ringing on either side; amplitudes positive, along the motion."""
        size, whole = self._sizes(mode)
        speed = np.interp(self._onsets, self._time_s, self._motion.speed_m_per_s)
        return [
            Strike(
                self.name,
                float(self._onsets[k]),
                float(np.interp(self._onsets[k], self._time_s, self._motion.position_m)),
                float(speed[k]),
                float(np.interp(self._onsets[k], self._time_s, self._force_n)),
                float(size[k]),
            )
            for k in np.flatnonzero(whole)
        ]

    def shifts(self, mode: Mode) -> Floats:
        """(2, strikes) what one standard error of frequency and of decay does to the amplitudes, all at once."""
        size, whole = self._sizes(mode)
        found = np.zeros((2, int(np.count_nonzero(whole))))
        count = len(self.groups)
        if count < 2:
            return found
        for k, name in enumerate(("angular_frequency_rad_per_s", "decay_rate_per_s")):
            values = np.array([getattr(group.mode, name) for group in self.groups])
            moved = dataclasses.replace(mode, **{name: getattr(mode, name) + values.std(ddof=1) / math.sqrt(count)})
            found[k] = self._sizes(moved)[0][whole] - size[whole]
        return found

    def stroke(self, mode: Mode) -> Stroke:
        windows = self._windows(mode, self._intervals(mode, self._onsets))
        if len(windows.used) == 0:
            raise FitError(f"{self.name}: the strikes follow one another within half a cycle: stroke more slowly")
        left = windows.solved(mode)[1]
        model = np.full(len(self._seen), np.nan)
        here = windows.index[windows.held]
        model[here] = self._seen[here] - left[windows.held]
        accounted = 1 - float(np.sum(left**2)) / float(np.sum(windows.flat**2))
        if accounted < ACCOUNTED:
            raise FitError(
                f"{self.name}: a mode struck by grooves accounts for {100 * accounted:.0f} % of the variance, "
                f"at least {100 * ACCOUNTED:.0f} % is needed: no grooves here"
            )
        place, number = self.row
        return Stroke(self.name, self._rate_hz, self._seen, model, accounted, float(slope_of_row(number, place)))
