"""Kinds of documents, recognized by their keys: scene, materials, configuration, operator; and their commands.

Every reader calls `refuse_other_kinds` before it reads single keys. For a valid file of another command the error
names that command, instead of a list of unknown keys.
"""

import os
from collections.abc import Collection, Sequence
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import InvalidError, Problem
from hapticd.base.model import UNKNOWN_KEY
from hapticd.base.yaml_source import Document, Json, load_path, printable

Kind: TypeAlias = Literal[
    "configuration",
    "change",
    "scene",
    "bare scene",
    "objects",
    "materials",
    "bare materials",
    "waypoints",
    "gesture",
    "study",
    "sweep",
]

CONFIGURATION_KEYS: Final = ("servo", "device", "flight")
"""Keys that only a configuration has, in addition to `materials` and `scene`."""
SCENE_KEYS: Final = ("display", "ramp_s", "passivity", "objects")
OBJECT_KINDS: Final = ("wall", "membrane", "box", "disc", "spring", "viscous", "constant")
"""Values of the key `kind` of an object."""
MATERIAL_KEYS: Final = (
    "stiffness_n_per_m", "damping_n_s_per_m", "tap", "rupture", "friction", "texture", "provenance",
)  # fmt: skip

_COMMAND_OF_KIND: Final[dict[Kind, tuple[str, str]]] = {
    "configuration": ("a configuration", "run -c"),
    "change": ("materials and a scene", "apply"),
    "scene": ("a scene", "apply"),
    "bare scene": ("a scene", "apply"),
    "objects": ("objects", "scene update"),
    "materials": ("materials", "apply"),
    "bare materials": ("materials", "apply"),
    "waypoints": ("waypoints", "operator"),
    "gesture": ("a gesture", "operator"),
    "study": ("a study", "experiment check"),
    "sweep": ("a sweep", "sweep run"),
}
"""Name of each kind in messages, and the command that reads it."""
KEYS_OF_KIND: Final[dict[Kind, tuple[str, ...]]] = {
    "bare scene": SCENE_KEYS,
    "gesture": ("gesture",),
    "waypoints": ("waypoints", "interpolation"),
    "study": ("experiment", "factors", "trial", "questions"),
    "sweep": ("vary", "measure", "refine"),
}
"""Keys by kind of document. A document with any of the keys of a kind is of that kind."""
KINDS_WITH_PATCHES: Final[dict[str, tuple[Kind, ...]]] = {
    "objects": ("scene", "bare scene", "objects"),
    "materials": ("materials", "bare materials"),
}
"""Kinds of documents that may hold a merge patch of objects, or of materials."""


def kind_of(data: Json) -> Kind | None:
    """Return the kind of a document by its keys, or None if it cannot be recognized."""
    if not isinstance(data, dict) or not data:
        return None
    inner = [value for key, value in data.items() if value is not None or key in SCENE_KEYS]
    if inner and all(isinstance(value, dict) and value.get("kind") in OBJECT_KINDS for value in inner):
        return "objects"
    if not data.keys().isdisjoint(CONFIGURATION_KEYS):
        return "configuration"
    if "scene" in data:
        return "change" if "materials" in data else "scene"
    if "materials" in data:
        return "materials"
    for kind, keys in KEYS_OF_KIND.items():
        if not data.keys().isdisjoint(keys):
            return kind
    if {"kind", "object"} <= data.keys():
        return "gesture"
    if inner and all(isinstance(value, dict) and value and value.keys() <= {*MATERIAL_KEYS} for value in inner):
        return "bare materials"
    return None


def refuse_other_kinds(document: Document, *accepted: Kind) -> None:
    """Raise InvalidError if a document is of a known kind other than those in `accepted`.

    A document of unknown kind is accepted; its reader checks the keys. Raises InvalidError also if keys of a scene are
    next to `materials`, `scene` or keys of a configuration.
    """
    kind = kind_of(document.data)
    keys = document.data.keys() if isinstance(document.data, dict) else set()
    if kind not in ("objects", "bare materials") and not keys.isdisjoint(("materials", "scene", *CONFIGURATION_KEYS)):
        misplaced = [
            Problem(document.where((key,)), "belongs below the key `scene`") for key in SCENE_KEYS if key in keys
        ]
        if misplaced:
            raise InvalidError(misplaced)
    if kind is not None and kind not in accepted:
        raise _for_another_command(document, kind)


def refuse_documents(path: str | os.PathLike[str]) -> None:
    """Raise InvalidError if the file of a recording is in fact a YAML or JSON document for another command.

    Raises HapticdError if such a file cannot be read. Files with other endings are not read.
    """
    if os.path.splitext(os.fspath(path))[1].lower() in (".yaml", ".yml", ".json"):
        document = load_path(path)
        kind = kind_of(document.data)
        if kind is not None:
            raise _for_another_command(document, kind, "not a recording: it ")


def refuse_other_keys(document: Document, path: Sequence[str], given: Collection[str], known: str) -> None:
    """Raise InvalidError if `given`, the keys of the mapping at `path`, contains a key other than `known`."""
    text = f"{UNKNOWN_KEY}; known: {known}"
    others = [Problem(document.where((*path, key)), text) for key in given if key != known]
    if others:
        raise InvalidError(others)


def _for_another_command(document: Document, kind: Kind, it: str = "") -> InvalidError:
    holds, command = _COMMAND_OF_KIND[kind]
    name = printable(document.name or "")
    return InvalidError([Problem(name, f"{it}holds {holds}; use: hapticd {command} {name}".rstrip())])
