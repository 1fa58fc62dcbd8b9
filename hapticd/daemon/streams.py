"""Streamed targets and forces: the sender and the order of messages, and the counters of accepted and refused ones.

The connection that sends the first message owns the stream. The stream ends when no message came within the time-out.
The servo ends the stream (csrc/servo/hd_servo_streams.c), even if the command thread hangs. Only the command thread may
use this module; any thread may call `status`.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from time import monotonic_ns
from typing import Protocol

from hapticd.base.core import StreamKind
from hapticd.base.errors import Problem
from hapticd.daemon.counters import StreamCounters
from hapticd.daemon.refusal import MethodError
from hapticd.protocol import streams as wire
from hapticd.protocol.messages import Code
from hapticd.protocol.streams import MAX_COMPONENT_BY_KIND, Kind


class NotInTurnError(MethodError):
    """A valid message is refused, because another connection owns the stream or its sequence number is too low."""


class Servo(Protocol):
    """The methods of an engine that streams call. `stream` never blocks: a newer value replaces the previous one."""

    def stream(self, kind: StreamKind, seq: int, x: float, y: float) -> None:
        """Send the servo a new target of the hand or a new force; see Engine.stream."""

    def stream_counters(self, kind: StreamKind) -> StreamCounters:
        """Return the servo's counters of the stream of targets or of forces."""
        ...


class _Stream:
    """The stream of targets or of forces: its owner, its last sequence number, and its counters since the start."""

    __slots__ = ("accepted", "held", "kind", "last_ns", "late", "lost", "refused", "sender", "seq")

    def __init__(self, kind: StreamKind) -> None:
        self.kind = kind
        self.sender: object = None
        self.seq = 0
        self.last_ns = -inf  # no message came yet
        self.accepted = self.late = self.lost = self.held = self.refused = 0

    @property
    def received(self) -> int:
        return self.accepted + self.late + self.held + self.refused


class Streams:
    """The stream of targets and the stream of forces of one servo."""

    def __init__(self, servo: Servo, hand: bool, timeout_ns: int, clock: Callable[[], int] = monotonic_ns) -> None:
        """Send streamed targets and forces to `servo`.

        `hand`: whether the device has a simulated hand, which targets move. `timeout_ns`: time without a message, in
        nanoseconds, after which a stream ends.
        """
        self._servo, self._hand, self._timeout_ns, self._clock = servo, hand, timeout_ns, clock
        self._streams: dict[Kind, _Stream] = {
            "target": _Stream(StreamKind.TARGET),
            "force": _Stream(StreamKind.FORCE),
        }
        self.target_m: tuple[float, float] | None = None
        """The last target that was sent to the servo, in metres; None: none was sent since the last `set_operator`."""

    def take_body(self, sender: object, body: bytes) -> bool:
        """Accept a notification with a target or a force that is complete, valid and in sequence.

        Returns False for any other body and changes nothing. The caller then handles the body as a request, and reports
        and counts its mistake.
        """
        streamed = wire.read(body)
        if streamed is None:
            return False
        kind, seq, x, y = streamed
        limit = MAX_COMPONENT_BY_KIND[kind]
        # Comparisons with NaN are false.
        if not (-limit <= x <= limit and -limit <= y <= limit) or seq > wire.MAX_SEQ:
            return False
        if kind == "target" and not self._hand:
            return False
        stream, now_ns = self._streams[kind], self._clock()
        if self._is_under_way(stream, now_ns) and (stream.sender is not sender or seq <= stream.seq):
            return False
        self._hand_over(stream, sender, seq, now_ns, x, y)
        return True

    def refused(self, method: str) -> None:
        """Count an invalid message of the method `stream_target` or `stream_force`."""
        self._streams[wire.STREAM_KIND_BY_METHOD[method]].refused += 1

    def take(self, sender: object, kind: Kind, seq: int, x: float, y: float) -> None:
        """Send the target or force of a valid message to the servo.

        Raises NotInTurnError if another connection owns the stream, or if the sequence number is not above that of the
        last accepted message.
        """
        stream, now_ns = self._streams[kind], self._clock()
        if self._is_under_way(stream, now_ns):
            if stream.sender is not sender:
                stream.held += 1
                free_s = 1e-9 * (stream.last_ns + self._timeout_ns - now_ns)
                again = f"wait until it has sent nothing for {1e-6 * self._timeout_ns:g} ms"
                raise NotInTurnError(Code.STREAM_HELD, f"another client streams a {kind}; {again}", {"free_s": free_s})
            if seq <= stream.seq:
                stream.late += 1
                late = f"must be above {stream.seq}, the last of this stream, is {seq}"
                raise NotInTurnError.faulty([Problem("seq", late)])
        self._hand_over(stream, sender, seq, now_ns, x, y)

    def _is_under_way(self, stream: _Stream, now_ns: int) -> bool:
        return now_ns - stream.last_ns < self._timeout_ns

    def _hand_over(self, stream: _Stream, sender: object, seq: int, now_ns: int, x: float, y: float) -> None:
        """Send a target or force to the servo, count it, and make `sender` the owner of the stream."""
        missing = seq - stream.seq - 1 if self._is_under_way(stream, now_ns) else 0
        self._servo.stream(stream.kind, seq, x, y)
        stream.sender, stream.seq, stream.last_ns = sender, seq, now_ns
        stream.accepted += 1
        stream.lost += missing
        if stream.kind is StreamKind.TARGET:
            self.target_m = (x, y)

    # ---- Status ------------------------------------------------------------------------------------------------------

    @property
    def received(self) -> int:
        """Number of streamed targets and forces since the start. While this is 0, `status` does not change."""
        return sum(stream.received for stream in self._streams.values())

    def status(self) -> dict[str, object]:
        """Return the member `streams` of a status. For any thread."""
        return {kind: self._status(stream) for kind, stream in self._streams.items()}

    def _status(self, stream: _Stream) -> dict[str, object]:
        servo = self._servo.stream_counters(stream.kind)
        return {
            "active": servo.active,
            "seq": servo.seq if servo.used else None,
            "tick": servo.tick if servo.used else None,
            "received": stream.received,
            "used": servo.used,
            "superseded": servo.superseded,
            "late": stream.late,
            "lost": stream.lost,
            "refused": stream.refused,
            "held": stream.held,
            "limited": servo.limited,
            "timeouts": servo.timeouts,
        }
