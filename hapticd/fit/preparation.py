"""Preparation of recordings for every fit: impossible samples, gaps, units, sampling rate, motion of the stylus.

Impossible samples are interpolated linearly and reported in one line with file, time and value. If too many samples of
a column are beyond its limit, its unit or column is wrong, and the recording is refused.

    beyond a limit    a force above 200 N, for example; NaN is beyond every limit
    spike             force or speed far beyond its usual values for at most 10 ms, or acceleration for three samples
    standstill        equal values of force, speed or acceleration for 50 ms or more, much longer than elsewhere
    leap              a jump of the position between two samples. If the position returns soon, the jump is a spike.
                      After a standstill, it means lost samples. Otherwise an encoder wrapped or slipped, and the jump
                      is subtracted from all later positions
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis import statistics
from hapticd.analysis.recordings.clipping import clipped
from hapticd.analysis.recordings.spans import Bools, Spans, spans_of
from hapticd.analysis.statistics import Estimate, FitError, Floats, Ints, UnitError
from hapticd.fit.limits import PREPARATION_LIMITS, SPEED_LAW_LIMITS
from hapticd.fit.recording import Kind, Recording
from hapticd.fit.verdict import ONE_PART, Exclusions, Warnings

WORDS_OF_COLUMNS: Final[Mapping[str, tuple[str, str]]] = {
    "acceleration_m_per_s2": ("the acceleration", "m/s^2"),
    "force_n": ("the force", "N"),
    "speed_m_per_s": ("the speed", "m/s"),
    "position_m": ("the position", "m"),
    "tangential_position_m": ("the position along the surface", "m"),
}
"""Name in messages, and unit, of each column of a recording."""


def refuse_duplicates(recordings: Sequence[Recording]) -> None:
    """Raise FitError if two recordings have the same bytes, because the data would count twice."""
    seen: dict[str, str] = {}
    for recording in recordings:
        sha256 = recording.source.sha256
        if sha256 and sha256 in seen:
            raise FitError(f"{recording.name}: duplicate of {seen[sha256]}, which would count twice; leave out one")
        seen[sha256] = recording.name


# ---- Invalid samples -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Cleaned:
    """A recording whose impossible samples are replaced."""

    recording: Recording
    replaced: Bools
    """(n,) whether a sample was replaced."""
    warnings: tuple[str, ...]


def without_invalid_samples(recording: Recording, kind: Kind) -> Cleaned:
    """Return the recording with its impossible samples interpolated linearly, for a fit of this kind.

    Raises FitError if too many samples are impossible.
    """
    columns = _columns(recording)
    count = max((each.size for each in columns.values()), default=0)
    replaced = np.zeros(count, dtype=np.bool_)
    warnings: list[str] = []
    changed: dict[str, Floats] = {}
    for name, values in columns.items():
        if values.size != count or count < 16:
            # A list of one speed for each tap, or a very short recording.
            continue
        column = _Column(recording.name, name, values, recording.rate_hz)
        column.clean(kind)
        if column.warnings:
            changed[name] = column.values
            replaced |= column.bad
            warnings += column.warnings
    if changed:
        recording = dataclasses.replace(recording, **changed)  # type: ignore[arg-type]
    return Cleaned(recording, replaced, tuple(warnings))


def _columns(recording: Recording) -> dict[str, Floats]:
    """Return the columns of the recording that are arrays, by name."""
    return {name: each for name in WORDS_OF_COLUMNS if isinstance(each := getattr(recording, name), np.ndarray)}


def report_cleaning(kept: Sequence[Cleaned], warnings: Warnings) -> None:
    """Add the warnings about replaced samples; downgrade the verdict if many samples were replaced."""
    warnings.lines += [line for each in kept for line in each.warnings]
    count = sum(each.replaced.size for each in kept)
    part = sum(int(np.count_nonzero(each.replaced)) for each in kept) / max(1, count)
    warnings.check("part left out", part, left=f"{100 * part:.0f} % of the samples are left out")


class _Column:
    """One column of a recording while its impossible samples are replaced."""

    def __init__(self, file: str, name: str, values: Floats, rate_hz: float) -> None:
        self.values = values
        self.bad: Bools = np.zeros(len(values), dtype=np.bool_)
        self.warnings: list[str] = []
        self._file, self._name, self._rate_hz = file, name, rate_hz
        self._what, self._unit = WORDS_OF_COLUMNS[name]

    def clean(self, kind: Kind) -> None:
        """Replace the samples that are impossible for this kind of fit.

        Forces at ruptures and speeds of taps look like spikes, so only strokes are searched for long spikes. Leaps in
        the position of taps remain: only the approach matters, and a tap with an uneven approach is left out.
        """
        tap, stroke = kind == "tap", kind in ("grooves", "texture")
        fastest = SPEED_LAW_LIMITS.max_speed_m_per_s if tap else PREPARATION_LIMITS.max_stroke_speed_m_per_s
        match self._name:
            case "acceleration_m_per_s2":
                of_tap = PREPARATION_LIMITS.max_tap_acceleration_m_per_s2
                limit = of_tap if tap else PREPARATION_LIMITS.max_acceleration_m_per_s2
                self._replace_beyond(limit, "is it in another unit, or another column?")
                if kind == "texture":
                    self._replace_stuck()
                else:
                    self._replace_short(above_all=True)
            case "force_n":
                self._replace_beyond(PREPARATION_LIMITS.max_force_n, "is it in mN, or swapped with the acceleration?")
                if kind == "puncture":
                    self._replace_short(above_all=False)
            case "speed_m_per_s":
                self._replace_beyond(fastest, f"is it in mm/s{', or are columns swapped?' if tap else '?'}")
            case _:
                self._replace_beyond(math.inf, "")
                if not tap:
                    self._remove_leaps(fastest)
        if stroke and self._name in ("force_n", "speed_m_per_s"):
            self._replace_spikes()
            self._replace_stuck()

    def _replace_beyond(self, limit: float, question: str) -> None:
        """Replace samples whose magnitude is above `limit`, and samples that are not finite.

        If there are many of them, raise UnitError with the `question` to the user.
        """
        # A comparison with NaN is false.
        over = ~(np.abs(self.values) <= limit) | ~np.isfinite(self.values)
        if not over.any():
            return
        spans, first = spans_of(over), int(np.argmax(over))
        value = f"{self._what} of {self._value(first)}"
        bound = f" (at most {limit:g})" if question else ""
        if np.mean(over) > PREPARATION_LIMITS.max_invalid_fraction or len(spans) > PREPARATION_LIMITS.max_faults:
            raise UnitError(
                f"{self._file}: {value} is impossible{bound}, and so are {100 * np.mean(over):.3g} % of the samples"
                f"{f': {question}' if question else ''}"
            )
        more = int(np.count_nonzero(over)) - 1
        others = f", as in {more} more samples" if more else ""
        self._replace(spans, f"{value} is impossible{bound}{others}")

    def _replace_spikes(self) -> None:
        """Replace spikes: values far beyond the usual ones, for at most 10 ms."""
        values = self.values
        far = max(2.0 * float(np.percentile(np.abs(values), 95)), PREPARATION_LIMITS.spike_to_noise * noise_of(values))
        half = max(PREPARATION_LIMITS.max_spike_samples, round(2 * PREPARATION_LIMITS.max_spike_s * self._rate_hz))
        found: Spans = []
        near = spans_of(np.abs(values - float(np.median(values))) > 0.75 * far)
        for low, high in near if len(near) <= 10 * PREPARATION_LIMITS.max_faults else ():
            if high - low > 2 * half:
                continue
            about = float(np.median(values[max(0, low - half) : high + half]))
            off = np.abs(values[low:high] - about) > far
            found += [(low + a, low + b) for a, b in spans_of(off) if b - a <= half / 2]
        self._replace_leaping(found)

    def _replace_short(self, above_all: bool) -> None:
        """Replace short spikes, of at most PREPARATION_LIMITS.max_spike_samples, far above the samples next to them.

        If `above_all`, a spike must also be far above all other samples, because a slowly sampled tap is as short.
        """
        size, longest = np.abs(self.values - np.median(self.values)), PREPARATION_LIMITS.max_spike_samples
        loud = PREPARATION_LIMITS.spike_to_noise * 1.4826 * float(np.median(size))
        if not size.max() > loud:
            return
        found: Spans = []
        for low, high in spans_of(size > max(loud, size.max() / PREPARATION_LIMITS.spike_ratio**2)):
            if high - low > longest:
                continue
            around = np.concatenate((size[max(0, low - longest) : low], size[high : high + longest]))
            if size[low:high].max() > PREPARATION_LIMITS.spike_ratio * around.max(initial=0.0):
                found.append((low, high))
        if above_all and found:
            rest = size.copy()
            for low, high in found:
                rest[low:high] = 0.0
            # A spike is replaced only if there is something else above the noise that it could hide.
            hides = float(rest.max()) > loud / 2
            found = [
                (low, high)
                for low, high in found
                if hides and size[low:high].max() > PREPARATION_LIMITS.spike_ratio * rest.max()
            ]
        self._replace_leaping(found)

    def _replace_stuck(self) -> None:
        """Replace standstills much longer than other runs of equal values, except zeros (no contact) at either end."""
        edges = np.flatnonzero(np.diff(self.values)) + 1
        starts, ends = np.concatenate(([0], edges)), np.concatenate((edges, [len(self.values)]))
        runs = ends - starts
        min_samples = max(
            PREPARATION_LIMITS.min_standstill_s * self._rate_hz,
            PREPARATION_LIMITS.standstill_ratio * float(np.percentile(runs, 99)),
            16.0,
        )
        found = [
            (int(low), int(high))
            for low, high in zip(starts[runs >= min_samples], ends[runs >= min_samples], strict=True)
            if self.values[low] != 0 or not (low == 0 or high == len(self.values))
        ]
        if not found or len(found) > PREPARATION_LIMITS.max_faults:
            return
        low, high = found[0]
        value = f"{self.values[low]:.6g} {self._unit}"
        where = f"from {self._at(low)} to {self._at(high - 1)}"
        self._replace(found, f"{self._what} stands still at {value} {where}{_as_in_others(found)}")

    def _remove_leaps(self, fastest: float) -> None:
        """Remove leaps (jumps from one sample to the next) of a position.

        A leap is far larger than the largest usual step, and either larger than the neighbouring steps or faster than
        `fastest`, in m/s. If the position returns within 20 ms, the samples until then are replaced as a spike.
        """
        steps = np.diff(self.values)
        size = np.abs(steps)
        moved = size[size > 0]
        if len(moved) < 8:
            return
        usual = PREPARATION_LIMITS.leap_ratio * float(np.percentile(moved, 99))
        reach = PREPARATION_LIMITS.max_spike_samples
        leaps = []
        for k in np.flatnonzero(size > usual):
            neighbours = np.concatenate((size[max(0, k - reach) : k], size[k + 1 : k + 1 + reach]))
            if size[k] * self._rate_hz > fastest or size[k] > 3.0 * np.median(neighbours):
                leaps.append(int(k))
        if not leaps:
            return
        if len(leaps) > PREPARATION_LIMITS.max_faults:
            raise FitError(
                f"{self._file}: {self._what} leaps in {len(leaps)} places, first by {steps[leaps[0]]:.4g} "
                f"{self._unit} at {self._at(leaps[0] + 1)}: is it the right column, or was the encoder disturbed?"
            )
        spikes: Spans = []
        lost: Spans = []
        values, shift = self.values, np.zeros(len(self.values))
        back = max(2, round(PREPARATION_LIMITS.max_leap_return_s * self._rate_hz))
        # Longest usual standstill of the position, in samples.
        run = max(reach, 4 * len(values) / max(1, int(np.count_nonzero(steps))))
        while leaps:
            at = leaps[0]
            drift = float(np.median(steps[max(0, at - back) : at])) if at > 0 else 0.0
            near = [k for k in leaps[1:] if k - at <= back]
            last = max([k for k in near if abs(values[k + 1] - values[at] - drift * (k + 1 - at)) < usual], default=at)
            leaps = [k for k in leaps if k > last]
            still = np.flatnonzero(values[: at + 1] != values[at])
            since = int(still[-1]) + 1 if len(still) else 0
            if last > at:
                spikes.append((at + 1, last + 1))
            elif at - since >= run:
                lost.append((since + 1, at + 1))
            else:
                shift[at + 1] = steps[at] - drift
        if spikes:
            value = self._value(spikes[0][0])
            self._replace(spikes, f"{self._what} leaps to {value} and back{_as_in_others(spikes)}")
        if lost:
            low, high = lost[0]
            where = f"stands still from {self._at(low - 1)}"
            self._replace(lost, f"{self._what} {where}, and leaps to {self._value(high)}{_as_in_others(lost)}")
        if shift.any():
            slips = np.flatnonzero(shift).tolist()
            value = f"by {shift[slips[0]]:.4g} {self._unit} to {self._value(slips[0])}"
            self.warnings.append(f"{self._file}: {self._what} leaps {value}{_as_in_others(slips)}; the leap is removed")
            self.bad[slips] = True
            self.values = self.values - np.cumsum(shift)

    def _replace_leaping(self, found: Spans) -> None:
        if not found or len(found) > PREPARATION_LIMITS.max_faults:
            # More are a property of the recording.
            return
        low, high = found[0]
        peak = low + int(np.argmax(np.abs(self.values[low:high] - np.median(self.values))))
        self._replace(found, f"{self._what} leaps to {self._value(peak)} and back{_as_in_others(found)}")

    def _replace(self, spans: Spans, warning: str) -> None:
        """Interpolate these samples linearly, and add this warning."""
        bad = np.zeros(len(self.values), dtype=np.bool_)
        for low, high in spans:
            bad[low:high] = True
        if bad.all():
            raise FitError(f"{self._file}: {self._what} is impossible in all samples")
        at = np.arange(len(self.values))
        self.values = np.where(bad, np.interp(at, at[~bad], self.values[~bad]), self.values)
        self.bad |= bad
        self.warnings.append(f"{self._file}: {warning}; left out")

    def _value(self, sample: int) -> str:
        return f"{self.values[sample]:.6g} {self._unit} at {self._at(sample)}"

    def _at(self, sample: int) -> str:
        return f"{sample / self._rate_hz:.6g} s"


def _as_in_others(found: Sequence[object]) -> str:
    return f", as in {len(found) - 1} other places" if len(found) > 1 else ""


# ---- Complete sections: between gaps of the clock and clipped samples ------------------------------------------------


def between_gaps(recording: Recording, samples: int) -> list[tuple[int, int]]:
    """Return pairs (first sample, last sample + 1) of the sections of a recording without missing samples."""
    edges = [0, *(edge for gap in recording.gaps for edge in gap), samples]
    return [(begin, end) for begin, end in zip(edges[::2], edges[1::2], strict=True) if end > begin]


def sections_of(recordings: Sequence[Recording], min_s: float, excluded: Exclusions) -> list[Recording]:
    """Return the complete sections, of `min_s` or more, of all recordings; leave out incomplete recordings."""
    parts = excluded.each(recordings, lambda one: complete_sections(one, min_s, excluded))
    return [part for each in parts for part in each]


def complete_sections(recording: Recording, min_s: float, excluded: Exclusions) -> list[Recording]:
    """Return the sections of at least `min_s` without gaps and clipped samples, as recordings.

    The other parts are added to `excluded`. Raises FitError if too much is left out.
    """
    acceleration, rate_hz = recording.acceleration_m_per_s2, recording.rate_hz
    columns = _columns(recording)
    samples = next((len(values) for name, values in columns.items() if name != "speed_m_per_s"), 0)
    bad = np.zeros(samples, dtype=np.bool_)
    reasons = []
    if acceleration is not None and (cut := clipped(acceleration)).any():
        bad |= cut
        places = len(spans_of(cut))
        levels = " and ".join(f"{level:.4g}" for level in np.unique(acceleration[cut]))
        reasons.append(f"clipped at {levels} m/s^2 in {places} {'place' if places == 1 else 'places'}")
    if recording.gaps:
        reasons.append(gaps_in_words(recording))
    for begin, end in recording.gaps:
        bad[begin:end] = True
    if not bad.any():
        return [recording]
    kept = [(begin, end) for begin, end in spans_of(~bad) if end - begin >= min_s * rate_hz]
    usable = sum(end - begin for begin, end in kept)
    reason = ", ".join(reasons)
    if usable < PREPARATION_LIMITS.min_complete_fraction * samples:
        raise FitError(
            f"{recording.name}: {reason}: {100 * usable / samples:.0f} % of the samples are in complete sections of "
            f"{min_s:g} s, {100 * PREPARATION_LIMITS.min_complete_fraction:.0f} % are needed"
        )
    lost = f"{(samples - usable) / rate_hz:.3g} of {samples / rate_hz:.3g} s, {reason}"
    excluded.add(recording.name, lost, ONE_PART, fraction=1 - usable / samples)
    found = []
    for begin, end in kept:
        parts = {name: values[begin:end] for name, values in columns.items() if len(values) == samples}
        name = f"{recording.name} from {begin / rate_hz:.4g} s"
        found.append(dataclasses.replace(recording, name=name, gaps=(), **parts))  # type: ignore[arg-type]
    return found


def gaps_in_words(recording: Recording) -> str:
    """Return a phrase with the number and the time of the missing samples of a recording that has gaps."""
    (begin, end), more = recording.gaps[0], len(recording.gaps) - 1
    others = f", and in {more} more {'place' if more == 1 else 'places'}" if more else ""
    return f"{end - begin} samples are missing at {begin / recording.rate_hz:.4g} s{others}"


# ---- Acceleration, force, their units, and the rate ------------------------------------------------------------------


def acceleration_of(recording: Recording) -> Floats:
    """Return the acceleration (n,), m/s^2; raise FitError if it was not recorded or hardly changes."""
    values = recording.acceleration_m_per_s2
    if values is None:
        raise FitError(f"{recording.name}: no acceleration, which this fit needs")
    if not np.ptp(values) > 0:
        raise FitError(
            f"{recording.name}: the acceleration is {values[0]:g} m/s^2 throughout: was the sensor connected?"
        )
    if np.ptp(values) < PREPARATION_LIMITS.min_acceleration_span_m_per_s2:
        raise FitError(
            f"{recording.name}: the acceleration changes by {np.ptp(values):.2g} m/s^2, which is not felt: wrong unit?"
        )
    return values


def force_of(recording: Recording) -> Floats:
    """Return the normal force (n,), N; raise FitError if it was not recorded, is 0 or too small."""
    values = recording.force_n
    if values is None:
        raise FitError(f"{recording.name}: no force, which this fit needs")
    if not np.any(values):
        raise FitError(f"{recording.name}: the force is 0 throughout: was the sensor connected?")
    highest = float(np.percentile(np.abs(values), 99.9))
    if highest < PREPARATION_LIMITS.min_force_n:
        raise UnitError(f"{recording.name}: the largest force, {highest:.2g} N, is too small to be felt: is it in kN?")
    return values


def pressing_force(recording: Recording) -> Floats:
    """Return the force (n,), N, pressing positive; raise UnitError if it is mostly negative or oscillates about 0."""
    values = force_of(recording)
    if np.median(values) < 0:
        raise UnitError(f"{recording.name}: the force is mostly negative: pressing must be positive (scale -1?)")
    if np.mean(values < -0.1 * np.std(values)) > 0.2:
        raise UnitError(f"{recording.name}: the force oscillates about 0: is it swapped with the acceleration?")
    return values


def check_force_varies(recordings: Sequence[Recording], force: Floats, warnings: Warnings) -> None:
    """Raise FitError if all samples have the same force; downgrade the verdict if `force` varies by less than a fifth.

    `force` (n,) are the forces of the strikes or blocks, N.
    """
    every = np.concatenate([recording.force_n for recording in recordings if recording.force_n is not None])
    if not np.ptp(every) > 0:
        raise FitError(f"the force is {every[0]:g} N in every sample: was the sensor connected?")
    if float(np.ptp(force)) < PREPARATION_LIMITS.min_force_variation * abs(float(np.mean(force))):
        warnings.add_fair(
            f"the force hardly varies ({force.min():.3g} to {force.max():.3g} N): its gain includes everything that "
            "does not depend on speed"
        )


def check_range(usual: float, low: float, high: float, name: str) -> None:
    """Raise FitError unless an amplitude, m/s^2, is from `low` to `high`; `name` is its name in the error."""
    if not low <= usual <= high:
        raise FitError(
            f"{name}: must be between {low:g} and {high:g} m/s^2, is {usual:.3g}: wrong unit of the acceleration?"
        )


def vary_independently(speed: Floats, force: Floats) -> bool:
    """Return whether speed and force (n,) vary independently."""
    return statistics.well_conditioned(np.column_stack((speed, force)), 20)


def check_independent(speed: Floats, force: Floats) -> None:
    """Raise FitError if speed and force (n,) do not vary independently."""
    if not vary_independently(speed, force):
        raise FitError(
            f"speed ({speed.min():.3g} to {speed.max():.3g} m/s) and force ({force.min():.3g} to {force.max():.3g} N) "
            "rise and fall together or not at all, so that their gains cannot be separated: vary them independently"
        )


def changes_with(
    speed: Floats, force: Floats, hertz: Floats, name: str, min_change: float, confidence: float, warnings: Warnings
) -> tuple[Estimate | None, Estimate | None]:
    """Return the slopes of frequencies (n,) with speed and with force, or None if these do not vary independently.

    Downgrade the verdict if a slope is significant at this confidence, and changes the frequency by `min_change`, a
    fraction of the mean, or more. `name` is the name of the frequency in warnings.
    """
    columns = np.column_stack((speed, force, np.ones_like(speed)))
    if len(speed) < 6 or not statistics.well_conditioned(columns):
        warnings.note(f"too few strokes at different speeds and forces to show whether the {name} depends on them")
        return None, None
    line = statistics.least_squares(columns, hertz)
    wider = statistics.student_t(line.freedom, confidence) / statistics.student_t(line.freedom)
    for slope, values, cause, unit in zip(
        line.coefficients, (speed, force), ("speed", "force"), ("m/s", "N"), strict=False
    ):
        change = slope.value * float(np.ptp(values))
        if abs(slope.value) > wider * (slope.high - slope.value) and abs(change) > min_change * float(hertz.mean()):
            warnings.add_fair(
                f"the {name} changes with {cause}: by {change:+.3g} Hz from {values.min():.3g} to {values.max():.3g} "
                f"{unit}; the material has the mean"
            )
    return line.coefficients[0], line.coefficients[1]


def gravity_of(recordings: Sequence[Recording]) -> list[str]:
    """Return a warning for each recording whose acceleration at rest suggests a wrong unit."""
    found = []
    for recording in recordings:
        if recording.acceleration_m_per_s2 is None:
            continue
        rest = abs(float(np.median(recording.acceleration_m_per_s2)))
        for usual, unit in ((1.0, "g"), (9.80665**2, "m/s^2 already, and multiplied by 9.80665 again")):
            if abs(rest / usual - 1) < PREPARATION_LIMITS.gravity_tolerance:
                found.append(f"{recording.name}: rests at {rest:.3g} m/s^2: is the acceleration in {unit}?")
    return found


def report_gravity(recordings: Sequence[Recording], warnings: Warnings) -> None:
    """Downgrade the verdict for each recording whose acceleration at rest suggests a wrong unit."""
    for line in gravity_of(recordings):
        warnings.add_fair(line)


def undersampled(rate_hz: float, frequency_hz: float, minimum: float = PREPARATION_LIMITS.min_samples_per_cycle) -> str:
    """Return a phrase if a rate gives fewer than `minimum` samples in a cycle of a frequency, else an empty string."""
    if rate_hz >= minimum * frequency_hz:
        return ""
    return (
        f"rings at {frequency_hz:.4g} Hz, and its sampling rate of {rate_hz:g} Hz is too low: must be at least "
        f"{minimum:g} times that, {math.ceil(minimum * frequency_hz)} Hz"
    )


def report_sampling(recordings: Sequence[Recording], frequency_hz: float, warnings: Warnings) -> None:
    """Downgrade the verdict if the lowest sampling rate gives few samples in a cycle of `frequency_hz`."""
    slowest = min(recording.rate_hz for recording in recordings)
    warnings.check("samples in a cycle", slowest / frequency_hz, rate_hz=slowest, hz=frequency_hz)


# ---- Strokes along the surface ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Stroke(Cleaned):
    """A recording of a stroke whose impossible samples are replaced; all arrays are (n,)."""

    acceleration: Floats
    """m/s^2."""
    force: Floats
    """N."""
    position: Floats
    """m along the surface, from an arbitrary origin."""
    speed: Floats
    """m/s along the surface, signed."""


def stroke_of(recording: Recording, kind: Kind) -> Stroke:
    """Return the stroke of a recording for a fit of this kind; raise FitError if it cannot be a stroke."""
    kept = without_invalid_samples(recording, kind)
    acceleration, force = acceleration_of(kept.recording), pressing_force(kept.recording)
    position, speed = _motion_of(kept.recording, len(acceleration))
    return Stroke(kept.recording, kept.replaced, kept.warnings, acceleration, force, position, speed)


def _motion_of(recording: Recording, samples: int) -> tuple[Floats, Floats]:
    """Return the position and the speed along the surface (n,), from the recorded position or speed.

    Raises FitError if neither was recorded, or if both disagree.
    """
    name, position = recording.name, recording.tangential_position_m
    column: Floats | None = None
    if recording.speed_m_per_s is not None:
        given = np.asarray(recording.speed_m_per_s, dtype=np.float64).reshape(-1)
        if given.size not in (1, samples):
            raise FitError(
                f"{name}: {given.size} speeds for {samples} samples: a stroke needs one speed, or one for each sample"
            )
        column = np.full(samples, given[0]) if given.size == 1 else given
    if position is None:
        if column is None:
            raise FitError(f"{name}: no position along the surface and no speed: a stroke needs one of them")
        _refuse_speed(recording, column)
        return np.concatenate(([0.0], np.cumsum((column[1:] + column[:-1]) / 2))) / recording.rate_hz, column
    if np.ptp(position) > (max_m := PREPARATION_LIMITS.max_stroke_m):
        raise UnitError(f"{name}: a stroke must be at most {max_m:g} m, is {np.ptp(position):.4g} m: is it in mm?")
    if not np.ptp(position) > 0:
        raise FitError(f"{name}: the position along the surface never moves: is it the wrong column?")
    found = slope_of(position, recording.rate_hz, 0.02)
    _refuse_speed(recording, found)
    if column is not None:
        usual, given_speed = float(np.median(np.abs(found))), float(np.median(np.abs(column)))
        ratio = PREPARATION_LIMITS.max_speed_ratio
        if not usual / ratio <= given_speed <= ratio * usual:
            raise UnitError(
                f"{name}: the speed from the position is {usual:.3g} m/s, the speed column has {given_speed:.3g} m/s: "
                "one of them has the wrong unit or column"
            )
    return position, found


def _refuse_speed(recording: Recording, speed: Floats) -> None:
    usual = float(np.percentile(np.abs(speed), 90))
    if usual > PREPARATION_LIMITS.max_stroke_speed_m_per_s:
        raise UnitError(f"{recording.name}: a speed of {usual:.4g} m/s is too high: is it in mm/s?")
    fastest = int(np.argmax(np.abs(speed)))
    if not abs(speed[fastest]) <= PREPARATION_LIMITS.max_stroke_speed_m_per_s:
        at_s = fastest / recording.rate_hz
        raise FitError(
            f"{recording.name}: a speed of {abs(speed[fastest]):.4g} m/s at {at_s:.6g} s is impossible (at most "
            f"{PREPARATION_LIMITS.max_stroke_speed_m_per_s:g}): check the position there"
        )
    if usual < PREPARATION_LIMITS.min_stroke_speed_m_per_s:
        raise UnitError(f"{recording.name}: a speed of {usual:.2g} m/s is too low: is it in km/s, or another column?")


def slope_of(values: Floats, rate_hz: float, window_s: float) -> Floats:
    """Return the slopes (n,), per second, of lines fitted to a window about each sample, shorter at the ends."""
    count = len(values)
    half = min(max(1, round(window_s * rate_hz / 2)), (count - 1) // 2)
    centred = values - values[count // 2]
    ones = np.concatenate(([0.0], np.cumsum(centred)))
    ramps = np.concatenate(([0.0], np.cumsum(centred * np.arange(count))))
    low, high = _about(count, half)
    number = (high - low).astype(np.float64)
    moment = number * (number**2 - 1) / 12
    return np.asarray(((ramps[high] - ramps[low]) - (low + high - 1) / 2 * (ones[high] - ones[low])) / moment * rate_hz)


def noise_of(values: Floats) -> float:
    """Return the standard deviation of the noise of slowly changing values (n,), from differences between samples."""
    return 1.4826 * float(np.median(np.abs(np.diff(values)))) / math.sqrt(2)


def running_mean(values: Floats, half: int) -> Floats:
    """Return the means (n,) of 2 half + 1 samples about each sample, fewer at the ends."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    low, high = _about(len(values), half)
    return np.asarray((total[high] - total[low]) / (high - low))


def _about(count: int, half: int) -> tuple[Ints, Ints]:
    """Return the first sample (count,), and the last sample + 1 (count,), of the window about each sample."""
    at = np.arange(count)
    return np.maximum(at - half, 0), np.minimum(at + half + 1, count)
