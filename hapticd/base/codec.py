"""msgpack of plain data, and values that are encoded once and sent often."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, cast

import msgpack

from hapticd.base.errors import HapticdError

MAX_DEPTH: Final = 32
"""Maximum nesting of a message. A request whose params hold only scalars has depth 2."""

MIN_SHARED_PART_BYTES: Final = 16 * 1024
"""An encoded part of at least 16 KiB is sent without a copy."""

_PACKER_BUFFER_BYTES: Final = 4096
"""Initial buffer of a msgpack packer. Its default, 256 KiB, is mapped and unmapped for each message (docs/adr/0022)."""


class NotEncodableError(HapticdError):
    """A value that is not plain data."""


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return dict(value)
    tolist = getattr(value, "tolist", None)  # numpy's scalars and arrays
    if tolist is None:
        raise TypeError(f"a {type(value).__name__} is not plain data")
    return tolist()


def encode(value: object) -> bytes:
    """Encode plain data as msgpack: mappings, lists, tuples, str, bytes, bool, numbers, None and numpy's arrays.

    Raises NotEncodableError for anything else.
    """
    try:
        return cast(bytes, msgpack.packb(value, default=_plain, buf_size=_PACKER_BUFFER_BYTES))
    except (TypeError, ValueError, OverflowError) as error:
        raise NotEncodableError(f"cannot be encoded: {error}") from None


@dataclass(frozen=True, slots=True)
class Encoded:
    """An encoded value as consecutive byte strings, of which large ones are shared between messages, not copied."""

    parts: tuple[bytes, ...]

    def __len__(self) -> int:
        return sum(map(len, self.parts))

    def __bytes__(self) -> bytes:
        return b"".join(self.parts)


def encoded(value: object) -> Encoded:
    """Encode a value as msgpack, once for many messages. Raises NotEncodableError."""
    return Encoded((encode(value),))


def encoded_map(members: Mapping[str, object]) -> Encoded:
    """Encode a map as msgpack. The values of the map may be `Encoded`. Raises NotEncodableError."""
    found: list[bytes] = []
    small = bytearray(msgpack.Packer(buf_size=_PACKER_BUFFER_BYTES).pack_map_header(len(members)))
    for key, value in members.items():
        small += encode(key)
        for part in value.parts if isinstance(value, Encoded) else (encode(value),):
            if len(part) < MIN_SHARED_PART_BYTES:
                small += part
            else:
                found += bytes(small), part
                small.clear()
    return Encoded((*found, bytes(small)))


@dataclass(frozen=True, slots=True)
class Members:
    """Encoded members of a map, without the map's header."""

    count: int
    data: bytes

    @classmethod
    def of(cls, members: Mapping[str, object]) -> Members:
        """Encode the members of a map as msgpack. Raises NotEncodableError."""
        data = encode(members)
        return cls(len(members), data[_header_size(len(members)) :])

    def joined(self, members: Mapping[str, object]) -> bytes:
        """Return one encoded map that has both the encoded members and `members`. Raises NotEncodableError."""
        count = self.count + len(members)
        header = bytes((0x80 | count,)) if count < 16 else b"\xde" + count.to_bytes(2, "big")
        return header + self.data + encode(members)[_header_size(len(members)) :]


def _header_size(count: int) -> int:
    """Return the size in bytes of the header of a map with `count` members, at most 65,535."""
    return 1 if count < 16 else 3
