"""The command thread: takes requests from `router.py`, answers them, and sends the servo a heartbeat between them.

Requests that change the scene or materials are carried out one at a time, in the order of their arrival, and in steps.
Between two steps other requests are answered (docs/adr/0002, 0024, 0058). A reload of the configuration is also a
change; all signals that arrive before it begins cause one reload. The heartbeat shows the servo that this thread runs.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import monotonic_ns
from typing import Final

from hapticd.base import codec
from hapticd.base.errors import quoted
from hapticd.base.steps import Steps
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import CHANGE_METHODS, Methods, Result
from hapticd.daemon.refusal import MethodError
from hapticd.daemon.router import Router
from hapticd.protocol import messages, streams
from hapticd.system import notify
from hapticd.system.repeated_lines import Repeats

MAX_WAITING_CHANGES: Final = 64
"""Largest number of requested changes, including the one under way, as docs/protocol.md states."""
MAX_WAITING_CHANGE_BYTES: Final = 2 * messages.MAX_BODY_BYTES
"""Largest size of the bodies of all requested changes together, as docs/protocol.md states."""
CHANGE_SLICE_NS: Final = 5_000_000
"""Time after which a change stops at the end of its present step, so that other requests are served."""
BEAT_INTERVAL_S: Final = 0.1
"""Longest time between two heartbeats. A servo that gets none for a second fades the forces out."""
CHORES_INTERVAL_S: Final = 0.02
"""Interval of heartbeat, servo poll, log and continued changes while requests come without a pause."""

_log = logging.getLogger("hapticd.server")

Reply = Callable[[bytes | codec.Encoded], None]
"""Sends the body of an answer to the client that sent the request."""


@dataclass(slots=True)
class _Change:
    """A requested change of the scene, the materials or the configuration."""

    request: messages.Request
    steps: Steps[Result]
    reply: Reply
    size: int
    """Size of the request's body, in bytes."""
    ended: bool = False
    """Whether the change is in force or was refused."""

    def run_slice(self) -> Result | None:
        """Continue the change for CHANGE_SLICE_NS; return the result, or None if the change is not complete.

        Raises MethodError if the change is refused.
        """
        until_ns = monotonic_ns() + CHANGE_SLICE_NS
        self.ended = True
        try:
            next(self.steps)
            while monotonic_ns() < until_ns:
                next(self.steps)
        except StopIteration as end:
            result: Result = end.value
            return result
        self.ended = False
        return None


class Dispatch:
    """Answers requests to the command socket. All methods but `ask_reload` are for the command thread."""

    def __init__(
        self, methods: Methods, repeats: Repeats | None = None, wake: Callable[[], None] = lambda: None
    ) -> None:
        """Answer requests to the command socket with `methods`.

        `repeats` limits how often the log reports errors of clients. `wake`, which any thread may call, makes the
        command thread call `queue_reload`.
        """
        self.repeats = Repeats() if repeats is None else repeats
        self._methods = methods
        self._wake = wake
        self._changes: deque[_Change] = deque()
        """Changes in the order in which they came; the first one is under way."""
        self._reload = threading.Event()
        self._reload_waits = False
        """Whether a reload is among the changes and has not begun."""

    @property
    def busy(self) -> bool:
        """Whether a change of scene or configuration is under way or waits: `continue_change` must be called soon."""
        return bool(self._changes)

    def ask_reload(self) -> None:
        """Request a reload of the configuration, unless one already waits. For any thread."""
        self._reload.set()
        self._wake()

    def take(self, body: bytes | None, reply: Reply, sender: object = None) -> None:
        """Carry out the request in `body` and answer it by `reply`, now or in a later `continue_change`.

        Errors are answered, never raised; a notification is not answered. `body`: None if the message had a wrong
        number of frames. `sender`: the connection of the message, which identifies the owner of a stream.
        """
        if body is not None and self._methods.streams.take_body(sender, body):
            return
        try:
            if body is None:
                raise messages.WireError(
                    messages.Code.INVALID_REQUEST, "frames: must be the body alone, or an empty frame and the body"
                )
            request = messages.parse_request(messages.decode(body))
        except messages.WireError as error:
            if error.method in streams.STREAM_KIND_BY_METHOD:
                self._methods.streams.refused(error.method)
            if not error.silent:
                reply(messages.error_reply(error.id, error.code, error.message))
            return
        if request.method in streams.STREAM_KIND_BY_METHOD:
            self._answer(request, lambda: self._methods.stream(request.method, request.params, sender), reply)
        elif request.method not in CHANGE_METHODS:
            self._answer(request, lambda: self._methods.perform(request.method, request.params), reply)
        elif self._has_room(len(body)):
            self._add(_Change(request, self._methods.change(request.method, request.params), reply, len(body)))
        else:
            self._answer(request, _too_many_changes, reply)

    def queue_reload(self) -> None:
        """Queue the reload that `ask_reload` requested. Must be called often, and soon after `wake`."""
        if self._reload.is_set() and not self._reload_waits:
            self._reload_waits = True
            # Nobody gets the answer: the outcome of the reload, also an unexpected error, is logged.
            self._add(_Change(messages.Request(0, True, "reload", {}), self._reloading(), _notify_ready, 0))

    def continue_change(self) -> None:
        """Continue the change of scene or configuration that is under way, or begin the next one."""
        if self._changes:
            change = self._changes[0]
            self._answer(change.request, change.run_slice, change.reply)
            if change.ended:
                self._changes.popleft()

    def _has_room(self, size: int) -> bool:
        """Return whether one more requested change, with a body of `size` bytes, may wait."""
        waiting = size + sum(change.size for change in self._changes)
        return not self._changes or (len(self._changes) < MAX_WAITING_CHANGES and waiting <= MAX_WAITING_CHANGE_BYTES)

    def _add(self, change: _Change) -> None:
        self._changes.append(change)
        if len(self._changes) == 1:
            self.continue_change()

    def _reloading(self) -> Steps[Result]:
        self._reload.clear()
        self._reload_waits = False
        notify.reloading()
        return (yield from self._methods.change("reload", {}))

    def _answer(self, request: messages.Request, perform: Callable[[], Result | None], reply: Reply) -> None:
        """Answer a request with the result or the error of `perform`; None means that the change is not complete."""
        try:
            result = perform()
            if result is None:
                return
            _log.debug("%s: done", request.method)
        except MethodError as error:
            _log.debug("%s: refused, %d: %s", quoted(request.method), error.code, quoted(error.message))
            if request.has_id:
                reply(messages.error_reply(request.id, error.code, error.message, error.data))
                return
            line = f"notification {quoted(request.method)}: {quoted(error.message)}"
            # A client can invent any number of method names: the log counts unknown methods together.
            kind = "" if error.code == messages.Code.NO_SUCH_METHOD else request.method
            self.repeats.note(f"notification {error.code} {kind}", lambda since: _log.warning("%s%s", line, since.more))
        except Exception as error:
            # An unexpected error must neither leave the client without an answer nor stop the daemon.
            failure = error
            self.repeats.note(
                f"failed {request.method}",
                lambda since: _log.error("method %s failed%s", quoted(request.method), since.more, exc_info=failure),
            )
            if request.has_id:
                reply(messages.error_reply(request.id, messages.Code.INTERNAL, "internal error; see the daemon's log"))
        else:
            if request.has_id:
                reply(messages.result_reply(request.id, result))


def _notify_ready(_: bytes | codec.Encoded) -> None:
    notify.ready()


def _too_many_changes() -> Result:
    raise MethodError(
        messages.Code.RING_FULL, "too many changes wait for their turn; this one was not carried out: send it again"
    )


def serve(
    router: Router,
    engine: Engine,
    dispatch: Dispatch,
    stop: threading.Event,
    between: Callable[[], None] = lambda: None,
) -> None:
    """Answer requests to the command socket until `stop` is set; call `between` at least ten times a second."""
    repeats = dispatch.repeats
    due_s = 0.0
    while not stop.is_set():
        if (now_s := time.monotonic()) >= due_s:
            due_s = now_s + CHORES_INTERVAL_S
            repeats.flush()
            engine.beat()
            engine.poll_servo()
            between()
            dispatch.continue_change()
        dispatch.queue_reload()
        request = router.receive(0.0 if dispatch.busy else BEAT_INTERVAL_S)
        if request is None:
            dispatch.continue_change()
            continue
        if stop.is_set():
            break
        reply = partial(router.send, request.peer, request.delimited)
        if request.too_long:
            reply(messages.too_long_reply(request.size))
        else:
            dispatch.take(request.body, reply, request.peer)
    repeats.finish()
