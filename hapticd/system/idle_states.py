"""Keeps the processors out of deep idle states, which take long to leave.

While `/dev/cpu_dma_latency` is held open with a latency of 0, the kernel's idle governor selects only shallow states
(Documentation/power/pm_qos_interface). These cost power, so the file is open only while a real-time servo runs.
"""

from __future__ import annotations

import os
import struct
from typing import Final

LATENCY_DEVICE: Final = "/dev/cpu_dma_latency"
"""The kernel's interface for latency requests; a request lasts while its file is open."""


class IdleStateLock:
    """The request to the kernel for shallow idle states, which a process can hold and release."""

    def __init__(self) -> None:
        self._fd: int | None = None

    @property
    def held(self) -> bool:
        """Whether the request for shallow idle states is active."""
        return self._fd is not None

    def hold(self) -> None:
        """Request shallow idle states, if not yet requested. Raises OSError without the permission."""
        if self._fd is None:
            fd = os.open(LATENCY_DEVICE, os.O_WRONLY | os.O_CLOEXEC)
            try:
                os.write(fd, struct.pack("=i", 0))
            except OSError:
                os.close(fd)
                raise
            self._fd = fd

    def release(self) -> None:
        """Withdraw the request for shallow idle states, if there is one."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None
