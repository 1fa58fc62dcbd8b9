"""Fit of punctures of a membrane: stiffness, depth and force of the rupture, and the mode that it strikes.

Okamura, Dennerlein and Howe, "Vibration Feedback Models for Virtual Environments", ICRA 1998: F = K d until the
rupture, then no force, and a ringing whose amplitude does not depend on speed. The rupture is where the force falls
most within a few milliseconds. K and the position of the surface come from a line fitted to force versus position
before the rupture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.recordings.clipping import clipped
from hapticd.analysis.statistics import Estimate, FitError, Floats, UnitError, common, with_offset
from hapticd.fit import preparation
from hapticd.fit.limits import PUNCTURE_LIMITS
from hapticd.fit.recording import Recording
from hapticd.fit.result import Fit
from hapticd.fit.ringing import Ringing, fit_ringing
from hapticd.fit.spectral_lines import SpectralLine, lines_in_residual, report_lines
from hapticd.fit.verdict import Exclusions, Warnings


@dataclass(frozen=True, slots=True)
class Rupture:
    """Result of one fitted puncture; `time_s` is the time of the rupture after the first sample."""

    recording: str
    time_s: float
    speed_m_per_s: float
    stiffness_n_per_m: float
    depth_m: float
    force_n: float
    amplitude_m_per_s2: float
    frequency_hz: float
    decay_rate_per_s: float
    variance_accounted_for: float


# ---- Model: one puncture, from the drop of the force back to the touch, then the ringing -----------------------------


class _Puncture:
    """Fit of a recording of one puncture, with warnings."""

    def __init__(self, recording: Recording) -> None:
        """Fit the puncture; raise FitError if the recording has no puncture that can be fitted."""
        self._kept = preparation.without_invalid_samples(recording, "puncture")
        self.warnings = Warnings()
        preparation.report_cleaning([self._kept], self.warnings)
        recording = self._kept.recording
        name, rate_hz = recording.name, recording.rate_hz
        force, place = preparation.force_of(recording), recording.position_m
        if place is None:
            raise FitError(f"{name}: no position along the normal, which this fit needs")
        if np.ptp(place) > (max_m := PUNCTURE_LIMITS.max_depth_m):
            raise UnitError(
                f"{name}: the position must span at most {max_m:g} m, spans {np.ptp(place):.4g}: is it in mm?"
            )
        if not np.ptp(place) > 0:
            raise FitError(f"{name}: the position never moves: is it the wrong column?")
        if float(np.median(force)) < 0 and -float(force.min()) > float(force.max()):
            raise UnitError(f"{name}: the force is mostly negative: pressing must be positive (scale -1?)")
        at = _drop(force, rate_hz)
        if at is None:
            raise _no_puncture(name)
        self._name, self._rate_hz, self._force, self._place = name, rate_hz, force, place
        self._at = at
        """Index of the last sample before the drop of the force."""
        self._half = max(1, round(PUNCTURE_LIMITS.max_drop_s * rate_hz / 2))
        self._smooth = preparation.running_mean(force, self._half)
        """(n,) force averaged over PUNCTURE_LIMITS.max_drop_s, N."""
        self._speed = preparation.slope_of(place, rate_hz, 8 * PUNCTURE_LIMITS.max_drop_s)
        self._seen = preparation.acceleration_of(recording)
        self._load()
        self._check_touch()
        self.rupture = self._ruptured()

    def _load(self) -> None:
        """Fit a line to force versus position before the rupture.

        Sets the stiffness, the force without contact, the position of the surface (where the line has this force), and
        the load just before the drop. Raises FitError if the force does not follow the position.
        """
        at, half, smooth, name = self._at, self._half, self._smooth, self._name
        first = max(0, at - 2 * half)
        highest = float(np.median(self._force[first : max(at - half, first + 1)]))
        early = np.flatnonzero(smooth[: at - half] < PUNCTURE_LIMITS.min_load * highest)
        self._begin = int(early[-1]) + 1 if len(early) else 0
        loaded = np.arange(self._begin, at - half)
        loaded = loaded[smooth[loaded] < PUNCTURE_LIMITS.max_load * highest]
        if len(loaded) < PUNCTURE_LIMITS.min_loaded_samples:
            raise FitError(
                f"{name}: the force rises within {len(loaded)} samples, {PUNCTURE_LIMITS.min_loaded_samples} are "
                "needed for a stiffness"
            )
        path, pressed = self._place[loaded], self._force[loaded]
        level, stiffness = map(float, np.polynomial.polynomial.polyfit(path - path.mean(), pressed, 1))
        if float(np.corrcoef(path, pressed)[0, 1]) ** 2 < PUNCTURE_LIMITS.min_r_squared:
            raise FitError(f"{name}: the force does not follow the position before it drops: are columns swapped?")
        if stiffness < 0:
            raise UnitError(
                f"{name}: the force falls with the position, which must rise as the stylus presses in (scale -1?)"
            )
        if not PUNCTURE_LIMITS.min_stiffness_n_per_m <= stiffness <= PUNCTURE_LIMITS.max_stiffness_n_per_m:
            raise UnitError(
                f"{name}: the stiffness must be between {PUNCTURE_LIMITS.min_stiffness_n_per_m:g} and "
                f"{PUNCTURE_LIMITS.max_stiffness_n_per_m:g} N/m, is {stiffness:.3g}: is a unit off by a thousand?"
            )
        near = path < np.median(path)
        below, above = (float(np.polyfit(path[part], pressed[part], 1)[0]) for part in (near, ~near))
        if abs(above - below) > PUNCTURE_LIMITS.max_stiffness_change * stiffness:
            self._warn(
                "the stiffness changes",
                f"the stiffness changes from {below:.4g} to {above:.4g} N/m as the stylus presses in",
            )
        # The sensor may have an offset before the touch.
        rest, surface, quiet = 0.0, 0.0, np.zeros(0)
        for _ in range(3):
            surface = float(path.mean()) - (level - rest) / stiffness
            free = np.flatnonzero(self._place[: self._begin] < surface)
            quiet = self._force[: max(0, int(free[-1]) - 2 * half if len(free) else 0)]
            rest = float(np.median(quiet)) if len(quiet) >= 20 else 0.0
        if len(quiet) < 20:
            self._warn("begun in contact", "begins in contact: the sensor is assumed to read 0 without force")
        self._load_n, self._stiffness_n_per_m, self._surface_m, self._rest_n = highest - rest, stiffness, surface, rest

    def _warn(self, what: str, text: str) -> None:
        self.warnings.add_for_recording(what, f"{self._name}: {text}")

    def _check_touch(self) -> None:
        """Add a warning if the membrane is softer at first than the fitted line.

        The membrane is softer if the force reaches 2 % of the load (or six standard errors, if larger) by more than 3 %
        of the rupture's depth before the line does.
        """
        half, noise = self._half, preparation.noise_of(self._force)
        touch_n = max(PUNCTURE_LIMITS.touch_load * self._load_n, 6.0 * noise / math.sqrt(2 * half + 1))
        touched = np.flatnonzero(self._smooth[: self._at - half] - self._rest_n > touch_n)
        if not len(touched):
            return
        due = self._surface_m + touch_n / self._stiffness_n_per_m
        early_m = due - float(np.mean(self._place[max(0, touched[0] - half) : touched[0] + half + 1]))
        if early_m > PUNCTURE_LIMITS.max_soft_depth * self._load_n / self._stiffness_n_per_m:
            self._warn(
                "softer at first",
                f"the membrane is softer at first: the fitted line begins {1e3 * early_m:.3g} mm or more after the "
                "touch, and the depth is counted from there",
            )

    def _ruptured(self) -> Rupture:
        """Return the result of the fit; raise FitError if the stylus was withdrawn or there are two ruptures."""
        at, half, force = self._at, self._half, self._force
        index = np.arange(max(0, at - 4 * half), at + 1)
        fitted = np.polynomial.polynomial.polyfit(index - at, self._place[index], 1)
        if self._speed[at] <= 0:
            # The stylus was withdrawn, or it bounced off.
            raise _no_puncture(self._name)
        # The force drops between this sample and the next.
        depth = float(fitted[0] + 0.5 * fitted[1]) - self._surface_m
        ringing = self._ringing()
        left = float(np.median(force[at + 2 * half : at + 6 * half])) - self._rest_n
        if left > PUNCTURE_LIMITS.max_remaining_force * self._load_n:
            self._warn(
                "force is left after the rupture",
                f"{100 * left / self._load_n:.0f} % of the force is left after the rupture: something holds the "
                "stylus, which the model does not have",
            )
        # Another drop from 0.3 of the load, while the stylus advances, is a second rupture.
        for start, part in ((0, force[: max(0, at - 4 * half)]), (at + 4 * half, force[at + 4 * half :])):
            other = _drop(part, self._rate_hz)
            if other is None or not part[other] - self._rest_n > PUNCTURE_LIMITS.min_second_drop_load * self._load_n:
                continue
            if self._speed[start + other] > 0:
                early, late = sorted((at, start + other))
                places = f"{early / self._rate_hz:.4g} s and at {late / self._rate_hz:.4g} s"
                raise FitError(f"{self._name}: ruptures at {places}: record each puncture in a separate file")
        fraction = ringing.variance_accounted_for
        if fraction < PUNCTURE_LIMITS.well_explained:
            self.warnings.note(f"{self._name}: one mode explains {100 * fraction:.0f} % of the ringing")
        return Rupture(
            recording=self._name,
            time_s=(at + 0.5) / self._rate_hz,
            speed_m_per_s=float(self._speed[at]),
            stiffness_n_per_m=self._stiffness_n_per_m,
            depth_m=depth,
            force_n=self._stiffness_n_per_m * depth,
            amplitude_m_per_s2=abs(float(ringing.coefficients[0])),
            frequency_hz=float(ringing.angular_frequency_rad_per_s[0]) / (2 * math.pi),
            decay_rate_per_s=float(ringing.decay_rate_per_s[0]),
            variance_accounted_for=fraction,
        )

    def _ringing(self) -> Ringing:
        """Return the mode of the rupture; raise FitError if the ringing is incomplete or is not one mode."""
        name, at, rate_hz, begin, seen = self._name, self._at, self._rate_hz, self._begin, self._seen
        first = max(0, at - round(PUNCTURE_LIMITS.before_rupture_s * rate_hz))
        end = min(len(seen), at + round(PUNCTURE_LIMITS.after_rupture_s * rate_hz))
        if np.mean(self._kept.replaced[begin:end]) > PUNCTURE_LIMITS.max_replaced:
            percent = 100 * PUNCTURE_LIMITS.max_replaced
            raise FitError(f"{name}: over {percent:g} % of the samples from touch to end of ringing are impossible")
        if clipped(seen)[first:end].any():
            raise FitError(
                f"{name}: the ringing of the rupture is clipped at {np.abs(seen[first:end]).max():.4g} m/s^2; record "
                "with a wider range"
            )
        recording = self._kept.recording
        if any(begin < last and early < end for early, last in recording.gaps):
            gaps = preparation.gaps_in_words(recording)
            raise FitError(f"{name}: {gaps}, between the touch and the end of the ringing")
        try:
            # A slow force sensor shows the rupture late.
            onsets = [max(0.0, (at + 0.5 - first) / rate_hz - late_s) for late_s in (0.0, 0.002, 0.005)]
            fits = [fit_ringing(seen[first:end], rate_hz, onset_s=onset_s) for onset_s in onsets]
        except FitError as error:
            raise FitError(f"{name}: the rupture has no ringing: {error}") from None
        ringing = min(fits, key=lambda each: each.noise_m_per_s2)
        hertz = float(ringing.angular_frequency_rad_per_s[0]) / (2 * math.pi)
        if slow := preparation.undersampled(rate_hz, hertz):
            raise FitError(f"{name}: {slow}")
        if ringing.variance_accounted_for < PUNCTURE_LIMITS.min_explained:
            raise FitError(
                f"{name}: one mode explains {100 * ringing.variance_accounted_for:.0f} % of the ringing, "
                f"{100 * PUNCTURE_LIMITS.min_explained:.0f} % are needed"
            )
        return ringing


def _no_puncture(name: str) -> FitError:
    return FitError(f"{name}: no puncture here: the force never drops at once while the stylus advances")


def _drop(force: Floats, rate_hz: float) -> int | None:
    """Return the index of the last sample before the force drops at once by half or more; None without such a drop."""
    half = max(1, round(PUNCTURE_LIMITS.max_drop_s * rate_hz / 2))
    if len(force) < 20 * half:
        return None
    mean = preparation.running_mean(force, half)
    fall = mean[: -4 * half] - mean[4 * half :]
    middle = int(np.argmax(fall)) + 2 * half
    before, after = float(mean[middle - 2 * half]), float(mean[middle + 2 * half])
    rest = float(np.median(force[: len(force) // 20]))
    noise = preparation.noise_of(force)
    if before - rest < 5 * noise or before - after < PUNCTURE_LIMITS.min_drop * (before - min(rest, 0.0)):
        return None
    held = np.flatnonzero(force[middle - 2 * half : middle + 2 * half] > (before + after) / 2)
    return middle - 2 * half + int(held[-1]) if len(held) else None


# ---- The fit: means over the punctures, and the verdict --------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class PunctureFit(Fit):
    """Result of a fit of punctures of one membrane. All intervals are 95 % confidence intervals."""

    stiffness_n_per_m: Estimate
    depth_m: Estimate
    force_n: Estimate
    amplitude_m_per_s2: Estimate
    frequency_hz: Estimate
    decay_rate_per_s: Estimate
    amplitude_per_speed_per_s: Estimate | None
    """Slope of the amplitude with speed; None for fewer than four punctures or nearly equal speeds."""
    ruptures: tuple[Rupture, ...]

    def material(self) -> dict[str, object]:
        """Return the keys of a material."""
        names = ("depth_m", "amplitude_m_per_s2", "frequency_hz", "decay_rate_per_s")
        rupture = {name: getattr(self, name).value for name in names}
        return {"stiffness_n_per_m": self.stiffness_n_per_m.value, "rupture": rupture}


def fit_puncture(recordings: Sequence[Recording], excluded: Exclusions | None = None) -> PunctureFit:
    """Fit a membrane to two or more recordings of one puncture each.

    Unusable recordings are added to `excluded`. Raises FitError if fewer than two are left, or if their punctures do
    not agree.
    """
    excluded = Exclusions() if excluded is None else excluded
    warnings = Warnings()
    ruptures = _ruptures(recordings, excluded, warnings)
    by_name = {recording.name: recording for recording in recordings}
    used = [each for each in recordings if each.name in {rupture.recording for rupture in ruptures}]
    preparation.report_gravity(used, warnings)

    def lines(rupture: Rupture, needed: int) -> list[SpectralLine]:
        """Return the spectral lines of the acceleration before the rupture."""
        recording = by_name[rupture.recording]
        seen = recording.acceleration_m_per_s2
        assert seen is not None
        model = np.full(len(seen), math.nan)
        until = max(0, round((rupture.time_s - PUNCTURE_LIMITS.before_rupture_s) * recording.rate_hz))
        model[:until] = np.median(seen[:until]) if until else 0.0
        return lines_in_residual(seen, model, recording.rate_hz, needed)

    report_lines(ruptures, lines, warnings)
    warnings.check("punctures", len(ruptures))

    low, high = PUNCTURE_LIMITS.min_amplitude_m_per_s2, PUNCTURE_LIMITS.max_amplitude_m_per_s2
    usual = float(np.median([each.amplitude_m_per_s2 for each in ruptures]))
    preparation.check_range(usual, low, high, "median amplitude of the ruptures")
    named = {
        "depth_m": "rupture depth",
        "stiffness_n_per_m": "stiffness",
        "amplitude_m_per_s2": "amplitude",
        "frequency_hz": "frequency",
        "decay_rate_per_s": "decay rate",
        "force_n": "force",
    }
    figures = {name: common(np.array([getattr(each, name) for each in ruptures])) for name in named}
    depth, frequency = figures["depth_m"], figures["frequency_hz"]
    preparation.report_sampling(used, frequency.value, warnings)
    by_speed = _amplitude_over_speed(ruptures, figures["amplitude_m_per_s2"], warnings)
    for name in ("stiffness_n_per_m", "amplitude_m_per_s2", "decay_rate_per_s"):
        figure = figures[name]
        if figure.low <= 0:
            within = f"{figure.value:.3g} ({figure.low:.3g} to {figure.high:.3g})"
            raise FitError(f"the punctures do not agree on the {named[name]}: {within}")
    if depth.low <= 0 or depth.high - depth.low > depth.value:
        warnings.note(f"the rupture depth is uncertain: {1e3 * depth.low:.3g} to {1e3 * depth.high:.3g} mm")
    for name, figure in figures.items():
        # The force follows from stiffness and depth.
        if name != "force_n":
            warnings.check_interval(named[name], figure)
    scatter = float(np.std([math.log(each.frequency_hz) for each in ruptures]))
    warnings.check("scatter of the frequency", scatter, events="punctures", one="membrane")
    explained = float(np.median([each.variance_accounted_for for each in ruptures]))
    warnings.check("variance that a rupture's mode explains", explained)
    return PunctureFit(
        **figures,
        amplitude_per_speed_per_s=by_speed,
        ruptures=tuple(ruptures),
        warnings=tuple(warnings.lines),
        judged=warnings.verdict(
            f"{len(ruptures)} punctures at {1e3 * depth.value:.4g} mm, "
            f"{figures['stiffness_n_per_m'].value:.4g} N/m, ringing at {frequency.value:.4g} Hz"
        ),
        left_out=tuple(excluded.items),
    )


def _ruptures(recordings: Sequence[Recording], excluded: Exclusions, warnings: Warnings) -> list[Rupture]:
    """Fit each recording separately; return two or more ruptures, and add the warnings of their recordings.

    Raises FitError for fewer than two ruptures.
    """
    preparation.refuse_duplicates(recordings)
    found = excluded.each(recordings, _Puncture)
    if not found:
        raise excluded.refused(f"none of {len(recordings)} recordings can be used" if recordings else "no recordings")
    ruptures = _without_outliers([each.rupture for each in found], excluded)
    if len(ruptures) < PUNCTURE_LIMITS.min_punctures:
        raise excluded.refused("one puncture gives no interval: at least two recordings of a puncture are needed")
    used = {each.recording for each in ruptures}
    for each in found:
        if each.rupture.recording in used:
            warnings.merge(each.warnings)
    excluded.report_recordings(recordings, warnings)
    return ruptures


def _without_outliers(ruptures: list[Rupture], excluded: Exclusions) -> list[Rupture]:
    """Return the ruptures whose ringing is within a factor of three of the median; add the others to `excluded`.

    If more than a quarter of the ruptures are outliers, all are returned.
    """
    ringing = np.array([[each.amplitude_m_per_s2, each.frequency_hz, each.decay_rate_per_s] for each in ruptures])
    usual = np.median(ringing, axis=0)
    off = np.maximum(ringing / usual, usual / ringing).max(axis=1) > PUNCTURE_LIMITS.max_outlier_ratio
    if np.count_nonzero(off) > PUNCTURE_LIMITS.max_outlier_fraction * len(ruptures):
        return ruptures
    for each, far in zip(ruptures, off, strict=True):
        if far:
            excluded.add(
                each.recording,
                f"the ringing has {each.amplitude_m_per_s2:.3g} m/s^2, {each.frequency_hz:.4g} Hz and a decay rate of "
                f"{each.decay_rate_per_s:.3g} 1/s, usual are {usual[0]:.3g}, {usual[1]:.4g} and {usual[2]:.3g}",
            )
    return [each for each, far in zip(ruptures, off, strict=True) if not far]


def _amplitude_over_speed(ruptures: Sequence[Rupture], amplitude: Estimate, warnings: Warnings) -> Estimate | None:
    """Return the slope of amplitude with speed, or None for fewer than four punctures or nearly equal speeds.

    A material has no such slope, so a significant one downgrades the verdict.
    """
    speed = np.array([each.speed_m_per_s for each in ruptures])
    if (
        len(ruptures) < PUNCTURE_LIMITS.min_trend_punctures
        or not np.ptp(speed) > PUNCTURE_LIMITS.min_speed_span * speed.mean()
    ):
        return None
    by_speed = with_offset(speed, np.array([each.amplitude_m_per_s2 for each in ruptures])).coefficients[0]
    change = by_speed.value * float(np.ptp(speed))
    if by_speed.excludes_zero and abs(change) > PUNCTURE_LIMITS.min_amplitude_change * amplitude.value:
        warnings.add_fair(
            f"the amplitude changes with speed: by {change:+.3g} m/s^2 from {speed.min():.3g} to {speed.max():.3g} m/s"
            "; the material has the mean"
        )
    return by_speed
