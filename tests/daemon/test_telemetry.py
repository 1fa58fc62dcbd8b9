"""Events in telemetry: events of a flood that are read together are merged."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, records
from hapticd.config.configuration import load_config
from hapticd.daemon.engine import Engine
from hapticd.daemon.telemetry import Telemetry
from hapticd.protocol import messages


class Names:
    """An engine with the names of objects."""

    def name_of(self, slot: int, generation: int) -> str | None:
        return {(0, 1): "comb", (0, 9): "later", (5, 1): "file"}.get((slot, generation))


def batch(*events: tuple[EventKind, int, int, int]) -> npt.NDArray[np.void]:
    array = records(EVENT_DTYPE, len(events))
    for record, (kind, tick, slot, generation) in zip(array, events, strict=True):
        record["kind"], record["tick"], record["slot"], record["generation"] = kind, tick, slot, generation
        record["time_ns"], record["value"], record["speed_m_per_s"] = 100_000 * tick, tick, -0.01 * tick
    return array


def merged(*events: tuple[EventKind, int, int, int]) -> list[dict[str, object]]:
    telemetry = Telemetry(cast(Engine, Names()), cast(Any, None), dict)
    return list(telemetry._maps(batch(*events)))


def test_grooves_of_one_object_are_told_as_one_that_speaks_of_the_last() -> None:
    groove = EventKind.GROOVE
    found = merged(
        (EventKind.CONTACT, 1, 0, 1),
        (groove, 2, 0, 1),
        (groove, 3, 5, 1),
        (groove, 4, 0, 1),
        (groove, 4, 0, 1),
        (EventKind.RELEASE, 5, 0, 1),
        (groove, 6, 0, 9),  # another object has the slot
        (groove, 7, 5, 1),
    )
    shown = [(event["event"], event["object"], event["tick"], event.get("count")) for event in found]
    assert shown == [
        ("contact", "comb", 1, None),
        ("groove", "comb", 4, 3),
        ("release", "comb", 5, None),
        ("groove", "later", 6, 1),
        ("groove", "file", 7, 2),
    ]
    comb = found[1]
    assert (comb["time_ns"], comb["grooves"], comb["speed_m_per_s"]) == (400_000, 4, -0.04)


def test_what_is_no_flood_is_told_one_by_one() -> None:
    assert merged() == []
    kinds = [EventKind.SATURATION, EventKind.PUNCTURE, EventKind.SATURATION]
    assert [event["event"] for event in merged(*((kind, 1, 0, 1) for kind in kinds))] == [
        "saturation",
        "puncture",
        "saturation",
    ]


class Read(Names):
    """An engine with `events` events and samples of `revisions`; `read_up_to`: arguments of `events_read`."""

    def __init__(self, events: int, revisions: list[int]) -> None:
        self.events, self.revisions = events, revisions
        self.read_up_to: list[int] = []
        self.granted = None
        self.rate_hz = 10_000.0

    def read_samples(self, room: npt.NDArray[np.void]) -> tuple[int, int]:
        count, revisions = len(self.revisions), self.revisions
        room["revision"][:count] = revisions
        self.revisions = []
        return count, 0

    def read_events(self, room: npt.NDArray[np.void]) -> tuple[int, int]:
        count = min(len(room), self.events)
        room["kind"][:count] = EventKind.OVERRUN
        self.events -= count
        return count, 0

    def events_read(self, revision: int) -> None:
        assert not self.events
        self.read_up_to.append(revision)


class Nowhere:
    """A socket that drops all messages."""

    def wants(self, topic: str) -> bool:
        return True

    def publish(self, topic: str, *body: bytes) -> None:
        pass


@pytest.mark.parametrize(
    ("events", "revisions", "read_up_to"),
    [(0, [], []), (0, [3, 3, 4], [4]), (20, [7], [7]), (1500, [7, 8], [8]), (100_000, [7], [])],
)
def test_how_far_events_were_read_is_said_once_all_that_were_older_were(
    events: int, revisions: list[int], read_up_to: list[int]
) -> None:
    engine = Read(events, revisions)
    Telemetry(cast(Engine, engine), cast(Any, Nowhere()), dict)._drain()
    assert engine.read_up_to == read_up_to


class Heard:
    """A socket that keeps the last message of each topic."""

    def __init__(self) -> None:
        self.last: dict[str, dict[str, Any]] = {}

    def wants(self, topic: str) -> bool:
        return True

    def publish(self, topic: str, *body: bytes) -> None:
        self.last[topic] = cast(dict[str, Any], messages.decode_trusted(b"".join(body)))


def test_what_is_touched_is_right_again_after_events_were_lost() -> None:
    """Forty floors are touched again until the ring of events is full; then all but one are removed, without events."""
    floor = {"kind": "wall", "point_m": [0, 0.001], "normal": [0, 1], "material": "air"}
    floors: dict[str, object] = {f"floor{number}": floor for number in range(40)}
    engine = Engine(load_config({"materials": {"air": {"stiffness_n_per_m": 1}}, "scene": {"objects": floors}}))
    heard = Heard()
    telemetry = Telemetry(engine, cast(Any, heard), dict)

    def touching() -> list[str]:
        telemetry._drain()
        telemetry._send_state()
        return cast(list[str], heard.last["state"]["touching"])

    engine.start()
    try:
        while engine.counters().events_dropped == 0:
            engine.beat()
            engine.reset(None)
        left = engine.scene.with_objects({name: None for name in floors if name != "floor7"})
        engine.wait_revision(engine.take(left, engine.materials))
        engine.reset(["floor7"])  # once it is answered, that tick is over
        assert touching() == ["floor7"]
        engine.wait_revision(engine.take(engine.scene.with_objects({"floor7": None}), engine.materials))
        engine.reset(None)
        assert touching() == []
    finally:
        engine.stop()


def test_samples_that_were_read_for_the_state_are_sent_all_the_same() -> None:
    engine = Engine(load_config({"servo": {"rate_hz": 1000}}))
    heard = Heard()
    telemetry = Telemetry(engine, cast(Any, heard), dict)
    assert telemetry.state() is None
    engine.start()
    try:
        ticks: set[object] = set()
        while len(ticks) < 5:
            ticks.add((telemetry.state() or {"tick": 0})["tick"])
    finally:
        engine.stop()
    telemetry._drain()
    telemetry._send_samples()
    sent = np.frombuffer(heard.last["samples"]["data"], SAMPLE_DTYPE)["tick"].astype(int).tolist()
    assert sent == list(range(sent[0], engine.counters().ticks)) and ticks <= {0, *sent}


@pytest.mark.slow
def test_a_publisher_that_stands_still_loses_nothing_for_1_6_s_at_10_khz() -> None:
    """`dropped` counts the samples that are lost after that time."""
    engine = Engine(load_config({"servo": {"rate_hz": 10_000}}))
    heard = Heard()
    telemetry = Telemetry(engine, cast(Any, heard), dict)
    engine.start()
    try:
        while engine.counters().samples_dropped < 14:
            engine.beat()
            engine.reset(None)
    finally:
        engine.stop()
    telemetry._drain()
    message = heard.last["samples"]
    ticks = np.frombuffer(message["data"], SAMPLE_DTYPE)["tick"].astype(int)
    assert len(ticks) == 16_384 and 16_384 / 10_000 > 1.6
    assert set(np.diff(ticks)) == {1}
    assert message["dropped"] == engine.counters().samples_dropped
