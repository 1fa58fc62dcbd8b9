"""The command socket: frames in, frames out, one request at a time.

One thread waits for a request, answers it and waits again (docs/adr/0002, 0024). Between requests it beats, so that the
servo knows that somebody serves commands.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Final

from hapticd import notify, wire
from hapticd.control import Control, MethodError
from hapticd.engine import Engine
from hapticd.errors import quoted
from hapticd.repeats import Repeats
from hapticd.router import Router

BEAT_EVERY_S: Final = 0.1

_log = logging.getLogger(__name__)


class Reloads:
    """Reloads of the configuration that a signal asked for. Those that nobody has begun yet are one."""

    def __init__(self, wake: Callable[[], None]) -> None:
        """`wake`: has the thread that serves commands call `serve`."""
        self._wake = wake
        self._wanted = threading.Event()

    def ask(self) -> None:
        """Has the thread that serves commands reload the configuration, in its turn. For any thread."""
        self._wanted.set()
        self._wake()

    def serve(self, control: Control) -> None:
        """Reloads if somebody asked for it; what comes of it stands in the log. For the thread that serves commands."""
        if not self._wanted.is_set():
            return
        self._wanted.clear()
        notify.reloading()
        answer(control, wire.request(0, "reload", {}))  # what comes of it is logged, a defect too
        notify.ready()


def answer(control: Control, body: bytes | None, repeats: Repeats | None = None) -> bytes | None:
    """The body of the answer to a body; None for a notification. Never raises for what a client sent.

    What a client causes is told in the log as `repeats` says.
    """
    repeats = Repeats() if repeats is None else repeats
    try:
        if body is None:
            raise wire.WireError(
                wire.Code.INVALID_REQUEST, "frames: send the body alone, or an empty frame and the body"
            )
        request = wire.parse_request(wire.decode(body))
    except wire.WireError as error:
        return None if error.silent else wire.error_reply(error.id, error.code, error.message)
    try:
        result = control.call(request.method, request.params)
        _log.debug("%s: done", request.method)
    except MethodError as error:
        _log.debug("%s: refused, %d: %s", quoted(request.method), error.code, quoted(error.message))
        if not request.has_id:
            line = f"notification {quoted(request.method)}: {quoted(error.message)}"
            # Of methods that there are not, a client can think of any number.
            kind = "" if error.code == wire.Code.NO_SUCH_METHOD else request.method
            repeats.note(f"notification {error.code} {kind}", lambda since: _log.warning("%s%s", line, since.more))
            return None
        return wire.error_reply(request.id, error.code, error.message, error.data)
    except Exception as error:
        # A defect of ours must neither leave the client without an answer nor stop the daemon.
        failure = error
        repeats.note(
            f"failed {request.method}",
            lambda since: _log.error("method %s failed%s", quoted(request.method), since.more, exc_info=failure),
        )
        if not request.has_id:
            return None
        return wire.error_reply(request.id, wire.Code.INTERNAL, "the daemon failed; its log says how")
    return wire.result_reply(request.id, result) if request.has_id else None


def serve(
    router: Router,
    engine: Engine,
    control: Control,
    stop: threading.Event,
    between: Callable[[], None] = lambda: None,
) -> None:
    """Answers requests until `stop` is set; calls `between` between them, ten times a second at least."""
    repeats = Repeats()
    while not stop.is_set():
        repeats.flush()
        engine.beat()
        engine.look_after()
        between()
        request = router.receive(BEAT_EVERY_S)
        if request is None:
            continue
        if stop.is_set():
            break
        if request.too_long:
            reply: bytes | None = wire.too_long(request.size)
        else:
            reply = answer(control, request.body, repeats)
        if reply is not None:
            router.send(request.peer, request.delimited, reply)
    repeats.finish()
