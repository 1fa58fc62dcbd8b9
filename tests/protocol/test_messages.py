"""The decoder and the envelope, against msgpack's own decoder and against a decoder written from the specification."""

from __future__ import annotations

import math
import struct
import sys
import tracemalloc
from typing import Any

import msgpack
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hapticd.base import codec
from hapticd.protocol import messages
from hapticd.protocol.messages import Code, WireError

INTEGERS = st.integers(-(2**63), 2**64 - 1)
SCALARS = st.none() | st.booleans() | INTEGERS | st.floats() | st.text() | st.binary(max_size=40)
TREES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(), inner, max_size=6), max_leaves=40
)


class Refused(Exception):
    """The reference refuses a body."""


def reference(body: bytes) -> object:
    """A plain recursive decoder, from the msgpack specification and the protocol's rules; for short bodies."""
    position = 0

    def take(count: int) -> bytes:
        nonlocal position
        if len(body) - position < count:
            raise Refused
        position += count
        return body[position - count : position]

    def number(form: str) -> Any:
        return struct.unpack(">" + form, take(struct.calcsize(form)))[0]

    def text(length: int) -> str:
        try:
            return take(length).decode("utf-8")
        except UnicodeDecodeError:
            raise Refused from None

    def array(length: int, depth: int) -> list[object]:
        if depth == codec.MAX_DEPTH:
            raise Refused
        return [value(depth + 1) for _ in range(length)]

    def mapping(length: int, depth: int) -> dict[str, object]:
        if depth == codec.MAX_DEPTH:
            raise Refused
        result: dict[str, object] = {}
        for _ in range(length):
            key = value(depth + 1)
            if type(key) is not str or key in result:
                raise Refused
            result[key] = value(depth + 1)
        return result

    def value(depth: int) -> object:
        head = take(1)[0]
        if head < 0x80:
            return head
        if head >= 0xE0:
            return head - 256
        if head < 0x90:
            return mapping(head & 15, depth)
        if head < 0xA0:
            return array(head & 15, depth)
        if head < 0xC0:
            return text(head & 31)
        plain = {0xC0: None, 0xC2: False, 0xC3: True}
        if head in plain:
            return plain[head]
        numbers = {
            0xCA: "f", 0xCB: "d", 0xCC: "B", 0xCD: "H", 0xCE: "I", 0xCF: "Q",
            0xD0: "b", 0xD1: "h", 0xD2: "i", 0xD3: "q",
        }  # fmt: skip
        if head in numbers:
            return number(numbers[head])
        sized: dict[int, tuple[str, Any]] = {
            0xC4: ("B", take), 0xC5: ("H", take), 0xC6: ("I", take),
            0xD9: ("B", text), 0xDA: ("H", text), 0xDB: ("I", text),
        }  # fmt: skip
        if head in sized:
            form, read = sized[head]
            return read(number(form))
        if head in (0xDC, 0xDD):
            return array(number("H" if head == 0xDC else "I"), depth)
        if head in (0xDE, 0xDF):
            return mapping(number("H" if head == 0xDE else "I"), depth)
        raise Refused  # 0xC1 and the extensions

    result = value(0)
    if position != len(body):
        raise Refused
    return result


def outcome(decode: Any, body: bytes) -> object:
    """Return the result of a decoder for a body; NaN compares equal to itself."""
    try:
        return repr(decode(body))
    except (Refused, WireError) as error:
        assert isinstance(error, Refused) or (error.code == Code.PARSE and "\n" not in str(error))
        return "refused"


def code_of(body: bytes) -> int:
    with pytest.raises(WireError) as caught:
        messages.decode(body)
    return caught.value.code


# ---- decoding ------------------------------------------------------------------------------------------------


@given(st.binary(max_size=60))
def test_any_bytes_decode_as_the_specification_says(body: bytes) -> None:
    assert outcome(messages.decode, body) == outcome(reference, body)


@pytest.mark.long
@given(TREES)
def test_what_is_encoded_is_decoded(tree: object) -> None:
    assert repr(messages.decode(codec.encode(tree))) == repr(tree)


@pytest.mark.long
@given(
    st.recursive(
        SCALARS | st.builds(msgpack.Timestamp, st.integers(-(2**63), 2**63 - 1), st.integers(0, 10**9 - 1)),
        lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.binary() | INTEGERS, inner),
        max_leaves=10,
    )
)
@example({"data": msgpack.Timestamp(1)})
@example({"data": msgpack.Timestamp(1, 1)})
@example({"data": msgpack.Timestamp(-1)})
@example({b"": None})
@example({b"x" * 300: None})
def test_a_client_refuses_what_the_daemon_would(tree: object) -> None:
    def checked(body: bytes) -> object:
        messages.check_encoded(body)
        return messages.decode_trusted(body)

    body = msgpack.packb(tree)
    assert outcome(checked, body) == outcome(messages.decode, body)


@pytest.mark.long
@given(TREES, st.data())
def test_a_damaged_message_decodes_as_the_specification_says(tree: object, data: st.DataObject) -> None:
    body = bytearray(msgpack.packb(tree))
    for _ in range(data.draw(st.integers(1, 3))):
        body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))
    assert outcome(messages.decode, bytes(body)) == outcome(reference, bytes(body))


@pytest.mark.long
@given(TREES, st.integers(0, 200))
def test_a_message_in_the_long_form_decodes_alike(tree: object, pad: int) -> None:
    """The decoder has a separate path for bodies over 4 KiB or with many containers."""
    padded = [tree, "x" * 5000, [[]] * pad]
    assert repr(messages.decode(msgpack.packb(padded))) == repr(padded)


@pytest.mark.parametrize("pad", [b"", b"\xda\x20\x00" + b"x" * 8192], ids=["short", "long"])
@pytest.mark.parametrize("depth", [1, 31, 32, 33, 100, 1100])
def test_depth_is_limited(depth: int, pad: bytes) -> None:
    inner = pad or b"\xc0"
    body = b"\x91" * depth + inner
    if depth <= codec.MAX_DEPTH:
        messages.decode(body)
    else:
        assert code_of(body) == Code.PARSE
    maps = b"\x81\xa1a" * depth + inner
    assert (outcome(messages.decode, maps) == "refused") == (depth > codec.MAX_DEPTH)


@pytest.mark.parametrize(
    "body",
    [
        b"\x91" * 100_000,
        b"\x91" * messages.MAX_BODY_BYTES,
        b"\x81\xa0" * (messages.MAX_BODY_BYTES // 2),
        b"\xdd" + struct.pack(">I", 64_000_000),
        b"\xdf" + struct.pack(">I", 64_000_000),
        b"\xdb" + struct.pack(">I", 0xFFFFFFFF),
        b"\xc9" + struct.pack(">I", 0xFFFFFFFF) + b"\x01",
        (b"\xdd" + struct.pack(">I", 2_000_000)) * (messages.MAX_BODY_BYTES // 5),
        (b"\xdd" + struct.pack(">I", 2_000_000)) * 20 + b"\x01" * (messages.MAX_BODY_BYTES - 100),
        (b"\xdd" + struct.pack(">I", 64_000_000)) * 30,
        b"x" * (messages.MAX_BODY_BYTES + 1),
    ],
    ids=range(11),
)
def test_lies_about_size_cost_no_memory(body: bytes) -> None:
    tracemalloc.start()
    try:
        assert code_of(body) == Code.PARSE
        assert tracemalloc.get_traced_memory()[1] < 2 * len(body) + 1_000_000
    finally:
        tracemalloc.stop()


def test_the_largest_body_is_taken_and_one_byte_more_is_not() -> None:
    header = b"\xc6" + struct.pack(">I", messages.MAX_BODY_BYTES - 5)
    assert len(messages.decode(header + bytes(messages.MAX_BODY_BYTES - 5))) == messages.MAX_BODY_BYTES - 5  # type: ignore[arg-type]
    header = b"\xc6" + struct.pack(">I", messages.MAX_BODY_BYTES - 4)
    assert code_of(header + bytes(messages.MAX_BODY_BYTES - 4)) == Code.PARSE


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (b"", "empty"),
        (b"\xc1", "not msgpack"),
        (b"\x92\x01", "truncated"),
        (b"\x01\x02\x03", "2 trailing bytes"),
        (b"\x82\xa1a\x01\xa1a\x02", "duplicate key 'a'"),
        (b"\x81\x01\x02", "type int"),
        (b"\x81\xc4\x01a\x02", "type bytes"),
        (b"\x81\x91\x01\x02", "type list"),
        (b"\xa1\xff", "UTF-8"),
        (msgpack.packb(msgpack.ExtType(5, b"x")), "extension type 5"),
        (msgpack.packb([msgpack.Timestamp(1, 2)]), "extension type -1"),
        (msgpack.packb({"a": [{"b": msgpack.Timestamp(1, 2)}], "c": "x" * 9000}), "extension type -1"),
    ],
)
def test_errors_say_what_is_wrong(body: bytes, problem: str) -> None:
    with pytest.raises(WireError, match=problem):
        messages.decode(body)


def test_a_map_that_would_hold_everybody_up_is_refused_before_it_is_built() -> None:
    largest_map = {str(i): 0 for i in range(messages.MAX_MAP_MEMBERS)}
    assert messages.decode(msgpack.packb({"params": largest_map})) == {"params": largest_map}
    with pytest.raises(messages.WireError, match="a map has more than 65536 members"):
        messages.decode(msgpack.packb({"params": {**largest_map, "one": 0}}))


def test_a_short_string_is_kept_once_in_a_body_and_not_beyond_it() -> None:
    """Some versions of Python never free interned strings: clients could fill the memory with names."""
    name = "a name that nothing else here has"
    body = codec.encode([{"material": name}, {"material": name}])
    decoded: Any = messages.decode(body)
    first, second = (each["material"] for each in decoded)
    assert first is second and first == name
    assert sys.intern(name) is not first


def test_what_cannot_be_encoded_is_an_error() -> None:
    for value in (object(), {"a": {1, 2}}, 2**64, [print]):
        with pytest.raises(codec.NotEncodableError, match="cannot be encoded"):
            codec.encode(value)


# ---- requests ------------------------------------------------------------------------------------------------


def message(**members: object) -> dict[str, object]:
    return {"jsonrpc": "2.0", "id": 1, "method": "get_status", **members}


@pytest.mark.parametrize("id", [0, -1, 2**64 - 1, 1.5, "", "abc", None])
def test_legal_ids(id: object) -> None:
    request = messages.parse_request(message(id=id))
    assert request.id == id and request.has_id


@pytest.mark.parametrize("id", [True, False, math.nan, math.inf, -math.inf, [], {}, b"x"])
def test_illegal_ids_are_answered_with_nil(id: object) -> None:
    with pytest.raises(WireError) as caught:
        messages.parse_request(message(id=id))
    assert (caught.value.code, caught.value.id, caught.value.silent) == (Code.INVALID_REQUEST, None, False)


@pytest.mark.parametrize(
    "wrong",
    [
        {"jsonrpc": "1.0"},
        {"jsonrpc": 2.0},
        {"jsonrpc": None},
        {"method": 7},
        {"method": None},
        {"method": b"get_status"},
        {"extra": 1},
    ],
)
def test_wrong_requests_carry_their_id(wrong: dict[str, object]) -> None:
    with pytest.raises(WireError) as caught:
        messages.parse_request(message(id="mine") | wrong)
    assert (caught.value.code, caught.value.id, caught.value.silent) == (Code.INVALID_REQUEST, "mine", False)


@pytest.mark.parametrize("missing", ["jsonrpc", "method"])
def test_missing_members(missing: str) -> None:
    incomplete = message()
    del incomplete[missing]
    with pytest.raises(WireError) as caught:
        messages.parse_request(incomplete)
    assert (caught.value.code, caught.value.id) == (Code.INVALID_REQUEST, 1)


@pytest.mark.parametrize("not_a_map", [[], [message()], 1, None, "x", b"x", True])
def test_a_request_is_a_map(not_a_map: object) -> None:
    with pytest.raises(WireError) as caught:
        messages.parse_request(not_a_map)
    assert (caught.value.code, caught.value.id) == (Code.INVALID_REQUEST, None)


def test_params() -> None:
    assert messages.parse_request(message()).params == {}
    assert messages.parse_request(message(params={"a": 1})).params == {"a": 1}
    for params in ([], [1], None, 1, "x"):
        with pytest.raises(WireError) as caught:
            messages.parse_request(message(params=params))
        assert (caught.value.code, caught.value.id, caught.value.silent) == (Code.INVALID_PARAMS, 1, False)


def test_notifications() -> None:
    notification = message()
    del notification["id"]
    assert not messages.parse_request(notification).has_id
    with pytest.raises(WireError) as caught:
        messages.parse_request(notification | {"params": []})
    assert caught.value.silent  # valid but for its params: JSON-RPC 2.0, section 4.1, is silent
    with pytest.raises(WireError) as caught:
        messages.parse_request(notification | {"jsonrpc": "1.0"})
    assert not caught.value.silent  # not a notification, but an invalid request


@pytest.mark.long
@given(TREES)
def test_any_tree_is_a_request_or_an_error(tree: object) -> None:
    try:
        messages.parse_request(tree)
    except WireError as error:
        assert error.code in (Code.INVALID_REQUEST, Code.INVALID_PARAMS)
        messages.error_reply(error.id, error.code, error.message)


def test_bodies_are_json_rpc() -> None:
    def unpacked(body: bytes) -> object:
        return msgpack.unpackb(body)

    assert unpacked(messages.request(3, "play", {"a": 1})) == message(id=3, method="play", params={"a": 1})
    assert unpacked(messages.request(3, "play")) == message(id=3, method="play")
    assert unpacked(messages.result_reply("x", {"tick": 1})) == {"jsonrpc": "2.0", "id": "x", "result": {"tick": 1}}
    assert unpacked(messages.error_reply(None, Code.PARSE, "m")) == {
        "jsonrpc": "2.0",
        "id": None,
        "error": {"code": -32700, "message": "m"},
    }
    assert unpacked(messages.error_reply(1, -32602, "m", [1]))["error"]["data"] == [1]  # type: ignore[index]


# ---- frames --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frames", "opened"),
    [
        ([b"x"], (False, b"x")),
        ([b""], (False, b"")),
        ([b"", b"x"], (True, b"x")),
        ([b"", b""], (True, b"")),
        ([b"x", b"y"], (False, None)),
        ([b"", b"x", b"y"], (True, None)),
        ([b"x", b"", b"y"], (False, None)),
        ([], (False, None)),
    ],
)
def test_envelopes(frames: list[bytes], opened: tuple[bool, bytes | None]) -> None:
    assert messages.open_envelope(frames) == opened
