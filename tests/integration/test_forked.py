"""A client in a forked child of its process: the child has its sockets, but not the threads that serve them."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable, Coroutine, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

import hapticd.aio
from hapticd.base.errors import HapticdError
from tests.support.daemon_process import Daemon, connect
from tests.support.fake_daemon import fake_daemon, result

# On a busy machine the daemon turns its forces off (fault `control`), and the end of a stream of forces says so.
pytestmark = pytest.mark.filterwarnings("ignore::hapticd.ForcesOff")

HANGS_S = 10
"""A child is killed after this time; it only ends tests that fail."""
REFUSED = f"this client belongs to process {os.getpid()}: connect again"


@pytest.fixture(scope="module")
def daemon(quiet_daemon: Daemon) -> Daemon:
    return quiet_daemon


def in_child(work: Callable[[], object]) -> object:
    """What `work` returns in a forked child, or the text of its HapticdError."""
    ours, theirs = multiprocessing.Pipe(duplex=False)

    def run() -> None:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(HANGS_S)
        try:
            theirs.send(work())
        except HapticdError as error:
            theirs.send(str(error))

    child = multiprocessing.get_context("fork").Process(target=run)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12: this process has threads
        child.start()
    child.join()
    assert child.exitcode == 0, f"the child hung or failed: {child.exitcode}"
    return ours.recv()


class Parent:
    """All that a program can have open when it forks."""

    def __init__(self, daemon: Daemon, file: Path, stack: ExitStack) -> None:
        self.client = stack.enter_context(connect(daemon.directory))
        self.client.get_status()
        self.queued = stack.enter_context(self.client.states())
        self.states = stack.enter_context(self.client.states())
        next(self.states)
        self.newest = stack.enter_context(self.client.states(newest=True))
        self.lease, self.recording, self.stream = (
            self.client.hold_lease(60.0),
            self.client.record(file),
            self.client.stream(),
        )
        stack.enter_context(self.lease)
        stack.enter_context(self.recording)
        stack.enter_context(self.stream)
        self.stream.force(0.0, 0.0)
        self.client.set_operator([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])


@pytest.fixture(scope="module")
def parent(daemon: Daemon, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Parent]:
    file = tmp_path_factory.mktemp("recorded") / "run.npz"
    with ExitStack() as stack:
        yield Parent(daemon, file, stack)
    assert len(hapticd.load(file).samples), "the children did no harm to the blocks of the parent"


USES: dict[str, Callable[[Parent], object]] = {
    "call": lambda parent: parent.client.get_status(),
    "mark": lambda parent: parent.client.mark("from a child"),
    "wait gesture": lambda parent: parent.client.wait_gesture(),
    "hold lease": lambda parent: parent.client.hold_lease().__enter__(),
    "queued item": lambda parent: next(parent.queued),
    "next item": lambda parent: next(parent.states),
    "receive": lambda parent: parent.states.receive(0.0),
    "newest": lambda parent: next(parent.newest),
    "stream": lambda parent: parent.stream.target(0.0, 0.0),
    "new stream": lambda parent: parent.client.stream().__enter__(),
    "end of stream": lambda parent: parent.stream.__exit__(None, None, None),
    "end of lease": lambda parent: parent.lease.__exit__(None, None, None),
    "end of recording": lambda parent: parent.recording.__exit__(None, None, None),
}


@pytest.mark.parametrize("use", USES)
def test_in_a_forked_child_every_use_is_refused_at_once(parent: Parent, use: str) -> None:
    assert in_child(lambda: USES[use](parent)) == REFUSED
    assert parent.client.get_status()["state"] == "running" and next(parent.states)["tick"] > 0
    parent.stream.force(0.0, 0.0)


@pytest.mark.parametrize("block", ["lease", "recording", "stream"])
def test_an_error_leaves_the_blocks_of_the_parent(parent: Parent, block: str) -> None:
    """`sys.exit` in a child, for one."""
    leaves = getattr(parent, block).__exit__
    assert not in_child(lambda: leaves(SystemExit, SystemExit(0), None))
    assert parent.client.get_status()["state"] == "running"


def test_closing_in_a_child_leaves_the_parent_its_connections(parent: Parent) -> None:
    def close() -> str:
        parent.states.close()
        parent.client.close()
        return "closed"

    assert in_child(close) == "closed"
    assert parent.client.get_status()["state"] == "running" and next(parent.states)["tick"] > 0


def test_a_child_connects_anew(daemon: Daemon, parent: Parent) -> None:
    def anew() -> object:
        with connect(daemon.directory) as client, client.samples() as samples:
            return client.get_status()["state"], len(next(samples)) > 0

    assert in_child(anew) == ("running", True)


def test_a_child_of_a_thread_that_calls_closes_its_client(tmp_path: Path) -> None:
    """The thread holds the lock of the connection, which the child can never get."""
    asked, answer = threading.Event(), threading.Event()

    def slow(request: dict[str, Any]) -> list[bytes]:
        asked.set()
        answer.wait()
        return [result(request, {})]

    with fake_daemon(tmp_path, slow) as fake, connect(fake.directory) as client:
        caller = threading.Thread(target=client.get_status)
        caller.start()
        asked.wait()
        try:
            assert in_child(client.close) is None
            assert in_child(client.get_status) == REFUSED
        finally:
            answer.set()
            caller.join()


AsyncUse = Callable[[hapticd.aio.Client, Any, Any], Coroutine[Any, Any, object]]


async def close_both(client: hapticd.aio.Client, states: Any, stream: Any) -> None:
    states.close()
    await client.close()


@pytest.mark.parametrize(
    ("use", "said"),
    [
        (lambda client, states, stream: client.get_status(), REFUSED),
        (lambda client, states, stream: states.__anext__(), REFUSED),
        (lambda client, states, stream: states.receive(0.0), REFUSED),
        (lambda client, states, stream: stream.__aexit__(None, None, None), REFUSED),
        (lambda client, states, stream: client.stream().__aenter__(), REFUSED),
        (close_both, None),
    ],
    ids=["call", "item", "receive", "end_of_stream", "new_stream", "close"],
)
def test_asyncio_in_a_forked_child(daemon: Daemon, use: AsyncUse, said: str | None) -> None:
    async def main() -> None:
        async with hapticd.aio.connect(daemon.directory) as client, client.states() as states:
            await client.get_status()
            async with client.stream() as stream:
                assert in_child(lambda: asyncio.run(use(client, states, stream))) == said
                assert (await client.get_status())["state"] == "running"
                await states.__anext__()

    asyncio.run(main())
