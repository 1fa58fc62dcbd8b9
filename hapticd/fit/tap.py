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
from typing import Final, TypeAlias

import numpy as np

from hapticd.fit.impossible import ACCELERATION, without_impossible
from hapticd.fit.recording import Recording, Source
from hapticd.fit.regression import (
    Estimate,
    FitError,
    Floats,
    Regression,
    common,
    improbable,
    least_squares,
    require_scipy,
    student_t,
    through_origin,
    with_offset,
)
from hapticd.fit.ringing import Ringing, fit_ringing
from hapticd.fit.sensor import Sensor
from hapticd.fit.strokes import LEAST_RATE, force_of, gravity_of
from hapticd.fit.verdict import Doubts, Verdict
from hapticd.mode import Attack, Mode
from hapticd.yaml_source import Json

LEAST_TAPS: Final = 3
LEAST_M_PER_S2: Final = 1e-3
"""An acceleration whose largest is less is none."""
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
ALIKE_NOISE: Final = 1.5
NO_NOISE: Final = 1e-9
"""Of the coefficient: the least noise a tap is taken to have."""
OTHER_WAY: Final = 0.25
"""Of the taps may begin the other way, and are left out."""
UNCERTAIN: Final = 0.5
"""A tap whose amplitude, decay or frequency is known less than this, one standard error, is not used."""
FEW_SAMPLES: Final = 8.0
"""Samples per period, below which it is said that they are few."""
SOFTEST: Final = 0.003
HARDEST: Final = 10.0
"""Slope over w: 1 where a mass at this speed rings elastically; the paper's seven are 0.07 to 0.87."""
EXPLAINED: Final = 0.5
MANY: Final = 5
"""Where so many are not used, and fewer are, the recording is none of taps."""
WELL_EXPLAINED: Final = 0.95
"""Of a tap's variance by one mode: below the first it is not used, below the second in the middle it is told."""
COLOURED: Final = 1.3
"""A residual so many times the noise before the onset has more in it than noise."""
WELL_LINEAR: Final = 0.9
"""r^2 of A(v)."""
SECOND_GAIN: Final = 0.01
"""A second mode explains so much of the variance besides, at least."""
SECOND_TAPS: Final = 12
"""It is sought in so many taps, the loudest."""
ALIKE: Final = 0.1
"""And its frequency is the same in them within so much."""
CHANCE: Final = 0.01
BENT: Final = 0.05
"""A(v) is told to be no line through the origin where that is less likely by chance, and matters more than this."""
SCATTERED: Final = 0.05
"""Frequencies that scatter more are told."""
TOLD: Final = 3
"""So many reasons are in a refusal."""
TABLE: Final = 8
"""Speeds of a table of amplitudes, at most."""
APART: Final = 0.02
"""And they are apart by so much."""
ASTRAY: Final = 0.25
"""A tap this far off the line of the others is told."""
MOVED_FREQUENCY: Final = 0.02
MOVED_DECAY: Final = 0.1
"""From the slowest to the fastest tap; what is less is not told."""
MISSHAPEN: Final = 0.02
"""RMS over that of the ringing, from which on a shape of what is left over is told."""
PULSE: Final = 0.3
"""A second mode that falls to 1/e within this part of its own period is none."""
MOST_RATIO: Final = 10.0
"""Of a second mode, as materials have it."""

Amplitudes: TypeAlias = tuple[tuple[float, Estimate], ...]
"""Speeds in m/s, rising, and m/s^2."""


@dataclass(frozen=True, slots=True)
class TapHit:
    """One tap: what was fitted, and the stretch of the recording that it was fitted to."""

    recording: str
    onset_s: float
    speed_m_per_s: float
    coefficient_m_per_s2: float
    first_peak_m_per_s2: float
    decay_rate_per_s: float
    angular_frequency_rad_per_s: float
    variance_accounted_for: float
    noise_m_per_s2: float
    begin_s: float
    """Of the stretch, on the recording's clock."""
    rate_hz: float
    measured: Floats
    modelled: Floats
    sensor: Sensor | None = None

    def to_dict(self) -> dict[str, Json]:
        return {
            "recording": self.recording,
            "onset_s": self.onset_s,
            "speed_m_per_s": self.speed_m_per_s,
            "coefficient_m_per_s2": self.coefficient_m_per_s2,
            "first_peak_m_per_s2": self.first_peak_m_per_s2,
            "frequency_hz": self.angular_frequency_rad_per_s / (2 * math.pi),
            "decay_time_s": 1 / self.decay_rate_per_s,
            "variance_accounted_for": self.variance_accounted_for,
        }


@dataclass(frozen=True, slots=True)
class SecondMode:
    """A mode that is struck together with the first, and the first as it is beside it."""

    frequency_hz: Estimate
    decay_time_s: Estimate
    ratio: Estimate
    """Its coefficient over the first one's."""
    first_slope_per_s: Estimate
    """Of the first one's coefficient over the speed."""
    first_frequency_hz: Estimate
    first_decay_time_s: Estimate
    amplitudes: Amplitudes
    """Of the first, as TapFit's."""
    variance_accounted_for: float
    """By both, median over the taps."""

    def to_dict(self) -> dict[str, Json]:
        return {
            "frequency_hz": _json(self.frequency_hz),
            "decay_time_s": _json(self.decay_time_s),
            "ratio": _json(self.ratio),
            "first_slope_per_s": _json(self.first_slope_per_s),
            "first_frequency_hz": _json(self.first_frequency_hz),
            "first_decay_time_s": _json(self.first_decay_time_s),
            "amplitudes": _json_table(self.amplitudes),
            "variance_accounted_for": self.variance_accounted_for,
        }


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
    r_squared: float
    """Of A(v) through the origin."""
    offset_slope_per_s: Estimate
    offset_m_per_s2: Estimate
    r_squared_offset: float
    """Of A(v) with an offset."""
    variance_accounted_for: float
    """By the mode, median over the taps."""
    linear: bool
    """Whether a line through the origin does for A(v)."""
    amplitudes: Amplitudes
    """The coefficient over the speed, as `amplitudes` of a material has it: straight lines from rest to the first speed
    and from one to the next."""
    second: SecondMode | None
    """Offered where one mode is not enough."""
    sources: tuple[Source, ...]
    warnings: tuple[str, ...]
    judged: Verdict

    @property
    def verdict(self) -> str:
        return str(self.judged)

    def material(self, attack: Attack = "coefficient", table: bool = False, two_modes: bool = False) -> dict[str, Json]:
        """Keys of a YAML material; with `table`, amplitudes over speed instead of a slope; with `two_modes`, both of
        them. Raises FitError where no second mode was found, and for a first peak where A alone is known."""
        if attack != "coefficient" and (table or two_modes):
            raise FitError("a table, and two modes, are of coefficients: leave out the first peak")
        second = self.second if two_modes else None
        if two_modes and second is None:
            raise FitError("no second mode was found: one is enough, or the taps differ")
        tap: dict[str, Json] = {}
        if table:
            amplitudes = self.amplitudes if second is None else second.amplitudes
            tap["amplitudes"] = [[speed, amplitude.value] for speed, amplitude in amplitudes]
        elif second is not None:
            tap["attack_slope_per_s"] = second.first_slope_per_s.value
        elif attack == "coefficient":
            tap["attack_slope_per_s"] = self.slope_per_s.value
        else:
            tap["attack_slope_per_s"] = self.first_peak_slope_per_s.value
            tap["attack"] = "first_peak"
        if second is None:
            tap["frequency_hz"] = self.frequency_hz.value
            tap["decay_time_s"] = self.decay_time_s.value
            return {"tap": tap}
        tap["frequency_hz"] = second.first_frequency_hz.value
        tap["decay_time_s"] = second.first_decay_time_s.value
        tap["second"] = {
            "frequency_hz": second.frequency_hz.value,
            "decay_time_s": second.decay_time_s.value,
            "ratio": second.ratio.value,
        }
        return {"tap": tap}

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
            told[name] = _json(getattr(self, name))
        told |= {
            "r_squared": self.r_squared,
            "r_squared_offset": self.r_squared_offset,
            "variance_accounted_for": self.variance_accounted_for,
            "linear": self.linear,
            "amplitudes": _json_table(self.amplitudes),
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
    hits: list[tuple[TapHit, Ringing]] = []
    _check_files(recordings)
    for recording in recordings:
        hits += _hits_of(recording, warnings)
        if progress is not None:
            progress(recording)
    if len(hits) < LEAST_TAPS:
        more = f"; and {len(warnings) - TOLD} more" if len(warnings) > TOLD else ""
        told = f" ({'; '.join(warnings[:TOLD])}{more})" if warnings else ""
        raise FitError(f"{len(hits)} taps are too few: needs {LEAST_TAPS}, better ten, at different speeds{told}")
    hits = _upright(hits, warnings)
    taps = tuple(tap for tap, _ in hits)
    _check_speeds(taps)

    noise = _noise(taps)
    decays = np.log([tap.decay_rate_per_s for tap in taps])
    angulars = np.log([tap.angular_frequency_rad_per_s for tap in taps])
    speeds = np.array([tap.speed_m_per_s for tap in taps])
    amplitudes = np.array([tap.coefficient_m_per_s2 for tap in taps])
    peaks = np.array([tap.first_peak_m_per_s2 for tap in taps])
    # By the peak, whose error has little to do with those of decay and frequency.
    relative = noise / peaks**2

    spreads = np.array([np.diag(ringing.covariance)[:3] for _, ringing in hits])
    of_coefficient = _levelled(spreads[:, 0], noise)
    of_decay = _levelled(spreads[:, 1] / np.exp(2 * decays), relative)
    of_angular = _levelled(spreads[:, 2] / np.exp(2 * angulars), relative)
    of_peak = _levelled(np.array([_peak_variance(ringing) for _, ringing in hits]), noise)

    decay = common(decays, of_decay)
    angular = common(angulars, of_angular)
    # Taps differ by parts of their amplitudes.
    line = through_origin(speeds, amplitudes, of_coefficient, speeds**2)
    peak_line = through_origin(speeds, peaks, of_peak, speeds**2)
    shifted = with_offset(speeds, amplitudes, of_coefficient, speeds**2)
    slope = line.coefficients[0]
    if not slope.low > 0:
        raise FitError(
            f"the speed says nothing of the amplitude: the slope is {slope.value:.4g} 1/s, from {slope.low:.4g} to "
            f"{slope.high:.4g}: are these taps of one material, and is each speed that of its tap?"
        )
    _check_size(slope.value, math.exp(angular.value))

    frequency = angular.mapped(lambda log: math.exp(log) / (2 * math.pi))
    explained = float(np.median([tap.variance_accounted_for for tap in taps]))
    _check_ringing(frequency.value, math.exp(-decay.value), taps)
    slowest = min(recording.rate_hz for recording in recordings)
    if slowest < FEW_SAMPLES * frequency.value:
        warnings.append(
            f"{slowest:g} Hz are {slowest / frequency.value:.1f} samples a period at {frequency.value:.0f} Hz; the "
            "amplitude is less certain than with more, and a filter of the sensor may have lowered it"
        )

    doubts = Doubts()
    second = _second_mode(hits, explained)
    bends = _bends(speeds, amplitudes, noise)
    astray = _astray(taps, speeds, amplitudes, noise)
    scatter = float(np.std(angulars))
    if second is not None:
        together = 100 * second.variance_accounted_for
        warnings.append(
            f"one mode is not enough: a second at {second.frequency_hz.value:.4g} Hz, "
            f"{1e3 * second.decay_time_s.value:.3g} ms and {second.ratio.value:.2g} times as strong explains "
            f"{together:.1f} % together with the first, which alone explains {100 * explained:.1f} %"
        )
        doubts.add(second.variance_accounted_for < WELL_EXPLAINED, f"two explain {together:.1f} %", "")
    elif explained < WELL_EXPLAINED:
        doubts.add(True, "the rest is of another kind", "")
    else:
        doubts.add(False, *_misfit(hits, taps))
    if scatter > SCATTERED:
        doubts.add(
            scatter > 2 * SCATTERED,
            f"the frequency scatters by {100 * scatter:.0f} % between taps",
            "is it one material, held alike?",
        )
    doubts.add(False, _moves(speeds, angulars, of_angular, "frequency", MOVED_FREQUENCY), "the material has the mean")
    doubts.add(False, _moves(speeds, -decays, of_decay, "decay time", MOVED_DECAY), "the material has the mean")
    if astray:
        doubts.add(False, astray, "is its speed right?")
    else:
        doubts.add(False, bends, "a table of amplitudes over speed is offered")
    if (shifted.correlation if bends else line.r_squared) < WELL_LINEAR and not astray:
        doubts.add(True, f"the speed says little of the amplitude (r^2 {line.r_squared:.2f})", "")
    warnings += doubts.told
    return TapFit(
        taps=taps,
        slope_per_s=slope,
        first_peak_slope_per_s=peak_line.coefficients[0],
        frequency_hz=frequency,
        decay_time_s=decay.mapped(lambda log: math.exp(-log)),
        r_squared=line.r_squared,
        offset_slope_per_s=shifted.coefficients[0],
        offset_m_per_s2=shifted.coefficients[1],
        r_squared_offset=shifted.r_squared,
        variance_accounted_for=explained,
        linear=not bends,
        amplitudes=_table(speeds, amplitudes, of_coefficient),
        second=second,
        sources=tuple(recording.source for recording in recordings),
        warnings=tuple(warnings),
        judged=doubts.judged(
            f"one mode explains {100 * explained:.1f} % of {len(taps)} taps",
            f"A(v) is a line through the origin (r^2 {line.r_squared:.3f})",
        ),
    )


def _check_files(recordings: Sequence[Recording]) -> None:
    seen: dict[str, str] = {}
    for recording in recordings:
        sha256 = recording.source.sha256
        if sha256 and sha256 in seen:
            raise FitError(f"{recording.name}: is the same as {seen[sha256]}: a tap counts once")
        seen[sha256] = recording.name


# ---- Taps in a recording ---------------------------------------------------------------------------------------------


def _hits_of(recording: Recording, warnings: list[str]) -> list[tuple[TapHit, Ringing]]:
    whole = without_impossible(recording, "tap")
    recording = whole.recording
    warnings += whole.told
    acceleration = recording.acceleration_m_per_s2
    if acceleration is None:
        raise FitError(f"{recording.name}: has no acceleration, which taps are fitted to")
    largest = float(np.abs(acceleration).max())
    if 0 < largest < LEAST_M_PER_S2:
        raise FitError(
            f"{recording.name}: an acceleration of {largest:.3g} m/s^2 is none of a stylus ({LEAST_M_PER_S2:g} to "
            f"{ACCELERATION['tap'].most:g}): is it in another unit, or another column?"
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
    found: list[tuple[TapHit, Ringing]] = []
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
        if whole.replaced[begin : begin + len(ringing.residual)].any():
            warnings.append(f"{place} has samples that cannot be, and is left out")
            continue
        if ringing.variance_accounted_for < EXPLAINED:
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
        if recording.rate_hz < LEAST_RATE * frequency_hz:
            warnings.append(f"{place} is left out: it rings at {frequency_hz:.0f} Hz, too fast for the sampling rate")
            too_fast.append(frequency_hz)
            continue
        if not _uncertainty(ringing) < UNCERTAIN:
            warnings.append(f"{place} is too weak for its noise, and left out")
            continue
        if recording.rate_hz < GLITCH * ringing.decay_rate_per_s[0]:
            warnings.append(f"{place} is over within {GLITCH:g} samples, a glitch, and left out")
            continue
        onset_s = begin / recording.rate_hz + ringing.onset_s
        speed = _speed_of(recording, onset_s) if speeds is None else float(speeds[index])
        if isinstance(speed, str):
            warnings.append(f"{place} {speed}, and is left out")
            wayless += 1
            continue
        found.append((_hit(recording, ringing, begin, onset_s, speed), ringing))
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
    """The largest of the relative standard errors of A, B and w of one mode."""
    values = np.concatenate((ringing.coefficients, ringing.decay_rate_per_s, ringing.angular_frequency_rad_per_s))
    if not values.all():
        return math.inf
    return float((np.sqrt(np.diag(ringing.covariance)[:3]) / np.abs(values)).max())


def _samples(time_s: float, rate_hz: float, least: int) -> int:
    return max(least, round(time_s * rate_hz))


# ---- What they have in common ----------------------------------------------------------------------------------------


def _upright(hits: list[tuple[TapHit, Ringing]], warnings: list[str]) -> list[tuple[TapHit, Ringing]]:
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
        tap = dataclasses.replace(
            tap,
            coefficient_m_per_s2=usual * tap.coefficient_m_per_s2,
            first_peak_m_per_s2=usual * tap.first_peak_m_per_s2,
            measured=usual * tap.measured,
            modelled=usual * tap.modelled,
        )
        found.append((tap, ringing))
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


def _check_size(slope: float, angular: float) -> None:
    ratio = slope / angular
    if not SOFTEST <= ratio <= HARDEST:
        raise FitError(
            f"the amplitude over speed is {slope:.4g} 1/s, {ratio:.2g} times the angular frequency; a touch has "
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


def _peak_variance(ringing: Ringing) -> float:
    """Of A p(B, w), to first order."""
    values = np.array(
        [ringing.coefficients[0], ringing.decay_rate_per_s[0], ringing.angular_frequency_rad_per_s[0]], dtype=np.float64
    )

    def peak(at: Floats) -> float:
        return float(at[0]) * Mode(float(at[1]), float(at[2])).peak

    slopes = np.empty(3)
    for which in range(3):
        step = np.zeros(3)
        step[which] = 1e-5 * values[which]
        slopes[which] = (peak(values + step) - peak(values - step)) / (2 * step[which])
    return float(slopes @ ringing.covariance[:3, :3] @ slopes)


def _noise(taps: Sequence[TapHit]) -> Floats:
    """(n,) variances of the noise; what differs no more than short stretches do by chance is taken as alike."""
    found = np.array([tap.noise_m_per_s2 for tap in taps])
    usual = float(np.median(found))
    return np.where((found < ALIKE_NOISE * usual) & (usual < ALIKE_NOISE * found), usual, found) ** 2


def _bends(speeds: Floats, amplitudes: Floats, noise: Floats) -> str:
    """What keeps A(v) from being a line through the origin; empty where nothing does."""
    if len(speeds) < LEAST_TAPS + 2:
        return ""
    ones = np.ones_like(speeds)
    size = float(np.mean(amplitudes))
    weights = noise / np.mean(noise)
    scale = 1 / np.sqrt(weights)

    def laid(*columns: Floats) -> tuple[Regression, Floats]:
        found = least_squares(np.column_stack(columns) * scale[:, None], amplitudes * scale)
        return found, amplitudes - found.residual / scale

    origin, straight = laid(speeds)
    offset, shifted = laid(speeds, ones)
    curve, curved = laid(speeds, speeds**2, ones)
    bend = float(np.sqrt(np.mean((curved - shifted) ** 2))) / size
    if bend > BENT and improbable(offset.squares, offset.freedom, curve.squares, curve.freedom) < CHANCE:
        return f"A(v) is not linear: a curve is {100 * bend:.0f} % off the line"
    off = float(np.sqrt(np.mean((shifted - straight) ** 2))) / size
    if off > BENT and improbable(origin.squares, origin.freedom, offset.squares, offset.freedom) < CHANCE:
        value = offset.coefficients[1].value
        return f"A(v) does not go through the origin: it has {value:.3g} m/s^2 at rest"
    return ""


def _astray(taps: Sequence[TapHit], speeds: Floats, amplitudes: Floats, noise: Floats) -> str:
    """The one tap without which A(v) is a line through the origin; empty where there is none."""
    if len(speeds) < LEAST_TAPS + 3:
        return ""
    found: tuple[float, int, float] | None = None
    scale = np.sqrt(np.mean(noise) / noise)
    for index in range(len(speeds)):
        others = np.delete(np.arange(len(speeds)), index)
        line = through_origin((speeds * scale)[others], (amplitudes * scale)[others])
        expected = line.coefficients[0].value * speeds[index]
        own = float(((amplitudes[index] - expected) * scale[index]) ** 2)
        # The line of the others is uncertain there, too.
        own /= 1 + float((speeds * scale)[index] ** 2 / np.sum((speeds * scale)[others] ** 2))
        # The deleted residual against those of the others: n ways to be the farthest by chance.
        chance = len(speeds) * improbable(line.squares + own, line.freedom + 1, line.squares, line.freedom)
        if found is None or chance < found[0]:
            found = (chance, index, amplitudes[index] / expected - 1)
    assert found is not None
    chance, index, off = found
    others = np.delete(np.arange(len(speeds)), index)
    if chance > CHANCE or abs(off) < ASTRAY or _bends(speeds[others], amplitudes[others], noise[others]):
        return ""
    side = "above" if off > 0 else "below"
    return (
        f"the tap at {taps[index].onset_s:.4g} s of {taps[index].recording} is {100 * abs(off):.0f} % {side} the line "
        "of the others"
    )


def _moves(speeds: Floats, logs: Floats, variances: Floats, what: str, least: float) -> str:
    """Whether a figure changes with the speed; empty where it does not."""
    if len(speeds) < LEAST_TAPS + 2:
        return ""
    slope = with_offset(speeds, logs, variances).coefficients[0]
    freedom = len(speeds) - 2
    if not slope.value:
        return ""
    # With the chance of CHANCE: as many standard errors as t has there.
    wide = (slope.high - slope.value) * student_t(freedom, 1 - CHANCE) / student_t(freedom)
    change = math.expm1(slope.value * float(np.ptp(speeds)))
    if abs(slope.value) < wide or abs(change) < least:
        return ""
    return (
        f"the {what} {'rises' if change > 0 else 'falls'} by {100 * abs(change):.0f} % from the slowest to the fastest"
    )


def _misfit(hits: Sequence[tuple[TapHit, Ringing]], taps: Sequence[TapHit]) -> tuple[str, str]:
    """Whether what is left over has a shape that all taps have, and is no noise: the score test of the shapes that
    ringing.py tries beside the mode. Empty where it has none."""
    more = "the figures may be farther off than their intervals say"
    colour = float(np.median([_colour(tap, ringing) for tap, ringing in hits]))
    size = len(hits[0][1].misfit[0])
    score, squares, heard, samples = np.zeros(size), np.zeros((size, size)), 0.0, 0
    for tap, (_, ringing) in zip(taps, hits, strict=True):
        score += ringing.misfit[0] / tap.noise_m_per_s2**2
        squares += ringing.misfit[1] / tap.noise_m_per_s2**2
        modelled = tap.modelled - np.median(tap.modelled)
        heard += float(modelled @ modelled) / tap.noise_m_per_s2**2
        samples += len(tap.measured) - 6
    taken = float(score @ np.linalg.lstsq(squares, score, rcond=1e-9)[0])
    share = math.sqrt(max(0.0, taken) / heard) if heard > 0 else 0.0
    chance = improbable(float(samples), samples, max(0.0, samples - taken), samples - size)
    if share > MISSHAPEN and (chance < CHANCE or colour > COLOURED):
        return f"what is left over has a shape, {100 * share:.0f} % of the ringing", more
    left = math.sqrt(
        sum(float(ringing.residual @ ringing.residual) / tap.noise_m_per_s2**2 for tap, ringing in hits) / heard
    )
    if colour > COLOURED and left > MISSHAPEN:
        return f"what is left over is {colour:.1f} times the noise before the taps", more
    return "", ""


def _levelled(own: Floats, scale: Floats) -> Floats:
    """The variances' common factor: of what a tap of its noise would have. Their own luck does not enter."""
    return np.asarray(scale * np.median(own / scale), dtype=np.float64)


def _table(speeds: Floats, amplitudes: Floats, variances: Floats) -> Amplitudes:
    """The straight lines between so many of the speeds that are nearest to the amplitudes, none below 0."""
    order = np.sort(speeds)
    count = min(TABLE, max(2, len(speeds) - 2))
    knots: list[float] = []
    for place in np.linspace(0, len(speeds) - 1, count).round().astype(int):
        if not knots or order[place] > (1 + APART) * knots[-1]:
            knots.append(float(order[place]))
    nodes = np.array([0.0, *knots])
    hats = np.column_stack([np.interp(speeds, nodes, row) for row in np.eye(len(nodes))[1:]])
    # What would be negative is 0, and the others are fitted without it.
    kept = np.ones(len(knots), dtype=np.bool_)
    while True:
        line = least_squares(hats[:, kept], amplitudes, variances, speeds**2)
        below = [value.value < 0 for value in line.coefficients]
        if not any(below):
            break
        kept[np.flatnonzero(kept)[below]] = False
    found = iter(line.coefficients)
    table = [(knot, next(found) if keep else Estimate(0.0, 0.0, 0.0)) for knot, keep in zip(knots, kept, strict=True)]
    return tuple((knot, Estimate(value.value, max(0.0, value.low), value.high)) for knot, value in table)


def _second_mode(hits: list[tuple[TapHit, Ringing]], explained: float) -> SecondMode | None:
    """A mode that most of the loudest taps have besides, at one frequency."""
    loudest = sorted(hits, key=lambda hit: hit[0].noise_m_per_s2 / hit[0].coefficient_m_per_s2)[:SECOND_TAPS]
    coloured = [(tap, ringing) for tap, ringing in loudest if _colour(tap, ringing) > COLOURED]
    enough = max(LEAST_TAPS, len(loudest) / 2)
    if len(coloured) < enough:
        return None
    both: list[tuple[TapHit, Ringing]] = []
    for tap, ringing in coloured:
        pair = fit_ringing(tap.measured, tap.rate_hz, modes=2, onset_s=ringing.onset_s, sensor=tap.sensor)
        freedom = len(ringing.residual) - 6
        one, two = float(ringing.residual @ ringing.residual), float(pair.residual @ pair.residual)
        turns = float(pair.angular_frequency_rad_per_s.min()) * len(ringing.residual) / tap.rate_hz
        if improbable(one, freedom, two, freedom - 3) < CHANCE and turns > math.pi:
            both.append((tap, pair))
    if len(both) < enough:
        return None
    logs = np.log([pair.angular_frequency_rad_per_s for _, pair in both])
    alike = np.all(np.abs(logs - np.median(logs, axis=0)) < ALIKE, axis=1)
    together = float(np.median([pair.variance_accounted_for for _, pair in both]))
    if np.mean(alike) < 0.7 or np.sum(alike) < LEAST_TAPS or together < explained + SECOND_GAIN:
        return None
    return _pair_of([one for one, same in zip(both, alike, strict=True) if same], together)


def _pair_of(both: list[tuple[TapHit, Ringing]], together: float) -> SecondMode | None:
    """What they have in common; None where that is no pair, but one mode of another shape."""
    speeds = np.array([tap.speed_m_per_s for tap, _ in both])
    noise = _noise([tap for tap, _ in both])
    relative = noise / np.array([tap.first_peak_m_per_s2 for tap, _ in both]) ** 2
    coefficients = np.array([pair.coefficients for _, pair in both])
    decays = np.array([pair.decay_rate_per_s for _, pair in both])
    angulars = np.array([pair.angular_frequency_rad_per_s for _, pair in both])
    covariances = np.array([pair.covariance for _, pair in both])
    own = np.array([np.diag(covariance) for covariance in covariances])
    ratios = coefficients[:, 1] / coefficients[:, 0]
    of_ratio = ratios**2 * (
        own[:, 0] / coefficients[:, 0] ** 2
        + own[:, 1] / coefficients[:, 1] ** 2
        - 2 * covariances[:, 0, 1] / (coefficients[:, 0] * coefficients[:, 1])
    )

    def shared(values: Floats, variances: Floats) -> Estimate:
        return common(np.log(values), _levelled(variances / values**2, relative))

    of_first = _levelled(own[:, 0], noise)
    slope = through_origin(speeds, coefficients[:, 0], of_first, speeds**2).coefficients[0]
    ratio = common(ratios, _levelled(of_ratio, relative))
    decay = [shared(decays[:, mode], own[:, 2 + mode]) for mode in range(2)]
    angular = [shared(angulars[:, mode], own[:, 4 + mode]) for mode in range(2)]
    same = abs(angular[1].value - angular[0].value) < ALIKE
    # In periods of its own; what is over sooner is a pulse.
    lasts = math.exp(angular[1].value - decay[1].value) / (2 * math.pi)
    if slope.value <= 0 or abs(ratio.value) > MOST_RATIO or same or lasts < PULSE:
        return None
    return SecondMode(
        frequency_hz=angular[1].mapped(lambda log: math.exp(log) / (2 * math.pi)),
        decay_time_s=decay[1].mapped(lambda log: math.exp(-log)),
        ratio=ratio,
        first_slope_per_s=slope,
        first_frequency_hz=angular[0].mapped(lambda log: math.exp(log) / (2 * math.pi)),
        first_decay_time_s=decay[0].mapped(lambda log: math.exp(-log)),
        amplitudes=_table(speeds, coefficients[:, 0], of_first),
        variance_accounted_for=together,
    )


def _colour(tap: TapHit, ringing: Ringing) -> float:
    """What is left over while it rings, over what was there before."""
    onset = max(2, math.floor(ringing.onset_s * tap.rate_hz))
    end = math.ceil((ringing.onset_s + 5 / tap.decay_rate_per_s) * tap.rate_hz)
    before = float(np.std(ringing.residual[:onset]))
    return float(np.std(ringing.residual[onset:end])) / before if before > 0 else math.inf


def _json(estimate: Estimate) -> Json:
    return {"value": estimate.value, "low": estimate.low, "high": estimate.high}


def _json_table(amplitudes: Amplitudes) -> Json:
    return [{"speed_m_per_s": speed, "coefficient_m_per_s2": _json(amplitude)} for speed, amplitude in amplitudes]
