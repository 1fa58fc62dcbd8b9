"""The loop that serves commands: how it ends."""

from __future__ import annotations

import threading
from typing import cast

import pytest
import zmq

from hapticd import server
from hapticd.control import Control
from hapticd.dispatch import Dispatch
from hapticd.engine import Engine
from hapticd.intake import Intake


class Beating:
    """What the loop needs of an engine."""

    def __init__(self) -> None:
        self.begun = threading.Event()

    def beat(self) -> None:
        self.begun.set()

    def look_after(self) -> None:
        """Nothing is wrong here."""


class Idle:
    """What the loop needs of a control plane."""

    def __init__(self) -> None:
        self.intake = Intake()


def test_it_ends_without_a_request_or_a_beat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "BEAT_EVERY_MS", 3_600_000)
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    engine, stop = Beating(), threading.Event()
    # Nobody asks anything, so there is nothing to control.
    control = cast(Control, Idle())
    transport = server.Transport(context)
    with transport.socket:
        arguments = (transport, cast(Engine, engine), Dispatch(control), stop)
        thread = threading.Thread(target=server.serve, args=arguments, daemon=True)
        thread.start()
        assert engine.begun.wait(60)
        stop.set()
        transport.wake()
        thread.join(60)
        assert not thread.is_alive()
        # Nor does waking keep anything from ending where nobody serves any more.
        transport.wake()
    context.term()
