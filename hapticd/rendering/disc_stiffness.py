"""Upper bounds of a disc's radial and tangential stiffness, down to the depth of a given pressing force.

Shaped grooves: the proxy on the rim moves R/r as far as a probe at radius r, and the grooves fade out towards the
centre (docs/adr/0027). The second derivatives of K/2 (R - r - g H(s))^2, in polar coordinates, give the stiffness. K is
that of the material, H the height of the grooves at the arc length s, and g the fading. Without friction and shaped
grooves the stiffness never exceeds K.

Friction: its spring has the same stiffness at every depth, and turns with the surface (docs/adr/0062). While the probe
moves along the radius and around the disc at the same time, the turn adds up to mu F_n / (2 r) between the two
directions. A disc's stiffness around its centre is lower than the spring's by F_n / r, so an addition of mu^2 F_n /
(4 r) to the radial stiffness bounds it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Texture

Floats: TypeAlias = npt.NDArray[np.float64]

FULL_RADIUS_FRACTION: Final = 0.5
"""From this r/R on, shaped grooves act fully (csrc/shapes/hd_disc.c)."""
ZERO_RADIUS_FRACTION: Final = 0.2
"""Up to this r/R, shaped grooves do not act, and friction does not follow the turn (csrc/shapes/hd_disc.c)."""
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
    """Return the fading g of shaped grooves at `part` = r/R, and its first and second derivatives by r/R."""
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
    mu = materials["friction_coefficient"]
    spring = np.where(mu > 0.0, materials["friction_stiffness_n_per_m"], 0.0)
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
    cross = pressed * 0.5 * height * turn * leaning
    normal = stiffness * (steep**2 + steep * slope) + np.abs(bend) / radius**2 * pressed * height + cross
    around = stiffness * (slope**2 + steep * slope) + pressed * curvature + cross
    normal, around = normal.max(axis=1), around.max(axis=1)
    # Friction: it turns with the surface outside the middle, up to the largest mu^2 F_n / (4 r) there.
    innermost = np.maximum(part[:, -1], ZERO_RADIUS_FRACTION)
    rubbed = np.minimum(press_n, stiffness[:, 0] * radius_m * (1.0 - innermost))
    return RoundProperties(
        normal=normal + 0.25 * mu**2 * rubbed / (innermost * radius_m),
        tangent=around + spring,
        spring=spring,
        friction_per_depth=mu * normal,
    )
