"""Taps that are pulses: the waveform that they have in common, scaled over the approach speed.

The shape and each tap's amplitude and onset are found together (pulse_shape.py). What the shape explains is judged on
each tap by a shape that was found without that tap. The amplitude, the tap's largest acceleration, is then laid over
the speed as of a ringing tap.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats, jackknife_error, student_t, through_origin
from hapticd.base.yaml_source import Json
from hapticd.config.waveform import LONGEST_S, MOST_SAMPLES, Curve
from hapticd.fit.exclusions import Exclusion, Exclusions, mostly_excluded
from hapticd.fit.plain_data import end_of, fields_of
from hapticd.fit.recording import Source
from hapticd.fit.taps.amplitude import doubt_the_law, law_of
from hapticd.fit.taps.hit import check_speeds
from hapticd.fit.taps.law import Amplitudes, check_slope
from hapticd.fit.taps.pulse_shape import (
    LARGE,
    Equations,
    Placed,
    Pulse,
    common_shape,
    crossing_s,
    explained,
    place,
    rest_of,
    upright,
)
from hapticd.fit.verdict import Doubts, Verdict

LEAST_PULSES: Final = 3
CROSSES: Final = 0.25
"""Pulses begin to be laid over each other where they cross this part of their peak."""
FAINT: Final = 5e-4
"""What of the shape lies before its beginning, and what after its end, has at most this part of its energy."""
CLEAR: Final = 3.0
"""The shape begins at the last sample before its rise that is within so many standard errors of the rest, and ends
where no more stands out of twice the standard errors than FAINT."""
QUIET: Final = 3
"""Samples of rest that tell how the shape scatters there."""
FINER: Final = 4 / 3
"""How far samples are off, over what twice as many change: for errors that fall with the square of their distance."""
GROUPS: Final = 16
"""Of more taps, groups are left out in turn instead of single ones."""
LEAST_SAMPLES: Final = 8
COARSER: Final = 1e-4
"""The rate of the samples is halved as long as the shape explains no more than this less."""
ALIKE: Final = 0.5
"""A tap of which the shape of the others explains less is left out."""
UNFINISHED: Final = 0.05
"""Of the peak: a shape that is larger where it has to end is faded out."""
AFTER: Final = 1.3
"""A pulse is evaluated for so many times its length."""
FADED: Final = 0.2
"""Over this part of its length."""


@dataclass(frozen=True, slots=True)
class PulseHit:
    """One tap by the waveform."""

    recording: str
    onset_s: float
    """On the recording's clock."""
    speed_m_per_s: float
    peak_m_per_s2: float
    """Its largest acceleration, by the waveform."""
    variance_accounted_for: float
    """By a waveform that was found without this tap."""
    rate_hz: float
    measured: Floats
    modelled: Floats

    def to_dict(self) -> dict[str, Json]:
        return fields_of(self, "recording", "onset_s", "speed_m_per_s", "peak_m_per_s2", "variance_accounted_for")


@dataclass(frozen=True, slots=True)
class WaveformFit:
    """What the taps have in common."""

    taps: tuple[PulseHit, ...]
    first_peak_slope_per_s: Estimate
    """The largest acceleration over the speed, of a line through the origin."""
    amplitudes: Amplitudes
    """Instead of the line, where that does not do: speeds in m/s, rising, and m/s^2. Empty where the line does."""
    rate_hz: float
    """Of the samples."""
    samples: tuple[float, ...]
    """Of the curve, whose largest magnitude is 1."""
    deviations: tuple[float, ...]
    """Half of the 95 % interval of each sample."""
    length_s: float
    samples_a_period: float
    """Of the recordings, in a period of the frequency below which half of the waveform's energy lies."""
    r_squared: float
    """Of A(v) through the origin."""
    variance_accounted_for: float
    """Median over the taps, each by a waveform that was found without it."""
    sources: tuple[Source, ...]
    warnings: tuple[str, ...]
    judged: Verdict
    left_out: tuple[Exclusion, ...] = ()

    @property
    def verdict(self) -> str:
        return str(self.judged)

    @property
    def curve(self) -> Curve:
        """The waveform."""
        return Curve(self.samples, self.rate_hz)

    def material(self) -> dict[str, Json]:
        """Keys of a YAML material."""
        tap: dict[str, Json] = {"attack": "first_peak"}
        if self.amplitudes:
            tap["amplitudes"] = [[speed, amplitude.value] for speed, amplitude in self.amplitudes]
        else:
            tap["attack_slope_per_s"] = self.first_peak_slope_per_s.value
        tap["waveform"] = {"rate_hz": self.rate_hz, "samples": list(self.samples)}
        return {"tap": tap}

    def to_dict(self) -> dict[str, Json]:
        """As JSON has it, without the stretches."""
        return {
            "first_peak_slope_per_s": self.first_peak_slope_per_s.to_dict(),
            "amplitudes": [
                {"speed_m_per_s": speed, "first_peak_m_per_s2": amplitude.to_dict()}
                for speed, amplitude in self.amplitudes
            ],
            "waveform": {
                "rate_hz": self.rate_hz,
                "samples": list(self.samples),
                "half_of_the_interval": list(self.deviations),
            },
            **fields_of(self, "length_s", "samples_a_period", "r_squared", "variance_accounted_for"),
            "taps": [tap.to_dict() for tap in self.taps],
            **end_of(self),
        }


@dataclass(frozen=True, slots=True)
class Others:
    """What the shape would be without each of n pulses."""

    explained: Floats
    """(n,) of each pulse, by the shape of the others."""
    beside_noise: Floats
    """(n,) the same with the noise taken off."""


@dataclass(frozen=True, slots=True)
class Uncertain:
    """How far a shape may be from the one that was recorded."""

    deviations: Floats
    """(count,) standard errors of the samples, of what differs between the pulses."""
    of_amplitudes: float
    """The same of what all amplitudes have in common, as a part of them."""
    freedom: int
    """Of both."""
    unresolved: Floats
    """(count,) how far the curve is off for want of samples, from half a sample before each to half a sample behind
    (RMS)."""
    of_amplitudes_unresolved: float
    """The same of the amplitudes and of the whole curve (RMS), as a part of them: a peak between samples is missed by
    no less than the curve is."""

    @property
    def halves(self) -> Floats:
        """(count,) of the 95 % intervals of the samples."""
        return np.asarray(np.hypot(student_t(self.freedom) * self.deviations, self.unresolved))

    @property
    def half_of_amplitudes(self) -> float:
        """Of the 95 % interval of what all amplitudes have in common, as a part of them."""
        return math.hypot(student_t(self.freedom) * self.of_amplitudes, self.of_amplitudes_unresolved)


@dataclass(frozen=True, slots=True)
class Shape:
    """The waveform of some pulses, and these by it."""

    samples: Floats
    rate_hz: float
    placed: tuple[Placed, ...]
    others: Others
    uncertain: Uncertain
    faded: bool

    @property
    def curve(self) -> Curve:
        return Curve(self.samples, self.rate_hz)


def shape_of(pulses: Sequence[Pulse]) -> Shape:
    """The waveform of pulses, 3 or more. Raises FitError where they have nothing in common."""
    rate_hz, before_s, rest_s, count = _window(pulses)
    placed = []
    for pulse in pulses:
        above = pulse.measured - rest_of(pulse)
        peak = float(above[np.argmax(np.abs(above))])
        placed.append(Placed(peak, rest_of(pulse), crossing_s(pulse, CROSSES) - before_s, 0.0))
    samples, found = common_shape(pulses, placed, rate_hz, count)
    pulses, samples, found, rate_hz, faded = _trimmed(pulses, samples, found, rate_hz, math.floor(rest_s * rate_hz))
    samples, found, rate_hz = _coarser(pulses, samples, found, rate_hz)
    others = by_others(pulses, found, Equations(pulses, found, rate_hz, len(samples)), rate_hz)
    uncertain = _uncertain(pulses, samples, found, rate_hz, faded)
    return Shape(samples, rate_hz, tuple(found), others, uncertain, faded)


def by_others(pulses: Sequence[Pulse], placed: Sequence[Placed], equations: Equations, rate_hz: float) -> Others:
    """What the shape would be without each of the pulses."""
    shares = []
    for index, (pulse, where) in enumerate(zip(pulses, placed, strict=True)):
        _, other = upright(equations.solved(without=index), rate_hz)
        alone = place(other, pulse, where.onset_s, 2.0 / rate_hz)
        shares.append([explained(other, pulse, alone, noise) for noise in (0.0, pulse.noise_m_per_s2)])
    explains = np.array(shares)
    return Others(explains[:, 0], explains[:, 1])


def _uncertain(
    pulses: Sequence[Pulse], samples: Floats, placed: Sequence[Placed], rate_hz: float, faded: bool
) -> Uncertain:
    """Found again, with all onsets, without each of the pulses, and with twice as many samples."""
    count, groups = len(samples), min(len(pulses), GROUPS)
    shapes, sizes = [], []
    for group in range(groups):
        kept = [index for index in range(len(pulses)) if index % groups != group]
        some = [placed[index] for index in kept]
        shape, found = common_shape([pulses[index] for index in kept], some, rate_hz, count, turns=1)
        shapes.append(shape)
        sizes.append(_ratio(found, some))
    finer, found = common_shape(pulses, placed, 2 * rate_hz, 2 * count - 1, turns=2)
    between_s = np.arange(2 * count - 1) / (2 * rate_hz)
    changes = (FINER * (finer - Curve(samples, rate_hz).at(between_s))) ** 2
    # That a shape is faded out says nothing of the amplitudes.
    whole = changes[: math.floor((1 - FADED) * len(changes))] if faded else changes
    about = np.zeros(count)
    about[1:-1] = np.sqrt((changes[1:-3:2] + changes[2:-2:2] + changes[3:-1:2]) / 3)
    return Uncertain(
        deviations=_with_neighbours(jackknife_error(np.array(shapes))),
        of_amplitudes=float(jackknife_error(np.array(sizes))),
        freedom=groups - 1,
        unresolved=about,
        of_amplitudes_unresolved=math.hypot(FINER * (_ratio(found, placed) - 1.0), math.sqrt(float(np.mean(whole)))),
    )


def _ratio(found: Sequence[Placed], before: Sequence[Placed]) -> float:
    """Of all amplitudes to those before."""
    old = np.array([each.amplitude for each in before])
    return float(old @ np.array([each.amplitude for each in found]) / (old @ old))


def _with_neighbours(errors: Floats) -> Floats:
    """Standard errors (count,), 0 at the ends: their squares in the mean over five neighbours, fewer near the ends,
    as with few taps some are small by luck."""
    inner = np.ones(len(errors) - 2)
    around = np.ones(5)
    mean = np.convolve(errors[1:-1] ** 2, around)[2:-2] / np.convolve(inner, around)[2:-2]
    return np.concatenate(([0.0], np.sqrt(mean), [0.0]))


def _window(pulses: Sequence[Pulse]) -> tuple[float, float, float, int]:
    """The rate of the samples, how long before the crossing the shape may begin, how much of that is rest, and how many
    samples it may have."""
    rate_hz = min(pulse.rate_hz for pulse in pulses)
    crossings = [crossing_s(pulse, CROSSES) for pulse in pulses]
    peaks = [np.argmax(np.abs(pulse.measured - rest_of(pulse))) / pulse.rate_hz for pulse in pulses]
    rise_s = float(np.median(np.subtract(peaks, crossings)))
    before_s = min(2.0 * max(rise_s, 0.0) + 3.0 / rate_hz, max(1.0 / rate_hz, float(np.median(crossings))))
    ends = [len(pulse.measured) / pulse.rate_hz for pulse in pulses]
    length_s = min(LONGEST_S, before_s + float(np.median(np.subtract(ends, crossings))))
    rate_hz = min(rate_hz, (MOST_SAMPLES - 1) / length_s)
    # The rise from the crossing to the peak takes longer than the one from the contact to the crossing; and a sample
    # before the first loud one of any pulse there is rest.
    loud_s = min(before_s + pulse.onset_s - crossing for pulse, crossing in zip(pulses, crossings, strict=True))
    rest_s = max(0.0, before_s - max(rise_s, 1.0 / rate_hz), min(loud_s, before_s) - 1.0 / rate_hz)
    return rate_hz, before_s, rest_s, max(LEAST_SAMPLES, math.floor(length_s * rate_hz) + 1)


def _trimmed(
    pulses: Sequence[Pulse], samples: Floats, placed: list[Placed], rate_hz: float, rest: int
) -> tuple[list[Pulse], Floats, list[Placed], float, bool]:
    """The shape from where it begins to where it is over, at the rate of the recordings where that leaves room; and the
    pulses until then. Its first `rest` samples are before the contact."""
    equations = Equations(pulses, placed, rate_hz, len(samples))
    quiet = samples[1 : 1 + rest]
    level, scatter = (float(np.median(quiet)), float(np.std(quiet, ddof=1))) if len(quiet) >= QUIET else (0.0, 0.0)
    # Hum and noise are in the rest, too, and their squares add up to energy.
    noise = np.hypot(equations.deviations(equations.solved()), scatter)
    energy = samples**2 - noise**2
    total = float(energy.sum())
    if not total > 0:
        raise FitError("the taps have no shape in common that stands out of what differs between them")
    ahead = np.flatnonzero(np.cumsum(energy) <= FAINT * total)
    rise = int(np.argmax(np.abs(samples) >= LARGE * np.abs(samples).max()))
    at_rest = np.flatnonzero(np.abs(samples - level)[:rise] <= CLEAR * noise[:rise])
    begin = max(int(steps[-1]) if len(steps) else 0 for steps in (ahead, at_rest))
    left = 0.0
    end = len(samples) - 1
    while end > rise and (left := max(0.0, left + samples[end] ** 2 - (2.0 * noise[end]) ** 2)) <= FAINT * total:
        end -= 1
    end = min(len(samples) - 1, end + 1)
    faded = end == len(samples) - 1 and float(np.abs(samples[-max(2, len(samples) // 20) :]).max()) > UNFINISHED
    length_s = (end - begin) / rate_hz
    finer_hz = min(min(pulse.rate_hz for pulse in pulses), (MOST_SAMPLES - 1) / max(length_s, 1e-9))
    count = max(LEAST_SAMPLES, math.floor(length_s * finer_hz + 1e-9) + 1)
    moved = [dataclasses.replace(each, onset_s=each.onset_s + begin / rate_hz) for each in placed]
    over_s = [each.onset_s + AFTER * length_s for each in moved]
    pulses = [pulse.until(end_s) for pulse, end_s in zip(pulses, over_s, strict=True)]
    samples, found = common_shape(pulses, moved, finer_hz, count, turns=4)
    if faded:
        over = max(2, round(FADED * count))
        samples[-over:] *= 0.5 * (1.0 + np.cos(math.pi * np.arange(1, over + 1) / over))
        samples[-1] = 0.0
    return pulses, samples, found, finer_hz, faded


def _coarser(
    pulses: Sequence[Pulse], samples: Floats, placed: list[Placed], rate_hz: float
) -> tuple[Floats, list[Placed], float]:
    """The same with as few samples as do."""

    def share(found: Sequence[Placed], at_hz: float, count: int) -> float:
        return float(np.median(by_others(pulses, found, Equations(pulses, found, at_hz, count), at_hz).beside_noise))

    least = share(placed, rate_hz, len(samples)) - COARSER
    while True:
        half_hz = rate_hz / 2
        count = math.ceil((len(samples) - 1) / 2) + 1
        if count < LEAST_SAMPLES or half_hz < 100:
            return samples, placed, rate_hz
        tried, found = common_shape(pulses, placed, half_hz, count, turns=2)
        if share(found, half_hz, count) < least:
            return samples, placed, rate_hz
        samples, placed, rate_hz = tried, found, half_hz


def fit_waveform(
    pulses: Sequence[Pulse], sources: Sequence[Source], earlier: Sequence[str], excluded: Exclusions
) -> WaveformFit:
    """The waveform of taps that are pulses; `earlier` are warnings of how the pulses were found. Taps that cannot be
    used are reported in `excluded`.

    Raises FitError (one line) for too few, for pulses that have nothing in common, and for amplitudes that do not grow
    with the speed.
    """
    pulses, shape = _alike(list(pulses), earlier, excluded)
    warnings = [*excluded.lines(), *earlier]
    doubts = Doubts()
    peaks = np.array([each.amplitude for each in shape.placed])
    if float(np.median(peaks)) < 0:
        warnings.append("the taps push downwards: the acceleration is taken with its sign turned")
        peaks = -peaks
    each = zip(pulses, shape.placed, shape.others.explained, strict=True)
    hits = tuple(_hit(pulse, placed, share, shape.curve) for pulse, placed, share in each)
    check_speeds(hits)
    speeds = np.array([pulse.speed_m_per_s for pulse in pulses])
    variances = _variances(pulses, shape)
    line = through_origin(speeds, peaks, variances, speeds**2)
    part = shape.uncertain.half_of_amplitudes
    slope = _wider(line.coefficients[0], part)
    check_slope(slope)
    share = float(np.median(shape.others.explained))
    resolved = min(pulse.rate_hz for pulse in pulses) / shape.curve.middle_hz
    _doubt_the_shape(doubts, shape, share, resolved)
    law = law_of(speeds, peaks, variances)
    if law.kind != "line":
        warnings.append(f"A(v) is {law.named}, no line through the origin: {law.why}")
    doubt_the_law(doubts, law, line.r_squared)
    doubts.add(False, mostly_excluded(excluded, len(hits), "tap"))
    warnings += doubts.warnings
    return WaveformFit(
        taps=hits,
        first_peak_slope_per_s=slope,
        amplitudes=tuple(
            (speed, _wider(amplitude, part)) for speed, amplitude in (() if law.kind == "line" else law.points)
        ),
        rate_hz=shape.rate_hz,
        samples=tuple(map(float, shape.samples)),
        deviations=tuple(map(float, shape.uncertain.halves)),
        length_s=shape.curve.length_s,
        samples_a_period=resolved,
        r_squared=line.r_squared,
        variance_accounted_for=share,
        sources=tuple(sources),
        warnings=tuple(warnings),
        judged=doubts.judged(
            f"a waveform explains {100 * share:.1f} % of {len(pulses)} taps",
            f"A(v) is {law.named} (r^2 {line.r_squared if law.kind == 'line' else law.r_squared:.3f})",
        ),
        left_out=tuple(excluded.items),
    )


def _doubt_the_shape(doubts: Doubts, shape: Shape, share: float, resolved: float) -> None:
    """Whether all taps have it, whether it is whole, and whether the samples resolve it."""
    doubts.at_least(
        "variance that a waveform explains",
        share,
        f"a waveform explains {100 * share:.1f} % of a tap",
        "the taps differ in shape",
    )
    if shape.faded:
        doubts.add(
            False,
            f"the pulses are not over after {1e3 * shape.curve.length_s:.3g} ms",
            f"the waveform is faded out over its last {100 * FADED:.0f} %",
        )
    doubts.at_least(
        "samples in a period of a waveform",
        resolved,
        f"{resolved:.1f} samples of the recordings are a period of its middle frequency",
        "the waveform is not resolved: record faster",
    )


def _wider(estimate: Estimate, part: float) -> Estimate:
    """With a further error, half of whose interval is this part of the value."""
    further = (part * estimate.value) ** 2
    return Estimate(
        estimate.value,
        estimate.value - math.sqrt((estimate.value - estimate.low) ** 2 + further),
        estimate.value + math.sqrt((estimate.high - estimate.value) ** 2 + further),
    )


def _alike(pulses: list[Pulse], earlier: Sequence[str], excluded: Exclusions) -> tuple[list[Pulse], Shape]:
    """The pulses that have a shape in common; the others are reported in `excluded`."""
    if len(pulses) < LEAST_PULSES:
        reasons = [*excluded.lines(), *earlier]
        why = f" ({'; '.join(reasons[:3])})" if reasons else ""
        raise FitError(f"{len(pulses)} taps are too few: needs {LEAST_PULSES}, better ten, at different speeds{why}")
    shape = shape_of(pulses)
    usual = math.copysign(1.0, float(np.median([each.amplitude for each in shape.placed])))
    kept = []
    for pulse, placed, share in zip(pulses, shape.placed, shape.others.beside_noise, strict=True):
        if share < ALIKE:
            reason = f"the waveform of the others explains {100 * share:.0f} % of it"
        elif placed.amplitude * usual <= 0:
            reason = "it pushes the other way"
        else:
            kept.append(pulse)
            continue
        excluded.add(pulse.recording, reason, "tap", pulse.begin_s + placed.onset_s)
    if len(kept) == len(pulses):
        return pulses, shape
    if len(kept) < max(LEAST_PULSES, len(pulses) / 2):
        raise FitError(
            f"{len(pulses) - len(kept)} of {len(pulses)} taps have no waveform in common with the others: is it one "
            "material, tapped alike?"
        )
    return kept, shape_of(kept)


def _variances(pulses: Sequence[Pulse], shape: Shape) -> Floats:
    """Of the amplitudes, of what is left over."""
    found = []
    for pulse, placed in zip(pulses, shape.placed, strict=True):
        heard = shape.curve.at(pulse.since_s - placed.onset_s)
        own = float(heard @ heard)
        noise = max(placed.squares, 1e-18 * placed.amplitude**2) / max(1, len(heard) - 3)
        found.append(noise / max(own, 1e-12))
    return np.array(found)


def _hit(pulse: Pulse, placed: Placed, share: float, shape: Curve) -> PulseHit:
    return PulseHit(
        recording=pulse.recording,
        onset_s=pulse.begin_s + placed.onset_s,
        speed_m_per_s=pulse.speed_m_per_s,
        peak_m_per_s2=abs(placed.amplitude),
        variance_accounted_for=float(share),
        rate_hz=pulse.rate_hz,
        measured=pulse.measured,
        modelled=placed.modelled(shape, pulse),
    )
