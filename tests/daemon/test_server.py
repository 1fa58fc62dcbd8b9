"""The loop that serves commands: how it ends."""

from __future__ import annotations

import socket
import threading
from pathlib import Path
from typing import cast

import pytest

from hapticd.daemon import server
from hapticd.daemon.dispatch import Dispatch
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.router import Router


class Beating:
    """What the loop needs of an engine."""

    def __init__(self) -> None:
        self.begun = threading.Event()

    def beat(self) -> None:
        self.begun.set()

    def look_after(self) -> None:
        """Nothing is wrong here."""


def test_it_ends_without_a_request_or_a_beat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "BEAT_EVERY_S", 3600.0)
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    listening.bind(str(tmp_path / "s"))
    listening.listen()
    router = Router(listening)
    engine, stop = Beating(), threading.Event()
    # Nobody asks anything, so there are no methods to perform.
    arguments = (router, cast(Engine, engine), Dispatch(cast(Methods, None)), stop)
    thread = threading.Thread(target=server.serve, args=arguments, daemon=True)
    thread.start()
    assert engine.begun.wait(60)
    stop.set()
    router.wake()
    thread.join(60)
    assert not thread.is_alive()
    # Nor does waking keep anything from ending where nobody serves any more.
    router.wake()
    router.close()
