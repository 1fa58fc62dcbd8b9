"""The command thread: takes one request after the other from `router.py`, answers it, and beats between them.

Scene and materials change in the order in which requests came, one change at a time and in steps: between two steps
other requests are answered (docs/adr/0002, 0024, 0058). A reload of the configuration is a change, one for all signals
that asked for it before it began. The beats tell the servo that somebody serves commands.
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
from hapticd.daemon.methods import CHANGES, Methods, Result
from hapticd.daemon.refusal import MethodError
from hapticd.daemon.router import Router
from hapticd.protocol import messages, streams
from hapticd.system import notify
from hapticd.system.repeated_lines import Repeats

MOST_WAITING: Final = 64
"""Changes that wait for their turn."""
MOST_WAITING_BYTES: Final = 2 * messages.MAX_BODY_BYTES
"""Of the bodies of the changes that wait."""
SLICE_NS: Final = 5_000_000
"""So long a change goes on before other requests are looked at, and until the step is over that is under way then."""
BEAT_EVERY_S: Final = 0.1
"""The servo hears at least so often that commands are served."""
LOOK_EVERY_S: Final = 0.02
"""While requests come faster, so long passes until a change goes on, and until anything else is done."""

_log = logging.getLogger("hapticd.server")

Reply = Callable[[bytes | codec.Encoded], None]
"""Sends the body of an answer to who asked."""


@dataclass(slots=True)
class _Change:
    """A change that was asked for."""

    request: messages.Request
    steps: Steps[Result]
    reply: Reply
    size: int
    """Bytes of its body."""
    over: bool = False
    """It is in force, or was refused."""

    def go_on(self) -> Result | None:
        """Does some steps; None: there are more. Raises what refuses the change."""
        until_ns = monotonic_ns() + SLICE_NS
        self.over = True
        try:
            next(self.steps)
            while monotonic_ns() < until_ns:
                next(self.steps)
        except StopIteration as end:
            result: Result = end.value
            return result
        self.over = False
        return None


class Dispatch:
    """Answers requests; everything but `ask_reload` is for the thread that serves commands."""

    def __init__(
        self, methods: Methods, repeats: Repeats | None = None, wake: Callable[[], None] = lambda: None
    ) -> None:
        """What a client causes is reported in the log as `repeats` says. `wake` has the thread that serves commands
        call `turn`, and is called by any."""
        self.repeats = Repeats() if repeats is None else repeats
        self._methods = methods
        self._wake = wake
        self._changes: deque[_Change] = deque()
        """In the order in which they came; the first one is under way."""
        self._reload = threading.Event()
        self._reload_waits = False
        """It is among the changes, and has not begun."""

    @property
    def busy(self) -> bool:
        """Whether a change is under way, or waits: `go_on` is to be called soon."""
        return bool(self._changes)

    def ask_reload(self) -> None:
        """Has the configuration reloaded in its turn; what nobody has begun yet is one. For any thread."""
        self._reload.set()
        self._wake()

    def take(self, body: bytes | None, reply: Reply, sender: object = None) -> None:
        """Answers a body by `reply`, now or in a later `go_on`; a notification not at all. Never raises for
        what was sent. `sender`: the connection that it came over, which is whose a stream is."""
        if body is not None and self._methods.streams.take_body(sender, body):
            return
        try:
            if body is None:
                raise messages.WireError(
                    messages.Code.INVALID_REQUEST, "frames: send the body alone, or an empty frame and the body"
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
        elif request.method not in CHANGES:
            self._answer(request, lambda: self._methods.perform(request.method, request.params), reply)
        elif self._has_room(len(body)):
            self._add(_Change(request, self._methods.change(request.method, request.params), reply, len(body)))
        else:
            self._answer(request, _too_many_changes, reply)

    def turn(self) -> None:
        """Takes up a reload that was asked for. To be called when `wake` was, and often."""
        if self._reload.is_set() and not self._reload_waits:
            self._reload_waits = True
            # What comes of it is logged, a defect too.
            self._add(_Change(messages.Request(0, True, "reload", {}), self._reloading(), _tell_ready, 0))

    def go_on(self) -> None:
        """Goes on with the change that is under way, or begins the one that waits."""
        if self._changes:
            change = self._changes[0]
            self._answer(change.request, change.go_on, change.reply)
            if change.over:
                self._changes.popleft()

    def _has_room(self, size: int) -> bool:
        """For one more change, with a body of so many bytes, to wait."""
        waiting = size + sum(change.size for change in self._changes)
        return not self._changes or (len(self._changes) < MOST_WAITING and waiting <= MOST_WAITING_BYTES)

    def _add(self, change: _Change) -> None:
        self._changes.append(change)
        if len(self._changes) == 1:
            self.go_on()

    def _reloading(self) -> Steps[Result]:
        self._reload.clear()
        self._reload_waits = False
        notify.reloading()
        return (yield from self._methods.change("reload", {}))

    def _answer(self, request: messages.Request, perform: Callable[[], Result | None], reply: Reply) -> None:
        """Answers a request by what was performed for it; None: it goes on."""
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
            # Of methods that there are not, a client can think of any number.
            kind = "" if error.code == messages.Code.NO_SUCH_METHOD else request.method
            self.repeats.note(f"notification {error.code} {kind}", lambda since: _log.warning("%s%s", line, since.more))
        except Exception as error:
            # A defect of ours must neither leave the client without an answer nor stop the daemon.
            failure = error
            self.repeats.note(
                f"failed {request.method}",
                lambda since: _log.error("method %s failed%s", quoted(request.method), since.more, exc_info=failure),
            )
            if request.has_id:
                reply(messages.error_reply(request.id, messages.Code.INTERNAL, "the daemon failed; its log says how"))
        else:
            if request.has_id:
                reply(messages.result_reply(request.id, result))


def _tell_ready(_: bytes | codec.Encoded) -> None:
    notify.ready()


def _too_many_changes() -> Result:
    raise MethodError(
        messages.Code.RING_FULL, "too many changes wait for their turn; nothing of this was done: send it again"
    )


def serve(
    router: Router,
    engine: Engine,
    dispatch: Dispatch,
    stop: threading.Event,
    between: Callable[[], None] = lambda: None,
) -> None:
    """Answers requests until `stop` is set; calls `between` between them, ten times a second at least."""
    repeats = dispatch.repeats
    due_s = 0.0
    while not stop.is_set():
        if (now_s := time.monotonic()) >= due_s:
            due_s = now_s + LOOK_EVERY_S
            repeats.flush()
            engine.beat()
            engine.look_after()
            between()
            dispatch.go_on()
        dispatch.turn()
        request = router.receive(0.0 if dispatch.busy else BEAT_EVERY_S)
        if request is None:
            dispatch.go_on()
            continue
        if stop.is_set():
            break
        reply = partial(router.send, request.peer, request.delimited)
        if request.too_long:
            reply(messages.too_long_reply(request.size))
        else:
            dispatch.take(request.body, reply, request.peer)
    repeats.finish()
