"""Options of the fits. Importing this module loads no fit."""

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
"""Stiffness of a material if neither the recordings nor the user determine it: that of most library materials."""
MATERIAL_KEYS: Final[Mapping[Kind, str]] = {
    "tap": "tap",
    "grooves": "texture",
    "texture": "texture",
    "puncture": "rupture",
}
"""Key of a material that each kind of fit sets. Of two fits with the same key the later replaces the earlier."""


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of a fit; None means that the recordings decide."""

    form: TapKind | None = None
    """Model of the taps. The options from `form` to `mode_table` apply to taps only."""
    attack: Attack | None = None
    law: LawKind | None = None
    two_modes: bool | None = None
    mode_table: bool | None = None
    autoregressive: bool | None = None
    """Whether autoregressive models are fitted to a texture."""

    @property
    def of_modes(self) -> list[str]:
        """Names of the options that are set and concern modes."""
        return [name for name in ("law", "two_modes", "mode_table", "attack") if getattr(self, name) is not None]

    def fault(self, spelled: Callable[[str], str]) -> tuple[str, str] | None:
        """Return an option that conflicts with another one, and the text of the error; None without a conflict.

        `spelled(name)` returns an option as the user writes it.
        """
        if self.form == "waveform" and self.of_modes:
            word = spelled(self.of_modes[0])
            return self.of_modes[0], (
                f"{word} is only for modes, and {spelled('form')} waveform fits no modes: leave out one"
            )
        curved = self.law not in (None, "line")
        for option, given in (("law", curved), ("two_modes", self.two_modes is True)):
            if given and self.attack == "first_peak":
                word = spelled(option)
                return option, (
                    f"{word} and {spelled('attack')} exclude each other: leave out one, {word} needs coefficients"
                )
        return None
