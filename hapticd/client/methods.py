"""The one client: the daemon's methods, subscriptions, leases and recordings, as coroutines.

`asynchronous.py` and `blocking.py` say how it sends and waits (the abstract methods of Client): with an event loop, or
on the caller's thread, where a coroutine runs to its end without a pause. asyncio is not imported here: blocking
programs start without it.
"""

from __future__ import annotations

import itertools
import math
import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any, Final, Generic, Self, TypeAlias, TypeVar, cast, get_args

import zmq

from hapticd.base import arguments
from hapticd.base.errors import HapticdError
from hapticd.client import streams
from hapticd.client.base import warn
from hapticd.client.sources import (
    Interpolation,
    PatchSource,
    SceneSource,
    WaypointsSource,
    operator_params,
    patch_tree,
    scene_tree,
)
from hapticd.protocol import calls, messages, places
from hapticd.protocol.calls import REPLY_TIMEOUT_S, DaemonNotRunning, ForcesOff, RemoteError, TimedOut, Topic
from hapticd.protocol.places import HEARTBEAT_TOPIC
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
from hapticd.system.paths import RuntimePaths

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json
    from hapticd.client.record import Daemon, Recorder
    from hapticd.client.samples import SampleBatch

T = TypeVar("T")
Stream: TypeAlias = streams.Stream[streams.AlreadySent]
Response: TypeAlias = object | RemoteError
Wait: TypeAlias = Callable[[float], Awaitable[bool]]
"""Waits for so many seconds, or until the work is to end: then true."""
READY_TOPIC: Final = b"state"


class Client(ABC):
    """What the clients have in common: all but how they send and wait."""

    def __init__(self, place: RuntimePaths, timeout_s: float = REPLY_TIMEOUT_S) -> None:
        self.paths: RuntimePaths = place
        self.timeout_s = timeout_s
        self._closed = False
        self._ids = itertools.count(1)
        self._sender = streams.Sender(place, timeout_s)
        self._subscriptions: set[Subscription[Any]] = set()
        self._operator_tick: int | None = None
        """At which the last operator was set here."""

    @classmethod
    async def _connected(cls, runtime_dir: str | os.PathLike[str] | None, timeout_s: float, wait_s: float) -> Self:
        """A client of a daemon that listens, at the latest after `wait_s`. Raises DaemonNotRunning."""
        place = places.place_of(runtime_dir)
        given_up = threading.Event()
        try:
            if wait_s > 0:
                await cls._in_thread(places.await_ready, place, wait_s, given_up.is_set)
                # The runtime directory may have been made meanwhile.
                place = places.place_of(runtime_dir)
            await cls._in_thread(places.probe, place)
        except DaemonNotRunning as error:
            raise places.after_waiting(error, wait_s) from None
        finally:
            given_up.set()
        return cls(place, timeout_s)

    # ---- How it sends and waits --------------------------------------------------------------------------------------

    @abstractmethod
    async def _exchange(self, id: int, body: bytes) -> Response:
        """Sends a call and returns its answer. Raises zmq.Again after `timeout_s`."""

    @abstractmethod
    async def _disconnect(self) -> None:
        """Closes the connection for calls."""

    @abstractmethod
    def _subscriber(self) -> zmq.Socket[Any]:
        """A SUB socket for `_receive`."""

    @abstractmethod
    async def _receive(self, socket: zmq.Socket[Any], timeout_s: float) -> list[bytes]:
        """The next message. Raises zmq.Again after `timeout_s`."""

    @staticmethod
    @abstractmethod
    async def _in_thread(work: Callable[..., T], /, *given: Any) -> T:
        """Calls what blocks."""

    @abstractmethod
    def _start(self, name: str, work: Callable[[Wait], Coroutine[Any, Any, None]]) -> Callable[[], Awaitable[None]]:
        """Starts background work; the function that is returned ends it, and raises what it raised."""

    @abstractmethod
    def _blocking(self) -> AbstractContextManager[Daemon]:
        """A blocking client of the same daemon, for another thread."""

    # ---- Calls -------------------------------------------------------------------------------------------------------

    def _refuse_closed(self) -> None:
        if self._closed:
            raise HapticdError("the client is closed")

    async def close(self) -> None:
        """Closes the client and its subscriptions; it may be closed twice."""
        self._closed = True
        await self._disconnect()
        self._sender.close()
        for subscription in list(self._subscriptions):
            subscription.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.close()

    async def call(self, method: str, params: Mapping[str, object] | None = None) -> object:
        """Calls any method of the protocol by its name; returns its result."""
        id = next(self._ids)
        body = calls.encode_request(id, method, params)
        try:
            response = await self._exchange(id, body)
        except zmq.Again:
            raise await self._in_thread(places.no_answer, self.paths, self.timeout_s) from None
        return calls.result_of(response, params)

    async def _change(
        self, method: str, params: dict[str, object], expect_revision: int | None, wait: bool
    ) -> RevisionResult:
        if expect_revision is not None:
            params["expect_revision"] = expect_revision
        if arguments.flag("wait", wait):
            params["wait"] = True
        return cast(RevisionResult, await self.call(method, params))

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
        return await self._change("set_scene", {"scene": scene_tree(scene)}, expect_revision, wait)

    async def update_scene(
        self, objects: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Changes objects by id: a JSON Merge Patch (RFC 7396) over the scene's `objects`; None removes."""
        params: dict[str, object] = {"objects": patch_tree(objects, "scene", "objects")}
        return await self._change("update_scene", params, expect_revision, wait)

    async def get_materials(self) -> MaterialsResult:
        """All materials by name, the shipped ones among them."""
        return cast(MaterialsResult, await self.call("get_materials"))

    async def set_materials(
        self, materials: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Adds materials by name, and replaces those of the same name whole; others stay. A mapping or the path of a
        YAML file."""
        params: dict[str, object] = {"materials": patch_tree(materials, "materials")}
        return await self._change("set_materials", params, expect_revision, wait)

    async def update_materials(
        self, materials: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Changes materials by name: a JSON Merge Patch, as a mapping or the path of a YAML file."""
        params: dict[str, object] = {"materials": patch_tree(materials, "materials")}
        return await self._change("update_materials", params, expect_revision, wait)

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
        params: dict[str, object] = {}
        if materials is not None:
            params["materials"] = patch_tree(materials, "materials")
        if scene is not None:
            params["scene"] = scene_tree(scene)
        return await self._change("apply", params, expect_revision, wait)

    async def play(
        self,
        material: str | None = None,
        *,
        mode: Mapping[str, float] | None = None,
        direction: Iterable[float] = (0.0, 1.0),
        amplitude_m_per_s2: float,
    ) -> PlayResult:
        """Strikes a mode, or a material's tap, along `direction` [x, y], whatever is touched."""
        params: dict[str, object] = {
            "direction": arguments.numbers("direction", direction),
            "amplitude_m_per_s2": amplitude_m_per_s2,
        }
        if material is not None:
            params["material"] = material
        if mode is not None:
            params["mode"] = arguments.mapping("mode", mode)
        return cast(PlayResult, await self.call("play", params))

    async def reset(self, objects: Iterable[str] | None = None) -> TickResult:
        """Heals membranes and clears contact state, of the objects with these ids or of all."""
        params = None if objects is None else {"objects": arguments.texts("objects", objects)}
        return cast(TickResult, await self.call("reset", params))

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
        params = operator_params(waypoints, interpolation, gesture)
        result = cast(OperatorResult, await self.call("set_operator", params))
        self._operator_tick = result["tick"]
        return result

    async def wait_gesture(self, timeout_s: float | None = None) -> GestureEnd:
        """Waits until the hand has done what this client last sent by `set_operator`; returns the event
        `gesture_end`, at once where it is over already.

        Where another operator took its place before the end, by whomever, the event has `completed` false. Raises
        TimedOut after `timeout_s` (None: however long it takes), and DaemonNotRunning for a daemon that goes away.
        """
        started_tick = self._operator_tick
        if started_tick is None:
            raise HapticdError("wait_gesture: this client has called no set_operator yet")
        within_s = math.inf if timeout_s is None else arguments.seconds("timeout_s", timeout_s, zero=True)
        deadline_s = time.monotonic() + within_s
        # Who listens first and then asks misses no end.
        async with self.telemetry("event", "status") as subscription:
            end = gesture_end(started_tick, "status", cast("dict[str, object]", await self.get_status()))
            while end is None:
                left_s = deadline_s - time.monotonic()
                message = await subscription.receive(max(0.0, min(left_s, self.timeout_s)))
                if message is not None:
                    end = gesture_end(started_tick, *message)
                elif left_s <= self.timeout_s:
                    raise TimedOut(f"wait_gesture: the hand was still under way after {timeout_s:g} s")
                else:
                    raise await self._in_thread(places.no_telemetry, self.paths, self.timeout_s)
        return end

    async def lease(self, duration_s: float, token: str | None = None) -> LeaseResult:
        """Takes a lease, or renews that with `token`; 0 ends it. Not renewed in time, forces fade out."""
        params = {"duration_s": duration_s} if token is None else {"duration_s": duration_s, "token": token}
        return cast(LeaseResult, await self.call("lease", params))

    async def reload(self, expect_revision: int | None = None, wait: bool = False) -> RevisionResult:
        """The daemon reads its configuration files again: scene and materials, all or nothing."""
        return await self._change("reload", {}, expect_revision, wait)

    async def dump_flight(self) -> FlightResult:
        """Has the last seconds of telemetry written to a file on the daemon's machine; its name."""
        return cast(FlightResult, await self.call("dump_flight"))

    # ---- While a block of code runs ----------------------------------------------------------------------------------

    @asynccontextmanager
    async def hold_lease(self, duration_s: float = 1.0) -> AsyncIterator[str]:
        """Holds a lease while the block runs, and gives its token.

        A thread renews it three times within `duration_s`, over a separate connection, and dies with the process: then
        the forces fade. In asyncio it is a task, and the forces fade, too, where the event loop is held up for longer.
        Raises at the end of the block where the lease was lost meanwhile. Warns (ForcesOff) where a fault keeps the
        forces off until `set_forces(True)`.
        """
        lease = await self.lease(duration_s)
        token = lease["token"]
        if token is None:
            raise HapticdError("duration_s: must be more than 0 to hold a lease")
        if "warning" in lease:
            warn(ForcesOff(lease["warning"]))

        async def renew(wait: Wait) -> None:
            async with type(self)(self.paths, duration_s / 3) as renewer:
                while not await wait(duration_s / 3):
                    # A daemon that is away may come back in time; if not, its answer says that the lease lapsed.
                    with suppress(DaemonNotRunning):
                        await renewer.lease(duration_s, token)

        end = self._start("hapticd-lease", renew)
        try:
            yield token
        except BaseException:
            # What went wrong in the block is reported.
            with suppress(Exception):
                await end()
            with suppress(Exception):
                await self.lease(0, token)
            raise
        await end()
        await self.lease(0, token)

    @asynccontextmanager
    async def record(
        self, /, path: str | os.PathLike[str], overwrite: bool = False, **notes: object
    ) -> AsyncIterator[Recorder]:
        """Records every tick and every event while the block runs, into `path`: .npz, or an export of it.

        A thread with a separate connection records. The first sample is taken before the block begins, and what the
        block did last is in the file. `notes` are kept in it as they are, whatever JSON can hold. Gives a Recorder,
        whose `result` is there after the block. Raises HapticdError before the block where `path` is there already
        (unless `overwrite`) or cannot be written, and at its end where the recording ended before. Warns
        (MissedPeriods) at its end where the servo missed too many periods.
        """
        from hapticd.client.record import Recorder

        recorder = Recorder(self._blocking, path, overwrite, notes)
        try:
            await self._in_thread(recorder.begin)
            yield recorder
        except BaseException:
            with suppress(HapticdError):  # what went wrong in the block is reported
                await self._in_thread(recorder.end)
            raise
        for warning in await self._in_thread(recorder.end):
            warn(warning)

    def stream(self) -> Stream:
        """Streams targets of the simulated hand, or forces, while the block runs: up to 1,000 a second of each.

        The servo goes from one to the next in a straight line. Without a message for the time-out (20 ms by default) a
        force fades to zero and the hand stays; the end of the block sends a force of zero. No message waits for an
        answer. The first one of each kind, and one in half a second, asks for one all the same: what the daemon refuses
        is raised (RemoteError) by a later message or at the end of the block, and forces that are off are warned of
        (ForcesOff).
        """
        self._refuse_closed()
        return Stream(self._sender, streams.AlreadySent())

    # ---- Telemetry ---------------------------------------------------------------------------------------------------

    def samples(self, timeout_s: float | None = None, *, newest: bool = False) -> Subscription[SampleBatch]:
        """Every tick, in batches of 20 ms: numpy structured arrays that know what of them was lost (`lost`).

        Begins when this returns, in asyncio with `async with` or the first item. Iteration raises DaemonNotRunning
        where nothing comes for `timeout_s` (by default the client's), and warns (TelemetryLoss) where reading is too
        slow.

        With `newest` each batch is the next one that the daemon sends once it is asked for; what it sent since the one
        before is left out, which is no loss to warn of, and counted in `lost`.
        """
        from hapticd.client.samples import SampleStream

        newest = arguments.flag("newest", newest)
        return Subscription(self, ("samples",), SampleStream(warn=not newest).convert, timeout_s, newest)

    def states(self, timeout_s: float | None = None, *, newest: bool = False) -> Subscription[State]:
        """The newest sample as a dictionary, 60 times a second.

        With `newest` each one is the next that the daemon sends once it is asked for: who reads slowly never reads an
        old one.
        """
        newest = arguments.flag("newest", newest)
        return Subscription(self, ("state",), lambda _, message: cast(State, message), timeout_s, newest)

    def events(self, timeout_s: float | None = None) -> Subscription[Event]:
        """Contacts, releases, punctures, faults and the other events."""
        return Subscription(self, ("event",), lambda _, message: cast("Event", message), timeout_s)

    def statuses(self, timeout_s: float | None = None) -> Subscription[Status]:
        """The status, once a second."""
        return Subscription(self, ("status",), lambda _, message: cast(Status, message), timeout_s)

    def telemetry(
        self, *topics: Topic, timeout_s: float | None = None
    ) -> Subscription[tuple[Topic, dict[str, object]]]:
        """Several topics on one socket, in the daemon's order: pairs of topic and message as it came."""
        return Subscription(self, topics, lambda topic, message: (topic, message), timeout_s)


class Subscription(Generic[T]):
    """An endless asynchronous iterator over telemetry, until `close` or the end of `async with`.

    It is in effect from the entry into `async with`, or else from the first item on.
    """

    def __init__(
        self,
        client: Client,
        topics: Sequence[Topic],
        convert: Callable[[Topic, dict[str, object]], T],
        timeout_s: float | None,
        newest: bool = False,
    ) -> None:
        """`newest`: each item is asked for when it is read, so that those before it are never sent."""
        if not topics:
            raise arguments.wrong("telemetry", f"needs a topic or several; known: {', '.join(get_args(Topic))}")
        for topic in topics:
            arguments.one_of("topic", topic, get_args(Topic))
        self._timeout_s = client.timeout_s if timeout_s is None else arguments.seconds("timeout_s", timeout_s)
        client._refuse_closed()
        self._client, self._convert = client, convert
        self._wanted = {topic.encode() for topic in topics}
        self._on_demand = self._wanted - {HEARTBEAT_TOPIC} if newest else set()
        """Subscribed to for each item, and unsubscribed from after it."""
        self._first: T | None = None
        """An item that came before it was asked for."""
        self._ready = False
        self._socket = client._subscriber()
        self._socket.setsockopt(zmq.LINGER, 0)
        # Subscriptions take effect in their order, and `state` comes 60 times a second: the first message of any topic
        # shows that all are in effect. `status` comes every second, so that silence means that the daemon is gone.
        try:
            self._set(zmq.SUBSCRIBE, (*sorted((self._wanted | {HEARTBEAT_TOPIC}) - {READY_TOPIC}), READY_TOPIC))
            self._socket.connect(client.paths.telemetry_endpoint)
        except BaseException:
            self._socket.close()
            raise
        client._subscriptions.add(self)

    def _set(self, option: int, topics: Iterable[bytes]) -> None:
        for topic in topics:
            self._socket.setsockopt(option, topic)

    @property
    def closed(self) -> bool:
        return self._socket.closed

    def close(self) -> None:
        """Ends the subscription; it may be closed twice."""
        self._socket.close()
        self._client._subscriptions.discard(self)

    async def _take(self, timeout_s: float) -> T | None:
        """What the next message yields: nothing where it was not asked for. Raises zmq.Again."""
        frames = await self._client._receive(self._socket, timeout_s)
        if not self._ready:
            self._ready = True
            self._set(zmq.UNSUBSCRIBE, ({READY_TOPIC} - self._wanted) | self._on_demand)
        if len(frames) != 2 or frames[0] not in self._wanted:
            return None
        topic, message = cast(Topic, frames[0].decode()), messages.decode_trusted(frames[1])
        if not isinstance(message, dict):
            raise messages.WireError(messages.Code.INVALID_REQUEST, f"telemetry {topic}: not a map")
        return self._convert(topic, message)

    async def _item(self, left_s: Callable[[], float]) -> T | None:
        """The next item; `left_s`: how long to wait for each message. None: it was closed. Raises zmq.Again."""
        item, self._first = self._first, None
        if item is not None:
            return item
        with suppress(zmq.Again):
            while self._on_demand:  # what came since the last item is dropped
                await self._client._receive(self._socket, 0.0)
        self._set(zmq.SUBSCRIBE, self._on_demand)
        try:
            while item is None and not self.closed:
                item = await self._take(left_s())
            return item
        finally:
            if not self.closed:
                self._set(zmq.UNSUBSCRIBE, self._on_demand)

    async def _silence(self) -> DaemonNotRunning:
        return await self._client._in_thread(places.no_telemetry, self._client.paths, self._timeout_s)

    async def receive(self, timeout_s: float) -> T | None:
        """The next item, or None where none comes within `timeout_s`, in seconds. 0: only what has come already.

        Raises InvalidError for a `timeout_s` that is negative or not finite. Unlike the iterator it raises nothing
        where the daemon is silent.
        """
        deadline_s = time.monotonic() + arguments.seconds("timeout_s", timeout_s, zero=True)
        with suppress(zmq.Again):
            return await self._item(lambda: max(0.0, deadline_s - time.monotonic()))
        return None

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        if self.closed:
            raise StopAsyncIteration
        await self.__aenter__()
        try:
            item = await self._item(lambda: self._timeout_s)
        except zmq.Again:
            raise await self._silence() from None
        if item is None:
            raise StopAsyncIteration
        return item

    async def __aenter__(self) -> Self:
        """Waits for the first message of a daemon."""
        if not self._ready:
            try:
                item = await self._take(self._timeout_s)
            except zmq.Again:
                raise await self._silence() from None
            self._first = None if self._on_demand else item
        return self

    async def __aexit__(self, *error: object) -> None:
        self.close()


def gesture_end(started_tick: int, topic: Topic, message: Mapping[str, object]) -> GestureEnd | None:
    """The end of the operator that this tick took, where a message of telemetry, or a status, tells of it.

    Raises HapticdError for a status of a daemon that knows nothing of such an operator.
    """
    if topic == "event":
        ours = message.get("event") == "gesture_end" and message.get("started_tick") == started_tick
        return cast(GestureEnd, message) if ours else None
    operator = cast(Status, message)["operator"]
    ends = [] if operator is None else operator["ends"]
    for end in ends:
        if end["started_tick"] == started_tick:
            return end
    last = None if operator is None else operator["started_tick"]
    forgotten = len(ends) == messages.MAX_GESTURE_ENDS and min(end["started_tick"] for end in ends) > started_tick
    if last is None or last < started_tick or forgotten:
        raise HapticdError(
            f"the daemon knows nothing of the operator that tick {started_tick} took: it was started anew since, or "
            f"{messages.MAX_GESTURE_ENDS} others ended"
        )
    return None
