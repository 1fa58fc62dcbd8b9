"""The documents: OpenRPC of the requests of the command socket, AsyncAPI of telemetry and streams."""

from __future__ import annotations

from typing import Final, NamedTuple, cast

from hapticd._version import __version__
from hapticd.base.yaml_source import Json
from hapticd.daemon.described.schemas import REF, event_schema, params_model, params_schemas, samples_schema, schema_of
from hapticd.daemon.described.words import (
    CODES,
    CODES_OF_ANY_MESSAGE,
    CODES_OF_EVERY_METHOD,
    METHODS,
    RULES,
    RULES_OF_METHOD,
)
from hapticd.daemon.telemetry import SAMPLES_INTERVAL_S, STATE_INTERVAL_S, STATUS_INTERVAL_S
from hapticd.protocol import results
from hapticd.protocol.messages import PROTOCOL, Code
from hapticd.protocol.streams import METHODS as STREAMS

# ---- OpenRPC ---------------------------------------------------------------------------------------------------------

OPENRPC: Final = "1.3.2"
_EMPTY: Final[dict[str, Json]] = {"type": "object", "description": "An empty map."}
_ABOUT_REQUESTS: Final = """\
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
            "description": _ABOUT_REQUESTS,
            "license": {"name": "MIT"},
        },
        "x-protocol": PROTOCOL,
        "x-errors-of-any-message": [_error_ref(code) for code in CODES_OF_ANY_MESSAGE],
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
        "errors": [_error_ref(code) for code in (*CODES_OF_EVERY_METHOD, *described.codes)],
        "x-params": {"$ref": f"{REF}{model}"},
        "x-validation": [RULES[rule] for rule in RULES_OF_METHOD.get(name, ())],
    }


def _param(name: str, schema: dict[str, Json], required: bool) -> Json:
    told: dict[str, Json] = {"description": schema["description"]} if "description" in schema else {}
    return {"name": name, **told, "required": required, "schema": cast(Json, schema)}


# ---- AsyncAPI --------------------------------------------------------------------------------------------------------

ASYNCAPI: Final = "3.0.0"
_MSGPACK: Final = "application/msgpack"
_ABOUT_TELEMETRY: Final = """\
What hapticd sends by itself, and what is streamed to it. `docs/protocol.md` says what everything means; SI units,
endings of names say which. Requests and their answers are in the OpenRPC document.

- The transport is ZeroMQ over Unix sockets in the daemon's runtime directory; the address of a channel is a topic of
  `hapticd.telemetry` (PUB, connect with SUB), or `hapticd.command` (ROUTER, connect with DEALER).
- A message of telemetry has two frames, the topic in ASCII and a map in msgpack, which the payload describes. Clients
  ignore members that they do not know. A subscriber that reads too slowly loses messages.
- A message of a stream has one frame, a map in msgpack: a JSON-RPC 2.0 notification.
"""


class _Topic(NamedTuple):
    name: str
    told: str
    payload: dict[str, Json]


def _topics() -> list[_Topic]:
    return [
        _Topic("samples", f"Every tick, in batches that leave every {1e3 * SAMPLES_INTERVAL_S:.0f} ms.", samples_schema()),
        _Topic("state", f"The newest sample, {1 / STATE_INTERVAL_S:.0f} times a second.", schema_of(results.State)),
        _Topic("event", "What happened: contacts, ruptures, faults, marks.", event_schema()),
        _Topic("change", "What commands changed, once they did.", schema_of(results.Change)),
        _Topic("status", f"What `get_status` answers, every {STATUS_INTERVAL_S:.0f} s.", schema_of(results.Status)),
    ]


def asyncapi_document() -> dict[str, Json]:
    """AsyncAPI 3.0 of telemetry and streams; its JSON Schemas are draft 7."""
    schemas = params_schemas()
    topics = _topics()
    channels: dict[str, Json] = {
        topic.name: {
            "address": topic.name,
            "description": topic.told,
            "servers": [{"$ref": "#/servers/telemetry"}],
            "messages": {topic.name: {"$ref": f"#/components/messages/{topic.name}"}},
        }
        for topic in topics
    }
    channels["command"] = {
        "address": None,
        "description": "Requests and notifications; those of streams are described here.",
        "servers": [{"$ref": "#/servers/command"}],
        "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in STREAMS},
    }
    messages = {topic.name: _message(topic.name, topic.told, topic.payload) for topic in topics}
    told = "One message of a stream, up to 1,000 a second. It is not answered; the newest counts."
    messages |= {name: _message(name, told, _notification(name)) for name in STREAMS}
    return {
        "asyncapi": ASYNCAPI,
        "info": {
            "title": "hapticd, telemetry and streams",
            "version": __version__,
            "description": _ABOUT_TELEMETRY,
            "license": {"name": "MIT"},
        },
        "x-protocol": PROTOCOL,
        "defaultContentType": _MSGPACK,
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
            "runtime_directory": {"description": "`hapticd paths` prints it, for example /run/user/1000/hapticd."}
        },
    }


def _message(name: str, told: str, payload: dict[str, Json]) -> Json:
    return {"name": name, "summary": told, "contentType": _MSGPACK, "payload": payload}


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
            "params": {"$ref": f"{REF}{params_model(method).__name__}"},
        },
        "additionalProperties": False,
    }
