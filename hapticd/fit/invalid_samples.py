"""Invalid samples: found in every column that a fit uses, and replaced by straight lines, or refused.

    beyond a limit    no hand presses with more than 200 N; a sample that is NaN is beyond every limit
    a spike           of force or speed, that comes and goes within SPIKE_S and is far beyond the usual values; of
                      acceleration, that comes and goes within three samples
    stuck             force, speed or acceleration stand still for STUCK_S and more, and never so long elsewhere
    a leap            of a position from one sample to the next: out and back it is a spike, after a standstill the
                      samples were lost, otherwise an encoder wrapped or slipped and all later positions are moved back

A recording of which more than MOST is invalid is refused: then it is a unit or a column. Every finding is one line with
file, time and value.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.recordings.spans import Bools, Spans, spans_of
from hapticd.analysis.statistics import FitError, Floats, UnitError
from hapticd.fit.provenance import Kind
from hapticd.fit.recording import Recording

MOST: Final = 0.01
"""Part of the samples of a column beyond its limit that is a wrong unit or column, and no fault of single samples."""
MOST_FINDINGS: Final = 50
"""In one column; more are no faults of single samples either."""
SPIKE_S: Final = 0.01
BEYOND: Final = 2.0
"""A spike is farther than this from what is about it, in units of the value that 95 % of the samples keep below."""
NOISES: Final = 15.0
"""And so many standard deviations of the noise."""
STUCK_S: Final = 0.05
LONGER: Final = 20.0
"""Stuck is so many times longer than standing still usually is."""
LEAP: Final = 5.0
"""A leap is so many times larger than the largest usual step."""
ALONE: Final = 3.0
"""And than the steps beside it, unless it is beyond the limit of speed."""
BACK_S: Final = 0.02
"""Within which a position that leapt is back."""
FALLS: Final = 8.0
"""A spike of acceleration is so many times larger than the samples beside it."""
WIDEST: Final = 3
LEAST: Final = 16
"""Samples of a column that is checked."""

UNITS: Final[Mapping[str, str]] = {
    "acceleration_m_per_s2": "m/s^2",
    "force_n": "N",
    "speed_m_per_s": "m/s",
    "position_m": "m",
    "tangential_position_m": "m",
}
WORDS: Final[Mapping[str, str]] = {
    "acceleration_m_per_s2": "the acceleration",
    "force_n": "the force",
    "speed_m_per_s": "the speed",
    "position_m": "the position",
    "tangential_position_m": "the position along the surface",
}


@dataclass(frozen=True, slots=True)
class Limit:
    """The largest value that can be, and what to ask whoever has more."""

    most: float
    ask: str


FORCE: Final = Limit(200.0, "is it in mN, or swapped with the acceleration?")
SPEED: Final[Mapping[Kind, Limit]] = {
    "tap": Limit(10.0, "is it in mm/s, or are columns swapped?"),
    "grooves": Limit(5.0, "is it in mm/s?"),
    "texture": Limit(5.0, "is it in mm/s?"),
    "puncture": Limit(5.0, "is it in mm/s?"),
}
ACCELERATION: Final[Mapping[Kind, Limit]] = {
    kind: Limit(1e6 if kind == "tap" else 1e5, "is it in another unit, or another column?") for kind in SPEED
}


@dataclass(frozen=True, slots=True)
class Cleaned:
    """A recording without invalid samples."""

    recording: Recording
    replaced: Bools
    """(n,) samples that were not measured so."""
    warnings: tuple[str, ...]


def without_invalid_samples(recording: Recording, kind: Kind) -> Cleaned:
    """The recording with straight lines in place of its invalid samples, for a fit of this kind. FitError where there
    are too many."""
    columns = {name: each for name in UNITS if isinstance(each := getattr(recording, name), np.ndarray)}
    count = max((each.size for each in columns.values()), default=0)
    replaced = np.zeros(count, dtype=np.bool_)
    warnings: list[str] = []
    changed: dict[str, Floats] = {}
    limits = {"force_n": FORCE, "speed_m_per_s": SPEED[kind], "acceleration_m_per_s2": ACCELERATION[kind]}
    for name, values in columns.items():
        if values.size != count or count < LEAST:
            # Of taps, one speed each.
            continue
        column = _Column(recording.name, name, values, recording.rate_hz)
        column.beyond(limits.get(name))
        column.look(kind, SPEED[kind].most)
        if column.warnings:
            changed[name] = column.values
            replaced |= column.bad
            warnings += column.warnings
    if changed:
        recording = dataclasses.replace(recording, **changed)  # type: ignore[arg-type]
    return Cleaned(recording, replaced, tuple(warnings))


class _Column:
    """One column, and what was found in it."""

    def __init__(self, file: str, name: str, values: Floats, rate_hz: float) -> None:
        self.values = values
        self.bad: Bools = np.zeros(len(values), dtype=np.bool_)
        self.warnings: list[str] = []
        self._file, self._name, self._rate_hz = file, name, rate_hz
        self._what, self._unit = WORDS[name], UNITS[name]

    def look(self, kind: Kind, fastest_m_per_s: float) -> None:
        """All but the limits: a force that breaks off and a speed of taps come and go as spikes do. Of taps the
        position matters only just before each, and where the way is uneven there, the tap is left out."""
        stroke = kind in ("grooves", "texture")
        if self._name.endswith("position_m"):
            if kind != "tap":
                self.leaps(fastest_m_per_s)
        elif self._name == "acceleration_m_per_s2":
            if kind == "texture":
                self.stuck()
            else:
                self.alone(above_all=True)
        elif stroke:
            self.spikes()
            self.stuck()
        elif kind == "puncture" and self._name == "force_n":
            self.alone(above_all=False)

    def beyond(self, limit: Limit | None) -> None:
        """Samples over the limit, or not finite."""
        most = math.inf if limit is None else limit.most
        # Not a number is not less than anything.
        over = ~(np.abs(self.values) <= most) | ~np.isfinite(self.values)
        if not over.any():
            return
        first = int(np.argmax(over))
        spans = spans_of(over)
        value = f"{self.values[first]:.6g} {self._unit} at {self._at(first)}"
        bound = "" if limit is None else f" (at most {most:g})"
        if np.mean(over) > MOST or len(spans) > MOST_FINDINGS:
            ask = "" if limit is None else f": {limit.ask}"
            raise UnitError(
                f"{self._file}: {self._what} of {value} is not a hand's{bound}, nor is that of "
                f"{100 * np.mean(over):.3g} % of the samples{ask}"
            )
        samples = int(np.count_nonzero(over))
        self._replace(spans)
        self._report(
            f"{self._what} of {value} cannot be{bound}"
            + (f", nor can that of {samples - 1} more samples" if samples > 1 else "")
        )

    def spikes(self) -> None:
        """What comes and goes within SPIKE_S, far beyond the usual values."""
        values = self.values
        noise = 1.4826 * float(np.median(np.abs(np.diff(values)))) / math.sqrt(2)
        far = max(BEYOND * float(np.percentile(np.abs(values), 95)), NOISES * noise)
        usual = float(np.median(values))
        half = max(WIDEST, round(2 * SPIKE_S * self._rate_hz))
        found: Spans = []
        near = spans_of(np.abs(values - usual) > 0.75 * far)
        for low, high in near if len(near) <= 10 * MOST_FINDINGS else ():
            if high - low > 2 * half:
                continue
            about = float(np.median(values[max(0, low - half) : high + half]))
            off = np.abs(values[low:high] - about) > far
            found += [(low + a, low + b) for a, b in spans_of(off) if b - a <= half / 2]
        self._take_out(found, "leaps to")

    def stuck(self) -> None:
        """What stands still for so long as it does nowhere else; not at 0 at either end, where nothing is touched."""
        edges = np.flatnonzero(np.diff(self.values)) + 1
        starts, ends = np.concatenate(([0], edges)), np.concatenate((edges, [len(self.values)]))
        runs = ends - starts
        least = max(STUCK_S * self._rate_hz, LONGER * float(np.percentile(runs, 99)), 16.0)
        found = [
            (int(low), int(high))
            for low, high in zip(starts[runs >= least], ends[runs >= least], strict=True)
            if self.values[low] != 0 or not (low == 0 or high == len(self.values))
        ]
        if not found or len(found) > MOST_FINDINGS:
            return
        low, high = found[0]
        value = f"{self.values[low]:.6g} {self._unit}"
        finding = f"{self._what} stands still at {value} from {self._at(low)} to {self._at(high - 1)}"
        self._replace(found)
        self._report(finding + _more(found))

    def alone(self, above_all: bool) -> None:
        """Up to WIDEST samples far above those beside them and, with `above_all`, far above everything else: a tap that
        is sampled slowly may be that short, too."""
        size = np.abs(self.values - np.median(self.values))
        loud = NOISES * 1.4826 * float(np.median(size))
        if not size.max() > loud:
            return
        found: Spans = []
        for low, high in spans_of(size > max(loud, size.max() / FALLS**2)):
            around = np.concatenate((size[max(0, low - WIDEST) : low], size[high : high + WIDEST]))
            peak = float(size[low:high].max())
            if high - low <= WIDEST and peak > FALLS * float(around.max(initial=0.0)):
                found.append((low, high))
        if above_all and found:
            rest = size.copy()
            for low, high in found:
                rest[low:high] = 0.0
            # Beside nothing that stands out of the noise there is nothing that it hides.
            hides = float(rest.max()) > loud / 2
            found = [(low, high) for low, high in found if hides and size[low:high].max() > FALLS * rest.max()]
        self._take_out(found, "leaps to")

    def leaps(self, fastest: float) -> None:
        """Of a position, from one sample to the next."""
        steps = np.diff(self.values)
        size = np.abs(steps)
        moved = size[size > 0]
        if len(moved) < 8:
            return
        usual = LEAP * float(np.percentile(moved, 99))
        candidates = np.flatnonzero(size > usual)
        leaps = [
            int(k)
            for k in candidates
            if size[k] * self._rate_hz > fastest or size[k] > ALONE * float(np.median(_beside(size, int(k))))
        ]
        if not leaps:
            return
        if len(leaps) > MOST_FINDINGS:
            raise FitError(
                f"{self._file}: {self._what} leaps in {len(leaps)} places, first by {steps[leaps[0]]:.4g} "
                f"{self._unit} at {self._at(leaps[0] + 1)}: is it the right column, or was the encoder disturbed?"
            )
        spikes, lost, steps_taken = self._sorted(leaps, usual)
        if spikes:
            self._report(f"{self._what} leaps to {spikes[0][2]} and back{_more(spikes)}")
        if lost:
            begin = self._at(lost[0][0] - 1)
            self._report(f"{self._what} stands still from {begin}, and leaps to {lost[0][2]}{_more(lost)}")
        if steps_taken:
            value = f"by {steps_taken[0][1]:.4g} {self._unit} to {steps_taken[0][2]}"
            self._report(f"{self._what} leaps {value}{_more(steps_taken)}", "the leap is taken out")
            shift = np.zeros(len(self.values))
            for at, leap, _ in steps_taken:
                shift[at] = leap
                self.bad[at] = True
            self.values = self.values - np.cumsum(shift)
        self._replace([(low, high) for low, high, _ in (*spikes, *lost)])

    def _sorted(
        self, leaps: list[int], usual: float
    ) -> tuple[list[tuple[int, int, str]], list[tuple[int, int, str]], list[tuple[int, float, str]]]:
        """Spikes, and what was lost in a standstill: first sample, first after the last, and value; and steps: sample,
        leap and value."""
        spikes, lost, steps = [], [], []
        back = max(2, round(BACK_S * self._rate_hz))
        values = self.values
        run = _usual_run(values)
        while leaps:
            at = leaps.pop(0)
            drift = float(np.median(np.diff(values[max(0, at - back) : at + 1]))) if at > 0 else 0.0
            near = [k for k in leaps if k - at <= back]
            returns = [k for k in near if abs(values[k + 1] - values[at] - drift * (k + 1 - at)) < usual]
            value = f"{values[at + 1]:.6g} {self._unit} at {self._at(at + 1)}"
            still = _still(values, at)
            if returns:
                leaps = [k for k in leaps if k > returns[-1]]
                spikes.append((at + 1, returns[-1] + 1, value))
            elif at - still >= max(WIDEST, run):
                lost.append((still + 1, at + 1, value))
            else:
                steps.append((at + 1, float(values[at + 1] - values[at]) - drift, value))
        return spikes, lost, steps

    def _take_out(self, found: Spans, does: str) -> None:
        if not found or len(found) > MOST_FINDINGS:
            # So many are how it is.
            return
        low, high = found[0]
        peak = low + int(np.argmax(np.abs(self.values[low:high] - np.median(self.values))))
        finding = f"{self._what} {does} {self.values[peak]:.6g} {self._unit} at {self._at(peak)} and back" + _more(
            found
        )
        self._replace(found)
        self._report(finding)

    def _replace(self, spans: Spans) -> None:
        """By straight lines between the samples on either side."""
        bad = np.zeros(len(self.values), dtype=np.bool_)
        for low, high in spans:
            bad[low:high] = True
        if bad.all():
            raise FitError(f"{self._file}: {self._what} has no sample that can be")
        at = np.arange(len(self.values))
        self.values = np.where(bad, np.interp(at, at[~bad], self.values[~bad]), self.values)
        self.bad |= bad

    def _report(self, found: str, done: str = "left out") -> None:
        self.warnings.append(f"{self._file}: {found}; {done}")

    def _at(self, sample: int) -> str:
        return f"{sample / self._rate_hz:.6g} s"


def _more(found: Sequence[object]) -> str:
    return f", as in {len(found) - 1} other places" if len(found) > 1 else ""


def _beside(size: Floats, at: int) -> Floats:
    return np.concatenate((size[max(0, at - WIDEST) : at], size[at + 1 : at + 1 + WIDEST]))


def _still(values: Floats, at: int) -> int:
    """The first sample of the run of equal values that ends here."""
    first = at
    while first > 0 and values[first - 1] == values[at]:
        first -= 1
    return first


def _usual_run(values: Floats) -> float:
    """Samples for which a position usually stands still."""
    return 4 * len(values) / max(1, int(np.count_nonzero(np.diff(values))))
