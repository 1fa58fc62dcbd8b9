"""Memory allocation of a process that runs for months (docs/adr/0022)."""

from __future__ import annotations

from typing import Final

# Imported directly: hapticd.base.core imports numpy, 11 MB that some processes do not need.
from hapticd._core import ffi, lib
from hapticd.base.errors import HapticdError

MIN_RETURNED_BLOCK_BYTES: Final = 16 * 1024
"""Blocks of at least 16 KiB are returned to the kernel when freed, so that they do not fragment the heap. A telemetry
message at 10 kHz has 22 kB."""


def return_large_blocks(min_bytes: int = MIN_RETURNED_BLOCK_BYTES) -> None:
    """Have the C library take blocks of at least `min_bytes` from the kernel, and return them when they are freed.

    The setting lasts until the process ends. Raises HapticdError if the C library refuses the size.
    """
    if lib.hd_memory_large_from(min_bytes) != lib.HD_OK:
        raise HapticdError(ffi.string(lib.hd_invalid_reason()).decode())
