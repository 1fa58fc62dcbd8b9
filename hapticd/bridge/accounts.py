"""The clients that the configuration names, and what each of them has taken."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from hapticd.base.token_bucket import Bucket
from hapticd.bridge.config import BridgeConfig, BridgeLimits, Right


@dataclass(eq=False, slots=True)
class Account:
    """One client, by its key; its connections share these."""

    name: str
    key: str
    may: Right
    requests: Bucket
    streams: Bucket
    bytes: Bucket
    connections: int = 0
    asked: int = 0
    taken_bytes: int = 0
    waited_s: dict[str, float] = field(default_factory=lambda: {"requests": 0.0, "bytes": 0.0})
    telemetry_dropped: int = 0
    streamed: int = 0
    streams_dropped: int = 0

    def take_request(self) -> float:
        """How long the client has to wait for its next request, s."""
        self.asked += 1
        return self._waits("requests", self.requests.take(1))

    def take_stream(self) -> bool:
        """Whether a message of a stream passes. None waits: it would come too late."""
        passes = self.streams.take_if_there(1)
        self.streams_dropped += not passes
        return passes

    def take_bytes(self, count: int) -> float:
        """How long the client has to wait for its next bytes, s."""
        self.taken_bytes += count
        return self._waits("bytes", self.bytes.take(count))

    def _waits(self, limit: str, wait_s: float) -> float:
        self.waited_s[limit] += wait_s
        return wait_s


def _account(name: str, key: str, may: Right, limits: BridgeLimits) -> Account:
    # A tenth of a second at once: who asks in bunches is not slowed, who floods gets no start.
    requests = Bucket(limits.requests_per_s, max(1.0, limits.requests_per_s / 10))
    streams = Bucket(limits.streams_per_s, max(1.0, limits.streams_per_s / 10))
    return Account(name, key, may, requests, streams, Bucket(limits.bytes_per_s, limits.bytes_per_s))


class Accounts:
    """Clients by public key."""

    def __init__(self, config: BridgeConfig) -> None:
        self.limits = config.limits
        self._by_key = {
            client.public_key: _account(name, client.public_key, client.may, config.limits)
            for name, client in config.clients.items()
        }

    def find(self, key: str) -> Account | None:
        """The client with this public key."""
        return self._by_key.get(key)

    def all(self) -> Iterable[Account]:
        return self._by_key.values()

    def replace(self, config: BridgeConfig) -> list[Account]:
        """Takes a changed configuration; returns the clients that were there and are no more: their key is gone, has
        another name, or another right."""
        before: Mapping[str, Account] = self._by_key
        limited = config.limits != self.limits
        self.limits = config.limits
        self._by_key = {}
        for name, client in config.clients.items():
            account = _account(name, client.public_key, client.may, config.limits)
            known = before.get(client.public_key)
            if known is not None and (known.name, known.may) == (name, client.may):
                if limited:
                    known.requests, known.bytes = account.requests, account.bytes
                    known.streams = account.streams
                account = known
            self._by_key[client.public_key] = account
        return [account for key, account in before.items() if self._by_key.get(key) is not account]
