"""Changes are made in steps, in their order, and other requests are answered between the steps."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import msgpack
import numpy as np
import pytest

from hapticd.base import codec, lattice
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, load_config
from hapticd.daemon import dispatch as dispatching
from hapticd.daemon import methods as methods_module
from hapticd.daemon.dispatch import Dispatch
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.router import Router
from hapticd.protocol import messages

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
SANDED = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "sand"}


def models(count: int, seed: int = 1) -> list[dict[str, Any]]:
    """Return autoregressive models that no other test uses."""
    random = np.random.default_rng(seed)
    return [
        {
            "speed_m_per_s": 0.01 * (1 + place),
            "force_n": 1.0,
            "coefficients": list(lattice.coefficients_of(random.uniform(-0.5, 0.5, 6))),
            "rms_m_per_s2": 1.0,
        }
        for place in range(count)
    ]


def sand(count: int = 3, seed: int = 1) -> dict[str, Any]:
    texture = {"kind": "autoregressive", "rate_hz": 2000.0, "models": models(count, seed)}
    return {"stiffness_n_per_m": 300.0, "texture": texture}


def taken(seed: int = 1) -> dict[str, Any]:
    """Return params of `apply` that take long."""
    return {"materials": {"sand": sand(seed=seed)}, "scene": {"objects": {"floor": SANDED}}}


SERVO = {"realtime": "off", "overruns": {"threshold": 1.0}}


class Daemon:
    """A daemon without sockets: the command thread, step by step."""

    def __init__(self, load: Callable[[], tuple[Config, str]] | None = None) -> None:
        config = load_config({"device": {"kind": "sim"}, "servo": SERVO})
        self.engine = Engine(config)
        self.methods = Methods(self.engine, load)
        self.woken = threading.Event()
        self.dispatch = Dispatch(self.methods, wake=self.woken.set)
        self.answers: dict[object, dict[str, Any]] = {}
        self._next = 0

    def send(self, method: str, params: dict[str, Any] | None = None, notification: bool = False) -> int:
        self._next += 1
        message: dict[str, Any] = {"jsonrpc": "2.0", "method": method, "params": params or {}}
        if not notification:
            message["id"] = self._next
        self.dispatch.take(codec.encode(message), self._reply)
        return self._next

    def _reply(self, body: bytes) -> None:
        answer = msgpack.unpackb(body)
        self.answers[answer["id"]] = answer

    def ask(self, method: str, params: dict[str, Any] | None = None) -> Any:
        """Return the result of a request that is answered at once."""
        return self.answers[self.send(method, params)]["result"]

    def code(self, id: int) -> int:
        return int(self.answers[id]["error"]["code"])

    def go_on(self) -> int:
        """Make all changes, and return the number of steps."""
        steps = 0
        while self.dispatch.busy:
            self.dispatch.continue_change()
            steps += 1
        return steps


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    """A daemon that makes one step of a change at a time."""
    monkeypatch.setattr(dispatching, "CHANGE_SLICE_NS", 0)
    made = Daemon()
    made.engine.start()
    yield made
    made.engine.stop()


def test_others_are_answered_between_the_steps_of_a_change(daemon: Daemon) -> None:
    before = daemon.ask("get_status")
    long = daemon.send("apply", taken())
    assert daemon.dispatch.busy
    assert daemon.ask("get_status")["revision"] == before["revision"]
    assert daemon.ask("get_scene")["scene"]["objects"] == {}
    assert daemon.ask("set_forces", {"enabled": False})["forces"] == "off"
    assert daemon.ask("set_forces", {"enabled": True})["forces"] == "on"
    token = daemon.ask("lease", {"duration_s": 60})["token"]
    assert daemon.ask("lease", {"duration_s": 0, "token": token})["token"] is None
    assert daemon.ask("mark", {"text": "meanwhile"})["tick"] > 0
    assert daemon.ask("reset")["tick"] > 0
    assert long not in daemon.answers
    assert daemon.go_on() > 3  # a step for each filter, at least
    assert daemon.answers[long]["result"]["revision"] == before["revision"] + 1
    assert list(daemon.ask("get_scene")["scene"]["objects"]) == ["floor"]


def test_changes_are_made_in_the_order_in_which_they_came(daemon: Daemon) -> None:
    revision = daemon.ask("get_status")["revision"]
    long = daemon.send("apply", taken())
    one = daemon.send("update_scene", {"objects": {"floor": {"point_m": [0, -0.001]}}})
    other = daemon.send("update_scene", {"objects": {"floor": {"point_m": [0, -0.002]}}, "wait": True})
    assert not {long, one, other} & daemon.answers.keys()
    daemon.go_on()
    assert [daemon.answers[id]["result"]["revision"] - revision for id in (long, one, other)] == [1, 2, 3]
    # The first tick, 0, may have this revision.
    assert 0 <= daemon.answers[other]["result"]["tick"] <= daemon.ask("get_status")["tick"]
    assert daemon.ask("get_scene")["scene"]["objects"]["floor"]["point_m"] == [0, -0.002]


def test_no_more_changes_wait_than_there_is_room_for(daemon: Daemon) -> None:
    long = daemon.send("apply", taken())
    silent = daemon.send("update_scene", {"objects": {}}, notification=True)
    waiting = [daemon.send("update_scene", {"objects": {}}) for _ in range(dispatching.MAX_WAITING_CHANGES - 2)]
    assert daemon.code(daemon.send("update_scene", {"objects": {}})) == messages.Code.RING_FULL
    daemon.go_on()
    assert "result" in daemon.answers[long] and all("result" in daemon.answers[id] for id in waiting)
    assert silent not in daemon.answers


def test_a_revision_is_expected_when_the_change_is_made(daemon: Daemon) -> None:
    revision = daemon.ask("get_status")["revision"]
    long = daemon.send("apply", taken() | {"expect_revision": revision})
    late = daemon.send("update_scene", {"objects": {"floor": None}, "expect_revision": revision})
    right = daemon.send("update_scene", {"objects": {"floor": None}, "expect_revision": revision + 1})
    # A step down of the servo to another rate is a revision, too.
    state = daemon.engine.state
    daemon.engine.state = state._replace(revision=revision + 5)
    daemon.go_on()
    assert [daemon.code(id) for id in (long, late, right)] == [messages.Code.STALE_REVISION] * 3
    assert daemon.answers[long]["error"]["data"] == {"revision": revision + 5}
    assert daemon.engine.state.scene is state.scene and daemon.engine.state.materials is state.materials


def test_a_refused_change_changes_nothing_and_the_next_one_is_made(daemon: Daemon) -> None:
    before = daemon.engine.state
    faulty = taken()
    faulty["scene"]["objects"]["floor"] = FLOOR | {"material": "no such"}
    long, next_one = daemon.send("apply", faulty), daemon.send("update_scene", {"objects": {}})
    while long not in daemon.answers:
        daemon.dispatch.continue_change()
    assert daemon.code(long) == messages.Code.INVALID_PARAMS
    assert daemon.engine.state is before
    daemon.go_on()
    assert "result" in daemon.answers[next_one]


def test_reloads_wait_for_other_changes_and_become_one(monkeypatch: pytest.MonkeyPatch) -> None:
    notified: list[str] = []
    monkeypatch.setattr(dispatching.notify, "reloading", lambda: notified.append("reloading"))
    monkeypatch.setattr(dispatching.notify, "ready", lambda: notified.append("ready"))
    read, loads = threading.Event(), []

    def load() -> tuple[Config, str]:
        loads.append(1)
        assert read.wait(60)
        raise HapticdError("the file was removed")

    daemon = Daemon(load)
    scene = {"objects": {f"wall {place}": FLOOR for place in range(500)}}
    monkeypatch.setattr(dispatching, "CHANGE_SLICE_NS", 0)
    long = daemon.send("set_scene", {"scene": scene})
    for _ in range(40):
        daemon.dispatch.ask_reload()
        daemon.dispatch.queue_reload()
    assert daemon.woken.is_set() and not loads
    while notified != ["reloading"]:
        daemon.dispatch.continue_change()
    assert "result" in daemon.answers[long]
    assert daemon.ask("get_status")["revision"] == 2
    asked = daemon.send("update_scene", {"objects": {}})
    daemon.dispatch.continue_change()
    assert asked not in daemon.answers
    read.set()
    daemon.go_on()
    assert notified == ["reloading", "ready"] and "result" in daemon.answers[asked] and loads == [1]


def test_large_bodies_are_answered_whatever_they_are(daemon: Daemon) -> None:
    long = "x" * 70_000
    assert daemon.code(daemon.send("no such", {"long": long})) == messages.Code.NO_SUCH_METHOD
    assert daemon.code(daemon.send("get_status", {"long": long})) == messages.Code.INVALID_PARAMS
    assert daemon.code(daemon.send("set_scene", {"scene": {long: 1}})) == messages.Code.INVALID_PARAMS
    daemon.dispatch.take(b"\xc1" * len(long), daemon._reply)
    assert daemon.answers[None]["error"]["code"] == messages.Code.PARSE
    body = codec.encode({"jsonrpc": "1.0", "id": "old", "method": "set_scene", "params": {"scene": long}})
    daemon.dispatch.take(body, daemon._reply)
    assert daemon.answers["old"]["error"]["code"] == messages.Code.INVALID_REQUEST


def patched(count: int, **keys: object) -> dict[str, object]:
    patches = [
        {"from_m": 0.001 * place, "to_m": 0.001 * place + 0.0005, "material": "steel" if place % 2 else "glass"}
        for place in range(count)
    ]
    return FLOOR | {"patches": patches} | keys


def test_a_wall_that_moves_keeps_the_pieces_of_its_patches(daemon: Daemon) -> None:
    daemon.engine.take(daemon.engine.scene, load_config({}).materials)
    daemon.methods.call("set_scene", {"scene": {"objects": {"one": patched(50), "other": patched(30)}}})
    rows = daemon.engine._compiler._walls.records.copy()
    objects = daemon.engine.scene.objects
    result = daemon.methods.call("update_scene", {"objects": {"one": {"point_m": [0, -0.001]}}})
    assert len(result["warnings"]) == 99  # type: ignore[arg-type]
    moved = daemon.engine.scene.objects["one"]
    assert moved.patches == objects["one"].patches and moved.point_m == (0, -0.001)  # type: ignore[union-attr]
    assert (daemon.engine._compiler._walls.records == rows).all()
    # The same patches sent again, another ramp, and no patches at all.
    daemon.methods.call("update_scene", {"objects": {"one": patched(50)}})
    assert (daemon.engine._compiler._walls.records == rows).all()
    daemon.methods.call("update_scene", {"objects": {"one": {"patch_ramp_m": 1e-4}}})
    assert len(daemon.engine._compiler._walls.records) == len(rows)
    assert not (daemon.engine._compiler._walls.records == rows).all()
    daemon.methods.call("update_scene", {"objects": {"one": {"patches": None}}})
    assert len(daemon.engine._compiler._walls.records) == 61
    fresh = Engine(daemon.engine.config)
    fresh.take(daemon.engine.scene, daemon.engine.materials)
    assert (fresh._compiler._walls.records == daemon.engine._compiler._walls.records).all()


def test_the_first_sample_is_waited_for(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    states: list[dict[str, object] | None] = [None, None, {"tick": 0}]
    daemon.methods._read_state = lambda: states.pop(0)
    assert daemon.ask("get_state") == {"tick": 0} and not states
    monkeypatch.setattr(methods_module, "FIRST_STATE_TIMEOUT_S", 0.0)
    daemon.methods._read_state = lambda: None
    assert daemon.code(daemon.send("get_state")) == messages.Code.WAIT_TIMED_OUT


class Beating:
    """An engine with the two methods that `serve` calls."""

    def __init__(self) -> None:
        self.begun = threading.Event()

    def beat(self) -> None:
        self.begun.set()

    def poll_servo(self) -> None:
        """Do nothing."""


def test_it_ends_without_a_request_or_a_beat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dispatching, "BEAT_INTERVAL_S", 3600.0)
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    listening.bind(str(tmp_path / "s"))
    listening.listen()
    router = Router(listening)
    engine, stop = Beating(), threading.Event()
    # No request comes, so no methods are needed.
    arguments = (router, cast(Engine, engine), Dispatch(cast(Methods, None)), stop)
    thread = threading.Thread(target=dispatching.serve, args=arguments, daemon=True)
    thread.start()
    assert engine.begun.wait(60)
    stop.set()
    router.wake()
    thread.join(60)
    assert not thread.is_alive()
    # Waking a router that no thread serves does not prevent its end.
    router.wake()
    router.close()
