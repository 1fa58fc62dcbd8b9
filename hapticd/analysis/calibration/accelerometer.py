"""Recordings of an accelerometer: read, laid beside what was driven, compared.

.npz  `time_s` and `acceleration_m_per_s2`, each (n,)
.csv  the same as columns, named in the first line

They are read as recordings for a fit are (hapticd.analysis.recordings), without a YAML beside them.

The recording's clock starts anywhere: where in it a drive lies is found by cross-correlation.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.calibration.fit import Fit, Point, model_motion, tapered
from hapticd.analysis.calibration.sweep import Floats, Record
from hapticd.analysis.recordings.clock import LEAST_SAMPLES
from hapticd.analysis.recordings.files import MAX_BYTES, READERS, ending_of, file_bytes
from hapticd.base.errors import HapticdError

TIME: Final = "time_s"
ACCELERATION: Final = "acceleration_m_per_s2"
ALIKE: Final = 0.3
"""Less correlation than this is not the same motion."""
SCALE_TO_HZ: Final = 120.0
"""Where the encoder sees well, the accelerometer's scale is found by it: between 30 Hz and here."""
SCALE_FROM_HZ: Final = 10.0


@dataclass(frozen=True, slots=True)
class Recording:
    """Acceleration (n,) at rising times (n,) of a separate clock."""

    name: str
    time_s: Floats
    acceleration_m_per_s2: Floats

    @property
    def rate_hz(self) -> float:
        return 1.0 / float(np.median(np.diff(self.time_s)))

    def at(self, time_s: npt.NDArray[np.floating]) -> Floats:
        """By straight lines; 0 beyond its ends."""
        return np.asarray(np.interp(time_s, self.time_s, self.acceleration_m_per_s2, left=0.0, right=0.0))


def check_name(name: str) -> None:
    """Raises HapticdError (one line) for what is no recording by its name; it may be there only later."""
    if ending_of(name) not in (".npz", ".csv"):
        raise HapticdError(f"{name}: a recording ends in .npz or .csv")


def load_recording(path: str | os.PathLike[str], scale: float = 1.0) -> Recording:
    """A recording, its numbers times `scale`. Raises HapticdError (one line) for what cannot be read."""
    name = os.fspath(path)
    check_name(name)
    try:
        table = READERS[ending_of(name)](file_bytes(name, MAX_BYTES))
        time_s, acceleration = table.read([table.place(TIME), table.place(ACCELERATION)])
    except ValueError as error:
        raise HapticdError(f"{name}: {error}") from None
    if len(time_s) != len(acceleration) or len(time_s) < LEAST_SAMPLES:
        raise HapticdError(f"{name}: {TIME} and {ACCELERATION} must be of one length, at least {LEAST_SAMPLES}")
    if not (np.isfinite(time_s).all() and np.isfinite(acceleration).all() and (np.diff(time_s) > 0).all()):
        raise HapticdError(f"{name}: {TIME} must rise, and every number be finite")
    return Recording(name, time_s, (acceleration - acceleration.mean()) * scale)


def offset_of(recording: Recording, expected: Floats, rate_hz: float) -> float:
    """The recording's time at which `expected` (n,), an acceleration at this rate, begins.

    The maximum of the normalised cross-correlation, between samples by a parabola. Raises HapticdError where nothing
    in the recording is like it.
    """
    count = 1 + math.floor((recording.time_s[-1] - recording.time_s[0]) * rate_hz)
    heard = recording.at(recording.time_s[0] + np.arange(count) / rate_hz)
    length = 1 << math.ceil(math.log2(count + len(expected)))
    product = np.fft.irfft(np.fft.rfft(heard, length) * np.conj(np.fft.rfft(expected, length)), length)
    # From all of `expected` before the recording to all of it behind.
    lags = np.arange(-len(expected) + 1, count)
    product = product[lags]
    power = np.concatenate(([0.0], np.cumsum(heard**2)))
    here = power[np.clip(lags + len(expected), 0, count)] - power[np.clip(lags, 0, count)]
    scale = np.sqrt(np.maximum(here, 1e-6 * power[-1]) * np.sum(expected**2))
    alike = product / np.where(scale > 0, scale, 1.0)
    best = int(np.argmax(alike))
    if not alike[best] >= ALIKE:
        raise HapticdError(
            f"{recording.name}: what was driven is not in it (correlation {alike[best]:.2f}): was it recorded "
            "meanwhile, along this axis, the right way round?"
        )
    shift = 0.0
    if 0 < best < len(product) - 1:
        before, now, after = product[best - 1 : best + 2]
        curve = before - 2 * now + after
        shift = 0.5 * (before - after) / curve if curve < 0 else 0.0
    return float(recording.time_s[0] + (lags[best] + shift) / rate_hz)


@dataclass(frozen=True, slots=True)
class Heard:
    """What an accelerometer says of a drive."""

    points: tuple[Point, ...]
    """Over what the fit says, in the scale of the encoder."""
    scale: float
    """Of the accelerometer's numbers to what the encoder says, where both see well."""


def compare(record: Record, fit: Fit, recording: Recording) -> Heard:
    """The accelerometer against the fit, burst by burst. Raises HapticdError where the drive is not in the recording.

    Accelerations are compared as spectra over the same time, so that each may have another rate.
    """
    speed = model_motion(record, fit)[:, 1]
    period_s = 1.0 / record.rate_hz
    expected = np.diff(speed) * record.rate_hz
    begin_s = offset_of(recording, expected, record.rate_hz) + 0.5 * period_s  # middles of the periods
    own_s = np.gradient(recording.time_s)
    seen: dict[float, complex] = {}
    said: dict[float, float] = {}
    for burst in record.bursts:
        end = min(burst.end, len(expected))
        time_s = np.arange(burst.begin, end) * period_s
        inside = np.flatnonzero((recording.time_s - begin_s >= time_s[0]) & (recording.time_s - begin_s <= time_s[-1]))
        if len(inside) < 16 or burst.frequency_hz > 0.4 * recording.rate_hz:
            continue
        of_model = np.sum(tapered(time_s, burst.frequency_hz) * expected[burst.begin : end]) * period_s
        heard_s = recording.time_s[inside] - begin_s
        pointer = tapered(np.concatenate(([time_s[0]], heard_s, [time_s[-1]])), burst.frequency_hz)[1:-1]
        # Both pointers turn from their own beginning on: at the same moment, the drive's.
        of_sensor = np.sum(pointer * recording.acceleration_m_per_s2[inside] * own_s[inside])
        frequency, line = burst.frequency_hz, complex(of_model)
        seen[frequency] = seen.get(frequency, 0j) + complex(of_sensor) * line.conjugate()
        said[frequency] = said.get(frequency, 0.0) + abs(line) ** 2
    points = [Point(frequency, seen[frequency] / said[frequency]) for frequency in sorted(seen)]
    low = [abs(point.ratio) for point in points if SCALE_FROM_HZ <= point.frequency_hz <= SCALE_TO_HZ]
    if not low:
        raise HapticdError(
            f"{recording.name}: holds none of the drive between {SCALE_FROM_HZ:g} and {SCALE_TO_HZ:g} Hz"
        )
    scale = float(np.median(low))
    return Heard(tuple(Point(point.frequency_hz, point.ratio / scale) for point in points), scale)
