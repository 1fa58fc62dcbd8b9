"""One end of a SOCK_SEQPACKET pair stands for the hidraw node of a device that a test plays: the base of such devices.

What is written to the node arrives in `take`, and what the device sends can be read from it; feature reports, which a
socket has no way for, are calls of `NodeDevice`.
"""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable

from hapticd.hid.plan import DeviceError  # what a Device raises: the interface, no part of the encoding


class Node(ABC):
    """A device. `device` is what the code under test opens."""

    def _open(self, path: str) -> None:
        """From now on it is there, and serves its node."""
        self.gone = False
        self.changed = threading.Condition()
        """Notified after each report."""
        self.heard: queue.Queue[bytes] = queue.Queue()
        """What the device sent."""
        self.ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.device = NodeDevice(self, path)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @abstractmethod
    def take(self, report: bytes) -> None:
        """An output report."""

    @abstractmethod
    def set_feature(self, report: bytes) -> None:
        """A feature report that is written."""

    @abstractmethod
    def get_feature(self, report_id: int, length: int) -> bytes:
        """The answer to a feature report that is asked for."""

    @abstractmethod
    def _words(self) -> list[str]:
        """What happened, for a test that waits in vain."""

    def _serve(self) -> None:
        while True:
            try:
                report = self.theirs.recv(4096)
            except ConnectionResetError:
                continue  # it was closed with positions unread; what was written before is still to be read
            except OSError:
                return
            if not report:
                return
            self.take(report)

    def _send(self, report: bytes) -> None:
        """An input report, its id first; 0, which is not sent, where reports are not numbered."""
        report = report if report[0] else report[1:]
        self.heard.put(report)
        with contextlib.suppress(OSError):  # nobody may be there, or nobody may read
            self.theirs.send(report, socket.MSG_DONTWAIT)

    def wait(self, until: Callable[[], bool], timeout_s: float = 60.0) -> None:
        """Waits until something holds after a report; the bound only keeps a broken test from hanging."""
        with self.changed:
            assert self.changed.wait_for(until, timeout_s), self._words()[-20:]

    def unplug(self) -> None:
        """It is gone."""
        self.gone = True
        self.theirs.shutdown(socket.SHUT_RDWR)
        self.theirs.close()

    def close(self) -> None:
        if not self.gone:
            self.unplug()
        self.ours.close()
        self._thread.join(60)


class NodeDevice:
    """A Node as `hapticd.hid.device.Device`."""

    def __init__(self, node: Node, path: str) -> None:
        self._node = node
        self.path = path
        self.closed = False

    def fileno(self) -> int:
        return self._node.ours.fileno()

    def _there(self) -> Node:
        if self._node.gone:
            raise DeviceError(f"{self.path}: gone")
        return self._node

    def write(self, report: bytes) -> None:
        self._there().take(report)

    def send_feature(self, report: bytes) -> None:
        self._there().set_feature(report)

    def get_feature(self, report_id: int, length: int) -> bytes:
        return self._there().get_feature(report_id, length)

    def listen(self, timeout_s: float) -> bytes:
        try:
            return self._node.heard.get(timeout=timeout_s)
        except queue.Empty:
            return b""

    def close(self) -> None:
        self.closed = True
        self._node.ours.close()
