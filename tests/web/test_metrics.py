"""`hapticd web --metrics`: the metrics for Prometheus, read by prometheus-client's parser."""

from __future__ import annotations

import re
import socket
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.support.daemon_process import connect, running_daemon, until
from tests.web.test_process import refusal, running

pytestmark = pytest.mark.slow

Figures = dict[str, dict[str, float]]


def figures(address: str) -> Figures:
    """Return the metrics' values by name and by the values of their labels."""
    with urllib.request.urlopen(address, timeout=30) as answer:
        assert answer.headers["Content-Type"].startswith("text/plain; version=")
        text = answer.read().decode()
    found: Figures = {}
    for family in text_string_to_metric_families(text):
        assert family.documentation and family.type != "unknown", family.name
        for sample in family.samples:
            found.setdefault(sample.name, {})[",".join(sample.labels.values())] = sample.value
    return found


def address_in(log: Path) -> str:
    """Return the address of the metrics from the log, which a separate thread of the process writes."""
    line = re.compile(r"metrics at (http://127\.0\.0\.1:\d+/metrics)")
    until(lambda: line.search(log.read_text()) is not None)
    return line.findall(log.read_text())[0]


def test_figures_are_those_of_the_status(tmp_path: Path) -> None:
    with running_daemon() as daemon:
        place = ("--runtime-dir", str(daemon.directory))
        with running(tmp_path, "--metrics", "0", before=place), connect(daemon.directory) as client:
            address = address_in(tmp_path / "web.log")
            until(lambda: figures(address)["hapticd_up"] == {"": 1})
            before = client.get_status(detail=True)
            until(lambda: figures(address)["hapticd_ticks_total"][""] >= before["tick"])
            found, after = figures(address), client.get_status(detail=True)
    for key in ("ticks", "strikes"):
        count = found[f"hapticd_{key}_total"][""]
        assert before["counters"][key] <= count <= after["counters"][key]  # type: ignore[literal-required]
    assert found["hapticd_rate_hertz"] == {"": before["rate_hz"]}
    assert found["hapticd_forces"] == {"on": 1, "off": 0, "faulted": 0}
    buckets = found["hapticd_lateness_seconds_bucket"]
    edges = sorted(map(float, buckets))
    assert edges[:-1] == [edge / 1e9 for edge in before["histograms"]["lateness_ns"]["edges"]]
    assert buckets["+Inf"] == found["hapticd_lateness_seconds_count"][""] > 0
    assert [buckets[text] for text in sorted(buckets, key=float)] == sorted(buckets.values())


def test_without_a_daemon_there_is_one_figure(tmp_path: Path) -> None:
    with running(tmp_path, "--metrics", "0", before=("--runtime-dir", str(tmp_path / "none"))):
        assert figures(address_in(tmp_path / "web.log")) == {"hapticd_up": {"": 0}}


def test_a_port_in_use_is_reported_in_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    with running_daemon() as daemon, socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        line = refusal(capfd, "--runtime-dir", str(daemon.directory), "web", "--port", "0", "--metrics", port)
    assert line == f"hapticd: --metrics {port}: Address already in use\n"
