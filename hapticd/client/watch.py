"""The live view: where the probe is, what it touches and feels, and how the daemon keeps time.

`View` takes telemetry in and gives text out, 80x24 or larger; it knows neither sockets nor clocks. `watch`
connects it with a daemon: on a terminal as a picture 15 times a second, into a pipe as lines.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
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

REFRESH_S: Final = 1 / 15
LOST_AFTER_S: Final = 1.5
PANEL_WIDTH: Final = 33
EVENT_LINES: Final = 4
HALF_VIEW_M: Final = 0.08
"""Half the height of the plane that is shown at least."""

_BAR: Final = 12
_SOLID, _SKIN = "░", "─\\│/"
# Shown by other means: what is touched, and a counter.
_QUIET_EVENTS: Final = frozenset(("release", "overrun"))


class View:
    """What is known of the daemon, and how it is drawn."""

    def __init__(self) -> None:
        self.status: Status | None = None
        self.state: State | None = None
        self.scene: dict[str, Any] = {}
        self.scene_revision: int | None = None
        self.lost_for_s: float | None = None
        """How long nothing has come; None while telemetry comes."""
        self.rate_hz: float | None = None
        self._clock: deque[tuple[int, int]] = deque(maxlen=60)
        self._lateness: deque[int] = deque(maxlen=60)
        self._events: deque[tuple[str, Text]] = deque(maxlen=EVENT_LINES)
        self._punctured: set[str] = set()
        self._largest_n = 1.0
        self._half_m = HALF_VIEW_M
        self._background: tuple[object, list[str]] | None = None

    # ---- in ------------------------------------------------------------------------------------------------

    def feed(self, topic: str, message: Mapping[str, object]) -> None:
        """Takes one telemetry message."""
        self.lost_for_s = None
        if topic == "status":
            self.status = cast(Status, message)
        elif topic == "state":
            self._feed_state(cast(State, message))
        elif topic == "event":
            self._feed_event(message)

    def _feed_state(self, state: State) -> None:
        if self._clock and state["tick"] < self._clock[-1][0]:
            self._clock.clear()  # another daemon, or the same started again
            self._punctured.clear()
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
        if kind == "puncture":
            self._punctured.add(event["object"])
        elif kind == "contact":
            self._punctured.discard(event["object"])  # what is open is not touched: it has healed
        if kind not in _QUIET_EVENTS:
            if kind in ("revision", "groove") and self._events and self._events[-1][0] == kind:
                self._events.pop()  # of a stream of updates or grooves the newest tells all
            time_s = f"{event['time_ns'] / 1e9:12.3f}"
            self._events.append((kind, Text.assemble((time_s, "dim"), f"  {event_line(event)}")))

    @property
    def wants_scene(self) -> bool:
        """Whether the daemon shows another scene than the one that is drawn."""
        return self.lost_for_s is None and self.state is not None and self.state["revision"] != self.scene_revision

    def set_scene(self, scene: Mapping[str, object], revision: int) -> None:
        """Takes the scene that is drawn."""
        if revision != self.scene_revision:
            self._background = None
        self.scene, self.scene_revision = dict(scene), revision

    # ---- out -----------------------------------------------------------------------------------------------

    def render(self, width: int, height: int) -> Text:
        """The whole view, `height` lines of at most `width` columns."""
        rows = max(1, height - EVENT_LINES - 2)
        columns = max(1, width - PANEL_WIDTH - 1)
        panel = self._panel()
        lines = [self._headline(width)]
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
        connection = cast("dict[str, Any]", status.get("connection") or {})
        right, style = f"forces {status['forces']} ", "bold white on red"
        if status["forces"] == "on" and connection.get("signs", {}).get("state") in ("checking", "waiting"):
            right, style = "signs are checked ", "black on yellow"
        elif status["forces"] in ("on", "off"):
            style = f"black on {'green' if status['forces'] == 'on' else 'yellow'}"
        left = f" hapticd {status['version']}  {status['device']}  {wording.si(status['rate_hz'], 'Hz')}"
        return Text.assemble((left.ljust(max(0, width - len(right))), "reverse"), (right, style))

    def _panel(self) -> list[Text]:
        state, status = self.state, self.status
        if state is None:
            return []
        x, y = (1e3 * value for value in state["position_m"])
        vx, vy = (1e3 * value for value in state["velocity_m_per_s"])
        fx, fy = state["force_n"]
        scale = _nice(self._largest_n)
        contact, vibration = math.hypot(*state["contact_force_n"]), math.hypot(*state["vibration_force_n"])
        touching = ", ".join(state["touching"])
        late_us = [value / 1e3 for value in self._lateness]
        rows = [
            ("position", f"{x:+8.3f} {y:+8.3f} mm", ""),
            ("velocity", f"{vx:+8.1f} {vy:+8.1f} mm/s", ""),
            ("force x", f"{signed_bar(fx, scale, _BAR)} {fx:+.2f} N", "cyan"),
            ("force y", f"{signed_bar(fy, scale, _BAR)} {fy:+.2f} N", "cyan"),
            ("contact", f"{bar(contact, scale, _BAR)}  {contact:.2f} N", "green"),
            ("vibration", f"{bar(vibration, scale, _BAR)}  {vibration:.2f} N", "green"),
            ("touching", touching or "nothing", "bold" if touching else ""),
            ("", "", ""),
            ("rate", "" if self.rate_hz is None else f"{self.rate_hz:,.0f} Hz", ""),
            ("lateness", f"{late_us[-1]:.0f} us, worst seen {max(late_us):.0f}", ""),
            ("work", f"{state['work_ns']} ns", ""),
            ("tick", f"{state['tick']:,}", ""),
            ("revision", f"{state['revision']:,}", ""),
        ]
        if status is not None:
            skipped, faults = status["counters"]["skipped"], ", ".join(status["faults"])
            times = wording.count(status["counters"]["overruns"], "time") if skipped else ""
            rows.append(("missed", wording.count(skipped, "period"), "yellow" if skipped else ""))
            rows.append(("", times, ""))
            rows.append(("faults", faults or "none", "bold red" if faults else ""))
            if status["lease_s"] is not None:
                rows.append(("lease", f"{status['lease_s']:.1f} s left", ""))
        return [Text.assemble((f"{label:<11}", "dim"), (value, style)) for label, value, style in rows]

    def _picture(self, columns: int, rows: int) -> list[Text]:
        # A character is about twice as high as wide.
        cell_m = 2 * self._half_m / max(1, 2 * min(rows, columns // 2))
        key = (columns, rows, cell_m, self.scene_revision, frozenset(self._punctured))
        if self._background is None or self._background[0] != key:
            cells = draw_scene(self.scene, columns, rows, cell_m, self._punctured)
            self._background = (key, ["".join(row) for row in cells])
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
        """The state as one plain line."""
        state, status = self.state, self.status
        if state is None:
            return "no state yet"
        x, y = (1e3 * value for value in state["position_m"])
        fx, fy = state["force_n"]
        parts = [
            f"tick {state['tick']:,}",
            f"position {x:+.3f} {y:+.3f} mm",
            f"force {fx:+.3f} {fy:+.3f} N",
            f"touching {', '.join(state['touching']) or 'nothing'}",
        ]
        if self.rate_hz is not None:
            parts.append(f"rate {self.rate_hz:,.0f} Hz")
        parts.append(f"lateness {max(self._lateness) / 1e3:.0f} us at worst")
        if status is not None:
            parts.append(f"{wording.count(status['counters']['skipped'], 'period')} missed")
            parts.append(f"forces {status['forces']}")
            if status["faults"]:
                parts.append(f"faults {', '.join(status['faults'])}")
        return "  ".join(parts)


# ---- pieces of text ----------------------------------------------------------------------------------------


def _contact(event: Mapping[str, Any]) -> str:
    if event.get("appeared"):
        return "inside it when it appeared"
    words = f"at {event['speed_m_per_s']:.3f} m/s, {event['amplitude_m_per_s2']:.1f} m/s²"
    if event["scale"] == 0:
        return f"{words} not displayed"
    return words if event["scale"] >= 1 else f"{words} scaled to {event['scale']:.2f} by the force limit"


_WORDS: Final[dict[str, Callable[[Mapping[str, Any]], str]]] = {
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
    "gesture_end": lambda event: "as it was meant" if event["completed"] else "replaced by another",
    "revision": lambda event: str(event["revision"]),
}
"""What a line says of an event of each kind beside its object."""


def event_line(event: Mapping[str, Any]) -> str:
    """An event in words: its kind, its object, and its other members."""
    kind = event["event"]
    words = [kind.replace("_", " "), event.get("object"), _WORDS[kind](event) if kind in _WORDS else None]
    return " ".join(each for each in words if each is not None)


def bar(value: float, scale: float, width: int) -> str:
    """A bar from the left, `width` columns for `scale`."""
    filled = min(width, round(abs(value) / scale * width))
    return "█" * filled + "·" * (width - filled)


def signed_bar(value: float, scale: float, width: int) -> str:
    """A bar from the middle of `width` columns, to the left for negative values."""
    left, right = (bar(max(0.0, part), scale, width // 2) for part in (-value, value))
    return f"{left[::-1]}│{right}"


def _nice(value: float) -> float:
    """The next of 1, 2, 5, 10, ..."""
    exponent = 10.0 ** math.floor(math.log10(value))
    return next((step * exponent for step in (1, 2, 5) if value <= step * exponent), 10 * exponent)


def draw_scene(
    scene: Mapping[str, Any], columns: int, rows: int, cell_m: float, punctured: Iterable[str] = ()
) -> list[list[str]]:
    """The plane in characters, rows from the top: solids shaded, membranes as lines, punctured ones with a
    hole.

    The origin is in the middle; a character is `cell_m` wide and twice as high.
    """
    x = (np.arange(columns) + 0.5 - columns / 2) * cell_m
    y = (rows / 2 - np.arange(rows) - 0.5) * 2 * cell_m
    solid = np.zeros((rows, columns), bool)
    cells: npt.NDArray[np.str_] = np.full((rows, columns), " ")
    skins = []
    objects: Mapping[str, Mapping[str, Any]] = scene.get("objects") or {}
    for name, thing in objects.items():
        kind = thing.get("kind")
        if kind == "wall":
            (px, py), (nx, ny) = thing["point_m"], thing["normal"]
            solid |= (x[None, :] - px) * nx + (y[:, None] - py) * ny < 0
        elif kind == "box":
            (cx, cy), (width, height), angle = thing["center_m"], thing["size_m"], thing.get("angle_rad", 0.0)
            along = (x[None, :] - cx) * math.cos(angle) + (y[:, None] - cy) * math.sin(angle)
            across = (y[:, None] - cy) * math.cos(angle) - (x[None, :] - cx) * math.sin(angle)
            # What is thinner than a character is drawn as one.
            solid |= (abs(along) < max(width / 2, cell_m / 2)) & (abs(across) < max(height / 2, cell_m))
        elif kind == "disc":
            (cx, cy), radius = thing["center_m"], thing["radius_m"]
            solid |= np.hypot(x[None, :] - cx, y[:, None] - cy) < max(radius, cell_m)
        elif kind == "membrane":
            skins.append((name, thing))
    cells[solid] = _SOLID
    broken = frozenset(punctured)
    for name, thing in skins:
        (cx, cy), (nx, ny), half = thing["center_m"], thing["normal"], thing["width_m"] / 2
        length = math.hypot(nx, ny) or 1.0
        tx, ty = ny / length, -nx / length
        # Slope on the screen, where a character is twice as high: 0 along the rows, 2 along the columns.
        angle = math.atan2(-ty / 2, tx) % math.pi
        mark = _SKIN[round(angle / (math.pi / 4)) % 4]
        steps = np.linspace(-half, half, max(3, int(2 * half / cell_m * 2)))
        column = np.floor((cx + steps * tx) / cell_m + columns / 2).astype(int)
        row = np.floor(rows / 2 - (cy + steps * ty) / (2 * cell_m)).astype(int)
        shown = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        if name in broken:
            shown &= np.abs(steps) > half / 3
        cells[row[shown], column[shown]] = mark
    return cast("list[list[str]]", cells.tolist())


# ---- the loop ----------------------------------------------------------------------------------------------


def watch(
    client: Client, as_json: bool = False, console: Console | None = None, duration_s: float | None = None
) -> None:
    """Shows the daemon live for `duration_s` from its first message, or until it is interrupted (KeyboardInterrupt). A
    daemon that goes away is waited for; a terminal that does raises HapticdError.

    Where the console is no terminal, or for `as_json`, it prints a line a second and one for each event.
    """
    console = console or Console()
    lasts_s = math.inf if duration_s is None else duration_s
    with client.telemetry("state", "event", "status") as messages:
        if as_json or not console.is_terminal:
            for line in _lines(client, messages, as_json, lasts_s):
                console.file.write(line + "\n")
                console.file.flush()
        else:
            try:
                if _draw(client, messages, console, lasts_s):
                    return
            except OSError:
                if console.file.isatty():
                    raise
            # Whose controlling terminal it is not is sent no SIGHUP.
            raise HapticdError("the terminal is gone")


_Item: TypeAlias = tuple[Topic, dict[str, object]]
_Messages: TypeAlias = Subscription[_Item]


def _follow(view: View, client: Client, messages: _Messages, every_s: float, lasts_s: float) -> Iterator[_Item | None]:
    """Feeds the view for a time from the first message; each message, or None where none came within `every_s`."""
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
    """Draws until the time is over (true) or the terminal is gone (false)."""
    view = View()
    shown_s = time.monotonic()
    asked_s = -math.inf
    with Live(console=console, screen=True, auto_refresh=False) as live:
        for _ in _follow(view, client, messages, REFRESH_S, lasts_s):
            now_s = time.monotonic()
            if view.wants_scene and now_s - asked_s > 1.0:
                asked_s = now_s
                # Asked again if there is no answer; that the daemon is gone shows by its silence.
                with suppress(HapticdError):
                    answer = client.get_scene()
                    view.set_scene(answer["scene"], answer["revision"])
            if now_s - shown_s >= REFRESH_S:
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
