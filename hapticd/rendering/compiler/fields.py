"""Springs, dampers and constant forces: all of them are one field, the exact sum of theirs (docs/adr/0005)."""

from __future__ import annotations

from typing import Final

from hapticd.base.core import CData
from hapticd.config.scene import SceneObject

_QUANTUM: Final = 1 << 1074
"""Every double is a whole number of 1/_QUANTUM."""


class Fields:
    """The sum of all fields, F = force - stiffness p - damping v, exact however often they come and go."""

    def __init__(self) -> None:
        self._parts: dict[str, tuple[float, float, float, float]] = {}
        self._sums = [0, 0, 0, 0]

    def put(self, id: str, item: SceneObject | None) -> bool:
        """Takes what a field exerts, or None for what is none; whether the sum changed."""
        before = self._parts.pop(id, None)
        after = None if item is None else _field_of(item)
        if after is not None:
            self._parts[id] = after
        if before == after:
            return False
        for place in range(4):
            new = 0 if after is None else _quanta(after[place])
            old = 0 if before is None else _quanta(before[place])
            self._sums[place] += new - old
        return True

    def write(self, field: CData) -> None:
        """Puts the sums, correctly rounded, into a `struct hd_field`."""
        x, y, field.stiffness_n_per_m, field.damping_n_s_per_m = (total / _QUANTUM for total in self._sums)
        field.force_n = (x, y)


def _quanta(value: float) -> int:
    numerator, denominator = value.as_integer_ratio()
    return numerator * (_QUANTUM // denominator)


def _field_of(item: SceneObject) -> tuple[float, float, float, float] | None:
    """Force (x, y), stiffness and damping; None for a surface."""
    if item.kind == "spring":
        stiffness = item.stiffness_n_per_m
        return stiffness * item.center_m[0], stiffness * item.center_m[1], stiffness, item.damping_n_s_per_m
    if item.kind == "viscous":
        return 0.0, 0.0, 0.0, item.damping_n_s_per_m
    if item.kind == "constant":
        return item.force_n[0], item.force_n[1], 0.0, 0.0
    return None
