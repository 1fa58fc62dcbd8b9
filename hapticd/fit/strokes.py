"""What fits of strokes and of punctures share: checks of a recording, its motion, and small statistics."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import Estimate, FitError, Floats, MistakenError, student_t
from hapticd.fit.invalid_samples import SPEED, Kept
from hapticd.fit.recording import Recording
from hapticd.fit.verdict import Doubts

Ints = npt.NDArray[np.int64]

GRAVITY_M_PER_S2: Final = 9.80665
FASTEST_M_PER_S: Final = SPEED["texture"].most
SLOWEST_M_PER_S: Final = 1e-4
LEAST_FORCE_N: Final = 1e-3
FARTHEST_M: Final = 5.0
SPEED_WINDOW_S: Final = 0.02
"""A position is differentiated over so long."""
STILL_M_PER_S2: Final = 0.02
HARDLY: Final = 0.2
"""A range of forces that is less than this part of their mean."""
LEAST_RATE: Final = 2.5
"""Samples in a cycle, below which nothing is fitted."""


# ---- Checks ---------------------------------------------------------------------------------------------------


def acceleration_of(recording: Recording) -> Floats:
    """The acceleration, m/s^2. FitError where there is none, or it is all one value."""
    values = recording.acceleration_m_per_s2
    if values is None:
        raise FitError(f"{recording.name}: has no acceleration, which this fit needs")
    if not np.ptp(values) > 0:
        raise FitError(
            f"{recording.name}: the acceleration is {values[0]:g} m/s^2 throughout: was the sensor connected?"
        )
    if np.ptp(values) < STILL_M_PER_S2:
        raise FitError(
            f"{recording.name}: the acceleration moves by {np.ptp(values):.2g} m/s^2 in all, which is not felt: is its "
            "unit another one?"
        )
    return values


def force_of(recording: Recording) -> Floats:
    """The normal force, N, pressing positive. FitError where there is none, or it cannot be one."""
    values = recording.force_n
    if values is None:
        raise FitError(f"{recording.name}: has no force, which this fit needs")
    if not np.any(values):
        raise FitError(f"{recording.name}: the force is 0 throughout: was the sensor connected?")
    largest = float(np.percentile(np.abs(values), 99.9))
    if largest < LEAST_FORCE_N:
        raise MistakenError(
            f"{recording.name}: a force of {largest:.2g} N at most is too small to be felt: is it in kN?"
        )
    return values


def pressed(recording: Recording) -> Floats:
    """A force that presses for most of the time. FitError where it pulls, or swings about zero."""
    values = force_of(recording)
    if np.median(values) < 0:
        raise MistakenError(f"{recording.name}: the force is mostly negative: pressing must be positive (scale -1?)")
    if np.mean(values < -0.1 * np.std(values)) > 0.2:
        raise MistakenError(f"{recording.name}: the force swings about 0: is it swapped with the acceleration?")
    return values


def gravity_of(recording: Recording) -> list[str]:
    """What the rest value of the acceleration tells of its unit."""
    values = recording.acceleration_m_per_s2
    if values is None:
        return []
    rest = abs(float(np.median(values)))
    for usual, unit in ((1.0, "g"), (GRAVITY_M_PER_S2**2, "m/s^2 already, and multiplied by 9.80665 again")):
        if abs(rest / usual - 1) < 0.02:
            return [f"{recording.name}: rests at {rest:.3g} m/s^2: is the acceleration in {unit}?"]
    return []


def tell_gravity(recordings: Sequence[Recording], doubts: Doubts) -> None:
    """What rest values tell of the unit."""
    for recording in recordings:
        for line in gravity_of(recording):
            doubts.tell(line)


def told_of(kept: Sequence[Kept], doubts: Doubts) -> None:
    """What was left out of recordings, and where that is a doubt."""
    for line in (line for each in kept for line in each.told):
        doubts.note(line)
    count = sum(each.replaced.size for each in kept)
    part = sum(int(np.count_nonzero(each.replaced)) for each in kept) / max(1, count)
    doubts.at_most("part left out", part, f"{100 * part:.0f} % of the samples are left out")


def varied_force(recordings: Sequence[Recording], force: Floats, doubts: Doubts) -> None:
    """FitError where every sample of all recordings has the same force; told where they hardly differ."""
    every = [recording.force_n for recording in recordings if recording.force_n is not None]
    if max(float(each.max()) for each in every) == min(float(each.min()) for each in every):
        raise FitError(f"the force is {every[0][0]:g} N in every sample: was the sensor connected?")
    if float(np.ptp(force)) < HARDLY * abs(float(np.mean(force))):
        doubts.tell(
            f"the force hardly varies ({force.min():.3g} to {force.max():.3g} N): its gain takes in all that does not "
            "go with speed"
        )


def too_slow(rate_hz: float, frequency_hz: float, least: float = LEAST_RATE) -> str:
    """Why what rings at a frequency is not fitted at a rate, with fewer than `least` samples in a cycle; empty where it
    is."""
    if rate_hz >= least * frequency_hz:
        return ""
    return (
        f"rings at {frequency_hz:.4g} Hz, and is sampled at {rate_hz:g} Hz, which is too low: less than "
        f"{least:g} times that; {math.ceil(least * frequency_hz)} Hz are wanted"
    )


def tell_few_samples(recordings: Sequence[Recording], frequency_hz: float, doubts: Doubts) -> None:
    """Where the slowest recording has few samples in a cycle."""
    slowest = min(recording.rate_hz for recording in recordings)
    doubts.at_least(
        "samples in a cycle",
        slowest / frequency_hz,
        f"{slowest:g} Hz are {slowest / frequency_hz:.1f} samples in a cycle of {frequency_hz:.4g} Hz: amplitude "
        "and decay are less certain than their intervals say, and a filter of the sensor may have lowered them",
        "record at a higher rate",
    )


# ---- Motion ---------------------------------------------------------------------------------------------------


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
        raise MistakenError(f"{recording.name}: a stroke of {np.ptp(position):.4g} m is not a hand's: is it in mm?")
    if not np.ptp(position) > 0:
        raise FitError(f"{recording.name}: the position along the surface never moves: is it the wrong column?")
    found = slope_of(position, recording.rate_hz, SPEED_WINDOW_S)
    _refuse_speed(recording, found)
    if column is not None:
        usual, said = float(np.median(np.abs(found))), float(np.median(np.abs(column)))
        if not 0.5 * usual <= said <= 2 * usual:
            raise MistakenError(
                f"{recording.name}: the position moves at {usual:.3g} m/s, the speed says {said:.3g} m/s: "
                "one of them has the wrong unit or column"
            )
    return Motion(position, found)


def _refuse_speed(recording: Recording, speed: Floats) -> None:
    usual = float(np.percentile(np.abs(speed), 90))
    if usual > FASTEST_M_PER_S:
        raise MistakenError(f"{recording.name}: a speed of {usual:.4g} m/s is not a hand's: is it in mm/s?")
    fastest = int(np.argmax(np.abs(speed)))
    if not abs(speed[fastest]) <= FASTEST_M_PER_S:
        at_s = fastest / recording.rate_hz
        raise FitError(
            f"{recording.name}: a speed of {abs(speed[fastest]):.4g} m/s at {at_s:.6g} s is not a hand's (at most "
            f"{FASTEST_M_PER_S:g}): what is the position there?"
        )
    if usual < SLOWEST_M_PER_S:
        raise MistakenError(
            f"{recording.name}: a speed of {usual:.2g} m/s is none: is it in km/s, or of another column?"
        )


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


# ---- Statistics -----------------------------------------------------------------------------------------------


def about(value: float, error: float, freedom: float) -> Estimate:
    """A number with 95 % bounds from its standard error."""
    reach = student_t(freedom) * error
    return Estimate(float(value), float(value - reach), float(value + reach))


TUKEY: Final = 4.685
"""Standard deviations from which on a point has no weight: 95 % as good as least squares for normal errors."""
ROUNDS: Final = 60


@dataclass(frozen=True, slots=True)
class Robust:
    """y = sum of coefficients times columns, whatever a few points say."""

    coefficients: tuple[Estimate, ...]
    correlation: float
    """Of what was measured and what the model says, without the outliers."""
    outliers: tuple[int, ...]
    """Points without weight."""


def robust(columns: Floats, y: Floats, shifts: Floats | None = None, grows: bool = True) -> Robust:
    """Tukey's bisquare M-estimate of y (n,) by columns (n, k), begun from Huber's.

    The scale of an error is one for all, or, if it `grows`, a + b |y as modelled|, with a and b from the absolute
    residuals. Intervals are Huber's (1981) sandwich, with residuals enlarged for their leverage (MacKinnon and White,
    1985), so that scales need not be right. `shifts` (m, n): errors of one standard deviation each that all points
    have together. FitError where there are not more points than columns.
    """
    count, unknowns = columns.shape
    if count <= unknowns:
        raise FitError(f"{count} points cannot tell {unknowns} figures with their intervals: needs {unknowns + 1}")
    scale = np.full(count, _spread(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0], count, unknowns))
    weight = np.ones(count)
    values = np.zeros(unknowns)
    for bisquare in (False, True):
        for _ in range(ROUNDS):
            root = np.sqrt(weight) / scale
            before = values
            values = np.linalg.lstsq(columns * root[:, None], y * root, rcond=None)[0]
            modelled = columns @ values
            off = y - modelled
            if not np.abs(off).max() > 1e-12 * np.abs(y).max():
                break
            scale = _scales(off, np.abs(modelled) if grows else np.ones(count), unknowns)
            size = np.abs(off) / scale
            weight = np.maximum(1 - (size / TUKEY) ** 2, 0) ** 2 if bisquare else 1 / np.maximum(1, size / 1.345)
            if np.abs(values - before).max() < 1e-10 * np.abs(values).max():
                break
    size = off / scale
    inside = np.abs(size) < TUKEY
    weight = np.where(inside, (1 - (size / TUKEY) ** 2) ** 2, 0.0)
    bend = np.where(inside, (1 - (size / TUKEY) ** 2) * (1 - 5 * (size / TUKEY) ** 2), 0.0)
    scaled = columns / scale[:, None]
    bread = np.linalg.pinv((scaled * bend[:, None]).T @ scaled)
    whitened = scaled * np.sqrt(weight)[:, None]
    leverage = np.sum((whitened @ np.linalg.pinv(whitened.T @ whitened)) * whitened, axis=1)
    pull = weight * size / (1 - np.minimum(leverage, 0.9))
    meat = (scaled * pull[:, None] ** 2).T @ scaled
    if shifts is not None:
        together = (shifts / scale * weight) @ scaled
        meat = meat + together.T @ together
    errors = np.sqrt(np.maximum(np.diag(bread @ meat @ bread), 0.0))
    kept = np.flatnonzero(inside)
    modelled = columns @ values
    correlation = float(np.corrcoef(modelled[kept], y[kept])[0, 1]) if np.ptp(modelled[kept]) > 0 else math.nan
    freedom = max(1, len(kept) - unknowns)
    return Robust(
        tuple(about(float(value), float(error), freedom) for value, error in zip(values, errors, strict=True)),
        correlation,
        tuple(int(k) for k in np.flatnonzero(~inside)),
    )


def _spread(off: Floats, count: int, unknowns: int) -> float:
    """Standard deviation, from the median of the absolute values; they are fewer than they seem by the unknowns."""
    usual = 1.4826 * float(np.median(np.abs(off))) * math.sqrt(count / (count - unknowns))
    return usual or float(np.sqrt(np.mean(off**2))) or 1.0


def _scales(off: Floats, modelled: Floats, unknowns: int) -> Floats:
    """a + b |modelled| of every point; both at least 0, and no scale far below the usual one."""
    count = len(off)
    usual = _spread(off, count, unknowns)
    far = np.minimum(np.abs(off), 3 * usual)
    columns = np.column_stack((np.ones(count), modelled))
    a, b = np.linalg.lstsq(columns, far, rcond=None)[0] if np.ptp(modelled) > 0 else (1.0, 0.0)
    if a < 0:
        a, b = 0.0, 1.0
    elif b < 0:
        a, b = 1.0, 0.0
    shape = np.maximum(a + b * modelled, 0.0)
    shape = np.maximum(shape, 0.2 * float(np.median(shape))) if np.median(shape) > 0 else np.ones(count)
    scaled: Floats = shape * _spread(off / shape, count, unknowns)
    return scaled


def told_apart(columns: Floats, worst: float = 100.0) -> bool:
    """Whether columns differ by enough for their coefficients: by the condition number of the columns, scaled."""
    norms = np.linalg.norm(columns, axis=0)
    return bool((norms > 0).all()) and float(np.linalg.cond(columns / norms)) < worst


def excludes_zero(estimate: Estimate) -> bool:
    return estimate.low > 0 or estimate.high < 0


def plain(value: object) -> object:
    """Dataclasses, tuples and arrays as plain data for JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
