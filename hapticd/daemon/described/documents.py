"""The OpenRPC document of the command socket's requests, and the AsyncAPI document of telemetry and streams."""

from __future__ import annotations

from typing import Final, NamedTuple, cast

from hapticd._version import __version__
from hapticd.base.yaml_source import Json
from hapticd.daemon.described.schemas import (
    SCHEMA_REF_PREFIX,
    event_schema,
    params_model,
    params_schemas,
    samples_schema,
    schema_of,
)
from hapticd.daemon.described.words import (
    CODE_DESCRIPTIONS,
    CODES_OF_ANY_MESSAGE,
    CODES_OF_EVERY_METHOD,
    METHOD_DESCRIPTIONS,
    RULES_OF_METHOD,
    VALIDATION_RULES,
)
from hapticd.daemon.telemetry import (
    SAMPLES_INTERVAL_S,
    STATE_INTERVAL_S,
    STATUS_INTERVAL_S,
)
from hapticd.protocol import results
from hapticd.protocol.messages import PROTOCOL_VERSION, Code
from hapticd.protocol.streams import STREAM_KIND_BY_METHOD as STREAMS

# ---- OpenRPC ---------------------------------------------------------------------------------------------------------

OPENRPC_VERSION: Final = "1.3.2"
_EMPTY_MAP_SCHEMA: Final[dict[str, Json]] = {"type": "object", "description": "An empty map."}
_ABOUT_REQUESTS: Final = """\
The requests of hapticd's command socket. `docs/protocol.md` explains all members. Quantities are in SI units; the
ending of a name is its unit.

Differences from JSON-RPC 2.0:

- The transport is ZeroMQ: a DEALER or REQ socket that connects to the Unix socket `hapticd.command` in the daemon's
  runtime directory. One message is one frame, the body; or an empty frame and the body.
- A body is msgpack, not JSON: one map with the members of a JSON-RPC object. Its strings are UTF-8, its keys are
  strings, and it has no extension types. It has at most 2 MiB and 32 levels.
- `params` is a map (by name), never an array. Batches are not supported.
- `integer` in a schema is a msgpack integer: 1.0 is refused. `number` is a finite integer or float.
- nil is null. No parameter accepts a byte string.
- Answers come in the order of the requests, except those of long changes. Notifications are carried out and not
  answered.

`x-params` is the schema of all params of a method together: it also states which exclude each other, and refuses
unknown params. `x-validation` lists rules that the daemon validates in addition. Params that break the schema or a
rule are refused with code -32602. A stale `expect_revision` is refused (-32001) before scene, objects and materials are
validated, `set_operator` without the simulated joystick (-32008) before its params are.
"""


def openrpc_document() -> dict[str, Json]:
    """Return the OpenRPC 1.3 document of all requests. Its JSON Schemas are draft 7."""
    schemas = params_schemas()
    for described in METHOD_DESCRIPTIONS.values():
        if described.result is not None:
            schemas[described.result.__name__] = schema_of(described.result)
    return {
        "openrpc": OPENRPC_VERSION,
        "info": {
            "title": "hapticd, requests",
            "version": __version__,
            "description": _ABOUT_REQUESTS,
            "license": {"name": "MIT"},
        },
        "x-protocol": PROTOCOL_VERSION,
        "x-errors-of-any-message": [_error_ref(code) for code in CODES_OF_ANY_MESSAGE],
        "methods": [_method(name, schemas) for name in METHOD_DESCRIPTIONS],
        "components": {
            "schemas": cast(Json, schemas),
            "errors": {code.name: _error(code) for code in Code},
        },
    }


def _error(code: Code) -> Json:
    described = CODE_DESCRIPTIONS[code]
    data: dict[str, Json] = {"data": described.data} if described.data else {}
    return {"code": int(code), "message": described.when, **data}


def _error_ref(code: Code) -> Json:
    return {"$ref": f"#/components/errors/{code.name}"}


def _ref(result: type) -> dict[str, Json]:
    return {"$ref": f"{SCHEMA_REF_PREFIX}{result.__name__}"}


def _method(name: str, schemas: dict[str, dict[str, Json]]) -> Json:
    described, model = METHOD_DESCRIPTIONS[name], params_model(name).__name__
    params = cast("dict[str, dict[str, Json]]", schemas[model].get("properties", {}))
    required = cast("list[str]", schemas[model].get("required", []))
    result = _EMPTY_MAP_SCHEMA if described.result is None else _ref(described.result)
    return {
        "name": name,
        "summary": described.summary,
        "paramStructure": "by-name",
        "params": [_param(each, schema, each in required) for each, schema in params.items()],
        "result": {"name": "result", "schema": result},
        "errors": [_error_ref(code) for code in (*CODES_OF_EVERY_METHOD, *described.codes)],
        "x-params": {"$ref": f"{SCHEMA_REF_PREFIX}{model}"},
        "x-validation": [VALIDATION_RULES[rule] for rule in RULES_OF_METHOD.get(name, ())],
    }


def _param(name: str, schema: dict[str, Json], required: bool) -> Json:
    about: dict[str, Json] = {"description": schema["description"]} if "description" in schema else {}
    return {"name": name, **about, "required": required, "schema": cast(Json, schema)}


# ---- AsyncAPI --------------------------------------------------------------------------------------------------------

ASYNCAPI_VERSION: Final = "3.0.0"
_MSGPACK_MEDIA_TYPE: Final = "application/msgpack"
_ABOUT_TELEMETRY: Final = """\
The telemetry that hapticd publishes, and the messages that clients stream to it. `docs/reference/telemetry.md`,
`events.md` and `status.md` explain the members. Quantities are in SI units; the ending of a name is its unit. Requests
and their answers are in the OpenRPC document.

- The transport is ZeroMQ over Unix sockets in the daemon's runtime directory: `hapticd.telemetry` (PUB, connect with
  SUB) and `hapticd.command` (ROUTER, connect with DEALER). The address of a telemetry channel is its topic.
- A telemetry message has two frames: the topic in ASCII, and a map in msgpack, which the payload describes. Clients
  must ignore members that they do not know. A subscriber that reads too slowly loses messages.
- A message of a stream has one frame, a map in msgpack: a JSON-RPC 2.0 notification.
"""


class _Topic(NamedTuple):
    """A topic of telemetry, as the AsyncAPI document describes it."""

    name: str
    summary: str
    payload: dict[str, Json]


def _topics() -> list[_Topic]:
    return [
        _Topic("samples", f"One sample a tick, in batches every {1e3 * SAMPLES_INTERVAL_S:.0f} ms.", samples_schema()),
        _Topic("state", f"The newest sample, {1 / STATE_INTERVAL_S:.0f} times a second.", schema_of(results.State)),
        _Topic("event", "Events: contacts, ruptures, faults, marks and others.", event_schema()),
        _Topic("change", "What a command changed, sent after the change.", schema_of(results.Change)),
        _Topic("status", f"The result of `get_status`, every {STATUS_INTERVAL_S:.0f} s.", schema_of(results.Status)),
    ]


def asyncapi_document() -> dict[str, Json]:
    """Return the AsyncAPI 3.0 document of telemetry and streams. Its JSON Schemas are draft 7."""
    schemas = params_schemas()
    topics = _topics()
    channels: dict[str, Json] = {
        topic.name: {
            "address": topic.name,
            "description": topic.summary,
            "servers": [{"$ref": "#/servers/telemetry"}],
            "messages": {topic.name: {"$ref": f"#/components/messages/{topic.name}"}},
        }
        for topic in topics
    }
    channels["command"] = {
        "address": None,
        "description": "Requests and notifications. This document describes those of streams.",
        "servers": [{"$ref": "#/servers/command"}],
        "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in STREAMS},
    }
    messages = {topic.name: _message(topic.name, topic.summary, topic.payload) for topic in topics}
    summary = "A message of a stream, up to 1,000 a second. It is not answered; a newer one replaces it."
    messages |= {name: _message(name, summary, _notification(name)) for name in STREAMS}
    return {
        "asyncapi": ASYNCAPI_VERSION,
        "info": {
            "title": "hapticd, telemetry and streams",
            "version": __version__,
            "description": _ABOUT_TELEMETRY,
            "license": {"name": "MIT"},
        },
        "x-protocol": PROTOCOL_VERSION,
        "defaultContentType": _MSGPACK_MEDIA_TYPE,
        "servers": {name: _server(name) for name in ("telemetry", "command")},
        "channels": channels,
        "operations": {
            **{topic.name: _operation("send", topic.name, topic.name) for topic in topics},
            **{name: _operation("receive", "command", name) for name in STREAMS},
        },
        "components": {
            "messages": messages,
            "schemas": cast(
                Json, {model: schemas[model] for model in (params_model(name).__name__ for name in STREAMS)}
            ),
        },
    }


def _server(name: str) -> Json:
    return {
        "host": "{runtime_directory}",
        "pathname": f"/hapticd.{name}",
        "protocol": "zmq",
        "protocolVersion": "ZMTP 3.1",
        "description": f"Connect to `ipc://{{runtime_directory}}/hapticd.{name}`.",
        "variables": {
            "runtime_directory": {
                "description": "`hapticd doctor --paths` prints it, for example /run/user/1000/hapticd."
            }
        },
    }


def _message(name: str, summary: str, payload: dict[str, Json]) -> Json:
    return {"name": name, "summary": summary, "contentType": _MSGPACK_MEDIA_TYPE, "payload": payload}


def _operation(action: str, channel: str, message: str) -> Json:
    return {
        "action": action,
        "channel": {"$ref": f"#/channels/{channel}"},
        "messages": [{"$ref": f"#/channels/{channel}/messages/{message}"}],
    }


def _notification(method: str) -> dict[str, Json]:
    return {
        "type": "object",
        "required": ["jsonrpc", "method", "params"],
        "properties": {
            "jsonrpc": {"const": "2.0"},
            "method": {"const": method},
            "params": {"$ref": f"{SCHEMA_REF_PREFIX}{params_model(method).__name__}"},
        },
        "additionalProperties": False,
    }
