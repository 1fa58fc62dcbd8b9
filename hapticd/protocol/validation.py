"""Objects and materials of a message, validated: what handlers take, and every fault where a parameter beside them is
faulty, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from pydantic import ValidationError

from hapticd.base.errors import InvalidError, Path, Problem, known_names, path_text
from hapticd.base.merge_patch import merge_patch
from hapticd.base.model import MAX_FAULTS
from hapticd.config.materials import MAX_MATERIALS, Material, Materials, shipped_materials, validate_materials
from hapticd.config.patches import Patch
from hapticd.config.scene import MAX_OBJECTS, Scene, SceneObject, validate_object, validate_scene

_Working = Callable[[], None]


def _kept_patches(before: SceneObject | None, patch: object) -> Sequence[Patch] | None:
    """The patches of a wall that a merge patch says nothing of; None where there are none, or it does."""
    if before is None or before.kind != "wall" or not isinstance(patch, dict):
        return None
    if "patches" in patch or patch.get("kind", "wall") != "wall":
        return None
    return before.patches or None


def _same_kind(before: SceneObject, patch: object) -> SceneObject | None:
    """An object with some of its keys replaced, as most patches do: it is not written out and read again, and its kind
    need not be found. None: it is another patch, or faulty."""
    if not isinstance(patch, dict) or len(patch) > len(before.__dict__) or "kind" in patch or "patches" in patch:
        return None
    for value in patch.values():
        if value is None or isinstance(value, dict):
            return None
    try:
        return type(before).parsed({**before.__dict__, **patch})
    except ValidationError:
        return None


def patched_objects(given: Mapping[str, object], scene: Scene) -> dict[str, SceneObject | None]:
    """What merge patches make of objects; None for those that go. Raises InvalidError with the faults of all."""
    changes: dict[str, SceneObject | None] = {}
    problems: list[Problem] = []
    if len(given) > MAX_OBJECTS:
        raise InvalidError([Problem("objects", f"must hold at most {MAX_OBJECTS} entries, holds {len(given)}")])
    for id, patch in given.items():
        if len(problems) > MAX_FAULTS:
            problems.append(Problem("objects", "the rest was not looked at"))
            break
        before = scene.objects.get(id)
        if patch is None:
            if before is not None:
                changes[id] = None
            continue
        if before is not None and (item := _same_kind(before, patch)) is not None:
            changes[id] = item
            continue
        # Thousands of patches are not written out and validated again where nothing is said of them.
        kept = _kept_patches(before, patch)
        old = None if before is None else before.to_dict() if kept is None else before.to_dict({"patches"})
        merged = merge_patch(old, cast(Any, patch))
        if before is None and isinstance(merged, dict) and "kind" not in merged:
            problems.append(Problem(path_text(("objects", id)), _no_object(id, scene)))
            continue
        try:
            item = validate_object(id, merged)
            changes[id] = item if kept is None else item.model_copy(update={"patches": kept})
        except InvalidError as error:
            problems += error.problems
    if problems:
        raise InvalidError(problems)
    return changes


def _no_object(id: str, scene: Scene) -> str:
    """Why nothing can be merged into the object: there is none."""
    if id in Scene.model_fields:
        return "there is no object of this id: it is a key of the scene; set_scene changes it, with the whole scene"
    told = known_names(id, scene.objects) if scene.objects else "the scene has none"
    return f"there is no object of this id, and a new one needs a kind; {told}"


def whole_materials(given: Mapping[str, object], before: Materials, working: _Working) -> dict[str, Material]:
    """All materials once those given took their places. Raises InvalidError."""
    told = "must be a mapping, is null; update_materials removes a material"
    problems = [Problem(path_text(("materials", name)), told) for name, each in given.items() if each is None]
    materials = dict(before)
    try:
        materials.update(
            validate_materials({name: each for name, each in given.items() if each is not None}, working=working)
        )
    except InvalidError as error:
        problems += error.problems
    if problems:
        raise InvalidError(problems)
    return _not_too_many(materials)


def patched_materials(
    given: Mapping[str, object], before: Materials, working: _Working
) -> tuple[dict[str, Material], list[str]]:
    """All materials once those given were merged or removed, and the names of the merged. Raises InvalidError."""
    materials, shipped = dict(before), shipped_materials()
    patched: dict[str, object] = {}
    for name, patch in given.items():
        if patch is None:
            materials.pop(name, None)
            if name in shipped:
                materials[name] = shipped[name]
        else:
            old = before.get(name)
            patched[name] = merge_patch(None if old is None else old.to_dict(), cast(Any, patch))
    materials.update(validate_materials(patched, working=working))
    return _not_too_many(materials), list(patched)


def _not_too_many(materials: dict[str, Material]) -> dict[str, Material]:
    if len(materials) > MAX_MATERIALS:
        problem = f"must hold at most {MAX_MATERIALS} entries, holds {len(materials)}"
        raise InvalidError([Problem("materials", problem)])
    return materials


def faults_beside(
    method: str, params: Mapping[str, object], scene: Scene, materials: Materials, working: _Working
) -> list[Problem]:
    """Faults of the scene, objects and materials in parameters of which others are faulty, so that all are reported."""
    objects, given = params.get("objects"), params.get("materials")
    problems: list[Problem] = []

    def look(validate: Callable[[], object]) -> None:
        try:
            validate()
        except InvalidError as error:
            problems.extend(error.problems)

    if method == "update_scene" and isinstance(objects, dict):
        look(lambda: patched_objects(objects, scene))
    if method in ("set_materials", "apply") and isinstance(given, dict):
        look(lambda: whole_materials(given, materials, working))
    if method == "update_materials" and isinstance(given, dict):
        look(lambda: patched_materials(given, materials, working))
    if method in ("set_scene", "apply") and "scene" in params:
        root: Path = ("scene",)
        look(lambda: validate_scene(params["scene"], root, working))
    return problems
