"""Taps: slope, frequency and decay of the ringing at a touch, from recordings of taps at several speeds.

Each tap is found by itself, fitted by itself (ringing.py), and then weighed with the others: frequency and decay as
what the taps have in common, the amplitude as a line over the approach speed (regression.py). Weights are of the
signal to the noise of a tap; its own error bars, which follow its own luck, do not enter.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.fit.recording import Recording, Source
from hapticd.fit.regression import (
    Estimate,
    FitError,
    Floats,
    common,
    require_scipy,
    through_origin,
    with_offset,
)
from hapticd.fit.ringing import Ringing, fit_ringing
from hapticd.fit.strokes import LEAST_RATE, force_of, gravity_of
from hapticd.fit.tap_amplitude import Law, LawKind, Power, law_of
from hapticd.fit.tap_hit import LEAST_TAPS, NO_NOISE, WELL_EXPLAINED, Figures, Hit, TapHit
from hapticd.fit.tap_law import TABLE as TABLE
from hapticd.fit.tap_law import (
    Amplitudes,
    json_of,
    json_table,
    one_astray,
)
from hapticd.fit.tap_misfit import misfit
from hapticd.fit.tap_modes import Modes, modes_of
from hapticd.fit.tap_second import EXPLAINED, SecondMode, as_pairs, pair_of, second_mode
from hapticd.fit.verdict import Doubts, Verdict
from hapticd.mode import Attack, Mode
from hapticd.yaml_source import Json

LEAST_M_PER_S2: Final = 1e-3
MOST_M_PER_S2: Final = 1e6
"""An acceleration whose largest is not between these is none."""
LEAST_HZ: Final = 15.0
"""What is slower than this is a hand's motion."""
GLITCH: Final = 2.0
"""What falls to 1/e in fewer samples is none of a surface."""
OUTSTANDING: Final = 8.0
"""A tap's peak is at least so many times the noise."""
LOUD_CHANCE: Final = 0.01
LOUD_PART: Final = 0.05
"""A sample is loud beyond what noise reaches once in a recording with this chance, and beyond this part of the
recording's largest."""
QUIET_S: Final = 0.02
"""Taps are apart by so long without a loud sample."""
BOUNCE_S: Final = 0.15
"""What is weaker and comes so soon after a tap is its bounce, unless it has an approach of its own."""
BASE_S: Final = 0.05
"""Gravity and drift are seen as medians over so long."""
BLOCK_S: Final = 0.002
CALM: Final = 20.0
CALMER: Final = 0.842
"""The noise is taken where it is calm: this percentile of the blocks, so many of their deviations below the middle."""
BEFORE_S: Final = 0.002
"""A tap is fitted from so long before its onset, or from one decay time before."""
LASTS: Final = 7.0
"""To so many decay times after it."""
APPROACH_S: Final = 0.01
"""Speed is a position's over so long before the onset."""
UNEVEN: Final = 0.5
"""Of its variance that a straight line leaves over there."""
CLIPPED: Final = 3
"""So many equal samples at the end of the range are clipped."""
LEAST_SPEED_M_PER_S: Final = 1e-3
MOST_SPEED_M_PER_S: Final = 10.0
SPEED_RANGE: Final = 1.2
"""The fastest tap is at least so many times as fast as the slowest."""
OTHER_WAY: Final = 0.25
"""Of the taps may begin the other way, and are left out."""
UNCERTAIN: Final = 0.5
"""A tap whose amplitude, decay or frequency is known less than this, one standard error, is not used."""
FEW_SAMPLES: Final = 8.0
"""Samples per period, below which it is said that they are few."""
SOFTEST: Final = 0.003
HARDEST: Final = 10.0
"""Slope over w: 1 where a mass at this speed rings elastically; the paper's seven are 0.07 to 0.87."""
MANY: Final = 5
"""Where so many are not used, and fewer are, the recording is none of taps."""
WELL_LINEAR: Final = 0.9
"""r^2 of A(v)."""
WELL_KNOWN: Final = 0.15
"""What taps are off a law that is no line, as a part of the amplitude."""
SCATTERED: Final = 0.05
"""Frequencies that scatter more are told."""
TOLD: Final = 3
"""So many reasons are in a refusal."""


@dataclass(frozen=True, slots=True)
class TapFit:
    """What the taps have in common. Slopes are of lines through the origin."""

    taps: tuple[TapHit, ...]
    slope_per_s: Estimate
    """`attack: coefficient`, A of eq. 1 over the speed."""
    first_peak_slope_per_s: Estimate
    """`attack: first_peak`, the largest acceleration of the first cycle over the speed."""
    frequency_hz: Estimate
    decay_time_s: Estimate
    modes: Modes | None
    """Frequency and decay time over the speed, where they change with it."""
    r_squared: float
    """Of A(v) through the origin."""
    offset_slope_per_s: Estimate
    offset_m_per_s2: Estimate
    r_squared_offset: float
    """Of A(v) with an offset."""
    variance_accounted_for: float
    """By the mode, median over the taps."""
    law: Law
    """What A(v) is: the line, a power law or a table."""
    power: Power | None
    """The power law, where A(v) is one."""
    second: SecondMode | None
    """Offered where one mode is not enough."""
    sources: tuple[Source, ...]
    warnings: tuple[str, ...]
    judged: Verdict

    @property
    def verdict(self) -> str:
        return str(self.judged)

    @property
    def choices(self) -> dict[str, str]:
        """What was chosen of several models, and why."""
        told = {"amplitude": f"{self.law.named}: {self.law.why}"}
        return told if self.modes is None else {**told, "mode_table": self.modes.why}

    @property
    def linear(self) -> bool:
        """Whether a line through the origin does for A(v)."""
        return self.law.kind == "line"

    @property
    def amplitudes(self) -> Amplitudes:
        """The coefficient over the speed, as `amplitudes` of a material has it: straight lines from rest to the first
        speed and from one to the next; those of the power law, where A(v) is one."""
        return self.law.table if self.power is None else self.power.points

    def material(
        self,
        attack: Attack = "coefficient",
        law: LawKind | None = None,
        two_modes: bool | None = None,
        mode_table: bool | None = None,
    ) -> dict[str, Json]:
        """Keys of a YAML material. `law`, `two_modes` and `mode_table` are as the taps have them, unless given. Raises
        FitError where no second mode or no power law was found, and for a first peak where A alone is known."""
        second = self.second if two_modes or (two_modes is None and self.second and self.second.kept) else None
        if attack != "coefficient" and (law not in (None, "line") or second is not None):
            raise FitError("a table, and two modes, are of coefficients: leave out the first peak")
        if two_modes and second is None:
            raise FitError("no second mode was found: one is enough, or the taps differ")
        if mode_table and self.modes is None:
            raise FitError("frequency and decay do not change with the speed: there is no table of modes")
        alone = second is None or second.kept
        modes = self.modes if alone and mode_table is not False else None
        tap = self._amplitude(attack, law or self.law.kind, second, modes)
        if modes is not None:
            tap["mode_table"] = modes.material()
        elif second is None:
            tap["frequency_hz"] = self.frequency_hz.value
            tap["decay_time_s"] = self.decay_time_s.value
        else:
            tap["frequency_hz"] = second.first_frequency_hz.value
            tap["decay_time_s"] = second.first_decay_time_s.value
        if second is None:
            return {"tap": tap}
        tap["second"] = {
            "frequency_hz": second.frequency_hz.value,
            "decay_time_s": second.decay_time_s.value,
            "ratio": second.ratio.value,
        }
        return {"tap": tap}

    def _amplitude(
        self, attack: Attack, law: LawKind, second: SecondMode | None, modes: Modes | None
    ) -> dict[str, Json]:
        if law == "line":
            slope = self.slope_per_s if attack == "coefficient" else self.first_peak_slope_per_s
            if second is not None:
                slope = second.first_slope_per_s
            told: dict[str, Json] = {"attack_slope_per_s": slope.value}
        else:
            if law == "power" and self.law.power is None:
                raise FitError("no power law was found: the amplitude does not rise with the speed")
            points = self.law.power.points if law == "power" and self.law.power is not None else self.law.table
            if second is not None and not second.kept:
                # Beside the other mode the first one has other amplitudes.
                points = second.amplitudes
            # A first peak is that part of A which the mode of its speed has.
            hertz, time_s = self.frequency_hz.value, self.decay_time_s.value
            parts = [
                Mode(1 / t, 2 * math.pi * f).peak if attack == "first_peak" else 1.0
                for f, t in (
                    (hertz, time_s)
                    if modes is None
                    else (float(modes.frequency_at(np.array(speed))), float(modes.decay_time_at(np.array(speed))))
                    for speed, _ in points
                )
            ]
            told = {
                "amplitudes": [[speed, part * each.value] for part, (speed, each) in zip(parts, points, strict=True)]
            }
        return told if attack == "coefficient" else {**told, "attack": attack}

    def to_dict(self) -> dict[str, Json]:
        """As JSON has it, without the stretches."""
        told: dict[str, Json] = {}
        for name in (
            "slope_per_s",
            "first_peak_slope_per_s",
            "frequency_hz",
            "decay_time_s",
            "offset_slope_per_s",
            "offset_m_per_s2",
        ):
            told[name] = json_of(getattr(self, name))
        told |= {
            "r_squared": self.r_squared,
            "r_squared_offset": self.r_squared_offset,
            "variance_accounted_for": self.variance_accounted_for,
            "linear": self.linear,
            "law": self.law.to_dict(),
            "modes": None if self.modes is None else self.modes.to_dict(),
            "amplitudes": json_table(self.amplitudes),
            "second": None if self.second is None else self.second.to_dict(),
            "taps": [tap.to_dict() for tap in self.taps],
            "warnings": list(self.warnings),
            "verdict": self.verdict,
            "judged": {"quality": self.judged.quality, "reasons": list(self.judged.reasons)},
        }
        return told


def fit_tap(recordings: Sequence[Recording], progress: Callable[[Recording], None] | None = None) -> TapFit:
    """Fits the taps of one material; `progress` is called after each recording.

    Raises FitError (one line) for what they do not support: no onset, too few taps, all at one speed, clipped, sampled
    too slowly, units that cannot be.
    """
    require_scipy()
    warnings: list[str] = []
    hits, second = _found(recordings, progress, warnings)
    taps = tuple(tap for tap, _ in hits)
    _check_speeds(taps)
    figures = Figures.of(hits)
    decay = common(figures.decays, figures.of_decay)
    angular = common(figures.angulars, figures.of_angular)
    # Taps differ by parts of their amplitudes.
    over = (figures.speeds, figures.amplitudes, figures.of_amplitude, figures.speeds**2)
    line, shifted = through_origin(*over), with_offset(*over)
    peak_line = through_origin(figures.speeds, figures.peaks, figures.of_peak, figures.speeds**2)
    slope = line.coefficients[0]
    _check_slope(slope, math.exp(angular.value))

    frequency = angular.mapped(lambda log: math.exp(log) / (2 * math.pi))
    explained = float(np.median([tap.variance_accounted_for for tap in taps]))
    _check_ringing(frequency.value, math.exp(-decay.value), taps)
    _warn_of_rate(min(recording.rate_hz for recording in recordings), frequency.value, warnings)
    if second is None:
        second = second_mode(hits, explained)
    astray = one_astray(taps, figures.speeds, figures.amplitudes, figures.noise)
    law = law_of(figures.speeds, figures.amplitudes, figures.of_amplitude, "line" if astray else None)
    doubts = Doubts()
    _doubt_the_mode(doubts, hits, second, explained, warnings)
    decay_time = decay.mapped(lambda log: math.exp(-log))
    modes = modes_of(figures, frequency, decay_time)
    _doubt_the_speed(doubts, figures, modes)
    _doubt_the_law(doubts, law, astray, line.r_squared)
    warnings += doubts.told
    return TapFit(
        taps=taps,
        slope_per_s=slope,
        first_peak_slope_per_s=peak_line.coefficients[0],
        frequency_hz=frequency,
        decay_time_s=decay_time,
        modes=modes,
        r_squared=line.r_squared,
        offset_slope_per_s=shifted.coefficients[0],
        offset_m_per_s2=shifted.coefficients[1],
        r_squared_offset=shifted.r_squared,
        variance_accounted_for=explained,
        law=law,
        power=law.power if law.kind == "power" else None,
        second=second,
        sources=tuple(recording.source for recording in recordings),
        warnings=tuple(warnings),
        judged=doubts.judged(
            f"{_modes(second)} {100 * explained:.1f} % of {len(taps)} taps",
            f"A(v) is {law.named} (r^2 {law.r_squared if law.kind != 'line' else line.r_squared:.3f})",
        ),
    )


def _found(
    recordings: Sequence[Recording], progress: Callable[[Recording], None] | None, warnings: list[str]
) -> tuple[list[Hit], SecondMode | None]:
    """The taps of all recordings, all of which begin the same way, and their second mode where one does not do."""
    _check_files(recordings)
    hits: list[Hit] = []
    for recording in recordings:
        hits += _hits_of(recording, warnings)
        if progress is not None:
            progress(recording)
    hits, second = as_pairs(hits, warnings)
    if len(hits) < LEAST_TAPS:
        more = f"; and {len(warnings) - TOLD} more" if len(warnings) > TOLD else ""
        told = f" ({'; '.join(warnings[:TOLD])}{more})" if warnings else ""
        raise FitError(f"{len(hits)} taps are too few: needs {LEAST_TAPS}, better ten, at different speeds{told}")
    return _upright(hits, warnings), second


def _modes(second: SecondMode | None) -> str:
    return "two modes explain" if second is not None and second.kept else "one mode explains"


def _warn_of_rate(rate_hz: float, frequency_hz: float, warnings: list[str]) -> None:
    if rate_hz < FEW_SAMPLES * frequency_hz:
        warnings.append(
            f"{rate_hz:g} Hz are {rate_hz / frequency_hz:.1f} samples a period at {frequency_hz:.0f} Hz; the "
            "amplitude is less certain than with more, and a filter of the sensor may have lowered it"
        )


def _doubt_the_mode(
    doubts: Doubts,
    hits: Sequence[Hit],
    second: SecondMode | None,
    explained: float,
    warnings: list[str],
) -> None:
    """What one mode, or two, leave over."""
    if second is not None:
        together = 100 * second.variance_accounted_for
        warnings.append(
            f"one mode is not enough: a second at {second.frequency_hz.value:.4g} Hz, "
            f"{1e3 * second.decay_time_s.value:.3g} ms and {second.ratio.value:.2g} times as strong explains "
            f"{together:.1f} % together with the first, which alone explains {100 * second.alone:.1f} %"
        )
        poor = second.variance_accounted_for < WELL_EXPLAINED
        if poor or not second.kept:
            doubts.add(poor, f"two explain {together:.1f} %", "")
    elif explained < WELL_EXPLAINED:
        doubts.add(True, "the rest is of another kind", "")
    else:
        doubts.add(False, *misfit(hits))


def _doubt_the_speed(doubts: Doubts, figures: Figures, modes: Modes | None) -> None:
    """Whether frequency and decay are the same for all speeds."""
    told = math.nan if modes is None else modes.frequency_at(figures.speeds)
    scatter = float(np.std(figures.angulars - (0.0 if modes is None else np.log(told))))
    if scatter > SCATTERED:
        doubts.add(
            scatter > 2 * SCATTERED,
            f"the frequency scatters by {100 * scatter:.0f} % between taps",
            "is it one material, held alike?",
        )
    if modes is not None:
        doubts.note(f"{modes.why}; the material has a table of modes over the speed")


def _doubt_the_law(doubts: Doubts, law: Law, astray: str, r_squared: float) -> None:
    """Whether the speed says what the amplitude is; `r_squared` of the line."""
    if astray:
        doubts.add(False, astray, "is its speed right?")
        return
    if law.kind != "line":
        doubts.note(f"A(v) is {law.named}, no line through the origin: {law.why}")
        # Where the amplitude hardly depends on the speed, r^2 says nothing: what counts is how far taps are from it.
        little = law.r_squared < WELL_LINEAR and law.left > WELL_KNOWN
    else:
        little = r_squared < WELL_LINEAR
    told = r_squared if law.kind == "line" else law.r_squared
    doubts.add(little, f"the speed says little of the amplitude (r^2 {told:.2f})" if little else "", "")


def _check_files(recordings: Sequence[Recording]) -> None:
    seen: dict[str, str] = {}
    for recording in recordings:
        sha256 = recording.source.sha256
        if sha256 and sha256 in seen:
            raise FitError(f"{recording.name}: is the same as {seen[sha256]}: a tap counts once")
        seen[sha256] = recording.name


# ---- Taps in a recording ---------------------------------------------------------------------------------------------


def _hits_of(recording: Recording, warnings: list[str]) -> list[Hit]:
    acceleration = recording.acceleration_m_per_s2
    if acceleration is None:
        raise FitError(f"{recording.name}: has no acceleration, which taps are fitted to")
    largest = float(np.abs(acceleration).max())
    if largest > 0 and not LEAST_M_PER_S2 <= largest <= MOST_M_PER_S2:
        raise FitError(
            f"{recording.name}: an acceleration of {largest:.3g} m/s^2 is none of a stylus ({LEAST_M_PER_S2:g} to "
            f"{MOST_M_PER_S2:g}): is it in another unit, or another column?"
        )
    if recording.force_n is not None:
        _check_force(recording.name, force_of(recording))
    warnings += gravity_of(recording)
    above = acceleration - _base(acceleration, recording.rate_hz)
    events = _events(recording, above)
    speeds = _given_speeds(recording, events, above)
    if speeds is not None and len(speeds) != len(events):
        # One of many thousand samples of noise may be loud by itself.
        events = [(first, last) for first, last in events if first < last] or events
    if speeds is None or len(speeds) != len(events):
        kept = _without_bounces(recording, events, above)
        if speeds is not None and len(speeds) != len(kept):
            raise FitError(
                f"{recording.name}: has {len(speeds)} speeds for {len(kept)} taps"
                f"{f' and {len(events) - len(kept)} bounces' if len(kept) < len(events) else ''}: needs one a tap"
            )
        if len(kept) < len(events):
            warnings.append(f"{recording.name}: {len(events) - len(kept)} bounces after taps are left out")
        events = kept
    found: list[Hit] = []
    too_fast: list[float] = []
    no_taps = wayless = 0
    clipped = _clipped(acceleration)
    ends = [first for first, _ in events[1:]] + [len(above)]
    begins = [0] + [last + 1 for _, last in events[:-1]]
    for index, (first, last) in enumerate(events):
        place = f"{recording.name}: the tap at {first / recording.rate_hz:.4g} s"
        if first - begins[index] < _samples(0.25 * BEFORE_S, recording.rate_hz, 8):
            warnings.append(f"{place} has no rest before it, and is left out")
            continue
        ringing, begin = _fitted(recording, first, last, begins[index], ends[index])
        if clipped[begin : begin + len(ringing.residual)].any():
            warnings.append(f"{place} is clipped, and left out")
            continue
        pair = _pair_of(recording, ringing, begin)
        if ringing.variance_accounted_for < EXPLAINED and pair is None:
            share = 100 * ringing.variance_accounted_for
            warnings.append(f"{place} is left out: a decaying sinusoid explains {share:.0f} % of it")
            no_taps += 1
            if no_taps >= MANY and no_taps > len(found):
                raise FitError(
                    f"{recording.name}: most of what stands out is no tap: a decaying sinusoid explains less than half "
                    f"of {no_taps} of the first {index + 1}"
                )
            continue
        frequency_hz = float(ringing.angular_frequency_rad_per_s[0]) / (2 * math.pi)
        fault = _fault_of(recording, ringing)
        if fault and pair is None:
            warnings.append(f"{place} {fault}")
            too_fast += [frequency_hz] if recording.rate_hz < LEAST_RATE * frequency_hz else []
            continue
        onset_s = begin / recording.rate_hz + ringing.onset_s
        speed = _speed_of(recording, onset_s) if speeds is None else float(speeds[index])
        if isinstance(speed, str):
            warnings.append(f"{place} {speed}, and is left out")
            wayless += 1
            continue
        tap = _hit(recording, ringing, begin, onset_s, speed)
        alone = not fault and ringing.variance_accounted_for >= EXPLAINED
        found.append((dataclasses.replace(tap, pair=pair, alone=alone), ringing))
    if len(too_fast) > len(found):
        raise FitError(
            f"{recording.name}: sampled at {recording.rate_hz:g} Hz, which is less than {LEAST_RATE:g} times the "
            f"{np.median(too_fast):.0f} Hz that ring: record faster"
        )
    if wayless >= LEAST_TAPS and wayless > len(found):
        raise FitError(
            f"{recording.name}: {wayless} of {wayless + len(found)} taps have no even way before them to tell their "
            "speed: is the position the right column?"
        )
    if not found and clipped.any():
        raise FitError(
            f"{recording.name}: clipped at {np.abs(acceleration[clipped]).max():.4g} m/s^2: use a wider range"
        )
    return found


def _check_force(name: str, force: Floats) -> None:
    if not np.ptp(force) > 0:
        raise FitError(f"{name}: the force is {force[0]:g} N throughout: was the sensor connected?")
    if not force.max() > 0:
        raise FitError(f"{name}: the force is never positive: pressing must be (scale -1?)")


def _base(acceleration: Floats, rate_hz: float) -> Floats:
    """Gravity and drift: medians over blocks, and straight lines between them."""
    length = _samples(BASE_S, rate_hz, 32)
    count = max(1, len(acceleration) // length)
    blocks = np.array_split(acceleration, count)
    middles = np.cumsum([0] + [len(block) for block in blocks[:-1]]) + np.array([len(block) for block in blocks]) / 2
    return np.asarray(np.interp(np.arange(len(acceleration)), middles, [np.median(block) for block in blocks]))


def _events(recording: Recording, above: Floats) -> list[tuple[int, int]]:
    """First and last loud sample of every tap. Raises FitError where nothing stands out."""
    length = _samples(BLOCK_S, recording.rate_hz, 16)
    blocks = above[: len(above) // length * length].reshape(-1, length)
    noise = float(np.percentile(blocks.std(axis=1), CALM)) if len(blocks) else 0.0
    noise /= 1 - CALMER / math.sqrt(2 * length)
    highest = float(np.abs(above).max())
    if not highest > OUTSTANDING * noise:
        times = "nothing" if highest == 0 else f"{highest / noise:.1f} times its noise"
        raise FitError(
            f"{recording.name}: no onset: its largest acceleration is {times}, a tap has {OUTSTANDING:g} times at least"
        )
    # A bound of the normal distribution's tail.
    loud_noise = math.sqrt(2 * math.log(len(above) / LOUD_CHANCE))
    loud = np.flatnonzero(np.abs(above) > max(loud_noise * noise, LOUD_PART * highest))
    gaps = np.flatnonzero(np.diff(loud) > QUIET_S * recording.rate_hz)
    firsts = np.concatenate(([loud[0]], loud[gaps + 1]))
    lasts = np.concatenate((loud[gaps], [loud[-1]]))
    return [(int(first), int(last)) for first, last in zip(firsts, lasts, strict=True)]


def _given_speeds(recording: Recording, events: list[tuple[int, int]], above: Floats) -> Floats | None:
    """One a tap; None where they are to be taken from the position, or one holds for all."""
    speed = recording.speed_m_per_s
    if isinstance(speed, np.ndarray) and len(speed) == len(above):
        back = _samples(0.5 * APPROACH_S, recording.rate_hz, 4)
        return np.array([np.median(np.abs(speed[max(0, first - back) : first + 1])) for first, _ in events])
    return np.abs(speed) if isinstance(speed, np.ndarray) else None


def _without_bounces(recording: Recording, events: list[tuple[int, int]], above: Floats) -> list[tuple[int, int]]:
    kept: list[tuple[int, int]] = []
    size_before, before = 0.0, 0
    for first, last in events:
        size = float(np.abs(above[first : last + 1]).max())
        soon = bool(kept) and first - kept[-1][0] < BOUNCE_S * recording.rate_hz
        if soon and size < 0.8 * size_before and not _comes_by_itself(recording, kept[-1][0], before, first):
            before = first
            continue
        kept.append((first, last))
        size_before, before = size, first
    return kept


def _comes_by_itself(recording: Recording, touched: int, before: int, first: int) -> bool:
    """Whether the position shows an approach of its own: from in front of the surface, which was `touched`, and at a
    speed that changes less than half as fast as that of a bounce, which since the event `before` has gone away at this
    speed and come back at it by a steady push."""
    if recording.speed_m_per_s is not None or recording.position_m is None:
        return False
    half = _samples(0.5 * APPROACH_S, recording.rate_hz, 4)
    if first - 2 * half <= before:
        return False
    way = recording.position_m[first - 2 * half : first]
    place = np.arange(half) / recording.rate_hz
    early, late = (float(np.polyfit(place, part, 1)[0]) for part in (way[:half], way[half:]))
    speed = 0.5 * (early + late)
    passed = half / recording.rate_hz
    ahead = (float(recording.position_m[touched]) - float(way.mean())) * math.copysign(1.0, speed)
    steady = abs(late - early) * (first - before) / recording.rate_hz < abs(speed) * passed
    return abs(speed) >= LEAST_SPEED_M_PER_S and ahead > 0.5 * abs(speed) * passed and steady


def _clipped(acceleration: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Samples at the end of the range that stand still there, where the way to them was steep."""
    found = np.zeros(len(acceleration), dtype=np.bool_)
    steps = np.abs(np.diff(acceleration))
    if not steps.any():
        return found
    quantum = float(steps[steps > 0].min())
    # Without noise, rest may be an end of the range, too.
    rest = np.median(acceleration)
    for extreme in {acceleration.max(), acceleration.min()} - {rest}:
        edges = np.flatnonzero(np.diff(np.concatenate(([False], acceleration == extreme, [False])).astype(np.int8)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            around = np.concatenate((steps[max(0, begin - 1) : begin], steps[end - 1 : end]))
            if end - begin >= CLIPPED and around.size and around.max() > 3 * quantum:
                found[begin:end] = True
    return found


def _fitted(recording: Recording, first: int, last: int, least: int, most: int) -> tuple[Ringing, int]:
    """A tap's ringing, and the first sample of the stretch; none of it is before `least` or from `most` on."""
    acceleration = recording.acceleration_m_per_s2
    assert acceleration is not None
    rate_hz = recording.rate_hz
    before = _samples(BEFORE_S, rate_hz, 16)
    lasted = max(last - first, before)
    begin, end = max(least, first - max(before, lasted // 2)), min(most, last + lasted)
    begin = max(0, min(begin, end - 24))
    try:
        ringing = fit_ringing(
            acceleration[begin:end], rate_hz, onset_s=(first - begin) / rate_hz, sensor=recording.sensor
        )
        # The stretch was by guess; now it is by the decay.
        onset = begin + ringing.onset_s * rate_hz
        decay = float(rate_hz / ringing.decay_rate_per_s[0])
        again = max(least, math.floor(onset - max(before, min(decay, 5 * before))))
        end = min(most, max(math.ceil(onset + LASTS * decay), math.ceil(onset) + 24))
        start = dataclasses.replace(ringing, onset_s=ringing.onset_s + (begin - again) / rate_hz)
        return fit_ringing(acceleration[again:end], rate_hz, start=start, sensor=recording.sensor), again
    except FitError as error:
        raise FitError(f"{recording.name}: the tap at {first / rate_hz:.4g} s: {error}") from None


def _speed_of(recording: Recording, onset_s: float) -> float | str:
    """The speed, or why the position does not tell it."""
    if recording.speed_m_per_s is not None:
        assert not isinstance(recording.speed_m_per_s, np.ndarray)
        return abs(recording.speed_m_per_s)
    if recording.position_m is None:
        raise FitError(f"{recording.name}: has neither speed nor position: say speed_m_per_s in the YAML beside it")
    if not np.ptp(recording.position_m) > 0:
        raise FitError(f"{recording.name}: the position never moves: is it the right column?")
    end = max(0, math.floor(onset_s * recording.rate_hz))
    begin = max(0, end - _samples(APPROACH_S, recording.rate_hz, 4))
    if end - begin < 4:
        return "is too near the begin to tell its speed"
    way = recording.position_m[begin:end]
    time_s = np.arange(len(way)) / recording.rate_hz
    line = np.polyfit(time_s, way - way[0], 1)
    left = way - way[0] - np.polyval(line, time_s)
    if float(left @ left) > UNEVEN * float(np.sum((way - way.mean()) ** 2)):
        return "has no even way before it to tell its speed"
    return abs(float(line[0]))


def _fault_of(recording: Recording, ringing: Ringing) -> str:
    """Why the modes are none that a tap could have; empty where they may be."""
    for angular, decay in zip(ringing.angular_frequency_rad_per_s, ringing.decay_rate_per_s, strict=True):
        frequency_hz = float(angular) / (2 * math.pi)
        if recording.rate_hz < LEAST_RATE * frequency_hz:
            return f"is left out: it rings at {frequency_hz:.0f} Hz, too fast for the sampling rate"
        if not _uncertainty(ringing) < UNCERTAIN:
            return "is too weak for its noise, and left out"
        if recording.rate_hz < GLITCH * decay:
            return f"is over within {GLITCH:g} samples, a glitch, and left out"
    return ""


def _pair_of(recording: Recording, ringing: Ringing, begin: int) -> Ringing | None:
    """Two modes of a tap that one explains too little of; None where they do not explain it, either."""
    if ringing.variance_accounted_for >= WELL_EXPLAINED:
        return None
    assert recording.acceleration_m_per_s2 is not None
    measured = recording.acceleration_m_per_s2[begin : begin + len(ringing.residual)]
    pair = pair_of(measured, recording.rate_hz, ringing, recording.sensor)
    if pair is None or pair.variance_accounted_for < EXPLAINED or _fault_of(recording, pair):
        return None
    return pair


def _hit(recording: Recording, ringing: Ringing, begin: int, onset_s: float, speed: float) -> TapHit:
    assert recording.acceleration_m_per_s2 is not None
    measured = recording.acceleration_m_per_s2[begin : begin + len(ringing.residual)]
    mode = Mode(float(ringing.decay_rate_per_s[0]), float(ringing.angular_frequency_rad_per_s[0]))
    coefficient = float(ringing.coefficients[0])
    return TapHit(
        recording=recording.name,
        onset_s=onset_s,
        speed_m_per_s=speed,
        coefficient_m_per_s2=coefficient,
        first_peak_m_per_s2=coefficient * mode.peak,
        decay_rate_per_s=mode.decay_rate_per_s,
        angular_frequency_rad_per_s=mode.angular_frequency_rad_per_s,
        variance_accounted_for=ringing.variance_accounted_for,
        # A rendered tap may have none, and yet is weighted by it.
        noise_m_per_s2=max(ringing.noise_m_per_s2, NO_NOISE * abs(coefficient)),
        begin_s=begin / recording.rate_hz,
        rate_hz=recording.rate_hz,
        measured=measured,
        modelled=measured - ringing.residual,
        sensor=recording.sensor,
    )


def _uncertainty(ringing: Ringing) -> float:
    """The largest of the relative standard errors of A, B and w of any mode."""
    values = np.concatenate((ringing.coefficients, ringing.decay_rate_per_s, ringing.angular_frequency_rad_per_s))
    variances = np.diag(ringing.covariance)[: len(values)]
    # Modes that cannot be told apart may have variances below 0, by rounding.
    if not values.all() or not (variances >= 0).all():
        return math.inf
    return float((np.sqrt(variances) / np.abs(values)).max())


def _samples(time_s: float, rate_hz: float, least: int) -> int:
    return max(least, round(time_s * rate_hz))


# ---- What they have in common ----------------------------------------------------------------------------------------


def _upright(hits: list[Hit], warnings: list[str]) -> list[Hit]:
    """With positive coefficients."""
    signs = [math.copysign(1.0, tap.coefficient_m_per_s2) for tap, _ in hits]
    usual = 1.0 if sum(signs) >= 0 else -1.0
    if usual < 0:
        warnings.append("the taps begin downwards: the acceleration is taken with its sign turned")
    found = []
    for sign, (tap, ringing) in zip(signs, hits, strict=True):
        if sign != usual:
            warnings.append(f"{tap.recording}: the tap at {tap.onset_s:.4g} s begins the other way, and is left out")
            continue
        found.append((tap if usual > 0 else tap.turned(), ringing))
    other = len(hits) - len(found)
    if len(found) < LEAST_TAPS or (other > 1 and other > OTHER_WAY * len(hits)):
        raise FitError(
            f"{other} of {len(hits)} taps begin the other way: a surface pushes one way; is there something else among "
            "them, or is the rate too low?"
        )
    return found


def _check_speeds(taps: Sequence[TapHit]) -> None:
    slowest, fastest = min(taps, key=lambda tap: tap.speed_m_per_s), max(taps, key=lambda tap: tap.speed_m_per_s)
    for tap, allowed, unit in (
        (fastest, fastest.speed_m_per_s <= MOST_SPEED_M_PER_S, "is it in mm/s, or are columns swapped?"),
        (slowest, slowest.speed_m_per_s >= LEAST_SPEED_M_PER_S, "is it in km/s, or the position in the wrong unit?"),
    ):
        if not allowed:
            raise FitError(
                f"{tap.recording}: the tap at {tap.onset_s:.4g} s has a speed of {tap.speed_m_per_s:.4g} m/s, taps "
                f"have {LEAST_SPEED_M_PER_S:g} to {MOST_SPEED_M_PER_S:g}: {unit}"
            )
    if fastest.speed_m_per_s < SPEED_RANGE * slowest.speed_m_per_s:
        raise FitError(
            f"all {len(taps)} taps have about one speed ({slowest.speed_m_per_s:.4g} to "
            f"{fastest.speed_m_per_s:.4g} m/s): a slope over speed needs slow ones and fast ones"
        )


def _check_slope(slope: Estimate, angular: float) -> None:
    if not slope.low > 0:
        raise FitError(
            f"the speed says nothing of the amplitude: the slope is {slope.value:.4g} 1/s, from {slope.low:.4g} to "
            f"{slope.high:.4g}: are these taps of one material, and is each speed that of its tap?"
        )
    ratio = slope.value / angular
    if not SOFTEST <= ratio <= HARDEST:
        raise FitError(
            f"the amplitude over speed is {slope.value:.4g} 1/s, {ratio:.2g} times the angular frequency; a touch has "
            f"{SOFTEST:g} to {HARDEST:g}: is the acceleration or the speed off by a thousand (mm, g)?"
        )


def _check_ringing(frequency_hz: float, decay_time_s: float, taps: Sequence[TapHit]) -> None:
    if frequency_hz < LEAST_HZ:
        raise FitError(
            f"what follows the onsets is of {frequency_hz:.3g} Hz, slower than {LEAST_HZ:g} Hz: a hand's motion, no tap"
        )
    longest_s = max(len(tap.measured) / tap.rate_hz for tap in taps)
    # A stretch is of LASTS decay times, where there is room.
    if decay_time_s > 0.5 * longest_s:
        raise FitError(
            f"what follows the onsets does not decay: by {decay_time_s:.3g} s to 1/e, and {longest_s:.3g} s were seen"
        )
