"""JSON Schema as OpenRPC and AsyncAPI have it, draft 7, of what pydantic gives, 2020-12."""

from __future__ import annotations

from typing import Final

from hapticd.base.yaml_source import Json

_OPEN_API: Final = "discriminator"
"""A keyword of OpenAPI; the `const` of `kind` says the same."""


def draft7(schema: Json) -> Json:
    """The same schema in draft 7: a list of fixed length by `items`, nothing beside a `$ref`, no default that is
    null."""
    if isinstance(schema, list):
        return [draft7(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: draft7(value) for key, value in schema.items() if key != _OPEN_API}
    if isinstance(found.get("properties"), dict):
        # pydantic's title of a property is its key in other letters.
        found["properties"] = {key: _untitled(each) for key, each in found["properties"].items()}  # type: ignore[union-attr]
    if "prefixItems" in found:
        found["items"] = found.pop("prefixItems")
    if found.get("default", 0) is None:
        del found["default"]
    if "$ref" in found and len(found) > 1:
        found = {"allOf": [{"$ref": found.pop("$ref")}], **found}
    return found


def _untitled(schema: Json) -> Json:
    if not isinstance(schema, dict) or not isinstance(schema.get("title"), str):
        return schema
    return {key: value for key, value in schema.items() if key != "title"}
