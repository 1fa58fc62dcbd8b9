"""What daemon and client say to each other: JSON-RPC 2.0 objects in msgpack, and the frames around them.

Nothing here does I/O. The decoder takes bytes from anybody: it allocates no more than the message is long
(times a small constant), never recurses, and accepts exactly what `docs/protocol.md` says.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias, TypeGuard, cast

import msgpack

from hapticd.base.codec import MAX_DEPTH, Encoded, encode, encoded_map
from hapticd.base.errors import HapticdError

PROTOCOL_VERSION: Final = 1
"""Version of what is said over the sockets, apart from the version of the package."""

MAX_GESTURE_ENDS: Final = 16
"""So many ends of gestures stand in a status."""

MAX_BODY_BYTES: Final = 2 * 1024 * 1024
"""Largest body of a request, bytes."""

MAX_MAP_MEMBERS: Final = 65_536
"""Largest map of a body: building one is a single call, in which no other thread runs."""

_MAX_SHARED_STRING_CHARACTERS: Final = 64
"""Strings of so many characters at most, names of materials above all, are kept once in a body."""

# Up to this size a header can claim at most this many elements, which is cheap enough to try.
_MAX_FLAT_BODY_BYTES: Final = 4096
# The bytes that can open a map or an array, and an extension. They also occur inside strings and numbers, so that
# counting them bounds the structure from above.
_CONTAINER_TAGS: Final = bytes([*range(0x80, 0xA0), 0xDC, 0xDD, 0xDE, 0xDF])
_EXTENSION_TAGS: Final = bytes([0xC7, 0xC8, 0xC9, *range(0xD4, 0xD9)])
# What opens bytes of up to 255, which may be a key, and the type of a time (and the number -1).
_BIN8_TAG: Final = b"\xc4"
_TIMESTAMP_TYPE: Final = b"\xff"

_REQUEST_MEMBERS: Final = frozenset(("jsonrpc", "id", "method", "params"))

Id: TypeAlias = int | float | str | None

_REPLY_UP_TO_ID: Final = b"\x83" + encode("jsonrpc") + encode("2.0") + encode("id")
"""How an answer begins, up to its id, and what follows that."""
_RESULT_KEY: Final = encode("result")


class Code(enum.IntEnum):
    """The error codes of the protocol: those of JSON-RPC 2.0, and from -32000 down the daemon's own."""

    PARSE = -32700
    INVALID_REQUEST = -32600
    NO_SUCH_METHOD = -32601
    INVALID_PARAMS = -32602
    INTERNAL = -32603
    STALE_REVISION = -32001
    FORCES_OFF = -32003
    LEASE_HELD = -32004
    RING_FULL = -32005
    WAIT_TIMED_OUT = -32006
    LEASE_LAPSED = -32007
    NO_OPERATOR = -32008
    DAEMON_AWAY = -32009
    STREAM_HELD = -32010


class WireError(HapticdError):
    """A message that is not what the protocol says.

    `id` is the id that the answer carries (None where none could be read), `silent` is true where the
    message was a notification, which is never answered. `method` is what it asked for, where that could be read.
    """

    def __init__(
        self, code: int, message: str, *, id: Id = None, silent: bool = False, method: str | None = None
    ) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.id = id
        self.silent = silent
        self.method = method


# ---- bodies ------------------------------------------------------------------------------------------------


def _parse_error(message: str) -> WireError:
    return WireError(Code.PARSE, message)


def _too_long(size: int, limit: int) -> str:
    return f"the body has {size} bytes: at most {limit} are taken"


def _map(strings: dict[str, str], pairs: list[tuple[str, object]]) -> dict[str, object]:
    """`strings` are those of the body that were met so far. (They are not interned: some versions of Python keep what
    is interned for ever, and clients can think of any number.)"""
    result = {}
    for key, value in pairs:
        if key.__class__ is not str:
            raise _parse_error(f"a key is of type {type(key).__name__}: keys are strings")
        result[key] = (
            strings.setdefault(value, value)
            if type(value) is str and len(value) <= _MAX_SHARED_STRING_CHARACTERS
            else value
        )
    if len(result) != len(pairs):
        seen = set[str]()
        for key, _ in pairs:
            if key in seen:
                raise _parse_error(f"duplicate key {key!r:.40}")
            seen.add(key)
    return result


def _extension(code: int, data: bytes) -> object:
    raise _parse_error(f"extension type {code}: only nil, booleans, numbers, strings, bytes, arrays and maps")


def _check_tree(root: object) -> None:
    """Depth and extension types, level by level: no recursion."""
    timestamp = msgpack.Timestamp
    level: list[object] = [[root]]
    depth = -1
    while level:
        depth += 1
        if depth > MAX_DEPTH:
            raise _parse_error(f"nested deeper than {MAX_DEPTH}")
        below: list[object] = []
        for container in level:
            for value in container.values() if type(container) is dict else container:  # type: ignore[attr-defined]
                kind = value.__class__
                if kind is dict or kind is list:
                    below.append(value)
                elif kind is timestamp:
                    _extension(-1, b"")
        level = below


def _is_flat(body: bytes) -> bool:
    """Whether a body is so short, with so few bytes that could open a container, that it cannot be nested too deep."""
    return len(body) <= _MAX_FLAT_BODY_BYTES and len(body) - len(body.translate(None, _CONTAINER_TAGS)) <= MAX_DEPTH


def check_encoded(body: bytes) -> None:
    """Raises as `decode` does, for a body that was packed here: a short one costs half as much."""
    # Keys of bytes and times, which msgpack itself unpacks, are refused by `decode` alone.
    if _is_flat(body) and _BIN8_TAG not in body and _TIMESTAMP_TYPE not in body:
        try:
            msgpack.unpackb(body, max_bin_len=0, ext_hook=_extension)
        except ValueError:
            pass  # `decode` says what is wrong
        else:
            return
    decode(body)


def decode(body: bytes, limit: int = MAX_BODY_BYTES) -> object:
    """The object that `body` encodes; maps become dicts, arrays lists, bin bytes.

    Raises WireError(-32700) for a body over `limit` bytes, truncated, with trailing bytes, nested deeper
    than 32, with a map of more than 65,536 members, with duplicate or non-string keys, extension types (timestamps too)
    or invalid UTF-8.
    """
    size = len(body)
    if size > limit:
        raise _parse_error(_too_long(size, limit))
    # A short body with few bytes that could open a container, and none that could open an extension, needs
    # no second look; most are so.
    flat = _is_flat(body)
    plain = flat and len(body.translate(None, _EXTENSION_TAGS)) == size
    try:
        if not flat:
            # Structure first, without building anything: a header that claims more than the body holds
            # allocates nothing, and nesting without end stops at the unpacker's own stack.
            scanner = msgpack.Unpacker(max_buffer_size=max(size, 1))
            scanner.feed(body)
            scanner.skip()
            if scanner.tell() != size:
                raise _parse_error(f"{size - scanner.tell()} trailing bytes")
        result = msgpack.unpackb(
            body,
            raw=False,
            strict_map_key=False,
            max_map_len=MAX_MAP_MEMBERS if size > MAX_MAP_MEMBERS else size,
            object_pairs_hook=partial(_map, {}),
            ext_hook=_extension,
        )
    except WireError:
        raise
    except (msgpack.StackError, RecursionError):
        raise _parse_error(f"nested deeper than {MAX_DEPTH}") from None
    except msgpack.ExtraData as error:
        raise _parse_error(f"{len(error.extra)} trailing bytes") from None
    except msgpack.FormatError:
        raise _parse_error("the body is not msgpack") from None
    except UnicodeDecodeError:
        raise _parse_error("a string is not UTF-8") from None
    except (ValueError, msgpack.UnpackException, OverflowError) as error:
        if size > MAX_MAP_MEMBERS and "max_map_len" in str(error):
            raise _parse_error(f"a map has more than {MAX_MAP_MEMBERS} members") from None
        raise _parse_error("the body is empty" if size == 0 else "the body is truncated") from None
    if not plain:
        _check_tree(result)
    return cast(object, result)


def decode_trusted(body: bytes) -> object:
    """As `decode`, of a body that our own daemon wrote: only well-formed msgpack is asked for, not the
    protocol's form.

    Raises WireError(-32700).
    """
    try:
        return cast(object, msgpack.unpackb(body, raw=False))
    except (ValueError, msgpack.UnpackException, RecursionError) as error:
        raise _parse_error(f"the body is not msgpack: {error}") from None


# ---- requests and replies ----------------------------------------------------------------------------------


@dataclass(slots=True)
class Request:
    """One call; without an id (`has_id` false) a notification, which is never answered."""

    id: Id
    has_id: bool
    method: str
    params: dict[str, object]


def _is_id(value: object) -> TypeGuard[Id]:
    kind = value.__class__
    return kind is str or kind is int or value is None or (isinstance(value, float) and math.isfinite(value))


def parse_request(message: object) -> Request:
    """The request in a decoded body; raises WireError with the code and the id of the answer."""
    if type(message) is not dict:
        what = "an array (there are no batches)" if type(message) is list else type(message).__name__
        raise WireError(Code.INVALID_REQUEST, f"a request is a map, not {what}")
    has_id = "id" in message
    id = message.get("id")
    if has_id and not _is_id(id):
        raise WireError(Code.INVALID_REQUEST, "id: must be an integer, a finite number, a string or nil")
    if message.get("jsonrpc") != "2.0":
        raise WireError(Code.INVALID_REQUEST, 'jsonrpc: must be "2.0"', id=id)
    method = message.get("method")
    if type(method) is not str:
        raise WireError(Code.INVALID_REQUEST, "method: must be a string", id=id)
    if not message.keys() <= _REQUEST_MEMBERS:
        unknown = ", ".join(sorted(repr(key) for key in message.keys() - _REQUEST_MEMBERS))
        raise WireError(Code.INVALID_REQUEST, f"unknown member {unknown:.80}", id=id)
    params = message.get("params", {})
    if type(params) is not dict:
        raise WireError(Code.INVALID_PARAMS, "params: must be a map", id=id, silent=not has_id, method=method)
    return Request(id, has_id, method, params)


def peek(body: bytes) -> Request | None:
    """Method and id of a large request, without its params; None for what is not one at a first look. It costs a
    tenth of decoding it."""
    found: dict[str, object] = {}
    try:
        scanner = msgpack.Unpacker(max_buffer_size=max(len(body), 1), raw=False, strict_map_key=False)
        scanner.feed(body)
        members = scanner.read_map_header()
        if members > len(_REQUEST_MEMBERS):
            return None
        for _ in range(members):
            key = scanner.unpack()
            if key in ("id", "method"):
                found[key] = scanner.unpack()
            else:
                scanner.skip()
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError):
        return None
    id, method = found.get("id"), found.get("method")
    return Request(id, "id" in found, method, {}) if _is_id(id) and isinstance(method, str) else None


def request(id: Id, method: str, params: Mapping[str, object] | None = None) -> bytes:
    """The body of a call."""
    message: dict[str, object] = {"jsonrpc": "2.0", "id": id, "method": method}
    if params:
        message["params"] = params
    return encode(message)


def result_reply(id: Id, result: object) -> bytes | Encoded:
    """The body that answers call `id` with its result; it may be encoded already, and so may a map's members."""
    if isinstance(result, Encoded) and len(result.parts) == 1:
        return _REPLY_UP_TO_ID + encode(id) + _RESULT_KEY + result.parts[0]
    if isinstance(result, dict) and any(isinstance(value, Encoded) for value in result.values()):
        reply = encoded_map({"jsonrpc": "2.0", "id": id, "result": encoded_map(result)})
        return reply if len(reply.parts) > 1 else reply.parts[0]
    return encode({"jsonrpc": "2.0", "id": id, "result": result})


def error_reply(id: Id, code: int, message: str, data: object = None) -> bytes:
    """The body that answers call `id` with an error; `data` is left out where there is none."""
    error: dict[str, object] = {"code": int(code), "message": message}
    if data is not None:
        error["data"] = data
    return encode({"jsonrpc": "2.0", "id": id, "error": error})


# ---- frames ------------------------------------------------------------------------------------------------


def open_envelope(frames: Sequence[bytes]) -> tuple[bool, bytes | None]:
    """Of the frames after the identity: is the reply delimited, and the body (None: wrong form)."""
    count = len(frames)
    if count == 1:
        return False, frames[0]
    delimited = count > 0 and not frames[0]
    if count == 2 and delimited:
        return True, frames[1]
    return delimited, None


def too_long_reply(size: int) -> bytes:
    """The answer to a body of more than MAX_BODY_BYTES bytes that nobody kept."""
    return error_reply(None, Code.PARSE, _too_long(size, MAX_BODY_BYTES))
