"""What `hapticd calibrate` does: drives free and held, fits both, and says what handle and hand are."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hapticd.analysis.calibration.accelerometer import Heard, compare, load_recording
from hapticd.analysis.calibration.fit import Fit, Point, difference, fit
from hapticd.analysis.calibration.rig import rig_of
from hapticd.analysis.calibration.sweep import HIGHEST_HZ, Axis, Record, Sweep, sweep_config, travel_m
from hapticd.analysis.drawing import require_matplotlib
from hapticd.analysis.statistics import Estimate, require_scipy
from hapticd.base.errors import HapticdError
from hapticd.config.actuator import MAX_BANDWIDTH_HZ
from hapticd.config.configuration import Config
from hapticd.rendering.rearm import Resting, at_rest

LAGGING: Final = 0.9
"""A lag bends the response as well as it delays it: the delay that is fitted is up to 7 % less than the lag's."""
LEAST_RATIO: Final = 0.36
"""A lag of second order with this damping ratio or more has at least the bandwidth of one of first order that delays as
much: with r = bandwidth over natural frequency, 2 zeta r >= 1."""

_MASS, _DAMPING, _FRICTION, _STIFFNESS, _DELAY = range(5)


@dataclass(frozen=True, slots=True)
class Calibration:
    """The two drives and what they say."""

    kind: str
    axis: Axis
    records: tuple[Record, Record]
    free: Fit
    held: Fit
    heard: tuple[Heard, Heard] | None = None

    @property
    def handle(self) -> tuple[Estimate, Estimate, Estimate]:
        """Mass (kg), damping (N s/m), dry friction (N)."""
        return (self.free.estimate(_MASS), self.free.estimate(_DAMPING), self.free.estimate(_FRICTION))

    @property
    def grip(self) -> tuple[Estimate, Estimate, Estimate]:
        """Mass (kg), damping (N s/m), stiffness (N/m): held minus free."""
        mass, damping = (difference(self.held, self.free, which) for which in (_MASS, _DAMPING))
        return (mass, damping, self.held.estimate(_STIFFNESS))

    @property
    def resting(self) -> Resting:
        """The positions before the first burst, where nobody holds the handle."""
        free = self.records[0]
        begin = min((burst.begin for burst in free.bursts), default=0)
        return at_rest(free.position_m[:begin], free.step_m, free.rate_hz)

    @property
    def bandwidth_at_least_hz(self) -> float:
        """What the actuator's bandwidth is not below: that of a lag of first order which is all of the delay. Infinite
        without a delay.

        A lag and a delay move the handle alike as far as the encoder sees, so the fit does not tell them apart.
        """
        longest_s = self.free.estimate(_DELAY).high
        return LAGGING / (2 * math.pi * longest_s) if longest_s > 0 else math.inf

    def section(self) -> dict[str, object]:
        """What a configuration file takes, four figures of each."""
        shown = [float(f"{max(0.0, each.value):.4g}") for each in (*self.handle, *self.grip)]
        return {
            "device": {
                "handle": dict(zip(("mass_kg", "damping_n_s_per_m", "friction_n"), shown[:3], strict=True)),
                "grip": dict(zip(("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"), shown[3:], strict=True)),
                "rearm_m": self.resting.rearm_m,
            }
        }

    def rows(self) -> list[tuple[str, Estimate, str]]:
        """For a table."""
        names = ("handle mass", "handle damping", "handle friction", "grip mass", "grip damping", "grip stiffness")
        units = ("kg", "N s/m", "N", "kg", "N s/m", "N/m")
        in_ms = self.free.estimate(_DELAY, -math.inf).mapped(lambda seconds: 1e3 * seconds)
        return [*zip(names, (*self.handle, *self.grip), units, strict=True), ("delay", in_ms, "ms")]

    def curves(self) -> Iterator[tuple[str, Record, Fit, Heard | None]]:
        """Both drives: name, what was recorded, its fit, and what an accelerometer says of it."""
        yield "free", self.records[0], self.free, None if self.heard is None else self.heard[0]
        yield "held", self.records[1], self.held, None if self.heard is None else self.heard[1]

    def notes(self) -> list[str]:
        """What else there is to say, a line each."""
        lines = []
        for name, record, found, heard in self.curves():
            highest = max(point.frequency_hz for point in found.points)
            lines.append(
                f"{name}: seen by the encoder up to {highest:.0f} Hz; {1e6 * found.residual_m:.2g} um of "
                f"{1e6 * found.motion_m:.3g} um are left over (step {1e6 * record.step_m:.3g} um)"
            )
            if record.left_out:
                lines.append(f"{name}: {record.left_out} bursts are left out, the servo stalled during them")
            if found.residual_m > max(0.05 * found.motion_m, record.step_m):
                lines.append(
                    f"{name}: that is much: this handle is not only a mass with damping and dry friction, or the hand "
                    "did not keep still; the bounds hold for the model only"
                )
            if heard is not None:
                beyond = [point for point in heard.points if point.frequency_hz > highest]
                text = f"{name}: accelerometer's scale {heard.scale:.3g}"
                if beyond:
                    off = float(np.sqrt(np.mean([(abs(point.ratio) - 1) ** 2 for point in beyond])))
                    last = beyond[-1].frequency_hz
                    text += f"; beyond the encoder, up to {last:.0f} Hz, {100 * off:.2g} % RMS from the fit"
                lines.append(text)
        return [*lines, self._of_actuator(), str(self.resting)]

    def _of_actuator(self) -> str:
        least_hz = self.bandwidth_at_least_hz
        if least_hz >= MAX_BANDWIDTH_HZ:
            return (
                f"actuator: its bandwidth is above {MAX_BANDWIDTH_HZ:g} Hz, so that it needs none in the configuration"
            )
        return (
            f"actuator: its bandwidth is {least_hz:.0f} Hz or more (of second order: with a damping ratio from "
            f"{LEAST_RATIO:g} on), even if all of the delay is its lag; the fit does not tell a lag from a delay, so "
            "none is written"
        )

    def to_dict(self) -> dict[str, object]:
        """For programs."""
        return {
            "axis": self.axis,
            "estimates": {name.replace(" ", "_"): {**each.to_dict(), "unit": unit} for name, each, unit in self.rows()},
            "response": {name: list(_response(fit, heard)) for name, _, fit, heard in self.curves()},
            "accelerometer_scale": None if self.heard is None else [each.scale for each in self.heard],
            "positions": self.resting.to_dict(),
            "actuator_bandwidth_at_least_hz": min(MAX_BANDWIDTH_HZ, self.bandwidth_at_least_hz),
            "notes": self.notes(),
        }


def _measured(fit: Fit, heard: Heard | None) -> list[tuple[str, Sequence[Point]]]:
    """What was measured, over the fit, and by what."""
    return [("encoder", fit.points), ("accelerometer", () if heard is None else heard.points)]


def _response(fit: Fit, heard: Heard | None) -> Iterator[dict[str, object]]:
    for by, points in _measured(fit, heard):
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
    """Drives and fits. `ask` is called before each drive, with whether the handle is to be held; an empty `progress`
    makes room for it. `wide`: up to where an accelerometer sees.

    Raises HapticdError, one line, where that cannot be; the force is zero then, as with every other exception.
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
        highest_hz = HIGHEST_HZ if wide else None
        with rig_of(sweep_config(config, held=held, force_n=limit_n)) as rig:
            records.append(Sweep(rig, progress, axis, held, limit_n, travel_m(config), highest_hz).run())
        progress("fitting")
        fits.append(fit(records[-1], fits[0] if held else None))
    return Calibration(device.kind, axis, (records[0], records[1]), fits[0], fits[1])


def with_accelerometer(found: Calibration, path: str) -> Calibration:
    """The calibration beside a recording of both drives. Raises HapticdError for one that does not hold them."""
    recording = load_recording(path)
    free, held = (
        compare(record, each, recording) for record, each in zip(found.records, (found.free, found.held), strict=True)
    )
    return replace(found, heard=(free, held))


# ---- The picture ----------------------------------------------------------------------------------------------------


def check_picture(path: str) -> None:
    """Raises HapticdError (one line) where a picture cannot be drawn, or not one with that ending."""
    require_matplotlib("a plot", "fit")
    from matplotlib.backend_bases import FigureCanvasBase

    known = sorted(FigureCanvasBase.get_supported_filetypes())
    ending = _picture_ending(path)
    if ending not in known:
        raise HapticdError(f"{path}: cannot be drawn: must end in .png or another of {', '.join(known)}")


def picture(found: Calibration, path: str) -> bytes:
    """The response as measured and as fitted, magnitude above phase; of the kind that the ending of `path` says."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 7), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for color, (name, _, fitted, heard) in zip(("C0", "C1"), found.curves(), strict=True):
        measured = _measured(fitted, heard)
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
