"""A client that comes, asks a few things, subscribes to something for a while and leaves; for the soak.

python -m tests.soak.visitor JSON    what it is to do (`Visit`); prints what it did as JSON, fails on a wrong answer
"""

from __future__ import annotations

import json
import random
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import zmq

from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client, Subscription, connect
from hapticd.protocol.calls import RemoteError
from hapticd.protocol.messages import Code

TOPICS = ("samples", "state", "event", "change", "status")
TIMEOUT_S = 30.0


@dataclass(frozen=True, slots=True)
class Visit:
    """What a visitor does."""

    place: str
    """The runtime directory."""
    seed: int
    seconds: float
    """How long it stays subscribed."""
    reads: bool = True
    """Whether it reads what it subscribed to."""


@dataclass(slots=True)
class Told:
    """What came of it."""

    asked: int = 0
    received: int = 0
    lost: int = 0
    """Samples that did not arrive."""


def _expect(true: bool, what: str) -> None:
    if not true:
        raise HapticdError(f"a wrong answer: {what}")


def _refused(client: Client, method: str, params: Mapping[str, object], code: Code) -> None:
    try:
        told = client.call(method, params)
    except RemoteError as error:
        _expect(error.code == code, f"{method}: {error.code} {error}")
    else:
        raise HapticdError(f"a wrong answer: {method}: {told!r:.200}")


def _status(client: Client) -> None:
    status = client.get_status()
    _expect(status["state"] == "running" and status["faults"] == [], f"status: {status!r:.300}")


def _scene(client: Client) -> None:
    told = client.get_scene()
    objects = told["scene"]["objects"]
    _expect(isinstance(objects, dict) and "floor" in objects and told["revision"] > 0, f"scene: {told!r:.300}")


def _play(client: Client) -> None:
    told = client.play("wood", amplitude_m_per_s2=1.0)
    _expect(told["tick"] > 0, f"play: {told!r}")


QUESTIONS: tuple[Callable[[Client], None], ...] = (
    _status,
    _scene,
    _play,
    lambda client: _expect("wood" in client.get_materials()["materials"], "materials"),
    lambda client: _expect(client.get_config()["config"]["servo"]["rate_hz"] is not None, "config"),
    lambda client: _refused(client, "update_scene", {"objects": {}, "expect_revision": 0}, Code.STALE_REVISION),
    lambda client: _refused(client, "get_status", {"unknown": 1}, Code.INVALID_PARAMS),
    lambda client: _refused(client, "update_scene", {"objects": {"x": {"kind": "box"}}}, Code.INVALID_PARAMS),
    lambda client: _refused(client, "nothing", {}, Code.NO_SUCH_METHOD),
)
"""None of them changes the scene."""


def _read(client: Client, topic: str, end: float, told: Told) -> None:
    subscribe: dict[str, Callable[..., Subscription[Any]]] = {
        "samples": client.samples,
        "state": client.states,
        "event": client.events,
        "change": lambda timeout_s: client.telemetry("change", timeout_s=timeout_s),
        "status": client.statuses,
    }
    with subscribe[topic](timeout_s=TIMEOUT_S) as feed:
        while time.monotonic() < end:
            item = feed.receive(0.5)
            if item is not None:
                told.received += 1
                told.lost += getattr(item, "lost", 0)


def _ignore(client: Client, seconds: float) -> None:
    """A subscription to everything that is never read, with hardly any room on this side."""
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVHWM, 1)
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        socket.connect(client.paths.telemetry_endpoint)
        time.sleep(seconds)


def pay(visit: Visit) -> Told:
    """Does it. Raises HapticdError where something is not as it should be."""
    rng, told = random.Random(visit.seed), Told()
    with connect(visit.place, TIMEOUT_S) as client:
        for question in rng.choices(QUESTIONS, k=rng.randint(3, 12)):
            question(client)
            told.asked += 1
        if visit.reads:
            _read(client, rng.choice(TOPICS), time.monotonic() + visit.seconds, told)
        else:
            _ignore(client, visit.seconds)
    return told


if __name__ == "__main__":
    try:
        print(json.dumps(asdict(pay(Visit(**json.loads(sys.argv[1]))))))
    except HapticdError as error:
        sys.exit(f"visitor: {error}")
