"""Figures for Prometheus: the daemon's newest status, in the text format that prometheus-client writes."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, cast

from prometheus_client import start_http_server
from prometheus_client.core import (
    CollectorRegistry,
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from hapticd.base.errors import HapticdError
from hapticd.protocol import messages
from hapticd.web.telemetry_hub import TelemetryHub

LOCAL_ADDRESS: Final = "127.0.0.1"
"""No other machine gets the figures: they are not encrypted."""

_log = logging.getLogger("hapticd.web")

_COUNTERS: Final = {
    "ticks": ("hapticd_ticks", "Ticks rendered."),
    "skipped": ("hapticd_skipped_periods", "Periods of the servo that were missed."),
    "overruns": ("hapticd_overruns", "Times that periods were missed."),
    "samples_dropped": ("hapticd_samples_dropped", "Samples that found the daemon's ring full."),
    "events_dropped": ("hapticd_events_dropped", "Events that found the daemon's ring full."),
    "strikes": ("hapticd_strikes", "Modes struck."),
    "glitches": ("hapticd_glitches", "Jumps of the position."),
    "overloads": ("hapticd_overloads", "Seconds in which more periods than the threshold were missed."),
    "suspends": ("hapticd_suspends", "Times that the machine was suspended."),
    "saturations": ("hapticd_saturations", "Times that the force limit was reached."),
}
_HISTOGRAMS: Final = {
    "lateness_ns": ("hapticd_lateness_seconds", "How late the servo woke after its deadline."),
    "work_ns": ("hapticd_work_seconds", "From the servo's wake-up until the force was handed over."),
}


class DaemonCollector(Collector):
    """Metrics of the newest status. It is asked by a thread of the server."""

    def __init__(self) -> None:
        self._hub: TelemetryHub | None = None
        self._newest: bytes | None = None

    def follow(self, hub: TelemetryHub) -> None:
        """From now on the figures are those of the hub's daemon."""
        self._hub = hub
        hub.subscribe(self, frozenset({"status"}))

    def telemetry(self, topic: str, message: bytes) -> None:
        """A status as the hub passes it on: [topic, status]."""
        self._newest = message

    def collect(self) -> Iterator[Metric]:
        """All metrics as they are now; `hapticd_up` alone where no daemon is there."""
        newest = self._newest
        up = self._hub is not None and self._hub.daemon and newest is not None
        yield GaugeMetricFamily("hapticd_up", "Whether a daemon is there.", int(up))
        if up and newest is not None:
            _, status = cast("tuple[str, Mapping[str, Any]]", messages.decode_trusted(newest))
            yield from _of_status(status)


def _of_status(status: Mapping[str, Any]) -> Iterator[Metric]:
    info = GaugeMetricFamily("hapticd_info", "What the daemon is.", labels=("version", "protocol", "device"))
    info.add_metric([str(status[key]) for key in ("version", "protocol", "device")], 1)
    yield info
    for key, (name, text) in _COUNTERS.items():
        if key in status["counters"]:
            yield CounterMetricFamily(name, text, status["counters"][key])
    yield GaugeMetricFamily("hapticd_running", "Whether the servo runs.", int(status["state"] == "running"))
    yield GaugeMetricFamily("hapticd_rate_hertz", "Ticks a second that the servo is to render.", status["rate_hz"])
    yield GaugeMetricFamily("hapticd_scene_revision", "Revision of the scene.", status["revision"])
    forces = GaugeMetricFamily("hapticd_forces", "The state of the forces.", labels=("state",))
    for state in ("on", "off", "faulted"):
        forces.add_metric([state], int(status["forces"] == state))
    yield forces
    faults = GaugeMetricFamily("hapticd_fault", "Faults that are latched.", labels=("fault",))
    for fault in status["faults"]:
        faults.add_metric([fault], 1)
    yield faults
    yield GaugeMetricFamily("hapticd_lease_held", "Whether a lease runs.", int(status["lease_s"] is not None))
    fifo = (status["realtime"] or {}).get("scheduler") == "fifo"
    yield GaugeMetricFamily("hapticd_realtime", "Whether the servo has SCHED_FIFO.", int(fifo))
    for key, (name, text) in _HISTOGRAMS.items():
        histogram = status["histograms"][key]
        yield HistogramMetricFamily(name, text, _buckets(histogram), sum_value=histogram["sum"] / 1e9)


def _buckets(histogram: Mapping[str, Any]) -> Sequence[tuple[str, float]]:
    """From upper edges in ns and the counts between them to cumulative buckets in s; the last has no upper edge."""
    total, buckets = 0, []
    for edge, count in zip([*histogram["edges"], float("inf")], histogram["counts"], strict=True):
        total += count
        buckets.append(("+Inf" if edge == float("inf") else repr(edge / 1e9), float(total)))
    return buckets


@contextmanager
def served(port: int) -> Iterator[DaemonCollector]:
    """Answers Prometheus at `port` of this machine, 0: a free one. Raises HapticdError where the port cannot be had."""
    collector, registry = DaemonCollector(), CollectorRegistry(auto_describe=False)
    registry.register(collector)
    try:
        server, thread = start_http_server(port, LOCAL_ADDRESS, registry)
    except OSError as error:
        raise HapticdError(f"--metrics {port}: {error.strerror}") from None
    _log.info("metrics at http://%s:%d/metrics", LOCAL_ADDRESS, server.server_port)
    try:
        yield collector
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
