"""Fit of taps that are pulses: their common waveform, scaled with the approach speed.

    y_i(t) = a_i s(R (t - t_i)) + c_i, where s is the curve of hapticd.config.waveform

The fit alternates two steps. For given amplitudes a_i, onsets t_i and offsets c_i, the samples of s at the rate R are
fitted by linear least squares. For given s, a_i and c_i are fitted in the same way, and t_i is searched. The search
starts where the pulse crosses a fraction of its peak. s is interpolated as in the servo, so the fit includes the error
of the interpolation. s is 0 at both ends, and its peak is 1.

The explained variance of a tap is that by a shape fitted without this tap. The amplitude is the tap's largest
acceleration; the law of amplitude versus speed is chosen as for taps that ring.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats, jackknife_error, student_t, through_origin
from hapticd.base.core import MAX_WAVEFORM_SAMPLES
from hapticd.base.yaml_source import Json
from hapticd.config.waveform import MAX_WAVEFORM_LENGTH_S, Curve
from hapticd.fit import speed_law
from hapticd.fit.limits import TAP_LIMITS, WAVEFORM_LIMITS
from hapticd.fit.recording import Recording
from hapticd.fit.result import Fit
from hapticd.fit.speed_law import Amplitudes, Law
from hapticd.fit.tap import Events, Unusable
from hapticd.fit.verdict import Exclusions, Warnings

# ---- Onsets: the pulses of recordings --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Pulse:
    """A section of a recording with one tap, and the approximate onset of this tap."""

    recording: str
    begin_s: float
    """Time of the first sample, on the recording's clock."""
    onset_s: float
    """Time of the onset after the first sample."""
    speed_m_per_s: float
    rate_hz: float
    measured: Floats
    """(n,) acceleration, m/s^2."""
    lasts_s: float
    """Time from the first loud sample to the last, which may be after those of `measured`."""

    def until(self, end_s: float) -> Pulse:
        """Return the pulse without the samples later than `end_s` after its first sample."""
        return dataclasses.replace(self, measured=self.measured[: max(2, math.ceil(end_s * self.rate_hz))])

    @property
    def noise_m_per_s2(self) -> float:
        """Standard deviation of the acceleration before the onset, or 0 for fewer than 6 samples."""
        first = math.floor(self.onset_s * self.rate_hz)
        return float(np.std(self.measured[:first])) if first >= 6 else 0.0

    @property
    def since_s(self) -> Floats:
        """(n,) times of the samples since the first sample."""
        return np.arange(len(self.measured)) / self.rate_hz

    @property
    def rest(self) -> float:
        """Median of the acceleration before the onset, m/s^2."""
        first = max(1, math.floor(self.onset_s * self.rate_hz))
        return float(np.median(self.measured[:first]))

    @property
    def rings_on(self) -> bool:
        """Whether the pulse changes its sign at least twice and is loud to the end of `measured`."""
        above = self.measured - self.rest
        strong = above[np.abs(above) > WAVEFORM_LIMITS.alignment_level * np.abs(above).max()]
        turns = int(np.count_nonzero(np.diff(np.sign(strong))))
        to_the_end = self.lasts_s > 0.9 * (len(self.measured) / self.rate_hz - self.onset_s)
        return to_the_end and turns >= WAVEFORM_LIMITS.min_ringing_turns

    def crossing_s(self) -> float:
        """Return the time, s after the first sample, at which the pulse rises above alignment_level times its peak."""
        size = np.abs(self.measured - self.rest)
        level = WAVEFORM_LIMITS.alignment_level * float(size.max())
        below = np.flatnonzero(size[: int(np.argmax(size >= WAVEFORM_LIMITS.rise_end_level * size.max()))] < level)
        if not len(below):
            return 0.0
        before = int(below[-1])
        low, high = float(size[before]), float(size[before + 1])
        return (before + (level - low) / (high - low)) / self.rate_hz


def ring_on(pulses: Sequence[Pulse]) -> bool:
    """Return whether most of these pulses ring on after a waveform ends."""
    return 2 * sum(pulse.rings_on for pulse in pulses) > len(pulses)


def pulses_of(recordings: Sequence[Recording], lines: list[str], excluded: Exclusions) -> list[Pulse]:
    """Return the taps of recordings, each with the rest before it; unusable taps are added to `excluded`."""

    def pulses_in(recording: Recording) -> list[Pulse]:
        loud = Events(recording, lines)
        found = []
        for index, event in enumerate(loud.events):
            try:
                found.append(_pulse(loud, index))
            except Unusable as no:
                excluded.add(recording.name, str(no), "tap", event.first / recording.rate_hz)
        if not found:
            excluded.unused.add(recording.name)
        return found

    return [pulse for found in excluded.each(recordings, pulses_in) for pulse in found]


def _pulse(loud: Events, index: int) -> Pulse:
    """Return the pulse of an event, with up to 20 ms of rest before the onset; raise Unusable if it cannot be used."""
    event, (before, after) = loud.events[index], loud.section(index)
    first = event.first
    name, rate_hz = loud.recording.name, loud.recording.rate_hz
    begin = max(before, first - max(TAP_LIMITS.min_rest_samples, round(0.02 * rate_hz)))
    end = min(after, first + round(MAX_WAVEFORM_LENGTH_S * rate_hz))
    loud.check(begin, end)
    speed = loud.speed(index, first / rate_hz)
    measured, lasts_s = loud.acceleration[begin:end], (event.last - first) / rate_hz
    return Pulse(name, begin / rate_hz, (first - begin) / rate_hz, speed, rate_hz, measured, lasts_s)


# ---- Model: the common shape of the pulses ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FittedPulse:
    """Amplitude, offset and onset of a pulse fitted by the common waveform."""

    amplitude: float
    offset: float
    onset_s: float
    """Onset after the first sample of the pulse."""
    squares: float
    """Sum of squares of the residual."""

    def modelled(self, shape: Curve, pulse: Pulse) -> Floats:
        """Return the acceleration (n,), m/s^2, of this shape at the samples of the pulse."""
        return np.asarray(self.amplitude * shape.at(pulse.since_s - self.onset_s) + self.offset)

    def explained(self, shape: Curve, pulse: Pulse, noise_m_per_s2: float = 0.0) -> float:
        """Return the fraction of the pulse's variance, while the shape lasts, that the shape explains.

        The variance is about the offset, less that of the noise with the given standard deviation.
        """
        since = pulse.since_s - self.onset_s
        here = (since >= 0) & (since <= shape.length_s)
        above = pulse.measured[here] - self.offset
        left = pulse.measured[here] - self.modelled(shape, pulse)[here]
        noise = noise_m_per_s2**2 * len(left)
        energy = float(above @ above) - noise
        return min(1.0, 1.0 - (float(left @ left) - noise) / energy) if energy > 0 else 0.0


class Equations:
    """Normal equations of each pulse for the shape's `count` samples, without the first and the last, which are 0."""

    def __init__(self, pulses: Sequence[Pulse], fitted: Sequence[FittedPulse], rate_hz: float, count: int) -> None:
        from scipy.sparse import csr_array

        self._own: list[tuple[Floats, Floats]] = []
        """For each pulse the matrix (count - 2, count - 2) and the right side (count - 2,)."""
        for pulse, where in zip(pulses, fitted, strict=True):
            at = (pulse.since_s - where.onset_s) * rate_hz
            here = (at >= 0) & (at <= count - 1)
            k = np.minimum(np.floor(at[here]), count - 2).astype(np.intp)
            x = at[here] - k
            weights = 0.5 * np.column_stack(
                (
                    x * (-1 + x * (2 - x)),
                    2 + x * x * (3 * x - 5),
                    x * (1 + x * (4 - 3 * x)),
                    x * x * (x - 1),
                )
            )
            # Weights of four neighbouring samples; two columns at each end are for the zeros there.
            places = (k[:, None] + np.arange(4)).ravel(), np.arange(0, 4 * len(k) + 1, 4)
            shape = (len(k), count + 2)
            rows = csr_array((where.amplitude * weights.ravel(), *places), shape=shape)[:, 2:-2]
            self._own.append(((rows.T @ rows).toarray(), rows.T @ (pulse.measured[here] - where.offset)))
        self._gram = np.sum([gram for gram, _ in self._own], axis=0)
        self._side = np.sum([side for _, side in self._own], axis=0)
        # A small penalty on second differences determines samples that no pulse has measured.
        bends = np.diff(np.eye(count), 2, axis=0)[:, 1:-1]
        self._smooth = 1e-4 * float(np.mean(np.diag(self._gram))) * (bends.T @ bends)

    def solved(self, without: int | None = None) -> Floats:
        """Return the shape's samples (count,), fitted to all pulses, or to all but that of index `without`."""
        from scipy.linalg import solve

        gram, side = self._gram, self._side
        if without is not None:
            gram, side = gram - self._own[without][0], side - self._own[without][1]
        return np.pad(solve(gram + self._smooth, side, assume_a="pos", check_finite=False), 1)

    def deviations(self, samples: Floats) -> Floats:
        """Return the standard errors (count,) of these samples, from the differences between pulses.

        This is the sandwich estimator of linear regression.
        """
        from scipy.linalg import solve

        left = np.column_stack([side - gram @ samples[1:-1] for gram, side in self._own])
        moved = solve(self._gram + self._smooth, left, assume_a="pos", check_finite=False)
        pulses = len(self._own)
        return np.pad(np.sqrt(np.sum(moved**2, axis=1) * pulses / max(1, pulses - 1)), 1)


def _fit_pulse(shape: Curve, pulse: Pulse, near_s: float, reach_s: float) -> FittedPulse:
    """Return the fit of a pulse by this shape; the onset is searched up to `reach_s` from `near_s`.

    Four times, the best of nine onsets is taken; each time their range is a quarter of the previous one.
    """
    best: FittedPulse | None = None
    middle_s = near_s
    for _ in range(4):
        onsets = middle_s + np.linspace(-reach_s, reach_s, 9)
        curves = shape.at(pulse.since_s[None, :] - onsets[:, None])
        mean = curves.mean(axis=1, keepdims=True)
        level = float(pulse.measured.mean())
        centred, measured = curves - mean, pulse.measured - level
        size = np.maximum(np.sum(centred**2, axis=1), 1e-300)
        along = centred @ measured
        which = int(np.argmax(along**2 / size))
        amplitude = float(along[which] / size[which])
        found = FittedPulse(
            amplitude,
            level - amplitude * float(mean[which, 0]),
            float(onsets[which]),
            float(measured @ measured) - float(along[which] ** 2 / size[which]),
        )
        if best is None or found.squares < best.squares:
            best = found
        middle_s, reach_s = best.onset_s, reach_s / 4
    assert best is not None
    return best


def _normalized(samples: Floats, rate_hz: float) -> tuple[Floats, Curve]:
    """Return the samples of a curve whose peak, the value of largest magnitude, is scaled to 1, and this curve."""
    curve = Curve(samples, rate_hz)
    peak = float(curve.at(curve.peak_time_s))
    scaled = samples / peak if peak else samples
    return scaled, Curve(scaled, rate_hz)


@dataclass(frozen=True, slots=True)
class Shape:
    """The common waveform of some pulses, and the fits of these pulses by the waveform."""

    pulses: tuple[Pulse, ...]
    fitted: tuple[FittedPulse, ...]
    rate_hz: float
    samples: Floats
    """Samples (count,) of the waveform."""

    @classmethod
    def of(
        cls, pulses: Sequence[Pulse], fitted: Sequence[FittedPulse], rate_hz: float, count: int, rounds: int = 6
    ) -> Shape:
        """Fit a shape with `count` samples at this rate; `fitted` are the initial fits of the pulses."""
        found = list(fitted)
        reach_s = 2.0 / rate_hz
        for done in range(rounds + 1):
            samples, curve = _normalized(Equations(pulses, found, rate_hz, count).solved(), rate_hz)
            found = [_fit_pulse(curve, pulse, each.onset_s, reach_s) for pulse, each in zip(pulses, found, strict=True)]
            if done < rounds:
                # The shape may shift along its samples together with all onsets: this is undone.
                slid = float(np.median([new.onset_s for new in found]) - np.median([old.onset_s for old in fitted]))
                found = [dataclasses.replace(each, onset_s=each.onset_s - slid) for each in found]
                reach_s = max(reach_s / 2, 0.25 / rate_hz)
        return cls(tuple(pulses), tuple(found), rate_hz, samples)

    @property
    def curve(self) -> Curve:
        """The waveform as a curve."""
        return Curve(self.samples, self.rate_hz)

    @property
    def equations(self) -> Equations:
        """The normal equations of the samples."""
        return Equations(self.pulses, self.fitted, self.rate_hz, len(self.samples))

    def explained(self) -> tuple[Floats, Floats]:
        """Return the fractions (n,) of each pulse's variance, with and without noise, that the other pulses explain."""
        equations = self.equations
        fractions = []
        for index, (pulse, where) in enumerate(zip(self.pulses, self.fitted, strict=True)):
            _, other = _normalized(equations.solved(without=index), self.rate_hz)
            alone = _fit_pulse(other, pulse, where.onset_s, 2.0 / self.rate_hz)
            fractions.append([alone.explained(other, pulse, noise) for noise in (0.0, pulse.noise_m_per_s2)])
        explains = np.array(fractions)
        return explains[:, 0], explains[:, 1]

    def trimmed(self, rest: int) -> tuple[Shape, bool]:
        """Return the shape without rest before or after the pulse, and whether the shape's end is faded out.

        The first `rest` samples are before the onset. The new shape begins at the last sample before the rise that is
        within three standard errors of the rest. It ends where the energy of later samples, less that of twice their
        standard errors, is below WAVEFORM_LIMITS.max_faint_energy. The rate of the recordings is lowered if the new
        shape would have too many samples.
        """
        samples, rate_hz, equations = self.samples, self.rate_hz, self.equations
        quiet = samples[1 : 1 + rest]
        level, scatter = (float(np.median(quiet)), float(np.std(quiet, ddof=1))) if len(quiet) >= 3 else (0.0, 0.0)
        # The energy of hum and noise is subtracted; it is measured at rest and between the pulses.
        noise = np.hypot(equations.deviations(equations.solved()), scatter)
        energy = samples**2 - noise**2
        total = float(energy.sum())
        if not total > 0:
            raise FitError("the taps have no common waveform that is larger than their differences")
        ahead = np.flatnonzero(np.cumsum(energy) <= WAVEFORM_LIMITS.max_faint_energy * total)
        rise = int(np.argmax(np.abs(samples) >= WAVEFORM_LIMITS.rise_end_level * np.abs(samples).max()))
        at_rest = np.flatnonzero(np.abs(samples - level)[:rise] <= 3.0 * noise[:rise])
        begin = max(int(steps[-1]) if len(steps) else 0 for steps in (ahead, at_rest))
        left, end = 0.0, len(samples) - 1
        while end > rise:
            left = max(0.0, left + samples[end] ** 2 - (2.0 * noise[end]) ** 2)
            if left > WAVEFORM_LIMITS.max_faint_energy * total:
                break
            end -= 1
        end = min(len(samples) - 1, end + 1)
        faded = (
            end == len(samples) - 1
            and float(np.abs(samples[-max(2, len(samples) // 20) :]).max()) > WAVEFORM_LIMITS.max_end_level
        )
        length_s = (end - begin) / rate_hz
        finer_hz = min(min(pulse.rate_hz for pulse in self.pulses), (MAX_WAVEFORM_SAMPLES - 1) / max(length_s, 1e-9))
        count = max(WAVEFORM_LIMITS.min_samples, math.floor(length_s * finer_hz + 1e-9) + 1)
        moved = [dataclasses.replace(each, onset_s=each.onset_s + begin / rate_hz) for each in self.fitted]
        # A pulse is fitted up to 1.3 times its length.
        pulses = [pulse.until(each.onset_s + 1.3 * length_s) for pulse, each in zip(self.pulses, moved, strict=True)]
        found = Shape.of(pulses, moved, finer_hz, count, rounds=4)
        if faded:
            over = max(2, round(WAVEFORM_LIMITS.fade_out_fraction * count))
            found.samples[-over:] *= 0.5 * (1.0 + np.cos(math.pi * np.arange(1, over + 1) / over))
            found.samples[-1] = 0.0
        return found, faded

    def coarser(self) -> Shape:
        """Return the shape with fewer samples: the rate is halved while this loses at most 1e-4 of the variance."""
        enough, shape = float(np.median(self.explained()[1])) - WAVEFORM_LIMITS.max_coarse_loss, self
        while True:
            count = math.ceil((len(shape.samples) - 1) / 2) + 1
            if count < WAVEFORM_LIMITS.min_samples or shape.rate_hz < 200:
                return shape
            tried = Shape.of(self.pulses, shape.fitted, shape.rate_hz / 2, count, rounds=2)
            if float(np.median(tried.explained()[1])) < enough:
                return shape
            shape = tried


def shape_of(pulses: Sequence[Pulse]) -> tuple[Shape, bool]:
    """Return the common waveform of three or more pulses, and whether the waveform's end is faded out.

    Raises FitError if the pulses have no common waveform.
    """
    rate_hz = min(pulse.rate_hz for pulse in pulses)
    crossings = [pulse.crossing_s() for pulse in pulses]
    peaks = [np.argmax(np.abs(pulse.measured - pulse.rest)) / pulse.rate_hz for pulse in pulses]
    rise_s = float(np.median(np.subtract(peaks, crossings)))
    # Time before the crossing at which the shape may begin, and its greatest length.
    before_s = min(2.0 * max(rise_s, 0.0) + 3.0 / rate_hz, max(1.0 / rate_hz, float(np.median(crossings))))
    ends = [len(pulse.measured) / pulse.rate_hz for pulse in pulses]
    length_s = min(MAX_WAVEFORM_LENGTH_S, before_s + float(np.median(np.subtract(ends, crossings))))
    rate_hz = min(rate_hz, (MAX_WAVEFORM_SAMPLES - 1) / length_s)
    # At rest are times that are farther before the crossing than the peak is after it, and those until a sample before
    # the first loud sample of any pulse.
    loud_s = min(before_s + pulse.onset_s - crossing for pulse, crossing in zip(pulses, crossings, strict=True))
    rest_s = max(0.0, before_s - max(rise_s, 1.0 / rate_hz), min(loud_s, before_s) - 1.0 / rate_hz)
    fitted = []
    for pulse, crossing in zip(pulses, crossings, strict=True):
        above = pulse.measured - pulse.rest
        peak = float(above[np.argmax(np.abs(above))])
        fitted.append(FittedPulse(peak, pulse.rest, crossing - before_s, 0.0))
    shape = Shape.of(pulses, fitted, rate_hz, max(WAVEFORM_LIMITS.min_samples, math.floor(length_s * rate_hz) + 1))
    found, faded = shape.trimmed(math.floor(rest_s * rate_hz))
    return found.coarser(), faded


# ---- Intervals -------------------------------------------------------------------------------------------------------


def _uncertain(shape: Shape, faded: bool) -> tuple[Floats, float]:
    """Return half the 95 % intervals of the shape's samples (count,), and of a common factor of all amplitudes.

    Two errors are added in quadrature. The first is from a jackknife over the pulses, or over 16 groups of pulses, with
    all onsets fitted again. The second is the interpolation error, estimated from a fit with twice as many samples. For
    a sample it is the RMS change of the curve up to half a sample away. For the amplitudes it is their own change and
    the RMS change of the curve, because a peak between samples has at least the error of the curve.
    """
    count, groups = len(shape.samples), min(len(shape.pulses), WAVEFORM_LIMITS.max_groups)
    samples, sizes = [], []
    for group in range(groups):
        kept = [index for index in range(len(shape.pulses)) if index % groups != group]
        some = [shape.fitted[index] for index in kept]
        found = Shape.of([shape.pulses[index] for index in kept], some, shape.rate_hz, count, rounds=1)
        samples.append(found.samples)
        sizes.append(_ratio(found.fitted, some))
    finer = Shape.of(shape.pulses, shape.fitted, 2 * shape.rate_hz, 2 * count - 1, rounds=2)
    between_s = np.arange(2 * count - 1) / (2 * shape.rate_hz)
    changes = (WAVEFORM_LIMITS.error_to_change * (finer.samples - shape.curve.at(between_s))) ** 2
    # The faded end does not affect the amplitudes.
    unfaded = changes[: math.floor((1 - WAVEFORM_LIMITS.fade_out_fraction) * len(changes))] if faded else changes
    off = WAVEFORM_LIMITS.error_to_change * (_ratio(finer.fitted, shape.fitted) - 1.0)
    # Squares are averaged over five neighbours, fewer near the ends: of few taps some are small by chance.
    squares = jackknife_error(np.array(samples))[1:-1] ** 2
    mean = np.convolve(squares, np.ones(5))[2:-2] / np.convolve(np.ones(count - 2), np.ones(5))[2:-2]
    deviations = np.pad(np.sqrt(mean), 1)
    unresolved = np.pad(np.sqrt((changes[1:-3:2] + changes[2:-2:2] + changes[3:-1:2]) / 3), 1)
    wide = student_t(groups - 1)
    of_amplitudes = wide * float(jackknife_error(np.array(sizes)))
    together = math.hypot(of_amplitudes, math.hypot(off, math.sqrt(float(np.mean(unfaded)))))
    return np.asarray(np.hypot(wide * deviations, unresolved)), together


def _widened(estimate: Estimate, fraction: float) -> Estimate:
    """Return the estimate with a wider interval: a further error, a `fraction` of the value, is added in quadrature."""
    value, further = estimate.value, fraction * estimate.value
    low, high = math.hypot(value - estimate.low, further), math.hypot(estimate.high - value, further)
    return Estimate(value, value - low, value + high)


def _ratio(found: Sequence[FittedPulse], before: Sequence[FittedPulse]) -> float:
    """Return the ratio of the amplitudes `found` to the amplitudes `before`, by least squares."""
    old = np.array([each.amplitude for each in before])
    return float(old @ np.array([each.amplitude for each in found]) / (old @ old))


# ---- The fit, and its verdict ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class PulseHit:
    """A tap fitted by a waveform, with the fitted section of the recording."""

    recording: str
    onset_s: float
    """Onset on the recording's clock."""
    speed_m_per_s: float
    peak_m_per_s2: float
    """Largest acceleration of the fitted waveform."""
    variance_accounted_for: float
    """Fraction of the variance that a waveform fitted without this tap explains."""
    rate_hz: float = field(repr=False)
    measured: Floats = field(repr=False)
    modelled: Floats = field(repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveformFit(Fit):
    """Result of a fit of taps that are pulses, by a common waveform."""

    taps: tuple[PulseHit, ...]
    first_peak_slope_per_s: Estimate
    """Slope of the largest acceleration with speed, for a line through the origin."""
    law: Law
    """Law of the largest acceleration versus speed: the line, a power law or a table."""
    amplitudes: Amplitudes
    """Table of rising speeds, m/s, and amplitudes, m/s^2. Empty if the law is a line."""
    rate_hz: float
    samples: tuple[float, ...]
    """Samples of the curve, whose largest magnitude is 1."""
    deviations: tuple[float, ...]
    """Half of the 95 % interval of each sample."""
    length_s: float
    samples_a_period: float
    """Recorded samples in a period of the middle frequency, below which half of the waveform's energy lies."""
    r_squared: float
    """r^2 of the amplitude versus speed as a line through the origin."""
    variance_accounted_for: float
    """Fraction of a tap's variance that a waveform fitted without this tap explains, median over the taps."""

    @property
    def curve(self) -> Curve:
        """The waveform as a curve."""
        return Curve(self.samples, self.rate_hz)

    def material(self) -> dict[str, Json]:
        """Return the keys of a YAML material."""
        tap: dict[str, Json] = {"attack": "first_peak"}
        if self.amplitudes:
            tap["amplitudes"] = [[speed, amplitude.value] for speed, amplitude in self.amplitudes]
        else:
            tap["attack_slope_per_s"] = self.first_peak_slope_per_s.value
        tap["waveform"] = {"rate_hz": self.rate_hz, "samples": list(self.samples)}
        return {"tap": tap}

    def to_dict(self) -> dict[str, Json]:
        """Return the fit as plain data for JSON, without recorded samples."""
        figures = Fit.to_dict(self)
        names = {"rate_hz": "rate_hz", "samples": "samples", "deviations": "half_of_the_interval"}
        return {
            **{name: value for name, value in figures.items() if name not in names},
            "amplitudes": speed_law.json_table(self.amplitudes, "first_peak_m_per_s2"),
            "waveform": {name: figures[own] for own, name in names.items()},
        }


def fit_waveform(pulses: Sequence[Pulse], earlier: Sequence[str], excluded: Exclusions) -> WaveformFit:
    """Fit the common waveform of taps that are pulses.

    `earlier` are the warnings of the search for the pulses. Unusable taps are added to `excluded`. Raises FitError (one
    line) if the pulses do not support a fit.
    """
    pulses, shape, faded, explained = _alike(pulses, earlier, excluded)
    warnings = Warnings([*earlier])
    excluded.report(len(pulses), "taps", warnings)
    peaks = np.array([each.amplitude for each in shape.fitted])
    if float(np.median(peaks)) < 0:
        warnings.note("the taps push downwards: the sign of the acceleration is reversed")
        peaks = -peaks
    curve, (halves, of_amplitudes) = shape.curve, _uncertain(shape, faded)
    hits = tuple(
        PulseHit(
            recording=pulse.recording,
            onset_s=pulse.begin_s + fitted.onset_s,
            speed_m_per_s=pulse.speed_m_per_s,
            peak_m_per_s2=abs(fitted.amplitude),
            variance_accounted_for=float(fraction),
            rate_hz=pulse.rate_hz,
            measured=pulse.measured,
            modelled=fitted.modelled(curve, pulse),
        )
        for pulse, fitted, fraction in zip(pulses, shape.fitted, explained, strict=True)
    )
    speed_law.check_speeds(hits)
    speeds = np.array([pulse.speed_m_per_s for pulse in pulses])
    variances = _variances(pulses, shape)
    line = through_origin(speeds, peaks, variances, speeds**2)
    slope = _widened(line.coefficients[0], of_amplitudes)
    fraction = float(np.median(explained))
    resolved = min(pulse.rate_hz for pulse in pulses) / curve.middle_hz
    law = speed_law.law_of(speeds, peaks, variances)
    speed_law.check_rises(law, len(pulses))
    warnings.check("variance that a waveform explains", fraction)
    if faded or ring_on(pulses):
        percent = 100 * WAVEFORM_LIMITS.fade_out_fraction
        fade = f"the waveform is faded out over its last {percent:.0f} %" if faded else "--as mode fits a ringing"
        warnings.add(False, f"the pulses have not ended after {1e3 * curve.length_s:.3g} ms", fade)
    warnings.check("samples in a period of a waveform", resolved)
    speed_law.check_law(warnings, law)
    speed_law.check_hardness(speeds, peaks, 2.0 * math.pi * curve.middle_hz, "the angular frequency of the pulses")
    points = () if law.kind == "line" else law.points
    return WaveformFit(
        taps=hits,
        first_peak_slope_per_s=slope,
        law=law,
        amplitudes=tuple((speed, _widened(amplitude, of_amplitudes)) for speed, amplitude in points),
        rate_hz=shape.rate_hz,
        samples=tuple(map(float, shape.samples)),
        deviations=tuple(map(float, halves)),
        length_s=curve.length_s,
        samples_a_period=resolved,
        r_squared=line.r_squared,
        variance_accounted_for=fraction,
        warnings=tuple(warnings.lines),
        judged=warnings.verdict(
            f"a waveform explains {100 * fraction:.1f} % of {len(pulses)} taps",
            f"A(v) is {law.named} (r^2 {law.r_squared:.3f})",
        ),
        left_out=tuple(excluded.items),
    )


def _alike(
    pulses: Sequence[Pulse], earlier: Sequence[str], excluded: Exclusions
) -> tuple[Sequence[Pulse], Shape, bool, Floats]:
    """Return the pulses with a common shape, the shape, whether it is faded out, and the explained variances (n,).

    The explained variance of a pulse is that by the shape of the others. Pulses of other shape are added to `excluded`.
    """
    if len(pulses) < WAVEFORM_LIMITS.min_pulses:
        reasons = [*excluded.lines(), *earlier]
        why = f" ({'; '.join(reasons[:3])})" if reasons else ""
        raise FitError(
            f"{len(pulses)} taps are too few: needs {WAVEFORM_LIMITS.min_pulses}, better ten, at different speeds{why}"
        )
    shape, faded = shape_of(pulses)
    explained, without_noise = shape.explained()
    usual = math.copysign(1.0, float(np.median([each.amplitude for each in shape.fitted])))
    kept = []
    for pulse, fitted, fraction in zip(pulses, shape.fitted, without_noise, strict=True):
        if fraction < WAVEFORM_LIMITS.min_explained:
            reason = f"the waveform of the others explains {100 * fraction:.0f} % of the variance"
        elif fitted.amplitude * usual <= 0:
            reason = "pushes with the opposite sign"
        else:
            kept.append(pulse)
            continue
        excluded.add(pulse.recording, reason, "tap", pulse.begin_s + fitted.onset_s)
    if len(kept) == len(pulses):
        return pulses, shape, faded, explained
    if len(kept) < max(WAVEFORM_LIMITS.min_pulses, len(pulses) / 2):
        raise FitError(
            f"{len(pulses) - len(kept)} of {len(pulses)} taps have another waveform than the others: are all of one "
            "material, tapped in the same way?"
        )
    shape, faded = shape_of(kept)
    return kept, shape, faded, shape.explained()[0]


def _variances(pulses: Sequence[Pulse], shape: Shape) -> Floats:
    """Return the variances (n,) of the pulses' amplitudes, (m/s^2)^2, from the residuals."""
    found = []
    for pulse, fitted in zip(pulses, shape.fitted, strict=True):
        curve = shape.curve.at(pulse.since_s - fitted.onset_s)
        own = float(curve @ curve)
        noise = max(fitted.squares, 1e-18 * fitted.amplitude**2) / max(1, len(curve) - 3)
        found.append(noise / max(own, 1e-12))
    return np.array(found)
