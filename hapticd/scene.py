"""Scenes: the objects in the workspace, and what of them is displayed.

The workspace is a plane, x to the right and y up, in m. A normal points out of the solid into free space.
"""

import math
import os
from collections.abc import Collection, Mapping
from typing import Annotated, Literal, TypeAlias

from pydantic import AfterValidator, Field, Strict, ValidationError

from hapticd.errors import InvalidError, Path, Problem, known_names, path_text, quoted
from hapticd.model import Damping, Model, Name, Position, Stiffness, faults_of, plain, problems_of
from hapticd.yaml_source import Document, load_path

MAX_OBJECTS = 16384
MIN_NORMAL_LENGTH = 1e-9
MAX_NORMAL_COMPONENT = 1e9
_ROUNDING = 4 * 2.0**-52


def _unit(vector: tuple[float, float]) -> tuple[float, float]:
    length = math.hypot(*vector)
    if length < MIN_NORMAL_LENGTH:
        raise ValueError(f"must have a direction: a length of at least {MIN_NORMAL_LENGTH:g}, has {length:g}")
    if abs(length - 1) <= _ROUNDING:  # already a unit vector: normalising again would only move its last bit
        return vector
    return vector[0] / length, vector[1] / length


NormalComponent: TypeAlias = Annotated[float, Field(ge=-MAX_NORMAL_COMPONENT, le=MAX_NORMAL_COMPONENT)]
Normal: TypeAlias = Annotated[tuple[NormalComponent, NormalComponent], Strict(False), AfterValidator(_unit)]
ForceComponent: TypeAlias = Annotated[float, Field(ge=-100, le=100)]
ForceVector: TypeAlias = Annotated[tuple[ForceComponent, ForceComponent], Strict(False)]


class Wall(Model):
    """A half-plane of material: everything behind the line through `point_m`."""

    kind: Literal["wall"]
    point_m: Position = Field(description="A point of the surface, [x, y].")
    normal: Normal = Field(description="Direction out of the solid, [x, y]; kept as a unit vector.")
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


SceneObject: TypeAlias = Wall | Membrane | Spring | Viscous | Constant


class Display(Model):
    """Which parts of the force are displayed."""

    force: bool = Field(default=True, description="Forces of objects and fields.")
    vibration: bool = Field(default=True, description="Ringing modes.")


class Scene(Model):
    """Objects by id, and how they are displayed."""

    display: Display = Field(default=Display(), description="Force only, vibration only, or both.")
    ramp_s: float = Field(
        default=0.02, ge=0.001, le=1, description="Time in which a force comes in that would otherwise step."
    )
    objects: dict[Name, Annotated[SceneObject, Field(discriminator="kind")]] = Field(
        default={}, max_length=MAX_OBJECTS, description="What is in the workspace, by id."
    )

    def with_objects(self, changes: Mapping[str, SceneObject | None]) -> "Scene":
        """This scene with some objects added or replaced, and those given as None removed.

        The objects are taken as validated (see validate_object); the others are the same instances as before.
        Raises InvalidError for more than MAX_OBJECTS.
        """
        objects = dict(self.objects)
        for name, changed in changes.items():
            if changed is None:
                objects.pop(name, None)
            else:
                objects[name] = changed
        if len(objects) > MAX_OBJECTS:
            problem = f"must hold at most {MAX_OBJECTS} entries, holds {len(objects)}"
            raise InvalidError([Problem("objects", problem)])
        # All three are valid already; copying the model would cost more than the rest of an update.
        return Scene.model_construct(display=self.display, ramp_s=self.ramp_s, objects=objects)


SceneSource: TypeAlias = "Scene | Mapping[str, object] | str | os.PathLike[str]"


def load_scene(source: SceneSource) -> Scene:
    """A scene from a mapping or a YAML file that holds either a scene or a section `scene` and nothing else.

    Whether its materials exist is not checked here: see reference_problems. Raises InvalidError, with file
    and line for a file; HapticdError for a file that cannot be read.
    """
    if isinstance(source, Scene):
        return source
    document = Document(plain(source)) if isinstance(source, Mapping) else load_path(source)
    data = document.data
    root: Path = ()
    if isinstance(data, dict) and "scene" in data:
        others = [key for key in data if key != "scene"]
        if others:
            raise InvalidError(
                Problem(document.where((key,)), "does not belong to a scene, which is all that is taken here")
                for key in others
            )
        data, root = data["scene"], ("scene",)
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        faults = faults_of(error)
        raise InvalidError(Problem(document.where(root + path), text) for path, text in faults) from None


def validate_scene(data: object, root: Path = ()) -> Scene:
    """A scene from plain data. Raises InvalidError; `where` begins with `root`."""
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise InvalidError(problems_of(error, root)) from None


def validate_object(name: str, data: object, root: Path = ()) -> SceneObject:
    """One object from plain data. Raises InvalidError; `where` starts with `root`, `objects`, `name`."""
    return validate_scene({"objects": {name: data}}, root).objects[name]


def reference_faults(objects: Mapping[str, SceneObject], materials: Collection[str]) -> list[tuple[Path, str]]:
    """Materials that objects name and nobody defines, with paths relative to the scene."""
    return [
        (
            ("objects", name, "material"),
            f"unknown material {quoted(wanted)}; {known_names(wanted, materials)}",
        )
        for name, thing in objects.items()
        if isinstance(thing, Wall | Membrane) and (wanted := thing.material) not in materials
    ]


def reference_problems(
    objects: Mapping[str, SceneObject], materials: Collection[str], root: Path = ()
) -> list[Problem]:
    """As reference_faults; `where` begins with `root`, then `objects`."""
    return [Problem(path_text(root + path), text) for path, text in reference_faults(objects, materials)]
