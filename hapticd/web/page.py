"""One page: its WebSocket, its calls to the daemon, its queue.

Every message is binary, one msgpack value.

    page -> server   a JSON-RPC 2.0 object as the daemon takes it. Methods of the daemon that page_calls names are
                     passed on over a connection of this page's own. Methods that begin with `web.` are this process's:
                     each group of them stands in a file of its own, and application.METHODS has them all.
                     One without `id` is a notification: carried out, never answered.
    server -> page   the answer to a call, a map with `id`; or an array [topic, body]: telemetry as the daemon sent it,
                     of the topics that `web.subscribe` named; or ["web", {...}]: news of this process.

News, each with one or several of these members:

    daemon           bool: whether a daemon is there; sent first of all, and whenever it comes or goes
    pages            int: pages that are open
    dropped          {topic: count}: messages of telemetry that this page was too slow for, since it was opened
    refused          {reason: count}: messages of this page that were refused, since it was opened
    ended            string: why this page is being closed
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from typing import Final, TypeAlias

from aiohttp import WSCloseCode, WSMsgType, web

from hapticd.base.codec import encode
from hapticd.base.errors import HapticdError
from hapticd.client.asynchronous import Client
from hapticd.protocol import messages
from hapticd.protocol.calls import DaemonNotRunning, RemoteError
from hapticd.protocol.messages import Code, Request, WireError
from hapticd.system.paths import RuntimePaths
from hapticd.web import page_calls
from hapticd.web.daemon_relay import DaemonRelay
from hapticd.web.outbox import Outbox, Overflow
from hapticd.web.page_lease import PageLease
from hapticd.web.page_limits import UNDER_WAY, PageLimits
from hapticd.web.telemetry_hub import TelemetryHub

MAX_MESSAGE: Final = messages.MAX_BODY_BYTES
TOO_MUCH: Final = -32029
"""The error of a call beyond what a page may ask (page_limits)."""
FROZEN_S: Final = 30.0
"""A page that reads nothing for so long is closed, which frees what it takes here. Its forces do not wait for that:
they fade with its lease, by the clock of the daemon. A page that loads on a slow machine reads nothing for seconds."""
_GOODBYE_S: Final = 0.3
_AT_ONCE: Final = 32
_NEWS_EVERY_S: Final = 1.0
_SMALL: Final = 4096
"""A call of which this process looks at the params is no larger, but for the methods of this process."""

_log = logging.getLogger("hapticd.web")

Method: TypeAlias = Callable[["Page", Mapping[str, object]], Awaitable[object]]
"""A method of this process. It gets the page and the params; its result is a map. It raises HapticdError where the
params are wrong; RemoteError and DaemonNotRunning pass as they are. It does not block: what takes long goes to a
thread."""


class Page:
    """A WebSocket that was let in."""

    def __init__(
        self,
        socket: web.WebSocketResponse,
        place: RuntimePaths,
        hub: TelemetryHub,
        control: Client,
        methods: Mapping[str, Method],
        *,
        demo: bool,
        new_address: Callable[[], str],
        passes: frozenset[str] = page_calls.OF_THE_DAEMON,
    ) -> None:
        """`passes`: what it may call of the daemon."""
        self._socket, self.hub, self._methods = socket, hub, methods
        self.demo = demo
        self.new_address = new_address
        self.daemon = Client(place)
        """For the methods of this process; connected once one of them asks."""
        self.outbox = Outbox()
        self.closing = contextlib.AsyncExitStack()
        """What is to be done when the page goes: methods push their own callbacks."""
        self.lease = PageLease(control)
        self.refused: Counter[str] = Counter()
        self._relay = DaemonRelay(place, self._answer)
        self._limits = PageLimits()
        self._passes = passes
        self._tasks: set[asyncio.Task[None]] = set()
        self._told: dict[str, Mapping[str, int]] = {"dropped": {}, "refused": {}}
        self._ended = asyncio.Event()

    def tell(self, news: Mapping[str, object]) -> None:
        """Sends ["web", news] to the page."""
        self._answer(encode(["web", dict(news)]))

    def end(self, why: str) -> None:
        """Has the page closed, soon."""
        if not self._ended.is_set():
            with contextlib.suppress(Overflow):
                self.outbox.answer(encode(["web", {"ended": why}]))
            self._ended.set()

    # ---- Its life ----------------------------------------------------------------------------------------------------

    async def serve(self) -> None:
        """Until the page goes, or is closed."""
        parts = [
            asyncio.create_task(part, name=f"page-{name}")
            for name, part in (
                ("receiver", self._receive()),
                ("sender", self._send()),
                ("news", self._news()),
                ("end", self._ended.wait()),
            )
        ]
        try:
            done, _ = await asyncio.wait(parts, return_when=asyncio.FIRST_COMPLETED)
            if self._ended.is_set():
                await self._goodbye()
            for part in done:
                part.result()
        finally:
            self.hub.subscribe(self.outbox, frozenset())
            for task in (*parts, *self._tasks):
                task.cancel()
            await asyncio.gather(*parts, *self._tasks, return_exceptions=True)
            await self._relay.close()
            await self.daemon.close()
            await self.closing.aclose()
            self.outbox.close()

    async def _goodbye(self) -> None:
        """Says that it ends, to a page that reads; in any case lets go of the connection."""
        with contextlib.suppress(TimeoutError, ConnectionError):
            async with asyncio.timeout(_GOODBYE_S):
                while len(self.outbox):
                    await asyncio.sleep(0.01)
                await self._socket.close(code=WSCloseCode.GOING_AWAY)

    async def _send(self) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                message = await self.outbox.next()
                try:
                    async with asyncio.timeout(FROZEN_S):
                        await self._socket.send_bytes(message)
                except TimeoutError:
                    return

    async def _news(self) -> None:
        """What was dropped and refused, once a second where there is more of it."""
        while True:
            await asyncio.sleep(_NEWS_EVERY_S)
            now = {"dropped": dict(self.outbox.dropped), "refused": dict(self.refused)}
            news = {name: counts for name, counts in now.items() if counts != self._told[name]}
            if news:
                self._told.update(news)
                self.tell(news)

    # ---- What it says ------------------------------------------------------------------------------------------------

    async def _receive(self) -> None:
        taken = 0
        async for message in self._socket:
            if message.type is not WSMsgType.BINARY:
                await self._socket.close(code=WSCloseCode.UNSUPPORTED_DATA, message=b"messages are binary: msgpack")
                return
            self.received(message.data)
            wait_s = self._limits.pace(len(message.data))
            taken += 1
            if wait_s > 0.0 or taken % _AT_ONCE == 0:
                await asyncio.sleep(wait_s)

    def received(self, body: bytes) -> None:
        """A message of the page."""
        request = messages.peek(body)
        if request is None or len(body) > MAX_MESSAGE:
            self._refuse_form(body)
        elif request.method not in self._passes and request.method not in self._methods:
            self._refuse(request, Code.NO_SUCH_METHOD, f"no method {request.method!r:.60} for a page", "method")
        elif request.method in page_calls.STREAMS and not request.has_id:
            if not self._limits.streams.take_if_there(1):
                self.refused["streams"] += 1
            elif not self._relay.notify(body):
                self.refused["no daemon"] += 1
        elif request.method in page_calls.SAFETY or request.method in self._methods:
            self._look_into(request, body)
        else:
            self._pass_on(request, body)

    def _pass_on(self, request: Request, body: bytes) -> None:
        if not self._has_room(request):
            return
        if not request.has_id:
            if not self._relay.notify(body):
                self.refused["no daemon"] += 1
        elif not self._relay.passes(request):
            self._refuse(request, Code.INVALID_REQUEST, f"id: a call {request.id!r:.40} is under way already", "id")
        else:
            self._relay.call(request, body)

    def _look_into(self, seen: Request, body: bytes) -> None:
        """A call whose params this process has to know; `seen` has none yet."""
        if seen.method in page_calls.SAFETY and len(body) > _SMALL:
            self._refuse(seen, Code.INVALID_PARAMS, f"params: more than {_SMALL} bytes", "size")
            return
        request = self._decoded(body)
        if request is None:
            return
        stops = request.method == "set_forces" and request.params.get("enabled") is False
        if not stops and not self._has_room(request):
            return
        # The stop is not counted among the calls under way, nor does it wait for any.
        task = asyncio.create_task(self._carry_out(request), name=f"page-{request.method:.40}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _has_room(self, request: Request) -> bool:
        if len(self._relay) + len(self._tasks) >= UNDER_WAY:
            self._refuse(request, TOO_MUCH, f"{UNDER_WAY} calls of this page are under way already", "calls")
            return False
        if not self._limits.calls.take_if_there(1):
            self._refuse(request, TOO_MUCH, "this page calls too often", "calls")
            return False
        return True

    def _refuse_form(self, body: bytes) -> None:
        """What is no request at a first look: the decoder says why."""
        if self._decoded(body) is not None:
            raise AssertionError("a request that was not seen as one")

    def _decoded(self, body: bytes) -> Request | None:
        """The request in a body; None where it is none, which is said and counted."""
        try:
            return messages.parse_request(messages.decode(body, MAX_MESSAGE))
        except WireError as error:
            self.refused["form"] += 1
            if not error.silent:
                self._answer(messages.error_reply(error.id, error.code, error.message))
            return None

    def _refuse(self, request: Request, code: int, message: str, reason: str) -> None:
        self.refused[reason] += 1
        if request.has_id:
            self._answer(messages.error_reply(request.id, code, message))

    async def _carry_out(self, request: Request) -> None:
        try:
            if request.method == "lease":
                result = await self.lease.lease(request.params)
            elif request.method == "set_forces":
                result = await self.lease.set_forces(request.params)
            else:
                result = await self._methods[request.method](self, request.params)
            reply = encode({"jsonrpc": "2.0", "id": request.id, "result": result})
        except RemoteError as error:
            reply = messages.error_reply(request.id, error.code, error.message, error.data)
        except DaemonNotRunning as error:
            reply = messages.error_reply(request.id, Code.DAEMON_AWAY, str(error))
        except HapticdError as error:
            reply = messages.error_reply(request.id, Code.INVALID_PARAMS, str(error))
        except Exception:
            _log.exception("%s failed", request.method)
            reply = messages.error_reply(request.id, Code.INTERNAL, f"{request.method} failed; the log says why")
        if request.has_id:
            self._answer(reply)

    def _answer(self, message: bytes) -> None:
        try:
            self.outbox.answer(message)
        except Overflow:
            self._ended.set()
