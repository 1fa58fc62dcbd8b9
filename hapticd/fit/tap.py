"""Taps: slope, frequency and decay of the ringing at a touch, from recordings of taps at several speeds.

Each tap is found by itself, fitted by itself (ringing.py), and then weighed with the others: frequency and decay as
what the taps have in common, the amplitude as a line over the approach speed (regression.py). Weights are of the
signal to the noise of a tap; its own error bars, which follow its own luck, do not enter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, common, require_scipy, through_origin, with_offset
from hapticd.base.yaml_source import Json
from hapticd.config.modes import Attack, Mode
from hapticd.fit.duplicates import refuse_twins
from hapticd.fit.exclusions import Left, LeftOut, most_are_left_out
from hapticd.fit.recording import Recording, Source
from hapticd.fit.spectral_lines import Line, lines_beside, tell_lines
from hapticd.fit.strokes import tell_few_samples
from hapticd.fit.taps.amplitude import Law, LawKind, Power, doubt_the_law, law_of
from hapticd.fit.taps.events import hits_of
from hapticd.fit.taps.hit import LEAST_TAPS, WELL_EXPLAINED, Figures, Hit, TapHit, check_speeds
from hapticd.fit.taps.lack_of_fit import misfit
from hapticd.fit.taps.law import TABLE as TABLE
from hapticd.fit.taps.law import Amplitudes, check_hardness, check_slope, json_table, one_astray
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
    left_out: tuple[Left, ...] = ()

    @property
    def verdict(self) -> str:
        return str(self.judged)

    @property
    def choices(self) -> dict[str, str]:
        """What was chosen of several models, and why."""
        told = {"amplitude": f"{self.law.named}: {self.law.why}"}
        return told if self.modes is None else {**told, "mode_table": self.modes.why}

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
            told: dict[str, Json] = {"attack_slope_per_s": slope.value}
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
            told = {
                "amplitudes": [[speed, part * each.value] for part, (speed, each) in zip(parts, points, strict=True)]
            }
        return told if attack == "coefficient" else {**told, "attack": attack}

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
            told[name] = getattr(self, name).to_dict()
        told |= {
            "r_squared": self.r_squared,
            "r_squared_offset": self.r_squared_offset,
            "variance_accounted_for": self.variance_accounted_for,
            "linear": self.linear,
            "law": self.law.to_dict(),
            "modes": None if self.modes is None else self.modes.to_dict(),
            "amplitudes": json_table(self.amplitudes),
            "second": None if self.second is None else self.second.to_dict(),
            "taps": [tap.to_dict() for tap in self.taps],
            "left_out": [each.to_dict() for each in self.left_out],
            "warnings": list(self.warnings),
            "verdict": self.verdict,
            "judged": {"quality": self.judged.quality, "reasons": list(self.judged.reasons)},
        }
        return told


def fit_tap(
    recordings: Sequence[Recording],
    progress: Callable[[Recording], None] | None = None,
    left: LeftOut | None = None,
) -> TapFit:
    """Fits the taps of one material; `progress` is called after each recording. Recordings and taps that cannot be used
    are told to `left`.

    Raises FitError (one line) for what they do not support: no onset, too few taps, all at one speed, clipped, sampled
    too slowly, units that cannot be.
    """
    require_scipy()
    warnings: list[str] = []
    left = LeftOut() if left is None else left
    hits, second = _found(recordings, progress, warnings, left)
    warnings = left.lines() + warnings
    taps = tuple(tap for tap, _ in hits)
    check_speeds(taps)
    figures = Figures.of(hits)
    decay = common(figures.decays, figures.of_decay)
    angular = common(figures.angulars, figures.of_angular)
    # Taps differ by parts of their amplitudes.
    over = (figures.speeds, figures.amplitudes, figures.of_amplitude, figures.speeds**2)
    line, shifted = through_origin(*over), with_offset(*over)
    peak_line = through_origin(figures.speeds, figures.peaks, figures.of_peak, figures.speeds**2)
    slope = line.coefficients[0]
    check_slope(slope)
    check_hardness(slope.value, math.exp(angular.value), "the angular frequency")
    frequency = angular.mapped(lambda log: math.exp(log) / (2 * math.pi))
    explained = float(np.median([tap.variance_accounted_for for tap in taps]))
    _check_ringing(frequency.value, math.exp(-decay.value), taps)
    if second is None:
        second = second_mode(hits, explained)
    astray = one_astray(taps, figures.speeds, figures.amplitudes, figures.noise)
    law = law_of(figures.speeds, figures.amplitudes, figures.of_amplitude, "line" if astray else None)
    doubts = Doubts()
    of_taps = [each for each in recordings if any(tap.recording == each.name for tap in taps)]
    tell_lines(len(of_taps), lambda place, needed: _lines(of_taps[place], taps, needed), doubts)
    tell_few_samples(of_taps, frequency.value, doubts)
    _doubt_the_mode(doubts, hits, second, explained, warnings)
    decay_time = decay.mapped(lambda log: math.exp(-log))
    modes = modes_of(figures, frequency, decay_time)
    if modes is None:
        doubts.known("decay time", decay_time)
    _doubt_the_speed(doubts, figures, modes)
    _doubt_the_law(doubts, law, astray, line.r_squared)
    doubts.add(False, most_are_left_out(left, len(taps), "tap"))
    warnings += doubts.told
    return TapFit(
        taps=taps,
        slope_per_s=slope,
        first_peak_slope_per_s=peak_line.coefficients[0],
        frequency_hz=frequency,
        decay_time_s=decay_time,
        modes=modes,
        r_squared=line.r_squared,
        offset_slope_per_s=shifted.coefficients[0],
        offset_m_per_s2=shifted.coefficients[1],
        r_squared_offset=shifted.r_squared,
        variance_accounted_for=explained,
        law=law,
        power=law.power if law.kind == "power" else None,
        second=second,
        sources=tuple(recording.source for recording in recordings),
        warnings=tuple(warnings),
        judged=doubts.judged(
            f"{_modes(second)} {100 * explained:.1f} % of {len(taps)} taps",
            f"A(v) is {law.named} (r^2 {law.r_squared if law.kind != 'line' else line.r_squared:.3f})",
        ),
        left_out=tuple(left.items),
    )


def _found(
    recordings: Sequence[Recording],
    progress: Callable[[Recording], None] | None,
    warnings: list[str],
    left: LeftOut,
) -> tuple[list[Hit], SecondMode | None]:
    """The taps of all recordings, all of which begin the same way, and their second mode where one does not do."""
    refuse_twins(recordings)

    def hits_in(recording: Recording) -> list[Hit]:
        found = hits_of(recording, warnings, left)
        if progress is not None:
            progress(recording)
        return found

    hits, second = as_pairs([hit for found in left.each(recordings, hits_in) for hit in found], left)
    if len(hits) < LEAST_TAPS:
        raise left.refused(f"{len(hits)} taps are too few: needs {LEAST_TAPS}, better ten, at different speeds")
    return _upright(hits, warnings, left), second


def _lines(recording: Recording, taps: Sequence[TapHit], needed: int) -> list[Line]:
    """Of what the taps leave of a recording."""
    seen = recording.acceleration_m_per_s2
    assert seen is not None
    own = [tap for tap in taps if tap.recording == recording.name]
    model = np.full(len(seen), np.median(seen))
    for tap in own:
        begin = round(tap.begin_s * tap.rate_hz)
        sign = 1.0 if np.dot(seen[begin : begin + len(tap.measured)], tap.measured) >= 0 else -1.0
        model[begin : begin + len(tap.measured)] = sign * tap.modelled
    return lines_beside(seen, model, recording.rate_hz, needed)


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
        doubts.add(False, *misfit(hits))


def _doubt_the_speed(doubts: Doubts, figures: Figures, modes: Modes | None) -> None:
    """Whether frequency and decay are the same for all speeds."""
    told = math.nan if modes is None else modes.frequency_at(figures.speeds)
    scatter = float(np.std(figures.angulars - (0.0 if modes is None else np.log(told))))
    doubts.at_most(
        "scatter of the frequency",
        scatter,
        f"the frequency scatters by {100 * scatter:.0f} % between taps",
        "is it one material, held alike?",
    )
    if modes is not None:
        doubts.note(f"{modes.why}; the material has a table of modes over the speed")


def _doubt_the_law(doubts: Doubts, law: Law, astray: str, r_squared: float) -> None:
    """Whether the speed says what the amplitude is; `r_squared` of the line."""
    if astray:
        doubts.add(False, astray, "is its speed right?")
        return
    if law.kind != "line":
        doubts.note(f"A(v) is {law.named}, no line through the origin: {law.why}")
    doubt_the_law(doubts, law, r_squared)


def _upright(hits: list[Hit], warnings: list[str], left: LeftOut) -> list[Hit]:
    """With positive coefficients."""
    signs = [math.copysign(1.0, tap.coefficient_m_per_s2) for tap, _ in hits]
    usual = 1.0 if sum(signs) >= 0 else -1.0
    if usual < 0:
        warnings.append("the taps begin downwards: the acceleration is taken with its sign turned")
    found = []
    for sign, (tap, ringing) in zip(signs, hits, strict=True):
        if sign != usual:
            left.add(tap.recording, "it begins the other way than most", "tap", tap.onset_s)
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
