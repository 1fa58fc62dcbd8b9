"""ZMTP 3.0 and 3.1 without I/O: a peer's bytes in, its messages and commands out (RFC 23 and 37, mechanism NULL).

Whatever a peer sends, a `Parser` keeps no more than its bounds say: a frame is kept as it comes and not as it is
announced, and of a message that is too long only the size.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from hapticd.base.errors import HapticdError, quoted

MORE_FLAG: Final = 1
LONG_FLAG: Final = 2
COMMAND_FLAG: Final = 4

MAX_COMMAND_BYTES: Final = 4096
"""Bytes of a command, its name counted."""

_GREETING_SIGNATURE: Final = b"\xff" + bytes(8) + b"\x7f"
_NULL_MECHANISM: Final = b"NULL".ljust(20, b"\0")
_LONG_SIZE_FORMAT: Final = struct.Struct(">Q")
_MAX_KEPT_FRAMES: Final = 2
_NO_FRAME: Final = -1
_NO_GREETING: Final = -2

ZMTP_GREETING: Final = _GREETING_SIGNATURE + b"\x03\x01" + _NULL_MECHANISM + bytes(32)
"""What both sides send first, whole and without waiting for the other's."""


class ZmtpError(HapticdError):
    """A peer says what is no ZMTP 3, or goes beyond a bound."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """How much of one peer is borne with."""

    frames: int
    """Parts of a message."""
    size: int
    """Bytes of a message, all parts together."""
    kept: int
    """Bytes of a message that are kept; of a longer one only the size is reported."""


@dataclass(slots=True)
class Message:
    """A whole message: its first three frames, and how many bytes all its frames had.

    A message that was too long, or has more than two frames, has only a byte left of each that was not empty.
    """

    frames: list[bytes]
    size: int


@dataclass(slots=True)
class Command:
    """A command, for example `READY`, and what follows its name."""

    name: bytes
    data: bytes


@dataclass(slots=True)
class Greeted:
    """The peer's greeting came."""


Event = Message | Command | Greeted


# ---- out ---------------------------------------------------------------------------------------------------


def header(size: int, flags: int = 0) -> bytes:
    """What stands before `size` bytes of a frame."""
    return bytes((flags, size)) if size < 256 else bytes((flags | LONG_FLAG,)) + _LONG_SIZE_FORMAT.pack(size)


def message(frames: list[bytes]) -> bytes:
    """A message as it is sent."""
    last = len(frames) - 1
    return b"".join([header(len(each), MORE_FLAG if n < last else 0) + each for n, each in enumerate(frames)])


def command(name: bytes, data: bytes = b"") -> bytes:
    """A command as it is sent."""
    return header(1 + len(name) + len(data), COMMAND_FLAG) + bytes((len(name),)) + name + data


def ready(socket_type: bytes, **others: bytes) -> bytes:
    """The command that ends the handshake on one side."""
    told = {b"Socket-Type": socket_type, **{name.encode(): value for name, value in others.items()}}
    pairs = [bytes((len(name),)) + name + len(value).to_bytes(4, "big") + value for name, value in told.items()]
    return command(b"READY", b"".join(pairs))


def error(reason: bytes) -> bytes:
    """The command that refuses a handshake."""
    return command(b"ERROR", bytes((len(reason),)) + reason)


# ---- in ----------------------------------------------------------------------------------------------------


def properties(data: bytes) -> dict[bytes, bytes]:
    """What a READY says, by names in lower case. Raises ZmtpError."""
    found = {}
    at = 0
    while at < len(data):
        named = at + 1 + data[at]
        begin = named + 4
        end = begin + int.from_bytes(data[named:begin], "big")
        if end > len(data):
            raise ZmtpError("properties of a READY that are cut off")
        found[data[at + 1 : named].lower()] = data[begin:end]
        at = end
    return found


class Parser:
    """What one peer sent. After an error it is of no use any more."""

    __slots__ = ("_at", "_bounds", "_buffer", "_count", "_cut", "_flags", "_frames", "_left", "_part", "_size")

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._buffer = b""
        self._at = 0
        self._left = _NO_GREETING  # bytes of the open frame that are still to come
        self._flags = 0
        # Of the message that is under way:
        self._frames: list[bytes] = []
        self._part = bytearray()
        self._count = 0
        self._size = 0
        self._cut = False

    def feed(self, data: bytes) -> None:
        """More bytes, as they came. To be called when `next` has nothing more."""
        self._buffer = self._buffer[self._at :] + data if self._at < len(self._buffer) else data
        self._at = 0

    @property
    def pending(self) -> bool:
        """Whether there are bytes that `next` has not read."""
        return self._at < len(self._buffer)

    @property
    def held(self) -> int:
        """Bytes kept of a message that is not whole yet, about."""
        return 0 if self._cut else self._size - max(self._left, 0)

    def next(self) -> Event | None:
        """What came, one after the other; None: nothing more is whole. Raises ZmtpError."""
        if self._left == _NO_GREETING:
            return self._greeting()
        while self._left >= 0 or self._open():
            buffer, at = self._buffer, self._at
            end = at + self._left
            if end > len(buffer):
                self._left = end - len(buffer)
                self._at = len(buffer)
                self._keep(buffer[at:])
                return None
            self._left, self._at = _NO_FRAME, end
            body = buffer[at:end]
            if self._part or self._cut:
                self._keep(body)
                body = bytes(self._part)
                self._part = bytearray()
            if self._flags & COMMAND_FLAG:
                return self._command(body)
            if self._count <= _MAX_KEPT_FRAMES + 1:
                self._frames.append(body)
            if not self._flags & MORE_FLAG:
                found = Message(self._frames, self._size)
                self._frames, self._count, self._size, self._cut = [], 0, 0, False
                return found
        return None

    def _greeting(self) -> Greeted | None:
        came = self._buffer
        if came[:1] not in (b"", b"\xff") or came[9:10] not in (b"", b"\x7f"):
            raise ZmtpError("what it sends is not ZMTP 3")
        if len(came) > 10 and came[10] < 3:
            raise ZmtpError(f"it speaks ZMTP {came[10]}, and only 3 is spoken here")
        if len(came) >= 32 and came[12:32] != _NULL_MECHANISM:
            mechanism = came[12:32].strip(b"\0").decode("ascii", "replace")
            raise ZmtpError(f"its mechanism is {quoted(mechanism)}, not NULL")
        if len(came) < len(ZMTP_GREETING):
            return None
        self._at, self._left = len(ZMTP_GREETING), _NO_FRAME
        return Greeted()

    def _open(self) -> bool:
        """Begins the next frame, if its header is whole."""
        buffer, at = self._buffer, self._at
        if len(buffer) - at < 2:
            return False
        flags = buffer[at]
        if flags & LONG_FLAG:
            if len(buffer) - at < 9:
                return False
            size: int = _LONG_SIZE_FORMAT.unpack_from(buffer, at + 1)[0]
            self._at = at + 9
        else:
            size = buffer[at + 1]
            self._at = at + 2
        if flags & ~(MORE_FLAG | LONG_FLAG | COMMAND_FLAG) or (flags & COMMAND_FLAG and flags & MORE_FLAG):
            raise ZmtpError("what it sends is not ZMTP 3")
        self._flags, self._left = flags, size
        if flags & COMMAND_FLAG:
            if size > MAX_COMMAND_BYTES:
                raise ZmtpError(f"a command of {size:,} bytes: at most {MAX_COMMAND_BYTES:,} are taken")
            return True
        self._count += 1
        self._size += size
        if self._count > self._bounds.frames:
            raise ZmtpError(f"a message of more than {self._bounds.frames:,} parts")
        if self._size > self._bounds.size:
            raise ZmtpError(f"a message of more than {self._bounds.size:,} bytes")
        if not self._cut and (self._size > self._bounds.kept or self._count > _MAX_KEPT_FRAMES):
            self._cut = True
            self._frames = [each[:1] for each in self._frames]
        return True

    def _keep(self, chunk: bytes) -> None:
        """Of a frame that does not come at once."""
        if not self._cut or self._flags & COMMAND_FLAG:
            self._part += chunk
        elif not self._part:
            self._part += chunk[:1]

    def _command(self, body: bytes) -> Command:
        named = 1 + body[0] if body else 0
        if not 1 < named <= len(body):
            raise ZmtpError("a command without a name")
        return Command(body[1:named], body[named:])
