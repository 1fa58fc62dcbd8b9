"""What `hapticd verify` says of taps on a wall: the surface that is tapped acts on the handle while its tap rings.

The forces of the tap are those that `hapticd.render` gives for a probe that comes onto a wall of the material at the
speed, and is at rest there. Under them the simulated joystick moves; at each tick the wall adds -K times the way that
the handle has gone, held until the next. Its acceleration is compared with the library's waveform, as of every strike:
nothing of how the forces were chosen is used (hapticd.rendering.compensation knows the wall, too).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hapticd.analysis.calibration.sweep import Axis, Floats
from hapticd.analysis.calibration.verify import SETTLED_S, SPEED_M_PER_S, Strike, Verdict, arrival, compared
from hapticd.base.core import ffi, lib, pointer
from hapticd.config.configuration import Config, Sim
from hapticd.config.materials import Material
from hapticd.config.scene import Scene, Wall
from hapticd.rendering.device_output import Output, output_of
from hapticd.rendering.displayability import displayed_mode
from hapticd.rendering.displayed_error import FINER, waveform
from hapticd.rendering.joystick import new_sim
from hapticd.rendering.offline import render

AT_TICK: Final = 2.0**-20
"""So much of a period an onset at a tick lies before it: an onset is a crossing."""


def walls_of(config: Config) -> list[str]:
    """The materials that have a tap which rings, and push."""
    return [name for name, each in config.materials.items() if _rings(each) and each.stiffness_n_per_m > 0]


def _rings(material: Material) -> bool:
    return material.tap is not None and material.tap.ringing is not None


def verdicts_on_walls(config: Config, speed_m_per_s: float = SPEED_M_PER_S, axis: Axis = "y") -> list[Verdict]:
    """How the simulated joystick displays the taps of the materials, each on a separate wall."""
    rate_hz = config.servo.rate_hz
    output = output_of(config, rate_hz)
    found = []
    for name in walls_of(config):
        material = config.materials[name]
        tap = material.tap
        assert tap is not None
        amplitude = tap.amplitude_m_per_s2(speed_m_per_s)
        if not amplitude > 0:
            continue
        mode = tap.mode_at(speed_m_per_s)
        coefficient = mode.coefficient(amplitude, tap.attack)
        strikes = [Strike(name, "wall", mode, coefficient)]
        if tap.second is not None and tap.second.ratio != 0:
            strikes.append(Strike(name, "wall", tap.second.mode, tap.second.ratio * coefficient))
        found.append(_on_wall(config, output, strikes, speed_m_per_s, axis))
    return found


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


def acceleration_on(
    sim: Sim, force_n: Floats, rate_hz: float, stiffness_n_per_m: float, axis: Axis = "y", finer: int = FINER
) -> Floats:
    """Acceleration of the simulated handle, (n * finer, 2) in m/s^2, as means over equal parts of a period.

    Forces (n, 2) are held for 1/rate_hz each; the wall's normal is `axis`, and its stiffness acts to both sides of
    where the handle was at rest. What the servo would read of the handle (steps, age) does not matter.
    """
    joystick = new_sim(sim, rate_hz * finer)
    along = 0 if axis == "x" else 1
    now, unused = (ffi.new("double[2]") for _ in range(2))
    held = np.empty((finer, 2))
    motion = np.empty((len(force_n), finer, 4))
    for tick, force in enumerate(force_n):
        lib.hd_sim_truth(joystick, now, unused, unused)
        held[:] = force
        held[:, along] -= stiffness_n_per_m * (now[along] - sim.start_m[along])
        lib.hd_sim_drive(joystick, pointer("double[]", held), finer, pointer("double[]", motion[tick]))
    lib.hd_sim_truth(joystick, unused, now, unused)
    speeds = np.concatenate((motion[:, :, 2:].reshape(-1, 2), [list(now)]))
    acceleration: Floats = np.diff(speeds, axis=0) * (rate_hz * finer)
    return acceleration


def _on_wall(config: Config, output: Output, strikes: list[Strike], speed_m_per_s: float, axis: Axis) -> Verdict:
    """`strikes`: the tap's mode, and the second one that it strikes."""
    first = strikes[0]
    shown, _ = displayed_mode(first.mode, output)
    if shown is None:
        return Verdict(first, None, 0.0, 1.0, 0.0)
    rate_hz = config.servo.rate_hz
    lasting_s = max(5.0 / strike.mode.decay_rate_per_s for strike in strikes) + SETTLED_S
    force = tap_force(config, first.material, speed_m_per_s, round(lasting_s * rate_hz), axis=axis)
    stiffness = config.materials[first.material].stiffness_n_per_m
    moved = acceleration_on(config.device.sim, force, rate_hz, stiffness, axis)
    onset = arrival(config.device.sim.link, 0, rate_hz)
    count = len(moved) - onset
    reference = sum(each.coefficient_m_per_s2 * waveform(each.mode, count, rate_hz * FINER) for each in strikes)
    tap = config.materials[first.material].tap
    assert tap is not None
    # A tap pushes along the wall's normal n, its tangent (n_y, -n_x), or between.
    across, along = tap.aim
    towards = (across, -along) if axis == "x" else (along, across)
    shown_as = moved[onset:] @ np.array(towards)
    error, strength = compared(shown_as, np.asarray(reference), rate_hz * FINER, output)
    return Verdict(first, shown.frequency_hz, float(np.hypot(*force.T).max()), error, strength)
