"""Columns of a .wav: its channels, named 1, 2 and so on; full scale is 1."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np

from hapticd.analysis.recordings.table import MAX_CHANNELS, Table
from hapticd.analysis.statistics import Floats

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_KINDS: Final = {
    (_PCM, 8): "u1", (_PCM, 16): "<i2", (_PCM, 24): "u1", (_PCM, 32): "<i4", (_FLOAT, 32): "<f4", (_FLOAT, 64): "<f8",
}  # fmt: skip


def wav_table(content: bytes) -> Table:
    """Channels, in parts of full scale: RIFF, WAVE of whole numbers or floats (Microsoft and IBM, 1991, and its
    WAVE_FORMAT_EXTENSIBLE)."""
    if content[:4] != b"RIFF" or content[8:12] != b"WAVE":
        raise ValueError("is no .wav: it has no RIFF and WAVE at its beginning")
    at, form, data = 12, b"", b""
    while at + 8 <= len(content):
        name, size = content[at : at + 4], int.from_bytes(content[at + 4 : at + 8], "little")
        begin, end = at + 8, at + 8 + size
        if name == b"data":
            if end > len(content):
                raise ValueError(f"is cut off: {len(content) - begin} of {size} bytes of its samples are there")
            data = content[begin:end]
            break
        if name == b"fmt ":
            form = content[begin:end]
        at = end + size % 2
    if len(form) < 16:
        raise ValueError("is no .wav that can be read: nothing says how its samples are stored")
    code, channels, rate_hz, _, frame, bits = struct.unpack("<HHIIHH", form[:16])
    if code == _EXTENSIBLE and len(form) >= 26:
        code = int.from_bytes(form[24:26], "little")
    kind = _KINDS.get((code, bits))
    if kind is None:
        raise ValueError(f"holds samples of kind {code} with {bits} bits: it needs 8, 16, 24 or 32 bits, or floats")
    if not 1 <= channels <= MAX_CHANNELS or frame != channels * bits // 8:
        raise ValueError(f"says {channels} channels in {frame} bytes, which cannot be with {bits} bits")
    if len(data) % frame:
        raise ValueError(f"is cut off in the middle of a sample: {len(data)} bytes of samples, {frame} each")

    def read(places: Sequence[int]) -> list[Floats]:
        return [_channel(data, kind, bits, channels, place) for place in places]

    return Table([str(index + 1) for index in range(channels)], read, {}, float(rate_hz))


def _channel(data: bytes, kind: str, bits: int, channels: int, place: int) -> Floats:
    if bits == 24:
        parts = np.frombuffer(data, dtype=np.uint8).reshape(-1, channels, 3)[:, place].astype(np.int32)
        # The sign is in the upper one of three bytes.
        signed = ((parts[:, 2] ^ 128) - 128) * 65536 + parts[:, 1] * 256 + parts[:, 0]
        return np.asarray(signed / 2.0**23, dtype=np.float64)
    numbers: Floats = np.frombuffer(data, dtype=kind).reshape(-1, channels)[:, place].astype(np.float64)
    if kind == "u1":
        numbers -= 128.0
    if "f" not in kind:
        numbers /= 2.0 ** (bits - 1)
    return numbers
