"""The daemon's status as lines of text, for `hapticd status`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, Literal

from hapticd.base import wording
from hapticd.hid.device_texts import offload_text, unseen_reset_text
from hapticd.rendering.undisplayable_text import undisplayable_text

if TYPE_CHECKING:
    from hapticd.protocol.results import Status, StreamStatus

Line = tuple[str, str]
"""The name of a line and its text. A line with an empty name continues the one before it."""

FAULT_REASONS: Final = {
    "nonfinite": "a position or a force was not a number",
    "control": "the control plane did not answer for a second",
    "lease": "a lease lapsed",
    "device": "the device does not report",
    "overrun": "the servo missed too many periods",
    "frozen": "the device reported the same position all the time, under force",
    "signs": "the signs of the device are not known",
}
"""Why forces are off, by the name of the fault."""

_LISTED_COUNTERS: Final = ("strikes", "saturations", "glitches", "overloads", "suspends")


def lines(status: Status) -> Iterator[Line]:
    """Yield the lines that `hapticd status` prints for a status."""
    yield from _forces(status)
    yield from _real_time(status["realtime"])
    yield from _periods(status)
    yield "device", f"{status['device']} at {wording.si(status['rate_hz'], 'Hz')}{_stepped_down(status)}"
    yield from _connection(status.get("connection"))
    yield "scene", f"revision {status['revision']:,}"
    lease = status["lease_s"]
    yield "lease", "none" if lease is None else f"held, {wording.duration(lease)} left"
    yield from _streams(status.get("streams", {}))
    for name, histogram in status.get("histograms", {}).items():
        yield name.removesuffix("_ns"), _times(histogram)
    counters = status["counters"]
    for name in _LISTED_COUNTERS:
        if name in counters:
            yield name, wording.number(counters[name])
    lost = {what: counters.get(f"{what}_dropped", 0) for what in ("samples", "events")}
    dropped = [wording.count(lost[what], what[:-1]) for what in lost]
    yield "telemetry", f"{wording.listed(dropped)} dropped" if any(lost.values()) else "nothing dropped"
    yield from _flight(status.get("flight"))
    for mode in status["undisplayable"]:
        yield "undisplayable", undisplayable_text(mode)
    for outcome in status["offload"]:
        yield "offload", offload_text(outcome)
    for warning in status["warnings"]:
        yield "warning", f"{warning['where']}: {warning['problem']}"
    yield "daemon", f"hapticd {status['version']}, protocol {status['protocol']}, {status['state']}"


def text_of(lines: list[Line]) -> str:
    """Return the lines of a status as a text of two aligned columns."""
    width = max(len(name) for name, _ in lines)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in lines)


def quantile_ns(histogram: Mapping[str, Any], probability: float) -> float:
    """Return a quantile of a histogram, in ns: interpolated within its bin, at most the longest time."""
    edges, counts = histogram["edges"], histogram["counts"]
    wanted, below = probability * sum(counts), 0
    for place, count in enumerate(counts):
        if count and below + count >= wanted:
            if place == len(edges):
                break
            low = edges[place - 1] if place else 0
            return float(min(low + (wanted - below) / count * (edges[place] - low), histogram["max"]))
        below += count
    return float(histogram["max"])


def _forces(status: Status) -> Iterator[Line]:
    if not status["faults"]:
        off = status["forces"] == "off"
        signs = _signs(status)
        why = "the device exerts none" if signs.get("problem") == "idle" else "the signs of the device are checked"
        on = f"on, but held back while {why}" if signs.get("state") in ("checking", "waiting") else status["forces"]
        yield "forces", "off, by a command or since the start: `hapticd force on` turns them on" if off else on
        return
    reasons = [FAULT_REASONS.get(name, name.replace("_", " ")) for name in status["faults"]]
    yield "forces", f"off by a fault: {wording.listed(reasons)}"
    advice = _signs(status).get("advice") if status["faults"] == ["signs"] else None
    yield "", advice or "`hapticd force on` turns them on again once the cause has ended"


def _signs(status: Status) -> dict[str, Any]:
    """Return the state of the check of the device's axis signs; empty for a simulated joystick."""
    connection = status.get("connection")
    signs = connection.get("signs") if isinstance(connection, dict) else None
    return signs if isinstance(signs, dict) else {}


def _streams(streams: Mapping[Literal["target", "force"], StreamStatus]) -> Iterator[Line]:
    """Yield a line for each kind of stream (targets, forces) whose messages were received."""
    for kind, counted in streams.items():
        if counted["received"]:
            came = f"{wording.count(counted['received'], 'message')} received, {counted['used']:,} used"
            came += f", {counted['limited']:,} limited" if counted["limited"] else ""
            timed_out = wording.count(counted["timeouts"], "time")
            yield f"{kind} stream", f"{'active' if counted['active'] else 'ended'}: {came}; timed out {timed_out}"


def _real_time(granted: Mapping[str, Any] | None) -> Iterator[Line]:
    if granted is None:
        yield "real time", "not requested"
        return
    missing = granted["missing"]
    parts = [
        f"SCHED_FIFO {granted['priority']}" if granted["priority"] else "no priority",
        "any processor" if granted["cpu"] is None else f"processor {granted['cpu']}",
        {"process": "all memory locked", "servo": "the servo's memory locked"}.get(
            granted["memory_locked"], "no memory locked"
        ),
        "idle states held off" if granted["idle_states_held"] else "idle states as they are",
    ]
    yield "real time", ", ".join(parts)
    for line in missing:
        yield "", f"not granted: {line}"
    if missing:
        yield "", "`hapticd doctor` says how to grant it"


def _periods(status: Status) -> Iterator[Line]:
    counters, overruns = status["counters"], status.get("overruns")
    skipped, ticks = counters["skipped"], status["tick"]
    if not skipped:
        yield "periods", f"{wording.count(ticks, 'tick')}, none missed"
        return
    share = wording.percent(skipped / (ticks + skipped))
    times = counters["overruns"]
    yield (
        "periods",
        f"{wording.count(ticks, 'tick')}; {skipped:,} missed ({share}), {wording.count(times, 'time')}",
    )
    if isinstance(overruns, dict):
        now, limit = (wording.percent(float(str(overruns[key]))) for key in ("missed_share", "threshold"))
        yield "", f"{now} of the last second's; above {limit}: {str(overruns['action']).replace('_', ' ')}"


def _stepped_down(status: Status) -> str:
    overruns = status.get("overruns")
    configured = overruns.get("configured_rate_hz") if isinstance(overruns, dict) else None
    if not isinstance(configured, float | int) or configured <= status["rate_hz"]:
        return ""
    return f", stepped down from {wording.si(configured, 'Hz')}"


def _times(histogram: Mapping[str, Any]) -> str:
    times_ns = (quantile_ns(histogram, 0.5), quantile_ns(histogram, 0.99), histogram["max"])
    median, almost_all, longest = (wording.si(1e-9 * time_ns, "s", 3) for time_ns in times_ns)
    return f"median {median}, 99 % within {almost_all}, longest {longest}"


def _flight(flight: object) -> Iterator[Line]:
    if not isinstance(flight, dict):
        return
    files = f"{wording.count(flight['written'], 'file')} written to {flight['directory']}"
    yield "flight recorder", f"the last {wording.duration(flight['seconds'])}; {files}"
    if flight["problem"] is not None:
        yield "", flight["problem"]


def _connection(connection: object) -> Iterator[Line]:
    if not isinstance(connection, dict):
        return
    where = f"{connection['name']} at {connection['path']}, " if connection["name"] else ""
    yield (
        "connection",
        f"{where}{connection['state']}" + (f": {connection['problem']}" if connection["problem"] else ""),
    )
    rates = [
        f"{what} {wording.si(connection[key], 'Hz')}"
        for what, key in (
            ("carries forces at", "link_hz"),
            ("reports at", "report_hz"),
            ("takes forces at", "force_hz"),
        )
        if connection[key] is not None
    ]
    if rates:
        yield "link", ", ".join(rates)
    signs = connection.get("signs")
    if isinstance(signs, dict):
        waits = signs["state"] in ("checking", "waiting") and signs["advice"]
        yield "signs", signs["state"] + (f": {signs['advice']}" if waits else "")
    for line in connection.get("warnings", ()):
        yield "warning", line
    if connection["states"]:
        yield "states", ", ".join(f"{name} {'yes' if value else 'no'}" for name, value in connection["states"].items())
    if connection["resets"]:
        yield "resets", wording.number(connection["resets"])
    if connection.get("resets_seen") is False:
        condition, action = unseen_reset_text(connection["path"], connection["foreign_effect_s"])
        yield "unseen", condition
        yield "", action
