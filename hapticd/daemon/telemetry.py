"""The telemetry thread: drains the servo's rings into messages, which `publisher.py` sends.

It also passes samples and events to the flight recorder, and events to the log. The servo never waits for the thread: a
ring holds more than a second, longer than a garbage collection. A slow subscriber loses messages; others do not.
The command thread reads samples, too, for `get_state`; a lock guards the samples that are not sent yet.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from time import monotonic_ns
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.codec import encode
from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, Flag, records
from hapticd.daemon.engine import SAMPLE_CAPACITY, Engine
from hapticd.daemon.flight_recorder import Flight
from hapticd.daemon.publisher import Publisher
from hapticd.protocol.changes import change_map
from hapticd.protocol.events import event_map
from hapticd.system.journal import EventLog

SAMPLES_INTERVAL_S: Final = 0.020
STATE_INTERVAL_S: Final = 1.0 / 60.0
"""Interval of the topic `state`: a usual display's frame rate."""
STATUS_INTERVAL_S: Final = 1.0
TELEMETRY_TOPICS: Final = ("samples", "state", "event", "change", "status")

_MAX_EVENT_READS: Final = 2
"""Largest number of batches of events that are read before samples are sent."""
_TOPIC_INTERVALS_NS: Final = {
    "samples": round(SAMPLES_INTERVAL_S * 1e9),
    "state": round(STATE_INTERVAL_S * 1e9),
    "status": round(STATUS_INTERVAL_S * 1e9),
}
_UNTIL_FIRST_TICK: Final = b"\x84" + encode("first_tick")
"""Bytes of a message before the value of `first_tick`."""
_UNTIL_DROPPED: Final = encode("dropped")
"""Bytes of a message between the values of `first_tick` and `dropped`."""
_UNTIL_DATA: Final = encode("dtype") + encode(np.lib.format.dtype_to_descr(SAMPLE_DTYPE)) + encode("data")
"""Bytes of a message between the value of `dropped` and the header of `data`."""


def _samples_head(first_tick: int, dropped: int, size: int) -> bytes:
    """Return the msgpack bytes before the `size` bytes of samples in a message."""
    begin = _UNTIL_FIRST_TICK + encode(first_tick) + _UNTIL_DROPPED + encode(dropped) + _UNTIL_DATA
    if size < 2**8:
        return begin + b"\xc4" + size.to_bytes(1, "big")
    if size < 2**16:
        return begin + b"\xc5" + size.to_bytes(2, "big")
    return begin + b"\xc6" + size.to_bytes(4, "big")


def _last_of_each(events: npt.NDArray[np.void]) -> dict[int, int]:
    """Return a mapping from the index of each object's last event to the number of the object's events."""
    objects = events["slot"].astype(np.uint64) << np.uint64(32) | events["generation"]
    _, first, counts = np.unique(objects[::-1], return_index=True, return_counts=True)
    return dict(zip((len(events) - 1 - first).tolist(), counts.tolist(), strict=True))


class Telemetry:
    """Drains the rings of one engine's servo, and passes messages to the publisher when they are due."""

    def __init__(
        self,
        engine: Engine,
        publisher: Publisher,
        status: Callable[[], dict[str, object]],
        flight: Flight | None = None,
    ) -> None:
        """Publish the telemetry of `engine`; `status` returns the message of the topic `status`."""
        self._engine = engine
        self._publisher = publisher
        self._status = status
        self._flight = flight
        self._log = EventLog(
            missing=lambda: engine.granted is not None and bool(engine.granted.missing),
            rate_hz=lambda: engine.rate_hz,
            simulated=lambda: engine.connection is None,
        )
        self._samples = records(SAMPLE_DTYPE, SAMPLE_CAPACITY)
        self._sent_samples = records(SAMPLE_DTYPE, SAMPLE_CAPACITY)
        """The buffer that is swapped with `_samples`, so that samples do not change while they are sent."""
        self._events = records(EVENT_DTYPE, 1024)
        self._held = 0
        self._newest: npt.NDArray[np.void] | None = None
        self._dropped = 0
        self._reading = threading.Lock()
        """Held while samples are read or used, but not while they are sent: the command thread may wait for it."""

    def wake(self) -> None:
        """End the wait for the next message, so that `run` checks whether to stop. For any thread."""
        self._publisher.wake()

    def state(self) -> dict[str, object] | None:
        """Return the message of the topic `state` for the newest sample; None before the first. For any thread."""
        with self._reading:
            self._read_samples()
            return None if self._newest is None else self._state(self._newest[0])

    def run(self, stop: threading.Event) -> None:
        """Publish telemetry until `stop` is set, and once more after that."""
        now = monotonic_ns()
        due = {"samples": now, "state": now, "status": now}
        send = {"samples": self._send_samples, "state": self._send_state, "status": self._send_status}
        while True:
            # The thread does not wake up for the topic `state` while it has no subscribers.
            next_ns = min(due["samples"], due["status"], *((due["state"],) if self._publisher.wants("state") else ()))
            self._publisher.wait(max(0.0, (next_ns - monotonic_ns()) / 1e9))
            if stop.is_set():
                break
            drained_ns = monotonic_ns()
            self._drain()
            self._log.flush()
            self._send_changes()
            now = monotonic_ns()
            for topic, time in due.items():
                if now >= time:
                    send[topic]()
                    # After a stall the interval starts again instead of catching up.
                    every_ns = _TOPIC_INTERVALS_NS[topic]
                    due[topic] = (time if now - time < every_ns else now) + every_ns
            if self._flight is not None:
                self._flight.hand_over_due(drained_ns)
        self._drain()
        self._send_changes()
        self._send_samples()
        self._send_state()
        self._log.finish()
        if self._flight is not None:
            self._flight.finish()

    def _drain(self) -> None:
        with self._reading:
            self._read_samples()
            revision = None if self._newest is None else int(self._newest["revision"][0])
            full = self._held == len(self._samples)
        if full:
            self._send_samples()
        # Bounded: a flood of events must not delay the samples. The ring counts the events that it drops.
        for _ in range(_MAX_EVENT_READS):
            count, _ = self._engine.read_events(self._events)
            for message in self._maps(self._events[:count]) if count else ():
                self._send("event", message)
                self._log.note(message)
                if self._flight is not None:
                    self._flight.keep_event(message)
            if count < len(self._events):
                # `revision` is that of the sample read before these events; the command thread may have read a newer
                # sample since.
                if revision is not None:
                    self._engine.events_read(revision)
                break

    def _read_samples(self) -> None:
        """Move samples from the servo's ring to `_samples`. The caller must hold the lock `_reading`."""
        room = self._samples[self._held :]
        count, self._dropped = self._engine.read_samples(room) if len(room) else (0, self._dropped)
        if count:
            self._held += count
            self._newest = self._samples[self._held - 1 : self._held]  # stays as it is until there is a newer one

    def _maps(self, events: npt.NDArray[np.void]) -> Iterator[dict[str, object]]:
        """Yield the servo's events as maps; overruns, grooves and revisions are merged.

        A flood of events would delay commands. So a batch has one event for all overruns (their sum), one for all
        grooves of an object (their count), and one for all revisions (the newest).
        """
        kinds = events["kind"]
        overruns, revisions = events[kinds == EventKind.OVERRUN], events[kinds == EventKind.REVISION]
        if len(revisions):
            yield event_map(revisions[-1], None)
        strikes = np.flatnonzero(kinds == EventKind.GROOVE)
        counts = _last_of_each(events[strikes])
        sent = (kinds != EventKind.OVERRUN) & (kinds != EventKind.REVISION) & (kinds != EventKind.GROOVE)
        sent[strikes[list(counts)]] = True
        grooves = {int(strikes[place]): count for place, count in counts.items()}
        for place in np.flatnonzero(sent).tolist():
            message = self._note(events[place])
            yield message | {"count": grooves[place]} if place in grooves else message
        if len(overruns):
            total = {"missed": int(overruns["value"].sum()), "count": len(overruns)}
            yield event_map(overruns[-1], None) | total

    def _send_samples(self) -> None:
        with self._reading:
            batch, dropped = self._samples[: self._held], self._dropped
            if len(batch) == 0:
                return
            if self._engine.connection is not None:
                self._engine.connection.note_use(batch, self._engine.touching)
            self._samples, self._sent_samples, self._held = self._sent_samples, self._samples, 0
        if self._publisher.wants("samples"):
            data = batch.view(np.uint8).data
            self._publisher.publish("samples", _samples_head(int(batch["tick"][0]), dropped, len(data)), data)
        if self._flight is not None:
            self._flight.keep_samples(batch)

    def _send_changes(self) -> None:
        for change in self._engine.read_changes():
            if self._publisher.wants("change"):  # the map of a change with thousands of patches takes long
                self._send("change", change_map(change))
            if self._flight is not None:
                self._flight.keep_change(change)

    def _send_state(self) -> None:
        if not self._publisher.wants("state"):
            return
        with self._reading:
            state = None if self._newest is None else self._state(self._newest[0])
        if state is not None:
            self._send("state", state)

    def _state(self, sample: np.void) -> dict[str, object]:
        state: dict[str, object] = {name: sample[name].tolist() for name in SAMPLE_DTYPE.names or ()}
        state["touching"] = self._engine.touching()
        state["flag_names"] = [flag.name.lower() for flag in Flag(int(sample["flags"])) if flag.name]
        return state

    def _send_status(self) -> None:
        self._send("status", self._status())

    def _send(self, topic: str, message: dict[str, object]) -> None:
        if self._publisher.wants(topic):
            self._publisher.publish(topic, encode(message))

    def _note(self, event: Any) -> dict[str, object]:
        """Return an event as a map. Releases the event's mark, and keeps the end of a gesture for the status."""
        name = self._engine.name_of(int(event["slot"]), int(event["generation"]))
        kind = int(event["kind"])
        mark = self._engine.take_mark(int(event["code"])) if kind == EventKind.MARK else None
        message = event_map(event, name, mark)
        if kind == EventKind.GESTURE_END:
            # Kept before the event is sent, so that a client that subscribes and then requests the status misses none.
            self._engine.gesture_ended(message)
        return message
