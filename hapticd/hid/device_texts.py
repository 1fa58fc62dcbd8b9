"""Texts for users about device effects, about devices that do not report resets, and about the check of signs."""

from collections.abc import Mapping
from typing import Final

LET_GO: Final = "let go of the handle, or hold it lightly and still if it has a hand sensor"
"""What the user should do while the signs of a device are checked."""


def offload_text(outcome: Mapping[str, object]) -> str:
    """Return a line that says whether the device plays a tap or rupture, and if not, why the mode is streamed.

    `outcome` is an element of `offload` in the protocol's status.
    """
    name = f"{outcome['mode']} of {outcome['material']}, {outcome['frequency_hz']:g} Hz"
    if outcome["refused"] is not None:
        return f"{name}: streamed, {outcome['refused']}"
    return f"{name}: played by the device at {outcome['shown_hz']:g} Hz, {outcome['error_percent']:.2g} % off"


def unseen_reset_text(node: str, effect_s: object = None) -> tuple[str, str]:
    """Return two texts on a device that does not report which effects play: what may happen, and the remedy.

    `effect_s` is the longest time, in s, for which another program's effect can replace hapticd's; None if unknown.
    """
    lasts = f"; an effect that it uploads lasts up to {1e3 * effect_s:.0f} ms" if isinstance(effect_s, float) else ""
    return (
        f"{node} does not report which of its effects play: a reset by another program is not noticed{lasts}",
        f"`hapticd devices claim {node}` keeps other programs off",
    )
