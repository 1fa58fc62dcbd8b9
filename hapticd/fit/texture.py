"""Textures from recorded strokes: peak and mean frequency, and how loud they are over speed and force.

A stroke is cut into blocks of half a second, each with its own periodograms, speed and force. What the sensor hisses is
read off the top of the spectrum and taken away; below TEXTURE_LIMITS.min_frequency_hz, where a hand trembles, the density goes on as it is just
above, and where it sinks into the hiss it goes on falling as it does in the octave before.

The mean frequency is the power's centroid. The peak is that of a parabola in 1/density over the squared frequency
within the half-power band, by Whittle's likelihood: a single resonance has just this shape. Intervals are jackknifed
over groups of blocks, or over strokes where they differ by more than the blocks do by chance. Where the parabola of the
upper quarter of the power has its peak elsewhere, the spectrum is no single resonance, and the interval takes in both.
A peak is resolved where the density is lower on both sides: the spectrum ends below TEXTURE_LIMITS.min_frequency_hz, so that one which is as
high there has its peak anywhere below. Then the interval begins at 0; it ends where the parabola's does, within the
half-power band, or where the highest point lies in 97.5 % of resampled groups (Efron's bootstrap, 1979), if that is
more.

The RMS law is fitted to the blocks' power, of which it is the square, with errors that are a part of it
(quasi-likelihood of a gamma distribution; Wedderburn, 1974).

Autoregressive models, where they are asked for, are of each pair of speed and force: they come from the autocorrelation
of the mean spectrum there (Levinson and Durbin), which makes them stable for any spectrum; the order is that of the
least corrected information criterion of Akaike (Hurvich and Tsai, 1989).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats, Ints, jackknife_error, least_squares
from hapticd.base.lattice import coefficients_of
from hapticd.fit import preparation
from hapticd.fit.limits import PREPARATION_LIMITS, TEXTURE_LIMITS
from hapticd.fit.preparation import Stroke, stroke_of
from hapticd.fit.recording import Recording
from hapticd.fit.result import Fit, fields_of
from hapticd.fit.spectral_lines import report_lines, spectral_lines
from hapticd.fit.verdict import Exclusions, Warnings
from hapticd.rendering.filter_design import power_spectrum, stochastic_filter

# ---- Blocks: strokes in halves of a second ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StrokeBlocks:
    """A recording in blocks."""

    stroke: Stroke
    density: Floats
    """(blocks, frequencies) in (m/s^2)^2/Hz, one-sided, without the sensor's."""
    means: Floats
    """(blocks, 5) of speed, of force, of the square of speed, of their product and of the square of force."""
    floor: float
    """The sensor's density."""
    lost: int
    """Blocks that do not count, as of `_spoilt`."""


def _frequencies(rate_hz: float) -> Floats:
    return np.asarray(np.fft.rfftfreq(round(TEXTURE_LIMITS.block_s * rate_hz / 2), 1 / rate_hz), dtype=np.float64)


def _blocks_of(stroke: Stroke, usual_hz: float, warnings: Warnings) -> StrokeBlocks:
    """A recording in blocks. FitError where its rate is another one, and where it is no texture."""
    from scipy.signal import periodogram

    name, rate_hz = stroke.recording.name, stroke.recording.rate_hz
    if rate_hz != usual_hz:
        raise FitError(
            f"{name}: sampled at {rate_hz:g} Hz, most others at {usual_hz:g} Hz: strokes of one texture need one rate"
        )
    # Three windows of Hann's in each block: at both ends, and half-way over the first.
    block, length = round(TEXTURE_LIMITS.block_s * rate_hz), round(TEXTURE_LIMITS.block_s * rate_hz / 2)
    window = np.hanning(length + 1)[:-1]
    weights = np.zeros(block)
    firsts = (0, length // 2, block - length)
    for first in firsts:
        weights[first : first + length] += window**2
    weights /= weights.sum()
    speed, force = np.abs(stroke.speed), np.maximum(stroke.force, 0.0)
    slowest = TEXTURE_LIMITS.min_block_speed * float(np.median(speed))
    spoilt = _spoilt(stroke, block, warnings)
    found, means = [], []
    for start in range(0, len(speed) - block + 1, block):
        here = slice(start, start + block)
        if start in spoilt or speed[here].min() < slowest or stroke.force[here].mean() <= 0:
            continue
        moved, press = speed[here], force[here]
        pieces = [stroke.acceleration[start + first : start + first + length] for first in firsts]
        found.append(periodogram(pieces, rate_hz, window)[1].mean(axis=0))
        means.append([float(weights @ each) for each in (moved, press, moved**2, moved * press, press**2)])
    if not found:
        raise FitError(f"{name}: holds no half second of one stroke")
    density = np.array(found, dtype=np.float64)
    if length % 2 == 0:
        # scipy has the power of the bin at half the rate once, that of all others twice.
        density[:, -1] *= 2
    frequency = _frequencies(rate_hz)
    density, floor = _without_hiss(name, frequency, density, rate_hz)
    _refuse_motion(name, frequency, density.mean(axis=0))
    just = (frequency >= TEXTURE_LIMITS.min_frequency_hz) & (frequency < 2 * TEXTURE_LIMITS.min_frequency_hz)
    density[:, frequency < TEXTURE_LIMITS.min_frequency_hz] = density[:, just].mean(axis=1)[:, None]
    # A sum over the bins is then the integral from 0 on.
    density[:, 0] /= 2
    return StrokeBlocks(stroke, density, np.array(means), floor, len(spoilt))


def _without_hiss(name: str, frequency: Floats, density: Floats, rate_hz: float) -> tuple[Floats, float]:
    """The density without the sensor's, and the sensor's. FitError where the spectrum does not end below half the
    rate: where between 0.4 and 0.49 of the rate it is more than a twentieth of its highest."""
    hiss = (frequency > 0.4 * rate_hz) & (frequency < 0.49 * rate_hz)
    floor = float(np.mean(density[:, hiss]))
    if floor > TEXTURE_LIMITS.max_floor * float(
        density[:, (frequency >= TEXTURE_LIMITS.min_frequency_hz) & ~hiss].mean(axis=0).max(initial=0.0)
    ):
        raise FitError(
            f"{name}: the spectrum goes on beyond half the rate of {rate_hz:g} Hz, or is the sensor's hiss "
            "alone: record at a higher rate, or with less noise"
        )
    # A texture's own density falls there, by TEXTURE_LIMITS.min_density_fall at least; only what does not is the sensor's.
    nearer = float(np.mean(density[:, (frequency > 0.3 * rate_hz) & (frequency < 0.35 * rate_hz)]))
    floor = min(
        max(0.0, (TEXTURE_LIMITS.min_density_fall * floor - nearer) / (TEXTURE_LIMITS.min_density_fall - 1)), floor
    )
    return density - floor, floor


def _spoilt(stroke: Stroke, block: int, warnings: Warnings) -> set[int]:
    """First samples of the blocks that do not count: more than 2 % was not measured so, or something knocked: 15
    standard deviations of a block, which noise does not reach."""
    seen = stroke.acceleration
    starts = range(0, len(seen) - block + 1, block)
    lost = {start for start in starts if np.mean(stroke.replaced[start : start + block]) > TEXTURE_LIMITS.max_replaced}
    knocks = []
    for start in starts:
        part = np.abs(seen[start : start + block] - np.median(seen[start : start + block]))
        if part.max() > TEXTURE_LIMITS.knock_to_noise * 1.4826 * np.median(part):
            knocks.append(start)
    # Where more than a tenth of the blocks have them, it is a texture of knocks.
    if 0 < len(knocks) <= max(1, TEXTURE_LIMITS.max_knock_blocks * len(starts)):
        at = knocks[0] + int(np.argmax(np.abs(seen[knocks[0] : knocks[0] + block])))
        warnings.note(
            f"{stroke.recording.name}: the acceleration of {seen[at]:.4g} m/s^2 at "
            f"{at / stroke.recording.rate_hz:.6g} s is a knock: {len(knocks) * TEXTURE_LIMITS.block_s:g} s about such are left out"
        )
        lost |= set(knocks)
    return lost


def _refuse_motion(name: str, frequency: Floats, density: Floats) -> None:
    """FitError where most of the power is the hand's, or tones."""
    low, whole = frequency < TEXTURE_LIMITS.min_frequency_hz, frequency >= TEXTURE_LIMITS.min_frequency_hz
    lowest = float(frequency[whole][np.argmax(smoothed(density, 2)[whole])])
    if density[low].sum() > density[whole].sum() and lowest < 2 * TEXTURE_LIMITS.min_frequency_hz:
        raise FitError(
            f"{name}: most of it is below {TEXTURE_LIMITS.min_frequency_hz:g} Hz, and above it falls: a hand that moves, and no texture"
        )
    loudest = np.sort(density[whole])[-3:]
    if loudest.sum() > TEXTURE_LIMITS.max_tone * density[whole].sum():
        raise FitError(
            f"{name}: a tone at {frequency[whole][np.argmax(density[whole])]:.4g} Hz holds most of the power: hum, or "
            "something that rings, and no texture"
        )


def _top_of(frequency: Floats, shape: Floats, floor: float) -> tuple[float, Tail | None]:
    """Where the mean spectrum sinks to 0.3 of what was taken away as the sensor's, and how it goes on from there."""
    smooth = smoothed(shape, max(1, round(25 / frequency[1])))
    peak = int(np.argmax(smooth))
    below = np.flatnonzero(smooth[peak:] < 0.3 * floor)
    if floor <= 0 or len(below) == 0:
        return float(frequency[-1]), None
    top = float(frequency[peak + below[0]])
    last = (frequency > max(top / 2, float(frequency[peak]))) & (frequency <= top) & (smooth > 0)
    if np.count_nonzero(last) < 8:
        return top, None
    fall = -float(np.polyfit(np.log(frequency[last]), np.log(smooth[last]), 1)[0])
    # The power of what falls more slowly has no mean frequency.
    return top, Tail(top, max(fall, 2.5), float(frequency[-1])) if fall > 2 else None


@dataclass(frozen=True, slots=True)
class Tail:
    """Density beyond `top_hz`, up to half the rate: it falls as frequency^-fall, as in the octave before."""

    top_hz: float
    fall: float
    end_hz: float

    def moments(self, frequency: Floats, shape: Floats) -> tuple[float, float]:
        """Its power, and that times its mean frequency, in units of sums over `shape`."""
        last = frequency > self.top_hz / 2
        level = float(shape[last].sum() / np.sum((frequency[last] / self.top_hz) ** -self.fall)) / float(frequency[1])
        ratio = self.end_hz / self.top_hz
        power = self.top_hz * (1 - ratio ** (1 - self.fall)) / (self.fall - 1)
        first = self.top_hz**2 * (1 - ratio ** (2 - self.fall)) / (self.fall - 2)
        return level * power, level * first


@dataclass(frozen=True, slots=True)
class _Blocks:
    """The blocks of all strokes together."""

    strokes: tuple[Stroke, ...]
    stroke: Ints
    """(blocks,) the place of each block's stroke among these."""
    frequency: Floats
    """(frequencies,) up to where the spectra sink into the sensor's hiss; how they go on from there is `tail`."""
    density: Floats
    """(blocks, frequencies)."""
    tail: Tail | None
    means: Floats
    """(blocks, 5), as of StrokeBlocks."""
    rms: Floats
    """(blocks,)."""

    @classmethod
    def of(cls, cut: Sequence[StrokeBlocks], excluded: Exclusions) -> _Blocks:
        """FitError for too few of them, and for an RMS that is no texture's."""
        density = np.concatenate([each.density for each in cut])
        if len(density) < TEXTURE_LIMITS.min_blocks:
            raise excluded.refused(
                f"{len(density) * TEXTURE_LIMITS.block_s:g} s of strokes are too few: at least {TEXTURE_LIMITS.min_blocks * TEXTURE_LIMITS.block_s:g} s are needed"
            )
        strokes = tuple(each.stroke for each in cut)
        stroke = np.repeat(np.arange(len(cut)), [len(each.density) for each in cut])
        frequency = _frequencies(strokes[0].recording.rate_hz)
        power = density.sum(axis=1) * frequency[1]
        rough = (density / power[:, None]).mean(axis=0)
        top, tail = _top_of(frequency, rough, float(np.mean([each.floor for each in cut]) / np.median(power)))
        heard = frequency <= top
        frequency, density = frequency[heard], density[:, heard]
        power = density.sum(axis=1) * frequency[1]
        if power.min() <= 0:
            name = strokes[stroke[int(np.argmin(power))]].recording.name
            raise FitError(f"{name}: what is there is no more than the sensor's hiss")
        rms = np.sqrt(power)
        usual = float(np.median(rms))
        preparation.check_range(
            usual,
            TEXTURE_LIMITS.min_rms_m_per_s2,
            TEXTURE_LIMITS.max_rms_m_per_s2,
            "usual RMS",
        )
        return cls(strokes, stroke, frequency, density, tail, np.concatenate([each.means for each in cut]), rms)

    @property
    def speed(self) -> Floats:
        return np.asarray(self.means[:, 0])

    @property
    def force(self) -> Floats:
        return np.asarray(self.means[:, 1])

    def centroid(self, density: Floats) -> float:
        """Mean frequency of a density (frequencies,), in Hz."""
        beyond, first = (0.0, 0.0) if self.tail is None else self.tail.moments(self.frequency, density)
        return float((self.frequency @ density + first) / (density.sum() + beyond))


# ---- Peak and mean of the spectrum, with their intervals -------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Peak:
    """Of a spectrum."""

    hz: Estimate
    resolved: bool


def peak_of(frequency: Floats, shape: Floats, strokes: Ints) -> Peak:
    """Of densities (blocks, frequencies) of the blocks of these strokes (blocks,)."""

    def parabola(density: Floats) -> float:
        return _parabola_peak(frequency, density)

    def upper(density: Floats) -> float:
        return _parabola_peak(frequency, density, TEXTURE_LIMITS.narrow_top)

    found = jackknifed(parabola, shape, strokes)
    top = jackknifed(upper, shape, strokes)
    if jackknifed(lambda density: parabola(density) - upper(density), shape, strokes).excludes_zero:
        found = Estimate(found.value, min(found.low, top.low), max(found.high, top.high))
    if found.low > 0 and found.high - found.low <= found.value and _falls_below(frequency, shape, found.value):
        return Peak(found, True)
    # An interval may have run away, but nothing with less than half of the highest density is the peak.
    smooth, place = _highest(frequency, shape.mean(axis=0))
    below = np.flatnonzero(smooth[place:] < TEXTURE_LIMITS.wide_top * smooth[place])
    reach = min(found.high, float(frequency[place + below[0]] if len(below) else frequency[-1]))
    return Peak(Estimate(found.value, 0.0, max(_highest_resampled(frequency, shape), reach, found.value)), False)


def jackknifed(figure: Callable[[Floats], float], shape: Floats, strokes: Ints) -> Estimate:
    """A figure of the mean density with its interval: each group of blocks left out in turn, or each stroke where they
    differ by more than chance makes of their blocks with a probability of 0.05."""
    from scipy.special import fdtri

    value = figure(shape.mean(axis=0))
    error, freedom = _left_out(figure, shape, _groups_of(len(shape)))
    by_stroke = [np.flatnonzero(strokes == each) for each in np.unique(strokes)]
    if 3 <= len(by_stroke) <= TEXTURE_LIMITS.jackknife_groups:
        wider, fewer = _left_out(figure, shape, by_stroke)
        if wider > error * math.sqrt(float(fdtri(fewer, freedom, 0.95))):
            error, freedom = wider, fewer
    return Estimate.from_error(value, error, freedom)


def _groups_of(blocks: int) -> list[Ints]:
    """Blocks in a row, by their numbers."""
    edges = np.linspace(0, blocks, min(TEXTURE_LIMITS.jackknife_groups, blocks) + 1).round().astype(np.int64)
    return [np.arange(low, high) for low, high in pairwise(edges)]


def _left_out(figure: Callable[[Floats], float], shape: Floats, groups: Sequence[Ints]) -> tuple[float, int]:
    """Standard error and degrees of freedom; groups of different sizes count alike (Busing, Meijer and van der Leeden,
    1999, have the weights, which change little)."""
    total = shape.sum(axis=0)
    without = np.array([figure((total - shape[each].sum(axis=0)) / (len(shape) - len(each))) for each in groups])
    return float(jackknife_error(without)), len(groups) - 1


def smoothed(values: Floats, half: int) -> Floats:
    """Means over 2 half + 1 of them, along the last axis; at the ends the last one goes on."""
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.convolve(np.pad(values, half, mode="edge"), kernel, mode="valid")


def _highest(frequency: Floats, density: Floats) -> tuple[Floats, int]:
    """The density smoothed, and where it is highest above TEXTURE_LIMITS.min_frequency_hz."""
    smooth = smoothed(density, max(1, round(TEXTURE_LIMITS.smoothing_hz / frequency[1])))
    return smooth, int(np.argmax(np.where(frequency >= TEXTURE_LIMITS.min_frequency_hz, smooth, 0.0)))


def _parabola_peak(frequency: Floats, shape: Floats, part: float = TEXTURE_LIMITS.wide_top) -> float:
    """Of the band in which the density (frequencies,) is more than this part of its highest."""
    smooth, place = _highest(frequency, shape)
    outside = (smooth <= part * smooth[place]) | (frequency < TEXTURE_LIMITS.min_frequency_hz)
    low = int(np.flatnonzero(outside[:place])[-1]) + 1 if outside[:place].any() else 0
    high = place + int(np.argmax(outside[place:])) - 1 if outside[place:].any() else len(smooth) - 1
    band = slice(low, high + 1)
    if high - low < 6:
        return float(frequency[place])
    square = frequency**2
    width = float(square[high] - square[low])
    x = (square[band] - square[place]) / width
    columns = np.stack([np.ones_like(x), x, x**2], axis=1)
    seen = shape[band] / smooth[place]
    found = np.linalg.lstsq(columns * smooth[band, None], np.full(len(x), smooth[place]), rcond=None)[0]
    if (columns @ found).min() <= 0:
        found = np.array([1.0, 0.0, 1.0])

    def unlikely(at: Floats) -> float:
        inverse = columns @ at
        return float(np.sum(seen * inverse - np.log(inverse))) if inverse.min() > 0 else math.inf

    least = unlikely(found)
    for _ in range(50):
        inverse = columns @ found
        slope = columns.T @ (seen - 1 / inverse)
        step = np.linalg.solve((columns / inverse[:, None] ** 2).T @ columns, -slope)
        while unlikely(found + step) > least and np.abs(step).max() > 1e-12:
            step = step / 2
        found = found + step
        reached = unlikely(found)
        if least - reached < 1e-10:
            break
        least = reached
    if found[2] <= 0:
        return float(frequency[place])
    best = math.sqrt(max(0.0, float(square[place] - width * found[1] / (2 * found[2]))))
    return min(max(best, float(frequency[low])), float(frequency[high]))


def _falls_below(frequency: Floats, shape: Floats, peak_hz: float) -> bool:
    """Whether the density near TEXTURE_LIMITS.min_frequency_hz is less than within a fifth of the peak by more than chance."""
    if peak_hz < 1.3 * TEXTURE_LIMITS.min_frequency_hz:
        return False
    low = (frequency >= TEXTURE_LIMITS.min_frequency_hz) & (
        frequency
        <= TEXTURE_LIMITS.min_frequency_hz + max(frequency[1] * 2, (peak_hz - TEXTURE_LIMITS.min_frequency_hz) / 3)
    )
    high = (frequency >= 0.8 * peak_hz) & (frequency <= 1.2 * peak_hz) & ~low
    if not low.any() or not high.any():
        return False

    def fallen(density: Floats) -> float:
        return math.log(max(float(density[high].mean()), 1e-300) / max(float(density[low].mean()), 1e-300))

    return jackknifed(fallen, shape, np.zeros(len(shape), dtype=np.int64)).low > 0


def _highest_resampled(frequency: Floats, shape: Floats) -> float:
    """Where the highest density lies at most, in 97.5 % of 400 resamplings of the groups of blocks."""
    groups = _groups_of(len(shape))
    sums = np.stack([shape[each].sum(axis=0) for each in groups])
    drawn = np.random.default_rng(0).integers(len(groups), size=(400, len(groups)))
    at = [float(frequency[_highest(frequency, sums[each].sum(axis=0))[1]]) for each in drawn]
    return float(np.quantile(at, 0.975))


def spectral_distance_db(frequency: Floats, model: Floats, power: Floats) -> float:
    """RMS difference of two densities (n,) over bands of a twelfth of an octave, as a periodogram itself scatters,
    where the second is within 20 dB of its peak."""
    smooth = smoothed(power, 2)
    loud = (frequency >= TEXTURE_LIMITS.min_frequency_hz) & (smooth > 0.01 * smooth.max())
    band = np.round(12 * np.log2(np.maximum(frequency, 1.0))).astype(int)
    differences = [
        10 * math.log10(float(model[here].mean() / power[here].mean()))
        for each in np.unique(band[loud])
        if np.count_nonzero(here := loud & (band == each))
    ]
    return float(np.sqrt(np.mean(np.square(differences))))


# ---- Loudness over speed and force -----------------------------------------------------------------------------------

Gains: TypeAlias = tuple[Estimate, Estimate] | tuple[None, None]


def _loudness(blocks: _Blocks, autoregressive: bool, warnings: Warnings) -> tuple[Floats, Gains, float]:
    """RMS of each block as its law has it (blocks,), the gains of the law over speed and force, and its correlation;
    where these do not vary apart, the mean of each stroke, if models need no law."""
    if not autoregressive:
        preparation.check_apart(blocks.speed, blocks.force)
    if preparation.vary_apart(blocks.speed, blocks.force):
        return _law(blocks.means[:, 2:], blocks.rms, warnings)
    warnings.note("speed and force vary too little, or together: no gains")
    means = np.array([np.mean(blocks.rms[blocks.stroke == each]) for each in range(len(blocks.strokes))])
    return means[blocks.stroke], (None, None), math.nan


def _law(moments: Floats, rms: Floats, warnings: Warnings) -> tuple[Floats, Gains, float]:
    """As of `_loudness`. The mean power of a block is g' M g, with the gains g and the block's moments M; its
    derivative 2 M g, relative to the power, gives the columns."""
    squares = moments[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    gains = np.linalg.lstsq(np.sqrt(moments[:, [0, 2]]) / rms[:, None], np.ones(len(rms)), rcond=None)[0]
    for _ in range(30):
        pushed = squares @ gains
        power = pushed @ gains
        if power.min() <= 0 or (np.sqrt(moments[:, [0, 2]]) @ gains).min() <= 0:
            raise FitError(
                "the RMS law is negative at some of these strokes: the loudness does not grow in proportion to speed "
                "and force, or a column is swapped"
            )
        fit = least_squares(2 * pushed / power[:, None], rms**2 / power + 1)
        before, gains = gains, np.array([each.value for each in fit.coefficients])
        if np.abs(gains - before).max() < 1e-9 * np.abs(gains).max():
            break
    velocity_gain, force_gain = fit.coefficients
    law = np.sqrt(np.einsum("i,kij,j->k", gains, squares, gains))
    for name, gain, square in (("velocity", velocity_gain, moments[:, 0]), ("force", force_gain, moments[:, 2])):
        if gain.high < 0:
            warnings.add_fair(f"the {name} gain is negative: {gain.low:.3g} to {gain.high:.3g}")
        else:
            warnings.check_gain(name, gain, float(np.sqrt(np.median(square))), float(np.median(rms)))
    if max(velocity_gain.value, force_gain.value) <= 0:
        raise FitError("neither speed nor force makes it louder: is a column swapped?")
    correlation = float(np.corrcoef(law, rms)[0, 1]) if np.ptp(law) > 0 and np.ptp(rms) > 0 else math.nan
    warnings.check("distance from the law", float(np.std(np.log(rms / law))))
    warnings.check("correlation of the law", correlation, what="loudness")
    return law, (velocity_gain, force_gain), correlation


# ---- Autoregressive models -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ArModel:
    """At one speed and force: the model, and how far its spectrum is from the recorded one."""

    speed_m_per_s: float
    force_n: float
    coefficients: tuple[float, ...]
    rms_m_per_s2: float
    rms_error_db: float
    """As of `spectral_distance_db`."""


def _model_rate(frequency: Floats, shape: Floats, rate_hz: float) -> float:
    """A whole number of hertz, at most the recording's rate, 0.4 of which holds 0.995 of the power."""
    below = np.cumsum(np.maximum(shape, 0.0))
    top = float(frequency[min(int(np.searchsorted(below, TEXTURE_LIMITS.model_power * below[-1])), len(frequency) - 1)])
    return min(rate_hz, 2 * float(frequency[-1]), float(math.ceil(max(top / 0.4, 100.0))))


def _models_of(blocks: _Blocks, rate_hz: float) -> tuple[ArModel, ...]:
    """Of the blocks whose speeds and forces differ by less than a tenth. FitError where there are none of 2 s."""
    columns = (blocks.speed, blocks.force)
    places: list[list[int]] = []
    for stroke in range(len(blocks.strokes)):
        # A recording whole where speed and force keep near their means, otherwise block by block.
        here = np.flatnonzero(blocks.stroke == stroke)
        steady = max(float(np.ptp(values[here]) / np.mean(values[here])) for values in columns) < 0.5
        for part in [here.tolist()] if steady else [[member] for member in here.tolist()]:
            for place in places:
                if all(
                    abs(np.mean(values[part]) / np.mean(values[place]) - 1) < TEXTURE_LIMITS.max_model_difference
                    for values in columns
                ):
                    place += part
                    break
            else:
                places.append(part)
    kept = [place for place in places if len(place) >= TEXTURE_LIMITS.min_model_blocks]
    if not kept:
        raise FitError("no speed and force was held for 2 s: autoregressive models need steady strokes")
    return tuple(_model(blocks, place, rate_hz) for place in kept)


def _model(blocks: _Blocks, place: list[int], rate_hz: float) -> ArModel:
    from scipy.linalg import solve_toeplitz

    density = blocks.density[place].mean(axis=0)
    below = blocks.frequency <= rate_hz / 2
    frequency, power = blocks.frequency[below], np.maximum(density[below], 1e-6 * density.max())
    weights = np.full(len(frequency), frequency[1])
    weights[-1] /= 2
    lags = np.arange(TEXTURE_LIMITS.max_order + 1)
    correlation = np.cos(2 * math.pi * np.outer(lags, frequency) / rate_hz) @ (power * weights)
    # Of every order the last coefficient is the reflection, in the convention of hapticd.rendering.filter_design.
    stages = [-float(solve_toeplitz(correlation[:m], correlation[1 : m + 1])[-1]) for m in lags[1:]]
    errors = np.cumprod(1 - np.square(stages))
    count = len(place) * TEXTURE_LIMITS.block_s * rate_hz
    criteria = [count * math.log(errors[p - 1]) + 2 * (p + 1) * count / (count - p - 2) for p in lags[1:]]
    reflection = stages[: 1 + int(np.argmin(criteria))]
    model = float(correlation[0]) * power_spectrum((reflection, None), frequency, rate_hz)
    return ArModel(
        float(blocks.speed[place].mean()),
        float(blocks.force[place].mean()),
        coefficients_of(reflection),
        math.sqrt(float(correlation[0])),
        spectral_distance_db(frequency, model, power),
    )


# ---- The fit, and its verdict ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Block:
    """Half a second of a stroke: means of speed and force, RMS and centroid of the acceleration."""

    recording: str
    speed_m_per_s: float
    force_n: float
    rms_m_per_s2: float
    mean_hz: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureFit(Fit):
    """What strokes over one texture say. All intervals are of 95 %."""

    peak_hz: Estimate
    peak_resolved: bool
    """Otherwise the interval begins at 0, and the peak is a guess."""
    mean_hz: Estimate
    velocity_gain_per_s: Estimate | None
    """None, as the next: speed and force do not vary apart from one another, as `warnings` say."""
    force_gain_m_per_s2_per_n: Estimate | None
    correlation: float
    mean_per_speed_hz_s_per_m: Estimate | None
    mean_per_force_hz_per_n: Estimate | None
    ar_rate_hz: float | None
    ar_models: tuple[ArModel, ...]
    """Empty unless they were asked for."""
    blocks: tuple[Block, ...]

    def material(self) -> dict[str, object]:
        """The keys of a material: its texture. Stiffness is not measured by strokes."""
        if self.ar_models:
            names = ("speed_m_per_s", "force_n", "coefficients", "rms_m_per_s2")
            models = [fields_of(model, *names) for model in self.ar_models]
            return {"texture": {"kind": "autoregressive", "rate_hz": self.ar_rate_hz, "models": models}}
        assert self.velocity_gain_per_s is not None
        assert self.force_gain_m_per_s2_per_n is not None
        return {
            "texture": {
                "kind": "stochastic",
                "peak_hz": self.peak_hz.value,
                "mean_hz": self.mean_hz.value,
                "velocity_gain_per_s": self.velocity_gain_per_s.value,
                "force_gain_m_per_s2_per_n": self.force_gain_m_per_s2_per_n.value,
            }
        }


def fit_texture(
    recordings: Sequence[Recording], autoregressive: bool = False, excluded: Exclusions | None = None
) -> TextureFit:
    """Of strokes at several speeds and forces. FitError where they do not say it.

    Recordings, and stretches of them, that cannot be used are reported in `excluded`.
    """
    excluded = Exclusions() if excluded is None else excluded
    preparation.refuse_duplicates(recordings)
    rates = [recording.rate_hz for recording in recordings]
    if not rates:
        raise FitError("no recordings")
    usual_hz = max(rates, key=rates.count)
    stretches = preparation.stretches_of(recordings, TEXTURE_LIMITS.block_s, excluded)
    while True:
        try:
            return _fitted(stretches, usual_hz, autoregressive, excluded)
        except _TwoTextures as two:
            excluded.add(two.name, str(two))
            gone = {each.recording for each in excluded.items}
            stretches = [recording for recording in stretches if recording.name not in gone]


def _fitted(stretches: Sequence[Recording], rate_hz: float, autoregressive: bool, excluded: Exclusions) -> TextureFit:
    """Of stretches of strokes. _TwoTextures where one of them is of more than one."""
    warnings = Warnings()
    blocks = _Blocks.of(_cut(stretches, rate_hz, excluded, warnings), excluded)
    recordings = [each.recording for each in blocks.strokes]
    preparation.report_gravity(recordings, warnings)
    report_lines(blocks.strokes, lambda each, needed: spectral_lines(each.acceleration, rate_hz, needed), warnings)
    preparation.check_force_varies(recordings, blocks.force, warnings)
    law, (velocity_gain, force_gain), correlation = _loudness(blocks, autoregressive, warnings)
    # Not by each block's own power, which goes with its peak.
    shape = blocks.density / (law**2)[:, None]
    centroid = np.array([blocks.centroid(each) for each in shape])
    peak = peak_of(blocks.frequency, shape, blocks.stroke)
    mean = jackknifed(blocks.centroid, shape, blocks.stroke)
    if rate_hz < PREPARATION_LIMITS.min_samples_per_cycle * mean.value:
        raise FitError(f"the mean frequency is {mean.value:.4g} Hz, sampled at {rate_hz:g} Hz: the rate is too low")
    for place, recording in enumerate(recordings):
        here = blocks.stroke == place
        _refuse_two(recording.name, np.log(np.maximum(centroid[here], 1.0)), np.log(blocks.rms[here] / law[here]))
    # So seldom by chance that a good fit is not called fair for it.
    by_speed, by_force = preparation.moved_with(
        blocks.speed,
        blocks.force,
        centroid,
        "mean frequency",
        TEXTURE_LIMITS.min_frequency_change,
        TEXTURE_LIMITS.change_confidence,
        warnings,
    )
    ar_rate: float | None = None
    models: tuple[ArModel, ...] = ()
    if autoregressive:
        ar_rate = _model_rate(blocks.frequency, shape.mean(axis=0), rate_hz)
        models = _models_of(blocks, ar_rate)
    _check_peak(peak, autoregressive, warnings)
    warnings.check_interval("mean frequency", mean)
    if peak.resolved and not autoregressive:
        # The spectrum of the material knows peak and mean alone.
        power = shape.mean(axis=0) / (shape.mean(axis=0).sum() * blocks.frequency[1])
        model = power_spectrum(stochastic_filter(peak.hz.value, mean.value, rate_hz), blocks.frequency, rate_hz)
        apart = spectral_distance_db(blocks.frequency, model, np.maximum(power, 1e-6 * power.max()))
        warnings.check("decibels between the spectra", apart)
    found = f"peak at {peak.hz.value:.4g} Hz" if peak.resolved else f"peak below {peak.hz.high:.3g} Hz"
    names = [recordings[place].name for place in blocks.stroke]
    figures = zip(blocks.speed, blocks.force, blocks.rms, centroid, strict=True)
    return TextureFit(
        peak_hz=peak.hz,
        peak_resolved=peak.resolved,
        mean_hz=mean,
        velocity_gain_per_s=velocity_gain,
        force_gain_m_per_s2_per_n=force_gain,
        correlation=correlation,
        mean_per_speed_hz_s_per_m=by_speed,
        mean_per_force_hz_per_n=by_force,
        ar_rate_hz=ar_rate,
        ar_models=models,
        blocks=tuple(Block(name, *map(float, each)) for name, each in zip(names, figures, strict=True)),
        warnings=tuple(warnings.lines),
        judged=warnings.verdict(
            f"{len(centroid) * TEXTURE_LIMITS.block_s:g} s of noise with its {found} and its mean at {mean.value:.4g} Hz"
            + (f", {len(models)} autoregressive models" if models else "")
        ),
        left_out=tuple(excluded.items),
    )


def _cut(
    stretches: Sequence[Recording], rate_hz: float, excluded: Exclusions, warnings: Warnings
) -> list[StrokeBlocks]:
    """Every stretch in blocks. FitError where none can be used."""
    found = excluded.each(stretches, lambda each: _blocks_of(stroke_of(each, "texture"), rate_hz, warnings))
    if not found:
        raise excluded.refused("none of the recordings can be used")
    preparation.report_cleaning([each.stroke for each in found], warnings)
    excluded.report([each.stroke.recording for each in found], warnings)
    dropped = sum(each.lost for each in found)
    lost = dropped / (dropped + sum(len(each.density) for each in found))
    warnings.check("part left out", lost, left=f"{100 * lost:.0f} % of the strokes are left out")
    return found


class _TwoTextures(FitError):
    """A recording is of more than one texture, or of none."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name


def _refuse_two(name: str, pitch: Floats, loudness: Floats) -> None:
    """_TwoTextures where a recording changes its pitch or loudness at once, by much."""
    count = len(pitch)
    if count > 3 and float(np.std(pitch)) > TEXTURE_LIMITS.max_pitch_scatter:
        raise _TwoTextures(
            name,
            f"two textures in one file, or none: the mean frequency goes from {math.exp(pitch.min()):.3g} to "
            f"{math.exp(pitch.max()):.3g} Hz within it",
        )
    for k in range(3, count - 2):
        # Steps in the logarithms that are two textures, where they are six standard errors.
        for values, apart, what in (
            (pitch, TEXTURE_LIMITS.min_pitch_step, "mean frequency"),
            (loudness, TEXTURE_LIMITS.min_loudness_step, "loudness"),
        ):
            one, other = values[:k], values[k:]
            step = float(other.mean() - one.mean())
            within = math.sqrt((k * float(np.var(one)) + (count - k) * float(np.var(other))) / (count - 2))
            if abs(step) > apart and abs(step) > TEXTURE_LIMITS.step_to_error * within * math.sqrt(
                1 / k + 1 / (count - k)
            ):
                raise _TwoTextures(
                    name,
                    f"two textures in one file: the {what} changes {math.exp(step):.2f}-fold at about "
                    f"{k * TEXTURE_LIMITS.block_s:g} s; give each its own file",
                )


def _check_peak(peak: Peak, autoregressive: bool, warnings: Warnings) -> None:
    """Whether there is one; autoregressive models have the spectrum as it is."""
    if not peak.resolved:
        tell = warnings.note if autoregressive else warnings.add_fair
        tell(
            f"the peak is not resolved: the spectrum is broad, or highest below {TEXTURE_LIMITS.min_frequency_hz:g} Hz; it lies between 0 and "
            f"{peak.hz.high:.3g} Hz, and {peak.hz.value:.3g} Hz is a guess (--ar needs no peak)"
        )
    elif not autoregressive:
        warnings.check_interval("peak frequency", peak.hz)
