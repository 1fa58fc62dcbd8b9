"""One page: its WebSocket, its calls to the daemon, its queue.

Every message is binary: one msgpack value.

    page -> server   a JSON-RPC 2.0 object as for the daemon. Methods of the daemon that page_calls names are passed on
                     over a separate connection for each page. Methods that begin with `web.` are those of this
                     process: application.WEB_PAGE_METHODS lists them, and each group is a separate file.
                     A message without `id` is a notification: it is carried out and never answered.
    server -> page   the answer to a call, a map with `id`; or an array [topic, body]: telemetry as the daemon sent it,
                     of the topics that `web.subscribe` named; or ["web", {...}]: news of this process.

News have one or more of these members:

    daemon           bool: whether a daemon is connected; sent first, and after each change
    pages            int: number of open pages
    dropped          {topic: count}: dropped messages of telemetry since this page was opened
    refused          {reason: count}: refused messages of this page since it was opened
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
from hapticd.web.outbox import Outbox, OutboxFullError
from hapticd.web.page_lease import PageLease
from hapticd.web.page_limits import MAX_PENDING_CALLS, PageLimits
from hapticd.web.telemetry_hub import TelemetryHub

MAX_PAGE_MESSAGE_BYTES: Final = messages.MAX_BODY_BYTES
"""Longest message of a page: the daemon's limit."""
RATE_LIMIT_CODE: Final = -32029
"""Error code of a call beyond the limits of page_limits.py."""
PAGE_READ_TIMEOUT_S: Final = 30.0
"""Time after which a page that reads nothing is closed, to free its memory.

A page that loads on a slow machine reads nothing for seconds. Forces end earlier, with the page's lease.
"""
_CLOSE_GRACE_S: Final = 0.3
"""Time in which waiting messages are still sent to a page that is being closed."""
_MESSAGES_PER_TURN: Final = 32
"""Number of messages of a page after which other tasks of the event loop run."""
_NEWS_INTERVAL_S: Final = 1.0
"""Interval of the news `dropped` and `refused`."""
_MAX_SAFETY_CALL_BYTES: Final = 4096
"""Longest call of `lease` or `set_forces`, whose params this process reads, in bytes."""

_log = logging.getLogger("hapticd.web")

Method: TypeAlias = Callable[["Page", Mapping[str, object]], Awaitable[object]]
"""A method of this process: it gets the page and the params, and returns a map.

It raises HapticdError if the params are wrong; RemoteError and DaemonNotRunning are answered with their codes. It must
not block: long computations go to a thread.
"""


class Page:
    """An open page with its WebSocket."""

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
        daemon_methods: frozenset[str] = page_calls.DAEMON_METHODS,
    ) -> None:
        """Serve the page of the WebSocket `socket`.

        `control` is the connection for leases. The page may call `methods` of this process and `daemon_methods`.
        """
        self._socket, self.hub, self._methods = socket, hub, methods
        self.demo = demo
        self.new_address = new_address
        self.daemon = Client(place)
        """A client for the methods of this process; it connects at its first call."""
        self.outbox = Outbox()
        self.closing = contextlib.AsyncExitStack()
        """Callbacks for the end of the page, which methods add."""
        self.lease = PageLease(control)
        self.refused: Counter[str] = Counter()
        self._relay = DaemonRelay(place, self._answer)
        self._limits = PageLimits()
        self._daemon_methods = daemon_methods
        self._tasks: set[asyncio.Task[None]] = set()
        self._sent_counts: dict[str, Mapping[str, int]] = {"dropped": {}, "refused": {}}
        self._ended = asyncio.Event()

    def send_news(self, news: Mapping[str, object]) -> None:
        """Send news (changed state of this process) to the page, as ["web", news]."""
        self._answer(encode(["web", dict(news)]))

    def end(self, why: str) -> None:
        """Begin to close the page, and send it the reason `why`."""
        if not self._ended.is_set():
            with contextlib.suppress(OutboxFullError):
                self.outbox.answer(encode(["web", {"ended": why}]))
            self._ended.set()

    # ---- Begin and end -----------------------------------------------------------------------------------------------

    async def serve(self) -> None:
        """Serve the page until it disconnects or is closed."""
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
                await self._close_gracefully()
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

    async def _close_gracefully(self) -> None:
        """Send the waiting messages to a page that reads them soon, and close the WebSocket."""
        with contextlib.suppress(TimeoutError, ConnectionError):
            async with asyncio.timeout(_CLOSE_GRACE_S):
                while len(self.outbox):
                    await asyncio.sleep(0.01)
                await self._socket.close(code=WSCloseCode.GOING_AWAY)

    async def _send(self) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                message = await self.outbox.next()
                try:
                    async with asyncio.timeout(PAGE_READ_TIMEOUT_S):
                        await self._socket.send_bytes(message)
                except TimeoutError:
                    return

    async def _news(self) -> None:
        """Send the numbers of dropped and refused messages once a second if they changed."""
        while True:
            await asyncio.sleep(_NEWS_INTERVAL_S)
            now = {"dropped": dict(self.outbox.dropped), "refused": dict(self.refused)}
            news = {name: counts for name, counts in now.items() if counts != self._sent_counts[name]}
            if news:
                self._sent_counts.update(news)
                self.send_news(news)

    # ---- Messages of the page ----------------------------------------------------------------------------------------

    async def _receive(self) -> None:
        count = 0
        async for message in self._socket:
            if message.type is not WSMsgType.BINARY:
                await self._socket.close(code=WSCloseCode.UNSUPPORTED_DATA, message=b"messages are binary: msgpack")
                return
            self.received(message.data)
            wait_s = self._limits.pace(len(message.data))
            count += 1
            if wait_s > 0.0 or count % _MESSAGES_PER_TURN == 0:
                await asyncio.sleep(wait_s)

    def received(self, body: bytes) -> None:
        """Handle a message of the page."""
        request = messages.peek(body)
        if request is None or len(body) > MAX_PAGE_MESSAGE_BYTES:
            self._refuse_form(body)
        elif request.method not in self._daemon_methods and request.method not in self._methods:
            self._refuse(request, Code.NO_SUCH_METHOD, f"no method {request.method!r:.60} for a page", "method")
        elif request.method in page_calls.STREAM_METHODS and not request.has_id:
            if not self._limits.streams.try_take(1):
                self.refused["streams"] += 1
            elif not self._relay.notify(body):
                self.refused["no daemon"] += 1
        elif request.method in page_calls.SAFETY_METHODS or request.method in self._methods:
            self._handle_here(request, body)
        else:
            self._pass_on(request, body)

    def _pass_on(self, request: Request, body: bytes) -> None:
        if not self._has_room(request):
            return
        if not request.has_id:
            if not self._relay.notify(body):
                self.refused["no daemon"] += 1
        elif not self._relay.is_id_free(request):
            self._refuse(request, Code.INVALID_REQUEST, f"id: a call {request.id!r:.40} is already under way", "id")
        else:
            self._relay.call(request, body)

    def _handle_here(self, head: Request, body: bytes) -> None:
        """Handle a call whose params this process must read; `head` is the request without its params."""
        if head.method in page_calls.SAFETY_METHODS and len(body) > _MAX_SAFETY_CALL_BYTES:
            self._refuse(head, Code.INVALID_PARAMS, f"params: must have at most {_MAX_SAFETY_CALL_BYTES} bytes", "size")
            return
        request = self._decoded(body)
        if request is None:
            return
        stops = request.method == "set_forces" and request.params.get("enabled") is False
        if not stops and not self._has_room(request):
            return
        # Turning forces off is neither limited by the calls under way nor delayed by them.
        task = asyncio.create_task(self._carry_out(request), name=f"page-{request.method:.40}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _has_room(self, request: Request) -> bool:
        if len(self._relay) + len(self._tasks) >= MAX_PENDING_CALLS:
            self._refuse(
                request, RATE_LIMIT_CODE, f"{MAX_PENDING_CALLS} calls of this page are already under way", "calls"
            )
            return False
        if not self._limits.calls.try_take(1):
            self._refuse(request, RATE_LIMIT_CODE, "too many calls a second of this page", "calls")
            return False
        return True

    def _refuse_form(self, body: bytes) -> None:
        """Refuse a body that `peek` did not recognize as a request; the decoder reports the reason."""
        if self._decoded(body) is not None:
            raise AssertionError("messages.peek rejected a valid request")

    def _decoded(self, body: bytes) -> Request | None:
        """Return the request in a body. If it is not valid, answer with an error, count it and return None."""
        try:
            return messages.parse_request(messages.decode(body, MAX_PAGE_MESSAGE_BYTES))
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
            reply = messages.error_reply(request.id, Code.INTERNAL, f"{request.method} failed; see the log")
        if request.has_id:
            self._answer(reply)

    def _answer(self, message: bytes) -> None:
        try:
            self.outbox.answer(message)
        except OutboxFullError:
            self._ended.set()
