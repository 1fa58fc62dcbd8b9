"""Kills the runner, the daemon or a page of a session at random moments, and resumes it: is anything lost or doubled?

python -m tests.soak.kill_experiment [--kills 100] [--trials 120] [--seed 1] [--out build/kill_experiment]

The participant's hand presses on the surface while it is asked, so that there is a force that has to go. After a kill
the force must be zero within RELEASED_S, by the daemon's own telemetry. Whenever the participant's page shows trial N,
N - 1 answers must be on disk. At the end every trial has one answer, in the order of the plan.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

from hapticd.experiment.daemon_stage import RUNNER_LEASE_S
from tests.experiment.scripted_pages import (
    SERVO,
    SESSION,
    Page,
    Running,
    Script,
    Visitor,
    answered,
    log_of,
    run_study,
    visitor,
)
from tests.support.daemon_process import Daemon, connect

Victim: TypeAlias = Literal["runner", "daemon", "participant", "experimenter"]
VICTIMS: tuple[Victim, ...] = ("runner", "daemon", "participant", "experimenter")
RELEASED_S = {"runner": RUNNER_LEASE_S + 2.0, "participant": 2.0, "experimenter": 2.0}
"""From a kill to no force, on a machine that is busy; the median is told."""
MOST_WAIT_S = 2.0
"""A kill comes within so long after both pages are open."""
FELT_S = 0.15
STUDY = """\
experiment: 1
title: Which is stiffer?
instructions: Press both.
base:
  materials: {{left: wood, right: wood}}
  scene:
    objects:
      left:  {{kind: box, center_m: [-0.03, -0.03], size_m: [0.05, 0.04], material: left}}
      right: {{kind: box, center_m: [0.03, -0.03], size_m: [0.05, 0.04], material: right}}
places: [left, right]
factors:
  material: {{at: "materials.{{place}}", levels: [wood, delrin, steel]}}
trial: {{type: paired_comparison, presentation: places, cross: [material], question: stiffer}}
repetitions: {repetitions}
questions:
  stiffer:
    kind: choice
    text: Which is stiffer?
    answers:
      - {{name: first, label: The left one, means: first}}
      - {{name: second, label: The right one, means: second}}
    asks: {{factor: material, which: highest}}
"""


@dataclass
class Found:
    """What the kills did."""

    kills: Counter[str] = field(default_factory=Counter)
    pressed: int = 0
    """Kills while there was a force."""
    released_s: list[float] = field(default_factory=list)
    given_up: int = 0
    problems: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        ordered = sorted(self.released_s)
        return {
            "kills": dict(self.kills),
            "while_there_was_a_force": self.pressed,
            "released_s": {"median": ordered[len(ordered) // 2], "largest": ordered[-1]} if ordered else None,
            "attempts_given_up": self.given_up,
            "problems": self.problems,
        }


class Pressing(Script):
    """Its participant presses before it answers, and looks whether every answer before is on disk."""

    def __init__(self, folder: Path, found: Found) -> None:
        super().__init__()
        self._folder, self._found = folder, found
        self._answers: set[asyncio.Task[None]] = set()

    async def answer(self, page: Page, screen: dict[str, Any]) -> None:
        before = len(answered(self._folder))
        if before < screen["number"] - 1:
            self._found.problems.append(f"trial {screen['number']} was shown with {before} answers on disk")
        task = asyncio.create_task(self._later(page, screen))
        self._answers.add(task)
        task.add_done_callback(self._answers.discard)

    async def withdraw(self, page: Page) -> None:
        await page.call("stream_target", seq=int(1e6 * time.monotonic()), position_m=[-0.03, 0.02])

    async def _later(self, page: Page, screen: dict[str, Any]) -> None:
        try:
            await page.call("stream_target", seq=int(1e6 * time.monotonic()), position_m=[-0.03, -0.02])
            await asyncio.sleep(FELT_S)
            await super().answer(page, screen)
        except ConnectionError:
            return  # it was killed meanwhile


class Torture:
    """A session that is killed again and again."""

    def __init__(self, folder: Path, trials: int, seed: int) -> None:
        self._folder, self._random, self.found = folder, random.Random(seed), Found()
        self._study = folder / "study.yaml"
        self._study.write_text(STUDY.format(repetitions=-(-trials // 3)))
        (folder / "servo.yaml").write_text(SERVO)
        self._runtime = tempfile.TemporaryDirectory(prefix="hapticd-kill-")
        self._daemon = self._new_daemon()
        self._begun = False

    def close(self) -> None:
        if self._daemon.process.poll() is None:
            self._daemon.stop()
        self._runtime.cleanup()

    def _new_daemon(self) -> Daemon:
        daemon = Daemon(Path(self._runtime.name) / "run", "-c", str(self._folder / "servo.yaml"))
        daemon.wait_ready()
        return daemon

    def _start(self) -> Running:
        """The session, from its beginning or from where it was killed."""
        words = ("--runtime-dir", str(self._daemon.directory))
        session = self._folder / SESSION
        if (session / "session.json").exists():
            return Running(*words, "experiment", "resume", str(session), "--port", "0")
        return Running(*words, *run_study(self._folder, str(self._study)))

    async def run(self, kills: int) -> None:
        """So many kills, then to the end."""
        left = kills
        while True:
            running = self._start()
            try:
                left = await self._play(running, left)
            finally:
                running.stop()
            if self._daemon.process.poll() is not None:
                self._daemon = self._new_daemon()
            if left == 0 and log_of(self._folder)[-1]["kind"] == "ended":
                return
            if left == kills and running.process.returncode == 0:
                raise AssertionError("the session was over before the kills were")

    async def _play(self, running: Running, left: int) -> int:
        """Until the process is gone; the kills that are left."""
        script = Pressing(self._folder, self.found)
        async with AsyncExitStack() as stack:
            one = await stack.enter_async_context(visitor(running.links["experimenter"]))
            other = await stack.enter_async_context(visitor(running.links["participant"]))
            pages = {
                "experimenter": asyncio.create_task(script.experimenter_page(one)),
                "participant": asyncio.create_task(script.participant_page(other)),
            }
            try:
                while left > 0 and running.process.poll() is None:
                    await asyncio.sleep(self._random.uniform(0.0, MOST_WAIT_S))
                    if running.process.poll() is not None:
                        break
                    victim = self._random.choice(VICTIMS)
                    left -= 1
                    await self._kill(victim, running, script, pages, {"experimenter": one, "participant": other})
                    if victim in ("runner", "daemon"):
                        break
                await asyncio.to_thread(running.process.wait)
            finally:
                for task in pages.values():
                    task.cancel()
                await asyncio.gather(*pages.values(), return_exceptions=True)
        return left

    async def _kill(
        self,
        victim: Victim,
        running: Running,
        script: Script,
        pages: dict[str, asyncio.Task[None]],
        browsers: dict[str, Visitor],
    ) -> None:
        self.found.kills[victim] += 1
        if victim == "daemon":
            self._daemon.process.send_signal(signal.SIGKILL)
            self._daemon.process.wait()
            return
        with connect(self._daemon.directory) as client, client.states(newest=True) as states:
            state = await asyncio.to_thread(states.receive, 10.0)
            assert state is not None
            pressed = state["force_n"] != [0.0, 0.0]
            self.found.pressed += pressed
            killed = time.monotonic()
            if victim == "runner":
                running.process.send_signal(signal.SIGKILL)
            else:
                gone = script.participant if victim == "participant" else script.experimenter
                if gone is not None and gone.socket._response.connection is not None:
                    gone.socket._response.connection.transport.abort()
                pages[victim].cancel()
                await asyncio.gather(pages[victim], return_exceptions=True)
            zero = False
            while not zero and time.monotonic() - killed < RELEASED_S[victim]:
                state = await asyncio.to_thread(states.receive, 1.0)
                zero = state is not None and state["force_n"] == [0.0, 0.0]
            if not zero:
                self.found.problems.append(f"{victim}: a force {RELEASED_S[victim]:g} s after it was killed")
            elif pressed:
                self.found.released_s.append(time.monotonic() - killed)
        if victim in pages and running.process.poll() is None:
            opens = script.participant_page if victim == "participant" else script.experimenter_page
            script.screens.clear()
            script.consoles.clear()
            pages[victim] = asyncio.create_task(opens(browsers[victim]))

    def check(self) -> None:
        """Of the whole session."""
        plan = json.loads((self._folder / SESSION / "plan.json").read_text())
        given = answered(self._folder)
        if given != [trial["index"] for trial in plan["trials"]]:
            self.found.problems.append(f"answers of trials {given} for {len(plan['trials'])} planned ones")
        self.found.given_up = sum(each["kind"] == "trial_given_up" for each in log_of(self._folder))


def torture(folder: Path, kills: int, trials: int, seed: int) -> Found:
    """What `kills` kills did to a session of about `trials` trials."""
    made = Torture(folder, trials, seed)
    try:
        asyncio.run(made.run(kills))
        made.check()
    finally:
        made.close()
    return made.found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--trials", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("build/kill_experiment"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=False)
    found = torture(given.out, given.kills, given.trials, given.seed)
    print(json.dumps(found.to_dict(), indent=1))
    return 1 if found.problems else 0


if __name__ == "__main__":
    sys.exit(main())
