"""Grooves from recorded strokes: spacing, the mode of one groove, and how hard a groove strikes.

Okamura, Dennerlein and Howe, "Vibration Feedback Models for Virtual Environments", ICRA 1998, eq. 2: each groove that
passes strikes a mode with A(v, F) = velocity_gain |v| + force_gain F.

Between two strikes the acceleration is one free ringing, Im(z exp((-B + i w) t)), beside a drift. So, for each B and w,
every interval is a linear fit of its own, whatever came before it and however near the strikes are; B and w are
those that leave the least (variable projection). A strike is the step in z from what is left of the ringing before
it to the ringing after it: z' - z exp(p dt) = A exp(-p d), whose phase -w d tells how much later than assumed it
struck, and whose size is A. Onsets are first found as steps of z in two windows, one on either side of each sample.

Frequency and decay are fitted over groups of strikes; their scatter gives the intervals, and shows whether they move
with speed or force. The gains are an M-estimate, so that a few strikes of another kind do not pull them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.recordings.spans import Bools
from hapticd.analysis.statistics import Estimate, FitError, Floats, common, least_squares
from hapticd.config.modes import Mode
from hapticd.fit.impossible import Kept, without_impossible
from hapticd.fit.left_out import Left, LeftOut, weigh
from hapticd.fit.lines import Line, lines_beside, tell_lines
from hapticd.fit.recording import Recording
from hapticd.fit.stretches import stretches_of
from hapticd.fit.strokes import (
    Ints,
    Motion,
    Robust,
    acceleration_of,
    excludes_zero,
    motion_of,
    plain,
    pressed,
    robust,
    running_mean,
    tell_few_samples,
    tell_gravity,
    told_apart,
    told_of,
    too_slow,
    varied_force,
)
from hapticd.fit.twins import refuse_twins
from hapticd.fit.verdict import AT_LEAST, Doubts, Verdict

Complexes: TypeAlias = npt.NDArray[np.complex128]

LEAST_S: Final = 0.1
"""Of a stretch of a recording, between gaps and clipped samples."""
LEAST_STRIKES: Final = 8
GROUP: Final = 8
"""Strikes in a group whose frequency is fitted."""
MOST_STRIKES: Final = 2000
"""In one recording."""
DAMPINGS: Final = (0.15, 0.03, 0.4)
"""B over w that strikes are first looked for with."""
FAINT: Final = 0.3
"""Steps smaller than this part of the strong ones are not strikes."""
WINDOW_CYCLES: Final = 1.25
"""Ringing on either side of a sample that is looked at for a strike."""
EVEN: Final = 0.05
"""Where they lie off by less, no other damping is tried."""
SCATTERED: Final = 0.22
"""Where they lie off by more, nothing is refined; places at random are off by 0.29."""
NEAR: Final = AT_LEAST["cycles from strike to strike"].fair
BETTER: Final = 0.7
"""A mode that leaves so much less than the one at hand takes its place."""
ECHO: Final = 2.0
"""Every other strike so many times weaker than its neighbours is an echo of the one before."""
SAME_SPACING: Final = 0.03
"""Recordings whose spacings differ by more are not of the same grooves."""
SAME_MODE: Final = 0.25
"""Recordings whose frequencies differ by more do not ring with the same mode."""
FEW: Final = 300
"""Strikes that a spacing is first looked for with."""
AMPLITUDES_M_PER_S2: Final = (0.1, 5000.0)
"""Of a usual strike; less is not felt."""
UNEVEN: Final = 0.12
"""Strikes that lie off a regular row by more than this part of the spacing (RMS) are not grooves."""
ACCOUNTED: Final = 0.5
"""Less of the variance than this is not one mode struck again and again."""
MOVES: Final = 0.02
"""A change of frequency over the speeds or forces of the recordings that is worth telling, as a part of it."""
WIDTH: Final = 0.25
"""Width over spacing that is written: strokes do not show it, and vibration does not use it."""
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

    def lines(self, needed: int) -> list[Line]:
        """Of what the model leaves."""
        return lines_beside(self.acceleration_m_per_s2, self.model_m_per_s2, self.rate_hz, needed)


@dataclass(frozen=True, slots=True)
class GroovesFit:
    """What strokes over grooves say. All intervals are of 95 %."""

    spacing_m: Estimate
    frequency_hz: Estimate
    decay_time_s: Estimate
    velocity_gain_per_s: Estimate
    force_gain_m_per_s2_per_n: Estimate
    correlation: float
    """Between the amplitudes and what the two gains say of them."""
    offset_m_per_s2: Estimate | None
    """Of a fit with a constant beside the two gains; None where speed and force vary too little for one."""
    frequency_per_speed_hz_s_per_m: Estimate | None
    frequency_per_force_hz_per_n: Estimate | None
    variance_accounted_for: float
    strikes: tuple[Strike, ...]
    strokes: tuple[Stroke, ...]
    warnings: tuple[str, ...]
    judged: Verdict
    left_out: tuple[Left, ...] = ()

    @property
    def verdict(self) -> str:
        return str(self.judged)

    def material(self) -> dict[str, object]:
        """The keys of a material: its texture. Stiffness is not measured by strokes."""
        return {
            "texture": {
                "kind": "grooves",
                "display": "vibration",
                "spacing_m": self.spacing_m.value,
                "width_m": WIDTH * self.spacing_m.value,
                "velocity_gain_per_s": max(0.0, self.velocity_gain_per_s.value),
                "force_gain_m_per_s2_per_n": max(0.0, self.force_gain_m_per_s2_per_n.value),
                "frequency_hz": self.frequency_hz.value,
                "decay_time_s": self.decay_time_s.value,
            }
        }

    def to_dict(self) -> dict[str, object]:
        """Plain data, without the samples."""
        found = plain(self)
        assert isinstance(found, dict)
        for stroke in found["strokes"]:
            del stroke["acceleration_m_per_s2"], stroke["model_m_per_s2"]
        return {**found, "verdict": self.verdict}


def fit_grooves(recordings: Sequence[Recording], left: LeftOut | None = None) -> GroovesFit:
    """Of strokes at several speeds and forces, one or more to a recording. FitError where they do not say it.

    Recordings, and stretches of them, that cannot be used are told to `left`.
    """
    left = LeftOut() if left is None else left
    refuse_twins(recordings)
    rows = left.each(stretches_of(recordings, LEAST_S, left), lambda each: _Row(without_impossible(each, "grooves")))
    if not rows:
        raise left.refused(f"none of {len(recordings)} recordings can be used")
    doubts = Doubts()
    told_of([row.kept for row in rows], doubts)
    weigh(left, recordings, doubts)
    recordings = [row.kept.recording for row in rows]
    _refuse_others(rows)
    each = [_mean_mode(row.groups) for row in rows]
    groups = [group for row in rows for group in row.groups]
    if len(groups) < 2:
        raise left.refused(f"{len(groups)} group of strikes has no interval: needs {2 * GROUP} strikes")
    frequency = common(np.array([group.mode.frequency_hz for group in groups]))
    decay = common(np.array([group.mode.decay_time_s for group in groups]))
    strikes = tuple(strike for row, mode in zip(rows, each, strict=True) for strike in row.strikes(mode))
    strokes = tuple(row.stroke(mode) for row, mode in zip(rows, each, strict=True))
    tell_gravity(recordings, doubts)
    tell_lines(len(strokes), lambda place, needed: strokes[place].lines(needed), doubts)
    for row in rows:
        doubts.at_least(
            "cycles from strike to strike",
            row.cycles,
            f"{row.name}: strikes follow within {row.cycles:.1f} cycles: their mode is hard to tell",
            "stroke more slowly",
        )
    tell_few_samples(recordings, frequency.value, doubts)
    spacing = _spacing(rows)
    speed = np.array([abs(strike.speed_m_per_s) for strike in strikes])
    force = np.array([strike.force_n for strike in strikes])
    amplitude = np.array([strike.amplitude_m_per_s2 for strike in strikes])
    usual = float(np.median(np.abs(amplitude)))
    least, most = AMPLITUDES_M_PER_S2
    if not least <= usual <= most:
        raise FitError(
            f"strikes of {usual:.3g} m/s^2 are no grooves' ({least:g} to {most:g}): is its unit another one?"
        )
    varied_force(recordings, force, doubts)
    if not told_apart(np.column_stack((speed, force)), 20):
        raise FitError(
            f"speed ({speed.min():.3g} to {speed.max():.3g} m/s) and force ({force.min():.3g} to {force.max():.3g} N) "
            "rise and fall together or not at all, so that their gains cannot be told apart: vary them on their own"
        )
    both = np.column_stack((speed, force))
    shifts = np.concatenate([row.shifts(mode) for row, mode in zip(rows, each, strict=True)], axis=1)
    law = robust(both, amplitude, shifts)
    velocity_gain, force_gain = law.coefficients
    correlation = law.correlation
    for which, (name, gain) in enumerate((("velocity", velocity_gain), ("force", force_gain))):
        if gain.high < 0:
            raise FitError(
                f"the {name} gain comes out negative ({gain.low:.3g} to {gain.high:.3g}): "
                "strikes that weaken are not of this model; is a column swapped?"
            )
        if gain.low <= 0:
            doubts.tell(f"the {name} gain may be 0: {gain.low:.3g} to {gain.high:.3g}")
        else:
            doubts.gain(name, gain, float(np.median(both[:, which])), usual)
        if gain.value < 0:
            alone = robust(both[:, [1 - which]], amplitude, shifts)
            kept, none = alone.coefficients[0], Estimate(0.0, 0.0, max(0.0, gain.high))
            velocity_gain, force_gain = (none, kept) if which == 0 else (kept, none)
            correlation = alone.correlation
    _tell_outliers(law, strikes, doubts)
    offset = _offset(speed, force, amplitude, shifts)
    if offset is not None and excludes_zero(offset):
        doubts.at_most(
            "offset",
            abs(offset.value) / float(amplitude.mean()),
            f"amplitudes have an offset of {offset.value:.3g} m/s^2 ({offset.low:.3g} to {offset.high:.3g})",
            "the two gains do not have it",
        )
    doubts.at_least(
        "correlation of the law",
        correlation,
        f"speed and force explain the amplitudes poorly: correlation {correlation:.2f}",
        "the gains in the material say little",
    )
    by_speed, by_force = _moved(groups, frequency.value, doubts)
    accounted = _accounted(strokes)
    doubts.at_least(
        "variance that grooves explain",
        accounted,
        f"one mode accounts for {100 * accounted:.0f} % of the variance",
        "grooves ring with more",
    )
    for what, figure in (("spacing", spacing), ("frequency", frequency), ("decay time", decay)):
        doubts.known(what, figure)
    summary = (
        f"{len(strikes)} strikes {1e3 * spacing.value:.4g} mm apart, {frequency.value:.4g} Hz, decay time "
        f"{1e3 * decay.value:.3g} ms, amplitudes with a correlation of {correlation:.2f}"
    )
    return GroovesFit(
        spacing_m=spacing,
        frequency_hz=frequency,
        decay_time_s=decay,
        velocity_gain_per_s=velocity_gain,
        force_gain_m_per_s2_per_n=force_gain,
        correlation=correlation,
        offset_m_per_s2=offset,
        frequency_per_speed_hz_s_per_m=by_speed,
        frequency_per_force_hz_per_n=by_force,
        variance_accounted_for=accounted,
        strikes=strikes,
        strokes=strokes,
        warnings=tuple(doubts.told),
        judged=doubts.judged(summary),
        left_out=tuple(left.items),
    )


# ---- One recording --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Group:
    """Intervals in a row, their mode, and the mean speed and force there."""

    mode: Mode
    speed_m_per_s: float
    force_n: float


class _Row:
    """The strikes of one recording."""

    def __init__(self, kept: Kept) -> None:
        self.kept = kept
        recording = kept.recording
        self._replaced = np.concatenate(([0], np.cumsum(kept.replaced)))
        self.name = self._name = recording.name
        self._rate_hz = recording.rate_hz
        self._seen = acceleration_of(recording)
        force = pressed(recording)
        self._force_n = running_mean(force, round(_FORCE_WINDOW_S * self._rate_hz))
        self._motion: Motion = motion_of(recording, len(self._seen))
        self._time_s = np.arange(len(self._seen)) / self._rate_hz
        rough = _rough_frequency(self._seen, self._rate_hz)
        if slow := too_slow(self._rate_hz, rough):
            raise FitError(f"{self._name}: {slow}")
        mode, onsets = self._begun(2 * math.pi * rough)
        for _ in range(3):
            mode = self._refined(mode, self._intervals(mode, onsets))
            onsets = self._moved(mode, onsets)
        if self._uneven(onsets) > EVEN:
            # What is no strike followed from the mode that they were looked for with.
            again = self._found(mode)
            if len(again) >= LEAST_STRIKES and self._uneven(again) < self._uneven(onsets):
                for _ in range(3):
                    mode = self._refined(mode, self._intervals(mode, again))
                    again = self._moved(mode, again)
                onsets = again
        self._onsets = self._without_echoes(mode, self._regular(mode, onsets))
        better = self._searched(mode, self._onsets, wide=True)
        if self._left(better) < BETTER * self._left(mode):
            mode = better
        if mode is better or len(self._onsets) < len(onsets):
            for _ in range(3):
                mode = self._refined(mode, self._intervals(mode, self._onsets))
                self._onsets = self._moved(mode, self._onsets)
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
            raise FitError(f"{self._name}: {most} strikes, at least {LEAST_STRIKES} are needed: no grooves here")
        if best[0] > SCATTERED:
            raise FitError(self._scattered(best[0], best[1], best[2]))
        return best[1], best[2]

    def _scattered(self, uneven: float, mode: Mode, onsets: Floats) -> str:
        cycles = float(np.median(np.diff(onsets))) * mode.frequency_hz
        near = f"; they follow within {cycles:.1f} cycles: stroke more slowly" if cycles < NEAR else ""
        return (
            f"{self._name}: the strikes are not at equal distances (off by {100 * uneven:.0f} % of the spacing): "
            f"no grooves here, or grooves of two spacings{near}"
        )

    def _uneven(self, onsets: Floats) -> float:
        """RMS distance from a regular row, as a part of its spacing."""
        place = np.interp(onsets, self._time_s, self._motion.position_m)
        return _off(place, _row(place))

    def _found(self, mode: Mode) -> Floats:
        """Times of the strikes, s, in order: where z steps while the stylus moves."""
        step = _steps(self._seen, self._rate_hz, mode)
        noise = 1.4826 * float(np.median(np.abs(step.real)))
        reach = max(2, round(0.5 * self._rate_hz / mode.frequency_hz))
        unit = _steps(_unit(mode, self._rate_hz), self._rate_hz, mode).real
        kept = _picked(step.real, unit, noise, reach)
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
        number, spacing, first = _row(place)
        off = np.abs(place - first - number * spacing) / spacing
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
        odd = _row(np.interp(onsets, self._time_s, self._motion.position_m))[0] % 2 == 1
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
        number, _, _ = _row(place)
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

    def _windows(self, mode: Mode, intervals: Sequence[tuple[int, int, float]]) -> _Windows:
        return _Windows(self._seen, self._rate_hz, intervals, mode, self._least(mode))

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
        """Gauss and Newton's steps in log B and log w over these intervals."""
        place = np.log([mode.decay_rate_per_s, mode.angular_frequency_rad_per_s])
        # The intervals stay as they are while the mode moves, so that sums of squares compare.
        windows = self._windows(mode, intervals)
        if len(windows.used) == 0:
            raise FitError(f"{self._name}: the strikes follow one another within half a cycle: stroke more slowly")
        low, high = place + np.log([[0.02, 0.3], [50.0, 3.0]])

        def left(at: Floats) -> Floats:
            return windows.solved(Mode(math.exp(at[0]), math.exp(at[1])))[1].ravel()

        now = left(place)
        for _ in range(12):
            step = 1e-5
            slopes = np.stack([(left(place + step * unit) - now) / step for unit in np.eye(2)], axis=1)
            move = np.clip(np.linalg.lstsq(slopes, -now, rcond=None)[0], -0.3, 0.3)
            for _ in range(6):
                there = np.clip(place + move, low, high)
                after = left(there)
                if after @ after < now @ now:
                    break
                move = move / 2
            else:
                break
            place, now = there, after
            if float(np.abs(move).max()) < 1e-6:
                break
        return Mode(math.exp(place[0]), math.exp(place[1]))

    # ---- What comes of it

    def _grouped(self, mode: Mode) -> list[_Group]:
        count = max(1, len(self._onsets) // GROUP)
        intervals = self._intervals(mode, self._onsets)
        edges = np.linspace(0, len(self._onsets), count + 1).round().astype(int)
        found = []
        for low, high in pairwise(edges):
            part = self._onsets[low:high]
            refined = self._refined(mode, intervals[low:high])
            found.append(
                _Group(
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
                self._name,
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
            raise FitError(f"{self._name}: the strikes follow one another within half a cycle: stroke more slowly")
        left = windows.solved(mode)[1]
        model = np.full(len(self._seen), np.nan)
        here = windows.index[windows.held]
        model[here] = self._seen[here] - left[windows.held]
        accounted = 1 - float(np.sum(left**2)) / float(np.sum(windows.flat**2))
        if accounted < ACCOUNTED:
            raise FitError(
                f"{self._name}: a mode struck by grooves accounts for {100 * accounted:.0f} % of the variance, "
                f"at least {100 * ACCOUNTED:.0f} % is needed: no grooves here"
            )
        place, number = self.row
        return Stroke(self._name, self._rate_hz, self._seen, model, accounted, float(_slope(number, place)))


class _Windows:
    """Stretches of free ringing, side by side: arrays (stretches, samples), 0 beyond a stretch's end."""

    def __init__(
        self, seen: Floats, rate_hz: float, intervals: Sequence[tuple[int, int, float]], mode: Mode, least: int
    ) -> None:
        self.used: Ints = np.array(
            [k for k, (low, high, _) in enumerate(intervals) if high - low >= least], dtype=np.int64
        )
        low, high, onset = np.array([intervals[k] for k in self.used], dtype=np.float64).reshape(-1, 3).T
        count = high - low
        steps = np.arange(int(count.max(initial=0)))
        index = low[:, None] + steps
        self.held: Bools = index < high[:, None]
        self.index: Ints = np.where(self.held, index, low[:, None]).astype(np.int64)
        self._first_s = low / rate_hz - onset
        self._since_s = steps / rate_hz
        # A level takes a cycle to tell from the ringing, a slope two.
        cycles = count / rate_hz * mode.frequency_hz
        level = self.held / np.sqrt(count)[:, None] * (cycles > 0.9)[:, None]
        ramp = np.where(self.held, steps - (count[:, None] - 1) / 2, 0.0) * (cycles > 1.8)[:, None]
        ramp /= np.maximum(np.sqrt(np.sum(ramp**2, axis=1, keepdims=True)), 1e-300)
        self._drift = (level, ramp)
        self.flat: Floats = self._less_drift(np.where(self.held, seen[self.index], 0.0))

    def _less_drift(self, values: Floats) -> Floats:
        for column in self._drift:
            values = values - column * np.einsum("ij,ij->i", column, values)[:, None]
        return values

    def solved(self, mode: Mode) -> tuple[Complexes, Floats]:
        """z at each onset, and what the ringing leaves, (stretches, samples)."""
        pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
        turned = np.exp(pole * self._first_s)[:, None] * np.exp(pole * self._since_s) * self.held
        sine, cosine = self._less_drift(turned.imag), self._less_drift(turned.real)
        ss, cc, sc, sa, ca = (
            np.einsum("ij,ij->i", one, other)
            for one, other in (
                (sine, sine),
                (cosine, cosine),
                (sine, cosine),
                (sine, self.flat),
                (cosine, self.flat),
            )
        )
        # Where both columns say the same, the stretch says nothing.
        inverse = 1 / np.maximum(ss * cc - sc**2, 1e-12 * ss * cc + 1e-300)
        by_sine, by_cosine = inverse * (cc * sa - sc * ca), inverse * (ss * ca - sc * sa)
        left = self.flat - by_sine[:, None] * sine - by_cosine[:, None] * cosine
        return by_sine + 1j * by_cosine, left


def _rough_frequency(seen: Floats, rate_hz: float) -> float:
    """Where the mean spectrum of windows of 40 ms is largest, above 20 Hz."""
    length = min(len(seen), max(64, round(0.04 * rate_hz)))
    starts = range(0, len(seen) - length + 1, max(1, length // 2))
    window = np.hanning(length)
    bins = 8 * length
    power = np.zeros(bins // 2 + 1)
    for start in starts:
        part = seen[start : start + length]
        index = np.arange(length) - (length - 1) / 2
        slope = float(index @ part) / float(index @ index)
        power += np.abs(np.fft.rfft(window * (part - part.mean() - slope * index), bins)) ** 2
    frequency = np.fft.rfftfreq(bins, 1 / rate_hz)
    power[frequency < 20.0] = 0.0
    return float(frequency[int(np.argmax(power))])


def _steps(seen: Floats, rate_hz: float, mode: Mode) -> Complexes:
    """By how much z differs between the windows after and before each sample."""
    length = max(6, round(WINDOW_CYCLES * rate_hz / mode.frequency_hz))
    count = len(seen)
    if count < 4 * length:
        raise FitError("a recording of a few cycles holds no grooves")
    pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
    taps = np.zeros(2 * length, dtype=np.complex128)
    for index, sign in ((np.arange(length), 1.0), (np.arange(-length, 0), -1.0)):
        ring = np.exp(pole * index / rate_hz)
        columns = np.stack([ring.imag, ring.real, np.ones(length)], axis=1)
        solve = np.linalg.pinv(columns)
        taps[index + length] += sign * (solve[0] + 1j * solve[1])
    bins = 1 << (count + 2 * length - 1).bit_length()
    spectrum = np.fft.fft(seen, bins)
    found = np.fft.ifft(spectrum * np.fft.fft(taps[::-1], bins))[length - 1 : length - 1 + count]
    found[:length] = 0
    found[count - length :] = 0
    return np.asarray(found)


def _unit(mode: Mode, rate_hz: float) -> Floats:
    """A strike of 1 in the middle of silence, as long as its ringing."""
    half = math.ceil(max(6 * mode.decay_time_s, 4 * WINDOW_CYCLES / mode.frequency_hz) * rate_hz)
    time = np.arange(-half, half + 1) / rate_hz
    ring = np.exp(-mode.decay_rate_per_s * np.maximum(time, 0.0)) * np.sin(mode.angular_frequency_rad_per_s * time)
    return np.asarray(np.where(time >= 0, ring, 0.0))


def _picked(step: Floats, unit: Floats, noise: float, reach: int) -> Ints:
    """Where strikes are, in order: the largest step first, and what it makes of its neighbourhood taken away."""
    left = step.copy()
    middle = len(unit) // 2
    peak = float(unit[middle])
    free = np.ones(len(step), dtype=np.bool_)
    at: list[int] = []
    sizes: list[float] = []
    while len(at) < MOST_STRIKES:
        k = int(np.argmax(np.where(free, np.abs(left), 0.0)))
        size = float(left[k]) / peak
        # A knock or two must not hide strikes.
        strong = float(np.percentile(np.abs(sizes), 75)) if len(sizes) >= LEAST_STRIKES else 0.0
        if abs(size) <= max(FAINT * strong, min(4 * noise, 0.5 * strong)):
            break
        low, high = max(0, k - middle), min(len(left), k + middle + 1)
        left[low:high] -= size * unit[low - k + middle : high - k + middle]
        # What is left about a strike is the error of its time and of the mode.
        free[max(0, k - reach) : k + reach + 1] = False
        at.append(k)
        sizes.append(size)
    strong = float(np.percentile(np.abs(sizes), 75)) if sizes else 0.0
    return np.array(sorted(k for k, size in zip(at, sizes, strict=True) if abs(size) > FAINT * strong), dtype=np.int64)


def _row(place: Floats) -> tuple[Ints, float, float]:
    """Whole numbers k, and spacing and first, so that place is about first + k spacing: by where the strikes lie, or
    from strike to strike (a speed that was integrated drifts), whichever is the more even."""
    steps = np.abs(np.diff(place))
    steps = steps[steps > 0]
    if len(steps) < 2:
        raise FitError("the strikes are all at one place: is the position the wrong column?")
    usual = float(np.median(steps))
    return min((_by_place(place, usual), _by_step(place, usual)), key=lambda row: _off(place, row))


def _off(place: Floats, row: tuple[Ints, float, float]) -> float:
    """RMS distance from the row, as a part of its spacing."""
    number, spacing, first = row
    return float(np.sqrt(np.mean((place - first - number * spacing) ** 2))) / spacing


def _by_step(place: Floats, spacing: float) -> tuple[Ints, float, float]:
    number = np.zeros(len(place), dtype=np.int64)
    for _ in range(4):
        number = np.concatenate(([0], np.cumsum(np.round(np.diff(place) / spacing).astype(np.int64))))
        spacing = abs(_slope(number, place)) or spacing
    return number, spacing, float(np.median(place - spacing * number))


def _by_place(place: Floats, usual: float) -> tuple[Ints, float, float]:
    """The spacing is the one whose phases agree best, of half the usual step to two and a half of it; half of one that
    agrees does as well, so the largest is taken."""
    few = place[:FEW]
    waves = np.arange(0.4 / usual, 2.0 / usual, 0.2 / max(float(np.ptp(few)), usual))
    agree = np.abs(np.exp(2j * math.pi * np.outer(waves, few)).mean(axis=1))
    best = int(np.argmax(agree > 0.95 * agree.max()))
    while best + 1 < len(waves) and agree[best + 1] > agree[best]:
        best += 1
    spacing = 1 / float(waves[best])
    first = spacing * float(np.angle(np.exp(2j * math.pi * few / spacing).mean())) / (2 * math.pi)
    # Of more strikes each time, as an error of the spacing adds up.
    for count in (*_doubled(min(len(few), 16), len(place)), len(place)):
        part = place[:count]
        number = np.round((part - first) / spacing).astype(np.int64)
        near = np.abs(part - first - number * spacing) < 0.25 * spacing
        if np.ptp(number[near]) if near.any() else 0:
            spacing = abs(_slope(number[near], part[near]))
            first = float(np.median(part[near] - spacing * number[near]))
    return np.round((place - first) / spacing).astype(np.int64), spacing, first


def _doubled(first: int, last: int) -> list[int]:
    found = [first]
    while found[-1] < last:
        found.append(min(last, 2 * found[-1]))
    return found


def _slope(number: Ints, place: Floats) -> float:
    centred = number - number.mean()
    square = float(centred @ centred)
    return float(centred @ place) / square if square > 0 else 0.0


def _spacing(rows: Sequence[_Row]) -> Estimate:
    """One spacing for all; where a row begins is its own. A strike whose ringing is cut short may lie anywhere."""
    parts = [row.row for row in rows]
    place = np.concatenate([each - each.mean() for each, _ in parts])
    number = np.concatenate([each - each.mean() for _, each in parts])
    which = np.repeat(np.arange(len(parts)), [len(each) for each, _ in parts])
    # Whichever way they were stroked.
    turned = np.array([math.copysign(1.0, _slope(each, at)) for at, each in parts])
    columns = np.column_stack((number * turned[which], which[:, None] == np.arange(len(parts))))
    return robust(columns, place, grows=False).coefficients[0]


def _mean_mode(groups: Sequence[_Group]) -> Mode:
    return Mode(
        1 / float(np.mean([group.mode.decay_time_s for group in groups])),
        float(np.mean([group.mode.angular_frequency_rad_per_s for group in groups])),
    )


def _offset(speed: Floats, force: Floats, amplitude: Floats, shifts: Floats) -> Estimate | None:
    columns = np.column_stack((speed, force, np.ones_like(speed)))
    if len(columns) <= 3 or not told_apart(columns):
        return None
    return robust(columns, amplitude, shifts).coefficients[2]


def _tell_outliers(law: Robust, strikes: Sequence[Strike], doubts: Doubts) -> None:
    if law.outliers:
        first = strikes[law.outliers[0]]
        reason = f"{len(law.outliers)} of {len(strikes)} strikes are far off the others and do not count"
        doubts.note(f"{reason}; the first: {first.recording} at {first.time_s:.4g} s")
        doubts.at_most("part left out", len(law.outliers) / len(strikes), reason)


def _refuse_others(rows: Sequence[_Row]) -> None:
    """FitError where recordings are not of the same grooves, or not of the same mode."""
    spacings = np.array([abs(_slope(row.row[1], row.row[0])) for row in rows])
    frequencies = np.array([row.mode.frequency_hz for row in rows])
    for values, most, what, unit, scale in (
        (spacings, SAME_SPACING, "grooves", "mm apart", 1e3),
        (frequencies, SAME_MODE, "ringing at", "Hz", 1.0),
    ):
        middle = float(np.median(values))
        off = np.abs(values / middle - 1)
        if off.max() > most:
            k = int(np.argmax(off))
            raise FitError(
                f"{rows[k].name}: {what} {scale * values[k]:.4g} {unit}, those of the other recordings "
                f"{scale * middle:.4g}: other grooves, or strokes so fast that strikes cannot be told apart"
            )


def _moved(groups: Sequence[_Group], frequency_hz: float, doubts: Doubts) -> tuple[Estimate | None, Estimate | None]:
    """Slopes of the frequency over speed and force, where both vary apart from each other and from a constant."""
    speed = np.array([group.speed_m_per_s for group in groups])
    force = np.array([group.force_n for group in groups])
    columns = np.column_stack((speed, force, np.ones_like(speed)))
    if len(groups) < 6 or not told_apart(columns):
        doubts.note("too few strokes at different speeds and forces to tell whether the frequency moves with them")
        return None, None
    frequencies = np.array([group.mode.frequency_hz for group in groups])
    by_speed, by_force, _ = least_squares(columns, frequencies).coefficients
    for slope, values, name, unit in ((by_speed, speed, "speed", "m/s"), (by_force, force, "force", "N")):
        change = slope.value * float(np.ptp(values))
        if excludes_zero(slope) and abs(change) > MOVES * frequency_hz:
            doubts.tell(
                f"the frequency moves with {name}: by {change:+.3g} Hz from {values.min():.3g} to "
                f"{values.max():.3g} {unit}; "
                "the material has the mean"
            )
    return by_speed, by_force


def _accounted(strokes: Sequence[Stroke]) -> float:
    return float(np.mean([stroke.variance_accounted_for for stroke in strokes]))
