"""The command socket: frames in, frames out, one request at a time.

A blocking receive in a thread of its own, because it measured as the fastest way in (docs/adr/0002). Between requests
it beats, so that the servo knows that somebody serves commands.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Final

import zmq

from hapticd import notify, wire
from hapticd.control import Control, MethodError
from hapticd.engine import Engine
from hapticd.errors import quoted
from hapticd.repeats import Repeats, Since

BEAT_EVERY_MS: Final = 100
LARGEST_MESSAGE: Final = 64 * 1024 * 1024
"""A longer message closes the connection that it came from."""

_log = logging.getLogger(__name__)


_WAKE: Final = "inproc://wake"


def router(context: zmq.Context[zmq.Socket[bytes]]) -> zmq.Socket[bytes]:
    """The ROUTER of the command socket, which `wake` reaches and clients do not yet. Raises zmq.ZMQError."""
    socket = context.socket(zmq.ROUTER)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_MESSAGE)
    socket.setsockopt(zmq.RCVTIMEO, BEAT_EVERY_MS)
    socket.bind(_WAKE)
    return socket


def wake(context: zmq.Context[zmq.Socket[bytes]]) -> None:
    """Ends the wait for a request, so that `serve` looks whether it is to stop, or to reload. For any thread."""
    with context.socket(zmq.DEALER) as socket:
        socket.connect(_WAKE)
        socket.send(b"")


class Reloads:
    """Reloads of the configuration that a signal asked for. Those that nobody has begun yet are one."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]]) -> None:
        self._context = context
        self._wanted = threading.Event()

    def ask(self) -> None:
        """Has the thread that serves commands reload the configuration, in its turn. For any thread."""
        self._wanted.set()
        wake(self._context)

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
    socket: zmq.Socket[bytes],
    engine: Engine,
    control: Control,
    stop: threading.Event,
    between: Callable[[], None] = lambda: None,
) -> None:
    """Answers requests until `stop` is set; calls `between` between them, ten times a second at least."""
    repeats = control.repeats
    while not stop.is_set():
        repeats.flush()
        engine.beat()
        engine.look_after()
        between()
        try:
            identity, *frames = socket.recv_multipart()
        except zmq.Again:
            continue
        if stop.is_set():
            break
        delimited, body = wire.open_envelope(frames)
        reply = answer(control, body, repeats)
        if reply is not None:
            try:
                socket.send_multipart([identity, *wire.close_envelope(delimited, reply)], zmq.NOBLOCK)
            except zmq.Again:
                repeats.note("unread", _tell_unread)
    repeats.finish()


def _tell_unread(since: Since) -> None:
    _log.warning(
        "a client does not read its answers: %s dropped%s",
        "one was" if since.times == 1 else f"{since.times:,} were",
        f" {since.window}" if since.window else "",
    )
