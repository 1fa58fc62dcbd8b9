"""Pictures in the report of each kind of fit."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats
from hapticd.config.materials import Material, validate_materials
from hapticd.config.texture import Autoregressive, Stochastic
from hapticd.fit.preparation import without_invalid_samples
from hapticd.fit.recording import Kind, Recording
from hapticd.fit.report import Curve, Page, Panel
from hapticd.fit.result import Fit, estimates, plain_figures
from hapticd.fit.ringing import fit_ringing
from hapticd.fit.speed_law import Amplitudes
from hapticd.fit.synthesize import level_of, unit_density
from hapticd.fit.verdict import COMPLETE_RECORDING, Exclusion
from hapticd.fit.waveform import PulseHit, WaveformFit

if TYPE_CHECKING:
    from hapticd.fit.grooves import GroovesFit
    from hapticd.fit.puncture import PunctureFit
    from hapticd.fit.tap import TapFit, TapHit
    from hapticd.fit.texture import TextureFit

Row: TypeAlias = tuple[Panel, ...]

MAX_DRAWN_RECORDINGS: Final = 3
"""A report draws at most this number of taps, strokes or recordings as examples, to stay short."""
ACCELERATION_UNIT: Final = "m/s²"
DENSITY_UNIT: Final = "(m/s²)²/Hz"


def page_of(
    kind: Kind, title: str, fit: Fit, recordings: Sequence[Recording], unused: Sequence[Recording] = ()
) -> Page:
    """Return the report of a fit of this kind, which also shows why `unused` recordings are left out."""
    sources = {recording.source.path: recording.source.sha256 for recording in recordings}
    drawn = _ROWS_BY_KIND[kind](fit, [_kept(each, kind) for each in recordings])
    rows = tuple(row for row in (*drawn, *_left_out(fit, [*recordings, *unused])) if row)
    return Page(title, fit.verdict, fit.warnings, estimates(fit), plain_figures(fit), tuple(sources.items()), rows)


def first_row(kind: Kind, fit: Fit, recordings: Sequence[Recording]) -> Row:
    """Return the first row of pictures in the report of a fit; it shows the events of all recordings together."""
    rows = _ROWS_BY_KIND[kind](fit, [_kept(each, kind) for each in recordings])
    return next((row for row in rows if row), ())


def _kept(recording: Recording, kind: Kind) -> Recording:
    """Return the recording as it was fitted, without impossible samples."""
    try:
        return without_invalid_samples(recording, kind).recording
    except FitError:
        return recording


def density(values: Floats, rate_hz: float, segment: int = 4096) -> tuple[Floats, Floats]:
    """Return the frequencies above 0 Hz, and the one-sided power spectral density there.

    The density is Welch's mean over Hann windows of `segment` samples that overlap by half.
    """
    from scipy.signal import welch

    frequency, power = welch(values, rate_hz, nperseg=min(segment, len(values)))
    return np.asarray(frequency[1:], dtype=np.float64), np.asarray(power[1:], dtype=np.float64)


def overlay(name: str, rate_hz: float, recorded: Floats, model: Floats) -> Row:
    """Return pictures of recording, model and residual over time, and of their spectra.

    `model` is NaN where nothing was fitted. The spectra are of the longest section without NaN. The pictures over time
    show 150 ms around this section.
    """
    modelled = np.flatnonzero(np.isfinite(model))
    if len(modelled) == 0:
        return ()
    section = max(np.split(modelled, np.flatnonzero(np.diff(modelled) > 1) + 1), key=len)
    around = max(0, round(0.15 * rate_hz) - len(section)) // 2
    first, last = max(int(modelled[0]), int(section[0]) - around), min(int(modelled[-1]), int(section[-1]) + around)
    here = slice(first, last + 1)
    ms: Floats = np.asarray(1e3 * np.arange(first, last + 1) / rate_hz, dtype=np.float64)
    lines = (Curve("recording", ms, recorded[here]), Curve("model", ms, model[here]))
    left = (Curve("recording less model", ms, recorded[here] - model[here]),)
    panels = (Panel(name, "ms", ACCELERATION_UNIT, lines), Panel("recording less model", "ms", ACCELERATION_UNIT, left))
    if len(section) < 16:
        return panels
    parts = (("recording", recorded), ("model", model), ("residual", recorded - model))
    spectra = tuple(Curve(label, *density(values[section], rate_hz)) for label, values in parts)
    return (*panels, Panel("spectrum", "Hz", DENSITY_UNIT, spectra, logarithmic=True))


def law(title: str, x_label: str, x: Floats, y: Floats, gain: Estimate, bent: Amplitudes = ()) -> Panel:
    """Return a picture of amplitudes versus speed or force and their model: a line through 0, or the points `bent`."""
    ends = np.linspace(0.0, 1.05 * float(np.max(x)), 50)
    dots = Curve("recorded", x, y, points=True)
    model = Curve("model", ends, gain.value * ends, low=gain.low * ends, high=gain.high * ends)
    line: tuple[Curve, ...] = ()
    if bent:
        line = (Curve("line through 0", ends, model.y, dashed=True),)
        at, y, low, high = np.array([(0.0,) * 4, *((at, each.value, each.low, each.high) for at, each in bent)]).T
        model = Curve("model", at, y, low=low, high=high)
    return Panel(title, x_label, ACCELERATION_UNIT, (dots, model, *line))


def level(title: str, x_label: str, y_label: str, x: Floats, y: Floats, value: Estimate) -> Panel:
    """Return a picture of values y that should be constant, and the fitted value with its interval."""
    ends = np.array([0.0, 1.05 * float(np.max(x))])
    flat = np.ones(2)
    line = Curve("model", ends, value.value * flat, low=value.low * flat, high=value.high * flat)
    return Panel(title, x_label, y_label, (Curve("recorded", x, y, points=True), line))


def compared(title: str, unit: str, modelled: Floats, recorded: Floats) -> Panel:
    """Return a picture of recorded versus modelled values, and the line on which they are equal."""
    ends = np.array([0.0, 1.05 * max(float(modelled.max()), float(recorded.max()))])
    curves = (Curve("recorded", modelled, recorded, points=True), Curve("equal to the model", ends, ends))
    return Panel(title, f"model, {unit}", f"recording, {unit}", curves)


def _tap(fit: TapFit | WaveformFit, recordings: Sequence[Recording]) -> Iterator[Row]:
    yield _waveform(fit) if isinstance(fit, WaveformFit) else _ringing(fit)
    taps: Sequence[TapHit | PulseHit] = fit.taps
    for tap in sorted(taps, key=lambda tap: -tap.speed_m_per_s)[:MAX_DRAWN_RECORDINGS]:
        name = f"{os.path.basename(tap.recording)}, {tap.speed_m_per_s:.3g} m/s"
        yield overlay(name, tap.rate_hz, tap.measured, tap.modelled)
        if isinstance(fit, WaveformFit) or fit.second is None:
            continue
        # A tap without a second mode has no such picture.
        with suppress(FitError):
            pair = fit_ringing(tap.measured, tap.rate_hz, modes=2)
            yield overlay(f"{name}, two modes", tap.rate_hz, tap.measured, tap.measured - pair.residual)


def _waveform(fit: WaveformFit) -> Row:
    speed, peak = _columns(fit.taps, "speed_m_per_s", "peak_m_per_s2")
    lines = law("largest acceleration of each tap", "m/s", speed, peak, fit.first_peak_slope_per_s, fit.amplitudes)
    samples, half = np.array(fit.samples), np.array(fit.deviations)
    ms: Floats = np.asarray(1e3 * np.arange(len(samples)) / fit.rate_hz, dtype=np.float64)
    fine = np.linspace(0.0, fit.length_s, 500)
    curves = (
        Curve("curve", 1e3 * fine, fit.curve.at(fine)),
        Curve("samples", ms, samples, low=samples - half, high=samples + half, points=True),
    )
    return (lines, Panel("waveform", "ms", "over the largest acceleration", curves))


def _ringing(fit: TapFit) -> Row:
    speed, amplitude, angular = _columns(
        fit.taps, "speed_m_per_s", "coefficient_m_per_s2", "angular_frequency_rad_per_s"
    )
    bent = () if fit.linear else fit.amplitudes
    lines = law("amplitude of each tap", "m/s", speed, amplitude, fit.slope_per_s, bent)
    ends = np.linspace(0.0, 1.05 * float(np.max(speed)), 50)
    offset = Curve("offset", ends, fit.offset_m_per_s2.value + fit.offset_slope_per_s.value * ends, dashed=True)
    curves = (*lines.curves, offset)

    def less(curve: Curve) -> Curve:
        """Return the curve of amplitudes minus the model."""
        model = np.interp(curve.x, curves[1].x, curves[1].y)
        low, high = (None if end is None else end - model for end in (curve.low, curve.high))
        return dataclasses.replace(curve, y=curve.y - model, low=low, high=high)

    return (
        dataclasses.replace(lines, curves=curves),
        Panel("amplitude less the model", "m/s", ACCELERATION_UNIT, tuple(map(less, curves))),
        level("frequency of each tap", "m/s", "Hz", speed, angular / (2 * np.pi), fit.frequency_hz),
    )


def _columns(events: Sequence[object], *names: str) -> tuple[Floats, ...]:
    """Return the values (n,) of each of these attributes of n events."""
    return tuple(np.array([getattr(each, name) for each in events], dtype=np.float64) for name in names)


def _left_out(fit: Fit, recordings: Sequence[Recording]) -> Iterator[Row]:
    """Yield pictures of partly used recordings, then of the first excluded events and recordings in detail."""
    seen = {each.name: each for each in recordings if each.acceleration_m_per_s2 is not None}
    excluded: list[Exclusion] = [each for each in fit.left_out if each.recording in seen]
    if not excluded:
        return
    used = [(tap.recording, tap.onset_s) for tap in getattr(fit, "taps", ())]
    both = dict.fromkeys(each.recording for each in excluded if each.recording in {name for name, _ in used})
    yield tuple(_marked(seen[name], used, excluded) for name in islice(both, MAX_DRAWN_RECORDINGS))
    drawable = [each for each in excluded if each.what == COMPLETE_RECORDING or each.time_s is not None]
    for first in (0, MAX_DRAWN_RECORDINGS):
        yield tuple(_not_used(seen[each.recording], each) for each in drawable[first : first + MAX_DRAWN_RECORDINGS])


def _marked(recording: Recording, used: Sequence[tuple[str, float]], excluded: Sequence[Exclusion]) -> Panel:
    """Return a picture of a recording, with marks above the events that were used or left out."""
    seen = recording.acceleration_m_per_s2
    assert seen is not None
    time_s = np.arange(len(seen)) / recording.rate_hz
    top = float(seen.max()) + 0.08 * float(np.ptp(seen))
    used_s = np.array([at_s for name, at_s in used if name == recording.name], dtype=np.float64)
    left_s = np.array(
        [each.time_s for each in excluded if each.recording == recording.name and each.time_s is not None],
        dtype=np.float64,
    )
    marks = (
        Curve("fitted", used_s, np.full(len(used_s), top), points=True),
        Curve("left out", left_s, np.full(len(left_s), top), points=True, crossed=True),
    )
    return Panel(os.path.basename(recording.name), "s", ACCELERATION_UNIT, (Curve("recording", time_s, seen), *marks))


def _not_used(recording: Recording, exclusion: Exclusion) -> Panel:
    """Return a picture of a recording near an excluded event, or of a complete excluded recording."""
    seen, rate_hz = recording.acceleration_m_per_s2, recording.rate_hz
    assert seen is not None
    first, last = 0, len(seen)
    if exclusion.time_s is not None:
        first = max(0, round((exclusion.time_s - 0.01) * rate_hz))
        last = min(last, round((exclusion.time_s + 0.06) * rate_hz) + 1)
    ms: Floats = np.asarray(1e3 * np.arange(first, last) / rate_hz, dtype=np.float64)
    name = os.path.basename(recording.name)
    return Panel(
        f"{name} left out: {exclusion.reason}", "ms", ACCELERATION_UNIT, (Curve("recording", ms, seen[first:last]),)
    )


def _grooves(fit: GroovesFit, recordings: Sequence[Recording]) -> Iterator[Row]:
    speed, force, amplitude = map(np.abs, _columns(fit.strikes, "speed_m_per_s", "force_n", "amplitude_m_per_s2"))
    by_speed, by_force = fit.velocity_gain_per_s, fit.force_gain_m_per_s2_per_n
    yield (
        law("amplitude less the force's part", "m/s", speed, amplitude - by_force.value * force, by_speed),
        law("amplitude less the speed's part", "N", force, amplitude - by_speed.value * speed, by_force),
        compared("amplitude", ACCELERATION_UNIT, by_speed.value * speed + by_force.value * force, amplitude),
    )
    for stroke in islice(fit.strokes, MAX_DRAWN_RECORDINGS):
        name = os.path.basename(stroke.name)
        yield overlay(name, stroke.rate_hz, stroke.acceleration_m_per_s2, stroke.model_m_per_s2)


def _texture(fit: TextureFit, recordings: Sequence[Recording]) -> Iterator[Row]:
    """Yield pictures that compare recording and model: RMS and mean frequency of each block, and spectra."""
    texture = _material(fit).texture
    assert isinstance(texture, Stochastic | Autoregressive)
    speed, force, rms, mean = _columns(fit.blocks, "speed_m_per_s", "force_n", "rms_m_per_s2", "mean_hz")
    modelled = np.concatenate([level_of(texture, speed[at : at + 1], force[at : at + 1]) for at in range(len(speed))])
    yield (
        compared("RMS of each half second", ACCELERATION_UNIT, modelled, rms),
        level("mean frequency", "m/s", "Hz", speed, mean, fit.mean_hz),
        level("mean frequency", "N", "Hz", force, mean, fit.mean_hz),
    )
    for recording in islice(filter(_is_complete, recordings), MAX_DRAWN_RECORDINGS):
        yield _power(recording, texture)


def _power(recording: Recording, texture: Stochastic | Autoregressive) -> Row:
    """Return pictures of the spectral densities of a recording and of the model at its speed and force."""
    acceleration, force, rate_hz = recording.acceleration_m_per_s2, recording.force_n, recording.rate_hz
    assert acceleration is not None and force is not None
    speed, force_n = _speed(recording), float(np.mean(force))
    frequency, recorded = density(acceleration, rate_hz, 2048)
    unit = unit_density(texture, speed, force_n, frequency, rate_hz)
    unit[unit == 0] = np.nan  # an autoregressive model has no density beyond half its rate
    modelled = level_of(texture, np.array([speed]), np.array([force_n])) ** 2 * unit
    decibels = 10 * np.log10(np.maximum(recorded, 1e-300) / np.maximum(modelled, 1e-300))
    loud = modelled > 1e-3 * np.nanmax(modelled)
    name = f"{os.path.basename(recording.name)}, {speed:.3g} m/s, {force_n:.3g} N"
    spectra = (Curve("recording", frequency, recorded), Curve("model", frequency, modelled))
    ratio = (Curve("recording over model", frequency[loud], decibels[loud]),)
    return (
        Panel(name, "Hz", DENSITY_UNIT, spectra, logarithmic=True),
        Panel("recording over model, at loud frequencies", "Hz", "dB", ratio),
    )


def _is_complete(recording: Recording) -> bool:
    """Return whether the recording of a stroke has acceleration, force and speed."""
    moves = recording.tangential_position_m is not None or recording.speed_m_per_s is not None
    return recording.acceleration_m_per_s2 is not None and recording.force_n is not None and moves


def _speed(recording: Recording) -> float:
    """Return the mean speed along the surface, m/s."""
    place = recording.tangential_position_m
    if place is not None:
        return abs(float(place[-1] - place[0])) * recording.rate_hz / (len(place) - 1)
    assert recording.speed_m_per_s is not None
    return float(np.mean(np.abs(recording.speed_m_per_s)))


def _puncture(fit: PunctureFit, recordings: Sequence[Recording]) -> Iterator[Row]:
    """Yield pictures of depth, force and amplitude of all ruptures, and of recorded forces and ringings."""
    material = _material(fit)
    rupture = material.rupture
    assert rupture is not None
    depth_m, mode = rupture.rupture_depth_m, rupture.mode
    speed, depth, force_n, amplitude = _columns(
        fit.ruptures, "speed_m_per_s", "depth_m", "force_n", "amplitude_m_per_s2"
    )
    mm = fit.depth_m.mapped(lambda metres: 1e3 * metres)
    yield (
        level("depth of each rupture", "m/s", "mm", speed, 1e3 * depth, mm),
        level("force of each rupture", "m/s", "N", speed, force_n, fit.force_n),
        level("amplitude of each rupture", "m/s", ACCELERATION_UNIT, speed, amplitude, fit.amplitude_m_per_s2),
    )
    broken = {each.recording: each for each in fit.ruptures}
    for recording in islice((each for each in recordings if each.name in broken), MAX_DRAWN_RECORDINGS):
        force, place, acceleration = recording.force_n, recording.position_m, recording.acceleration_m_per_s2
        assert force is not None and place is not None and acceleration is not None
        rate_hz = recording.rate_hz
        struck_s = broken[recording.name].time_s
        at = min(max(1, round(struck_s * rate_hz)), len(force) - 1)
        sign = 1.0 if place[at] >= place[0] else -1.0
        deflection = sign * (place - place[at]) + depth_m
        line = np.array([0.0, depth_m])
        forces = (
            Curve("recording", 1e3 * deflection, force),
            Curve("model", 1e3 * line, material.stiffness_n_per_m * line),
        )
        first = max(0, at - round(mode.decay_time_s * rate_hz))
        last = min(len(acceleration), at + round(5 * mode.decay_time_s * rate_hz))
        measured = acceleration[first:last] - np.median(acceleration[:at])
        since = np.arange(first, last) / rate_hz - struck_s
        later = np.maximum(since, 0.0)
        ringing = np.exp(-mode.decay_rate_per_s * later) * np.sin(mode.angular_frequency_rad_per_s * later)
        # The accelerometer may be mounted with either sign.
        turned = 1.0 if float(measured @ ringing) >= 0 else -1.0
        spring = Panel(os.path.basename(recording.name), "deflection, mm", "N", forces)
        yield (spring, *overlay("ringing", rate_hz, measured, turned * rupture.amplitude_m_per_s2 * ringing))


def _material(fit: Fit) -> Material:
    figures = {"stiffness_n_per_m": 0.0, **fit.material()}
    return validate_materials({"fitted": figures}, ("materials",))["fitted"]


_ROWS_BY_KIND: Final[Mapping[str, Callable[[Any, Sequence[Recording]], Iterator[Row]]]] = {
    "tap": _tap,
    "grooves": _grooves,
    "texture": _texture,
    "puncture": _puncture,
}
