"""Patches of a wall: stretches of other materials."""

import math
from collections.abc import Sequence
from typing import Annotated, Final, Self, TypeAlias

from pydantic import AfterValidator, Field, Strict, model_validator

from hapticd.base.model import Model, Name, at_most

MAX_PATCHES: Final = 512
"""Of a wall."""
MAX_SCENE_PATCHES: Final = 5000
"""Of all walls of a scene: the last step of a change keeps the command thread for some 50 ms then (docs/adr/0058)."""
MIN_PATCH_M: Final = 1e-5
"""Patches, and the gaps between them, are at least this wide."""
TOUCHING_M: Final = 1e-9
"""Patches whose edges are as near as this touch: 0.1 + 0.2 is not 0.3."""
_ROUNDING_OF_WIDTHS: Final = 1e-6
_SHOWN_OVERLAPS: Final = 5

PatchEdge: TypeAlias = Annotated[float, Field(ge=-20, le=20)]


class Patch(Model):
    """A stretch of a wall that is of another material."""

    from_m: PatchEdge = Field(
        description="Where it begins, from the wall's point in the direction (n_y, -n_x): to the right on a floor."
    )
    to_m: PatchEdge = Field(description="Where it ends, in the same direction; more than where it begins.")
    material: Name = Field(description="Name of a material.")

    @model_validator(mode="after")
    def _is_wide_enough(self) -> Self:
        if self.to_m - self.from_m < MIN_PATCH_M * (1 - _ROUNDING_OF_WIDTHS):
            raise ValueError(
                f"to_m must be more than from_m by at least {MIN_PATCH_M:g}, is {self.to_m:.15g} and {self.from_m:.15g}"
            )
        return self


def in_order(patches: Sequence[Patch]) -> list[int]:
    """Their indices, in rising order along the wall."""
    return sorted(range(len(patches)), key=lambda index: patches[index].from_m)


def _apart(patches: tuple[Patch, ...]) -> tuple[Patch, ...]:
    """Refuses patches that overlap, or leave gaps that nobody means."""
    faults = []
    farthest, end_m = -1, -math.inf
    for index in in_order(patches):
        gap = patches[index].from_m - end_m
        names = f"[{min(farthest, index)}] and [{max(farthest, index)}]"
        if gap < -TOUCHING_M:
            faults.append(f"{names} overlap")
        elif TOUCHING_M < gap < MIN_PATCH_M * (1 - _ROUNDING_OF_WIDTHS):
            faults.append(f"{names} leave a gap of {gap:.3g} m: they touch, or are at least {MIN_PATCH_M:g} m apart")
        if patches[index].to_m > end_m:
            farthest, end_m = index, patches[index].to_m
    if faults:
        more = len(faults) - _SHOWN_OVERLAPS
        raise ValueError("; ".join(faults[:_SHOWN_OVERLAPS]) + (f"; and {more} more" if more > 0 else ""))
    return patches


Patches: TypeAlias = Annotated[
    tuple[Patch, ...], Strict(False), Field(max_length=MAX_PATCHES), AfterValidator(_apart), at_most(MAX_PATCHES)
]
