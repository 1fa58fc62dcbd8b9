"""JSON Schemas (draft 7) of params, results and the maps of telemetry.

Schemas of params come from the models that validate them. The schema of a merge patch (RFC 7396) has the members of the
patched object: each is optional, and null removes it. The daemon also validates the object after the patch; no schema
expresses this. Schemas of results and telemetry come from the types of protocol/results and the records of the core;
they allow unknown members, because later versions may add some.
"""

from __future__ import annotations

from types import NoneType, UnionType
from typing import (
    Any,
    Final,
    Literal,
    NotRequired,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np
from pydantic.json_schema import models_json_schema

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, records
from hapticd.base.model import MAX_NAME_CHARACTERS, NAME_PATTERN, Model
from hapticd.base.yaml_source import Json
from hapticd.config.materials import Material
from hapticd.config.operator import OperatorParams
from hapticd.config.scene import Scene, SceneObject
from hapticd.config.schema import closed
from hapticd.daemon.methods import METHOD_PARAMS
from hapticd.protocol.events import event_map
from hapticd.recording.event_columns import EVENT_MEMBER_SCHEMAS, NULLABLE_MEMBERS

# ---- From draft 2020-12, of pydantic, to draft 7, of OpenRPC and AsyncAPI --------------------------------------------

_OPEN_API_KEYWORD: Final = "discriminator"
"""A keyword of OpenAPI that is left out, because the `const` of `kind` expresses the same."""


def draft7(schema: Json) -> Json:
    """Convert a JSON Schema to draft 7: `items` describes tuples, `$ref` stands alone, and no default is null."""
    if isinstance(schema, list):
        return [draft7(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    result = {key: draft7(value) for key, value in schema.items() if key != _OPEN_API_KEYWORD}
    if isinstance(result.get("properties"), dict):
        # pydantic's title of a property only repeats its key.
        result["properties"] = {key: _untitled(each) for key, each in result["properties"].items()}  # type: ignore[union-attr]
    if "prefixItems" in result:
        result["items"] = result.pop("prefixItems")
    if result.get("default", 0) is None:
        del result["default"]
    if "$ref" in result and len(result) > 1:
        result = {"allOf": [{"$ref": result.pop("$ref")}], **result}
    return result


def _untitled(schema: Json) -> Json:
    if not isinstance(schema, dict) or not isinstance(schema.get("title"), str):
        return schema
    return {key: value for key, value in schema.items() if key != "title"}


# ---- Params ----------------------------------------------------------------------------------------------------------

SCHEMA_REF_PREFIX: Final = "#/components/schemas/"
"""Beginning of a reference to a schema of the document."""
_NULL_SCHEMA: Final[dict[str, Json]] = {"type": "null"}
_PATCH_KEYWORDS: Final = ("type", "description", "properties")
"""Keywords of an object's schema that also apply to a patch of it."""
Schemas = dict[str, dict[str, Json]]


def params_model(method: str) -> type[Model]:
    """Return the model that validates the params of a method."""
    return METHOD_PARAMS[method] or OperatorParams


def params_schemas() -> Schemas:
    """Return the schemas of the params of all methods, and of the models that they refer to, by the models' names."""
    models = {params_model(method): None for method in METHOD_PARAMS} | {Scene: None, Material: None}
    _, document = models_json_schema(
        [(model, "validation") for model in models], ref_template=f"{SCHEMA_REF_PREFIX}{{model}}"
    )
    schemas = cast(Schemas, draft7(closed(cast(Json, document["$defs"]))))
    kinds = [model.__name__ for model in _kinds()]
    schemas["MaterialPatch"] = _model_patch("Material", schemas)
    for kind in kinds:
        schemas[f"{kind}Patch"] = _model_patch(kind, schemas)
    _properties(schemas["UpdateMaterialsParams"])["materials"]["patternProperties"] = _named(
        [f"{SCHEMA_REF_PREFIX}MaterialPatch"]
    )
    _properties(schemas["UpdateSceneParams"])["objects"]["patternProperties"] = _named(
        [f"{SCHEMA_REF_PREFIX}{kind}Patch" for kind in kinds]
    )
    for model, name in (("UpdateMaterialsParams", "materials"), ("UpdateSceneParams", "objects")):
        # Removing a name that does not exist is not an error, even if the name is invalid.
        _properties(schemas[model])[name]["additionalProperties"] = _NULL_SCHEMA
    return schemas


def _kinds() -> tuple[type[Model], ...]:
    return cast("tuple[type[Model], ...]", get_args(SceneObject))


def _properties(schema: dict[str, Json]) -> Schemas:
    return cast(Schemas, schema["properties"])


def _named(patches: list[str]) -> dict[str, Json]:
    """Return the value of `patternProperties` for a map from names to merge patches; null removes a name."""
    pattern = NAME_PATTERN.replace("]+$", f"]{{1,{MAX_NAME_CHARACTERS}}}$")
    options: list[Json] = [{"$ref": patch} for patch in patches]
    return {pattern: {"anyOf": [*options, _NULL_SCHEMA]}}


def _model_patch(name: str, schemas: Schemas) -> dict[str, Json]:
    """Return the schema of a merge patch (RFC 7396) of the model `name`.

    Keys that the model lacks may be null: a patch that changes an object's `kind` must remove keys of the old kind.
    """
    patch = {key: value for key, value in schemas[name].items() if key in _PATCH_KEYWORDS}
    patch["description"] = f"A JSON Merge Patch. {patch['description']}"
    patch["properties"] = {key: _member_patch(value, schemas) for key, value in _properties(patch).items()}
    return {**patch, "additionalProperties": _NULL_SCHEMA}


def _member_patch(schema: dict[str, Json], schemas: Schemas) -> Json:
    """Return the schema of a member of a merge patch: null, the patch of an object, or another value."""
    about = {"description": schema["description"]} if "description" in schema else {}
    options = cast(
        "list[dict[str, Json]]", schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf") or [schema]
    )
    members: list[Json] = []
    for option in options:
        reference = cast("str | None", option.get("$ref"))
        choices = cast("list[dict[str, Json]]", option.get("oneOf", []))
        if reference is not None:
            members.append(_referred_patch(reference, schemas))
        elif choices:
            members += [_referred_patch(cast(str, choice["$ref"]), schemas) for choice in choices]
        elif option != _NULL_SCHEMA:
            members.append(_mapping_patch(option) if "patternProperties" in option else _without_words(option))
    return {**about, "anyOf": [*members, _NULL_SCHEMA]}


def _without_words(schema: dict[str, Json]) -> dict[str, Json]:
    return {key: value for key, value in schema.items() if key not in ("default", "description")}


def _mapping_patch(schema: dict[str, Json]) -> dict[str, Json]:
    """Return the schema of a merge patch (RFC 7396) of a mapping whose keys are names."""
    patch = {key: value for key, value in _without_words(schema).items() if key != "propertyNames"}
    patterns = cast(Schemas, schema["patternProperties"])
    patch["patternProperties"] = {pattern: {"anyOf": [value, _NULL_SCHEMA]} for pattern, value in patterns.items()}
    return {**patch, "additionalProperties": _NULL_SCHEMA}


def _referred_patch(reference: str, schemas: Schemas) -> Json:
    """Return a reference to the merge patch of a schema, made if missing; `reference` itself if not of an object."""
    name = reference.removeprefix(SCHEMA_REF_PREFIX)
    if schemas[name].get("type") != "object":
        return {"$ref": reference}
    if f"{name}Patch" not in schemas:
        schemas[f"{name}Patch"] = {}  # a placeholder, in case that the schema refers to itself
        schemas[f"{name}Patch"] = _model_patch(name, schemas)
    return {"$ref": f"{reference}Patch"}


# ---- Results and telemetry -------------------------------------------------------------------------------------------

_JSON_TYPE_NAMES: Final[dict[object, str]] = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    NoneType: "null",
}


class _AnyJson:
    """Stands for `Json`, any value, in the annotations of results."""


def schema_of(kind: Any) -> dict[str, Json]:
    """Return the JSON Schema of a type of protocol/results; the docstring of the type is the description."""
    if kind is _AnyJson:
        return {}
    if kind in _JSON_TYPE_NAMES:
        return {"type": _JSON_TYPE_NAMES[kind]}
    if is_typeddict(kind):
        return _mapping(kind)
    arguments, origin = get_args(kind), get_origin(kind)
    if origin is NotRequired:
        return schema_of(arguments[0])
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin is list:
        return {"type": "array", "items": schema_of(arguments[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": schema_of(arguments[1])}
    if origin in (Union, UnionType):
        return {"anyOf": [schema_of(each) for each in arguments]}
    raise TypeError(f"no JSON Schema of {kind}: must be a TypedDict, or a plain type in one")


def _mapping(kind: Any) -> dict[str, Json]:
    members = get_type_hints(kind, localns={"Json": _AnyJson}, include_extras=True)
    return {
        "title": kind.__name__,
        "description": " ".join((kind.__doc__ or "").split()),
        "type": "object",
        "required": [name for name, each in members.items() if get_origin(each) is not NotRequired],
        "properties": {name: schema_of(each) for name, each in members.items()},
    }


def event_schema() -> dict[str, Json]:
    """Return the schema of a message of the topic `event`: for each kind, the members that `event_map` gives."""
    record = records(EVENT_DTYPE, 1)[0]
    kinds: list[Json] = []
    for kind in EventKind:
        record["kind"] = kind
        members = event_map(record, "")
        properties: dict[str, Json] = {name: _event_member(name) for name in members}
        properties["event"] = {"const": members["event"]}  # type: ignore[dict-item]
        kinds.append({"type": "object", "required": list(members), "properties": properties})
    return {"title": "Event", "oneOf": kinds}


def _event_member(name: str) -> Json:
    described: Any = EVENT_MEMBER_SCHEMAS[name]
    return {"anyOf": [described, {"type": "null"}]} if described and name in NULLABLE_MEMBERS else described


def samples_schema() -> dict[str, Json]:
    """Return the schema of a message of the topic `samples`. `data` is msgpack's bin, which JSON does not have."""
    return {
        "title": "Samples",
        "type": "object",
        "required": ["first_tick", "dropped", "dtype", "data"],
        "properties": {
            "first_tick": {"type": "integer", "description": "tick of the first sample"},
            "dropped": {
                "type": "integer",
                "description": "samples lost because the daemon's ring was full, total since the start",
            },
            "dtype": {
                "type": "array",
                "items": {"type": "array", "minItems": 2, "maxItems": 3},
                "description": "numpy's descr of one record: `[name, format]`, or `[name, format, [length]]`",
                "const": _plain(np.lib.format.dtype_to_descr(SAMPLE_DTYPE)),
            },
            "data": {
                "type": "string",
                "format": "binary",
                "description": "the records, little-endian and packed as `dtype` describes, "
                f"{SAMPLE_DTYPE.itemsize} bytes each in this version",
            },
        },
    }


def _plain(value: Any) -> Json:
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value
