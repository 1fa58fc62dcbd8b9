"""The bridge's configuration: where it listens, its key, its clients and what they may."""

from __future__ import annotations

import os
from typing import Final, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from hapticd.base.errors import InvalidError, Problem, quoted
from hapticd.base.model import Model, Name, faults_of
from hapticd.base.yaml_source import MAX_BYTES, Document, load_bytes
from hapticd.config.document_kinds import refuse_other_kinds
from hapticd.protocol.keys import is_key
from hapticd.protocol.messages import MAX_BODY
from hapticd.protocol.remote import PORT, host_and_port, is_loopback
from hapticd.system.trusted_files import read_trusted

METRICS_PORT: Final = 9417
MOST_CONNECTIONS: Final = 128
"""Each takes eight descriptors and one of the thousand sockets of libzmq, or two."""

Right = Literal["watch", "command"]


class BridgeClient(Model):
    """Whom a key belongs to, and what it may."""

    public_key: str = Field(description="Its public key, 40 characters of Z85.")
    may: Right = Field(description="Telemetry alone, or commands too.")

    @field_validator("public_key")
    @classmethod
    def _is_a_key(cls, text: str) -> str:
        if not is_key(text):
            raise ValueError(f"must be a public key, 40 characters of Z85, is {quoted(text)}")
        return text


class BridgeLimits(Model):
    """What one client, by its key, may take of the bridge."""

    requests_per_s: float = Field(default=500.0, ge=1, le=1e6, description="Requests of a client; more wait.")
    streams_per_s: float = Field(
        default=2500.0, ge=1, le=1e6, description="Streamed targets and forces of a client; more are dropped."
    )
    bytes_per_s: float = Field(default=2.0**20, ge=1024, le=1e9, description="Bytes from a client; more wait.")
    message_bytes: int = Field(default=MAX_BODY, ge=1024, le=MAX_BODY, description="Largest request.")
    connections_per_client: int = Field(
        default=16, ge=1, le=MOST_CONNECTIONS, description="Connections of a client, each subscription has one."
    )
    connections: int = Field(default=64, ge=1, le=MOST_CONNECTIONS, description="Connections of all clients.")


class BridgeConfig(Model):
    """Everything that the bridge's file holds."""

    listen: str = Field(
        default=f"tcp://127.0.0.1:{PORT}",
        description="Where commands are taken; telemetry has the port after it. `*`: every address of the machine.",
    )
    server_key: str = Field(
        default="keys/server.key_secret", description="The file of the bridge's own key, from this file's folder."
    )
    metrics: str | None = Field(
        default=f"127.0.0.1:{METRICS_PORT}", description="Where Prometheus asks, on a loopback address; null: nowhere."
    )
    limits: BridgeLimits = Field(default=BridgeLimits(), description="What a client may take.")
    clients: dict[Name, BridgeClient] = Field(default={}, max_length=1000, description="Clients by name.")

    @field_validator("listen")
    @classmethod
    def _listens(cls, text: str) -> str:
        _, port = host_and_port(text)
        if port == 65535:
            raise ValueError("the port must be at most 65534; telemetry has the one after it")
        return text

    @field_validator("metrics")
    @classmethod
    def _stays_here(cls, text: str | None) -> str | None:
        if text is not None:
            metrics_place(text)
        return text

    @model_validator(mode="after")
    def _one_name_for_a_key(self) -> Self:
        names: dict[str, str] = {}
        for name, client in self.clients.items():
            other = names.setdefault(client.public_key, name)
            if other != name:
                raise ValueError(f"clients {quoted(other)} and {quoted(name)} have the same public_key")
        return self


def metrics_place(text: str) -> tuple[str, int]:
    """Host and port of HOST:PORT, which must be loopback: metrics go in the clear. Raises ValueError."""
    try:
        host, port = host_and_port(f"tcp://{text}")
    except ValueError:
        raise ValueError(f"must be HOST:PORT, such as 127.0.0.1:{METRICS_PORT}, is {quoted(text)}") from None
    if not is_loopback(host):
        raise ValueError(
            f"must be on a loopback address such as 127.0.0.1, is {quoted(text)}: metrics are not encrypted"
        )
    return host, port


def load_bridge(path: str | os.PathLike[str]) -> BridgeConfig:
    """The configuration in a file, with `server_key` as a path from here.

    Raises InvalidError, which names every fault with file, line and key; HapticdError for a file that cannot be read,
    or that others than root and we may change: it says who is let in.
    """
    document = load_bytes(read_trusted(path, MAX_BYTES), os.fspath(path))
    refuse_other_kinds(document, "bridge")
    if not isinstance(document.data, dict):
        known = ", ".join(BridgeConfig.model_fields)
        raise InvalidError([Problem(document.where(()), f"must be a mapping; known keys: {known}")])
    config = _validated(document)
    key = os.path.join(os.path.dirname(os.fspath(path)), config.server_key)
    return config.model_copy(update={"server_key": key})


def _validated(document: Document) -> BridgeConfig:
    try:
        return BridgeConfig.parsed(document.data)
    except ValidationError as error:
        faults = faults_of(error)
        raise InvalidError(document.problem(path, text) for path, text in faults) from None
