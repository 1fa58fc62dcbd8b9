"""The live view: where the probe is, what it touches and feels, and how the daemon keeps time.

`View` takes telemetry in and gives text out, 80x24 or larger; it knows neither sockets nor clocks. `watch`
connects it with a daemon: on a terminal as a picture 15 times a second, into a pipe as lines.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, Final, NamedTuple, TypeAlias, cast

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


class _Shown(NamedTuple):
    kind: str
    time_s: float
    text: str


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
        self._events: deque[_Shown] = deque(maxlen=EVENT_LINES)
        self._punctured: set[str] = set()
        self._largest_n = 1.0
        self._half_m = HALF_VIEW_M
        self._background: tuple[object, list[list[str]]] | None = None

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

    def _feed_event(self, event: Mapping[str, object]) -> None:
        kind = str(event.get("event"))
        if kind == "puncture":
            self._punctured.add(str(event.get("object")))
        elif kind == "contact":
            self._punctured.discard(str(event.get("object")))  # what is open is not touched: it has healed
        if kind not in _QUIET_EVENTS:
            if kind in ("revision", "groove") and self._events and self._events[-1].kind == kind:
                self._events.pop()  # of a stream of updates or grooves the newest tells all
            self._events.append(_Shown(kind, _number(event, "time_ns") / 1e9, event_line(event)))

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
        for row, picture in enumerate(self._picture(columns, rows)):
            line = picture
            line.append(" ")
            if row < len(panel):
                line.append_text(panel[row])
            lines.append(line)
        lines.append(Text("─" * width, style="dim"))
        for event in self._events:
            line = _label(f"{event.time_s:12.3f}")
            line.append(f"  {event.text}")
            lines.append(line)
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
        left = f" hapticd {status['version']}  {status['device']}  {wording.si(status['rate_hz'], 'Hz')}"
        connection = cast("dict[str, Any]", status.get("connection") or {})
        held = status["forces"] == "on" and connection.get("signs", {}).get("state") in ("checking", "waiting")
        right = "signs are checked " if held else f"forces {status['forces']} "
        style = (
            "black on yellow"
            if held
            else {"on": "black on green", "off": "black on yellow"}.get(status["forces"], "bold white on red")
        )
        line = Text()
        line.append(left.ljust(max(0, width - len(right))), style="reverse")
        line.append(right, style=style)
        return line

    def _panel(self) -> list[Text]:
        lines: list[Text] = []

        def put(label: str, value: str, style: str = "") -> None:
            line = _label(f"{label:<11}")
            line.append(value, style=style)
            lines.append(line)

        state, status = self.state, self.status
        if state is None:
            return lines
        x, y = (1e3 * value for value in state["position_m"])
        put("position", f"{x:+8.3f} {y:+8.3f} mm")
        vx, vy = (1e3 * value for value in state["velocity_m_per_s"])
        put("velocity", f"{vx:+8.1f} {vy:+8.1f} mm/s")
        scale = _nice(self._largest_n)
        contact, vibration = math.hypot(*state["contact_force_n"]), math.hypot(*state["vibration_force_n"])
        for label, value in (("force x", state["force_n"][0]), ("force y", state["force_n"][1])):
            line = _label(f"{label:<11}")
            line.append(signed_bar(value, scale, _BAR), style="cyan")
            line.append(f" {value:+.2f} N")
            lines.append(line)
        for label, value in (("contact", contact), ("vibration", vibration)):
            line = _label(f"{label:<11}")
            line.append(bar(value, scale, _BAR), style="green")
            line.append(f"  {value:.2f} N")
            lines.append(line)
        touching = state.get("touching", [])
        put("touching", ", ".join(touching) or "nothing", "bold" if touching else "")
        lines.append(Text())
        put("rate", "" if self.rate_hz is None else f"{self.rate_hz:,.0f} Hz")
        late = [value / 1e3 for value in self._lateness]
        put("lateness", f"{late[-1]:.0f} us, worst seen {max(late):.0f}")
        put("work", f"{state['work_ns']} ns")
        put("tick", f"{state['tick']:,}")
        put("revision", f"{state['revision']:,}")
        if status is not None:
            counters = status["counters"]
            overruns, skipped = counters.get("overruns", 0), counters.get("skipped", 0)
            put("missed", wording.count(skipped, "period"), "yellow" if skipped else "")
            put("", f"{wording.count(overruns, 'time')}" if skipped else "")
            faults = status["faults"]
            put("faults", ", ".join(faults) or "none", "bold red" if faults else "")
            if status["lease_s"] is not None:
                put("lease", f"{status['lease_s']:.1f} s left")
        return lines

    def _picture(self, columns: int, rows: int) -> list[Text]:
        # A character is about twice as high as wide.
        cell_m = 2 * self._half_m / max(1, 2 * min(rows, columns // 2))
        key = (columns, rows, cell_m, self.scene_revision, frozenset(self._punctured))
        if self._background is None or self._background[0] != key:
            self._background = (key, draw_scene(self.scene, columns, rows, cell_m, self._punctured))
        lines = [_label("".join(line)) for line in self._background[1]]
        if self.state is not None:
            x, y = self.state["position_m"]
            column = math.floor(x / cell_m + columns / 2)
            row = math.floor(rows / 2 - y / (2 * cell_m))
            if 0 <= row < rows and 0 <= column < columns:
                touched = bool(self.state.get("touching"))
                line = "".join(self._background[1][row])
                lines[row] = _label(line[:column])
                lines[row].append("●", style="bold red" if touched else "bold")
                lines[row].append(line[column + 1 :], style="dim")
        return lines

    def line(self) -> str:
        """The state as one plain line."""
        state, status = self.state, self.status
        if state is None:
            return "no state yet"
        x, y = (1e3 * value for value in state["position_m"])
        fx, fy = state["force_n"]
        faults = ", ".join(status["faults"]) if status is not None else ""
        parts = [
            f"tick {state['tick']:,}",
            f"position {x:+.3f} {y:+.3f} mm",
            f"force {fx:+.3f} {fy:+.3f} N",
            f"touching {', '.join(state.get('touching', [])) or 'nothing'}",
            f"rate {self.rate_hz:,.0f} Hz" if self.rate_hz is not None else "",
            f"lateness {max(self._lateness) / 1e3:.0f} us at worst",
            f"{wording.count(status['counters'].get('skipped', 0), 'period')} missed" if status is not None else "",
            f"forces {status['forces']}" if status is not None else "",
            f"faults {faults}" if faults else "",
        ]
        return "  ".join(part for part in parts if part)


def _label(text: str) -> Text:
    """Dim text that others can be appended to: a style of the whole would be theirs too."""
    label = Text()
    label.append(text, style="dim")
    return label


# ---- pieces of text ----------------------------------------------------------------------------------------


def event_line(event: Mapping[str, object]) -> str:
    """An event in words: its kind, its object, and its other members."""
    kind, about = str(event.get("event", "event")), event.get("object")
    words = [kind.replace("_", " "), *([str(about)] if about is not None else [])]
    match kind:
        case "contact" if not event.get("appeared"):
            words.append(
                f"at {_number(event, 'speed_m_per_s'):.3f} m/s, {_number(event, 'amplitude_m_per_s2'):.1f} m/s²"
            )
            if _number(event, "scale", 1.0) == 0:
                words.append("not displayed")
            elif _number(event, "scale", 1.0) < 1:
                words.append(f"scaled to {_number(event, 'scale'):.2f} by the force limit")
        case "contact":
            words.append("inside it when it appeared")
        case "groove":
            words.append(f"{_number(event, 'grooves'):.0f} struck in this contact")
        case "puncture":
            words.append(f"at {1e3 * _number(event, 'depth_m'):.2f} mm")
        case "saturation":
            words.append(f"wanted {_number(event, 'wanted_n'):.2f} N")
        case "overrun":
            words.append(f"{wording.count(round(_number(event, 'missed')), 'period')} missed")
        case "glitch":
            words.append(f"a jump of {_number(event, 'speed_m_per_s'):.0f} m/s")
        case "fault":
            faults = event.get("faults")
            words.append(", ".join(map(str, faults)) if isinstance(faults, list) and faults else "cleared")
        case "overload":
            words.append(f"{wording.percent(_number(event, 'missed_share'), 2)} of a second's periods missed")
        case "rate":
            words.append(f"{wording.si(_number(event, 'rate_hz'), 'Hz')} from now on")
        case "resumed":
            words.append(f"after {wording.duration(round(_number(event, 'suspended_s')))} of suspend")
        case "memory_refused":
            words.append(str(event.get("problem")))
        case "mark":
            words.append(str(event.get("text")))
        case "gesture_end":
            words.append("as it was meant" if event.get("completed") else "replaced by another")
        case "revision":
            words.append(str(event.get("revision")))
    return " ".join(words)


def _number(event: Mapping[str, object], key: str, default: float = 0.0) -> float:
    value = event.get(key, default)
    return float(value) if isinstance(value, int | float) else default


def bar(value: float, scale: float, width: int) -> str:
    """A bar from the left, `width` columns for `scale`."""
    filled = min(width, round(abs(value) / scale * width))
    return "█" * filled + "·" * (width - filled)


def signed_bar(value: float, scale: float, width: int) -> str:
    """A bar from the middle of `width` columns, to the left for negative values."""
    half = width // 2
    filled = min(half, round(abs(value) / scale * half))
    empty = "·" * (half - filled)
    return f"{empty}{'█' * filled}│{'·' * half}" if value < 0 else f"{'·' * half}│{'█' * filled}{empty}"


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


_Messages: TypeAlias = Subscription[tuple[Topic, dict[str, object]]]


def _draw(client: Client, messages: _Messages, console: Console, lasts_s: float) -> bool:
    """Draws until the time is over (true) or the terminal is gone (false)."""
    view = View()
    heard = shown = time.monotonic()
    asked, ends_s = -math.inf, math.inf
    with Live(console=console, screen=True, auto_refresh=False) as live:
        view.feed("status", client.get_status())
        while (now := time.monotonic()) < ends_s:
            item = messages.receive(min(REFRESH_S, ends_s - now))
            now = time.monotonic()
            if item is not None:
                heard, ends_s = now, min(ends_s, now + lasts_s)
                view.feed(*item)
            elif now - heard > LOST_AFTER_S:
                view.lost_for_s = now - heard
            if view.wants_scene and now - asked > 1.0:
                asked = now
                # Asked again if there is no answer; that the daemon is gone shows by its silence.
                with suppress(HapticdError):
                    answer = client.get_scene()
                    view.set_scene(answer["scene"], answer["revision"])
            if now - shown >= REFRESH_S:
                shown = now
                if not console.file.isatty():
                    return False
                live.update(view.render(*console.size), refresh=True)
    return True


def _lines(client: Client, messages: _Messages, as_json: bool, lasts_s: float) -> Iterator[str]:
    view = View()
    heard = time.monotonic()
    due, ends_s = -math.inf, math.inf
    view.feed("status", client.get_status())
    while (now := time.monotonic()) < ends_s:
        item = messages.receive(min(LOST_AFTER_S, ends_s - now))
        now = time.monotonic()
        if item is None:
            if now - heard < LOST_AFTER_S:
                continue
            if view.lost_for_s is None:
                yield json.dumps({"topic": "lost"}) if as_json else "daemon lost; waiting for it"
            view.lost_for_s = now - heard
            continue
        topic, message = item
        heard, ends_s = now, min(ends_s, now + lasts_s)
        view.feed(topic, message)
        if topic == "event" and as_json:
            yield json.dumps({"topic": topic, **message})
        elif topic == "event" and message.get("event") not in _QUIET_EVENTS:
            yield event_line(message)
        elif topic == "state" and now >= due:
            due = now + 1.0
            yield json.dumps({"topic": topic, **message}) if as_json else view.line()
