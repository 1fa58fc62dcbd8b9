"""`hapticd experiment run` or `resume` in a process, and both of its pages played by a script without a browser.

The script keeps every message to the participant's page. They are all that a participant could find out.
"""

from __future__ import annotations

import asyncio
import re
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import msgpack

from hapticd.experiment.session_log import Record, read_log
from tests.support.daemon_process import PATIENCE_S

SESSION = Path("sub-P07/ses-01")

BEAT_S = 0.5
SERVO = "servo: {rate_hz: 1000, realtime: off, overruns: {threshold: 1}}\n"
"""A configuration that needs no real-time rights, and whose missed periods are not reported."""


class Running:
    """The command in a process, with the addresses that it printed."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hapticd", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.links = self.read_links()

    def read_links(self) -> dict[str, str]:
        """Read the next two addresses that the command prints, and return them by page."""
        assert self.process.stdout is not None and self.process.stderr is not None
        links: dict[str, str] = {}
        while len(links) < 2:
            line = self.process.stdout.readline()
            assert line, self.process.stderr.read()
            found = re.match(r"(participant|experimenter): (http://\S+)", line)
            assert found is not None, line
            links[found[1]] = found[2]
        return links

    def ended(self) -> tuple[int, str, str]:
        """Wait for the end. Return the exit code, and the output since the previous read."""
        out, errors = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, out, errors

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.communicate()


class Page:
    """A page that sends heartbeats, and answers the questions that it receives."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, heard: Callable[[Page, Any], Any]) -> None:
        self.socket, self._heard = socket, heard
        self.messages: list[bytes] = []
        self.refused: list[Any] = []
        self._id = 0

    async def call(self, method: str, **params: Any) -> None:
        self._id += 1
        body = {"jsonrpc": "2.0", "id": self._id, "method": method, "params": params}
        await self.socket.send_bytes(msgpack.packb(body))

    async def run(self, beat: str) -> None:
        """Run until the server closes the page, or dies."""
        beating = asyncio.create_task(self._beat(beat))
        try:
            async for message in self.socket:
                assert message.type is aiohttp.WSMsgType.BINARY, message
                self.messages.append(message.data)
                content = msgpack.unpackb(message.data)
                if isinstance(content, dict) and "error" in content:
                    self.refused.append(content["error"])
                    continue
                await self._heard(self, content)
        except ConnectionError:
            pass  # the server was killed, as these tests intend
        finally:
            beating.cancel()
            await asyncio.gather(beating, return_exceptions=True)

    async def _beat(self, method: str) -> None:
        while True:
            await self.call(method)
            await asyncio.sleep(BEAT_S)


class Visitor:
    """A browser that opened an address with a token. It may open the page again as often as it likes."""

    def __init__(self, session: aiohttp.ClientSession, origin: str) -> None:
        self._session, self._origin = session, origin

    @asynccontextmanager
    async def page(self, heard: Callable[[Page, Any], Any]) -> AsyncIterator[Page]:
        async with self._session.ws_connect(f"{self._origin}/socket", headers={"Origin": self._origin}) as socket:
            yield Page(socket, heard)


@asynccontextmanager
async def visitor(link: str) -> AsyncIterator[Visitor]:
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        async with session.get(link) as response:
            assert response.status == 200, await response.text()
        yield Visitor(session, link.partition("/?")[0])


@asynccontextmanager
async def page(link: str, heard: Callable[[Page, Any], Any]) -> AsyncIterator[Page]:
    """Return the page at an address with a token."""
    async with visitor(link) as browser, browser.page(heard) as opened:
        yield opened


def answer_of(question: dict[str, Any], stimuli: int) -> Any:
    """Return a valid answer to a question."""
    match question["kind"]:
        case "choice":
            return 0
        case "measure":
            return None
        case "ranking":
            return " ".join(map(str, range(stimuli, 0, -1)))
        case "text":
            return "a text"
        case _:
            return (question["low"] + question["high"]) / 2


class Script:
    """Both pages: the participant answers each question once, the experimenter lets every trial begin."""

    def __init__(self, max_answers: int | None = None) -> None:
        """Prepare both pages. After `max_answers` answers the participant presses the stop."""
        self.max_answers = max_answers
        self.answers = 0
        self.screens: list[dict[str, Any]] = []
        self.consoles: list[dict[str, Any]] = []
        self.participant: Page | None = None
        self.experimenter: Page | None = None

    async def play(self, links: dict[str, str]) -> None:
        """Play both pages until the session ends or its process dies."""
        async with visitor(links["experimenter"]) as one, visitor(links["participant"]) as other:
            await asyncio.gather(self.experimenter_page(one), self.participant_page(other))

    async def experimenter_page(self, browser: Visitor) -> None:
        """Play the experimenter's page until it is closed."""
        async with browser.page(self._experimenter) as self.experimenter:
            await self.experimenter.call("experiment.watch", since=0)
            await self.experimenter.run("experiment.beat")

    async def participant_page(self, browser: Visitor) -> None:
        """Play the participant's page until it is closed."""
        async with browser.page(self._participant) as self.participant:
            await self.participant.call("participant.screen")
            await self.participant.run("participant.beat")

    async def withdraw(self, page: Page) -> None:
        """Do nothing: the hand is outside of all surfaces."""
        raise AssertionError("the hand is inside something")

    async def answer(self, page: Page, screen: dict[str, Any]) -> None:
        """Answer immediately, without feeling anything."""
        answer = answer_of(screen["question"], screen["stimuli"])
        await page.call("participant.answer", screen=screen["screen"], answer=answer)

    async def _participant(self, page: Page, content: Any) -> None:
        screen = None
        if isinstance(content, dict) and isinstance(content["result"], dict):
            screen = content["result"].get("screen")
        elif isinstance(content, list) and content[0] == "web":
            screen = content[1].get("screen")
        if screen is None or (self.screens and screen["screen"] <= self.screens[-1]["screen"]):
            return
        self.screens.append(screen)
        number = screen["screen"]
        if screen["kind"] == "trial" and screen["withdraws"]:
            await self.withdraw(page)
        if screen["kind"] == "trial" and screen["felt"]:
            if screen["question"] is None:
                await page.call("participant.go_on", screen=number)
            elif self.max_answers is not None and self.answers >= self.max_answers:
                await page.call("participant.stop")
            else:
                self.answers += 1
                await self.answer(page, screen)

    async def _experimenter(self, page: Page, content: Any) -> None:
        state = content[1].get("experiment") if isinstance(content, list) and content[0] == "web" else None
        if isinstance(content, dict) and isinstance(content["result"], dict) and "doing" in content["result"]:
            state = content["result"]
        if state is None:
            return
        before = self.consoles[-1] if self.consoles else None
        self.consoles.append(state)
        steps = ("screen", "here")
        if state["goes_on"] is None or (before is not None and all(before[each] == state[each] for each in steps)):
            return
        if all(state["here"].values()):
            await page.call("experiment.go_on", screen=state["screen"])


def log_of(root: Path) -> tuple[Record, ...]:
    """Return the records of P07's first session in a data set, without an incomplete line; none without a log."""
    path = root / SESSION / "log.jsonl"
    return read_log(path).records if path.exists() else ()


def answered(root: Path) -> list[object]:
    """Return the indices of the answered trials, in the order of the answers."""
    return [record["trial"] for record in log_of(root) if record["kind"] == "answer"]


def run_study(folder: Path, study: str, *more: str) -> tuple[str, ...]:
    """Return the arguments of the command that runs a study with its pages."""
    return ("experiment", "run", study, "--participant", "P07", "--port", "0", "-o", str(folder), *more)
