"""Mass, damping, dry friction and stiffness from a drive, with bounds.

The model is the simulated joystick itself (csrc/device/hd_sim_solver.c), driven by the recorded force, without steps of
encoder and actuator:

    m x'' + b x' + c sign(x') + k x = F(t) + g,    seen d later,

exact between the periods, dry friction with its rests included. A force that is held for longer than a period of the
servo, as by a link, is either the staircase that changes with each report, or its running mean over the hold, which is
what a staircase does below its rate; the one that explains more. m, b, c, k and d are those of the whole drive; c and d
are the device's own, so that a drive of a held handle takes them from the one before it (under a hand, damping times
delay looks like mass). Where a burst begins, how fast, and the constant force g beside it (a hand's drift, a
weight) are its own.

Least squares over positions, by Levenberg and Marquardt's method. Its residuals are what the encoder rounds off, and
what the model does not know; neither is white, so the bounds come from the bursts: the jackknife of the fit that leaves
one of them out at a time (its variance is that of MacKinnon, Nielsen and Webb, "Fast and reliable jackknife and
bootstrap methods for cluster-robust inference", 2023, CV3), and Student's t with as many degrees of freedom as there
are bursts but one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.calibration.sweep import LEAD_S, Burst, Floats, Record
from hapticd.analysis.statistics import Estimate
from hapticd.base.core import ffi, invalid_reason, lib, pointer
from hapticd.base.errors import HapticdError

SETTLED_S: Final = 0.005
MOST_SAMPLES: Final = 2000
"""Of a burst; more of them say the same."""
ITERATIONS: Final = 60
ENOUGH: Final = 1e-7
"""A step that lessens the sum of squares by less than this moves nothing by a noticeable part of its bounds."""
CONFIDENCE: Final = 0.95
UNFELT_M: Final = 1e-7
"""What moves a handle by less than this says nothing."""
LONGEST_STEP: Final = 10.0
"""Of what is a burst's own, in one iteration, in its scales."""
SUSPECT: Final = 1.2
"""A burst whose squares are so many times the usual ones is fitted again from the start."""
OWN_STEPS: Final = 12
FIRST_S: Final = 0.01
_GLOBALS: Final = 5
_BURSTS_LEAST: Final = 6
_WIDE_M: Final = 100.0


@dataclass(frozen=True, slots=True)
class Point:
    """What was measured at one frequency, over what the fit says: spectra of a burst, tapered.

    Times the fit's response this is the measured one, without what friction and the burst's begin add to its spectrum.
    """

    frequency_hz: float
    ratio: complex


@dataclass(frozen=True, slots=True)
class Fit:
    """What one drive says. `error` are standard errors, `freedom` their degrees of freedom."""

    mass_kg: float
    damping_n_s_per_m: float
    friction_n: float
    stiffness_n_per_m: float
    delay_s: float
    error: tuple[float, float, float, float, float]
    freedom: int
    residual_m: float
    """RMS of what is left of the positions."""
    motion_m: float
    """RMS of the positions."""
    points: tuple[Point, ...]
    """Of the encoder, by frequency, one for each that moved it."""

    @property
    def values(self) -> tuple[float, float, float, float, float]:
        return (self.mass_kg, self.damping_n_s_per_m, self.friction_n, self.stiffness_n_per_m, self.delay_s)

    def response(self, frequency_hz: Floats) -> npt.NDArray[np.complex128]:
        """Position over force, m/N, of the linear part."""
        s = 2j * math.pi * frequency_hz
        return np.asarray(1.0 / (self.mass_kg * s**2 + self.damping_n_s_per_m * s + self.stiffness_n_per_m))

    def estimate(self, which: int, least: float = 0.0) -> Estimate:
        """Of `values`, with bounds; the lower one is not below `least`."""
        return bounded(self.values[which], self.error[which], self.freedom, least)


def difference(held: Fit, free: Fit, which: int) -> Estimate:
    """Held minus free, with the bounds of two independent fits (Welch and Satterthwaite)."""
    variances = (held.error[which] ** 2, free.error[which] ** 2)
    total = sum(variances)
    parts = variances[0] ** 2 / held.freedom + variances[1] ** 2 / free.freedom
    freedom = total**2 / parts if parts > 0 else min(held.freedom, free.freedom)
    return bounded(held.values[which] - free.values[which], math.sqrt(total), freedom)


def bounded(value: float, error: float, freedom: float, least: float = 0.0) -> Estimate:
    """A number with 95 % bounds from its standard error; the lower one is not below `least`."""
    half = error * student_t(freedom)
    return Estimate(value, max(least, value - half), value + half)


def student_t(freedom: float) -> float:
    """The two-sided 95 % quantile of Student's t: Hill, "Algorithm 396", Comm. ACM 13 (1970), Cornish and Fisher's
    expansion to the fourth order; within 0.1 % from 4 degrees of freedom on."""
    z = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2)
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / freedom ** (order + 1) for order, term in enumerate(terms))


@dataclass(frozen=True, slots=True)
class _Window:
    """One burst: the force at each period, and the periods whose positions count."""

    frequency_hz: float
    force_n: Floats
    at: np.ndarray[tuple[int], np.dtype[np.int64]]
    seen_m: Floats


class _Device:
    """The model."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz

    def motion(self, values: Floats, start: Floats, force_n: Floats) -> Floats:
        """(n, 2) position and velocity at the periods of `force_n`; `values` m, b, c, k, and `start` x, v, g."""
        config = ffi.new("struct hd_sim_config *")
        config.handle_mass_kg, config.handle_damping_n_s_per_m, config.coulomb_friction_n = values[:3]
        config.hand_stiffness_n_per_m = values[3]
        config.max_force_n, config.workspace_m, config.force_timeout_s = 1e6, _WIDE_M, 1e6
        made = lib.hd_sim_new(config, self._period_s)
        if made == ffi.NULL:
            raise HapticdError(f"the fit does not hold: {invalid_reason()}")
        sim = ffi.gc(made, lib.hd_sim_free)
        if lib.hd_sim_place(sim, ffi.new("double[2]", [start[0], 0.0]), ffi.new("double[2]", [start[1], 0.0])):
            raise HapticdError(f"the fit does not hold: {invalid_reason()}")
        force = np.zeros((len(force_n), 2))
        force[:, 0] = force_n + start[2]
        moved = np.empty((len(force_n), 4))
        lib.hd_sim_drive(sim, pointer("double[]", force), len(force), pointer("double[]", moved))
        return moved[:, ::2]


def fit(record: Record, free: Fit | None = None) -> Fit:
    """What a drive says of a handle alone, or, where it is `held`, of handle and hand; `free` is then what it is alone.

    Raises HapticdError where it says too little.
    """
    forces = held_forces(record)
    return min((_Fitting(record, force, free).run() for force in forces), key=lambda found: found.residual_m)


def held_forces(record: Record) -> list[Floats]:
    """What the force may have been at the actuator, each (n,), but for a delay."""
    periods = max(1, round(record.hold_s * record.rate_hz))
    if periods == 1:
        return [record.force_n]
    padded = np.concatenate((np.full(periods - 1, record.force_n[0]), record.force_n))
    mean = np.convolve(padded, np.full(periods, 1.0 / periods), mode="valid")
    reports = np.flatnonzero(~np.isnan(record.position_m))
    if len(reports) < 2 or np.median(np.diff(reports)) != periods:
        return [mean]
    frame = np.maximum.accumulate(np.where(np.isnan(record.position_m), 0, np.arange(len(record.position_m))))
    return [mean, record.force_n[np.maximum(frame - 1, 0)]]


def model_motion(record: Record, found: Fit) -> Floats:
    """(n, 2) position and velocity at the periods of a whole drive, as the fit says, from rest."""
    force = held_forces(record)[-1]
    return _Device(record.rate_hz).motion(np.array(found.values), np.zeros(3), force)


def tapered(time_s: npt.NDArray[np.floating], frequency_hz: float) -> npt.NDArray[np.complex128]:
    """A turning pointer at a frequency, which begins and ends at nothing (Hann's window)."""
    taper = np.sin(math.pi * (time_s - time_s[0]) / (time_s[-1] - time_s[0])) ** 2
    return np.asarray(taper * np.exp(-2j * math.pi * frequency_hz * time_s))


class _Fitting:
    def __init__(self, record: Record, force: Floats, known: Fit | None) -> None:
        self._record = record
        self._known = known
        # A handle that nobody holds has no stiffness.
        self._fitted = np.array([True, True, known is None, record.held, known is None])
        self._device = _Device(record.rate_hz)
        self._period_s = 1.0 / record.rate_hz
        seen = record.position_m[~np.isnan(record.position_m)]
        self._middle = float(np.median(seen)) if record.held else 0.0
        self._windows = [window for burst in record.bursts if (window := self._window(force, burst)) is not None]
        if len(self._windows) < _BURSTS_LEAST:
            raise HapticdError(
                f"the handle moved in {len(self._windows)} bursts only, {_BURSTS_LEAST} are needed: use more force "
                "(--force-n)"
            )

    def _window(self, force: Floats, burst: Burst) -> _Window | None:
        """None where the handle stood."""
        record, begin, end = self._record, burst.begin, burst.end
        lead = round(LEAD_S * record.rate_hz)
        first = max(0, begin - lead)
        seen = record.position_m[first:end] - self._middle
        at = np.flatnonzero(~np.isnan(seen))
        # A delay looks back; and what stands says the same over and over again.
        at = at[(at >= min(lead, begin - first)) & (at < len(seen) - 2)]
        moves = np.flatnonzero(np.diff(seen[at]))
        if len(moves) < 4:
            return None
        last = at[moves[-1] + 1] + round(SETTLED_S * record.rate_hz)
        at = at[at <= last]
        at = at[:: 1 + len(at) // MOST_SAMPLES]
        return _Window(burst.frequency_hz, force[first : min(end, first + int(last) + 3)], at, seen[at])

    # ---- The model against what was seen --------------------------------------------------------------------------

    def _model(self, values: Floats, start: Floats, window: _Window) -> tuple[Floats, Floats]:
        """Position and velocity where they were seen, the delay before."""
        moved = self._device.motion(values, start, window.force_n)
        place = np.clip(window.at - values[4] / self._period_s, 0.0, len(moved) - 1.001)
        index = place.astype(np.int64)
        part = place - index
        x0, x1 = moved[index, 0], moved[index + 1, 0]
        v0, v1 = self._period_s * moved[index, 1], self._period_s * moved[index + 1, 1]
        # Hermite's cubic.
        a, b = v0 - (x1 - x0), (x1 - x0) - v1
        position = x0 + part * (x1 - x0) + part * (1 - part) * ((1 - part) * a + part * b)
        return position, moved[index, 1] + part * (moved[index + 1, 1] - moved[index, 1])

    def _sum(self, values: Floats, starts: list[Floats]) -> float:
        return sum(
            float(np.sum((window.seen_m - self._model(values, start, window)[0]) ** 2))
            for window, start in zip(self._windows, starts, strict=True)
        )

    def _linear(
        self, values: Floats, starts: list[Floats], scale: Floats
    ) -> list[tuple[Floats, Floats, Floats, Floats]]:
        """Of each window: residual, derivatives by what is common (scaled) and by what is its own, and its scale."""
        found = []
        for window, start in zip(self._windows, starts, strict=True):
            model, speed = self._model(values, start, window)
            common = np.empty((len(model), _GLOBALS))
            for which in range(_GLOBALS - 1):
                step = 1e-4 * scale[which]
                moved = values.copy()
                moved[which] += step
                common[:, which] = (self._model(moved, start, window)[0] - model) / step * scale[which]
            common[:, 4] = -speed * scale[4]
            own, own_scale = self._own(values, start, window, model)
            found.append((window.seen_m - model, common, own, own_scale))
        return found

    def _own(self, values: Floats, start: Floats, window: _Window, model: Floats) -> tuple[Floats, Floats]:
        """Differences by what is a burst's own, and the scale of each, by which they are taken."""
        scale = np.array([2e-5, 1e-2, 1e-2 * float(np.abs(window.force_n).max())])
        own = np.empty((len(model), 3))
        for which in range(3):
            nudged = start.copy()
            # Away from a rest, by as much as may be: what friction holds still has no derivative.
            side = 1.0 if start[which] >= 0 else -1.0
            nudged[which] += side * scale[which]
            own[:, which] = (self._model(values, nudged, window)[0] - model) * side
        return own, scale

    # ---- The fit --------------------------------------------------------------------------------------------------

    def run(self) -> Fit:
        values, starts = self._guess()
        values, starts, least = self._descend(values, starts)
        # A burst that begins while friction stops the handle may have found another way to rest.
        starts = self._begun_anew(values, starts)
        values, starts, least = self._descend(values, starts)
        return self._result(values, starts, least)

    def _descend(self, values: Floats, starts: list[Floats]) -> tuple[Floats, list[Floats], float]:
        """To the least sum of squares near here."""
        least = self._sum(values, starts)
        damping = 1e-3
        for _ in range(ITERATIONS):
            scale = self._scale(values)
            linear = self._linear(values, starts, scale)
            while True:
                tried, tried_starts = self._step(values, starts, linear, scale, damping)
                reached = self._sum(tried, tried_starts)
                if reached < least or damping > 1e6:
                    break
                damping *= 5
            gained = least - reached
            if gained <= 0:
                break
            values, starts, least = tried, tried_starts, reached
            damping = max(1e-9, damping / 10)
            if gained < ENOUGH * least:
                break
        return values, starts, least

    def _begun_anew(self, values: Floats, starts: list[Floats]) -> list[Floats]:
        """Where a burst is explained worse than most are, other speeds at its begin are tried."""
        left = [self._left(values, start, window) for window, start in zip(self._windows, starts, strict=True)]
        usual = float(np.median(left))
        found = []
        for window, start, now in zip(self._windows, starts, left, strict=True):
            best, least = start, now
            if now > SUSPECT * usual:
                speed = _speed(window, self._period_s)
                for part in (0.0, 0.5, 1.0, 1.5, 2.0):
                    tried, reached = self._settled(values, np.array([window.seen_m[0], part * speed, 0.0]), window)
                    if reached < least:
                        best, least = tried, reached
            found.append(best)
        return found

    def _settled(self, values: Floats, start: Floats, window: _Window) -> tuple[Floats, float]:
        """What is a burst's own, fitted alone, from here."""
        least = self._left(values, start, window)
        damping = 1e-3
        for _ in range(OWN_STEPS):
            model, _ = self._model(values, start, window)
            own, scale = self._own(values, start, window, model)
            tried = start + scale * _own_step(own, window.seen_m - model, damping)
            reached = self._left(values, tried, window)
            if reached < least:
                start, least, damping = tried, reached, damping / 10
            elif damping > 1.0:
                break
            else:
                damping *= 10
        return start, least

    def _left(self, values: Floats, start: Floats, window: _Window) -> float:
        """Mean of the squares of what is left over."""
        return float(np.mean((window.seen_m - self._model(values, start, window)[0]) ** 2))

    def _scale(self, values: Floats) -> Floats:
        """What a change is measured by, of m, b, c, k, d."""
        force = float(np.abs(self._record.force_n).max())
        mass = values[0]
        return np.array([mass, max(values[1], mass), max(values[2], 0.02 * force), max(values[3], 10 * mass), 1e-3])

    def _step(
        self,
        values: Floats,
        starts: list[Floats],
        linear: list[tuple[Floats, Floats, Floats, Floats]],
        scale: Floats,
        damping: float,
    ) -> tuple[Floats, list[Floats]]:
        free = self._fitted.copy()
        matrix, side = np.zeros((_GLOBALS, _GLOBALS)), np.zeros(_GLOBALS)
        for residual, common, own, _ in linear:
            matrix_of, side_of = _reduced(residual, common, own)
            matrix += matrix_of
            side += side_of
        while True:
            # Towards a bound that is reached already nothing goes.
            kept = np.flatnonzero(free)
            reduced = matrix[np.ix_(kept, kept)]
            step = np.zeros(_GLOBALS)
            step[kept] = np.linalg.lstsq(reduced + damping * np.diag(np.diag(reduced)), side[kept], rcond=1e-12)[0]
            outward = free & (values <= 0) & (step < 0) & (np.arange(_GLOBALS) != 4)
            if not outward.any():
                break
            free &= ~outward
        tried = values + step * scale
        tried[:4] = np.maximum(tried[:4], 0.0)
        tried[0] = min(max(tried[0], 0.5 * values[0]), 2.0 * values[0])
        tried[4] = min(max(tried[4], -2 * self._period_s), LEAD_S - 2 * self._period_s)
        moved = []
        for start, (residual, common, own, own_scale) in zip(starts, linear, strict=True):
            left = residual - common @ step
            moved.append(start + own_scale * _own_step(own, left, damping))
        return tried, moved

    def _guess(self) -> tuple[Floats, list[Floats]]:
        """From the spectra of the bursts at their frequencies, friction aside: (-w^2 m + i w b + k) X = F."""
        rows, sides = [], []
        for window in self._windows:
            omega = 2 * math.pi * window.frequency_hz
            turn = tapered(window.at * self._period_s, window.frequency_hz)
            x, f = np.sum(turn * (window.seen_m - window.seen_m.mean())), np.sum(turn * window.force_n[window.at])
            weight = 1.0 / abs(f)
            row = weight * np.array([-(omega**2) * x, 1j * omega * x, x])
            row = row if self._record.held else row[:2]
            rows += [row.real, row.imag]
            sides += [(weight * f).real, (weight * f).imag]
        found = np.linalg.lstsq(np.array(rows), np.array(sides), rcond=None)[0]
        force = float(np.abs(self._record.force_n).max())
        mass = max(1e-3, float(found[0]))
        stiffness = max(0.0, float(found[2])) if self._record.held else 0.0
        friction, delay = (0.02 * force, 0.0) if self._known is None else (self._known.friction_n, self._known.delay_s)
        values = np.array([mass, max(mass, float(found[1])), friction, stiffness, delay])
        return values, [np.array([each.seen_m[0], _speed(each, self._period_s), 0.0]) for each in self._windows]

    def _points(self, values: Floats, starts: list[Floats]) -> tuple[Point, ...]:
        """Up to where the motion falls below a step."""
        seen: dict[float, complex] = {}
        said: dict[float, float] = {}
        mass, damping, _, stiffness, _ = values
        for window, start in zip(self._windows, starts, strict=True):
            s = 2j * math.pi * window.frequency_hz
            moved_m = np.abs(window.force_n).max() / abs(mass * s**2 + damping * s + stiffness)
            if moved_m < self._record.step_m:
                continue
            turn = tapered(window.at * self._period_s, window.frequency_hz)
            turn -= np.abs(turn) * turn.sum() / np.abs(turn).sum()  # blind to a constant
            model, _ = self._model(values, start, window)
            line, frequency = complex(np.sum(turn * model)), window.frequency_hz
            seen[frequency] = seen.get(frequency, 0j) + complex(np.sum(turn * window.seen_m)) * line.conjugate()
            said[frequency] = said.get(frequency, 0.0) + abs(line) ** 2
        return tuple(Point(frequency, seen[frequency] / said[frequency]) for frequency in sorted(seen))

    def _result(self, values: Floats, starts: list[Floats], least: float) -> Fit:
        scale = self._scale(values)
        parts = [_reduced(residual, common, own) for residual, common, own, _ in self._linear(values, starts, scale)]
        kept = np.flatnonzero(self._fitted)
        full = np.sum([matrix for matrix, _ in parts], axis=0)
        whole = full[np.ix_(kept, kept)]
        side = np.sum([side for _, side in parts], axis=0)[kept]
        centre = np.linalg.lstsq(whole, side, rcond=1e-12)[0]
        spread = np.zeros((len(kept), len(kept)))
        for matrix, side_of in parts:
            without = np.linalg.lstsq(whole - matrix[np.ix_(kept, kept)], side - side_of[kept], rcond=1e-12)[0]
            spread += np.outer(without - centre, without - centre)
        count = len(parts)
        spread *= (count - 1) / count
        error = np.zeros(_GLOBALS)
        if self._known is not None:
            # What is taken as known is known within its own error.
            taken = np.array([2, 4])
            error[taken] = np.array(self._known.error)[taken]
            moves = np.linalg.lstsq(whole, full[np.ix_(kept, taken)], rcond=1e-12)[0] * (error[taken] / scale[taken])
            spread += moves @ moves.T
        error[kept] = np.sqrt(np.diag(spread)) * scale[kept]
        seen = sum(len(window.seen_m) for window in self._windows)
        motion = sum(float(np.sum((window.seen_m - window.seen_m.mean()) ** 2)) for window in self._windows)
        mass, damping, friction, stiffness, delay = map(float, values)
        return Fit(
            mass_kg=mass,
            damping_n_s_per_m=damping,
            friction_n=friction,
            stiffness_n_per_m=stiffness,
            delay_s=delay,
            error=(float(error[0]), float(error[1]), float(error[2]), float(error[3]), float(error[4])),
            freedom=count - 1,
            residual_m=math.sqrt(least / seen),
            motion_m=math.sqrt(motion / seen),
            points=self._points(values, starts),
        )


def _reduced(residual: Floats, common: Floats, own: Floats) -> tuple[Floats, Floats]:
    """Normal equations of what is common, once the window's own has been fitted."""
    felt, norms = _felt(own)
    left, _, _ = np.linalg.svd(own[:, felt] / norms[felt], full_matrices=False)
    reduced = common - left @ (left.T @ common)
    return reduced.T @ reduced, reduced.T @ (residual - left @ (left.T @ residual))


def _speed(window: _Window, period_s: float) -> float:
    """At its begin, of a straight line through what was seen in its first moments."""
    time_s = window.at * period_s
    first = time_s <= time_s[0] + FIRST_S
    if np.count_nonzero(first) < 2:
        return 0.0
    return float(np.polyfit(time_s[first] - time_s[0], window.seen_m[first], 1)[0])


def _felt(own: Floats) -> tuple[np.ndarray[tuple[int], np.dtype[np.bool_]], Floats]:
    """Which of a window's own derivatives say anything, and their norms."""
    norms = np.sqrt(np.sum(own**2, axis=0))
    return np.abs(own).max(axis=0) > UNFELT_M, norms


def _own_step(own: Floats, left: Floats, damping: float) -> Floats:
    felt, norms = _felt(own)
    scaled = own[:, felt] / norms[felt]
    step = np.zeros(own.shape[1])
    square = scaled.T @ scaled
    step[felt] = np.linalg.solve(square + (damping + 1e-9) * np.eye(len(square)), scaled.T @ left) / norms[felt]
    return np.clip(step, -LONGEST_STEP, LONGEST_STEP)
