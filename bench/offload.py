"""How well a device's own periodic effect would play a tap: `python -m bench.offload`, figures of docs/adr.

A sine of the PID class has a period, and an envelope of straight lines: from the attack level to the magnitude over the
attack time, and to the fade level over the fade time at the end of the effect. Times are multiples of the device's
resolution. The best such effect is found by least squares over its levels, for each choice of its times.
"""

from __future__ import annotations

import math

import numpy as np

from bench.report import Floats, Table
from hapticd.materials import shipped_materials
from hapticd.mode import Mode

RESOLUTIONS_S = (1e-3, 1e-4, 1e-5)
SPAN = 6.0
"""So many decay times are compared."""
SAMPLES = 1500
STEPS = 50
"""Times are tried at this many places over the span, or at every multiple of the resolution if those are fewer."""


def _envelopes(time_s: Floats, attack_s: float, end_s: float) -> Floats:
    """[3][n]: what attack level, magnitude and fade level each contribute; no time between attack and fade."""
    knots = [0.0, attack_s, end_s]
    rows = [np.interp(time_s, knots, [float(i == j) for j in range(3)], right=0.0) for i in range(3)]
    if attack_s == 0.0:
        rows[0][:] = 0.0
        rows[1] = np.interp(time_s, [0.0, end_s], [1.0, 0.0], right=0.0)
    found: Floats = np.array(rows)
    found[:, time_s > end_s] = 0.0
    return found


def best(mode: Mode, resolution_s: float) -> tuple[float, float]:
    """Period in s and error (RMS over RMS) of the effect that is nearest to the mode."""
    span_s = SPAN * mode.decay_time_s
    time_s = (np.arange(SAMPLES) + 0.5) * span_s / SAMPLES
    wanted = np.exp(-mode.decay_rate_per_s * time_s) * np.sin(mode.angular_frequency_rad_per_s * time_s)
    power = float(wanted @ wanted)
    step_s = resolution_s * max(1, round(span_s / STEPS / resolution_s))
    times = np.arange(0, math.ceil(span_s / step_s) + 1) * step_s
    nearest = round(1 / mode.frequency_hz / resolution_s)
    found = (math.nan, 1.0)
    for count in range(max(1, nearest - 1), nearest + 2):
        period_s = count * resolution_s
        sine = np.sin(2 * np.pi * time_s / period_s)
        for end_s in times[1:]:
            for attack_s in times[times < end_s]:
                basis = _envelopes(time_s, attack_s, end_s) * sine
                levels = np.linalg.lstsq(basis @ basis.T, basis @ wanted, rcond=1e-12)[0]
                left = wanted - levels @ basis
                error = math.sqrt(float(left @ left) / power)
                if error < found[1]:
                    found = (period_s, error)
    return found


def table() -> Table:
    """Each material that is struck, at each resolution."""
    rows = []
    for name, material in shipped_materials().items():
        if material.tap is None and material.rupture is None:
            continue
        mode = material.tap.mode if material.tap is not None else material.rupture.mode  # type: ignore[union-attr]
        cells = []
        for resolution_s in RESOLUTIONS_S:
            period_s, error = best(mode, resolution_s)
            cells.append("none" if math.isnan(period_s) else f"{1 / period_s:.0f} Hz, {100 * error:.0f} %")
        rows.append([name, f"{mode.frequency_hz:.0f}", f"{1e3 * mode.decay_time_s:.2f}", *cells])
    heads = [f"{1e3 * resolution_s:g} ms" for resolution_s in RESOLUTIONS_S]
    return Table("The nearest periodic effect and its error", ["material", "Hz", "decay, ms", *heads], rows)


if __name__ == "__main__":
    print(table().markdown())
