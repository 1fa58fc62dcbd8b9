"""The options of the fits: those of taps may exclude one another. Loads no fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

if TYPE_CHECKING:
    from hapticd.config.modes import Attack
    from hapticd.fit.recording import Kind
    from hapticd.fit.speed_law import LawKind

TapKind: TypeAlias = Literal["auto", "mode", "waveform"]
STIFFNESS_N_PER_M: Final = 800.0
"""What a material gets where neither recordings nor the user say it: as most of the library's."""
KEY_OF: Final[Mapping[Kind, str]] = {
    "tap": "tap",
    "grooves": "texture",
    "texture": "texture",
    "puncture": "rupture",
}
"""What of a material each kind of fit makes; of two that make the same only the later stays."""


@dataclass(frozen=True, slots=True)
class FitOptions:
    """What is asked of a fit; None: as the recordings have it."""

    form: TapKind | None = None
    """Of taps, as are the next four."""
    attack: Attack | None = None
    law: LawKind | None = None
    two_modes: bool | None = None
    mode_table: bool | None = None
    autoregressive: bool | None = None
    """Of textures."""

    @property
    def of_modes(self) -> list[str]:
        """Options that are given and concern modes."""
        return [name for name in ("law", "two_modes", "mode_table", "attack") if getattr(self, name) is not None]

    def fault(self, spelled: Callable[[str], str]) -> tuple[str, str] | None:
        """Which option does not go together with the others, and why; `spelled` is how the user writes an option."""
        if self.form == "waveform" and self.of_modes:
            word = spelled(self.of_modes[0])
            return self.of_modes[0], (
                f"{word} is only for modes, and {spelled('form')} waveform fits none: leave out one"
            )
        bent = self.law not in (None, "line")
        for option, given in (("law", bent), ("two_modes", self.two_modes is True)):
            if given and self.attack == "first_peak":
                word = spelled(option)
                return option, (
                    f"{word} and {spelled('attack')} do not go together: leave out one, {word} is of coefficients"
                )
        return None
