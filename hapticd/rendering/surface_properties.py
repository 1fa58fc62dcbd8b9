"""Upper bounds of stiffness, damping and noise of surfaces, which the analysis of contact sets adds up."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Shape, Texture
from hapticd.rendering.disc_stiffness import round_properties
from hapticd.rendering.stability import ASSUMED_PRESS_N, Floats
from hapticd.rendering.surface_table import SurfaceTable


class SurfaceProperties(NamedTuple):
    """Stiffness, damping and noise of each surface, as upper bounds anywhere on it; arrays (n,)."""

    normal: Floats
    """Stiffness along the normal."""
    tangent: Floats
    """Stiffness along the surface."""
    damping: Floats
    """Damping along the normal."""
    drag: Floats
    """Damping along the surface."""
    friction_per_depth: Floats
    """Change of the friction force with the depth, mu K."""
    friction_per_speed: Floats
    """Change of the friction force with the approach speed, mu D."""
    normal_noise: Floats
    """Force along the normal per metre of position error."""
    tangent_noise: Floats
    """Force along the tangent per metre of position error."""
    normal_speed_noise: Floats
    """Force along the normal per m/s of speed error."""
    tangent_speed_noise: Floats
    """Force along the tangent per m/s of speed error."""

    def of(self, rows: npt.NDArray[np.integer]) -> SurfaceProperties:
        """Return the properties of the surfaces at these indices."""
        return SurfaceProperties(*(values[rows] for values in self))


def _material_properties(materials: npt.NDArray[np.void]) -> SurfaceProperties:
    stiffness, damping = materials["stiffness_n_per_m"], materials["damping_n_s_per_m"]
    rubs = materials["friction_coefficient"] > 0.0
    spring = np.where(rubs, materials["friction_stiffness_n_per_m"], 0.0)
    # The surface is lowered by H, of slope H' and curvature H'': the force is -grad(K/2 (d - H)^2), whose derivative
    # is K (1, H')(1, H')^T, and K (d - H) H'' along the surface.
    grooved = materials["texture"] == Texture.GEOMETRY
    width = np.where(grooved, materials["width_m"], 1.0)
    slope = np.where(grooved, math.pi * materials["depth_m"] / width, 0.0)
    curvature = 2.0 * math.pi * slope / width
    normal = stiffness * (1.0 + slope)
    flank = stiffness * (slope * slope + slope) + ASSUMED_PRESS_N * curvature
    drag = np.where(materials["texture"] == Texture.DRAG, materials["drag_n_s_per_m"], 0.0)
    mu = materials["friction_coefficient"]
    return SurfaceProperties(
        normal=normal,
        tangent=spring + flank,
        damping=damping,
        drag=drag,
        friction_per_depth=mu * normal,
        friction_per_speed=mu * damping,
        normal_noise=normal,
        # Position and anchor both have the error, so the spring has twice; its longest stretch follows F_n.
        tangent_noise=2.0 * spring + flank + mu * normal,
        normal_speed_noise=damping,
        tangent_speed_noise=drag + mu * damping,
    )


def depends_on_radius(materials: npt.NDArray[np.void]) -> npt.NDArray[np.bool_]:
    """Return for each of `materials`, MATERIAL_DTYPE (n,), whether the stiffness of a disc depends on its radius."""
    return np.asarray((materials["friction_coefficient"] > 0.0) | (materials["texture"] == Texture.GEOMETRY))


def _put_discs(surfaces: SurfaceTable, properties: SurfaceProperties) -> None:
    """Replace the properties of discs that have friction or shaped grooves."""
    materials = surfaces.materials[surfaces.objects["material"]]
    discs = np.flatnonzero((surfaces.objects["shape"] == Shape.DISC) & depends_on_radius(materials))
    if len(discs) == 0:
        return
    found = round_properties(surfaces.objects["half_m"][discs, 0], materials[discs], ASSUMED_PRESS_N)
    properties.normal[discs] = properties.normal_noise[discs] = found.normal
    properties.tangent[discs] = found.tangent
    properties.friction_per_depth[discs] = found.friction_per_depth
    properties.tangent_noise[discs] = found.tangent + found.spring + found.friction_per_depth


def properties_of(surfaces: SurfaceTable) -> SurfaceProperties:
    """Return upper bounds for each object, from its material, or from all pieces and ramps of a wall with patches."""
    materials = _material_properties(surfaces.materials)
    properties = SurfaceProperties(*(values.copy() for values in materials.of(surfaces.objects["material"])))
    _put_discs(surfaces, properties)
    patched = np.flatnonzero(surfaces.objects["piece_count"] > 0)
    if len(patched) == 0:
        return properties
    # On a ramp of width w from stiffness K1 to K2, K' <= 3/2 |K2 - K1| / w and
    # K'' <= 6 |K2 - K1| / w^2; the force is -grad(K/2 d^2), pressed to the depth of ASSUMED_PRESS_N in the middle.
    of = surfaces.pieces["material"]
    stiffness = surfaces.materials["stiffness_n_per_m"][of]
    before = np.concatenate((stiffness[:1], stiffness[:-1]))
    ramp = 2.0 * surfaces.pieces["half_ramp_m"]
    step = np.where(ramp > 0.0, np.abs(stiffness - before), 0.0)
    ramp = np.where(ramp > 0.0, ramp, 1.0)
    depth = ASSUMED_PRESS_N / np.maximum(0.5 * (stiffness + before), 1e-3)
    cross = 1.5 * step / ramp * depth
    along = 3.0 * step / ramp**2 * depth**2 + cross
    pieces = materials.of(of)
    pieces = pieces._replace(
        normal=np.maximum(pieces.normal, np.where(step > 0.0, before, 0.0)) + cross,
        tangent=pieces.tangent + along,
        normal_noise=np.maximum(pieces.normal_noise, np.where(step > 0.0, before, 0.0)) + cross,
        tangent_noise=pieces.tangent_noise + along,
    )
    # The pieces of walls are contiguous, but in another order than the walls.
    order = patched[np.argsort(surfaces.objects["piece_first"][patched], kind="stable")]
    starts = surfaces.objects["piece_first"][order].astype(np.int64)
    for into, values in zip(properties, pieces, strict=True):
        into[order] = np.maximum.reduceat(values, starts)
    return properties
