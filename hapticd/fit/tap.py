"""Fit of taps that ring: slope, frequency and decay, from recordings of taps at several speeds.

Each loud event of a recording is fitted alone (ringing.py). Frequency and decay time are weighted means over all taps;
the amplitude is a function of the approach speed (speed_law.py). The weight of a tap is its signal-to-noise ratio, not
the standard error of its fit, which varies by chance.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from hapticd.analysis import statistics
from hapticd.analysis.recordings.clipping import clipped
from hapticd.analysis.recordings.sensor import Sensor
from hapticd.analysis.statistics import Estimate, FitError, Floats, Regression, UnitError, common, through_origin
from hapticd.base.yaml_source import Json
from hapticd.config.modes import Attack, Mode
from hapticd.fit import preparation, speed_law
from hapticd.fit.limits import PREPARATION_LIMITS, SPEED_LAW_LIMITS, TAP_LIMITS
from hapticd.fit.recording import Recording
from hapticd.fit.result import Fit, fields_of
from hapticd.fit.ringing import Ringing, fit_ringing
from hapticd.fit.spectral_lines import SpectralLine, lines_in_residual, report_lines
from hapticd.fit.speed_law import Amplitudes, Law, LawKind, Power
from hapticd.fit.verdict import Exclusions, Warnings

# ---- Onsets: what is loud in a recording -----------------------------------------------------------------------------


class Unusable(FitError):
    """A tap cannot be used; the message is the reason, without file and time.

    If most taps of a recording have the same `fault`, the recording is refused: "rate" is a sampling rate that is too
    low, "approach" a position that does not determine the speed, "shape" an event that is not a tap.
    """

    def __init__(self, reason: str, fault: Literal["rate", "approach", "shape"] | None = None) -> None:
        super().__init__(reason)
        self.fault = fault


@dataclass(frozen=True, slots=True)
class Event:
    """A loud event in a recording: a tap or its bounce."""

    first: int
    """Index of the first loud sample."""
    last: int
    """Index of the last loud sample."""
    noise: float
    """Standard deviation of the noise in the section without gaps around the event, m/s^2."""
    peak: float
    """Largest magnitude of the acceleration without gravity and drift, m/s^2."""
    rises: bool = False
    """Whether the event before is loud until this one."""


class Events:
    """The loud events of a recording: taps, without bounces."""

    def __init__(self, recording: Recording, lines: list[str]) -> None:
        """Find the events and append warnings to `lines`; raise FitError for a recording without taps."""
        cleaned = preparation.without_invalid_samples(recording, "tap")
        lines += cleaned.warnings
        self.recording = recording = cleaned.recording
        """The recording without impossible samples."""
        self.acceleration = _checked(recording)
        """(n,) acceleration with gravity and drift, m/s^2."""
        lines += preparation.gravity_of([recording])
        above = self.acceleration - _base(self.acceleration, recording.rate_hz)
        self.events = _loud_events(recording, above)
        if any(each.last - each.first > TAP_LIMITS.long_event_s * recording.rate_hz for each in self.events):
            above = self.acceleration - _base(self.acceleration, recording.rate_hz, self.events)
            self.events = _loud_events(recording, above)
        self.speeds = _given_speeds(recording, self.events, above)
        """(events,) approach speeds from the file, m/s; None if the file has none or a single speed."""
        if self.speeds is None or len(self.speeds) != len(self.events):
            # A single loud sample may be noise.
            surely = math.inf if self.speeds is not None else TAP_LIMITS.min_shapeless_peak_to_noise
            self.events = [
                each for each in self.events if each.first < each.last or each.peak > surely * each.noise
            ] or self.events
        if self.speeds is None or len(self.speeds) != len(self.events):
            kept = _without_bounces(recording, self.events)
            bounces = len(self.events) - len(kept)
            if self.speeds is not None and len(self.speeds) != len(kept):
                weakest = f"the noise and than {100 * TAP_LIMITS.min_loud_level:.0f} % of the loudest"
                hint = (
                    f"a tap is found only if it is louder than {weakest}, and the one before has almost stopped ringing"
                    if len(kept) < len(self.speeds)
                    else "a knock, a hum or a ringing that beats also counts as a tap"
                )
                raise FitError(
                    f"{recording.name}: has {len(self.speeds)} speeds for {len(kept)} taps"
                    f"{f' and {bounces} bounces' if bounces else ''}: needs one for each tap; {hint}"
                )
            if bounces:
                lines.append(f"{recording.name}: {bounces} bounces after taps are left out")
            self.events = kept
        noise = min((event.noise for event in self.events), default=0.0)
        self.clipped, self.replaced = clipped(self.acceleration, noise), cleaned.replaced
        """(n,) whether a sample is clipped, and whether it was replaced."""

    def section(self, index: int) -> tuple[int, int]:
        """Return the first sample and the last + 1 around an event, up to the neighbouring events or gaps.

        Raises Unusable if there is too little rest before the event.
        """
        first, samples = self.events[index].first, len(self.clipped)
        begin = self.events[index - 1].last + 1 if index else 0
        end = self.events[index + 1].first if index + 1 < len(self.events) else samples
        for low, high in preparation.between_gaps(self.recording, samples):
            if low <= first < high:
                begin, end = max(begin, low), min(end, high)
                break
        if self.events[index].rises:
            before_s = self.events[index - 1].first / self.recording.rate_hz
            raise Unusable(
                f"begins while the tap at {before_s:.4g} s still rings, or a tone hums: wait longer between taps"
            )
        if first - begin < TAP_LIMITS.min_rest_samples:
            raise Unusable(f"{first - begin} samples of rest before the tap, {TAP_LIMITS.min_rest_samples} are needed")
        return begin, end

    def allow_ringing_before(self, index: int) -> None:
        """Let the section around an event begin during the ringing of the tap before, which is weak."""
        event, before = self.events[index], self.events[index - 1]
        begin = event.first - _samples(TAP_LIMITS.approach_s, self.recording.rate_hz, 16)
        self.events[index - 1] = dataclasses.replace(before, last=begin - 1)
        self.events[index] = dataclasses.replace(event, rises=False)

    def check(self, begin: int, end: int) -> None:
        """Raise Unusable if a sample from `begin` to `end` - 1 is clipped or was replaced."""
        cut, replaced = self.clipped[begin:end], self.replaced[begin:end]
        if cut.any():
            raise Unusable(f"clipped at {np.abs(self.acceleration[begin:end][cut]).max():.4g} m/s^2")
        if replaced.any():
            raise Unusable(f"{np.count_nonzero(replaced)} impossible samples, 0 are allowed")

    def speed(self, index: int, onset_s: float) -> float:
        """Return the approach speed, m/s: from the file, else from the position before the onset.

        Raises Unusable if the position does not determine a speed.
        """
        if self.speeds is not None:
            return float(self.speeds[index])
        given, position, rate_hz = self.recording.speed_m_per_s, self.recording.position_m, self.recording.rate_hz
        if given is not None:
            assert not isinstance(given, np.ndarray)
            return abs(given)
        assert position is not None
        end = max(0, math.floor(onset_s * rate_hz))
        begin = max(
            self.section(index)[0], end - _samples(TAP_LIMITS.approach_s, rate_hz, TAP_LIMITS.min_approach_samples)
        )
        if end - begin < TAP_LIMITS.min_approach_samples:
            raise Unusable(
                f"{end - begin} positions before the tap, {TAP_LIMITS.min_approach_samples} are needed for a speed"
            )
        path = position[begin:end]
        time_s = np.arange(len(path)) / rate_hz
        line = np.polyfit(time_s, path - path[0], 1)
        off = path - path[0] - np.polyval(line, time_s)
        left, total = float(off @ off), float(np.sum((path - path.mean()) ** 2))
        if left > TAP_LIMITS.max_approach_residual * total:
            raise Unusable(
                f"the approach is too uneven for a speed: a straight line leaves {100 * left / total:.0f} % of "
                f"the position's variance, at most {100 * TAP_LIMITS.max_approach_residual:.0f} % is allowed",
                "approach",
            )
        return abs(float(line[0]))


def _checked(recording: Recording) -> Floats:
    """Return the acceleration, m/s^2; raise FitError for a recording that cannot be of taps."""
    name, acceleration, position = recording.name, recording.acceleration_m_per_s2, recording.position_m
    if acceleration is None:
        raise FitError(f"{name}: no acceleration, which a fit of taps needs")
    peak, low = float(np.abs(acceleration).max()), TAP_LIMITS.min_acceleration_m_per_s2
    if 0 < peak < low:
        high = PREPARATION_LIMITS.max_tap_acceleration_m_per_s2
        raise FitError(
            f"{name}: the acceleration must be between {low:g} and {high:g} m/s^2, is {peak:.3g}: wrong unit or column?"
        )
    if recording.force_n is not None:
        force = preparation.force_of(recording)
        if not np.ptp(force) > 0:
            raise FitError(f"{name}: the force is {force[0]:g} N throughout: was the sensor connected?")
        if not force.max() > 0:
            raise UnitError(f"{name}: the force is never positive: pressing must be positive (scale -1?)")
    if recording.speed_m_per_s is None:
        if position is None:
            raise FitError(f"{name}: neither speed nor position: add speed_m_per_s to {name}.yaml")
        if not np.ptp(position) > 0:
            raise FitError(f"{name}: the position never moves: is it the right column?")
    return acceleration


def _base(acceleration: Floats, rate_hz: float, events: Sequence[Event] = ()) -> Floats:
    """Return the acceleration (n,) due to gravity and drift: medians over blocks of 50 ms, interpolated linearly.

    Samples of long `events` do not count, because slow ringing shifts medians. For a short recording that begins at
    rest, return the median of that rest.
    """
    if len(acceleration) < TAP_LIMITS.short_recording_s * rate_hz:
        off = np.abs(acceleration - acceleration[0])
        rest = int(np.argmax(off > TAP_LIMITS.max_rest_change * off.max()))
        if rest >= TAP_LIMITS.min_rest_samples:
            return np.full(len(acceleration), np.median(acceleration[:rest]))
    quiet = np.ones(len(acceleration), dtype=np.bool_)
    for event in events:
        if event.last - event.first > TAP_LIMITS.long_event_s * rate_hz:
            quiet[max(0, event.first - _samples(0.002, rate_hz, 2)) : event.last + 1] = False
    if np.count_nonzero(quiet) < TAP_LIMITS.certain_rest_samples:
        quiet[:] = True
    places = np.array_split(np.arange(len(acceleration)), max(1, len(acceleration) // _samples(0.05, rate_hz, 32)))
    blocks = [kept for block in places if len(kept := block[quiet[block]]) >= TAP_LIMITS.min_rest_samples]
    middles = [0.5 * (block[0] + block[-1] + 1) for block in blocks]
    medians = [np.median(acceleration[block]) for block in blocks]
    return np.asarray(np.interp(np.arange(len(acceleration)), middles, medians))


def _loud_events(recording: Recording, above: Floats) -> list[Event]:
    """Return the loud events of a recording; `above` (n,) is the acceleration without gravity and drift.

    A loud sample exceeds 5 % of the largest one, and the level that noise reaches in one of a hundred recordings.
    Raises FitError if there are no loud samples.
    """
    rate_hz = recording.rate_hz
    length = _samples(0.002, rate_hz, 16)
    sections = preparation.between_gaps(recording, len(above))
    longest = max(sections, key=lambda section: section[1] - section[0])
    found: list[Event] = []
    quiet = []
    for begin, end in sections:
        if (begin, end) != longest and end - begin < 2 * length:
            continue
        size = np.abs(above[begin:end])
        blocks = above[begin : begin + len(size) // length * length].reshape(-1, length)
        # Noise of the quiet blocks; the 20th percentile of their deviations is 0.842 standard errors below the median.
        noise = float(np.percentile(blocks.std(axis=1), 20.0)) if len(blocks) else 0.0
        noise /= 1 - 0.842 / math.sqrt(2 * length)
        highest = float(size.max())
        rest = int(np.argmax(size > TAP_LIMITS.max_rest_change * highest))
        if rest >= (5 if len(size) < TAP_LIMITS.short_recording_s * rate_hz else length):
            # A recording may ring to its end: its noise is at most twice that of the rest, which may have few samples.
            noise = min(noise, 2.0 * float(np.std(above[begin : begin + rest], ddof=1)))
        if not highest > TAP_LIMITS.min_peak_to_noise * noise:
            quiet.append("0" if highest == 0 else f"{highest / noise:.1f} times its noise")
            continue
        # Upper bound of the tail of the normal distribution.
        loud_noise = math.sqrt(2 * math.log(len(size) / 0.01))
        level = max(loud_noise * noise, TAP_LIMITS.min_loud_level * highest)
        for first, last, rises in _separated(above[begin:end], level, rate_hz):
            found.append(Event(begin + first, begin + last, noise, float(size[first : last + 1].max()), rises))
    if not found:
        raise FitError(
            f"{recording.name}: no onset: the largest acceleration is {quiet[0]}, must be at least "
            f"{TAP_LIMITS.min_peak_to_noise:g} times the noise"
        )
    return found


def _separated(above: Floats, level: float, rate_hz: float) -> list[tuple[int, int, bool]]:
    """Return first sample and last sample of each event that is louder than `level`, m/s^2, and Event.rises.

    Events are separated by 20 ms without a loud sample, or a fifth of the first one's duration if that is longer: its
    ringing falls below the level in noise, or between two peaks. Within an event, another tap rises abruptly.
    """
    loud = np.flatnonzero(np.abs(above) > level)
    parts: list[list[int]] = []
    for part in np.split(loud, np.flatnonzero(np.diff(loud) > TAP_LIMITS.min_quiet_s * rate_hz) + 1):
        if parts and part[0] - parts[-1][1] <= TAP_LIMITS.max_pause * (parts[-1][1] - parts[-1][0]):
            parts[-1][1] = int(part[-1])
        else:
            parts.append([int(part[0]), int(part[-1])])
    found: list[tuple[int, int, bool]] = []
    for first, last in parts:
        here = loud[(loud >= first) & (loud <= last)]
        edges = [first + rise for rise in _rises(above[first : last + 1], level, rate_hz)]
        for piece in np.split(here, np.searchsorted(here, edges)):
            if len(piece):
                rises = piece[0] > first and piece[0] - found[-1][1] <= TAP_LIMITS.min_rest_samples
                found.append((int(piece[0]), int(piece[-1]), bool(rises)))
    return found


def _rises(event: Floats, level: float, rate_hz: float) -> list[int]:
    """Return the samples of an event (n,) at which its envelope rises abruptly, by more than `level`, m/s^2.

    The envelope is the maximum over a period of the strongest frequency, so it falls during a ringing. Beating raises
    it slowly. The maximum over 50 ms, or two periods, must rise as well: it falls even if several modes beat quickly.
    """
    from scipy.ndimage import maximum_filter1d

    nearest = round(TAP_LIMITS.min_onset_distance_s * rate_hz)
    if len(event) <= nearest:
        return []
    power = np.abs(np.fft.rfft(event))
    period = math.ceil(len(event) / (1 + int(np.argmax(power[1:]))))
    size = np.abs(event)
    rising = np.arange(len(event)) >= nearest
    for width in (period, max(2 * period, nearest)):
        ahead = maximum_filter1d(size, width, origin=-(width // 2), mode="constant")
        behind = np.concatenate((np.full(min(width, len(size)), math.inf), ahead[: max(0, len(size) - width)]))
        rising &= (ahead > TAP_LIMITS.min_onset_rise * behind) & (ahead - behind > level)
    places = np.flatnonzero(rising)
    # The last sample of a run is on the steep front of the first half period.
    ends = places[np.diff(places, append=len(event) + nearest) >= nearest]
    return [int(end) - period // 4 for end in ends]


def _given_speeds(recording: Recording, events: Sequence[Event], above: Floats) -> Floats | None:
    """Return the speed of each event, m/s, or None if the recording has no column or list of speeds."""
    speed = recording.speed_m_per_s
    if not isinstance(speed, np.ndarray):
        return None
    if len(speed) != len(above):
        return np.abs(speed)
    back = _samples(0.5 * TAP_LIMITS.approach_s, recording.rate_hz, 4)
    return np.array([np.median(np.abs(speed[max(0, each.first - back) : each.first + 1])) for each in events])


def _without_bounces(recording: Recording, events: Sequence[Event]) -> list[Event]:
    """Return the events without bounces. A bounce is weaker than the tap up to 150 ms before, and has no approach."""
    kept: list[Event] = []
    size_before, before = 0.0, 0
    for event in events:
        first, size = event.first, event.peak
        soon = bool(kept) and first - kept[-1].first < TAP_LIMITS.max_bounce_s * recording.rate_hz
        if (
            soon
            and size < TAP_LIMITS.max_bounce_size * size_before
            and not _has_approach(recording, kept[-1].first, before, first)
        ):
            before = first
            continue
        kept.append(event)
        size_before, before = size, first
    return kept


def _has_approach(recording: Recording, touched: int, before: int, first: int) -> bool:
    """Return whether the position before sample `first` shows an approach, not the end of a bounce.

    An approach begins in front of the surface, which is at the position of sample `touched`. Its speed changes less
    than half as fast as in a bounce that leaves the surface at sample `before` and is steadily pushed back.
    """
    if recording.speed_m_per_s is not None or recording.position_m is None:
        return False
    half = _samples(0.5 * TAP_LIMITS.approach_s, recording.rate_hz, 4)
    if first - 2 * half <= before:
        return False
    path = recording.position_m[first - 2 * half : first]
    time_s = np.arange(half) / recording.rate_hz
    early, late = (float(np.polyfit(time_s, part, 1)[0]) for part in (path[:half], path[half:]))
    speed = 0.5 * (early + late)
    passed_s = half / recording.rate_hz
    ahead = (float(recording.position_m[touched]) - float(path.mean())) * math.copysign(1.0, speed)
    steady = abs(late - early) * (first - before) / recording.rate_hz < abs(speed) * passed_s
    return abs(speed) >= SPEED_LAW_LIMITS.min_speed_m_per_s and ahead > 0.5 * abs(speed) * passed_s and steady


def _samples(time_s: float, rate_hz: float, minimum: int) -> int:
    return max(minimum, round(time_s * rate_hz))


# ---- Model: each tap fitted alone ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class TapHit:
    """A tap of a recording, fitted by a mode."""

    recording: str
    speed_m_per_s: float
    rate_hz: float
    begin_s: float
    """Time of the first fitted sample, on the recording's clock."""
    measured: Floats
    """(n,) fitted samples of the acceleration, m/s^2."""
    ringing: Ringing
    sensor: Sensor | None = None
    pair: Ringing | None = None
    """The fit by two modes, if one mode explains too little and two explain more."""
    alone: bool = True
    """Whether one mode is enough for this tap."""

    @property
    def onset_s(self) -> float:
        """Onset of the tap on the recording's clock."""
        return self.begin_s + self.ringing.onset_s

    @property
    def coefficient_m_per_s2(self) -> float:
        """Coefficient (initial amplitude) of the mode."""
        return float(self.ringing.coefficients[0])

    @property
    def decay_rate_per_s(self) -> float:
        """Decay rate of the mode."""
        return float(self.ringing.decay_rate_per_s[0])

    @property
    def angular_frequency_rad_per_s(self) -> float:
        """Angular frequency of the mode."""
        return float(self.ringing.angular_frequency_rad_per_s[0])

    @property
    def first_peak_m_per_s2(self) -> float:
        """Largest acceleration of the mode's first cycle."""
        return self.coefficient_m_per_s2 * Mode(self.decay_rate_per_s, self.angular_frequency_rad_per_s).peak

    @property
    def variance_accounted_for(self) -> float:
        """Fraction of the acceleration's variance that the mode explains."""
        return self.ringing.variance_accounted_for

    @property
    def noise_m_per_s2(self) -> float:
        """RMS of the residual; at least a billionth of the coefficient, because a weight must be finite."""
        return max(self.ringing.noise_m_per_s2, 1e-9 * abs(self.coefficient_m_per_s2))

    @property
    def modelled(self) -> Floats:
        """(n,) acceleration of the model at the fitted samples, m/s^2."""
        return self.measured - self.ringing.residual

    @property
    def residual_to_noise(self) -> float:
        """RMS of the residual during the ringing, divided by its RMS before the onset."""
        left = self.ringing.residual
        onset = max(2, math.floor(self.ringing.onset_s * self.rate_hz))
        end = math.ceil((self.ringing.onset_s + 5 / self.decay_rate_per_s) * self.rate_hz)
        before = float(np.std(left[:onset]))
        return float(np.std(left[onset:end])) / before if before > 0 else math.inf

    def remainder(self, time_s: float) -> float:
        """Return the amplitude of the mode, m/s^2, at a time on the recording's clock."""
        return abs(self.coefficient_m_per_s2) * math.exp(-self.decay_rate_per_s * (time_s - self.onset_s))

    def negated(self) -> TapHit:
        """Return the same tap with the sign of the acceleration reversed."""
        pair = None if self.pair is None else self.pair.negated()
        return dataclasses.replace(self, measured=-self.measured, ringing=self.ringing.negated(), pair=pair)

    def to_dict(self) -> dict[str, Json]:
        """Return the tap as plain data for JSON."""
        return {
            "recording": self.recording,
            "onset_s": self.onset_s,
            "speed_m_per_s": self.speed_m_per_s,
            "coefficient_m_per_s2": self.coefficient_m_per_s2,
            "first_peak_m_per_s2": self.first_peak_m_per_s2,
            "variance_accounted_for": self.variance_accounted_for,
            "frequency_hz": self.angular_frequency_rad_per_s / (2 * math.pi),
            "decay_time_s": 1 / self.decay_rate_per_s,
        }


def hits_of(recording: Recording, lines: list[str], excluded: Exclusions) -> list[TapHit]:
    """Return the taps of a recording; unusable taps are added to `excluded`.

    Raises FitError if there are no taps, or if most of them have the same fault.
    """
    loud = Events(recording, lines)
    name, events = recording.name, loud.events
    found: list[TapHit] = []
    last_used = -1
    refused: list[tuple[Event, Unusable]] = []
    for index, event in enumerate(events):
        try:
            remainder = found[-1].remainder(event.first / recording.rate_hz) if found else 0.0
            if event.rises:
                if last_used == index - 1 and remainder <= TAP_LIMITS.max_remainder * event.peak:
                    loud.allow_ringing_before(index)
            elif event.noise < remainder and event.peak <= remainder + TAP_LIMITS.min_peak_to_noise * event.noise:
                # Noise on the ringing of the tap before.
                continue
            hit = _hit_of(loud, index)
            fraction = found[-1].remainder(hit.onset_s) / abs(hit.coefficient_m_per_s2) if found else 0.0
            if fraction > TAP_LIMITS.max_remainder:
                raise Unusable(
                    f"the tap at {found[-1].onset_s:.4g} s still rings with {100 * fraction:.0f} % of this tap's "
                    f"amplitude, at most {100 * TAP_LIMITS.max_remainder:.0f} % is allowed: wait longer between taps"
                )
            found.append(hit)
            last_used = index
        except Unusable as no:
            refused.append((event, no))
        shapeless = sum(no.fault == "shape" for _, no in refused)
        if shapeless >= 5 and shapeless > len(found):
            first = f"{shapeless} of the first {index + 1}; the first of these: {refused[0][1]}"
            raise FitError(f"{name}: most events are not taps: {first}")
    for fault, min_count, hint in (
        ("rate", 1, "record at a higher rate."),
        ("approach", SPEED_LAW_LIMITS.min_taps, "is the position the right column?"),
    ):
        alike = [no for _, no in refused if no.fault == fault]
        if len(alike) >= min_count and len(alike) > len(found):
            count = f"{len(alike)} of {len(events)} taps cannot be used"
            raise FitError(f"{name}: {count}: {hint} The first of these: {alike[0]}")
    for event, reason in refused:
        excluded.add(name, str(reason), "tap", event.first / recording.rate_hz)
    if not found:
        excluded.unused.add(name)
    return found


def _hit_of(loud: Events, index: int) -> TapHit:
    """Return the tap of an event; raise Unusable, with the measured and the required value, if it cannot be used."""
    recording, event, section = loud.recording, loud.events[index], loud.section(index)
    rate_hz, sensor = recording.rate_hz, recording.sensor
    ringing, begin = _fitted(loud, event, *section)
    end = begin + len(ringing.residual)
    loud.check(begin, end)
    measured = loud.acceleration[begin:end]
    fraction = ringing.variance_accounted_for
    fault: Unusable | None
    if fraction < TAP_LIMITS.min_explained:
        needed = f"{100 * TAP_LIMITS.min_explained:.0f} % are needed"
        fault = Unusable(f"a decaying sinusoid explains {100 * fraction:.0f} % of the variance, {needed}", "shape")
    else:
        fault = _fault_of(rate_hz, event, ringing)
    pair = pair_of(measured, rate_hz, ringing, sensor) if fraction < TAP_LIMITS.well_explained else None
    if pair and (pair.variance_accounted_for < TAP_LIMITS.min_explained or _fault_of(rate_hz, event, pair) is not None):
        pair = None
    if fault is not None and pair is None:
        raise fault
    rest = event.first - section[0]
    if rest < TAP_LIMITS.certain_rest_samples:
        off = math.sqrt(float(ringing.covariance[-1, -1])) * rate_hz
        place = begin - section[0] + ringing.onset_s * rate_hz
        if place < 0 or off > TAP_LIMITS.max_onset_error_samples:
            raise Unusable(
                f"{rest} samples of rest, and the onset {place:.1f} +- {off:.2g} samples after the first of them: "
                f"needs {TAP_LIMITS.certain_rest_samples} samples of rest, or an onset after the first with an error "
                f"of at most {TAP_LIMITS.max_onset_error_samples:g} sample"
            )
    return TapHit(
        recording=recording.name,
        speed_m_per_s=loud.speed(index, begin / rate_hz + ringing.onset_s),
        rate_hz=rate_hz,
        begin_s=begin / rate_hz,
        measured=measured,
        ringing=ringing,
        sensor=sensor,
        pair=pair,
        alone=fault is None,
    )


def _fitted(loud: Events, event: Event, low: int, high: int) -> tuple[Ringing, int]:
    """Return the ringing of a tap and its first fitted sample; samples from `low` to `high` - 1 may be fitted.

    Raises Unusable if nothing can be fitted.
    """
    rate_hz, sensor, first = loud.recording.rate_hz, loud.recording.sensor, event.first
    before = _samples(0.002, rate_hz, 16)
    lasted = max(event.last - first, before)
    begin, end = max(low, first - max(before, lasted // 2)), min(high, event.last + lasted)
    begin = max(0, min(begin, end - 24))
    try:
        ringing = fit_ringing(loud.acceleration[begin:end], rate_hz, onset_s=(first - begin) / rate_hz, sensor=sensor)
        # The first fit was of a guessed section; the second is from one decay time before the onset to seven after it.
        onset = begin + ringing.onset_s * rate_hz
        decay = float(rate_hz / ringing.decay_rate_per_s[0])
        again = max(low, math.floor(onset - max(before, min(decay, 5 * before))))
        end = min(high, max(math.ceil(onset + TAP_LIMITS.fit_decay_times * decay), math.ceil(onset) + 24))
        start = dataclasses.replace(ringing, onset_s=ringing.onset_s + (begin - again) / rate_hz)
        return fit_ringing(loud.acceleration[again:end], rate_hz, start=start, sensor=sensor), again
    except FitError as error:
        raise Unusable(str(error)) from None


def _fault_of(rate_hz: float, event: Event, ringing: Ringing) -> Unusable | None:
    """Return the reason why the modes of `ringing` cannot come from a tap, or None."""
    for angular in ringing.angular_frequency_rad_per_s:
        if slow := preparation.undersampled(rate_hz, float(angular) / (2 * math.pi), TAP_LIMITS.min_samples_per_cycle):
            return Unusable(slow, "rate")
    uncertain, figure = _uncertainty(ringing)
    if not uncertain < TAP_LIMITS.max_relative_error:
        times = event.peak / event.noise if event.noise > 0 else math.inf
        known = (
            f"the {figure} is uncertain by {100 * uncertain:.0f} %, at most {100 * TAP_LIMITS.max_relative_error:.0f} %"
        )
        # A louder event that cannot be fitted has another shape.
        strong = TAP_LIMITS.min_shapeless_peak_to_noise
        if times > strong:
            return Unusable(
                f"the shape is not a ringing: the peak is {times:.0f} times the noise, but {known}", "shape"
            )
        return Unusable(
            f"too weak for the noise: the peak is {times:.1f} times the noise, {strong:g} are needed, and {known}"
        )
    lasts = rate_hz / float(ringing.decay_rate_per_s.max())
    if lasts < TAP_LIMITS.min_decay_samples:
        return Unusable(
            f"a glitch: falls to 1/e within {lasts:.2g} samples, {TAP_LIMITS.min_decay_samples:g} are needed"
        )
    return None


def _uncertainty(ringing: Ringing) -> tuple[float, str]:
    """Return the largest relative standard error of the parameters of all modes, and the parameter's name."""
    modes = len(ringing.coefficients)
    values = np.concatenate((ringing.coefficients, ringing.decay_rate_per_s, ringing.angular_frequency_rad_per_s))
    variances = np.diag(ringing.covariance)[: len(values)]
    # Rounding may make variances of modes that cannot be separated negative.
    if not values.all() or not (variances >= 0).all():
        return math.inf, "amplitude"
    errors = np.sqrt(variances) / np.abs(values)
    worst = int(np.argmax(errors))
    return float(errors[worst]), ("amplitude", "decay", "frequency")[worst // modes]


# ---- A second mode that is struck together with the first ------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SecondMode:
    """A second mode that is struck together with the first, and the first mode's values in the fit of both modes."""

    frequency_hz: Estimate
    decay_time_s: Estimate
    ratio: Estimate
    """The second mode's coefficient divided by that of the first."""
    first_slope_per_s: Estimate
    """Slope of the first mode's coefficient with speed."""
    first_frequency_hz: Estimate
    first_decay_time_s: Estimate
    amplitudes: Amplitudes
    """Amplitudes of the first mode, in the form of TapFit.amplitudes."""
    variance_accounted_for: float
    """Fraction of the variance that both modes explain, median over the taps."""
    alone: float
    """Fraction of the variance that one mode explains, median over the taps."""
    kept: bool
    """Whether the material has the second mode by default; it has if one mode explains too little."""

    def to_dict(self) -> dict[str, Json]:
        """Return the second mode as plain data for JSON."""
        figures = fields_of(self)
        alone = figures.pop("alone")
        return {**figures, "amplitudes": speed_law.json_table(self.amplitudes), "variance_by_one_mode": alone}


def pair_of(measured: Floats, rate_hz: float, ringing: Ringing, sensor: Sensor | None) -> Ringing | None:
    """Return the fit of two modes if it explains significantly more than `ringing`, the fit of one, else None.

    `measured` (n,) is the acceleration, m/s^2. It must contain half a period of the slower mode or more. To save time,
    only 4096 samples after the onset are fitted, or those of three decay times if these are more.
    """
    if len(measured) < 24:
        return None
    longest_s = max(4096 / rate_hz, 3 / float(ringing.decay_rate_per_s[0]))
    head = measured[: math.ceil((ringing.onset_s + longest_s) * rate_hz)]
    pair = fit_ringing(head, rate_hz, modes=2, onset_s=ringing.onset_s, sensor=sensor)
    left = ringing.residual[: len(head)]
    freedom = len(head) - 6
    one, two = float(left @ left), float(pair.residual @ pair.residual)
    turns = float(pair.angular_frequency_rad_per_s.min()) * len(head) / rate_hz
    chance = statistics.f_test_p(one, freedom, two, freedom - 3)
    return pair if chance < SPEED_LAW_LIMITS.significance and turns > math.pi else None


def as_pairs(taps: list[TapHit], excluded: Exclusions) -> tuple[list[TapHit], SecondMode | None]:
    """Return the taps, each with one mode, and the second mode of the material, or None if it has no second mode.

    The material has a second mode if one mode explains the median tap too little and most taps have the same two modes.
    Then each tap keeps the louder of the two. Taps that do not fit are added to `excluded`.
    """
    alone = float(np.median([tap.variance_accounted_for for tap in taps])) if taps else 1.0
    pairs = [tap.pair for tap in taps if tap.pair is not None]
    usual = None if alone >= TAP_LIMITS.well_explained or len(pairs) < len(taps) / 2 else _usual_pair(pairs)
    if usual is not None:
        used: list[TapHit] = []
        struck: list[tuple[TapHit, Ringing]] = []
        others: list[TapHit] = []
        for tap in taps:
            pair = None if tap.pair is None else _in_order(tap.pair, usual)
            off = abs(math.log(tap.angular_frequency_rad_per_s) - usual[0])
            if pair is not None:
                # From here on the tap is its first mode.
                first = pair.of_modes([0])
                used.append(dataclasses.replace(tap, ringing=first, measured=tap.measured[: len(first.residual)]))
                struck.append((used[-1], pair))
            elif tap.variance_accounted_for >= TAP_LIMITS.well_explained and off < TAP_LIMITS.max_frequency_difference:
                used.append(tap)
            else:
                others.append(tap)
        usual_sign = 1.0 if sum(np.sign([tap.coefficient_m_per_s2 for tap, _ in struck])) >= 0 else -1.0
        upright = [
            (tap, pair) if usual_sign > 0 else (tap.negated(), pair.negated())
            for tap, pair in struck
            if np.sign(tap.coefficient_m_per_s2) == usual_sign
        ]
        second = (
            _common_pair(upright, _explained_by(upright), alone) if len(upright) >= SPEED_LAW_LIMITS.min_taps else None
        )
        if second is not None:
            for tap in others:
                excluded.add(tap.recording, "lacks the two modes of the other taps", "tap", tap.onset_s)
            return used, second
    for tap in taps:
        if not tap.alone:
            part = 100 * tap.variance_accounted_for
            reason = f"a decaying sinusoid explains {part:.0f} % of the variance, and the other taps have other modes"
            excluded.add(tap.recording, reason, "tap", tap.onset_s)
    return [tap for tap in taps if tap.alone], None


def second_mode(taps: list[TapHit], explained: float, law: LawKind) -> SecondMode | None:
    """Return the second mode that most of the 12 loudest taps have, or None.

    Both modes together must explain more of the variance than one mode, which explains the fraction `explained`. `law`
    is the law of the amplitude.
    """
    loudest = sorted(taps, key=lambda tap: tap.noise_m_per_s2 / tap.coefficient_m_per_s2)[:12]
    noisy = [tap for tap in loudest if tap.residual_to_noise > TAP_LIMITS.max_residual_to_noise]
    enough = max(SPEED_LAW_LIMITS.min_taps, len(loudest) / 2)
    if len(noisy) < enough:
        return None
    tried = ((tap, pair_of(tap.measured, tap.rate_hz, tap.ringing, tap.sensor)) for tap in noisy)
    both = [(tap, pair) for tap, pair in tried if pair is not None]
    usual = _usual_pair([pair for _, pair in both]) if len(both) >= enough else None
    if usual is None or _explained_by(both) < explained + TAP_LIMITS.min_second_gain:
        return None
    ordered = [(tap, same) for tap, pair in both if (same := _in_order(pair, usual)) is not None]
    return _common_pair(ordered, _explained_by(both), explained, law)


def _explained_by(both: Sequence[tuple[TapHit, Ringing]]) -> float:
    return float(np.median([pair.variance_accounted_for for _, pair in both]))


def _usual_pair(pairs: Sequence[Ringing]) -> Floats | None:
    """Return the logarithms of the two angular frequencies that most pairs have, the louder mode first, or None."""
    if len(pairs) < SPEED_LAW_LIMITS.min_taps:
        return None
    # Sorted by frequency, because the louder mode may change from tap to tap.
    rising = [pair.of_modes(np.argsort(pair.angular_frequency_rad_per_s).tolist()) for pair in pairs]
    logs = np.log([pair.angular_frequency_rad_per_s for pair in rising])
    usual = np.median(logs, axis=0)
    alike = np.all(np.abs(logs - usual) < TAP_LIMITS.max_frequency_difference, axis=1)
    if np.sum(alike) < max(SPEED_LAW_LIMITS.min_taps, TAP_LIMITS.min_same_pairs * len(pairs)):
        return None
    sizes = np.array([np.abs(pair.coefficients) / np.sqrt(pair.decay_rate_per_s) for pair in rising])[alike]
    return np.asarray(usual if np.median(sizes[:, 0] / sizes[:, 1]) >= 1 else usual[::-1])


def _in_order(pair: Ringing, usual: Floats) -> Ringing | None:
    """Return the two modes sorted as `usual`, the usual log angular frequencies; None if they do not have these."""
    for order in ([0, 1], [1, 0]):
        if np.all(
            np.abs(np.log(pair.angular_frequency_rad_per_s[order]) - usual) < TAP_LIMITS.max_frequency_difference
        ):
            return pair.of_modes(order)
    return None


def _common_pair(
    both: list[tuple[TapHit, Ringing]], by_both: float, by_one: float, law: LawKind | None = None
) -> SecondMode | None:
    """Return the second mode common to these taps, each with its two modes; None for an artefact of the fit.

    `by_both` and `by_one` are the fractions of variance that two modes and one mode explain. `law` is the law of the
    amplitude with one mode; it is None if the material has two modes by default.
    """
    speeds = np.array([tap.speed_m_per_s for tap, _ in both])
    noise = _noise_of([tap for tap, _ in both])
    relative = noise / np.array([tap.first_peak_m_per_s2 for tap, _ in both]) ** 2
    coefficients = np.array([pair.coefficients for _, pair in both])
    own = np.array([np.diag(pair.covariance) for _, pair in both])
    between = np.array([pair.covariance[0, 1] for _, pair in both])
    ratios = coefficients[:, 1] / coefficients[:, 0]
    parts = own[:, :2] / coefficients**2
    of_ratio = ratios**2 * (parts.sum(axis=1) - 2 * between / coefficients.prod(axis=1))

    def shared(name: str, first_column: int) -> list[Estimate]:
        """Return the mean natural logarithm, over the taps, of the parameter `name` of either mode."""
        values = np.array([getattr(pair, name) for _, pair in both])
        variances = own[:, first_column : first_column + 2] / values**2
        return [common(np.log(values[:, k]), _smoothed(variances[:, k], relative)) for k in range(2)]

    of_first = _smoothed(own[:, 0], noise)
    slope = through_origin(speeds, coefficients[:, 0], of_first, speeds**2).coefficients[0]
    ratio = common(ratios, _smoothed(of_ratio, relative))
    decay, angular = shared("decay_rate_per_s", 2), shared("angular_frequency_rad_per_s", 4)
    same = abs(angular[1].value - angular[0].value) < TAP_LIMITS.max_frequency_difference
    # Decay time in periods of the second mode.
    lasts = math.exp(angular[1].value - decay[1].value) / (2 * math.pi)
    if (
        slope.value <= 0
        or abs(ratio.value) > TAP_LIMITS.max_second_ratio
        or same
        or lasts < TAP_LIMITS.min_second_periods
    ):
        return None
    try:
        first = speed_law.law_of(speeds, coefficients[:, 0], of_first, law)
    except FitError:
        return None
    return SecondMode(
        frequency_hz=angular[1].mapped(_hertz),
        decay_time_s=decay[1].mapped(_time),
        ratio=ratio,
        first_slope_per_s=slope,
        first_frequency_hz=angular[0].mapped(_hertz),
        first_decay_time_s=decay[0].mapped(_time),
        amplitudes=first.points,
        variance_accounted_for=by_both,
        alone=by_one,
        kept=law is None,
    )


# ---- Intervals: what all taps have in common -------------------------------------------------------------------------

WithVariances: TypeAlias = tuple[Floats, Floats]
"""Values (n,) and their variances (n,) due to noise, without the scatter between taps."""


def _noise_of(taps: Sequence[TapHit]) -> Floats:
    """Return the noise variance of each tap (n,); taps within a factor of 1.5 of the median noise have the median."""
    found = np.array([tap.noise_m_per_s2 for tap in taps])
    usual = float(np.median(found))
    return np.where((found < 1.5 * usual) & (usual < 1.5 * found), usual, found) ** 2


def _smoothed(variances: Floats, scale: Floats) -> Floats:
    """Return `scale` (n,) times the median ratio of `variances` (n,) to it; single variances vary by chance."""
    return np.asarray(scale * np.median(variances / scale), dtype=np.float64)


def _hertz(log_angular: float) -> float:
    return math.exp(log_angular) / (2 * math.pi)


def _time(log_decay: float) -> float:
    return math.exp(-log_decay)


def _peak_variance(ringing: Ringing) -> float:
    """Return the variance of the first mode's first peak, by linear propagation of the parameters' errors."""
    values = np.array([ringing.coefficients[0], ringing.decay_rate_per_s[0], ringing.angular_frequency_rad_per_s[0]])

    def peak(at: Floats) -> float:
        return float(at[0]) * Mode(float(at[1]), float(at[2])).peak

    steps = np.diag(1e-5 * values)
    slopes = np.array([(peak(values + step) - peak(values - step)) / (2 * step.sum()) for step in steps])
    return float(slopes @ ringing.covariance[:3, :3] @ slopes)


@dataclass(frozen=True, slots=True)
class Figures:
    """Fitted values of all n taps, as arrays."""

    speeds: Floats
    """(n,) m/s."""
    noise: Floats
    """(n,) variances of the noise, (m/s^2)^2."""
    amplitude: WithVariances
    """Coefficient A, m/s^2."""
    peak: WithVariances
    """Largest acceleration of the first cycle, m/s^2."""
    decay: WithVariances
    """Logarithm of the decay rate B."""
    angular: WithVariances
    """Logarithm of the angular frequency w."""

    @classmethod
    def of(cls, taps: Sequence[TapHit]) -> Figures:
        """Return the fitted values of these taps."""

        def each(name: str) -> Floats:
            return np.array([getattr(tap, name) for tap in taps])

        noise, peaks = _noise_of(taps), each("first_peak_m_per_s2")
        decays, angulars = each("decay_rate_per_s"), each("angular_frequency_rad_per_s")
        # Relative to the peak, whose error hardly depends on those of decay and frequency.
        relative = noise / peaks**2
        spreads = np.array([np.diag(tap.ringing.covariance)[:3] for tap in taps])
        of_peaks = np.array([_peak_variance(tap.ringing) for tap in taps])
        return cls(
            each("speed_m_per_s"),
            noise,
            amplitude=(each("coefficient_m_per_s2"), _smoothed(spreads[:, 0], noise)),
            peak=(peaks, _smoothed(of_peaks, noise)),
            decay=(np.log(decays), _smoothed(spreads[:, 1] / decays**2, relative)),
            angular=(np.log(angulars), _smoothed(spreads[:, 2] / angulars**2, relative)),
        )


@dataclass(frozen=True, slots=True)
class Modes:
    """Frequency and decay time at several speeds: interpolated linearly, constant beyond the first and last speed."""

    speeds_m_per_s: tuple[float, ...]
    frequencies_hz: tuple[Estimate, ...]
    decay_times_s: tuple[Estimate, ...]
    why: str
    """Reason for a table, in words."""

    def frequency_at(self, speeds: Floats) -> Floats:
        """Return the frequencies, Hz, at speeds in m/s."""
        return np.interp(speeds, self.speeds_m_per_s, [each.value for each in self.frequencies_hz])

    def decay_time_at(self, speeds: Floats) -> Floats:
        """Return the decay times, s, at speeds in m/s."""
        return np.interp(speeds, self.speeds_m_per_s, [each.value for each in self.decay_times_s])

    def material(self) -> dict[str, Json]:
        """Return the value of `mode_table` of a material's tap."""
        return {
            "speeds_m_per_s": list(self.speeds_m_per_s),
            "frequencies_hz": [each.value for each in self.frequencies_hz],
            "decay_times_s": [each.value for each in self.decay_times_s],
        }


def modes_of(figures: Figures, frequency_hz: Estimate, decay_time_s: Estimate) -> tuple[Modes | None, str]:
    """Return the table of modes versus speed, and a sentence about what changes with the speed.

    A change is significant and, from the slowest to the fastest tap, at least 2 % of the frequency or 10 % of the decay
    time. A quantity that does not change has the mean of all taps at every speed. The sentence is empty if nothing
    changes. The table is None in this case, and if no table is certain enough.
    """
    speeds, logs = figures.speeds, (figures.angular, (-figures.decay[0], figures.decay[1]))
    least = (TAP_LIMITS.min_frequency_change, TAP_LIMITS.min_decay_change)
    reasons = [
        speed_law.speed_trend(speeds, *logs[which], name, least[which])
        for which, name in enumerate(("frequency", "decay time"))
    ]
    moved = [which for which, reason in enumerate(reasons) if reason]
    why = " and ".join(filter(None, reasons))
    scatters: dict[int, float] = {}
    made, lowest = None, math.inf
    for count in range(2, 6):
        knots = speed_law.knots_of(speeds, count)
        if not (moved and count == len(knots) < len(speeds)):
            continue
        tables = {which: _log_table(speeds, knots, *logs[which]) for which in moved}
        # The weights are those of a table with two knots.
        scatters = scatters or {which: table.scatter for which, table in tables.items()}
        reached = 0.0
        for which, table in tables.items():
            squares = float(np.sum(table.residual**2 / (logs[which][1] + scatters[which] ** 2)))
            reached += statistics.aicc(max(squares, 1e-24), len(speeds), count)
        widest = max(each.high - each.value for table in tables.values() for each in table.coefficients)
        if reached < lowest and widest < math.log1p(TAP_LIMITS.max_table_error):
            lowest = reached
            columns = [
                tuple(each.mapped(unit) for each in tables[which].coefficients)
                if which in tables
                else (steady,) * count
                for which, (unit, steady) in enumerate(((_hertz, frequency_hz), (math.exp, decay_time_s)))
            ]
            made = Modes(tuple(map(float, knots)), columns[0], columns[1], why)
    return made, why


def _log_table(speeds: Floats, knots: Floats, logs: Floats, variances: Floats) -> Regression:
    """Fit a table, linear between its `knots`, to a quantity with the natural logarithms `logs` (n,).

    The coefficients are the logarithms at the knots, by Gauss-Newton steps. No value of the table leaves the range of
    the taps' values by more than the factor 1 + TAP_LIMITS.max_table_error.
    """
    reach = math.log1p(TAP_LIMITS.max_table_error)
    hats = np.column_stack([np.interp(speeds, knots, row) for row in np.eye(len(knots))])
    at = np.full(len(knots), float(np.mean(logs)))
    for _ in range(50):
        parts = hats * np.exp(at)
        model = parts.sum(axis=1)
        columns = parts / model[:, None]
        found = statistics.least_squares(columns, logs - np.log(model) + columns @ at, variances)
        before, at = at, np.clip([each.value for each in found.coefficients], logs.min() - reach, logs.max() + reach)
        if np.abs(at - before).max() < 1e-9:
            break
    halves = [each.high - each.value for each in found.coefficients]
    return dataclasses.replace(
        found,
        coefficients=tuple(Estimate(value, value - half, value + half) for value, half in zip(at, halves, strict=True)),
        residual=logs - np.log(hats @ np.exp(at)),
    )


# ---- The fit ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class TapFit(Fit):
    """Result of a fit of taps that ring. Slopes are of lines through the origin."""

    taps: tuple[TapHit, ...]
    slope_per_s: Estimate
    """Slope of the mode's coefficient versus approach speed, for `attack: coefficient`."""
    first_peak_slope_per_s: Estimate
    """Slope of the largest acceleration of the first cycle with speed, for `attack: first_peak`."""
    frequency_hz: Estimate
    decay_time_s: Estimate
    modes: Modes | None
    """Table of frequency and decay time at several speeds, if they change with speed."""
    r_squared: float
    """r^2 of the amplitude versus speed as a line through the origin."""
    offset_slope_per_s: Estimate
    offset_m_per_s2: Estimate
    r_squared_offset: float
    """r^2 of the amplitude versus speed as a line with an offset."""
    variance_accounted_for: float
    """Fraction of the variance that the mode explains, median over the taps."""
    law: Law
    """Law of the amplitude versus speed: the line, a power law or a table."""
    power: Power | None
    """The power law, if it is the law of the amplitude versus speed."""
    second: SecondMode | None
    """A second mode, if one mode is not enough."""

    @property
    def choices(self) -> dict[str, str]:
        """Chosen models with their reasons, for `amplitude` and `mode_table`."""
        chosen = {"amplitude": f"{self.law.named}: {self.law.why}"}
        return chosen if self.modes is None else {**chosen, "mode_table": self.modes.why}

    @property
    def linear(self) -> bool:
        """Whether the amplitude versus approach speed is a line through the origin."""
        return self.law.kind == "line"

    @property
    def amplitudes(self) -> Amplitudes:
        """Value of `amplitudes` of a material: a table at several speeds, interpolated linearly and down to 0 at rest.

        A power law is given by points on its curve.
        """
        return self.law.points

    def material(self, attack: Attack = "coefficient", two_modes: bool | None = None) -> dict[str, Json]:
        """Return the keys of a YAML material; if `two_modes` is None, the fit decides.

        Raises FitError if a requested second mode was not found, or if `attack` is `first_peak` with two modes.
        """
        second = self.second if two_modes or (two_modes is None and self.second and self.second.kept) else None
        if attack != "coefficient" and second is not None:
            raise FitError("two modes need attack: coefficient, not first_peak")
        if two_modes and second is None:
            raise FitError("no second mode was found: one is enough, or the taps have different modes")
        modes = self.modes if second is None or second.kept else None
        tap = self._amplitude(attack, second, modes)
        if modes is not None:
            tap["mode_table"] = modes.material()
        elif second is not None:
            tap["frequency_hz"] = second.first_frequency_hz.value
            tap["decay_time_s"] = second.first_decay_time_s.value
        else:
            tap |= {"frequency_hz": self.frequency_hz.value, "decay_time_s": self.decay_time_s.value}
        if second is not None:
            figures = ("frequency_hz", "decay_time_s", "ratio")
            tap["second"] = {name: getattr(second, name).value for name in figures}
        return {"tap": tap}

    def _amplitude(self, attack: Attack, second: SecondMode | None, modes: Modes | None) -> dict[str, Json]:
        tap: dict[str, Json] = {} if attack == "coefficient" else {"attack": attack}
        if self.linear:
            slope = self.slope_per_s if attack == "coefficient" else self.first_peak_slope_per_s
            return tap | {"attack_slope_per_s": (slope if second is None else second.first_slope_per_s).value}
        # In the fit of both modes the first one has other amplitudes.
        points = self.amplitudes if second is None or second.kept else second.amplitudes

        def factor(speed: float) -> float:
            """Return the amplitude that `attack` specifies, divided by the mode's coefficient, at this speed."""
            if attack == "coefficient":
                return 1.0
            hertz, time_s = self.frequency_hz.value, self.decay_time_s.value
            if modes is not None:
                hertz, time_s = float(modes.frequency_at(np.array(speed))), float(modes.decay_time_at(np.array(speed)))
            return Mode(1 / time_s, 2 * math.pi * hertz).peak

        return tap | {"amplitudes": [[speed, factor(speed) * each.value] for speed, each in points]}

    def to_dict(self) -> dict[str, Json]:
        """Return the fit as plain data for JSON, without samples."""
        amplitudes = speed_law.json_table(self.amplitudes)
        return {**Fit.to_dict(self), "linear": self.linear, "amplitudes": amplitudes}


def fit_tap(
    recordings: Sequence[Recording],
    progress: Callable[[Recording], None] | None = None,
    excluded: Exclusions | None = None,
    law: LawKind | None = None,
    mode_table: bool | None = None,
    one_mode: bool = False,
) -> TapFit:
    """Fit modes to the taps of one material.

    `progress` is called after each recording. Unusable recordings and taps are added to `excluded`. `law` is the law of
    the amplitude, and `mode_table` whether frequency and decay time are a table over the speed; the taps decide if they
    are None. With `one_mode` the verdict is that of a material without the second mode. Raises FitError (one line) if
    the recordings do not support a fit.
    """
    statistics.require_scipy()
    preparation.refuse_duplicates(recordings)
    excluded = Exclusions() if excluded is None else excluded
    warnings = Warnings()
    lines = warnings.lines

    def hits_in(recording: Recording) -> list[TapHit]:
        found = hits_of(recording, lines, excluded)
        if progress is not None:
            progress(recording)
        return found

    hits, second = as_pairs([hit for found in excluded.each(recordings, hits_in) for hit in found], excluded)
    if len(hits) < SPEED_LAW_LIMITS.min_taps:
        raise excluded.refused(
            f"{len(hits)} taps are too few: needs {SPEED_LAW_LIMITS.min_taps}, better ten, at different speeds"
        )
    taps = _of_one_sign(hits, lines, excluded)
    excluded.report(len(taps), "taps", warnings)
    speed_law.check_speeds(taps)
    figures = Figures.of(taps)
    speeds, squares = figures.speeds, figures.speeds**2
    # The scatter between taps is proportional to the speed.
    line = through_origin(speeds, *figures.amplitude, squares)
    offset = statistics.with_offset(speeds, *figures.amplitude, squares)
    slope = line.coefficients[0]
    angular, decay = common(*figures.angular), common(*figures.decay)
    speed_law.check_hardness(speeds, figures.amplitude[0], math.exp(angular.value), "the angular frequency")
    frequency, decay_time = angular.mapped(_hertz), decay.mapped(_time)
    _check_ringing(frequency.value, decay_time.value, taps)
    explained = float(np.median([tap.variance_accounted_for for tap in taps]))
    chosen = speed_law.law_of(speeds, *figures.amplitude, law)
    speed_law.check_rises(chosen, len(taps))
    outlier = speed_law.single_outlier(taps, speeds, figures.amplitude[0], figures.noise, chosen)
    if outlier and law is None:
        chosen = speed_law.law_of(speeds, *figures.amplitude, "line", "a single tap is off the line of the others")
    if second is None:
        second = second_mode(taps, explained, chosen.kind)
    _check_recordings(warnings, recordings, taps, frequency, excluded)
    has_second = second is not None and second.kept and not one_mode
    _check_mode(warnings, taps, second, explained, has_second)
    modes = _modes_over_speed(warnings, figures, frequency, decay_time, mode_table)
    if outlier:
        warnings.add(False, outlier, "is its speed right?")
    else:
        speed_law.check_law(warnings, chosen)
    explains = "two modes explain" if has_second else "one mode explains"
    explained_by_modes = second.alone if second is not None and second.kept and one_mode else explained
    return TapFit(
        taps=tuple(taps),
        slope_per_s=slope,
        first_peak_slope_per_s=through_origin(speeds, *figures.peak, squares).coefficients[0],
        frequency_hz=frequency,
        decay_time_s=decay_time,
        modes=modes,
        r_squared=line.r_squared,
        offset_slope_per_s=offset.coefficients[0],
        offset_m_per_s2=offset.coefficients[1],
        r_squared_offset=offset.r_squared,
        variance_accounted_for=explained,
        law=chosen,
        power=chosen.power if chosen.kind == "power" else None,
        second=second,
        warnings=tuple(warnings.lines),
        judged=warnings.verdict(
            f"{explains} {100 * explained_by_modes:.1f} % of {len(taps)} taps",
            f"A(v) is {chosen.named} (r^2 {chosen.r_squared:.3f})",
        ),
        left_out=tuple(excluded.items),
    )


def _of_one_sign(hits: list[TapHit], lines: list[str], excluded: Exclusions) -> list[TapHit]:
    """Return the taps with the usual sign of the acceleration, made positive; add the others to `excluded`."""
    signs = [math.copysign(1.0, tap.coefficient_m_per_s2) for tap in hits]
    usual = 1.0 if sum(signs) >= 0 else -1.0
    if usual < 0:
        lines.append("the taps begin downwards: the sign of the acceleration is reversed")
    found = []
    for sign, tap in zip(signs, hits, strict=True):
        if sign != usual:
            excluded.add(tap.recording, "begins with the opposite sign of most taps", "tap", tap.onset_s)
            continue
        found.append(tap if usual > 0 else tap.negated())
    other = len(hits) - len(found)
    if len(found) < SPEED_LAW_LIMITS.min_taps or (other > 1 and other > TAP_LIMITS.max_opposite_fraction * len(hits)):
        raise FitError(
            f"{other} of {len(hits)} taps begin with the opposite sign: a surface pushes one way; are some events not "
            "taps, or is the rate too low?"
        )
    return found


def _check_ringing(frequency_hz: float, decay_time_s: float, taps: Sequence[TapHit]) -> None:
    if frequency_hz < TAP_LIMITS.min_frequency_hz:
        raise FitError(
            f"the frequency of the ringing must be at least {TAP_LIMITS.min_frequency_hz:g} Hz, is {frequency_hz:.3g}: "
            "a hand's motion, not a tap"
        )
    longest_s = max(len(tap.measured) / tap.rate_hz for tap in taps)
    max_s = TAP_LIMITS.max_decay_time * longest_s
    if decay_time_s > max_s:
        raise FitError(
            f"the ringing does not decay enough before the recording or the next tap ends it: its decay time is "
            f"{decay_time_s:.3g} s, must be at most {max_s:.3g} s if {longest_s:.3g} s are fitted"
        )


# ---- The verdict -----------------------------------------------------------------------------------------------------


def _check_recordings(
    warnings: Warnings,
    recordings: Sequence[Recording],
    taps: Sequence[TapHit],
    frequency: Estimate,
    excluded: Exclusions,
) -> None:
    """Downgrade the verdict for hum in the residuals, and for a low sampling rate."""
    of_taps = [each for each in recordings if any(tap.recording == each.name for tap in taps)]

    def lines(recording: Recording, needed: int) -> list[SpectralLine]:
        seen = recording.acceleration_m_per_s2
        assert seen is not None
        model = np.full(len(seen), np.median(seen))
        for each in excluded.items:
            if each.recording == recording.name and each.time_s is not None:
                # The ringing of a tap that was left out is not a hum.
                end_s = each.time_s + TAP_LIMITS.fit_decay_times / min(tap.decay_rate_per_s for tap in taps)
                here = slice(round(each.time_s * recording.rate_hz), math.ceil(end_s * recording.rate_hz))
                model[here] = seen[here]
        for tap in taps:
            if tap.recording == recording.name:
                begin = round(tap.begin_s * tap.rate_hz)
                here = slice(begin, begin + len(tap.measured))
                sign = 1.0 if np.dot(seen[here], tap.measured) >= 0 else -1.0
                model[here] = sign * tap.modelled
        return lines_in_residual(seen, model, recording.rate_hz, needed)

    report_lines(of_taps, lines, warnings)
    preparation.report_sampling(of_taps, frequency.value, warnings)


def _check_mode(
    warnings: Warnings, taps: Sequence[TapHit], second: SecondMode | None, explained: float, has_second: bool
) -> None:
    """Downgrade the verdict if the modes of the material do not explain the taps.

    One mode explains the fraction `explained`. `has_second`: whether the material has the second mode.
    """
    noisy = float(np.median([tap.residual_to_noise for tap in taps]))
    if second is not None:
        together = 100 * second.variance_accounted_for
        warnings.note(
            f"one mode is not enough: a second at {second.frequency_hz.value:.4g} Hz, "
            f"{1e3 * second.decay_time_s.value:.3g} ms and {second.ratio.value:.2g} times as strong explains "
            f"{together:.1f} % together with the first, which alone explains {100 * second.alone:.1f} %"
        )
        poor = second.variance_accounted_for < TAP_LIMITS.well_explained or (second.kept and not has_second)
        if poor or not has_second:
            warnings.add(poor, "the residuals are not noise" if has_second else f"two explain {together:.1f} %")
    elif explained < TAP_LIMITS.well_explained and noisy > TAP_LIMITS.max_residual_to_noise:
        warnings.add(True, "the residuals are not noise")
    else:
        warnings.add(False, _lack_of_fit(taps), "the errors of the figures may be larger than their intervals")


def _lack_of_fit(taps: Sequence[TapHit]) -> str:
    """Return a sentence if the residuals of all taps have a common pattern that is not noise, else an empty string.

    The pattern is found by a score test of the shapes in `ringing.OTHER_SHAPES`.
    """
    noisy = float(np.median([tap.residual_to_noise for tap in taps]))
    size = len(taps[0].ringing.lack_of_fit[0])
    score, squares, energy, left, samples = np.zeros(size), np.zeros((size, size)), 0.0, 0.0, 0
    for tap in taps:
        noise, residual = tap.noise_m_per_s2**2, tap.ringing.residual
        score += tap.ringing.lack_of_fit[0] / noise
        squares += tap.ringing.lack_of_fit[1] / noise
        modelled = tap.modelled - np.median(tap.modelled)
        energy += float(modelled @ modelled) / noise
        left += float(residual @ residual) / noise
        samples += len(residual) - 6
    explained = float(score @ np.linalg.lstsq(squares, score, rcond=1e-9)[0])
    fraction = math.sqrt(max(0.0, explained) / energy) if energy > 0 else 0.0
    chance = statistics.f_test_p(float(samples), samples, max(0.0, samples - explained), samples - size)
    if fraction > TAP_LIMITS.min_pattern_rms and (
        chance < SPEED_LAW_LIMITS.significance or noisy > TAP_LIMITS.max_residual_to_noise
    ):
        return f"the residuals have a pattern of {100 * fraction:.0f} % of the ringing"
    if noisy > TAP_LIMITS.max_residual_to_noise and math.sqrt(left / energy) > TAP_LIMITS.min_pattern_rms:
        return f"the residuals are {noisy:.1f} times the noise before the taps"
    return ""


def _modes_over_speed(
    warnings: Warnings, figures: Figures, frequency: Estimate, decay_time: Estimate, asked: bool | None
) -> Modes | None:
    """Return the table of modes versus speed, or None; downgrade the verdict for scattered frequencies or decays.

    `asked` is whether the material must or must not have a table. Raises FitError for a table that cannot be made.
    """
    made, why = modes_of(figures, frequency, decay_time)
    uncertain = "but no table over the speed is certain enough"
    if asked and made is None:
        reason = f"{why}, {uncertain}" if why else "frequency and decay do not change with the speed"
        raise FitError(f"{reason}: there is no table of modes; --no-mode-table needs none")
    modes = None if asked is False else made
    if modes is not None:
        warnings.note(f"{why}; the material has a table of modes over the speed")
        decay_time = max(modes.decay_times_s, key=lambda each: (each.high - each.low) / each.value)
    elif why:
        add = warnings.note if made is not None else warnings.add_fair
        add(f"{why}{'' if made is not None else f', {uncertain}'}; the material has one frequency and one decay time")
    warnings.check_interval("decay time", decay_time)
    expected = 0.0 if modes is None else np.log(modes.frequency_at(figures.speeds))
    scatter = float(np.std(figures.angular[0] - expected))
    warnings.check("scatter of the frequency", scatter, events="taps", one="material, held alike")
    return modes
