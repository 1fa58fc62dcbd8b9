"""The documents of the protocol: validators of OpenRPC and AsyncAPI accept them, and a daemon's messages match them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgpack
import pytest
import zmq
from click.testing import CliRunner
from jsonschema import Draft7Validator
from referencing import Registry, Resource

from hapticd.base.core import EventKind
from hapticd.cli import cli
from hapticd.daemon.described.documents import asyncapi_document, openrpc_document
from hapticd.daemon.described.words import CODE_DESCRIPTIONS, METHOD_DESCRIPTIONS, RULES_OF_METHOD
from hapticd.daemon.methods import METHOD_PARAMS
from hapticd.daemon.telemetry import TELEMETRY_TOPICS
from hapticd.protocol.messages import Code
from tests.support.daemon_process import PATIENCE_S, Daemon, Wire, running_daemon, wired
from tests.support.schema_messages import validator

METASCHEMAS: Final = Path(__file__).parents[1] / "data" / "metaschemas"
OPENRPC: Final[Any] = openrpc_document()
ASYNCAPI: Final[Any] = asyncapi_document()
COMPONENTS: Final[Any] = OPENRPC["components"]["schemas"]
WALL = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
WHISTLE = {"stiffness_n_per_m": 100, "tap": {"attack_slope_per_s": 1, "frequency_hz": 50_000, "decay_time_s": 0.001}}
CALLS: Final[dict[str, dict[str, Any]]] = {
    "get_status": {"detail": True},
    "get_state": {},
    "get_config": {},
    "get_scene": {},
    "set_scene": {"scene": {"objects": {"floor": WALL}}, "wait": True},
    "update_scene": {"objects": {"floor": {"material": "steel"}}},
    "get_materials": {},
    "set_materials": {"materials": {"whistle": WHISTLE}},
    "update_materials": {"materials": {"whistle": {"damping_n_s_per_m": 1}}},
    "apply": {"scene": {"objects": {"floor": WALL}}, "wait": True},
    "play": {"material": "wood", "direction": [0, 1], "amplitude_m_per_s2": 1},
    "reset": {},
    "mark": {"text": "here", "data": {"trial": 1}},
    "set_forces": {"enabled": True},
    "set_operator": {"gesture": {"kind": "tap", "object": "floor", "speed_m_per_s": 0.2}},
    "stream_target": {"seq": 1, "position_m": [0, 0.01]},
    "stream_force": {"seq": 1, "force_n": [0, 0.1]},
    "lease": {"duration_s": 10},
    "reload": {},
    "dump_flight": {},
}


def closed(schema: Any) -> Any:
    """Return the schema with closed objects, so that a sent member that the schema lacks is an error."""
    if isinstance(schema, list):
        return [closed(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: closed(value) for key, value in schema.items()}
    return {"additionalProperties": False, **found} if "properties" in found else found


def metaschema(name: str) -> Any:
    return json.loads((METASCHEMAS / name).read_text())


# ---- The documents -------------------------------------------------------------------------------------------------


def test_the_meta_schemas_are_those_that_were_published() -> None:
    """The list in the folder has their hashes, packages and licences."""
    listed = (METASCHEMAS / "README.md").read_text()
    files = sorted(METASCHEMAS.glob("*.json"))
    assert len(files) == 3
    for file in files:
        assert hashlib.sha256(file.read_bytes()).hexdigest() in listed, file.name


@pytest.mark.long
def test_the_openrpc_document_is_one() -> None:
    meta, dialect = metaschema("openrpc.json"), metaschema("json-schema-tools.json")
    registry: Registry[Any] = Registry().with_resources(
        [(address, Resource.from_contents(dialect, default_specification=_draft7())) for address in _addresses(dialect)]
    )
    check = Draft7Validator(meta, registry=registry)
    assert [error.message for error in check.iter_errors(OPENRPC)] == []
    broken = {**OPENRPC, "methods": [{"name": "x"}]}
    assert not check.is_valid(broken)
    for name in COMPONENTS:
        Draft7Validator.check_schema(COMPONENTS[name])


def _addresses(dialect: Any) -> list[str]:
    return [dialect["$id"], dialect["$id"].rstrip("/")]


def _draft7() -> Any:
    from referencing.jsonschema import DRAFT7

    return DRAFT7


def test_the_asyncapi_document_is_one() -> None:
    check = Draft7Validator(metaschema("asyncapi-3.0.0.json"))
    assert [error.message for error in check.iter_errors(ASYNCAPI)] == []
    broken = {**ASYNCAPI, "channels": {"samples": {"adress": "samples"}}}
    assert not check.is_valid(broken)


@pytest.mark.parametrize("document", [OPENRPC, ASYNCAPI], ids=["openrpc", "asyncapi"])
def test_every_reference_leads_somewhere(document: Any) -> None:
    references = _references(document)
    assert references
    for reference in references:
        found = document
        for part in reference.removeprefix("#/").split("/"):
            found = found[part]


def _references(tree: Any) -> set[str]:
    if isinstance(tree, list):
        return set().union(*map(_references, tree))
    if not isinstance(tree, dict):
        return set()
    own = {tree["$ref"]} if isinstance(tree.get("$ref"), str) else set()
    return own.union(*map(_references, tree.values()))


def test_every_method_code_and_topic_is_described() -> None:
    assert [*METHOD_DESCRIPTIONS] == [*METHOD_PARAMS] == [method["name"] for method in OPENRPC["methods"]] == [*CALLS]
    assert [*CODE_DESCRIPTIONS] == [*Code]
    assert [channel for channel in ASYNCAPI["channels"] if channel != "command"] == [*TELEMETRY_TOPICS]
    assert RULES_OF_METHOD.keys() <= METHOD_DESCRIPTIONS.keys()


@pytest.mark.parametrize(("protocol", "document"), [("openrpc", OPENRPC), ("asyncapi", ASYNCAPI)])
def test_the_command_prints_it(protocol: str, document: Any) -> None:
    result = CliRunner().invoke(cli, ["schema", "--protocol", protocol])
    assert result.exit_code == 0
    assert json.loads(result.stdout) == document


# ---- What a daemon answers and sends ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    with running_daemon() as daemon:
        yield daemon


@pytest.fixture(scope="module")
def wire(daemon: Daemon) -> Iterator[Wire]:
    with wired(daemon) as wire:
        yield wire


@pytest.fixture(scope="module")
def sent(daemon: Daemon, wire: Wire) -> dict[str, list[Any]]:
    """Messages of each topic while every method was called, and the results by method, as "method NAME"."""
    found: dict[str, list[Any]] = {topic: [] for topic in TELEMETRY_TOPICS}
    with zmq.Context() as context, context.socket(zmq.SUB) as telemetry:
        telemetry.setsockopt(zmq.RCVTIMEO, int(1e3 * PATIENCE_S))
        telemetry.connect(f"ipc://{daemon.directory}/hapticd.telemetry")
        for topic in (*TELEMETRY_TOPICS, "state"):
            telemetry.subscribe(topic)

        def hear() -> str:
            topic, body = telemetry.recv_multipart()
            found[topic.decode()].append(msgpack.unpackb(body))
            return topic.decode()

        while hear() != "state":
            pass
        for method, params in CALLS.items():
            if method == "play":  # a machine that was busy for a second has faded the forces
                wire.result("set_forces", enabled=True)
            found[f"method {method}"] = [wire.result(method, **params)]
        wire.result("lease", duration_s=0, token=found["method lease"][0]["token"])
        # The reload brought the scene of the configuration, and the stream took the hand.
        for method in ("set_scene", "set_operator"):
            wire.result(method, **CALLS[method])
        while not {"contact", "mark", "release"} <= {event["event"] for event in found["event"]} or not found["status"]:
            hear()
    return found


@pytest.mark.parametrize("method", OPENRPC["methods"], ids=lambda method: method["name"])
def test_a_result_is_as_described(sent: dict[str, list[Any]], method: Any) -> None:
    check = validator(closed(method["result"]["schema"]), closed(COMPONENTS))
    (result,) = sent[f"method {method['name']}"]
    assert [error.message for error in check.iter_errors(result)] == []


@pytest.mark.parametrize("topic", TELEMETRY_TOPICS)
def test_telemetry_is_as_described(sent: dict[str, list[Any]], topic: str) -> None:
    payload = ASYNCAPI["components"]["messages"][topic]["payload"]
    check = validator(closed(payload), {})
    assert sent[topic]
    for message in sent[topic]:
        if topic == "samples":
            assert type(message["data"]) is bytes
            message = {**message, "data": ""}
        assert [error.message for error in check.iter_errors(message)] == [], message


@pytest.mark.long
def test_every_kind_of_event_is_described() -> None:
    kinds = ASYNCAPI["components"]["messages"]["event"]["payload"]["oneOf"]
    assert [each["properties"]["event"]["const"] for each in kinds] == [kind.name.lower() for kind in EventKind]


@pytest.mark.long
def test_an_error_has_a_code_of_the_method(wire: Wire) -> None:
    method = next(each for each in OPENRPC["methods"] if each["name"] == "set_scene")
    named = {reference["$ref"].rpartition("/")[2] for reference in method["errors"]}
    codes = {OPENRPC["components"]["errors"][name]["code"] for name in named}
    assert wire.error("set_scene", scene={}, expect_revision=4_000_000_000)["code"] in codes
    assert wire.error("set_scene", scene=1)["code"] in codes
