"""`hapticd verify`: strike each mode of the library, and compare the handle's acceleration with the library's waveform.

The commanded forces drive the simulated handle again, at PARTS_PER_PERIOD times the rate. Differences of its exact
velocities are means of its acceleration; the library's waveform is averaged over the same times. A link delays the
force without changing its shape, so the waveform is delayed, too. A link that is slower than the servo samples a strike
at any time within a frame: the forces are sent at up to MAX_LINK_PHASES times within a frame, and the error is the RMS
over them.

In an accelerometer's recording, cross-correlation finds the sequence of strikes. Each onset is then the time within
3 ms of the expected one at which the error is smallest.

Taps on a wall: the tapped surface acts on the handle while the tap rings. The forces of the tap are those that
`hapticd.render` returns for a probe that meets a wall of the material at the given speed and then rests there. They
drive the simulated joystick; at each tick the wall adds -K times the displacement of the handle, held until the next
tick. The comparison is the same as for other strikes, and independent of how the forces were chosen
(hapticd.rendering.compensation also accounts for the wall).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hapticd.analysis.calibration.accelerometer import Recording, offset_of
from hapticd.analysis.calibration.rig import on_grid, rig_of
from hapticd.analysis.calibration.sweep import Axis
from hapticd.analysis.statistics import Floats
from hapticd.base.core import ffi, lib, pointer
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, Link, Sim
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.scene import Scene, Wall
from hapticd.config.texture import Grooves
from hapticd.rendering.compensation import ERROR_BAND_LOW_HZ, ERROR_BAND_RATE_FRACTION, root_mean_square
from hapticd.rendering.device_output import Output, output_of
from hapticd.rendering.displayability import displayed_mode
from hapticd.rendering.displayed_error import PARTS_PER_PERIOD, band_error, band_lines, waveform
from hapticd.rendering.joystick import new_sim
from hapticd.rendering.offline import Samples, render

DEFAULT_TAP_SPEED_M_PER_S: Final = 0.1
"""Speed of taps and of strokes over grooves, without --speed."""
GROOVE_NORMAL_FORCE_N: Final = 1.0
"""Normal force of a stroke over grooves."""
STRIKE_GAP_S: Final = 0.3
"""The next strike follows after five decay times, RECORDING_TAIL_S and this time."""
RECORDING_TAIL_S: Final = 0.06
"""Time beyond five decay times that is compared in a recording. It includes the end of the compensation and the hand's
response; a longer time would add noise of the sensor."""
SIMULATION_TAIL_S: Final = 0.25
"""Time beyond five decay times that is compared in a simulation, until hand and handle are at rest. It is shorter than
the pause between two strikes."""
DEEP_TAP_TIMES: Final = 2.0
"""Time for which a tap on a wall keeps its speed, over the inverse of the angular frequency of handle and wall."""
MAX_LINK_PHASES: Final = 10
"""Number of onsets within a frame of a link that is slower than the servo; one a tick in a shorter frame."""
ONSET_LEAD_PERIODS: Final = 2.0**-20
"""Time from an onset to the next tick, in periods. Above 0, so that the probe is inside the surface at the tick."""


@dataclass(frozen=True, slots=True)
class Strike:
    """A mode to strike, with its coefficient, as a material of the library uses it."""

    material: str
    use: str
    """tap, second, groove, rupture, or wall for a tap on a wall."""
    mode: Mode
    coefficient_m_per_s2: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Error and strength of a displayed strike, compared with the library's waveform."""

    strike: Strike
    displayed_hz: float | None
    """Displayed frequency; None if the mode is muted because its frequency is too high for the rate."""
    force_n: float
    """Largest commanded force."""
    error: float
    """RMS of the difference divided by the RMS of the library's waveform, in the error band; 1 if the mode is muted.
    Through a link that is slower than the servo it is the RMS over the onsets within a frame."""
    strength: float
    """Displayed amplitude over that of the library, by projection on the waveform: 1 is ideal, less is too weak."""

    def to_dict(self) -> dict[str, object]:
        """Return the comparison as JSON."""
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


def strikes_of(materials: Mapping[str, Material], speed_m_per_s: float = DEFAULT_TAP_SPEED_M_PER_S) -> list[Strike]:
    """Return the strikes of materials: taps and grooves at `speed_m_per_s` (grooves pressed with 1 N), and ruptures."""
    found = []
    for name, material in materials.items():
        for strike in _tap_strikes(name, material, speed_m_per_s):
            found.append(replace(strike, coefficient_m_per_s2=abs(strike.coefficient_m_per_s2)))
        rupture, texture = material.rupture, material.texture
        if (
            isinstance(texture, Grooves)
            and (groove := material.groove_mode_at(speed_m_per_s, GROOVE_NORMAL_FORCE_N)) is not None
        ):
            amplitude = (
                texture.velocity_gain_per_s * speed_m_per_s + texture.force_gain_m_per_s2_per_n * GROOVE_NORMAL_FORCE_N
            )
            found.append(Strike(name, "groove", groove, amplitude))
        if rupture is not None and rupture.amplitude_m_per_s2 > 0:
            found.append(Strike(name, "rupture", rupture.mode, rupture.amplitude_m_per_s2))
    return found


def _tap_strikes(name: str, material: Material, speed_m_per_s: float) -> list[Strike]:
    """Return a strike for each mode of a material's tap, none to two. The second coefficient may be negative."""
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
    """A rendered sequence of strikes."""

    rate_hz: float
    output: Output
    strikes: tuple[Strike, ...]
    begins: tuple[int, ...]
    """Period of each strike's first tick, counted from the first sample; -1 if the strike is silent."""
    force_n: Floats
    """Commanded force (n, 2) at each period."""
    along: int
    """Index of the axis of the strikes."""


def play(config: Config, strikes: list[Strike], axis: Axis) -> Played:
    """Strike modes one after the other in an empty scene. Raises HapticdError if the device cannot be driven."""
    alone = config.model_copy(update={"scene": Scene()})
    along = 0 if axis == "x" else 1
    taken: list[Samples] = []
    ticks: list[int | None] = []
    with rig_of(alone) as rig:
        output = rig.output
        taken.append(rig.run(STRIKE_GAP_S))
        for strike in strikes:
            ticks.append(None)
            if displayed_mode(strike.mode, output)[0] is not None:
                direction = (1.0, 0.0) if along == 0 else (0.0, 1.0)
                ticks[-1] = rig.strike(strike.mode, strike.coefficient_m_per_s2, direction)
                taken.append(rig.run(5.0 / strike.mode.decay_rate_per_s + RECORDING_TAIL_S + STRIKE_GAP_S))
    samples = np.concatenate(taken)
    place, holding = on_grid(samples, rig.rate_hz)
    force = np.ascontiguousarray(samples["force_n"][holding], dtype=np.float64)
    first = int(samples["tick"][0])
    begins = [-1 if tick is None else int(place[tick - first]) for tick in ticks]
    return Played(rig.rate_hz, output, tuple(strikes), tuple(begins), force, along)


def from_simulation(config: Config, played: Played) -> list[Comparison]:
    """Compare the simulated handle's acceleration under the commanded forces with the library."""
    rate_hz, link = played.rate_hz * PARTS_PER_PERIOD, config.device.sim.link
    waits = waiting_ticks(link, played.rate_hz)
    accelerations = [_driven(config.device.sim, played, wait, rate_hz) for wait in waits]

    def measured(strike: Strike, begin: int) -> tuple[float, float]:
        count = round((5.0 / strike.mode.decay_rate_per_s + SIMULATION_TAIL_S) * rate_hz)
        found = []
        for wait, acceleration in zip(waits, accelerations, strict=True):
            onset = arrival(link, wait + begin, played.rate_hz, strike.mode)
            found.append(_compared(acceleration[onset : onset + count], strike, rate_hz, played))
        return over_phases(found)

    return _comparisons(played, measured)


def _driven(sim: Sim, played: Played, wait: int, rate_hz: float) -> Floats:
    """Return the acceleration of the simulated handle under the forces, delayed by `wait` ticks, at `rate_hz`."""
    force = np.repeat(np.pad(played.force_n, ((wait, 0), (0, 0))), PARTS_PER_PERIOD, axis=0)
    motion = np.empty((len(force), 4))
    lib.hd_sim_drive(new_sim(sim, rate_hz), pointer("double[]", force), len(force), pointer("double[]", motion))
    acceleration: Floats = np.diff(motion[:, 2 + played.along]) * rate_hz
    return acceleration


def from_recording(played: Played, recording: Recording) -> list[Comparison]:
    """Compare a recorded acceleration with the library. Raises HapticdError if the recording lacks the strikes."""
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
        raise HapticdError("no mode of the library can be displayed at this rate: use a higher servo.rate_hz")
    begin_s = offset_of(recording, expected, played.rate_hz)
    from scipy.optimize import minimize_scalar

    def measured(strike: Strike, begin: int) -> tuple[float, float]:
        count = round((5.0 / strike.mode.decay_rate_per_s + RECORDING_TAIL_S) * rate_hz)
        times = begin_s + begin / played.rate_hz + (np.arange(count) + 0.5) / rate_hz

        def error_at(shift_s: float) -> float:
            return _compared(recording.at(times + shift_s), strike, rate_hz, played)[0]

        period_s = 1.0 / strike.mode.frequency_hz
        step = min(period_s / 12, 0.0003)
        near = min(np.arange(-0.003, 0.003 + step / 2, step).tolist(), key=error_at)
        around = (near - step, near + step)
        best = minimize_scalar(error_at, bounds=around, method="bounded", options={"xatol": 1e-3 * period_s}).x
        return _compared(recording.at(times + best), strike, rate_hz, played)

    return _comparisons(played, measured)


def waiting_ticks(link: Link | None, rate_hz: float) -> list[int]:
    """Return the delays of the forces, in ticks, for which a strike is compared: up to MAX_LINK_PHASES in a frame."""
    if link is None or link.rate_hz >= rate_hz:
        return [0]
    frame_ticks = rate_hz / link.rate_hz
    return sorted({math.floor(phase * frame_ticks / MAX_LINK_PHASES) for phase in range(MAX_LINK_PHASES)})


def arrival(link: Link | None, begin: int, rate_hz: float, mode: Mode) -> int:
    """Return the time at which a strike that begins at tick `begin` acts, in 1/PARTS_PER_PERIOD of a period.

    Over a link the force waits for the next frame, and for the link's delay. A link that is slower than the servo sends
    the force of the last tick before a frame. The time from tick to frame varies unless one rate is a multiple of the
    other; then its mean counts, weighted by the energy of the mode.
    """
    if link is None:
        return begin * PARTS_PER_PERIOD
    frame = rate_hz / link.rate_hz
    events = np.arange(math.ceil(5.0 / mode.decay_rate_per_s * min(rate_hz, link.rate_hz)), dtype=np.float64)
    if link.rate_hz >= rate_hz:
        ticks = begin + events
        waits = (np.floor(ticks / frame * (1 + 1e-12)) + 1) * frame - ticks
    else:
        frames = (math.floor(begin / frame * (1 + 1e-12)) + 1 + events) * frame
        waits = frames - (np.ceil(frames * (1 - 1e-12)) - 1)
    decay_per_event = mode.decay_rate_per_s / min(rate_hz, link.rate_hz)
    waited = float(np.average(waits, weights=np.exp(-2.0 * decay_per_event * events)))
    return round((begin + waited + (link.delay_frames - 1) * frame) * PARTS_PER_PERIOD)


def over_phases(compared: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the RMS of the errors and the mean of the strengths of a strike that began at several times in a frame."""
    errors, strengths = zip(*compared, strict=True)
    return root_mean_square(errors), sum(strengths) / len(strengths)


def _compared(measured: Floats, strike: Strike, rate_hz: float, played: Played) -> tuple[float, float]:
    reference = strike.coefficient_m_per_s2 * waveform(strike.mode, len(measured), rate_hz)
    return compared(measured, reference, rate_hz, played.output)


def compared(measured: Floats, reference: Floats, rate_hz: float, output: Output) -> tuple[float, float]:
    """Return error and strength (see Comparison) of an acceleration (n,) from the onset, relative to `reference`."""
    high_hz = ERROR_BAND_RATE_FRACTION * min(output.carried_hz, rate_hz)
    error = band_error(measured, reference, rate_hz, ERROR_BAND_LOW_HZ, high_hz)
    one, other = (band_lines(each, rate_hz, ERROR_BAND_LOW_HZ, high_hz) for each in (measured, reference))
    return error, float(np.vdot(other, one).real / np.vdot(other, other).real)


def _comparisons(played: Played, measured: Callable[[Strike, int], tuple[float, float]]) -> list[Comparison]:
    found = []
    for strike, begin in zip(played.strikes, played.begins, strict=True):
        if begin < 0:
            found.append(Comparison(strike, None, 0.0, 1.0, 0.0))
            continue
        shown, _ = displayed_mode(strike.mode, played.output)
        assert shown is not None
        last = begin + round((5.0 / strike.mode.decay_rate_per_s + RECORDING_TAIL_S) * played.rate_hz)
        force = float(np.abs(played.force_n[begin:last, played.along]).max())
        error, strength = measured(strike, begin)
        found.append(Comparison(strike, shown.frequency_hz, force, error, strength))
    return found


# ---- Taps on walls --------------------------------------------------------------------------------------------------


def compare_on_walls(
    config: Config, speed_m_per_s: float = DEFAULT_TAP_SPEED_M_PER_S, axis: Axis = "y"
) -> list[Comparison]:
    """Compare the taps of materials with the library, on walls of these materials, with the simulated joystick."""
    output = output_of(config, config.servo.rate_hz)
    return [
        _on_wall(config, output, strikes, speed_m_per_s, axis)
        for name, material in config.materials.items()
        if material.stiffness_n_per_m > 0 and (strikes := _tap_strikes(name, material, speed_m_per_s))
    ]


def tap_force(
    config: Config,
    material: str,
    speed_m_per_s: float,
    count: int,
    *,
    axis: Axis = "y",
    onset_periods: float = ONSET_LEAD_PERIODS,
) -> Floats:
    """Return the vibration force of a tap on a wall of a material, (count, 2) in N, at the configuration's ticks.

    The wall's normal is `axis`; the onset is `onset_periods` periods before the first tick. The probe keeps its speed
    until it is deeper than a hand could press it in, so that the compensation of the tap is not reduced.
    """
    along = (1.0, 0.0) if axis == "x" else (0.0, 1.0)
    wall = Wall(kind="wall", point_m=(0.0, 0.0), normal=along, material=material)
    alone = config.model_copy(update={"scene": Scene(objects={"wall": wall})})
    stiffness, mass = config.materials[material].stiffness_n_per_m, config.device.effective_mass_kg
    moving_s = 0.0 if stiffness == 0.0 else DEEP_TAP_TIMES * math.sqrt(mass / stiffness)
    moving = math.ceil(moving_s * config.servo.rate_hz)
    step_m = speed_m_per_s / config.servo.rate_hz
    path = -step_m * (np.minimum(np.arange(count + 1) - 1.0, moving) + onset_periods)
    speeds = np.where(np.arange(count + 1) <= moving + 1, -speed_m_per_s, 0.0)
    samples = render(alone, np.outer(path, along), velocity_m_per_s=np.outer(speeds, along))
    force: Floats = np.asarray(samples["vibration_force_n"][1:], dtype=np.float64)
    return force


def acceleration_on(sim: Sim, force_n: Floats, rate_hz: float, stiffness_n_per_m: float, axis: Axis = "y") -> Floats:
    """Return the acceleration of the simulated handle on a wall, shape (n * PARTS_PER_PERIOD, 2), in m/s^2.

    Each row is a mean over 1/PARTS_PER_PERIOD of a period. Forces (n, 2) are held for 1/rate_hz each. The wall's normal
    is `axis`; its stiffness acts in both directions from the rest position. Encoder steps and the age of positions have
    no effect.
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


def _on_wall(config: Config, output: Output, strikes: list[Strike], speed_m_per_s: float, axis: Axis) -> Comparison:
    """Compare a tap on a wall with the library. `strikes` are those of the tap's one or two modes."""
    first = replace(strikes[0], use="wall")
    shown, _ = displayed_mode(first.mode, output)
    if shown is None:
        return Comparison(first, None, 0.0, 1.0, 0.0)
    rate_hz, material = config.servo.rate_hz, config.materials[first.material]
    lasting_s = max(5.0 / strike.mode.decay_rate_per_s for strike in strikes) + SIMULATION_TAIL_S
    force = tap_force(config, first.material, speed_m_per_s, round(lasting_s * rate_hz), axis=axis)
    assert material.tap is not None
    # A tap pushes along the wall's normal n, along its tangent (n_y, -n_x), or in a direction between them.
    across, along = material.tap.aim
    towards = (across, -along) if axis == "x" else (along, across)
    link, fine_hz, found = config.device.sim.link, rate_hz * PARTS_PER_PERIOD, []
    for wait in waiting_ticks(link, rate_hz):
        waited = np.pad(force, ((wait, 0), (0, 0)))
        moved = acceleration_on(config.device.sim, waited, rate_hz, material.stiffness_n_per_m, axis)
        moved = moved[arrival(link, wait, rate_hz, first.mode) :] @ np.array(towards)
        reference = sum(each.coefficient_m_per_s2 * waveform(each.mode, len(moved), fine_hz) for each in strikes)
        found.append(compared(moved, np.asarray(reference), fine_hz, output))
    error, strength = over_phases(found)
    return Comparison(first, shown.frequency_hz, float(np.hypot(*force.T).max()), error, strength)
