"""Whether a texture keeps a light hand moving along the surface after the hand has stopped.

A strike acts along the motion and grows with speed and force, so each groove adds energy. If the hand dissipates less,
it keeps moving from groove to groove. Noise grows with speed, too: with a large gain it moves the hand, whose motion
sustains the noise. As there is no closed form, the check runs the servo's tick with the simulated joystick, in a few
milliseconds per run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np

from hapticd.base.core import EventKind
from hapticd.base.errors import Problem
from hapticd.config.configuration import Config, Hand, Sim
from hapticd.config.materials import Material
from hapticd.config.scene import Scene, Wall
from hapticd.config.texture import Grooves
from hapticd.rendering.offline import Run, simulate_run
from hapticd.rendering.stability import Loop

CHECKED_SPEEDS_M_PER_S: Final = (0.05, 0.1, 0.2, 0.5)
"""Speeds of the simulated strokes: slow to fast exploration."""
CHECKED_FORCES_N: Final = (0.3, 1.0)
"""Forces with which the hand presses in the simulated strokes: a light and a firm touch."""
CHECKED_DAMPING_PART: Final = 0.8
"""Fraction of the hand's damping that is simulated. The rest is a margin, as other motions may drive the hand more."""
_STROKE_LENGTH_M: Final = 0.02
"""Length of a simulated stroke, over several grooves of usual spacing."""
_MAX_PRESS_DEPTH_M: Final = 0.4
"""Largest depth of the hand's reference below the surface; a softer surface is pressed with less force."""
_MAX_SETTLING_S: Final = 20.0
"""Longest time that the hand gets to settle after a stroke."""
_OBSERVED_END_S: Final = 1.0
"""Time at the end of a run in which strikes are counted and noise is measured."""
_MAX_RESIDUAL_NOISE_PART: Final = 0.05
"""Noise counts as sustained by the hand if its force at the end exceeds this fraction of its largest value."""


def driven_hand_warnings(config: Config, loop: Loop, shown: Mapping[str, Material]) -> list[Problem]:
    """Return a warning for each of the materials whose texture drives the hand of `loop` in typical strokes.

    The list is empty if the loop has no hand, as nothing presses then, or if vibrations are off.
    """
    hand = loop.dynamics
    if hand.grip_stiffness_n_per_m <= 0.0 or not config.scene.display.vibration:
        return []
    found = []
    for name in materials_with_vibration(shown):
        runs = (
            _run(config, loop, name, speed, press) for speed in CHECKED_SPEEDS_M_PER_S for press in CHECKED_FORCES_N
        )
        if isinstance(shown[name].texture, Grooves):
            count = max(map(_late_strikes, runs))
            drives = f"strikes drive this hand over the grooves after it has stopped, {count} strikes a second"
        else:
            count = sum(map(_is_noise_sustained, runs))
            drives = "noise drives this hand along the surface after it has stopped"
        if count > 0:
            less = "a firmer grip (more damping), dry friction, or a lower gain of the texture stops it"
            found.append(Problem(f"materials.{name}.texture", f"its {drives}; {less}"))
    return found


def materials_with_vibration(shown: Mapping[str, Material]) -> Iterable[str]:
    """Yield the names of the materials that have noise, or grooves that are displayed as strikes."""
    for name, material in shown.items():
        texture = material.texture
        if texture is not None and (not isinstance(texture, Grooves) or texture.display == "vibration"):
            yield name


def _late_strikes(run: Run) -> int:
    """Return the number of strikes in the last second of a simulated stroke."""
    last_s = len(run.samples) / run.rate_hz - _OBSERVED_END_S
    return int((run.events[run.events["kind"] == EventKind.GROOVE]["time_ns"] * 1e-9 > last_s).sum())


def _is_noise_sustained(run: Run) -> bool:
    """Return whether noise lasts into the last second of a simulated stroke."""
    force = np.abs(run.samples["vibration_force_n"][:, 0])
    late = force[-round(_OBSERVED_END_S * run.rate_hz) :]
    return bool(late.max() > _MAX_RESIDUAL_NOISE_PART * force.max())


def _run(config: Config, loop: Loop, name: str, speed: float, press: float) -> Run:
    """Simulate a stroke: the hand presses, moves along the surface, stops, and settles before the last second."""
    hand = loop.dynamics
    stiffness = hand.grip_stiffness_n_per_m
    deep = min(_MAX_PRESS_DEPTH_M, press / stiffness + press / max(config.materials[name].stiffness_n_per_m, 1e-3))
    moved = [[0.0, 0.0, 0.001], [0.3, 0.0, -deep], [0.3 + _STROKE_LENGTH_M / speed, _STROKE_LENGTH_M, -deep]]
    # A free oscillation falls to 1/1000 within 14 m / b.
    rest_s = 14.0 * hand.mass_kg / max(hand.damping_n_s_per_m, 1e-9)
    lasting_s = moved[-1][0] + min(_MAX_SETTLING_S, 1.0 + rest_s) + _OBSERVED_END_S
    return simulate_run(_floor_config(config, loop, name, 2.0 * deep + 0.1), moved, lasting_s, check_stability=False)


def _floor_config(config: Config, loop: Loop, name: str, workspace_m: float) -> Config:
    """Return a configuration with a floor of the named material, and the device and hand of `loop`."""
    hand = loop.dynamics
    sim = Sim(
        handle_mass_kg=hand.handle_mass_kg,
        handle_damping_n_s_per_m=hand.handle_damping_n_s_per_m,
        coulomb_friction_n=hand.friction_n,
        encoder_step_m=loop.encoder_step_m,
        force_step_n=loop.force_step_n,
        max_force_n=loop.max_force_n,
        report_delay_s=loop.timing.delay_s,
        workspace_m=min(1.0, workspace_m),
        start_m=(0.0, 0.001),
        hand=Hand(
            mass_kg=hand.grip_mass_kg,
            stiffness_n_per_m=hand.grip_stiffness_n_per_m,
            damping_n_s_per_m=CHECKED_DAMPING_PART * hand.grip_damping_n_s_per_m,
        ),
    )
    floor = Wall(kind="wall", point_m=(0.0, 0.0), normal=(0.0, 1.0), material=name)
    device = config.device.model_copy(update={"kind": "sim", "sim": sim})
    scene = Scene(display=config.scene.display, objects={"floor": floor})
    return config.model_copy(update={"device": device, "scene": scene})
