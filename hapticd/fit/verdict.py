"""The verdict on a fit: what is left out and why, and good, fair or poor, with the reasons.

A fit collects its doubts in `Doubts`. Without one it is good; with one it is fair, and poor where a doubt says that
the figures should not be used. LOWER_LIMITS and UPPER_LIMITS have every threshold that a single value decides, of all kinds of
fits, with its reason; docs/fit.md has the same table, and a test compares them.
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
WHOLE_RECORDING: Final = "recording"
ONE_PART: Final = "part"


class Rule(NamedTuple):
    """Beyond `fair` a fit is fair, beyond `poor` it is poor.

    The texts have the `value`, how much it is in `percent`, and whatever else `Doubts.check` is given."""

    fair: float
    poor: float
    reason: str
    more: str = ""
    """Of the warning, which there is besides the reason unless this is empty."""


LOWER_LIMITS: Final[Mapping[str, Rule]] = {
    "correlation of the law": Rule(
        0.7,
        0.5,
        "speed and force explain the {what} poorly: correlation {value:.2f}",
        "the gains in the material say little",
    ),
    "variance that grooves explain": Rule(
        0.8, 0.6, "one mode accounts for {percent:.0f} % of the variance", "grooves ring with more"
    ),
    "variance that a rupture's mode explains": Rule(
        0.9, 0.8, "one mode explains {percent:.0f} % of the ringing", "membranes ring with more"
    ),
    "variance that a waveform explains": Rule(
        0.95, 0.8, "a waveform explains {percent:.1f} % of a tap", "the taps differ in shape"
    ),
    "r^2 of the law of taps": Rule(0.9, 0.9, "the speed says little of the amplitude (r^2 {value:.2f})"),
    "cycles from strike to strike": Rule(
        2.5,
        1.0,
        "{name}: strikes follow within {value:.1f} cycles: their mode is hard to tell",
        "stroke more slowly",
    ),
    "samples in a cycle": Rule(
        8.0,
        2.05,
        "{rate_hz:g} Hz are {value:.1f} samples in a cycle of {hz:.4g} Hz: amplitude and decay are less certain than "
        "their intervals say, and a filter of the sensor may have lowered them",
        "record at a higher rate",
    ),
    "samples in a period of a waveform": Rule(
        4.0,
        4.0,
        "{value:.1f} samples of the recordings are a period of its middle frequency",
        "the waveform is not resolved: record faster",
    ),
    "punctures": Rule(3.0, 2.0, "{value:.0f} punctures are few", "ten are better"),
}
"""What is less than these is a doubt."""
UPPER_LIMITS: Final[Mapping[str, Rule]] = {
    "half of a figure's interval": Rule(0.25, 0.5, "the {what} is uncertain: {within}"),
    "part of the loudness that is uncertain": Rule(
        0.25, 0.5, "the {what} gain is uncertain: {gain.low:.3g} to {gain.high:.3g}"
    ),
    "distance from the law": Rule(
        0.3, 0.6, "loudness is off the law by {percent:.0f} %", "it depends on more than speed and force"
    ),
    "part left out": Rule(0.1, 0.3, "{left}"),
    "offset": Rule(
        0.1,
        0.5,
        "amplitudes have an offset of {offset.value:.3g} m/s^2 ({offset.low:.3g} to {offset.high:.3g})",
        "the two gains do not have it",
    ),
    "scatter of the frequency": Rule(
        0.05, 0.1, "the frequency scatters by {percent:.0f} % between {events}", "is it one {one}?"
    ),
    "decibels between the spectra": Rule(
        3.0,
        10.0,
        "noise with this peak and mean has another spectrum than the recorded one, {value:.1f} dB apart",
        "--ar takes the spectrum as it is",
    ),
}
"""What is more than these is a doubt; all are parts of 1, but for the decibels."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a fit is worth. As text: `fair: what was found, but this; and that`."""

    quality: Quality
    summary: str
    reasons: tuple[str, ...] = ()
    """Why it is not good."""

    def __str__(self) -> str:
        return f"{self.quality}: {self.summary}" + (f", but {'; '.join(self.reasons)}" if self.reasons else "")


@dataclass(slots=True)
class Doubts:
    """What keeps a fit from being good."""

    warnings: list[str] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    cases: Counter[str] = field(default_factory=Counter)
    """How many recordings have what."""
    poor: bool = False

    def add(self, poor: bool, reason: str, more: str = "") -> None:
        """A reason, unless it is empty; with `more` it is also among the warnings."""
        if not reason:
            return
        self.poor |= poor
        self.reasons.append(reason)
        if more:
            self.warnings.append(f"{reason}; {more}")

    def doubt(self, line: str) -> None:
        """A reason that is a warning as it stands."""
        self.add(False, line)
        self.warnings.append(line)

    def doubt_recording(self, what: str, line: str) -> None:
        """A warning about one recording; all that have the same are one reason."""
        self.cases[what] += 1
        self.warnings.append(line)

    def warn(self, line: str) -> None:
        """A warning that is no reason: the fit is as good with it."""
        self.warnings.append(line)

    def merge(self, other: Doubts) -> None:
        """Those of one recording, which is used."""
        self.warnings += other.warnings
        self.reasons += other.reasons
        self.poor |= other.poor
        self.cases += other.cases

    def check(self, rule: str, value: float, **said: object) -> None:
        """A reason where the value is beyond the rule's of LOWER_LIMITS or UPPER_LIMITS. A value that is no number is poor."""
        sign, bound = (1.0, LOWER_LIMITS[rule]) if rule in LOWER_LIMITS else (-1.0, UPPER_LIMITS[rule])
        if sign * value >= sign * bound.fair:
            return
        said |= {"value": value, "percent": 100 * value}
        poor = not sign * value >= sign * bound.poor
        self.add(poor, bound.reason.format_map(said), bound.more.format_map(said))

    def check_interval(self, what: str, figure: Estimate) -> None:
        """A reason where half of the figure's interval is too large a part of the figure."""
        half = max(figure.high - figure.value, figure.value - figure.low)
        part = half / abs(figure.value) if figure.value else math.inf
        within = f"{100 * part:.0f} %" if part < 10 else f"{figure.low:.3g} to {figure.high:.3g}"
        self.check("half of a figure's interval", part, what=what, within=within)

    def check_gain(self, what: str, gain: Estimate, usual: float, loudness: float) -> None:
        """A reason where the gain of a law may be 0, or half of its interval, at the usual speed or force, is too large
        a part of the usual loudness."""
        if gain.low <= 0:
            self.doubt(f"the {what} gain may be 0: {gain.low:.3g} to {gain.high:.3g}")
            return
        half = max(gain.high - gain.value, gain.value - gain.low)
        self.check("part of the loudness that is uncertain", half * usual / loudness, what=what, gain=gain)

    def judged(self, summary: str, good: str = "") -> Verdict:
        """The verdict; of a good fit the summary has `good` besides."""
        cases = [f"{what} (in {count} recordings)" if count > 1 else what for what, count in self.cases.items()]
        reasons = (*self.reasons, *cases)
        if not reasons:
            return Verdict("good", f"{summary}, {good}" if good else summary)
        return Verdict("poor" if self.poor else "fair", summary, reasons)


# ---- What is left out ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A recording, a part of one, or one event of it, that was not used."""

    recording: str
    reason: str
    what: str = WHOLE_RECORDING
    """WHOLE_RECORDING, ONE_PART of it, or the event: `tap`."""
    time_s: float | None = None
    """Of the event, from the first sample."""

    def __str__(self) -> str:
        if self.what == WHOLE_RECORDING:
            return f"{self.recording}: left out: {self.reason}"
        if self.time_s is None:
            return f"{self.recording}: a {self.what} is left out: {self.reason}"
        return f"{self.recording}: the {self.what} at {self.time_s:.4g} s is left out: {self.reason}"


class StrictError(FitError):
    """Something would be left out, and nothing may be."""


class Exclusions:
    """Collects what is left out. With `strict` the first one raises StrictError instead."""

    def __init__(self, strict: bool = False) -> None:
        self.items: list[Exclusion] = []
        self.unused: set[str] = set()
        """Names of recordings all of whose events were left out."""
        self._strict = strict

    def add(self, recording: str, reason: str, what: str = WHOLE_RECORDING, time_s: float | None = None) -> None:
        left = Exclusion(recording, reason.removeprefix(f"{recording}: "), what, time_s)
        if self._strict:
            raise StrictError(f"{left}; --strict refuses that")
        self.items.append(left)

    def copy(self) -> Exclusions:
        """For a fit that may not be taken: what was left out before it, and never strict."""
        other = Exclusions()
        other.items, other.unused = list(self.items), set(self.unused)
        return other

    def merge(self, other: Exclusions) -> None:
        """What the fit left out that is taken, after `copy`."""
        for left in other.items[len(self.items) :]:
            self.add(left.recording, left.reason, left.what, left.time_s)
        self.unused |= other.unused

    def each(self, recordings: Iterable[Recording], fitted: Callable[[Recording], _T]) -> list[_T]:
        """What `fitted` makes of every recording; one that it refuses is left out with its reason.

        UnitError goes on: whoever mistakes the unit of one recording mistakes that of all.
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
        """Names of those of which nothing was used."""
        return self.unused | {left.recording for left in self.items if left.what == WHOLE_RECORDING}

    def refused(self, few: str) -> FitError:
        """That too little is left: `few` says what, and up to three reasons follow; of a single recording its own
        alone."""
        whole = [left for left in self.items if left.what == WHOLE_RECORDING]
        if len(self.items) == len(whole) == 1:
            return FitError(f"{whole[0].recording}: {whole[0].reason}")
        if not self.items:
            return FitError(few)
        more = f"; and {len(self.items) - 3} more" if len(self.items) > 3 else ""
        return FitError(f"{few} ({'; '.join(self.lines()[:3])}{more})")

    def lines(self) -> list[str]:
        """One for each."""
        return [str(left) for left in self.items]

    def report(self, recordings: Sequence[Recording], doubts: Doubts) -> None:
        """What is left out, before all other warnings, and a doubt where that is a large part of the recordings."""
        doubts.warnings[:0] = self.lines()
        unused, every = self.recordings, {recording.name for recording in recordings} | self.recordings
        count = max(len(every), len(recordings))
        left = f"{len(unused)} of {count} recordings are left out"
        doubts.check("part left out", len(unused) / count, left=left)

    def report_taps(self, used: int, doubts: Doubts) -> None:
        """A doubt where more taps are left out than are used."""
        taps = sum(each.what == "tap" for each in self.items)
        if taps > used:
            doubts.add(False, f"{taps} of {taps + used} taps are left out")
