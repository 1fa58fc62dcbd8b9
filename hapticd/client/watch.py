"""The live view of `hapticd watch`: position, contacts, forces and timing.

`View` turns telemetry into text of 80x24 characters or more, without sockets and clocks. `watch` connects it to a
daemon: on a terminal as a picture 15 times a second, in a pipe as lines.
"""

from __future__ import annotations

import json
import math
import textwrap
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import zip_longest
from typing import Any, Final, TypeAlias, cast

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.live import Live
from rich.text import Text

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client, Subscription
from hapticd.protocol.calls import Topic
from hapticd.protocol.results import State, Status

FRAME_PERIOD_S: Final = 1 / 15
"""Time between two pictures."""
LOST_AFTER_S: Final = 1.5
"""Time without messages after which the daemon is shown as lost; it sends its status every second."""
PANEL_WIDTH: Final = 33
"""Width of the column of values next to the picture, in characters."""
EVENT_LINES: Final = 4
"""Number of events below the picture."""
MIN_HALF_VIEW_M: Final = 0.08
"""Smallest distance from the middle of the picture to its upper edge."""

_BAR_WIDTH: Final = 12
"""Width of the bar of a force, in characters."""
_LINE_LABELS: Final = ("tick", "position", "force x", "force y", "touching", "rate", "lateness", "missed", "faults")
"""Labels of the values that a line for a file or a pipe shows."""
_QUIET_EVENTS: Final = frozenset(("release", "overrun"))
"""Events that are not listed, since the values `touching` and `missed` show them."""


class View:
    """The state of a daemon, and its picture."""

    def __init__(self) -> None:
        self.status: Status | None = None
        self.state: State | None = None
        self.scene: dict[str, Any] = {}
        self.scene_revision: int | None = None
        self.lost_for_s: float | None = None
        """Time without telemetry, in s; None while it arrives."""
        self.rate_hz: float | None = None
        self._clock: deque[tuple[int, int]] = deque(maxlen=60)
        self._lateness: deque[int] = deque(maxlen=60)
        self._events: deque[tuple[str, Text]] = deque(maxlen=EVENT_LINES)
        self._largest_n = 1.0
        self._half_m = MIN_HALF_VIEW_M
        self._background: tuple[object, list[str]] | None = None

    # ---- Input ------------------------------------------------------------------------------------------------

    def feed(self, topic: str, message: Mapping[str, object]) -> None:
        """Update the view with a telemetry message."""
        self.lost_for_s = None
        if topic == "status":
            self.status = cast(Status, message)
        elif topic == "state":
            self._feed_state(cast(State, message))
        elif topic == "event":
            self._feed_event(message)

    def _feed_state(self, state: State) -> None:
        if self._clock and state["tick"] < self._clock[-1][0]:
            self._clock.clear()  # the daemon was restarted
            self.scene_revision = None
        self._clock.append((state["tick"], state["time_ns"]))
        self._lateness.append(state["lateness_ns"])
        ticks = self._clock[-1][0] - self._clock[0][0]
        elapsed_ns = self._clock[-1][1] - self._clock[0][1]
        self.rate_hz = ticks / elapsed_ns * 1e9 if elapsed_ns > 0 else None
        self.state = state
        self._largest_n = max(self._largest_n, *map(abs, state["force_n"]), *map(abs, state["vibration_force_n"]))
        self._half_m = max(self._half_m, 1.05 * max(map(abs, state["position_m"])))

    def _feed_event(self, event: Mapping[str, Any]) -> None:
        kind = event["event"]
        if kind not in _QUIET_EVENTS:
            if kind in ("revision", "groove") and self._events and self._events[-1][0] == kind:
                self._events.pop()  # of several updates or grooves in a row only the newest is shown
            time_s = f"{event['time_ns'] / 1e9:12.3f}"
            self._events.append((kind, Text.assemble((time_s, "dim"), f"  {event_line(event)}")))

    @property
    def wants_scene(self) -> bool:
        """Whether the daemon's scene has changed since the last `set_scene`."""
        return self.lost_for_s is None and self.state is not None and self.state["revision"] != self.scene_revision

    def set_scene(self, scene: Mapping[str, object], revision: int) -> None:
        """Set the scene that the picture shows, and its revision."""
        self._background = None
        self.scene, self.scene_revision = dict(scene), revision

    # ---- Output -----------------------------------------------------------------------------------------------

    def render(self, width: int, height: int) -> Text:
        """Return the complete view: `height` lines of at most `width` characters."""
        warnings = self._connection.get("warnings", [])
        warned = [Text(line, "yellow") for each in warnings for line in textwrap.wrap(each, width)]
        rows = max(1, height - EVENT_LINES - 2 - len(warned))
        columns = max(1, width - PANEL_WIDTH - 1)
        panel = [
            Text.assemble((f"{label:<11}", "dim"), (f"{bar}{value}", style))
            for label, bar, value, style in self._rows()
        ]
        lines = [self._headline(width), *warned]
        for picture, about in zip_longest(self._picture(columns, rows), panel[:rows], fillvalue=Text()):
            lines.append(Text.assemble(picture, " ", about))
        lines.append(Text("─" * width, style="dim"))
        lines += [line.copy() for _, line in self._events]
        lines += [Text()] * (height - len(lines))
        for line in lines:
            line.truncate(width)
        return Text("\n").join(lines[:height])

    def _headline(self, width: int) -> Text:
        if self.lost_for_s is not None:
            text = f" daemon lost: nothing for {self.lost_for_s:.0f} s; waiting for it, Ctrl-C ends "
            return Text(text.ljust(width), style="bold white on red")
        if self.status is None:
            return Text(" connecting ".ljust(width), style="reverse")
        status = self.status
        right, style = f"forces {status['forces']} ", "bold white on red"
        signs = self._connection.get("signs", {})
        if status["forces"] == "on" and signs.get("state") in ("checking", "waiting"):
            right = "device exerts no force " if signs.get("problem") == "idle" else "signs are checked "
            style = "black on yellow"
        elif status["forces"] in ("on", "off"):
            style = f"black on {'green' if status['forces'] == 'on' else 'yellow'}"
        left = f" hapticd {status['version']}  {status['device']}  {wording.si(status['rate_hz'], 'Hz')}"
        return Text.assemble((left.ljust(max(0, width - len(right))), "reverse"), (right, style))

    @property
    def _connection(self) -> dict[str, Any]:
        """The connection to the device; empty without a device."""
        return {} if self.status is None else dict(self.status.get("connection") or {})

    def _rows(self) -> Iterator[tuple[str, str, str, str]]:
        """Yield the rows next to the picture: label, bar, value and style of each."""
        state, status = self.state, self.status
        if state is None:
            return
        x, y = (1e3 * value for value in state["position_m"])
        vx, vy = (1e3 * value for value in state["velocity_m_per_s"])
        yield "position", "", f"{x:+8.3f} {y:+8.3f} mm", ""
        yield "velocity", "", f"{vx:+8.1f} {vy:+8.1f} mm/s", ""
        for axis, force in zip("xy", state["force_n"], strict=True):
            yield f"force {axis}", signed_bar(force, self._largest_n, _BAR_WIDTH), f" {force:+.2f} N", "cyan"
        for label, vector in (("contact", state["contact_force_n"]), ("vibration", state["vibration_force_n"])):
            force = math.hypot(*vector)
            yield label, bar(force, self._largest_n, _BAR_WIDTH), f"  {force:.2f} N", "green"
        touching, late_us = ", ".join(state["touching"]), [value / 1e3 for value in self._lateness]
        yield "touching", "", touching or "nothing", "bold" if touching else ""
        yield "rate", "", "" if self.rate_hz is None else f"{self.rate_hz:,.0f} Hz", ""
        yield "lateness", "", f"{late_us[-1]:.0f} us, worst seen {max(late_us):.0f}", ""
        yield "work", "", f"{state['work_ns']} ns", ""
        yield "tick", "", f"{state['tick']:,}", ""
        yield "revision", "", f"{state['revision']:,}", ""
        if status is not None:
            skipped, faults = status["counters"]["skipped"], ", ".join(status["faults"])
            times = f", {wording.count(status['counters']['overruns'], 'time')}" if skipped else ""
            yield "missed", "", wording.count(skipped, "period") + times, "yellow" if skipped else ""
            yield "faults", "", faults or "none", "bold red" if faults else ""
            if status["lease_s"] is not None:
                yield "lease", "", f"{status['lease_s']:.1f} s left", ""

    def _picture(self, columns: int, rows: int) -> list[Text]:
        # A character is about twice as high as it is wide.
        cell_m = 2 * self._half_m / max(1, 2 * min(rows, columns // 2))
        key = (columns, rows, cell_m)
        if self._background is None or self._background[0] != key:
            self._background = (key, draw_scene(self.scene, columns, rows, cell_m))
        drawn = self._background[1]
        lines = [Text.assemble((line, "dim")) for line in drawn]
        if self.state is not None:
            x, y = self.state["position_m"]
            column = math.floor(x / cell_m + columns / 2)
            row = math.floor(rows / 2 - y / (2 * cell_m))
            if 0 <= row < rows and 0 <= column < columns:
                line, style = drawn[row], "bold red" if self.state["touching"] else "bold"
                lines[row] = Text.assemble((line[:column], "dim"), ("●", style), (line[column + 1 :], "dim"))
        return lines

    def line(self) -> str:
        """Return the state of the daemon as a line for a file or a pipe."""
        values = {label: value for label, _, value, _ in self._rows()}
        parts = [f"{label} {' '.join(values[label].split())}" for label in _LINE_LABELS if values.get(label)]
        return "  ".join(parts if self.status is None else [*parts, f"forces {self.status['forces']}"])


# ---- Texts ----------------------------------------------------------------------------------------


def _contact(event: Mapping[str, Any]) -> str:
    if event.get("appeared"):
        return "appeared around the probe"
    words = f"at {event['speed_m_per_s']:.3f} m/s, {event['amplitude_m_per_s2']:.1f} m/s²"
    if event["scale"] == 0:
        return f"{words} not displayed"
    return words if event["scale"] >= 1 else f"{words} scaled to {event['scale']:.2f} by the force limit"


_EVENT_TEXT_BY_KIND: Final[dict[str, Callable[[Mapping[str, Any]], str]]] = {
    "contact": _contact,
    "groove": lambda event: f"{event['grooves']} struck in this contact",
    "puncture": lambda event: f"at {1e3 * event['depth_m']:.2f} mm",
    "saturation": lambda event: f"wanted {event['wanted_n']:.2f} N",
    "overrun": lambda event: f"{wording.count(event['missed'], 'period')} missed",
    "glitch": lambda event: f"a jump of {event['speed_m_per_s']:.0f} m/s",
    "fault": lambda event: ", ".join(event["faults"]) or "cleared",
    "overload": lambda event: f"{wording.percent(event['missed_share'], 2)} of a second's periods missed",
    "rate": lambda event: f"{wording.si(event['rate_hz'], 'Hz')} from now on",
    "resumed": lambda event: f"after {wording.duration(round(event['suspended_s']))} of suspend",
    "memory_refused": lambda event: str(event["problem"]),
    "mark": lambda event: str(event["text"]),
    "gesture_end": lambda event: "completed" if event["completed"] else "replaced by another operator",
    "revision": lambda event: str(event["revision"]),
}
"""Text of an event after its object, by kind of event."""


def event_line(event: Mapping[str, Any]) -> str:
    """Return an event as a line of text: its kind, its object, and its other members."""
    kind = event["event"]
    words = [
        kind.replace("_", " "),
        event.get("object"),
        _EVENT_TEXT_BY_KIND[kind](event) if kind in _EVENT_TEXT_BY_KIND else None,
    ]
    return " ".join(each for each in words if each is not None)


def bar(value: float, scale: float, width: int) -> str:
    """Return a bar of `width` characters that grows from the left; `scale` is the value of a full bar."""
    filled = min(width, round(abs(value) / scale * width))
    return "█" * filled + "·" * (width - filled)


def signed_bar(value: float, scale: float, width: int) -> str:
    """Return a bar of `width` characters that grows from the middle, to the left for negative values."""
    left, right = (bar(max(0.0, part), scale, width // 2) for part in (-value, value))
    return f"{left[::-1]}│{right}"


def draw_scene(scene: Mapping[str, Any], columns: int, rows: int, cell_m: float) -> list[str]:
    """Return the picture of a scene, in rows from the top: solids are shaded, membranes are lines.

    The origin is in the middle; a character is `cell_m` wide and twice as high.
    """
    x = ((np.arange(columns) + 0.5 - columns / 2) * cell_m)[None, :]
    y = ((rows / 2 - np.arange(rows) - 0.5) * 2 * cell_m)[:, None]
    cells: npt.NDArray[np.str_] = np.full((rows, columns), " ")

    def slab(center: Sequence[float], size: Sequence[float], angle: float) -> npt.NDArray[np.bool_]:
        """Return which characters of the picture lie in a rectangle, which is at least one character wide and high."""
        right, up = x - center[0], y - center[1]
        along = right * math.cos(angle) + up * math.sin(angle)
        across = up * math.cos(angle) - right * math.sin(angle)
        return (abs(along) < max(size[0] / 2, cell_m / 2)) & (abs(across) < max(size[1] / 2, cell_m))

    for thing in (scene.get("objects") or {}).values():
        match thing.get("kind"):
            case "wall":
                (px, py), (nx, ny) = thing["point_m"], thing["normal"]
                cells[(x - px) * nx + (y - py) * ny < 0] = "░"
            case "box":
                cells[slab(thing["center_m"], thing["size_m"], thing.get("angle_rad", 0.0))] = "░"
            case "disc":
                cx, cy = thing["center_m"]
                cells[np.hypot(x - cx, y - cy) < max(thing["radius_m"], cell_m)] = "░"
            case "membrane":
                nx, ny = thing["normal"]
                cells[slab(thing["center_m"], (thing["width_m"], 0.0), math.atan2(-nx, ny))] = "─"
    return ["".join(row) for row in cells]


# ---- Loop ----------------------------------------------------------------------------------------------


def watch(
    client: Client, as_json: bool = False, console: Console | None = None, duration_s: float | None = None
) -> None:
    """Show the daemon live, for `duration_s` from its first message on, or until KeyboardInterrupt.

    If the daemon ends, wait for the next one. If the console is not a terminal, or with `as_json`, print a line per
    second and a line for each event. Raises HapticdError if the terminal is closed.
    """
    console = console or Console()
    lasts_s = math.inf if duration_s is None else duration_s
    with client.telemetry("state", "event", "status") as messages:
        if as_json or not console.is_terminal:
            for line in _lines(client, messages, as_json, lasts_s):
                console.file.write(line + "\n")
                console.file.flush()
            return
        try:
            if _draw(client, messages, console, lasts_s):
                return
        except OSError:
            if console.file.isatty():
                raise
        # No SIGHUP arrives if it is not the controlling terminal of this process.
        raise HapticdError("the terminal was closed")


_Item: TypeAlias = tuple[Topic, dict[str, object]]
_Messages: TypeAlias = Subscription[_Item]


def _follow(view: View, client: Client, messages: _Messages, every_s: float, lasts_s: float) -> Iterator[_Item | None]:
    """Update the view until `lasts_s` after the first message; yield messages, or None if none comes in `every_s`."""
    heard_s, ends_s = time.monotonic(), math.inf
    view.feed("status", client.get_status())
    while (now_s := time.monotonic()) < ends_s:
        item = messages.receive(min(every_s, ends_s - now_s))
        now_s = time.monotonic()
        if item is not None:
            heard_s, ends_s = now_s, min(ends_s, now_s + lasts_s)
            view.feed(*item)
        elif now_s - heard_s > LOST_AFTER_S:
            view.lost_for_s = now_s - heard_s
        yield item


def _draw(client: Client, messages: _Messages, console: Console, lasts_s: float) -> bool:
    """Draw the view until `lasts_s` after the first message (return true) or the terminal closes (return false)."""
    view = View()
    shown_s = time.monotonic()
    asked_s = -math.inf
    with Live(console=console, screen=True, auto_refresh=False) as live:
        for _ in _follow(view, client, messages, FRAME_PERIOD_S, lasts_s):
            now_s = time.monotonic()
            if view.wants_scene and now_s - asked_s > 1.0:
                asked_s = now_s
                # Without a reply the scene is requested again; that the daemon has ended shows in missing telemetry.
                with suppress(HapticdError):
                    answer = client.get_scene()
                    view.set_scene(answer["scene"], answer["revision"])
            if now_s - shown_s >= FRAME_PERIOD_S:
                shown_s = now_s
                if not console.file.isatty():
                    return False
                live.update(view.render(*console.size), refresh=True)
    return True


def _lines(client: Client, messages: _Messages, as_json: bool, lasts_s: float) -> Iterator[str]:
    view = View()
    due_s = -math.inf
    lost = False
    for item in _follow(view, client, messages, LOST_AFTER_S, lasts_s):
        if item is None:
            if view.lost_for_s is not None and not lost:
                yield json.dumps({"topic": "lost"}) if as_json else "daemon lost; waiting for it"
            lost = view.lost_for_s is not None
            continue
        lost = False
        topic, message = item
        if topic == "event" and (as_json or message["event"] not in _QUIET_EVENTS):
            yield json.dumps({"topic": topic, **message}) if as_json else event_line(message)
        elif topic == "state" and time.monotonic() >= due_s:
            due_s = time.monotonic() + 1.0
            yield json.dumps({"topic": topic, **message}) if as_json else view.line()
