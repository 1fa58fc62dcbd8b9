"""The front of `--text`: participant and experimenter at one terminal.

Answers are keys, as the study names them, or the number of the answer. A line that begins with a colon is the
experimenter's: `:pause`, `:repeat`, `:note TEXT`, `:abort`. Escape ends everything, as `:abort` does. Where the input
is no terminal, each line is one key.
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
from hapticd.experiment.front import CLEARANCE_POLL_S, Choice, Command, CommandKind, Reply, Shown, Watched
from hapticd.experiment.replies import typed_reply
from hapticd.experiment.stage import Stage

LOOKED_AFTER_S: Final = 0.5
"""Between two looks whether the stage is still there, while somebody is waited for."""
COMMANDS: Final[tuple[CommandKind, ...]] = ("pause", "repeat", "abort", "note")
_SEQUENCES: Final = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left", " ": "space"}
_ESCAPE: Final = "escape"
_ENTER: Final = "enter"


class Keys:
    """The keys of a terminal, or the lines of what is no terminal."""

    def __init__(self, stream: TextIO) -> None:
        self._fd = stream.fileno()
        self._terminal = stream.isatty()
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._pending = ""
        self._ended = False

    @contextmanager
    def single(self) -> Iterator[None]:
        """Keys come one by one, and are not echoed, while the block runs."""
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
        """The next key: a character or a name such as `left`; of what is no terminal the next line. None: none came.

        Raises HapticdError at the end of the input.
        """
        return self._await(self._key if self._terminal else self._line, timeout_s)

    def line(self, timeout_s: float, begun: str = "") -> str | None:
        """A line that is typed after `begun`, without its end; None: it has not ended yet."""
        self._pending = begun + self._pending
        return self._await(self._line, timeout_s)

    def _await(self, taken: Callable[[], str | None], timeout_s: float) -> str | None:
        """What `taken` takes of the input once there is enough of it; None: not within the time-out."""
        deadline = time.monotonic() + timeout_s
        while (found := taken()) is None:
            if self._ended:
                raise HapticdError("the input has ended; go on with `hapticd experiment resume`")
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
        for sequence, name in _SEQUENCES.items():
            if text.startswith(sequence):
                self._pending = text[len(sequence) :]
                return name
        self._pending = text[1:]
        if text[0] == "\x1b":
            # What follows is a key that nobody asked for.
            self._pending = ""
            return _ESCAPE if len(text) == 1 else ""
        return _ENTER if text[0] in "\r\n" else text[0]


class TextFront:
    """Participant and experimenter at a terminal."""

    def __init__(self, source: TextIO | None = None, out: TextIO | None = None) -> None:
        self._keys = Keys(source or sys.stdin)
        self._out = out or sys.stdout
        if isinstance(self._out, io.TextIOWrapper):
            self._out.reconfigure(errors="replace")  # a terminal may lack a character of the study's texts
        self._console = Console(file=self._out, highlight=False)

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        self._say(f"{title}\n")
        self._say_markdown(instructions)
        self._say(f"{done} of {'at most ' if at_most else ''}{wording.count(total, 'trial')} done.")
        self._say("Experimenter: :pause, :repeat, :note TEXT, :abort; Escape stops everything.")
        return self._go_on("Enter begins.")

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        if instructions is None and phase == "test":
            return None
        self._say(f"\n{phase.capitalize()}")
        if instructions:
            self._say_markdown(instructions)
        return self._go_on("Enter goes on.")

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        # What tells stimuli apart is for the experimenter's window alone; at one terminal it stays away.
        again = f", attempt {watched.attempt}" if watched.attempt > 1 else ""
        total = f"at most {shown.total}" if shown.at_most else f"{shown.total}"
        self._say(f"\nTrial {shown.number} of {total}{again}. {watched.answered} answered.")
        return self._go_on("Enter lets the forces on.")

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        self._say("Move the stylus to where it touches nothing; the forces come on then.")
        with self._keys.single():
            while not stage.is_clear():
                # Without a look at the stage: a fault stays until the forces are switched on again.
                said = self._next(None, time.monotonic() + CLEARANCE_POLL_S)
                if isinstance(said, Command):
                    return said
        return None

    def may_enable(self) -> Command | None:
        return None

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        self._say(f"Interval {interval} of {shown.stimuli}.")
        return self._go_on("Enter goes on to the next.", stage)

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        if shown.stimuli > 1 and not shown.in_places:
            self._say(f"Interval {shown.stimuli} of {shown.stimuli}.")
        self._say_markdown(shown.text)
        limit_s = math.inf if shown.time_limit_s is None else shown.time_limit_s
        deadline = time.monotonic() + limit_s
        match shown.kind:
            case "choice":
                return self._choice(shown.answers, stage, deadline)
            case "measure":
                return self._waited(_ENTER, "Enter when it is done.", stage, deadline)
            case _:
                return self._typed(shown, stage, deadline)

    def feedback(self, told: str, right: str | None) -> None:
        self._say(told)

    def not_done(self, trial: int, why: str) -> None:
        self._say(f"{why} Trial {trial} begins again.")

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        # At one terminal the participant would read it.
        pass

    def rest(self, text: str | None, least_s: float) -> Command | None:
        self._say("")
        self._say_markdown(text or "A break.")
        ends = time.monotonic() + least_s
        while (left_s := ends - time.monotonic()) > 0:
            said = self._go_on(f"{wording.duration(math.ceil(left_s))} left; Enter is taken after them.", until=ends)
            if said is not None:
                return said
        return self._go_on("Enter goes on.")

    def paused(self) -> Command | None:
        return self._go_on("\nPaused, the forces are off. Enter goes on.")

    def tell(self, line: str) -> None:
        self._say(line)

    # ---- How it is read --------------------------------------------------------------------------------------

    def _say(self, text: str) -> None:
        print(text, file=self._out, flush=True)

    def _say_markdown(self, text: str) -> None:
        self._console.print(Markdown(text.strip()))

    def _go_on(self, text: str, stage: Stage | None = None, until: float = math.inf) -> Command | None:
        said = self._waited(_ENTER, text, stage, until)
        return said if isinstance(said, Command) else None

    def _waited(self, key: str, text: str, stage: Stage | None, deadline: float) -> Reply | Command:
        self._say(text)
        with self._keys.single():
            while (said := self._next(stage, deadline)) is not None:
                if isinstance(said, Command):
                    return said
                if said in (key, ""):
                    return Reply(None)
        return Reply(None, timed_out=True)

    def _choice(self, answers: tuple[Choice, ...], stage: Stage, deadline: float) -> Reply | Command:
        by_key: dict[str, str] = {}
        for number, answer in enumerate(answers, 1):
            by_key.setdefault(str(number), answer.name)
            self._say(f"  {answer.key or number}  {answer.label}")
        by_key |= {answer.key: answer.name for answer in answers if answer.key is not None}
        with self._keys.single():
            while (said := self._next(stage, deadline)) is not None:
                if isinstance(said, Command):
                    return said
                if said in by_key:
                    return Reply(by_key[said])
                self._say(f"{said or _ENTER}: is no answer; {', '.join(by_key)} are")
        return Reply(None, timed_out=True)

    def _typed(self, shown: Shown, stage: Stage, deadline: float) -> Reply | Command:
        self._say(_HINTS[shown.kind](shown))
        while (said := self._next(stage, deadline, lines=True)) is not None:
            if isinstance(said, Command):
                return said
            try:
                return Reply(typed_reply(shown, said))
            except ValueError as error:
                self._say(str(error))
        return Reply(None, timed_out=True)

    def _next(self, stage: Stage | None, deadline: float, lines: bool = False) -> str | Command | None:
        """A key, a line or a command; None at the deadline. Looks after the stage meanwhile."""
        while (left_s := deadline - time.monotonic()) > 0:
            read: Callable[[float], str | None] = self._keys.line if lines else self._keys.read
            said = read(min(LOOKED_AFTER_S, left_s))
            if said is None:
                if stage is not None:
                    stage.check()
                continue
            if said == _ESCAPE or said.startswith("\x1b"):
                return Command("abort")
            if not said.startswith(":"):
                return said
            command = self._command(said)
            if command is not None:
                return command
        return None

    def _command(self, begun: str) -> Command | None:
        line: str | None = begun
        if begun == ":":
            # On a terminal the rest of the line is typed now; the wait for the stage goes on after it.
            self._say(":")
            line = None
            while line is None:
                line = self._keys.line(LOOKED_AFTER_S, "")
            line = ":" + line
        word, _, text = cast(str, line)[1:].strip().partition(" ")
        for kind in COMMANDS:
            if word == kind:
                return Command(kind, text.strip())
        self._say(f":{word}: is no command; :pause, :repeat, :note TEXT and :abort are")
        return None


_HINTS: Final[dict[str, Callable[[Shown], str]]] = {
    "ranking": lambda shown: f"The numbers 1 to {shown.stimuli} in their order, and Enter.",
    "slider": lambda shown: f"A number from {shown.low:g} to {shown.high:g}, and Enter.",
    "number": lambda shown: "A number, and Enter.",
    "text": lambda shown: "A text, and Enter.",
}
