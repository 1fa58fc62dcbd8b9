"""Verdict on a fit (good, fair or poor, with reasons), and the recordings and events that were left out.

A fit collects warnings, and reasons against itself, in `Warnings`. Without a reason the fit is good. With a reason it
is fair, or poor if its results should not be used. LOWER_LIMITS and UPPER_LIMITS are the rules for single values;
`make docs-tables` copies these rules to docs/reference/fit_limits.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, TypeAlias, TypeVar

from hapticd.analysis.statistics import Estimate, FitError, UnitError
from hapticd.fit.recording import Recording

_T = TypeVar("_T")
Quality: TypeAlias = Literal["good", "fair", "poor"]
COMPLETE_RECORDING: Final = "recording"
"""Value of Exclusion.what if a complete recording was not used."""
ONE_PART: Final = "part"
"""Value of Exclusion.what if a part of a recording was not used."""


class Rule(NamedTuple):
    """Limits of a value: beyond `fair` the fit is fair, beyond `poor` the fit is poor.

    `reason` and `more` are format strings. Their fields are `value`, `percent` and the arguments of `Warnings.check`.
    """

    fair: float
    poor: float
    reason: str
    more: str = ""
    """Advice or consequence, added to the reason in a warning. If it is empty, there is no warning."""


LOWER_LIMITS: Final[Mapping[str, Rule]] = {
    "correlation of the law": Rule(
        0.7,
        0.5,
        "speed and force explain the {what} poorly: correlation {value:.2f}",
        "the gains of the material are unreliable",
    ),
    "variance that grooves explain": Rule(
        0.8, 0.6, "one mode explains {percent:.0f} % of the variance", "the grooves may have more modes"
    ),
    "variance that a rupture's mode explains": Rule(
        0.9, 0.8, "one mode explains {percent:.0f} % of the ringing", "the membrane may have more modes"
    ),
    "variance that a waveform explains": Rule(
        0.95, 0.8, "a waveform explains {percent:.1f} % of a tap", "the taps differ in shape"
    ),
    "r^2 of the law of taps": Rule(0.9, 0.9, "the speed explains the amplitude poorly (r^2 {value:.2f})"),
    "cycles from strike to strike": Rule(
        2.5,
        1.0,
        "{name}: strikes follow one another within {value:.1f} cycles: the mode is hard to determine",
        "stroke more slowly",
    ),
    "samples in a cycle": Rule(
        8.0,
        2.05,
        "{rate_hz:g} Hz are {value:.1f} samples in a cycle of {hz:.4g} Hz: the errors of amplitude and decay are "
        "larger than their intervals, and a filter of the sensor may have lowered both",
        "record at a higher rate",
    ),
    "samples in a period of a waveform": Rule(
        4.0,
        4.0,
        "the recordings have {value:.1f} samples in a period of the middle frequency",
        "the waveform is not resolved: record faster",
    ),
    "punctures": Rule(3.0, 2.0, "{value:.0f} punctures are few", "ten are better"),
}
"""Rules by the name of the value; a value below a limit is a reason against the fit."""
UPPER_LIMITS: Final[Mapping[str, Rule]] = {
    "half of a figure's interval": Rule(0.25, 0.5, "the {what} is uncertain: {within}"),
    "part of the loudness that is uncertain": Rule(
        0.25, 0.5, "the {what} gain is uncertain: {gain.low:.3g} to {gain.high:.3g}"
    ),
    "distance from the law": Rule(
        0.3, 0.6, "loudness deviates from the law by {percent:.0f} %", "it depends on more than speed and force"
    ),
    "part left out": Rule(0.1, 0.3, "{left}"),
    "offset": Rule(
        0.1,
        0.5,
        "amplitudes have an offset of {offset.value:.3g} m/s^2 ({offset.low:.3g} to {offset.high:.3g})",
        "the two gains do not describe it",
    ),
    "scatter about the law of taps": Rule(0.15, 0.4, "the amplitudes differ from {law} by {percent:.0f} %"),
    "scatter of the frequency": Rule(
        0.05, 0.1, "the frequency scatters by {percent:.0f} % between {events}", "is it one {one}?"
    ),
    "decibels between the spectra": Rule(
        3.0,
        10.0,
        "noise with this peak and mean has another spectrum, {value:.1f} dB from the recorded one",
        "--ar uses the recorded spectrum",
    ),
}
"""Rules by the name of the value; a value above a limit is a reason against the fit. Values are fractions, or dB."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Quality of a fit with its reasons. As text: `fair: SUMMARY, but REASON; REASON`."""

    quality: Quality
    summary: str
    reasons: tuple[str, ...] = ()
    """Reasons why the fit is not good."""

    def __str__(self) -> str:
        return f"{self.quality}: {self.summary}" + (f", but {'; '.join(self.reasons)}" if self.reasons else "")


@dataclass(slots=True)
class Warnings:
    """Warnings of a fit, and the reasons why the fit is not good."""

    lines: list[str] = field(default_factory=list)
    """All warnings, one line each."""
    reasons: list[str] = field(default_factory=list)
    cases: Counter[str] = field(default_factory=Counter)
    """Reasons that concern single recordings, with the number of recordings."""
    poor: bool = False

    def add(self, poor: bool, reason: str, more: str = "") -> None:
        """Add a reason against the fit, unless `reason` is empty; with `more`, also add the warning `reason; more`."""
        if not reason:
            return
        self.poor |= poor
        self.reasons.append(reason)
        if more:
            self.lines.append(f"{reason}; {more}")

    def add_fair(self, line: str) -> None:
        """Add a warning that is also a reason against the fit, which is then at best fair."""
        self.add(False, line)
        self.lines.append(line)

    def add_for_recording(self, what: str, line: str) -> None:
        """Add a warning about one recording; recordings with the same `what` count as one reason."""
        self.cases[what] += 1
        self.lines.append(line)

    def note(self, line: str) -> None:
        """Add a warning that does not change the verdict."""
        self.lines.append(line)

    def merge(self, other: Warnings) -> None:
        """Add all warnings and reasons of `other`."""
        self.lines += other.lines
        self.reasons += other.reasons
        self.poor |= other.poor
        self.cases += other.cases

    def check(self, rule: str, value: float, **context: object) -> None:
        """Downgrade the verdict if the value is beyond its rule in LOWER_LIMITS or UPPER_LIMITS; NaN is poor.

        `context` holds further fields of the rule's texts.
        """
        sign, bound = (1.0, LOWER_LIMITS[rule]) if rule in LOWER_LIMITS else (-1.0, UPPER_LIMITS[rule])
        if sign * value >= sign * bound.fair:
            return
        context |= {"value": value, "percent": 100 * value}
        poor = not sign * value >= sign * bound.poor
        self.add(poor, bound.reason.format_map(context), bound.more.format_map(context))

    def check_interval(self, what: str, figure: Estimate) -> None:
        """Downgrade the verdict if half of an interval is too large a fraction of the value `figure`."""
        half = max(figure.high - figure.value, figure.value - figure.low)
        part = half / abs(figure.value) if figure.value else math.inf
        within = f"{100 * part:.0f} %" if part < 10 else f"{figure.low:.3g} to {figure.high:.3g}"
        self.check("half of a figure's interval", part, what=what, within=within)

    def check_gain(self, what: str, gain: Estimate, usual: float, loudness: float) -> None:
        """Downgrade the verdict if the gain of loudness with speed or force may be 0 or is uncertain.

        The gain is uncertain if half of its interval, times the `usual` speed or force, is too large a fraction of the
        usual loudness.
        """
        if gain.low <= 0:
            self.add_fair(f"the {what} gain may be 0: {gain.low:.3g} to {gain.high:.3g}")
            return
        half = max(gain.high - gain.value, gain.value - gain.low)
        self.check("part of the loudness that is uncertain", half * usual / loudness, what=what, gain=gain)

    def verdict(self, summary: str, good: str = "") -> Verdict:
        """Return the verdict; `good` is appended to the summary of a good fit."""
        cases = [f"{what} (in {count} recordings)" if count > 1 else what for what, count in self.cases.items()]
        reasons = (*self.reasons, *cases)
        if not reasons:
            return Verdict("good", f"{summary}, {good}" if good else summary)
        return Verdict("poor" if self.poor else "fair", summary, reasons)


# ---- What is left out ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A recording, a part of a recording or an event that was not used."""

    recording: str
    reason: str
    what: str = COMPLETE_RECORDING
    """COMPLETE_RECORDING, ONE_PART, or the kind of the event: `tap`."""
    time_s: float | None = None
    """Time of the event after the first sample, in s."""
    fraction: float = 1.0
    """Fraction of the recording that a part is; 1 for a complete recording and for an event."""

    def __str__(self) -> str:
        if self.what == COMPLETE_RECORDING:
            return f"{self.recording}: left out: {self.reason}"
        if self.time_s is None:
            return f"{self.recording}: a {self.what} is left out: {self.reason}"
        return f"{self.recording}: the {self.what} at {self.time_s:.4g} s is left out: {self.reason}"


class StrictError(FitError):
    """A recording or an event would be left out, which --strict forbids."""


class Exclusions:
    """Collects recordings and events that are left out; if `strict`, the first one raises StrictError."""

    def __init__(self, strict: bool = False) -> None:
        self.items: list[Exclusion] = []
        self.unused: set[str] = set()
        """Names of recordings without a used event."""
        self._count = ""
        """Number of recordings or events that are left out, in words, once `report` has counted them."""
        self._strict = strict

    def add(
        self,
        recording: str,
        reason: str,
        what: str = COMPLETE_RECORDING,
        time_s: float | None = None,
        fraction: float = 1.0,
    ) -> None:
        """Add the exclusion of `what`, by default the complete recording; raise StrictError if strict."""
        exclusion = Exclusion(recording, reason.removeprefix(f"{recording}: "), what, time_s, fraction)
        if self._strict:
            raise StrictError(f"{exclusion}; --strict forbids exclusions")
        self.items.append(exclusion)

    def copy(self) -> Exclusions:
        """Return a copy that is not strict, for a fit whose result may be discarded."""
        other = Exclusions()
        other.items, other.unused = list(self.items), set(self.unused)
        return other

    def merge(self, other: Exclusions) -> None:
        """Add the exclusions that `other`, a copy of this object, has collected since it was made."""
        for each in other.items[len(self.items) :]:
            self.add(each.recording, each.reason, each.what, each.time_s, each.fraction)
        self.unused |= other.unused
        self._count = other._count

    def each(self, recordings: Iterable[Recording], fitted: Callable[[Recording], _T]) -> list[_T]:
        """Return `fitted(recording)` of each recording; leave out recordings for which `fitted` raises FitError.

        UnitError and StrictError are passed on: a unit that is wrong in one recording is wrong in all.
        """
        found = []
        for recording in recordings:
            try:
                found.append(fitted(recording))
            except (StrictError, UnitError):
                raise
            except FitError as error:
                self.add(recording.name, str(error))
        return found

    @property
    def recordings(self) -> set[str]:
        """Names of the recordings of which nothing was used."""
        return self.unused | {each.recording for each in self.items if each.what == COMPLETE_RECORDING}

    def refused(self, few: str) -> FitError:
        """Return the error for too few usable recordings: the text `few` and up to three reasons.

        If a single recording was left out, and nothing else, the error is the reason for that.
        """
        complete = [each for each in self.items if each.what == COMPLETE_RECORDING]
        if len(self.items) == len(complete) == 1:
            return FitError(f"{complete[0].recording}: {complete[0].reason}")
        return FitError(f"{few} ({self._first_lines()})" if self.items else few)

    def explained(self, error: FitError) -> FitError:
        """Return the error of a fit, with what was left out before it, unless the error names that already."""
        if not self.items or any(each.reason in str(error) for each in self.items):
            return error
        count = self._count or f"{len(self.items)} recordings or events are left out"
        return FitError(f"{error}; {count}: {self._first_lines()}")

    def _first_lines(self) -> str:
        more = f"; and {len(self.items) - 3} more" if len(self.items) > 3 else ""
        return f"{'; '.join(self.lines()[:3])}{more}"

    def lines(self) -> list[str]:
        """Return one line of text for each exclusion."""
        return [str(each) for each in self.items]

    def report_recordings(self, recordings: Sequence[Recording], warnings: Warnings) -> None:
        """Report the exclusions of a fit whose events are not counted; `recordings` are those that were given to it."""
        self.report(sum(each.name not in self.recordings for each in recordings), "recordings", warnings)

    def report(self, used: int, events: str, warnings: Warnings) -> None:
        """Insert the exclusions before all other warnings; downgrade the verdict if much is left out.

        `used` events remain, named `events`. A complete recording counts as one event.
        """
        warnings.lines[:0] = self.lines()
        complete = sum(each.what != ONE_PART for each in self.items)
        parts = sum(each.fraction for each in self.items if each.what == ONE_PART)
        count = used + complete
        self._count = f"{complete} of {count} {events} are left out"
        if parts:
            self._count += f", and parts as long as {parts:.2g} of the others"
        warnings.check("part left out", (complete + parts) / max(1, count), left=self._count)
