"""Taps: slope, frequency and decay of the ringing at a touch, from recordings of taps at several speeds.

Each tap is found and fitted alone (taps/events.py, taps/ringing.py), and then weighed with the others: frequency and
decay as what the taps have in common, the amplitude as a function of the approach speed (taps/amplitude.py). Weights
are of the signal to the noise of a tap; its own error bars, which follow its own luck, do not enter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import (
    Estimate,
    FitError,
    Regression,
    common,
    require_scipy,
    through_origin,
    with_offset,
)
from hapticd.base.yaml_source import Json
from hapticd.config.modes import Attack, Mode
from hapticd.fit.duplicates import refuse_duplicates
from hapticd.fit.exclusions import Exclusion, Exclusions, mostly_excluded
from hapticd.fit.plain_data import end_of, fields_of
from hapticd.fit.recording import Recording, Source
from hapticd.fit.recording_checks import report_sampling
from hapticd.fit.spectral_lines import SpectralLine, lines_in_residual, report_lines
from hapticd.fit.taps.amplitude import Law, LawKind, Power, doubt_the_law, law_of
from hapticd.fit.taps.events import hits_of
from hapticd.fit.taps.hit import LEAST_TAPS, WELL_EXPLAINED, Figures, Hit, TapHit, check_speeds
from hapticd.fit.taps.lack_of_fit import lack_of_fit
from hapticd.fit.taps.law import TABLE as TABLE
from hapticd.fit.taps.law import Amplitudes, check_hardness, check_slope, json_table, single_outlier
from hapticd.fit.taps.modes import Modes, modes_of
from hapticd.fit.taps.second_mode import SecondMode, as_pairs, second_mode
from hapticd.fit.verdict import Doubts, Verdict

LEAST_HZ: Final = 15.0
"""What is slower than this is a hand's motion."""
OTHER_WAY: Final = 0.25
"""Of the taps may begin the other way, and are left out."""


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
    left_out: tuple[Exclusion, ...] = ()

    @property
    def verdict(self) -> str:
        return str(self.judged)

    @property
    def choices(self) -> dict[str, str]:
        """What was chosen of several models, and why."""
        chosen = {"amplitude": f"{self.law.named}: {self.law.why}"}
        return chosen if self.modes is None else {**chosen, "mode_table": self.modes.why}

    @property
    def linear(self) -> bool:
        """Whether a line through the origin does for A(v)."""
        return self.law.kind == "line"

    @property
    def amplitudes(self) -> Amplitudes:
        """The coefficient over the speed, as `amplitudes` of a material has it: straight lines from rest to the first
        speed and from one to the next; those of the power law, where A(v) is one."""
        return self.law.points

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
            tap: dict[str, Json] = {"attack_slope_per_s": slope.value}
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
            tap = {
                "amplitudes": [[speed, part * each.value] for part, (speed, each) in zip(parts, points, strict=True)]
            }
        return tap if attack == "coefficient" else {**tap, "attack": attack}

    def to_dict(self) -> dict[str, Json]:
        """As JSON has it, without the stretches."""
        figures = ("slope_per_s", "first_peak_slope_per_s", "frequency_hz", "decay_time_s", "offset_slope_per_s")
        shares = ("r_squared", "r_squared_offset", "variance_accounted_for")
        return {
            **fields_of(self, *figures, "offset_m_per_s2", *shares),
            "linear": self.linear,
            "law": self.law.to_dict(),
            "modes": None if self.modes is None else self.modes.to_dict(),
            "amplitudes": json_table(self.amplitudes),
            "second": None if self.second is None else self.second.to_dict(),
            "taps": [tap.to_dict() for tap in self.taps],
            **end_of(self),
        }


def fit_tap(
    recordings: Sequence[Recording],
    progress: Callable[[Recording], None] | None = None,
    excluded: Exclusions | None = None,
) -> TapFit:
    """Fits the taps of one material; `progress` is called after each recording. Recordings and taps that cannot be used
    are reported in `excluded`.

    Raises FitError (one line) for what they do not support: no onset, too few taps, all at one speed, clipped, sampled
    too slowly, units that cannot be.
    """
    require_scipy()
    excluded = Exclusions() if excluded is None else excluded
    warnings: list[str] = []
    hits, second = _found(recordings, progress, warnings, excluded)
    warnings = excluded.lines() + warnings
    taps = tuple(tap for tap, _ in hits)
    check_speeds(taps)
    figures = Figures.of(hits)
    lines = _Lines.of(figures)
    frequency, decay_time = _common_mode(figures, lines.slope, taps)
    explained = float(np.median([tap.variance_accounted_for for tap in taps]))
    if second is None:
        second = second_mode(hits, explained)
    outlier = single_outlier(taps, figures.speeds, figures.amplitudes, figures.noise)
    law = law_of(figures.speeds, figures.amplitudes, figures.of_amplitude, "line" if outlier else None)
    doubts = Doubts()
    _doubt_the_recordings(doubts, recordings, taps, frequency)
    _doubt_the_mode(doubts, hits, second, explained, warnings)
    modes = _modes_over_speed(doubts, figures, frequency, decay_time)
    _doubt_the_law(doubts, law, outlier, lines.through_origin.r_squared)
    doubts.add(False, mostly_excluded(excluded, len(taps), "tap"))
    warnings += doubts.warnings
    return TapFit(
        taps=taps,
        slope_per_s=lines.slope,
        first_peak_slope_per_s=lines.of_peaks.coefficients[0],
        frequency_hz=frequency,
        decay_time_s=decay_time,
        modes=modes,
        r_squared=lines.through_origin.r_squared,
        offset_slope_per_s=lines.with_offset.coefficients[0],
        offset_m_per_s2=lines.with_offset.coefficients[1],
        r_squared_offset=lines.with_offset.r_squared,
        variance_accounted_for=explained,
        law=law,
        power=law.power if law.kind == "power" else None,
        second=second,
        sources=tuple(recording.source for recording in recordings),
        warnings=tuple(warnings),
        judged=doubts.judged(
            f"{_modes(second)} {100 * explained:.1f} % of {len(taps)} taps",
            f"A(v) is {law.named} (r^2 {(law if law.kind != 'line' else lines.through_origin).r_squared:.3f})",
        ),
        left_out=tuple(excluded.items),
    )


def _found(
    recordings: Sequence[Recording],
    progress: Callable[[Recording], None] | None,
    warnings: list[str],
    excluded: Exclusions,
) -> tuple[list[Hit], SecondMode | None]:
    """The taps of all recordings, all of which begin the same way, and their second mode where one does not do."""
    refuse_duplicates(recordings)

    def hits_in(recording: Recording) -> list[Hit]:
        found = hits_of(recording, warnings, excluded)
        if progress is not None:
            progress(recording)
        return found

    hits, second = as_pairs([hit for found in excluded.each(recordings, hits_in) for hit in found], excluded)
    if len(hits) < LEAST_TAPS:
        raise excluded.refused(f"{len(hits)} taps are too few: needs {LEAST_TAPS}, better ten, at different speeds")
    return _of_one_sign(hits, warnings, excluded), second


@dataclass(frozen=True, slots=True)
class _Lines:
    """Amplitudes over the speed: a line through the origin, one with an offset, and one of the first peaks."""

    through_origin: Regression
    with_offset: Regression
    of_peaks: Regression

    @classmethod
    def of(cls, figures: Figures) -> _Lines:
        """FitError where the amplitude does not rise with the speed."""
        # Taps differ by parts of their amplitudes.
        over = (figures.speeds, figures.amplitudes, figures.of_amplitude, figures.speeds**2)
        of_peaks = through_origin(figures.speeds, figures.peaks, figures.of_peak, figures.speeds**2)
        found = cls(through_origin(*over), with_offset(*over), of_peaks)
        check_slope(found.slope)
        return found

    @property
    def slope(self) -> Estimate:
        """Of the line through the origin."""
        return self.through_origin.coefficients[0]


def _common_mode(figures: Figures, slope: Estimate, taps: Sequence[TapHit]) -> tuple[Estimate, Estimate]:
    """Frequency and decay time of all taps. FitError where they are no touch's."""
    decay = common(figures.decays, figures.of_decay)
    angular = common(figures.angulars, figures.of_angular)
    check_hardness(slope.value, math.exp(angular.value), "the angular frequency")
    frequency = angular.mapped(lambda log: math.exp(log) / (2 * math.pi))
    decay_time = decay.mapped(lambda log: math.exp(-log))
    _check_ringing(frequency.value, decay_time.value, taps)
    return frequency, decay_time


def _doubt_the_recordings(
    doubts: Doubts, recordings: Sequence[Recording], taps: Sequence[TapHit], frequency: Estimate
) -> None:
    """Hum, and a rate that is too low."""
    of_taps = [each for each in recordings if any(tap.recording == each.name for tap in taps)]
    report_lines(len(of_taps), lambda place, needed: _lines_in_rest(of_taps[place], taps, needed), doubts)
    report_sampling(of_taps, frequency.value, doubts)


def _lines_in_rest(recording: Recording, taps: Sequence[TapHit], needed: int) -> list[SpectralLine]:
    """Of what the taps leave of a recording."""
    seen = recording.acceleration_m_per_s2
    assert seen is not None
    own = [tap for tap in taps if tap.recording == recording.name]
    model = np.full(len(seen), np.median(seen))
    for tap in own:
        begin = round(tap.begin_s * tap.rate_hz)
        sign = 1.0 if np.dot(seen[begin : begin + len(tap.measured)], tap.measured) >= 0 else -1.0
        model[begin : begin + len(tap.measured)] = sign * tap.modelled
    return lines_in_residual(seen, model, recording.rate_hz, needed)


def _modes(second: SecondMode | None) -> str:
    return "two modes explain" if second is not None and second.kept else "one mode explains"


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
        doubts.add(False, *lack_of_fit(hits))


def _modes_over_speed(doubts: Doubts, figures: Figures, frequency: Estimate, decay_time: Estimate) -> Modes | None:
    """Frequency and decay over the speed, where they change with it; else they should be the same for all."""
    modes = modes_of(figures, frequency, decay_time)
    if modes is None:
        doubts.check_interval("decay time", decay_time)
    expected = 0.0 if modes is None else np.log(modes.frequency_at(figures.speeds))
    scatter = float(np.std(figures.angulars - expected))
    doubts.at_most(
        "scatter of the frequency",
        scatter,
        f"the frequency scatters by {100 * scatter:.0f} % between taps",
        "is it one material, held alike?",
    )
    if modes is not None:
        doubts.warn(f"{modes.why}; the material has a table of modes over the speed")
    return modes


def _doubt_the_law(doubts: Doubts, law: Law, outlier: str, r_squared: float) -> None:
    """Whether the speed says what the amplitude is; `r_squared` of the line."""
    if outlier:
        doubts.add(False, outlier, "is its speed right?")
        return
    if law.kind != "line":
        doubts.warn(f"A(v) is {law.named}, no line through the origin: {law.why}")
    doubt_the_law(doubts, law, r_squared)


def _of_one_sign(hits: list[Hit], warnings: list[str], excluded: Exclusions) -> list[Hit]:
    """With positive coefficients."""
    signs = [math.copysign(1.0, tap.coefficient_m_per_s2) for tap, _ in hits]
    usual = 1.0 if sum(signs) >= 0 else -1.0
    if usual < 0:
        warnings.append("the taps begin downwards: the acceleration is taken with its sign turned")
    found = []
    for sign, (tap, ringing) in zip(signs, hits, strict=True):
        if sign != usual:
            excluded.add(tap.recording, "it begins the other way than most", "tap", tap.onset_s)
            continue
        found.append((tap if usual > 0 else tap.turned(), ringing))
    other = len(hits) - len(found)
    if len(found) < LEAST_TAPS or (other > 1 and other > OTHER_WAY * len(hits)):
        raise FitError(
            f"{other} of {len(hits)} taps begin the other way: a surface pushes one way; is there something else among "
            "them, or is the rate too low?"
        )
    return found


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
