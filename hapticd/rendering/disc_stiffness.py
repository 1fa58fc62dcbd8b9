"""Upper bounds of a disc's radial and tangential stiffness, down to the depth of a given pressing force.

The proxy on the rim moves R/r as far as a probe at radius r, and friction and grooves fade out towards the centre
(docs/adr/0027). With friction or shaped grooves, the second derivatives, in polar coordinates, of

    K/2 (R - r - g H(s))^2 + g k/2 (s - anchor)^2

give the stiffness. K is that of the material, H the height of the grooves at the arc length s, k the stiffness of
friction's spring, and g the fading. Without friction and shaped grooves the stiffness never exceeds K.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Texture

Floats: TypeAlias = npt.NDArray[np.float64]

FULL_RADIUS_FRACTION: Final = 0.5
"""From this r/R on, friction and grooves act fully (csrc/shapes/hd_disc.c)."""
ZERO_RADIUS_FRACTION: Final = 0.2
"""Up to this r/R, friction and grooves do not act (csrc/shapes/hd_disc.c)."""
_RADIAL_SAMPLES: Final = 65
"""Number of radii, from the deepest press to the rim, at which the bounds are evaluated."""


class RoundProperties(NamedTuple):
    """Upper bounds of stiffness of discs; arrays (n,), N/m."""

    normal: Floats
    """Stiffness along the radius."""
    tangent: Floats
    """Stiffness around the disc."""
    spring: Floats
    """The stiffness of friction's spring, which is included in `tangent`."""
    friction_per_depth: Floats
    """Change of the friction force with the depth."""


def fading(part: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the fading g of friction and grooves at `part` = r/R, and its first and second derivatives by r/R."""
    width = FULL_RADIUS_FRACTION - ZERO_RADIUS_FRACTION
    x = np.clip((part - ZERO_RADIUS_FRACTION) / width, 0.0, 1.0)
    within = (x > 0.0) & (x < 1.0)
    return (
        x * x * (3.0 - 2.0 * x),
        6.0 * x * (1.0 - x) / width,
        np.where(within, 6.0 - 12.0 * x, 0.0) / width**2,
    )


def round_properties(radius_m: Floats, materials: npt.NDArray[np.void], press_n: float) -> RoundProperties:
    """Return the stiffness bounds of discs (n,) of these materials, MATERIAL_DTYPE (n,), pressed up to `press_n`."""
    radius = radius_m[:, None]
    stiffness = materials["stiffness_n_per_m"][:, None]
    mu = materials["friction_coefficient"][:, None]
    spring = np.where(mu > 0.0, materials["friction_stiffness_n_per_m"][:, None], 0.0)
    grooved = (materials["texture"] == Texture.GEOMETRY)[:, None]
    height = np.where(grooved, materials["depth_m"][:, None], 0.0)
    turn = 2.0 * math.pi / np.where(grooved, materials["width_m"][:, None], 1.0)
    deepest = np.minimum(1.0, (press_n / np.maximum(stiffness, 1e-9) + height) / radius)
    part = np.maximum(1.0 - deepest * np.linspace(0.0, 1.0, _RADIAL_SAMPLES), 1e-3)
    pressed = np.minimum(press_n, stiffness * radius * (1.0 - part))
    g, rise, bend = fading(part)
    lever = g / part
    # Grooves: bounds of the first and second derivatives of R - r - g H.
    slope = 0.5 * height * turn * lever
    steep = 1.0 + rise * height / radius
    curvature = 0.5 * height * turn**2 * lever / part
    leaning = np.abs(rise - lever) / (part * radius)
    # Friction: its spring is stretched by at most mu F_n / k.
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
        friction_per_depth=(mu * normal * lever).max(axis=1),
    )
