"""The command thread: takes one request after the other from `router.py`, and beats between them.

It waits for a request, answers it and waits again (docs/adr/0002, 0024). Between requests it goes on with the change
that is under way, and beats, so that the servo knows that somebody serves commands.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from hapticd.daemon.dispatch import Dispatch
from hapticd.daemon.engine import Engine
from hapticd.daemon.router import Router
from hapticd.protocol import messages

BEAT_EVERY_S: Final = 0.1
"""At the least."""
LOOK_EVERY_S: Final = 0.02
"""At the most: while requests come faster, so long passes until a change goes on, and until anything else is done."""


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
            reply(messages.too_long(request.size))
        else:
            dispatch.take(request.body, reply, request.peer)
    repeats.finish()
