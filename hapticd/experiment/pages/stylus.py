"""The position at which the stylus is drawn, which must not reveal the material.

The depth of the handle in a surface depends on its stiffness. A stylus that touches a surface is therefore drawn on the
surface.
"""

from __future__ import annotations

from collections.abc import Sequence

from hapticd.experiment.front import Seen


def drawn_at(position_m: tuple[float, float], touches: bool, surfaces: Sequence[Seen]) -> tuple[float, float]:
    """Return the position in m at which the stylus is drawn for a handle at `position_m`.

    If the handle touches an object, the stylus is drawn at the height of the surface above it, also beyond the end of
    the surface and at the side of a box: no depth is visible. Of several surfaces, the one with the smallest distance
    beyond its end is used. A handle that touches nothing, also behind a punctured membrane, is drawn at `position_m`.
    """
    x, y = position_m
    found = [(*each.from_surface(position_m), each.normal) for each in surfaces] if touches else []
    below = [each for each in found if each[1] < 0.0]
    if not below:
        return x, y
    _, above, (n_x, n_y) = min(below)
    return x - above * n_x, y - above * n_y
