"""Validation of objects and materials in a message, even if other params of the message are faulty."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, cast

from pydantic import ValidationError

from hapticd.base import wording
from hapticd.base.errors import InvalidError, Problem, known_names, path_text
from hapticd.base.merge_patch import merge_patch
from hapticd.base.model import MAX_FAULTS, check_count
from hapticd.base.steps import Steps
from hapticd.config.materials import MAX_MATERIALS, Material, Materials, material_steps, shipped_materials
from hapticd.config.scene import MAX_OBJECTS, Scene, SceneObject, scene_steps, validate_object

_OPTIONAL_PARTS: Final = ("tap", "rupture", "friction", "texture")
"""Keys of the parts of a material that it may lack."""


def _patched_directly(before: SceneObject, patch: object) -> SceneObject | None:
    """Return a scene object with the keys of `patch` replaced, faster than by a merge patch of its mapping.

    Returns None for a patch that needs the merge: it is faulty, has `kind` or `patches`, or has null or a mapping.
    """
    if not isinstance(patch, dict) or len(patch) > len(before.__dict__) or "kind" in patch or "patches" in patch:
        return None
    for value in patch.values():
        if value is None or isinstance(value, dict):
            return None
    try:
        return type(before).parsed({**before.__dict__, **patch})
    except ValidationError:
        return None


def patched_objects(given: Mapping[str, object], scene: Scene) -> Steps[dict[str, SceneObject | None]]:
    """Return the patched objects by id, None for removed ones; a generator that pauses after each object.

    Raises InvalidError with the faults of all objects.
    """
    changes: dict[str, SceneObject | None] = {}
    problems: list[Problem] = []
    check_count(given, MAX_OBJECTS, ("objects",))
    for id, patch in given.items():
        yield
        if len(problems) > MAX_FAULTS:
            problems.append(Problem("objects", "too many faults; the rest was not checked"))
            break
        before = scene.objects.get(id)
        if patch is None:
            if before is not None:
                changes[id] = None
            continue
        if before is not None and (item := _patched_directly(before, patch)) is not None:
            changes[id] = item
            continue
        merged = merge_patch(None if before is None else before.to_dict(), cast(Any, patch))
        if before is None and isinstance(merged, dict) and "kind" not in merged:
            problems.append(Problem(path_text(("objects", id)), _no_object(id, scene)))
            continue
        try:
            changes[id] = validate_object(id, merged)
        except InvalidError as error:
            problems += error.problems
    if problems:
        raise InvalidError(problems)
    return changes


def _no_object(id: str, scene: Scene) -> str:
    """Return the problem of a patch of an object that does not exist."""
    if id in Scene.model_fields:
        return "there is no object of this id: it is a key of the scene, which set_scene (`hapticd apply`) changes"
    known = known_names(id, scene.objects) if scene.objects else "the scene has no objects"
    return f"there is no object of this id, and a new one needs a kind; {known}"


def replaced_materials(given: Mapping[str, object], before: Materials) -> Steps[dict[str, Material]]:
    """Return all materials after replacing those given; a generator that pauses after each. Raises InvalidError."""
    check_count(given, MAX_MATERIALS, ("materials",))
    removed = "must be a mapping, is null; update_materials removes a material"
    problems = [Problem(path_text(("materials", name)), removed) for name, each in given.items() if each is None]
    materials = dict(before)
    try:
        materials.update((yield from material_steps({name: each for name, each in given.items() if each is not None})))
    except InvalidError as error:
        problems += error.problems
    if problems:
        raise InvalidError(problems)
    check_count(materials, MAX_MATERIALS, ("materials",))
    return materials


def dropped_parts(given: Iterable[str], materials: Materials, before: Materials) -> list[Problem]:
    """Return a warning for each replaced material without a part that the earlier material has, such as its tap."""
    problems = []
    for name in filter(before.__contains__, given):
        lacking = [
            part for part in _OPTIONAL_PARTS if getattr(before[name], part) and not getattr(materials[name], part)
        ]
        if lacking:
            text = f"no longer has the {wording.listed(lacking)} of the material that it replaces"
            problems.append(Problem(path_text(("materials", name)), text))
    return problems


def patched_materials(given: Mapping[str, object], before: Materials) -> Steps[tuple[dict[str, Material], list[str]]]:
    """Return all materials after merge patches, and the names of the patched ones; a generator that pauses after each.

    The value null removes a material, or restores it if it is shipped. Raises InvalidError.
    """
    check_count(given, MAX_MATERIALS, ("materials",))
    materials, shipped = dict(before), shipped_materials()
    patched: dict[str, object] = {}
    for name, patch in given.items():
        yield
        if patch is None:
            materials.pop(name, None)
            if name in shipped:
                materials[name] = shipped[name]
        else:
            old = before.get(name)
            patched[name] = merge_patch(None if old is None else old.to_dict(), cast(Any, patch))
    materials.update((yield from material_steps(patched)))
    check_count(materials, MAX_MATERIALS, ("materials",))
    return materials, list(patched)


def further_faults(
    method: str, params: Mapping[str, object], scene: Scene, materials: Materials
) -> Steps[list[Problem]]:
    """Return the faults of scene, objects and materials in the params of a request whose other params are faulty."""
    objects, given = params.get("objects"), params.get("materials")
    checks: list[Steps[object]] = []
    if method == "update_scene" and isinstance(objects, dict):
        checks.append(patched_objects(objects, scene))
    if method in ("set_materials", "apply") and isinstance(given, dict):
        checks.append(replaced_materials(given, materials))
    if method == "update_materials" and isinstance(given, dict):
        checks.append(patched_materials(given, materials))
    if method in ("set_scene", "apply") and "scene" in params:
        checks.append(scene_steps(params["scene"], ("scene",)))
    problems: list[Problem] = []
    for check in checks:
        try:
            yield from check
        except InvalidError as error:
            problems.extend(error.problems)
    return problems
