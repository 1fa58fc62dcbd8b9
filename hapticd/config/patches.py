"""Patches of a wall: stretches of other materials, tens of thousands of them in a few numbers each.

A model for each would take half a kilobyte, most of it for what all of them have alike, and be let go one by one.
"""

import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, TypeAlias, cast, overload

from pydantic import (
    Field,
    PlainSerializer,
    Strict,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from hapticd.base.codec import Encoded
from hapticd.base.model import AT_ONCE, MAX_FAULTS, Model, Name
from hapticd.base.yaml_source import Json

MAX_PATCHES: Final = 2**16
"""Of a wall; address room too."""
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


class Patches(Sequence[Patch]):
    """Patches as they were given; equal to a tuple of them. What follows from all of them is found once."""

    def __init__(self, patches: Iterable[Patch] = ()) -> None:
        self.begins_m = array("d")
        """Where each begins,"""
        self.ends_m = array("d")
        """and ends."""
        self._material = array("I")
        self.narrow: tuple[float, list[tuple[int, str]]] | None = None
        """A ramp, and what is too narrow for it (displayable.patch_warnings)."""
        self.encoded: Encoded | None = None
        """msgpack of all of them, once it was asked for (protocol/encoded_scene.py)."""
        numbers: dict[str, int] = {}
        first: dict[str, int] = {}
        for index, patch in enumerate(patches):
            self.begins_m.append(patch.from_m)
            self.ends_m.append(patch.to_m)
            self._material.append(numbers.setdefault(patch.material, len(numbers)))
            first.setdefault(patch.material, index)
        self._names = tuple(numbers)
        self.first: Mapping[str, int] = MappingProxyType(first)
        """Their materials, and the index of the first patch of each."""
        self.order = array("I", sorted(range(len(self.begins_m)), key=self.begins_m.__getitem__))
        """Their indices, in rising order along the wall."""

    def material(self, index: int) -> str:
        """The name of a patch's material."""
        return self._names[self._material[index]]

    def texts(self) -> Iterator[dict[str, Json]]:
        """Each as plain data, one at a time: no list of all of them is made."""
        for from_m, to_m, number in zip(self.begins_m, self.ends_m, self._material, strict=True):
            yield {"from_m": from_m, "to_m": to_m, "material": self._names[number]}

    def __len__(self) -> int:
        return len(self.begins_m)

    @overload
    def __getitem__(self, index: int) -> Patch: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Patch, ...]: ...
    def __getitem__(self, index: int | slice) -> Patch | tuple[Patch, ...]:
        if isinstance(index, slice):
            return tuple(self[each] for each in range(*index.indices(len(self))))
        return Patch.model_construct(
            from_m=self.begins_m[index], to_m=self.ends_m[index], material=self.material(index)
        )

    def __iter__(self) -> Iterator[Patch]:
        return map(self.__getitem__, range(len(self)))

    def _key(self) -> tuple[object, ...]:
        # Numbers by their names in order: equal patches have equal ones.
        return self.begins_m, self.ends_m, self._material, self._names

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Patches):
            return self is other or self._key() == other._key()
        return tuple(self) == other if isinstance(other, tuple) else NotImplemented

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        return repr(tuple(self))

    def __reduce__(self) -> tuple[type[Self], tuple[tuple[Patch, ...]]]:
        return type(self), (tuple(self),)


def patches_of(given: Sequence[Patch]) -> Patches:
    """The patches of a wall, as they were kept if they were validated."""
    return given if isinstance(given, Patches) else Patches(given)


def _validated(given: object, handler: ValidatorFunctionWrapHandler) -> Sequence[Patch]:
    """Thousands of patches, each alone: nobody waits for all of them, or reads the faults of all."""
    if isinstance(given, Patches):
        return given
    if given == [] or given == ():
        return ()  # what has none is asked often
    if isinstance(given, list) and AT_ONCE < len(given) <= MAX_PATCHES:
        try:
            return _apart(Patches(map(Patch.parsed, given)))
        except ValidationError:
            given = list(_faulty(given))
    return _apart(Patches(cast(Iterable[Patch], handler(given))))


def _faulty(given: list[object]) -> Iterator[object]:
    """Those that are validated, and the first MAX_FAULTS that cannot be, for their faults to be reported."""
    faulty = 0
    for patch in given:
        try:
            yield Patch.parsed(patch)
        except ValidationError:
            yield patch
            faulty += 1
            if faulty == MAX_FAULTS:
                return


def _apart(patches: Patches) -> Patches:
    """Refuses patches that overlap, or leave gaps that nobody means."""
    faults = []
    farthest, end_m = -1, -math.inf
    for index in patches.order:
        gap = patches.begins_m[index] - end_m
        names = f"[{min(farthest, index)}] and [{max(farthest, index)}]"
        if gap < -TOUCHING_M:
            faults.append(f"{names} overlap")
        elif TOUCHING_M < gap < MIN_PATCH_M * (1 - _ROUNDING_OF_WIDTHS):
            faults.append(f"{names} leave a gap of {gap:.3g} m: they touch, or are at least {MIN_PATCH_M:g} m apart")
        if patches.ends_m[index] > end_m:
            farthest, end_m = index, patches.ends_m[index]
    if faults:
        more = len(faults) - _SHOWN_OVERLAPS
        raise ValueError("; ".join(faults[:_SHOWN_OVERLAPS]) + (f"; and {more} more" if more > 0 else ""))
    return patches


def _texts(patches: Any) -> list[dict[str, Json]]:
    return list(patches_of(patches).texts())


if TYPE_CHECKING:
    GivenPatches: TypeAlias = Sequence[Patch]
else:  # what pydantic makes of it; messages and the JSON Schema speak of a list
    GivenPatches = Annotated[
        tuple[Patch, ...],
        Strict(False),
        Field(max_length=MAX_PATCHES),
        WrapValidator(_validated),
        PlainSerializer(_texts, return_type=list),
    ]
