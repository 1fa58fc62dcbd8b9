"""The servo's counters, histograms and granted privileges, read from the structs of csrc/api/."""

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
    """The scheduling and memory privileges that the servo got; `missing` describes those that were refused."""

    scheduler: Literal["fifo", "other"]
    priority: int
    cpu: int | None
    memory: str
    idle_states_held: bool
    missing: tuple[str, ...]

    @classmethod
    def of(cls, grant: CData, servo: Servo, idle_states_held: bool, missing: Sequence[str]) -> Granted:
        """Combine a `struct hd_grant`, the processor in `servo`, the idle-state lock and the missing privileges."""
        return cls(
            scheduler="fifo" if grant.priority else "other",
            priority=grant.priority,
            cpu=None if grant.affinity else servo.cpu,
            memory=_MEMORY_KINDS[grant.memory_kind],
            idle_states_held=idle_states_held,
            missing=tuple(missing),
        )

    def to_dict(self) -> dict[str, object]:
        """Return the member `realtime` of a status."""
        return {
            "scheduler": self.scheduler,
            "priority": self.priority,
            "cpu": self.cpu,
            "memory_locked": self.memory,
            "idle_states_held": self.idle_states_held,
            "missing": list(self.missing),
        }


def missing_of(grant: CData, servo: Servo) -> list[str]:
    """Return a line for each configured privilege that was refused according to `grant`, a `struct hd_grant`."""
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
    """A histogram: counts[i] counts times t with edges_ns[i - 1] <= t < edges_ns[i]; the outer bins are unbounded."""

    edges_ns: tuple[int, ...]
    counts: list[int]
    sum_ns: int
    max_ns: int

    def to_dict(self) -> dict[str, object]:
        """Return the histogram as a map for the result of `get_status`, with bin edges in ns."""
        return {"edges": list(self.edges_ns), "counts": self.counts, "sum": self.sum_ns, "max": self.max_ns}


class Counters(NamedTuple):
    """The servo's counters since its start, and its state."""

    ticks: int
    skipped: int
    overruns: int
    samples_dropped: int
    events_dropped: int
    strikes: int
    glitches: int
    saturations: int
    overloads: int
    """Number of seconds in which the servo missed more periods than the threshold in `servo.overruns`."""
    suspends: int
    """Number of times that the machine was suspended."""
    revision: int
    latched: int
    """The latched faults as bits, which `faults` decodes."""
    forces_on: bool
    running: bool
    memory_refused: int
    """errno of the last attempt to lock memory for a grown scene; 0: memory is locked as granted."""
    overloaded: bool
    """Whether an overload has ended the servo thread, or is about to; it is then restarted at a lower rate."""
    missed_share: float
    """Fraction of the periods of the last complete second that were missed."""
    signs_word: int
    energy_j: float
    """Energy given to the hand in the current or last contact (passivity observer). Negative: the hand gave more."""
    largest_j: float
    """The largest `energy_j` of any contact."""
    contacts: int
    """Number of contacts, each from the first touch to the last release."""
    restrained: int
    """Number of contacts in which the passivity controller acted."""
    acted: int
    """Number of ticks in which the passivity controller acted."""

    @property
    def faults(self) -> Fault:
        """The latched faults: those that keep the forces off until forces are turned on again."""
        return Fault(self.latched) if self.latched else _NO_FAULT

    @property
    def signs(self) -> SignsStatus:
        """State of the check that a HID device's force along an axis moves the handle in the same direction."""
        return SignsStatus.read(self.signs_word)


class StreamCounters(NamedTuple):
    """Counters of a stream of targets or forces. Each value that the servo got is counted as used or superseded."""

    used: int
    superseded: int
    """Values that a newer one replaced before a tick took them."""
    limited: int
    """Used values that the servo could not follow exactly because they were too large or changed too fast."""
    timeouts: int
    """Number of times that no value came for `servo.stream_timeout_s`."""
    seq: int
    """Sequence number of the last value that was used; 0 before the first."""
    tick: int
    """The tick that used the last value; 0 before the first."""
    active: bool
    """Whether a value came within `servo.stream_timeout_s`."""


TOTAL_COUNTER_NAMES: Final = Counters._fields[: Counters._fields.index("suspends") + 1]
"""Counters that only grow, as `get_status` names them."""

# Unpacks all members in one call: reading them one by one through cffi takes a third of the time of a status.
_COUNTERS_STRUCT: Final = struct.Struct("<10Q2I?3x?3xI?3xdI4x2d3Q")
if _COUNTERS_STRUCT.size != ffi.sizeof("struct hd_counters"):
    raise ImportError("hapticd/daemon/counters.py: size differs from struct hd_counters of csrc/api/hd_api.h")


def read_counters(servo: CData) -> Counters:
    """Read the counters of a `struct hd_servo`. For any thread."""
    raw = ffi.new("struct hd_counters *")
    lib.hd_servo_counters(servo, raw)
    return Counters._make(_COUNTERS_STRUCT.unpack(ffi.buffer(raw)))


_STREAM_COUNTERS_STRUCT: Final = struct.Struct("<6Q?7x")
if _STREAM_COUNTERS_STRUCT.size != ffi.sizeof("struct hd_stream_counters"):
    raise ImportError("hapticd/daemon/counters.py: size differs from struct hd_stream_counters of hd_api_servo.h")


def read_stream_counters(servo: CData, kind: StreamKind) -> StreamCounters:
    """Read the counters of one stream of a `struct hd_servo`. For any thread."""
    raw = ffi.new("struct hd_stream_counters *")
    lib.hd_servo_stream_counters(servo, kind, raw)
    return StreamCounters._make(_STREAM_COUNTERS_STRUCT.unpack(ffi.buffer(raw)))


def read_histograms(servo: CData) -> tuple[Histogram, Histogram]:
    """Read the histograms of the ticks' lateness and work time since the servo's start. For any thread."""
    raw = ffi.new("struct hd_histograms *")
    lib.hd_servo_histograms(servo, raw)
    return _histogram_of(raw.lateness), _histogram_of(raw.work)


def _histogram_of(raw: CData) -> Histogram:
    counts: list[int] = ffi.unpack(raw.counts, len(HISTOGRAM_EDGES_NS) + 1)
    return Histogram(HISTOGRAM_EDGES_NS, counts, raw.sum_ns, raw.max_ns)
