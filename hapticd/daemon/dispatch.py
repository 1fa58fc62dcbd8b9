"""Who answers a request: the thread that serves commands, or one beside it for what takes long to take in.

Scene and materials change in the order in which requests came. While a long change is taken in, brief ones wait for at
most WAIT_S, and another long one is refused. Everything else is answered meanwhile; `get_state` when the thread that
reads the samples has come to it. A reload of the configuration is a long change, one for all signals that asked for it
before it began.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from time import monotonic_ns
from typing import Final

from hapticd.base import codec
from hapticd.base.errors import quoted
from hapticd.daemon.intake import GivenUpError, Work
from hapticd.daemon.methods import CHANGES, Changed, Done, MethodError, Methods, TakesLongError
from hapticd.protocol import messages, streams
from hapticd.system import notify
from hapticd.system.repeated_lines import Repeats

WAIT_S: Final = 1.0
"""So long a brief change waits for a long one."""
MOST_WAITING: Final = 64
LARGE_BODY: Final = 64 * 1024
"""Larger bodies, bytes, are decoded beside."""
BRIEF_BODY: Final = 16 * 1024
"""Changes with larger ones take long."""

_log = logging.getLogger("hapticd.server")

Reply = Callable[[bytes | codec.Encoded], None]
"""Sends the body of an answer to who asked."""


@dataclass(frozen=True, slots=True)
class _Asked:
    """A request that another thread answers, when it comes to it."""

    request: messages.Request
    answer: Future[dict[str, object]]
    until_ns: int
    reply: Reply


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A change that waits for another one."""

    request: messages.Request
    size: int
    until_ns: int
    reply: Reply


class Dispatch:
    """Answers requests; everything but `ask_reload` is for the thread that serves commands."""

    def __init__(self, methods: Methods, repeats: Repeats | None = None) -> None:
        """What a client causes is reported in the log as `repeats` says."""
        self.repeats = Repeats() if repeats is None else repeats
        self._methods = methods
        self._waiting: deque[_Waiting] = deque()
        self._asked: deque[_Asked] = deque()
        self._reload = threading.Event()

    def ask_reload(self) -> None:
        """Has the configuration reloaded in its turn; what nobody has begun yet is one. For any thread."""
        self._reload.set()
        self._methods.intake.wake()

    def take(self, body: bytes | None, reply: Reply, sender: object = None) -> None:
        """Answers a body by `reply`, now or in a later `turn`; a notification not at all. Never raises for what was
        sent. `sender`: the connection that it came over, which is whose a stream is."""
        if body is not None:
            if self._methods.streams.take_body(sender, body):
                return
            if len(body) > LARGE_BODY and self._take_large(body, reply):
                return
        try:
            if body is None:
                raise messages.WireError(
                    messages.Code.INVALID_REQUEST, "frames: send the body alone, or an empty frame and the body"
                )
            request = messages.parse_request(messages.decode(body))
        except messages.WireError as error:
            if error.method in streams.METHODS:
                self._methods.streams.refused(error.method)
            _answer_error(error, reply)
            return
        if request.method in streams.METHODS:
            self._answer(request, lambda: self._methods.stream(request.method, request.params, sender), reply)
        elif request.method not in CHANGES:
            self._answer(request, lambda: self._methods.perform(request.method, request.params), reply)
        elif self._methods.intake.work is None and not self._waiting:
            self._change(request, len(body), reply)
        elif self._is_long(request, len(body)) or len(self._waiting) >= MOST_WAITING:
            self._refuse(request, reply)
        else:
            until_ns = monotonic_ns() + int(WAIT_S * 1e9)
            self._waiting.append(_Waiting(request, len(body), until_ns, reply))

    def turn(self) -> None:
        """Answers what is over, and does what has waited for it. To be called when intake's `wake` was, and often."""
        intake = self._methods.intake
        intake.finished()
        if not (self._waiting or self._asked or self._reload.is_set()):
            return
        while self._waiting and intake.work is None:
            waited = self._waiting.popleft()
            self._change(waited.request, waited.size, waited.reply)
        now_ns = monotonic_ns()
        while self._waiting and self._waiting[0].until_ns < now_ns:
            waited = self._waiting.popleft()
            self._refuse(waited.request, waited.reply)
        for _ in range(len(self._asked)):
            asked = self._asked.popleft()
            if asked.answer.done():
                self._answer(asked.request, asked.answer.result, asked.reply)
            elif asked.until_ns < now_ns:
                self._answer(asked.request, _late, asked.reply)
            else:
                self._asked.append(asked)
        if self._reload.is_set() and intake.work is None:
            self._reload.clear()
            notify.reloading()
            # What comes of it is logged, a defect too.
            self._beside(messages.Request(0, True, "reload", {}), lambda _: _ready())

    def _take_large(self, body: bytes, reply: Reply) -> bool:
        """Whether this was a change; it is taken in beside, or refused."""
        found = messages.peek(body)
        if found is None or found.method not in CHANGES:
            return False
        if self._methods.intake.work is not None or self._waiting:
            self._refuse(found, reply)
            return True

        def do(work: Work) -> Callable[[], object]:
            try:
                request = messages.parse_request(messages.decode(body))
            except messages.WireError as error:
                failure = error
                return lambda: _answer_error(failure, reply)
            return self._long(request, work, reply)

        self._methods.intake.begin(found.method, do)
        return True

    def _is_long(self, request: messages.Request, size: int) -> bool:
        return size > BRIEF_BODY or self._methods.takes_long(request.method, request.params)

    def _change(self, request: messages.Request, size: int, reply: Reply) -> None:
        if not self._is_long(request, size):
            try:
                self._answer(request, lambda: self._methods.perform(request.method, request.params, brief=True), reply)
                return
            except TakesLongError:
                pass
        self._beside(request, reply)

    def _beside(self, request: messages.Request, reply: Reply) -> None:
        self._methods.intake.begin(request.method, lambda work: self._long(request, work, reply))

    def _long(self, request: messages.Request, work: Work, reply: Reply) -> Callable[[], object]:
        """In a separate thread: makes a change; what is returned answers it."""
        with self._methods.beside(work):
            try:
                done = self._methods.perform(request.method, request.params)
            except BaseException as error:
                failure = error
                if isinstance(error, MethodError):
                    error.__traceback__ = None  # which would keep the whole message

                def fail() -> Changed:
                    raise failure

                return lambda: self._answer(request, fail, reply)
        return lambda: self._answer(request, lambda: done, reply)

    def _refuse(self, request: messages.Request, reply: Reply) -> None:
        work = self._methods.intake.work

        def refused() -> Changed:
            method = "another change" if work is None else f"{work.method} of another request"
            data = None if work is None else {"intake": work.status()}
            raise MethodError(
                messages.Code.RING_FULL,
                f"{method} is still being taken in; nothing of this was done: send it again",
                data,
            )

        self._answer(request, refused, reply)

    def _wait_for(self, request: messages.Request, answer: Future[dict[str, object]], reply: Reply) -> None:
        """Answers once the other thread has; meanwhile others are served. Raises MethodError."""
        if len(self._asked) >= MOST_WAITING:
            raise MethodError(
                messages.Code.RING_FULL, f"{MOST_WAITING} of {request.method} are under way; send it again later"
            )
        self._asked.append(_Asked(request, answer, monotonic_ns() + int(WAIT_S * 1e9), reply))
        answer.add_done_callback(lambda _: self._methods.intake.wake())

    def _answer(
        self, request: messages.Request, perform: Callable[[], Done | Future[dict[str, object]]], reply: Reply
    ) -> None:
        """Answers a request by what was performed for it, at once or later. Raises TakesLongError."""
        try:
            done = perform()
            if isinstance(done, Future):
                self._wait_for(request, done, reply)
                return
            result = self._methods.finish(done)
            _log.debug("%s: done", request.method)
        except TakesLongError:
            raise
        except GivenUpError:
            return  # nobody is answered any more
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


def _late() -> Done:
    raise MethodError(messages.Code.WAIT_TIMED_OUT, f"no tick was rendered within {WAIT_S:g} s")


def _ready() -> None:
    notify.ready()


def _answer_error(error: messages.WireError, reply: Reply) -> None:
    if not error.silent:
        reply(messages.error_reply(error.id, error.code, error.message))
