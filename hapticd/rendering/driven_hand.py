"""Whether a texture drives a light hand along the surface by itself, after the hand has stopped.

A strike acts along the motion and grows with speed and force, so that each groove gives energy. A hand that takes less
than that goes on from groove to groove by itself. Noise grows with speed, too: where its gain is large it moves the
hand that moves it. Spring, damper, friction, texture and the force limit have no closed form together: it is found with
the servo's own tick and the simulated joystick, in a few milliseconds a run.
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

SPEEDS_M_PER_S: Final = (0.05, 0.1, 0.2, 0.5)
PRESSES_N: Final = (0.3, 1.0)
LIGHTER: Final = 0.8
"""A hand is checked with this part of its damping: where it just stands another way of moving may set it off."""
_WAY_M: Final = 0.02
_DEEPEST_M: Final = 0.4
"""What gives way further than this is pressed with less."""
_LONGEST_S: Final = 20.0
_LOOKED_AT_S: Final = 1.0
_STILL: Final = 0.05
"""Noise that has not fallen to this part of its largest by then is kept up by the hand that it moves."""


def driven(config: Config, loop: Loop, shown: Mapping[str, Material]) -> list[Problem]:
    """A line for each of the materials whose texture drives the hand of `loop`, pressed and moved as people do.

    A handle without a hand has nothing that presses it, and is not checked; nor is anything where vibrations are off.
    """
    hand = loop.dynamics
    if hand.grip_stiffness_n_per_m <= 0.0 or not config.scene.display.vibration:
        return []
    found = []
    for name in sounding(shown):
        runs = (_run(config, loop, name, speed, press) for speed in SPEEDS_M_PER_S for press in PRESSES_N)
        if isinstance(shown[name].texture, Grooves):
            most = max(map(_strikes, runs))
            drives = f"strikes drive this hand over the grooves after it has stopped, {most} strikes a second"
        else:
            most = sum(map(_sounds, runs))
            drives = "noise drives this hand along the surface after it has stopped"
        if most > 0:
            less = "a firmer grip (more damping), dry friction, or a lower gain of the texture stops it"
            found.append(Problem(f"materials.{name}.texture", f"its {drives}; {less}"))
    return found


def sounding(shown: Mapping[str, Material]) -> Iterable[str]:
    """The materials that have grooves which strike, or noise."""
    for name, material in shown.items():
        texture = material.texture
        if texture is not None and (not isinstance(texture, Grooves) or texture.display == "vibration"):
            yield name


def _strikes(run: Run) -> int:
    """Strikes in the last second of a run."""
    last_s = len(run.samples) / run.rate_hz - _LOOKED_AT_S
    return int((run.events[run.events["kind"] == EventKind.GROOVE]["time_ns"] * 1e-9 > last_s).sum())


def _sounds(run: Run) -> bool:
    """Whether noise goes on in the last second of a run."""
    force = np.abs(run.samples["vibration_force_n"][:, 0])
    late = force[-round(_LOOKED_AT_S * run.rate_hz) :]
    return bool(late.max() > _STILL * force.max())


def _run(config: Config, loop: Loop, name: str, speed: float, press: float) -> Run:
    """The hand presses, moves along, stops, and has time to come to rest before the last second."""
    hand = loop.dynamics
    stiffness = hand.grip_stiffness_n_per_m
    deep = min(_DEEPEST_M, press / stiffness + press / max(config.materials[name].stiffness_n_per_m, 1e-3))
    moved = [[0.0, 0.0, 0.001], [0.3, 0.0, -deep], [0.3 + _WAY_M / speed, _WAY_M, -deep]]
    # By itself a swing falls to 1/1000 within 14 m / b.
    rest_s = 14.0 * hand.mass_kg / max(hand.damping_n_s_per_m, 1e-9)
    lasting_s = moved[-1][0] + min(_LONGEST_S, 1.0 + rest_s) + _LOOKED_AT_S
    return simulate_run(_alone(config, loop, name, 2.0 * deep + 0.1), moved, lasting_s, check_stability=False)


def _alone(config: Config, loop: Loop, name: str, workspace_m: float) -> Config:
    """The material as a floor, with the device and hand of the loop."""
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
            damping_n_s_per_m=LIGHTER * hand.grip_damping_n_s_per_m,
        ),
    )
    floor = Wall(kind="wall", point_m=(0.0, 0.0), normal=(0.0, 1.0), material=name)
    device = config.device.model_copy(update={"kind": "sim", "sim": sim})
    scene = Scene(display=config.scene.display, objects={"floor": floor})
    return config.model_copy(update={"device": device, "scene": scene})
