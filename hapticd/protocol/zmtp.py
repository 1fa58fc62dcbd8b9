"""ZMTP 3.0 and 3.1 without I/O: parser and writer of messages and commands (RFC 23 and 37, mechanism NULL).

`Bounds` limit the memory of a `Parser`, whatever a peer sends. A parser allocates memory for received bytes, not for
the length in a header. Of a message that is too long it keeps only the size.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from hapticd.base.errors import HapticdError, quoted

MORE_FLAG: Final = 1
"""Flag of a frame: another frame of the message follows."""
LONG_FLAG: Final = 2
"""Flag of a frame: its size has eight bytes instead of one."""
COMMAND_FLAG: Final = 4
"""Flag of a frame: the frame is a ZMTP command, not a part of a message."""

MAX_COMMAND_BYTES: Final = 4096
"""Largest size of a ZMTP command with its name."""

_GREETING_SIGNATURE: Final = b"\xff" + bytes(8) + b"\x7f"
_NULL_MECHANISM: Final = b"NULL".ljust(20, b"\0")
_LONG_SIZE_FORMAT: Final = struct.Struct(">Q")
_MAX_KEPT_FRAMES: Final = 2
"""Largest number of frames of a message that is kept in full."""
_NO_FRAME: Final = -1
"""Value of `Parser._left`, the number of missing bytes, between two frames."""
_NO_GREETING: Final = -2
"""Value of `Parser._left` before the greeting."""

ZMTP_GREETING: Final = _GREETING_SIGNATURE + b"\x03\x01" + _NULL_MECHANISM + bytes(32)
"""The greeting, which both sides send first, without waiting for that of the peer."""


class ZmtpError(HapticdError):
    """A peer violates ZMTP 3, or exceeds a bound."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of a message that a parser accepts from a peer."""

    frames: int
    """Largest number of parts (frames) of a message."""
    size: int
    """Largest size of a message, all frames together, in bytes."""
    kept: int
    """Largest size of a message that is kept, in bytes; of a longer message only the size is reported."""


@dataclass(slots=True)
class Message:
    """A complete message: its first three frames, and the size of all frames, in bytes.

    If the message is longer than `Bounds.kept` or has more than two frames, only the first byte of each frame is kept.
    """

    frames: list[bytes]
    size: int


@dataclass(slots=True)
class Command:
    """A command of ZMTP: its name, for example `READY`, and the data after the name."""

    name: bytes
    data: bytes


@dataclass(slots=True)
class Greeted:
    """The greeting of the peer was received."""


Event = Message | Command | Greeted


# ---- Writer ---------------------------------------------------------------------------------------------------


def header(size: int, flags: int = 0) -> bytes:
    """Return the header of a frame of `size` bytes."""
    return bytes((flags, size)) if size < 256 else bytes((flags | LONG_FLAG,)) + _LONG_SIZE_FORMAT.pack(size)


def message(frames: list[bytes]) -> bytes:
    """Return the bytes of a ZMTP message that consists of these frames."""
    last = len(frames) - 1
    return b"".join([header(len(each), MORE_FLAG if n < last else 0) + each for n, each in enumerate(frames)])


def command(name: bytes, data: bytes = b"") -> bytes:
    """Return the bytes of a ZMTP command."""
    return header(1 + len(name) + len(data), COMMAND_FLAG) + bytes((len(name),)) + name + data


def ready(socket_type: bytes, **others: bytes) -> bytes:
    """Return the command READY, which ends one side's handshake, with the socket type and `others` as properties."""
    values = {b"Socket-Type": socket_type, **{name.encode(): value for name, value in others.items()}}
    pairs = [bytes((len(name),)) + name + len(value).to_bytes(4, "big") + value for name, value in values.items()]
    return command(b"READY", b"".join(pairs))


def error(reason: bytes) -> bytes:
    """Return the command ERROR, which refuses a handshake."""
    return command(b"ERROR", bytes((len(reason),)) + reason)


# ---- Parser ----------------------------------------------------------------------------------------------------


def properties(data: bytes) -> dict[bytes, bytes]:
    """Return the properties in a command READY, by names in lower case. Raises ZmtpError."""
    values = {}
    at = 0
    while at < len(data):
        named = at + 1 + data[at]
        begin = named + 4
        end = begin + int.from_bytes(data[named:begin], "big")
        if end > len(data):
            raise ZmtpError("the properties of READY are truncated")
        values[data[at + 1 : named].lower()] = data[begin:end]
        at = end
    return values


class Parser:
    """The parser of the bytes of one peer. It cannot be used after an error."""

    __slots__ = ("_at", "_bounds", "_buffer", "_count", "_flags", "_frames", "_left", "_part", "_size", "_truncated")

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._buffer = b""
        self._at = 0
        self._left = _NO_GREETING  # missing bytes of the current frame
        self._flags = 0
        # State of the current message:
        self._frames: list[bytes] = []
        self._part = bytearray()  # received bytes of the current frame
        self._count = 0
        self._size = 0
        self._truncated = False  # only the first byte of each frame is kept

    def feed(self, data: bytes) -> None:
        """Add received bytes. Call it after `next` has returned None."""
        self._buffer = self._buffer[self._at :] + data if self._at < len(self._buffer) else data
        self._at = 0

    @property
    def pending(self) -> bool:
        """Whether there are bytes that `next` has not read."""
        return self._at < len(self._buffer)

    @property
    def held(self) -> int:
        """Approximate number of bytes that the parser keeps of an incomplete message."""
        return 0 if self._truncated else self._size - max(self._left, 0)

    def next(self) -> Event | None:
        """Return the next message, command or greeting; None if more bytes are needed. Raises ZmtpError."""
        if self._left == _NO_GREETING:
            return self._greeting()
        while self._left >= 0 or self._read_header():
            buffer, at = self._buffer, self._at
            end = at + self._left
            if end > len(buffer):
                self._left = end - len(buffer)
                self._at = len(buffer)
                self._keep(buffer[at:])
                return None
            self._left, self._at = _NO_FRAME, end
            body = buffer[at:end]
            if self._part or self._truncated:
                self._keep(body)
                body = bytes(self._part)
                self._part = bytearray()
            if self._flags & COMMAND_FLAG:
                return self._command(body)
            if self._count <= _MAX_KEPT_FRAMES + 1:
                self._frames.append(body)
            if not self._flags & MORE_FLAG:
                complete = Message(self._frames, self._size)
                self._frames, self._count, self._size, self._truncated = [], 0, 0, False
                return complete
        return None

    def _greeting(self) -> Greeted | None:
        received = self._buffer
        if received[:1] not in (b"", b"\xff") or received[9:10] not in (b"", b"\x7f"):
            raise ZmtpError("the data is not ZMTP 3")
        if len(received) > 10 and received[10] < 3:
            raise ZmtpError(f"the protocol is ZMTP {received[10]}: must be 3")
        if len(received) >= 32 and received[12:32] != _NULL_MECHANISM:
            mechanism = received[12:32].strip(b"\0").decode("ascii", "replace")
            raise ZmtpError(f"the mechanism is {quoted(mechanism)}: must be NULL")
        if len(received) < len(ZMTP_GREETING):
            return None
        self._at, self._left = len(ZMTP_GREETING), _NO_FRAME
        return Greeted()

    def _read_header(self) -> bool:
        """Read the header of the next frame; return false if the header is incomplete."""
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
            raise ZmtpError("the data is not ZMTP 3")
        self._flags, self._left = flags, size
        if flags & COMMAND_FLAG:
            if size > MAX_COMMAND_BYTES:
                raise ZmtpError(f"a command of {size:,} bytes: must be at most {MAX_COMMAND_BYTES:,}")
            return True
        self._count += 1
        self._size += size
        if self._count > self._bounds.frames:
            raise ZmtpError(f"a message of more than {self._bounds.frames:,} parts")
        if self._size > self._bounds.size:
            raise ZmtpError(f"a message of more than {self._bounds.size:,} bytes")
        if not self._truncated and (self._size > self._bounds.kept or self._count > _MAX_KEPT_FRAMES):
            self._truncated = True
            self._frames = [each[:1] for each in self._frames]
        return True

    def _keep(self, chunk: bytes) -> None:
        """Keep a chunk of a frame that arrives in several chunks, or its first byte if the message is truncated."""
        if not self._truncated or self._flags & COMMAND_FLAG:
            self._part += chunk
        elif not self._part:
            self._part += chunk[:1]

    def _command(self, body: bytes) -> Command:
        named = 1 + body[0] if body else 0
        if not 1 < named <= len(body):
            raise ZmtpError("a command without a name")
        return Command(body[1:named], body[named:])
