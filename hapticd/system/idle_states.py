"""Keeping the processors out of deep idle states, from which they wake up late.

While `/dev/cpu_dma_latency` is held open with a latency of 0, the kernel's idle governor stays shallow
(Documentation/power/pm_qos_interface). It costs power, so it is held only while a servo with real-time rights runs.
"""

from __future__ import annotations

import os
import struct
from typing import Final

DEVICE: Final = "/dev/cpu_dma_latency"


class IdleStateLock:
    """Holds the request, or not."""

    def __init__(self) -> None:
        self._fd: int | None = None

    @property
    def held(self) -> bool:
        return self._fd is not None

    def hold(self) -> None:
        """Raises OSError where the system does not let us."""
        if self._fd is None:
            fd = os.open(DEVICE, os.O_WRONLY | os.O_CLOEXEC)
            try:
                os.write(fd, struct.pack("=i", 0))
            except OSError:
                os.close(fd)
                raise
            self._fd = fd

    def release(self) -> None:
        """The kernel forgets the request when the file is closed; it may be released twice."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None
