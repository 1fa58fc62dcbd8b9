"""The position at which the stylus is drawn, which must not reveal the material.

The depth of the handle in a surface depends on the stiffness. So a stylus that touches a surface is drawn on it.
"""

from __future__ import annotations

from collections.abc import Sequence

from hapticd.experiment.front import Seen


def drawn_at(position_m: tuple[float, float], touches: bool, surfaces: Sequence[Seen]) -> tuple[float, float]:
    """Return the position in m at which to draw a handle at `position_m`: if it touches, on the surface above it.

    Of several surfaces, the nearest one along the surface is used. Beyond the end of a surface and at the side of a box
    the stylus is drawn at the height of the surface, so that no depth is ever visible. A handle that touches nothing is
    drawn at its position, also behind a punctured membrane.
    """
    x, y = position_m
    found = [(*each.from_surface(position_m), each.normal) for each in surfaces] if touches else []
    below = [each for each in found if each[1] < 0.0]
    if not below:
        return x, y
    _, above, (n_x, n_y) = min(below)
    return x - above * n_x, y - above * n_y
