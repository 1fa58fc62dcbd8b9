"""msgpack of plain data, and values that are encoded once and sent often."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, cast

import msgpack

from hapticd.base.errors import HapticdError

MAX_DEPTH: Final = 32
"""Deepest nesting of a message; a request whose params hold only scalars has depth 2."""

LARGE_PART: Final = 16 * 1024
"""Bytes; a part that is as large, and encoded already, is sent without being copied."""

_PACKED: Final = 4096
"""Bytes that a packer begins with. By default it takes 256 KiB, which the kernel maps and unmaps for each message
(docs/adr/0022)."""


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
    """msgpack of a tree of mappings, lists, tuples, str, bytes, bool, numbers (numpy's and arrays too) and
    None.

    Raises NotEncodableError for anything else.
    """
    try:
        return cast(bytes, msgpack.packb(value, default=_plain, buf_size=_PACKED))
    except (TypeError, ValueError, OverflowError) as error:
        raise NotEncodableError(f"cannot be encoded: {error}") from None


@dataclass(frozen=True, slots=True)
class Encoded:
    """A value that is encoded already, in parts that follow each other. Large parts are shared, never copied."""

    parts: tuple[bytes, ...]

    def __len__(self) -> int:
        return sum(map(len, self.parts))

    def __bytes__(self) -> bytes:
        return b"".join(self.parts)


def encoded(value: object) -> Encoded:
    """Any value. Raises as encode does."""
    return Encoded((encode(value),))


def encoded_map(members: Mapping[str, object]) -> Encoded:
    """A map of these members, of which some may be encoded already. Raises as encode does."""
    found: list[bytes] = []
    small = bytearray(msgpack.Packer(buf_size=_PACKED).pack_map_header(len(members)))
    for key, value in members.items():
        small += encode(key)
        for part in value.parts if isinstance(value, Encoded) else (encode(value),):
            if len(part) < LARGE_PART:
                small += part
            else:
                found += bytes(small), part
                small.clear()
    return Encoded((*found, bytes(small)))


@dataclass(frozen=True, slots=True)
class Members:
    """Members of a map that are encoded already, without the map's header."""

    count: int
    data: bytes

    @classmethod
    def of(cls, members: Mapping[str, object]) -> Members:
        """Raises as encode does."""
        data = encode(members)
        return cls(len(members), data[_header_size(len(members)) :])

    def joined(self, members: Mapping[str, object]) -> bytes:
        """The map of these, and of others that are not encoded yet. Raises as encode does."""
        count = self.count + len(members)
        header = bytes((0x80 | count,)) if count < 16 else b"\xde" + count.to_bytes(2, "big")
        return header + self.data + encode(members)[_header_size(len(members)) :]


def _header_size(count: int) -> int:
    """Bytes of the header of a map of so many members; of at most 65,535."""
    return 1 if count < 16 else 3
