"""Messages of the WebSocket: allowed calls of a page, their limits, and refused messages."""

from __future__ import annotations

import asyncio
import random
from typing import Any

import aiohttp
import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.daemon.methods import _METHOD_HANDLERS
from hapticd.protocol import messages, streams
from hapticd.protocol.messages import Code, WireError
from hapticd.web import outbox, page_calls, page_limits
from hapticd.web.application import MAX_OPEN_PAGES
from hapticd.web.page import MAX_PAGE_MESSAGE_BYTES, RATE_LIMIT_CODE
from hapticd.web.token_bucket import Bucket
from tests.support.fake_daemon import result
from tests.web.served import WebSite, echo, served, tab, until


def silent(_: dict[str, Any]) -> list[bytes]:
    return []


@pytest.mark.parametrize("method", sorted(page_calls.FORWARDED_METHODS))
def test_calls_pass_as_they_are(method: str) -> None:
    async def test() -> None:
        async with served() as site, tab(site) as page:
            params = {"scene": {"a": [1, 2.5, None, b"\x00"]}}
            answer = await page.call(method, params)
            assert answer["result"] == {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}

    asyncio.run(test())


@pytest.mark.parametrize("method", ["reload", "dump_flight", "", "web.", "web.nothing", "__class__", "GET_STATUS"])
def test_what_is_not_listed_is_refused_and_never_reaches_the_daemon(method: str) -> None:
    async def test() -> None:
        async with served() as site, tab(site) as page:
            assert (await page.call(method))["error"]["code"] == Code.NO_SUCH_METHOD
            await page.notify(method)
            await page.call("get_status")
            assert [request["method"] for request in site.daemon.requests] == ["get_status"]

    asyncio.run(test())


def test_every_method_of_the_daemon_is_allowed_or_refused() -> None:
    known = {*_METHOD_HANDLERS, *streams.STREAM_KIND_BY_METHOD}
    assert known - page_calls.FORWARDED_METHODS - page_calls.SAFETY_METHODS - page_calls.STREAM_METHODS == {
        "reload",
        "dump_flight",
    }


def test_answers_keep_their_ids() -> None:
    async def test() -> None:
        async with served() as site, tab(site) as page:
            for id in (0, -5, 2**63, "x", 1.5, None, ""):
                await page.send({"jsonrpc": "2.0", "id": id, "method": "get_status"})
                assert (await page.answer(id))["result"]["id"] == id

    asyncio.run(test())


def test_two_calls_of_one_id_at_a_time_are_refused() -> None:
    async def test() -> None:
        async with served(silent) as site, tab(site) as page:
            await page.send({"jsonrpc": "2.0", "id": 7, "method": "get_status"})
            await page.send({"jsonrpc": "2.0", "id": 7, "method": "get_scene"})
            assert (await page.answer(7))["error"]["code"] == Code.INVALID_REQUEST

    asyncio.run(test())


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"", Code.PARSE),
        (b"\xc1", Code.PARSE),
        (b"\x81", Code.PARSE),
        (b"\xdf\xff\xff\xff\xff", Code.PARSE),
        (b"\xdd\xff\xff\xff\xff", Code.PARSE),
        (b"\x91" * 10_000, Code.PARSE),
        (msgpack.packb([1, 2]), Code.INVALID_REQUEST),
        (msgpack.packb(5), Code.INVALID_REQUEST),
        (msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": 5}), Code.INVALID_REQUEST),
        (msgpack.packb({"jsonrpc": "2.0", "id": [1], "method": "get_status"}), Code.INVALID_REQUEST),
        (msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": "web.hello"}) + b"\xc0", Code.PARSE),
        (msgpack.packb({"jsonrpc": "1.0", "id": 1, "method": "web.hello"}), Code.INVALID_REQUEST),
        (msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": "web.hello", "params": [1]}), Code.INVALID_PARAMS),
        (msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": "web.subscribe", "params": {"topics": [{}]}}), -32602),
        (msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": "web.subscribe", "params": {"topics": "all"}}), -32602),
    ],
)
def test_nonsense_is_answered_with_what_is_wrong(body: bytes, code: int) -> None:
    async def test() -> None:
        async with served() as site, tab(site) as page:
            await page.socket.send_bytes(body)
            while isinstance(message := await page.receive(), list):
                pass
            assert message["error"]["code"] == code
            assert "result" in await page.call("web.hello")

    asyncio.run(test())


def test_text_and_what_is_too_large_close_the_page() -> None:
    async def test() -> None:
        async with served() as site:
            for send in (
                lambda socket: socket.send_str("{}"),
                lambda socket: socket.send_bytes(bytes(MAX_PAGE_MESSAGE_BYTES + 1)),
            ):
                async with tab(site) as page:
                    await send(page.socket)
                    while (message := await page.socket.receive()).type is aiohttp.WSMsgType.BINARY:
                        pass
                    assert message.type is aiohttp.WSMsgType.CLOSE and message.data in (1003, 1009)
            async with tab(site) as page:
                assert "result" in await page.call("web.hello")

    asyncio.run(test())


def packed(**members: object) -> bytes:
    body: bytes = msgpack.packb(members)
    return body


SEEDS = [
    packed(jsonrpc="2.0", id=1, method="get_status"),
    packed(jsonrpc="2.0", id="a", method="set_forces", params={"enabled": False}),
    packed(jsonrpc="2.0", method="stream_target", params={"seq": 1, "position_m": [0.0, 0.0]}),
    packed(jsonrpc="2.0", id=3, method="lease", params={"duration_s": 0.5}),
    packed(jsonrpc="2.0", id=4, method="web.subscribe", params={"topics": ["state"]}),
    packed(id=1, method="reload", jsonrpc="2.0"),
]


def mutated(random_: random.Random) -> bytes:
    body = bytearray(random_.choice(SEEDS))
    for _ in range(random_.randrange(4)):
        kind = random_.randrange(4)
        at = random_.randrange(len(body) + 1)
        if kind == 0 and at < len(body):
            body[at] = random_.randrange(256)
        elif kind == 1:
            body[at:at] = random_.randbytes(random_.randrange(1, 4))
        elif kind == 2:
            del body[at : at + random_.randrange(1, 9)]
        else:
            body += random_.choice(SEEDS)[at:]
    return bytes(body)


@settings(max_examples=300)
@given(st.randoms(use_true_random=False))
def test_what_the_daemon_would_take_is_seen_as_the_same_call(random_: random.Random) -> None:
    """The server reads only method and id: it must read the same method as the daemon."""
    body = mutated(random_)
    try:
        request = messages.parse_request(messages.decode(body))
    except WireError:
        return
    seen = messages.peek(body)
    assert seen is not None
    assert (seen.method, seen.id, seen.has_id) == (request.method, request.id, request.has_id)


def test_a_message_with_two_methods_is_refused() -> None:
    """The daemon refuses a duplicate key."""
    key = msgpack.packb("method")
    body = b"\x84" + msgpack.packb("jsonrpc") + msgpack.packb("2.0") + msgpack.packb("id") + b"\x01"
    for first, second in (("reload", "get_status"), ("get_status", "reload")):
        with pytest.raises(WireError):
            messages.decode(body + key + msgpack.packb(first) + key + msgpack.packb(second))


@pytest.mark.slow
def test_ten_thousand_mutated_messages() -> None:
    async def test() -> None:
        random_ = random.Random(1)
        async with served() as site, tab(site) as page:
            drained = asyncio.create_task(page.answer("last"))
            for _ in range(10_000):
                await page.socket.send_bytes(mutated(random_))
            await page.send({"jsonrpc": "2.0", "id": "last", "method": "web.hello"})
            await drained
            async with tab(site) as other:
                assert "result" in await other.call("web.hello")
                assert len(site.pages.open) == 2
            reached = [request for request in site.daemon.requests if "undecodable" not in request]
            assert len(reached) > 100
            assert not {request["method"] for request in reached} & {"reload", "dump_flight"}
            on = [request for request in reached if request["method"] == "set_forces" and request.get("params")]
            assert not any(request["params"].get("enabled") is True for request in on)

    asyncio.run(test())


# ---- Limits ----------------------------------------------------------------------------------------------------------


def test_calls_under_way_are_bounded_and_stop_passes() -> None:
    def answer(request: dict[str, Any]) -> list[bytes]:
        return [result(request, {})] if request["method"] == "set_forces" else []

    async def test() -> None:
        async with served(answer) as site, tab(site) as page:
            for id in range(page_limits.MAX_PENDING_CALLS):
                await page.send({"jsonrpc": "2.0", "id": f"w{id}", "method": "get_status"})
            refused = await page.call("get_status")
            assert refused["error"]["code"] == RATE_LIMIT_CODE
            assert "result" in await page.call("set_forces", {"enabled": False})
            assert (await page.telemetry("refused"))["refused"] == {"calls": 1}

    asyncio.run(test())


def test_calls_a_second_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_limits, "MAX_CALLS_PER_S", 5.0)

    async def test() -> None:
        async with served() as site, tab(site) as page:
            answers = [await page.call("get_status") for _ in range(30)]
            assert "result" in answers[0] and answers[-1]["error"]["code"] == RATE_LIMIT_CODE
            assert "result" in await page.call("set_forces", {"enabled": False})

    asyncio.run(test())


def test_streams_a_second_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_limits, "MAX_STREAMS_PER_S", 40.0)

    async def test() -> None:
        async with served() as site, tab(site) as page:
            assert "result" in await page.call("get_status")  # waits for the connection: streams before it are refused
            for seq in range(200):
                await page.notify("stream_target", {"seq": seq, "position_m": [0.0, 0.0]})
            assert "result" in await page.call("get_status")
            passed = sum(request["method"] == "stream_target" for request in site.daemon.requests)
            (open_page,) = site.pages.open
            assert 10 <= passed < 200
            assert passed + open_page.refused["streams"] == 200

    asyncio.run(test())


def test_a_token_bucket_limits_burst_and_rate() -> None:
    now = 0.0
    allowance = Bucket(10.0, 5.0, lambda: now)
    assert [allowance.try_take(1) for _ in range(7)] == [True] * 5 + [False] * 2
    now = 0.1
    assert [allowance.try_take(1) for _ in range(2)] == [True, False]
    now = 100.0
    assert [allowance.try_take(1) for _ in range(6)] == [True] * 5 + [False]
    assert allowance.take(20.0) == pytest.approx(2.0)


def test_pages_are_bounded() -> None:
    async def test() -> None:
        async with served(there=False) as site, aiohttp.ClientSession() as session:
            headers = {**site.cookie, **site.origin}
            opened = [await session.ws_connect(f"{site.url}/socket", headers=headers) for _ in range(MAX_OPEN_PAGES)]
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await session.ws_connect(f"{site.url}/socket", headers=headers)
            assert refused.value.status == 503
            await opened[0].close()
            await until(lambda: len(site.pages.open) < MAX_OPEN_PAGES)
            await (await session.ws_connect(f"{site.url}/socket", headers=headers)).close()
            for socket in opened:
                await socket.close()

    asyncio.run(test())


# ---- Telemetry -------------------------------------------------------------------------------------------------------


def test_telemetry_passes_as_it_came_to_each_page_that_wants_it() -> None:
    async def test() -> None:
        async with served() as site, tab(site) as one, tab(site) as other:
            await one.call("web.subscribe", {"topics": ["samples", "event"]})
            await other.call("web.subscribe", {"topics": ["event"]})
            await published(site, one, "samples", {"first_tick": 5, "data": b"\x01\x02"})
            site.daemon.publish("event", {"event": "mark"})
            assert await one.telemetry("event") == {"event": "mark"}
            assert await other.telemetry("event") == {"event": "mark"}
            await other.call("web.subscribe", {"topics": []})
            assert set(site.pages.hub._wanted.elements()) == {"samples", "event"}

    asyncio.run(test())


async def published(site: WebSite, page: Any, topic: str, body: dict[str, Any]) -> None:
    """Publish a message until it arrives, because a subscription takes time to reach the daemon."""
    arrived = asyncio.create_task(page.telemetry(topic))
    while not arrived.done():
        site.daemon.publish(topic, body)
        await asyncio.sleep(0.005)
    assert arrived.result() == body


def test_the_page_gets_news_when_the_daemon_ends_and_starts() -> None:
    async def test() -> None:
        async with served(there=False) as site, tab(site) as page:
            while not (await page.telemetry("daemon"))["daemon"]:
                pass
            await asyncio.to_thread(site.daemon.close)
            while (await page.telemetry("daemon"))["daemon"]:
                pass
            again = type(site.daemon)(site.daemon.directory, echo)
            try:
                while not (await page.telemetry("daemon"))["daemon"]:
                    pass
                assert "result" in await page.call("get_status")
            finally:
                await asyncio.to_thread(again.close)
            site.daemon.close = lambda: None  # type: ignore[method-assign]

    asyncio.run(test())


def test_an_outbox_drops_the_oldest_of_a_topic_and_no_answer() -> None:
    async def test() -> None:
        box = outbox.Outbox()
        for number in range(1000):
            box.telemetry("state", b"state %d" % number)
            box.telemetry("samples", b"samples %d" % number)
        box.answer(b"answer")
        kept = outbox.MAX_WAITING_BY_TOPIC["samples"]
        assert len(box) == kept + 2
        assert len(box._telemetry) <= 2 * sum(outbox.MAX_WAITING_BY_TOPIC.values()) + 1
        assert box.dropped == {"state": 999, "samples": 1000 - kept}
        sent = [await box.next() for _ in range(len(box))]
        assert sent[0] == b"answer"
        assert sent[1:] == [
            *(b"samples %d" % number for number in range(1000 - kept, 999)),
            b"state 999",
            b"samples 999",
        ]

    asyncio.run(test())


def test_messages_that_wait_for_a_closed_page_are_dropped() -> None:
    async def test() -> None:
        box = outbox.Outbox()
        box.answer(b"a")
        for _ in range(3):
            box.telemetry("samples", b"s")
        box.telemetry("state", b"t")
        assert len(box) == 5
        box.close()
        assert len(box) == 0 and not box.dropped

    asyncio.run(test())


def test_waiting_answers_are_limited() -> None:
    async def test() -> None:
        box = outbox.Outbox()
        with pytest.raises(outbox.OutboxFullError):
            for _ in range(outbox.MAX_WAITING_ANSWERS + 1):
                box.answer(b"x")
        box = outbox.Outbox()
        with pytest.raises(outbox.OutboxFullError):
            for _ in range(17):
                box.answer(bytes(1 << 20))

    asyncio.run(test())
