"""What the servo counts and reports of itself, as Python reads it from the structs of csrc/api/hd_api.h."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from hapticd.base.core import HISTOGRAM_EDGES_NS, CData, Fault, ffi, lib
from hapticd.hid.signs import SignsStatus

_NO_FAULT: Final = Fault(0)


@dataclass(frozen=True, slots=True)
class Granted:
    """What the machine gave of what the servo asked for; `missing` says in words what it did not."""

    scheduler: Literal["fifo", "other"]
    priority: int
    cpu: int | None
    memory: str
    awake: bool
    missing: tuple[str, ...]

    def to_dict(self) -> dict[str, object]:
        return {
            "scheduler": self.scheduler,
            "priority": self.priority,
            "cpu": self.cpu,
            "memory_locked": self.memory,
            "idle_states_held": self.awake,
            "missing": list(self.missing),
        }


class Energy(NamedTuple):
    """What the touched objects gave to the hand, as far as the passivity observer saw it."""

    energy_j: float
    """In this contact, or in the last one; below zero: the hand gave more than it got."""
    largest_j: float
    """The largest so far in any contact."""
    contacts: int
    """From the first touch to the last release."""
    restrained: int
    """Of them, those in which the controller acted."""
    acted: int
    """Ticks in which it did."""


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
    faults: Fault
    forces_on: bool
    running: bool
    memory_refused: int
    """errno: the scene has grown beyond what may be locked; 0: memory is as granted."""
    overloaded: bool
    """The servo thread ended, or is about to, so that it can go on at a lower rate."""
    missed_share: float
    """Part of the periods of the last whole second that were missed."""
    signs_word: int
    energy: Energy
    """As of the last tick that was observed."""

    @property
    def signs(self) -> SignsStatus:
        """The check of a HID device's signs."""
        return SignsStatus.read(self.signs_word)


TOTALS: Final = Counters._fields[: Counters._fields.index("suspends") + 1]
"""Those that only grow, as `get_status` names them."""


def read_counters(servo: CData) -> Counters:
    """Those of a `struct hd_servo`. For any thread."""
    raw = ffi.new("struct hd_counters *")
    lib.hd_servo_counters(servo, raw)
    return Counters(
        raw.ticks,
        raw.skipped,
        raw.overruns,
        raw.samples_dropped,
        raw.events_dropped,
        raw.strikes,
        raw.glitches,
        raw.saturations,
        raw.overloads,
        raw.suspends,
        raw.revision,
        Fault(raw.faults) if raw.faults else _NO_FAULT,
        bool(raw.forces_on),
        bool(raw.running),
        raw.memory_refused,
        bool(raw.overloaded),
        raw.missed_share,
        raw.signs,
        energy_of(raw.energy),
    )


def energy_of(raw: CData) -> Energy:
    """A `struct hd_energy`."""
    return Energy(raw.energy_j, raw.largest_j, raw.contacts, raw.restrained, raw.acted)


def read_faults(servo: CData) -> Fault:
    """The faults that are latched. For any thread."""
    raw = ffi.new("struct hd_counters *")
    lib.hd_servo_counters(servo, raw)
    return Fault(raw.faults) if raw.faults else _NO_FAULT


def read_histograms(servo: CData) -> tuple[Histogram, Histogram]:
    """Of lateness and of work, since the start. For any thread."""
    raw = ffi.new("struct hd_histograms *")
    lib.hd_servo_histograms(servo, raw)
    return _histogram_of(raw.lateness), _histogram_of(raw.work)


def _histogram_of(raw: CData) -> Histogram:
    counts: list[int] = ffi.unpack(raw.counts, len(HISTOGRAM_EDGES_NS) + 1)
    return Histogram(HISTOGRAM_EDGES_NS, counts, raw.sum_ns, raw.max_ns)
