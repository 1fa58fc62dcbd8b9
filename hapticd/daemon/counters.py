"""What the servo counts and reports of itself, as Python reads it from the structs of csrc/api/hd_api.h."""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from hapticd.base.core import HISTOGRAM_EDGES_NS, CData, Fault, StreamKind, ffi, lib
from hapticd.config.configuration import Servo
from hapticd.hid.signs import SignsStatus

_NO_FAULT: Final = Fault(0)
_MEMORY_KINDS: Final = ("none", "servo", "process")


@dataclass(frozen=True, slots=True)
class Granted:
    """What the machine gave of what the servo asked for; `missing` says in words what it did not."""

    scheduler: Literal["fifo", "other"]
    priority: int
    cpu: int | None
    memory: str
    awake: bool
    missing: tuple[str, ...]

    @classmethod
    def of(cls, grant: CData, servo: Servo, awake: bool, missing: Sequence[str]) -> Granted:
        """From a `struct hd_grant` and what else was asked for."""
        return cls(
            scheduler="fifo" if grant.priority else "other",
            priority=grant.priority,
            cpu=None if grant.affinity else servo.cpu,
            memory=_MEMORY_KINDS[grant.memory_kind],
            awake=awake,
            missing=tuple(missing),
        )

    def to_dict(self) -> dict[str, object]:
        return {
            "scheduler": self.scheduler,
            "priority": self.priority,
            "cpu": self.cpu,
            "memory_locked": self.memory,
            "idle_states_held": self.awake,
            "missing": list(self.missing),
        }


def missing_of(grant: CData, servo: Servo) -> list[str]:
    """What a `struct hd_grant` lacks of what was asked for, in words."""
    missing = []
    if grant.scheduler:
        missing.append(f"SCHED_FIFO priority {servo.priority}: {os.strerror(grant.scheduler)}")
    if grant.affinity:
        missing.append(f"processor {servo.cpu}: {os.strerror(grant.affinity)}")
    if grant.memory:
        kept = "only the servo's memory is locked" if grant.memory_kind else "nothing is locked"
        missing.append(f"locked memory: {os.strerror(grant.memory)} ({kept})")
    return missing


class Histogram(NamedTuple):
    """How often a time was how long: counts[0] below the first edge, counts[i] from edge i - 1 on and below edge i."""

    edges_ns: tuple[int, ...]
    counts: list[int]
    sum_ns: int
    max_ns: int

    def to_dict(self) -> dict[str, object]:
        return {"edges": list(self.edges_ns), "counts": self.counts, "sum": self.sum_ns, "max": self.max_ns}


class Counters(NamedTuple):
    """What the servo has counted since it started."""

    ticks: int
    skipped: int
    overruns: int
    samples_dropped: int
    events_dropped: int
    strikes: int
    glitches: int
    saturations: int
    overloads: int
    """Seconds in which more periods than the threshold were missed."""
    suspends: int
    """Times that the machine was suspended."""
    revision: int
    latched: int
    """`faults` as a number."""
    forces_on: bool
    running: bool
    memory_refused: int
    """errno: the scene has grown beyond what may be locked; 0: memory is as granted."""
    overloaded: bool
    """The servo thread ended, or is about to, so that it can go on at a lower rate."""
    missed_share: float
    """Part of the periods of the last whole second that were missed."""
    signs_word: int
    energy_j: float
    """What touched objects gave to the hand in this contact, or in the last one, as far as the passivity observer saw
    it; below zero: the hand gave more than it got."""
    largest_j: float
    """The largest so far in any contact."""
    contacts: int
    """From the first touch to the last release."""
    restrained: int
    """Of them, those in which the controller acted."""
    acted: int
    """Ticks in which it did."""

    @property
    def faults(self) -> Fault:
        """Those that are latched."""
        return Fault(self.latched) if self.latched else _NO_FAULT

    @property
    def signs(self) -> SignsStatus:
        """The check of a HID device's signs."""
        return SignsStatus.read(self.signs_word)


class StreamCounters(NamedTuple):
    """Of a stream of targets or forces; all that were sent are used or superseded."""

    used: int
    superseded: int
    """Those that a newer one took the place of before a tick could take them."""
    limited: int
    """Of those used, those that could not be followed as they were meant: too large, too fast."""
    timeouts: int
    """Times that none came for `servo.stream_timeout_s`."""
    seq: int
    """Of the last one that was used, by the tick `tick`; both 0 before the first."""
    tick: int
    active: bool
    """One came within `servo.stream_timeout_s`."""


TOTALS: Final = Counters._fields[: Counters._fields.index("suspends") + 1]
"""Those that only grow, as `get_status` names them."""

# All members in one call: one by one, through cffi, they would be a third of a status.
_RECORD: Final = struct.Struct("<10Q2I?3x?3xI?3xdI4x2d3Q")
if _RECORD.size != ffi.sizeof("struct hd_counters"):
    raise ImportError("the record of hapticd.daemon.counters is not that of csrc/api/hd_api.h")


def read_counters(servo: CData) -> Counters:
    """Those of a `struct hd_servo`. For any thread."""
    raw = ffi.new("struct hd_counters *")
    lib.hd_servo_counters(servo, raw)
    return Counters._make(_RECORD.unpack(ffi.buffer(raw)))


_STREAM: Final = struct.Struct("<6Q?7x")
if _STREAM.size != ffi.sizeof("struct hd_stream_counters"):
    raise ImportError("the record of hapticd.daemon.counters is not that of csrc/api/hd_api_servo.h")


def read_stream_counters(servo: CData, kind: StreamKind) -> StreamCounters:
    """Those of one stream of a `struct hd_servo`. For any thread."""
    raw = ffi.new("struct hd_stream_counters *")
    lib.hd_servo_stream_counters(servo, kind, raw)
    return StreamCounters._make(_STREAM.unpack(ffi.buffer(raw)))


def read_histograms(servo: CData) -> tuple[Histogram, Histogram]:
    """Of lateness and of work, since the start. For any thread."""
    raw = ffi.new("struct hd_histograms *")
    lib.hd_servo_histograms(servo, raw)
    return _histogram_of(raw.lateness), _histogram_of(raw.work)


def _histogram_of(raw: CData) -> Histogram:
    counts: list[int] = ffi.unpack(raw.counts, len(HISTOGRAM_EDGES_NS) + 1)
    return Histogram(HISTOGRAM_EDGES_NS, counts, raw.sum_ns, raw.max_ns)
