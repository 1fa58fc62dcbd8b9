"""Messages of streams: `read` accepts only valid messages, and reads the same values as the general decoder."""

from __future__ import annotations

import math
import struct
from typing import Any, get_args

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.daemon.params import StreamForceParams, StreamTargetParams
from hapticd.protocol import messages, streams

KINDS = st.sampled_from(sorted(get_args(streams.Kind)))
SEQS = st.one_of(
    st.integers(0, 2**64 - 1), st.sampled_from([0, 127, 128, 255, 256, 65535, 65536, 2**32 - 1, 2**32, 2**63 - 1])
)
FLOATS = st.floats(allow_nan=False)
NUMBERS = st.one_of(st.integers(-100, 100), st.floats())


def message(kind: str, seq: object, vector: object) -> dict[str, Any]:
    params = {"seq": seq, streams.VECTOR_PARAM_BY_KIND[kind]: vector}  # type: ignore[index]
    return {"jsonrpc": "2.0", "method": f"stream_{kind}", "params": params}


@given(KINDS, st.integers(0, streams.MAX_SEQ), FLOATS, FLOATS)
def test_what_is_written_is_a_request_and_is_read(kind: streams.Kind, seq: int, x: float, y: float) -> None:
    body = streams.write(kind, seq, x, y)
    assert streams.read(body) == (kind, seq, x, y)
    request = messages.parse_request(messages.decode(body))
    assert not request.has_id and message(kind, seq, [x, y]) == messages.decode(body)
    assert request.method in streams.STREAM_KIND_BY_METHOD


@given(KINDS, SEQS, NUMBERS, NUMBERS)
def test_what_a_library_packs_is_read_as_it_is_or_left_to_the_decoder(
    kind: streams.Kind, seq: int, x: float, y: float
) -> None:
    found = streams.read(msgpack.packb(message(kind, seq, [x, y])))
    if isinstance(x, float) and isinstance(y, float):
        assert found is not None and found[:2] == (kind, seq)
        assert struct.pack("dd", *found[2:]) == struct.pack("dd", x, y)
    else:
        assert found is None


@given(KINDS, st.integers(0, 2**20), st.binary(max_size=3), st.integers(0, 200), st.integers(0, 255))
def test_a_body_with_another_byte_is_read_as_the_decoder_reads_it_or_not_at_all(
    kind: streams.Kind, seq: int, more: bytes, place: int, byte: int
) -> None:
    body = bytearray(streams.write(kind, seq, 0.5, -0.5) if more else msgpack.packb(message(kind, seq, [0.5, -0.5])))
    if place < len(body):
        body[place] = byte
    found = streams.read(bytes(body) + more[1:])
    if found is not None:
        params = messages.parse_request(messages.decode(bytes(body) + more[1:])).params
        vector = params[streams.VECTOR_PARAM_BY_KIND[found.kind]]
        assert struct.pack("dd", *vector) == struct.pack("dd", found.x, found.y)  # type: ignore[misc]
        assert params == {"seq": found.seq, streams.VECTOR_PARAM_BY_KIND[found.kind]: vector}


@pytest.mark.parametrize(
    "body",
    [
        b"",
        msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": "stream_target", "params": {}}),
        msgpack.packb(message("target", 1.0, [0.0, 0.0])),
        msgpack.packb(message("target", -1, [0.0, 0.0])),
        msgpack.packb(message("target", True, [0.0, 0.0])),
        msgpack.packb(message("target", "1", [0.0, 0.0])),
        msgpack.packb(message("target", 1, [0.0])),
        msgpack.packb(message("target", 1, [0.0, 0.0, 0.0])),
        msgpack.packb(message("target", 1, ["a", 0.0])),
        msgpack.packb({**message("target", 1, [0.0, 0.0]), "more": 1}),
        *(streams.write("force", 1, 0.0, 0.0)[:length] for length in range(1, 80, 3)),
        streams.write("force", 1, 0.0, 0.0) + b"\0",
    ],
)
def test_anything_else_is_left_to_the_decoder(body: bytes) -> None:
    assert streams.read(body) is None


def test_the_largest_values_are_those_that_the_params_allow() -> None:
    for model, kind in ((StreamTargetParams, "target"), (StreamForceParams, "force")):
        limit = streams.MAX_COMPONENT_BY_KIND[kind]  # type: ignore[index]
        for value in (limit, -limit):
            model.parsed({"seq": streams.MAX_SEQ, streams.VECTOR_PARAM_BY_KIND[kind]: [value, 0]})  # type: ignore[index]
        for value in (math.nextafter(limit, math.inf), -math.nextafter(limit, math.inf), math.nan, math.inf, True, "1"):
            with pytest.raises(ValueError, match=streams.VECTOR_PARAM_BY_KIND[kind]):  # type: ignore[index]
                model.parsed({"seq": 0, streams.VECTOR_PARAM_BY_KIND[kind]: [value, 0]})  # type: ignore[index]
