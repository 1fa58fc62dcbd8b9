"""Arguments of a client's methods: scenes, patches and operators as mappings, models or files.

Files are read and validated here, so that their faults are reported by line before anything is sent.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Literal, TypeAlias

from hapticd.base import arguments
from hapticd.base.errors import HapticdError, shown

if TYPE_CHECKING:
    from hapticd.base.model import Model

Interpolation: TypeAlias = Literal["linear", "minimum_jerk"]


SceneSource: TypeAlias = "Mapping[str, object] | str | os.PathLike[str] | Model"
"""A scene: a mapping, the path of a YAML file, or a `hapticd.Scene`."""
WaypointsSource: TypeAlias = "Iterable[Iterable[float]] | str | os.PathLike[str]"
"""Waypoints [[t_s, x_m, y_m], ...], or the path of a file with the motion of the hand: YAML, JSON or CSV."""
PatchSource: TypeAlias = "Mapping[str, object] | str | os.PathLike[str]"
"""A merge patch: a mapping, or the path of a YAML file."""


def scene_tree(scene: SceneSource) -> Mapping[str, object]:
    """Return a scene as a mapping for the request.

    Raises HapticdError for a file that cannot be read, InvalidError with lines for a file without a valid scene.
    """
    if isinstance(scene, Mapping):
        return scene
    if isinstance(scene, str | os.PathLike):
        from hapticd.config.file_faults import FromFile
        from hapticd.config.scene import read_scene

        read, document, root = read_scene(arguments.path("scene", scene))
        return FromFile(read.to_dict(), document, root)
    if not hasattr(scene, "to_dict"):
        problem = f"must be a mapping, the path of a file or a hapticd.Scene, is {shown(scene)}"
        raise arguments.invalid_argument("scene", problem)
    return scene.to_dict()


def patch_tree(patch: PatchSource, *path: str) -> Mapping[str, object]:
    """Return a merge patch as a mapping for the request. A file has it at the keys `path`, or at the top level.

    Raises HapticdError for a file that cannot be read or has no mapping, InvalidError for a file that is not YAML or
    has other keys next to `path`.
    """
    if isinstance(patch, Mapping):
        return patch
    from hapticd.base.yaml_source import load_path
    from hapticd.config.document_kinds import KINDS_WITH_PATCHES, refuse_other_keys, refuse_other_kinds
    from hapticd.config.file_faults import FromFile

    if not isinstance(patch, str | os.PathLike):
        raise arguments.invalid_argument(path[-1], f"must be a mapping or the path of a file, is {shown(patch)}")
    document = load_path(arguments.path(path[-1], patch))
    refuse_other_kinds(document, *KINDS_WITH_PATCHES[path[-1]])
    found: tuple[str, ...] = ()
    data: object = document.data
    for key in path:
        if isinstance(data, dict) and key in data:
            refuse_other_keys(document, found, data, key)
            data = data[key]
            found += (key,)
    if not isinstance(data, dict):
        raise HapticdError(f"{document.where(found)}: must be a mapping of names to {path[-1]}")
    return FromFile(data, document, found)


def operator_params(
    waypoints: WaypointsSource | None, interpolation: Interpolation | None, gesture: Mapping[str, object] | None
) -> dict[str, object]:
    """Return the params of `set_operator`, a motion of the hand. Raises HapticdError for a file without a motion."""
    if isinstance(waypoints, str | os.PathLike):
        if interpolation is not None or gesture is not None:
            raise HapticdError(
                f"{os.fspath(waypoints)}: a file of waypoints cannot be combined with interpolation or gesture"
            )
        from hapticd.config.file_faults import FromFile
        from hapticd.config.operator import load_operator

        operator = load_operator(arguments.path("waypoints", waypoints))
        if operator.gesture is not None:
            read = operator_params(None, None, operator.gesture.to_dict())
        else:
            read = operator_params(operator.waypoints, operator.interpolation, None)
        return read if operator.document is None else FromFile(read, operator.document)
    params: dict[str, object] = {}
    if waypoints is not None:
        params["waypoints"] = arguments.rows("waypoints", waypoints)
    if interpolation is not None:
        params["interpolation"] = interpolation
    if gesture is not None:
        params["gesture"] = arguments.mapping("gesture", gesture)
    return params
