"""The options of the fits: those of taps may exclude one another, and each makes its fit. Loads no fit before that."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from hapticd.config.modes import Attack
    from hapticd.fit.from_files import Fitting, TapKind
    from hapticd.fit.recording import Kind
    from hapticd.fit.speed_law import LawKind

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

    def fault(self, spelled: Callable[[str], str]) -> tuple[str, str] | None:
        """Which option does not go together with the others, and why; `spelled` is how the user writes an option."""
        modes = self._of_modes()
        if self.form == "waveform" and modes:
            return modes[0], (
                f"{spelled(modes[0])} is only for modes, and {spelled('form')} waveform fits none: leave out one"
            )
        bent = self.law not in (None, "line")
        for option, given in (("law", bent), ("two_modes", self.two_modes is True)):
            if given and self.attack == "first_peak":
                word = spelled(option)
                return option, (
                    f"{word} and {spelled('attack')} do not go together: leave out one, {word} is of coefficients"
                )
        return None

    def fitting(self, kind: Kind) -> Fitting:
        """The fit of recordings of this kind."""
        from hapticd.fit.from_files import of_one_kind, of_taps

        match kind:
            case "tap":
                form: TapKind = self.form if self.form is not None else "mode" if self._of_modes() else "auto"
                return of_taps(form, self.attack, self.law, self.two_modes, self.mode_table)
            case "grooves":
                from hapticd.fit.grooves import fit_grooves

                return of_one_kind(fit_grooves)
            case "texture":
                from hapticd.fit.texture import fit_texture

                return of_one_kind(partial(fit_texture, autoregressive=self.autoregressive is True))
            case "puncture":
                from hapticd.fit.puncture import fit_puncture

                return of_one_kind(fit_puncture)

    def _of_modes(self) -> list[str]:
        """Options that are given and concern modes."""
        return [name for name in ("law", "two_modes", "mode_table", "attack") if getattr(self, name) is not None]
