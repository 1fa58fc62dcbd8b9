"""The connection of a page to the daemon, before a daemon runs."""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path
from typing import Any

import msgpack

from hapticd.base.codec import encode
from hapticd.protocol import messages
from hapticd.protocol.messages import Code, Request
from hapticd.system.paths import runtime_paths
from hapticd.web import daemon_relay
from hapticd.web.daemon_relay import DaemonRelay
from tests.support.daemon_process import PATIENCE_S
from tests.support.fake_daemon import fake_daemon
from tests.web.served import echo


def _call(relay: DaemonRelay, id: int) -> None:
    relay.call(Request(id, True, "mark", {}), messages.request(id, "mark", {"text": str(id)}))


def test_calls_wait_for_a_daemon_in_their_order_and_messages_of_streams_do_not() -> None:
    async def test(folder: str) -> None:
        answers: asyncio.Queue[Any] = asyncio.Queue()
        relay = DaemonRelay(runtime_paths(folder), lambda body: answers.put_nowait(msgpack.unpackb(body)))
        try:
            _call(relay, 1)
            _call(relay, 2)
            assert not relay.notify(encode({"jsonrpc": "2.0", "method": "stream_target", "params": {"seq": 0}}))
            await asyncio.sleep(0)
            _call(relay, 3)
            assert len(relay) == 3
            with fake_daemon(Path(folder), echo) as daemon:
                async with asyncio.timeout(PATIENCE_S):
                    found = [await answers.get() for _ in range(3)]
                assert [each["result"]["params"]["text"] for each in found] == ["1", "2", "3"]
                assert [request["id"] for request in daemon.requests] == [1, 2, 3]
                assert relay.notify(encode({"jsonrpc": "2.0", "method": "mark", "params": {"text": "now"}}))
        finally:
            await relay.close()

    with tempfile.TemporaryDirectory(prefix="ht-") as folder:
        asyncio.run(test(folder))


def test_calls_that_no_daemon_accepts_are_answered_one_by_one(monkeypatch: Any) -> None:
    monkeypatch.setattr(daemon_relay, "_CONNECT_TIMEOUT_S", 0.05)

    async def test(folder: str) -> None:
        answers: asyncio.Queue[Any] = asyncio.Queue()
        relay = DaemonRelay(runtime_paths(folder), lambda body: answers.put_nowait(msgpack.unpackb(body)))
        try:
            for ids in ((1, 2), (3,)):
                for id in ids:
                    _call(relay, id)
                async with asyncio.timeout(PATIENCE_S):
                    found = [await answers.get() for _ in ids]
                assert [(each["id"], each["error"]["code"]) for each in found] == [(id, Code.DAEMON_AWAY) for id in ids]
            assert len(relay) == 0
        finally:
            await relay.close()

    with tempfile.TemporaryDirectory(prefix="ht-") as folder:
        asyncio.run(test(folder))
