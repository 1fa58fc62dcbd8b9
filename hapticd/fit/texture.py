"""Textures from recorded strokes: peak and mean frequency, and how loud they are over speed and force.

A stroke is cut into blocks of half a second, each with its own periodograms, speed and force (texture_blocks.py). The
mean frequency is the power's centroid; the peak and the intervals of both are found by spectrum_peak.py. The RMS law is
fitted to the blocks' power, of which it is the square, with errors that are a part of it (quasi-likelihood of a gamma
distribution; Wedderburn, 1974). Autoregressive models, where they are asked for, are those of autoregressive.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats, Ints, least_squares, student_t, well_conditioned
from hapticd.fit.autoregressive import ArModel, model_rate, models_of
from hapticd.fit.duplicates import refuse_duplicates
from hapticd.fit.exclusions import Exclusion, Exclusions, report_exclusions
from hapticd.fit.invalid_samples import without_invalid_samples
from hapticd.fit.plain_data import plain
from hapticd.fit.recording import Recording
from hapticd.fit.recording_checks import (
    LEAST_RATE,
    acceleration_of,
    check_force_varies,
    report_cleaning,
    report_gravity,
)
from hapticd.fit.spectral_distance import spectral_distance_db
from hapticd.fit.spectral_lines import report_lines, spectral_lines
from hapticd.fit.spectrum_peak import LOW_HZ, Peak, jackknifed, peak_of
from hapticd.fit.stretches import stretches_of
from hapticd.fit.texture_blocks import BLOCK_S, StrokeBlocks, Tail, blocks_of, centroid_of, slices_of, top_of
from hapticd.fit.verdict import Doubts, Verdict
from hapticd.rendering.filter_design import power_spectrum, stochastic_filter

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
UNSTEADY: Final = 0.3
"""Standard deviation of the logarithm of the mean frequency over the blocks of a recording that is no one texture."""
RMS_M_PER_S2: Final = (0.03, 300.0)
"""Of a usual block; less is not felt."""


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
    left_out: tuple[Exclusion, ...] = ()

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
    recordings: Sequence[Recording], autoregressive: bool = False, excluded: Exclusions | None = None
) -> TextureFit:
    """Of strokes at several speeds and forces. FitError where they do not say it.

    Recordings, and stretches of them, that cannot be used are reported in `excluded`.
    """
    excluded = Exclusions() if excluded is None else excluded
    refuse_duplicates(recordings)
    rate_hz = _usual_rate(recordings)
    stretches = stretches_of(recordings, BLOCK_S, excluded)
    while True:
        try:
            return _fitted(stretches, rate_hz, autoregressive, excluded)
        except _TwoTextures as two:
            excluded.add(two.name, str(two))
            gone = {each.recording for each in excluded.items}
            stretches = [recording for recording in stretches if recording.name not in gone]


def _fitted(stretches: Sequence[Recording], rate_hz: float, autoregressive: bool, excluded: Exclusions) -> TextureFit:
    """Of stretches of strokes. _TwoTextures where one of them is of more than one."""
    doubts = Doubts()
    strokes = _cut(stretches, rate_hz, excluded, doubts)
    recordings = [each.kept.recording for each in strokes]
    blocks = _Blocks.of(strokes, excluded)
    _doubt_the_recordings(recordings, rate_hz, doubts)
    check_force_varies(recordings, blocks.force, doubts)
    loudness = _loudness(blocks, autoregressive, doubts)
    # Not by each block's own power, which goes with its peak.
    shape = blocks.density / (loudness.rms**2)[:, None]
    centroid = np.array([blocks.centroid(each) for each in shape])
    peak = peak_of(blocks.frequency, shape, blocks.stroke)
    mean = jackknifed(blocks.centroid, shape, blocks.stroke)
    if rate_hz < LEAST_RATE * mean.value:
        raise FitError(f"the mean frequency is {mean.value:.4g} Hz, sampled at {rate_hz:g} Hz: the rate is too low")
    for each, here in slices_of(strokes):
        _refuse_two(each.name, np.log(np.maximum(centroid[here], 1.0)), np.log(blocks.rms[here] / loudness.rms[here]))
    by_speed, by_force = _moved(blocks.speed, blocks.force, centroid, mean.value, doubts)
    ar_rate: float | None = None
    models: tuple[ArModel, ...] = ()
    if autoregressive:
        members = [list(range(here.start, here.stop)) for _, here in slices_of(strokes)]
        ar_rate = model_rate(blocks.frequency, shape.mean(axis=0), rate_hz)
        models = models_of(blocks.frequency, blocks.density, blocks.speed, blocks.force, members, BLOCK_S, ar_rate)
    _doubt_the_peak(peak, autoregressive, doubts)
    doubts.check_interval("mean frequency", mean)
    if peak.resolved and not autoregressive:
        _compare(blocks.frequency, shape.mean(axis=0), peak.hz.value, mean.value, rate_hz, doubts)
    return TextureFit(
        peak_hz=peak.hz,
        peak_resolved=peak.resolved,
        mean_hz=mean,
        velocity_gain_per_s=loudness.gains[0],
        force_gain_m_per_s2_per_n=loudness.gains[1],
        correlation=loudness.correlation,
        mean_per_speed_hz_s_per_m=by_speed,
        mean_per_force_hz_per_n=by_force,
        ar_rate_hz=ar_rate,
        ar_models=models,
        blocks=blocks.reported(centroid),
        warnings=tuple(doubts.warnings),
        judged=doubts.judged(_summary(len(centroid), peak, mean, len(models))),
        left_out=tuple(excluded.items),
    )


# ---- Stages, in their order ----------------------------------------------------------------------------------------


def _cut(stretches: Sequence[Recording], rate_hz: float, excluded: Exclusions, doubts: Doubts) -> list[StrokeBlocks]:
    """Every stretch in blocks. FitError where none can be used."""
    strokes = excluded.each(
        stretches, lambda each: blocks_of(without_invalid_samples(each, "texture"), rate_hz, doubts)
    )
    if not strokes:
        raise excluded.refused("none of the recordings can be used")
    report_cleaning([each.kept for each in strokes], doubts)
    report_exclusions(excluded, [each.kept.recording for each in strokes], doubts)
    dropped = sum(each.lost for each in strokes)
    lost = dropped / (dropped + sum(len(each.density) for each in strokes))
    doubts.at_most("part left out", lost, f"{100 * lost:.0f} % of the strokes are left out")
    return strokes


@dataclass(frozen=True, slots=True)
class _Blocks:
    """The blocks of all strokes together: names, stroke's number, speed, force and RMS of each (blocks,)."""

    names: list[str]
    stroke: Ints
    frequency: Floats
    """(frequencies,) up to where the spectra sink into the sensor's hiss; how they go on from there is `tail`."""
    density: Floats
    """(blocks, frequencies)."""
    tail: Tail | None
    speed: Floats
    force: Floats
    moments: Floats
    """(blocks, 3), as of StrokeBlocks."""
    rms: Floats

    @classmethod
    def of(cls, strokes: Sequence[StrokeBlocks], excluded: Exclusions) -> _Blocks:
        """FitError for too few of them, and for an RMS that is no texture's."""
        density = np.concatenate([each.density for each in strokes])
        if len(density) < LEAST_BLOCKS:
            raise excluded.refused(
                f"{len(density) * BLOCK_S:g} s of strokes are too few: at least {LEAST_BLOCKS * BLOCK_S:g} s are needed"
            )
        names = [each.name for each in strokes for _ in each.density]
        frequency = strokes[0].frequency_hz
        power = density.sum(axis=1) * frequency[1]
        rough = (density / power[:, None]).mean(axis=0)
        top, tail = top_of(frequency, rough, float(np.mean([each.floor for each in strokes]) / np.median(power)))
        heard = frequency <= top
        frequency, density = frequency[heard], density[:, heard]
        power = density.sum(axis=1) * frequency[1]
        if power.min() <= 0:
            raise FitError(f"{names[int(np.argmin(power))]}: what is there is no more than the sensor's hiss")
        rms = np.sqrt(power)
        usual = float(np.median(rms))
        least, most = RMS_M_PER_S2
        if not least <= usual <= most:
            raise FitError(
                f"an RMS of {usual:.3g} m/s^2 is no texture's ({least:g} to {most:g}): is its unit another one?"
            )
        return cls(
            names=names,
            stroke=np.repeat(np.arange(len(strokes)), [len(each.density) for each in strokes]),
            frequency=frequency,
            density=density,
            tail=tail,
            speed=np.concatenate([each.speed for each in strokes]),
            force=np.concatenate([each.force for each in strokes]),
            moments=np.concatenate([each.moments for each in strokes]),
            rms=rms,
        )

    def centroid(self, density: Floats) -> float:
        """Mean frequency of a density (frequencies,), in Hz."""
        return centroid_of(self.frequency, density, self.tail)

    def reported(self, centroid: Floats) -> tuple[Block, ...]:
        """What the report says of each."""
        figures = zip(self.names, self.speed, self.force, self.rms, centroid, strict=True)
        return tuple(Block(name, float(v), float(f), float(r), float(c)) for name, v, f, r, c in figures)


def _doubt_the_recordings(recordings: Sequence[Recording], rate_hz: float, doubts: Doubts) -> None:
    """Wrong units, and hum."""
    report_gravity(recordings, doubts)
    report_lines(
        len(recordings),
        lambda place, needed: spectral_lines(acceleration_of(recordings[place]), rate_hz, needed),
        doubts,
    )


@dataclass(frozen=True, slots=True)
class _Loudness:
    """RMS of each block as its law has it (blocks,), and the gains of the law."""

    rms: Floats
    gains: tuple[Estimate, Estimate] | tuple[None, None]
    correlation: float


def _loudness(blocks: _Blocks, autoregressive: bool, doubts: Doubts) -> _Loudness:
    """The law over speed and force; where these do not vary apart, the mean of each stroke, if models need no law."""
    speed, force = blocks.speed, blocks.force
    if well_conditioned(np.column_stack((speed, force)), 20):
        return _law(blocks.moments, blocks.rms, doubts)
    if not autoregressive:
        raise FitError(
            f"speed ({speed.min():.3g} to {speed.max():.3g} m/s) and force ({force.min():.3g} to {force.max():.3g} N) "
            "rise and fall together or not at all, so that their gains cannot be told apart: vary them on their own"
        )
    doubts.warn("speed and force vary too little, or together: no gains")
    means = np.array([np.mean(blocks.rms[blocks.stroke == each]) for each in np.unique(blocks.stroke)])
    return _Loudness(means[blocks.stroke], (None, None), math.nan)


def _doubt_the_peak(peak: Peak, autoregressive: bool, doubts: Doubts) -> None:
    """Whether there is one; autoregressive models have the spectrum as it is."""
    if not peak.resolved:
        tell = doubts.warn if autoregressive else doubts.doubt
        tell(
            f"the peak is not resolved: the spectrum is broad, or highest below {LOW_HZ:g} Hz; it lies between 0 and "
            f"{peak.hz.high:.3g} Hz, and {peak.hz.value:.3g} Hz is a guess (--ar needs no peak)"
        )
    elif not autoregressive:
        doubts.check_interval("peak frequency", peak.hz)


def _compare(
    frequency: Floats, density: Floats, peak_hz: float, mean_hz: float, rate_hz: float, doubts: Doubts
) -> None:
    """The recorded spectrum with that of the material, which knows peak and mean alone."""
    model = power_spectrum(stochastic_filter(peak_hz, mean_hz, rate_hz), frequency, rate_hz)
    power = density / (density.sum() * frequency[1])
    apart = spectral_distance_db(frequency, model, np.maximum(power, 1e-6 * power.max()))
    doubts.at_most(
        "decibels between the spectra",
        apart,
        f"noise with this peak and mean has another spectrum than the recorded one, {apart:.1f} dB apart",
        "--ar takes the spectrum as it is",
    )


def _summary(blocks: int, peak: Peak, mean: Estimate, models: int) -> str:
    place = f"peak at {peak.hz.value:.4g} Hz" if peak.resolved else f"peak below {peak.hz.high:.3g} Hz"
    return f"{blocks * BLOCK_S:g} s of noise with its {place} and its mean at {mean.value:.4g} Hz" + (
        f", {models} autoregressive models" if models else ""
    )


def _usual_rate(recordings: Sequence[Recording]) -> float:
    """Of most of them."""
    rates = [recording.rate_hz for recording in recordings]
    if not rates:
        raise FitError("no recordings")
    return max(rates, key=rates.count)


# ---- Laws -----------------------------------------------------------------------------------------------------


def _law(moments: Floats, rms: Floats, doubts: Doubts) -> _Loudness:
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
            doubts.doubt(f"the {name} gain is negative: {gain.low:.3g} to {gain.high:.3g}")
        elif gain.low <= 0:
            doubts.doubt(f"the {name} gain may be 0: {gain.low:.3g} to {gain.high:.3g}")
        else:
            doubts.check_gain(name, gain, float(np.sqrt(np.median(square))), float(np.median(rms)))
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
    return _Loudness(law, (velocity_gain, force_gain), correlation)


class _TwoTextures(FitError):
    """A recording is of more than one texture, or of none."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(reason)
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
    if not well_conditioned(columns):
        doubts.warn("too few speeds and forces to tell whether the frequency moves with them")
        return None, None
    line = least_squares(columns, centroid)
    by_speed, by_force, _ = line.coefficients
    # So seldom by chance that a good fit is not called fair for it.
    wider = student_t(line.freedom, SELDOM) / student_t(line.freedom)
    for slope, values, name, unit in ((by_speed, speed, "speed", "m/s"), (by_force, force, "force", "N")):
        change = slope.value * float(np.ptp(values))
        if abs(slope.value) > wider * (slope.high - slope.value) and abs(change) > MOVES * mean_hz:
            doubts.doubt(
                f"the mean frequency moves with {name}: by {change:+.3g} Hz from {values.min():.3g} to "
                f"{values.max():.3g} {unit}"
            )
    return by_speed, by_force
