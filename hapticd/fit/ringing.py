"""Fit of decaying sinusoids to a section of acceleration, by variable projection.

    a(t) = c_0 + c_1 t + sum_k A_k exp(-B_k (t - t_0)) sin(w_k (t - t_0)) [t >= t_0]

All modes begin at the onset t_0, which is fitted. The straight line is gravity and drift. If the sensor is known, its
response to the modes (sensor.py) is fitted instead of the modes. For given B, w and t_0 the best A and line are linear
least squares, so the search is over B, w and t_0 alone (Golub and Pereyra, 1973, with Kaufman's Jacobian, 1975). The
search begins at the best point of a grid and takes Levenberg-Marquardt steps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from hapticd.analysis.recordings.sensor import Complexes, Sensor
from hapticd.analysis.statistics import FitError, Floats
from hapticd.fit.limits import RINGING_LIMITS

OTHER_SHAPES: Final = ((2.0, 1.0), (0.5, 1.0), (1.0, 2.0), (2.0, 0.0), (0.5, 0.0))
"""Decaying sinusoids that are searched for in the residuals, as factors of the fitted B and w: other decays, twice the
frequency, and decays without oscillation."""


@dataclass(frozen=True, slots=True)
class Ringing:
    """Modes fitted to a section of acceleration, sorted by falling energy."""

    coefficients: Floats
    """(modes,) A, m/s^2."""
    decay_rate_per_s: Floats
    """(modes,) B."""
    angular_frequency_rad_per_s: Floats
    """(modes,) w."""
    onset_s: float
    """Time of the onset after the first sample."""
    covariance: Floats
    """(3 modes + 1, 3 modes + 1) covariance of all A, all B, all w and the onset, assuming white noise."""
    residual: Floats
    """(n,) measured minus modelled acceleration, m/s^2."""
    variance_accounted_for: float
    """1 - (residual squares)/(squares about the line), from the onset to five decay times after it."""
    noise_m_per_s2: float
    """RMS of the residual."""
    lack_of_fit: tuple[Floats, Floats]
    """For one mode: scalar products of residual and OTHER_SHAPES (k,), and of OTHER_SHAPES with each other (k, k).

    The shapes have the amplitude of the mode and are orthogonal to the fitted parameters. Empty for more modes.
    """

    def of_modes(self, which: Sequence[int]) -> Ringing:
        """Return the modes of these indices, in this order; residual and onset remain those of the fit of all modes."""
        modes = len(self.coefficients)
        places = [*which, *(modes + mode for mode in which), *(2 * modes + mode for mode in which), 3 * modes]
        return dataclasses.replace(
            self,
            coefficients=self.coefficients[list(which)],
            decay_rate_per_s=self.decay_rate_per_s[list(which)],
            angular_frequency_rad_per_s=self.angular_frequency_rad_per_s[list(which)],
            covariance=self.covariance[np.ix_(places, places)],
        )

    def negated(self) -> Ringing:
        """Return the same fit with the sign of the acceleration reversed."""
        modes = len(self.coefficients)
        signs = np.where(np.arange(3 * modes + 1) < modes, -1.0, 1.0)
        covariance = self.covariance * np.outer(signs, signs)
        return dataclasses.replace(
            self, coefficients=-self.coefficients, residual=-self.residual, covariance=covariance
        )


def fit_ringing(
    acceleration: Floats,
    rate_hz: float,
    modes: int = 1,
    onset_s: float | None = None,
    start: Ringing | None = None,
    sensor: Sensor | None = None,
) -> Ringing:
    """Fit `modes` decaying sinusoids to acceleration (n,) in m/s^2, sampled at `rate_hz`.

    The onset is searched near `onset_s`, by default at the first large sample. If a fit `start` is given, the search
    starts at its modes and onset. The modes of the result do not include the response of the `sensor`. Raises FitError
    if the acceleration is constant or has too few samples.
    """
    needed = max(RINGING_LIMITS.min_samples, 2 * (3 * modes + 3))
    if len(acceleration) < needed:
        raise FitError(f"{len(acceleration)} samples are too few for {modes} modes: needs {needed}")
    search = _Search(acceleration, rate_hz, sensor if sensor is not None and sensor.poles else None)
    if start is None:
        point = search.begin(onset_s)
        for _ in range(1, modes):
            point = search.joined(search.descend(point))
    else:
        point = np.concatenate(
            (np.log(start.decay_rate_per_s), np.log(start.angular_frequency_rad_per_s), [start.onset_s])
        )
    return search.result(search.at_the_onset(search.descend(point)))


class _Search:
    """Least-squares search of modes. A point is the vector (log decay rates B, log angular frequencies w, onset)."""

    def __init__(self, acceleration: Floats, rate_hz: float, sensor: Sensor | None) -> None:
        self._measured = acceleration
        self._rate_hz = rate_hz
        self._sensor = sensor
        self._time_s = np.arange(len(acceleration)) / rate_hz
        self._line = np.column_stack((np.ones(len(acceleration)), np.linspace(-1.0, 1.0, len(acceleration))))
        self._slowest = 0.2 / self._time_s[-1]
        """Lowest decay rate and angular frequency, 1/s: anything slower is part of the line."""
        self._fastest = math.pi * rate_hz

    # ---- Start ----------------------------------------------------------------------------------------------------

    def begin(self, onset_s: float | None) -> Floats:
        """Return the best point (decay rate, frequency and onset) of a grid for one mode."""
        above = self._measured - np.median(self._measured)
        size = np.abs(above)
        if not size.max() > 0:
            raise FitError("no ringing: the acceleration is constant")
        if onset_s is None:
            onset_s = float(self._time_s[np.argmax(size > 0.15 * size.max())])
        return self._best(above, onset_s, np.empty(0))

    def joined(self, point: Floats) -> Floats:
        """Return the point (modes and onset) with one more mode, the one that fits the residual best."""
        left = self._solved(point)[1]
        return self._best(left, float(point[-1]), point)

    def _best(self, signal: Floats, onset_s: float, earlier: Floats) -> Floats:
        """Return the point `earlier` with one more mode, the best mode of a grid for this signal (n,)."""
        first = min(int(np.searchsorted(self._time_s, onset_s)), len(signal) - RINGING_LIMITS.min_samples // 2)
        time_s, padding = self._time_s[first:], 8
        for degree in (0, 1):
            rings = signal[first:] - np.polyval(np.polyfit(time_s, signal[first:], degree), time_s)
            highest = 1 + int(np.argmax(np.abs(np.fft.rfft(rings, padding * len(rings)))[1:]))
            if highest >= 2 * padding:
                # Otherwise a drift may hide a slow ringing.
                break
        peak_hz = highest * self._rate_hz / (padding * len(rings))
        known = len(earlier) // 2
        grid = []
        # Factors of the highest line of the spectrum, periods of the onset before the first large sample, and B over w.
        # If other modes are fitted already, the onset is known.
        earliest = (0.01, 0.05, 0.12) if known == 0 else (0.0,)
        for factor, periods, damping in product((0.85, 1.05, 1.35), earliest, (0.03, 0.12, 0.5)):
            angular = min(2 * math.pi * peak_hz * factor, 0.95 * self._fastest)
            last = [math.log(angular), onset_s - periods * 2 * math.pi / angular]
            grid.append(np.concatenate((earlier[:known], [math.log(damping * angular)], earlier[known:-1], last)))
        return min(grid, key=self._squares)

    # ---- The model ------------------------------------------------------------------------------------------------

    def _responses(self, point: Floats) -> tuple[int, list[tuple[Complexes, Complexes, Complexes]]]:
        """Return the first sample after the onset, and for every mode three arrays from this sample on (sensor.py).

        The arrays are the response y, whose imaginary part is the acceleration, and its derivatives with respect to the
        pole -B + i w and to time.
        """
        modes = len(point) // 2
        since = self._time_s - point[-1]
        first = int(np.searchsorted(since, 0.0))
        ringing = since[first:]
        found = []
        for pole in -np.exp(point[:modes]) + 1j * np.exp(point[modes:-1]):
            if self._sensor is None:
                turned = np.exp(pole * ringing)
                found.append((turned, ringing * turned, pole * turned))
            else:
                found.append(self._sensor.response(complex(pole), ringing))
        return first, found

    def _solved(self, point: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the linear fit at a point.

        Returns coefficients (modes + 2,), residual (n,), columns (n, modes + 2) and the columns' orthonormal basis.
        """
        first, responses = self._responses(point)
        modes = len(responses)
        columns = np.empty((len(self._measured), modes + 2))
        columns[:first, :modes] = 0.0
        for mode, (response, _, _) in enumerate(responses):
            columns[first:, mode] = response.imag
        columns[:, modes:] = self._line
        norms = np.sqrt(np.sum(columns**2, axis=0))
        if not (norms > 0).all():
            # The onset is after the last sample.
            return np.zeros(columns.shape[1]), self._measured.copy(), columns, np.zeros_like(columns)
        base, triangle = np.linalg.qr(columns / norms)
        on_base = base.T @ self._measured
        try:
            coefficients = np.linalg.solve(triangle, on_base) / norms
        except np.linalg.LinAlgError:
            # Two modes are equal.
            coefficients = np.linalg.lstsq(triangle, on_base, rcond=1e-12)[0] / norms
        return coefficients, self._measured - base @ on_base, columns, base

    def _squares(self, point: Floats) -> float:
        return float(np.sum(self._solved(point)[1] ** 2))

    def _slopes(self, point: Floats, coefficients: Floats) -> Floats:
        """Return the derivatives (n, 2 modes + 1) of the model with respect to the coordinates of the point."""
        modes = len(point) // 2
        first, responses = self._responses(point)
        slopes = np.zeros((len(self._measured), 2 * modes + 1))
        for mode, (_, by_pole, by_time) in enumerate(responses):
            slopes[first:, mode] = -coefficients[mode] * np.exp(point[mode]) * by_pole.imag
            slopes[first:, modes + mode] = coefficients[mode] * np.exp(point[modes + mode]) * by_pole.real
            slopes[first:, -1] -= coefficients[mode] * by_time.imag
        return slopes

    # ---- The search -----------------------------------------------------------------------------------------------

    def descend(self, point: Floats) -> Floats:
        """Return the point with the least squared residual near `point`, by Levenberg-Marquardt steps."""
        coefficients, left, _, base = self._solved(point)
        lowest = float(left @ left)
        damping = 1e-3
        for _ in range(60):
            slopes = self._slopes(point, coefficients)
            slopes -= base @ (base.T @ slopes)
            norms = np.sqrt(np.sum(slopes**2, axis=0))
            norms[norms == 0] = 1.0
            slopes /= norms
            square, side = slopes.T @ slopes, slopes.T @ left
            gained = 0.0
            while damping < 1e8:
                step = np.linalg.solve(square + damping * np.eye(len(square)), side) / norms
                tried = self._bounded(point, step)
                solved = self._solved(tried)
                squares = float(solved[1] @ solved[1])
                if squares < lowest:
                    gained = lowest - squares
                    point, lowest = tried, squares
                    coefficients, left, _, base = solved
                    damping = max(1e-12, damping / 10)
                    break
                damping *= 6
            if gained <= 1e-9 * lowest:
                break
        return point

    def at_the_onset(self, point: Floats) -> Floats:
        """Return the point, or a better point whose onset differs by half a period or a period.

        At half a period the ringing begins with the opposite sign, at a period with the same sign.
        """
        lowest = self._squares(point)
        half_s = math.pi / math.exp(float(point[len(point) // 2]))
        for turned in (-2, -1, 1, 2):
            tried = point.copy()
            tried[-1] += turned * half_s
            if not 0 <= tried[-1] < self._time_s[-2] or self._squares(tried) >= lowest:
                continue
            tried = self.descend(tried)
            squares = self._squares(tried)
            if squares < lowest:
                point, lowest = tried, squares
        return point

    def _bounded(self, point: Floats, step: Floats) -> Floats:
        modes = len(point) // 2
        period_s = 2 * math.pi / math.exp(float(point[modes:-1].max()))
        tried = point + np.clip(step, -0.5, 0.5)
        tried[-1] = point[-1] + min(max(step[-1], -0.25 * period_s), 0.25 * period_s)
        tried[:-1] = np.clip(tried[:-1], math.log(self._slowest), math.log(self._fastest))
        tried[-1] = min(max(tried[-1], -period_s), float(self._time_s[-2]))
        return tried

    def result(self, point: Floats) -> Ringing:
        """Return the fit whose modes and onset are those of `point`, with covariance and residual."""
        modes = len(point) // 2
        coefficients, left, columns, _ = self._solved(point)
        decay, angular = np.exp(point[:modes]), np.exp(point[modes:-1])
        slopes = self._slopes(point, coefficients)
        slopes[:, : 2 * modes] /= np.concatenate((decay, angular))
        jacobian = np.column_stack((columns[:, :modes], slopes, columns[:, modes:]))
        norms = np.sqrt(np.sum(jacobian**2, axis=0))
        norms[norms == 0] = 1.0
        noise = math.sqrt(float(left @ left) / (len(left) - jacobian.shape[1]))
        spread = np.linalg.pinv((jacobian / norms).T @ (jacobian / norms), rcond=1e-14) * noise**2
        spread /= np.outer(norms, norms)
        by_energy = np.argsort(-np.abs(coefficients[:modes]) / np.sqrt(decay))
        order = np.concatenate((by_energy, modes + by_energy, 2 * modes + by_energy, [3 * modes]))
        rings = (self._time_s >= point[-1]) & (
            self._time_s <= point[-1] + RINGING_LIMITS.judged_decay_times / decay.min()
        )
        above = self._measured[rings] - columns[rings][:, modes:] @ coefficients[modes:]
        energy = float(above @ above)
        return Ringing(
            coefficients=coefficients[by_energy],
            decay_rate_per_s=decay[by_energy],
            angular_frequency_rad_per_s=angular[by_energy],
            onset_s=float(point[-1]),
            covariance=spread[np.ix_(order, order)],
            residual=left,
            variance_accounted_for=1.0 - float(left[rings] @ left[rings]) / energy if energy > 0 else 0.0,
            noise_m_per_s2=noise,
            lack_of_fit=self._lack_of_fit(point, float(coefficients[0]), jacobian / norms, left)
            if modes == 1
            else (np.empty(0), np.empty((0, 0))),
        )

    def _lack_of_fit(self, point: Floats, coefficient: float, jacobian: Floats, left: Floats) -> tuple[Floats, Floats]:
        since = np.maximum(self._time_s - point[-1], 0.0)
        begun = self._time_s >= point[-1]
        decay, angular = math.exp(point[0]), math.exp(point[1])
        shapes = []
        for slower, faster in OTHER_SHAPES:
            wave = coefficient * begun * np.exp((-slower * decay + 1j * faster * angular) * since)
            shapes += [wave.real, wave.imag] if faster else [wave.real]
        columns = np.column_stack(shapes)
        base = np.linalg.qr(jacobian)[0]
        columns -= base @ (base.T @ columns)
        return columns.T @ left, columns.T @ columns
