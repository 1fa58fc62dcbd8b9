"""Fit of textures to recorded strokes: peak and mean frequency, and loudness as a function of speed and force.

Strokes are cut into blocks of half a second, each with its periodograms, speed and force. The density (power spectral
density) of the sensor's noise is measured near half the rate and subtracted. Below TEXTURE_LIMITS.min_frequency_hz,
where a hand trembles, the density is assumed to be that just above. Where the density falls below the sensor's noise,
it is assumed to fall as in the octave before.

The mean frequency is the centroid of the power. The peak is that of a single resonance: a parabola is fitted to
1/density versus squared frequency in the half-power band, by Whittle's likelihood. Intervals are jackknifed over groups
of blocks, or over strokes if strokes differ more than their blocks do by chance. If a parabola fitted above three
quarters of the highest density has another peak, the spectrum is not a single resonance, and the interval includes
both peaks.

A peak is resolved if the density is lower on both sides. If the density at TEXTURE_LIMITS.min_frequency_hz is as high,
the peak may be anywhere below, and has no value. It is then below the larger of two frequencies: the end of the
parabola's interval, limited to the half-power band, and the 97.5 % quantile of the frequency of the highest density
over bootstrap samples of the groups (Efron, 1979). Noise with a peak and a mean cannot have such a spectrum, so the
material gets autoregressive models.

The law of the RMS is fitted to the power of the blocks, with errors proportional to the power (quasi-likelihood of a
gamma distribution; Wedderburn, 1974).

On request, or without a peak, an autoregressive model is made for each pair of speed and force, from the
autocorrelation of the mean spectrum (Levinson and Durbin); such a model is stable for any spectrum. The order of the
model has the lowest corrected information criterion of Akaike (Hurvich and Tsai, 1989).
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

# ---- Blocks: strokes cut into half seconds ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StrokeBlocks:
    """A recording cut into blocks of half a second."""

    stroke: Stroke
    density: Floats
    """(blocks, frequencies) one-sided density without that of the sensor's noise, (m/s^2)^2/Hz."""
    means: Floats
    """(blocks, 5) means of speed, force, squared speed, speed times force, and squared force."""
    floor: float
    """Density of the sensor's noise, (m/s^2)^2/Hz."""
    lost: int
    """Number of blocks left out because of replaced samples or knocks."""


def _frequencies(rate_hz: float) -> Floats:
    return np.asarray(np.fft.rfftfreq(round(TEXTURE_LIMITS.block_s * rate_hz / 2), 1 / rate_hz), dtype=np.float64)


def _blocks_of(stroke: Stroke, usual_hz: float, warnings: Warnings) -> StrokeBlocks:
    """Return a stroke cut into blocks. Raises FitError if its rate is not `usual_hz`, or if no texture was stroked."""
    from scipy.signal import periodogram

    name, rate_hz = stroke.recording.name, stroke.recording.rate_hz
    if rate_hz != usual_hz:
        raise FitError(
            f"{name}: sampled at {rate_hz:g} Hz, most others at {usual_hz:g} Hz: strokes of one texture need one rate"
        )
    # Three Hann windows in each block: at both ends, and shifted by half a window from the first.
    block, length = round(TEXTURE_LIMITS.block_s * rate_hz), round(TEXTURE_LIMITS.block_s * rate_hz / 2)
    window = np.hanning(length + 1)[:-1]
    weights = np.zeros(block)
    firsts = (0, length // 2, block - length)
    for first in firsts:
        weights[first : first + length] += window**2
    weights /= weights.sum()
    speed, force = np.abs(stroke.speed), np.maximum(stroke.force, 0.0)
    slowest = TEXTURE_LIMITS.min_block_speed * float(np.median(speed))
    unusable = _unusable_blocks(stroke, block, warnings)
    found, means = [], []
    for start in range(0, len(speed) - block + 1, block):
        here = slice(start, start + block)
        if start in unusable or speed[here].min() < slowest or stroke.force[here].mean() <= 0:
            continue
        moved, press = speed[here], force[here]
        pieces = [stroke.acceleration[start + first : start + first + length] for first in firsts]
        found.append(periodogram(pieces, rate_hz, window)[1].mean(axis=0))
        means.append([float(weights @ each) for each in (moved, press, moved**2, moved * press, press**2)])
    if not found:
        raise FitError(f"{name}: no complete half second of a stroke")
    density = np.array(found, dtype=np.float64)
    if length % 2 == 0:
        # scipy counts the bin at half the rate once, all others twice.
        density[:, -1] *= 2
    frequency = _frequencies(rate_hz)
    density, floor = _without_sensor_noise(name, frequency, density, rate_hz)
    _refuse_motion(name, frequency, density.mean(axis=0))
    just = (frequency >= TEXTURE_LIMITS.min_frequency_hz) & (frequency < 2 * TEXTURE_LIMITS.min_frequency_hz)
    density[:, frequency < TEXTURE_LIMITS.min_frequency_hz] = density[:, just].mean(axis=1)[:, None]
    # With half of the first bin, a sum over the bins is the integral from 0.
    density[:, 0] /= 2
    return StrokeBlocks(stroke, density, np.array(means), floor, len(unusable))


def _without_sensor_noise(name: str, frequency: Floats, density: Floats, rate_hz: float) -> tuple[Floats, float]:
    """Return the power spectral densities minus that of the sensor's noise, and the density of the noise.

    Raises FitError if the spectrum does not end below half the rate: if the mean density between 0.4 and 0.49 of the
    rate is more than a twentieth of the highest density.
    """
    noise_band = (frequency > 0.4 * rate_hz) & (frequency < 0.49 * rate_hz)
    floor = float(np.mean(density[:, noise_band]))
    signal_band = (frequency >= TEXTURE_LIMITS.min_frequency_hz) & ~noise_band
    if floor > TEXTURE_LIMITS.max_floor * float(density[:, signal_band].mean(axis=0).max(initial=0.0)):
        raise FitError(
            f"{name}: the spectrum does not end below half the rate of {rate_hz:g} Hz, or it is the sensor's noise "
            "alone: record at a higher rate, or with less noise"
        )
    # The density of a texture falls there by at least min_density_fall; the part that does not fall is the sensor's.
    nearer = float(np.mean(density[:, (frequency > 0.3 * rate_hz) & (frequency < 0.35 * rate_hz)]))
    fall = TEXTURE_LIMITS.min_density_fall
    floor = min(max(0.0, (fall * floor - nearer) / (fall - 1)), floor)
    return density - floor, floor


def _unusable_blocks(stroke: Stroke, block: int, warnings: Warnings) -> set[int]:
    """Return the first sample of each block to leave out: a block with more than 2 % replaced samples, or a knock.

    A knock exceeds 15 standard deviations of its block, which noise does not reach.
    """
    seen = stroke.acceleration
    starts = range(0, len(seen) - block + 1, block)
    lost = {start for start in starts if np.mean(stroke.replaced[start : start + block]) > TEXTURE_LIMITS.max_replaced}
    knocks = []
    for start in starts:
        part = np.abs(seen[start : start + block] - np.median(seen[start : start + block]))
        if part.max() > TEXTURE_LIMITS.knock_to_noise * 1.4826 * np.median(part):
            knocks.append(start)
    # If more than a tenth of the blocks have knocks, they belong to the texture.
    if 0 < len(knocks) <= max(1, TEXTURE_LIMITS.max_knock_blocks * len(starts)):
        at = knocks[0] + int(np.argmax(np.abs(seen[knocks[0] : knocks[0] + block])))
        warnings.note(
            f"{stroke.recording.name}: the acceleration of {seen[at]:.4g} m/s^2 at "
            f"{at / stroke.recording.rate_hz:.6g} s is a knock: {len(knocks) * TEXTURE_LIMITS.block_s:g} s with knocks "
            "are left out"
        )
        lost |= set(knocks)
    return lost


def _refuse_motion(name: str, frequency: Floats, density: Floats) -> None:
    """Raise FitError if most of the power is motion of the hand, or in tones; `density` is (frequencies,)."""
    below, above = frequency < TEXTURE_LIMITS.min_frequency_hz, frequency >= TEXTURE_LIMITS.min_frequency_hz
    loudest_hz = float(frequency[above][np.argmax(smoothed(density, 2)[above])])
    if density[below].sum() > density[above].sum() and loudest_hz < 2 * TEXTURE_LIMITS.min_frequency_hz:
        raise FitError(
            f"{name}: most of the power is below {TEXTURE_LIMITS.min_frequency_hz:g} Hz, and the spectrum falls above: "
            "motion of a hand, not a texture"
        )
    loudest = np.sort(density[above])[-3:]
    if loudest.sum() > TEXTURE_LIMITS.max_tone_power * density[above].sum():
        raise FitError(
            f"{name}: a tone at {frequency[above][np.argmax(density[above])]:.4g} Hz holds most of the power: hum or a "
            "ringing, not a texture"
        )


def _top_of(frequency: Floats, shape: Floats, floor: float) -> tuple[float, Tail | None]:
    """Return the frequency, Hz, at which the spectrum falls to 0.3 of the sensor's noise, and an extrapolation above.

    `shape` (frequencies,) is the mean density of blocks with a power of 1, and `floor` the noise on the same scale.
    """
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
    # A slower fall has no finite mean frequency.
    return top, Tail(top, max(fall, 2.5), float(frequency[-1])) if fall > 2 else None


@dataclass(frozen=True, slots=True)
class Tail:
    """Density extrapolated from `top_hz` to `end_hz`: proportional to frequency^-fall, as in the octave below."""

    top_hz: float
    fall: float
    end_hz: float

    def moments(self, frequency: Floats, shape: Floats) -> tuple[float, float]:
        """Return the power of the tail, and this power times the mean frequency, both divided by a bin's width.

        `shape` is the density at `frequency` (n,), which ends at `top_hz`.
        """
        last = frequency > self.top_hz / 2
        level = float(shape[last].sum() / np.sum((frequency[last] / self.top_hz) ** -self.fall)) / float(frequency[1])
        ratio = self.end_hz / self.top_hz
        power = self.top_hz * (1 - ratio ** (1 - self.fall)) / (self.fall - 1)
        first = self.top_hz**2 * (1 - ratio ** (2 - self.fall)) / (self.fall - 2)
        return level * power, level * first


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Blocks of half a second of all strokes."""

    strokes: tuple[Stroke, ...]
    stroke: Ints
    """(blocks,) index in `strokes` of each block's stroke."""
    frequency: Floats
    """(frequencies,) Hz, up to where the spectra fall below the sensor's noise; `tail` continues them."""
    density: Floats
    """(blocks, frequencies) in (m/s^2)^2/Hz."""
    tail: Tail | None
    means: Floats
    """(blocks, 5) as in StrokeBlocks."""
    rms: Floats
    """(blocks,) m/s^2."""

    @classmethod
    def of(cls, cut: Sequence[StrokeBlocks], excluded: Exclusions) -> _Blocks:
        """Return the blocks of all strokes; raise FitError if the blocks are too few or their RMS is out of range."""
        density = np.concatenate([each.density for each in cut])
        if len(density) < TEXTURE_LIMITS.min_blocks:
            raise excluded.refused(
                f"{len(density) * TEXTURE_LIMITS.block_s:g} s of strokes are too few: at least "
                f"{TEXTURE_LIMITS.min_blocks * TEXTURE_LIMITS.block_s:g} s are needed"
            )
        strokes = tuple(each.stroke for each in cut)
        stroke = np.repeat(np.arange(len(cut)), [len(each.density) for each in cut])
        frequency = _frequencies(strokes[0].recording.rate_hz)
        power = density.sum(axis=1) * frequency[1]
        rough = (density / power[:, None]).mean(axis=0)
        top, tail = _top_of(frequency, rough, float(np.mean([each.floor for each in cut]) / np.median(power)))
        kept = frequency <= top
        frequency, density = frequency[kept], density[:, kept]
        power = density.sum(axis=1) * frequency[1]
        if power.min() <= 0:
            name = strokes[stroke[int(np.argmin(power))]].recording.name
            raise FitError(f"{name}: a block is not louder than the sensor's noise")
        rms = np.sqrt(power)
        low, high = TEXTURE_LIMITS.min_rms_m_per_s2, TEXTURE_LIMITS.max_rms_m_per_s2
        preparation.check_range(float(np.median(rms)), low, high, "median RMS")
        return cls(strokes, stroke, frequency, density, tail, np.concatenate([each.means for each in cut]), rms)

    @property
    def speed(self) -> Floats:
        """(blocks,) mean speed of each block, m/s."""
        return np.asarray(self.means[:, 0])

    @property
    def force(self) -> Floats:
        """(blocks,) mean force of each block, N."""
        return np.asarray(self.means[:, 1])

    def centroid(self, density: Floats) -> float:
        """Return the mean frequency, Hz, of a density (frequencies,)."""
        beyond, first = (0.0, 0.0) if self.tail is None else self.tail.moments(self.frequency, density)
        return float((self.frequency @ density + first) / (density.sum() + beyond))


# ---- Peak and mean of the spectrum, with their intervals -------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Peak:
    """Peak frequency of a spectrum."""

    hz: Estimate | None
    """The peak; None if it is not resolved."""
    below_hz: float
    """Upper end of the interval, 95 %."""


def peak_of(frequency: Floats, shape: Floats, strokes: Ints) -> Peak:
    """Return the peak of the mean of densities (blocks, frequencies); `strokes` (blocks,) are the blocks' strokes."""

    def parabola(density: Floats) -> float:
        return _parabola_peak(frequency, density)

    def upper(density: Floats) -> float:
        return _parabola_peak(frequency, density, TEXTURE_LIMITS.narrow_peak_level)

    found = jackknifed(parabola, shape, strokes)
    top = jackknifed(upper, shape, strokes)
    if jackknifed(lambda density: parabola(density) - upper(density), shape, strokes).excludes_zero:
        found = Estimate(found.value, min(found.low, top.low), max(found.high, top.high))
    if found.low > 0 and found.high - found.low <= found.value and _falls_below(frequency, shape, found.value):
        return Peak(found, found.high)
    # The interval may be far too wide: it is limited to where the density is above half of its highest value.
    smooth, place = _highest(frequency, shape.mean(axis=0))
    below = np.flatnonzero(smooth[place:] < TEXTURE_LIMITS.peak_level * smooth[place])
    reach = min(found.high, float(frequency[place + below[0]] if len(below) else frequency[-1]))
    return Peak(None, max(_highest_resampled(frequency, shape), reach, found.value))


def jackknifed(figure: Callable[[Floats], float], shape: Floats, strokes: Ints) -> Estimate:
    """Return the value of `figure`, a function of the mean density (frequencies,), with its jackknife interval.

    `shape` (blocks, frequencies) are the densities. Groups of blocks are left out in turn, or strokes if strokes differ
    significantly more than their blocks do (5 % level).
    """
    from scipy.special import fdtri

    value = figure(shape.mean(axis=0))
    error, freedom = _left_out(figure, shape, _groups_of(len(shape)))
    by_stroke = [np.flatnonzero(strokes == each) for each in np.unique(strokes)]
    if 3 <= len(by_stroke) <= TEXTURE_LIMITS.max_jackknife_groups:
        wider, fewer = _left_out(figure, shape, by_stroke)
        if wider > error * math.sqrt(float(fdtri(fewer, freedom, 0.95))):
            error, freedom = wider, fewer
    return Estimate.from_error(value, error, freedom)


def _groups_of(blocks: int) -> list[Ints]:
    """Return at most 20 groups of consecutive blocks, each as the indices of its blocks."""
    edges = np.linspace(0, blocks, min(TEXTURE_LIMITS.max_jackknife_groups, blocks) + 1).round().astype(np.int64)
    return [np.arange(low, high) for low, high in pairwise(edges)]


def _left_out(figure: Callable[[Floats], float], shape: Floats, groups: Sequence[Ints]) -> tuple[float, int]:
    """Return jackknife standard error and degrees of freedom of `figure`; each group of blocks is left out in turn.

    Groups of different sizes have equal weights; the weights of Busing et al. (1999) would change little.
    """
    total = shape.sum(axis=0)
    without = np.array([figure((total - shape[each].sum(axis=0)) / (len(shape) - len(each))) for each in groups])
    return float(jackknife_error(without)), len(groups) - 1


def smoothed(values: Floats, half: int) -> Floats:
    """Return the mean of 2 half + 1 values about each value (n,); the first and last value continue beyond the ends."""
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.convolve(np.pad(values, half, mode="edge"), kernel, mode="valid")


def _highest(frequency: Floats, density: Floats) -> tuple[Floats, int]:
    """Return the smoothed density (n,), and the index of the highest one above TEXTURE_LIMITS.min_frequency_hz."""
    smooth = smoothed(density, max(1, round(TEXTURE_LIMITS.smoothing_hz / frequency[1])))
    return smooth, int(np.argmax(np.where(frequency >= TEXTURE_LIMITS.min_frequency_hz, smooth, 0.0)))


def _parabola_peak(frequency: Floats, shape: Floats, fraction: float = TEXTURE_LIMITS.peak_level) -> float:
    """Return the peak, Hz, of a parabola fitted to 1/density where the density exceeds a `fraction` of the highest."""
    smooth, place = _highest(frequency, shape)
    outside = (smooth <= fraction * smooth[place]) | (frequency < TEXTURE_LIMITS.min_frequency_hz)
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

    lowest = unlikely(found)
    for _ in range(50):
        inverse = columns @ found
        slope = columns.T @ (seen - 1 / inverse)
        step = np.linalg.solve((columns / inverse[:, None] ** 2).T @ columns, -slope)
        while unlikely(found + step) > lowest and np.abs(step).max() > 1e-12:
            step = step / 2
        found = found + step
        reached = unlikely(found)
        if lowest - reached < 1e-10:
            break
        lowest = reached
    if found[2] <= 0:
        return float(frequency[place])
    best = math.sqrt(max(0.0, float(square[place] - width * found[1] / (2 * found[2]))))
    return min(max(best, float(frequency[low])), float(frequency[high]))


def _falls_below(frequency: Floats, shape: Floats, peak_hz: float) -> bool:
    """Return whether the density near min_frequency_hz is significantly lower than within 20 % of the peak."""
    min_hz = TEXTURE_LIMITS.min_frequency_hz
    if peak_hz < 1.3 * min_hz:
        return False
    low = (frequency >= min_hz) & (frequency <= min_hz + max(frequency[1] * 2, (peak_hz - min_hz) / 3))
    high = (frequency >= 0.8 * peak_hz) & (frequency <= 1.2 * peak_hz) & ~low
    if not low.any() or not high.any():
        return False

    def fallen(density: Floats) -> float:
        return math.log(max(float(density[high].mean()), 1e-300) / max(float(density[low].mean()), 1e-300))

    return jackknifed(fallen, shape, np.zeros(len(shape), dtype=np.int64)).low > 0


def _highest_resampled(frequency: Floats, shape: Floats) -> float:
    """Return the 97.5 % quantile of the frequency of the highest density, over 400 bootstrap samples of the groups."""
    groups = _groups_of(len(shape))
    sums = np.stack([shape[each].sum(axis=0) for each in groups])
    drawn = np.random.default_rng(0).integers(len(groups), size=(400, len(groups)))
    at = [float(frequency[_highest(frequency, sums[each].sum(axis=0))[1]]) for each in drawn]
    return float(np.quantile(at, 0.975))


def spectral_distance_db(frequency: Floats, model: Floats, power: Floats) -> float:
    """Return the RMS difference, dB, of two densities (n,) where `power`, the second, is within 20 dB of its peak.

    The densities are compared in bands of a twelfth of an octave, because a periodogram scatters.
    """
    smooth = smoothed(power, 2)
    loud = (frequency >= TEXTURE_LIMITS.min_frequency_hz) & (smooth > 0.01 * smooth.max())
    band = np.round(12 * np.log2(np.maximum(frequency, 1.0))).astype(int)
    differences = [
        10 * math.log10(float(model[here].mean() / power[here].mean()))
        for each in np.unique(band[loud])
        if np.count_nonzero(here := loud & (band == each))
    ]
    return float(np.sqrt(np.mean(np.square(differences))))


# ---- Loudness versus speed and force ---------------------------------------------------------------------------------

Gains: TypeAlias = tuple[Estimate, Estimate] | tuple[None, None]


def _loudness(blocks: _Blocks, autoregressive: bool, warnings: Warnings) -> tuple[Floats, Gains, float]:
    """Return the RMS (blocks,) predicted by the law of speed and force, the law's gains, and its correlation.

    If speed and force do not vary independently, autoregressive models use the mean RMS of each stroke, without gains.
    Raises FitError if a texture without such models has no law.
    """
    if not autoregressive:
        preparation.check_independent(blocks.speed, blocks.force)
    if preparation.vary_independently(blocks.speed, blocks.force):
        return _law(blocks.means[:, 2:], blocks.rms, warnings)
    warnings.note("speed and force vary too little, or together: no gains")
    means = np.array([np.mean(blocks.rms[blocks.stroke == each]) for each in range(len(blocks.strokes))])
    return means[blocks.stroke], (None, None), math.nan


def _law(moments: Floats, rms: Floats, warnings: Warnings) -> tuple[Floats, Gains, float]:
    """Fit RMS versus speed and force by quasi-likelihood; return predicted RMS (blocks,), gains and correlation.

    The mean power of a block is g' M g, with the gains g and the block's `moments` M: means of squared speed, speed
    times force, and squared force. The row of a block in the least squares is 2 M g divided by this power.
    """
    squares = moments[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    gains = np.linalg.lstsq(np.sqrt(moments[:, [0, 2]]) / rms[:, None], np.ones(len(rms)), rcond=None)[0]
    for _ in range(30):
        pushed = squares @ gains
        power = pushed @ gains
        if power.min() <= 0 or (np.sqrt(moments[:, [0, 2]]) @ gains).min() <= 0:
            raise FitError(
                "the RMS law is negative for some strokes: the loudness does not grow with speed and force, or a "
                "column is swapped"
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
        raise FitError("the loudness grows neither with speed nor with force: is a column swapped?")
    correlation = float(np.corrcoef(law, rms)[0, 1]) if np.ptp(law) > 0 and np.ptp(rms) > 0 else math.nan
    warnings.check("distance from the law", float(np.std(np.log(rms / law))))
    warnings.check("correlation of the law", correlation, what="loudness")
    return law, (velocity_gain, force_gain), correlation


# ---- Autoregressive models -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ArModel:
    """Autoregressive model of a texture at one speed and force."""

    speed_m_per_s: float
    force_n: float
    coefficients: tuple[float, ...]
    rms_m_per_s2: float
    rms_error_db: float
    """Difference of the model's spectrum from the recorded one, from `spectral_distance_db`."""


def _model_rate(frequency: Floats, shape: Floats, rate_hz: float) -> float:
    """Return the sampling rate of autoregressive models, at most `rate_hz`, the rate of the recordings.

    The rate is an integer of Hz, and 99.5 % of the power lies below 0.4 of it. `shape` (frequencies,) is the density.
    """
    below = np.cumsum(np.maximum(shape, 0.0))
    top = float(frequency[min(int(np.searchsorted(below, TEXTURE_LIMITS.model_power * below[-1])), len(frequency) - 1)])
    return min(rate_hz, 2 * float(frequency[-1]), float(math.ceil(max(top / 0.4, 100.0))))


def _models_of(blocks: _Blocks, rate_hz: float) -> tuple[ArModel, ...]:
    """Return an autoregressive model, at this rate, of each group of blocks with nearly the same speed and force.

    Raises FitError if no group lasts 2 s.
    """
    columns = (blocks.speed, blocks.force)
    groups: list[list[int]] = []
    for stroke in range(len(blocks.strokes)):
        # A recording at nearly constant speed and force is one part, otherwise each block is a part.
        here = np.flatnonzero(blocks.stroke == stroke)
        steady = max(float(np.ptp(values[here]) / np.mean(values[here])) for values in columns) < 0.5
        for part in [here.tolist()] if steady else [[member] for member in here.tolist()]:
            for group in groups:
                if all(
                    abs(np.mean(values[part]) / np.mean(values[group]) - 1) < TEXTURE_LIMITS.max_model_difference
                    for values in columns
                ):
                    group += part
                    break
            else:
                groups.append(part)
    kept = [group for group in groups if len(group) >= TEXTURE_LIMITS.min_model_blocks]
    if not kept:
        raise FitError("no speed and force was held for 2 s: autoregressive models need steady strokes")
    return tuple(_model(blocks, group, rate_hz) for group in kept)


def _model(blocks: _Blocks, group: list[int], rate_hz: float) -> ArModel:
    from scipy.linalg import solve_toeplitz

    density = blocks.density[group].mean(axis=0)
    below = blocks.frequency <= rate_hz / 2
    frequency, power = blocks.frequency[below], np.maximum(density[below], 1e-6 * density.max())
    weights = np.full(len(frequency), frequency[1])
    weights[-1] /= 2
    lags = np.arange(TEXTURE_LIMITS.max_order + 1)
    correlation = np.cos(2 * math.pi * np.outer(lags, frequency) / rate_hz) @ (power * weights)
    # The reflection is the last coefficient of each order, in the convention of hapticd.rendering.filter_design.
    stages = [-float(solve_toeplitz(correlation[:m], correlation[1 : m + 1])[-1]) for m in lags[1:]]
    errors = np.cumprod(1 - np.square(stages))
    count = len(group) * TEXTURE_LIMITS.block_s * rate_hz
    criteria = [count * math.log(errors[p - 1]) + 2 * (p + 1) * count / (count - p - 2) for p in lags[1:]]
    reflection = stages[: 1 + int(np.argmin(criteria))]
    model = float(correlation[0]) * power_spectrum((reflection, None), frequency, rate_hz)
    return ArModel(
        float(blocks.speed[group].mean()),
        float(blocks.force[group].mean()),
        coefficients_of(reflection),
        math.sqrt(float(correlation[0])),
        spectral_distance_db(frequency, model, power),
    )


# ---- The fit, and its verdict ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Block:
    """Half a second of a stroke: means of speed and force, RMS and mean frequency of the acceleration."""

    recording: str
    speed_m_per_s: float
    force_n: float
    rms_m_per_s2: float
    mean_hz: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureFit(Fit):
    """Result of a fit of a texture. All intervals are 95 % confidence intervals."""

    peak_hz: Estimate | None
    """None if the peak is not resolved."""
    peak_resolved: bool
    peak_below_hz: float | None
    """If the peak is not resolved: the frequency below which it is, with 95 % confidence."""
    mean_hz: Estimate
    velocity_gain_per_s: Estimate | None
    """None, like the force gain, if speed and force do not vary independently; a warning then says so."""
    force_gain_m_per_s2_per_n: Estimate | None
    correlation: float
    mean_per_speed_hz_s_per_m: Estimate | None
    mean_per_force_hz_per_n: Estimate | None
    ar_rate_hz: float | None
    ar_models: tuple[ArModel, ...]
    """The autoregressive models; empty unless they were requested or the peak is not resolved."""
    blocks: tuple[Block, ...]

    def material(self) -> dict[str, object]:
        """Return the keys of a material: its texture. Strokes do not measure the stiffness."""
        if self.ar_models:
            names = ("speed_m_per_s", "force_n", "coefficients", "rms_m_per_s2")
            models = [fields_of(model, *names) for model in self.ar_models]
            return {"texture": {"kind": "autoregressive", "rate_hz": self.ar_rate_hz, "models": models}}
        assert self.peak_hz is not None
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
    """Fit a texture to strokes at several speeds and forces; without a resolved peak always by autoregressive models.

    Unusable recordings and sections are added to `excluded`. Raises FitError if the recordings do not support a fit.
    """
    excluded = Exclusions() if excluded is None else excluded
    preparation.refuse_duplicates(recordings)
    rates = [recording.rate_hz for recording in recordings]
    if not rates:
        raise FitError("no recordings")
    usual_hz = max(rates, key=rates.count)
    sections = preparation.sections_of(recordings, TEXTURE_LIMITS.block_s, excluded)
    while True:
        try:
            return _fitted(recordings, sections, usual_hz, autoregressive, excluded)
        except _TwoTextures as two:
            excluded.add(two.name, str(two))
            left_out = {each.recording for each in excluded.items}
            sections = [recording for recording in sections if recording.name not in left_out]


def _fitted(
    given: Sequence[Recording],
    sections: Sequence[Recording],
    rate_hz: float,
    autoregressive: bool,
    excluded: Exclusions,
) -> TextureFit:
    """Fit a texture to these sections of strokes; raise _TwoTextures if a section has more than one texture.

    `given` are the recordings that were cut into the sections.
    """
    warnings = Warnings()
    cut = _cut(sections, rate_hz, excluded, warnings)
    excluded.report_recordings(given, warnings)
    blocks = _Blocks.of(cut, excluded)
    recordings = [each.recording for each in blocks.strokes]
    preparation.report_gravity(recordings, warnings)
    report_lines(blocks.strokes, lambda each, needed: spectral_lines(each.acceleration, rate_hz, needed), warnings)
    preparation.check_force_varies(recordings, blocks.force, warnings)
    law, (velocity_gain, force_gain), correlation = _loudness(blocks, autoregressive, warnings)
    # Divided by the law, not by each block's power, which is correlated with its peak.
    shape = blocks.density / (law**2)[:, None]
    centroid = np.array([blocks.centroid(each) for each in shape])
    peak = peak_of(blocks.frequency, shape, blocks.stroke)
    mean = jackknifed(blocks.centroid, shape, blocks.stroke)
    if rate_hz < PREPARATION_LIMITS.min_samples_per_cycle * mean.value:
        raise FitError(f"the rate is too low: {rate_hz:g} Hz for a mean frequency of {mean.value:.4g} Hz")
    for place, recording in enumerate(recordings):
        here = blocks.stroke == place
        _refuse_two(recording.name, np.log(np.maximum(centroid[here], 1.0)), np.log(blocks.rms[here] / law[here]))
    by_speed, by_force = preparation.changes_with(
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
    unresolved = ""
    if peak.hz is None:
        unresolved = (
            f"the peak is not resolved: the spectrum is broad, or highest below {TEXTURE_LIMITS.min_frequency_hz:g} "
            f"Hz; the peak is below {peak.below_hz:.3g} Hz"
        )
        warnings.note(f"{unresolved}; autoregressive models need no peak")
    if autoregressive or unresolved:
        ar_rate = _model_rate(blocks.frequency, shape.mean(axis=0), rate_hz)
        try:
            models = _models_of(blocks, ar_rate)
        except FitError as error:
            raise FitError(f"{unresolved}; {error}" if unresolved else str(error)) from None
    warnings.check_interval("mean frequency", mean)
    if peak.hz is not None and not autoregressive:
        warnings.check_interval("peak frequency", peak.hz)
        # The spectrum of the material has two parameters only: peak and mean.
        power = shape.mean(axis=0) / (shape.mean(axis=0).sum() * blocks.frequency[1])
        model = power_spectrum(stochastic_filter(peak.hz.value, mean.value, rate_hz), blocks.frequency, rate_hz)
        distance_db = spectral_distance_db(blocks.frequency, model, np.maximum(power, 1e-6 * power.max()))
        warnings.check("decibels between the spectra", distance_db)
    found = f"peak below {peak.below_hz:.3g} Hz" if peak.hz is None else f"peak at {peak.hz.value:.4g} Hz"
    names = [recordings[place].name for place in blocks.stroke]
    figures = zip(blocks.speed, blocks.force, blocks.rms, centroid, strict=True)
    return TextureFit(
        peak_hz=peak.hz,
        peak_resolved=peak.hz is not None,
        peak_below_hz=peak.below_hz if peak.hz is None else None,
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
            f"{len(centroid) * TEXTURE_LIMITS.block_s:g} s of noise with its {found} and its mean at "
            f"{mean.value:.4g} Hz" + (f", {len(models)} autoregressive models" if models else "")
        ),
        left_out=tuple(excluded.items),
    )


def _cut(sections: Sequence[Recording], rate_hz: float, excluded: Exclusions, warnings: Warnings) -> list[StrokeBlocks]:
    """Return each section cut into blocks; raise FitError if no section can be used."""
    found = excluded.each(sections, lambda each: _blocks_of(stroke_of(each, "texture"), rate_hz, warnings))
    if not found:
        raise excluded.refused("none of the recordings can be used")
    preparation.report_cleaning([each.stroke for each in found], warnings)
    dropped = sum(each.lost for each in found)
    lost = dropped / (dropped + sum(len(each.density) for each in found))
    warnings.check("part left out", lost, left=f"{100 * lost:.0f} % of the strokes are left out")
    return found


class _TwoTextures(FitError):
    """A recording has more than one texture, or is not of a texture."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name


def _refuse_two(name: str, frequency: Floats, loudness: Floats) -> None:
    """Raise _TwoTextures if mean frequency or loudness, as logarithms (blocks,), scatters or jumps too much."""
    count = len(frequency)
    if count > 3 and float(np.std(frequency)) > TEXTURE_LIMITS.max_frequency_scatter:
        raise _TwoTextures(
            name,
            f"two textures in one file, or none: the mean frequency varies from {math.exp(frequency.min()):.3g} to "
            f"{math.exp(frequency.max()):.3g} Hz",
        )
    for k in range(3, count - 2):
        for values, min_step, what in (
            (frequency, TEXTURE_LIMITS.min_frequency_step, "mean frequency"),
            (loudness, TEXTURE_LIMITS.min_loudness_step, "loudness"),
        ):
            one, other = values[:k], values[k:]
            step = float(other.mean() - one.mean())
            within = math.sqrt((k * float(np.var(one)) + (count - k) * float(np.var(other))) / (count - 2))
            by_chance = TEXTURE_LIMITS.step_to_error * within * math.sqrt(1 / k + 1 / (count - k))
            if abs(step) > min_step and abs(step) > by_chance:
                raise _TwoTextures(
                    name,
                    f"two textures in one file: the {what} changes {math.exp(step):.2f}-fold at about "
                    f"{k * TEXTURE_LIMITS.block_s:g} s; record each in a separate file",
                )
