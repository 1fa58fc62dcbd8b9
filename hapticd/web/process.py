"""The process of `hapticd web`, from its options to its end."""

from __future__ import annotations

import asyncio
import logging
import signal
from contextlib import AsyncExitStack, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from hapticd.base import memory
from hapticd.base.errors import HapticdError
from hapticd.client import blocking
from hapticd.client.asynchronous import Client
from hapticd.protocol import places
from hapticd.protocol.calls import DaemonNotRunning
from hapticd.system import journal, notify
from hapticd.system.paths import RuntimePaths
from hapticd.web import opening
from hapticd.web.application import STATIC_FOLDER, Pages, Site
from hapticd.web.connections import Connections
from hapticd.web.demo import DemoDaemon
from hapticd.web.http_server import serving
from hapticd.web.listening import Listening, listen
from hapticd.web.recording_folder import default_folder
from hapticd.web.recording_methods import Recordings
from hapticd.web.sessions import Sessions
from hapticd.web.tasks import ended
from hapticd.web.telemetry_hub import TelemetryHub

if TYPE_CHECKING:
    from hapticd.web.metrics import DaemonCollector

_DAEMON_WAIT_S: Final = 0.3
"""Longest wait for the daemon at the start, so that the first page shows a running daemon at once."""

_log = logging.getLogger("hapticd.web")


@dataclass(frozen=True, slots=True)
class Options:
    """The options of `hapticd web`."""

    place: RuntimePaths | None
    """Paths of the daemon's sockets; None: a demo, which starts a separate daemon."""
    configs: tuple[str, ...]
    """Configuration files of the demo's daemon; empty: DEMO_CONFIG_PATH."""
    host: str
    port: int
    open_browser: bool
    tls_cert: str | None = None
    tls_key: str | None = None
    password_file: str | None = None
    log_level: str = "info"
    recordings: Path | None = None
    """Folder of recordings; None: recording_folder.default_folder()."""
    metrics: int | None = None
    """Port of the metrics for Prometheus; None: metrics are not served."""


def run(options: Options) -> int:
    """Serve the page until SIGTERM or SIGINT, and return the exit code. Raises HapticdError if it cannot start."""
    memory.return_large_blocks()
    with journal.attached(options.log_level), ExitStack() as stack:
        at = listen(options.host, options.port, options.tls_cert, options.tls_key, options.password_file)
        stack.callback(at.socket.close)
        collector = None
        if options.metrics is not None:
            from hapticd.web.metrics import served  # imported only here: needs prometheus-client

            collector = stack.enter_context(served(options.metrics))
        if options.place is not None:
            _probe_daemon(options.place)
            server = _Server(at, options.place, None, options, collector)
        else:
            demo = stack.enter_context(DemoDaemon(options.configs))
            server = _Server(at, demo.place, demo, options, collector)
        return asyncio.run(server.run())


def _probe_daemon(place: RuntimePaths) -> None:
    """Log a warning if no daemon runs: it may start later. Raises HapticdError if access to its sockets is denied."""
    try:
        places.probe(place)
    except DaemonNotRunning as error:
        _log.warning("%s; the page waits for a daemon", error)


class _Server:
    """The running web server: its pages, its sessions and its connection to the daemon."""

    def __init__(
        self,
        at: Listening,
        place: RuntimePaths,
        demo: DemoDaemon | None,
        options: Options,
        collector: DaemonCollector | None,
    ) -> None:
        self._at, self._place, self._demo, self._options, self._collector = at, place, demo, options, collector
        self._sessions = Sessions()

    async def run(self) -> int:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, stop.set)
        loop.add_signal_handler(signal.SIGUSR1, lambda: click.echo(self._new_address()))
        async with AsyncExitStack() as stack:
            control = Client(self._place)
            stack.push_async_callback(control.close)
            hub = TelemetryHub(self._place, lambda connected: pages.send_news({"daemon": connected}))
            recordings = Recordings(
                self._options.recordings or default_folder(), lambda: blocking.Client(self._place.directory)
            )
            pages = Pages(self._place, hub, control, self._demo is not None, self._new_address, recordings)
            if self._collector is not None:
                self._collector.follow(hub)
            connections = Connections()
            site = Site(STATIC_FOLDER / "index.html", pages.add_routes)
            await stack.enter_async_context(serving(self._at, self._sessions, site, connections))
            tasks: list[asyncio.Task[Any]] = [
                asyncio.create_task(hub.run(), name="telemetry"),
                asyncio.create_task(connections.run(), name="connections"),
                asyncio.create_task(stop.wait(), name="stop"),
            ]
            if self._demo is not None:
                tasks.append(asyncio.create_task(self._demo.failed(), name="demo"))
            for task in tasks:
                stack.push_async_callback(ended, task)
            await hub.await_daemon(_DAEMON_WAIT_S)
            address = self._new_address()
            click.echo(address)
            notify.ready(f"at {self._at.url}")
            if self._options.open_browser:
                browser = asyncio.create_task(opening.open_in_browser([address]), name="browser")
                stack.push_async_callback(ended, browser)
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            notify.stopping()
            await pages.close()
            return self._code_of(done)

    def _code_of(self, done: set[asyncio.Task[Any]]) -> int:
        failed = [task for task in done if task.get_name() != "stop"]
        for task in failed:
            if task.exception() is not None:
                _log.error("hapticd web failed", exc_info=task.exception())
            else:
                raise HapticdError(str(task.result()))
        return 1 if failed else 0

    def _new_address(self) -> str:
        return f"{self._at.url}/?token={self._sessions.new_token()}"
