"""A vibration whose frequency is too high for the rate, and the text that reports it.

The module imports only the standard library, so that `hapticd status` starts fast.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal, TypeAlias

Use: TypeAlias = Literal["tap", "second", "rupture", "groove", "texture"]
"""Use of a vibration in a material: the strike that starts a mode, or `texture` for noise."""


@dataclass(frozen=True, slots=True)
class Undisplayable:
    """A mode, a texture's peak or the middle of a waveform's spectrum that lies above 0.4 of the rate.

    `shown_hz` is the frequency that is displayed instead; None if the vibration is silent.
    """

    material: str
    mode: Use
    frequency_hz: float
    shown_hz: float | None

    def __str__(self) -> str:
        return undisplayable_text(asdict(self))


def undisplayable_text(entry: Mapping[str, object]) -> str:
    """Return the text for an entry of the list `undisplayable` of the protocol."""
    shown = "silent" if entry["shown_hz"] is None else f"shown at {entry['shown_hz']:g} Hz"
    return f"{entry['mode']} of {entry['material']}, {entry['frequency_hz']:g} Hz: {shown}"
