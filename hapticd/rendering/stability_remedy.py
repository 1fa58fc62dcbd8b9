"""What to lower so that a set of objects is safe, found and checked with the analysis that called it unsafe.

The curvature of groove flanks does not fall with the stiffness, that of the ramps between patches rises where the wall
is softer, and a softer wall is pressed deeper and may reach others. So a limit is not the margin times the stiffness:
each answer is a scene that is judged again.
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

_LEAST: Final = 1e-3
"""Factors below this are no remedy."""
_COARSE: Final = 0.75
_HALVINGS: Final = 7
_CHECKED: Final = (1.0, 0.99, 0.9)
"""A factor is reported if the set is safe with it, and with a little less."""
MOST_CHECKED: Final = 200
"""In a scene of more surfaces a set is checked alone: what else a softer wall would reach is left out."""
_SHOWN: Final = 4


def with_remedy(margin: Margin, surfaces: SurfaceTable, loop: Loop, slots: Sequence[int]) -> Margin:
    """The margin of an unsafe set with the limit that holds, and the keys to lower where one figure does not say it."""
    own = np.array(slots, dtype=np.int64)
    alone = np.count_nonzero(surfaces.objects["shape"]) > MOST_CHECKED
    if alone:
        surfaces, own, slots = surfaces.of(own), np.arange(len(own)), range(len(own))
    materials = surfaces.materials_of(own)
    bends = _bends(surfaces, own, materials)

    def safe(changed: SurfaceTable) -> bool:
        return safe_around(changed, loop, slots)

    def softer(factor: float) -> SurfaceTable:
        return _scaled(surfaces, materials, factor)

    # Boxes and discs reach as far as ever.
    deepens = bool(np.isin(surfaces.objects["shape"], (Shape.WALL, Shape.MEMBRANE)).any())
    # What is linear needs no search, only the check: 1 - 1e-9, as energy that is neither given nor taken is not safe.
    factor = margin.margin * (1.0 - 1e-9) if math.isfinite(margin.margin) else 0.0
    if bends or (deepens and not alone and factor > 0.0 and not _checked(safe, softer, factor)):
        factor = _found(safe, softer, 1.0)
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


def _bends(surfaces: SurfaceTable, own: Ints, materials: Ints) -> bool:
    """Whether anything of it has a stiffness that is not proportional to `stiffness_n_per_m`."""
    grooved = bool((surfaces.materials["texture"][materials] == Texture.GEOMETRY).any())
    rubs = surfaces.materials["friction_coefficient"][surfaces.objects["material"][own]] > 0.0
    round_rubs = bool((rubs & (surfaces.objects["shape"][own] == Shape.DISC)).any())
    return grooved or round_rubs or bool((surfaces.objects["piece_count"][own] > 0).any())


def _scaled(surfaces: SurfaceTable, materials: Ints, factor: float) -> SurfaceTable:
    changed = surfaces.materials.copy()
    for key in ("stiffness_n_per_m", "friction_stiffness_n_per_m"):
        changed[key][materials] *= factor
    return surfaces._replace(materials=changed, field_stiffness_n_per_m=factor * surfaces.field_stiffness_n_per_m)


def _checked(safe: Callable[[SurfaceTable], bool], with_factor: Callable[[float], SurfaceTable], factor: float) -> bool:
    return factor >= _LEAST and all(safe(with_factor(part * factor)) for part in _CHECKED)


def _found(safe: Callable[[SurfaceTable], bool], with_factor: Callable[[float], SurfaceTable], top: float) -> float:
    """The largest factor below `top` that is safe, as are those a little below; 0: none was found."""
    low = high = top
    while not _checked(safe, with_factor, low):
        low, high = _COARSE * low, low
        if low < _LEAST:
            return 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _checked(safe, with_factor, middle) else (low, middle)
    return low


def _named(surfaces: SurfaceTable, materials: Ints) -> str:
    names = [surfaces.names[index] for index in materials[:_SHOWN].tolist()]
    return ", ".join(names) + (f" and {len(materials) - _SHOWN} more" if len(materials) > _SHOWN else "")


def _rounded(value: float) -> str:
    """Rounded down to three digits: what is a little less is safe, what is more may not be."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{math.floor(value / digit) * digit:.6g}"


def _softened(surfaces: SurfaceTable, materials: Ints, factor: float, springs: bool) -> str:
    stiffness = surfaces.materials["stiffness_n_per_m"][materials]
    if len(materials) == 1 and not springs:
        most = _rounded(factor * float(stiffness[0]))
        return f"a stiffness_n_per_m of at most {most} N/m for {_named(surfaces, materials)}"
    of = f"of {_named(surfaces, materials)}" if len(materials) > 0 else "of the fields"
    more = ", springs of friction and fields included," if springs and len(materials) > 0 else ""
    return f"every stiffness {of}{more} at most {_rounded(factor)} times what it is"


def _reshaped(safe: Callable[[SurfaceTable], bool], surfaces: SurfaceTable, materials: Ints) -> str:
    """The stiffest patches softer: all alike they have no ramps. Or grooves flatter; or both."""
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
        # With those that are hardly softer: left as they are, they would be the next step.
        above = materials[stiffness > _CHECKED[-1] * factor * top]
        return f"a stiffness_n_per_m of at most {_rounded(factor * top)} N/m for {_named(surfaces, above)}"

    def flat(factor: float) -> str:
        depth_m = surfaces.materials["depth_m"][grooved]
        if len(grooved) > 1:
            return f"every texture.depth_m of {_named(surfaces, grooved)} at most {_rounded(factor)} times what it is"
        return f"a texture.depth_m of at most {_rounded(factor * float(depth_m[0]))} m for {_named(surfaces, grooved)}"

    factor = _found(safe, capped, 1.0)
    if factor > 0.0:
        return cap(factor)
    if len(grooved) == 0:
        return ""
    depth = _found(safe, flatter, 1.0)
    if depth > 0.0:
        return flat(depth)
    # Room for both: nine tenths of the stiffness that plain walls might have.
    factor = 0.9 * _found(safe, lambda some: capped(some, flatter(0.0)), 1.0)
    depth = _found(safe, lambda some: flatter(some, capped(factor)), 1.0) if factor > 0.0 else 0.0
    return f"{cap(factor)} and {flat(depth)}" if depth > 0.0 else ""
