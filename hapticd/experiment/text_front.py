"""The front (user interface) of `--text`: participant and experimenter at one terminal.

An answer is chosen by its key in the study, or by its number. A line that begins with a colon is a command of the
experimenter: `:pause`, `:repeat`, `:note TEXT`, `:abort`. Escape aborts the session like `:abort`. If the input is not
a terminal, each line counts as one key.
"""

from __future__ import annotations

import codecs
import io
import math
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, TextIO, cast

from rich.console import Console
from rich.markdown import Markdown

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.experiment.front import (
    CLEARANCE_POLL_S,
    COMMAND_KINDS,
    STAGE_CHECK_INTERVAL_S,
    Choice,
    Command,
    Reply,
    Shown,
    Watched,
)
from hapticd.experiment.replies import typed_reply
from hapticd.experiment.stage import Stage

_TERMINAL_SEQUENCES: Final = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left", " ": "space"}
"""The characters that a terminal sends for a key, and the name of the key."""
_ESCAPE_KEY: Final = "escape"
_ENTER_KEY: Final = "enter"


class Keys:
    """Reads keys from a terminal, or lines from another input."""

    def __init__(self, stream: TextIO) -> None:
        self._fd = stream.fileno()
        self._terminal = stream.isatty()
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._pending = ""
        self._ended = False

    @contextmanager
    def single(self) -> Iterator[None]:
        """Set the terminal, while the context lasts, to report keys one by one and without echo."""
        if not self._terminal:
            yield
            return
        before = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)
        try:
            yield
        finally:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, before)

    def read(self, timeout_s: float) -> str | None:
        """Return the next key, or None after the timeout.

        From a terminal, a key is a character or a name such as `left`; from another input, it is a line. Raises
        HapticdError at the end of the input.
        """
        return self._await(self._key if self._terminal else self._line, timeout_s)

    def line(self, timeout_s: float, begun: str = "") -> str | None:
        """Return the next line, or None if it is incomplete after the timeout. `begun` was already read of the line."""
        self._pending = begun + self._pending
        return self._await(self._line, timeout_s)

    def _await(self, parse: Callable[[], str | None], timeout_s: float) -> str | None:
        """Read input until `parse` returns a text, and return this text, or None after the timeout."""
        deadline = time.monotonic() + timeout_s
        while (found := parse()) is None:
            if self._ended:
                raise HapticdError("the input has ended; continue with `hapticd experiment resume`")
            ready, _, _ = select.select([self._fd], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                return None
            part = os.read(self._fd, 4096)
            self._ended = not part
            self._pending += self._decoder.decode(part, final=not part)
        return found

    def _line(self) -> str | None:
        line, end, rest = self._pending.partition("\n")
        if not end:
            return None
        self._pending = rest
        return line.rstrip("\r")

    def _key(self) -> str | None:
        text = self._pending
        if not text:
            return None
        for sequence, name in _TERMINAL_SEQUENCES.items():
            if text.startswith(sequence):
                self._pending = text[len(sequence) :]
                return name
        self._pending = text[1:]
        if text[0] == "\x1b":
            # More characters after Escape are an unknown key, which is ignored.
            self._pending = ""
            return _ESCAPE_KEY if len(text) == 1 else ""
        return _ENTER_KEY if text[0] in "\r\n" else text[0]


class TextFront:
    """The user interface of participant and experimenter at one terminal; see `Front` for the methods."""

    def __init__(self, source: TextIO | None = None, out: TextIO | None = None) -> None:
        self._keys = Keys(source or sys.stdin)
        self._out = out or sys.stdout
        if isinstance(self._out, io.TextIOWrapper):
            self._out.reconfigure(errors="replace")  # a terminal may lack a character of the study's texts
        self._console = Console(file=self._out, highlight=False)

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        """Print title, instructions and progress of a session, and wait for Enter."""
        self._say(f"{title}\n")
        self._say_markdown(instructions)
        self._say(f"{done} of {'at most ' if at_most else ''}{wording.count(total, 'trial')} done.")
        self._say("Experimenter: :pause, :repeat, :note TEXT, :abort; Escape aborts the session.")
        return self._wait_for_enter("Press Enter to begin.")

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        """Print the instructions of a phase (practice, training or test), and wait for Enter."""
        if instructions is None and phase == "test":
            return None
        self._say(f"\n{phase.capitalize()}")
        if instructions:
            self._say_markdown(instructions)
        return self._wait_for_enter("Press Enter to continue.")

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        """Print the number of the trial, and wait for Enter."""
        # The names of stimuli are not printed, as the participant could read them at this terminal.
        again = f", attempt {watched.attempt}" if watched.attempt > 1 else ""
        total = f"at most {shown.total}" if shown.at_most else f"{shown.total}"
        self._say(f"\nTrial {shown.number} of {total}{again}. {watched.answered} answered.")
        return self._wait_for_enter("Press Enter to switch the forces on.")

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Ask the participant to withdraw the handle, and wait until the handle is clear of the objects."""
        self._say("Move the stylus away from all surfaces. Then the forces are switched on.")
        with self._keys.single():
            while not stage.is_clear():
                # `stage.check` is not called: if a fault persists, `enable` raises an error.
                typed = self._next(None, time.monotonic() + CLEARANCE_POLL_S)
                if isinstance(typed, Command):
                    return typed
        return None

    def may_enable(self) -> Command | None:
        """Return None: at a terminal, commands are only read while the front waits for input."""
        return None

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Print the number of an interval of the trial, and wait for Enter."""
        self._say(f"Interval {interval} of {shown.stimuli}.")
        return self._wait_for_enter("Press Enter for the next interval.", stage)

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        """Print the question of a trial, and read the answer until the time limit."""
        if shown.stimuli > 1 and not shown.in_places:
            self._say(f"Interval {shown.stimuli} of {shown.stimuli}.")
        self._say_markdown(shown.text)
        limit_s = math.inf if shown.time_limit_s is None else shown.time_limit_s
        deadline = time.monotonic() + limit_s
        match shown.kind:
            case "choice":
                return self._choice(shown.answers, stage, deadline)
            case "measure":
                return self._reply_by_enter("Press Enter when you are done.", stage, deadline)
            case _:
                return self._typed(shown, stage, deadline)

    def feedback(self, text: str, right: str | None) -> None:
        """Print the feedback on a trial."""
        self._say(text)

    def not_done(self, trial: int, why: str) -> None:
        """Print why a motor task was not done."""
        self._say(f"{why} Trial {trial} begins again.")

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        """Print nothing: the participant could read the answer's result at this terminal."""

    def rest(self, text: str | None, least_s: float) -> Command | None:
        """Print the text of a break, and wait for Enter after at least `least_s` seconds."""
        self._say("")
        self._say_markdown(text or "A break.")
        ends = time.monotonic() + least_s
        while (left_s := ends - time.monotonic()) > 0:
            text = f"{wording.duration(math.ceil(left_s))} left before you can continue."
            typed = self._wait_for_enter(text, until=ends)
            if typed is not None:
                return typed
        return self._wait_for_enter("Press Enter to continue.")

    def paused(self) -> Command | None:
        """Print that the session is paused, and wait for Enter."""
        return self._wait_for_enter("\nPaused, the forces are off. Press Enter to continue.")

    def show_line(self, line: str) -> None:
        """Print one line for the experimenter."""
        self._say(line)

    # ---- Output and input --------------------------------------------------------------------------------------

    def _say(self, text: str) -> None:
        print(text, file=self._out, flush=True)

    def _say_markdown(self, text: str) -> None:
        self._console.print(Markdown(text.strip()))

    def _wait_for_enter(self, text: str, stage: Stage | None = None, until: float = math.inf) -> Command | None:
        typed = self._reply_by_enter(text, stage, until)
        return typed if isinstance(typed, Command) else None

    def _reply_by_enter(self, text: str, stage: Stage | None, deadline: float) -> Reply | Command:
        self._say(text)
        with self._keys.single():
            while (typed := self._next(stage, deadline)) is not None:
                if isinstance(typed, Command):
                    return typed
                if typed in (_ENTER_KEY, ""):
                    return Reply(None)
        return Reply(None, timed_out=True)

    def _choice(self, answers: tuple[Choice, ...], stage: Stage, deadline: float) -> Reply | Command:
        by_key: dict[str, str] = {}
        for number, answer in enumerate(answers, 1):
            by_key.setdefault(str(number), answer.name)
            self._say(f"  {answer.key or number}  {answer.label}")
        by_key |= {answer.key: answer.name for answer in answers if answer.key is not None}
        with self._keys.single():
            while (typed := self._next(stage, deadline)) is not None:
                if isinstance(typed, Command):
                    return typed
                if typed in by_key:
                    return Reply(by_key[typed])
                self._say(f"{typed or _ENTER_KEY}: invalid answer; must be one of {', '.join(by_key)}")
        return Reply(None, timed_out=True)

    def _typed(self, shown: Shown, stage: Stage, deadline: float) -> Reply | Command:
        self._say(_INPUT_HINTS[shown.kind](shown))
        while (typed := self._next(stage, deadline, lines=True)) is not None:
            if isinstance(typed, Command):
                return typed
            try:
                return Reply(typed_reply(shown, typed))
            except ValueError as error:
                self._say(str(error))
        return Reply(None, timed_out=True)

    def _next(self, stage: Stage | None, deadline: float, lines: bool = False) -> str | Command | None:
        """Return the next key, line or command, or None at the deadline. While it waits, it calls `stage.check`."""
        while (left_s := deadline - time.monotonic()) > 0:
            read: Callable[[float], str | None] = self._keys.line if lines else self._keys.read
            typed = read(min(STAGE_CHECK_INTERVAL_S, left_s))
            if typed is None:
                if stage is not None:
                    stage.check()
                continue
            if typed == _ESCAPE_KEY or typed.startswith("\x1b"):
                return Command("abort")
            if not typed.startswith(":"):
                return typed
            command = self._command(typed)
            if command is not None:
                return command
        return None

    def _command(self, begun: str) -> Command | None:
        line: str | None = begun
        if begun == ":":
            # On a terminal the rest of the line is still being typed. Until Enter, `stage.check` is not called.
            self._say(":")
            line = None
            while line is None:
                line = self._keys.line(STAGE_CHECK_INTERVAL_S, "")
            line = ":" + line
        word, _, text = cast(str, line)[1:].strip().partition(" ")
        for kind in COMMAND_KINDS:
            if word == kind:
                return Command(kind, text.strip())
        self._say(f":{word}: unknown command; must be :pause, :repeat, :note TEXT or :abort")
        return None


_INPUT_HINTS: Final[dict[str, Callable[[Shown], str]]] = {
    "ranking": lambda shown: f"Type the numbers 1 to {shown.stimuli} in order, then Enter.",
    "slider": lambda shown: f"Type a number from {shown.low:g} to {shown.high:g}, then Enter.",
    "number": lambda shown: "Type a number, then Enter.",
    "text": lambda shown: "Type a text, then Enter.",
}
"""Functions that return the instruction for typing an answer, by kind of question."""
