"""How the stylus of a recording moves along the surface: its position and speed, and slopes and means of a column."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import FitError, Floats, UnitError
from hapticd.fit.invalid_samples import SPEED
from hapticd.fit.recording import Recording

FASTEST_M_PER_S: Final = SPEED["texture"].most
SLOWEST_M_PER_S: Final = 1e-4
FARTHEST_M: Final = 5.0
SPEED_WINDOW_S: Final = 0.02
"""A position is differentiated over so long."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Along the surface: `speed_m_per_s` has a sign; `position_m` begins anywhere."""

    position_m: Floats
    speed_m_per_s: Floats


def motion_of(recording: Recording, samples: int) -> Motion:
    """From the tangential position, or from the speed. FitError where there is neither, or they disagree."""
    speed = recording.speed_m_per_s
    column: Floats | None = None
    if speed is not None:
        given = np.asarray(speed, dtype=np.float64)
        if given.ndim == 0 or given.size == 1:
            column = np.full(samples, float(given.reshape(-1)[0]))
        elif given.size == samples:
            column = given
        else:
            raise FitError(
                f"{recording.name}: holds {given.size} speeds for {samples} samples: a stroke needs one, or a column"
            )
    position = recording.tangential_position_m
    if position is None and column is None:
        raise FitError(f"{recording.name}: a stroke needs the position along the surface, or the speed")
    if position is None:
        assert column is not None
        _refuse_speed(recording, column)
        return Motion(np.concatenate(([0.0], np.cumsum((column[1:] + column[:-1]) / 2))) / recording.rate_hz, column)
    if np.ptp(position) > FARTHEST_M:
        raise UnitError(f"{recording.name}: a stroke of {np.ptp(position):.4g} m is not a hand's: is it in mm?")
    if not np.ptp(position) > 0:
        raise FitError(f"{recording.name}: the position along the surface never moves: is it the wrong column?")
    found = slope_of(position, recording.rate_hz, SPEED_WINDOW_S)
    _refuse_speed(recording, found)
    if column is not None:
        usual, said = float(np.median(np.abs(found))), float(np.median(np.abs(column)))
        if not 0.5 * usual <= said <= 2 * usual:
            raise UnitError(
                f"{recording.name}: the position moves at {usual:.3g} m/s, the speed says {said:.3g} m/s: "
                "one of them has the wrong unit or column"
            )
    return Motion(position, found)


def _refuse_speed(recording: Recording, speed: Floats) -> None:
    usual = float(np.percentile(np.abs(speed), 90))
    if usual > FASTEST_M_PER_S:
        raise UnitError(f"{recording.name}: a speed of {usual:.4g} m/s is not a hand's: is it in mm/s?")
    fastest = int(np.argmax(np.abs(speed)))
    if not abs(speed[fastest]) <= FASTEST_M_PER_S:
        at_s = fastest / recording.rate_hz
        raise FitError(
            f"{recording.name}: a speed of {abs(speed[fastest]):.4g} m/s at {at_s:.6g} s is not a hand's (at most "
            f"{FASTEST_M_PER_S:g}): what is the position there?"
        )
    if usual < SLOWEST_M_PER_S:
        raise UnitError(f"{recording.name}: a speed of {usual:.2g} m/s is none: is it in km/s, or of another column?")


def slope_of(values: Floats, rate_hz: float, window_s: float) -> Floats:
    """The slope, per second, of a straight line through the window about each sample; shorter at the ends."""
    count = len(values)
    half = min(max(1, round(window_s * rate_hz / 2)), (count - 1) // 2)
    middle = values[count // 2]
    index = np.arange(count, dtype=np.float64)
    ones = np.concatenate(([0.0], np.cumsum(values - middle)))
    ramps = np.concatenate(([0.0], np.cumsum((values - middle) * index)))
    at = np.arange(count)
    low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, count)
    number = (high - low).astype(np.float64)
    centre = (low + high - 1) / 2
    moment = number * (number**2 - 1) / 12
    slope: Floats = ((ramps[high] - ramps[low]) - centre * (ones[high] - ones[low])) / moment * rate_hz
    return slope


def running_mean(values: Floats, half: int) -> Floats:
    """Over 2 half + 1 samples; fewer at the ends."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    at = np.arange(len(values))
    low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, len(values))
    return np.asarray((total[high] - total[low]) / (high - low))
