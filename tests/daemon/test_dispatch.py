"""Long changes are taken in beside the thread that serves commands: in order, one at a time, as if it did it itself."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from hapticd.base import codec, lattice
from hapticd.base.core import ffi
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, load_config
from hapticd.config.scene import Scene
from hapticd.daemon import dispatch as dispatching
from hapticd.daemon.dispatch import Dispatch
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.protocol import messages
from hapticd.rendering.compiler import noise_filters

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
SANDED = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "sand"}


def models(count: int, seed: int = 1) -> list[dict[str, Any]]:
    """Autoregressive models that no other test has."""
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
    """The params of `apply` that take long."""
    return {"materials": {"sand": sand(seed=seed)}, "scene": {"objects": {"floor": SANDED}}}


SERVO = {"realtime": "off", "overruns": {"threshold": 1.0}}


class Daemon:
    """A daemon without sockets: what the thread that serves commands does, step by step."""

    def __init__(self, load: Callable[[], Config] | None = None) -> None:
        config = load_config({"device": {"kind": "sim"}, "servo": SERVO})
        self.engine = Engine(config)
        self.methods = Methods(self.engine, load)
        self.dispatch = Dispatch(self.methods)
        self.woken = threading.Event()
        self.methods.intake.wake = self.woken.set
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
        """The result of what is answered at once."""
        return self.answers[self.send(method, params)]["result"]

    def code(self, id: int) -> int:
        return int(self.answers[id]["error"]["code"])

    def over(self) -> None:
        """Waits until what is being taken in is done, and answers it."""
        assert self.woken.wait(60)
        self.woken.clear()
        self.dispatch.turn()


@pytest.fixture
def daemon() -> Iterator[Daemon]:
    made = Daemon()
    made.engine.start()
    yield made
    made.methods.end()
    made.methods.intake.join()
    made.engine.stop()


@pytest.fixture
def hold(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[threading.Event, threading.Event]]:
    """Filters are designed only once the second event is set; the first says that somebody waits for that."""
    begun, go_on = threading.Event(), threading.Event()
    design = noise_filters._new_design

    def held(texture: Any, output: Any, working: Callable[[], None]) -> Any:
        begun.set()
        while not go_on.wait(0.01):
            working()
        return design(texture, output, working)

    monkeypatch.setattr(noise_filters, "_new_design", held)
    # Nothing that another test designed is there yet.
    monkeypatch.setattr(noise_filters, "designs", noise_filters.Designs())
    yield begun, go_on
    go_on.set()


def test_others_are_answered_while_a_change_is_compiled(
    daemon: Daemon, hold: tuple[threading.Event, threading.Event]
) -> None:
    begun, go_on = hold
    before = daemon.ask("get_status")
    assert before["intake"] is None
    long = daemon.send("apply", taken())
    assert begun.wait(60)
    status = daemon.ask("get_status")
    assert status["intake"]["method"] == "apply"
    assert (status["intake"]["filters"], status["intake"]["filters_done"]) == (3, 0)
    assert status["revision"] == before["revision"] and daemon.ask("get_scene")["scene"]["objects"] == {}
    assert daemon.ask("set_forces", {"enabled": False})["forces"] == "off"
    assert daemon.ask("set_forces", {"enabled": True})["forces"] == "on"
    token = daemon.ask("lease", {"duration_s": 60})["token"]
    assert daemon.ask("lease", {"duration_s": 0, "token": token})["token"] is None
    assert daemon.ask("mark", {"text": "meanwhile"})["tick"] > 0
    assert daemon.ask("reset")["tick"] > 0
    assert long not in daemon.answers
    go_on.set()
    daemon.over()
    assert daemon.answers[long]["result"]["revision"] == before["revision"] + 1
    assert daemon.ask("get_status")["intake"] is None
    assert list(daemon.ask("get_scene")["scene"]["objects"]) == ["floor"]


def test_a_second_long_change_is_refused_and_brief_ones_wait_in_their_order(
    daemon: Daemon, hold: tuple[threading.Event, threading.Event]
) -> None:
    begun, go_on = hold
    revision = daemon.ask("get_status")["revision"]
    long = daemon.send("apply", taken())
    assert begun.wait(60)
    second = daemon.send("set_materials", {"materials": {"sand": sand(seed=2)}})
    assert daemon.code(second) == messages.Code.RING_FULL
    assert daemon.answers[second]["error"]["data"]["intake"]["method"] == "apply"
    large = {"objects": {f"wall {place}": FLOOR for place in range(2000)}}
    assert daemon.code(daemon.send("set_scene", {"scene": large})) == messages.Code.RING_FULL
    one = daemon.send("update_scene", {"objects": {"floor": {"point_m": [0, -0.001]}}})
    other = daemon.send("update_scene", {"objects": {"floor": {"point_m": [0, -0.002]}}, "wait": True})
    daemon.dispatch.turn()
    assert not {long, one, other} & daemon.answers.keys()
    go_on.set()
    daemon.over()
    assert [daemon.answers[id]["result"]["revision"] - revision for id in (long, one, other)] == [1, 2, 3]
    assert daemon.answers[other]["result"]["tick"] > 0
    assert daemon.ask("get_scene")["scene"]["objects"]["floor"]["point_m"] == [0, -0.002]


def test_a_brief_change_waits_no_longer_than_it_should(
    daemon: Daemon, hold: tuple[threading.Event, threading.Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = hold
    monkeypatch.setattr(dispatching, "WAIT_S", -1.0)
    long = daemon.send("apply", taken())
    assert begun.wait(60)
    late = daemon.send("update_scene", {"objects": {}})
    silent = daemon.send("update_scene", {"objects": {}}, notification=True)
    daemon.dispatch.turn()
    assert daemon.code(late) == messages.Code.RING_FULL and silent not in daemon.answers
    monkeypatch.setattr(dispatching, "WAIT_S", 60.0)
    waiting = [daemon.send("update_scene", {"objects": {}}) for _ in range(dispatching.MOST_WAITING)]
    assert daemon.code(daemon.send("update_scene", {"objects": {}})) == messages.Code.RING_FULL
    go_on.set()
    daemon.over()
    assert "result" in daemon.answers[long] and all("result" in daemon.answers[id] for id in waiting)


def test_spectra_of_waveforms_are_found_beside(daemon: Daemon) -> None:
    """A short message holds a hundred: 1.7 s, in which nobody would be answered."""
    waveform = {"rate_hz": 100.0, "samples": [0.0, 1.0, 0.0]}
    cushion = {"stiffness_n_per_m": 300.0, "tap": {"attack_slope_per_s": 1.0, "waveform": waveform}}
    for method, params in (
        ("update_materials", {"materials": {"cushion": cushion}}),
        ("update_materials", {"materials": {"cushion": {"tap": {"waveform": {"rate_hz": 200.0}}}}}),
        ("apply", {"materials": {"cushion": cushion}}),
        ("set_materials", {"materials": {f"m{place}": cushion for place in range(5)}}),
        ("set_scene", {"scene": {"objects": {f"o{n}": FLOOR | {"material": f"m{n}"} for n in range(5)}}}),
    ):
        asked = daemon.send(method, params)
        assert daemon.ask("get_status")["intake"]["method"] == method
        assert asked not in daemon.answers
        daemon.over()
        assert "result" in daemon.answers[asked]
    asked = daemon.send("update_materials", {"materials": {"m0": {"stiffness_n_per_m": 200.0}}})
    assert "result" in daemon.answers[asked]


def test_a_revision_is_expected_when_the_change_is_made(
    daemon: Daemon, hold: tuple[threading.Event, threading.Event]
) -> None:
    begun, go_on = hold
    revision = daemon.ask("get_status")["revision"]
    long = daemon.send("apply", taken() | {"expect_revision": revision})
    assert begun.wait(60)
    late = daemon.send("update_scene", {"objects": {"floor": None}, "expect_revision": revision})
    right = daemon.send("update_scene", {"objects": {"floor": None}, "expect_revision": revision + 1})
    # What the servo itself changes is a revision, too: it steps down to another rate.
    state = daemon.engine.state
    daemon.engine.state = state._replace(revision=revision + 5)
    go_on.set()
    daemon.over()
    assert [daemon.code(id) for id in (long, late, right)] == [messages.Code.STALE_REVISION] * 3
    assert daemon.answers[long]["error"]["data"] == {"revision": revision + 5}
    assert daemon.engine.state.scene is state.scene and daemon.engine.state.materials is state.materials


def test_a_refused_long_change_changes_nothing(daemon: Daemon) -> None:
    before = daemon.engine.state
    faulty = taken()
    faulty["scene"]["objects"]["floor"] = FLOOR | {"material": "no such"}
    long = daemon.send("apply", faulty)
    daemon.over()
    assert daemon.code(long) == messages.Code.INVALID_PARAMS
    assert daemon.engine.state is before


def test_the_end_overtakes_what_is_compiled(
    daemon: Daemon, hold: tuple[threading.Event, threading.Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, _ = hold
    before = daemon.engine.state
    long = daemon.send("apply", taken())
    assert begun.wait(60)
    daemon.methods.end()
    thread = daemon.methods.intake._thread
    assert thread is not None
    thread.join(60)
    assert not thread.is_alive()
    daemon.dispatch.turn()
    assert long not in daemon.answers and daemon.engine.state is before


def test_reloads_wait_for_each_other_and_become_one(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(dispatching.notify, "reloading", lambda: told.append("reloading"))
    monkeypatch.setattr(dispatching.notify, "ready", lambda: told.append("ready"))
    reading, read = threading.Event(), threading.Event()
    loads = []

    def load() -> Config:
        loads.append(1)
        reading.set()
        assert read.wait(60)
        raise HapticdError("the file is gone")

    daemon = Daemon(load)
    long = daemon.send("set_scene", {"scene": {"objects": {f"wall {place}": FLOOR for place in range(500)}}})
    for _ in range(40):
        daemon.dispatch.ask_reload()
    while long not in daemon.answers:
        daemon.over()
    assert reading.wait(60)
    assert daemon.ask("get_status")["intake"]["method"] == "reload"
    asked = daemon.send("reload")
    assert daemon.code(asked) == messages.Code.RING_FULL
    read.set()
    while told != ["reloading", "ready"]:
        daemon.over()
    assert len(loads) == 1


def test_beside_comes_out_as_it_does_inline(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    inline = Engine(daemon.engine.config)
    assert Methods(inline).call("apply", taken(seed=7))["revision"] == 2
    monkeypatch.setattr(noise_filters, "designs", noise_filters.Designs())
    daemon.send("apply", taken(seed=7))
    daemon.over()
    tables = [engine._compiler._table for engine in (inline, daemon.engine)]
    for array, count, kind in (
        ("numbers", "number_count", "double[]"),
        ("materials", "material_count", "struct hd_material[]"),
        ("objects", "object_count", "struct hd_object[]"),
        ("noises", "noise_count", "struct hd_noise[]"),
    ):
        size = ffi.sizeof(kind.removesuffix("[]"))
        one, other = (bytes(ffi.buffer(getattr(t, array), getattr(t, count) * size)) for t in tables)
        assert one == other and one, array


def test_a_scene_that_names_a_long_material_is_taken_in_beside(
    daemon: Daemon, hold: tuple[threading.Event, threading.Event]
) -> None:
    """A brief message may need many filters: nothing says so before its material is known."""
    begun, go_on = hold
    daemon.send("update_materials", {"materials": {"sand": sand(9)}})
    daemon.over()
    long = daemon.send("update_scene", {"objects": {"floor": SANDED}})
    assert begun.wait(60) and long not in daemon.answers
    assert daemon.ask("get_status")["intake"]["filters"] == 9
    go_on.set()
    daemon.over()
    assert "result" in daemon.answers[long]
    # Known by now, it is brief.
    assert "revision" in daemon.ask("update_scene", {"objects": {"floor": None}})
    assert "revision" in daemon.ask("update_scene", {"objects": {"floor": SANDED}})


def test_large_bodies_are_answered_whatever_they_are(daemon: Daemon) -> None:
    long = "x" * (dispatching.LARGE_BODY + 1)
    assert daemon.code(daemon.send("no such", {"long": long})) == messages.Code.NO_SUCH_METHOD
    assert daemon.code(daemon.send("get_status", {"long": long})) == messages.Code.INVALID_PARAMS
    unknown = daemon.send("set_scene", {"scene": {long: 1}})
    daemon.over()
    assert daemon.code(unknown) == messages.Code.INVALID_PARAMS
    daemon.dispatch.take(b"\xc1" * len(long), daemon._reply)
    assert daemon.answers[None]["error"]["code"] == messages.Code.PARSE
    body = codec.encode({"jsonrpc": "1.0", "id": "old", "method": "set_scene", "params": {"scene": long}})
    daemon.dispatch.take(body, daemon._reply)
    daemon.over()
    assert daemon.answers["old"]["error"]["code"] == messages.Code.INVALID_REQUEST


def test_designs_are_kept_within_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    designs = noise_filters.Designs()
    monkeypatch.setattr(noise_filters, "_KEPT", 10_000)
    config = load_config({"device": {"kind": "sim"}})
    output = Engine(config).output
    methods = Methods(Engine(config))
    methods.call("set_materials", {"materials": {f"sand {seed}": sand(1, seed) for seed in range(3)}})
    textures = [methods._engine.materials[f"sand {seed}"].texture for seed in range(3)]
    large = noise_filters.SILENCE._replace(nodes=np.zeros((1, 1, 500)))
    for texture in textures:
        designs.keep(texture, output, large)  # type: ignore[arg-type]
        designs.keep(texture, output, large)  # type: ignore[arg-type]
    assert [designs.find(texture, output) is large for texture in textures] == [False, True, True]  # type: ignore[arg-type]


def patched(count: int, **keys: object) -> dict[str, object]:
    patches = [
        {"from_m": 0.001 * place, "to_m": 0.001 * place + 0.0005, "material": "steel" if place % 2 else "glass"}
        for place in range(count)
    ]
    return FLOOR | {"patches": patches} | keys


@pytest.mark.parametrize("method", ["set_scene", "update_scene", "apply", "reload"])
def test_a_wall_of_many_patches_is_encoded_before_it_is_in_force(monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    """Who asks for the scene then would encode it, while others wait."""
    scene = {"objects": {"one": patched(2000)}}
    daemon = Daemon(lambda: load_config({"device": {"kind": "sim"}, "servo": SERVO, "scene": scene}))
    daemon.engine.set_materials(load_config({}).materials)
    encoded: list[bool] = []
    for name in ("update_objects", "replace"):  # by one of which every change comes
        take = getattr(Engine, name)

        def looked(self: Engine, given: Any, *rest: Any, take: Callable[..., int] = take) -> int:
            walls = given.objects if isinstance(given, Scene) else given
            encoded.append(walls["one"].patches.encoded is not None)
            return take(self, given, *rest)

        monkeypatch.setattr(Engine, name, looked)
    daemon.methods.call(method, {"update_scene": scene, "reload": {}}.get(method, {"scene": scene}))
    assert encoded == [True]


def test_a_tiny_change_of_a_wall_looks_at_none_of_its_patches(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    library = load_config({}).materials
    daemon.engine.set_materials(library)
    daemon.methods.call("set_scene", {"scene": {"objects": {"one": patched(50), "other": patched(30)}}})
    rows = daemon.engine._compiler._walls.records.copy()
    objects = daemon.engine.scene.objects

    def nobody(*_: object) -> None:
        raise AssertionError("looked at")

    with monkeypatch.context() as patch:
        patch.setattr(type(objects["one"]), "stretches", nobody)
        patch.setattr("hapticd.config.patches._apart", nobody)
        patch.setattr("hapticd.rendering.displayability._narrow", nobody)
        result = daemon.methods.call("update_scene", {"objects": {"one": {"point_m": [0, -0.001]}}})
        assert len(result["warnings"]) == 99  # type: ignore[arg-type]
        assert daemon.methods.status()["revision"] == result["revision"]
    moved = daemon.engine.scene.objects["one"]
    assert moved.patches is objects["one"].patches and moved.point_m == (0, -0.001)  # type: ignore[union-attr]
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
    fresh.replace(daemon.engine.scene, daemon.engine.materials)
    assert (fresh._compiler._walls.records == daemon.engine._compiler._walls.records).all()


def test_the_newest_sample_is_waited_for_by_nobody_else(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Future[dict[str, object]]] = []

    def ask() -> Future[dict[str, object]]:
        asked.append(Future())
        return asked[-1]

    daemon.methods._ask_state = ask
    first, second = daemon.send("get_state"), daemon.send("get_state")
    assert daemon.ask("set_forces", {"enabled": False})["forces"] == "off"
    assert not {first, second} & daemon.answers.keys()
    asked[1].set_result({"tick": 7})
    daemon.over()
    assert daemon.answers[second]["result"] == {"tick": 7} and first not in daemon.answers
    others = [daemon.send("get_state") for _ in range(dispatching.MOST_WAITING)]
    assert daemon.code(others[-1]) == messages.Code.RING_FULL and others[-2] not in daemon.answers
    now_ns = dispatching.monotonic_ns()
    monkeypatch.setattr(dispatching, "monotonic_ns", lambda: now_ns + int(2e9))
    daemon.dispatch.turn()
    assert {daemon.code(id) for id in (first, *others[:-1])} == {messages.Code.WAIT_TIMED_OUT}
    assert len(daemon.answers) == len(asked) + 1
