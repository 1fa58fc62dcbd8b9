"""The daemon's process: configuration, runtime directory, threads, signals.

    main thread      waits for a signal: requests a reload of the configuration, or stops all threads in order
    command thread   dispatch.py: answers requests, makes changes, sends the servo a heartbeat
    telemetry thread telemetry.py: drains the rings, publishes
    flight thread    flight_recorder.py: writes the last seconds of telemetry to a file, on a fault or request
    servo thread     csrc/servo/hd_servo_thread.c: computes the force at each tick

The command socket is bound last: if it exists, the daemon is ready. However the daemon ends, the force fades to zero
first.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic_ns
from typing import Final

from hapticd.base import memory, threads, wording
from hapticd.base.core import lib
from hapticd.base.errors import HapticdError
from hapticd.base.model import MAX_FAULTS
from hapticd.config.configuration import Config, chosen_config
from hapticd.config.locations import ConfigFiles, choose
from hapticd.daemon.counters import Granted
from hapticd.daemon.dispatch import Dispatch, serve
from hapticd.daemon.engine import Engine
from hapticd.daemon.flight_recorder import Flight, directory_of
from hapticd.daemon.flight_scene import FlightScene
from hapticd.daemon.methods import Methods
from hapticd.daemon.publisher import TELEMETRY_SOCKET_LIMITS, Publisher
from hapticd.daemon.router import COMMAND_SOCKET_LIMITS, Router
from hapticd.daemon.telemetry import TELEMETRY_TOPICS, Telemetry
from hapticd.hid.stopper import StopFile, stop_device
from hapticd.protocol.events import fault_names
from hapticd.system import journal, notify, open_files
from hapticd.system.paths import Owned, owned, runtime_paths

SWITCH_INTERVAL_S: Final = 0.0005
"""Time after which a thread hands over the interpreter. Python's default of 5 ms would delay the command thread."""

MAX_LOGGED_MARGINS: Final = 3
"""Largest number of surfaces whose stability margin is logged at the start, the lowest first."""

_HANDLED_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)

_log = logging.getLogger("hapticd")


def run(
    config_paths: Sequence[str | os.PathLike[str]] = (),
    runtime_dir: str | os.PathLike[str] | None = None,
    log_level: str = "info",
    rate_hz: float | None = None,
) -> int:
    """Run the daemon until SIGTERM or SIGINT, and return its exit code.

    SIGHUP reloads the configuration or, if the daemon was started on a terminal, ends it.

    `config_paths` are merged in order; without any, the configuration is searched (config/locations.py). A reload reads
    the same files again, or searches again if none was found. `log_level`: one of journal.LOG_LEVELS. `rate_hz`
    replaces servo.rate_hz. Raises HapticdError if the daemon cannot start: invalid configuration, another daemon in the
    runtime directory, or required real-time rights that are refused.
    """
    with ExitStack() as stack:
        memory.return_large_blocks()
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        connections = open_files.raise_descriptor_limit()
        stack.enter_context(journal.attached(log_level))
        stack.push(_log_end)
        chosen = choose(config_paths)
        config = chosen_config(chosen, rate_hz)
        stack.callback(os.umask, os.umask(0o007))
        signals = stack.enter_context(_signals())
        mine = stack.enter_context(owned(runtime_paths(runtime_dir)))
        lib.hd_last_report_arm()
        return _run(config, chosen, rate_hz, mine, signals, stack, connections)


def _run(
    config: Config,
    chosen: ConfigFiles,
    rate_hz: float | None,
    mine: Owned,
    signals: socket.socket,
    stack: ExitStack,
    connections: int,
) -> int:
    paths = mine.paths
    stop_file = StopFile(paths.device)
    _stop_device_of_killed_daemon(stop_file.path)
    engine = Engine(config, stop_file)
    flight = Flight(
        directory_of(config.flight.directory, paths.directory),
        config.flight.seconds,
        config.flight.keep,
        engine.rate_hz,
        monotonic_ns,
        FlightScene(engine.scene, engine.materials, engine.revision, engine.rate_hz),
        lambda: _about(engine, methods),
    )

    def load_again() -> tuple[Config, str]:
        again = chosen if chosen.files else choose()
        return chosen_config(again, rate_hz), str(again)

    methods = Methods(engine, load_again, flight, lambda: telemetry.state())
    threads.check(threads.DAEMON_THREADS)
    publisher = Publisher(mine.listen(paths.telemetry), TELEMETRY_TOPICS, TELEMETRY_SOCKET_LIMITS.of(connections))
    # Long enough for subscribers to read the last samples, which show that the force is zero.
    stack.callback(publisher.close, linger_s=0.2)
    failures: list[BaseException] = []
    telemetry = Telemetry(engine, publisher, methods.status, flight)
    # Stopped in reverse order: commands end, the force fades, telemetry publishes that, and pending files are written.
    _thread("flight", flight.run, failures, stack, wake=flight.wake)
    _thread("telemetry", telemetry.run, failures, stack, wake=telemetry.wake)
    granted = engine.start()
    stack.callback(engine.stop)
    _log_limits(engine, granted, chosen)
    router = Router(mine.listen(paths.command), COMMAND_SOCKET_LIMITS.of(connections))
    stack.callback(router.close)
    watch = notify.Watch(lambda: _progress(engine))
    dispatch = Dispatch(methods, methods.repeats, router.wake)

    def between() -> None:
        watch()
        mine.check()

    _thread(
        "command",
        lambda stop: serve(router, engine, dispatch, stop, between),
        failures,
        stack,
        wake=router.wake,
    )
    # There is little garbage by now, and collecting it would delay the first answer.
    gc.freeze()
    gc.enable()
    _log_ready(engine, granted, paths.command)
    notify.ready(_progress(engine)[1])
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _HANDLED_SIGNALS)
    ended = _await_end(signals, dispatch)
    notify.stopping()
    if failures:
        _log.error("a thread failed: %s: %s", type(failures[0]).__name__, failures[0])
        return 1
    _log.info("%s: stopping", ended.name)
    mine.remove(paths.command)
    return 0


def _log_limits(engine: Engine, granted: Granted, chosen: ConfigFiles) -> None:
    """Log the configuration files, missing privileges, what cannot be displayed, and low stability margins."""
    _log.info("configuration: %s", chosen)
    for missing in granted.missing:
        _log.warning("not granted: %s", missing)
    undisplayable, warnings = engine.limits()
    for problem in (*undisplayable[:MAX_FAULTS], *warnings[:MAX_FAULTS]):
        _log.warning("%s", problem)
    low = [(margin, id) for id, margin in (engine.margins() or {}).items() if margin is not None and margin < 1.0]
    if low:
        worst = wording.listed([f"{id} {margin:.2g}" for margin, id in sorted(low)[:MAX_LOGGED_MARGINS]])
        surfaces = wording.count(len(low), "surface")
        _log.warning("%s with a margin of stability below 1: %s; see `hapticd check`", surfaces, worst)


def _log_ready(engine: Engine, granted: Granted, command: Path) -> None:
    if engine.connection is not None:
        device = engine.connection.status()
        _log.info("device: %s at %s; forces are off until `hapticd force on`", device["name"], device["path"])
    _log.info(
        "ready: %s at %s, %s%s, commands at %s",
        engine.config.device.kind,
        wording.si(engine.config.servo.rate_hz, "Hz"),
        f"SCHED_FIFO {granted.priority}" if granted.priority else "no real-time priority",
        f", memory locked: {granted.memory}",
        command,
    )


def _await_end(signals: socket.socket, dispatch: Dispatch) -> signal.Signals:
    """Wait for the signal that ends the daemon and return it; SIGHUP without a terminal reloads the configuration."""
    # Checked now: the terminal may have closed since the start.
    ends = {signal.SIGTERM, signal.SIGINT} | ({signal.SIGHUP} if _on_terminal() else set())
    # If several signals came together, the end has priority over reloads.
    while not ends.intersection(received := signals.recv(4096)):
        dispatch.ask_reload()
    return signal.Signals(next(number for number in received if number in ends))


def _log_end(kind: type[BaseException] | None, *_: object) -> None:
    """Log the end of the daemon, after all threads have stopped. An error is logged elsewhere."""
    if kind is None:
        _log.info("stopped")


def _on_terminal() -> bool:
    return sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty()


def _about(engine: Engine, methods: Methods) -> dict[str, object]:
    """Return the configuration and the status for a file of the flight recorder."""
    config = engine.config
    return {
        "config": {"servo": config.servo.to_dict(), "device": config.device.to_dict()},
        "status": methods.status(),
    }


def _stop_device_of_killed_daemon(record: Path) -> None:
    """Stop the device of a daemon that was killed, unless systemd did so by `hapticd stop-device`."""
    try:
        done = stop_device(record)
    except HapticdError as error:
        _log.warning("previous daemon: %s", error)
    else:
        if done is not None:
            _log.warning("previous daemon: %s", done)


def _progress(engine: Engine) -> tuple[int, str]:
    """Return the servo's number of ticks, and the daemon's state in one line, for systemd."""
    counters = engine.counters()
    connection = None if engine.connection is None else engine.connection.status()
    device = engine.config.device.kind if connection is None else connection["name"] or "device lost"
    forces = "on" if counters.forces_on else "off"
    if counters.faults:
        forces = f"off by fault: {', '.join(fault_names(counters.faults))}"
    return (
        counters.ticks,
        f"{device} at {wording.si(engine.rate_hz, 'Hz')}; scene revision {engine.revision}; forces {forces}",
    )


def _thread(
    name: str,
    work: Callable[[threading.Event], None],
    failures: list[BaseException],
    stack: ExitStack,
    wake: Callable[[], None] | None = None,
) -> None:
    """Start a thread whose failure ends the daemon. The exit of `stack` ends and joins the thread.

    `wake`: makes the thread check its event while it waits for something else.
    """
    stop = threading.Event()

    def guarded() -> None:
        try:
            work(stop)
        except BaseException as error:
            _log.exception("the %s thread failed", name)
            failures.append(error)
            os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=guarded, name=name)
    thread.start()
    stack.callback(thread.join)
    if wake is not None:
        stack.callback(wake)
    stack.callback(stop.set)


@contextmanager
def _signals() -> Iterator[socket.socket]:
    """Yield a socket from which signal numbers can be read, whichever thread the kernel chose for a signal.

    Threads that are started within the `with` block inherit the blocked signals, so that no handler runs in the servo
    thread. Threads of libraries may not block them, so that sigwait would miss signals.
    """
    ours, pythons = socket.socketpair()
    with ours, pythons:
        pythons.setblocking(False)
        signal.pthread_sigmask(signal.SIG_BLOCK, _HANDLED_SIGNALS)
        before = [signal.signal(number, lambda *_: None) for number in _HANDLED_SIGNALS]
        fd = signal.set_wakeup_fd(pythons.fileno())
        try:
            yield ours
        finally:
            signal.set_wakeup_fd(fd)
            for number, handler in zip(_HANDLED_SIGNALS, before, strict=True):
                signal.signal(number, handler)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _HANDLED_SIGNALS)
