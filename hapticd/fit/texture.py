"""Textures from recorded strokes: peak and mean frequency, and how loud they are over speed and force.

A stroke is cut into blocks of half a second, each with its own periodograms, speed and force. What the sensor hisses is
read off the top of the spectrum and taken away; below LOW_HZ, where a hand trembles, the density goes on as it is just
above, and where it sinks into the hiss it goes on falling as it does in the octave before. The mean frequency is the
power's centroid; the peak and the intervals of both are found by spectrum_peak.py. The RMS law is fitted to the blocks'
power, of which it is the square, with errors that are a part of it (quasi-likelihood of a gamma distribution;
Wedderburn, 1974).

Autoregressive models (`autoregressive`) come from the autocorrelation of the mean spectrum at each pair of speed and
force (Levinson and Durbin), which makes them stable for any spectrum; the order is that of the least corrected
information criterion of Akaike (Hurvich and Tsai, 1989).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats, least_squares, student_t
from hapticd.fit.impossible import Kept, without_impossible
from hapticd.fit.left_out import Left, LeftOut, weigh
from hapticd.fit.lines import lines_of, tell_lines
from hapticd.fit.recording import Recording
from hapticd.fit.spectrum_apart import apart_db
from hapticd.fit.spectrum_peak import LOW_HZ, jackknifed, peak_of, smoothed
from hapticd.fit.stretches import stretches_of
from hapticd.fit.strokes import (
    LEAST_RATE,
    acceleration_of,
    motion_of,
    plain,
    pressed,
    tell_gravity,
    told_apart,
    told_of,
    varied_force,
)
from hapticd.fit.twins import refuse_twins
from hapticd.fit.verdict import Doubts, Verdict
from hapticd.rendering.filter_design import coefficients_of, power_spectrum, stochastic_filter

BLOCK_S: Final = 0.5
LEAST_BLOCKS: Final = 8
MOVES: Final = 0.05
"""A change of the mean frequency over the speeds or forces that is worth telling, as a part of it."""
SELDOM: Final = 0.99
"""And is more than what chance makes of it with this probability."""
ROUNDS: Final = 30
"""Of the RMS law at most."""
APART: Final = (0.15, 0.4)
"""Steps in the logarithms of mean frequency and of loudness within a recording that are two textures,"""
SURE: Final = 6.0
"""where they are so many standard errors."""
SAME_PLACE: Final = 0.1
"""Strokes whose speeds and forces differ by less than this part are at one place of the autoregressive models."""
STEADY: Final = 0.5
"""A stroke whose speed and force vary by less than this part is at one place."""
CUT_OFF: Final = 0.05
"""Of the highest density, between 0.4 and 0.49 of the rate: more than that is a spectrum that goes on beyond it."""
FALLS: Final = 1.78
"""From 0.325 to 0.445 of the rate, the density of noise with two poles at low frequency, filtered at this very rate;
the samples of a continuous one fall by more."""
TONE_BINS: Final = 3
"""That hold half of the power are a tone."""
UNSTEADY: Final = 0.3
"""Standard deviation of the logarithm of the mean frequency over the blocks of a recording that is no one texture."""
SPOILT: Final = 0.02
"""Of the samples of a block, replaced, and it does not count."""
KNOCK: Final = 15.0
"""Standard deviations of a block that noise does not reach."""
KNOCKED: Final = 0.1
"""Of the blocks of a recording; where more have knocks, they are part of the texture."""
SUNK: Final = 0.3
"""Of the hiss: a density below is not seen."""
RMS_M_PER_S2: Final = (0.03, 300.0)
"""Of a usual block; less is not felt."""
MAX_ORDER: Final = 32
KEPT: Final = 0.995
"""Of the power lies below 0.4 of the rate of the autoregressive models."""


@dataclass(frozen=True, slots=True)
class ArModel:
    """At one speed and force: the model, and how far its spectrum is from the recorded one."""

    speed_m_per_s: float
    force_n: float
    coefficients: tuple[float, ...]
    rms_m_per_s2: float
    rms_error_db: float
    """RMS difference of the spectra, in bands, where the recorded one is within COMPARED_DB of its peak."""


@dataclass(frozen=True, slots=True)
class Block:
    """Half a second of a stroke: means of speed and force, RMS and centroid of the acceleration."""

    recording: str
    speed_m_per_s: float
    force_n: float
    rms_m_per_s2: float
    mean_hz: float


@dataclass(frozen=True, slots=True)
class TextureFit:
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
    warnings: tuple[str, ...]
    judged: Verdict
    left_out: tuple[Left, ...] = ()

    @property
    def verdict(self) -> str:
        return str(self.judged)

    def material(self) -> dict[str, object]:
        """The keys of a material: its texture. Stiffness is not measured by strokes."""
        if self.ar_models:
            models = [
                {
                    "speed_m_per_s": model.speed_m_per_s,
                    "force_n": model.force_n,
                    "coefficients": list(model.coefficients),
                    "rms_m_per_s2": model.rms_m_per_s2,
                }
                for model in self.ar_models
            ]
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

    def to_dict(self) -> dict[str, object]:
        found = plain(self)
        assert isinstance(found, dict)
        return {**found, "verdict": self.verdict}


def fit_texture(
    recordings: Sequence[Recording], autoregressive: bool = False, left: LeftOut | None = None
) -> TextureFit:
    """Of strokes at several speeds and forces. FitError where they do not say it.

    Recordings, and stretches of them, that cannot be used are told to `left`.
    """
    left = LeftOut() if left is None else left
    refuse_twins(recordings)
    rate_hz = _usual_rate(recordings)
    stretches = stretches_of(recordings, BLOCK_S, left)
    while True:
        try:
            return _fitted(stretches, rate_hz, autoregressive, left)
        except _TwoTextures as two:
            left.add(two.name, str(two))
            gone = {each.recording for each in left.items}
            stretches = [recording for recording in stretches if recording.name not in gone]


def _fitted(stretches: Sequence[Recording], rate_hz: float, autoregressive: bool, left: LeftOut) -> TextureFit:
    doubts = Doubts()
    cut = left.each(stretches, lambda recording: _cut(without_impossible(recording, "texture"), rate_hz, doubts))
    if not cut:
        raise left.refused("none of the recordings can be used")
    told_of([each.kept for each in cut], doubts)
    recordings = [each.kept.recording for each in cut]
    weigh(left, recordings, doubts)
    dropped = sum(each.lost for each in cut)
    lost = dropped / (dropped + sum(len(each.density) for each in cut))
    doubts.at_most("part left out", lost, f"{100 * lost:.0f} % of the strokes are left out")
    density = np.concatenate([each.density for each in cut])
    if len(density) < LEAST_BLOCKS:
        raise left.refused(
            f"{len(density) * BLOCK_S:g} s of strokes are too few: at least {LEAST_BLOCKS * BLOCK_S:g} s are needed"
        )
    names = [each.name for each in cut for _ in each.density]
    frequency = cut[0].frequency_hz
    speed = np.concatenate([each.speed for each in cut])
    force = np.concatenate([each.force for each in cut])
    moments = np.concatenate([each.moments for each in cut])
    power = density.sum(axis=1) * frequency[1]
    rough = (density / power[:, None]).mean(axis=0)
    top, tail = _top(frequency, rough, float(np.mean([each.floor for each in cut]) / np.median(power)))
    heard = frequency <= top
    frequency, density = frequency[heard], density[:, heard]
    power = density.sum(axis=1) * frequency[1]
    if power.min() <= 0:
        raise FitError(f"{names[int(np.argmin(power))]}: what is there is no more than the sensor's hiss")
    rms = np.sqrt(power)
    usual = float(np.median(rms))
    least, most = RMS_M_PER_S2
    if not least <= usual <= most:
        raise FitError(f"an RMS of {usual:.3g} m/s^2 is no texture's ({least:g} to {most:g}): is its unit another one?")
    tell_gravity(recordings, doubts)
    tell_lines(
        len(recordings), lambda place, needed: lines_of(acceleration_of(recordings[place]), rate_hz, needed), doubts
    )
    varied_force(recordings, force, doubts)
    gains: tuple[Estimate | None, Estimate | None] = (None, None)
    correlation = math.nan
    law = np.concatenate([np.full(len(each.density), float(np.mean(rms[here]))) for each, here in _slices(cut)])
    if told_apart(np.column_stack((speed, force)), 20):
        law, gains, correlation = _law(moments, rms, doubts)
    elif autoregressive:
        doubts.note("speed and force vary too little, or together: no gains")
    else:
        raise FitError(
            f"speed ({speed.min():.3g} to {speed.max():.3g} m/s) and force ({force.min():.3g} to {force.max():.3g} N) "
            "rise and fall together or not at all, so that their gains cannot be told apart: vary them on their own"
        )
    # Not by each block's own power, which goes with its peak.
    shape = density / (law**2)[:, None]
    centroid = np.array([_centroid(frequency, each, tail) for each in shape])
    strokes = np.repeat(np.arange(len(cut)), [len(each.density) for each in cut])
    peak = peak_of(frequency, shape, strokes)
    mean = jackknifed(lambda density: _centroid(frequency, density, tail), shape, strokes)
    if rate_hz < LEAST_RATE * mean.value:
        raise FitError(f"the mean frequency is {mean.value:.4g} Hz, sampled at {rate_hz:g} Hz: the rate is too low")
    members = []
    for each, here in _slices(cut):
        members.append(list(range(here.start, here.stop)))
        _refuse_two(each.name, np.log(np.maximum(centroid[here], 1.0)), np.log(rms[here] / law[here]))
    by_speed, by_force = _moved(speed, force, centroid, mean.value, doubts)
    ar_rate: float | None = None
    models: tuple[ArModel, ...] = ()
    if autoregressive:
        ar_rate = _ar_rate(frequency, shape.mean(axis=0), rate_hz)
        models = _ar_models(frequency, density, speed, force, members, ar_rate)
    blocks = tuple(
        Block(name, float(v), float(f), float(r), float(c))
        for name, v, f, r, c in zip(names, speed, force, rms, centroid, strict=True)
    )
    if not peak.resolved:
        # Autoregressive models have the spectrum as it is.
        tell = doubts.note if autoregressive else doubts.tell
        tell(
            f"the peak is not resolved: the spectrum is broad, or highest below {LOW_HZ:g} Hz; it lies between 0 and "
            f"{peak.hz.high:.3g} Hz, and {peak.hz.value:.3g} Hz is a guess (--ar needs no peak)"
        )
    elif not autoregressive:
        doubts.known("peak frequency", peak.hz)
    doubts.known("mean frequency", mean)
    if peak.resolved and not autoregressive:
        _compare(frequency, shape.mean(axis=0), peak.hz.value, mean.value, rate_hz, doubts)
    place = f"peak at {peak.hz.value:.4g} Hz" if peak.resolved else f"peak below {peak.hz.high:.3g} Hz"
    summary = f"{len(blocks) * BLOCK_S:g} s of noise with its {place} and its mean at {mean.value:.4g} Hz" + (
        f", {len(models)} autoregressive models" if models else ""
    )
    return TextureFit(
        peak_hz=peak.hz,
        peak_resolved=peak.resolved,
        mean_hz=mean,
        velocity_gain_per_s=gains[0],
        force_gain_m_per_s2_per_n=gains[1],
        correlation=correlation,
        mean_per_speed_hz_s_per_m=by_speed,
        mean_per_force_hz_per_n=by_force,
        ar_rate_hz=ar_rate,
        ar_models=models,
        blocks=blocks,
        warnings=tuple(doubts.told),
        judged=doubts.judged(summary),
        left_out=tuple(left.items),
    )


def _compare(
    frequency: Floats, density: Floats, peak_hz: float, mean_hz: float, rate_hz: float, doubts: Doubts
) -> None:
    """The recorded spectrum with that of the material, which knows peak and mean alone."""
    model = power_spectrum(stochastic_filter(peak_hz, mean_hz, rate_hz), frequency, rate_hz)
    power = density / (density.sum() * frequency[1])
    apart = apart_db(frequency, model, np.maximum(power, 1e-6 * power.max()))
    doubts.at_most(
        "decibels between the spectra",
        apart,
        f"noise with this peak and mean has another spectrum than the recorded one, {apart:.1f} dB apart",
        "--ar takes the spectrum as it is",
    )


# ---- Spectra --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Cut:
    """A recording in blocks: density (blocks, frequencies) in (m/s^2)^2/Hz, one-sided, without the sensor's."""

    name: str
    frequency_hz: Floats
    density: Floats
    speed: Floats
    force: Floats
    moments: Floats
    """(blocks, 3) means of the squares of speed and of force, and between them of their product."""
    floor: float
    lost: int
    """Blocks that do not count, as of `_spoilt`."""
    kept: Kept


def _slices(cut: Sequence[_Cut]) -> Iterator[tuple[_Cut, slice]]:
    """Each with its blocks among all."""
    start = 0
    for each in cut:
        yield each, slice(start, start + len(each.density))
        start += len(each.density)


def _usual_rate(recordings: Sequence[Recording]) -> float:
    """Of most of them."""
    rates = [recording.rate_hz for recording in recordings]
    if not rates:
        raise FitError("no recordings")
    return max(rates, key=rates.count)


def _cut(kept: Kept, usual_hz: float, doubts: Doubts) -> _Cut:
    recording = kept.recording
    if recording.rate_hz != usual_hz:
        raise FitError(
            f"{recording.name}: sampled at {recording.rate_hz:g} Hz, most others at {usual_hz:g} Hz: strokes of one "
            "texture need one rate"
        )
    seen, force = acceleration_of(recording), pressed(recording)
    motion = motion_of(recording, len(seen))
    rate_hz = recording.rate_hz
    block, length = round(BLOCK_S * rate_hz), round(BLOCK_S * rate_hz / 2)
    window = np.hanning(length + 1)[:-1]
    scale = 2 / (rate_hz * float(window @ window))
    usual = float(np.median(np.abs(motion.speed_m_per_s)))
    found, speeds, forces, moments = [], [], [], []
    # Of speed and force the mean is taken as the power's is.
    weights = np.zeros(block)
    for first in (0, length // 2, block - length):
        weights[first : first + length] += window**2
    weights /= weights.sum()
    spoilt = _spoilt(kept, seen, block, doubts)
    for start in range(0, len(seen) - block + 1, block):
        here = slice(start, start + block)
        if start in spoilt:
            continue
        speed = motion.speed_m_per_s[here]
        if np.abs(speed).min() < 0.2 * usual or force[here].mean() <= 0:
            continue
        part = seen[here]
        power = np.zeros(length // 2 + 1)
        for first in (0, length // 2, block - length):
            piece = part[first : first + length]
            power += np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2 * scale / 3
        found.append(power)
        moved, press = np.abs(speed), np.maximum(force[here], 0.0)
        speeds.append(float(weights @ moved))
        forces.append(float(weights @ press))
        moments.append([float(weights @ each) for each in (moved**2, moved * press, press**2)])
    if not found:
        raise FitError(f"{recording.name}: holds no half second of one stroke")
    density: Floats = np.array(found, dtype=np.float64)
    frequency: Floats = np.asarray(np.fft.rfftfreq(length, 1 / rate_hz), dtype=np.float64)
    hiss = (frequency > 0.4 * rate_hz) & (frequency < 0.49 * rate_hz)
    floor = float(np.mean(density[:, hiss]))
    if floor > CUT_OFF * float(density[:, (frequency >= LOW_HZ) & ~hiss].mean(axis=0).max(initial=0.0)):
        raise FitError(
            f"{recording.name}: the spectrum goes on beyond half the rate of {rate_hz:g} Hz, or is the sensor's hiss "
            "alone: record at a higher rate, or with less noise"
        )
    # A texture's own density falls there, by FALLS at least; only what does not is the sensor's.
    nearer = float(np.mean(density[:, (frequency > 0.3 * rate_hz) & (frequency < 0.35 * rate_hz)]))
    floor = min(max(0.0, (FALLS * floor - nearer) / (FALLS - 1)), floor)
    density = density - floor
    _refuse_motion(recording.name, frequency, density.mean(axis=0))
    just = (frequency >= LOW_HZ) & (frequency < 2 * LOW_HZ)
    density[:, frequency < LOW_HZ] = density[:, just].mean(axis=1)[:, None]
    # A sum over the bins is then the integral from 0 on.
    density[:, 0] /= 2
    return _Cut(
        recording.name,
        frequency,
        density,
        np.array(speeds),
        np.array(forces),
        np.array(moments),
        floor,
        len(spoilt),
        kept,
    )


def _spoilt(kept: Kept, seen: Floats, block: int, doubts: Doubts) -> set[int]:
    """First samples of the blocks that do not count: much of them was not measured so, or something knocked."""
    starts = range(0, len(seen) - block + 1, block)
    lost = {start for start in starts if np.mean(kept.replaced[start : start + block]) > SPOILT}
    knocks = []
    for start in starts:
        part = np.abs(seen[start : start + block] - np.median(seen[start : start + block]))
        if part.max() > KNOCK * 1.4826 * np.median(part):
            knocks.append(start)
    # Where there are many, it is a texture of knocks.
    if 0 < len(knocks) <= max(1, KNOCKED * len(starts)):
        at = knocks[0] + int(np.argmax(np.abs(seen[knocks[0] : knocks[0] + block])))
        value = f"{seen[at]:.4g} m/s^2 at {at / kept.recording.rate_hz:.6g} s"
        doubts.note(
            f"{kept.recording.name}: the acceleration of {value} is a knock: {len(knocks) * BLOCK_S:g} s about such "
            "are left out"
        )
        lost |= set(knocks)
    return lost


def _refuse_motion(name: str, frequency: Floats, density: Floats) -> None:
    """FitError where most of the power is the hand's, or tones."""
    low, whole = frequency < LOW_HZ, frequency >= LOW_HZ
    smooth = smoothed(density, 2)
    lowest = float(frequency[whole][np.argmax(smooth[whole])])
    if density[low].sum() > density[whole].sum() and lowest < 2 * LOW_HZ:
        raise FitError(
            f"{name}: most of it is below {LOW_HZ:g} Hz, and above it falls: a hand that moves, and no texture"
        )
    loudest = np.sort(density[whole])[-TONE_BINS:]
    if loudest.sum() > 0.5 * density[whole].sum():
        raise FitError(
            f"{name}: a tone at {frequency[whole][np.argmax(density[whole])]:.4g} Hz holds most of the power: hum, or "
            "something that rings, and no texture"
        )


def _top(frequency: Floats, shape: Floats, floor: float) -> tuple[float, _Tail | None]:
    """Where the mean spectrum sinks into what was taken away as the sensor's, and how it goes on from there."""
    smooth = smoothed(shape, max(1, round(25 / frequency[1])))
    peak = int(np.argmax(smooth))
    below = np.flatnonzero(smooth[peak:] < SUNK * floor)
    if floor <= 0 or len(below) == 0:
        return float(frequency[-1]), None
    top = float(frequency[peak + below[0]])
    last = (frequency > max(top / 2, float(frequency[peak]))) & (frequency <= top) & (smooth > 0)
    if np.count_nonzero(last) < 8:
        return top, None
    fall = -float(np.polyfit(np.log(frequency[last]), np.log(smooth[last]), 1)[0])
    # The power of what falls more slowly has no mean frequency.
    return top, _Tail(top, max(fall, 2.5), float(frequency[-1])) if fall > 2 else None


@dataclass(frozen=True, slots=True)
class _Tail:
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


def _centroid(frequency: Floats, shape: Floats, tail: _Tail | None) -> float:
    beyond, first = (0.0, 0.0) if tail is None else tail.moments(frequency, shape)
    return float((frequency @ shape + first) / (shape.sum() + beyond))


# ---- Laws -----------------------------------------------------------------------------------------------------


def _law(moments: Floats, rms: Floats, doubts: Doubts) -> tuple[Floats, tuple[Estimate, Estimate], float]:
    """RMS as the law has it, gains, and their correlation. The mean power of a block is g' M g, with the gains g and
    the block's moments M; its derivative 2 M g, relative to the power, gives the columns."""
    squares = moments[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    gains = np.linalg.lstsq(np.sqrt(moments[:, [0, 2]]) / rms[:, None], np.ones(len(rms)), rcond=None)[0]
    for _ in range(ROUNDS):
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
            doubts.tell(f"the {name} gain is negative: {gain.low:.3g} to {gain.high:.3g}")
        elif gain.low <= 0:
            doubts.tell(f"the {name} gain may be 0: {gain.low:.3g} to {gain.high:.3g}")
        else:
            doubts.gain(name, gain, float(np.sqrt(np.median(square))), float(np.median(rms)))
    if max(velocity_gain.value, force_gain.value) <= 0:
        raise FitError("neither speed nor force makes it louder: is a column swapped?")
    scatter = float(np.std(np.log(rms / law)))
    correlation = float(np.corrcoef(law, rms)[0, 1]) if np.ptp(law) > 0 and np.ptp(rms) > 0 else math.nan
    doubts.at_most(
        "distance from the law",
        scatter,
        f"loudness is off the law by {100 * scatter:.0f} %",
        "it depends on more than speed and force",
    )
    doubts.at_least(
        "correlation of the law",
        correlation,
        f"speed and force explain the loudness poorly: correlation {correlation:.2f}",
        "the gains in the material say little",
    )
    return law, (velocity_gain, force_gain), correlation


class _TwoTextures(FitError):
    """A recording is of more than one texture, or of none."""

    def __init__(self, name: str, told: str) -> None:
        super().__init__(told)
        self.name = name


def _refuse_two(name: str, pitch: Floats, loudness: Floats) -> None:
    """_TwoTextures where a recording changes its pitch or loudness at once, by much."""
    count = len(pitch)
    if count > 3 and float(np.std(pitch)) > UNSTEADY:
        raise _TwoTextures(
            name,
            f"{name}: two textures in one file, or none: the mean frequency goes from {math.exp(pitch.min()):.3g} to "
            f"{math.exp(pitch.max()):.3g} Hz within it",
        )
    for k in range(3, count - 2):
        for values, apart, what in zip((pitch, loudness), APART, ("mean frequency", "loudness"), strict=True):
            one, other = values[:k], values[k:]
            step = float(other.mean() - one.mean())
            within = math.sqrt(
                (float(np.sum((one - one.mean()) ** 2)) + float(np.sum((other - other.mean()) ** 2))) / (count - 2)
            )
            if abs(step) > apart and abs(step) > SURE * within * math.sqrt(1 / k + 1 / (count - k)):
                raise _TwoTextures(
                    name,
                    f"{name}: two textures in one file: the {what} changes {math.exp(step):.2f}-fold at about "
                    f"{k * BLOCK_S:g} s; give each its own file",
                )


def _moved(
    speed: Floats, force: Floats, centroid: Floats, mean_hz: float, doubts: Doubts
) -> tuple[Estimate | None, Estimate | None]:
    """Slopes of the mean frequency over speed and force."""
    columns = np.column_stack((speed, force, np.ones_like(speed)))
    if not told_apart(columns):
        doubts.note("too few speeds and forces to tell whether the frequency moves with them")
        return None, None
    line = least_squares(columns, centroid)
    by_speed, by_force, _ = line.coefficients
    # So seldom by chance that a good fit is not called fair for it.
    wider = student_t(line.freedom, SELDOM) / student_t(line.freedom)
    for slope, values, name, unit in ((by_speed, speed, "speed", "m/s"), (by_force, force, "force", "N")):
        change = slope.value * float(np.ptp(values))
        if abs(slope.value) > wider * (slope.high - slope.value) and abs(change) > MOVES * mean_hz:
            doubts.tell(
                f"the mean frequency moves with {name}: by {change:+.3g} Hz from {values.min():.3g} to "
                f"{values.max():.3g} {unit}"
            )
    return by_speed, by_force


# ---- Autoregressive models ------------------------------------------------------------------------------------


def _ar_rate(frequency: Floats, shape: Floats, rate_hz: float) -> float:
    """A whole number of hertz, at most the recording's rate, 0.4 of which holds KEPT of the power."""
    below = np.cumsum(np.maximum(shape, 0.0))
    top = float(frequency[min(int(np.searchsorted(below, KEPT * below[-1])), len(frequency) - 1)])
    return min(rate_hz, 2 * float(frequency[-1]), float(math.ceil(max(top / 0.4, 100.0))))


def _steady(blocks: list[int], speed: Floats, force: Floats) -> list[list[int]]:
    """A recording whole where speed and force keep near their means, otherwise block by block."""
    spread = max(float(np.ptp(values[blocks]) / np.mean(values[blocks])) for values in (speed, force))
    return [blocks] if spread < STEADY else [[block] for block in blocks]


def _ar_models(
    frequency: Floats, density: Floats, speed: Floats, force: Floats, recordings: list[list[int]], rate_hz: float
) -> tuple[ArModel, ...]:
    places: list[list[int]] = []
    for part in (part for each in recordings for part in _steady(each, speed, force)):
        v, f = float(np.mean(speed[part])), float(np.mean(force[part]))
        for place in places:
            if (
                abs(v / float(np.mean(speed[place])) - 1) < SAME_PLACE
                and abs(f / float(np.mean(force[place])) - 1) < SAME_PLACE
            ):
                place += part
                break
        else:
            places.append(part)
    kept = [place for place in places if len(place) >= 4]
    if not kept:
        raise FitError("no speed and force was held for 2 s: autoregressive models need steady strokes")
    return tuple(
        _ar_model(frequency, density[place].mean(axis=0), float(speed[place].mean()), float(force[place].mean()),
                  len(place) * BLOCK_S, rate_hz)
        for place in kept
    )  # fmt: skip


def _ar_model(
    frequency: Floats, density: Floats, speed: float, force: float, duration_s: float, rate_hz: float
) -> ArModel:
    below = frequency <= rate_hz / 2
    frequency = frequency[below]
    power = np.maximum(density[below], 1e-6 * density.max())
    weights = np.full(len(frequency), frequency[1])
    weights[-1] /= 2
    lags = np.arange(MAX_ORDER + 1)
    correlation = np.cos(2 * math.pi * np.outer(lags, frequency) / rate_hz) @ (power * weights)
    stages, errors = _levinson(correlation)
    count = duration_s * rate_hz
    criteria = [count * math.log(errors[p]) + 2 * (p + 1) * count / (count - p - 2) for p in range(1, MAX_ORDER + 1)]
    order = 1 + int(np.argmin(criteria))
    reflection = stages[:order]
    model = float(correlation[0]) * power_spectrum((reflection, None), frequency, rate_hz)
    return ArModel(
        speed,
        force,
        coefficients_of(reflection),
        math.sqrt(float(correlation[0])),
        apart_db(frequency, model, power),
    )


def _levinson(correlation: Floats) -> tuple[list[float], list[float]]:
    """Reflection coefficients k_1 .. k_p in the convention of hapticd.rendering.filter_design, and the errors E_0 ..
    E_p, relative."""
    forward = np.array([1.0])
    error = float(correlation[0])
    stages, errors = [], [1.0]
    for m in range(1, len(correlation)):
        k = -float(forward @ correlation[m:0:-1]) / error
        stages.append(k)
        padded = np.append(forward, 0.0)
        forward = padded + k * padded[::-1]
        error *= (1 - k) * (1 + k)
        errors.append(error / float(correlation[0]))
    return stages, errors
