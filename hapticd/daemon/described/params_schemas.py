"""JSON Schema of the params of every method: of the models that validate them, and of merge patches.

A merge patch (RFC 7396) has members of what it is merged into, each optional and with null for one that is removed.
What it makes of an object or a material is validated whole; that depends on what there is.
"""

from __future__ import annotations

from typing import Final, cast, get_args

from pydantic.json_schema import models_json_schema

from hapticd.base.model import NAME_MAX_CHARACTERS, NAME_PATTERN, Model
from hapticd.base.yaml_source import Json
from hapticd.config.materials import Material
from hapticd.config.operator import OperatorParams
from hapticd.config.scene import Scene, SceneObject
from hapticd.config.schema import closed
from hapticd.daemon.described.draft7 import draft7
from hapticd.daemon.methods import METHOD_PARAMS

REF: Final = "#/components/schemas/"
_NULL: Final[dict[str, Json]] = {"type": "null"}
_KEPT: Final = ("type", "description", "properties")
"""What a patch has of the schema of an object; the rest is of the object as a whole."""
Schemas = dict[str, dict[str, Json]]


def params_model(method: str) -> type[Model]:
    """The model that validates the params of a method."""
    return METHOD_PARAMS[method] or OperatorParams


def params_schemas() -> Schemas:
    """By the names of the models, in draft 7: `params_model` of every method, and what they refer to."""
    models = {params_model(method): None for method in METHOD_PARAMS} | {Scene: None, Material: None}
    _, found = models_json_schema([(model, "validation") for model in models], ref_template=f"{REF}{{model}}")
    schemas = cast(Schemas, draft7(closed(cast(Json, found["$defs"]))))
    kinds = [model.__name__ for model in _kinds()]
    schemas["MaterialPatch"] = _patch("Material", schemas)
    for kind in kinds:
        schemas[f"{kind}Patch"] = _patch(kind, schemas)
    _properties(schemas["UpdateMaterialsParams"])["materials"]["patternProperties"] = _by_name([f"{REF}MaterialPatch"])
    _properties(schemas["UpdateSceneParams"])["objects"]["patternProperties"] = _by_name(
        [f"{REF}{kind}Patch" for kind in kinds]
    )
    for model, name in (("UpdateMaterialsParams", "materials"), ("UpdateSceneParams", "objects")):
        # What never was there is removed without an error, whatever its name.
        _properties(schemas[model])[name]["additionalProperties"] = _NULL
    return schemas


def _kinds() -> tuple[type[Model], ...]:
    return cast("tuple[type[Model], ...]", get_args(SceneObject))


def _properties(schema: dict[str, Json]) -> Schemas:
    return cast(Schemas, schema["properties"])


def _by_name(patches: list[str]) -> dict[str, Json]:
    pattern = NAME_PATTERN.replace("]+$", f"]{{1,{NAME_MAX_CHARACTERS}}}$")
    options: list[Json] = [{"$ref": patch} for patch in patches]
    return {pattern: {"anyOf": [*options, _NULL]}}


def _patch(name: str, schemas: Schemas) -> dict[str, Json]:
    """A merge patch over what this schema describes. Keys that it does not have may be removed: they belonged to a kind
    that the object had before."""
    found = {key: value for key, value in schemas[name].items() if key in _KEPT}
    found["description"] = f"A JSON Merge Patch. {found['description']}"
    found["properties"] = {key: _patched(value, schemas) for key, value in _properties(found).items()}
    return {**found, "additionalProperties": _NULL}


def _patched(schema: dict[str, Json], schemas: Schemas) -> Json:
    """A member of a patch: null, a patch where it is an object, else the member as it is to be."""
    told = {"description": schema["description"]} if "description" in schema else {}
    options = cast(
        "list[dict[str, Json]]", schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf") or [schema]
    )
    members: list[Json] = []
    for option in options:
        reference = cast("str | None", option.get("$ref"))
        choices = cast("list[dict[str, Json]]", option.get("oneOf", []))
        if reference is not None:
            members.append(_nested(reference, schemas))
        elif choices:
            members += [_nested(cast(str, choice["$ref"]), schemas) for choice in choices]
        elif option != _NULL:
            members.append(_by_names(option) if "patternProperties" in option else _without_words(option))
    return {**told, "anyOf": [*members, _NULL]}


def _without_words(schema: dict[str, Json]) -> dict[str, Json]:
    return {key: value for key, value in schema.items() if key not in ("default", "description")}


def _by_names(schema: dict[str, Json]) -> dict[str, Json]:
    """A patch over a mapping by names."""
    found = {key: value for key, value in _without_words(schema).items() if key != "propertyNames"}
    patterns = cast(Schemas, schema["patternProperties"])
    found["patternProperties"] = {pattern: {"anyOf": [value, _NULL]} for pattern, value in patterns.items()}
    return {**found, "additionalProperties": _NULL}


def _nested(reference: str, schemas: Schemas) -> Json:
    name = reference.removeprefix(REF)
    if schemas[name].get("type") != "object":
        return {"$ref": reference}
    if f"{name}Patch" not in schemas:
        schemas[f"{name}Patch"] = {}  # its place, should it refer to itself
        schemas[f"{name}Patch"] = _patch(name, schemas)
    return {"$ref": f"{reference}Patch"}
