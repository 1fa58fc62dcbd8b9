"""The verdict on a fit: good, fair or poor, with the reasons. The one place for the thresholds that a single value
decides, of all kinds of fits.

A fit collects its doubts in `Doubts`. Without one it is good; with one it is fair, and poor where a doubt says that
the figures should not be used. docs/fit.md has the table of BOUNDS, and a test compares them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, TypeAlias

from hapticd.analysis.statistics import Estimate

Quality: TypeAlias = Literal["good", "fair", "poor"]


class Bound(NamedTuple):
    """Beyond `fair` a fit is fair, beyond `poor` it is poor."""

    fair: float
    poor: float


AT_LEAST: Final[Mapping[str, Bound]] = {
    "correlation of the law": Bound(0.7, 0.5),
    "variance that grooves explain": Bound(0.8, 0.6),
    "variance that a rupture's mode explains": Bound(0.9, 0.8),
    "variance that a waveform explains": Bound(0.95, 0.8),
    "r^2 of the law of taps": Bound(0.9, 0.9),
    "cycles from strike to strike": Bound(2.5, 1.0),
    "samples in a cycle": Bound(8.0, 2.05),
    "samples in a period of a waveform": Bound(4.0, 4.0),
    "punctures": Bound(3.0, 2.0),
}
"""What is less than these is a doubt."""
AT_MOST: Final[Mapping[str, Bound]] = {
    "half of a figure's interval": Bound(0.25, 0.5),
    "part of the loudness that is uncertain": Bound(0.25, 0.5),
    "distance from the law": Bound(0.3, 0.6),
    "part left out": Bound(0.1, 0.3),
    "offset": Bound(0.1, 0.5),
    "scatter of the frequency": Bound(0.05, 0.1),
    "decibels between the spectra": Bound(3.0, 10.0),
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
    cases: dict[str, int] = field(default_factory=dict)
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

    def doubt(self, line: str, poor: bool = False) -> None:
        """A reason that is a warning as it stands."""
        self.add(poor, line)
        self.warnings.append(line)

    def doubt_recording(self, what: str, line: str) -> None:
        """A warning about one recording; all that have the same are one reason."""
        self.cases[what] = self.cases.get(what, 0) + 1
        self.warnings.append(line)

    def warn(self, line: str) -> None:
        """A warning that is no reason: the fit is as good with it."""
        self.warnings.append(line)

    def merge(self, other: Doubts) -> None:
        """Those of one recording, which is used."""
        self.warnings += other.warnings
        self.reasons += other.reasons
        self.poor |= other.poor
        for what, count in other.cases.items():
            self.cases[what] = self.cases.get(what, 0) + count

    def at_least(self, rule: str, value: float, reason: str, more: str = "") -> None:
        """A reason where the value is less than the rule of AT_LEAST asks. A value that is no number is poor."""
        bound = AT_LEAST[rule]
        if not value >= bound.fair:
            self.add(not value >= bound.poor, reason, more)

    def at_most(self, rule: str, value: float, reason: str, more: str = "") -> None:
        """A reason where the value is more than the rule of AT_MOST allows. A value that is no number is poor."""
        bound = AT_MOST[rule]
        if not value <= bound.fair:
            self.add(not value <= bound.poor, reason, more)

    def check_interval(self, what: str, figure: Estimate) -> None:
        """A reason where half of the figure's interval is too large a part of the figure."""
        half = max(figure.high - figure.value, figure.value - figure.low)
        part = half / abs(figure.value) if figure.value else math.inf
        within = f"{100 * part:.0f} %" if part < 10 else f"{figure.low:.3g} to {figure.high:.3g}"
        self.at_most("half of a figure's interval", part, f"the {what} is uncertain: {within}")

    def check_gain(self, what: str, gain: Estimate, usual: float, loudness: float) -> None:
        """A reason where the interval of a gain of a law is too large a part of the usual loudness, at the usual speed
        or force."""
        half = max(gain.high - gain.value, gain.value - gain.low)
        part = half * usual / loudness
        reason = f"the {what} gain is uncertain: {gain.low:.3g} to {gain.high:.3g}"
        self.at_most("part of the loudness that is uncertain", part, reason)

    def judged(self, summary: str, good: str = "") -> Verdict:
        """The verdict; of a good fit the summary has `good` besides."""
        cases = [f"{what} (in {count} recordings)" if count > 1 else what for what, count in self.cases.items()]
        reasons = (*self.reasons, *cases)
        if not reasons:
            return Verdict("good", f"{summary}, {good}" if good else summary)
        return Verdict("poor" if self.poor else "fair", summary, reasons)
