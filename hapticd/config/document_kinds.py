"""What a document is, by its keys: a scene, materials, a configuration, what a hand does; and which command takes it.

Every reader asks `refuse_other_kinds` before it reads single keys, so that a file that is sound but meant for
another command is answered with that command, not with a list of unknown keys.
"""

import os
from collections.abc import Collection, Sequence
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import InvalidError, Problem
from hapticd.base.model import UNKNOWN_KEY
from hapticd.base.yaml_source import Document, Json, load_path, one_line

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

CONFIGURATION: Final = ("servo", "device", "flight")
"""Keys of a configuration alone; it has `materials` and `scene` too."""
SCENE: Final = ("display", "ramp_s", "passivity", "objects")
OBJECT_KINDS: Final = ("wall", "membrane", "box", "disc", "spring", "viscous", "constant")
MATERIAL: Final = (
    "stiffness_n_per_m", "damping_n_s_per_m", "tap", "rupture", "friction", "texture", "provenance",
)  # fmt: skip

_TAKERS: Final[dict[Kind, tuple[str, str]]] = {
    "configuration": ("a configuration", "run -c"),
    "change": ("materials and a scene", "apply"),
    "scene": ("a scene", "scene set"),
    "bare scene": ("a scene", "scene set"),
    "objects": ("objects", "scene update"),
    "materials": ("materials", "material set"),
    "bare materials": ("materials", "material set"),
    "waypoints": ("waypoints", "operator"),
    "gesture": ("a gesture", "operator"),
    "study": ("a study", "experiment check"),
    "sweep": ("a sweep", "sweep run"),
}
"""What a person calls a kind, and the command that takes it."""
TELLING_KEYS: Final[dict[Kind, tuple[str, ...]]] = {
    "bare scene": SCENE,
    "gesture": ("gesture",),
    "waypoints": ("waypoints", "interpolation"),
    "study": ("experiment", "factors", "trial", "questions"),
    "sweep": ("vary", "measure", "refine"),
}
"""A document that has one of these keys is of this kind."""
PATCHES: Final[dict[str, tuple[Kind, ...]]] = {
    "objects": ("scene", "bare scene", "objects"),
    "materials": ("materials", "bare materials"),
}
"""Kinds of documents that hold a merge patch over these."""


def kind_of(data: Json) -> Kind | None:
    """The kind of a document, by its keys; None where they do not tell."""
    if not isinstance(data, dict) or not data:
        return None
    inner = [value for key, value in data.items() if value is not None or key in SCENE]
    if inner and all(isinstance(value, dict) and value.get("kind") in OBJECT_KINDS for value in inner):
        return "objects"
    if not data.keys().isdisjoint(CONFIGURATION):
        return "configuration"
    if "scene" in data:
        return "change" if "materials" in data else "scene"
    if "materials" in data:
        return "materials"
    for kind, keys in TELLING_KEYS.items():
        if not data.keys().isdisjoint(keys):
            return kind
    if {"kind", "object"} <= data.keys():
        return "gesture"
    if inner and all(isinstance(value, dict) and value and value.keys() <= {*MATERIAL} for value in inner):
        return "bare materials"
    return None


def refuse_other_kinds(document: Document, *taken: Kind) -> None:
    """Raises InvalidError for a document that is none of these and that another command takes.

    What is not known is left to the reader, which knows its own keys.
    """
    kind = kind_of(document.data)
    if kind is not None and kind not in taken:
        raise _for_another_command(document, kind)


def refuse_documents(path: str | os.PathLike[str]) -> None:
    """Raises InvalidError for a YAML or JSON file where a recording is to be read: it names the command that takes it.

    HapticdError for one that cannot be read. Other files are not read.
    """
    if os.path.splitext(os.fspath(path))[1].lower() in (".yaml", ".yml", ".json"):
        document = load_path(path)
        kind = kind_of(document.data)
        if kind is not None:
            raise _for_another_command(document, kind, "is no recording: it ")


def refuse_other_keys(document: Document, path: Sequence[str], given: Collection[str], known: str) -> None:
    """Raises InvalidError if the mapping at `path`, with the keys `given`, has others than `known`."""
    text = f"{UNKNOWN_KEY}; known: {known}"
    others = [Problem(document.where((*path, key)), text) for key in given if key != known]
    if others:
        raise InvalidError(others)


def _for_another_command(document: Document, kind: Kind, it: str = "") -> InvalidError:
    holds, taker = _TAKERS[kind]
    name = one_line(document.name or "")
    return InvalidError([Problem(name, f"{it}holds {holds}; use: hapticd {taker} {name}".rstrip())])
