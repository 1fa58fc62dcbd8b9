"""The AsyncAPI document: the topics of the telemetry socket, and the messages of streams on the command socket."""

from __future__ import annotations

from typing import Final, NamedTuple, cast

from hapticd._version import __version__
from hapticd.base.yaml_source import Json
from hapticd.daemon.described.message_schemas import event_schema, samples_schema, schema_of
from hapticd.daemon.described.params_schemas import REF, params_model, params_schemas
from hapticd.daemon.telemetry import SAMPLES_EVERY_S, STATE_EVERY_S, STATUS_EVERY_S
from hapticd.protocol import results
from hapticd.protocol.messages import PROTOCOL
from hapticd.protocol.streams import METHODS as STREAMS

ASYNCAPI: Final = "3.0.0"
_MSGPACK: Final = "application/msgpack"
_ABOUT: Final = """\
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
        _Topic("samples", f"Every tick, in batches that leave every {1e3 * SAMPLES_EVERY_S:.0f} ms.", samples_schema()),
        _Topic("state", f"The newest sample, {1 / STATE_EVERY_S:.0f} times a second.", schema_of(results.State)),
        _Topic("event", "What happened: contacts, ruptures, faults, marks.", event_schema()),
        _Topic("change", "What commands changed, once they did.", schema_of(results.Change)),
        _Topic("status", f"What `get_status` answers, every {STATUS_EVERY_S:.0f} s.", schema_of(results.Status)),
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
            "description": _ABOUT,
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
