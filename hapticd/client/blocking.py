"""The client for ordinary, blocking code: `with hapticd.connect() as daemon: ...`.

One DEALER socket for commands, used under a lock, so that a client may be shared between threads; each
subscription has a SUB socket of its own and belongs to one thread. What is said over them stands in
`calls.py`.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import TYPE_CHECKING, Generic, Self, TypeVar, cast

import zmq

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

__all__ = ["Client", "DaemonNotRunning", "RemoteError", "Subscription", "TelemetryLoss", "connect"]

T = TypeVar("T")


def connect(
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout_s: float = TIMEOUT_S,
    *,
    wait_s: float = 0.0,
    key: KeySource = None,
    server_key: str | os.PathLike[str] | None = None,
) -> Client:
    """A client of the daemon at `runtime_dir` (by default where the environment says), to be used in `with`.

    `timeout_s` is how long each call waits for its answer. `wait_s` is how long to wait for a daemon that is not ready
    yet. Raises DaemonNotRunning where nobody listens.

    `tcp://HOST:PORT` in its place is a bridge on another machine; then `key` is the file of our secret key, and
    `server_key` the bridge's public key, or a file with it. A bridge that refuses the key raises KeyRefused.

    What is not given is taken from the environment: HAPTICD_CONNECT, the address of a bridge, or else
    HAPTICD_RUNTIME_DIR; HAPTICD_KEY and HAPTICD_SERVER_KEY.
    """
    return Client(runtime_dir, timeout_s, wait_s=wait_s, key=key, server_key=server_key)


class Client:
    """The daemon's methods, by their names in the protocol; each returns the protocol's result as a
    dictionary.

    Every method raises RemoteError where the daemon refuses, and DaemonNotRunning where it does not answer
    within `timeout_s`; such a call is not repeated later by itself.
    """

    def __init__(
        self,
        runtime_dir: str | os.PathLike[str] | None = None,
        timeout_s: float = TIMEOUT_S,
        *,
        wait_s: float = 0.0,
        key: KeySource = None,
        server_key: str | os.PathLike[str] | None = None,
    ) -> None:
        """As `connect`."""
        timeout_s, wait_s = arguments.seconds("timeout_s", timeout_s), arguments.seconds("wait_s", wait_s, zero=True)
        place = calls.place_of(runtime_dir, key, server_key)
        try:
            if wait_s > 0:
                calls.await_ready(place, wait_s)
                # A runtime directory that was made meanwhile is looked at again.
                place = calls.place_of(runtime_dir, key, server_key)
            self._begin(place, timeout_s)
        except DaemonNotRunning as error:
            raise calls.waited(error, wait_s) from None

    def _begin(self, place: Place, timeout_s: float) -> None:
        self.paths: Place = place
        self.timeout_s = timeout_s
        self._lock = threading.Lock()
        self._last_id = 0
        self._subscriptions: list[Subscription[object]] = []
        self._closed = False
        self._operator_tick: int | None = None
        # Opened when it is first used: who may only watch has none.
        self._socket: zmq.Socket[bytes] | None = None
        calls.probe(self.paths, timeout_s)

    @classmethod
    def at(cls, place: Place, timeout_s: float) -> Self:
        """A client of the daemon at a place that is known."""
        client = cls.__new__(cls)
        client._begin(place, timeout_s)
        return client

    def _open(self) -> zmq.Socket[bytes]:
        if isinstance(self.paths, Remote):
            calls.probe(self.paths, self.timeout_s, command=True)
        socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
        socket.setsockopt(zmq.LINGER, 0)
        # Nothing waits in a queue for a daemon that is not there: what was told to a dead one must not
        # reach the next.
        socket.setsockopt(zmq.IMMEDIATE, 1)
        socket.setsockopt(zmq.SNDTIMEO, _milliseconds(self.timeout_s))
        socket.setsockopt(zmq.RCVTIMEO, _milliseconds(self.timeout_s))
        if isinstance(self.paths, Remote):
            self.paths.secure(socket)
        socket.connect(self.paths.command_endpoint)
        return socket

    def close(self) -> None:
        """Closes the client and its subscriptions; it may be closed twice."""
        with self._lock:
            self._closed = True
            if self._socket is not None:
                self._socket.close()
            subscriptions, self._subscriptions = self._subscriptions, []
        for subscription in subscriptions:
            subscription.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, method: str, params: Mapping[str, object] | None = None) -> object:
        """Calls any method of the protocol by its name; returns its result."""
        with self._lock:
            if self._closed:
                raise HapticdError("the client is closed")
            self._last_id += 1
            id = self._last_id
            body = calls.question(id, method, params)
            socket = self._socket = self._socket or self._open()
            try:
                socket.send(body)
                answer_id, result = calls.answer(socket.recv())
                if answer_id != id and answer_id is not None:
                    result = self._skip_to(socket, id)
            except zmq.Again:
                # The call may still be under way; its answer goes with the socket.
                socket.close()
                self._socket = None
                raise calls.unanswered(self.paths, self.timeout_s) from None
        return calls.outcome(result, params, self.paths)

    def _skip_to(self, socket: zmq.Socket[bytes], id: int) -> object | RemoteError | DaemonNotRunning:
        """The answer to `id`, past those to calls that were interrupted."""
        deadline = time.monotonic() + self.timeout_s
        while time.monotonic() < deadline:
            answer_id, result = calls.answer(socket.recv())
            if answer_id == id or answer_id is None:
                return result
        raise zmq.Again

    # ---- methods -------------------------------------------------------------------------------------------

    def get_status(self, detail: bool = False) -> Status:
        """Version, device, rate, real-time rights, revision, tick, forces, faults and counters; `detail`: histograms,
        too."""
        return cast(Status, self.call("get_status", {"detail": True} if detail else {}))

    def get_state(self) -> State:
        """The newest sample, as `states` yields it."""
        return cast(State, self.call("get_state"))

    def state(self) -> State:
        """The newest sample: `get_state` by its short name."""
        return self.get_state()

    def get_config(self) -> ConfigResult:
        """The configuration's servo and device."""
        return cast(ConfigResult, self.call("get_config"))

    def get_scene(self) -> SceneResult:
        """The scene and its revision."""
        return cast(SceneResult, self.call("get_scene"))

    def set_scene(self, scene: SceneSource, expect_revision: int | None = None, wait: bool = False) -> RevisionResult:
        """Replaces the scene, all or nothing.

        `scene` is a mapping, the path of a YAML file that holds a scene, or a `hapticd.Scene`. With
        `expect_revision` the daemon refuses (-32001) if the scene has another revision; with `wait` the
        result has the first `tick` rendered with it.
        """
        params = calls.change_params("scene", calls.scene_tree(scene), expect_revision, wait)
        return cast(RevisionResult, self.call("set_scene", params))

    def update_scene(
        self, objects: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Changes objects by id: a JSON Merge Patch (RFC 7396) over the scene's `objects`; None removes."""
        patch = calls.patch_tree(objects, "scene", "objects")
        params = calls.change_params("objects", patch, expect_revision, wait)
        return cast(RevisionResult, self.call("update_scene", params))

    def get_materials(self) -> MaterialsResult:
        """All materials by name, the shipped ones among them."""
        return cast(MaterialsResult, self.call("get_materials"))

    def set_materials(
        self, materials: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Adds materials by name, and replaces those of the same name whole; others stay. A mapping or the path of a
        YAML file."""
        tree = calls.patch_tree(materials, "materials")
        params = calls.change_params("materials", tree, expect_revision, wait)
        return cast(RevisionResult, self.call("set_materials", params))

    def update_materials(
        self, materials: PatchSource, expect_revision: int | None = None, wait: bool = False
    ) -> RevisionResult:
        """Changes materials by name: a JSON Merge Patch, as a mapping or the path of a YAML file."""
        patch = calls.patch_tree(materials, "materials")
        params = calls.change_params("materials", patch, expect_revision, wait)
        return cast(RevisionResult, self.call("update_materials", params))

    def apply(
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
        return cast(RevisionResult, self.call("apply", params))

    def play(
        self,
        material: str | None = None,
        *,
        mode: Mapping[str, float] | None = None,
        direction: Iterable[float] = (0.0, 1.0),
        amplitude_m_per_s2: float,
    ) -> PlayResult:
        """Strikes a mode, or a material's tap, along `direction` [x, y], whatever is touched."""
        return cast(PlayResult, self.call("play", calls.play_params(material, mode, direction, amplitude_m_per_s2)))

    def reset(self, objects: Iterable[str] | None = None) -> TickResult:
        """Heals membranes and clears contact state, of the objects with these ids or of all."""
        return cast(TickResult, self.call("reset", calls.reset_params(objects)))

    def mark(self, text: str, data: Json = None) -> TickResult:
        """Leaves a mark in the event stream and in every recording; the result has its `tick`.

        `text` has up to 1000 characters, `data` is anything that JSON can hold, up to 8 KiB.
        """
        return cast(TickResult, self.call("mark", {"text": text, "data": data}))

    def set_forces(self, enabled: bool) -> ForcesResult:
        """Forces on or off; on clears a latched fault whose cause is gone, else is refused (-32003)."""
        return cast(ForcesResult, self.call("set_forces", {"enabled": enabled}))

    def set_operator(
        self,
        waypoints: WaypointsSource | None = None,
        *,
        interpolation: Interpolation | None = None,
        gesture: Mapping[str, object] | None = None,
    ) -> OperatorResult:
        """What the simulated joystick's hand does: waypoints [[t_s, x_m, y_m], ...], a gesture, or the path of a file
        (YAML, JSON, CSV) that holds either."""
        params = calls.operator_params(waypoints, interpolation, gesture)
        result = cast(OperatorResult, self.call("set_operator", params))
        self._operator_tick = result["tick"]
        return result

    def wait_gesture(self, timeout_s: float | None = None) -> GestureEnd:
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
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
        # Who listens first and then asks misses no end.
        with self.telemetry("event", "status") as messages:
            end = calls.gesture_end(started_tick, "status", cast("dict[str, object]", self.get_status()))
            while end is None:
                left_s = deadline - time.monotonic()
                message = messages.receive(max(0.0, min(left_s, self.timeout_s)))
                if message is not None:
                    end = calls.gesture_end(started_tick, *message)
                elif left_s <= self.timeout_s:
                    raise TimedOut(f"wait_gesture: the hand was still under way after {timeout_s:g} s")
                else:
                    raise calls.silent(self.paths, self.timeout_s)
        return end

    def lease(self, duration_s: float, token: str | None = None) -> LeaseResult:
        """Takes a lease, or renews that with `token`; 0 ends it. Not renewed in time, forces fade out."""
        return cast(LeaseResult, self.call("lease", calls.lease_params(duration_s, token)))

    def reload(self, expect_revision: int | None = None, wait: bool = False) -> RevisionResult:
        """The daemon reads its configuration files anew: scene and materials, all or nothing."""
        return cast(RevisionResult, self.call("reload", calls.reload_params(expect_revision, wait)))

    def dump_flight(self) -> FlightResult:
        """Has the last seconds of telemetry written to a file on the daemon's machine; its name."""
        return cast(FlightResult, self.call("dump_flight"))

    @contextmanager
    def hold_lease(self, duration_s: float = 1.0) -> Iterator[str]:
        """Holds a lease while the block runs, and gives its token.

        A thread with a connection of its own renews it three times within `duration_s`; it dies with the
        process, and the forces fade. Raises at the end of the block where the lease was lost meanwhile.
        Warns (ForcesOff) where a fault keeps the forces off until `set_forces(True)`.
        """
        token = calls.token_of(self.lease(duration_s))
        stop = threading.Event()
        lost: list[HapticdError] = []

        def renew() -> None:
            try:
                with self.at(self.paths, duration_s / 3) as renewer:
                    while not stop.wait(duration_s / 3):
                        # A daemon that is away may come back in time; if not, its answer says that the
                        # lease lapsed.
                        with suppress(DaemonNotRunning):
                            renewer.lease(duration_s, token)
            except HapticdError as error:
                lost.append(error)

        thread = threading.Thread(target=renew, name="hapticd-lease", daemon=True)
        thread.start()
        try:
            yield token
        except BaseException:
            stop.set()
            thread.join()
            with suppress(HapticdError):  # what went wrong in the block is what is told
                self.lease(0, token)
            raise
        stop.set()
        thread.join()
        if lost:
            raise lost[0]
        self.lease(0, token)

    @contextmanager
    def record(self, path: str | os.PathLike[str], overwrite: bool = False, **notes: object) -> Iterator[Recorder]:
        """Records every tick and every event while the block runs, into `path`: .npz, .csv or .mcap.

        A thread with a connection of its own records. The first sample is taken before the block begins, and what the
        block did last is in the file. `notes` are kept in it as they are, whatever JSON can hold. Gives a Recorder,
        whose `result` is there after the block. Raises HapticdError before the block where `path` is there already
        (unless `overwrite`) or cannot be written, and at its end where the recording ended before. Warns
        (MissedPeriods) at its end where the servo missed too many periods.
        """
        from hapticd.client.background import Recorder

        recorder = Recorder(lambda: self.at(self.paths, self.timeout_s), path, overwrite, notes)
        try:
            recorder.begin()
            yield recorder
        except BaseException:
            with suppress(HapticdError):  # what went wrong in the block is what is told
                recorder.end()
            raise
        recorder.end()

    # ---- telemetry -----------------------------------------------------------------------------------------

    def samples(self, timeout_s: float | None = None, *, newest: bool = False) -> Subscription[SampleBatch]:
        """Every tick, in batches of 20 ms: numpy structured arrays that know what of them was lost (`lost`).

        Begins when this returns. Iteration raises DaemonNotRunning where nothing comes for `timeout_s` (by
        default the client's), and warns (TelemetryLoss) where reading is too slow.

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
        with self._lock:
            self._subscriptions = [other for other in self._subscriptions if not other.closed]
            self._subscriptions.append(cast("Subscription[object]", subscription))
        return subscription


class Subscription(Generic[T]):
    """An endless iterator over telemetry, in effect from its creation until `close` or the end of `with`."""

    def __init__(self, paths: Place, feed: Feed[T], timeout_s: float) -> None:
        self._paths = paths
        self._feed = feed
        self._timeout_s = timeout_s
        self._first: list[T] = []
        self._socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        try:
            for topic in feed.subscriptions:
                self._socket.setsockopt(zmq.SUBSCRIBE, topic)
            if isinstance(paths, Remote):
                paths.secure(self._socket)
                self._socket.setsockopt(zmq.SUBSCRIBE, Feed.BRIDGE)
            self._socket.connect(paths.telemetry_endpoint)
            self._begin()
            if isinstance(paths, Remote):
                self._socket.setsockopt(zmq.UNSUBSCRIBE, Feed.BRIDGE)
            for topic in feed.surplus:
                self._socket.setsockopt(zmq.UNSUBSCRIBE, topic)
        except BaseException:
            self._socket.close()
            raise

    def _begin(self) -> None:
        """Waits for the first message of a daemon, less long where a bridge says that there is none."""
        deadline, away, topic = time.monotonic() + self._timeout_s, False, Feed.BRIDGE
        while topic == Feed.BRIDGE:
            try:
                frames = self._receive(_milliseconds(max(0.0, deadline - time.monotonic())))
            except zmq.Again:
                raise calls.behind(self._paths) if away else calls.silent(self._paths, self._timeout_s) from None
            self._first += () if self._feed.each else self._feed.accept(frames)
            topic, away = frames[0], not Feed.shows_daemon(frames)
            if away:
                deadline = min(deadline, time.monotonic() + calls.AWAY_S)

    def _receive(self, timeout_ms: int) -> list[bytes]:
        self._socket.setsockopt(zmq.RCVTIMEO, timeout_ms)
        return self._socket.recv_multipart()

    @property
    def closed(self) -> bool:
        return self._socket.closed

    def close(self) -> None:
        """Ends the subscription; it may be closed twice."""
        self._socket.close()

    def receive(self, timeout_s: float) -> T | None:
        """The next item, or None where none comes within `timeout_s`."""
        timeout_s = arguments.seconds("timeout_s", timeout_s, zero=True)
        if self._first:
            return self._first.pop(0)
        deadline = time.monotonic() + timeout_s
        with self._asked():
            while True:
                try:
                    items = self._feed.accept(self._receive(_milliseconds(max(0.0, deadline - time.monotonic()))))
                except zmq.Again:
                    return None
                if items:
                    return items[0]

    @contextmanager
    def _asked(self) -> Iterator[None]:
        """Of a subscription to the newest: what is left of the last time goes, and the next one is asked for."""
        if self._feed.each:
            with suppress(zmq.Again):
                while True:
                    self._socket.recv_multipart(zmq.NOBLOCK)
            for topic in self._feed.each:
                self._socket.setsockopt(zmq.SUBSCRIBE, topic)
        try:
            yield
        finally:
            if not self._socket.closed:
                for topic in self._feed.each:
                    self._socket.setsockopt(zmq.UNSUBSCRIBE, topic)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> T:
        if self._first:
            return self._first.pop(0)
        if self._socket.closed:
            raise StopIteration
        with self._asked():
            while not self._socket.closed:
                try:
                    items = self._feed.accept(self._receive(_milliseconds(self._timeout_s)))
                except zmq.Again:
                    raise calls.silent(self._paths, self._timeout_s) from None
                if items:
                    return items[0]
        raise StopIteration

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _milliseconds(timeout_s: float) -> int:
    return min(int(timeout_s * 1e3 + 0.999), 2**31 - 1)
