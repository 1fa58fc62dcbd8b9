"""How a process that runs for months takes its memory (docs/adr/0022)."""

from __future__ import annotations

from typing import Final

# Not by way of hapticd.base.core, which needs numpy: 11 MB that others do without.
from hapticd._core import ffi, lib
from hapticd.base.errors import HapticdError

LARGE_BLOCK: Final = 16 * 1024
"""Bytes; a message of telemetry at 10 kHz has 22 kB. Such buffers come and go whole, and smaller blocks cannot settle
between them."""


def settle(large_block: int = LARGE_BLOCK) -> None:
    """For the whole process, from now on: blocks of `large_block` bytes or more are the kernel's, and go back to it at
    once. Raises HapticdError where the C library does not take the size."""
    if lib.hd_memory_large_from(large_block) != lib.HD_OK:
        raise HapticdError(ffi.string(lib.hd_invalid_reason()).decode())
