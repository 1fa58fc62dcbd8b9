"""What a person reads of devices that play modes, and of those that do not report resets. It loads nothing."""

from collections.abc import Mapping


def offload_text(outcome: Mapping[str, object]) -> str:
    """What a person reads of a tap or rupture that the device was to play itself: an `offload` of the protocol."""
    name = f"{outcome['mode']} of {outcome['material']}, {outcome['frequency_hz']:g} Hz"
    if outcome["refused"] is not None:
        return f"{name}: streamed, {outcome['refused']}"
    return f"{name}: played by the device at {outcome['shown_hz']:g} Hz, {outcome['error_percent']:.2g} % off"


def unseen_text(node: str, foreign_s: object = None) -> tuple[str, str]:
    """What is wrong with a device that does not report which of its effects play, and what to do about it.
    `foreign_s`: so long an effect of another program lasts in the place of ours at most, s; None: not known."""
    lasts = f"; what it uploads lasts up to {1e3 * foreign_s:.0f} ms" if isinstance(foreign_s, float) else ""
    return (
        f"{node} does not report which of its effects play: a reset by another program is not noticed{lasts}",
        f"`hapticd devices claim {node}` keeps other programs off",
    )
