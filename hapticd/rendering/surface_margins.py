"""How many times as stiff each surface of a compiled table could be by itself, in microseconds a surface.

It is the factor that contact_sets.py finds for a set of this surface alone, without fields: up to which it is passive,
and the handle's dry friction holds the noise of encoder and actuator. What other surfaces and the fields add, what the
eigenvalues say and what would help is for `hapticd check`.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from hapticd.base.core import Shape
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.stability import CORNER, Loop, limits
from hapticd.rendering.surface_properties import depends_on_radius, properties_of
from hapticd.rendering.surface_table import SurfaceTable

_Make: TypeAlias = tuple[int, int, float]
"""What a surface is made of, wherever it is: material, first piece (-1: no patches) and, where it matters, the
radius."""
_PLANES: Final = frozenset((int(Shape.WALL), int(Shape.MEMBRANE)))
_DISC: Final = int(Shape.DISC)
_WORST_SIDE: Final = math.sqrt(0.5 * CORNER)
"""As x and y of a normal it makes CORNER of the product below."""


class _Made(NamedTuple):
    """What does not depend on where surfaces of one make are and which way they face."""

    passive: float
    """Factor up to which it is passive."""
    along_n: float
    """Noise along the normal that grows with the stiffness."""
    across_n: float
    """Noise along the surface that grows with the stiffness."""
    still_along_n: float
    """Noise along the normal that does not grow with the stiffness."""
    still_across_n: float
    """Noise along the surface that does not grow with the stiffness."""


class SurfaceMargins:
    """Finds margins; what it found of a material, a patched wall or a radius is kept while the table has it."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self._quiet_n = loop.dynamics.friction_n / loop.timing.gain - 0.5 * loop.force_step_n
        self._version: int | None = None
        self._made: dict[_Make, _Made | None] = {}
        """None: it does not push."""
        self._depends_on_radius: list[bool] = []
        """By material: whether the radius of a disc of it matters."""

    def of(self, compiler: Compiler, slots: Collection[int]) -> list[float]:
        """The margins of the surfaces at these slots; infinite where nothing limits the stiffness, 0 where no stiffness
        would do."""
        if compiler.parts_version != self._version:
            self._forget(compiler)
        made, depends = self._made, self._depends_on_radius
        faces: list[tuple[_Make, float, float]] = []
        lacking: dict[_Make, int] = {}
        for slot, record in zip(slots, compiler.records_of(slots), strict=True):
            _, _, _, shape, material, first, count, _, _, _, x, y, half_m, _ = record
            make = (material, first if count else -1, half_m if shape == _DISC and depends[material] else 0.0)
            if make not in made:
                lacking[make] = slot
            # What may be met from any side counts as its worst one.
            faces.append((make, abs(x), abs(y)) if shape in _PLANES else (make, _WORST_SIDE, _WORST_SIDE))
        if lacking:
            self._find(compiler.surfaces(), lacking)
        margins = []
        for make, x, y in faces:
            common = made[make]
            if common is None:
                margins.append(math.inf)
                continue
            passive, along_n, across_n, still_along_n, still_across_n = common
            size, quiet_n = x + y, self._quiet_n
            # Noise counts for the worse of both axes.
            noise_n = size * max(along_n * x + across_n * y, along_n * y + across_n * x)
            if still_along_n or still_across_n:
                quiet_n -= size * max(still_along_n * x + still_across_n * y, still_along_n * y + still_across_n * x)
            silent = 0.0 if quiet_n < 0.0 else quiet_n / noise_n if noise_n > 0.0 else math.inf
            margins.append(min(passive, silent))
        return margins

    def _forget(self, compiler: Compiler) -> None:
        """Gives up what was found of materials and pieces, which are others now."""
        self._depends_on_radius = depends_on_radius(compiler.surfaces().materials).tolist()
        self._version = compiler.parts_version
        self._made.clear()

    def _find(self, surfaces: SurfaceTable, lacking: dict[_Make, int]) -> None:
        """Finds what surfaces of these makes have in common, of a slot each."""
        loop = self.loop
        found = properties_of(surfaces.of(np.fromiter(lacking.values(), np.int64, len(lacking))))
        none = np.zeros(len(lacking))
        passive, _ = limits(
            np.maximum(found.normal, found.tangent) + 0.5 * loop.lag * found.rubbed,
            np.maximum(found.damping, found.drag) + 2.0 * loop.late_periods * found.rubbed_damping,
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
        for make, row, some in zip(lacking, np.stack(columns, axis=1).tolist(), pushes.tolist(), strict=True):
            self._made[make] = _Made(*row) if some else None
