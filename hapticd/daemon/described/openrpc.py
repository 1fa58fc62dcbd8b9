"""The OpenRPC document: every method of the command socket, its params, result and errors."""

from __future__ import annotations

from typing import Final, cast

from hapticd._version import __version__
from hapticd.base.yaml_source import Json
from hapticd.daemon.described.beyond_schema import OF_METHOD, RULES
from hapticd.daemon.described.error_codes import CODES
from hapticd.daemon.described.message_schemas import schema_of
from hapticd.daemon.described.methods_in_words import ANY_MESSAGE, EVERY_METHOD, METHODS
from hapticd.daemon.described.params_schemas import REF, params_model, params_schemas
from hapticd.protocol.messages import PROTOCOL, Code

OPENRPC: Final = "1.3.2"
_EMPTY: Final[dict[str, Json]] = {"type": "object", "description": "An empty map."}
_ABOUT: Final = """\
The requests of hapticd's command socket. `docs/protocol.md` says what everything means; SI units, endings of names say
which.

What differs from JSON-RPC 2.0:

- The transport is ZeroMQ: a DEALER or REQ socket that connects to `hapticd.command` in the daemon's runtime directory,
  a Unix socket. One message is one frame, the body; or an empty frame and the body.
- A body is msgpack, not JSON: one map with the members of a JSON-RPC object. Its strings are UTF-8, its keys strings;
  it has no extension types. It has 2 MiB and 32 levels at most.
- `params` is a map, never an array (by name). There are no batches.
- `integer` in a schema is an integer of msgpack: 1.0 is none. `number` is an integer or a float, and finite.
- nil is null, and a byte string is none of JSON's types: no parameter takes one.
- Answers come in the order of the requests, but for those of long changes. Notifications are carried out and not
  answered.

The schema of a method's params as one object is `x-params`: it also says which go together, and that there are no
others. `x-validation` lists what the daemon validates beyond it. Whatever is refused by schema or by these rules has
code -32602. A stale `expect_revision` (-32001), `set_operator` without a simulation (-32008) are refused before the
rest is validated.
"""


def openrpc_document() -> dict[str, Json]:
    """OpenRPC 1.3 of every request; its JSON Schemas are draft 7."""
    schemas = params_schemas()
    for described in METHODS.values():
        if described.result is not None:
            schemas[described.result.__name__] = schema_of(described.result)
    return {
        "openrpc": OPENRPC,
        "info": {
            "title": "hapticd, requests",
            "version": __version__,
            "description": _ABOUT,
            "license": {"name": "MIT"},
        },
        "x-protocol": PROTOCOL,
        "x-errors-of-any-message": [_error_ref(code) for code in ANY_MESSAGE],
        "methods": [_method(name, schemas) for name in METHODS],
        "components": {
            "schemas": cast(Json, schemas),
            "errors": {code.name: _error(code) for code in Code},
        },
    }


def _error(code: Code) -> Json:
    described = CODES[code]
    data: dict[str, Json] = {"data": described.data} if described.data else {}
    return {"code": int(code), "message": described.when, **data}


def _error_ref(code: Code) -> Json:
    return {"$ref": f"#/components/errors/{code.name}"}


def _ref(result: type) -> dict[str, Json]:
    return {"$ref": f"{REF}{result.__name__}"}


def _method(name: str, schemas: dict[str, dict[str, Json]]) -> Json:
    described, model = METHODS[name], params_model(name).__name__
    params = cast("dict[str, dict[str, Json]]", schemas[model].get("properties", {}))
    required = cast("list[str]", schemas[model].get("required", []))
    result = _EMPTY if described.result is None else _ref(described.result)
    return {
        "name": name,
        "summary": described.summary,
        "paramStructure": "by-name",
        "params": [_param(each, schema, each in required) for each, schema in params.items()],
        "result": {"name": "result", "schema": result},
        "errors": [_error_ref(code) for code in (*EVERY_METHOD, *described.codes)],
        "x-params": {"$ref": f"{REF}{model}"},
        "x-validation": [RULES[rule] for rule in OF_METHOD.get(name, ())],
    }


def _param(name: str, schema: dict[str, Json], required: bool) -> Json:
    told: dict[str, Json] = {"description": schema["description"]} if "description" in schema else {}
    return {"name": name, **told, "required": required, "schema": cast(Json, schema)}
