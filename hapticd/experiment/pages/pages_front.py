"""The front (user interface) of a session in the browser: content of both pages, and messages from them.

The session's thread calls the methods of `Front`, which block. The event loop calls `go_on`, `answer`, `command`,
`here` and `set_auto`, which do not block. A screen is never modified: a new screen replaces it under a lock, and then
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
from hapticd.experiment.front import CLEARANCE_POLL_S, STAGE_CHECK_INTERVAL_S, Command, Reply, Seen, Shown, Watched
from hapticd.experiment.pages import screens
from hapticd.experiment.pages.console import Console, Doing, Row, rows_of
from hapticd.experiment.pages.screens import Screen
from hapticd.experiment.plan import Plan
from hapticd.experiment.replies import typed_reply
from hapticd.experiment.session_log import Record
from hapticd.experiment.stage import Stage

Who: TypeAlias = Literal["participant", "experimenter"]
PAGES_SERVER_TIMEOUT_S: Final = 3.0
"""The server of the pages counts as stuck if it does not call `server_runs` for this time."""
_WAIT_TEXT: Final = "Please wait for the experimenter."
_EXPERIMENTER_AWAY_TEXT: Final = (
    "The experimenter is away. The session waits, without forces, until the experimenter is back and continues it."
)
_PAGE_NAMES: Final = {"participant": "the participant's page", "experimenter": "the experimenter's page"}


@dataclass(frozen=True, slots=True)
class _Continue:
    who: Who
    screen: int


@dataclass(frozen=True, slots=True)
class _Answer:
    screen: int
    reply: Reply


class _StateChanged:
    """The message that a page was opened or closed, or that automatic trials were switched on or off."""


_PageMessage: TypeAlias = "_Continue | _Answer | _StateChanged | Command"


class PagesFront:
    """The user interface of a session with two pages, for participant and experimenter; see `Front` for the methods."""

    def __init__(self, plan: Plan, changed: Callable[[], None]) -> None:
        """Create the user interface for the session of a plan.

        `changed` is called, from any thread, when the content of a page has changed.
        """
        self._plan, self._changed = plan, changed
        self._lock = threading.Lock()
        self._inbox: queue.SimpleQueue[_PageMessage] = queue.SimpleQueue()
        self._screen: Screen = {**screens.wait(_WAIT_TEXT), "screen": 0}
        self._shown: Shown | None = None
        self._console = Console(
            plan.study.title, plan.participant, plan.session, len(plan.trials), plan.study.may_end_early
        )
        self._rows: list[Row] = []
        self._feedback = ""
        self._stopped = threading.Event()
        self._server_s: float | None = None
        """Time of the last call of `server_runs`, in s of time.monotonic; None without a server."""
        self._until_s = 0.0
        """End of the time limit of an answer, or of the shortest duration of a break, in s of time.monotonic."""
        self._least_s = 0.0
        """Shortest duration of the current break, in s."""

    # ---- Content of the pages; for any thread ---------------------------------------------------------------------

    @property
    def screen(self) -> Screen:
        """The screen of the participant's page. During a break `least_s` is the time in s until the break may end."""
        with self._lock:
            return {**self._screen, "least_s": self._left_s()} if self._console.doing == "rests" else self._screen

    @property
    def notice(self) -> str:
        """Notice on the participant's page that the experimenter is away, or an empty text."""
        with self._lock:
            present = self._console.here["experimenter"] or self._console.doing == "over"
        return "" if present else _EXPERIMENTER_AWAY_TEXT

    @property
    def surfaces(self) -> Sequence[Seen]:
        """The surfaces that the participant's page shows: those of the current interval, none without a trial."""
        with self._lock:
            shown, screen = self._shown, self._screen
        return () if shown is None else shown.surfaces_of(int(str(screen["interval"])))

    def console(self) -> dict[str, Any]:
        """Return the content of the experimenter's page as JSON data, with the number of answers, not the answers.

        During a break `least_s` is its shortest duration and `left_s` the time until it may end, in s, otherwise 0.
        """
        with self._lock:
            rests = self._console.doing == "rests"
            least_s, left_s = (self._least_s, self._left_s()) if rests else (0.0, 0.0)
            return {**self._console.to_dict(), "answers": len(self._rows), "least_s": least_s, "left_s": left_s}

    def rows(self, since: int = 0) -> list[dict[str, Any]]:
        """Return the saved answers of the session from index `since` on, as JSON data."""
        with self._lock:
            return [row.to_dict() for row in self._rows[since:]]

    # ---- Messages of the pages; for the event loop --------------------------------------------------------------

    def here(self, who: Who, is_here: bool) -> None:
        """Receive whether the page of `who` is open and responds."""
        with self._lock:
            self._console.here = {**self._console.here, who: is_here}
        self._inbox.put(_StateChanged())
        self._changed()

    def set_auto(self, auto: bool) -> None:
        """Receive whether trials begin automatically."""
        with self._lock:
            self._console.auto = auto
        self._inbox.put(_StateChanged())
        self._changed()

    def go_on(self, who: Who, screen: int) -> None:
        """Receive a press of the button to continue on a screen. A press on an earlier screen has no effect."""
        self._inbox.put(_Continue(who, screen))

    def command(self, command: Command) -> None:
        """Receive a command of the experimenter, or `abort`, which the stop button of either page sends."""
        if command.kind == "abort":
            self._stopped.set()
        self._inbox.put(command)

    def answer(self, screen: int, value: object) -> None:
        """Receive the answer to the question of a screen. An answer to an earlier screen has no effect.

        Raises ValueError if the answer is invalid.
        """
        with self._lock:
            shown, current = self._shown, self._screen
        if shown is None or current["screen"] != screen or current.get("question") is None:
            return
        self._inbox.put(_Answer(screen, Reply(_value_of(shown, value))))

    # ---- The session's thread ---------------------------------------------------------------------------------

    def opened(self, records: Sequence[Record]) -> None:
        """Show the experimenter the answers in the records of the session's log, before the session continues."""
        with self._lock:
            self._rows = rows_of(records, self._plan.trials)
        self._changed()

    def over(self, line: str, text: str, complete: bool) -> None:
        """Show `line` to the experimenter and `text` to the participant, after the end of the run.

        The participant reads the feedback on the last trial only if the session is complete.
        """
        self._show(screens.over(f"{text}\n\n{self._feedback if complete else ''}"), "over")
        self.show_line(line)

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        """Show the instructions of a study, and wait until the experimenter begins the session."""
        self._set(done=done, total=total, at_most=at_most)
        self._show(screens.read(f"# {title}\n\n{instructions}\n\n---\n\n{_WAIT_TEXT}", None), "begins", "Begin")
        return self._wait_to_continue("experimenter")

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        """Show the instructions of a phase, if any, and wait until participant or experimenter continues."""
        self._set(phase=phase)
        if instructions is None and phase == "test":
            return None
        self._show(screens.read(f"## {phase.capitalize()}\n\n{instructions or ''}", "Continue"), "reads", "Continue")
        return self._wait_to_continue("participant", "experimenter")

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        """Show that a trial is ready, and wait until the experimenter enables the forces."""
        self._set(trial=watched, phase=shown.phase, asked=shown.text, done=shown.number - 1)
        # The feedback on the previous trial is kept for the next screen: with automatic trials this screen is short.
        screen = screens.trial(shown, interval=1, felt=False, asks=False, feedback=self._feedback)
        self._show(screen, "armed", "Enable the forces", shown)
        return self._wait_to_continue("experimenter", automatic=True)

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Ask the participant to move the stylus out, and wait until the handle is clear of all objects."""
        screen = screens.trial(
            shown, interval=interval, felt=False, asks=False, withdraws=True, feedback=self._feedback
        )
        self._show(screen, "withdraws", None, shown)
        while not stage.is_clear():
            message = (
                self._wait(lambda each: None, deadline=time.monotonic() + CLEARANCE_POLL_S) or self._pause_if_away()
            )
            if isinstance(message, Command):
                return message
        return None

    def may_enable(self) -> Command | None:
        """Return a command that keeps the forces off, or None: an abort after a stop, a pause if a page is away."""
        if self._stopped.is_set():
            return Command("abort", "the stop was pressed")
        return self._pause_if_away()

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Let the participant feel an interval of the trial, and wait until the participant continues."""
        self._show_felt(shown, interval, asks=False)
        message = self._wait(lambda each: _continued(each, ("participant",)), stage=stage)
        return message if isinstance(message, Command) else None

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        """Show the last interval and the question of a trial, and wait for the answer."""
        self._show_felt(shown, shown.stimuli, asks=True)
        message = self._wait(lambda each: each.reply if isinstance(each, _Answer) else None, stage, self._until_s)
        return Reply(None, timed_out=True) if message is None else message

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        """Show a saved answer to the experimenter."""
        row = Row(watched.index, watched.condition, watched.cell, watched.stimuli, answer, correct, response_s)
        with self._lock:
            self._rows.append(row)
            self._console.done += 1
        self._changed()

    def feedback(self, text: str, right: str | None) -> None:
        """Keep the feedback on a trial for the participant's next screen."""
        self._feedback = text

    def not_done(self, trial: int, why: str) -> None:
        """Keep the reason why a trial begins again for the participant's next screen; show it to the experimenter."""
        self._feedback = f"{why} The trial begins again."
        self.show_line(f"trial {trial} begins again: {why}")

    def rest(self, text: str | None, least_s: float) -> Command | None:
        """Show a break, and wait for its shortest duration, and until participant or experimenter continues."""
        if self._console.doing != "rests":
            self._least_s, self._until_s = least_s, time.monotonic() + least_s
            self._show(screens.read(text or "A break.", "Continue", least_s), "rests", "Continue")
        message = self._wait(self._too_early, deadline=self._until_s)
        return message if isinstance(message, Command) else self._wait_to_continue("participant", "experimenter")

    def _too_early(self, message: _PageMessage | None) -> None:
        """If the experimenter presses "Continue" too early, show how long the break still lasts."""
        if message is not None and _continued(message, ("experimenter",)) is not None:
            self.show_line(f"The break lasts at least {self._least_s:g} s: {math.ceil(self._left_s())} s left")

    def _left_s(self) -> float:
        return max(0.0, self._until_s - time.monotonic())

    def paused(self) -> Command | None:
        """Show a pause, and wait until the experimenter continues."""
        self._show(screens.wait(f"A pause.\n\n{_WAIT_TEXT}"), "paused", "Continue")
        while (message := self._wait_to_continue("experimenter")) is not None and message.kind == "pause":
            pass  # the session is already paused
        return message

    def show_line(self, line: str) -> None:
        """Append a line to the log on the experimenter's page."""
        with self._lock:
            self._console.say(line)
        self._changed()

    # ---- Showing screens and waiting for messages ---------------------------------------------------------------

    def _set(self, **members: Any) -> None:
        with self._lock:
            for name, value in members.items():
                setattr(self._console, name, value)

    def _show_felt(self, shown: Shown, interval: int, asks: bool) -> None:
        """Show a trial whose forces are on. If the screen already shows it, screen and time limit are unchanged."""
        screen = self._screen
        same = screen.get("felt") and (screen["interval"], screen["question"] is not None) == (interval, asks)
        if self._shown is shown and same:
            return
        limit_s = shown.time_limit_s if asks else None
        self._until_s = math.inf if limit_s is None else time.monotonic() + limit_s
        feedback, self._feedback = self._feedback, ""
        felt = screens.trial(shown, interval=interval, felt=True, asks=asks, left_s=limit_s, feedback=feedback)
        self._show(felt, "felt", None, shown)

    def _show(self, screen: Screen, doing: Doing, goes_on: str | None = None, shown: Shown | None = None) -> None:
        """Replace the screen of the participant's page. The number of the screen increases by one."""
        with self._lock:
            self._console.screen += 1
            self._console.doing, self._console.goes_on = doing, goes_on
            self._screen = {**screen, "screen": self._console.screen}
            self._shown = shown
        self._changed()

    def server_runs(self) -> None:
        """Store that the server of the pages runs, a few times per second: a stuck server would not receive a stop."""
        self._server_s = time.monotonic()

    def _missing(self) -> list[str]:
        with self._lock:
            missing = [name for who, name in _PAGE_NAMES.items() if not self._console.here[who]]
        stuck = self._server_s is not None and time.monotonic() - self._server_s > PAGES_SERVER_TIMEOUT_S
        return [*missing, "the pages' server"] if stuck else missing

    def _pause_if_away(self) -> Command | None:
        """Return the command to pause if a page, or the server of the pages, does not respond, else None."""
        missing = self._missing()
        if not missing:
            return None
        line = f"paused: {' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} away"
        self.show_line(line)
        return Command("pause", line)

    def _wait_to_continue(self, *who: Who, automatic: bool = False) -> Command | None:
        """Wait until one of `who` continues while both pages are open. Returns a command that ends the wait, or None.

        With `automatic`, the wait ends immediately if trials begin automatically. If the participant continues while
        the experimenter is away, the wait ends when the experimenter is back.
        """
        willing = False

        def accept(message: _PageMessage | None) -> bool | None:
            nonlocal willing
            with self._lock:
                auto = automatic and self._console.auto
                here = self._console.here["participant"]
            pressed = isinstance(message, _Continue) and message.who in who
            willing = here and (
                willing or (isinstance(message, _Continue) and pressed and message.who == "participant")
            )
            missing = self._missing()
            if missing and pressed and not auto:
                self.show_line(f"{' and '.join(missing)} must be open to continue")
            return True if (auto or pressed or willing) and not missing else None

        if accept(None):
            # A command that was given before this screen takes effect first.
            return self._pending_command()
        message = self._wait(accept)
        return message if isinstance(message, Command) else None

    def _pending_command(self) -> Command | None:
        while True:
            try:
                message = self._inbox.get_nowait()
            except queue.Empty:
                return None
            if isinstance(message, Command):
                return message

    def _wait(
        self, accept: Callable[[_PageMessage], Any], stage: Stage | None = None, deadline: float = math.inf
    ) -> Any | Command | None:
        """Wait for a message about the current screen for which `accept` does not return None, and return its result.

        Returns instead a command that comes meanwhile, or None at the deadline. A `stage` means that the forces are on:
        `stage.check` is called, and a closed page causes a pause.
        """
        number, next_check_s = self.screen["screen"], 0.0
        while (left_s := deadline - time.monotonic()) > 0:
            if stage is not None:
                if (away := self._pause_if_away()) is not None:
                    return away
                if time.monotonic() >= next_check_s:
                    stage.check()
                    next_check_s = time.monotonic() + STAGE_CHECK_INTERVAL_S
            try:
                message = self._inbox.get(timeout=min(STAGE_CHECK_INTERVAL_S, left_s))
            except queue.Empty:
                continue
            if isinstance(message, Command):
                return message
            if isinstance(message, _Continue | _Answer) and message.screen != number:
                continue
            found = accept(message)
            if found is not None:
                return found
        return None


def _continued(message: _PageMessage, who: Sequence[Who]) -> bool | None:
    return True if isinstance(message, _Continue) and message.who in who else None


def _value_of(shown: Shown, value: object) -> str | float | None:
    """Convert the answer of a page to the answer that is stored. Raises ValueError if the answer is invalid."""
    if shown.kind == "measure":
        return None
    if shown.kind == "choice":
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < len(shown.answers):
            raise ValueError(f"answer: must be an integer from 0 to {len(shown.answers) - 1}")
        return shown.answers[value].name
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError("answer: must be a text or a number")
    return typed_reply(shown, value if isinstance(value, str) else repr(float(value)))
