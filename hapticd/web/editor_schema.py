"""The JSON Schema of materials, objects and scene, with units, for the editors of the page.

The answer of `web.schema`:

    {"material":  {"$ref": "#/$defs/Material"},
     "scene":     {"$ref": "#/$defs/Scene"},
     "objects":   {"wall": {"$ref": "#/$defs/Wall"}, ...},      by the object's `kind`
     "textures":  {"grooves": {"$ref": "#/$defs/Grooves"}, ...}, by the texture's `kind`
     "$defs":     {"Material": ..., "Wall": ..., ...}}

Each definition is JSON Schema (2020-12) as `hapticd schema` prints it, with two differences that make a form simple:

- a member with a unit has it as `"unit": "N/m"`, and not at the end of its description;
- a member that may be absent has the schema of its value: no `anyOf` with null and no default. It is not in `required`.
  Null in a merge patch removes it.

`minimum`, `maximum`, `enum`, `const`, `default` and `description` are those of the configuration. Rules on combinations
of members are left out: the panels offer one choice after the other (static/editor/choices.js).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from typing import Final, cast

from hapticd.base.yaml_source import Json
from hapticd.config.document_kinds import OBJECT_KINDS
from hapticd.config.schema import config_schema, unit_of

_DEFS_REF_PREFIX: Final = "#/$defs/"
_NULL_SCHEMA: Final = {"type": "null"}
_COMBINATION_KEYWORDS: Final = ("allOf", "anyOf", "oneOf", "not", "if", "then")
"""Keywords of an object's schema that say which members may be combined."""
_TEXTURE_KINDS: Final = ("grooves", "stochastic", "autoregressive")


@cache
def editor_schema() -> dict[str, Json]:
    """Return the answer of `web.schema`: the JSON Schema of materials, objects and scene, with units."""
    every = cast("dict[str, dict[str, Json]]", config_schema()["$defs"])
    by_kind = {kind: name for name, definition in every.items() for kind in _kinds(definition)}
    wanted, definitions = ["Material", "Scene"], {}
    while wanted:
        name = wanted.pop()
        if name not in definitions:
            definitions[name] = cast("dict[str, Json]", _simple(every[name]))
            wanted += _referred(definitions[name])
    return {
        "material": _ref("Material"),
        "scene": _ref("Scene"),
        "objects": {kind: _ref(by_kind[kind]) for kind in OBJECT_KINDS},
        "textures": {kind: _ref(by_kind[kind]) for kind in _TEXTURE_KINDS},
        "$defs": {name: definitions[name] for name in sorted(definitions)},
    }


def _ref(name: str) -> dict[str, Json]:
    return {"$ref": _DEFS_REF_PREFIX + name}


def _kinds(definition: dict[str, Json]) -> list[str]:
    """Return the values of the member `kind` that select this definition of an object or a texture."""
    kind = cast("dict[str, dict[str, Json]]", definition.get("properties", {})).get("kind", {})
    return [cast(str, kind["const"])] if "const" in kind else []


def _referred(tree: Json) -> Iterator[str]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key == "$ref":
                yield cast(str, value).removeprefix(_DEFS_REF_PREFIX)
            else:
                yield from _referred(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from _referred(value)


def _simple(tree: Json) -> Json:
    """Return a JSON Schema with units as members, without null values, null defaults and rules on combinations."""
    if isinstance(tree, list):
        return [_simple(value) for value in tree]
    if not isinstance(tree, dict):
        return tree
    rules = _COMBINATION_KEYWORDS if "properties" in tree else ()
    simple = {key: _simple(value) for key, value in tree.items() if key not in rules}
    choices = simple.get("anyOf")
    if isinstance(choices, list) and _NULL_SCHEMA in choices and len(choices) == 2:
        del simple["anyOf"]
        if simple.get("default", 0) is None:
            del simple["default"]
        simple = {**next(cast("dict[str, Json]", choice) for choice in choices if choice != _NULL_SCHEMA), **simple}
    properties = simple.get("properties")
    if isinstance(properties, dict):
        for key, described in properties.items():
            unit = unit_of(key)
            if unit is not None and isinstance(described, dict):
                text = cast(str, described["description"])
                described["description"] = re.sub(rf" In {re.escape(unit)}\.$", "", text)
                described["unit"] = unit
    return simple
