"""The margin of each surface alone, from a compiled table, computed in microseconds per surface.

The margin is the largest factor on the stiffness at which two conditions hold: the surface is passive, and the handle's
dry friction absorbs the noise of encoder and actuator. For a set of one surface without fields, contact_sets.py yields
the same margin. `hapticd check` adds the effects of other surfaces and fields, the eigenvalues and the remedies.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from hapticd.base.core import Shape
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.stability import WORST_NORMAL_FACTOR, Loop, limits
from hapticd.rendering.surface_properties import depends_on_radius, properties_of
from hapticd.rendering.surface_table import SurfaceTable

_SurfaceKind: TypeAlias = tuple[int, int, float]
"""Material, first piece (-1: no patches), radius (0: irrelevant). Surfaces of one kind share terms of the margin."""
_PLANE_SHAPES: Final = frozenset((int(Shape.WALL), int(Shape.MEMBRANE)))
"""Shapes that push along one normal."""
_DISC_SHAPE: Final = int(Shape.DISC)
"""Shape of a disc; an int is faster to compare than a member of Shape."""
_WORST_NORMAL_COMPONENT: Final = math.sqrt(0.5 * WORST_NORMAL_FACTOR)
"""Value used for |n_x| and |n_y| if a surface has many normals: its noise has the factor WORST_NORMAL_FACTOR."""


class _KindMargins(NamedTuple):
    """Terms of the stability margin that surfaces of one kind share, independent of position and orientation."""

    passive: float
    """Factor on the stiffness up to which the surface is passive."""
    along_n: float
    """Noise along the normal that grows with the stiffness."""
    across_n: float
    """Noise along the surface that grows with the stiffness."""
    fixed_along_n: float
    """Noise along the normal that does not grow with the stiffness."""
    fixed_across_n: float
    """Noise along the surface that does not grow with the stiffness."""


class SurfaceMargins:
    """Computes the stability margins of surfaces, and caches the terms that all surfaces of one kind share.

    The cache is cleared when materials or pieces of the table change.
    """

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self._quiet_n = loop.dynamics.friction_n / loop.timing.gain - 0.5 * loop.force_step_n
        self._version: int | None = None
        self._cache: dict[_SurfaceKind, _KindMargins | None] = {}
        """Terms by kind of surface; None: the surface exerts no force."""
        self._depends_on_radius: list[bool] = []
        """By material: whether the margin of a disc depends on its radius."""

    def of(self, compiler: Compiler, slots: Collection[int]) -> list[float]:
        """Return the margins (factors by which the stiffness may grow) of the surfaces at these slots.

        A margin is infinite if nothing limits the stiffness, and 0 if no stiffness is safe.
        """
        if compiler.parts_version != self._version:
            self._forget(compiler)
        cached, depends = self._cache, self._depends_on_radius
        faces: list[tuple[_SurfaceKind, float, float]] = []
        missing: dict[_SurfaceKind, int] = {}
        for slot, record in zip(slots, compiler.records_of(slots), strict=True):
            _, _, _, shape, material, first, count, _, _, _, x, y, half_m, _ = record
            kind = (material, first if count else -1, half_m if shape == _DISC_SHAPE and depends[material] else 0.0)
            if kind not in cached:
                missing[kind] = slot
            # A shape that can be touched from any side counts with the worst normal.
            faces.append(
                (kind, abs(x), abs(y))
                if shape in _PLANE_SHAPES
                else (kind, _WORST_NORMAL_COMPONENT, _WORST_NORMAL_COMPONENT)
            )
        if missing:
            self._find(compiler.surfaces(), missing)
        margins = []
        for kind, x, y in faces:
            common = cached[kind]
            if common is None:
                margins.append(math.inf)
                continue
            passive, along_n, across_n, fixed_along_n, fixed_across_n = common
            size, quiet_n = x + y, self._quiet_n
            # Noise counts on the worse of the two axes.
            noise_n = size * max(along_n * x + across_n * y, along_n * y + across_n * x)
            if fixed_along_n or fixed_across_n:
                quiet_n -= size * max(fixed_along_n * x + fixed_across_n * y, fixed_along_n * y + fixed_across_n * x)
            silent = 0.0 if quiet_n < 0.0 else quiet_n / noise_n if noise_n > 0.0 else math.inf
            margins.append(min(passive, silent))
        return margins

    def _forget(self, compiler: Compiler) -> None:
        """Clear the cached terms after a change of the table's materials or pieces."""
        self._depends_on_radius = depends_on_radius(compiler.surfaces().materials).tolist()
        self._version = compiler.parts_version
        self._cache.clear()

    def _find(self, surfaces: SurfaceTable, missing: dict[_SurfaceKind, int]) -> None:
        """Compute and cache the terms of the kinds `missing`, each from one surface of the kind, given by its slot."""
        loop = self.loop
        found = properties_of(surfaces.of(np.fromiter(missing.values(), np.int64, len(missing))))
        none = np.zeros(len(missing))
        passive, _ = limits(
            np.maximum(found.normal, found.tangent) + 0.5 * loop.lag * found.friction_per_depth,
            np.maximum(found.damping, found.drag) + 2.0 * loop.late_periods * found.friction_per_speed,
            none,
            none,
            loop,
        )
        step_m, step_m_per_s = loop.encoder_step_m, loop.speed_step_m_per_s
        columns = (
            passive,
            0.5 * step_m * found.normal_noise,
            0.5 * step_m * found.tangent_noise,
            step_m_per_s * found.normal_speed_noise,
            step_m_per_s * found.tangent_speed_noise,
        )
        pushes = np.any(np.stack(found) > 0.0, axis=0)
        for kind, row, some in zip(missing, np.stack(columns, axis=1).tolist(), pushes.tolist(), strict=True):
            self._cache[kind] = _KindMargins(*row) if some else None
