"""Recordings of an accelerometer on the handle: reading, alignment with a drive, comparison with the drive's fit.

.npz  `time_s` and `acceleration_m_per_s2`, each (n,)
.csv  the same as columns, named in the first line

The recording may begin at any time; the start of the drive in it is found by cross-correlation.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.calibration.fit import Fit, Point, model_motion, points_of, tapered
from hapticd.analysis.calibration.sweep import Record
from hapticd.analysis.recordings.clock import COLUMN_OF, check_columns
from hapticd.analysis.recordings.files import MAX_RECORDING_BYTES, TABLE_READERS, ending_of, file_bytes
from hapticd.analysis.statistics import Floats, require_scipy
from hapticd.base.errors import HapticdError

SCALE_BAND_HZ: Final = (10.0, 120.0)
"""Frequencies at which the encoder measures accurately, used to find the accelerometer's scale."""


@dataclass(frozen=True, slots=True)
class Recording:
    """An accelerometer's recording: acceleration (n,) without its mean, at rising times (n,) of the sensor's clock."""

    name: str
    time_s: Floats
    acceleration_m_per_s2: Floats

    @property
    def rate_hz(self) -> float:
        """Sampling rate, from the median interval between samples."""
        return 1.0 / float(np.median(np.diff(self.time_s)))

    def at(self, time_s: npt.NDArray[np.floating]) -> Floats:
        """Return the acceleration in m/s^2 at the times `time_s`, linearly interpolated; 0 outside of the recording."""
        return np.asarray(np.interp(time_s, self.time_s, self.acceleration_m_per_s2, left=0.0, right=0.0))


def check_name(name: str) -> None:
    """Raise HapticdError if a file's name does not end in .npz or .csv. The file need not exist yet."""
    if ending_of(name) not in (".npz", ".csv"):
        raise HapticdError(f"{name}: the name of a recording must end in .npz or .csv")


def load_recording(path: str | os.PathLike[str], scale: float = 1.0) -> Recording:
    """Read an accelerometer's recording, remove its mean, and multiply it by `scale`.

    Raises HapticdError if the file cannot be read.
    """
    name = os.fspath(path)
    check_name(name)
    try:
        table = TABLE_READERS[ending_of(name)](file_bytes(name, MAX_RECORDING_BYTES))
        indices = [table.index_of(COLUMN_OF[key]) for key in ("time", "acceleration")]
        # The names state SI units; a line of units that contradicts them is refused.
        table.stated_unit(indices[0], "time")
        table.stated_unit(indices[1], "acceleration")
        time_s, acceleration = table.read(indices)
        check_columns({"time": time_s, "acceleration": acceleration})
    except ValueError as error:
        raise HapticdError(f"{name}: {error}") from None
    if not (np.diff(time_s) > 0).all():
        raise HapticdError(f"{name}: {COLUMN_OF['time']} must rise from sample to sample")
    return Recording(name, time_s, (acceleration - acceleration.mean()) * scale)


def offset_of(recording: Recording, expected: Floats, rate_hz: float) -> float:
    """Return the time (s) in the recording at which `expected` (n,), an acceleration sampled at `rate_hz`, begins.

    At this time the normalised cross-correlation is highest, with a parabola between samples. Raises HapticdError if
    the correlation is below 0.3.
    """
    require_scipy("a recording of an accelerometer")
    from scipy.signal import correlate, correlation_lags

    count = 1 + math.floor((recording.time_s[-1] - recording.time_s[0]) * rate_hz)
    measured = recording.at(recording.time_s[0] + np.arange(count) / rate_hz)
    product = correlate(measured, expected, method="fft")
    lags = correlation_lags(count, len(expected))
    power = np.concatenate(([0.0], np.cumsum(measured**2)))
    overlapped = power[np.clip(lags + len(expected), 0, count)] - power[np.clip(lags, 0, count)]
    scale = np.sqrt(np.maximum(overlapped, 1e-6 * power[-1]) * np.sum(expected**2))
    correlation = product / np.where(scale > 0, scale, 1.0)
    best = int(np.argmax(correlation))
    if not correlation[best] >= 0.3:
        raise HapticdError(
            f"{recording.name}: the drive was not found in the recording (correlation {correlation[best]:.2f}): was it "
            "recorded during the drive, along this axis, with the right sign?"
        )
    shift = 0.0
    if 0 < best < len(product) - 1:
        before, now, after = product[best - 1 : best + 2]
        curve = before - 2 * now + after
        shift = 0.5 * (before - after) / curve if curve < 0 else 0.0
    return float(recording.time_s[0] + (lags[best] + shift) / rate_hz)


@dataclass(frozen=True, slots=True)
class AccelerometerResponse:
    """A handle's frequency response, measured by an accelerometer and divided by that of the fit to its positions."""

    points: tuple[Point, ...]
    """Ratio of the measured to the fitted response at each frequency, divided by `scale`."""
    scale: float
    """Median ratio, in SCALE_BAND_HZ, of the accelerometer's values to the accelerations of the fit."""


def compare(record: Record, fit: Fit, recording: Recording) -> AccelerometerResponse:
    """Return the response measured by an accelerometer, relative to the fit of the drive `record`.

    Measured and fitted acceleration are compared by their spectra over each burst, so their rates may differ. Raises
    HapticdError if the recording lacks the drive, or all bursts in SCALE_BAND_HZ.
    """
    expected = np.diff(model_motion(record, fit)[:, 1]) * record.rate_hz
    period_s = 1.0 / record.rate_hz
    # The first expected acceleration is the mean over the first period, and so belongs to its middle.
    since_s = recording.time_s - (offset_of(recording, expected, record.rate_hz) + 0.5 * period_s)
    interval_s = np.gradient(recording.time_s)

    def lines() -> Iterator[tuple[float, complex, complex]]:
        for burst in record.bursts:
            end = min(burst.end, len(expected))
            time_s = np.arange(burst.begin, end) * period_s
            inside = np.flatnonzero((since_s >= time_s[0]) & (since_s <= time_s[-1]))
            if len(inside) < 16 or burst.frequency_hz > 0.4 * recording.rate_hz:
                continue
            modelled = np.sum(tapered(time_s, burst.frequency_hz) * expected[burst.begin : end]) * period_s
            # Both spectra have the same window, that of the burst, and phases relative to the begin of the drive.
            around_s = np.concatenate((time_s[:1], since_s[inside], time_s[-1:]))
            pointer = tapered(around_s, burst.frequency_hz)[1:-1]
            measured = np.sum(pointer * recording.acceleration_m_per_s2[inside] * interval_s[inside])
            yield burst.frequency_hz, complex(measured), complex(modelled)

    points = points_of(lines())
    low = [abs(point.ratio) for point in points if SCALE_BAND_HZ[0] <= point.frequency_hz <= SCALE_BAND_HZ[1]]
    if not low:
        raise HapticdError(
            f"{recording.name}: contains no burst between {SCALE_BAND_HZ[0]:g} and {SCALE_BAND_HZ[1]:g} Hz"
        )
    scale = float(np.median(low))
    return AccelerometerResponse(tuple(Point(point.frequency_hz, point.ratio / scale) for point in points), scale)
