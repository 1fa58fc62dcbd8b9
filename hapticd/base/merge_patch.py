"""JSON Merge Patch (RFC 7396), as `update_scene` and `update_materials` take it; and the flat form of changes."""

from collections.abc import Mapping
from typing import TypeVar

from hapticd.base.yaml_source import Json

T = TypeVar("T")


def merge_patch(target: Json, patch: Json) -> Json:
    """`target` with `patch` applied: mappings merge key by key, null removes a key, anything else replaces.

    Neither argument is changed; the result may share unchanged parts with both.
    """
    if not isinstance(patch, dict):
        return patch
    result = dict(target) if isinstance(target, dict) else {}
    for key, change in patch.items():
        if change is None:
            result.pop(key, None)
        else:
            result[key] = merge_patch(result.get(key), change)
    return result


def replace_members(into: dict[str, T], changes: Mapping[str, T | None]) -> None:
    """Each member of `changes` takes the place of that of the same name, whole; None removes it."""
    for name, value in changes.items():
        if value is None:
            into.pop(name, None)
        else:
            into[name] = value
