"""The taps of a recording: found where it is loud, each fitted alone, with its speed; why one cannot be used."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.recordings.clipping import clipped
from hapticd.analysis.recordings.spans import Bools
from hapticd.analysis.statistics import FitError, Floats, UnitError
from hapticd.config.modes import Mode
from hapticd.fit.exclusions import Exclusions
from hapticd.fit.invalid_samples import ACCELERATION, without_invalid_samples
from hapticd.fit.recording import Recording
from hapticd.fit.recording_checks import force_of, gravity_of, undersampled
from hapticd.fit.stretches import between_gaps
from hapticd.fit.taps.hit import LEAST_SPEED_M_PER_S, LEAST_TAPS, NO_NOISE, WELL_EXPLAINED, Hit, TapHit
from hapticd.fit.taps.ringing import Ringing, fit_ringing
from hapticd.fit.taps.second_mode import EXPLAINED, pair_of

LEAST_M_PER_S2: Final = 1e-3
"""An acceleration whose largest is less is none."""
GLITCH: Final = 2.0
"""What falls to 1/e in fewer samples is none of a surface."""
OUTSTANDING: Final = 8.0
"""A tap's peak is at least so many times the noise."""
LOUD_CHANCE: Final = 0.01
LOUD_PART: Final = 0.05
"""A sample is loud beyond what noise reaches once in a recording with this chance, and beyond this part of the
recording's largest."""
QUIET_S: Final = 0.02
"""Taps are apart by so long without a loud sample."""
BOUNCE_S: Final = 0.15
"""What is weaker and comes so soon after a tap is its bounce, unless it has an approach of its own."""
BASE_S: Final = 0.05
"""Gravity and drift are seen as medians over so long."""
SHORT_S: Final = 0.5
RISES: Final = 0.1
"""Of its largest change: what a recording changes less before is its rest."""
TELLING: Final = 5
"""So many samples of it tell its noise,"""
LUCKY: Final = 2.0
"""within this factor."""
BLOCK_S: Final = 0.002
BLOCK: Final = 16
"""Samples at least."""
CALM: Final = 20.0
CALMER: Final = 0.842
"""The noise is taken where it is calm: this percentile of the blocks, so many of their deviations below the middle."""
LEAST_RATE: Final = 2.05
"""Samples in a cycle. So few are enough where the onset is known; at 2 amplitude and onset cannot be separated."""
REST: Final = 8
"""Samples of rest before a tap, with which its onset is never asked for;"""
LEAST_REST: Final = 2
"""so many do where"""
CLEAR: Final = 1.0
"""the onset lies behind the first of them, and is uncertain by fewer samples than this (one standard error)."""
FAINT: Final = 2.0
"""A tap whose peak is so many times OUTSTANDING's share of the noise, and that still cannot be fitted, has another
shape; what is less is too weak."""
BEFORE_S: Final = 0.002
"""A tap is fitted from so long before its onset, or from one decay time before."""
LASTS: Final = 7.0
"""To so many decay times after it."""
APPROACH_S: Final = 0.01
"""Speed is a position's over so long before the onset."""
LEAST_WAY: Final = 4
"""And over so many samples at least."""
UNEVEN: Final = 0.5
"""Of its variance that a straight line leaves over there."""
UNCERTAIN: Final = 0.5
"""A tap whose amplitude, decay or frequency is known less than this, one standard error, is not used."""
MANY: Final = 5
"""Where so many are not used, and fewer are, the recording is none of taps."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something loud in a recording."""

    first: int
    """Events sample."""
    last: int
    noise: float
    """Standard deviation of what is quiet in its stretch of the recording, m/s^2."""
    peak: float
    """The largest that it is, above gravity and drift, m/s^2."""


@dataclass(frozen=True, slots=True)
class Events:
    """What is loud in a recording, without what bounced."""

    recording: Recording
    """Without samples that cannot be."""
    events: list[Event]
    speeds: Floats | None
    """(events,), where they are given."""
    clipped: Bools
    """(n,) samples."""
    replaced: Bools
    """(n,) samples that were not measured as they are."""

    def room(self, index: int) -> tuple[int, int]:
        """First sample, and the one after the last, between the taps and the gaps about this one."""
        first, samples = self.events[index].first, len(self.clipped)
        begin = self.events[index - 1].last + 1 if index else 0
        end = self.events[index + 1].first if index + 1 < len(self.events) else samples
        for low, high in between_gaps(self.recording, samples):
            if low <= first < high:
                return max(begin, low), min(end, high)
        return begin, end

    def speed(self, index: int, onset_s: float) -> float:
        """Of the approach, m/s. Raises Unusable."""
        if self.speeds is not None:
            return float(self.speeds[index])
        return _speed_of(self.recording, onset_s, self.room(index)[0])


def events_of(recording: Recording, warnings: list[str]) -> Events:
    """Raises FitError for a recording that is none of taps."""
    whole = without_invalid_samples(recording, "tap")
    recording = whole.recording
    warnings += whole.warnings
    acceleration = _checked(recording)
    warnings += gravity_of(recording)
    above = acceleration - _base(acceleration, recording.rate_hz)
    events = _loud_events(recording, above)
    speeds = _given_speeds(recording, events, above)
    if speeds is not None and len(speeds) != len(events):
        # One of many thousand samples of noise may be loud by itself.
        events = [each for each in events if each.first < each.last] or events
    if speeds is None or len(speeds) != len(events):
        kept = _without_bounces(recording, events, above)
        if speeds is not None and len(speeds) != len(kept):
            raise FitError(
                f"{recording.name}: has {len(speeds)} speeds for {len(kept)} taps"
                f"{f' and {len(events) - len(kept)} bounces' if len(kept) < len(events) else ''}: needs one a tap"
            )
        if len(kept) < len(events):
            warnings.append(f"{recording.name}: {len(events) - len(kept)} bounces after taps are left out")
        events = kept
    noise = min((event.noise for event in events), default=0.0)
    return Events(recording, events, speeds, clipped(acceleration, noise), whole.replaced)


def hits_of(recording: Recording, warnings: list[str], excluded: Exclusions) -> list[Hit]:
    """The taps of a recording; those that cannot be used are reported in `excluded`. FitError where it has none."""
    loud = events_of(recording, warnings)
    recording, events = loud.recording, loud.events
    found: list[Hit] = []
    refused: list[tuple[Event, Unusable]] = []
    for index, event in enumerate(events):
        try:
            found.append(_hit_of(loud, index))
        except Unusable as no:
            refused.append((event, no))
        _check_kind(recording.name, [no for _, no in refused], len(found), index + 1)
    for kind, least in ((_Undersampled, 1), (_NoApproach, LEAST_TAPS)):
        alike = [no for _, no in refused if isinstance(no, kind)]
        if len(alike) >= least and len(alike) > len(found):
            count = f"{len(alike)} of {len(events)} taps cannot be used"
            raise FitError(f"{recording.name}: {count}: {kind.hint} Of the first: {alike[0]}")
    for event, reason in refused:
        excluded.add(recording.name, str(reason), "tap", event.first / recording.rate_hz)
    if not found:
        excluded.unused.add(recording.name)
    return found


def _check_kind(name: str, refused: Sequence[Unusable], found: int, tried: int) -> None:
    """Raises FitError where most of what was tried of a recording has the shape of no tap."""
    count = sum(isinstance(no, _NoTap) for no in refused)
    if count >= MANY and count > found:
        raise FitError(f"{name}: most of what stands out is no tap, {count} of the first {tried}; of one: {refused[0]}")


class Unusable(FitError):
    """Why a tap cannot be used, without its place."""


class _Undersampled(Unusable):
    """It rings too fast for the sampling rate."""

    hint = "record faster."


class _NoApproach(Unusable):
    """The position does not tell its speed."""

    hint = "is the position the right column?"


class _NoTap(Unusable):
    """It has the shape of no tap."""


def _checked(recording: Recording) -> Floats:
    """The acceleration, m/s^2. FitError for a recording that cannot be one of taps."""
    acceleration = recording.acceleration_m_per_s2
    if acceleration is None:
        raise FitError(f"{recording.name}: has no acceleration, which taps are fitted to")
    largest = float(np.abs(acceleration).max())
    if 0 < largest < LEAST_M_PER_S2:
        raise FitError(
            f"{recording.name}: an acceleration of {largest:.3g} m/s^2 is none of a stylus ({LEAST_M_PER_S2:g} to "
            f"{ACCELERATION['tap'].most:g}): is it in another unit, or another column?"
        )
    if recording.force_n is not None:
        _check_force(recording.name, force_of(recording))
    position = recording.position_m
    if recording.speed_m_per_s is None and position is None:
        raise FitError(f"{recording.name}: has neither speed nor position: say speed_m_per_s in the YAML beside it")
    if recording.speed_m_per_s is None and position is not None and not np.ptp(position) > 0:
        raise FitError(f"{recording.name}: the position never moves: is it the right column?")
    return acceleration


def _hit_of(loud: Events, index: int) -> Hit:
    """A tap fitted within its room. Raises Unusable, with what was measured and what is wanted."""
    recording, event, room = loud.recording, loud.events[index], loud.room(index)
    acceleration, rate_hz = recording.acceleration_m_per_s2, recording.rate_hz
    assert acceleration is not None
    rest = event.first - room[0]
    if rest < LEAST_REST:
        raise Unusable(f"{rest} samples of rest before it, {LEAST_REST} are wanted")
    try:
        ringing, begin = _fitted(recording, event.first, event.last, *room)
    except FitError as error:
        raise Unusable(str(error)) from None
    span = slice(begin, begin + len(ringing.residual))
    if loud.clipped[span].any():
        level = float(np.abs(acceleration[span][loud.clipped[span]]).max())
        raise Unusable(f"it is clipped at {level:.4g} m/s^2")
    if loud.replaced[span].any():
        raise Unusable(f"{np.count_nonzero(loud.replaced[span])} of its samples cannot be, and none may")
    share = ringing.variance_accounted_for
    fault: Unusable | None = None
    if share < EXPLAINED:
        fault = _NoTap(f"a decaying sinusoid explains {100 * share:.0f} % of it, {100 * EXPLAINED:.0f} % are wanted")
    else:
        fault = _fault_of(recording, event, ringing)
    pair = _pair_of(recording, event, ringing, begin)
    if fault is not None and pair is None:
        raise fault
    if rest < REST:
        off = math.sqrt(float(ringing.covariance[-1, -1])) * rate_hz
        place = begin - room[0] + ringing.onset_s * rate_hz
        if place < 0 or off > CLEAR:
            raise Unusable(
                f"{rest} samples of rest before it, and its onset is {place:.1f} samples behind the first of them, "
                f"give or take {off:.2g}: {REST} samples are wanted, or an onset that is uncertain by {CLEAR:g} at most"
            )
    onset_s = begin / rate_hz + ringing.onset_s
    tap = _hit(recording, ringing, begin, onset_s, loud.speed(index, onset_s))
    return dataclasses.replace(tap, pair=pair, alone=fault is None), ringing


def _fault_of(recording: Recording, event: Event, ringing: Ringing) -> Unusable | None:
    """Why the modes are none that a tap could have."""
    for angular in ringing.angular_frequency_rad_per_s:
        if slow := undersampled(recording.rate_hz, float(angular) / (2 * math.pi), LEAST_RATE):
            return _Undersampled(f"it {slow}")
    uncertain, figure = _uncertainty(ringing)
    if not uncertain < UNCERTAIN:
        times = event.peak / event.noise if event.noise > 0 else math.inf
        known = f"its {figure} is uncertain by {100 * uncertain:.0f} %, {100 * UNCERTAIN:.0f} % is the most"
        if times > FAINT * OUTSTANDING:
            return _NoTap(f"its shape is no ringing: it stands {times:.0f} times out of the noise, but {known}")
        return Unusable(
            f"it is too weak for its noise: it stands {times:.1f} times out of it, {FAINT * OUTSTANDING:g} are wanted, "
            f"and {known}"
        )
    lasts = recording.rate_hz / float(ringing.decay_rate_per_s.max())
    if lasts < GLITCH:
        return Unusable(f"a glitch: it falls to 1/e within {lasts:.2g} samples, {GLITCH:g} are wanted")
    return None


def _pair_of(recording: Recording, event: Event, ringing: Ringing, begin: int) -> Ringing | None:
    """Two modes of a tap that one explains too little of; None where they do not explain it, either."""
    if ringing.variance_accounted_for >= WELL_EXPLAINED:
        return None
    assert recording.acceleration_m_per_s2 is not None
    measured = recording.acceleration_m_per_s2[begin : begin + len(ringing.residual)]
    pair = pair_of(measured, recording.rate_hz, ringing, recording.sensor)
    if pair is None or pair.variance_accounted_for < EXPLAINED or _fault_of(recording, event, pair) is not None:
        return None
    return pair


def _check_force(name: str, force: Floats) -> None:
    if not np.ptp(force) > 0:
        raise FitError(f"{name}: the force is {force[0]:g} N throughout: was the sensor connected?")
    if not force.max() > 0:
        raise UnitError(f"{name}: the force is never positive: pressing must be (scale -1?)")


def _base(acceleration: Floats, rate_hz: float) -> Floats:
    """Gravity and drift: medians over blocks, and straight lines between them; of a short recording that begins at rest
    the level of that rest, which slow ringing does not move."""
    if len(acceleration) < SHORT_S * rate_hz:
        off = np.abs(acceleration - acceleration[0])
        rest = int(np.argmax(off > RISES * off.max()))
        if rest >= LEAST_REST:
            return np.full(len(acceleration), np.median(acceleration[:rest]))
    length = _samples(BASE_S, rate_hz, 32)
    count = max(1, len(acceleration) // length)
    blocks = np.array_split(acceleration, count)
    middles = np.cumsum([0] + [len(block) for block in blocks[:-1]]) + np.array([len(block) for block in blocks]) / 2
    return np.asarray(np.interp(np.arange(len(acceleration)), middles, [np.median(block) for block in blocks]))


def _loud_events(recording: Recording, above: Floats) -> list[Event]:
    """What is loud, by stretches without gaps. Raises FitError where nothing stands out."""
    found: list[Event] = []
    refused: list[FitError] = []
    stretches = between_gaps(recording, len(above))
    longest = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    for begin, end in stretches:
        if (begin, end) != longest and end - begin < 2 * _samples(BLOCK_S, recording.rate_hz, BLOCK):
            continue  # too short to tell its noise
        try:
            found += [
                dataclasses.replace(event, first=begin + event.first, last=begin + event.last)
                for event in _events_in(recording, above[begin:end])
            ]
        except FitError as error:
            refused.append(error)
    if not found:
        raise refused[0]
    return found


def _events_in(recording: Recording, above: Floats) -> list[Event]:
    length = _samples(BLOCK_S, recording.rate_hz, BLOCK)
    blocks = above[: len(above) // length * length].reshape(-1, length)
    noise = float(np.percentile(blocks.std(axis=1), CALM)) if len(blocks) else 0.0
    noise /= 1 - CALMER / math.sqrt(2 * length)
    highest = float(np.abs(above).max())
    rest = int(np.argmax(np.abs(above) > RISES * highest))
    if len(above) < SHORT_S * recording.rate_hz and rest >= TELLING:
        # A short recording may ring to its end. So few samples may be quieter than noise is, by chance.
        noise = min(noise, LUCKY * float(np.std(above[:rest], ddof=1)))
    if not highest > OUTSTANDING * noise:
        times = "nothing" if highest == 0 else f"{highest / noise:.1f} times its noise"
        raise FitError(
            f"{recording.name}: no onset: its largest acceleration is {times}, a tap has {OUTSTANDING:g} times at least"
        )
    # A bound of the normal distribution's tail.
    loud_noise = math.sqrt(2 * math.log(len(above) / LOUD_CHANCE))
    loud = np.flatnonzero(np.abs(above) > max(loud_noise * noise, LOUD_PART * highest))
    gaps = np.flatnonzero(np.diff(loud) > QUIET_S * recording.rate_hz)
    firsts = np.concatenate(([loud[0]], loud[gaps + 1]))
    lasts = np.concatenate((loud[gaps], [loud[-1]]))
    return [
        Event(int(first), int(last), noise, float(np.abs(above[first : last + 1]).max()))
        for first, last in zip(firsts, lasts, strict=True)
    ]


def _given_speeds(recording: Recording, events: Sequence[Event], above: Floats) -> Floats | None:
    """One a tap; None where they are to be taken from the position, or one holds for all."""
    speed = recording.speed_m_per_s
    if isinstance(speed, np.ndarray) and len(speed) == len(above):
        back = _samples(0.5 * APPROACH_S, recording.rate_hz, 4)
        return np.array([np.median(np.abs(speed[max(0, each.first - back) : each.first + 1])) for each in events])
    return np.abs(speed) if isinstance(speed, np.ndarray) else None


def _without_bounces(recording: Recording, events: Sequence[Event], above: Floats) -> list[Event]:
    kept: list[Event] = []
    size_before, before = 0.0, 0
    for event in events:
        first, size = event.first, event.peak
        soon = bool(kept) and first - kept[-1].first < BOUNCE_S * recording.rate_hz
        if soon and size < 0.8 * size_before and not _comes_by_itself(recording, kept[-1].first, before, first):
            before = first
            continue
        kept.append(event)
        size_before, before = size, first
    return kept


def _comes_by_itself(recording: Recording, touched: int, before: int, first: int) -> bool:
    """Whether the position shows an approach of its own: from in front of the surface, which was `touched`, and at a
    speed that changes less than half as fast as that of a bounce, which since the event `before` has gone away at this
    speed and come back at it by a steady push."""
    if recording.speed_m_per_s is not None or recording.position_m is None:
        return False
    half = _samples(0.5 * APPROACH_S, recording.rate_hz, 4)
    if first - 2 * half <= before:
        return False
    way = recording.position_m[first - 2 * half : first]
    place = np.arange(half) / recording.rate_hz
    early, late = (float(np.polyfit(place, part, 1)[0]) for part in (way[:half], way[half:]))
    speed = 0.5 * (early + late)
    passed = half / recording.rate_hz
    ahead = (float(recording.position_m[touched]) - float(way.mean())) * math.copysign(1.0, speed)
    steady = abs(late - early) * (first - before) / recording.rate_hz < abs(speed) * passed
    return abs(speed) >= LEAST_SPEED_M_PER_S and ahead > 0.5 * abs(speed) * passed and steady


def _fitted(recording: Recording, first: int, last: int, least: int, most: int) -> tuple[Ringing, int]:
    """A tap's ringing, and the first sample of the stretch; none of it is before `least` or from `most` on."""
    acceleration = recording.acceleration_m_per_s2
    assert acceleration is not None
    rate_hz = recording.rate_hz
    before = _samples(BEFORE_S, rate_hz, 16)
    lasted = max(last - first, before)
    begin, end = max(least, first - max(before, lasted // 2)), min(most, last + lasted)
    begin = max(0, min(begin, end - 24))
    try:
        ringing = fit_ringing(
            acceleration[begin:end], rate_hz, onset_s=(first - begin) / rate_hz, sensor=recording.sensor
        )
        # The stretch was by guess; now it is by the decay.
        onset = begin + ringing.onset_s * rate_hz
        decay = float(rate_hz / ringing.decay_rate_per_s[0])
        again = max(least, math.floor(onset - max(before, min(decay, 5 * before))))
        end = min(most, max(math.ceil(onset + LASTS * decay), math.ceil(onset) + 24))
        start = dataclasses.replace(ringing, onset_s=ringing.onset_s + (begin - again) / rate_hz)
        return fit_ringing(acceleration[again:end], rate_hz, start=start, sensor=recording.sensor), again
    except FitError as error:
        raise Unusable(str(error)) from None


def _speed_of(recording: Recording, onset_s: float, least: int) -> float:
    """The speed, from the position's samples from `least` on where there is no other. Raises Unusable."""
    if recording.speed_m_per_s is not None:
        assert not isinstance(recording.speed_m_per_s, np.ndarray)
        return abs(recording.speed_m_per_s)
    assert recording.position_m is not None
    end = max(0, math.floor(onset_s * recording.rate_hz))
    wanted = _samples(APPROACH_S, recording.rate_hz, LEAST_WAY)
    begin = max(least, end - wanted)
    if end - begin < LEAST_WAY:
        raise Unusable(
            f"its speed is not seen: {end - begin} samples of the position before it, {LEAST_WAY} are wanted"
        )
    way = recording.position_m[begin:end]
    time_s = np.arange(len(way)) / recording.rate_hz
    line = np.polyfit(time_s, way - way[0], 1)
    off = way - way[0] - np.polyval(line, time_s)
    whole = float(np.sum((way - way.mean()) ** 2))
    if float(off @ off) > UNEVEN * whole:
        share = 100 * float(off @ off) / whole
        raise _NoApproach(
            f"it has no even way before it to tell its speed: a straight line leaves {share:.0f} % of the position's "
            f"variance, {100 * UNEVEN:.0f} % is the most"
        )
    return abs(float(line[0]))


def _hit(recording: Recording, ringing: Ringing, begin: int, onset_s: float, speed: float) -> TapHit:
    assert recording.acceleration_m_per_s2 is not None
    measured = recording.acceleration_m_per_s2[begin : begin + len(ringing.residual)]
    mode = Mode(float(ringing.decay_rate_per_s[0]), float(ringing.angular_frequency_rad_per_s[0]))
    coefficient = float(ringing.coefficients[0])
    return TapHit(
        recording=recording.name,
        onset_s=onset_s,
        speed_m_per_s=speed,
        coefficient_m_per_s2=coefficient,
        first_peak_m_per_s2=coefficient * mode.peak,
        decay_rate_per_s=mode.decay_rate_per_s,
        angular_frequency_rad_per_s=mode.angular_frequency_rad_per_s,
        variance_accounted_for=ringing.variance_accounted_for,
        # A rendered tap may have none, and yet is weighted by it.
        noise_m_per_s2=max(ringing.noise_m_per_s2, NO_NOISE * abs(coefficient)),
        begin_s=begin / recording.rate_hz,
        rate_hz=recording.rate_hz,
        measured=measured,
        modelled=measured - ringing.residual,
        sensor=recording.sensor,
    )


def _uncertainty(ringing: Ringing) -> tuple[float, str]:
    """The largest of the relative standard errors of A, B and w of any mode, and which it is."""
    modes = len(ringing.coefficients)
    values = np.concatenate((ringing.coefficients, ringing.decay_rate_per_s, ringing.angular_frequency_rad_per_s))
    variances = np.diag(ringing.covariance)[: len(values)]
    # Modes that cannot be separated may have variances below 0, by rounding.
    if not values.all() or not (variances >= 0).all():
        return math.inf, "amplitude"
    errors = np.sqrt(variances) / np.abs(values)
    worst = int(np.argmax(errors))
    return float(errors[worst]), ("amplitude", "decay", "frequency")[worst // modes]


def _samples(time_s: float, rate_hz: float, least: int) -> int:
    return max(least, round(time_s * rate_hz))
