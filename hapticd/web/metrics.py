"""Metrics for Prometheus: the daemon's newest status, in the text format of prometheus-client."""

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
"""The address of the metrics: this machine only, because metrics are sent without encryption."""

_log = logging.getLogger("hapticd.web")

_COUNTER_METRICS: Final = {
    "ticks": ("hapticd_ticks", "Ticks rendered."),
    "skipped": ("hapticd_skipped_periods", "Periods of the servo that were missed."),
    "overruns": ("hapticd_overruns", "Number of times that periods were missed."),
    "samples_dropped": ("hapticd_samples_dropped", "Samples lost because the daemon's ring was full."),
    "events_dropped": ("hapticd_events_dropped", "Events lost because the daemon's ring was full."),
    "strikes": ("hapticd_strikes", "Modes struck."),
    "glitches": ("hapticd_glitches", "Jumps of the position."),
    "overloads": ("hapticd_overloads", "Seconds in which more periods than the threshold were missed."),
    "suspends": ("hapticd_suspends", "Number of times that the machine was suspended."),
    "saturations": ("hapticd_saturations", "Number of times that the force limit was reached."),
}
"""Name and help text of the metric of each counter of a status."""
_HISTOGRAM_METRICS: Final = {
    "lateness_ns": ("hapticd_lateness_seconds", "Time from the servo's deadline to its wake-up."),
    "work_ns": ("hapticd_work_seconds", "Time from the servo's wake-up until the force was passed to the device."),
}
"""Name and help text of the metric of each histogram of a status."""


class DaemonCollector(Collector):
    """The Prometheus metrics of the daemon's newest status. A thread of prometheus-client's server calls `collect`."""

    def __init__(self) -> None:
        self._hub: TelemetryHub | None = None
        self._newest: bytes | None = None

    def follow(self, hub: TelemetryHub) -> None:
        """Collect the metrics of the hub's daemon from now on."""
        self._hub = hub
        hub.subscribe(self, frozenset({"status"}))

    def telemetry(self, topic: str, message: bytes) -> None:
        """Keep a status of the daemon, which the hub passes on as a message [topic, status]."""
        self._newest = message

    def collect(self) -> Iterator[Metric]:
        """Yield the current metrics; only `hapticd_up` if no daemon is connected."""
        newest = self._newest
        up = self._hub is not None and self._hub.daemon and newest is not None
        yield GaugeMetricFamily("hapticd_up", "Whether a daemon is connected.", int(up))
        if up and newest is not None:
            _, status = cast("tuple[str, Mapping[str, Any]]", messages.decode_trusted(newest))
            yield from _of_status(status)


def _of_status(status: Mapping[str, Any]) -> Iterator[Metric]:
    info = GaugeMetricFamily(
        "hapticd_info", "Version, protocol and device of the daemon.", labels=("version", "protocol", "device")
    )
    info.add_metric([str(status[key]) for key in ("version", "protocol", "device")], 1)
    yield info
    for key, (name, text) in _COUNTER_METRICS.items():
        if key in status["counters"]:
            yield CounterMetricFamily(name, text, status["counters"][key])
    yield GaugeMetricFamily("hapticd_running", "Whether the servo runs.", int(status["state"] == "running"))
    yield GaugeMetricFamily("hapticd_rate_hertz", "Ticks per second that the servo renders.", status["rate_hz"])
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
    for key, (name, text) in _HISTOGRAM_METRICS.items():
        histogram = status["histograms"][key]
        yield HistogramMetricFamily(name, text, _buckets(histogram), sum_value=histogram["sum"] / 1e9)


def _buckets(histogram: Mapping[str, Any]) -> Sequence[tuple[str, float]]:
    """Return the cumulative buckets, in s, of a histogram in ns; the last bucket has no upper edge."""
    total, buckets = 0, []
    for edge, count in zip([*histogram["edges"], float("inf")], histogram["counts"], strict=True):
        total += count
        buckets.append(("+Inf" if edge == float("inf") else repr(edge / 1e9), float(total)))
    return buckets


@contextmanager
def served(port: int) -> Iterator[DaemonCollector]:
    """Serve the metrics at `port` of this machine (0: a free one) while the context lasts.

    Raises HapticdError if the port cannot be used.
    """
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
