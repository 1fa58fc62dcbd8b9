"""The daemon's process: configuration, runtime directory, threads, signals.

    main thread      waits for a signal (sigwait), then takes everything down in order
    command thread   hapticd.server: answers requests, beats
    telemetry thread hapticd.telemetry: drains the rings, publishes
    servo thread     csrc/hd_servo.c: owns time and force

The command socket is bound last, so that its existence means ready. Whatever ends the daemon, the force fades to zero
first.
"""

from __future__ import annotations

import fcntl
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TypeVar

import zmq

from hapticd import server
from hapticd.config import Config, default_config, load_config
from hapticd.control import Control
from hapticd.engine import Engine
from hapticd.errors import HapticdError
from hapticd.paths import RuntimePaths, make_directory, runtime_paths
from hapticd.telemetry import SEND_HIGH_WATER_MARK, Telemetry

_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
_log = logging.getLogger("hapticd")
_T = TypeVar("_T")


def run(config_paths: Sequence[str | os.PathLike[str]] = (), runtime_dir: str | os.PathLike[str] | None = None) -> int:
    """Runs the daemon until SIGTERM, SIGINT or SIGHUP; returns its exit code.

    `config_paths` are merged in order; without one, the shipped default is used. Raises HapticdError (one line) where
    it cannot start: bad configuration, another daemon on the directory, real time required and refused.
    """
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="hapticd: %(message)s")
    config = load_config(tuple(config_paths)) if config_paths else default_config()
    # Before any thread exists, so that all of them inherit it: only sigwait below takes these.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    os.umask(0o117)
    with ExitStack() as stack:
        paths = stack.enter_context(_runtime(runtime_dir))
        return _run(config, paths, stack)


def _run(config: Config, paths: RuntimePaths, stack: ExitStack) -> int:
    engine = Engine(config)
    control = Control(engine)
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    stack.callback(context.destroy, 0)
    publisher = context.socket(zmq.PUB)
    publisher.setsockopt(zmq.SNDHWM, SEND_HIGH_WATER_MARK)
    publisher.setsockopt(zmq.LINGER, 0)
    _bind(lambda: publisher.bind(paths.telemetry_endpoint), paths.telemetry)
    granted = engine.start()
    stack.callback(engine.stop)
    for missing in granted.missing:
        _log.warning("not granted: %s", missing)
    stop = threading.Event()
    failures: list[BaseException] = []
    telemetry = Telemetry(engine, publisher, control.status)
    _thread("telemetry", lambda: telemetry.run(stop), stop, failures, stack)
    router = _bind(lambda: server.bind(context, paths.command_endpoint), paths.command)
    _thread("command", lambda: server.serve(router, engine, control, stop), stop, failures, stack)
    gc.collect()
    gc.freeze()
    _log.info(
        "ready: %s at %g Hz, %s%s, commands at %s",
        config.device.kind,
        config.servo.rate_hz,
        f"SCHED_FIFO {granted.priority}" if granted.priority else "no real-time priority",
        f", memory locked: {granted.memory}",
        paths.command,
    )
    received = signal.sigwait(_SIGNALS)
    if failures:
        _log.error("a thread failed: %s: %s", type(failures[0]).__name__, failures[0])
        return 1
    _log.info("%s: stopping", signal.Signals(received).name)
    paths.command.unlink(missing_ok=True)
    return 0


def _thread(
    name: str, work: Callable[[], None], stop: threading.Event, failures: list[BaseException], stack: ExitStack
) -> None:
    """A thread that takes the daemon down if it fails, and is ended and joined when the stack unwinds."""

    def guarded() -> None:
        try:
            work()
        except BaseException as error:
            _log.exception("the %s thread failed", name)
            failures.append(error)
            os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=guarded, name=name)
    thread.start()
    stack.callback(thread.join)
    stack.callback(stop.set)


def _bind(bind: Callable[[], _T], path: Path) -> _T:
    """Binds a socket in place of a file that a daemon which is gone left behind: we hold the lock."""
    path.unlink(missing_ok=True)
    try:
        return bind()
    except zmq.ZMQError as error:
        raise HapticdError(f"{path}: cannot be bound: {error.strerror}") from None


@contextmanager
def _runtime(directory: str | os.PathLike[str] | None) -> Iterator[RuntimePaths]:
    """The runtime directory, ours alone while the context lasts."""
    paths = runtime_paths(directory)
    make_directory(paths)
    try:
        lock = os.open(paths.lock, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise HapticdError(f"{paths.lock}: {error.strerror}") from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(lock, 32, 0).decode("ascii", "replace").strip() or "unknown"
            raise HapticdError(
                f"another daemon (process {holder}) runs on {paths.directory}; stop it, or choose another directory "
                "with --runtime-dir"
            ) from None
        os.ftruncate(lock, 0)
        os.pwrite(lock, f"{os.getpid()}\n".encode(), 0)
        yield paths
        for path in (paths.command, paths.telemetry):
            path.unlink(missing_ok=True)
    finally:
        os.close(lock)
