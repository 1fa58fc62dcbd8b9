"""What a material gets where neither recordings nor the user say it. Loads nothing: the help of commands shows it."""

from __future__ import annotations

from typing import Final

STIFFNESS_N_PER_M: Final = 800.0
"""As most of the library's."""
