"""What Prometheus gets, in its text format 0.0.4: the daemon's status and the bridge's own counters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from hapticd.bridge.accounts import Account
from hapticd.bridge.daemon_link import DaemonLink
from hapticd.bridge.gate import Gate

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"

_COUNTERS: Final = {
    "ticks": ("hapticd_ticks_total", "Ticks rendered."),
    "skipped": ("hapticd_skipped_periods_total", "Periods of the servo that were missed."),
    "overruns": ("hapticd_overruns_total", "Times that periods were missed."),
    "samples_dropped": ("hapticd_samples_dropped_total", "Samples that found the daemon's ring full."),
    "events_dropped": ("hapticd_events_dropped_total", "Events that found the daemon's ring full."),
    "strikes": ("hapticd_strikes_total", "Modes struck."),
    "glitches": ("hapticd_glitches_total", "Jumps of the position."),
    "overloads": ("hapticd_overloads_total", "Seconds in which more periods than the threshold were missed."),
    "suspends": ("hapticd_suspends_total", "Times that the machine was suspended."),
    "saturations": ("hapticd_saturations_total", "Times that the force limit was reached."),
}
_HISTOGRAMS: Final = {
    "lateness_ns": ("hapticd_lateness_seconds", "How late the servo woke after its deadline."),
    "work_ns": ("hapticd_work_seconds", "From the servo's wake-up until the force was handed over."),
}
_ESCAPES: Final = str.maketrans({"\\": r"\\", "\n": r"\n", '"': r"\""})

Value = int | float
Sample = tuple[str, Mapping[str, str], Value]
"""Suffix of the name, labels, value."""


@dataclass(frozen=True)
class Family:
    """One metric with all its samples."""

    name: str
    kind: str
    help: str
    samples: Iterable[Sample]

    def lines(self) -> Iterator[str]:
        yield f"# HELP {self.name} {self.help}\n"
        yield f"# TYPE {self.name} {self.kind}\n"
        for suffix, labels, value in self.samples:
            inner = ",".join(f'{key}="{text.translate(_ESCAPES)}"' for key, text in labels.items())
            yield f"{self.name}{suffix}{f'{{{inner}}}' if inner else ''} {_number(value)}\n"


def _number(value: Value) -> str:
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        return "+Inf" if value > 0 else "-Inf"
    return repr(value)


class Metrics:
    """Makes the text; remembers which faults there were, so that one that was cleared reads 0."""

    def __init__(self, link: DaemonLink, gate: Gate) -> None:
        self._link, self._gate = link, gate
        self._faults: dict[str, None] = {}

    def text(self) -> str:
        """All metrics as they are now."""
        status = self._link.status
        families = [_one("hapticd_up", "gauge", "Whether the daemon tells its status.", int(status is not None))]
        if status is not None:
            families += self._daemon(status)
        families += self._bridge()
        return "".join(line for family in families for line in family.lines())

    def _daemon(self, status: Mapping[str, Any]) -> Iterator[Family]:
        labels = {key: str(status[key]) for key in ("version", "protocol", "device")}
        yield Family("hapticd_info", "gauge", "What the daemon is.", [("", labels, 1)])
        for key, (name, text) in _COUNTERS.items():
            if key in status["counters"]:
                yield _one(name, "counter", text, status["counters"][key])
        yield _one("hapticd_running", "gauge", "Whether the servo runs.", int(status["state"] == "running"))
        yield _one("hapticd_rate_hertz", "gauge", "Ticks a second that the servo is to render.", status["rate_hz"])
        yield _one("hapticd_scene_revision", "gauge", "Revision of the scene.", status["revision"])
        forces = [("", {"state": state}, int(status["forces"] == state)) for state in ("on", "off", "faulted")]
        yield Family("hapticd_forces", "gauge", "What the forces are.", forces)
        latched = status["faults"]
        self._faults.update(dict.fromkeys(latched))
        yield _one("hapticd_faults", "gauge", "How many faults are latched.", len(latched))
        if self._faults:
            faults = [("", {"fault": fault}, int(fault in latched)) for fault in self._faults]
            yield Family("hapticd_fault", "gauge", "Faults that were latched since the bridge started.", faults)
        yield _one("hapticd_lease_held", "gauge", "Whether a lease runs.", int(status["lease_s"] is not None))
        fifo = (status["realtime"] or {}).get("scheduler") == "fifo"
        yield _one("hapticd_realtime", "gauge", "Whether the servo has SCHED_FIFO.", int(fifo))
        histograms = status.get("histograms") or {}
        for key, (name, text) in _HISTOGRAMS.items():
            if key in histograms:
                yield Family(name, "histogram", text, list(_histogram(histograms[key])))

    def _bridge(self) -> Iterator[Family]:
        gate = self._gate
        accounts = list(gate.accounts.all())
        yield _one("hapticd_bridge_connections_total", "counter", "Connections taken.", gate.accepted)
        refused = [("", {"reason": reason}, count) for reason, count in sorted(gate.refused.items())]
        yield Family("hapticd_bridge_refused_total", "counter", "Connections refused or ended.", refused)

        def each(name: str, kind: str, text: str, value: Any) -> Family:
            samples: list[Sample] = [("", {"client": account.name}, value(account)) for account in accounts]
            return Family(f"hapticd_bridge_{name}", kind, text, samples)

        yield each("client_connections", "gauge", "Connections of a client.", lambda a: a.connections)
        yield each("requests_total", "counter", "Requests of a client.", lambda a: a.asked)
        yield each("streamed_total", "counter", "Targets and forces that a client streamed.", lambda a: a.streamed)
        yield each(
            "streams_dropped_total",
            "counter",
            "Targets and forces over the limit, or without a daemon.",
            lambda a: a.streams_dropped,
        )
        yield each("received_bytes_total", "counter", "Bytes that came from a client.", lambda a: a.taken_bytes)
        yield each(
            "telemetry_dropped_total",
            "counter",
            "Messages of telemetry that a client did not read in time.",
            lambda a: a.telemetry_dropped,
        )
        waited = list(_waited(accounts))
        yield Family("hapticd_bridge_limited_seconds_total", "counter", "How long a limit let a client wait.", waited)


def _one(name: str, kind: str, text: str, value: Value) -> Family:
    return Family(name, kind, text, [("", {}, value)])


def _waited(accounts: Iterable[Account]) -> Iterator[Sample]:
    for account in accounts:
        for limit, waited_s in account.waited_s.items():
            yield "", {"client": account.name, "limit": limit}, waited_s


def _histogram(histogram: Mapping[str, Any]) -> Iterator[Sample]:
    """From upper edges in ns and the counts between them (the last one beyond the last edge) to cumulative buckets."""
    edges, counts = histogram["edges"], histogram["counts"]
    total = 0
    for edge, count in zip([*(edge / 1e9 for edge in edges), float("inf")], counts, strict=True):
        total += count
        yield "_bucket", {"le": _number(float(edge))}, total
    if "sum" in histogram:
        yield "_sum", {}, histogram["sum"] / 1e9
    yield "_count", {}, total
