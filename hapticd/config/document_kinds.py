"""What a document is, by its keys: a scene, materials, a configuration, what a hand does; and which command takes it.

Every reader asks `refuse_other_kinds` before it reads single keys, so that a file that is sound but meant for
another command is answered with that command, not with a list of unknown keys.
"""

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import InvalidError, Problem, near_names
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
OPERATOR: Final = ("waypoints", "interpolation", "gesture")
GESTURE_KINDS: Final = ("tap", "stroke", "puncture")
STUDY: Final = ("experiment", "factors", "trial", "questions")
SWEEP: Final = ("vary", "measure", "refine")

_HOLDS: Final[dict[Kind, str]] = {
    "configuration": "a configuration",
    "change": "materials and a scene",
    "scene": "a scene",
    "bare scene": "a scene",
    "objects": "objects",
    "materials": "materials",
    "bare materials": "materials",
    "waypoints": "waypoints",
    "gesture": "a gesture",
    "study": "a study",
    "sweep": "a sweep",
}
_TAKER: Final[dict[Kind, str]] = {
    "configuration": "run -c",
    "change": "apply",
    "scene": "scene set",
    "bare scene": "scene set",
    "objects": "scene update",
    "materials": "material set",
    "bare materials": "material set",
    "waypoints": "operator",
    "gesture": "operator",
    "study": "experiment check",
    "sweep": "sweep run",
}
_KEYS: Final[dict[Kind, tuple[str, ...]]] = {
    "configuration": (*CONFIGURATION, "materials", "scene"),
    "bare scene": SCENE,
    "waypoints": ("waypoints", "interpolation"),
    "gesture": ("gesture",),
    "study": STUDY,
    "sweep": SWEEP,
}

_KEY_ABOVE: Final[dict[Kind, tuple[str, Kind]]] = {
    "objects": ("objects", "bare scene"),
    "bare materials": ("materials", "materials"),
}
"""The key that these lack, and what they are below it."""
_SECTIONS: Final = frozenset(key for keys in _KEYS.values() for key in keys)
PATCHES: Final[dict[str, tuple[Kind, ...]]] = {
    "objects": ("scene", "bare scene", "objects"),
    "materials": ("materials", "bare materials"),
}
"""Kinds of documents that hold a merge patch over these."""


def kind_of(data: Json) -> Kind | None:
    """What plain data is; None where its keys do not say."""
    if not isinstance(data, dict) or not data:
        return None
    inner = [value for key, value in data.items() if value is not None or key in _SECTIONS]
    if inner and all(isinstance(value, dict) and _is_word(value.get("kind"), OBJECT_KINDS) for value in inner):
        return "objects"
    if any(key in data for key in CONFIGURATION):
        return "configuration"
    if "scene" in data:
        return "change" if "materials" in data else "scene"
    if "materials" in data:
        return "materials"
    for kind, keys in _KEYS.items():
        if any(key in data for key in keys):
            return kind
    if _is_word(data.get("kind"), GESTURE_KINDS) and "object" in data:
        return "gesture"
    if inner and all(isinstance(value, dict) and value and value.keys() <= {*MATERIAL} for value in inner):
        return "bare materials"
    return None


def likely_kind_of(data: Json) -> Kind | None:
    """As kind_of; where no key is known, by the keys that are nearly one: `objcts` is a scene's."""
    found = kind_of(data)
    if found is not None or not isinstance(data, dict):
        return found
    owner = {key: kind for kind, keys in _KEYS.items() for key in keys}
    near = [owner[key] for name in data for key in near_names(name, list(owner), 1)]
    return near[0] if near else None


def refuse_other_kinds(document: Document, *taken: Kind, takers: Mapping[Kind, str] = {}) -> None:
    """Raises InvalidError for a document that is none of these and that another command takes, or another option:
    `takers` are those that a command has itself.

    What is not known is left to the reader, which knows its own keys.
    """
    kind = kind_of(document.data)
    if kind is not None and kind not in taken:
        text = _other(kind, document.name, takers)
        key, whole = _KEY_ABOVE.get(kind, ("", kind))
        text += f"; or put them below `{key}:`" if whole in taken else ""
        raise InvalidError([Problem(_name(document), text)])


def refuse_documents(path: str | os.PathLike[str]) -> None:
    """Raises InvalidError for a YAML or JSON file where a recording is to be read: it names the command that takes it.

    HapticdError for one that cannot be read. Other files are not read.
    """
    if os.path.splitext(os.fspath(path))[1].lower() not in (".yaml", ".yml", ".json"):
        return
    document = load_path(path)
    kind = kind_of(document.data)
    if kind is not None:
        raise InvalidError([Problem(_name(document), f"is no recording: it {_other(kind, document.name)}")])


def refuse_other_keys(document: Document, path: Sequence[str], others: Iterable[str], what: str) -> None:
    """Refuses keys of the mapping at `path`; `what` says what alone is taken there: "a scene, which is all"."""
    problems = []
    for key in others:
        taker = _taker_of(key)
        text = f"does not belong to {what} that is taken here{f'; that is for hapticd {taker}' if taker else ''}"
        problems.append(Problem(document.where((*path, key)), text))
    if problems:
        raise InvalidError(problems)


def _taker_of(key: str) -> str | None:
    if key in ("materials", "scene"):
        return _TAKER["scene" if key == "scene" else "materials"]
    kinds = [kind for kind, keys in _KEYS.items() if key in keys and key != "objects"]
    return _TAKER[kinds[0]] if kinds else None


def _other(kind: Kind, name: str | None, takers: Mapping[Kind, str] = {}) -> str:
    taker = takers.get(kind, _TAKER[kind])
    return f"holds {_HOLDS[kind]}; use: hapticd {taker}{f' {one_line(name)}' if name is not None else ''}"


def _name(document: Document) -> str:
    return "" if document.name is None else one_line(document.name)


def _is_word(value: object, words: Collection[str]) -> bool:
    return isinstance(value, str) and value in words
