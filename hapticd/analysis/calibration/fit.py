"""Fit of mass, damping, dry friction and stiffness, with confidence intervals, to the positions of a drive.

The model is the simulated joystick (csrc/device/hd_sim_solver.c), driven by the recorded force, without the steps of
encoder and actuator:

    m x'' + b x' + c sign(x') + k x = F(t) + g,    observed with the delay d.

The model is exact between the periods and includes the times at which dry friction holds the handle. A force that is
held for longer than a period of the servo, as by a link, is modelled in two ways: as a staircase that changes with each
report, and as its running mean over the hold. Both are equivalent below the rate of the reports; the better fit is
kept. m, b, c, k and d hold for the entire drive. c and d belong to the device: for a held handle they are those of the
free handle's drive, because in a hand damping times delay acts like a mass. Each burst has its own initial position,
initial speed and constant force g (drift of the hand, weight).

The fit is least squares over the positions by variable projection (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973):
an outer fit of m, b, c, k and d, and an inner fit of each burst's start. Its residuals are the encoder's rounding and
errors of the model. Neither is white, so intervals come from the jackknife that leaves out one burst at a time
(variance CV3 of MacKinnon, Nielsen and Webb, "Fast and reliable jackknife and bootstrap methods for cluster-robust
inference", 2023), and from Student's t with one degree of freedom less than there are bursts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.calibration.sweep import BURST_LEAD_TIME_S, Burst, Record
from hapticd.analysis.statistics import Estimate, Floats
from hapticd.base.core import ffi, invalid_reason, lib, pointer
from hapticd.base.errors import HapticdError

SETTLING_TIME_S: Final = 0.005
"""A burst is fitted until this time after the last change of the encoder's position."""
MAX_BURST_SAMPLES: Final = 2000
"""Largest number of samples of a burst that are fitted. More would cost time without better accuracy."""
MIN_MOVING_BURSTS: Final = 6
"""Smallest number of bursts that move the handle. The intervals have one degree of freedom less than this number."""
MIN_START_EFFECT_M: Final = 1e-7
"""A parameter of a burst's start that moves the handle by less than this cannot be determined and is ignored."""
MASS, DAMPING, FRICTION, STIFFNESS, DELAY = range(5)
"""Indices of `Fit.values`."""


@dataclass(frozen=True, slots=True)
class Point:
    """The ratio of the measured to the modelled spectrum of the handle's motion at one frequency.

    The ratio times the linear response of the fit is the measured response, without the effects of friction and of the
    bursts' starts.
    """

    frequency_hz: float
    ratio: complex


def points_of(lines: Iterable[tuple[float, complex, complex]]) -> tuple[Point, ...]:
    """Return a Point for each frequency. `lines` are frequency (Hz), measured and modelled spectrum of each burst."""
    sums: dict[float, tuple[complex, float]] = {}
    for frequency_hz, measured, modelled in lines:
        product, power = sums.get(frequency_hz, (0j, 0.0))
        sums[frequency_hz] = product + measured * modelled.conjugate(), power + abs(modelled) ** 2
    return tuple(Point(frequency_hz, product / power) for frequency_hz, (product, power) in sorted(sums.items()))


@dataclass(frozen=True, slots=True)
class Fit:
    """The handle's parameters fitted to one drive.

    `error` are the standard errors of `values`, `freedom` the degrees of freedom of these errors.
    """

    mass_kg: float
    damping_n_s_per_m: float
    friction_n: float
    stiffness_n_per_m: float
    delay_s: float
    error: tuple[float, ...]
    freedom: int
    residual_m: float
    """RMS of the residual of the positions."""
    motion_m: float
    """RMS of the positions."""
    points: tuple[Point, ...]
    """Points measured by the encoder, one for each frequency at which the handle moved."""

    @property
    def values(self) -> tuple[float, float, float, float, float]:
        """Mass, damping, friction, stiffness and delay, in SI units."""
        return (self.mass_kg, self.damping_n_s_per_m, self.friction_n, self.stiffness_n_per_m, self.delay_s)

    def response(self, frequency_hz: Floats) -> npt.NDArray[np.complex128]:
        """Return the frequency response position/force of the linear part, in m/N."""
        s = 2j * math.pi * frequency_hz
        return np.asarray(1.0 / (self.mass_kg * s**2 + self.damping_n_s_per_m * s + self.stiffness_n_per_m))

    def estimate(self, which: int, lower_bound: float = 0.0) -> Estimate:
        """Return element `which` of `values`, with an interval whose lower end is at least `lower_bound`."""
        found = Estimate.from_error(self.values[which], self.error[which], self.freedom)
        return Estimate(found.value, max(lower_bound, found.low), found.high)


def difference(held: Fit, free: Fit, which: int) -> Estimate:
    """Return element `which` of `values` for the held handle, minus that for the free handle.

    The interval is that of two independent fits (Welch and Satterthwaite); its lower end is at least 0.
    """
    variances = (held.error[which] ** 2, free.error[which] ** 2)
    total = sum(variances)
    parts = variances[0] ** 2 / held.freedom + variances[1] ** 2 / free.freedom
    freedom = total**2 / parts if parts > 0 else min(held.freedom, free.freedom)
    found = Estimate.from_error(held.values[which] - free.values[which], math.sqrt(total), freedom)
    return Estimate(found.value, max(0.0, found.low), found.high)


def fit(record: Record, free: Fit | None = None) -> Fit:
    """Fit the parameters of the handle to a drive. For a held handle, `free` is the fit of the free handle's drive.

    Raises HapticdError if the handle moved in too few bursts.
    """
    forces = held_forces(record)
    return min((_Fitting(record, force, free).run() for force in forces), key=lambda found: found.residual_m)


def held_forces(record: Record) -> list[Floats]:
    """Return the models of the held force to be fitted, (n,) in N, without delay.

    A force held for one period is the command itself. A longer hold is modelled as a running mean and, if positions
    are reported once per hold, also as a staircase.
    """
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
    """Return the modelled position (m) and velocity (m/s) at each period, (n, 2), of a handle that begins at rest."""
    return _motion(np.array(found.values), np.zeros(3), held_forces(record)[-1], record.rate_hz)


def _motion(values: Floats, start: Floats, force_n: Floats, rate_hz: float) -> Floats:
    """Return the modelled position and velocity at each period of `force_n`, (n, 2).

    `values` begin with m, b, c and k of the model; `start` holds initial position, velocity and constant force.
    """
    config = ffi.new("struct hd_sim_config *")
    config.handle_mass_kg, config.handle_damping_n_s_per_m, config.coulomb_friction_n = values[:3]
    config.hand_stiffness_n_per_m = values[STIFFNESS]
    # Limits so wide that neither the force nor the travel is limited.
    config.max_force_n, config.workspace_m, config.force_timeout_s = 1e6, 100.0, 1e6
    made = lib.hd_sim_new(config, 1.0 / rate_hz)
    if made == ffi.NULL:
        raise HapticdError(f"the fit failed: {invalid_reason()}")
    sim = ffi.gc(made, lib.hd_sim_free)
    if lib.hd_sim_place(sim, ffi.new("double[2]", [start[0], 0.0]), ffi.new("double[2]", [start[1], 0.0])):
        raise HapticdError(f"the fit failed: {invalid_reason()}")
    force = np.zeros((len(force_n), 2))
    force[:, 0] = force_n + start[2]
    moved = np.empty((len(force_n), 4))
    lib.hd_sim_drive(sim, pointer("double[]", force), len(force), pointer("double[]", moved))
    return moved[:, ::2]


def tapered(time_s: npt.NDArray[np.floating], frequency_hz: float) -> npt.NDArray[np.complex128]:
    """Return the complex exponential exp(-i w t) of a frequency, times a Hann window over the times (n,)."""
    taper = np.sin(math.pi * (time_s - time_s[0]) / (time_s[-1] - time_s[0])) ** 2
    return np.asarray(taper * np.exp(-2j * math.pi * frequency_hz * time_s))


@dataclass(slots=True)
class _Window:
    """One burst to be fitted: its force at each period, the positions `seen_m` at the periods `at`, and its start."""

    frequency_hz: float
    force_n: Floats
    at: npt.NDArray[np.int64]
    seen_m: Floats
    start: Floats
    """Initial position (m), initial velocity (m/s) and constant force (N)."""

    @property
    def start_scale(self) -> Floats:
        """Steps for numerical derivatives with respect to the elements of `start`."""
        return np.array([2e-5, 1e-2, 1e-2 * float(np.abs(self.force_n).max())])


class _Fitting:
    """The fit of one drive for one model of the held force."""

    def __init__(self, record: Record, force: Floats, known: Fit | None) -> None:
        self._record = record
        self._known = known
        # A free handle has no stiffness.
        self._fitted = np.array([True, True, known is None, record.held, known is None])
        self._period_s = 1.0 / record.rate_hz
        seen = record.position_m[~np.isnan(record.position_m)]
        self._middle = float(np.median(seen)) if record.held else 0.0
        self._windows = [window for burst in record.bursts if (window := self._window(force, burst)) is not None]
        if len(self._windows) < MIN_MOVING_BURSTS:
            raise HapticdError(
                f"the handle moved in {len(self._windows)} bursts, at least {MIN_MOVING_BURSTS} are needed: use more "
                "force (--force-n)"
            )
        self._values = self._guess()

    def _window(self, force: Floats, burst: Burst) -> _Window | None:
        """Return the samples of a burst to be fitted; None if the handle did not move."""
        record, begin, end = self._record, burst.begin, burst.end
        lead = round(BURST_LEAD_TIME_S * record.rate_hz)
        first = max(0, begin - lead)
        seen = record.position_m[first:end] - self._middle
        at = np.flatnonzero(~np.isnan(seen))
        # With a delay, a position depends on earlier periods. Samples after the handle has come to rest add nothing.
        at = at[(at >= min(lead, begin - first)) & (at < len(seen) - 2)]
        moves = np.flatnonzero(np.diff(seen[at]))
        if len(moves) < 4:
            return None
        last = at[moves[-1] + 1] + round(SETTLING_TIME_S * record.rate_hz)
        at = at[at <= last]
        at = at[:: 1 + len(at) // MAX_BURST_SAMPLES]
        force = force[first : min(end, first + int(last) + 3)]
        found = _Window(burst.frequency_hz, force, at, seen[at], np.zeros(3))
        found.start[:2] = found.seen_m[0], self._speed(found)
        return found

    def _speed(self, window: _Window) -> float:
        """Return the initial velocity of a burst in m/s: the slope of a straight line fitted to its first 10 ms."""
        time_s = (window.at - window.at[0]) * self._period_s
        first = time_s <= 0.01
        if np.count_nonzero(first) < 2:
            return 0.0
        return float(np.polyfit(time_s[first], window.seen_m[first], 1)[0])

    def _guess(self) -> Floats:
        """Return initial values of m, b, c, k and d, from the spectra of the bursts: (-w^2 m + i w b + k) X = F."""
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
        return np.array([mass, max(mass, float(found[1])), friction, stiffness, delay])

    # ---- Model and residuals --------------------------------------------------------------------------------------

    def _model(self, values: Floats, start: Floats, window: _Window) -> tuple[Floats, Floats]:
        """Return the modelled position and velocity for each fitted sample, with the delay d."""
        moved = _motion(values, start, window.force_n, self._record.rate_hz)
        place = np.clip(window.at - values[DELAY] / self._period_s, 0.0, len(moved) - 1.001)
        index = place.astype(np.int64)
        part = place - index
        x0, x1 = moved[index, 0], moved[index + 1, 0]
        v0, v1 = self._period_s * moved[index, 1], self._period_s * moved[index + 1, 1]
        # Cubic Hermite interpolation.
        a, b = v0 - (x1 - x0), (x1 - x0) - v1
        position = x0 + part * (x1 - x0) + part * (1 - part) * ((1 - part) * a + part * b)
        return position, moved[index, 1] + part * (moved[index + 1, 1] - moved[index, 1])

    def _start_slopes(self, values: Floats, start: Floats, window: _Window) -> Floats:
        """Return the derivatives of a burst's positions with respect to the elements of `start`, (n, 3)."""
        model, _ = self._model(values, start, window)
        scale = window.start_scale
        slopes = np.empty((len(model), 3))
        for which in range(3):
            nudged = start.copy()
            # The step is large and away from rest, because the derivative vanishes while friction holds the handle.
            step = scale[which] if start[which] >= 0 else -scale[which]
            nudged[which] += step
            slopes[:, which] = (self._model(values, nudged, window)[0] - model) / step
        return slopes

    def _fit_start(self, values: Floats, start: Floats, window: _Window) -> tuple[Floats, Floats]:
        """Fit one burst's initial position, speed and constant force; return them and the residual (n,)."""
        from scipy.optimize import least_squares

        found = least_squares(
            lambda own: self._model(values, own, window)[0] - window.seen_m,
            start,
            lambda own: self._start_slopes(values, own, window),
            # Bounds keep a burst with little information near its initial start.
            bounds=(start - 100 * window.start_scale, start + 100 * window.start_scale),
            x_scale=window.start_scale,
            ftol=1e-3,
            max_nfev=12,
        )
        return found.x, found.fun

    def _residual(self, values: Floats) -> Floats:
        """Return the residual of all bursts, each with its best initial position, speed and constant force."""
        lefts = []
        for window in self._windows:
            window.start, left = self._fit_start(values, window.start, window)
            lefts.append(left)
        return np.concatenate(lefts)

    def _slopes(self, values: Floats) -> list[Floats]:
        """Return for each burst the derivatives (n, 5) of its positions by m, b, c, k and d, times their scales.

        Changes of position that other starts of the burst can cause are projected out.
        """
        scale = self._scale(values)
        found = []
        for window in self._windows:
            model, speed = self._model(values, window.start, window)
            slopes = np.empty((len(model), 5))
            for which in range(DELAY):
                moved = values.copy()
                moved[which] += 1e-4 * scale[which]
                slopes[:, which] = (self._model(moved, window.start, window)[0] - model) / 1e-4
            slopes[:, DELAY] = -speed * scale[DELAY]
            own = self._start_slopes(values, window.start, window) * window.start_scale
            own = own[:, np.abs(own).max(axis=0) > MIN_START_EFFECT_M]
            left, _, _ = np.linalg.svd(own / np.linalg.norm(own, axis=0), full_matrices=False)
            found.append(slopes - left @ (left.T @ slopes))
        return found

    def _scale(self, values: Floats) -> Floats:
        """Return a significant change of each of m, b, c, k and d, to scale the fit."""
        force = float(np.abs(self._record.force_n).max())
        mass = values[MASS]
        return np.array([mass, max(values[1], mass), max(values[2], 0.02 * force), max(values[3], 10 * mass), 1e-3])

    # ---- The fit --------------------------------------------------------------------------------------------------

    def run(self) -> Fit:
        """Fit m, b, c, k and d to all bursts; return the fit with its errors."""
        self._descend()
        # The start of a burst that begins while friction stops the handle may be a wrong local minimum.
        self._retry_starts()
        return self._result(self._descend())

    def _descend(self) -> Floats:
        """Move m, b, c, k and d to the next local minimum of the residual's sum of squares; return the residual."""
        from scipy.optimize import least_squares

        fitted = self._fitted
        lowest = np.array([1e-4, 0.0, 0.0, 0.0, -2 * self._period_s])
        highest = np.array([np.inf, np.inf, np.inf, np.inf, BURST_LEAD_TIME_S - 2 * self._period_s])

        def values_of(some: Floats) -> Floats:
            values = self._values.copy()
            values[fitted] = some
            return values

        def slopes(some: Floats) -> Floats:
            values = values_of(some)
            return (np.concatenate(self._slopes(values)) / self._scale(values))[:, fitted]

        found = least_squares(
            lambda some: self._residual(values_of(some)),
            self._values[fitted],
            slopes,
            bounds=(lowest[fitted], highest[fitted]),
            x_scale=self._scale(self._values)[fitted],
            ftol=1e-6,
            gtol=None,
            max_nfev=15,
        )
        values = values_of(found.x)
        # The solver stays strictly inside its bounds: values next to 0 are 0.
        values[:DELAY][values[:DELAY] < 1e-9 * self._scale(values)[:DELAY]] = 0.0
        self._values = values
        return self._residual(values)

    def _retry_starts(self) -> None:
        """Fit bursts with a residual well above the median again, from other initial speeds."""
        found = [self._fit_start(self._values, window.start, window) for window in self._windows]
        usual = float(np.median([np.mean(left**2) for _, left in found]))
        for window, (start, left) in zip(self._windows, found, strict=True):
            starts = [(start, left)]
            if np.mean(left**2) > 1.2 * usual:
                speed = self._speed(window)
                for part in (0.0, 0.5, 1.0, 1.5, 2.0):
                    tried = np.array([window.seen_m[0], part * speed, 0.0])
                    starts.append(self._fit_start(self._values, tried, window))
            window.start, _ = min(starts, key=lambda each: float(np.sum(each[1] ** 2)))

    def _result(self, residual: Floats) -> Fit:
        scale, blocks = self._scale(self._values), self._slopes(self._values)
        lefts = np.split(residual, np.cumsum([len(block) for block in blocks])[:-1])
        kept = np.flatnonzero(self._fitted)
        matrices = [block.T @ block for block in blocks]
        sides = [-(block.T @ left) for block, left in zip(blocks, lefts, strict=True)]
        full, side = np.sum(matrices, axis=0), np.sum(sides, axis=0)
        fitted = full[np.ix_(kept, kept)]
        centre = np.linalg.lstsq(fitted, side[kept], rcond=1e-12)[0]
        spread = np.zeros((len(kept), len(kept)))
        for matrix, side_of in zip(matrices, sides, strict=True):
            without = np.linalg.lstsq(fitted - matrix[np.ix_(kept, kept)], (side - side_of)[kept], rcond=1e-12)[0]
            spread += np.outer(without - centre, without - centre)
        count = len(blocks)
        spread *= (count - 1) / count
        error = np.zeros(5)
        if self._known is not None:
            # The values taken from the free drive contribute their own errors.
            taken = np.array([FRICTION, DELAY])
            error[taken] = np.array(self._known.error)[taken]
            moves = np.linalg.lstsq(fitted, full[np.ix_(kept, taken)], rcond=1e-12)[0] * (error[taken] / scale[taken])
            spread += moves @ moves.T
        error[kept] = np.sqrt(np.diag(spread)) * scale[kept]
        motion = np.concatenate([window.seen_m - window.seen_m.mean() for window in self._windows])
        mass, damping, friction, stiffness, delay = self._values.tolist()
        return Fit(
            mass,
            damping,
            friction,
            stiffness,
            delay,
            error=tuple(error.tolist()),
            freedom=count - 1,
            residual_m=float(np.sqrt(np.mean(residual**2))),
            motion_m=float(np.sqrt(np.mean(motion**2))),
            points=points_of(self._spectral_lines()),
        )

    def _spectral_lines(self) -> Iterable[tuple[float, complex, complex]]:
        """Yield frequency, measured and modelled spectrum of each burst that moves the handle by a step or more."""
        mass, damping, _, stiffness, _ = self._values
        for window in self._windows:
            s = 2j * math.pi * window.frequency_hz
            moved_m = np.abs(window.force_n).max() / abs(mass * s**2 + damping * s + stiffness)
            if moved_m < self._record.step_m:
                continue
            turn = tapered(window.at * self._period_s, window.frequency_hz)
            turn -= np.abs(turn) * turn.sum() / np.abs(turn).sum()  # insensitive to a constant
            model, _ = self._model(self._values, window.start, window)
            yield window.frequency_hz, complex(np.sum(turn * window.seen_m)), complex(np.sum(turn * model))
