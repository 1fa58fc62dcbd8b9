"""Scenes: the objects in the workspace, and what of them is displayed.

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
"""The last step of a change keeps the command thread for some 100 ms then (docs/adr/0058)."""
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
MIN_NORMAL_LENGTH = 1e-9
MAX_NORMAL_COMPONENT = 1e9
_ROUNDING: Final = 4 * 2.0**-52


def _unit(vector: tuple[float, float]) -> tuple[float, float]:
    length = math.hypot(*vector)
    if length < MIN_NORMAL_LENGTH:
        raise ValueError(f"must have a direction: a length of at least {MIN_NORMAL_LENGTH:g}, has {length:g}")
    if abs(length - 1) <= _ROUNDING:  # already a unit vector: normalising again would only move its last bit
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


def patches_in_order(patches: Sequence[Patch]) -> list[int]:
    """Their indices, in rising order along the wall."""
    return sorted(range(len(patches)), key=lambda index: patches[index].from_m)


def _disjoint(patches: tuple[Patch, ...]) -> tuple[Patch, ...]:
    """Refuses patches that overlap, or leave gaps that nobody means."""
    faults = []
    farthest, end_m = -1, -math.inf
    for index in patches_in_order(patches):
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
    patches: Patches = Field(default=(), description="Stretches of other materials; they do not overlap.")
    patch_ramp_m: float = Field(
        default=0.001, ge=1e-5, le=1, description="Over which one material goes over into the next, across the edge."
    )

    def stretches(self) -> tuple[list[float], list[str]]:
        """The whole wall in rising order, patches and the base material between them: where each stretch begins, -inf
        for the first, and its material. The last one has no end."""
        begins, materials = [-math.inf], [self.material]
        for index in patches_in_order(self.patches):
            patch = self.patches[index]
            if patch.from_m - begins[-1] <= TOUCHING_M:  # the base material has no room between two patches
                begins.pop()
                materials.pop()
            begins += patch.from_m, patch.to_m
            materials += patch.material, self.material
        return begins, materials


class Box(Model):
    """A solid rectangle."""

    kind: Literal["box"]
    center_m: Position = Field(description="Its middle, [x, y].")
    size_m: Size = Field(description="Its sides, [width, height].")
    angle_rad: float = Field(
        default=0.0, ge=-1000, le=1000, description="Angle by which it is turned counterclockwise."
    )
    material: Name = Field(description="Name of a material.")


class Disc(Model):
    """A solid disc."""

    kind: Literal["disc"]
    center_m: Position = Field(description="Its middle, [x, y].")
    radius_m: float = Field(
        ge=1e-4,
        le=10,
        description="Its radius R. A hand that presses harder than stiffness times R comes out on the other side.",
    )
    material: Name = Field(description="Name of a material.")


class Membrane(Model):
    """A straight elastic skin that can be pushed from both sides and, by its material, punctured."""

    kind: Literal["membrane"]
    center_m: Position = Field(description="Its middle, [x, y].")
    normal: Normal = Field(description="Direction across the skin, [x, y]; kept as a unit vector.")
    width_m: float = Field(ge=1e-4, le=20, description="Its length along the skin.")
    material: Name = Field(description="Name of a material; without rupture the skin never breaks.")


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
    """A field that pushes everywhere alike."""

    kind: Literal["constant"]
    force_n: ForceVector = Field(description="The force, [x, y].")


Surface: TypeAlias = Wall | Membrane | Box | Disc
"""What can be touched."""
Passivity: TypeAlias = Literal["off", "observe", "control"]
SceneObject: TypeAlias = Surface | Spring | Viscous | Constant
SURFACES: Final = (Wall, Membrane, Box, Disc)
SURFACE_KINDS: Final = tuple(tag for kind in SURFACES for tag in get_args(kind.model_fields["kind"].annotation))


def materials_of(item: SceneObject) -> tuple[str, ...]:
    """Names of the materials that an object is made of: its own first, then its patches'; none for a field."""
    # By kind: isinstance of a pydantic model that an object is not takes longer than all the rest.
    if item.kind == "wall" and item.patches:
        return (item.material, *(patch.material for patch in item.patches))
    if item.kind == "spring" or item.kind == "viscous" or item.kind == "constant":
        return ()
    return (item.material,)


def material_names(item: SceneObject) -> Collection[str]:
    """As materials_of, each once."""
    return dict.fromkeys(materials_of(item))


def same_materials(one: SceneObject | None, other: SceneObject) -> bool:
    """Whether two objects are surely made of the same materials, in the same places."""
    if one is None or one.kind != other.kind:
        return False
    if one.kind == "wall":
        return one.material == other.material and one.patches == other.patches  # type: ignore[union-attr]
    return getattr(one, "material", None) == getattr(other, "material", None)


def material_places(item: SceneObject) -> Iterator[tuple[str, Path]]:
    """The materials of an object, each once, and where it first names them."""
    if item.kind == "spring" or item.kind == "viscous" or item.kind == "constant":
        return
    seen = {item.material}
    yield item.material, ("material",)
    for index, patch in enumerate(item.patches if item.kind == "wall" else ()):
        if patch.material not in seen:
            seen.add(patch.material)
            yield patch.material, ("patches", index, "material")


def field_ids(objects: Mapping[str, SceneObject]) -> list[str]:
    """Ids of the fields that follow position or speed."""
    return [id for id, item in objects.items() if item.kind == "spring" or item.kind == "viscous"]


def used_materials(objects: Iterable[SceneObject]) -> set[str]:
    """Names of all materials that these objects are made of."""
    return {name for item in objects for name in material_names(item)}


def of_all_materials(objects: Mapping[str, SceneObject]) -> dict[str, SceneObject]:
    """The objects that say all there is to say of a scene's materials: patched ones, and the first of each material."""
    found: dict[str, SceneObject] = {}
    seen: set[str] = set()
    for id, item in objects.items():
        names = material_names(item)
        if len(names) > 1 or not seen.issuperset(names):
            seen.update(names)
            found[id] = item
    return found


class Display(Model):
    """Which parts of the force are displayed."""

    force: bool = Field(default=True, description="Forces of objects and fields.")
    vibration: bool = Field(default=True, description="Ringing modes and the noise of textures.")


def _patches_fault(objects: Mapping[str, SceneObject]) -> str | None:
    """Why the patches of these objects are too many for a scene; None where they are not."""
    patches = sum(len(item.patches) for item in objects.values() if item.kind == "wall")
    too_many = f"must have at most {MAX_SCENE_PATCHES} patches in all, have {patches}"
    return too_many if patches > MAX_SCENE_PATCHES else None


class Scene(Model):
    """Objects by id, and how they are displayed."""

    display: Display = Field(default=Display(), description="Force only, vibration only, or both.")
    ramp_s: float = Field(
        default=0.02, ge=0.001, le=1, description="Time in which a force comes in that would otherwise step."
    )
    passivity: Passivity = Field(
        default="off",
        description="The energy that touched objects give to the hand: not looked at, observed, or held down.",
    )
    objects: dict[Name, Annotated[SceneObject, Field(discriminator="kind")]] = Field(
        default={}, max_length=MAX_OBJECTS, description="What is in the workspace, by id."
    )

    @model_validator(mode="after")
    def _has_not_too_many_patches(self) -> Self:
        fault = _patches_fault(self.objects)
        if fault is not None:
            raise ValueError(f"objects {fault}")
        return self

    def changed_since(self, before: "Scene") -> list[str]:
        """Ids of the objects that are not those of the scene before, and of those that are gone."""
        old, new = before.objects, self.objects
        return [id for id, item in new.items() if old.get(id) != item] + [id for id in old if id not in new]

    def with_objects(self, changes: Mapping[str, SceneObject | None]) -> "Scene":
        """This scene with some objects added or replaced, and those given as None removed.

        The objects are taken as validated (see validate_object); the others are the same instances as before.
        Raises InvalidError for more than MAX_OBJECTS, or MAX_SCENE_PATCHES of their patches.
        """
        objects = dict(self.objects)
        for name, changed in changes.items():
            if changed is None:
                objects.pop(name, None)
            else:
                objects[name] = changed
        check_count(objects, MAX_OBJECTS, ("objects",))
        # Without a changed patch the number cannot have grown, and counting would cost more than the rest of an update.
        if any(changed is not None and changed.kind == "wall" and changed.patches for changed in changes.values()):
            fault = _patches_fault(objects)
            if fault is not None:
                raise InvalidError([Problem("objects", fault)])
        # All is valid already; pydantic's ways to copy a model would cost more than the rest of an update.
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
    """A scene from a mapping or a YAML file that holds either a scene or a section `scene` and nothing else.

    Whether its materials exist is not checked here: see reference_problems. Raises InvalidError, with file
    and line for a file; HapticdError for a file that cannot be read.
    """
    return source if isinstance(source, Scene) else read_scene(source)[0]


def read_scene(source: Mapping[str, object] | str | os.PathLike[str]) -> tuple[Scene, Document, Path]:
    """As load_scene; also the document that it stands in, and where."""
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
    """A scene from plain data. Raises InvalidError; `where` begins with `root`."""
    return finish(scene_steps(data, root))


def scene_steps(data: object, root: Path = ()) -> Steps[Scene]:
    """As validate_scene, with a pause after each object."""
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
    """One object from plain data. Raises InvalidError; `where` starts with `root`, `objects`, `name`."""
    return _parsed({"objects": {name: data}}, root).objects[name]


def reference_faults(objects: Mapping[str, SceneObject], materials: Collection[str]) -> list[tuple[Path, str]]:
    """Materials that objects name and nobody defines, with paths relative to the scene; at most MAX_FAULTS."""
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
        faults.append((("objects",), f"name unknown materials {more} times more"))
    return faults


def reference_problems(
    objects: Mapping[str, SceneObject], materials: Collection[str], root: Path = ()
) -> list[Problem]:
    """As reference_faults; `where` begins with `root`, then `objects`."""
    return [Problem(path_text(root + path), text) for path, text in reference_faults(objects, materials)]
