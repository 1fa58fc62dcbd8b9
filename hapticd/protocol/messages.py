"""Messages between daemon and client: JSON-RPC 2.0 objects in msgpack, and the frames around them, without I/O.

The decoder is safe for untrusted bytes: it uses at most a small multiple of the length of the message as memory, and
does not recurse.
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
"""Version of the protocol, which is independent of the version of the package."""

MAX_GESTURE_ENDS: Final = 16
"""Largest number of ends of gestures (motions of the simulated hand) that a status lists: the latest."""

MAX_BODY_BYTES: Final = 2 * 1024 * 1024
"""Largest size of the body of a request."""

MAX_MAP_MEMBERS: Final = 65_536
"""Largest number of members of a map in a body. A map is built in one call, in which no other thread runs."""

_MAX_SHARED_STRING_CHARACTERS: Final = 64
"""Equal strings up to this length, in characters, share memory in a decoded body; most are names of materials."""

_MAX_FLAT_BODY_BYTES: Final = 4096
"""Largest body decoded without a scan of its structure, in bytes. A length in it may claim at most as many elements."""
# The tags of maps and arrays, and of extensions. They also occur inside strings and numbers, so their count is an upper
# bound of the number of containers or extensions.
_CONTAINER_TAGS: Final = bytes([*range(0x80, 0xA0), 0xDC, 0xDD, 0xDE, 0xDF])
_EXTENSION_TAGS: Final = bytes([0xC7, 0xC8, 0xC9, *range(0xD4, 0xD9)])
# The tag of up to 255 bytes, which may be a key, and the type of a timestamp, which is also the tag of the number -1.
_BIN8_TAG: Final = b"\xc4"
_TIMESTAMP_TYPE: Final = b"\xff"

_REQUEST_MEMBERS: Final = frozenset(("jsonrpc", "id", "method", "params"))

Id: TypeAlias = int | float | str | None

_REPLY_UP_TO_ID: Final = b"\x83" + encode("jsonrpc") + encode("2.0") + encode("id")
"""First bytes of a reply, up to its id."""
_RESULT_KEY: Final = encode("result")
"""Bytes of a reply between its id and its result."""


class Code(enum.IntEnum):
    """Error codes of the protocol: those of JSON-RPC 2.0 (-32700 to -32600) and of the daemon (-32011 to -32001)."""

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
    HANDLE_INSIDE = -32011


class WireError(HapticdError):
    """A message violates the protocol.

    `id` is the id for the reply and `method` the requested method, each None if it could not be read. `silent` is true
    for a notification, which gets no reply.
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


# ---- Bodies ------------------------------------------------------------------------------------------------


def _parse_error(message: str) -> WireError:
    return WireError(Code.PARSE, message)


def _too_long(size: int, limit: int) -> str:
    return f"the body has {size} bytes: must be at most {limit}"


def _map(strings: dict[str, str], pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return `pairs` as a dict whose equal strings share memory: each is taken from `strings`, or added to it.

    Strings are not interned: some versions of Python never free interned strings, and clients can send any number.
    """
    result = {}
    for key, value in pairs:
        if key.__class__ is not str:
            raise _parse_error(f"a key is of type {type(key).__name__}: must be a string")
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
    raise _parse_error(f"extension type {code}: must be nil, a boolean, number, string, bytes, array or map")


def _check_tree(root: object) -> None:
    """Raise WireError if a decoded body is nested too deeply or has timestamps, without recursion."""
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
    """Return whether a body is short and has at most MAX_DEPTH bytes that could be the tag of a container."""
    return len(body) <= _MAX_FLAT_BODY_BYTES and len(body) - len(body.translate(None, _CONTAINER_TAGS)) <= MAX_DEPTH


def check_encoded(body: bytes) -> None:
    """Raise WireError if `decode` refuses a body that this process encoded; twice as fast for a short body."""
    # msgpack accepts keys of bytes and timestamps, `decode` does not; so bodies that may have them go to `decode`.
    if _is_flat(body) and _BIN8_TAG not in body and _TIMESTAMP_TYPE not in body:
        try:
            msgpack.unpackb(body, max_bin_len=0, ext_hook=_extension)
        except ValueError:
            pass  # `decode` raises an error with the reason
        else:
            return
    decode(body)


def decode(body: bytes, limit: int = MAX_BODY_BYTES) -> object:
    """Return the object in `body`: maps become dicts, arrays lists, binary data bytes.

    Raises WireError(-32700) for a body that has more than `limit` bytes, is truncated, is followed by other bytes, or
    has more than 32 levels, a map of more than 65,536 members, duplicate keys, keys that are not strings, extension
    types such as timestamps, or invalid UTF-8.
    """
    size = len(body)
    if size > limit:
        raise _parse_error(_too_long(size, limit))
    # Most bodies are short, with few bytes that could be tags of containers and none that could be a tag of an
    # extension; these need no check of the decoded object.
    flat = _is_flat(body)
    plain = flat and len(body.translate(None, _EXTENSION_TAGS)) == size
    try:
        if not flat:
            # Skip through the structure first, which builds no objects: a header with a wrong length allocates
            # nothing, and unlimited nesting ends at the stack of the unpacker.
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
    """Return the object in a body that the daemon wrote, without the checks of `decode`.

    Raises WireError(-32700) for a body that is not msgpack.
    """
    try:
        return cast(object, msgpack.unpackb(body, raw=False))
    except (ValueError, msgpack.UnpackException, RecursionError) as error:
        raise _parse_error(f"the body is not msgpack: {error}") from None


# ---- Requests and replies ----------------------------------------------------------------------------------


@dataclass(slots=True)
class Request:
    """A call; if `has_id` is false a notification, which gets no reply."""

    id: Id
    has_id: bool
    method: str
    params: dict[str, object]


def _is_id(value: object) -> TypeGuard[Id]:
    kind = value.__class__
    return kind is str or kind is int or value is None or (isinstance(value, float) and math.isfinite(value))


def parse_request(message: object) -> Request:
    """Return the request in a decoded body. Raises WireError with the code and the id for the reply."""
    if type(message) is not dict:
        what = "an array (batches are not supported)" if type(message) is list else type(message).__name__
        raise WireError(Code.INVALID_REQUEST, f"a request must be a map, is {what}")
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
    """Return method and id of a large request without its params, or None for a body that is not a request.

    This takes a tenth of the time of `decode`.
    """
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
    """Return the body of a request that calls a method."""
    message: dict[str, object] = {"jsonrpc": "2.0", "id": id, "method": method}
    if params:
        message["params"] = params
    return encode(message)


def result_reply(id: Id, result: object) -> bytes | Encoded:
    """Return the body of the reply to call `id` with a result. The result or its members may be `Encoded`."""
    if isinstance(result, Encoded) and len(result.parts) == 1:
        return _REPLY_UP_TO_ID + encode(id) + _RESULT_KEY + result.parts[0]
    if isinstance(result, dict) and any(isinstance(value, Encoded) for value in result.values()):
        reply = encoded_map({"jsonrpc": "2.0", "id": id, "result": encoded_map(result)})
        return reply if len(reply.parts) > 1 else reply.parts[0]
    return encode({"jsonrpc": "2.0", "id": id, "result": result})


def error_reply(id: Id, code: int, message: str, data: object = None) -> bytes:
    """Return the body of the reply to call `id` with an error; `data` is optional."""
    error: dict[str, object] = {"code": int(code), "message": message}
    if data is not None:
        error["data"] = data
    return encode({"jsonrpc": "2.0", "id": id, "error": error})


# ---- Frames ------------------------------------------------------------------------------------------------


def open_envelope(frames: Sequence[bytes]) -> tuple[bool, bytes | None]:
    """Return whether the reply to a request needs an empty delimiter frame, and the body of the request.

    The body is None if the frames are invalid. `frames` are those after the identity of the client.
    """
    count = len(frames)
    if count == 1:
        return False, frames[0]
    delimited = count > 0 and not frames[0]
    if count == 2 and delimited:
        return True, frames[1]
    return delimited, None


def too_long_reply(size: int) -> bytes:
    """Return the error reply to a request of `size` bytes, more than MAX_BODY_BYTES; its id is unknown."""
    return error_reply(None, Code.PARSE, _too_long(size, MAX_BODY_BYTES))
