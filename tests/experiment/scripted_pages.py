"""`hapticd experiment run` or `resume` in a process, and both of its pages played by a script without a browser.

The script keeps every message that the participant's page got: what stands there is all that a participant could find.
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
"""A configuration that needs no real-time rights, and whose missed periods are no news."""


class Running:
    """The command in a process, and the addresses that it printed."""

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
        """The next two addresses that it prints, by page."""
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
        """Exit code, and what it said from then on."""
        out, said = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, out, said

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.communicate()


class Page:
    """A page that beats, and answers what it is shown."""

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
        """Until the server closes it, or dies."""
        beating = asyncio.create_task(self._beat(beat))
        try:
            async for message in self.socket:
                assert message.type is aiohttp.WSMsgType.BINARY, message
                self.messages.append(message.data)
                told = msgpack.unpackb(message.data)
                if isinstance(told, dict) and "error" in told:
                    self.refused.append(told["error"])
                    continue
                await self._heard(self, told)
        except ConnectionError:
            pass  # the server was killed, which is what these tests are for
        finally:
            beating.cancel()
            await asyncio.gather(beating, return_exceptions=True)

    async def _beat(self, method: str) -> None:
        while True:
            await self.call(method)
            await asyncio.sleep(BEAT_S)


class Visitor:
    """A browser that was let in by an address with a token: it may open the page as often as it likes."""

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
    """A page of an address with a token."""
    async with visitor(link) as browser, browser.page(heard) as opened:
        yield opened


def answer_of(question: dict[str, Any], stimuli: int) -> Any:
    """An answer of the right form to a question."""
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

    def __init__(self, most: int | None = None) -> None:
        """`most`: so many answers, then the participant presses the stop."""
        self.most = most
        self.answers = 0
        self.screens: list[dict[str, Any]] = []
        self.consoles: list[dict[str, Any]] = []
        self.participant: Page | None = None
        self.experimenter: Page | None = None

    async def play(self, links: dict[str, str]) -> None:
        """Until the session ends or its process dies."""
        async with visitor(links["experimenter"]) as one, visitor(links["participant"]) as other:
            await asyncio.gather(self.experimenter_page(one), self.participant_page(other))

    async def experimenter_page(self, browser: Visitor) -> None:
        """Until it is closed."""
        async with browser.page(self._experimenter) as self.experimenter:
            await self.experimenter.call("experiment.watch", since=0)
            await self.experimenter.run("experiment.beat")

    async def participant_page(self, browser: Visitor) -> None:
        """Until it is closed."""
        async with browser.page(self._participant) as self.participant:
            await self.participant.call("participant.screen")
            await self.participant.run("participant.beat")

    async def withdraw(self, page: Page) -> None:
        """Its hand is nowhere that it would have to leave."""
        raise AssertionError("the hand is inside something")

    async def answer(self, page: Page, screen: dict[str, Any]) -> None:
        """Feels nothing, and answers at once."""
        answer = answer_of(screen["question"], screen["stimuli"])
        await page.call("participant.answer", screen=screen["screen"], answer=answer)

    async def _participant(self, page: Page, told: Any) -> None:
        screen = None
        if isinstance(told, dict) and isinstance(told["result"], dict):
            screen = told["result"].get("screen")
        elif isinstance(told, list) and told[0] == "web":
            screen = told[1].get("screen")
        if screen is None or (self.screens and screen["screen"] <= self.screens[-1]["screen"]):
            return
        self.screens.append(screen)
        number = screen["screen"]
        if screen["kind"] == "trial" and screen["withdraws"]:
            await self.withdraw(page)
        if screen["kind"] == "trial" and screen["felt"]:
            if screen["question"] is None:
                await page.call("participant.go_on", screen=number)
            elif self.most is not None and self.answers >= self.most:
                await page.call("participant.stop")
            else:
                self.answers += 1
                await self.answer(page, screen)

    async def _experimenter(self, page: Page, told: Any) -> None:
        state = told[1].get("experiment") if isinstance(told, list) and told[0] == "web" else None
        if isinstance(told, dict) and isinstance(told["result"], dict) and "doing" in told["result"]:
            state = told["result"]
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
    """The records of P07's first session under a data set's folder, without a line that is just being written; none
    before there is a log."""
    path = root / SESSION / "log.jsonl"
    return read_log(path).records if path.exists() else ()


def answered(root: Path) -> list[object]:
    """The indices of the trials that were answered, in the order of the answers."""
    return [record["trial"] for record in log_of(root) if record["kind"] == "answer"]


def run_study(folder: Path, study: str, *more: str) -> tuple[str, ...]:
    """The words of a command that runs a study with its pages."""
    return ("experiment", "run", study, "--participant", "P07", "--port", "0", "-o", str(folder), *more)
