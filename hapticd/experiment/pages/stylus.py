"""Where the stylus is drawn: a participant sees objects and stylus, and nothing that tells materials apart.

How deep a hand presses into a surface tells how stiff that is. So a stylus that touches something is drawn on it.
"""

from __future__ import annotations

from collections.abc import Sequence

from hapticd.experiment.front import Seen


def drawn_at(position_m: tuple[float, float], touches: bool, surfaces: Sequence[Seen]) -> tuple[float, float]:
    """Where a handle at `position_m` is drawn: at the height of the surface that it is below, along its normal.

    Of several that is the one that it is nearest to along the surface. Beyond the end of one, and at the side of a box,
    it is drawn at the same height: no depth is seen anywhere. A handle that touches nothing is drawn where it is, also
    behind a membrane that was punctured.
    """
    x, y = position_m
    found = [(*each.from_surface(position_m), each.normal) for each in surfaces] if touches else []
    below = [each for each in found if each[1] < 0.0]
    if not below:
        return x, y
    _, above, (n_x, n_y) = min(below)
    return x - above * n_x, y - above * n_y
