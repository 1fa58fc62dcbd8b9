"""What every kind of fit checks of a recording first: acceleration, force, their units, and the rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from hapticd.analysis.statistics import FitError, Floats, UnitError
from hapticd.fit.invalid_samples import Cleaned
from hapticd.fit.recording import Recording
from hapticd.fit.verdict import Doubts

GRAVITY_M_PER_S2: Final = 9.80665
LEAST_FORCE_N: Final = 1e-3
STILL_M_PER_S2: Final = 0.02
HARDLY: Final = 0.2
"""A range of forces that is less than this part of their mean."""
LEAST_RATE: Final = 2.5
"""Samples in a cycle, below which nothing is fitted."""


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
        raise UnitError(f"{recording.name}: a force of {largest:.2g} N at most is too small to be felt: is it in kN?")
    return values


def pressed(recording: Recording) -> Floats:
    """A force that presses for most of the time. FitError where it pulls, or swings about zero."""
    values = force_of(recording)
    if np.median(values) < 0:
        raise UnitError(f"{recording.name}: the force is mostly negative: pressing must be positive (scale -1?)")
    if np.mean(values < -0.1 * np.std(values)) > 0.2:
        raise UnitError(f"{recording.name}: the force swings about 0: is it swapped with the acceleration?")
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


def report_gravity(recordings: Sequence[Recording], doubts: Doubts) -> None:
    """What rest values tell of the unit."""
    for recording in recordings:
        for line in gravity_of(recording):
            doubts.doubt(line)


def report_cleaning(kept: Sequence[Cleaned], doubts: Doubts) -> None:
    """What was left out of recordings, and where that is a doubt."""
    for line in (line for each in kept for line in each.warnings):
        doubts.warn(line)
    count = sum(each.replaced.size for each in kept)
    part = sum(int(np.count_nonzero(each.replaced)) for each in kept) / max(1, count)
    doubts.at_most("part left out", part, f"{100 * part:.0f} % of the samples are left out")


def check_force_varies(recordings: Sequence[Recording], force: Floats, doubts: Doubts) -> None:
    """FitError where every sample of all recordings has the same force; reported where they hardly differ."""
    every = [recording.force_n for recording in recordings if recording.force_n is not None]
    if max(float(each.max()) for each in every) == min(float(each.min()) for each in every):
        raise FitError(f"the force is {every[0][0]:g} N in every sample: was the sensor connected?")
    if float(np.ptp(force)) < HARDLY * abs(float(np.mean(force))):
        doubts.doubt(
            f"the force hardly varies ({force.min():.3g} to {force.max():.3g} N): its gain takes in all that does not "
            "go with speed"
        )


def undersampled(rate_hz: float, frequency_hz: float, least: float = LEAST_RATE) -> str:
    """Why what rings at a frequency is not fitted at a rate, with fewer than `least` samples in a cycle; empty where it
    is."""
    if rate_hz >= least * frequency_hz:
        return ""
    return (
        f"rings at {frequency_hz:.4g} Hz, and is sampled at {rate_hz:g} Hz, which is too low: less than "
        f"{least:g} times that; {math.ceil(least * frequency_hz)} Hz are wanted"
    )


def report_sampling(recordings: Sequence[Recording], frequency_hz: float, doubts: Doubts) -> None:
    """Where the slowest recording has few samples in a cycle."""
    slowest = min(recording.rate_hz for recording in recordings)
    doubts.at_least(
        "samples in a cycle",
        slowest / frequency_hz,
        f"{slowest:g} Hz are {slowest / frequency_hz:.1f} samples in a cycle of {frequency_hz:.4g} Hz: amplitude "
        "and decay are less certain than their intervals say, and a filter of the sensor may have lowered them",
        "record at a higher rate",
    )
