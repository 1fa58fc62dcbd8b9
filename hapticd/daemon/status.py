"""The result of `get_status`, which is also the message of the topic `status`.

Most members rarely change: their encoding is kept until they do.
"""

from __future__ import annotations

import os
from dataclasses import asdict
from time import monotonic_ns

from hapticd._version import __version__
from hapticd.base import clock
from hapticd.base.codec import Encoded, Members
from hapticd.base.model import MAX_FAULTS
from hapticd.daemon.counters import TOTAL_COUNTER_NAMES, Counters, Granted
from hapticd.daemon.engine import Engine
from hapticd.daemon.flight_recorder import Flight
from hapticd.daemon.lease import Lease
from hapticd.daemon.streams import Streams
from hapticd.protocol.events import fault_names
from hapticd.protocol.messages import PROTOCOL_VERSION


class Status:
    """Reports the status of one engine and of its lease, streams and flight recorder. For any thread."""

    def __init__(self, engine: Engine, lease: Lease, flight: Flight | None, streams: Streams) -> None:
        """Report the status of these objects; the daemon's start time is now."""
        self._engine, self._lease, self._flight = engine, lease, flight
        self._streams = streams
        self._started_ns = monotonic_ns()
        self._limits: tuple[tuple[int, int], dict[str, object]] = ((0, 0), {})
        self._encoded: tuple[tuple[object, ...], Members] = ((), Members(0, b""))
        servo = engine.config.servo
        self._overruns = {**servo.overruns.to_dict(), "configured_rate_hz": servo.rate_hz}

    def report(self) -> dict[str, object]:
        """Return all members of the status."""
        counters = self._engine.counters()
        return {**self._lasting(counters), **self._changing(counters), **self._detail()}

    def encoded(self, detail: bool) -> Encoded:
        """Return the encoded members of the status for an answer; histograms, which are long, only with `detail`."""
        counters = self._engine.counters()
        known, lasting = self._encoded
        state = self._state(counters)
        if known != state:
            lasting = Members.of(self._lasting(counters))
            self._encoded = state, lasting
        changing = self._changing(counters)
        if detail:
            changing |= self._detail()
        return Encoded((lasting.joined(changing),))

    def _state(self, counters: Counters) -> tuple[object, ...]:
        """Return the values on which `_lasting` depends: while none changes, its encoding is used again."""
        engine, flight = self._engine, self._flight
        return (
            engine.revision,
            engine.offload_version,
            engine.operator_version,
            counters.memory_refused,
            0 if flight is None else flight.version,
            engine.granted,
            self._streams.received > 0,
        )

    def _lasting(self, counters: Counters) -> dict[str, object]:
        """Return the members that rarely change."""
        engine, flight = self._engine, self._flight
        granted = engine.granted
        return {
            "version": __version__,
            "protocol": PROTOCOL_VERSION,
            "started_ns": self._started_ns,
            "device": engine.config.device.kind,
            "rate_hz": engine.rate_hz,
            "realtime": None if granted is None else _realtime(granted, counters),
            "revision": engine.revision,
            "flight": None if flight is None else flight.status(),
            **self._find_limits(),
            "operator": engine.operator(),
            **({} if self._streams.received else {"streams": self._streams.status()}),
        }

    def _changing(self, counters: Counters) -> dict[str, object]:
        engine = self._engine
        connection, moment = engine.connection, clock.read()
        # Until the first streamed message, `streams` is among the members that rarely change.
        streams = {"streams": self._streams.status()} if self._streams.received else {}
        return {
            **streams,
            "clock": {"monotonic_ns": moment.monotonic_ns, "realtime_ns": moment.realtime_ns},
            "state": "running" if counters.running else "stopped",
            "connection": None if connection is None else {**connection.status(), "signs": counters.signs.to_dict()},
            "tick": counters.ticks,
            "forces": "faulted" if counters.latched else "on" if counters.forces_on else "off",
            "faults": fault_names(counters.faults) if counters.latched else [],
            "lease_s": self._lease.remaining_s,
            "counters": dict(zip(TOTAL_COUNTER_NAMES, counters)),  # noqa: B905 - the others are not totals
            "overruns": {**self._overruns, "missed_share": counters.missed_share},
            "passivity": {
                "mode": engine.scene.passivity,
                "energy_j": counters.energy_j,
                "largest_j": counters.largest_j,
                "contacts": counters.contacts,
                "restrained": counters.restrained,
                "acted": counters.acted,
            },
        }

    def _detail(self) -> dict[str, object]:
        lateness, work = self._engine.histograms()
        return {"histograms": {"lateness_ns": lateness.to_dict(), "work_ns": work.to_dict()}}

    def _find_limits(self) -> dict[str, object]:
        """Return the members `undisplayable`, `warnings`, `offload`, recomputed if scene or materials changed."""
        known, limits = self._limits
        state = (self._engine.revision, self._engine.offload_version)
        if known != state:
            undisplayable, warnings = self._engine.limits()
            limits = {
                "undisplayable": [asdict(mode) for mode in undisplayable],
                "warnings": [asdict(problem) for problem in warnings[:MAX_FAULTS]],
                "offload": [asdict(each) for each in self._engine.offloaded()[:MAX_FAULTS]],
            }
            self._limits = (state, limits)
        return limits


def _realtime(granted: Granted, counters: Counters) -> dict[str, object]:
    """Return the member `realtime`: the granted privileges, and locked memory that was refused later."""
    realtime = granted.to_dict()
    if counters.memory_refused:
        problem = f"locked memory for all objects: {os.strerror(counters.memory_refused)}"
        realtime["missing"] = [*granted.missing, problem]
    return realtime
