"""The bridge's process: configuration, sockets, signals. One thread, one event loop, beside libzmq's own."""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import signal
import socket
import tempfile
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from typing import Any, Final

import zmq.asyncio
from pydantic import ValidationError

from hapticd.base import memory, threads
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.base.model import problems_of
from hapticd.base.tasks import ended
from hapticd.bridge import zap
from hapticd.bridge.accounts import Accounts
from hapticd.bridge.config import BridgeConfig, load_bridge, metrics_place
from hapticd.bridge.daemon_link import DaemonLink
from hapticd.bridge.gate import Gate
from hapticd.bridge.http import Endpoint
from hapticd.bridge.metrics import Metrics
from hapticd.protocol.keys import load_secret
from hapticd.protocol.remote import host_and_port
from hapticd.system import journal, notify
from hapticd.system.paths import RuntimePaths, daemon_paths

_BACKLOG: Final = 64
_TRIES: Final = 16
_DESCRIPTORS: Final = 4096
"""A connection takes eight; what is allowed at first is often 1024."""
_LONGEST_FOLDER: Final = 80
"""sockaddr_un has room for 107 bytes, and the names in the folder are short."""

_log = logging.getLogger("hapticd.bridge")


def run(
    config_path: str,
    runtime_dir: str | None,
    listen: str | None = None,
    metrics: str | None = None,
    log_level: str = "info",
) -> int:
    """Runs the bridge until SIGTERM or SIGINT; returns its exit code. SIGHUP reloads the configuration's clients and
    limits.

    `listen` and `metrics` take the place of the configuration's. `log_level`: one of journal.LEVELS. Raises
    HapticdError where it cannot start.
    """
    memory.settle()
    os.umask(0o077)
    _more_descriptors()
    loader = _loader(config_path, listen, metrics)
    with journal.attached(log_level), tempfile.TemporaryDirectory(prefix="hapticd-bridge-") as folder:
        if len(os.fsencode(folder)) > _LONGEST_FOLDER:
            raise HapticdError(f"TMPDIR: {folder} is too long for sockets (at most {_LONGEST_FOLDER} bytes)")
        return asyncio.run(_Bridge(loader, daemon_paths(runtime_dir), folder).run())


def _more_descriptors() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _DESCRIPTORS if hard == resource.RLIM_INFINITY else min(_DESCRIPTORS, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def _loader(path: str, listen: str | None, metrics: str | None) -> Callable[[], BridgeConfig]:
    def load() -> BridgeConfig:
        config = load_bridge(path)
        changes = {key: value for key, value in (("listen", listen), ("metrics", metrics)) if value is not None}
        try:
            return BridgeConfig.parsed({**config.model_dump(), **changes})
        except ValidationError as error:
            raise InvalidError(problems_of(error)) from None

    return load


class _Bridge:
    def __init__(self, load: Callable[[], BridgeConfig], paths: RuntimePaths, folder: str) -> None:
        self._load, self._paths, self._folder = load, paths, folder
        self._config = load()
        self._accounts = Accounts(self._config)
        self._gate: Gate | None = None

    async def run(self) -> int:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, stop.set)
        loop.add_signal_handler(signal.SIGHUP, self._reload)
        async with AsyncExitStack() as stack:
            threads.check(threads.BRIDGE)
            context = zmq.asyncio.Context()
            stack.callback(context.destroy, 0)
            authenticator = zap.bind(context)
            stack.callback(authenticator.close)
            link = DaemonLink(context, self._paths, self._lost, self._publish)
            gate = self._gate = Gate(
                context,
                self._folder,
                load_secret(self._config.server_key),
                self._accounts,
                link,
                self._paths.command_endpoint,
            )
            stack.callback(gate.close)
            stack.callback(link.listen, False)
            tasks: list[asyncio.Task[Any]] = [
                asyncio.create_task(zap.authenticate(authenticator, gate.authorize), name="zap"),
                asyncio.create_task(link.run(), name="link"),
                asyncio.create_task(self._tick(), name="tick"),
                asyncio.create_task(stop.wait(), name="stop"),
            ]
            for task in tasks:
                stack.push_async_callback(ended, task)
            place = await self._listen(gate, stack)
            metrics = ""
            if self._config.metrics is not None:
                endpoint = Endpoint(Metrics(link, gate).text)
                try:
                    server = await endpoint.listen(*metrics_place(self._config.metrics))
                except OSError as error:
                    raise HapticdError(f"metrics: {self._config.metrics}: {error.strerror or error}") from None
                stack.callback(server.close)
                metrics = f", metrics at http://{_name(server.sockets[0])}/metrics"
            missing = link.missing()
            if missing is not None:
                _log.warning("%s; it may come later", missing)
            _log.info("ready: commands at %s, telemetry at the port after it%s", place, metrics)
            notify.ready(f"commands at {place}")
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            failed = [task for task in done if task.get_name() != "stop"]
            for task in failed:
                _log.error("the bridge failed", exc_info=task.exception())
            _log.info("stopping")
            notify.stopping()
        return 1 if failed else 0

    def _lost(self) -> None:
        if self._gate is not None:
            self._gate.tell("daemon", f"the daemon at {self._paths.directory} went away")
            self._gate.daemon_lost()

    def _publish(self, frames: list[bytes]) -> None:
        if self._gate is not None:
            self._gate.publish(frames)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(1)
            if self._gate is not None:
                self._gate.tick()

    # ---- listening ---------------------------------------------------------------------------------------------------

    async def _listen(self, gate: Gate, stack: AsyncExitStack) -> str:
        """Binds both ports; port 0 is any that is free, with the one after it."""
        host, port = host_and_port(self._config.listen)
        loop = asyncio.get_running_loop()
        command, telemetry = _bind_both(None if host == "*" else host, port)
        for sockets, factory in (
            (command, gate.protocol_factory("command")),
            (telemetry, gate.protocol_factory("telemetry")),
        ):
            for listening in sockets:
                server = await loop.create_server(factory, sock=listening, backlog=_BACKLOG)
                stack.callback(server.close)
        return f"tcp://{_name(command[0])}"

    # ---- reload ------------------------------------------------------------------------------------------------------

    def _reload(self) -> None:
        """Takes the file as it is now, or leaves everything as it was."""
        notify.reloading()
        try:
            self._take_file()
        finally:
            notify.ready()

    def _take_file(self) -> None:
        try:
            config = self._load()
        except HapticdError as error:
            _log.error("not reloaded, everything is as it was: %s", error)
            return
        for key in ("listen", "metrics", "server_key"):
            if getattr(config, key) != getattr(self._config, key):
                _log.warning("%s: a change takes a restart", key)
        gone = self._accounts.replace(config)
        assert self._gate is not None
        ended = sum(self._gate.drop(account) for account in gone)
        names = f" ({', '.join(account.name for account in gone)})" if gone else ""
        _log.info(
            "reloaded: %d clients; %d keys revoked or changed%s, %d connections ended",
            len(config.clients),
            len(gone),
            names,
            ended,
        )


def _name(listening: socket.socket) -> str:
    host, port = listening.getsockname()[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _bind_both(host: str | None, port: int) -> tuple[list[socket.socket], list[socket.socket]]:
    """Sockets bound to a port and to the one after it, on each address of the host. Raises HapticdError."""
    for attempt in range(_TRIES):
        bound: list[list[socket.socket]] = []
        try:
            bound.append(_bind(host, port))
            first = bound[0][0].getsockname()[1]
            if first == 65535:
                raise OSError(0, "there is no port after 65535")
            bound.append(_bind(host, first + 1))
        except OSError as error:
            _close(bound)
            if port == 0 and attempt + 1 < _TRIES:
                continue  # the port after a free one need not be free
            raise HapticdError(
                f"listen: {host or '*'}:{port} and the port after it: {error.strerror or error}"
            ) from None
        return bound[0], bound[1]
    raise AssertionError("unreachable")


def _bind(host: str | None, port: int) -> list[socket.socket]:
    bound: list[socket.socket] = []
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, kind, protocol, _, address in dict.fromkeys(found):
            listening = socket.socket(family, kind, protocol)
            bound.append(listening)
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                listening.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            if port == 0 and len(bound) > 1:
                address = (address[0], bound[0].getsockname()[1], *address[2:])
            listening.bind(address)
    except OSError:
        _close([bound])
        raise
    return bound


def _close(groups: Sequence[Sequence[socket.socket]]) -> None:
    for group in groups:
        for each in group:
            each.close()
