"""Directions of effects: the counts that stand for an angle, and what comes of whole counts only being near it."""

from __future__ import annotations

import math
from typing import Final, Literal

from hapticd.config.hid import ForceAxes, HandleAxes, Hid
from hapticd.hid.descriptor.fields import Field
from hapticd.hid.descriptor.layout import Layout, SetEffect

_COARSE: Final = 0.5
"""Two directions whose sine is below this do not tell the axes apart."""


def angle_of(effect: SetEffect) -> Field | None:
    """The direction as an angle; None where there is none, or parts of a vector stand for it."""
    return None if effect.is_direction_cartesian or not effect.direction else effect.direction[0]


def has_vector(effect: SetEffect) -> bool:
    """Whether the direction has a part along each of two axes."""
    return effect.is_direction_cartesian and len(effect.direction) >= 2


def has_one_axis(layout: Layout, hid: Hid) -> bool:
    """Whether the device pushes along one axis only, as a wheel does that has pedals and no Y."""
    assert layout.set_effect is not None
    no_y = hid.axes.y.usage == "Y" and "y" not in layout.input
    return no_y or len(layout.input) == 1 or len(layout.set_effect.axes_enable) == 1


def enabled_for(effect: SetEffect, axes: HandleAxes, axis: Literal["x", "y"]) -> str:
    """Which axis is enabled for a force along the device's first axis (x) or its second one (y): X and Y where it has
    both, else those of the handle, else its axes in their order. A device with one axis has it under any name."""
    known = effect.axes_enable
    handle = (axes.x.usage.lower(), axes.y.usage.lower())
    names = next(names for names in (("x", "y"), handle, tuple(known)) if known.keys() >= set(names))
    return names[min("xy".index(axis), len(names) - 1)]


def counts_of(angle: Field, turns: float) -> float:
    """The counts of a direction, at least the field's first and less than a turn beyond."""
    per_turn = angle.counts_per_turn()
    if per_turn <= 0.0:
        return angle.logical_min
    return angle.logical_min + (angle.counts_at_north() + per_turn * turns - angle.logical_min) % per_turn


def mirrored(axes: ForceAxes) -> tuple[int, float]:
    """What the device takes for a direction of d turns: slope * d + offset, by its signs and a swap of its axes.

    A direction is an angle from +y towards +x. Taking x negative turns d into -d, y negative into 1/2 - d, and swapping
    the axes into 1/4 - d; the swap comes first.
    """
    slope, offset = (-1, 0.25) if axes.swap else (1, 0.0)
    if axes.x.sign < 0:
        slope, offset = -slope, -offset
    if axes.y.sign < 0:
        slope, offset = -slope, 0.5 - offset
    return slope, offset


def parts(angle: Field, x_turns: float, y_turns: float) -> list[tuple[float, float]]:
    """What the magnitudes of two effects must have of the forces, so that both together push straight along an axis:
    of the force along the effect's own axis, and of the other one, for the effect of x and that of y.

    Of 255 counts a turn none is a right angle: a single effect that is meant for one axis pushes along the other with
    up to 1.2 % of its force. `x_turns`, `y_turns`: where their forces come from.
    """
    x_x, x_y = _pushes(angle, x_turns)
    y_x, y_y = _pushes(angle, y_turns)
    area = x_x * y_y - x_y * y_x
    if area < _COARSE:
        return [(1.0, 0.0)] * 2
    return [(y_y / area, -y_x / area), (x_x / area, -x_y / area)]


def leak(angle: Field) -> float:
    """What part of a force comes out across it, at most, where its direction is half a count off."""
    per_turn = angle.counts_per_turn()
    return math.sin(math.pi / per_turn) if per_turn > 2.0 else 1.0


def _pushes(angle: Field, turns: float) -> tuple[float, float]:
    """Which way the whole counts of a direction push."""
    per_turn = angle.counts_per_turn()
    if per_turn > 0.0:
        counts = min(max(round(counts_of(angle, turns)), angle.logical_min), angle.logical_max)
        turns = (counts - angle.counts_at_north()) / per_turn
    return -math.sin(2.0 * math.pi * turns), -math.cos(2.0 * math.pi * turns)
