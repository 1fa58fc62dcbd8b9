"""The client: methods of the daemon, subscriptions, leases and recordings, as coroutines.

`asynchronous.py` and `blocking.py` implement the abstract methods of Client, which send and wait: on an event loop, or
on the caller's thread, where a coroutine runs to its end without suspending. asyncio is not imported here, since
blocking programs do not need it.
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
from hapticd.client.base import Owner, warn
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
"""A function that waits for a number of seconds, and returns true as soon as the work has to end."""
READY_TOPIC: Final = b"state"
"""Topic whose first message shows that all subscriptions are in effect; it is published 60 times a second."""


class Client(ABC):
    """The base of the blocking and the asyncio client. Subclasses implement sending and waiting."""

    def __init__(self, place: RuntimePaths, timeout_s: float = REPLY_TIMEOUT_S) -> None:
        self.paths: RuntimePaths = place
        self.timeout_s = timeout_s
        self._closed = False
        self._owner = Owner()
        self._ids = itertools.count(1)
        self._sender = streams.Sender(place, timeout_s, self._owner)
        self._subscriptions: set[Subscription[Any]] = set()
        self._operator_tick: int | None = None
        """Tick of the last `set_operator` of this client."""

    @classmethod
    async def _connected(cls, runtime_dir: str | os.PathLike[str] | None, timeout_s: float, wait_s: float) -> Self:
        """Return a client, after waiting at most `wait_s` for a daemon to listen. Raises DaemonNotRunning."""
        place = places.place_of(runtime_dir)
        given_up = threading.Event()
        try:
            if wait_s > 0:
                await cls._in_thread(places.await_ready, place, wait_s, given_up.is_set)
                # The daemon may have created its runtime directory meanwhile.
                place = places.place_of(runtime_dir)
            await cls._in_thread(places.probe, place)
        except DaemonNotRunning as error:
            raise places.after_waiting(error, wait_s) from None
        finally:
            given_up.set()
        return cls(place, timeout_s)

    # ---- Sending and waiting --------------------------------------------------------------------------------------

    @abstractmethod
    async def _exchange(self, id: int, body: bytes) -> Response:
        """Send a call to the daemon and return the reply. Raises zmq.Again after the client's `timeout_s`."""

    @abstractmethod
    async def _disconnect(self) -> None:
        """Close the connection for calls."""

    @abstractmethod
    def _subscriber(self) -> zmq.Socket[Any]:
        """Return a new SUB socket for `_receive`."""

    @abstractmethod
    async def _receive(self, socket: zmq.Socket[Any], timeout_s: float) -> list[bytes]:
        """Return the frames of the next message. Raises zmq.Again after `timeout_s`."""

    @staticmethod
    @abstractmethod
    async def _in_thread(work: Callable[..., T], /, *given: Any) -> T:
        """Call a blocking function and return its result."""

    @abstractmethod
    def _start(self, name: str, work: Callable[[Wait], Coroutine[Any, Any, None]]) -> Callable[[], Awaitable[None]]:
        """Start background work; return a function that ends the work and raises the error of the work, if any."""

    @abstractmethod
    def _blocking(self) -> AbstractContextManager[Daemon]:
        """Return a blocking client of the same daemon, for another thread."""

    # ---- Calls -------------------------------------------------------------------------------------------------------

    def _refuse_closed(self) -> None:
        if self._closed:
            raise HapticdError("the client is closed")

    async def close(self) -> None:
        """Close the client and its subscriptions. Closing it again has no effect.

        In a forked child, the connections of the parent stay as they are.
        """
        self._closed = True
        if not self._owner.is_forked:
            await self._disconnect()
            self._sender.close()
        for subscription in list(self._subscriptions):
            subscription.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.close()

    async def call(self, method: str, params: Mapping[str, object] | None = None) -> object:
        """Call any method of the protocol by its name, and return its result."""
        self._owner.refuse_fork()
        id = next(self._ids)
        body = calls.encode_request(id, method, params)
        try:
            response = await self._exchange(id, body)
        except zmq.Again:
            raise await self._in_thread(places.no_answer, self.paths, self.timeout_s) from None
        return calls.result_of(response, params)

    async def _change(
        self, method: str, params: dict[str, object], expect_revision: int | None, wait: bool, force: bool = False
    ) -> RevisionResult:
        if expect_revision is not None:
            params["expect_revision"] = expect_revision
        if arguments.flag("wait", wait):
            params["wait"] = True
        if arguments.flag("force", force):
            params["force"] = True
        return cast(RevisionResult, await self.call(method, params))

    async def get_status(self, detail: bool = False) -> Status:
        """Return device, rate, real-time rights, revision, forces, faults, counters; with `detail` also histograms."""
        return cast(Status, await self.call("get_status", {"detail": True} if detail else {}))

    async def get_state(self) -> State:
        """Return the newest sample of the servo (positions, forces, contacts), as `states` yields it."""
        return cast(State, await self.call("get_state"))

    async def state(self) -> State:
        """Return the newest sample of the servo (positions, forces, contacts); short for `get_state`."""
        return await self.get_state()

    async def get_config(self) -> ConfigResult:
        """Return the keys `servo` and `device` of the configuration."""
        return cast(ConfigResult, await self.call("get_config"))

    async def get_scene(self) -> SceneResult:
        """Return the scene, and its revision: the number of the last change of scene or materials."""
        return cast(SceneResult, await self.call("get_scene"))

    async def set_scene(
        self, scene: SceneSource, expect_revision: int | None = None, wait: bool = False, force: bool = False
    ) -> RevisionResult:
        """Replace the scene.

        `scene` is a mapping, the path of a YAML file with a scene, or a `hapticd.Scene`. With `expect_revision` the
        daemon refuses the change (-32001) if the scene has another revision. With `wait` the result has the first
        `tick` that was rendered with the new scene. While forces are on, an object that would hold the handle deep
        inside is refused (-32011), unless `force` is true.
        """
        return await self._change("set_scene", {"scene": scene_tree(scene)}, expect_revision, wait, force)

    async def update_scene(
        self, objects: PatchSource, expect_revision: int | None = None, wait: bool = False, force: bool = False
    ) -> RevisionResult:
        """Change scene objects by id, with a JSON Merge Patch (RFC 7396) of `objects`; None removes an object.

        `force` is as in `set_scene`.
        """
        params: dict[str, object] = {"objects": patch_tree(objects, "scene", "objects")}
        return await self._change("update_scene", params, expect_revision, wait, force)

    async def get_materials(self) -> MaterialsResult:
        """Return all materials by name, including the shipped ones."""
        return cast(MaterialsResult, await self.call("get_materials"))

    async def set_materials(
        self, materials: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Add materials, or replace those of the same name; others are kept.

        `materials` is a mapping by name, or the path of a YAML file.
        """
        params: dict[str, object] = {"materials": patch_tree(materials, "materials")}
        return await self._change("set_materials", params, expect_revision, wait)

    async def update_materials(
        self, materials: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Change materials, by name, with a JSON Merge Patch (RFC 7396): a mapping or the path of a YAML file."""
        params: dict[str, object] = {"materials": patch_tree(materials, "materials")}
        return await self._change("update_materials", params, expect_revision, wait)

    async def apply(
        self,
        *,
        materials: PatchSource | None = None,
        scene: SceneSource | None = None,
        expect_revision: int | None = None,
        wait: bool = False,
        force: bool = False,
    ) -> RevisionResult:
        """Set materials as `set_materials` does and the scene as `set_scene` does, as one change at one tick.

        If materials or scene are invalid, nothing is changed. `force` is as in `set_scene`.
        """
        params: dict[str, object] = {}
        if materials is not None:
            params["materials"] = patch_tree(materials, "materials")
        if scene is not None:
            params["scene"] = scene_tree(scene)
        return await self._change("apply", params, expect_revision, wait, force)

    async def play(
        self,
        material: str | None = None,
        *,
        mode: Mapping[str, float] | None = None,
        direction: Iterable[float] = (0.0, 1.0),
        amplitude_m_per_s2: float,
    ) -> PlayResult:
        """Strike a mode, or the mode of a material's tap or rupture, along `direction` [x, y], in contact or not."""
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
        """Heal membranes and clear contacts of the objects with these ids, or of all objects."""
        params = None if objects is None else {"objects": arguments.texts("objects", objects)}
        return cast(TickResult, await self.call("reset", params))

    async def mark(self, text: str, data: Json = None) -> TickResult:
        """Put a mark into the event stream, and so into every recording; the result has its `tick`.

        `text` has at most 1000 characters, `data` is a JSON value of at most 8 KiB.
        """
        return cast(TickResult, await self.call("mark", {"text": text, "data": data}))

    async def set_forces(self, enabled: bool) -> ForcesResult:
        """Turn forces on or off.

        `set_forces(True)` clears the latched faults whose cause has ended, and is refused (-32003) if a fault remains.
        """
        return cast(ForcesResult, await self.call("set_forces", {"enabled": enabled}))

    async def set_operator(
        self,
        waypoints: WaypointsSource | None = None,
        *,
        interpolation: Interpolation | None = None,
        gesture: Mapping[str, object] | None = None,
    ) -> OperatorResult:
        """Move the hand of the simulated joystick along waypoints, or by a gesture.

        `waypoints` are [[t_s, x_m, y_m], ...], or the path of a file (YAML, JSON, CSV) with waypoints or a gesture.
        """
        params = operator_params(waypoints, interpolation, gesture)
        result = cast(OperatorResult, await self.call("set_operator", params))
        self._operator_tick = result["tick"]
        return result

    async def wait_gesture(self, timeout_s: float | None = None) -> GestureEnd:
        """Wait for the end of the last motion that this client set by `set_operator`; return the event `gesture_end`.

        `completed` is false in the event if another operator replaced the motion. Raises TimedOut after `timeout_s`
        (None: no limit), and DaemonNotRunning if the daemon ends.
        """
        started_tick = self._operator_tick
        if started_tick is None:
            raise HapticdError("wait_gesture: this client has not called set_operator")
        within_s = math.inf if timeout_s is None else arguments.seconds("timeout_s", timeout_s, zero=True)
        deadline_s = time.monotonic() + within_s
        # Subscribed before the status is read, so that the end cannot be missed.
        async with self.telemetry("event", "status") as subscription:
            end = gesture_end(started_tick, "status", cast("dict[str, object]", await self.get_status()))
            while end is None:
                left_s = deadline_s - time.monotonic()
                message = await subscription.receive(max(0.0, min(left_s, self.timeout_s)))
                if message is not None:
                    end = gesture_end(started_tick, *message)
                elif left_s <= self.timeout_s:
                    raise TimedOut(f"wait_gesture: the hand was still moving after {timeout_s:g} s")
                else:
                    raise await self._in_thread(places.no_telemetry, self.paths, self.timeout_s)
        return end

    async def lease(self, duration_s: float, token: str | None = None) -> LeaseResult:
        """Take the lease, or renew the lease of `token`, for `duration_s` from now; 0 ends the lease.

        One client at a time can hold the lease. If the lease is not renewed in time, the daemon fades the forces out.
        """
        params = {"duration_s": duration_s} if token is None else {"duration_s": duration_s, "token": token}
        return cast(LeaseResult, await self.call("lease", params))

    async def reload(
        self, expect_revision: int | None = None, wait: bool = False, force: bool = False
    ) -> RevisionResult:
        """Reload scene and materials from the configuration files of the daemon; `force` is as in `set_scene`."""
        return await self._change("reload", {}, expect_revision, wait, force)

    async def dump_flight(self) -> FlightResult:
        """Write the last seconds of telemetry to a flight file on the daemon's machine; the result has its path."""
        return cast(FlightResult, await self.call("dump_flight"))

    # ---- While a block of code runs ----------------------------------------------------------------------------------

    @asynccontextmanager
    async def hold_lease(self, duration_s: float = 1.0) -> AsyncIterator[str]:
        """Hold the lease while the `with` block runs; yields the token of the lease.

        A thread renews the lease three times within `duration_s`, over a separate connection. If the process ends, the
        forces fade out. In asyncio a task renews it, so the forces also fade out if the event loop is blocked for
        `duration_s`. Raises RemoteError at the end of the block if the lease was lost. Warns (ForcesOff) at its start
        if a fault keeps the forces off.
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
                    # The daemon may answer again in time; if not, its reply says that the lease lapsed.
                    with suppress(DaemonNotRunning):
                        await renewer.lease(duration_s, token)

        end = self._start("hapticd-lease", renew)
        try:
            yield token
        except BaseException:
            # The error of the block is raised, not those of ending the lease.
            with suppress(Exception):
                self._owner.refuse_fork()
                await end()
            with suppress(Exception):
                await self.lease(0, token)
            raise
        self._owner.refuse_fork()
        await end()
        await self.lease(0, token)

    @asynccontextmanager
    async def record(
        self, /, path: str | os.PathLike[str], overwrite: bool = False, **notes: object
    ) -> AsyncIterator[Recorder]:
        """Record every tick and event to `path` while the `with` block runs: .npz, or .csv or .mcap exported from it.

        A thread with a separate connection records, from before the block until all effects of the block are recorded.
        `notes` are JSON values, which are stored in the file. Yields a Recorder, whose `result` is available after the
        block. Raises HapticdError before the block if `path` already exists (unless `overwrite`) or cannot be written,
        and after the block if the recording ended early. Warns (MissedPeriods) after the block if the servo missed too
        many periods.
        """
        from hapticd.client.record import Recorder

        owner = Owner()
        recorder = Recorder(self._blocking, path, overwrite, notes)
        try:
            await self._in_thread(recorder.begin)
            yield recorder
        except BaseException:
            with suppress(HapticdError):  # the error of the block is raised, not that of the recording
                owner.refuse_fork()
                await self._in_thread(recorder.end)
            raise
        owner.refuse_fork()
        for warning in await self._in_thread(recorder.end):
            warn(warning)

    def stream(self) -> Stream:
        """Stream targets of the simulated hand, or forces, while the `with` block runs: up to 1,000 of each a second.

        The servo interpolates linearly between messages. If no message arrives within the time-out (20 ms by default),
        a force fades to zero and the hand stays. The end of the block sends a force of zero. Messages do not wait for
        replies. The first of each kind, and then one every half second, requests a reply. If the daemon refuses a
        message, a later message or the end of the block raises RemoteError. Warns (ForcesOff) if forces are off.
        """
        self._refuse_closed()
        return Stream(self._sender, streams.AlreadySent())

    # ---- Telemetry ---------------------------------------------------------------------------------------------------

    def samples(self, timeout_s: float | None = None, *, newest: bool = False) -> Subscription[SampleBatch]:
        """Subscribe to the samples of all ticks, in batches of 20 ms: numpy arrays whose `lost` counts missing samples.

        The subscription begins at this call, in asyncio at `async with` or the first item. Iteration raises
        DaemonNotRunning if nothing arrives for `timeout_s` (by default that of the client), and warns (TelemetryLoss)
        if the program reads too slowly.

        With `newest` an item is the first batch that the daemon sends after the program requests the item. Batches
        between two items are skipped: their samples are counted in `lost`, without a warning.
        """
        from hapticd.client.samples import SampleStream

        newest = arguments.flag("newest", newest)
        return Subscription(self, ("samples",), SampleStream(warn=not newest).convert, timeout_s, newest)

    def states(self, timeout_s: float | None = None, *, newest: bool = False) -> Subscription[State]:
        """Subscribe to the servo's newest sample as a dictionary, 60 times a second.

        With `newest` an item is the first sample that the daemon sends after the program requests the item, so a slow
        reader never gets an old one.
        """
        newest = arguments.flag("newest", newest)
        return Subscription(self, ("state",), lambda _, message: cast(State, message), timeout_s, newest)

    def events(self, timeout_s: float | None = None) -> Subscription[Event]:
        """Subscribe to events: contacts, releases, punctures, faults and others."""
        return Subscription(self, ("event",), lambda _, message: cast("Event", message), timeout_s)

    def statuses(self, timeout_s: float | None = None) -> Subscription[Status]:
        """Subscribe to the status of the daemon, once a second."""
        return Subscription(self, ("status",), lambda _, message: cast(Status, message), timeout_s)

    def telemetry(
        self, *topics: Topic, timeout_s: float | None = None
    ) -> Subscription[tuple[Topic, dict[str, object]]]:
        """Subscribe to several topics on one socket; items are pairs (topic, message), in the order of sending."""
        return Subscription(self, topics, lambda topic, message: (topic, message), timeout_s)


class Subscription(Generic[T]):
    """An endless asynchronous iterator over telemetry.

    The subscription lasts from `async with`, or else the first item, until `close` or the end of `async with`.
    """

    def __init__(
        self,
        client: Client,
        topics: Sequence[Topic],
        convert: Callable[[Topic, dict[str, object]], T],
        timeout_s: float | None,
        newest: bool = False,
    ) -> None:
        """Create a subscription. With `newest` the daemon sends an item only when the program requests one."""
        if not topics:
            known = ", ".join(get_args(Topic))
            raise arguments.invalid_argument("telemetry", f"needs at least one topic; known: {known}")
        for topic in topics:
            arguments.one_of("topic", topic, get_args(Topic))
        self._timeout_s = client.timeout_s if timeout_s is None else arguments.seconds("timeout_s", timeout_s)
        client._refuse_closed()
        self._client, self._convert, self._owner = client, convert, Owner()
        self._wanted = {topic.encode() for topic in topics}
        self._on_demand = self._wanted - {HEARTBEAT_TOPIC} if newest else set()
        """Topics that are subscribed for each item, and unsubscribed after it."""
        self._first: T | None = None
        """An item that arrived before the first request."""
        self._ready = False
        self._socket = client._subscriber()
        self._socket.setsockopt(zmq.LINGER, 0)
        # Subscriptions take effect in their order, with READY_TOPIC last, so its first message shows that all are in
        # effect. HEARTBEAT_TOPIC arrives every second, so silence means that the daemon has ended.
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
        """Whether the subscription has ended."""
        return self._socket.closed

    def close(self) -> None:
        """End the subscription. Closing it again has no effect; nor has closing it in a forked child."""
        if not self._owner.is_forked:
            self._socket.close()
        self._client._subscriptions.discard(self)

    async def _take(self, timeout_s: float) -> T | None:
        """Return the item of the next message, or None if the message is not of a wanted topic. Raises zmq.Again."""
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
        """Return the next item, or None if the subscription is closed. Raises zmq.Again.

        `left_s` returns the time to wait for the next message, in s.
        """
        self._owner.refuse_fork()
        item, self._first = self._first, None
        if item is not None:
            return item
        with suppress(zmq.Again):
            while self._on_demand:  # drop messages that arrived since the last item
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
        """Return the next item, or None if no item arrives within `timeout_s`; with 0 do not wait.

        Raises InvalidError if `timeout_s` is negative or not finite. Unlike the iterator, it raises nothing if the
        daemon is silent.
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
        """Wait for the first message of the daemon."""
        self._owner.refuse_fork()
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
    """Return the event at the end of the motion that began at `started_tick`; None if `message` does not have it.

    Raises HapticdError if the daemon no longer knows the motion.
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
            f"the daemon has no operator of tick {started_tick}: it was restarted, or {messages.MAX_GESTURE_ENDS} "
            "later motions ended"
        )
    return None
