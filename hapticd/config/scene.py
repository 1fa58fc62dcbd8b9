"""Scenes: the objects in the workspace, and which of their forces are displayed.

The workspace is a plane, x to the right and y up, in m. A normal points out of the solid into free space.
"""

import math
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Final, Literal, Self, TypeAlias, get_args

from pydantic import AfterValidator, Field, Strict, ValidationError, model_validator

from hapticd.base import arguments
from hapticd.base.errors import InvalidError, Path, Problem, known_names, path_text, quoted
from hapticd.base.model import (
    MAX_FAULTS,
    Damping,
    Model,
    Name,
    Position,
    Stiffness,
    at_most,
    check_count,
    entry_by_entry,
    faults_of,
    plain,
    problems_of,
    refuse_many_keys,
)
from hapticd.base.steps import Steps, finish
from hapticd.base.yaml_source import Document, load_path
from hapticd.config.document_kinds import refuse_other_keys, refuse_other_kinds

MAX_OBJECTS: Final = 10_000
"""Maximum number of objects: the last step of a change then takes the command thread 100 ms (docs/adr/0058)."""
MAX_PATCHES: Final = 512
"""Maximum number of patches of a wall."""
MAX_SCENE_PATCHES: Final = 5000
"""Maximum number of patches of a scene: a change's last step then takes the command thread 50 ms (docs/adr/0058)."""
MIN_PATCH_M: Final = 1e-5
"""Minimum width of a patch, and of a gap between patches."""
TOUCHING_DISTANCE_M: Final = 1e-9
"""Edges of patches at a smaller distance count as touching, since 0.1 + 0.2 is not 0.3 in floating point.

HD_FLUSH_M of the C core is the same for faces of solids."""
_ROUNDING_OF_WIDTHS: Final = 1e-6
"""Relative tolerance of the minimum width MIN_PATCH_M, for rounding."""
_MAX_SHOWN_OVERLAPS: Final = 5
"""Largest number of overlaps that a message lists; the others are counted."""
MIN_NORMAL_LENGTH = 1e-9
"""Minimum length of a normal before normalization."""
MAX_NORMAL_COMPONENT = 1e9
"""Maximum magnitude of a normal's component before normalization."""
UNIT_LENGTH_TOLERANCE: Final = 4 * 2.0**-52
"""Maximum difference between 1 and the length of a unit vector."""


def _unit(vector: tuple[float, float]) -> tuple[float, float]:
    length = math.hypot(*vector)
    if length < MIN_NORMAL_LENGTH:
        raise ValueError(f"must have a direction: a length of at least {MIN_NORMAL_LENGTH:g}, has {length:g}")
    # Normalizing a unit vector would only change its last bit.
    if abs(length - 1) <= UNIT_LENGTH_TOLERANCE:
        return vector
    return vector[0] / length, vector[1] / length


NormalComponent: TypeAlias = Annotated[float, Field(ge=-MAX_NORMAL_COMPONENT, le=MAX_NORMAL_COMPONENT)]
Normal: TypeAlias = Annotated[tuple[NormalComponent, NormalComponent], Strict(False), AfterValidator(_unit)]
Side: TypeAlias = Annotated[float, Field(ge=1e-4, le=20)]
Size: TypeAlias = Annotated[tuple[Side, Side], Strict(False)]
ForceComponent: TypeAlias = Annotated[float, Field(ge=-100, le=100)]
ForceVector: TypeAlias = Annotated[tuple[ForceComponent, ForceComponent], Strict(False)]


PatchEdge: TypeAlias = Annotated[float, Field(ge=-20, le=20)]


class Patch(Model):
    """A section of a wall with another material."""

    from_m: PatchEdge = Field(
        description="Beginning of the patch: distance from the wall's point along (n_y, -n_x), on a floor to the right."
    )
    to_m: PatchEdge = Field(description="End of the patch, in the same direction; more than from_m.")
    material: Name = Field(description="Name of a material.")

    @model_validator(mode="after")
    def _is_wide_enough(self) -> Self:
        if self.to_m - self.from_m < MIN_PATCH_M * (1 - _ROUNDING_OF_WIDTHS):
            raise ValueError(
                f"to_m must be at least {MIN_PATCH_M:g} above from_m, is {self.to_m:.15g}; from_m is {self.from_m:.15g}"
            )
        return self


def patches_in_order(patches: Sequence[Patch]) -> list[int]:
    """Return the indices of patches in rising order along the wall."""
    return sorted(range(len(patches)), key=lambda index: patches[index].from_m)


def _disjoint(patches: tuple[Patch, ...]) -> tuple[Patch, ...]:
    """Raise ValueError if patches overlap or leave gaps narrower than MIN_PATCH_M."""
    faults = []
    farthest, end_m = -1, -math.inf
    for index in patches_in_order(patches):
        gap = patches[index].from_m - end_m
        names = f"[{min(farthest, index)}] and [{max(farthest, index)}]"
        if gap < -TOUCHING_DISTANCE_M:
            faults.append(f"{names} overlap")
        elif TOUCHING_DISTANCE_M < gap < MIN_PATCH_M * (1 - _ROUNDING_OF_WIDTHS):
            faults.append(f"{names} leave a gap of {gap:.3g} m: it must be 0 or at least {MIN_PATCH_M:g} m")
        if patches[index].to_m > end_m:
            farthest, end_m = index, patches[index].to_m
    if faults:
        more = len(faults) - _MAX_SHOWN_OVERLAPS
        raise ValueError("; ".join(faults[:_MAX_SHOWN_OVERLAPS]) + (f"; and {more} more" if more > 0 else ""))
    return patches


Patches: TypeAlias = Annotated[
    tuple[Patch, ...],
    Strict(False),
    Field(max_length=MAX_PATCHES),
    AfterValidator(_disjoint),
    at_most(MAX_PATCHES),
]


class Wall(Model):
    """A half-plane of material: everything behind the line through `point_m`."""

    kind: Literal["wall"]
    point_m: Position = Field(description="A point of the surface, [x, y].")
    normal: Normal = Field(description="Direction out of the solid, [x, y]; kept as a unit vector.")
    material: Name = Field(description="Name of a material.")
    patches: Patches = Field(default=(), description="Sections with other materials, which do not overlap.")
    patch_ramp_m: float = Field(
        default=0.001, ge=1e-5, le=1, description="Width of the blend between two materials, centred on the edge."
    )

    def stretches(self) -> tuple[list[float], list[str]]:
        """Return the start coordinates in m and the materials of all sections of the wall, in rising order.

        Sections are the patches and the base material between them. The first starts at -inf, the last has no end.
        """
        begins, materials = [-math.inf], [self.material]
        for index in patches_in_order(self.patches):
            patch = self.patches[index]
            if patch.from_m - begins[-1] <= TOUCHING_DISTANCE_M:  # no base material between two touching patches
                begins.pop()
                materials.pop()
            begins += patch.from_m, patch.to_m
            materials += patch.material, self.material
        return begins, materials


class Box(Model):
    """A solid rectangle."""

    kind: Literal["box"]
    center_m: Position = Field(description="Centre, [x, y].")
    size_m: Size = Field(description="Lengths of the sides, [width, height].")
    angle_rad: float = Field(default=0.0, ge=-1000, le=1000, description="Angle of rotation, counterclockwise.")
    material: Name = Field(description="Name of a material.")


class Disc(Model):
    """A solid disc."""

    kind: Literal["disc"]
    center_m: Position = Field(description="Centre, [x, y].")
    radius_m: float = Field(
        ge=1e-4,
        le=10,
        description="Radius R. A force above stiffness times R pushes the probe through to the other side.",
    )
    material: Name = Field(description="Name of a material.")


class Membrane(Model):
    """A straight elastic membrane that can be pushed from both sides and, with `rupture`, punctured."""

    kind: Literal["membrane"]
    center_m: Position = Field(description="Centre, [x, y].")
    normal: Normal = Field(description="Direction across the membrane, [x, y]; kept as a unit vector.")
    width_m: float = Field(ge=1e-4, le=20, description="Length of the membrane.")
    material: Name = Field(description="Name of a material; without `rupture` the membrane never breaks.")


class Spring(Model):
    """A field that pulls to a point and damps all motion."""

    kind: Literal["spring"]
    center_m: Position = Field(description="Where the force is zero, [x, y].")
    stiffness_n_per_m: Stiffness = Field(description="Force per distance from the centre.")
    damping_n_s_per_m: Damping = Field(default=0.0, description="Force against motion, per speed.")


class Viscous(Model):
    """A field that damps all motion."""

    kind: Literal["viscous"]
    damping_n_s_per_m: Damping = Field(description="Force against motion, per speed.")


class Constant(Model):
    """A field with the same force everywhere."""

    kind: Literal["constant"]
    force_n: ForceVector = Field(description="The force, [x, y].")


Surface: TypeAlias = Wall | Membrane | Box | Disc
"""An object that can be touched."""
Passivity: TypeAlias = Literal["off", "observe", "control"]
SceneObject: TypeAlias = Surface | Spring | Viscous | Constant
SURFACE_MODELS: Final = (Wall, Membrane, Box, Disc)
"""Models of the objects that can be touched."""
SURFACE_KINDS: Final = tuple(tag for kind in SURFACE_MODELS for tag in get_args(kind.model_fields["kind"].annotation))
"""Values of `kind` of objects that can be touched."""


def materials_of(item: SceneObject) -> tuple[str, ...]:
    """Return the names of an object's materials: its base material, then those of its patches; () for a field."""
    # Compared by kind, since isinstance of a pydantic model is slow when it is false.
    if item.kind == "wall" and item.patches:
        return (item.material, *(patch.material for patch in item.patches))
    if item.kind == "spring" or item.kind == "viscous" or item.kind == "constant":
        return ()
    return (item.material,)


def material_names(item: SceneObject) -> Collection[str]:
    """Return the names of an object's materials, each once."""
    return dict.fromkeys(materials_of(item))


def same_materials(one: SceneObject | None, other: SceneObject) -> bool:
    """Return whether two objects have the same materials at the same positions."""
    if one is None or one.kind != other.kind:
        return False
    if one.kind == "wall":
        return one.material == other.material and one.patches == other.patches  # type: ignore[union-attr]
    return getattr(one, "material", None) == getattr(other, "material", None)


def material_places(item: SceneObject) -> Iterator[tuple[str, Path]]:
    """Yield each material of an object once, with the path of its first use."""
    if item.kind == "spring" or item.kind == "viscous" or item.kind == "constant":
        return
    seen = {item.material}
    yield item.material, ("material",)
    for index, patch in enumerate(item.patches if item.kind == "wall" else ()):
        if patch.material not in seen:
            seen.add(patch.material)
            yield patch.material, ("patches", index, "material")


def field_ids(objects: Mapping[str, SceneObject]) -> list[str]:
    """Return the ids of the force fields that depend on position or speed: springs and viscous fields."""
    return [id for id, item in objects.items() if item.kind == "spring" or item.kind == "viscous"]


def used_materials(objects: Iterable[SceneObject]) -> set[str]:
    """Return the names of all materials of these objects."""
    return {name for item in objects for name in material_names(item)}


def of_all_materials(objects: Mapping[str, SceneObject]) -> dict[str, SceneObject]:
    """Return objects with all materials: those with several materials, and the first of each other material."""
    selected: dict[str, SceneObject] = {}
    seen: set[str] = set()
    for id, item in objects.items():
        names = material_names(item)
        if len(names) > 1 or not seen.issuperset(names):
            seen.update(names)
            selected[id] = item
    return selected


class Display(Model):
    """Parts of the force that are displayed."""

    force: bool = Field(default=True, description="Forces of objects and fields.")
    vibration: bool = Field(default=True, description="Ringing modes and the noise of textures.")


def _patches_fault(objects: Mapping[str, SceneObject]) -> str | None:
    """Return the fault of objects that together have more patches than a scene may have, or None."""
    patches = sum(len(item.patches) for item in objects.values() if item.kind == "wall")
    too_many = f"must have at most {MAX_SCENE_PATCHES} patches in all, have {patches}"
    return too_many if patches > MAX_SCENE_PATCHES else None


class Scene(Model):
    """Objects by id, and settings of their display."""

    display: Display = Field(default=Display(), description="Force only, vibration only, or both.")
    ramp_s: float = Field(
        default=0.02, ge=0.001, le=1, description="Duration of the ramp of a force that would otherwise step."
    )
    passivity: Passivity = Field(
        default="off",
        description="The energy that touched objects give to the hand is ignored, observed, or limited.",
    )
    objects: dict[Name, Annotated[SceneObject, Field(discriminator="kind")]] = Field(
        default={}, max_length=MAX_OBJECTS, description="Objects and fields by id."
    )

    @model_validator(mode="after")
    def _has_not_too_many_patches(self) -> Self:
        fault = _patches_fault(self.objects)
        if fault is not None:
            raise ValueError(f"objects {fault}")
        return self

    def changed_since(self, before: "Scene") -> list[str]:
        """Return the ids of the objects that were changed, added or removed since the scene `before`."""
        old, new = before.objects, self.objects
        return [id for id, item in new.items() if old.get(id) != item] + [id for id in old if id not in new]

    def with_objects(self, changes: Mapping[str, SceneObject | None]) -> "Scene":
        """Return this scene with objects added or replaced, and those given as None removed.

        The objects must be validated (see validate_object); unchanged objects are shared. Raises InvalidError for more
        than MAX_OBJECTS objects or MAX_SCENE_PATCHES patches.
        """
        objects = dict(self.objects)
        for name, changed in changes.items():
            if changed is None:
                objects.pop(name, None)
            else:
                objects[name] = changed
        check_count(objects, MAX_OBJECTS, ("objects",))
        # Patches are counted only if one has changed: counting costs more than the rest of an update.
        if any(changed is not None and changed.kind == "wall" and changed.patches for changed in changes.values()):
            fault = _patches_fault(objects)
            if fault is not None:
                raise InvalidError([Problem("objects", fault)])
        # Copied by hand: pydantic's methods cost more than the rest of an update.
        scene = Scene.__new__(Scene)
        values = {**self.__dict__, "objects": objects}
        for slot, value in (
            ("__dict__", values),
            ("__pydantic_fields_set__", set(values)),
            ("__pydantic_extra__", None),
            ("__pydantic_private__", None),
        ):
            object.__setattr__(scene, slot, value)
        return scene


SceneSource: TypeAlias = "Scene | Mapping[str, object] | str | os.PathLike[str]"


def load_scene(source: SceneSource) -> Scene:
    """Load a scene from a mapping or a YAML file, which holds the keys of a scene, or a key `scene` with them.

    Whether the scene's materials exist is not checked here: see reference_problems. Raises InvalidError, with file
    and line for a file; HapticdError for a file that cannot be read.
    """
    return source if isinstance(source, Scene) else read_scene(source)[0]


def read_scene(source: Mapping[str, object] | str | os.PathLike[str]) -> tuple[Scene, Document, Path]:
    """Load a scene as load_scene does; return the scene, its document, and the scene's path in the document."""
    document = Document(plain(source)) if isinstance(source, Mapping) else load_path(arguments.path("scene", source))
    refuse_other_kinds(document, "scene", "bare scene")
    data = document.data
    root: Path = ()
    if isinstance(data, dict) and "scene" in data:
        refuse_other_keys(document, (), data, "scene")
        data, root = data["scene"], ("scene",)
    try:
        return Scene.parsed(data), document, root
    except ValidationError as error:
        faults = faults_of(error)
        raise InvalidError(document.problem(root + path, text) for path, text in faults) from None


def validate_scene(data: object, root: Path = ()) -> Scene:
    """Validate a scene, given as plain data. Raises InvalidError with paths that begin with `root`."""
    return finish(scene_steps(data, root))


def scene_steps(data: object, root: Path = ()) -> Steps[Scene]:
    """Validate a scene as validate_scene does, with a pause after each object."""
    given = data.get("objects", {}) if isinstance(data, dict) else None
    if not isinstance(data, dict) or not isinstance(given, dict):
        return _parsed(data, root)
    check_count(given, MAX_OBJECTS, (*root, "objects"))
    problems: list[Problem] = []
    scene, objects = Scene(), dict[str, SceneObject]()
    try:
        scene = _parsed({key: value for key, value in data.items() if key != "objects"}, root)
    except InvalidError as error:
        problems += error.problems
    try:
        objects = yield from entry_by_entry(
            given, lambda part: _parsed({"objects": part}, root).objects, (*root, "objects")
        )
    except InvalidError as error:
        problems += error.problems
    if problems:
        raise InvalidError(problems)
    return scene.with_objects(objects)


def _parsed(data: object, root: Path) -> Scene:
    refuse_many_keys(data, root)
    try:
        return Scene.parsed(data)
    except ValidationError as error:
        raise InvalidError(problems_of(error, root)) from None


def validate_object(name: str, data: object, root: Path = ()) -> SceneObject:
    """Validate an object, given as plain data. Raises InvalidError with paths that begin with `root`."""
    return _parsed({"objects": {name: data}}, root).objects[name]


def reference_faults(objects: Mapping[str, SceneObject], materials: Collection[str]) -> list[tuple[Path, str]]:
    """Return the faults of objects with unknown materials, at most MAX_FAULTS, with paths relative to the scene."""
    faults: list[tuple[Path, str]] = []
    more = 0
    for id, item in objects.items():
        if all(name in materials for name in material_names(item)):
            continue
        for index, name in enumerate(materials_of(item)):
            if name in materials:
                continue
            if len(faults) == MAX_FAULTS:
                more += 1
                continue
            path: Path = ("objects", id, *(("patches", index - 1) if index else ()), "material")
            faults.append((path, f"unknown material {quoted(name)}; {known_names(name, materials)}"))
    if more:
        faults.append((("objects",), f"have {more} more unknown materials"))
    return faults


def reference_problems(
    objects: Mapping[str, SceneObject], materials: Collection[str], root: Path = ()
) -> list[Problem]:
    """Return a problem for each unknown material of an object; its path begins with `root`, then `objects`."""
    return [Problem(path_text(root + path), text) for path, text in reference_faults(objects, materials)]
