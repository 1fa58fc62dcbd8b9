"""The example that shows pictures at a session's event codes, with a window that stores what it showed."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from examples.psychopy_stimuli import follow, pictures_of
from hapticd.experiment.daemon_stage import DaemonStage
from hapticd.experiment.event_codes import EventCode
from hapticd.experiment.front import Command
from tests.experiment.sessions import STAIRCASE, ScriptedFront, started
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon

ROOT = Path(__file__).parents[2]
TRIAL = ["cross", "disc", "", "disc", ""]
"""Pictures of a trial with two intervals: armed, forces on, off, on, off."""


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "servo.yaml"
    config.write_text("servo: {rate_hz: 1000, realtime: off, overruns: {threshold: 1}}\n")
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


class Screen:
    """A window that stores what each of its frames showed."""

    def __init__(self) -> None:
        self.drawn = ""
        self.frames: list[str] = []

    def flip(self) -> None:
        self.frames.append(self.drawn)
        self.drawn = ""

    @property
    def changes(self) -> list[str]:
        """Return the shown pictures in order, each once however many frames showed it."""
        return [now for before, now in zip(["", *self.frames], self.frames, strict=False) if now != before]


class Stimuli:
    """Takes the place of psychopy.visual: stimuli with the arguments that the example gives."""

    class _Stimulus:
        def __init__(self, window: Screen, name: str) -> None:
            self._window, self._name = window, name

        def draw(self) -> None:
            self._window.drawn += self._name

    def TextStim(self, window: Screen, text: str, height: float) -> Any:
        return self._Stimulus(window, "cross" if text == "+" else text)

    def Circle(self, window: Screen, radius: float, fillColor: str) -> Any:
        return self._Stimulus(window, "disc")


def watched(daemon: Daemon, folder: Path, front: ScriptedFront) -> tuple[str, Screen]:
    """Run a session; return its end and the screen, which has the shown pictures."""
    screen, endings = Screen(), []

    def run() -> None:
        with connect(daemon.directory) as client, DaemonStage(client) as stage:
            endings.append(started(folder, stage, front, STAIRCASE).run())

    session = threading.Thread(target=run)
    with connect(daemon.directory) as client, client.events() as events:
        session.start()
        follow(events, screen, pictures_of(Stimuli(), screen))
        session.join(PATIENCE_S)
    return endings[0], screen


@pytest.mark.slow
def test_the_screen_follows_a_session(daemon: Daemon, tmp_path: Path) -> None:
    front = ScriptedFront()
    front.commands = {"ready": [Command("pause")]}
    ending, screen = watched(daemon, tmp_path, front)
    answered = len(front.shown)
    assert ending == "ended"
    assert answered > 1
    # A pause before the forces of the first trial, then every trial completely.
    assert screen.changes == ["cross", "", "A break. Rest your hand.", "", *(TRIAL * answered)]


def test_a_session_that_is_aborted_leaves_an_empty_screen(daemon: Daemon, tmp_path: Path) -> None:
    front = ScriptedFront()
    front.commands = {"explore": [Command("abort")]}
    ending, screen = watched(daemon, tmp_path, front)
    assert ending == "aborted"
    assert screen.changes == ["cross", "disc", ""]


@pytest.mark.long
def test_it_ends_when_the_window_is_closed(daemon: Daemon) -> None:
    screen = Screen()
    with connect(daemon.directory) as client, client.events() as events:
        client.mark("trial_armed", {"code": int(EventCode.TRIAL_ARMED), "trial": 0, "attempt": 1})
        follow(events, screen, pictures_of(Stimuli(), screen), lambda: "cross" in screen.frames)
    assert screen.changes == ["cross"]


@pytest.mark.long
def test_without_psychopy_it_says_so_in_one_line(daemon: Daemon, tmp_path: Path) -> None:
    """A module that fails to import takes the place of psychopy."""
    (tmp_path / "psychopy.py").write_text("raise ImportError\n")
    run = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "psychopy_stimuli.py"), "--runtime-dir", str(daemon.directory)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr == "psychopy_stimuli: needs PsychoPy: pip install psychopy\n"
