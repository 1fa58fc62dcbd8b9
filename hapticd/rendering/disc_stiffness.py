"""How stiff a disc is along its radius and around it, at most, as deep as a press reaches.

The proxy goes R/r as far as a probe at r from the centre, and what depends on it fades towards the centre
(docs/adr/0027). Where friction or grooves have a shape, the disc is as stiff as the second derivatives of

    K/2 (R - r - g H(s))^2 + g k/2 (s - anchor)^2

say, in polar coordinates. Without either it is never stiffer than K: around the centre it gives way.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Texture

Floats: TypeAlias = npt.NDArray[np.float64]

WHOLE: Final = 0.5
BARE: Final = 0.2
"""From so far out, in radii, all of it is there; so near to the centre nothing: csrc/shapes/hd_disc.c."""
_STEPS: Final = 65


class RoundProperties(NamedTuple):
    """Arrays (n,), N/m."""

    normal: Floats
    tangent: Floats
    spring: Floats
    """Of `tangent`, friction's own."""
    rubbed: Floats
    """What friction follows the normal force with."""


def fading(part: Floats) -> tuple[Floats, Floats, Floats]:
    """g at r/R, and its first and second derivative after r/R."""
    width = WHOLE - BARE
    x = np.clip((part - BARE) / width, 0.0, 1.0)
    within = (x > 0.0) & (x < 1.0)
    return (
        x * x * (3.0 - 2.0 * x),
        6.0 * x * (1.0 - x) / width,
        np.where(within, 6.0 - 12.0 * x, 0.0) / width**2,
    )


def round_properties(radius_m: Floats, materials: npt.NDArray[np.void], press_n: float) -> RoundProperties:
    """Of discs (n,) of these materials, MATERIAL_DTYPE (n,), pressed with up to press_n."""
    radius = radius_m[:, None]
    stiffness = materials["stiffness_n_per_m"][:, None]
    mu = materials["friction_coefficient"][:, None]
    spring = np.where(mu > 0.0, materials["friction_stiffness_n_per_m"][:, None], 0.0)
    grooved = (materials["texture"] == Texture.GEOMETRY)[:, None]
    height = np.where(grooved, materials["depth_m"][:, None], 0.0)
    turn = 2.0 * math.pi / np.where(grooved, materials["width_m"][:, None], 1.0)
    deepest = np.minimum(1.0, (press_n / np.maximum(stiffness, 1e-9) + height) / radius)
    part = np.maximum(1.0 - deepest * np.linspace(0.0, 1.0, _STEPS), 1e-3)
    pressed = np.minimum(press_n, stiffness * radius * (1.0 - part))
    g, rise, bend = fading(part)
    lever = g / part
    # Grooves: of R - r - g H, with H, H' and H'' at most these.
    slope = 0.5 * height * turn * lever
    steep = 1.0 + rise * height / radius
    curvature = 0.5 * height * turn**2 * lever / part
    leaning = np.abs(rise - lever) / (part * radius)
    # Friction: stretched by mu F_n / k at most.
    rubs = mu * pressed
    softness = np.where(spring > 0.0, rubs**2 / np.where(spring > 0.0, spring, 1.0), 0.0)
    cross = pressed * 0.5 * height * turn * leaning + rubs * leaning
    own = spring * lever / part
    normal = stiffness * (steep**2 + steep * slope) + np.abs(bend) / radius**2 * (pressed * height + 0.5 * softness)
    around = stiffness * (slope**2 + steep * slope) + pressed * curvature + 0.5 * rise * softness / (part * radius**2)
    normal, around = normal + cross, around + cross
    return RoundProperties(
        normal=normal.max(axis=1),
        tangent=(around + own).max(axis=1),
        spring=own.max(axis=1),
        rubbed=(mu * normal * lever).max(axis=1),
    )
