"""The owner of a stream, the order of its messages, and the counters of all messages."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import msgpack
import pytest

from hapticd.base.core import StreamKind
from hapticd.config.configuration import load_config
from hapticd.daemon.counters import StreamCounters
from hapticd.daemon.dispatch import Dispatch
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.streams import NotInTurnError, Streams
from hapticd.hid.replay import Recording, save
from hapticd.protocol import messages
from hapticd.protocol import streams as wire
from hapticd.protocol.messages import Code
from tests.support.hid_descriptors import Joystick

TIMEOUT_NS = 20_000_000
COUNTED = ("received", "late", "lost", "refused", "held")


class Servo:
    """Keeps the streamed values."""

    def __init__(self) -> None:
        self.taken: list[tuple[StreamKind, int, float, float]] = []

    def stream(self, kind: StreamKind, seq: int, x: float, y: float) -> None:
        self.taken.append((kind, seq, x, y))

    def stream_counters(self, kind: StreamKind) -> StreamCounters:
        mine = [each for each in self.taken if each[0] == kind]
        return StreamCounters(len(mine), 0, 0, 0, mine[-1][1] if mine else 0, 7, bool(mine))


class Bench:
    """Streams on a servo that keeps the values, with a clock that a test sets."""

    def __init__(self, hand: bool = True) -> None:
        self.servo = Servo()
        self.now_ns = 0
        self.streams = Streams(self.servo, hand, TIMEOUT_NS, lambda: self.now_ns)

    def send(self, sender: object, seq: int, kind: wire.Kind = "force", x: float = 1.0, y: float = 2.0) -> bool:
        """Send a notification of the usual form; return whether it was accepted at once."""
        return self.streams.take_body(sender, wire.write(kind, seq, x, y))

    def counted(self, kind: wire.Kind = "force") -> dict[str, Any]:
        status: Any = self.streams.status()[kind]
        return {name: status[name] for name in COUNTED if status[name]}

    def seqs(self) -> list[int]:
        return [seq for _, seq, _, _ in self.servo.taken]


def test_what_comes_in_turn_is_handed_over_and_told() -> None:
    bench = Bench()
    assert bench.send("a", 5, "target", 0.25, -0.5)
    assert bench.send("a", 0, "force", 3.0, -4.0)  # each kind has a separate order
    assert bench.servo.taken == [(StreamKind.TARGET, 5, 0.25, -0.5), (StreamKind.FORCE, 0, 3.0, -4.0)]
    assert bench.streams.target_m == (0.25, -0.5)
    assert bench.counted("target") == bench.counted("force") == {"received": 1}
    status: Any = bench.streams.status()
    assert (status["target"]["seq"], status["target"]["tick"], status["target"]["active"]) == (5, 7, True)


def test_before_the_first_one_there_is_neither_a_number_nor_a_tick() -> None:
    status: Any = Bench().streams.status()["force"]
    assert status["seq"] is None and status["tick"] is None and status["active"] is False


def test_gaps_are_counted_and_what_is_late_or_double_is_left_out() -> None:
    bench = Bench()
    assert bench.send("a", 10)
    assert bench.send("a", 14)
    for seq in (14, 12, 0):
        assert not bench.send("a", seq)  # the general decoder reports why, and counts
        with pytest.raises(NotInTurnError, match="above 14") as late:
            bench.streams.take("a", "force", seq, 0.0, 0.0)
        assert late.value.code == Code.INVALID_PARAMS
    assert bench.send("a", 15)
    assert bench.seqs() == [10, 14, 15]
    assert bench.counted() == {"received": 6, "late": 3, "lost": 3}


def test_a_stream_stands_until_it_timed_out_and_then_another_begins_at_any_number() -> None:
    bench = Bench()
    assert bench.send("a", 1000)
    bench.now_ns += TIMEOUT_NS - 1
    assert not bench.send("b", 2000)
    with pytest.raises(NotInTurnError, match="sent nothing for 20 ms") as held:
        bench.streams.take("b", "force", 2000, 0.0, 0.0)
    assert (held.value.code, held.value.data) == (Code.STREAM_HELD, {"free_s": 1e-9})
    assert bench.send("b", 1, "target")  # the other kind is free
    bench.now_ns += 1
    assert bench.send("b", 3)
    assert not bench.send("a", 1001)
    bench.now_ns += TIMEOUT_NS
    assert bench.send("a", 0)
    assert bench.counted() == {"received": 4, "held": 1}
    assert bench.counted("target") == {"received": 1}


def test_the_same_sender_begins_anew_after_the_timeout_and_not_before() -> None:
    bench = Bench()
    assert bench.send("a", 100)
    bench.now_ns += TIMEOUT_NS - 1
    assert not bench.send("a", 3)
    bench.now_ns += 1
    assert bench.send("a", 3)
    assert bench.counted() == {"received": 2}  # nothing is lost between two streams


def test_what_is_late_or_held_does_not_keep_a_stream_alive() -> None:
    bench = Bench()
    assert bench.send("a", 7)
    for _ in range(4):
        bench.now_ns += TIMEOUT_NS // 4
        for sender in "ab" if bench.now_ns < TIMEOUT_NS else "":
            assert not bench.send(sender, 7)
    assert bench.send("b", 7)


@pytest.mark.parametrize(
    ("kind", "x", "y"),
    [
        ("force", math.nan, 0.0),
        ("force", 0.0, math.nan),
        ("force", math.inf, 0.0),
        ("force", 0.0, -math.inf),
        ("force", 100.1, 0.0),
        ("target", 0.0, 10.1),
        ("target", -1e300, 0.0),
    ],
)
def test_what_is_no_number_or_out_of_range_never_reaches_the_servo(kind: wire.Kind, x: float, y: float) -> None:
    bench = Bench()
    assert not bench.send("a", 1, kind, x, y)
    assert bench.servo.taken == []


def test_a_number_above_the_largest_is_left_to_the_ordinary_way() -> None:
    bench = Bench()
    body = msgpack.packb(
        {
            "jsonrpc": "2.0",
            "method": "stream_force",
            "params": {"seq": wire.MAX_SEQ + 1, "force_n": [0.0, 0.0]},
        }
    )
    assert not bench.streams.take_body("a", body)
    assert bench.send("a", wire.MAX_SEQ)


def test_without_a_simulated_hand_no_target_is_taken_and_forces_are() -> None:
    bench = Bench(hand=False)
    assert not bench.send("a", 1, "target")
    assert bench.send("a", 1, "force")
    bench.streams.refused("stream_target")
    assert bench.counted("target") == {"received": 1, "refused": 1}


def test_a_device_with_a_hand_of_its_own_takes_forces_and_no_targets(tmp_path: Path) -> None:
    """A replay is like a HID device. A message with an id gets the reason; each message is counted."""
    path = str(tmp_path / "stick.jsonl")
    save(path, Recording("stick", 0x1209, 0x5AFF, bytes(Joystick()), ((0.0, struct.pack("<BhhB", 1, 0, 0, 0)),)), False)
    config = {"servo": {"realtime": "off"}, "device": {"kind": "replay", "replay": {"path": path}}}
    engine = Engine(load_config(config))
    methods = Methods(engine)
    dispatch, answers = Dispatch(methods), list[Any]()
    for body in (
        wire.write("target", 1, 0.0, 0.0),
        messages.request(1, "stream_target", {"seq": 2, "position_m": [0, 0]}),
        wire.write("force", 1, 0.0, 0.5),
        messages.request(2, "stream_force", {"seq": 2, "force_n": [0, 0.5]}),
    ):
        dispatch.take(body, lambda answer: answers.append(msgpack.unpackb(bytes(answer))), "a")
    engine.start()
    engine.stop()
    refused, taken = answers
    assert (refused["id"], refused["error"]["code"]) == (1, messages.Code.NO_OPERATOR)
    assert "device.kind is replay" in refused["error"]["message"]
    assert taken["result"]["forces"] == "off" and "warning" in taken["result"]
    status: Any = methods.status()["streams"]
    assert (status["target"]["received"], status["target"]["refused"]) == (2, 2)
    assert (status["force"]["received"], status["force"]["refused"]) == (2, 0)
    # The status is the same whether streams are among the lasting or the changing members.
    assert methods.call("get_status", {})["streams"] == status
