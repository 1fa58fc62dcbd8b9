"""Both clients: against a real daemon, and against one that misbehaves."""

from __future__ import annotations

import asyncio
import inspect
import os
import signal
import threading
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

import hapticd.aio
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.client import blocking as client_module
from hapticd.config.scene import Scene
from hapticd.protocol import calls
from hapticd.protocol.calls import DaemonNotRunning, RemoteError, TelemetryLoss
from hapticd.protocol.messages import Code, WireError
from hapticd.protocol.results import Status
from tests.support.daemon_process import Daemon, connect, running_daemon
from tests.support.fake_daemon import FakeDaemon, fake_daemon, result

FLOOR = {"kind": "wall", "point_m": [0.0, 0.0], "normal": [0.0, 1.0], "material": "wood"}
SCENE = {"objects": {"floor": FLOOR}}
DOWN = [[0.0, 0.0, 0.01], [0.1, 0.0, 0.01], [0.2, 0.0, -0.003], [0.3, 0.0, 0.01]]


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "quiet.yaml"
    config.write_text("servo: {rate_hz: 1000, realtime: off}\n")
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[FakeDaemon]:
    with fake_daemon(tmp_path, lambda request: [result(request, {"method": request["method"]})]) as daemon:
        yield daemon


# ---- a real daemon -------------------------------------------------------------------------------------------


def test_every_method(daemon: Daemon, tmp_path: Path) -> None:
    with connect(daemon.directory) as client:
        status = client.get_status()
        assert status["rate_hz"] == 1000 and status["device"] == "sim"
        revision = client.set_scene(SCENE)["revision"]
        found = client.get_scene()
        assert (found["scene"], found["revision"]) == (Scene.model_validate(SCENE).to_dict(), revision)
        assert found["margins"].keys() == {"floor"}
        changed = client.update_scene({"floor": {"material": "steel"}}, expect_revision=revision, wait=True)
        assert changed["revision"] == revision + 1 and changed["tick"] > 0
        assert client.update_materials({"mine": {"stiffness_n_per_m": 100}})["revision"] == revision + 2
        assert client.get_materials()["materials"]["mine"]["stiffness_n_per_m"] == 100
        assert client.play("wood", amplitude_m_per_s2=1)["tick"] > 0
        mode = {"frequency_hz": 100.0, "decay_time_s": 0.01}
        assert client.play(mode=mode, direction=np.array([1, 0]), amplitude_m_per_s2=np.float64(1))["tick"] > 0
        assert client.reset()["tick"] > 0
        assert client.reset(["floor"])["tick"] > 0
        assert client.set_forces(False)["forces"] == "off"
        assert client.set_forces(True)["forces"] == "on"
        assert client.set_operator(np.array(DOWN), interpolation="minimum_jerk")["duration_s"] == pytest.approx(0.3)
        gesture = {"kind": "tap", "object": "floor", "speed_m_per_s": 0.1}
        assert client.set_operator(gesture=gesture)["duration_s"] > 0
        token = client.lease(60.0)["token"]
        assert token is not None
        assert client.lease(60.0, token)["token"] == token
        assert client.lease(0, token)["token"] is None
        assert client.call("get_scene")["revision"] == revision + 2  # type: ignore[index]


def test_scenes_from_files_and_models(daemon: Daemon, tmp_path: Path) -> None:
    scene, update, materials = tmp_path / "scene.yaml", tmp_path / "update.yaml", tmp_path / "materials.yaml"
    scene.write_text("scene:\n  objects:\n    a: {kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}\n")
    update.write_text("scene:\n  objects:\n    a: null\n    b: {kind: viscous, damping_n_s_per_m: 1}\n")
    materials.write_text("materials:\n  felt: {stiffness_n_per_m: 90}\n")
    with connect(daemon.directory) as client:
        client.set_scene(scene)
        assert list(client.get_scene()["scene"]["objects"]) == ["a"]  # type: ignore[arg-type]
        client.update_scene(update)
        assert list(client.get_scene()["scene"]["objects"]) == ["b"]  # type: ignore[arg-type]
        client.update_materials(str(materials))
        assert "felt" in client.get_materials()["materials"]
        client.set_scene(Scene.model_validate(SCENE))
        assert list(client.get_scene()["scene"]["objects"]) == ["floor"]  # type: ignore[arg-type]
        before = client.get_scene()
        scene.write_text("objects:\n  a: {kind: wall, point_m: [0, 0], normal: [0, 0], material: wood}\n")
        with pytest.raises(InvalidError, match=r"scene\.yaml:2:\d+: objects\.a\.normal: must have a direction"):
            client.set_scene(scene)
        update.write_text("- 1\n")
        with pytest.raises(HapticdError, match=r"update\.yaml:1:\d+: must be a mapping of names to objects"):
            client.update_scene(update)
        materials.write_text("materials:\n  felt: null\nscene: {}\n")
        with pytest.raises(InvalidError, match=r"materials\.yaml: holds materials and a scene; use: hapticd apply "):
            client.update_materials(materials)
        materials.write_text("device: {}\nmaterials:\n  felt: null\n")
        with pytest.raises(InvalidError, match=r"materials\.yaml: holds a configuration; use: hapticd run -c "):
            client.update_materials(materials)
        update.write_text("scene:\n  objects: {b: null}\nmaterials: {}\n")
        with pytest.raises(InvalidError, match=r"update\.yaml: holds materials and a scene; use: hapticd apply "):
            client.update_scene(update)
        update.write_text("scene:\n  objects: {b: null}\n  display: {force: false}\n")
        with pytest.raises(InvalidError, match=r"update\.yaml:3:\d+: scene.display: unknown key; known: objects$"):
            client.update_scene(update)
        assert client.get_scene() == before
        assert "felt" in client.get_materials()["materials"]


def test_remote_errors_say_what_and_where(daemon: Daemon) -> None:
    with connect(daemon.directory) as client:
        client.set_scene(SCENE)
        with pytest.raises(RemoteError) as caught:
            client.update_scene({"floor": {"normal": [0, 0]}, "x": {"kind": "wall"}})
        assert caught.value.code == Code.INVALID_PARAMS
        assert {problem.where for problem in caught.value.problems} >= {"objects.floor.normal", "objects.x.point_m"}
        assert "objects.floor.normal: must have a direction" in str(caught.value)
        with pytest.raises(RemoteError, match="expect_revision: 0 is stale") as caught:
            client.set_scene(SCENE, expect_revision=0)
        assert caught.value.code == Code.STALE_REVISION
        with pytest.raises(RemoteError) as caught:
            client.call("get_stats")
        assert caught.value.code == Code.NO_SUCH_METHOD


def test_samples_are_structured_arrays_without_gaps(daemon: Daemon) -> None:
    with connect(daemon.directory) as client, client.samples() as batches:
        taken = [next(batches) for _ in range(20)]
    assert all(batch.dtype == SAMPLE_DTYPE for batch in taken)
    assert all(batch.lost == 0 for batch in taken)
    ticks = np.concatenate([batch["tick"] for batch in taken])
    assert (np.diff(ticks) == 1).all()
    assert [batch.first_tick for batch in taken] == [batch["tick"][0] for batch in taken]


def test_events_and_states(daemon: Daemon) -> None:
    with connect(daemon.directory) as client, client.events() as events, client.states() as states:
        client.set_scene(SCENE, wait=True)
        # What the hand did before may still be on its way here.
        begin = client.set_operator(DOWN)["tick"]
        contact = next(event for event in events if event["event"] == "contact" and event["tick"] > begin)
        assert contact["object"] == "floor"
        assert isinstance(contact["speed_m_per_s"], float) and contact["speed_m_per_s"] > 0.05
        release = next(event for event in events if event["event"] == "release")
        state = next(state for state in states if state["tick"] > release["tick"])  # type: ignore[operator]
        assert len(state["position_m"]) == 2 and state["touching"] == []
        assert next(client.statuses())["protocol"] == 1


def test_a_subscription_is_in_effect_when_it_is_made(daemon: Daemon) -> None:
    """What happens right after must arrive: a subscription that came too late would miss some of these."""
    with connect(daemon.directory) as client:
        for _ in range(10):
            with client.events() as events:
                revision = client.set_scene(SCENE)["revision"]
                # That of a change before it may still be on its way.
                wanted = (each["revision"] for each in events if each["event"] == "revision")
                assert next(each for each in wanted if each >= revision) == revision


def test_a_client_may_be_shared_by_threads(daemon: Daemon) -> None:
    failures: list[BaseException] = []
    with connect(daemon.directory) as client:

        def work(index: int) -> None:
            try:
                for _ in range(50):
                    client.update_scene({f"field{index}": {"kind": "viscous", "damping_n_s_per_m": index}})
                    assert client.get_status()["rate_hz"] == 1000
            except BaseException as error:
                failures.append(error)

        threads = [threading.Thread(target=work, args=(index,)) for index in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert not failures
        objects = client.get_scene()["scene"]["objects"]
        assert isinstance(objects, dict) and {f"field{index}" for index in range(4)} <= objects.keys()


@pytest.mark.slow
def test_a_held_lease_outlasts_its_duration_and_ends_with_the_block(daemon: Daemon) -> None:
    def passed_s(status: Status) -> float:
        """By the servo's clock."""
        return (status["counters"]["ticks"] + status["counters"]["skipped"]) / status["rate_hz"]

    # Renewed every second: whoever renews it may be held up for two.
    with connect(daemon.directory) as client, client.statuses() as statuses:
        with client.hold_lease(3.0):
            begin_s = passed_s(client.get_status())
            with pytest.raises(RemoteError) as caught:
                client.lease(1.0)
            assert caught.value.code == Code.LEASE_HELD
            status = next(status for status in statuses if passed_s(status) > begin_s + 4.0)
            assert status["lease_s"] is not None and status["forces"] == "on"
        assert client.get_status()["lease_s"] is None
        assert client.get_status()["forces"] == "on", "ending a lease is not losing it"


def test_a_lost_lease_is_told_at_the_end_of_the_block(daemon: Daemon) -> None:
    with connect(daemon.directory) as client:
        with pytest.raises(RemoteError) as caught, client.hold_lease(3.0) as token:
            client.lease(0, token)  # somebody who has the token ends it
            threads = [thread for thread in threading.enumerate() if thread.name == "hapticd-lease"]
            threads[0].join(60)
        assert caught.value.code == Code.LEASE_LAPSED
        with pytest.raises(ZeroDivisionError), client.hold_lease(60.0):
            raise ZeroDivisionError
        assert client.get_status()["lease_s"] is None


def test_asyncio_has_every_method_too(daemon: Daemon) -> None:
    async def main() -> None:
        async with hapticd.aio.connect(daemon.directory, 60.0) as client:
            revision = (await client.set_scene(SCENE))["revision"]
            answers = await asyncio.gather(*(client.get_status() for _ in range(20)), client.get_scene())
            found = answers[-1]
            assert (found["scene"], found["revision"]) == (Scene.model_validate(SCENE).to_dict(), revision)
            with pytest.raises(RemoteError, match="no such method"):
                await client.call("nonsense")
            async with client.events() as events, client.samples() as batches:
                assert (await client.play("wood", amplitude_m_per_s2=1.0))["tick"] > 0
                await client.reset()
                await client.set_forces(True)
                await client.update_scene({"floor": {"material": "steel"}}, wait=True)
                assert (await client.update_materials({"mine": {"stiffness_n_per_m": 1}}))["revision"] > revision
                assert "mine" in (await client.get_materials())["materials"]
                assert (await client.set_operator(DOWN))["duration_s"] == pytest.approx(0.3)
                async for event in events:
                    if event["event"] == "contact":
                        break
                taken = [await anext(batches) for _ in range(5)]
                assert (np.diff(np.concatenate([batch["tick"] for batch in taken])) == 1).all()
            assert len((await anext(client.states()))["position_m"]) == 2
            assert (await anext(client.statuses()))["protocol"] == 1
            async with client.hold_lease(60.0):
                with pytest.raises(RemoteError) as caught:
                    await client.lease(1.0)
                assert caught.value.code == Code.LEASE_HELD
            assert (await client.get_status())["lease_s"] is None

    asyncio.run(main())


def test_the_clients_have_the_same_methods_and_say_the_same_of_them() -> None:
    """Parameters, defaults, types and text."""

    def methods(kind: type) -> dict[str, Any]:
        return {n: m for n, m in inspect.getmembers(kind, inspect.isfunction) if not n.startswith("_")}

    def parameters(member: Any) -> list[tuple[str, object, object, object]]:
        return [(p.name, p.kind, p.default, p.annotation) for p in inspect.signature(member).parameters.values()]

    blocking, asynchronous = methods(client_module.Client), methods(hapticd.aio.Client)
    assert blocking.keys() == asynchronous.keys()
    for name, member in blocking.items():
        assert parameters(member) == parameters(asynchronous[name]), name
        assert inspect.getdoc(member) == inspect.getdoc(asynchronous[name]), name
        result = inspect.signature(asynchronous[name]).return_annotation
        result = result.replace("AsyncIterator", "Iterator")
        assert inspect.signature(member).return_annotation == result, name
    assert parameters(client_module.connect) == parameters(hapticd.aio.connect)
    same = "`runtime_dir` is by default"
    texts = [inspect.getdoc(each.connect) or "" for each in (client_module, hapticd.aio)]
    assert texts[0][texts[0].index(same) :] == texts[1][texts[1].index(same) :]


# ---- a daemon that misbehaves ----------------------------------------------------------------------------------


def unanswering(request: dict[str, Any]) -> list[bytes]:
    return []


def in_asyncio(work: Callable[[hapticd.aio.Client], Awaitable[object]], directory: Path, timeout_s: float) -> None:
    async def main() -> None:
        async with hapticd.aio.connect(directory, timeout_s) as client:
            await work(client)

    asyncio.run(main())


def test_no_daemon(tmp_path: Path) -> None:
    for directory in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(DaemonNotRunning, match=f"no daemon at {directory}; start one with: hapticd run"):
            connect(directory)
        with pytest.raises(DaemonNotRunning, match="start one with"):
            in_asyncio(lambda client: client.get_status(), directory, 60.0)


def test_a_socket_that_a_dead_daemon_left(fake: FakeDaemon, tmp_path: Path) -> None:
    (tmp_path / "stale").mkdir()
    os.link(fake.directory / "hapticd.command", tmp_path / "stale" / "hapticd.command")
    fake.close()
    with pytest.raises(DaemonNotRunning, match="start one with"):
        connect(tmp_path / "stale")


def test_somebody_who_does_not_answer(fake: FakeDaemon) -> None:
    fake.answer = unanswering
    with connect(fake.directory, timeout_s=0.1) as client:
        with pytest.raises(DaemonNotRunning, match=r"did not answer within 0\.1 s"):
            client.get_status()
        client.timeout_s = 60.0
        fake.answer = lambda request: [result(request, {"fine": True})]
        assert client.call("get_status") == {"fine": True}, "the client goes on"
    fake.answer = unanswering
    with pytest.raises(DaemonNotRunning, match=r"did not answer within 0\.1 s"):
        in_asyncio(lambda client: client.get_status(), fake.directory, 0.1)


def test_late_answers_are_not_taken_for_others(fake: FakeDaemon) -> None:
    waiting: list[dict[str, Any]] = []

    def late(request: dict[str, Any]) -> list[bytes]:
        stale = [result({"id": request["id"] - 1}, "stale"), result({"id": 999}, "foreign")]
        waiting.append(request)
        return [*stale, result(request, "mine")]

    fake.answer = late
    with connect(fake.directory) as client:
        assert [client.call("x") for _ in range(3)] == ["mine"] * 3

    async def ask(client: hapticd.aio.Client) -> None:
        assert await client.call("x") == "mine"

    in_asyncio(ask, fake.directory, 60.0)


def test_asyncio_takes_answers_in_any_order(fake: FakeDaemon) -> None:
    held: list[dict[str, Any]] = []

    def reversed_pairs(request: dict[str, Any]) -> list[bytes]:
        held.append(request)
        if len(held) < 10:
            return []
        return [result(each, each["params"]["n"]) for each in reversed(held)]

    fake.answer = reversed_pairs

    async def ask(client: hapticd.aio.Client) -> None:
        assert await asyncio.gather(*(client.call("x", {"n": n}) for n in range(10))) == list(range(10))

    in_asyncio(ask, fake.directory, 60.0)


@pytest.mark.parametrize(
    "body", [b"", b"\xc1", msgpack.packb([1]), msgpack.packb({"id": 1, "error": "x"}), b"\x91" * 2000]
)
def test_answers_that_are_none(fake: FakeDaemon, body: bytes) -> None:
    fake.answer = lambda request: [body]
    with connect(fake.directory) as client, pytest.raises(WireError):
        client.get_status()
    with pytest.raises(WireError):
        in_asyncio(lambda client: client.get_status(), fake.directory, 60.0)


def test_an_interrupted_call_does_not_confuse_the_next(fake: FakeDaemon) -> None:
    with connect(fake.directory) as client:
        main_thread = threading.get_ident()

        def interrupting(request: dict[str, Any]) -> list[bytes]:
            if request["method"] == "slow":
                signal.pthread_kill(main_thread, signal.SIGINT)
            return []

        fake.answer = interrupting
        with pytest.raises(KeyboardInterrupt):
            client.call("slow")
        late = fake.requests[-1]
        fake.answer = lambda request: [result(late, "late"), result(request, "mine")]
        assert client.call("next") == "mine"


def test_what_was_told_to_a_dead_daemon_never_reaches_the_next(tmp_path: Path) -> None:
    with fake_daemon(tmp_path, lambda request: [result(request, None)]) as first:
        client = connect(tmp_path)
        client.call("before")
        first.close()
    # It is impatient only now that it has a connection, which may have taken its time.
    socket = client._client._socket
    assert socket is not None
    socket.SNDTIMEO = socket.RCVTIMEO = 200
    with pytest.raises(DaemonNotRunning, match="start one with"):
        client.call("meanwhile")
    with fake_daemon(tmp_path, lambda request: [result(request, "here")]) as second:
        client.timeout_s = 60.0
        with pytest.raises(DaemonNotRunning):
            connect(tmp_path / "nowhere")
        assert client.call("after") == "here"
        assert [request["method"] for request in second.requests] == ["after"]
    client.close()


def test_messages_that_are_too_large_are_refused_here(fake: FakeDaemon) -> None:
    with connect(fake.directory) as client:
        with pytest.raises(HapticdError, match=r"set_scene: message too long: must be at most 2097152 bytes, is \d+"):
            client.set_scene({"objects": {"x": "y" * 3_000_000}})
        with pytest.raises(
            HapticdError, match=r"^scene\.objects: must be a JSON value, is a Python object of type function$"
        ):
            client.set_scene({"objects": unanswering})
        assert fake.requests == []


def test_a_closed_client_says_so(fake: FakeDaemon) -> None:
    client = connect(fake.directory)
    events = client.events()
    client.close()
    client.close()
    assert events.closed
    assert next(events, None) is None
    with pytest.raises(HapticdError, match="the client is closed"):
        client.get_status()


def test_loss_is_told(fake: FakeDaemon) -> None:
    description = [list(field) for field in np.lib.format.dtype_to_descr(SAMPLE_DTYPE)]

    def send(first: int, count: int, dropped: int) -> None:
        samples = np.zeros(count, SAMPLE_DTYPE)
        samples["tick"] = np.arange(first, first + count)
        fake.publish(
            "samples", {"first_tick": first, "dropped": dropped, "dtype": description, "data": samples.tobytes()}
        )

    with connect(fake.directory) as client, client.samples() as batches:
        send(0, 10, 0)
        assert next(batches).lost == 0
        send(15, 10, 5)
        assert next(batches).lost == 0, "the ring dropped these"
        send(28, 10, 5)
        with pytest.warns(TelemetryLoss, match="3 samples before tick 28"):
            assert next(batches).lost == 3


def test_silent_telemetry_is_a_lost_daemon(fake: FakeDaemon) -> None:
    with connect(fake.directory) as client:
        with client.samples() as batches:
            fake.silent.set()
            client.call("quiet")  # what it was about to publish is out by its answer
            batches._subscription._timeout_s = 0.1  # only now: that it begins may take longer
            with pytest.raises(DaemonNotRunning, match=r"no telemetry from .* for 0\.1 s"):
                next(batches)
        with pytest.raises(DaemonNotRunning, match="no telemetry"):
            client.events(timeout_s=0.1)

        async def listen(client: hapticd.aio.Client) -> None:
            await anext(client.events(timeout_s=0.1))

        with pytest.raises(DaemonNotRunning, match="no telemetry"):
            in_asyncio(listen, fake.directory, 60.0)
        fake.close()
        with pytest.raises(DaemonNotRunning, match="start one with"):
            client.states(timeout_s=0.1)


def test_telemetry_that_is_none(fake: FakeDaemon) -> None:
    with connect(fake.directory) as client, client.events() as events:
        fake.publish("event", [1])
        with pytest.raises(WireError, match="telemetry event: not a map"):
            next(events)


def test_receive_waits_no_longer_than_it_is_told(fake: FakeDaemon) -> None:
    with connect(fake.directory) as client, client.events() as events:
        assert events.receive(0.0) is None
        fake.publish("event", {"event": "x"})
        assert events.receive(30.0) == {"event": "x"}


def test_asyncio_s_timeout_loses_nothing_that_comes_after_it(fake: FakeDaemon) -> None:
    async def listen(client: hapticd.aio.Client) -> None:
        async with client.events() as events:
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.0):
                    await anext(events)
            for name in ("x", "y"):
                fake.publish("event", {"event": name})
                async with asyncio.timeout(30.0):
                    assert await anext(events) == {"event": name}

    in_asyncio(listen, fake.directory, 60.0)


def test_a_lease_needs_a_duration(fake: FakeDaemon) -> None:
    fake.answer = lambda request: [result(request, {"token": None})]
    with connect(fake.directory) as client, pytest.raises(HapticdError, match="duration_s"), client.hold_lease(0):
        pass


def test_a_lease_that_keeps_no_forces_on_warns(fake: FakeDaemon) -> None:
    off = "forces are off because a lease lapsed"
    fake.answer = lambda request: [result(request, {"token": "t", "warning": off})]

    async def held() -> None:
        async with hapticd.aio.connect(fake.directory) as client, client.hold_lease(60.0):
            pass

    with connect(fake.directory) as client, pytest.warns(hapticd.ForcesOff, match=off) as told:
        with client.hold_lease(60.0):
            pass
        asyncio.run(held())
    assert [each.filename for each in told] == [__file__, __file__]


def test_the_blocking_client_may_be_used_while_an_event_loop_runs(fake: FakeDaemon) -> None:
    """As in the cell of a notebook."""
    fake.answer = lambda request: [result(request, {"token": "t"})]

    async def cell() -> None:
        with connect(fake.directory) as client, client.hold_lease(60.0) as token:
            assert token == "t" and client.lease(60.0, token) == {"token": "t"}

    asyncio.run(cell())


@pytest.mark.long
def test_a_blocking_call_that_would_pause_is_a_defect() -> None:
    with pytest.raises(RuntimeError, match="has paused"):
        client_module.run(asyncio.sleep(0))


@pytest.mark.long
def test_problems_of_an_error() -> None:
    assert str(RemoteError(-32602, "m", [{"where": "a.b", "problem": "is wrong"}, {"where": "", "problem": "x"}])) == (
        "a.b: is wrong; x"
    )
    assert str(RemoteError(-32602, "m", ["other"])) == "m"
    assert calls.RemoteError(-1, "m").problems == ()
