"""The command socket: frames in, frames out, one request at a time.

One thread waits for a request, answers it and waits again (docs/adr/0002, 0024). Between requests it beats, so that the
servo knows that somebody serves commands.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

from hapticd.base import codec
from hapticd.daemon.dispatch import Dispatch
from hapticd.daemon.engine import Engine
from hapticd.daemon.router import Request, Router
from hapticd.protocol import messages

BEAT_EVERY_S: Final = 0.1


def serve(
    router: Router,
    engine: Engine,
    dispatch: Dispatch,
    stop: threading.Event,
    between: Callable[[], None] = lambda: None,
) -> None:
    """Answers requests until `stop` is set; calls `between` between them, ten times a second at least."""
    repeats = dispatch.repeats
    while not stop.is_set():
        repeats.flush()
        engine.beat()
        engine.look_after()
        between()
        dispatch.turn()
        request = router.receive(BEAT_EVERY_S)
        if request is None:
            continue
        if stop.is_set():
            break

        def reply(answer: bytes | codec.Encoded, request: Request = request) -> None:
            router.send(request.peer, request.delimited, answer)

        if request.too_long:
            reply(messages.too_long(request.size))
        else:
            dispatch.take(request.body, reply)
    repeats.finish()
