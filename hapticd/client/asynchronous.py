"""The client for asyncio: `async with hapticd.aio.connect() as daemon: ...`.

The methods are those of `hapticd.client.Client`, awaited; several calls may be under way at once. What is
said over the sockets stands in `calls.py`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from collections.abc import AsyncIterator, Callable, Generator, Iterable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, Self, TypeAlias, TypeVar, cast

import zmq
import zmq.asyncio

from hapticd.base import arguments
from hapticd.base.errors import HapticdError
from hapticd.protocol import calls
from hapticd.protocol.calls import (
    TIMEOUT_S,
    DaemonNotRunning,
    Feed,
    Interpolation,
    KeySource,
    PatchSource,
    Place,
    RemoteError,
    SceneSource,
    TelemetryLoss,
    TimedOut,
    Topic,
    WaypointsSource,
)
from hapticd.protocol.remote import Remote
from hapticd.protocol.results import (
    ConfigResult,
    Event,
    FlightResult,
    ForcesResult,
    GestureEnd,
    LeaseResult,
    MaterialsResult,
    OperatorResult,
    PlayResult,
    RevisionResult,
    SceneResult,
    State,
    Status,
    TickResult,
)

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json
    from hapticd.client.background import Recorder
    from hapticd.client.samples import SampleBatch

__all__ = ["Client", "Connecting", "DaemonNotRunning", "RemoteError", "Subscription", "TelemetryLoss", "connect"]

T = TypeVar("T")
Answer: TypeAlias = object | RemoteError | DaemonNotRunning


def connect(
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout_s: float = TIMEOUT_S,
    *,
    wait_s: float = 0.0,
    key: KeySource = None,
    server_key: str | os.PathLike[str] | None = None,
) -> Connecting:
    """A client of the daemon at `runtime_dir` (by default where the environment says):
    `async with connect() as daemon`, or `daemon = await connect()`, which is to be closed.

    `timeout_s` is how long each call waits for its answer. `wait_s` is how long to wait for a daemon that is not ready
    yet. Raises DaemonNotRunning where nobody listens.

    `tcp://HOST:PORT` in its place is a bridge on another machine; then `key` is the file of our secret key, and
    `server_key` the bridge's public key, or a file with it. A bridge that refuses the key raises KeyRefused.

    What is not given is taken from the environment: HAPTICD_CONNECT, the address of a bridge, or else
    HAPTICD_RUNTIME_DIR; HAPTICD_KEY and HAPTICD_SERVER_KEY.
    """
    timeout_s, wait_s = arguments.seconds("timeout_s", timeout_s), arguments.seconds("wait_s", wait_s, zero=True)
    return Connecting(lambda: calls.place_of(runtime_dir, key, server_key), timeout_s, wait_s)


class Connecting:
    """A client that is still to be connected: await it, or enter it."""

    def __init__(self, find: Callable[[], Place], timeout_s: float, wait_s: float) -> None:
        self._find, self._timeout_s, self._wait_s = find, timeout_s, wait_s
        self._client: Client | None = None

    def __await__(self) -> Generator[Any, None, Client]:
        return self._connect().__await__()

    async def __aenter__(self) -> Client:
        self._client = await self._connect()
        return self._client

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._client is not None:
            await self._client.close()

    async def _connect(self) -> Client:
        place = self._find()
        try:
            if self._wait_s > 0:
                await _await_ready(place, self._wait_s)
                # A runtime directory that was made meanwhile is looked at again.
                place = self._find()
            await asyncio.to_thread(calls.probe, place, self._timeout_s)
        except DaemonNotRunning as error:
            raise calls.waited(error, self._wait_s) from None
        return Client(place, self._timeout_s)


async def _await_ready(place: Place, wait_s: float) -> None:
    given_up = threading.Event()
    try:
        await asyncio.to_thread(calls.await_ready, place, wait_s, given_up.is_set)
    finally:
        given_up.set()


class Client:
    """The daemon's methods, by their names in the protocol; each returns the protocol's result as a
    dictionary.

    Belongs to the event loop that was running when it was made. Every method raises RemoteError where the
    daemon refuses, and DaemonNotRunning where it does not answer within `timeout_s`.
    """

    def __init__(self, place: Place, timeout_s: float = TIMEOUT_S) -> None:
        self.paths: Place = place
        self.timeout_s = timeout_s
        self._last_id = 0
        self._waiting: dict[int, asyncio.Future[Answer]] = {}
        self._subscriptions: list[Subscription[object]] = []
        self._opening = asyncio.Lock()
        self._closed = False
        self._operator_tick: int | None = None
        # Opened when it is first used: who may only watch has none.
        self._socket: zmq.asyncio.Socket | None = None
        self._reader: asyncio.Task[None] | None = None

    async def _opened(self) -> zmq.asyncio.Socket:
        async with self._opening:
            if self._socket is None:
                if isinstance(self.paths, Remote):
                    await asyncio.to_thread(calls.probe, self.paths, self.timeout_s, True)
                self._socket = self._open()
                self._reader = asyncio.create_task(self._read(self._socket), name="hapticd-answers")
            return self._socket

    def _open(self) -> zmq.asyncio.Socket:
        socket = zmq.asyncio.Context.instance().socket(zmq.DEALER)
        socket.setsockopt(zmq.LINGER, 0)
        # Nothing waits in a queue for a daemon that is not there: what was told to a dead one must not
        # reach the next.
        socket.setsockopt(zmq.IMMEDIATE, 1)
        if isinstance(self.paths, Remote):
            self.paths.secure(socket)
        socket.connect(self.paths.command_endpoint)
        return socket

    async def _read(self, socket: zmq.asyncio.Socket) -> None:
        try:
            while True:
                id, result = calls.answer(await socket.recv())
                # An error without an id says that some message was no call; ours are, so that it belongs to
                # none.
                future = self._waiting.pop(id, None) if isinstance(id, int) else None
                if future is not None and not future.done():
                    future.set_result(result)
        except HapticdError as error:
            for future in self._waiting.values():
                if not future.done():
                    future.set_exception(error)

    async def close(self) -> None:
        """Closes the client and its subscriptions; it may be closed twice."""
        self._closed = True
        if self._reader is not None:
            self._reader.cancel()
            await asyncio.gather(self._reader, return_exceptions=True)
        if self._socket is not None:
            self._socket.close()
        for future in self._waiting.values():
            future.cancel()
        for subscription in self._subscriptions:
            subscription.close()
        self._subscriptions.clear()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def call(self, method: str, params: Mapping[str, object] | None = None) -> object:
        """Calls any method of the protocol by its name; returns its result."""
        if self._closed:
            raise HapticdError("the client is closed")
        self._last_id += 1
        id = self._last_id
        body = calls.question(id, method, params)
        socket = await self._opened()
        future: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._waiting[id] = future
        try:
            async with asyncio.timeout(self.timeout_s):
                await socket.send(body)
                result = await future
        except TimeoutError:
            raise await asyncio.to_thread(calls.unanswered, self.paths, self.timeout_s) from None
        finally:
            self._waiting.pop(id, None)
        return calls.outcome(result, params, self.paths)

    # ---- methods -------------------------------------------------------------------------------------------

    async def get_status(self, detail: bool = False) -> Status:
        """Version, device, rate, real-time rights, revision, tick, forces, faults and counters; `detail`: histograms,
        too."""
        return cast(Status, await self.call("get_status", {"detail": True} if detail else {}))

    async def get_state(self) -> State:
        """The newest sample, as `states` yields it."""
        return cast(State, await self.call("get_state"))

    async def state(self) -> State:
        """The newest sample: `get_state` by its short name."""
        return await self.get_state()

    async def get_config(self) -> ConfigResult:
        """The configuration's servo and device."""
        return cast(ConfigResult, await self.call("get_config"))

    async def get_scene(self) -> SceneResult:
        """The scene and its revision."""
        return cast(SceneResult, await self.call("get_scene"))

    async def set_scene(
        self, scene: SceneSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Replaces the scene, all or nothing.

        `scene` is a mapping, the path of a YAML file that holds a scene, or a `hapticd.Scene`. With
        `expect_revision` the daemon refuses (-32001) if the scene has another revision; with `wait` the
        result has the first `tick` rendered with it.
        """
        params = calls.change_params("scene", calls.scene_tree(scene), expect_revision, wait)
        return cast(RevisionResult, await self.call("set_scene", params))

    async def update_scene(
        self, objects: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Changes objects by id: a JSON Merge Patch (RFC 7396) over the scene's `objects`; None removes."""
        patch = calls.patch_tree(objects, "scene", "objects")
        params = calls.change_params("objects", patch, expect_revision, wait)
        return cast(RevisionResult, await self.call("update_scene", params))

    async def get_materials(self) -> MaterialsResult:
        """All materials by name, the shipped ones among them."""
        return cast(MaterialsResult, await self.call("get_materials"))

    async def set_materials(
        self, materials: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Adds materials by name, and replaces those of the same name whole; others stay. A mapping or the path of a
        YAML file."""
        tree = calls.patch_tree(materials, "materials")
        params = calls.change_params("materials", tree, expect_revision, wait)
        return cast(RevisionResult, await self.call("set_materials", params))

    async def update_materials(
        self, materials: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Changes materials by name: a JSON Merge Patch, as a mapping or the path of a YAML file."""
        patch = calls.patch_tree(materials, "materials")
        params = calls.change_params("materials", patch, expect_revision, wait)
        return cast(RevisionResult, await self.call("update_materials", params))

    async def apply(
        self,
        *,
        materials: PatchSource | None = None,
        scene: SceneSource | None = None,
        expect_revision: int | None = None,
        wait: bool = False,
    ) -> RevisionResult:
        """Materials as `set_materials` and the scene as `set_scene`, or one of them: one change at one tick, all or
        nothing."""
        params = calls.apply_params(materials, scene, expect_revision, wait)
        return cast(RevisionResult, await self.call("apply", params))

    async def play(
        self,
        material: str | None = None,
        *,
        mode: Mapping[str, float] | None = None,
        direction: Iterable[float] = (0.0, 1.0),
        amplitude_m_per_s2: float,
    ) -> PlayResult:
        """Strikes a mode, or a material's tap, along `direction` [x, y], whatever is touched."""
        params = calls.play_params(material, mode, direction, amplitude_m_per_s2)
        return cast(PlayResult, await self.call("play", params))

    async def reset(self, objects: Iterable[str] | None = None) -> TickResult:
        """Heals membranes and clears contact state, of the objects with these ids or of all."""
        return cast(TickResult, await self.call("reset", calls.reset_params(objects)))

    async def mark(self, text: str, data: Json = None) -> TickResult:
        """Leaves a mark in the event stream and in every recording; the result has its `tick`.

        `text` has up to 1000 characters, `data` is anything that JSON can hold, up to 8 KiB.
        """
        return cast(TickResult, await self.call("mark", {"text": text, "data": data}))

    async def set_forces(self, enabled: bool) -> ForcesResult:
        """Forces on or off; on clears a latched fault whose cause is gone, else is refused (-32003)."""
        return cast(ForcesResult, await self.call("set_forces", {"enabled": enabled}))

    async def set_operator(
        self,
        waypoints: WaypointsSource | None = None,
        *,
        interpolation: Interpolation | None = None,
        gesture: Mapping[str, object] | None = None,
    ) -> OperatorResult:
        """What the simulated joystick's hand does: waypoints [[t_s, x_m, y_m], ...], a gesture, or the path of a file
        (YAML, JSON, CSV) that holds either."""
        params = calls.operator_params(waypoints, interpolation, gesture)
        result = cast(OperatorResult, await self.call("set_operator", params))
        self._operator_tick = result["tick"]
        return result

    async def wait_gesture(self, timeout_s: float | None = None) -> GestureEnd:
        """Waits until the hand has done what this client told it last by `set_operator`; returns the event
        `gesture_end`, at once where it is over already.

        Where another operator took its place before the end, by whomever, the event has `completed` false. Raises
        TimedOut after `timeout_s` (None: however long it takes), and DaemonNotRunning for a daemon that goes away.
        """
        started_tick = self._operator_tick
        if started_tick is None:
            raise HapticdError("wait_gesture: this client has called no set_operator yet")
        if timeout_s is not None:
            arguments.seconds("timeout_s", timeout_s, zero=True)
        try:
            async with asyncio.timeout(timeout_s):
                return await self._gesture_end(started_tick)
        except TimeoutError:
            raise TimedOut(f"wait_gesture: the hand was still under way after {timeout_s:g} s") from None

    async def _gesture_end(self, started_tick: int) -> GestureEnd:
        # Who listens first and then asks misses no end.
        async with self.telemetry("event", "status") as messages:
            end = calls.gesture_end(started_tick, "status", cast("dict[str, object]", await self.get_status()))
            while end is None:
                end = calls.gesture_end(started_tick, *await anext(messages))
            return end

    async def lease(self, duration_s: float, token: str | None = None) -> LeaseResult:
        """Takes a lease, or renews that with `token`; 0 ends it. Not renewed in time, forces fade out."""
        return cast(LeaseResult, await self.call("lease", calls.lease_params(duration_s, token)))

    async def reload(self, expect_revision: int | None = None, wait: bool = False) -> RevisionResult:
        """The daemon reads its configuration files anew: scene and materials, all or nothing."""
        return cast(RevisionResult, await self.call("reload", calls.reload_params(expect_revision, wait)))

    async def dump_flight(self) -> FlightResult:
        """Has the last seconds of telemetry written to a file on the daemon's machine; its name."""
        return cast(FlightResult, await self.call("dump_flight"))

    @contextlib.asynccontextmanager
    async def hold_lease(self, duration_s: float = 1.0) -> AsyncIterator[str]:
        """Holds a lease while the block runs, and gives its token.

        A task renews it three times within `duration_s`, as long as the event loop is not held up. Raises
        at the end of the block where the lease was lost meanwhile.
        Warns (ForcesOff) where a fault keeps the forces off until `set_forces(True)`.
        """
        token = calls.token_of(await self.lease(duration_s))
        lost: list[HapticdError] = []

        async def renew() -> None:
            try:
                while True:
                    await asyncio.sleep(duration_s / 3)
                    # A daemon that is away may come back in time; if not, its answer says that the lease
                    # lapsed.
                    with contextlib.suppress(DaemonNotRunning):
                        await self.lease(duration_s, token)
            except HapticdError as error:
                lost.append(error)

        task = asyncio.create_task(renew(), name="hapticd-lease")
        try:
            yield token
        except BaseException:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            with contextlib.suppress(HapticdError):  # what went wrong in the block is what is told
                await self.lease(0, token)
            raise
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        if lost:
            raise lost[0]
        await self.lease(0, token)

    @contextlib.asynccontextmanager
    async def record(
        self, path: str | os.PathLike[str], overwrite: bool = False, **notes: object
    ) -> AsyncIterator[Recorder]:
        """Records every tick and every event while the block runs, into `path`: .npz, .csv or .mcap.

        A thread records, so that the event loop may be held up. The rest is as for `hapticd.client.Client.record`.
        """
        from hapticd.client.background import Recorder
        from hapticd.client.blocking import Client as Blocking

        recorder = Recorder(lambda: Blocking.at(self.paths, self.timeout_s), path, overwrite, notes)
        try:
            await asyncio.to_thread(recorder.begin)
            yield recorder
        except BaseException:
            with contextlib.suppress(HapticdError):  # what went wrong in the block is what is told
                await asyncio.to_thread(recorder.end)
            raise
        await asyncio.to_thread(recorder.end)

    # ---- telemetry -----------------------------------------------------------------------------------------

    def samples(self, timeout_s: float | None = None, *, newest: bool = False) -> Subscription[SampleBatch]:
        """Every tick, in batches of 20 ms: numpy structured arrays that know what of them was lost (`lost`).

        Iteration raises DaemonNotRunning where nothing comes for `timeout_s` (by default the client's), and
        warns (TelemetryLoss) where reading is too slow.

        With `newest` each batch is the next one that the daemon sends once it is asked for; what it sent since the one
        before is left out, which is no loss to warn of, and counted in `lost`.
        """
        from hapticd.client.samples import SampleStream

        newest = arguments.flag("newest", newest)
        return self._subscribe(Feed(("samples",), SampleStream(warn=not newest).convert, newest), timeout_s)

    def states(self, timeout_s: float | None = None, *, newest: bool = False) -> Subscription[State]:
        """The newest sample as a dictionary, 60 times a second.

        With `newest` each one is the next that the daemon sends once it is asked for: who reads slowly never reads an
        old one.
        """
        return self._subscribe(Feed(("state",), calls.state_of, arguments.flag("newest", newest)), timeout_s)

    def events(self, timeout_s: float | None = None) -> Subscription[Event]:
        """Contacts, releases, punctures, faults and the other events."""
        return self._subscribe(Feed(("event",), calls.event_of), timeout_s)

    def statuses(self, timeout_s: float | None = None) -> Subscription[Status]:
        """The status, once a second."""
        return self._subscribe(Feed(("status",), calls.status_of), timeout_s)

    def telemetry(
        self, *topics: Topic, timeout_s: float | None = None
    ) -> Subscription[tuple[Topic, dict[str, object]]]:
        """Several topics on one socket, in the daemon's order: pairs of topic and message as it came."""
        return self._subscribe(Feed(topics, calls.message_of), timeout_s)

    def _subscribe(self, feed: Feed[T], timeout_s: float | None) -> Subscription[T]:
        if self._closed:
            raise HapticdError("the client is closed")
        timeout_s = self.timeout_s if timeout_s is None else arguments.seconds("timeout_s", timeout_s)
        subscription = Subscription(self.paths, feed, timeout_s)
        self._subscriptions = [other for other in self._subscriptions if not other.closed]
        self._subscriptions.append(cast("Subscription[object]", subscription))
        return subscription


class Subscription(Generic[T]):
    """An endless asynchronous iterator over telemetry, until `close` or the end of `async with`.

    It is in effect from the entry into `async with`, or else from the first item on.
    """

    def __init__(self, paths: Place, feed: Feed[T], timeout_s: float) -> None:
        self._paths = paths
        self._feed = feed
        self._timeout_s = self._patience_s = timeout_s
        self._first: list[T] = []
        self._ready = self._away = False
        self._socket = zmq.asyncio.Context.instance().socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        for topic in feed.subscriptions:
            self._socket.setsockopt(zmq.SUBSCRIBE, topic)
        if isinstance(paths, Remote):
            paths.secure(self._socket)
            self._socket.setsockopt(zmq.SUBSCRIBE, Feed.BRIDGE)
        self._socket.connect(paths.telemetry_endpoint)

    async def _receive(self) -> tuple[T, ...]:
        try:
            async with asyncio.timeout(self._patience_s):
                frames = await self._socket.recv_multipart()
        except TimeoutError:
            if self._away:
                raise calls.behind(self._paths) from None
            raise await asyncio.to_thread(calls.silent, self._paths, self._timeout_s) from None
        if not self._ready:
            self._look(frames)
        return self._feed.accept(frames)

    def _look(self, frames: list[bytes]) -> None:
        """The first message of a daemon shows that all is in effect; a bridge may say before that there is none."""
        self._away = not Feed.shows_daemon(frames)
        self._patience_s = min(self._timeout_s, calls.AWAY_S) if self._away else self._timeout_s
        if frames[0] != Feed.BRIDGE:
            self._ready = True
            if isinstance(self._paths, Remote):
                self._socket.setsockopt(zmq.UNSUBSCRIBE, Feed.BRIDGE)
            for topic in self._feed.surplus:
                self._socket.setsockopt(zmq.UNSUBSCRIBE, topic)

    async def _skip(self) -> None:
        """Of a subscription to the newest: what is left of the last time goes."""
        while await self._socket.poll(0):
            await self._socket.recv_multipart()

    @property
    def closed(self) -> bool:
        return self._socket.closed

    def close(self) -> None:
        """Ends the subscription; it may be closed twice."""
        self._socket.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        if self._first:
            return self._first.pop(0)
        if self._feed.each:
            return await self._newest()
        while not self._socket.closed:
            items = await self._receive()
            if items:
                return items[0]
        raise StopAsyncIteration

    async def _newest(self) -> T:
        while not self._ready:
            await self._receive()
        if not self._socket.closed:
            await self._skip()
            for topic in self._feed.each:
                self._socket.setsockopt(zmq.SUBSCRIBE, topic)
        try:
            while not self._socket.closed:
                items = await self._receive()
                if items:
                    return items[0]
        finally:
            if not self._socket.closed:
                for topic in self._feed.each:
                    self._socket.setsockopt(zmq.UNSUBSCRIBE, topic)
        raise StopAsyncIteration

    async def __aenter__(self) -> Self:
        while not self._ready:
            first = await self._receive()
            self._first += () if self._feed.each else first
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
