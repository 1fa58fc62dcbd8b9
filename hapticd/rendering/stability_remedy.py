"""Remedies for a contact set that is not safe: stiffnesses to lower, or depths of grooves.

The stiffness due to the curvature of groove flanks does not fall with that of the material; the stiffness due to ramps
between patches rises where the wall is softer. A softer wall is also pressed deeper and may reach other objects. So the
limit is not simply the margin times the stiffness: each proposed scene is analysed again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from hapticd.base.core import Shape, Texture
from hapticd.rendering.contact_sets import safe_around
from hapticd.rendering.stability import Loop, Margin
from hapticd.rendering.surface_table import Ints, SurfaceTable

_MIN_STIFFNESS_FACTOR: Final = 1e-3
"""Smallest factor on the stiffness that is proposed as a remedy."""
_SEARCH_FACTOR_STEP: Final = 0.75
"""Ratio of successive factors that are tried until a factor is safe."""
_FACTOR_BISECTIONS: Final = 7
"""Number of bisections between the first safe factor and the unsafe one before."""
_CHECKED_FACTOR_PARTS: Final = (1.0, 0.99, 0.9)
"""A factor counts as safe only if the set is safe with each of these fractions of the factor."""
MAX_SURFACES_JUDGED_TOGETHER: Final = 200
"""In a scene with more surfaces, a set is analysed alone, without surfaces that only a softer wall reaches."""
_MAX_NAMED_MATERIALS: Final = 4
"""Largest number of materials that a remedy names."""


def with_remedy(margin: Margin, surfaces: SurfaceTable, loop: Loop, slots: Sequence[int]) -> Margin:
    """Return the margin of a set that is not safe with a checked limit, and with a remedy if one is needed."""
    own = np.array(slots, dtype=np.int64)
    alone = np.count_nonzero(surfaces.objects["shape"]) > MAX_SURFACES_JUDGED_TOGETHER
    if alone:
        surfaces, own, slots = surfaces.of(own), np.arange(len(own)), range(len(own))
    materials = surfaces.materials_of(own)
    bends = _has_nonlinear_stiffness(surfaces, own, materials)

    def safe(changed: SurfaceTable) -> bool:
        return safe_around(changed, loop, slots)

    def softer(factor: float) -> SurfaceTable:
        return _scaled(surfaces, materials, factor)

    # A softer wall or membrane is pressed deeper; boxes and discs keep their region.
    deepens = bool(np.isin(surfaces.objects["shape"], (Shape.WALL, Shape.MEMBRANE)).any())
    # A linear set needs no search, only a check just below its margin (1 - 1e-9), as the limit itself is not safe.
    factor = margin.margin * (1.0 - 1e-9) if math.isfinite(margin.margin) else 0.0
    if bends or (deepens and not alone and factor > 0.0 and not _is_safe_near(safe, softer, factor)):
        factor = _largest_safe_factor(safe, softer, 1.0)
    limit = margin.margin if factor == margin.margin * (1.0 - 1e-9) else factor
    remedy = ""
    if factor > 0.0:
        single = len(own) == 1 and len(materials) == 1 and not bends
        rubs = bool((surfaces.materials["friction_coefficient"][materials] > 0.0).any())
        if not single or rubs or surfaces.field_stiffness_n_per_m > 0.0:
            remedy = _softened(surfaces, materials, factor, rubs or surfaces.field_stiffness_n_per_m > 0.0)
    elif bends:
        remedy = _reshaped(safe, surfaces, materials)
    return replace(margin, margin=limit, limit_n_per_m=limit * margin.stiffness_n_per_m, remedy=remedy)


def _has_nonlinear_stiffness(surfaces: SurfaceTable, own: Ints, materials: Ints) -> bool:
    """Return whether a surface of the set has a stiffness that is not proportional to `stiffness_n_per_m`."""
    grooved = bool((surfaces.materials["texture"][materials] == Texture.GEOMETRY).any())
    rubs = surfaces.materials["friction_coefficient"][surfaces.objects["material"][own]] > 0.0
    round_rubs = bool((rubs & (surfaces.objects["shape"][own] == Shape.DISC)).any())
    return grooved or round_rubs or bool((surfaces.objects["piece_count"][own] > 0).any())


def _scaled(surfaces: SurfaceTable, materials: Ints, factor: float) -> SurfaceTable:
    changed = surfaces.materials.copy()
    for key in ("stiffness_n_per_m", "friction_stiffness_n_per_m"):
        changed[key][materials] *= factor
    return surfaces._replace(materials=changed, field_stiffness_n_per_m=factor * surfaces.field_stiffness_n_per_m)


def _is_safe_near(
    safe: Callable[[SurfaceTable], bool], with_factor: Callable[[float], SurfaceTable], factor: float
) -> bool:
    return factor >= _MIN_STIFFNESS_FACTOR and all(safe(with_factor(part * factor)) for part in _CHECKED_FACTOR_PARTS)


def _largest_safe_factor(
    safe: Callable[[SurfaceTable], bool], with_factor: Callable[[float], SurfaceTable], top: float
) -> float:
    """Return the largest factor up to `top` that is safe, as are slightly smaller ones; 0 if none was found."""
    low = high = top
    while not _is_safe_near(safe, with_factor, low):
        low, high = _SEARCH_FACTOR_STEP * low, low
        if low < _MIN_STIFFNESS_FACTOR:
            return 0.0
    for _ in range(_FACTOR_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _is_safe_near(safe, with_factor, middle) else (low, middle)
    return low


def _named(surfaces: SurfaceTable, materials: Ints) -> str:
    names = [surfaces.names[index] for index in materials[:_MAX_NAMED_MATERIALS].tolist()]
    return ", ".join(names) + (
        f" and {len(materials) - _MAX_NAMED_MATERIALS} more" if len(materials) > _MAX_NAMED_MATERIALS else ""
    )


def _rounded(value: float) -> str:
    """Return a limit as text, rounded down to three digits, as larger values are not safe."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{math.floor(value / digit) * digit:.6g}"


def _softened(surfaces: SurfaceTable, materials: Ints, factor: float, springs: bool) -> str:
    stiffness = surfaces.materials["stiffness_n_per_m"][materials]
    if len(materials) == 1 and not springs:
        limit = _rounded(factor * float(stiffness[0]))
        return f"a stiffness_n_per_m of at most {limit} N/m for {_named(surfaces, materials)}"
    of = f"of {_named(surfaces, materials)}" if len(materials) > 0 else "of the fields"
    more = ", springs of friction and fields included," if springs and len(materials) > 0 else ""
    return f"every stiffness {of}{more} at most {_rounded(factor)} times its value"


def _reshaped(safe: Callable[[SurfaceTable], bool], surfaces: SurfaceTable, materials: Ints) -> str:
    """Return a remedy that lowers the stiffest patches to a common stiffness, the depth of grooves, or both.

    Patches of equal stiffness have no ramps between them.
    """
    stiffness = surfaces.materials["stiffness_n_per_m"][materials]
    top = float(stiffness.max())
    grooved = materials[surfaces.materials["texture"][materials] == Texture.GEOMETRY]

    def capped(factor: float, surfaces: SurfaceTable = surfaces) -> SurfaceTable:
        changed = surfaces.materials.copy()
        changed["stiffness_n_per_m"][materials] = np.minimum(stiffness, factor * top)
        return surfaces._replace(materials=changed)

    def flatter(factor: float, surfaces: SurfaceTable = surfaces) -> SurfaceTable:
        changed = surfaces.materials.copy()
        changed["depth_m"][grooved] *= factor
        return surfaces._replace(materials=changed)

    def cap(factor: float) -> str:
        # Materials just below the cap are named, too: they would be the next step.
        above = materials[stiffness > _CHECKED_FACTOR_PARTS[-1] * factor * top]
        return f"a stiffness_n_per_m of at most {_rounded(factor * top)} N/m for {_named(surfaces, above)}"

    def flat(factor: float) -> str:
        depth_m = surfaces.materials["depth_m"][grooved]
        if len(grooved) > 1:
            return f"every texture.depth_m of {_named(surfaces, grooved)} at most {_rounded(factor)} times its value"
        return f"a texture.depth_m of at most {_rounded(factor * float(depth_m[0]))} m for {_named(surfaces, grooved)}"

    factor = _largest_safe_factor(safe, capped, 1.0)
    if factor > 0.0:
        return cap(factor)
    if len(grooved) == 0:
        return ""
    depth = _largest_safe_factor(safe, flatter, 1.0)
    if depth > 0.0:
        return flat(depth)
    # Both are lowered: the stiffness to nine tenths of the limit without grooves, then the depth.
    factor = 0.9 * _largest_safe_factor(safe, lambda some: capped(some, flatter(0.0)), 1.0)
    depth = _largest_safe_factor(safe, lambda some: flatter(some, capped(factor)), 1.0) if factor > 0.0 else 0.0
    return f"{cap(factor)} and {flat(depth)}" if depth > 0.0 else ""
