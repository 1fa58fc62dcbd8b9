"""A daemon that says what a test tells it to, on real sockets; for what a real one cannot be made to do."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgpack
import zmq

from hapticd.system.paths import runtime_paths

Answer = Callable[[dict[str, Any]], list[bytes]]
"""What is sent back for a request: any number of bodies."""


def result(request: Mapping[str, Any], value: object) -> bytes:
    return msgpack.packb({"jsonrpc": "2.0", "id": request["id"], "result": value})  # type: ignore[no-any-return]


class FakeDaemon:
    """Answers by `answer`; publishes `state` all the time, and whatever `publish` is given."""

    def __init__(self, directory: Path, answer: Answer) -> None:
        self.directory = directory
        self.answer = answer
        self.requests: list[dict[str, Any]] = []
        self.silent = threading.Event()
        paths = runtime_paths(directory)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._publisher = self._context.socket(zmq.PUB)
        self._publisher.setsockopt(zmq.SNDHWM, 0)  # what is published arrives
        self._publisher.bind(paths.telemetry_endpoint)
        self._queue = self._context.socket(zmq.PULL)
        self._queue.bind("inproc://publish")
        self._feeder = self._context.socket(zmq.PUSH)
        self._feeder.connect("inproc://publish")
        self._router = self._context.socket(zmq.ROUTER)
        self._router.bind(paths.command_endpoint)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def publish(self, topic: str, message: object) -> None:
        self._feeder.send_multipart([topic.encode(), msgpack.packb(message)])

    def _serve(self) -> None:
        poller = zmq.Poller()
        poller.register(self._router, zmq.POLLIN)
        poller.register(self._queue, zmq.POLLIN)
        while not self._stop.is_set():
            ready = dict(poller.poll(5))
            while self._queue.poll(0):
                self._publisher.send_multipart(self._queue.recv_multipart())
            if self._router in ready:
                identity, body = self._router.recv_multipart()
                try:
                    request = msgpack.unpackb(body)
                except ValueError:
                    request = {"undecodable": body}
                self.requests.append(request)
                for reply in self.answer(request):
                    self._router.send_multipart([identity, reply])
            if not self.silent.is_set():
                self._publisher.send_multipart([b"state", msgpack.packb({"tick": 1})])

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._context.destroy(0)


@contextmanager
def fake_daemon(directory: Path, answer: Answer) -> Iterator[FakeDaemon]:
    daemon = FakeDaemon(directory, answer)
    try:
        yield daemon
    finally:
        daemon.close()
