"""Grooves from recorded strokes: spacing, the mode of one groove, and how hard a groove strikes.

Okamura, Dennerlein and Howe, "Vibration Feedback Models for Virtual Environments", ICRA 1998, eq. 2: each groove that
passes strikes a mode with A(v, F) = velocity_gain |v| + force_gain F.

Between two strikes the acceleration is one free ringing, Im(z exp((-B + i w) t)), beside a drift. So, for each B and w,
every interval is a separate linear fit, whatever came before it and however near the strikes are; B and w are
those that leave the least (variable projection). A strike is the step in z from what is left of the ringing before
it to the ringing after it: z' - z exp(p dt) = A exp(-p d), whose phase -w d tells how much later than assumed it
struck, and whose size is A. Onsets are first found as steps of z in two windows, one on either side of each sample.

Frequency and decay are fitted over groups of strikes; their scatter gives the intervals, and shows whether they move
with speed or force. The gains are an M-estimate, so that a few strikes of another kind do not pull them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.robust import Robust, robust
from hapticd.analysis.statistics import Estimate, FitError, Floats, common, least_squares, well_conditioned
from hapticd.config.modes import Mode
from hapticd.fit.duplicates import refuse_duplicates
from hapticd.fit.exclusions import Exclusion, Exclusions, report_exclusions
from hapticd.fit.invalid_samples import without_invalid_samples
from hapticd.fit.plain_data import plain
from hapticd.fit.recording import Recording
from hapticd.fit.recording_checks import check_force_varies, report_cleaning, report_gravity, report_sampling
from hapticd.fit.spectral_lines import report_lines
from hapticd.fit.stretches import stretches_of
from hapticd.fit.strikes.spacing import slope_of_row
from hapticd.fit.strikes.stroke import GROUP, Group, Strike, Stroke, StrokeFit
from hapticd.fit.verdict import Doubts, Verdict

LEAST_S: Final = 0.1
"""Of a stretch of a recording, between gaps and clipped samples."""
SAME_SPACING: Final = 0.03
"""Recordings whose spacings differ by more are not of the same grooves."""
SAME_MODE: Final = 0.25
"""Recordings whose frequencies differ by more do not ring with the same mode."""
AMPLITUDES_M_PER_S2: Final = (0.1, 5000.0)
"""Of a usual strike; less is not felt."""
MOVES: Final = 0.02
"""A change of frequency over the speeds or forces of the recordings that is worth telling, as a part of it."""
WIDTH: Final = 0.25
"""Width over spacing that is written: strokes do not show it, and vibration does not use it."""


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
    left_out: tuple[Exclusion, ...] = ()

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


def fit_grooves(recordings: Sequence[Recording], excluded: Exclusions | None = None) -> GroovesFit:
    """Of strokes at several speeds and forces, one or more to a recording. FitError where they do not say it.

    Recordings, and stretches of them, that cannot be used are reported in `excluded`.
    """
    excluded = Exclusions() if excluded is None else excluded
    doubts = Doubts()
    fits = _fitted_strokes(recordings, excluded, doubts)
    recordings = [each.kept.recording for each in fits]
    modes = [_mean_mode(each.groups) for each in fits]
    groups = [group for each in fits for group in each.groups]
    if len(groups) < 2:
        raise excluded.refused(f"{len(groups)} group of strikes has no interval: needs {2 * GROUP} strikes")
    frequency = common(np.array([group.mode.frequency_hz for group in groups]))
    decay = common(np.array([group.mode.decay_time_s for group in groups]))
    strikes = tuple(strike for each, mode in zip(fits, modes, strict=True) for strike in each.strikes(mode))
    strokes = tuple(each.stroke(mode) for each, mode in zip(fits, modes, strict=True))
    _doubt_the_recordings(recordings, fits, strokes, frequency, doubts)
    spacing = _spacing(fits)
    points = _Points.of(strikes, np.concatenate([one.shifts(mode) for one, mode in zip(fits, modes, strict=True)], 1))
    points.check(recordings, doubts)
    gains = _gains(points, doubts)
    _report_outliers(gains.law, strikes, doubts)
    offset = _offset(points, doubts)
    _doubt_the_correlation(gains.correlation, doubts)
    by_speed, by_force = _moved(groups, frequency.value, doubts)
    accounted = _accounted(strokes, doubts)
    for what, figure in (("spacing", spacing), ("frequency", frequency), ("decay time", decay)):
        doubts.check_interval(what, figure)
    summary = (
        f"{len(strikes)} strikes {1e3 * spacing.value:.4g} mm apart, {frequency.value:.4g} Hz, decay time "
        f"{1e3 * decay.value:.3g} ms, amplitudes with a correlation of {gains.correlation:.2f}"
    )
    return GroovesFit(
        spacing_m=spacing,
        frequency_hz=frequency,
        decay_time_s=decay,
        velocity_gain_per_s=gains.velocity,
        force_gain_m_per_s2_per_n=gains.force,
        correlation=gains.correlation,
        offset_m_per_s2=offset,
        frequency_per_speed_hz_s_per_m=by_speed,
        frequency_per_force_hz_per_n=by_force,
        variance_accounted_for=accounted,
        strikes=strikes,
        strokes=strokes,
        warnings=tuple(doubts.warnings),
        judged=doubts.judged(summary),
        left_out=tuple(excluded.items),
    )


# ---- Stages, in their order ----------------------------------------------------------------------------------------


def _fitted_strokes(recordings: Sequence[Recording], excluded: Exclusions, doubts: Doubts) -> list[StrokeFit]:
    """Every stretch of a stroke separately. FitError where none can be used, or where they are of different grooves."""
    refuse_duplicates(recordings)
    stretches = stretches_of(recordings, LEAST_S, excluded)
    fits = excluded.each(stretches, lambda each: StrokeFit(without_invalid_samples(each, "grooves")))
    if not fits:
        raise excluded.refused(f"none of {len(recordings)} recordings can be used")
    report_cleaning([each.kept for each in fits], doubts)
    report_exclusions(excluded, recordings, doubts)
    _refuse_others(fits)
    return fits


def _doubt_the_recordings(
    recordings: Sequence[Recording],
    fits: Sequence[StrokeFit],
    strokes: Sequence[Stroke],
    frequency: Estimate,
    doubts: Doubts,
) -> None:
    """Wrong units, hum, strikes that follow one another too soon, and a rate that is too low."""
    report_gravity(recordings, doubts)
    report_lines(len(strokes), lambda place, needed: strokes[place].lines(needed), doubts)
    for each in fits:
        doubts.at_least(
            "cycles from strike to strike",
            each.cycles,
            f"{each.name}: strikes follow within {each.cycles:.1f} cycles: their mode is hard to tell",
            "stroke more slowly",
        )
    report_sampling(recordings, frequency.value, doubts)


@dataclass(frozen=True, slots=True)
class _Points:
    """What the law is fitted to: of every strike (n,) speed, force and amplitude."""

    speed: Floats
    force: Floats
    amplitude: Floats
    shifts: Floats
    """(2, n) what one standard error of frequency and of decay does to the amplitudes, all at once."""

    @classmethod
    def of(cls, strikes: Sequence[Strike], shifts: Floats) -> _Points:
        return cls(
            np.array([abs(strike.speed_m_per_s) for strike in strikes]),
            np.array([strike.force_n for strike in strikes]),
            np.array([strike.amplitude_m_per_s2 for strike in strikes]),
            shifts,
        )

    @property
    def both(self) -> Floats:
        """(n, 2) speed and force."""
        return np.column_stack((self.speed, self.force))

    @property
    def usual(self) -> float:
        """A usual amplitude, m/s^2."""
        return float(np.median(np.abs(self.amplitude)))

    def check(self, recordings: Sequence[Recording], doubts: Doubts) -> None:
        """FitError for amplitudes that are no grooves', and where speed and force do not vary apart."""
        least, most = AMPLITUDES_M_PER_S2
        if not least <= self.usual <= most:
            raise FitError(
                f"strikes of {self.usual:.3g} m/s^2 are no grooves' ({least:g} to {most:g}): is its unit another one?"
            )
        check_force_varies(recordings, self.force, doubts)
        if not well_conditioned(self.both, 20):
            raise FitError(
                f"speed ({self.speed.min():.3g} to {self.speed.max():.3g} m/s) and force ({self.force.min():.3g} to "
                f"{self.force.max():.3g} N) rise and fall together or not at all, so that their gains cannot be told "
                "apart: vary them on their own"
            )


@dataclass(frozen=True, slots=True)
class _Gains:
    """Of speed and of force, none below 0; `law` is the fit of both, whatever their signs."""

    velocity: Estimate
    force: Estimate
    correlation: float
    law: Robust


def _gains(points: _Points, doubts: Doubts) -> _Gains:
    """The amplitudes over speed and force. FitError where a gain is negative beyond doubt."""
    law = robust(points.both, points.amplitude, points.shifts)
    velocity_gain, force_gain = law.coefficients
    correlation = law.correlation
    for which, (name, gain) in enumerate((("velocity", velocity_gain), ("force", force_gain))):
        if gain.high < 0:
            raise FitError(
                f"the {name} gain comes out negative ({gain.low:.3g} to {gain.high:.3g}): "
                "strikes that weaken are not of this model; is a column swapped?"
            )
        if gain.low <= 0:
            doubts.doubt(f"the {name} gain may be 0: {gain.low:.3g} to {gain.high:.3g}")
        else:
            doubts.check_gain(name, gain, float(np.median(points.both[:, which])), points.usual)
        if gain.value < 0:
            alone = robust(points.both[:, [1 - which]], points.amplitude, points.shifts)
            kept, none = alone.coefficients[0], Estimate(0.0, 0.0, max(0.0, gain.high))
            velocity_gain, force_gain = (none, kept) if which == 0 else (kept, none)
            correlation = alone.correlation
    return _Gains(velocity_gain, force_gain, correlation, law)


def _offset(points: _Points, doubts: Doubts) -> Estimate | None:
    """A constant beside the two gains, which the model does not have; None where it cannot be separated from them."""
    columns = np.column_stack((points.both, np.ones_like(points.speed)))
    if len(columns) <= 3 or not well_conditioned(columns):
        return None
    offset = robust(columns, points.amplitude, points.shifts).coefficients[2]
    if offset.excludes_zero:
        doubts.at_most(
            "offset",
            abs(offset.value) / float(points.amplitude.mean()),
            f"amplitudes have an offset of {offset.value:.3g} m/s^2 ({offset.low:.3g} to {offset.high:.3g})",
            "the two gains do not have it",
        )
    return offset


def _doubt_the_correlation(correlation: float, doubts: Doubts) -> None:
    """Whether speed and force say what the amplitude is."""
    doubts.at_least(
        "correlation of the law",
        correlation,
        f"speed and force explain the amplitudes poorly: correlation {correlation:.2f}",
        "the gains in the material say little",
    )


def _spacing(fits: Sequence[StrokeFit]) -> Estimate:
    """One spacing for all; where a row begins is its own. A strike whose ringing is cut short may lie anywhere."""
    parts = [each.row for each in fits]
    place = np.concatenate([each - each.mean() for each, _ in parts])
    number = np.concatenate([each - each.mean() for _, each in parts])
    which = np.repeat(np.arange(len(parts)), [len(each) for each, _ in parts])
    # Whichever way they were stroked.
    turned = np.array([math.copysign(1.0, slope_of_row(each, at)) for at, each in parts])
    columns = np.column_stack((number * turned[which], which[:, None] == np.arange(len(parts))))
    return robust(columns, place, grows=False).coefficients[0]


def _mean_mode(groups: Sequence[Group]) -> Mode:
    """Of one stroke."""
    return Mode(
        1 / float(np.mean([group.mode.decay_time_s for group in groups])),
        float(np.mean([group.mode.angular_frequency_rad_per_s for group in groups])),
    )


def _report_outliers(law: Robust, strikes: Sequence[Strike], doubts: Doubts) -> None:
    """Strikes that have no weight in the law."""
    if law.outliers:
        first = strikes[law.outliers[0]]
        reason = f"{len(law.outliers)} of {len(strikes)} strikes are far off the others and do not count"
        doubts.warn(f"{reason}; the first: {first.recording} at {first.time_s:.4g} s")
        doubts.at_most("part left out", len(law.outliers) / len(strikes), reason)


def _refuse_others(fits: Sequence[StrokeFit]) -> None:
    """FitError where recordings are not of the same grooves, or not of the same mode."""
    spacings = np.array([abs(slope_of_row(each.row[1], each.row[0])) for each in fits])
    frequencies = np.array([each.mode.frequency_hz for each in fits])
    for values, most, what, unit, scale in (
        (spacings, SAME_SPACING, "grooves", "mm apart", 1e3),
        (frequencies, SAME_MODE, "ringing at", "Hz", 1.0),
    ):
        middle = float(np.median(values))
        off = np.abs(values / middle - 1)
        if off.max() > most:
            k = int(np.argmax(off))
            raise FitError(
                f"{fits[k].name}: {what} {scale * values[k]:.4g} {unit}, those of the other recordings "
                f"{scale * middle:.4g}: other grooves, or strokes so fast that strikes cannot be told apart"
            )


def _moved(groups: Sequence[Group], frequency_hz: float, doubts: Doubts) -> tuple[Estimate | None, Estimate | None]:
    """Slopes of the frequency over speed and force, where both vary apart from each other and from a constant."""
    speed = np.array([group.speed_m_per_s for group in groups])
    force = np.array([group.force_n for group in groups])
    columns = np.column_stack((speed, force, np.ones_like(speed)))
    if len(groups) < 6 or not well_conditioned(columns):
        doubts.warn("too few strokes at different speeds and forces to tell whether the frequency moves with them")
        return None, None
    frequencies = np.array([group.mode.frequency_hz for group in groups])
    by_speed, by_force, _ = least_squares(columns, frequencies).coefficients
    for slope, values, name, unit in ((by_speed, speed, "speed", "m/s"), (by_force, force, "force", "N")):
        change = slope.value * float(np.ptp(values))
        if slope.excludes_zero and abs(change) > MOVES * frequency_hz:
            doubts.doubt(
                f"the frequency moves with {name}: by {change:+.3g} Hz from {values.min():.3g} to "
                f"{values.max():.3g} {unit}; "
                "the material has the mean"
            )
    return by_speed, by_force


def _accounted(strokes: Sequence[Stroke], doubts: Doubts) -> float:
    """The part of the variance that strikes of one mode explain."""
    accounted = float(np.mean([stroke.variance_accounted_for for stroke in strokes]))
    doubts.at_least(
        "variance that grooves explain",
        accounted,
        f"one mode accounts for {100 * accounted:.0f} % of the variance",
        "grooves ring with more",
    )
    return accounted
