"""JSON Merge Patch (RFC 7396) of `update_scene` and `update_materials`, and replacement of members by name."""

from collections.abc import Mapping
from typing import TypeVar

from hapticd.base.yaml_source import Json

T = TypeVar("T")


def merge_patch(target: Json, patch: Json) -> Json:
    """Return `target` with `patch` applied: mappings merge key by key, null removes a key, other values replace.

    Neither argument is changed; the result may share objects with both.
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
    """Write each member of `changes` into `into`; a value of None removes the member with this name."""
    for name, value in changes.items():
        if value is None:
            into.pop(name, None)
        else:
            into[name] = value
