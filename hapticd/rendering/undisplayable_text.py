"""What a rate cannot carry, and how a person reads it. It loads nothing, as `hapticd status` should not either."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal, TypeAlias

Use: TypeAlias = Literal["tap", "second", "rupture", "groove", "texture"]


@dataclass(frozen=True, slots=True)
class Undisplayable:
    """A mode, the middle of a waveform's spectrum or the peak of a texture's, that the rate cannot carry.

    `shown_hz` is what is displayed in its place, None if nothing is.
    """

    material: str
    mode: Use
    frequency_hz: float
    shown_hz: float | None

    def __str__(self) -> str:
        return undisplayable_text(asdict(self))


def undisplayable_text(entry: Mapping[str, object]) -> str:
    """What a person reads of a mode, or the peak of a texture, that the rate cannot carry: an `undisplayable` of the
    protocol."""
    shown = "silent" if entry["shown_hz"] is None else f"shown at {entry['shown_hz']:g} Hz"
    return f"{entry['mode']} of {entry['material']}, {entry['frequency_hz']:g} Hz: {shown}"
