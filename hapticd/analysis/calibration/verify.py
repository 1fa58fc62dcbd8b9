"""What `hapticd verify` does: strikes each mode of the library, and lays the handle's acceleration beside it.

Of the simulated joystick the acceleration is that of the handle itself: it is driven once more by the forces that were
commanded, at sixteen times the rate, and the differences of its exact velocities are means of its acceleration. The
library's waveform is taken as means over the same times. A link delays the force and changes none of its shape: the
onset is when the force begins at the actuator.

Of a recording the acceleration is what it holds; the whole sequence is found in it by cross-correlation, and each onset
where the error is least, within 3 ms of that.

Taps on a wall: the surface that is tapped acts on the handle while its tap rings. The forces of the tap are those that
`hapticd.render` gives for a probe that comes onto a wall of the material at the speed, and is at rest there. Under them
the simulated joystick moves; at each tick the wall adds -K times the way that the handle has gone, held until the next.
Its acceleration is compared as of every strike: nothing of how the forces were chosen is used
(hapticd.rendering.compensation knows the wall, too).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hapticd.analysis.calibration.accelerometer import Recording, offset_of
from hapticd.analysis.calibration.rig import on_grid, rig_of
from hapticd.analysis.calibration.sweep import Axis, Floats
from hapticd.base.core import ffi, lib, pointer
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, Link, Sim
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.scene import Scene, Wall
from hapticd.config.texture import Grooves
from hapticd.rendering.compensation import ERROR_BAND_LOW_HZ, ERROR_BAND_RATE_FRACTION
from hapticd.rendering.device_output import Output, output_of
from hapticd.rendering.displayability import displayed_mode
from hapticd.rendering.displayed_error import PARTS_PER_PERIOD, band_error, band_lines, waveform
from hapticd.rendering.joystick import new_sim
from hapticd.rendering.offline import Samples, render

SPEED_M_PER_S: Final = 0.1
PRESS_N: Final = 1.0
REST_S: Final = 0.3
"""Between two strikes, once five decay times are over."""
AFTER_S: Final = 0.06
"""Looked at in a recording beyond five decay times: what compensation may still do there, and what the hand makes of
it. Longer would be more of the sensor's noise."""
SETTLED_S: Final = 0.25
"""The same of the simulated handle, until hand and handle are at rest; less than from one strike to the next."""
AT_TICK: Final = 2.0**-20
"""So much of a period an onset at a tick lies before it: an onset is a crossing."""


@dataclass(frozen=True, slots=True)
class Strike:
    """What is struck: a use of a material, and the coefficient that the library gives it."""

    material: str
    use: str
    mode: Mode
    coefficient_m_per_s2: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a strike was displayed."""

    strike: Strike
    displayed_hz: float | None
    """None: silent, the rate cannot carry it."""
    force_n: float
    """The largest that was commanded."""
    error: float
    """RMS of the difference over RMS of the library's waveform, in the band; 1 where nothing is displayed."""
    strength: float
    """The part of the library's waveform in what was displayed: 1 where all is well, less where it was held back."""

    def to_dict(self) -> dict[str, object]:
        return {
            "material": self.strike.material,
            "use": self.strike.use,
            "frequency_hz": self.strike.mode.frequency_hz,
            "amplitude_m_per_s2": self.strike.coefficient_m_per_s2,
            "displayed_hz": self.displayed_hz,
            "force_n": self.force_n,
            "error": self.error,
            "strength": self.strength,
        }


def strikes_of(materials: Mapping[str, Material], speed_m_per_s: float = SPEED_M_PER_S) -> list[Strike]:
    """What the materials ring with: taps and grooves at this speed, grooves pressed with 1 N, ruptures."""
    found = []
    for name, material in materials.items():
        for strike in _of_tap(name, material, speed_m_per_s):
            found.append(replace(strike, coefficient_m_per_s2=abs(strike.coefficient_m_per_s2)))
        rupture, texture = material.rupture, material.texture
        if isinstance(texture, Grooves) and (groove := material.groove_mode_at(speed_m_per_s, PRESS_N)) is not None:
            amplitude = texture.velocity_gain_per_s * speed_m_per_s + texture.force_gain_m_per_s2_per_n * PRESS_N
            found.append(Strike(name, "groove", groove, amplitude))
        if rupture is not None and rupture.amplitude_m_per_s2 > 0:
            found.append(Strike(name, "rupture", rupture.mode, rupture.amplitude_m_per_s2))
    return found


def _of_tap(name: str, material: Material, speed_m_per_s: float) -> list[Strike]:
    """A tap's mode, and the second one that it strikes, of either sign; none of a tap that does not ring."""
    tap = material.tap
    if tap is None or tap.ringing is None or not (amplitude := tap.amplitude_m_per_s2(speed_m_per_s)) > 0:
        return []
    mode = tap.mode_at(speed_m_per_s)
    coefficient = mode.coefficient(amplitude, tap.attack)
    found = [Strike(name, "tap", mode, coefficient)]
    if tap.second is not None and tap.second.ratio != 0:
        found.append(Strike(name, "second", tap.second.mode, tap.second.ratio * coefficient))
    return found


@dataclass(frozen=True, slots=True)
class Played:
    """A sequence of strikes: what the servo rendered."""

    rate_hz: float
    output: Output
    strikes: tuple[Strike, ...]
    begins: tuple[int, ...]
    """Of each strike, the period of its first tick since the first sample; -1 where it is silent."""
    force_n: Floats
    """(n, 2) the command at each period."""
    along: int


def play(config: Config, strikes: list[Strike], axis: Axis) -> Played:
    """Strikes them one after the other, alone in an empty scene. Raises HapticdError."""
    alone = config.model_copy(update={"scene": Scene()})
    along = 0 if axis == "x" else 1
    taken: list[Samples] = []
    ticks: list[int | None] = []
    with rig_of(alone) as rig:
        output = rig.output
        taken.append(rig.run(REST_S))
        for strike in strikes:
            ticks.append(None)
            if displayed_mode(strike.mode, output)[0] is not None:
                direction = (1.0, 0.0) if along == 0 else (0.0, 1.0)
                ticks[-1] = rig.strike(strike.mode, strike.coefficient_m_per_s2, direction)
                taken.append(rig.run(5.0 / strike.mode.decay_rate_per_s + AFTER_S + REST_S))
    samples = np.concatenate(taken)
    place, holding = on_grid(samples, rig.rate_hz)
    force = np.ascontiguousarray(samples["force_n"][holding], dtype=np.float64)
    first = int(samples["tick"][0])
    begins = [-1 if tick is None else int(place[tick - first]) for tick in ticks]
    return Played(rig.rate_hz, output, tuple(strikes), tuple(begins), force, along)


def from_simulation(config: Config, played: Played) -> list[Verdict]:
    """Of the simulated handle."""
    rate_hz = played.rate_hz * PARTS_PER_PERIOD
    sim = new_sim(config.device.sim, rate_hz)
    force = np.repeat(played.force_n, PARTS_PER_PERIOD, axis=0)
    motion = np.empty((len(force), 4))
    lib.hd_sim_drive(sim, pointer("double[]", force), len(force), pointer("double[]", motion))
    acceleration = np.diff(motion[:, 2 + played.along]) * rate_hz

    def measured(strike: Strike, begin: int) -> tuple[float, float]:
        onset = arrival(config.device.sim.link, begin, played.rate_hz)
        count = round((5.0 / strike.mode.decay_rate_per_s + SETTLED_S) * rate_hz)
        return _compared(acceleration[onset : onset + count], strike, rate_hz, played)

    return _verdicts(played, measured)


def from_recording(played: Played, recording: Recording) -> list[Verdict]:
    """Of what an accelerometer heard. Raises HapticdError where the sequence is not in it."""
    rate_hz = recording.rate_hz
    expected = np.zeros(len(played.force_n))
    for strike, begin in zip(played.strikes, played.begins, strict=True):
        if begin >= 0:
            shown, factor = displayed_mode(strike.mode, played.output)
            assert shown is not None
            count = min(round(5.0 / shown.decay_rate_per_s * played.rate_hz), len(expected) - begin)
            ringing = waveform(shown, count, played.rate_hz)
            expected[begin : begin + count] += strike.coefficient_m_per_s2 * factor * ringing
    if not expected.any():
        raise HapticdError("nothing of the library is displayed at this rate, so there is nothing to verify")
    begin_s = offset_of(recording, expected, played.rate_hz)
    from scipy.optimize import minimize_scalar

    def measured(strike: Strike, begin: int) -> tuple[float, float]:
        count = round((5.0 / strike.mode.decay_rate_per_s + AFTER_S) * rate_hz)
        times = begin_s + begin / played.rate_hz + (np.arange(count) + 0.5) / rate_hz

        def error_at(shift_s: float) -> float:
            return _compared(recording.at(times + shift_s), strike, rate_hz, played)[0]

        period_s = 1.0 / strike.mode.frequency_hz
        step = min(period_s / 12, 0.0003)
        near = min(np.arange(-0.003, 0.003 + step / 2, step).tolist(), key=error_at)
        around = (near - step, near + step)
        best = minimize_scalar(error_at, bounds=around, method="bounded", options={"xatol": 1e-3 * period_s}).x
        return _compared(recording.at(times + best), strike, rate_hz, played)

    return _verdicts(played, measured)


def arrival(link: Link | None, begin: int, rate_hz: float) -> int:
    """When the force of a tick begins at the actuator, in 1/PARTS_PER_PERIOD of a period: it waits for
    its frame."""
    onset = begin * PARTS_PER_PERIOD
    if link is None:
        return onset
    frame = rate_hz * PARTS_PER_PERIOD / link.rate_hz
    return round((math.floor(onset / frame * (1 + 1e-12)) + link.delay_frames) * frame)


def _compared(measured: Floats, strike: Strike, rate_hz: float, played: Played) -> tuple[float, float]:
    reference = strike.coefficient_m_per_s2 * waveform(strike.mode, len(measured), rate_hz)
    return compared(measured, reference, rate_hz, played.output)


def compared(measured: Floats, reference: Floats, rate_hz: float, output: Output) -> tuple[float, float]:
    """Error and strength of an acceleration, (n,) at rate_hz from the onset, against the library's."""
    high_hz = ERROR_BAND_RATE_FRACTION * min(output.rate_hz, rate_hz)
    error = band_error(measured, reference, rate_hz, ERROR_BAND_LOW_HZ, high_hz)
    one, other = (band_lines(each, rate_hz, ERROR_BAND_LOW_HZ, high_hz) for each in (measured, reference))
    return error, float(np.vdot(other, one).real / np.vdot(other, other).real)


def _verdicts(played: Played, measured: Callable[[Strike, int], tuple[float, float]]) -> list[Verdict]:
    found = []
    for strike, begin in zip(played.strikes, played.begins, strict=True):
        if begin < 0:
            found.append(Verdict(strike, None, 0.0, 1.0, 0.0))
            continue
        shown, _ = displayed_mode(strike.mode, played.output)
        assert shown is not None
        last = begin + round((5.0 / strike.mode.decay_rate_per_s + AFTER_S) * played.rate_hz)
        force = float(np.abs(played.force_n[begin:last, played.along]).max())
        error, strength = measured(strike, begin)
        found.append(Verdict(strike, shown.frequency_hz, force, error, strength))
    return found


# ---- Taps on walls --------------------------------------------------------------------------------------------------


def verdicts_on_walls(config: Config, speed_m_per_s: float = SPEED_M_PER_S, axis: Axis = "y") -> list[Verdict]:
    """How the simulated joystick displays the taps of the materials, each on a separate wall."""
    output = output_of(config, config.servo.rate_hz)
    return [
        _on_wall(config, output, strikes, speed_m_per_s, axis)
        for name, material in config.materials.items()
        if material.stiffness_n_per_m > 0 and (strikes := _of_tap(name, material, speed_m_per_s))
    ]


def tap_force(
    config: Config, material: str, speed_m_per_s: float, count: int, *, axis: Axis = "y", part: float = AT_TICK
) -> Floats:
    """What a tap on a wall of a material adds to the force, (count, 2) in N, at ticks of the configuration's rate.

    The wall's normal is `axis`, and the onset `part` of a period before the first of the ticks.
    """
    along = (1.0, 0.0) if axis == "x" else (0.0, 1.0)
    wall = Wall(kind="wall", point_m=(0.0, 0.0), normal=along, material=material)
    alone = config.model_copy(update={"scene": Scene(objects={"wall": wall})})
    step_m = speed_m_per_s / config.servo.rate_hz
    path = np.full(count + 1, -part * step_m)
    path[0] = (1.0 - part) * step_m
    speeds = np.zeros(count + 1)
    speeds[:2] = -speed_m_per_s
    samples = render(alone, np.outer(path, along), velocity_m_per_s=np.outer(speeds, along))
    force: Floats = np.asarray(samples["vibration_force_n"][1:], dtype=np.float64)
    return force


def acceleration_on(sim: Sim, force_n: Floats, rate_hz: float, stiffness_n_per_m: float, axis: Axis = "y") -> Floats:
    """Acceleration of the simulated handle, (n * PARTS_PER_PERIOD, 2) in m/s^2, as means over equal parts of a period.

    Forces (n, 2) are held for 1/rate_hz each; the wall's normal is `axis`, and its stiffness acts to both sides of
    where the handle was at rest. What the servo would read of the handle (steps, age) does not matter.
    """
    joystick = new_sim(sim, rate_hz * PARTS_PER_PERIOD)
    along = 0 if axis == "x" else 1
    now, unused = (ffi.new("double[2]") for _ in range(2))
    held = np.empty((PARTS_PER_PERIOD, 2))
    motion = np.empty((len(force_n), PARTS_PER_PERIOD, 4))
    for tick, force in enumerate(force_n):
        lib.hd_sim_truth(joystick, now, unused, unused)
        held[:] = force
        held[:, along] -= stiffness_n_per_m * (now[along] - sim.start_m[along])
        lib.hd_sim_drive(joystick, pointer("double[]", held), PARTS_PER_PERIOD, pointer("double[]", motion[tick]))
    lib.hd_sim_truth(joystick, unused, now, unused)
    speeds = np.concatenate((motion[:, :, 2:].reshape(-1, 2), [list(now)]))
    acceleration: Floats = np.diff(speeds, axis=0) * (rate_hz * PARTS_PER_PERIOD)
    return acceleration


def _on_wall(config: Config, output: Output, strikes: list[Strike], speed_m_per_s: float, axis: Axis) -> Verdict:
    """`strikes`: the tap's mode, and the second one that it strikes."""
    first = replace(strikes[0], use="wall")
    shown, _ = displayed_mode(first.mode, output)
    if shown is None:
        return Verdict(first, None, 0.0, 1.0, 0.0)
    rate_hz, material = config.servo.rate_hz, config.materials[first.material]
    lasting_s = max(5.0 / strike.mode.decay_rate_per_s for strike in strikes) + SETTLED_S
    force = tap_force(config, first.material, speed_m_per_s, round(lasting_s * rate_hz), axis=axis)
    moved = acceleration_on(config.device.sim, force, rate_hz, material.stiffness_n_per_m, axis)
    onset = arrival(config.device.sim.link, 0, rate_hz)
    count = len(moved) - onset
    reference = sum(
        each.coefficient_m_per_s2 * waveform(each.mode, count, rate_hz * PARTS_PER_PERIOD) for each in strikes
    )
    assert material.tap is not None
    # A tap pushes along the wall's normal n, its tangent (n_y, -n_x), or between.
    across, along = material.tap.aim
    towards = (across, -along) if axis == "x" else (along, across)
    error, strength = compared(
        moved[onset:] @ np.array(towards), np.asarray(reference), rate_hz * PARTS_PER_PERIOD, output
    )
    return Verdict(first, shown.frequency_hz, float(np.hypot(*force.T).max()), error, strength)
