"""The loop that serves commands: how it ends."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import cast

import pytest
import zmq

from hapticd import server
from hapticd.control import Control
from hapticd.engine import Engine
from hapticd.repeats import Repeats


class Beating:
    """What the loop needs of an engine."""

    def __init__(self) -> None:
        self.begun = threading.Event()

    def beat(self) -> None:
        self.begun.set()

    def look_after(self) -> None:
        """Nothing is wrong here."""


def test_it_ends_without_a_request_or_a_beat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "BEAT_EVERY_MS", 3_600_000)
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    engine, stop = Beating(), threading.Event()
    # Nobody asks anything, so there is nothing to control.
    control = cast(Control, SimpleNamespace(repeats=Repeats()))
    with server.router(context) as socket:
        thread = threading.Thread(target=server.serve, args=(socket, cast(Engine, engine), control, stop), daemon=True)
        thread.start()
        assert engine.begun.wait(60)
        stop.set()
        server.wake(context)
        thread.join(60)
        assert not thread.is_alive()
        # Nor does waking keep anything from ending where nobody serves any more.
        server.wake(context)
    context.term()
