"""Reads all samples of a daemon while a benchmark runs."""

from __future__ import annotations

import threading

import msgpack
import numpy as np
import zmq

from hapticd.client.samples import dtype_of


class SampleReader:
    """Reads all samples in a thread, until `until` sets the last tick."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self._last: int | None = None
        self._ready = threading.Event()
        self._batches: list[np.ndarray[tuple[int], np.dtype[np.void]]] = []
        self._thread = threading.Thread(target=self._read)
        self._thread.start()
        self._ready.wait()

    def _read(self) -> None:
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.RCVHWM, 0)
            socket.setsockopt(zmq.SUBSCRIBE, b"samples")
            socket.connect(self._endpoint)
            end = -1
            while self._last is None or end < self._last:
                message = msgpack.unpackb(socket.recv_multipart()[1])
                batch = np.frombuffer(message["data"], dtype_of(message["dtype"]))
                self._batches.append(batch)
                end = int(batch["tick"][-1])
                self._ready.set()

    def until(self, tick: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
        """Wait for this tick, and return the samples up to it and a few later ones."""
        self._last = tick
        self._thread.join()
        return np.concatenate(self._batches)
