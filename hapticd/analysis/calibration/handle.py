"""`hapticd calibrate`: measures the dynamics of handle and hand by driving the handle, first released, then held."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hapticd.analysis.calibration.accelerometer import AccelerometerResponse, compare, load_recording
from hapticd.analysis.calibration.fit import DAMPING, DELAY, FRICTION, MASS, STIFFNESS, Fit, Point, difference, fit
from hapticd.analysis.calibration.rig import rig_of
from hapticd.analysis.calibration.sweep import MAX_BURST_HZ, Axis, Record, Sweep, sweep_config, travel_m
from hapticd.analysis.drawing import require_matplotlib
from hapticd.analysis.statistics import Estimate, require_scipy
from hapticd.base.errors import HapticdError
from hapticd.config.actuator import MAX_BANDWIDTH_HZ
from hapticd.config.configuration import Config
from hapticd.rendering.rearm import Resting, at_rest

MIN_DELAY_PER_LAG: Final = 0.9
"""Lower bound of the ratio of a fitted delay to the time constant of the first-order lag that causes the delay.

A lag also changes the shape of the response, so that the fitted delay is up to 7 % less than the time constant.
"""
MIN_LAG_DAMPING_RATIO: Final = 0.36
"""Smallest damping ratio zeta of a second-order lag that has at least the bandwidth of a first-order lag of equal
delay: 2 zeta r >= 1, with the ratio r of bandwidth to natural frequency."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The result of a calibration: the drives of the free and of the held handle, and their fits."""

    kind: str
    axis: Axis
    records: tuple[Record, Record]
    free: Fit
    held: Fit
    responses: tuple[AccelerometerResponse, AccelerometerResponse] | None = None
    """Measurements of the accelerometer during the two drives, if any."""

    @property
    def handle(self) -> tuple[Estimate, Estimate, Estimate]:
        """Mass (kg), damping (N s/m) and dry friction (N) of the handle."""
        return (self.free.estimate(MASS), self.free.estimate(DAMPING), self.free.estimate(FRICTION))

    @property
    def grip(self) -> tuple[Estimate, Estimate, Estimate]:
        """Mass (kg), damping (N s/m) and stiffness (N/m) of the hand: the held drive minus the free one."""
        mass, damping = (difference(self.held, self.free, which) for which in (MASS, DAMPING))
        return (mass, damping, self.held.estimate(STIFFNESS))

    @property
    def resting(self) -> Resting:
        """Noise and smallest step of the positions of the free handle before its first burst."""
        free = self.records[0]
        begin = min((burst.begin for burst in free.bursts), default=0)
        return at_rest(free.position_m[:begin], free.step_m, free.rate_hz)

    @property
    def bandwidth_at_least_hz(self) -> float:
        """Lower bound of the actuator's bandwidth in Hz: the cutoff of a first-order lag that causes the delay.

        The encoder cannot distinguish a lag from a delay. The bound is infinite without a delay.
        """
        delay_s = self.free.estimate(DELAY).high
        return MIN_DELAY_PER_LAG / (2 * math.pi * delay_s) if delay_s > 0 else math.inf

    def section(self) -> dict[str, object]:
        """Return the section `device` of a configuration with the calibrated values, to four digits."""
        shown = [float(f"{max(0.0, each.value):.4g}") for each in (*self.handle, *self.grip)]
        return {
            "device": {
                "handle": dict(zip(("mass_kg", "damping_n_s_per_m", "friction_n"), shown[:3], strict=True)),
                "grip": dict(zip(("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"), shown[3:], strict=True)),
                "rearm_m": self.resting.rearm_m,
            }
        }

    def rows(self) -> list[tuple[str, Estimate, str]]:
        """Return the name, the estimate and the unit of each result, for a table."""
        names = ("handle mass", "handle damping", "handle friction", "grip mass", "grip damping", "grip stiffness")
        units = ("kg", "N s/m", "N", "kg", "N s/m", "N/m")
        in_ms = self.free.estimate(DELAY, -math.inf).mapped(lambda seconds: 1e3 * seconds)
        return [*zip(names, (*self.handle, *self.grip), units, strict=True), ("delay", in_ms, "ms")]

    def curves(self) -> Iterator[tuple[str, Record, Fit, AccelerometerResponse | None]]:
        """Yield name, record, fit and accelerometer response of both drives."""
        yield "free", self.records[0], self.free, None if self.responses is None else self.responses[0]
        yield "held", self.records[1], self.held, None if self.responses is None else self.responses[1]

    def notes(self) -> list[str]:
        """Return notes on the quality of the calibration, one line each."""
        lines = []
        for name, record, found, accelerometer in self.curves():
            highest = max(point.frequency_hz for point in found.points)
            lines.append(
                f"{name}: measured by the encoder up to {highest:.0f} Hz; RMS of the residual "
                f"{1e6 * found.residual_m:.2g} um, of the motion {1e6 * found.motion_m:.3g} um (step "
                f"{1e6 * record.step_m:.3g} um)"
            )
            if record.left_out:
                lines.append(f"{name}: {record.left_out} bursts are excluded, as the servo stalled during them")
            if found.residual_m > max(0.05 * found.motion_m, record.step_m):
                lines.append(
                    f"{name}: the residual is large: this handle is not only a mass with damping and dry friction, or "
                    "the hand moved; the bounds hold for the model only"
                )
            if accelerometer is not None:
                beyond = [point for point in accelerometer.points if point.frequency_hz > highest]
                text = f"{name}: accelerometer scale {accelerometer.scale:.3g}"
                if beyond:
                    off = float(np.sqrt(np.mean([(abs(point.ratio) - 1) ** 2 for point in beyond])))
                    last = beyond[-1].frequency_hz
                    text += f"; above the encoder's range, up to {last:.0f} Hz, {100 * off:.2g} % RMS from the fit"
                lines.append(text)
        return [*lines, self._actuator_note(), str(self.resting)]

    def _actuator_note(self) -> str:
        bandwidth_hz = self.bandwidth_at_least_hz
        if bandwidth_hz >= MAX_BANDWIDTH_HZ:
            limit = f"{MAX_BANDWIDTH_HZ:g} Hz"
            return f"actuator: its bandwidth is above {limit}, so the configuration needs no device.actuator"
        return (
            f"actuator: its bandwidth is {bandwidth_hz:.0f} Hz or more (of second order: with a damping ratio of at "
            f"least {MIN_LAG_DAMPING_RATIO:g}), even if all of the delay is its lag; a lag cannot be distinguished "
            "from a delay, so device.actuator is not written"
        )

    def to_dict(self) -> dict[str, object]:
        """Return the result as JSON."""
        return {
            "axis": self.axis,
            "estimates": {name.replace(" ", "_"): {**each.to_dict(), "unit": unit} for name, each, unit in self.rows()},
            "response": {name: list(_response(fit, accelerometer)) for name, _, fit, accelerometer in self.curves()},
            "accelerometer_scale": None if self.responses is None else [each.scale for each in self.responses],
            "positions": self.resting.to_dict(),
            "actuator_bandwidth_at_least_hz": min(MAX_BANDWIDTH_HZ, self.bandwidth_at_least_hz),
            "notes": self.notes(),
        }


def _measured(fit: Fit, accelerometer: AccelerometerResponse | None) -> list[tuple[str, Sequence[Point]]]:
    """Return each sensor's name, and the response that it measured, divided by the response of the fit."""
    return [("encoder", fit.points), ("accelerometer", () if accelerometer is None else accelerometer.points)]


def _response(fit: Fit, accelerometer: AccelerometerResponse | None) -> Iterator[dict[str, object]]:
    for by, points in _measured(fit, accelerometer):
        for point in points:
            fitted = complex(fit.response(np.array([point.frequency_hz]))[0])
            measured = fitted * point.ratio
            yield {
                "by": by,
                "frequency_hz": point.frequency_hz,
                "measured_m_per_n": [measured.real, measured.imag],
                "fitted_m_per_n": [fitted.real, fitted.imag],
            }


def calibrate(
    config: Config,
    axis: Axis,
    force_n: float,
    ask: Callable[[bool], None],
    progress: Callable[[str], None],
    *,
    wide: bool = False,
) -> Calibration:
    """Drive the handle free and held, and fit both drives.

    `ask` is called before each drive, with True if the handle must be held. `progress` is called with each new state,
    and with an empty text before `ask`. `wide` drives up to MAX_BURST_HZ. Raises HapticdError if the device cannot be
    driven. After an exception the force is zero.
    """
    require_scipy("calibrating")
    device = config.device
    limit_n = min(force_n, device.max_force_n)
    if device.kind == "sim":
        limit_n = min(limit_n, device.sim.max_force_n)
    fits: list[Fit] = []
    records: list[Record] = []
    for held in (False, True):
        progress("")
        ask(held)
        progress("held" if held else "free")
        highest_hz = MAX_BURST_HZ if wide else None
        with rig_of(sweep_config(config, held=held, force_n=limit_n)) as rig:
            records.append(Sweep(rig, progress, axis, held, limit_n, travel_m(config), highest_hz).run())
        progress("fitting")
        fits.append(fit(records[-1], fits[0] if held else None))
    return Calibration(device.kind, axis, (records[0], records[1]), fits[0], fits[1])


def with_accelerometer(found: Calibration, path: str) -> Calibration:
    """Add an accelerometer's recording of both drives to a calibration.

    Raises HapticdError if the recording cannot be read, or lacks a drive.
    """
    recording = load_recording(path)
    free, held = (
        compare(record, each, recording) for record, each in zip(found.records, (found.free, found.held), strict=True)
    )
    return replace(found, responses=(free, held))


# ---- The picture ----------------------------------------------------------------------------------------------------


def check_picture(path: str) -> None:
    """Raise HapticdError if matplotlib is missing or cannot write the format of a file's extension."""
    require_matplotlib("a plot", "fit")
    from matplotlib.backend_bases import FigureCanvasBase

    known = sorted(FigureCanvasBase.get_supported_filetypes())
    ending = _picture_ending(path)
    if ending not in known:
        raise HapticdError(
            f"{path}: unknown picture format: the name must end in .png or another of {', '.join(known)}"
        )


def picture(found: Calibration, path: str) -> bytes:
    """Draw the measured and fitted responses, magnitude above phase; return the bytes in the format of `path`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 7), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for color, (name, _, fitted, accelerometer) in zip(("C0", "C1"), found.curves(), strict=True):
        measured = _measured(fitted, accelerometer)
        frequencies = [point.frequency_hz for _, points in measured for point in points]
        fine = np.geomspace(min(frequencies), max(frequencies), 500)
        response = fitted.response(fine)
        above.loglog(fine, np.abs(response), lw=1, color=color, label=f"{name}, fit")
        below.semilogx(fine, np.degrees(np.angle(response)), lw=1, color=color)
        for marker, (by, points) in zip("ox", measured, strict=True):
            if points:
                frequency = np.array([point.frequency_hz for point in points])
                seen = fitted.response(frequency) * np.array([point.ratio for point in points])
                above.loglog(frequency, np.abs(seen), marker, ms=4, color=color, label=f"{name}, {by}")
                below.semilogx(frequency, np.degrees(np.angle(seen)), marker, ms=4, color=color)
    above.set_ylabel("position over force, m/N")
    above.legend(fontsize=8)
    below.set_ylabel("phase, degrees")
    below.set_xlabel("Hz")
    content = io.BytesIO()
    figure.savefig(content, dpi=120, format=_picture_ending(path))
    return content.getvalue()


def _picture_ending(path: str) -> str:
    return os.path.splitext(path)[1].lower().lstrip(".") or "png"
