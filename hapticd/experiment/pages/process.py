"""A session in the browser: two ports for the pages, and a thread for the session."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable
from contextlib import AsyncExitStack, ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import click

from hapticd.client.asynchronous import Client
from hapticd.experiment.front import Command
from hapticd.experiment.pages import experimenter_page, participant_page
from hapticd.experiment.pages.pages_front import PagesFront, Who
from hapticd.experiment.pages.participant_page import HAND_METHODS, STOP_METHODS, StylusRelay
from hapticd.experiment.pages.presence import Presence
from hapticd.system.paths import RuntimePaths
from hapticd.web import application, opening
from hapticd.web.application import Pages, Site
from hapticd.web.connections import Connections
from hapticd.web.http_server import serving
from hapticd.web.listening import Listening, listen
from hapticd.web.sessions import Sessions
from hapticd.web.tasks import ended
from hapticd.web.telemetry_hub import TelemetryHub

STATIC_FOLDER: Final = Path(__file__).parent / "static"
"""Folder of the HTML, CSS and JavaScript files of both pages."""


@dataclass(frozen=True, slots=True)
class Options:
    """The options of a session in the browser."""

    place: RuntimePaths
    simulated: bool
    """Whether the daemon has the simulated joystick."""
    host: str
    port: int
    """Port of the participant's page. The experimenter's page has the next port. 0 chooses two free ports."""
    open_browser: bool
    tls_cert: str | None = None
    tls_key: str | None = None
    password_file: str | None = None


def run(options: Options, front: PagesFront, news: News, session: Callable[[], int]) -> int:
    """Serve both pages while `session` runs in a thread, and return the result of `session`.

    SIGINT and SIGTERM end the session like the experimenter's button; SIGUSR1 prints new addresses. Raises HapticdError
    if a port is not available, and the exceptions that `session` raises.
    """
    with ExitStack() as stack:
        at = []
        for number in (0, 1):
            port = options.port + number if options.port else 0
            found = listen(options.host, port, options.tls_cert, options.tls_key, options.password_file)
            stack.callback(found.socket.close)
            at.append(found)
        return asyncio.run(_SessionPages(options, front, news, at[0], at[1]).run(session))


class News:
    """A callable that notifies the event loop, from any thread, that the content of a page has changed."""

    def __init__(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._event: asyncio.Event | None = None

    def __call__(self) -> None:
        """Notify the event loop of a change."""
        if self._loop is not None and self._event is not None:
            self._loop.call_soon_threadsafe(self._event.set)

    async def listened(self, send: Callable[[], None]) -> None:
        """Call `send` now, and again after one or more changes of the pages' content, until cancelled."""
        self._loop, self._event = asyncio.get_running_loop(), asyncio.Event()
        try:
            while True:
                send()
                await self._event.wait()
                self._event.clear()
        finally:
            self._loop = None


class _SessionPages:
    """The pages and their servers during one session."""

    def __init__(
        self, options: Options, front: PagesFront, news: News, participant: Listening, experimenter: Listening
    ) -> None:
        self._options, self._front, self._changes = options, front, news
        self._at: dict[Who, Listening] = {"participant": participant, "experimenter": experimenter}
        self._sessions: dict[Who, Sessions] = {"participant": Sessions(), "experimenter": Sessions()}
        self._screen, self._notice = -1, ""

    async def run(self, session: Callable[[], int]) -> int:
        """Serve the pages until the session ends, and return its result."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._front.command, Command("abort", signal.Signals(number).name))
        loop.add_signal_handler(signal.SIGUSR1, self._print_addresses)
        async with AsyncExitStack() as stack:
            control = Client(self._options.place)
            stack.push_async_callback(control.close)
            hub = TelemetryHub(self._options.place)
            running = [asyncio.create_task(hub.run(), name="telemetry")]
            pages = await self._serve(stack, running, hub, control)
            hub.subscribe(StylusRelay(self._front, lambda: tuple(pages["participant"].open)), frozenset(("state",)))
            running.append(asyncio.create_task(self._changes.listened(partial(self._send_changes, pages)), name="news"))
            for task in running:
                stack.push_async_callback(ended, task)
            for each in pages.values():
                stack.push_async_callback(each.close)  # before their telemetry ends
            done = _in_thread(loop, session)
            waiting: list[asyncio.Future[Any]] = [done, *running]
            first, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            if done not in first:
                # A task of the pages failed: the session ends, so that the forces do not stay on.
                self._front.command(Command("abort", "the server of the pages failed"))
                await asyncio.wait((done,))
                for part in first:
                    part.result()
            self._send_changes(pages)  # the last screen, which close() sends before it disconnects
            return done.result()

    async def _serve(
        self, stack: AsyncExitStack, running: list[asyncio.Task[Any]], hub: TelemetryHub, control: Client
    ) -> dict[Who, Pages]:
        """Serve both pages, print their addresses, and return the pages."""
        made: dict[Who, Pages] = {}
        for who, at in self._at.items():
            presence = Presence(partial(self._front.here, who), swept=self._front.server_runs)
            connections = Connections()
            pages = Pages(self._options.place, hub, control, False, partial(self._address, who))
            if who == "participant":
                daemon_methods = STOP_METHODS | HAND_METHODS if self._options.simulated else STOP_METHODS
                own = participant_page.methods(self._front, presence, self._options.simulated)
                pages = replace(pages, methods=own, daemon_methods=daemon_methods)
            else:
                own = experimenter_page.methods(self._front, presence)
                pages = replace(pages, methods={**application.WEB_PAGE_METHODS, **own})
            site = Site(STATIC_FOLDER / f"{who}.html", partial(_add_routes, pages))
            await stack.enter_async_context(serving(at, self._sessions[who], site, connections))
            running += [asyncio.create_task(each.run(), name=f"{who}-{each}") for each in (presence, connections)]
            made[who] = pages
        addresses = self._print_addresses()
        if self._options.open_browser:
            task = asyncio.create_task(opening.open_in_browser(addresses), name="browser")
            stack.push_async_callback(ended, task)
        return made

    def _address(self, who: Who) -> str:
        """Return a new address of the page of `who`. An address can be opened once."""
        return f"{self._at[who].url}/?token={self._sessions[who].new_token()}"

    def _print_addresses(self) -> list[str]:
        addresses = {who: self._address(who) for who in self._at}
        for who, address in addresses.items():
            click.echo(f"{who}: {address}")
        return list(addresses.values())

    def _send_changes(self, pages: dict[Who, Pages]) -> None:
        screen = self._front.screen
        if screen["screen"] != self._screen:
            self._screen = int(str(screen["screen"]))
            pages["participant"].send_news({"screen": screen})
        if (notice := self._front.notice) != self._notice:
            self._notice = notice
            pages["participant"].send_news({"notice": notice})
        pages["experimenter"].send_news(experimenter_page.news(self._front))


def _add_routes(pages: Pages, app: Any) -> None:
    pages.add_routes(app)
    app.router.add_static("/experiment/", STATIC_FOLDER, follow_symlinks=False)


def _in_thread(loop: asyncio.AbstractEventLoop, session: Callable[[], int]) -> asyncio.Future[int]:
    """Run `session` in a new thread, as it would block a thread of a pool, and return a future of its result."""
    done: asyncio.Future[int] = loop.create_future()

    def settle(code: int | None, error: BaseException | None) -> None:
        if error is not None:
            done.set_exception(error)
        else:
            done.set_result(code if code is not None else 1)

    def work() -> None:
        try:
            code = session()
        except BaseException as error:
            loop.call_soon_threadsafe(settle, None, error)
        else:
            loop.call_soon_threadsafe(settle, code, None)

    threading.Thread(target=work, name="hapticd-session").start()
    return done
