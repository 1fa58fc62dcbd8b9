"""Notifications of streamed targets and forces, written and read without a general decoder.

A stream sends up to a thousand messages a second. `read` accepts only the bytes to which msgpack libraries encode
jsonrpc, method, params (seq, vector), in this order. Other encodings of a message are decoded like any request.
"""

from __future__ import annotations

import struct
from typing import Final, Literal, NamedTuple, TypeAlias

from hapticd.base.codec import encode

Kind: TypeAlias = Literal["target", "force"]

STREAM_KIND_BY_METHOD: Final[dict[str, Kind]] = {"stream_target": "target", "stream_force": "force"}
VECTOR_PARAM_BY_KIND: Final[dict[Kind, str]] = {"target": "position_m", "force": "force_n"}
"""The parameter of each kind that holds the vector; the other parameter is `seq`."""
MAX_COMPONENT_BY_KIND: Final[dict[Kind, float]] = {"target": 10.0, "force": 100.0}
"""Largest coordinate of a target, in m, and largest component of a force, in N."""
MAX_SEQ: Final = 2**63 - 1


class Streamed(NamedTuple):
    """One message of a stream: a target position of the simulated hand or a force, with its sequence number."""

    kind: Kind
    seq: int
    x: float
    y: float


_FLOAT64_TAG: Final = 0xCB
_UINT64_TAG: Final = 0xCF
_NUMBER_FORMAT_BY_TAG: Final = {0xCC: "xB", 0xCD: "xH", 0xCE: "xI", _UINT64_TAG: "xQ"}
"""Formats (module struct) of unsigned integers above 127, by their first byte in msgpack."""


class _Form:
    """Fixed bytes and struct formats of the messages of one streaming method."""

    def __init__(self, method: str) -> None:
        self.kind = kind = STREAM_KIND_BY_METHOD[method]
        self.head = (
            b"\x83" + encode("jsonrpc") + encode("2.0") + encode("method") + encode(method) + encode("params") + b"\x82"
        ) + encode("seq")
        # The key of the vector, the header of an array of two, and the tag of the first number.
        self.middle = encode(VECTOR_PARAM_BY_KIND[kind]) + bytes((0x92, _FLOAT64_TAG))
        rest = f"{len(self.middle)}sdBd"
        self.small = struct.Struct(f">B{rest}")
        self.large = {tag: struct.Struct(f">{number}{rest}") for tag, number in _NUMBER_FORMAT_BY_TAG.items()}
        self.written = struct.Struct(f">{len(self.head)}sBQ{rest}")


_FORM_BY_KIND: Final = {STREAM_KIND_BY_METHOD[method]: _Form(method) for method in STREAM_KIND_BY_METHOD}
_TARGET, _FORCE = _FORM_BY_KIND["target"], _FORM_BY_KIND["force"]


def write(kind: Kind, seq: int, x: float, y: float) -> bytes:
    """Return the body of a message with a streamed target or force. Raises struct.error if it is not a number."""
    form = _FORM_BY_KIND[kind]
    return form.written.pack(form.head, _UINT64_TAG, seq, form.middle, x, _FLOAT64_TAG, y)


def read(body: bytes) -> Streamed | None:
    """Return the message in a body, or None if the body is not encoded as by `write`; integers may be shorter."""
    if body.startswith(_TARGET.head):
        form = _TARGET
    elif body.startswith(_FORCE.head):
        form = _FORCE
    else:
        return None
    begin = len(form.head)
    if len(body) == begin:
        return None
    tag = body[begin]
    rest = form.small if tag < 0x80 else form.large.get(tag)
    if rest is None or begin + rest.size != len(body):
        return None
    seq, middle, x, second, y = rest.unpack_from(body, begin)
    return Streamed(form.kind, seq, x, y) if middle == form.middle and second == _FLOAT64_TAG else None
