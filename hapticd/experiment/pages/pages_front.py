"""The front of a session in the browser: the screens of both pages, and the messages from them.

The session's thread calls the methods of `Front`, which block. The event loop calls `go_on`, `answer`, `command`,
`here` and `set_auto`, which do not block. A screen is never edited: a new one replaces it under one lock, and then
`changed` is called.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from hapticd.base.yaml_source import Json
from hapticd.experiment.front import CLEARANCE_POLL_S, Command, Reply, Seen, Shown, Watched
from hapticd.experiment.pages import screens
from hapticd.experiment.pages.console import Console, Doing, Row, rows_of
from hapticd.experiment.pages.screens import Screen
from hapticd.experiment.plan import Plan
from hapticd.experiment.replies import typed_reply
from hapticd.experiment.session_log import Record
from hapticd.experiment.stage import Stage

Who: TypeAlias = Literal["participant", "experimenter"]
LOOKED_AFTER_S: Final = 0.5
"""Interval at which the stage is checked while a page is waited for, in seconds."""
STUCK_S: Final = 3.0
"""The pages' server counts as stuck if it did not report for this time, in seconds."""
_WAIT: Final = "Please wait for the experimenter."
_EXPERIMENTER_AWAY: Final = (
    "The experimenter is away. The session waits, without forces, until the experimenter is back and continues it."
)
_NAMES: Final = {"participant": "the participant's page", "experimenter": "the experimenter's page"}


@dataclass(frozen=True, slots=True)
class _GoOn:
    who: Who
    screen: int


@dataclass(frozen=True, slots=True)
class _Answer:
    screen: int
    reply: Reply


class _Look:
    """A page was opened or closed, or automatic trials were switched on or off."""


_Said: TypeAlias = "_GoOn | _Answer | _Look | Command"


class PagesFront:
    """The front of a session whose participant and experimenter each have a page."""

    def __init__(self, plan: Plan, changed: Callable[[], None]) -> None:
        """`changed` is called from any thread when the content of a page has changed."""
        self._plan, self._changed = plan, changed
        self._lock = threading.Lock()
        self._inbox: queue.SimpleQueue[_Said] = queue.SimpleQueue()
        self._screen: Screen = {**screens.wait(_WAIT), "screen": 0}
        self._shown: Shown | None = None
        self._console = Console(
            plan.study.title, plan.participant, plan.session, len(plan.trials), plan.study.may_end_early
        )
        self._rows: list[Row] = []
        self._told = ""
        self._stopped = threading.Event()
        self._server_s: float | None = None
        """Time of the last report of the pages' server, on time.monotonic; None: there is no server."""
        self._until_s = 0.0
        """End of the current screen's time limit, or of its shortest break, on time.monotonic."""
        self._least_s = 0.0
        """Shortest duration of the current break, in seconds."""

    # ---- Content of the pages; for any thread -------------------------------------------------------------------

    @property
    def screen(self) -> Screen:
        """The screen of the participant's page. Of a break, `least_s` is what is left of its shortest duration."""
        with self._lock:
            return {**self._screen, "least_s": self._left_s()} if self._console.doing == "rests" else self._screen

    @property
    def notice(self) -> str:
        """What the participant's page says beside its screen: that the experimenter is away; else nothing."""
        with self._lock:
            present = self._console.here["experimenter"] or self._console.doing == "over"
        return "" if present else _EXPERIMENTER_AWAY

    @property
    def surfaces(self) -> Sequence[Seen]:
        """The surfaces of the current trial."""
        with self._lock:
            shown, screen = self._shown, self._screen
        return () if shown is None else shown.surfaces_of(int(str(screen["interval"])))

    def console(self) -> dict[str, Any]:
        """The content of the experimenter's page without the answers; `answers` is their number.

        `least_s` is the shortest duration of a break, `left_s` what is left of it; both are 0 where nothing rests.
        """
        with self._lock:
            rests = self._console.doing == "rests"
            least_s, left_s = (self._least_s, self._left_s()) if rests else (0.0, 0.0)
            return {**self._console.to_dict(), "answers": len(self._rows), "least_s": least_s, "left_s": left_s}

    def rows(self, since: int = 0) -> list[dict[str, Any]]:
        """The answers from index `since` on."""
        with self._lock:
            return [row.to_dict() for row in self._rows[since:]]

    # ---- What the pages say; for the event loop ---------------------------------------------------------------

    def here(self, who: Who, is_here: bool) -> None:
        """Stores whether the page of `who` is open and responds."""
        with self._lock:
            self._console.here = {**self._console.here, who: is_here}
        self._inbox.put(_Look())
        self._changed()

    def set_auto(self, auto: bool) -> None:
        """Switches automatic trials on or off."""
        with self._lock:
            self._console.auto = auto
        self._inbox.put(_Look())
        self._changed()

    def go_on(self, who: Who, screen: int) -> None:
        """A button to continue was pressed on a screen. A press on an earlier screen has no effect."""
        self._inbox.put(_GoOn(who, screen))

    def command(self, command: Command) -> None:
        """The experimenter gave a command, or either person pressed the stop (`abort`)."""
        if command.kind == "abort":
            self._stopped.set()
        self._inbox.put(command)

    def answer(self, screen: int, value: object) -> None:
        """Takes the answer to a screen. One to an earlier screen has no effect. Raises ValueError: it is invalid."""
        with self._lock:
            shown, current = self._shown, self._screen
        if shown is None or current["screen"] != screen or current.get("question") is None:
            return
        self._inbox.put(_Answer(screen, Reply(_value_of(shown, value))))

    # ---- The session's thread ---------------------------------------------------------------------------------

    def opened(self, records: Sequence[Record]) -> None:
        """Shows the answers that the session's log already has."""
        with self._lock:
            self._rows = rows_of(records, self._plan.trials)
        self._changed()

    def over(self, told: str, participant: str, complete: bool) -> None:
        """Shows that the session has ended, or will be continued later. Only the last trial of a session that is
        complete has its feedback here."""
        self._show(screens.over(f"{participant}\n\n{self._told if complete else ''}"), "over")
        self.tell(told)

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        self._set(done=done, total=total, at_most=at_most)
        self._show(screens.read(f"# {title}\n\n{instructions}\n\n---\n\n{_WAIT}", None), "begins", "Begin")
        return self._until_gone_on("experimenter")

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        self._set(phase=phase)
        if instructions is None and phase == "test":
            return None
        self._show(screens.read(f"## {phase.capitalize()}\n\n{instructions or ''}", "Go on"), "reads", "Go on")
        return self._until_gone_on("participant", "experimenter")

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        self._set(trial=watched, phase=shown.phase, asked=shown.text, done=shown.number - 1)
        # What is told of the trial before stays on the next screen: where trials begin by themselves this one is short.
        screen = screens.trial(shown, interval=1, felt=False, asks=False, told=self._told)
        self._show(screen, "armed", "Let the forces on", shown)
        return self._until_gone_on("experimenter", by_itself=True)

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        screen = screens.trial(shown, interval=interval, felt=False, asks=False, withdraws=True, told=self._told)
        self._show(screen, "withdraws", None, shown)
        while not stage.is_clear():
            said = self._wait(lambda each: None, deadline=time.monotonic() + CLEARANCE_POLL_S) or self._away()
            if isinstance(said, Command):
                return said
        return None

    def may_enable(self) -> Command | None:
        if self._stopped.is_set():
            return Command("abort", "the stop was pressed")
        return self._away()

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        self._show_felt(shown, interval, asks=False)
        said = self._wait(lambda each: _gone_on(each, ("participant",)), stage=stage)
        return said if isinstance(said, Command) else None

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        self._show_felt(shown, shown.stimuli, asks=True)
        said = self._wait(lambda each: each.reply if isinstance(each, _Answer) else None, stage, self._until_s)
        return Reply(None, timed_out=True) if said is None else said

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        row = Row(watched.index, watched.condition, watched.cell, watched.stimuli, answer, correct, response_s)
        with self._lock:
            self._rows.append(row)
            self._console.done += 1
        self._changed()

    def feedback(self, told: str, right: str | None) -> None:
        self._told = told

    def not_done(self, trial: int, why: str) -> None:
        self._told = f"{why} The trial begins again."
        self.tell(f"trial {trial} begins again: {why}")

    def rest(self, text: str | None, least_s: float) -> Command | None:
        if self._console.doing != "rests":
            self._least_s, self._until_s = least_s, time.monotonic() + least_s
            self._show(screens.read(text or "A break.", "Go on", least_s), "rests", "Go on")
        said = self._wait(self._too_early, deadline=self._until_s)
        return said if isinstance(said, Command) else self._until_gone_on("participant", "experimenter")

    def _too_early(self, said: _Said | None) -> None:
        """Shows the remaining time to an experimenter who continues before the shortest break is over."""
        if said is not None and _gone_on(said, ("experimenter",)) is not None:
            self.tell(f"The break lasts at least {self._least_s:g} s: {math.ceil(self._left_s())} s left")

    def _left_s(self) -> float:
        return max(0.0, self._until_s - time.monotonic())

    def paused(self) -> Command | None:
        self._show(screens.wait(f"A pause.\n\n{_WAIT}"), "paused", "Go on")
        while (said := self._until_gone_on("experimenter")) is not None and said.kind == "pause":
            pass  # it is one already
        return said

    def tell(self, line: str) -> None:
        with self._lock:
            self._console.say(line)
        self._changed()

    # ---- How it is shown and waited for -----------------------------------------------------------------------

    def _set(self, **members: Any) -> None:
        with self._lock:
            for name, value in members.items():
                setattr(self._console, name, value)

    def _show_felt(self, shown: Shown, interval: int, asks: bool) -> None:
        """Shows a trial while the forces are on. After a note the screen and its time limit stay as they are."""
        screen = self._screen
        same = screen.get("felt") and (screen["interval"], screen["question"] is not None) == (interval, asks)
        if self._shown is shown and same:
            return
        limit_s = shown.time_limit_s if asks else None
        self._until_s = math.inf if limit_s is None else time.monotonic() + limit_s
        told, self._told = self._told, ""
        felt = screens.trial(shown, interval=interval, felt=True, asks=asks, left_s=limit_s, told=told)
        self._show(felt, "felt", None, shown)

    def _show(self, screen: Screen, doing: Doing, goes_on: str | None = None, shown: Shown | None = None) -> None:
        """Replaces the screen; the new one has the next number."""
        with self._lock:
            self._console.screen += 1
            self._console.doing, self._console.goes_on = doing, goes_on
            self._screen = {**screen, "screen": self._console.screen}
            self._shown = shown
        self._changed()

    def server_runs(self) -> None:
        """The pages' server calls this a few times a second. While it is stuck, a stop would not be received."""
        self._server_s = time.monotonic()

    def _missing(self) -> list[str]:
        with self._lock:
            missing = [name for who, name in _NAMES.items() if not self._console.here[who]]
        stuck = self._server_s is not None and time.monotonic() - self._server_s > STUCK_S
        return [*missing, "the pages' server"] if stuck else missing

    def _away(self) -> Command | None:
        """A pause if a page is closed or does not respond, else None."""
        missing = self._missing()
        if not missing:
            return None
        line = f"paused: {' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} away"
        self.tell(line)
        return Command("pause", line)

    def _until_gone_on(self, *who: Who, by_itself: bool = False) -> Command | None:
        """Waits until one of them continues while both pages are open. `by_itself`: not if trials are automatic.

        A participant who continues while the experimenter is away does so when the experimenter is back.
        """
        willing = False

        def taken(said: _Said | None) -> bool | None:
            nonlocal willing
            with self._lock:
                auto = by_itself and self._console.auto
                here = self._console.here["participant"]
            pressed = isinstance(said, _GoOn) and said.who in who
            willing = here and (willing or (isinstance(said, _GoOn) and pressed and said.who == "participant"))
            missing = self._missing()
            if missing and pressed and not auto:
                self.tell(f"{' and '.join(missing)} must be open to go on")
            return True if (auto or pressed or willing) and not missing else None

        if taken(None):
            # What was said before this screen is heard first.
            return self._commanded()
        said = self._wait(taken)
        return said if isinstance(said, Command) else None

    def _commanded(self) -> Command | None:
        while True:
            try:
                said = self._inbox.get_nowait()
            except queue.Empty:
                return None
            if isinstance(said, Command):
                return said

    def _wait(
        self, taken: Callable[[_Said], Any], stage: Stage | None = None, deadline: float = math.inf
    ) -> Any | Command | None:
        """Waits for a message to this screen. Returns the result of `taken`, or a command; None at the deadline.

        With a `stage` the forces are on. Then the stage is checked, and a page that is closed causes a pause.
        """
        number, look_s = self.screen["screen"], 0.0
        while (left_s := deadline - time.monotonic()) > 0:
            if stage is not None:
                if (away := self._away()) is not None:
                    return away
                if time.monotonic() >= look_s:
                    stage.check()
                    look_s = time.monotonic() + LOOKED_AFTER_S
            try:
                said = self._inbox.get(timeout=min(LOOKED_AFTER_S, left_s))
            except queue.Empty:
                continue
            if isinstance(said, Command):
                return said
            if isinstance(said, _GoOn | _Answer) and said.screen != number:
                continue
            found = taken(said)
            if found is not None:
                return found
        return None


def _gone_on(said: _Said, who: Sequence[Who]) -> bool | None:
    return True if isinstance(said, _GoOn) and said.who in who else None


def _value_of(shown: Shown, value: object) -> str | float | None:
    """The answer of a page in the form of the data. Raises ValueError if it is invalid."""
    if shown.kind == "measure":
        return None
    if shown.kind == "choice":
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < len(shown.answers):
            raise ValueError(f"answer: must be a number from 0 to {len(shown.answers) - 1}")
        return shown.answers[value].name
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError("answer: must be a text or a number")
    return typed_reply(shown, value if isinstance(value, str) else repr(float(value)))
